// One picture: particles or surface, walls, smooth edges; one panel, or two side by side.

import { dot } from "./camera.js";
import { COLORINGS, cssColor, isDark, scaleOf } from "./colors.js";
import { createPass, runPass, Target } from "./gl.js";
import { Cloud, colorTables, Spheres } from "./spheres.js";
import { missingForSurface, Surface } from "./surface.js";
import { Walls } from "./walls.js";

// Fast approximate anti-aliasing (Lottes 2009): along an edge of brightness, a mean of both sides.
const SMOOTH_EDGES = `#version 300 es
precision highp float;
precision highp sampler2D;
in vec2 uv;
uniform sampler2D picture;
uniform vec2 pixel;
out vec4 smoothed;
float brightness(vec3 color) { return dot(color, vec3(0.299, 0.587, 0.114)); }
vec3 at(vec2 offset) { return texture(picture, uv + offset * pixel).rgb; }
void main() {
  vec3 middle = at(vec2(0.0));
  float nw = brightness(at(vec2(-1.0, 1.0)));
  float ne = brightness(at(vec2(1.0, 1.0)));
  float sw = brightness(at(vec2(-1.0, -1.0)));
  float se = brightness(at(vec2(1.0, -1.0)));
  float m = brightness(middle);
  float low = min(m, min(min(nw, ne), min(sw, se)));
  float high = max(m, max(max(nw, ne), max(sw, se)));
  if (high - low < max(0.03, 0.12 * high)) { smoothed = vec4(middle, 1.0); return; }
  vec2 along = vec2((sw + se) - (nw + ne), (nw + sw) - (ne + se));
  float least = 1.0 / (min(abs(along.x), abs(along.y)) + max(0.03 * (nw + ne + sw + se), 0.008));
  along = clamp(along * least, -6.0, 6.0);
  vec3 near = 0.5 * (at(along * (1.0 / 3.0 - 0.5)) + at(along * (2.0 / 3.0 - 0.5)));
  vec3 wide = 0.5 * near + 0.25 * (at(along * -0.5) + at(along * 0.5));
  float b = brightness(wide);
  smoothed = vec4(b < low || b > high ? near : wide, 1.0);
}`;

/** Milliseconds a picture above which they are made coarser, and below which they may be finer. */
const SLOW = 45;
const FAST = 22;

/** How coarse pictures may become, and how much with a step. */
const COARSEST = 0.5;
const STEP = 0.25;

/** So many slow pictures in a row make them coarser, and so many fast ones finer. */
const SLOW_ROW = 6;
const FAST_ROW = 90;

/** Each time that finer pictures were too slow they are tried again after as many times more fast ones, up to so many. */
const CAUTION = 2;
const LONGEST_ROW = 5000;

/** How fine pictures are drawn, 1 for as fine as the screen: coarser where they take long, finer again where they no longer do. */
export class Fineness {
  constructor() {
    Object.assign(this, { value: 1, slow: 0, fast: 0, row: FAST_ROW, isTrial: false });
  }

  /** A picture has taken so many milliseconds. */
  adapt(milliseconds) {
    this.slow = milliseconds > SLOW ? this.slow + 1 : 0;
    this.fast = milliseconds < FAST ? this.fast + 1 : 0;
    if (this.slow >= SLOW_ROW && this.value > COARSEST) {
      if (this.isTrial) this.row = Math.min(CAUTION * this.row, LONGEST_ROW);
      Object.assign(this, { value: this.value - STEP, slow: 0, isTrial: false });
    } else if (this.fast >= this.row && this.value < 1) {
      Object.assign(this, { value: this.value + STEP, fast: 0, isTrial: true });
    }
  }
}

