"""Checks the container with pyarrow and DuckDB against its description and a dump of the PulseWaves library."""

import gzip
import json
import struct

import numpy as np
import pyarrow as pa

from checks import numbers, same_column
from read_container import SCHEMAS, arrow_type, sql

REFERENCE, LOW_POWER = 3, 1
OUTGOING, RETURNING = 1, 2


def read_container(path):
    return pa.ipc.open_file(path).read_all()


def check_container(checks, path, table, report):
    layout = json.loads((SCHEMAS / "container.json").read_text())
    checks.equal("has the columns of its description", table.schema.names, [c["name"] for c in layout["columns"]])
    for column in layout["columns"]:
        field = table.schema.field(column["name"])
        found = (str(field.type).replace(" not null", ""), field.nullable)
        checks.equal(f"{field.name} has its type", found, (str(arrow_type(column, field.type)), column["nullable"]))
    metadata = {key.decode() for key in table.schema.metadata}
    required = {key["key"] for key in layout["metadata"] if key["required"]}
    checks.equal("has all metadata that are required", sorted(required - metadata), [])
    table.validate(full=True)
    reader = report["stages"][0]["items_out"]
    blocks = flat(table)
    checks.equal("has a row per shot", table.num_rows, reader["shots"])
    checks.equal("has every block", len(blocks["channel"]), reader["blocks"])
    lengths = np.linalg.norm(np.array(table.column("direction").to_pylist()), axis=1)
    checks.within("directions are unit vectors", lengths, np.ones(table.num_rows), 1e-9)
    found = sql(
        "with b as (select unnest(blocks) as b from read), s as (select unnest(b.samples) as dn from b) "
        "select (select count(*) from read), (select count(*) from b), count(*), sum(dn)::bigint from s",
        read=table,
    )
    expected = [table.num_rows, len(blocks["channel"]), len(blocks["samples"]), int(blocks["samples"].sum())]
    checks.equal("DuckDB finds the same samples as pyarrow", found, expected)


def flat(table):
    """Concatenates the blocks of all shots, and their samples."""
    lists = table.column("blocks").combine_chunks()
    blocks = lists.flatten()
    samples = blocks.field("samples")
    return {
        "per_shot": lists.value_lengths().to_numpy(),
        "channel": blocks.field("channel").to_numpy(),
        "start_ns": blocks.field("start_ns").to_numpy(),
        "lengths": samples.value_lengths().to_numpy(),
        "samples": samples.flatten().to_numpy().astype(np.int64),
    }


def check_same_waveforms(checks, what, table, other):
    same = table.schema.names == other.schema.names and all(map(equal_nested, table.columns, other.columns))
    checks.that(what, same)


def equal_nested(a, b):
    return a.equals(b) or same_column(a, b)


def read_dump(path):
    """Reads the dump of a PulseWaves file: T of each pulse, and for each segment the columns of `flat`."""
    ticks, per_shot, kinds, durations, lengths, samples, places = [], [], [], [], [], [], []
    for line in gzip.open(path, "rt"):
        words = line.split()
        if words[0] == "P":
            ticks.append(int(words[2]))
            per_shot.append(0)
        elif words[0] == "S":
            per_shot[-1] += 1
            kinds.append((int(words[2]), int(words[3])))
            durations.append(float(words[7]))
            lengths.append(int(words[8]))
            samples.append(np.array(words[10:], dtype=np.int64))
        elif words[0] == "X":
            places.append([float(word) for word in words[1:]])
    channels = [REFERENCE if kind == OUTGOING else channel for kind, channel in kinds]
    return {
        "ticks": np.array(ticks),
        "per_shot": np.array(per_shot),
        "channel": np.array(channels),
        "start_ns": np.array(durations),
        "lengths": np.array(lengths),
        "samples": np.concatenate(samples),
        "places": np.array(places),
    }


def check_against_dump(checks, table, dump, pls):
    """Compares all samples and segment attributes."""
    blocks = flat(table)
    for what in ["per_shot", "channel", "lengths", "samples"]:
        same = np.array_equal(blocks[what], dump[what])
        checks.that(f"{len(dump[what])} {what.replace('_', ' ')} are those of the PulseWaves library", same)
    # The library stores durations as 32-bit floats.
    start = dump["start_ns"]
    checks.within("segments begin when the library says", blocks["start_ns"], start, 1e-6 + start * 2e-7)
    (t_scale_s,) = struct.unpack_from("<d", pls.read_bytes(), 224)
    clock = numbers(table, "clock_ps") - numbers(table, "clock_ps")[0]
    expected = np.round((dump["ticks"] - dump["ticks"][0]) * t_scale_s * 1e12)
    checks.within("the clock is T in picoseconds", clock, expected, 1.0)
    check_places(checks, table, blocks, dump)


def check_places(checks, table, blocks, dump):
    """Compares segment positions: the library uses each beam's rounded length, wavex the mean length."""
    metadata = table.schema.metadata
    metres_per_ns = float(metadata[b"wavex.group_velocity_mps"]) * 0.5e-9
    shot = np.repeat(np.arange(table.num_rows), blocks["per_shot"])
    origin = np.array(table.column("origin").to_pylist())[shot]
    direction = np.array(table.column("direction").to_pylist())[shot]
    scale = numbers(table, "frame_scale", null=1.0).astype(float)[shot]
    reach = (blocks["start_ns"] * metres_per_ns * scale)[:, None]
    grid_m = json.loads(metadata[b"wavex.coordinate_grid"])["scale"][0]
    # Two points 1000 ns apart, each rounded by up to half a step in three directions.
    rounding_m = np.sqrt(3.0) * grid_m * blocks["start_ns"] / 1000.0 + 1e-3
    off = np.linalg.norm(origin + direction * reach - dump["places"], axis=1)
    checks.within("segments begin where the library says", off, np.zeros(len(off)), rounding_m)
