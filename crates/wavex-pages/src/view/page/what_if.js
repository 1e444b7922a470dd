// What if: changes keys of the decomposition, and shows what would be different.

import { getJson, getText } from "./api.js";
import { announce, byId, debounced, download, fill, make, problem } from "./elements.js";
import { count, counted, significant, unitAfter } from "./format.js";
import { absolute, emit, on, overrides, select, state } from "./state.js";
import { sign } from "./symbols.js";
import { stage } from "./stage.js";

const page = byId("page-what-if");
/** Ranges of the sliders of keys that have no limits of their own. */
const USUAL = { detection_sigma: [2, 40], split_evidence: [4, 100], template_error: [0.0005, 0.1] };
const summary = make("div", { id: "difference", role: "status" });
const results = make("div", { id: "comparison" });
const controls = new Map();
let request = null;
const lineButton = make(
  "button",
  { click: () => compare("line"), title: "Decompose the scan line of the shot with both sets of keys" },
  "Compare line",
);
const partButton = make("button", { click: () => compare("part") }, "Compare visible");
const resetButton = make("button", { click: reset }, "Reset");
const copyButton = make(
  "button",
  { click: copyJob, title: "Copy the job with the changed keys" },
  "Copy as job",
);
const saveButton = make(
  "button",
  { click: saveJob, title: "Save the job with the changed keys" },
  "Save job",
);

const keysChanged = debounced(150, () => emit("keys"));

/** Sets a key; the value of the job removes the change. */
function set(key, value) {
  if (value === key.value) state.changedKeys.delete(key.key);
  else state.changedKeys.set(key.key, value);
  clearComparison();
  showKeys();
  keysChanged();
}

function valueOf(key) {
  return state.changedKeys.get(key.key) ?? key.value;
}

/** Name of a key without its stage. */
function nameOf(key) {
  return key.key.slice(key.key.lastIndexOf(".") + 1);
}

/** Ends of the slider of a key; null: it has none. */
function ends(key) {
  if (Number.isFinite(key.min) && Number.isFinite(key.max)) return [key.min, key.max];
  return USUAL[nameOf(key)] || null;
}

/** Position of a slider, 0 to 1000, for a value. Wide ranges are logarithmic. */
function slider([low, high]) {
  const isLog = low > 0 && high / low >= 50;
  const [from, to] = isLog ? [Math.log(low), Math.log(high)] : [low, high];
  return {
    place: (value) =>
      Math.round((1000 * ((isLog ? Math.log(Math.max(low, value)) : value) - from)) / (to - from)),
    value: (place) => {
      const at = from + ((to - from) * place) / 1000;
      return Number((isLog ? Math.exp(at) : at).toPrecision(3));
    },
  };
}

/** Input elements of a key, and how they show a value. */
function inputs(key) {
  const id = `key-${key.key.replace(/\W/g, "-")}`;
  if (key.kind === "flag") {
    const box = make("input", { type: "checkbox", id, change: () => set(key, box.checked) });
    return {
      id,
      elements: [box],
      show: (value) => {
        box.checked = value === true;
      },
    };
  }
  if (key.kind === "choice") {
    const list = make(
      "select",
      {
        id,
        change: () =>
          set(
            key,
            key.choices.find((one) => String(one) === list.value),
          ),
      },
      ...key.choices.map((one) => make("option", { value: one }, String(one))),
    );
    return {
      id,
      elements: [list],
      show: (value) => {
        list.value = String(value);
      },
    };
  }
  if (key.kind === "text") {
    const box = make("input", {
      type: "text",
      id,
      spellcheck: "false",
      autocomplete: "off",
      input: debounced(300, () => {
        if (box.value.trim() !== "") set(key, box.value.trim());
      }),
    });
    return {
      id,
      elements: [box],
      show: (value) => {
        if (document.activeElement !== box || box.value.trim() !== value) box.value = value;
      },
    };
  }
  const number = make("input", {
    type: "number",
    id,
    min: key.min,
    max: key.max,
    step: "any",
    input: () => {
      if (number.value !== "" && number.checkValidity()) set(key, Number(number.value));
    },
  });
  const showNumber = (value) => {
    if (document.activeElement !== number || Number(number.value) !== value) number.value = value ?? "";
  };
  const limits = ends(key);
  if (!limits) return { id, elements: [number], show: showNumber };
  const { place, value: at } = slider(limits);
  const range = make("input", {
    type: "range",
    min: 0,
    max: 1000,
    "aria-label": labelOf(key),
    input: () => set(key, at(Number(range.value))),
  });
  return {
    id,
    elements: [range, number],
    show: (value) => {
      showNumber(value);
      range.value = place(value ?? limits[0]);
    },
  };
}

