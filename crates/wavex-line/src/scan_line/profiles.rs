//! Profiles of distributed targets.

use wavex_signal::distributed::{RELATIVE_HEIGHTS, WithSd};

/// Relative heights of the energy of a shot above its ground.
///
/// Set by `decompose`. Ranges as in [`Return`](super::Return); later corrections do not change them.
/// Unknown values are NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShotProfile {
    /// Index of the shot in the line.
    pub emission: u32,
    /// Range of the first significant mode, m.
    pub first_range_m: WithSd,
    /// Range of the last significant mode, the ground, m.
    pub last_range_m: WithSd,
    /// Number of significant modes.
    pub peaks: u32,
    /// Heights above the ground, along the beam, below which the parts [`RELATIVE_HEIGHTS`] of the
    /// energy lie, m.
    pub heights_m: [WithSd; RELATIVE_HEIGHTS.len()],
    /// Height above the ground, along the beam, at which the signal begins, m.
    pub top_m: WithSd,
    /// Energy, as the height of a flat target's echo of the same energy, digitiser steps.
    pub energy_dn: WithSd,
    /// Flags of [`wavex_signal::distributed`].
    pub flags: u8,
}
