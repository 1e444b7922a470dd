"""Runs the R code of docs/how-to/r.md on files that the program writes.

    python3 tests/python/check_r.py target/release/wavex

Blocks whose packages R lacks are skipped, and named. Prints a line per block; exit code 1 if one fails.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "r.md"
SIMULATE = """
[[stage]]
type = "simulate"
stem = "flight7"
lines = 5
shots_per_line = 200
"""
WRITE_ARROW = """
[[stage]]
type = "write_arrow"
path = "{}"
"""
JOB = """
[job]
output_dir = "out"
{simulate}{container}
[[stage]]
type = "calibrate"
[[stage]]
type = "decompose"
[[stage]]
type = "georeference"
{writers}
"""
# What must hold after a block; a block without an entry must only run.
EXPECTED = {
    "read.csv": 'stopifnot(nrow(returns) > 900, ncol(returns) >= 28, is.numeric(returns$range_m), '
    'nrow(kept) > 100, all(kept$range_sd_m > 0))',
    "read_parquet": "stopifnot(nrow(returns) > 900)",
    "readLAS": "stopifnot(nrow(las@data) > 100)",
    "read_feather": "stopifnot(length(samples) > 10)",
}


def blocks(language: str) -> list[str]:
    """Code of the page in a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)


def r(code: str, folder: Path) -> subprocess.CompletedProcess:
    """Runs R code."""
    return subprocess.run(["Rscript", "-e", code], cwd=folder, capture_output=True, text=True, check=False)


def main() -> int:
    """Runs all blocks."""
    program = Path(sys.argv[1]).resolve()
    if shutil.which("Rscript") is None:
        print("SKIPPED: docs/how-to/r.md is not run: Rscript is not here")
        return 0
    failed = ran = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        container, writers = WRITE_ARROW.format("../flight7.arrow"), "\n".join(blocks("toml"))
        (folder / "job.toml").write_text(JOB.format(simulate=SIMULATE, container=container, writers=writers))
        (folder / "to_stdout.toml").write_text(SIMULATE + WRITE_ARROW.format("-"))
        subprocess.run([program, "--quiet", "run", "job.toml"], cwd=folder, check=True)
        os.environ["PATH"] = f"{program.parent}{os.pathsep}{os.environ['PATH']}"
        for number, code in enumerate(blocks("r"), 1):
            packages = re.findall(r"^library\((\w+)\)", code, re.MULTILINE)
            missing = [package for package in packages if r(f"library({package})", folder).returncode]
            if missing:
                print(f"SKIPPED: block {number} of r.md: R has no package {', '.join(missing)}")
                continue
            checks = [check for call, check in EXPECTED.items() if call in code]
            done = r("\n".join([code, *checks]), folder)
            ran += 1
            if done.returncode:
                failed += 1
                print(f"FAILED: block {number} of r.md\n{code}\n{done.stderr}")
            else:
                print(f"ok: block {number} of r.md")
    if not ran:
        print("FAILED: no block of r.md was run")
    return 1 if failed or not ran else 0


if __name__ == "__main__":
    sys.exit(main())
