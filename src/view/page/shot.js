// The selected shot: its picture, returns, the instrument's own returns, and the fit of its blocks.

import { getJson } from "./api.js";
import { announce, byId, debounced, download, fill, make, problem } from "./elements.js";
import { counted, fixed, significant, withSd } from "./format.js";
import { emit, on, overrides, relative, select, state } from "./state.js";
import { showPanels, showWhole } from "./picture.js";
import { stage } from "./stage.js";

let request = null;
/** Whether the picture shows the keys of the job although keys are changed. */
let showsJob = false;
let failure = null;

/** Width of the picture in the panel, CSS px. */
function pictureWidth() {
  return Math.max(320, byId("panel").clientWidth - 26);
}

/** Loads a shot, and once more with the changed keys if there are any. */
async function load({ move = false } = {}) {
  if (!state.selected) return;
  const { input, shot } = state.selected;
  request?.abort();
  request = new AbortController();
  const { signal } = request;
  byId("picture").classList.add("loading");
  try {
    const isLoaded = state.shot && state.shot.input === input && state.shot.shot === shot;
    const sets = overrides();
    const ask = (set) => getJson("shot", { input, shot, set }, signal);
    const [plain, changed] = await Promise.all([
      isLoaded ? state.shot : ask([]),
      sets.length ? ask(sets) : null,
    ]);
    failure = null;
    state.shot = plain;
    state.changedShot = changed;
    if (move) bringIntoView(plain);
  } catch (error) {
    if (error.name === "AbortError") return;
    failure = error.message;
    if (!state.shot || state.shot.shot !== shot || state.shot.input !== input) {
      state.shot = null;
    }
    state.changedShot = null;
  }
  byId("picture").classList.remove("loading");
  show();
  emit("shot");
}

/** Moves the map if the shot is outside of its middle. */
function bringIntoView(shot) {
  const position = shot.returns.find((each) => each.position)?.position;
  if (!position) return;
  const at = relative(position);
  const [x, y, w] = stage.camera.project(at);
  const { width, height } = stage.camera;
  const inside = w > 0 && x > 0.08 * width && x < 0.92 * width && y > 0.08 * height && y < 0.92 * height;
  if (!inside) stage.centre(at);
}

/** Shot whose picture is shown. */
function shown() {
  return state.changedShot && !showsJob ? state.changedShot : state.shot;
}

function show() {
  const shot = shown();
  byId("picture").hidden = !shot || !["shot", "what-if"].includes(document.body.dataset.tab);
  if (!shot) {
    fill(byId("shot"), failure ? problem(failure) : intro());
    return;
  }
  // The GPS time is in the line below.
  byId("shot-title").textContent = shot.title
    .split(/, GPS time|: \d+ return/)[0]
    .replace(/ of .*[/\\]/, " of ");
  byId("shot-title").title = shot.title;
  byId("shot-about").textContent = about(shot);
  byId("previous-shot").disabled = shot.previous === null;
  byId("next-shot").disabled = shot.next === null;
  byId("keys-shown").hidden = !state.changedShot;
  byId("shown-changed").setAttribute("aria-pressed", String(!showsJob));
  byId("shown-job").setAttribute("aria-pressed", String(showsJob));
  showPanels(byId("waveform"), shot.svg, pictureWidth());
  fill(
    byId("shot"),
    failure ? problem(failure) : null,
    returnsTable(state.changedShot),
    instrumentTable(shot),
    blocksTable(shot),
    explanation(shot),
  );
}

function intro() {
  return make(
    "div",
    { class: "intro" },
    make(
      "p",
      {},
      "Click a point to see its waveform, the fit, and its returns with their standard deviations.",
    ),
    make("p", { class: "faint" }, "Or open “Find” to start with the worst fits. Press ? for all keys."),
  );
}

function about({ gps_time_s: time, line, returns }) {
  const parts = [counted(returns.length, "return")];
  if (line) parts.push(`shot ${line.shot} of ${line.shots} in scan line ${line.number}`);
  if (time !== null && time !== undefined) parts.push(`GPS time ${time.toFixed(6)} s`);
  return parts.join(" · ");
}

