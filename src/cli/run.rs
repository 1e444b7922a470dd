//! `wavex run`: reads and runs a job.

use std::fmt::Write as _;
use std::io::IsTerminal;
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, TryLockError};
use std::time::Duration;

use super::args::ResumeCheck;
use super::run_files::RunFiles;
use super::{Failure, JobArgs, Machine, When, log, terminal};
use crate::archive::{Recorder, check_destination};
use crate::engine::{
    self, Cancel, Cause, InputStatus, InputSummary, Options, ProgressMode, ProgressWatch, RunError,
    RunSummary,
};
use crate::georef::check_crs;
use crate::job::{Job, Override};
use crate::report;
use crate::stage::{StageError, counted, release_all, remove_unfinished_files};
use wavex_formats::Error;

/// Reads and runs the job; `archive` names the archive to make, `resume` skips complete inputs.
pub(super) fn run(
    args: &JobArgs,
    machine: Machine,
    archive: Option<&Path>,
    resume: Option<ResumeCheck>,
    relearn: bool,
    quiet: bool,
) -> Result<(), Failure> {
    let job = args.read(machine.overrides())?;
    if let Some(archive) = archive {
        check_destination(archive).map_err(|error| Failure::Wrong(error.to_string()))?;
    }
    if resume.is_some() && job.settings.report.is_empty() {
        let problem =
            "--resume reads the report of the earlier run, but this job writes none; set `report` in `[job]`";
        return Err(Failure::Wrong(problem.to_owned()));
    }
    let asked = Asked { archive, resume, relearn, ..Asked::of(machine, quiet) };
    run_archived(&job, &args.folder(), asked).map(drop).map_err(Failure::from)
}

/// How a job is run.
struct Asked<'a> {
    machine: Machine,
    archive: Option<&'a Path>,
    resume: Option<ResumeCheck>,
    relearn: bool,
    quiet: bool,
    /// Flag that ends the run; `None`: signals end it.
    cancel: Option<Cancel>,
    watch: Option<ProgressWatch>,
}

impl Asked<'_> {
    fn of(machine: Machine, quiet: bool) -> Self {
        Asked { machine, archive: None, resume: None, relearn: false, quiet, cancel: None, watch: None }
    }
}

/// A run that a program requests; see [`run_quietly`].
#[derive(Debug)]
pub struct RunRequest<'a> {
    /// The job.
    pub job: &'a Job,
    /// Folder at which its relative paths start.
    pub folder: &'a Path,
    /// Whether to write a trace.
    pub profile: bool,
    /// Ends the run early when set.
    pub cancel: Cancel,
    /// Receives the progress.
    pub watch: ProgressWatch,
}

/// Results of a run.
#[derive(Debug)]
pub struct FinishedRun {
    /// The run.
    pub run: RunSummary,
    /// Its report, JSON.
    pub report: String,
    /// Files of the run as a whole: report, log, statistics.
    pub written: Vec<PathBuf>,
}

/// Failure of a run.
#[derive(Debug)]
pub struct RunFailure {
    /// Message for the user: problem and remedy.
    pub message: String,
    /// Whether the job is invalid, so that nothing was run.
    pub is_invalid: bool,
    /// First failure with its stage and input, if it is one of the engine.
    pub error: Option<RunError>,
}

impl RunFailure {
    fn of(error: impl std::fmt::Display) -> RunFailure {
        RunFailure { message: error.to_string(), is_invalid: false, error: None }
    }

    fn of_engine(error: RunError) -> RunFailure {
        RunFailure { message: error.to_string(), is_invalid: false, error: Some(error) }
    }
}

impl From<RunFailure> for Failure {
    fn from(failure: RunFailure) -> Failure {
        match failure.is_invalid {
            true => Failure::Wrong(failure.message),
            false => Failure::Run(failure.message),
        }
    }
}

