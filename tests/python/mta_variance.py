"""Compares the methods of `resolve_mta` with a NumPy version of the variance method, on simulated flights.

Simulates a circular scanner, a rotating polygon and an oscillating mirror at 550 kHz over forest, relief and
houses, and prints the share of received blocks that each method assigns to the shot that caused them. `variance`
below shares no code with the program. As there, up to four peaks of a block have ranges, and a block goes to the shot
with the highest peaks.

Usage: mta_variance.py WAVEX. Fails if the program's variance method is more than five percentage points below NumPy's,
or if `blocks` assigns less than 99.9 % correctly.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

FLIGHT = """landscape = 'country'\npulse_rate_hz = 550000\nmodulation_ns = 15\nflying_height_m = 800\nrelief_m = 120
water_ratio = 0.02\nfalse_alarm_rate = 0.002\nblind_gap_ns = 15\nroll_deg = 6\npitch_deg = 3\nyaw_deg = 3
motion_period_s = 4\nas_recorded = true\nseed = 3\nscan_angle_deg = [-20, 20]\nlines = 48\nshots_per_line = 700
"""
SCANNERS = {
    "circular": "scanner = 'circular'\nrotation_hz = 366.667\n",
    "rotating polygon": "scanner = 'rotating_polygon'\n",
    "oscillating mirror": "scanner = 'oscillating'\n",
}
M_PER_NS = 0.5 * 0.29971054
# A buffer with overlap is overwritten if the zone alone has less than this part of its sum.
FAULTY = 0.5


def variance(ranges, possible, length):
    """The zone of each range, from those in all zones (zones, ranges), in the order of the scan."""
    zones, count = ranges.shape
    own = np.arange(zones)
    beside = np.clip(own + np.array([[-1], [0], [1]]), 0, zones - 1)
    # Squared differences with the overlap of one zone, and of each zone alone.
    buffers = np.zeros((2, zones, length))
    last = np.tile(ranges[:, 0], (2, 1))
    chosen = np.zeros((zones, count), int)
    found = np.zeros(count, int)
    for turn in range(count + length // 2):
        if turn < count:
            new = ranges[:, turn]
            chosen[:, turn] = beside[np.abs(new[beside] - last[0]).argmin(0), own]
            now = np.stack([new[chosen[:, turn]], new])
            buffers[:, :, turn % length] = (now - last) ** 2
            sums = buffers.sum(2)
            faulty = sums[1] < FAULTY * sums[0]
            now[0, faulty], buffers[0, faulty], sums[0, faulty] = new[faulty], buffers[1, faulty], sums[1, faulty]
            last = now
        middle = turn - length // 2
        if middle >= 0:
            zone = chosen[:, middle]
            found[middle] = zone[np.where(possible[zone, middle], sums[0], np.inf).argmin()]
    return found


def blocks_of(path):
    """Clocks, shots and lines of a container; shot index, channel, start and samples of its blocks."""
    table = pa.ipc.open_file(path).read_all()
    blocks = table["blocks"].combine_chunks()
    of_shot = np.repeat(np.arange(len(table)), np.diff(blocks.offsets.to_numpy()))
    channel, start, samples = (blocks.values.field(name) for name in ("channel", "start_ns", "samples"))
    start_ns = table["clock_ps"].to_numpy()[of_shot] * 1e-3 + start.to_numpy()
    shots = {name: table[name].to_numpy() for name in ("clock_ps", "shot", "line")}
    waves = np.split(samples.values.to_numpy().astype(float), samples.offsets.to_numpy()[1:-1])
    return shots, of_shot, channel.to_numpy(), start_ns, waves


def peaks(wave):
    """Index (centroid of five samples) and height of up to four peaks."""
    signal = wave - np.median(wave)
    inner = signal[1:-1]
    tops = 1 + np.flatnonzero((inner > signal[:-2]) & (inner >= signal[2:]) & (inner >= max(3, 0.3 * signal.max())))
    tops = tops[signal[tops].argsort()[-4:]] if len(tops) else [signal.argmax()]
    parts = [(np.arange(len(wave))[max(top - 2, 0) : top + 3], signal[max(top - 2, 0) : top + 3]) for top in tops]
    return [(np.average(at, weights=part.clip(1e-9)), part.max()) for at, part in parts]


def read(folder):
    """Emission times and shots; time, height and block of each echo; start, line and true shot of each block."""
    shots, of_shot, channel, start_ns, waves = blocks_of(folder / "recording.arrow")
    left_ns = shots["clock_ps"] * 1e-3
    for block in np.flatnonzero(channel == 3):
        left_ns[of_shot[block]] = start_ns[block] + max(peaks(waves[block]), key=lambda peak: peak[1])[0]
    low = np.flatnonzero(channel == 1)
    low = low[start_ns[low].argsort(kind="stable")]
    found = [(start_ns[i] + at, height, block) for block, i in enumerate(low) for at, height in peaks(waves[i])]
    at_ns, height, block = np.array(sorted(found)).T
    start_ns, end_ns = start_ns[low] - 1, start_ns[low] + [len(waves[i]) + 1 for i in low]
    truth = pa.csv.read_csv(folder / "truth.csv")
    truth = {name: truth[name].to_numpy() for name in truth.column_names}
    clock_ns = shots["clock_ps"][np.searchsorted(shots["shot"], truth["shot"])] * 1e-3
    received_ns = clock_ns + truth["emission_ns"] + truth["time_of_flight_ns"]
    order = np.flatnonzero(truth["class"] != "false_alarm")
    order = order[received_ns[order].argsort()]
    first, end = np.searchsorted(received_ns[order], start_ns), np.searchsorted(received_ns[order], end_ns)
    cause = np.full(len(low), -1)
    for i in np.flatnonzero(end > first):
        inside = order[first[i] : end[i]]
        cause[i] = truth["shot"][inside[truth["amplitude_dn"][inside].argmax()]]
    echoes = at_ns, height, block.astype(int)
    return (left_ns, shots["shot"]), echoes, (start_ns + 1, shots["line"][of_shot[low]], cause)


def by_numpy(recording, range_m, length, is_flipped):
    """The shot of each block by the variance method."""
    (left_ns, shot), (at_ns, height, block), (_, line, cause) = recording
    line = line[block] if is_flipped else 0 * block
    interval_ns = np.median(np.diff(left_ns))
    zones = int(np.ceil(range_m[1] / (interval_ns * M_PER_NS))) + 1
    # Before the first emission and within pauses, emissions at even intervals are assumed: shot -1.
    gaps = np.diff(left_ns, prepend=left_ns[0] - (zones + 1) * interval_ns)
    missing = np.round(gaps / interval_ns).astype(int) - 1
    back = np.concatenate([np.arange(n, 0, -1) for n in missing])
    left_ns = np.concatenate([left_ns, np.repeat(left_ns, missing) - back * interval_ns])
    shot = np.concatenate([shot.astype(int), np.full(len(back), -1)])[left_ns.argsort()]
    left_ns = np.sort(left_ns)
    order = np.lexsort((np.where(line % 2 == 1, -at_ns, at_ns), line))
    emission = np.searchsorted(left_ns, at_ns[order]) - 1 - np.arange(zones)[:, None]
    ranges = (at_ns[order] - left_ns[emission]) * M_PER_NS
    possible = (shot[emission] >= 0) & (ranges >= range_m[0]) & (ranges <= range_m[1])
    zone = variance(ranges, possible, length)
    votes = np.stack([block[order], shot[emission[zone, np.arange(len(zone))]]])
    votes, which = np.unique(votes, axis=1, return_inverse=True)
    heights = np.bincount(which.ravel(), height[order])
    # The last entry of a block is that with the greatest height.
    votes = votes[:, heights.argsort(kind="stable")]
    found = np.zeros(len(cause), int)
    found[votes[0]] = votes[1]
    return found


def run(wavex, folder, stages):
    """Runs a job in a folder."""
    job = folder / "job.toml"
    job.write_text("".join(f"[[stage]]\ntype = '{stage}'\n{keys}\n" for stage, keys in stages))
    subprocess.run([wavex, "run", job], check=True, capture_output=True)


def by_wavex(wavex, folder, recording, keys):
    """The shot of each block by `resolve_mta`."""
    read_from, write_to = "path = 'recording.arrow'", "path = 'resolved.arrow'"
    run(wavex, folder, [("read_arrow", read_from), ("resolve_mta", keys), ("write_arrow", write_to)])
    shots, of_shot, channel, start_ns, _ = blocks_of(folder / "resolved.arrow")
    low = np.flatnonzero(channel == 1)
    low = low[start_ns[low].argsort()]
    recorded_ns = recording[2][0]
    at = np.searchsorted(start_ns[low], recorded_ns - 0.5).clip(max=len(low) - 1)
    is_same = np.abs(start_ns[low][at] - recorded_ns) < 0.6
    return np.where(is_same, shots["shot"][of_shot[low]][at].astype(int), -2)


def main():
    """Prints the table."""
    failed = False
    print("| scanner | `range_m` | buffer | NumPy, % right | `variance`, % right | `blocks`, % right |\n|---|---|---|---|---|---|")
    for scanner, keys in SCANNERS.items():
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            write = "path = 'recording.arrow'\ncompression = 'none'"
            run(sys.argv[1], folder, [("simulate", f"truth = 'truth.csv'\n{FLIGHT}{keys}"), ("write_arrow", write)])
            recording = read(folder)

            def right(found):
                cause = recording[2][2]
                return 100 * np.mean((found == cause)[cause >= 0])

            for range_m in ([30, 1600], [30, 5000]):
                limits = f"range_m = {range_m}\n"
                blocks = right(by_wavex(sys.argv[1], folder, recording, limits))
                for length in (50, 200, 1000):
                    keys = f"{limits}method = 'variance'\nbuffer = {length}"
                    ours = right(by_wavex(sys.argv[1], folder, recording, keys))
                    reference = right(by_numpy(recording, range_m, length, scanner == "rotating polygon"))
                    failed |= ours < reference - 5 or blocks < 99.9
                    print(f"| {scanner} | {range_m} | {length} | {reference:.1f} | {ours:.1f} | {blocks:.2f} |", flush=True)
    sys.exit(failed)


if __name__ == "__main__":
    main()
