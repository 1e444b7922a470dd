"""Decomposition of arrays, with arrays of every kind."""

import numpy as np
import pyarrow as pa
import pytest

import wavex

M = 60


@pytest.fixture(scope="module")
def waveforms():
    """Echoes at known positions, digitiser steps, and the positions in ns."""
    random = np.random.default_rng(1)
    position = random.uniform(20, 40, 500)
    height = random.uniform(30, 150, 500)
    k = np.arange(M)
    pulse = np.exp(-4 * np.log(2) * ((k - position[:, None]) / 4.5) ** 2)
    noise = random.normal(0, 1, (500, M))
    return np.clip(np.round(5 + height[:, None] * pulse + noise), 0, 255).astype("u2"), position


@pytest.fixture(scope="module")
def own(waveforms):
    """Model of the waveforms."""
    return wavex.calibrate_samples(waveforms[0], interval_ns=1.0, full_scale_dn=255)


def same(a, b):
    return all(np.array_equal(a[name], b[name], equal_nan=True) for name in a.column_names)


def test_positions_are_those_of_the_echoes(waveforms, own):
    samples, position = waveforms
    found = wavex.decompose_samples(samples, 100.0, own)
    single = found["number_of_returns"] == 1
    assert single.mean() > 0.97
    z = (found["time_ns"] - 100 - position[found["waveform"].astype(int)])[single] / found["time_sd_ns"][single]
    assert abs(np.median(z)) < 0.3 and 0.8 < np.percentile(np.abs(z), 68) < 1.2


def test_one_start_time_or_one_per_waveform(waveforms, own):
    samples, _ = waveforms
    each = wavex.decompose_samples(samples, np.full(500, 7.0), own)
    assert same(each, wavex.decompose_samples(samples, 7, own))
    for t0, problem in [(np.zeros(3), "3 values for 500"), (np.nan, "t0 is NaN"), ("x", "t0 cannot")]:
        with pytest.raises(wavex.DataError, match=problem):
            wavex.decompose_samples(samples, t0, own)


def test_threads_and_modes(waveforms, own):
    samples = np.tile(waveforms[0], (20, 1))
    one = wavex.decompose_samples(samples, 0, own, threads=1)
    assert same(one, wavex.decompose_samples(samples, 0, own, threads=4))
    assert len(wavex.decompose_samples(samples[:200], 0, own, mode="slow")) >= 190
    with pytest.raises(wavex.JobError, match="mode"):
        wavex.decompose_samples(samples, 0, own, mode="quick")


@pytest.mark.parametrize("dtype", ["u1", "u4", "u8", "i2", "i4", "i8", "f4", "f8", ">u2", ">f8", "<i4"])
def test_types_and_byte_orders(waveforms, own, dtype):
    samples, _ = waveforms
    expected = wavex.decompose_samples(samples, 0, own)
    assert same(wavex.decompose_samples(samples.astype(dtype), 0, own), expected)


def test_strides(waveforms, own):
    samples, _ = waveforms
    expected = wavex.decompose_samples(samples, 0, own)
    wide = np.zeros((500, 2 * M), "u2")
    wide[:, ::2] = samples
    for strided in [wide[:, ::2], np.asfortranarray(samples), samples[::-1][::-1]]:
        assert same(wavex.decompose_samples(strided, 0, own), expected)


@pytest.mark.parametrize(
    ("samples", "problem"),
    [
        (np.full((2, M), np.nan), "sample 0 of the array is NaN, not a digitiser step"),
        (np.full((2, M), 1.5), "1.5, not a digitiser step"),
        (np.full((2, M), -1), "-1, not a digitiser step"),
        (np.full((2, M), 70000), "70000, not a digitiser step"),
        (np.full((2, M), 1j), "type complex128 cannot be used"),
        (np.full((2, M), "a"), "cannot be used"),
        (np.full((2, M), None), "cannot be used"),
        (np.zeros(M, "u2"), "has 1 dimensions"),
        (np.zeros((2, 3, M), "u2"), "has 3 dimensions"),
        (5, "has 0 dimensions"),
    ],
)
def test_other_arrays_are_refused(own, samples, problem):
    with pytest.raises(wavex.DataError, match=problem):
        wavex.decompose_samples(samples, 0, own)


def test_empty_arrays(own):
    for shape in [(0, M), (0, 0), (3, 0), (3, 1)]:
        assert len(wavex.decompose_samples(np.zeros(shape, "u2"), 0, own)) == 0
    assert len(wavex.decompose_samples(pa.array([], pa.list_(pa.uint16())), 0, own)) == 0


def test_ragged_lists(waveforms, own):
    samples, _ = waveforms
    lists = [row[: M - n % 7].tolist() for n, row in enumerate(samples)]
    table = wavex.decompose_samples(pa.array(lists, pa.list_(pa.uint16())), 0, own)
    for kind in [pa.large_list(pa.int32()), pa.list_(pa.float64())]:
        assert same(wavex.decompose_samples(pa.array(lists, kind), 0, own), table)
    chunked = pa.chunked_array([pa.array(lists[:100], pa.list_(pa.uint16())), pa.array(lists[100:], pa.list_(pa.uint16()))])
    assert same(wavex.decompose_samples(chunked, 0, own), table)
    sliced = pa.array([[1, 2, 3], *lists], pa.list_(pa.uint16()))[1:]
    assert same(wavex.decompose_samples(sliced, 0, own), table)
    with pytest.raises(wavex.DataError, match="the list array has nulls"):
        wavex.decompose_samples(pa.array([[1, 2], None], pa.list_(pa.uint16())), 0, own)
    with pytest.raises(wavex.DataError, match="the Arrow array has the type"):
        wavex.decompose_samples(pa.array([1, 2], pa.uint16()), 0, own)


def test_lists_and_padded_rows_give_the_same_model(waveforms):
    lengths = np.random.default_rng(2).integers(45, M, len(waveforms[0]))
    lists = [row[:length] for row, length in zip(waveforms[0], lengths)]
    padded = np.zeros((len(lists), 2 * M), "u2")
    for row, samples in zip(padded, lists):
        row[: len(samples)] = samples
    of_lists = wavex.calibrate_samples(pa.array(lists, pa.list_(pa.uint16())), full_scale_dn=255)
    of_rows = wavex.calibrate_samples(padded, full_scale_dn=255)
    assert of_lists.to_json() == of_rows.to_json()
    assert abs(of_lists.pulse_fwhm_ns() - 4.5) < 0.3


def test_calibration_needs_waveforms():
    with pytest.raises(wavex.DataError):
        wavex.calibrate_samples(np.zeros((5, M), "u2"))
    with pytest.raises(wavex.DataError, match="not a digitiser step"):
        wavex.calibrate_samples(np.full((500, M), 1.5))
