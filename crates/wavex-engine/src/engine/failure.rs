//! Early end of a run: keeps the first cause and stops all threads.

use std::cell::RefCell;
use std::io::ErrorKind;
use std::panic;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, Once};

use super::Options;
use crate::job::Job;
use crate::missing::{self, CHECK_THE_PATH};
use wavex_formats::RecordingFormat;
use wavex_line::stage::{Outputs, StageError};
use wavex_line::system::Unpoisoned as _;

/// A flag that ends a run early; clones share it.
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicBool>, Option<Arc<AtomicBool>>);

impl Cancel {
    /// Requests the end of the run.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// A flag of its own that is also set with this one.
    pub(super) fn child(&self) -> Cancel {
        Cancel(Arc::default(), Some(Arc::clone(&self.0)))
    }

    /// Returns the flag itself, set once the end of the run is requested.
    pub fn flag(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.0)
    }

    /// Returns whether the end of the run was requested.
    pub fn is_cancelled(&self) -> bool {
        let is_set = |flag: &Arc<AtomicBool>| flag.load(Ordering::Relaxed);
        is_set(&self.0) || self.1.as_ref().is_some_and(is_set)
    }
}

/// Failure of a run, with its stage and input.
#[derive(Debug)]
pub struct RunError {
    /// Name of the stage in the job.
    pub stage: Option<String>,
    /// Input that was being processed; `None` if the error does not depend on it.
    pub input: Option<PathBuf>,
    /// The cause.
    pub cause: Cause,
}

/// Cause of the end of a run.
#[derive(Debug)]
pub enum Cause {
    /// A stage failed.
    Stage(StageError),
    /// A stage panicked, which is a bug in wavex.
    Panic(String),
    /// The user interrupted the run.
    Interrupted,
}

impl RunError {
    /// An error of the job as a whole.
    pub fn of_job(error: StageError) -> RunError {
        RunError { stage: None, input: None, cause: Cause::Stage(error) }
    }

    /// Converts the error for a caller that is itself part of a run.
    pub fn into_stage_error(self) -> StageError {
        match self {
            RunError { stage: None, input: None, cause: Cause::Stage(error) } => error,
            other => {
                let text = other.to_string();
                let (problem, remedy) = text.split_once("; ").unwrap_or((&text, "see the log"));
                StageError::failed(problem, remedy)
            }
        }
    }

    /// Next step for an input that does not exist; `None` if no recording is similar.
    fn meant(&self) -> Option<String> {
        let is_recording = |path: &Path| RecordingFormat::of(path).is_some();
        let input = self.input.as_deref().filter(|path| matches!(path.try_exists(), Ok(false)))?;
        missing::remedy(input, is_recording)
    }
}

impl std::error::Error for RunError {}

impl std::fmt::Display for RunError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if let Some(stage) = &self.stage {
            write!(f, "stage {stage}: ")?;
        }
        match &self.cause {
            Cause::Stage(error) => {
                // Errors of formats already name their file.
                if let (StageError::Failed { .. } | StageError::Georef(_), Some(input)) =
                    (error, self.input.as_deref().filter(named))
                {
                    write!(f, "{}: ", input.display())?;
                }
                let text = error.to_string();
                let problem = text.strip_suffix(CHECK_THE_PATH);
                match problem.and_then(|problem| Some((problem, self.meant()?))) {
                    Some((problem, remedy)) => write!(f, "{problem}{remedy}"),
                    None => f.write_str(&text),
                }
            }
            Cause::Panic(message) => write!(
                f,
                "bug in wavex: {message}; please report it with the job and, if possible, the input{}",
                self.input
                    .as_deref()
                    .filter(named)
                    .map_or(String::new(), |input| format!(" {}", input.display()))
            ),
            Cause::Interrupted => write!(f, "interrupted; unfinished outputs were removed"),
        }
    }
}

fn named(path: &&Path) -> bool {
    !path.as_os_str().is_empty()
}

/// Files whose errors concern all inputs of a run.
#[derive(Debug)]
pub(super) struct SharedFiles<'r> {
    /// Files that stages read for every input.
    read: Vec<PathBuf>,
    written: &'r Outputs,
}

