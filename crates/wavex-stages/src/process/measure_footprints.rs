//! `measure_footprints`: ground, canopy and relative heights of waveforms with large footprints.

use std::path::PathBuf;
use std::sync::Arc;

use rayon::ThreadPool;
use rayon::iter::ParallelIterator;
use rayon::slice::ParallelSlice;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_footprints::{FootprintEstimator, FootprintModel, FootprintSettings};
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{Block, Blocks, Content, Footprint, InputInfo, Kind, Return, Returns, ScanLine};
use wavex_line::stage::{
    Config, Holds, Learning, Learns, LookAhead, Output, OutputFile, Reason, Result, RunContext, StageError,
    StageSpec, Transform, TransformConfig,
};

mod learning;
mod model_file;
mod result;
mod seen;
#[cfg(test)]
mod tests;

use learning::{Learnt, learnt, outgoing_samples};
use model_file::LoadedModels;
pub use model_file::{BeamModel, FootprintModels};
pub use result::GROUND_CLASS;
use result::MeasuredShot;
pub use seen::SeenFootprint;

/// Registry entry of the stage.
pub const STAGE: StageSpec =
    StageSpec::transform::<MeasureFootprints>("measure_footprints", &[Kind::Shots, Kind::Footprints])
        .making(Kind::Returns);

/// Shots that one thread measures in a row.
const SHOTS_PER_TASK: usize = 32;

/// Measures ground, canopy and relative heights of every shot, with standard deviations.
///
/// For instruments with footprints of 20 m and more (GEDI, LVIS), whose waveforms are profiles of ground and
/// vegetation, not a few echoes. Any reader gives such waveforms: GEDI and LVIS as HDF5, LVIS as PulseWaves, and
/// containers. The noise of each beam and its response, the mean outgoing pulse, are learnt
/// from its first `shots` shots. Without outgoing pulses the response is the mean of the narrowest 2 % of the echoes. Each waveform is smoothed; its signal lies between the first and the last crossing
/// of a threshold; modes become returns. The lowest is the ground: its return has class 2. Its standard deviation
/// includes shifts by slope and low vegetation, and it has the probability that the ground is within 1 m or 3 standard
/// deviations of it, and not below. Where the ground may merge with the layer above it, a second candidate below the mode has
/// height, standard deviation and probability. All follow from the shape of the mode. The deviation of a waveform is large
/// where no profile of ground and canopy explains it. Relative heights count from the ground upwards: below RH50 lies half of
/// the energy, and RH100 is where the signal begins. Heights are vertical. `docs/explanation/footprints.md` describes the method; `write_footprints` writes one row per shot.
///
/// A preset repeats one of the six settings of NASA's product GEDI02_A, for comparison: smoothing, thresholds and
/// noise as there, and every maximum of the smoothed waveform as a mode.
///
/// Cover and plant area index are those of GEDI02_B: the energy of canopy and ground, with the ratio of their
/// reflectances, give the gap probability.
///
/// Saved models (`save` writes to `output_dir`, `load` reads from `input_dir`) are used in another run or on another
/// recording; nothing is learnt then. A file has a model of each beam, and `load` takes that of the same name; beams without a
/// model in it are not measured, with a warning. With `split_beams` of `read_hdf5`, a run saves one file per beam, and
/// loads its beam's model from a file with several. Sampling interval and number of samples of the outgoing pulses
/// must be those of the model. `schemas/footprint_models.schema.json` describes the format.
///
/// Rejected, and counted, are waveforms without background beside their signal: at least 100 samples.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct MeasureFootprints {
    /// Settings of NASA's product GEDI02_A, for comparison with it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub preset: Option<GediPreset>,
    /// Reflectance of the canopy over that of the ground, at the wavelength of the laser.
    #[schemars(range(min = 0.1, max = 10.0))]
    pub reflectance_ratio: f64,
    /// Number of shots of each beam from which noise and response are learnt.
    #[schemars(range(min = 100, max = 1_000_000))]
    pub shots: u64,
    /// File to save the models of the beams to, as JSON, for runs that must reproduce this one exactly.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub save: Option<String>,
    /// Model file written by `save`. Its models are used, and nothing is learnt.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub load: Option<PathBuf>,
}

