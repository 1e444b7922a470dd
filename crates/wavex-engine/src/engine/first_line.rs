//! First scan line of an input, before or without a run.

use std::path::Path;

use crate::job::Job;
use wavex_line::scan_line::{FirstShot, InputInfo, ScanLine};
use wavex_line::stage::{Context, Plan, Result, RunContext};

/// The first scan line of a file as the reader of the job gives it, without samples.
///
/// `None` for standard input, sources without a file, and recordings without shots.
///
/// # Errors
/// The file cannot be read, or a key of the reader does not fit it.
pub fn first_line(job: &Job, path: &Path, input_dir: &Path) -> Result<Option<ScanLine>> {
    match job.stages.first().map(|stage| &stage.planned.plan) {
        Some(Plan::Source(source)) if path.is_file() => {
            let run = RunContext { input_dir: input_dir.to_owned(), ..RunContext::alone(path) };
            source.make_for_inspection(&run, false)?.next(&mut Context::of_run())
        }
        _ => Ok(None),
    }
}

/// Metadata of a recording with its first shot, as stages receive it if it gets no poses.
pub fn info_of(line: &ScanLine) -> InputInfo {
    InputInfo { first_shot: line.emissions.first().map(FirstShot::of), ..InputInfo::clone(&line.input) }
}

/// Whether the beams of a file are georeferenced, so that it needs no trajectory.
pub fn is_placed(job: &Job, path: &Path, input_dir: &Path) -> bool {
    let line = first_line(job, path, input_dir).ok().flatten();
    line.is_some_and(|line| line.input.frame.is_georeferenced())
}
