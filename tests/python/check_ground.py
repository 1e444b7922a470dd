"""Recall and precision of ground by land cover: worlds with truth, classified by `wavex classify`. Shares no code with it.

    check_ground.py target/release/wavex            six worlds at 1.5, 4 and 16 points per m², some minutes
    check_ground.py target/release/wavex --quick    one small world, some seconds; finds wrong classifications

Each world has a town with a hall, courtyards and cars, a valley with a bridge level with its banks, terraces, a cliff,
and ridges and valleys of one slope, bare and below woods. `land.py` scans them and adds noise. Points are echoes of solids
and of plants at least 0.3 m above the ground. Prints shares of the ground found (recall) and of points classified as
ground that are ground (precision), percent. LIMITS are the bounds. Needs numpy and laspy.
"""

import argparse
import pathlib
import subprocess
import sys
import tempfile

import laspy
import numpy as np

from land import GROUND, NAMES, ORIGIN, Land, cloud

SLOPES_DEG = (0, 10, 20, 30, 35, 40)
DENSITIES = (1.5, 4.0, 16.0)
# Name, western edge; woods: chance of a leaf in 0.5 m of crowns and of undergrowth, share of pulses that go on after a leaf.
COVERS = (
    ("town", 0, None),
    ("bridge and valley", 90, None),
    ("terraces", 150, None),
    ("cliff", 200, None),
    ("open slope", 230, None),
    ("thin wood", 280, (0.03, 0.02, 0.7)),
    ("wood", 330, (0.08, 0.05, 0.5)),
    ("dense wood", 380, (0.2, 0.05, 0.35)),
    ("wood with understory", 430, (0.03, 0.4, 0.6)),
)
WEST = np.array([west for _, west, _ in COVERS])
EAST_M = 480.0
PERIOD_M = 160.0


class World(Land):
    """Covers side by side from west to east."""

    masts = chimneys = []
    wires = []

    def __init__(self, seed, slope_deg, size_m):
        random = self.random = np.random.default_rng(1000 + seed)
        self.slope = np.tan(np.radians(slope_deg))
        self.phase = random.uniform(0, 6, 4)
        self.cliff_m = random.uniform(15, 40)
        self.step_m = random.uniform(1.5, 3)
        self.bridge = (random.uniform(105, 135), size_m[1] / 2 - 15, size_m[1] / 2 + 15, random.uniform(2.5, 6), 0.2)
        self.middle = size_m[1] / 2
        self.houses = [(18, 8, 45, 30, 9)]
        for _ in range(30):
            house = (*random.uniform([2, 42], [75, size_m[1] - 18]), *random.uniform(7, 15, 2), random.uniform(3, 14))
            if all(max(abs(house[0] - other[0]), abs(house[1] - other[1])) > 18 for other in self.houses[1:]):
                self.houses.append(house)
        # A courtyard between four wings, and cars.
        self.houses += [(w + 30, s + 60, a, b, 12) for w, s, a, b in [(0, 0, 36, 8), (0, 20, 36, 8), (0, 0, 8, 28), (28, 0, 8, 28)]]
        self.houses += [(*random.uniform([2, 42], [85, size_m[1] - 5]), 1.8, 4.5, 1.5) for _ in range(15)]
        super().__init__(size_m)

    def ground_m(self, x, y):
        a, b, c, d = self.phase
        z = 60 + 3 * np.sin(x / 41 + a) * np.cos(y / 29 + b) + 0.12 * np.sin(x / 2.9 + c) * np.sin(y / 3.7 + d)
        valley = (abs(y - self.middle) < 15) & (x > 90) & (x < 150)
        z = z - np.where(valley, 9 * np.cos((y - self.middle) / 15 * np.pi / 2), 0)
        terrace = np.clip(np.floor((x - 140) / 12), 0, 5)
        z = z + self.step_m * terrace + np.where(x > 215, self.cliff_m, 0)
        # Ridges along x with a hipped end: one slope everywhere.
        along = abs((y + 0.25 * PERIOD_M) % PERIOD_M - 0.5 * PERIOD_M)
        return z + self.slope * np.minimum(along, np.clip(x - 230, 0, None))

    def leaves(self, x, y, above):
        cover = np.clip(np.searchsorted(WEST, x, side="right") - 1, 0, len(COVERS) - 1)
        crown, under, goes_on = (np.array(row)[cover] for row in zip(*(plants or (0, 0, 0.6) for _, _, plants in COVERS)))
        # Undergrowth is lower in some places than in others.
        high = 1.2 + 0.8 * np.sin(x / 5) * np.sin(y / 6)
        chance = np.where((above > 9) & (above < 24), crown, np.where((above > 0.3) & (above < high), under, 0.0))
        return chance, goes_on


