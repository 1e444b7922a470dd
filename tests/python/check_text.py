"""Compares text points and sensor paths with the table of the same returns and the truth."""

import laspy
import numpy as np
import pyproj

from check_points import ADJUSTMENT_S, LAYOUTS, SCAN_ANGLE_STEP_DEG, WEEK_S, attribute_values, power_channel
from checks import numbers

# All columns with their names: letters of LAStools, and extra attributes by number.
COLUMNS = "txyzXYZirncuaedphkgol0123456789"
NAMES = ["gps_time", "x", "y", "z", "X", "Y", "Z", "intensity", "return_number", "number_of_returns", "classification",
         "user_data", "scan_angle", "edge_of_flight_line", "scan_direction", "point_source_id", "withheld", "key_point",
         "synthetic", "overlap", "scanner_channel"]
ATTRIBUTES = LAYOUTS["1.1"] + [("RawAmp", "raw_amplitude", "u2", 1.0, 0.0, 0)]
# SBET: time, latitude, longitude, height, three velocities, roll, pitch, platform heading, wander angle, and six more.
SBET = np.dtype(("<f8", 17))


def check_ascii(checks, path, table, container):
    head, *rows = path.read_text().splitlines()
    checks.equal("names its columns", head.split(","), NAMES + [name for name, *_ in ATTRIBUTES])
    checks.equal("has a row per return", len(rows), table.num_rows)
    values = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    column = dict(zip(head.split(","), values.T))
    with laspy.open(path.with_name(path.name.replace("_points.txt", ".las"))) as las:
        scales, offsets = las.header.scales, las.header.offsets
    for axis, step, offset in zip("xyz", scales, offsets):
        checks.within(f"{axis} is that of the table", column[axis], numbers(table, axis), step / 2 + 1e-8)
        checks.within(f"{axis.upper()} are its steps", column[axis.upper()] * step + offset, column[axis], 1e-8)
    intensity = np.clip(np.floor(numbers(table, "intensity") + 0.5), 0, 65535)
    checks.within("intensity is that of the table, rounded", column["intensity"], intensity, 0)
    for name, of_table in [("return_number", "return_number"), ("number_of_returns", "number_of_returns"),
                           ("withheld", "withheld")]:
        checks.within(f"{name} is that of the table", column[name], np.minimum(numbers(table, of_table).astype(int), 255), 0)
    checks.within("classification is 20 for outliers", column["classification"], np.where(numbers(table, "class") > 0, 20, 0), 0)
    checks.within("user_data holds the flags of the fit", column["user_data"], numbers(table, "flags").astype(int) & 0xFF, 0)
    zone = np.maximum(numbers(table, "mta_zone", null=0), 0)
    checks.within("point_source_id is the multiple-time-around zone", column["point_source_id"], zone, 0)
    checks.within("scanner_channel is the power channel", column["scanner_channel"], power_channel(table), 0)
    check_shots(checks, column, table, container)
    check_attributes(checks, column, table)


def check_shots(checks, column, table, container):
    """Checks shot attributes of rows."""
    rows = np.searchsorted(numbers(container, "shot"), numbers(table, "shot"))
    flags = numbers(container, "flags").astype(int)[rows]
    checks.within("scan_direction is that of the shot", column["scan_direction"], flags >> 8 & 1, 0)
    checks.within("edge_of_flight_line is that of the shot", column["edge_of_flight_line"], flags >> 9 & 1, 0)
    angle = numbers(container, "scan_angle_deg", null=0.0).astype(float)[rows]
    checks.within("scan_angle is that of the shot", column["scan_angle"], angle, SCAN_ANGLE_STEP_DEG / 2 + 1e-9)
    for name in ["key_point", "synthetic", "overlap"]:
        checks.that(f"{name} is not set", not np.any(column[name]))
    # Both clocks may differ by whole weeks.
    since_first = column["gps_time"] - column["gps_time"][0]
    times = numbers(table, "gps_time_s", null=0.0)
    checks.within("gps_time runs with that of the table", since_first, times - times[0], 1e-6)


def check_attributes(checks, column, table):
    values = attribute_values(table)
    for name, quantity, kind, step, zero, unknown in ATTRIBUTES:
        steps = np.clip((values[quantity] - zero) / step, 0, np.iinfo(kind).max)
        steps = np.where(np.isnan(steps), unknown, steps)
        found = (column[name] - zero) / step
        checks.within(f"{name} is that of the table", found, steps, 0.5 + 1e-9)
        checks.within(f"{name} has whole steps", found, np.round(found), 1e-6)


def read_path(path):
    head, *rows = path.read_text().splitlines()
    return head.removeprefix("# ").split(" "), np.array([[float(cell) for cell in row.split(" ")] for row in rows])


def shots_with_rows(times, every):
    """Every n-th shot, restarting where the clock steps back; plus the last shot."""
    shots = [0]
    for shot, time in enumerate(times):
        if shot - shots[-1] >= every or time < times[shots[-1]]:
            shots.append(shot)
    return sorted({*shots, len(times) - 1})


def check_origins(checks, path, container, every):
    """Checks a path from beam origins."""
    names, rows = read_path(path)
    checks.equal("names its columns", names, ["gps_time", "X", "Y", "Z"])
    origins = np.array(container.column("origin").to_pylist())
    shots = shots_with_rows(numbers(container, "gps_time_s").astype(float), every)
    checks.equal("has a row for every n-th shot, and the last", len(rows), len(shots))
    checks.within("its places are where the beams begin", rows[:, 1:], origins[shots], 0.5e-4 + 1e-9)
    since_first = rows[:, 0] - rows[0, 0]
    times = numbers(container, "gps_time_s").astype(float)[shots]
    checks.within("its times run with those of the shots", since_first, times - times[0], 2e-6)


def check_beams(checks, path):
    """Checks that a path estimated from beam intersections is plausible."""
    names, rows = read_path(path)
    checks.equal("names its columns", names, ["gps_time", "X", "Y", "Z"])
    checks.that("runs forward in time", len(rows) > 0 and np.all(np.diff(rows[:, 0]) > 0.0))


def check_flown(checks, path, sbet, epsg):
    """Checks a path with attitude against the flown trajectory."""
    names, rows = read_path(path)
    checks.equal("names its columns", names, ["gps_time", "X", "Y", "Z", "roll", "pitch", "heading"])
    flown = np.fromfile(sbet, dtype=SBET)
    # Rows are in adjusted GPS seconds, the trajectory in seconds of the week.
    rows[:, 0] = (rows[:, 0] + ADJUSTMENT_S) % WEEK_S
    checks.that("has rows between the first and last record",
                len(rows) > 5 and flown[0, 0] <= rows[0, 0] and rows[-1, 0] <= flown[-1, 0])
    project = pyproj.Transformer.from_crs("EPSG:4979", epsg, always_xy=True)
    x, y = project.transform(np.degrees(flown[:, 2]), np.degrees(flown[:, 1]))
    # At 200 records per second, linear interpolation is accurate to 1 mm and 0.001 degrees.
    between = lambda values: np.interp(rows[:, 0], flown[:, 0], values)
    for column, values in [(1, x), (2, y), (3, flown[:, 3])]:
        checks.within(f"{names[column]} is where the aircraft was", rows[:, column], between(values), 2e-3)
    for column, values in [(4, flown[:, 7]), (5, flown[:, 8]), (6, flown[:, 9] - flown[:, 10])]:
        off = rows[:, column] - np.degrees(between(np.unwrap(values)))
        checks.within(f"{names[column]} is that of the aircraft", (off + 180.0) % 360.0 - 180.0, 0.0 * off, 2e-3)
