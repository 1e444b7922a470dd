// Starts the page: asks the server what is open, follows its progress, and connects the parts.

import { connection, getJson } from "./api.js";
import { announce, byId, download, fill, make } from "./elements.js";
import { count, counted } from "./format.js";
import { darkScheme, emit, on, state } from "./state.js";
import { stage } from "./stage.js";
import { draw as drawOverlay, redrawOverlay } from "./overlay.js";
import "./layers.js";
import "./legend.js";
import "./clip.js";
import "./interaction.js";
import "./shot.js";
import "./what_if.js";
import "./find.js";
import "./marks.js";
import "./map_legend.js";
import { measured } from "./measure.js";
import "./profile.js";
import "./waterfall.js";
import "./keyboard.js";

/** Time between two requests for the state: while reading, and while the server is lost, ms. */
const POLL_MS = 700;
const LOST_MS = 2000;
let opening = 0;

let timer = 0;
let isPolling = false;

/** Asks for the state and opens new generations. */
async function poll() {
  if (isPolling) return;
  isPolling = true;
  clearTimeout(timer);
  let pause = LOST_MS;
  try {
    const info = await getJson("info");
    const isFirst = state.info === null;
    const before = state.info;
    state.info = info;
    const changed =
      isFirst ||
      before.generation !== info.generation ||
      JSON.stringify(before.attributes) !== JSON.stringify(info.attributes) ||
      JSON.stringify(before.keys) !== JSON.stringify(info.keys) ||
      (before.layers || []).length !== (info.layers || []).length;
    if (changed) emit("info");
    showStatus();
    const isOpen = info.generation === 0 || info.generation === opening || (await open(info.generation));
    pause = info.state === "reading" || !isOpen ? POLL_MS : 0;
  } catch (error) {
    byId("status-text").textContent = error.message;
  }
  isPolling = false;
  if (pause > 0) timer = setTimeout(poll, pause);
}

/** Opens a generation; the first one is shown whole. Whether it could be opened. */
async function open(generation) {
  opening = generation;
  const isFirst = stage.cloud === null;
  try {
    await stage.open(generation);
  } catch (error) {
    // The generation may have been replaced since.
    opening = 0;
    if (error.status !== 410) announce(error.message, true);
    return false;
  }
  const bounds = JSON.stringify([state.info.usual_min, state.info.usual_max]);
  if (isFirst || (stage.showsAll && bounds !== shownBounds)) stage.fit();
  shownBounds = bounds;
  return true;
}

let shownBounds = "";

const KINDS = { recording: "recording", points: "points", job: "job", folder: "survey" };

function showStatus() {
  const { info } = state;
  byId("title").textContent = info.title;
  byId("title").title = [`${KINDS[info.kind] || info.kind} ${info.title}`, info.crs, `wavex ${info.version}`]
    .filter(Boolean)
    .join("\n");
  document.title = `${info.title} – wavex view`;
  const progress = byId("progress");
  progress.hidden = info.state !== "reading";
  progress.value = info.progress || 0;
  const status = byId("status");
  status.classList.toggle("problem", info.state === "failed");
  if (info.state === "failed")
    byId("status-text").textContent = `Reading failed: ${info.error || "unknown error"}`;
  else showCount();
  const { warnings } = info;
  byId("warnings").hidden = warnings.length === 0;
  byId("warnings-count").textContent = counted(warnings.length, "warning");
  fill(byId("warnings-list"), ...warnings.map((text) => make("li", {}, text)));
  byId("empty").hidden = info.generation > 0 && info.points > 0;
  byId("empty").textContent =
    info.state === "reading"
      ? "Reading the first points …"
      : info.state === "failed"
        ? info.error || ""
        : "There are no points.";
}

function showCount() {
  const { info } = state;
  const total =
    info.kept_one_of > 1
      ? `${count(info.points)} points of every ${count(info.kept_one_of)}th shot`
      : counted(info.points, "point");
  const reading =
    info.state === "reading" ? `Reading, ${Math.floor(100 * (info.progress || 0))}\u202f%: ` : "";
  const drawn = stage.pointsDrawn < info.points ? `, ${count(stage.pointsDrawn)} drawn` : "";
  byId("status-text").textContent = `${reading}${total}${drawn}`;
}

