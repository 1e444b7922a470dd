//! What a recording of large footprints shows of its receiver: noise and response.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex_simd::statistics::median;

use super::background::{self, Scratch};
use super::deviation::{self, Residual, ResidualNoise};
use super::kernel::Kernel;

/// Samples of the response per sample of a waveform.
pub(super) const OVERSAMPLING: usize = 4;
/// Lags of the noise's autocorrelation.
pub(super) const LAGS: usize = 16;
/// Fewest shots to learn from.
pub const LEAST_SHOTS: usize = 10;
/// Standard deviation of a Gaussian over its full width at half maximum.
pub(super) const SD_OF_FWHM: f64 = 0.424_660_900_144_009_5;
/// Distance of samples that are free of signal from the smoothed signal, widths of the response.
pub(super) const FREE_WIDTHS: f64 = 2.0;
/// Half length of the response before its peak, and length behind it, widths.
const BEFORE_WIDTHS: f64 = 3.0;
const BEHIND_WIDTHS: f64 = 6.0;
/// Relative height at which the response ends before its peak.
const FOOT: f64 = 0.004;
/// Height of an echo from which its width is known, SDs of a sample.
const CLEAR_SDS: f64 = 20.0;

/// Noise and response of a receiver of large footprints.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FootprintModel {
    /// Sampling interval, ns.
    pub sampling_interval_ns: f64,
    /// Median of the standard deviations of a sample without signal, DN.
    pub noise_sd_dn: f64,
    /// Autocorrelation of the noise, at lags of 0 to 15 samples.
    pub autocorrelation: Vec<f64>,
    /// Noise beyond the frequencies of the response.
    pub residual_noise: ResidualNoise,
    /// Mean outgoing pulse, or narrowest echo, four values per sample, peak 1: the echo of a flat target.
    pub response: Vec<f64>,
    /// Full width at half maximum of the response, ns.
    pub pulse_fwhm_ns: f64,
    /// Number of shots from which it was learnt.
    pub shots: u64,
}

/// Why a model cannot be learnt.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LearningError {
    /// Too few outgoing pulses.
    #[error(
        "{found} shots have a recorded outgoing pulse, and {LEAST_SHOTS} are needed for the response of the receiver"
    )]
    TooFewPulses {
        /// Number found.
        found: usize,
    },
    /// Too few waveforms with background.
    #[error(
        "{found} waveforms have background beside their signal, and {LEAST_SHOTS} are needed for the noise of the receiver"
    )]
    TooFewBackgrounds {
        /// Number found.
        found: usize,
    },
}

/// Learns a model from shots, one at a time.
pub struct FootprintLearner {
    interval_ns: f64,
    /// Sums of the aligned outgoing pulses, four values per sample.
    sum: Vec<f64>,
    peak: usize,
    pulses: usize,
    /// Sums of products at each lag over the sum of squares, per waveform.
    products: [f64; LAGS],
    /// The same of the noise that the residual's filter leaves.
    residual_products: [f64; deviation::LAGS],
    /// Variance that the signal adds per DN, over that of the background, per waveform.
    variance_ratios_per_dn: Vec<f64>,
    residual: Residual,
    noise_sds_dn: Vec<f64>,
    kernel: Kernel,
    scratch: Scratch,
    smoothed: Vec<f32>,
    reach: usize,
}

impl FootprintLearner {
    /// For waveforms of this sampling interval, ns, and outgoing pulses of about this width, ns.
    pub fn new(interval_ns: f64, fwhm_ns: f64) -> FootprintLearner {
        let fwhm = fwhm_ns / interval_ns;
        let peak = (BEFORE_WIDTHS * fwhm).ceil() as usize * OVERSAMPLING;
        let behind = (BEHIND_WIDTHS * fwhm).ceil() as usize * OVERSAMPLING;
        FootprintLearner {
            interval_ns,
            sum: vec![0.0; peak + behind + 1],
            peak,
            pulses: 0,
            products: [0.0; LAGS],
            residual_products: [0.0; deviation::LAGS],
            variance_ratios_per_dn: Vec::new(),
            residual: Residual::new(SD_OF_FWHM * fwhm),
            noise_sds_dn: Vec::new(),
            kernel: Kernel::of_sd(SD_OF_FWHM * fwhm),
            scratch: Scratch::default(),
            smoothed: Vec::new(),
            reach: (FREE_WIDTHS * fwhm).ceil() as usize,
        }
    }

    /// Adds the outgoing pulse of a shot; ignores one without a clear peak.
    pub fn add_outgoing(&mut self, samples: &[f32]) {
        if let Some(pulse) = Peak::of(samples) {
            self.add_pulse(samples, &pulse);
        }
    }

