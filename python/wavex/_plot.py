"""Pictures with Matplotlib."""


from __future__ import annotations

from typing import Any

from . import SensorModel


def plot_model(model: SensorModel, ax: Any | None = None) -> Any:
    """Draw the system response of each channel of a sensor model."""
    if ax is None:
        from matplotlib import pyplot

        _, ax = pyplot.subplots()
    for channel in model.channels:
        time_ns, value = model.response(channel)
        ax.plot(time_ns, value, label=f"{channel}, FWHM {model.pulse_fwhm_ns(channel):.2f} ns")
    ax.set_xlabel("time from the peak, ns")
    ax.set_ylabel("relative to the peak")
    ax.legend()
    return ax
