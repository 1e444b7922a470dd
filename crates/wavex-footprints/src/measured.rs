//! Results of one waveform.

use wavex_simd::statistics::WithSd;

/// Number of relative heights: of 0, 1, … 100 % of the energy.
pub const HEIGHTS: usize = 101;
/// Most samples of a waveform.
pub const MOST_SAMPLES: usize = 16_384;

/// Background and noise of a waveform as the instrument's processing recorded them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RecordedNoise {
    /// Level, DN.
    pub mean_dn: f64,
    /// Standard deviation of a sample, DN.
    pub sd_dn: f64,
}

/// What is known of one footprint. Positions are samples from the first; heights count from the ground
/// upwards, samples; unknown values are NaN.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Modes, ordered by position.
    pub modes: Vec<FootprintMode>,
    /// Probability that the last mode is the ground; NaN if there is no mode, or the signal continues behind the last sample.
    pub ground_probability: f64,
    /// Heights below which 0, 1, … 100 % of the energy lie; the last one is the height at which the signal begins.
    pub heights_samples: Box<[WithSd; HEIGHTS]>,
    /// Energy, as the height of a flat target's echo of the same energy, DN.
    pub energy_dn: WithSd,
    /// Energy of the ground over that of the waveform.
    pub ground_energy_ratio: WithSd,
    /// Cover of a canopy through which the ground would be found with a probability of 0.9.
    pub sensitivity: f64,
    /// Level of the background, DN.
    pub background_dn: f64,
    /// Whether the signal continues before the first sample, and behind the last.
    pub is_cut: [bool; 2],
}

impl Measured {
    /// A waveform without signal.
    pub(super) fn without_signal(background_dn: f64) -> Measured {
        Measured {
            modes: Vec::new(),
            ground_probability: f64::NAN,
            heights_samples: Box::new([WithSd::UNKNOWN; HEIGHTS]),
            energy_dn: WithSd::UNKNOWN,
            ground_energy_ratio: WithSd::UNKNOWN,
            sensitivity: f64::NAN,
            background_dn,
            is_cut: [false; 2],
        }
    }

    /// The mode that may be the ground; its SD includes shifts by slope and vegetation.
    pub fn ground(&self) -> Option<&FootprintMode> {
        self.modes.last().filter(|_| !self.ground_probability.is_nan())
    }
}

/// A mode of a waveform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FootprintMode {
    /// Position.
    pub position_samples: WithSd,
    /// Height above the background, DN.
    pub amplitude_dn: WithSd,
    /// Distances to half the height behind the mode and before it, or to the next valley if that is higher, over those of
    /// a flat target.
    pub half_width_ratios: [f64; 2],
}