/// Settings groups of GEDI02_A.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GediPreset {
    /// Group 1: modes smoothed by 6.5 ns; signal from 3 to 6 standard deviations of the noise.
    GediL2aA1,
    /// Group 2: modes smoothed by 3.5 ns; thresholds 3 and 3.
    GediL2aA2,
    /// Group 3: 3.5 ns; 3 and 6.
    GediL2aA3,
    /// Group 4: 6.5 ns; 6 and 6.
    GediL2aA4,
    /// Group 5: 3.5 ns; 3 and 2.
    GediL2aA5,
    /// Group 6: 3.5 ns; 3 and 4.
    GediL2aA6,
}

impl GediPreset {
    /// Number of the group.
    fn group(self) -> u8 {
        self as u8 + 1
    }
}

impl Default for MeasureFootprints {
    fn default() -> MeasureFootprints {
        MeasureFootprints { preset: None, reflectance_ratio: 1.5, shots: 1000, save: None, load: None }
    }
}

impl MeasureFootprints {
    fn settings(&self) -> FootprintSettings {
        self.preset.and_then(|preset| FootprintSettings::gedi_l2a(preset.group())).unwrap_or_default()
    }

    /// The models of the file `load`, if it is given.
    fn loaded(&self, run: &RunContext) -> Result<Option<LoadedModels>> {
        self.load.as_ref().map(|path| LoadedModels::read(run.input_path(path))).transpose()
    }

    /// Measures one shot: its longest echo block.
    fn shot(
        &self,
        emission: u32,
        line: &ScanLine,
        blocks: &Blocks,
        estimator: &mut FootprintEstimator,
        samples: &mut Vec<f32>,
    ) -> Option<(Footprint, Vec<Return>)> {
        let block = echo_block(blocks, emission)?;
        blocks.fractions_into(block, samples);
        let record = blocks.footprint_of(emission);
        let measured = estimator.measure(samples, record.and_then(|record| record.noise))?;
        let full_scale_dn = line.input.full_scale_dn.map_or(f32::INFINITY, f32::from);
        let shot = MeasuredShot {
            block,
            emission: line.emissions.get(emission as usize)?,
            record,
            is_clipped: samples.iter().any(|dn| *dn >= full_scale_dn),
            input: &line.input,
        };
        Some(shot.footprint(&measured, self.reflectance_ratio))
    }
}

impl Config for MeasureFootprints {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        Ok(())
    }

    fn inputs(&self) -> Vec<&str> {
        self.load.iter().filter_map(|path| path.to_str()).collect()
    }
}

impl TransformConfig for MeasureFootprints {
    fn outputs(&self) -> Vec<&str> {
        self.save.as_deref().into_iter().collect()
    }

