//! Changes of models and samples, and the warnings that must name them.

use wavex_formats::container::EmissionReference;
use wavex_signal::sensor_model::{Background, ChannelModel, SensorModel};

use super::instruments::{Recording, Timing};
use super::runs::Case;

const NOISE: &str = "the noise differs from the sensor model";
const CORRELATION: &str = "the correlation of the noise differs";
const BACKGROUND: &str = "the background differs from the sensor model";
const WIDTH: &str = "the width of single echoes differs";
const SHAPE: &str = "the shape of single echoes differs";
const TEMPLATE_ERROR: &str = "the template error of the sensor model contradicts";
const FULL_SCALE: &str = "clipping level";
const NOISE_DRIFT: &str = "the noise changes along the recording";
const BACKGROUND_DRIFT: &str = "the background changes along the recording";
const DEAD: &str = "did not work or does not belong to the sensor model";
const EMISSION: &str = "points are smoother by";
const DISPLACED: &str = "displaced by a sample";
const COPIES: &str = "byte-identical copies";
const ECHOES: &str = "hardly any waveform has an echo";

/// Warnings on the model and the receiver.
const ALARMS: [&str; 14] = [
    NOISE,
    CORRELATION,
    BACKGROUND,
    WIDTH,
    SHAPE,
    TEMPLATE_ERROR,
    FULL_SCALE,
    NOISE_DRIFT,
    BACKGROUND_DRIFT,
    DEAD,
    EMISSION,
    DISPLACED,
    COPIES,
    ECHOES,
];

/// Whether a run with the right model gave a false alarm.
pub fn is_alarm(warnings: &[String]) -> bool {
    warnings.iter().any(|text| ALARMS.iter().any(|alarm| text.contains(alarm)))
}

/// What is changed.
enum What {
    /// Nothing: the model of another recording of the instrument.
    Nothing,
    /// Nothing: the model is calibrated from the recording.
    Calibrated,
    /// The loaded model.
    Model(fn(&mut ChannelModel)),
    /// The samples.
    Samples(fn(&Recording) -> Recording),
    /// The model is that of another instrument.
    Other,
    /// The recording has outgoing pulses, from which the model is calibrated.
    Timing(Timing),
}

/// A row of the table.
pub struct Change {
    pub name: &'static str,
    /// Parts of warnings of which one must appear; empty if none may.
    pub areas: &'static [&'static str],
    what: What,
}

impl Change {
    /// The case for a recording.
    pub fn apply(&self, model: &SensorModel, other: &SensorModel, recording: &Recording) -> Case {
        let (mut model, mut recording) = (Some(model.clone()), recording.clone());
        match self.what {
            What::Nothing => {}
            What::Calibrated => model = None,
            What::Other => model = Some(other.clone()),
            What::Samples(change) => recording = change(&recording),
            What::Model(change) => {
                model.iter_mut().filter_map(|model| model.low_power.as_mut()).for_each(change);
            }
            What::Timing(timing) => (model, recording.timing) = (None, Some(timing)),
        }
        Case { model, recording }
    }
}

