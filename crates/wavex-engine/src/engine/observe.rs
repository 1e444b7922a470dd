//! Runs a chain without sinks over one input, as far as an observer wants.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::ControlFlow;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crossbeam_channel::RecvTimeoutError;

use super::chain::Common;
use super::failure::{THREAD_PREFIX, no_thread};
use super::worker::Gauge;
use super::{
    Cancel, Cause, Input, InputSummary, Options, Progress, ProgressMode, RunError, failure, pool,
    run_context, schedule, size,
};
use crate::job::Job;
use wavex_line::georef::Loader;
use wavex_line::scan_line::ScanLine;
use wavex_line::stage::{Context, DecomposedLine, FitShot, Result, RunContext, RunObserver, RunObservers};
use wavex_line::system::Unpoisoned as _;

/// Shows each line that leaves the chain to `look`, together with a state that is returned.
///
/// `Break` ends the run: the source reads no further.
///
/// # Errors
/// The first cause, with its stage.
pub fn observe<T, L>(
    job: &Job,
    input: Input,
    options: &Options,
    cx: Context,
    state: T,
    look: L,
) -> std::result::Result<T, RunError>
where
    T: Send + 'static,
    L: Fn(&mut T, &ScanLine) -> ControlFlow<()> + Send + Sync + 'static,
{
    observe_all(job, input, options, cx, state, look).map(|(state, _)| state)
}

/// As [`observe`]; also returns the counters and notes of the stages.
///
/// # Errors
/// The first cause, with its stage.
pub fn observe_all<T, L>(
    job: &Job,
    input: Input,
    options: &Options,
    cx: Context,
    state: T,
    look: L,
) -> std::result::Result<(T, InputSummary), RunError>
where
    T: Send + 'static,
    L: Fn(&mut T, &ScanLine) -> ControlFlow<()> + Send + Sync + 'static,
{
    let cancel = options.cancel.child();
    let state = Arc::new(Mutex::new(Some(state)));
    let probe = Probe { state: Arc::clone(&state), look, cancel: cancel.clone() };
    let options = Options { cancel, observers: Some(Arc::new(One(Arc::new(probe)))), ..options.clone() };
    let (summary, error) = run_one(job, input, &options, cx)?;
    let state = state.lock().unpoisoned().take();
    match (error, state) {
        (None | Some(RunError { cause: Cause::Interrupted, .. }), Some(state)) => Ok((state, summary)),
        (Some(error), _) => Err(error),
        (None, None) => Err(no_state()),
    }
}

/// Runs the chain over one input, without writing files; returns the work done and what ended it.
pub(super) fn run_one(
    job: &Job,
    input: Input,
    options: &Options,
    cx: Context,
) -> std::result::Result<schedule::Ended, RunError> {
    failure::catch_panic_messages();
    let geometry = Loader::new(&job.settings.geometry, &options.input_dir)
        .map_err(|error| RunError::of_job(error.into()))?;
    let common = Common::new(job, options);
    let geometry = Mutex::new(geometry);
    let shared = schedule::Shared { job, options, common: &common, geometry, cx, has_several_inputs: false };
    let run = RunContext { has_outputs: false, ..run_context(options, input, pool::start(options)?) };
    run_shown(&shared, run, options)
}

/// Runs the chain over an input and shows the progress.
fn run_shown(
    shared: &schedule::Shared,
    run: RunContext,
    options: &Options,
) -> std::result::Result<schedule::Ended, RunError> {
    let gauge = Arc::<Gauge>::default();
    if options.progress == ProgressMode::Hidden && options.watch.is_none() {
        return Ok(schedule::run_input(shared, run, options, &gauge));
    }
    let sizes = BTreeMap::from([(0, size(&run.input))]);
    let mut progress = Progress::new(options.progress, sizes).watched(options.watch.clone());
    progress.begin(0, &run.stem, &gauge);
    std::thread::scope(|scope| {
        let (sender, ended) = crossbeam_channel::bounded(1);
        let gauge = &gauge;
        let body = move || sender.send(Box::new(schedule::run_input(shared, run, options, gauge)));
        let thread = std::thread::Builder::new().name(THREAD_PREFIX.to_owned()).spawn_scoped(scope, body);
        thread.map_err(|error| no_thread(&error))?;
        loop {
            match ended.recv_timeout(Duration::from_millis(100)) {
                Ok(ended) => break Ok(*ended),
                Err(RecvTimeoutError::Timeout) => progress.show(),
                Err(RecvTimeoutError::Disconnected) => break Err(no_state()),
            }
        }
    })
}

/// Error of a chain that ended without a result.
fn no_state() -> RunError {
    RunError { stage: None, input: None, cause: Cause::Panic("the observer of a run lost its state".into()) }
}

/// Observer of the only input.
#[derive(Debug)]
struct One(Arc<dyn RunObserver>);

impl RunObservers for One {
    fn of_input(&self, _: &str) -> Arc<dyn RunObserver> {
        Arc::clone(&self.0)
    }
}

struct Probe<T, L> {
    state: Arc<Mutex<Option<T>>>,
    look: L,
    cancel: Cancel,
}

impl<T, L> fmt::Debug for Probe<T, L> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Probe")
    }
}

impl<T, L> RunObserver for Probe<T, L>
where
    T: Send,
    L: Fn(&mut T, &ScanLine) -> ControlFlow<()> + Send + Sync,
{
    fn line(&self, line: &ScanLine) {
        let mut state = self.state.lock().unpoisoned();
        // Further lines may leave the chain while it ends.
        if self.cancel.is_cancelled() {
            return;
        }
        if let Some(state) = state.as_mut()
            && (self.look)(state, line).is_break()
        {
            self.cancel.cancel();
        }
    }

    fn decomposed(&self, _: &DecomposedLine, _: &mut FitShot) -> Result<()> {
        Ok(())
    }
}
