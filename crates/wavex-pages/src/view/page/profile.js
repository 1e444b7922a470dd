// Profile: the points along a line, from the side.

import { getBytes, getJson } from "./api.js";
import { coloursOf } from "./colours.js";
import { drawAxes } from "./axes.js";
import { isDocked, openDock, placeInDock, setMessage, setTitle } from "./dock.js";
import { byId, colour, debounced, fitted, make } from "./elements.js";
import { count, counted, length, roundStep } from "./format.js";
import { absolute, emit, heightUnit, mapUnit, on, relative, state } from "./state.js";
import { stage } from "./stage.js";
import { path, stroke, symbol } from "./symbols.js";
import { addTool, setTool } from "./tools.js";

const MARGIN = { left: 62, top: 8, right: 12, bottom: 38 };
const HIT_PX = 8;
/** Default width, screen pixels. */
const WIDTH_PX = 12;

let points = null;
/** Shown ranges: along the line and height. */
let range = null;
let drag = null;
let request = null;
let isTrueScale = false;

const width = make("input", {
  type: "number",
  min: 0.01,
  step: "any",
  input: debounced(250, () => {
    const value = Number(width.value);
    if (!(value > 0) || !state.profile) return;
    state.profile.width_m = value;
    emit("profile");
    load();
  }),
});
const widthUnit = make("span");
const trueScale = make("input", {
  type: "checkbox",
  change: () => {
    isTrueScale = trueScale.checked;
    showAll();
  },
});

const content = {
  name: "profile",
  controls: [
    make("label", {}, "Width ", width, widthUnit),
    make(
      "label",
      { class: "check", title: "The same scale along the line and in height" },
      trueScale,
      "1 : 1",
    ),
  ],
  draw,
  close() {
    request?.abort();
    points = null;
    state.ground = [];
    state.profile = null;
    emit("profile");
  },
  pointerdown(event) {
    drag = { begin: placeInDock(event), last: placeInDock(event), hasMoved: false };
    byId("dock-body").setPointerCapture(event.pointerId);
  },
  pointermove(event) {
    if (!drag || !range || !event.buttons) return;
    const at = placeInDock(event);
    if (!drag.hasMoved && Math.hypot(at[0] - drag.begin[0], at[1] - drag.begin[1]) < 5) return;
    drag.hasMoved = true;
    const frame = box();
    shift(0, (-(at[0] - drag.last[0]) / (frame.right - frame.left)) * (range[0][1] - range[0][0]));
    shift(1, ((at[1] - drag.last[1]) / (frame.bottom - frame.top)) * (range[1][1] - range[1][0]));
    drag.last = at;
    draw();
  },
  pointerup(event) {
    const ended = drag;
    drag = null;
    if (ended && !ended.hasMoved) {
      const index = pick(...placeInDock(event));
      if (index !== null) emit("click-point", index);
    }
  },
  wheel(event) {
    if (!range) return;
    const [x, y] = placeInDock(event);
    const frame = box();
    const factor = Math.exp(Math.max(-300, Math.min(300, event.deltaY)) * 0.0016);
    const parts = [
      (x - frame.left) / (frame.right - frame.left),
      (frame.bottom - y) / (frame.bottom - frame.top),
    ];
    range = range.map(([low, high], i) => {
      const middle = low + parts[i] * (high - low);
      return [middle + (low - middle) * factor, middle + (high - middle) * factor];
    });
    draw();
  },
  dblclick: showAll,
};

function shift(axis, by) {
  range[axis] = range[axis].map((at) => at + by);
}

/** Frame of the picture, CSS px. */
function box() {
  const { clientWidth, clientHeight } = byId("dock-canvas");
  return {
    left: MARGIN.left,
    top: MARGIN.top,
    right: clientWidth - MARGIN.right,
    bottom: clientHeight - MARGIN.bottom,
  };
}