def write(path, table):
    """Writes a cloud as LAS 1.4."""
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = [0.001] * 3, ORIGIN
    las = laspy.LasData(header)
    las.x, las.y, las.z = table[:, :3].T
    las.return_number[:], las.number_of_returns[:] = table[:, 6:8].T.astype(np.uint8)
    las.point_source_id[:] = 1
    las.write(path)


def count(is_found, is_ground, groups):
    """Ground, ground found, and points found as ground, by group."""
    return np.array([[(is_ground & group).sum(), (is_ground & is_found & group).sum(), (is_found & group).sum()] for group in groups])


def percent(counts):
    """Recall and precision by group, percent."""
    ground, both, found = counts.T
    return 100 * both / np.maximum(ground, 1), 100 * both / np.maximum(found, 1)


def broken(counts):
    """Covers whose recall or precision is below the bounds, percent."""
    wrong = []
    for (name, _, _), recall, precision in zip(COVERS, *percent(counts)):
        for what, value, least in zip(("recall", "precision"), (recall, precision), LIMITS.get(name, (98, 95))):
            wrong += [f"{name}: {what} {value:.1f} %, not {least} %"] if value < least else []
    return wrong


# Least recall and precision at each density, percent; of other covers 98 and 95. `docs/explanation/ground.md` gives the reason.
LIMITS = {"thin wood": (97, 98), "wood": (97, 96), "dense wood": (96, 97), "wood with understory": (95, 85)}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--density", type=float, nargs="*", default=DENSITIES)
    parser.add_argument("--clouds", type=pathlib.Path, help="folder that keeps the clouds for the next call")
    arguments = parser.parse_args()
    worlds = [(0, 20)] if arguments.quick else list(enumerate(SLOPES_DEG))
    wrong = []
    for density in (2.0,) if arguments.quick else arguments.density:
        total, by_slope = 0, {}
        for seed, slope_deg in worlds:
            with tempfile.TemporaryDirectory() as name:
                folder = pathlib.Path(name)
                kept = arguments.clouds and arguments.clouds / f"ground{seed}_{density}.npz"
                if kept and kept.exists():
                    table, kinds = np.load(kept).values()
                else:
                    # Dense clouds cover half the length.
                    world = World(seed, slope_deg, (EAST_M, 120.0 if density > 8 or arguments.quick else 200.0))
                    table, kinds = cloud(seed, world, density)
                    if kept:
                        np.savez(kept, table, kinds)
                write(folder / "a.las", table)
                subprocess.run([arguments.program, "classify", folder / "a.las", "-o", folder / "b.las", "--quiet"], check=True)
                is_found = np.asarray(laspy.read(folder / "b.las").classification == 2)
            cover = np.searchsorted(WEST, table[:, 0] - ORIGIN[0], side="right") - 1
            groups = [cover == at for at in range(len(COVERS))]
            counts = count(is_found, kinds == GROUND, groups)
            total, by_slope[slope_deg] = total + counts, counts
            kinds_found = {NAMES[kind]: int((is_found & (kinds == kind)).sum()) for kind in np.unique(kinds[is_found]) if kind != GROUND}
            print(f"{density} per m², slope {slope_deg}°: {len(table)} points; others taken for ground, by kind: {kinds_found}", flush=True)
            if arguments.quick:
                # The check itself: no ground, everything ground, roofs and plants taken for ground.
                for found in (np.zeros(len(kinds), bool), np.ones(len(kinds), bool), kinds <= 2, np.isin(kinds, [GROUND, 6])):
                    assert broken(count(found, kinds == GROUND, groups)), "a wrong classification is not found"
        recall, precision = percent(total)
        print(f"{'cover':22}{'ground points':>14}{'recall':>8}{'precision':>11}  recall/precision at " + " ".join(f"{slope}°" for slope in by_slope))
        slopes = [percent(counts) for counts in by_slope.values()]
        for at, (name, _, _) in enumerate(COVERS):
            print(f"{name:22}{total[at][0]:14}{recall[at]:8.1f}{precision[at]:11.1f}  "
                  + " ".join(f"{r[at]:.0f}/{p[at]:.0f}" for r, p in slopes))
        wrong += [f"{density} per m²: {line}" for line in broken(total)]
    print("\n".join(wrong))
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
