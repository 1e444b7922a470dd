//! `wavex report`: renders the report of a run as a page.

use std::io::{Read, Write};
use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{Failure, terminal};
use crate::engine::RunReport;
use crate::stage::OutputFile;
use wavex_formats::Error;

mod overview;
mod page;
mod pictures;
mod plot;
mod style;
mod waveforms;

/// Maximum size of a report, bytes.
const MOST_REPORT_BYTES: u64 = 200_000_000;

/// Writes the page of a report; `place` is the report or its folder.
pub(super) fn report(place: &Path, out: Option<&Path>, quiet: bool) -> Result<(), Failure> {
    let failed = |error: &dyn std::fmt::Display| Failure::Run(error.to_string());
    let path = if place.is_dir() { place.join("report.json") } else { place.to_path_buf() };
    let report = read(&path).map_err(|error| failed(&error))?;
    let out: PathBuf = out.map_or_else(|| path.with_extension("html"), Path::to_path_buf);
    let page = page::page(&report)
        .map_err(|problem| Error::unusable(&path, problem, "run the job again to make a new report"));
    let page = page.map_err(|error| failed(&error))?;
    let file = OutputFile::create(&out).and_then(|file| write(&page, file));
    file.map_err(|error| failed(&error))?;
    if quiet { Ok(()) } else { terminal::print(&format!("wrote {}\n", out.display())) }
}

fn read(path: &Path) -> Result<Value, Error> {
    let file = std::fs::File::open(path).map_err(Error::io(path, "open the report"))?;
    let mut text = String::new();
    file.take(MOST_REPORT_BYTES).read_to_string(&mut text).map_err(Error::io(path, "read the report"))?;
    let remedy = "give the report.json of a run or the folder that contains it";
    let report: Value = serde_json::from_str(&text)
        .map_err(|error| Error::unusable(path, format!("not a report of a run: {error}"), remedy))?;
    match report["inputs"].is_array() {
        true => Ok(report),
        false => Err(Error::unusable(path, "not a report of a run: no `inputs`", remedy)),
    }
}

/// Writes the page of a run that has just ended.
pub(super) fn write_page(report: &RunReport, file: OutputFile) -> Result<(), Error> {
    let defect = |problem: String| Error::unusable(file.path(), problem, "please report this bug in wavex");
    let value = serde_json::to_value(report).map_err(|error| defect(error.to_string()))?;
    let page = page::page(&value).map_err(defect)?;
    write(&page, file)
}

fn write(page: &str, mut file: OutputFile) -> Result<(), Error> {
    let written = file.write_all(page.as_bytes());
    written.map_err(|error| Error::io(file.path(), "write the page")(error))?;
    file.finish()?.publish().map(|_| ())
}
