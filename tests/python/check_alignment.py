"""Aligns simulated surveys of make_alignment.py and compares the results with the truth.

    cargo build --release -p wavex-align --example align_points
    check_alignment.py target/release/examples/align_points [--flights 30] [--quick] [options of make_alignment.py]
    check_alignment.py PROGRAM --flights 50 --terrain flat --plan parallel --worse     # nothing may get worse

Prints errors and errors over stated SDs of each parameter, the drift before and after, and distances of points from
their true places before and after, which are computed here, not by wavex. Fails if the RMS of errors over SDs is outside
0.8 to 1.2, or (--worse) if points or strip differences get worse in any survey.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

import make_alignment
import numpy

NAMES = ["lever_forward_m", "lever_right_m", "lever_down_m", "boresight_roll_rad", "boresight_pitch_rad",
         "boresight_yaw_rad", "e0_m", "time_offset_s"]
PRINTED = {"_m": (1e3, "mm"), "_rad": (numpy.degrees(1) * 1e3, "mdeg"), "_s": (1e3, "ms")}


def rms(values):
    return float(numpy.sqrt(numpy.mean(numpy.square(values)))) if len(values) else float("nan")


def printed(name):
    return next(value for ending, value in PRINTED.items() if name.endswith(ending))


def values_of(calibration):
    return dict(zip(NAMES, [*calibration["lever_arm_m"], *numpy.radians(calibration["boresight_deg"]), calibration["e0"],
                            calibration.get("time_offset_s", 0)]))


def distances(folder, survey, truth, of_days, knots):
    """Distances of sample points from the truth, and their vectors' means by strip, m."""
    found = []
    for strip, true, own in zip(survey["strips"], truth["strips"], knots):
        installation = strip["installation"]
        mount = make_alignment.roll_pitch_yaw(numpy.radians(survey["installations"][installation]["mount_deg"]))
        values = of_days[installation]
        calibration = {
            "lever_arm_m": [values[name] for name in NAMES[:3]],
            "boresight_deg": numpy.degrees([values[name] for name in NAMES[3:6]]),
            "e0": values["e0_m"],
        }
        rows = numpy.fromfile(folder / strip["trajectory"]).reshape(-1, 7)
        t = numpy.array(true["sample_time_s"]) + values["time_offset_s"]
        latitude, longitude, height, *attitude = (numpy.interp(t, rows[:, 0], rows[:, k]) for k in range(1, 7))
        attitude = numpy.stack(attitude, -1)
        offsets = numpy.zeros((len(t), 6))
        if own:
            times = [knot["time_s"] for knot in own]
            at = numpy.array([knot["position_m"] + knot["attitude_rad"] for knot in own])
            offsets = numpy.stack([numpy.interp(t, times, at[:, k]) for k in range(6)], -1)
        origin, ned, ecef_from_body = make_alignment.frames((longitude, latitude, height), attitude + offsets[:, 3:])
        origin = origin + (ned @ offsets[:, :3, None])[..., 0]
        directions, raw = numpy.array(true["sample_directions"]), numpy.array(true["sample_raw_m"])
        points = make_alignment.locate(calibration, mount, origin, ecef_from_body, directions, raw)
        found.append(points - numpy.array(true["sample_ecef_m"]))
    return numpy.concatenate(found)


def fly(program, folder, options):
    """One survey: made, aligned, compared."""
    make_alignment.make(folder, options)
    done = subprocess.run([program, folder], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"FAILED: {done.stderr}")
    result = json.loads(done.stdout)
    survey, truth = (json.loads((folder / name).read_text()) for name in ("survey.json", "truth.json"))
    # Per parameter, one of each day.
    errors = {}
    starts, values = [], []
    for found, given, true in zip(result["parameters"], survey["installations"], truth["calibrations"]):
        true = values_of(true)
        starts.append(values_of(given["calibration"]))
        parameters = {p["name"]: p for p in found if p["prior_sd"] > 0}
        for name, p in parameters.items():
            errors.setdefault(name, []).append((p["value"] - true[name], p["sd"], p["treatment"]))
        values.append(starts[-1] | {name: p["value"] for name, p in parameters.items()})
    drift = []
    ratios = []
    for strip, of_truth in zip(result["strips"], truth["strips"]):
        if not strip["knots"]:
            continue
        times, offsets = numpy.array(of_truth["times_s"]), numpy.array(of_truth["corrections"])
        knots = strip["knots"]
        at = numpy.array([knot["position_m"] + knot["attitude_rad"] for knot in knots])
        found = numpy.stack([numpy.interp(times, [k["time_s"] for k in knots], at[:, j]) for j in range(6)], -1)
        left = found - offsets
        drift.append([[rms(o - o.mean()) for o in offsets.T], [rms(e - e.mean()) for e in left.T]])
        exact = numpy.stack([numpy.interp([k["time_s"] for k in knots], times, offsets[:, j]) for j in range(6)], -1)
        sds = numpy.array([knot["sds"] for knot in knots])
        ratios.append(((at - exact) / numpy.where(sds > 0, sds, numpy.nan)))
    before = distances(folder, survey, truth, starts, [None] * len(truth["strips"]))
    after = distances(folder, survey, truth, values, [strip["knots"] for strip in result["strips"]])
    spread = [rms(numpy.linalg.norm(d - d.mean(0), axis=1)) for d in (before, after)]
    return {
        "result": result, "errors": errors, "drift": numpy.array(drift), "ratios": numpy.concatenate(ratios) if ratios else numpy.zeros((0, 6)),
        "points": [rms(numpy.linalg.norm(d, axis=1)) for d in (before, after)], "spread": spread,
    }


