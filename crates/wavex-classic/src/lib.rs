//! Translates BayesWavEx 1.0 and 1.1 command lines into jobs.
//!
//! One table per version (`v10`, `v11`) defines what each option becomes. `line` parses a command
//! line with it. `translate` and `outputs` turn the options into job keys, notes and commands.
//! `draft` writes the TOML, with the source of each key as a comment. Every option appears in the
//! result.

use std::path::Path;

use wavex_engine::job::{Job, JobError, JobErrors};
use wavex_stages::registry::STAGES;

pub mod draft;
pub mod line;
pub mod options;
mod outputs;
mod page;
pub mod paths;
pub mod problem;
pub mod translate;
mod v10;
mod v11;
pub mod versions;

use draft::Known;
use line::{Given, Value};
use options::{Becomes, Flag, Part, Version};
use problem::Problem;
use translate::Imported;

pub use page::{becomes, page};
pub use translate::Place;

/// The job made from a classic command line, with notes.
#[derive(Debug)]
pub struct Import {
    /// The job in TOML with comments; only comments if the line writes no points.
    pub text: String,
    /// Whether the text contains a job.
    pub has_job: bool,
    /// Commands to run besides or instead of the job, each a `wavex` command line.
    pub commands: Vec<Vec<String>>,
    /// Options of `wavex run`.
    pub flags: Vec<Flag>,
    /// Requests that this build does not support.
    pub missing: Vec<String>,
    /// Requests that cannot be met, each with the reason.
    pub obstacles: Vec<String>,
}

/// Maximum length of a command line, bytes.
const LONGEST_LINE: usize = 1_000_000;

/// Translates a classic command line; `classic` names its version, if known.
///
/// # Errors
/// If the line, or the job that it makes in this build, is invalid: the problems with their positions
/// in one message, without the leading `error`.
pub fn import(words: &[String], classic: Option<&str>, place: &Place) -> Result<Import, String> {
    let length = words.iter().fold(0, |sum: usize, word| sum.saturating_add(word.len() + 1));
    if length > LONGEST_LINE {
        let what = format!("the command line has {length} bytes, more than {LONGEST_LINE}");
        return Err(
            Problem::of_line(what, "name many inputs by a pattern, as in `-i \"lines/*.sdf\"`").shown()
        );
    }
    let words = line::without_program(words);
    let version = version_of(words, classic)?;
    let (mut given, mut problems) = (Vec::new(), Vec::new());
    let mut passed_over = Vec::new();
    for name in version.option_files {
        match (place.read)(name) {
            Some(text) if given.is_empty() && problems.is_empty() => {
                (given, problems) = line::read_file(version, Path::new(name), &text);
            }
            Some(_) => {
                passed_over.push(((*name).to_owned(), "ignored: only the first file is read".to_owned()))
            }
            None => {}
        }
    }
    let from_files: Vec<String> = given.iter().map(|given: &Given| given.written.clone()).collect();
    let (of_line, of_words) = line::read_line(version, words);
    given.extend(of_line);
    problems.extend(of_words);
    if !problems.is_empty() {
        return Err(problem::message(&problems));
    }
    let mut imported = translate::translate(version, given, place).map_err(|all| problem::message(&all))?;
    imported.notes.extend(passed_over);
    let given = std::mem::take(&mut imported.given);
    let sources = std::mem::take(&mut imported.job.sources);
    let n_job_lines = imported.job.toml.lines().count();
    let import = finished(version, words, &from_files, imported);
    if import.has_job && matches!(place.known, Known::Program(_)) {
        let first = import.text.lines().count() - n_job_lines;
        let parsed = Job::parse(STAGES, THE_JOB, &import.text, &[]);
        parsed.map_err(|errors| problem::message(&of_job(&errors, first, &sources, &given)))?;
    }
    Ok(import)
}

/// Name of the job in errors that no option causes.
pub const THE_JOB: &str = "the job of this line";

/// Errors of the job at the options that cause them.
///
/// `sources` are the keys' lines in the job, which starts at line `first` of the text.
fn of_job(errors: &JobErrors, first: usize, sources: &[(usize, String)], given: &[Given]) -> Vec<Problem> {
    let cause = |line: usize| {
        let before = sources.iter().take_while(|(start, _)| first + start < line);
        let (_, source) = before.last()?;
        // A key may have several options as its source.
        given.iter().find(|given| *source == given.written).or_else(|| {
            given
                .iter()
                .filter(|given| source.contains(&given.written))
                .max_by_key(|given| given.written.len())
        })
    };
    // Defaults follow from the inputs.
    let input = || given.iter().find(|given| given.option.becomes == Becomes::Part(Part::Input));
    let one = |error: &JobError| {
        let what = format!("the job of this line is invalid: {}", error.problem);
        let help = error.help.join("; ");
        let cause = errors.position(error).and_then(|(_, line, _)| cause(line)).or_else(input);
        let place = cause.map(|given| given.place.clone());
        Problem { what: problem::plain(&what), help: problem::plain(&help), place }
    };
    errors.errors().iter().map(one).collect()
}

/// Returns the named version, else 1.0 for LAS or LAZ inputs and 1.1 for all others.
fn version_of(words: &[String], classic: Option<&str>) -> Result<&'static Version, String> {
    let is_las = || {
        let (given, _) = line::read_line(&v11::V11, words);
        let inputs = given.iter().rev().find(|given| given.option.becomes == Becomes::Part(Part::Input));
        let first = inputs.and_then(|given| match &given.value {
            Value::Texts(files) => files.first().map(|file| file.to_lowercase()),
            _ => None,
        });
        first.is_some_and(|file| file.ends_with(".las") || file.ends_with(".laz"))
    };
    let name = classic.unwrap_or_else(|| if is_las() { "1.0" } else { "1.1" });
    versions::find(name)
        .ok_or_else(|| Problem::of_line(format!("unknown version {name}"), "1.0 or 1.1").shown())
}

/// Builds the text of a translated line.
fn finished(version: &Version, words: &[String], from_files: &[String], imported: Imported) -> Import {
    let has_job = !imported.job.toml.is_empty();
    let (missing, obstacles) = (imported.job.missing, imported.job.obstacles);
    let mut text = format!(
        "# Translation of this BayesWavEx {} command line:\n#\n#   {}\n",
        version.name,
        line::joined(words)
    );
    for written in from_files {
        text += &format!("#   {written}\n");
    }
    if !imported.notes.is_empty() {
        text += "#\n# Options without a key in the job:\n";
        for (written, what) in &imported.notes {
            text += &format!("#   {written}: {what}\n");
        }
    }
    if !imported.commands.is_empty() {
        text += if has_job {
            "#\n# In addition to the job:\n"
        } else {
            "#\n# Equivalent commands instead of a job:\n"
        };
        for words in &imported.commands {
            text += &format!("#   {}\n", shell_line(words));
        }
    }
    text += &imported.job.toml;
    Import { text, has_job, commands: imported.commands, flags: imported.flags, missing, obstacles }
}

/// Quotes words for a shell.
fn shell_line(words: &[String]) -> String {
    let is_plain = |letter: char| letter.is_alphanumeric() || "-_./:=,+%@\\".contains(letter);
    let quoted = |word: &String| {
        if !word.is_empty() && word.chars().all(is_plain) {
            word.clone()
        } else {
            format!("'{}'", word.replace(char::is_control, "?").replace('\'', "'\\''"))
        }
    };
    words.iter().map(quoted).collect::<Vec<_>>().join(" ")
}
