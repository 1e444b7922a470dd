//! `wavex run`: reads and runs a job.

use std::io::IsTerminal;
use std::path::Path;
use std::time::Duration;

use super::{Failure, JobArgs, MachineArgs, When, args, terminal};
use wavex_engine::engine::{Cancel, Cause, ProgressMode, RunError, RunSummary};
use wavex_engine::job::Override;
use wavex_line::stage::{release_all, remove_unfinished_files};
use wavex_run::archive::check_destination;
use wavex_run::from_returns;
use wavex_run::log;
use wavex_run::run::{Ending, Listener, ResumeCheck, RunRequest};

/// What a run makes besides its outputs, and where it starts.
pub(super) struct RunKind<'a> {
    /// Archive to make.
    pub(super) archive: Option<&'a Path>,
    /// Skips complete inputs.
    pub(super) resume: Option<args::ResumeCheck>,
    /// Whether a resumed run learns the sensor models again.
    pub(super) relearn: bool,
    /// Whether it reads returns files instead of the recordings.
    pub(super) from_returns: bool,
}

/// Reads and runs the job.
pub(super) fn run(args: &JobArgs, machine: MachineArgs, kind: RunKind, quiet: bool) -> Result<(), Failure> {
    let RunKind { archive, resume, relearn, from_returns } = kind;
    let job = args.read(machine.overrides())?;
    if let Some(archive) = archive {
        check_destination(archive).map_err(|error| Failure::Wrong(error.to_string()))?;
    }
    if resume.is_some() && job.settings.report.is_empty() {
        let problem =
            "--resume reads the report of the earlier run, but this job writes none; set `report` in `[job]`";
        return Err(Failure::Wrong(problem.to_owned()));
    }
    let resume = resume.map(ResumeCheck::from);
    let folder = args.folder();
    let job = if from_returns { from_returns::from_returns(&job, &folder)? } else { job };
    run_job(RunRequest { archive, resume, relearn, ..RunRequest::quiet(&job, &folder) }, machine, quiet)
        .map(drop)
}

/// Runs a job until it ends or a signal comes; shows progress and messages.
pub(super) fn run_job(request: RunRequest, machine: MachineArgs, quiet: bool) -> Result<RunSummary, Failure> {
    let request = RunRequest {
        profile: machine.profile,
        with_stages: log::is_verbose(),
        progress: machine.progress(quiet, std::io::stderr().is_terminal()),
        listener: &Terminal { quiet },
        ..request
    };
    stop_on_signals(&request.cancel, end_run);
    Ok(wavex_run::run::run(request)?.run)
}

/// Prints the messages of a run.
struct Terminal {
    quiet: bool,
}

impl Listener for Terminal {
    fn resume_decision(&self, message: &str) {
        if !self.quiet {
            terminal::print_message(&format!("{message}\n"));
        }
    }

    fn input_failed(&self, message: &str) {
        terminal::print_failure(&Failure::Run(message.to_owned()));
    }

    fn ended(&self, ending: &Ending) -> Result<(), Failure> {
        if self.quiet { Ok(()) } else { terminal::print_ending(ending) }
    }
}

impl From<args::ResumeCheck> for ResumeCheck {
    fn from(check: args::ResumeCheck) -> ResumeCheck {
        match check {
            args::ResumeCheck::Time => ResumeCheck::Time,
            args::ResumeCheck::Digest => ResumeCheck::Digest,
        }
    }
}

/// Time in which an interrupted run may end in order.
const TIME_TO_STOP: Duration = Duration::from_millis(800);

/// Ends the process of a run without waiting for its stages.
pub(super) fn end_run() -> ! {
    remove_unfinished_files();
    release_all();
    let error = RunError { stage: None, input: None, cause: Cause::Interrupted };
    let interrupted = Failure::Run(error.to_string());
    terminal::print_failure(&interrupted);
    std::process::exit(terminal::exit_code(&interrupted).into());
}

/// Ends the run in order on Ctrl-C or a termination request.
///
/// Every stage completes its current line first, if that takes less than [`TIME_TO_STOP`]. A second signal
/// ends the process at once, by `end_process`.
pub(super) fn stop_on_signals(cancel: &Cancel, end_process: fn() -> !) {
    let cancel = cancel.clone();
    let handler = move || {
        if cancel.is_cancelled() {
            end_process();
        }
        cancel.cancel();
        // The handler must be free for a second signal.
        let _ = std::thread::Builder::new().spawn(move || {
            std::thread::sleep(TIME_TO_STOP);
            end_process();
        });
    };
    if let Err(error) = ctrlc::set_handler(handler) {
        tracing::debug!("cannot install the signal handler: {error}");
    }
}

impl MachineArgs {
    /// Job keys set by these arguments.
    pub(super) fn overrides(self) -> Option<Override> {
        self.threads.map(|threads| Override::new(format!("job.threads={threads}")))
    }

    pub(super) fn progress(self, quiet: bool, on_terminal: bool) -> ProgressMode {
        self.progress.mode(quiet, on_terminal)
    }
}

impl When {
    /// Progress display for this setting.
    pub(super) fn mode(self, quiet: bool, on_terminal: bool) -> ProgressMode {
        match self {
            _ if quiet => ProgressMode::Hidden,
            When::Never => ProgressMode::Hidden,
            When::Always => ProgressMode::Bar,
            When::Json => ProgressMode::Json,
            When::Auto if on_terminal => ProgressMode::Bar,
            When::Auto => ProgressMode::Lines,
        }
    }

    /// Progress display for this setting of a command that prints its result soon.
    pub(super) fn without_lines(self, quiet: bool) -> ProgressMode {
        match self.mode(quiet, std::io::stderr().is_terminal()) {
            ProgressMode::Lines => ProgressMode::Hidden,
            mode => mode,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bar_is_for_terminals() {
        let shown = |progress, quiet, on_terminal| {
            MachineArgs { threads: None, profile: false, progress }.progress(quiet, on_terminal)
        };
        assert_eq!(shown(When::Auto, false, true), ProgressMode::Bar);
        assert_eq!(shown(When::Auto, false, false), ProgressMode::Lines);
        assert_eq!(shown(When::Always, false, false), ProgressMode::Bar);
        assert_eq!(shown(When::Never, false, true), ProgressMode::Hidden);
        assert_eq!(shown(When::Always, true, true), ProgressMode::Hidden);
        assert_eq!(shown(When::Json, false, true), ProgressMode::Json);
    }

    #[test]
    fn threads_of_the_command_line_are_the_jobs() {
        let machine = MachineArgs { threads: Some(3), profile: false, progress: When::Auto };
        assert_eq!(machine.overrides(), Some(Override::new("job.threads=3")));
    }
}
