//! Paths that do not exist: what was meant.

use std::path::{Component, Path, PathBuf};

use wavex_line::stage::nearest_of;

/// Number of entries of a folder that are searched.
const MOST_ENTRIES: usize = 10_000;

/// Remedy for a path that does not exist, if nothing similar is in its folder.
pub(crate) const CHECK_THE_PATH: &str = "check the path";

/// Error for a path that does not exist, with the next step; `None` for other paths and patterns.
///
/// `is_wanted` selects the paths in its folder that may have been meant.
pub fn missing(path: &Path, is_wanted: impl Fn(&Path) -> bool) -> Option<String> {
    let is_pattern = path.to_string_lossy().contains(['*', '?', '[']);
    let is_missing = path.as_os_str() != "-" && !is_pattern && matches!(path.try_exists(), Ok(false));
    is_missing.then(|| {
        let remedy = remedy(path, is_wanted).unwrap_or_else(|| CHECK_THE_PATH.to_owned());
        format!("{}: no such file or folder; {remedy}", path.display())
    })
}

/// Next step for a path that does not exist; `None` if nothing similar is in its folder.
pub fn remedy(path: &Path, is_wanted: impl Fn(&Path) -> bool) -> Option<String> {
    match similar(path, is_wanted) {
        Some(meant) => Some(format!("did you mean {}?", meant.display())),
        None => {
            is_of_windows(path).then(|| "it is a path of Windows: write a path of this system".to_owned())
        }
    }
}

/// The path in the same folder with the same stem and another extension, or else with the most similar name.
fn similar(path: &Path, is_wanted: impl Fn(&Path) -> bool) -> Option<PathBuf> {
    let with_slashes = PathBuf::from(path.to_string_lossy().replace('\\', "/"));
    if with_slashes.exists() {
        return Some(with_slashes);
    }
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let entries = folder.read_dir().ok()?.flatten().take(MOST_ENTRIES);
    let wanted = entries.filter(|entry| is_wanted(&entry.path()));
    let mut names: Vec<String> = wanted.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.sort();
    let has_stem = |name: &&String| {
        let stem = Path::new(name.as_str()).file_stem();
        stem == path.file_stem() || stem == path.file_name()
    };
    let name = path.file_name()?.to_string_lossy();
    let same_stem = names.iter().find(has_stem).map(String::as_str);
    let meant = same_stem.or_else(|| nearest_of(&name, names.iter().map(String::as_str)))?;
    Some(path.with_file_name(meant))
}

/// Whether a path has a drive or backslashes, on another system than Windows.
fn is_of_windows(path: &Path) -> bool {
    let is_foreign = |part: &str| {
        let is_drive = matches!(part.as_bytes(), [drive, b':'] if drive.is_ascii_alphabetic());
        is_drive || part.contains('\\')
    };
    let is_part =
        |part: Component| matches!(part, Component::Normal(part) if is_foreign(&part.to_string_lossy()));
    !cfg!(windows) && path.components().any(is_part)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_missing_path_gets_what_was_meant() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        fs::create_dir(path("lines")).unwrap();
        for name in ["flight7.las", "flight8.pls", "flight7.txt", "lines/a.pls"] {
            fs::write(path(name), "").unwrap();
        }
        let is_wanted = |path: &Path| path.is_dir() || path.extension().is_some_and(|own| own != "txt");
        let of = |name: &str| missing(&path(name), is_wanted);
        for (name, meant) in [
            ("flight7", "flight7.las"),
            ("flight7.pls", "flight7.las"),
            ("fligth8.pls", "flight8.pls"),
            ("line", "lines"),
        ] {
            let expected = format!(
                "{}: no such file or folder; did you mean {}?",
                path(name).display(),
                path(meant).display()
            );
            assert_eq!(of(name), Some(expected));
        }
        let expected = format!("{}: no such file or folder; check the path", path("x.las").display());
        assert_eq!(of("x.las"), Some(expected));
        for name in ["lines", "flight7.txt", "*.sdf"] {
            assert_eq!(of(name), None);
        }
        assert_eq!(missing(Path::new("-"), is_wanted), None);
    }

    #[cfg(not(windows))]
    #[test]
    fn paths_of_windows_are_named() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("lines")).unwrap();
        fs::write(folder.path().join("lines/a.pls"), "").unwrap();
        let of = |name: &str| remedy(&folder.path().join(name), |_| true);
        for name in ["D:\\new\\a.pls", "D:/new/a.pls", "new\\a.pls"] {
            assert_eq!(of(name).as_deref(), Some("it is a path of Windows: write a path of this system"));
        }
        let meant = folder.path().join("lines/a.pls");
        assert_eq!(of("lines\\a.pls"), Some(format!("did you mean {}?", meant.display())));
        assert_eq!(of("new/a.pls"), None);
    }
}
