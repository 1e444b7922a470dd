//! Whitening and matched filter in one, on samples as they come: in whole numbers.
//!
//! Two products of 16 bits and their sum are one instruction: half as many as in `f32`, and the sum is exact in any order.
//! Scaled to the full range, the taps are rounded by 1e-4 of the largest at most.

use std::ops::Range;

use super::tables::{TAPS, TAPS_BEFORE};
use super::vector::{LANES, Simd, Sixteen};

/// Samples from here on are filtered as this one: the largest that 16 bits hold with a sign.
pub(super) const HIGHEST: u16 = i16::MAX.cast_unsigned();
/// The magnitudes of the taps add up to less than this: no sum of products with samples leaves 32 bits.
const TAPS_SUM: f64 = 65_000.0;
/// Positions that are filtered at a time: their sums and the taps are what registers hold.
pub(super) const POSITIONS: usize = 8;
/// Pairs of samples that these positions' windows reach over.
pub(super) const WINDOW: usize = (TAPS + POSITIONS) / 2;

/// The filter of unit output variance, and what stands for the background and for the samples that a block's edges leave out.
pub(super) struct Filter {
    /// By tap, in units of `scale`.
    taps: [i16; TAPS],
    /// The statistic of a sum of 1.
    scale: f32,
    /// What the statistic is multiplied with at the first positions of a block, and at the last.
    pub(super) leading: Sixteen,
    pub(super) trailing: Sixteen,
    /// By the number modulo 4 of the sample that the first tap meets: the background's part in the sum of as many taps.
    background: [[f32; TAPS + 1]; 4],
}

impl Filter {
    /// Without taps.
    pub(super) const NONE: Filter = Filter {
        taps: [0; TAPS],
        scale: 0.0,
        leading: [0.0; LANES],
        trailing: [0.0; LANES],
        background: [[0.0; TAPS + 1]; 4],
    };

    /// `gain` tells what the statistic of some of the taps is to be multiplied with: the inverse standard deviation, or 0 where
    /// too little of a pulse is left.
    pub(super) fn new(
        taps: &[f64; TAPS],
        background_dn: &[f64; 4],
        gain: impl Fn(Range<usize>) -> f32,
    ) -> Filter {
        let sum: f64 = taps.iter().map(|tap| tap.abs()).sum();
        let largest = taps.iter().fold(0.0, |a: f64, tap| a.max(tap.abs()));
        let per_unit = (TAPS_SUM / sum).min(f64::from(i16::MAX) / largest);
        let taps = taps.map(|tap| (tap * per_unit).round() as i16);
        let behind = TAPS - TAPS_BEFORE;
        let mut background = [[0.0; TAPS + 1]; 4];
        for (first, sums) in background.iter_mut().enumerate() {
            let mut sum = 0.0;
            for (i, &tap) in taps.iter().enumerate() {
                sum += f64::from(tap) * background_dn[(first + i) % 4];
                sums[i + 1] = sum as f32;
            }
        }
        Filter {
            taps,
            scale: per_unit.recip() as f32,
            leading: std::array::from_fn(|k| match TAPS_BEFORE.saturating_sub(k) {
                0 => 1.0,
                missing => gain(missing..TAPS),
            }),
            trailing: std::array::from_fn(|k| match behind.saturating_sub(LANES - k) {
                0 => 1.0,
                missing => gain(0..TAPS - missing),
            }),
            background,
        }
    }

    /// What the sum at a position of a block is multiplied with, and what is added then.
    pub(super) fn scale_and_level(&self, position: usize, length: usize) -> [f32; 2] {
        let behind = length - position;
        let mut scale = self.scale;
        scale *= self.leading.get(position).copied().unwrap_or(1.0);
        scale *= self.trailing.get(LANES.wrapping_sub(behind)).copied().unwrap_or(1.0);
        // The taps that meet samples of the block.
        let met = TAPS_BEFORE.saturating_sub(position)..TAPS.min(TAPS_BEFORE + behind);
        let sums = &self.background[(position + 4 * TAPS - TAPS_BEFORE) % 4];
        [scale, -scale * (sums[met.end] - sums[met.start])]
    }

    /// The statistic per unit of the sums.
    pub(super) fn scale(&self) -> f32 {
        self.scale
    }

    /// The last `N` taps in registers: for positions whose window begins with a pair, and for those between.
    #[inline(always)]
    pub(super) fn taps<S: Simd, const N: usize>(&self, s: S) -> Taps<S::V> {
        let tap = |i: usize| if i < N { self.taps[TAPS - N + i].cast_unsigned() } else { 0 };
        let mut taps = Taps { even: [s.splat(0.0); WINDOW], odd: [s.splat(0.0); WINDOW] };
        for (j, even) in taps.even.iter_mut().enumerate() {
            *even = s.splat_pair([tap(2 * j), tap(2 * j + 1)]);
        }
        for (j, odd) in taps.odd.iter_mut().enumerate() {
            *odd = s.splat_pair([if j == 0 { 0 } else { tap(2 * j - 1) }, tap(2 * j)]);
        }
        taps
    }
}

/// Pairs of taps in registers, and zeros behind.
pub(super) struct Taps<V> {
    even: [V; WINDOW],
    odd: [V; WINDOW],
}

/// Sums of `N` taps over eight windows, each a sample later, as bits. Every pair of samples is read once.
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
