//! Factors sixteen symmetric linear systems at once as `L D Lᵀ`.

use wavex_simd::Simd;

/// Factors of sixteen positive definite matrices of order `P`.
///
/// `lower` holds the unit triangle below the diagonal.
pub(super) struct Factors<V, const P: usize> {
    lower: [[V; P]; P],
    inverse_pivots: [V; P],
}

/// Factors matrices given by their lower triangles.
#[inline(always)]
pub(super) fn factor<S: Simd, const P: usize>(s: S, mut a: [[S::V; P]; P]) -> Factors<S::V, P> {
    let one = s.splat(1.0);
    let mut inverse_pivots = [one; P];
    for j in 0..P {
        // Right-looking: each finished column is eliminated from all later ones at once.
        let inverse = s.div(one, a[j][j]);
        inverse_pivots[j] = inverse;
        let mut scaled = [one; P];
        for i in j + 1..P {
            scaled[i] = s.mul(a[i][j], inverse);
        }
        for i in j + 1..P {
            for k in j + 1..=i {
                a[i][k] = s.fnma(scaled[i], a[k][j], a[i][k]);
            }
        }
        for i in j + 1..P {
            a[i][j] = scaled[i];
        }
    }
    Factors { lower: a, inverse_pivots }
}

impl<V: Copy, const P: usize> Factors<V, P> {
    /// Replaces the right side by `L⁻¹ b`.
    #[inline(always)]
    fn forward<S: Simd<V = V>>(&self, s: S, b: &mut [V; P]) {
        for j in 0..P {
            for i in j + 1..P {
                b[i] = s.fnma(self.lower[i][j], b[j], b[i]);
            }
        }
    }

    /// Part of the sum of squares explained by each unknown beyond earlier ones.
    ///
    /// The second value has the sign of the unknown's contribution.
    #[inline(always)]
    pub(super) fn explained<S: Simd<V = V>>(&self, s: S, mut b: [V; P]) -> [(V, V); P] {
        self.forward(s, &mut b);
        let mut out = [(b[0], b[0]); P];
        for ((value, inverse), out) in b.iter().zip(&self.inverse_pivots).zip(&mut out) {
            *out = (s.mul(s.mul(*value, *value), *inverse), *value);
        }
        out
    }

    /// Replaces the right side by the solution.
    #[inline(always)]
    pub(super) fn solve<S: Simd<V = V>>(&self, s: S, b: &mut [V; P]) {
        self.forward(s, b);
        for (value, inverse) in b.iter_mut().zip(&self.inverse_pivots) {
            *value = s.mul(*value, *inverse);
        }
        for i in (0..P).rev() {
            for j in 0..i {
                b[j] = s.fnma(self.lower[i][j], b[i], b[j]);
            }
        }
    }

    /// Returns the diagonal of the inverse.
    #[inline(always)]
    pub(super) fn inverse_diagonal<S: Simd<V = V>>(&self, s: S) -> [V; P] {
        let zero = s.splat(0.0);
        let mut diagonal = [zero; P];
        for c in 0..P {
            // Column c of L⁻¹: sums its squares divided by the pivots.
            let mut column = [zero; P];
            column[c] = s.splat(1.0);
            for j in c..P {
                diagonal[c] = s.fma(s.mul(column[j], column[j]), self.inverse_pivots[j], diagonal[c]);
                for i in j + 1..P {
                    column[i] = s.fnma(self.lower[i][j], column[j], column[i]);
                }
            }
        }
        diagonal
    }
}

/// Factors of sixteen matrices of order at most `N`, as packed lower triangles of `PACKED` values.
pub(super) struct PackedFactors<V, const N: usize, const PACKED: usize> {
    /// The matrices before [`PackedFactors::factor`], the unit triangles below the diagonal after it.
    pub(super) lower: [V; PACKED],
    /// By row, the first column that is not 0 in all matrices; at most the row.
    pub(super) first: [usize; N],
    inverse_pivots: [V; N],
}

