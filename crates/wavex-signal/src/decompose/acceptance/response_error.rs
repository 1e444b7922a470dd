//! Spurious echoes caused by response-model error.
//!
//! A response known to a fraction `κ` of the pulse height `a` leaves a residual of order `κ a √E`
//! in the matched filter. Together with the noise the threshold becomes `T √(1 + Σ (κ a √E)²)`.

use crate::decompose::acceptance::BEGINS_WIDTHS;
use crate::sensor_model::ChannelModel;
use crate::shape::Pulse;

/// Relative response error of a pulse that overdrives the receiver, from its start to its
/// after-pulse. Before it there is nothing to distort. After it, the error equals the height of the
/// tail.
const OVERDRIVEN_ERROR: f64 = 0.06;
/// Half width of the envelope of the template error, in pulse widths (4 ns for 4.4).
const ENVELOPE_WIDTHS: f64 = 0.9;
/// Range of the main lobe and after-pulse, in widths from the peak; there the full smallest
/// template error applies …
const LOBE_WIDTHS: std::ops::Range<f64> = -2.5..3.2;
/// … and this fraction of it elsewhere, in the slow and smooth tail.
const FAR_PART: f64 = 0.5;

/// A pulse whose response error raises the threshold near it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ErrorSource {
    pub(crate) position_samples: f64,
    pub(crate) height_dn: f64,
    /// Height times width ratio, the latter at least 1.
    ///
    /// A target that broadens a pulse lowers its peak, but not the tail that the response adds to it.
    pub(crate) energy_dn: f64,
}

impl ErrorSource {
    pub(crate) fn of(pulse: &Pulse) -> ErrorSource {
        ErrorSource {
            position_samples: pulse.position_samples,
            height_dn: pulse.height_dn,
            energy_dn: pulse.height_dn * pulse.ln_width_ratio.max(0.0).exp(),
        }
    }
}

/// Error model of one channel's response.
#[derive(Debug, Clone)]
pub(crate) struct Allowance {
    /// Whether the channel has a calibrated response.
    has_response: bool,
    /// Relative error far from a pulse.
    far_error: f64,
    overdriven_dn: f64,
    /// Inverse of the noise SD, 1/DN.
    per_noise_sd: f64,
    /// Lag of the first entry of the tables, samples.
    first_lag: i64,
    /// Measured error of the tail, relative to the energy, by whole sample after the peak; 0 elsewhere.
    tail_errors: Vec<f64>,
    greatest_tail_error: f64,
    /// Response error relative to the height, at least the smallest …
    errors: Vec<f64>,
    /// … and for pulses that overdrive the receiver.
    overdriven_errors: Vec<f64>,
    /// Largest of these errors, without and with overdriven pulses.
    greatest_known_error: f64,
    greatest_error: f64,
    /// Cumulative sums of the squared measured errors before each sample, times their part of the
    /// excess.
    squares: Vec<f64>,
}

impl Allowance {
    /// Creates the error model.
    ///
    /// `least_error` is the smallest relative error of the response; pulses higher than
    /// `overdriven_dn` overdrive the receiver.
    pub(crate) fn new(model: &ChannelModel, least_error: f64, overdriven_dn: f64) -> Allowance {
        let fwhm = model.fwhm_samples();
        let reach = (ENVELOPE_WIDTHS * fwhm).round() as i64;
        let margin = reach.max((LOBE_WIDTHS.end * fwhm).ceil() as i64) + 1;
        let (first_sample, known) = match &model.response {
            Some(response) => (i64::from(response.first_sample), response.template_error.len() as i64),
            None => (-margin, margin),
        };
        let measured = |lag: i64| model.response.as_ref().map_or(0.0, |r| r.template_error_at(lag as f64));
        let height = |lag: i64| model.response.as_ref().map_or(0.0, |r| r.highest_at(lag as f64));
        // A Gaussian has the measured shape error in the main lobe, and none elsewhere.
        let (near_error, far_error) = match &model.response {
            Some(_) => (least_error, FAR_PART * least_error),
            None => (model.pulse_shape_error, 0.0),
        };
        let mut allowance = Allowance {
            has_response: model.response.is_some(),
            far_error,
            overdriven_dn,
            per_noise_sd: model.noise_sd_dn.recip(),
            first_lag: first_sample - margin,
            tail_errors: Vec::new(),
            greatest_tail_error: 0.0,
            errors: Vec::new(),
            overdriven_errors: Vec::new(),
            greatest_known_error: 0.0,
            greatest_error: 0.0,
            squares: vec![0.0],
        };
        let excess_part = model.response.as_ref().map_or(1.0, |response| response.excess_part);
        let mut sum = 0.0;
        for lag in (0..known + 2 * margin).map(|k| allowance.first_lag + k) {
            let widths = lag as f64 / fwhm;
            let least = if LOBE_WIDTHS.contains(&widths) { near_error } else { far_error };
            let envelope = (-reach..=reach).map(|k| measured(lag + k)).fold(0.0, f64::max);
            let error = envelope.max(least);
            let overdriven = if widths <= -BEGINS_WIDTHS {
                0.0
            } else if widths < LOBE_WIDTHS.end {
                OVERDRIVEN_ERROR
            } else {
                (-reach..=reach).map(|k| height(lag + k).abs()).fold(0.0, f64::max).min(OVERDRIVEN_ERROR)
            };
            allowance.tail_errors.push(if widths < LOBE_WIDTHS.end { 0.0 } else { envelope });
            allowance.errors.push(error);
            allowance.overdriven_errors.push(overdriven.max(error));
            sum += excess_part * measured(lag).powi(2);
            allowance.squares.push(sum);
        }
        let greatest = |errors: &[f64]| errors.iter().copied().fold(far_error, f64::max);
        allowance.greatest_tail_error = allowance.tail_errors.iter().copied().fold(0.0, f64::max);
        allowance.greatest_known_error = greatest(&allowance.errors);
        allowance.greatest_error = greatest(&allowance.overdriven_errors);
        allowance
    }

