//! Simulated waveforms with known truth for tests: random numbers, correlated noise, pulses.

use crate::noise::{ArNoise, fit_by_bic};
use crate::sensor_model::{Background, ChannelModel, Digitiser};
use crate::shape::{FOUR_LN_2, Pulse};

/// SplitMix64 (Steele, Lea, Flood 2014): a counter passed through a mixing function.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Random {
        Random(seed)
    }

    pub fn next_u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Standard normal (Box and Muller 1958).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.uniform()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// Coefficients of the stationary process with these reflection coefficients.
pub fn coefficients_from_reflection(reflection: &[f64]) -> Vec<f64> {
    let mut predictor: Vec<f64> = Vec::new();
    for &k in reflection {
        let shorter = predictor.clone();
        for j in 0..shorter.len() {
            predictor[j] = shorter[j] - k * shorter[shorter.len() - 1 - j];
        }
        predictor.push(k);
    }
    predictor
}

/// `samples` values of the process, after a run-in to stationarity.
pub fn noise(random: &mut Random, noise: &ArNoise, samples: usize) -> Vec<f64> {
    let run_in = 100;
    let sd = noise.innovation_variance().sqrt();
    let mut out: Vec<f64> = Vec::with_capacity(run_in + samples);
    for k in 0..run_in + samples {
        let product: f64 = noise.coefficients().iter().zip(out[..k].iter().rev()).map(|(c, x)| c * x).sum();
        out.push(product + sd * random.normal());
    }
    out.split_off(run_in)
}

/// An 8-bit channel at 1 GHz with the noise of the process, rounded to whole steps: 1/12 DN² more
/// at lag 0.
pub fn channel(process: &ArNoise, fwhm_samples: f64, background_dn: f64) -> ChannelModel {
    let mut lags = [0.0; 6];
    process.autocovariance_into(&mut lags);
    lags[0] += 1.0 / 12.0;
    let noise = fit_by_bic(&lags, 1_000_000, 4).expect("a process has a noise model");
    ChannelModel {
        sampling_interval_ns: 1.0,
        full_scale_dn: 255.0,
        background: Background::Fixed,
        background_dn: [background_dn; 4],
        background_sd_dn: 0.0,
        noise_sd_dn: noise.sd(),
        autocorrelation: lags[1..].iter().map(|r| r / lags[0]).collect(),
        ar: noise.coefficients().to_vec(),
        innovation_sd_dn: noise.innovation_variance().sqrt(),
        pulse_fwhm_ns: fwhm_samples,
        pulse_fwhm_sd_ns: 0.1,
        pulse_shape_error: 0.0,
        pulse_error_factor: 1.0,
        response: None,
        digitiser: Digitiser::default(),
        uncertainty: Default::default(),
        provenance: Default::default(),
        limits: Default::default(),
        waveforms: 1000,
        pulses: 1000,
    }
}

/// A pulse of the given height, position and width ratio, without a prior.
pub fn pulse(height_dn: f64, position_samples: f64, width_ratio: f64) -> Pulse {
    Pulse { height_dn, position_samples, ln_width_ratio: width_ratio.ln(), ln_width_precision: 0.0 }
}

/// Background, pulses and noise before the digitiser.
pub fn analogue(
    random: &mut Random,
    process: &ArNoise,
    samples: usize,
    background_dn: f64,
    fwhm_samples: f64,
    pulses: &[Pulse],
) -> Vec<f64> {
    let mut values = noise(random, process, samples);
    for (k, value) in values.iter_mut().enumerate() {
        *value += background_dn;
        for p in pulses {
            let x = (k as f64 - p.position_samples) / (fwhm_samples * p.ln_width_ratio.exp());
            *value += p.height_dn * (-FOUR_LN_2 * x * x).exp();
        }
    }
    values
}

/// Digitises values with the given full scale.
pub fn digitised(values: &[f64], full_scale: u16) -> Vec<u16> {
    values.iter().map(|v| v.round().clamp(0.0, f64::from(full_scale)) as u16).collect()
}

/// Mean and standard deviation.
pub fn moments(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (n - 1.0)).sqrt())
}
