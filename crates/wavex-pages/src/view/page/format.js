// Numbers as text.

/** Number with digits after the point; a dash if unknown. */
export function fixed(value, digits) {
  return value === null || value === undefined || Number.isNaN(value) ? "–" : value.toFixed(digits);
}

/** Number and its standard deviation. */
export function withSd(value, sd, digits) {
  return sd === null || sd === undefined
    ? fixed(value, digits)
    : `${fixed(value, digits)} ± ${fixed(sd, digits)}`;
}

/** Number with a fixed number of significant digits, without exponent where it is readable. */
export function significant(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e7)) return value.toExponential(digits - 1);
  return String(Number(value.toPrecision(digits)));
}

/** Count with narrow spaces between thousands. */
export function count(value) {
  return String(Math.round(value)).replace(/\B(?=(\d{3})+$)/g, "\u202f");
}

/** Count and noun. */
export function counted(value, one, many = `${one}s`) {
  return `${count(value)} ${value === 1 ? one : many}`;
}

/** Unit after a number or label; empty if it has none. */
export function unitAfter(unit) {
  return unit ? `\u202f${unit}` : "";
}

/** Length with its unit; metres are given in the unit that reads best. */
export function length(value, unit) {
  const size = Math.abs(value);
  if (unit !== "m" || size === 0) return `${significant(value, 4)} ${unit}`;
  if (size >= 2000) return `${significant(value / 1000, 4)} km`;
  if (size >= 1) return `${significant(value, 4)} m`;
  return size >= 0.01 ? `${significant(value * 100, 3)} cm` : `${significant(value * 1000, 3)} mm`;
}

/** Largest of 1, 2 and 5 times a power of ten that is at most the value. */
export function roundStep(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const digit = value / power;
  return power * (digit >= 5 ? 5 : digit >= 2 ? 2 : 1);
}

/** Round values in a range, about so many, with the digits to write them. */
export function ticks(low, high, about) {
  if (!(high > low)) return { values: [low], digits: 1 };
  const step = roundStep(((high - low) / Math.max(1, about)) * 1.999);
  const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  const values = [];
  for (let k = Math.ceil(low / step - 1e-6); k * step <= high + step * 1e-6; k += 1) values.push(k * step);
  return { values, digits };
}
