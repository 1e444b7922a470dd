//! Reads job files.

use std::io;
use std::path::{Path, PathBuf};

use crate::Failure;
use wavex_engine::job::{Include, Job, MAX_INCLUDES, Override, included, read_text};
use wavex_engine::missing;
use wavex_formats::extensions::has_extension;
use wavex_formats::{Error, RecordingFormat, folder_of_outputs, regular_file, unsupported};
use wavex_stages::registry::STAGES;

/// Reads a job with the files that it includes; `-` is standard input.
///
/// # Errors
/// If a file cannot be read or the job is invalid.
pub fn read(job: &Path, overrides: Vec<Override>) -> Result<Job, Failure> {
    let (name, text) = if is_stdin(job) {
        ("standard input".to_owned(), read_text(std::io::stdin()))
    } else if let Some(problem) = not_a_job(job) {
        return Err(Failure::Wrong(problem));
    } else {
        (job.display().to_string(), read_file(job))
    };
    let text = text.map_err(|error| {
        let remedy = if error.kind() == io::ErrorKind::NotFound { nearby(job) } else { String::new() };
        Failure::Wrong(format!("{name}: cannot read the job: {error}{remedy}"))
    })?;
    let folder = folder(job);
    let includes: Result<Vec<Include>, Failure> = included(&text)
        .iter()
        .take(MAX_INCLUDES + 1)
        .map(|included| read_include(&folder, included))
        .collect();
    Ok(Job::parse_with(STAGES, &name, &text, &includes?, &overrides)?)
}

/// Error for a recording, a folder or another file that is given as a job, with the next step.
fn not_a_job(path: &Path) -> Option<String> {
    if has_extension(path, "toml") && !path.is_dir() {
        return None;
    }
    let name = path.display();
    if path.is_dir() {
        let remedy = match jobs_in(path).as_slice() {
            [] => "a job is a file that ends in .toml: `wavex init RECORDING JOB.toml` writes one".to_owned(),
            [job, ..] => format!("give a job in it, such as {}", path.join(job).display()),
        };
        let outputs = folder_of_outputs(path).map_or(String::new(), |folder| {
            format!("; to see the outputs of a run, use `wavex view {}`", folder.display())
        });
        return Some(format!("{name}: it is a folder, not a job; {remedy}{outputs}"));
    }
    if RecordingFormat::of(path).is_some() {
        let job = path.with_extension("toml");
        let job = Path::new(job.file_name().unwrap_or_default()).display();
        return Some(format!(
            "{name}: it is a recording, not a job; write its job with `wavex init --from {name} {job}`, and run that: \
             `wavex run {job}`"
        ));
    }
    if has_extension(path, "json") {
        return Some(format!(
            "{name}: it is JSON, but a job is TOML: `wavex init RECORDING JOB.toml` writes one; `wavex report {name}` renders the \
             report of a run"
        ));
    }
    unsupported(path).map(|error| error.to_string())
}

/// Names of the jobs in a folder, sorted.
fn jobs_in(folder: &Path) -> Vec<String> {
    let entries = folder.read_dir().into_iter().flatten().flatten();
    let mut names: Vec<String> = entries
        .filter(|entry| has_extension(&entry.path(), "toml"))
        .filter_map(|entry| entry.file_name().into_string().ok())
        .collect();
    names.sort();
    names
}

/// Remedy for a job that does not exist.
fn nearby(job: &Path) -> String {
    let remedy = missing::remedy(job, |path| has_extension(path, "toml"));
    let remedy = remedy
        .unwrap_or_else(|| "check the path, or write a job with `wavex init RECORDING JOB.toml`".to_owned());
    format!("; {remedy}")
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
