"""Makes the HDF5 files of `crates/wavex-hdf5/tests/data`: each uses another form of storage.

Values follow formulas that the tests in Rust repeat: sample k of shot i is `200 + (7 i + 3 k) % 101 + (i % 4) / 4`.

All but `odd_data_sets.h5`, which has times of creation, are the same at each run.

usage: make_hdf5.py FOLDER
"""

import sys
from pathlib import Path

import h5py
import make_spd
import numpy as np

SHOTS = 12
LVIS_SHOTS = 6
# Columns with the storage of a case; the others are contiguous, because each B-tree takes 2 kB.
IN_CHUNKS = ("shot_number", "delta_time", "rx_sample_count", "rx_sample_start_index", "geolocation/degrade")


def sample(shot, index):
    """Received sample."""
    return 200 + (7 * shot + 3 * index) % 101 + (shot % 4) / 4


def outgoing(shot, index):
    """Outgoing sample."""
    return 240 + (5 * shot + index) % 50


def count(shot):
    """Number of received samples."""
    return 20 + shot % 3


def create(path, library=None, user_block=0):
    """Creates a file for readers of a version of HDF5, by default of the first."""
    bounds = {None: ("earliest", "v108"), "v110": ("v110", "v110"), "latest": "latest"}
    return h5py.File(path, "w", libver=bounds[library], userblock_size=user_block)


def gedi_beam(beam, samples, values, numbers="<", starts=None):
    """Fills the group of a beam; `samples` and `values` are options of its data sets."""
    shots = np.arange(SHOTS)
    counts = count(shots)
    first = np.cumsum(counts) - counts
    received = np.concatenate([sample(i, np.arange(count(i))) for i in shots])
    pulse = np.concatenate([outgoing(i, np.arange(8)) for i in shots])
    columns = {
        "shot_number": (19640513500108370 + 200000001 * shots, "u8"),
        "delta_time": (4.08e7 + 0.00826 * shots, "f8"),
        "rx_sample_count": (counts, "u2"),
        "rx_sample_start_index": (first + 1 if starts is None else starts, "u8"),
        "tx_sample_count": (np.full(SHOTS, 8), "u2"),
        "tx_sample_start_index": (8 * shots + 1, "u8"),
        "noise_mean_corrected": (200 + shots / 8, "f8"),
        "noise_stddev_corrected": (2 + shots / 16, "f8"),
        "stale_return_flag": (shots % 2, "u1"),
        "geolocation/degrade": (shots % 3, "i1"),
        "geophys_corr/geoid": (-13 + shots / 4, "f4"),
    }
    for of, height in (("bin0", 850.0), ("lastbin", 730.0), ("instrument", 413000.0)):
        name = "altitude" if of == "instrument" else "elevation"
        columns[f"geolocation/longitude_{of}"] = (-44.25 + shots / 1024, "f8")
        columns[f"geolocation/latitude_{of}"] = (-13.75 - shots / 1024, "f8")
        columns[f"geolocation/{name}_{of}"] = (height + shots / 2, "f8")
    for name, (data, kind) in columns.items():
        options = values if name in IN_CHUNKS else {}
        beam.create_dataset(name, data=np.asarray(data, numbers + kind), **options)
    beam.create_dataset("rxwaveform", data=np.asarray(received, numbers + "f4"), **samples)
    beam.create_dataset("txwaveform", data=np.asarray(pulse, numbers + "f4"), **samples)
    beam.create_dataset("ancillary/master_time_epoch", data=[1198800018.0])


def gedi(path, samples, values, library=None, **options):
    """Makes a file with one beam with waveforms and one without."""
    with create(path, library, options.pop("user_block", 0)) as file:
        gedi_beam(file.create_group("BEAM0101"), samples, values, **options)
        file.create_group("BEAM0000/ancillary")


def lvis(path, samples, kind, options, with_pulse=True, library=None):
    """Makes a file of LVIS."""
    shots = np.arange(LVIS_SHOTS)
    waveforms = 10 + (11 * shots[:, None] + 2 * np.arange(samples)) % 200
    last = samples - 1
    columns = {
        "LFID": (1000000 + shots, "u4"),
        "SHOTNUMBER": (500 + shots, "u4"),
        "TIME": (43200.5 + shots / 64, "f8"),
        "AZIMUTH": (10 + shots, "f4"),
        "INCIDENTANGLE": (1 + shots / 8, "f4"),
        "RANGE": (8000 + shots, "f4"),
        "SIGMEAN": (14 + shots / 4, "f4"),
    }
    for index, height in ((0, 500.0), (last, 372.0)):
        columns[f"LON{index}"] = (310.5 + shots / 1024, "f8")
        columns[f"LAT{index}"] = (69.25 + shots / 1024, "f8")
        columns[f"Z{index}"] = (height + shots / 2, "f4")
    with create(path, library) as file:
        for name, (data, type_name) in columns.items():
            file.create_dataset(name, data=np.asarray(data, type_name))
        file.create_dataset("RXWAVE", data=waveforms.astype(kind), **options)
        if with_pulse:
            pulse = 30 + (shots[:, None] + np.arange(16)) % 90
            file.create_dataset("TXWAVE", data=pulse.astype(kind))


