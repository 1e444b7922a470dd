// Rasters of a survey and terrain models over the map.

import { address } from "./api.js";
import { announce, byId, fill, make } from "./elements.js";
import { significant, unitAfter } from "./format.js";
import { emit, on, state } from "./state.js";

const DEFAULT_OPACITY = 0.6;
/** Loaded layers: name to picture, layer, opacity, whether it is shown. */
const loaded = new Map();

/** Layers to draw. */
export function shownLayers() {
  return [...loaded.values()].filter(
    (one) => one.isShown && one.picture.complete && one.picture.naturalWidth > 0,
  );
}

function show(layer, isShown) {
  let one = loaded.get(layer.name);
  if (!one) {
    const picture = new Image();
    picture.onload = () => emit("layers");
    picture.onerror = () => announce(`The layer “${layer.label}” cannot be loaded.`, true);
    one = { picture, layer, opacity: DEFAULT_OPACITY };
    loaded.set(layer.name, one);
    picture.src = address("layer", { name: layer.name });
  }
  one.isShown = isShown;
  emit("layers");
}

function setOpacity(layer, opacity) {
  if (!loaded.has(layer.name)) show(layer, false);
  loaded.get(layer.name).opacity = opacity;
  emit("layers");
}

function entry(layer) {
  const [low, high] = layer.range || [];
  const range =
    low === undefined || low === null
      ? ""
      : `${significant(low)} to ${significant(high)}${unitAfter(layer.unit)}`;
  return make(
    "li",
    {},
    make(
      "label",
      { class: "check" },
      make("input", { type: "checkbox", change: (event) => show(layer, event.target.checked) }),
      layer.label,
    ),
    make("span", { class: "faint" }, range),
    make(
      "label",
      {},
      "Opacity ",
      make("input", {
        type: "range",
        min: 0,
        max: 1,
        step: 0.05,
        value: DEFAULT_OPACITY,
        input: (event) => setOpacity(layer, Number(event.target.value)),
      }),
    ),
  );
}

on("info", () => {
  const layers = state.info.layers || [];
  const page = byId("page-layers");
  byId("tab-layers").hidden = layers.length === 0;
  const names = layers.map(({ name }) => name).join();
  if (page.dataset.names === names) return;
  page.dataset.names = names;
  fill(
    page,
    make("p", { class: "faint" }, "Rasters of the folder, drawn over the map from above."),
    make("ul", { class: "layers" }, ...layers.map(entry)),
  );
});
