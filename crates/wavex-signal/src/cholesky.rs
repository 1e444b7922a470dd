//! Cholesky factorisation in place, for small square matrices stored by rows.

/// Replaces the lower triangle of a matrix by its Cholesky factor.
///
/// The matrix is symmetric, `n` by `n`, and `L Lᵀ = A`.
///
/// The upper triangle is neither read nor written. Returns `false` if the matrix is not positive
/// definite; its contents are then undefined.
pub(super) fn factor(matrix: &mut [f64], n: usize) -> bool {
    for j in 0..n {
        for i in j..n {
            let (above, row_i) = matrix.split_at_mut(i * n);
            let row_j = if i == j { &row_i[..j] } else { &above[j * n..j * n + j] };
            let known: f64 = row_i[..j].iter().zip(row_j).map(|(a, b)| a * b).sum();
            let rest = row_i[j] - known;
            if i == j {
                if !(rest > 0.0 && rest.is_finite()) {
                    return false;
                }
                matrix[j * n + j] = rest.sqrt();
            } else {
                matrix[i * n + j] = rest / matrix[j * n + j];
            }
        }
    }
    true
}

/// Replaces `b` by the solution of `L Lᵀ x = b`.
pub(super) fn solve(factor: &[f64], n: usize, b: &mut [f64]) {
    for i in 0..n {
        let known: f64 = factor[i * n..i * n + i].iter().zip(b.iter()).map(|(l, x)| l * x).sum();
        b[i] = (b[i] - known) / factor[i * n + i];
    }
    for i in (0..n).rev() {
        let known: f64 = (i + 1..n).map(|k| factor[k * n + i] * b[k]).sum();
        b[i] = (b[i] - known) / factor[i * n + i];
    }
}

/// Writes the inverse of `L Lᵀ` to the `n` by `n` matrix `inverse`.
pub(super) fn invert(factor: &[f64], n: usize, inverse: &mut [f64]) {
    for (i, row) in inverse.chunks_exact_mut(n).take(n).enumerate() {
        row.fill(0.0);
        row[i] = 1.0;
        solve(factor, n, row);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factor_solution_and_inverse_of_a_small_matrix() {
        // L = [[2,0,0],[1,3,0],[-1,0.5,1]]
        let matrix = [4.0, 0.0, 0.0, 2.0, 10.0, 0.0, -2.0, 0.5, 2.25];
        let mut l = matrix;
        assert!(factor(&mut l, 3));
        assert_eq!([l[0], l[3], l[4], l[6], l[7], l[8]], [2.0, 1.0, 3.0, -1.0, 0.5, 1.0]);
        let mut x = [4.0 + 4.0 - 6.0, 2.0 + 20.0 + 1.5, -2.0 + 1.0 + 6.75]; // A (1, 2, 3)
        solve(&l, 3, &mut x);
        for (got, exact) in x.iter().zip([1.0, 2.0, 3.0]) {
            assert!((got - exact).abs() < 1e-14);
        }
        let mut inverse = [0.0; 9];
        invert(&l, 3, &mut inverse);
        for i in 0..3 {
            for j in 0..3 {
                let a = |r: usize, c: usize| matrix[r.max(c) * 3 + r.min(c)];
                let product: f64 = (0..3).map(|k| a(i, k) * inverse[k * 3 + j]).sum();
                assert!((product - if i == j { 1.0 } else { 0.0 }).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn what_is_not_positive_definite_is_refused() {
        assert!(!factor(&mut [1.0, 0.0, 2.0, 1.0], 2));
        assert!(!factor(&mut [0.0], 1));
        assert!(!factor(&mut [f64::NAN], 1));
    }
}
