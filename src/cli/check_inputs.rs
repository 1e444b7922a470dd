//! Inputs of a job for `wavex check`: number, size, shots, problems.

use std::path::Path;

use super::check_times::{self, FirstLine};
use super::estimate::{self, Amount};
use super::terminal::size;
use wavex_engine::engine::{self, Input};
use wavex_engine::job::Job;
use wavex_formats::{CompanionIndex, RecordingFormat};
use wavex_line::georef::{GeometryKeys, Loader, declared};
use wavex_line::scan_line::ScanLine;
use wavex_line::stage::check_whole_steps;
use wavex_run::archive::missing_files;

/// Usual number of points per shot, at least and at most.
const POINTS_PER_SHOT: [u64; 2] = [1, 3];

/// Stages that refuse samples with fractions of a digitiser step.
const WHOLE_STEPS: [&str; 2] = ["calibrate", "decompose"];

/// Describes the inputs of a job and lists their problems; `input_dir` is absolute.
///
/// Reads headers only, and first scan lines if the job has keys of coordinates or no header counts the shots.
pub(super) fn inspect(job: &Job, input_dir: &Path) -> (String, Vec<String>) {
    let (mut inputs, errors) = engine::find_inputs(job, input_dir);
    // Parts of a file follow each other.
    inputs.dedup_by(|later, first| later.path == first.path);
    let mut problems: Vec<String> = errors.iter().map(ToString::to_string).collect();
    let format = job.stages.first().and_then(|reader| RecordingFormat::read_by(reader.spec.name));
    let shot_count = format.and_then(|format| format.shot_count);
    let has_keys = job.settings.geometry != GeometryKeys::default() || crs_of_input(job).is_some();
    let first = |input: &Input| -> FirstLine {
        engine::first_line(job, &input.path, input_dir).map_err(|error| error.to_string())
    };
    let is_read = has_keys || shot_count.is_none();
    let firsts: Vec<FirstLine> = inputs.iter().filter(|_| is_read).map(first).collect();
    let known: Vec<&ScanLine> = firsts.iter().flatten().flatten().collect();
    let mut needed = job.clone();
    if !known.is_empty() && known.iter().all(|line| line.input.frame.is_georeferenced()) {
        // A run does not read the trajectory.
        (needed.settings.geometry.trajectory, needed.settings.geometry.trajectory_accuracy) = (None, None);
    }
    problems.extend(missing_files(&needed, &inputs, input_dir));
    problems.extend(check_times::problems(&needed, &inputs, &firsts, input_dir));
    problems.extend(crs_problems(job, &inputs, &firsts, input_dir));
    problems.extend(sample_problems(job, &inputs, &firsts));
    let files: Vec<&Path> =
        inputs.iter().map(|input| input.path.as_path()).filter(|path| path.is_file()).collect();
    let Some(reader) = job.stages.first().filter(|_| !files.is_empty()) else {
        return (String::new(), problems);
    };
    let length = |path: &Path| path.metadata().map_or(0, |about| about.len());
    let mut index = CompanionIndex::default();
    let with_companions = |path: &&Path| {
        length(path) + index.of(path).unwrap_or_default().iter().map(|path| length(path)).sum::<u64>()
    };
    let bytes: u64 = files.iter().map(with_companions).sum();
    let mut text = format!("  files:  {}, {}\n", files.len(), size(bytes));
    let inputs = files.len();
    if shot_count.is_none() {
        problems
            .extend(firsts.iter().filter_map(|first| first.as_ref().err()).filter(is_not_of_crs).cloned());
    }
    let (mut total, n_problems) = (Some(0), problems.len());
    for path in files {
        match shot_count.map(|count| count(path)) {
            None => total = None,
            Some(Ok(shots)) => total = total.map(|total: u64| total.saturating_add(shots)),
            Some(Err(error)) => problems.push(error.to_string()),
        }
    }
    if problems.len() - n_problems == inputs {
        return (text, problems);
    }
    let cores = match job.settings.threads {
        0 => engine::cores().unwrap_or(1),
        threads => threads,
    };
    let seconds = estimate::seconds(job, Amount { inputs, bytes, shots: total }, cores);
    text += &match seconds {
        Some(seconds) => {
            let s = if cores == 1 { "" } else { "s" };
            format!("  time:   {} on {cores} core{s}\n", estimate::words(seconds))
        }
        None => "  time:   not estimated: the shots are longer than those measured\n".to_owned(),
    };
    text += &match total {
        Some(shots) => {
            let points: Vec<String> =
                POINTS_PER_SHOT.iter().map(|each| each.saturating_mul(shots).to_string()).collect();
            let shots = match format.and_then(|format| format.counted) {
                Some(counted) => format!("about {shots}, the number of {counted}"),
                None => shots.to_string(),
            };
            format!("  shots:  {shots}; about {} points\n", points.join(" to "))
        }
        None => format!(
            "  shots:  unknown, and so are the points: {} counts shots only by reading the data\n",
            reader.id
        ),
    };
    (text, problems)
}

