//! `wavex report`: renders the report of a run as a page.

use std::path::{Path, PathBuf};

use super::{Failure, terminal};
use wavex_line::keys::listed;
use wavex_pages::report::write_page_of;

/// Writes the page of a report; `place` is the report or its folder.
pub(super) fn report(place: &Path, out: Option<&Path>, quiet: bool) -> Result<(), Failure> {
    let path = if place.is_dir() { only_report(place)? } else { place.to_path_buf() };
    let out: PathBuf = out.map_or_else(|| path.with_extension("html"), Path::to_path_buf);
    write_page_of(&path, &out).map_err(|error| Failure::Run(error.to_string()))?;
    if quiet { Ok(()) } else { terminal::print(&format!("wrote {}\n", out.display())) }
}

/// The report in a folder.
///
/// # Errors
/// If there is none, or several.
pub(super) fn only_report(folder: &Path) -> Result<PathBuf, Failure> {
    let is_report = |name: &String| name == "report.json" || name.ends_with("_report.json");
    let entries = folder.read_dir().into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let mut names: Vec<String> = names.filter(is_report).collect();
    names.sort();
    let problem = match names.as_slice() {
        [only] => return Ok(folder.join(only)),
        [] => "no report of a run in this folder".to_owned(),
        _ => format!("several reports in this folder: {}", listed(&names, "and")),
    };
    Err(Failure::Run(format!("{}: {problem}; give the report or the job of a run", folder.display())))
}
