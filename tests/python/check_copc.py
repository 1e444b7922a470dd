"""Compares COPC queries of laspy by area and by level with the source file."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import copclib
import laspy
import numpy as np
from laspy.copc import Bounds

from checks import same_bytes

# Point formats with waveforms, and the same formats without.
WITHOUT_WAVEFORMS = {9: 6, 10: 8}


def check_copc(checks, path, source):
    """Checks a COPC file; `source` is the source file as read by laspy."""
    before = source.header
    plain = laspy.read(path, laz_backend=laspy.LazBackend.Lazrs)
    by_laszip = laspy.read(path, laz_backend=laspy.LazBackend.Laszip)
    checks.that("LASzip reads the same points as lazrs", same_bytes(by_laszip.points.array, plain.points.array))
    check_by_copclib(checks, path, plain)
    check_by_node(checks, path, plain)
    with laspy.CopcReader.open(path) as reader:
        header, everything = reader.header, reader.query()
        expected = WITHOUT_WAVEFORMS.get(before.point_format.id, before.point_format.id)
        checks.equal("has its version and point format", (str(header.version), header.point_format.id), ("1.4", expected))
        check_same_header(checks, header, before)
        check_same_records(checks, "the octree leads to all points", everything.array, source.points.array)
        check_same_records(checks, "the chunks in their order hold all points", plain.points.array, source.points.array)
        check_places(checks, reader, source)
        check_levels(checks, reader, everything)


def check_by_copclib(checks, path, plain):
    """Checks the octree with another library, which shares no code with laspy.

    Its own validation is of no use: it takes the cube to begin at the smallest coordinates, not at centre - halfsize.
    """
    if not plain.header.global_encoding.wkt:
        print(f"skipped: copclib refuses {path.name}, which has no coordinate reference system")
        return
    reader = copclib.FileReader(str(path))
    nodes, info = reader.GetAllNodes(), reader.copc_config.copc_info
    checks.equal("copclib counts the points of all nodes", sum(node.point_count for node in nodes), len(plain.points))
    least = np.array([info.center_x, info.center_y, info.center_z]) - info.halfsize
    step, found, outside = max(plain.header.scales), [], 0
    for node in nodes:
        points, key = reader.GetPoints(node), node.key
        xyz, side = np.stack([points.x, points.y, points.z], axis=1), 2.0 * info.halfsize / 2**key.d
        low = least + side * np.array([key.x, key.y, key.z])
        outside += int(np.any((xyz < low - step) | (xyz > low + side + step), axis=1).sum())
        found.append(xyz[:, 0])
    checks.equal("copclib finds all points within their nodes", outside, 0)
    checks.within("copclib reads their coordinates", np.sort(np.concatenate(found)), np.sort(plain.x), 1e-9)


def check_by_node(checks, path, plain):
    """Checks header, octree and points with the npm package `copc`, which viewers in browsers use."""
    folder = os.environ.get("WAVEX_NODE_COPC")
    if folder is None or shutil.which("node") is None:
        print("SKIPPED: the npm package `copc`; it needs node, and its folder in WAVEX_NODE_COPC")
        return
    program = Path(__file__).with_suffix(".mjs")
    done = subprocess.run(["node", program, folder, path], capture_output=True, text=True)
    checks.equal(f"node reads {path.name}", (done.returncode, done.stderr), (0, ""))
    if done.returncode != 0:
        return
    found, n = json.loads(done.stdout), len(plain.points)
    checks.equal("node counts points in header, octree and nodes", [found[of] for of in ("header", "nodes", "points")], [n] * 3)
    checks.within("node reads coordinates", found["least"] + found["most"], [*plain.header.mins, *plain.header.maxs], 1e-9)
    checks.that("node's cube has all points", all(a <= b for a, b in zip(found["cube"][:3], found["least"]))
                and all(a >= b for a, b in zip(found["cube"][3:], found["most"])))
    checks.equal("node reads the extra attributes", found["extra"], list(plain.point_format.extra_dimension_names))
    checks.equal("node finds the coordinate reference system", found["has_wkt"],
                 any((vlr.user_id, vlr.record_id) == ("LASF_Projection", 2112) for vlr in plain.header.vlrs))


def check_same_header(checks, header, before):
    checks.equal("counts points as before", header.point_count, before.point_count)
    checks.equal("counts returns as before", list(header.number_of_points_by_return), list(before.number_of_points_by_return))
    for name in ["scales", "offsets", "mins", "maxs"]:
        checks.within(f"has the {name} of before", getattr(header, name), getattr(before, name), 0)
    names = list(header.point_format.extra_dimension_names)
    checks.equal("has the extra attributes of before", names, list(before.point_format.extra_dimension_names))
    for name in names:
        found, expected = (of.point_format.dimension_by_name(name) for of in (header, before))
        same = (found.scales, found.offsets, found.description) == (expected.scales, expected.offsets, expected.description)
        checks.that(f"{name} has its step and description", same, (found, expected))
    wkt = lambda of: [vlr.string for vlr in of.vlrs if (vlr.user_id, vlr.record_id) == ("LASF_Projection", 2112)]
    checks.equal("has the coordinate reference system of before", wkt(header), wkt(before))
    times = (header.global_encoding.gps_time_type, before.global_encoding.gps_time_type)
    checks.equal("says what times count", *times)


def check_same_records(checks, what, found, expected):
    """Checks that records are equal in any order: every field of `found`, bit by bit."""
    fields = list(found.dtype.names)
    pick = lambda array: np.sort(np.array([row.tobytes() for row in packed(array, fields)]))
    checks.equal(f"{what}: their number", len(found), len(expected))
    checks.that(what, np.array_equal(pick(found), pick(expected)))


def packed(array, fields):
    out = np.empty(len(array), dtype=[(name, array.dtype[name]) for name in fields])
    for name in fields:
        out[name] = array[name]
    # Not dtype S, which drops trailing zeros.
    return out.view(f"V{out.dtype.itemsize}")


def check_places(checks, reader, source):
    header = source.header
    low, high = header.mins, header.maxs
    # Off the coordinate steps to which laspy rounds borders: on a step, rounding would decide.
    beside = lambda place, steps: header.offsets + (np.round((place - header.offsets) / header.scales) + steps) * header.scales
    for number, (start, end) in enumerate([(0.0, 0.5), (0.25, 0.4), (0.9, 1.0)]):
        bounds = Bounds(mins=beside(low + (high - low) * start, -0.25), maxs=beside(low + (high - low) * end, 0.25))
        found = reader.query(bounds)
        inside = np.all((source.xyz >= bounds.mins) & (source.xyz <= bounds.maxs), axis=1)
        checks.that(f"box {number} has points, or the source has none there", inside.any() == bool(len(found)))
        check_same_records(checks, f"box {number} holds the points of the source", found.array, source.points.array[inside])


def check_levels(checks, reader, everything):
    """Checks that levels partition the points, and that the root has at most one per cell unless it has all."""
    info = reader.copc_info
    levels = [reader.query(level=range(level, level + 1)) for level in range(4)]
    checks.that("level 0 is not empty", len(levels[0]) > 0)
    checks.that("the first levels are no more than all", sum(map(len, levels)) <= len(everything))
    if len(levels[0]) == len(everything):
        return
    root = levels[0]
    xyz = np.stack([root.x, root.y, root.z], axis=1)
    cells = np.floor((xyz - (info.center - info.halfsize)) / info.spacing)
    checks.equal("the root shows one point of each cell", len(np.unique(cells, axis=0)), len(root))
