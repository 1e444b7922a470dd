"""Runs the program and reads its outputs with other programs: pyarrow, DuckDB, laspy, LASzip, pyproj, rasterio, pystac,
and the npm package `copc` if WAVEX_NODE_COPC names the folder that has it in node_modules.

    python3 -m venv venv
    venv/bin/pip install -r tests/python/requirements.txt
    venv/bin/python tests/python/check_outputs.py target/release/wavex target/debug/examples/write_container

With WAVEX_DATA set to a folder of real recordings, those are checked as well. Prints a line per check; exit code 1 if
one fails.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import jsonschema
import laspy
import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

import read_container as made_up
from check_copc import check_copc
from check_geoparquet import check_geoparquet
from check_laszip import check_laszip
from check_packets import check_packets
from check_pdal import check_pdal
from check_points import check_points, check_same_points
from check_rasters import check_rasters
from check_relative_heights import check_relative_heights
from check_stac import check_stac
from check_text import COLUMNS, check_ascii, check_beams, check_flown, check_origins
from check_units import SYSTEMS, check_units
from check_waveforms import check_against_dump, check_container, check_same_waveforms, read_container, read_dump
from checks import Checks, numbers, same_column
from read_container import SCHEMAS, arrow_type, sql

SIMULATED = """
[[stage]]
type = "simulate"
stem = "flight"
lines = 5
shots_per_line = 200
"""
FLIGHT = """
[[stage]]
type = "simulate"
stem = "flown"
lines = 5
shots_per_line = 200
pulse_rate_hz = 1000.0
heading_deg = 340.0
roll_deg = 3.0
pitch_deg = 2.0
yaw_deg = 2.0
motion_period_s = 2.0
sbet = "*.sbet"

[[stage]]
type = "write_arrow"
"""
SURVEYED = """
[job]
survey_page = true

[[stage]]
type = "simulate"
stem = "strip"
landscape = "country"
lines = 650
shots_per_line = 150
pulse_rate_hz = 20000.0
speed_mps = 80.0
flying_height_m = 200.0
scan_angle_deg = [-20.0, 20.0]

[[stage]]
type = "calibrate"
waveforms = 2000

[[stage]]
type = "decompose"

[[stage]]
type = "georeference"

[[stage]]
type = "write_las"
path = "*.las"
"""
# Every sink, after any source of shots.
SINKS = """
[[stage]]
type = "write_arrow"

[[stage]]
type = "calibrate"
waveforms = 600

[[stage]]
type = "decompose"

[[stage]]
type = "filter_outliers"

[[stage]]
type = "georeference"

[[stage]]
type = "write_las"
id = "las"
path = "*.las"

[[stage]]
type = "write_las"
id = "laz"
path = "*.laz"
index = "file"
stac = true

[[stage]]
type = "write_las"
id = "las_1_2"
attribute_layout = "1.1"
path = "*_12.las"
version = "1.2"
index = "file"

[[stage]]
type = "write_las"
id = "laz_1_2"
attribute_layout = "1.1"
path = "*_12_appended.laz"
version = "1.2"
index = "appended"

[[stage]]
type = "write_las"
id = "layout_1_0"
path = "*_layout_10.laz"
attribute_layout = "1.0"
index = "appended"

[[stage]]
type = "write_las"
id = "waves_inside"
path = "*_waves.laz"
wave_packets = "internal"
index = "appended"

[[stage]]
type = "write_las"
id = "waves_beside"
attribute_layout = "1.1"
path = "*_waves_13.las"
version = "1.3"
wave_packets = "external"

[[stage]]
type = "write_las"
id = "laz_waves_beside"
attribute_layout = "1.1"
path = "*_waves_13_compressed.laz"
version = "1.3"
wave_packets = "external"

[[stage]]
type = "write_table"
id = "table_arrow"
path = "*_returns.arrow"

[[stage]]
type = "write_table"
id = "table_parquet"
path = "*_returns.parquet"

[[stage]]
type = "write_table"
id = "table_csv"
path = "*_returns.csv"

[[stage]]
type = "write_lstat"

[[stage]]
type = "write_ascii"
path = "*_points.txt"
columns = "{columns}"
separator = "comma"
header = true

