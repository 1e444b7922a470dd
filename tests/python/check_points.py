"""Compares LAS and LAZ read by laspy with the table of the same returns."""

import json

import laspy
import numpy as np
import pyarrow.compute as pc

from checks import numbers, same_bytes

WEEK_S = 604_800
ADJUSTMENT_S = 1_000_000_000
SCAN_ANGLE_STEP_DEG = 0.006
# Name, quantity, type, step and value of 0 of each extra attribute, and what NaN is stored as: docs/reference/las.md;
# BayesWavEx 1.1, section 3, and BayesWavEx 1.0, section 2.
LAYOUTS = {
    "standard": [
        ("Amplitude", "amplitude_db", "u2", 0.01, 0.0, 65_535),
        ("Reflectance", "reflectance_db", "i2", 0.01, 0.0, -32_768),
        ("Pulse width", "fwhm", "u2", 0.01, 0.0, 65_535),
        ("Deviation", "deviation", "i2", 0.1, 0.0, -32_768),
        ("Raw amplitude", "raw_amplitude", "u4", 0.01, 0.0, 2**32 - 1),
        ("Width ratio", "width", "u2", 0.001, 0.0, 65_535),
        ("Target thickness", "thickness", "u2", 0.001, 0.0, 65_535),
        ("Range SD", "range_sd", "f4", 1.0, 0.0, np.nan),
        ("Amplitude SD", "amplitude_sd", "f4", 1.0, 0.0, np.nan),
        ("Width SD", "fwhm_sd", "f4", 1.0, 0.0, np.nan),
        ("Thickness SD", "thickness_sd", "f4", 1.0, 0.0, np.nan),
        ("Intensity SD", "intensity_sd", "f4", 1.0, 0.0, np.nan),
        ("Total uncertainty", "total_sd", "f4", 1.0, 0.0, np.nan),
        ("Channel", "receivers", "u1", 1.0, 0.0, 0),
        ("MTA zone", "zone", "u1", 1.0, 0.0, 255),
        ("Quality flags", "flags", "u2", 1.0, 0.0, 0),
    ],
    "1.1": [
        ("WideRatio", "width", "u1", 0.025, 0.5, 0),
        ("TargetThick", "thickness", "u1", 0.008, 0.0, 0),
        ("Amp", "amplitude", "u2", 1.0, 0.0, 0),
        ("DevRatio", "deviation", "u1", 0.1, 0.0, 0),
        ("RangeErr", "range_sd", "u1", 0.001, 0.0, 255),
        ("IntErr", "intensity_sd", "u1", 0.2, 0.0, 255),
        ("WideErr", "width_sd", "u1", 0.002, 0.0, 255),
        ("ThickErr", "thickness_sd", "u1", 0.001, 0.0, 255),
        ("Channel", "channel", "u1", 1.0, 0.0, 0),
    ],
    "1.0": [
        ("Widening", "width", "u1", 0.02, 1.0, 0),
        ("Target Thickness", "thickness", "u1", 0.008, 0.0, 0),
        ("Amplitude", "amplitude", "u2", 1.0, 0.0, 0),
        ("Raw Amplitude", "raw_amplitude", "u2", 1.0, 0.0, 0),
        ("Deviation Ratio", "deviation", "u1", 0.05, 0.0, 0),
        ("Range Error", "range_sd", "u1", 0.001, 0.0, 255),
        ("Intensity Error", "intensity_sd", "u1", 0.2, 0.0, 255),
        ("Widening Error", "width_sd", "u1", 0.002, 0.0, 255),
        ("Thickness Error", "thickness_sd", "u1", 0.001, 0.0, 255),
    ],
}
# Flag bits of the table, and their values in the user data of layout 1.0.
USER_DATA_1_0 = {0: 0, 1: 6, 2: 7}


def attribute_values(table):
    """Expected value of each extra attribute in full precision."""
    db, dn = numbers(table, "amplitude_db"), numbers(table, "amplitude_dn")
    return {
        "width": numbers(table, "width_ratio"),
        "thickness": numbers(table, "thickness_m"),
        "amplitude_db": db,
        "reflectance_db": np.where(np.isnan(db), np.nan, 10.0 * np.log10(np.maximum(numbers(table, "intensity"), 1e-300) / 7.0)),
        "fwhm": numbers(table, "fwhm_ns"),
        "fwhm_sd": numbers(table, "width_ratio_sd") * numbers(table, "fwhm_ns") / numbers(table, "width_ratio"),
        "amplitude_sd": numbers(table, "amplitude_sd_dn"),
        "total_sd": numbers(table, "total_uncertainty_m").astype(float),
        "receivers": np.array([["low", "high", "joint"].index(name) for name in table.column("channel").to_pylist()]),
        "zone": numbers(table, "mta_zone").astype(float),
        "flags": numbers(table, "flags"),
        "amplitude": np.where(np.isnan(db), dn, 7.0 * 10.0 ** (db / 10.0)),
        "raw_amplitude": dn,
        "deviation": numbers(table, "deviation_ratio"),
        "range_sd": numbers(table, "range_sd_m"),
        "intensity_sd": numbers(table, "intensity_sd"),
        "width_sd": numbers(table, "width_ratio_sd"),
        "thickness_sd": numbers(table, "thickness_sd_m"),
        "channel": power_channel(table),
    }


