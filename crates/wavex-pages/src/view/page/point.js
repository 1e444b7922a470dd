// The panel of a file of points without waveforms: why there are none, and the quantities of a point.

import { byId, fill, make } from "./elements.js";
import { fixed, significant, unitAfter } from "./format.js";
import { emit, on, state } from "./state.js";

/** Whether the file has points without waveforms. */
export function isWithoutWaveforms() {
  return Boolean(state.info?.without_waveforms);
}

/** Content of the panel. */
export function pointPanel() {
  return [
    make("p", { class: "notice", id: "without-waveforms" }, state.info.without_waveforms),
    state.point ? quantities(state.point) : make("p", { class: "faint" }, "Click a point to see its values."),
  ];
}

function quantities({ position, values, flags }) {
  const rows = [
    ...state.info.axes.map((axis, i) => {
      const [label, unit] = axis.split(", ");
      return [label, `${fixed(position[i], 3)}${unitAfter(unit)}`];
    }),
    ...state.info.attributes
      .filter(({ name }) => name !== "flags" && name !== "height_m")
      .map(({ name, label, unit }) => [label, `${significant(values[name], 6)}${unitAfter(unit)}`]),
    ["flags", flags.join(", ") || "–"],
  ];
  return make(
    "table",
    { class: "list", id: "point" },
    make(
      "tbody",
      {},
      ...rows.map(([label, text]) =>
        make("tr", {}, make("th", { scope: "row" }, label), make("td", {}, text)),
      ),
    ),
  );
}

/** Shows a point. */
export function showPoint(point) {
  state.point = point;
  emit("point");
}

on("info", () => {
  if (!isWithoutWaveforms()) return;
  for (const id of ["tab-what-if", "tab-marks", "show-line"]) byId(id).hidden = true;
  byId("tab-shot").textContent = "Point";
  emit("point");
});
on("point", () => fill(byId("shot"), ...pointPanel()));
on("generation", () => {
  state.point = null;
});
