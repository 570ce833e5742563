// The liquid surface in the space of the picture: depths of the particles, smoothed; how much liquid lies behind them;
// and light that is reflected, bent and absorbed there (van der Laan, Green & Sainz 2009, with the filter of Truong &
// Yuksel 2018).

import { dot } from "./camera.js";
import { createPass, createProgram, KEY, runPass, Target } from "./gl.js";
import { ATTRIBUTES, VERTEX } from "./spheres.js";

/** Particles are drawn so much larger than they are, so that those of a calm liquid overlap. */
const GROWTH = 1.4;

/** As far as this, in particle radii, what a particle adds to the thickness is spread. */
const SPREAD = 2.6;

/** How far the filter reaches, in particle radii, and at most, in pixels; how often it is run. */
const REACH = 5;
const MOST_PIXELS = 40;
const ROUNDS = 3;

/** Gaps between particles up to so wide, in particle radii to each side, and in pixels, are closed before. */
const GAP = 0.8;
const MOST_GAP = 12;

const DEPTH = `#version 300 es
precision highp float;
precision highp sampler2D;
in vec2 corner;
flat in vec3 center, color;
uniform float radius;
uniform mat4 projection;
out float away;
void main() {
  float squared = dot(corner, corner);
  if (squared > 1.0) discard;
  float z = center.z + radius * sqrt(1.0 - squared);
  vec2 depth = projection[2].zw * z + projection[3].zw;
  gl_FragDepth = 0.5 + 0.5 * depth.x / depth.y;
  away = -z;
}`;

// The sum of colours, weighted with the thickness, and the thickness itself, metres: the volume of a particle at rest,
// 6.4 r³, as a smooth hill.
const THICKNESS = `#version 300 es
precision highp float;
precision highp sampler2D;
in vec2 corner;
flat in vec3 center, color;
uniform float radius;
out vec4 sum;
void main() {
  float squared = dot(corner, corner);
  if (squared > 1.0) discard;
  float thickness = 6.4 * 3.0 / 3.14159 / ${SPREAD ** 3} * radius * (1.0 - squared) * (1.0 - squared);
  sum = vec4(pow(color, vec3(2.2)) * thickness, thickness);
}`;

// One direction of the narrow-range filter: what is far in front is left out, what is far behind counts as just behind.
const SMOOTH = `#version 300 es
precision highp float;
precision highp sampler2D;
in vec2 uv;
uniform sampler2D distances;
uniform vec4 area;
uniform vec2 direction;
uniform float reach, radius, most, gap;
out float smoothed;
// The distances so far to both sides.
vec2 beside(int pixels) {
  vec2 offset = float(pixels) * direction;
  vec2 high = area.xy + area.zw;
  return vec2(
    texture(distances, clamp(uv + offset, area.xy, high)).r,
    texture(distances, clamp(uv - offset, area.xy, high)).r
  );
}
void main() {
  float here = texture(distances, uv).r;
  if (here == 0.0) { smoothed = 0.0; return; }
  // A calm liquid is closed: what is seen far below it between two particles would stay a hole.
  int width = int(min(gap / here, ${MOST_GAP}.0));
  for (int k = 1; k <= ${MOST_GAP}; k++) {
    if (k > width) break;
    vec2 sides = beside(k);
    if (sides.x != 0.0 && sides.y != 0.0) here = min(here, max(sides.x, sides.y));
  }
  float pixels = clamp(reach / here, 1.0, most);
  int steps = int(ceil(pixels));
  float sigma = 0.5 * pixels;
  float below = here - 2.5 * radius;
  float above = here + 2.5 * radius;
  float sum = here;
  float weights = 1.0;
  for (int k = 1; k <= ${MOST_PIXELS}; k++) {
    if (k > steps) break;
    float weight = exp(-0.5 * float(k * k) / (sigma * sigma));
    vec2 sides = beside(k);
    // In pairs, so that a slope stays where it is.
    if (min(sides.x, sides.y) < below) continue;
    sum += weight * (min(sides.x, above) + min(sides.y, above));
    weights += 2.0 * weight;
  }
  smoothed = sum / weights;
}`;

