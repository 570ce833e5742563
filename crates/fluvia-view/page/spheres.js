// Particles as spheres: a square each, on which every pixel finds its point of the sphere and its depth.

import { dot } from "./camera.js";
import { BODIES, ramp, STEPS, WATER } from "./colors.js";
import { createPass, createProgram, KEY, runPass } from "./gl.js";

/** Where a particle is and what colour it has; shared with the liquid surface. */
export const VERTEX = `#version 300 es
precision highp float;
precision highp sampler2D;
in vec4 place;
in vec2 small;
uniform vec3 low, extent, up, plain;
uniform float highestSpeed, radius, scaleLow, scaleHigh, curve;
uniform mat4 view, projection;
uniform int coloring;
uniform sampler2D rampTable, bodyTable;
out vec2 corner;
flat out vec3 center, color;
void main() {
  vec3 position = low + extent * place.xyz;
  corner = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
  center = (view * vec4(position, 1.0)).xyz;
  gl_Position = projection * vec4(center + vec3(corner * radius, 0.0), 1.0);
  if (coloring == 3) {
    color = texelFetch(bodyTable, ivec2(int(small.y) % ${BODIES.length}, 0), 0).rgb;
  } else if (coloring == 4) {
    color = plain;
  } else {
    float value = coloring == 0 ? place.w * highestSpeed : coloring == 1 ? dot(position, up) : small.x / 100.0;
    float at = pow(clamp((value - scaleLow) / max(scaleHigh - scaleLow, 1e-6), 0.0, 1.0), curve);
    color = texelFetch(rampTable, ivec2(int(at * ${STEPS - 1}.0 + 0.5), 0), 0).rgb;
  }
}`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2D;
in vec2 corner;
flat in vec3 center, color;
uniform float radius;
uniform mat4 projection;
uniform vec3 upInView, sky, ground;
out vec4 shaded;
${KEY}
void main() {
  float squared = dot(corner, corner);
  if (squared > 1.0) discard;
  vec3 normal = vec3(corner, sqrt(1.0 - squared));
  vec3 point = center + radius * normal;
  vec2 depth = projection[2].zw * point.z + projection[3].zw;
  gl_FragDepth = 0.5 + 0.5 * depth.x / depth.y;
  vec3 linear = pow(color, vec3(2.2));
  vec3 light = mix(ground, sky, 0.5 + 0.5 * dot(normal, upInView));
  float key = max(0.0, (dot(normal, KEY) + 0.25) / 1.25);
  float gleam = pow(max(0.0, dot(normal, normalize(KEY + vec3(0.0, 0.0, 1.0)))), 40.0);
  shaded = vec4(pow(linear * (light + 0.62 * key) + 0.10 * gleam, vec3(1.0 / 2.2)), 1.0);
}`;

// What lies deep between others gets less light: the depths around say how deep (two rings, one of about a particle, one
// of several). The second sum marks the rims of what is in front, as in eye-dome lighting (Boucheny 2009).
const SHADE = `#version 300 es
precision highp float;
precision highp sampler2D;
in vec2 uv;
uniform sampler2D colors, depths;
uniform vec3 top, bottom;
uniform vec4 area;
uniform vec2 nearFar, pixel;
uniform float radius, focal;
out vec4 shaded;
float distanceAt(vec2 at) {
  float z = 2.0 * texture(depths, clamp(at, area.xy + pixel, area.xy + area.zw - pixel)).r - 1.0;
  return 2.0 * nearFar.x * nearFar.y / (nearFar.y + nearFar.x - z * (nearFar.y - nearFar.x));
}
void main() {
  float depth = texture(depths, uv).r;
  gl_FragDepth = depth;
  if (depth == 1.0) {
    shaded = vec4(mix(bottom, top, uv.y), 1.0);
    return;
  }
  float here = distanceAt(uv);
  float reach = focal * radius / here;
  float occluded = 0.0;
  float rim = 0.0;
  float turn = 6.2831853 * fract(52.9829189 * fract(dot(gl_FragCoord.xy, vec2(0.06711056, 0.00583715))));
  for (int i = 0; i < 12; i++) {
    float angle = turn + 2.3999632 * float(i);
    float ring = sqrt((float(i) + 0.5) / 12.0);
    vec2 offset = ring * vec2(cos(angle), sin(angle)) * pixel;
    float wide = (here - distanceAt(uv + offset * max(7.0 * reach, 3.0))) / radius;
    occluded += clamp(wide / 5.0, 0.0, 1.0) * (1.0 - smoothstep(6.0, 18.0, wide));
    float close = (here - distanceAt(uv + offset * clamp(1.2 * reach, 1.0, 6.0))) / radius;
    rim += clamp(close, 0.0, 2.0);
  }
  float light = (1.0 - 0.85 * occluded / 12.0) * exp(-0.42 * rim / 12.0);
  shaded = vec4(texture(colors, uv).rgb * light, 1.0);
}`;

function table(gl, colors) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  const bytes = new Uint8Array(colors.flatMap((color) => [...color.map((x) => Math.round(255 * x)), 255]));
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, colors.length, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, bytes);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  return made;
}

/** The particles of a panel on the GPU, as they came. */
export class Cloud {
  constructor(gl) {
    this.gl = gl;
    this.rows = gl.createBuffer();
    this.small = gl.createBuffer();
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.rows);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 4, gl.UNSIGNED_SHORT, true, 8, 0);
    gl.vertexAttribDivisor(0, 1);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.small);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 2, gl.UNSIGNED_BYTE, false, 2, 0);
    gl.vertexAttribDivisor(1, 1);
    gl.bindVertexArray(null);
    this.panel = null;
  }

  set(panel) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.rows);
    gl.bufferData(gl.ARRAY_BUFFER, panel.rows, gl.STREAM_DRAW);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.small);
    gl.bufferData(gl.ARRAY_BUFFER, panel.small, gl.STREAM_DRAW);
    this.panel = panel;
  }

  /** Draws all particles as squares, with a program whose vertex shader is VERTEX. */
  draw({ program, uniforms }, look, style, tables) {
    const { gl, panel } = this;
    if (!panel || panel.count === 0) return;
    gl.useProgram(program);
    gl.uniformMatrix4fv(uniforms.view, false, look.view);
    gl.uniformMatrix4fv(uniforms.projection, false, look.projection);
    gl.uniform3fv(uniforms.low, panel.low);
    gl.uniform3fv(uniforms.extent, panel.extent);
    gl.uniform1f(uniforms.highestSpeed, panel.highestSpeed);
    gl.uniform1f(uniforms.radius, style.radius);
    gl.uniform3fv(uniforms.up, style.up);
    gl.uniform3fv(uniforms.plain, WATER);
    gl.uniform1i(uniforms.coloring, style.coloring);
    gl.uniform1f(uniforms.scaleLow, style.scale?.low ?? 0);
    gl.uniform1f(uniforms.scaleHigh, style.scale?.high ?? 1);
    gl.uniform1f(uniforms.curve, style.scale?.curve ?? 1);
    [tables.ramp, tables.bodies].forEach((texture, unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(gl.TEXTURE_2D, texture);
    });
    gl.uniform1i(uniforms.rampTable, 0);
    gl.uniform1i(uniforms.bodyTable, 1);
    gl.bindVertexArray(this.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, panel.count);
    gl.bindVertexArray(null);
  }
}

export const ATTRIBUTES = ["place", "small"];

export function colorTables(gl) {
  const steps = Array.from({ length: STEPS }, (_, k) => ramp(k / (STEPS - 1)));
  return { ramp: table(gl, steps), bodies: table(gl, BODIES) };
}

export class Spheres {
  constructor(gl) {
    this.gl = gl;
    this.program = createProgram(gl, VERTEX, FRAGMENT, ATTRIBUTES);
    this.shade = createPass(gl, SHADE);
  }

  /** Draws into `first`, then shaded, on the background, into `second`. */
  draw(cloud, look, style, tables, area, first, second) {
    const { gl } = this;
    const { theme } = style;
    first.bind();
    first.limit(area);
    gl.enable(gl.DEPTH_TEST);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(this.program.program);
    const { uniforms } = this.program;
    gl.uniform3fv(uniforms.upInView, [look.right, look.above, look.back].map((axis) => dot(axis, style.up)));
    gl.uniform3fv(uniforms.sky, theme.sky);
    gl.uniform3fv(uniforms.ground, theme.ground);
    cloud.draw(this.program, look, style, tables);
    second.bind();
    second.limit(area);
    gl.depthFunc(gl.ALWAYS);
    runPass(gl, this.shade, area, { colors: first.color, depths: first.depth }, (set) => {
      gl.uniform3fv(set.top, theme.top);
      gl.uniform3fv(set.bottom, theme.bottom);
      gl.uniform2f(set.nearFar, look.near, look.far);
      gl.uniform2f(set.pixel, 1 / first.width, 1 / first.height);
      gl.uniform1f(set.radius, style.radius);
      gl.uniform1f(set.focal, 0.5 * look.f * first.height * area[3]);
    });
    gl.depthFunc(gl.LESS);
  }
}
