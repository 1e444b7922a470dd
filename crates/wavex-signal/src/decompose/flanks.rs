//! Evidence of a waveform that its clipped pulses are those of a linear receiver.

use super::{Decomposition, Return, Waveform};
use crate::flags;
use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::{Pulse, Shape};
use crate::whitening::Whitener;

/// Flags of pulses near or above full scale.
pub const BLINDED: u16 = CLIPPED | flags::OVERDRIVEN;
/// Flags of pulses with clipped samples.
const CLIPPED: u16 = flags::SATURATED | flags::EXTREMELY_SATURATED;

/// Fewest degrees of freedom of the flanks.
const LEAST_FREEDOM: f64 = 6.0;
/// Largest chi-square of explained flanks, as a normal deviate: the 99 % point.
const EXPLAINED: f64 = 2.33;
/// Parameters of a pulse.
const PARAMETERS: f64 = 3.0;

/// Standard deviations that overdriven and clipped pulses have in addition to those of their fit: of
/// the time, ns, and of the height relative to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverdriveErrors {
    clipped: (f64, f64),
    unclipped: (f64, f64),
}

impl OverdriveErrors {
    /// Those of a receiver: [`ChannelModel::overdrive_errors`].
    pub fn of_receiver(model: &ChannelModel) -> OverdriveErrors {
        OverdriveErrors { clipped: model.overdrive_errors(), unclipped: model.overdrive_errors() }
    }

    /// Errors of a pulse with these flags; 0 if it is neither overdriven nor clipped.
    pub fn of(&self, flags: u16) -> (f64, f64) {
        match flags & BLINDED {
            0 => (0.0, 0.0),
            flags::OVERDRIVEN => self.unclipped,
            _ => self.clipped,
        }
    }
}

/// Tests the flanks of clipped pulses of one channel.
///
/// The flanks are the unclipped samples at which the fitted pulses exceed the noise. If their
/// chi-square is that of noise and response error, they are explained up to full scale by the response
/// that weaker pulses have. An overdriven receiver flattens them. A pulse below full scale proves
/// nothing: that of an overdriven receiver may be one of the right shape and of another height and
/// time.
pub struct Flanks {
    model: ChannelModel,
    shape: Shape,
    whitener: Whitener,
    /// Smallest error of the response relative to its height.
    template_error: f64,
    recovery_samples: usize,
    used: Vec<bool>,
    residual_dn: Vec<f64>,
    pulses_dn: Vec<f64>,
}

impl Flanks {
    /// Creates the test of a channel.
    ///
    /// `template_error` is the smallest error of the response relative to its height;
    /// `recovery_samples` are left out after clipped ones unless the model has their number.
    ///
    /// # Errors
    /// The model is invalid.
    pub fn new(
        model: &ChannelModel,
        template_error: f64,
        recovery_samples: usize,
    ) -> Result<Flanks, ModelError> {
        Ok(Flanks {
            shape: Shape::of(model)?,
            whitener: Whitener::new(model.noise()?, 0),
            template_error,
            recovery_samples: model.limits.recovery_samples.unwrap_or(recovery_samples),
            model: model.clone(),
            used: Vec::new(),
            residual_dn: Vec::new(),
            pulses_dn: Vec::new(),
        })
    }

    /// Errors of the pulses of a waveform: those of the receiver, but none of clipped pulses whose
    /// flanks are explained.
    pub fn overdrive_errors(&mut self, waveform: Waveform, found: &Decomposition) -> OverdriveErrors {
        let errors = OverdriveErrors::of_receiver(&self.model);
        let is_clipped = found.returns.iter().any(|pulse| pulse.flags & CLIPPED != 0);
        if !is_clipped || self.model.limits.is_linear || !self.are_explained(waveform, found) {
            return errors;
        }
        OverdriveErrors { clipped: (0.0, 0.0), ..errors }
    }

