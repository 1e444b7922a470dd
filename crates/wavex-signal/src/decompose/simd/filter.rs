//! Whitening and matched filter in one, on raw samples in integers.
//!
//! Two products of 16 bits and their sum take one instruction: half as many as in `f32`, and the
//! sum is exact in any order. The taps are scaled to the full range and rounded by less than 2e-4
//! of the largest.

use std::ops::Range;

use wavex_simd::{LANES, Simd, Sixteen};

use super::layout::{TAPS, TAPS_BEFORE};

/// Larger samples are filtered as this value: the largest signed number of 16 bits.
pub(super) const HIGHEST: u16 = i16::MAX.cast_unsigned();
/// Upper limit of the sum of the taps' magnitudes.
///
/// It keeps all sums of products with samples within 32 bits.
const TAPS_SUM: f64 = 65_000.0;
/// Positions filtered at a time: their sums and the taps fit into the registers.
pub(super) const POSITIONS: usize = 8;
/// Pairs of samples in the windows of these positions.
pub(super) const WINDOW: usize = (TAPS + POSITIONS) / 2;

/// Filter of unit output variance, with corrections for background and block edges.
pub(super) struct Filter {
    /// Taps in units of `scale`, for even and for odd positions.
    taps: [[i16; TAPS]; 2],
    /// Statistic of a sum of 1.
    scale: f32,
    /// Factors on the statistic for missing samples at the edges of the block.
    ///
    /// `leading` is by position, `trailing` by position modulo 2 and by number of samples from the
    /// position to the end of the block.
    leading: Sixteen,
    trailing: [Sixteen; 2],
    /// Contribution of the background to the sum of the first taps.
    ///
    /// By position modulo 4 and by number of taps.
    background: [[f32; TAPS + 1]; 4],
    /// The same for the taps on samples before the end of the block.
    ///
    /// By position modulo 4 and by number of samples from the position to the end.
    background_met: [Sixteen; 4],
    /// Factor and offset of the sums far from the end of a block.
    ///
    /// The offset is added after the multiplication. By position; the last entries by position
    /// modulo 8.
    far: [[f32; 2]; LANES + POSITIONS],
}

impl Filter {
    /// A filter without taps.
    pub(super) const NONE: Filter = Filter {
        taps: [[0; TAPS]; 2],
        scale: 0.0,
        leading: [0.0; LANES],
        trailing: [[0.0; LANES]; 2],
        background: [[0.0; TAPS + 1]; 4],
        background_met: [[0.0; LANES]; 4],
        far: [[0.0; 2]; LANES + POSITIONS],
    };

    /// Creates a filter.
    ///
    /// `taps` are for even and for odd positions. `gain` returns the factor on the statistic of a
    /// part of them: the inverse standard deviation, or 0 if too little of a pulse is left.
    pub(super) fn new(
        taps: &[[f64; TAPS]; 2],
        background_dn: &[f64; 4],
        gain: impl Fn(usize, Range<usize>) -> f32,
    ) -> Filter {
        // One unit for both parities, so that their sums have the same scale.
        let per_unit = taps.iter().fold(f64::INFINITY, |least, taps| {
            let sum: f64 = taps.iter().map(|tap| tap.abs()).sum();
            let largest = taps.iter().fold(0.0, |a: f64, tap| a.max(tap.abs()));
            least.min(TAPS_SUM / sum).min(f64::from(i16::MAX) / largest)
        });
        let taps = taps.map(|taps| taps.map(|tap| (tap * per_unit).round() as i16));
        let mut filter = Filter { taps, scale: per_unit.recip() as f32, ..Filter::NONE };
        for (position, sums) in filter.background.iter_mut().enumerate() {
            let mut sum = 0.0;
            for (i, &tap) in taps[position % 2].iter().enumerate() {
                sum += f64::from(tap) * background_dn[(position + i + 4 * TAPS - TAPS_BEFORE) % 4];
                sums[i + 1] = sum as f32;
            }
        }
        filter.leading = std::array::from_fn(|k| match TAPS_BEFORE.saturating_sub(k) {
            0 => 1.0,
            missing => gain(k % 2, missing..TAPS),
        });
        filter.trailing = [0, 1].map(|parity| {
            std::array::from_fn(|behind| match TAPS.saturating_sub(TAPS_BEFORE + behind) {
                _ if behind == 0 => 0.0,
                0 => 1.0,
                missing => gain(parity, 0..TAPS - missing),
            })
        });
        for (met, sums) in filter.background_met.iter_mut().zip(&filter.background) {
            *met = std::array::from_fn(|behind| sums[TAPS.min(TAPS_BEFORE + behind)]);
        }
        for position in 0..LANES + POSITIONS {
            filter.far[position] = filter.scale_and_level(position, LANES - 1);
        }
        filter
    }

    /// Returns factor and offset of the sum at a position.
    ///
    /// The offset subtracts the background. `behind` is the number of samples from the position to
    /// the end of the block, at most 15.
    pub(super) fn scale_and_level(&self, position: usize, behind: usize) -> [f32; 2] {
        let leading = self.leading.get(position).copied().unwrap_or(1.0);
        let scale = self.scale * leading * self.trailing[position % 2][behind];
        [scale, -scale * (self.background_met[position % 4][behind] - self.background_missed(position))]
    }

    /// Contribution of the background to the taps before the start of the block.
    #[inline(always)]
    fn background_missed(&self, position: usize) -> f32 {
        self.background[position % 4][TAPS_BEFORE.saturating_sub(position)]
    }

