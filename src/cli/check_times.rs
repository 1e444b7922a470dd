//! Time spans of recordings and their trajectories for `wavex check`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use wavex_engine::engine::Input;
use wavex_engine::job::Job;
use wavex_formats::RecordingFormat;
use wavex_geodesy::time_axis::{Clock, TimeSpan, align};
use wavex_line::georef::corrections::CorrectionsFile;
use wavex_line::georef::{applied_corrections, trajectory_times};
use wavex_line::scan_line::ScanLine;

/// Time without trajectory that is not reported, s.
const TOLERANCE_S: f64 = 0.1;

/// First scan line of an input, `None` if unknown; or why it cannot be read.
pub(super) type FirstLine = Result<Option<ScanLine>, String>;

/// Lists recordings that their trajectory or its corrections do not cover, and unreadable files of both.
///
/// `firsts` are the first scan lines of the inputs. Reads the last record of each recording, and the first and the last
/// record of each trajectory. Missing files, and recordings without random access, are passed over.
pub(super) fn problems(job: &Job, inputs: &[Input], firsts: &[FirstLine], input_dir: &Path) -> Vec<String> {
    let geometry = &job.settings.geometry;
    let Some(pattern) = &geometry.trajectory else { return Vec::new() };
    let mut trajectories: BTreeMap<PathBuf, Option<TimeSpan>> = BTreeMap::new();
    let mut problems = Vec::new();
    let corrections =
        geometry.corrections.as_ref().map(|name| input_dir.join(name)).filter(|file| file.is_file());
    let corrections = corrections.and_then(|file| {
        let read = CorrectionsFile::read(&file).map_err(|error| problems.push(error.to_string()));
        read.ok().map(|corrections| (file, corrections))
    });
    for (input, first) in inputs.iter().zip(firsts) {
        let file = input_dir.join(pattern.replace('*', &input.stem));
        let trajectory = trajectories.entry(file.clone()).or_insert_with(|| {
            let times = file.is_file().then(|| trajectory_times(geometry, &file))?;
            times.map_err(|error| problems.push(error.to_string())).ok()
        });
        let recording = recording_times(job, &input.path, first);
        if let Some((file, corrections)) = &corrections {
            let problem = uncorrected(file, corrections, input, first, recording);
            problems.extend(problem.map(|problem| format!("{}: {problem}", input.path.display())));
        }
        let Some((trajectory, recording)) = trajectory.zip(recording) else { continue };
        problems.extend(
            uncovered(recording, trajectory).map(|problem| format!("{}: {problem}", input.path.display())),
        );
    }
    problems
}

/// Problem of a recording with its corrections.
fn uncorrected(
    file: &Path,
    corrections: &CorrectionsFile,
    input: &Input,
    first: &FirstLine,
    recording: Option<TimeSpan>,
) -> Option<String> {
    let line = first.as_ref().ok()?.as_ref()?;
    // Of a file with several parts only the first is known.
    if input.part.is_some() {
        return None;
    }
    let span_s = recording.map(|times| [times.first_s, times.last_s]);
    applied_corrections::problem(file, corrections, &input.stem, &line.input, span_s)
}

/// Time span of a recording as its reader gives the times; `None` if it is unknown.
fn recording_times(job: &Job, path: &Path, first: &FirstLine) -> Option<TimeSpan> {
    let reader = job.stages.first()?;
    let first_last_s = RecordingFormat::read_by(reader.spec.name)?.first_last_s?;
    // A window of time may begin anywhere in the recording.
    let has_window = reader.planned.resolved.get("time_s").is_some_and(|window| !window.is_null());
    if has_window || !path.is_file() {
        return None;
    }
    let [stored_first_s, stored_last_s] = first_last_s(path).ok()??;
    let line = first.as_ref().ok()?.as_ref()?;
    let first_s = line.emissions.first()?.gps_time_s;
    let clock = Clock::of(line.input.time_scale)?;
    let mut duration_s = stored_last_s - stored_first_s;
    if let Some(period_s) = clock.period_s().filter(|period_s| duration_s < -0.5 * period_s) {
        duration_s += period_s;
    }
    let last_s = first_s + duration_s;
    let times = TimeSpan { clock, first_s: first_s.min(last_s), last_s: first_s.max(last_s) };
    (times.first_s.is_finite() && times.last_s.is_finite()).then_some(times)
}

/// Describes the part of a recording that its trajectory does not cover.
fn uncovered(recording: TimeSpan, trajectory: TimeSpan) -> Option<String> {
    let alignment = match align(recording, trajectory) {
        Ok(alignment) => alignment,
        Err(problem) => return Some(problem.to_string()),
    };
    let first_s = alignment.on_trajectory(recording.first_s);
    let duration_s = recording.last_s - recording.first_s;
    let before_s = (trajectory.first_s - first_s).max(0.0);
    let after_s = (first_s + duration_s - trajectory.last_s).max(0.0);
    (before_s + after_s > TOLERANCE_S).then(|| {
        let covered = 1.0 - (before_s + after_s) / duration_s;
        format!(
            "the trajectory covers {:.0} % of the recording: the recording lasts from {recording}, the trajectory from \
             {trajectory}; shots without a position are rejected: use the trajectory of the whole flight",
            (100.0 * covered).clamp(0.0, 99.0)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uncovered_parts_are_described_with_both_spans() {
        let week = |first_s: f64, last_s: f64| TimeSpan { clock: Clock::Week, first_s, last_s };
        let trajectory = week(200_000.0, 200_100.0);
        assert_eq!(uncovered(week(200_000.0, 200_100.0), trajectory), None);
        assert_eq!(uncovered(week(199_999.95, 200_100.0), trajectory), None);
        let problem = uncovered(week(200_050.0, 200_150.0), trajectory).unwrap();
        assert!(problem.starts_with("the trajectory covers 50 % of the recording: "), "{problem}");
        assert!(problem.contains("(200050.0 to 200150.0 s of the week)"), "{problem}");
        assert!(problem.contains("(200000.0 to 200100.0 s of the week)"), "{problem}");
        let nothing = uncovered(week(300_000.0, 300_001.0), trajectory).unwrap();
        assert!(
            nothing.starts_with("the recording and the trajectory have no time in common: "),
            "{nothing}"
        );
        // Seconds of the day agree with any day of the trajectory.
        let of_day =
            TimeSpan { clock: Clock::Day, first_s: 200_010.0 - 172_800.0, last_s: 200_020.0 - 172_800.0 };
        assert_eq!(uncovered(of_day, trajectory), None);
    }
}
