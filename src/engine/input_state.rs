//! Detects changes of an input while it is read.

use std::path::{Path, PathBuf};

use super::failure::{Cause, RunError};
use crate::stage::{StageError, Stamp};
use wavex_formats::Error;

/// States of an input and its companion files at the start of its run.
pub(super) struct InputState(Vec<(PathBuf, Option<Stamp>)>);

impl InputState {
    /// Takes the states; pipes and generated inputs have none.
    ///
    /// Does not list the folder, which may have many files.
    pub(super) fn of(input: &Path) -> InputState {
        let extension = input.extension().unwrap_or_default().to_ascii_lowercase();
        let companions = match extension.to_str() {
            Some("las" | "laz") => &["wdp", "WDP"][..],
            Some("pls") => &["wvs", "WVS"],
            _ => &[],
        };
        let companions = companions.iter().map(|extension| input.with_extension(extension));
        let files = [input.to_owned()].into_iter().chain(companions);
        InputState(files.map(|file| (file.clone(), Stamp::of(&file))).collect())
    }

    /// Checks that no file has changed since.
    ///
    /// # Errors
    /// The first changed file, and what happened to it.
    pub(super) fn check(&self) -> Result<(), Error> {
        let change = |(file, before): &(PathBuf, Option<Stamp>)| {
            Stamp::change(*before, Stamp::of(file)).map(|change| (file.clone(), change))
        };
        let Some((file, change)) = self.0.iter().find_map(change) else { return Ok(()) };
        let remedy = "run the job again once no other program writes the file";
        Err(Error::unusable(&file, format!("{change} while it was read"), remedy))
    }

    /// Replaces an error in one of the files by their change, if they have changed.
    ///
    /// A file that is still written looks cut off or damaged.
    pub(super) fn explain(&self, error: RunError) -> RunError {
        let is_here = |error: &Error| self.0.iter().any(|(file, _)| file == error.file());
        match (&error.cause, self.check()) {
            (Cause::Stage(StageError::Format(found)), Err(change)) if is_here(found) => {
                RunError { cause: Cause::Stage(change.into()), ..error }
            }
            _ => error,
        }
    }
}
