"""Compares every sample that `wavex-hdf5` reads with h5py.

Build the program first: cargo build -p wavex-hdf5 --example dump_hdf5
usage: check_hdf5.py DUMP_PROGRAM FILE ...
Prints beams, shots and samples, and the CRC-32 of all samples of a file as little-endian `f32`.
"""

import subprocess
import sys
import zlib

import h5py
import numpy as np


def degrees(longitude, latitude, height):
    """Position as the crate gives it."""
    return np.radians((longitude + 180) % 360 - 180), np.radians(latitude), height


def gedi_shots(beam):
    """Shots of a beam: received, outgoing, number, values."""
    place = beam["geolocation"]
    columns = [
        beam["delta_time"][:] + beam["ancillary/master_time_epoch"][0],
        beam["noise_mean_corrected"][:].astype(np.float32),
        beam["noise_stddev_corrected"][:].astype(np.float32),
    ]
    for of, height in (("bin0", "elevation"), ("lastbin", "elevation"), ("instrument", "altitude")):
        columns += degrees(place[f"longitude_{of}"][:], place[f"latitude_{of}"][:], place[f"{height}_{of}"][:])
    waveforms = []
    for way in ("rx", "tx"):
        samples = beam[f"{way}waveform"][:].astype("<f4")
        start, count = (beam[f"{way}_sample_{what}"][:].astype(int) for what in ("start_index", "count"))
        fits = start.min() >= 1 and (start - 1 + count).max() <= len(samples)
        first = start - 1 if fits else np.cumsum(count) - count
        waveforms.append([samples[at : at + length] for at, length in zip(first, count)])
    return zip(*waveforms, beam["shot_number"][:], np.array(columns, float).T)


def lvis_shots(file):
    """Shots of a file of LVIS."""
    last = file["RXWAVE"].shape[1] - 1
    count = len(file["SHOTNUMBER"])
    unknown = np.full(count, np.nan)
    columns = [file["TIME"][:], file["SIGMEAN"][:], unknown]
    for of in (0, last):
        columns += degrees(file[f"LON{of}"][:], file[f"LAT{of}"][:], file[f"Z{of}"][:])
    columns += [unknown] * 3
    outgoing = file["TXWAVE"][:].astype("<f4") if "TXWAVE" in file else np.empty((count, 0), "<f4")
    return zip(file["RXWAVE"][:].astype("<f4"), outgoing, file["SHOTNUMBER"][:], np.array(columns, float).T)


def spd_shots(file):
    """Waveforms of the pulses of SPD."""
    received, transmitted = (file[f"DATA/{name}"][:].astype("<f4") for name in ("RECEIVED", "TRANSMITTED"))
    table = file["DATA/PULSES"]
    is_table = isinstance(table, h5py.Dataset)

    def column(group, name):
        if is_table:
            return table[name].astype(float) if table[name].dtype.kind == "f" else table[name]
        data = file[f"DATA/{group}/{name}"]
        scale = data.attrs
        return data[:] / scale["GAIN"] + scale["OFFSET"] if "GAIN" in scale else data[:]

    pulses = {name: column("PULSES", name) for name in ("PULSE_ID", "X_ORIGIN", "Y_ORIGIN", "Z_ORIGIN", "AZIMUTH", "ZENITH")}
    times = column("PULSES", "GPS_TIME" if is_table else "TIMESTAMP").astype(float)
    names = ["RANGE_TO_WAVEFORM_START"]
    for way in ("RECEIVED", "TRANSMITTED"):
        names += [f"{way}_START_IDX", f"NUMBER_OF_WAVEFORM_{way}_BINS"]
    waves = [column("WAVEFORMS", name) for name in names]
    for i, (number, *place) in enumerate(zip(*pulses.values())):
        first, count = (i, 1) if is_table else (column("PULSES", name)[i] for name in ("WFM_START_IDX", "NUMBER_OF_WAVEFORM_SAMPLES"))
        for row in range(int(first), int(first) + int(count)):
            range_m, start, length, sent, sent_length = (int(values[row]) if k else values[row] for k, values in enumerate(waves))
            yield (
                received[start : start + length],
                transmitted[sent : sent + sent_length],
                number,
                np.array([times[i], *place, range_m], float),
            )


def compare(program, path):
    """Compares all beams of a file."""
    digest = 0
    with h5py.File(path) as file:
        if "DATA" in file:
            beams = {"SPD": spd_shots(file)}
        elif "RXWAVE" in file:
            beams = {"LVIS": lvis_shots(file)}
        else:
            names = sorted(name for name in file if name.startswith("BEAM"))
            beams = {name: gedi_shots(file[name]) for name in names if "rxwaveform" in file[name]}
        shots = samples = 0
        for name, expected in beams.items():
            dump = subprocess.run([program, path, name], check=True, stdout=subprocess.PIPE).stdout
            at = 0
            for received, outgoing, number, values in expected:
                counts = np.frombuffer(dump, "<u4", 2, at)
                assert (counts == [len(received), len(outgoing)]).all(), (path, name, number, counts)
                found = np.frombuffer(dump, "<f4", counts.sum(), at + 8)
                every = np.concatenate([received, outgoing])
                assert found.tobytes() == every.tobytes(), (path, name, number, "samples")
                at += 8 + found.nbytes
                assert np.frombuffer(dump, "<u8", 1, at)[0] == number, (path, name, number)
                found = np.frombuffer(dump, "<f8", len(values), at + 8)
                equal = np.allclose(found, values, rtol=1e-15, atol=0, equal_nan=True)
                assert equal, (path, name, number, found, values)
                at += 8 + found.nbytes
                digest = zlib.crc32(every.tobytes(), digest)
                shots, samples = shots + 1, samples + len(every)
            assert at == len(dump), (path, name, "further shots")
    print(f"{path}: {len(beams)} beams, {shots} shots, {samples} samples, CRC-32 {digest:08x}")


if __name__ == "__main__":
    if len(sys.argv) < 3:
        sys.exit(__doc__)
    for path in sys.argv[2:]:
        compare(sys.argv[1], path)
