// Clip: shows only the points within a box or polygon that is drawn on the map.

import { recolour } from "./colours.js";
import { regionOf } from "./clip_region.js";
import { announce, byId } from "./elements.js";
import { emit, on, state } from "./state.js";
import { stage } from "./stage.js";
import { addTool, setTool } from "./tools.js";

/** A click this near to the first corner closes the polygon, px. */
const CLOSE_PX = 12;
/** Corners nearer than this are one, px: a double click gives two. */
const SAME_PX = 4;

/** Corners on the map, relative to the origin. */
let corners = [];

function onScreen(corner) {
  return stage.camera.project([...corner, stage.camera.target[2]]);
}

function isNear(at, corner, px) {
  const [x, y] = onScreen(corner);
  return Math.hypot(at[0] - x, at[1] - y) <= px;
}

function onMap(at) {
  return stage.camera.unproject(...at).slice(0, 2);
}

/** Shows the unfinished polygon, up to the pointer. */
function draft(next = null) {
  state.clipDraft = corners.length ? [...corners, ...(next ? [next] : [])] : null;
  emit("clip-draft");
}

function boxOf(from, to) {
  const [[x0, y0], [x1, y1]] = [onMap(from), onMap(to)];
  return [
    [x0, y0],
    [x1, y0],
    [x1, y1],
    [x0, y1],
  ];
}

export const clipTool = addTool({
  button: "clip",
  needsMap: true,
  hint: "Drag a box, or click the corners of a polygon. Enter, a double click or the first corner closes it.",
  press() {
    if (!state.clip) return false;
    setClip(null);
    return true;
  },
  click(at) {
    if (corners.length > 2 && isNear(at, corners[0], CLOSE_PX)) return clipTool.finish();
    if (corners.length === 0 || !isNear(at, corners.at(-1), SAME_PX)) corners.push(onMap(at));
    draft();
  },
  move(at) {
    if (corners.length) draft(onMap(at));
  },
  drag(from, to, isDone) {
    corners = boxOf(from, to);
    if (isDone) clipTool.finish();
    else draft();
  },
  finish() {
    if (corners.length < 3) return announce("A polygon needs three corners.");
    setClip(corners);
    setTool(null);
  },
  cancel() {
    corners = [];
    draft();
  },
});

/** Clips to a polygon; null shows all points again. */
function setClip(polygon) {
  state.clip = polygon && regionOf(polygon);
  byId("clip").textContent = polygon ? "Clear clip" : "Clip";
  if (state.info?.attributes.length) recolour();
  stage.redraw();
  emit("clip");
}

on("tool", (tool) => {
  if (tool !== clipTool) byId("clip").setAttribute("aria-pressed", String(Boolean(state.clip)));
});
on("clip", () => byId("clip").setAttribute("aria-pressed", String(Boolean(state.clip))));
