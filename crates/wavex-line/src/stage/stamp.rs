//! State of a file, to detect changes.

use std::fs::{self, Metadata};
use std::path::Path;
use std::time::SystemTime;

/// Size, modification time and identity of a regular file.
///
/// A change within the resolution of the file system's clock that keeps the size goes unnoticed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stamp {
    bytes: u64,
    modified: Option<SystemTime>,
    /// Device and number of the file, if the system has them.
    id: Option<(u64, u64)>,
}

impl Stamp {
    /// State of `path`; `None` if it is no regular file.
    pub fn of(path: &Path) -> Option<Stamp> {
        let about = fs::metadata(path).ok().filter(Metadata::is_file)?;
        Some(Stamp { bytes: about.len(), modified: about.modified().ok(), id: id(&about) })
    }

    /// Describes what happened to a file between two states; `None` if nothing did.
    pub fn change(before: Option<Stamp>, after: Option<Stamp>) -> Option<String> {
        let (before, after) = match (before, after) {
            (None, None) => return None,
            (Some(_), None) => return Some("it was removed".to_owned()),
            (None, Some(_)) => return Some("it was created".to_owned()),
            (Some(before), Some(after)) if before == after => return None,
            (Some(before), Some(after)) => (before, after),
        };
        let (was, is) = (before.bytes, after.bytes);
        Some(match was.cmp(&is) {
            _ if before.id != after.id => "it was replaced by another file".to_owned(),
            std::cmp::Ordering::Less => format!("it grew from {was} to {is} bytes"),
            std::cmp::Ordering::Greater => format!("it shrank from {was} to {is} bytes"),
            std::cmp::Ordering::Equal => "it was modified".to_owned(),
        })
    }
}

#[cfg(unix)]
fn id(about: &Metadata) -> Option<(u64, u64)> {
    use std::os::unix::fs::MetadataExt;
    Some((about.dev(), about.ino()))
}

#[cfg(not(unix))]
fn id(_: &Metadata) -> Option<(u64, u64)> {
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_have_a_name() {
        let folder = tempfile::tempdir().unwrap();
        let (path, other) = (folder.path().join("a"), folder.path().join("b"));
        assert_eq!(Stamp::of(&path), None);
        assert_eq!(Stamp::of(folder.path()), None, "a folder has no state");
        fs::write(&path, "1234").unwrap();
        let made = Stamp::of(&path);
        assert_eq!(Stamp::change(None, made).unwrap(), "it was created");
        assert_eq!(Stamp::change(made, made), None);
        fs::write(&path, "123456").unwrap();
        assert_eq!(Stamp::change(made, Stamp::of(&path)).unwrap(), "it grew from 4 to 6 bytes");
        fs::write(&path, "12").unwrap();
        assert_eq!(Stamp::change(made, Stamp::of(&path)).unwrap(), "it shrank from 4 to 2 bytes");
        let file = fs::OpenOptions::new().write(true).open(&path).unwrap();
        file.set_len(4).unwrap();
        file.set_modified(SystemTime::UNIX_EPOCH).unwrap();
        assert_eq!(Stamp::change(made, Stamp::of(&path)).unwrap(), "it was modified");
        fs::write(&other, "abcd").unwrap();
        fs::rename(&other, &path).unwrap();
        if cfg!(unix) {
            assert_eq!(Stamp::change(made, Stamp::of(&path)).unwrap(), "it was replaced by another file");
        }
        fs::remove_file(&path).unwrap();
        assert_eq!(Stamp::change(made, Stamp::of(&path)).unwrap(), "it was removed");
    }
}
