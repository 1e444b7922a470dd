"""Compare the package with the program's stages on the same recording.

Prints, as a table in Markdown, waveforms per second and core of `decompose_samples` and of the stage `decompose`,
and shots per second of `Recording.shots()` and of the stage `read_arrow`: medians of alternating rounds. The recording
is simulated: a million shots of 60 samples, of one receiver, without compression.

    pip install wavex pyarrow
    python benchmarks/same_data.py
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
import pyarrow as pa

import wavex

JOB = """
[[stage]]
type = "read_arrow"
path = "flight.arrow"
[[stage]]
type = "calibrate"
load = "model.json"
[[stage]]
type = "decompose"
mode = "refined"
"""


def stages(folder: Path) -> dict[str, float]:
    """Run the job with one worker; working times of its stages, s."""
    job = wavex.Job.from_toml(f'[job]\nthreads = 1\ninput_dir = "{folder}"\noutput_dir = "{folder}"\n{JOB}')
    return {stage["type"]: stage["working_s"] for stage in wavex.run(job)["inputs"][0]["stages"]}


def main() -> None:
    """Print the table."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--lines", type=int, default=1000, help="scan lines of 1000 shots")
    arguments.add_argument("--rounds", type=int, default=5)
    options = arguments.parse_args()
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        path = folder / "flight.arrow"
        simulated = wavex.Job.from_toml(
            f'[job]\noutput_dir = "{folder}"\n[[stage]]\ntype = "simulate"\nlines = {options.lines}\n'
            'shots_per_line = 1000\n[[stage]]\ntype = "write_arrow"\npath = "flight.arrow"\ncompression = "none"\n'
        )
        wavex.run(simulated)
        recording = wavex.open(path)
        model = wavex.calibrate(recording)
        model.save(folder / "model.json")
        columns = recording.shots(columns=["blocks"]).to_arrow().read_all()["blocks"].combine_chunks().flatten()
        is_low = np.asarray(columns.field("channel")) == 1
        low = columns.filter(pa.array(is_low))
        samples, start_ns = low.field("samples"), np.asarray(low.field("start_ns"))
        rates: dict[str, list[float]] = {"decompose": [], "decompose_samples": [], "read_arrow": [], "shots()": []}
        shots = 1000 * options.lines
        for _ in range(options.rounds):
            working_s = stages(folder)
            rates["decompose"].append(len(samples) / working_s["decompose"])
            rates["read_arrow"].append(shots / working_s["read_arrow"])
            start = time.process_time()
            wavex.decompose_samples(samples, start_ns, model, threads=1, mode="refined")
            rates["decompose_samples"].append(len(samples) / (time.process_time() - start))
            start = time.perf_counter()
            read = sum(batch.num_rows for batch in wavex.open(path).shots().to_arrow())
            rates["shots()"].append(read / (time.perf_counter() - start))
        print("| of | per second | ratio |\n|---|---|---|")
        for base, name in [("decompose", "decompose_samples"), ("read_arrow", "shots()")]:
            ratio = statistics.median(ours / its for ours, its in zip(rates[name], rates[base]))
            print(f"| stage `{base}` | {statistics.median(rates[base]):,.0f} | |")
            print(f"| `{name}` | {statistics.median(rates[name]):,.0f} | {ratio:.2f} |")


if __name__ == "__main__":
    main()
