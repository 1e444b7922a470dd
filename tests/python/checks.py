"""Counts passed and failed checks, and compares columns."""

import traceback
from contextlib import contextmanager

import numpy as np
import pyarrow as pa


class Checks:
    """Prints a line per check, with the current subject."""

    def __init__(self):
        self.passed = 0
        self.failed = 0
        self.subject = ""

    def that(self, what, holds, detail=""):
        if holds:
            self.passed += 1
            print(f"ok    {self.subject}: {what}")
        else:
            self.failed += 1
            print(f"FAILED {self.subject}: {what}{': ' if detail else ''}{detail}")

    def equal(self, what, found, expected):
        self.that(what, found == expected, f"{found!r} instead of {expected!r}")

    def within(self, what, found, expected, tolerance):
        """Checks that numbers or arrays agree within the tolerance."""
        found, expected = np.asarray(found, dtype=np.float64), np.asarray(expected, dtype=np.float64)
        if found.shape != expected.shape:
            self.that(what, False, f"{found.shape} instead of {expected.shape}")
            return
        off = np.abs(found - expected)
        worst = float(np.max(off - tolerance, initial=-np.inf))
        self.that(what, worst <= 0.0, f"off by up to {np.max(off, initial=0.0)} (allowed: {np.max(tolerance)})")

    @contextmanager
    def of(self, subject):
        """Sets the subject of the checks inside; an exception counts as a failed check."""
        before, self.subject = self.subject, subject
        try:
            yield
        except (Exception, SystemExit) as error:
            traceback.print_exc()
            self.that("can be checked to the end", False, f"{type(error).__name__}: {error}")
        finally:
            self.subject = before

    def end(self):
        """Prints the summary; returns the exit code."""
        print(f"{self.passed} passed, {self.failed} failed")
        return 1 if self.failed else 0


def numbers(table, name, null=np.nan):
    """A column as an array, with a replacement for nulls."""
    column = table.column(name).combine_chunks()
    return column.to_numpy(zero_copy_only=False) if column.null_count == 0 else np.array(
        [null if value is None else value for value in column.to_pylist()]
    )


def same_column(a, b):
    """Whether two columns are equal bit by bit; NaN equals NaN and null equals null."""
    a, b = a.combine_chunks(), b.combine_chunks()
    if a.type != b.type or len(a) != len(b) or not a.is_null().equals(b.is_null()):
        return False
    if pa.types.is_floating(a.type):
        a, b = (column.drop_null().to_numpy() for column in (a, b))
        return bool(np.array_equal(a, b, equal_nan=True))
    return a.equals(b)


def same_bytes(a, b):
    """Whether two arrays of records are equal bit by bit."""
    return a.dtype == b.dtype and a.tobytes() == b.tobytes()
