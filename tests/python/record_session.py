"""Records a terminal from clone to viewer, as asciicast version 2 (`asciinema play FILE`).

    python record_session.py RECORDING [--repository ADDRESS]

Clones the repository (by default this one), builds the program, runs the demo and starts the viewer, in a terminal of
80 columns and in a new folder. Times are those of the machine; players shorten pauses (`idle_time_limit`). Fails if a
command fails, or if the viewer's address does not answer. Needs git, cargo and a C compiler.
"""

import argparse
import fcntl
import json
import os
import pty
import re
import select
import struct
import sys
import tempfile
import termios
import time
import urllib.request
from pathlib import Path

COLUMNS, ROWS = 80, 24
# What somebody types, whose clone is of the address that is shown.
SHOWN_ADDRESS = "https://wavex.example/wavex.git"
COMMANDS = [
    f"git clone {SHOWN_ADDRESS}",
    "cd wavex",
    "cargo run --release -- run jobs/demo.toml",
    "cargo run --release -- view --no-open out/demo",
]
PROMPT = "$ "
VIEWER = re.compile(r"http://127\.0\.0\.1:\d+/\S*")
# Parts of output within this time are one event.
EVENT_S = 0.1


class Recorder:
    """A shell whose output is recorded."""

    def __init__(self, folder, repository):
        self.folder, self.events, self.start_s = str(folder), [], time.monotonic()
        child, self.terminal = pty.fork()
        if child == 0:
            os.chdir(folder)
            # The shell then writes nothing between a command and its output.
            (Path(folder) / ".inputrc").write_text("set enable-bracketed-paste off\n")
            shown = {"TERM": "xterm-256color", "PS1": PROMPT, "INPUTRC": f"{folder}/.inputrc", "HOME": os.environ["HOME"], "PATH": os.environ["PATH"]}
            git = {"GIT_CONFIG_COUNT": "1", "GIT_CONFIG_KEY_0": f"url.{repository}.insteadOf", "GIT_CONFIG_VALUE_0": SHOWN_ADDRESS}
            kept = {key: os.environ[key] for key in ("CARGO_HOME", "RUSTUP_HOME") if key in os.environ}
            os.execvpe("bash", ["bash", "--norc", "--noprofile"], shown | git | kept)
        fcntl.ioctl(self.terminal, termios.TIOCSWINSZ, struct.pack("HHHH", ROWS, COLUMNS, 0, 0))

    def until(self, pattern, most_s):
        """Records output until it contains a pattern; returns what matched."""
        seen, end_s = "", time.monotonic() + most_s
        while not (found := re.search(pattern, seen)):
            assert time.monotonic() < end_s, f"no {pattern!r} in {seen[-500:]!r}"
            if not select.select([self.terminal], [], [], 1)[0]:
                continue
            at_s = time.monotonic() - self.start_s
            time.sleep(EVENT_S)
            text = os.read(self.terminal, 65536).decode(errors="replace")
            seen += text
            self.events.append([round(at_s, 2), "o", text.replace(self.folder, "~")])
        return found

    def type(self, keys):
        """Types text."""
        os.write(self.terminal, keys.encode())


def record(folder, repository):
    """Types the commands, and returns the recorded events."""
    recorder = Recorder(folder, repository)
    recorder.until(re.escape(PROMPT), 10)
    for command in COMMANDS:
        time.sleep(0.5)
        recorder.type(command + "\r")
        if " view " in command:
            address = recorder.until(VIEWER, 600).group()
            with urllib.request.urlopen(address) as answer:
                assert answer.status == 200, answer.status
            recorder.type("\x03")
            # The shell goes on behind the echo of Ctrl-C.
            recorder.until(r"\^C\s*" + re.escape(PROMPT), 60)
        else:
            recorder.until(r"\n" + re.escape(PROMPT), 7200)
    recorder.type("echo status $?\r")
    status = recorder.until(r"status (\d+)\r", 10).group(1)
    assert status == "0", f"the last command ended with {status}"
    return recorder.events[:-1]


def main():
    """Writes the recording."""
    parser = argparse.ArgumentParser()
    parser.add_argument("recording", type=Path)
    parser.add_argument("--repository", default=str(Path(__file__).resolve().parents[2]))
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        events = record(Path(folder), chosen.repository)
    text = "".join(event for _, _, event in events)
    assert "wrote out/demo" in text, text[-2000:]
    header = {"version": 2, "width": COLUMNS, "height": ROWS, "idle_time_limit": 0.5, "title": "wavex, from clone to viewer"}
    chosen.recording.write_text("".join(json.dumps(line) + "\n" for line in [header, *events]))


if __name__ == "__main__":
    sys.exit(main())
