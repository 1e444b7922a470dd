//! Check of the samples of stages for whole digitiser steps.

use super::{Result, StageError};
use crate::scan_line::ScanLine;

/// Checks that samples are whole digitiser steps, as `stage` needs them: a container may have others.
///
/// # Errors
/// Some are fractions of a step.
pub fn check_whole_steps(line: &ScanLine, stage: &str) -> Result<()> {
    if line.blocks().is_none_or(|blocks| !blocks.has_fractions()) {
        return Ok(());
    }
    Err(StageError::failed(
        format!(
            "`{stage}` needs samples in whole digitiser steps, but the recording has fractions of a step"
        ),
        "measure profiles of large footprints with `measure_footprints` in its place",
    ))
}
