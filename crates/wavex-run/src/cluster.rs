//! Surveys on several machines: a plan with one task per input, and the collection of their results.
//!
//! A plan is a folder:
//!
//! | file | content |
//! |---|---|
//! | `plan.json` | [`SurveyPlan`]: the tasks with their files, cores, memory and time |
//! | `tasks.tsv` | the same as a table, for array jobs |
//! | `job.toml`, `included/N_NAME` | the job as written, with the files that it includes |
//! | `job.resolved.toml` | the whole job with all defaults and relative paths |
//! | `tasks/STEM.toml` | the job of each input |
//! | `model.json` | sensor models of the survey, written by the calibration task |
//! | `Snakefile`, `profiles/NAME/config.yaml` | rules and settings of Snakemake |
//! | `reports/`, `logs/`, `lines/`, `done/` | written by the tasks |
//!
//! All paths in a plan are relative, so that it can be moved with its data.

use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_formats::{Error, path_within, read_small_text};
use wavex_line::stage::Result;

mod collect;
mod estimate;
mod merge;
mod plan;
mod tasks;

pub use collect::{Collected, collect};
pub use estimate::Estimate;
pub use plan::{PlanOptions, plan};

/// Version of the format of plans; plans of other versions are refused.
pub const FORMAT: u32 = 1;

/// Description of the plan.
const PLAN: &str = "plan.json";
/// Job as written.
const JOB: &str = "job.toml";
/// Folder of the files that the job includes.
const INCLUDED: &str = "included";
/// Job with all defaults.
const RESOLVED: &str = "job.resolved.toml";
/// Sensor models of the survey, which the calibration task writes.
const MODEL: &str = "model.json";
/// Remedy for a plan that cannot be used.
const REMEDY: &str = "make it again with `wavex plan`";
/// Maximum size of a text of a plan or a task, bytes.
const MOST_BYTES: u64 = 1 << 28;

/// Plan of a survey (`plan.json`).
///
/// Paths without another statement are relative to `root`.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct SurveyPlan {
    /// Version of this format: 1.
    pub format: u32,
    /// Version of wavex that made the plan.
    pub wavex: String,
    /// Commit from which it was built; empty if unknown.
    pub commit: String,
    /// Name of the job file.
    pub job: String,
    /// Folder of the job file, relative to the folder of the plan.
    pub job_dir: String,
    /// Overrides from the command line, in order.
    pub set: Vec<String>,
    /// Names of the files that the job includes, in order.
    pub included: Vec<String>,
    /// Folder that contains plan, inputs and outputs, relative to the folder of the plan.
    pub root: String,
    /// Folder of the plan.
    pub plan_dir: String,
    /// Archive to make of the whole survey.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub archive: Option<String>,
    /// Alignment to make of the whole survey.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub align: Option<PlannedAlignment>,
    /// Files that all tasks read.
    pub shared_inputs: Vec<PlannedFile>,
    /// Patterns of the files that each task writes; `*` is its name.
    pub output_patterns: Vec<String>,
    /// Task that calibrates once for all inputs; none if each task calibrates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub calibration: Option<CalibrationTask>,
    /// One task per input, in the order of the job.
    pub tasks: Vec<Task>,
    /// Resources of the task that collects the results.
    pub collect: Estimate,
}

/// Alignment of the whole survey, with the options of `wavex align`.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct PlannedAlignment {
    /// Folder to write.
    pub folder: String,
    /// Corrections of trajectories: `none`, `constant`, `linear`, or the distance of knots in seconds.
    pub trajectory: String,
    /// File of control points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub control: Option<String>,
    /// Coordinate reference system of the control points.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub control_crs: Option<String>,
    /// Strips whose trajectories are not corrected.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub references: Vec<String>,
    /// Parameters that are estimated only if asked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub estimate: Vec<String>,
}

/// Task that makes the sensor model of the survey from all inputs.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct CalibrationTask {
    /// Job file.
    pub job: String,
    /// Sensor model that it writes.
    pub model: String,
    /// Resources.
    #[serde(flatten)]
    pub estimate: Estimate,
}

/// Task of one input.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Task {
    /// Name: the stem of the input.
    pub name: String,
    /// Job file.
    pub job: String,
    /// The input, and after it other files that only this task reads.
    pub inputs: Vec<PlannedFile>,
    /// Files that its stages write.
    pub outputs: Vec<String>,
    /// Report.
    pub report: String,
    /// Log.
    pub log: String,
    /// Resources.
    #[serde(flatten)]
    pub estimate: Estimate,
}

/// A file that a task reads.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct PlannedFile {
    /// Path.
    pub path: String,
    /// Size, bytes.
    pub bytes: u64,
}

impl SurveyPlan {
    /// Path of a file that a task has written to the folder of the plan.
    fn task_file(&self, root: &Path, path: &str) -> wavex_formats::Result<PathBuf> {
        let path = Path::new(path);
        path_within(&root.join(&self.plan_dir), path.strip_prefix(&self.plan_dir).unwrap_or(path))
    }

    /// Reads the plan in a folder.
    ///
    /// # Errors
    /// If the folder has no plan, or the plan has another version.
    pub fn read(folder: &Path) -> Result<SurveyPlan> {
        let path = folder.join(PLAN);
        let text = read_small_text(&path, MOST_BYTES, "a plan", REMEDY)?;
        let unusable = |problem: String| Error::unusable(&path, problem, REMEDY);
        let value: serde_json::Value =
            serde_json::from_str(&text).map_err(|error| unusable(format!("invalid JSON: {error}")))?;
        if value["format"] != FORMAT {
            let problem = format!("plan format {} is not supported, only format {FORMAT}", value["format"]);
            return Err(unusable(problem).into());
        }
        Ok(serde_json::from_value(value).map_err(|error| unusable(format!("invalid plan: {error}")))?)
    }
}
