//! Trials of the residual search: clusters that may replace others.

use std::ops::Range;

use super::pulse_model::{MAX_TRIAL, PulseComponent, PulseModel};
use crate::flags;
use crate::shape::SD_OF_FWHM;

/// A cluster that may replace another.
#[derive(Clone, Copy)]
pub(super) struct Trial {
    pub(super) row: usize,
    pub(super) old: (usize, usize),
    pub(super) pulses: [PulseComponent; MAX_TRIAL],
    pub(super) count: usize,
    /// Required decrease of chi-square.
    pub(super) gain: f32,
    pub(super) chi_square: f32,
    /// Whether the fit ended at an optimum.
    pub(super) has_ended: bool,
    /// Whether the fit was stopped because it could not have been accepted.
    pub(super) is_dropped: bool,
    /// Chi-square with the prior terms.
    ///
    /// Without priors a narrow pulse with a wide one often fits as well as the true pair.
    pub(super) objective: f32,
}

impl Trial {
    /// Creates a trial that replaces pulses near a position if chi-square decreases by `gain`.
    pub(super) fn near(
        row: usize,
        pulse_model: &PulseModel,
        position: f32,
        fwhm_samples: f32,
        gain: f32,
    ) -> Trial {
        let whole = pulse_model.cluster_around(position, fwhm_samples);
        Trial::replacing(row, part_of(pulse_model, whole, position, |_| true), gain)
    }

    /// Creates a trial that replaces a pulse and its neighbours if chi-square decreases by `gain`.
    pub(super) fn around(
        row: usize,
        pulse_model: &PulseModel,
        number: usize,
        fwhm_samples: f32,
        gain: f32,
    ) -> Trial {
        let position = pulse_model.pulses()[number].position();
        let whole = pulse_model.cluster_around(position, fwhm_samples);
        // Several pulses can be at one place, such as the end of the block.
        let old = part_of(pulse_model, whole, position, |pair| pair.contains(&number));
        Trial::replacing(row, old, gain)
    }

    fn replacing(row: usize, old: Range<usize>, gain: f32) -> Trial {
        Trial {
            row,
            old: (old.start, old.end),
            pulses: [PulseComponent::default(); MAX_TRIAL],
            count: 0,
            has_ended: false,
            is_dropped: false,
            gain,
            chi_square: f32::INFINITY,
            objective: f32::INFINITY,
        }
    }

    pub(super) fn old(&self) -> Range<usize> {
        self.old.0..self.old.1
    }

    pub(super) fn pulses(&self) -> &[PulseComponent] {
        &self.pulses[..self.count]
    }

    /// Information on the level that the pulses absorb if the trial is accepted, 1/DN².
    pub(super) fn level_information(&self, pulse_model: &PulseModel) -> f32 {
        let others = &pulse_model.pulses()[..self.old.0];
        let others = others.iter().chain(&pulse_model.pulses()[self.old.1..]);
        others.chain(self.pulses()).map(|pulse| pulse.level_information).sum()
    }
}

/// Change of a cluster in a trial.
#[derive(Clone, Copy)]
pub(super) enum Change {
    /// Adds a pulse.
    Add(PulseComponent),
    /// Adds a pulse; all start with the calibrated width.
    ///
    /// The index is that of its nearest neighbour.
    AddToNarrow(PulseComponent, usize),
    /// Splits a pulse into two of the calibrated width.
    ///
    /// The first has this fraction of its energy.
    Divide(usize, f32),
}

/// Returns the cluster, or two pulses of one that is too large for a trial.
///
/// The two are the neighbours nearest to `position` among those accepted by `is_candidate`.
fn part_of(
    pulse_model: &PulseModel,
    cluster: Range<usize>,
    position: f32,
    is_candidate: impl Fn(&Range<usize>) -> bool,
) -> Range<usize> {
    if cluster.len() < MAX_TRIAL {
        return cluster;
    }
    let distance = |pair: &Range<usize>| {
        let pulses = &pulse_model.pulses()[pair.clone()];
        pulses.iter().map(|p| (p.position() - position).abs()).sum::<f32>()
    };
    let pairs = (cluster.start..cluster.end - 1).map(|start| start..start + 2).filter(is_candidate);
    pairs.min_by(|a, b| distance(a).total_cmp(&distance(b))).unwrap_or(cluster)
}

/// Splits a widened pulse into two of the calibrated width with its first moments.
pub(super) fn divided(pulse: &PulseComponent, part: f32, fwhm_samples: f32) -> [PulseComponent; 2] {
    let [height, centre, _] = pulse.values();
    let ratio = pulse.width_ratio();
    let separation =
        SD_OF_FWHM as f32 * fwhm_samples * ((ratio * ratio - 1.0) / (part * (1.0 - part))).max(0.0).sqrt();
    let energy = ratio * height;
    let flags = pulse.flags | flags::SPLIT;
    let of = |part: f32, position: f32| PulseComponent::new([part * energy, position, 0.0]).flagged(flags);
    [of(part, centre - (1.0 - part) * separation), of(1.0 - part, centre + part * separation)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_is_divided_among_others_at_its_place() {
        let mut pulse_model = PulseModel::default();
        pulse_model.reset();
        for place in [20.0, 20.0, 20.0, 22.0] {
            assert!(pulse_model.push(PulseComponent::new([10.0, place, 0.0])));
        }
        for number in 0..4 {
            let trial = Trial::around(0, &pulse_model, number, 4.0, 1.0);
            assert!(trial.old().contains(&number), "{number} is not in {:?}", trial.old());
        }
    }
}
