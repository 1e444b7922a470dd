// What lies over the points: layers, lines that are drawn, marks, north arrow and scale bar.

import { colour, fitted, byId } from "./elements.js";
import { fixed, length, roundStep } from "./format.js";
import { mapUnit, on, relative, state } from "./state.js";
import { stage } from "./stage.js";
import { shownLayers } from "./layers.js";
import { measured } from "./measure.js";
import { label, path, stroke, symbol } from "./symbols.js";
import { currentTool } from "./tools.js";

const LONGEST_SCALE_PX = 150;
let scheduled = false;

/** Draws the overlay with the next frame. */
export function redrawOverlay() {
  if (scheduled) return;
  scheduled = true;
  requestAnimationFrame(() => {
    scheduled = false;
    draw(fitted(byId("overlay")));
  });
}

/** Draws the overlay into a context of CSS pixels. */
export function draw({ context, width, height }) {
  context.clearRect(0, 0, width, height);
  if (!state.info || !stage.cloud) return;
  layers(context);
  clipOutline(context);
  profileLine(context);
  marks(context);
  measuredLine(context);
  crosshair(context, width, height);
  scaleBar(context, width, height);
  if (stage.camera.isOrbit) northArrow(context, width);
}

function layers(context) {
  if (stage.camera.isOrbit) return;
  for (const { picture, layer, opacity } of shownLayers()) {
    const [left, bottom] = stage.camera.project(relative([...layer.min, state.info.origin[2]]));
    const [right, top] = stage.camera.project(relative([...layer.max, state.info.origin[2]]));
    context.globalAlpha = opacity;
    context.imageSmoothingEnabled = false;
    context.drawImage(picture, left, top, right - left, bottom - top);
  }
  context.globalAlpha = 1;
}

/** Line of the profile, or the one that is being drawn, and its width. */
function profileLine(context) {
  const line = state.draft ?? state.profile;
  if (!line) return;
  const { from, to, width_m: wide } = line;
  const height = stage.camera.target[2];
  const along = [to[0] - from[0], to[1] - from[1]];
  const size = Math.hypot(...along) || 1;
  const across = [(-along[1] / size) * (wide / 2), (along[0] / size) * (wide / 2)];
  const at = (end, side) =>
    stage.camera.project([end[0] + side * across[0], end[1] + side * across[1], height]);
  const corners = [at(from, 1), at(to, 1), at(to, -1), at(from, -1)];
  const accent = colour("accent");
  path(context, corners, true);
  context.fillStyle = accent;
  context.globalAlpha = 0.16;
  context.fill();
  context.globalAlpha = 1;
  stroke(context, accent, 1);
  const [a, b] = [at(from, 0), at(to, 0)];
  path(context, [a, b]);
  stroke(context, accent, 2);
  for (const [text, [x, y]] of [
    ["A", a],
    ["B", b],
  ])
    label(context, text, x, y - 10);
}

/** Outline of the clipped region, or of the one that is being drawn. */
function clipOutline(context) {
  const corners = state.clipDraft ?? state.clip?.corners;
  if (!corners) return;
  const height = stage.camera.target[2];
  const onScreen = corners.map((corner) => stage.camera.project([...corner, height]));
  if (onScreen.some(([, , w]) => w <= 0)) return;
  path(context, onScreen, corners.length > 2);
  stroke(context, colour("accent"), 1.5);
  if (state.clipDraft) symbol(context, "corner", ...onScreen[0]);
}

/** Line between the measured points, and in perspective its horizontal and vertical part. */
function measuredLine(context) {
  if (!state.measure) return;
  const { from, to, pointer } = state.measure;
  const a = stage.camera.project(from);
  const b = to ? stage.camera.project(to) : pointer;
  if (a[2] <= 0 || (to && b[2] <= 0)) return;
  symbol(context, "measured", a[0], a[1]);
  if (!b) return;
  if (to && stage.camera.isOrbit) {
    context.setLineDash([4, 4]);
    path(context, [a, stage.camera.project([to[0], to[1], from[2]]), b]);
    stroke(context, colour("accent"), 1.2);
    context.setLineDash([]);
  }
  path(context, [a, b]);
  stroke(context, colour("accent"), 2);
  if (!to) return;
  symbol(context, "measured", b[0], b[1]);
  const { distance, horizontal } = measured();
  label(
    context,
    `${fixed(distance ?? horizontal, 3)} ${mapUnit()}`,
    (a[0] + b[0]) / 2,
    (a[1] + b[1]) / 2 - 8,
  );
}

/** Middle of the view, where the space bar clicks, while a tool is used by the keyboard. */
function crosshair(context, width, height) {
  if (!currentTool() || !state.isByKeyboard) return;
  const [x, y] = [width / 2, height / 2];
  for (const [dx, dy] of [
    [12, 0],
    [0, 12],
  ]) {
    path(context, [
      [x - dx, y - dy],
      [x + dx, y + dy],
    ]);
    stroke(context, colour("text"), 1.2);
  }
}

/** Number of marks of a kind above which they are smaller. */
const MANY = 200;

function marks(context) {
  const put = (kind, position, count = 1) => {
    if (!position) return;
    const [x, y, w] = stage.camera.project(relative(position));
    if (w > 0 && x > -20 && y > -20 && x < stage.camera.width + 20 && y < stage.camera.height + 20)
      symbol(context, kind, x, y, count > MANY ? 0.6 : 1);
  };
  for (const { position } of state.found) put("found", position, state.found.length);
  for (const kind of ["moved", "gone", "new"]) {
    const list = state.comparison?.[kind] || [];
    for (const { position } of list) put(kind, position, list.length);
  }
  for (const { shot } of state.marks.values())
    for (const { position } of shot.returns.slice(0, 1)) put("marked", position);
  if (state.point) put("selected", state.point.position);
  const shown = state.changedShot || state.shot;
  if (!shown) return;
  for (const { change, before, after } of state.changedShot?.difference?.changes || []) {
    if (change !== "same") put(change, (after || before).position);
  }
  for (const each of shown.returns) put("selected", each.position);
}

/** In perspective the scale holds at the centre of the view. */
function scaleBar(context, width, height) {
  const size = roundStep(LONGEST_SCALE_PX * stage.camera.scale);
  const px = size / stage.camera.scale;
  const [right, y] = [width - 14, height - 14];
  path(context, [
    [right - px, y - 5],
    [right - px, y],
    [right, y],
    [right, y - 5],
  ]);
  stroke(context, colour("text"), 1.5);
  label(context, length(size, mapUnit()), right - px / 2, y - 7);
}

function northArrow(context, width) {
  const [x, y] = [width - 30, 34];
  const angle = -stage.camera.azimuth;
  const turn = (a, b) => [
    x + a * Math.cos(angle) - b * Math.sin(angle),
    y + (a * Math.sin(angle) + b * Math.cos(angle)) * Math.max(0.35, Math.sin(stage.camera.elevation)),
  ];
  path(context, [turn(0, -16), turn(6, 12), turn(0, 7), turn(-6, 12)], true);
  stroke(context, colour("text"), 1.5);
  label(context, "N", ...turn(0, -21));
}

for (const name of [
  "camera",
  "generation",
  "shot",
  "found",
  "marks",
  "compared",
  "profile",
  "layers",
  "scheme",
  "clip",
  "clip-draft",
  "measure",
  "point",
  "tool",
])
  on(name, redrawOverlay);