/** Loads the points of the line. */
async function load() {
  if (!state.profile) return;
  request?.abort();
  request = new AbortController();
  const { from, to, width_m } = state.profile;
  const corner = (at) => absolute(at).slice(0, 2).join(",");
  const line = { generation: state.generation, from: corner(from), to: corner(to), width_m };
  if (!points) setMessage("Loading …");
  try {
    const answer = await getBytes("profile", { ...line, attribute: state.attribute }, request.signal);
    state.ground = (await getJson("ground", line, request.signal)).ground;
    const [n, total] = new Uint32Array(answer, 0, 2);
    const column = (Kind, at) => new Kind(answer, 8 + 4 * n * at, n);
    const isFirst = !points;
    points = {
      generation: state.generation,
      attribute: state.attribute,
      n,
      total,
      along: column(Float32Array, 0),
      height: column(Float32Array, 1),
      value: column(Float32Array, 2),
      index: column(Uint32Array, 3),
    };
    const seen = n < total ? `${count(n)} of ${count(total)} points` : counted(n, "point");
    const lines = state.ground.length ? "; line: median of the ground" : "";
    setTitle(`Profile, ${length(size(), mapUnit())}: ${seen}${lines}`);
    setMessage(n === 0 ? "No points within this width of the line." : "");
    if (isFirst || !range) showAll();
    else draw();
  } catch (error) {
    if (error.name === "AbortError") return;
    setMessage(error.message, true);
  }
}

function size() {
  const { from, to } = state.profile;
  return Math.hypot(to[0] - from[0], to[1] - from[1]);
}

/** Shows all points of the profile. */
function showAll() {
  if (!points || !state.profile) return;
  let [low, high] = [Infinity, -Infinity];
  for (const at of points.height) {
    if (at < low) low = at;
    if (at > high) high = at;
  }
  if (!(high >= low)) [low, high] = [0, 1];
  const pad = Math.max(0.2, 0.06 * (high - low));
  range = [
    [0, size()],
    [low - pad, high + pad],
  ];
  if (isTrueScale) {
    const frame = box();
    const perPx = Math.max(
      size() / (frame.right - frame.left),
      (high - low + 2 * pad) / (frame.bottom - frame.top),
    );
    const half = [((frame.right - frame.left) * perPx) / 2, ((frame.bottom - frame.top) * perPx) / 2];
    range = [
      [size() / 2 - half[0], size() / 2 + half[0]],
      [(low + high) / 2 - half[1], (low + high) / 2 + half[1]],
    ];
  }
  draw();
}

function draw() {
  const { context, width: wide, height: tall, ratio } = fitted(byId("dock-canvas"));
  context.clearRect(0, 0, wide, tall);
  if (!points || !range || !state.profile) return;
  const frame = box();
  if (frame.right - frame.left < 20 || frame.bottom - frame.top < 20) return;
  drawAxes(
    context,
    frame,
    { range: range[0], label: `distance along the line, ${mapUnit()}` },
    { range: range[1], label: `height, ${heightUnit()}` },
  );
  const [w, h] = [
    Math.floor((frame.right - frame.left) * ratio),
    Math.floor((frame.bottom - frame.top) * ratio),
  ];
  const image = new ImageData(w, h);
  const pixels = new Uint32Array(image.data.buffer);
  const colours = coloursOf(points.value);
  const side = Math.max(1, Math.round(state.pointSize * ratio));
  const [sx, sy] = [w / (range[0][1] - range[0][0]), h / (range[1][1] - range[1][0])];
  for (let i = 0; i < points.n; i += 1) {
    const x = Math.floor((points.along[i] - range[0][0]) * sx);
    const y = Math.floor((range[1][1] - points.height[i]) * sy);
    if (x < 0 || y < 0 || x > w - side || y > h - side || colours[i] === 0) continue;
    for (let row = 0, at = y * w + x; row < side; row += 1, at += w) pixels.fill(colours[i], at, at + side);
  }
  const layer = make("canvas", { width: w, height: h });
  layer.getContext("2d").putImageData(image, 0, 0);
  context.drawImage(layer, frame.left, frame.top, w / ratio, h / ratio);
  context.save();
  context.beginPath();
  context.rect(frame.left, frame.top, frame.right - frame.left, frame.bottom - frame.top);
  context.clip();
  for (const part of state.ground) {
    const corners = part.map(([along, height]) => screen(frame, along, height));
    path(context, corners);
    stroke(context, colour("selected"), 1.5);
  }
  context.restore();
  for (const each of (state.changedShot || state.shot)?.returns || [])
    selected(context, frame, each.position);
}

