//! How a run ends early: the first true cause is kept, and everybody is told to stop.

use std::cell::RefCell;
use std::panic;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, Once};

use crate::stage::StageError;

/// A switch that ends a run early; clones share it.
#[derive(Clone, Debug, Default)]
pub struct Cancel(Arc<AtomicBool>);

impl Cancel {
    /// Asks the run to end.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Whether the run was asked to end.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

/// Why a run failed, and where.
#[derive(Debug)]
pub struct RunError {
    /// The stage, as the job calls it.
    pub stage: Option<String>,
    /// The input that was being worked on.
    pub input: Option<PathBuf>,
    /// What happened.
    pub cause: Cause,
}

/// What ended a run.
#[derive(Debug)]
pub enum Cause {
    /// A stage could not go on.
    Stage(StageError),
    /// A stage panicked: a bug of ours.
    Panic(String),
    /// Somebody asked for it.
    Interrupted,
}

impl RunError {
    /// An error that concerns the job as a whole.
    pub fn of_job(error: StageError) -> RunError {
        RunError { stage: None, input: None, cause: Cause::Stage(error) }
    }

    /// The same as the error of something that a run is a part of.
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
}

impl std::error::Error for RunError {}

impl std::fmt::Display for RunError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if let Some(stage) = &self.stage {
            write!(f, "stage {stage}: ")?;
        }
        match &self.cause {
            Cause::Stage(error) => {
                // An error of a format names its file by itself.
                if let (StageError::Failed { .. }, Some(input)) = (error, self.input.as_deref().filter(named))
                {
                    write!(f, "{}: ", input.display())?;
                }
                write!(f, "{error}")
            }
            Cause::Panic(message) => write!(
                f,
                "a bug in wavex: {message}; please report it with the job and, if you can, the input{}",
                self.input
                    .as_deref()
                    .filter(named)
                    .map_or(String::new(), |input| format!(" {}", input.display()))
            ),
            Cause::Interrupted => write!(f, "interrupted; no unfinished output was left behind"),
        }
    }
}

fn named(path: &&Path) -> bool {
    !path.as_os_str().is_empty()
}

/// Where the threads of one chain meet when something goes wrong.
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

    /// Whether the threads should end.
    pub(super) fn stopping(&self) -> bool {
        self.stopping.load(Ordering::Relaxed) || self.cancel.is_cancelled()
    }

    /// Keeps the cause if it is the first, and tells everybody to stop. An echo of another failure is no cause.
    pub(super) fn fail(&self, stage: &str, input: &Path, cause: Cause) {
        if !matches!(cause, Cause::Stage(StageError::Stopped)) {
            let mut first = self.first.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
            first.get_or_insert(RunError {
                stage: Some(stage.to_string()),
                input: Some(input.to_path_buf()),
                cause,
            });
        }
        self.stopping.store(true, Ordering::SeqCst);
    }

    /// The cause of the end, if it was not a success.
    pub(super) fn into_error(self, input: &Path) -> Option<RunError> {
        let first = self.first.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
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

/// Makes the panics of stages silent, and keeps their messages for [`guarded`].
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

/// What the names of the engine's threads begin with.
pub(super) const THREAD_PREFIX: &str = "wavex:";

/// Runs the body of a thread, and turns a panic into a cause.
pub(super) fn guarded<T>(body: impl FnOnce() -> Result<T, StageError>) -> Result<T, Cause> {
    match panic::catch_unwind(panic::AssertUnwindSafe(body)) {
        Ok(result) => result.map_err(Cause::Stage),
        Err(_) => Err(Cause::Panic(PANIC.take().unwrap_or_else(|| "no message".into()))),
    }
}
