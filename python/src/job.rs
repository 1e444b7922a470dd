//! Jobs and their runs.

use std::path::{Path, PathBuf};

use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList, PyType};
use toml::{Table as Keys, Value};

use wavex::engine::{Cancel, ProgressWatch};
use wavex::job::{Job as Parsed, Override, manual_of, summary};
use wavex::job_file;
use wavex::registry::STAGES;
use wavex::run::{RunRequest, run_quietly};
use wavex::stage::{Plan, StageSpec};

use crate::errors;
use crate::stage::{PYTHON, Stage};
use crate::toml_value::{self, table};
use crate::wait::interruptible;

/// Validated job.
///
/// Parameters
/// ----------
/// stages : list of dict or Stage
///     Stages in order. A dictionary has the key ``type`` and the keys of the stage; a function decorated
///     with :func:`wavex.stage` is the stage at that place of the list.
/// folder : str or os.PathLike, optional
///     Folder at which relative paths start; the current folder by default.
/// **settings
///     Keys of the table ``[job]``, such as ``threads``, ``memory_mb`` or ``geometry``.
///
/// Raises
/// ------
/// JobError
///     If a stage or a key is wrong; ``errors`` has all errors.
#[pyclass(module = "wavex", frozen)]
pub struct Job {
    parsed: Parsed,
    folder: PathBuf,
}

/// Overrides from a dictionary: `{"decompose.mode": "fastest"}`.
pub fn overrides(set: Option<&Bound<'_, PyDict>>) -> PyResult<Vec<String>> {
    Ok(table(set)?.into_iter().map(|(key, value)| format!("{key}={value}")).collect())
}

#[pymethods]
impl Job {
    #[new]
    #[pyo3(signature = (stages, *, folder=None, **settings))]
    fn new(
        py: Python<'_>,
        stages: &Bound<'_, PyAny>,
        folder: Option<PathBuf>,
        settings: Option<&Bound<'_, PyDict>>,
    ) -> PyResult<Job> {
        let mut job = Keys::new();
        job.insert("job".into(), Value::Table(table(settings)?));
        let (mut of_rust, mut of_python) = (Vec::new(), Vec::new());
        for (place, item) in stages.try_iter()?.enumerate() {
            let item = item?;
            if let Ok(stage) = item.cast::<Stage>() {
                of_python.push((place, stage.clone().unbind()));
            } else if let Ok(keys) = item.cast::<PyDict>() {
                of_rust.push(Value::Table(table(Some(keys))?));
            } else {
                return Err(errors::job(
                    format!("stage {} of the list is neither a dictionary nor a wavex.Stage", place + 1),
                    "give a dictionary with the key `type`, or a function with the decorator wavex.stage",
                ));
            }
        }
        job.insert("stage".into(), Value::Array(of_rust));
        let parsed = Parsed::parse(STAGES, "the job", &toml_value::text(&job)?, &[]);
        let mut parsed = parsed.map_err(|errors| errors::of_job(&errors))?;
        for (place, stage) in of_python {
            insert(&mut parsed, place, &stage, py)?;
        }
        Ok(Job { parsed, folder: folder.unwrap_or_else(|| ".".into()) })
    }

    /// Parse a job from text in TOML.
    ///
    /// Parameters
    /// ----------
    /// text : str
    /// set : dict, optional
    ///     Overrides, such as ``{"decompose.detection_sigma": 5}``.
    /// folder : str or os.PathLike, optional
    ///     Folder at which relative paths start.
    /// name : str, optional
    ///     Name in error messages.
    ///
    /// Returns
    /// -------
    /// Job
    #[classmethod]
    #[pyo3(signature = (text, *, set=None, folder=None, name="the job"))]
    fn from_toml(
        _: &Bound<'_, PyType>,
        text: &str,
        set: Option<&Bound<'_, PyDict>>,
        folder: Option<PathBuf>,
        name: &str,
    ) -> PyResult<Job> {
        let set: Vec<Override> = overrides(set)?.into_iter().map(Override::new).collect();
        let parsed = Parsed::parse(STAGES, name, text, &set).map_err(|errors| errors::of_job(&errors))?;
        Ok(Job { parsed, folder: folder.unwrap_or_else(|| ".".into()) })
    }

