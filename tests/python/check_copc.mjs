// Reads COPC files with the npm package `copc`: header, octree, and the points of every node.
//
//     node check_copc.mjs FOLDER FILE...
//
// FOLDER contains `node_modules/copc`. Prints one JSON object per file.

import { createRequire } from "node:module";
import { pathToFileURL } from "node:url";

const [folder, ...files] = process.argv.slice(2);
const { Copc } = createRequire(pathToFileURL(`${folder}/`))("copc");

/** All nodes of the octree, of all its pages. */
async function nodes(file, page) {
  const found = await Copc.loadHierarchyPage(file, page);
  const pages = await Promise.all(Object.values(found.pages).map((inner) => nodes(file, inner)));
  return Object.assign({}, found.nodes, ...pages);
}

for (const file of files) {
  const copc = await Copc.create(file);
  const all = Object.values(await nodes(file, copc.info.rootHierarchyPage));
  const least = [Infinity, Infinity, Infinity];
  const most = [-Infinity, -Infinity, -Infinity];
  let points = 0;
  for (const node of all) {
    const view = await Copc.loadPointDataView(file, copc, node);
    points += view.pointCount;
    ["X", "Y", "Z"].forEach((name, axis) => {
      const value = view.getter(name);
      for (let i = 0; i < view.pointCount; i += 1) {
        least[axis] = Math.min(least[axis], value(i));
        most[axis] = Math.max(most[axis], value(i));
      }
    });
  }
  console.log(JSON.stringify({
    header: copc.header.pointCount,
    nodes: all.reduce((sum, node) => sum + node.pointCount, 0),
    points,
    least,
    most,
    cube: copc.info.cube,
    extra: copc.eb.map(({ name }) => name),
    has_wkt: Boolean(copc.wkt),
  }));
}
