//! Single-pass statistics of a channel's samples: noise, saturation, peaks.
//!
//! The first blocks give the level and spread of the background. After that, the samples of a block
//! before the first rise above the noise, minus a margin, count as free of signal. Their statistics
//! are computed as in the calibration ([`NoiseStatistics`]); only the selection of free samples is
//! simpler: no pulses are fitted.

use super::histogram::GrowingHistogram;
use wavex_signal::calibrate::NoiseStatistics;

/// Number of blocks used to determine level and spread.
const LOOKED_AT: usize = 500;
/// Maximum number of samples in these blocks.
const SAMPLES_LOOKED_AT: usize = 1 << 20;
/// Number of samples at the start of a block initially taken as background.
const START_SAMPLES: usize = 8;
/// Signal threshold above the level, in standard deviations.
const SIGNAL_SD: f64 = 5.0;
/// Minimum signal threshold above the level, DN, because of rounding by the digitiser.
const LEAST_SIGNAL_DN: f64 = 1.5;
/// Maximum number of samples from the start of a pulse to the threshold.
const MARGIN: usize = 4;
/// Minimum run of free samples for their correlation.
const LEAST_STRETCH: usize = 4;

/// Running statistics of a channel's samples.
#[derive(Clone, Debug)]
pub struct SampleStatistics {
    /// The first blocks, until the level is known.
    ahead: Vec<Vec<u16>>,
    n_ahead: usize,
    signal_from_dn: Option<f64>,
    noise: NoiseStatistics,
    free_dn: GrowingHistogram,
    peaks_dn: GrowingHistogram,
    /// Numbers of samples and of blocks.
    added: [u64; 2],
    saturated_samples: u64,
    saturated_blocks: u64,
    full_scale_dn: Option<u16>,
}

/// Highest sample of a block, and its position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockPeak {
    /// Position in the block, refined by a parabola through the sample and its neighbours.
    pub position_samples: f64,
    /// Value of the sample, DN.
    pub dn: u16,
}

impl SampleStatistics {
    /// Creates statistics for a digitiser with an optional full scale.
    pub fn new(full_scale_dn: Option<u16>) -> SampleStatistics {
        SampleStatistics {
            ahead: Vec::new(),
            n_ahead: 0,
            signal_from_dn: None,
            noise: NoiseStatistics::default(),
            free_dn: GrowingHistogram::of_whole_numbers(512),
            peaks_dn: GrowingHistogram::of_whole_numbers(512),
            added: [0; 2],
            saturated_samples: 0,
            saturated_blocks: 0,
            full_scale_dn,
        }
    }

    /// Adds the samples of a block; returns its peak, or `None` for an empty block.
    pub fn add(&mut self, samples: &[u16]) -> Option<BlockPeak> {
        let peak = peak_of(samples)?;
        self.added = [self.added[0] + samples.len() as u64, self.added[1] + 1];
        self.peaks_dn.add(f64::from(peak.dn));
        if self.full_scale_dn.is_some_and(|full| peak.dn >= full) {
            let full = self.full_scale_dn.unwrap_or(u16::MAX);
            self.saturated_samples += samples.iter().filter(|&&sample| sample >= full).count() as u64;
            self.saturated_blocks += 1;
        }
        match self.signal_from_dn {
            Some(signal_from_dn) => self.add_free(samples, signal_from_dn),
            None => {
                self.ahead.push(samples.to_vec());
                self.n_ahead += samples.len();
                if self.ahead.len() == LOOKED_AT || self.n_ahead >= SAMPLES_LOOKED_AT {
                    self.settle();
                }
            }
        }
        Some(peak)
    }

    /// Ends the input.
    pub fn finish(&mut self) {
        if self.signal_from_dn.is_none() {
            self.settle();
        }
    }

    /// Determines the signal threshold from the first blocks, then counts their free samples.
    fn settle(&mut self) {
        let mut starts = GrowingHistogram::of_whole_numbers(1 << 16);
        for block in &self.ahead {
            block.iter().take(START_SAMPLES).for_each(|&sample| starts.add(f64::from(sample)));
        }
        let Some(level_dn) = quantile_of_rounded(&starts, 0.5) else { return };
        // Echoes only increase values, so the spread is taken below the level.
        let sd_dn = level_dn - quantile_of_rounded(&starts, 0.158_655).unwrap_or(level_dn);
        let signal_from_dn = level_dn + (SIGNAL_SD * sd_dn).max(LEAST_SIGNAL_DN);
        self.signal_from_dn = Some(signal_from_dn);
        for block in std::mem::take(&mut self.ahead) {
            self.add_free(&block, signal_from_dn);
        }
    }

    fn add_free(&mut self, samples: &[u16], signal_from_dn: f64) {
        let signal = samples.iter().position(|&sample| f64::from(sample) >= signal_from_dn);
        let until = signal.map_or(samples.len(), |first| first.saturating_sub(MARGIN));
        let free = &samples[..until];
        if free.len() >= LEAST_STRETCH {
            self.noise.add(free, 0);
            free.iter().for_each(|&sample| self.free_dn.add(f64::from(sample)));
        }
    }

    /// Number of samples free of signal.
    pub fn free(&self) -> u64 {
        self.noise.samples()
    }

    /// Mean level of the free samples by index modulo 4, DN; `None` without any.
    pub fn background_dn(&self) -> Option<[f64; 4]> {
        (self.free() > 0).then(|| self.noise.background_dn())
    }

    /// Mean of [`SampleStatistics::background_dn`].
    pub fn level_dn(&self) -> Option<f64> {
        self.background_dn().map(|phases| phases.iter().sum::<f64>() / 4.0)
    }