    /// Adds a waveform with one narrow echo in place of an outgoing pulse; ignores one without a clear peak.
    pub fn add_echo(&mut self, samples: &[f32]) {
        if let Some((echo, _)) = Peak::of_echo(samples) {
            self.add_pulse(samples, &echo);
        }
    }

    fn add_pulse(&mut self, samples: &[f32], pulse: &Peak) {
        for (k, sum) in self.sum.iter_mut().enumerate() {
            let at = pulse.position + (k as f64 - self.peak as f64) / OVERSAMPLING as f64;
            *sum += (interpolated(samples, at).unwrap_or(pulse.level) - pulse.level) / pulse.height;
        }
        self.pulses += 1;
    }

    /// Adds the waveform of a shot.
    pub fn add_waveform(&mut self, samples: &[f32]) {
        self.kernel.smooth_into(samples, &mut self.smoothed);
        // The ends are smoothed with the zeros beyond them.
        let edge = self.reach.min(samples.len() / 2);
        let inner = samples.len() - edge;
        let (Some(inside), Some(smoothed)) = (samples.get(edge..inner), self.smoothed.get(edge..inner))
        else {
            return;
        };
        let Some(found) = background::estimate(inside, smoothed, self.reach, &mut self.scratch) else {
            return;
        };
        let is_free = self.scratch.is_free();
        add_products(&mut self.products, inside, is_free, found.mean_dn);
        self.residual.filter(samples);
        let residual_dn = self.residual.values_dn.get(edge..inner).unwrap_or_default();
        add_products(&mut self.residual_products, residual_dn, is_free, 0.0);
        let powers = self.residual.power_ratio(&self.smoothed, found.mean_dn, is_free, edge, 0.0);
        self.variance_ratios_per_dn.extend(powers.map(|of| (of.ratio - 1.0) / of.mean_signal_dn));
        self.noise_sds_dn.push(found.sd_dn);
    }

    /// The model.
    ///
    /// # Errors
    /// There are too few shots.
    pub fn finish(mut self) -> Result<FootprintModel, LearningError> {
        if self.pulses < LEAST_SHOTS {
            return Err(LearningError::TooFewPulses { found: self.pulses });
        }
        let waveforms = self.noise_sds_dn.len();
        if waveforms < LEAST_SHOTS {
            return Err(LearningError::TooFewBackgrounds { found: waveforms });
        }
        self.noise_sds_dn.sort_unstable_by(f64::total_cmp);
        let mut response: Vec<f64> = self.sum.iter().map(|sum| sum / self.pulses as f64).collect();
        trim(&mut response, self.peak);
        let residual_squares: f64 =
            autocorrelation(&self.residual_products).iter().map(|value| value * value).sum();
        let above = response.iter().filter(|value| **value > 0.5).count();
        Ok(FootprintModel {
            sampling_interval_ns: self.interval_ns,
            noise_sd_dn: self.noise_sds_dn.get(waveforms / 2).copied().unwrap_or_default(),
            autocorrelation: autocorrelation(&self.products),
            residual_noise: ResidualNoise {
                samples_per_independent: 2.0 * residual_squares - 1.0,
                variance_ratio_per_dn: median(self.variance_ratios_per_dn).unwrap_or(0.0).max(0.0),
            },
            response,
            pulse_fwhm_ns: above as f64 / OVERSAMPLING as f64 * self.interval_ns,
            shots: waveforms as u64,
        })
    }
}

/// Adds the mean products of samples without signal at each lag, over their mean square.
fn add_products(sums: &mut [f64], samples: &[f32], is_free: &[bool], level_dn: f64) {
    let mut square = 0.0;
    for (lag, total) in sums.iter_mut().enumerate() {
        let pairs = samples.iter().zip(is_free).zip(samples.iter().zip(is_free).skip(lag));
        let (mut sum, mut count) = (0.0, 0u32);
        for ((a, _), (b, _)) in pairs.filter(|((_, free), (_, other))| **free && **other) {
            sum += (f64::from(*a) - level_dn) * (f64::from(*b) - level_dn);
            count += 1;
        }
        let mean = sum / f64::from(count.max(1));
        if lag == 0 {
            square = mean;
        }
        *total += mean / square.max(f64::MIN_POSITIVE);
    }
}

/// Products over those of lag 0.
fn autocorrelation(products: &[f64]) -> Vec<f64> {
    let own = products.first().copied().unwrap_or(1.0);
    products.iter().map(|product| product / own).collect()
}

/// Sets what lies beyond the feet of the pulse to 0: there is only noise.
fn trim(response: &mut [f64], peak: usize) {
    let (before, behind) = response.split_at_mut(peak.min(response.len()));
    let from = before.iter().rposition(|value| *value < FOOT).map_or(0, |k| k + 1);
    before.get_mut(..from).unwrap_or_default().fill(0.0);
    let until = behind.iter().position(|value| *value < FOOT).unwrap_or(behind.len());
    behind.get_mut(until..).unwrap_or_default().fill(0.0);
}

