// WebGL2 in the few forms that the page needs: programs, targets, a pass over all pixels.

const FULL_SCREEN = `#version 300 es
out vec2 uv;
uniform vec4 area;
void main() {
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  uv = area.xy + area.zw * (0.5 + 0.5 * corner);
  gl_Position = vec4(corner, 0.0, 1.0);
}`;

/** Where the light comes from, in the axes of the picture. */
export const KEY = "const vec3 KEY = normalize(vec3(-0.45, 0.75, 0.6));";

function compile(gl, type, source) {
  const shader = gl.createShader(type);
  gl.shaderSource(shader, source);
  gl.compileShader(shader);
  if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS) && !gl.isContextLost()) {
    throw new Error(`shader: ${gl.getShaderInfoLog(shader)}\n${source}`);
  }
  return shader;
}

/** A program and the places of its uniforms by their names. */
export function createProgram(gl, vertex, fragment, attributes = []) {
  const program = gl.createProgram();
  gl.attachShader(program, compile(gl, gl.VERTEX_SHADER, vertex));
  gl.attachShader(program, compile(gl, gl.FRAGMENT_SHADER, fragment));
  attributes.forEach((name, index) => gl.bindAttribLocation(program, index, name));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    throw new Error(`program: ${gl.getProgramInfoLog(program)}`);
  }
  const uniforms = {};
  const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) ?? 0;
  for (let i = 0; i < count; i++) {
    const name = gl.getActiveUniform(program, i).name.replace("[0]", "");
    uniforms[name] = gl.getUniformLocation(program, name);
  }
  return { program, uniforms };
}

/** A program that computes every pixel of a part of the picture; `area` is that part in texture coordinates. */
export function createPass(gl, fragment) {
  return createProgram(gl, FULL_SCREEN, fragment);
}

/** Runs a pass. Textures are bound in the order of their names. */
export function runPass(gl, pass, area, textures, set = () => {}) {
  gl.useProgram(pass.program);
  gl.uniform4f(pass.uniforms.area, ...area);
  Object.entries(textures).forEach(([name, texture], unit) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.uniform1i(pass.uniforms[name], unit);
  });
  set(pass.uniforms);
  gl.drawArrays(gl.TRIANGLES, 0, 3);
}

function texture(gl, internal, width, height, filter) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texStorage2D(gl.TEXTURE_2D, 1, internal, width, height);
  for (const parameter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
    gl.texParameteri(gl.TEXTURE_2D, parameter, filter);
  }
  for (const parameter of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) {
    gl.texParameteri(gl.TEXTURE_2D, parameter, gl.CLAMP_TO_EDGE);
  }
  return made;
}

/** Something to draw into: a colour texture, with a depth texture if asked for. */
export class Target {
  constructor(gl, { format, filter, depth = false }) {
    Object.assign(this, { gl, format, filter, hasDepth: depth, width: 0, height: 0 });
  }

  /** Makes it of this size; what was in it is lost where the size changes. */
  resize(width, height) {
    if (width === this.width && height === this.height) return;
    const { gl } = this;
    this.free();
    this.color = texture(gl, this.format, width, height, this.filter);
    this.frame = gl.createFramebuffer();
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, this.color, 0);
    if (this.hasDepth) {
      this.depth = texture(gl, gl.DEPTH_COMPONENT24, width, height, gl.NEAREST);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, this.depth, 0);
    }
    Object.assign(this, { width, height });
  }

  bind() {
    this.gl.bindFramebuffer(this.gl.FRAMEBUFFER, this.frame);
  }

  /** Limits drawing to a part of it, given in texture coordinates. */
  limit([x, y, w, h]) {
    const { gl, width, height } = this;
    const left = Math.round(x * width);
    const right = Math.round((x + w) * width);
    gl.viewport(left, Math.round(y * height), right - left, Math.round(h * height));
    gl.scissor(left, Math.round(y * height), right - left, Math.round(h * height));
  }

  free() {
    const { gl } = this;
    gl.deleteTexture(this.color ?? null);
    gl.deleteTexture(this.depth ?? null);
    gl.deleteFramebuffer(this.frame ?? null);
  }
}
