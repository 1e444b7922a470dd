//! What errors of the response look like: echoes that are not there, beside strong ones.
//!
//! A response known to the part `κ` of a pulse's height `a` leaves behind it, in the matched filter, something of the size
//! `κ a √E`; with the noise it makes the threshold `T √(1 + Σ (κ a √E)²)` (ALGORITHMS.md S5).

use super::{Decomposer, OVERDRIVEN_ERROR};
use crate::kernels::gauss_fit::Pulse;

/// What is seen of a candidate's strength is told from what stronger ones leave there from so many widths on.
const TOLD_WIDTHS: f64 = 1.5;
/// The template error is the greatest within so many widths (4 ns of 4.4).
const ENVELOPE_WIDTHS: f64 = 0.9;

/// Where a response can be wrong as a pulse can be: its main lobe and its after-pulse, in widths from the peak …
const LOBE_WIDTHS: std::ops::Range<f64> = -2.5..3.2;
/// … and the part of the least template error elsewhere, in the slow and smooth tail (REALDATA.md: at most 0.0012).
const FAR_PART: f64 = 0.5;

impl Decomposer {
    /// Whether a pulse overdrives the receiver.
    pub(super) fn overdrives(&self, pulse: &Pulse) -> bool {
        self.model.response.is_some()
            && pulse.height_dn > self.settings.overdriven_part * self.model.full_scale_dn
    }

    /// The error of the response so many samples behind a pulse, as part of its height.
    fn template_error(&self, pulse: &Pulse, lag_samples: f64) -> f64 {
        let widths = lag_samples / self.model.fwhm_samples();
        let Some(response) = &self.model.response else {
            return if LOBE_WIDTHS.contains(&widths) { self.model.pulse_shape_error } else { 0.0 };
        };
        if self.overdrives(pulse) {
            return OVERDRIVEN_ERROR.max(self.settings.template_error);
        }
        let reach = (ENVELOPE_WIDTHS * self.model.fwhm_samples()).round() as i32;
        let near = (-reach..=reach).map(|k| response.template_error_at(lag_samples + f64::from(k)));
        let least = if LOBE_WIDTHS.contains(&widths) { 1.0 } else { FAR_PART };
        near.fold(least * self.settings.template_error, f64::max)
    }

    /// `Σ (κ_k a/σ)²` over pulses and samples with the template error that calibration saw (ALGORITHMS.md S7).
    pub(super) fn expected_excess(&self) -> f64 {
        let Some(response) = &self.model.response else { return 0.0 };
        let used = self.scene.whitener().used();
        let of_pulse = |pulse: &Pulse| -> f64 {
            let part = pulse.height_dn / self.model.noise_sd_dn;
            let samples = used.iter().enumerate().filter(|(_, used)| **used);
            samples
                .map(|(k, _)| (part * response.template_error_at(k as f64 - pulse.position_samples)).powi(2))
                .sum()
        };
        self.scene.found.iter().map(|f| of_pulse(&f.pulse)).sum()
    }

    /// The threshold of detection at a place, raised by what pulses higher than `height_dn` may leave there; an
    /// infinite height means all pulses.
    pub(super) fn threshold_at(&self, position_samples: f64, height_dn: f64) -> f64 {
        let threshold = self.settings.detection_sigma;
        // What a Gaussian leaves of a pulse is a reason to add nothing there, and none to drop what stands by itself.
        if self.model.response.is_none() && height_dn.is_finite() {
            return threshold;
        }
        let per_dn = self.detector.full_significance_per_dn();
        let mut sum = 1.0;
        for f in &self.scene.found {
            let lag = position_samples - f.pulse.position_samples;
            let stronger = height_dn.is_infinite() || f.pulse.height_dn > height_dn;
            if stronger {
                sum += (self.template_error(&f.pulse, lag) * f.pulse.height_dn * per_dn).powi(2);
            }
        }
        threshold * sum.sqrt()
    }

    /// Drops candidates that are no more than what stronger ones leave behind them. The candidates are sorted by
    /// their statistic; what is dropped wrongly stands in the residual of the first fit.
    pub(super) fn screen_candidates(&mut self) {
        if self.model.response.is_none() {
            return;
        }
        let told = TOLD_WIDTHS * self.model.fwhm_samples();
        let mut kept = 0;
        for i in 0..self.candidates.len() {
            let candidate = self.candidates[i];
            let left = self.candidates[..kept].iter().fold(0.0, |sum, stronger| {
                let lag = candidate.position_samples - stronger.position_samples;
                sum + if lag > told { stronger.height_dn * self.detector.echo(lag) } else { 0.0 }
            });
            if candidate.statistic - left >= self.settings.detection_sigma {
                self.candidates[kept] = candidate;
                kept += 1;
            }
        }
        self.candidates.truncate(kept);
    }
}