    /// Read a job file.
    ///
    /// Parameters
    /// ----------
    /// path : str or os.PathLike
    /// set : dict, optional
    ///     Overrides, such as ``{"decompose.detection_sigma": 5}``.
    ///
    /// Returns
    /// -------
    /// Job
    #[classmethod]
    #[pyo3(signature = (path, *, set=None))]
    fn from_file(_: &Bound<'_, PyType>, path: PathBuf, set: Option<&Bound<'_, PyDict>>) -> PyResult<Job> {
        if !path.is_file() {
            return Err(errors::read(format!("{}: no such job; check the path", path.display()), &path));
        }
        let set = overrides(set)?.into_iter().map(Override::new).collect();
        let parsed = job_file::read(&path, set).map_err(|failure| errors::of_command(&failure))?;
        Ok(Job { parsed, folder: job_file::folder(&path) })
    }

    /// The same job with a Python stage after another stage.
    ///
    /// Parameters
    /// ----------
    /// after : str
    ///     ``id`` or type of the stage before it.
    /// stage : Stage
    ///
    /// Returns
    /// -------
    /// Job
    fn with_stage(&self, py: Python<'_>, after: &str, stage: Py<Stage>) -> PyResult<Job> {
        let mut parsed = self.parsed.clone();
        let found = parsed.stages.iter().rposition(|stage| stage.id == after || stage.spec.name == after);
        let Some(place) = found else {
            let ids: Vec<&str> = parsed.stages.iter().map(|stage| stage.id.as_str()).collect();
            return Err(errors::job(
                format!("the job has no stage `{after}`"),
                format!("stages: {}", ids.join(", ")),
            ));
        };
        insert(&mut parsed, place + 1, &stage, py)?;
        Ok(Job { parsed, folder: self.folder.clone() })
    }

    /// The job as TOML, with the keys as given; overrides and Python stages are not part of it.
    ///
    /// Returns
    /// -------
    /// str
    fn to_toml(&self) -> &str {
        &self.parsed.text
    }

    /// The chain on one line, with the kind of lines wherever it changes.
    #[getter]
    fn chain(&self) -> String {
        self.parsed.chain()
    }

    /// Identifiers of the stages, in order.
    #[getter]
    fn stages(&self) -> Vec<String> {
        self.parsed.stages.iter().map(|stage| stage.id.clone()).collect()
    }

    /// Warnings about the job.
    #[getter]
    fn notes(&self) -> Vec<String> {
        self.parsed.notes.clone()
    }

    fn __repr__(&self) -> String {
        format!("<wavex.Job {}>", self.parsed.chain())
    }
}

/// Inserts a Python stage.
fn insert(job: &mut Parsed, place: usize, stage: &Py<Stage>, py: Python<'_>) -> PyResult<()> {
    let id = format!("python:{}", stage.get().id());
    let done = job.insert(place, &id, &PYTHON, Plan::Map(Stage::plan(stage, py)));
    done.map_err(|error| {
        let text = error.to_string();
        match text.split_once("; ") {
            Some((problem, remedy)) => errors::job(problem, remedy),
            None => errors::job(text, "choose another place"),
        }
    })
}

/// Job of an argument: a job, or the path of a job file with overrides; and its folder.
pub fn job_of(
    py: Python<'_>,
    job: &Bound<'_, PyAny>,
    set: Option<&Bound<'_, PyDict>>,
) -> PyResult<(Parsed, PathBuf)> {
    match job.cast::<Job>() {
        Ok(job) if set.is_none() => Ok((job.get().parsed.clone(), job.get().folder.clone())),
        Ok(_) => Err(errors::job("`set` changes the keys of a job file", "give the keys to wavex.Job")),
        Err(_) => {
            let path: PathBuf = job.extract().map_err(|_| {
                errors::job(
                    "the job is neither a wavex.Job nor a path",
                    "make it with wavex.Job, or give a file",
                )
            })?;
            let read = Job::from_file(&py.get_type::<Job>(), path, set)?;
            Ok((read.parsed, read.folder))
        }
    }
}

