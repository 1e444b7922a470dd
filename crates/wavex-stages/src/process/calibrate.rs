//! `calibrate`: estimates the sensor model from the recording itself.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use rayon::ThreadPool;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use wavex_simd::SimdLevel;

pub use keys::{Auto, AutoOrNumber, BackgroundKey, Calibrate, ResponseKey};
use model_check::{CHECKED_WAVEFORMS, ReceiverCheck};
pub(crate) use model_file::write_model;
pub use model_file::{load_model, model_json, parse_model};
pub use presets::Preset;
use shared::SharedModel;
use wavex_line::scan_line::{Channel, InputInfo, Kind, ScanLine};
use wavex_line::stage::{
    Holds, Learning, Learns, LookAhead, MakeTransform, Output, OutputFile, Plan, Result, RunContext,
    StageError, StageSpec, SurveyModels, Transform, TransformConfig, check_whole_steps,
};
use wavex_signal::calibrate::response::{Calibrated, calibrate_response};
use wavex_signal::calibrate::{
    self, BackgroundChoice, CalibrationError, CalibrationProgress, CalibrationSettings,
};
use wavex_signal::decompose::Waveform;
use wavex_signal::gain::calibrate_at_unit_gain;
use wavex_signal::sensor_model::{Decay, Digitiser, SensorModel};

mod keys;
mod model_check;
mod model_file;
mod presets;
mod response_and_limits;
mod shared;

/// Receivers of echoes.
const ECHOES: [Channel; 2] = [Channel::LowPower, Channel::HighPower];

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::transform::<Calibrate>("calibrate", &[Kind::Shots]);

impl TransformConfig for Calibrate {
    fn outputs(&self) -> Vec<&str> {
        self.save.as_deref().into_iter().collect()
    }

    fn holds(&self) -> Holds {
        Holds::First
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>> {
        let model = match (&self.load, self.preset) {
            (Some(path), _) => Some(self.shared.load(&run.input_path(path))?),
            (None, Some(preset)) => Some(self.shared.preset(preset)?),
            (None, None) => None,
        };
        let save = self.save.as_ref().filter(|_| run.has_outputs);
        let save = save.map(|pattern| run.create(pattern)).transpose()?;
        Ok(Box::new(Calibrator { save, ..self.calibrator(run).given(model) }))
    }

    fn learns(&self) -> Option<Learns> {
        let is_given = self.load.is_some() || self.preset.is_some();
        (!is_given).then_some(Learns { waveforms: self.waveforms, makes_model: true })
    }

    fn learn(&self, lines: &mut Vec<ScanLine>, learning: &mut Learning) -> Result<()> {
        let mut calibrator = self.calibrator(learning.run);
        if learning.only_compares {
            // The response takes most of the time.
            calibrator.config.response = ResponseKey::Gaussian;
        }
        calibrator.look_ahead = LookAhead::of(std::mem::take(lines));
        let mut emit = |_: ScanLine| Ok(());
        let model = calibrator.calibrate(&mut Output::new(learning.cx, usize::MAX, &mut emit));
        *lines = calibrator.look_ahead.release();
        learning.known.sensor_model = Some(Arc::new(model?));
        Ok(())
    }
}

impl Calibrate {
    /// Plan of the stage with a model from memory instead of a file or an estimate.
    pub fn with_model(mut self, model: Arc<SensorModel>) -> Plan {
        // The model is compared with the recording like one that is loaded.
        self.load = Some(PathBuf::from("the given model"));
        self.save = None;
        Plan::Transform(Arc::new(WithModel { config: self, model }))
    }

