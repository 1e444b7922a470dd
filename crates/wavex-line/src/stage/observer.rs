//! Observation of a run, without influence on its results.

use std::fmt::Debug;
use std::sync::Arc;

use super::{FittedShot, Result};
use crate::scan_line::{Emission, Return, ScanLine};
use wavex_geodesy::time_axis::Alignment;
use wavex_geodesy::trajectory::Trajectory;

/// Makes the observers of a run.
pub trait RunObservers: Debug + Send + Sync {
    /// Observer of the input with this stem. Several inputs may run at the same time.
    fn of_input(&self, stem: &str) -> Arc<dyn RunObserver>;
}

/// Observes the lines of an input.
///
/// Engine and stages call it from several threads, so lines arrive in any order.
pub trait RunObserver: Debug + Send + Sync {
    /// Observes a scan line that leaves the chain.
    fn line(&self, line: &ScanLine);

    /// Observes the trajectory of the input, after its last line; `alignment` converts the times of
    /// shots to its axis.
    fn trajectory(&self, _trajectory: &Trajectory, _alignment: &Alignment) {}

    /// Observes the results of `decompose` for a line; fits shots again for display.
    ///
    /// # Errors
    /// Those of `fit`.
    fn decomposed(&self, line: &DecomposedLine, fit: &mut FitShot) -> Result<()>;
}

/// A decomposed line.
#[derive(Clone, Copy, Debug)]
pub struct DecomposedLine<'a> {
    /// Scan line number.
    pub line: u32,
    /// Shots of the line.
    pub emissions: &'a [Emission],
    /// Returns of the line, grouped by shot.
    pub returns: &'a [Return],
}

/// Fits the shot with this index again; `None` if it has no blocks.
pub type FitShot<'a> = dyn FnMut(u32) -> Result<Option<FittedShot>> + 'a;
