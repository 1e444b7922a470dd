//! `wavex report`: renders the report of a run as a page.

use std::path::{Path, PathBuf};

use super::place::{missing_report, only_report, page};
use super::{Failure, JobArgs, terminal};
use wavex_engine::job::Job;
use wavex_formats::RecordingFormat;
use wavex_formats::extensions::has_extension;
use wavex_pages::report::{read_report, write_page_of};
use wavex_run::archive::shown;
use wavex_run::run::{changes_since, folders};

/// Writes the page of a report; `place` is the report, its folder or its job.
pub(super) fn report(place: &Path, out: Option<&Path>, quiet: bool) -> Result<(), Failure> {
    let (path, job) = report_of(place)?;
    let out: PathBuf = out.map_or_else(|| path.with_extension("html"), Path::to_path_buf);
    let failed = |error: wavex_formats::Error| Failure::Run(error.to_string());
    let stored = read_report(&path).map_err(failed)?;
    let job = job.as_ref().map(|(job, folder)| (job, folder.as_path()));
    for warning in changes_since(&path, &stored, job) {
        tracing::warn!("{warning}");
    }
    write_page_of(&path, &stored, &out).map_err(failed)?;
    if quiet { Ok(()) } else { terminal::print(&format!("wrote {}\n", out.display())) }
}

/// The report of a report, a folder or a job; with the job and its folder.
fn report_of(place: &Path) -> Result<(PathBuf, Option<(Job, PathBuf)>), Failure> {
    match page(place).or_else(|| missing_report(place)) {
        Some(problem) => Err(Failure::Wrong(problem)),
        None if RecordingFormat::of(place).is_some() => Err(Failure::Wrong(format!(
            "{}: it is a recording or the points of a run; give the report of a run, its job or its folder",
            place.display()
        ))),
        None if place.is_dir() => Ok((only_report(place)?, None)),
        None if has_extension(place, "toml") => report_of_job(place),
        None => Ok((place.to_path_buf(), None)),
    }
}

/// The report of the last run of a job.
///
/// # Errors
/// If the job is invalid, writes no report, or was not run.
fn report_of_job(file: &Path) -> Result<(PathBuf, Option<(Job, PathBuf)>), Failure> {
    let args = JobArgs { job: file.to_path_buf(), set: Vec::new() };
    let job = args.read(None)?;
    let wrong = |problem: &str| Err(Failure::Wrong(format!("{}: {problem}", file.display())));
    if job.settings.report.is_empty() {
        return wrong("the job writes no report; set `report` in `[job]`, and run it");
    }
    let (_, output_dir) = folders(&job, &args.folder());
    let report = shown(&output_dir.join(job.settings.report.replace('*', &job.stem())));
    match report.is_file() {
        true => Ok((report, Some((job, args.folder())))),
        false => {
            wrong(&format!("the job has no report of a run; run it with `wavex run {}`", file.display()))
        }
    }
}
