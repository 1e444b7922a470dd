//! One run at a time for the same outputs: what a run writes, it claims first.
//!
//! A claim is a small file in the folder of the outputs that tells them, and that the system keeps locked for the run as long
//! as it lives, however it ends. Whoever comes next finds out by the lock alone whether that run still lives: its claim is then
//! respected, and swept away with its unfinished files otherwise.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

use super::output_file::partial_path;
use super::{Result, StageError};
use crate::formats::Error;

/// What the names of claims begin and end with; between them stand the number of the process and that of its claim.
const CLAIM: (&str, &str) = (".wavex-", ".run");
/// Whoever reads or changes the claims of a folder holds this file meanwhile.
const GATE: &str = ".wavex.lock";
/// So often is the gate sought where others give it up at that moment.
const MOST_ATTEMPTS: u32 = 10_000;
/// A list of outputs is never longer, bytes.
const MOST_BYTES: u64 = 1 << 26;

/// Outputs by the folder in which they are claimed, which they all lie below.
pub type Outputs = BTreeMap<PathBuf, BTreeSet<PathBuf>>;

/// Keeps other runs from writing the same files for as long as it lives.
#[derive(Debug, Default)]
pub struct OutputLock(Vec<Claim>);

/// The claim of a run on outputs below a folder.
#[derive(Debug)]
struct Claim {
    path: PathBuf,
    /// Locked while it is open.
    file: Option<File>,
}

/// The claims of this process, for an end without time for anything else.
static CLAIMED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn claimed() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    // Each change is one insertion or removal: a panic elsewhere cannot leave the set half done.
    CLAIMED.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Gives up what this process claims: where it ends at once.
pub fn give_up_claims() {
    let paths = claimed().clone();
    for path in &paths {
        give_up(path);
    }
}

/// Removes a claim, and the gate with the last one.
fn give_up(claim: &Path) {
    // Without the gate the file is as good as gone all the same: its lock ends with the process.
    let gate = Gate::enter(claim.parent().unwrap_or(Path::new(".")));
    remove(claim);
    if let Ok(gate) = gate {
        gate.leave();
    }
}

impl OutputLock {
    /// Claims outputs, and sweeps up what runs have left that were killed. Folders are made where they are missing. On a
    /// file system that knows no locks nothing is claimed, and the log says so.
    ///
    /// # Errors
    /// Another run is writing one of them, or a folder cannot be written to.
    pub fn take(outputs: &Outputs) -> Result<OutputLock> {
        let mut lock = OutputLock::default();
        for (folder, paths) in outputs {
            fs::create_dir_all(folder).map_err(Error::io(folder, "make the folder"))?;
            match claim(folder, paths) {
                Ok(claim) => lock.0.push(claim),
                Err(StageError::Format(Error::Io { source, .. })) if is_unsupported(&source) => {
                    let folder = folder.display();
                    tracing::warn!(
                        "{folder}: locks are not known here: nothing keeps two runs from writing the same files"
                    );
                }
                Err(error) => return Err(error),
            }
        }
        Ok(lock)
    }
}

fn is_unsupported(error: &io::Error) -> bool {
    error.kind() == io::ErrorKind::Unsupported
}

fn claim(folder: &Path, paths: &BTreeSet<PathBuf>) -> Result<Claim> {
    let gate = Gate::enter(folder).map_err(Error::io(folder, "lock the folder of the outputs"))?;
    let wanted = paths.iter().map(|path| below(folder, path)).collect();
    for claim in claims(folder) {
        if let Some(other) = Other::look(&claim).map_err(Error::io(&claim, "read what another run claims"))? {
            other.check(folder, &wanted)?;
        }
    }
    let made = make(folder, &wanted).map_err(Error::io(folder, "claim the outputs in"))?;
    gate.leave();
    Ok(made)
}