[[stage]]
type = "write_trajectory"
every = 50
""".replace("{columns}", COLUMNS)
# Point outputs: extension, version, attribute layout, location of the index; "waves" includes waveforms.
POINTS = [
    (".las", "1.4", "standard", None),
    (".laz", "1.4", "standard", "file"),
    ("_12.las", "1.2", "1.1", "file"),
    ("_12_appended.laz", "1.2", "1.1", "appended"),
    ("_layout_10.laz", "1.4", "1.0", "appended"),
    ("_waves.laz", "1.4", "standard", "appended"),
    ("_waves_13.las", "1.3", "1.1", None),
    ("_waves_13_compressed.laz", "1.3", "1.1", None),
]


def reader(stage, path):
    return f"\n[[stage]]\ntype = \"{stage}\"\npath = '{path}'\n"


def run(program, folder, job):
    """Runs a job in a folder; returns its standard output."""
    (folder / "job.toml").write_text(job)
    return command([program, "--quiet", "run", folder / "job.toml"])


def command(words, folder=None):
    """Runs a program, optionally in a folder; returns its standard output."""
    done = subprocess.run([str(word) for word in words], capture_output=True, cwd=folder)
    if done.returncode != 0:
        raise RuntimeError(f"{' '.join(map(str, words))}: exit code {done.returncode}: {done.stderr.decode()}")
    return done.stdout


def check_survey(checks, name, program, source, tells_origins=True):
    """Checks all outputs of a job with every sink. LAS has no beam origins."""
    with checks.of(name), tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        run(program, folder, source + SINKS)
        report = json.loads((folder / "job_report.json").read_text())
        stem = report["inputs"][0]["stem"]
        output = lambda ending: folder / f"{stem}{ending}"
        with checks.of(f"{name}, job_report.json"):
            check_report(checks, report, folder)
        report = report["inputs"][0]
        container = read_container(output(".arrow"))
        with checks.of(f"{name}, container"):
            check_container(checks, output(".arrow"), container, report)
            check_copies(checks, program, folder, output(".arrow"), container)
        with checks.of(f"{name}, tables"):
            table = check_tables(checks, output, report)
        with checks.of(f"{name}, GeoParquet"):
            wkt = container.schema.metadata.get(b"wavex.crs", b"").decode()
            check_geoparquet(checks, output("_returns.parquet"), table, wkt)
        las = {}
        for ending, version, layout, index in POINTS:
            with checks.of(f"{name}, {ending}"):
                las[ending] = check_points(checks, output(ending), table, container, version, layout)
                check_laszip(checks, output(ending), las[ending], index)
                if ending in (".las", ".laz"):
                    check_pdal(checks, output(ending), las[ending])
                if "waves" in ending:
                    check_packets(checks, output(ending), las[ending], table, container)
        with checks.of(f"{name}, laz"):
            check_same_points(checks, las[".las"], las[".laz"])
        with checks.of(f"{name}, laz 1.2"):
            check_same_points(checks, las["_12.las"], las["_12_appended.laz"])
        for ending in (".las", ".laz", "_waves.laz"):
            with checks.of(f"{name}, COPC of {ending}"):
                copc = folder / f"of{ending}.copc.laz"
                command([program, "--quiet", "copc", output(ending), "-o", copc, "--stac"])
                check_copc(checks, copc, las[ending])
                item = folder / f"of{ending}.copc.json"
                check_stac(checks, item, laspy.read(copc), "COPC", copc.name)
        with checks.of(f"{name}, STAC"):
            check_stac(checks, output(".json"), las[".laz"], "LAZ", f"{stem}.laz")
        with checks.of(f"{name}, points as text"):
            check_ascii(checks, output("_points.txt"), table, container)
        with checks.of(f"{name}, the sensor's path"):
            if tells_origins:
                check_origins(checks, output("_traj.txt"), container, 50)
            else:
                check_beams(checks, output("_traj.txt"))
        with checks.of(f"{name}, line statistics"):
            check_line_statistics(checks, output("_lstat.txt"), container, report)


def check_report(checks, report, folder):
    def errors(name, value):
        schema = json.loads((SCHEMAS / f"{name}.schema.json").read_text())
        found = jsonschema.Draft202012Validator(schema).iter_errors(value)
        return [f"{error.json_path}: {error.message}" for error in found][:3]

    checks.equal("is as its schema says", errors("report", report), [])
    if report.get("sensor_model"):
        checks.equal("has a sensor model as its schema says", errors("sensor_model", report["sensor_model"]), [])
    (of_input,) = report["inputs"]
    written = sorted(Path(path).name for path in of_input["outputs"])
    about_the_run = {"job.toml", "job.log", "job_report.json", f"{of_input['stem']}_stat.log"}
    there = {path.name for path in folder.iterdir()}
    checks.equal("stands beside the other files about the run", sorted(about_the_run - there), [])
    checks.equal("names every file that was written", written, sorted(there - about_the_run))
    checks.that("lists its totals", of_input["totals"]["np"] > 0 and of_input["totals"]["nw"] > 0)
    total = of_input["totals"].get
    found = total("np") + total("np_filtered") + total("np_merged") + total("np_xtalk_dropped")
    checks.equal("accounts for every candidate", found, total("n_candidates") + total("n_added"))
    waveforms = total("nw_empty") + total("nw_deleted") + total("nw_with_points")
    checks.equal("accounts for every waveform", waveforms, total("nw"))


def check_copies(checks, program, folder, path, container):
    """Checks that rereading own containers, and writing to a pipe, gives the same data."""
    copy = folder / "copy.arrow"
    with tempfile.TemporaryDirectory() as here:
        command([program, "--quiet", "convert", path, copy], here)
        checks.equal("convert leaves nothing where it was called", sorted(Path(here).iterdir()), [])
    check_same_waveforms(checks, "convert gives the same again", container, read_container(copy))
    piped = run(program, folder, "[job]\nreport = ''\nlog = ''\n" + reader("read_arrow", path)
                + "\n[[stage]]\ntype = 'write_arrow'\npath = '-'\n")
    with pa.ipc.open_stream(piped) as stream:
        check_same_waveforms(checks, "standard output gives the same again", container, stream.read_all())


def check_tables(checks, output, report):
    """Checks that the three formats are equal; returns the table."""
    table = pa.ipc.open_file(output("_returns.arrow")).read_all()
    layout = json.loads((SCHEMAS / "return_table.json").read_text())["columns"]
    checks.equal("have the columns of their description", table.schema.names, [column["name"] for column in layout])
    for column in layout:
        field = table.schema.field(column["name"])
        checks.equal(f"{field.name} has its type", (field.type, field.nullable), (arrow_type(column), column["nullable"]))
    checks.equal("have a row per return", table.num_rows, report["totals"]["np"])
    parquet = pa.parquet.read_table(output("_returns.parquet"))
    types = pa.csv.ConvertOptions(column_types=dict(zip(table.schema.names, table.schema.types)), null_values=[""])
    csv = pa.csv.read_csv(output("_returns.csv"), convert_options=types)
    for name, other in [("Parquet", parquet), ("CSV", csv)]:
        differ = [column for column in table.schema.names if not same_column(table.column(column), other.column(column))]
        checks.equal(f"{name} holds the same as Arrow", (without_geometry(other), differ), (table.schema.names, []))
    sources = [f"read_parquet('{output('_returns.parquet')}')", f"read_csv('{output('_returns.csv')}')", "arrow"]
    query = "select count(*), sum(range_m), sum(z), sum(amplitude_dn), count(amplitude_db), sum(flags)::bigint from "
    expected = [table.num_rows, *(float(np.sum(numbers(table, name))) for name in ["range_m", "z", "amplitude_dn"]),
                len(table) - table.column("amplitude_db").null_count, int(np.sum(numbers(table, "flags")))]
    for source in sources:
        found = sql(query + source, arrow=table)
        checks.that(f"DuckDB sums up the same from {source.split('(')[0]}", np.allclose(found, expected, rtol=1e-12), found)
    return table


def without_geometry(table):
    return [name for name in table.schema.names if name != "geometry"]


def check_line_statistics(checks, path, container, report):
    head, *rows = path.read_text().splitlines()
    names = [column["name"] for column in json.loads((SCHEMAS / "lstat.json").read_text())["columns"]]
    checks.equal("have the 20 columns of their description", (head, len(names)), ("# " + " ".join(names), 20))
    values = np.array([[float(word) for word in row.split(" ")] for row in rows])
    checks.equal("have a row per scan line", len(rows), report["stages"][0]["lines_out"])
    for column, name in enumerate(names):
        if name in report["totals"]:
            checks.equal(f"{name} adds up to the report's", int(values[:, column].sum()), report["totals"][name])
    first = np.unique(numbers(container, "line"), return_index=True)[1]
    times = numbers(container, "gps_time_s").astype(float)[first]
    since_first = values[:, 0] - values[0, 0]
    checks.within("gps_time is that of each line's first shot", since_first, times - times[0], 2e-6)


def check_flight(checks, program):
    """Checks the path of a flight with a trajectory against coordinates projected by another program."""
    with checks.of("a flight with a trajectory"), tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        run(program, folder, FLIGHT)
        geometry = "[job.geometry]\ntrajectory = 'flown.sbet'\ncrs = 'utm:33N'\n"
        stages = reader("read_arrow", "flown.arrow") + "[[stage]]\ntype = 'write_trajectory'\ninterval_s = 0.01\n"
        run(program, folder, geometry + stages)
        check_flown(checks, folder / "flown_traj.txt", folder / "flown.sbet", "EPSG:32633")


def check_systems(checks, program):
    """Points of a flight in feet and on the earth's own axes, in LAS 1.2."""
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        run(program, folder, FLIGHT.replace("heading_deg", "start_deg = [-122.0, 41.5]\nheading_deg"))
        stages = reader("read_arrow", "flown.arrow") + (
            "\n[[stage]]\ntype = \"calibrate\"\nwaveforms = 600\n\n[[stage]]\ntype = \"decompose\"\n"
            "\n[[stage]]\ntype = \"georeference\"\n\n[[stage]]\ntype = \"write_las\"\n")
        geometry = "[job.geometry]\ntrajectory = 'flown.sbet'\n"
        with checks.of("a flight in several systems"):
            run(program, folder, f"{geometry}crs = 'geodetic'\n{stages}path = 'geodetic.las'\n")
            geodetic = laspy.read(folder / "geodetic.las").xyz
            checks.that("has points where it was flown",
                        len(geodetic) > 500 and np.all(np.abs(geodetic[:, :2] - [-122.0, 41.5]) < 0.1))
        for number, (system, keys) in enumerate(SYSTEMS.items()):
            with checks.of(f"LAS 1.2, {system.replace(chr(10), ', ')}"):
                path = folder / f"{number}.las"
                run(program, folder, f"{geometry}{system}\n{stages}path = '{path.name}'\nversion = '1.2'\n")
                check_units(checks, path, keys, np.asarray(geodetic))


