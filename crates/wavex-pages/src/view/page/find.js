// Find: lists shots by an attribute, a flag or conditions, and steps through them.

import { getJson } from "./api.js";
import { byId, fill, make, problem } from "./elements.js";
import { count, significant } from "./format.js";
import { emit, on, relative, select, state } from "./state.js";
import { columnsTable } from "./find_columns.js";
import { isMarked } from "./marks.js";
import { isWithoutWaveforms } from "./point.js";
import { stage } from "./stage.js";

/** Largest number of shots in the list. */
const LIMIT = 500;
/** The worst fits end at this deviation ratio, and after this many shots. */
const WORST = { ratio: 3, limit: 50 };
const page = byId("page-find");
const sort = make("select", { id: "find-sort", "aria-label": "Sort by" });
const order = make(
  "select",
  { "aria-label": "Order" },
  make("option", { value: "true" }, "largest first"),
  make("option", { value: "false" }, "smallest first"),
);
const flag = make("select", { id: "find-flag", "aria-label": "Flag" });
const where = make("input", {
  type: "text",
  id: "find-where",
  placeholder: "amplitude_dn > 20, return_number = 1",
  spellcheck: "false",
  autocomplete: "off",
});
const presets = make("div", { class: "bar wrap", role: "group", "aria-label": "Presets" });
const columns = make("div");
const results = make("div", { id: "found" });
let request = null;

/** Presets: label, attribute, order, words of a flag, conditions, limit, and what it says without results. */
const PRESETS = [
  ["Worst fits", "deviation_ratio", true, null, `deviation_ratio >= ${WORST.ratio}`, WORST.limit, noBadFit],
  ["Overlapping", "deviation_ratio", true, /overlap/],
  ["Saturated", "amplitude_dn", true, /saturat/],
  ["Weakest", "amplitude_dn", false],
  ["Uncertain zone", "total_sd_m", true, /zone|ambig/],
  ["Largest uncertainty", "total_sd_m", true],
];

/** Why there are no worst fits. */
function noBadFit() {
  const [, largest] = state.info.attributes.find(({ name }) => name === "deviation_ratio").extent;
  return `No fit has a deviation ratio of ${WORST.ratio} or more; the largest is ${significant(largest, 3)}.`;
}

function buildPresets() {
  const names = state.info.attributes.map(({ name }) => name);
  const buttons = PRESETS.map(([label, attribute, descending, words, conditions, limit, whyNone]) => {
    const by = [attribute, "range_sd_m", "amplitude_dn", names[0]].find((name) => names.includes(name));
    const found = words && state.info.flags.find(({ name }) => words.test(name));
    if ((words && !found) || (!words && by !== attribute && attribute !== "total_sd_m")) return null;
    return make(
      "button",
      {
        click: () => {
          sort.value = by;
          order.value = String(descending);
          flag.value = found ? found.name : "";
          where.value = conditions ?? "";
          search(limit, whyNone);
        },
      },
      label,
    );
  });
  fill(presets, ...buttons);
}

function build() {
  const numbers = state.info.attributes.filter(({ name }) => name !== "flags");
  const names = numbers.map(({ name }) => name).join() + state.info.flags.map(({ name }) => name).join();
  if (page.dataset.names === names) return;
  page.dataset.names = names;
  const before = [sort.value, flag.value];
  fill(
    sort,
    ...numbers.map(({ name, label, unit }) =>
      make("option", { value: name }, unit ? `${label}, ${unit}` : label),
    ),
  );
  fill(
    flag,
    make("option", { value: "" }, "any"),
    ...state.info.flags.map(({ name }) => make("option", { value: name }, name)),
  );
  if (numbers.some(({ name }) => name === "deviation_ratio")) sort.value = "deviation_ratio";
  if (before[0]) [sort.value, flag.value] = before;
  buildPresets();
  fill(columns, columnsTable(useColumn));
  if (page.childElementCount) return;
  fill(
    page,
    presets,
    make(
      "form",
      {
        class: "find",
        submit: (event) => {
          event.preventDefault();
          search();
        },
      },
      make("label", {}, "Conditions ", where),
      make("p", { class: "faint", id: "find-names" }, "Joined by commas, with = < > <= >=."),
      make(
        "div",
        { class: "row wrap" },
        make("label", {}, "Sort by ", sort),
        order,
        make("label", {}, "Flag ", flag),
        make("button", { class: "primary" }, "Find"),
      ),
    ),
    columns,
    results,
  );
}

