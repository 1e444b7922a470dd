//! `wavex init`: writes a starter job, generic or for a recording.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use super::recording::Recording;
use super::{Failure, print};
use wavex_engine::job::{example_job, job_schema_text};
use wavex_formats::extensions::beside;
use wavex_stages::registry::STAGES;

/// Schema for editors, written to the folder of the job.
const SCHEMA: &str = "job.schema.json";
/// Extensions of trajectories, in order of preference.
const TRAJECTORIES: [&str; 5] = ["pof", "sbet", "out", "sol", "trj"];

/// Writes a new job file and its schema, or prints the job.
pub(super) fn init(file: Option<&Path>, from: Option<&Path>, quiet: bool) -> Result<(), Failure> {
    let (text, remark) = match from {
        Some(recording) => (of_recording(recording, file)?, String::new()),
        None => (
            example_job(STAGES),
            "the job reads RECORDING.las: edit `type` and `path` of the first stage, or use `wavex init --from RECORDING`\n"
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

/// Creates a file; fails if it exists.
pub(super) fn write_new(file: &Path, text: &str) -> Result<(), Failure> {
    let written = OpenOptions::new().write(true).create_new(true).open(file);
    written.and_then(|mut file| file.write_all(text.as_bytes())).map_err(|error| {
        let problem = match error.kind() {
            ErrorKind::AlreadyExists => {
                "the file already exists; choose another name or remove it".to_owned()
            }
            _ => format!("cannot write the job: {error}"),
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
                _ => line.replace(&format!("jobs/{}", recording.kind.file()), &name),
            };
        }
    }
    Ok(text)
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