/// A path from a folder that it lies below.
fn below(folder: &Path, path: &Path) -> String {
    path.strip_prefix(folder).unwrap_or(path).to_string_lossy().into_owned()
}

/// The claims in a folder.
fn claims(folder: &Path) -> Vec<PathBuf> {
    let is_claim = |path: &PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        name.starts_with(CLAIM.0) && name.ends_with(CLAIM.1)
    };
    // A folder that cannot be listed has no claims that one could read.
    let entries = folder.read_dir().into_iter().flatten().flatten();
    entries.map(|entry| entry.path()).filter(is_claim).collect()
}

/// The process that a claim's name tells.
fn process_of(claim: &Path) -> u32 {
    let name = claim.file_name().unwrap_or_default().to_string_lossy();
    let numbers = name.strip_prefix(CLAIM.0).unwrap_or_default();
    numbers.split('-').next().and_then(|number| number.parse().ok()).unwrap_or(0)
}

/// Makes a claim of this process and locks it.
fn make(folder: &Path, wanted: &BTreeSet<String>) -> io::Result<Claim> {
    let list = serde_json::to_vec(wanted)?;
    let mut number = 0;
    loop {
        let path = folder.join(format!("{}{}-{number}{}", CLAIM.0, std::process::id(), CLAIM.1));
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => number += 1,
            Err(error) => return Err(error),
            Ok(mut file) => {
                let locked = file.lock().and_then(|()| file.write_all(&list));
                claimed().insert(path.clone());
                let claim = Claim { path, file: Some(file) };
                return locked.map(|()| claim);
            }
        }
    }
}

/// The claim of a run that lives.
struct Other {
    process: u32,
    /// What it writes; `None` where the system lets nobody else read a locked file.
    outputs: Option<BTreeSet<String>>,
}

impl Other {
    /// Looks at a claim; `None`: its run is dead, and all that it left is swept away.
    fn look(claim: &Path) -> io::Result<Option<Other>> {
        let mut file = match OpenOptions::new().read(true).write(true).open(claim) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            opened => opened?,
        };
        let lives = match file.try_lock() {
            Ok(()) => false,
            Err(TryLockError::WouldBlock) => true,
            Err(TryLockError::Error(error)) => return Err(error),
        };
        let mut list = Vec::new();
        let read = (&mut file).take(MOST_BYTES).read_to_end(&mut list);
        let outputs: Option<BTreeSet<String>> = read.ok().and_then(|_| serde_json::from_slice(&list).ok());
        let process = process_of(claim);
        if lives {
            return Ok(Some(Other { process, outputs }));
        }
        let folder = claim.parent().unwrap_or(Path::new("."));
        for output in outputs.iter().flatten() {
            remove(&partial_path(&folder.join(output), process));
        }
        remove(claim);
        Ok(None)
    }

    /// # Errors
    /// It writes one of these files below a folder.
    fn check(&self, folder: &Path, wanted: &BTreeSet<String>) -> Result<()> {
        let meets = match &self.outputs {
            Some(outputs) => outputs.intersection(wanted).next(),
            None => wanted.first(),
        };
        match meets {
            None => Ok(()),
            Some(output) => Err(StageError::failed(
                format!(
                    "{} is being written by another run (process {})",
                    folder.join(output).display(),
                    self.process
                ),
                "wait for its end, or choose another folder with `output_dir`",
            )),
        }
    }
}

/// Removes a file or a folder of a dead run. What resists is in nobody's way.
fn remove(path: &Path) {
    let _ = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.file = None;
        give_up(&self.path);
        claimed().remove(&self.path);
    }
}

/// Lets one run at a time look at the claims of a folder and change them.
struct Gate {
    file: File,
    folder: PathBuf,
}

