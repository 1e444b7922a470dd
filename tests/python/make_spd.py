"""Makes the SPD files of `crates/wavex-hdf5/tests/data`, by the layouts of SPDLib (version 3) and pylidar (version 4).

A scanner 500 m above flat ground at a height of 100 m; every fifth pulse has a weaker echo 12 ns before the ground.
`truth` has the formulas that the tests in Rust repeat. The files are the same at each run.

usage: make_hdf5.py FOLDER
"""

import h5py
import numpy as np
from numpy.lib.recfunctions import repack_fields

PULSES = 400
LINE = 40
SAMPLES = 64
INTERVAL_NS = 1.0
# Speed of light in air of SPDLib: refractive index 1.000268008.
M_PER_NS = 0.5 * 0.299792458 / 1.000268008
GROUND_M = 100.0
WKT = (
    'PROJCS["WGS 84 / UTM zone 33N",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],'
    'PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],PROJECTION["Transverse_Mercator"],'
    'PARAMETER["latitude_of_origin",0],PARAMETER["central_meridian",15],PARAMETER["scale_factor",0.9996],'
    'PARAMETER["false_easting",500000],PARAMETER["false_northing",0],UNIT["metre",1],AUTHORITY["EPSG","32633"]]'
)
# Members of the records of pulses of version 2, in the order of SPDLib.
PULSE = [
    ("PULSE_ID", "<u8"),
    ("GPS_TIME", "<u8"),
    ("X_ORIGIN", "<f8"),
    ("Y_ORIGIN", "<f8"),
    ("Z_ORIGIN", "<f4"),
    ("H_ORIGIN", "<f4"),
    ("X_IDX", "<f8"),
    ("Y_IDX", "<f8"),
    ("AZIMUTH", "<f4"),
    ("ZENITH", "<f4"),
    ("NUMBER_OF_RETURNS", "u1"),
    ("NUMBER_OF_WAVEFORM_TRANSMITTED_BINS", "<u2"),
    ("NUMBER_OF_WAVEFORM_RECEIVED_BINS", "<u2"),
    ("RANGE_TO_WAVEFORM_START", "<f4"),
    ("AMPLITUDE_PULSE", "<f4"),
    ("WIDTH_PULSE", "<f4"),
    ("USER_FIELD", "<u4"),
    ("SOURCE_ID", "<u2"),
    ("SCANLINE", "<u4"),
    ("SCANLINE_IDX", "<u2"),
    ("RECEIVE_WAVE_NOISE_THRES", "<f4"),
    ("TRANS_WAVE_NOISE_THRES", "<f4"),
    ("WAVELENGTH", "<f4"),
    ("RECEIVE_WAVE_GAIN", "<f4"),
    ("RECEIVE_WAVE_OFFSET", "<f4"),
    ("TRANS_WAVE_GAIN", "<f4"),
    ("TRANS_WAVE_OFFSET", "<f4"),
    ("PTS_START_IDX", "<u8"),
    ("TRANSMITTED_START_IDX", "<u8"),
    ("RECEIVED_START_IDX", "<u8"),
]


