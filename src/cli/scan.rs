//! `wavex scan`: inspects recordings; prints summaries; writes histograms and pages if asked.

use std::io::Write;
use std::path::Path;
use std::sync::Arc;

use super::place::check_recording;
use super::{Failure, ScanArgs, terminal};
use wavex_engine::engine::{self, Gauge, Input, Progress};
use wavex_engine::job::{Job, Override};
use wavex_formats::Error;
use wavex_formats::extensions::has_extension;
use wavex_formats::format::reader_of;
use wavex_line::scan_line::ScanLine;
use wavex_line::stage::{Context, FinishedFile, OutputFile, Paths, Plan, RunContext, StageError};
use wavex_pages::inspect::{Inspection, RecordingSummary, ScanSummary, histogram_files, page};
use wavex_stages::registry::STAGES;

/// Remedy for a pattern without matches in a job, and on the command line.
const OF_JOB: &str = "check `path` of the reader and `input_dir` of the job";
const OF_LINE: &str = "check the pattern and the folder";

/// Inspects recordings, prints the summaries, and writes files if asked.
///
/// An unreadable recording does not stop the inspection of the others.
pub(super) fn scan(args: &ScanArgs, quiet: bool) -> Result<(), Failure> {
    let inputs = engine::expand(Some(&Paths::Many(args.files.clone())), "", Path::new(""));
    let inputs = inputs.map_err(|error| {
        // An unsupported format is the more helpful reason.
        let unreadable = args.files.iter().find_map(|file| reader_of(file).err());
        unreadable.map_or_else(|| failed(&error.to_string().replace(OF_JOB, OF_LINE)), Failure::Wrong)
    })?;
    if let Some(problem) = args.out.as_deref().and_then(one_file) {
        return Err(Failure::Wrong(problem));
    }
    let are_many = inputs.len() > 1;
    let prefix = |stem: &str| match &args.out {
        None => stem.to_owned(),
        Some(name) if name.ends_with(std::path::is_separator) => format!("{name}{stem}"),
        Some(name) if are_many => format!("{name}_{stem}"),
        Some(name) => name.clone(),
    };
    let sizes = (0..).zip(engine::sizes(inputs.iter().map(|input| input.path.as_path())));
    let mut progress = Progress::new(args.progress.without_lines(quiet), sizes.collect());
    let scans = inputs.into_iter().enumerate().map(|(number, Input { path, stem, .. })| {
        check_recording(&path)?;
        if !quiet && engine::size(&path) >= LARGE_BYTES {
            print_first_look(&path, args)?;
        }
        let gauge = Arc::<Gauge>::default();
        progress.begin(number, &stem, &gauge);
        let read = look_at(&path, &args.set, !args.fast, u64::MAX, |line, fraction| {
            let shots = line.emissions.len() as u64;
            gauge.read(shots, fraction);
            gauge.passed(shots);
            progress.show();
        });
        progress.end(number);
        progress.count(!matches!(read, Ok((_, _, Ok(())))));
        conclude(&path, &prefix(&stem), read?, args, quiet)
    });
    super::do_all(scans)
}

/// Extensions of the files that are written.
const WRITTEN: [&str; 4] = ["html", "htm", "txt", "json"];

/// The answer to the name of one file: `--out` begins the names of several.
fn one_file(out: &str) -> Option<String> {
    let path = Path::new(out);
    let stem = WRITTEN.iter().any(|written| has_extension(path, written)).then(|| path.with_extension(""))?;
    let stem = stem.display();
    Some(format!(
        "--out {out}: it is the beginning of the names of several files, not one file; `--out {stem}` writes \
         {stem}_scan.html, {stem}_scan.txt and the histograms, `--page` only the page of each recording, and `--json` \
         prints JSON"
    ))
}

/// Size from which the first shots are summarised before all others are read, bytes.
const LARGE_BYTES: u64 = 256 << 20;
/// Number of these shots.
const FIRST_SHOTS: u64 = 2000;