def power_channel(table):
    """Receiver of the intensity: high power if both were fitted."""
    return pc.not_equal(table.column("channel"), "low").to_numpy().astype(float)


def check_points(checks, path, table, container, version="1.4", layout="standard"):
    las = laspy.read(path, laz_backend=laspy.LazBackend.Lazrs)
    header = las.header
    with_waveforms = {"1.4": 9, "1.3": 4} if "waves" in path.name else {"1.4": 6, "1.2": 1}
    expected = (version, with_waveforms[version])
    checks.equal("has its version and point format", (str(header.version), header.point_format.id), expected)
    checks.equal("has a point for each return of the table", len(las.points), table.num_rows)
    check_header(checks, las, layout)
    check_crs(checks, header, container.schema.metadata)
    for axis, step in zip("xyz", header.scales):
        # Half a step, plus the rounding of coordinates as doubles.
        checks.within(f"{axis} is that of the table", las[axis], numbers(table, axis), step / 2 + 1e-8)
    check_fields(checks, las, table, layout)
    check_emissions(checks, las, table, container)
    check_times(checks, las, table, container.schema.metadata)
    check_attributes(checks, las, table, LAYOUTS[layout])
    if layout == "standard":
        check_declared(checks, las, LAYOUTS[layout])
    return las


def check_header(checks, las, layout):
    header = las.header
    checks.equal("has the flight line as file source ID", header.file_source_id, 1 if layout == "standard" else 0)
    by_return = np.bincount(np.asarray(las.return_number), minlength=16)[1:16]
    columns = 5 if is_old(las) else 15
    found = list(header.number_of_points_by_return)[:columns]
    checks.equal("points by return add up", found, by_return.tolist()[:columns])
    found = [las.xyz.min(axis=0), las.xyz.max(axis=0)]
    checks.within("the bounding box is that of the points", [header.mins, header.maxs], found, 1e-8)
    checks.that("says which program made it", header.generating_software.startswith("wavex "))


def is_old(las):
    return las.header.version.minor < 4


def check_crs(checks, header, metadata):
    if header.version.minor < 4:
        check_geo_keys(checks, header, metadata)
        return
    records = [vlr for vlr in header.vlrs if (vlr.user_id, vlr.record_id) == ("LASF_Projection", 2112)]
    crs = metadata.get(b"wavex.crs", b"").decode()
    checks.equal("has the coordinate reference system of the input", [vlr.string for vlr in records], [crs] if crs else [])
    checks.equal("says that it is WKT where there is one", header.global_encoding.wkt, bool(crs))


def check_geo_keys(checks, header, metadata):
    crs = metadata.get(b"wavex.crs", b"").decode()
    records = [vlr for vlr in header.vlrs if (vlr.user_id, vlr.record_id) == ("LASF_Projection", 34735)]
    keys = {key.id: key.value_offset for vlr in records for key in vlr.geo_keys}
    codes = [keys[name] for name in (3072, 2048) if name in keys]
    checks.equal("names the coordinate reference system by its code", len(codes), 1 if crs else 0)
    checks.that("the code is that of the input", all(f'AUTHORITY["EPSG","{code}"]' in crs for code in codes), codes)
    checks.that("does not say that it is WKT", not header.global_encoding.wkt)


def check_fields(checks, las, table, layout):
    rounded = np.clip(np.floor(numbers(table, "intensity") + 0.5), 0, 65535)
    checks.within("intensity is that of the table, rounded", las.intensity, rounded, 0)
    for field, column, most in [
        ("return_number", "return_number", 7 if is_old(las) else 15),
        ("number_of_returns", "number_of_returns", 7 if is_old(las) else 15),
        ("withheld", "withheld", 1),
    ]:
        expected = np.minimum(numbers(table, column).astype(int), most)
        checks.within(f"{field} is that of the table", las[field], expected, 0)
    classes, flags = numbers(table, "class").astype(int), numbers(table, "flags").astype(int) & 0xFF
    if layout == "standard":
        classes = np.where(is_old(las) & (classes == 18), 7, classes)
    else:
        classes = np.where(classes > 0, 20, classes)
    if layout == "1.0":
        classes = np.where(numbers(table, "deviation_ratio") > 3.0, 20, classes)
        flags = sum((flags >> bit & 1) << place for bit, place in USER_DATA_1_0.items())
    checks.within("classification is that of the table", las.classification, classes, 0)
    checks.within("user_data holds the flags of the fit", las.user_data, flags, 0)
    source = np.ones(len(las.points)) if layout == "standard" else np.maximum(numbers(table, "mta_zone", null=0), 0)
    checks.within("point_source_id is the flight line, or the zone", las.point_source_id, source, 0)
    for field in ["synthetic", "key_point"] + ([] if is_old(las) else ["overlap"]):
        checks.that(f"{field} is not set", not np.any(las[field]))
    if not is_old(las):
        checks.within("scanner_channel is the power channel", las.scanner_channel, power_channel(table), 0)


