//! Layout of the tables and rows, shared by all kernels.

use wavex_simd::{LANES, Sixteen};

/// Samples of a template row.
///
/// From 11 before the peak to 20 after it, past the after-pulse.
pub(super) const ROW: usize = 32;
/// Samples of a row before that of the peak.
pub(super) const BEFORE_PEAK: i32 = 11;
/// Table positions per sample.
pub(super) const PHASES: usize = 16;
/// Number of tabulated widths.
pub(super) const KNOTS: usize = 52;
/// `ln` of the smallest width ratio, 0.6.
pub(super) const U_MIN: f64 = -0.510_825_623_765_990_7;
/// Spacing of the knots, `ln` width.
pub(super) const U_STEP: f64 = 0.026_4;
/// `ln` of the largest width ratio, 2.3.
pub(super) const U_MAX: f64 = U_MIN + (KNOTS - 1) as f64 * U_STEP;
/// Templates per entry: `s, s_t, s_tt, s_u, s_uu, s_tu`.
pub(super) const TEMPLATES: usize = 6;
/// A row and the zeros after it; the entry starts with the zeros before the first row.
pub(super) const ROW_STRIDE: usize = ROW + LANES;
/// Values of one entry.
pub(super) const ENTRY: usize = LANES + TEMPLATES * ROW_STRIDE;
/// Highest supported order of the noise.
pub(super) const MAX_ORDER: usize = 4;
/// Lags of the matched filter after whitening, from 6 before the peak.
pub(super) const FILTER_LAGS: usize = 14;
pub(super) const FILTER_BEFORE: i32 = 6;
/// Taps of whitening and matched filter combined.
pub(super) const TAPS: usize = FILTER_LAGS + MAX_ORDER;
/// Samples from the first tap's sample to the position.
pub(super) const TAPS_BEFORE: usize = FILTER_BEFORE as usize + MAX_ORDER;

/// Height (DN), position (samples from the block's first), `ln` of the width ratio.
pub(super) type Values = [f32; 3];

/// Returns the sixteen values from `at` on; zeros if the row is too short.
#[inline(always)]
pub(super) fn sixteen(row: &[f32], at: usize) -> &Sixteen {
    match row.get(at..) {
        Some(from) => from.first_chunk().unwrap_or(&[0.0; LANES]),
        None => &[0.0; LANES],
    }
}
