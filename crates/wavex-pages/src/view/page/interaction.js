// Pointer and keys on the stage: pan, zoom, turn, click a point; what the active tool takes instead.

import { byId } from "./elements.js";
import { fixed } from "./format.js";
import { absolute, emit, mapUnit, on, state } from "./state.js";
import { stage } from "./stage.js";
import { currentTool, setTool } from "./tools.js";

/** Largest movement of a click, px. */
const CLICK_PX = 5;
const TURN_PER_PX = 0.006;
const element = byId("stage");
const pointers = new Map();
let gesture = null;

/** Position of an event on the stage, CSS px. */
function place(event) {
  const box = element.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}

/** Switches between map and perspective. */
export function setView(isOrbit) {
  byId("view-map").setAttribute("aria-pressed", String(!isOrbit));
  byId("view-orbit").setAttribute("aria-pressed", String(isOrbit));
  if (isOrbit && currentTool()?.needsMap) setTool(null);
  stage.setOrbit(isOrbit);
}

function start(event) {
  if (event.target.closest("#tools, #legend")) return;
  element.focus({ preventScroll: true });
  element.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, place(event));
  const at = place(event);
  if (pointers.size === 1) {
    const kind = currentTool()?.drag
      ? "tool"
      : stage.camera.isOrbit && event.button === 0 && !event.shiftKey
        ? "turn"
        : "pan";
    gesture = { kind, begin: at, last: at, hasMoved: false };
  } else {
    if (gesture?.kind === "tool") currentTool()?.cancel();
    gesture = { kind: "pinch", hasMoved: true, ...spread() };
  }
}

/** Middle, distance and direction of two pointers. */
function spread() {
  const [a, b] = [...pointers.values()];
  return {
    middle: [(a[0] + b[0]) / 2, (a[1] + b[1]) / 2],
    apart: Math.hypot(b[0] - a[0], b[1] - a[1]),
    angle: Math.atan2(b[1] - a[1], b[0] - a[0]),
  };
}

function move(event) {
  const at = place(event);
  state.isByKeyboard = false;
  if (!pointers.has(event.pointerId) || !gesture) {
    currentTool()?.move?.(at);
    return readout(at);
  }
  pointers.set(event.pointerId, at);
  if (gesture.kind === "pinch") {
    if (pointers.size < 2) return;
    const now = spread();
    stage.camera.pan(now.middle[0] - gesture.middle[0], now.middle[1] - gesture.middle[1]);
    stage.camera.zoom(now.apart / Math.max(1, gesture.apart), ...now.middle);
    if (stage.camera.isOrbit) stage.camera.turn(-(now.angle - gesture.angle), 0);
    Object.assign(gesture, now);
    return stage.moved();
  }
  if (!gesture.hasMoved && Math.hypot(at[0] - gesture.begin[0], at[1] - gesture.begin[1]) < CLICK_PX) return;
  gesture.hasMoved = true;
  const [dx, dy] = [at[0] - gesture.last[0], at[1] - gesture.last[1]];
  gesture.last = at;
  if (gesture.kind === "tool") return currentTool()?.drag(gesture.begin, at, false);
  if (gesture.kind !== "turn") return stage.pan(dx, dy);
  stage.camera.turn(dx * TURN_PER_PX, dy * TURN_PER_PX);
  stage.moved();
}

function end(event) {
  if (!pointers.delete(event.pointerId) || !gesture) return;
  const ended = gesture;
  if (pointers.size > 0) {
    const [rest] = pointers.values();
    gesture = { kind: stage.camera.isOrbit ? "turn" : "pan", begin: rest, last: rest, hasMoved: true };
    return;
  }
  gesture = null;
  const tool = currentTool();
  if (event.type === "pointercancel") tool?.cancel();
  else if (ended.kind === "tool" && ended.hasMoved) tool?.drag(ended.begin, ended.last, true);
  else if (!ended.hasMoved) click(place(event));
}

/** A click at a position: of the active tool, or on a point. */
function click(at) {
  const tool = currentTool();
  if (tool) return tool.click(at);
  const index = stage.pick(...at);
  if (index !== null) emit("click-point", index);
}

/** Coordinates under the pointer; from above only, where they are unambiguous. */
function readout([x, y]) {
  const box = byId("readout");
  if (!state.info?.origin || stage.camera.isOrbit) {
    box.textContent = "";
    return;
  }
  const [east, north] = absolute(stage.camera.unproject(x, y));
  const digits = stage.camera.scale < 0.05 ? 2 : 1;
  box.textContent = `${fixed(east, digits)}, ${fixed(north, digits)} ${mapUnit()}`;
}

function wheel(event) {
  if (event.target.closest("#legend")) return;
  event.preventDefault();
  const lines = event.deltaMode === 1 ? 16 : 1;
  stage.camera.zoom(Math.exp(-Math.max(-300, Math.min(300, event.deltaY * lines)) * 0.0016), ...place(event));
  stage.moved();
}

/** Keys of the stage; whether the key is one of them. */
export function stageKey(event) {
  const { camera } = stage;
  const isOnStage = document.activeElement === element;
  if (isOnStage && /^(Arrow| )/.test(event.key)) state.isByKeyboard = true;
  if (event.key === " " && isOnStage) {
    click([camera.width / 2, camera.height / 2]);
    return true;
  }
  if (event.key === "Enter" && isOnStage && currentTool()?.finish) {
    currentTool().finish();
    return true;
  }
  const step = 60;
  const turns = camera.isOrbit && !event.shiftKey;
  const arrows = { ArrowLeft: [1, 0], ArrowRight: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
  if (arrows[event.key] && isOnStage) {
    const [dx, dy] = arrows[event.key];
    if (turns) camera.turn(dx * 0.1, -dy * 0.1);
    else {
      stage.pan(dx * step, dy * step);
      return true;
    }
  } else if (event.key === "+" || event.key === "=") camera.zoom(1.4);
  else if (event.key === "-") camera.zoom(1 / 1.4);
  else if (event.key === "0") {
    stage.fit();
    return true;
  } else return false;
  stage.moved();
  return true;
}

element.addEventListener("pointerdown", start);
element.addEventListener("pointermove", move);
element.addEventListener("pointerup", end);
element.addEventListener("pointercancel", end);
element.addEventListener("wheel", wheel, { passive: false });
element.addEventListener("contextmenu", (event) => event.preventDefault());
element.addEventListener("dblclick", (event) => {
  if (event.target.closest("#tools, #legend")) return;
  if (currentTool()) return currentTool().finish?.();
  stage.camera.zoom(2, ...place(event));
  stage.moved();
});
byId("zoom-in").addEventListener("click", () => {
  stage.camera.zoom(1.6);
  stage.moved();
});
byId("zoom-out").addEventListener("click", () => {
  stage.camera.zoom(1 / 1.6);
  stage.moved();
});
byId("fit").addEventListener("click", () => stage.fit());
byId("view-map").addEventListener("click", () => setView(false));
byId("view-orbit").addEventListener("click", () => setView(true));
on("tool", (tool) => {
  if (tool?.needsMap) setView(false);
});
on("camera", () => {
  byId("readout").textContent = "";
});
