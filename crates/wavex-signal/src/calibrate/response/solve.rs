//! Linear least-squares problem for the splines of the response, in the whitened domain.

use std::ops::Range;

use wavex_simd::dot::dot;

use super::Single;
use super::spline::Basis;
use crate::cholesky;
use crate::pulse_fit::{FIXED_WIDTH_PRECISION, PulseFit, StopCriteria};
use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::Pulse;
use crate::shape::Shape;
use crate::whitening::Whitener;

/// Ridge added to the diagonal, relative to its largest element.
const RIDGE: f64 = 1e-6;
/// SD of the second difference of neighbouring splines in the tail: a slow tail is smooth.
const TAIL_BEND_SD: f64 = 0.004;
/// SD of the first difference in the tail: without data the tail decays to zero.
const TAIL_SLOPE_SD: f64 = 0.003;
/// SD of the difference of a spline between adjacent nodes.
const NODE_CHANGE_SD: f64 = 0.02;

/// Tolerance for heights and positions: a hundredth of their standard deviations.
const NEAR: StopCriteria = StopCriteria { iterations: 30, decrease: 1e-4, enough: f64::INFINITY };

/// Normal equations of the splines of all nodes.
pub(super) struct SolverProblem<'a> {
    model: &'a ChannelModel,
    basis: &'a Basis,
    nodes: &'a [f64],
    fitter: PulseFit,
    whitener: Whitener,
    normal: Vec<f64>,
    right: Vec<f64>,
    target: Vec<f64>,
    columns: Vec<f64>,
    extents: Vec<Range<usize>>,
}

/// Spline coefficients by node.
pub(super) struct Solution {
    pub(super) coefficients: Vec<Vec<f64>>,
    /// RMS uncertainty of the first node's main lobe.
    pub(super) shape_sd: f64,
    /// Decrease of the objective by the splines, relative to none.
    decrease: f64,
}

