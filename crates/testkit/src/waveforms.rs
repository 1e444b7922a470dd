//! Simulated waveforms of one channel, with known pulse positions.

use std::f64::consts::TAU;

use wavex_signal::noise::ArNoise;
use wavex_signal::sensor_model::{
    Background, ChannelModel, Digitiser, ModelUncertainty, Provenance, ReceiverLimits,
};
use wavex_signal::sensor_model::{ResponseNode, SystemResponse};
use wavex_signal::shape::Pulse;
use wavex_signal::shape::Shape;

/// Samples per block.
pub const SAMPLES: usize = 60;
const BACKGROUND_DN: f64 = 20.3;
/// Distance of the pulses of [`Scene::Long`], samples.
const LONG_SPACING: usize = 4000;

/// SplitMix64 and Box-Muller: identical waveforms in every run.
pub struct Random(u64);

impl Random {
    /// Creates a generator.
    pub fn new(seed: u64) -> Random {
        Random(seed)
    }

    /// A uniform random number in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A standard normal random number.
    pub fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (TAU * self.uniform()).cos()
    }
}

/// Creates an 8-bit channel at 1 GHz.
///
/// The response is a Gaussian of 1.65 ns convolved with a decay of 0.9 ns, with an after-pulse of 4
/// % and a tail of 1.5 % that decays over 30 ns. The noise is autoregressive of order 2, that of the
/// receiver and of rounding to whole steps.
pub fn model(noise: &ArNoise) -> ChannelModel {
    model_of(noise, [0.9, 0.04, 0.015])
}

/// Creates the channel with this decay, ns, and relative heights of after-pulse and tail.
fn model_of(noise: &ArNoise, [decay_ns, after_pulse, tail]: [f64; 3]) -> ChannelModel {
    let noise = &recorded(noise);
    let narrow = |t: f64| (-0.5 * (t / 1.65).powi(2)).exp();
    let main = |t: f64| {
        (0..200).map(|i| f64::from(i) * 0.05).map(|d| (-d / decay_ns).exp() * narrow(t - d)).sum::<f64>()
    };
    let slow = |t: f64| if t > 3.0 { (1.0 - (-(t - 3.0) / 4.0).exp()) * (-t / 30.0).exp() } else { 0.0 };
    let value = |t: f64| main(t) / main(0.7) + after_pulse * narrow((t - 11.0) / 1.2) + tail * slow(t);
    let (mut peak, mut place) = (0.0, 0.0);
    for t in (0..1500).map(|i| f64::from(i) * 0.001) {
        if value(t) > peak {
            (peak, place) = (value(t), t);
        }
    }
    let values = (-96..=640).map(|k| value(f64::from(k) / 8.0 + place) / peak).collect();
    let response = SystemResponse {
        first_sample: -12,
        nodes: vec![ResponseNode { peak_dn: 155.0, values }],
        template_error: vec![0.001; 80],
        echoes: 1000,
        excess_part: 1.0,
        shape_sd: 1e-3,
    };
    ChannelModel {
        sampling_interval_ns: 1.0,
        full_scale_dn: 255.0,
        background: Background::Fixed,
        background_dn: [BACKGROUND_DN; 4],
        background_sd_dn: 0.0,
        noise_sd_dn: noise.sd(),
        autocorrelation: Vec::new(),
        ar: noise.coefficients().to_vec(),
        innovation_sd_dn: noise.innovation_variance().sqrt(),
        pulse_fwhm_ns: response.fwhm_samples(),
        pulse_fwhm_sd_ns: 0.1,
        pulse_shape_error: 0.0,
        pulse_error_factor: 1.0,
        response: Some(response),
        digitiser: Digitiser::default(),
        uncertainty: ModelUncertainty::default(),
        provenance: Provenance::default(),
        limits: ReceiverLimits::default(),
        waveforms: 1000,
        pulses: 1000,
    }
}

/// Noise of the recorded samples: receiver noise, and the rounding to whole steps.
///
/// Without the rounding chi-square per degree of freedom is 1.3.
fn recorded(noise: &ArNoise) -> ArNoise {
    let mut covariance = [0.0; 3];
    noise.autocovariance_into(&mut covariance);
    covariance[0] += 1.0 / 12.0;
    // Yule-Walker equations of order 2.
    let [c0, c1, c2] = covariance;
    let determinant = c0 * c0 - c1 * c1;
    let coefficients = [(c1 * c0 - c1 * c2) / determinant, (c0 * c2 - c1 * c1) / determinant];
    let innovation_variance = c0 - coefficients[0] * c1 - coefficients[1] * c2;
    ArNoise::new(&coefficients, innovation_variance.sqrt()).expect("stationary noise")
}

