// Columns by which points are searched: names, units and ranges.

import { make } from "./elements.js";
import { significant, unitAfter } from "./format.js";
import { state } from "./state.js";

/** Most values of a class that are listed one by one. */
const MOST_VALUES = 6;

/** Range of a column as text. */
function rangeOf({ name, kind, unit, values, extent: [low, high] }) {
  if (name === "input" && !state.info.without_waveforms)
    return state.info.inputs.map((input, i) => `${i} ${input.name}`).join(", ");
  if (kind === "class" && values.length <= MOST_VALUES) return values.join(", ");
  return `${significant(low)} to ${significant(high)}${unitAfter(unit)}`;
}

/** Table of the columns; `use(name)` is called when one is chosen. */
export function columnsTable(use) {
  const row = (attribute) =>
    make(
      "tr",
      {},
      make(
        "td",
        {},
        make("button", { class: "link", type: "button", click: () => use(attribute.name) }, attribute.name),
      ),
      make("td", { class: "text" }, attribute.label),
      make("td", { class: "text" }, rangeOf(attribute)),
    );
  const columns = state.info.attributes.filter(({ name }) => name !== "flags");
  return make(
    "details",
    { id: "columns" },
    make("summary", {}, "Columns and their ranges"),
    make(
      "div",
      { class: "scroll" },
      make(
        "table",
        { class: "list columns" },
        make(
          "thead",
          {},
          make("tr", {}, ...["column", "meaning", "range"].map((text) => make("th", { scope: "col" }, text))),
        ),
        make("tbody", {}, ...columns.map(row)),
      ),
    ),
  );
}
