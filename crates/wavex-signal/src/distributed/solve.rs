//! Non-negative least squares with a penalty on bending.
//!
//! The positive points of a penalty are found by block principal pivoting (L. F. Portugal, J. J.
//! Júdice and L. N. Vicente, A comparison of block pivoting and interior-point algorithms for linear
//! least squares problems with nonnegative variables, Mathematics of Computation 63, 1994) from
//! those of the penalty before. Both matrices of the fit have a band.

use super::band::{BandFactor, LANES, product, subtract};
use super::columns::Columns;
use crate::simd::dot::dot;
use crate::simd::{Kernel, Simd, SimdLevel};

/// Penalties, as powers of ten of the mean diagonal, from the stiffest; steps per decade.
const STIFFEST: f64 = 2.0;
const STEPS_PER_DECADE: f64 = 2.0;
const STEPS: usize = 12;
/// Penalty that is tried first.
const FIRST_STEP: usize = 8;
/// A penalty that leaves this much more than the smallest one is preferred to it.
const WORTH: f64 = 0.01;
/// Gradient of a point at zero from which it is freed, in its standard deviations.
const CONVERGED: f64 = 1e-3;
/// Largest number of exchanges for one penalty.
const EXCHANGES: usize = 200;
/// Number of exchanges of all points that may gain nothing; then one is exchanged at a time.
const PATIENCE: usize = 3;
/// Relative change of the penalty for the effective number of parameters.
const PENALTY_CHANGE: f64 = 1e-4;

/// Equations of the fit, and their memory.
#[derive(Default)]
pub(super) struct Solver {
    /// Largest distance of two coupled points.
    reach: usize,
    /// Entries of a row of the matrices, from the diagonal, with padding.
    width: usize,
    normal: Vec<f64>,
    penalised: Vec<f64>,
    right: Vec<f64>,
    /// Square of the whitened samples.
    square: f64,
    mean_diagonal: f64,
    /// Fits by penalty: values of the points, and `χ²` if fitted.
    fits: Vec<f64>,
    chi_squares: [Option<f64>; STEPS],
    is_free: Vec<bool>,
    free: Vec<usize>,
    reduced: Vec<f64>,
    /// Values of all points, and the descent there, with padding.
    values: Vec<f64>,
    descent: Vec<f64>,
    /// Points to be exchanged.
    to_exchange: Vec<usize>,
    factor: BandFactor,
}

/// A profile on the grid, with its covariance.
pub(super) struct Solution<'a> {
    /// Non-negative values of the points.
    pub(super) values: &'a [f64],
    /// Values with the next stiffer penalty; equal to `values` for the stiffest.
    pub(super) stiffer: &'a [f64],
    /// Indices of the positive points.
    free: &'a [usize],
    /// Of the inverse covariance of the positive points.
    factor: &'a BandFactor,
    /// `χ²` of the fit.
    pub(super) chi_square: f64,
    /// Usable samples minus effective parameters.
    pub(super) degrees_of_freedom: f64,
}

impl Solution<'_> {
    /// Variance of the sum of `weights` times the points.
    pub(super) fn variance(&self, weights: impl Fn(usize) -> f64) -> f64 {
        let mut weights: Vec<f64> = self.free.iter().map(|&point| weights(point)).collect();
        let first = weights.iter().position(|weight| *weight != 0.0).unwrap_or(weights.len());
        weights.resize(weights.len() + LANES, 0.0);
        self.factor.half_solve(first, &mut weights);
        dot(&weights, &weights)
    }
}

