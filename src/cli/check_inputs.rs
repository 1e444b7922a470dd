//! Inputs of a job for `wavex check`: number, size, pulses, problems.

use std::path::Path;

use super::terminal::size;
use wavex_engine::engine;
use wavex_engine::job::Job;
use wavex_formats::{CompanionIndex, RecordingFormat};
use wavex_run::archive::missing_files;

/// Usual throughput of one core, MB of input per second, at most and at least: `fastest` on single
/// pulses, `refined` on vegetation.
const MB_PER_S: [f64; 2] = [30.0, 5.0];
/// Usual number of points per pulse, at least and at most.
const POINTS_PER_PULSE: [u64; 2] = [1, 3];

/// Describes the inputs of a job and lists their problems; `input_dir` is absolute.
///
/// Reads headers only.
pub(super) fn inspect(job: &Job, input_dir: &Path) -> (String, Vec<String>) {
    let (inputs, errors) = engine::find_inputs(job, input_dir);
    let mut problems: Vec<String> = errors.iter().map(ToString::to_string).collect();
    problems.extend(missing_files(job, &inputs, input_dir));
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
    let cores = match job.settings.threads {
        0 => engine::cores().unwrap_or(1),
        threads => threads,
    };
    text += &format!("  time:   {} on {cores} cores\n", time(bytes, cores));
    let pulse_count = RecordingFormat::read_by(reader.spec.name).and_then(|format| format.pulse_count);
    let mut total = Some(0);
    for path in files {
        match pulse_count.map(|count| count(path)) {
            None => total = None,
            Some(Ok(pulses)) => total = total.map(|total: u64| total.saturating_add(pulses)),
            Some(Err(error)) => problems.push(error.to_string()),
        }
    }
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

/// Usual time for inputs of this size, in words.
fn time(bytes: u64, cores: usize) -> String {
    let minutes = MB_PER_S.map(|rate| (bytes as f64 / 1e6 / rate / cores as f64 / 60.0).ceil());
    match minutes {
        [least, most] if most <= 1.0 || least == most => format!("about {most} min"),
        [least, most] if most <= 120.0 => format!("about {least} to {most} min"),
        [least, most] => format!("about {:.1} to {:.1} h", least / 60.0, most / 60.0),
    }
}

/// Error for inputs that must be there.
pub(super) fn required(job: &Job, problems: &[String]) -> String {
    let what = if problems.len() == 1 { "1 problem" } else { &format!("{} problems", problems.len()) };
    format!("{}: {what} with the inputs\n  {}", job.name, problems.join("\n  "))
}

#[cfg(test)]
mod tests {
    use super::time;

    #[test]
    fn times_are_a_range() {
        assert_eq!(time(1_000_000, 2), "about 1 min");
        assert_eq!(time(40_000_000_000, 4), "about 6 to 34 min");
        assert_eq!(time(2_000_000_000_000, 2), "about 9.3 to 55.6 h");
    }
}
