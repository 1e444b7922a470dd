// Symbols of marks on the map, and lines and texts with a halo.

import { colour, make } from "./elements.js";

/** Symbols: colour and shape of each kind of mark. */
export const SYMBOLS = {
  found: { name: "accent", shape: "circle", size: 3.5 },
  marked: { name: "star", shape: "star", size: 7 },
  new: { name: "new", shape: "plus", size: 6 },
  gone: { name: "gone", shape: "cross", size: 5 },
  moved: { name: "moved", shape: "diamond", size: 5 },
  selected: { name: "selected", shape: "ring", size: 9 },
  measured: { name: "accent", shape: "ring", size: 5 },
  corner: { name: "accent", shape: "ring", size: 6 },
};

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

/** Starts the path of a line through screen positions. */
export function path(context, corners, isClosed = false) {
  context.beginPath();
  corners.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
  if (isClosed) context.closePath();
}

/** Draws the current path with a halo in the colour of the stage. */
export function stroke(context, accent, width, halo = 2.5) {
  context.lineJoin = "round";
  context.strokeStyle = colour("stage");
  context.lineWidth = width + halo;
  context.stroke();
  context.strokeStyle = accent;
  context.lineWidth = width;
  context.stroke();
}

/** Draws a text with a halo. */
export function label(context, text, x, y, align = "center") {
  context.font = "600 12px 'Segoe UI','Helvetica Neue','Liberation Sans','DejaVu Sans',Arial,sans-serif";
  context.textAlign = align;
  context.lineWidth = 3;
  context.lineJoin = "round";
  context.strokeStyle = colour("stage");
  context.strokeText(text, x, y);
  context.fillStyle = colour("text");
  context.fillText(text, x, y);
}

/** Picture of a symbol for texts. */
export function sign(kind) {
  const canvas = make("canvas", { width: 40, height: 40, class: "sign", "aria-hidden": "true" });
  const context = canvas.getContext("2d");
  context.scale(2, 2);
  symbol(context, kind, 10, 10);
  return canvas;
}
