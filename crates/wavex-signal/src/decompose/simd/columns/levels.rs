//! Estimates the level of each waveform's own background before any pulse is known.

use wavex_simd::{LANES, Simd};

use super::{BEFORE, Columns};
use crate::decompose::simd::level::LEAST_FREE;
use crate::decompose::simd::level_tables::LevelTables;
use crate::decompose::simd::tables::Tables;

/// Newton steps of the robust mean.
///
/// The first leaves an error of some hundredths of the noise SD, the second a negligible one.
const STEPS: usize = 2;
/// Fraction of a level's variance in the variance of the statistic near the threshold.
///
/// Samples that noise raises this far have little weight in the level. The errors of the level and
/// of these samples are therefore nearly independent.
const KEPT_VARIANCE: f32 = 0.5;

impl Columns {
    /// Estimates the level of each block above the channel's background, DN.
    ///
    /// It is the biweight mean of the samples around the lowest mean of four, shrunk towards the
    /// prior. Pulses only raise samples, so the lowest samples belong to the background.
    #[inline(always)]
    pub(in crate::decompose::simd) fn estimate_levels<S: Simd>(
        &mut self,
        s: S,
        tables: &Tables,
        level: &LevelTables,
    ) {
        let (lengths, shortest) = self.ends(s);
        let (zero, one) = (s.splat(0.0), s.splat(1.0));
        let pairs = self.pairs.as_slice().as_chunks::<LANES>().0.get(BEFORE / 2..).unwrap_or_default();
        let mut lowest = s.splat(f32::MAX);
        for (group, pairs) in pairs.as_chunks::<2>().0.iter().enumerate().take(self.longest / 4) {
            let [a, b] = [s.load(&pairs[0]), s.load(&pairs[1])];
            let mut sum = s.add(s.add(s.first(a), s.second(a)), s.add(s.first(b), s.second(b)));
            if 4 * group + 4 > shortest {
                let inside = s.gt(lengths, s.splat((4 * group + 3) as f32));
                sum = s.select(inside, sum, s.splat(f32::MAX));
            }
            lowest = s.min(lowest, sum);
        }
        let above = level.above_lowest_dn - 0.25 * tables.background.iter().sum::<f32>();
        let mut centre = s.fma(lowest, s.splat(0.25), s.splat(above));
        let mut free = zero;
        let scale = s.splat(level.reach_dn.recip());
        for _ in 0..STEPS {
            let mut base = [centre; 4];
            for (base, &background) in base.iter_mut().zip(&tables.background) {
                *base = s.add(s.splat(background), centre);
            }
            let (mut sums, mut weights) = ([zero; 4], [zero; 4]);
            for (group, pairs) in pairs.as_chunks::<2>().0.iter().enumerate().take(self.longest.div_ceil(4)) {
                let [a, b] = [s.load(&pairs[0]), s.load(&pairs[1])];
                let samples = [s.first(a), s.second(a), s.first(b), s.second(b)];
                unrolled!(k in [0 1 2 3] if 4 => {
                    let distance = s.mul(s.sub(samples[k], base[k]), scale);
                    let root = s.max(s.fnma(distance, distance, one), zero);
                    let mut weight = s.mul(root, root);
                    if 4 * group + k >= shortest {
                        let inside = s.gt(lengths, s.splat((4 * group + k) as f32));
                        weight = s.select(inside, weight, zero);
                    }
                    sums[k] = s.fma(weight, distance, sums[k]);
                    weights[k] = s.add(weights[k], weight);
                });
            }
            let sum = s.add(s.add(sums[0], sums[1]), s.add(sums[2], sums[3]));
            let weight = s.add(s.add(weights[0], weights[1]), s.add(weights[2], weights[3]));
            // Free samples have this mean weight, samples on pulses almost none: this counts the free ones.
            free = s.mul(weight, s.splat(level.mean_weight.recip()));
            // Without samples in reach both sums are 0, and the level stays.
            let step = s.div(sum, s.max(weight, s.splat(1e-3)));
            centre = s.fma(step, s.splat(level.newton * level.reach_dn), centre);
        }
        let information = s.mul(free, s.splat(level.steady * level.steady));
        let variance = s.div(one, s.add(information, s.splat(level.precision)));
        let enough = s.ge(free, s.splat(LEAST_FREE));
        let drawn = s.mul(s.mul(centre, information), variance);
        s.store(s.select(enough, drawn, zero), &mut self.level_dn);
        s.store(s.select(enough, variance, zero), &mut self.level_variance);
    }

    /// Returns the level of a lane, DN, and its variance, DN².
    ///
    /// `None` if too few samples are free of pulses.
    #[inline(always)]
    pub(in crate::decompose::simd) fn level(&self, lane: usize) -> Option<[f32; 2]> {
        let [level_dn, variance] = [self.level_dn[lane], self.level_variance[lane]];
        (variance > 0.0).then_some([level_dn, variance])
    }

    /// Returns the change of the statistic due to the levels of the lanes.
    #[inline(always)]
    pub(super) fn statistic_change<'a, S: Simd>(
        &self,
        s: S,
        level: &'a LevelTables,
    ) -> StatisticChange<'a, S> {
        let levels = s.load(&self.level_dn);
        let half = s.mul(s.load(&self.level_variance), s.splat(-0.5 * KEPT_VARIANCE));
        let (lengths, shortest) = self.ends(s);
        let mut change = StatisticChange { s, level, levels, half, far: [levels; 2], lengths, shortest };
        change.far = change.of_response(s.splat(-level.response()));
        change
    }
}

/// Subtracts the levels from the statistic and rescales it.
///
/// After scaling, noise reaches thresholds as often as with a known level.
pub(super) struct StatisticChange<'a, S: Simd> {
    s: S,
    level: &'a LevelTables,
    levels: S::V,
    half: S::V,
    /// Offset and factor far from the ends of the blocks.
    far: [S::V; 2],
    lengths: S::V,
    shortest: usize,
}

impl<S: Simd> StatisticChange<'_, S> {
    /// Offset and factor at a position where a constant 1 has the statistic `response`.
    #[inline(always)]
    fn of_response(&self, response: S::V) -> [S::V; 2] {
        let s = self.s;
        [s.mul(self.levels, response), s.fma(s.mul(response, response), self.half, s.splat(1.0))]
    }

    /// Returns the changed statistic of a position.
    #[inline(always)]
    pub(super) fn of(&self, statistic: S::V, position: usize) -> S::V {
        let s = self.s;
        let mut change = self.far;
        if position < LANES || position + LANES > self.shortest {
            let filter = &self.level.filter;
            let [_, response] = filter.scales_and_levels(s, position, self.lengths, self.shortest);
            change = self.of_response(response);
        }
        s.mul(s.add(statistic, change[0]), change[1])
    }
}
