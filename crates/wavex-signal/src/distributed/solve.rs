//! Non-negative least squares with a penalty on bending.

use std::ops::Range;

use crate::cholesky;
use crate::simd::dot::dot;

/// Penalties tried, as powers of ten of the mean diagonal, from the stiffest; steps per decade.
const STIFFEST: i32 = 2;
const STEPS_PER_DECADE: f64 = 2.0;
const STEPS: i32 = 20;
/// Largest number of sweeps over the points for one penalty.
const SWEEPS: usize = 60;
/// Largest change of a point in its last sweep, in its standard deviations.
const CONVERGED: f64 = 1e-2;
/// A penalty that explains this much more than the next stiffer one is still worth it.
const WORTH: f64 = 0.01;
/// Number of penalties that may gain nothing before the search ends.
const IDLE: usize = 3;

/// Columns of the points, and the memory of the fit.
#[derive(Default)]
pub(super) struct Solver {
    samples: usize,
    columns: Vec<f64>,
    /// By row of the normal equations, the points that it couples.
    bands: Vec<Range<usize>>,
    normal: Vec<f64>,
    penalised: Vec<f64>,
    right: Vec<f64>,
}

/// A profile on the grid, with its covariance.
pub(super) struct Solution {
    /// Non-negative values of the points.
    pub(super) values: Vec<f64>,
    /// Values with the next stiffer penalty; equal to `values` for the stiffest.
    pub(super) stiffer: Vec<f64>,
    /// Indices of the positive points.
    pub(super) free: Vec<usize>,
    /// Cholesky factor of the inverse covariance of the positive points, by rows.
    factor: Vec<f64>,
    /// `χ²` of the fit.
    pub(super) chi_square: f64,
    /// Usable samples minus effective parameters.
    pub(super) degrees_of_freedom: f64,
}

/// The fit with one penalty.
struct Fit {
    chi_square: f64,
    stiffness: f64,
    values: Vec<f64>,
    stiffer: Vec<f64>,
}

impl Solution {
    /// Variance of the sum of `weights` times the points.
    pub(super) fn variance(&self, weights: impl Fn(usize) -> f64) -> f64 {
        let mut weights: Vec<f64> = self.free.iter().map(|&point| weights(point)).collect();
        half_solve(&self.factor, &mut weights)
    }
}

impl Solver {
    /// Begins a fit to this number of samples.
    pub(super) fn begin(&mut self, samples: usize) {
        self.samples = samples;
        self.columns.clear();
    }

    /// Adds a column of zeros and returns it.
    pub(super) fn add_column(&mut self) -> &mut [f64] {
        let first = self.columns.len();
        self.columns.resize(first + self.samples, 0.0);
        &mut self.columns[first..]
    }

    /// Fits the columns to the whitened samples, of which `used` are usable.
    ///
    /// `None` if nothing is positive.
    pub(super) fn solve(&mut self, whitened: &[f64], used: usize) -> Option<Solution> {
        let points = self.columns.len() / self.samples;
        if points < 3 {
            return None;
        }
        self.prepare(whitened, points);
        let square = whitened.iter().map(|value| value * value).sum::<f64>();
        let mean_diagonal = (0..points).map(|i| self.normal[i * points + i]).sum::<f64>() / points as f64;
        let mut values = vec![0.0; points];
        let mut best: Option<Fit> = None;
        let mut idle = 0;
        for step in 0..STEPS {
            let power = f64::from(STIFFEST) - f64::from(step) / STEPS_PER_DECADE;
            let stiffness = mean_diagonal * libm::exp(power * std::f64::consts::LN_10);
            self.penalise(stiffness, points);
            self.descend(&mut values);
            let chi_square = self.chi_square(square, &values);
            let is_worth = best.as_ref().is_none_or(|best| chi_square < (1.0 - WORTH) * best.chi_square);
            idle = if is_worth { 0 } else { idle + 1 };
            if is_worth {
                let stiffer = best.map_or_else(|| values.clone(), |best| best.values);
                best = Some(Fit { chi_square, stiffness, values: values.clone(), stiffer });
            }
            // Morozov's principle: no smaller penalty than the noise asks for.
            if chi_square <= used as f64 || idle > IDLE {
                break;
            }
        }
        self.solution(best?, used)
    }

