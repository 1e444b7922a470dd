//! The four roles of stages, and the interface that the engine gives them.
//!
//! A stage sees no channels, threads or clocks. It drops items through [`Context::reject`], records
//! measurements through [`Context::observe`], and warns the user through [`Context::warn`].

use std::ops::Range;
use std::path::PathBuf;

use crate::georef;
use crate::scan_line::ScanLine;

mod cause;
mod context;
mod fitted;
mod lookahead;
mod names;
mod observer;
mod output_file;
mod output_lock;
pub mod own_file;
pub mod packed;
pub mod pose_source;
mod run_context;
mod spec;
mod stamp;
mod survey_models;
mod whole_steps;

pub use crate::reason::{Item, Reason};
pub use cause::Cause;
pub use context::{Context, Counters, Distribution, counted};
pub use fitted::{CURVE_POINTS_PER_SAMPLE, FittedBlock, FittedPeak, FittedSamples, FittedShot};
pub use lookahead::LookAhead;
pub use names::{find_in, nearest_of};
pub use observer::{DecomposedLine, FitShot, RunObserver, RunObservers};
pub use output_file::partial_path;
pub use output_file::{FinishedFile, OutputFile, remove_unfinished_files};
pub use output_lock::{OutputLock, Outputs, release_all};
pub use run_context::{ChainStage, Paths, RunContext, fixed_folder};
pub use spec::{
    Config, ConfigError, Holds, Learning, Learns, MakeMap, MakeTransform, MapConfig, Plan, Planned, RoleName,
    SinkConfig, SinkPlan, SourceConfig, SourcePlan, StageSpec, TransformConfig,
};
pub use stamp::Stamp;
pub use survey_models::{ChannelDrift, Instrument, InstrumentModel, Measured, SensorDrift, SurveyModels};
pub use survey_models::{check_model, is_valid_fusion};
pub use whole_steps::check_whole_steps;

/// Failure of a stage.
#[derive(Debug, thiserror::Error)]
pub enum StageError {
    /// A file is invalid.
    #[error(transparent)]
    Format(#[from] wavex_formats::Error),
    /// The input cannot be georeferenced.
    #[error(transparent)]
    Georef(georef::Error),
    /// Any other problem, with its remedy.
    #[error("{problem}; {remedy}")]
    Failed {
        /// The problem.
        problem: String,
        /// The remedy.
        remedy: String,
    },
    /// Another run writes an output.
    #[error(
        "{} is being written by another run (process {process}); wait until it ends, or choose another folder with `output_dir`",
        output.display()
    )]
    InUse {
        /// The output.
        output: PathBuf,
        /// Process id of the other run.
        process: u32,
    },
    /// The run ends because of another stage.
    #[error("the run is being stopped")]
    Stopped,
}

impl StageError {
    /// Creates an error from a problem and its remedy.
    pub fn failed(problem: impl Into<String>, remedy: impl Into<String>) -> StageError {
        StageError::Failed { problem: problem.into(), remedy: remedy.into() }
    }
}

impl From<georef::Error> for StageError {
    fn from(error: georef::Error) -> StageError {
        match error {
            georef::Error::Format(error) => StageError::Format(error),
            error => StageError::Georef(error),
        }
    }
}

/// Result of a stage.
pub type Result<T> = std::result::Result<T, StageError>;

/// Location of a scan line in its recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LineLocation {
    /// Records of the file: pulses, points or record batches, from 0.
    pub records: Range<u64>,
    /// First row in the first record.
    pub row: u32,
    /// Number of the line.
    pub line: u32,
    /// Number of its first shot.
    pub first_shot: u64,
    /// Whether the recording ends the line, not a limit of its size.
    pub is_complete: bool,
}

/// Produces scan lines: a reader, or the simulator.
pub trait Source: Send {
    /// Returns the next line, or `None` at the end of the input.
    fn next(&mut self, cx: &mut Context) -> Result<Option<ScanLine>>;

