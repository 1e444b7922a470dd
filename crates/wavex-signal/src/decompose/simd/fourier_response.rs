//! System response as a Fourier series, widened by a Gaussian.
//!
//! Computes its shapes and their derivatives at sixteen positions per sample.

use std::f64::consts::PI;

use crate::fourier::{self, Complex};
use crate::sensor_model::response::{STEPS_PER_SAMPLE, bins, spectrum};
use crate::shape::templates::widening_gain;

use super::tables::{PHASES, TEMPLATES};

/// Steps of the widened shapes per step of the response.
const FINER: usize = PHASES / STEPS_PER_SAMPLE;

/// Fourier series of one response.
pub(super) struct Series {
    terms: Vec<Complex>,
    /// Period, a power of two, in steps of the response.
    steps: usize,
    /// Variance of a Gaussian of the response's width, samples².
    variance: f64,
}

/// Shapes of one width: the pulse of height 1 and its derivatives, ordered as in [`super::tables`].
pub(super) struct Widened {
    shapes: [Vec<f64>; TEMPLATES],
    /// Maximum before scaling to height 1.
    pub(super) top: f64,
}

impl Widened {
    /// Value of a shape, `step` steps of 1/16 sample after the response's peak.
    pub(super) fn at(&self, shape: usize, step: i64) -> f64 {
        let values = &self.shapes[shape];
        values[step.rem_euclid(values.len() as i64) as usize]
    }
}

impl Series {
    /// Creates the series of a response.
    ///
    /// `values` and `first_sample` are as in [`crate::sensor_model::response::SystemResponse`]. The
    /// period leaves room for `reach` samples on either side.
    pub(super) fn new(values: &[f64], first_sample: i32, fwhm_samples: f64, reach: usize) -> Series {
        let steps = (values.len() + 2 * reach * STEPS_PER_SAMPLE).next_power_of_two();
        let first_step = i64::from(first_sample) * STEPS_PER_SAMPLE as i64;
        let terms = spectrum(values, first_step, steps, bins(steps));
        Series { terms, steps, variance: fwhm_samples * fwhm_samples / (8.0 * std::f64::consts::LN_2) }
    }

    /// Pulse of a width and height 1, with first and second derivatives.
    ///
    /// The derivatives are by time and by the logarithm of the width. With `h = s T`, `T` the
    /// height: `s_u = (h_u - s T_u)/T` and `s_uu = (h_uu - 2 s_u T_u - s T_uu)/T`.
    pub(super) fn widened(&self, ln_width_ratio: f64) -> Widened {
        let [h, t, tt, u, uu, tu] = self.transformed(ln_width_ratio);
        let peak = (0..h.len()).fold(0, |best, k| if h[k] > h[best] { k } else { best });
        let step = 1.0 / PHASES as f64;
        let shift = if tt[peak] < 0.0 { (-t[peak] / tt[peak]).clamp(-step, step) } else { 0.0 };
        let top = h[peak] + 0.5 * shift * t[peak];
        let top_u = u[peak] + tu[peak] * shift;
        let top_uu = if tt[peak] < 0.0 { uu[peak] - tu[peak] * tu[peak] / tt[peak] } else { uu[peak] };
        let scaled = |values: &[f64]| -> Vec<f64> { values.iter().map(|v| v / top).collect() };
        let (s, s_t, s_tt) = (scaled(&h), scaled(&t), scaled(&tt));
        let s_u: Vec<f64> = (0..h.len()).map(|k| (u[k] - s[k] * top_u) / top).collect();
        let s_uu = (0..h.len()).map(|k| (uu[k] - 2.0 * s_u[k] * top_u - s[k] * top_uu) / top).collect();
        let s_tu = (0..h.len()).map(|k| (tu[k] - s_t[k] * top_u) / top).collect();
        Widened { shapes: [s, s_t, s_tt, s_u, s_uu, s_tu], top }
    }

    /// Unscaled widened response and derivatives: `h, h_t, h_tt, h_u, h_uu, h_tu`.
    fn transformed(&self, ln_width_ratio: f64) -> [Vec<f64>; TEMPLATES] {
        let length = self.steps * FINER;
        let mut spectra = [vec![[0.0, 0.0]; length], vec![[0.0, 0.0]; length], vec![[0.0, 0.0]; length]];
        for (j, &c) in self.terms.iter().enumerate() {
            let omega = 2.0 * PI * j as f64 * STEPS_PER_SAMPLE as f64 / self.steps as f64;
            let [gain, by_u, by_uu] = widening_gain(omega, self.variance, ln_width_ratio);
            let scaled = |factor: f64| [c[0] * factor, c[1] * factor];
            let turned = |factor: f64| [-omega * c[1] * factor, omega * c[0] * factor];
            let pairs = [
                [scaled(gain), turned(gain)],
                [scaled(-omega * omega * gain), scaled(by_u)],
                [scaled(by_uu), turned(by_u)],
            ];
            for (target, [a, b]) in spectra.iter_mut().zip(pairs) {
                // f + i g in one transform: the term at j is a + i b, at -j it is a* + i b*.
                target[j] = [a[0] - b[1], a[1] + b[0]];
                if j > 0 {
                    target[length - j] = [a[0] + b[1], b[0] - a[1]];
                }
            }
        }
        spectra.iter_mut().for_each(|values| fourier::transform(values, 1.0));
        let part = |values: &[Complex], i: usize| -> Vec<f64> { values.iter().map(|c| c[i]).collect() };
        let [a, b, c] = &spectra;
        [part(a, 0), part(a, 1), part(b, 0), part(b, 1), part(c, 0), part(c, 1)]
    }
}
