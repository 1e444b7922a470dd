"""Compares ground, relative heights and cover with the truth of simulated footprints.

    python make_footprints.py --shots 10000 --seed 1 --out footprints.h5
    python check_footprints.py results.parquet footprints_truth.npz
    python check_footprints.py --self-test

Results are CSV, Parquet or Arrow. A shot without result, or with a null ground, is not found. A ground is right
when its error is less than 1 m or less than three of its stated SDs. Probabilities are of being right.
The exit code is 1 when a goal is missed, and when a column is not there.
"""

import argparse
import sys

import numpy as np

# Columns of the results. Relative heights are one list column, or `rh_0` to `rh_100`.
SHOT, GROUND, GROUND_SD, PROBABILITY, COVER = "shot_number", "z", "ground_sd_m", "ground_probability", "cover"
RH_LIST, RH_COLUMN = "rh_m", "rh{}_m"

# Name: lowest and highest value that reaches the goal, and the fewest shots for a verdict. None: information only.
CLASSES = ("bare", "0-30 %", "30-60 %", "60-80 %", "80-90 %", "90-95 %", "95-99 %")
PROBABILITIES = {0.5: (0.45, 0.55, 0.05), 0.7: (0.65, 0.75, 0.05), 0.9: (0.88, 0.92, 0.02)}  # bounds, tolerance
GOALS = {
    "shots with a result": (0.999, 1.0, 1),
    "ground found, cover below sensitivity": (0.95, 1.0, 30),
    "ground found, cover below sensitivity on slopes": (None, None, 30),
    "ground found, slope < 10, cover below sensitivity": (None, None, 30),
    "ground error, slope < 10: mean, m": (-0.05, 0.05, 30),
    "ground error, slope < 10: median, m": (-0.05, 0.05, 30),
    "ground error, slope < 10: robust SD, m": (None, None, 30),
    "ground error, slope >= 10: robust SD, m": (None, None, 30),
    **{f"ground z-score, cover {name}: robust SD": (0.9, 1.1, 30) for name in CLASSES},
    **{f"ground z-score, cover {name}: share beyond 3": (None, None, 30) for name in CLASSES},
    **{f"probability near {p}: share right - stated": (-b[2], b[2], 30) for p, b in PROBABILITIES.items()},
    "probability, tenths of shots: mean of |share right - stated|": (0.0, 0.03, 200),
    **{f"RH{k} error, slope < 10: median, m": (-0.1, 0.1, 30) for k in (50, 75, 98)},
    **{f"RH{k} error, slope < 10: robust SD, m": (0.0, 0.3, 30) for k in (50, 75, 98)},
    **{f"RH{k} error, slope >= 10: robust SD, m": (None, None, 30) for k in (25, 50, 75, 98)},
    "cover error, slope < 10: RMS": (0.0, 0.03, 30),
    "cover error, slope >= 10: RMS": (None, None, 30),
}


def read_results(path):
    """Columns of a table by name; relative heights under `rh`, (shots, 101)."""
    import pyarrow as pa
    from pyarrow import csv, feather, parquet

    ending = str(path).rsplit(".", 1)[-1]
    readers = {"csv": csv.read_csv, "parquet": parquet.read_table, "arrow": feather.read_table}
    if ending not in readers:
        sys.exit(f"{path}: neither csv, parquet nor arrow")
    table = readers[ending](path)
    result = {}
    for name in (SHOT, GROUND, GROUND_SD, PROBABILITY, COVER):
        if name in table.column_names:
            kind = pa.uint64() if name == SHOT else pa.float64()
            result[name] = table[name].cast(kind).to_numpy()
    if RH_LIST in table.column_names:
        rows = [[np.nan] * 101 if row is None else row for row in table[RH_LIST].to_pylist()]
        result[RH_LIST] = np.array(rows, dtype=np.float64)
    elif RH_COLUMN.format(0) in table.column_names:
        result[RH_LIST] = np.stack([table[RH_COLUMN.format(k)].cast(pa.float64()).to_numpy() for k in range(101)], 1)
    for name in (SHOT, GROUND, GROUND_SD):
        if name not in result:
            sys.exit(f"{path}: no column {name}")
    if np.unique(result[SHOT]).size != result[SHOT].size:
        sys.exit(f"{path}: shots appear twice in {SHOT}")
    return result


