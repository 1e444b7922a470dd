//! Standard deviations at the solution.

use nalgebra::{DMatrix, DVector};

use crate::matching::Pair;
use crate::normal::{Problem, Weighting};
use crate::parameters::GLOBALS;
use crate::survey::State;

/// Standard deviations at the solution.
pub(crate) struct Solution {
    /// Covariance of the parameters of all installations.
    pub(crate) globals: DMatrix<f64>,
    /// Formal SDs of all unknowns.
    pub(crate) formal: Vec<f64>,
    /// SDs of all unknowns from the scatter of tiles.
    pub(crate) jackknife: Vec<f64>,
}

impl Solution {
    /// `None` if the normal equations have no solution.
    ///
    /// Held parameters keep their start values; their SDs pass to the others through their effect on them (consider
    /// parameters of S. F. Schmidt).
    pub(crate) fn new(
        problem: &Problem<'_>,
        state: &State,
        pairs: &[Pair],
        weighting: &Weighting,
        held: &[usize],
    ) -> Option<Solution> {
        let layout = &problem.layout;
        let mut normal = problem.normal(state, pairs, weighting, true);
        let mut effects = Vec::new();
        for &unknown in held {
            let (node, offset) = layout.place(unknown);
            effects.push(-normal.matrix.hold(node, offset));
        }
        for effect in effects.iter_mut().chain(&mut normal.groups) {
            held.iter().for_each(|&unknown| effect[unknown] = 0.0);
        }
        let factor = normal.matrix.factor()?;
        let inverse = factor.selected_inverse();
        let n_globals = GLOBALS * layout.installations;
        let first = layout.globals_start();
        let block = inverse.diagonal(layout.globals_node())?;
        let mut globals = block.clone();
        let mut formal: Vec<f64> = (0..layout.len())
            .map(|unknown| {
                let (node, offset) = layout.place(unknown);
                inverse.diagonal(node).map_or(0.0, |block| block[(offset, offset)])
            })
            .collect();
        let mut jackknife = vec![0.0; layout.len()];
        let n_groups = normal.groups.iter().filter(|group| group.amax() > 0.0).count().max(2) as f64;
        let factor_of_groups = n_groups / (n_groups - 1.0);
        for group in &normal.groups {
            let change = factor.solve(group);
            jackknife.iter_mut().zip(change.iter()).for_each(|(sum, x)| *sum += factor_of_groups * x * x);
        }
        // Control points are few, and their SDs are given: their part is formal, like that of the priors.
        let control = problem.control_rows(state, weighting);
        // The part of the priors, for the parameters of installations.
        for unknown in first..layout.len() {
            let mut unit = DVector::zeros(layout.len());
            unit[unknown] = 1.0;
            let column = factor.solve(&unit);
            let mut product = vec![0.0; layout.len()];
            problem.prior_times(&column, &mut product, None);
            held.iter().for_each(|&unknown| product[unknown] = 0.0);
            jackknife[unknown] += column.iter().zip(product).map(|(x, y)| x * y).sum::<f64>();
            for (row, weight) in &control {
                let along: f64 = row.entries.iter().map(|(other, by)| by * column[*other]).sum();
                jackknife[unknown] += weight * along * along;
            }
        }
        for (&unknown, effect) in held.iter().zip(&effects) {
            let mut effect = factor.solve(effect);
            held.iter().for_each(|&other| effect[other] = 0.0);
            effect[unknown] = 1.0;
            let k = unknown - first;
            let sd = problem.priors.globals[k / GLOBALS][k % GLOBALS];
            let scaled = effect * sd;
            // The held unknown itself has unit information in the system.
            formal[unknown] = 0.0;
            jackknife[unknown] = 0.0;
            globals[(k, k)] = 0.0;
            for (other, x) in scaled.iter().enumerate() {
                formal[other] += x * x;
                jackknife[other] += x * x;
            }
            let of_globals = scaled.rows(first, n_globals);
            globals += of_globals * of_globals.transpose();
        }
        let sds = |variances: Vec<f64>| variances.into_iter().map(|v| v.max(0.0).sqrt()).collect();
        Some(Solution { globals, formal: sds(formal), jackknife: sds(jackknife) })
    }

    pub(crate) fn sd(&self, unknown: usize) -> f64 {
        self.formal[unknown].max(self.jackknife[unknown])
    }
}
