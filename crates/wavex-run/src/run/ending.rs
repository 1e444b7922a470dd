//! What a run says at its end: results, consequences, rejections and files.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use crate::archive::shown;
use wavex_engine::engine::{InputStatus, InputSummary, RunSummary, rate};
use wavex_engine::job::Job;
use wavex_line::stage::counted;
use wavex_pages::report;

/// Messages at the end of a run, in order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ending(pub Vec<EndMessage>);

/// A message at the end of a run, without a line feed at its end.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EndMessage {
    /// Results of an input or of all.
    Result(String),
    /// Rejected items, or consequences of a cause.
    Warning(String),
    /// A table, of several lines.
    Table(String),
    /// Written files, or seals.
    File(String),
    /// The next command.
    Next(String),
}

impl Ending {
    /// The same as plain text.
    pub fn text(&self) -> String {
        self.0.iter().map(|message| format!("{}\n", message.text())).collect()
    }
}

impl EndMessage {
    /// Its text.
    pub fn text(&self) -> &str {
        match self {
            EndMessage::Result(text)
            | EndMessage::Warning(text)
            | EndMessage::Table(text)
            | EndMessage::File(text)
            | EndMessage::Next(text) => text,
        }
    }
}

/// What is said beyond results, rejections and files.
#[derive(Clone, Copy, Debug)]
pub(super) struct Detail {
    /// Table of stages, and all files of several inputs.
    pub(super) stages: bool,
    /// Table of working times per scan line.
    pub(super) latencies: bool,
}

/// Messages about the inputs and their files; `of_run` are the files of the run as a whole, `of_inputs` those of its
/// inputs that no stage has written.
pub(super) fn messages(
    run: &RunSummary,
    table: Option<String>,
    [of_run, of_inputs]: [&[PathBuf]; 2],
    detail: Detail,
) -> Vec<EndMessage> {
    let mut messages = Vec::new();
    let done = || run.inputs.iter().filter(|input| input.status == InputStatus::Done);
    let is_single = run.inputs.len() == 1;
    for input in done() {
        if is_single {
            messages.push(EndMessage::Result(format!("{}: {}", input.stem, results([input], input.wall_s))));
        }
        if detail.stages {
            messages.push(EndMessage::Table(report::stage_table(input).trim_end().to_owned()));
        }
        if detail.latencies {
            messages.push(EndMessage::Table(report::latency_table(input).trim_end().to_owned()));
        }
    }
    messages.extend(table.map(|table| EndMessage::Table(table.trim_end().to_owned())));
    if !is_single && done().next().is_some() {
        messages.push(EndMessage::Result(results(done(), run.wall_s)));
    }
    messages.extend(warnings(done()).into_iter().map(EndMessage::Warning));
    let of_stages = done().flat_map(|input| &input.outputs).chain(of_inputs);
    if is_single || detail.stages {
        messages.extend(of_stages.map(|path| wrote(path)));
    } else {
        messages.extend(folders(of_stages).map(EndMessage::File));
    }
    messages.extend(of_run.iter().map(|path| wrote(path)));
    messages
}

/// Command that shows the results: `wavex view` with the output folder, or with the report if the folder has other ones.
///
/// Without a report it is the job; `None` for a job without points, and for one that is not in a file.
pub(super) fn next(job: &Job, output_dir: &Path, report: Option<&Path>) -> Option<EndMessage> {
    if job.stages.iter().all(|stage| stage.spec.name != "georeference") {
        return None;
    }
    let has_only = |report: &Path| {
        let names = output_dir.read_dir().ok()?.flatten().map(|entry| entry.file_name());
        let mut reports = names.filter(|name| name.to_string_lossy().ends_with("report.json"));
        (report.parent() == Some(output_dir) && reports.next().is_some() && reports.next().is_none())
            .then(|| shown(output_dir))
    };
    let job = Path::new(&job.name);
    let of_report = report.map(|report| has_only(report).unwrap_or_else(|| shown(report)));
    let place = of_report.or_else(|| job.is_file().then(|| shown(job)))?;
    let place = place.display().to_string();
    let quote = if place.contains(char::is_whitespace) { "'" } else { "" };
    Some(EndMessage::Next(format!("look: wavex view {quote}{place}{quote}")))
}

/// Waveforms, returns, time and rate.
fn results<'a>(inputs: impl IntoIterator<Item = &'a InputSummary>, wall_s: f64) -> String {
    let (mut waveforms, mut returns, mut shots) = (0, 0, 0);
    let mut has_decomposed = false;
    for input in inputs {
        has_decomposed |= input.stages.iter().any(|stage| stage.r#type == "decompose");
        let total = |name: &str| input.totals.get(name).copied().unwrap_or(0);
        waveforms += total("nw");
        returns += total("np");
        shots += input.stages.first().map_or(0, |reader| reader.items_out.shots);
    }
    let per_s = rate(shots as f64 / wall_s.max(1e-3));
    // A job that only copies waveforms looks for no returns.
    let what = match has_decomposed {
        true => format!("{} and {}", count(waveforms, "waveform"), count(returns, "return")),
        false => count(shots, "shot"),
    };
    format!("{what} in {wall_s:.1} s ({per_s})")
}

/// Rejected items and consequences, each with the number of its inputs if there are several.
fn warnings<'a>(inputs: impl Iterator<Item = &'a InputSummary>) -> Vec<String> {
    let mut rejected: BTreeMap<(&str, &str), u64> = BTreeMap::new();
    let mut consequences: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for stage in inputs.flat_map(|input| &input.stages) {
        for (what, n) in &stage.rejected {
            *rejected.entry((&stage.id, what)).or_default() += n;
        }
        for (cause, texts) in &stage.consequences {
            consequences.entry(cause).or_default().extend(texts.iter().map(String::as_str));
        }
    }
    let consequence = |(cause, texts): (&str, BTreeSet<&str>)| {
        format!("{cause}: {}", texts.into_iter().collect::<Vec<_>>().join("; "))
    };
    let rejected = rejected.into_iter().map(|((id, what), n)| format!("{id}: rejected {}", counted(n, what)));
    consequences.into_iter().map(consequence).chain(rejected).collect()
}

fn wrote(path: &Path) -> EndMessage {
    EndMessage::File(format!("wrote {}", shown(path).display()))
}

/// Number of files in each folder.
fn folders<'a>(paths: impl Iterator<Item = &'a PathBuf>) -> impl Iterator<Item = String> {
    let mut files: BTreeMap<PathBuf, u64> = BTreeMap::new();
    paths.for_each(|path| *files.entry(path.parent().map_or_else(PathBuf::new, shown)).or_default() += 1);
    let words = |(folder, n): (PathBuf, u64)| {
        format!("wrote {} of the inputs to {} (-v lists them)", count(n, "file"), folder.display())
    };
    files.into_iter().map(words)
}

/// A number of things: `1 file`, `2 files`.
fn count(n: u64, thing: &str) -> String {
    format!("{n} {thing}{}", if n == 1 { "" } else { "s" })
}
