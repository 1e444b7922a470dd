//! Changes of outputs and job since the run that a report describes.

use std::path::Path;
use std::time::SystemTime;

use serde_json::{Value, to_value};

use super::folders;
use wavex_engine::engine::{Options, RunSummary};
use wavex_engine::job::Job;
use wavex_pages::report::{FileState, InputFiles};

/// Warnings that the run of the report `path` is not that of the files or of the job as they are now.
///
/// `job` is the job, if the report was asked for by it, with its folder.
pub fn changes_since(path: &Path, report: &Value, job: Option<(&Job, &Path)>) -> Vec<String> {
    let of_job = job.filter(|(job, folder)| differs(report, job, folder)).map(|(job, _)| {
        format!(
            "{}: the job differs from that of the run in {}: it was changed, or run with `--set`; run it again",
            job.name,
            path.display()
        )
    });
    let of_outputs = changed_output(path, report).map(|output| {
        format!("{output} was changed after the run that {} describes; run the job again", path.display())
    });
    of_job.into_iter().chain(of_outputs).collect()
}

/// Whether stages or geometry of a job are not those of the run.
fn differs(report: &Value, job: &Job, folder: &Path) -> bool {
    let (input_dir, output_dir) = folders(job, folder);
    let now = to_value(RunSummary::new(job, &Options::of_job(job, input_dir, &output_dir)));
    let now = now.unwrap_or_default();
    report["stages"] != now["stages"] || report["job"]["geometry"] != now["job"]["geometry"]
}

/// First output in the folder of the report whose size is another, or which is later than the report.
fn changed_output(path: &Path, report: &Value) -> Option<String> {
    let folder = path.parent()?;
    let ended = path.metadata().ok()?.modified().ok()?;
    let files = |input: &Value| serde_json::from_value::<InputFiles>(input["files"].clone()).ok();
    let written = report["inputs"].as_array()?.iter().filter_map(files).flat_map(|files| files.written);
    let is_changed = |then: &FileState| {
        let Ok(now) = folder.join(&then.path).metadata() else { return false };
        let later =
            || now.modified().is_ok_and(|modified| modified > ended && seconds(modified) != then.modified_s);
        now.len() != then.bytes || later()
    };
    let mut changed = written.into_iter().filter(is_changed);
    changed.next().map(|state| folder.join(state.path).display().to_string())
}

/// Seconds since 1970.
fn seconds(time: SystemTime) -> f64 {
    time.duration_since(SystemTime::UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}