def chunks(size, **more):
    """Options of compressed chunks."""
    return dict(chunks=(size,), compression="gzip", **more)


def make(folder):
    """Makes all files."""
    large = chunks(50_000, maxshape=(None,))
    latest = "latest"
    # Old groups and B-trees, chunks larger than the data, samples over several chunks: the product's layout.
    gedi(folder / "gedi_product.h5", chunks(50), large)
    gedi(folder / "gedi_contiguous.h5", {}, {})
    # More chunks than a node of a B-tree holds.
    gedi(folder / "gedi_deep_tree.h5", dict(chunks=(1,)), {})
    gedi(folder / "gedi_shuffle_checksum.h5", chunks(50, shuffle=True, fletcher32=True), chunks(7, shuffle=True))
    gedi(folder / "gedi_checksum.h5", dict(chunks=(50,), fletcher32=True), dict(chunks=(7,), fletcher32=True))
    gedi(folder / "gedi_big_endian.h5", chunks(50, shuffle=True), {}, numbers=">")
    gedi(folder / "gedi_user_block.h5", chunks(50), {}, user_block=1024)
    # New groups (more than eight members: a heap); fixed arrays, one chunk.
    gedi(folder / "gedi_latest.h5", chunks(50), chunks(SHOTS), library=latest)
    gedi(folder / "gedi_latest_plain.h5", dict(chunks=(9,)), dict(chunks=(5,)), library=latest)
    gedi(folder / "gedi_v110.h5", chunks(50), chunks(5), library="v110")
    # Extensible arrays; 300 chunks reach blocks that super blocks list.
    growing = dict(maxshape=(None,))
    gedi(folder / "gedi_extensible.h5", chunks(2, **growing), chunks(5, **growing), library="v110")
    gedi(folder / "gedi_extensible_plain.h5", dict(chunks=(1,), **growing), {}, library="v110")
    # Start indices of the whole granule, as some programs that cut granules leave them.
    kept = 1_000_001 + 813 * np.arange(SHOTS)
    gedi(folder / "gedi_cut.h5", chunks(50), large, starts=kept)
    lvis(folder / "lvis_432.h5", 432, "u2", chunks_of_rows(4, 432))
    lvis(folder / "lvis_528.h5", 528, ">i2", dict(chunks=(2, 100), compression="gzip"))
    lvis(folder / "lvis_1024.h5", 1024, "f4", {}, library=latest)
    lvis(folder / "lvis_1216.h5", 1216, "u2", dict(chunks=(4, 500), maxshape=(None, None)), library="v110")
    lvis(folder / "lvis_without_pulse.h5", 352, "u2", {}, with_pulse=False)
    special(folder)
    odd(folder)
    refused(folder)
    make_spd.make(folder)


def chunks_of_rows(rows, columns):
    """Options of chunks of whole rows."""
    return dict(chunks=(rows, columns), compression="gzip", shuffle=True)


def special(folder):
    """Makes files that are not ordinary."""
    # Compact data and values that are not stored.
    with create(folder / "gedi_compact_fill.h5") as file:
        beam = file.create_group("BEAM1011")
        for name, data in (("shot_number", np.arange(3, dtype="u8")), ("rx_sample_count", np.full(3, 4, "u2"))):
            options = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
            options.set_layout(h5py.h5d.COMPACT)
            options.set_obj_track_times(False)
            kind = h5py.h5t.py_create(data.dtype)
            made = h5py.h5d.create(beam.id, name.encode(), kind, h5py.h5s.create_simple(data.shape), options)
            made.write(h5py.h5s.ALL, h5py.h5s.ALL, data)
        beam.create_dataset("rx_sample_start_index", data=[1, 5, 9])
        samples = beam.create_dataset("rxwaveform", (12,), "<f4", chunks=(4,), fillvalue=-1.5)
        samples[4:8] = [1, 2, 3, 4]
        beam.create_dataset("delta_time", (3,), "<f8", fillvalue=2.5)
    # A shot whose samples are not in the file, and one without any.
    with create(folder / "gedi_bad_shots.h5") as file:
        beam = file.create_group("BEAM0110")
        beam["shot_number"] = np.arange(4, dtype="u8")
        beam["rx_sample_count"] = np.array([4, 9, 0, 4], "u2")
        beam["rx_sample_start_index"] = np.array([1, 5, 1, 0], "u8")
        beam["rxwaveform"] = np.arange(8, dtype="f4")
    with create(folder / "gedi_l2a.h5") as file:
        file["BEAM0101/rh"] = np.zeros((2, 101), "f4")
        file["BEAM0101/shot_number"] = np.arange(2, dtype="u8")
    with create(folder / "other.h5") as file:
        for letter in "abcdefghij":
            file[f"group_{letter}/values"] = [1.0]
    # Chunks without an index: all are allocated at the beginning.
    with create(folder / "gedi_implicit.h5", "v110") as file:
        gedi_beam(file.create_group("BEAM0101"), {}, {})
        del file["BEAM0101/rxwaveform"]
        data = np.concatenate([sample(i, np.arange(count(i))) for i in range(SHOTS)]).astype("f4")
        options = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        options.set_chunk((50,))
        options.set_obj_track_times(False)
        options.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
        space = h5py.h5s.create_simple(data.shape)
        made = h5py.h5d.create(file["BEAM0101"].id, b"rxwaveform", h5py.h5t.IEEE_F32LE, space, options)
        made.write(h5py.h5s.ALL, h5py.h5s.ALL, data)
    # A heap of links with several blocks.
    with create(folder / "many_links.h5", "latest") as file:
        for index in range(300):
            file.create_group(f"a_group_with_a_rather_long_name_{index:03}")
        gedi_beam(file.create_group("BEAM0101"), {}, {})


