//! The run of an archive once more, and whether it gives the same bytes.

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
use crate::engine::{self, Cancel, Options, ProgressMode, RunReport};
use crate::formats::Error;
use crate::job::{Job, Override, Simd};
use crate::stage::{Result, StageError};

/// How an archive is run again.
#[derive(Clone, Debug)]
pub struct Replay {
    /// Where inputs and outputs are now.
    pub folders: Folders,
    /// Workers per map; the archive's when not given, as many as the machine has cores when 0.
    pub threads: Option<usize>,
    /// How to show how far the run is.
    pub progress: ProgressMode,
    /// Ends the run early when it is set.
    pub cancel: Cancel,
}

/// What came out.
#[derive(Debug)]
pub struct Replayed {
    /// Each thing that is not as it was; empty: every output is the same to the bit.
    pub problems: Vec<String>,
    /// What the user should know besides.
    pub notes: Vec<String>,
    /// How many outputs were compared.
    pub outputs: usize,
    /// The archive's seal, the BLAKE3 digest of `archive.b3`; empty where that is missing.
    pub seal: String,
}

/// Runs an archive again, into a folder of its own that is removed behind it, and compares what comes out with what came out
/// then. Nothing is run where the archive or an input is not as it was.
///
/// # Errors
/// There is no archive, or the run fails.
pub fn replay(path: &Path, replay: &Replay) -> Result<Replayed> {
    let contents = Contents::read(path)?;
    let seal = contents.seal();
    let stopped = |seal, problems| Ok(Replayed { problems, notes: Vec::new(), outputs: 0, seal });
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
    options.overview = false;
    options.cancel = replay.cancel.clone();
    let report = engine::run(&job, &options).map_err(|error| error.into_stage_error())?;
    let then = verify::place(&archive.outputs, &contents, replay.folders.outputs.as_deref());
    let problems = compare(&archive, &report, &folder.0, &then)?;
    if !problems.is_empty() {
        notes.extend(other_program(&archive));
    }
    Ok(Replayed { problems, notes, outputs: archive.outputs.files.len(), seal })
}

/// The job as it was run, and what is different of it here.
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
            "the run used instructions that this processor lacks ({}): others are used, which give the same results",
            archive.machine.processor.as_deref().unwrap_or(&archive.machine.architecture)
        ));
    }
    match Job::parse(RESOLVED, text, &set) {
        Ok(job) => Ok((job, notes)),
        Err(errors) => {
            let problem = format!(
                "the job of this archive is none that wavex {} knows:\n{errors}",
                env!("CARGO_PKG_VERSION")
            );
            Err(StageError::failed(problem.trim_end(), format!("use wavex {}", archive.program.words())))
        }
    }
}

/// A note where another program made the archive.
fn other_program(archive: &Archive) -> Option<String> {
    let (then, now) = (&archive.program, Program::this());
    (*then != now)
        .then(|| format!("the archive was made by wavex {}, this is wavex {}", then.words(), now.words()))
}

/// What differs between the outputs of now, in `now`, and those of then, which may lie in `then`.
fn compare(archive: &Archive, report: &RunReport, now: &Path, then: &Path) -> Result<Vec<String>> {
    let outputs = report.inputs.iter().flat_map(|input| &input.outputs);
    let mut made: BTreeMap<String, &PathBuf> =
        outputs.filter_map(|path| Some((relative(now, path)?, path))).collect();
    let mut problems = Vec::new();
    for file in &archive.outputs.files {
        match made.remove(&file.path) {
            None => problems.push(format!("output {}: the run does not make it any more", file.path)),
            Some(path) => problems.extend(compare_file(file, path, &then.join(&file.path))?),
        }
    }
    problems.extend(made.keys().map(|path| format!("output {path}: the run did not make it then")));
    Ok(problems)
}

/// What is wrong with an output, if anything: the one made now, and the one made then where it still lies there.
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
            Some(format!("{name}: the run makes it again, but {then} was changed since: {difference}"))
        }
        (false, true) if is_same(then)? => {
            Some(format!("{name}: not the same: {}", first_difference(then, now)))
        }
        (false, _) => {
            let (_, blake3) = digest::of_file(now)?;
            Some(format!(
                "{name}: not the same: its digest is {blake3} instead of {}; the file of then is not at hand to say where",
                file.blake3
            ))
        }
    })
}

/// A folder that is removed in the end.
struct Temporary(PathBuf);

impl Temporary {
    fn new() -> Result<Temporary> {
        static COUNT: AtomicUsize = AtomicUsize::new(0);
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let path = std::env::temp_dir().join(format!("wavex-replay-{}-{number}", std::process::id()));
        fs::create_dir_all(&path).map_err(Error::io(&path, "make the folder"))?;
        Ok(Temporary(path))
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // The system's own sweeping of temporary files gets what resists.
        let _ = fs::remove_dir_all(&self.0);
    }
}
