//! `wavex explain`: one shot as a table and a picture.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use super::place::check_recording;
use super::{ExplainArgs, Failure, terminal};
use wavex_engine::engine::terminal_columns;
use wavex_formats::Error;
use wavex_formats::extensions::has_extension;
use wavex_line::stage::OutputFile;
use wavex_run::explain::{Chain, ExplainRequest, FootprintChain, NEAR_S};

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
    let wanted_s = args.time.unwrap_or_default();
    let mut distance = String::new();
    let (shot, table, picture) = if request.has_large_footprints() {
        let chain = FootprintChain::of(&request)?;
        let explained = match args.shot {
            Some(shot) => chain.explain(shot)?,
            None => {
                let (shot, time_s) = chain.nearest(wanted_s)?;
                distance = distance_of(time_s - wanted_s, wanted_s);
                chain.explain_running(shot)?
            }
        };
        let shot = explained.seen.footprint.shot_number;
        (shot, explained.table_within(terminal_columns()), explained.picture())
    } else {
        let chain = Arc::new(Chain::of(&request)?);
        let shot = match args.shot {
            Some(shot) => shot,
            None => {
                let (shot, time_s) = chain.nearest(wanted_s)?;
                distance = distance_of(time_s - wanted_s, wanted_s);
                shot
            }
        };
        let explained = chain.explain(shot)?;
        (shot, explained.table_within(terminal_columns()), explained.picture())
    };
    let stem = args.file.file_stem().unwrap_or_default().to_string_lossy();
    let path = args.out.clone().unwrap_or_else(|| format!("{stem}_shot_{shot}.svg").into());
    write(&path, &picture).map_err(|error| Failure::Run(error.to_string()))?;
    let said = format!("{table}\n{distance}wrote {}\n", path.display());
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