/// All rows.
pub fn changes() -> Vec<Change> {
    let row = |name, areas, what| Change { name, areas, what };
    let model = |name, areas, change| row(name, areas, What::Model(change));
    let samples = |name, areas, change| row(name, areas, What::Samples(change));
    vec![
        row("none: loaded model", &[], What::Nothing),
        row("none: calibrated", &[], What::Calibrated),
        model("response 10 % too wide", &[WIDTH], |m| widen(m, 1.1)),
        model("response 20 % too wide", &[WIDTH], |m| widen(m, 1.2)),
        model("response 10 % too narrow", &[WIDTH], |m| widen(m, 1.0 / 1.1)),
        model("response 20 % too narrow", &[WIDTH], |m| widen(m, 1.0 / 1.2)),
        model("tail missing", &[SHAPE, TEMPLATE_ERROR], |m| scale_tail(m, 0.0)),
        model("ringing sign flipped", &[SHAPE, TEMPLATE_ERROR], |m| scale_tail(m, -1.0)),
        model("noise halved", &[NOISE], |m| scale_noise(m, 0.5)),
        model("noise doubled", &[NOISE], |m| scale_noise(m, 2.0)),
        model("correlation dropped", &[CORRELATION], |m| {
            m.ar.clear();
            m.autocorrelation.iter_mut().for_each(|lag| *lag = 0.0);
            m.innovation_sd_dn = m.noise_sd_dn;
        }),
        model("background 2 SD too high", &[BACKGROUND], |m| shift_background(m, 2.0)),
        model("background 2 SD too low", &[BACKGROUND], |m| shift_background(m, -2.0)),
        model("template error 5 times too large", &[TEMPLATE_ERROR], |m| scale_template_error(m, 5.0)),
        model("template error 5 times too small", &[TEMPLATE_ERROR], |m| scale_template_error(m, 0.2)),
        model("clipping level too low", &[FULL_SCALE], |m| m.full_scale_dn = (0.6 * m.full_scale_dn).round()),
        samples("clipped below the level of the model", &[FULL_SCALE], |recording| {
            let level_dn = (0.5 * f64::from(recording.full_scale_dn)) as u16;
            recording.changed(|_, samples| samples.iter_mut().for_each(|dn| *dn = level_dn.min(*dn)))
        }),
        samples("gain 1.5 times higher from the middle on", &[NOISE_DRIFT], |recording| {
            let (middle, level_dn) = (recording.shots() / 2, recording.background_dn);
            let full_scale_dn = f64::from(recording.full_scale_dn);
            let louder = |dn: u16| (level_dn + 1.5 * (f64::from(dn) - level_dn)).clamp(0.0, full_scale_dn);
            recording.changed(|number, samples| {
                if number >= middle {
                    samples.iter_mut().for_each(|dn| *dn = louder(*dn).round() as u16);
                }
            })
        }),
        samples("dead receiver from the middle on", &[DEAD], |recording| {
            let middle = recording.shots() / 2;
            recording.changed(|number, samples| {
                if number >= middle {
                    samples.fill(77)
                }
            })
        }),
        samples("dead receiver", &[DEAD], |recording| recording.changed(|_, samples| samples.fill(77))),
        samples("receiver offset by 60 DN", &[BACKGROUND, DEAD], |recording| {
            let full_scale_dn = recording.full_scale_dn;
            recording
                .changed(|_, samples| samples.iter_mut().for_each(|dn| *dn = (*dn + 60).min(full_scale_dn)))
        }),
        row("none: outgoing pulses", &[], timing(EmissionReference::OutgoingPulse, 0.0)),
        row(
            "emission by the clock, not the outgoing pulse",
            &[EMISSION],
            timing(EmissionReference::Clock, 0.0),
        ),
        row(
            "every tenth waveform late by a sample",
            &[DISPLACED],
            timing(EmissionReference::OutgoingPulse, 1.0),
        ),
        samples("every second waveform a copy", &[COPIES], |recording| {
            let mut last = Vec::new();
            recording.changed(|number, samples| match number % 2 {
                0 => last.clone_from(samples),
                _ => samples.clone_from(&last),
            })
        }),
        row("model of another instrument", &[NOISE, BACKGROUND, WIDTH, SHAPE], What::Other),
    ]
}

fn timing(emission_reference: EmissionReference, late_samples: f64) -> What {
    What::Timing(Timing { emission_reference, late_samples })
}

/// Stretches the response about its peak.
fn widen(model: &mut ChannelModel, factor: f64) {
    model.pulse_fwhm_ns *= factor;
    let Some(response) = &mut model.response else { return };
    let peak = -8.0 * f64::from(response.first_sample);
    for node in &mut response.nodes {
        let old = node.values.clone();
        for (k, value) in node.values.iter_mut().enumerate() {
            let place = (peak + (k as f64 - peak) / factor).max(0.0);
            let (index, part) = (place as usize, place.fract());
            let at = |index: usize| old.get(index).copied().unwrap_or(0.0);
            *value = (1.0 - part) * at(index) + part * at(index + 1);
        }
    }
}

/// Scales what follows the main lobe, with a smooth transition.
fn scale_tail(model: &mut ChannelModel, factor: f64) {
    let fwhm = 8.0 * model.fwhm_samples();
    let Some(response) = &mut model.response else { return };
    let peak = -8.0 * f64::from(response.first_sample);
    for node in &mut response.nodes {
        for (k, value) in node.values.iter_mut().enumerate() {
            let part = (((k as f64 - peak) / fwhm - 1.0) / 0.4).clamp(0.0, 1.0);
            *value *= 1.0 + part * (factor - 1.0);
        }
    }
}

fn scale_noise(model: &mut ChannelModel, factor: f64) {
    model.noise_sd_dn *= factor;
    model.innovation_sd_dn *= factor;
}

/// Shifts the level by standard deviations of the noise, or of the background if that is larger.
fn shift_background(model: &mut ChannelModel, sds: f64) {
    let sd_dn = match model.background {
        Background::Fixed => model.noise_sd_dn,
        Background::PerWaveform => model.noise_sd_dn.max(model.background_sd_dn),
    };
    model.background_dn.iter_mut().for_each(|level| *level += sds * sd_dn);
}

fn scale_template_error(model: &mut ChannelModel, factor: f64) {
    let Some(response) = &mut model.response else { return };
    response.template_error.iter_mut().for_each(|error| *error *= factor);
}
