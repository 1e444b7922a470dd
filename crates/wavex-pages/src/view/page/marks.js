// Marked shots: their list, and its export as CSV.

import { byId, download, fill, make } from "./elements.js";
import { counted } from "./format.js";
import { emit, on, select, state } from "./state.js";

const page = byId("page-marks");
/** Columns of the CSV file: name and value of a shot and one of its returns. */
const COLUMNS = [
  ["input", (shot) => state.info.inputs[shot.input]?.name ?? shot.input],
  ["shot", (shot) => shot.shot],
  ["gps_time_s", (shot) => shot.gps_time_s],
  ...[
    "return_number",
    "number_of_returns",
    "channel",
    "time_of_flight_ns",
    "time_of_flight_sd_ns",
    "range_m",
    "range_sd_m",
    "amplitude_dn",
    "amplitude_sd_dn",
    "width_ratio",
    "width_ratio_sd",
    "thickness_m",
    "thickness_sd_m",
    "deviation_ratio",
    "mta_zone",
  ].map((name) => [name, (_, each) => each?.[name]]),
  ["flags", (_, each) => each?.flags?.join(" ")],
  ...["x", "y", "z"].map((name, i) => [name, (_, each) => each?.position?.[i]]),
  ["note", (_, __, note) => note],
];

function keyOf({ input, shot }) {
  return `${input}:${shot}`;
}

export function isMarked(shot) {
  return state.marks.has(keyOf(shot));
}

/** Marks the selected shot, or removes its mark. */
export function toggleMark() {
  if (!state.shot) return;
  const key = keyOf(state.shot);
  if (!state.marks.delete(key)) {
    const { svg, text, blocks, ...shot } = state.shot;
    state.marks.set(key, { shot, note: "" });
  }
  emit("marks");
}

/** Field of a CSV file. */
function field(value) {
  if (value === null || value === undefined) return "";
  const text = String(value);
  return /[",\n\r]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
}

/** Marked shots as CSV, a row per return. */
function csv() {
  const rows = [COLUMNS.map(([name]) => name)];
  for (const { shot, note } of state.marks.values()) {
    for (const each of shot.returns.length ? shot.returns : [null])
      rows.push(COLUMNS.map(([, value]) => field(value(shot, each, note))));
  }
  return `${rows.map((row) => row.join(",")).join("\n")}\n`;
}

export function saveCsv() {
  if (state.marks.size > 0) download("marked_shots.csv", csv(), "text/csv");
}

function show() {
  byId("tab-marks").textContent = state.marks.size ? `Marks (${state.marks.size})` : "Marks";
  const isThis = state.shot !== null && isMarked(state.shot);
  byId("mark-shot").setAttribute("aria-pressed", String(isThis));
  byId("mark-shot").textContent = isThis ? "★ Marked" : "☆ Mark";
  if (state.marks.size === 0) {
    fill(page, make("p", {}, "No shot is marked. Press m to mark the selected shot."));
    return;
  }
  const row = ([key, mark]) =>
    make(
      "tr",
      {},
      make(
        "td",
        {},
        make(
          "button",
          { class: "link", click: () => select(mark.shot.input, mark.shot.shot, null, { move: true }) },
          `${mark.shot.shot}`,
        ),
      ),
      state.info.inputs.length > 1
        ? make("td", { class: "text" }, state.info.inputs[mark.shot.input]?.name || "")
        : null,
      make("td", {}, `${mark.shot.returns.length}`),
      make(
        "td",
        { class: "text" },
        make("input", {
          type: "text",
          value: mark.note,
          "aria-label": `Note on shot ${mark.shot.shot}`,
          input: (event) => {
            mark.note = event.target.value;
          },
        }),
      ),
      make(
        "td",
        {},
        make(
          "button",
          {
            title: "Remove the mark",
            "aria-label": `Remove the mark of shot ${mark.shot.shot}`,
            click: () => {
              state.marks.delete(key);
              emit("marks");
            },
          },
          "×",
        ),
      ),
    );
  const heads = ["shot", state.info.inputs.length > 1 ? "input" : null, "returns", "note", ""].filter(
    (text) => text !== null,
  );
  fill(
    page,
    make(
      "div",
      { class: "bar" },
      make("p", {}, `${counted(state.marks.size, "shot")} marked`),
      make("button", { class: "primary", click: saveCsv, id: "save-csv" }, "Save CSV"),
      make(
        "button",
        {
          click: () => {
            state.marks.clear();
            emit("marks");
          },
        },
        "Remove all",
      ),
    ),
    make(
      "div",
      { class: "scroll" },
      make(
        "table",
        { class: "list marks" },
        make("thead", {}, make("tr", {}, ...heads.map((text) => make("th", { scope: "col" }, text)))),
        make("tbody", {}, ...[...state.marks].map(row)),
      ),
    ),
  );
}

byId("mark-shot").addEventListener("click", toggleMark);
on("marks", show);
on("shot", () => show());
