"""Checks what `wavex run` shows on a terminal of 80 columns: phases, whole warnings, lines that fit.

Usage: check_terminal.py WAVEX
"""

import os
import pty
import re
import struct
import sys
import tempfile
from fcntl import ioctl
from pathlib import Path
from termios import TIOCSWINSZ

from checks import Checks

COLUMNS = 80
# A flight long enough for several frames of the bar, in the scanner frame and without its trajectory.
JOB = """
[job]
output_dir = "out"
[[stage]]
type = "simulate"
stem = "a_flight_with_a_very_long_name_that_no_terminal_has_room_for"
landscape = "country"
sbet = "*.out"
lines = 300
shots_per_line = 400
[[stage]]
type = "calibrate"
[[stage]]
type = "decompose"
mode = "slow"
[[stage]]
type = "georeference"
[[stage]]
type = "write_las"
"""
ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")


def on_terminal(arguments, folder):
    """Returns everything that a program writes to a terminal, and its exit status."""
    child, terminal = pty.fork()
    if child == 0:
        os.chdir(folder)
        os.environ["TERM"] = "xterm-256color"
        os.execv(arguments[0], arguments)
    ioctl(terminal, TIOCSWINSZ, struct.pack("HHHH", 24, COLUMNS, 0, 0))
    text = b""
    while True:
        try:
            part = os.read(terminal, 65536)
        except OSError:
            break
        if not part:
            break
        text += part
    return text.decode(), os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main(wavex):
    checks = Checks()
    wavex = str(Path(wavex).resolve())
    with tempfile.TemporaryDirectory() as folder, checks.of("a run on a terminal"):
        Path(folder, "job.toml").write_text(JOB)
        shown, status = on_terminal([wavex, "run", "job.toml"], folder)
        checks.equal("exit status", status, 0)
        # What is drawn between two movements of the cursor to the start of a line.
        drawn = [ESCAPE.sub("", part) for part in re.split(r"[\r\n]+", shown)]
        bars = [line for line in drawn if re.search(r"\[[=> ]{12}\]", line)]
        checks.that("bars are drawn", len(bars) > 5, len(bars))
        widest = max(bars, key=len, default="")
        checks.that("bars fit the terminal", len(widest) <= COLUMNS, widest)
        for phase in ["calibrating", "processing"]:
            checks.that(f"a bar names the phase {phase}", any(phase in bar for bar in bars))
        percents = {int(bar.split("%")[0].split()[-1]) for bar in bars if "calibrating" in bar}
        checks.that("calibrating has several percentages", len(percents) > 2, percents)
        warnings = [line for line in drawn if "WARN" in line]
        checks.equal("warnings", len(warnings), 1)
        checks.that("no bar is in the line of a warning", not any("[=" in line for line in warnings), warnings)
        checks.that("the end names the next command", "look: wavex view out" in shown)
        checks.that("the end has colours", "\x1b[36mlook:" in shown)
        os.environ["NO_COLOR"] = "1"
        shown, _ = on_terminal([wavex, "run", "job.toml"], folder)
        checks.that("NO_COLOR is respected", "\x1b[36m" not in shown)
    return checks.end()


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