function labelOf({ label }) {
  return label.charAt(0).toUpperCase() + label.slice(1);
}

/** Help without the marks of code. */
function plain(help) {
  return help.replaceAll("`", "");
}

function firstSentence(text) {
  return text.match(/^.*?\.(?=\s[A-Z]|$)/s)?.[0] ?? text;
}

function control(key) {
  const { id, elements, show } = inputs(key);
  const note = make("button", {
    class: "job-value",
    title: "Back to the key of the job",
    click: () => set(key, key.value),
  });
  const element = make(
    "div",
    { class: "key" },
    make(
      "label",
      { for: id, title: plain(key.help) },
      labelOf(key),
      key.unit ? make("span", { class: "faint" }, `, ${key.unit}`) : null,
    ),
    make("div", { class: "inputs" }, ...elements),
    note,
    make("p", { class: "faint help", title: plain(key.help) }, firstSentence(plain(key.help))),
  );
  controls.set(key.key, { key, element, note, show });
  return element;
}

function written(value) {
  return typeof value === "number"
    ? significant(value, 6)
    : value === true
      ? "on"
      : value === false
        ? "off"
        : String(value);
}

/** Shows the values of all keys; marks changed ones. */
function showKeys() {
  for (const { key, element, note, show } of controls.values()) {
    const isChanged = state.changedKeys.has(key.key);
    element.classList.toggle("changed", isChanged);
    note.hidden = !isChanged;
    note.textContent = `job: ${written(key.value)}${unitAfter(key.unit)} ↺`;
    show(valueOf(key));
  }
  const changes = state.changedKeys.size;
  resetButton.disabled = changes === 0;
  lineButton.disabled = changes === 0 || !state.selected;
  allowPart();
  byId("tab-what-if").classList.toggle("changed", changes > 0);
  showDifference();
}

/** In perspective the visible part is no rectangle of the map and may reach the horizon. */
function allowPart() {
  const { isOrbit } = stage.camera;
  partButton.disabled = state.changedKeys.size === 0 || isOrbit;
  partButton.title = isOrbit
    ? "Only with the map from above (1)"
    : "Decompose the visible part of the map with both sets of keys";
}

/** Ends and removes a comparison: it is only valid for its keys. */
function clearComparison() {
  request?.abort();
  fill(results);
  state.comparison = null;
  for (const kind of Object.keys(steps)) steps[kind] = -1;
  emit("compared");
}

/** One line: what changes in the selected shot. */
function showDifference() {
  if (state.changedKeys.size === 0) {
    fill(
      summary,
      make(
        "p",
        { class: "faint" },
        state.selected
          ? "Change a key: the shot is decomposed again at once."
          : "Select a shot, then change a key: it is decomposed again at once.",
      ),
    );
    return;
  }
  const difference = state.changedShot?.difference;
  if (!difference) {
    const failure = state.failure ?? state.changedShot?.problem;
    fill(
      summary,
      failure
        ? problem(failure)
        : make(
            "p",
            { class: "faint" },
            state.selected
              ? "Decomposing …"
              : `${counted(state.changedKeys.size, "key")} changed. Select a shot, or compare the visible part.`,
          ),
    );
    return;
  }
  const of = (kind) => difference.changes.filter(({ change }) => change === kind).length;
  const parts = [`${counted(difference.before, "return")} → ${count(difference.after)}`];
  const kinds = ["new", "gone", "moved"]
    .filter((kind) => of(kind) > 0)
    .map((kind) => make("span", { class: `badge ${kind}` }, `${of(kind)} ${kind}`));
  fill(
    summary,
    make("p", {}, `This shot: ${parts.join("")} `, ...(kinds.length ? kinds : ["no difference"])),
  );
}

