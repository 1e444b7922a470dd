//! Job files of tasks.

use std::path::Path;

use serde_json::{Value, json};

use crate::archive::{Resolved, job_text, way};
use wavex_engine::engine::Input;
use wavex_line::stage::Result;

/// Scan-line statistics of a task for the archive, in the folder of the plan.
pub(super) const LINES: &str = "lines/*_lstat.txt";
/// Id of the stage that writes them.
pub(super) const ARCHIVE_STAGE: &str = "archive";

/// Writes the job of each task.
pub(super) struct TaskWriter<'r> {
    resolved: &'r Resolved,
    /// The job without its input.
    table: Value,
    plan_dir: &'r str,
}

impl<'r> TaskWriter<'r> {
    /// Tasks of a job whose files are all below one folder.
    ///
    /// `model` is the file with the sensor models of the survey.
    pub(super) fn new(
        resolved: &'r Resolved,
        plan_dir: &'r str,
        cores: usize,
        archives: bool,
        model: Option<&str>,
    ) -> Self {
        let mut table = resolved.table.clone();
        table["job"]["threads"] = json!(cores);
        if let Some(model) = model {
            table["job"]["survey_model"] = json!(model);
        }
        if let Some(key) = &resolved.path_key {
            table["stage"][0][key] = Value::Null;
        }
        if let Some(stages) = table["stage"].as_array_mut().filter(|_| archives) {
            let path = in_folder(plan_dir, LINES);
            stages.push(json!({"type": "write_lstat", "id": ARCHIVE_STAGE, "path": path}));
        }
        TaskWriter { resolved, table, plan_dir }
    }

    /// Patterns of the files that stages write.
    pub(super) fn patterns(&self) -> Vec<String> {
        self.resolved.patterns.clone()
    }

    /// Text of the job of one input; `number` counts the inputs of the whole job from 1.
    pub(super) fn text(&self, number: usize, source: &Input, root: &Path) -> Result<String> {
        let mut table = self.table.clone();
        // A task has one input, so it cannot count flight lines.
        for stage in table["stage"].as_array_mut().into_iter().flatten() {
            if stage["type"] == "write_las" && stage["point_source_id"] == "line" {
                stage["point_source_id"] = json!(number);
            }
        }
        let in_plan = |path: String| json!(in_folder(self.plan_dir, &path));
        let name = &source.stem;
        table["job"]["report"] = in_plan(format!("reports/{name}_report.json"));
        table["job"]["log"] = in_plan(format!("logs/{name}.log"));
        if table["job"]["report_page"] != "" {
            table["job"]["report_page"] = in_plan(format!("reports/{name}_report.html"));
        }
        // The survey's page is made of the cells of all tasks.
        table["job"]["survey_page"] = json!("");
        if let Some(key) = &self.resolved.path_key {
            table["stage"][0][key] = json!(way(root, &source.path)?);
        }
        if let (Some(key), Some(part)) = (self.resolved.part_key, &source.part) {
            table["stage"][0][key] = json!([part]);
        }
        job_text(&table)
    }
}

/// Path below a folder; the folder may be `.`.
pub(super) fn in_folder(folder: &str, path: &str) -> String {
    if folder == "." { path.to_owned() } else { format!("{folder}/{path}") }
}
