// The page: what comes from the program goes to the picture and the read-outs, what hands do goes back.
//
// With ?draw=off nothing is drawn; every frame is decoded as it comes, to measure how many arrive. With ?fine pictures stay as
// fine as the screen is, however long they take.

import { Camera, dot, rayThrough } from "./camera.js";
import { Connection } from "./connection.js";
import { Controls } from "./controls.js";
import { Emitters } from "./emitters.js";
import { Input } from "./input.js";
import { decodePanel } from "./protocol.js";
import { Readouts } from "./readouts.js";
import { Renderer } from "./renderer.js";

const options = new URLSearchParams(location.search);
const draws = options.get("draw") !== "off";

/** Milliseconds between new numbers in the read-outs. */
const READ = 150;

/** The part of the way to the fluid that a camera that follows goes with every frame. */
const FOLLOW = 0.12;

/** The finest picture: pixels of the screen a pixel of the page. */
const FINEST = 2;

const canvas = document.getElementById("canvas");

const app = {
  state: null,
  frame: null,
  view: { camera: new Camera(), radius: 0.025, up: [0, 1, 0], coloring: "speed", isSurface: false, hasWalls: true },
  renderer: null,
  isDirty: true,
  lastRead: 0,
  lastLoop: 0,
  hasDrawn: false,

  send: (command) => app.connection.send(command),

  redraw() {
    app.isDirty = true;
  },

  setColoring(name) {
    const wanted = app.view.coloring === "density";
    app.view.coloring = name;
    if ((name === "density") !== wanted) app.send({ do: "density", on: name === "density" });
    app.setLegend();
    app.redraw();
  },

  setSurface(on) {
    app.view.isSurface = on;
    app.redraw();
  },

  setTheme() {
    app.renderer?.readTheme();
    app.redraw();
  },

  resetView() {
    app.controls.setFollow(false);
    app.view.camera.home();
    app.redraw();
  },

  setLegend() {
    const { low = [0, 0, 0], high = [0, 1, 0] } = app.walls ?? {};
    const ends = [low, high].map((x) => dot(x, app.view.up));
    app.readouts.setLegend(app.view.coloring, Math.min(...ends), Math.max(...ends), app.bodies ?? 0);
  },

  /** Gives the picture the size of the window. What it shows is gone then: only where it is drawn at once. */
  fit() {
    const scale = Math.min(FINEST, devicePixelRatio || 1);
    const [width, height] = [canvas.clientWidth, canvas.clientHeight].map((size) => Math.max(1, Math.round(size * scale)));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
  },

  /** Drops fluid at a place of the page. */
  drop(x, y) {
    const body = app.controls.body();
    if (app.state?.mode !== "live" || !body || !app.look) return;
    const box = canvas.getBoundingClientRect();
    const at = [(x - box.left) / box.width, 1 - (y - box.top) / box.height];
    // Where in the panel, from 0 to 1.
    const inside = ([left, low, width, height]) => [(at[0] - left) / width, (at[1] - low) / height];
    const panel = app.areas.findIndex((area) => inside(area).every((part) => part >= 0 && part <= 1));
    if (panel < 0) return;
    const ray = rayThrough(app.look, ...inside(app.areas[panel]).map((part) => 2 * part - 1));
    app.send({ do: "drop", panel, ...ray, body });
    const mark = document.createElement("span");
    Object.assign(mark.style, { left: `${x - box.left}px`, top: `${y - box.top}px` });
    mark.addEventListener("animationend", () => mark.remove());
    document.getElementById("marks").append(mark);
  },
};

app.readouts = new Readouts();
app.emitters = new Emitters(document.getElementById("handles"), (index, to) => app.send({ do: "move-emitter", index, to }));
app.controls = new Controls(app);
app.input = new Input(canvas, app.view.camera, { changed: () => app.cameraChanged(), tap: (x, y) => app.drop(x, y) });

app.cameraChanged = () => {
  if (!app.view.camera.follows) document.getElementById("follow").checked = false;
  app.redraw();
};

function startRenderer() {
  try {
    app.renderer = new Renderer(canvas, !options.has("fine"));
  } catch (error) {
    app.readouts.notice(`${error.message}: the fluid cannot be drawn here.`);
    return;
  }
  if (app.renderer.missing) app.controls.forbidSurface(app.renderer.missing);
  if (app.walls) app.renderer.setWalls(app.walls);
  if (app.frame) app.renderer.setFrame(app.frame);
  app.readouts.notice(null);
  app.redraw();
}

if (draws) startRenderer();
else app.readouts.notice("Drawing is off: frames are received and decoded.");
canvas.addEventListener("webglcontextlost", (event) => {
  // The browser tries to give it back, which it does not for pages that let it be.
  event.preventDefault();
  app.renderer = null;
  app.readouts.notice("The browser has lost its graphics; the fluid is drawn again as soon as they are back.");
});
canvas.addEventListener("webglcontextrestored", startRenderer);

