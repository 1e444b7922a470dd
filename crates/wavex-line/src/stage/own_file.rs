//! Opens files of wavex in folders in which others may write.
//!
//! A link planted under the name of such a file would lead to a file elsewhere.

use std::fs::{self, File, OpenOptions};
use std::io::{self, ErrorKind};
use std::path::Path;

/// Options that refuse a link as the last step of a path.
pub fn no_link() -> OpenOptions {
    #[cfg_attr(not(unix), expect(unused_mut, reason = "only Unix has links to follow"))]
    let mut options = OpenOptions::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::OpenOptionsExt;
        // A pipe without a reader would otherwise block.
        options.custom_flags(libc::O_NOFOLLOW | libc::O_NONBLOCK);
    }
    options
}

/// Creates a file of a name that only this process uses; what has the name is removed.
///
/// # Errors
/// If the system refuses.
pub(crate) fn create_anew(path: &Path) -> io::Result<File> {
    let create = || OpenOptions::new().write(true).create_new(true).open(path);
    match create() {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => {
            // Of a dead process with the same number, or planted.
            fs::remove_file(path)?;
            create()
        }
        created => created,
    }
}

/// Opens a file for writing from its start, but does not follow a link.
///
/// # Errors
/// If the system refuses, or the path is a link.
pub fn truncate(path: &Path) -> io::Result<File> {
    no_link().write(true).create(true).truncate(true).open(path).map_err(|error| explained(path, error))
}

/// Replaces the system's words for a link.
pub(crate) fn explained(path: &Path, error: io::Error) -> io::Error {
    let is_link = fs::symlink_metadata(path).is_ok_and(|about| about.is_symlink());
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    if is_link { io::Error::other(format!("`{name}` is a link; remove it")) } else { error }
}

/// Makes the names in a folder durable.
///
/// Only Unix needs it; a file system that cannot is left alone.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    #[cfg(unix)]
    {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        match File::open(folder)?.sync_all() {
            Err(error) if matches!(error.kind(), ErrorKind::Unsupported | ErrorKind::InvalidInput) => {}
            synced => synced?,
        }
    }
    let _ = folder;
    Ok(())
}
