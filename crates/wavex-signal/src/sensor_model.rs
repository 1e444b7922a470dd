//! Sensor model: the calibration of each channel, used by the decomposition.

pub(crate) mod response;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::noise::{ArNoise, MAX_ORDER};
pub use response::{ResponseNode, SystemResponse};
use wavex_returns::range_walk::RangeWalk;

/// Sensor model with one entry per calibrated channel.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SensorModel {
    /// Sensitive channel, for weak echoes (RIEGL: low power, LO).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub low_power: Option<ChannelModel>,
    /// Less sensitive channel, for strong echoes (RIEGL: high power, HI).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high_power: Option<ChannelModel>,
    /// Channel for echoes that saturate the others.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub saturation: Option<ChannelModel>,
    /// Channel of the outgoing pulse.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<ChannelModel>,
    /// Range walk of the sensitive channel, learnt by `correct`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub low_power_range_walk: Option<RangeWalk>,
    /// Range walk of the less sensitive channel.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high_power_range_walk: Option<RangeWalk>,
}

/// Source of the background of a waveform.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Background {
    /// The channel's `background_dn`, by sample phase.
    Fixed,
    /// A free parameter of each waveform, with a prior of mean `background_dn` and SD
    /// `background_sd_dn`.
    PerWaveform,
}

/// Model of one channel. DN are digitiser steps.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ChannelModel {
    /// Sampling interval, ns; positive.
    pub sampling_interval_ns: f64,
    /// Full scale, DN; positive. Samples at or above it are saturated.
    pub full_scale_dn: f64,
    /// Source of the background of a waveform.
    pub background: Background,
    /// Background level, DN, by sample index modulo 4.
    pub background_dn: [f64; 4],
    /// SD of the level between blocks, DN; 0 if not measured.
    ///
    /// With `per_waveform`, the SD of the prior on the level of a waveform; 0 then means no prior.
    pub background_sd_dn: f64,
    /// SD of the noise of one sample, quantisation included, DN; positive.
    pub noise_sd_dn: f64,
    /// Measured autocorrelation of the noise, at lags of 1, 2, … samples.
    pub autocorrelation: Vec<f64>,
    /// Coefficients `φ_1 …` of the autoregressive noise model; empty for white noise.
    pub ar: Vec<f64>,
    /// SD of the innovation of the noise model, DN; positive.
    pub innovation_sd_dn: f64,
    /// Full width at half maximum of a pulse from a flat target, ns; positive.
    pub pulse_fwhm_ns: f64,
    /// SD of that width between pulses, ns.
    pub pulse_fwhm_sd_ns: f64,
    /// SD of pulses about the Gaussian model, relative to their height; 0 if not measured.
    ///
    /// Measured only if no sample is free of signal, because nothing else then determines the
    /// residual of a pulse.
    #[serde(default)]
    pub pulse_shape_error: f64,
    /// Ratio of actual errors to those expected from the noise.
    ///
    /// Standard deviations are multiplied by it. 1 if not measured or not significant.
    #[serde(default = "one")]
    pub pulse_error_factor: f64,
    /// System response; if absent, pulses are Gaussians of width `pulse_fwhm_ns`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub response: Option<SystemResponse>,
    /// Sampling and receiver effects other than noise; none if absent.
    #[serde(default, skip_serializing_if = "Digitiser::is_plain")]
    pub digitiser: Digitiser,
    /// Standard deviations of these parameters.
    #[serde(default)]
    pub uncertainty: ModelUncertainty,
    /// Data from which noise and response were estimated.
    #[serde(default, skip_serializing_if = "Provenance::is_unknown")]
    pub provenance: Provenance,
    /// Behaviour of the receiver near full scale.
    #[serde(default, skip_serializing_if = "ReceiverLimits::is_unknown")]
    pub limits: ReceiverLimits,
    /// Number of blocks used for calibration.
    pub waveforms: u64,
    /// Number of single, unsaturated pulses used for the width.
    ///
    /// 0 if there were too few; the width is then another receiver's or an initial estimate from
    /// the samples above half maximum.
    pub pulses: u64,
}

/// Known timing offset and tail of the digitiser.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Digitiser {
    /// Delay of the odd samples of a block relative to their index, samples; above -1 and below 1.
    pub odd_sample_shift: f64,
    /// Exponential tail that the receiver adds to a signal; absent if it is part of the response.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decay: Option<Decay>,
}

/// Exponential tail of a signal.
///
/// `D_k = λ D_{k-1} + A (1 - λ) s_{k-1}` with `λ = e^(-1/T)`, from the signal `s` before sample
/// `k`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Decay {
    /// Area of the tail over that of the signal, `A`; absolute value below 1.
    pub amplitude: f64,
    /// Time constant `T`, samples; positive.
    pub time_samples: f64,
}

