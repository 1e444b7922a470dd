//! Measures one shot with a large footprint.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::{
    ExplainRequest, FOOTPRINTS, MEASURE, ShotNumbers, absolute, default_job, failed, keys_of, nearest,
};
use crate::{Failure, job_file, run};
use wavex_engine::engine::ProgressMode;
use wavex_engine::job::{Job, Override};
use wavex_engine::recording::Recording;
use wavex_formats::format::reader_of;
use wavex_line::scan_line::ScanLine;
use wavex_line::stage::{Context, LineLocation, Plan, RunContext, SourceConfig, SourcePlan};
use wavex_pages::explain::ExplainedFootprint;
use wavex_stages::process::measure_footprints::MeasureFootprints;
use wavex_stages::readers::read_hdf5::{BeamShot, ReadHdf5};

/// A recording, and the stages that measure its footprints.
pub struct FootprintChain {
    file: PathBuf,
    progress: ProgressMode,
    reader: ProfileReader,
    measure: MeasureFootprints,
    /// Folder at which paths of the job start.
    input_dir: PathBuf,
}

/// Reader of a recording of large footprints.
enum ProfileReader {
    Hdf5(ReadHdf5),
    /// Another reader, with its keys.
    Other(Arc<dyn SourcePlan>, serde_json::Value),
}

impl ProfileReader {
    /// Of the first stage of a job that reads a file.
    fn of(job: &Job, file: &Path) -> Result<ProfileReader, Failure> {
        let reads_hdf5 = job.stages.first().is_some_and(|first| first.spec.name == FOOTPRINTS);
        if reads_hdf5 && ReadHdf5::has_beams(file) {
            return Ok(ProfileReader::Hdf5(keys_of(job, FOOTPRINTS)?));
        }
        match job.stages.first().map(|stage| (&stage.planned.plan, &stage.planned.resolved)) {
            Some((Plan::Source(reader), keys)) => Ok(ProfileReader::Other(Arc::clone(reader), keys.clone())),
            _ => Err(Failure::Wrong(format!("{}: the job has no reader; add one", job.name))),
        }
    }
}

/// Error for a sensor model of small footprints.
pub(super) fn with_sensor_model(file: &Path) -> Failure {
    let problem = "noise and response of large footprints are learnt from their beam; leave out `model`";
    Failure::Wrong(format!("{}: {problem}", file.display()))
}

impl FootprintChain {
    /// Chain of a request.
    ///
    /// # Errors
    /// If the job is invalid or has no `measure_footprints`.
    pub fn of(request: &ExplainRequest) -> Result<FootprintChain, Failure> {
        let file = request.file.to_owned();
        let set = if request.job.is_some() { &[] } else { request.set };
        let name = file.display().to_string();
        let format = reader_of(&name).map_err(Failure::Wrong)?;
        let default_job = default_job(format, &[MEASURE], &name, set)?;
        let overrides = request.set.iter().map(Override::new).collect();
        let given = request.job.map(|path| job_file::read(path, overrides)).transpose()?;
        let job = given.as_ref().unwrap_or(&default_job);
        let folder = request.job.map_or_else(|| PathBuf::from("."), job_file::folder);
        let (input_dir, _) = run::folders(job, &folder);
        let mut measure: MeasureFootprints = keys_of(job, MEASURE)?;
        if let Some(model) = request.model {
            measure.load = Some(absolute(model));
        }
        let reads_it = job.stages.first().is_some_and(|first| first.spec.name == format);
        Ok(FootprintChain {
            reader: ProfileReader::of(if reads_it { job } else { &default_job }, &file)?,
            file,
            progress: request.progress,
            measure,
            input_dir,
        })
    }

    fn run(&self) -> RunContext {
        RunContext { input_dir: self.input_dir.clone(), ..RunContext::alone(&self.file) }
    }

    /// Number of shots from which the model is learnt; 0 for a loaded model.
    fn shots_to_learn(&self) -> u64 {
        if self.measure.load.is_some() { 0 } else { self.measure.shots }
    }

    /// Opens the recording for random access.
    fn recording(&self) -> Result<Recording, Failure> {
        let (reader, keys): (Arc<dyn SourcePlan>, _) = match &self.reader {
            ProfileReader::Hdf5(reader) => {
                (Arc::new(reader.clone()), serde_json::to_value(reader).map_err(|error| failed(&error))?)
            }
            ProfileReader::Other(reader, keys) => (Arc::clone(reader), keys.clone()),
        };
        Recording::of_reader(reader, &keys, self.run()).map_err(|error| failed(&error))
    }

