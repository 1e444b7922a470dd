// Legend: the attribute that colours the points, its colours, unit and range.

import { byId, fill, make } from "./elements.js";
import { choose, colouring, css, MAPS, recolour } from "./colours.js";
import { significant, unitAfter } from "./format.js";
import { emit, on, state } from "./state.js";
import { stage } from "./stage.js";

/** Attributes as entries of the list; `flags` gives one for each flag. */
function entries() {
  const plain = state.info.attributes.filter(({ name }) => name !== "flags");
  const flags = state.info.attributes.some(({ name }) => name === "flags") ? state.info.flags : [];
  const text = ({ label, unit }) => (unit ? `${label}, ${unit}` : label);
  return [
    ...plain.map((one) => make("option", { value: one.name }, text(one))),
    flags.length
      ? make(
          "optgroup",
          { label: "Flags" },
          ...flags.map(({ bit, name }) => make("option", { value: `flag ${bit}` }, name)),
        )
      : null,
  ];
}

function fillList() {
  const list = byId("attribute");
  const names = state.info.attributes.map(({ name }) => name).join();
  if (list.dataset.names !== names) {
    list.dataset.names = names;
    fill(list, ...entries());
  }
  if (!state.info.attributes.some(({ name }) => name === state.attribute) && state.info.attributes.length) {
    state.attribute = state.info.attributes[0].name;
  }
  list.value = state.flagBit === null ? state.attribute : `flag ${state.flagBit}`;
}

function setAttribute(value) {
  state.flagBit = value.startsWith("flag ") ? Number(value.slice(5)) : null;
  state.attribute = state.flagBit === null ? value : "flags";
  update();
  emit("attribute");
}

/** Shades shapes in perspective, or not. */
export function toggleShading() {
  state.isShaded = !state.isShaded;
  byId("shading").checked = state.isShaded;
  stage.redraw();
}

/** Colours the points by the next attribute of the list. */
export function nextAttribute() {
  const list = byId("attribute");
  list.selectedIndex = (list.selectedIndex + 1) % list.length;
  setAttribute(list.value);
}

function update() {
  // Before the first points there is nothing to colour.
  if (state.info.attributes.length === 0) return;
  recolour();
  show();
  stage.redraw();
  emit("colours");
}

function change(wish) {
  choose(wish);
  show();
  stage.redraw();
  emit("colours");
}

function rangeInput(at, label) {
  const set = (event) => {
    const value = Number(event.target.value);
    if (event.target.value === "" || Number.isNaN(value)) return show();
    const range = [...colouring.range];
    range[at] = value;
    return range[0] < range[1] ? change({ range }) : show();
  };
  return make("input", {
    type: "number",
    step: "any",
    "aria-label": label,
    title: label,
    value: significant(colouring.range[at]),
    change: set,
  });
}

/** Shows colours and range. */
function show() {
  const { attribute, isClass, table, classes } = colouring;
  const body = byId("legend-body");
  byId("colour-map").disabled = isClass;
  byId("colour-map").value = colouring.map;
  byId("range-reset").disabled = isClass;
  if (!isClass) {
    const stops = Array.from({ length: 9 }, (_, i) => css(table[Math.round((i * 255) / 8)])).join(",");
    const bar = make("div", { class: "colour-bar", style: `background:linear-gradient(90deg,${stops})` });
    fill(
      body,
      bar,
      make(
        "div",
        { class: "row ends" },
        rangeInput(0, "Lower end of the colours"),
        make("span", { class: "unit" }, attribute.unit || ""),
        rangeInput(1, "Upper end of the colours"),
      ),
    );
    return;
  }
  fill(
    body,
    make(
      "ul",
      { class: "classes" },
      ...classes.map((one) =>
        make(
          "li",
          {},
          make(
            "button",
            {
              "aria-pressed": String(!one.hidden),
              title: one.hidden ? "Show" : "Hide",
              click: () => {
                one.hidden = !one.hidden;
                change({});
              },
            },
            make("i", { style: `background:${css(one.colour)}` }),
            one.label + unitAfter(attribute.unit),
          ),
        ),
      ),
    ),
  );
}

byId("attribute").addEventListener("change", (event) => setAttribute(event.target.value));
fill(byId("colour-map"), ...MAPS.map((name) => make("option", {}, name)));
byId("colour-map").addEventListener("change", (event) => change({ map: event.target.value }));
byId("range-reset").addEventListener("click", () => change(null));
/** Sizes for few points, until the user chooses one: limit of the number of points, and size, px. */
const SIZES = [
  [5_000, 4],
  [50_000, 3],
  [Infinity, 2],
];
let isSizeChosen = false;
byId("point-size").addEventListener("input", (event) => {
  isSizeChosen = true;
  state.pointSize = Number(event.target.value);
  stage.redraw();
  emit("colours");
});
byId("shading").addEventListener("change", toggleShading);
byId("point-limit").addEventListener("change", (event) => {
  state.pointLimit = Number(event.target.value);
  stage.redraw();
});
byId("drawing").textContent =
  stage.painterName === "WebGL" ? "Drawn by WebGL." : "Drawn without a graphics processor.";

on("info", () => {
  fillList();
  if (!isSizeChosen) {
    state.pointSize = SIZES.find(([limit]) => state.info.points < limit)[1];
    byId("point-size").value = state.pointSize;
  }
  update();
});
on("scheme", () => {
  if (state.info) update();
});
