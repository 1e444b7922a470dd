"""Compare the outputs of two wavex binaries, byte by byte.

    python3 tests/python/compare_binaries.py OLD NEW [--stand-in LIBRARY] [--data FOLDER] [--keep FOLDER]

Runs with each binary, in a folder of its own:

- the jobs of `jobs/`, on a simulated flight as container, SDF (by the stand-in library) and trajectory;
- the example command lines of BayesWavEx through `wavex import --run`, on that flight;
- the real recordings of `--data` (default: `WAVEX_DATA`), by `read_pulsewaves` and `read_las`, in the four modes.

Lists every difference of an exit status, message or output and exits with 1 if there is one. Times, digests of outputs
and the machine are removed from reports before the comparison, logs are left out, and the name of the folder from messages.
"""

import argparse
import base64
import hashlib
import json
import os
import re
import shutil
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]

FLIGHT = """
[job]
output_dir = "out"
[[stage]]
type = "simulate"
stem = "data"
lines = 6
shots_per_line = 200
as_recorded = true
pulse_rate_hz = 300000
modulation_ns = 15.0
flying_height_m = 1000.0
pof = "file.pof"
[[stage]]
type = "write_arrow"
"""

# Keys of `[[stage]]` readers whose path is replaced, by job.
JOBS = {
    "demo": [],
    "flight": ["simulate.lines=12", "simulate.shots_per_line=300"],
    "georeference": [],
    "container": ["job.input_dir='../out/flight'"],
    "raw": [],
    "sdf": ["job.input_dir='../in'", "read_sdf.path='data.sdf'", "job.geometry.trajectory='file.pof'"],
}

LINES = [
    "-i data.sdf -po file.pof -fastest",
    "-i data.sdf -po file.pof -lstat -o12",
    "-i data.sdf -po file.pof -lstat -olas -olax",
    "-i data.sdf -po file.pof -lstat -O outdir -ounc 0 -o*_abc",
    "-i data.sdf -po file.pof -utm 33 -feet -gps_date 2025-05-06",
    "-i data.sdf -po file.pof -geo",
    "-i data.sdf -po file.pof -fastest -oext 0",
    "-i data.sdf",
    "-i data.sdf -det 6 -lm_det 10",
    "-i data.sdf -fastest -oext 0 -nil",
    "-i data.sdf -po file.pof -fastsep -traj -stat",
    "-i data.sdf -po file.pof -fastest -bge 0",
    "-i data.sdf -po file.pof -fastest -o flown.laz -lax_append",
    "-sdfscan -i data.sdf -name scan",
    "-i data.sdf -po file.pof -osdfstat -ostat -fastest -plot_po track.txt",
    "-h",
    "-v",
    "-clear_log",
]

# Reader and modes of the real recordings.
MODES = ["refined", "fast_separated", "fastest", "slow"]

# Members of a report that differ from run to run.
VOLATILE = re.compile(r"(wall|working|waiting|blocked|modified)_s$|^(line_us|started|ended|commit|threads|stages_s)$|peak")


def run(binary, words, folder, environment):
    """Run a binary; return exit status and messages without the name of the folder."""
    ended = subprocess.run([binary, *words], cwd=folder, env=environment, capture_output=True, text=True)
    text = f"{ended.stdout}\n{ended.stderr}".replace(str(folder.resolve()), "").replace(str(folder), "")
    # Times, rates and the table of stage times.
    text = re.sub(r" *<- bottleneck", "", text)
    text = re.sub(r"\d+\.\d+ M shots/s|\d+(\.\d+)? ?(m?s|MB|k/s|shots/s)\b|( +\d+\.\d+){3} +\d+%", "N", text)
    return f"status {ended.returncode}\n{text}"


