//! Results of one waveform.

use wavex_simd::statistics::WithSd;

/// Number of relative heights: of 0, 1, … 100 % of the energy.
pub const HEIGHTS: usize = 101;
/// Most samples of a waveform.
pub const MOST_SAMPLES: usize = 16_384;

/// Number of features on which the choice of the ground depends.
pub const GROUND_FEATURES: usize = 12;

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
    /// Probability that the ground is at the last mode: within 1 m, or 3 of its SDs. NaN if there is no mode, or the signal
    /// continues behind the last sample.
    pub ground_probability: f64,
    /// Root mean square distance of the ground from the last mode: the SD that includes the choice of the ground.
    pub ground_total_sd_samples: f64,
    /// Where the ground is otherwise, if that has a probability of 0.05 and more.
    pub second_ground: Option<GroundCandidate>,
    /// What the choice depends on, for fits of its constants; NaN without ground.
    pub ground_features: [f64; GROUND_FEATURES],
    /// Heights below which 0, 1, … 100 % of the energy lie; the last one is the height at which the signal begins.
    pub heights_samples: Box<[WithSd; HEIGHTS]>,
    /// Energy, as the height of a flat target's echo of the same energy, DN.
    pub energy_dn: WithSd,
    /// Energy of the ground over that of the waveform.
    pub ground_energy_ratio: WithSd,
    /// Cover of a canopy through which the ground would be found with a probability of 0.9.
    pub sensitivity: f64,
    /// Excess of the signal's power beyond the frequencies of the response over that of noise, in its SDs; NaN if there
    /// is no signal or no background beside it. Large where no profile of ground and canopy explains the waveform.
    pub deviation: f64,
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
            ground_total_sd_samples: f64::NAN,
            second_ground: None,
            ground_features: [f64::NAN; GROUND_FEATURES],
            heights_samples: Box::new([WithSd::UNKNOWN; HEIGHTS]),
            energy_dn: WithSd::UNKNOWN,
            ground_energy_ratio: WithSd::UNKNOWN,
            sensitivity: f64::NAN,
            deviation: f64::NAN,
            background_dn,
            is_cut: [false; 2],
        }
    }

    /// The mode that may be the ground; its SD includes shifts by slope and vegetation.
    pub fn ground(&self) -> Option<&FootprintMode> {
        self.modes.last().filter(|_| !self.ground_probability.is_nan())
    }
}

/// Another place of the ground, without a mode: a surface that merges with the layer above it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundCandidate {
    /// Position.
    pub position_samples: WithSd,
    /// Probability that the ground is here, within 1 m or 3 SDs, and not at the last mode.
    pub probability: f64,
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
