// Draws points without a graphics processor: each point is a square of pixels with a depth test.
//
// Software implementations of WebGL need about 0.5 µs per point, this loop less than 0.1 µs.

import { nodeColours } from "./cloud.js";

export class SoftwarePainter {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.ratio = 1;
    this.image = null;
  }

  resize(width, height) {
    Object.assign(this.canvas, { width, height });
    this.image = this.context.createImageData(width, height);
    this.pixels = new Uint32Array(this.image.data.buffer);
    // Inverse depth in perspective, height above the target from above.
    this.depth = new Float32Array(width * height);
  }

  /** Starts a picture. */
  begin(camera, background, size) {
    this.pixels.fill(background);
    this.depth.fill(-1e30);
    this.camera = camera;
    this.projection = camera.projection;
    this.target = [...camera.target];
    this.size = Math.max(1, Math.round(size));
  }

  /** Draws the points of a node. */
  draw(node) {
    const { pixels, depth, target, size, projection, camera } = this;
    const { width, height } = this.canvas;
    const { xyz, count } = node;
    const colours = nodeColours(node);
    const [tx, ty, tz] = target;
    const half = (size - 1) / 2;
    const [right, bottom] = [width - size + 1, height - size + 1];
    const { x: [x0, x1, x2, x3], y: [y0, y1, y2, y3], w: [w0, w1, w2], near, } = projection;
    const { isOrbit } = camera;
    for (let i = 0, j = 0; i < count; i += 1, j += 3) {
      const a = xyz[j] - tx;
      const b = xyz[j + 1] - ty;
      const c = xyz[j + 2] - tz;
      let u;
      let v;
      let z = c;
      if (isOrbit) {
        const w = w0 * a + w1 * b + w2 * c + 1;
        if (w <= near) continue;
        z = 1 / w;
        u = (x0 * a + x1 * b + x2 * c + x3) * z - half;
        v = (y0 * a + y1 * b + y2 * c + y3) * z - half;
      } else {
        u = x0 * a + x3 - half;
        v = y1 * b + y3 - half;
      }
      if (!(u >= 0 && v >= 0 && u < right && v < bottom)) continue;
      const colour = colours[i];
      if (colour === 0) continue;
      let at = (v | 0) * width + (u | 0);
      if (size === 1) {
        if (z > depth[at]) {
          depth[at] = z;
          pixels[at] = colour;
        }
      } else if (size === 2) {
        if (z > depth[at]) { depth[at] = z; pixels[at] = colour; }
        if (z > depth[at + 1]) { depth[at + 1] = z; pixels[at + 1] = colour; }
        at += width;
        if (z > depth[at]) { depth[at] = z; pixels[at] = colour; }
        if (z > depth[at + 1]) { depth[at + 1] = z; pixels[at + 1] = colour; }
      } else {
        for (let row = 0; row < size; row += 1, at += width) {
          for (let k = at; k < at + size; k += 1) {
            if (z > depth[k]) {
              depth[k] = z;
              pixels[k] = colour;
            }
          }
        }
      }
    }
  }

  /** Shows what is drawn. */
  present() {
    this.context.putImageData(this.image, 0, 0);
  }
}
