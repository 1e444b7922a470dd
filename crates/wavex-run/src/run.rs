//! Runs a job like `wavex run`: with report, page, log, statistics and archive.

use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, TryLockError};
use std::time::Duration;

use crate::archive::Recorder;
use crate::archive::shown;
use crate::{Failure, log};
use wavex_engine::engine::{
    self, Cancel, Cause, InputStatus, InputSummary, Options, ProgressMode, ProgressWatch, RunError,
    RunSummary,
};
use wavex_engine::job::Job;
use wavex_formats::Error;
use wavex_line::georef::check_crs;
use wavex_line::stage::StageError;
use wavex_pages::report::{self, InputEntry, RunReport};

mod ending;
mod files;
mod replaced;
mod resume;
mod since;
mod survey_files;

use ending::Detail;
pub use ending::{EndMessage, Ending};
use files::RunFiles;
pub use since::changes_since;

/// A run of a job, with its report, page, log, statistics and archive.
pub struct RunRequest<'a> {
    /// The job.
    pub job: &'a Job,
    /// Folder at which its relative paths start.
    pub folder: &'a Path,
    /// Archive to make.
    pub archive: Option<&'a Path>,
    /// Comparison by which inputs that an earlier run has completed are recognised and skipped; `None`: all
    /// are processed.
    pub resume: Option<ResumeCheck>,
    /// Whether a resumed run learns the sensor models of its survey again.
    pub relearn: bool,
    /// Whether to write a trace.
    pub profile: bool,
    /// Whether the end of the run says what each stage did.
    pub with_stages: bool,
    /// Progress display.
    pub progress: ProgressMode,
    /// Ends the run early when set.
    pub cancel: Cancel,
    /// Receives the progress.
    pub watch: Option<ProgressWatch>,
    /// Receives the messages.
    pub listener: &'a dyn Listener,
}

impl<'a> RunRequest<'a> {
    /// A run that says and shows nothing, without an archive.
    pub fn quiet(job: &'a Job, folder: &'a Path) -> RunRequest<'a> {
        RunRequest {
            job,
            folder,
            archive: None,
            resume: None,
            relearn: false,
            profile: false,
            with_stages: false,
            progress: ProgressMode::Hidden,
            cancel: Cancel::default(),
            watch: None,
            listener: &(),
        }
    }
}

/// What files are compared by to recognise changes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResumeCheck {
    /// Size and modification time.
    Time,
    /// BLAKE3 digest.
    Digest,
}

/// Receives the messages of a run.
pub trait Listener {
    /// Whether an input of an earlier run is skipped, and why not.
    fn resume_decision(&self, _message: &str) {}

    /// One of several inputs has failed.
    fn input_failed(&self, _message: &str) {}

    /// The run has ended: results, rejections and files.
    ///
    /// # Errors
    /// The messages could not be delivered, and why.
    fn ended(&self, _ending: &Ending) -> Result<(), Failure> {
        Ok(())
    }
}

impl Listener for () {}

/// Results of a run.
#[derive(Debug)]
pub struct FinishedRun {
    /// The run.
    pub run: RunSummary,
    /// Entries of its report.
    entries: Vec<InputEntry>,
    /// Files of the run as a whole: report, log, statistics.
    pub written: Vec<PathBuf>,
}

impl FinishedRun {
    /// Report of the run.
    pub fn report(&self) -> RunReport<'_> {
        RunReport { run: &self.run, inputs: &self.entries }
    }
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

/// Runs a job and keeps its log, without any output to the terminal.
///
/// One run of the process at a time writes its log: another one waits.
///
/// # Errors
/// As [`run`].
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
    log::begin(0, true, false);
    let done = run(request);
    log::end_file();
    done
}

