"""Reads the files of `cargo run --example write_container -- FOLDER` with pyarrow and DuckDB and checks them.

    pip install pyarrow duckdb
    python tests/python/read_container.py FOLDER/*

Every file given is checked: containers (Arrow IPC file or stream) and tables of returns (.arrow, .parquet, .csv), told
apart by their metadata. Ends with an error at the first thing that is not as the example made it.

    python tests/python/read_container.py --write FOLDER

writes the same container as pyarrow does it: `crates/wavex-formats/src/container/tests/*.arrow*` were made so, and the tests of the
reader open them.
"""

import argparse
import json
import math
from pathlib import Path

import duckdb
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

SHOTS = range(12)
SCHEMAS = Path(__file__).resolve().parents[2] / "schemas"
TYPES = {
    "u8": pa.uint8(), "u16": pa.uint16(), "u32": pa.uint32(), "u64": pa.uint64(),
    "i16": pa.int16(), "i64": pa.int64(), "f32": pa.float32(), "f64": pa.float64(),
    "bool": pa.bool_(), "utf8": pa.string(), "list of u16": pa.list_(pa.uint16()),
    "fixed-size list of 3 f64": pa.list_(pa.float64(), 3),
}


def arrow_type(column, found=None):
    """The pyarrow type of a column as the files in schemas/ describe it, without optional fields that `found` lacks."""
    if column["type"] == "list of struct":
        names = None if found is None else {field.name for field in found.value_type}
        fields = [field for field in column["fields"] if field["required"] or names is None or field["name"] in names]
        return pa.list_(pa.struct([(field["name"], arrow_type(field)) for field in fields]))
    return TYPES[column["type"]]


def container_row(n):
    """The row of shot n, as examples/write_container.rs makes it."""
    return {
        "shot": n,
        "line": n // 4,
        "gps_time_s": None if n % 5 == 4 else 1000 + n / 2,
        "clock_ps": n * 2_500_000,
        "origin": [n, 2 * n, 3 * n],
        "direction": [0.6, 0.0, -0.8],
        "facet": n % 4,
        "flags": 1,
        "mta_zone": 2 if n % 2 else None,
        "blocks": [
            {"channel": 3, "start_ns": 0.25, "samples": [n + i for i in range(6)], "zone": None,
             "interval_ns": None},
            {"channel": 1, "start_ns": 100.0 + n, "samples": [10 * n + i for i in range(8 + n)],
             "zone": 1 if n == 6 else None, "interval_ns": 0.5 if n == 3 else None},
        ],
        "online": [{"time_ns": 100.0 + i, "amplitude": 1.5} for i in range(n % 3)] or None,
        "scan_angle_deg": n - 6 if n else None,
        "frame_scale": 0.9996 if n == 7 else None,
    }


