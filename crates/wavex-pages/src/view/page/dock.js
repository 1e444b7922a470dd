// The dock below the map: the profile or the scan line, one at a time.

import { byId, fill } from "./elements.js";
import { emit, on } from "./state.js";

let content = null;

/** Shows a content: `name`, `controls` (elements), `draw`, `close`. */
export function openDock(next) {
  if (content && content !== next) content.close();
  content = next;
  byId("dock").hidden = false;
  fill(byId("dock-controls"), ...next.controls);
  setMessage("");
  next.draw();
  mark();
}

/** Closes the dock. */
export function closeDock() {
  content?.close();
  content = null;
  byId("dock").hidden = true;
  mark();
}

/** Whether a content is shown. */
export function isDocked(one) {
  return content === one;
}

export function setTitle(text) {
  byId("dock-title").textContent = text;
}

/** Shows a text instead of the picture; empty: the picture. */
export function setMessage(text, isProblem = false) {
  const box = byId("dock-message");
  box.textContent = text;
  box.hidden = !text;
  box.classList.toggle("problem", isProblem);
}

function mark() {
  byId("show-line").setAttribute("aria-pressed", String(content?.name === "line"));
  emit("dock");
}

/** Position of an event on the canvas of the dock, CSS px. */
export function placeInDock(event) {
  const box = byId("dock-canvas").getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

byId("dock-close").addEventListener("click", closeDock);
new ResizeObserver(() => content?.draw()).observe(byId("dock-body"));
for (const name of ["pointerdown", "pointermove", "pointerup", "wheel", "dblclick"]) {
  byId("dock-body").addEventListener(
    name,
    (event) => {
      if (name === "wheel") event.preventDefault();
      content?.[name]?.(event);
    },
    { passive: false },
  );
}
on("scheme", () => content?.draw());
