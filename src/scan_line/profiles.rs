//! Profiles of distributed targets.

use wavex_signal::distributed::{RELATIVE_HEIGHTS, WithSd};

/// Continuous profile of a shot's target along the beam.
///
/// Set by `decompose` for waveforms that pulses do not explain. Ranges as in
/// [`Return`](super::Return); later corrections do not change them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShotProfile {
    /// Index of the shot in the line.
    pub emission: u32,
    /// Range of the first clear peak, m.
    pub first_range_m: WithSd,
    /// Range of the last clear peak, m.
    pub last_range_m: WithSd,
    /// Number of clear peaks.
    pub peaks: u32,
    /// Heights above the last peak, along the beam, below which the parts [`RELATIVE_HEIGHTS`] of
    /// the energy lie, m.
    pub heights_m: [WithSd; RELATIVE_HEIGHTS.len()],
    /// Sum of the echo heights, digitiser steps.
    pub energy_dn: WithSd,
    /// Deviation ratio of the profile.
    pub deviation_ratio: f64,
}