    /// The stage without a model.
    fn calibrator(&self, run: &RunContext) -> Calibrator {
        Calibrator {
            config: self.clone(),
            simd: run.simd,
            pool: run.pool.clone(),
            cancelled: Arc::clone(&run.cancelled),
            progress: Arc::clone(&run.calibration),
            look_ahead: LookAhead::new(self.waveforms),
            clipping_dn: [None; 2],
            survey: run.survey.clone().filter(|_| TransformConfig::learns(self).is_some()),
            stem: run.stem.clone(),
            model: None,
            in_use: None,
            checks: Default::default(),
            save: None,
        }
    }
}

struct Calibrator {
    config: Calibrate,
    simd: SimdLevel,
    pool: Option<Arc<ThreadPool>>,
    cancelled: Arc<AtomicBool>,
    progress: Arc<CalibrationProgress>,
    look_ahead: LookAhead,
    /// Levels at which the samples of the low-power and the high-power receiver are clipped, DN.
    clipping_dn: [Option<u16>; 2],
    /// Models of the survey, which are used instead of calibrating.
    survey: Option<Arc<SurveyModels>>,
    stem: String,
    /// The model: given, of the survey, or calibrated.
    model: Option<Arc<SensorModel>>,
    /// The model that lines get; `None` until it is compared with the first lines.
    in_use: Option<Arc<SensorModel>>,
    /// Checks of the echo receivers along the recording.
    checks: [ReceiverCheck; 2],
    /// File for the model; `None` once written.
    save: Option<OutputFile>,
}

/// The stage with a model from memory.
struct WithModel {
    config: Calibrate,
    model: Arc<SensorModel>,
}

impl MakeTransform for WithModel {
    fn outputs(&self) -> Vec<&str> {
        Vec::new()
    }

    fn holds(&self) -> Holds {
        Holds::First
    }

    fn learns(&self) -> Option<Learns> {
        None
    }

    fn learn(&self, _: &mut Vec<ScanLine>, _: &mut Learning) -> Result<()> {
        Ok(())
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>> {
        Ok(Box::new(self.config.calibrator(run).given(Some(Arc::clone(&self.model)))))
    }
}

impl Transform for Calibrator {
    fn process(&mut self, mut line: ScanLine, out: &mut Output) -> Result<()> {
        check_whole_steps(&line, "calibrate")?;
        self.take_from_survey(&line, out);
        self.save(out)?;
        if let Some(model) = &self.model {
            self.compare(model, &line, out)?;
        }
        if self.in_use.is_some() {
            self.remove_silent_blocks(&mut line, out);
            return self.emit(line, out);
        }
        let done = if self.model.is_some() { "the sensor model was checked" } else { "calibrated" };
        let is_enough = self.look_ahead.hold(line, done, out);
        if is_enough { self.release(out) } else { Ok(()) }
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        if !self.look_ahead.lines().is_empty() {
            self.release(out)?;
        }
        self.conclude_checks(out);
        Ok(())
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
                out.cx.warn("the recording was not among those from which the sensor model of the survey was made: it has the model of an instrument of the same name, serial number and sampling interval, as far as recorded; run `wavex calibrate` for the whole survey and set `survey_model` to its file, or run again with `--resume --relearn`");
            }
            self.model = Some(Arc::clone(model));
            self.look_ahead = LookAhead::new(CHECKED_WAVEFORMS);
        }
    }

    /// The same with a model that is not calibrated here.
    fn given(self, model: Option<Arc<SensorModel>>) -> Calibrator {
        let look_ahead = if model.is_some() { LookAhead::new(CHECKED_WAVEFORMS) } else { self.look_ahead };
        Calibrator { model, look_ahead, ..self }
    }

    /// Calibrates from the held lines unless there is a model, compares it with them, and emits them.
    fn release(&mut self, out: &mut Output) -> Result<()> {
        let is_given = self.model.is_some();
        if !is_given {
            self.progress.begin(self.blocks_to_use());
            let model = self.calibrate(out);
            self.progress.end();
            self.model = Some(Arc::new(model?));
            self.save(out)?;
        }
        let mut lines = self.look_ahead.release();
        lines.iter_mut().for_each(|line| self.remove_silent_blocks(line, out));
        self.look_ahead = LookAhead::of(lines);
        self.in_use = self.checked(is_given, out)?;
        // The rule for silent blocks follows the model in use.
        self.checks.iter_mut().for_each(|check| check.forget_rule());
        for line in self.look_ahead.release() {
            self.emit(line, out)?;
        }
        Ok(())
    }

