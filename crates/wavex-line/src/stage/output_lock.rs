//! Prevents two runs from writing the same outputs.
//!
//! A claim is a small file in the output folder that lists the outputs of a run. The system keeps
//! it locked while the run's process lives, however the process ends. The lock alone tells a later
//! run whether the process still lives: if so, its claim is respected; otherwise the claim and the
//! unfinished files are removed.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, DirEntry, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Component, Path, PathBuf};
use std::sync::{Mutex, MutexGuard};
use std::time::{Duration, Instant};

use super::output_file::partial_path;
use super::{Result, StageError, own_file};
use crate::system::Unpoisoned as _;
use wavex_formats::Error;

/// Prefix and suffix of claim names; the process id and the claim number are in between.
const CLAIM: (&str, &str) = (".wavex-", ".run");
/// File that a process locks while it reads or changes the claims of a folder.
const GATE: &str = ".wavex.lock";
/// Maximum number of attempts to lock the gate while others give it up.
const MOST_ATTEMPTS: u32 = 10_000;
/// Time between two attempts to lock a gate that another process holds.
const ATTEMPT_EVERY: Duration = Duration::from_millis(5);
/// Waiting time after which a message says what a run waits for.
const SILENT_WAIT: Duration = Duration::from_secs(2);
/// Maximum waiting time for the gate; others hold it for some milliseconds.
const LONGEST_WAIT: Duration = Duration::from_secs(60);
/// Maximum size of a list of outputs, bytes.
const MOST_BYTES: u64 = 1 << 26;

/// Outputs by the folder in which they are claimed; all are below that folder.
pub type Outputs = BTreeMap<PathBuf, BTreeSet<PathBuf>>;

/// Prevents other runs from writing the same files until dropped.
#[derive(Debug, Default)]
pub struct OutputLock(Vec<Claim>);

/// Claim of a run on outputs below a folder.
#[derive(Debug)]
struct Claim {
    path: PathBuf,
    /// Locked while open.
    file: Option<File>,
}

/// Claims of this process, for an immediate exit.
static CLAIMED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn claimed() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    // Each change is one insertion or removal, so a panic elsewhere cannot leave the set
    // inconsistent.
    CLAIMED.lock().unpoisoned()
}

/// Releases all claims of this process before an immediate exit.
pub fn release_all() {
    let paths = claimed().clone();
    for path in &paths {
        give_up(path);
    }
}

/// Removes a claim, and the gate with the last claim.
fn give_up(claim: &Path) {
    // Without the gate the file can still be removed: its lock ends with the process.
    let gate = FolderGate::enter(claim.parent().unwrap_or(Path::new(".")));
    remove(claim);
    if let Ok(gate) = gate {
        gate.leave();
    }
}