def truth(pulses=PULSES):
    """Pulses with origin, angles as stored, time and range to the first sample, and samples."""
    i = np.arange(pulses)
    line, place = i // LINE, i % LINE
    scan = np.radians(-10 + 20 * place / (LINE - 1))
    found = np.zeros(pulses, PULSE)
    found["PULSE_ID"] = 1000 + i
    found["GPS_TIME"] = 100_000_000_000_000 + 10_000 * i
    found["X_ORIGIN"] = 500_000.0
    found["Y_ORIGIN"] = 5_400_000.0 + 0.5 * line
    found["Z_ORIGIN"] = 600.0
    # To the east for positive scan angles, else to the west; a little to the north.
    found["AZIMUTH"] = np.where(scan > 0, 0.5 * np.pi, 1.5 * np.pi) + np.where(scan > 0, -0.02, 0.02)
    found["ZENITH"] = np.pi - np.abs(scan)
    found["SCANLINE"] = line
    found["SCANLINE_IDX"] = place
    found["RECEIVE_WAVE_GAIN"] = found["TRANS_WAVE_GAIN"] = 1.0
    ground_m = (600.0 - GROUND_M) / -np.cos(found["ZENITH"].astype("f8"))
    # The ground is at samples 38 to 42.
    start_m = (ground_m - (38 + (i % 17) / 4) * INTERVAL_NS * M_PER_NS).astype("f4")
    found["RANGE_TO_WAVEFORM_START"] = start_m
    at = (ground_m - start_m.astype("f8")) / (M_PER_NS * INTERVAL_NS)
    found["NUMBER_OF_WAVEFORM_RECEIVED_BINS"] = SAMPLES
    found["NUMBER_OF_WAVEFORM_TRANSMITTED_BINS"] = 20
    found["RECEIVED_START_IDX"] = SAMPLES * i
    found["TRANSMITTED_START_IDX"] = 20 * i

    random = np.random.RandomState(7)
    sample = np.arange(SAMPLES)
    gauss = lambda at: np.exp(-0.5 * ((sample - at[:, None]) / 2.0) ** 2)
    received = 12 + (100 + i % 50)[:, None] * gauss(at) + np.where(i % 5 == 0, 60, 0)[:, None] * gauss(at - 12)
    received = np.round(received + 0.7 * random.randn(pulses, SAMPLES)).clip(0).astype("u2")
    pulse = 5 + 180 * np.exp(-0.5 * ((np.arange(20) - 8) / 1.9) ** 2)
    transmitted = np.round(pulse + 0.3 * random.randn(pulses, 20)).clip(0).astype("u2")
    return found, received, transmitted


def create(path, library=None):
    """Creates a file for readers of a version of HDF5, by default of the first."""
    return h5py.File(path, "w", libver="latest" if library else ("earliest", "v108"))


CHUNKS = dict(chunks=(250,), maxshape=(None,), compression="gzip", shuffle=True)


def version_3(path, pulses, received, transmitted, library=None, header=(), kind="u2", options=CHUNKS):
    """Makes a file of version 3; `header` replaces values of the header, or removes them with `None`."""
    values = {
        "VERSION_MAJOR_SPD": np.array([2], "u2"),
        "VERSION_MINOR_SPD": np.array([1], "u2"),
        "VERSION_PULSE": np.array([2], "u2"),
        "SENSOR_TEMPORAL_BIN_SPACING": np.array([INTERVAL_NS]),
        "DEFINED_ORIGIN": np.array([1], "i2"),
        "DEFINED_RECEIVE_WAVEFORM": np.array([1], "i2"),
        "WAVEFORM_BIT_RES": np.array([16], "u2"),
        "NUMBER_OF_PULSES": np.array([len(pulses)], "u8"),
        "SPATIAL_REFERENCE": WKT,
        **dict(header),
    }
    with create(path, library) as file:
        for name, value in values.items():
            if isinstance(value, str):
                text = h5py.string_dtype("ascii")
                file.create_dataset(f"HEADER/{name}", data=np.array([value], object), dtype=text)
            elif value is not None:
                file.create_dataset(f"HEADER/{name}", data=value)
        file.create_dataset("DATA/PULSES", data=pulses, **options)
        if received is not None:
            file.create_dataset("DATA/RECEIVED", data=received.ravel().astype(kind), **options)
            file.create_dataset("DATA/TRANSMITTED", data=transmitted.ravel().astype(kind), **options)
        file.create_group("INDEX")
        file.create_group("QUICKLOOK")


# Scaled values of version 4: stored steps per unit, and the value of 0.
SCALES = {
    "X_ORIGIN": (1000.0, 499_000.0),
    "Y_ORIGIN": (1000.0, 5_399_000.0),
    "Z_ORIGIN": (1000.0, 0.0),
    "AZIMUTH": (1e8, 0.0),
    "ZENITH": (1e8, 0.0),
    "RANGE_TO_WAVEFORM_START": (1e6, 0.0),
}