def check_rasters_of_survey(checks, program):
    """Rasters of a survey of one strip, 1 km long."""
    with checks.of("rasters of a survey"), tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        run(program, folder, SURVEYED)
        check_rasters(checks, folder, "strip")


def check_many_points(checks, program):
    """Checks COPC with enough points for several octree levels."""
    with checks.of("COPC of many points"), tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        points = laspy.LasData(laspy.LasHeader(point_format=8, version="1.4"))
        points.header.scales = [0.01, 0.01, 0.001]
        # LAS 1.4 requires it of these formats, and copclib refuses files without.
        points.header.global_encoding.wkt = True
        random = np.random.default_rng(6)
        n = 400_000
        # A steep surface, denser towards a corner.
        x, y = 1000.0 * random.random(n) ** 2, 700.0 * random.random(n)
        points.x, points.y, points.z = x, y, 100.0 + 0.3 * x + 5.0 * random.random(n)
        points.gps_time = np.arange(n) * 1e-5
        points.add_extra_dim(laspy.ExtraBytesParams("range", "f8"))
        points["range"], points.nir, points.return_number = random.random(n), np.arange(n) % 65536, 1 + np.arange(n) % 15
        points.write(folder / "many.las")
        command([program, "--quiet", "copc", folder / "many.las"])
        source = laspy.read(folder / "many.las")
        check_copc(checks, folder / "many.copc.laz", source)
        with laspy.CopcReader.open(folder / "many.copc.laz") as file:
            shown = [len(file.query(level=range(0, level))) for level in (1, 2, 3, 20)]
        checks.that("has several levels", 0 < shown[0] < shown[1] <= shown[3] == n, shown)


