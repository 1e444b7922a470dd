//! Cholesky factor of a symmetric matrix with a band.
//!
//! Sums are added in a fixed order, so results are bit-identical on every processor.

use crate::simd::{Kernel, Simd, SimdLevel};

/// Values processed together.
pub(super) const LANES: usize = 8;
/// Rows subtracted together: the target is read and written once for all of them.
pub(super) const PANEL: usize = 4;

/// Cholesky factor by columns, each from its diagonal downwards, padded with zeros.
///
/// The diagonal holds the inverse of the factor's.
#[derive(Default)]
pub(super) struct BandFactor {
    stride: usize,
    /// Entries of each column.
    lengths: Vec<usize>,
    values: Vec<f64>,
}

impl BandFactor {
    /// Begins a matrix whose columns have at most `longest` entries.
    pub(super) fn begin(&mut self, longest: usize) {
        self.stride = (longest + PANEL + LANES).next_multiple_of(LANES);
        self.lengths.clear();
        self.values.clear();
    }

    /// Adds the next column of the matrix, from its diagonal downwards.
    ///
    /// Its last row is not above that of the previous column.
    pub(super) fn push(&mut self, column: impl Iterator<Item = f64>) {
        let first = self.values.len();
        self.values.extend(column);
        self.lengths.push(self.values.len() - first);
        self.values.resize(first + self.stride, 0.0);
    }

    /// Replaces the matrix by its factor; `false` if it is not positive definite.
    pub(super) fn factor(&mut self) -> bool {
        SimdLevel::best().processor().run(Factor(self))
    }

    /// Replaces `b` by `L⁻¹ b`.
    ///
    /// `b` is zero before `first`, and has [`LANES`] zeros after its last row.
    pub(super) fn half_solve(&self, first: usize, b: &mut [f64]) {
        SimdLevel::best().processor().run(HalfSolve { factor: self, first, b });
    }

    /// Replaces `b` by the solution of `L Lᵀ x = b`; `b` has [`LANES`] zeros after its last row.
    pub(super) fn solve(&self, b: &mut [f64]) {
        self.half_solve(0, b);
        SimdLevel::best().processor().run(BackSolve { factor: self, b });
    }

    /// Logarithm of the determinant of the matrix.
    pub(super) fn ln_determinant(&self) -> f64 {
        -2.0 * self.values.iter().step_by(self.stride).map(|inverse| libm::log(*inverse)).sum::<f64>()
    }
}

/// Subtracts `factor` times the source from the target, in whole vectors of the shorter.
#[inline(always)]
pub(super) fn subtract(target: &mut [f64], factor: f64, source: &[f64]) {
    let targets = target.as_chunks_mut::<LANES>().0;
    for (target, source) in targets.iter_mut().zip(source.as_chunks::<LANES>().0) {
        // A copy, because a loop over memory that may overlap is not vectorised.
        let mut rest = *target;
        for i in 0..LANES {
            rest[i] -= factor * source[i];
        }
        *target = rest;
    }
}

/// Subtracts `factors` times the sources from the target, in whole vectors of the shortest.
#[inline(always)]
pub(super) fn subtract_rows(target: &mut [f64], factors: [f64; PANEL], sources: [&[f64]; PANEL]) {
    let [a, b, c, d] = sources.map(|source| source.as_chunks::<LANES>().0);
    let targets = target.as_chunks_mut::<LANES>().0;
    for ((((target, a), b), c), d) in targets.iter_mut().zip(a).zip(b).zip(c).zip(d) {
        let mut sums = [0.0; LANES];
        for (source, factor) in [a, b, c, d].into_iter().zip(factors) {
            for i in 0..LANES {
                sums[i] += factor * source[i];
            }
        }
        for i in 0..LANES {
            target[i] -= sums[i];
        }
    }
}

/// `Σ a b` over the whole vectors of the shorter.
#[inline(always)]
pub(super) fn product(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; LANES];
    for (a, b) in a.as_chunks::<LANES>().0.iter().zip(b.as_chunks::<LANES>().0) {
        for i in 0..LANES {
            sums[i] += a[i] * b[i];
        }
    }
    ((sums[0] + sums[4]) + (sums[1] + sums[5])) + ((sums[2] + sums[6]) + (sums[3] + sums[7]))
}

