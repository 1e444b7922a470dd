//! Inputs of a job for `wavex check`: number, size, pulses, problems.

use std::path::Path;

use super::check_times;
use super::estimate::{self, Amount};
use super::terminal::size;
use wavex_engine::engine;
use wavex_engine::job::Job;
use wavex_formats::{CompanionIndex, RecordingFormat};
use wavex_run::archive::missing_files;

/// Usual number of points per pulse, at least and at most.
const POINTS_PER_PULSE: [u64; 2] = [1, 3];

/// Describes the inputs of a job and lists their problems; `input_dir` is absolute.
///
/// Reads headers only.
pub(super) fn inspect(job: &Job, input_dir: &Path) -> (String, Vec<String>) {
    let (inputs, errors) = engine::find_inputs(job, input_dir);
    let mut problems: Vec<String> = errors.iter().map(ToString::to_string).collect();
    problems.extend(missing_files(job, &inputs, input_dir));
    problems.extend(check_times::problems(job, &inputs, input_dir));
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
    let pulse_count = RecordingFormat::read_by(reader.spec.name).and_then(|format| format.pulse_count);
    let mut total = Some(0);
    for path in files {
        match pulse_count.map(|count| count(path)) {
            None => total = None,
            Some(Ok(pulses)) => total = total.map(|total: u64| total.saturating_add(pulses)),
            Some(Err(error)) => problems.push(error.to_string()),
        }
    }
    let cores = match job.settings.threads {
        0 => engine::cores().unwrap_or(1),
        threads => threads,
    };
    let seconds = estimate::seconds(job, Amount { inputs, bytes, shots: total }, cores);
    let s = if cores == 1 { "" } else { "s" };
    text += &format!("  time:   {} on {cores} core{s}\n", estimate::words(seconds));
    text += &match total {
        Some(pulses) => {
            let points: Vec<String> =
                POINTS_PER_PULSE.iter().map(|each| each.saturating_mul(pulses).to_string()).collect();
            format!("  pulses: {pulses}; about {} points\n", points.join(" to "))
        }
        None => format!(
            "  pulses: unknown, and so are the points: {} counts pulses only by reading the data\n",
            reader.id
        ),
    };
    (text, problems)
}

/// Error for inputs that must be there.
pub(super) fn required(job: &Job, problems: &[String]) -> String {
    let what = if problems.len() == 1 { "1 problem" } else { &format!("{} problems", problems.len()) };
    format!("{}: {what} with the inputs\n  {}", job.name, problems.join("\n  "))
}
