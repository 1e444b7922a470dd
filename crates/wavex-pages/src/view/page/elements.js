// Building blocks of the page's elements.

/** Element by its id. */
export function byId(id) {
  return document.getElementById(id);
}

/** New element with attributes (functions: event listeners) and children (elements or texts). */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name, value);
    else if (name === "class") element.className = value;
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value);
  }
  element.append(...children.filter((child) => child !== null && child !== undefined));
  return element;
}

/** Replaces the children of an element. */
export function fill(element, ...children) {
  element.replaceChildren(...children.filter((child) => child !== null && child !== undefined));
}

/** Text of an error in an element, for screen readers too. */
export function problem(text) {
  return make("p", { class: "problem", role: "alert" }, text);
}

/** Calls a function once calls have paused for a time, ms. */
export function debounced(pause, run) {
  let timer = 0;
  return (...args) => {
    clearTimeout(timer);
    timer = setTimeout(() => run(...args), pause);
  };
}

/** Shows a short message at the bottom of the page. */
export function announce(text, isProblem = false) {
  const box = byId("message");
  box.textContent = text;
  box.classList.toggle("problem", isProblem);
  box.hidden = false;
  clearTimeout(announce.timer);
  announce.timer = setTimeout(
    () => {
      box.hidden = true;
    },
    isProblem ? 9000 : 3500,
  );
}

/** Saves a blob or text as a download. */
export function download(name, content, type = "text/plain") {
  const blob = content instanceof Blob ? content : new Blob([content], { type });
  const link = make("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Canvas fitted to its box at the screen's resolution; its context in CSS pixels, and its size. */
export function fitted(canvas, ratio = Math.min(2, devicePixelRatio)) {
  const { clientWidth: width, clientHeight: height } = canvas;
  const [w, h] = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
  if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height, ratio };
}

/** Value of a custom property of the page's style. */
export function colour(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}