    fn holds(&self) -> Holds {
        Holds::First
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>> {
        let save = self.save.as_ref().filter(|_| run.has_outputs);
        Ok(Box::new(Measurer {
            loaded: self.loaded(run)?,
            save: save.map(|pattern| run.create(pattern)).transpose()?,
            pool: run.pool.clone(),
            ..Measurer::new(self.clone())
        }))
    }

    fn learns(&self) -> Option<Learns> {
        None
    }

    fn learn(&self, _: &mut Vec<ScanLine>, _: &mut Learning) -> Result<()> {
        Ok(())
    }
}

struct Measurer {
    config: MeasureFootprints,
    pool: Option<Arc<ThreadPool>>,
    /// First lines of the current beam.
    look_ahead: LookAhead,
    beam: Option<Beam>,
    /// Models of the beams so far.
    models: FootprintModels,
    /// Why the first beam without a model has none.
    failure: Option<StageError>,
    /// Models that are used instead of learning.
    loaded: Option<LoadedModels>,
    /// File for the models.
    save: Option<OutputFile>,
}

/// The current beam, and its model as soon as it is known.
struct Beam {
    input: Arc<InputInfo>,
    model: Option<FootprintModel>,
}

impl Transform for Measurer {
    fn process(&mut self, line: ScanLine, out: &mut Output) -> Result<()> {
        if self.beam.as_ref().is_none_or(|beam| !Arc::ptr_eq(&beam.input, &line.input)) {
            self.release(out)?;
            self.beam = Some(Beam { input: Arc::clone(&line.input), model: None });
            self.look_ahead = LookAhead::new(self.config.shots);
        }
        if let Some(Beam { model: Some(model), .. }) = &self.beam {
            let line = self.measured(line, model, out)?;
            return out.emit(line);
        }
        if let Some(loaded) = &self.loaded {
            return match loaded.of_line(&line)? {
                Some(model) => {
                    let model = model.clone();
                    self.report_loaded(&model, out);
                    self.measure_with(model, vec![line], out)
                }
                None => {
                    let error = loaded.without(&line);
                    self.leave_out(vec![line], error, out)
                }
            };
        }
        let is_enough = self.look_ahead.hold(line, "noise and response were learnt", out);
        if is_enough { self.release(out) } else { Ok(()) }
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        self.release(out)?;
        let is_measured = !self.models.beams.is_empty();
        if let Some(failure) = self.failure.take().filter(|_| !is_measured) {
            return Err(failure);
        }
        match self.save.take().filter(|_| is_measured) {
            Some(file) => self.models.write(file, out),
            None => Ok(()),
        }
    }
}

impl Measurer {
    fn new(config: MeasureFootprints) -> Measurer {
        Measurer {
            pool: None,
            look_ahead: LookAhead::new(config.shots),
            config,
            beam: None,
            models: FootprintModels::default(),
            failure: None,
            loaded: None,
            save: None,
        }
    }

    /// Learns the model of the current beam from the held lines, measures and emits them.
    fn release(&mut self, out: &mut Output) -> Result<()> {
        let lines = self.look_ahead.release();
        if !lines.iter().any(has_blocks) {
            return emit_without_returns(lines, out);
        }
        let Learnt { model, of_echoes } = match learnt(&lines) {
            Ok(learnt) => learnt,
            Err(error) => return self.leave_out(lines, error, out),
        };
        let beam = self.beam.as_ref().and_then(|beam| beam.input.beam.clone());
        let name = prefix(beam.as_deref());
        let FootprintModel { pulse_fwhm_ns, noise_sd_dn, shots, .. } = &model;
        match of_echoes {
            None => out.cx.info(format!(
                "{name}outgoing pulse of {pulse_fwhm_ns:.1} ns, noise of {noise_sd_dn:.2} DN, from {shots} shots"
            )),
            Some([count, of]) => out.cx.warn(format!(
                "{name}no outgoing pulses are recorded: the response is the mean of the {count} narrowest of {of} \
                 echoes, {pulse_fwhm_ns:.1} ns wide; if none of them is from flat ground, it is too wide, and the \
                 ground too probable"
            )),
        }
        let model = BeamModel { beam, outgoing_samples: outgoing_samples(&lines), model };
        self.measure_with(model, lines, out)
    }

    /// Measures and emits the first lines of the current beam with its model.
    fn measure_with(&mut self, model: BeamModel, lines: Vec<ScanLine>, out: &mut Output) -> Result<()> {
        for line in lines {
            let line = self.measured(line, &model.model, out)?;
            out.emit(line)?;
        }
        if let Some(beam) = &mut self.beam {
            beam.model = Some(model.model.clone());
        }
        self.models.add(model);
        Ok(())
    }