    /// Emits a line with the model in use.
    fn emit(&self, mut line: ScanLine, out: &mut Output) -> Result<()> {
        line.model = self.in_use.clone();
        out.emit(line)
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
        let low = self.undistorted(Channel::LowPower, low, &reference, out)?;
        let high = self.undistorted(Channel::HighPower, high, &reference, out)?;
        let low = self.with_outgoing_pulse(Channel::LowPower, low, &reference, out)?;
        let high = self.with_outgoing_pulse(Channel::HighPower, high, &reference, out)?;
        if low.is_none() && high.is_none() {
            let [low, high] = ECHOES.map(|channel| self.count(channel));
            let (channel, found) =
                if high > low { (Channel::HighPower, high) } else { (Channel::LowPower, low) };
            let needed = self.settings(Channel::LowPower).min_blocks;
            let error = CalibrationError::TooFewBlocks { found, needed };
            return Err(failed(channel, &error));
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
        let gain_changes = self.gain_changes(channel);
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
        let input = self.look_ahead.lines().first().map_or(&unknown, |scan_line| &scan_line.input);
        let full_scale_dn = f64::from(self.clipping_dn(channel).or(input.full_scale_dn).unwrap_or(u16::MAX));
        let settings = match channel {
            Channel::Reference => CalibrationSettings::reference(input.sampling_interval_ns, full_scale_dn),
            _ => CalibrationSettings::echoes(input.sampling_interval_ns, full_scale_dn),
        };
        let digitiser = self.digitiser(channel, input);
        let cancelled = Arc::clone(&self.cancelled);
        let progress = Arc::clone(&self.progress);
        let settings = CalibrationSettings { digitiser, simd: self.simd, cancelled, progress, ..settings };
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
        self.look_ahead.samples(channel).map(|samples| Waveform { samples })
    }

    fn count(&self, channel: Channel) -> u64 {
        self.blocks(channel).count() as u64
    }

    /// Number of blocks of all receivers from which the model is made.
    fn blocks_to_use(&self) -> u64 {
        let of = |channel| self.count(channel).min(self.settings(channel).max_blocks as u64);
        [Channel::LowPower, Channel::HighPower, Channel::Reference].map(of).iter().sum()
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
    use wavex_line::scan_line::{Blocks, Emission};
    use wavex_line::stage::Context;

    /// A line of noise-like samples, too few to calibrate from.
    fn line(line: u32, shots: u32) -> ScanLine {
        line_of(Channel::LowPower, line, shots)
    }

    fn line_of(channel: Channel, line: u32, shots: u32) -> ScanLine {
        let mut blocks = Blocks::default();
        (0..shots).for_each(|shot| blocks.push(shot, channel, None, 0.0, 1.0, &[2, 3, 2, 1, 2, 3]));
        let emissions = vec![Emission::default(); shots as usize];
        ScanLine::of_shots(Arc::new(InputInfo::default()), line, emissions, blocks)
    }

    fn calibrator() -> Calibrator {
        Calibrator {
            simd: SimdLevel::Portable,
            pool: None,
            cancelled: Arc::default(),
            progress: Arc::default(),
            look_ahead: LookAhead::new(Calibrate::default().waveforms),
            config: Calibrate::default(),
            clipping_dn: [None; 2],
            survey: None,
            stem: String::new(),
            model: None,
            in_use: None,
            checks: Default::default(),
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
    fn a_preset_of_another_instrument_is_a_warning() {
        let warning_of = |name: &str| {
            let mut calibrator = calibrator();
            calibrator.config.preset = Some(Preset::RieglLmsQ680i);
            let (mut cx, mut emit) = (Context::default(), |_: ScanLine| Ok(()));
            let mut out = Output::new(&mut cx, usize::MAX, &mut emit);
            let mut line = line(0, 1);
            line.input = Arc::new(InputInfo { instrument: Some(name.to_owned()), ..InputInfo::default() });
            calibrator.compare(&Preset::RieglLmsQ680i.model().unwrap(), &line, &mut out).unwrap();
            cx.counters().notes[0].clone()
        };
        let other = warning_of("RIEGL Q560");
        assert!(
            other.contains(
                "a preset of the RIEGL LMS-Q680i, but the recording names the instrument RIEGL Q560"
            ),
            "{other}"
        );
        let own = warning_of("LMS-Q680i");
        assert!(own.contains("measured on another instrument of this type"), "{own}");
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

    #[test]
    fn too_few_waveforms_of_two_receivers_name_the_one_with_more() {
        let mut calibrator = calibrator();
        let mut cx = Context::default();
        let mut emit = |_: ScanLine| Ok(());
        let mut out = Output::new(&mut cx, usize::MAX, &mut emit);
        calibrator.process(line_of(Channel::HighPower, 0, 25), &mut out).unwrap();
        calibrator.process(line(1, 2), &mut out).unwrap();
        let error = calibrator.finish(&mut out).unwrap_err().to_string();
        assert!(error.starts_with("the high power receiver: calibration needs 200"), "{error}");
        assert!(error.contains("there were 25; "), "{error}");
    }
}
