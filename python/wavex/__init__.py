"""Full-waveform lidar: recordings as arrays, returns as tables with standard deviations.

>>> import wavex
>>> recording = wavex.simulate(lines=20)
>>> model = wavex.calibrate(recording)
>>> returns = wavex.decompose(recording, model).read_all()
"""

from ._wavex import (
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
    "__version__",
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
