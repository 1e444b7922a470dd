"""Compares coordinates and WKT printed by `examples/project.rs` with PROJ.

    target/venv/bin/python tests/python/check_crs.py target/debug/examples/project

Prints a line per check; exit code 1 if one fails.
"""

import math
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from pyproj import CRS, Transformer

from checks import Checks

# Tolerance of easting, northing and their inverse against PROJ, m.
ALLOWED_M = 1e-6
# Tolerance for systems whose inverse in proj4rs stops the latitude iteration earlier, m.
ALLOWED_INVERSE_M = {3078: 1e-5, 3832: 1e-5}
EARTH_M = 6378137.0
US_FOOT = 1200 / 3937
# Code of EPSG, and the box where the projection is compared: west, south, east, north, degrees. Those of UTM reach 6
# degrees beyond the edges of the zone.
SYSTEMS = {
    32601: (-186, 0, -168, 84),
    32633: (6, -2, 24, 84),
    32756: (144, -80, 162, 2),
    25832: (0, 30, 18, 84),
    26910: (-132, 10, -114, 84),
    2193: (166, -48, 179, -34),     # New Zealand, transverse Mercator
    6576: (-103, 32, -93, 35),      # Texas in US survey feet, Lambert
    2225: (-125, 39, -119, 43),     # California in US survey feet, Lambert
    2223: (-115, 30, -111, 38),     # Arizona in international feet, transverse Mercator
    2913: (-125, 41, -116, 45),     # Oregon in international feet, Lambert
    2154: (-10, 41, 10, 52),        # France, Lambert
    3112: (112, -44, 154, -9),      # Australia, Lambert in the south
    3448: (-79, 17, -76, 19),       # Jamaica, Lambert with one parallel
    3035: (-16, 33, 40, 84),        # Europe, equal area, by proj4rs
    3031: (-180, -90, 180, -60),    # Antarctica, stereographic, by proj4rs
    5880: (-74, -35, -28, 7),       # Brazil, polyconic, by proj4rs
    3078: (-91, 41, -82, 49),       # Michigan, oblique Mercator (variant A), by proj4rs
    3832: (98, -60, 230, 66),       # Pacific, Mercator, by proj4rs
    2953: (-70, 44, -63, 49),       # New Brunswick, oblique stereographic, by proj4rs
}


