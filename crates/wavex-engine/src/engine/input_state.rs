//! Detects changes of an input while it is read.

use std::path::{Path, PathBuf};

use super::failure::{Cause, RunError};
use wavex_formats::Error;
use wavex_formats::format::companion_names;
use wavex_line::stage::{StageError, Stamp};

/// States of an input and its companion files at the start of its run.
pub(super) struct InputState(Vec<(PathBuf, Option<Stamp>)>);

impl InputState {
    /// Takes the states; pipes and generated inputs have none.
    ///
    /// A missing companion file has a state, too, because it may be created.
    pub(super) fn of(input: &Path) -> InputState {
        let files = [input.to_owned()].into_iter().chain(companion_names(input));
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

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn changes_of_companion_files_are_noticed_whatever_the_case_of_their_extension() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (recording, companion) in
            [("a.pls", "a.Wvs"), ("b.LAS", "b.wdp"), ("c.laz", "c.wdz"), ("d.plz", "d.wvz")]
        {
            [recording, companion].iter().for_each(|name| fs::write(path(name), "before").unwrap());
            let state = InputState::of(&path(recording));
            assert!(state.check().is_ok());
            fs::write(path(companion), "and after").unwrap();
            assert_eq!(state.check().unwrap_err().file(), path(companion));
        }
    }
}
