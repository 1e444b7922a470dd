//! `wavex explain`: one shot as a table and a picture.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use super::{ExplainArgs, Failure, terminal};
use wavex_engine::engine::terminal_columns;
use wavex_formats::Error;
use wavex_formats::extensions::has_extension;
use wavex_line::stage::OutputFile;
use wavex_run::explain::{Chain, ExplainRequest, FootprintChain};

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
    let request = ExplainRequest {
        file: &args.file,
        job: args.job.as_deref(),
        set: &args.set,
        model: args.model.as_deref(),
        progress: args.progress.without_lines(quiet),
    };
    let (shot, table, picture) = if request.has_large_footprints() {
        let chain = FootprintChain::of(&request)?;
        let explained = match (args.shot, args.time) {
            (Some(shot), _) => chain.explain(shot)?,
            (None, time) => chain.explain_nearest(time.unwrap_or_default())?,
        };
        let shot = explained.seen.footprint.shot_number;
        (shot, explained.table_within(terminal_columns()), explained.picture())
    } else {
        let chain = Arc::new(Chain::of(&request)?);
        let shot = match (args.shot, args.time) {
            (Some(shot), _) => shot,
            (None, time) => chain.nearest(time.unwrap_or_default())?,
        };
        let explained = chain.explain(shot)?;
        (shot, explained.table_within(terminal_columns()), explained.picture())
    };
    let stem = args.file.file_stem().unwrap_or_default().to_string_lossy();
    let path = args.out.clone().unwrap_or_else(|| format!("{stem}_shot_{shot}.svg").into());
    write(&path, &picture).map_err(|error| Failure::Run(error.to_string()))?;
    let said = format!("{table}\nwrote {}\n", path.display());
    if quiet { Ok(()) } else { terminal::print(&said) }
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