    /// Factors and offsets for sixteen blocks of any lengths; `shortest` is the least length.
    #[inline(always)]
    pub(super) fn scales_and_levels<S: Simd>(
        &self,
        s: S,
        position: usize,
        lengths: S::V,
        shortest: usize,
    ) -> [S::V; 2] {
        if position + LANES <= shortest {
            let at = if position < LANES { position } else { LANES + position % POSITIONS };
            return self.far[at].map(|value| s.splat(value));
        }
        let behind = s.sub(lengths, s.splat(position as f32));
        let behind = s.min(s.max(behind, s.splat(0.0)), s.splat((LANES - 1) as f32));
        let leading = self.leading.get(position).copied().unwrap_or(1.0);
        let scale = s.mul(s.splat(self.scale * leading), s.look_up(&self.trailing[position % 2], behind));
        let met = s.look_up(&self.background_met[position % 4], behind);
        [scale, s.mul(scale, s.sub(s.splat(self.background_missed(position)), met))]
    }

    /// Returns the statistic per unit of the sums.
    pub(super) fn scale(&self) -> f32 {
        self.scale
    }

    /// Loads the last `N` taps into registers.
    ///
    /// `even` is for positions whose window starts at a pair, `odd` for those in between.
    #[inline(always)]
    pub(super) fn taps<S: Simd, const N: usize>(&self, s: S) -> Taps<S::V> {
        let [of_even, of_odd] = &self.taps;
        let tap = |of: &[i16; TAPS], i: usize| if i < N { of[TAPS - N + i].cast_unsigned() } else { 0 };
        let mut taps = Taps { even: [s.splat(0.0); WINDOW], odd: [s.splat(0.0); WINDOW] };
        for (j, even) in taps.even.iter_mut().enumerate() {
            *even = s.splat_pair([tap(of_even, 2 * j), tap(of_even, 2 * j + 1)]);
        }
        for (j, odd) in taps.odd.iter_mut().enumerate() {
            let first = if j == 0 { 0 } else { tap(of_odd, 2 * j - 1) };
            *odd = s.splat_pair([first, tap(of_odd, 2 * j)]);
        }
        taps
    }
}

/// Pairs of taps in registers, followed by zeros.
pub(super) struct Taps<V> {
    even: [V; WINDOW],
    odd: [V; WINDOW],
}

/// Sums of `N` taps over eight windows, each one sample later, as bits.
///
/// Every pair of samples is read once.
#[inline(always)]
pub(super) fn sums<S: Simd, const N: usize>(
    s: S,
    taps: &Taps<S::V>,
    window: &[Sixteen; WINDOW],
) -> [S::V; POSITIONS] {
    const { assert!(N.is_multiple_of(2) && N <= TAPS) };
    let mut sums = [s.splat(0.0); POSITIONS];
    unrolled!(m in [0 1 2 3 4 5 6 7 8 9 10 11 12] if (N + POSITIONS) / 2 => {
        let pair = s.load(&window[m]);
        unrolled!(i in [0 1 2 3] if POSITIONS / 2 => {
            if m >= i && m - i < N / 2 {
                sums[2 * i] = s.dot(pair, taps.even[m - i], sums[2 * i]);
            }
            if m >= i && m - i <= N / 2 {
                sums[2 * i + 1] = s.dot(pair, taps.odd[m - i], sums[2 * i + 1]);
            }
        });
    });
    sums
}

#[cfg(test)]
mod tests {
    use super::super::layout::{TAPS, TAPS_BEFORE};
    use super::*;

    /// A filter with one tap, which is represented exactly.
    fn one_tap(at: usize) -> Filter {
        let mut taps = [[0.0; TAPS]; 2];
        taps.iter_mut().for_each(|taps| taps[at] = 0.25);
        Filter::new(&taps, &[2.0, 2.5, 3.0, 2.25], |_, _| 0.5)
    }

    /// `value × tap`; the background is subtracted only if the tap meets a sample of the block.
    #[test]
    fn the_background_counts_as_far_as_the_block_goes() {
        let (length, filter) = (40_usize, one_tap(3));
        let sum_of_one = f32::from(filter.taps[0][3]);
        for position in 0..length {
            let sample = (position + 3).checked_sub(TAPS_BEFORE);
            let [scale, level] = filter.scale_and_level(position, (length - position).min(LANES - 1));
            let edges = [position < TAPS_BEFORE, length - position < TAPS - TAPS_BEFORE];
            let gain = edges.into_iter().filter(|missing| *missing).fold(1.0, |gain, _| gain * 0.5);
            for value in [0.0, 5.0, 4000.0] {
                let (sum, expected) = match sample {
                    Some(i) => (value * sum_of_one, 0.25 * gain * (value - [2.0, 2.5, 3.0, 2.25][i % 4])),
                    None => (0.0, 0.0),
                };
                let found = scale * sum + level;
                assert!((found - expected).abs() < 1e-5 * value.max(1.0), "{position}: {found} {expected}");
            }
        }
        assert_eq!(filter.scale_and_level(50, 0), [0.0, 0.0]);
    }

    /// No sum of taps and samples exceeds 32 bits, and no tap 16.
    #[test]
    fn sums_stay_within_32_bits() {
        let alternating: [f64; TAPS] = std::array::from_fn(|i| if i % 2 == 0 { 0.3 } else { -0.2 });
        let mut lone = [1e-9; TAPS];
        lone[5] = -7.0;
        for taps in [[alternating, alternating], [lone, lone], [lone, alternating]] {
            let filter = Filter::new(&taps, &[0.0; 4], |_, _| 1.0);
            let sums =
                filter.taps.map(|taps| taps.iter().map(|tap| i64::from(tap.unsigned_abs())).sum::<i64>());
            let most = sums[0].max(sums[1]);
            assert!(most * i64::from(HIGHEST) <= i64::from(i32::MAX), "{sums:?}");
            assert!(most > 32_000, "the taps use the range: {sums:?}");
        }
    }
}
