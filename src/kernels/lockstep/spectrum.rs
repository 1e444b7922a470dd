//! A response as a band-limited Fourier series: widened by a Gaussian, differentiated and whitened exactly.
//!
//! The series repeats after its period, which is at least twice what the response was sampled over.

use crate::kernels::noise::ArNoise;

/// Frequencies above this, in cycles per sample, are left out (ALGORITHMS.md, 1.1).
const BAND_LIMIT: f64 = 0.55;
/// Narrowing (`variance < 0`) amplifies no frequency by more than this; those beyond are left out.
const MAX_GAIN: f64 = 1000.0;

/// The response `h(t)` of one channel, `t` in samples, peak at 0 and `h(0) = 1`.
#[derive(Debug, Clone)]
pub struct Spectrum {
    /// Angular frequency between terms, radians per sample.
    omega_step: f64,
    /// Amplitude of `cos` and `sin` of each multiple of the step, as the real and imaginary part of a phasor.
    terms: Vec<[f64; 2]>,
}

impl Spectrum {
    /// From fine samples: `values[i] = h(first + i step)`, all in samples of the digitiser; `None` unless there are at
    /// least two finite values whose largest is positive, and the step is between 0 and 1.
    ///
    /// The series is shifted and scaled so that its peak stands at 0 and is 1.
    pub fn of_samples(values: &[f64], first: f64, step: f64) -> Option<Spectrum> {
        let usable = values.len() > 1 && values.iter().all(|v| v.is_finite()) && step > 0.0 && step <= 1.0;
        let (peak, height) = values.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
        if !usable || *height <= 0.0 || !first.is_finite() {
            return None;
        }
        let period = (2.0 * values.len() as f64 * step).max(128.0).ceil();
        let omega_step = std::f64::consts::TAU / period;
        let terms = (0..=(BAND_LIMIT * period) as usize).map(|m| {
            let scale = if m == 0 { 1.0 } else { 2.0 } * step / period;
            let mut phasor = [0.0; 2];
            for (i, value) in values.iter().enumerate() {
                let (sin, cos) = (m as f64 * omega_step * (first + i as f64 * step)).sin_cos();
                phasor[0] += scale * value * cos;
                phasor[1] -= scale * value * sin;
            }
            phasor
        });
        let mut series = Spectrum { omega_step, terms: terms.collect() };
        series.put_peak_at_zero(first + peak as f64 * step);
        Some(series)
    }

    /// The response behind the whitening filter of the noise, so that the noise has unit variance.
    pub fn whitened(&self, noise: &ArNoise) -> Spectrum {
        let scale = noise.innovation_variance().sqrt().recip();
        let terms = self.terms.iter().enumerate().map(|(m, &phasor)| {
            let mut filter = [scale, 0.0];
            for (lag, coefficient) in noise.coefficients().iter().enumerate() {
                let (sin, cos) = ((lag + 1) as f64 * m as f64 * self.omega_step).sin_cos();
                filter[0] -= scale * coefficient * cos;
                filter[1] += scale * coefficient * sin;
            }
            product(phasor, filter)
        });
        Spectrum { omega_step: self.omega_step, terms: terms.collect() }
    }

    /// Fills `out[k]` with the series and its first four derivatives at `first + k` samples, widened by a Gaussian of
    /// `variance` samples² (negative: narrowed).
    pub fn derivatives_into(&self, variance: f64, first: f64, out: &mut [[f64; 5]]) {
        out.fill([0.0; 5]);
        for (m, &term) in self.terms.iter().enumerate() {
            let omega = m as f64 * self.omega_step;
            let gain = (-0.5 * omega * omega * variance).exp();
            if gain > MAX_GAIN {
                break;
            }
            let (sin, cos) = (omega * first).sin_cos();
            let mut phasor = product([gain * term[0], gain * term[1]], [cos, sin]);
            let (sin, cos) = omega.sin_cos();
            for values in out.iter_mut() {
                let [real, imaginary] = phasor;
                values[0] += real;
                values[1] -= omega * imaginary;
                values[2] -= omega.powi(2) * real;
                values[3] += omega.powi(3) * imaginary;
                values[4] += omega.powi(4) * real;
                phasor = product(phasor, [cos, sin]);
            }
        }
    }

