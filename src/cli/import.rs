//! `wavex import`: a line of the classic program BayesWavEx 1.0 or 1.1 as a job of wavex.
//!
//! What each option becomes stands in one table per version (`v10`, `v11`). A line is taken apart by it (`line`), becomes keys
//! of a job, notes and commands (`translate`, `outputs`), and is written as TOML (`draft`), in which every key says what it
//! comes from. Nothing of a line is dropped in silence.

use std::path::Path;

use clap::{CommandFactory, Parser};

use super::{Cli, Failure, ImportArgs, Machine, When, dispatch, run, terminal};
use crate::formats::trajectory::{self, Records};
use crate::job::Job;

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

use draft::Known;
use line::{Given, Value};
use options::{Becomes, Flag, Part, Version};
use problem::Problem;
use translate::Imported;

pub use page::{becomes, page};
pub use translate::Place;

/// The job of a line, with everything that is to be said of it.
#[derive(Debug)]
pub struct Import {
    /// The job in TOML with its comments; comments only where the line makes no points.
    pub text: String,
    /// Whether there is a job.
    pub has_job: bool,
    /// What else is to be done, each a command line of `wavex`.
    pub commands: Vec<Vec<String>>,
    /// Options of `wavex run`.
    pub flags: Vec<Flag>,
    /// What the line asks for and this build cannot do.
    pub missing: Vec<String>,
    /// What the line asks for in a way that cannot be used, and why.
    pub obstacles: Vec<String>,
}

/// Translates a line: its words, and the version where it is known.
///
/// # Errors
/// Everything that is wrong with the line, each with its place, as one message without the word `error` before it.
pub fn import(words: &[String], classic: Option<&str>, place: &Place) -> Result<Import, String> {
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
                passed_over.push(((*name).to_owned(), "passed over: only one such file is read".to_owned()))
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
    Ok(finished(version, words, &from_files, imported, place.known))
}

/// The version that is named, or that reads such inputs: 1.0 LAS and LAZ, 1.1 everything else.
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
    Version::find(name)
        .ok_or_else(|| Problem::of_line(format!("there is no version {name}"), "1.0 or 1.1").shown())
}

/// The text of what a line has become.
fn finished(
    version: &Version,
    words: &[String],
    from_files: &[String],
    imported: Imported,
    known: &Known,
) -> Import {
    let has_job = !imported.job.toml.is_empty();
    let (mut missing, obstacles) = (imported.job.missing, imported.job.obstacles);
    let mut text =
        format!("# What BayesWavEx {} does with this line:\n#\n#   {}\n", version.name, line::joined(words));
    for written in from_files {
        text += &format!("#   {written}\n");
    }
    if !imported.notes.is_empty() {
        text += "#\n# Options that are no keys of the job:\n";
        for (written, what) in &imported.notes {
            text += &format!("#   {written}: {what}\n");
        }
    }
    if !imported.commands.is_empty() {
        text += if has_job { "#\n# Besides the job:\n" } else { "#\n# No job: the same is done by\n" };
        for words in &imported.commands {
            let mut line = shell_line(words);
            if !known.has_command(words) {
                missing.push(line.clone());
                line += "    (this build cannot do this yet)";
            }
            text += &format!("#   {line}\n");
        }
    }
    text += &imported.job.toml;
    Import { text, has_job, commands: imported.commands, flags: imported.flags, missing, obstacles }
}

/// Words as a shell takes them.
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

impl Known {
    /// Whether the program has the command that these words begin with.
    fn has_command(&self, words: &[String]) -> bool {
        let name = words.get(1).map(String::as_str).unwrap_or_default();
        matches!(self, Known::Everything)
            || name.starts_with('-')
            || name == "help"
            || Cli::command().find_subcommand(name).is_some()
    }
}

/// Translates a line, and prints, writes or runs what it has become.
pub(super) fn run_import(args: &ImportArgs, quiet: bool) -> Result<(), Failure> {
    let read = |path: &str| std::fs::read_to_string(path).ok();
    let folder =
        args.output.as_deref().and_then(Path::parent).filter(|folder| !folder.as_os_str().is_empty());
    let base = match folder {
        None => None,
        Some(_) => {
            let here = std::env::current_dir();
            let here = here.map_err(|error| Failure::Wrong(format!("the current folder: {error}")))?;
            Some(here.display().to_string())
        }
    };
    let classic = args.classic.map(super::Classic::name);
    let known = Known::this_build();
    let place = Place { known: &known, base: base.as_deref(), read: &read, latitude: &latitude };
    let import = import(&args.line, classic, &place).map_err(Failure::Wrong)?;
    let job = match import.has_job {
        true => Some(Job::parse("the job of this line", &import.text, &[])?),
        false => None,
    };
    match &args.output {
        Some(_) if job.is_none() => {
            return Err(Failure::Wrong(format!("this line makes no job to write:\n{}", import.text)));
        }
        Some(file) => super::init::write_new(file, &import.text)?,
        None if !args.run => terminal::print(&import.text)?,
        None => {}
    }
    for what in &import.missing {
        tracing::warn!("this build cannot do yet: {what}");
    }
    for what in &import.obstacles {
        tracing::warn!("{what}");
    }
    if args.run { run_all(&import, job, folder, quiet) } else { Ok(()) }
}

/// The latitude at which a trajectory begins, degrees; `None` where it cannot be read, or is in the coordinates of a map.
fn latitude(file: &str, columns: Option<&str>) -> Option<f64> {
    let options = trajectory::Options { columns: columns.map(str::to_owned), ..Default::default() };
    match trajectory::read(Path::new(file), &options).ok()?.records {
        Records::Geodetic(samples) => samples.first().map(|sample| sample.place.latitude_rad.to_degrees()),
        Records::Projected(_) => None,
    }
}

/// Runs the job and the commands, or says what keeps this build from it.
fn run_all(import: &Import, job: Option<Job>, folder: Option<&Path>, quiet: bool) -> Result<(), Failure> {
    if !import.obstacles.is_empty() {
        let what = import.obstacles.join("; ");
        return Err(Failure::Wrong(format!("the line is not run: {what}")));
    }
    if !import.missing.is_empty() {
        let what = import.missing.join(", ");
        return Err(Failure::Wrong(format!(
            "the line is not run, because this build cannot do yet: {what}; leave that out, or write the job with `-o` \
             and change it"
        )));
    }
    if job.is_none() && import.commands.is_empty() {
        return terminal::print(&import.text);
    }
    let quiet = quiet || import.flags.contains(&Flag::Quiet);
    let progress = if import.flags.contains(&Flag::NoProgress) { When::Never } else { When::Auto };
    if let Some(job) = job {
        let machine = Machine { threads: None, profile: false, progress };
        run::run_job(&job, folder.unwrap_or(Path::new(".")), machine, quiet)?;
    }
    super::do_all(import.commands.iter().map(|words| command(words, quiet)))
}

/// Does what a command line of `wavex` says.
fn command(words: &[String], quiet: bool) -> Result<(), Failure> {
    let words = words.iter().map(String::as_str).chain(quiet.then_some("--quiet"));
    match Cli::try_parse_from(words) {
        Ok(cli) => dispatch(cli),
        Err(answer) if !answer.use_stderr() => terminal::print(&answer.render().to_string()),
        Err(problem) => Err(Failure::Wrong(problem.render().to_string())),
    }
}
