//! Production archives: what it takes to show, years later, how files were made, and to make them again.
//!
//! An archive is a folder, or the same folder as `.tar.zst`, of texts that need no wavex to be read:
//!
//! | file | what it is |
//! |---|---|
//! | `archive.json` | [`Archive`]: digests of all inputs and outputs, the program, the machine |
//! | `job.toml` | the job as written |
//! | `job.resolved.toml` | the job as run: every default spelled out, every path relative |
//! | `report.json` | the report of the run |
//! | `wavex.log` | its log |
//! | `sensor_model/STEM.json` | what was learnt of the sensor, for each input |
//! | `lines/STEM_lstat.txt` | the statistics of the scan lines of each input |
//! | `archive.b3` | the seal: the BLAKE3 digests of all these, as `b3sum` writes and checks them |
//!
//! Inputs and outputs stay where they are: the archive names each by its path below one folder, with its digest.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod contents;
mod difference;
mod digest;
mod inputs;
mod origin;
mod paths;
mod recorder;
mod replay;
mod resolved;
mod verify;

pub(crate) use inputs::missing_inputs;
pub use origin::{Machine, Package, Program};
pub(crate) use paths::plain;
pub use recorder::{Recorder, check_destination};
pub use replay::{Replay, Replayed, replay};
pub use verify::{Folders, Verified, verify};

/// The format's version: others are refused.
pub const FORMAT: u32 = 1;

/// The file that describes the archive.
const ARCHIVE: &str = "archive.json";
/// The file with the digests of all others.
const SEAL: &str = "archive.b3";
/// The job as written.
const JOB: &str = "job.toml";
/// The folder of the files that the job as written includes.
const INCLUDED: &str = "included";
/// The job as run.
const RESOLVED: &str = "job.resolved.toml";
/// The report of the run.
const REPORT: &str = "report.json";
/// The log of the run.
const LOG: &str = "wavex.log";
/// The folder of the sensor models.
const MODELS: &str = "sensor_model";
/// The folder of the statistics of scan lines.
const LINES: &str = "lines";

/// What a production archive says of itself (`archive.json`).
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Archive {
    /// The version of this format: 1.
    pub format: u32,
    /// When the run began, UTC (ISO 8601).
    pub made: String,
    /// What the job's file was called.
    pub job: String,
    /// What the command line set of the job, in order.
    pub set: Vec<String>,
    /// The program that ran it.
    pub program: Program,
    /// The machine that it ran on.
    pub machine: Machine,
    /// Every file that the run read.
    pub inputs: Files,
    /// Every file that its stages wrote.
    pub outputs: Files,
}

/// Files below one folder.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Files {
    /// The folder, seen from that of the archive (for a `.tar.zst`, from the folder of its name beside it).
    pub folder: String,
    /// The folder as the machine called it.
    pub folder_was: String,
    /// The files, in order of their paths.
    pub files: Vec<DigestedFile>,
}

/// A file and its digest.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct DigestedFile {
    /// Its path from the folder, with `/` between the steps.
    pub path: String,
    /// Its length, bytes.
    pub bytes: u64,
    /// The BLAKE3 digest of its content, 64 hexadecimal digits.
    pub blake3: String,
    /// The stage that wrote it, as the job calls it; none for an input.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<String>,
}
