//! Production archives: document how files were made, and reproduce them years later.
//!
//! An archive is a folder, or the same folder as `.tar.zst`, of text files that can be read without
//! wavex:
//!
//! | file | content |
//! |---|---|
//! | `archive.json` | [`Archive`]: digests of all inputs and outputs, the program, the machine |
//! | `job.toml` | the job as written |
//! | `job.resolved.toml` | the job as run: all defaults written out, all paths relative |
//! | `report.json` | the report of the run |
//! | `wavex.log` | its log |
//! | `sensor_model/STEM.json` | the calibrated sensor model of each input |
//! | `lines/STEM_lstat.txt` | the scan-line statistics of each input |
//! | `results.b3` | digests of all that does not depend on time and machine |
//! | `archive.b3` | the seal: BLAKE3 digests of all these files, in the format of `b3sum` |
//!
//! Inputs and outputs are not copied: the archive lists each by its path below one folder, with its
//! digest.

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

pub use digest::digest_of;
pub(crate) use digest::of_file as size_and_digest_of;
pub use inputs::{FilesRead, missing_files};
pub use origin::{Machine, Package, Program};
pub use paths::{common, plain, relative, shown};
pub use recorder::{KnownDigests, Recorder, Seals, check_destination};
pub use replay::{Replay, Replayed, replay};
pub(crate) use resolved::{Resolved, job_text, way};
pub(crate) use verify::existing;
pub use verify::{Folders, Verified, verify};

/// Version of the format; archives of other versions are refused.
pub const FORMAT: u32 = 1;

/// File that describes the archive.
const ARCHIVE: &str = "archive.json";
/// File with the digests of inputs, outputs, sensor models, scan-line statistics and job.
const RESULTS: &str = "results.b3";
/// File with the digests of all others.
const SEAL: &str = "archive.b3";
/// Job as written.
const JOB: &str = "job.toml";
/// Folder of the files that the job includes.
const INCLUDED: &str = "included";
/// Job as run.
const RESOLVED: &str = "job.resolved.toml";
/// Report of the run.
const REPORT: &str = "report.json";
/// Log of the run.
const LOG: &str = "wavex.log";
/// Folder of the sensor models.
const MODELS: &str = "sensor_model";
/// Folder of the scan-line statistics.
const LINES: &str = "lines";

/// Description of a production archive (`archive.json`).
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Archive {
    /// Version of this format: 1.
    pub format: u32,
    /// Start of the run, UTC, ISO 8601.
    pub made: String,
    /// Name of the job file.
    pub job: String,
    /// Overrides from the command line, in order.
    pub set: Vec<String>,
    /// Program that ran the job.
    pub program: Program,
    /// Machine that it ran on.
    pub machine: Machine,
    /// All files that the run read.
    pub inputs: ArchivedFiles,
    /// All files that its stages wrote.
    pub outputs: ArchivedFiles,
    /// Inputs that failed and have no outputs.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failed: Vec<FailedInput>,
}

/// An input that failed.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct FailedInput {
    /// Stem of the input.
    pub stem: String,
    /// Error message.
    pub reason: String,
}

/// Files below one folder.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct ArchivedFiles {
    /// The folder, relative to the archive's folder (for a `.tar.zst`, to the folder it unpacks to).
    pub folder: String,
    /// Absolute path of the folder on the machine of the run.
    pub folder_was: String,
    /// The files, sorted by path.
    pub files: Vec<DigestedFile>,
}

/// A file with its digest.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct DigestedFile {
    /// Path relative to the folder, with `/` as separator.
    pub path: String,
    /// Size, bytes.
    pub bytes: u64,
    /// BLAKE3 digest of the content, 64 hexadecimal digits.
    pub blake3: String,
    /// Id of the stage that wrote it; none for an input.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stage: Option<String>,
}
