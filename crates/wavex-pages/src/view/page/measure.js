// Distance: horizontal, vertical and 3-D, between two points that are clicked.

import { announce } from "./elements.js";
import { fixed } from "./format.js";
import { absolute, emit, heightUnit, mapUnit, on, state } from "./state.js";
import { stage } from "./stage.js";
import { addTool, currentTool, setHint } from "./tools.js";

export const measureTool = addTool({
  button: "measure",
  hint: "Click two points to measure their distance and the difference of their heights.",
  click(at) {
    const point = stage.pointAt(stage.pick(...at));
    if (!point) return announce("There is no point here; click a point.");
    const isFirst = !state.measure || state.measure.to !== null;
    state.measure = isFirst
      ? { from: point, to: null, pointer: null }
      : { ...state.measure, to: point, pointer: null };
    setHint(isFirst ? "Click the second point." : measureText());
    emit("measure");
  },
  move(at) {
    if (!state.measure || state.measure.to) return;
    state.measure.pointer = at;
    emit("measure");
  },
  cancel() {
    if (!state.measure) return;
    state.measure = null;
    if (currentTool() === measureTool) setHint(measureTool.hint);
    emit("measure");
  },
});

/** Distances between the measured points, and the points; null before the second click. */
export function measured() {
  if (!state.measure?.to) return null;
  const { from, to } = state.measure;
  const horizontal = Math.hypot(to[0] - from[0], to[1] - from[1]);
  const height = to[2] - from[2];
  // Feet and metres do not add up.
  const distance = mapUnit() === heightUnit() ? Math.hypot(horizontal, height) : null;
  return { from: absolute(from), to: absolute(to), horizontal, height, distance };
}

/** The distances as text. */
export function measureText() {
  const { horizontal, height, distance } = measured();
  const parts = [
    `horizontal ${fixed(horizontal, 3)} ${mapUnit()}`,
    `height ${height < 0 ? "−" : "+"}${fixed(Math.abs(height), 3)} ${heightUnit()}`,
  ];
  if (distance !== null) parts.unshift(`distance ${fixed(distance, 3)} ${mapUnit()}`);
  return parts.join(" · ");
}

on("generation", () => measureTool.cancel());
