//! The command line: parses arguments, runs a command, sets the exit code.
//!
//! Exit codes: 0 success; 1 the run failed; 2 the job or the command line is invalid.

use std::ffi::OsString;
use std::path::PathBuf;
use std::process::ExitCode;

use clap::error::ErrorKind;
use clap::{CommandFactory, Parser};

use wavex_engine::job::{Job, Override, job_schema_text};
use wavex_line::system;
use wavex_run::{Failure, job_file, log};
use wavex_stages::registry::STAGES;

mod align;
mod archive;
mod args;
mod calibrate;
mod check;
mod check_inputs;
mod check_times;
mod classify;
mod commands;
mod convert;
mod copc;
mod doctor;
mod estimate;
mod explain;
mod false_alarms;
mod import;
mod init;
mod man;
mod place;
mod plan;
mod recording;
mod report;
mod run;
mod scan;
mod stages;
mod survey;
mod terminal;
mod trajectory;
mod unknown;
mod usage;
mod version;
mod view;

use args::{
    ArchiveArgs, CalibrateArgs, Classic, ExplainArgs, ImportArgs, InputRule, JobArgs, MachineArgs, ScanArgs,
    TrajectoryArgs, ViewArgs, When,
};
use commands::{Cli, Command};
use terminal::{exit_code, print};

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
            return print(&version::details()).map_or_else(|error| exit_code(&error), |()| 0);
        }
        Err(mut answer) => {
            if let Some(problem) = unknown::not_a_command(&answer, &arguments) {
                let failure = Failure::Wrong(problem);
                terminal::print_failure(&failure);
                return exit_code(&failure);
            }
            unknown::explain_argument(&mut answer, &arguments);
            answer.exit()
        }
    };
    log::begin(cli.loudness.verbose, cli.loudness.quiet, terminal::colour());
    let exit_code = match dispatch(cli) {
        Ok(()) => 0,
        Err(failure) => {
            terminal::print_failure(&failure);
            exit_code(&failure)
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
        Command::Run { job, machine, archive, resume, relearn, from_returns } => {
            let kind = run::RunKind { archive: archive.as_deref(), resume, relearn, from_returns };
            run::run(&job, machine, kind, quiet)
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
        Command::Init { files, from } => init::init(&files, from.as_deref(), quiet),
        Command::Convert { input, output, machine } => convert::convert(&input, &output, machine, quiet),
        Command::Align(args) => align::align(&args, quiet),
        Command::Classify(args) => classify::classify(&args, quiet),
        Command::Calibrate(args) => calibrate::calibrate(&args, quiet),
        Command::Copc { inputs, out, stac, progress } => {
            copc::copc_each(&inputs, out, stac, progress.without_lines(quiet), quiet)
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
        job_file::read(&self.job, self.set.iter().map(Override::new).chain(more).collect())
    }

    /// Folder at which relative paths of the job start.
    fn folder(&self) -> PathBuf {
        job_file::folder(&self.job)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_formats::format::FORMATS;

    #[test]
    fn the_command_line_is_consistent() {
        // clap panics on contradictory definitions and names them.
        Cli::command().debug_assert();
    }

    /// Help texts of recordings list the extensions of all formats.
    #[test]
    fn help_texts_list_all_extensions() {
        let extensions: Vec<String> = FORMATS
            .iter()
            .flat_map(|format| format.extensions)
            .map(|extension| format!(".{extension}"))
            .collect();
        let mut n_texts = 0;
        for command in Cli::command().get_subcommands() {
            for argument in command.get_arguments() {
                let help = argument.get_long_help().or(argument.get_help()).map(ToString::to_string);
                let Some(help) = help.filter(|help| help.contains(".las, ")) else { continue };
                for extension in &extensions {
                    assert!(help.contains(extension), "{} {}: {help}", command.get_name(), argument.get_id());
                }
                n_texts += 1;
            }
        }
        assert!(n_texts >= 5, "only {n_texts} help texts list extensions");
    }

    #[test]
    fn exit_codes_separate_failed_runs_from_wrong_jobs() {
        let wrong = Failure::Wrong("no such file".into());
        let failed = Failure::Run("the disk is full; make room".into());
        assert_eq!((exit_code(&wrong), exit_code(&failed)), (2, 1));
        assert_eq!(terminal::message(&failed, false), "error: the disk is full; make room\n");
        assert_eq!(terminal::message(&wrong, true), "\x1b[1;31merror\x1b[0m: no such file\n");
    }
}
