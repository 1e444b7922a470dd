//! Runs a job: one thread per stage (several for a map), bounded channels between them, and a report at the end.
//!
//! This is the only place that knows of threads and channels. Three promises are kept here:
//! * the end of a stream is said, by an `End` message: a channel that hangs up means that the run has failed, and the
//!   first true cause is reported, not its echoes;
//! * lines come out in the order they came in, whatever the number of workers;
//! * no file gets its final name before every stage has succeeded.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

use crate::geometry::Loader;
use crate::job::Job;
use crate::kernels::lockstep;
use crate::stage::{Context, OutputLock, Plan, Site, StageError};

mod chain;
mod failure;
mod inputs;
mod link;
mod meter;
mod progress;
mod report;
mod stat_log;
mod trace;
mod worker;

pub(crate) use chain::may_hold_bytes;
pub use failure::{Cancel, Cause, RunError};
pub use inputs::Input;
pub(crate) use inputs::expand;
pub use progress::{Progress, ProgressMode};
pub use report::{InputReport, ItemCounts, RunReport, StageReport, Summary, Totals, TrajectoryReport};
pub use stat_log::{geometry_words, sensor_model_words, stat_log};

/// Where a job runs, and how.
#[derive(Clone, Debug)]
pub struct Options {
    /// Where relative input paths start.
    pub input_dir: PathBuf,
    /// Where relative output paths start.
    pub output_dir: PathBuf,
    /// Workers per map; 0: as many as the machine has cores.
    pub threads: usize,
    /// How many lines may wait between two stages.
    pub channel_capacity: usize,
    /// The instructions that kernels use; the results do not depend on it.
    pub simd: lockstep::Path,
    /// Keep what a trace needs.
    pub profile: bool,
    /// Ends the run early when it is set.
    pub cancel: Cancel,
    /// How to show how far the run is.
    pub progress: ProgressMode,
    /// Gather what a page shows of each input.
    pub overview: bool,
}

impl Options {
    /// The options that a job asks for, in these folders.
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
            overview: !job.settings.report_page.is_empty(),
        }
    }

    /// How many workers each map has.
    pub fn workers(&self) -> usize {
        match self.threads {
            0 => cores().unwrap_or(1),
            threads => threads,
        }
    }
}

/// How many threads the machine runs at once, where it tells.
pub fn cores() -> Option<usize> {
    std::thread::available_parallelism().ok().map(usize::from)
}

/// The inputs of a job, one run each, in order.
///
/// # Errors
/// A pattern that fits no file, and inputs whose outputs would have the same names.
pub fn inputs(job: &Job, input_dir: &Path) -> Result<Vec<Input>, RunError> {
    let Some(Plan::Source(source)) = job.stages.first().map(|stage| &stage.planned.plan) else {
        return Err(RunError::of_job(StageError::failed("the job has no source", "begin it with a reader")));
    };
    inputs::expand(source.paths(), source.stem(), input_dir)
}

/// A run that failed: why, and what it had done by then.
#[derive(Debug)]
pub struct FailedRun {
    /// The first true cause, with its stage and input.
    pub error: RunError,
    /// The run, with the inputs that were finished before it failed; their outputs stay.
    pub report: RunReport,
    /// The input that it failed on; all inputs where it failed before the first one.
    pub unfinished: Vec<InputReport>,
}

/// Runs the chain once per input, and says what happened.
///
/// # Errors
/// The first true cause, with its stage and input. The outputs of inputs that were finished before it stay; of the one
/// that failed, no file is left.
pub fn run(job: &Job, options: &Options) -> Result<RunReport, RunError> {
    run_or_report(job, options).map_err(|failed| failed.error)
}

/// Runs the chain once per input, and reports failures, too.
///
/// # Errors
/// As [`run`], with what was done.
pub fn run_or_report(job: &Job, options: &Options) -> Result<RunReport, Box<FailedRun>> {
    failure::catch_panic_messages();
    let started = Instant::now();
    let mut report = RunReport::new(job, options);
    let mut unfinished = Vec::new();
    let done = run_inputs(job, options, &mut report, &mut unfinished);
    report.wall_s = started.elapsed().as_secs_f64();
    match done {
        Ok(()) => Ok(report),
        Err(error) => Err(Box::new(FailedRun { error, report, unfinished })),
    }
}

fn run_inputs(
    job: &Job,
    options: &Options,
    report: &mut RunReport,
    unfinished: &mut Vec<InputReport>,
) -> Result<(), RunError> {
    let started = Instant::now();
    let site = |input: inputs::Input| Site {
        input: input.path,
        stem: input.stem,
        input_dir: options.input_dir.clone(),
        output_dir: options.output_dir.clone(),
        threads: options.workers(),
        simd: options.simd,
        geometry: Arc::default(),
    };
    let sites: Vec<Site> = inputs(job, &options.input_dir)?.into_iter().map(site).collect();
    let begin = || {
        let geometry = Loader::new(&job.settings.geometry, &options.input_dir).map_err(RunError::of_job)?;
        inputs::keep_from_outputs(job, &sites)?;
        let lock = OutputLock::take(&inputs::outputs(job, &sites)).map_err(RunError::of_job)?;
        Ok((geometry, lock))
    };
    // The lock is held until the end of the run.
    let (mut geometry, _lock) = match begin() {
        Ok(begun) => begun,
        Err(error) => {
            unfinished.extend(sites.iter().map(|site| InputReport::not_begun(site, started)));
            return Err(error);
        }
    };
    let mut progress = Progress::new(options.progress, sites.len());
    let cx = Context::default();
    for mut site in sites {
        match geometry.load(&site.stem) {
            Ok(its_geometry) => site.geometry = Arc::new(its_geometry),
            Err(error) => {
                unfinished.push(InputReport::not_begun(&site, started));
                return Err(RunError { stage: None, input: Some(site.input), cause: Cause::Stage(error) });
            }
        }
        match chain::run(job, &Arc::new(site), options, &mut progress, &cx) {
            Ok(result) => report.add(result),
            Err((error, result)) => {
                unfinished.push(*result);
                return Err(error);
            }
        }
    }
    Ok(())
}

/// Writes the trace of a profiled run for Perfetto or chrome://tracing (the Trace Event Format, JSON).
pub fn write_trace(report: &RunReport, out: &mut dyn std::io::Write) -> std::io::Result<()> {
    trace::write(report, out)
}