impl<'a> SolverProblem<'a> {
    pub(super) fn new(
        model: &'a ChannelModel,
        basis: &'a Basis,
        nodes: &'a [f64],
        shape: Shape,
        longest: usize,
    ) -> Result<SolverProblem<'a>, ModelError> {
        let unknowns = basis.len() * nodes.len();
        Ok(SolverProblem {
            model,
            basis,
            nodes,
            fitter: PulseFit::new(shape, model.offset_precision(), longest, 1),
            whitener: Whitener::new(model.noise()?, longest),
            normal: vec![0.0; unknowns * unknowns],
            right: vec![0.0; unknowns],
            target: Vec::new(),
            columns: Vec::new(),
            extents: Vec::new(),
        })
    }

    /// Adds the equations of another problem with the same splines.
    pub(super) fn merged(mut self, other: SolverProblem<'a>) -> SolverProblem<'a> {
        let add = |sums: &mut [f64], more: &[f64]| sums.iter_mut().zip(more).for_each(|(a, b)| *a += b);
        add(&mut self.normal, &other.normal);
        add(&mut self.right, &other.right);
        self
    }

    /// Adds an echo; fits its height and position with the calibrated width.
    pub(super) fn add(&mut self, single: &Single<'_>) {
        let samples = single.block.samples;
        self.whitener.set_used(&vec![true; samples.len()]);
        self.target.clear();
        self.model.signal_into(samples, &mut self.target);
        let start = Pulse {
            height_dn: single.fitted.amplitude_dn,
            position_samples: single.fitted.position_samples,
            ln_width_ratio: 0.0,
            ln_width_precision: FIXED_WIDTH_PRECISION,
        };
        let fit = self.fitter.fit(&self.whitener, &self.target, &[start], NEAR);
        let (true, Some(&pulse)) = (fit.termination.is_optimum(), self.fitter.pulses().first()) else {
            return;
        };
        let offset = self.fitter.offset_dn();
        self.target.iter_mut().for_each(|value| *value -= offset);
        self.whitener.whiten(&mut self.target);
        self.fill_columns(&pulse, samples.len());
        self.accumulate(pulse.height_dn, samples.len());
    }

    /// Fills the whitened splines of an echo, each with the range of samples where it differs from
    /// zero.
    ///
    /// Whitening extends this range by the order of the noise model.
    fn fill_columns(&mut self, pulse: &Pulse, samples: usize) {
        let SolverProblem { basis, model, whitener, columns, extents, .. } = self;
        columns.clear();
        columns.resize(basis.len() * samples, 0.0);
        extents.clear();
        // A spline without samples has an end before its start.
        extents.resize(basis.len(), samples..0);
        for k in 0..samples {
            for (j, value) in basis.at(model.digitiser.time_of(k) - pulse.position_samples) {
                columns[j * samples + k] = pulse.height_dn * value;
                extents[j] = extents[j].start.min(k)..k + 1;
            }
        }
        let order = whitener.noise().order();
        for (column, extent) in columns.chunks_exact_mut(samples.max(1)).zip(extents) {
            if extent.start < extent.end {
                extent.end = (extent.end + order).min(samples);
                whitener.whiten_from(extent.start, &mut column[..extent.end]);
            }
        }
    }

    fn accumulate(&mut self, height_dn: f64, samples: usize) {
        let count = self.basis.len();
        let unknowns = count * self.nodes.len();
        let shares = shares(self.nodes, height_dn);
        let column = |j: usize, extent: Range<usize>| &self.columns[j * samples..][extent];
        for (i, extent) in self.extents.iter().enumerate().filter(|(_, extent)| !extent.is_empty()) {
            let known = dot(column(i, extent.clone()), &self.target[extent.clone()]);
            for &(node, share) in &shares {
                self.right[node * count + i] += share * known;
            }
            // Splines are ordered by time, so overlapping ones are adjacent.
            for j in (0..=i).rev() {
                let other = &self.extents[j];
                let common = extent.start.max(other.start)..extent.end.min(other.end);
                if common.is_empty() {
                    break;
                }
                let product = dot(column(i, common.clone()), column(j, common));
                for &(a, share_a) in &shares {
                    for &(b, share_b) in &shares {
                        let (row, other_row) = (a * count + i, b * count + j);
                        self.normal[row * unknowns + other_row] += share_a * share_b * product;
                        if i != j {
                            self.normal[other_row * unknowns + row] += share_a * share_b * product;
                        }
                    }
                }
            }
        }
    }

    /// Adds the priors: tails are smooth, and neighbouring nodes are similar.
    fn add_priors(&mut self) {
        let (count, unknowns) = (self.basis.len(), self.right.len());
        let greatest = (0..unknowns).map(|i| self.normal[i * unknowns + i]).fold(0.0, f64::max);
        for i in 0..unknowns {
            self.normal[i * unknowns + i] += RIDGE * greatest;
        }
        for node in 0..self.nodes.len() {
            for j in self.basis.lobe..count {
                // Beyond the last spline the value is zero.
                let terms = [(j.wrapping_sub(1), 1.0), (j, -2.0), (j + 1, 1.0)];
                let terms = terms.map(|(j, c)| (if j < count { Some(node * count + j) } else { None }, c));
                self.add_square(&terms, TAIL_BEND_SD.powi(-2));
                self.add_square(&[(terms[1].0, 1.0), (terms[2].0, -1.0)], TAIL_SLOPE_SD.powi(-2));
            }
            if node > 0 {
                for j in 0..count {
                    let terms = [(Some(node * count + j), 1.0), (Some((node - 1) * count + j), -1.0)];
                    self.add_square(&terms, NODE_CHANGE_SD.powi(-2));
                }
            }
        }
    }

    fn add_square(&mut self, terms: &[(Option<usize>, f64)], precision: f64) {
        let unknowns = self.right.len();
        for &(i, a) in terms {
            for &(j, b) in terms {
                if let (Some(i), Some(j)) = (i, j) {
                    self.normal[i * unknowns + j] += precision * a * b;
                }
            }
        }
    }

    /// Solves with all nodes, or with one for all heights if more are not significant.
    ///
    /// Further nodes must improve the fit beyond their noise (Akaike 1974: two per additional
    /// parameter). `None` for singular equations.
    pub(super) fn solve(self) -> Option<Solution> {
        let one = self.with_one_node();
        let more = 2.0 * (self.right.len() - one.right.len()) as f64;
        let all = self.solve_all()?;
        match one.solve_all() {
            Some(one) if all.decrease - one.decrease <= more => Some(one),
            _ => Some(all),
        }
    }

    /// Reduces the problem to one node: shares of nodes sum to one, so its equations are sums.
    fn with_one_node(&self) -> SolverProblem<'a> {
        let (count, unknowns) = (self.basis.len(), self.right.len());
        let nodes = &self.nodes[..1];
        let mut normal = vec![0.0; count * count];
        let mut right = vec![0.0; count];
        for (i, known) in self.right.iter().enumerate() {
            right[i % count] += known;
            for j in 0..unknowns {
                normal[(i % count) * count + j % count] += self.normal[i * unknowns + j];
            }
        }
        let (fitter, whitener) = (self.fitter.clone(), self.whitener.clone());
        SolverProblem {
            nodes,
            fitter,
            whitener,
            normal,
            right,
            target: Vec::new(),
            columns: Vec::new(),
            extents: Vec::new(),
            ..*self
        }
    }

    fn solve_all(mut self) -> Option<Solution> {
        self.add_priors();
        let (count, unknowns) = (self.basis.len(), self.right.len());
        let known = self.right.clone();
        if !cholesky::factor(&mut self.normal, unknowns) {
            return None;
        }
        cholesky::solve(&self.normal, unknowns, &mut self.right);
        let decrease = dot(&known, &self.right);
        let lobe = self.basis.lobe.max(1);
        let variance = |i: usize| {
            let mut unit = vec![0.0; unknowns];
            unit[i] = 1.0;
            cholesky::solve(&self.normal, unknowns, &mut unit);
            unit[i]
        };
        let mean = (0..lobe).map(variance).sum::<f64>() / lobe as f64;
        let coefficients = self.right.chunks_exact(count).map(<[f64]>::to_vec).collect();
        Some(Solution { coefficients, shape_sd: mean.sqrt(), decrease })
    }
}

