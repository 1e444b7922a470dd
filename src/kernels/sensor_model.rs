//! What `calibrate` finds out about a sensor and `decompose` relies on, channel by channel.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::noise::{ArNoise, MAX_ORDER};
use super::response::SystemResponse;

/// A sensor: one model for each channel that was calibrated.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SensorModel {
    /// The sensitive channel, for weak echoes (RIEGL: low power, LO).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub low_power: Option<ChannelModel>,
    /// The coarse channel, for strong echoes (RIEGL: high power, HI).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high_power: Option<ChannelModel>,
    /// The channel for echoes that saturate the others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub saturation: Option<ChannelModel>,
    /// The outgoing pulse.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<ChannelModel>,
}

/// How the background of a waveform is told.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// It is the channel's: `background_dn`, by the sample's phase.
    Fixed,
    /// It is a free parameter of each waveform, drawn to `background_dn` with the spread `background_sd_dn`.
    PerWaveform,
}

/// One channel of a sensor. DN are steps of the digitiser.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ChannelModel {
    /// Time from sample to sample, ns; positive.
    pub sampling_interval_ns: f64,
    /// Samples at or above this are saturated, DN; positive.
    pub full_scale_dn: f64,
    /// How the background of a waveform is told.
    pub background: Background,
    /// Level without a pulse, DN, by the sample's index modulo 4.
    pub background_dn: [f64; 4],
    /// Spread of the level from block to block, DN; 0 where none was measured. With `per_waveform`, the standard
    /// deviation of the prior on a waveform's level; 0 is then no prior.
    pub background_sd_dn: f64,
    /// Standard deviation of the noise of one sample, quantisation included, DN; positive.
    pub noise_sd_dn: f64,
    /// Correlation of the noise as measured, at lags of 1, 2, … samples.
    pub autocorrelation: Vec<f64>,
    /// Coefficients `φ_1 …` of the noise's autoregressive model; none for white noise.
    pub ar: Vec<f64>,
    /// Standard deviation of that model's innovation, DN; positive.
    pub innovation_sd_dn: f64,
    /// Full width at half maximum of a pulse from a flat target, ns; positive.
    pub pulse_fwhm_ns: f64,
    /// Spread of that width from pulse to pulse, ns.
    pub pulse_fwhm_sd_ns: f64,
    /// Standard deviation of pulses about the Gaussian that stands for them, as part of their height, where no sample is
    /// free of signal and so nothing else tells what a pulse leaves; 0 where it was not measured.
    #[serde(default)]
    pub pulse_shape_error: f64,
    /// How much larger errors on a pulse are than the noise before it lets expect: its standard deviations are
    /// multiplied by this. 1 where it was not measured or does not stand out of its own uncertainty.
    #[serde(default = "one")]
    pub pulse_error_factor: f64,
    /// The system response; absent where pulses are taken to be Gaussians of the width `pulse_fwhm_ns`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub response: Option<SystemResponse>,
    /// What the digitiser and the receiver do to samples beside noise; nothing where it is absent.
    #[serde(default, skip_serializing_if = "Digitiser::is_plain")]
    pub digitiser: Digitiser,
    /// How well these numbers are known.
    #[serde(default)]
    pub uncertainty: ModelUncertainty,
    /// Blocks the model was found from.
    pub waveforms: u64,
    /// Single, unsaturated pulses the width was found from; 0 where there were too few, and the width is
    /// another receiver's or a first measure, taken from the samples above half the height.
    pub pulses: u64,
}

/// What is known beforehand of how samples are taken.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Digitiser {
    /// Odd samples of a block were taken so much later than their index says, samples; above -1 and below 1.
    pub odd_sample_shift: f64,
    /// The exponential tail that the receiver adds to a signal; absent where it is part of the response.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decay: Option<Decay>,
}

/// An exponential tail: `D_k = λ D_{k-1} + A (1 - λ) s_{k-1}` with `λ = e^(-1/T)`, of the signal `s` before sample `k`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Decay {
    /// Area of the tail over that of the signal, `A`.
    pub amplitude: f64,
    /// Time constant, samples, `T`; positive.
    pub time_samples: f64,
}

impl Digitiser {
    pub(super) fn is_plain(&self) -> bool {
        *self == Digitiser::default()
    }

    fn check(&self) -> Result<(), ModelError> {
        let shift = self.odd_sample_shift;
        if shift.is_nan() || shift.abs() >= 1.0 {
            let problem = format!("{shift} is not between -1 and 1");
            return Err(ModelError { field: "odd_sample_shift", problem });
        }
        match self.decay {
            Some(Decay { amplitude, time_samples })
                if !(amplitude.abs() < 1.0 && time_samples > 0.0 && time_samples.is_finite()) =>
            {
                let problem =
                    format!("amplitude {amplitude} must be within ±1, and time_samples {time_samples} positive");
                Err(ModelError { field: "decay", problem })
            }
            _ => Ok(()),
        }
    }

    /// When sample `k` of a block was taken, samples after its first.
    pub fn time_of(&self, k: usize) -> f64 {
        k as f64 + if k % 2 == 1 { self.odd_sample_shift } else { 0.0 }
    }
}