    /// Emits lines of a beam without a model; an error if the recording has no other beams.
    fn leave_out(&mut self, lines: Vec<ScanLine>, error: StageError, out: &mut Output) -> Result<()> {
        let beam = self.beam.as_ref().and_then(|beam| beam.input.beam.as_deref());
        let Some(beam) = beam else { return Err(error) };
        out.cx.warn(format!("{beam} is not measured: {error}"));
        let shots = lines.iter().map(|line| line.emissions.len() as u64).sum();
        out.cx.reject(Reason::BeamNotLearnt, shots);
        self.failure.get_or_insert(error);
        emit_without_returns(lines, out)
    }

    /// Reports the model that the current beam has from a file.
    fn report_loaded(&self, of_beam: &BeamModel, out: &mut Output) {
        let name = prefix(of_beam.beam.as_deref());
        let FootprintModel { pulse_fwhm_ns, noise_sd_dn, shots, .. } = &of_beam.model;
        let source = if of_beam.outgoing_samples.is_some() { "outgoing pulse" } else { "response" };
        out.cx.info(format!(
            "{name}loaded model: {source} of {pulse_fwhm_ns:.1} ns, noise of {noise_sd_dn:.2} DN, from {shots} shots"
        ));
        if self.config.shots != MeasureFootprints::default().shots {
            out.cx.warn("`shots` of measure_footprints has no effect with `load`: remove it, or learn from the recording");
        }
    }

    /// Measures the shots of a line.
    fn measured(&self, mut line: ScanLine, model: &FootprintModel, out: &mut Output) -> Result<ScanLine> {
        let Content::Shots(blocks) = std::mem::replace(&mut line.content, Content::Returns(Returns::new()))
        else {
            return Err(StageError::failed(
                "measure_footprints received no waveforms",
                "put it before the stages that use returns",
            ));
        };
        let shots: Vec<u32> = blocks.by_emission().map(|(emission, _)| emission).collect();
        let task = || -> Vec<Option<(Footprint, Vec<Return>)>> {
            let of_task = |shots: &[u32]| {
                let mut estimator = FootprintEstimator::new(model, self.config.settings());
                let mut samples = Vec::new();
                let measure = |emission: &u32| {
                    self.config.shot(*emission, &line, &blocks, &mut estimator, &mut samples)
                };
                shots.iter().map(measure).collect::<Vec<_>>()
            };
            shots.par_chunks(SHOTS_PER_TASK).flat_map_iter(of_task).collect()
        };
        let found = match &self.pool {
            Some(pool) => pool.install(task),
            None => task(),
        };
        let missing = found.iter().filter(|shot| shot.is_none()).count();
        out.cx.reject(Reason::WithoutBackground, missing as u64);
        let mut returns = Returns::new();
        for (footprint, of_shot) in found.into_iter().flatten() {
            out.cx.observe("modes", f64::from(footprint.modes));
            out.cx.observe("ground_sd_m", footprint.ground_range_m.sd);
            out.cx.observe("ground_probability", footprint.ground_probability);
            out.cx.observe("sensitivity", footprint.sensitivity);
            returns.extend(of_shot);
            line.footprints.push(footprint);
        }
        line.stats.np += returns.len() as u64;
        line.content = Content::Returns(returns);
        if let Some(kept) = &mut line.waveforms {
            *kept = blocks;
        }
        line.recount();
        Ok(line)
    }
}

/// Name of a beam at the beginning of a message.
fn prefix(beam: Option<&str>) -> String {
    beam.map_or(String::new(), |beam| format!("{beam}: "))
}

fn has_blocks(line: &ScanLine) -> bool {
    line.blocks().is_some_and(|blocks| !blocks.is_empty())
}

fn emit_without_returns(lines: Vec<ScanLine>, out: &mut Output) -> Result<()> {
    let mut lines = lines.into_iter();
    lines.try_for_each(|line| out.emit(ScanLine { content: Content::Returns(Returns::new()), ..line }))
}

/// The longest echo block of a shot.
fn echo_block(blocks: &Blocks, emission: u32) -> Option<&Block> {
    let echoes = blocks.of_emission(emission).map(|(_, block)| block).filter(|block| block.channel.is_echo());
    echoes.max_by_key(|block| block.len())
}
