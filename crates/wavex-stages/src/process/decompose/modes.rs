//! Returns as modes: where no echo proves the response, a return must have a peak of its own.
//!
//! Echoes closer than a pulse width are separated by the shape of the response. A response that
//! echoes determined is verified by them. One taken from the outgoing pulse is not: over vegetation
//! under a large footprint, its error and the shape of the target cannot be distinguished, and
//! components on the slopes of a peak are no evidence of a target there.

use super::echo::FoundEcho;
use wavex_line::scan_line::Block;
use wavex_signal::sensor_model::{ChannelModel, ModelError, ResponseSource};

/// Distance of a return from its mode, pulse widths.
const REACH_WIDTHS: f64 = 0.75;
/// Half extent of the smoothing kernel, standard deviations.
const KERNEL_SD: f64 = 3.0;
/// Standard deviation of a Gaussian over its full width at half maximum.
const SD_OF_FWHM: f64 = 0.424_660_9;

/// Finds modes of the waveforms of one receiver.
pub(super) struct Modes {
    /// Gaussian of the width of the response; its sum is 1.
    kernel: Vec<f64>,
    /// Smallest rise of a mode above the samples that separate it from higher ones, DN.
    prominence_dn: f64,
    background_dn: [f64; 4],
    fwhm_samples: f64,
    smoothed_dn: Vec<f64>,
    /// Positions of the modes, samples.
    modes: Vec<f64>,
}

impl Modes {
    /// `None` for a receiver whose response is proven by echoes, or a Gaussian.
    ///
    /// Modes rise by `sigma` standard deviations of the smoothed noise.
    ///
    /// # Errors
    /// The noise of the model is invalid.
    pub(super) fn of(model: &ChannelModel, sigma: f64) -> Result<Option<Modes>, ModelError> {
        if model.provenance.response != ResponseSource::OutgoingPulse {
            return Ok(None);
        }
        let fwhm_samples = model.fwhm_samples();
        let sd_samples = SD_OF_FWHM * fwhm_samples;
        let reach = (KERNEL_SD * sd_samples).ceil() as i32;
        let values = (-reach..=reach).map(|k| (-0.5 * (f64::from(k) / sd_samples).powi(2)).exp());
        let sum: f64 = values.clone().sum();
        let kernel: Vec<f64> = values.map(|value| value / sum).collect();
        Ok(Some(Modes {
            prominence_dn: sigma * smoothed_sd_dn(model, &kernel)?,
            kernel,
            background_dn: model.background_dn,
            fwhm_samples,
            smoothed_dn: Vec::new(),
            modes: Vec::new(),
        }))
    }

    /// Moves the times of returns to their modes and drops those without one; returns the number dropped.
    ///
    /// The returns of the block begin at `first`. The distance that a return is moved enters its standard
    /// deviation as that of a uniform distribution.
    pub(super) fn keep(
        &mut self,
        samples: &[u16],
        block: &Block,
        found: &mut Vec<FoundEcho>,
        first: usize,
    ) -> u64 {
        self.find(samples);
        let mut fitted = found.split_off(first);
        let before = fitted.len();
        for &mode in &self.modes {
            let distance = |found: &FoundEcho| {
                let reach = REACH_WIDTHS * self.fwhm_samples * found.fitted.width_ratio.max(1.0);
                (found.fitted.position_samples - mode).abs() / reach
            };
            let near = (0..fitted.len()).filter(|&i| distance(&fitted[i]) <= 1.0);
            let nearest = near.min_by(|&i, &j| distance(&fitted[i]).total_cmp(&distance(&fitted[j])));
            found.extend(nearest.map(|nearest| moved(fitted.remove(nearest), mode, block)));
        }
        (before - (found.len() - first)) as u64
    }

    /// Finds the maxima of the smoothed waveform that rise far enough.
    fn find(&mut self, samples: &[u16]) {
        self.modes.clear();
        self.smoothed_dn.clear();
        let reach = self.kernel.len() / 2;
        let signal_dn = |k: usize| f64::from(samples[k]) - self.background_dn[k % 4];
        let last = samples.len().saturating_sub(1);
        self.smoothed_dn.extend((0..samples.len()).map(|k| {
            let at = |(i, weight): (usize, &f64)| weight * signal_dn((k + i).saturating_sub(reach).min(last));
            self.kernel.iter().enumerate().map(at).sum::<f64>()
        }));
        let dn = &self.smoothed_dn;
        for k in 1..last {
            if dn[k] > dn[k - 1] && dn[k] >= dn[k + 1] && prominence(dn, k) >= self.prominence_dn {
                let curvature = dn[k - 1] - 2.0 * dn[k] + dn[k + 1];
                let offset = if curvature < 0.0 { 0.5 * (dn[k - 1] - dn[k + 1]) / curvature } else { 0.0 };
                self.modes.push(k as f64 + offset);
            }
        }
    }
}

