//! Reads job files.

use std::io;
use std::path::{Path, PathBuf};

use crate::Failure;
use wavex_engine::job::{Include, Job, MAX_INCLUDES, Override, included, read_text};
use wavex_formats::{Error, regular_file};
use wavex_stages::registry::STAGES;

/// Reads a job with the files that it includes; `-` is standard input.
///
/// # Errors
/// If a file cannot be read or the job is invalid.
pub fn read(job: &Path, overrides: Vec<Override>) -> Result<Job, Failure> {
    let (name, text) = if is_stdin(job) {
        ("standard input".to_owned(), read_text(std::io::stdin()))
    } else {
        (job.display().to_string(), read_file(job))
    };
    let text = text.map_err(|error| Failure::Wrong(format!("{name}: cannot read the job: {error}")))?;
    let folder = folder(job);
    let includes: Result<Vec<Include>, Failure> = included(&text)
        .iter()
        .take(MAX_INCLUDES + 1)
        .map(|included| read_include(&folder, included))
        .collect();
    Ok(Job::parse_with(STAGES, &name, &text, &includes?, &overrides)?)
}

/// Folder at which relative paths of a job start.
pub fn folder(job: &Path) -> PathBuf {
    let folder = job.parent().filter(|folder| !is_stdin(job) && !folder.as_os_str().is_empty());
    folder.map_or(PathBuf::from("."), PathBuf::from)
}

/// Whether a job is read from standard input.
pub fn is_stdin(job: &Path) -> bool {
    job.as_os_str() == "-"
}

/// Reads a file that a job includes.
fn read_include(folder: &Path, included: &str) -> Result<Include, Failure> {
    // In the current folder the path stays as the job writes it, without a leading `./`.
    let path = if *folder == *"." { PathBuf::from(included) } else { folder.join(included) };
    let name = path.display().to_string();
    match read_file(&path) {
        Ok(text) => Ok(Include { name, text }),
        Err(error) => {
            let remedy = "check `include` in `[job]`";
            Err(Failure::Wrong(format!("{name}: cannot read the included file: {error}; {remedy}")))
        }
    }
}

/// Reads a job or an included file.
fn read_file(path: &Path) -> io::Result<String> {
    match regular_file(path) {
        Ok(file) => read_text(file),
        Err(Error::Io { source, .. }) => Err(source),
        Err(_) => Err(io::Error::other("it is a pipe or device; give a file, or - for standard input")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_paths_start_at_the_folder_of_the_job() {
        let folders = ["a/b.toml", "b.toml", "-"].map(|job| folder(Path::new(job)));
        assert_eq!(folders, ["a", ".", "."].map(PathBuf::from));
    }
}
