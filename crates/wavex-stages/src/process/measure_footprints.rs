//! `measure_footprints`: ground, canopy and relative heights of waveforms with large footprints.

use std::sync::Arc;

use rayon::ThreadPool;
use rayon::iter::ParallelIterator;
use rayon::slice::ParallelSlice;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_footprints::{
    EchoWidth, FootprintEstimator, FootprintLearner, FootprintModel, FootprintSettings, LEAST_SHOTS,
    outgoing_fwhm_samples,
};
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{
    Block, Blocks, Channel, Content, Footprint, InputInfo, Kind, Return, Returns, ScanLine,
};
use wavex_line::stage::{
    Config, Holds, Learning, Learns, LookAhead, Output, Reason, Result, RunContext, StageError, StageSpec,
    Transform, TransformConfig,
};
use wavex_simd::statistics::median;

mod result;
mod seen;
#[cfg(test)]
mod tests;

pub use result::GROUND_CLASS;
use result::MeasuredShot;
pub use seen::SeenFootprint;

/// Registry entry of the stage.
pub const STAGE: StageSpec =
    StageSpec::transform::<MeasureFootprints>("measure_footprints", &[Kind::Shots, Kind::Footprints])
        .making(Kind::Returns);

/// Width of outgoing pulses while none has shown its own, samples.
const USUAL_WIDTH_SAMPLES: f64 = 15.0;
/// Part of the echoes, the narrowest, that give the response without outgoing pulses.
const NARROWEST: f64 = 0.02;
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
        MeasureFootprints { preset: None, reflectance_ratio: 1.5, shots: 1000 }
    }
}

impl MeasureFootprints {
    fn settings(&self) -> FootprintSettings {
        self.preset.and_then(|preset| FootprintSettings::gedi_l2a(preset.group())).unwrap_or_default()
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
}

impl TransformConfig for MeasureFootprints {
    fn outputs(&self) -> Vec<&str> {
        Vec::new()
    }

