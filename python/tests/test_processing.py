"""Calibration, decomposition, explanation."""

import json
import os
import pickle
from pathlib import Path

import numpy as np
import polars as pl
import pyarrow as pa
import pyarrow.ipc
import pytest

import wavex


def test_a_model_is_that_of_the_stage(folder, flight, model):
    wavex.run(folder / "job.toml")
    path = folder / "out" / "flight_model.json"
    assert model.to_json() == path.read_text()
    assert wavex.SensorModel.load(path) == model
    assert pickle.loads(pickle.dumps(model)) == model
    assert json.loads(model.to_json())["low_power"]["noise_sd_dn"] == model.noise_sd_dn()


def test_a_model_has_its_response(model):
    time_ns, value = model.response("low")
    assert value.max() == pytest.approx(1.0, abs=0.01)
    above = time_ns[value >= 0.5]
    assert above[-1] - above[0] == pytest.approx(model.pulse_fwhm_ns("low"), abs=0.3)
    with pytest.raises(wavex.DataError, match="there is no channel `middle`; channels: low"):
        model.response("middle")
    with pytest.raises(wavex.ReadError, match="not a sensor model"):
        wavex.SensorModel.from_json("{")


def test_returns_equal_write_table(folder, flight, model):
    wavex.run(folder / "job.toml")
    with pa.ipc.open_file(folder / "out" / "flight_returns.arrow") as file:
        written = file.read_all()
    for reader in [wavex.decompose(flight), wavex.decompose(flight, model)]:
        returns = reader.to_arrow().read_all()
        assert returns.schema.equals(written.schema, check_metadata=True)
        assert returns.equals(written) or all(
            np.array_equal(returns[name].to_numpy(), written[name].to_numpy(), equal_nan=True)
            for name in returns.column_names
            if name != "channel"
        )


def test_returns_go_to_other_libraries(flight, model):
    frame = pl.DataFrame(wavex.decompose(flight, model, columns=["shot", "range_m"], mode="fastest"))
    assert frame.columns == ["shot", "range_m"] and frame.height > 4000
    duckdb = pytest.importorskip("duckdb")
    returns = wavex.decompose(flight, model).to_arrow()
    assert duckdb.sql("select count(*) from returns").fetchall()[0][0] > 4000
    reader = wavex.decompose(flight, model)
    assert duckdb.sql("select count(*) from reader").fetchall()[0][0] > 4000


def test_a_reader_is_exported_once_it_is_read_and_is_no_array(flight, model):
    reader = wavex.decompose(flight, model, columns=["shot"], mode="fastest")
    reader.__arrow_c_stream__()
    assert pl.DataFrame(reader).height > 4000
    with pytest.raises(wavex.DataError, match=r"a reader is not an array; use `reader.to_pandas\(\)`"):
        np.asarray(wavex.decompose(flight, model))


def test_pictures_are_svg(flight, model, tmp_path):
    explanation = wavex.explain(flight, 5, model)
    explanation.save(tmp_path / "e.SVG")
    with pytest.raises(wavex.DataError, match="e.png: the picture is SVG"):
        explanation.save(tmp_path / "e.png")


def test_batches_are_iterated_and_closed(flight, model):
    with wavex.decompose(flight, model) as returns:
        rows = sum(len(batch) for batch in returns)
    assert rows == len(wavex.decompose(flight, model).read_all())
    reader = wavex.decompose(flight, model)
    reader.close()
    assert list(reader) == []
    with pytest.raises(wavex.DataError, match="the reader is closed or was handed to another library"):
        reader.read_all()


def test_points_have_coordinates(flight, model):
    points = wavex.decompose(flight, model, georeference=True).read_all()
    assert np.isfinite(points["x"]).all()


def test_keys_are_checked(flight, model):
    with pytest.raises(wavex.JobError) as error:
        wavex.decompose(flight, model, mode="quick")
    assert "fastest" in str(error.value) and error.value.line >= 1 and error.value.column >= 1
    assert error.value.errors[0]["problem"] == error.value.problem


def test_a_shot_is_explained(flight, model):
    explained = wavex.explain(flight, 557, model)
    assert explained._repr_svg_().startswith("<svg") or "<svg" in explained.svg
    assert explained.shot == 557 and len(explained.returns) >= 1
    block = explained.blocks[0]
    assert len(block.samples) == len(block.fitted) == len(block.residual) == len(explained.residual)
    of_shot = wavex.decompose(flight, model).read_all()
    rows = of_shot["shot"] == 557
    np.testing.assert_allclose(explained.returns["range_m"], of_shot["range_m"][rows], rtol=0, atol=0)
    with pytest.raises(wavex.JobError, match="no shot 99999"):
        wavex.explain(flight, 99999, model)


def test_a_large_footprint_needs_no_model(model):
    granule = Path(__file__).parents[2] / "crates/wavex-hdf5/tests/data/gedi_product.h5"
    with pytest.raises(wavex.Error, match="learnt from their beam; leave out `model`"):
        wavex.explain(granule, 3, model)
    with pytest.raises(wavex.Error, match="0 shots have a recorded outgoing pulse"):
        wavex.explain(granule, 3)


def test_samples_of_large_footprints_are_floats():
    granule = Path(os.environ.get("WAVEX_DATA", "/nowhere")) / "gedi" / "gedi_l1b.h5"
    if not granule.exists():
        pytest.skip("WAVEX_DATA not set")
    recording = wavex.open(granule)
    samples = recording.lines[0][0].samples["low"]
    assert samples.dtype == np.float32 and np.any(samples % 1 != 0)
    waveforms = recording.waveforms("low")
    assert waveforms.samples.dtype == np.float32
    assert np.array_equal(waveforms.samples[0][waveforms.mask[0]], samples)


def test_a_large_footprint_is_explained():
    granule = Path(os.environ.get("WAVEX_DATA", "/nowhere")) / "gedi" / "gedi_l1b.h5"
    if not granule.exists():
        pytest.skip("SKIPPED: WAVEX_DATA has no GEDI granule")
    explained = wavex.explain(granule, 19640522900108417)
    assert explained.shot == 19640522900108417 and "BEAM0101" in str(explained)
    assert len(explained.returns) == 1 and len(explained.blocks) == 0
    assert "height above the ground, m" in explained.svg
