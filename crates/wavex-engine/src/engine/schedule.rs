//! Runs the chain over the inputs of a job, several at once.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crossbeam_channel::Sender;

use super::chain::{self, Common};
use super::failure::{THREAD_PREFIX, guarded, no_thread};
use super::worker::Gauge;
use super::{Cancel, Cause, InputSummary, Options, Progress, RunError, is_placed};
use crate::job::Job;
use wavex_line::georef::Loader;
use wavex_line::stage::{Context, RunContext, StageError};
use wavex_line::system::Unpoisoned as _;

/// Results of an input: the work done, and the first cause of a failure.
pub(super) type Ended = (InputSummary, Option<RunError>);

/// What inputs that run at the same time share.
pub(super) struct Shared<'a> {
    pub(super) job: &'a Job,
    pub(super) options: &'a Options,
    pub(super) common: &'a Common,
    pub(super) geometry: Mutex<Loader>,
    pub(super) cx: Context,
    pub(super) has_several_inputs: bool,
}

/// Runs inputs, several at the same time, and gives their results to `take` in their order.
///
/// `ends` decides whether an error ends the run; `take` returns whether the run ends. Later inputs are
/// then cancelled. Returns the results of those that had already ended.
pub(super) fn run(
    shared: &Shared,
    inputs: Vec<(usize, RunContext)>,
    progress: &mut Progress,
    ends: impl Fn(&RunError) -> bool,
    mut take: impl FnMut(&mut Progress, usize, Ended) -> bool,
) -> Vec<(usize, Ended)> {
    let at_once = shared.options.at_once();
    let mut due = inputs.iter().map(|(number, _)| *number).collect::<VecDeque<usize>>();
    let mut waiting = inputs.into_iter();
    let mut running: BTreeMap<usize, Cancel> = BTreeMap::new();
    let mut ended: BTreeMap<usize, Ended> = BTreeMap::new();
    std::thread::scope(|scope| {
        let (sender, receiver) = crossbeam_channel::bounded(at_once);
        // `sender` lives as long as the loop, so nothing but a timeout ends `recv_timeout` early.
        while !due.is_empty() || !running.is_empty() {
            let is_cancelled = shared.options.cancel.is_cancelled();
            // After a cancellation, the next input only reports it.
            let is_ending = ended.values().any(|(_, error)| error.as_ref().is_some_and(&ends));
            let may_run = if is_cancelled { 1 } else { at_once };
            // Results of later inputs are kept in memory until a slow one ends.
            let may_wait = 2 * at_once;
            while !due.is_empty()
                && !is_ending
                && running.len() < may_run
                && running.len() + ended.len() < may_wait
            {
                let Some((number, run)) = waiting.next() else { break };
                let (cancel, gauge) = (Cancel::default(), Arc::<Gauge>::default());
                progress.begin(number, &run.stem, &gauge);
                running.insert(number, cancel.clone());
                let (sender, not_run) = (sender.clone(), InputSummary::not_run(&run));
                let name = format!("{THREAD_PREFIX}{}", run.stem);
                let body = move || one(shared, number, run, cancel, &gauge, &sender);
                if let Err(error) = std::thread::Builder::new().name(name).spawn_scoped(scope, body) {
                    running.remove(&number);
                    let error = no_thread(&error);
                    ended.insert(number, (not_run.failed(&error), Some(error)));
                }
            }
            if is_cancelled || due.is_empty() {
                running.values().for_each(Cancel::cancel);
            }
            match receiver.recv_timeout(Duration::from_millis(100)) {
                Ok((number, result)) => {
                    running.remove(&number);
                    ended.insert(number, result);
                }
                Err(_) => progress.show(),
            }
            while let Some(result) = due.front().and_then(|number| ended.remove(number)) {
                let Some(number) = due.pop_front() else { break };
                progress.end(number);
                if take(progress, number, result) {
                    due.clear();
                }
            }
        }
    });
    let is_interrupted =
        |error: &RunError| matches!(error.cause, Cause::Interrupted | Cause::Stage(StageError::Stopped));
    ended.retain(|_, (_, error)| !error.as_ref().is_some_and(is_interrupted));
    ended.into_iter().collect()
}

/// Runs the chain over one input and sends its results.
fn one(
    shared: &Shared,
    number: usize,
    run: RunContext,
    cancel: Cancel,
    gauge: &Gauge,
    ended: &Sender<(usize, Ended)>,
) {
    let run = RunContext { cancelled: cancel.flag(), ..run };
    let options = Options { cancel, ..shared.options.clone() };
    let (input, not_run) = (run.input.clone(), InputSummary::not_run(&run));
    let result = guarded(|| Ok(run_input(shared, run, &options, gauge))).unwrap_or_else(|cause| {
        let error = RunError { stage: None, input: Some(input), cause };
        (not_run.failed(&error), Some(error))
    });
    // The receiver is gone if the run ends because of another input.
    let _ = ended.send((number, result));
}

/// Runs the chain over one input; returns the work done and the first cause of a failure.
pub(super) fn run_input(shared: &Shared, mut run: RunContext, options: &Options, gauge: &Gauge) -> Ended {
    let is_placed = || is_placed(shared.job, &run.input, &run.input_dir);
    let loaded = shared.geometry.lock().unpoisoned().load(&run.stem, is_placed);
    match loaded {
        Ok(its_geometry) => {
            run.geometry = Arc::new(its_geometry);
            run.read_ppm = Arc::clone(&gauge.read_ppm);
            run.calibration = Arc::clone(&gauge.calibration);
        }
        Err(error) => {
            let not_run = InputSummary::not_run(&run);
            let cause = Cause::Stage(error.into());
            let error = RunError { stage: None, input: Some(run.input), cause };
            return (not_run.failed(&error), Some(error));
        }
    }
    let observer = options.observers.as_ref().map(|observers| observers.of_input(&run.stem));
    let mut cx = shared.cx.another().observed(observer);
    if shared.has_several_inputs {
        cx = cx.of_input(&run.stem);
    }
    let (input, error) = chain::run(shared.job, &Arc::new(run), options, shared.common, gauge, &cx);
    match error {
        Some(error) => (input.failed(&error), Some(error)),
        None => (input, None),
    }
}
