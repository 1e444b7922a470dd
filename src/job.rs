//! A job: TOML text to a chain of stages that is known to fit. No input or output happens here.

use crate::stage::{Planned, StageSpec};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// A job that can be run.
#[derive(Clone)]
pub struct Job {
    /// The table `[job]`.
    pub settings: JobSettings,
    /// The chain, in order: one source, then what takes its lines.
    pub stages: Vec<JobStage>,
}

/// A stage of a job.
#[derive(Clone)]
pub struct JobStage {
    /// What the job calls it: its `id`, or its type, numbered where that occurs more than once (`write_las-2`).
    pub id: String,
    /// Its place in the registry.
    pub spec: &'static StageSpec,
    /// Its keys, and how it is made.
    pub planned: Planned,
}

/// The table `[job]`: what concerns the run as a whole.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct JobSettings {
    /// How many threads work in the pools of `decompose` and its like; 0: as many as the machine has cores.
    pub threads: usize,
    /// A bound on the memory taken by the scan lines that are under way, MB.
    #[schemars(range(min = 64))]
    pub memory_mb: u64,
    /// Where relative input paths start; the job file's folder when not given. A relative one starts there, too.
    pub input_dir: Option<String>,
    /// Where relative output paths start; the job file's folder when not given. A relative one starts there, too.
    pub output_dir: Option<String>,
    /// How many scan lines may wait between two stages. The results do not depend on it.
    #[schemars(range(min = 1))]
    pub channel_capacity: usize,
}

impl Default for JobSettings {
    fn default() -> JobSettings {
        JobSettings { threads: 0, memory_mb: 1024, input_dir: None, output_dir: None, channel_capacity: 16 }
    }
}
