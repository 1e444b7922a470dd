//! `wavex run --resume`: inputs whose outputs an earlier run has completed.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsStr;
use std::fs::Metadata;
use std::path::{Path, PathBuf};
use std::time::SystemTime;

use serde_json::Value;

use super::ResumeCheck;
use crate::archive::{FilesRead, digest_of, plain};
use wavex_engine::engine::{Input, RunSummary};
use wavex_engine::job::Job;
use wavex_pages::report::{FileState, InputFiles, difference};

/// What files are compared by, and the folders in which they are.
#[derive(Clone, Debug)]
pub(super) struct Comparison {
    check: Option<ResumeCheck>,
    /// Absolute folder of the inputs.
    input_dir: PathBuf,
    /// Absolute folder of the outputs.
    output_dir: PathBuf,
}

impl Comparison {
    /// Compares files in these folders by this check.
    pub(super) fn new(check: Option<ResumeCheck>, input_dir: &Path, output_dir: &Path) -> Comparison {
        let absolute = |folder: &Path| std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
        Comparison { check, input_dir: absolute(input_dir), output_dir: absolute(output_dir) }
    }

    /// State of a file in or outside of a folder; `None` if it cannot be read.
    fn state(&self, folder: &Path, path: &Path) -> Option<FileState> {
        let about = path.metadata().ok()?;
        let modified_s = modified_s(&about)?;
        let blake3 = match self.check {
            Some(ResumeCheck::Digest) => Some(digest_of(path).ok()?),
            _ => None,
        };
        let absolute = std::path::absolute(path).ok()?;
        let shown = absolute.strip_prefix(folder).unwrap_or(&absolute);
        let path = shown.to_string_lossy().into_owned();
        Some(FileState { path, bytes: about.len(), modified_s, blake3 })
    }

    /// States of the existing ones of these outputs.
    pub(super) fn written<'p>(&self, paths: impl IntoIterator<Item = &'p PathBuf>) -> Vec<FileState> {
        paths.into_iter().filter_map(|path| self.state(&self.output_dir, path)).collect()
    }

    /// First planned output that a report does not name.
    fn unnamed(&self, planned: &[PathBuf], named: &[PathBuf]) -> Option<String> {
        let absolute = |path: &PathBuf| plain(&std::path::absolute(path).unwrap_or_else(|_| path.clone()));
        let named: BTreeSet<PathBuf> = named.iter().map(absolute).collect();
        let missing = planned.iter().find(|path| !named.contains(&absolute(path)))?;
        Some(format!("the earlier report does not name its output {}", missing.display()))
    }

    /// States of the files that a run reads, by the stem of the input.
    pub(super) fn read(&self, job: &Job, inputs: &[Input]) -> BTreeMap<String, Vec<FileState>> {
        let mut files = FilesRead::new(job, &self.input_dir);
        let mut of_input = |input: &Input| {
            // The paths of inputs contain the folder.
            let path = std::path::absolute(&input.path).unwrap_or_else(|_| input.path.clone());
            // Without their states, the input is not skipped later.
            let read = files.of(&[Input { path, ..input.clone() }]).unwrap_or_default();
            read.iter().filter_map(|path| self.state(&self.input_dir, path)).collect()
        };
        inputs.iter().map(|input| (input.stem.clone(), of_input(input))).collect()
    }

    /// First file whose state differs from an earlier one.
    fn changed(&self, now: &[FileState], then: &[FileState]) -> Option<String> {
        let is_same = |now: &FileState, then: &FileState| match self.check {
            Some(ResumeCheck::Digest) => now.blake3.is_some() && now.blake3 == then.blake3,
            _ => (now.bytes, now.modified_s) == (then.bytes, then.modified_s),
        };
        let find = |among: &[FileState], path: &str| among.iter().find(|file| file.path == path).cloned();
        for file in then {
            match find(now, &file.path) {
                None => return Some(format!("{} is missing", file.path)),
                Some(_) if self.check == Some(ResumeCheck::Digest) && file.blake3.is_none() => {
                    return Some(format!("the earlier run took no digest of {}", file.path));
                }
                Some(now) if !is_same(&now, file) => return Some(format!("{} was changed", file.path)),
                Some(_) => {}
            }
        }
        let new = now.iter().find(|file| find(then, &file.path).is_none());
        new.map(|file| format!("{} is new", file.path))
    }
}

