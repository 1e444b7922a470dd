//! `wavex align`: aligns the strips of a survey.

use std::io::IsTerminal;

use super::args::AlignArgs;
use super::{Failure, run, terminal};
use wavex_engine::engine::Cancel;
use wavex_engine::job::Override;
use wavex_run::align::{AlignConstraints, AlignRequest, Aligned};
use wavex_run::archive::shown;

/// Aligns, writes the files, prints the results.
pub(super) fn align(args: &AlignArgs, quiet: bool) -> Result<(), Failure> {
    let threads = args.threads.map(|threads| Override::new(format!("job.threads={threads}")));
    let job = args.job.read(threads)?;
    let cancel = Cancel::default();
    run::stop_on_signals(&cancel, run::end_run);
    let request = AlignRequest {
        job: &job,
        folder: &args.job.folder(),
        output: &args.output,
        trajectory: args.trajectory,
        constraints: AlignConstraints {
            control: args.control.clone(),
            control_crs: args.control_crs.clone(),
            references: args.reference.clone(),
            estimate: args.estimate.clone(),
        },
        patches: &args.patches,
        progress: args.progress.mode(quiet, std::io::stderr().is_terminal()),
        cancel,
    };
    show(wavex_run::align::align(&request)?, quiet)
}

/// Prints an alignment.
pub(super) fn show(aligned: Aligned, quiet: bool) -> Result<(), Failure> {
    aligned.warnings.iter().for_each(|warning| tracing::warn!("{warning}"));
    if !quiet {
        let written: String =
            aligned.written.iter().map(|path| format!("wrote {}\n", shown(path).display())).collect();
        terminal::print(&(written + &aligned.text))?;
    }
    aligned.failure.map_or(Ok(()), Err)
}
