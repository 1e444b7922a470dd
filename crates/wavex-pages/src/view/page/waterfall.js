// Waterfall: the waveforms of a scan line as a picture, shot by time of flight.

import { getJson } from "./api.js";
import { table } from "./colours.js";
import { drawAxes } from "./axes.js";
import { closeDock, isDocked, openDock, placeInDock, setMessage, setTitle } from "./dock.js";
import { byId, colour, fitted, make } from "./elements.js";
import { significant } from "./format.js";
import { on, select, state } from "./state.js";

const MARGIN = { left: 62, top: 8, right: 12, bottom: 38 };
let line = null;
let picture = null;
/** Shown rows: first and last time of flight, ns. */
let times = null;
let drag = null;
let request = null;
/** Exponent of the brightness: weak waveforms are raised. */
let gamma = 0.5;

const brightness = make(
  "select",
  {
    "aria-label": "Brightness",
    change: () => {
      gamma = Number(brightness.value);
      paint();
    },
  },
  make("option", { value: 1 }, "linear"),
  make("option", { value: 0.5, selected: true }, "square root"),
  make("option", { value: 0.3 }, "weak echoes"),
);
const dots = make("input", { type: "checkbox", checked: true, change: () => draw() });
const scale = make("span", { class: "scale" });

const content = {
  name: "line",
  controls: [
    scale,
    make("label", {}, "Brightness ", brightness),
    make("label", { class: "check" }, dots, "Returns"),
  ],
  draw,
  close() {
    request?.abort();
    line = null;
  },
  pointerdown(event) {
    drag = { begin: placeInDock(event), last: placeInDock(event), hasMoved: false };
  },
  pointermove(event) {
    if (!drag || !times || !event.buttons) return;
    const at = placeInDock(event);
    if (!drag.hasMoved && Math.abs(at[1] - drag.begin[1]) < 5) return;
    drag.hasMoved = true;
    const frame = box();
    const by = (-(at[1] - drag.last[1]) / (frame.bottom - frame.top)) * (times[1] - times[0]);
    times = times.map((time) => time + by);
    drag.last = at;
    draw();
  },
  pointerup(event) {
    const ended = drag;
    drag = null;
    if (!ended || ended.hasMoved || !line) return;
    const frame = box();
    const column = Math.floor(
      ((placeInDock(event)[0] - frame.left) / (frame.right - frame.left)) * line.width,
    );
    const shot = line.shots[column];
    if (shot !== undefined && shot !== null) select(line.input, shot);
  },
  wheel(event) {
    if (!times) return;
    const frame = box();
    const part = (placeInDock(event)[1] - frame.top) / (frame.bottom - frame.top);
    const middle = times[0] + part * (times[1] - times[0]);
    const factor = Math.exp(Math.max(-300, Math.min(300, event.deltaY)) * 0.0016);
    times = times.map((time) => middle + (time - middle) * factor);
    draw();
  },
  dblclick() {
    if (!line) return;
    times = whole();
    draw();
  },
};

function box() {
  const { clientWidth, clientHeight } = byId("dock-canvas");
  return {
    left: MARGIN.left,
    top: MARGIN.top,
    right: clientWidth - MARGIN.right,
    bottom: clientHeight - MARGIN.bottom,
  };
}

function whole() {
  return [line.first_ns, line.first_ns + line.height * line.interval_ns];
}

/** Loads the line of the selected shot, unless it is shown. */
async function load() {
  request?.abort();
  if (!state.selected) {
    setTitle("Scan line");
    setMessage("Select a shot to see the waveforms of its scan line.");
    return;
  }
  const { input, shot } = state.selected;
  if (line && line.input === input && line.shots.includes(shot)) return draw();
  request = new AbortController();
  const { signal } = request;
  if (!line) setMessage("Loading …");
  try {
    const answer = await getJson("line", { input, shot }, signal);
    const image = new Image();
    image.src = `data:image/png;base64,${answer.image}`;
    await image.decode();
    if (signal.aborted) return;
    line = { ...answer, input, grey: grey(image) };
    times = whole();
    setMessage("");
    setTitle(`Scan line ${line.line}`);
    paint();
  } catch (error) {
    if (signal.aborted) return;
    line = null;
    draw();
    setMessage(error.message, true);
  }
}

/** Grey values of a picture. */
function grey(image) {
  const canvas = make("canvas", { width: image.width, height: image.height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(image, 0, 0);
  const { data } = context.getImageData(0, 0, image.width, image.height);
  return Uint8Array.from({ length: data.length / 4 }, (_, i) => data[4 * i]);
}

/** Colours the picture. */
function paint() {
  if (!line) return;
  const colours = table("viridis");
  const shades = Uint32Array.from({ length: 256 }, (_, i) => colours[Math.round(255 * (i / 255) ** gamma)]);
  picture = make("canvas", { width: line.width, height: line.height });
  const context = picture.getContext("2d");
  const image = context.createImageData(line.width, line.height);
  new Uint32Array(image.data.buffer).set(Uint32Array.from(line.grey, (value) => shades[value]));
  context.putImageData(image, 0, 0);
  scale.textContent = `0 to ${significant(line.highest_dn)} DN`;
  scale.title = "Amplitude above the background, from dark to bright";
  draw();
}

function draw() {
  const { context, width, height } = fitted(byId("dock-canvas"));
  context.clearRect(0, 0, width, height);
  if (!line || !picture) return;
  const frame = box();
  const [wide, tall] = [frame.right - frame.left, frame.bottom - frame.top];
  if (wide < 20 || tall < 20) return;
  const column = wide / line.width;
  const y = (time) => frame.top + ((time - times[0]) / (times[1] - times[0])) * tall;
  drawAxes(
    context,
    frame,
    { range: [0, line.width], label: "shot in the line" },
    { range: [times[1], times[0]], label: "time of flight, ns" },
  );
  context.save();
  context.beginPath();
  context.rect(frame.left, frame.top, wide, tall);
  context.clip();
  context.imageSmoothingEnabled = false;
  const [top, bottom] = whole().map(y);
  context.drawImage(picture, frame.left, top, wide, bottom - top);
  context.fillStyle = colour("gone");
  const side = Math.max(1.5, Math.min(3, column / 2));
  for (const each of dots.checked ? line.returns : []) {
    context.fillRect(
      frame.left + (each.column + 0.5) * column - side / 2,
      y(each.time_of_flight_ns) - side / 2,
      side,
      side,
    );
  }
  const at = line.shots.indexOf(state.selected?.shot);
  if (at >= 0 && line.input === state.selected.input) {
    context.strokeStyle = colour("selected");
    context.lineWidth = 2;
    context.strokeRect(frame.left + at * column - 1, frame.top - 2, Math.max(3, column) + 2, tall + 4);
  }
  context.restore();
}

/** Opens or closes the waterfall. */
export function toggleLine() {
  if (isDocked(content)) return closeDock();
  line = null;
  setTitle("Scan line");
  openDock(content);
  return load();
}

byId("show-line").addEventListener("click", toggleLine);
on("select", () => {
  if (isDocked(content)) load();
});
on("scheme", () => {
  if (isDocked(content)) paint();
});
