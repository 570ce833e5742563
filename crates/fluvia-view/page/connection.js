// The connection to the program: what comes, what goes, and how much of it.

import { decode } from "./protocol.js";

/** Seconds that rates are means over. */
const WINDOW = 1;

/** Milliseconds before the next try after the connection is gone, doubled each time. */
const FIRST_WAIT = 250;
const LONGEST_WAIT = 4000;

export class Connection {
  /** `on` has functions state, frame, walls, open, close. */
  constructor(on) {
    this.on = on;
    this.wait = FIRST_WAIT;
    this.received = 0;
    this.dropped = 0;
    this.bytesPerParticle = 0;
    this.arrivals = [];
    this.connect();
  }

  connect() {
    const socket = new WebSocket(`ws://${location.host}/socket`);
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    this.sequence = null;
    socket.onopen = () => {
      this.wait = FIRST_WAIT;
      this.on.open();
    };
    socket.onmessage = ({ data }) => this.take(data);
    socket.onclose = ({ reason }) => {
      this.arrivals.length = 0;
      this.on.close(reason);
      setTimeout(() => this.connect(), this.wait);
      this.wait = Math.min(2 * this.wait, LONGEST_WAIT);
    };
  }

  take(data) {
    if (typeof data === "string") return this.on.state(JSON.parse(data));
    const message = decode(data);
    if (message.kind === "walls") return this.on.walls(message);
    // What was published in between was never sent.
    if (this.sequence !== null) this.dropped += Math.max(0, message.sequence - this.sequence - 1);
    this.sequence = message.sequence;
    this.received++;
    this.arrivals.push(performance.now());
    this.rate();
    const particles = message.panels.reduce((sum, panel) => sum + panel.count, 0);
    if (particles > 0) this.bytesPerParticle = message.bytes / particles;
    this.on.frame(message);
  }

  /** Frames a second; forgets what is older. */
  rate() {
    const since = performance.now() - 1000 * WINDOW;
    while (this.arrivals.length && this.arrivals[0] < since) this.arrivals.shift();
    return this.arrivals.length / WINDOW;
  }

  /** Sends a command; it is lost where there is no connection. */
  send(command) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(command));
  }

  /** Says that there is room for another frame. */
  acknowledge(frame) {
    this.send({ do: "acknowledge", sequence: frame.sequence });
  }
}