function reset() {
  state.changedKeys.clear();
  clearComparison();
  showKeys();
  emit("keys");
}

/** Compares many shots. */
async function compare(what) {
  clearComparison();
  request = new AbortController();
  const set = overrides();
  let params;
  if (what === "line") params = { input: state.selected.input, shot: state.selected.shot, set };
  else {
    const { width, height } = stage.camera;
    const corners = [
      [0, 0],
      [width, 0],
      [0, height],
      [width, height],
    ].map(([x, y]) => absolute(stage.camera.unproject(x, y)));
    const ends = [Math.min, Math.max].map((pick) =>
      [0, 1].map((i) => pick(...corners.map((corner) => corner[i]))),
    );
    params = { generation: state.generation, from: ends[0].join(","), to: ends[1].join(","), set };
  }
  fill(results, make("p", { class: "faint", role: "status" }, "Decomposing …"));
  try {
    const answer = await getJson("compare", params, request.signal);
    state.comparison = answer;
    showComparison(answer, what);
    results.scrollIntoView({ block: "nearest" });
    emit("compared");
  } catch (error) {
    if (error.name === "AbortError") return;
    fill(results, problem(error.message));
    if (error.status === 410) emit("loading-failed", error);
  }
}

function showComparison(answer, what) {
  const share =
    answer.before > 0
      ? ` (${answer.after >= answer.before ? "+" : "−"}${significant((100 * Math.abs(answer.after - answer.before)) / answer.before, 2)}\u202f%)`
      : "";
  const explained = {
    new: "returns only with the changed keys",
    gone: "returns only with the keys of the job",
    moved: "returns at another range",
  };
  const row = (kind) => {
    const total = answer[`${kind}_total`] ?? answer[kind].length;
    const first = answer[kind][0];
    const go = first ? make("button", { class: "link", click: () => stepThrough(kind) }, "step through") : "";
    return make(
      "tr",
      {},
      make("td", {}, sign(kind), kind),
      make("td", {}, count(total)),
      make("td", { class: "text" }, explained[kind]),
      make("td", {}, go),
    );
  };
  fill(
    results,
    make("h3", {}, what === "line" ? "In the scan line" : "In the visible part"),
    make(
      "p",
      {},
      `${counted(answer.shots, "shot")}: ${counted(answer.before, "return")} → ${count(answer.after)}${share}`,
    ),
    answer.limited
      ? make(
          "p",
          { class: "notice" },
          "Only a part was compared: an answer has at most 50 000 shots and takes at most 5 s. Zoom in to compare all.",
        )
      : null,
    make("table", { class: "list" }, make("tbody", {}, ...["new", "gone", "moved"].map(row))),
  );
}

const steps = { new: -1, gone: -1, moved: -1 };

/** Selects the next shot with a difference. */
function stepThrough(kind) {
  const list = state.comparison[kind];
  steps[kind] = (steps[kind] + 1) % list.length;
  const { input, shot, return_number: number } = list[steps[kind]];
  select(input, shot, number, { move: true });
}

async function jobText() {
  try {
    return await getText("job", { set: overrides() });
  } catch (error) {
    announce(error.message, true);
    return null;
  }
}

async function copyJob() {
  const text = await jobText();
  if (text === null) return;
  try {
    await navigator.clipboard.writeText(text);
    announce("The job is in the clipboard.");
  } catch {
    download("job.toml", text);
    announce("The clipboard is not available; the job was saved as job.toml.");
  }
}

async function saveJob() {
  const text = await jobText();
  if (text !== null) download("job.toml", text);
}

function build() {
  const keys = state.info.keys || [];
  const names = keys.map(({ key }) => key).join();
  if (page.dataset.keys === names) return;
  page.dataset.keys = names;
  controls.clear();
  fill(
    page,
    summary,
    make("div", { class: "keys" }, ...keys.map(control)),
    results,
    make("div", { class: "bar wrap actions" }, lineButton, partButton, copyButton, saveButton, resetButton),
  );
  if (keys.length === 0)
    fill(page, make("p", {}, "This input has no waveforms that could be decomposed again."));
  showKeys();
}

on("info", build);
on("shot", showDifference);
on("select", showKeys);
on("camera", allowPart);
on("scheme", () => {
  if (state.comparison) emit("compared");
});
