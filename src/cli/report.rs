//! `wavex report`: renders the report of a run as a page.

use std::path::{Path, PathBuf};

use super::{Failure, terminal};
use crate::report::write_page_of;

/// Writes the page of a report; `place` is the report or its folder.
pub(super) fn report(place: &Path, out: Option<&Path>, quiet: bool) -> Result<(), Failure> {
    let path = if place.is_dir() { place.join("report.json") } else { place.to_path_buf() };
    let out: PathBuf = out.map_or_else(|| path.with_extension("html"), Path::to_path_buf);
    write_page_of(&path, &out).map_err(|error| Failure::Run(error.to_string()))?;
    if quiet { Ok(()) } else { terminal::print(&format!("wrote {}\n", out.display())) }
}
