//! `wavex align`: aligns the strips of a survey.

use std::io::IsTerminal;

use super::args::{AlignArgs, MachineArgs};
use super::{Failure, run, terminal};
use wavex_engine::engine::Cancel;
use wavex_engine::job::Override;
use wavex_run::align::AlignRequest;
use wavex_run::archive::shown;
use wavex_run::from_returns::from_returns;
use wavex_run::run::RunRequest;

/// Aligns, writes the files, prints the results; runs the job with them if asked.
pub(super) fn align(args: &AlignArgs, quiet: bool) -> Result<(), Failure> {
    let threads = args.threads.map(|threads| Override::new(format!("job.threads={threads}")));
    let job = args.job.read(threads.clone())?;
    let folder = args.job.folder();
    let job = if args.from_returns || args.apply { from_returns(&job, &folder)? } else { job };
    let cancel = Cancel::default();
    run::stop_on_signals(&cancel, run::end_run);
    let request = AlignRequest {
        job: &job,
        folder: &folder,
        output: &args.output,
        trajectory: args.trajectory,
        progress: args.progress.mode(quiet, std::io::stderr().is_terminal()),
        cancel: cancel.clone(),
    };
    let aligned = wavex_run::align::align(&request)?;
    aligned.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    if !quiet {
        let written: String =
            aligned.written.iter().map(|path| format!("wrote {}\n", shown(path).display())).collect();
        terminal::print(&(written + &aligned.text))?;
    }
    aligned.failure.map_or(Ok(()), Err)?;
    if !args.apply {
        return Ok(());
    }
    let settings = aligned.settings.into_iter().map(Override::new);
    let job = from_returns(&args.job.read(settings.chain(threads))?, &folder)?;
    let machine = MachineArgs { threads: args.threads, profile: false, progress: args.progress };
    run::run_job(RunRequest { cancel, ..RunRequest::quiet(&job, &folder) }, machine, quiet).map(drop)
}
