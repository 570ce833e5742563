// What can be asked for: every control sends a command, and shows what the program says, which may be somebody else's wish.

import { COLORINGS } from "./colors.js";

const find = (id) => document.getElementById(id);

const SPEEDS = [0.125, 0.25, 0.5, 1, 2, 4, null];
const GRAVITY = [0, -9.81, 0];

const speedName = (factor) => (factor === null ? "max" : `${{ 0.125: "⅛", 0.25: "¼", 0.5: "½" }[factor] ?? factor}×`);

/** The ends of the sliders of gravity, metres per second squared; farther apart where a scene has more. */
const MOST_GRAVITY = 20;

/** Sliders of viscosity are finer where liquids are thin. */
const VISCOSITY_POWER = 3;

export class Controls {
  /** `app` has send, redraw, view, setColoring, setSurface, setTheme, resetView and the last state. */
  constructor(app) {
    this.app = app;
    this.held = new Set();
    const send = (command) => app.send(command);
    const click = (id, act) => find(id).addEventListener("click", act);
    click("play", () => this.togglePlay());
    click("forward", () => send({ do: "step", by: 1 }));
    click("back", () => send({ do: "step", by: -1 }));
    click("reset", () => send({ do: "reset" }));
    click("record", () => send({ do: "record", on: !app.state?.recording }));
    click("view-reset", () => app.resetView());
    click("gravity-reset", () => send({ do: "gravity", to: app.state?.scene_gravity ?? GRAVITY }));
    click("viscosity-reset", () => send({ do: "viscosity", to: null }));
    click("theme", () => this.nextTheme());
    click("help-open", () => find("help").showModal());
    click("settings-toggle", () => this.toggleSettings());
    find("speed").replaceChildren(...SPEEDS.map((factor) => new Option(speedName(factor), String(factor))));
    find("speed").addEventListener("change", ({ target }) => send({ do: "speed", factor: JSON.parse(target.value) }));
    find("coloring").addEventListener("change", ({ target }) => app.setColoring(target.value));
    find("walls").addEventListener("change", ({ target }) => this.setWalls(target.checked));
    find("follow").addEventListener("change", ({ target }) => this.setFollow(target.checked));
    find("compare").addEventListener("change", ({ target }) => send({ do: "compare", on: target.checked }));
    for (const panel of [0, 1]) {
      find(`solver-${panel}`).addEventListener("change", ({ target }) => send({ do: "solver", panel, name: target.value }));
    }
    for (const radio of document.getElementsByName("look")) {
      radio.addEventListener("change", () => app.setSurface(radio.value === "surface"));
    }
    for (const radio of document.getElementsByName("form")) {
      radio.addEventListener("change", () => document.body.classList.toggle("drops", this.form() !== null));
    }
    document.body.classList.add("drops");
    this.slider("size", (value) => `${value.toFixed(2)} m`, () => {});
    this.slider("scrub", (index) => `${index + 1} of ${Number(find("scrub").max) + 1}`, (index) => send({ do: "seek", index }));
    [0, 1, 2].forEach((axis) => {
      this.slider(`gravity-${axis}`, (value) => `${value.toFixed(2).replace("-", "−")} m/s²`, (value) => {
        const to = [...(app.state?.gravity ?? GRAVITY)];
        to[axis] = value;
        send({ do: "gravity", to });
      });
    });
    this.slider("viscosity", (place) => this.viscosityAt(place).toPrecision(2), (place) => {
      send({ do: "viscosity", to: this.viscosityAt(place) });
    });
    try {
      this.setTheme(localStorage.getItem("fluvia-scheme") ?? "");
    } catch {
      // Without storage the system decides, every time.
      this.setTheme("");
    }
    // The settings have room beside the scene, or are asked for.
    const hasRoom = matchMedia("(min-width: 821px)");
    hasRoom.addEventListener("change", () => this.setSettings(hasRoom.matches));
    this.setSettings(hasRoom.matches);
  }