impl<'r> SharedFiles<'r> {
    pub(super) fn new(job: &Job, options: &Options, written: &'r Outputs) -> SharedFiles<'r> {
        let names = job.stages.iter().flat_map(|stage| &stage.planned.inputs);
        let geometry = &job.settings.geometry;
        let trajectory = [&geometry.trajectory, &geometry.trajectory_accuracy];
        let trajectory = trajectory.into_iter().flatten().filter(|name| !name.contains('*'));
        let read = names.chain(trajectory).map(|name| options.input_dir.join(name)).collect();
        SharedFiles { read, written }
    }

    /// Returns whether an error is not of one input, so that the others would fail as well.
    pub(super) fn concern(&self, error: &RunError) -> bool {
        match &error.cause {
            Cause::Interrupted => true,
            Cause::Panic(_) => false,
            Cause::Stage(StageError::Format(error)) => {
                self.read.iter().any(|file| file == error.file()) || self.cannot_be_written(error)
            }
            Cause::Stage(_) => error.input.is_none(),
        }
    }

    /// Returns whether the disk is full, or the system refuses an output or its folder.
    fn cannot_be_written(&self, error: &wavex_formats::Error) -> bool {
        let wavex_formats::Error::Io { file, source, .. } = error else { return false };
        let is_full = matches!(
            source.kind(),
            ErrorKind::StorageFull | ErrorKind::QuotaExceeded | ErrorKind::FileTooLarge
        );
        is_full || self.written.values().flatten().any(|output| output.starts_with(file))
    }
}

/// Shared failure state of the threads of one chain.
#[derive(Debug)]
pub(super) struct Failure {
    first: Mutex<Option<RunError>>,
    stopping: AtomicBool,
    cancel: Cancel,
}

impl Failure {
    pub(super) fn new(cancel: Cancel) -> Failure {
        Failure { first: Mutex::default(), stopping: AtomicBool::new(false), cancel }
    }

    /// Returns whether the threads should end.
    pub(super) fn stopping(&self) -> bool {
        self.stopping.load(Ordering::Relaxed) || self.cancel.is_cancelled()
    }

    /// Records the first cause and stops all threads.
    ///
    /// `StageError::Stopped` is a consequence of another failure and is not recorded.
    pub(super) fn fail(&self, stage: &str, input: Option<&Path>, cause: Cause) {
        if !matches!(cause, Cause::Stage(StageError::Stopped)) {
            let mut first = self.first.lock().unpoisoned();
            first.get_or_insert(RunError {
                stage: Some(stage.to_string()),
                input: input.map(Path::to_path_buf),
                cause,
            });
        }
        self.stopping.store(true, Ordering::SeqCst);
    }

    /// The cause of the end, unless the run succeeded.
    pub(super) fn into_error(self, input: &Path) -> Option<RunError> {
        let first = self.first.into_inner().unpoisoned();
        let interrupted =
            || RunError { stage: None, input: Some(input.to_path_buf()), cause: Cause::Interrupted };
        match first {
            Some(error) => Some(error),
            None if self.cancel.is_cancelled() => Some(interrupted()),
            None if self.stopping.into_inner() => Some(RunError {
                stage: None,
                input: Some(input.to_path_buf()),
                cause: Cause::Panic("the stages stopped without a cause".into()),
            }),
            None => None,
        }
    }
}

thread_local! {
    static PANIC: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Suppresses the output of panics in stages and keeps their messages for [`guarded`].
pub(super) fn catch_panic_messages() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let usual = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            let of_a_stage =
                std::thread::current().name().is_some_and(|name| name.starts_with(THREAD_PREFIX));
            if !of_a_stage {
                return usual(info);
            }
            let what = info.payload_as_str().unwrap_or("no message");
            let place = info.location().map_or(String::new(), |at| format!(" ({}:{})", at.file(), at.line()));
            PANIC.set(Some(format!("{what}{place}")));
        }));
    });
}

/// Prefix of the names of the engine's threads.
pub(super) const THREAD_PREFIX: &str = "wavex:";

/// Runs the body of a thread; converts a panic into a cause.
pub(super) fn guarded<T>(body: impl FnOnce() -> Result<T, StageError>) -> Result<T, Cause> {
    match panic::catch_unwind(panic::AssertUnwindSafe(body)) {
        Ok(result) => result.map_err(Cause::Stage),
        Err(_) => Err(Cause::Panic(PANIC.take().unwrap_or_else(|| "no message".into()))),
    }
}

/// Error if the system refuses a thread.
pub(super) fn no_thread(error: &dyn std::fmt::Display) -> RunError {
    RunError::of_job(StageError::failed(
        format!("cannot start a thread: {error}"),
        "lower `threads` or raise the process limit of the system",
    ))
}