    /// Measures the shot with this number in its mission, or else this running number.
    ///
    /// Reads the shots from which the stage learns, the first ones of the beam, and the shot.
    ///
    /// # Errors
    /// If the recording cannot be read, has no such shot, or the shot cannot be measured.
    pub fn explain(&self, shot: u64) -> Result<ExplainedFootprint, Failure> {
        match &self.reader {
            ProfileReader::Hdf5(reader) => {
                let place = reader.find(&self.file, shot).map_err(|error| failed(&error))?;
                self.explain_at(reader, &place)
            }
            ProfileReader::Other(reader, _) => self.explain_in_order(&**reader, shot),
        }
    }

    /// Measures the shot with this running number.
    ///
    /// # Errors
    /// As [`FootprintChain::explain`].
    pub fn explain_running(&self, shot: u64) -> Result<ExplainedFootprint, Failure> {
        match &self.reader {
            ProfileReader::Hdf5(reader) => {
                let place = reader.at(&self.file, shot).map_err(|error| failed(&error))?;
                self.explain_at(reader, &place)
            }
            ProfileReader::Other(reader, _) => self.explain_in_order(&**reader, shot),
        }
    }

    /// Returns the running number of the shot nearest to a time, and its time, s.
    ///
    /// # Errors
    /// If the recording cannot be read, its shots have no times, or the time is outside of theirs.
    pub fn nearest(&self, time_s: f64) -> Result<(u64, f64), Failure> {
        nearest(self.recording()?, &self.file, self.progress, time_s)
    }

    /// Reads lines until the shot was found and those from which the stage learns, the first ones of its beam.
    fn explain_in_order(&self, reader: &dyn SourcePlan, shot: u64) -> Result<ExplainedFootprint, Failure> {
        let mut source = reader.make(&self.run()).map_err(|error| failed(&error))?;
        let (mut cx, mut seen) = (Context::default(), ShotNumbers::default());
        let (mut first, mut shots) = (Vec::<ScanLine>::new(), 0);
        let mut found: Option<(ScanLine, u32)> = None;
        while let Some(line) = source.next(&mut cx).map_err(|error| failed(&error))? {
            let is_other_beam = first.first().is_some_and(|first| !Arc::ptr_eq(&first.input, &line.input));
            if found.is_some() && (is_other_beam || shots >= self.shots_to_learn()) {
                break;
            }
            if is_other_beam {
                (first, shots) = (Vec::new(), 0);
            }
            line.emissions.iter().for_each(|emission| seen.add(emission.shot));
            if found.is_none() {
                found = index_of(&line, shot).map(|index| (line.copied(), index));
            }
            if shots < self.shots_to_learn() {
                shots += line.distinct_waveforms();
                first.push(line);
            }
        }
        let Some((line, index)) = found else {
            return Err(Failure::Wrong(seen.without(shot, &self.file)));
        };
        let file = self.file.display().to_string();
        let seen = self.measure.seen(&self.run(), &first, &line, index);
        let seen = seen.map_err(|error| Failure::Run(format!("{file}: {error}")))?;
        let problem = format!("{file}: shot {shot} has no background beside its signal; choose another one");
        let seen = seen.ok_or(Failure::Wrong(problem))?;
        Ok(ExplainedFootprint { file, seen })
    }

    fn explain_at(
        &self,
        reader: &ReadHdf5,
        BeamShot { beam, index }: &BeamShot,
    ) -> Result<ExplainedFootprint, Failure> {
        let file = self.file.display().to_string();
        let stage_failed = |error| failed(&error);
        let reader = reader.of_beam(beam);
        let run = self.run();
        let mut source = SourceConfig::make(&reader, &run).map_err(stage_failed)?;
        let mut cx = Context::default();
        let (mut first, mut shots) = (Vec::new(), 0);
        while shots < self.shots_to_learn()
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
        let seen = self.measure.seen(&self.run(), &first, &line, 0);
        let seen = seen.map_err(|error| Failure::Run(format!("{file}: {error}")))?;
        let seen = seen.ok_or_else(|| without("no background beside its signal"))?;
        Ok(ExplainedFootprint { file, seen })
    }
}

/// Index in a line of the shot with this number in its mission, or else this running number.
fn index_of(line: &ScanLine, shot: u64) -> Option<u32> {
    let records = line.blocks().map_or(&[][..], |blocks| &blocks.footprints);
    let by_mission = records.iter().find(|record| record.shot_number == shot).map(|record| record.emission);
    by_mission
        .or_else(|| (0..).zip(&line.emissions).find(|(_, found)| found.shot == shot).map(|(index, _)| index))
}
