//! Scan lines of a recording, processed again with other keys.

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use wavex_simd::SimdLevel;

use wavex_engine::job::{Job, JobStage};
use wavex_engine::recording::{LineIndex, Recording};
use wavex_line::scan_line::{InputInfo, Kind, ScanLine};
use wavex_line::stage::pose_source::PoseSource;
use wavex_line::stage::{
    Context, Instrument, InstrumentModel, Output, Plan, Result, RunContext, SensorDrift, Source, StageError,
    SurveyModels, Transform,
};
use wavex_signal::fusion::ChannelFusion;
use wavex_signal::sensor_model::SensorModel;
use wavex_stages::process::correct::WAVEFORMS;
use wavex_stages::process::measure_footprints::MeasureFootprints;
use wavex_stages::process::resolve_mta::LINES_AROUND;

/// Lines that are read at once to learn from.
const LINES_AT_ONCE: usize = 64;

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
    pub(super) fn models(&self, stem: &str) -> SurveyModels {
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
pub(super) struct InputLines {
    recording: Recording,
    index: Arc<LineIndex>,
    /// The job of the view.
    job: Job,
    run: RunContext,
    /// Transforms after `decompose`, which have learnt from the first lines as in a run; `None` until then.
    trained: Option<Vec<Box<dyn Transform>>>,
    /// Lines that passed the stages before `decompose` last: their numbers, the keys of the stages, and
    /// the lines.
    before_decompose: Option<(Range<usize>, String, Vec<ScanLine>)>,
}

impl InputLines {
    /// Opens the input of a run, and reads or makes its index.
    ///
    /// # Errors
    /// If it cannot be read in any order.
    pub(super) fn open(job: Job, run: RunContext) -> Result<InputLines> {
        let Some((Plan::Source(reader), keys)) =
            job.stages.first().map(|stage| (&stage.planned.plan, &stage.planned.resolved))
        else {
            return Err(StageError::failed(format!("{}: the job has no reader", job.name), "add one"));
        };
        let mut recording = Recording::of_reader(Arc::clone(reader), keys, run.clone())?;
        let index = recording.index(&mut |_| match run.cancelled.load(Ordering::Relaxed) {
            true => Err(StageError::Stopped),
            false => Ok(()),
        })?;
        Ok(InputLines { recording, index, job, run, trained: None, before_decompose: None })
    }

    pub(super) fn simd(&self) -> SimdLevel {
        self.run.simd
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

    /// Lines with these numbers after the stages before `decompose`.
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

    /// Folders and threads of the recording.
    pub(super) fn run(&self) -> &RunContext {
        &self.run
    }

    /// Lines with these numbers after all stages that determine their points.
    ///
    /// Stages after `decompose` keep what they learnt with the keys of the view's job.
    pub(super) fn with_points(&mut self, job: &Job, numbers: Range<usize>) -> Result<Vec<ScanLine>> {
        if let Some(measure) = measures_footprints(job)? {
            let first = self.first_of_beam(numbers.start, measure.shots)?;
            return self.with_footprints(job, &first, numbers);
        }
        self.train()?;
        let before: Vec<ScanLine> =
            self.before_decompose(job, numbers)?.iter().map(ScanLine::copied).collect();
        through(after_decompose(job), &self.run, before, self.trained.as_deref_mut().unwrap_or_default())
    }

    /// Lines of one beam with these numbers, measured by the model of the first lines of the beam, as in a run.
    pub(super) fn with_footprints(
        &mut self,
        job: &Job,
        first: &[ScanLine],
        numbers: Range<usize>,
    ) -> Result<Vec<ScanLine>> {
        let wanted = self.before_decompose(job, numbers)?;
        let numbers: Vec<u32> = wanted.iter().map(|line| line.line).collect();
        let others = first.iter().filter(|line| !numbers.contains(&line.line));
        let mut lines: Vec<ScanLine> = others.chain(wanted).map(ScanLine::copied).collect();
        lines.sort_by_key(|line| line.line);
        // The stage knows a beam by its metadata, which each reading makes anew.
        if let Some(input) = lines.first().map(|line| Arc::clone(&line.input)) {
            lines.iter_mut().for_each(|line| line.input = Arc::clone(&input));
        }
        let mut measured = through(after_decompose(job), &self.run, lines, &mut [])?;
        measured.retain(|line| numbers.contains(&line.line));
        Ok(measured)
    }

    /// The first lines of the beam of a line, with at least this many shots if it has them.
    pub(super) fn first_of_beam(&mut self, number: usize, shots: u64) -> Result<Vec<ScanLine>> {
        let mut beam_of = |number: usize| {
            Ok::<_, StageError>(self.recording.line(number)?.and_then(|line| line.input.beam.clone()))
        };
        let beam = beam_of(number)?;
        let (mut first, mut high) = (0, number);
        while first < high {
            let middle = first.midpoint(high);
            if beam_of(middle)? == beam { high = middle } else { first = middle + 1 }
        }
        let end = self.end_of_waveforms(first, shots);
        let mut lines = self.read(&self.job.stages.clone()[..1], first..end)?;
        lines.retain(|line| line.input.beam == beam);
        Ok(lines)
    }

    /// Lets the transforms after `decompose` learn from as many waveforms as in a run.
    fn train(&mut self) -> Result<()> {
        if self.trained.is_some() {
            return Ok(());
        }
        let job = self.job.clone();
        let stages = after_decompose(&job);
        let mut trained = Vec::new();
        for stage in stages.iter().filter(|stage| !is_skipped(stage)) {
            if let Plan::Transform(plan) = &stage.planned.plan {
                trained.push(plan.make(&self.run)?);
            }
        }
        let (mut first, mut waveforms, mut decomposed) = (0, 0, Vec::new());
        while !trained.is_empty() && waveforms < WAVEFORMS && first < self.index.lines().len() {
            let end = self.end_of_waveforms(first, WAVEFORMS - waveforms);
            let lines = self.read(before_decompose(&job), first..end)?;
            waveforms += lines.iter().map(|line| line.stats.nw).sum::<u64>();
            decomposed.extend(through(&stages[..1], &self.run, lines, &mut [])?);
            first = end;
        }
        through(&stages[1..], &self.run, decomposed, &mut trained)?;
        self.trained = Some(trained);
        Ok(())
    }

    /// End of the lines from `first` on that have this many shots, or of as many as are read at once.
    fn end_of_waveforms(&self, first: usize, shots: u64) -> usize {
        let lines = self.index.lines().iter().skip(first).take(LINES_AT_ONCE);
        let sums = lines.scan(0, |sum, line| {
            *sum += u64::from(line.shots);
            Some(*sum)
        });
        (first + 1 + sums.take_while(|sum| *sum < shots).count()).min(self.index.lines().len())
    }

    /// Reads lines and passes them through stages; reads more lines around them where a stage needs these.
    fn read(&mut self, stages: &[JobStage], numbers: Range<usize>) -> Result<Vec<ScanLine>> {
        let resolves = stages.iter().any(|stage| stage.spec.name == "resolve_mta");
        let margin = if resolves { LINES_AROUND } else { 0 };
        let first = numbers.start.saturating_sub(margin);
        let end = (numbers.end + margin).min(self.index.lines().len());
        let mut lines = Vec::new();
        // The first line decides on the axis of times and on the zone of coordinates.
        for number in (first > 0).then_some(0).into_iter().chain(first..end) {
            lines.extend(self.recording.line(number)?);
        }
        let wanted: Vec<u32> =
            self.index.lines().get(numbers).into_iter().flatten().map(|line| line.location.line).collect();
        let mut source =
            PoseSource::new(Box::new(GivenLines(lines.into_iter())), Arc::clone(&self.run.geometry));
        let (mut placed, mut cx) = (Vec::new(), Context::default());
        while let Some(line) = source.next(&mut cx)? {
            placed.push(line);
        }
        let mut lines = through(&stages[1..], &self.run, placed, &mut [])?;
        lines.retain(|line| wanted.contains(&line.line));
        Ok(lines)
    }
}

/// Keys of the stage of a job that measures footprints, if it has one.
pub(super) fn measures_footprints(job: &Job) -> Result<Option<MeasureFootprints>> {
    let stage = job.stages.iter().find(|stage| stage.spec.name == "measure_footprints");
    let keys = stage.map(|stage| serde_json::from_value(stage.planned.resolved.clone()));
    keys.transpose().map_err(|error| {
        StageError::failed(format!("`measure_footprints`: {error}"), "please report this bug in wavex")
    })
}

/// Stages before `decompose`, the reader included.
fn before_decompose(job: &Job) -> &[JobStage] {
    let end = job.stages.iter().position(|stage| stage.spec.gives(Some(Kind::Shots)) == Some(Kind::Returns));
    &job.stages[..end.unwrap_or(job.stages.len().saturating_sub(1))]
}

/// `decompose` and all stages after it.
fn after_decompose(job: &Job) -> &[JobStage] {
    &job.stages[before_decompose(job).len()..]
}

/// Whether lines do not pass through a stage: sinks, and `filter_outliers`, which needs all lines around.
fn is_skipped(stage: &JobStage) -> bool {
    matches!(stage.planned.plan, Plan::Source(_) | Plan::Sink(_)) || stage.spec.name == "filter_outliers"
}

/// Passes lines through stages one after the other; `trained` are their transforms, otherwise new ones are made.
fn through(
    stages: &[JobStage],
    run: &RunContext,
    mut lines: Vec<ScanLine>,
    trained: &mut [Box<dyn Transform>],
) -> Result<Vec<ScanLine>> {
    let mut cx = Context::default();
    let mut trained = trained.iter_mut();
    for stage in stages.iter().filter(|stage| !is_skipped(stage)) {
        match &stage.planned.plan {
            Plan::Source(_) | Plan::Sink(_) => {}
            Plan::Map(plan) => {
                let mut map = plan.make(run)?;
                lines = lines.into_iter().map(|line| map.map(line, &mut cx)).collect::<Result<_>>()?;
            }
            Plan::Transform(plan) => {
                let mut new = None;
                let transform = match trained.next() {
                    Some(transform) => transform,
                    None => new.insert(plan.make(run)?),
                };
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
struct GivenLines(std::vec::IntoIter<ScanLine>);

impl Source for GivenLines {
    fn next(&mut self, _: &mut Context) -> Result<Option<ScanLine>> {
        Ok(self.0.next())
    }
}
