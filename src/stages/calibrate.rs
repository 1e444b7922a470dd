//! `calibrate`: estimates the sensor model from the recording itself.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use rayon::ThreadPool;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::keys::InvalidKey;
use crate::scan_line::{Channel, InputInfo, Kind, ScanLine};
use crate::stage::{
    Config, Context, Holds, InstrumentModel, Learns, LookAhead, Output, OutputFile, Result, RunContext,
    StageError, StageSpec, SurveyModels, Transform, TransformConfig,
};
pub(super) use model_file::{load_model, write_model};
pub use presets::Preset;
use wavex_signal::calibrate::response::{Calibrated, calibrate_response};
use wavex_signal::calibrate::{self, BackgroundChoice, CalibrationError, CalibrationSettings};
use wavex_signal::decompose::Waveform;
use wavex_signal::gain::calibrate_at_unit_gain;
use wavex_signal::sensor_model::{Decay, Digitiser, SensorModel};
use wavex_signal::simd::SimdLevel;

mod model_file;
mod presets;
mod response_and_limits;

/// Receivers of echoes.
const ECHOES: [Channel; 2] = [Channel::LowPower, Channel::HighPower];

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::transform::<Calibrate>("calibrate", &[Kind::Shots]);

/// Estimates the sensor model for `decompose` from the first waveforms.
///
/// For each receiver it estimates the background (per sample index modulo 4, or per waveform if no
/// sample is free of signal), the noise and its correlation, and the system response: the shape of
/// a pulse from a flat target with its after-pulse and tail, from single echoes. It also estimates
/// the error of the response, and the factor by which errors on a pulse exceed those expected from
/// the noise. Signal is separated from noise by fitted pulses, never by a threshold on samples. At
/// most 20 000 evenly chosen waveforms of an echo receiver and 2000 of the outgoing pulse are used.
///
/// Where the recorded outgoing pulse explains the echoes clearly better than their own response, it
/// is used instead: over vegetation under a large footprint few echoes are single and narrow. The
/// level at which a receiver clips, the height from which it is overdriven, and whether it recovers
/// from clipping at once are measured where enough strong echoes exist. The report has the residuals
/// with both responses, the source of the noise, and these limits.
///
/// Holds back the first lines until it has enough waveforms, then lets everything through. The
/// model travels with every line and is included in the report. A receiver with fewer than 200
/// waveforms, or an outgoing pulse recorded fewer than 20 times, is left out, and the report says
/// so. If no echo receiver has enough waveforms, the run fails.
///
/// A job over several inputs calibrates once for all inputs of an instrument, before the first of them
/// (`[job] model`).
///
/// A saved model (`save` writes to `output_dir`, `load` reads from `input_dir`) is used unchanged,
/// in another run or on another recording, even for a single waveform. It may lack channels, which
/// are then not used, and may be written by hand; `schemas/sensor_model.schema.json` describes its
/// format. A `preset` is the model of another instrument of the same type, for recordings too short
/// to calibrate from. No preset was tested on an instrument other than the measured one.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Calibrate {
    /// Number of waveforms to calibrate from. Fewer are used if the input has fewer, or if
    /// `memory_mb` cannot hold them.
    pub waveforms: u64,
    /// Background of a waveform: common to the receiver (`fixed`), fitted per waveform
    /// (`per_waveform`), or decided from the data (`auto`).
    pub background: BackgroundKey,
    /// Pulse shape: the system response estimated from single echoes (`auto`), or a Gaussian of the
    /// measured width (`gaussian`).
    pub response: ResponseKey,
    /// Area of the exponential tail of an echo relative to the echo: above -0.9 and below 0.9. With
    /// `"auto"` the tail is part of the response, which extends to the end of the block.
    pub decay_amplitude: AutoOrNumber,
    /// Time constant of that tail, ns; `"auto"` as for `decay_amplitude`. Give both or neither.
    pub decay_time_ns: AutoOrNumber,
    /// File to save the model to, as JSON, for runs that must reproduce this one exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub save: Option<String>,
    /// Model file written by `save`. Its model is used, and nothing is calibrated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub load: Option<PathBuf>,
    /// Model of an instrument type, measured on one instrument. Nothing is calibrated. Excludes
    /// `load`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<Preset>,
}