impl Solver {
    /// Fits the columns to the whitened samples, of which `used` are usable.
    ///
    /// `None` if nothing is positive.
    pub(super) fn solve(&mut self, columns: &Columns, whitened: &[f64], used: usize) -> Option<Solution<'_>> {
        columns.project_into(whitened, &mut self.right);
        let points = self.right.len();
        if points < 3 {
            return None;
        }
        self.reach = columns.reach().max(2);
        self.width = (self.reach + 1).next_multiple_of(LANES);
        columns.multiply_into(self.width, &mut self.normal);
        self.mean_diagonal = self.normal.iter().step_by(self.width).sum::<f64>() / points as f64;
        self.square = dot(whitened, whitened);
        self.is_free.clear();
        self.is_free.extend(self.right.iter().map(|right| *right > 0.0));
        self.chi_squares = [None; STEPS];
        self.fits.resize(STEPS * points, 0.0);
        // Morozov's principle: no smaller penalty than the noise asks for.
        let mut step = FIRST_STEP;
        let mut chi_square = self.fit(step)?;
        while chi_square > used as f64 && step + 1 < STEPS {
            step += 1;
            chi_square = self.fit(step)?;
        }
        let target = if chi_square > used as f64 { (1.0 + WORTH) * chi_square } else { used as f64 };
        while step > 0 {
            let stiffer = self.fit(step - 1)?;
            if stiffer > target {
                break;
            }
            (step, chi_square) = (step - 1, stiffer);
        }
        self.solution(step, chi_square, used)
    }

    fn stiffness(&self, step: usize) -> f64 {
        let power = STIFFEST - step as f64 / STEPS_PER_DECADE;
        self.mean_diagonal * libm::exp(power * std::f64::consts::LN_10)
    }

    /// Fits with a penalty, unless that is done, and returns `χ²`.
    fn fit(&mut self, step: usize) -> Option<f64> {
        if let Some(chi_square) = self.chi_squares[step] {
            return Some(chi_square);
        }
        let stiffness = self.stiffness(step);
        self.penalise(stiffness);
        self.minimise()?;
        let points = self.right.len();
        let values = &mut self.fits[step * points..(step + 1) * points];
        values.iter_mut().zip(&self.values).for_each(|(to, value)| *to = value.max(0.0));
        // At the minimum the residual is orthogonal to the fit, but for the penalty.
        let bend = values.windows(3).map(|v| (v[0] - 2.0 * v[1] + v[2]).powi(2)).sum::<f64>();
        let chi_square = self.square - dot(&self.right, values) - stiffness * bend;
        self.chi_squares[step] = Some(chi_square);
        Some(chi_square)
    }

    /// Normal equations with the penalty on second differences.
    fn penalise(&mut self, stiffness: f64) {
        const BEND: [f64; 3] = [1.0, -2.0, 1.0];
        self.penalised.clone_from(&self.normal);
        for first in 0..self.right.len() - 2 {
            for a in 0..BEND.len() {
                let row = &mut self.penalised[(first + a) * self.width..];
                for b in a..BEND.len() {
                    row[b - a] += stiffness * BEND[a] * BEND[b];
                }
            }
        }
    }

    /// Minimises over the non-negative values, from the present free points.
    fn minimise(&mut self) -> Option<()> {
        let (mut fewest, mut patience) = (usize::MAX, PATIENCE);
        for _ in 0..EXCHANGES {
            self.solve_free()?;
            SimdLevel::best().processor().run(Descent(self));
            let falls = self.free.iter().zip(&self.reduced).filter(|(_, value)| **value < 0.0);
            self.to_exchange.clear();
            self.to_exchange.extend(falls.map(|(&point, _)| point));
            let rises = |point: &usize| {
                let sd = self.penalised[point * self.width].sqrt();
                !self.is_free[*point] && self.descent[*point] > CONVERGED * sd
            };
            self.to_exchange.extend((0..self.right.len()).filter(rises));
            let Some(&last) = self.to_exchange.iter().max() else { return Some(()) };
            if self.to_exchange.len() < fewest {
                (fewest, patience) = (self.to_exchange.len(), PATIENCE);
            } else if patience > 0 {
                patience -= 1;
            } else {
                self.to_exchange.clear();
                self.to_exchange.push(last);
            }
            self.to_exchange.iter().for_each(|&point| self.is_free[point] = !self.is_free[point]);
        }
        None
    }

    /// Solves for the free points.
    fn solve_free(&mut self) -> Option<()> {
        self.factor_free()?;
        self.reduced.clear();
        self.reduced.extend(self.free.iter().map(|&point| self.right[point]));
        self.reduced.resize(self.free.len() + LANES, 0.0);
        self.factor.solve(&mut self.reduced);
        self.values.clear();
        self.values.resize(self.right.len() + self.width, 0.0);
        self.free.iter().zip(&self.reduced).for_each(|(&point, value)| self.values[point] = *value);
        Some(())
    }

    /// Factor of the rows and columns of the free points.
    fn factor_free(&mut self) -> Option<()> {
        self.free.clear();
        self.free.extend((0..self.right.len()).filter(|&point| self.is_free[point]));
        self.factor.begin(self.free.len().min(self.reach + 1));
        for (i, &point) in self.free.iter().enumerate() {
            let row = &self.penalised[point * self.width..];
            let coupled = self.free[i..].iter().map(|other| other - point);
            self.factor.push(coupled.take_while(|apart| *apart <= self.reach).map(|apart| row[apart]));
        }
        self.factor.factor().then_some(())
    }

    /// Adds the covariance of the positive points, and the effective number of parameters.
    fn solution(&mut self, step: usize, chi_square: f64, used: usize) -> Option<Solution<'_>> {
        let points = self.right.len();
        let fit = |step: usize| step * points..(step + 1) * points;
        self.is_free.clear();
        self.is_free.extend(self.fits[fit(step)].iter().map(|value| *value > 0.0));
        let stiffness = self.stiffness(step);
        self.penalise(stiffness * (1.0 + PENALTY_CHANGE));
        self.factor_free()?;
        let stiffer_ln_determinant = self.factor.ln_determinant();
        self.penalise(stiffness);
        self.factor_free()?;
        // The penalty takes from the number of points what it decides itself: d ln det / d ln λ.
        let taken = (stiffer_ln_determinant - self.factor.ln_determinant()) / PENALTY_CHANGE;
        let degrees_of_freedom = (used as f64 - (self.free.len() as f64 - taken)).max(1.0);
        (!self.free.is_empty()).then_some(Solution {
            values: &self.fits[fit(step)],
            stiffer: &self.fits[fit(step.saturating_sub(1))],
            free: &self.free,
            factor: &self.factor,
            chi_square,
            degrees_of_freedom,
        })
    }
}

/// Half the steepest descent of `χ²` at the points at zero.
struct Descent<'a>(&'a mut Solver);

impl Kernel for Descent<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let Solver { width, penalised, right, values, is_free, descent, .. } = self.0;
        descent.clear();
        descent.extend_from_slice(right);
        descent.resize(right.len() + *width, 0.0);
        for (point, row) in penalised.chunks_exact(*width).enumerate() {
            // The rows hold one half of the matrix: that of the later points.
            if is_free[point] {
                subtract(&mut descent[point..], values[point], row);
            } else {
                descent[point] -= product(row, &values[point..]);
            }
        }
    }
}
