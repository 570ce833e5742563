// Walls: the sides that look at the eye, translucent, with their edges; or points where only points are known.

import { cross, dot } from "./camera.js";
import { createProgram, KEY } from "./gl.js";

const VERTEX = `#version 300 es
precision highp float;
precision highp sampler2D;
in vec3 position;
in vec4 normal;
uniform mat4 view, projection;
uniform float pointSize;
out vec3 point, direction;
out float solid;
void main() {
  point = (view * vec4(position, 1.0)).xyz;
  direction = mat3(view) * normal.xyz;
  solid = normal.w;
  gl_Position = projection * vec4(point, 1.0);
  gl_PointSize = clamp(pointSize / gl_Position.w, 1.5, 24.0);
}`;

// Where a liquid is on the picture already, only walls in front of it are drawn.
const FRAGMENT = `#version 300 es
precision highp float;
precision highp sampler2D;
in vec3 point, direction;
in float solid;
uniform vec3 color;
uniform int kind;
uniform float opacity;
uniform bool overLiquid;
uniform sampler2D distances;
out vec4 shaded;
${KEY}
void main() {
  if (overLiquid && texelFetch(distances, ivec2(gl_FragCoord.xy), 0).r == 0.0) discard;
  float alpha = opacity;
  vec3 lit = color;
  if (kind == 1) {
    vec2 corner = 2.0 * gl_PointCoord - 1.0;
    if (dot(corner, corner) > 1.0 || dot(direction, point) > 0.0) discard;
  } else if (kind == 0) {
    vec3 normal = normalize(direction);
    float facing = abs(dot(normal, normalize(point)));
    float light = 0.5 + 0.5 * dot(normal, KEY);
    lit = color * mix(0.72, 1.0, light);
    alpha = opacity * mix(1.0 + 0.9 * pow(1.0 - facing, 2.0), 3.6 + 2.0 * (1.0 - facing), solid);
  }
  shaded = vec4(lit * alpha, alpha);
}`;

/** Two faces with normals farther apart than this have an edge between them. */
const SHARP = Math.cos((28 * Math.PI) / 180);

/** The size of a wall point, in particle radii. */
const POINT = 0.9;

function triangleNormal(vertices, [a, b, c]) {
  const [u, v] = [b, c].map((corner) => [0, 1, 2].map((k) => vertices[3 * corner + k] - vertices[3 * a + k]));
  return cross(u, v);
}

/** For every vertex the number of the connected surface that it is part of. */
function components(count, triangles) {
  const parent = Uint32Array.from({ length: count }, (_, k) => k);
  const root = (k) => {
    while (parent[k] !== k) k = parent[k] = parent[parent[k]];
    return k;
  };
  for (let t = 0; t < triangles.length; t += 3) {
    for (const k of [1, 2]) parent[root(triangles[t + k])] = root(triangles[t]);
  }
  return Uint32Array.from(parent, (_, k) => root(k));
}

/** Triangles with a normal each, told apart into what holds fluid and what lies in it; and the sharp edges. */
export function buildSurface({ vertices, triangles }) {
  const count = triangles.length / 3;
  const part = components(vertices.length / 3, triangles);
  const normals = [];
  const volume = new Map();
  const edges = new Map();
  for (let t = 0; t < count; t++) {
    const corners = [0, 1, 2].map((k) => triangles[3 * t + k]);
    const scaled = triangleNormal(vertices, corners);
    const length = Math.hypot(...scaled) || 1;
    normals.push(scaled.map((x) => x / length));
    // Seen from a vertex of the same surface: far from the origin nothing is lost.
    const whole = part[corners[0]];
    const moment = [0, 1, 2].reduce((sum, k) => sum + scaled[k] * (vertices[3 * corners[0] + k] - vertices[3 * whole + k]), 0);
    volume.set(whole, (volume.get(whole) ?? 0) + moment);
    for (const k of [0, 1, 2]) {
      const [a, b] = [corners[k], corners[(k + 1) % 3]];
      const key = Math.min(a, b) * vertices.length + Math.max(a, b);
      const sides = edges.get(key);
      if (sides) sides.push(t);
      else edges.set(key, [t]);
    }
  }
  // What is open has no inside, and holds fluid.
  for (const [key, sides] of edges) if (sides.length % 2 === 1) volume.set(part[key % vertices.length], 0);
  const faces = new Float32Array(21 * count);
  for (let t = 0; t < count; t++) {
    for (const k of [0, 1, 2]) {
      const vertex = triangles[3 * t + k];
      faces.set(vertices.subarray(3 * vertex, 3 * vertex + 3), 21 * t + 7 * k);
      // Faces look into the fluid: those of an obstacle look outwards.
      faces.set([...normals[t], volume.get(part[vertex]) > 0 ? 1 : 0], 21 * t + 7 * k + 3);
    }
  }
  const lines = [];
  for (const [key, sides] of edges) {
    const [a, b] = sides.map((t) => normals[t]);
    if (b && dot(a, b) > SHARP) continue;
    for (const vertex of [Math.floor(key / vertices.length), key % vertices.length]) {
      lines.push(...vertices.subarray(3 * vertex, 3 * vertex + 3), 0, 0, 0, 0);
    }
  }
  return { faces, lines: new Float32Array(lines) };
}

