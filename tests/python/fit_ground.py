"""Fits the constants of crates/wavex-footprints/src/constants.rs, and compares probabilities and SDs with the truth.

The distance of the ground below the lowest mode is normal about 0, normal about a second candidate, or exponential, where
nothing shows the ground. Weights, SDs, the second candidate and the exponential scale are linear in the features of the mode, or
their logarithms are. On shots that were not fitted, probabilities are calibrated, and the SD of the first candidate is scaled to the
robust SD of its errors.

usage: fit_ground.py PROGRAM [--train FILE.h5 ... --calibrate FILE.h5 ...] [--test FILE.h5 ...]

PROGRAM is the example `ground_features` of wavex-footprints. Files are written by make_footprints.py, with their truth. Without
--train nothing is fitted; tests are those of the constants in PROGRAM. Needs h5py, numpy and scipy.
"""

import argparse
import subprocess

import h5py
import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtr

M_PER_SAMPLE = 0.149896229
FEATURES = 12
# As in ground.rs.
LOG_BOUNDS = np.array([(-5.0, 1.0), (-2.0, 3.0), (-2.0, 1.1), (0.0, 3.4)]).T
OUTPUTS = 3 + LOG_BOUNDS.shape[1]
NEAR_M, NEAR_SDS, ABOVE_M = 1.0, 3.0, 1.0
# Weight of the squared constants; features are scaled.
RIDGE = 2e-5
# Robust SD of a standard normal variable over its median absolute value.
ROBUST = 1.4826


def measured(program, path, beam):
    """One row per shot: numbers printed by the program."""
    samples = []
    for outgoing, received in zip(*(split(beam, kind) for kind in ("tx", "rx"))):
        samples += [np.array([outgoing.size, received.size], "<u4").tobytes(), outgoing.tobytes(), received.tobytes()]
    lines = subprocess.run([program], input=b"".join(samples), stdout=subprocess.PIPE, check=True).stdout.decode().splitlines()
    width = FEATURES + 8
    return np.array([np.array(line.split() or [np.nan] * width, float) for line in lines])


def split(beam, kind):
    ends = np.cumsum(beam[f"{kind}_sample_count"][:].astype(int))
    return np.split(beam[f"{kind}waveform"][:].astype("<f4"), ends[:-1])


def read(program, paths):
    """Results with a ground and their truth."""
    parts = []
    for path in paths:
        truth = np.load(path.replace(".h5", "_truth.npz"))
        place = {number: row for row, number in enumerate(truth["shot_number"])}
        with h5py.File(path) as file:
            beams = [beam for name, beam in file.items() if name.startswith("BEAM")]
            rows = np.concatenate([measured(program, path, beam) for beam in beams])
            order = [place[number] for beam in beams for number in beam["shot_number"][:]]
        known = {name: truth[name][order] for name in ("ground_sample", "cover", "sensitivity", "slope_deg")}
        error = (known["ground_sample"] - rows[:, 0]) * M_PER_SAMPLE
        # The truth refers to a Gaussian of the outgoing pulse, not to the mode of a flat target's echo.
        offset = np.nanmedian(error[(known["cover"] == 0) & (known["slope_deg"] < 5)])
        parts.append(np.column_stack([rows, error - offset, known["cover"], known["sensitivity"], known["slope_deg"]]))
    rows = np.concatenate(parts)
    rows = rows[np.isfinite(rows[:, 0])]
    second_m = (rows[:, FEATURES + 4] - rows[:, 0]) * M_PER_SAMPLE
    stated = {"sd": rows[:, FEATURES + 1] * M_PER_SAMPLE, "probability": rows[:, FEATURES + 2],
              "total_sd": rows[:, FEATURES + 3] * M_PER_SAMPLE, "second_m": second_m,
              "second_sd": rows[:, FEATURES + 5] * M_PER_SAMPLE, "second_probability": rows[:, FEATURES + 6],
              "deviation": rows[:, FEATURES + 7]}  # fmt: skip
    error, *known = rows[:, -4:].T
    names = ("cover", "sensitivity", "slope_deg")
    return {"features": rows[:, 1 : FEATURES + 1], "error": error} | dict(zip(names, known)) | stated