def return_rows():
    """The rows of the table, as examples/write_container.rs makes them."""
    for n in SHOTS:
        for index in range(n % 3):
            distance = 100 + n + index / 8
            point = [n, 0.1 + index, -0.125] if n % 2 == 0 else [None] * 3
            yield [
                n, None if n % 5 == 4 else 1000 + n / 2, index + 1, n % 3, ["low", "high", "joint"][n // 3 % 3],
                2 if n % 2 else None, distance, 0.0015, distance / 0.15, 0.01, 0.1 + 0.2, 0.9,
                None if index else 12.5, 1.0, 0.0625, 4.5, 0.0, math.nan, -0.5, 70.0, 1.0, 0x100, index == 1,
                20 * index, *point, 0.04 if n % 4 == 0 else None, *[None] * 19,
            ]


def same(found, expected):
    """Equality with NaN equal to NaN, and lists compared by item."""
    if isinstance(expected, float) and math.isnan(expected):
        return isinstance(found, float) and math.isnan(found)
    if isinstance(expected, list):
        return len(found) == len(expected) and all(map(same, found, expected))
    return found == expected


def expect(what, found, expected):
    if not same(found, expected):
        raise SystemExit(f"{what}:\n  found    {found}\n  expected {expected}")


def sql(query, **tables):
    """The only row of a query on these tables."""
    connection = duckdb.connect()
    for name, table in tables.items():
        connection.register(name, table)
    return list(connection.execute(query).fetchall()[0])


def check_container(path, table):
    layout = json.loads((SCHEMAS / "container.json").read_text())
    expect(f"{path}: columns", table.schema.names, [column["name"] for column in layout["columns"]])
    for column in layout["columns"]:
        field = table.schema.field(column["name"])
        expect(f"{path}: type of {field.name}", str(field.type).replace(" not null", ""), str(arrow_type(column, field.type)))
        expect(f"{path}: nullable {field.name}", field.nullable, column["nullable"])
    metadata = {key.decode(): value.decode() for key, value in table.schema.metadata.items()}
    for key in layout["metadata"]:
        if key["required"]:
            expect(f"{path}: metadata {key['key']}", key["key"] in metadata, True)
    expect(f"{path}: day", metadata["wavex.recorded"], "2013-06-21")
    expect(f"{path}: table", json.loads(metadata["wavex.tables"])["amplitude_low"], [[9.0, 0.0], [255.0, 19.7]])
    table.validate(full=True)
    for row, n in zip(table.to_pylist(), SHOTS, strict=True):
        expect(f"{path}: row {n}", row, container_row(n))
    found = sql(
        "with block as (select shot, unnest(blocks) as b from t), "
        "sample as (select b.channel as channel, unnest(b.samples) as dn from block) "
        "select (select count(*) from t), (select count(*) from block), count(*), sum(dn)::bigint, "
        "(sum(dn) filter (where channel = 1))::bigint, (select sum(origin[3]) from t), "
        "(select sum(len(online)) from t)::bigint, (select count(gps_time_s) from t) from sample",
        t=table,
    )
    rows = [container_row(n) for n in SHOTS]
    blocks = [block for row in rows for block in row["blocks"]]
    samples = [(block["channel"], dn) for block in blocks for dn in block["samples"]]
    expected = [
        len(rows), len(blocks), len(samples), sum(dn for _, dn in samples),
        sum(dn for channel, dn in samples if channel == 1), sum(row["origin"][2] for row in rows),
        sum(len(row["online"] or []) for row in rows), sum(row["gps_time_s"] is not None for row in rows),
    ]
    expect(f"{path}: sums in DuckDB", found, expected)


def check_table(path, table, is_csv):
    layout = json.loads((SCHEMAS / "return_table.json").read_text())["columns"]
    expect(f"{path}: columns", table.schema.names, [column["name"] for column in layout])
    if not is_csv:
        for column in layout:
            field = table.schema.field(column["name"])
            expect(f"{path}: type of {field.name}", str(field.type), str(arrow_type(column, field.type)))
            expect(f"{path}: nullable {field.name}", field.nullable, column["nullable"])
        expect(f"{path}: time scale", table.schema.metadata[b"wavex.time_scale"], b"week")
    rows = list(return_rows())
    for found, expected in zip(table.to_pylist(), rows, strict=True):
        expect(f"{path}: a row", list(found.values()), expected)
    source = {".parquet": f"read_parquet('{path}')", ".csv": f"read_csv('{path}')"}.get(path.suffix, "t")
    found = sql(
        f"select count(*), sum(range_m), sum(time_of_flight_ns), count(gps_time_s), count(amplitude_db), "
        f"count(x), count(mta_zone), (count(*) filter (where withheld)), "
        f"(count(*) filter (where isnan(thickness_sd_m))), (sum(\"class\"))::bigint, "
        f"(count(*) filter (where channel = 'joint')) from {source}",
        t=table,
    )
    column = lambda index: [row[index] for row in rows]
    known = lambda index: sum(value is not None for value in column(index))
    expected = [
        len(rows), sum(column(6)), sum(column(8)), known(1), known(12), known(24), known(5), sum(column(22)),
        len(rows), sum(column(23)), column(4).count("joint"),
    ]
    close = [abs(found[i] - expected[i]) < 1e-9 for i in (1, 2)]
    expect(f"{path}: sums in DuckDB", found[:1] + close + found[3:], expected[:1] + [True] * 2 + expected[3:])
    if path.suffix == ".parquet":
        about = pa.parquet.ParquetFile(path).metadata
        expect(f"{path}: made by", about.created_by.startswith("wavex "), True)
        scale = sql(f"select value::varchar from parquet_kv_metadata('{path}') where key = 'wavex.time_scale'")
        expect(f"{path}: time scale in DuckDB", scale, ["week"])


def read(path):
    """Reads any of the files as a pyarrow table."""
    if path.suffix == ".parquet":
        return pa.parquet.read_table(path)
    if path.suffix == ".csv":
        return pa.csv.read_csv(path, convert_options=pa.csv.ConvertOptions(null_values=[""]))
    is_file = path.read_bytes()[:6] == b"ARROW1"
    return (pa.ipc.open_file if is_file else pa.ipc.open_stream)(path).read_all()


def check(path):
    table = read(path)
    if b"wavex.container" in (table.schema.metadata or {}):
        check_container(path, table)
    else:
        check_table(path, table, path.suffix == ".csv")
    print(f"{path}: as it was made, {table.num_rows} rows")


def write(folder):
    """Rewrites the container with pyarrow: all fields nullable, plus an unknown column."""
    layout = json.loads((SCHEMAS / "container.json").read_text())["columns"]
    fields = [pa.field(column["name"], arrow_type(column)) for column in layout]
    metadata = {
        "wavex.container": "1", "wavex.sampling_interval_ns": "1.0", "wavex.group_velocity_mps": "299707502",
        "wavex.time_scale": "week", "wavex.frame": "scanner", "author": "somebody",
    }
    rows = [container_row(n) for n in SHOTS]
    for row in rows:
        row["weather"] = "fair"
    weather = pa.field("weather", pa.dictionary(pa.int8(), pa.string()))
    schema = pa.schema([weather, *fields], metadata)
    table = pa.Table.from_pylist(rows, schema)
    folder.mkdir(parents=True, exist_ok=True)
    forms = [("pyarrow_zstd.arrow", pa.ipc.new_file, "zstd"), ("pyarrow_lz4.arrows", pa.ipc.new_stream, "lz4")]
    for name, new, codec in forms:
        with new(folder / name, schema, options=pa.ipc.IpcWriteOptions(compression=codec)) as writer:
            for first in range(0, len(rows), 4):
                writer.write_table(table.slice(first, 4))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--write", type=Path, metavar="FOLDER")
    arguments = parser.parse_args()
    if arguments.write:
        write(arguments.write)
    for path in arguments.files:
        check(path)
    if not (arguments.files or arguments.write):
        parser.error("give the files to check")


if __name__ == "__main__":
    main()
