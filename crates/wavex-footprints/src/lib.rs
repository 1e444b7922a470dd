//! Large footprints: ground, canopy and relative heights of waveforms that are profiles, not a few echoes.
//!
//! A footprint of 20 m and more holds ground and many layers of vegetation. Its waveform is smoothed by the
//! receiver, long, and not a sum of few pulses, therefore it is described as in GEDI's level 2A product
//! (M. Hofton and J. B. Blair, Algorithm Theoretical Basis Document for GEDI Transmit and Receive Waveform
//! Processing, 2019): it is smoothed, its signal lies between the first and the last crossing of a
//! threshold, modes are local maxima, one of the lowest is the ground, and heights are percentiles of the
//! energy. Everything is a function of the samples; standard deviations follow from the
//! autocovariance of the noise, which the receiver's filter correlates over several samples, and which no
//! autoregressive model describes because hardly any part of a sample is unpredictable.
//!
//! [`FootprintLearner`] learns noise and response from shots, [`FootprintEstimator`] measures shots. Samples are
//! fractions of a digitiser step. The cost is linear in their number.

mod background;
mod ground;
mod kernel;
mod model;
mod settings;
#[cfg(test)]
mod tests;

use background::{Background, Scratch};
pub use ground::Candidate;
use kernel::Kernel;
use model::{FREE_WIDTHS, OVERSAMPLING};
pub use model::{FootprintLearner, FootprintModel, LEAST_SHOTS, LearningError, outgoing_fwhm_samples};
pub use settings::{FootprintSettings, NoiseSource};

/// Number of relative heights: of 0, 1, … 100 % of the energy.
pub const HEIGHTS: usize = 101;
/// Most samples of a waveform.
pub const MOST_SAMPLES: usize = 16_384;

/// A value with its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WithSd {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
}

impl WithSd {
    /// An unknown value.
    pub const UNKNOWN: WithSd = WithSd { value: f64::NAN, sd: f64::NAN };
}

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
    /// The mode that is the ground, if there is one.
    pub ground: Option<Candidate>,
    /// Position at which the signal begins.
    pub top_samples: WithSd,
    /// Heights below which 0, 1, … 100 % of the energy lie.
    pub heights_samples: Box<[WithSd; HEIGHTS]>,
    /// Energy, as the height of a flat target's echo of the same energy, DN.
    pub energy_dn: WithSd,
    /// Energy of the ground over that of the waveform.
    pub ground_energy_ratio: WithSd,
    /// Cover of a canopy through which the ground would be found with a probability of 0.9.
    pub sensitivity: f64,
    /// Deviation ratio of the fit.
    pub deviation_ratio: f64,
    /// Level of the background, DN.
    pub background_dn: f64,
    /// Standard deviation of a sample without signal, DN.
    pub noise_sd_dn: f64,
    /// Whether the signal continues before the first sample, and behind the last.
    pub is_cut: [bool; 2],
}

/// A mode of a waveform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FootprintMode {
    /// Position.
    pub position_samples: WithSd,
    /// Height above the background, DN.
    pub amplitude_dn: WithSd,
    /// Distances to half the height, or to the next valley, behind the mode and before it, over those of a flat target.
    pub half_widths: [f64; 2],
    /// Index of the highest smoothed sample.
    top: usize,
}

/// Measures footprints of one receiver.
pub struct FootprintEstimator {
    settings: FootprintSettings,
    /// For the extent of the signal and its energy.
    wide: Smoother,
    /// For modes.
    narrow: Smoother,
    /// Variance of the mean of many samples times their number, over the variance of a sample.
    long_run: f64,
    fwhm_samples: f64,
    interval_ns: f64,
    echo: Echo,
    samples: Vec<f32>,
    cumulative_dn: Vec<f64>,
    scratch: Scratch,
}

/// A kernel with the noise that it leaves, relative to that of a sample.
struct Smoother {
    kernel: Kernel,
    /// Standard deviation of a smoothed sample.
    sd: f64,
    /// Standard deviation of half the difference of its neighbours.
    slope_sd: f64,
    values_dn: Vec<f32>,
}

/// A flat target's echo, after smoothing.
struct Echo {
    /// Sum of its samples over its height.
    area_samples: f64,
    /// Part of its energy behind its mode.
    behind: f64,
    /// Distances from its mode to half its height, behind and before, samples.
    half_widths: [f64; 2],
    /// Its largest value at this distance or more behind its mode, relative to its height.
    tail: Vec<f64>,
}

