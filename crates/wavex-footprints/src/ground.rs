//! Which mode is the ground.

use super::FootprintMode;

/// A mode that may be the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// Index of the mode.
    pub mode: usize,
    /// Probability that it is the ground.
    pub probability: f64,
}

/// What the probability of a mode depends on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Evidence {
    /// Height of the mode over the SD of its noise.
    pub(super) height_sds: f64,
    /// Energy of the mode over that of the waveform.
    pub(super) energy_ratio: f64,
    /// Sensitivity of the shot.
    pub(super) sensitivity: f64,
}

impl Evidence {
    /// Probability that the lowest mode is the ground, and not a layer above a ground that is too weak.
    fn probability(self) -> f64 {
        let Evidence { height_sds, energy_ratio, sensitivity } = self;
        let strength = libm::log(height_sds.max(1.0));
        let share = libm::log(energy_ratio.clamp(1e-3, 1.0));
        let missed = libm::log((1.0 - sensitivity).clamp(1e-4, 1.0));
        let logit = 2.0 + 0.5 * strength + 0.5 * share - 0.2 * missed;
        1.0 / (1.0 + libm::exp(-logit))
    }
}

/// The lowest mode and the one above it, with their probabilities.
pub(super) fn candidates(modes: &[FootprintMode], evidence: Option<Evidence>) -> [Option<Candidate>; 2] {
    let (Some(lowest), Some(evidence)) = (modes.len().checked_sub(1), evidence) else { return [None; 2] };
    let probability = evidence.probability();
    let other = lowest.checked_sub(1).map(|mode| Candidate { mode, probability: 0.5 * (1.0 - probability) });
    [Some(Candidate { mode: lowest, probability }), other]
}
