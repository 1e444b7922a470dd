//! Output files that get their final name only when complete.

use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard};

use super::own_file;
use crate::system::Unpoisoned as _;
use wavex_formats::{Error, Result};

/// A file being written under a temporary name; removed if dropped before [`OutputFile::finish`].
#[derive(Debug)]
pub struct OutputFile {
    writer: BufWriter<File>,
    partial: TempFile,
}

/// A complete file under a temporary name; removed if dropped before [`FinishedFile::publish`].
#[derive(Debug)]
pub struct FinishedFile {
    partial: TempFile,
    /// Files to remove before this one gets its final name.
    stale: Vec<PathBuf>,
    /// Whether the content is on the disk; the name then gets there as well.
    is_synced: bool,
}

/// A file under a temporary name; removed when dropped unless renamed.
#[derive(Debug)]
struct TempFile {
    temporary: PathBuf,
    path: PathBuf,
    renamed: bool,
}

/// Temporary files of this process, for an immediate exit.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    // Each change is one insertion or removal, so a panic elsewhere cannot leave the set
    // inconsistent.
    UNFINISHED.lock().unpoisoned()
}

/// Removes all temporary files of this process before an immediate exit.
pub fn remove_unfinished_files() {
    for path in unfinished().iter() {
        // Errors are ignored, as on drop.
        let _ = fs::remove_file(path);
    }
}

/// Temporary path of an output, in the same folder.
pub fn partial_path(path: &Path, process: u32) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{name}.{process}.partial"))
}

impl OutputFile {
    /// Creates the temporary file of an output; creates its folder if missing.
    pub fn create(path: &Path) -> Result<OutputFile> {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
        fs::create_dir_all(folder).map_err(Error::io(folder, "create the folder"))?;
        if path.file_name().is_none() {
            return Err(Error::unusable(path, "no file name", "give the output a name such as `out/*.laz`"));
        }
        if path.is_dir() {
            let remedy = "choose another name or remove the folder";
            return Err(Error::unusable(path, "a folder with the name of this output exists", remedy));
        }
        let temporary = partial_path(path, std::process::id());
        let file = own_file::create_anew(&temporary).map_err(Error::io(path, "create"))?;
        let partial = TempFile::new(temporary, path);
        Ok(OutputFile { writer: BufWriter::with_capacity(1 << 18, file), partial })
    }

    /// Final path.
    pub fn path(&self) -> &Path {
        &self.partial.path
    }

    /// Flushes and syncs the file to disk; it is then complete.
    pub fn finish(self) -> Result<FinishedFile> {
        let path = self.partial.path.clone();
        let file = self.writer.into_inner().map_err(|e| Error::io(&path, "write")(e.into_error()))?;
        file.sync_all().map_err(Error::io(&path, "write"))?;
        Ok(FinishedFile { partial: self.partial, stale: Vec::new(), is_synced: true })
    }

    /// Flushes the file; it is complete unless the machine stops.
    ///
    /// For many small files that are compared before they are used again.
    pub fn finish_without_sync(self) -> Result<FinishedFile> {
        let path = self.partial.path.clone();
        self.writer.into_inner().map_err(|e| Error::io(&path, "write")(e.into_error()))?;
        Ok(FinishedFile { partial: self.partial, stale: Vec::new(), is_synced: false })
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

impl FinishedFile {
    /// Final path.
    pub fn path(&self) -> &Path {
        &self.partial.path
    }

    /// Opens the file for reading under its current name.
    pub fn open(&self) -> io::Result<File> {
        File::open(&self.partial.temporary)
    }

    /// Names companion files of the earlier output, such as its index.
    ///
    /// They are removed before this file gets its final name, so they never appear next to it.
    pub fn replacing(self, stale: impl IntoIterator<Item = PathBuf>) -> FinishedFile {
        FinishedFile { stale: stale.into_iter().collect(), ..self }
    }

    /// Removes the stale companion files; [`FinishedFile::publish`] does this as well.
    ///
    /// If several files are published together, call this for all of them first: a file removed for
    /// one may be an output of another.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn remove_stale(&mut self) -> Result<()> {
        for path in std::mem::take(&mut self.stale) {
            match fs::remove_file(&path) {
                // A folder of this name is not a companion file.
                Err(error) if error.kind() != ErrorKind::NotFound && !path.is_dir() => {
                    return Err(Error::io(&path, "remove a companion file of the earlier output")(error));
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// Gives the file its final name; replaces an earlier file.
    ///
    /// # Errors
    /// If the system refuses.
    pub fn publish(mut self) -> Result<PathBuf> {
        self.remove_stale()?;
        let partial = &mut self.partial;
        fs::rename(&partial.temporary, &partial.path)
            .map_err(Error::io(&partial.path, "rename to the final name"))?;
        partial.renamed = true;
        let folder = partial.path.parent().unwrap_or(Path::new("."));
        if self.is_synced {
            own_file::sync_folder(folder).map_err(Error::io(folder, "write the folder"))?;
        }
        Ok(partial.path.clone())
    }
}

impl TempFile {
    fn new(path_now: PathBuf, path: &Path) -> TempFile {
        unfinished().insert(path_now.clone());
        TempFile { temporary: path_now, path: path.to_path_buf(), renamed: false }
    }
}

impl Drop for TempFile {
    fn drop(&mut self) {
        unfinished().remove(&self.temporary);
        if !self.renamed {
            // A temporary file that cannot be removed is recognisable by its name.
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

    #[cfg(unix)]
    #[test]
    fn a_planted_link_is_replaced_and_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let (path, victim) = (folder.path().join("a.laz"), folder.path().join("victim"));
        fs::write(&victim, "dear").unwrap();
        std::os::unix::fs::symlink(&victim, partial_path(&path, std::process::id())).unwrap();
        let mut file = OutputFile::create(&path).unwrap();
        file.write_all(b"abc").unwrap();
        file.finish().unwrap().publish().unwrap();
        assert_eq!(
            (fs::read(&path).unwrap(), fs::read(&victim).unwrap()),
            (b"abc".to_vec(), b"dear".to_vec())
        );
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
            whole.replacing([index.clone(), folder.path().join("never.lax"), folder.path().to_path_buf()])
        };
        fs::write(&index, b"old").unwrap();
        // A failing rename shows what was done before it.
        let begun = whole();
        fs::create_dir_all(path.join("in the way")).unwrap();
        assert!(
            begun.publish().unwrap_err().to_string().contains("a.laz: cannot rename to the final name: ")
        );
        assert_eq!(names(folder.path()), ["a.laz"]);
        fs::remove_dir_all(&path).unwrap();

        fs::write(&index, b"old").unwrap();
        let mut file = whole();
        file.remove_stale().unwrap();
        assert!(!index.exists());
        fs::write(&index, b"new").unwrap();
        file.publish().unwrap();
        assert_eq!(names(folder.path()), ["a.lax", "a.laz"]);
    }

    #[test]
    fn folders_with_the_name_of_an_output_are_errors() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("points.laz");
        fs::create_dir(&path).unwrap();
        let error = OutputFile::create(&path).unwrap_err().to_string();
        let expected =
            "a folder with the name of this output exists; choose another name or remove the folder";
        assert_eq!(error, format!("{}: {expected}", path.display()));
        assert_eq!(names(folder.path()), ["points.laz"]);
    }

    #[test]
    fn a_folder_that_cannot_be_made_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let blocker = folder.path().join("file");
        fs::write(&blocker, b"").unwrap();
        let error = OutputFile::create(&blocker.join("out.laz")).unwrap_err().to_string();
        assert!(error.contains("cannot create the folder"), "{error}");
    }
}