def in_order(result, shot_number):
    """Rows of the results in the order of the truth, NaN where a shot has none, and whether it has one."""
    order = np.argsort(result[SHOT])
    at = np.minimum(np.searchsorted(result[SHOT], shot_number, sorter=order), order.size - 1)
    has = result[SHOT][order[at]] == shot_number
    ordered = {}
    for name, values in result.items():
        if name != SHOT:
            ordered[name] = np.where(has if values.ndim == 1 else has[:, None], values[order[at]], np.nan)
    return ordered, has


def robust_sd(values):
    return 1.4826 * np.median(np.abs(values - np.median(values)))


def measure(result, truth, rh_name="rh", reflectance_ratio=1.0):
    """Value, standard error and number of shots per name of GOALS; None where a column is not there."""
    found = {}

    def add(name, values, statistic, error):
        """`error` is that of one value; the error of the statistic falls with the root of the number."""
        values = values[np.isfinite(values)]
        count = values.size
        found[name] = (statistic(values), error(values) / np.sqrt(count), count) if count else (np.nan, np.nan, 0)

    share_error = lambda values: np.sqrt(max(values.mean() * (1 - values.mean()), 1e-9))
    sd_error = lambda values: 1.17 * robust_sd(values)  # of a robust SD of normal values, times root n
    result, has = in_order(result, truth["shot_number"])
    error = result[GROUND] - truth["ground_m"]
    sd = result[GROUND_SD]
    stated = np.isfinite(error) & np.isfinite(sd)
    right = np.where(stated, np.abs(error) < np.maximum(1.0, 3 * np.nan_to_num(sd)), False)
    gentle = truth["slope_deg"] < 10
    visible = truth["cover"] < truth["sensitivity"]
    add("shots with a result", has * 1.0, np.mean, share_error)
    below = "ground found, cover below sensitivity"
    add(below, right[visible] * 1.0, np.mean, share_error)
    add(below + " on slopes", right[truth["cover"] < truth["sensitivity_slope"]] * 1.0, np.mean, share_error)
    add("ground found, slope < 10, cover below sensitivity", right[visible & gentle] * 1.0, np.mean, share_error)
    for slope, chosen in (("slope < 10", right & gentle), ("slope >= 10", right & ~gentle)):
        if slope == "slope < 10":
            add(f"ground error, {slope}: mean, m", error[chosen], np.mean, np.std)
            add(f"ground error, {slope}: median, m", error[chosen], np.median, lambda e: 1.25 * robust_sd(e))
        add(f"ground error, {slope}: robust SD, m", error[chosen], robust_sd, sd_error)
    z = np.where(stated & (sd > 0), error / np.where(sd > 0, sd, 1.0), np.where(stated, np.inf, np.nan))
    z = np.clip(z, -1e6, 1e6)
    for number, name in enumerate(CLASSES):
        own = truth["cover_class"] == number
        add(f"ground z-score, cover {name}: robust SD", z[own], robust_sd, sd_error)
        beyond = np.where(np.isnan(z), np.nan, np.abs(z) > 3)
        add(f"ground z-score, cover {name}: share beyond 3", beyond[own], np.mean, share_error)
    if PROBABILITY in result:
        probability = np.where(stated, result[PROBABILITY], np.nan)
        miss = right - probability
        for centre, (low, high, _) in PROBABILITIES.items():
            own = (probability >= low) & (probability <= high)
            add(f"probability near {centre}: share right - stated", miss[own], np.mean, np.std)
        order = np.argsort(np.where(np.isnan(probability), np.inf, probability))[: np.isfinite(probability).sum()]
        tenths = [np.abs(miss[part].mean()) for part in np.array_split(order, 10) if part.size]
        value = np.mean(tenths) if tenths else np.nan
        found["probability, tenths of shots: mean of |share right - stated|"] = (value, np.nan, order.size)
    if RH_LIST in result:
        for k in (25, 50, 75, 98):
            off = result[RH_LIST][:, k] - truth[rh_name][:, k]
            if k > 25:
                add(f"RH{k} error, slope < 10: median, m", off[right & gentle & visible], np.median,
                    lambda e: 1.25 * robust_sd(e))  # fmt: skip
                add(f"RH{k} error, slope < 10: robust SD, m", off[right & gentle & visible], robust_sd, sd_error)
            add(f"RH{k} error, slope >= 10: robust SD, m", off[right & ~gentle & visible], robust_sd, sd_error)
    if COVER in result:
        canopy = 1 - truth["ground_share"]
        off = result[COVER] - canopy / (canopy + reflectance_ratio * truth["ground_share"])
        rms = lambda values: np.sqrt(np.mean(values**2))
        for slope, chosen in (("slope < 10", gentle), ("slope >= 10", ~gentle)):
            add(f"cover error, {slope}: RMS", off[right & chosen & visible], rms, lambda e: 0.71 * rms(e))
    return found