impl Smoother {
    fn new(sd_samples: f64, autocorrelation: &[f64]) -> Smoother {
        let kernel = Kernel::of_sd(sd_samples);
        let left = kernel.autocorrelation_after(autocorrelation, 3);
        let [own, _, second] = [0, 1, 2].map(|lag| left.get(lag).copied().unwrap_or(0.0));
        Smoother {
            kernel,
            sd: own.max(0.0).sqrt(),
            slope_sd: (0.5 * (own - second)).max(0.0).sqrt(),
            values_dn: Vec::new(),
        }
    }

    fn smooth(&mut self, samples: &[f32]) {
        self.kernel.smooth_into(samples, &mut self.values_dn);
    }
}

impl Echo {
    fn of(model: &FootprintModel, kernel: &Kernel) -> Echo {
        let response: Vec<f32> =
            model.response.iter().map(|value| *value as f32).step_by(OVERSAMPLING).collect();
        let room = 4 * response.len();
        let samples: Vec<f32> = std::iter::repeat_n(0.0, room)
            .chain(response.iter().copied())
            .chain(std::iter::repeat_n(0.0, room))
            .collect();
        let mut smoothed = Vec::new();
        kernel.smooth_into(&samples, &mut smoothed);
        let top = (0..smoothed.len()).max_by(|&a, &b| smoothed[a].total_cmp(&smoothed[b])).unwrap_or(0);
        let height = f64::from(smoothed.get(top).copied().unwrap_or(1.0));
        let position = top as f64 + vertex(&smoothed, top).map_or(0.0, |(offset, _)| offset);
        let area: f64 = smoothed.iter().map(|dn| f64::from(*dn)).sum();
        let before: f64 =
            (0..).zip(&smoothed).map(|(k, dn)| share_before(k, position) * f64::from(*dn)).sum();
        let half_widths = half_widths(&smoothed, top, position, height);
        let mut tail: Vec<f64> = smoothed.iter().skip(top).map(|dn| f64::from(*dn) / height).collect();
        // The largest value from here on: a mode is not made by a ringing response.
        let mut largest = 0.0f64;
        for value in tail.iter_mut().rev() {
            largest = largest.max(*value);
            *value = largest;
        }
        let height_before = model.response.iter().copied().fold(0.0, f64::max);
        Echo { area_samples: area / height_before, behind: 1.0 - before / area, half_widths, tail }
    }
}

/// Distances from a mode to half its height behind it and before it, samples; to the next valley if that is higher.
fn half_widths(values: &[f32], top: usize, position: f64, height: f64) -> [f64; 2] {
    let half = 0.5 * height;
    let behind = values.get(top..).unwrap_or_default().iter().map(|dn| f64::from(*dn));
    let before = values.get(..=top).unwrap_or_default().iter().rev().map(|dn| f64::from(*dn));
    let offset = position - top as f64;
    [steps_to(behind, half) - offset, steps_to(before, half) + offset]
}

/// Number of steps, with its fraction, until values fall below a level or rise again.
fn steps_to(values: impl Iterator<Item = f64>, level: f64) -> f64 {
    let mut last = f64::INFINITY;
    for (step, value) in (0u32..).zip(values) {
        if value <= level {
            return f64::from(step) - (level - value) / (last - value);
        }
        if value > last {
            return f64::from(step.saturating_sub(1));
        }
        last = value;
    }
    f64::INFINITY
}

/// Part of sample `k` that lies before a position.
fn share_before(k: usize, position: f64) -> f64 {
    (position - k as f64 + 0.5).clamp(0.0, 1.0)
}

/// Distance of the vertex of the parabola through a maximum and its neighbours from the maximum, and its
/// second difference; `None` at the ends and without a maximum.
fn vertex(values: &[f32], top: usize) -> Option<(f64, f64)> {
    let at = |k: usize| values.get(k).copied().map(f64::from);
    let (before, here, behind) = (at(top.checked_sub(1)?)?, at(top)?, at(top + 1)?);
    let bend = before - 2.0 * here + behind;
    (bend < 0.0).then(|| (0.5 * (before - behind) / bend, bend))
}

