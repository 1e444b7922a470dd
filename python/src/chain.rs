//! Jobs over one recording.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use wavex::registry::STAGES;

use pyo3::prelude::*;
use toml::Table;

use wavex::engine::{Cancel, Input, Options};
use wavex::job::Job;
use wavex::stages::process::calibrate::Calibrate;
use wavex_formats::format::reader_of;
use wavex_signal::sensor_model::SensorModel;

use crate::errors;
use crate::toml_value;

/// File of a recording and keys of its reader.
#[derive(Clone, Debug)]
pub struct Place {
    pub path: PathBuf,
    pub reader: &'static str,
    pub keys: Table,
}

impl Place {
    /// Recognises the reader of a file by its extension.
    pub fn of(path: &Path, keys: Table) -> PyResult<Place> {
        let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let reader = reader_of(&path.to_string_lossy()).map_err(|problem| errors::read(problem, &path))?;
        Ok(Place { path, reader, keys })
    }

    /// The file as input of a run.
    pub fn input(&self) -> Input {
        let stem = self.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        Input { path: self.path.clone(), stem, part: None }
    }

    /// A job that reads the recording, followed by `stages`.
    pub fn job(&self, settings: Table, stages: &[(&str, Table)]) -> PyResult<Job> {
        let mut job = Table::new();
        for unused in ["report", "stat_log", "log"] {
            job.insert(unused.into(), "".into());
        }
        job.extend(settings);
        let mut text = format!("[job]\n{}\n", toml_value::text(&job)?);
        let mut reader = self.keys.clone();
        reader.insert("path".into(), self.path.to_string_lossy().into_owned().into());
        text += &toml_value::stage(self.reader, &reader)?;
        for (name, keys) in stages {
            text += "\n";
            text += &toml_value::stage(name, keys)?;
        }
        Job::parse(STAGES, &self.path.display().to_string(), &text, &[])
            .map_err(|errors| errors::of_job(&errors))
    }
}

/// Options of a job over one recording.
pub fn options(job: &Job, cancel: &Cancel) -> Options {
    Options { cancel: cancel.clone(), ..Options::of_job(job, ".", ".") }
}

/// Replaces the calibration of a job by a model.
pub fn use_model(job: &mut Job, model: &Arc<SensorModel>) {
    if let Some(stage) = job.stages.iter_mut().find(|stage| stage.spec.name == "calibrate") {
        stage.planned.plan = Calibrate::default().with_model(Arc::clone(model));
    }
}
