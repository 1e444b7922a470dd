// Measures the readability of the page: visible pictures, and texts that are large enough, have
// contrast and do not overlap. Appends the findings as JSON to the page.
const channels = (colour) => (colour.match(/[\d.]+/g) || []).map(Number);
const luminance = (colour) => {
  const linear = channels(colour).slice(0, 3).map((c) => c / 255)
    .map((c) => (c <= 0.03928 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
  return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
};
// WCAG 2.1, contrast ratio.
const contrast = (a, b) => {
  const [light, dark] = [luminance(a), luminance(b)].sort((x, y) => y - x);
  return (light + 0.05) / (dark + 0.05);
};
const background = (element) => {
  for (let at = element; at; at = at.parentElement) {
    const colour = getComputedStyle(at).backgroundColor;
    const alpha = channels(colour)[3];
    if (alpha === undefined || alpha > 0) return colour;
  }
  return "rgb(255, 255, 255)";
};
const box = (element) => {
  const { left, right, top, bottom, width, height } = element.getBoundingClientRect();
  return { left, right, top, bottom, width, height };
};
const found = { empty: [], images: [], texts: 0, faint: [], small: [], overlapping: [], cut: [] };
for (const picture of document.querySelectorAll("svg, img, canvas, image")) {
  const { width, height } = box(picture);
  if (width < 20 || height < 10) found.empty.push(picture.outerHTML.slice(0, 120));
}
for (const element of document.body.querySelectorAll("*")) {
  const own = [...element.childNodes].filter((node) => node.nodeType === 3 && node.data.trim());
  if (!own.length || ["SCRIPT", "STYLE", "title"].includes(element.tagName)) continue;
  found.texts += 1;
  const style = getComputedStyle(element);
  const drawn = element.namespaceURI.endsWith("svg");
  const text = element.textContent.slice(0, 60);
  const matrix = drawn ? element.getScreenCTM() : null;
  const size = parseFloat(style.fontSize) * (drawn ? Math.hypot(matrix.a, matrix.b) : 1);
  if (size < 10) found.small.push(`${text}: ${size.toFixed(1)} px`);
  const ratio = contrast(drawn ? style.fill : style.color, background(element));
  if (!(ratio >= 4.5)) found.faint.push(`${text}: ${ratio.toFixed(2)}`);
}
for (const svg of document.querySelectorAll("svg")) {
  const around = box(svg);
  const texts = [...svg.querySelectorAll("text")].map((text) => ({ text: text.textContent, ...box(text) }));
  texts.forEach((a, i) => {
    if (a.left < around.left - 1 || a.right > around.right + 1 || a.top < around.top - 1 || a.bottom > around.bottom + 1) {
      found.cut.push(`${svg.getAttribute("aria-label")}: ${a.text}`);
    }
    for (const b of texts.slice(i + 1)) {
      const wide = Math.min(a.right, b.right) - Math.max(a.left, b.left);
      const high = Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top);
      if (wide > 1 && high > 3) found.overlapping.push(`${svg.getAttribute("aria-label")}: ${a.text} and ${b.text}`);
    }
  });
}
found.page = getComputedStyle(document.body).backgroundColor;
found.wide = document.documentElement.scrollWidth > innerWidth;
const loading = [...document.querySelectorAll("image, img")].map((element) => new Promise((done) => {
  const image = new Image();
  image.onload = () => done([image.naturalWidth, image.naturalHeight]);
  image.onerror = () => done("broken");
  image.src = element.getAttribute("href") || element.src;
}));
Promise.all(loading).then((images) => {
  found.images = images;
  const names = performance.getEntriesByType("resource").map((entry) => entry.name);
  found.loaded = [...new Set(names)].filter((name) => !name.startsWith("data:"));
  const result = document.createElement("script");
  result.type = "application/json";
  result.textContent = JSON.stringify(found);
  document.body.append(result);
});
