// The selected shot: its picture, returns, the instrument's own returns, and the fit of its blocks.

import { getJson } from "./api.js";
import { announce, byId, debounced, download, fill, make, problem } from "./elements.js";
import { counted, fixed, significant, withSd } from "./format.js";
import { emit, on, overrides, relative, select, state } from "./state.js";
import { showPanels, showWhole } from "./picture.js";
import { isWithoutWaveforms, pointPanel, showPoint } from "./point.js";
import { stage } from "./stage.js";

let request = null;
/** Whether the picture shows the keys of the job although keys are changed. */
let showsJob = false;
let pointRequest = null;

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
  const isLoaded = state.shot?.input === input && state.shot.shot === shot;
  const sets = overrides();
  const ask = (set) => getJson("shot", { input, shot, set }, signal);
  // Invalid keys do not hide the shot with the keys of the job.
  const [plain, changed] = await Promise.allSettled([
    isLoaded ? state.shot : ask([]),
    sets.length ? ask(sets) : null,
  ]);
  if (signal.aborted) return;
  state.shot = plain.value ?? null;
  state.changedShot = (state.shot && changed.value) ?? null;
  state.failure = (plain.reason ?? changed.reason)?.message ?? null;
  if (move && state.shot) bringIntoView(state.shot);
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
  const isEmpty = !shot && !state.failure;
  byId("picture").hidden = isEmpty || !["shot", "what-if"].includes(document.body.dataset.tab);
  if (isEmpty) {
    fill(byId("shot"), ...(isWithoutWaveforms() ? pointPanel() : [intro()]));
    return;
  }
  const title = shot?.title ?? `shot ${state.selected.shot}`;
  // The GPS time is in the line below.
  byId("shot-title").textContent = title.split(/, GPS time|: \d+ return/)[0].replace(/ of .*[/\\]/, " of ");
  byId("shot-title").title = title;
  byId("shot-about").textContent = shot ? about(shot) : "";
  byId("previous-shot").disabled = neighbour(-1) === null;
  byId("next-shot").disabled = neighbour(1) === null;
  byId("mark-shot").disabled = !shot;
  byId("keys-shown").hidden = !state.changedShot;
  byId("shown-changed").setAttribute("aria-pressed", String(!showsJob));
  byId("shown-job").setAttribute("aria-pressed", String(showsJob));
  for (const id of ["waveform", "picture-tools"]) byId(id).hidden = !shot?.svg;
  if (shot?.svg) showPanels(byId("waveform"), shot.svg, pictureWidth());
  fill(byId("shot"), state.failure ? problem(state.failure) : null, ...(shot ? details(shot) : []));
}

/** Tables and texts of a shot. */
function details(shot) {
  return [
    shot.problem ? make("p", { class: "notice" }, shot.problem) : null,
    returnsTable(state.changedShot),
    instrumentTable(shot),
    blocksTable(shot),
    shot.text ? explanation(shot) : null,
  ];
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
    (changed ?? state.shot).returns.map((each) => ({ change: "same", before: each, after: each }));
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

/** Number of the shot before or after; null if there is none. */
function neighbour(direction) {
  if (state.shot) return direction < 0 ? state.shot.previous : state.shot.next;
  // Without an answer the neighbours are unknown; most recordings number their shots without gaps.
  const next = state.selected ? state.selected.shot + direction : -1;
  return next >= 0 ? next : null;
}

/** Selects the shot before or after. */
export function step(direction) {
  const next = neighbour(direction);
  if (next !== null) select((state.shot ?? state.selected).input, next, null, { move: true });
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
  if (!shot?.svg) return;
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
  if (shot?.svg) download(fileName(shot, "svg"), shot.svg, "image/svg+xml");
}

/** Saves the picture with twice as many pixels per unit as it has CSS pixels. */
export async function savePng() {
  const shot = shown();
  if (!shot?.svg) return;
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
async function clickPoint(index, { opensTab }) {
  pointRequest?.abort();
  pointRequest = new AbortController();
  try {
    const point = await getJson("point", { generation: state.generation, index }, pointRequest.signal);
    if (opensTab && !["shot", "what-if"].includes(document.body.dataset.tab)) emit("open-tab", "shot");
    if (isWithoutWaveforms()) return showPoint(point);
    select(point.input, point.shot, point.return_number);
  } catch (error) {
    if (error.name === "AbortError") return;
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
on("click-point", (index) => clickPoint(index, { opensTab: true }));
on("found-point", (index) => clickPoint(index, { opensTab: false }));
on("select", load);
on("keys", () => {
  showsJob = false;
  load();
});
on("tab", show);
new ResizeObserver(
  debounced(100, () => {
    if (shown()?.svg) showPanels(byId("waveform"), shown().svg, pictureWidth());
  }),
).observe(byId("panel"));
show();
