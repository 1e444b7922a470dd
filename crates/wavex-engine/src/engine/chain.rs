//! Runs the chain over one input: spawns threads, monitors, joins, publishes.

use std::path::PathBuf;
use std::sync::{Arc, Mutex};
use std::time::Instant;

use super::failure::{Failure, RunError, THREAD_PREFIX, guarded, no_thread};
use super::input_state::InputState;
use super::link::{Inlet, Outlet, link};
use super::meter::Meter;
use super::pool::Permits;
use super::stage_summary::StageSummary;
use super::summary::InputSummary;
use super::worker::{
    ChainState, Downstream, Gauge, WorkerContext, run_map, run_sink, run_source, run_transform,
};
use super::{Cause, Options};
use crate::job::{Job, JobStage};
use wavex_line::scan_line::Budget;
use wavex_line::stage::pose_source::PoseSource;
use wavex_line::stage::{Context, Counters, FinishedFile, Holds, Plan, Result, RunContext, StageError};
use wavex_line::system::Unpoisoned as _;

/// Results of a stage's workers, one entry per worker.
type WorkerResults = Mutex<Vec<(Meter, Context)>>;

/// Runs the chain over one input; `cx` is the context of the whole run.
///
/// Returns the work done, and the first true cause of a failure.
pub(super) fn run(
    job: &Job,
    run_context: &Arc<RunContext>,
    options: &Options,
    common: &Common,
    gauge: &Gauge,
    cx: &Context,
) -> (InputSummary, Option<RunError>) {
    let started = Instant::now();
    let state = InputState::of(&run_context.input);
    let shared = shared(job, options, common, gauge, cx);
    let worker_results: Vec<WorkerResults> = job.stages.iter().map(|_| WorkerResults::default()).collect();
    std::thread::scope(|scope| {
        for (index, work) in plan(job, options).into_iter().enumerate() {
            for (worker, (inlet, exit)) in work.into_iter().enumerate() {
                let (stage, shared, worker_results) = (&job.stages[index], &shared, &worker_results[index]);
                let body = move || {
                    run_worker(stage, run_context, shared, inlet, exit, options.profile, worker_results)
                };
                let name = format!("{THREAD_PREFIX}{}-{worker}", stage.id);
                if let Err(error) = std::thread::Builder::new().name(name).spawn_scoped(scope, body) {
                    // Not of this input: the others would have no threads either.
                    shared.failure.fail(&stage.id, None, no_thread(&error).cause);
                }
            }
        }
    });
    let budget_peak = shared.budget.peak();
    let totals = shared.totals.into_inner().unpoisoned();
    let flown = run_context.geometry.trajectory().map(|(_, trajectory)| trajectory);
    let aligned = totals.input.as_ref().and_then(|input| input.first_shot?.alignment);
    if let (Some(observer), Some(trajectory), Some(alignment)) = (cx.observer(), flown, aligned) {
        observer.trajectory(trajectory, &alignment);
    }
    let (stages, whole) = collect(job, worker_results, cx);
    let published = match shared.failure.into_error(&run_context.input) {
        Some(error) => Err(state.explain(error)),
        None => {
            let source = job.stages.first().map(|stage| stage.id.clone());
            let unchanged = state.check().map_err(|error| (source.unwrap_or_default(), error.into()));
            unchanged.and_then(|()| publish(whole)).map_err(|(stage, error)| RunError {
                stage: Some(stage),
                input: Some(run_context.input.clone()),
                cause: Cause::Stage(error),
            })
        }
    };
    let summary = |outputs| InputSummary::new(run_context, started, totals, stages, outputs, budget_peak);
    match published {
        Ok(outputs) => (summary(outputs), None),
        Err(error) => (summary(Vec::new()), Some(error)),
    }
}

/// Input and output ends of all workers, by stage.
fn plan(job: &Job, options: &Options) -> Vec<Vec<(Option<Inlet>, Downstream)>> {
    let workers = |stage: &JobStage| match stage.planned.plan {
        Plan::Map(_) => options.workers(),
        _ => 1,
    };
    let mut inlet: Option<Inlet> = None;
    let mut plan = Vec::with_capacity(job.stages.len());
    for (index, stage) in job.stages.iter().enumerate() {
        let n = workers(stage);
        let next = job.stages.get(index + 1).map(|next| link(options.channel_capacity, n, workers(next)));
        let (outlet, next_inlet): (Option<Outlet>, Option<Inlet>) = next.unzip();
        let exits = || outlet.as_ref().map_or(Downstream::Out, |outlet| Downstream::To(outlet.another()));
        plan.push((0..n).map(|_| (inlet.as_ref().map(Inlet::another), exits())).collect());
        inlet = next_inlet;
    }
    plan
}

/// Memory limit of all lines, bytes, and the maximum number of transforms that hold lines at the
/// same time (at least 1).
///
/// Of the transforms that hold only the first lines, one is active at a time: as long as it holds
/// lines, none reaches the next.
fn memory(job: &Job) -> (usize, usize) {
    let limit =
        usize::try_from(job.settings.memory_mb).unwrap_or(usize::MAX / 1_000_000).saturating_mul(1_000_000);
    let transforms = job.stages.iter().filter_map(|stage| match &stage.planned.plan {
        Plan::Transform(plan) => Some(plan.holds()),
        _ => None,
    });
    let windows = transforms.clone().filter(|holds| *holds == Holds::Window).count();
    let first = transforms.clone().any(|holds| holds == Holds::First);
    (limit, (windows + usize::from(first)).max(1))
}

/// Memory that each transform may hold back if it can do with less, bytes.
fn may_hold_bytes(job: &Job) -> usize {
    let (limit, holders) = memory(job);
    limit / (2 * holders)
}