/// Runs a job like `wavex run`, with the same files, but prints nothing and ignores signals.
///
/// One run of the process at a time writes its log: another one waits.
///
/// # Errors
/// As `wavex run`.
pub fn run_quietly(request: RunRequest) -> Result<FinishedRun, RunFailure> {
    static ONE: Mutex<()> = Mutex::new(());
    let _one = loop {
        match ONE.try_lock() {
            Ok(one) => break one,
            Err(TryLockError::Poisoned(one)) => break one.into_inner(),
            Err(TryLockError::WouldBlock) if request.cancel.is_cancelled() => {
                let error = RunError { stage: None, input: None, cause: Cause::Interrupted };
                return Err(RunFailure::of_engine(error));
            }
            Err(TryLockError::WouldBlock) => std::thread::sleep(Duration::from_millis(20)),
        }
    };
    log::begin(0, true);
    let machine = Machine { threads: None, profile: request.profile, progress: When::Never };
    let asked =
        Asked { cancel: Some(request.cancel), watch: Some(request.watch), ..Asked::of(machine, true) };
    let done = run_archived(request.job, request.folder, asked);
    log::end_file();
    done
}

/// Reads a job file with the files that it includes; `set` are overrides such as `decompose.mode=slow`.
///
/// Returns the folder at which its relative paths start, too.
///
/// # Errors
/// If a file cannot be read or the job is invalid.
pub fn read_job(path: &Path, set: &[String]) -> Result<(Job, PathBuf), Failure> {
    let args = JobArgs { job: path.to_owned(), set: set.to_owned() };
    Ok((args.read(None)?, args.folder()))
}

/// Runs a job whose relative paths start at `folder`.
pub(super) fn run_job(
    job: &Job,
    folder: &Path,
    machine: Machine,
    quiet: bool,
) -> Result<RunSummary, Failure> {
    let done = run_archived(job, folder, Asked::of(machine, quiet))?;
    Ok(done.run)
}