app.connection = new Connection({
  open() {
    app.readouts.begin();
    if (app.view.coloring === "density") app.send({ do: "density", on: true });
  },
  close(reason) {
    app.readouts.setChip("not connected", "error");
    if (reason) app.readouts.say(reason, true);
  },
  state(state) {
    const isFirst = app.state === null || app.state.title !== state.title;
    app.state = state;
    app.view.radius = state.particle_radius;
    if (isFirst) {
      // Gravity may be turned later; the floor stays below.
      app.view.camera.setUp(state.up);
      app.view.up = app.view.camera.up;
    }
    app.readouts.setState(state);
    app.controls.setState(state);
    app.emitters.set(state.emitters);
    app.setLegend();
    app.redraw();
  },
  walls(walls) {
    app.walls = walls;
    app.view.camera.setBox(walls.low, walls.high);
    app.renderer?.setWalls(walls);
    app.setLegend();
    app.redraw();
  },
  frame(frame) {
    app.frame = frame;
    if (!draws) {
      // What a picture would need of it.
      app.decoded = frame.panels.map(decodePanel);
      app.connection.acknowledge(frame);
      return;
    }
    app.isNew = true;
    app.redraw();
  },
});

function countBodies(panels) {
  let last = -1;
  for (const { small } of panels) {
    for (let k = 1; k < small.length; k += 2) if (small[k] > last) last = small[k];
  }
  return last + 1;
}

function read(now) {
  if (!app.frame || now - app.lastRead < READ) return;
  app.lastRead = now;
  app.readouts.show(app.frame, app.connection);
  if (app.state?.stored) app.controls.setSlider("scrub", app.frame.index, `frame ${app.frame.number}`);
  const bodies = app.view.coloring === "body" ? countBodies(app.frame.panels) : 0;
  if (bodies !== (app.bodies ?? 0)) {
    app.bodies = bodies;
    app.setLegend();
  }
}

function loop(now) {
  requestAnimationFrame(loop);
  read(now);
  // After a picture the next call comes late where pictures take long.
  if (app.hasDrawn) app.renderer?.adapt(now - app.lastLoop);
  Object.assign(app, { lastLoop: now, hasDrawn: false });
  const { renderer, frame, view } = app;
  // Another screen, or another size of everything: the window need not have changed.
  if (app.ratio !== devicePixelRatio) app.redraw();
  app.ratio = devicePixelRatio;
  if (!renderer) {
    // Nothing holds up the frames of a page that cannot draw.
    if (draws && app.isNew) app.connection.acknowledge(frame);
    app.isNew = false;
    return;
  }
  if (!app.isDirty) return;
  app.isDirty = false;
  if (app.isNew) {
    renderer.setFrame(frame);
    if (view.camera.follows && frame.panels[0].count > 0) view.camera.follow(frame.panels[0].mean, FOLLOW);
    app.connection.acknowledge(frame);
    app.isNew = false;
  }
  app.hasDrawn = true;
  app.fit();
  Object.assign(app, renderer.draw(view));
  const [, , across, upwards] = app.areas[0];
  document.getElementById("labels").classList.toggle("stacked", upwards < 1);
  app.emitters.place(app.look, canvas.clientWidth * across, canvas.clientHeight * upwards);
}
requestAnimationFrame(loop);

new ResizeObserver(() => app.redraw()).observe(canvas);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => app.setTheme());

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || document.getElementById("help").open) return;
  // Arrows belong to what is focused, unless that is the scene or nothing.
  const isScene = event.target === canvas || event.target === document.body;
  if (isScene && app.input.key(event)) return event.preventDefault();
  // Letters choose in a list.
  if (event.target.matches("select")) return;
  const { controls, view } = app;
  const isStored = app.state?.mode === "playback";
  const center = () => {
    const box = canvas.getBoundingClientRect();
    app.drop(box.left + box.width / 2, box.top + box.height / 2);
  };
  const keys = {
    " ": () => controls.togglePlay(),
    ".": () => app.send({ do: "step", by: 1 }),
    ",": () => isStored && app.send({ do: "step", by: -1 }),
    "[": () => controls.changeSpeed(-1),
    "]": () => controls.changeSpeed(1),
    r: () => app.send({ do: "reset" }),
    v: () => app.resetView(),
    f: () => controls.setFollow(!view.camera.follows),
    s: () => controls.setSurface(!view.isSurface),
    c: () => controls.nextColoring(),
    w: () => controls.setWalls(!view.hasWalls),
    d: center,
    b: () => !isStored && app.send({ do: "compare", on: app.state?.panels.length === 1 }),
    p: () => controls.toggleSettings(),
    "?": () => document.getElementById("help").showModal(),
  };
  const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  // What has the focus takes the space bar itself.
  if (!act || (event.key === " " && event.target.matches("button, input:not([type=range])"))) return;
  event.preventDefault();
  // A key that is held goes through speeds and stored frames. What takes time or adds fluid is asked for once.
  const goesOn = "[]".includes(event.key) || (isStored && ",.".includes(event.key));
  if (!event.repeat || goesOn) act();
});
