// Colours: scales that are even to the eye, what they show, and the themes of the scene.

/** Oklab (Ottosson 2020) to sRGB, 0 to 1. */
function fromOklab(l, a, b) {
  const long = (l + 0.3963377774 * a + 0.2158037573 * b) ** 3;
  const medium = (l - 0.1055613458 * a - 0.0638541728 * b) ** 3;
  const short = (l - 0.0894841775 * a - 1.291485548 * b) ** 3;
  const linear = [
    4.0767416621 * long - 3.3077115913 * medium + 0.2309699292 * short,
    -1.2684380046 * long + 2.6097574011 * medium - 0.3413193965 * short,
    -0.0041960863 * long - 0.7034186147 * medium + 1.707614701 * short,
  ];
  return linear.map((x) => {
    const inside = Math.min(1, Math.max(0, x));
    return inside <= 0.0031308 ? 12.92 * inside : 1.055 * inside ** (1 / 2.4) - 0.055;
  });
}

/** From blue to pale yellow in equal steps of lightness and hue, as in the pictures of `fluvia render`. */
export function ramp(place) {
  const hue = ((262 + (105 - 262) * place) * Math.PI) / 180;
  return fromOklab(0.52 + (0.94 - 0.52) * place, 0.125 * Math.cos(hue), 0.125 * Math.sin(hue));
}

/** The colours of bodies; they repeat after the last. */
export const BODIES = [
  [74, 158, 232],
  [243, 220, 112],
  [52, 186, 150],
  [236, 142, 196],
  [140, 116, 226],
  [168, 214, 92],
  [204, 214, 228],
  [86, 196, 222],
].map((color) => color.map((x) => x / 255));

/** Liquid without anything to show. */
export const WATER = [0.24, 0.56, 0.86];

/** Steps of the table of a scale. */
export const STEPS = 256;

/** Speeds end here, metres per second: as in the pictures of `fluvia render`. */
const HIGHEST_SPEED = 4;

/** Densities over that at rest, from loose spray to what no liquid reaches. */
const DENSITIES = [0.6, 1.2];

/** What colours can show. The number is that of the shader. */
export const COLORINGS = [
  { name: "speed", label: "Speed", number: 0, key: "has_speeds" },
  { name: "height", label: "Height", number: 1 },
  { name: "density", label: "Density", number: 2 },
  { name: "body", label: "Body", number: 3, key: "has_bodies" },
  { name: "plain", label: "Plain", number: 4 },
];

/** The ends of a scale and its ticks, for the shader and the legend; null where there is no scale. */
export function scaleOf(name, low, high) {
  if (name === "speed") {
    const at = [0, 0.25, 1, HIGHEST_SPEED];
    const ticks = at.map((value) => ({ place: Math.sqrt(value / HIGHEST_SPEED), text: String(value) }));
    ticks[ticks.length - 1].text += "+";
    return { low: 0, high: HIGHEST_SPEED, curve: 0.5, unit: "m/s", ticks };
  }
  if (name === "height") {
    const ticks = [0, 0.5, 1].map((place) => ({ place, text: (low + (high - low) * place).toFixed(2) }));
    return { low, high, curve: 1, unit: "m", ticks };
  }
  if (name === "density") {
    const [first, last] = DENSITIES;
    const ticks = [0.6, 0.8, 1, 1.2].map((value) => ({ place: (value - first) / (last - first), text: value.toFixed(1) }));
    return { low: first, high: last, curve: 1, unit: "of rest density", ticks };
  }
  return null;
}

/** Whether the page is dark: as the system, unless it was told. */
export function isDark() {
  const { scheme } = document.documentElement.dataset;
  return scheme ? scheme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
}

/** A colour of the style sheet, of the scheme that is on, as three numbers. */
export function cssColor(name) {
  const pair = getComputedStyle(document.documentElement).getPropertyValue(name).match(/#[0-9a-f]{6}/gi);
  const value = parseInt(pair[isDark() ? 1 : 0].slice(1), 16);
  return [value >> 16, (value >> 8) & 255, value & 255].map((x) => x / 255);
}
