//! Scan lines of a recording, processed again with other keys.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::engine::Input;
use crate::georef::Loader;
use crate::job::{Job, JobStage};
use crate::recording::{LineIndex, Recording};
use crate::scan_line::{InputInfo, Kind, ScanLine};
use crate::stage::{
    Context, Instrument, InstrumentModel, Output, Plan, Result, RunContext, SensorDrift, Source, StageError,
    SurveyModels,
};
use crate::stages::pose_source::PoseSource;
use wavex_signal::fusion::ChannelFusion;
use wavex_signal::sensor_model::SensorModel;
use wavex_signal::simd::SimdLevel;

/// Number of scan lines before and after a line from which `resolve_mta` decides on its zones.
const LINES_OF_ZONES: usize = 200;

/// What the stages have learnt from an input.
#[derive(Clone, Debug)]
pub(super) struct Learnt {
    pub(super) model: Option<Arc<SensorModel>>,
    pub(super) fusion: Option<Arc<ChannelFusion>>,
    pub(super) input: Arc<InputInfo>,
}

impl Learnt {
    /// What a line has that has left the chain.
    pub(super) fn of(line: &ScanLine) -> Learnt {
        Learnt { model: line.model.clone(), fusion: line.fusion.clone(), input: Arc::clone(&line.input) }
    }

    /// The same as models of a survey, which stages use instead of learning.
    fn models(&self, stem: &str) -> SurveyModels {
        let instrument = InstrumentModel {
            instrument: Instrument::of(&self.input),
            inputs: 1,
            fusion: self.fusion.as_deref().cloned(),
            sensor_model: self.model.clone(),
            notes: Vec::new(),
        };
        let input = SensorDrift { stem: stem.to_owned(), instrument: Some(0), ..SensorDrift::default() };
        SurveyModels { instruments: vec![instrument], inputs: vec![input], ..SurveyModels::new() }
    }
}

/// An input whose lines can be read in any order.
pub(super) struct Lines {
    recording: Recording,
    index: Arc<LineIndex>,
    site: RunContext,
    /// Lines that passed the stages before `decompose` last: their numbers, the keys of these stages, and
    /// the lines.
    before_decompose: Option<(Range<usize>, String, Vec<ScanLine>)>,
}

impl Lines {
    /// Opens an input of a job, and reads or makes its index.
    ///
    /// # Errors
    /// If it cannot be read in any order, or its trajectory cannot be read.
    pub(super) fn open(
        job: &Job,
        input: &Input,
        input_dir: &Path,
        learnt: &Learnt,
        cancelled: &Arc<AtomicBool>,
    ) -> Result<Lines> {
        let Some((Plan::Source(reader), keys)) =
            job.stages.first().map(|stage| (&stage.planned.plan, &stage.planned.resolved))
        else {
            return Err(StageError::failed(format!("{}: the job has no reader", job.name), "add one"));
        };
        let geometry = Loader::new(&job.settings.geometry, input_dir)?.load(&input.stem)?;
        let site = RunContext {
            stem: input.stem.clone(),
            input_dir: input_dir.to_owned(),
            simd: job.settings.simd.path(),
            cancelled: Arc::clone(cancelled),
            geometry: Arc::new(geometry),
            survey: Some(Arc::new(learnt.models(&input.stem))),
            has_outputs: false,
            ..RunContext::alone(&input.path)
        };
        let mut recording = Recording::of_reader(Arc::clone(reader), keys, site.clone())?;
        let index = recording.index(&mut |_| match cancelled.load(Ordering::Relaxed) {
            true => Err(StageError::Stopped),
            false => Ok(()),
        })?;
        Ok(Lines { recording, index, site, before_decompose: None })
    }

    pub(super) fn simd(&self) -> SimdLevel {
        self.site.simd
    }

    pub(super) fn index(&self) -> &LineIndex {
        &self.index
    }

    /// Position of the line of a shot in the index.
    pub(super) fn of_shot(&mut self, shot: u64) -> Result<Option<usize>> {
        for number in self.index.clone().of_shot(shot) {
            if let Some(line) = self.recording.line(number)?
                && line.emissions.iter().any(|emission| emission.shot == shot)
            {
                return Ok(Some(number));
            }
        }
        Ok(None)
    }

