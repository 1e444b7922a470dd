// Tools of the stage that take clicks or a drag: profile, distance, clip. At most one is active.

import { byId } from "./elements.js";
import { emit } from "./state.js";

let current = null;

/**
 * Adds a tool to its button. A tool has `button` (id), `hint`, `click(at)` and `cancel()`, which drops what
 * is unfinished; it may have `needsMap`, `move(at)`, `drag(from, to, isDone)`, `finish()`, and `press()` instead
 * of starting and ending it. Positions are CSS pixels of the stage.
 */
export function addTool(tool) {
  byId(tool.button).addEventListener("click", () => toggleTool(tool));
  return tool;
}

/** The active tool; null: clicks select shots. */
export function currentTool() {
  return current;
}

/** Starts a tool, or ends the active one (null). */
export function setTool(tool) {
  if (tool === current) return;
  const ended = current;
  current = tool;
  ended?.cancel();
  if (ended) byId(ended.button).setAttribute("aria-pressed", "false");
  if (tool) byId(tool.button).setAttribute("aria-pressed", "true");
  byId("stage").classList.toggle("drawing", tool !== null);
  setHint(tool?.hint ?? "");
  emit("tool", tool);
}

/** Starts or ends a tool, as its button does. */
export function toggleTool(tool) {
  if (tool.press?.()) return;
  setTool(tool === current ? null : tool);
}

/** Shows a text above the map; empty: none. */
export function setHint(text) {
  byId("hint").hidden = !text;
  byId("hint").textContent = text;
}
