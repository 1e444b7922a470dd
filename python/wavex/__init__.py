"""Full-waveform lidar: recordings as arrays, returns as tables with standard deviations.

>>> import wavex
>>> recording = wavex.simulate(lines=20)
>>> model = wavex.calibrate(recording)
>>> returns = wavex.decompose(recording, model).read_all()
"""

from ._wavex import (
    Alignment,
    BatchReader,
    Block,
    DataError,
    Error,
    Explanation,
    FittedSamples,
    Info,
    Job,
    JobError,
    Line,
    Lines,
    ReadError,
    Recording,
    RunError,
    SensorModel,
    Shot,
    Stage,
    Table,
    __version__,
    align,
    calibrate,
    calibrate_samples,
    decompose,
    decompose_samples,
    explain,
    open,
    run,
    simulate,
    stages,
)


from ._frames import to_pandas, to_polars
from ._html import explanation_html, model_html, recording_html
from ._waveforms import Waveforms, waveforms

# Methods that are shorter in Python; packages that they need are imported when they are called.
for _table in (BatchReader, Table):
    _table.to_pandas, _table.to_polars = to_pandas, to_polars
Recording.waveforms = waveforms
Recording._repr_html_ = recording_html
SensorModel._repr_html_ = model_html
Explanation._repr_html_ = explanation_html
del _table, to_pandas, to_polars, waveforms, recording_html, model_html, explanation_html


def stage(function=None, *, name=None, reason=None):
    """Make a stage of a job from a function.

    Parameters
    ----------
    function : callable
        Receives the returns of one scan line as a :class:`Table`; see :class:`Stage`.
    name : str, optional
        Name in reports; the name of the function by default.
    reason : str, optional
        Reason of rejections in reports.

    Returns
    -------
    Stage

    Examples
    --------
    >>> @wavex.stage(reason="weaker than 20 DN")
    ... def strong_only(returns):
    ...     return returns["amplitude_dn"] >= 20
    """
    if function is None:
        return lambda function: Stage(function, name=name, reason=reason)
    return Stage(function, name=name, reason=reason)


__all__ = [
    "Alignment",
    "BatchReader",
    "Block",
    "DataError",
    "Error",
    "Explanation",
    "FittedSamples",
    "Info",
    "Job",
    "JobError",
    "Line",
    "Lines",
    "ReadError",
    "Recording",
    "RunError",
    "SensorModel",
    "Shot",
    "Stage",
    "Table",
    "Waveforms",
    "__version__",
    "align",
    "calibrate",
    "calibrate_samples",
    "decompose",
    "decompose_samples",
    "explain",
    "open",
    "run",
    "simulate",
    "stage",
    "stages",
]
