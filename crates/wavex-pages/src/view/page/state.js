// What the page shows, shared by all of its parts. Parts change it and emit an event.

export const state = {
  /** Answer of `info`. */
  info: null,
  /** Generation of the points that are drawn. */
  generation: 0,
  /** Attribute that colours the points: name in `info.attributes`. */
  attribute: "height_m",
  /** Bit of the attribute `flags` that colours the points; null for other attributes. */
  flagBit: null,
  /** Size of a point, CSS pixels. */
  pointSize: 2,
  /** Limit of the number of points drawn. */
  pointLimit: 1_500_000,
  /** Whether shapes are shaded in perspective. */
  isShaded: true,
  /** Region to which the points are clipped (see `clip_region.js`), and corners of the one that is being drawn. */
  clip: null,
  clipDraft: null,
  /** Measured points: from and to (null before the second click), relative to the origin; pointer, px. */
  measure: null,
  /** Whether the last action on the stage was by the keyboard. */
  isByKeyboard: false,
  /** Clicked point of a file without waveforms: answer of `point`. */
  point: null,
  /** Selected shot: input, shot, return_number. */
  selected: null,
  /** Answer of `shot` with the keys of the job, and with the changed keys. */
  shot: null,
  changedShot: null,
  /** Why the selected shot cannot be shown, or not with the changed keys; null if it can. */
  failure: null,
  /** Changed keys of the job: key to value. */
  changedKeys: new Map(),
  /** Answer of `compare`. */
  comparison: null,
  /** Shots of the last search, and the current one. */
  found: [],
  foundAt: -1,
  /** Marked shots: "input:shot" to their data. */
  marks: new Map(),
  /** Line of the profile: from, to (relative to the origin), width_m, in the unit of the map. */
  profile: null,
  /** Median height of the ground along that line, in parts: pairs of distance and height. */
  ground: [],
  /** Line that is being drawn, like `profile`. */
  draft: null,
};

const target = new EventTarget();

/** Calls a function on each event of a name. */
export function on(name, run) {
  target.addEventListener(name, (event) => run(event.detail));
}

/** Announces a change. */
export function emit(name, detail) {
  target.dispatchEvent(new CustomEvent(name, { detail }));
}

/** Changed keys as parameters `set`. */
export function overrides() {
  return [...state.changedKeys].map(([key, value]) => `${key}=${value}`);
}

/** Selects a shot of an input. */
export function select(input, shot, returnNumber = null, { move = false } = {}) {
  state.selected = { input, shot, return_number: returnNumber };
  emit("select", { move });
}

/** Unit of map coordinates. */
export function mapUnit() {
  return state.info?.unit ?? "m";
}

/** Unit of heights. */
export function heightUnit() {
  return state.info?.height_unit ?? mapUnit();
}

/** Position relative to the origin of an absolute one. */
export function relative(position) {
  return position.map((at, i) => at - state.info.origin[i]);
}

/** Absolute position of one relative to the origin. */
export function absolute(position) {
  return position.map((at, i) => at + state.info.origin[i]);
}

/** Whether the page is dark. */
export const darkScheme = matchMedia("(prefers-color-scheme: dark)");