function buildPoints({ points }) {
  const count = points.length / 6;
  const rows = new Float32Array(7 * count);
  for (let k = 0; k < count; k++) rows.set(points.subarray(6 * k, 6 * k + 6), 7 * k);
  return rows;
}

export class Walls {
  constructor(gl) {
    this.gl = gl;
    this.program = createProgram(gl, VERTEX, FRAGMENT, ["position", "normal"]);
    this.parts = [];
  }

  set(walls) {
    const { faces, lines } = buildSurface(walls);
    const { gl } = this;
    for (const { array, buffer } of this.parts) {
      gl.deleteVertexArray(array);
      gl.deleteBuffer(buffer);
    }
    this.parts = [
      { kind: 0, mode: gl.TRIANGLES, rows: faces },
      { kind: 1, mode: gl.POINTS, rows: buildPoints(walls) },
      { kind: 2, mode: gl.LINES, rows: lines },
    ].filter(({ rows }) => rows.length > 0);
    for (const part of this.parts) {
      part.array = gl.createVertexArray();
      gl.bindVertexArray(part.array);
      part.buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, part.buffer);
      gl.bufferData(gl.ARRAY_BUFFER, part.rows, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(0);
      gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 28, 0);
      gl.enableVertexAttribArray(1);
      gl.vertexAttribPointer(1, 4, gl.FLOAT, false, 28, 12);
    }
    gl.bindVertexArray(null);
  }

  /** Draws over the liquid in the target alone, where it is in front of it; distances are 0 where there is none. */
  drawInFront(look, style, target, area, distances) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, distances);
    this.draw(look, style, target, area, true);
  }

  /** Draws over what is in the target, as far as it is in front of it. */
  draw(look, style, target, area, overLiquid = false) {
    const { gl } = this;
    const { program, uniforms } = this.program;
    target.bind();
    target.limit(area);
    gl.useProgram(program);
    gl.uniformMatrix4fv(uniforms.view, false, look.view);
    gl.uniformMatrix4fv(uniforms.projection, false, look.projection);
    gl.uniform1i(uniforms.overLiquid, overLiquid ? 1 : 0);
    gl.uniform1i(uniforms.distances, 0);
    gl.uniform1f(uniforms.pointSize, POINT * style.radius * look.f * target.height * area[3]);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.enable(gl.CULL_FACE);
    gl.depthMask(false);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    for (const { kind, mode, rows, array } of this.parts) {
      gl.uniform1i(uniforms.kind, kind);
      gl.uniform3fv(uniforms.color, kind === 2 ? style.theme.edge : style.theme.wall);
      gl.uniform1f(uniforms.opacity, style.theme.opacities[kind]);
      gl.bindVertexArray(array);
      gl.drawArrays(mode, 0, rows.length / 7);
    }
    gl.bindVertexArray(null);
    gl.depthMask(true);
    gl.disable(gl.CULL_FACE);
    gl.disable(gl.BLEND);
  }
}
