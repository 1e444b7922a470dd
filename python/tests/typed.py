"""Uses of the package that mypy checks."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import wavex


@wavex.stage(reason="weak")
def strong(returns: wavex.Table) -> NDArray[np.bool_]:
    """Keep strong returns."""
    keep: NDArray[np.bool_] = returns["amplitude_dn"] > 20
    return keep


def use(path: Path) -> float:
    """Use most of the package."""
    recording = wavex.open(path)
    shot: wavex.Shot = recording.lines[3][0]
    samples: NDArray[np.uint16] | NDArray[np.float32] = shot.samples["low"]
    model = wavex.calibrate(recording, waveforms=1000)
    table = wavex.decompose_samples(samples[None, :], 0.0, model, mode="fastest")
    with wavex.decompose(recording, model, columns=["shot"]) as reader:
        rows = sum(len(batch) for batch in reader)
    report = wavex.run(wavex.Job([{"type": "simulate"}, strong]), progress=True)
    print(rows, report["files"], wavex.stages("decompose"))
    return float(table["time_ns"][0])


def matrices(recording: wavex.Recording) -> NDArray[np.uint16] | NDArray[np.float32]:
    """Use tables as mappings, and waveforms."""
    table = wavex.decompose(recording).read_all()
    columns: dict[str, NDArray[np.float64]] = dict(table)
    ranges = table.get("range_m")
    assert "range_m" in table and ranges is not None and len(columns) == len(table.keys())
    waveforms: wavex.Waveforms = recording.waveforms("low", lines=slice(0, 10))
    print(waveforms.to_xarray(), table.to_pandas(), table.to_polars(), list(table))
    wavex.calibrate_samples(waveforms.samples, lengths=waveforms.lengths)
    return waveforms.samples
