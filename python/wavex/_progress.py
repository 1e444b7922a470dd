"""Progress bar of tqdm."""

from __future__ import annotations

from typing import Any


def bar() -> _Bar | None:
    """Make a function that shows the progress; ``None`` without tqdm."""
    try:
        from tqdm.auto import tqdm
    except ImportError:
        return None
    return _Bar(tqdm(total=100, unit="%"))


class _Bar:
    def __init__(self, bar: Any) -> None:
        self._bar = bar

    def __call__(self, part: float, shots: int) -> None:
        self._bar.update(round(100 * part) - self._bar.n)
        self._bar.set_postfix_str(f"{shots} shots", refresh=False)

    def close(self) -> None:
        self._bar.close()
