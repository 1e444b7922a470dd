"""Checks that terrain is not mistaken for a delay of the receiver by amplitude (range walk).

Simulates flights of a receiver without a walk over surfaces whose height follows their reflectance:
towns (dark roofs, kerbs, bright grass), fields with furrows, meadows, leaves, hills. Every surface has
heights on a grid of a quarter of the shot distance, seen through a Gaussian footprint; echoes of a
footprint with a large spread of heights are not single. Shares no code with the program.

Usage: check_walk.py LEARN_RANGE_WALK [FLIGHTS], the example program of the crate wavex-signal.
Fails if the program believes a walk beyond three of its standard deviations in more than one of 200
flights, or if it never believes one that is there.
"""

import json
import math
import subprocess
import sys

import numpy as np

CELLS = 4  # per shot
SHOT_DISTANCE_M = 0.5
METRES_PER_NS = 0.15
LINES, SHOTS = 80, 250
SCENES = ["town", "fields", "meadow", "leaves", "hills"]


def materials(scene, rng):
    """(share of reflectance, spread of it, height m or None for roofs, roughness m, relation m)."""
    between = rng.uniform
    if scene == "town":
        return [
            (0.12, 0.08, 0.0, 0.003, 0.0),
            (0.30, 0.10, between(0.08, 0.15), 0.004, 0.0),
            (0.50, 0.15, between(0.02, 0.12), between(0.01, 0.03), between(-0.01, 0.02)),
            (0.15, 0.20, None, 0.01, 0.0),
            (0.30, 0.15, 0.01, 0.008, between(-0.005, 0.005)),
        ]
    if scene == "fields":
        return [
            (0.25, 0.15, 0.0, between(0.01, 0.04), between(-0.02, 0.02)),
            (0.50, 0.20, between(0.05, 0.3), between(0.02, 0.05), between(-0.03, 0.03)),
            (0.20, 0.10, -0.05, 0.005, 0.0),
        ]
    if scene == "meadow":
        return [
            (0.45, 0.20, between(0.02, 0.1), between(0.01, 0.03), between(-0.03, 0.03)),
            (0.50, 0.12, 0.0, between(0.005, 0.015), between(-0.01, 0.01)),
            (0.20, 0.10, -0.03, 0.004, 0.0),
        ]
    if scene == "leaves":
        return [
            (0.40, 0.25, 0.0, between(0.01, 0.03), between(-0.02, 0.03)),
            (0.35, 0.40, 0.3, 0.15, between(-0.1, 0.15)),
            (0.35, 0.50, None, 0.4, between(-0.3, 0.3)),
            (0.20, 0.10, 0.0, 0.005, 0.0),
        ]
    return [
        (0.50, 0.12, 0.0, between(0.005, 0.02), between(-0.01, 0.01)),
        (0.30, 0.20, between(0.0, 0.2), between(0.01, 0.05), 0.0),
    ]


