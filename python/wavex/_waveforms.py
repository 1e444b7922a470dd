"""Samples of many shots as one matrix."""

from __future__ import annotations

from . import DataError, Recording
from ._frames import package
from ._wavex import read_blocks

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable
    from typing import Any


class Waveforms:
    """Sample blocks of one channel, one per row, from :meth:`Recording.waveforms`.

    Attributes
    ----------
    channel : str
    samples : numpy.ndarray, shape (n, m), uint16 or float32
        Digitiser steps; 0 after the end of a block. ``float32`` if they are fractions of a step (GEDI, LVIS in HDF5).
    mask : numpy.ndarray, shape (n, m), bool
        Where samples were recorded.
    time_ns : numpy.ndarray, shape (m,)
        Time after the first sample of a row, ns.
    t0_ns : numpy.ndarray, shape (n,)
        Time of the first sample after the shot's clock, ns.
    shot : numpy.ndarray, shape (n,)
        Number of the shot; a shot with several blocks has several rows.
    gain : numpy.ndarray, shape (n,)
        Gain relative to the reference gain.
    lengths : numpy.ndarray, shape (n,)
        Number of samples.
    """

    def __init__(self, channel: str, blocks: dict[str, Any]) -> None:
        import numpy as np

        self.channel = channel
        self.shot, self.t0_ns, self.gain = blocks["shot"], blocks["t0_ns"], blocks["gain"]
        self.lengths = blocks["length"]
        index = np.arange(max(self.lengths, default=0))
        self.time_ns = index * float(blocks["interval_ns"][0]) if len(index) else index * 1.0
        self.mask = index < self.lengths[:, None]
        self.samples = np.zeros(self.mask.shape, blocks["samples"].dtype)
        self.samples[self.mask] = blocks["samples"]

    def to_xarray(self) -> Any:
        """Make a dataset of xarray with the dimensions ``waveform`` and ``time_ns``.

        ``dataset.samples.where(dataset.mask)`` has NaN where nothing was recorded.

        Returns
        -------
        xarray.Dataset

        Raises
        ------
        ImportError
            If xarray is not installed.
        """
        of_row = ("waveform",)
        return package("xarray").Dataset(
            {
                "samples": (("waveform", "time_ns"), self.samples, {"long_name": "samples", "units": "DN"}),
                "mask": (("waveform", "time_ns"), self.mask, {"long_name": "recorded"}),
                "gain": (of_row, self.gain, {"long_name": "gain relative to the reference gain"}),
            },
            coords={
                "time_ns": ("time_ns", self.time_ns, {"long_name": "time after the first sample", "units": "ns"}),
                "shot": (of_row, self.shot),
                "t0_ns": (of_row, self.t0_ns, {"long_name": "time of the first sample", "units": "ns"}),
            },
            attrs={"channel": self.channel},
        )

    def __len__(self) -> int:
        return len(self.shot)

    def __repr__(self) -> str:
        rows, columns = self.samples.shape
        return f"<wavex.Waveforms {self.channel}: {rows} of up to {columns} samples>"


def waveforms(
    self: Recording, channel: str | None = None, *, lines: slice | Iterable[int] | None = None
) -> Waveforms:
    """Read sample blocks into one matrix, for NumPy and xarray.

    A sample needs three bytes in the matrix, and rows are as long as the longest block: take a large
    recording in parts, by `lines`.

    Parameters
    ----------
    channel : str, optional
        Channel: ``low``, ``high``, ``saturation`` or ``reference``; by default the first with echoes.
    lines : slice or iterable of int, optional
        Scan lines, such as ``slice(0, 100)``; all by default.

    Returns
    -------
    Waveforms

    Raises
    ------
    DataError
        If the lines have no blocks of this channel, or blocks of several sampling intervals.
    """
    every = range(len(self.lines))
    numbers = list(every if lines is None else every[lines] if isinstance(lines, slice) else lines)
    known = self.info.channels if every else []
    if channel is None:
        channel = "high" if "high" in known and "low" not in known else "low"
    blocks = read_blocks(self, channel, numbers)
    intervals_ns = sorted(set(blocks["interval_ns"].tolist()))
    if not intervals_ns:
        raise _data_error(
            f"{self.path}: {len(numbers)} lines have no samples of the channel `{channel}`",
            f"channels of the first line: {', '.join(known)}",
        )
    if len(intervals_ns) > 1:
        listed = ", ".join(f"{interval:g}" for interval in intervals_ns)
        raise _data_error(
            f"{self.path}: blocks have sampling intervals of {listed} ns, a matrix has one",
            "choose other lines, or read the blocks with `Recording.shots()`",
        )
    return Waveforms(channel, blocks)


def _data_error(problem: str, remedy: str) -> DataError:
    error = DataError(f"{problem}; {remedy}")
    error.problem, error.remedy = problem, remedy
    return error
