"""Jobs, runs, Python stages and the command."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pytest

import wavex

COMMAND = Path(sys.executable).parent / "wavex"


def files(folder: Path) -> dict[str, bytes]:
    """Outputs of stages; report and log contain times."""
    skipped = {"job_report.json", "job.log", "flight_stat.log"}
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name not in skipped}


def test_run_writes_the_same_bytes_as_the_command(folder, tmp_path_factory):
    report = wavex.run(folder / "job.toml", set={"decompose.detection_sigma": 5})
    here = files(folder / "out")
    subprocess.run(
        [COMMAND, "--quiet", "run", "job.toml", "--set", "decompose.detection_sigma=5", "--set",
         'job.output_dir="other"'],
        cwd=folder,
        check=True,
    )
    assert here == files(folder / "other")
    assert {"flight.laz", "flight_returns.arrow", "flight_model.json"} <= set(here)
    assert report["files"] and all(Path(path).exists() for path in report["files"])
    assert json.loads((folder / "out" / "job_report.json").read_text())["inputs"][0]["totals"] == (
        report["inputs"][0]["totals"]
    )


def test_errors_of_a_job_have_places(folder):
    (folder / "wrong.toml").write_text("[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\ncolour = 1\n")
    with pytest.raises(wavex.JobError) as error:
        wavex.run(folder / "wrong.toml")
    assert (error.value.line, error.value.column) == (4, 1)
    assert error.value.path.endswith("wrong.toml") and error.value.problem == "`read_arrow` has no key `colour`"
    with pytest.raises(wavex.ReadError, match="no such job; check the path"):
        wavex.run(folder / "none.toml")
    with pytest.raises(wavex.ReadError) as error:
        wavex.run(folder / "job.toml", set={"read_arrow.path": "none.arrow"})
    assert error.value.path.endswith("none.arrow") and error.value.stage == "read_arrow"


def test_a_broken_input_is_a_read_error(folder):
    (folder / "broken.arrow").write_bytes(b"ARROW1\0\0" + bytes(100))
    with pytest.raises(wavex.ReadError) as error:
        wavex.run(folder / "job.toml", set={"read_arrow.path": "broken.arrow"})
    assert error.value.path.endswith("broken.arrow") and error.value.remedy
    assert error.value.stage == "read_arrow"


def job(folder: Path, *stages):
    """A job in Python with the given stages after `decompose`."""
    return wavex.Job(
        [
            {"type": "read_arrow", "path": "flight.arrow"},
            {"type": "calibrate"},
            {"type": "decompose"},
            *stages,
            {"type": "write_table", "path": "*_returns.arrow"},
        ],
        folder=folder,
        output_dir="out",
    )


def returns(folder: Path):
    import pyarrow.ipc

    with pyarrow.ipc.open_file(folder / "out" / "flight_returns.arrow") as file:
        return file.read_all()


def test_a_job_is_made_in_python(folder):
    made = job(folder)
    assert made.chain == "read_arrow -> Shots -> calibrate -> decompose -> Returns -> write_table"
    again = wavex.Job.from_toml(made.to_toml(), folder=folder)
    assert again.stages == made.stages == ["read_arrow", "calibrate", "decompose", "write_table"]
    wavex.run(again)
    assert returns(folder).num_rows > 4000
    with pytest.raises(wavex.JobError, match="neither a dictionary nor a wavex.Stage"):
        wavex.Job(["decompose"])
    with pytest.raises(wavex.JobError, match="decompose"):
        wavex.Job([{"type": "read_arrow", "path": "a.arrow"}, {"type": "write_las"}])


def test_a_mask_rejects_and_is_counted(folder):
    @wavex.stage(reason="weaker than 20 DN")
    def strong(table):
        return table["amplitude_dn"] >= 20

    wavex.run(job(folder))
    every = returns(folder)
    report = wavex.run(job(folder, strong))
    left = returns(folder)
    keep = every["amplitude_dn"].to_numpy() >= 20
    assert 0 < left.num_rows == keep.sum() < every.num_rows
    np.testing.assert_array_equal(left["range_m"], every["range_m"].filter(keep))
    stage = next(stage for stage in report["inputs"][0]["stages"] if "strong" in stage["id"])
    assert stage["rejected"] == {"returns: weaker than 20 DN": every.num_rows - left.num_rows}
    shots = left.group_by("shot").aggregate([("return_number", "max"), ("number_of_returns", "max"), ("shot", "count")])
    assert pc.all(pc.equal(shots["number_of_returns_max"], shots["shot_count"])).as_py()
    assert pc.all(pc.equal(shots["return_number_max"], shots["shot_count"])).as_py()
    assert report["inputs"][0]["totals"]["np"] == left.num_rows


def test_columns_are_changed(folder):
    @wavex.stage
    def brighter(table):
        return {"intensity": 2 * table["amplitude_dn"], "class": np.full(len(table), 5)}

    @wavex.stage
    def as_arrow(table):
        arrow = table.to_arrow()
        place = arrow.column_names.index("withheld")
        return arrow.set_column(place, "withheld", pc.greater(arrow["width_ratio"], 1.5))

    wavex.run(job(folder, brighter, as_arrow))
    table = returns(folder)
    np.testing.assert_array_equal(table["intensity"], 2 * table["amplitude_dn"].to_numpy())
    assert set(table["class"].to_pylist()) == {5}
    np.testing.assert_array_equal(table["withheld"].to_numpy(), table["width_ratio"].to_numpy() > 1.5)


@pytest.mark.parametrize(
    ("function", "problem"),
    [
        (lambda table: 1 / 0, r"failed \(line \d+\): ZeroDivisionError: division by zero"),
        (lambda table: np.ones(3), "that is no one-dimensional Boolean array"),
        (lambda table: np.ones(3, bool), "a mask of 3 values for"),
        (lambda table: {"range_m": table["range_m"] + 1}, "changed the column range_m"),
        (lambda table: {"colour": table["range_m"]}, "changed the column colour"),
        (lambda table: {"intensity": [1.0]}, "1 values of intensity for"),
        (lambda table: (1, 2, 3), "a tuple of 3"),
    ],
)
def test_wrong_stages_end_the_run(folder, function, problem):
    with pytest.raises(wavex.RunError, match=problem) as error:
        wavex.run(job(folder, wavex.stage(function, name="mine")))
    assert error.value.stage == "python:mine"
    assert not list((folder / "out").glob("*.partial"))


def test_a_stage_has_a_place_that_fits(folder):
    stage = wavex.stage(lambda table: None, name="mine")
    with pytest.raises(wavex.JobError, match="accepts Returns or Points, but receives Shots"):
        wavex.Job.from_file(folder / "job.toml").with_stage("calibrate", stage)
    wavex.run(folder / "job.toml", stages={"decompose": stage})
    with pytest.raises(wavex.JobError, match="the job has no stage `other`; stages: read_arrow"):
        wavex.run(folder / "job.toml", stages={"other": stage})


def test_the_cost_of_a_stage_is_reported(folder):
    import time

    stage = wavex.stage(lambda table: time.sleep(0.005), name="slow")
    report = wavex.run(job(folder, stage), profile=True)
    stages = {stage["id"]: stage for stage in report["inputs"][0]["stages"]}
    assert stages["python:slow"]["working_s"] >= 0.1


def test_progress_is_reported(folder):
    seen = []
    wavex.run(folder / "job.toml", progress=lambda part, shots: seen.append((part, shots)))
    assert seen[-1] == (1.0, 4000)


def test_stages_are_listed():
    assert wavex.stages()["decompose"] == "Decomposes waveforms into returns" or "decompose" in wavex.stages()
    assert "detection_sigma" in wavex.stages("decompose")
    with pytest.raises(wavex.JobError, match="there is no stage `decomp`"):
        wavex.stages("decomp")


def test_the_command_is_the_program(folder):
    done = subprocess.run([COMMAND, "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"wavex {wavex.__version__}"
    done = subprocess.run([COMMAND, "run", "none.toml"], capture_output=True, text=True, cwd=folder)
    assert done.returncode == 2 and "none.toml: cannot read the job" in done.stderr
    done = subprocess.run([sys.executable, "-m", "wavex", "stages"], capture_output=True, text=True, check=True)
    assert "decompose" in done.stdout
