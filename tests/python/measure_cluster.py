"""Time of a survey on Slurm, on this machine, against the time of one run.

    target/venv/bin/python tests/python/measure_cluster.py target/release/wavex [STRIPS [LINES]]

Needs requirements-cluster.txt and Slurm (see check_cluster.py). Strips have LINES lines of 1000 shots (default 300
strips of 100 lines). Prints the time of one run over all strips, that of the array job of docs/how-to/cluster.md, and
that of Snakemake with batches; exit code 1 if products differ.
"""

import sys
import tempfile
import time
from pathlib import Path

from check_cluster import QUICK
from cluster_survey import MAKE, SURVEY, Folder, commands
from slurm import Slurm, obstacle

# Distance of neighbouring strips, which overlap by a third.
SPACING_M = 450.0


class LargeSurvey(Folder):
    """A survey of many strips."""

    def __init__(self, folder, wavex, strips, lines):
        super().__init__(folder, wavex)
        self.strips = strips
        self.write("make.toml", MAKE.replace("lines = 6", f"lines = {lines}")
                   .replace("shots_per_line = 60", "shots_per_line = 1000"))
        # Longer recordings need more memory than the strips of the test.
        self.write("survey.toml", SURVEY.replace("MODEL", "survey").replace("memory_mb = 64\n", ""))
        for number in range(1, strips + 1):
            right_m = SPACING_M * (number - strips / 2)
            keys = {"stem": f"strip{number:04}", "seed": number, "track_offset_m": f"[{right_m}, 0.0]"}
            self.wavex("run", "make.toml", *(f"--set=simulate.{key}={value}" for key, value in keys.items()))

    def run_long(self, command, more=""):
        """Runs a command of the document; returns its time, s."""
        started = time.monotonic()
        code = self.start(command, more).wait(timeout=3600)
        if code != 0:
            raise RuntimeError(f"{command} ended with {code}: {self.log()[-3000:]}")
        return time.monotonic() - started

    def measure(self, what, name, more=""):
        """Times of a block of the document: plan, tasks, collect."""
        plan = sum(self.run_long(command) for command in commands("plan"))
        # The document's survey has twelve strips.
        of_all = [command.replace("--array=1-12", f"--array=1-{self.strips}") for command in commands(name)]
        tasks = sum(self.run_long(command, more) for command in of_all)
        print(f"{what}: {plan + tasks:.1f} s, of which {plan:.1f} s for the plan", flush=True)
        return plan + tasks


def main(wavex, strips=300, lines=100):
    why = obstacle()
    if why:
        print(f"skipped: {why}")
        return 0
    with tempfile.TemporaryDirectory() as folder:
        survey = LargeSurvey(Path(folder) / "survey", wavex, strips, lines)
        started = time.monotonic()
        survey.wavex("run", "survey.toml")
        one = time.monotonic() - started
        expected = survey.products()
        print(f"one run over {strips} strips of {lines * 1000} shots: {one:.1f} s", flush=True)
        survey.remove("out")
        is_equal = True
        with Slurm(Path(folder) / "slurm"):
            for what, name, more in [("array job", "array", ""), ("Snakemake, batches", "batch", QUICK)]:
                took = survey.measure(what, name, more)
                print(f"{what}: efficiency {one / took:.2f}", flush=True)
                is_equal &= survey.products() == expected
                survey.remove("out", "plan", ".snakemake")
    print("products are equal" if is_equal else "PRODUCTS DIFFER")
    return 0 if is_equal else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]).resolve(), *map(int, sys.argv[2:])))
