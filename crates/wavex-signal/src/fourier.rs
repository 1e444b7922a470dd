//! Fourier transform of power-of-two length (Cooley and Tukey 1965), for tables computed once.

use std::f64::consts::TAU;
use std::sync::OnceLock;

use wavex_simd::{Kernel, Simd, SimdLevel};

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

/// Evaluates real Fourier series at `P` phases of each sample.
///
/// The frequencies of a series are low compared with `P` per sample. One transform of a value per
/// sample and phase is therefore `P` transforms of a value per sample, in lock-step.
#[derive(Debug, Clone)]
pub(super) struct Synthesis<const P: usize> {
    /// Period, a power of two.
    samples: usize,
    /// Real and imaginary part of `exp(2πi j p/(P samples))` of each term `j`, by phase `p`.
    turns: Vec<[[f64; P]; 2]>,
}

/// Values of a series: row `k` has the times `k + p/P`, in samples.
pub(super) type ByPhase<const P: usize> = Vec<[f64; P]>;

impl<const P: usize> Synthesis<P> {
    /// For series of at most `terms` terms.
    pub(super) fn new(samples: usize, terms: usize) -> Synthesis<P> {
        let steps = P * samples;
        let roots = roots(steps);
        let turn = |step: usize| match roots.get(step % steps) {
            Some(root) => *root,
            None => roots[step % steps - roots.len()].map(|part| -part),
        };
        let of_term = |j: usize| [0, 1].map(|part| std::array::from_fn(|p| turn(j * p)[part]));
        Synthesis { samples, turns: (0..terms).map(of_term).collect() }
    }

    /// Angular frequency of a term, radians per sample.
    pub(super) fn omega(&self, j: usize) -> f64 {
        TAU * j as f64 / self.samples as f64
    }

    /// Two series `Σ_j c_j exp(2πi jt/samples)`, with the conjugates of the terms at `-j`.
    ///
    /// `terms` are the `c_j` of both.
    pub(super) fn of(&self, terms: &[[Complex; 2]]) -> [ByPhase<P>; 2] {
        let mut parts = [vec![[0.0; P]; self.samples], vec![[0.0; P]; self.samples]];
        let [re, im] = &mut parts;
        SimdLevel::best().processor().run(Transforms { re, im, terms, turns: &self.turns });
        parts
    }
}

/// `P` transforms in lock-step.
struct Transforms<'a, const P: usize> {
    re: &'a mut [[f64; P]],
    im: &'a mut [[f64; P]],
    terms: &'a [[Complex; 2]],
    turns: &'a [[[f64; P]; 2]],
}

impl<const P: usize> Kernel for Transforms<'_, P> {
    type Output = ();

    /// One complex transform gives `f + i g`: its term is `a + i b` at `j`, and `a* + i b*` at `-j`.
    #[inline(always)]
    fn run<S: Simd>(self, _: S) {
        let Transforms { re, im, terms, turns } = self;
        let n = re.len();
        let place = |k: usize| ((k % n) << 1).reverse_bits() >> n.leading_zeros();
        for (j, ([a, b], [cos, sin])) in terms.iter().zip(turns).enumerate() {
            let (at, mirrored) = (place(j), place(n - j % n));
            let turned = |c: &Complex| -> [[f64; P]; 2] {
                [
                    std::array::from_fn(|p| c[0] * cos[p] - c[1] * sin[p]),
                    std::array::from_fn(|p| c[0] * sin[p] + c[1] * cos[p]),
                ]
            };
            let (a, b) = (turned(a), turned(b));
            re[at] = std::array::from_fn(|p| re[at][p] + (a[0][p] - b[1][p]));
            im[at] = std::array::from_fn(|p| im[at][p] + (a[1][p] + b[0][p]));
            if j > 0 {
                re[mirrored] = std::array::from_fn(|p| re[mirrored][p] + (a[0][p] + b[1][p]));
                im[mirrored] = std::array::from_fn(|p| im[mirrored][p] + (b[0][p] - a[1][p]));
            }
        }
        let roots = roots(n);
        // A part is combined as soon as both its halves are ready: they are still in the cache.
        for end in (2..=n).step_by(2) {
            let mut size = 2;
            while end % size == 0 && size <= n {
                let (re_low, re_high) = re[end - size..end].split_at_mut(size / 2);
                let (im_low, im_high) = im[end - size..end].split_at_mut(size / 2);
                let low = re_low.iter_mut().zip(im_low);
                let high = re_high.iter_mut().zip(im_high);
                for ((low, high), root) in low.zip(high).zip(roots.iter().step_by(n / size)) {
                    // Copies, which cannot overlap, are computed in registers.
                    let (a, b) = ([*low.0, *low.1], [*high.0, *high.1]);
                    let turned: [[f64; P]; 2] = [
                        std::array::from_fn(|p| b[0][p] * root[0] - b[1][p] * root[1]),
                        std::array::from_fn(|p| b[1][p] * root[0] + b[0][p] * root[1]),
                    ];
                    *low.0 = std::array::from_fn(|p| a[0][p] + turned[0][p]);
                    *low.1 = std::array::from_fn(|p| a[1][p] + turned[1][p]);
                    *high.0 = std::array::from_fn(|p| a[0][p] - turned[0][p]);
                    *high.1 = std::array::from_fn(|p| a[1][p] - turned[1][p]);
                }
                size *= 2;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn series_by_phase_are_their_sums() {
        let coefficient = |j: usize, of: usize| [1.0 / (j + of) as f64, ((j * of) as f64).sin()];
        for samples in [1, 2, 16] {
            // Frequencies above half the sampling rate count too.
            let terms: Vec<[Complex; 2]> =
                (0..samples / 2 + 2).map(|j| [coefficient(j, 1), coefficient(j, 2)]).collect();
            let both = Synthesis::<4>::new(samples, terms.len()).of(&terms);
            for (series, k, p) in (0..2 * samples * 4).map(|i| (i / 4 / samples, i / 4 % samples, i % 4)) {
                let time = k as f64 + p as f64 / 4.0;
                let term = |(j, terms): (usize, &[Complex; 2])| {
                    let (sin, cos) = (TAU * j as f64 * time / samples as f64).sin_cos();
                    let twice = if j > 0 { 2.0 } else { 1.0 };
                    twice * times(terms[series], [cos, sin])[0]
                };
                let exact: f64 = terms.iter().enumerate().map(term).sum();
                let value = both[series][k][p];
                assert!((value - exact).abs() < 1e-12, "{samples} {k} {p}: {value} {exact}");
            }
        }
    }

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