def distribution(constants, features):
    """Logarithms of the weights, parameters and which of them are within bounds."""
    outputs = features @ constants.reshape(OUTPUTS, -1).T
    scores = outputs[:, :3] - outputs[:, :3].max(1, keepdims=True)
    inside = (outputs[:, 3:] > LOG_BOUNDS[0]) & (outputs[:, 3:] < LOG_BOUNDS[1])
    return scores - np.log(np.exp(scores).sum(1, keepdims=True)), np.exp(np.clip(outputs[:, 3:], *LOG_BOUNDS)), inside


def misfit(constants, features, error):
    """Mean negative log-likelihood and its gradient."""
    weights, parameters, inside = distribution(constants, features)
    (sd, second, second_sd, missed), inside = parameters.T, inside.T
    score, second_score = error / sd, (error - second) / second_sd
    parts = weights + np.stack([
        -0.5 * score**2 - np.log(sd * np.sqrt(2 * np.pi)),
        -0.5 * second_score**2 - np.log(second_sd * np.sqrt(2 * np.pi)),
        np.where(error > 0, -error / missed, error / ABOVE_M) - np.log(missed + ABOVE_M),
    ], axis=1)  # fmt: skip
    highest = parts.max(1, keepdims=True)
    total = highest + np.log(np.exp(parts - highest).sum(1, keepdims=True))
    share = np.exp(parts - total)
    slopes = np.column_stack([
        np.exp(weights) - share, -share[:, 0] * (score**2 - 1) * inside[0],
        -share[:, 1] * second_score / second_sd * second * inside[1], -share[:, 1] * (second_score**2 - 1) * inside[2],
        -share[:, 2] * (np.maximum(error, 0) / missed - missed / (missed + ABOVE_M)) * inside[3],
    ]) / len(error)  # fmt: skip
    small = constants.copy()
    small[:: features.shape[1]] = 0
    return -total.mean() + RIDGE * small @ small, (slopes.T @ features).ravel() + 2 * RIDGE * small


def below(constants, features, factor, distance):
    """Probability that the ground is less than a distance below the mode."""
    weights, parameters, _ = distribution(constants, features)
    sd, second, second_sd, missed = parameters.T
    share = missed / (missed + ABOVE_M)
    tail = np.where(distance > 0, 1 - share * np.exp(-np.maximum(distance, 0) / missed),
                    (1 - share) * np.exp(np.minimum(distance, 0) / ABOVE_M))  # fmt: skip
    parts = np.stack([ndtr(distance / (factor * sd)), ndtr((distance - second) / second_sd), tail], axis=1)
    return (np.exp(weights) * parts).sum(1)


def fit(features, error):
    """Constants of largest likelihood."""
    mean, scale = features.mean(0), features.std(0)
    mean[0], scale[0] = 0.0, 1.0
    start = np.zeros(OUTPUTS * FEATURES)
    start[::FEATURES] = [1.0, -0.5, -1.0, -2.5, 0.7, 0.0, 2.0]
    options = {"maxiter": 800, "maxfun": 10**6}
    best = minimize(misfit, start, args=((features - mean) / scale, error), jac=True, method="L-BFGS-B", options=options).x
    factors = best.reshape(OUTPUTS, FEATURES) / scale
    factors[:, 0] -= factors[:, 1:] @ mean[1:]
    return factors.ravel()


def calibrate(constants, features, error):
    """Factor of the SD, and calibration of the probability."""
    sd = distribution(constants, features)[1][:, 0]
    near = abs(error) < np.maximum(NEAR_M, NEAR_SDS * sd)
    factor = ROBUST * np.median(abs(error / sd)[near])
    half = np.maximum(NEAR_M, NEAR_SDS * factor * sd)
    part = below(constants, features, factor, half) - below(constants, features, factor, -half)
    return factor, calibration(part, abs(error) < half)


