"""How recordings, models and explanations look in a notebook."""

from __future__ import annotations

import os

from . import Explanation, Recording, SensorModel

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable


def _escaped(value: object) -> str:
    """Text for HTML, without control characters and those that change its direction."""
    text = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in str(value))
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")


def _row(cells: Iterable[object]) -> str:
    head, *others = (_escaped(cell) for cell in cells)
    return f"<tr><th>{head}</th>" + "".join(f"<td>{cell}</td>" for cell in others) + "</tr>"


def recording_html(self: Recording) -> str:
    """Table of the metadata; the recording is not read for it."""
    info, counts = self.info, self._counts
    folder, name = os.path.split(self.path)
    crs = (info.crs_wkt or "").split('"')
    rows = {
        "instrument": " ".join(filter(None, [info.instrument, info.serial])),
        "scan lines, shots": f"{counts[0]}, {counts[1]}" if counts else "`recording.info.shots` counts them",
        "sampling": f"{info.sampling_interval_ns:g} ns",
        "full scale": f"{info.full_scale_dn} DN" if info.full_scale_dn else "",
        "pulse rate": f"{info.pulse_rate_hz:g} Hz" if info.pulse_rate_hz else "",
        "times": info.time_scale,
        "frame": info.frame,
        "CRS": crs[1] if len(crs) > 1 else "",
        "folder": folder,
    }
    return (
        f"<table><caption>{_escaped(name)}: {_escaped(info.format)}</caption>"
        + "".join(_row(row) for row in rows.items() if row[1])
        + "</table>"
    )


def model_html(self: SensorModel) -> str:
    """Table of the channels, with a curve of each response."""
    rows = "".join(
        _row(
            (
                channel,
                f"{self.noise_sd_dn(channel):.3f} DN",
                f"{self.background_dn(channel):.2f} DN",
                f"{self.pulse_fwhm_ns(channel):.3f} ns",
                f"{self.sampling_interval_ns(channel):g} ns",
            )
        ).removesuffix("</tr>")
        + f"<td>{_curve(self, channel)}</td></tr>"
        for channel in self.channels
    )
    titles = ["channel", "noise SD", "background", "pulse FWHM", "sampling", "system response"]
    head = "".join(f"<th>{title}</th>" for title in titles)
    return f"<table><caption>Sensor model</caption><tr>{head}</tr>{rows}</table>"


def _curve(model: SensorModel, channel: str) -> str:
    """Line drawing of a system response, 120 by 30 pixels."""
    _, values = model.response(channel)
    step = 120 / max(len(values) - 1, 1)
    every = enumerate(values.tolist())
    points = " ".join(f"{place * step:.1f},{28 - 26 * value:.1f}" for place, value in every if place % 4 == 0)
    return (
        '<svg width="120" height="30"><polyline fill="none" stroke="currentColor" '
        f'points="{points}"/></svg>'
    )


def explanation_html(self: Explanation) -> str:
    """The picture, and the table of returns as text."""
    from base64 import b64encode

    # As an image, the styles of the picture do not reach the notebook, and nothing in it can run.
    picture = b64encode(self.svg.encode()).decode()
    lines = "\n".join(_escaped(line) for line in self.text.splitlines())
    return f'<img alt="shot {self.shot}" src="data:image/svg+xml;base64,{picture}"><pre>{lines}</pre>'
