"""Units and systems of LAS 1.2, which has GeoTIFF keys alone, as laspy reads them and pyproj projects them."""

import laspy
import numpy as np
import pyproj

# GeoTIFF 1.0, sections 2.4, 6.2 and 6.3.
MODEL_TYPE, GEOGRAPHIC, PROJECTED, METHOD, LINEAR_UNITS, VERTICAL_UNITS = 1024, 2048, 3072, 3075, 3076, 4099
USER_DEFINED, TRANSVERSE_MERCATOR = 32767, 1
LONGITUDE, LATITUDE, EASTING, NORTHING, SCALE = 3080, 3081, 3082, 3083, 3092
METRE, FOOT, US_FOOT = 9001, 9002, 9003
METRES = {METRE: 1.0, FOOT: 0.3048, US_FOOT: 1200 / 3937}
# Lines of `[job.geometry]`, and the keys that must be there.
SYSTEMS = {
    "crs = 'EPSG:2225'": {MODEL_TYPE: 1, PROJECTED: 2225, LINEAR_UNITS: US_FOOT, VERTICAL_UNITS: US_FOOT},
    "crs = 'EPSG:2994'": {MODEL_TYPE: 1, PROJECTED: 2994, LINEAR_UNITS: FOOT, VERTICAL_UNITS: FOOT},
    "crs = 'utm:10N'\nunit = 'ft'": {
        MODEL_TYPE: 1, GEOGRAPHIC: 4326, PROJECTED: USER_DEFINED, METHOD: TRANSVERSE_MERCATOR,
        LINEAR_UNITS: FOOT, VERTICAL_UNITS: FOOT,
    },
    "crs = 'utm:10N'": {MODEL_TYPE: 1, PROJECTED: 32610, LINEAR_UNITS: METRE, VERTICAL_UNITS: METRE},
    "crs = 'ecef'": {MODEL_TYPE: 3, GEOGRAPHIC: 4978, LINEAR_UNITS: METRE},
}
# Half a step of coordinates, and of longitudes and latitudes in degrees, both in metres.
ALLOWED_M = 5e-4 + 1e-3


def check_units(checks, path, keys, geodetic):
    """A LAS 1.2 file with these keys, whose points lie at these longitudes, latitudes and heights (degrees, m)."""
    las = laspy.read(path)
    checks.equal("is version 1.2", str(las.header.version), "1.2")
    found, doubles = read_keys(las)
    checks.equal("has the keys of its system", {key: found.get(key) for key in keys}, keys)
    checks.equal("has a unit of heights where it has heights", VERTICAL_UNITS in found, VERTICAL_UNITS in keys)
    crs = system(found, doubles, las)
    units = [axis.unit_conversion_factor for axis in crs.axis_info]
    checks.within("the system's axes have the unit of the key", units, [METRES[keys[LINEAR_UNITS]]] * len(units), 1e-12)
    to_metres = METRES[keys[LINEAR_UNITS]]
    points = np.column_stack([las.x, las.y, las.z]) * to_metres
    checks.within("points lie where pyproj projects them, m", points, projected(crs, geodetic, keys, to_metres), ALLOWED_M)


def read_keys(las):
    """The keys of the file by number, and its doubles."""
    records = {vlr.record_id: vlr for vlr in las.header.vlrs if vlr.user_id == "LASF_Projection"}
    doubles = np.frombuffer(records[34736].record_data_bytes(), dtype="<f8") if 34736 in records else np.zeros(0)
    return {key.id: key.value_offset for key in records[34735].geo_keys}, doubles


def system(keys, doubles, las):
    """The file's system: by its code, or by the parameters that the keys hold."""
    if keys.get(PROJECTED) != USER_DEFINED:
        return las.header.parse_crs()
    value = {key: float(doubles[keys[key]]) for key in (LONGITUDE, LATITUDE, EASTING, NORTHING, SCALE)}
    metres = METRES[keys[LINEAR_UNITS]]
    return pyproj.CRS.from_proj4(
        f"+proj=tmerc +lon_0={value[LONGITUDE]!r} +lat_0={value[LATITUDE]!r} +k={value[SCALE]!r} "
        f"+x_0={value[EASTING] * metres!r} +y_0={value[NORTHING] * metres!r} +datum=WGS84 +to_meter={metres!r}")


def projected(crs, geodetic, keys, to_metres):
    """Coordinates in metres; the datum is not shifted."""
    longitude, latitude, height_m = geodetic.T
    if keys[MODEL_TYPE] == 3:
        project = pyproj.Transformer.from_crs("EPSG:4979", crs, always_xy=True)
        return np.column_stack(project.transform(longitude, latitude, height_m))
    horizontal = crs.to_2d()
    project = pyproj.Transformer.from_crs(horizontal.geodetic_crs, horizontal, always_xy=True)
    x, y = project.transform(longitude, latitude)
    return np.column_stack([x * to_metres, y * to_metres, height_m])
