//! `wavex plan` and `wavex collect`: a survey as tasks of a cluster.

use std::fmt::Write as _;
use std::path::Path;

use super::args::{CollectArgs, PlanArgs};
use super::{Failure, align, print, terminal};
use wavex_engine::engine::{Cancel, ProgressMode};
use wavex_line::georef::check_crs;
use wavex_run::align::{AlignConstraints, AlignJob, AlignRequest, TrajectoryModel, check_early};
use wavex_run::archive::check_destination;
use wavex_run::cluster::{self, PlanOptions, SurveyPlan};

/// Cores per task if neither the job nor the command line has a number.
const CORES: usize = 4;

/// Writes the plan of a job.
pub(super) fn plan(args: &PlanArgs, quiet: bool) -> Result<(), Failure> {
    let job = args.job.read(None)?;
    for note in &job.notes {
        tracing::warn!("{note}");
    }
    let folder = args.job.folder();
    let (input_dir, output_dir) = wavex_run::run::folders(&job, &folder);
    check_crs(&job.settings.geometry, &input_dir).map_err(|error| Failure::Wrong(error.to_string()))?;
    if wavex_run::job_file::is_stdin(&args.job.job) {
        let problem = "a job on standard input cannot be planned; save it to a file and plan that";
        return Err(Failure::Wrong(problem.to_owned()));
    }
    // An existing archive may belong to this plan: `collect` compares them.
    if let Some(archive) = args.archive.as_ref().filter(|archive| !archive.exists()) {
        check_destination(archive).map_err(|error| Failure::Wrong(error.to_string()))?;
    }
    let jobs = [AlignJob { job: &job, folder: &folder }];
    let align = align_request(args, &jobs)?;
    let options = PlanOptions {
        folder: &args.output,
        job_dir: &folder,
        input_dir: &input_dir,
        output_dir: &output_dir,
        archive: args.archive.as_deref(),
        align: align.as_ref(),
        cores: args.cores.unwrap_or(match job.settings.threads {
            0 => CORES,
            threads => threads,
        }),
        mb_per_s: args.mb_per_s,
    };
    let plan = cluster::plan(&job, &options).map_err(|error| Failure::Run(error.to_string()))?;
    if quiet { Ok(()) } else { print(&words(&plan, &args.output)) }
}

/// The alignment that `wavex collect` makes, checked as far as it can be before the tasks have run.
fn align_request<'a>(
    args: &'a PlanArgs,
    jobs: &'a [AlignJob<'a>],
) -> Result<Option<AlignRequest<'a>>, Failure> {
    let (trajectory, constraints) = (args.alignment.trajectory, args.alignment.constraints());
    let Some(output) = &args.align else {
        if trajectory != TrajectoryModel::Constant || constraints != AlignConstraints::default() {
            let problem = "`--trajectory`, `--control`, `--reference` and `--estimate` are for an alignment; add `--align FOLDER`";
            return Err(Failure::Wrong(problem.to_owned()));
        }
        return Ok(None);
    };
    let request = AlignRequest {
        jobs,
        output,
        trajectory,
        constraints,
        patches: &[],
        progress: ProgressMode::Hidden,
        cancel: Cancel::default(),
    };
    check_early(&request)?;
    Ok(Some(request))
}

/// Describes a plan and how to run it.
fn words(plan: &SurveyPlan, folder: &Path) -> String {
    let bytes: u64 = plan.tasks.iter().flat_map(|task| &task.inputs).map(|file| file.bytes).sum();
    let most = |of: fn(&cluster::Estimate) -> u64| plan.tasks.iter().map(|task| of(&task.estimate)).max();
    let mut text = format!("{} tasks, {}\n", plan.tasks.len(), terminal::size(bytes));
    if let (Some(memory_mb), Some(minutes), Some(task)) =
        (most(|estimate| estimate.memory_mb), most(|estimate| estimate.minutes), plan.tasks.first())
    {
        let cores = task.estimate.cores;
        let _ = writeln!(text, "each: {cores} cores, up to {memory_mb} MB and {minutes} min");
    }
    if plan.calibration.is_some() {
        text += "first: calibration from all inputs\n";
    }
    let folder = wavex_run::archive::shown(folder);
    let folder = folder.display();
    let _ = writeln!(text, "wrote {folder}");
    let _ =
        writeln!(text, "run: snakemake -s {folder}/Snakefile --profile {folder}/profiles/local --cores all");
    text
}

/// Checks and merges the results of a plan.
pub(super) fn collect(args: &CollectArgs, quiet: bool) -> Result<(), Failure> {
    let found = cluster::collect(&args.plan, args.digest, !args.no_archive);
    let found = found.map_err(|error| Failure::Run(error.to_string()))?;
    if !quiet {
        let mut said = found.table;
        for path in &found.written {
            let _ = writeln!(said, "wrote {}", wavex_run::archive::shown(path).display());
        }
        if let Some((path, seals)) = &found.archive {
            let _ = writeln!(said, "results {}", seals.results);
            let _ = writeln!(
                said,
                "archived in {}; seal {}",
                wavex_run::archive::shown(path).display(),
                seals.seal
            );
        }
        print(&said)?;
    }
    let aligned = found.aligned.map_or(Ok(()), |aligned| align::show(aligned?, quiet));
    if found.problems.is_empty() {
        return aligned;
    }
    if let Err(failure) = aligned {
        tracing::warn!("{}", failure.text());
    }
    let mut text = format!("incomplete: {} of {} tasks", found.problems.len(), found.tasks);
    for (name, reason) in &found.problems {
        let _ = write!(text, "\n  {name}: {reason}");
    }
    Err(Failure::Run(text))
}
