// Draws points without a graphics processor: each point is a square of pixels with a depth test.
//
// Software implementations of WebGL need about 0.5 µs per point, this loop less than 0.1 µs.

import { nodeColours } from "./cloud.js";
import { shade } from "./shade_software.js";
import { state } from "./state.js";

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
    this.shadedImage = this.context.createImageData(width, height);
    this.shadedPixels = new Uint32Array(this.shadedImage.data.buffer);
    // Inverse depth in perspective, height above the target from above.
    this.depth = new Float32Array(width * height);
  }

  /** Starts a picture. */
  begin(camera, background, size) {
    this.background = background;
    this.pixels.fill(background);
    this.depth.fill(-1e30);
    this.camera = camera;
    this.projection = camera.projection;
    this.target = [...camera.target];
    this.size = Math.max(1, Math.round(size));
  }

  /**
   * Moves the picture by whole pixels after the camera was panned from above; returns the rectangles
   * to draw: left, top, right, bottom.
   */
  slide(dx, dy) {
    const { pixels, depth, background, size } = this;
    const { width, height } = this.canvas;
    const offset = dy * width + dx;
    const [from, to] = [Math.max(0, -offset), Math.max(0, offset)];
    const count = Math.max(0, width * height - Math.abs(offset));
    for (const [numbers, empty] of [
      [pixels, background],
      [depth, -1e30],
    ]) {
      numbers.copyWithin(to, from, from + count);
      const clear = (left, top, right, bottom) => {
        for (let y = top; y < bottom; y += 1) numbers.fill(empty, y * width + left, y * width + right);
      };
      if (dy > 0) clear(0, 0, width, Math.min(height, dy));
      if (dy < 0) clear(0, Math.max(0, height + dy), width, height);
      if (dx > 0) clear(0, 0, Math.min(width, dx), height);
      if (dx < 0) clear(Math.max(0, width + dx), 0, width, height);
    }
    this.target = [...this.camera.target];
    // Points at the borders were cut: they are drawn again, which changes nothing else.
    const parts = [];
    if (dy > 0) parts.push([0, 0, width, dy + size]);
    if (dy < 0) parts.push([0, height + dy - size, width, height]);
    if (dx > 0) parts.push([0, 0, dx + size, height]);
    if (dx < 0) parts.push([width + dx - size, 0, width, height]);
    return parts.map(([left, top, right, bottom]) => [
      Math.max(0, left),
      Math.max(0, top),
      Math.min(width, right),
      Math.min(height, bottom),
    ]);
  }

  /** Draws the points of a node, within a rectangle: left, top, right, bottom. */
  draw(node, clip = [0, 0, this.canvas.width, this.canvas.height]) {
    const { pixels, depth, target, size, projection, camera } = this;
    const { width } = this.canvas;
    const [left, top] = clip;
    const { xyz, count } = node;
    const colours = nodeColours(node);
    const [tx, ty, tz] = target;
    const half = (size - 1) / 2;
    const [right, bottom] = [clip[2] - size + 1, clip[3] - size + 1];
    const {
      x: [x0, x1, x2, x3],
      y: [y0, y1, y2, y3],
      w: [w0, w1, w2],
      near,
    } = projection;
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
      if (!(u >= left && v >= top && u < right && v < bottom)) continue;
      const colour = colours[i];
      if (colour === 0) continue;
      let at = (v | 0) * width + (u | 0);
      if (size === 1) {
        if (z > depth[at]) {
          depth[at] = z;
          pixels[at] = colour;
        }
      } else if (size === 2) {
        if (z > depth[at]) {
          depth[at] = z;
          pixels[at] = colour;
        }
        if (z > depth[at + 1]) {
          depth[at + 1] = z;
          pixels[at + 1] = colour;
        }
        at += width;
        if (z > depth[at]) {
          depth[at] = z;
          pixels[at] = colour;
        }
        if (z > depth[at + 1]) {
          depth[at + 1] = z;
          pixels[at + 1] = colour;
        }
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

  /** Shows what is drawn; in perspective shaded. */
  present() {
    const isShaded = state.isShaded && this.camera.isOrbit;
    if (isShaded) {
      const { width, height } = this.canvas;
      shade(this.pixels, this.depth, this.shadedPixels, width, height, this.size);
    }
    this.context.putImageData(isShaded ? this.shadedImage : this.image, 0, 0);
  }
}