def check_example3(checks, program, data):
    """Compares a RIEGL recording sample by sample with the format's own library."""
    pls = data / "pulsewaves" / "riegl_example3.pls"
    with checks.of("riegl_example3"), tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.arrow"
        command([program, "--quiet", "convert", pls, path])
        table = read_container(path)
        check_against_dump(checks, table, read_dump(pls.with_suffix(".txt.gz")), pls)


def check_made_up(checks, example):
    """Checks the files of the example `write_container`."""
    with tempfile.TemporaryDirectory() as folder:
        command([example, folder])
        for path in sorted(Path(folder).iterdir()):
            with checks.of(path.name):
                made_up.check(path)
                checks.that("is as the example made it", True)


def main():
    program = Path(sys.argv[1]).resolve()
    checks = Checks()
    if len(sys.argv) > 2:
        check_made_up(checks, Path(sys.argv[2]).resolve())
    else:
        print("skipped: the example write_container is not given")
    check_survey(checks, "simulated", program, SIMULATED)
    check_flight(checks, program)
    check_systems(checks, program)
    check_rasters_of_survey(checks, program)
    check_many_points(checks, program)
    check_relative_heights(checks, command, program)
    data = os.environ.get("WAVEX_DATA")
    if data is None:
        print("skipped: WAVEX_DATA not set")
    else:
        data = Path(data).resolve()
        recording = data / "riegl_q680i_dev" / "riegl_q680i_dev"
        check_survey(checks, "riegl_q680i_dev, LAS", program, reader("read_las", f"{recording}.las"), False)
        check_survey(checks, "riegl_q680i_dev, PulseWaves", program, reader("read_pulsewaves", f"{recording}.pls"))
        check_example3(checks, program, data)
    return checks.end()


if __name__ == "__main__":
    sys.exit(main())