def scaled(group, name, data, options):
    """Writes a value with its scale."""
    gain, offset = SCALES[name]
    column = group.create_dataset(name, data=np.round((data - offset) * gain).astype("u4"), **options)
    column.attrs["GAIN"] = gain
    column.attrs["OFFSET"] = offset


def version_4(path, pulses, received, transmitted, library=None, attributes=(), edit=None, options=CHUNKS):
    """Makes a file of version 4; every tenth pulse has a second waveform, of channel 0 with twice the gain."""
    header = {
        "VERSION_SPD": np.array([4, 0], "u1"),
        "VERSION_DATA": np.array([1, 0], "u1"),
        "SENSOR_TEMPORAL_BIN_SPACING": np.float64(INTERVAL_NS),
        "SPATIAL_REFERENCE": np.bytes_(WKT.encode()),
        "GENERATING_SOFTWARE": "pylidar",
        "BLOCK_SIZE_PULSE": np.uint16(250),
        "NUMBER_OF_PULSES": np.uint64(len(pulses)),
        "INDEX_TYPE": np.uint16(0),
        "X_MIN": np.float64(499_900),
        "X_MAX": np.float64(500_100),
        **dict(attributes),
    }
    i = np.arange(len(pulses))
    counts = 1 + (i % 10 == 0)
    first = np.cumsum(counts) - counts
    owner = np.repeat(i, counts)
    second = np.arange(len(owner)) != first[owner]
    # Samples of a pulse follow each other; the second waveform has no transmitted samples of its own.
    samples = received[owner] * np.where(second, 2, 1)[:, None]
    with create(path, library) as file:
        for name, value in header.items():
            if value is not None:
                file.attrs[name] = value
        data = file.create_group("DATA")
        data.create_group("POINTS")
        group = data.create_group("PULSES")
        for name in ("PULSE_ID", "NUMBER_OF_RETURNS", "PTS_START_IDX", "SCANLINE", "SCANLINE_IDX"):
            group.create_dataset(name, data=pulses[name], **options)
        group.create_dataset("TIMESTAMP", data=pulses["GPS_TIME"], **options)
        group.create_dataset("NUMBER_OF_WAVEFORM_SAMPLES", data=counts.astype("u1"), **options)
        group.create_dataset("WFM_START_IDX", data=first.astype("u8"), **options)
        for name in ("X_ORIGIN", "Y_ORIGIN", "Z_ORIGIN", "AZIMUTH", "ZENITH"):
            scaled(group, name, pulses[name].astype("f8"), options)
        group = data.create_group("WAVEFORMS")
        scaled(group, "RANGE_TO_WAVEFORM_START", pulses["RANGE_TO_WAVEFORM_START"].astype("f8")[owner], options)
        columns = {
            "NUMBER_OF_WAVEFORM_RECEIVED_BINS": np.full(len(owner), SAMPLES, "u2"),
            "NUMBER_OF_WAVEFORM_TRANSMITTED_BINS": np.full(len(owner), 20, "u2"),
            "RECEIVED_START_IDX": SAMPLES * np.arange(len(owner), dtype="u8"),
            "TRANSMITTED_START_IDX": 20 * owner.astype("u8"),
            "CHANNEL": np.where(second, 0, 1).astype("u1"),
            "RECEIVE_WAVE_GAIN": np.where(second, 2, 1).astype("f4"),
            "RECEIVE_WAVE_OFFSET": np.zeros(len(owner), "f4"),
            "TRANS_WAVE_GAIN": np.ones(len(owner), "f4"),
            "TRANS_WAVE_OFFSET": np.zeros(len(owner), "f4"),
        }
        for name, column in columns.items():
            group.create_dataset(name, data=column, **options)
        data.create_dataset("RECEIVED", data=samples.ravel().astype("u4"), **options)
        data.create_dataset("TRANSMITTED", data=transmitted.ravel().astype("u4"), **options)
        if edit:
            edit(data)