def calibration(part, right):
    """Logistic regression of right on the log-odds of a probability and their square."""
    part = np.clip(part, 1e-3, 0.9995)
    odds = np.log(part / (1 - part))
    powers, found = np.stack([np.ones_like(odds), odds, odds**2], axis=1), np.array([0.0, 1.0, 0.0])
    for _ in range(30):
        now = 1 / (1 + np.exp(-powers @ found))
        found += np.linalg.solve((powers * (now * (1 - now))[:, None]).T @ powers, powers.T @ (right - now))
    return found


def show(constants, factor, calibrated):
    row = lambda values: "[" + ", ".join(f"{value:.4f}" for value in values) + "]"
    print("OUTPUTS = [", *(f"    {row(factors)}," for factors in constants.reshape(OUTPUTS, -1)), "];", sep="\n")
    print(f"SD_FACTOR = {factor:.4f};\nCALIBRATION = {row(calibrated)};")


def table(name, stated, right, edges):
    print(f"{name}:")
    for least, most in zip(edges[:-1], edges[1:]):
        of = (stated >= least) & (stated < most)
        print(f"  {least:.2f} to {most:.2f}: {of.sum():5} shots, mean {stated[of].mean():.3f}, right {right[of].mean():.3f}")


def report(shots):
    error, sd, second_sd = shots["error"], shots["sd"], shots["second_sd"]
    right = abs(error) < np.maximum(NEAR_M, NEAR_SDS * sd)
    second = ~right & (abs(error - shots["second_m"]) < np.maximum(NEAR_M, NEAR_SDS * second_sd))
    table("probability of the ground", shots["probability"], right, (0, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99, 1))
    table("probability of the second candidate", shots["second_probability"], second, (0.05, 0.2, 0.4, 0.6, 0.8, 1))
    for least, most in ((0, 0.001), (0.001, 0.3), (0.3, 0.6), (0.6, 0.8), (0.8, 0.9), (0.9, 1)):
        of = (shots["cover"] >= least) & (shots["cover"] < most)
        scores = abs(error / sd)[of & right]
        print(f"cover {least:.1f} to {most:.1f}: {of.sum():5} shots, mean probability {shots['probability'][of].mean():.2f}, right "
              f"{right[of].mean():.3f}, z of these {ROBUST * np.median(scores):.2f}, their 68 % {np.quantile(scores, 0.6827):.2f}, median error on slopes below 10 degrees "
              f"{np.median(error[of & right & (shots['slope_deg'] < 10)]):.3f} m")  # fmt: skip
    edges = (0, 0.15, 0.5, 1, 2, 4, 8, 12, np.inf)
    for least, most in zip(edges[:-1], edges[1:]):
        of = (shots["total_sd"] >= least) & (shots["total_sd"] < most)
        total, rms = shots["total_sd"][of], np.sqrt(((error / shots["total_sd"])[of] ** 2).mean())
        print(f"total SD {least} to {most} m: {of.sum():5} shots, mean {total.mean():.2f}, RMS of error over it {rms:.2f}")
    seen = shots["cover"] < shots["sensitivity"]
    print(f"cover below the sensitivity: {seen.sum()} shots, first candidate right {right[seen].mean():.3f}, "
          f"one of both {(right | second)[seen].mean():.3f}; distance to the second where it is right, median "
          f"{np.median(abs(error - shots['second_m'])[second]):.2f} m, its SD {np.median(second_sd[second]):.2f} m")  # fmt: skip
    median, *ends = np.nanquantile(shots["deviation"], [0.5, 0.01, 0.99])
    spread = ROBUST * np.nanmedian(abs(shots["deviation"] - median))
    print(f"deviation: median {median:.2f}, robust SD {spread:.2f}, 1 and 99 % {ends[0]:.2f} and {ends[1]:.2f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program")
    parser.add_argument("--train", nargs="+", default=[])
    parser.add_argument("--calibrate", nargs="+", default=[])
    parser.add_argument("--test", nargs="+", default=[])
    options = parser.parse_args()
    if options.train:
        fitted, others = (read(options.program, files) for files in (options.train, options.calibrate))
        constants = fit(fitted["features"], fitted["error"])
        show(constants, *calibrate(constants, others["features"], others["error"]))
    if options.test:
        report(read(options.program, options.test))


if __name__ == "__main__":
    main()
