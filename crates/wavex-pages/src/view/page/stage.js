// The stage: draws points as the camera sees them, and finds the point under the pointer.
//
// While the camera moves, only as many points are drawn as fit into a frame; when it rests, the
// others follow over the next frames. Nothing is drawn while nothing changes.

import { Camera } from "./camera.js";
import { Cloud } from "./cloud.js";
import { getJson } from "./api.js";
import { SoftwarePainter } from "./draw_software.js";
import { WebglPainter } from "./draw_webgl.js";
import { byId, colour } from "./elements.js";
import { emit, state } from "./state.js";

/** Time after the last movement until the camera rests, ms. */
const REST_MS = 140;
/** Time for drawing points in a frame while moving and at rest, ms. */
const MOVING_MS = 13;
const RESTING_MS = 24;
/** Longest frame while moving, ms. */
const FRAME_MS = 33;
/** Number of heights from which a median is taken. */
const ENOUGH_HEIGHTS = 20_000;
/** Distance at which a click hits a point, CSS pixels. */
const HIT_PX = 8;

class Stage {
  constructor() {
    this.camera = new Camera();
    this.canvas = byId("points");
    this.painter = WebglPainter.on(this.canvas);
    if (!this.painter) {
      // A canvas keeps its first kind of context.
      const fresh = this.canvas.cloneNode();
      this.canvas.replaceWith(fresh);
      this.canvas = fresh;
      this.painter = new SoftwarePainter(fresh);
    }
    /** Points of the generation shown, and of the one that replaces it once it is loaded. */
    this.cloud = null;
    this.next = null;
    /** Nodes to draw, how many are drawn, and those drawn. */
    this.queue = [];
    this.drawn = [];
    this.pointsDrawn = 0;
    this.isFresh = false;
    /** Whether the camera shows all points, as `fit` left it. */
    this.showsAll = false;
    /** Movement of the picture since the last frame, and fractions of pixels that are left, px. */
    this.slid = [0, 0];
    this.fraction = [0, 0];
    this.movedAt = -Infinity;
    this.scheduled = false;
    /** Measured speed, points per ms, and times of the last frames. */
    this.speed = 4000;
    this.frames = [];
    this.slack = 1;
    this.lastFrame = 0;
    this.canvasShown = 0;
    new ResizeObserver(() => this.resize()).observe(this.canvas.parentElement);
  }

  /** Name of the way of drawing. */
  get painterName() {
    return this.painter instanceof WebglPainter ? "WebGL" : "software";
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement;
    if (!width || !height) return;
    this.camera.width = width;
    this.camera.height = height;
    this.canvas.style.width = `${width}px`;
    this.canvas.style.height = `${height}px`;
    this.painter.resize(Math.round(width * this.painter.ratio), Math.round(height * this.painter.ratio));
    if (this.wantsFit) this.fit();
    this.redraw();
    emit("camera");
  }

  /** Loads a generation and shows it when it covers the view. */
  async open(generation) {
    const tree = await getJson("tree", { generation });
    const cloud = new Cloud(tree, (node, error) => this.nodeChanged(cloud, node, error));
    this.next?.close();
    this.next = cloud;
    this.nextSince = performance.now();
    if (!this.cloud || tree.nodes.length === 0) this.useNext();
    else this.redraw();
  }

  useNext() {
    this.cloud?.close();
    this.cloud = this.next;
    this.next = null;
    state.generation = this.cloud.generation;
    emit("generation");
    this.redraw();
  }

  nodeChanged(cloud, node, error) {
    if (error) emit("loading-failed", error);
    if (cloud === this.next) {
      if (cloud.isComplete || performance.now() - this.nextSince > 4000) this.useNext();
    } else if (cloud === this.cloud && node) {
      this.add(node);
    }
    emit("loading");
  }

  /** Draws a node that has arrived, without starting anew. */
  add(node) {
    if (!this.wanted?.includes(node)) return;
    if (this.drawn.includes(node)) this.redraw();
    else if (!this.queue.includes(node)) this.queue.push(node);
    this.schedule();
  }

  /** Shows all points but outliers. */
  fit() {
    const { usual_min: min, usual_max: max, origin } = state.info;
    if (!min) return;
    this.wantsFit = this.camera.width <= 1;
    const inside = (corner) => corner.map((at, i) => at - origin[i]);
    this.camera.fit(inside(min), inside(max));
    this.moved();
    this.showsAll = true;
  }

  /** Switches between map and perspective; a view of all points stays one. */
  setOrbit(isOrbit) {
    const { camera } = this;
    if (camera.isOrbit === isOrbit) return;
    if (isOrbit) camera.target[2] = this.heightAround();
    camera.isOrbit = isOrbit;
    if (this.showsAll) this.fit();
    else this.moved();
  }

