// Hands on the scene: mouse, touch and pen turn, move and zoom; a short press is a tap; keys do the same and more.

/** A press that moves less, in pixels, of a finger and of others, and is shorter, in milliseconds, is a tap. */
const TAP_PIXELS = { touch: 12, others: 5 };
const TAP_TIME = 500;

/** Radians a pixel; what a key turns; what a step of the wheel and a key zoom. */
const TURN = 0.0065;
const KEY_TURN = 0.12;
const WHEEL_ZOOM = 0.0015;
const KEY_ZOOM = 1.15;
const KEY_PAN = 0.05;

export class Input {
  /** `on` has functions changed (of the camera) and tap (x, y in pixels of the page). */
  constructor(canvas, camera, on) {
    Object.assign(this, { canvas, camera, on });
    this.pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("pointercancel", (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  down(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
    // With the control key it is the other button on some systems.
    const isPan = event.button !== 0 || event.shiftKey || event.ctrlKey;
    this.press = { x: event.clientX, y: event.clientY, time: event.timeStamp, isTap: this.pointers.size === 1 && !isPan, isPan };
  }

  move(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = { x: event.clientX, y: event.clientY };
    const most = TAP_PIXELS[event.pointerType] ?? TAP_PIXELS.others;
    if (Math.hypot(now.x - this.press.x, now.y - this.press.y) > most) this.press.isTap = false;
    const height = this.canvas.clientHeight;
    if (this.pointers.size === 2) {
      const [other] = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, pointer]) => pointer);
      const gap = (pointer) => Math.max(1, Math.hypot(pointer.x - other.x, pointer.y - other.y));
      this.camera.zoom(gap(before) / gap(now));
      // Both fingers move the middle between them, each by half.
      this.camera.pan((now.x - before.x) / 2 / height, (now.y - before.y) / 2 / height);
      this.press.isTap = false;
      this.on.changed();
    } else if (!this.press.isTap) {
      const [dx, dy] = [now.x - before.x, now.y - before.y];
      if (this.press.isPan) this.camera.pan(dx / height, dy / height);
      else this.camera.turn(TURN * dx, TURN * dy);
      this.on.changed();
    }
    this.pointers.set(event.pointerId, now);
  }

  up(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    const { isTap, time } = this.press;
    if (isTap && event.timeStamp - time < TAP_TIME) this.on.tap(event.clientX, event.clientY);
  }

  wheel(event) {
    event.preventDefault();
    const lines = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 16 : 1;
    // A pinch on a touchpad comes as a wheel with small steps.
    const pinch = event.ctrlKey ? 6 : 1;
    this.camera.zoom(Math.exp(WHEEL_ZOOM * lines * pinch * event.deltaY));
    this.on.changed();
  }

  /** The keys that turn, move and zoom. Whether it was one. */
  key(event) {
    const sides = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (event.key in sides) {
      const [x, y] = sides[event.key];
      if (event.shiftKey) this.camera.pan(-KEY_PAN * x, -KEY_PAN * y);
      else this.camera.turn(-KEY_TURN * x, -KEY_TURN * y);
    } else if (event.key === "+" || event.key === "=") this.camera.zoom(1 / KEY_ZOOM);
    else if (event.key === "-") this.camera.zoom(KEY_ZOOM);
    else return false;
    this.on.changed();
    return true;
  }
}
