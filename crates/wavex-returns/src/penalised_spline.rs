//! Penalised cubic smoothing spline (P-spline).
//!
//! P. H. C. Eilers and B. D. Marx, Flexible smoothing with B-splines and penalties, Statistical
//! Science 11, 1996, equation 6. The stiffness is chosen by generalised cross-validation (P. Craven
//! and G. Wahba, Smoothing noisy data with spline functions, Numerische Mathematik 31, 1979).

use nalgebra::{DMatrix, DVector};

/// Largest number of spline pieces; fewer if there are fewer than two points per piece.
const MOST_PIECES: usize = 20;
/// Fewest points; fewer are returned unchanged.
const LEAST_POINTS: usize = 5;
/// Range of tried stiffnesses in steps, as powers of ten relative to the points' weight, and steps
/// per decade.
const STIFFNESS: std::ops::RangeInclusive<i32> = -12..=16;
const STEPS_PER_DECADE: f64 = 2.0;

/// A point to be smoothed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DataPoint {
    /// Abscissa.
    pub x: f64,
    /// Noisy value.
    pub y: f64,
    /// Weight, inversely proportional to the variance of `y`.
    pub weight: f64,
}

/// Values of the smooth curve at the points, in their order.
///
/// Points must be sorted by `x`. The values are returned unchanged for fewer than five points, for
/// a single abscissa, for non-finite values or weights, and for non-positive weights.
pub fn smooth(points: &[DataPoint]) -> Vec<f64> {
    let as_given = || points.iter().map(|point| point.y).collect();
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return Vec::new() };
    let usable = |p: &DataPoint| p.x.is_finite() && p.y.is_finite() && p.weight.is_finite() && p.weight > 0.0;
    let span = last.x - first.x;
    if points.len() < LEAST_POINTS || span.is_nan() || span <= 0.0 || !points.iter().all(usable) {
        return as_given();
    }
    let pieces = (points.len() / 2).clamp(2, MOST_PIECES);
    let basis = basis(points, first.x, span, pieces);
    fitted(points, &basis).unwrap_or_else(as_given)
}

/// Curve with the stiffness of the smallest cross-validation score.
fn fitted(points: &[DataPoint], basis: &DMatrix<f64>) -> Option<Vec<f64>> {
    let n = points.len() as f64;
    let weighted = DMatrix::from_fn(basis.nrows(), basis.ncols(), |i, j| points[i].weight * basis[(i, j)]);
    let normal = basis.transpose() * &weighted;
    let right = weighted.transpose() * DVector::from_iterator(points.len(), points.iter().map(|p| p.y));
    let bends = bend_penalty(basis.ncols());
    let unit = normal.trace() / bends.trace();
    let mut best: Option<(f64, DVector<f64>)> = None;
    for step in STIFFNESS {
        let stiffness = unit * 10f64.powf(f64::from(step) / STEPS_PER_DECADE);
        let Some(factor) = (&normal + &bends * stiffness).cholesky() else { continue };
        let curve = basis * factor.solve(&right);
        let freedom = n - factor.solve(&normal).trace();
        let misfit: f64 = points.iter().zip(curve.iter()).map(|(p, y)| p.weight * (p.y - y).powi(2)).sum();
        let score = misfit / freedom.max(1e-9).powi(2);
        // Of stiffnesses equal up to rounding, the larger one.
        if best.as_ref().is_none_or(|(least, _)| score <= least * (1.0 + 1e-9)) {
            best = Some((score, curve));
        }
    }
    best.map(|(_, curve)| curve.iter().copied().collect())
}

/// Values of every B-spline, one column each, at every point.
fn basis(points: &[DataPoint], from: f64, span: f64, pieces: usize) -> DMatrix<f64> {
    let mut basis = DMatrix::zeros(points.len(), pieces + 3);
    for (row, point) in points.iter().enumerate() {
        let place = (point.x - from) / span * pieces as f64;
        let piece = (place.max(0.0) as usize).min(pieces - 1);
        for (k, value) in cubic(place - piece as f64).into_iter().enumerate() {
            basis[(row, piece + k)] = value;
        }
    }
    basis
}

/// The four non-zero cubic B-splines at fraction `t` of a piece, 0 to 1.
fn cubic(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    let inner = |t: f64| (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0;
    [s * s * s / 6.0, inner(t), inner(s), t * t * t / 6.0]
}

/// Penalty matrix of the squared second differences of `n` coefficients.
fn bend_penalty(n: usize) -> DMatrix<f64> {
    let differences = DMatrix::from_fn(n - 2, n, |i, j| match j.wrapping_sub(i) {
        0 | 2 => 1.0,
        1 => -2.0,
        _ => 0.0,
    });
    differences.transpose() * differences
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_signal::simulated::Random;

    fn points(n: usize, y: impl Fn(f64) -> f64) -> Vec<DataPoint> {
        (0..n).map(|k| k as f64 / n as f64).map(|x| DataPoint { x, y: y(x), weight: 1.0 }).collect()
    }

    #[test]
    fn a_straight_line_stays_itself() {
        let line = points(40, |x| 3.0 - 2.0 * x);
        let largest = smooth(&line).iter().zip(&line).map(|(y, p)| (y - p.y).abs()).fold(0.0, f64::max);
        assert!(largest < 1e-6, "{largest}");
    }

    #[test]
    fn noise_is_taken_off_a_curve() {
        let truth = |x: f64| (5.0 * x).sin();
        let mut random = Random::new(5);
        let noisy: Vec<DataPoint> = points(400, truth)
            .into_iter()
            .map(|point| DataPoint { y: point.y + 0.1 * random.normal(), ..point })
            .collect();
        let rms = |errors: Vec<f64>| (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        let before = rms(noisy.iter().map(|p| p.y - truth(p.x)).collect());
        let after = rms(smooth(&noisy).iter().zip(&noisy).map(|(y, p)| y - truth(p.x)).collect());
        assert!(before > 0.09 && after < 0.025, "{before} {after}");
    }

    #[test]
    fn a_point_of_little_weight_bends_nothing() {
        let mut line = points(40, |x| x);
        (line[20].y, line[20].weight) = (50.0, 1e-9);
        assert!((smooth(&line)[20] - line[20].x).abs() < 1e-3);
    }

    #[test]
    fn what_cannot_be_smoothed_is_left() {
        let few = points(4, |x| x * x);
        assert_eq!(smooth(&few), few.iter().map(|p| p.y).collect::<Vec<_>>());
        assert_eq!(smooth(&[DataPoint { x: 1.0, y: 2.0, weight: 1.0 }; 9]), [2.0; 9]);
        assert_eq!(smooth(&[]), [0.0; 0]);
    }
}
