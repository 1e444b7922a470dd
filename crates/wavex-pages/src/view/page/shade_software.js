// Shading by depth, so that shapes are seen: eye-dome lighting without a graphics processor.
//
// A pixel is darker the more its neighbours are in front of it (Boucheny 2009, as in CloudCompare and Potree).

/** Darkening by the mean relative depth of the neighbours in front; the shader has the same. */
export const STRENGTH = 90;
/** Darkest shade: colours remain readable. */
export const DARKEST = 0.35;

/** Sum of relative depths at which the table ends. */
const TABLE_END = 0.05;
const TABLE_SIZE = 1024;
const PER_ENTRY = TABLE_SIZE / TABLE_END;
/** Factors of colours times 256, by the sum of relative depths. */
const FACTORS = Uint16Array.from({ length: TABLE_SIZE + 1 }, (_, i) =>
  Math.round(256 * Math.max(DARKEST, Math.exp((-STRENGTH * i) / PER_ENTRY / 4))),
);

/**
 * Shades packed `pixels` into `into`. `nearness` is the inverse depth of each pixel, negative without a point;
 * `reach` is the distance of the neighbours, px.
 */
export function shade(pixels, nearness, into, width, height, reach) {
  for (let y = 0, i = 0; y < height; y += 1) {
    const up = y >= reach ? -reach * width : 0;
    const down = y < height - reach ? reach * width : 0;
    for (let x = 0; x < width; x += 1, i += 1) {
      const own = nearness[i];
      const pixel = pixels[i];
      if (own <= 0) {
        into[i] = pixel;
        continue;
      }
      let sum = 0;
      let more = nearness[i + up] - own;
      if (more > 0) sum += more;
      more = nearness[i + down] - own;
      if (more > 0) sum += more;
      more = nearness[x >= reach ? i - reach : i] - own;
      if (more > 0) sum += more;
      more = nearness[x < width - reach ? i + reach : i] - own;
      if (more > 0) sum += more;
      const entry = (sum / own) * PER_ENTRY;
      const factor = FACTORS[entry < TABLE_SIZE ? entry | 0 : TABLE_SIZE];
      // Red and blue together, then green.
      into[i] =
        0xff000000 |
        ((Math.imul(pixel & 0xff00ff, factor) >>> 8) & 0xff00ff) |
        ((Math.imul(pixel & 0x00ff00, factor) >>> 8) & 0x00ff00);
    }
  }
}