  /** Median height of the drawn points around the middle of the map; of the target without any. */
  heightAround() {
    const { target, scale, width, height } = this.camera;
    const reach = 0.25 * Math.min(width, height) * scale;
    const heights = [];
    for (const { xyz } of this.drawn) {
      for (let j = 0; xyz && j < xyz.length; j += 3)
        if (Math.abs(xyz[j] - target[0]) < reach && Math.abs(xyz[j + 1] - target[1]) < reach)
          heights.push(xyz[j + 2]);
      if (heights.length > ENOUGH_HEIGHTS) break;
    }
    heights.sort((a, b) => a - b);
    return heights.length ? heights[heights.length >> 1] : target[2];
  }

  /** Announces that the camera has moved. */
  moved() {
    this.showsAll = false;
    this.movedAt = performance.now();
    this.isMoving = true;
    this.redraw();
    emit("camera");
  }

  /** Moves the picture by pixels; from above, what is drawn is kept. */
  pan(dx, dy) {
    if (this.camera.isOrbit || !this.painter.slide || this.isFresh || !this.wanted) {
      this.camera.pan(dx, dy);
      this.moved();
      return;
    }
    this.showsAll = false;
    const whole = [dx, dy].map((by, i) => Math.round(by + this.fraction[i]));
    this.fraction = [dx, dy].map((by, i) => by + this.fraction[i] - whole[i]);
    this.camera.pan(...whole);
    this.slid = this.slid.map((by, i) => by + whole[i]);
    this.movedAt = performance.now();
    this.isMoving = true;
    this.schedule();
    emit("camera");
  }

  /** Slides the picture and draws what has come into view. */
  slide() {
    const parts = this.painter.slide(...this.slid);
    this.slid = [0, 0];
    const kept = new Set(this.drawn);
    this.choose();
    this.queue = this.queue.filter((node) => !kept.has(node));
    this.drawn = this.wanted.filter((node) => kept.has(node));
    this.pointsDrawn = this.drawn.reduce((sum, node) => sum + node.count, 0);
    const { camera } = this;
    for (const node of this.drawn) {
      const [left, bottom] = camera.project([...node.low, 0]);
      const side = node.side / camera.scale;
      for (const part of parts) {
        if (left < part[2] && left + side > part[0] && bottom - side < part[3] && bottom > part[1])
          this.painter.draw(node, part);
      }
    }
    this.wasCleared = true;
  }

  /** Moves the camera to a position, keeping its scale. */
  centre(position) {
    this.camera.target = [...position];
    this.moved();
  }

  /** Starts the picture anew. */
  redraw() {
    this.isFresh = true;
    this.schedule();
  }

  schedule() {
    if (this.scheduled) return;
    this.scheduled = true;
    requestAnimationFrame((now) => this.frame(now));
  }

  /** Draws one frame. */
  frame(now) {
    this.scheduled = false;
    const wasMoving = this.isMoving;
    this.isMoving = performance.now() - this.movedAt < REST_MS;
    this.measure(now, wasMoving);
    if (!this.cloud || !this.canvas.width) return;
    const started = performance.now();
    const limit = this.isMoving ? MOVING_MS * this.slack : RESTING_MS;
    if (this.isFresh) this.begin();
    else if (this.slid[0] !== 0 || this.slid[1] !== 0) this.slide();
    let points = 0;
    const most = this.isMoving ? Math.max(30_000, this.speed * limit) : Infinity;
    while (this.queue.length > 0) {
      const node = this.queue[0];
      if (points > 0 && (points + node.count > most || performance.now() - started > limit)) break;
      this.queue.shift();
      this.painter.draw(node);
      this.drawn.push(node);
      points += node.count;
      if (this.isMoving && this.pointsDrawn + points > most) break;
    }
    this.pointsDrawn += points;
    const took = performance.now() - started;
    if (points > 40_000) this.speed += 0.2 * (points / Math.max(0.5, took) - this.speed);
    // A picture that replaces another of the same view appears when it is complete.
    const waits = !this.isMoving && this.queue.length > 0 && now - this.begunAt < 400 && this.keepsOld;
    if (!waits && (points > 0 || this.wasCleared)) {
      this.painter.present();
      this.wasCleared = false;
      this.canvasShown += 1;
    }
    if (this.isMoving || this.queue.length > 0) this.schedule();
    else this.rest(wasMoving);
    emit("frame");
  }

  /** Chooses the nodes of the view. */
  choose() {
    this.wanted = this.cloud.choose(this.camera, state.pointLimit);
    this.next?.choose(this.camera, state.pointLimit);
    this.queue = this.wanted.filter((node) => node.xyz !== null);
  }

