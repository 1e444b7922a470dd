//! Runs an archived job again and compares the outputs.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

use super::contents::Contents;
use super::difference::first_difference;
use super::origin::Program;
use super::paths::relative;
use super::verify::{self, Folders};
use super::{Archive, DigestedFile, RESOLVED, digest};
use crate::engine::{self, Cancel, InputSummary, Options, ProgressMode, RunSummary};
use crate::job::{Job, Override, Simd};
use crate::stage::{Result, StageError};
use wavex_formats::Error;

/// Options of a replay.
#[derive(Clone, Debug)]
pub struct Replay {
    /// Current folders of inputs and outputs.
    pub folders: Folders,
    /// Workers per map; default: as in the archived run; 0: one per core.
    pub threads: Option<usize>,
    /// Progress display.
    pub progress: ProgressMode,
    /// Ends the run early when set.
    pub cancel: Cancel,
}

/// Result of a replay.
#[derive(Debug)]
pub struct Replayed {
    /// Differences; empty if all outputs are identical bit by bit.
    pub problems: Vec<String>,
    /// Further notes for the user.
    pub notes: Vec<String>,
    /// Number of compared outputs.
    pub outputs: usize,
    /// Stems of the inputs that failed, as in the archived run.
    pub failed: Vec<String>,
    /// Seal of the archive: the BLAKE3 digest of `archive.b3`; empty if missing.
    pub seal: String,
}

/// Runs an archived job again and compares the outputs.
///
/// Writes to a temporary folder, which is removed afterwards. Does not run if the archive or an
/// input has changed.
///
/// # Errors
/// If there is no archive or the run fails.
pub fn replay(path: &Path, replay: &Replay) -> Result<Replayed> {
    let contents = Contents::read(path)?;
    let seal = contents.seal();
    let stopped =
        |seal, problems| Ok(Replayed { problems, notes: Vec::new(), outputs: 0, failed: Vec::new(), seal });
    let tampering = contents.tampering();
    if !tampering.is_empty() {
        return stopped(seal, tampering);
    }
    let archive = contents.archive()?;
    let inputs = verify::inputs(&archive, &contents, &replay.folders);
    if !inputs.is_empty() {
        return stopped(seal, inputs);
    }
    let (job, mut notes) = job(&contents, &archive, replay.threads)?;
    let folder = Temporary::new()?;
    let input_dir = verify::place(&archive.inputs, &contents, replay.folders.inputs.as_deref());
    let mut options = Options::of_job(&job, input_dir, &folder.0);
    options.progress = replay.progress;
    options.cancel = replay.cancel.clone();
    let mut run = RunSummary::new(&job, &options);
    engine::run_each(&job, &options, &mut run, &mut |_, _, _| Ok(()))
        .map_err(|error| error.into_stage_error())?;
    let then = verify::place(&archive.outputs, &contents, replay.folders.outputs.as_deref());
    let mut problems = compare_failures(&archive, &run);
    problems.extend(compare(&archive, &run, &folder.0, &then)?);
    if !problems.is_empty() {
        notes.extend(other_program(&archive));
    }
    let (outputs, failed) = (archive.outputs.files.len(), verify::failed(&archive));
    Ok(Replayed { problems, notes, outputs, failed, seal })
}

/// The archived job, and notes on differences to the archived run.
fn job(contents: &Contents, archive: &Archive, threads: Option<usize>) -> Result<(Job, Vec<String>)> {
    let text = contents.resolved_job()?;
    let wanted = toml::from_str::<toml::Table>(text).ok().and_then(|job| {
        let simd: Simd = job.get("job")?.get("simd")?.clone().try_into().ok()?;
        Some(simd)
    });
    let mut set: Vec<Override> =
        threads.map(|threads| Override::new(format!("job.threads={threads}"))).into_iter().collect();
    let mut notes = Vec::new();
    if wanted.is_some_and(|simd| !simd.path().is_available()) {
        set.push(Override::new("job.simd='auto'"));
        notes.push(format!(
            "the archived run used SIMD instructions that this processor lacks (recorded on: {}); other instructions with the same results are used",
            archive.machine.processor.as_deref().unwrap_or(&archive.machine.architecture)
        ));
    }
    match Job::parse(RESOLVED, text, &set) {
        Ok(job) => Ok((job, notes)),
        Err(errors) => {
            let problem = format!(
                "the job of this archive is not valid in wavex {}:\n{errors}",
                env!("CARGO_PKG_VERSION")
            );
            Err(StageError::failed(problem.trim_end(), format!("use wavex {}", archive.program.words())))
        }
    }
}

