"""Checks simulated footprints against their truth, and their layout against a recorded file when `WAVEX_DATA` is set."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import h5py
import numpy as np

from checks import Checks
from make_footprints import BEAM_SD_M, DETECTION_SD, ECHO_WIDTH, FALSE_ALARM_SD, gaussian_centre


def generate(folder, name, *options):
    """Opens the file and the truth of a run of the generator."""
    path = Path(folder) / f"{name}.h5"
    script = Path(__file__).with_name("make_footprints.py")
    subprocess.run([sys.executable, script, "--out", path, *options], check=True)
    with np.load(path.with_name(f"{name}_truth.npz")) as file:
        return h5py.File(path), dict(file)


def waveforms(file):
    """Received and outgoing samples of all shots, and elevations of their first and last samples."""
    rx, tx, elevations = [], [], []
    for name in sorted(name for name in file if name.startswith("BEAM")):
        beam = file[name]
        for samples, part in ((rx, "rx"), (tx, "tx")):
            starts, counts = beam[f"{part}_sample_start_index"][()].astype(int) - 1, beam[f"{part}_sample_count"][()]
            data = beam[f"{part}waveform"][()].astype(float)
            samples += [data[start : start + count] for start, count in zip(starts, counts)]
        places = beam["geolocation"]
        elevations.append(np.stack([places["elevation_bin0"][()], places["elevation_lastbin"][()]]))
    return rx, tx, np.concatenate(elevations, axis=1)


def layout(group):
    """Type and number of dimensions of the data sets of a group."""
    found = {}
    group.visititems(
        lambda name, item: found.update({name: (item.dtype.str, item.ndim)} if isinstance(item, h5py.Dataset) else {})
    )
    return found


def check_samples(checks, folder):
    """Flat bare ground: position, elevation, energy, noise and sensitivity."""
    file, truth = generate(folder, "bare", "--shots", "200", "--kind", "bare", "--slope-max", "0", "--seed", "5")
    rx, tx, (first, last) = waveforms(file)
    checks.equal("number of waveforms", len(rx), 200)
    checks.equal("samples of a shot", [row.size for row in rx], truth["count"].tolist())
    numbers = np.concatenate([file[name]["shot_number"][()] for name in sorted(np.unique(truth["beam"]))])
    checks.equal("shot numbers", numbers.tolist(), truth["shot_number"].tolist())
    share = truth["ground_sample"] / (truth["count"] - 1)
    checks.within("elevation of the ground", first + share * (last - first), truth["ground_m"], 1e-6)
    signal = [row - mean for row, mean in zip(rx, truth["noise_mean_dn"])]
    outgoing = [row - mean for row, mean in zip(tx, truth["noise_mean_dn"])]
    checks.within("reference of the outgoing pulse", [gaussian_centre(row)[0] for row in outgoing], truth["tx_gloc"], 0.08)
    # Off nadir a flat ground is spread: the centre moves into the tail of the pulse.
    found = np.array([gaussian_centre(row)[0] for row in signal]) - truth["ground_sample"]
    spread = (BEAM_SD_M * np.tan(np.radians(truth["off_nadir_deg"])) + truth["roughness_m"]) / 0.1498
    checks.within("echo of steep beams, samples", found[spread < 2], 0.0 * found[spread < 2], 0.25)
    checks.within("energy", [row.sum() for row in signal] / truth["energy_dn"], np.ones(200), 0.1)
    noise = np.array([row[-90:] for row in signal]) / truth["noise_sd_dn"][:, None]
    lags = [np.mean(noise[:, : 90 - lag] * noise[:, lag:]) for lag in range(6)]
    checks.within("autocorrelation of noise", lags, [1.0, 0.92, 0.73, 0.48, 0.25, 0.09], 0.05)
    needed = (FALSE_ALARM_SD + DETECTION_SD) * 1.76 * truth["noise_sd_dn"] * ECHO_WIDTH
    checks.within("sensitivity", truth["sensitivity"], 1 - needed / truth["energy_dn"], 1e-9)
    checks.within("relative heights of flat ground", truth["rh"][spread < 2][:, [0, 100]], np.zeros((np.sum(spread < 2), 2)), 1.2)


def check_canopies(checks, folder):
    """Truth of canopies against the energy of their waveforms."""
    for kind in ("gaussians", "crowns"):
        file, truth = generate(folder, kind, "--shots", "80", "--kind", kind, "--seed", "6")
        rx, _, _ = waveforms(file)
        with checks.of(kind):
            share = (1 - truth["cover"]) / (1 - truth["cover"] + truth["cover"] * truth["reflectance_ratio"])
            checks.within("share of the ground", truth["ground_share"], share, 1e-6)
            checks.that("heights ascend", np.all(np.diff(truth["rh"], axis=1) >= 0))
            step = 0.1498 * np.cos(np.radians(truth["off_nadir_deg"]))
            median = []
            for row, mean, ground, size in zip(rx, truth["noise_mean_dn"], truth["ground_sample"], step):
                below = np.cumsum((row - mean)[::-1])
                median.append((ground - (row.size - 1.5 - np.interp(0.5 * below[-1], below, np.arange(row.size)))) * size)
            # Noise moves the median of a weak waveform by metres.
            off = np.median(np.abs(median - truth["rh_waveform"][:, 50]))
            checks.that("median of the waveform", off < 0.15, f"off by {off} m")
            # The mean of the pulse lies 2 to 3 samples after its reference.
            lower = np.median(truth["rh"][:, 50] - truth["rh_waveform"][:, 50])
            checks.that("the pulse lowers the median of the surfaces", 0.1 < lower < 0.6, f"by {lower} m")


def check_layout(checks, folder):
    """The same data sets and types as a recorded file, and the same bytes from the same seed."""
    runs = [generate(folder, name, "--shots", "20", "--seed", "9", "--beams", "BEAM0101") for name in ("one", "two")]
    same = [np.array_equal(runs[0][0]["BEAM0101"][name], runs[1][0]["BEAM0101"][name]) for name in ("rxwaveform", "txwaveform")]
    checks.equal("samples of one seed", same, [True, True])
    data = os.environ.get("WAVEX_DATA")
    if data is None:
        print("skipped: WAVEX_DATA not set")
        return
    with h5py.File(Path(data) / "gedi" / "gedi_l1b.h5") as recorded:
        checks.equal("data sets of a beam", layout(runs[0][0]["BEAM0101"]), layout(recorded["BEAM0101"]))


def main():
    checks = Checks()
    with tempfile.TemporaryDirectory() as folder:
        for name, check in (("samples", check_samples), ("canopies", check_canopies), ("layout", check_layout)):
            with checks.of(name):
                check(checks, folder)
    return checks.end()


if __name__ == "__main__":
    sys.exit(main())
