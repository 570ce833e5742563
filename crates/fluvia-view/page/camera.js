// A camera that looks at a point from around it; matrices as WebGL takes them, column after column.

const FIELD = (35 * Math.PI) / 180;
const STEEPEST = (89 * Math.PI) / 180;
const START = { yaw: (28 * Math.PI) / 180, pitch: (17 * Math.PI) / 180 };

/** The part of the width that what is fitted takes; of the height what is left by the names above and time below, pixels. */
const FILLED = 0.9;
const ABOVE = 84;
const BELOW = 84;
const LEAST_FILLED = 0.45;

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const along = (a, s, b) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const unit = (a) => {
  const length = Math.hypot(...a) || 1;
  return a.map((x) => x / length);
};

export class Camera {
  constructor() {
    this.low = [-1, 0, -1];
    this.high = [1, 1, 1];
    this.setUp([0, 1, 0]);
    this.follows = false;
    this.isFitted = true;
    this.home();
  }

  /** Which axis points up; the one nearest to the vector. */
  setUp(vector) {
    const size = vector.map(Math.abs);
    const axis = size.indexOf(Math.max(...size));
    this.up = [0, 0, 0];
    this.up[axis] = Math.sign(vector[axis]) || 1;
    const east = [1, 0, 0];
    this.east = axis === 0 ? [0, 0, 1] : east;
    this.north = cross(this.east, this.up);
  }

  /** What to look at: a box. */
  setBox(low, high) {
    Object.assign(this, { low, high });
    if (this.isFitted) this.home();
  }

  /** Back to where everything is seen. */
  home() {
    Object.assign(this, START, { isFitted: true });
    this.target = this.low.map((x, a) => 0.5 * (x + this.high[a]));
    this.distance = null;
  }

  /** The axes of the picture: right, upwards, towards the eye. */
  axes() {
    const { yaw, pitch } = this;
    const flat = [0, 1, 2].map((a) => Math.sin(yaw) * this.east[a] - Math.cos(yaw) * this.north[a]);
    const back = [0, 1, 2].map((a) => Math.cos(pitch) * flat[a] + Math.sin(pitch) * this.up[a]);
    const right = unit(cross(this.up, back));
    return { right, above: cross(back, right), back };
  }

  /** The distance from which the box fills a picture of this shape, so many pixels of the page high. */
  fitDistance(aspect, height) {
    const { right, above, back } = this.axes();
    const tangent = Math.tan(FIELD / 2);
    const filled = Math.max(LEAST_FILLED, 1 - (ABOVE + BELOW) / height);
    let distance = 0.1;
    for (let k = 0; k < 8; k++) {
      const corner = [0, 1, 2].map((a) => (k & (1 << a) ? this.high[a] : this.low[a]) - this.target[a]);
      const size = Math.max(Math.abs(dot(corner, above)) / filled, Math.abs(dot(corner, right)) / aspect / FILLED);
      distance = Math.max(distance, size / tangent + dot(corner, back));
    }
    return distance;
  }

  /** Matrices for a picture of this shape, so many pixels of the page high. */
  look(aspect, height) {
    if (this.isFitted || this.distance === null) this.distance = this.fitDistance(aspect, height);
    const { right, above, back } = this.axes();
    const eye = along(this.target, this.distance, back);
    const size = Math.hypot(...this.high.map((x, a) => x - this.low[a])) || 1;
    const near = Math.max(this.distance - 2 * size, 0.02 * this.distance);
    const far = this.distance + 4 * size;
    const f = 1 / Math.tan(FIELD / 2);
    const view = [0, 1, 2].flatMap((a) => [right[a], above[a], back[a], 0]);
    view.push(-dot(right, eye), -dot(above, eye), -dot(back, eye), 1);
    const depth = 1 / (near - far);
    const projection = [f / aspect, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) * depth, -1, 0, 0, 2 * far * near * depth, 0];
    return { view, projection, eye, right, above, back, near, far, f, aspect };
  }

  turn(dx, dy) {
    this.yaw -= dx;
    this.pitch = Math.min(STEEPEST, Math.max(-STEEPEST, this.pitch + dy));
    this.isFitted = false;
  }

  /** Moves what is looked at; in parts of the height of the picture. */
  pan(dx, dy) {
    const { right, above } = this.axes();
    const height = 2 * Math.tan(FIELD / 2) * (this.distance ?? 1);
    this.target = along(along(this.target, -dx * height, right), dy * height, above);
    this.isFitted = false;
    this.follows = false;
  }

  zoom(factor) {
    const size = Math.hypot(...this.high.map((x, a) => x - this.low[a])) || 1;
    this.distance = Math.min(20 * size, Math.max(0.02 * size, (this.distance ?? size) * factor));
    this.isFitted = false;
  }

  /** Goes after a point, a part of the way. */
  follow(point, part) {
    this.target = this.target.map((x, a) => x + part * (point[a] - x));
    this.isFitted = false;
  }
}

/** The ray through a point of the picture, -1 to 1 from left to right and from below. */
export function rayThrough(look, x, y) {
  const sideways = (x * look.aspect) / look.f;
  const direction = [0, 1, 2].map((a) => sideways * look.right[a] + (y / look.f) * look.above[a] - look.back[a]);
  return { origin: look.eye, direction: unit(direction) };
}

/** Where a point is in the picture, and how far it is; behind the eye the distance is negative. */
export function project(look, point) {
  const offset = point.map((x, a) => x - look.eye[a]);
  const distance = -dot(offset, look.back);
  const scale = look.f / distance;
  return { x: (dot(offset, look.right) * scale) / look.aspect, y: dot(offset, look.above) * scale, distance };
}
