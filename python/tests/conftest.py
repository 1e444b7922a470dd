"""Recordings and jobs that all tests use."""

from pathlib import Path

import pytest

import wavex

JOB = """
[job]
output_dir = "out"

[[stage]]
type = "read_arrow"
path = "flight.arrow"
[[stage]]
type = "calibrate"
save = "*_model.json"
[[stage]]
type = "decompose"
[[stage]]
type = "write_table"
path = "*_returns.arrow"
[[stage]]
type = "georeference"
[[stage]]
type = "write_las"
path = "*.laz"
"""


@pytest.fixture(scope="session")
def flight(tmp_path_factory: pytest.TempPathFactory) -> wavex.Recording:
    """Simulated recording of 20 lines of 200 shots."""
    folder = tmp_path_factory.mktemp("flight")
    return wavex.simulate(folder / "flight.arrow", lines=20, shots_per_line=200)


@pytest.fixture(scope="session")
def model(flight: wavex.Recording) -> wavex.SensorModel:
    """Sensor model of the recording."""
    return wavex.calibrate(flight)


@pytest.fixture
def folder(flight: wavex.Recording, tmp_path: Path) -> Path:
    """Folder with the recording and a job for it."""
    (tmp_path / "flight.arrow").symlink_to(Path(flight.path))
    (tmp_path / "job.toml").write_text(JOB)
    return tmp_path
