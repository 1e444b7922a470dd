//! Puts the library's index into another folder than the data.
//!
//! The library writes its index next to the path it is given, and the interface has no argument for
//! another location. A symbolic link to the data in a writable folder provides one. Each file gets
//! its own folder, so an index is never used for another file of the same name. The folder
//! stays for later runs.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::{Error, Result};

/// Returns the link to `data`, creating it if necessary.
///
/// It is in its own folder below `folder`.
pub(super) fn link(data: &Path, folder: &Path) -> Result<PathBuf> {
    let whole = fs::canonicalize(data).map_err(Error::io(data, "open"))?;
    let size = fs::metadata(&whole).map_err(Error::io(data, "open"))?.len();
    let name = data.file_name().unwrap_or_default();
    let own = folder.join(format!("{}-{:016x}", name.to_string_lossy(), fingerprint(&whole, size)));
    fs::create_dir_all(&own).map_err(Error::io(&own, "create the folder for the index"))?;
    let link = own.join(name);
    match symlink(&whole, &link) {
        Ok(()) => Ok(link),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => match fs::read_link(&link) {
            Ok(to) if to == whole => Ok(link),
            _ => Err(Error::unusable(&link, "it blocks the link to the data", "remove it")),
        },
        Err(error) => Err(Error::io(&link, "link to the data")(error)),
    }
}

/// Returns the 64-bit FNV-1a hash of path and size.
///
/// It is identical on every machine and in every version.
fn fingerprint(path: &Path, size: u64) -> u64 {
    let text = path.to_string_lossy();
    let bytes = text.bytes().chain(size.to_le_bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(unix)]
fn symlink(to: &Path, at: &Path) -> io::Result<()> {
    std::os::unix::fs::symlink(to, at)
}

#[cfg(windows)]
fn symlink(to: &Path, at: &Path) -> io::Result<()> {
    std::os::windows::fs::symlink_file(to, at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_one_name_have_links_of_their_own_which_stay() {
        let folder = tempfile::tempdir().unwrap();
        let index = folder.path().join("index");
        let data = ["a", "b"].map(|name| {
            let data = folder.path().join(name).join("130621_101500.sdf");
            fs::create_dir_all(data.parent().unwrap()).unwrap();
            fs::write(&data, name).unwrap();
            data
        });
        let links = data.each_ref().map(|data| link(data, &index).unwrap());
        assert_ne!(links[0], links[1]);
        assert_eq!(links.each_ref().map(|link| fs::read_to_string(link).unwrap()), ["a", "b"]);
        assert_eq!(link(&data[0], &index).unwrap(), links[0], "the second time, the first link is taken");
    }

    #[test]
    fn what_is_in_the_way_is_not_removed() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("a.sdf");
        fs::write(&data, "a").unwrap();
        let link_path = link(&data, folder.path()).unwrap();
        fs::remove_file(&link_path).unwrap();
        fs::write(&link_path, "mine").unwrap();
        let error = link(&data, folder.path()).unwrap_err().to_string();
        let expected = format!("{}: it blocks the link to the data; remove it", link_path.display());
        assert_eq!(error, expected);
        assert_eq!(fs::read_to_string(link_path).unwrap(), "mine");
    }

    #[test]
    fn the_fingerprint_is_that_of_fnv() {
        // FNV-1a of eight zero bytes, from the definition.
        assert_eq!(fingerprint(Path::new(""), 0), 0xa8c7_f832_281a_39c5);
        assert_ne!(fingerprint(Path::new("a"), 1), fingerprint(Path::new("a"), 2));
    }
}
