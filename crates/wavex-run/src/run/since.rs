//! Changes of outputs and job since the run that a report describes.

use std::path::Path;

use serde_json::{Value, to_value};

use super::folders;
use super::resume::modified_s;
use wavex_engine::engine::{Options, RunSummary};
use wavex_engine::job::Job;
use wavex_pages::report::InputFiles;

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
    let ended_s = modified_s(&path.metadata().ok()?)?;
    let files = |input: &Value| serde_json::from_value::<InputFiles>(input["files"].clone()).ok();
    let mut written = report["inputs"].as_array()?.iter().filter_map(files).flat_map(|files| files.written);
    let changed = written.find(|then| {
        let now = folder.join(&then.path).metadata().ok();
        now.is_some_and(|now| {
            let is_later = |now_s: f64| now_s > ended_s && now_s != then.modified_s;
            now.len() != then.bytes || modified_s(&now).is_some_and(is_later)
        })
    })?;
    Some(folder.join(changed.path).display().to_string())
}