class Program:
    def __init__(self, path):
        self.path = str(path)

    def ask(self, system, action, points, *options):
        text = "".join(" ".join(repr(float(value)) for value in point) + "\n" for point in points)
        done = subprocess.run([self.path, system, action, *options], input=text, capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(done.stderr)
        return np.array([[float(value) for value in line.split()] for line in done.stdout.splitlines()])

    def wkt(self, system, *options):
        return subprocess.run([self.path, system, "wkt", *options], capture_output=True, text=True, check=True).stdout


def places(box, count=400):
    west, south, east, north = box
    rng = np.random.default_rng(7)
    longitude = (rng.uniform(west, east, count) + 180) % 360 - 180
    return np.column_stack([longitude, rng.uniform(south, north, count), rng.uniform(-50, 5000, count)])


def of_proj(system):
    """PROJ transformation from the system's own longitude and latitude, without a datum shift."""
    horizontal = system.sub_crs_list[0] if system.is_compound else system.to_2d()
    return Transformer.from_crs(horizontal.geodetic_crs, horizontal, always_xy=True)


def largest(differences):
    return float(np.max(np.abs(differences)))


def on_ground(found, expected):
    """Differences of longitude and latitude, m."""
    turns = (found[:, 0] - expected[:, 0] + 180) % 360 - 180
    east = np.radians(turns) * np.cos(np.radians(expected[:, 1])) * EARTH_M
    return largest([east, np.radians(found[:, 1] - expected[:, 1]) * EARTH_M])


def check_projections(checks, program):
    for code, box in SYSTEMS.items():
        system = CRS.from_epsg(code)
        unit_m = system.axis_info[0].unit_conversion_factor
        points = places(box)
        with checks.of(f"EPSG:{code} {system.name}"):
            found = program.ask(f"EPSG:{code}", "forward", points)
            x, y = of_proj(system).transform(points[:, 0], points[:, 1])
            apart = largest([found[:, 0] - x, found[:, 1] - y]) * unit_m
            checks.that(f"projects as PROJ ({apart:.1e} m)", apart <= ALLOWED_M)
            apart = largest(found[:, 2] * unit_m - points[:, 2])
            checks.that(f"keeps heights in its unit ({apart:.1e} m)", apart <= 1e-9)
            back = program.ask(f"EPSG:{code}", "inverse", np.column_stack([x, y, found[:, 2]]))
            apart = on_ground(back, points)
            allowed_m = ALLOWED_INVERSE_M.get(code, ALLOWED_M)
            checks.that(f"comes back from PROJ's coordinates ({apart:.1e} m)", apart <= allowed_m)
            check_wkt(checks, program, f"EPSG:{code}", system, points)


def check_wkt(checks, program, name, system, points):
    """Checks that PROJ reads the WKT as the same system, by definition and by coordinates."""
    for unit, metres in [(None, system.axis_info[0].unit_conversion_factor), ("us_ft", US_FOOT), ("m", 1.0)]:
        options = [f"unit={unit}"] if unit else []
        written = CRS.from_wkt(program.wkt(name, *options))
        if unit is None and metres == 1.0:
            # Systems with another axis order in EPSG differ in the axes only.
            in_order = system.axis_info[0].direction == "east"
            pair = (written, system) if in_order else (written.geodetic_crs, system.geodetic_crs)
            checks.that("writes a WKT that PROJ takes for the system", pair[0].equals(pair[1], ignore_axis_order=True))
        else:
            factors = {axis.unit_conversion_factor for axis in written.axis_info}
            checks.that(f"has three axes in {unit or 'its unit'}", len(factors) == 1
                        and abs(factors.pop() / metres - 1) < 1e-12
                        and (metres == 1.0 or len(written.axis_info) == 3))
        found = program.ask(name, "forward", points, *options)
        x, y = of_proj(written).transform(points[:, 0], points[:, 1])
        apart = largest([found[:, 0] - x, found[:, 1] - y]) * metres
        checks.that(f"has its coordinates by that WKT in {unit or 'its unit'} ({apart:.1e} m)", apart <= ALLOWED_M)


def check_dialects(checks, program):
    """Checks a system given as a file in any WKT dialect."""
    for code in [32633, 2193, 2154, 6576, 2913, 3035, 5070, 5880, 3078, 3832, 2953]:
        system = CRS.from_epsg(code)
        unit_m = system.axis_info[0].unit_conversion_factor
        area = system.area_of_use
        # The area of use may cross the antimeridian.
        east = area.east + 360 * (area.east < area.west)
        points = places((area.west, max(area.south, -80), east, min(area.north, 84)))
        x, y = of_proj(system).transform(points[:, 0], points[:, 1])
        for dialect in ["WKT1_GDAL", "WKT1_ESRI", "WKT2_2015", "WKT2_2019"]:
            with checks.of(f"EPSG:{code} as {dialect}"), tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "system.wkt"
                path.write_text(system.to_wkt(dialect, pretty=True))
                found = program.ask(path, "forward", points)
                apart = largest([found[:, 0] - x, found[:, 1] - y]) * unit_m
                checks.that(f"projects as PROJ ({apart:.1e} m)", apart <= ALLOWED_M)
                written = CRS.from_wkt(program.wkt(path))
                x_2, y_2 = of_proj(written).transform(points[:, 0], points[:, 1])
                apart = largest([x_2 - x, y_2 - y]) * unit_m
                checks.that(f"is written as the same system ({apart:.1e} m)", apart <= ALLOWED_M)


def check_earth_centred(checks, program):
    """Checks points in the local frame of a sensor against PROJ: topocentric to UTM, Lambert and geodetic."""
    rng = np.random.default_rng(11)
    offsets = rng.uniform(-2000, 2000, (300, 3))
    for name, longitude, latitude in [("utm:33N", 12.6, 47.8), ("utm:56S", 151.2, -33.9), ("EPSG:2154", 5.5, 45.2),
                                      ("geodetic", -179.99, 71.0)]:
        frame = f"+proj=topocentric +ellps=WGS84 +lon_0={longitude} +lat_0={latitude} +h_0=1500"
        local = Transformer.from_pipeline(frame)
        ecef = np.column_stack(local.transform(*offsets.T, direction="INVERSE"))
        with checks.of(f"{name} from the earth-centred frame"):
            found = program.ask(name, "ecef", ecef)
            again = np.column_stack(local.transform(*program.ask("ecef", "forward", program.ask("geodetic", "ecef", ecef)).T))
            apart = largest(again - offsets)
            checks.that(f"comes back to the horizon's frame ({apart:.1e} m)", apart <= ALLOWED_M)
            ellipsoid = "GRS80" if name.startswith("EPSG") else "WGS84"
            geodetic = np.column_stack(Transformer.from_pipeline(f"+proj=cart +ellps={ellipsoid}").transform(
                *ecef.T, direction="INVERSE"))
            if name == "geodetic":
                apart = on_ground(found, geodetic)
            else:
                code = {"utm:33N": 32633, "utm:56S": 32756}.get(name) or int(name[5:])
                x, y = of_proj(CRS.from_epsg(code)).transform(geodetic[:, 0], geodetic[:, 1])
                apart = largest([found[:, 0] - x, found[:, 1] - y])
            checks.that(f"is where PROJ puts it ({apart:.1e} m)", apart <= ALLOWED_M)
            apart = largest(found[:, 2] - geodetic[:, 2])
            checks.that(f"is as high as PROJ says ({apart:.1e} m)", apart <= ALLOWED_M)


def write_geoid(folder, name):
    """Writes a synthetic global geoid with a step of 10 degrees in VDatum format."""
    latitude, longitude = np.meshgrid(np.arange(-90, 91, 10), np.arange(0, 360, 10), indexing="ij")
    heights = 50 * np.sin(np.radians(latitude)) * np.cos(np.radians(longitude)) + 7
    header = np.array([-90, 0, 10, 10], ">f8").tobytes() + np.array(heights.shape, ">i4").tobytes()
    (folder / f"{name}.gtx").write_bytes(header + heights.astype(">f4").tobytes())


def check_geoids(checks, program):
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        write_geoid(folder, "EGM96")
        options = ["geoid=egm96", f"geoid_dir={folder}"]
        points = places((-180, -89, 180, 89))
        shift = Transformer.from_pipeline(f"+proj=vgridshift +grids={folder / 'EGM96.gtx'} +multiplier=1")
        with checks.of("a geoid"):
            found = program.ask("geodetic", "forward", points, *options)
            # PROJ expects radians, and shifts from heights above the geoid.
            zeros = np.zeros(len(points))
            _, _, undulation = shift.transform(points[:, 0], points[:, 1], zeros, radians=False)
            apart = largest(points[:, 2] - np.abs(undulation) * np.sign(undulation) - found[:, 2])
            checks.that(f"gives PROJ's heights ({apart:.1e} m)", apart <= 1e-5)
        for system, unit, code, name in [("utm:33N", "m", 5773, "EGM96 height"), ("EPSG:2154", "us_ft", None, "EGM96 height")]:
            with checks.of(f"the WKT of {system} over a geoid"):
                written = CRS.from_wkt(program.wkt(system, *options, f"unit={unit}"))
                checks.that("is compound", written.is_compound)
                vertical = written.sub_crs_list[1]
                checks.equal("names its heights", vertical.name, name)
                checks.equal("has the code of its heights", vertical.to_epsg(min_confidence=100) if code else None, code)
                factor = vertical.axis_info[0].unit_conversion_factor
                checks.that("has their unit", math.isclose(factor, US_FOOT if unit == "us_ft" else 1.0, rel_tol=1e-12))


def main():
    program = Program(sys.argv[1])
    checks = Checks()
    check_projections(checks, program)
    check_dialects(checks, program)
    check_earth_centred(checks, program)
    check_geoids(checks, program)
    return checks.end()


if __name__ == "__main__":
    sys.exit(main())
