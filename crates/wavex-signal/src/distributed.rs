//! Distributed targets: relative heights of the energy of a waveform above its last mode.
//!
//! Dense vegetation under a large footprint is not a sum of a few echoes. Its waveform is described
//! as in the level 2A product of GEDI (M. Hofton and J. B. Blair, Algorithm Theoretical Basis Document
//! for GEDI Transmit and Receive Waveform Processing, 2019): the waveform is smoothed, the signal lies
//! between its first and last crossing of a threshold, modes are local maxima of the smoothed
//! waveform, the last significant one is the ground, and heights are percentiles of the cumulative
//! energy, counted from the ground upwards. Everything is a function of the samples, therefore the
//! standard deviations follow from the covariance of the noise.

mod linear;
mod modes;
#[cfg(test)]
mod tests;

use crate::noise::ArNoise;
use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::{Pulse, Shape};

pub use wavex_simd::statistics::WithSd;

use linear::{LinearKernel, variance};
use modes::{ProfileMode, largest_rise, modes};

/// Parts of the energy whose heights above the ground are given.
pub const RELATIVE_HEIGHTS: [f64; 4] = [0.25, 0.5, 0.75, 0.98];
/// Flag of a profile: no ground. There is no significant mode, or the signal continues at the end of
/// the block.
pub const GROUND_MISSING: u8 = 1;
/// Flag of a profile: the signal begins before the block.
pub const TOP_MISSING: u8 = 2;
/// Flag of a profile: samples are clipped.
pub const CLIPPED: u8 = 4;

/// Fewest samples of a waveform.
const LEAST_SAMPLES: usize = 8;
/// Smoothed signal over the standard deviation of its noise from which it counts.
const CLEAR: f64 = 4.5;
/// Distance from the signal at which samples are free of it, pulse widths.
const FREE_WIDTHS: f64 = 2.0;
/// Distance from the crossings of the threshold within which energy counts, pulse widths.
const MARGIN_WIDTHS: f64 = 1.0;
/// Length of the end of a block that must be free of signal, pulse widths.
const CUT_WIDTHS: f64 = 0.25;
/// Half length of the secant that gives the density at a percentile, SDs of its energy.
const SECANT_SDS: f64 = 1.5;
/// A mode behind a higher one is this many times as prominent as the ringing of the response there.
const RINGING_FACTOR: f64 = 2.0;

/// Profile of a distributed target. Positions are samples from the first of the block; unknown values
/// are NaN.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TargetProfile {
    /// Position of the first significant mode, as the peak of an echo.
    pub first_peak_samples: WithSd,
    /// Position of the last significant mode, the ground, as the peak of an echo.
    pub last_peak_samples: WithSd,
    /// Number of significant modes.
    pub peaks: u32,
    /// Heights above the ground below which these parts ([`RELATIVE_HEIGHTS`]) of the energy lie,
    /// samples; negative below the ground.
    pub heights_samples: [WithSd; RELATIVE_HEIGHTS.len()],
    /// Height above the ground at which the signal begins, samples.
    pub top_samples: WithSd,
    /// Energy, as the height of a flat target's echo of the same energy, DN.
    pub energy_dn: WithSd,
    /// [`GROUND_MISSING`], [`TOP_MISSING`], [`CLIPPED`].
    pub flags: u8,
}

/// Estimates profiles of the waveforms of one channel.
pub struct DistributedTargets {
    model: ChannelModel,
    noise: ArNoise,
    fwhm_samples: f64,
    kernel: LinearKernel,
    /// Standard deviation of the noise of the smoothed waveform, DN.
    smoothed_sd_dn: f64,
    echo: SmoothedEcho,
    signal_dn: Vec<f64>,
    smoothed_dn: Vec<f64>,
    /// Energy up to each edge of the samples, DN.
    cumulative_dn: Vec<f64>,
    modes: Vec<ProfileMode>,
    weights: Weights,
}

/// Weights of the samples in a linear function of them.
#[derive(Default)]
struct Weights {
    of_smoothed: Vec<f64>,
    of_samples: Vec<f64>,
    smoothed: Vec<f64>,
}

/// The smoothed response.
struct SmoothedEcho {
    /// Position of its maximum after the peak of the response, samples.
    delay_samples: f64,
    /// Largest rise behind the maximum, relative to it.
    ringing: f64,
    /// Sum of the samples of a response of height 1.
    area_samples: f64,
}

