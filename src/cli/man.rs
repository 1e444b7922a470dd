//! `wavex man`: writes the manual pages.

use std::path::Path;

use clap::CommandFactory;

use super::commands::Cli;
use super::{Failure, print};

/// Writes one page per command into a folder, and one of all commands.
pub(super) fn man(folder: &Path, quiet: bool) -> Result<(), Failure> {
    let written =
        std::fs::create_dir_all(folder).and_then(|()| clap_mangen::generate_to(Cli::command(), folder));
    written.map_err(|error| {
        Failure::Run(format!(
            "{}: cannot write the manual pages: {error}; choose another folder",
            folder.display()
        ))
    })?;
    if quiet { Ok(()) } else { print(&format!("manual pages are in {}\n", folder.display())) }
}
