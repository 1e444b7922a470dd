// The picture of a shot that the server draws: the whole of it, and its panels fitted to the page.

/** Height of the panels relative to the whole picture. */
const TALL = 0.7;
/** Space above and below the panels, and right of them, units of the picture. */
const PAD = 12;
/** Widths of a character of the labels, units of the picture. */
const CHARACTER = 6.8;
/** Distance of a label's base from the middle of its text. */
const BASE = 4;

/** Picture as an element; null if it is not well-formed. */
function parse(text) {
  const parsed = new DOMParser().parseFromString(text, "image/svg+xml");
  return parsed.querySelector("parsererror") ? null : document.importNode(parsed.documentElement, true);
}

/** Puts a picture into an element, where its style sheet stays. */
function put(element, svg) {
  const root = element.shadowRoot || element.attachShadow({ mode: "open" });
  if (!svg) {
    root.replaceChildren("The picture cannot be shown.");
    return;
  }
  const style = document.createElement("style");
  style.textContent = ":host{display:block}svg{display:block;width:100%;height:auto}";
  svg.removeAttribute("width");
  svg.removeAttribute("height");
  root.replaceChildren(style, svg);
}

/** Shows the whole picture. */
export function showWhole(element, text) {
  put(element, parse(text));
}

/** Shows the panels of samples and residuals, fitted to a width; letters keep their size. */
export function showPanels(element, text, width) {
  const svg = parse(text);
  if (svg) fitPanels(svg, width);
  put(element, svg);
}

/** Number of an attribute. */
function at(element, name) {
  return Number(element.getAttribute(name));
}

/** Moves the panels closer together; removes the title, and what is below the axis of time. */
function fitPanels(svg, width) {
  const axis = [...svg.querySelectorAll("text")].find((one) => one.textContent === "time of flight, ns");
  const frames = axis
    ? [...svg.querySelectorAll("rect.frame")].filter((frame) => at(frame, "y") < at(axis, "y"))
    : [];
  if (frames.length === 0) return;
  const left = Math.min(...frames.map((frame) => at(frame, "x")));
  const right = Math.max(...frames.map((frame) => at(frame, "x") + at(frame, "width")));
  const top = Math.min(...frames.map((frame) => at(frame, "y")));
  const bottom = Math.max(...frames.map((frame) => at(frame, "y") + at(frame, "height")));
  const wide = (width - left - PAD) / (right - left);
  const x = (value) => (value < left ? value : left + (value - left) * wide);
  const y = (value) =>
    PAD + (value <= bottom ? (value - top) * TALL : (bottom - top) * TALL + value - bottom);
  const set = (one, name, value) => one.setAttribute(name, value.toFixed(1));
  for (const one of [...svg.querySelectorAll("line,rect,circle,polyline,text")]) {
    const kind = one.tagName;
    const from =
      kind === "line"
        ? at(one, "y1")
        : kind === "circle"
          ? at(one, "cy")
          : kind === "polyline"
            ? Number(one.getAttribute("points").split(/[ ,]/)[1])
            : at(one, "y");
    if (one.classList.contains("page")) continue;
    if (from < top - PAD || (from > at(axis, "y") + 1 && one !== axis)) {
      one.remove();
      continue;
    }
    if (kind === "line") {
      for (const name of ["x1", "x2"]) set(one, name, x(at(one, name)));
      for (const name of ["y1", "y2"]) set(one, name, y(at(one, name)));
    } else if (kind === "rect") {
      const [a, b] = [x(at(one, "x")), y(at(one, "y"))];
      set(one, "width", x(at(one, "x") + at(one, "width")) - a);
      set(one, "height", y(at(one, "y") + at(one, "height")) - b);
      set(one, "x", a);
      set(one, "y", b);
    } else if (kind === "circle") {
      set(one, "cx", x(at(one, "cx")));
      set(one, "cy", y(at(one, "cy")));
      set(one, "r", at(one, "r") * Math.min(1, Math.max(0.6, wide + 0.25)));
    } else if (kind === "polyline") {
      const points = one
        .getAttribute("points")
        .trim()
        .split(/\s+/)
        .map((point) => point.split(",").map(Number));
      one.setAttribute("points", points.map(([a, b]) => `${x(a).toFixed(1)},${y(b).toFixed(1)}`).join(" "));
    } else {
      moveText(one, x, y);
    }
  }
  thinLabels(svg, PAD + (bottom - top) * TALL);
  svg.setAttribute("viewBox", `0 0 ${width} ${(at(axis, "y") + PAD).toFixed(1)}`);
}

function moveText(text, x, y) {
  const offset = text.classList.contains("num") ? -2 * BASE : text.hasAttribute("transform") ? 0 : BASE;
  const [a, b] = [x(at(text, "x")), y(at(text, "y") - offset) + offset];
  text.setAttribute("x", a.toFixed(1));
  text.setAttribute("y", b.toFixed(1));
  if (text.hasAttribute("transform"))
    text.setAttribute("transform", `rotate(-90 ${a.toFixed(1)} ${b.toFixed(1)})`);
}

/** Removes labels of the axis of time that would overlap. */
function thinLabels(svg, bottom) {
  let end = -Infinity;
  const labels = [...svg.querySelectorAll("text[text-anchor=middle]")].filter(
    (one) => at(one, "y") > bottom && /^-?[\d.]+$/.test(one.textContent),
  );
  for (const label of labels.sort((a, b) => at(a, "x") - at(b, "x"))) {
    const half = (label.textContent.length * CHARACTER) / 2;
    if (at(label, "x") - half < end + CHARACTER) label.remove();
    else end = at(label, "x") + half;
  }
}