  /** Starts a picture: chooses its nodes and clears the canvas. */
  begin() {
    this.isFresh = false;
    this.keepsOld = !this.isMoving && this.pointsDrawn > 0;
    this.begunAt = performance.now();
    this.slid = [0, 0];
    this.choose();
    this.drawn = [];
    this.pointsDrawn = 0;
    this.wasCleared = true;
    const all = this.queue.reduce((sum, node) => sum + node.count, 0);
    const isThin = this.isMoving && this.speed * MOVING_MS * this.slack < 0.5 * all;
    this.painter.begin(this.camera, background(), state.pointSize + (isThin ? 1 : 0));
    this.isThin = isThin;
  }

  /** The camera rests: points left out are drawn; enlarged points get their size again. */
  rest(wasMoving) {
    if (wasMoving && this.isThin) this.redraw();
    emit("rest");
  }

  /** Notes the time of a frame while moving and adapts the number of points to it. */
  measure(now, wasMoving) {
    const took = now - this.lastFrame;
    this.lastFrame = now;
    if (!wasMoving || took > 500) return;
    this.frames.push(took);
    if (this.frames.length > 60) this.frames.shift();
    this.slack = Math.min(1.2, Math.max(0.15, this.slack * (took > FRAME_MS + 3 ? 0.93 : 1.04)));
  }

  /** Frames per second of the last movement; 0 before the first. */
  framesPerSecond() {
    const sum = this.frames.reduce((total, took) => total + took, 0);
    return sum > 0 ? (1000 * this.frames.length) / sum : 0;
  }

  /** Position of a point that is drawn, relative to the origin; null for others. */
  pointAt(index) {
    const node = this.drawn.find(({ first, count }) => index >= first && index < first + count);
    if (index === null || !node || node.colours?.[index - node.first] === 0) return null;
    const at = 3 * (index - node.first);
    return [...node.xyz.subarray(at, at + 3)];
  }

  /** Screen position of a point that is drawn; null for others. */
  screenOf(index) {
    const point = this.pointAt(index);
    if (!point) return null;
    const [x, y, w] = this.camera.project(point);
    return w > 0 ? [x, y] : null;
  }

  /** Number of points in the picture that are not hidden. */
  get pointsShown() {
    const shown = (node) => node.colours?.reduce((sum, packed) => sum + (packed !== 0 ? 1 : 0), 0) ?? 0;
    return this.drawn.reduce((sum, node) => sum + shown(node), 0);
  }

  /** Index of the drawn point at a screen position; null if there is none. */
  pick(x, y) {
    const { camera } = this;
    const { x: rowX, y: rowY, w: rowW, near } = camera.projection;
    const [tx, ty, tz] = camera.target;
    const reach = HIT_PX * camera.scale;
    const [px, py] = camera.unproject(x, y);
    const exact = Math.max(2.5, state.pointSize) ** 2;
    let best = null;
    let bestScore = Infinity;
    for (const node of this.drawn) {
      if (!node.xyz) continue;
      if (
        !camera.isOrbit &&
        (px < node.low[0] - reach ||
          px > node.low[0] + node.side + reach ||
          py < node.low[1] - reach ||
          py > node.low[1] + node.side + reach)
      )
        continue;
      const { xyz, count } = node;
      for (let i = 0, j = 0; i < count; i += 1, j += 3) {
        const [a, b, c] = [xyz[j] - tx, xyz[j + 1] - ty, xyz[j + 2] - tz];
        const w = rowW[0] * a + rowW[1] * b + rowW[2] * c + rowW[3];
        if (w <= near) continue;
        const u = (rowX[0] * a + rowX[1] * b + rowX[2] * c + rowX[3]) / w - x;
        const v = (rowY[0] * a + rowY[1] * b + rowY[2] * c + rowY[3]) / w - y;
        const off = u * u + v * v;
        if (off > HIT_PX * HIT_PX || node.colours?.[i] === 0) continue;
        // Of points under the pointer the nearest to the camera; of others the nearest to the pointer.
        const nearness = camera.isOrbit ? -1 / w : -c;
        const score = off <= exact ? nearness : 1e6 + off;
        if (score < bestScore) {
          bestScore = score;
          best = node.first + i;
        }
      }
    }
    return best;
  }
}

/** Packed colour of the stage. */
function background() {
  const hex = colour("stage");
  const value = parseInt(hex.slice(1), 16);
  return ((255 << 24) | ((value & 255) << 16) | (value & 0xff00) | (value >> 16)) >>> 0;
}

export const stage = new Stage();