/// Modification time of a file, s since 1970.
pub(super) fn modified_s(about: &Metadata) -> Option<f64> {
    Some(about.modified().ok()?.duration_since(SystemTime::UNIX_EPOCH).ok()?.as_secs_f64())
}

/// Earlier report of the job, as far as it applies to the next run.
pub(super) struct EarlierRun {
    report: Value,
    /// Why no input can be skipped.
    obstacle: Option<String>,
}

impl EarlierRun {
    /// Compares an earlier report with the next run; `None`: there is none.
    pub(super) fn new(report: Option<Result<Value, String>>, job: &Job, next: &RunSummary) -> EarlierRun {
        let none = || Err("there is no report of an earlier run".to_owned());
        match report.unwrap_or_else(none) {
            Ok(report) => EarlierRun { obstacle: difference(&report, job, next, &[]), report },
            Err(problem) => EarlierRun { report: Value::Null, obstacle: Some(problem) },
        }
    }

    /// Returns the earlier results of an input with complete outputs.
    ///
    /// `read` and `planned` are the files that its run reads and writes, `number` its place among the inputs.
    ///
    /// # Errors
    /// The reason to run it again.
    pub(super) fn results(
        &self,
        input: &Input,
        read: &[FileState],
        planned: &[PathBuf],
        number: usize,
        comparison: &Comparison,
    ) -> Result<&Value, String> {
        if let Some(obstacle) = &self.obstacle {
            return Err(obstacle.clone());
        }
        if input.path == Path::new("-") {
            return Err("standard input cannot be compared".to_owned());
        }
        let inputs = self.report["inputs"].as_array().map_or(&[][..], Vec::as_slice);
        let place = inputs.iter().position(|entry| entry["stem"] == *input.stem);
        let place = place.ok_or("it was no input of the earlier run")?;
        let entry = &inputs[place];
        if place != number && self.numbers_flight_lines() {
            return Err(format!(
                "its flight line was number {}, and is {}; numbers of `point_source_id = \"name\"` do not depend on the other inputs",
                place + 1,
                number + 1
            ));
        }
        match entry["status"].as_str() {
            Some("done") => {}
            Some("failed") => return Err("it failed in the earlier run".to_owned()),
            _ => return Err("the earlier run ended before it".to_owned()),
        }
        let files: InputFiles = serde_json::from_value(entry["files"].clone())
            .map_err(|_| "the earlier report does not describe its files".to_owned())?;
        let paths: Vec<PathBuf> =
            files.written.iter().map(|file| comparison.output_dir.join(&file.path)).collect();
        let name = input.path.file_name().map(OsStr::to_string_lossy);
        let is_input =
            |file: &FileState| Path::new(&file.path).file_name().map(OsStr::to_string_lossy) == name;
        if !input.path.as_os_str().is_empty() && !read.iter().any(is_input) {
            return Err(format!("{} cannot be read", input.path.display()));
        }
        let changed = comparison
            .changed(read, &files.read)
            .or_else(|| comparison.changed(&comparison.written(&paths), &files.written))
            .or_else(|| comparison.unnamed(planned, &paths));
        changed.map_or(Ok(entry), Err)
    }

    /// Whether points have the number of their input in the job.
    fn numbers_flight_lines(&self) -> bool {
        let stages = self.report["stages"].as_array().map_or(&[][..], Vec::as_slice);
        stages.iter().any(|stage| stage["keys"]["point_source_id"] == "line")
    }
}
