//! Deviation of a waveform from every profile that the receiver can show.
//!
//! The response passes no frequencies above its own, so what a high-pass filter leaves of a waveform is noise,
//! whatever ground and canopy are like. Its power within the signal is compared with its power beside the signal.
//! Photons add noise that grows with the signal; a receiver's share of it is learnt.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::kernel::Kernel;

/// SD of the Gaussian of the filter over the SD of the pulse, and number of times that the Gaussian is removed.
///
/// `(1 - G)^6` leaves below 0.0005 of a flat target's echo.
const WIDTH: f64 = 0.3;
const ORDER: u32 = 6;
/// Lags over which the filtered noise is correlated.
pub(super) const LAGS: usize = 24;

/// Noise that the filter leaves, as a receiver has it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ResidualNoise {
    /// Sum of its squared autocorrelation over all lags: the number of samples per independent one.
    pub samples_per_independent: f64,
    /// Variance that the signal adds, per DN of signal, over that of the background.
    pub variance_ratio_per_dn: f64,
}

/// What a waveform has beyond the frequencies of the response.
pub(super) struct Residual {
    filter: Kernel,
    pub(super) values_dn: Vec<f32>,
}

/// Power within the signal over that beside it.
#[derive(Clone, Copy, Debug)]
pub(super) struct PowerRatio {
    pub(super) ratio: f64,
    pub(super) mean_signal_dn: f64,
    /// Numbers of samples beside the signal and within it.
    counts: [f64; 2],
}

impl Residual {
    /// For pulses of this standard deviation, samples.
    pub(super) fn new(pulse_sd_samples: f64) -> Residual {
        Residual { filter: Kernel::high_pass(WIDTH * pulse_sd_samples, ORDER), values_dn: Vec::new() }
    }

    /// Filters samples; the ends are not valid.
    pub(super) fn filter(&mut self, samples: &[f32]) {
        self.filter.smooth_into(samples, &mut self.values_dn);
    }

    /// Compares powers; the samples of `is_free` begin `edge` samples behind the first. `None` without signal.
    pub(super) fn power_ratio(
        &self,
        smoothed: &[f32],
        level_dn: f64,
        is_free: &[bool],
        edge: usize,
        variance_ratio_per_dn: f64,
    ) -> Option<PowerRatio> {
        let [mut powers, mut counts, mut signal_dn] = [[0.0; 2], [0.0; 2], [0.0; 2]];
        let samples = self.values_dn.iter().zip(smoothed).skip(edge).zip(is_free);
        for ((residual_dn, smoothed_dn), is_free) in samples {
            let side = usize::from(!is_free);
            let here_dn = if *is_free { 0.0 } else { (f64::from(*smoothed_dn) - level_dn).max(0.0) };
            powers[side] += f64::from(*residual_dn).powi(2) / (1.0 + variance_ratio_per_dn * here_dn);
            signal_dn[side] += here_dn;
            counts[side] += 1.0;
        }
        let ratio = powers[1] * counts[0] / (powers[0] * counts[1]);
        let found = PowerRatio { ratio, mean_signal_dn: signal_dn[1] / counts[1], counts };
        ratio.is_finite().then_some(found)
    }
}

impl PowerRatio {
    /// Excess of the power within the signal, in its standard deviations.
    pub(super) fn deviation(self, noise: ResidualNoise) -> f64 {
        let [free, signal] = self.counts;
        let variance = 2.0 * noise.samples_per_independent * (1.0 / free + 1.0 / signal);
        (self.ratio - 1.0) / variance.sqrt()
    }
}