def verdicts(found):
    """`ok`, `MISSED`, `too few`, `no column` or `-` (no goal) per name of GOALS."""
    result = {}
    for name, (low, high, fewest) in GOALS.items():
        if low is None:
            result[name] = "-"
        elif name not in found:
            result[name] = "no column"
        elif found[name][2] < fewest:
            result[name] = "too few"
        else:
            result[name] = "ok" if low <= found[name][0] <= high else "MISSED"
    return result


def is_missed(name, verdict):
    """Too few shots miss a goal, except near a probability: the tenths hold all of them."""
    return verdict in ("MISSED", "no column") or (verdict == "too few" and not name.startswith("probability near"))


def report(found):
    """Prints the table; returns the number of goals missed."""
    width = max(map(len, GOALS))
    print(f"{'':{width}}  {'goal':>16}  {'reached':>8}  {'SE':>7}  {'shots':>6}")
    verdict = verdicts(found)
    for name, (low, high, _) in GOALS.items():
        value, error, count = found.get(name, (np.nan, np.nan, 0))
        goal = "" if low is None else f"{low:g} to {high:g}"
        print(f"{name:{width}}  {goal:>16}  {value:8.3f}  {error:7.3f}  {count:6d}  {verdict[name]}")
    missed = sum(is_missed(name, word) for name, word in verdict.items())
    print(f"{missed} goals missed" if missed != 1 else "1 goal missed")
    return missed


def ideal(random, shots):
    """A truth and results that reach every goal."""
    cover = np.where(random.random(shots) < 0.15, 0.0, 0.99 * random.random(shots) ** 0.5)
    truth = {
        "shot_number": np.arange(shots, dtype=np.uint64) + np.uint64(10**17), "cover": cover,
        "ground_m": random.uniform(0, 900, shots), "slope_deg": 40 * random.random(shots) ** 2,
        "sensitivity": random.uniform(0.90, 0.99, shots), "sensitivity_slope": random.uniform(0.8, 0.99, shots),
        "cover_class": np.where(cover == 0, 0, np.searchsorted([0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 1.0], cover)),
        "ground_share": 1 - cover, "rh": np.sort(random.uniform(0, 30, (shots, 101)), axis=1),
    }  # fmt: skip
    sd = random.uniform(0.02, 0.2, shots)
    probability = np.where(random.random(shots) < 0.1, random.uniform(0.4, 0.95, shots), 0.995)
    wrong = random.random(shots) > probability
    result = {
        SHOT: truth["shot_number"].copy(), GROUND_SD: sd, PROBABILITY: probability,
        GROUND: truth["ground_m"] + sd * random.normal(size=shots) + 8.0 * wrong, COVER: cover.copy(),
        RH_LIST: truth["rh"] + 0.1 * random.normal(size=(shots, 101)),
    }  # fmt: skip
    return truth, result