fn run_archived(job: &Job, folder: &Path, asked: Asked) -> Result<FinishedRun, RunFailure> {
    let Asked { machine, archive, resume, relearn, quiet, cancel, watch } = asked;
    let silent = cancel.is_some();
    for note in &job.notes {
        tracing::warn!("{note}");
    }
    let (input_dir, output_dir) = folders(job, folder);
    check_crs(&job.settings.geometry, &input_dir)
        .map_err(|error| RunFailure { is_invalid: true, ..RunFailure::of(error) })?;
    let failed = |error: &dyn std::fmt::Display| RunFailure::of(error);
    let mut files = RunFiles::new(job, [&input_dir, &output_dir], machine.profile, resume);
    // Claim the files before opening the log, which would truncate the log of another run.
    let _locks = files.claim(job, &input_dir, archive).map_err(|error| failed(&error))?;
    if archive.is_some() {
        log::keep();
    }
    if let Some(path) = files.log() {
        log::to_file(&path).map_err(|error| failed(&error))?;
    }
    tracing::info!("wavex {}: {} ({})", env!("CARGO_PKG_VERSION"), job.name, job.chain());
    for (name, words) in report::geometry_words(&job.settings.geometry) {
        tracing::info!("{name}: {words}");
    }
    let mut options = Options {
        observers: files.observers(),
        profile: machine.profile,
        progress: machine.progress(quiet, std::io::stderr().is_terminal()),
        watch,
        ..Options::of_job(job, input_dir, &output_dir)
    };
    match cancel {
        Some(cancel) => options.cancel = cancel,
        None => stop_on_signals(&options.cancel),
    }
    files.check().map_err(|error| failed(&error))?;
    let logged = |error: &dyn std::fmt::Display| {
        log::fatal(error);
        failed(error)
    };
    let recorder = archive.map(|archive| Recorder::begin(job, &options, archive)).transpose();
    let recorder = recorder.map_err(|error| logged(&error))?;
    let archived = recorder.as_ref().map(|recorder| recorder.job(job)).transpose();
    let archived = archived.map_err(|error| logged(&error))?;
    let keeps_models = resume.is_some() && !relearn;
    let earlier = if keeps_models { files.earlier_models(job, &options) } else { None };
    options.survey = match earlier {
        Some(models) => Some(models),
        None => engine::survey_models(job, &options)
            .map_err(|error| {
                log::fatal(&error);
                RunFailure::of_engine(error)
            })?
            .map(Arc::new),
    };
    let mut run = RunSummary::new(job, &options);
    let mut first = None;
    let messages;
    (options.skip, messages) = files.plan(job, &options.input_dir, &run, resume.is_some());
    for message in &messages {
        tracing::info!("{message}");
        if !quiet {
            terminal::print_message(&format!("{message}\n"));
        }
    }
    let ended = engine::run_each(
        archived.as_ref().unwrap_or(job),
        &options,
        &mut run,
        &mut |run: &mut RunSummary, number, failure| {
            if let Some(recorder) = &recorder {
                recorder.strip(&mut run.inputs[number]);
            }
            // The error of a single input is that of the command.
            if let Some(error) = failure {
                if run.inputs.len() > 1 {
                    log::fatal(&error);
                    if !silent {
                        terminal::print_failure(&failed(&error).into());
                    }
                }
                first.get_or_insert(error);
            }
            let has_failed = run.inputs[number].status == InputStatus::Failed;
            files.update(run, number).or_else(|error| match has_failed {
                true => {
                    // The run already has an error.
                    tracing::warn!("{error}");
                    Ok(())
                }
                false => Err(error),
            })
        },
    );
    if let Err(error) = &ended
        && run.inputs.iter().all(|input| input.status == InputStatus::NotRun)
    {
        files.not_begun(&run, &error.to_string());
    }
    let is_done = |input: &InputSummary| input.status == InputStatus::Done;
    let to_archive = recorder.zip(archive).filter(|_| ended.is_ok() && run.inputs.iter().any(is_done));
    let finished = finish(&run, &mut files, to_archive, machine.profile);
    let failure = match (&ended, &finished) {
        (Err(error), _) => Some(error.to_string()),
        (Ok(()), Err(error)) => Some(error.to_string()),
        (Ok(()), Ok(_)) => failed_inputs(&run),
    };
    if let Ok(said) = &finished
        && !quiet
        && (failure.is_none() || run.inputs.len() > 1)
    {
        terminal::print(said).map_err(|failure| RunFailure::of(failure.text()))?;
    }
    if let Some(message) = failure {
        log::fatal(&message);
        return Err(RunFailure { message, is_invalid: false, error: first.or(ended.err()) });
    }
    let report = files.report(&run).to_json().map_err(|error| failed(&error))?;
    let written = files.written(&run);
    drop(files);
    Ok(FinishedRun { run, report, written })
}

/// Completes report, trace and archive of a run; returns its summary for the user.
fn finish(
    run: &RunSummary,
    files: &mut RunFiles,
    archive: Option<(Recorder, &Path)>,
    profile: bool,
) -> Result<String, StageError> {
    files.complete(run)?;
    // A problem with this page costs neither trace nor archive.
    let survey = files.write_survey(run);
    files.write_trace(run)?;
    for (note, inputs) in run.repeated_notes() {
        tracing::warn!("{inputs} of {} inputs: {note}", run.inputs.len());
    }
    let mut said = summary(run, &files.written(run), profile);
    if run.inputs.len() > 1 {
        said.push_str(&report::input_table(&files.report(run)));
    }
    if let Some((recorder, archive)) = archive {
        let text = files.report(run).to_json().map_err(std::io::Error::from);
        let text = text.map_err(Error::io(archive, "write the report"))?;
        let seals = recorder.finish(run, text, &log::kept())?;
        let _ = writeln!(said, "results {}", seals.results);
        let _ = writeln!(said, "archived in {}; seal {}", archive.display(), seals.seal);
    }
    survey.map(|()| said)
}

