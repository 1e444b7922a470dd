// Points of one generation: the quadtree, which of its nodes a camera needs, and their loading.
//
// A node is drawn together with its ancestors, whose points are a coarser sample of the same
// square. Nodes are loaded in the order in which they are drawn: the largest on the screen first.

import { getBytes } from "./api.js";
import { hideOutside, touches } from "./clip_region.js";
import { coloursOf, colouring, plainColours } from "./colours.js";
import { state } from "./state.js";

/** Points over each other, on average, above which no finer points are drawn. */
const MOST_COVERED = 8;
/** Number of nodes that are loaded at a time. */
const AT_ONCE = 3;
/** Points of one request. */
const REQUEST_POINTS = 100_000;
/** Loaded points are kept up to this multiple of the points drawn. */
const KEPT = 2;

class Node {
  constructor(tree, { level, x, y, first, count, z }) {
    const side = tree.size_m / 2 ** level;
    this.level = level;
    this.first = first;
    this.count = count;
    this.side = side;
    this.low = [tree.corner[0] + x * side, tree.corner[1] + y * side];
    this.z = [...z];
    this.children = [];
    /** Positions; null until loaded. */
    this.xyz = null;
    /** Values of attributes. */
    this.values = new Map();
    this.colours = null;
    this.coloursVersion = -1;
    /** Number of times that the colours were computed. */
    this.coloured = 0;
    this.isLoading = false;
    this.failures = 0;
    this.usedAt = 0;
  }
}

export class Cloud {
  /**
   * `changed(node)`: called when a node can be drawn or has other colours.
   * `changed(null, error)`: called when a request has failed; `error` is given for the first of a series.
   */
  constructor(tree, changed) {
    this.generation = tree.generation;
    this.changed = changed;
    this.isClosed = false;
    const byPlace = new Map();
    this.nodes = tree.nodes.map((entry) => {
      const node = new Node(tree, entry);
      byPlace.set(`${entry.level} ${entry.x} ${entry.y}`, node);
      return node;
    });
    tree.nodes.forEach(({ level, x, y }, i) => {
      const parent = byPlace.get(`${level - 1} ${x >> 1} ${y >> 1}`);
      if (parent) parent.children.push(this.nodes[i]);
    });
    this.root = byPlace.get("0 0 0");
    if (this.root) widen(this.root);
    this.loading = 0;
    this.wanted = [];
    this.hasFailed = false;
    this.clock = 0;
  }

  /** Nodes for a camera, most important first, within a number of points. */
  choose(camera, limit) {
    const seen = [];
    const visit = (node, most, covered) => {
      if (state.clip && !touches(state.clip, node.low, node.side)) return;
      const [half, height] = [node.side / 2, (node.z[1] - node.z[0]) / 2];
      const centre = [node.low[0] + half, node.low[1] + half, node.z[0] + height];
      // From above, the square itself is tested: `look` uses its half side as a box.
      const look = camera.look(centre, camera.isOrbit ? Math.hypot(half, half, height) : half);
      if (!look.seen) return;
      const size = node.side * look.perUnit;
      const at = Math.hypot(centre[0] - camera.target[0], centre[1] - camera.target[1]) / node.side;
      const rank = Math.min(most, size / (1 + 0.02 * at));
      seen.push([rank, node]);
      const covers = covered + node.count * (state.pointSize / size) ** 2;
      if (covers < MOST_COVERED) for (const child of node.children) visit(child, rank, covers);
    };
    if (this.root) visit(this.root, Infinity, 0);
    seen.sort((a, b) => b[0] - a[0]);
    let points = 0;
    const chosen = [];
    for (const [, node] of seen) {
      if (chosen.length > 0 && points + node.count > limit) break;
      points += node.count;
      chosen.push(node);
    }
    this.clock += 1;
    for (const node of chosen) node.usedAt = this.clock;
    this.wanted = chosen;
    this.load();
    return chosen;
  }

  /** Whether all nodes chosen last are loaded. */
  get isComplete() {
    return this.wanted.every((node) => isReady(node) || node.failures >= 2);
  }

  /** Starts requests for nodes that are wanted and not loaded. */
  load() {
    while (this.loading < AT_ONCE && !this.isClosed) {
      const node = this.wanted.find((one) => !one.isLoading && one.failures < 2 && !isReady(one));
      if (!node) return;
      this.fetch(node);
    }
  }

  async fetch(node) {
    const { attribute } = state;
    node.isLoading = true;
    this.loading += 1;
    try {
      const [xyz, values] = await Promise.all([
        node.xyz || this.columns("points", node, {}, 3),
        node.values.get(attribute) || this.columns("values", node, { attribute }, 1),
      ]);
      node.xyz = xyz;
      if (node.values.size > 2) node.values.clear();
      node.values.set(attribute, values);
      node.coloursVersion = -1;
      node.failures = 0;
      this.hasFailed = false;
      if (!this.isClosed) this.changed(node);
    } catch (error) {
      node.failures += 1;
      if (!this.isClosed) this.changed(null, this.hasFailed ? null : error);
      this.hasFailed = true;
    } finally {
      node.isLoading = false;
      this.loading -= 1;
      this.forget();
      this.load();
    }
  }

  /** Numbers of the points of a node. */
  async columns(name, node, more, width) {
    const parts = [];
    for (let done = 0; done < node.count; done += REQUEST_POINTS) {
      const count = Math.min(REQUEST_POINTS, node.count - done);
      parts.push(getBytes(name, { generation: this.generation, first: node.first + done, count, ...more }));
    }
    const all = new Float32Array(width * node.count);
    let at = 0;
    for (const part of parts) {
      const numbers = new Float32Array(await part);
      all.set(numbers, at);
      at += numbers.length;
    }
    return all;
  }

  /** Drops the nodes that were not used for the longest time. */
  forget() {
    const loaded = this.nodes.filter((node) => node.xyz);
    let points = loaded.reduce((sum, node) => sum + node.count, 0);
    const limit = KEPT * state.pointLimit;
    if (points <= limit) return;
    loaded.sort((a, b) => a.usedAt - b.usedAt);
    for (const node of loaded) {
      if (points <= limit || node.usedAt === this.clock) return;
      points -= node.count;
      node.xyz = null;
      node.values.clear();
      node.colours = null;
      node.released?.();
    }
  }

  /** Tries nodes again whose requests have failed. */
  retry() {
    this.hasFailed = false;
    for (const node of this.nodes) node.failures = 0;
    this.load();
  }

  close() {
    this.isClosed = true;
    for (const node of this.nodes) node.released?.();
  }
}

/** Whether a node has its points and the values that colour them. */
function isReady(node) {
  return node.xyz !== null && node.values.has(state.attribute);
}

/** Extends the heights of nodes to those of their descendants. */
function widen(node) {
  for (const child of node.children) {
    widen(child);
    node.z[0] = Math.min(node.z[0], child.z[0]);
    node.z[1] = Math.max(node.z[1], child.z[1]);
  }
}

/** Up-to-date colours of a loaded node. */
export function nodeColours(node) {
  if (node.coloursVersion !== colouring.version || node.colours === null) {
    const values = node.values.get(state.attribute);
    node.colours = values ? coloursOf(values, node.colours || undefined) : plainColours(node.count);
    if (state.clip) hideOutside(state.clip, node.xyz, node.colours);
    node.coloursVersion = colouring.version;
    node.coloured += 1;
  }
  return node.colours;
}
