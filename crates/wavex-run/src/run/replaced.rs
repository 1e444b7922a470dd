//! Outputs of other jobs that a run replaces.

use std::path::{Path, PathBuf};

use serde_json::Value;

use wavex_pages::report::{self, FileState, InputFiles};

/// Number of reports in the folder of the outputs that are read.
const MOST_REPORTS: usize = 50;
/// End of the default name of reports.
const REPORT: &str = "_report.json";

/// Warnings about outputs that, by another report in their folder, another job has made.
///
/// `now` are the states of the outputs that exist.
pub(super) fn warnings(output_dir: &Path, own_report: Option<&Path>, now: &[FileState]) -> Vec<String> {
    if now.is_empty() {
        return Vec::new();
    }
    let files = output_dir.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
    let is_report = |path: &PathBuf| path.to_string_lossy().ends_with(REPORT) && Some(&**path) != own_report;
    let mut reports: Vec<PathBuf> = files.filter(is_report).take(MOST_REPORTS).collect();
    reports.sort();
    reports.iter().filter_map(|path| warning(path, &report::read_report(path).ok()?, now)).collect()
}

/// The warning about outputs that this report describes.
fn warning(path: &Path, report: &Value, now: &[FileState]) -> Option<String> {
    let files = |input: &Value| serde_json::from_value::<InputFiles>(input["files"].clone()).ok();
    let inputs = report["inputs"].as_array()?;
    let written: Vec<FileState> = inputs.iter().filter_map(files).flat_map(|files| files.written).collect();
    let is_same =
        |a: &FileState, b: &FileState| (&a.path, a.bytes, a.modified_s) == (&b.path, b.bytes, b.modified_s);
    let mut of_other = now.iter().filter(|now| written.iter().any(|written| is_same(now, written)));
    let first = &of_other.next()?.path;
    let more = match of_other.count() {
        0 => String::new(),
        n => format!(" and {n} more"),
    };
    Some(format!(
        "if it succeeds, the run replaces outputs of another job: {first}{more}, which {} describes; give each job its own `output_dir`",
        path.display()
    ))
}