/// Note if another program made the archive.
fn other_program(archive: &Archive) -> Option<String> {
    let (then, now) = (&archive.program, Program::this());
    (*then != now)
        .then(|| format!("the archive was made by wavex {}, this is wavex {}", then.words(), now.words()))
}

/// Compares the inputs that failed with those of the archived run.
fn compare_failures(archive: &Archive, run: &RunSummary) -> Vec<String> {
    let compare = |input: &InputSummary| {
        let failed_then = archive.failed.iter().any(|failed| failed.stem == input.stem);
        match &input.failure {
            Some(reason) if !failed_then => {
                Some(format!("input {}: failed in the replay: {reason}", input.stem))
            }
            None if failed_then => {
                Some(format!("input {}: failed in the archived run, but not in the replay", input.stem))
            }
            _ => None,
        }
    };
    run.inputs.iter().filter_map(compare).collect()
}

/// Compares new outputs in `now` with the archived ones, which may still exist in `then`.
fn compare(archive: &Archive, report: &RunSummary, now: &Path, then: &Path) -> Result<Vec<String>> {
    let outputs = report.inputs.iter().flat_map(|input| &input.outputs);
    let mut made: BTreeMap<String, &PathBuf> =
        outputs.filter_map(|path| Some((relative(now, path)?, path))).collect();
    let mut problems = Vec::new();
    for file in &archive.outputs.files {
        match made.remove(&file.path) {
            None => problems.push(format!("output {}: not made by the replay", file.path)),
            Some(path) => problems.extend(compare_file(file, path, &then.join(&file.path))?),
        }
    }
    problems.extend(
        made.keys().map(|path| format!("output {path}: made by the replay, but not by the archived run")),
    );
    Ok(problems)
}

/// Compares an output with its digest; uses the original file if it still exists.
fn compare_file(file: &DigestedFile, now: &Path, then: &Path) -> Result<Option<String>> {
    let name = match &file.stage {
        Some(stage) => format!("output {} of stage {stage}", file.path),
        None => format!("output {}", file.path),
    };
    let is_same =
        |path: &Path| -> Result<bool> { Ok(digest::of_file(path)? == (file.bytes, file.blake3.clone())) };
    let is_reproduced = is_same(now)?;
    Ok(match (is_reproduced, then.is_file()) {
        (true, false) => None,
        (true, true) if is_same(then)? => None,
        (true, true) => {
            let difference = first_difference(now, then);
            let then = then.display();
            Some(format!("{name}: reproduced, but {then} was changed since the run: {difference}"))
        }
        (false, true) if is_same(then)? => {
            Some(format!("{name}: different: {}", first_difference(then, now)))
        }
        (false, _) => {
            let (_, blake3) = digest::of_file(now)?;
            Some(format!(
                "{name}: different: its digest is {blake3} instead of {}; the original file is not available to locate the difference",
                file.blake3
            ))
        }
    })
}

/// A temporary folder, removed on drop.
struct Temporary(PathBuf);

impl Temporary {
    fn new() -> Result<Temporary> {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("wavex-replay-{}-{number}", std::process::id()));
        fs::create_dir_all(&path).map_err(Error::io(&path, "create the folder"))?;
        Ok(Temporary(path))
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // The system cleans up temporary folders that cannot be removed.
        let _ = fs::remove_dir_all(&self.0);
    }
}
