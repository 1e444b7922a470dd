"""Makes a GEDI01_B file of many shots by repeating and perturbing those of a small one.

    python make_granule.py SMALL.h5 OUT.h5 [--shots 1000000] [--seed 1]

For measurements of time and memory; the shots have no truth. Each beam gets the same number of shots. Amplitudes are
scaled by up to 10 %, noise of 0.5 DN is added, and shot numbers, times and latitudes go on from shot to shot. Needs h5py.
"""

import argparse
from pathlib import Path

import h5py
import numpy as np

# Samples of the received and of the outgoing waveform: data set, first sample (counted from 1) and number of samples.
WAVEFORMS = {"rxwaveform": ("rx_sample_start_index", "rx_sample_count"), "txwaveform": ("tx_sample_start_index", "tx_sample_count")}
# Shots that are written at once.
PART = 20_000
SHOT_INTERVAL_S = 1 / 242
# Part of an orbit.
LATITUDE_SPAN_DEG = 40


def beam(source, target, shots, random):
    """Writes a beam of so many shots."""
    known = source["shot_number"].shape[0]
    starts = {name for _, (name, _) in WAVEFORMS.items()}
    per_shot = []
    source.visititems(lambda name, item: per_shot.append(name) if isinstance(item, h5py.Dataset) and item.shape[:1] == (known,) and name not in starts else None)
    source.visititems(lambda name, item: target.create_dataset(name, data=item[()]) if isinstance(item, h5py.Dataset) and name not in per_shot and name not in starts and name not in WAVEFORMS else None)
    for name in per_shot:
        values = source[name][()]
        repeated = np.resize(values, (shots, *values.shape[1:]))
        if name == "shot_number":
            repeated = values[0] + np.arange(shots, dtype=values.dtype)
        if name == "delta_time":
            repeated = values[0] + SHOT_INTERVAL_S * np.arange(shots)
        if "latitude" in name and not name.endswith("error"):
            repeated = repeated + LATITUDE_SPAN_DEG / shots * np.arange(shots)
        target.create_dataset(name, data=repeated, chunks=(min(shots, 4096), *values.shape[1:]), compression="gzip", compression_opts=1)
    for name, (start_name, count_name) in WAVEFORMS.items():
        samples, start, count = source[name][()], source[start_name][()].astype(int) - 1, source[count_name][()].astype(int)
        counts = np.resize(count, shots)
        target[start_name] = (np.concatenate([[0], np.cumsum(counts)[:-1]]) + 1).astype("uint64")
        into = target.create_dataset(name, (int(counts.sum()),), "float32", chunks=(14_200,), compression="gzip", compression_opts=1)
        level, written = np.median(samples), 0
        originals = [samples[a : a + n] for a, n in zip(start, count)]
        for first in range(0, shots, PART):
            wanted = [originals[shot % known] for shot in range(first, min(first + PART, shots))]
            lengths = [len(one) for one in wanted]
            scales = np.repeat(random.uniform(0.9, 1.1, len(wanted)), lengths)
            part = level + scales * (np.concatenate(wanted) - level) + random.normal(0, 0.5, sum(lengths))
            into[written : written + len(part)] = part.astype("float32")
            written += len(part)


def main():
    """Makes the file."""
    parser = argparse.ArgumentParser()
    parser.add_argument("small", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--shots", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    chosen = parser.parse_args()
    random = np.random.default_rng(chosen.seed)
    with h5py.File(chosen.small) as source, h5py.File(chosen.out, "w") as target:
        beams = [name for name in source if name.startswith("BEAM")]
        for name in beams:
            beam(source[name], target.create_group(name), chosen.shots // len(beams), random)


if __name__ == "__main__":
    main()
