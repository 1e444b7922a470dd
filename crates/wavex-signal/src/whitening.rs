//! Exact whitening of a block in stationary autoregressive noise, with gaps.
//!
//! Applies `L⁻¹ y`, with `L` the Cholesky factor of the noise covariance, in time linear in the
//! block length: each sample less its prediction from the earlier used samples, over the standard
//! deviation of the prediction error. The predictor is a Kalman filter (1960) with the last `p`
//! values of the noise as state. It starts with the stationary covariance, so the first rows are
//! those of the Durbin–Levinson recursion. An unused sample has no update, so the rows after a gap
//! are those of the exact covariance sub-matrix.

use std::ops::Range;

use wavex_simd::dot::predict;

use crate::noise::{ArNoise, MAX_ORDER};

/// Row of one sample: inverse SD of its prediction error (0 if unused), and state correction.
#[derive(Debug, Clone, Copy, Default)]
struct WhiteningRow {
    weight: f64,
    gain: [f64; MAX_ORDER],
    /// Whether the preceding `order` samples are all used; they alone then determine the
    /// prediction.
    is_steady: bool,
}

/// Whitening matrix of a block, `W = L⁻¹`, for one noise model and one set of used samples.
#[derive(Debug, Clone)]
pub struct Whitener {
    noise: ArNoise,
    /// Size of the predictor's state: the order, at least one.
    states: usize,
    used: Vec<bool>,
    rows: Vec<WhiteningRow>,
    /// From this sample on, all samples and the preceding `order` samples are used.
    steady: usize,
}

impl Whitener {
    /// Creates a whitener; blocks longer than `capacity` samples allocate.
    pub fn new(noise: ArNoise, capacity: usize) -> Whitener {
        let states = noise.order().max(1);
        Whitener {
            noise,
            states,
            used: Vec::with_capacity(capacity),
            rows: Vec::with_capacity(capacity),
            steady: 0,
        }
    }

    /// Noise model.
    pub fn noise(&self) -> &ArNoise {
        &self.noise
    }

    /// Used samples of the block.
    pub fn used(&self) -> &[bool] {
        &self.used
    }

    /// Number of used samples of the block.
    pub(crate) fn used_count(&self) -> usize {
        self.used.iter().filter(|&&used| used).count()
    }

    /// Prepares for a block of `used.len()` samples with the marked ones used.
    ///
    /// Returns whether the set of used samples changed.
    pub fn set_used(&mut self, used: &[bool]) -> bool {
        if self.used == used {
            return false;
        }
        self.used.clear();
        self.used.extend_from_slice(used);
        self.rows.clear();
        let mut covariance = self.stationary_covariance();
        let mut run = 0;
        for &used in &self.used {
            let mut row = if used { update(&mut covariance, self.states) } else { WhiteningRow::default() };
            row.is_steady = used && run >= self.noise.order();
            run = if used { run + 1 } else { 0 };
            self.rows.push(row);
            self.predict_covariance(&mut covariance);
        }
        self.steady = self.rows.iter().rposition(|row| !row.is_steady).map_or(0, |last| last + 1);
        true
    }

    /// Replaces `values` by `W values`; unused samples become zero.
    ///
    /// `values` has the length of the block and is zero before index `first`.
    pub(crate) fn whiten_from(&self, first: usize, values: &mut [f64]) {
        self.whiten_part(first.min(values.len())..values.len(), values);
    }

    /// As [`Whitener::whiten_from`] for values that are zero outside of `part`.
    ///
    /// Returns the index after the last value that can differ from zero; values before `part` stay zero.
    pub(crate) fn whiten_part(&self, part: Range<usize>, values: &mut [f64]) -> usize {
        match self.states {
            1 => self.filter::<1>(part, values),
            2 => self.filter::<2>(part, values),
            3 => self.filter::<3>(part, values),
            4 => self.filter::<4>(part, values),
            _ => self.filter::<MAX_ORDER>(part, values),
        }
    }

