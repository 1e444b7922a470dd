//! The four roles that a stage may play, and what the engine gives a stage to work with.
//!
//! A stage sees no channel, no thread and no clock. What it drops, it drops through [`Context::reject`]; what it
//! measures, it measures through [`Context::observe`]; what the user should know goes through [`Context::note`].

use crate::batch::Batch;

mod context;
mod keys;
mod output_file;
mod output_lock;
mod site;
mod spec;
mod survey;
mod words;

pub use context::{Context, Counters, Distribution, Item};
pub use keys::{FileMark, Key, Keys};
pub(crate) use output_file::partial_path;
pub use output_file::{OutputFile, WholeFile, remove_unfinished_files};
pub use output_lock::{OutputLock, Outputs, give_up_claims};
pub use site::{Paths, Site, fixed_folder};
pub use spec::{
    Config, ConfigError, Holds, InvalidKey, MapConfig, Plan, Planned, RoleName, SinkConfig, SourceConfig,
    SourcePlan, StageSpec, TransformConfig,
};
pub use survey::Survey;
pub use words::{bounds, choices, listed, takes};

/// Why a stage cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum StageError {
    /// A file is not what it should be.
    #[error(transparent)]
    Format(#[from] crate::formats::Error),
    /// Anything else: what is wrong, and what to do about it.
    #[error("{problem}; {remedy}")]
    Failed {
        /// What is wrong.
        problem: String,
        /// What the user can do.
        remedy: String,
    },
    /// The run ends for a reason that is not this stage's.
    #[error("the run is being stopped")]
    Stopped,
}

impl StageError {
    /// What is wrong, and what to do about it.
    pub fn failed(problem: impl Into<String>, remedy: impl Into<String>) -> StageError {
        StageError::Failed { problem: problem.into(), remedy: remedy.into() }
    }
}

/// Shorthand for the results of stages.
pub type Result<T> = std::result::Result<T, StageError>;

/// Makes batches: a reader, or the simulator.
pub trait Source {
    /// The next line, or `None` at the end of the input.
    fn next(&mut self, cx: &mut Context) -> Result<Option<Batch>>;

    /// How far the input has been read, from 0 to 1, where that can be said.
    fn progress(&self) -> Option<f64> {
        None
    }
}

/// Turns one line into one line, with no memory between lines: the engine may run several of them side by side.
pub trait Map {
    /// The line, changed. Its emissions stay; what it cannot keep, it rejects.
    fn map(&mut self, batch: Batch, cx: &mut Context) -> Result<Batch>;
}

/// Holds lines back: for look-ahead, or to learn from the first lines.
pub trait Transform {
    /// Takes a line and gives on what is ready.
    fn process(&mut self, batch: Batch, out: &mut Output) -> Result<()>;

    /// Gives on what was held back.
    fn finish(&mut self, out: &mut Output) -> Result<()>;
}

/// Writes lines; the engine passes each on, so that several sinks may follow one another.
pub trait Sink {
    /// Writes a line.
    fn write(&mut self, batch: &Batch, cx: &mut Context) -> Result<()>;

    /// Completes the files: each whole one is handed to [`Context::keep`], and gets its final name when the whole run
    /// has succeeded.
    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()>;
}

/// Where a [`Transform`] gives on its lines.
pub struct Output<'a> {
    /// Counters and notes.
    pub cx: &'a mut Context,
    emit: &'a mut dyn FnMut(Batch) -> Result<()>,
    may_hold_bytes: usize,
    foreseen_bytes: usize,
}

impl<'a> Output<'a> {
    /// An output that gives on through `emit`.
    pub fn new(
        cx: &'a mut Context,
        may_hold_bytes: usize,
        emit: &'a mut dyn FnMut(Batch) -> Result<()>,
    ) -> Output<'a> {
        Output { cx, emit, may_hold_bytes, foreseen_bytes: 0 }
    }

    /// Gives a line on.
    pub fn emit(&mut self, batch: Batch) -> Result<()> {
        (self.emit)(batch)
    }

    /// Most bytes of lines that a stage may hold back if it can work with fewer lines; it emits what exceeds them. It follows
    /// from the job alone, so that a stage that heeds it does the same on every machine. A stage that needs its lines holds
    /// as many as it needs, and says so by [`Output::foresee`].
    pub fn may_hold_bytes(&self) -> usize {
        self.may_hold_bytes
    }

    /// Says how many bytes the stage will hold back at most, as far as can be seen: where `memory_mb` has no room for the
    /// next line, the run ends with what to set.
    pub fn foresee(&mut self, bytes: usize) {
        self.foreseen_bytes = bytes;
    }

    /// What was foreseen; 0 where nothing was.
    pub fn foreseen_bytes(&self) -> usize {
        self.foreseen_bytes
    }
}