/// How well the numbers of a [`ChannelModel`] are known: standard deviations of the estimates, by the names of the numbers.
/// That of the response stands with it (`shape_sd`). 0 where it was not told.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ModelUncertainty {
    /// Of the level of one phase, DN. This and the next two come from leaving out one of 25 consecutive parts of the
    /// recording after the other (jackknife, Tukey 1958), so that what changes along it counts as well as chance; where no
    /// sample is free of pulses, from the spread over the blocks.
    pub background_dn: f64,
    /// Of the standard deviation of the noise, DN.
    pub noise_sd_dn: f64,
    /// Of the correlation at each lag.
    pub autocorrelation: Vec<f64>,
    /// Of the full width at half maximum, ns: `1.35 s / √n` for the mode of widths of Gaussians that spread by `s`, `n` of them within `1.5 s`; for a
    /// response by the jackknife, too.
    pub pulse_fwhm_ns: f64,
    /// Of the error factor: `0.96 f / √n` of `n` scores, it being half of what lies between two of their percentiles.
    pub pulse_error_factor: f64,
}

fn one() -> f64 {
    1.0
}

/// A model that describes no channel.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("sensor model: {field}: {problem}; recalibrate, or correct the saved model")]
pub struct ModelError {
    /// The field's name.
    pub field: &'static str,
    /// What is wrong with it.
    pub problem: String,
}

impl ChannelModel {
    /// Checks that the numbers describe a channel, and gives the noise they describe.
    pub fn noise(&self) -> Result<ArNoise, ModelError> {
        let positive = [
            ("sampling_interval_ns", self.sampling_interval_ns),
            ("full_scale_dn", self.full_scale_dn),
            ("noise_sd_dn", self.noise_sd_dn),
            ("innovation_sd_dn", self.innovation_sd_dn),
            ("pulse_fwhm_ns", self.pulse_fwhm_ns),
            ("pulse_error_factor", self.pulse_error_factor),
        ];
        for (field, value) in positive {
            if !(value > 0.0 && value.is_finite()) {
                return Err(ModelError { field, problem: format!("{value} is not a positive number") });
            }
        }
        if let Some(level) = self.background_dn.iter().find(|level| !level.is_finite()) {
            return Err(ModelError { field: "background_dn", problem: format!("{level} is not a number") });
        }
        if !(self.background_sd_dn >= 0.0 && self.background_sd_dn.is_finite()) {
            let problem = format!("{} is not a standard deviation", self.background_sd_dn);
            return Err(ModelError { field: "background_sd_dn", problem });
        }
        if !(self.pulse_shape_error >= 0.0 && self.pulse_shape_error.is_finite()) {
            let problem = format!("{} is not a standard deviation", self.pulse_shape_error);
            return Err(ModelError { field: "pulse_shape_error", problem });
        }
        ArNoise::new(&self.ar, self.innovation_sd_dn).ok_or_else(|| ModelError {
            field: "ar",
            problem: format!("{:?} is not a stationary process of at most {MAX_ORDER} coefficients", self.ar),
        })
    }

    /// Checks that the numbers describe a channel and its response.
    pub fn check(&self) -> Result<(), ModelError> {
        self.noise()?;
        self.digitiser.check()?;
        self.response.as_ref().map_or(Ok(()), SystemResponse::check)
    }

    /// The calibrated width in samples.
    pub fn fwhm_samples(&self) -> f64 {
        self.pulse_fwhm_ns / self.sampling_interval_ns
    }

    /// The background at sample `index` of a block whose first sample has index `start_phase` modulo 4.
    pub fn background_at(&self, start_phase: u8, index: usize) -> f64 {
        self.background_dn[(usize::from(start_phase) + index) % 4]
    }

    /// Appends what the samples of a block stand above the background, DN, less the tail that the digitiser's decay says;
    /// before the block there was no signal.
    pub fn signal_into(&self, samples: &[u16], start_phase: u8, signal_dn: &mut Vec<f64>) {
        let level = |k: usize| self.background_at(start_phase, k);
        let above = samples.iter().enumerate().map(|(k, &sample)| f64::from(sample) - level(k));
        let Some(decay) = self.digitiser.decay else {
            signal_dn.extend(above);
            return;
        };
        let kept = (-1.0 / decay.time_samples).exp();
        let mut tail_dn = 0.0;
        signal_dn.extend(above.map(|above_dn| {
            let signal_dn = above_dn - tail_dn;
            tail_dn = kept * tail_dn + decay.amplitude * (1.0 - kept) * signal_dn;
            signal_dn
        }));
    }