/// Stages that need samples in whole digitiser steps, for recordings that have others.
fn sample_problems(job: &Job, inputs: &[Input], firsts: &[FirstLine]) -> Vec<String> {
    let refused = |(input, first): (&Input, &FirstLine)| {
        let line = first.as_ref().ok()?.as_ref()?;
        let names = job.stages.iter().map(|stage| stage.spec.name);
        let error = names
            .filter(|name| WHOLE_STEPS.contains(name))
            .find_map(|name| check_whole_steps(line, name).err())?;
        Some(format!("{}: {error}", input.path.display()))
    };
    inputs.iter().zip(firsts).filter_map(refused).collect()
}

/// Problems of coordinates with the first scan lines of the recordings, as a run finds them.
fn crs_problems(job: &Job, inputs: &[Input], firsts: &[FirstLine], input_dir: &Path) -> Vec<String> {
    if let Some(word) = crs_of_input(job).filter(|word| declared::is_file(word)) {
        let is_there = input_dir.join(word).is_file();
        match declared::wkt(word, input_dir) {
            Ok(_) => {}
            Err(error) if is_there => return vec![error.to_string()],
            // Reported as missing.
            Err(_) => return Vec::new(),
        }
    }
    // Without the files of the trajectory; unreadable files have their own messages.
    let keys = GeometryKeys { trajectory: None, corrections: None, ..job.settings.geometry.clone() };
    let geometry = Loader::new(&keys, input_dir).and_then(|mut loader| loader.load("", || false)).ok();
    let has_coordinates = job.stages.iter().any(|stage| stage.spec.name == "georeference");
    let problems = |first: &FirstLine| -> Vec<String> {
        let info = match first {
            Ok(Some(line)) => engine::info_of(line),
            Ok(None) => return Vec::new(),
            // Other problems are found by their own checks.
            Err(error) => {
                return Some(error).filter(|error| !is_not_of_crs(error)).cloned().into_iter().collect();
            }
        };
        let mut problems: Vec<String> = job.settings.geometry.unused_in(info.frame).into_iter().collect();
        // The trajectory gives beams other coordinates.
        let is_judged =
            has_coordinates && (info.frame.is_georeferenced() || job.settings.geometry.trajectory.is_none());
        if let Some(geometry) = geometry.as_ref().filter(|_| is_judged) {
            problems.extend(geometry.judge(&info).unwrap_or_else(|error| vec![error.to_string()]));
        }
        problems
    };
    let named = |(input, first): (&Input, &FirstLine)| {
        problems(first)
            .into_iter()
            .map(|problem| format!("{}: {problem}", input.path.display()))
            .collect::<Vec<_>>()
    };
    inputs.iter().zip(firsts).flat_map(named).collect()
}

/// The key `crs_of_input` of the reader.
fn crs_of_input(job: &Job) -> Option<&str> {
    job.stages.first()?.planned.resolved.get("crs_of_input")?.as_str()
}

/// Whether an error of a reader is about something else than its key `crs_of_input`.
fn is_not_of_crs(error: &&String) -> bool {
    !error.contains("crs_of_input")
}

/// Error for inputs that must be there.
pub(super) fn required(job: &Job, problems: &[String]) -> String {
    let what = if problems.len() == 1 { "1 problem" } else { &format!("{} problems", problems.len()) };
    format!("{}: {what} with the inputs\n  {}", job.name, problems.join("\n  "))
}
