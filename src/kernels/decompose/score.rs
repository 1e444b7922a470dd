//! Whether a widened pulse may hide two: Rao's score, before the pair itself is fitted.
//!
//! A pair moves what it leaves of the samples out of the plane that one pulse's height, place and width span. The first
//! directions it takes are those of the third and the fourth derivative in time. By the heat equation the
//! derivative in the width's logarithm is the second one in time, but for a part of the shape itself: so the mixed
//! derivative in time and width, and the second one in width, stand for them (docs/explanation/method.md, Split test). `q = |P r|²`, the part
//! of the whitened residual in these directions once all fitted parameters are projected out, is chi-square with two
//! degrees of freedom where there is one pulse (Rao 1948). Two equal pulses some way apart leave more than these two
//! directions show: what they would leave is a third one, of known sign, and the greater of the two figures counts.

use crate::kernels::gauss_fit::Pulse;
use crate::kernels::rules::SD_OF_FWHM;
use crate::kernels::shape::Shape;
use crate::kernels::whitening::Whitener;
use crate::kernels::wide::dot;

/// Step of the differences in the width's logarithm, and in the place in widths.
const LN_WIDTH_STEP: f64 = 0.05;
/// What is left of a direction once others are projected out must be more than this part of its square.
const LEAST_PART: f64 = 1e-9;

/// Steps of second differences, as factor, step in the width and step in the place: what stands for the third
/// derivative in time …
const MIXED: [[f64; 3]; 4] = [[1.0, 1.0, 1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0], [1.0, -1.0, -1.0]];
/// … and for the fourth.
const SECOND: [[f64; 3]; 3] = [[1.0, 1.0, 0.0], [-2.0, 0.0, 0.0], [1.0, -1.0, 0.0]];

/// Workspace of the score.
#[derive(Debug, Clone, Default)]
pub(super) struct Score {
    /// Whitened directions, one column of the block's length after the other, made orthonormal.
    columns: Vec<f64>,
}

impl Score {
    /// For blocks of up to `max_samples` and clusters of up to `max_pulses`.
    pub(super) fn new(max_samples: usize, max_pulses: usize) -> Score {
        Score { columns: Vec::with_capacity((3 * max_pulses + 4) * max_samples) }
    }

    /// `q` of pulse `index` of a cluster; `residual` is what all pulses leave of the samples, whitened.
    pub(super) fn statistic(
        &mut self,
        shape: &Shape,
        whitener: &Whitener,
        offset_is_free: bool,
        cluster: impl ExactSizeIterator<Item = Pulse>,
        pulse: Pulse,
        residual: &[f64],
    ) -> f64 {
        let samples = residual.len().max(1);
        let fitted = 3 * cluster.len() + usize::from(offset_is_free);
        self.columns.clear();
        self.columns.resize((fitted + 3) * samples, 0.0);
        let mut columns = self.columns.chunks_exact_mut(samples);
        for p in cluster {
            let parts = [columns.next(), columns.next(), columns.next()];
            let [Some(by_height), Some(by_place), Some(by_width)] = parts else { return 0.0 };
            shape.add_derivatives(&p, [by_height, by_place, by_width]);
        }
        if offset_is_free && let Some(column) = columns.next() {
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
        self.project(fitted + 2, fitted, samples);
        let along = |i: usize| dot(&self.columns[i * samples..(i + 1) * samples], residual);
        let bent = along(fitted).powi(2) + along(fitted + 1).powi(2);
        bent.max(along(fitted + 2).max(0.0).powi(2))
    }

    /// Makes column `i` normal, and orthogonal to the first `others`.
    fn project(&mut self, i: usize, others: usize, samples: usize) {
        let (before, rest) = self.columns.split_at_mut(i * samples);
        let column = &mut rest[..samples];
        let whole = dot(column, column);
        for other in before.chunks_exact(samples).take(others) {
            let part = dot(other, column);
            column.iter_mut().zip(other).for_each(|(c, o)| *c -= part * o);
        }
        let left = dot(column, column);
        // A direction that others tell already says nothing new.
        let scale = if left > LEAST_PART * whole { left.sqrt().recip() } else { 0.0 };
        column.iter_mut().for_each(|c| *c *= scale);
    }
}

/// Adds what a widened pulse would leave if it were two equal ones of calibrated width, of the same energy, centre and
/// variance.
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
