//! `wavex align`: aligns the strips of a survey.

use std::io::IsTerminal;
use std::path::PathBuf;

use super::args::{AlignArgs, JobArgs, MachineArgs};
use super::{Failure, run, terminal};
use wavex_engine::engine::Cancel;
use wavex_engine::job::Override;
use wavex_run::align::clouds::{CloudsRequest, POSITION_SD_M, align_clouds, are_clouds};
use wavex_run::align::{AlignConstraints, AlignJob, AlignRequest, Aligned};
use wavex_run::archive::shown;
use wavex_run::from_returns::from_returns;
use wavex_run::run::RunRequest;

/// Aligns, writes the files, prints the results; runs the job with them if asked.
pub(super) fn align(args: &AlignArgs, quiet: bool) -> Result<(), Failure> {
    if are_clouds(&args.inputs) {
        return clouds(args, quiet);
    }
    let jobs_args = jobs_of(args)?;
    let threads = args.threads.map(|threads| Override::new(format!("job.threads={threads}")));
    // Patches replace the recordings, decomposed or not.
    let is_from_returns = args.from_returns || args.apply && args.patches.is_empty();
    let mut jobs = Vec::new();
    for job_args in &jobs_args {
        let (job, folder) = (job_args.read(threads.clone())?, job_args.folder());
        jobs.push((if is_from_returns { from_returns(&job, &folder)? } else { job }, folder));
    }
    let jobs: Vec<AlignJob<'_>> = jobs.iter().map(|(job, folder)| AlignJob { job, folder }).collect();
    let cancel = Cancel::default();
    run::stop_on_signals(&cancel, run::end_run);
    let request = AlignRequest {
        jobs: &jobs,
        output: &args.output,
        trajectory: args.alignment.trajectory,
        constraints: args.alignment.constraints(),
        patches: &args.patches,
        progress: args.progress.mode(quiet, std::io::stderr().is_terminal()),
        cancel: cancel.clone(),
    };
    let aligned = wavex_run::align::align(&request)?;
    let settings = aligned.settings.clone();
    show(aligned, quiet)?;
    if !args.apply {
        return Ok(());
    }
    for (job_args, settings) in jobs_args.iter().zip(settings) {
        let (settings, folder) = (settings.into_iter().map(Override::new), job_args.folder());
        let job = from_returns(&job_args.read(settings.chain(threads.clone()))?, &folder)?;
        let machine = MachineArgs { threads: args.threads, profile: false, progress: args.progress };
        let cancel = cancel.clone();
        run::run_job(RunRequest { cancel, ..RunRequest::quiet(&job, &folder) }, machine, quiet)?;
    }
    Ok(())
}

/// Prints an alignment.
pub(super) fn show(aligned: Aligned, quiet: bool) -> Result<(), Failure> {
    print(&aligned.warnings, &aligned.written, &aligned.text, quiet)?;
    aligned.failure.map_or(Ok(()), Err)
}

/// Aligns clouds of points without trajectory.
fn clouds(args: &AlignArgs, quiet: bool) -> Result<(), Failure> {
    if !args.set.is_empty() {
        return Err(Failure::Wrong(
            "`--set` overrides keys of a job, and clouds have none; leave it out".into(),
        ));
    }
    if args.alignment.constraints() != AlignConstraints::default()
        || !args.patches.is_empty()
        || args.from_returns
    {
        return Err(Failure::Wrong(
            "`--control`, `--reference`, `--estimate`, `--patches` and `--from-returns` are for jobs; leave them out for clouds \
             of points"
                .into(),
        ));
    }
    let cancel = Cancel::default();
    run::stop_on_signals(&cancel, run::end_run);
    let aligned = align_clouds(&CloudsRequest {
        inputs: &args.inputs,
        output: &args.output,
        corrections: args.alignment.trajectory,
        position_sd_m: args.position_sd.unwrap_or(POSITION_SD_M),
        by_source: args.by_source,
        apply: args.apply,
        threads: args.threads.unwrap_or(0),
        cancel,
    })?;
    print(&aligned.warnings, &aligned.written, &aligned.text, quiet)?;
    aligned.failure.map_or(Ok(()), Err)
}

/// The jobs of a survey.
fn jobs_of(args: &AlignArgs) -> Result<Vec<JobArgs>, Failure> {
    let wrong = |problem: &str| Err(Failure::Wrong(problem.to_owned()));
    let is_job = |path: &PathBuf| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("toml"));
    if args.inputs.len() > 1 && !args.inputs.iter().all(is_job) {
        return wrong("give jobs (.toml), or clouds of points (.las, .laz, folders of them), not both");
    }
    if args.by_source || args.position_sd.is_some() {
        return wrong(
            "`--by-source` and `--position-sd` are for clouds of points (.las, .laz); leave them out for a job",
        );
    }
    Ok(args.inputs.iter().map(|job| JobArgs { job: job.clone(), set: args.set.clone() }).collect())
}

/// Prints results and warnings.
pub(super) fn print(
    warnings: &[String],
    written: &[PathBuf],
    text: &str,
    quiet: bool,
) -> Result<(), Failure> {
    warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    if !quiet {
        let written: String =
            written.iter().map(|path| format!("wrote {}\n", shown(path).display())).collect();
        terminal::print(&(written + text))?;
    }
    Ok(())
}
