//! Energy along the signal, and heights of its percentiles.

use wavex_simd::statistics::WithSd;

use super::measured::HEIGHTS;

/// Energy of a smoothed waveform along its signal.
pub(super) struct Profile<'a> {
    /// Smoothed samples of the signal, DN.
    values_dn: &'a [f32],
    /// Sample with which the signal begins.
    first: usize,
    /// Energy up to the end of each sample, DN.
    cumulative_dn: &'a [f64],
    noise: SumNoise,
    /// Samples over which the density of the energy is averaged, to each side.
    around: usize,
}

/// Noise of sums over many samples.
pub(super) struct SumNoise {
    /// Variance of a sum per sample, DN².
    pub(super) variance: f64,
    /// Number of samples from which the background was estimated.
    pub(super) free: usize,
}

impl<'a> Profile<'a> {
    /// Of the signal's samples `values_dn`; overwrites `cumulative_dn`.
    pub(super) fn new(
        values_dn: &'a [f32],
        first: usize,
        fwhm_samples: f64,
        noise: SumNoise,
        cumulative_dn: &'a mut Vec<f64>,
    ) -> Profile<'a> {
        let mut sum_dn = 0.0;
        cumulative_dn.clear();
        cumulative_dn.extend(values_dn.iter().map(|dn| {
            sum_dn += f64::from(*dn);
            sum_dn
        }));
        Profile { values_dn, first, cumulative_dn, noise, around: (0.5 * fwhm_samples).ceil() as usize }
    }

    /// Energy of the signal, DN.
    pub(super) fn energy_dn(&self) -> WithSd {
        let length = self.values_dn.len() as f64;
        WithSd { value: self.up_to(self.values_dn.len()), sd: self.noise.sd_of_weights(length, length) }
    }

    /// Energy of the first samples, DN.
    fn up_to(&self, samples: usize) -> f64 {
        let last = samples.checked_sub(1).and_then(|last| self.cumulative_dn.get(last));
        last.copied().unwrap_or(0.0)
    }

    /// Energy behind a position, DN.
    pub(super) fn energy_behind_dn(&self, position: f64) -> WithSd {
        let behind = |(k, dn): (usize, &f32)| (1.0 - share_before(k, position)) * f64::from(*dn);
        let length = (self.first + self.values_dn.len()) as f64 - 0.5 - position;
        WithSd {
            value: (self.first..).zip(self.values_dn).map(behind).sum(),
            sd: self.noise.sd_of_weights(length.max(0.0), 0.0),
        }
    }

    /// Fills the heights of the percentiles of the energy above the ground; the last one is that of the top.
    pub(super) fn heights(&self, ground: WithSd, top: WithSd, heights: &mut [WithSd; HEIGHTS]) {
        let above_ground =
            |position: f64, sd: f64| WithSd { value: ground.value - position, sd: sd.hypot(ground.sd) };
        let energy_dn = self.up_to(self.values_dn.len());
        let mut k = 0;
        // From the top downwards: the energy above a position is that of the samples before it.
        for (percent, height) in heights.iter_mut().enumerate().rev() {
            let part = percent as f64 / (HEIGHTS - 1) as f64;
            let wanted_dn = (1.0 - part) * energy_dn;
            while k + 1 < self.values_dn.len() && self.up_to(k + 1) < wanted_dn {
                k += 1;
            }
            let (from_dn, until_dn) = (self.up_to(k), self.up_to(k + 1));
            let inside =
                ((until_dn - wanted_dn) / (until_dn - from_dn).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
            let above = k as f64 + 1.0 - inside;
            let below = self.values_dn.len() as f64 - above;
            // The percentile moves by the noise of the energies above and below it, over their density.
            let squares = above * part.powi(2) + below * (1.0 - part).powi(2);
            let sum = above * part - below * (1.0 - part);
            let sd = self.noise.sd_of_weights(squares, sum) / self.mean_density_dn(k);
            *height = above_ground(self.first as f64 - 0.5 + above, sd);
        }
        if let Some(highest) = heights.last_mut() {
            *highest = above_ground(top.value, top.sd);
        }
    }

    /// Mean energy per sample around a sample, DN.
    fn mean_density_dn(&self, k: usize) -> f64 {
        let (from, until) = (k.saturating_sub(self.around), (k + self.around + 1).min(self.values_dn.len()));
        let mean = (self.up_to(until) - self.up_to(from)) / (until - from).max(1) as f64;
        mean.max(f64::MIN_POSITIVE)
    }
}

impl SumNoise {
    /// SD of a weighted sum: of its squared weights, and of their sum, which the background's error multiplies.
    fn sd_of_weights(&self, squares: f64, sum: f64) -> f64 {
        (self.variance * (squares + sum * sum / self.free as f64)).sqrt()
    }
}

/// Part of sample `k` that lies before a position.
pub(super) fn share_before(k: usize, position: f64) -> f64 {
    (position - k as f64 + 0.5).clamp(0.0, 1.0)
}