/// A number, or `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum AutoOrNumber {
    /// The given number.
    Number(f64),
    /// Estimated from the recording.
    Auto(Auto),
}

/// The keyword `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Auto {
    /// Estimated from the recording.
    Auto,
}

impl AutoOrNumber {
    pub(super) const AUTO: AutoOrNumber = AutoOrNumber::Auto(Auto::Auto);

    pub(super) fn number(self) -> Option<f64> {
        match self {
            AutoOrNumber::Number(number) => Some(number),
            AutoOrNumber::Auto(_) => None,
        }
    }
}

/// Pulse shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ResponseKey {
    /// The system response, if there are 150 usable single echoes; otherwise that of the other
    /// receiver, or else a Gaussian. The report says which.
    Auto,
    /// A Gaussian of the measured width.
    Gaussian,
}

/// Source of the background.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BackgroundKey {
    /// Fixed if samples are free of signal, otherwise per waveform.
    Auto,
    /// Common to the receiver, per sample index modulo 4.
    Fixed,
    /// A free parameter of each waveform.
    PerWaveform,
}

impl Default for Calibrate {
    fn default() -> Calibrate {
        Calibrate {
            waveforms: 100_000,
            background: BackgroundKey::Auto,
            response: ResponseKey::Auto,
            decay_amplitude: AutoOrNumber::AUTO,
            decay_time_ns: AutoOrNumber::AUTO,
            save: None,
            load: None,
            preset: None,
        }
    }
}

impl Config for Calibrate {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(self.waveforms >= 200, "waveforms", "at least 200 waveforms are needed")?;
        InvalidKey::unless(
            self.load.is_none() || self.preset.is_none(),
            "preset",
            "`preset` and `load` both give a model: remove one of them",
        )?;
        let (amplitude, time_ns) = (self.decay_amplitude.number(), self.decay_time_ns.number());
        InvalidKey::unless(
            amplitude.is_none_or(|amplitude| amplitude.abs() < 0.9),
            "decay_amplitude",
            "it must lie between -0.9 and 0.9, or be \"auto\"",
        )?;
        InvalidKey::unless(
            time_ns.is_none_or(|time_ns| time_ns > 0.0 && time_ns <= 1e6),
            "decay_time_ns",
            "it must be above 0 and at most 1000000, or \"auto\"",
        )?;
        let (given, missing) = match amplitude {
            Some(_) => ("decay_amplitude", "it also needs decay_time_ns"),
            None => ("decay_time_ns", "it also needs decay_amplitude"),
        };
        InvalidKey::unless(amplitude.is_some() == time_ns.is_some(), given, missing)
    }

    fn inputs(&self) -> Vec<&str> {
        self.load.iter().filter_map(|path| path.to_str()).collect()
    }
}

impl TransformConfig for Calibrate {
    fn outputs(&self) -> Vec<&str> {
        self.save.as_deref().into_iter().collect()
    }

    fn holds(&self) -> Holds {
        Holds::First
    }

    fn make(&self, site: &RunContext) -> Result<Box<dyn Transform>> {
        let model = match (&self.load, self.preset) {
            (Some(path), _) => Some(Arc::new(load_model(&site.input_path(path))?)),
            (None, Some(preset)) => Some(Arc::new(preset.model()?)),
            (None, None) => None,
        };
        let save = self.save.as_ref().filter(|_| site.has_outputs);
        let save = save.map(|pattern| site.create(pattern)).transpose()?;
        Ok(Box::new(Calibrator { model, save, ..self.calibrator(site) }))
    }

