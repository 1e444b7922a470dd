//! The command line: parses arguments, runs a command, sets the exit code.
//!
//! Exit codes: 0 success; 1 the run failed; 2 the job or the command line is invalid.

use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};

use crate::job::{Include, Job, JobErrors, MAX_INCLUDES, Override, included, job_schema_text, read_text};
use crate::printable::printable;
use crate::registry::STAGES;
use crate::system;
use wavex_formats::{Error, regular_file};

mod archive;
mod args;
mod calibrate;
mod check;
mod check_inputs;
mod commands;
mod convert;
mod copc;
mod doctor;
mod explain;
mod false_alarms;
pub mod import;
mod init;
mod log;
mod man;
mod plan;
mod recording;
mod report;
mod resume;
mod run;
mod run_files;
mod scan;
mod stages;
mod survey;
mod survey_files;
mod terminal;
mod trajectory;
mod usage;
mod version;
mod view;

pub use explain::{Explanation, explain_shot};
pub use run::{FinishedRun, RunFailure, RunRequest, read_job, run_quietly};

use args::{
    ArchiveArgs, CalibrateArgs, Classic, ExplainArgs, ImportArgs, InputRule, JobArgs, Machine, ScanArgs,
    TrajectoryArgs, ViewArgs, When,
};
use commands::{Cli, Command};
use terminal::print;

/// Reason why a command failed.
#[derive(Debug)]
pub enum Failure {
    /// The job is invalid.
    Job(JobErrors),
    /// The command line or a file named on it is invalid: problem and remedy.
    Wrong(String),
    /// The run failed: problem and remedy.
    Run(String),
}

impl Failure {
    /// Exit code of the process.
    fn exit_code(&self) -> u8 {
        match self {
            Failure::Run(_) => 1,
            Failure::Job(_) | Failure::Wrong(_) => 2,
        }
    }

    /// The problem and its remedy.
    pub fn text(&self) -> String {
        match self {
            Failure::Job(errors) => errors.to_string(),
            Failure::Wrong(problem) | Failure::Run(problem) => problem.clone(),
        }
    }

    /// Error message for the user, safe to print; ends with a line feed.
    fn message(&self, colour: bool) -> String {
        match self {
            Failure::Job(errors) => errors.render(colour),
            Failure::Wrong(problem) | Failure::Run(problem) => {
                format!("{}: {}\n", terminal::error_word(colour), printable(problem))
            }
        }
    }
}

impl From<JobErrors> for Failure {
    fn from(errors: JobErrors) -> Failure {
        Failure::Job(errors)
    }
}

/// Runs the program: parses the process arguments, dispatches, reports errors.
pub fn main() -> ExitCode {
    ExitCode::from(main_with(std::env::args_os().collect()))
}

/// Runs the program with these arguments, the first of which is its name; returns the exit code.
///
/// Help, the version and invalid arguments end the process.
pub fn main_with(arguments: Vec<OsString>) -> u8 {
    system::ignore_file_size_signal();
    let cli = match Cli::try_parse_from(&arguments) {
        Ok(cli) => cli,
        Err(answer) if answer.kind() == ErrorKind::DisplayVersion && asks_for_more(&arguments) => {
            return print(&version::details()).map_or_else(|error| error.exit_code(), |()| 0);
        }
        Err(answer) => answer.exit(),
    };
    log::begin(cli.loudness.verbose, cli.loudness.quiet);
    let exit_code = match dispatch(cli) {
        Ok(()) => 0,
        Err(failure) => {
            terminal::print_failure(&failure);
            failure.exit_code()
        }
    };
    // The last line of a run's log states the exit status.
    tracing::debug!("exit status {exit_code}");
    log::end_file();
    exit_code
}

/// Returns whether the arguments contain `--verbose` or `-v`.
///
/// clap handles `--version` before it parses the other arguments.
fn asks_for_more(arguments: &[OsString]) -> bool {
    let is_verbose = |word: &str| {
        word == "--verbose" || (word.starts_with('-') && !word.starts_with("--") && word.contains('v'))
    };
    arguments.iter().skip(1).filter_map(|word| word.to_str()).any(is_verbose)
}

