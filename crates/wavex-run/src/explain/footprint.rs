//! Measures one shot with a large footprint.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{ExplainRequest, FOOTPRINTS, default_job, failed, keys_of, nearest};
use crate::{Failure, job_file};
use wavex_engine::engine::ProgressMode;
use wavex_engine::job::Override;
use wavex_engine::recording::Recording;
use wavex_line::stage::{Context, LineLocation, RunContext, SourceConfig};
use wavex_pages::explain::ExplainedFootprint;
use wavex_stages::process::measure_footprints::MeasureFootprints;
use wavex_stages::readers::read_hdf5::{BeamShot, ReadHdf5};

/// A recording, and the stages that measure its footprints.
pub struct FootprintChain {
    file: PathBuf,
    progress: ProgressMode,
    reader: ReadHdf5,
    measure: MeasureFootprints,
}

/// Error for a sensor model, with its remedy.
pub(super) fn without_model(file: &Path, remedy: &str) -> Failure {
    let problem = "noise and response of large footprints are learnt from their beam";
    Failure::Wrong(format!("{}: {problem}; {remedy}", file.display()))
}

impl FootprintChain {
    /// Chain of a request.
    ///
    /// # Errors
    /// If the job is invalid or has no `measure_footprints`, or a sensor model is given.
    pub fn of(request: &ExplainRequest) -> Result<FootprintChain, Failure> {
        let file = request.file.to_owned();
        if request.model.is_some() {
            return Err(without_model(request.file, "leave out --model"));
        }
        let set = if request.job.is_some() { &[] } else { request.set };
        let default_job = default_job(FOOTPRINTS, &["measure_footprints"], &file.display().to_string(), set)?;
        let job = match request.job {
            None => &default_job,
            Some(path) => &job_file::read(path, request.set.iter().map(Override::new).collect())?,
        };
        let reads_it = job.stages.first().is_some_and(|first| first.spec.name == FOOTPRINTS);
        let reader = keys_of(if reads_it { job } else { &default_job }, FOOTPRINTS)?;
        Ok(FootprintChain {
            file,
            progress: request.progress,
            reader,
            measure: keys_of(job, "measure_footprints")?,
        })
    }

    /// Opens the recording for random access.
    fn recording(&self) -> Result<Recording, Failure> {
        let keys = serde_json::to_value(&self.reader).map_err(|error| failed(&error))?;
        let reader = Arc::new(self.reader.clone());
        Recording::of_reader(reader, &keys, RunContext::alone(&self.file)).map_err(|error| failed(&error))
    }

    /// Measures the shot with this number in its mission, or else this running number.
    ///
    /// Reads the shots from which the stage learns, the first ones of the beam, and the shot.
    ///
    /// # Errors
    /// If the recording cannot be read, has no such shot, or the shot cannot be measured.
    pub fn explain(&self, shot: u64) -> Result<ExplainedFootprint, Failure> {
        let place = self.reader.find(&self.file, shot).map_err(|error| failed(&error))?;
        self.explain_at(&place)
    }

    /// Measures the shot with this running number.
    ///
    /// # Errors
    /// As [`FootprintChain::explain`].
    pub fn explain_running(&self, shot: u64) -> Result<ExplainedFootprint, Failure> {
        let place = self.reader.at(&self.file, shot).map_err(|error| failed(&error))?;
        self.explain_at(&place)
    }

    /// Returns the running number of the shot nearest to a time, and its time, s.
    ///
    /// # Errors
    /// If the recording cannot be read, its shots have no times, or the time is outside of theirs.
    pub fn nearest(&self, time_s: f64) -> Result<(u64, f64), Failure> {
        nearest(self.recording()?, &self.file, self.progress, time_s)
    }

    fn explain_at(&self, BeamShot { beam, index }: &BeamShot) -> Result<ExplainedFootprint, Failure> {
        let file = self.file.display().to_string();
        let stage_failed = |error| failed(&error);
        let reader = self.reader.of_beam(beam);
        let mut source = reader.make(&RunContext::alone(&self.file)).map_err(stage_failed)?;
        let mut cx = Context::default();
        let (mut first, mut shots) = (Vec::new(), 0);
        while shots < self.measure.shots
            && let Some(line) = source.next(&mut cx).map_err(stage_failed)?
        {
            shots += line.distinct_waveforms();
            first.push(line);
        }
        let location = LineLocation {
            records: *index..index + 1,
            row: 0,
            line: 0,
            first_shot: *index,
            is_complete: true,
        };
        let without = |what: &str| {
            Failure::Wrong(format!("{file}: shot {index} of {beam} has {what}; choose another one"))
        };
        let line = source.line_at(&location, &mut cx).map_err(stage_failed)?;
        let line = line.ok_or_else(|| without("no position, cannot be read, or is cut by the job"))?;
        let seen = self.measure.seen(&first, &line, 0);
        let seen = seen.map_err(|error| Failure::Run(format!("{file}: {error}")))?;
        let seen = seen.ok_or_else(|| without("no background beside its signal"))?;
        Ok(ExplainedFootprint { file, seen })
    }
}