impl SmoothedEcho {
    fn of(model: &ChannelModel, kernel: &LinearKernel) -> Result<SmoothedEcho, ModelError> {
        const NOISE_SDS: f64 = 50.0;
        let shape = Shape::of(model)?;
        let before = (8.0 * shape.fwhm_samples()).ceil() as usize + 1;
        let mut samples = vec![0.0; 4 * before + 256];
        let height_dn = NOISE_SDS * model.noise_sd_dn;
        let pulse = Pulse {
            height_dn,
            position_samples: before as f64,
            ln_width_ratio: 0.0,
            ln_width_precision: 0.0,
        };
        shape.add(&pulse, height_dn.recip(), &mut samples);
        let mut smoothed = Vec::new();
        kernel.smooth_into(&samples, &mut smoothed);
        let top = (1..smoothed.len() - 1).max_by(|&i, &j| smoothed[i].total_cmp(&smoothed[j])).unwrap_or(1);
        Ok(SmoothedEcho {
            delay_samples: ProfileMode::at(&smoothed, top).position() - before as f64,
            ringing: largest_rise(&smoothed[top..]) / smoothed[top],
            area_samples: samples.iter().sum(),
        })
    }
}

/// The signal of a waveform and the part of its block without signal.
struct Extent {
    /// First and last sample above the threshold.
    above: [usize; 2],
    /// Samples without signal: those before the first and from the second number on.
    free: [usize; 2],
}

impl Extent {
    fn is_free(&self, sample: usize) -> bool {
        sample < self.free[0] || sample >= self.free[1]
    }
}

impl DistributedTargets {
    /// Creates the estimator of a channel.
    ///
    /// # Errors
    /// The model is invalid.
    pub fn new(model: &ChannelModel) -> Result<DistributedTargets, ModelError> {
        let noise = model.noise()?;
        let fwhm_samples = Shape::of(model)?.fwhm_samples();
        let kernel = LinearKernel::of_fwhm(fwhm_samples);
        Ok(DistributedTargets {
            smoothed_sd_dn: variance(&noise, &mut kernel.weights().to_vec()).sqrt(),
            echo: SmoothedEcho::of(model, &kernel)?,
            model: model.clone(),
            noise,
            fwhm_samples,
            kernel,
            signal_dn: Vec::new(),
            smoothed_dn: Vec::new(),
            cumulative_dn: Vec::new(),
            modes: Vec::new(),
            weights: Weights::default(),
        })
    }

    /// Profile of a waveform; `None` if it is shorter than 8 samples or without signal.
    ///
    /// `offset_dn` is its background above the background of the channel, DN; samples without signal
    /// correct it.
    pub fn profile(&mut self, samples: &[u16], offset_dn: f64) -> Option<TargetProfile> {
        if samples.len() < LEAST_SAMPLES {
            return None;
        }
        self.signal_dn.clear();
        self.model.signal_into(samples, &mut self.signal_dn);
        self.signal_dn.iter_mut().for_each(|dn| *dn -= offset_dn);
        let extent = self.remove_background()?;
        let is_clipped = samples.iter().any(|&sample| f64::from(sample) >= self.model.full_scale_dn);
        self.find_modes();
        let last = self.modes.last().copied();
        let mut flags = 0;
        if last.is_none() || self.is_cut(extent.above[1] + 1 == samples.len(), self.signal_dn.iter().rev()) {
            flags |= GROUND_MISSING;
        }
        if self.is_cut(extent.above[0] == 0, self.signal_dn.iter()) {
            flags |= TOP_MISSING;
        }
        if is_clipped {
            flags |= CLIPPED;
        }
        let mut profile = TargetProfile {
            first_peak_samples: WithSd::UNKNOWN,
            last_peak_samples: WithSd::UNKNOWN,
            peaks: self.modes.len() as u32,
            heights_samples: [WithSd::UNKNOWN; RELATIVE_HEIGHTS.len()],
            top_samples: WithSd::UNKNOWN,
            energy_dn: WithSd::UNKNOWN,
            flags,
        };
        if is_clipped {
            return Some(profile);
        }
        if let Some(first) = self.modes.first().copied() {
            profile.first_peak_samples = self.position(&first, &extent);
        }
        let window = self.window(&extent);
        profile.energy_dn = self.energy(window, &extent);
        let Some(ground) = last.filter(|_| flags & GROUND_MISSING == 0) else { return Some(profile) };
        profile.last_peak_samples = self.position(&ground, &extent);
        if flags & TOP_MISSING == 0 && profile.energy_dn.value > 0.0 {
            profile.heights_samples =
                RELATIVE_HEIGHTS.map(|part| self.height(part, &ground, window, &extent));
            profile.top_samples = self.top(&ground, &extent);
        }
        Some(profile)
    }