export class Renderer {
  /** Throws where there is no WebGL2. `adapts`: whether pictures become coarser where they take long. */
  constructor(canvas, adapts) {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, powerPreference: "high-performance" });
    if (!gl) throw new Error("this browser has no WebGL2");
    this.canvas = canvas;
    this.gl = gl;
    this.missing = missingForSurface(gl);
    this.clouds = [];
    this.tables = colorTables(gl);
    this.spheres = new Spheres(gl);
    this.surface = this.missing ? null : new Surface(gl);
    this.walls = new Walls(gl);
    this.edges = createPass(gl, SMOOTH_EDGES);
    const color = { format: gl.RGBA8, filter: gl.LINEAR, depth: true };
    this.targets = [new Target(gl, color), new Target(gl, color)];
    this.adapts = adapts;
    this.fineness = new Fineness();
    gl.enable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 1);
    this.readTheme();
  }

  /** Takes the colours of the scene from the style sheet. */
  readTheme() {
    const dark = isDark();
    const linear = (name) => cssColor(name).map((x) => x ** 2.2);
    this.theme = {
      top: cssColor("--scene-top"),
      bottom: cssColor("--scene-bottom"),
      wall: cssColor("--scene-wall"),
      edge: cssColor("--scene-edge"),
      // Of faces, points, edges.
      opacities: dark ? [0.075, 0.34, 0.34] : [0.11, 0.42, 0.3],
      sky: dark ? [0.52, 0.56, 0.62] : [0.6, 0.62, 0.66],
      ground: dark ? [0.13, 0.14, 0.17] : [0.26, 0.27, 0.29],
      skyTop: linear("--scene-sky"),
      skyBottom: linear("--scene-horizon"),
      gleam: dark ? [0.9, 0.95, 1] : [1, 1, 1],
    };
  }

  setFrame(frame) {
    while (this.clouds.length < frame.panels.length) this.clouds.push(new Cloud(this.gl));
    frame.panels.forEach((panel, k) => this.clouds[k].set(panel));
    this.panels = frame.panels.length;
    this.hasDensities = frame.hasDensities;
  }

  setWalls(walls) {
    this.walls.set(walls);
    Object.assign(this, { low: walls.low, high: walls.high });
  }

  /** The parts of the picture that the panels take, in texture coordinates: beside each other, in a tall one above. */
  areas(panels) {
    const part = 1 / panels;
    const isTall = this.canvas.height > this.canvas.width;
    return Array.from({ length: panels }, (_, k) => (isTall ? [0, 1 - (k + 1) * part, 1, part] : [k * part, 0, part, 1]));
  }

  /** Milliseconds that a picture has taken. */
  adapt(milliseconds) {
    if (this.adapts) this.fineness.adapt(milliseconds);
  }

  /** Draws; `view` says how: camera, radius, up, coloring, isSurface, hasWalls. Returns how the panels are looked at, and where they are. */
  draw(view) {
    const { gl, canvas } = this;
    const [first, second] = this.targets;
    const [width, height] = [canvas.width, canvas.height].map((size) => Math.max(1, Math.round(size * this.fineness.value)));
    this.targets.forEach((target) => target.resize(width, height));
    const panels = Math.max(1, this.panels ?? 1);
    const areas = this.areas(panels);
    const [, , across, upwards] = areas[0];
    const look = view.camera.look((width * across) / (height * upwards), canvas.clientHeight * upwards);
    const ends = [this.low ?? [0, 0, 0], this.high ?? [1, 1, 1]].map((x) => dot(x, view.up));
    // Densities come a frame after they were asked for: no colours until then, rather than wrong ones.
    const shown = view.coloring === "density" && !this.hasDensities ? "plain" : view.coloring;
    const style = {
      radius: view.radius,
      up: view.up,
      coloring: COLORINGS.find(({ name }) => name === shown).number,
      scale: scaleOf(shown, Math.min(...ends), Math.max(...ends)),
      theme: this.theme,
    };
    areas.forEach((area, k) => {
      const cloud = (this.clouds[k] ??= new Cloud(gl));
      if (view.isSurface && this.surface) {
        this.surface.drawBackground(style, first, area);
        if (view.hasWalls) this.walls.draw(look, style, first, area);
        this.surface.draw(cloud, look, style, this.tables, area, first, second);
        if (view.hasWalls) this.walls.drawInFront(look, style, second, area, this.surface.distances[0].color);
      } else {
        this.spheres.draw(cloud, look, style, this.tables, area, first, second);
        if (view.hasWalls) this.walls.draw(look, style, second, area);
      }
    });
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.scissor(0, 0, canvas.width, canvas.height);
    gl.disable(gl.DEPTH_TEST);
    runPass(gl, this.edges, [0, 0, 1, 1], { picture: second.color }, (set) => {
      gl.uniform2f(set.pixel, 1 / width, 1 / height);
    });
    return { look, areas };
  }
}
