//! `wavex init`: writes a starter job, generic or for a recording.

use std::fs::{self, OpenOptions};
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::recording::Recording;
use super::{Failure, print};
use wavex_engine::job::{example_job, job_schema_text};
use wavex_engine::missing;
use wavex_formats::extensions::{beside, has_extension};
use wavex_formats::{RecordingFormat, TRAJECTORIES, unsupported};
use wavex_stages::registry::STAGES;

/// Schema for editors, written to the folder of the job.
const SCHEMA: &str = "job.schema.json";

/// Writes a new job file and its schema, or prints the job.
///
/// `files` are a recording, a job, or both.
pub(super) fn init(files: &[PathBuf], from: Option<&Path>, quiet: bool) -> Result<(), Failure> {
    let (from, file) = roles(files, from)?;
    file.map_or(Ok(()), check_job_name)?;
    let (text, remark) = match from {
        Some(recording) => (of_recording(recording, file)?, String::new()),
        None => (
            example_job(STAGES),
            "the job reads RECORDING.las: edit `type` and `path` of the first stage, or use `wavex init RECORDING JOB.toml`\n"
                .to_owned(),
        ),
    };
    let Some(file) = file else {
        return print(&text);
    };
    write_new(file, &text)?;
    let schema = file.with_file_name(SCHEMA);
    let kept = match schema.exists() {
        true => format!("kept the existing {}\n", schema.display()),
        false => {
            write_new(&schema, &job_schema_text(STAGES))?;
            format!("wrote {}\n", schema.display())
        }
    };
    if quiet { Ok(()) } else { print(&format!("wrote {}\n{kept}{remark}", file.display())) }
}

/// Which of the files is the recording, and which the job.
///
/// # Errors
/// Two recordings or two jobs: a job is not written under the name of a recording.
fn roles<'p>(
    files: &'p [PathBuf],
    from: Option<&'p Path>,
) -> Result<(Option<&'p Path>, Option<&'p Path>), Failure> {
    if let (Some(job), [recording]) = (from.filter(|from| has_extension(from, "toml")), files) {
        let (job, recording) = (job.display(), recording.display());
        let problem = format!("--from takes the recording: wavex init --from {recording} {job}");
        return Err(Failure::Wrong(format!("{job}: {problem}")));
    }
    let (mut recording, mut job) = (from, None);
    // Of two names without that of data, the one that is not that of a job is meant as the recording.
    let names_no_data = files.len() == 2 && !files.iter().any(|file| is_data(file));
    for file in files.iter().map(PathBuf::as_path) {
        let is_place_of_job = file.is_dir() && recording.is_some();
        let is_meant = names_no_data && recording.is_none() && !has_extension(file, "toml");
        let role = if (is_data(file) || is_meant) && !is_place_of_job { &mut recording } else { &mut job };
        if let Some(other) = role.replace(file) {
            let problem = match is_data(file) {
                true => {
                    "both are recordings; give one, and a name for the job that ends in .toml. A job reads several \
                         recordings by a pattern in `path`"
                }
                false => "both are jobs; give a recording and one job",
            };
            return Err(Failure::Wrong(format!("{}, {}: {problem}", other.display(), file.display())));
        }
    }
    Ok((recording, job))
}

/// Refuses the name of a job that other commands would not take for one.
fn check_job_name(job: &Path) -> Result<(), Failure> {
    if has_extension(job, "toml") {
        return Ok(());
    }
    let name = job.display();
    let recording =
        missing::remedy(job, |path| RecordingFormat::of(path).is_some()).filter(|_| !job.exists());
    let remedy = match recording {
        Some(remedy) => format!("for the recording, {remedy}"),
        None if job.is_dir() => format!("write {}", job.join("job.toml").display()),
        None => format!("write {name}.toml"),
    };
    Err(Failure::Wrong(format!("{name}: the name of a job ends in .toml; {remedy}")))
}