    /// Whether a pulse overdrives the receiver.
    #[inline(always)]
    pub(crate) fn overdrives(&self, height_dn: f64) -> bool {
        self.has_response && height_dn > self.overdriven_dn
    }

    /// Response error that a pulse may leave at a position, DN.
    #[inline(always)]
    fn error_dn(&self, source: &ErrorSource, position_samples: f64) -> f64 {
        let errors = if self.overdrives(source.height_dn) { &self.overdriven_errors } else { &self.errors };
        let lag = (position_samples - source.position_samples).round() as i64;
        let index = usize::try_from(lag - self.first_lag).unwrap_or(usize::MAX);
        let of_height = errors.get(index).copied().unwrap_or(self.far_error) * source.height_dn;
        let of_energy = self.tail_errors.get(index).copied().unwrap_or(0.0) * source.energy_dn;
        of_height.max(of_energy)
    }

    /// Factor by which other pulses raise the threshold at a position; at least 1.
    ///
    /// Only pulses higher than `height_dn` count; infinity means all. `per_dn` is `√E` of a pulse of
    /// height 1.
    #[inline(always)]
    pub(crate) fn raise(
        &self,
        position_samples: f64,
        height_dn: f64,
        per_dn: f64,
        pulses: impl Iterator<Item = ErrorSource>,
    ) -> f64 {
        // Without a response, residuals of a Gaussian prevent adding pulses but do not remove
        // detected ones.
        if !self.has_response && height_dn.is_finite() {
            return 1.0;
        }
        let mut sum = 1.0;
        for source in pulses {
            if height_dn.is_infinite() || source.height_dn > height_dn {
                sum += (self.error_dn(&source, position_samples) * per_dn).powi(2);
            }
        }
        sum.sqrt()
    }

    /// Upper bound of [`Allowance::raise`] for these pulses at any position; cheaper to compute.
    #[inline(always)]
    pub(crate) fn raise_at_most(&self, per_dn: f64, pulses: impl Iterator<Item = ErrorSource>) -> f64 {
        let (mut heights_dn, mut energies_dn, mut highest_dn) = (0.0, 0.0, 0.0);
        for source in pulses {
            heights_dn += source.height_dn;
            energies_dn += source.energy_dn;
            highest_dn = f64::max(highest_dn, source.height_dn);
        }
        let error = if self.overdrives(highest_dn) { self.greatest_error } else { self.greatest_known_error };
        // The root of a sum of squares is at most the sum.
        1.0 + per_dn * (error * heights_dn + self.greatest_tail_error * (energies_dn - heights_dn).max(0.0))
    }