impl FootprintEstimator {
    /// For the receiver of this model.
    pub fn new(model: &FootprintModel, settings: FootprintSettings) -> FootprintEstimator {
        let autocorrelation = &model.autocorrelation;
        let sds = settings.smoothing_ns(model.pulse_fwhm_ns).map(|ns| ns / model.sampling_interval_ns);
        let [wide, narrow] = sds.map(|sd_samples| Smoother::new(sd_samples, autocorrelation));
        let lags: f64 = autocorrelation.iter().skip(1).sum();
        FootprintEstimator {
            settings,
            long_run: (1.0 + 2.0 * lags).max(0.1),
            fwhm_samples: model.pulse_fwhm_ns / model.sampling_interval_ns,
            interval_ns: model.sampling_interval_ns,
            echo: Echo::of(model, &narrow.kernel),
            wide,
            narrow,
            samples: Vec::new(),
            cumulative_dn: Vec::new(),
            scratch: Scratch::default(),
        }
    }

    /// Measures a waveform.
    ///
    /// `None` if it has no background beside its signal, more than [`MOST_SAMPLES`] samples, or samples that are not finite.
    pub fn measure(&mut self, samples: &[f32], recorded: Option<RecordedNoise>) -> Option<Measured> {
        if samples.len() > MOST_SAMPLES || samples.iter().any(|dn| !dn.is_finite()) {
            return None;
        }
        let background = self.remove_background(samples, recorded)?;
        let n = samples.len();
        let wide_sd_dn = background.sd_dn * self.wide.sd;
        let unit_dn = match (self.settings.noise, recorded) {
            (NoiseSource::Recorded, Some(recorded)) => [recorded.sd_dn; 2],
            _ => [wide_sd_dn, background.sd_dn * self.narrow.sd],
        };
        let [front_dn, back_dn] =
            [self.settings.front_sigma, self.settings.back_sigma].map(|sigma| sigma * unit_dn[0]);
        let first = self.wide.values_dn.iter().position(|dn| f64::from(*dn) > front_dn);
        let last = self.wide.values_dn.iter().rposition(|dn| f64::from(*dn) > back_dn);
        let mut measured = Measured {
            modes: Vec::new(),
            ground: None,
            top_samples: WithSd::UNKNOWN,
            heights_samples: Box::new([WithSd::UNKNOWN; HEIGHTS]),
            energy_dn: WithSd::UNKNOWN,
            ground_energy_ratio: WithSd::UNKNOWN,
            sensitivity: f64::NAN,
            deviation_ratio: f64::NAN,
            background_dn: background.mean_dn,
            noise_sd_dn: background.sd_dn,
            is_cut: [first == Some(0), last == Some(n - 1)],
        };
        let (Some(first), Some(last)) = (first, last.filter(|last| first.is_some_and(|first| first < *last)))
        else {
            return Some(measured);
        };
        self.find_modes(
            first..last + 1,
            self.settings.back_sigma * unit_dn[1],
            &background,
            &mut measured.modes,
        );
        self.cumulate(first, last);
        let energy = self.cumulative_dn.last().copied().unwrap_or(0.0);
        let noise = Noise { variance: self.long_run * background.sd_dn.powi(2), free: background.free };
        let length = (last + 1 - first) as f64;
        let energy_sd = noise.sd_of_sum(length, length);
        measured.energy_dn =
            WithSd { value: energy / self.echo.area_samples, sd: energy_sd / self.echo.area_samples };
        measured.sensitivity = self.sensitivity(energy, &background, self.settings.back_sigma * unit_dn[1]);
        measured.top_samples = self.crossing(first, front_dn, wide_sd_dn);
        let modes = measured.modes.len();
        if let Some(ground) = measured.modes.last_mut().filter(|_| energy > 0.0) {
            let below_dn = self.energy_below(ground.position_samples.value, first, last);
            let scale = 1.0 / (self.echo.behind * energy);
            let ratio = (below_dn * scale).min(1.0);
            let sd = noise.sd_of_sum(last as f64 - ground.position_samples.value, 0.0) * scale;
            measured.ground_energy_ratio = WithSd { value: ratio, sd };
            if !measured.is_cut[1] {
                let evidence = ground::Evidence {
                    half_widths: ground.half_widths,
                    energy_ratio: ratio,
                    height_sds: ground.amplitude_dn.value / ground.amplitude_dn.sd,
                    modes,
                };
                ground.position_samples = evidence.position(ground, self.interval_ns);
                measured.ground = Some(Candidate { mode: modes - 1, probability: evidence.probability() });
                let ground = *ground;
                self.heights(&ground, first, last, energy, &noise, &mut measured.heights_samples);
            }
        }
        Some(measured)
    }

