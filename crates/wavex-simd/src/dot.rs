//! Vectorised loops over doubles.
//!
//! The order of summation is explicit, so results are bit-identical on every processor.

use crate::{Kernel, Simd, SimdLevel};

/// Number of values processed together.
pub const AT_A_TIME: usize = 8;

/// `Σ a b` over the common length.
#[inline]
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    SimdLevel::best().processor().run(Dot { a, b })
}

struct Dot<'a> {
    a: &'a [f64],
    b: &'a [f64],
}

impl Kernel for Dot<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> f64 {
        let n = self.a.len().min(self.b.len());
        let (a, a_rest) = self.a[..n].as_chunks::<AT_A_TIME>();
        let (b, b_rest) = self.b[..n].as_chunks::<AT_A_TIME>();
        let mut sums = [0.0; AT_A_TIME];
        for (a, b) in a.iter().zip(b) {
            for i in 0..AT_A_TIME {
                sums[i] += a[i] * b[i];
            }
        }
        let mut sum = 0.0;
        for part in sums {
            sum += part;
        }
        for (a, b) in a_rest.iter().zip(b_rest) {
            sum += a * b;
        }
        sum
    }
}

/// Number of rows added at once.
pub const ROWS: usize = 8;

/// Adds weighted rows to each target, over the common length.
pub fn add_rows<const T: usize>(targets: [&mut [f64]; T], rows: [&[f64]; ROWS], weights: &[[f64; ROWS]; T]) {
    SimdLevel::best().processor().run(AddRows { targets, rows, weights });
}

struct AddRows<'a, const T: usize> {
    targets: [&'a mut [f64]; T],
    rows: [&'a [f64]; ROWS],
    weights: &'a [[f64; ROWS]; T],
}

impl<const T: usize> Kernel for AddRows<'_, T> {
    type Output = ();

    /// Reads each row once for all targets.
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let AddRows { targets, rows, weights } = self;
        let lengths = rows.iter().map(|row| row.len()).chain(targets.iter().map(|target| target.len()));
        let n = lengths.min().unwrap_or(0);
        let whole = n - n % AT_A_TIME;
        for k in (0..whole).step_by(AT_A_TIME) {
            let mut sums = [[0.0; AT_A_TIME]; T];
            for r in 0..ROWS {
                let row = &rows[r][k..k + AT_A_TIME];
                for t in 0..T {
                    for i in 0..AT_A_TIME {
                        sums[t][i] += weights[t][r] * row[i];
                    }
                }
            }
            for t in 0..T {
                for (value, sum) in targets[t][k..k + AT_A_TIME].iter_mut().zip(sums[t]) {
                    *value += sum;
                }
            }
        }
        for k in whole..n {
            for t in 0..T {
                let mut sum = 0.0;
                for r in 0..ROWS {
                    sum += weights[t][r] * rows[r][k];
                }
                targets[t][k] += sum;
            }
        }
    }
}

/// Replaces values from index `from` by `weight` times their prediction error.
///
/// The prediction uses the `N` preceding values, nearest first; `from` is at least `N`.
pub fn predict<const N: usize>(values: &mut [f64], from: usize, coefficients: &[f64; N], weight: f64) {
    SimdLevel::best().processor().run(Predict { values, from: from.max(N), coefficients, weight });
}

struct Predict<'a, const N: usize> {
    values: &'a mut [f64],
    from: usize,
    coefficients: &'a [f64; N],
    weight: f64,
}

impl<const N: usize> Kernel for Predict<'_, N> {
    type Output = ();

    /// Runs backwards, so that the preceding values are still unchanged.
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let Predict { values, from, coefficients, weight } = self;
        let mut end = values.len();
        while end >= from + AT_A_TIME {
            let start = end - AT_A_TIME;
            let mut predicted = [0.0; AT_A_TIME];
            for (j, coefficient) in coefficients.iter().enumerate() {
                let before = &values[start - 1 - j..start - 1 - j + AT_A_TIME];
                for i in 0..AT_A_TIME {
                    predicted[i] += coefficient * before[i];
                }
            }
            for (value, predicted) in values[start..end].iter_mut().zip(predicted) {
                *value = (*value - predicted) * weight;
            }
            end = start;
        }
        while end > from {
            end -= 1;
            let mut predicted = 0.0;
            for (j, coefficient) in coefficients.iter().enumerate() {
                predicted += coefficient * values[end - 1 - j];
            }
            values[end] = (values[end] - predicted) * weight;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dots_and_rows_are_what_their_formulas_say() {
        for n in [0, 3, 8, 29] {
            let row = |k: f64| (0..n).map(|i| k + i as f64).collect::<Vec<f64>>();
            let expected: f64 = row(1.0).iter().zip(row(2.0)).map(|(a, b)| a * b).sum();
            assert_eq!(dot(&row(1.0), &row(2.0)), expected, "whole numbers are exact");
            let (mut plain, mut doubled) = (row(0.0), row(1.0));
            let rows: [Vec<f64>; ROWS] = std::array::from_fn(|r| row(r as f64));
            let weights = [1.0, 2.0, -1.0, 0.5, 0.0, 1.0, 1.0, -2.0];
            add_rows(
                [&mut plain, &mut doubled],
                rows.each_ref().map(Vec::as_slice),
                &[weights, weights.map(|w| 2.0 * w)],
            );
            for i in 0..n {
                let sum = -1.5 + 2.5 * i as f64;
                assert_eq!([plain[i], doubled[i]], [i as f64 + sum, 1.0 + i as f64 + 2.0 * sum]);
            }
        }
    }

    #[test]
    fn predictions_use_the_values_before() {
        let values: Vec<f64> = (0..30).map(|i| f64::from(i * i % 7)).collect();
        for from in [2, 5, 13, 29] {
            let mut errors = values.clone();
            predict(&mut errors, from, &[0.5, -0.25], 2.0);
            for k in 0..30 {
                let predicted = if k < from { 0.0 } else { 0.5 * values[k - 1] - 0.25 * values[k - 2] };
                let expected = if k < from { values[k] } else { 2.0 * (values[k] - predicted) };
                assert_eq!(errors[k], expected, "{from} {k}");
            }
        }
    }
}