/// What the chains of all inputs share.
pub(super) struct Common {
    /// Memory of all lines.
    budget: Arc<Budget>,
    /// Workers of maps that may work at the same time.
    workers: Permits,
}

impl Common {
    pub(super) fn new(job: &Job, options: &Options) -> Common {
        Common { budget: Budget::new(memory(job).0), workers: Permits::new(options.workers()) }
    }
}

fn shared<'a>(
    job: &Job,
    options: &Options,
    common: &'a Common,
    gauge: &'a Gauge,
    cx: &Context,
) -> ChainState<'a> {
    let (limit, holders) = memory(job);
    ChainState {
        failure: Failure::new(options.cancel.clone()),
        budget: Budget::within(&common.budget),
        workers: &common.workers,
        may_hold_bytes: may_hold_bytes(job),
        holders,
        // Such transforms stay within one half, so there is always room for one more line. Only
        // lines that a stage requires may exhaust the memory (`Budget::take`).
        largest_line_bytes: limit / 2,
        foreseen: Mutex::default(),
        keeps_waveforms: job.stages.iter().any(|stage| stage.planned.plan.needs_waveforms()),
        gauge,
        totals: Mutex::default(),
        cx: cx.another(),
    }
}

/// Runs a worker from construction of its stage to its last counter.
fn run_worker(
    stage: &JobStage,
    run_context: &Arc<RunContext>,
    shared: &ChainState,
    inlet: Option<Inlet>,
    exit: Downstream,
    profile: bool,
    worker_results: &WorkerResults,
) {
    let mut worker =
        WorkerContext { stage: &stage.id, shared, exit, meter: Meter::new(profile), cx: shared.cx.another() };
    let result = guarded(|| work(stage, run_context, inlet, &mut worker));
    if let Err(cause) = result {
        shared.failure.fail(&stage.id, Some(&run_context.input), cause);
    }
    let WorkerContext { meter, cx, .. } = worker;
    worker_results.lock().unpoisoned().push((meter, cx));
}

fn work(
    stage: &JobStage,
    run_context: &RunContext,
    inlet: Option<Inlet>,
    worker: &mut WorkerContext,
) -> Result<()> {
    match (&stage.planned.plan, inlet) {
        (Plan::Source(plan), None) => {
            let posed = PoseSource::new(plan.make(run_context)?, Arc::clone(&run_context.geometry));
            let keeps_recorded = run_context.chain.iter().any(|stage| stage.needs_recorded);
            run_source(Box::new(posed.keeping_recorded(keeps_recorded)), worker)
        }
        (Plan::Map(plan), Some(mut inlet)) => run_map(plan.make(run_context)?, &mut inlet, worker),
        (Plan::Transform(plan), Some(mut inlet)) => {
            run_transform(plan.make(run_context)?, &mut inlet, worker)
        }
        (Plan::Sink(plan), Some(mut inlet)) => run_sink(plan.make(run_context)?, &mut inlet, worker),
        _ => Err(StageError::failed(
            "the source must be the first stage of a job, and the only source",
            "check the job with `wavex check`",
        )),
    }
}

/// Merges the results of all workers: stage summaries, finished files.
fn collect(
    job: &Job,
    worker_results: Vec<WorkerResults>,
    run_cx: &Context,
) -> (Vec<StageSummary>, Vec<(String, FinishedFile)>) {
    let mut whole = Vec::new();
    let mut summaries = Vec::new();
    for (stage, worker_results) in job.stages.iter().zip(worker_results) {
        let workers = worker_results.into_inner().unpoisoned();
        let count = workers.len();
        let mut meter = Meter::new(false);
        let mut cx = run_cx.another();
        for (worker, (its_meter, its_cx)) in workers.into_iter().enumerate() {
            meter.merge(its_meter, worker);
            cx.merge(its_cx);
        }
        if let Plan::Map(plan) = &stage.planned.plan {
            plan.conclude(&mut cx);
        }
        whole.extend(cx.take_files().into_iter().map(|file| (stage.id.clone(), file)));
        let counters = cx.into_counters();
        assert_reasons(stage.spec.name, &counters);
        summaries.push(StageSummary::new(stage, count, meter, counters));
    }
    (summaries, whole)
}

/// Panics in debug builds if a stage has used a reason that does not list it.
fn assert_reasons(stage: &str, counters: &Counters) {
    for (_, reason) in counters.rejected.keys() {
        debug_assert!(reason.is_of(stage), "`{stage}` rejects with {reason:?}, which does not list it");
    }
}

/// Gives every finished file its final name, in the order in which stages finished them.
fn publish(
    mut whole: Vec<(String, FinishedFile)>,
) -> std::result::Result<Vec<PathBuf>, (String, StageError)> {
    for (stage, file) in &mut whole {
        file.remove_stale().map_err(|error| (stage.clone(), error.into()))?;
    }
    whole.into_iter().map(|(stage, file)| file.publish().map_err(|error| (stage, error.into()))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::stage::Reason;

    fn rejected(reason: Reason) -> Counters {
        let mut cx = Context::default();
        cx.reject(reason, 1);
        cx.into_counters()
    }

    #[test]
    fn reasons_of_the_stage_are_accepted() {
        assert_reasons("decompose", &rejected(Reason::EmptyBlock));
    }

    #[test]
    #[cfg(debug_assertions)]
    #[should_panic(expected = "`calibrate` rejects with EmptyBlock")]
    fn reasons_of_other_stages_panic() {
        assert_reasons("calibrate", &rejected(Reason::EmptyBlock));
    }
}
