"""Decompose simulated waveforms with wavex, SciPy's usual script and gdecomp.

Prints a table in Markdown: waveforms per second of processor time, echoes found, missed and false, and the
spread of their ranges. gdecomp runs in a process of its own. Waveforms have one to three echoes at known positions, 60 samples of 1 ns, noise
with an SD of 1 DN, and 8 bits.

    pip install wavex scipy gdecomp
    python benchmarks/compare.py
"""

import argparse
import multiprocessing
import os
from typing import Any

# One core each: libraries start threads when they are imported.
for variable in ["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"]:
    os.environ[variable] = "1"

import numpy as np

import wavex

SAMPLES = 60
FWHM_NS = 4.5
BACKGROUND_DN = 5.0
FULL_SCALE_DN = 255
MPS = 299_792_458.0
NS_TO_M = 1e-9 * MPS / 2


def simulate(count: int, seed: int) -> tuple[np.ndarray, np.ndarray, list[np.ndarray]]:
    """Make waveforms, and the index and position of each echo, ns."""
    random = np.random.default_rng(seed)
    echoes = random.choice([1, 2, 3], size=count, p=[0.6, 0.3, 0.1])
    k = np.arange(SAMPLES)
    waveforms = random.normal(BACKGROUND_DN, 1.0, (count, SAMPLES)).astype("f4")
    owners, positions = [], []
    first = random.uniform(8, 25, count)
    for number in range(3):
        has = echoes > number
        position = first[has] + number * random.uniform(6, 14, has.sum())
        height = random.uniform(12, 150, has.sum())
        shape = np.exp(-4 * np.log(2) * ((k - position[:, None]) / FWHM_NS) ** 2)
        waveforms[has] += (height[:, None] * shape).astype("f4")
        inside = position < SAMPLES - 3
        owners.append(np.flatnonzero(has)[inside])
        positions.append(position[inside])
    samples = np.clip(np.round(waveforms), 0, FULL_SCALE_DN).astype("u2")
    return samples, np.concatenate(owners), np.concatenate(positions)


def by_wavex(samples: np.ndarray, model: wavex.SensorModel, mode: str) -> tuple[np.ndarray, np.ndarray]:
    """Decompose with wavex; indices of waveforms and positions of echoes, ns."""
    found = wavex.decompose_samples(samples, 0.0, model, threads=1, mode=mode)
    return found["waveform"].astype(int), found["time_ns"]


def by_scipy(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Decompose as scripts usually do: maxima, then Gaussians by least squares."""
    from scipy.optimize import curve_fit
    from scipy.signal import find_peaks

    k = np.arange(SAMPLES, dtype=float)

    def gaussians(x, background, *parameters):
        total = np.full_like(x, background)
        for height, position, sd in zip(parameters[::3], parameters[1::3], parameters[2::3]):
            total += height * np.exp(-0.5 * ((x - position) / sd) ** 2)
        return total

    owners, positions = [], []
    for index, waveform in enumerate(samples.astype(float)):
        peaks, _ = find_peaks(waveform, height=BACKGROUND_DN + 5, prominence=4, distance=3)
        if len(peaks) == 0:
            continue
        start = [BACKGROUND_DN]
        for peak in peaks:
            start += [waveform[peak] - BACKGROUND_DN, float(peak), FWHM_NS / 2.355]
        try:
            fitted, _ = curve_fit(gaussians, k, waveform, start, maxfev=2000)
        except RuntimeError:
            continue
        owners += [index] * len(peaks)
        positions += list(fitted[2::3])
    return np.array(owners, int), np.array(positions)


def of_gdecomp(samples: np.ndarray, pipe: Any) -> None:
    """Send what gdecomp finds: it returns area, position and SD of each Gaussian."""
    from gdecomp import GaussianDecomposition

    owners, positions = [], []
    for index, waveform in enumerate(np.maximum(samples.astype(float) - BACKGROUND_DN, 0)):
        for _, position, _ in np.reshape(GaussianDecomposition(waveform), (-1, 3)):
            owners.append(index)
            positions.append(position)
    pipe.send((np.array(owners, int), np.array(positions)))


def by_gdecomp(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Decompose with gdecomp in another process, which it can end by a fault."""
    context = multiprocessing.get_context("fork")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=of_gdecomp, args=(samples, sender))
    process.start()
    sender.close()
    try:
        return receiver.recv()
    except EOFError:
        process.join()
        raise RuntimeError(f"ends with signal {-(process.exitcode or 0)} on noisy waveforms") from None
    finally:
        process.join()


def score(found, truth, count: int) -> tuple[float, float, float, float]:
    """Percent found, missed and false, and the robust SD of the range, mm."""
    (owners, positions), (true_owners, true_positions) = found, truth
    # Keys in one order: waveforms lie further apart than echoes in them.
    scale = 10 * SAMPLES
    mine = np.sort(owners * scale + positions)
    true = np.sort(true_owners * scale + true_positions)
    if len(mine) == 0:
        return 0.0, 100.0, 0.0, np.nan
    at = np.clip(np.searchsorted(mine, true), 1, len(mine) - 1) if len(mine) > 1 else np.zeros(len(true), int)
    left = np.abs(mine[at - 1] - true) < np.abs(mine[at] - true)
    nearest = np.where(left, at - 1, at)
    error = mine[nearest] - true
    hit = np.abs(error) < 2.0
    used = len(np.unique(nearest[hit]))
    sd_mm = 1e3 * NS_TO_M * 1.4826 * np.median(np.abs(error[hit] - np.median(error[hit])))
    return 100 * hit.mean(), 100 * (1 - hit.mean()), 100 * (len(mine) - used) / len(true), sd_mm


def cpu_s() -> float:
    """Processor time of this process and of those that have ended, s."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--waveforms", type=int, default=1_000_000, help="waveforms for wavex")
    arguments.add_argument("--slow", type=int, default=5_000, help="waveforms for the others")
    options = arguments.parse_args()
    samples, owners, positions = simulate(options.waveforms, 1)
    model = wavex.calibrate_samples(samples[:20_000], interval_ns=1.0, full_scale_dn=FULL_SCALE_DN)
    ways = [
        ("wavex, `fastest`", options.waveforms, lambda some: by_wavex(some, model, "fastest")),
        ("wavex, `refined`", options.waveforms, lambda some: by_wavex(some, model, "refined")),
        ("SciPy: find_peaks, curve_fit", options.slow, by_scipy),
    ]
    try:
        import gdecomp  # noqa: F401

        ways.append(("gdecomp 1.0.6", options.slow, by_gdecomp))
    except ImportError as error:
        print(f"gdecomp is not measured: {error}\n")
    print("| method | waveforms per second and core | found, % | missed, % | false, % | SD of range, mm |")
    print("|---|---|---|---|---|---|")
    for name, count, way in ways:
        some, of_some = samples[:count], owners < count
        start = cpu_s()
        try:
            found = way(some)
        except RuntimeError as error:
            print(f"| {name} | {error} | | | | |")
            continue
        rate = count / (cpu_s() - start)
        figures = score(found, (owners[of_some], positions[of_some]), count)
        print(f"| {name} | {rate:,.0f} | " + " | ".join(f"{figure:.1f}" for figure in figures) + " |")


if __name__ == "__main__":
    main()
