"""Checks LAZ and its spatial index with LASzip, the reference library, from the package `laszip`."""

import ctypes
import struct

import laspy
import laszip
import numpy as np

from checks import same_bytes

# Types of the library, see laszip_api.h.
INT, DOUBLE = ctypes.c_int32, ctypes.c_double
RECTANGLES = [(0.0, 0.0, 1.0, 1.0), (0.4, 0.4, 0.6, 0.6), (0.0, 0.7, 0.2, 1.0), (0.9, 0.0, 1.0, 0.05)]


def check_laszip(checks, path, las, index=None):
    """Checks a file; `las` is the result of another reader, `index` the location of the spatial index: "file" or "appended"."""
    if path.suffix == ".laz":
        laz = laspy.read(path, laz_backend=laspy.LazBackend.Laszip)
        checks.that("LASzip reads the same points", same_bytes(laz.points.array, las.points.array))
    if index is None:
        return
    if index == "appended":
        # The C interface finds only an index in a separate file; LAStools also finds an appended one.
        path.with_suffix(".lax").write_bytes(appended_index(checks, path))
    with Reader(path) as reader:
        checks.that("LASzip finds the index", reader.has_index())
    low, high = las.xyz[:, :2].min(axis=0), las.xyz[:, :2].max(axis=0)
    for number, (left, bottom, right, top) in enumerate(RECTANGLES):
        (x0, y0), (x1, y1) = low + (high - low) * [left, bottom], low + (high - low) * [right, top] + 1e-3
        xy = las.xyz[:, :2]
        inside = (xy[:, 0] >= x0) & (xy[:, 0] < x1) & (xy[:, 1] >= y0) & (xy[:, 1] < y1)
        with Reader(path) as reader:
            found = reader.inside(x0, y0, x1, y1)
        expected = las.xyz[inside]
        same = found.shape == expected.shape and np.allclose(found, expected, rtol=0, atol=1e-6)
        checks.that(f"the index leads to all points of rectangle {number}", same, f"{len(found)} of {len(expected)}")


def appended_index(checks, path):
    """The appended index, found through the LASzip VLR as LAStools do."""
    laz = path.read_bytes()
    # The VLR header has 54 bytes, with the name after the first two; 16 bytes of the data come first.
    number, at = struct.unpack_from("<qq", laz, laz.index(b"laszip encoded\0") - 2 + 54 + 16)
    record = laz[at:]
    user, record_id, length = record[2:18].rstrip(b"\0"), *struct.unpack_from("<HQ", record, 18)
    found = (number, user, record_id, length)
    checks.equal("the LASzip record leads to the index", found, (1, b"LAStools", 30, len(record) - 60))
    return record[60:]


class Reader:
    """A file read through the C interface of LASzip with its spatial index."""

    library = ctypes.CDLL(laszip.laszip_core.__file__)

    def __init__(self, path):
        self.handle = ctypes.c_void_p()
        if self.library.laszip_create(ctypes.byref(self.handle)) != 0:
            raise RuntimeError("LASzip cannot be started")
        self.call("exploit_spatial_index", INT(1))
        self.call("open_reader", str(path).encode(), ctypes.byref(INT()))

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.call("close_reader")
        self.call("destroy")

    def call(self, name, *arguments):
        if getattr(self.library, f"laszip_{name}")(self.handle, *arguments) != 0:
            said = ctypes.c_char_p()
            self.library.laszip_get_error(self.handle, ctypes.byref(said))
            raise RuntimeError(f"LASzip, {name}: {(said.value or b'').decode()}")

    def has_index(self):
        found, appended = INT(), INT()
        self.call("has_spatial_index", ctypes.byref(found), ctypes.byref(appended))
        return bool(found.value)

    def inside(self, x0, y0, x1, y1):
        """Coordinates of the points inside an area, in file order."""
        empty, done, place, points = INT(), INT(), (DOUBLE * 3)(), []
        self.call("inside_rectangle", DOUBLE(x0), DOUBLE(y0), DOUBLE(x1), DOUBLE(y1), ctypes.byref(empty))
        while not empty.value:
            self.call("read_inside_point", ctypes.byref(done))
            if done.value:
                break
            self.call("get_coordinates", place)
            points.append(tuple(place))
        return np.array(points).reshape(-1, 3)