/// Prints the summary of the first shots to standard error.
fn print_first_look(file: &Path, args: &ScanArgs) -> Result<(), Failure> {
    let (inspection, cx, _) = look_at(file, &args.set, !args.fast, FIRST_SHOTS, |_, _| ())?;
    let shots = inspection.shots.count;
    let text = RecordingSummary::of(file, &inspection, cx.counters(), None).text();
    terminal::print_message(&format!(
        "The first {shots} shots of {text}
Reading all of the recording.\n\n"
    ));
    Ok(())
}

/// Results of an inspection, and the error that ended it.
pub(super) type InspectedRecording = (Inspection, Context, Result<(), StageError>);

/// Prints the results of an inspection; writes files if asked.
///
/// If the recording could not be read to its end, these are of the readable part; then returns the
/// error.
fn conclude(
    file: &Path,
    prefix: &str,
    (inspection, cx, ended): InspectedRecording,
    args: &ScanArgs,
    quiet: bool,
) -> Result<(), Failure> {
    if let Err(error) = &ended
        && inspection.shots.count == 0
    {
        return Err(failed(error));
    }
    let cut = ended.as_ref().err().map(ToString::to_string);
    let cut = cut.as_deref();
    let summary = RecordingSummary::of(file, &inspection, cx.counters(), cut);
    let mut files = Vec::new();
    if args.out.is_some() {
        files.push((format!("{prefix}_scan.txt"), summary.text()));
        let histograms = histogram_files(&inspection).into_iter();
        files.extend(histograms.map(|(what, text)| (format!("{prefix}_{what}.txt"), text)));
    }
    if args.page || args.out.is_some() {
        files.push((format!("{prefix}_scan.html"), page(&summary, &inspection, cx.counters(), cut)));
    }
    let written = write(&files).map_err(|error| failed(&error))?;
    let said = if written.is_empty() { String::new() } else { format!("\nwrote {}\n", written.join(", ")) };
    if args.json {
        // Standard output has JSON alone.
        terminal::print(&ScanSummary::of(file, &inspection, cx.counters(), cut).line())?;
        if !quiet {
            terminal::print_message(said.trim_start());
        }
    } else if !quiet {
        terminal::print(&(summary.text() + &said))?;
    }
    ended.map_err(|error| failed(&error))
}

/// Inspects up to `shots` shots, or up to the first read error.
///
/// `watch` is called with each line and the part of the recording read so far.
pub(super) fn look_at(
    file: &Path,
    set: &[String],
    with_samples: bool,
    shots: u64,
    mut watch: impl FnMut(&ScanLine, Option<f64>),
) -> Result<InspectedRecording, Failure> {
    let name = file.display().to_string();
    let reader = reader_of(&name).map_err(Failure::Wrong)?;
    let text = format!("[[stage]]\ntype = \"{reader}\"\npath = {}\n", toml::Value::String(name));
    let overrides: Vec<Override> = set.iter().map(Override::new).collect();
    let job = Job::parse(STAGES, "the job of `wavex scan`", &text, &overrides)?;
    let Some(Plan::Source(source)) = job.stages.first().map(|stage| &stage.planned.plan) else {
        return Err(Failure::Run("the job has no source; please report this bug in wavex".into()));
    };
    let mut source =
        source.make_for_inspection(&RunContext::alone(file), with_samples).map_err(|error| failed(&error))?;
    let (mut inspection, mut cx) = (Inspection::new(with_samples), Context::of_run());
    let ended = loop {
        match source.next(&mut cx) {
            Ok(Some(_)) if inspection.shots.count >= shots => break Ok(()),
            Ok(Some(line)) => {
                inspection.add(&line);
                watch(&line, source.progress());
            }
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        }
    };
    inspection.finish();
    Ok((inspection, cx, ended))
}

/// Writes files; they get their final names when all are complete.
fn write(files: &[(String, String)]) -> Result<Vec<String>, Error> {
    let mut whole: Vec<FinishedFile> = Vec::new();
    for (name, text) in files {
        let path = Path::new(name);
        let mut file = OutputFile::create(path)?;
        file.write_all(text.as_bytes()).map_err(Error::io(path, "write"))?;
        whole.push(file.finish()?);
    }
    whole.into_iter().map(|file| file.publish().map(|path| path.display().to_string())).collect()
}

fn failed(error: &dyn std::fmt::Display) -> Failure {
    Failure::Run(error.to_string())
}