impl Gate {
    fn enter(folder: &Path) -> io::Result<Gate> {
        let path = folder.join(GATE);
        for attempt in 0..MOST_ATTEMPTS {
            let mut file = OpenOptions::new().read(true).append(true).create(true).open(&path)?;
            file.lock()?;
            if file.metadata()?.len() == 0 {
                return Ok(Gate { file, folder: folder.to_owned() });
            }
            // It was given up by the one who held it: the gate is another file by now, or that one was killed before it
            // could remove this. A mark of one's own tells which.
            let mark = format!("{}-{attempt}\n", std::process::id());
            file.write_all(mark.as_bytes())?;
            if fs::read_to_string(&path).is_ok_and(|found| found.ends_with(&mark)) {
                fs::remove_file(&path)?;
            }
        }
        Err(io::Error::other(format!("remove the file {GATE} in it")))
    }

    /// Leaves, and takes the gate away where there is nothing left to be looked at.
    fn leave(mut self) {
        if claims(&self.folder).is_empty() && self.file.write_all(b"given up\n").is_ok() {
            remove(&self.folder.join(GATE));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn outputs(folder: &Path, names: &[&str]) -> Outputs {
        BTreeMap::from([(folder.to_owned(), names.iter().map(|name| folder.join(name)).collect())])
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }

    #[test]
    fn the_same_output_is_refused_while_its_run_lives_and_others_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let first = OutputLock::take(&outputs(folder, &["a.laz", "lines/a.txt"])).unwrap();
        let error = OutputLock::take(&outputs(folder, &["b.laz", "lines/a.txt"])).unwrap_err().to_string();
        let expected = format!(
            "{} is being written by another run (process {}); wait for its end, or choose another folder with `output_dir`",
            folder.join("lines/a.txt").display(),
            std::process::id()
        );
        assert_eq!(error, expected);
        let other = OutputLock::take(&outputs(folder, &["b.laz"])).unwrap();
        drop(first);
        let again = OutputLock::take(&outputs(folder, &["a.laz"])).unwrap();
        drop((other, again));
        assert_eq!(names(folder), Vec::<String>::new(), "nothing is left");
    }

    #[test]
    fn what_a_dead_run_left_is_swept_away() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        // A claim that nobody holds, of a process with an unfinished file and an unfinished archive.
        fs::write(folder.join(".wavex-77-0.run"), r#"["a.laz","archive"]"#).unwrap();
        fs::write(folder.join(".a.laz.77.partial"), "half").unwrap();
        fs::create_dir(folder.join(".archive.77.partial")).unwrap();
        fs::write(folder.join(".archive.77.partial/job.toml"), "half").unwrap();
        fs::write(folder.join(".b.laz.78.partial"), "of somebody else").unwrap();
        drop(OutputLock::take(&outputs(folder, &["a.laz"])).unwrap());
        assert_eq!(names(folder), [".b.laz.78.partial"]);
    }

    #[test]
    fn a_claim_that_cannot_be_read_counts_for_the_whole_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(".wavex-77-0.run");
        fs::write(&path, "[").unwrap();
        let held = File::open(&path).unwrap();
        held.lock().unwrap();
        let error = OutputLock::take(&outputs(folder.path(), &["a.laz"])).unwrap_err().to_string();
        assert!(error.contains("a.laz is being written by another run (process 77); "), "{error}");
    }

    #[test]
    fn a_gate_that_was_given_up_and_not_removed_is_in_nobodys_way() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(GATE), "given up\n").unwrap();
        drop(OutputLock::take(&outputs(folder.path(), &["a.laz"])).unwrap());
        assert_eq!(names(folder.path()), Vec::<String>::new());
    }

    #[test]
    fn many_at_once_leave_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let won: usize = std::thread::scope(|scope| {
            let take = || {
                let tries = (0..40).map(|_| OutputLock::take(&outputs(folder, &["a.laz"])));
                tries.filter(|taken| taken.is_ok()).count()
            };
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(take)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).sum()
        });
        assert!(won >= 1, "whoever comes first gets it");
        assert_eq!(names(folder), Vec::<String>::new());
    }
}