impl<V: Copy, const N: usize, const PACKED: usize> PackedFactors<V, N, PACKED> {
    #[inline(always)]
    pub(super) fn none(zero: V) -> PackedFactors<V, N, PACKED> {
        const { assert!(PACKED == N * (N + 1) / 2) };
        PackedFactors { lower: [zero; PACKED], first: [0; N], inverse_pivots: [zero; N] }
    }

    /// Index of the first element of a row of the triangle.
    #[inline(always)]
    const fn row(row: usize) -> usize {
        row * (row + 1) / 2
    }

    /// Factors the matrices of order `n` in `lower`.
    #[inline(always)]
    pub(super) fn factor<S: Simd<V = V>>(&mut self, s: S, n: usize) {
        for i in 0..n.min(N) {
            let (above, from_i) = self.lower.split_at_mut(Self::row(i));
            let first = self.first[i];
            // Row i times the pivots: `L D`.
            for j in first..i {
                let of_j = &above[Self::row(j)..];
                let mut value = from_i[j];
                for k in first.max(self.first[j])..j {
                    value = s.fnma(from_i[k], of_j[k], value);
                }
                from_i[j] = value;
            }
            let mut pivot = from_i[i];
            for j in first..i {
                let scaled = s.mul(from_i[j], self.inverse_pivots[j]);
                pivot = s.fnma(scaled, from_i[j], pivot);
                from_i[j] = scaled;
            }
            self.inverse_pivots[i] = s.div(s.splat(1.0), pivot);
        }
    }

    /// Replaces the right side by the solution; returns the sum of squares that it explains.
    #[inline(always)]
    pub(super) fn solve<S: Simd<V = V>>(&self, s: S, n: usize, b: &mut [V; N]) -> V {
        let mut explained = s.splat(0.0);
        for i in 0..n.min(N) {
            let (row, first) = (&self.lower[Self::row(i)..][..i], self.first[i]);
            let mut value = b[i];
            for (&lower, &b) in row[first..].iter().zip(&b[first..]) {
                value = s.fnma(lower, b, value);
            }
            b[i] = value;
        }
        for (value, &inverse) in b[..n].iter_mut().zip(&self.inverse_pivots) {
            let scaled = s.mul(*value, inverse);
            explained = s.fma(scaled, *value, explained);
            *value = scaled;
        }
        for i in (0..n.min(N)).rev() {
            let solved = b[i];
            let first = self.first[i];
            for (value, &lower) in b[first..i].iter_mut().zip(&self.lower[Self::row(i) + first..]) {
                *value = s.fnma(lower, solved, *value);
            }
        }
        explained
    }

