// What the page says: numbers, names, the legend, what went wrong.

import { BODIES, COLORINGS, ramp, scaleOf } from "./colors.js";

const find = (id) => document.getElementById(id);

/** Milliseconds that a message stays. */
const SHOWN = 5000;

const grouped = (number) => number.toLocaleString("en").replaceAll(",", "\u2009");

export class Readouts {
  constructor() {
    this.begin();
  }

  /** With a new connection: what was said before is not for this page. */
  begin() {
    this.messageNumber = null;
    this.errors = "";
  }

  /** Numbers of a frame and of the connection. */
  show(frame, connection) {
    const counts = frame.panels.map(({ count }) => count);
    const same = counts.every((count) => count === counts[0]);
    find("particles").textContent = same ? grouped(counts[0]) : counts.map(grouped).join(" · ");
    find("step").textContent = frame.panels.map(({ ms }) => (ms > 0 ? ms.toFixed(1) : "–")).join(" · ");
    find("time").textContent = frame.time.toFixed(2);
    find("frame-number").textContent = `frame ${frame.number}`;
    find("received").textContent = Math.round(connection.rate());
    find("dropped").textContent = grouped(connection.dropped);
  }

  /** The names of what is shown. */
  setState(state) {
    document.title = `${state.title} · Fluvia`;
    find("title").textContent = state.title;
    find("title").title = state.title;
    document.body.classList.toggle("live", state.mode === "live");
    document.body.classList.toggle("playback", state.mode === "playback");
    find("step-item").hidden = state.mode !== "live";
    const kind = state.mode === "live" ? "live" : "stored";
    const failed = state.panels.some(({ error }) => error);
    const errors = state.panels.map(({ label, error }) => (error ? `${label}: ${error}` : "")).join(" ").trim();
    if (errors && errors !== this.errors) this.say(errors, true);
    this.errors = errors;
    this.setChip(state.playing ? kind : `${kind}, paused`, failed ? "error" : state.playing ? "running" : "");
    const labels = state.panels.map(({ label, error, warning }) => {
      const element = document.createElement("div");
      const name = document.createElement("div");
      name.className = "name";
      name.textContent = label;
      element.append(name);
      const add = (kind, said) => {
        const text = document.createElement("p");
        text.className = kind;
        text.textContent = said;
        element.append(text);
      };
      if (error) add("error", `${label} stands still: ${error}`);
      if (warning) add("warning", warning);
      return element;
    });
    find("labels").replaceChildren(...labels);
    const { message } = state;
    if (message && this.messageNumber !== null && message.number > this.messageNumber) this.say(message.text, message.is_error);
    this.messageNumber = message?.number ?? 0;
  }

  setChip(text, tone) {
    find("mode").textContent = text;
    find("mode").dataset.tone = tone;
  }

  say(text, isError = false) {
    const toast = find("toast");
    toast.textContent = text;
    toast.classList.toggle("error", isError);
    toast.classList.add("shown");
    clearTimeout(this.hiding);
    this.hiding = setTimeout(() => toast.classList.remove("shown"), SHOWN);
  }

  /** Something in place of the scene. */
  notice(text) {
    find("notice").hidden = text === null;
    find("notice").textContent = text ?? "";
  }

  /** What the colours mean. */
  setLegend(coloring, low, high, bodies) {
    const scale = scaleOf(coloring, low, high);
    const isBodies = coloring === "body" && bodies > 1;
    find("legend").hidden = !scale && !isBodies;
    const { label } = COLORINGS.find(({ name }) => name === coloring);
    find("legend-title").textContent = scale ? `${label}, ${scale.unit}` : label;
    const bar = find("legend-bar");
    const css = ([r, g, b]) => `rgb(${[r, g, b].map((x) => Math.round(255 * x)).join(" ")})`;
    const tick = ({ place, text }) => {
      const element = document.createElement("span");
      element.textContent = text;
      element.style.left = `${100 * place}%`;
      return element;
    };
    if (scale) {
      const stops = Array.from({ length: 13 }, (_, k) => css(ramp(k / 12)));
      bar.style.background = `linear-gradient(90deg, ${stops.join(", ")})`;
      bar.replaceChildren();
      find("legend-ticks").replaceChildren(...scale.ticks.map(tick));
    } else if (isBodies) {
      bar.style.background = "none";
      const all = Array.from({ length: Math.min(bodies, BODIES.length) }, (_, k) => k);
      bar.replaceChildren(
        ...all.map((k) => {
          const part = document.createElement("span");
          part.style.background = css(BODIES[k]);
          return part;
        }),
      );
      find("legend-ticks").replaceChildren(...all.map((k) => tick({ place: (k + 0.5) / all.length, text: String(k + 1) })));
    }
  }
}
