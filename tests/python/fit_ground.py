"""Fits the constants of crates/wavex-footprints/src/ground.rs: how far the lowest mode is from the ground, and the
probability that it is the ground.

Errors are Gaussian about the ground with the probability of the log-odds, and exponential above it otherwise, where a
layer hides the ground. Both the log-odds and the logarithm of the SD are linear in the features of the mode.

usage: fit_ground.py TABLE.parquet TRUTH.npz [TABLE.parquet TRUTH.npz ...] [--test TABLE.parquet TRUTH.npz ...]

Tables are written by `write_footprints` (crs = "EPSG:4979", default settings of `measure_footprints`) from files of
make_footprints.py. Needs numpy, pyarrow and scipy.
"""

import sys

import numpy as np
import pyarrow.parquet
from scipy.optimize import minimize

COLUMNS = ["shot_number", "z", "ground_width_below_ratio", "ground_width_above_ratio", "ground_energy_ratio",
           "ground_amplitude_dn", "ground_amplitude_sd_dn", "modes"]
# As in ground.rs.
LOG_SD_BOUNDS = (-5.0, 2.0)
# Weight of the squared constants; features have similar scales.
RIDGE = 1e-4


def features(table):
    """One row per shot, as `Evidence::features`."""
    log = lambda name, least, most: np.log(np.clip(table[name], least, most))
    strength = table["ground_amplitude_dn"] / table["ground_amplitude_sd_dn"]
    return np.column_stack([
        np.ones(len(strength)),
        log("ground_width_below_ratio", 0.5, 8.0),
        log("ground_width_above_ratio", 0.5, 8.0),
        -log("ground_energy_ratio", 0.02, 1.0),
        np.log(np.clip(strength, 3.0, 2000.0)),
        np.clip(table["modes"] - 1.0, 0.0, 3.0),
    ])


def read(pairs):
    """Features, errors, slopes and covers of all shots with a ground."""
    parts = []
    for table_path, truth_path in zip(pairs[::2], pairs[1::2]):
        table = pyarrow.parquet.read_table(table_path, columns=COLUMNS).to_pydict()
        # Numbers of shots have more digits than a double.
        numbers = np.array(table.pop("shot_number"), "u8")
        known = lambda values: np.array([np.nan if value is None else value for value in values], float)
        table = {name: known(values) for name, values in table.items()}
        truth = np.load(truth_path)
        place = {number: row for row, number in enumerate(truth["shot_number"])}
        rows = np.array([place[number] for number in numbers])
        found = np.isfinite(table["z"])
        error = table["z"] - truth["ground_m"][rows]
        parts.append([part[found] for part in (features(table), error, truth["slope_deg"][rows], truth["cover"][rows])])
    return [np.concatenate(part) for part in zip(*parts)]


def split(constants, count):
    return constants[:count], constants[count:2 * count], np.exp(constants[2 * count])


def predicted(constants, rows):
    """Probability and SD of each shot, and the scale of missed grounds."""
    odds, log_sd, missed = split(constants, rows.shape[1])
    return 1 / (1 + np.exp(-rows @ odds)), np.exp(np.clip(rows @ log_sd, *LOG_SD_BOUNDS)), missed


def misfit(constants, rows, error):
    probability, sd, missed = predicted(constants, rows)
    ground = np.log(probability + 1e-9) - np.log(sd) - 0.5 * (error / sd) ** 2 - 0.5 * np.log(2 * np.pi)
    # A mode is hardly ever below the ground by more than half a metre.
    layer = np.log(1 - probability + 1e-9) - np.log(missed + 0.5) - np.where(error > 0, error / missed, -error / 0.5)
    return -np.logaddexp(ground, layer).mean() + RIDGE * (constants ** 2).mean()


def fit(rows, error):
    count = rows.shape[1]
    mean, scale = rows.mean(0), rows.std(0)
    mean[0], scale[0] = 0.0, 1.0
    start = np.zeros(2 * count + 1)
    start[0], start[count], start[-1] = 1.0, -2.0, 1.5
    options = {"maxiter": 1000, "maxfun": 10 ** 6}
    best = minimize(misfit, start, args=((rows - mean) / scale, error), method="L-BFGS-B", options=options)
    odds, log_sd, _ = split(best.x, count)
    plain = []
    for weights in (odds, log_sd):
        weights = weights / scale
        weights[0] -= weights[1:] @ mean[1:]
        plain.append(weights)
    return np.concatenate([*plain, best.x[-1:]])


def report(constants, rows, error, slope, cover):
    probability, sd, _ = predicted(constants, rows)
    right = abs(error) < np.maximum(1.0, 3 * sd)
    robust = lambda values: 1.4826 * np.median(abs(values - np.median(values)))
    for least, most in ((0, 0.001), (0.001, 0.3), (0.3, 0.6), (0.6, 0.8), (0.8, 0.9), (0.9, 1)):
        of = (cover >= least) & (cover < most)
        sure = of & (probability > 0.9)
        score = error / sd
        print(f"cover {least:.1f} to {most:.1f}: {of.sum():5} shots, z {robust(score[of]):6.2f}; of those with "
              f"p > 0.9: {sure.sum():5}, z {robust(score[sure]):5.2f}, right {right[sure].mean():.3f}")
    for least, most in ((0, 0.5), (0.5, 0.7), (0.7, 0.85), (0.85, 0.95), (0.95, 0.99), (0.99, 1)):
        of = (probability >= least) & (probability < most)
        print(f"p {least:.2f} to {most:.2f}: {of.sum():5} shots, mean p {probability[of].mean():.3f}, right {right[of].mean():.3f}")


def main(arguments):
    at = arguments.index("--test") if "--test" in arguments else len(arguments)
    rows, error, *_ = train = read(arguments[:at])
    constants = fit(rows, error)
    odds, log_sd, missed = split(constants, rows.shape[1])
    show = lambda values: "[" + ", ".join(f"{value:.4f}" for value in values) + "]"
    print(f"{len(error)} shots\nLOG_ODDS {show(odds)}\nLOG_SD   {show(log_sd)}\nscale of missed grounds {missed:.2f} m")
    report(constants, *(read(arguments[at + 1:]) if at < len(arguments) else train))


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    main(sys.argv[1:])