    /// Standard deviation of the free samples about the level of their phase, DN.
    pub fn noise_sd_dn(&self) -> Option<f64> {
        (self.free() > 0).then(|| self.noise.autocovariance().first().copied().unwrap_or(0.0).max(0.0).sqrt())
    }

    /// Autocorrelation of the free samples at lags 1 to 4, as far as available.
    pub fn noise_autocorrelation(&self) -> Vec<f64> {
        let covariance = self.noise.autocovariance();
        let Some((&variance, lags)) = covariance.split_first().filter(|(variance, _)| **variance > 0.0)
        else {
            return Vec::new();
        };
        lags.iter().take(4).map(|lag| lag / variance).collect()
    }

    /// Histogram of the free samples, DN.
    pub fn free_dn(&self) -> &GrowingHistogram {
        &self.free_dn
    }

    /// Histogram of the highest sample of each block, DN, including background.
    pub fn peaks_dn(&self) -> &GrowingHistogram {
        &self.peaks_dn
    }

    /// Number of samples, and of blocks with any.
    pub fn added(&self) -> [u64; 2] {
        self.added
    }

    /// Number of saturated samples, and of blocks with any; `None` without a known full scale.
    pub fn saturated(&self) -> Option<[u64; 2]> {
        self.full_scale_dn.map(|_| [self.saturated_samples, self.saturated_blocks])
    }
}

/// Peak at the first of a block's highest samples.
pub fn peak_of(samples: &[u16]) -> Option<BlockPeak> {
    let (at, &dn) = samples.iter().enumerate().rev().max_by_key(|(_, sample)| **sample)?;
    let beside = |at: Option<usize>| at.and_then(|at| samples.get(at)).map(|&sample| f64::from(sample));
    let off = match (beside(at.checked_sub(1)), beside(at.checked_add(1))) {
        (Some(before), Some(after)) => {
            let curvature = before - 2.0 * f64::from(dn) + after;
            if curvature < 0.0 { (0.5 * (before - after) / curvature).clamp(-0.5, 0.5) } else { 0.0 }
        }
        _ => 0.0,
    };
    Some(BlockPeak { position_samples: at as f64 + off, dn })
}

/// Quantile of values rounded to integers, each spread uniformly over its rounding interval.
fn quantile_of_rounded(rounded: &GrowingHistogram, part: f64) -> Option<f64> {
    let mut left = part * rounded.total() as f64;
    let width = rounded.width();
    for (centre, count) in rounded.bins() {
        let count = count as f64;
        if count > 0.0 && left <= count {
            return Some(centre + width * (left / count - 0.5));
        }
        left -= count;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_signal::noise::ArNoise;
    use wavex_signal::simulated::{Random, digitised, noise};

    #[test]
    fn the_peak_of_a_parabola_is_its_vertex() {
        // 100 - 4 (x - 2.25)² at integer x, rounded: exact at 2.25 with these three samples.
        let samples = [80, 94, 100, 98, 88];
        let peak = peak_of(&samples).unwrap();
        assert_eq!(peak, BlockPeak { position_samples: 2.25, dn: 100 });
        assert_eq!(
            peak_of(&[5, 1]),
            Some(BlockPeak { position_samples: 0.0, dn: 5 }),
            "at the edge, the sample itself"
        );
        assert_eq!(peak_of(&[1, 9, 9, 1]).unwrap().position_samples, 1.5, "two equal samples: their middle");
        assert_eq!(peak_of(&[]), None);
    }

    #[test]
    fn saturated_samples_are_counted_where_the_end_is_known() {
        let mut known = SampleStatistics::new(Some(255));
        known.add(&[1, 255, 255, 3]);
        known.add(&[1, 254, 3]);
        assert_eq!(known.saturated(), Some([2, 1]));
        assert_eq!(known.peaks_dn().range(), Some([254.0, 255.0]));
        assert_eq!(SampleStatistics::new(None).saturated(), None);
    }

    #[test]
    fn the_noise_is_that_before_the_echoes() {
        let process = ArNoise::new(&[0.6], 0.8).unwrap();
        let mut exact = [0.0; 5];
        process.autocovariance_into(&mut exact);
        exact[0] += 1.0 / 12.0;
        let (mut random, mut samples) = (Random::new(5), SampleStatistics::new(Some(255)));
        for _ in 0..5000 {
            let mut values = noise(&mut random, &process, 60);
            for (k, value) in values.iter_mut().enumerate() {
                let off = (k as f64 - 35.0) / 2.0;
                *value += 20.0 + 0.4 * (k % 2) as f64 + 120.0 * (-0.5 * off * off).exp();
            }
            samples.add(&digitised(&values, 255));
        }
        samples.finish();
        let background = samples.background_dn().unwrap();
        for (got, exact) in background.iter().zip([20.0, 20.4, 20.0, 20.4]) {
            assert!((got - exact).abs() < 0.03, "{background:?}");
        }
        let sd = samples.noise_sd_dn().unwrap();
        assert!((sd - exact[0].sqrt()).abs() < 0.01 * sd, "{sd}");
        let correlation = samples.noise_autocorrelation();
        for (lag, (got, exact)) in correlation.iter().zip(exact[1..].iter().map(|r| r / exact[0])).enumerate()
        {
            assert!((got - exact).abs() < 0.01, "lag {}: {got} {exact}", lag + 1);
        }
        assert!((120_000..140_000).contains(&samples.free()), "{}", samples.free());
    }

    #[test]
    fn short_runs_of_samples_give_no_noise() {
        let mut samples = SampleStatistics::new(None);
        samples.add(&[200, 210, 220]);
        samples.finish();
        assert_eq!((samples.noise_sd_dn(), samples.background_dn()), (None, None));
        assert_eq!(samples.noise_autocorrelation(), Vec::<f64>::new());
    }
}