    /// Subtracts the background and smooths.
    fn remove_background(&mut self, samples: &[f32], recorded: Option<RecordedNoise>) -> Option<Background> {
        self.wide.smooth(samples);
        let reach = (FREE_WIDTHS * self.fwhm_samples).ceil() as usize;
        let edge = reach.min(samples.len() / 2);
        let inner = edge..samples.len() - edge;
        let found = background::estimate(
            samples.get(inner.clone())?,
            self.wide.values_dn.get(inner)?,
            reach,
            &mut self.scratch,
        );
        let own = found.or_else(|| {
            recorded.map(|noise| Background {
                mean_dn: noise.mean_dn,
                sd_dn: noise.sd_dn,
                free: background::LEAST_FREE,
            })
        })?;
        let background = match (self.settings.noise, recorded) {
            (NoiseSource::Recorded, Some(recorded)) => Background { mean_dn: recorded.mean_dn, ..own },
            _ => own,
        };
        let level = background.mean_dn as f32;
        self.samples.clear();
        self.samples.extend(samples.iter().map(|dn| dn - level));
        self.wide.smooth(&self.samples);
        self.narrow.smooth(&self.samples);
        Some(background)
    }

    /// Local maxima of the smoothed waveform within a range of samples, above a threshold.
    fn find_modes(
        &self,
        within: std::ops::Range<usize>,
        least_dn: f64,
        background: &Background,
        modes: &mut Vec<FootprintMode>,
    ) {
        let values = &self.narrow.values_dn;
        let height_sd_dn = background.sd_dn * self.narrow.sd;
        let slope_sd_dn = background.sd_dn * self.narrow.slope_sd;
        // A valley is real if it is deeper than the noise of a difference.
        let depth_dn =
            if self.settings.takes_every_maximum { 0.0 } else { std::f64::consts::SQRT_2 * least_dn };
        for top in within {
            let Some((offset, bend_dn)) = vertex(values, top) else { continue };
            let at = |k: usize| values.get(k).copied().map_or(0.0, f64::from);
            if !(at(top) > at(top - 1) && at(top) >= at(top + 1)) || at(top) <= least_dn {
                continue;
            }
            let height_dn = at(top) - 0.25 * (at(top - 1) - at(top + 1)) * offset;
            let mode = FootprintMode {
                position_samples: WithSd { value: top as f64 + offset, sd: slope_sd_dn / -bend_dn },
                amplitude_dn: WithSd { value: height_dn, sd: height_sd_dn },
                half_widths: self.widths_of(top, top as f64 + offset, height_dn),
                top,
            };
            if let Some(last) = modes.last().copied() {
                let valley_dn = values
                    .get(last.top..top)
                    .unwrap_or_default()
                    .iter()
                    .fold(f64::INFINITY, |low, dn| low.min(f64::from(*dn)));
                let lower_dn = last.amplitude_dn.value.min(height_dn);
                if lower_dn - valley_dn < depth_dn {
                    // One mode with a ripple: the higher maximum.
                    if height_dn > last.amplitude_dn.value {
                        modes.pop();
                        modes.push(mode);
                    }
                    continue;
                }
            }
            if !self.settings.takes_every_maximum
                && height_dn < least_dn + self.tails_dn(modes, mode.position_samples.value)
            {
                continue;
            }
            modes.push(mode);
        }
    }

    /// Half widths of a mode over those of a flat target.
    fn widths_of(&self, top: usize, position: f64, height_dn: f64) -> [f64; 2] {
        let own = half_widths(&self.narrow.values_dn, top, position, height_dn);
        [0, 1].map(|side| own[side] / self.echo.half_widths[side])
    }

    /// Largest signal that the tails of modes leave at a position behind them, DN.
    fn tails_dn(&self, modes: &[FootprintMode], position: f64) -> f64 {
        let tail = |mode: &FootprintMode| {
            let distance = (position - mode.position_samples.value).max(0.0) as usize;
            mode.amplitude_dn.value * self.echo.tail.get(distance).copied().unwrap_or(0.0)
        };
        modes.iter().map(tail).sum()
    }

    /// Fills the energy of the smoothed waveform up to the end of each sample from the first one.
    fn cumulate(&mut self, first: usize, last: usize) {
        self.cumulative_dn.clear();
        let mut sum_dn = 0.0;
        self.cumulative_dn.extend(self.wide.values_dn.get(first..=last).unwrap_or_default().iter().map(
            |dn| {
                sum_dn += f64::from(*dn);
                sum_dn
            },
        ));
    }