/** Rows of the table of returns: label, unit, text of a return. */
const ROWS = [
  ["time of flight", "ns", (r) => withSd(r.time_of_flight_ns, r.time_of_flight_sd_ns, 4)],
  ["range", "m", (r) => withSd(r.range_m, r.range_sd_m, 4)],
  ["amplitude", "DN", (r) => withSd(r.amplitude_dn, r.amplitude_sd_dn, 2)],
  ["width ratio", "", (r) => withSd(r.width_ratio, r.width_ratio_sd, 4)],
  ["thickness", "m", (r) => withSd(r.thickness_m, r.thickness_sd_m, 4)],
  ["deviation ratio", "", (r) => fixed(r.deviation_ratio, 2)],
  ["MTA zone", "", (r) => fixed(r.mta_zone, 0)],
  ["channel", "", (r) => r.channel || "–"],
  ["flags", "", (r) => r.flags.join(", ") || "–"],
];

/** Table of returns, one per column; with changed keys also those that are gone. */
function returnsTable(changed) {
  const changes =
    changed?.difference?.changes ||
    state.shot.returns.map((each) => ({ change: "same", before: each, after: each }));
  if (changes.length === 0) return make("p", {}, "No returns.");
  const columns = changes.map((one) => ({ ...one, shown: one.after || one.before }));
  const heading = ({ change, shown: each, before, after }) =>
    make(
      "th",
      { scope: "col", class: change },
      make("span", {}, `${each.return_number}`),
      change === "same"
        ? null
        : make(
            "span",
            { class: `badge ${change}` },
            change === "moved" ? millimetres(after.range_m - before.range_m) : change,
          ),
    );
  const row = ([label, unit, text]) =>
    make(
      "tr",
      {},
      make("th", { scope: "row" }, label, unit ? make("span", { class: "faint" }, `, ${unit}`) : null),
      ...columns.map(({ change, shown: each }) => make("td", { class: change }, text(each))),
    );
  const hasPositions = columns.some(({ shown: each }) => each.position);
  const places = hasPositions
    ? (state.info.axes || []).map((axis, i) => {
        const [label, unit] = axis.split(", ");
        return [label, unit || "", (each) => (each.position ? fixed(each.position[i], 3) : "–")];
      })
    : [];
  return make(
    "section",
    {},
    make("h3", {}, changed ? "Returns with the changed keys" : "Returns"),
    make(
      "div",
      { class: "scroll", tabindex: 0, role: "region", "aria-label": "Returns" },
      make(
        "table",
        { class: "returns", id: "returns" },
        make("thead", {}, make("tr", {}, make("th", { scope: "col" }, "return"), ...columns.map(heading))),
        make("tbody", {}, ...[...ROWS, ...places].map(row)),
      ),
    ),
    make("p", { class: "faint" }, "± 1 standard deviation"),
  );
}

function millimetres(metres) {
  if (!Number.isFinite(metres)) return "moved";
  return `moved ${metres >= 0 ? "+" : "−"}${significant(Math.abs(metres * 1000), 2)}\u202fmm`;
}

function instrumentTable({ instrument }) {
  if (!instrument?.length) return null;
  const row = (each, i) =>
    make(
      "tr",
      {},
      make("td", {}, `${i + 1}`),
      make("td", {}, fixed(each.time_of_flight_ns, 3)),
      make("td", {}, fixed(each.range_m, 3)),
      make("td", {}, fixed(each.amplitude_dn, 1)),
    );
  return make(
    "section",
    {},
    make("h3", {}, "Returns of the instrument"),
    make(
      "div",
      { class: "scroll" },
      make(
        "table",
        { class: "list" },
        make(
          "thead",
          {},
          make(
            "tr",
            {},
            ...["return", "time of flight, ns", "range, m", "amplitude, DN"].map((text) =>
              make("th", { scope: "col" }, text),
            ),
          ),
        ),
        make("tbody", {}, ...instrument.map(row)),
      ),
    ),
  );
}