    /// Fraction of the input read, 0 to 1, if known.
    fn progress(&self) -> Option<f64> {
        None
    }

    /// Location of the line that [`Source::next`] returned last.
    ///
    /// `None` if the source cannot return to it.
    fn location(&self) -> Option<LineLocation> {
        None
    }

    /// Reads the line at a location of the same recording again.
    ///
    /// [`Source::next`] continues after it, but may cut lines elsewhere. `None` if the source cannot
    /// seek or has no shot there.
    ///
    /// # Errors
    /// The recording cannot be read.
    fn line_at(&mut self, _location: &LineLocation, _cx: &mut Context) -> Result<Option<ScanLine>> {
        Ok(None)
    }
}

/// Maps one line to one line without state between lines.
///
/// The engine may run several instances in parallel.
pub trait Map {
    /// Processes a line. Keeps its shots; rejects what it drops.
    fn map(&mut self, line: ScanLine, cx: &mut Context) -> Result<ScanLine>;
}

/// Holds lines back, for look-ahead or to learn from the first lines.
pub trait Transform: Send {
    /// Accepts a line and emits the lines that are ready.
    fn process(&mut self, line: ScanLine, out: &mut Output) -> Result<()>;

    /// Emits all lines held back.
    fn finish(&mut self, out: &mut Output) -> Result<()>;
}

/// Writes lines; the engine passes each on, so several sinks may follow each other.
pub trait Sink {
    /// Writes a line.
    fn write(&mut self, line: &ScanLine, cx: &mut Context) -> Result<()>;

    /// Completes the files.
    ///
    /// Hands each finished file to [`Context::publish`]; it gets its final name after all
    /// stages have succeeded.
    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()>;
}

/// Output of a [`Transform`].
pub struct Output<'a> {
    /// Counters and notes.
    pub cx: &'a mut Context,
    emit: &'a mut dyn FnMut(ScanLine) -> Result<()>,
    may_hold_bytes: usize,
    foreseen_bytes: usize,
}

impl<'a> Output<'a> {
    /// Creates an output that forwards lines to `emit`.
    pub fn new(
        cx: &'a mut Context,
        may_hold_bytes: usize,
        emit: &'a mut dyn FnMut(ScanLine) -> Result<()>,
    ) -> Output<'a> {
        Output { cx, emit, may_hold_bytes, foreseen_bytes: 0 }
    }

    /// Emits a line.
    pub fn emit(&mut self, line: ScanLine) -> Result<()> {
        (self.emit)(line)
    }

    /// Maximum memory of lines held back, bytes, for a stage that can work with fewer lines.
    ///
    /// Such a stage emits lines beyond this limit. The limit depends only on the job, so results
    /// are the same on every machine. A stage that requires its lines may exceed it and announces
    /// its demand with [`Output::foresee`].
    pub fn may_hold_bytes(&self) -> usize {
        self.may_hold_bytes
    }

    /// Announces the maximum memory that the stage will hold back, bytes, as far as known.
    ///
    /// If `memory_mb` has no room for the next line, the run ends with an error that states the
    /// required value.
    pub fn foresee(&mut self, bytes: usize) {
        self.foreseen_bytes = bytes;
    }

    /// Announced memory demand, bytes; 0 if none.
    pub fn foreseen_bytes(&self) -> usize {
        self.foreseen_bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_source_cannot_return_to_a_line_unless_it_says_so() {
        struct Empty;
        impl Source for Empty {
            fn next(&mut self, _: &mut Context) -> Result<Option<ScanLine>> {
                Ok(None)
            }
        }
        let location = LineLocation { records: 0..1, row: 0, line: 0, first_shot: 0, is_complete: true };
        assert_eq!((Empty.location(), Empty.progress()), (None, None));
        assert!(matches!(Empty.line_at(&location, &mut Context::default()), Ok(None)));
    }
}