def summary(flights):
    """Prints errors over stated SDs, drift and distances of points; returns all errors over SDs."""
    print(f"\n{'parameter':22} {'estimated':>9} {'combined':>8} {'RMS error':>12} {'mean':>8} {'mean SD':>9} {'errors/SD':>9} {'< 1 SD':>7} {'< 2 SD':>7}")
    every = []
    for name in flights[0]["errors"]:
        of_flights = [own for flight in flights for own in flight["errors"][name]]
        estimated = [(error, sd) for error, sd, treatment in of_flights if treatment != "NotEstimable"]
        combined = sum(treatment == "OnlyCombined" for *_, treatment in of_flights)
        factor, unit = printed(name)
        if not estimated:
            print(f"{name:22} {0:>9} {0:>8} {'left alone':>12}")
            continue
        errors, sds = numpy.array(estimated).T
        every.extend(errors / sds)
        z = abs(errors / sds)
        print(f"{name:22} {len(errors):>9} {combined:>8} {rms(errors) * factor:>7.3f} {unit:4} {numpy.mean(errors) * factor:>8.3f} {numpy.mean(sds) * factor:>9.3f} "
              f"{rms(z):>9.2f} {numpy.mean(z < 1):>7.0%} {numpy.mean(z < 2):>7.0%}")
    print(f"all parameters: errors/SD {rms(every):.2f} (RMS of {len(every)})")
    ratios = numpy.concatenate([flight["ratios"] for flight in flights])
    if len(ratios):
        print("knots: errors/SD " + ", ".join(f"{name} {rms(column[numpy.isfinite(column)]):.2f}" for name, column in
              zip(("north", "east", "down", "roll", "pitch", "heading"), ratios.T)))
        drift = numpy.concatenate([flight["drift"] for flight in flights])
        scales = [1e3] * 3 + [numpy.degrees(1) * 1e3] * 3
        print("drift about the mean of each strip, RMS before -> after: " + ", ".join(
            f"{name} {rms(drift[:, 0, k]) * scale:.2f} -> {rms(drift[:, 1, k]) * scale:.2f} {unit}" for k, (name, scale, unit) in
            enumerate(zip(("north", "east", "down", "roll", "pitch", "heading"), scales, ["mm"] * 3 + ["mdeg"] * 3))))
    print("points, distance from the truth, RMS of surveys: " + " -> ".join(f"{rms([f['points'][k] for f in flights]) * 1e3:.1f}" for k in (0, 1)) + " mm; "
          "about their mean: " + " -> ".join(f"{rms([f['spread'][k] for f in flights]) * 1e3:.1f}" for k in (0, 1)) + " mm")
    return every


def main():
    arguments = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    arguments.add_argument("program")
    arguments.add_argument("--flights", type=int, default=30)
    arguments.add_argument("--worse", action="store_true", help="fail if any survey gets worse")
    arguments.add_argument("--quick", action="store_true", help="one small survey")
    make_alignment.add_options(arguments)
    options = arguments.parse_args()
    if options.quick:
        options.flights, options.length, options.spacing, options.density, options.height = 1, 900, 250, 2, 450
        options.pairs = 800
    flights, failures = [], []
    for flight in range(options.flights):
        with tempfile.TemporaryDirectory() as folder:
            flown = argparse.Namespace(**(vars(options) | {"seed": options.seed + flight}))
            flights.append(fly(options.program, Path(folder), flown))
        own = flights[-1]
        result = own["result"]
        z = rms([error / sd for of_days in own["errors"].values() for error, sd, _ in of_days])
        print(f"flight {flown.seed}: {result['n_pairs']} pairs, scale {result['scale']:.2f}, errors/SD {z:.2f}, differences "
              f"{result['spread_m'][0] * 1e3:.1f} -> {result['spread_m'][1] * 1e3:.2f} mm, points {own['points'][0] * 1e3:.1f} -> "
              f"{own['points'][1] * 1e3:.1f} mm, {result['verdict']}, {result['seconds'][0]:.1f} + {result['seconds'][1]:.1f} s", flush=True)
        if options.worse and (own["points"][1] > 1.02 * own["points"][0] or result["spread_m"][1] > 1.02 * result["spread_m"][0]):
            failures.append(f"flight {flown.seed} got worse")
    every = summary(flights)
    least, most = (0.4, 1.8) if options.quick else (0.8, 1.2)
    if every and not least < rms(every) < most:
        failures.append(f"errors/SD {rms(every):.2f}")
    for failure in failures:
        print(f"FAILED: {failure}")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