const SHADE = `#version 300 es
precision highp float;
precision highp sampler2D;
in vec2 uv;
uniform sampler2D distances, thicknesses, behind, behindDepths;
uniform vec4 area;
uniform vec2 pixel, nearFar, slope;
uniform vec3 upInView, skyTop, skyBottom, gleamColor;
out vec4 shaded;
${KEY}
float distanceAt(vec2 at) { return texture(distances, clamp(at, area.xy, area.xy + area.zw)).r; }
vec3 pointAt(vec2 at, float away) {
  vec2 inside = 2.0 * (at - area.xy) / area.zw - 1.0;
  return away * vec3(inside * slope, -1.0);
}
vec3 difference(vec2 apart, vec3 here, float away) {
  float first = distanceAt(uv + apart);
  float second = distanceAt(uv - apart);
  bool takesFirst = second == 0.0 || (first != 0.0 && abs(first - away) < abs(second - away));
  if (takesFirst && first != 0.0) return pointAt(uv + apart, first) - here;
  if (second != 0.0) return here - pointAt(uv - apart, second);
  return vec3(0.0);
}
vec3 surroundings(vec3 direction) {
  float height = dot(direction, upInView);
  vec3 sky = mix(skyBottom, skyTop, smoothstep(-0.25, 0.85, height));
  float window = smoothstep(0.965, 0.985, dot(direction, normalize(KEY + vec3(0.15, 0.1, 0.0))));
  return sky + gleamColor * window * 0.55;
}
void main() {
  float away = distanceAt(uv);
  if (away == 0.0) {
    gl_FragDepth = 1.0;
    shaded = vec4(texture(behind, uv).rgb, 1.0);
    return;
  }
  vec3 point = pointAt(uv, away);
  vec3 across = difference(vec2(pixel.x, 0.0), point, away);
  vec3 upwards = difference(vec2(0.0, pixel.y), point, away);
  vec3 normal = cross(across, upwards);
  float size = length(normal);
  normal = size > 0.0 ? normal / size : vec3(0.0, 0.0, 1.0);
  vec3 toEye = normalize(-point);
  vec4 sum = texture(thicknesses, uv);
  float thickness = sum.a;
  vec3 tint = sum.rgb / max(sum.a, 1e-6);
  float fresnel = 0.02 + 0.98 * pow(1.0 - clamp(dot(normal, toEye), 0.0, 1.0), 5.0);
  vec2 bent = clamp(uv - normal.xy * min(thickness, 0.5) * 0.12 / away, area.xy, area.xy + area.zw);
  vec3 through = pow(texture(behind, bent).rgb, vec3(2.2));
  vec3 passes = exp(-thickness * (1.08 - tint) * 4.5);
  float lit = 0.55 + 0.45 * max(0.0, dot(normal, KEY)) + 0.15 * dot(normal, upInView);
  float milk = 1.0 - exp(-thickness * 22.0);
  vec3 body = mix(through * passes, tint * lit, milk * 0.7);
  vec3 reflected = surroundings(reflect(-toEye, normal));
  float gleam = pow(max(0.0, dot(normal, normalize(KEY + toEye))), 220.0);
  vec3 linear = mix(body, reflected, fresnel) + gleamColor * gleam * 0.9;
  // Drops and rims are thin: they fade into what is behind them.
  float cover = smoothstep(0.0, 0.006, thickness);
  linear = mix(pow(texture(behind, uv).rgb, vec3(2.2)), linear, cover);
  float z = (nearFar.y + nearFar.x - 2.0 * nearFar.x * nearFar.y / away) / (nearFar.y - nearFar.x);
  gl_FragDepth = 0.5 + 0.5 * z;
  shaded = vec4(pow(linear, vec3(1.0 / 2.2)), 1.0);
}`;

const BACKGROUND = `#version 300 es
precision highp float;
precision highp sampler2D;
in vec2 uv;
uniform vec3 top, bottom;
out vec4 shaded;
void main() {
  shaded = vec4(mix(bottom, top, uv.y), 1.0);
}`;