    /// Whether the flanks of the clipped pulses are explained.
    fn are_explained(&mut self, waveform: Waveform, found: &Decomposition) -> bool {
        let Waveform { samples, start_phase } = waveform;
        self.set_used(samples);
        self.residual_dn.clear();
        self.model.signal_into(samples, start_phase, &mut self.residual_dn);
        self.residual_dn.iter_mut().for_each(|dn| *dn -= found.background_offset_dn);
        self.pulses_dn.clear();
        self.pulses_dn.resize(samples.len(), 0.0);
        let clipped = || found.returns.iter().filter(|pulse| pulse.flags & CLIPPED != 0);
        for fitted in found.returns {
            self.shape.add(&pulse_of(fitted), -1.0, &mut self.residual_dn);
        }
        for fitted in clipped() {
            self.shape.add(&pulse_of(fitted), 1.0, &mut self.pulses_dn);
        }
        self.whitener.whiten(&mut self.residual_dn);
        let (noise_dn, response) = (self.model.noise_sd_dn, self.model.response.as_ref());
        let (mut chi_square, mut freedom) = (0.0, -PARAMETERS * clipped().count() as f64);
        for (k, residual) in self.residual_dn.iter().enumerate() {
            if !self.used[k] || self.pulses_dn[k].abs() < noise_dn {
                continue;
            }
            let error_dn = |fitted: &Return| {
                let lag = k as f64 - fitted.position_samples;
                let measured = response.map_or(0.0, |response| response.template_error_at(lag));
                (measured.max(self.template_error) * fitted.amplitude_dn / noise_dn).powi(2)
            };
            chi_square += residual * residual / (1.0 + clipped().map(error_dn).sum::<f64>());
            freedom += 1.0;
        }
        freedom >= LEAST_FREEDOM && normal_deviate(chi_square, freedom) <= EXPLAINED
    }

    /// Marks the samples that are neither clipped nor follow clipped ones.
    fn set_used(&mut self, samples: &[u16]) {
        let mut recovering = 0;
        self.used.clear();
        self.used.extend(samples.iter().map(|&sample| {
            if f64::from(sample) >= self.model.full_scale_dn {
                recovering = self.recovery_samples + 1;
            }
            let is_used = recovering == 0 && sample > 0;
            recovering = recovering.saturating_sub(1);
            is_used
        }));
        self.whitener.set_used(&self.used);
    }
}

fn pulse_of(fitted: &Return) -> Pulse {
    Pulse {
        height_dn: fitted.amplitude_dn,
        position_samples: fitted.position_samples,
        ln_width_ratio: fitted.width_ratio.ln(),
        ln_width_precision: 0.0,
    }
}

/// Normal deviate of a chi-square (E. B. Wilson and M. M. Hilferty, PNAS 17, 1931).
fn normal_deviate(chi_square: f64, freedom: f64) -> f64 {
    let variance = 2.0 / (9.0 * freedom);
    ((chi_square / freedom).cbrt() - 1.0 + variance) / variance.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::decompose::{DecomposeSettings, Decomposer};
    use crate::noise::ArNoise;
    use crate::simulated::{Random, channel, digitised, noise};

    /// Share of proven clipped pulses of a receiver that records this part of the signal above
    /// 200 DN.
    fn proven(gain_above: f64) -> f64 {
        const COUNT: usize = 300;
        let process = ArNoise::new(&[0.5], 1.2).unwrap();
        let model = channel(&process, 5.0, 10.0);
        let settings = DecomposeSettings::default();
        let mut decomposer = Decomposer::new(&model, &settings, 60).unwrap();
        let mut flanks = Flanks::new(&model, settings.template_error, settings.recovery_samples).unwrap();
        let shape = Shape::of(&model).unwrap();
        let mut random = Random::new(3);
        let mut count = 0;
        for _ in 0..COUNT {
            let mut values = vec![0.0; 60];
            let (height, place) = (450.0 + 450.0 * random.uniform(), 28.0 + random.uniform());
            let pulse = Pulse {
                height_dn: height,
                position_samples: place,
                ln_width_ratio: 0.0,
                ln_width_precision: 0.0,
            };
            shape.add(&pulse, 1.0, &mut values);
            let background = noise(&mut random, &process, values.len());
            for (value, noise) in values.iter_mut().zip(background) {
                *value = value.min(120.0 + gain_above * (*value - 120.0).max(0.0)) + noise + 10.0;
            }
            let samples = digitised(&values, 255);
            let waveform = Waveform { samples: &samples, start_phase: 0 };
            let found = decomposer.decompose(&samples, 0);
            assert!(found.returns.iter().any(|pulse| pulse.flags & flags::SATURATED != 0));
            count +=
                usize::from(flanks.overdrive_errors(waveform, &found).of(flags::SATURATED) == (0.0, 0.0));
        }
        count as f64 / COUNT as f64
    }

    #[test]
    fn flanks_prove_a_linear_receiver_and_contradict_an_overdriven_one() {
        let (linear, overdriven) = (proven(1.0), proven(0.7));
        println!("proven: linear {linear:.3}, overdriven {overdriven:.3}");
        assert!(linear > 0.96 && overdriven < 0.02);
    }

    #[test]
    fn deviates_are_those_of_chi_square() {
        for (chi_square, freedom) in [(16.81, 6.0), (23.21, 10.0), (37.57, 20.0)] {
            assert!((normal_deviate(chi_square, freedom) - 2.326).abs() < 0.03);
        }
    }
}
