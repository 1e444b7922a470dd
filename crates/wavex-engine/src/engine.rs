//! Runs a job: one thread per stage (several per map), bounded channels, and a summary.
//!
//! Only this module uses threads and channels. It guarantees:
//! * An `End` message ends a stream. A disconnected channel means that the run has failed; the
//!   first cause is reported, not its consequences.
//! * Lines leave in the order in which they entered, whatever the number of workers.
//! * No file gets its final name before every stage has succeeded on its input.
//! * An input that fails does not affect the others.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};
use std::time::Instant;

use rayon::ThreadPool;
use wavex_simd::SimdLevel;

use crate::job::{Job, OnError};
use wavex_line::georef::Loader;
use wavex_line::stage::{Context, OutputLock, Plan, RunContext, RunObservers, StageError, SurveyModels};

mod chain;
mod failure;
mod first_line;
mod input_state;
mod inputs;
mod link;
mod meter;
mod observe;
mod pool;
mod progress;
mod schedule;
mod stage_summary;
mod stream;
mod summary;
mod survey;
mod totals;
mod trace;
mod worker;

pub use failure::{Cancel, Cause, RunError};
pub use first_line::{first_line, info_of, is_placed};
pub use inputs::Input;
pub use inputs::{expand, size, sizes};
pub use observe::observe;
pub use observe::observe_all;
pub use progress::{Phase, Progress, ProgressMode, ProgressWatch, rate, terminal_columns, without_bar};
pub use stage_summary::{ItemCounts, Percentiles, StageSummary};
pub use stream::{Convert, Next, Stream, stream};
pub use summary::{InputStatus, InputSummary, RunSummary, StageKeys, TrajectorySummary, host};
pub use survey::{learn_survey_models, shares_models, survey_models};
pub use worker::Gauge;

use failure::SharedFiles;

/// Folders, resources and observers of a run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Folder at which relative input paths start.
    pub input_dir: PathBuf,
    /// Folder at which relative output paths start.
    pub output_dir: PathBuf,
    /// Workers per map; 0: one per core.
    pub threads: usize,
    /// Maximum number of lines that wait between two stages.
    pub channel_capacity: usize,
    /// SIMD instructions of the kernels; results do not depend on them.
    pub simd: SimdLevel,
    /// Whether to record spans for a trace.
    pub profile: bool,
    /// Ends the run early when set.
    pub cancel: Cancel,
    /// Progress display.
    pub progress: ProgressMode,
    /// Receives the progress, whether it is displayed or not.
    pub watch: Option<ProgressWatch>,
    /// Observers of the lines, such as the observer of the report page.
    pub observers: Option<Arc<dyn RunObservers>>,
    /// Number of inputs that run at the same time; 0: as many as help.
    pub inputs_at_once: usize,
    /// Stems of the inputs to skip.
    pub skip: BTreeSet<String>,
    /// Sensor models of the survey; `None`: as the job requests.
    pub survey: Option<Arc<SurveyModels>>,
}

impl Options {
    /// Options requested by a job, in these folders.
    pub fn of_job(job: &Job, input_dir: impl Into<PathBuf>, output_dir: impl Into<PathBuf>) -> Options {
        Options {
            input_dir: input_dir.into(),
            output_dir: output_dir.into(),
            threads: job.settings.threads,
            channel_capacity: job.settings.channel_capacity,
            simd: job.settings.simd.path(),
            profile: false,
            cancel: Cancel::default(),
            progress: ProgressMode::Hidden,
            watch: None,
            observers: None,
            inputs_at_once: job.settings.inputs_at_once,
            skip: BTreeSet::new(),
            survey: None,
        }
    }

    /// Number of workers of each map.
    pub fn workers(&self) -> usize {
        match self.threads {
            0 => cores().unwrap_or(1),
            threads => threads,
        }
    }
}

impl Options {
    /// Number of inputs that run at the same time.
    ///
    /// While one is opened, calibrated or completed, the workers of another are busy. More than two
    /// help where workers are many, because readers and writers have one thread each. At most four: each
    /// has as many threads as workers.
    pub fn at_once(&self) -> usize {
        match self.inputs_at_once {
            0 if self.workers() == 1 => 1,
            0 => (self.workers() / 4).clamp(2, 4),
            inputs => inputs,
        }
    }
}

/// Number of available cores, if known.
pub fn cores() -> Option<usize> {
    std::thread::available_parallelism().ok().map(usize::from)
}

/// Lists the inputs of a job, one run each, in order.
///
/// # Errors
/// If a pattern matches no file, or the outputs of two inputs would have the same names.
pub fn inputs(job: &Job, input_dir: &Path) -> Result<Vec<Input>, RunError> {
    let (inputs, errors) = find_inputs(job, input_dir);
    errors.into_iter().next().map_or(Ok(inputs), Err)
}

/// Lists the inputs of a job like [`inputs`], and the problems of others.
pub fn find_inputs(job: &Job, input_dir: &Path) -> (Vec<Input>, Vec<RunError>) {
    match job.stages.first().map(|stage| &stage.planned.plan) {
        Some(Plan::Source(source)) => {
            let stem = [source.stem(), source.stem_suffix()];
            inputs::find(source.paths(), stem, input_dir, |path| source.parts(path))
        }
        _ => {
            let error = StageError::failed("the job has no source", "start it with a reader");
            (Vec::new(), vec![RunError::of_job(error)])
        }
    }
}

