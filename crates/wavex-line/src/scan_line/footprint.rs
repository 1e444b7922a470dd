//! Footprints: ground, canopy and relative heights of a shot whose footprint holds many targets.

use wavex_footprints::{HEIGHTS, WithSd};

/// Ground, canopy and relative heights of a shot with a large footprint.
///
/// Set by `measure_footprints`. Ranges as in [`Return`](super::Return); heights are along the beam, from the
/// ground upwards. Unknown values are NaN.
#[derive(Clone, Debug, PartialEq)]
pub struct Footprint {
    /// Index of the shot in the line.
    pub emission: u32,
    /// Number of the shot in its mission; the running number if it has none.
    pub shot_number: u64,
    /// The ground. Its return has class 2.
    pub ground: GroundCandidate,
    /// Range at which the signal begins, m: the top of the canopy.
    pub top_range_m: WithSd,
    /// Heights above the ground below which 0, 1, … 100 % of the energy lie, m.
    pub heights_m: Box<[f32; HEIGHTS]>,
    /// Their standard deviations, m.
    pub heights_sd_m: Box<[f32; HEIGHTS]>,
    /// Number of significant modes.
    pub modes: u32,
    /// Energy, as the height of a flat target's echo of the same energy, digitiser steps.
    pub energy_dn: WithSd,
    /// Energy of the ground's mode over the energy of the waveform.
    pub ground_energy_ratio: WithSd,
    /// Part of the footprint that the canopy covers, seen along the beam.
    pub cover: WithSd,
    /// Plant area index: area of leaves and branches per area of ground.
    pub plant_area_index: WithSd,
    /// Cover of a canopy through which the ground would be found with a probability of 0.9.
    pub sensitivity: f64,
    /// Deviation ratio of the modes' fit.
    pub deviation_ratio: f64,
    /// Bits of [`footprint_flags`].
    pub flags: u8,
    /// Values of the recording's further columns ([`super::InputInfo::columns`]).
    pub columns: Box<[f64]>,
}

/// A mode that may be the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundCandidate {
    /// Its range, m.
    pub range_m: WithSd,
    /// Probability that it is the ground; 0 if there is no such mode.
    pub probability: f64,
}

/// Bits of [`Footprint::flags`].
pub mod footprint_flags {
    /// There is no ground: no mode is significant, or the signal continues at the end of the block.
    pub const GROUND_MISSING: u8 = 1;
    /// The signal begins before the block.
    pub const TOP_MISSING: u8 = 1 << 1;
    /// Samples are clipped.
    pub const CLIPPED: u8 = 1 << 2;
    /// The ground has a probability below 0.9.
    pub const AMBIGUOUS: u8 = 1 << 3;
    /// The instrument's own flags advise against the shot (degraded pointing, stale waveform).
    pub const DEGRADED: u8 = 1 << 4;
}