/// Nodes around a height and their weights.
fn shares(nodes: &[f64], height_dn: f64) -> Vec<(usize, f64)> {
    let above = nodes.partition_point(|peak_dn| *peak_dn <= height_dn);
    if above == 0 || above == nodes.len() {
        return vec![(above.saturating_sub(1), 1.0)];
    }
    let part = (height_dn - nodes[above - 1]) / (nodes[above] - nodes[above - 1]);
    vec![(above - 1, 1.0 - part), (above, part)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decompose::Return;
    use crate::decompose::Waveform;
    use crate::noise::ArNoise;
    use crate::simulated::{Random, analogue, channel, digitised, pulse};

    const SAMPLES: usize = 60;
    const NODES: [f64; 2] = [100.0, 160.0];

    fn found(height_dn: f64, position_samples: f64) -> Return {
        Return {
            position_samples,
            position_sd_samples: 0.02,
            amplitude_dn: height_dn,
            amplitude_sd_dn: 0.7,
            width_ratio: 1.0,
            width_ratio_sd: 0.01,
            fwhm_ns: 4.4,
            deviation_ratio: 0.0,
            flags: 0,
        }
    }

    /// Complete columns, whitened over the whole block, and all their products.
    fn add_densely(problem: &SolverProblem<'_>, single: &Single<'_>, normal: &mut [f64], right: &mut [f64]) {
        let echo = problem.fitter.pulses()[0];
        let (count, unknowns) = (problem.basis.len(), right.len());
        let mut target = Vec::new();
        problem.model.signal_into(single.block.samples, &mut target);
        problem.whitener.whiten(&mut target);
        let mut columns = vec![vec![0.0; SAMPLES]; unknowns];
        for (node, share) in shares(problem.nodes, echo.height_dn) {
            for (k, time) in (0..SAMPLES).map(|k| (k, k as f64 - echo.position_samples)) {
                for (j, value) in problem.basis.at(time) {
                    columns[node * count + j][k] = share * echo.height_dn * value;
                }
            }
        }
        columns.iter_mut().for_each(|column| problem.whitener.whiten(column));
        for i in 0..unknowns {
            right[i] += dot(&columns[i], &target);
            for j in 0..unknowns {
                normal[i * unknowns + j] += dot(&columns[i], &columns[j]);
            }
        }
    }

    /// Echoes at the start, in the middle and at the end of a block, in noise of several orders.
    #[test]
    fn normal_equations_of_local_columns_are_those_of_whole_ones() {
        for coefficients in [&[][..], &[0.6], &[0.9, -0.5, 0.2], &[0.5, 0.1, -0.2, 0.1]] {
            let process = ArNoise::new(coefficients, 0.8).unwrap();
            let model = ChannelModel { full_scale_dn: 255.0, ..channel(&process, 4.4, 5.0) };
            let basis = Basis::new(4.4, 70.0);
            let mut problem =
                SolverProblem::new(&model, &basis, &NODES, Shape::of(&model).unwrap(), SAMPLES).unwrap();
            let (mut normal, mut right) = (problem.normal.clone(), problem.right.clone());
            let mut random = Random::new(4);
            for (height, place) in [(70.0, 3.3), (120.0, 15.1), (140.0, 30.7), (190.0, 54.2)] {
                let echo = pulse(height, place, 1.0);
                let values = analogue(&mut random, &process, SAMPLES, 5.0, 4.4, &[echo]);
                let samples = digitised(&values, 255);
                let block = Waveform { samples: &samples };
                let fitted = found(height, place);
                let single = Single {
                    block,
                    fitted,
                    offset_dn: 0.0,
                    chi_square: 57.0,
                    degrees_of_freedom: 57.0,
                    index: 0,
                };
                problem.add(&single);
                add_densely(&problem, &single, &mut normal, &mut right);
            }
            let scale = normal.iter().fold(0.0, |greatest: f64, value| greatest.max(value.abs()));
            let pairs = normal.iter().zip(&problem.normal).chain(right.iter().zip(&problem.right));
            let worst = pairs.map(|(dense, local)| (dense - local).abs()).fold(0.0, f64::max);
            assert!(scale > 1e3 && worst < 1e-9 * scale, "{coefficients:?}: {worst} of {scale}");
        }
    }
}