/// The return at a mode of its block.
fn moved(mut found: FoundEcho, mode: f64, block: &Block) -> FoundEcho {
    let moved_ns = block.time_ns(mode) - block.time_ns(found.fitted.position_samples);
    let sd_samples = (mode - found.fitted.position_samples) / 12f64.sqrt();
    found.fitted.position_sd_samples = found.fitted.position_sd_samples.hypot(sd_samples);
    found.time_ns += moved_ns;
    found.time_sd_ns = found.time_sd_ns.hypot(moved_ns / 12f64.sqrt());
    found
}

/// Height of a maximum above the higher of the lowest values between it and higher ones, or the ends.
fn prominence(dn: &[f64], at: usize) -> f64 {
    let lowest = |side: &mut dyn Iterator<Item = &f64>| {
        side.take_while(|value| **value <= dn[at]).copied().fold(dn[at], f64::min)
    };
    let before = lowest(&mut dn[..at].iter().rev());
    let after = lowest(&mut dn[at + 1..].iter());
    dn[at] - before.max(after)
}

/// Standard deviation of the noise after smoothing, DN.
fn smoothed_sd_dn(model: &ChannelModel, kernel: &[f64]) -> Result<f64, ModelError> {
    let mut covariance = vec![0.0; kernel.len()];
    model.noise()?.autocovariance_into(&mut covariance);
    let products = |lag: usize| kernel.iter().zip(&kernel[lag..]).map(|(a, b)| a * b).sum::<f64>();
    let at_lag =
        |(lag, covariance): (usize, &f64)| covariance * products(lag) * if lag == 0 { 1.0 } else { 2.0 };
    Ok(covariance.iter().enumerate().map(at_lag).sum::<f64>().max(0.0).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::scan_line::{Blocks, Channel, ReturnChannel};
    use wavex_signal::decompose::Return as Pulse;
    use wavex_signal::noise::ArNoise;
    use wavex_testkit::waveforms::{SAMPLES, model};

    fn large_footprint() -> ChannelModel {
        let mut model = model(&ArNoise::new(&[], 0.8).unwrap());
        model.provenance.response = ResponseSource::OutgoingPulse;
        model
    }

    /// Returns left of those at `positions`, in a waveform of Gaussian `peaks`: position and height.
    fn kept(peaks: &[(f64, f64)], positions: &[f64]) -> (Vec<FoundEcho>, u64) {
        let model = large_footprint();
        let sd_samples = SD_OF_FWHM * model.fwhm_samples();
        let signal_dn = |k: usize| -> f64 {
            let of = |(at, dn): &(f64, f64)| dn * (-0.5 * ((k as f64 - at) / sd_samples).powi(2)).exp();
            model.background_dn[0] + peaks.iter().map(of).sum::<f64>()
        };
        let samples: Vec<u16> = (0..SAMPLES).map(|k| signal_dn(k).round() as u16).collect();
        let mut blocks = Blocks::default();
        blocks.push(0, Channel::LowPower, None, 100.0, 1.0, &samples);
        let found = |position: &f64| FoundEcho {
            time_ns: 100.0 + position,
            time_sd_ns: 0.02,
            channel: ReturnChannel::Low,
            block: 0,
            zone: 0,
            background_dn: 20.0,
            gain: 1.0,
            high_power: None,
            fitted: Pulse {
                position_samples: *position,
                position_sd_samples: 0.02,
                amplitude_dn: 50.0,
                amplitude_sd_dn: 1.0,
                width_ratio: 1.0,
                width_ratio_sd: 0.02,
                fwhm_ns: 4.0,
                deviation_ratio: 0.0,
                flags: 0,
            },
            flags: 0,
        };
        // A return of another block is not changed.
        let mut all: Vec<FoundEcho> = [7.0].iter().chain(positions).map(found).collect();
        let (_, of_shot) = blocks.by_emission().next().unwrap();
        let block = &of_shot[0];
        let dropped = Modes::of(&model, 4.5).unwrap().unwrap().keep(&samples, block, &mut all, 1);
        assert_eq!(all.remove(0).time_ns, 107.0);
        (all, dropped)
    }

    #[test]
    fn a_component_on_the_slope_of_a_peak_is_no_return() {
        let (found, dropped) = kept(&[(25.0, 180.0), (28.5, 60.0)], &[25.0, 28.5, 45.0]);
        assert_eq!((found.len(), dropped), (1, 2));
        let moved_ns = found[0].time_ns - 125.0;
        assert!((0.05..1.0).contains(&moved_ns), "the mode of the sum is later: {moved_ns}");
        assert!((found[0].time_sd_ns - 0.02f64.hypot(moved_ns / 12f64.sqrt())).abs() < 1e-12);
    }

    #[test]
    fn peaks_of_their_own_are_returns() {
        let (found, dropped) = kept(&[(20.0, 150.0), (33.0, 12.0)], &[20.0, 33.0]);
        assert_eq!((found.len(), dropped), (2, 0));
        assert!(found.iter().zip([20.0, 33.0]).all(|(found, at)| (found.time_ns - 100.0 - at).abs() < 0.2));
    }

    #[test]
    fn a_response_that_echoes_prove_separates_returns() {
        let mut model = large_footprint();
        model.provenance.response = ResponseSource::Echoes;
        assert!(Modes::of(&model, 4.5).unwrap().is_none());
    }
}
