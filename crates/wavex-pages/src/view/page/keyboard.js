// Keys of the page, and the help that lists them.

import { byId, fill, make } from "./elements.js";
import { emit, state } from "./state.js";
import { clipTool } from "./clip.js";
import { setView, stageKey } from "./interaction.js";
import { closeDock } from "./dock.js";
import { nextAttribute, toggleShading } from "./legend.js";
import { measureTool } from "./measure.js";
import { profileTool } from "./profile.js";
import { enlarge, step, toggleJobKeys } from "./shot.js";
import { focusFind, stepFound } from "./find.js";
import { toggleMark } from "./marks.js";
import { toggleLine } from "./waterfall.js";
import { currentTool, setTool, toggleTool } from "./tools.js";
import { stage } from "./stage.js";
import { relative } from "./state.js";

/** Keys: key, what it does, function. */
const KEYS = [
  ["1", "Map from above", () => setView(false)],
  ["2", "Perspective view", () => setView(true)],
  ["c", "Colour by the next attribute", nextAttribute],
  ["v", "Shade shapes in perspective, or not", toggleShading],
  ["l", "Profile along a line of two clicks", () => toggleTool(profileTool)],
  ["d", "Distance and height difference of two clicks", () => toggleTool(measureTool)],
  ["x", "Clip to a box or polygon; again: show all points", () => toggleTool(clipTool)],
  ["t", "Waveforms of the scan line", toggleLine],
  ["[", "Previous shot", () => step(-1)],
  ["]", "Next shot", () => step(1)],
  ["g", "Move the map to the selected shot", goToShot],
  ["e", "Enlarge the picture", enlarge],
  ["b", "Picture with the keys of the job or the changed ones", toggleJobKeys],
  ["m", "Mark the shot or remove its mark", toggleMark],
  ["s", "Shot", () => emit("open-tab", "shot")],
  ["w", "What if", () => emit("open-tab", "what-if")],
  ["f", "Find", focusFind],
  ["n", "Next shot of the list", () => stepFound(1)],
  ["p", "Previous shot of the list", () => stepFound(-1)],
  ["?", "This help", () => byId("help").showModal()],
];
/** Keys and gestures that other parts handle. */
const OTHERS = [
  ["Drag", "Move the map; turn the perspective view (Shift or right button: move)"],
  ["Wheel, + −", "Zoom; two fingers also move"],
  ["Arrows", "Move the map; turn the perspective view"],
  ["0", "Show all points but outliers"],
  ["Click", "Select the shot of a point, in map, perspective, profile or scan line"],
  ["Space", "Click in the middle of the map, for the active tool too"],
  ["Enter", "Close the polygon of a clip"],
  ["Esc", "Close the dialog or the dock; end the tool"],
];

function goToShot() {
  const position = state.shot?.returns.find((each) => each.position)?.position;
  if (position) stage.centre(relative(position));
}

function help() {
  const rows = [...OTHERS, ...KEYS].map(([key, text]) =>
    make("tr", {}, make("td", {}, make("kbd", {}, key)), make("td", {}, text)),
  );
  fill(byId("help-body"), make("table", { class: "keys-list" }, make("tbody", {}, ...rows)));
}

function pressed(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  const isText = event.target.closest?.("input:not([type=range]):not([type=checkbox]), select, textarea");
  if (event.key === "Escape") {
    for (const open of document.querySelectorAll("details.popover[open]")) open.open = false;
    if (isText) event.target.blur();
    else if (currentTool()) setTool(null);
    else closeDock();
    return;
  }
  if (
    isText ||
    (event.target.closest?.("input[type=range]")?.matches(":focus") && event.key.startsWith("Arrow"))
  )
    return;
  if (stageKey(event)) {
    event.preventDefault();
    return;
  }
  const found = KEYS.find(([key]) => key === event.key);
  if (!found || !state.info) return;
  event.preventDefault();
  found[2]();
}

document.addEventListener("keydown", pressed);
byId("show-help").addEventListener("click", () => byId("help").showModal());
// A click beside an open popover or dialog closes it.
document.addEventListener("pointerdown", (event) => {
  for (const open of document.querySelectorAll("details.popover[open]"))
    if (!open.contains(event.target)) open.open = false;
});
for (const dialog of document.querySelectorAll("dialog"))
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close();
  });
help();