    /// Returns the diagonal of the inverse.
    #[inline(always)]
    pub(super) fn inverse_diagonal<S: Simd<V = V>>(&self, s: S, n: usize) -> [V; N] {
        let zero = s.splat(0.0);
        let mut diagonal = [zero; N];
        for c in 0..n.min(N) {
            // Column c of L⁻¹: sums its squares divided by the pivots.
            let mut column = [zero; N];
            column[c] = s.splat(1.0);
            for i in c..n.min(N) {
                let row = &self.lower[Self::row(i)..];
                let mut value = column[i];
                for k in c.max(self.first[i])..i {
                    value = s.fnma(row[k], column[k], value);
                }
                column[i] = value;
                diagonal[c] = s.fma(s.mul(value, value), self.inverse_pivots[i], diagonal[c]);
            }
        }
        diagonal
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{SMatrix, SVector};

    use super::*;
    use crate::simulated::Random;
    use wavex_simd::{Kernel, SimdLevel, Sixteen};

    struct Solve {
        matrix: [[Sixteen; 6]; 6],
        side: [Sixteen; 6],
    }

    impl Kernel for Solve {
        /// Solution and diagonal of the inverse, by either form.
        type Output = [([Sixteen; 6], [Sixteen; 6]); 2];

        fn run<S: Simd>(self, s: S) -> Self::Output {
            let factors = factor(s, self.matrix.map(|row| row.map(|v| s.load(&v))));
            let mut b = self.side.map(|v| s.load(&v));
            factors.solve(s, &mut b);
            let mut packed = PackedFactors::<S::V, 8, 36>::none(s.splat(0.0));
            for i in 0..6 {
                for j in 0..=i {
                    packed.lower[i * (i + 1) / 2 + j] = s.load(&self.matrix[i][j]);
                }
            }
            packed.factor(s, 6);
            let mut of_packed = [s.splat(0.0); 8];
            of_packed[..6].copy_from_slice(&self.side.map(|v| s.load(&v)));
            packed.solve(s, 6, &mut of_packed);
            let diagonal = packed.inverse_diagonal(s, 6);
            let stored = |values: [S::V; 6]| {
                values.map(|v| {
                    let mut out = [0.0; 16];
                    s.store(v, &mut out);
                    out
                })
            };
            let first = |values: [S::V; 8]| std::array::from_fn(|i| values[i]);
            [
                (stored(b), stored(factors.inverse_diagonal(s))),
                (stored(first(of_packed)), stored(first(diagonal))),
            ]
        }
    }

    /// Solution and diagonal of the inverse with the first columns given, and without.
    struct Banded {
        matrix: [[Sixteen; 6]; 6],
        first: [usize; 8],
    }

    impl Kernel for Banded {
        type Output = [Sixteen; 12];

        fn run<S: Simd>(self, s: S) -> Self::Output {
            let mut factors = PackedFactors::<S::V, 8, 36>::none(s.splat(0.0));
            factors.first = self.first;
            for i in 0..6 {
                for j in 0..=i {
                    factors.lower[i * (i + 1) / 2 + j] = s.load(&self.matrix[i][j]);
                }
            }
            factors.factor(s, 6);
            let mut b = [s.splat(1.0); 8];
            factors.solve(s, 6, &mut b);
            let diagonal = factors.inverse_diagonal(s, 6);
            std::array::from_fn(|i| {
                let mut out = [0.0; 16];
                s.store(if i < 6 { b[i] } else { diagonal[i - 6] }, &mut out);
                out
            })
        }
    }

    #[test]
    fn a_band_gives_what_its_zeros_give() {
        let mut random = Random::new(6);
        let first = [0, 0, 1, 1, 3, 3, 0, 0];
        let mut matrix = [[[0.0; 16]; 6]; 6];
        for (i, row) in matrix.iter_mut().enumerate() {
            for value in &mut row[first[i]..i] {
                *value = std::array::from_fn(|_| random.normal() as f32);
            }
            row[i] = [9.0; 16];
        }
        for path in SimdLevel::ALL.into_iter().filter(|path| path.is_available()) {
            let [banded, full] = [first, [0; 8]].map(|first| path.run(Banded { matrix, first }));
            assert_eq!(banded, full, "{path:?}");
        }
    }

    #[test]
    fn sixteen_systems_are_solved_as_nalgebra_solves_them() {
        let mut random = Random::new(5);
        let mut systems = Vec::new();
        for _ in 0..16 {
            let root = SMatrix::<f64, 6, 6>::from_fn(|_, _| random.normal());
            systems.push((
                root.transpose() * root + SMatrix::identity(),
                SVector::<f64, 6>::from_fn(|_, _| random.normal()),
            ));
        }
        let lanes = |value: &dyn Fn(usize) -> f64| -> Sixteen { std::array::from_fn(|w| value(w) as f32) };
        let matrix = std::array::from_fn(|i| std::array::from_fn(|j| lanes(&|w| systems[w].0[(i, j)])));
        let side = std::array::from_fn(|i| lanes(&|w| systems[w].1[i]));
        for path in SimdLevel::ALL {
            for (x, diagonal) in path.run(Solve { matrix, side }) {
                for (w, (a, b)) in systems.iter().enumerate() {
                    let inverse = a.try_inverse().unwrap();
                    let exact = inverse * b;
                    for i in 0..6 {
                        assert!((f64::from(x[i][w]) - exact[i]).abs() < 1e-4, "{path:?} {w} {i}");
                        assert!(
                            (f64::from(diagonal[i][w]) - inverse[(i, i)]).abs() < 1e-5,
                            "{path:?} {w} {i}"
                        );
                    }
                }
            }
        }
    }
}
