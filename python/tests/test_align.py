"""Alignment of a simulated survey."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import wavex

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "align-a-survey.md"
COMMAND = Path(sys.executable).parent / "wavex"

JOB = """
[job]
output_dir = "out"
report = ""
log = ""
stat_log = ""
[job.geometry]
trajectory = "*.out"
[[stage]]
type = "read_arrow"
path = "strip_?.arrow"
[[stage]]
type = "calibrate"
waveforms = 2000
response = "gaussian"
[[stage]]
type = "decompose"
mode = "fastest"
[[stage]]
type = "georeference"
"""


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with two strips in opposite directions, and a job."""
    folder = tmp_path_factory.mktemp("survey")
    for number, direction_deg in enumerate([0.0, 180.0]):
        keys = {
            "stem": f"strip_{number}", "scene_seed": 1, "seed": number, "lines": 60, "shots_per_line": 120,
            "landscape": "country", "wood_ratio": 0.0, "water_ratio": 0.0, "wire_height_m": 0.0,
            "house_ratio": 0.0, "flying_height_m": 120.0, "speed_mps": 25.0, "pulse_rate_hz": 7000.0,
            "track_direction_deg": direction_deg, "track_offset_m": [-30.0 * number, 40.0 * number],
            "start_time_s": 208800.0 + 100 * number, "boresight_deg": [0.2, 0.0, 0.0], "noise_sd_dn": 0.5,
            "noise_autocorrelation": [], "response": "gaussian", "sbet": "*.out",
        }
        stages = [{"type": "simulate", **keys}, {"type": "write_arrow"}]
        wavex.run(wavex.Job(stages, folder=folder, report="", log="", stat_log=""))
    (folder / "survey.toml").write_text(JOB)
    return folder


def test_an_alignment_is_tables(survey):
    found = wavex.align(survey / "survey.toml", survey / "aligned")
    assert found.verdict == "good" and found.warnings == []
    parameters = found.parameters
    roll = list(parameters["name"]).index("boresight_roll_rad")
    assert parameters["treatment"][roll] == "estimated"
    assert abs(parameters["value"][roll] - np.radians(0.2)) < 5 * parameters["sd"][roll] < 1.5e-4
    down = list(parameters["name"]).index("lever_down_m")
    assert parameters["treatment"][down] == "not_estimable" and "control points" in parameters["reasons"][down]
    place = found.covariance_names.index("boresight_roll_rad")
    n = len(found.covariance_names)
    assert found.covariance.shape == (n, n) and np.all(found.covariance == found.covariance.T)
    assert np.isclose(found.covariance[place, place], parameters["sd"][roll] ** 2)
    assert np.linalg.eigvalsh(found.covariance / np.max(found.covariance)).min() > -1e-9
    residuals, overlaps = found.residuals, found.overlaps
    assert len(residuals) == overlaps["pairs"].sum()
    assert (~residuals["used"]).sum() == overlaps["rejected_pairs"].sum()
    used = np.abs(residuals["difference_after_m"][residuals["used"]])
    assert np.isclose(1.4826 * np.sort(used)[len(used) // 2], overlaps["spread_after_m"][0])
    assert np.median(np.abs(residuals["difference_before_m"])) > 5 * np.median(used)
    assert list(found.strips["name"]) == ["strip_0", "strip_1"] and len(found.corrections) == 2
    assert {Path(path).name for path in found.files} == {
        "calibration.toml", "corrections.toml", "residuals.arrow", "align.json", "align.html"
    }
    assert "verdict: good" in str(found)
    assert set(found.correlations) == {"first", "second", "correlation"}
    # The files are those of the command, byte for byte; report and page have paths as given.
    command = [COMMAND, "--quiet", "align", survey / "survey.toml", "-o", "other"]
    subprocess.run(command, cwd=survey, check=True)
    for path in map(Path, found.files):
        assert path.read_bytes() == (survey / "other" / path.name).read_bytes(), path.name
    import pyarrow.ipc

    with pyarrow.ipc.open_file(survey / "aligned/residuals.arrow") as file:
        assert file.read_all().equals(residuals.to_arrow())


def test_errors_are_those_of_the_command(survey):
    def command(*arguments):
        ended = subprocess.run(
            [COMMAND, "--quiet", "align", "survey.toml", *arguments], cwd=survey, capture_output=True, text=True
        )
        assert ended.returncode != 0
        return ended.stderr

    with pytest.raises(wavex.JobError, match="compares strips") as error:
        wavex.align(survey / "survey.toml", survey / "none", set={"read_arrow.path": "strip_0.arrow"})
    text = command("-o", "none", "--set", "read_arrow.path=strip_0.arrow")
    assert str(error.value).rsplit("survey.toml: ")[-1] in text and error.value.remedy
    with pytest.raises(wavex.RunError, match="the alignment is bad") as error:
        wavex.align(survey / "survey.toml", survey / "bad", set={"job.geometry.mount": [0, 0, 180]})
    assert str(error.value) in command("-o", "bad_too", "--set", "job.geometry.mount=[0,0,180]")
    assert 'class="badge bad">bad' in (survey / "bad/align.html").read_text()
    with pytest.raises(wavex.JobError, match="none, constant, linear"):
        wavex.align(survey / "survey.toml", survey / "none", trajectory="wild")
    assert not (survey / "none").exists()
    splines = wavex.align(survey / "survey.toml", survey / "splines", trajectory=2)
    assert len(splines.corrections) > 2
    kept = wavex.align(survey / "survey.toml", survey / "kept", trajectory="none")
    assert len(kept.corrections) == 0 and "time_s" in kept.corrections


def test_constraints_are_those_of_the_command(survey):
    def refused(match, **constraints):
        with pytest.raises(wavex.JobError, match=match):
            wavex.align(survey / "survey.toml", survey / "none", **constraints)

    refused("`estimate` has no parameter e0; give e1", estimate=["e0"])
    refused("there is no strip `strip_7` for `--reference`; the strips are strip_0, strip_1", reference=["strip_7"])
    fixed = wavex.align(survey / "survey.toml", survey / "fixed", reference=["strip_0"], estimate=["e2"])
    treatments = dict(zip(fixed.parameters["name"], fixed.parameters["treatment"]))
    assert "e2" in treatments and "e3" not in treatments
    offsets = fixed.corrections["down_m"][np.array(fixed.corrections["strip"]) == "strip_0"]
    assert np.all(offsets == 0.0)


def test_the_code_of_the_how_to_runs(survey, monkeypatch):
    pytest.importorskip("pandas", reason="SKIPPED: pandas is not installed")
    monkeypatch.chdir(survey)
    codes = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert len(codes) == 1
    seen: dict = {}
    exec(compile(codes[0], str(PAGE), "exec"), seen)
    assert seen["found"].verdict == "good" and len(seen["residuals"]) > 100
