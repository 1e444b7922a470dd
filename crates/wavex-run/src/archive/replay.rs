//! Runs an archived job again and compares the outputs.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};

use super::contents::Contents;
use super::difference::first_difference;
use super::origin::Program;
use super::paths::{plain, relative};
use super::verify::{self, Folders};
use super::{Archive, DigestedFile, RESOLVED, digest, inputs, resolved};
use wavex_engine::engine::{self, Cancel, InputSummary, Options, ProgressMode, RunSummary};
use wavex_engine::job::{Job, Override, Simd};
use wavex_formats::Error;
use wavex_formats::sdf::library;
use wavex_line::stage::{Result, StageError, own_file};
use wavex_stages::registry::STAGES;

/// Options of a replay.
#[derive(Clone, Debug)]
pub struct Replay {
    /// Current folders of inputs and outputs.
    pub folders: Folders,
    /// Seal noted when the archive was made.
    pub seal: Option<String>,
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
    let noted = replay.seal.as_deref().and_then(|noted| verify::other_seal(&seal, noted));
    let tampering: Vec<String> = noted.into_iter().chain(contents.tampering()).collect();
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
    check_paths(&job, &input_dir, folder.path())?;
    let mut options = Options::of_job(&job, input_dir, folder.path());
    options.progress = replay.progress;
    options.cancel = replay.cancel.clone();
    let mut run = RunSummary::new(&job, &options);
    engine::run_each(&job, &options, &mut run, &mut |_, _, _| Ok(()))
        .map_err(|error| error.into_stage_error())?;
    let then = verify::place(&archive.outputs, &contents, replay.folders.outputs.as_deref());
    let mut problems = compare_failures(&archive, &run);
    problems.extend(compare(&archive, &run, folder.path(), &then)?);
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
    match Job::parse(STAGES, RESOLVED, text, &set) {
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

/// Checks that an archived job reads and writes below its folders only, and loads no native code.
///
/// Archives come from others, who can change and reseal them.
fn check_paths(job: &Job, input_dir: &Path, output_dir: &Path) -> Result<()> {
    let refused = |problem: String| {
        Err(StageError::failed(problem, "do not trust this archive; compare its seal with the noted one"))
    };
    for stage in &job.stages {
        let given = |key: &&&str| stage.planned.resolved.get(**key).is_some_and(|value| !value.is_null());
        if let Some(key) = stage.planned.local_keys.iter().find(given) {
            return refused(format!("the archived job has the key `{key}` of stage {}", stage.id));
        }
    }
    if job.stages.iter().any(|stage| stage.spec.name == "read_sdf") {
        let named = std::env::var_os(library::VARIABLE).filter(|named| !named.is_empty());
        let named =
            named.map(|named| format!("{} names it: {}", library::VARIABLE, Path::new(&named).display()));
        let named = named.unwrap_or_else(|| "in one of the usual folders".to_owned());
        tracing::warn!("the archived job reads SDF: RIEGL's library is loaded ({named})");
    }
    let input_dir = std::path::absolute(input_dir).map_err(Error::io(input_dir, "find the folder"))?;
    let input_dir = plain(&input_dir);
    let settings = serde_json::to_value(&job.settings).unwrap_or_default();
    let sources = engine::inputs(job, &input_dir).map_err(|error| error.into_stage_error())?;
    let read = inputs::of_job(job, &settings, &sources, &input_dir)?;
    let written = resolved::outputs_of(job, &sources, output_dir);
    if let Some(path) = read.iter().find(|path| !path.starts_with(&input_dir)) {
        let path = path.display();
        return refused(format!(
            "the archived job reads {path}, which is not below the folder of its inputs"
        ));
    }
    match written.keys().find(|path| !path.starts_with(output_dir)) {
        Some(path) => {
            let path = path.display();
            refused(format!("the archived job writes {path}, which is not below the folder of its outputs"))
        }
        None => Ok(()),
    }
}

/// Note if another program made the archive.
fn other_program(archive: &Archive) -> Option<String> {
    let (then, now) = (&archive.program, Program::this());
    (*then != now)
        .then(|| format!("the archive was made by wavex {}, this is wavex {}", then.words(), now.words()))
}

/// Compares the inputs that failed with the failed inputs of the archived run.
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

/// A temporary folder with a name that nobody can foresee, removed on drop.
///
/// A lock shows that its process lives; folders of killed replays are removed by the next one.
struct Temporary {
    folder: PathBuf,
    _lock: File,
}

/// Prefix of temporary folders.
const PREFIX: &str = "wavex-replay-";
/// File in a temporary folder that its process keeps locked.
const LOCK: &str = ".wavex-replay.lock";

impl Temporary {
    fn new() -> Result<Temporary> {
        let place = std::env::temp_dir();
        remove_remains(&place);
        let create = Error::io(&place, "create a folder in");
        loop {
            let folder = tempfile::Builder::new().prefix(PREFIX).tempdir_in(&place).map_err(&create)?;
            let lock = match File::create(folder.path().join(LOCK)) {
                // Another replay has just removed the empty folder.
                Err(_) if !folder.path().exists() => continue,
                lock => lock.map_err(&create)?,
            };
            // Where there are no locks, remains stay until the system removes them.
            let _ = lock.try_lock();
            return Ok(Temporary { folder: folder.keep(), _lock: lock });
        }
    }

    fn path(&self) -> &Path {
        &self.folder
    }
}

impl Drop for Temporary {
    fn drop(&mut self) {
        // What cannot be removed now is removed by the next replay.
        let _ = remove_with_lock(&self.folder);
    }
}

/// Removes a temporary folder, and its lock last: remains without a lock would not be recognised.
fn remove_with_lock(folder: &Path) -> io::Result<()> {
    for entry in folder.read_dir()? {
        let entry = entry?;
        if entry.file_type()?.is_dir() {
            fs::remove_dir_all(entry.path())?;
        } else if entry.file_name() != LOCK {
            fs::remove_file(entry.path())?;
        }
    }
    fs::remove_dir_all(folder)
}

/// Removes the folders of killed replays.
fn remove_remains(place: &Path) {
    for entry in place.read_dir().into_iter().flatten().flatten() {
        let is_folder = entry.file_type().is_ok_and(|kind| kind.is_dir());
        if is_folder && entry.file_name().to_string_lossy().starts_with(PREFIX) {
            // Others' folders cannot be removed, and need not be.
            let _ = match own_file::no_link().write(true).open(entry.path().join(LOCK)) {
                Ok(lock) if lock.try_lock().is_ok() => remove_with_lock(&entry.path()),
                // Of a replay killed between two steps; only an empty folder can be removed this way.
                Err(error) if error.kind() == io::ErrorKind::NotFound => fs::remove_dir(entry.path()),
                _ => Ok(()),
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_of_killed_replays_are_removed_and_of_running_ones_kept() {
        let place = tempfile::tempdir().unwrap();
        let [dead, living, other, empty] =
            ["wavex-replay-dead", "wavex-replay-living", "wavex-other", "wavex-replay-empty"]
                .map(|name| place.path().join(name));
        for folder in [&dead, &living, &other] {
            fs::create_dir_all(folder.join("lines")).unwrap();
            fs::write(folder.join(LOCK), "").unwrap();
            fs::write(folder.join("a.laz"), "").unwrap();
        }
        fs::create_dir(&empty).unwrap();
        let held = File::open(living.join(LOCK)).unwrap();
        held.lock().unwrap();
        remove_remains(place.path());
        assert_eq!([dead, living, other, empty].map(|folder| folder.exists()), [false, true, true, false]);
    }
}
