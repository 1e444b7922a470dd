//! `wavex init`: a commented job to start from.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::Path;

use super::{Failure, print};
use crate::job::example_job;
use crate::stage::StageSpec;

/// Writes the job into a file that does not exist yet, or prints it.
pub(super) fn init(stages: &[&'static StageSpec], file: Option<&Path>) -> Result<(), Failure> {
    let text = example_job(stages);
    let Some(file) = file else {
        return print(&text);
    };
    let written = OpenOptions::new().write(true).create_new(true).open(file);
    written.and_then(|mut file| file.write_all(text.as_bytes())).map_err(|error| {
        let problem = match error.kind() {
            ErrorKind::AlreadyExists => {
                "the file exists already; choose another name, or remove it".to_owned()
            }
            _ => format!("cannot write the job: {error}"),
        };
        Failure::Wrong(format!("{}: {problem}", file.display()))
    })
}
