//! Exceptions: problem, place and remedy as attributes.

use std::path::Path;

use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use wavex::Failure;
use wavex::engine::{Cause, RunError};
use wavex::georef;
use wavex::job::JobErrors;
use wavex::run::RunFailure;
use wavex::stage::StageError;

create_exception!(wavex, Error, PyException, "Base of all errors of this package.");
create_exception!(wavex, JobError, Error, "A job, or an argument that becomes part of one, is invalid.");
create_exception!(wavex, ReadError, Error, "A file is missing or invalid.");
create_exception!(wavex, RunError_, Error, "A run failed.");
create_exception!(wavex, DataError, Error, "An array or a table cannot be used.");

/// Attributes of every error; `None` where unknown.
const ATTRIBUTES: [&str; 8] = ["problem", "remedy", "path", "line", "column", "byte", "stage", "errors"];

/// Adds the exceptions to the module.
pub fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    let base = py.get_type::<Error>();
    for name in ATTRIBUTES {
        base.setattr(name, py.None())?;
    }
    module.add("Error", base)?;
    module.add("JobError", py.get_type::<JobError>())?;
    module.add("ReadError", py.get_type::<ReadError>())?;
    module.add("DataError", py.get_type::<DataError>())?;
    let run_error = py.get_type::<RunError_>();
    run_error.setattr("__name__", "RunError")?;
    run_error.setattr("__qualname__", "RunError")?;
    module.add("RunError", run_error)
}

/// An error with its place.
#[derive(Debug, Default)]
struct Place<'a> {
    problem: Option<String>,
    remedy: Option<String>,
    path: Option<&'a Path>,
    byte: Option<u64>,
    stage: Option<&'a str>,
}

impl Place<'_> {
    fn set(&self, error: PyErr) -> PyErr {
        Python::attach(|py| {
            let value = error.value(py);
            // Attributes of an exception cannot fail to be set.
            let _ = value.setattr("problem", self.problem.as_deref());
            let _ = value.setattr("remedy", self.remedy.as_deref());
            let path = self.path.filter(|path| !path.as_os_str().is_empty());
            let _ = value.setattr("path", path.map(|path| path.display().to_string()));
            let _ = value.setattr("byte", self.byte);
            let _ = value.setattr("stage", self.stage);
        });
        error
    }
}

/// Splits a message at the remedy.
fn split(text: &str) -> (Option<String>, Option<String>) {
    match text.rsplit_once("; ") {
        Some((problem, remedy)) => (Some(problem.to_owned()), Some(remedy.to_owned())),
        None => (Some(text.to_owned()), None),
    }
}

/// Error in an array or a table.
pub fn data(problem: impl Into<String>, remedy: impl Into<String>) -> PyErr {
    let (problem, remedy) = (problem.into(), remedy.into());
    let error = DataError::new_err(format!("{problem}; {remedy}"));
    Place { problem: Some(problem), remedy: Some(remedy), ..Place::default() }.set(error)
}

/// Error in an argument that is part of a job.
pub fn job(problem: impl Into<String>, remedy: impl Into<String>) -> PyErr {
    let (problem, remedy) = (problem.into(), remedy.into());
    let error = JobError::new_err(format!("{problem}; {remedy}"));
    Place { problem: Some(problem), remedy: Some(remedy), ..Place::default() }.set(error)
}

/// Error about a file as a text: problem and remedy.
pub fn read(text: impl Into<String>, path: &Path) -> PyErr {
    let text = text.into();
    let (problem, remedy) = split(&text);
    let error = ReadError::new_err(text);
    Place { problem, remedy, path: Some(path), ..Place::default() }.set(error)
}

/// Errors of a job, each with its place.
pub fn of_job(errors: &JobErrors) -> PyErr {
    let error = JobError::new_err(errors.to_string().trim_end().to_owned());
    Python::attach(|py| {
        let value = error.value(py);
        let all = errors.errors().iter().map(|error| -> PyResult<_> {
            let entry = PyDict::new(py);
            let position = errors.position(error);
            entry.set_item("problem", &error.problem)?;
            entry.set_item("remedy", error.help.join("; "))?;
            entry.set_item("path", position.map(|(name, ..)| name))?;
            entry.set_item("line", position.map(|(_, line, _)| line))?;
            entry.set_item("column", position.map(|(.., column)| column))?;
            Ok(entry)
        });
        let all: PyResult<Vec<_>> = all.collect();
        if let Ok(all) = all {
            for (name, first) in ["problem", "remedy", "path", "line", "column"].into_iter().zip(
                ["problem", "remedy", "path", "line", "column"]
                    .map(|name| all.first().and_then(|first| first.get_item(name).ok().flatten())),
            ) {
                let _ = value.setattr(name, first);
            }
            let _ = value.setattr("errors", all);
        }
    });
    error
}

/// Failure of a stage or a reader.
pub fn of_stage(error: &StageError) -> PyErr {
    with_place(error, error.to_string(), None, None)
}

/// Failure of a run of the engine.
pub fn of_run(error: &RunError) -> PyErr {
    let text = error.to_string();
    match &error.cause {
        Cause::Interrupted => PyKeyboardInterrupt::new_err(text),
        Cause::Panic(_) => {
            let (problem, remedy) = split(&text);
            let place = Place {
                problem,
                remedy,
                path: error.input.as_deref(),
                stage: error.stage.as_deref(),
                ..Place::default()
            };
            place.set(RunError_::new_err(text))
        }
        Cause::Stage(cause) => with_place(cause, text, error.stage.as_deref(), error.input.as_deref()),
    }
}

fn with_place(error: &StageError, text: String, stage: Option<&str>, input: Option<&Path>) -> PyErr {
    let format = match error {
        StageError::Format(error) | StageError::Georef(georef::Error::Format(error)) => Some(error),
        _ => None,
    };
    if let Some(format) = format {
        let (problem, remedy) = match format {
            wavex_formats::Error::Malformed { field, problem, remedy, .. } => {
                (Some(format!("{field}: {problem}")), Some(remedy.clone()))
            }
            wavex_formats::Error::Unusable { problem, remedy, .. } => {
                (Some(problem.clone()), Some(remedy.clone()))
            }
            wavex_formats::Error::Io { .. } => split(&format.to_string()),
        };
        let byte = match format {
            wavex_formats::Error::Malformed { offset, .. } => Some(*offset),
            _ => None,
        };
        let place = Place { problem, remedy, path: Some(format.file()), byte, stage };
        return place.set(ReadError::new_err(text));
    }
    let (problem, remedy) = match error {
        StageError::Failed { problem, remedy } => (Some(problem.clone()), Some(remedy.clone())),
        other => split(&other.to_string()),
    };
    Place { problem, remedy, path: input, stage, ..Place::default() }.set(RunError_::new_err(text))
}

/// Failure of a command of the program.
pub fn of_command(failure: &Failure) -> PyErr {
    match failure {
        Failure::Job(errors) => of_job(errors),
        Failure::Wrong(text) => {
            let (problem, remedy) = split(text);
            let error = JobError::new_err(text.clone());
            Place { problem, remedy, ..Place::default() }.set(error)
        }
        Failure::Run(text) => {
            let (problem, remedy) = split(text);
            Place { problem, remedy, ..Place::default() }.set(RunError_::new_err(text.clone()))
        }
    }
}

/// Failure of a job as run by the program.
pub fn of_run_failure(failure: RunFailure) -> PyErr {
    match &failure.error {
        Some(error) => of_run(error),
        None => of_command(&Failure::from(failure)),
    }
}
