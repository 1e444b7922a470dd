"""Recordings, scan lines, shots and samples."""

import pickle
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.ipc
import pytest

import wavex


def test_info_has_metadata_and_counts(flight):
    info = flight.info
    assert (info.lines, info.shots) == (20, 4000)
    assert info.shot_range == (0, 3999)
    assert info.sampling_interval_ns == 1.0
    assert "low" in info.channels
    first, last = info.time_span_s
    assert first < last


def test_a_shot_has_its_samples_without_a_copy(flight):
    shot = flight.shot(1234)
    assert shot.number == 1234
    samples = shot.samples["low"]
    assert samples.dtype == np.uint16 and samples.ndim == 1 and len(samples) > 10
    assert not samples.flags.writeable and not samples.flags.owndata
    assert isinstance(shot.t0_ns["low"], float)
    block = next(block for block in shot.blocks if block.channel == "low")
    assert block.t0_ns == shot.t0_ns["low"]
    np.testing.assert_array_equal(block.samples, samples)
    kept = samples.copy()
    del shot, block
    np.testing.assert_array_equal(samples, kept)


def test_lines_are_a_sequence(flight):
    lines = flight.lines
    assert isinstance(lines, Sequence) and len(lines) == 20
    assert lines[-1].number == 19 and len(lines[7]) == 200
    assert lines[7][-1].number == 7 * 200 + 199
    assert sum(len(line) for line in lines) == 4000
    with pytest.raises(IndexError, match="no line 20 of 20"):
        lines[20]


def test_shots_are_those_of_the_file(flight):
    table = flight.shots().to_arrow().read_all()
    with pa.ipc.open_file(flight.path) as file:
        written = file.read_all()
    assert table.schema.equals(written.schema, check_metadata=True)
    assert table.equals(written)


def test_columns_are_chosen(flight):
    table = flight.shots(columns=["shot", "gps_time_s"]).to_arrow().read_all()
    assert table.column_names == ["shot", "gps_time_s"] and len(table) == 4000
    with pytest.raises(wavex.DataError, match="there is no column `shots`; columns: shot, line"):
        flight.shots(columns=["shots"])


def test_a_line_is_a_table(flight):
    table = flight.lines[3].table()
    assert len(table) == 200
    np.testing.assert_array_equal(table["shot"], np.arange(600, 800))
    assert pa.table(table).num_rows == 200


def test_truth_of_a_simulated_recording(flight):
    assert flight.truth.num_rows > 4000


def test_a_temporary_recording_is_deleted():
    recording = wavex.simulate(lines=1, shots_per_line=10)
    path = Path(recording.path)
    assert path.exists()
    del recording
    assert not path.exists()


def test_a_recording_is_pickled_by_its_path(flight):
    again = pickle.loads(pickle.dumps(flight))
    assert again.info.shots == 4000


def test_errors_name_file_and_remedy(tmp_path):
    with pytest.raises(wavex.ReadError) as missing:
        wavex.open(tmp_path / "none.pls")
    assert missing.value.path.endswith("none.pls")
    with pytest.raises(wavex.ReadError, match="unknown recording format; supported extensions"):
        wavex.open(tmp_path / "a.dat")
    broken = tmp_path / "broken.las"
    broken.write_bytes(b"LASF" + bytes(50))
    with pytest.raises(wavex.ReadError) as error:
        wavex.open(broken)
    assert error.value.path == str(broken) and error.value.remedy
    with pytest.raises(wavex.JobError, match="has no key `colour`"):
        wavex.open(broken, colour="red")
    with pytest.raises(wavex.JobError, match="a value of type object cannot be part of a job"):
        wavex.open(broken, path_=object())
    assert issubclass(wavex.ReadError, wavex.Error)


def test_an_unknown_shot_is_a_key_error(flight):
    with pytest.raises(KeyError, match="no shot 4000; the 4000 shots are numbered 0 to 3999"):
        flight.shot(4000)
