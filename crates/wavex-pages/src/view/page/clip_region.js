// The region to which the points are clipped: a polygon on the map, at all heights.

/** Region of a polygon; corners are relative to the origin. */
export function regionOf(corners) {
  const ends = (pick) => [0, 1].map((axis) => pick(...corners.map((corner) => corner[axis])));
  return { corners, low: ends(Math.min), high: ends(Math.max) };
}

/** Whether a square may have points in the region. */
export function touches({ low, high }, corner, side) {
  return [0, 1].every((axis) => corner[axis] <= high[axis] && corner[axis] + side >= low[axis]);
}

/** Whether a place is in the region: a line to the east crosses its boundary an odd number of times. */
export function isInside({ corners, low, high }, x, y) {
  if (x < low[0] || x > high[0] || y < low[1] || y > high[1]) return false;
  let inside = false;
  for (let i = 0, j = corners.length - 1; i < corners.length; j = i, i += 1) {
    const [[xi, yi], [xj, yj]] = [corners[i], corners[j]];
    if (yi > y !== yj > y && x < ((xj - xi) * (y - yi)) / (yj - yi) + xi) inside = !inside;
  }
  return inside;
}

/** Hides the points outside of the region: their packed colour becomes 0. */
export function hideOutside(region, xyz, colours) {
  for (let i = 0, j = 0; i < colours.length; i += 1, j += 3)
    if (colours[i] !== 0 && !isInside(region, xyz[j], xyz[j + 1])) colours[i] = 0;
}
