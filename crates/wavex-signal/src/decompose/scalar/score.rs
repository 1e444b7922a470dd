//! Rao's score test of two pulses against a widened one.
//!
//! The test runs before the pair is fitted. A pair leaves a residual outside the plane spanned by
//! the derivatives in height, position and width. Its leading directions are the third and fourth
//! derivative in time. By the heat equation the derivative in ln width is the second derivative in
//! time plus a multiple of the shape. The mixed derivative in time and width and the second
//! derivative in width therefore replace them (docs/explanation/method.md, Split test).
//!
//! Let `q = |P r|²` be the part of the whitened residual in these directions after projection on
//! the complement of all fitted parameters. For one pulse `q` is chi-square with two degrees of
//! freedom (Rao 1948). Two equal, well-separated pulses leave more than these two directions
//! contain. Their expected residual is a third direction of known sign; the larger of the two
//! statistics counts.

use wavex_simd::dot::dot;

use crate::shape::Pulse;
use crate::shape::SD_OF_FWHM;
use crate::shape::Shape;
use crate::whitening::Whitener;

/// Step of differences in ln width, and in position in widths.
const LN_WIDTH_STEP: f64 = 0.05;
/// Minimum relative square of a direction after projection.
const LEAST_PART: f64 = 1e-9;

/// Second difference that replaces the third derivative in time.
///
/// Factor, step in width, step in position.
const MIXED: [[f64; 3]; 4] = [[1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0], [1.0, -1.0, -1.0]];
/// Second difference that replaces the fourth derivative in time.
const SECOND: [[f64; 3]; 3] = [[1.0, 1.0, 0.0], [-2.0, 0.0, 0.0], [1.0, -1.0, 0.0]];

/// Workspace of the score test.
#[derive(Debug, Clone)]
pub(super) struct TestScore {
    /// Whitened directions, orthonormalised, stored column by column.
    columns: Vec<f64>,
    shape: Shape,
    offset_is_free: bool,
}

impl TestScore {
    /// Creates a workspace for blocks of up to `max_samples` and clusters of up to `max_pulses`.
    pub(super) fn new(
        shape: Shape,
        offset_is_free: bool,
        max_samples: usize,
        max_pulses: usize,
    ) -> TestScore {
        TestScore { columns: Vec::with_capacity((3 * max_pulses + 4) * max_samples), shape, offset_is_free }
    }

    /// Returns `q` of pulse `index` of a cluster.
    ///
    /// `residual` is the whitened residual of all pulses.
    pub(super) fn statistic(
        &mut self,
        whitener: &Whitener,
        cluster: impl ExactSizeIterator<Item = Pulse>,
        pulse: Pulse,
        residual: &[f64],
    ) -> f64 {
        let samples = residual.len().max(1);
        let shape = &self.shape;
        let fitted = 3 * cluster.len() + usize::from(self.offset_is_free);
        self.columns.clear();
        self.columns.resize((fitted + 3) * samples, 0.0);
        let mut columns = self.columns.chunks_exact_mut(samples);
        for p in cluster {
            let parts = [columns.next(), columns.next(), columns.next()];
            let [Some(by_height), Some(by_place), Some(by_width)] = parts else { return 0.0 };
            shape.add_derivatives(&p, [by_height, by_place, by_width]);
        }
        if self.offset_is_free
            && let Some(column) = columns.next()
        {
            column.fill(1.0);
        }
        for (terms, column) in [&MIXED[..], &SECOND[..]].into_iter().zip(&mut columns) {
            for [factor, widths, places] in terms {
                let mut moved = pulse;
                moved.ln_width_ratio += LN_WIDTH_STEP * widths;
                moved.position_samples += LN_WIDTH_STEP * shape.fwhm_samples() * places;
                shape.add(&moved, *factor, column);
            }
        }
        if let Some(column) = columns.next() {
            add_equal_pair(shape, pulse, column);
        }
        self.columns.chunks_exact_mut(samples).for_each(|column| whitener.whiten(column));
        for i in 0..fitted + 2 {
            self.project(i, i, samples);
        }
        // Orthogonal to the fitted parameters only: it is an alternative to the two directions before it.
        self.project(fitted + 2, fitted, samples);
        let along = |i: usize| dot(&self.columns[i * samples..(i + 1) * samples], residual);
        let bent = along(fitted).powi(2) + along(fitted + 1).powi(2);
        bent.max(along(fitted + 2).max(0.0).powi(2))
    }

    /// Normalises column `i` and makes it orthogonal to the first `others`.
    fn project(&mut self, i: usize, others: usize, samples: usize) {
        let (before, rest) = self.columns.split_at_mut(i * samples);
        let column = &mut rest[..samples];
        let whole = dot(column, column);
        for other in before.chunks_exact(samples).take(others) {
            let part = dot(other, column);
            column.iter_mut().zip(other).for_each(|(c, o)| *c -= part * o);
        }
        let left = dot(column, column);
        // A direction spanned by the others adds no information.
        let scale = if left > LEAST_PART * whole { left.sqrt().recip() } else { 0.0 };
        column.iter_mut().for_each(|c| *c *= scale);
    }
}

/// Adds the residual expected of two equal pulses of calibrated width.
///
/// They have the same energy, centre and variance as the widened pulse.
fn add_equal_pair(shape: &Shape, pulse: Pulse, column: &mut [f64]) {
    let ratio = pulse.ln_width_ratio.exp();
    let reach = SD_OF_FWHM * shape.fwhm_samples() * (ratio * ratio - 1.0).max(0.0).sqrt();
    for shift in [-reach, reach] {
        let half = Pulse {
            height_dn: 0.5 * ratio * pulse.height_dn,
            position_samples: pulse.position_samples + shift,
            ln_width_ratio: 0.0,
            ..pulse
        };
        shape.add(&half, 1.0, column);
    }
    shape.add(&pulse, -1.0, column);
}