    /// Filter for a state of at most `N` values.
    fn filter<const N: usize>(&self, part: Range<usize>, values: &mut [f64]) -> usize {
        let mut coefficients = [0.0; N];
        coefficients.iter_mut().zip(self.noise.coefficients()).for_each(|(c, known)| *c = *known);
        let predicted = |past: &[f64; N]| -> f64 {
            let mut next = 0.0;
            for j in 0..N {
                next += coefficients[j] * past[j];
            }
            next
        };
        // Derivatives are zero outside of their pulse: the rest of a long block need not be filtered.
        let given = &values[part.clone()];
        let is_value = |value: &f64| *value != 0.0;
        let Some((first, last)) = given.iter().position(is_value).zip(given.iter().rposition(is_value))
        else {
            return part.start;
        };
        let (first, last) = (part.start + first, part.start + last);
        // The steady part comes first: it reads the preceding values before the loop below replaces them.
        let steady = self.steady.max(first).max(N);
        let end = (last + 1 + N).min(values.len());
        if let Some(row) = self.rows.get(steady).filter(|_| steady < end) {
            predict(&mut values[..end], steady, &coefficients, row.weight);
        }
        // Last values: of the block in the steady state, otherwise of the predictor.
        let mut past = [0.0; N];
        for (k, (value, row)) in values.iter_mut().zip(&self.rows).enumerate().take(steady).skip(first) {
            // All later values are 0 already.
            if k > last && past.iter().all(|past| *past == 0.0) {
                return end.max(k);
            }
            let next = predicted(&past);
            let error = *value - next;
            past.copy_within(..N - 1, 1);
            past[0] = next;
            if row.is_steady {
                past[0] = *value;
            } else {
                past.iter_mut().zip(&row.gain).for_each(|(value, gain)| *value += gain * error);
            }
            *value = error * row.weight;
        }
        end.max(steady.min(values.len()))
    }

    /// Replaces `values` by `W values`; unused samples become zero.
    pub fn whiten(&self, values: &mut [f64]) {
        self.whiten_from(0, values);
    }

    /// Replaces `values` by `Wᵀ values`; after [`Whitener::whiten`] they are `Σ⁻¹ y` on the used
    /// samples.
    pub(crate) fn whiten_transposed(&self, values: &mut [f64]) {
        let mut costate = [0.0; MAX_ORDER];
        for (value, row) in values.iter_mut().zip(&self.rows).rev() {
            self.predict_transposed(&mut costate);
            let back: f64 = row.gain.iter().zip(&costate).take(self.states).map(|(g, c)| g * c).sum();
            *value = row.weight * *value + back;
            costate[0] -= *value;
        }
    }

    fn stationary_covariance(&self) -> [[f64; MAX_ORDER]; MAX_ORDER] {
        let mut lags = [0.0; MAX_ORDER];
        self.noise.autocovariance_into(&mut lags[..self.states]);
        let mut covariance = [[0.0; MAX_ORDER]; MAX_ORDER];
        for i in 0..self.states {
            for j in 0..self.states {
                covariance[i][j] = lags[i.abs_diff(j)];
            }
        }
        covariance
    }

    fn predict_transposed(&self, costate: &mut [f64; MAX_ORDER]) {
        let first = costate[0];
        costate.copy_within(1..self.states, 0);
        costate[self.states - 1] = 0.0;
        for (c, coefficient) in costate.iter_mut().zip(self.noise.coefficients()) {
            *c += coefficient * first;
        }
    }

    fn predict_covariance(&self, covariance: &mut [[f64; MAX_ORDER]; MAX_ORDER]) {
        let n = self.states;
        let mut cross = [0.0; MAX_ORDER];
        for (i, value) in cross.iter_mut().enumerate().take(n) {
            *value = self.noise.coefficients().iter().zip(covariance.iter()).map(|(c, row)| c * row[i]).sum();
        }
        let known: f64 = self.noise.coefficients().iter().zip(&cross).map(|(c, v)| c * v).sum();
        // Backwards: each element is read before it is overwritten.
        for i in (1..n).rev() {
            for j in (1..n).rev() {
                covariance[i][j] = covariance[i - 1][j - 1];
            }
        }
        for i in 1..n {
            covariance[0][i] = cross[i - 1];
            covariance[i][0] = cross[i - 1];
        }
        covariance[0][0] = known + self.noise.innovation_variance();
    }
}