    fn holds(&self) -> Holds {
        Holds::First
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>> {
        Ok(Box::new(Measurer {
            config: self.clone(),
            pool: run.pool.clone(),
            look_ahead: LookAhead::new(self.shots),
            beam: None,
            has_learnt: false,
            failure: None,
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
    /// Whether the model of any beam was learnt.
    has_learnt: bool,
    /// Why that of the first other beam was not.
    failure: Option<StageError>,
}

/// The current beam, and its model as soon as it is learnt.
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
        let is_enough = self.look_ahead.hold(line, "noise and response were learnt", out);
        if is_enough { self.release(out) } else { Ok(()) }
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        self.release(out)?;
        self.failure.take().filter(|_| !self.has_learnt).map_or(Ok(()), Err)
    }
}

impl Measurer {
    /// Learns the model of the current beam from the held lines, measures and emits them.
    fn release(&mut self, out: &mut Output) -> Result<()> {
        let lines = self.look_ahead.release();
        if lines.is_empty() {
            return Ok(());
        }
        let has_blocks = |line: &ScanLine| line.blocks().is_some_and(|blocks| !blocks.is_empty());
        if !lines.iter().any(has_blocks) {
            return emit_without_returns(lines, out);
        }
        let beam = self.beam.as_ref().and_then(|beam| beam.input.beam.clone());
        let Learnt { model, of_echoes } = match (learnt(&lines), &beam) {
            (Ok(learnt), _) => learnt,
            (Err(error), None) => return Err(error),
            // Other beams can be measured.
            (Err(error), Some(beam)) => {
                out.cx.warn(format!("{beam} is not measured: {error}"));
                out.cx.reject(
                    Reason::BeamNotLearnt,
                    lines.iter().map(|line| line.emissions.len() as u64).sum(),
                );
                self.failure.get_or_insert(error);
                return emit_without_returns(lines, out);
            }
        };
        self.has_learnt = true;
        let name = beam.map_or(String::new(), |beam| format!("{beam}: "));
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
        for line in lines {
            let line = self.measured(line, &model, out)?;
            out.emit(line)?;
        }
        if let Some(beam) = &mut self.beam {
            beam.model = Some(model);
        }
        Ok(())
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

fn emit_without_returns(lines: Vec<ScanLine>, out: &mut Output) -> Result<()> {
    let mut lines = lines.into_iter();
    lines.try_for_each(|line| out.emit(ScanLine { content: Content::Returns(Returns::new()), ..line }))
}

/// The longest echo block of a shot.
fn echo_block(blocks: &Blocks, emission: u32) -> Option<&Block> {
    let echoes = blocks.of_emission(emission).map(|(_, block)| block).filter(|block| block.channel.is_echo());
    echoes.max_by_key(|block| block.len())
}

/// Noise and response of a beam.
struct Learnt {
    model: FootprintModel,
    /// Number of echoes that gave the response, and number of clear ones; `None` if outgoing pulses gave it.
    of_echoes: Option<[usize; 2]>,
}

/// Learns noise and response from the shots of lines.
fn learnt(lines: &[ScanLine]) -> Result<Learnt> {
    let (mut widths, mut interval_ns) = (Vec::new(), 1.0);
    let is_outgoing = |channel: Channel| channel == Channel::Reference;
    each_block(lines, is_outgoing, |_, samples| widths.extend(outgoing_fwhm_samples(samples)));
    each_block(lines, Channel::is_echo, |block, _| interval_ns = block.interval_ns);
    let narrowest = if widths.len() < LEAST_SHOTS { NarrowestEchoes::of(lines) } else { None };
    let width = narrowest.as_ref().map_or_else(|| median(widths), |echoes| Some(echoes.fwhm_samples));
    let mut learner = FootprintLearner::new(interval_ns, width.unwrap_or(USUAL_WIDTH_SAMPLES) * interval_ns);
    match &narrowest {
        None => each_block(lines, is_outgoing, |_, samples| learner.add_outgoing(samples)),
        Some(echoes) => each_block(lines, Channel::is_echo, |_, samples| {
            if echoes.includes(samples) {
                learner.add_echo(samples);
            }
        }),
    }
    each_block(lines, Channel::is_echo, |_, samples| learner.add_waveform(samples));
    let model = learner.finish().map_err(|error| {
        StageError::failed(
            error.to_string(),
            "read a longer part of the beam, or leave the beam out with `beams` of read_hdf5; small footprints are for `calibrate` and `decompose`",
        )
    })?;
    Ok(Learnt { model, of_echoes: narrowest.map(|echoes| [echoes.count, echoes.of]) })
}

/// The narrowest echoes of lines, which are as wide as the outgoing pulse if they are from flat ground.
struct NarrowestEchoes {
    /// Their median full width at half maximum, samples.
    fwhm_samples: f64,
    /// Their largest spread, samples.
    spread_samples: f64,
    /// Their number, and the number of clear echoes.
    count: usize,
    of: usize,
}

impl NarrowestEchoes {
    /// `None` if there are too few.
    fn of(lines: &[ScanLine]) -> Option<NarrowestEchoes> {
        let mut widths = Vec::new();
        each_block(lines, Channel::is_echo, |_, samples| widths.extend(EchoWidth::of(samples)));
        widths.sort_unstable_by(|a, b| a.spread_samples.total_cmp(&b.spread_samples));
        let count = ((NARROWEST * widths.len() as f64) as usize).max(LEAST_SHOTS);
        let narrowest = widths.get(..count)?;
        Some(NarrowestEchoes {
            fwhm_samples: median(narrowest.iter().map(|width| width.fwhm_samples))?,
            spread_samples: narrowest.last()?.spread_samples,
            count,
            of: widths.len(),
        })
    }

    fn includes(&self, samples: &[f32]) -> bool {
        EchoWidth::of(samples).is_some_and(|width| width.spread_samples <= self.spread_samples)
    }
}

/// Gives each block of these channels with its samples.
fn each_block(lines: &[ScanLine], is_wanted: fn(Channel) -> bool, mut take: impl FnMut(&Block, &[f32])) {
    let mut samples = Vec::new();
    for blocks in lines.iter().filter_map(|line| line.blocks()) {
        for block in blocks.iter().filter(|block| is_wanted(block.channel)) {
            blocks.fractions_into(block, &mut samples);
            take(block, &samples);
        }
    }
}