    /// Energy behind a position, DN.
    fn energy_below(&self, position: f64, first: usize, last: usize) -> f64 {
        let share = |k: usize| 1.0 - share_before(k, position);
        let values = self.wide.values_dn.get(first..=last).unwrap_or_default();
        (first..).zip(values).map(|(k, dn)| share(k) * f64::from(*dn)).sum()
    }

    /// Cover at which a ground echo would still be detected in nine of ten waveforms.
    fn sensitivity(&self, energy: f64, background: &Background, threshold_dn: f64) -> f64 {
        /// Normal deviate of nine of ten.
        const DEVIATE: f64 = 1.282;
        let least_height_dn = threshold_dn + DEVIATE * background.sd_dn * self.narrow.sd;
        let least_energy = least_height_dn * self.echo.area_samples;
        (1.0 - least_energy / energy).clamp(0.0, 1.0)
    }

    /// Position at which the smoothed waveform crosses a threshold before a sample.
    fn crossing(&self, first: usize, threshold_dn: f64, sd_dn: f64) -> WithSd {
        let at = |k: usize| self.wide.values_dn.get(k).copied().map_or(0.0, f64::from);
        let Some(before) = first.checked_sub(1) else { return WithSd::UNKNOWN };
        let rise_dn = at(first) - at(before);
        WithSd { value: first as f64 - (at(first) - threshold_dn) / rise_dn, sd: sd_dn / rise_dn }
    }

    /// Heights of the percentiles of the energy above the ground.
    fn heights(
        &self,
        ground: &FootprintMode,
        first: usize,
        last: usize,
        energy: f64,
        noise: &Noise,
        heights: &mut [WithSd; HEIGHTS],
    ) {
        // From the ground upwards: the energy above a position is what the first samples hold.
        let cumulative = &self.cumulative_dn;
        let mut k = 0;
        for (percent, height) in heights.iter_mut().enumerate().rev() {
            let part = percent as f64 / (HEIGHTS - 1) as f64;
            let wanted = (1.0 - part) * energy;
            while k + 1 < cumulative.len() && cumulative.get(k).is_some_and(|sum| *sum < wanted) {
                k += 1;
            }
            let until = cumulative.get(k).copied().unwrap_or(energy);
            let from = k.checked_sub(1).and_then(|k| cumulative.get(k)).copied().unwrap_or(0.0);
            let density = (until - from).max(f64::MIN_POSITIVE);
            let position = (first + k) as f64 + 0.5 - ((until - wanted) / density).clamp(0.0, 1.0);
            let (above, below) = (position - first as f64, last as f64 + 1.0 - position);
            let squares = above * part.powi(2) + below * (1.0 - part).powi(2);
            let sum = above * part - below * (1.0 - part);
            // The density over the distance that the noise may move the percentile.
            let sd = noise.sd_of_weights(squares, sum) / self.mean_density(k, density);
            *height = WithSd {
                value: ground.position_samples.value - position,
                sd: sd.hypot(ground.position_samples.sd),
            };
        }
    }

    /// Mean density of the energy around a sample, within half a width of the response.
    fn mean_density(&self, k: usize, at_least: f64) -> f64 {
        let half = (0.5 * self.fwhm_samples).ceil() as usize;
        let until = (k + half).min(self.cumulative_dn.len().saturating_sub(1));
        let from = k.saturating_sub(half);
        let [low, high] = [from, until].map(|k| self.cumulative_dn.get(k).copied().unwrap_or(0.0));
        let mean = (high - low) / (until.saturating_sub(from).max(1)) as f64;
        if mean > 0.0 { mean } else { at_least }
    }
}

/// Noise of sums over many samples.
struct Noise {
    /// Variance of a sum per sample, DN².
    variance: f64,
    /// Number of samples from which the background was estimated.
    free: usize,
}

impl Noise {
    /// SD of a sum of `count` samples above a background that `on_background` of them share.
    fn sd_of_sum(&self, count: f64, on_background: f64) -> f64 {
        self.sd_of_weights(count.max(0.0), on_background)
    }

    /// SD of a weighted sum: of its squared weights, and of their sum, which the background's error multiplies.
    fn sd_of_weights(&self, squares: f64, sum: f64) -> f64 {
        (self.variance * (squares + sum * sum / self.free as f64)).sqrt()
    }
}
