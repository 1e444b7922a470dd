//! `wavex explain`: one shot as a table and a picture.

use std::io::Write;
use std::path::{Path, PathBuf};

use super::place::check_recording;
use super::{ExplainArgs, Failure, JobArgs, terminal};
use wavex_engine::engine::{inputs, terminal_columns};
use wavex_formats::Error;
use wavex_formats::extensions::has_extension;
use wavex_line::stage::OutputFile;
use wavex_run::archive::plain;
use wavex_run::explain::{ExplainRequest, Explainer, NEAR_S, ShotChoice};

/// Prints the returns of a shot and writes its picture.
pub(super) fn explain(args: &ExplainArgs, quiet: bool) -> Result<(), Failure> {
    if let Some(out) = &args.out
        && !has_extension(out, "svg")
    {
        let problem = "the picture is SVG; give a name that ends in .svg";
        return Err(Failure::Wrong(format!("--out {}: {problem}", out.display())));
    }
    let of_job = has_extension(&args.file, "toml").then(|| recording_of(args)).transpose()?;
    let (file, job) = match &of_job {
        Some(recording) => (recording.as_path(), Some(args.file.as_path())),
        None => (args.file.as_path(), args.job.as_deref()),
    };
    check_recording(file)?;
    let request = ExplainRequest {
        file,
        job,
        set: &args.set,
        model: args.model.as_deref(),
        progress: args.progress.without_lines(quiet),
    };
    let time_s = args.time.unwrap_or_default();
    let choice = args.shot.map_or(ShotChoice::Time(time_s), ShotChoice::Number);
    let explained = Explainer::of(&request)?.explain(choice, terminal_columns())?;
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    let path = args.out.clone().unwrap_or_else(|| format!("{stem}_shot_{}.svg", explained.shot).into());
    write(&path, &explained.picture).map_err(|error| Failure::Run(error.to_string()))?;
    let distance = distance_of(explained.later_s, time_s);
    let said = format!("{}\n{distance}wrote {}\n", explained.table, path.display());
    if quiet { Ok(()) } else { terminal::print(&said) }
}

/// The only recording of the job that is given in its place.
fn recording_of(args: &ExplainArgs) -> Result<PathBuf, Failure> {
    let name = args.file.display();
    let of_job = JobArgs { job: args.file.clone(), set: args.set.clone() };
    let job = of_job.read([])?;
    let (input_dir, _) = wavex_run::run::folders(&job, &of_job.folder());
    let inputs = inputs(&job, &input_dir).map_err(|error| Failure::Wrong(format!("{name}: {error}")))?;
    let given = inputs.into_iter().filter(|input| !input.path.as_os_str().is_empty());
    let mut files: Vec<PathBuf> = given.map(|input| plain(&input.path)).collect();
    // Parts of a file follow each other.
    files.dedup();
    let problem = match files.as_slice() {
        [only] if args.job.is_none() => return Ok(only.clone()),
        [_] => "it is a job, and --job is another one".to_owned(),
        files => format!("it is a job of {} recordings", files.len()),
    };
    Err(Failure::Wrong(format!("{name}: {problem}; {}", as_option(&name.to_string()))))
}

/// Remedy for a job in place of a recording.
fn as_option(job: &str) -> String {
    format!("give the recording, and the job by an option: wavex explain RECORDING --job {job} --shot N")
}

/// How far the shot is from the time that selected it; empty if it is near.
fn distance_of(later_s: f64, time_s: f64) -> String {
    if later_s.abs() <= NEAR_S {
        return String::new();
    }
    let side = if later_s > 0.0 { "after" } else { "before" };
    format!("the nearest shot is {:.3} ms {side} {time_s} s\n", later_s.abs() * 1e3)
}

/// The answer to a job without the number of a shot.
pub(super) fn job_as_recording(file: &Path) -> Option<String> {
    let job = file.display().to_string();
    has_extension(file, "toml").then(|| format!("{job}: it is a job, not a recording; {}", as_option(&job)))
}

/// Writes a picture, which gets its final name only when complete.
fn write(path: &Path, picture: &str) -> wavex_formats::Result<()> {
    let mut file = OutputFile::create(path)?;
    file.write_all(picture.as_bytes()).map_err(Error::io(path, "write"))?;
    file.finish()?.publish()?;
    Ok(())
}
