//! Statistics over a whole recording: stretches are compared with each other.

use super::finding::{Area, Finding};
use super::statistics::Location;
use crate::calibrate::clipping_level_of_counts;
use crate::sensor_model::{Background, ChannelModel};

/// Samples of the lowest stretch of a block.
const WINDOW: usize = 12;
/// Largest number of blocks that are kept.
const MAX_KEPT: usize = 4096;
/// Numbers of parts into which a recording is split: longer parts resolve smaller changes.
const PARTS: [usize; 3] = [8, 4, 2];
/// Fewest blocks of a part.
const MIN_PER_PART: usize = 25;
/// Smallest ratio of the noise of two parts that is a change …
const NOISE_RATIO: f64 = 1.25;
/// … and smallest difference of their backgrounds, standard deviations of noise and background.
const BACKGROUND_SD: f64 = 1.5;
/// Significance of a change, standard deviations.
const SIGNIFICANT: f64 = 5.0;
/// Fewest blocks beyond the full scale of the model.
const MIN_BEYOND: u32 = 5;

/// `√70`: SD of fourth differences of white noise, over that of the noise.
const DIFFERENCE_GAIN: f64 = 8.366_600_265_340_756;

/// Noise and background along a recording, and its highest samples.
///
/// Keeps at most 4096 evenly spaced blocks.
#[derive(Debug, Clone, Default)]
pub struct Running {
    every: usize,
    seen: usize,
    /// Level and noise of the lowest stretch of a block, DN.
    kept: Vec<[f32; 2]>,
    highest: Highest,
}

impl Running {
    /// Adds a block, whose highest sample is known.
    pub fn add(&mut self, samples: &[u16], highest: u16) {
        self.highest.add(highest);
        if self.seen.is_multiple_of(self.every.max(1))
            && let Some(lowest) = lowest_stretch(samples)
        {
            if self.kept.len() == MAX_KEPT {
                let mut index = 0;
                self.kept.retain(|_| {
                    index += 1;
                    index % 2 == 1
                });
                self.every = 2 * self.every.max(1);
            }
            self.kept.push(lowest);
        }
        self.seen += 1;
    }

    /// Distance of the blocks that are kept.
    #[cfg(test)]
    pub(super) fn kept_every(&self) -> usize {
        self.every
    }

    /// Compares the parts of the recording with each other, and its highest samples with the model.
    pub fn findings(&self, model: &ChannelModel) -> Vec<Finding> {
        let mut findings: Vec<Finding> = self.highest.finding(model).into_iter().collect();
        let drifts: Vec<Finding> = PARTS.iter().flat_map(|&parts| self.drifts(parts, model)).collect();
        for area in [Area::BackgroundDrift, Area::NoiseDrift] {
            findings.extend(drifts.iter().find(|finding| finding.area == area).cloned());
        }
        findings
    }

    /// Compares this number of parts of the recording.
    fn drifts(&self, parts: usize, model: &ChannelModel) -> Vec<Finding> {
        let per_part = self.kept.len() / parts;
        if per_part < MIN_PER_PART {
            return Vec::new();
        }
        let of_quantity = |quantity: usize| -> Vec<Location> {
            let of_part = |part: &[[f32; 2]]| {
                Location::of(&mut part.iter().map(|kept| f64::from(kept[quantity])).collect::<Vec<_>>())
            };
            self.kept.chunks_exact(per_part).take(parts).map(of_part).collect()
        };
        let level_sd_dn = match model.background {
            Background::Fixed => model.noise_sd_dn,
            Background::PerWaveform => model.noise_sd_dn.hypot(model.background_sd_dn),
        };
        let (low, high) = extremes(&of_quantity(0));
        let background_limit_dn =
            BACKGROUND_SD * level_sd_dn + SIGNIFICANT * low.median_sd().hypot(high.median_sd());
        let background = Finding {
            area: Area::BackgroundDrift,
            measured: high.median - low.median,
            expected: 0.0,
            accepted: [f64::NEG_INFINITY, background_limit_dn],
            unit: "DN",
        };
        let (low, high) = extremes(&of_quantity(1));
        let relative_sd = (low.median_sd() / low.median).hypot(high.median_sd() / high.median);
        let noise = Finding {
            area: Area::NoiseDrift,
            measured: high.median / low.median.max(f64::MIN_POSITIVE),
            expected: 1.0,
            accepted: [f64::NEG_INFINITY, NOISE_RATIO * (1.0 + SIGNIFICANT * relative_sd)],
            unit: "",
        };
        [background, noise].into_iter().filter_map(Finding::unless_accepted).collect()
    }
}

/// The parts with the smallest and the largest median.
fn extremes(parts: &[Location]) -> (Location, Location) {
    let by_median = |a: &&Location, b: &&Location| a.median.total_cmp(&b.median);
    let low = parts.iter().min_by(by_median).copied().unwrap_or_default();
    (low, parts.iter().max_by(by_median).copied().unwrap_or_default())
}

/// Mean of the lowest stretch of a block and its noise by fourth differences, DN.
fn lowest_stretch(samples: &[u16]) -> Option<[f32; 2]> {
    let mut sum: u32 = samples.get(..WINDOW)?.iter().map(|&sample| u32::from(sample)).sum();
    let (mut least, mut start) = (sum, 0);
    for k in WINDOW..samples.len() {
        sum = sum + u32::from(samples[k]) - u32::from(samples[k - WINDOW]);
        if sum < least {
            (least, start) = (sum, k + 1 - WINDOW);
        }
    }
    let differences = samples[start..start + WINDOW].windows(5).map(|window| {
        let s = [0, 1, 2, 3, 4].map(|i| f64::from(window[i]));
        s[0] - 4.0 * s[1] + 6.0 * s[2] - 4.0 * s[3] + s[4]
    });
    let mean_square = differences.map(|d| d * d).sum::<f64>() / (WINDOW - 4) as f64;
    Some([least as f32 / WINDOW as f32, (mean_square.sqrt() / DIFFERENCE_GAIN) as f32])
}

/// Number of blocks by their highest sample.
#[derive(Debug, Clone, Default)]
pub(super) struct Highest(Vec<u32>);

impl Highest {
    pub(super) fn add(&mut self, highest: u16) {
        let index = usize::from(highest);
        if index >= self.0.len() {
            self.0.resize(index + 1, 0);
        }
        self.0[index] += 1;
    }

    /// Samples above the full scale of the model, or an accumulation of the highest ones below it.
    pub(super) fn finding(&self, model: &ChannelModel) -> Option<Finding> {
        let full_scale_dn = model.full_scale_dn;
        let beyond: u32 = self.0.iter().skip((full_scale_dn as usize).saturating_add(1)).sum();
        let top_dn = self.0.len().saturating_sub(1) as f64;
        let measured = match clipping_level_of_counts(&self.0) {
            Some(level_dn) => f64::from(level_dn),
            None if beyond >= MIN_BEYOND => top_dn,
            None => return None,
        };
        let finding = Finding {
            area: Area::FullScale,
            measured,
            expected: full_scale_dn,
            accepted: [full_scale_dn - 1.0, full_scale_dn],
            unit: "DN",
        };
        let is_known = beyond >= MIN_BEYOND || measured < full_scale_dn;
        if is_known { finding.unless_accepted() } else { None }
    }
}
