"""Opens the Parquet table of returns as GeoParquet with GeoPandas and with DuckDB's spatial extension."""

import json
from importlib import resources

import duckdb
import geopandas
import numpy as np
import pyarrow.parquet
import pyproj

from checks import numbers


def check_geoparquet(checks, path, table, wkt):
    """`table` is the table of returns, `wkt` the coordinate reference system of its points."""
    file = pyarrow.parquet.ParquetFile(path)
    geo = json.loads(file.metadata.metadata[b"geo"])
    about = geo["columns"][geo["primary_column"]]
    found = (geo["version"], geo["primary_column"], about["encoding"], about["geometry_types"])
    checks.equal("is GeoParquet 1.1 with points", found, ("1.1.0", "geometry", "WKB", ["Point Z"]))
    xyz = np.stack([numbers(table, axis) for axis in "xyz"], axis=1)
    checks.within("has the box of its points", about["bbox"], np.concatenate([xyz.min(axis=0), xyz.max(axis=0)]), 0)
    check_fields(checks, file, table)
    points = geopandas.read_parquet(path)
    for axis, column in zip("xyz", xyz.T):
        checks.within(f"GeoPandas reads {axis}", getattr(points.geometry, axis), column, 0)
    # PROJ finds no code for the names of some recordings; then the places must agree.
    code = pyproj.CRS(wkt).to_epsg() if wkt else None
    if wkt and code is None and points.crs is not None:
        systems = (points.crs, pyproj.CRS(wkt).to_2d())
        place, same = (pyproj.Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(*xyz[0, :2]) for crs in systems)
        checks.within("GeoPandas knows the coordinate reference system", place, same, 1e-9)
    else:
        checks.equal("GeoPandas knows the coordinate reference system", points.crs and points.crs.to_epsg(), code)
    check_duckdb(checks, path, xyz)


def check_fields(checks, file, table):
    names = table.schema.names
    without = [name for name in names if not (table.schema.field(name).metadata or {}).get(b"description")]
    checks.equal("columns have descriptions", without, [])
    units = {name: (file.schema_arrow.field(name).metadata or {}).get(b"unit") for name in names}
    expected = {"range_sd_m": b"m", "fwhm_ns": b"ns", "amplitude_db": b"dB", "gps_time_s": b"s", "flags": None}
    checks.equal("columns have units", {name: units[name] for name in expected}, expected)


def check_duckdb(checks, path, xyz):
    database = duckdb.connect()
    # The order of floats is IEEE 754's total order, which pyarrow does not use yet.
    query = f"select min(stats_min_value::double), max(stats_max_value::double) from parquet_metadata('{path}') where path_in_schema = 'x'"
    checks.within("row groups have statistics of x", database.execute(query).fetchone(), [xyz[:, 0].min(), xyz[:, 0].max()], 0)
    # The package contains the extension that DuckDB would fetch.
    (extension,) = resources.files("duckdb_extension_spatial").glob("extensions/*/spatial.duckdb_extension")
    database.execute(f"load '{extension}'")
    query = f"select count(*), min(st_x(geometry)), max(st_y(geometry)) from read_parquet('{path}')"
    found = database.execute(query).fetchone()
    checks.within("DuckDB reads points", found, [len(xyz), xyz[:, 0].min(), xyz[:, 1].max()], 0)
