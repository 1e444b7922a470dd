//! Footprints: ground, canopy and relative heights of a shot whose footprint holds many targets.

use wavex_footprints::{HEIGHTS, WithSd};

/// Names of instruments with large footprints, as whole words.
const INSTRUMENTS: [&str; 3] = ["LVIS", "GEDI", "GLAS"];
/// Shortest waveform of an instrument with large footprints, ns.
///
/// LVIS records 864 ns and GEDI 700 ns and more, whole crowns with the ground. Small-footprint instruments record at most
/// 256 ns around their echoes.
pub const LARGE_FOOTPRINT_NS: f64 = 400.0;
/// Highest pulse rate of an instrument with large footprints, Hz: each needs a pulse of several mJ.
const LARGE_FOOTPRINT_RATE_HZ: f64 = 5_000.0;

/// Whether a recording has footprints of about 10 m and more, profiles of ground and canopy.
///
/// Decides by the name of the instrument, or else by the length of the waveforms, ns, and the pulse rate, Hz; NaN where
/// unknown. Pulse width, divergence and height do not decide: converters fill the width with a constant, and few files
/// state the others.
pub fn has_large_footprints(instrument: Option<&str>, length_ns: f64, rate_hz: f64) -> bool {
    let mut words = instrument.unwrap_or_default().split(|letter: char| !letter.is_alphanumeric());
    let is_named = words.any(|word| INSTRUMENTS.contains(&word));
    is_named || (length_ns >= LARGE_FOOTPRINT_NS && rate_hz < LARGE_FOOTPRINT_RATE_HZ)
}

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_or_long_waveforms_at_a_low_rate_are_of_large_footprints() {
        let lvis = Some("NASA Laser Vegetation Imaging Sensor (LVIS)");
        assert!(has_large_footprints(lvis, f64::NAN, f64::NAN));
        assert!(has_large_footprints(None, 864.0, 500.0), "unnamed");
        assert!(!has_large_footprints(Some("LVISION"), 256.0, 500.0), "part of a word");
        assert!(!has_large_footprints(Some("Q680"), 240.0, 150_000.0));
        assert!(!has_large_footprints(None, 864.0, 150_000.0), "of a long block");
        assert!(!has_large_footprints(None, 240.0, 1_000.0), "of a slow scanner");
        assert!(!has_large_footprints(None, 864.0, f64::NAN), "of one shot");
    }
}
