"""Samples of many shots as one matrix."""

import numpy as np
import pytest

import wavex


def test_rows_are_the_blocks_of_shots(flight):
    waveforms = flight.waveforms(lines=slice(3, 5))
    assert waveforms.channel == "low" and len(waveforms) == len(waveforms.shot) >= 400
    assert waveforms.samples.dtype == np.uint16 and waveforms.mask.dtype == bool
    n, m = waveforms.samples.shape
    assert waveforms.mask.shape == (n, m) and waveforms.time_ns.shape == (m,)
    np.testing.assert_array_equal(waveforms.time_ns, np.arange(m) * 1.0)
    np.testing.assert_array_equal(waveforms.mask.sum(axis=1), waveforms.lengths)
    row = 0
    for line in flight.lines[3], flight.lines[4]:
        for shot in line:
            for block in shot.blocks:
                if block.channel == "low":
                    np.testing.assert_array_equal(waveforms.samples[row][waveforms.mask[row]], block.samples)
                    assert waveforms.shot[row] == shot.number and waveforms.t0_ns[row] == block.t0_ns
                    assert waveforms.gain[row] == block.gain
                    row += 1
    assert row == n
    assert not waveforms.samples[~waveforms.mask].any()
    assert repr(waveforms) == f"<wavex.Waveforms low: {n} of up to {m} samples>"


def test_lines_and_channels_are_chosen(flight):
    with_echo = {shot.number for line in flight.lines for shot in line if "low" in shot.samples}
    assert set(flight.waveforms().shot.tolist()) == with_echo
    for lines in [[2, -1], range(2, 20, 17), slice(2, None, 17)]:
        shots = flight.waveforms(lines=lines).shot.tolist()
        assert set(shots) == {shot for shot in with_echo if shot // 200 in [2, 19]}
    outgoing = flight.waveforms("reference", lines=[0])
    np.testing.assert_array_equal(outgoing.samples[7], flight.shot(7).samples["reference"])
    with pytest.raises(IndexError, match="no line 20 of 20"):
        flight.waveforms(lines=[20])


def test_a_missing_channel_is_an_error(flight):
    with pytest.raises(wavex.DataError, match="2 lines have no samples of the channel `middle`; .*: low") as error:
        flight.waveforms("middle", lines=[0, 1])
    assert error.value.problem and error.value.remedy.startswith("channels of the first line")
    with pytest.raises(wavex.DataError, match="0 lines have no samples"):
        flight.waveforms(lines=[])


def test_several_sampling_intervals_are_an_error(flight, tmp_path):
    pa = pytest.importorskip("pyarrow")
    import pyarrow.ipc

    with pa.ipc.open_file(flight.path) as file:
        batch = file.get_batch(0)
    frame = batch.to_pylist()
    for block in frame[5]["blocks"]:
        block["interval_ns"] = 2.0
    path = tmp_path / "two.arrow"
    with pa.ipc.new_file(path, batch.schema) as file:
        file.write_batch(pa.RecordBatch.from_pylist(frame, batch.schema))
    recording = wavex.open(path)
    with pytest.raises(wavex.DataError, match="sampling intervals of 1, 2 ns, a matrix has one"):
        recording.waveforms()


def test_a_dataset_of_xarray(flight):
    pytest.importorskip("xarray", reason="SKIPPED: xarray is not installed; `pip install xarray`")
    waveforms = flight.waveforms(lines=[0])
    dataset = waveforms.to_xarray()
    assert dict(dataset.sizes) == {"waveform": len(waveforms), "time_ns": len(waveforms.time_ns)}
    assert dataset.attrs == {"channel": "low"} and dataset.time_ns.attrs["units"] == "ns"
    recorded = dataset.samples.where(dataset.mask)
    np.testing.assert_array_equal(recorded.count("time_ns"), waveforms.lengths)
    np.testing.assert_array_equal(recorded.max("time_ns"), waveforms.samples.max(axis=1))


def test_xarray_that_is_missing_is_named(flight, monkeypatch):
    from wavex import _frames

    def missing(wanted):
        raise ModuleNotFoundError(f"No module named '{wanted}'", name=wanted)

    monkeypatch.setattr(_frames, "import_module", missing)
    with pytest.raises(ImportError, match="xarray is not installed; run `pip install xarray`"):
        flight.waveforms(lines=[0]).to_xarray()


def test_a_matrix_is_decomposed_with_its_lengths(flight, model):
    waveforms = flight.waveforms(lines=slice(0, 5))
    found = wavex.decompose_samples(waveforms.samples, waveforms.t0_ns, model, lengths=waveforms.lengths)
    blocks = [b for n in range(5) for shot in flight.lines[n] for b in shot.blocks if b.channel == "low"]
    pa = pytest.importorskip("pyarrow")
    lists = pa.array([block.samples.tolist() for block in blocks], pa.list_(pa.uint16()))
    expected = wavex.decompose_samples(lists, waveforms.t0_ns, model)
    for name in expected:
        np.testing.assert_array_equal(found[name], expected[name])
