"""Writes simulated footprints as HDF5 in the layout of GEDI01_B."""

import h5py
import numpy as np

SHOT_INTERVAL_S, FIRST_SHOT_S = 0.008264, 40_810_919.0
EPOCH_GPS_S = 1_198_800_018.0  # 2018-01-01, from which all times count
ORBIT = 1964
ALTITUDE_M = 413_300.0
EARTH_M = 6_371_000.0
SMALL_CHUNK = 10_000


def put(group, name, values, dtype, chunk=SMALL_CHUNK):
    """A compressed data set in chunks, which may be longer than the data."""
    values = np.asarray(values, dtype=dtype)
    shape = (*values.shape[:-1], chunk)
    group.create_dataset(name, data=values, maxshape=(*values.shape[:-1], None), chunks=shape, compression="gzip")


def write_beam(group, name, shots, sample_m, stated_noise):
    """Writes one beam; returns shot numbers, and elevations and positions of the ground."""
    number = shots["cover"].size
    at = np.arange(number)
    order = int(name[4:], 2)
    time = FIRST_SHOT_S + 0.1 * order + SHOT_INTERVAL_S * at
    shot_number = np.uint64(ORBIT * 10**13 + order * 10**11 + 135 * 10**8) + np.uint64(2 * 10**8) * at.astype(np.uint64)
    shot_number += np.uint64(100_000) + at.astype(np.uint64)

    lean = np.radians(shots["off_nadir_deg"])
    count, step_m = shots["count"], sample_m * np.cos(lean)
    ground_centre = 500.0 + 120.0 * np.sin(0.011 * at + order) + 15.0 * np.sin(0.17 * at)
    latitude, longitude = -13.75 + 0.000413 * at, -44.1366 + 0.02 * order + 0.000317 * at

    def position(samples):
        """Latitude, longitude and elevation at a sample; the beam points along its azimuth."""
        rise = (shots["centre_sample"] - samples) * step_m
        away = -rise * np.tan(lean)
        north = np.degrees(away * np.cos(shots["azimuth_rad"]) / EARTH_M)
        east = np.degrees(away * np.sin(shots["azimuth_rad"]) / EARTH_M / np.cos(np.radians(latitude)))
        return latitude + north, longitude + east, ground_centre + rise

    rx, tx = np.concatenate(shots["rx"]), np.concatenate(shots["tx"])
    tx_count = np.full(number, 128)
    put(group, "rxwaveform", rx, "f4", 14_200)
    put(group, "txwaveform", tx, "f4", 12_800)
    ends = np.cumsum(count)
    energy = [row.sum() - row.size * mean for row, mean in zip(shots["rx"], shots["noise_mean_dn"])]
    ones, zeros = np.ones(number), np.zeros(number)
    columns = {
        "all_samples_sum": ("u4", 20_000 * shots["noise_mean_dn"]), "beam": ("u2", order * ones),
        "channel": ("u1", order // 2 * ones), "delta_time": ("f8", time),
        "master_frac": ("f8", time % 1), "master_int": ("u4", np.floor(time)),
        "noise_mean_corrected": ("f8", np.round(16 * shots["noise_mean_dn"]) / 16),
        "noise_stddev_corrected": ("f8", stated_noise * shots["noise_sd_dn"]),
        "nsemean_even": ("f4", shots["noise_mean_dn"]), "nsemean_odd": ("f4", shots["noise_mean_dn"]),
        "rx_energy": ("f8", energy), "rx_offset": ("u2", 57_800 * ones), "rx_open": ("u4", 2_856_992 * ones),
        "rx_sample_count": ("u2", count), "rx_sample_start_index": ("u8", ends - count + 1),
        "selection_stretchers_x": ("u2", 300 * ones), "selection_stretchers_y": ("u2", 400 * ones),
        "shot_number": ("u8", shot_number), "stale_return_flag": ("u1", zeros),
        "th_left_used": ("u2", shots["noise_mean_dn"] + 12), "tx_sample_count": ("u2", tx_count),
        "tx_sample_start_index": ("u8", np.cumsum(tx_count) - 127),
        "tx_egamplitude": ("f4", 18_000 * ones), "tx_egamplitude_error": ("f4", 8.6 * ones),
        "tx_egbias": ("f4", shots["noise_mean_dn"]), "tx_egbias_error": ("f4", 0.11 * ones),
        "tx_egflag": ("u1", ones), "tx_eggamma": ("f4", 1 / shots["tx_decay"]), "tx_eggamma_error": ("f4", 0.0003 * ones),
        "tx_egsigma": ("f4", shots["tx_gaussian"]), "tx_egsigma_error": ("f4", 0.005 * ones),
        "tx_gloc": ("f4", shots["tx_gloc"]), "tx_gloc_error": ("f4", 0.003 * ones), "tx_pulseflag": ("u1", ones),
    }  # fmt: skip
    for key, (dtype, values) in columns.items():
        put(group, key, values, dtype)
    for key, value in (("master_time_epoch", EPOCH_GPS_S), ("mean_samples", np.int64(20_000)), ("smoothing_width", 2000.0)):
        group.create_dataset(f"ancillary/{key}", data=np.array([value]))

    place = group.create_group("geolocation")
    travel = 2 * ALTITUDE_M / 299_792_458.0 / 2
    for part, samples in (("bin0", zeros), ("lastbin", count - 1.0)):
        for key, values, error in zip(("latitude", "longitude", "elevation"), position(samples), (5.3e-5, 4.0e-5, 0.33)):
            put(place, f"{key}_{part}", values, "f8")
            put(place, f"{key}_{part}_error", error * ones, "f4")
        put(place, f"bounce_time_offset_{part}", travel + 0.5e-9 * samples, "f8")
        put(place, f"bounce_time_offset_{part}_error", 7.4e-10 * ones, "f4")
        put(place, f"neutat_delay_total_{part}", 2.13 * ones, "f4")
        put(place, f"neutat_delay_derivative_{part}", -7.8e-8 * ones, "f4")
    for key, dtype, values in (
        ("altitude_instrument", "f8", ALTITUDE_M), ("altitude_instrument_error", "f4", 0.2),
        ("degrade", "i1", 0), ("delta_time", "f8", time), ("digital_elevation_model", "f4", ground_centre),
        ("latitude_instrument", "f8", latitude - 0.066), ("latitude_instrument_error", "f4", 3e-6),
        ("local_beam_azimuth", "f4", shots["azimuth_rad"]), ("local_beam_azimuth_error", "f4", 3.2e-4),
        ("local_beam_elevation", "f4", np.pi / 2 - lean), ("local_beam_elevation_error", "f4", 1.8e-5),
        ("longitude_instrument", "f8", longitude - 0.025), ("longitude_instrument_error", "f4", 2.8e-6),
        ("mean_sea_surface", "f4", -12.8), ("range_bias_correction", "f4", -0.9475),
        ("shot_number", "u8", shot_number), ("solar_azimuth", "f4", 81.3), ("solar_elevation", "f4", -10.9),
    ):  # fmt: skip
        put(place, key, np.broadcast_to(np.asarray(values), number), dtype)
    put(place, "surface_type", np.array([[1], [0], [0], [0], [0]]) * ones, "i1")
    corrections = group.create_group("geophys_corr")
    put(corrections, "delta_time", time, "f8")
    for key in ("dynamic_atmosphere_correction", "geoid", "tide_earth", "tide_load", "tide_ocean", "tide_ocean_pole", "tide_pole"):
        put(corrections, key, zeros, "f4")
    ground_latitude, ground_longitude, _ = position(shots["centre_sample"])
    return {"shot_number": shot_number, "ground_centre_m": ground_centre, "ground_m": ground_centre + shots["ground_offset_m"],
            "latitude_deg": ground_latitude, "longitude_deg": ground_longitude}  # fmt: skip


def write(path, table, sample_m, stated_noise):
    """Writes the file; returns the truth of the shots in the order of the file."""
    truth = {}
    partial = path.with_name(path.name + ".partial")
    with h5py.File(partial, "w") as file:
        file.attrs["short_name"] = np.array(["GEDI_L1B"], dtype=h5py.string_dtype())
        metadata = file.create_group("METADATA/DatasetIdentification")
        for key, value in (("shortName", "GEDI_L1B"), ("VersionID", "01"), ("fileName", path.name)):
            metadata.attrs[key] = np.array([value], dtype=h5py.string_dtype())
        for name in np.unique(table["beam"]):
            own = np.flatnonzero(table["beam"] == name)
            shots = {key: [values[k] for k in own] if key in ("rx", "tx") else values[own] for key, values in table.items()}
            found = write_beam(file.create_group(name), name, shots, sample_m, stated_noise)
            for key, values in found.items():
                truth.setdefault(key, []).append(values)
    partial.replace(path)
    left_out = ("rx", "tx", "stretch", "tx_decay", "tx_gaussian", "gradient_x", "gradient_y")
    kept = {key: values for key, values in table.items() if key not in left_out}
    return {key: np.concatenate(values) for key, values in truth.items()} | kept