def line(rng, scene, kinds, share, patch_cells, facets, gain_dn):
    """Times, ns, their SDs, amplitudes, DN, and whether the echo is single, of one scan line."""
    n = SHOTS * CELLS
    ends = np.cumsum(1 + rng.exponential(patch_cells, n).astype(int))
    patch = np.searchsorted(ends, np.arange(n), side="right")
    patches = patch[-1] + 1
    kind_of_patch = rng.choice(len(kinds), patches, p=share)
    if scene == "town":
        slope = np.full(n, rng.normal(0, 0.01))
    else:
        slope = rng.normal(0, 0.03) + np.cumsum(rng.normal(0, 0.002, n))
    ground_m = np.cumsum(slope) * SHOT_DISTANCE_M / CELLS
    if scene == "hills":
        phase = np.arange(n) / (CELLS * rng.uniform(8, 30)) + rng.uniform(0, 2 * math.pi)
        ground_m += rng.uniform(0.2, 1.5) * np.sin(phase)
    smooth = np.convolve(rng.normal(0, 1, n), np.ones(CELLS) / math.sqrt(CELLS), "same")
    texture = 0.5 * rng.normal(0, 1, n) + smooth
    reflectance, height_m = np.zeros(n), np.zeros(n)
    for k, (mean, spread, above_m, rough_m, relation_m) in enumerate(kinds):
        cells = kind_of_patch[patch] == k
        of_patch = np.exp(rng.normal(0, 0.12, patches))[patch[cells]]
        varied = texture[cells] * spread
        reflectance[cells] = mean * of_patch * np.exp(varied)
        if above_m is None:
            top_m = rng.uniform(2, 9, patches)[patch[cells]]
        else:
            top_m = above_m * np.exp(rng.normal(0, 0.3, patches))[patch[cells]]
        rough = 1.4 * rng.normal(0, 1, cells.sum()) + rng.normal(0, 1, cells.sum())
        height_m[cells] = top_m + 2 * relation_m * varied + rough_m * rough
    surface_m = ground_m + height_m
    tilt = np.gradient(np.convolve(surface_m, np.ones(2 * CELLS) / (2 * CELLS), "same"))
    tilt = np.clip(tilt * CELLS / SHOT_DISTANCE_M, -1, 1)
    reflectance = reflectance * np.clip(1 - 0.5 * facets * tilt, 0.1, 2)

    beam = np.exp(-0.5 * (np.arange(-2 * CELLS, 2 * CELLS + 1) / (0.35 * CELLS)) ** 2)
    beam /= beam.sum()
    energy = np.convolve(reflectance, beam, "same")
    mean_m = np.convolve(reflectance * surface_m, beam, "same") / energy
    variance_m2 = np.convolve(reflectance * surface_m**2, beam, "same") / energy - mean_m**2
    energy, mean_m, variance_m2 = (of[CELLS // 2 :: CELLS] for of in (energy, mean_m, variance_m2))
    amplitude_dn = gain_dn * energy * np.exp(rng.normal(0, 0.02, SHOTS)) + rng.normal(0, 1, SHOTS)
    sd_ns = 0.7 / np.maximum(amplitude_dn, 5) + 0.003
    flight_ns = 5000 - mean_m / METRES_PER_NS + sd_ns * rng.normal(0, 1, SHOTS)
    is_single = (variance_m2 < 0.04) & (amplitude_dn > 8) & (amplitude_dn < 235)
    return flight_ns, sd_ns, amplitude_dn, is_single


def imitation(seed):
    """Lines of a flight without a walk over terrain that imitates one."""
    rng = np.random.default_rng(seed)
    scene = SCENES[seed % len(SCENES)]
    kinds = materials(scene, rng)
    facets = rng.uniform(0, 1) if scene in ("fields", "hills", "leaves") else 0.2 * rng.uniform()
    gain_dn = rng.uniform(250, 400)
    share = rng.dirichlet(np.full(len(kinds), 2.0))
    patch_cells = rng.uniform(4, 15) * CELLS
    return [line(rng, scene, kinds, share, patch_cells, facets, gain_dn) for _ in range(LINES)]


def with_walk(seed):
    """Lines of a flight with a walk of 30 ps per unit of ln amplitude; heights follow nothing."""
    rng = np.random.default_rng(seed)
    lines = []
    for _ in range(LINES):
        amplitude_dn = np.clip(100 * np.exp(rng.normal(0, 0.35, SHOTS)), 15, 230)
        sd_ns = np.full(SHOTS, 0.015)
        flight_ns = 5000 + rng.normal(0, 0.06, SHOTS) - 0.03 * np.log(amplitude_dn / 100)
        lines.append((flight_ns, sd_ns, amplitude_dn, np.ones(SHOTS, bool)))
    return lines


def learn(program, flights):
    """What the program learns from flights: one dictionary each."""
    process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    results = []
    for lines in flights:
        text = []
        for number, columns in enumerate(lines):
            for shot, (flight_ns, sd_ns, amplitude_dn, is_single) in enumerate(zip(*columns)):
                if is_single:
                    text.append(f"{number * 2000 + shot} {flight_ns:.5f} {sd_ns:.5f} {amplitude_dn:.3f}\n")
        process.stdin.write("".join(text) + "end\n")
        process.stdin.flush()
        results.append(json.loads(process.stdout.readline()))
    process.stdin.close()
    assert process.wait() == 0
    return results


def largest_ratio(walk):
    """Largest delay where there is evidence, in standard deviations."""
    least_dn, most_dn = walk["amplitudes_dn"]
    nodes = [node for node in walk["nodes"] if least_dn <= node["amplitude_dn"] <= most_dn]
    return max((abs(n["late_ns"]) / n["late_sd_ns"] for n in nodes if n["late_sd_ns"] > 0), default=0.0)


def main():
    program = sys.argv[1]
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 20
    results = learn(program, (imitation(seed) for seed in range(count)))
    ratios = [largest_ratio(result["walk"]) if "walk" in result else 0.0 for result in results]
    seen = sum(ratio > 3 for ratio in ratios)
    believed = [seed for seed in range(count) if results[seed]["proven"] and ratios[seed] > 3]
    print(f"{count} flights without a walk: {seen} seem to have one, {len(believed)} are believed {believed}")
    assert len(believed) <= 1 + count // 200
    assert 2 * seen > count, "the terrain does not imitate a walk"
    true = learn(program, (with_walk(seed) for seed in range(max(8, count // 10))))
    proven = sum(result["proven"] for result in true)
    print(f"{len(true)} flights with a walk over terrain that follows nothing: {proven} proven")
    for result in true:
        if not result["proven"]:
            print("  " + result["reason"])
    assert proven > 0


if __name__ == "__main__":
    main()