  /** A slider that sends while it is drawn, and shows what the program says when it is let go. */
  slider(id, name, act) {
    const element = find(id);
    const output = find(`${id}-value`);
    element.show = (value, text = name(value)) => {
      if (output) output.textContent = text;
      element.setAttribute("aria-valuetext", text);
    };
    element.addEventListener("input", () => {
      element.show(Number(element.value));
      act(Number(element.value));
    });
    element.addEventListener("pointerdown", () => this.held.add(id));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture", "change", "blur"]) {
      element.addEventListener(end, () => this.held.delete(id));
    }
    element.show(Number(element.value));
  }

  /** Moves a slider to a value, as near as it comes; what is said is the value itself, or the text. */
  setSlider(id, value, text) {
    if (this.held.has(id)) return;
    find(id).value = value;
    find(id).show(value, text);
  }

  viscosityAt(place) {
    const { low, high } = this.range ?? { low: 0, high: 1 };
    return Number((low + (high - low) * place ** VISCOSITY_POWER).toPrecision(3));
  }

  /** What a click drops: "cube", "ball", or null. */
  form() {
    const chosen = [...document.getElementsByName("form")].find((radio) => radio.checked).value;
    return chosen === "none" ? null : chosen;
  }

  body() {
    const form = this.form();
    return form && { form, size: Number(find("size").value) };
  }

  togglePlay() {
    this.app.send({ do: this.app.state?.playing ? "pause" : "play" });
  }

  changeSpeed(by) {
    const next = Math.min(SPEEDS.length - 1, Math.max(0, SPEEDS.indexOf(this.speed) + by));
    // The program's word on it may come after the next press.
    this.speed = SPEEDS[next];
    this.app.send({ do: "speed", factor: this.speed });
  }

  nextColoring(by = 1) {
    const options = [...find("coloring").options].filter(({ disabled }) => !disabled).map(({ value }) => value);
    const next = options[(options.indexOf(this.app.view.coloring) + by) % options.length];
    find("coloring").value = next;
    this.app.setColoring(next);
  }

  setSurface(on) {
    const radio = [...document.getElementsByName("look")].find(({ value }) => (value === "surface") === on);
    if (radio.disabled) return;
    radio.checked = true;
    this.app.setSurface(on);
  }

  setWalls(on) {
    find("walls").checked = on;
    this.app.view.hasWalls = on;
    this.app.redraw();
  }

  setFollow(on) {
    find("follow").checked = on;
    this.app.view.camera.follows = on;
    this.app.redraw();
  }

  nextTheme() {
    const order = ["", "light", "dark"];
    const scheme = order[(order.indexOf(document.documentElement.dataset.scheme ?? "") + 1) % order.length];
    try {
      localStorage.setItem("fluvia-scheme", scheme);
    } catch {
      // It counts until the page is left.
    }
    this.setTheme(scheme);
  }

  setTheme(scheme) {
    const known = ["light", "dark"].includes(scheme) ? scheme : "";
    if (known) document.documentElement.dataset.scheme = known;
    else delete document.documentElement.dataset.scheme;
    find("theme").setAttribute("aria-label", `Colour scheme: ${known || "as the system"}`);
    find("theme").title = `Colour scheme: ${known || "as the system"}`;
    this.app.setTheme();
  }

  toggleSettings() {
    this.setSettings(!document.body.classList.contains("settings"));
  }

  setSettings(on) {
    document.body.classList.toggle("settings", on);
    find("settings-toggle").setAttribute("aria-expanded", String(on));
    this.app.redraw();
  }

  /** Shows the surface as something that this machine cannot do. */
  forbidSurface(why) {
    find("surface").disabled = true;
    find("surface").closest("label").title = why;
  }

  setState(state) {
    this.speed = state.speed;
    const isPlaying = state.playing;
    find("play").setAttribute("aria-label", isPlaying ? "Pause" : "Play");
    find("play").querySelector("use").setAttribute("href", isPlaying ? "#i-pause" : "#i-play");
    if (![...find("speed").options].some(({ value }) => value === String(state.speed))) {
      find("speed").append(new Option(`${state.speed}×`, String(state.speed)));
    }
    find("speed").value = String(state.speed);
    this.setColorings(state);
    if (state.stored) find("scrub").max = state.stored[2] - 1;
    if (state.mode !== "live") return;
    const most = Math.max(MOST_GRAVITY, ...[...state.gravity, ...state.scene_gravity].map((value) => Math.ceil(Math.abs(value))));
    state.gravity.forEach((value, axis) => {
      Object.assign(find(`gravity-${axis}`), { min: -most, max: most });
      this.setSlider(`gravity-${axis}`, value);
    });
    this.setViscosity(state);
    this.setSolvers(state);
    const { recording } = state;
    find("record").setAttribute("aria-pressed", String(recording !== null));
    find("record").querySelector("use").setAttribute("href", recording ? "#i-stop" : "#i-record");
    find("record").querySelector("span").textContent = recording ? "Stop" : "Record";
    find("record").title = recording ? `Recording to ${recording.directories.join(" and ")}` : "Record frames to disk";
  }

  setColorings(state) {
    const offered = COLORINGS.filter(({ key }) => !key || state[key]);
    const select = find("coloring");
    const names = offered.map(({ name }) => name).join();
    if (select.dataset.names !== names) {
      select.dataset.names = names;
      select.replaceChildren(...offered.map(({ name, label }) => new Option(label, name)));
      const { coloring } = this.app.view;
      select.value = offered.some(({ name }) => name === coloring) ? coloring : offered[0].name;
      if (select.value !== coloring) this.app.setColoring(select.value);
    }
  }

  setViscosity({ viscosity, viscosities, panels }) {
    this.range = viscosities;
    const slider = find("viscosity");
    slider.disabled = !viscosities;
    find("viscosity-hint").hidden = viscosities !== null;
    const why = panels.some(({ solver }) => solver === "pbf") ? "PBF has no viscosity" : "Made for one viscosity";
    find("viscosity-hint").textContent = `${why}; DFSPH and the network viscosity take others.`;
    const { low, high } = viscosities ?? { low: 0, high: 1 };
    const part = Math.min(1, Math.max(0, ((viscosity ?? low) - low) / (high - low)));
    this.setSlider("viscosity", part ** (1 / VISCOSITY_POWER), viscosity === null ? "several" : String(Number(viscosity.toPrecision(3))));
  }

  setSolvers(state) {
    const isComparing = state.panels.length > 1;
    find("compare").checked = isComparing;
    find("solver-1-row").hidden = !isComparing;
    find("solver-0-label").textContent = isComparing ? "First" : "Moved by";
    const offers = JSON.stringify(state.solvers);
    const refused = state.solvers.filter((offer) => offer.refused !== null);
    const hint = find("solver-hint");
    hint.hidden = refused.length === 0;
    if (hint.dataset.offers !== offers) {
      // Why, where a finger or a screen reader finds it too.
      hint.dataset.offers = offers;
      hint.replaceChildren(
        ...refused.map((offer) => {
          const line = document.createElement("p");
          line.textContent = `Not ${offer.label}: ${offer.refused}`;
          return line;
        }),
      );
    }
    for (const panel of [0, 1]) {
      const select = find(`solver-${panel}`);
      if (select.dataset.offers !== offers) {
        select.dataset.offers = offers;
        select.replaceChildren(
          ...state.solvers.map(({ name, label, refused }) => {
            const option = new Option(label, name);
            option.disabled = refused !== null;
            return option;
          }),
        );
      }
      if (state.panels[panel]) select.value = state.panels[panel].solver;
    }
  }
}