/** Adds a column to the conditions. */
function useColumn(name) {
  const before = where.value.trim();
  where.value = `${before}${before && !before.endsWith(",") ? ", " : before ? " " : ""}${name} `;
  where.focus();
}

/** Searches and selects the first shot found; `whyNone` gives the text without results. */
async function search(limit = LIMIT, whyNone = () => "No shot fulfils the conditions.") {
  request?.abort();
  request = new AbortController();
  fill(results, make("p", { class: "faint", role: "status" }, "Searching …"));
  try {
    const conditions = where.value
      .split(",")
      .map((one) => one.trim().replace(/\s*([<>]=?|=)\s*/, "$1"))
      .filter(Boolean)
      .join(",");
    const answer = await getJson(
      "find",
      {
        generation: state.generation,
        sort: sort.value,
        descending: order.value,
        where: conditions,
        flag: flag.value,
        limit,
      },
      request.signal,
    );
    state.found = answer.found;
    state.foundAt = -1;
    if (answer.found.length) show(answer.total, sort.value, limit);
    else fill(results, make("p", { role: "status", id: "found-none" }, whyNone()));
    emit("found");
    if (answer.found.length > 0) go(0);
  } catch (error) {
    if (error.name === "AbortError") return;
    if (error.status === 410) emit("loading-failed", error);
    state.found = [];
    emit("found");
    fill(results, problem(error.message));
  }
}

function show(total, by, limit) {
  const attribute = state.info.attributes.find(({ name }) => name === by);
  const several = state.info.inputs.length > 1;
  const row = (each, i) =>
    make(
      "tr",
      { "data-at": i, click: () => go(i) },
      make("td", {}, `${i + 1}`),
      several ? make("td", { class: "text" }, state.info.inputs[each.input]?.name || "") : null,
      make("td", {}, make("button", { class: "link", "aria-label": `Shot ${each.shot}` }, `${each.shot}`)),
      make("td", {}, `${each.return_number}`),
      make("td", {}, significant(each.value)),
      make("td", { class: "star" }, isMarked(each) ? "★" : ""),
    );
  const heads = [
    "",
    several ? "input" : null,
    "shot",
    "return",
    `${attribute.label}${attribute.unit ? `, ${attribute.unit}` : ""}`,
    "",
  ].filter((text) => text !== null);
  fill(
    results,
    make(
      "div",
      { class: "bar" },
      make(
        "p",
        { role: "status", id: "found-count" },
        `${count(total)} ${total === 1 ? "return" : "returns"}; ${state.found.length >= limit ? "first " : ""}${count(state.found.length)} ${state.found.length === 1 ? "shot" : "shots"} listed`,
      ),
      make(
        "button",
        {
          title: "Previous shot of the list (p)",
          click: () => stepFound(-1),
          "aria-label": "Previous of the list",
        },
        "◂",
      ),
      make(
        "button",
        { title: "Next shot of the list (n)", click: () => stepFound(1), "aria-label": "Next of the list" },
        "▸",
      ),
      make("button", { click: clear }, "Clear"),
    ),
    make(
      "div",
      { class: "scroll tall" },
      make(
        "table",
        { class: "list found" },
        make("thead", {}, make("tr", {}, ...heads.map((text) => make("th", { scope: "col" }, text)))),
        make("tbody", {}, ...state.found.map(row)),
      ),
    ),
  );
}

function clear() {
  state.found = [];
  state.foundAt = -1;
  fill(results);
  emit("found");
}

/** Selects a shot of the list. */
function go(at) {
  state.foundAt = at;
  for (const row of results.querySelectorAll("tr[data-at]"))
    row.classList.toggle("current", Number(row.dataset.at) === at);
  results.querySelector("tr.current")?.scrollIntoView({ block: "nearest" });
  const { input, shot, return_number: number, index, position } = state.found[at];
  if (isWithoutWaveforms()) {
    stage.centre(relative(position));
    emit("found-point", index);
    return;
  }
  select(input, shot, number, { move: true });
}

/** Selects the next or previous shot of the list. */
export function stepFound(direction) {
  if (state.found.length === 0) return;
  go(Math.min(state.found.length - 1, Math.max(0, state.foundAt + direction)));
}

/** Opens the page with the cursor in the conditions. */
export function focusFind() {
  emit("open-tab", "find");
  where.focus();
}

on("info", build);
on("marks", () => {
  for (const row of results.querySelectorAll("tr[data-at]"))
    row.querySelector(".star").textContent = isMarked(state.found[Number(row.dataset.at)]) ? "★" : "";
});