struct Factor<'a>(&'a mut BandFactor);

impl Kernel for Factor<'_> {
    type Output = bool;

    #[inline(always)]
    fn run<S: Simd>(self, _: S) -> bool {
        let BandFactor { stride, lengths, values } = self.0;
        let stride = *stride;
        let mut rest = &mut values[..];
        for lengths in lengths.chunks(PANEL) {
            let (panel, below) = rest.split_at_mut(lengths.len() * stride);
            for c in 0..lengths.len() {
                let (column, others) = panel[c * stride..].split_at_mut(stride);
                if !(column[0] > 0.0 && column[0].is_finite()) {
                    return false;
                }
                let inverse = column[0].sqrt().recip();
                column.iter_mut().for_each(|value| *value *= inverse);
                column[0] = inverse;
                for (row, other) in (1..).zip(others.chunks_exact_mut(stride)) {
                    subtract(other, column[row], &column[row..]);
                }
            }
            // Rows of the panel's last column, counted from the first column.
            let end = lengths.len() - 1 + lengths[lengths.len() - 1];
            for (row, target) in (PANEL..end).zip(below.chunks_exact_mut(stride)) {
                let count = (end - row).next_multiple_of(LANES);
                let sources = std::array::from_fn(|c| &panel[c * stride + row - c..][..count]);
                subtract_rows(target, sources.map(|source| source[0]), sources);
            }
            rest = below;
        }
        true
    }
}

struct HalfSolve<'a> {
    factor: &'a BandFactor,
    first: usize,
    b: &'a mut [f64],
}

impl Kernel for HalfSolve<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let BandFactor { stride, lengths, values } = self.factor;
        for (c, column) in values.chunks_exact(*stride).enumerate().skip(self.first) {
            let value = self.b[c] * column[0];
            self.b[c] = value;
            let end = 1 + (lengths[c] - 1).next_multiple_of(LANES);
            subtract(&mut self.b[c + 1..], value, &column[1..end.min(*stride)]);
        }
    }
}

struct BackSolve<'a> {
    factor: &'a BandFactor,
    b: &'a mut [f64],
}

impl Kernel for BackSolve<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let BandFactor { stride, lengths, values } = self.factor;
        for (c, column) in values.chunks_exact(*stride).enumerate().rev() {
            let end = 1 + (lengths[c] - 1).next_multiple_of(LANES);
            let known = product(&column[1..end.min(*stride)], &self.b[c + 1..]);
            self.b[c] = (self.b[c] - known) * column[0];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of different reach, more than one panel; the same as the dense factor.
    #[test]
    fn factor_and_solution_are_those_of_the_dense_matrix() {
        const N: usize = 23;
        let last = |row: usize| (row + 3 + row % 7 / 5 * 9).min(N - 1);
        let ends: Vec<usize> = (0..N).map(|i| (0..=i).map(last).max().unwrap()).collect();
        let entry = |i: usize, j: usize| if i == j { 9.0 } else { 1.0 / (1.0 + (j - i) as f64) };
        let mut dense = vec![0.0; N * N];
        let mut band = BandFactor::default();
        band.begin(ends.iter().enumerate().map(|(i, end)| end + 1 - i).max().unwrap());
        for (i, &end) in ends.iter().enumerate() {
            band.push((i..=end).map(|j| entry(i, j)));
            (i..=end).for_each(|j| dense[j * N + i] = entry(i, j));
        }
        assert!(band.factor() && crate::cholesky::factor(&mut dense, N));
        let mut expected: Vec<f64> = (0..N).map(|i| (i as f64).sin()).collect();
        let mut solved = expected.clone();
        solved.resize(N + LANES, 0.0);
        band.solve(&mut solved);
        crate::cholesky::solve(&dense, N, &mut expected);
        assert!(solved.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-14));
        let ln_determinant: f64 = (0..N).map(|i| 2.0 * dense[i * N + i].ln()).sum();
        assert!((band.ln_determinant() - ln_determinant).abs() < 1e-12);
        band.begin(2);
        band.push([1.0, 2.0].into_iter());
        band.push([1.0].into_iter());
        assert!(!band.factor());
    }
}