function blocksTable({ blocks }) {
  if (!blocks?.length) return null;
  const row = (block, i) =>
    make(
      "tr",
      {},
      make("td", {}, `${i + 1}`),
      make("td", {}, block.channel || "–"),
      make("td", {}, `${block.samples_dn.length}`),
      make("td", {}, fixed(block.first_ns, 1)),
      make("td", {}, fixed(block.background_dn, 2)),
      make("td", {}, fixed(block.chi_square, 1)),
      make("td", {}, `${block.degrees_of_freedom}`),
    );
  return make(
    "section",
    {},
    make("h3", {}, "Sample blocks"),
    make(
      "div",
      { class: "scroll" },
      make(
        "table",
        { class: "list" },
        make(
          "thead",
          {},
          make(
            "tr",
            {},
            ...[
              "block",
              "channel",
              "samples",
              "begins at, ns",
              "background, DN",
              "chi-square",
              "degrees of freedom",
            ].map((text) => make("th", { scope: "col" }, text)),
          ),
        ),
        make("tbody", {}, ...blocks.map(row)),
      ),
    ),
  );
}

let isExplained = false;

function explanation({ text }) {
  const details = make(
    "details",
    {
      open: isExplained,
      toggle: () => {
        isExplained = details.open;
      },
    },
    make("summary", {}, "Text of wavex explain"),
    make("pre", { class: "scroll", tabindex: 0 }, text),
  );
  return details;
}

/** Selects the shot before or after. */
export function step(direction) {
  const next = direction < 0 ? state.shot?.previous : state.shot?.next;
  if (next !== null && next !== undefined) select(state.shot.input, next, null, { move: true });
}

/** Shows the picture with the keys of the job, or with the changed ones. */
export function toggleJobKeys() {
  if (!state.changedShot) return;
  showsJob = !showsJob;
  show();
}

/** Shows the whole picture in a dialog. */
export function enlarge() {
  const shot = shown();
  if (!shot) return;
  showWhole(byId("enlarged-picture"), shot.svg);
  byId("enlarged").showModal();
}

/** Name of a file for the shot. */
function fileName(shot, ending) {
  const input = (state.info.inputs[shot.input]?.name || "shot")
    .replace(/\.[^.]*$/, "")
    .replace(/[^\w.-]+/g, "_");
  return `${input}_shot_${shot.shot}.${ending}`;
}

export function saveSvg() {
  const shot = shown();
  if (shot) download(fileName(shot, "svg"), shot.svg, "image/svg+xml");
}

/** Saves the picture with twice as many pixels per unit as it has CSS pixels. */
export async function savePng() {
  const shot = shown();
  if (!shot) return;
  const link = URL.createObjectURL(new Blob([shot.svg], { type: "image/svg+xml" }));
  try {
    const image = new Image();
    image.src = link;
    await image.decode();
    const canvas = make("canvas", { width: 2 * image.naturalWidth, height: 2 * image.naturalHeight });
    canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
    canvas.toBlob((blob) => download(fileName(shot, "png"), blob));
  } catch {
    announce("The picture cannot be drawn.", true);
  } finally {
    URL.revokeObjectURL(link);
  }
}

/** Selects the shot of a point. */
async function clickPoint(index) {
  try {
    const point = await getJson("point", { generation: state.generation, index });
    if (!["shot", "what-if"].includes(document.body.dataset.tab)) emit("open-tab", "shot");
    select(point.input, point.shot, point.return_number);
  } catch (error) {
    if (error.status === 410) emit("loading-failed", error);
    else announce(error.message, true);
  }
}

byId("previous-shot").addEventListener("click", () => step(-1));
byId("next-shot").addEventListener("click", () => step(1));
byId("shown-changed").addEventListener("click", () => {
  showsJob = false;
  show();
});
byId("shown-job").addEventListener("click", () => {
  showsJob = true;
  show();
});
byId("whole-picture").addEventListener("click", enlarge);
byId("save-svg").addEventListener("click", saveSvg);
byId("save-png").addEventListener("click", savePng);
on("click-point", clickPoint);
on("select", load);
on("keys", () => {
  showsJob = false;
  load();
});
on("tab", show);
new ResizeObserver(
  debounced(100, () => {
    if (shown()) showPanels(byId("waveform"), shown().svg, pictureWidth());
  }),
).observe(byId("panel"));
show();
