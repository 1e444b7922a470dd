//! `wavex classify`: classifies the ground of clouds of points.

use std::io::IsTerminal;

use super::align::print;
use super::args::ClassifyArgs;
use super::{Failure, run};
use wavex_engine::engine::Cancel;
use wavex_run::classify::{ClassifyRequest, GroundSettings, classify_clouds};

/// Classifies, writes the copies, prints the points of each class.
pub(super) fn classify(args: &ClassifyArgs, quiet: bool) -> Result<(), Failure> {
    let cancel = Cancel::default();
    run::stop_on_signals(&cancel, run::end_run);
    let classified = classify_clouds(&ClassifyRequest {
        inputs: &args.inputs,
        output: &args.output,
        kept_classes: &args.keep,
        settings: GroundSettings::default(),
        memory_mb: args.memory_mb,
        threads: args.threads,
        report: args.report.as_deref(),
        progress: args.progress.mode(quiet, std::io::stderr().is_terminal()),
        cancel,
    })?;
    print(&classified.warnings, &classified.written, &classified.text, quiet)?;
    classified.failure.map_or(Ok(()), Err)
}
