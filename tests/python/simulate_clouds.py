"""Simulated clouds with known offsets, aligned by `wavex align`; errors over stated SDs. Shares no code with it.

    simulate_clouds.py target/release/wavex --surveys 12

Each survey has three strips of 80 x 150 m, 20 s and 4 points per m², with 8 mm noise of heights, offsets of 50 mm SD in x, y, z
and, for linear corrections, drifts of 20 mm SD; the second strip is flown in the opposite direction. Terrain: hills, roofs whose
slopes face east and west only, a plain. Fails if errors exceed their SDs, or if what is not estimable is changed.
"""

import argparse
import json
import pathlib
import subprocess
import sys
import tempfile

import laspy
import numpy as np

NORTH_M = 150.0
ORIGIN = np.array([412000.0, 5806000.0, 60.0])


def hills(x, y):
    return 4 * np.sin(x / 23) * np.cos(y / 17) + 0.08 * x


def roofs(x, y):
    u, v = (x % 30) - 15, (y % 30) - 15
    return 0.01 * x + np.where((abs(u) < 6) & (abs(v) < 8), 8 - 0.8 * abs(u), 0)


def plain(x, _):
    return 2 + 0 * x


def write_strip(path, terrain, random, west, east, start_s, errors, is_reversed):
    """A strip with errors that are linear in time between the given ones."""
    n = int(4 * (east - west) * NORTH_M)
    part = (np.arange(n) + 0.5) / n
    x, y = random.uniform(west, east, n), NORTH_M * (1 - part if is_reversed else part)
    z = terrain(x, y) + 0.008 * random.normal(size=n)
    places = ORIGIN + np.c_[x, y, z] + np.outer(1 - part, errors[0]) + np.outer(part, errors[1])
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = [0.001] * 3, ORIGIN
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = places.T
    cloud.gps_time = start_s + 20 * part
    cloud.return_number = cloud.number_of_returns = np.ones(n, int)
    cloud.classification = np.full(n, 2)
    cloud.write(path)


def survey(wavex, terrain, model, seed):
    """Error and SD of each estimated correction by axis, about the mean of all strips; number of others."""
    random = np.random.default_rng(seed)
    errors = []
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        for k, (west, east) in enumerate([(0, 80), (20, 100), (10, 90)]):
            first = random.normal(0, 0.05, 3)
            last = first + (0 if model == "constant" else random.normal(0, 0.02, 3))
            errors.append((first, last))
            name = folder / f"strip{k}.laz"
            write_strip(name, terrain, random, west, east, 1000 * k + 500, errors[-1], k == 1)
        command = [wavex, "align", folder, "-o", folder / "aligned", "--trajectory", model, "--quiet"]
        subprocess.run(command, check=True, capture_output=True)
        strips = json.loads((folder / "aligned/align.json").read_text())["strips"]
    mean = np.mean([np.mean(ends, axis=0) for ends in errors], axis=0)
    found, n_held = [], 0
    for strip, ends in zip(strips, errors):
        for knot, true in zip(strip["knots"], ends):
            for axis, name in enumerate("xyz"):
                value, sd = knot["x_y_z_m"][axis], knot["x_y_z_sd_m"][axis]
                if strip[name] == "estimated":
                    found.append((axis, value + true[axis] - mean[axis], sd))
                else:
                    assert value == 0, "a correction that is not estimable is not 0"
                    n_held += 1
    return found, n_held


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wavex", type=pathlib.Path)
    parser.add_argument("--surveys", type=int, default=12)
    arguments = parser.parse_args()
    is_good = True
    for terrain in (hills, roofs, plain):
        for model in ("constant", "linear"):
            found, n_held = [], 0
            for seed in range(arguments.surveys):
                more, held = survey(arguments.wavex, terrain, model, 1000 + seed)
                found += more
                n_held += held
            print(f"{terrain.__name__}, {model}: {n_held} not estimable")
            for axis, name in enumerate("xyz"):
                errors, sds = np.array([row[1:] for row in found if row[0] == axis]).reshape(-1, 2).T
                if len(errors) == 0:
                    continue
                ratio = np.sqrt(np.mean((errors / sds) ** 2))
                is_good &= ratio < (1.3 if len(errors) > 20 else 2)
                rms = np.sqrt(np.mean(errors**2))
                print(f"  {name}: {len(errors)}, RMS error {1e3 * rms:.2f} mm, mean SD {1e3 * sds.mean():.2f} mm, ratio {ratio:.2f}")
    return int(not is_good)


if __name__ == "__main__":
    sys.exit(main())