/// Whether a name is the name of data, not of a job.
fn is_data(file: &Path) -> bool {
    !has_extension(file, "toml") && (RecordingFormat::of(file).is_some() || unsupported(file).is_some())
}

/// Creates a file and its folder; fails if the file exists or has the name of a recording.
pub(super) fn write_new(file: &Path, text: &str) -> Result<(), Failure> {
    if is_data(file) {
        let problem = "a job is not written under the name of a recording or a folder; end its name in .toml";
        return Err(Failure::Wrong(format!("{}: {problem}", file.display())));
    }
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    let created = folder.map_or(Ok(()), fs::create_dir_all);
    let written = created.and_then(|()| OpenOptions::new().write(true).create_new(true).open(file));
    written.and_then(|mut file| file.write_all(text.as_bytes())).map_err(|error| {
        let problem = match error.kind() {
            ErrorKind::AlreadyExists => "the file already exists; choose another name".to_owned(),
            _ => format!("cannot write the job: {error}; choose another folder"),
        };
        Failure::Wrong(format!("{}: {problem}", file.display()))
    })
}

/// Fills the matching template of `jobs/` with this recording.
pub(super) fn of_recording(path: &Path, job: Option<&Path>) -> Result<String, Failure> {
    let recording = Recording::recognise(path)?;
    let folder = job.and_then(Path::parent).filter(|folder| !folder.as_os_str().is_empty());
    let quoted = |path: &Path| toml::Value::String(seen_from(folder, path).display().to_string()).to_string();
    let name = job.and_then(Path::file_name).map_or("FILE".into(), |name| name.to_string_lossy());
    let trajectory =
        TRAJECTORIES.iter().find_map(|extension| beside(path, extension).filter(|file| file.is_file()));
    let mut text = String::new();
    for paragraph in recording.kind.template().split_inclusive("\n\n") {
        let is_reader = paragraph.contains("\ntype = \"read_");
        if is_reader && !paragraph.contains(&format!("\ntype = \"{}\"", recording.reader)) {
            let path = quoted(path);
            text += &format!("# Recording.\n[[stage]]\ntype = \"{}\"\npath = {path}\n\n", recording.reader);
            continue;
        }
        for line in paragraph.split_inclusive('\n') {
            text += &match line.split(" = ").next().unwrap_or_default() {
                "path" if is_reader => format!("path = {}\n", quoted(path)),
                "output_dir" => "output_dir = \"out\"\n".to_owned(),
                "trajectory" => match &trajectory {
                    Some(trajectory) => format!("trajectory = {}\n", quoted(trajectory)),
                    None => format!("# No trajectory was found next to the recording:\n# {line}"),
                },
                // Coordinates in a CRS require a trajectory.
                "crs" if trajectory.is_none() => format!("# {line}"),
                _ if line.starts_with("#:schema ") => {
                    format!("#:schema {SCHEMA}\n\n# For {}: {}.\n", path.display(), recording.facts)
                }
                _ => match line.strip_prefix("#   wavex ") {
                    Some(command) => command_line(command, recording.kind.file(), &name),
                    None => line.to_owned(),
                },
            };
        }
    }
    Ok(text)
}

/// A comment line with a command and its description, for the job of this name.
fn command_line(line: &str, template: &str, name: &str) -> String {
    let Some((command, description)) = line.split_once("  ") else { return format!("#   wavex {line}") };
    let command = command.replace(&format!("jobs/{template}"), name);
    // The longest command of the templates.
    let width = "check ".len() + name.chars().count().max("NAME".len() + 1);
    format!("#   wavex {command:width$}    {}", description.trim_start())
}

/// Path as a job in this folder names it.
///
/// Unchanged if the job is in the current folder, else absolute.
fn seen_from(folder: Option<&Path>, path: &Path) -> PathBuf {
    match folder {
        None => path.to_owned(),
        Some(_) => path.canonicalize().unwrap_or_else(|_| path.to_owned()),
    }
}
