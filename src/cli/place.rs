//! Paths given to commands that cannot use them: what to give instead.

use std::path::{Path, PathBuf};

use super::Failure;
use wavex_engine::missing::missing;
use wavex_formats::extensions::has_extension;
use wavex_formats::{RecordingFormat, folder_of_outputs, is_only_points, is_report, unsupported};
use wavex_line::keys::listed;

/// Refuses a recording that does not exist, and the points of a run.
///
/// Readers refuse what is no recording for other reasons.
pub(super) fn check_recording(path: &Path) -> Result<(), Failure> {
    let is_recording = |path: &Path| RecordingFormat::of(path).is_some();
    let problem = match unsupported(path) {
        Some(error) => Some(error.to_string()),
        None => missing(path, is_recording).or_else(|| points_of_run(path)),
    };
    problem.map_or(Ok(()), |problem| Err(Failure::Wrong(problem)))
}

/// Refuses what `wavex view` cannot show: a path that does not exist, and pages.
pub(super) fn check_viewable(path: &Path) -> Result<(), Failure> {
    let is_viewable = |path: &Path| {
        RecordingFormat::of(path).is_some() || has_extension(path, "toml") || is_report(path) || path.is_dir()
    };
    let is_other = unsupported(path).is_some() && !has_extension(path, "toml");
    let problem = page(path).or_else(|| missing(path, is_viewable).filter(|_| !is_other));
    problem.map_or(Ok(()), |problem| Err(Failure::Wrong(problem)))
}

/// The answer to a report that does not exist: those in its folder, which are named by their jobs.
pub(super) fn missing_report(path: &Path) -> Option<String> {
    let folder = folder_of(path);
    let in_folder = |name: &String| path.with_file_name(name).display().to_string();
    let reports: Vec<String> = reports_in(folder).iter().map(in_folder).collect();
    let is_missing = is_report(path) && matches!(path.try_exists(), Ok(false));
    (is_missing && !reports.is_empty()).then(|| {
        format!(
            "{}: no such report; reports are named by the job; did you mean {}?",
            path.display(),
            listed(&reports, "or")
        )
    })
}

fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// The answer to the page of a run or of a recording.
pub(super) fn page(path: &Path) -> Option<String> {
    let is_page = has_extension(path, "html") || has_extension(path, "htm");
    let report = Some(path.with_extension("json")).filter(|report| is_report(report) && report.is_file());
    let folder = || folder_of(path);
    let report = match report {
        Some(report) => format!(", or give {}, the report of its run", report.display()),
        None if !reports_in(folder()).is_empty() => {
            format!(", or give {}, the folder of its run", folder().display())
        }
        None => String::new(),
    };
    is_page.then(|| format!("{}: it is a page; open it in a browser{report}", path.display()))
}

/// Why points have no waveforms, and what to open instead: the run in their folder if there is one.
pub(super) fn instead_of_points(points: &Path) -> String {
    let instead = points_of_run(points);
    instead.unwrap_or_else(|| {
        let remedy = "view the folder of the run that wrote them, its job or its recording";
        format!("{}: points without waveforms; {remedy}", points.display())
    })
}

/// The answer to points without waveforms in the folder of a run.
fn points_of_run(points: &Path) -> Option<String> {
    let folder = points.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let reports = reports_in(folder);
    let in_folder = |name: &String| points.with_file_name(name).display().to_string();
    let run = match reports.as_slice() {
        [] => return None,
        [_] => format!("`wavex view {}` shows the run in this folder with its waveforms", folder.display()),
        _ => format!(
            "`wavex view` shows a run in this folder with its waveforms; give its report: {}",
            listed(&reports.iter().map(in_folder).collect::<Vec<_>>(), "or")
        ),
    };
    is_only_points(points).then(|| format!("{}: points without waveforms; {run}", points.display()))
}

/// The report in a folder.
///
/// # Errors
/// If the folder has no report, or several.
pub(super) fn only_report(folder: &Path) -> Result<PathBuf, Failure> {
    let names = reports_in(folder);
    let problem = match (names.as_slice(), folder_of_outputs(folder)) {
        ([only], _) => return Ok(folder.join(only)),
        ([], Some(outputs)) => {
            format!("no report of a run in this folder; give {}, which has one", outputs.display())
        }
        ([], None) => "no report of a run in this folder; give the report or the job of a run".to_owned(),
        _ => format!(
            "several reports in this folder: {}; give the report or the job of a run",
            listed(&names, "and")
        ),
    };
    Err(Failure::Run(format!("{}: {problem}", folder.display())))
}

/// Names of the reports in a folder, sorted.
fn reports_in(folder: &Path) -> Vec<String> {
    let entries = folder.read_dir().into_iter().flatten().flatten();
    let reports = entries.filter(|entry| is_report(&entry.path()));
    let mut names: Vec<String> =
        reports.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}