/** Why there is no liquid surface on this machine; null if there is one. */
export function missingForSurface(gl) {
  return gl.getExtension("EXT_color_buffer_float") ? null : "this browser cannot draw into floating-point pictures";
}

export class Surface {
  constructor(gl) {
    this.gl = gl;
    this.depth = createProgram(gl, VERTEX, DEPTH, ATTRIBUTES);
    this.thickness = createProgram(gl, VERTEX, THICKNESS, ATTRIBUTES);
    this.smooth = createPass(gl, SMOOTH);
    this.shade = createPass(gl, SHADE);
    this.background = createPass(gl, BACKGROUND);
    this.distances = [true, false].map((depth) => new Target(gl, { format: gl.R32F, filter: gl.NEAREST, depth }));
    this.sums = new Target(gl, { format: gl.RGBA16F, filter: gl.LINEAR });
  }

  /** The background with walls, into the target. */
  drawBackground(style, target, area) {
    const { gl } = this;
    target.bind();
    target.limit(area);
    gl.disable(gl.DEPTH_TEST);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    runPass(gl, this.background, area, {}, (set) => {
      gl.uniform3fv(set.top, style.theme.top);
      gl.uniform3fv(set.bottom, style.theme.bottom);
    });
  }

  /** Draws the liquid over what is in `first`, into `second`. */
  draw(cloud, look, style, tables, area, first, second) {
    const { gl } = this;
    const { theme } = style;
    const [distances, other] = this.distances;
    [distances, other].forEach((target) => target.resize(first.width, first.height));
    this.sums.resize(Math.ceil(first.width / 2), Math.ceil(first.height / 2));
    distances.bind();
    distances.limit(area);
    gl.enable(gl.DEPTH_TEST);
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    cloud.draw(this.depth, look, { ...style, radius: GROWTH * style.radius }, tables);
    gl.disable(gl.DEPTH_TEST);

    this.sums.bind();
    this.sums.limit(area);
    gl.clearBufferfv(gl.COLOR, 0, [0, 0, 0, 0]);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE);
    cloud.draw(this.thickness, look, { ...style, radius: SPREAD * style.radius }, tables);
    gl.disable(gl.BLEND);

    const pixel = [1 / first.width, 1 / first.height];
    for (let round = 0; round < ROUNDS; round++) {
      // Wide first, then what the pairs of directions have left.
      const scale = style.radius * 0.5 * look.f * first.height * area[3];
      const reach = (REACH * scale) / 2 ** round;
      const gap = round === 0 ? GAP * scale : 0;
      [[other, distances, [pixel[0], 0]], [distances, other, [0, pixel[1]]]].forEach(([to, from, direction]) => {
        to.bind();
        to.limit(area);
        runPass(gl, this.smooth, area, { distances: from.color }, (set) => {
          gl.uniform2fv(set.direction, direction);
          gl.uniform1f(set.reach, reach);
          gl.uniform1f(set.gap, gap);
          gl.uniform1f(set.radius, style.radius);
          gl.uniform1f(set.most, MOST_PIXELS / 2 ** round);
        });
      });
    }

    second.bind();
    second.limit(area);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.ALWAYS);
    const textures = { distances: distances.color, thicknesses: this.sums.color, behind: first.color };
    runPass(gl, this.shade, area, textures, (set) => {
      gl.uniform2fv(set.pixel, pixel);
      gl.uniform2f(set.nearFar, look.near, look.far);
      gl.uniform2f(set.slope, look.aspect / look.f, 1 / look.f);
      gl.uniform3fv(set.upInView, [look.right, look.above, look.back].map((axis) => dot(axis, style.up)));
      gl.uniform3fv(set.skyTop, theme.skyTop);
      gl.uniform3fv(set.skyBottom, theme.skyBottom);
      gl.uniform3fv(set.gleamColor, theme.gleam);
    });
    gl.depthFunc(gl.LESS);
  }
}
