//! A smooth curve through noisy points: a cubic spline whose bends are penalised (P. H. C. Eilers and B. D. Marx, Flexible
//! smoothing with B-splines and penalties, Statistical Science 11, 1996, equation 6), as stiff as generalised
//! cross-validation finds best (P. Craven and G. Wahba, Smoothing noisy data with spline functions, Numerische Mathematik
//! 31, 1979).

use nalgebra::{DMatrix, DVector};

/// Pieces of the spline at most; fewer where there are fewer than two points for each.
const MOST_PIECES: usize = 20;
/// Fewer points are left as they are.
const LEAST_POINTS: usize = 5;
/// Stiffnesses that are tried, as powers of ten of the points' own weight, and the steps between them.
const STIFFNESS: std::ops::RangeInclusive<i32> = -12..=16;
const STEPS_PER_DECADE: f64 = 2.0;

/// A point to be smoothed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Where it stands.
    pub x: f64,
    /// Its noisy value.
    pub y: f64,
    /// How much it counts: in inverse proportion to the variance of `y`.
    pub weight: f64,
}

/// The smooth curve's values where the points stand, in their order.
///
/// Points come by rising `x`. Fewer than five, points at one place, and weights or values that are not finite, or weights
/// that are not positive, give the values as they are.
pub fn smooth(points: &[Point]) -> Vec<f64> {
    let as_given = || points.iter().map(|point| point.y).collect();
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return Vec::new() };
    let usable = |p: &Point| p.x.is_finite() && p.y.is_finite() && p.weight.is_finite() && p.weight > 0.0;
    let span = last.x - first.x;
    if points.len() < LEAST_POINTS || span.is_nan() || span <= 0.0 || !points.iter().all(usable) {
        return as_given();
    }
    let pieces = (points.len() / 2).clamp(2, MOST_PIECES);
    let basis = basis(points, first.x, span, pieces);
    fitted(points, &basis).unwrap_or_else(as_given)
}

/// The curve of the stiffness with the least score of cross-validation.
fn fitted(points: &[Point], basis: &DMatrix<f64>) -> Option<Vec<f64>> {
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
        // Of stiffnesses that are as good but for rounding the stiffer one.
        if best.as_ref().is_none_or(|(least, _)| score <= least * (1.0 + 1e-9)) {
            best = Some((score, curve));
        }
    }
    best.map(|(_, curve)| curve.iter().copied().collect())
}

/// The value of every B-spline, a column each, where every point stands.
fn basis(points: &[Point], from: f64, span: f64, pieces: usize) -> DMatrix<f64> {
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

/// The four cubic B-splines that are not zero at `t` of a piece, 0 to 1.
fn cubic(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    let inner = |t: f64| (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0;
    [s * s * s / 6.0, inner(t), inner(s), t * t * t / 6.0]
}

/// Sum of the squared second differences of so many coefficients.
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
    use crate::kernels::simulated::Random;

    fn points(n: usize, y: impl Fn(f64) -> f64) -> Vec<Point> {
        (0..n).map(|k| k as f64 / n as f64).map(|x| Point { x, y: y(x), weight: 1.0 }).collect()
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
        let noisy: Vec<Point> = points(400, truth)
            .into_iter()
            .map(|point| Point { y: point.y + 0.1 * random.normal(), ..point })
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
        assert_eq!(smooth(&[Point { x: 1.0, y: 2.0, weight: 1.0 }; 9]), [2.0; 9]);
        assert_eq!(smooth(&[]), [0.0; 0]);
    }
}