    /// The series and its first four derivatives at one time.
    pub fn derivatives(&self, variance: f64, at: f64) -> [f64; 5] {
        let mut out = [[0.0; 5]];
        self.derivatives_into(variance, at, &mut out);
        out[0]
    }

    /// Full width at half maximum, samples, of the unwhitened response.
    pub fn fwhm_samples(&self) -> f64 {
        let half = 0.5 * self.derivatives(0.0, 0.0)[0];
        let flank = |sign: f64| {
            let step = 1.0 / 64.0;
            let beyond = (1..).map(|i| i as f64 * step).take(64 * 64);
            let mut below = beyond.skip_while(|t| self.derivatives(0.0, sign * t)[0] > half);
            let mut t = below.next().unwrap_or(0.0);
            for _ in 0..5 {
                let [value, slope, ..] = self.derivatives(0.0, sign * t);
                t -= (value - half) / (sign * slope);
            }
            t
        };
        flank(1.0) + flank(-1.0)
    }

    fn put_peak_at_zero(&mut self, near: f64) {
        let mut peak = near;
        for _ in 0..8 {
            let [_, slope, curvature, ..] = self.derivatives(0.0, peak);
            if curvature < 0.0 {
                peak -= (slope / curvature).clamp(-0.5, 0.5);
            }
        }
        let scale = self.derivatives(0.0, peak)[0].recip();
        for (m, term) in self.terms.iter_mut().enumerate() {
            let (sin, cos) = (m as f64 * self.omega_step * peak).sin_cos();
            *term = product(*term, [scale * cos, scale * sin]);
        }
    }
}

/// Product of two complex numbers.
fn product(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gaussian(sd: f64) -> Spectrum {
        let values: Vec<f64> =
            (0..640).map(|i| 3.0 * (-0.5 * ((i as f64 / 16.0 - 20.0) / sd).powi(2)).exp()).collect();
        Spectrum::of_samples(&values, -17.0, 1.0 / 16.0).unwrap()
    }

    #[test]
    fn a_gaussian_is_widened_and_differentiated_as_the_closed_form_says() {
        let sd = 2.4;
        let series = gaussian(sd);
        assert!((series.fwhm_samples() - sd * (8.0 * 2f64.ln()).sqrt()).abs() < 1e-6);
        for variance in [0.0, 2.0, -1.0] {
            let wide = sd * sd + variance;
            for t in [-3.0, 0.0, 0.4, 5.0] {
                let x = t / wide.sqrt();
                let g = sd / wide.sqrt() * (-0.5 * x * x).exp();
                let s = wide.sqrt();
                let exact = [
                    g,
                    -x * g / s,
                    (x * x - 1.0) * g / s.powi(2),
                    (3.0 * x - x.powi(3)) * g / s.powi(3),
                    (x.powi(4) - 6.0 * x * x + 3.0) * g / s.powi(4),
                ];
                for (found, exact) in series.derivatives(variance, t).iter().zip(exact) {
                    assert!((found - exact).abs() < 1e-5, "{variance} {t}: {found} {exact}");
                }
            }
        }
    }

    #[test]
    fn whitening_in_the_series_is_whitening_of_the_samples() {
        let noise = ArNoise::new(&[0.9, -0.4, 0.1], 0.7).unwrap();
        let (raw, white) = (gaussian(1.8), gaussian(1.8).whitened(&noise));
        for t in [-2.0, 0.0, 1.3, 4.0] {
            let lagged = |lag: f64| raw.derivatives(0.5, t - lag)[0];
            let exact = (lagged(0.0) - 0.9 * lagged(1.0) + 0.4 * lagged(2.0) - 0.1 * lagged(3.0)) / 0.7;
            assert!((white.derivatives(0.5, t)[0] - exact).abs() < 1e-12);
        }
    }

    #[test]
    fn what_is_no_pulse_is_refused() {
        assert!(Spectrum::of_samples(&[1.0], 0.0, 0.1).is_none());
        assert!(Spectrum::of_samples(&[1.0, f64::NAN], 0.0, 0.1).is_none());
        assert!(Spectrum::of_samples(&[-1.0, -2.0], 0.0, 0.1).is_none());
        assert!(Spectrum::of_samples(&[1.0, 2.0], 0.0, 0.0).is_none());
    }
}
