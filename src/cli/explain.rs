//! `wavex explain`: one shot as a table and a picture.

use std::io::Write;
use std::path::Path;

use super::place::check_recording;
use super::{ExplainArgs, Failure, terminal};
use wavex_engine::engine::terminal_columns;
use wavex_formats::Error;
use wavex_formats::extensions::has_extension;
use wavex_line::stage::OutputFile;
use wavex_run::explain::{ExplainRequest, Explainer, NEAR_S, ShotChoice};

/// Prints the returns of a shot and writes its picture.
pub(super) fn explain(args: &ExplainArgs, quiet: bool) -> Result<(), Failure> {
    if let Some(out) = &args.out
        && !has_extension(out, "svg")
    {
        let problem = "the picture is SVG; give a name that ends in .svg";
        return Err(Failure::Wrong(format!("--out {}: {problem}", out.display())));
    }
    if let Some(problem) = job_as_recording(&args.file) {
        return Err(Failure::Wrong(problem));
    }
    check_recording(&args.file)?;
    let request = ExplainRequest {
        file: &args.file,
        job: args.job.as_deref(),
        set: &args.set,
        model: args.model.as_deref(),
        progress: args.progress.without_lines(quiet),
    };
    let time_s = args.time.unwrap_or_default();
    let choice = args.shot.map_or(ShotChoice::Time(time_s), ShotChoice::Number);
    let explained = Explainer::of(&request)?.explain(choice, terminal_columns())?;
    let stem = args.file.file_stem().unwrap_or_default().to_string_lossy();
    let path = args.out.clone().unwrap_or_else(|| format!("{stem}_shot_{}.svg", explained.shot).into());
    write(&path, &explained.picture).map_err(|error| Failure::Run(error.to_string()))?;
    let distance = distance_of(explained.later_s, time_s);
    let said = format!("{}\n{distance}wrote {}\n", explained.table, path.display());
    if quiet { Ok(()) } else { terminal::print(&said) }
}

/// How far the shot is from the time that selected it; empty if it is near.
fn distance_of(later_s: f64, time_s: f64) -> String {
    if later_s.abs() <= NEAR_S {
        return String::new();
    }
    let side = if later_s > 0.0 { "after" } else { "before" };
    format!("the nearest shot is {:.3} ms {side} {time_s} s\n", later_s.abs() * 1e3)
}

/// The answer to a job in place of the recording.
pub(super) fn job_as_recording(file: &Path) -> Option<String> {
    let job = file.display();
    has_extension(file, "toml").then(|| {
        format!(
            "{job}: it is a job, not a recording; give the recording, and the job by an option: wavex explain \
             RECORDING --job {job} --shot N"
        )
    })
}

/// Writes a picture, which gets its final name only when complete.
fn write(path: &Path, picture: &str) -> wavex_formats::Result<()> {
    let mut file = OutputFile::create(path)?;
    file.write_all(picture.as_bytes()).map_err(Error::io(path, "write"))?;
    file.finish()?.publish()?;
    Ok(())
}
