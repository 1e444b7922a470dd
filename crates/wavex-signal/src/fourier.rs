//! Fourier transform of power-of-two length (Cooley and Tukey 1965), for tables computed once.

use std::f64::consts::TAU;
use std::sync::OnceLock;

/// A complex number: real and imaginary part.
pub(super) type Complex = [f64; 2];

/// Product of two complex numbers.
pub(super) fn times(a: Complex, b: Complex) -> Complex {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

/// Replaces `values` by `Σ_k values_k exp(sign 2πi jk/n)`, unscaled.
///
/// The length is a power of two; `sign` is 1 or -1.
pub(super) fn transform(values: &mut [Complex], sign: f64) {
    let n = values.len();
    debug_assert!(n.is_power_of_two());
    let shift = usize::BITS - n.trailing_zeros();
    for i in 1..n {
        let j = i.reverse_bits() >> shift;
        if i < j {
            values.swap(i, j);
        }
    }
    let roots = roots(n);
    let mut half = 1;
    while half < n {
        let stride = n / (2 * half);
        for pair in values.chunks_exact_mut(2 * half) {
            let (low, high) = pair.split_at_mut(half);
            for ((a, b), root) in low.iter_mut().zip(high).zip(roots.iter().step_by(stride)) {
                let turned = times(*b, [root[0], sign * root[1]]);
                *b = [a[0] - turned[0], a[1] - turned[1]];
                *a = [a[0] + turned[0], a[1] + turned[1]];
            }
        }
        half *= 2;
    }
}

/// `exp(2πi k/n)` for the first half of the circle, cached per power of two.
fn roots(n: usize) -> &'static [Complex] {
    static ROOTS: [OnceLock<Vec<Complex>>; usize::BITS as usize] =
        [const { OnceLock::new() }; usize::BITS as usize];
    ROOTS[n.trailing_zeros() as usize % ROOTS.len()].get_or_init(|| {
        let root = |k: usize| {
            let (sin, cos) = (TAU * k as f64 / n as f64).sin_cos();
            [cos, sin]
        };
        (0..n / 2).map(root).collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_and_back_and_a_pure_oscillation() {
        let n = 32;
        let wave = |k: usize| {
            let phase = TAU * 5.0 * k as f64 / n as f64;
            [phase.cos(), phase.sin()]
        };
        let mut values: Vec<Complex> = (0..n).map(wave).collect();
        transform(&mut values, -1.0);
        for (j, value) in values.iter().enumerate() {
            let exact = if j == 5 { n as f64 } else { 0.0 };
            assert!((value[0] - exact).abs() < 1e-12 && value[1].abs() < 1e-12, "{j}: {value:?}");
        }
        transform(&mut values, 1.0);
        for (k, value) in values.iter().enumerate() {
            assert!((value[0] / n as f64 - wave(k)[0]).abs() < 1e-14);
            assert!((value[1] / n as f64 - wave(k)[1]).abs() < 1e-14);
        }
        let mut single = [[3.0, 4.0]];
        transform(&mut single, 1.0);
        assert_eq!(single, [[3.0, 4.0]]);
    }
}