impl Digitiser {
    pub(crate) fn is_plain(&self) -> bool {
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
                let problem = format!(
                    "amplitude {amplitude} must be within ±1, and time_samples {time_samples} positive"
                );
                Err(ModelError { field: "decay", problem })
            }
            _ => Ok(()),
        }
    }

    /// Time of sample `k` of a block, samples after its first.
    pub fn time_of(&self, k: usize) -> f64 {
        k as f64 + if k % 2 == 1 { self.odd_sample_shift } else { 0.0 }
    }
}

/// Standard deviations of the parameters of a [`ChannelModel`].
///
/// Fields have the names of the parameters. The uncertainty of the response is its `shape_sd`. 0 if
/// unknown.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ModelUncertainty {
    /// SD of the level of one phase, DN.
    ///
    /// This and the next two are jackknife estimates (Tukey 1958) that leave out one of 25
    /// consecutive parts of the recording at a time, so that changes along it count as well as
    /// chance. If no sample is free of pulses, they follow from the spread over the blocks.
    pub background_dn: f64,
    /// SD of `noise_sd_dn`, DN.
    pub noise_sd_dn: f64,
    /// SD of the autocorrelation at each lag.
    pub autocorrelation: Vec<f64>,
    /// SD of the full width at half maximum, ns.
    ///
    /// `1.35 s / √n` for the mode of Gaussian widths with SD `s`, `n` of them within `1.5 s`. With
    /// a response, a jackknife estimate.
    pub pulse_fwhm_ns: f64,
    /// SD of the error factor.
    ///
    /// `0.96 f / √n` for `n` scores; the factor is half the difference of two of their percentiles.
    pub pulse_error_factor: f64,
}

/// Data from which the parts of a [`ChannelModel`] were estimated.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Provenance {
    /// Data of the noise.
    pub noise: NoiseSource,
    /// Noise SD from fourth differences of quiet samples, DN; 0 if not measured.
    ///
    /// Independent of the pulse model. For correlated noise it is smaller than `noise_sd_dn`;
    /// [`ArNoise::difference_sd`](crate::noise::ArNoise::difference_sd) is the value expected from
    /// the noise model.
    pub noise_by_differences_dn: f64,
    /// Data of the pulse shape.
    pub response: ResponseSource,
    /// Median residual of strong echoes over their peak, with the response of the echoes or a
    /// Gaussian, and with that of the outgoing pulse; 0 if not compared.
    pub residual_over_peak: [f64; 2],
}

/// Data of a noise estimate.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum NoiseSource {
    /// Not recorded.
    #[default]
    Unknown,
    /// Samples before the first pulse of a block.
    FreeSamples,
    /// Residuals of fits, at all samples.
    Residuals,
    /// Residuals of fits, at samples where the fitted pulses are low.
    QuietResiduals,
    /// Fourth differences of quiet samples; correlation is unknown.
    Differences,
}

/// Data of a pulse shape.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ResponseSource {
    /// Not recorded.
    #[default]
    Unknown,
    /// A Gaussian of the width of the echoes.
    Gaussian,
    /// Single echoes of the channel.
    Echoes,
    /// Single echoes of the other receiver.
    OtherReceiver,
    /// Recorded outgoing pulses.
    OutgoingPulse,
}

/// Behaviour of a receiver near full scale.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ReceiverLimits {
    /// Whether `full_scale_dn` was measured, from an accumulation of the highest samples.
    pub full_scale_is_measured: bool,
    /// Height above which pulses overdrive the receiver, DN; absent if not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub overdriven_dn: Option<f64>,
    /// Samples unusable after saturation; absent if not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub recovery_samples: Option<usize>,
    /// Whether pulses up to full scale were found to have the shape of weaker ones.
    pub is_linear: bool,
}

impl Provenance {
    fn is_unknown(&self) -> bool {
        *self == Provenance::default()
    }
}

impl ReceiverLimits {
    fn check(&self) -> Result<(), ModelError> {
        match (self.overdriven_dn, self.recovery_samples) {
            (Some(dn), _) if !(dn > 0.0 && dn.is_finite()) => {
                Err(ModelError { field: "overdriven_dn", problem: format!("{dn} is not a positive number") })
            }
            (_, Some(samples)) if samples > MOST_RECOVERY_SAMPLES => {
                let problem = format!("{samples} is more than {MOST_RECOVERY_SAMPLES} samples");
                Err(ModelError { field: "recovery_samples", problem })
            }
            _ => Ok(()),
        }
    }

    fn is_unknown(&self) -> bool {
        *self == ReceiverLimits::default()
    }
}

/// Longest plausible recovery after saturation, samples.
const MOST_RECOVERY_SAMPLES: usize = 10_000;

fn one() -> f64 {
    1.0
}

/// Error of an invalid channel model.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("sensor model: {field}: {problem}; recalibrate, or correct the saved model")]
pub struct ModelError {
    /// Name of the field.
    pub field: &'static str,
    /// The problem.
    pub problem: String,
}

