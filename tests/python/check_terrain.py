"""Standard deviations of terrain models against terrain that is known.

The terrain is made here, without a covariance function: ridged noise, terraces, ditches, kerbs. Points come in
scan lines of overlapping strips with height errors; in the forest, some hit the ground and some low plants that a
classification took for ground. The program models the terrain, and the errors at the centres of cells, divided by their
standard deviations, must have an SD between 0.9 and 1.1 by land cover and by distance to the nearest point.

The errors of an area are not independent: its few strips share theirs, and a wide gap is one event with hundreds of cells. The
sampling error of each SD is found by bootstrap over the areas. A right program exceeds the bounds by chance where twice this
error is more than 0.1. The bound is then twice the sampling error, but at most 0.25. With fewer than eight areas it is always 0.1.
Each run verifies that SDs that are 0.7 or 1.4 times as large fail.

usage: check_terrain.py PROGRAM [--quick] [--worlds N] [--first SEED] [--cell M] [--classify]

PROGRAM is the example `terrain_cells` of the crate wavex-ground
(`cargo build -p wavex-ground --release --example terrain_cells`). Needs numpy, and scipy for the comparison with
linear interpolation in the triangulation. With `--classify`, PROGRAM is wavex: strips get trees, houses and shrubs, and
`wavex classify --dem` finds the ground and models it (needs laspy and rasterio). `--quick` models one small world with wide bounds, and verifies that this script finds standard deviations that are too
small or too large.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

COVERS = ("open", "forest", "town")
LIMITS_M = [0, 0.35, 0.7, 1.4, 2.8, 5.6, 11.2, 30]
BIAS_LIMIT_M = 0.02
# Deviation of the SD from 1 that is accepted, and the largest one that a sampling error excuses.
SPREAD_LIMIT, MOST_SPREAD_LIMIT = 0.1, 0.25
# Fewest areas with a class for its sampling error.
FEWEST_AREAS = 8


class Field:
    """Smooth noise between 0 and 1 of one wavelength."""

    def __init__(self, random, wavelength_m):
        self.wavelength_m = wavelength_m
        self.values = random.random((64, 64))
        self.offset = random.random(2) * 64

    def at(self, x, y):
        u, v = x / self.wavelength_m + self.offset[0], y / self.wavelength_m + self.offset[1]
        i, j = np.floor(u).astype(int), np.floor(v).astype(int)
        s, t = u - i, v - j
        s, t = s**3 * (6 * s * s - 15 * s + 10), t**3 * (6 * t * t - 15 * t + 10)
        value = lambda a, b: self.values[(i + a) % 64, (j + b) % 64]
        return (value(0, 0) * (1 - s) + value(1, 0) * s) * (1 - t) + (value(0, 1) * (1 - s) + value(1, 1) * s) * t


class World:
    """Three strips of land: open with terraces and ditches, forest, town."""

    def __init__(self, seed, width_m, length_m):
        random = self.random = np.random.default_rng(seed)
        self.width_m, self.length_m = width_m, length_m
        self.hills = [(Field(random, w), h) for w, h in ((170, 25), (70, 8))]
        self.ridged = [(Field(random, w), h) for w, h in ((40, 2.5), (17, 0.7), (7, 0.15))]
        self.meadow = [(Field(random, w), h) for w, h in ((30, 0.6), (9, 0.06))]
        self.density = Field(random, 25)
        self.ditches = [(random.random() * length_m, random.normal(0, 0.3), 0.4 + 0.6 * random.random()) for _ in range(3)]
        self.houses = [
            (self.width_m * 2 + 5 + random.random() * (width_m - 25), random.random() * (length_m - 20), *(8 + 12 * random.random(2)))
            for _ in range(int(width_m * length_m / 900))
        ]

    def cover(self, x):
        return np.clip((x / self.width_m).astype(int), 0, 2)

    def height(self, x, y):
        z = 100 + sum(h * field.at(x, y) for field, h in self.hills)
        cover = self.cover(x)
        # The covers meet smoothly.
        nearness = lambda k: np.clip(1.5 - np.abs(x / self.width_m - 0.5 - k) * 2, 0, 1)
        weights = [nearness(k) for k in range(3)]
        total = sum(weights) + 1e-9
        forest = sum(h * (1 - np.abs(2 * field.at(x, y) - 1)) for field, h in self.ridged)
        open_land = sum(h * field.at(x, y) for field, h in self.meadow)
        z = z + (weights[1] * forest + weights[0] * open_land) / total
        # Terraces of 0.8 m on the open land, with banks 1 m wide, which end before the forest.
        step = y / 33 + 0.3 * np.sin(x / 20)
        terraced = np.clip((self.width_m - 10 - x) / 10, 0, 1)
        z = z + 0.8 * (terraced * (np.floor(step) + np.clip((step % 1) * 33, 0, 1)) + (1 - terraced) * step)
        for y0, slope, depth in self.ditches:
            away = np.abs(y - y0 - slope * x)
            z = z - depth * np.clip(1.5 - away, 0, 1) * np.clip((2 * self.width_m - x) / 10, 0, 1)
        # Kerbs of streets in the town.
        street = np.minimum(np.abs((x % 45) - 22), np.abs((y % 60) - 30))
        return z - np.where((cover == 2) & (street < 3), 0.12, 0)

    def is_built(self, x, y):
        inside = np.zeros(len(x), bool)
        for x0, y0, w, d in self.houses:
            inside |= (x > x0) & (x < x0 + w) & (y > y0) & (y < y0 + d)
        return inside

    def points(self, known_sd):
        """Ground points: east, north, height, SD and strip."""
        random, rows = self.random, []
        spacing_m, half_width_m = 60.0, 50.0
        # Strips cross all covers, so that their errors are the same in all of them.
        for strip in range(int(self.length_m / spacing_m) + 1):
            offset = random.normal(0, 0.03)
            # Lines across the flight, 1 m apart, with shots every 0.4 m: 2.5 shots per m² and strip before losses.
            lines = np.arange(0, 3 * self.width_m, 1.0)
            across = np.arange(-half_width_m, half_width_m, 0.4)
            y = (strip * spacing_m + across[None, :] + 0.2 * random.random((len(lines), 1))).ravel()
            wave = 0.06 * np.sin(across / 15)[None, :]
            x = (lines[:, None] + wave + 0.02 * random.normal(size=(len(lines), len(across)))).ravel()
            inside = (x > 0) & (x < 3 * self.width_m) & (y > 0) & (y < self.length_m)
            x, y = x[inside], y[inside]
            cover = self.cover(x)
            # Forest: the canopy passes 10 to 60 % of the shots, and nothing where it is dense. Town: nothing under houses.
            density = self.density.at(x, y)
            share = np.where(density < 0.3, 0, 0.05 + 0.55 * density**2)
            share = np.where(cover == 1, share, 1.0)
            kept = (random.random(len(x)) < share) & ~((cover == 2) & self.is_built(x, y))
            x, y, cover = x[kept], y[kept], cover[kept]
            sd = np.where(cover == 1, 0.035, 0.02)
            z = self.height(x, y) + offset + sd * random.normal(size=len(x))
            plants = (cover == 1) & (random.random(len(x)) < 0.02)
            z = z + np.where(plants, random.exponential(0.3, len(x)), 0)
            given = np.hypot(sd, 0.03) if known_sd else np.full(len(x), np.nan)
            rows.append(np.column_stack([x, y, z, given, np.full(len(x), strip)]))
        return np.concatenate(rows)


def modelled(program, points, cell_m, folder):
    source, out = Path(folder, "points.txt"), Path(folder, "cells.txt")
    np.savetxt(source, points, fmt="%.3f %.3f %.4f %.4f %d")
    run = subprocess.run([program, source, str(cell_m), out], check=True, capture_output=True, text=True)
    print(run.stdout.strip())
    return np.loadtxt(out, ndmin=2)


def classified(program, world, points, cell_m, folder):
    """Cells of a model by `wavex classify --dem` of strips with everything that is on the ground."""
    import laspy
    import rasterio

    random = world.random
    strips = Path(folder, "strips")
    strips.mkdir()
    for strip in np.unique(points[:, 4]):
        x, y, z = points[points[:, 4] == strip, :3].T
        n = int(2.5 * 3 * world.width_m * min(100, world.length_m))
        u = random.random(n) * 3 * world.width_m
        v = np.clip(strip * 60 - 50, 0, None) + random.random(n) * 100
        u, v = u[v < world.length_m], v[v < world.length_m]
        cover = world.cover(u)
        ground = world.height(u, v)
        # Crowns of 8 to 18 m, houses with flat roofs.
        tree = (cover == 1) & (random.random(len(u)) < 0.8)
        house = (cover == 2) & world.is_built(u, v)
        top = np.where(house, 112 + 0 * u, ground + 18 - 10 * random.random(len(u)) ** 2)
        top = np.where(house, np.maximum(ground + 4, top), top)
        on_top = tree | house
        x, y, z = (np.concatenate(pair) for pair in ((x, u[on_top]), (y, v[on_top]), (z, top[on_top])))
        las = laspy.create(point_format=6, file_version="1.4")
        las.header.scales, las.header.offsets = [0.001] * 3, [4e5, 5.8e6, 0]
        las.x, las.y, las.z = x + 4e5, y + 5.8e6, z
        las.return_number[:] = 1
        las.number_of_returns[:] = 1
        las.point_source_id[:] = int(strip) + 1
        las.write(strips / f"strip{int(strip)}.las")
    dem = Path(folder, "terrain.tif")
    words = [program, "classify", strips, "-o", Path(folder, "out"), "--dem", dem, "--cell", str(cell_m)]
    run = subprocess.run(words, check=True, capture_output=True, text=True)
    print("\n".join(run.stdout.strip().splitlines()[-2:]))
    with rasterio.open(dem) as raster:
        assert raster.count == 4 and raster.descriptions[1].startswith("SD"), raster.descriptions
        height, sd, n, distance = raster.read()
        row, column = np.nonzero(height != raster.nodata)
        x, y = rasterio.transform.xy(raster.transform, row, column)
    bands = [band[row, column] for band in (height, sd, n, distance)]
    return np.column_stack([np.array(x) - 4e5, np.array(y) - 5.8e6, *bands])


def linear(points, cells):
    try:
        from scipy.interpolate import LinearNDInterpolator
    except ImportError:
        return None
    return LinearNDInterpolator(points[:, :2] , points[:, 2])(cells[:, :2])


def spread_of(sums):
    """SD of deviations from their number, sum and sum of squares by area."""
    n, first, second = sums.sum(axis=-2).T
    return np.sqrt(second / n - (first / n) ** 2)


def sampling_error(sums):
    """SD of `spread_of` by bootstrap over the areas; NaN if there are too few."""
    sums = sums[sums[:, 0] > 0]
    if len(sums) < FEWEST_AREAS:
        return np.nan
    chosen = np.random.default_rng(1).integers(0, len(sums), (2000, len(sums)))
    return spread_of(sums[chosen]).std()


def judged(rows, quiet=False):
    """Prints deviations by cover and distance; returns what is out of bounds."""
    cover, distance, error, sd = rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3]
    areas = [rows[:, 5] == area for area in np.unique(rows[:, 5])]
    wrong = []
    classes = [(name, cover == k) for k, name in enumerate(COVERS)]
    classes += [
        (f"{low} to {high} m", (distance >= low) & (distance < high)) for low, high in zip(LIMITS_M, LIMITS_M[1:])
    ]
    if not quiet:
        print(
            f"{'class':14} {'cells':>8} {'bias cm':>8} {'RMS cm':>8} {'SD cm':>8} {'SD of z':>8} {'+-':>5} {'bound':>6}"
            f" {'robust':>7} {'TIN RMS':>8}"
        )
    for name, inside in classes:
        if inside.sum() < 300:
            continue
        z = error / sd
        sums = np.array([[(at := z[inside & area]).size, at.sum(), (at**2).sum()] for area in areas])
        spread, sampling = spread_of(sums), sampling_error(sums)
        limit = SPREAD_LIMIT if np.isnan(sampling) else np.clip(2 * sampling, SPREAD_LIMIT, MOST_SPREAD_LIMIT)
        robust = 1.4826 * np.median(np.abs(z[inside] - np.median(z[inside])))
        bias = error[inside].mean()
        if not abs(spread - 1) <= limit:
            wrong.append(f"{name}: SD of deviations {spread:.2f} +- {sampling:.2f}, not within {limit:.2f} of 1")
        # Errors of strips are the same in the open.
        relative = bias - error[cover == 0].mean()
        if name == "forest" and abs(relative) > BIAS_LIMIT_M:
            wrong.append(f"{name}: bias {100 * relative:.1f} cm beyond that of the open land")
        rms = lambda e: 100 * np.sqrt(np.nanmean(e**2))
        if not quiet:
            print(
                f"{name:14} {inside.sum():8} {100 * bias:8.2f} {rms(error[inside]):8.2f} {rms(sd[inside]):8.2f}"
                f" {spread:8.2f} {sampling:5.2f} {limit:6.2f} {robust:7.2f} {rms(rows[inside, 4]):8.2f}"
            )
    return wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("program")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--classify", action="store_true")
    parser.add_argument("--worlds", type=int, default=6)
    parser.add_argument("--first", type=int, default=0, help="seed of the first world; the others follow")
    parser.add_argument("--cell", type=float, default=1.0)
    arguments = parser.parse_args()
    size = (60, 80) if arguments.quick else (120, 240)
    rows = []
    for seed in range(arguments.first, arguments.first + (1 if arguments.quick else arguments.worlds)):
        world = World(seed, *size)
        points = world.points(known_sd=seed % 2 == 0)
        with tempfile.TemporaryDirectory() as folder:
            if arguments.classify:
                cells = classified(arguments.program, world, points, arguments.cell, folder)
            else:
                cells = modelled(arguments.program, points, arguments.cell, folder)
        tin = linear(points, cells)
        truth = world.height(cells[:, 0], cells[:, 1])
        tin_error = np.full(len(cells), np.nan) if tin is None else tin - truth
        rows.append(np.column_stack([world.cover(cells[:, 0]), cells[:, 5], cells[:, 2] - truth, cells[:, 3], tin_error, np.full(len(cells), seed)]))
    rows = np.concatenate(rows)
    wrong = judged(rows)
    for factor in (0.5, 2.0) if arguments.quick else (0.7, 1.4):
        scaled = rows.copy()
        scaled[:, 3] *= factor
        found = judged(scaled, quiet=True)
        assert found, f"SDs {factor} times as large are not found"
        print(f"SDs {factor} times as large: {len(found)} findings")
    if arguments.quick:
        # One small world has few strips: only the script is judged.
        shifted = rows.copy()
        shifted[shifted[:, 0] == 1, 2] += 0.1
        assert any("bias" in line for line in judged(shifted, quiet=True)), "a bias is not found"
        # The program, with bounds that few strips do not exceed.
        rms_m, spread = np.sqrt((rows[:, 2] ** 2).mean()), (rows[:, 2] / rows[:, 3]).std()
        if len(rows) < 0.9 * 3 * size[0] * size[1] / arguments.cell**2 or rms_m > 0.1 or not 0.3 <= spread <= 1.5:
            sys.exit(f"{len(rows)} cells, RMS {rms_m:.3f} m, SD of deviations {spread:.2f}")
        return
    if wrong:
        sys.exit("\n".join(wrong))


if __name__ == "__main__":
    main()
