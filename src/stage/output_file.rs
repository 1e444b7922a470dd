//! Files that appear under their final name only when they are whole.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

use crate::formats::{Error, Result};

/// A file being written beside its final name. Dropped before [`OutputFile::finish`], it is removed.
#[derive(Debug)]
pub struct OutputFile {
    writer: BufWriter<File>,
    partial: Partial,
}

/// A file that is complete and waits for its final name. Dropped before [`WholeFile::publish`], it is removed.
#[derive(Debug)]
pub struct WholeFile {
    partial: Partial,
    /// Files that must be gone before this one has its final name.
    stale: Vec<PathBuf>,
}

/// A file under a temporary name, removed when dropped unless it was renamed.
#[derive(Debug)]
struct Partial {
    temporary: PathBuf,
    path: PathBuf,
    renamed: bool,
}

/// The temporary files of this process, for an end without time for anything else.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    // Each change is one insertion or removal: a panic elsewhere cannot leave the set half done.
    UNFINISHED.lock().unwrap_or_else(|poisoned| poisoned.into_inner())
}

/// Removes every file that has no final name yet: for a process that ends at once.
pub fn remove_unfinished_files() {
    for path in unfinished().iter() {
        // As where one is dropped.
        let _ = fs::remove_file(path);
    }
}

/// Where a process writes what is to become `path`: beside it.
pub(crate) fn partial_path(path: &Path, process: u32) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{name}.{process}.partial"))
}

impl OutputFile {
    /// Begins the file that is to become `path`; its folder is made where it is missing.
    pub fn create(path: &Path) -> Result<OutputFile> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::create_dir_all(folder).map_err(Error::io(folder, "make the folder"))?;
        if path.file_name().is_none() {
            return Err(Error::unusable(path, "no file name", "give the output a name, as in `out/*.laz`"));
        }
        if path.is_dir() {
            let remedy = "choose another name, or remove the folder";
            return Err(Error::unusable(path, "a folder has the name of this output", remedy));
        }
        let temporary = partial_path(path, std::process::id());
        let file = File::create(&temporary).map_err(Error::io(path, "create"))?;
        let partial = Partial::new(temporary, path);
        Ok(OutputFile { writer: BufWriter::with_capacity(1 << 18, file), partial })
    }

    /// The final name.
    pub fn path(&self) -> &Path {
        &self.partial.path
    }

    /// Writes what is buffered down to the disk: from here on the file is whole.
    pub fn finish(self) -> Result<WholeFile> {
        let path = self.partial.path.clone();
        let file = self.writer.into_inner().map_err(|e| Error::io(&path, "write")(e.into_error()))?;
        file.sync_all().map_err(Error::io(&path, "write"))?;
        Ok(WholeFile { partial: self.partial, stale: Vec::new() })
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

impl Seek for OutputFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.writer.seek(to)
    }
}

impl WholeFile {
    /// The final name.
    pub fn path(&self) -> &Path {
        &self.partial.path
    }

    /// Opens the file for reading under the name that it has now.
    pub fn open(&self) -> io::Result<File> {
        File::open(&self.partial.temporary)
    }

    /// Names files that belong to what stood there before, such as its index: they are removed first, so that no moment
    /// shows them beside this one.
    pub fn instead_of(self, stale: impl IntoIterator<Item = PathBuf>) -> WholeFile {
        WholeFile { stale: stale.into_iter().collect(), ..self }
    }

    /// Removes these files, where there are any; [`WholeFile::publish`] does so, too. Where several files get their names
    /// together, all make way first: what one removes, another may bring anew.
    ///
    /// # Errors
    /// The system refuses.
    pub fn make_way(&mut self) -> Result<()> {
        for path in std::mem::take(&mut self.stale) {
            match fs::remove_file(&path) {
                // No program takes a folder for what belongs to a file.
                Err(error) if error.kind() != ErrorKind::NotFound && !path.is_dir() => {
                    return Err(Error::io(&path, "remove what belongs to the earlier output")(error));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Gives the file its final name, in place of what stood there before.
    ///
    /// # Errors
    /// The system refuses.
    pub fn publish(mut self) -> Result<PathBuf> {
        self.make_way()?;
        let partial = &mut self.partial;
        fs::rename(&partial.temporary, &partial.path)
            .map_err(Error::io(&partial.path, "give the final name to"))?;
        partial.renamed = true;
        Ok(partial.path.clone())
    }
}

impl Partial {
    fn new(path_now: PathBuf, path: &Path) -> Partial {
        unfinished().insert(path_now.clone());
        Partial { temporary: path_now, path: path.to_path_buf(), renamed: false }
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        unfinished().remove(&self.temporary);
        if !self.renamed {
            // Nothing can be done about a temporary file that resists: its name says what it is.
            let _ = fs::remove_file(&self.temporary);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let mut names: Vec<String> = fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_file_has_its_name_only_when_it_is_whole() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("new/points.laz");
        let mut file = OutputFile::create(&path).unwrap();
        file.write_all(b"abc").unwrap();
        assert!(!path.exists());
        let whole = file.finish().unwrap();
        assert!(!path.exists());
        whole.publish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"abc");
        assert_eq!(names(path.parent().unwrap()), ["points.laz"]);
    }

    #[test]
    fn an_abandoned_file_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let mut file = OutputFile::create(&folder.path().join("a.txt")).unwrap();
        file.write_all(b"abc").unwrap();
        drop(file);
        drop(OutputFile::create(&folder.path().join("b.txt")).unwrap().finish().unwrap());
        assert_eq!(names(folder.path()), Vec::<String>::new());
    }

    #[test]
    fn what_belongs_to_the_earlier_file_goes_before_the_new_one_comes() {
        let folder = tempfile::tempdir().unwrap();
        let (path, index) = (folder.path().join("a.laz"), folder.path().join("a.lax"));
        let whole = || {
            let whole = OutputFile::create(&path).unwrap().finish().unwrap();
            whole.instead_of([index.clone(), folder.path().join("never.lax"), folder.path().to_path_buf()])
        };
        fs::write(&index, b"old").unwrap();
        // A new name that cannot be given shows what was done before it.
        let begun = whole();
        fs::create_dir_all(path.join("in the way")).unwrap();
        assert!(begun.publish().unwrap_err().to_string().contains("a.laz: cannot give the final name to: "));
        assert_eq!(names(folder.path()), ["a.laz"]);
        fs::remove_dir_all(&path).unwrap();

        fs::write(&index, b"old").unwrap();
        let mut file = whole();
        file.make_way().unwrap();
        assert!(!index.exists());
        fs::write(&index, b"new").unwrap();
        file.publish().unwrap();
        assert_eq!(names(folder.path()), ["a.lax", "a.laz"]);
    }

    #[test]
    fn a_folder_of_the_same_name_is_told_before_anything_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.laz");
        fs::create_dir(&path).unwrap();
        let error = OutputFile::create(&path).unwrap_err().to_string();
        let expected = "a folder has the name of this output; choose another name, or remove the folder";
        assert_eq!(error, format!("{}: {expected}", path.display()));
        assert_eq!(names(folder.path()), ["points.laz"]);
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let blocker = folder.path().join("file");
        fs::write(&blocker, b"").unwrap();
        let error = OutputFile::create(&blocker.join("out.laz")).unwrap_err().to_string();
        assert!(error.contains("cannot make the folder"), "{error}");
    }
}
