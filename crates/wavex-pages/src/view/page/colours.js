// Colours of points: perceptual maps for numbers, distinct colours for classes. All are safe for
// colour blindness.

import { darkScheme, state } from "./state.js";

const STOPS = {
  viridis: "440154 482475 414487 355f8d 2a788e 21918c 22a884 44bf70 7ad151 bddf26 fde725",
  cividis: "00224e 083370 35456c 4f576c 666970 7d7c78 948e77 aea371 c8b866 e5cf52 fee838",
  // Blue to red; the middle differs little from the background, so that both ends stand out.
  "diverging light": "053061 2166ac 4393c3 8fb5c9 b4b4b4 d9a48f d6604d b2182b 67001f",
  "diverging dark": "a6d8ff 6bb2ea 3d7fb8 36597a 50545a 7a4a3c b5543c e57a5c ffb9a3",
  "grey light": "1c1c1c c0c0c0",
  "grey dark": "404040 f4f4f4",
};
/** Names of the colour maps that can be chosen. */
export const MAPS = ["viridis", "cividis", "diverging", "grey"];
/** Colours of Okabe and Ito; the yellow is darker on a light background. */
const CLASSES = {
  light: "0072b2 e69f00 009e73 cc79a7 d55e00 56b4e9 a89400 5f6670".split(" "),
  dark: "56b4e9 e69f00 1fb58a d98fba e8702a 3d8fd1 f0e442 a9b0b8".split(" "),
};
/** Values around which an attribute diverges. */
const CENTRES = { deviation_ratio: 0 };
/** Share of a sequential map that is cut off next to the colour of the background. */
const CUT = { light: 0.07, dark: 0.13 };

/** Names of LAS classes. */
const LAS_CLASSES = [
  "never classified",
  "unclassified",
  "ground",
  "low vegetation",
  "medium vegetation",
  "high vegetation",
  "building",
  "low noise",
  "reserved",
  "water",
  "rail",
  "road surface",
  "overlap",
  "wire guard",
  "wire conductor",
  "transmission tower",
  "wire connector",
  "bridge deck",
  "high noise",
];
/** Indices of the colours of LAS classes, the same in every cloud; other classes follow in turn. */
const LAS_COLOURS = { 1: 7, 2: 1, 3: 6, 4: 2, 5: 2, 6: 4, 7: 3, 9: 0, 18: 5 };

function channels(hex) {
  return [0, 2, 4].map((at) => parseInt(hex.slice(at, at + 2), 16));
}

function packed([red, green, blue]) {
  return ((255 << 24) | (Math.round(blue) << 16) | (Math.round(green) << 8) | Math.round(red)) >>> 0;
}

/** Colour map as 256 packed colours. */
export function table(name) {
  const dark = darkScheme.matches;
  const stops = (STOPS[name] || STOPS[`${name} ${dark ? "dark" : "light"}`]).split(" ").map(channels);
  const sequential = name === "viridis" || name === "cividis";
  const [low, high] = sequential ? (dark ? [CUT.dark, 1] : [0, 1 - CUT.light]) : [0, 1];
  return Uint32Array.from({ length: 256 }, (_, i) => {
    const at = (low + ((high - low) * i) / 255) * (stops.length - 1);
    const stop = Math.min(stops.length - 2, Math.floor(at));
    return packed(stops[stop].map((from, k) => from + (stops[stop + 1][k] - from) * (at - stop)));
  });
}

/** Packed colour as CSS. */
export function css(colour) {
  return `rgb(${colour & 255},${(colour >> 8) & 255},${(colour >> 16) & 255})`;
}

/** Colour of points without a value. */
function unknown() {
  return packed(darkScheme.matches ? [92, 96, 102] : [150, 154, 160]);
}

/** How the points are coloured now. */
export const colouring = {
  /** Changes whenever colours do. */
  version: 0,
  attribute: null,
  map: "viridis",
  range: [0, 1],
  /** Classes: value, label, packed colour, whether they are hidden. */
  classes: [],
  table: null,
  isClass: false,
};
/** Map and range that the user chose for an attribute. */
const chosen = new Map();

function attributeKey() {
  return state.flagBit === null ? state.attribute : `flag ${state.flagBit}`;
}

function classLabel(name, value) {
  // The points of a file have the numbers of their strips.
  if (name === "input")
    return (!state.info.without_waveforms && state.info.inputs[value]?.name) || `strip ${value}`;
  if (name === "withheld") return value ? "withheld" : "not withheld";
  if (name === "class") return LAS_CLASSES[value] ? `${value} ${LAS_CLASSES[value]}` : `${value}`;
  return `${value}`;
}

/** Follows the state: chosen attribute, its range, the scheme of the page. */
export function recolour() {
  const attribute =
    state.info.attributes.find(({ name }) => name === state.attribute) || state.info.attributes[0];
  const key = attributeKey();
  const hidden = new Set(
    colouring.key === key ? colouring.classes.filter((one) => one.hidden).map((one) => one.value) : [],
  );
  const centre = CENTRES[attribute.name];
  const wish = chosen.get(key) || {};
  colouring.key = key;
  colouring.attribute = attribute;
  colouring.isClass = attribute.kind === "class";
  colouring.map = wish.map || (centre === undefined ? "viridis" : "diverging");
  if (colouring.isClass) {
    const palette = CLASSES[darkScheme.matches ? "dark" : "light"].map((hex) => packed(channels(hex)));
    const values = state.flagBit === null ? attribute.values || [] : [0, 1];
    const label = (value) =>
      state.flagBit === null ? classLabel(attribute.name, value) : value ? "set" : "not set";
    const shade = (value, i) => (attribute.name === "class" ? (LAS_COLOURS[value] ?? i) : i);
    colouring.classes = values.map((value, i) => ({
      value,
      label: label(value),
      hidden: hidden.has(value),
      colour:
        state.flagBit !== null && value === 0
          ? unknown()
          : palette[(state.flagBit === null ? shade(value, i) : 4) % palette.length],
    }));
  } else {
    const [low, high] = attribute.range || [0, 1];
    const half = Math.max(Math.abs(low - centre), Math.abs(high - centre)) || 1;
    colouring.range = wish.range || (centre === undefined ? [low, high] : [centre - half, centre + half]);
    colouring.classes = [];
  }
  colouring.table = table(colouring.map);
  colouring.version += 1;
}

/** Sets map or range of the current attribute; null: its default. */
export function choose(wish) {
  chosen.set(attributeKey(), wish && { ...chosen.get(attributeKey()), ...wish });
  recolour();
}

/** Packed colours of values; 0: hidden. */
export function coloursOf(values, into = new Uint32Array(values.length)) {
  const none = unknown();
  if (colouring.isClass) {
    const known = new Map(colouring.classes.map((one) => [one.value, one.hidden ? 0 : one.colour]));
    const bit = state.flagBit === null ? 0 : 2 ** state.flagBit;
    for (let i = 0; i < values.length; i += 1) {
      const value = bit ? Math.floor(values[i] / bit) % 2 : values[i];
      into[i] = known.get(value) ?? none;
    }
    return into;
  }
  const {
    table: colours,
    range: [low, high],
  } = colouring;
  const scale = 255 / (high - low || 1);
  for (let i = 0; i < values.length; i += 1) {
    const at = (values[i] - low) * scale;
    into[i] = at >= 0 ? colours[at < 255 ? at | 0 : 255] : at < 0 ? colours[0] : none;
  }
  return into;
}

/** Colours of points whose values are not loaded yet. */
export function plainColours(length) {
  return new Uint32Array(length).fill(unknown());
}