fn dispatch(cli: Cli) -> Result<(), Failure> {
    let quiet = cli.loudness.quiet;
    match cli.command {
        Command::Run { job, machine, archive, resume, relearn } => {
            run::run(&job, machine, archive.as_deref(), resume, relearn, quiet)
        }
        Command::Plan(args) => plan::plan(&args, quiet),
        Command::Collect(args) => plan::collect(&args, quiet),
        Command::Replay { archived, seal, threads, progress } => {
            archive::replay(archived, seal, threads, progress, quiet)
        }
        Command::Verify { archived, seal } => archive::verify(&archived, seal.as_deref(), quiet),
        Command::Check { job, inputs } => check::check(&job, inputs),
        Command::Stages { name } => stages::stages(STAGES, name.as_deref()),
        Command::Schema => print(&job_schema_text(STAGES)),
        Command::Init { file, from } => init::init(file.as_deref(), from.as_deref(), quiet),
        Command::Convert { input, output, machine } => convert::convert(&input, &output, machine, quiet),
        Command::Calibrate(args) => calibrate::calibrate(&args, quiet),
        Command::Copc { input, out, stac, progress } => {
            copc::copc(&input, out, stac, progress.without_lines(quiet), quiet)
        }
        Command::FalseAlarms(args) => false_alarms::false_alarms(&args),
        Command::Explain(args) => explain::explain(&args, quiet),
        Command::Scan(args) => scan::scan(&args, quiet),
        Command::Report { place, out } => report::report(&place, out.as_deref(), quiet),
        Command::Survey(args) => survey::survey(&args, quiet),
        Command::Trajectory(args) => trajectory::trajectory(&args, quiet),
        Command::Import(args) => import::run_import(&args, quiet),
        Command::View(args) => view::view(&args, quiet),
        Command::Doctor => doctor::doctor(),
        Command::Man { folder } => man::man(&folder, quiet),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "wavex", &mut script);
            print(&String::from_utf8_lossy(&script))
        }
    }
}

/// Runs all commands even if some fail.
///
/// Prints every error except the last, which is returned.
fn do_all(done: impl Iterator<Item = Result<(), Failure>>) -> Result<(), Failure> {
    let mut last = Ok(());
    for failure in done.filter_map(Result::err) {
        if let Err(earlier) = std::mem::replace(&mut last, Err(failure)) {
            terminal::print_failure(&earlier);
        }
    }
    last
}

impl JobArgs {
    /// Parses the job, with overrides from the command line and from `more`.
    fn read(&self, more: impl IntoIterator<Item = Override>) -> Result<Job, Failure> {
        let (name, text) = if self.is_stdin() {
            ("standard input".to_owned(), read_text(std::io::stdin()))
        } else {
            (self.job.display().to_string(), read_file(&self.job))
        };
        let text = text.map_err(|error| Failure::Wrong(format!("{name}: cannot read the job: {error}")))?;
        let overrides: Vec<Override> = self.set.iter().map(Override::new).chain(more).collect();
        let includes: Result<Vec<Include>, Failure> = included(&text)
            .iter()
            .take(MAX_INCLUDES + 1)
            .map(|included| self.read_include(included))
            .collect();
        Ok(Job::parse_with(STAGES, &name, &text, &includes?, &overrides)?)
    }

    /// Reads a file that the job includes.
    fn read_include(&self, included: &str) -> Result<Include, Failure> {
        // In the current folder the path stays as the job writes it, without a leading `./`.
        let folder = self.folder();
        let path = if folder == *"." { PathBuf::from(included) } else { folder.join(included) };
        let name = path.display().to_string();
        match read_file(&path) {
            Ok(text) => Ok(Include { name, text }),
            Err(error) => {
                let remedy = "check `include` in `[job]`";
                Err(Failure::Wrong(format!("{name}: cannot read the included file: {error}; {remedy}")))
            }
        }
    }

    /// Folder at which relative paths of the job start.
    fn folder(&self) -> PathBuf {
        let folder = self.job.parent().filter(|folder| !self.is_stdin() && !folder.as_os_str().is_empty());
        folder.map_or(PathBuf::from("."), PathBuf::from)
    }

    fn is_stdin(&self) -> bool {
        self.job.as_os_str() == "-"
    }
}

/// Reads a job or an included file.
fn read_file(path: &Path) -> io::Result<String> {
    match regular_file(path) {
        Ok(file) => read_text(file),
        Err(Error::Io { source, .. }) => Err(source),
        Err(_) => Err(io::Error::other("it is a pipe or device; give a file, or - for standard input")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_command_line_is_consistent() {
        // clap panics on contradictory definitions and names them.
        Cli::command().debug_assert();
    }

    #[test]
    fn exit_codes_separate_failed_runs_from_wrong_jobs() {
        let wrong = Failure::Wrong("no such file".into());
        let failed = Failure::Run("the disk is full; make room".into());
        assert_eq!((wrong.exit_code(), failed.exit_code()), (2, 1));
        assert_eq!(failed.message(false), "error: the disk is full; make room\n");
        assert_eq!(wrong.message(true), "\x1b[1;31merror\x1b[0m: no such file\n");
    }

    #[test]
    fn relative_paths_start_at_the_folder_of_the_job() {
        let folder = |job: &str| JobArgs { job: job.into(), set: Vec::new() }.folder();
        let folders = ["a/b.toml", "b.toml", "-"].map(folder);
        assert_eq!(folders, ["a", ".", "."].map(PathBuf::from));
    }
}
