//! Lexical path operations.

use std::ffi::OsStr;
use std::path::{Component, Path, PathBuf};

/// Removes `.` and `..` components: `a/./b/../c` becomes `a/c`.
pub fn plain(path: &Path) -> PathBuf {
    let mut steps = PathBuf::new();
    for step in path.components() {
        match step {
            Component::CurDir => {}
            Component::ParentDir if matches!(steps.components().next_back(), Some(Component::Normal(_))) => {
                steps.pop();
            }
            step => steps.push(step),
        }
    }
    steps
}

/// Shortens a path for display: `jobs/../out` becomes `out`.
///
/// Keeps the path if a symbolic link makes the short form a different place.
pub fn shown(path: &Path) -> PathBuf {
    let plain = match plain(path) {
        empty if empty.as_os_str().is_empty() => PathBuf::from("."),
        plain => plain,
    };
    match (plain.canonicalize(), path.canonicalize()) {
        (Ok(short), Ok(long)) if short == long => plain,
        _ => path.to_owned(),
    }
}

/// Deepest common parent folder; `None` without folders or without a common one.
pub fn common<'p>(folders: impl IntoIterator<Item = &'p Path>) -> Option<PathBuf> {
    let mut folders = folders.into_iter();
    let mut common = folders.next()?.to_path_buf();
    for folder in folders {
        while !folder.starts_with(&common) {
            if !common.pop() {
                return None;
            }
        }
    }
    Some(common)
}

/// Path from one absolute path to another, with `/` as separator; `.` if equal.
///
/// `None` on another drive, or if a component is not valid Unicode.
pub fn relative(from: &Path, to: &Path) -> Option<String> {
    let shared = common([from, to])?;
    let up = from.strip_prefix(&shared).ok()?.components().map(|_| Some(".."));
    let down = to.strip_prefix(&shared).ok()?.components().map(|step| OsStr::to_str(step.as_os_str()));
    let steps: Vec<&str> = up.chain(down).collect::<Option<_>>()?;
    Some(if steps.is_empty() { ".".to_owned() } else { steps.join("/") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_back_are_taken() {
        let cases = [("/a/./b/../c", "/a/c"), ("/a/b/", "/a/b"), ("../a", "../a"), ("/a/../../b", "/../b")];
        for (path, expected) in cases {
            assert_eq!(plain(Path::new(path)), Path::new(expected), "{path}");
        }
    }

    #[test]
    fn relative_paths_start_at_the_given_folder() {
        let way = |from: &str, to: &str| relative(Path::new(from), Path::new(to));
        assert_eq!(way("/data/in", "/data/in/a.pls").as_deref(), Some("a.pls"));
        assert_eq!(way("/data/out/archive", "/data/in").as_deref(), Some("../../in"));
        assert_eq!(way("/data", "/data").as_deref(), Some("."));
        assert_eq!(way("/data/a b", "/data/*.laz").as_deref(), Some("../*.laz"));
    }

    #[test]
    fn the_common_folder_is_the_deepest() {
        let of = |folders: &[&str]| common(folders.iter().map(Path::new));
        assert_eq!(of(&["/a/b/c", "/a/b/d", "/a/b"]), Some("/a/b".into()));
        assert_eq!(of(&["/a/bc", "/a/b"]), Some("/a".into()));
        assert_eq!(of(&[]), None);
    }
}
