//! `wavex run`: a job's text to a finished run.

use std::io::IsTerminal;
use std::path::{Path, PathBuf};

use super::{Failure, JobArgs, Machine, When};
use crate::job::{Job, Override};
use crate::stage::StageError;

/// What the engine is asked to do.
#[derive(Debug)]
pub(super) struct Request<'j> {
    /// The job; its `threads` are those of the command line, where it names any.
    pub job: &'j Job,
    /// Where relative input paths start.
    pub input_dir: PathBuf,
    /// Where relative output paths start.
    pub output_dir: PathBuf,
    /// Whether to say at the end how long each stage worked and waited.
    pub profile: bool,
    /// How to show how far the run is.
    pub progress: Progress,
}

/// How to show how far a run is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Progress {
    /// A bar, for a terminal.
    Bar,
    /// A line now and then.
    Lines,
    /// Not at all.
    Hidden,
}

/// Reads the job and runs it.
pub(super) fn run(args: &JobArgs, machine: Machine, quiet: bool) -> Result<(), Failure> {
    let job = args.read(machine.overrides())?;
    run_job(&job, &args.folder(), machine, quiet)
}

/// Runs a job whose relative paths start at `folder`.
pub(super) fn run_job(job: &Job, folder: &Path, machine: Machine, quiet: bool) -> Result<(), Failure> {
    for note in &job.notes {
        tracing::warn!("{note}");
    }
    let (input_dir, output_dir) = folders(job, folder);
    let progress = machine.progress(quiet, std::io::stderr().is_terminal());
    start(&Request { job, input_dir, output_dir, profile: machine.profile, progress }).map_err(Failure::Run)
}

/// Where relative input and output paths of a job start that stands in `folder`.
pub(super) fn folders(job: &Job, folder: &Path) -> (PathBuf, PathBuf) {
    let from = |dir: &Option<String>| dir.as_ref().map_or(folder.to_path_buf(), |dir| folder.join(dir));
    (from(&job.settings.input_dir), from(&job.settings.output_dir))
}

/// Hands the run to the engine: the only place that knows how it is called.
fn start(request: &Request) -> Result<(), StageError> {
    let Request { job, input_dir, output_dir, profile, progress } = request;
    tracing::debug!(?input_dir, ?output_dir, profile, ?progress, threads = job.settings.threads, "run");
    Err(StageError::failed("running jobs is unavailable: this build has no engine", "use one that has"))
}

impl Machine {
    /// What the command line sets of the job.
    pub(super) fn overrides(self) -> Option<Override> {
        self.threads.map(|threads| Override::new(format!("job.threads={threads}")))
    }

    fn progress(self, quiet: bool, on_terminal: bool) -> Progress {
        match self.progress {
            _ if quiet => Progress::Hidden,
            When::Never => Progress::Hidden,
            When::Always => Progress::Bar,
            When::Auto if on_terminal => Progress::Bar,
            When::Auto => Progress::Lines,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::JobSettings;
    use crate::test_stages;

    #[test]
    fn folders_start_at_the_job() {
        let dirs = |input: Option<&str>, output: Option<&str>| {
            let settings = JobSettings {
                input_dir: input.map(str::to_owned),
                output_dir: output.map(str::to_owned),
                ..JobSettings::default()
            };
            folders(&Job { settings, ..Job::default() }, Path::new("jobs"))
        };
        assert_eq!(dirs(None, None), ("jobs".into(), "jobs".into()));
        assert_eq!(dirs(Some("in"), Some("/data/out")), ("jobs/in".into(), "/data/out".into()));
    }

    #[test]
    fn a_run_without_an_engine_fails() {
        let job = Job::parse_with(test_stages::STAGES, "a.toml", "[[stage]]\ntype = \"simulate\"\n", &[]);
        let machine = Machine { threads: None, profile: false, progress: When::Auto };
        let failure = run_job(&job.unwrap(), Path::new("."), machine, true).unwrap_err();
        let expected = "error: running jobs is unavailable: this build has no engine; use one that has\n";
        assert_eq!((failure.exit_code(), failure.message(false).as_str()), (1, expected));
    }

    #[test]
    fn a_bar_is_for_terminals() {
        let shown = |progress, quiet, on_terminal| {
            Machine { threads: None, profile: false, progress }.progress(quiet, on_terminal)
        };
        assert_eq!(shown(When::Auto, false, true), Progress::Bar);
        assert_eq!(shown(When::Auto, false, false), Progress::Lines);
        assert_eq!(shown(When::Always, false, false), Progress::Bar);
        assert_eq!(shown(When::Never, false, true), Progress::Hidden);
        assert_eq!(shown(When::Always, true, true), Progress::Hidden);
    }

    #[test]
    fn threads_of_the_command_line_are_the_jobs() {
        let machine = Machine { threads: Some(3), profile: false, progress: When::Auto };
        assert_eq!(machine.overrides(), Some(Override::new("job.threads=3")));
    }
}
