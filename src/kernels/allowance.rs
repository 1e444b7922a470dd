//! What errors of the response look like: echoes that are not there, beside strong ones.
//!
//! A response known to the part `κ` of a pulse's height `a` leaves behind it, in the matched filter, something of the size
//! `κ a √E`; with the noise it makes the threshold `T √(1 + Σ (κ a √E)²)`.

use super::sensor_model::ChannelModel;

/// Error of the response behind a pulse that overdrives the receiver.
pub const OVERDRIVEN_ERROR: f64 = 0.06;
/// The template error is the greatest within so many widths (4 ns of 4.4).
const ENVELOPE_WIDTHS: f64 = 0.9;
/// Where a response can be wrong as a pulse can be: its main lobe and its after-pulse, in widths from the peak …
const LOBE_WIDTHS: std::ops::Range<f64> = -2.5..3.2;
/// … and the part of the least template error elsewhere, in the slow and smooth tail.
const FAR_PART: f64 = 0.5;

/// How far the response of one channel is to be trusted.
#[derive(Debug, Clone)]
pub(super) struct Allowance {
    /// Whether pulses are told by a response; Gaussians have no allowance.
    has_response: bool,
    least_error: f64,
    overdriven_dn: f64,
    noise_sd_dn: f64,
    /// Lag of the first entry of the tables, samples.
    first_lag: i64,
    /// Error of the response by whole sample of time after the peak, as part of the height.
    errors: Vec<f64>,
    /// Sums of the squared measured errors before each sample.
    squares: Vec<f64>,
}

impl Allowance {
    /// `least_error` is how well the response is known at least; pulses higher than `overdriven_dn` overdrive the
    /// receiver.
    pub(super) fn new(model: &ChannelModel, least_error: f64, overdriven_dn: f64) -> Allowance {
        let mut allowance = Allowance {
            has_response: model.response.is_some(),
            least_error,
            overdriven_dn,
            noise_sd_dn: model.noise_sd_dn,
            first_lag: 0,
            errors: Vec::new(),
            squares: vec![0.0],
        };
        let Some(response) = &model.response else { return allowance };
        let fwhm = model.fwhm_samples();
        let reach = (ENVELOPE_WIDTHS * fwhm).round() as i64;
        let margin = reach.max((LOBE_WIDTHS.end * fwhm).ceil() as i64) + 1;
        allowance.first_lag = i64::from(response.first_sample) - margin;
        let samples = response.template_error.len() as i64 + 2 * margin;
        let mut sum = 0.0;
        for lag in (0..samples).map(|k| allowance.first_lag + k) {
            let near = (-reach..=reach).map(|k| response.template_error_at((lag + k) as f64));
            let least = if LOBE_WIDTHS.contains(&(lag as f64 / fwhm)) { 1.0 } else { FAR_PART };
            allowance.errors.push(near.fold(least * least_error, f64::max));
            sum += response.template_error_at(lag as f64).powi(2);
            allowance.squares.push(sum);
        }
        allowance
    }

    /// Whether a pulse overdrives the receiver.
    pub(super) fn overdrives(&self, height_dn: f64) -> bool {
        self.has_response && height_dn > self.overdriven_dn
    }

    /// The error of the response so many samples behind a pulse, as part of its height.
    fn error(&self, height_dn: f64, lag_samples: f64) -> f64 {
        if self.overdrives(height_dn) {
            return OVERDRIVEN_ERROR.max(self.least_error);
        }
        let index = lag_samples.round() as i64 - self.first_lag;
        let known = usize::try_from(index).ok().and_then(|index| self.errors.get(index));
        known.copied().unwrap_or(FAR_PART * self.least_error)
    }

    /// By how much the threshold at a place rises for what pulses higher than `height_dn` may leave there (an infinite
    /// height means all pulses): a factor of at least 1. Pulses are given by position and height, `per_dn` is `√E` of a
    /// pulse of height 1.
    pub(super) fn raise(
        &self,
        position_samples: f64,
        height_dn: f64,
        per_dn: f64,
        pulses: impl Iterator<Item = (f64, f64)>,
    ) -> f64 {
        if !self.has_response {
            return 1.0;
        }
        let mut sum = 1.0;
        for (position, height) in pulses {
            if height_dn.is_infinite() || height > height_dn {
                sum += (self.error(height, position_samples - position) * height * per_dn).powi(2);
            }
        }
        sum.sqrt()
    }

    /// `Σ (κ_k a/σ)²` of one pulse over the samples of a block, with the template error that calibration saw.
    pub(super) fn expected_excess(&self, position_samples: f64, height_dn: f64, samples: usize) -> f64 {
        if !self.has_response {
            return 0.0;
        }
        let first = -(position_samples.round() as i64) - self.first_lag;
        let last = self.squares.len() as i64 - 1;
        let at = |index: i64| self.squares[index.clamp(0, last) as usize];
        (height_dn / self.noise_sd_dn).powi(2) * (at(first + samples as i64) - at(first))
    }
}