def pixels(png):
    """Size, palette and pixels of a PNG, so that encoders do not matter."""
    chunks, at = {}, 8
    while at < len(png):
        (length,), kind = struct.unpack(">I", png[at : at + 4]), png[at + 4 : at + 8]
        chunks[kind] = chunks.get(kind, b"") + png[at + 8 : at + 8 + length]
        at += 12 + length
    width, height, depth, colour = struct.unpack(">IIBB", chunks[b"IHDR"][:10])
    step = max(1, depth * {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour] // 8)
    row = (width * depth * {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[colour] + 7) // 8
    data, above, rows = zlib.decompress(chunks[b"IDAT"]), bytearray(row), []
    for start in range(0, height * (row + 1), row + 1):
        method, line = data[start], bytearray(data[start + 1 : start + 1 + row])
        for i in range(row):
            left = line[i - step] if i >= step else 0
            corner = above[i - step] if i >= step else 0
            paeth = min((left, above[i], corner), key=lambda value: abs(left + above[i] - corner - value))
            line[i] = (line[i] + (0, left, above[i], (left + above[i]) // 2, paeth)[method]) % 256
        rows.append(bytes(line))
        above = line
    return [width, height, chunks.get(b"PLTE", b"").hex(), hashlib.sha256(b"".join(rows)).hexdigest()]


def stable(value):
    """Remove volatile members of a report, and decode its pictures."""
    if isinstance(value, str) and value.startswith("iVBORw0KGgo"):
        return pixels(base64.b64decode(value))
    if isinstance(value, dict):
        return {key: stable(member) for key, member in value.items() if not VOLATILE.search(key)}
    return [stable(member) for member in value] if isinstance(value, list) else value


def digest(path):
    """Digest of an output; of a report without its volatile members."""
    data = path.read_bytes()
    if path.suffix == ".json" and path.name != "job.json":
        data = json.dumps(stable(json.loads(data)), sort_keys=True).encode()
    if path.name.endswith("_stat.log"):
        changing = rb"^(start|end|duration|waveforms per second|peak memory.*)\b|( +\d+\.\d+){3} +\d+%"
        data = b"\n".join(line for line in data.splitlines() if not re.search(changing, line))
    return hashlib.sha256(data).hexdigest()[:16]


def is_log(path):
    """Logs of runs contain times."""
    return path.suffix == ".log" and not path.name.endswith("_stat.log")


def real_recordings(data):
    """Paths of the real recordings, with their readers."""
    for pattern, reader in [("*/*.pls", "read_pulsewaves"), ("*/*.las", "read_las"), ("*/*.laz", "read_las")]:
        for path in sorted(data.glob(pattern)):
            yield path, reader


def outputs(binary, folder, arguments):
    """Run everything with one binary; return digests of messages and files by name."""
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("WAVEX", "RUST_"))}
    if arguments.stand_in:
        environment["WAVEX_RIWAVELIB"] = str(Path(arguments.stand_in).resolve())
    found, messages = {}, {}
    here, into = folder / "in", folder / "jobs"
    here.mkdir()
    shutil.copytree(REPOSITORY / "jobs", into)
    (here / "flight.toml").write_text(FLIGHT)
    messages["flight"] = run(binary, ["run", "flight.toml"], here, environment)
    if not (here / "out" / "data.arrow").is_file():
        sys.exit(f"{binary} cannot simulate the flight: {messages['flight']}")
    shutil.move(here / "out" / "data.arrow", here / "data.sdf")
    shutil.move(here / "out" / "file.pof", here / "file.pof")
    shutil.rmtree(here / "out")
    for job, sets in JOBS.items():
        if job == "sdf" and not arguments.stand_in:
            continue
        words = [word for value in sets for word in ("--set", value)]
        messages[f"jobs/{job}"] = run(binary, ["run", f"{job}.toml", *words], into, environment)
    if arguments.stand_in:
        for number, line in enumerate(LINES):
            place = folder / f"line-{number:02}"
            place.mkdir()
            for name in ("data.sdf", "file.pof"):
                (place / name).symlink_to(here / name)
            words = ["import", "--run", "--", "wavex", *line.split()]
            messages[f"line {line}"] = run(binary, words, place, environment)
    if arguments.data:
        for path, reader in real_recordings(Path(arguments.data)):
            for mode in MODES:
                place = folder / "real" / f"{path.stem}-{path.suffix[1:]}-{mode}"
                place.mkdir(parents=True)
                (place / "job.toml").write_text(
                    f'[job]\ninput_dir = "{path.parent}"\noutput_dir = "."\n'
                    f'[[stage]]\ntype = "{reader}"\npath = "{path.name}"\n'
                    f'[[stage]]\ntype = "calibrate"\n[[stage]]\ntype = "decompose"\nmode = "{mode}"\n'
                    '[[stage]]\ntype = "correct"\n[[stage]]\ntype = "filter_outliers"\n[[stage]]\ntype = "georeference"\n'
                    '[[stage]]\ntype = "write_las"\n[[stage]]\ntype = "write_ascii"\n[[stage]]\ntype = "write_lstat"\n'
                    '[[stage]]\ntype = "write_table"\n[[stage]]\ntype = "write_trajectory"\n'
                )
                name = f"real {path.name} {mode}"
                messages[name] = run(binary, ["run", "job.toml"], place, environment)
    for name, text in messages.items():
        found[f"messages of {name}"] = hashlib.sha256(text.encode()).hexdigest()[:16]
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not path.is_symlink() and path.suffix not in (".toml", ".html") and not is_log(path):
            found[str(path.relative_to(folder))] = digest(path)
    return found, messages


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("old")
    parser.add_argument("new")
    parser.add_argument("--stand-in", help="library built by `cargo build --example sdf_stand_in`")
    parser.add_argument("--data", default=os.environ.get("WAVEX_DATA"))
    parser.add_argument("--keep", help="existing folder for the outputs of both binaries")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        results = []
        for name, binary in [("old", arguments.old), ("new", arguments.new)]:
            # The same folder for both: paths are part of some outputs.
            place = Path(folder) / "run"
            place.mkdir()
            results.append(outputs(str(Path(binary).resolve()), place, arguments))
            if arguments.keep:
                shutil.copytree(place, Path(arguments.keep) / name, symlinks=True, dirs_exist_ok=True)
            shutil.rmtree(place)
    (old, old_messages), (new, new_messages) = results
    differ = [name for name in sorted(old.keys() | new.keys()) if old.get(name) != new.get(name)]
    for name in differ:
        print(f"differs: {name}: {old.get(name, 'missing')} {new.get(name, 'missing')}")
        key = name.removeprefix("messages of ")
        if key != name:
            before, after = (set(texts.get(key, "").splitlines()) for texts in (old_messages, new_messages))
            print("".join(f"    - {line}\n" for line in sorted(before - after)), end="")
            print("".join(f"    + {line}\n" for line in sorted(after - before)), end="")
    failed = [name for name, text in old_messages.items() if not text.startswith("status 0")]
    print(f"{len(old)} outputs and messages of {len(old_messages)} runs, {len(differ)} differ; "
          f"{len(failed)} runs of the old binary end with an error: {', '.join(failed) or 'none'}")
    sys.exit(1 if differ else 0)


if __name__ == "__main__":
    main()
