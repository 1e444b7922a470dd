// Axes of the pictures in the dock.

import { colour } from "./elements.js";
import { ticks } from "./format.js";

const FONT = "12px 'Segoe UI','Helvetica Neue','Liberation Sans','DejaVu Sans',Arial,sans-serif";

/** Draws frame, grid and labels. `x` and `y`: from [low, high] to pixels, and a label with unit. */
export function drawAxes(context, { left, top, right, bottom }, x, y) {
  context.font = FONT;
  context.lineWidth = 1;
  const at = ({ range: [low, high] }, value, from, to) => from + ((value - low) / (high - low)) * (to - from);
  context.fillStyle = colour("faint");
  context.strokeStyle = colour("grid");
  const line = (x0, y0, x1, y1) => {
    context.beginPath();
    context.moveTo(Math.round(x0) + 0.5, Math.round(y0) + 0.5);
    context.lineTo(Math.round(x1) + 0.5, Math.round(y1) + 0.5);
    context.stroke();
  };
  const horizontal = ticks(Math.min(...x.range), Math.max(...x.range), (right - left) / 90);
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const value of horizontal.values) {
    const px = at(x, value, left, right);
    line(px, top, px, bottom);
    if (px > left + 8 && px < right - 8) context.fillText(value.toFixed(horizontal.digits), px, bottom + 4);
  }
  const vertical = ticks(Math.min(...y.range), Math.max(...y.range), (bottom - top) / 40);
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const value of vertical.values) {
    const py = at(y, value, bottom, top);
    line(left, py, right, py);
    context.fillText(value.toFixed(vertical.digits), left - 5, Math.min(bottom - 5, Math.max(top + 5, py)));
  }
  context.strokeStyle = colour("frame");
  context.strokeRect(left + 0.5, top + 0.5, right - left, bottom - top);
  context.textAlign = "center";
  context.textBaseline = "bottom";
  context.fillText(x.label, (left + right) / 2, bottom + 34);
  context.save();
  context.translate(12, (top + bottom) / 2);
  context.rotate(-Math.PI / 2);
  context.textBaseline = "middle";
  context.fillText(y.label, 0, 0);
  context.restore();
}
