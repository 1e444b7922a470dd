"""Frames of pandas and Polars from tables and readers."""

from __future__ import annotations

from importlib import import_module

from . import BatchReader, Table

# `typing` takes longer to import than the rest of the package.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any


def package(name: str) -> Any:
    """Import an optional package, or raise an error that says how to install it."""
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        if error.name != name:
            raise
        raise ImportError(f"{name} is not installed; run `pip install {name}`") from error


def to_pandas(self: Table | BatchReader) -> Any:
    """Copy into a frame of pandas; PyArrow is not needed.

    Nulls of numbers become NaN. A column of vectors becomes three: ``origin_x``, ``origin_y``, ``origin_z``.

    Returns
    -------
    pandas.DataFrame

    Raises
    ------
    ImportError
        If pandas is not installed.
    DataError
        If a column has lists, as the column ``blocks`` of shots.
    """
    pandas = package("pandas")
    table = self if isinstance(self, Table) else self.read_all()
    columns: dict[str, Any] = {}
    for name, values in table.items():
        if values.ndim == 2:
            columns |= {f"{name}_{axis}": values[:, place] for place, axis in enumerate("xyz")}
        else:
            columns[name] = values
    return pandas.DataFrame(columns)


def to_polars(self: Table | BatchReader) -> Any:
    """Make a frame of Polars.

    Returns
    -------
    polars.DataFrame

    Raises
    ------
    ImportError
        If Polars is not installed.
    """
    return package("polars").DataFrame(self)
