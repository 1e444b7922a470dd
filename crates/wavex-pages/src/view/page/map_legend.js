// Legend of the marks on the map: new, gone and moved returns, results of a search, marked shots.

import { byId, fill, make } from "./elements.js";
import { count } from "./format.js";
import { on, state } from "./state.js";
import { sign } from "./symbols.js";

/** Number of marks of each kind of difference: of the comparison, or else of the selected shot. */
function differences() {
  const { comparison } = state;
  const changes = state.changedShot?.difference?.changes ?? [];
  return ["new", "gone", "moved"].map((kind) => [
    kind,
    comparison
      ? (comparison[`${kind}_total`] ?? comparison[kind].length)
      : changes.filter(({ change }) => change === kind).length,
  ]);
}

function show() {
  const isCompared = state.comparison || state.changedShot?.difference;
  const rows = [
    ...(isCompared ? differences() : []),
    ...(state.found.length ? [["found", state.found.length]] : []),
    ...(state.marks.size ? [["marked", state.marks.size]] : []),
  ];
  byId("symbols").hidden = rows.length === 0;
  fill(
    byId("symbols"),
    ...rows.map(([kind, number]) =>
      make(
        "li",
        { "data-kind": kind },
        sign(kind),
        `${kind} `,
        make("span", { class: "faint" }, count(number)),
      ),
    ),
  );
}

for (const name of ["compared", "shot", "found", "marks", "scheme", "keys"]) on(name, show);
