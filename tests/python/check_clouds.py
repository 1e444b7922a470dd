"""Height differences of strips on smooth cells, to judge `wavex align` of clouds. Shares no code with it.

    check_clouds.py strip04.laz strip05.laz                      # differences of all pairs
    check_clouds.py strip04.laz strip05.laz --after aligned      # and those of the files of the same names there
    check_clouds.py strip04.laz --perturb moved/strip04.laz --shift 0.11 -0.07 0.05 --drift 0.02 0.02 -0.03

Cells of 1 m of a common grid are smooth if both strips have 5 or more points of ground there (class 2, or all without
classes), and the RMS distance from their plane is at most 3 cm. The difference of two strips is that of the planes at the centre of
the cell. Offset: median; scatter: 1.4826 MAD. A drift is the change from the first to the last time of the file.
"""

import argparse
import itertools
import pathlib
import sys

import laspy
import numpy as np

CELL_M = 1.0
LEAST_POINTS = 5
MOST_RMS_M = 0.03
MOST_SLOPE = 0.5


def planes(path):
    """Height at the centre and slopes of the smooth cells of a cloud, by cell."""
    cloud = laspy.read(path)
    x, y, z = np.array(cloud.x), np.array(cloud.y), np.array(cloud.z)
    classes = np.array(cloud.classification)
    used = np.array(cloud.number_of_returns) == 1
    if (classes == 2).any():
        used &= classes == 2
    x, y, z = x[used], y[used], z[used]
    column, row = np.floor(x / CELL_M).astype(np.int64), np.floor(y / CELL_M).astype(np.int64)
    order = np.lexsort((row, column))
    x, y, z, column, row = (values[order] for values in (x, y, z, column, row))
    starts = np.flatnonzero(np.r_[True, (np.diff(column) != 0) | (np.diff(row) != 0)])
    found = {}
    for first, last in zip(starts, np.r_[starts[1:], len(x)]):
        if last - first < LEAST_POINTS:
            continue
        centre = (column[first] + 0.5) * CELL_M, (row[first] + 0.5) * CELL_M
        matrix = np.c_[np.ones(last - first), x[first:last] - centre[0], y[first:last] - centre[1]]
        heights = z[first:last]
        (height, east, north), _, rank, _ = np.linalg.lstsq(matrix, heights - heights[0], rcond=None)
        residuals = heights - heights[0] - matrix @ (height, east, north)
        is_smooth = np.sqrt((residuals**2).sum() / max(last - first - 3, 1)) <= MOST_RMS_M
        if rank == 3 and is_smooth and np.hypot(east, north) <= MOST_SLOPE:
            found[column[first], row[first]] = height + heights[0]
    return found


def differences(paths):
    """Offset, scatter and number of cells of each pair of clouds, mm."""
    cells = {path: planes(path) for path in paths}
    for one, other in itertools.combinations(paths, 2):
        shared = cells[one].keys() & cells[other].keys()
        if len(shared) < 30:
            continue
        d = 1e3 * np.array([cells[one][cell] - cells[other][cell] for cell in shared])
        offset = np.median(d)
        yield one, other, len(d), offset, 1.4826 * np.median(abs(d - offset))


def perturb(path, out, shift, drift):
    """Moves all points by a shift and a drift about the middle of the strip."""
    cloud = laspy.read(path)
    times = np.array(cloud.gps_time)
    part = (times - times.min()) / max(np.ptp(times), 1e-9) - 0.5
    for axis, name in enumerate("XYZ"):
        steps = np.rint((shift[axis] + part * drift[axis]) / cloud.header.scales[axis]).astype(np.int32)
        setattr(cloud, name, getattr(cloud, name) + steps)
    pathlib.Path(out).parent.mkdir(parents=True, exist_ok=True)
    cloud.write(out)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("clouds", nargs="+", type=pathlib.Path)
    parser.add_argument("--after", type=pathlib.Path, help="folder of the aligned clouds")
    parser.add_argument("--perturb", type=pathlib.Path, help="write the only cloud moved to this file")
    parser.add_argument("--shift", nargs=3, type=float, default=[0.0] * 3, metavar=("X", "Y", "Z"))
    parser.add_argument("--drift", nargs=3, type=float, default=[0.0] * 3, metavar=("X", "Y", "Z"))
    arguments = parser.parse_args()
    if arguments.perturb:
        perturb(arguments.clouds[0], arguments.perturb, arguments.shift, arguments.drift)
        return 0
    sets = {"before": arguments.clouds}
    if arguments.after:
        sets["after"] = [arguments.after / path.name for path in arguments.clouds]
    worst = 0.0
    for name, paths in sets.items():
        found = list(differences(paths))
        if not found:
            sys.exit("no two clouds share 30 smooth cells")
        for one, other, n, offset, scatter in found:
            print(f"{name:6} {one.stem} - {other.stem}: {n} cells, offset {offset:.2f} mm, scatter {scatter:.2f} mm")
        worst = max(abs(offset) for *_, offset, _ in found)
    return int(bool(arguments.after) and worst >= 2.0)


if __name__ == "__main__":
    sys.exit(main())
