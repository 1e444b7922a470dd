// What lies over the points: layers, the line of the profile, marks, north arrow and scale bar.

import { colour, fitted, byId } from "./elements.js";
import { length, roundStep } from "./format.js";
import { mapUnit, on, relative, state } from "./state.js";
import { stage } from "./stage.js";
import { shownLayers } from "./layers.js";

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
  profileLine(context);
  marks(context);
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

/** Symbols: colour and shape of each kind of mark. */
export const SYMBOLS = {
  found: { name: "accent", shape: "circle", size: 3.5 },
  marked: { name: "star", shape: "star", size: 7 },
  new: { name: "new", shape: "plus", size: 6 },
  gone: { name: "gone", shape: "cross", size: 5 },
  moved: { name: "moved", shape: "diamond", size: 5 },
  selected: { name: "selected", shape: "ring", size: 9 },
};

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
  const shown = state.changedShot || state.shot;
  if (!shown) return;
  for (const { change, before, after } of state.changedShot?.difference?.changes || []) {
    if (change !== "same") put(change, (after || before).position);
  }
  for (const each of shown.returns) put("selected", each.position);
}

/** Draws one symbol with a halo. */
export function symbol(context, kind, x, y, scale = 1) {
  const { name, shape, size: full } = SYMBOLS[kind];
  const size = full * scale;
  context.beginPath();
  if (shape === "circle" || shape === "ring") context.arc(x, y, size, 0, 2 * Math.PI);
  else if (shape === "plus")
    lines(
      context,
      [
        [x - size, y],
        [x + size, y],
      ],
      [
        [x, y - size],
        [x, y + size],
      ],
    );
  else if (shape === "cross")
    lines(
      context,
      [
        [x - size, y - size],
        [x + size, y + size],
      ],
      [
        [x - size, y + size],
        [x + size, y - size],
      ],
    );
  else if (shape === "diamond")
    path(
      context,
      [
        [x, y - size],
        [x + size, y],
        [x, y + size],
        [x - size, y],
      ],
      true,
    );
  else {
    path(
      context,
      Array.from({ length: 10 }, (_, i) => {
        const [radius, angle] = [i % 2 ? size * 0.45 : size, (i * Math.PI) / 5 - Math.PI / 2];
        return [x + radius * Math.cos(angle), y + radius * Math.sin(angle)];
      }),
      true,
    );
  }
  stroke(context, colour(name), scale < 1 ? 1.3 : 2, scale < 1 ? 1 : 2.5);
  if (shape === "star") {
    context.fillStyle = colour(name);
    context.fill();
  }
}

function lines(context, ...parts) {
  for (const [[ax, ay], [bx, by]] of parts) {
    context.moveTo(ax, ay);
    context.lineTo(bx, by);
  }
}

function path(context, corners, isClosed = false) {
  context.beginPath();
  corners.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
  if (isClosed) context.closePath();
}

/** Draws the current path with a halo in the colour of the stage. */
function stroke(context, accent, width, halo = 2.5) {
  context.lineJoin = "round";
  context.strokeStyle = colour("stage");
  context.lineWidth = width + halo;
  context.stroke();
  context.strokeStyle = accent;
  context.lineWidth = width;
  context.stroke();
}

function label(context, text, x, y, align = "center") {
  context.font = "600 12px 'Segoe UI','Helvetica Neue','Liberation Sans','DejaVu Sans',Arial,sans-serif";
  context.textAlign = align;
  context.lineWidth = 3;
  context.lineJoin = "round";
  context.strokeStyle = colour("stage");
  context.strokeText(text, x, y);
  context.fillStyle = colour("text");
  context.fillText(text, x, y);
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
])
  on(name, redrawOverlay);