/** Opens a tab of the panel. */
function openTab(name) {
  document.body.dataset.tab = name;
  for (const tab of document.querySelectorAll("[role=tab]")) {
    const isOpen = tab.id === `tab-${name}`;
    tab.setAttribute("aria-selected", String(isOpen));
    tab.tabIndex = isOpen ? 0 : -1;
    byId(tab.getAttribute("aria-controls")).hidden = !isOpen;
  }
  byId("pages").scrollTop = 0;
  emit("tab", name);
}

for (const tab of document.querySelectorAll("[role=tab]"))
  tab.addEventListener("click", () => openTab(tab.id.slice(4)));
byId("tabs").addEventListener("keydown", (event) => {
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
  if (!step) return;
  const tabs = [...document.querySelectorAll("[role=tab]:not([hidden])")];
  const next = tabs[(tabs.indexOf(document.activeElement) + step + tabs.length) % tabs.length];
  next.focus();
  next.click();
});
on("open-tab", openTab);
openTab("shot");

/** Saves map or perspective with all that lies over it. */
function saveMap() {
  const { canvas, camera } = stage;
  const picture = make("canvas", { width: canvas.width, height: canvas.height });
  const context = picture.getContext("2d");
  context.drawImage(canvas, 0, 0);
  const over = make("canvas", { width: canvas.width, height: canvas.height });
  const overContext = over.getContext("2d");
  const ratio = canvas.width / camera.width;
  overContext.scale(ratio, ratio);
  drawOverlay({ context: overContext, width: camera.width, height: camera.height });
  context.drawImage(over, 0, 0);
  picture.toBlob((blob) =>
    download(
      `${state.info.title.replace(/\.[^.]*$/, "").replace(/[^\w.-]+/g, "_")}_${camera.isOrbit ? "3d" : "map"}.png`,
      blob,
    ),
  );
}
byId("save-map").addEventListener("click", saveMap);

connection.addEventListener("lost", () => {
  byId("lost").hidden = false;
});
connection.addEventListener("found", () => {
  byId("lost").hidden = true;
  stage.cloud?.retry();
});
on("loading-failed", (error) => {
  if (error.status === 410) poll();
  else if (error.status !== 0) announce(error.message, true);
});
let countedAt = 0;
on("frame", () => {
  if (performance.now() - countedAt > 200 && state.info?.state !== "failed") {
    countedAt = performance.now();
    showCount();
  }
});
on("rest", () => {
  if (state.info) showCount();
});
darkScheme.addEventListener("change", () => emit("scheme"));
new ResizeObserver(redrawOverlay).observe(byId("stage"));

/** For tests and scripts. */
window.wavexView = Object.freeze({
  /** Number of points in the picture. */
  pointsDrawn: () => stage.pointsDrawn,
  /** Number of points in the picture that are not hidden, by the legend or a clip. */
  pointsShown: () => stage.pointsShown,
  /** Measured points and distances; null without. */
  measured: () => measured(),
  /** Clipped region; null without. */
  clip: () => structuredClone(state.clip),
  /** Line of the profile; null without. */
  profile: () => structuredClone(state.profile),
  /** Ground along the line of the profile, in parts. */
  ground: () => structuredClone(state.ground),
  /** Clicked point of a file without waveforms; null without. */
  point: () => structuredClone(state.point),
  /** Whether all points of the view are loaded and drawn. */
  isComplete: () =>
    Boolean(
      stage.cloud && !stage.next && stage.cloud.isComplete && stage.queue.length === 0 && !stage.scheduled,
    ),
  /** Screen position of a drawn point, CSS px from the corner of the window; null if it is not drawn. */
  screenOf: (index) => {
    const at = stage.screenOf(index);
    const box = byId("stage").getBoundingClientRect();
    return at && [at[0] + box.left, at[1] + box.top];
  },
  /** Mean of the last movement. */
  framesPerSecond: () => stage.framesPerSecond(),
  /** Selected shot, with the keys of the job. */
  shot: () => state.shot && structuredClone(state.shot),
  /** Selected shot with the changed keys; null without. */
  changedShot: () => state.changedShot && structuredClone(state.changedShot),
  found: () => structuredClone(state.found),
  generation: () => state.generation,
  painter: () => stage.painterName,
});

poll();
