//! `wavex replay` and `wavex verify`: check archives of runs.

use std::fmt::Write as _;
use std::io::IsTerminal;
use std::path::Path;

use super::{ArchiveArgs, Failure, When, print, run};
use wavex_engine::engine::Cancel;
use wavex_run::archive::{self, Folders, Replay};

/// Runs an archived job again and reports differences.
pub(super) fn replay(
    args: ArchiveArgs,
    seal: Option<String>,
    threads: Option<usize>,
    when: When,
    quiet: bool,
) -> Result<(), Failure> {
    let cancel = Cancel::default();
    run::stop_on_signals(&cancel, run::end_run);
    let progress = when.mode(quiet, std::io::stderr().is_terminal());
    let replay = Replay { folders: folders(&args), seal, threads, progress, cancel };
    let found = archive::replay(&args.archive, &replay).map_err(|error| Failure::Run(error.to_string()))?;
    for note in &found.notes {
        tracing::warn!("{note}");
    }
    failed(&args.archive, &found.problems, &found.seal)?;
    let (archive, outputs, seal) = (args.archive.display(), found.outputs, &found.seal);
    let failed = failed_inputs(&found.failed);
    let said = format!("{archive}: {outputs} outputs are identical bit by bit{failed}; seal {seal}\n");
    if quiet { Ok(()) } else { print(&said) }
}

/// Verifies all digests, and the seal against `seal_noted`.
pub(super) fn verify(args: &ArchiveArgs, seal_noted: Option<&str>, quiet: bool) -> Result<(), Failure> {
    let found = archive::verify(&args.archive, &folders(args), seal_noted);
    let found = found.map_err(|error| Failure::Run(error.to_string()))?;
    failed(&args.archive, &found.problems, &found.seal)?;
    let [files, inputs, outputs] = found.counts;
    let archive = args.archive.display();
    let said = format!(
        "{archive}: {files} archive files, {inputs} inputs and {outputs} outputs are unchanged{}; seal {}\n",
        failed_inputs(&found.failed),
        found.seal
    );
    let results = found.results.map(|results| format!("results {results}\n")).unwrap_or_default();
    if quiet { Ok(()) } else { print(&(results + &said)) }
}

/// Mentions the inputs that failed in the archived run.
fn failed_inputs(stems: &[String]) -> String {
    match stems {
        [] => String::new(),
        [stem] => format!("; 1 input failed in the run: {stem}"),
        _ => format!("; {} inputs failed in the run: {}", stems.len(), stems.join(", ")),
    }
}

fn folders(args: &ArchiveArgs) -> Folders {
    Folders { inputs: args.inputs.clone(), outputs: args.outputs.clone() }
}

/// Reports problems as one failure.
///
/// # Errors
/// If there are any problems.
fn failed(archive: &Path, problems: &[String], seal: &str) -> Result<(), Failure> {
    if problems.is_empty() {
        return Ok(());
    }
    let mut text = format!("{}: verification failed", archive.display());
    if !seal.is_empty() {
        let _ = write!(text, "; seal {seal}");
    }
    for problem in problems {
        let _ = write!(text, "\n  {problem}");
    }
    Err(Failure::Run(text))
}