impl ChannelModel {
    /// Checks the parameters and returns the noise process.
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

    /// Checks the parameters of the channel and its response.
    pub fn check(&self) -> Result<(), ModelError> {
        self.noise()?;
        self.digitiser.check()?;
        self.limits.check()?;
        self.response.as_ref().map_or(Ok(()), SystemResponse::check)
    }

    /// Height above which pulses overdrive the receiver, DN.
    ///
    /// As measured, or else this fraction of full scale.
    pub fn overdriven_dn(&self, part: f64) -> f64 {
        self.limits.overdriven_dn.unwrap_or(part * self.full_scale_dn)
    }

    /// Standard deviations that an overdriven or clipped pulse has in addition to those of its fit:
    /// of its time, ns, and of its height relative to it.
    ///
    /// 0 for a receiver found to be linear. The others are the errors of 14 overdriven pulses of an
    /// LMS-Q680i, which its high-power receiver recorded as well: -44 to -186 ps, and -1.33 dB of the
    /// amplitude `10 lg`, which is -26 %.
    pub fn overdrive_errors(&self) -> (f64, f64) {
        const TIME_WIDTHS: f64 = 0.03;
        const RELATIVE_HEIGHT: f64 = 0.26;
        if self.limits.is_linear { (0.0, 0.0) } else { (TIME_WIDTHS * self.pulse_fwhm_ns, RELATIVE_HEIGHT) }
    }

    /// Calibrated pulse width, samples.
    pub fn fwhm_samples(&self) -> f64 {
        self.pulse_fwhm_ns / self.sampling_interval_ns
    }

    /// Background of sample `index` of a block, DN.
    pub fn background_at(&self, index: usize) -> f64 {
        self.background_dn[index % 4]
    }

    /// Appends the samples of a block less background and decay tail, DN.
    ///
    /// Assumes no signal before the block.
    pub(crate) fn signal_into(&self, samples: &[u16], signal_dn: &mut Vec<f64>) {
        self.window_signal_into(samples, 0, signal_dn);
    }

    /// As [`ChannelModel::signal_into`] for a window of a block.
    ///
    /// `first` is the index in the block of its first sample. Assumes no signal before the window.
    pub(crate) fn window_signal_into(&self, samples: &[u16], first: usize, signal_dn: &mut Vec<f64>) {
        let above = (first..).zip(samples).map(|(k, &sample)| f64::from(sample) - self.background_at(k));
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

    /// Prior precision of a waveform's offset from `background_dn`, 1/DN²; `None` for a fixed
    /// background.
    pub(crate) fn offset_precision(&self) -> Option<f64> {
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
            provenance: Provenance::default(),
            limits: ReceiverLimits::default(),
            waveforms: 200,
            pulses: 150,
        }
    }

    #[test]
    fn overdriven_pulses_of_a_receiver_not_known_to_be_linear_have_errors() {
        let mut model = model();
        assert_eq!(model.overdrive_errors(), (0.03 * model.pulse_fwhm_ns, 0.26));
        model.limits.is_linear = true;
        assert_eq!(model.overdrive_errors(), (0.0, 0.0));
    }

    #[test]
    fn units_and_phases() {
        let mut model = model();
        assert_eq!(model.fwhm_samples(), 8.0);
        assert_eq!([3, 4, 5, 6, 7].map(|k| model.background_at(k)), [4.0, 1.0, 2.0, 3.0, 4.0]);
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
        // λ = 1/2: the signal 8, 4, 0, 0 has the tail 0, 2, 2, 1.
        let mut signal = Vec::new();
        model.signal_into(&[10, 8, 4, 3], &mut signal);
        assert!(
            signal.iter().zip([8.0, 4.0, 0.0, 0.0]).all(|(a, b): (&f64, f64)| (a - b).abs() < 1e-12),
            "{signal:?}"
        );
        model.digitiser.decay = None;
        model.signal_into(&[10], &mut signal);
        assert_eq!(signal.last(), Some(&8.0));
        assert_eq!(Digitiser { odd_sample_shift: 0.1, decay: None }.time_of(3), 3.1);
    }

    #[test]
    fn models_without_uncertainty_load() {
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
            |m| m.limits.overdriven_dn = Some(-1.0),
            "sensor model: overdriven_dn: -1 is not a positive number; \
             recalibrate, or correct the saved model",
        );
        check(
            |m| m.limits.recovery_samples = Some(usize::MAX),
            "sensor model: recovery_samples: 18446744073709551615 is more than 10000 samples; \
             recalibrate, or correct the saved model",
        );
        check(
            |m| m.ar = vec![1.5],
            "sensor model: ar: [1.5] is not a stationary process of at most 8 coefficients; \
             recalibrate, or correct the saved model",
        );
    }
}