def refused(folder):
    """Makes files whose beams are refused."""

    def beam(name, **columns):
        with create(folder / f"refused_{name}.h5") as file:
            group = file.create_group("BEAM0101")
            sound = dict(shot_number=[5, 6], rx_sample_count=[2, 2], rx_sample_start_index=[1, 3], rxwaveform=[0.5] * 4)
            for key, value in {**sound, **columns}.items():
                if isinstance(value, dict):
                    group.create_dataset(key, **value)
                elif value is not None:
                    group[key] = value

    with create(folder / "twice.h5") as file:
        gedi_beam(file.create_group("BEAM0101"), {}, {})
        file.create_group("BEAM0110")
    beam("counts", delta_time=[1.0, 2.0, 3.0])
    beam("negative", shot_number=[5, -6])
    beam("start_missing", rx_sample_count=[2, -1], rx_sample_start_index=None)
    beam("epoch", **{"ancillary/master_time_epoch": np.zeros(0)})
    many = 20_000_000
    beam("shots", shot_number=dict(shape=(many,), dtype="u8"))
    # Nothing is stored in these chunks of 64 MB.
    rows = 8 << 20
    column = dict(shape=(rows,), dtype="f8", chunks=(rows,))
    names = ["delta_time", "noise_mean_corrected", "noise_stddev_corrected", "rx_energy"]
    places = [f"geolocation/{of}_bin0" for of in ("longitude", "latitude", "elevation")]
    columns = dict.fromkeys(["shot_number", "rx_sample_count", "rx_sample_start_index", *names, *places], column)
    beam("kept", **columns)
    with create(folder / "refused_no_waveforms.h5") as file:
        file["BEAM0101/shot_number"] = [1]
    with create(folder / "refused_beams.h5", "latest") as file:
        for number in range(65):
            file[f"BEAM{number}"] = file["/"]
    with create(folder / "refused_lvis_part.h5") as file:
        file["SHOTNUMBER"] = [1]
    with create(folder / "refused_lvis_long.h5") as file:
        file["SHOTNUMBER"] = [1]
        file["Z0"] = [1.0]
        file.create_dataset("RXWAVE", (1, 70_000), "u2")


def odd(folder):
    """Makes data sets that are refused, and some that are not."""
    with create(folder / "odd_data_sets.h5", "v110") as file:
        file["text"] = np.array([b"text"])
        file["compound"] = np.zeros(2, [("a", "u1"), ("b", "f4")])
        file["half"] = np.zeros(2, "f2")
        file["volume"] = np.zeros((2, 2, 2))
        file["shared_type"] = np.dtype("f4")
        file.create_dataset("of_shared_type", data=np.zeros(2), dtype=file["shared_type"])
        file.create_dataset("lzf", data=np.zeros(9), chunks=(9,), compression="lzf")
        file.create_dataset("large_chunks", (1,), "f4", chunks=(20_000_000,), maxshape=(None,))
        file.create_dataset("wide", (1000, 20_000), "f4", chunks=(1000, 100))
        file.create_dataset("sideways", data=np.zeros((4, 3)), chunks=(4, 2), maxshape=(4, None))
        file.create_dataset("external", (4,), "f4", external=[("other.bin", 0, 16)])
        layout = h5py.VirtualLayout((4,), "f4")
        layout[:] = h5py.VirtualSource(".", "source", (4,))
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("edges", data=np.arange(7, dtype="f4"), chunks=(4,), compression="gzip")
        for kind in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"):
            for order in "<>":
                name = f"number_{order}{kind}".replace("<", "l").replace(">", "b")
                sign = 0 if kind[0] == "u" else -7
                file[name] = np.array([sign, 100, 3], order + kind)
        file["fractions"] = [0.5, -1.0, 3.0]


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    make(Path(sys.argv[1]))
