//! Inputs of a job for `wavex check`: number, size, shots, problems.

use std::path::Path;

use super::check_times;
use super::estimate::{self, Amount};
use super::terminal::size;
use wavex_engine::engine::{self, Input};
use wavex_engine::job::Job;
use wavex_formats::{CompanionIndex, RecordingFormat};
use wavex_line::georef::declared;
use wavex_line::stage::{Context, Plan, RunContext};
use wavex_run::archive::missing_files;

/// Usual number of points per shot, at least and at most.
const POINTS_PER_SHOT: [u64; 2] = [1, 3];

/// Describes the inputs of a job and lists their problems; `input_dir` is absolute.
///
/// Reads headers only.
pub(super) fn inspect(job: &Job, input_dir: &Path) -> (String, Vec<String>) {
    let (inputs, errors) = engine::find_inputs(job, input_dir);
    let mut problems: Vec<String> = errors.iter().map(ToString::to_string).collect();
    problems.extend(missing_files(job, &inputs, input_dir));
    problems.extend(check_times::problems(job, &inputs, input_dir));
    problems.extend(crs_problems(job, &inputs, input_dir));
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
    let format = RecordingFormat::read_by(reader.spec.name);
    let shot_count = format.and_then(|format| format.shot_count);
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
                Some(counted) => format!("at most {shots}, the number of {counted}"),
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

/// Problems of `crs_of_input` with the first scan lines of the recordings.
fn crs_problems(job: &Job, inputs: &[Input], input_dir: &Path) -> Vec<String> {
    let Some(reader) = job.stages.first() else { return Vec::new() };
    let Plan::Source(source) = &reader.planned.plan else { return Vec::new() };
    let named = reader.planned.resolved.get("crs_of_input").and_then(serde_json::Value::as_str);
    let Some(word) = named else { return Vec::new() };
    if declared::is_file(word) {
        let is_there = input_dir.join(word).is_file();
        match declared::wkt(word, input_dir) {
            Ok(_) => {}
            Err(error) if is_there => return vec![error.to_string()],
            // Reported as missing.
            Err(_) => return Vec::new(),
        }
    }
    let problem = |input: &Input| {
        let run = RunContext { input_dir: input_dir.to_owned(), ..RunContext::alone(&input.path) };
        let begun = source.make_for_inspection(&run, false);
        let read = begun.and_then(|mut source| source.next(&mut Context::of_run()).map(drop));
        // Other problems are found by their own checks.
        let error =
            read.err().map(|error| error.to_string()).filter(|error| error.contains("crs_of_input"))?;
        Some(format!("{}: {error}", input.path.display()))
    };
    inputs.iter().filter(|input| input.path.is_file()).filter_map(problem).collect()
}

/// Error for inputs that must be there.
pub(super) fn required(job: &Job, problems: &[String]) -> String {
    let what = if problems.len() == 1 { "1 problem" } else { &format!("{} problems", problems.len()) };
    format!("{}: {what} with the inputs\n  {}", job.name, problems.join("\n  "))
}