    /// Normal equations and the band that each row couples.
    fn prepare(&mut self, whitened: &[f64], points: usize) {
        let n = self.samples;
        let extent = |column: &[f64]| {
            let first = column.iter().position(|value| *value != 0.0).unwrap_or(0);
            first..column.iter().rposition(|value| *value != 0.0).map_or(first, |last| last + 1)
        };
        let extents: Vec<Range<usize>> = self.columns.chunks_exact(n).map(extent).collect();
        self.normal.clear();
        self.normal.resize(points * points, 0.0);
        self.right.clear();
        self.bands.clear();
        for i in 0..points {
            let column = &self.columns[i * n..(i + 1) * n];
            self.right.push(dot(column, whitened));
            let couples = |j: &usize| {
                extents[*j].start < extents[i].end && extents[i].start < extents[*j].end
                    || i.abs_diff(*j) <= 2
            };
            let first = (0..points).find(couples).unwrap_or(i);
            let last = (0..points).rfind(couples).unwrap_or(i);
            self.bands.push(first..last + 1);
            for j in first..=i {
                let common = extents[i].start.max(extents[j].start)..extents[i].end.min(extents[j].end);
                if common.is_empty() {
                    continue;
                }
                let other = &self.columns[j * n..(j + 1) * n];
                let product = dot(&column[common.clone()], &other[common]);
                self.normal[i * points + j] = product;
                self.normal[j * points + i] = product;
            }
        }
    }

    /// Normal equations with the penalty on second differences.
    fn penalise(&mut self, stiffness: f64, points: usize) {
        self.penalised.clear();
        self.penalised.extend_from_slice(&self.normal);
        for middle in 1..points - 1 {
            for (a, x) in [(middle - 1, 1.0), (middle, -2.0), (middle + 1, 1.0)] {
                for (b, y) in [(middle - 1, 1.0), (middle, -2.0), (middle + 1, 1.0)] {
                    self.penalised[a * points + b] += stiffness * x * y;
                }
            }
        }
    }

    /// Minimises over one point at a time, from the given values.
    fn descend(&self, values: &mut [f64]) {
        let points = values.len();
        for _ in 0..SWEEPS {
            let mut change = 0.0f64;
            for i in 0..points {
                let row = &self.penalised[i * points..(i + 1) * points];
                let curvature = row[i];
                if curvature <= 0.0 {
                    continue;
                }
                let band = self.bands[i].clone();
                let known = dot(&row[band.clone()], &values[band]);
                let value = (values[i] + (self.right[i] - known) / curvature).max(0.0);
                change = change.max((value - values[i]).abs() * curvature.sqrt());
                values[i] = value;
            }
            if change < CONVERGED {
                break;
            }
        }
    }

    fn chi_square(&self, square: f64, values: &[f64]) -> f64 {
        let points = values.len();
        let of_row = |i: usize| {
            let (row, band) = (&self.normal[i * points..(i + 1) * points], self.bands[i].clone());
            let known = dot(&row[band.clone()], &values[band]);
            values[i] * (known - 2.0 * self.right[i])
        };
        square + (0..points).filter(|&i| values[i] > 0.0).map(of_row).sum::<f64>()
    }

    /// Adds the covariance of the positive points, and the effective number of parameters.
    fn solution(&mut self, fit: Fit, used: usize) -> Option<Solution> {
        let Fit { chi_square, stiffness, values, stiffer } = fit;
        let points = values.len();
        self.penalise(stiffness, points);
        let free: Vec<usize> = (0..points).filter(|&i| values[i] > 0.0).collect();
        let m = free.len();
        if m == 0 {
            return None;
        }
        let of_row = |&i: &usize| free.iter().map(move |&j| i * points + j);
        let mut factor: Vec<f64> = free.iter().flat_map(of_row).map(|at| self.penalised[at]).collect();
        if !cholesky::factor(&mut factor, m) {
            return None;
        }
        // The penalty takes from the number of points what it decides itself: λ tr(C Dᵀ D).
        let mut taken = 0.0;
        for middle in 1..points - 1 {
            let bend = |point: &usize| match (point + 1).wrapping_sub(middle) {
                0 | 2 => 1.0,
                1 => -2.0,
                _ => 0.0,
            };
            let mut bend: Vec<f64> = free.iter().map(bend).collect();
            taken += stiffness * half_solve(&factor, &mut bend);
        }
        let degrees_of_freedom = (used as f64 - (m as f64 - taken)).max(1.0);
        Some(Solution { values, stiffer, free, factor, chi_square, degrees_of_freedom })
    }
}

/// Replaces `b` by `L⁻¹ b` and returns its square, `bᵀ (L Lᵀ)⁻¹ b`.
fn half_solve(factor: &[f64], b: &mut [f64]) -> f64 {
    let n = b.len();
    let first = b.iter().position(|value| *value != 0.0).unwrap_or(n);
    let mut square = 0.0;
    for i in first..n {
        let row = &factor[i * n..i * n + i];
        let known = dot(&row[first..], &b[first..i]);
        b[i] = (b[i] - known) / factor[i * n + i];
        square += b[i] * b[i];
    }
    square
}
