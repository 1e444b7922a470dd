//! The same estimates in `f64`, one waveform at a time, straight from the series: no tables, no lanes.

use nalgebra::{DMatrix, DVector};

use crate::kernels::lockstep::Spectrum;
use crate::kernels::noise::ArNoise;

pub(super) struct Twin {
    whitened: Spectrum,
    noise: ArNoise,
    background_dn: [f64; 4],
    v0: f64,
}

/// Values and standard deviations of each pulse, and the sum of squares.
#[derive(Debug)]
pub(super) struct Fit {
    pub(super) pulses: Vec<[[f64; 3]; 2]>,
    pub(super) chi_square: f64,
}

impl Twin {
    pub(super) fn new(response: &Spectrum, noise: &ArNoise, background_dn: [f64; 4]) -> Twin {
        let v0 = (response.fwhm_samples() / (8.0 * 2f64.ln()).sqrt()).powi(2);
        let whitened = response.whitened(noise);
        Twin { whitened, noise: noise.clone(), background_dn, v0 }
    }

    fn samples(&self, block: &[u16]) -> Vec<f64> {
        block.iter().enumerate().map(|(k, &v)| f64::from(v) - self.background_dn[k % 4]).collect()
    }

    /// Samples behind the predictor; none before the block.
    fn white(&self, block: &[u16]) -> Vec<f64> {
        let samples = self.samples(block);
        let value = |k: usize| {
            let told: f64 = (self.noise.coefficients().iter().enumerate())
                .filter_map(|(lag, c)| Some(c * samples[k.checked_sub(lag + 1)?]))
                .sum();
            (samples[k] - told) / self.noise.innovation_variance().sqrt()
        };
        (0..samples.len()).map(value).collect()
    }

    /// Local maxima away from the edges: the whitened template of lags −6 to 7 over the whitened samples.
    pub(super) fn candidates(&self, block: &[u16], threshold: f64) -> Vec<(f64, f64)> {
        let white = self.white(block);
        let template: Vec<f64> = (-6..8).map(|k| self.whitened.derivatives(0.0, f64::from(k))[0]).collect();
        let norm = template.iter().map(|v| v * v).sum::<f64>().sqrt();
        let statistic = |k: usize| (0..14).map(|i| template[i] * white[k + i - 6]).sum::<f64>() / norm;
        let peaks = (11..block.len() - 9).filter_map(|k| {
            let [l, c, r] = [statistic(k - 1), statistic(k), statistic(k + 1)];
            let shift = 0.5 * (l - r) / (l - 2.0 * c + r);
            (c >= threshold && c > l && c >= r).then_some((k as f64 + shift, c - 0.25 * (l - r) * shift))
        });
        peaks.collect()
    }

    /// Twenty iterations of Gauss and Newton from the given values, over a frame from nine samples before the
    /// first, as far as the block reaches.
    pub(super) fn fit(&self, block: &[u16], frame: usize, from: &[[f64; 3]], prior_sd: Option<f64>) -> Fit {
        let white = self.white(block);
        let n = 3 * from.len();
        let mut values = DVector::from_iterator(n, from.iter().flatten().copied());
        let precision = prior_sd.map_or(0.0, |sd| 1.0 / (sd * sd));
        for iteration in 0.. {
            let first = ((16.0 * values[1]).round() / 16.0).floor() as usize - 9;
            let frame = frame.min(white.len() - first);
            let mut jacobian = DMatrix::zeros(frame, n);
            let mut residual = DVector::from_column_slice(&white[first..first + frame]);
            let mut rows = vec![[0.0; 5]; frame];
            for p in (0..n).step_by(3) {
                let scale = self.v0 * (2.0 * values[p + 2]).exp();
                self.whitened.derivatives_into(scale - self.v0, first as f64 - values[p + 1], &mut rows);
                for (k, [h, t, tt, ..]) in rows.iter().enumerate() {
                    jacobian[(k, p)] = *h;
                    jacobian[(k, p + 1)] = -values[p] * t;
                    jacobian[(k, p + 2)] = values[p] * scale * tt;
                    residual[k] -= values[p] * h;
                }
            }
            let mut normal = jacobian.transpose() * &jacobian;
            let mut side = jacobian.transpose() * &residual;
            for u in (2..n).step_by(3) {
                normal[(u, u)] += precision;
                side[u] -= precision * values[u];
            }
            let covariance = normal.try_inverse().unwrap();
            if iteration == 20 {
                let pulse = |p: usize| {
                    let sds = std::array::from_fn(|i| covariance[(p + i, p + i)].sqrt());
                    [std::array::from_fn(|i| values[p + i]), sds]
                };
                let pulses = (0..n).step_by(3).map(pulse).collect();
                return Fit { pulses, chi_square: residual.norm_squared() };
            }
            let mut step = covariance * side;
            for p in (0..n).step_by(3) {
                step[p + 1] = step[p + 1].clamp(-0.5, 0.5);
                step[p + 2] = step[p + 2].clamp(-0.2, 0.2);
            }
            values += step;
        }
        unreachable!("the loop ends by itself")
    }
}