def without(pulses, name):
    """Records without a member."""
    return repack_fields(pulses[[other for other in pulses.dtype.names if other != name]])


def make(folder):
    """Makes all files."""
    pulses, received, transmitted = truth()
    version_3(folder / "spd_3.spd", pulses, received, transmitted)
    version_4(folder / "spd_4.spd", pulses, received, transmitted)
    few = [part[:12] for part in (pulses, received, transmitted)]
    # Records of version 3 of the data type, 32-bit samples; attributes in a heap.
    version_3(folder / "spd_3_latest.spd", *few, library="latest", kind="u4")
    version_4(folder / "spd_4_latest.spd", *few, library="latest")

    plain = dict(options={}, kind="u4")
    # The second waveforms have a channel without a receiver.
    channels = lambda data: data["WAVEFORMS/CHANNEL"].__setitem__(slice(None), 5 - 4 * data["WAVEFORMS/CHANNEL"][()])
    version_4(folder / "spd_4_channel.spd", *few, edit=channels, options={})
    # A spatial index sorts pulses by place.
    order = np.argsort(np.arange(12) % 3, kind="stable")
    version_3(folder / "spd_3_sorted.spd", *(part[order] for part in few), **plain)
    bad, samples = few[0][:9].copy(), few[1][:9].astype("u4")
    bad["NUMBER_OF_WAVEFORM_RECEIVED_BINS"][1] = 0
    bad["RECEIVED_START_IDX"][2] = 1 << 40
    bad["AZIMUTH"][3] = np.nan
    bad["X_ORIGIN"][4] = np.inf
    samples[5, 3] = 70_000
    bad["RANGE_TO_WAVEFORM_START"][6] = np.nan
    bad["NUMBER_OF_WAVEFORM_TRANSMITTED_BINS"][7] = 500
    version_3(folder / "spd_bad.spd", bad, samples, few[2][:9], **plain)

    def refused(name, *, pulses=few[0], waveforms=few[1:], **options):
        version_3(folder / f"refused_spd_{name}.spd", pulses, *waveforms, **plain, **options)

    refused("version", header={"VERSION_MAJOR_SPD": np.array([1], "u2")})
    refused("no_version", header={"VERSION_MAJOR_SPD": None})
    refused("points", waveforms=(None, None))
    refused("zenith", pulses=without(few[0], "ZENITH"))
    refused("interval", header={"SENSOR_TEMPORAL_BIN_SPACING": np.array([0.0])})
    unlocated = few[0].copy()
    for name in ("X_ORIGIN", "Y_ORIGIN", "Z_ORIGIN", "RANGE_TO_WAVEFORM_START"):
        unlocated[name] = 0
    refused("origin", pulses=unlocated)
    refused("text", header={"SPATIAL_REFERENCE": np.array([1.0])})

    def refused_4(name, edit=None, **options):
        version_4(folder / f"refused_spd_4_{name}.spd", *few, edit=edit, options={}, **options)

    def replaced(name, values=None):
        def edit(data):
            del data[name]
            if values is not None:
                data[name] = values

        return edit

    refused_4("version", attributes={"VERSION_SPD": np.array([3, 0], "u1")})
    refused_4("no_version", attributes={"VERSION_SPD": None})
    refused_4("waveforms", replaced("WAVEFORMS"))
    refused_4("zenith", replaced("PULSES/ZENITH"))
    refused_4("rows", replaced("PULSES/ZENITH", [3.0] * 5))
    refused_4("gain", lambda data: data["PULSES/ZENITH"].attrs.__setitem__("GAIN", 0.0))
    refused_4("place", replaced("PULSES/WFM_START_IDX", [1 << 40] * 12))
    refused_4("many", replaced("PULSES/NUMBER_OF_WAVEFORM_SAMPLES", [300] * 12))
    refused_4("fraction", replaced("PULSES/SCANLINE", [0.5] * 12))