    /// The precision of a waveform's own offset from `background_dn`, 1/DN²; `None` where the background is fixed.
    pub fn offset_precision(&self) -> Option<f64> {
        match self.background {
            Background::Fixed => None,
            Background::PerWaveform if self.background_sd_dn > 0.0 => Some(self.background_sd_dn.powi(-2)),
            Background::PerWaveform => Some(0.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> ChannelModel {
        ChannelModel {
            sampling_interval_ns: 0.5,
            full_scale_dn: 255.0,
            background: Background::Fixed,
            background_dn: [1.0, 2.0, 3.0, 4.0],
            background_sd_dn: 0.5,
            noise_sd_dn: 1.25,
            autocorrelation: vec![0.6, 0.36],
            ar: vec![0.6],
            innovation_sd_dn: 1.0,
            pulse_fwhm_ns: 4.0,
            pulse_fwhm_sd_ns: 0.1,
            pulse_shape_error: 0.0,
            pulse_error_factor: 1.0,
            response: None,
            digitiser: Digitiser::default(),
            uncertainty: ModelUncertainty { noise_sd_dn: 0.01, ..ModelUncertainty::default() },
            waveforms: 200,
            pulses: 150,
        }
    }

    #[test]
    fn units_and_phases() {
        let mut model = model();
        assert_eq!(model.fwhm_samples(), 8.0);
        assert_eq!([0, 1, 2, 3, 4].map(|k| model.background_at(3, k)), [4.0, 1.0, 2.0, 3.0, 4.0]);
        assert!((model.noise().unwrap().sd() - 1.25).abs() < 1e-12);
        assert_eq!(model.offset_precision(), None);
        model.background = Background::PerWaveform;
        assert_eq!(model.offset_precision(), Some(4.0));
        model.background_sd_dn = 0.0;
        assert_eq!(model.offset_precision(), Some(0.0));
    }

    #[test]
    fn a_model_survives_json_and_absent_channels_stay_absent() {
        let sensor = SensorModel { low_power: Some(model()), ..SensorModel::default() };
        let text = serde_json::to_string(&sensor).unwrap();
        assert!(!text.contains("reference") && text.contains("\"background\":\"fixed\""), "{text}");
        assert_eq!(serde_json::from_str::<SensorModel>(&text).unwrap(), sensor);
        assert!(serde_json::from_str::<SensorModel>("{\"low\":null}").is_err());
    }

    #[test]
    fn a_tail_is_taken_off_by_its_recursion() {
        let mut model = model();
        model.digitiser.decay = Some(Decay { amplitude: 0.5, time_samples: 1.0 / 2f64.ln() });
        model.background_dn = [2.0; 4];
        // λ = 1/2: the signal 8, 4, 0, 0 leaves the tail 0, 2, 2, 1.
        let mut signal = Vec::new();
        model.signal_into(&[10, 8, 4, 3], 0, &mut signal);
        assert!(
            signal.iter().zip([8.0, 4.0, 0.0, 0.0]).all(|(a, b): (&f64, f64)| (a - b).abs() < 1e-12),
            "{signal:?}"
        );
        model.digitiser.decay = None;
        model.signal_into(&[10], 0, &mut signal);
        assert_eq!(signal.last(), Some(&8.0));
        assert_eq!(Digitiser { odd_sample_shift: 0.1, decay: None }.time_of(3), 3.1);
    }

    #[test]
    fn a_model_of_before_its_uncertainty_was_told_still_loads() {
        let mut value = serde_json::to_value(model()).unwrap();
        for field in ["uncertainty", "pulse_shape_error", "pulse_error_factor"] {
            value.as_object_mut().unwrap().remove(field).unwrap();
        }
        let loaded: ChannelModel = serde_json::from_value(value).unwrap();
        assert_eq!(loaded, ChannelModel { uncertainty: ModelUncertainty::default(), ..model() });
    }

    #[test]
    fn what_describes_no_channel_is_named() {
        let check = |change: fn(&mut ChannelModel), expected: &str| {
            let mut model = model();
            change(&mut model);
            assert_eq!(model.check().unwrap_err().to_string(), expected);
        };
        check(
            |m| m.innovation_sd_dn = 0.0,
            "sensor model: innovation_sd_dn: 0 is not a positive number; \
             recalibrate, or correct the saved model",
        );
        check(
            |m| m.background_dn[2] = f64::NAN,
            "sensor model: background_dn: NaN is not a number; recalibrate, or correct the saved model",
        );
        check(
            |m| m.background_sd_dn = -1.0,
            "sensor model: background_sd_dn: -1 is not a standard deviation; \
             recalibrate, or correct the saved model",
        );
        check(
            |m| m.digitiser.odd_sample_shift = 1.0,
            "sensor model: odd_sample_shift: 1 is not between -1 and 1; \
             recalibrate, or correct the saved model",
        );
        check(
            |m| m.pulse_shape_error = f64::NAN,
            "sensor model: pulse_shape_error: NaN is not a standard deviation; \
             recalibrate, or correct the saved model",
        );
        check(
            |m| m.digitiser.decay = Some(Decay { amplitude: 0.1, time_samples: 0.0 }),
            "sensor model: decay: amplitude 0.1 must be within ±1, and time_samples 0 positive; \
             recalibrate, or correct the saved model",
        );
        check(
            |m| m.ar = vec![1.5],
            "sensor model: ar: [1.5] is not a stationary process of at most 8 coefficients; \
             recalibrate, or correct the saved model",
        );
    }
}
