//! Factors sixteen symmetric linear systems at once as `L D Lᵀ`.

use crate::simd::Simd;

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

#[cfg(test)]
mod tests {
    use nalgebra::{SMatrix, SVector};

    use super::*;
    use crate::simd::{Kernel, SimdLevel, Sixteen};
    use crate::simulated::Random;

    struct Solve {
        matrix: [[Sixteen; 6]; 6],
        side: [Sixteen; 6],
    }

    impl Kernel for Solve {
        type Output = ([Sixteen; 6], [Sixteen; 6]);

        fn run<S: Simd>(self, s: S) -> Self::Output {
            let factors = factor(s, self.matrix.map(|row| row.map(|v| s.load(&v))));
            let mut b = self.side.map(|v| s.load(&v));
            factors.solve(s, &mut b);
            let stored = |values: [S::V; 6]| {
                values.map(|v| {
                    let mut out = [0.0; 16];
                    s.store(v, &mut out);
                    out
                })
            };
            (stored(b), stored(factors.inverse_diagonal(s)))
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
            let (x, diagonal) = path.run(Solve { matrix, side });
            for (w, (a, b)) in systems.iter().enumerate() {
                let inverse = a.try_inverse().unwrap();
                let exact = inverse * b;
                for i in 0..6 {
                    assert!((f64::from(x[i][w]) - exact[i]).abs() < 1e-4, "{path:?} {w} {i}");
                    assert!((f64::from(diagonal[i][w]) - inverse[(i, i)]).abs() < 1e-5, "{path:?} {w} {i}");
                }
            }
        }
    }
}