    fn learns(&self) -> Option<Learns> {
        let is_given = self.load.is_some() || self.preset.is_some();
        (!is_given).then_some(Learns { waveforms: self.waveforms, makes_model: true })
    }

    fn learn(
        &self,
        lines: &mut Vec<ScanLine>,
        site: &RunContext,
        known: &mut InstrumentModel,
        cx: &mut Context,
    ) -> Result<()> {
        let mut calibrator = self.calibrator(site);
        calibrator.look_ahead = LookAhead::of(std::mem::take(lines));
        let mut emit = |_: ScanLine| Ok(());
        let model = calibrator.calibrate(&mut Output::new(cx, usize::MAX, &mut emit));
        *lines = calibrator.look_ahead.release();
        known.sensor_model = Some(Arc::new(model?));
        Ok(())
    }

    fn compare(
        &self,
        lines: &mut Vec<ScanLine>,
        site: &RunContext,
        known: &mut InstrumentModel,
        cx: &mut Context,
    ) -> Result<()> {
        // The response takes most of the time.
        Calibrate { response: ResponseKey::Gaussian, ..self.clone() }.learn(lines, site, known, cx)
    }
}

impl Calibrate {
    /// The stage without a model.
    fn calibrator(&self, site: &RunContext) -> Calibrator {
        Calibrator {
            config: self.clone(),
            simd: site.simd,
            pool: site.pool.clone(),
            cancelled: Arc::clone(&site.cancelled),
            look_ahead: LookAhead::new(self.waveforms),
            clipping_dn: [None; 2],
            survey: site.survey.clone().filter(|_| self.learns().is_some()),
            stem: site.stem.clone(),
            model: None,
            save: None,
        }
    }
}

struct Calibrator {
    config: Calibrate,
    simd: SimdLevel,
    pool: Option<Arc<ThreadPool>>,
    cancelled: Arc<AtomicBool>,
    look_ahead: LookAhead,
    /// Levels at which the samples of the low-power and the high-power receiver are clipped, DN.
    clipping_dn: [Option<u16>; 2],
    /// Models of the survey, which are used instead of calibrating.
    survey: Option<Arc<SurveyModels>>,
    stem: String,
    model: Option<Arc<SensorModel>>,
    /// File for the model; `None` once written.
    save: Option<OutputFile>,
}

impl Transform for Calibrator {
    fn process(&mut self, mut line: ScanLine, out: &mut Output) -> Result<()> {
        self.take_from_survey(&line, out);
        self.save(out)?;
        if let Some(model) = &self.model {
            self.compare(model, &line, out)?;
            line.model = Some(Arc::clone(model));
            return out.emit(line);
        }
        let is_enough = self.look_ahead.hold(line, "calibrated", out);
        if is_enough { self.release(out) } else { Ok(()) }
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        if self.look_ahead.lines().is_empty() { Ok(()) } else { self.release(out) }
    }
}

impl Calibrator {
    /// Uses the model that the survey has for the recording, before the first line.
    fn take_from_survey(&mut self, line: &ScanLine, out: &mut Output) {
        let Some(survey) = self.survey.take() else { return };
        let found = survey.of_recording(&self.stem, &line.input);
        if let Some((model, inputs)) = found.and_then(|of| Some((of.sensor_model.as_ref()?, of.inputs))) {
            out.cx.info(format!("the sensor model is that of the survey, from {inputs} inputs"));
            if !survey.has_input(&self.stem) {
                out.cx.warn("the recording was not among those from which `survey_model` was made: it has the model of an instrument of the same name, serial number and sampling interval, as far as recorded; run `wavex calibrate` for the whole survey");
            }
            self.model = Some(Arc::clone(model));
        }
    }

    /// Calibrates from the held lines and emits them.
    fn release(&mut self, out: &mut Output) -> Result<()> {
        let model = Arc::new(self.calibrate(out)?);
        self.model = Some(Arc::clone(&model));
        self.save(out)?;
        for mut line in self.look_ahead.release() {
            line.model = Some(Arc::clone(&model));
            out.emit(line)?;
        }
        Ok(())
    }

