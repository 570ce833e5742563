// Handles to move emitters by: buttons over the scene, to be dragged or moved with the arrow keys.

import { project } from "./camera.js";

/** What an arrow key moves an emitter by, metres. */
const STEP = 0.05;

export class Emitters {
  /** `move` is called with the index of an emitter and where it is to be. */
  constructor(container, move) {
    Object.assign(this, { container, move, buttons: [], emitters: [], dragged: null });
  }

  set(emitters) {
    this.emitters = emitters;
    while (this.buttons.length > emitters.length) this.buttons.pop().remove();
    while (this.buttons.length < emitters.length) this.buttons.push(this.button(this.buttons.length));
    emitters.forEach(({ label, active }, k) => {
      const name = `Emitter ${k + 1} (${label}): drag or use the arrow keys to move it`;
      this.buttons[k].setAttribute("aria-label", name);
      this.buttons[k].title = active ? "Drag to move the emitter" : "This emitter has given all it had";
      this.buttons[k].toggleAttribute("data-idle", !active);
    });
  }

  button(index) {
    const button = document.createElement("button");
    button.type = "button";
    const icon = document.querySelector("#tools svg").cloneNode(true);
    icon.querySelector("use").setAttribute("href", "#i-move");
    button.append(icon);
    button.addEventListener("pointerdown", (event) => {
      button.setPointerCapture(event.pointerId);
      this.dragged = { index, x: event.clientX, y: event.clientY, at: [...this.emitters[index].position] };
    });
    button.addEventListener("pointermove", (event) => {
      if (this.dragged?.index !== index || !this.look) return;
      const { x, y, at } = this.dragged;
      const { distance } = project(this.look, at);
      const metres = (2 * distance) / (this.look.f * this.height);
      this.shift(index, at, metres * (event.clientX - x), -metres * (event.clientY - y));
    });
    for (const end of ["pointerup", "pointercancel"]) {
      button.addEventListener(end, () => {
        this.dragged = null;
        this.place(this.look, this.width, this.height);
      });
    }
    button.addEventListener("keydown", (event) => {
      const sides = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
      if (!(event.key in sides) || !this.look) return;
      event.preventDefault();
      event.stopPropagation();
      const [right, above] = sides[event.key];
      this.shift(index, this.emitters[index].position, STEP * right, STEP * above);
    });
    this.container.append(button);
    return button;
  }

  /** Moves an emitter in the plane of the picture, metres. */
  shift(index, from, right, above) {
    const to = from.map((x, a) => x + right * this.look.right[a] + above * this.look.above[a]);
    if (this.dragged) this.dragged.to = to;
    this.move(index, to);
    this.place(this.look, this.width, this.height);
  }

  /** Puts the handles where the emitters are in a picture of this size, pixels. */
  place(look, width, height) {
    Object.assign(this, { look, width, height });
    if (!look) return;
    this.emitters.forEach(({ position }, k) => {
      const at = this.dragged?.index === k && this.dragged.to ? this.dragged.to : position;
      const { x, y, distance } = project(look, at);
      this.buttons[k].hidden = distance < 0 || Math.abs(x) > 1 || Math.abs(y) > 1;
      const [left, top] = [(0.5 + 0.5 * x) * width, (0.5 - 0.5 * y) * height];
      this.buttons[k].style.transform = `translate(${left.toFixed(1)}px, ${top.toFixed(1)}px)`;
    });
  }
}