/// Runs a job like `wavex run`, with the same files.
///
/// # Errors
/// As `wavex run`.
pub fn run(request: RunRequest) -> Result<FinishedRun, RunFailure> {
    let RunRequest {
        job,
        folder,
        archive,
        resume,
        relearn,
        profile,
        with_stages,
        progress,
        cancel,
        watch,
        listener,
    } = request;
    let detail = Detail { stages: with_stages || profile, latencies: profile };
    for note in &job.notes {
        tracing::warn!("{note}");
    }
    let (input_dir, output_dir) = folders(job, folder);
    check_crs(&job.settings.geometry, &input_dir)
        .map_err(|error| RunFailure { is_invalid: true, ..RunFailure::of(error) })?;
    let failed = |error: &dyn std::fmt::Display| RunFailure::of(error);
    let mut files = RunFiles::new(job, [&input_dir, &output_dir], profile, resume);
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
        profile,
        progress,
        cancel,
        watch,
        ..Options::of_job(job, input_dir, &output_dir)
    };
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
        listener.resume_decision(message);
    }
    for warning in files.replaced(job, &options.input_dir) {
        tracing::warn!("{warning}");
    }
    let ended = engine::run_each(
        archived.as_ref().unwrap_or(job),
        &options,
        &mut run,
        &mut |run: &mut RunSummary, number, failure| {
            if let Some(recorder) = &recorder {
                recorder.strip(&mut run.inputs[number]);
            }
            // The error of a single input is the error of the command.
            if let Some(error) = failure {
                if run.inputs.len() > 1 {
                    log::fatal(&error);
                    listener.input_failed(&error.to_string());
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
    let finished = finish(&run, job, &mut files, to_archive, detail);
    let failure = match (&ended, &finished) {
        (Err(error), _) => Some(error.to_string()),
        (Ok(()), Err(error)) => Some(error.to_string()),
        (Ok(()), Ok(_)) => failed_inputs(&run),
    };
    if let Ok(ending) = &finished
        && (failure.is_none() || run.inputs.len() > 1)
    {
        listener.ended(ending).map_err(|failure| RunFailure::of(failure.text()))?;
    }
    if let Some(message) = failure {
        if run.inputs.len() == 1
            && let Some(said) = files.of_failed(&run)
        {
            listener.ended(&Ending(vec![said])).map_err(|failure| RunFailure::of(failure.text()))?;
        }
        log::fatal(&message);
        return Err(RunFailure { message, is_invalid: false, error: first.or(ended.err()) });
    }
    let written = files.written(&run).concat();
    Ok(FinishedRun { run, entries: files.into_entries(), written })
}

/// The names of all inputs, or of the first ones.
fn few_names(names: &[&str]) -> String {
    const FEW: usize = 4;
    match names.get(..FEW) {
        Some(first) if names.len() > FEW => format!("{}, …", first.join(", ")),
        _ => names.join(", "),
    }
}

/// Completes report, trace and archive of a run; returns its messages for the user.
fn finish(
    run: &RunSummary,
    job: &Job,
    files: &mut RunFiles,
    archive: Option<(Recorder, &Path)>,
    detail: Detail,
) -> Result<Ending, StageError> {
    files.complete(run)?;
    // A problem with this page costs neither trace nor archive.
    let survey = files.write_survey(run).map(|not_compared| {
        not_compared.iter().for_each(|strip| tracing::warn!("{strip}"));
    });
    files.write_trace(run)?;
    for (note, inputs) in run.repeated_notes() {
        let named = few_names(&inputs);
        tracing::warn!("{} of {} inputs ({named}): {note}", inputs.len(), run.inputs.len());
    }
    let table = (run.inputs.len() > 1).then(|| report::input_table(&files.report(run)));
    let [of_run, of_inputs] = files.written(run);
    let of_stages = run.inputs.iter().flat_map(|input| &input.outputs);
    for path in of_stages.chain(&of_inputs).chain(&of_run) {
        tracing::info!("wrote {}", shown(path).display());
    }
    let mut messages = ending::messages(run, table, [&of_run, &of_inputs], detail);
    if run.inputs.iter().any(|input| input.status == InputStatus::Done) {
        messages.extend(files.next(job));
    }
    if let Some((recorder, archive)) = archive {
        let text = files.report(run).to_json().map_err(std::io::Error::from);
        let text = text.map_err(Error::io(archive, "write the report"))?;
        let seals = recorder.finish(run, text, &log::kept())?;
        messages.push(EndMessage::File(format!("results {}", seals.results)));
        messages.push(EndMessage::File(format!("archived in {}; seal {}", archive.display(), seals.seal)));
    }
    survey.map(|()| Ending(messages))
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

/// Input and output folders of a job stored in `folder`.
pub fn folders(job: &Job, folder: &Path) -> (PathBuf, PathBuf) {
    let from = |dir: &Option<String>| {
        let Some(dir) = dir else { return folder.to_path_buf() };
        let path = folder.join(dir);
        // Messages are easier to read without `plan/tasks/../..`.
        match shown(&path) {
            short if path.components().any(|step| step == Component::ParentDir) => short,
            _ => path,
        }
    };
    (from(&job.settings.input_dir), from(&job.settings.output_dir))
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_engine::job::JobSettings;

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
}