    /// Writes the model file, if one is wanted and not yet written.
    fn save(&mut self, out: &mut Output) -> Result<()> {
        if let Some(model) = &self.model
            && let Some(file) = self.save.take()
        {
            write_model(model, file, out)?;
        }
        Ok(())
    }

    fn calibrate(&mut self, out: &mut Output) -> Result<SensorModel> {
        self.clipping_dn = ECHOES.map(|channel| self.clipping_level_dn(channel));
        self.warn_of_unknown_scale(out);
        let channels = [Channel::LowPower, Channel::HighPower, Channel::Reference];
        let found: Vec<_> = match &self.pool {
            Some(pool) => pool.install(|| channels.par_iter().map(|of| self.calibrated(*of)).collect()),
            None => channels.iter().map(|of| self.calibrated(*of)).collect(),
        };
        let mut found = channels.into_iter().zip(found);
        let mut next = || match found.next() {
            Some((channel, found)) => self.sufficient(channel, found, out),
            None => Ok(None),
        };
        let (low, high, reference) = (next()?, next()?, next()?);
        let low = self.with_outgoing_pulse(Channel::LowPower, low, &reference, out)?;
        let high = self.with_outgoing_pulse(Channel::HighPower, high, &reference, out)?;
        if low.is_none() && high.is_none() {
            let found = self.count(Channel::LowPower).max(self.count(Channel::HighPower));
            let needed = self.settings(Channel::LowPower).min_blocks;
            let error = CalibrationError::TooFewBlocks { found, needed };
            return Err(failed(Channel::LowPower, &error));
        }
        let low = self.with_limits(Channel::LowPower, low, out)?;
        let high = self.with_limits(Channel::HighPower, high, out)?;
        for (channel, found) in
            [(Channel::LowPower, &low), (Channel::HighPower, &high), (Channel::Reference, &reference)]
        {
            found.iter().for_each(|found| Calibrator::report_noise(channel, &found.model, out));
        }
        let low_power = self.completed(Channel::LowPower, &low, &high, out);
        let high_power = match self.completed(Channel::HighPower, &high, &low, out) {
            Some(model) => Some(model),
            None => self.with_borrowed_response(low_power.as_ref(), out),
        };
        Ok(SensorModel {
            low_power,
            high_power,
            saturation: None,
            reference: self.completed(Channel::Reference, &reference, &None, out),
            ..SensorModel::default()
        })
    }

    /// Warns if the full scale is unknown; it may be far below the range of the sample type.
    fn warn_of_unknown_scale(&self, out: &mut Output) {
        let is_recorded =
            self.look_ahead.lines().first().is_none_or(|line| line.input.full_scale_dn.is_some());
        let is_known = is_recorded || self.clipping_dn(Channel::LowPower).is_some();
        let samples =
            ECHOES.into_iter().flat_map(|channel| self.blocks(channel)).flat_map(|block| block.samples);
        if let (false, Some(&highest)) = (is_known, samples.max()) {
            let scale = (u32::from(highest) + 1).next_power_of_two().max(256) - 1;
            out.cx.warn(format!(
                "the full scale of the digitiser is unknown: no pulse counts as clipped or overdriven; \
                 the highest sample is {highest} DN: set the reader's key `full_scale_dn` ({scale} for {} bits)",
                (scale + 1).ilog2()
            ));
        }
    }

    /// Calibrates one receiver.
    fn calibrated(&self, channel: Channel) -> std::result::Result<Calibrated, CalibrationError> {
        let settings = self.settings(channel);
        let with_response = self.config.response != ResponseKey::Gaussian;
        let gain_changes = self.look_ahead.recorded(channel).any(|block| block.gain != 1.0);
        let blocks = self.blocks(channel);
        if gain_changes {
            return calibrate_at_unit_gain(self.look_ahead.recorded(channel), &settings, with_response);
        }
        let model = calibrate::calibrate(blocks.clone(), &settings)?;
        if with_response {
            return calibrate_response(blocks, &model, &settings);
        }
        // Requested Gaussians have no template error: their misfit stays in the noise.
        Ok(Calibrated { model, usable_echoes: 0 })
    }

