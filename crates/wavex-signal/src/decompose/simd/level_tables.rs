//! Tables of a channel for levels of waveforms.

use wavex_simd::{LANES, Simd, Sixteen};

use super::filter::Filter;
use super::layout::MAX_ORDER;
use crate::noise::ArNoise;
use crate::whitening::Whitener;

/// Half width of the robust mean's window, standard deviations of the noise.
///
/// Samples within it are weighted by Tukey's biweight (Beaton and Tukey 1974), others by 0.
const REACH_SD: f64 = 4.0;
/// Average depth of the lowest mean of four samples below the level, in its own SDs.
const LOWEST_OF_MEANS_SD: f64 = 1.4;
/// Largest deviation of a level from the prior, standard deviations.
///
/// Waveforms beyond it go to the scalar kernels.
const LIKELY_SD: f32 = 5.0;
/// Minimum fraction of the information on a level that pulses must leave.
const LEAST_INFORMATION: f32 = 0.05;

/// Tables that depend on the channel.
pub(super) struct LevelTables {
    /// Precision of the prior on a level, 1/DN².
    pub(super) precision: f32,
    /// The whitened constant 1 at the first samples, as many as the noise's order.
    ///
    /// `steady` is its value at all others.
    begin: [f32; MAX_ORDER],
    pub(super) steady: f32,
    /// The same at the first sixteen samples minus `steady`; 0 from the order on.
    pub(super) begin_excess: Sixteen,
    /// Response of the matched filter to a constant 1, as its background.
    pub(super) filter: Filter,
    /// Half width of the window of the robust mean, DN.
    pub(super) reach_dn: f32,
    /// Average level above the lowest mean of four samples, DN.
    pub(super) above_lowest_dn: f32,
    /// Mean weight of free samples.
    pub(super) mean_weight: f32,
    /// Ratio of the Newton step to that of the weighted mean.
    pub(super) newton: f32,
    /// Effect of a level of 1 DN on a whole pulse of height 1, by entry.
    ///
    /// Three changes of its values, and the information on the level that the pulse absorbs.
    whole: Vec<[f32; 4]>,
}

impl LevelTables {
    /// Creates the tables, without those of pulses.
    pub(super) fn new(noise: &ArNoise, precision: f64) -> LevelTables {
        // Long enough for the whitened constant to be steady at the end.
        let mut ones = [1.0; 2 * MAX_ORDER];
        let mut whitener = Whitener::new(noise.clone(), ones.len());
        whitener.set_used(&[true; 2 * MAX_ORDER]);
        whitener.whiten(&mut ones);
        let mut lags = [0.0; 4];
        noise.autocovariance_into(&mut lags);
        // Mean of four consecutive samples, with their correlation.
        let variance_of_mean = (4.0 * lags[0] + 6.0 * lags[1] + 4.0 * lags[2] + 2.0 * lags[3]) / 16.0;
        // Moments of the weights over normal noise: `E w`, and `E ψ'` with `ψ = x w`.
        let [m2, m4] = [REACH_SD.powi(-2), 3.0 * REACH_SD.powi(-4)];
        let (weight, slope) = (1.0 - 2.0 * m2 + m4, 1.0 - 6.0 * m2 + 5.0 * m4);
        LevelTables {
            precision: precision as f32,
            begin: std::array::from_fn(|k| ones[k] as f32),
            begin_excess: std::array::from_fn(|k| {
                let is_begin = k < noise.order();
                if is_begin { (ones[k] - ones[2 * MAX_ORDER - 1]) as f32 } else { 0.0 }
            }),
            steady: ones[2 * MAX_ORDER - 1] as f32,
            filter: Filter::NONE,
            reach_dn: (REACH_SD * noise.sd()) as f32,
            above_lowest_dn: (LOWEST_OF_MEANS_SD * variance_of_mean.sqrt()) as f32,
            mean_weight: weight as f32,
            newton: (weight / slope) as f32,
            whole: Vec::new(),
        }
    }