/// Updates the state covariance with a used sample and returns its row.
fn update(covariance: &mut [[f64; MAX_ORDER]; MAX_ORDER], states: usize) -> WhiteningRow {
    let first = covariance[0];
    let mut row = WhiteningRow { weight: 1.0 / first[0].sqrt(), gain: [0.0; MAX_ORDER], is_steady: false };
    for (i, line) in covariance.iter_mut().enumerate().take(states) {
        row.gain[i] = first[i] / first[0];
        for (value, known) in line.iter_mut().zip(&first).take(states) {
            *value -= row.gain[i] * known;
        }
    }
    row
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    use super::*;

    /// Covariance of the used samples.
    fn dense_covariance(noise: &ArNoise, used: &[bool]) -> DMatrix<f64> {
        let mut lags = vec![0.0; used.len()];
        noise.autocovariance_into(&mut lags);
        let kept: Vec<usize> = (0..used.len()).filter(|&i| used[i]).collect();
        DMatrix::from_fn(kept.len(), kept.len(), |i, j| lags[kept[i].abs_diff(kept[j])])
    }

    fn check_against_cholesky(coefficients: &[f64], used: &[bool], values: &[f64]) {
        let noise = ArNoise::new(coefficients, 0.8).unwrap();
        let covariance = dense_covariance(&noise, used);
        let mut whitener = Whitener::new(noise, used.len());
        whitener.set_used(used);
        let mut white = values.to_vec();
        whitener.whiten(&mut white);

        let kept: Vec<usize> = (0..used.len()).filter(|&i| used[i]).collect();
        let picked = DVector::from_iterator(kept.len(), kept.iter().map(|&i| values[i]));
        let factor = covariance.clone().cholesky().unwrap();
        let dense = factor.l().solve_lower_triangular(&picked).unwrap();
        let solved = factor.solve(&picked);
        let mut back = white.clone();
        whitener.whiten_transposed(&mut back);
        for (row, &i) in kept.iter().enumerate() {
            assert!((white[i] - dense[row]).abs() < 1e-9, "whitened sample {i}: {} {}", white[i], dense[row]);
            assert!((back[i] - solved[row]).abs() < 1e-8, "solved sample {i}: {} {}", back[i], solved[row]);
        }
        for i in (0..used.len()).filter(|&i| !used[i]) {
            assert_eq!(white[i], 0.0);
            assert_eq!(back[i], 0.0);
        }
    }

    #[test]
    fn whitening_is_the_inverse_of_choleskys_factor() {
        let values: Vec<f64> = (0..40).map(|k| (k as f64 * 1.7).sin() * 3.0 + k as f64 * 0.1).collect();
        for coefficients in [&[][..], &[0.6], &[0.9, -0.4], &[0.9, -0.5, 0.2], &[0.5, 0.1, -0.2, 0.1]] {
            check_against_cholesky(coefficients, &[true; 40], &values);
            let mut gaps = [true; 40];
            gaps[..2].fill(false);
            gaps[9] = false;
            gaps[11] = false;
            gaps[20..29].fill(false);
            gaps[39] = false;
            check_against_cholesky(coefficients, &gaps, &values);
        }
    }

    /// `W Σ Wᵀ` is the identity on the used samples.
    #[test]
    fn the_covariance_of_whitened_noise_is_the_identity() {
        let noise = ArNoise::new(&[0.9, -0.5, 0.2], 1.3).unwrap();
        let used: Vec<bool> = (0..30).map(|k| !(12..17).contains(&k)).collect();
        let mut lags = vec![0.0; 30];
        noise.autocovariance_into(&mut lags);
        let mut whitener = Whitener::new(noise, 30);
        whitener.set_used(&used);
        let mut product = DMatrix::from_fn(30, 30, |i, j| lags[usize::abs_diff(i, j)]);
        for _ in 0..2 {
            for mut column in product.column_iter_mut() {
                whitener.whiten(column.as_mut_slice());
            }
            product = product.transpose();
        }
        for i in 0..30 {
            for j in 0..30 {
                let exact = if i == j && used[i] { 1.0 } else { 0.0 };
                assert!((product[(i, j)] - exact).abs() < 1e-12, "{i} {j}: {}", product[(i, j)]);
            }
        }
    }

    #[test]
    fn a_column_that_starts_late_may_be_whitened_from_there() {
        let mut whitener = Whitener::new(ArNoise::new(&[0.7, -0.2], 1.0).unwrap(), 20);
        assert!(whitener.set_used(&[true; 20]));
        assert!(!whitener.set_used(&[true; 20]));
        let mut whole: Vec<f64> = (0..20).map(|k| if k < 8 { 0.0 } else { k as f64 }).collect();
        let mut late = whole.clone();
        whitener.whiten(&mut whole);
        whitener.whiten_from(8, &mut late);
        assert_eq!(whole, late);
    }

    #[test]
    fn a_pulse_within_a_block_is_whitened_as_by_its_whole_length() {
        let mut used = [true; 60];
        for gap in [5..7, 22..24, 40..45] {
            used[gap].fill(false);
        }
        for pulse in [0..3, 10..12, 20..26, 38..50, 57..60] {
            let mut values = [0.0; 60];
            pulse.for_each(|k| values[k] = 1.0 + k as f64);
            for used in [used, [true; 60]] {
                check_against_cholesky(&[0.7, -0.2], &used, &values);
            }
        }
    }

    proptest! {
        #[test]
        fn any_choice_of_samples_is_whitened_exactly(
            used in prop::collection::vec(any::<bool>(), 1..25),
            reflection in prop::collection::vec(-0.9f64..0.9, 0..5),
            values in prop::collection::vec(-50.0f64..50.0, 25),
        ) {
            let coefficients = crate::simulated::coefficients_from_reflection(&reflection);
            check_against_cholesky(&coefficients, &used, &values[..used.len()]);
        }
    }
}
