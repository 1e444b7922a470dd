//! Context of one run: input, folders, threads, geometry.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64};

use rayon::ThreadPool;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use wavex_signal::calibrate::CalibrationProgress;
use wavex_simd::SimdLevel;

use super::{OutputFile, Result, SurveyModels};
use crate::georef::Geometry;
use crate::keys::InvalidKey;

/// Per-run context of a stage.
#[derive(Clone, Debug)]
pub struct RunContext {
    /// Input of this run: a file, or `-` for standard input; empty if the source generates its
    /// data.
    pub input: PathBuf,
    /// Part of the file that is the input of this run, such as a beam; `None`: all of it.
    pub part: Option<String>,
    /// Stem after which outputs are named.
    pub stem: String,
    /// Number of the input in the job, from 1.
    pub number: u32,
    /// Folder at which relative input paths start.
    pub input_dir: PathBuf,
    /// Folder at which relative output paths start.
    pub output_dir: PathBuf,
    /// The engine's threads for tasks within a stage; `None`: the stage's own thread does them.
    pub pool: Option<Arc<ThreadPool>>,
    /// SIMD instructions of the kernels.
    pub simd: SimdLevel,
    /// Set once the user interrupts the run; long tasks of a stage then end.
    pub cancelled: Arc<AtomicBool>,
    /// Trajectory, mount and coordinates: the table `[job.geometry]`.
    pub geometry: Arc<Geometry>,
    /// Types and keys of all stages of the job; none outside of a run.
    pub chain: Arc<[ChainStage]>,
    /// Sensor models of the survey; `None`: the recording has its own.
    pub survey: Option<Arc<SurveyModels>>,
    /// Fraction of the input read, ppm, for the progress display.
    ///
    /// The engine sets it behind each line; a source that works long on one line sets it meanwhile.
    pub read_ppm: Arc<AtomicU64>,
    /// Progress of `calibrate`, for the progress display.
    pub calibration: Arc<CalibrationProgress>,
    /// Whether stages write files; if not, their lines are only observed.
    pub has_outputs: bool,
}

/// A stage of the job of a run, as far as other stages need it.
#[derive(Clone, Debug)]
pub struct ChainStage {
    /// Name of its type in a job.
    pub name: &'static str,
    /// Whether it is the source.
    pub is_source: bool,
    /// Whether it only writes lines.
    pub is_sink: bool,
    /// Whether lines must keep their shots as recorded.
    pub needs_recorded: bool,
    /// Its keys with all defaults.
    pub keys: Value,
    /// Its input files: texts among the keys.
    pub inputs: Vec<String>,
    /// Patterns of the files that it writes.
    pub outputs: Vec<String>,
    /// Keys that concern only this machine.
    pub local_keys: &'static [&'static str],
}

impl RunContext {
    /// Context for one input outside of a run.
    ///
    /// Paths start at the current folder; no pool; no geometry.
    pub fn alone(input: &Path) -> RunContext {
        RunContext {
            input: input.to_owned(),
            part: None,
            stem: input.file_stem().unwrap_or_default().to_string_lossy().into_owned(),
            number: 1,
            input_dir: ".".into(),
            output_dir: ".".into(),
            pool: None,
            simd: SimdLevel::Portable,
            cancelled: Arc::default(),
            read_ppm: Arc::default(),
            calibration: Arc::default(),
            geometry: Arc::default(),
            chain: Arc::default(),
            survey: None,
            has_outputs: true,
        }
    }

    /// Path of an output pattern in this run; `*` is replaced by the stem of the input.
    pub fn output_path(&self, pattern: &str) -> PathBuf {
        self.output_dir.join(pattern.replace('*', &self.stem))
    }

    /// Creates the output file of a pattern.
    pub fn create(&self, pattern: &str) -> Result<OutputFile> {
        Ok(OutputFile::create(&self.output_path(pattern))?)
    }

    /// Path of an input named by the job.
    pub fn input_path(&self, path: &Path) -> PathBuf {
        self.input_dir.join(path)
    }
}

/// Folder of an output pattern, without parts that depend on the stem of the input.
pub fn fixed_folder(output_dir: &Path, pattern: &str) -> PathBuf {
    // The text before the first `*` is a folder up to its last separator.
    let known = output_dir.join(pattern.split('*').next().unwrap_or_default());
    let ends_in_separator = known.as_os_str().to_string_lossy().ends_with(std::path::is_separator);
    let folder = if ends_in_separator { Some(known.as_path()) } else { known.parent() };
    let folder: PathBuf = folder.map_or_else(PathBuf::new, |folder| folder.components().collect());
    if folder.as_os_str().is_empty() { PathBuf::from(".") } else { folder }
}

/// One or more paths; each may be a pattern (`*`, `?`, `[...]`, `**`).
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Paths {
    /// A file or a pattern.
    One(String),
    /// Several files or patterns.
    Many(Vec<String>),
}

impl Paths {
    /// Paths as written.
    pub fn patterns(&self) -> &[String] {
        match self {
            Paths::One(path) => std::slice::from_ref(path),
            Paths::Many(paths) => paths,
        }
    }

    /// Checks the key `path` of a reader.
    ///
    /// # Errors
    /// No path, or an empty one.
    pub fn check(&self) -> std::result::Result<(), InvalidKey> {
        let patterns = self.patterns();
        InvalidKey::unless(!patterns.is_empty(), "path", "at least one file is needed")?;
        InvalidKey::unless(!patterns.iter().any(String::is_empty), "path", "a path is empty")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_star_is_the_stem_of_the_input() {
        let run = RunContext {
            input: "in/flight7.pls".into(),
            stem: "flight7".into(),
            input_dir: "in".into(),
            output_dir: "out".into(),
            simd: SimdLevel::Portable,
            ..RunContext::alone("".as_ref())
        };
        assert_eq!(run.output_path("las/*_ex.laz"), Path::new("out/las/flight7_ex.laz"));
        assert_eq!(run.output_path("/abs/all.laz"), Path::new("/abs/all.laz"));
    }

    #[test]
    fn a_folder_ends_before_the_first_star() {
        let folder = |pattern: &str| fixed_folder(Path::new("out"), pattern);
        assert_eq!(folder("*.laz"), Path::new("out"));
        assert_eq!(folder("las/*.laz"), Path::new("out/las"));
        assert_eq!(folder("las/all.laz"), Path::new("out/las"));
        assert_eq!(folder("flight_*/a.laz"), Path::new("out"));
        assert_eq!(folder("/elsewhere/all.laz"), Path::new("/elsewhere"));
        assert_eq!(fixed_folder(Path::new(""), "all.laz"), Path::new("."));
    }
}