    /// Adds an entry.
    ///
    /// `sums` are those of its whitened pulse and of the derivatives by position and width.
    pub(super) fn push(&mut self, inverse_fisher: &[f32; 8], sums: [f32; 3]) {
        let [aa, at, tt, au, tu, uu, ..] = *inverse_fisher;
        let [a, t, u] = sums.map(|sum| self.steady * sum);
        let values = [aa * a + at * t + au * u, at * a + tt * t + tu * u, au * a + tu * t + uu * u];
        let explained = values[0] * a + values[1] * t + values[2] * u;
        self.whole.push([values[0], values[1], values[2], explained]);
    }

    /// The same for a pulse of height 1, by its table entry.
    #[inline(always)]
    pub(super) fn of_entry(&self, entry: usize) -> [f32; 4] {
        self.whole.get(entry).copied().unwrap_or([0.0; 4])
    }

    /// Statistic of a constant 1 far from the ends of a block.
    pub(super) fn response(&self) -> f32 {
        -self.filter.scale_and_level(LANES, LANES - 1)[1]
    }

    /// Whether a level is within the limit of the prior.
    ///
    /// `variance` is that of its estimate, DN².
    pub(super) fn is_likely(&self, level_dn: f32, variance: f32) -> bool {
        self.precision == 0.0
            || level_dn * level_dn <= LIKELY_SD * LIKELY_SD * (self.precision.recip() + variance)
    }

    /// `wᵀ w` of a whole block of each length.
    #[inline(always)]
    pub(super) fn information<S: Simd>(&self, s: S, lengths: S::V, order: usize) -> S::V {
        let squares: f32 = self.begin[..order].iter().map(|one| one * one).sum();
        let steady = self.steady * self.steady;
        s.fma(lengths, s.splat(steady), s.splat(squares - steady * order as f32))
    }

    /// Computes the joint step in sixteen lanes.
    ///
    /// `product` is that of the residuals with the whitened constant, `information` that of the
    /// constant, `explained` the part of it that the pulses absorb.
    #[inline(always)]
    pub(super) fn step<S: Simd>(
        &self,
        s: S,
        level_dn: S::V,
        product: S::V,
        information: S::V,
        explained: S::V,
    ) -> LevelStep<S::V> {
        let zero = s.splat(0.0);
        let precision = s.splat(self.precision);
        let left = s.sub(information, explained);
        let all = s.add(left, precision);
        let variance = s.div(s.splat(1.0), all);
        let step = s.mul(s.fnma(precision, level_dn, product), variance);
        let after = s.add(level_dn, step);
        // NaN fails this comparison.
        let mut made = s.gt(left, s.mul(s.splat(LEAST_INFORMATION), information));
        if self.precision > 0.0 {
            let likely = s.add(s.splat(self.precision.recip()), variance);
            made &= s.ge(s.mul(s.splat(LIKELY_SD * LIKELY_SD), likely), s.mul(after, after));
        } else {
            // Without a prior, every finite level is likely.
            made &= s.gt(s.splat(f32::INFINITY), s.max(after, s.sub(zero, after)));
        }
        let prior = s.mul(precision, s.sub(s.mul(level_dn, level_dn), s.mul(after, after)));
        let gain = s.mul(s.mul(step, step), all);
        LevelStep {
            made,
            by_dn: step,
            level_dn: after,
            variance,
            gain,
            chi_square_change: s.sub(prior, gain),
        }
    }

    /// The whitened constant at the first samples.
    pub(super) fn begin(&self) -> &[f32; MAX_ORDER] {
        &self.begin
    }
}

pub(super) struct LevelStep<V> {
    /// Lanes with enough remaining information and a level within the limit of the prior.
    pub(super) made: u16,
    /// The step, and the level and its variance after the step.
    pub(super) by_dn: V,
    pub(super) level_dn: V,
    pub(super) variance: V,
    /// Decrease of chi-square with the prior term, and change of chi-square alone.
    pub(super) gain: V,
    pub(super) chi_square_change: V,
}