def spoil(name, truth, result, random):
    """Changes results so that the goal of this name is missed."""
    gentle, shots = truth["slope_deg"] < 10, truth["cover"].size
    if name == "shots with a result":
        for key in result:
            result[key] = result[key][: shots * 99 // 100]
    elif name.startswith("ground found"):
        result[GROUND][random.random(shots) < 0.05] = np.nan
    elif name.startswith("ground error") and "mean" in name:
        # A fifth of the shots lies 0.5 m off: the mean moves, the median hardly.
        result[GROUND][gentle & (random.random(shots) < 0.2)] += 0.5
    elif name.startswith("ground error"):
        result[GROUND][gentle] += 0.08
    elif name.startswith("ground z-score"):
        own = truth["cover_class"] == CLASSES.index(name.split("cover ")[1].split(":")[0])
        result[GROUND_SD][own] *= random.choice([0.7, 1.4])
    elif name.startswith("probability near"):
        low, high, tolerance = PROBABILITIES[float(name.split()[2].rstrip(":"))]
        own = (result[PROBABILITY] >= low) & (result[PROBABILITY] <= high)
        result[GROUND][own & (random.random(shots) < 8 * tolerance)] += 40.0
    elif name.startswith("probability"):
        result[PROBABILITY] -= 0.05
    elif name.startswith("RH"):
        k = int(name[2:4])
        result[RH_LIST][:, k] += 0.2 if "median" in name else random.normal(size=shots)
    elif name.startswith("cover"):
        result[COVER] += 0.05 * random.normal(size=shots)


def forms_of_tables(random):
    """Failures of reading the same results as CSV and Parquet, and of refusing wrong tables."""
    import tempfile

    import pyarrow as pa
    from pyarrow import csv, parquet

    truth, result = ideal(random, 50)
    columns = {name: values for name, values in result.items() if name != RH_LIST}
    flat = columns | {RH_COLUMN.format(k): result[RH_LIST][:, k] for k in range(101)}
    twice = {name: np.concatenate([values, values]) for name, values in columns.items()}
    without = {name: values for name, values in columns.items() if name != GROUND_SD}
    failures = []
    with tempfile.TemporaryDirectory() as folder:
        csv.write_csv(pa.table(flat), f"{folder}/flat.csv")
        parquet.write_table(pa.table(columns | {RH_LIST: list(result[RH_LIST])}), f"{folder}/list.parquet")
        for name in ("flat.csv", "list.parquet"):
            got = read_results(f"{folder}/{name}")
            failures += [f"{name}: {key}" for key in result if not np.array_equal(got.get(key), result[key])]
        for name, table in (("twice.csv", twice), ("without.csv", without), ("unknown.txt", columns)):
            csv.write_csv(pa.table(table), f"{folder}/{name}")
            try:
                read_results(f"{folder}/{name}")
                failures.append(f"{name} is accepted")
            except SystemExit:
                pass
    return failures


def self_test():
    """Every goal is reached by ideal results, and missed by results spoiled for it and without its column."""
    random = np.random.default_rng(1)
    failures = forms_of_tables(random)
    with_goal = [name for name, goal in GOALS.items() if goal[0] is not None]
    truth, result = ideal(random, 40_000)
    words = verdicts(measure(result, truth))
    failures += [f"ideal results: {name}: {word}" for name, word in words.items() if word not in ("ok", "-")]
    for name in with_goal:
        truth, result = ideal(random, 40_000)
        spoil(name, truth, result, random)
        word = verdicts(measure(result, truth))[name]
        print(f"{name}: {word}")
        failures += [] if word == "MISSED" else [f"spoiled results: {name}: {word}"]
    truth, result = ideal(random, 5_000)
    for column, part in ((PROBABILITY, "probability"), (RH_LIST, "RH"), (COVER, "cover error")):
        fewer = {key: values for key, values in result.items() if key != column}
        words = verdicts(measure(fewer, truth))
        failures += [f"without {column}: {name}: {words[name]}" for name in with_goal
                     if name.startswith(part) and words[name] != "no column"]  # fmt: skip
    truth, result = ideal(random, 20)
    name = "cover error, slope < 10: RMS"
    failures += [] if is_missed(name, verdicts(measure(result, truth))[name]) else ["20 shots are enough"]
    print("\n".join(failures) or f"{len(with_goal)} goals can be reached and missed")
    return 1 if failures else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", nargs="?")
    parser.add_argument("truth", nargs="?", help="written by make_footprints.py")
    parser.add_argument("--rh-truth", choices=("rh", "rh_waveform"), default="rh",
                        help="rh: of the surfaces; rh_waveform: of the waveform without noise, which includes the pulse")  # fmt: skip
    parser.add_argument("--reflectance-ratio", type=float, default=1.0, help="of canopy over ground, assumed by the results")
    parser.add_argument("--self-test", action="store_true", help="spoil ideal results; each goal must be missed")
    options = parser.parse_args()
    if options.self_test:
        return self_test()
    if options.truth is None:
        parser.error("results and truth are needed")
    with np.load(options.truth) as file:
        truth = dict(file)
    found = measure(read_results(options.results), truth, options.rh_truth, options.reflectance_ratio)
    return 1 if report(found) else 0


if __name__ == "__main__":
    sys.exit(main())
