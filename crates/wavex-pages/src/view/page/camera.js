// Camera: from above (parallel) or in orbit around a target (perspective).
//
// Positions are relative to the origin of the points, in the unit of the map; screen positions are
// CSS pixels from the upper left corner. `scale` is the size of a pixel at the target, map units.

const FIELD_OF_VIEW = (40 * Math.PI) / 180;
const LOWEST = (3 * Math.PI) / 180;

export class Camera {
  constructor() {
    this.isOrbit = false;
    this.target = [0, 0, 0];
    this.scale = 1;
    this.azimuth = 0;
    this.elevation = Math.PI / 5;
    this.width = 1;
    this.height = 1;
    this.limits = [1e-4, 1e6];
  }

  /** Right, up and forward of the screen, as unit vectors. */
  get axes() {
    if (!this.isOrbit)
      return [
        [1, 0, 0],
        [0, 1, 0],
        [0, 0, -1],
      ];
    const [sa, ca, se, ce] = [
      Math.sin(this.azimuth),
      Math.cos(this.azimuth),
      Math.sin(this.elevation),
      Math.cos(this.elevation),
    ];
    return [
      [ca, -sa, 0],
      [sa * se, ca * se, ce],
      [sa * ce, ca * ce, -se],
    ];
  }

  /** Distance to the target, map units. */
  get distance() {
    return (this.scale * this.height) / 2 / Math.tan(FIELD_OF_VIEW / 2);
  }

  /**
   * Coefficients of a projection of `p - target`: x, y on the screen times w, w, and nearness, which
   * grows towards the camera. In the view from above w is 1.
   */
  get projection() {
    const [right, up, forward] = this.axes;
    const [cx, cy] = [this.width / 2, this.height / 2];
    if (!this.isOrbit) {
      const s = 1 / this.scale;
      return { x: [s, 0, 0, cx], y: [0, -s, 0, cy], w: [0, 0, 0, 1], near: 0 };
    }
    const distance = this.distance;
    const w = [...forward.map((c) => c / distance), 1];
    const s = 1 / this.scale;
    return {
      x: [...right.map((c, i) => c * s + cx * w[i]), cx],
      y: [...up.map((c, i) => -c * s + cy * w[i]), cy],
      w,
      near: 0.02,
    };
  }

  /** Screen position and w of a point; w is at most 0 if it is not in front of the camera. */
  project(point) {
    const d = point.map((at, i) => at - this.target[i]);
    const { x, y, w, near } = this.projection;
    const dot = (row) => row[0] * d[0] + row[1] * d[1] + row[2] * d[2] + row[3];
    const depth = dot(w);
    if (depth <= near) return [NaN, NaN, 0];
    return [dot(x) / depth, dot(y) / depth, depth];
  }

  /** Point on the plane through the target that faces the viewer (from above: horizontal). */
  unproject(x, y) {
    const [right, up] = this.axes;
    const [a, b] = [(x - this.width / 2) * this.scale, (this.height / 2 - y) * this.scale];
    return this.target.map((at, i) => at + a * right[i] + b * up[i]);
  }

  /** Moves the picture by pixels. */
  pan(dx, dy) {
    const [right, up] = this.axes;
    const flat = this.isOrbit ? Math.hypot(up[0], up[1]) : 1;
    const along = this.isOrbit ? [Math.sin(this.azimuth), Math.cos(this.azimuth)] : [0, 1];
    const step = (dy * this.scale) / Math.max(0.3, flat);
    this.target[0] += -dx * this.scale * right[0] + step * along[0];
    this.target[1] += -dx * this.scale * right[1] + step * along[1];
  }

  /** Enlarges by a factor around a position of the screen. */
  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const scale = Math.min(this.limits[1], Math.max(this.limits[0], this.scale / factor));
    const before = this.unproject(x, y);
    this.scale = scale;
    const after = this.unproject(x, y);
    this.target = this.target.map((at, i) => at + before[i] - after[i]);
  }

  /** Turns the view, radians. */
  turn(azimuth, elevation) {
    this.azimuth = (this.azimuth + azimuth) % (2 * Math.PI);
    this.elevation = Math.min(Math.PI / 2, Math.max(LOWEST, this.elevation + elevation));
  }

  /** Shows a whole box. */
  fit(low, high) {
    this.target = low.map((at, i) => (at + high[i]) / 2);
    const [width, depth, height] = high.map((at, i) => Math.max(0.5, at - low[i]));
    if (this.isOrbit) {
      const across = Math.hypot(width, depth);
      const tall = across * Math.sin(this.elevation) + height * Math.cos(this.elevation);
      this.scale = Math.max(across / this.width, tall / this.height) * 1.08;
    } else {
      this.scale = Math.max(width / this.width, depth / this.height) * 1.06;
    }
    this.limits = [1e-4, Math.max(width, depth, height) / 40];
  }

  /** Whether a sphere may be seen, and the size of a length at its nearest point, pixels per map unit. */
  look(centre, radius) {
    const d = centre.map((at, i) => at - this.target[i]);
    const [right, up, forward] = this.axes;
    const dot = (axis) => axis[0] * d[0] + axis[1] * d[1] + axis[2] * d[2];
    const perUnit = 1 / this.scale;
    if (!this.isOrbit) {
      const x = Math.abs(d[0]) - radius;
      const y = Math.abs(d[1]) - radius;
      return { seen: x * perUnit < this.width / 2 && y * perUnit < this.height / 2, perUnit };
    }
    const distance = this.distance;
    const depth = distance + dot(forward);
    if (depth < -radius) return { seen: false, perUnit };
    const nearest = Math.max(distance * 0.05, depth - radius);
    const size = (perUnit * distance) / nearest;
    const middle = (perUnit * distance) / Math.max(distance * 0.05, depth);
    const inside = (at, half) => Math.abs(at) * middle - radius * size < half;
    return {
      seen: depth < radius || (inside(dot(right), this.width / 2) && inside(dot(up), this.height / 2)),
      perUnit: middle,
    };
  }
}
