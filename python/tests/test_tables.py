"""Tables as mappings, and in the hands of pandas, Polars, DuckDB and PyArrow, as users type it."""

import importlib.metadata

import numpy as np
import pytest

import wavex

COLUMNS = ["shot", "channel", "range_m", "range_sd_m", "amplitude_db"]


def library(name: str):
    """A library of `requirements.txt`; where it cannot be installed, the test is skipped loudly."""
    return pytest.importorskip(name, reason=f"SKIPPED: {name} is not installed; `pip install {name}`")


@pytest.fixture(scope="module")
def table(flight, model):
    """Some columns of the returns."""
    return wavex.decompose(flight, model, columns=COLUMNS).read_all()


@pytest.fixture
def reader(flight, model):
    """The same, not yet read."""
    return wavex.decompose(flight, model, columns=COLUMNS)


def test_a_table_is_a_mapping_of_columns(table):
    assert list(table) == table.keys() == table.column_names == COLUMNS
    assert "range_m" in table and "colour" not in table and 5 not in table
    assert [name for name, _ in table.items()] == COLUMNS
    assert all(len(values) == len(table) for values in table.values())
    np.testing.assert_array_equal(table.get("range_m"), table["range_m"])
    assert table.get("colour") is None and table.get("colour", 7) == 7
    copy = dict(table)
    np.testing.assert_array_equal(copy["shot"], table["shot"])
    with pytest.raises(KeyError, match="no column colour; columns: shot, channel"):
        table["colour"]


def test_the_length_of_a_table_is_its_rows(table):
    assert len(table) == len(table["shot"]) > 4000 and len(table.keys()) == 5


def test_vectors_are_arrays_of_two_dimensions(flight):
    shots = flight.shots(columns=["shot", "origin", "direction"]).read_all()
    assert shots["origin"].shape == shots["direction"].shape == (4000, 3)
    np.testing.assert_array_equal(shots["origin"][1234], flight.shot(1234).origin_m)


def test_frames_of_pandas(flight, table, reader):
    pandas = library("pandas")
    frame = reader.to_pandas()
    assert list(frame.columns) == COLUMNS and len(frame) == len(table)
    pandas.testing.assert_frame_equal(frame, table.to_pandas())
    pandas.testing.assert_frame_equal(frame, pandas.DataFrame(dict(table)))
    np.testing.assert_array_equal(frame["range_m"], table["range_m"])
    assert frame.groupby("channel")["range_sd_m"].median().gt(0).all()
    shots = flight.shots(columns=["shot", "origin", "facet"]).to_pandas()
    assert list(shots.columns) == ["shot", "origin_x", "origin_y", "origin_z", "facet"]


def test_frames_of_pandas_by_arrow(flight, model, table):
    pandas = library("pandas")
    library("pyarrow")
    assert len(pandas.DataFrame.from_arrow(table)) == len(table)
    assert len(wavex.decompose(flight, model).to_arrow().read_pandas()) == len(table)


def test_pandas_does_not_make_a_frame_of_names(table, reader):
    pandas = library("pandas")
    with pytest.raises(wavex.DataError, match=r"a table is not an array; use `table.to_pandas\(\)`"):
        pandas.DataFrame(table)
    with pytest.raises(wavex.DataError, match=r"a reader is not an array; use `reader.to_pandas\(\)`"):
        pandas.DataFrame(reader)


def test_lists_have_no_place_in_pandas(flight):
    library("pandas")
    with pytest.raises(wavex.DataError, match=r"column blocks: lists .*`to_polars\(\)`.*`Recording.waveforms\(\)`"):
        flight.shots().to_pandas()


def test_frames_of_polars(flight, table, reader):
    polars = library("polars")
    frame = reader.to_polars()
    assert frame.columns == COLUMNS and frame.height == len(table)
    assert frame.equals(table.to_polars()) and frame.equals(polars.DataFrame(table))
    assert frame.equals(polars.from_arrow(table.to_arrow()))
    # Without a class of PyArrow, Polars makes a series of structs.
    assert frame.equals(polars.from_arrow(table).struct.unnest())
    assert frame.filter(polars.col("range_sd_m") < 0.01).height > 0
    assert flight.shots().to_polars().explode("blocks").unnest("blocks").height > 4000


def test_polars_takes_a_reader_as_it_is(flight, model, table):
    polars = library("polars")
    assert polars.DataFrame(wavex.decompose(flight, model)).height == len(table)
    assert polars.from_arrow(wavex.decompose(flight, model).to_arrow()).height == len(table)


def test_tables_of_several_batches(flight, model):
    polars, duckdb = library("polars"), library("duckdb")
    waveforms = flight.waveforms()
    samples = np.tile(waveforms.samples, (3, 1))
    lengths = np.tile(waveforms.lengths, 3)
    # Each task of 8192 waveforms makes a batch.
    found = wavex.decompose_samples(samples, 0.0, model, lengths=lengths)
    assert len(samples) > 8192
    for rows in [len(found["time_ns"]), polars.DataFrame(found).height, found.to_arrow().num_rows]:
        assert rows == len(found)
    assert duckdb.sql("select count(*) from found").fetchall() == [(len(found),)]


def test_duckdb_finds_tables_and_readers_by_name(flight, model, table):
    duckdb = library("duckdb")
    query = "select channel, count(*), median(range_sd_m) from {} where amplitude_dn > 20 group by channel"
    returns = wavex.decompose(flight, model)
    from_reader = duckdb.sql(query.format("returns")).fetchall()
    every = wavex.decompose(flight, model).read_all()
    frame = every.to_polars()
    arrow = every.to_arrow()
    assert from_reader[0][1] > 2000 and len(every) == len(frame) == len(arrow)
    for name in ["every", "frame", "arrow"]:
        assert duckdb.sql(query.format(name)).fetchall() == from_reader
    assert len(duckdb.sql("select * from every").df()) == len(table)


@pytest.mark.parametrize(("name", "call"), [("pandas", "to_pandas"), ("polars", "to_polars")])
def test_a_missing_library_is_named(table, reader, monkeypatch, name, call):
    from wavex import _frames

    def missing(wanted):
        raise ModuleNotFoundError(f"No module named '{wanted}'", name=wanted)

    monkeypatch.setattr(_frames, "import_module", missing)
    for source in [table, reader]:
        with pytest.raises(ImportError, match=f"{name} is not installed; run `pip install {name}`"):
            getattr(source, call)()


def test_an_error_inside_a_library_is_not_hidden(table, monkeypatch):
    from wavex import _frames

    def broken(wanted):
        raise ModuleNotFoundError("No module named 'numexpr'", name="numexpr")

    monkeypatch.setattr(_frames, "import_module", broken)
    with pytest.raises(ModuleNotFoundError, match="numexpr"):
        table.to_pandas()


def test_versions_are_current():
    wanted = {"duckdb": 2, "pandas": 3, "polars": 2, "pyarrow": 26}
    for name, major in wanted.items():
        library(name)
        assert int(importlib.metadata.version(name).split(".")[0]) >= major, name