/** Marks a return of the selected shot that is within the profile. */
function selected(context, frame, position) {
  if (!position) return;
  const { from, to, width_m } = state.profile;
  const at = relative(position);
  const along = [(to[0] - from[0]) / size(), (to[1] - from[1]) / size()];
  const d = [at[0] - from[0], at[1] - from[1]];
  const [a, off] = [d[0] * along[0] + d[1] * along[1], d[0] * -along[1] + d[1] * along[0]];
  const [x, y] = screen(frame, a, position[2]);
  const isWithin = Math.abs(off) <= width_m / 2 && a >= 0 && a <= size();
  if (isWithin && x >= frame.left && x <= frame.right && y >= frame.top && y <= frame.bottom)
    symbol(context, "selected", x, y);
}

function screen(frame, along, height) {
  return [
    frame.left + ((along - range[0][0]) / (range[0][1] - range[0][0])) * (frame.right - frame.left),
    frame.bottom - ((height - range[1][0]) / (range[1][1] - range[1][0])) * (frame.bottom - frame.top),
  ];
}

function pick(x, y) {
  if (!points || points.generation !== state.generation) return null;
  const frame = box();
  const colours = coloursOf(points.value);
  let [best, least] = [null, HIT_PX * HIT_PX];
  for (let i = 0; i < points.n; i += 1) {
    const [u, v] = screen(frame, points.along[i], points.height[i]);
    const off = (u - x) ** 2 + (v - y) ** 2;
    if (off < least && colours[i] !== 0) [best, least] = [points.index[i], off];
  }
  return best;
}

/** First end of the line, once it is clicked. */
let firstEnd = null;

export const profileTool = addTool({
  button: "draw-profile",
  needsMap: true,
  hint: "Click both ends of a line, or drag it, to see the points along it.",
  click(at) {
    const place = stage.camera.unproject(...at);
    if (!firstEnd) {
      firstEnd = place;
      setLine("draft", place, place);
    } else if (Math.hypot(place[0] - firstEnd[0], place[1] - firstEnd[1]) > stage.camera.scale) {
      open(firstEnd, place);
    }
  },
  move(at) {
    if (firstEnd) setLine("draft", firstEnd, stage.camera.unproject(...at));
  },
  drag(begin, at, isDone) {
    const [from, to] = [stage.camera.unproject(...begin), stage.camera.unproject(...at)];
    if (isDone) open(from, to);
    else setLine("draft", from, to);
  },
  cancel() {
    firstEnd = null;
    state.draft = null;
    emit("profile");
  },
});

function setLine(what, from, to) {
  const wide = state.profile?.width_m ?? Math.max(0.01, roundStep(WIDTH_PX * stage.camera.scale));
  state[what] = { from, to, width_m: wide };
  emit("profile");
}

/** Opens the profile of a line. */
function open(from, to) {
  setTool(null);
  setLine("profile", from, to);
  const wide = state.profile.width_m;
  width.value = Number(wide.toPrecision(3));
  width.setAttribute("aria-label", `Width of the profile, ${mapUnit()}`);
  widthUnit.textContent = ` ${mapUnit()}`;
  points = null;
  state.ground = [];
  range = null;
  setTitle("Profile");
  openDock(content);
  load();
}
for (const name of ["attribute", "generation"])
  on(name, () => {
    if (isDocked(content)) load();
  });
for (const name of ["colours", "shot"])
  on(name, () => {
    if (isDocked(content)) draw();
  });