    /// The calibration of a receiver; `None`, with a note, if it recorded too little.
    fn sufficient(
        &self,
        channel: Channel,
        found: std::result::Result<Calibrated, CalibrationError>,
        out: &mut Output,
    ) -> Result<Option<Calibrated>> {
        match found {
            Ok(found) => Ok(Some(found)),
            Err(CalibrationError::TooFewBlocks { found: 0, .. }) => Ok(None),
            Err(CalibrationError::TooFewBlocks { .. })
                if channel == Channel::HighPower && self.is_fused() =>
            {
                Ok(None)
            }
            Err(error @ CalibrationError::TooFewBlocks { .. }) => {
                out.cx.warn(format!("{} was not calibrated and is not used: {error}", name(channel)));
                Ok(None)
            }
            Err(error) => Err(failed(channel, &error)),
        }
    }

    /// Whether gain and delay of the receivers are known.
    fn is_fused(&self) -> bool {
        self.look_ahead.lines().first().is_some_and(|line| line.fusion.is_some())
    }

    /// Runs a task in the engine's pool; without a pool, in the current thread.
    fn in_pool<R: Send>(&self, task: impl FnOnce() -> R + Send) -> R {
        match &self.pool {
            Some(pool) => pool.install(task),
            None => task(),
        }
    }

    /// Level at which the samples of a receiver are clipped, if they show it.
    ///
    /// `full_scale_dn` of the reader's job table wins.
    fn clipping_level_dn(&self, channel: Channel) -> Option<u16> {
        let is_set = self.look_ahead.lines().first().is_some_and(|line| line.input.full_scale_is_set);
        if is_set { None } else { calibrate::clipping_level_dn(self.blocks(channel)) }
    }

    /// The same, found once before the calibration; none for the outgoing pulse.
    fn clipping_dn(&self, channel: Channel) -> Option<u16> {
        let index = ECHOES.iter().position(|echoes| *echoes == channel)?;
        self.clipping_dn[index]
    }

    fn settings(&self, channel: Channel) -> CalibrationSettings {
        let unknown = InputInfo::default();
        let input = self.look_ahead.lines().first().map_or(&unknown, |batch| &batch.input);
        let full_scale_dn = f64::from(self.clipping_dn(channel).or(input.full_scale_dn).unwrap_or(u16::MAX));
        let settings = match channel {
            Channel::Reference => CalibrationSettings::reference(input.sampling_interval_ns, full_scale_dn),
            _ => CalibrationSettings::echoes(input.sampling_interval_ns, full_scale_dn),
        };
        let digitiser = self.digitiser(channel, input);
        let cancelled = Arc::clone(&self.cancelled);
        let settings = CalibrationSettings { digitiser, simd: self.simd, cancelled, ..settings };
        match (channel, self.config.background) {
            (Channel::Reference, _) | (_, BackgroundKey::Auto) => settings,
            (_, BackgroundKey::Fixed) => {
                CalibrationSettings { background: BackgroundChoice::Fixed, ..settings }
            }
            (_, BackgroundKey::PerWaveform) => {
                CalibrationSettings { background: BackgroundChoice::PerWaveform, ..settings }
            }
        }
    }

    /// Digitiser properties of a channel; the tail applies to echo receivers only.
    fn digitiser(&self, channel: Channel, input: &InputInfo) -> Digitiser {
        let given = self.config.decay_amplitude.number().zip(self.config.decay_time_ns.number());
        let decay = given.filter(|_| channel.is_echo()).map(|(amplitude, time_ns)| Decay {
            amplitude,
            time_samples: time_ns / input.sampling_interval_ns,
        });
        Digitiser { odd_sample_shift: input.odd_sample_shift, decay }
    }