    /// Lines of these positions after the stages before `decompose`.
    pub(super) fn before_decompose(&mut self, job: &Job, numbers: Range<usize>) -> Result<&[ScanLine]> {
        let stages = before_decompose(job);
        let keys: String = stages.iter().map(|stage| stage.planned.resolved.to_string()).collect();
        let is_same = |(of, with, _): &(Range<usize>, String, _)| *of == numbers && *with == keys;
        if !self.before_decompose.as_ref().is_some_and(is_same) {
            self.before_decompose = None;
            let lines = self.read(stages, numbers.clone())?;
            self.before_decompose = Some((numbers, keys, lines));
        }
        Ok(self.before_decompose.as_ref().map_or(&[], |(_, _, lines)| lines))
    }

    /// Lines of these positions after all stages that determine their points.
    pub(super) fn with_points(&mut self, job: &Job, numbers: Range<usize>) -> Result<Vec<ScanLine>> {
        let before: Vec<ScanLine> =
            self.before_decompose(job, numbers)?.iter().map(ScanLine::copied).collect();
        let stages = &job.stages[before_decompose(job).len()..];
        through(stages, &self.site, before)
    }

    /// Reads lines and passes them through stages; reads more lines around them where a stage needs these.
    fn read(&mut self, stages: &[JobStage], numbers: Range<usize>) -> Result<Vec<ScanLine>> {
        let resolves = stages.iter().any(|stage| stage.spec.name == "resolve_mta");
        let margin = if resolves { LINES_OF_ZONES } else { 0 };
        let first = numbers.start.saturating_sub(margin);
        let end = (numbers.end + margin).min(self.index.lines().len());
        let mut lines = Vec::new();
        // The first line decides on the axis of times and on the zone of coordinates.
        for number in (first > 0).then_some(0).into_iter().chain(first..end) {
            lines.extend(self.recording.line(number)?);
        }
        let wanted: Vec<u32> =
            self.index.lines().get(numbers).into_iter().flatten().map(|line| line.location.line).collect();
        let mut source = PoseSource::new(Box::new(Given(lines.into_iter())), Arc::clone(&self.site.geometry));
        let (mut placed, mut cx) = (Vec::new(), Context::quiet());
        while let Some(line) = source.next(&mut cx)? {
            placed.push(line);
        }
        let mut lines = through(&stages[1..], &self.site, placed)?;
        lines.retain(|line| wanted.contains(&line.line));
        Ok(lines)
    }
}

/// Stages before `decompose`, the reader included.
fn before_decompose(job: &Job) -> &[JobStage] {
    let end = job.stages.iter().position(|stage| stage.spec.gives(Some(Kind::Shots)) == Some(Kind::Returns));
    &job.stages[..end.unwrap_or(job.stages.len().saturating_sub(1))]
}

/// Passes lines through stages one after the other.
///
/// Sinks are skipped, and `filter_outliers`, which needs all lines around.
fn through(stages: &[JobStage], site: &RunContext, mut lines: Vec<ScanLine>) -> Result<Vec<ScanLine>> {
    let mut cx = Context::quiet();
    for stage in stages.iter().filter(|stage| stage.spec.name != "filter_outliers") {
        match &stage.planned.plan {
            Plan::Source(_) | Plan::Sink(_) => {}
            Plan::Map(plan) => {
                let mut map = plan.make(site)?;
                lines = lines.into_iter().map(|line| map.map(line, &mut cx)).collect::<Result<_>>()?;
            }
            Plan::Transform(plan) => {
                let mut transform = plan.make(site)?;
                let mut passed = Vec::with_capacity(lines.len());
                let mut emit = |line| {
                    passed.push(line);
                    Ok(())
                };
                let mut out = Output::new(&mut cx, usize::MAX, &mut emit);
                lines.into_iter().try_for_each(|line| transform.process(line, &mut out))?;
                transform.finish(&mut out)?;
                lines = passed;
            }
        }
    }
    Ok(lines)
}

/// A source of given lines.
struct Given(std::vec::IntoIter<ScanLine>);

impl Source for Given {
    fn next(&mut self, _: &mut Context) -> Result<Option<ScanLine>> {
        Ok(self.0.next())
    }
}