/// Receives the results of a run after each input.
///
/// The number is the index of the input in [`RunSummary::inputs`]; the error is its failure, unless that
/// ends the run.
pub type InputDone<'a> = dyn FnMut(&mut RunSummary, usize, Option<RunError>) -> Result<(), StageError> + 'a;

/// Runs the chain once per input and returns the results.
///
/// # Errors
/// The first failure, with its stage and input. Outputs of other inputs remain; no file of a failed
/// input remains.
pub fn run(job: &Job, options: &Options) -> Result<RunSummary, RunError> {
    let mut summary = RunSummary::new(job, options);
    let mut first = None;
    let ended = run_each(job, options, &mut summary, &mut |_, _, failure| {
        first = first.take().or(failure);
        Ok(())
    });
    match first.or(ended.err()) {
        Some(error) => Err(error),
        None => Ok(summary),
    }
}

/// Runs the chain once per input and updates the results after each.
///
/// An input that fails is recorded, and the next one follows unless the job has `on_error = "stop"`.
///
/// # Errors
/// What ends the run before the last input: a failure that concerns all inputs, an interruption, or
/// an error of `done`.
pub fn run_each(
    job: &Job,
    options: &Options,
    summary: &mut RunSummary,
    done: &mut InputDone,
) -> Result<(), RunError> {
    failure::catch_panic_messages();
    let started = Instant::now();
    let survey = match &options.survey {
        Some(models) => Some(Arc::clone(models)),
        None => survey_models(job, options)?.map(Arc::new),
    };
    let options = &Options { survey, ..options.clone() };
    summary.survey_models = options.survey.clone();
    let pool = pool::start(options)?;
    let stages: Arc<[_]> = job.stages.iter().map(|stage| stage.planned.in_chain(stage.spec.name)).collect();
    let run = |(number, input)| RunContext {
        number,
        chain: Arc::clone(&stages),
        ..run_context(options, input, pool.clone())
    };
    let runs: Vec<RunContext> = (1..).zip(inputs(job, &options.input_dir)?).map(run).collect();
    summary.inputs = runs.iter().map(InputSummary::not_run).collect();
    let geometry = Loader::new(&job.settings.geometry, &options.input_dir)
        .map_err(|error| RunError::of_job(error.into()))?;
    inputs::keep_from_outputs(job, &runs)?;
    let outputs = inputs::outputs(job, &runs);
    // The lock is held until the end of the run.
    let _lock = OutputLock::acquire(&outputs).map_err(RunError::of_job)?;
    let files = SharedFiles::new(job, options, &outputs);
    let (to_skip, to_run): (Vec<_>, Vec<_>) =
        runs.into_iter().enumerate().partition(|(_, run)| options.skip.contains(&run.stem));
    to_skip.iter().for_each(|(number, _)| summary.inputs[*number].status = InputStatus::Skipped);
    let sizes = inputs::sizes(to_run.iter().map(|(_, run)| run.input.as_path()));
    let sizes = to_run.iter().map(|(number, _)| *number).zip(sizes).collect();
    let mut progress = Progress::new(options.progress, sizes).watched(options.watch.clone());
    let common = chain::Common::new(job, options);
    let shared = schedule::Shared {
        job,
        options,
        common: &common,
        geometry: Mutex::new(geometry),
        cx: Context::of_run(),
        has_several_inputs: summary.inputs.len() > 1,
    };
    let mut result = Ok(());
    let ends = |error: &RunError| job.settings.on_error == OnError::Stop || files.concern(error);
    let take = |progress: &mut Progress, number: usize, (input, error): schedule::Ended| {
        summary.inputs[number] = input;
        progress.count(error.is_some());
        summary.wall_s = started.elapsed().as_secs_f64();
        result = match error {
            Some(error) if ends(&error) => {
                if let Err(another) = done(summary, number, None) {
                    tracing::warn!("{another}");
                }
                Err(error)
            }
            failure => done(summary, number, failure).map_err(RunError::of_job),
        };
        result.is_err()
    };
    let others = schedule::run(&shared, to_run, &mut progress, ends, take);
    for (number, (input, error)) in others {
        summary.inputs[number] = input;
        if let Err(another) = done(summary, number, error) {
            tracing::warn!("{another}");
        }
    }
    result
}

/// Context of a run over one input, still without geometry.
fn run_context(options: &Options, input: Input, pool: Option<Arc<ThreadPool>>) -> RunContext {
    RunContext {
        input: input.path,
        part: input.part,
        stem: input.stem,
        number: 1,
        input_dir: options.input_dir.clone(),
        output_dir: options.output_dir.clone(),
        pool,
        simd: options.simd,
        cancelled: options.cancel.flag(),
        geometry: Arc::default(),
        chain: Arc::default(),
        survey: options.survey.clone(),
        read_ppm: Arc::default(),
        calibration: Arc::default(),
        has_outputs: true,
    }
}

/// Writes the trace of a profiled run in Trace Event Format (JSON).
///
/// Perfetto and chrome://tracing open it.
pub fn write_trace(run: &RunSummary, out: &mut dyn std::io::Write) -> std::io::Result<()> {
    trace::write(run, out)
}
