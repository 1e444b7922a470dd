"""Rasters and JSON of a survey, as rasterio reads them and numpy computes them from the points."""

import json

import jsonschema
import laspy
import numpy as np
import rasterio

from read_container import SCHEMAS

LAYERS = ["pulse_density", "point_density", "strips", "height_difference", "roughness"]
NO_DATA = -9999.0
# Coordinates in LAS are rounded to 1 mm, which moves one point of 4000 to the neighbouring cell of 2 m.
NEARLY_ALL = 0.98


def check_rasters(checks, folder, stem):
    """A survey `job_survey` of the strip whose points are in `STEM.las`."""
    survey = json.loads((folder / "job_survey.json").read_text())
    schema = json.loads((SCHEMAS / "survey.schema.json").read_text())
    checks.equal("the JSON fits its schema", [e.message for e in jsonschema.Draft202012Validator(schema).iter_errors(survey)], [])
    checks.equal("names its rasters", survey["rasters"], [f"job_survey_{layer}.tif" for layer in LAYERS])
    las = laspy.read(folder / f"{stem}.las")
    kept = ~np.asarray(las.withheld, dtype=bool)
    points, number, of = las.xyz[kept], np.asarray(las.return_number)[kept], np.asarray(las.number_of_returns)[kept]
    for layer in LAYERS:
        check_layout(checks, folder / f"job_survey_{layer}.tif", survey)
    first, first_grid = read(folder / "job_survey_pulse_density.tif")
    expected = counted(points[number == 1], *first_grid, points, first.shape)
    checks.that("pulse density is that of the first returns", share_of_equal(first, expected) > NEARLY_ALL)
    every, grid = read(folder / "job_survey_point_density.tif")
    expected = counted(points, *grid, points, every.shape)
    checks.that("point density is that of the points", share_of_equal(every, expected) > NEARLY_ALL)
    own, own_grid = read(folder / f"{stem}_pulse_density.tif")
    checks.equal("the strip's raster has the same grid", own_grid, first_grid)
    checks.within("the strip's raster has the same density", own, first, 0.0)
    rough, grid = read(folder / "job_survey_roughness.tif")
    found, expected = roughness(points[of == 1], rough, *grid)
    checks.that("has smooth cells", len(found) > 20, len(found))
    checks.within("roughness is that of a plane by least squares, m", found, expected, 2e-3)


def check_layout(checks, path, survey):
    with rasterio.open(path) as raster:
        name = path.name
        checks.equal(f"{name}: is in its system", raster.crs.to_epsg(), 32633)
        checks.equal(f"{name}: has tiles", raster.block_shapes, [(256, 256)])
        west, south, east, north = survey["extent"]
        checks.within(f"{name}: lies where the survey lies", raster.bounds, [west, south, east, north], 1e-9)
        checks.equal(f"{name}: has a value for no data", raster.nodata, NO_DATA)
        levels = raster.overviews(1)
        halved = max(raster.shape)
        expected = []
        while halved > 256:
            halved = -(-halved // 2)
            expected.append(2 ** (len(expected) + 1))
        checks.equal(f"{name}: has overviews down to a tile", levels, expected)
        if levels:
            values = raster.read(1, masked=True)
            rows, columns = (-(-size // 2) for size in raster.shape)
            with rasterio.open(path, OVERVIEW_LEVEL=0) as overview:
                half = overview.read(1, masked=True)
            padded = np.ma.masked_all((2 * rows, 2 * columns))
            padded[: raster.height, : raster.width] = values
            means = padded.reshape(rows, 2, columns, 2).mean(axis=(1, 3))
            checks.within(f"{name}: overviews are means", half.filled(NO_DATA), means.filled(NO_DATA), 1e-4)


def read(path):
    """Values, and west edge, north edge and cell size."""
    with rasterio.open(path) as raster:
        transform = raster.transform
        return raster.read(1).astype(np.float64), (transform.c, transform.f, transform.a)


def places(points, west, north, cell):
    # A point on an edge belongs to the cell north and east of it.
    rows = np.round(north / cell) - 1 - np.floor(points[:, 1] / cell + 1e-9)
    columns = np.floor(points[:, 0] / cell + 1e-9) - np.round(west / cell)
    return rows.astype(int), columns.astype(int)


def counted(points, west, north, cell, covered, shape):
    """Points per square metre, with no data where no point is."""
    def of(points):
        rows, columns = places(points, west, north, cell)
        inside = (rows >= 0) & (rows < shape[0]) & (columns >= 0) & (columns < shape[1])
        counts = np.zeros(shape)
        np.add.at(counts, (rows[inside], columns[inside]), 1.0)
        return counts
    return np.where(of(covered) > 0, of(points) / cell**2, NO_DATA)


def share_of_equal(found, expected):
    return np.mean(np.abs(found - expected) < 1e-6)


def roughness(points, raster, west, north, cell):
    """Roughness in the raster and by least squares, of some smooth cells."""
    rows, columns = places(points, west, north, cell)
    found, expected = [], []
    for row, column in list(zip(*np.nonzero(raster > NO_DATA)))[::7]:
        own = points[(rows == row) & (columns == column)]
        design = np.column_stack([np.ones(len(own)), own[:, :2] - own[:, :2].mean(axis=0)])
        left = own[:, 2] - design @ np.linalg.lstsq(design, own[:, 2], rcond=None)[0]
        found.append(raster[row, column])
        expected.append(np.sqrt(np.sum(left**2) / (len(own) - 3)))
    return found, expected
