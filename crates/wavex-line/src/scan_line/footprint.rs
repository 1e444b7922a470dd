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
    /// Range of the ground, m; its SD includes shifts by slope and vegetation. Its return has class 2.
    pub ground_range_m: WithSd,
    /// Probability that the lowest mode is the ground.
    pub ground_probability: f64,
    /// SD of the range of the ground that includes the choice, m.
    pub ground_total_sd_m: f64,
    /// Height of the second candidate for the ground above the first, m; negative.
    pub second_ground_height_m: WithSd,
    /// Its probability.
    pub second_ground_probability: f64,
    /// Height of the lowest mode above the background, digitiser steps.
    pub ground_amplitude_dn: WithSd,
    /// Distances from the lowest mode to half its height below and above it, over those of a flat target.
    pub ground_half_width_ratios: [f64; 2],
    /// Heights above the ground below which 0, 1, … 100 % of the energy lie, m; the last one is where the signal begins.
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
    /// Deviation of the waveform from every profile of ground and canopy, in standard deviations.
    pub deviation: f64,
    /// Bits of [`footprint_flags`].
    pub flags: u8,
    /// Values of the recording's further columns ([`super::InputInfo::columns`]).
    pub columns: Box<[f64]>,
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