/// Run a job.
///
/// Outputs are those of ``wavex run``, byte for byte. The GIL is released; Ctrl-C ends the run in order.
///
/// Parameters
/// ----------
/// job : Job, str or os.PathLike
///     A job, or the path of a job file.
/// set : dict, optional
///     Overrides of keys of a job file, such as ``{"decompose.detection_sigma": 5}``.
/// stages : dict, optional
///     Python stages to insert: ``{"decompose": stage}`` inserts one after ``decompose``.
/// progress : bool or callable, optional
///     ``True`` shows a bar of tqdm, if installed; a function is called with the part done, 0 to 1, and
///     the number of shots.
/// profile : bool, optional
///     Whether to write a trace and to measure the latency of each stage.
///
/// Returns
/// -------
/// dict
///     The report of the run, as in the report file; ``files`` has the paths of all files.
///
/// Raises
/// ------
/// JobError
///     If the job is invalid.
/// ReadError
///     If an input is missing or invalid.
/// RunError
///     If a stage fails.
#[pyfunction]
#[pyo3(signature = (job, *, set=None, stages=None, progress=None, profile=false))]
pub fn run<'py>(
    py: Python<'py>,
    job: &Bound<'py, PyAny>,
    set: Option<&Bound<'py, PyDict>>,
    stages: Option<&Bound<'py, PyDict>>,
    progress: Option<&Bound<'py, PyAny>>,
    profile: bool,
) -> PyResult<Bound<'py, PyAny>> {
    let (mut parsed, folder) = job_of(py, job, set)?;
    for (after, stage) in stages.into_iter().flatten() {
        let job = Job { parsed, folder: folder.clone() };
        let stage = stage.cast_into::<Stage>().map_err(|_| {
            errors::job("a value of `stages` is no wavex.Stage", "decorate the function with wavex.stage")
        })?;
        parsed = job.with_stage(py, &after.extract::<String>()?, stage.unbind())?.parsed;
    }
    let (cancel, watch) = (Cancel::default(), ProgressWatch::default());
    let show = match progress {
        Some(progress) if progress.is_callable() => Some(progress.clone()),
        Some(progress) if progress.is_truthy()? => {
            Some(py.import("wavex._progress")?.call_method0("bar")?).filter(|bar| !bar.is_none())
        }
        _ => None,
    };
    let look = |_: Python<'_>| match &show {
        Some(show) => show.call1(watch.get()).map(drop),
        None => Ok(()),
    };
    let done = interruptible(py, &cancel, look, || {
        run_quietly(RunRequest {
            profile,
            cancel: cancel.clone(),
            watch: Some(watch.clone()),
            ..RunRequest::quiet(&parsed, &folder)
        })
    })?;
    let done = done.map_err(errors::of_run_failure)?;
    if let Some(show) = &show {
        show.call1((1.0, watch.get().1))?;
        if show.hasattr("close")? {
            show.call_method0("close")?;
        }
    }
    let report = done
        .report()
        .to_json()
        .map_err(|error| errors::data(error.to_string(), "please report this bug in wavex"))?;
    let report = py.import("json")?.call_method1("loads", (report,))?;
    let of_inputs = done.run.inputs.iter().flat_map(|input| &input.outputs);
    let files = of_inputs.chain(&done.written).map(|path| shown(path));
    report.set_item("files", PyList::new(py, files.collect::<Vec<_>>())?)?;
    Ok(report)
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

/// All stages that a job can use.
///
/// Parameters
/// ----------
/// name : str, optional
///     Name of one stage.
///
/// Returns
/// -------
/// dict or str
///     Names with their first sentence; with ``name``, the manual of that stage.
#[pyfunction]
#[pyo3(signature = (name=None))]
pub fn stages<'py>(py: Python<'py>, name: Option<&str>) -> PyResult<Bound<'py, PyAny>> {
    if let Some(name) = name {
        let spec: &StageSpec = wavex::registry::find(name).ok_or_else(|| {
            let names: Vec<&str> = STAGES.iter().map(|spec| spec.name).collect();
            errors::job(format!("there is no stage `{name}`"), format!("stages: {}", names.join(", ")))
        })?;
        return Ok(manual_of(spec).into_pyobject(py)?.into_any());
    }
    let all = PyDict::new(py);
    for spec in STAGES {
        all.set_item(spec.name, summary(spec))?;
    }
    Ok(all.into_any())
}
