"""Checks STAC items with pystac, and against the points that laspy reads.

The core is validated by the schemas that pystac contains. Those of the extensions are on the network only: their
fields are read by pystac's classes and compared with the points.
"""

import json
from datetime import datetime, timedelta, timezone

import numpy as np
import pyproj
import pystac
from pystac.extensions.pointcloud import PointcloudExtension
from pystac.extensions.projection import ProjectionExtension
from pystac.validation.local_validator import LocalValidator

MEDIA = {"LAZ": "application/vnd.laszip", "COPC": "application/vnd.laszip+copc"}
SIZES = {"floating": (4, 8), "unsigned": (1, 2, 4, 8), "signed": (1, 2, 4, 8)}


def check_stac(checks, path, las, encoding, name):
    """`las` is the file `name` as read by laspy. Recordings without a date have no item."""
    if not path.exists():
        checks.that("has an item, or times without a date", las.header.global_encoding.gps_time_type == 0)
        return
    text = path.read_text()
    stored = json.loads(text)
    errors = [error.message for error in LocalValidator().item_validator().iter_errors(stored)]
    checks.equal("its item is valid STAC", errors, [])
    item = pystac.Item.from_dict(stored)
    # It writes the time without a zero fraction.
    again = item.to_dict(include_self_link=False)
    again["properties"]["datetime"] = stored["properties"]["datetime"]
    checks.that("pystac writes the item that it reads", again == stored)
    begin = pystac.utils.str_to_datetime(stored["properties"].get("start_datetime", stored["properties"]["datetime"]))
    checks.equal("datetime is the begin", item.datetime, begin)
    points, projection = PointcloudExtension.ext(item), ProjectionExtension.ext(item)
    found = (points.count, points.type, points.encoding, item.assets["data"].href, item.assets["data"].media_type)
    checks.equal("item counts and names the points", found, (len(las.points), "lidar", encoding, f"./{name}", MEDIA[encoding]))
    dimensions = [one.to_dict() for one in points.schemas]
    checks.equal("dimensions have sizes", [one for one in dimensions if one["size"] not in SIZES[one["type"]]], [])
    names = [one["name"] for one in dimensions]
    extra = list(las.header.point_format.extra_dimension_names)
    checks.equal("dimensions end with the extra attributes", names[len(names) - len(extra):], extra)
    bounds = np.concatenate([las.header.mins, las.header.maxs])
    checks.within("proj:bbox is that of the points", projection.bbox, bounds, 0)
    ranges = {one.to_dict()["name"]: one for one in points.statistics}
    times = [ranges["GpsTime"].minimum, ranges["GpsTime"].maximum]
    checks.within("times are those of the points", times, [np.min(las.gps_time), np.max(las.gps_time)], 0)
    if las.header.global_encoding.gps_time_type == 1:
        # 18 leap seconds since 2017.
        gps = datetime(1980, 1, 6, tzinfo=timezone.utc) + timedelta(seconds=1e9 + float(np.min(las.gps_time)) - 18.0)
        checks.that("datetime is UTC", gps.year >= 2017 and abs((item.datetime - gps).total_seconds()) < 1e-3, item.datetime)
    check_place(checks, item, projection, las)


def check_place(checks, item, projection, las):
    crs = las.header.parse_crs()
    if item.geometry is None:
        checks.that("has no place because the points have none that wavex can convert",
                    projection.code is None and item.bbox is None)
        return
    if projection.code:
        checks.equal("has the code of the system", projection.code.split(":")[1], str(crs.to_epsg()))
    if projection.projjson:
        checks.that("PROJ reads its system", pyproj.CRS.from_json_dict(projection.projjson).is_projected == crs.is_projected)
    place = pyproj.Transformer.from_crs(crs.to_2d(), "EPSG:4326", always_xy=True)
    west, south, east, north = item.bbox
    longitude, latitude = place.transform(las.x, las.y)
    tolerance = 2e-7
    inside = [west - tolerance <= longitude.min(), longitude.max() <= east + tolerance,
              south - tolerance <= latitude.min(), latitude.max() <= north + tolerance]
    checks.equal("the box on the earth has all points", inside, [True] * 4)
    corners = place.transform([las.header.mins[0], las.header.maxs[0]], [las.header.mins[1], las.header.maxs[1]])
    ring = np.array(item.geometry["coordinates"][0])
    checks.within("the outline has the corners of PROJ", [ring[0], ring[8]], np.stack(corners, axis=1), tolerance)