/// Error of a run with failed inputs.
fn failed_inputs(run: &RunSummary) -> Option<String> {
    let failed: Vec<&InputSummary> =
        run.inputs.iter().filter(|input| input.status == InputStatus::Failed).collect();
    match failed.as_slice() {
        [] => None,
        [only] if run.inputs.len() == 1 => only.failure.clone(),
        _ => {
            let stems: Vec<&str> = failed.iter().map(|input| input.stem.as_str()).collect();
            Some(format!("{} of {} inputs failed: {}", failed.len(), run.inputs.len(), stems.join(", ")))
        }
    }
}

/// Time in which an interrupted run may end in order.
const TIME_TO_STOP: Duration = Duration::from_millis(800);

/// Ends the process without waiting for its stages.
fn end_process() -> ! {
    remove_unfinished_files();
    release_all();
    let error = RunError { stage: None, input: None, cause: Cause::Interrupted };
    let interrupted = Failure::Run(error.to_string());
    terminal::print_failure(&interrupted);
    std::process::exit(interrupted.exit_code().into());
}

/// Ends the run in order on Ctrl-C or a termination request.
///
/// Every stage completes its current line first, if that takes less than [`TIME_TO_STOP`]. A second signal
/// ends the process at once.
pub(super) fn stop_on_signals(cancel: &Cancel) {
    let cancel = cancel.clone();
    let handler = move || {
        if cancel.is_cancelled() {
            end_process();
        }
        cancel.cancel();
        // The handler must be free for a second signal.
        let _ = std::thread::Builder::new().spawn(|| {
            std::thread::sleep(TIME_TO_STOP);
            end_process();
        });
    };
    if let Err(error) = ctrlc::set_handler(handler) {
        tracing::debug!("cannot install the signal handler: {error}");
    }
}

/// Summary for the user: times, rejections and outputs of each input.
///
/// `own` are the files of the run as a whole.
fn summary(run: &RunSummary, own: &[PathBuf], profile: bool) -> String {
    let mut text = String::new();
    for input in run.inputs.iter().filter(|input| input.status == InputStatus::Done) {
        let totals = |name: &str| input.totals.get(name).copied().unwrap_or(0);
        let (waveforms, returns) = (totals("nw"), totals("np"));
        let _ =
            writeln!(text, "{}: {waveforms} waveforms, {returns} returns, {:.1} s", input.stem, input.wall_s);
        text.push_str(&report::stage_table(input));
        if profile {
            text.push_str(&report::latency_table(input));
        }
        for stage in &input.stages {
            for (what, n) in &stage.rejected {
                let _ = writeln!(text, "{}: rejected {}", stage.id, counted(*n, what));
            }
        }
        wrote(&mut text, &input.outputs);
    }
    wrote(&mut text, own);
    text
}

fn wrote(text: &mut String, paths: &[PathBuf]) {
    for path in paths {
        let path = terminal::shown(path);
        tracing::info!("wrote {}", path.display());
        let _ = writeln!(text, "wrote {}", path.display());
    }
}

/// Input and output folders of a job stored in `folder`.
pub(super) fn folders(job: &Job, folder: &Path) -> (PathBuf, PathBuf) {
    let from = |dir: &Option<String>| {
        let Some(dir) = dir else { return folder.to_path_buf() };
        let path = folder.join(dir);
        // Messages are easier to read without `plan/tasks/../..`.
        match terminal::shown(&path) {
            short if path.components().any(|step| step == Component::ParentDir) => short,
            _ => path,
        }
    };
    (from(&job.settings.input_dir), from(&job.settings.output_dir))
}

impl Machine {
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
    use crate::job::JobSettings;

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
    fn a_bar_is_for_terminals() {
        let shown = |progress, quiet, on_terminal| {
            Machine { threads: None, profile: false, progress }.progress(quiet, on_terminal)
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
        let machine = Machine { threads: Some(3), profile: false, progress: When::Auto };
        assert_eq!(machine.overrides(), Some(Override::new("job.threads=3")));
    }
}
