//! System response as a Fourier series, widened by a Gaussian.
//!
//! Computes its shapes and their derivatives at sixteen positions per sample. Odd samples may be late.

use super::layout::{BEFORE_PEAK, MAX_ORDER, PHASES, TEMPLATES};
use crate::fourier::{ByPhase, Complex, Synthesis, times};
use crate::sensor_model::response::{STEPS_PER_SAMPLE, bins, spectrum};
use crate::shape::templates::widening_gain;

/// Samples of a row before that of the peak: those of an entry, and those that whitening adds.
pub(super) const BEFORE: usize = BEFORE_PEAK as usize + MAX_ORDER;

/// Fourier series of one response.
pub(super) struct Series {
    /// Terms at all samples, or at the even and at the odd ones.
    terms: Vec<Vec<Complex>>,
    /// Period, a power of two, in samples.
    samples: usize,
    synthesis: Synthesis<PHASES>,
    /// Variance of a Gaussian of the response's width, samples².
    variance: f64,
}

/// Shapes of one width: the pulse of height 1 and its derivatives, ordered as in [`super::tables`].
pub(super) struct Widened {
    /// Values by position and shape, from [`BEFORE`] samples before that of the peak.
    values: Vec<f64>,
    length: usize,
    /// Maximum before scaling to height 1.
    pub(super) top: f64,
}

impl Widened {
    /// Values of a shape whose peak is `step` steps of 1/16 sample after an even sample.
    pub(super) fn row(&self, step: usize, shape: usize) -> &[f64] {
        let at = (step * TEMPLATES + shape) * self.length;
        &self.values[at..at + self.length]
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
        let samples = steps / STEPS_PER_SAMPLE;
        let synthesis = Synthesis::new(samples, terms.len());
        let variance = fwhm_samples * fwhm_samples / (8.0 * std::f64::consts::LN_2);
        Series { terms: vec![terms], samples, synthesis, variance }
    }

    /// Takes odd samples this much later, samples.
    pub(super) fn seen_late(mut self, odd_sample_shift: f64) -> Series {
        if odd_sample_shift != 0.0 {
            let turned = |(j, c): (usize, &Complex)| {
                let (sin, cos) = (self.synthesis.omega(j) * odd_sample_shift).sin_cos();
                times(*c, [cos, sin])
            };
            self.terms.push(self.terms[0].iter().enumerate().map(turned).collect());
        }
        self
    }

    /// Pulse of a width and height 1, with first and second derivatives, in rows of `length`.
    ///
    /// The derivatives are by time and by the logarithm of the width. With `h = s T`, `T` the
    /// height: `s_u = (h_u - s T_u)/T` and `s_uu = (h_uu - 2 s_u T_u - s T_uu)/T`.
    pub(super) fn widened(&self, ln_width_ratio: f64, length: usize) -> Widened {
        let series: Vec<_> = self.terms.iter().map(|terms| self.transformed(terms, ln_width_ratio)).collect();
        let (on_time, mut peak) = (&series[0], [0, 0]);
        for (k, row) in on_time[0].iter().enumerate() {
            for (p, value) in row.iter().enumerate() {
                if *value > on_time[0][peak[0]][peak[1]] {
                    peak = [k, p];
                }
            }
        }
        let [h_peak, t_peak, tt_peak, u_peak, uu_peak, tu_peak] =
            on_time.each_ref().map(|values| values[peak[0]][peak[1]]);
        let step = 1.0 / PHASES as f64;
        let shift = if tt_peak < 0.0 { (-t_peak / tt_peak).clamp(-step, step) } else { 0.0 };
        let top = h_peak + 0.5 * shift * t_peak;
        let top_u = u_peak + tu_peak * shift;
        let top_uu = if tt_peak < 0.0 { uu_peak - tu_peak * tu_peak / tt_peak } else { uu_peak };
        let [h, t, tt, u, uu, tu] = [0, 1, 2, 3, 4, 5];
        let steps = PHASES * series.len();
        let mut values = Vec::with_capacity(steps * TEMPLATES * length);
        for step in 0..steps {
            // `phase` steps before sample k is after sample k - 1.
            let phase = step % PHASES;
            let (before, p) = (usize::from(phase > 0), (PHASES - phase) % PHASES);
            let first = 2 * self.samples - BEFORE - before;
            // Whether sample `k` of the row is odd; all are alike if none is late.
            let parity = |k: usize| (step / PHASES + BEFORE + k) % series.len();
            let of = |shape: usize, k: usize| series[parity(k)][shape][(first + k) % self.samples][p];
            let scaled = |shape, k| of(shape, k) / top;
            let s_u = |k| (of(u, k) - scaled(h, k) * top_u) / top;
            values.extend((0..length).map(|k| scaled(h, k)));
            values.extend((0..length).map(|k| scaled(t, k)));
            values.extend((0..length).map(|k| scaled(tt, k)));
            values.extend((0..length).map(s_u));
            values.extend(
                (0..length).map(|k| (of(uu, k) - 2.0 * s_u(k) * top_u - scaled(h, k) * top_uu) / top),
            );
            values.extend((0..length).map(|k| (of(tu, k) - scaled(t, k) * top_u) / top));
        }
        Widened { values, length, top }
    }

    /// Unscaled widened response and derivatives: `h, h_t, h_tt, h_u, h_uu, h_tu`.
    fn transformed(&self, response: &[Complex], ln_width_ratio: f64) -> [ByPhase<PHASES>; 6] {
        let mut terms = [const { Vec::new() }; 3];
        for (j, c) in response.iter().enumerate() {
            let omega = self.synthesis.omega(j);
            let [gain, by_u, by_uu] = widening_gain(omega, self.variance, ln_width_ratio);
            let scaled = |factor: f64| [c[0] * factor, c[1] * factor];
            let turned = |factor: f64| [-omega * c[1] * factor, omega * c[0] * factor];
            terms[0].push([scaled(gain), turned(gain)]);
            terms[1].push([scaled(-omega * omega * gain), scaled(by_u)]);
            terms[2].push([scaled(by_uu), turned(by_u)]);
        }
        let [[h, t], [tt, u], [uu, tu]] = terms.map(|terms| self.synthesis.of(&terms));
        [h, t, tt, u, uu, tu]
    }
}