/// The peak of an outgoing pulse.
struct Peak {
    position: f64,
    height: f64,
    level: f64,
}

impl Peak {
    /// Peak above the median of the samples of the first fifth.
    fn of(samples: &[f32]) -> Option<Peak> {
        Peak::above(samples, level_of(samples.get(..samples.len() / 5)?)?)
    }

    /// Peak of an echo above the lower median of the first and the last fifth, with the SD of a sample there.
    fn of_echo(samples: &[f32]) -> Option<(Peak, f64)> {
        let fifth = samples.len() / 5;
        let ends = [samples.get(..fifth)?, samples.get(samples.len() - fifth..)?];
        let of_end = |end: &[f32]| {
            let level = level_of(end)?;
            let squares: f64 = end.iter().map(|dn| (f64::from(*dn) - level).powi(2)).sum();
            Some((level, (squares / end.len() as f64).sqrt()))
        };
        let [first, last] = ends.map(of_end);
        let ((level, sd), other) = (first?, last?);
        let (level, sd) = if other.0 < level { other } else { (level, sd) };
        Some((Peak::above(samples, level)?, sd))
    }

    /// Peak as the vertex of the parabola through the logarithms of the three highest samples.
    fn above(samples: &[f32], level: f64) -> Option<Peak> {
        let top = (0..samples.len()).max_by(|&a, &b| samples[a].total_cmp(&samples[b]))?;
        let height_at = |k: usize| Some(f64::from(*samples.get(k)?) - level).filter(|dn| *dn > 0.0);
        let [before, here, behind] =
            [height_at(top.checked_sub(1)?)?, height_at(top)?, height_at(top + 1)?].map(libm::log);
        let bend = before - 2.0 * here + behind;
        let offset = if bend < 0.0 { 0.5 * (before - behind) / bend } else { 0.0 };
        let height = libm::exp(here - 0.25 * (before - behind) * offset);
        let is_clear = height.is_finite() && height > 0.0;
        is_clear.then_some(Peak { position: top as f64 + offset, height, level })
    }
}

/// Median of samples.
fn level_of(samples: &[f32]) -> Option<f64> {
    let mut ordered = samples.to_vec();
    ordered.sort_unstable_by(f32::total_cmp);
    ordered.get(ordered.len() / 2).copied().map(f64::from)
}

/// Value between two samples; `None` beyond the ends.
fn interpolated(samples: &[f32], at: f64) -> Option<f64> {
    let first = (at >= 0.0).then(|| at.floor() as usize)?;
    let part = at - first as f64;
    let [a, b] = [*samples.get(first)?, *samples.get(first + 1)?].map(f64::from);
    Some(a + part * (b - a))
}

/// Full width at half maximum of an outgoing pulse, samples; `None` without a clear peak.
pub fn outgoing_fwhm_samples(samples: &[f32]) -> Option<f64> {
    fwhm_samples(samples, &Peak::of(samples)?)
}

/// Widths of a waveform's highest echo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EchoWidth {
    /// Full width at half maximum, samples.
    pub fwhm_samples: f64,
    /// Energy from three of these widths before its peak to six behind, over its height, samples.
    ///
    /// Neighbouring echoes raise it.
    pub spread_samples: f64,
}

impl EchoWidth {
    /// `None` without an echo that is clearly above the noise.
    pub fn of(samples: &[f32]) -> Option<EchoWidth> {
        let (echo, sd) = Peak::of_echo(samples)?;
        if echo.height < CLEAR_SDS * sd {
            return None;
        }
        let fwhm_samples = fwhm_samples(samples, &echo)?;
        let from = (echo.position - BEFORE_WIDTHS * fwhm_samples).max(0.0) as usize;
        let until = (echo.position + BEHIND_WIDTHS * fwhm_samples) as usize + 1;
        let around = samples.get(from..until)?.iter();
        let energy: f64 = around.map(|dn| f64::from(*dn) - echo.level).sum();
        Some(EchoWidth { fwhm_samples, spread_samples: energy / echo.height })
    }
}

fn fwhm_samples(samples: &[f32], peak: &Peak) -> Option<f64> {
    let half = (peak.level + 0.5 * peak.height) as f32;
    let top = peak.position.round() as usize;
    let crossing = |inside: f32, outside: f32| f64::from((inside - half) / (inside - outside));
    let behind = (top..samples.len().checked_sub(1)?).find(|&k| samples[k + 1] < half)?;
    let before = (1..=top.min(samples.len() - 1)).rev().find(|&k| samples[k - 1] < half)?;
    let width = (behind - before) as f64
        + crossing(samples[behind], samples[behind + 1])
        + crossing(samples[before], samples[before - 1]);
    Some(width).filter(|width| width.is_finite() && *width > 0.0)
}