impl OutputLock {
    /// Claims outputs and removes remains of killed runs.
    ///
    /// Creates missing folders. On a file system without locks, logs a warning and claims nothing.
    ///
    /// # Errors
    /// If another run is writing one of the outputs, or a folder is not writable.
    pub fn acquire(outputs: &Outputs) -> Result<OutputLock> {
        let mut lock = OutputLock::default();
        for (folder, paths) in outputs {
            fs::create_dir_all(folder).map_err(Error::io(folder, "create the folder"))?;
            match claim(folder, paths) {
                Ok(claim) => lock.0.push(claim),
                Err(StageError::Format(Error::Io { source, .. })) if is_unsupported(&source) => {
                    let folder = folder.display();
                    tracing::warn!(
                        "{folder}: this file system has no locks: two runs may write the same files"
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
    let gate = FolderGate::enter(folder).map_err(Error::io(folder, "lock the output folder"))?;
    let claimed = claim_in(folder, paths);
    gate.leave();
    claimed
}

/// Claims outputs within the gate of their folder.
fn claim_in(folder: &Path, paths: &BTreeSet<PathBuf>) -> Result<Claim> {
    let wanted = paths.iter().map(|path| below(folder, path)).collect();
    for claim in claims(folder).map_err(Error::io(folder, "list the claims in"))? {
        if let Some(other) =
            OtherClaim::look(&claim).map_err(Error::io(&claim, "read the claim of another run"))?
        {
            other.check(folder, &wanted)?;
        }
    }
    Ok(make(folder, &wanted).map_err(Error::io(folder, "claim the outputs in"))?)
}

/// Path relative to a folder that contains it.
fn below(folder: &Path, path: &Path) -> String {
    path.strip_prefix(folder).unwrap_or(path).to_string_lossy().into_owned()
}

/// Claims in a folder.
fn claims(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let is_claim = |entry: &DirEntry| {
        let name = entry.file_name();
        let name = name.to_string_lossy();
        // Links and pipes are not ours.
        let is_file = || entry.file_type().is_ok_and(|kind| kind.is_file());
        name.starts_with(CLAIM.0) && name.ends_with(CLAIM.1) && is_file()
    };
    let entries: Vec<DirEntry> = folder.read_dir()?.collect::<io::Result<_>>()?;
    Ok(entries.iter().filter(|entry| is_claim(entry)).map(DirEntry::path).collect())
}

/// Process id in a claim's name.
fn process_of(claim: &Path) -> u32 {
    let name = claim.file_name().unwrap_or_default().to_string_lossy();
    let numbers = name.strip_prefix(CLAIM.0).unwrap_or_default();
    numbers.split('-').next().and_then(|number| number.parse().ok()).unwrap_or(0)
}

/// Creates and locks a claim of this process, within the gate of its folder.
fn make(folder: &Path, wanted: &BTreeSet<String>) -> io::Result<Claim> {
    let list = serde_json::to_vec(wanted)?;
    let mut number = 0;
    loop {
        let path = folder.join(format!("{}{}-{number}{}", CLAIM.0, std::process::id(), CLAIM.1));
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => number += 1,
            Err(error) => return Err(error),
            Ok(mut file) => {
                if let Err(error) = uninterrupted(|| file.lock()).and_then(|()| file.write_all(&list)) {
                    // Not by dropping a claim, which would wait for the gate that is held here.
                    remove(&path);
                    return Err(error);
                }
                claimed().insert(path.clone());
                return Ok(Claim { path, file: Some(file) });
            }
        }
    }
}

/// Claim of a live run.
struct OtherClaim {
    process: u32,
    /// Its outputs; `None` if the system does not permit reading a locked file.
    outputs: Option<BTreeSet<String>>,
}

impl OtherClaim {
    /// Inspects a claim; `None` if its run is dead, after removing its remains.
    fn look(claim: &Path) -> io::Result<Option<OtherClaim>> {
        let mut file = match own_file::no_link().read(true).write(true).open(claim) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            opened => opened?,
        };
        let lives = !uninterrupted(|| try_lock(&file))?;
        let mut list = Vec::new();
        match (&mut file).take(MOST_BYTES).read_to_end(&mut list) {
            // Windows does not permit reading a locked file.
            Err(_) if cfg!(windows) => list.clear(),
            read => drop(read?),
        }
        let outputs: Option<BTreeSet<String>> = serde_json::from_slice(&list).ok();
        let process = process_of(claim);
        if lives {
            return Ok(Some(OtherClaim { process, outputs }));
        }
        let folder = claim.parent().unwrap_or(Path::new("."));
        for output in outputs.iter().flatten().filter_map(|output| inside(folder, output)) {
            remove(&partial_path(&output, process));
        }
        remove(claim);
        Ok(None)
    }

    /// Checks for overlap with these files below a folder.
    ///
    /// # Errors
    /// If the other run writes one of them.
    fn check(&self, folder: &Path, wanted: &BTreeSet<String>) -> Result<()> {
        let meets = match &self.outputs {
            Some(outputs) => outputs.intersection(wanted).next(),
            None => wanted.first(),
        };
        match meets {
            None => Ok(()),
            Some(output) => Err(StageError::InUse { output: folder.join(output), process: self.process }),
        }
    }
}

/// Path of an output in a claim, if it is below the folder; others may write claims as well.
fn inside(folder: &Path, output: &str) -> Option<PathBuf> {
    let is_plain = Path::new(output).components().all(|step| matches!(step, Component::Normal(_)));
    let path = folder.join(output);
    // Links among its folders may lead elsewhere.
    let parent = path.parent()?.canonicalize().ok()?;
    (is_plain && parent.starts_with(folder.canonicalize().ok()?)).then_some(path)
}

/// Removes a file or folder of a dead run; ignores errors, because remains do no harm.
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

/// Repeats a call that a signal interrupts.
fn uninterrupted<T>(mut call: impl FnMut() -> io::Result<T>) -> io::Result<T> {
    loop {
        match call() {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            done => return done,
        }
    }
}

/// Locks a file; false if another process has it locked.
fn try_lock(file: &File) -> io::Result<bool> {
    match file.try_lock() {
        Ok(()) => Ok(true),
        Err(TryLockError::WouldBlock) => Ok(false),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Locks a gate until the longest wait since `started`; says what it waits for.
fn lock_within(file: &File, started: Instant, path: &Path) -> io::Result<()> {
    let mut is_told = false;
    loop {
        if uninterrupted(|| try_lock(file))? {
            return Ok(());
        }
        let waited = started.elapsed();
        if waited > LONGEST_WAIT {
            let waited_s = LONGEST_WAIT.as_secs();
            let problem = format!("another process has held {GATE} in it for {waited_s} s; end that process");
            return Err(io::Error::new(io::ErrorKind::TimedOut, problem));
        }
        if waited > SILENT_WAIT && !is_told {
            tracing::warn!("waiting for {}, which another process holds", path.display());
            is_told = true;
        }
        std::thread::sleep(ATTEMPT_EVERY);
    }
}

/// Whether a file ends with these bytes.
fn ends_with(path: &Path, bytes: &[u8]) -> bool {
    let read = || -> io::Result<Vec<u8>> {
        let mut file = own_file::no_link().read(true).open(path)?;
        file.seek(SeekFrom::End(-(bytes.len() as i64)))?;
        let mut end = vec![0; bytes.len()];
        file.read_exact(&mut end).map(|()| end)
    };
    read().is_ok_and(|end| end == bytes)
}

/// Serialises access to the claims of a folder.
struct FolderGate {
    file: File,
    folder: PathBuf,
}

impl FolderGate {
    fn enter(folder: &Path) -> io::Result<FolderGate> {
        let path = folder.join(GATE);
        let started = Instant::now();
        for attempt in 0..MOST_ATTEMPTS {
            let opened = own_file::no_link().read(true).append(true).create(true).open(&path);
            let mut file = opened.map_err(|error| own_file::explained(&path, error))?;
            lock_within(&file, started, &path)?;
            if file.metadata()?.len() == 0 {
                return Ok(FolderGate { file, folder: folder.to_owned() });
            }
            // Its holder gave it up. Either the gate is a new file by now, or the holder was killed
            // before it could remove this one. A mark written to this file shows which.
            let mark = format!("{}-{attempt}\n", std::process::id());
            file.write_all(mark.as_bytes())?;
            if ends_with(&path, mark.as_bytes()) {
                fs::remove_file(&path)?;
            }
        }
        Err(io::Error::other(format!("remove the file {GATE} in it")))
    }

    /// Leaves the gate and removes it if no claims remain.
    fn leave(mut self) {
        let is_last = claims(&self.folder).is_ok_and(|claims| claims.is_empty());
        if is_last && self.file.write_all(b"given up\n").is_ok() {
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
        let first = OutputLock::acquire(&outputs(folder, &["a.laz", "lines/a.txt"])).unwrap();
        let error = OutputLock::acquire(&outputs(folder, &["b.laz", "lines/a.txt"])).unwrap_err().to_string();
        let expected = format!(
            "{} is being written by another run (process {}); wait until it ends, or choose another folder with `output_dir`",
            folder.join("lines/a.txt").display(),
            std::process::id()
        );
        assert_eq!(error, expected);
        let other = OutputLock::acquire(&outputs(folder, &["b.laz"])).unwrap();
        drop(first);
        let again = OutputLock::acquire(&outputs(folder, &["a.laz"])).unwrap();
        drop((other, again));
        assert_eq!(names(folder), Vec::<String>::new(), "no files remain");
    }

    #[test]
    fn what_a_dead_run_left_is_swept_away() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        // A claim without a lock, of a process with an unfinished file and an unfinished archive.
        fs::write(folder.join(".wavex-77-0.run"), r#"["a.laz","archive"]"#).unwrap();
        fs::write(folder.join(".a.laz.77.partial"), "half").unwrap();
        fs::create_dir(folder.join(".archive.77.partial")).unwrap();
        fs::write(folder.join(".archive.77.partial/job.toml"), "half").unwrap();
        fs::write(folder.join(".b.laz.78.partial"), "of somebody else").unwrap();
        drop(OutputLock::acquire(&outputs(folder, &["a.laz"])).unwrap());
        assert_eq!(names(folder), [".b.laz.78.partial"]);
    }

    #[test]
    fn a_forged_claim_removes_nothing_elsewhere() {
        let place = tempfile::tempdir().unwrap();
        let (folder, other) = (place.path().join("out"), place.path().join("other"));
        fs::create_dir(&folder).unwrap();
        fs::create_dir(&other).unwrap();
        let victim = other.join(".a.laz.77.partial");
        fs::write(&victim, "of another run").unwrap();
        let outputs_of_claim = ["../other/a.laz", &other.join("a.laz").display().to_string(), "link/a.laz"];
        #[cfg(unix)]
        std::os::unix::fs::symlink(&other, folder.join("link")).unwrap();
        fs::write(folder.join(".wavex-77-0.run"), serde_json::to_vec(&outputs_of_claim).unwrap()).unwrap();
        drop(OutputLock::acquire(&outputs(&folder, &["b.laz"])).unwrap());
        assert!(victim.exists());
    }

    #[cfg(unix)]
    #[test]
    fn planted_links_and_pipes_are_not_followed() {
        use std::os::unix::fs::symlink;
        let place = tempfile::tempdir().unwrap();
        let (folder, victim) = (place.path().join("out"), place.path().join("victim"));
        fs::create_dir(&folder).unwrap();
        fs::write(&victim, "[]").unwrap();
        symlink(&victim, folder.join(".wavex-77-0.run")).unwrap();
        drop(OutputLock::acquire(&outputs(&folder, &["a.laz"])).unwrap());
        assert!(victim.exists());
        symlink(&victim, folder.join(GATE)).unwrap();
        let error = OutputLock::acquire(&outputs(&folder, &["a.laz"])).unwrap_err().to_string();
        assert!(
            error.ends_with("cannot lock the output folder: `.wavex.lock` is a link; remove it"),
            "{error}"
        );
        assert_eq!(fs::read(&victim).unwrap(), b"[]");
    }

    #[test]
    fn a_claim_that_cannot_be_read_counts_for_the_whole_folder() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(".wavex-77-0.run");
        fs::write(&path, "[").unwrap();
        let held = File::open(&path).unwrap();
        held.lock().unwrap();
        let error = OutputLock::acquire(&outputs(folder.path(), &["a.laz"])).unwrap_err().to_string();
        assert!(error.contains("a.laz is being written by another run (process 77); "), "{error}");
    }

    #[test]
    fn a_gate_that_was_given_up_and_not_removed_is_in_nobodys_way() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(GATE), "given up\n").unwrap();
        drop(OutputLock::acquire(&outputs(folder.path(), &["a.laz"])).unwrap());
        assert_eq!(names(folder.path()), Vec::<String>::new());
    }

    #[test]
    fn many_at_once_leave_nothing_behind() {
        let folder = tempfile::tempdir().unwrap();
        let folder = folder.path();
        let won: usize = std::thread::scope(|scope| {
            let take = || {
                let tries = (0..40).map(|_| OutputLock::acquire(&outputs(folder, &["a.laz"])));
                tries.filter(|taken| taken.is_ok()).count()
            };
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(take)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).sum()
        });
        assert!(won >= 1, "the first one gets the lock");
        assert_eq!(names(folder), Vec::<String>::new());
    }
}
