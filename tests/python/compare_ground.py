"""Compares `wavex classify` with other ground filters on the ISPRS samples, each with one set of settings.

    pip install laspy numpy cloth-simulation-filter pysmrf
    python tests/python/compare_ground.py target/release/wavex DATA/isprs

Peers that are not installed are left out. Times are those of one process, with reading and writing for wavex.
"""

import argparse
import gzip
import pathlib
import subprocess
import tempfile
import time

import laspy
import numpy as np


def wavex(program, points, folder):
    """Classifies by the program; returns whether each point is ground."""
    header = laspy.LasHeader(point_format=1, version="1.2")
    header.scales, header.offsets = [0.01] * 3, np.floor(points.min(0))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.return_number[:] = las.number_of_returns[:] = 1
    source, copy = folder / "a.las", folder / "b.las"
    las.write(source)
    start = time.perf_counter()
    subprocess.run([program, "classify", source, "-o", copy, "--threads", "1", "--quiet"], check=True)
    return laspy.read(copy).classification == 2, time.perf_counter() - start


def smrf(points):
    """Simple morphological filter (Pingel et al. 2013)."""
    import pysmrf

    start = time.perf_counter()
    _, _, _, is_object = pysmrf.smrf(
        *points.T, cellsize=1.0, windows=18, slope_threshold=0.15, elevation_threshold=0.5, elevation_scaler=1.25
    )
    return ~is_object, time.perf_counter() - start


def cloth(points):
    """Cloth simulation filter (Zhang et al. 2016)."""
    import CSF

    start = time.perf_counter()
    csf = CSF.CSF()
    csf.params.bSloopSmooth = True
    csf.params.cloth_resolution, csf.params.rigidness, csf.params.class_threshold = 1.0, 2, 0.5
    csf.setPointCloud(points)
    ground, other = CSF.VecInt(), CSF.VecInt()
    csf.do_filtering(ground, other, False)
    is_ground = np.zeros(len(points), bool)
    is_ground[np.array(ground)] = True
    return is_ground, time.perf_counter() - start


def rates(is_ground, truth):
    """Type I, type II and total error, and kappa, percent."""
    total = np.mean(is_ground != truth)
    chance = truth.mean() * is_ground.mean() + (1 - truth.mean()) * (1 - is_ground.mean())
    return [100 * value for value in (np.mean(~is_ground[truth]), np.mean(is_ground[~truth]), total,
                                      1 - total / (1 - chance))]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("program", help="wavex, of a release build")
    parser.add_argument("samples", type=pathlib.Path, help="folder of samp*.txt.gz: x, y, z, 0 for ground")
    arguments = parser.parse_args()
    print(f"{'sample':<10}{'filter':<8}{'type I, %':>10}{'type II, %':>11}{'total, %':>10}{'kappa, %':>10}{'time, s':>9}")
    found = {}
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        filters = {
            "wavex": lambda points: wavex(arguments.program, points, folder),
            "SMRF": smrf,
            "cloth": cloth,
        }
        for path in sorted(arguments.samples.glob("samp*.txt*")):
            with (gzip.open if path.suffix == ".gz" else open)(path, "rt") as file:
                rows = np.loadtxt(file)
            points, truth = np.ascontiguousarray(rows[:, :3]), rows[:, 3] == 0
            for label, classify in filters.items():
                try:
                    is_ground, seconds = classify(points)
                except ImportError:
                    continue
                row = [*rates(is_ground, truth), seconds]
                found.setdefault(label, []).append(row)
                print(f"{path.name.split('.')[0]:<10}{label:<8}", *(f"{value:9.1f}" for value in row), flush=True)
    for label, values in found.items():
        print(f"{'mean':<10}{label:<8}", *(f"{value:9.1f}" for value in np.mean(values, 0)))


if __name__ == "__main__":
    main()