/// Content of a set of waveforms.
#[derive(Clone, Copy)]
pub enum Scene {
    /// One pulse.
    One,
    /// Two pulses 7 to 13 samples apart, which both detection and a joint fit resolve.
    Two,
    /// Mixed waveforms, with pulses 3 to 20 samples apart.
    ///
    /// 15 % have no pulse, 55 % one, 20 % two, 10 % three; 40 % of the pulses are widened by up to
    /// 40 %.
    Mixed,
    /// This many pulses of calibrated width, 5 to 12 samples apart, in blocks of 120 samples.
    Echoes(usize),
    /// One to seven pulses, as many as fit, in blocks of 60 to 240 samples.
    ///
    /// They are 3 to 20 samples apart; 40 % are widened by up to 40 %.
    Forest,
    /// One to seven pulses, as many as fit, 3 to 20 samples apart, in blocks of 140 samples.
    ///
    /// They are 10 to 70 standard deviations of the noise high; 40 % are widened by up to 40 %.
    Close,
    /// One pulse of calibrated width in every 4000 samples of a block of this length.
    Long(usize),
}

/// Returns the channel as it is when recording: its response differs from the calibrated one of [`model`].
///
/// The decay is 2 % slower, after-pulse and tail are 5 % higher.
pub fn recording_model(noise: &ArNoise) -> ChannelModel {
    model_of(noise, [0.918, 0.042, 0.01575])
}

/// Returns the noise of the channel.
pub fn noise() -> ArNoise {
    ArNoise::new(&[0.85, -0.3], 0.7).expect("stationary noise")
}

/// Generator of the blocks of a scene.
///
/// Pulse heights are 20 to 150 DN.
pub struct Waveforms {
    scene: Scene,
    random: Random,
    shape: Shape,
    noise: ArNoise,
    noise_sd_dn: f64,
}

impl Waveforms {
    /// Creates the generator of a scene.
    pub fn new(model: &ChannelModel, noise: &ArNoise, scene: Scene, seed: u64) -> Waveforms {
        Waveforms {
            scene,
            random: Random(seed),
            shape: Shape::of(model).expect("a channel"),
            noise: noise.clone(),
            noise_sd_dn: noise.innovation_variance().sqrt(),
        }
    }

    /// Appends the samples of a block.
    ///
    /// Returns the positions of its pulses.
    pub fn next(&mut self, samples: &mut Vec<u16>) -> Vec<f64> {
        let Waveforms { scene, random, shape, noise, noise_sd_dn } = self;
        let length = match scene {
            Scene::Echoes(_) => 120,
            Scene::Close => 140,
            Scene::Long(samples) => *samples,
            Scene::Forest => 60 + 20 * (10.0 * random.uniform()) as usize,
            _ => SAMPLES,
        };
        let mut values = vec![BACKGROUND_DN; length];
        let mut past = [0.0; 2];
        for value in values.iter_mut() {
            let predicted: f64 = past.iter().zip(noise.coefficients()).map(|(p, c)| p * c).sum();
            let now = predicted + *noise_sd_dn * random.normal();
            past = [now, past[0]];
            *value += now;
        }
        let kind = random.uniform();
        let count = match scene {
            Scene::One => 1,
            Scene::Two => 2,
            Scene::Echoes(count) => *count,
            Scene::Forest => (1 + (7.0 * random.uniform()) as usize).min(1 + (length - 40) / 14),
            Scene::Close => 1 + (7.0 * random.uniform()) as usize,
            Scene::Long(samples) => samples.div_ceil(LONG_SPACING),
            Scene::Mixed => [0.15, 0.70, 0.90].iter().filter(|&&limit| kind >= limit).count(),
        };
        let heights_dn = match scene {
            Scene::Close => [10.0, 70.0].map(|snr| snr * *noise_sd_dn),
            _ => [20.0, 150.0],
        };
        let mut place = 12.0 + 12.0 * random.uniform();
        let mut truth = Vec::new();
        for _ in 0..count {
            // The samples of the last pulse end 16 samples after its peak.
            if matches!(scene, Scene::Close) && place > (length - 16) as f64 {
                break;
            }
            let widened =
                matches!(scene, Scene::Mixed | Scene::Forest | Scene::Close) && random.uniform() < 0.4;
            let pulse = Pulse {
                height_dn: heights_dn[0] + (heights_dn[1] - heights_dn[0]) * random.uniform(),
                position_samples: place,
                ln_width_ratio: if widened { (1.0 + 0.4 * random.uniform()).ln() } else { 0.0 },
                ln_width_precision: 0.0,
            };
            shape.add(&pulse, 1.0, &mut values);
            truth.push(place);
            place += match scene {
                Scene::Two => 7.0 + 6.0 * random.uniform(),
                Scene::Echoes(_) => 5.0 + 7.0 * random.uniform(),
                Scene::Long(_) => LONG_SPACING as f64,
                _ => 3.0 + 17.0 * random.uniform(),
            };
        }
        samples.extend(values.iter().map(|v| v.round().clamp(0.0, 254.0) as u16));
        truth
    }
}
