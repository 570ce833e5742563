// What comes over the wire as bytes, see docs/formats.md. Little endian, as every machine with a browser is.

const FRAME = 0x46564c46; // "FLVF"
const WALLS = 0x57564c46; // "FLVW"

/** Reads a binary message: { kind: "frame" | "walls", ... }. */
export function decode(buffer) {
  const magic = new DataView(buffer).getUint32(0, true);
  if (magic === FRAME) return decodeFrame(buffer);
  if (magic === WALLS) return decodeWalls(buffer);
  throw new Error(`a message that begins with ${magic.toString(16)}`);
}

function decodeFrame(buffer) {
  const view = new DataView(buffer);
  const panels = [];
  const count = view.getUint32(12, true);
  let at = 32 + 48 * count;
  for (let k = 0; k < count; k++) {
    const head = new Float32Array(buffer, 32 + 48 * k + 4, 11);
    const particles = view.getUint32(32 + 48 * k, true);
    panels.push({
      count: particles,
      ms: head[0],
      low: head.slice(1, 4),
      extent: [0, 1, 2].map((a) => head[4 + a] - head[1 + a]),
      highestSpeed: head[7],
      mean: head.slice(8, 11),
      rows: new Uint16Array(buffer, at, 4 * particles),
      small: new Uint8Array(buffer, at + 8 * particles, 2 * particles),
    });
    at += 8 * particles + 8 * Math.ceil(particles / 4);
  }
  if (at !== buffer.byteLength) throw new Error(`${buffer.byteLength} bytes, expected ${at}`);
  return {
    kind: "frame",
    sequence: view.getUint32(4, true),
    number: view.getUint32(8, true),
    time: view.getFloat64(16, true),
    hasDensities: (view.getUint32(24, true) & 1) !== 0,
    index: view.getUint32(28, true),
    bytes: buffer.byteLength,
    panels,
  };
}

/** The positions of a panel, metres, and its speeds, metres per second, as numbers: x, y, z, speed a particle. */
export function decodePanel(panel) {
  const values = new Float32Array(4 * panel.count);
  const base = [...panel.low, 0];
  const step = [...panel.extent, panel.highestSpeed].map((extent) => extent / 65535);
  for (let i = 0; i < values.length; i++) values[i] = base[i & 3] + step[i & 3] * panel.rows[i];
  return values;
}

function decodeWalls(buffer) {
  const [vertices, triangles, points] = new Uint32Array(buffer, 4, 3);
  const box = new Float32Array(buffer, 16, 6);
  let at = 40;
  const take = (Kind, count) => {
    const values = new Kind(buffer, at, count);
    at += 4 * count;
    return values;
  };
  return {
    kind: "walls",
    low: [...box.slice(0, 3)],
    high: [...box.slice(3, 6)],
    vertices: take(Float32Array, 3 * vertices),
    triangles: take(Uint32Array, 3 * triangles),
    points: take(Float32Array, 6 * points),
  };
}