    /// Blocks of one receiver in the held lines.
    fn blocks(&self, channel: Channel) -> impl Iterator<Item = Waveform<'_>> + Clone {
        self.look_ahead.samples(channel).map(|samples| Waveform { samples, start_phase: 0 })
    }

    fn count(&self, channel: Channel) -> u64 {
        self.blocks(channel).count() as u64
    }
}

fn name(channel: Channel) -> &'static str {
    match channel {
        Channel::HighPower => "the high power receiver",
        Channel::LowPower => "the low power receiver",
        Channel::Saturation => "the saturation receiver",
        Channel::Reference => "the outgoing pulse",
    }
}

fn failed(channel: Channel, error: &CalibrationError) -> StageError {
    if *error == CalibrationError::Cancelled {
        return StageError::Stopped;
    }
    let text = format!("{}: {error}", name(channel));
    match text.rsplit_once("; ") {
        Some((problem, remedy)) => StageError::failed(problem, remedy),
        None => StageError::failed(text, "calibrate on another part of the recording"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scan_line::{Blocks, Emission};
    use crate::stage::Context;

    /// A line of noise-like samples, too few to calibrate from.
    fn line(line: u32, shots: u32) -> ScanLine {
        let mut blocks = Blocks::default();
        (0..shots).for_each(|shot| blocks.push(shot, Channel::LowPower, None, 0.0, 1.0, &[2, 3, 2, 1, 2, 3]));
        let emissions = vec![Emission::default(); shots as usize];
        ScanLine::of_shots(Arc::new(InputInfo::default()), line, emissions, blocks)
    }

    fn calibrator() -> Calibrator {
        Calibrator {
            simd: SimdLevel::Portable,
            pool: None,
            cancelled: Arc::default(),
            config: Calibrate::default(),
            look_ahead: LookAhead::new(100_000),
            clipping_dn: [None; 2],
            survey: None,
            stem: String::new(),
            model: None,
            save: None,
        }
    }

    #[test]
    fn a_full_scale_of_the_job_is_not_replaced_by_a_measured_one() {
        let level_dn = |full_scale_is_set: bool| {
            let mut blocks = Blocks::default();
            for shot in 0..2000u16 {
                let highest_dn = if shot % 3 == 0 { 200 } else { 50 + shot % 150 };
                blocks.push(shot.into(), Channel::LowPower, None, 0.0, 1.0, &[2, highest_dn, 2, 1]);
            }
            let input = Arc::new(InputInfo { full_scale_is_set, ..InputInfo::default() });
            let line = ScanLine::of_shots(input, 0, vec![Emission::default(); 2000], blocks);
            let mut calibrator = calibrator();
            let (mut cx, mut emit) = (Context::default(), |_: ScanLine| Ok(()));
            let mut out = Output::new(&mut cx, usize::MAX, &mut emit);
            calibrator.look_ahead.hold(line, "calibrated", &mut out);
            calibrator.clipping_level_dn(Channel::LowPower)
        };
        assert_eq!((level_dn(false), level_dn(true)), (Some(200), None));
    }

    #[test]
    fn too_few_waveforms_say_how_many_there_were() {
        let mut calibrator = calibrator();
        let mut cx = Context::default();
        let mut emit = |_: ScanLine| Ok(());
        let mut out = Output::new(&mut cx, usize::MAX, &mut emit);
        calibrator.process(line(0, 70), &mut out).unwrap();
        calibrator.process(line(1, 53), &mut out).unwrap();
        let error = calibrator.finish(&mut out).unwrap_err().to_string();
        assert_eq!(
            error,
            "the low power receiver: calibration needs 200 waveforms of the channel and there were 123; \
             give it more data, or load a saved sensor model"
        );
    }
}