def check_emissions(checks, las, table, container):
    """Checks emission attributes of points by the shot in the table."""
    rows = np.searchsorted(numbers(container, "shot"), numbers(table, "shot"))
    flags = numbers(container, "flags").astype(int)[rows]
    checks.within("scan_direction_flag is that of the shot", las.scan_direction_flag, flags >> 8 & 1, 0)
    checks.within("edge_of_flight_line is that of the shot", las.edge_of_flight_line, flags >> 9 & 1, 0)
    angle = numbers(container, "scan_angle_deg", null=0.0).astype(float)[rows]
    step = 1.0 if is_old(las) else SCAN_ANGLE_STEP_DEG
    stored = (las.scan_angle_rank if is_old(las) else las.scan_angle) * step
    checks.within("scan_angle is that of the shot", stored, angle, step / 2 + 1e-9)


def check_times(checks, las, table, metadata):
    scale, week = metadata[b"wavex.time_scale"].decode(), metadata.get(b"wavex.gps_week")
    adjusted = scale == "adjusted" or (scale == "week" and week is not None)
    offset = int(week) * WEEK_S - ADJUSTMENT_S if scale == "week" and week is not None else 0
    checks.equal("says whether its times are adjusted", int(las.header.global_encoding.gps_time_type), int(adjusted))
    times = offset + numbers(table, "gps_time_s", null=0.0)
    checks.within("gps_time is that of the table", las.gps_time, times, 0)


def check_attributes(checks, las, table, layout):
    names = list(las.point_format.extra_dimension_names)
    checks.equal("has the extra attributes in their order", names, [name for name, *_ in layout])
    values = attribute_values(table)
    for name, quantity, kind, step, zero, unknown in layout:
        if kind == "f4":
            check_single(checks, las, name, values[quantity])
            continue
        stored = las.points.array[name]
        about = las.point_format.dimension_by_name(name)
        scale = 1.0 if about.scales is None else about.scales[0]
        offset = 0.0 if about.offsets is None else about.offsets[0]
        found = (stored.dtype.str[1:], scale, offset)
        checks.equal(f"{name} has its type and step", found, (kind, step, zero))
        limits = np.iinfo(stored.dtype)
        steps = np.clip((values[quantity] - zero) / step, limits.min, limits.max)
        steps = np.where(np.isnan(steps), unknown, steps)
        checks.within(f"{name} is that of the table", stored, steps, 0.5 + 1e-6)


def check_single(checks, las, name, expected):
    """Checks a standard deviation in single precision: within 1 % of the table, and NaN where unknown."""
    stored = np.asarray(las[name])
    checks.equal(f"{name} has its type and step", (stored.dtype.str[1:], las.point_format.dimension_by_name(name).scales), ("f4", None))
    checks.that(f"{name} is unknown where it is in the table", np.array_equal(np.isnan(stored), np.isnan(expected)))
    # A column without any known value has nothing to compare.
    off = np.abs(stored - expected) / np.maximum(expected, 1e-30)
    checks.that(f"{name} is within 1 % of the table", np.nanmax(off, initial=0.0) <= 0.01, np.nanmax(off, initial=0.0))


def check_declared(checks, las, layout):
    """Checks no-data values and limits in the record of the extra attributes."""
    (record,) = [vlr for vlr in las.header.vlrs if (vlr.user_id, vlr.record_id) == ("LASF_Spec", 4)]
    for about, (name, _, kind, *_, unknown) in zip(record.extra_bytes_structs, layout):
        if name not in ("Channel", "Quality flags"):
            checks.that(f"{name} declares its no-data value", np.array_equal(about.no_data, [unknown], equal_nan=kind == "f4"))
        if name != "Quality flags":
            stored = las.points.array[name]
            known = np.asarray(las[name], dtype=float)[(stored != unknown) & ~np.isnan(stored)]
            inside = (known >= about.min[0] - 1e-9) & (known <= about.max[0] + 1e-9)
            checks.that(f"{name} is within its limits", np.all(inside), (about.min, about.max))


def check_same_points(checks, las, laz):
    checks.that("holds the same points as LAS", same_bytes(las.points.array, laz.points.array))
    records = lambda file: [(vlr.user_id, vlr.record_id) for vlr in file.header.vlrs if vlr.user_id != "laszip encoded"]
    checks.equal("has the same records as LAS", json.dumps(records(laz)), json.dumps(records(las)))
