"""A simulated survey of twelve strips, its commands from the documents, and its products."""

import hashlib
import os
import re
import subprocess
import sys
import time
from pathlib import Path

STRIPS = [f"strip{number:02}" for number in range(1, 13)]
# A strip that is cut off, and what is left of it, bytes.
DAMAGED, LEFT_BYTES = "strip07", 3000

MAKE = """
[job]
report = ""
log = ""
stat_log = ""
[[stage]]
type = "simulate"
stem = "a"
lines = 6
shots_per_line = 60
[[stage]]
type = "write_arrow"
path = "in/*.arrow"
"""

# Little memory, so that a task that exceeds it need not take much.
SURVEY = """
[job]
output_dir = "out"
report_page = true
survey_page = true
memory_mb = 64
model = "MODEL"
[[stage]]
type = "read_arrow"
path = "in/*.arrow"
[[stage]]
type = "calibrate"
waveforms = 300
[[stage]]
type = "decompose"
mode = "fastest"
[[stage]]
type = "georeference"
[[stage]]
type = "write_las"
path = "*.laz"
[[stage]]
type = "write_lstat"
[[stage]]
type = "write_table"
path = "*.parquet"
"""

# Strips in opposite directions and one across, over hills with houses.
FLIGHTS = [("a", 0.0, "[0.0, 0.0]"), ("b", 180.0, "[-30.0, 80.0]"), ("c", 90.0, "[-40.0, 40.0]")]

FLY = """
[job]
report = ""
log = ""
stat_log = ""
[[stage]]
type = "simulate"
stem = "a"
scene_seed = 1
lines = 90
shots_per_line = 120
landscape = "country"
wood_ratio = 0.1
water_ratio = 0.0
wire_height_m = 0.0
house_ratio = 0.3
flying_height_m = 120
speed_mps = 25
pulse_rate_hz = 7000
roll_deg = 2.0
pitch_deg = 2.0
motion_period_s = 3.0
boresight_deg = [0.2, -0.3, 0.4]
sbet = "in/*.out"
[[stage]]
type = "write_arrow"
path = "in/*.arrow"
"""

ALIGNED = """
[job]
output_dir = "out"
[job.geometry]
trajectory = "in/*.out"
[[stage]]
type = "read_arrow"
path = "in/*.arrow"
[[stage]]
type = "calibrate"
waveforms = 300
[[stage]]
type = "decompose"
mode = "fastest"
[[stage]]
type = "georeference"
[[stage]]
type = "write_patches"
[[stage]]
type = "write_las"
path = "*.laz"
"""

DOCUMENT = Path(__file__).parents[2] / "docs" / "how-to" / "cluster.md"


def commands(name):
    """Commands of the block with this name in the document."""
    blocks = re.findall(r"```sh (\w+)\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    return next(text for other, text in blocks if other == name).strip().splitlines()


class Folder:
    """A folder with the programs that its commands find first."""

    def __init__(self, folder, wavex):
        self.folder = Path(folder)
        self.programs = self.folder / "bin"
        self.programs.mkdir(parents=True)
        (self.programs / "wavex").symlink_to(wavex)

    def write(self, name, text):
        (self.folder / name).write_text(text, encoding="utf-8")

    def environment(self):
        # Snakemake is next to the Python that runs this.
        folders = [str(self.programs), str(Path(sys.executable).parent), os.environ["PATH"]]
        return {**os.environ, "PATH": ":".join(folders)}

    def wavex(self, *arguments, expected=0):
        """Runs wavex; returns standard output and standard error."""
        command = [self.programs / "wavex", "--quiet", *arguments]
        done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True, check=False)
        if done.returncode != expected:
            raise RuntimeError(f"{command} ended with {done.returncode}: {done.stderr}")
        return done.stderr

    def start(self, command, more=""):
        """Starts a command of the document in a process group of its own."""
        log = open(self.folder / "commands.log", "a", encoding="utf-8")
        line = f"{command} {more}".strip()
        log.write(f"\n$ {line}\n")
        log.flush()
        return subprocess.Popen(
            ["bash", "-c", f"exec {line}"], cwd=self.folder, env=self.environment(), stdout=log,
            stderr=subprocess.STDOUT, start_new_session=True)

    def run(self, name, more=""):
        """Runs the commands of a block of the document; returns their exit codes."""
        return [self.start(command, more).wait(timeout=300) for command in commands(name)]

    def log(self):
        log = self.folder / "commands.log"
        return log.read_text(encoding="utf-8") if log.exists() else ""

    def remove(self, *names):
        subprocess.run(["rm", "-rf", *names], cwd=self.folder, check=True)

    def products(self):
        """Digests of the products by name."""
        out = self.folder / "out"
        files = [*out.glob("strip*"), out / "survey.html", out / "survey.json", *out.glob("survey_*.tif")]
        return {file.name: hashlib.sha256(file.read_bytes()).hexdigest()
                for file in files if not file.name.endswith(".log")}

    def times(self):
        """Inodes and times of the products of complete tasks; both change if a file is made again."""
        complete = {file.name.removesuffix("_report.json")
                    for file in (self.folder / "plan" / "reports").glob("*_report.json")}
        states = {}
        for file in (self.folder / "out").glob("strip*"):
            if file.name[:7] in complete - {DAMAGED} and not file.name.endswith(".log"):
                about = file.stat()
                states[file.name] = (about.st_ino, about.st_mtime_ns)
        return states

    def results(self, archive):
        """Digests of everything in an archive that does not depend on time and machine."""
        return (self.folder / "archives" / archive / "results.b3").read_text(encoding="utf-8")

    def marks(self):
        """Tasks that Snakemake has seen complete."""
        return sorted(file.name for file in (self.folder / "plan" / "done").glob("*"))


def wait_until(what, holds, seconds=120):
    """Waits for a condition."""
    end = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > end:
            raise TimeoutError(f"no {what} in {seconds} s")
        time.sleep(0.2)


class Survey(Folder):
    """A survey of twelve strips, one of them damaged."""

    def __init__(self, folder, wavex, model="survey"):
        super().__init__(folder, wavex)
        self.write("make.toml", MAKE)
        self.write("survey.toml", SURVEY.replace("MODEL", model))
        for seed, strip in enumerate(STRIPS, start=1):
            self.wavex("run", "make.toml", "--set", f"simulate.stem={strip}", "--set", f"simulate.seed={seed}")
        self.whole = self.recording(DAMAGED).read_bytes()
        self.recording(DAMAGED).write_bytes(self.whole[:LEFT_BYTES])

    def recording(self, strip):
        return self.folder / "in" / f"{strip}.arrow"

    def repair(self):
        self.recording(DAMAGED).write_bytes(self.whole)


class AlignedSurvey(Folder):
    """Three overlapping strips with trajectories."""

    def __init__(self, folder, wavex):
        super().__init__(folder, wavex)
        self.write("make.toml", FLY)
        self.write("survey.toml", ALIGNED)
        for seed, (strip, direction_deg, offset_m) in enumerate(FLIGHTS):
            settings = {"stem": strip, "seed": seed, "track_direction_deg": direction_deg,
                        "track_offset_m": offset_m, "start_time_s": 208_800 + 100 * seed}
            sets = [word for key, value in settings.items() for word in ("--set", f"simulate.{key}={value}")]
            self.wavex("run", "make.toml", *sets)