    /// `Σ (κ_k a/σ)²` of one pulse over the samples of a block, with the calibrated template error.
    ///
    /// Times the response's `excess_part` it is the expected contribution of the response error to
    /// chi-square.
    #[inline(always)]
    pub(crate) fn expected_excess(&self, position_samples: f64, height_dn: f64, samples: usize) -> f64 {
        let first = -(position_samples.round() as i64) - self.first_lag;
        let last = self.squares.len() as i64 - 1;
        let at = |index: i64| self.squares[index.clamp(0, last) as usize];
        (height_dn * self.per_noise_sd).powi(2) * (at(first + samples as i64) - at(first))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::ArNoise;
    use crate::sensor_model::response::{ResponseNode, SystemResponse};
    use crate::simulated::channel;

    fn model(errors: &[f64]) -> ChannelModel {
        let mut model = channel(&ArNoise::new(&[], 2.0).unwrap(), 4.0, 20.0);
        let response = SystemResponse {
            first_sample: -2,
            // A tail from sample 12 to sample 48.
            nodes: vec![ResponseNode {
                peak_dn: 155.0,
                values: [[1.0; 112].as_slice(), &[0.02; 288]].concat(),
            }],
            template_error: errors.to_vec(),
            echoes: 200,
            excess_part: 1.0,
            shape_sd: 1e-3,
        };
        model.response = Some(response);
        model.noise_sd_dn = 2.0;
        model
    }

    fn source(position_samples: f64, height_dn: f64) -> ErrorSource {
        ErrorSource { position_samples, height_dn, energy_dn: height_dn }
    }

    /// A target of three widths lowers the peak to a third, but not the tail.
    #[test]
    fn measured_errors_follow_the_energy_of_a_broad_pulse() {
        let mut errors = [0.0; 50];
        (errors[3], errors[32]) = (0.02, 0.02);
        let allowance = Allowance::new(&model(&errors), 0.01, 200.0);
        let broad = ErrorSource { energy_dn: 300.0, ..source(30.0, 100.0) };
        let raise = |lag: f64| allowance.raise(30.0 + lag, 10.0, 0.5, [broad].into_iter());
        for (lag, error_dn) in
            [(1.0, 0.02 * 100.0), (7.0, 0.01 * 100.0), (30.0, 0.02 * 300.0), (90.0, 0.005 * 100.0)]
        {
            assert!((raise(lag) - (1.0 + f64::powi(error_dn * 0.5, 2)).sqrt()).abs() < 1e-12, "{lag}");
            assert!(raise(lag) <= allowance.raise_at_most(0.5, [broad].into_iter()));
        }
    }

    /// `T √(1 + Σ (κ a √E)²)` with the envelope of the error, its minimum and that of the tail.
    #[test]
    fn thresholds_rise_with_what_strong_pulses_may_leave() {
        let allowance = Allowance::new(&model(&[0.0, 0.0, 0.0, 0.02, 0.0]), 0.01, 200.0);
        let raise = |lag: f64| allowance.raise(30.0 + lag, 10.0, 0.5, [source(30.0, 100.0)].into_iter());
        for (lag, error) in
            [(1.0, 0.02), (5.0, 0.02), (7.0, 0.01), (-9.0, 0.01), (-14.0, 0.005), (90.0, 0.005)]
        {
            assert!((raise(lag) - (1.0 + f64::powi(error * 100.0 * 0.5, 2)).sqrt()).abs() < 1e-12, "{lag}");
        }
        // Before the pulse an overdriven receiver behaves normally; long after it the error is that
        // of the tail.
        for (place, error) in [
            (40.0, 0.06),
            (23.0, 0.06),
            (22.0, 0.01),
            (16.0, 0.005),
            (45.0, 0.06),
            (46.0, 0.02),
            (90.0, 0.005),
        ] {
            let raised = allowance.raise(place, 10.0, 0.5, [source(30.0, 201.0)].into_iter());
            assert!((raised - (1.0 + f64::powi(error * 201.0 * 0.5, 2)).sqrt()).abs() < 1e-12, "{place}");
        }
        for (heights, error) in [([100.0, 50.0], 0.02), ([100.0, 201.0], 0.06)] {
            let sum: f64 = heights.iter().sum();
            let pulses = heights.map(|height| source(30.0, height));
            let most = allowance.raise_at_most(0.5, pulses.into_iter());
            assert!((most - (1.0 + error * 0.5 * sum)).abs() < 1e-12);
            for lag in -20..60 {
                assert!(allowance.raise(30.0 + f64::from(lag), 0.0, 0.5, pulses.into_iter()) <= most);
            }
        }
        let weaker = allowance.raise(31.0, 150.0, 0.5, [source(30.0, 100.0)].into_iter());
        assert_eq!(weaker, 1.0);
        assert!(allowance.overdrives(201.0) && !allowance.overdrives(200.0));
    }

    #[test]
    fn a_gaussian_is_only_a_reason_to_add_nothing() {
        let mut model = model(&[]);
        (model.response, model.pulse_shape_error) = (None, 0.07);
        let allowance = Allowance::new(&model, 0.01, 200.0);
        let strong = || [source(30.0, 100.0)].into_iter();
        assert_eq!(allowance.raise(33.0, 10.0, 0.5, strong()), 1.0);
        let any = f64::INFINITY;
        assert!((allowance.raise(33.0, any, 0.5, strong()) - (1.0 + 3.5f64.powi(2)).sqrt()).abs() < 1e-12);
        assert_eq!(allowance.raise(60.0, any, 0.5, strong()), 1.0);
        assert_eq!(allowance.expected_excess(30.0, 100.0, 60), 0.0);
    }

    #[test]
    fn the_expected_excess_is_summed_over_the_block() {
        let allowance = Allowance::new(&model(&[0.01, 0.02, 0.03, 0.04]), 0.0, 200.0);
        let of = |place: f64, samples: usize| allowance.expected_excess(place, 50.0, samples);
        let scale = (50.0f64 / 2.0).powi(2);
        assert!((of(20.0, 60) - scale * 3.0e-3).abs() < 1e-12);
        // The block begins at the peak: only errors from there on count.
        assert!((of(0.2, 60) - scale * 2.5e-3).abs() < 1e-12);
        assert!((of(20.0, 20) - scale * 0.5e-3).abs() < 1e-12);
        assert_eq!(of(500.0, 60), 0.0);
    }
}