    /// Whether the signal reaches an end of the block: the smoothed one, or the mean of the last samples
    /// there, which smoothing mixes with nothing beyond the end.
    fn is_cut<'a>(&self, is_above: bool, from_end: impl Iterator<Item = &'a f64>) -> bool {
        let count = (CUT_WIDTHS * self.fwhm_samples).ceil();
        let mean_dn = from_end.take(count as usize).sum::<f64>() / count;
        is_above || mean_dn > CLEAR * self.model.noise_sd_dn
    }

    fn threshold_dn(&self) -> f64 {
        CLEAR * self.smoothed_sd_dn
    }

    /// Subtracts the mean of the samples without signal, and smooths; `None` without signal.
    fn remove_background(&mut self) -> Option<Extent> {
        let n = self.signal_dn.len();
        let reach = (FREE_WIDTHS * self.fwhm_samples).ceil() as usize;
        let mut extent = self.extent(reach)?;
        // The second pass finds the signal above the corrected background.
        for _ in 0..2 {
            let count = (0..n).filter(|&k| extent.is_free(k)).count();
            if count < reach.max(LEAST_SAMPLES) {
                extent.free = [0, n];
                return Some(extent);
            }
            let free = (0..n).filter(|&k| extent.is_free(k)).map(|k| self.signal_dn[k]);
            let mean_dn = free.sum::<f64>() / count as f64;
            self.signal_dn.iter_mut().for_each(|dn| *dn -= mean_dn);
            extent = self.extent(reach)?;
        }
        Some(extent)
    }

    fn extent(&mut self, reach: usize) -> Option<Extent> {
        self.kernel.smooth_into(&self.signal_dn, &mut self.smoothed_dn);
        let threshold_dn = self.threshold_dn();
        let is_above = |dn: &f64| *dn > threshold_dn;
        let first = self.smoothed_dn.iter().position(is_above)?;
        let last = self.smoothed_dn.iter().rposition(is_above)?;
        let free = [first.saturating_sub(reach), (last + reach + 1).min(self.signal_dn.len())];
        Some(Extent { above: [first, last], free })
    }

    fn find_modes(&mut self) {
        // The noise of a difference of two independent values.
        let least_dn = 2f64.sqrt() * self.threshold_dn();
        modes(&self.smoothed_dn, least_dn, RINGING_FACTOR * self.echo.ringing, &mut self.modes);
    }

    /// Standard deviation of the linear function with the current weights.
    ///
    /// A common error of the samples counts against the background.
    fn sd(&mut self, extent: &Extent) -> f64 {
        let Weights { of_smoothed, of_samples, smoothed } = &mut self.weights;
        self.kernel.smooth_into(of_smoothed, smoothed);
        of_samples.iter_mut().zip(smoothed.iter()).for_each(|(weight, smoothed)| *weight += smoothed);
        let n = of_samples.len();
        let free = (0..n).filter(|&k| extent.is_free(k)).count();
        let share = if free == 0 { 0.0 } else { of_samples.iter().sum::<f64>() / free as f64 };
        (0..n).filter(|&k| extent.is_free(k)).for_each(|k| of_samples[k] -= share);
        variance(&self.noise, of_samples).max(0.0).sqrt()
    }

    fn clear_weights(&mut self) {
        for weights in [&mut self.weights.of_smoothed, &mut self.weights.of_samples] {
            weights.clear();
            weights.resize(self.signal_dn.len(), 0.0);
        }
    }

    /// Position of a mode as the peak of an echo.
    fn position(&mut self, mode: &ProfileMode, extent: &Extent) -> WithSd {
        self.clear_weights();
        mode.add_slopes(1.0, &mut self.weights.of_smoothed);
        WithSd { value: mode.position() - self.echo.delay_samples, sd: self.sd(extent) }
    }

    /// First and last position within which energy counts; fills the cumulative energy.
    fn window(&mut self, extent: &Extent) -> [f64; 2] {
        let n = self.signal_dn.len();
        let margin = MARGIN_WIDTHS * self.fwhm_samples;
        let [first, last] = [0, 1].map(|side| self.crossing(extent, side).0);
        let window = [(first - margin).max(-0.5), (last + margin).min(n as f64 - 0.5)];
        self.cumulative_dn.clear();
        self.cumulative_dn.push(0.0);
        let mut sum_dn = 0.0;
        for (k, dn) in self.signal_dn.iter().enumerate() {
            sum_dn += share(k, window) * dn;
            self.cumulative_dn.push(sum_dn);
        }
        window
    }

    /// Position at which the smoothed signal crosses the threshold, with its derivatives by the two
    /// samples around it; first (0) or last (1) crossing.
    fn crossing(&self, extent: &Extent, side: usize) -> (f64, [(usize, f64); 2]) {
        let inside = extent.above[side];
        let outside = if side == 0 { inside.checked_sub(1) } else { Some(inside + 1) };
        let Some((outside, outside_dn)) = outside.and_then(|k| Some((k, *self.smoothed_dn.get(k)?))) else {
            return (inside as f64, [(inside, 0.0); 2]);
        };
        let step = self.smoothed_dn[inside] - outside_dn;
        let part = (self.threshold_dn() - outside_dn) / step;
        let sign = inside as f64 - outside as f64;
        let slopes = [(outside, -sign * (1.0 - part) / step), (inside, -sign * part / step)];
        (outside as f64 + sign * part, slopes)
    }

    fn energy(&mut self, window: [f64; 2], extent: &Extent) -> WithSd {
        self.clear_weights();
        self.weights.of_samples.iter_mut().enumerate().for_each(|(k, weight)| *weight = share(k, window));
        let sum_dn = self.cumulative_dn[self.signal_dn.len()];
        WithSd { value: sum_dn / self.echo.area_samples, sd: self.sd(extent) / self.echo.area_samples }
    }

    /// Height above the ground below which a part of the energy lies.
    fn height(&mut self, part: f64, ground: &ProfileMode, window: [f64; 2], extent: &Extent) -> WithSd {
        // Beams travel downwards: the part of the energy from below is the rest of that from above.
        let above = 1.0 - part;
        let wanted_dn = above * self.cumulative_dn[self.signal_dn.len()];
        let level = self.level(part, wanted_dn);
        self.weigh_energy(above, &level, 1.0, window);
        let energy_sd_dn = self.sd(extent);
        // The density changes within the error of the energy: a secant, not a tangent.
        let reach_dn = SECANT_SDS * energy_sd_dn;
        let [low, high] = [-reach_dn, reach_dn].map(|dn| self.level(part, wanted_dn + dn).position());
        let density_dn = 2.0 * reach_dn / (high - low).max(f64::EPSILON);
        self.weigh_energy(above, &level, -density_dn.recip(), window);
        ground.add_slopes(1.0, &mut self.weights.of_smoothed);
        WithSd { value: ground.position() - level.position(), sd: self.sd(extent) }
    }

    /// Level above which this energy lies; `part` is its distance from all energy.
    fn level(&self, part: f64, energy_dn: f64) -> Level {
        let cumulative_dn = &self.cumulative_dn;
        let last = self.signal_dn.len() - 1;
        let energy_dn = energy_dn.clamp(0.0, cumulative_dn[last + 1]);
        // Noise makes the sum not monotonic: the crossing next to the middle of the energy counts.
        let sample = if part > 0.5 {
            cumulative_dn.iter().position(|&dn| dn >= energy_dn).map_or(0, |edge| edge.saturating_sub(1))
        } else {
            cumulative_dn.iter().rposition(|&dn| dn <= energy_dn).unwrap_or(0)
        };
        let sample = sample.min(last);
        let step_dn = cumulative_dn[sample + 1] - cumulative_dn[sample];
        let inside = if step_dn > 0.0 { (energy_dn - cumulative_dn[sample]) / step_dn } else { 0.5 };
        Level { sample, inside: inside.clamp(0.0, 1.0) }
    }

    /// Weights of `factor` times a part of the energy less the energy above a level.
    fn weigh_energy(&mut self, part: f64, level: &Level, factor: f64, window: [f64; 2]) {
        self.clear_weights();
        for (k, weight) in self.weights.of_samples.iter_mut().enumerate() {
            let counted = match k.cmp(&level.sample) {
                std::cmp::Ordering::Less => 1.0,
                std::cmp::Ordering::Equal => level.inside,
                std::cmp::Ordering::Greater => 0.0,
            };
            *weight = factor * (part - counted) * share(k, window);
        }
    }

    /// Height above the ground at which the signal begins.
    fn top(&mut self, ground: &ProfileMode, extent: &Extent) -> WithSd {
        let (position, slopes) = self.crossing(extent, 0);
        self.clear_weights();
        ground.add_slopes(1.0, &mut self.weights.of_smoothed);
        slopes.iter().for_each(|&(k, slope)| self.weights.of_smoothed[k] -= slope);
        WithSd { value: ground.position() - position, sd: self.sd(extent) }
    }
}

/// A position within the block: a sample, and the part of it before the position.
struct Level {
    sample: usize,
    inside: f64,
}

impl Level {
    fn position(&self) -> f64 {
        self.sample as f64 - 0.5 + self.inside
    }
}

/// Share of a sample that lies within a window.
fn share(sample: usize, [first, last]: [f64; 2]) -> f64 {
    let at = sample as f64;
    ((at + 0.5).min(last) - (at - 0.5).max(first)).clamp(0.0, 1.0)
}
