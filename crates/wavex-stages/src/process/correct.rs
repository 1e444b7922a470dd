//! `correct`: removes amplitude, range and angle effects from returns.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::process::calibrate::{Auto, write_model};
use crate::process::decompose::Threshold;
use wavex_formats::lookup_tables::LookupTables;
use wavex_line::keys::{InvalidKey, above, at_least};
use wavex_line::scan_line::{Content, Kind, ScanLine};
use wavex_line::stage::{
    Config, Holds, Learning, Learns, LookAhead, Output, OutputFile, Result, RunContext, StageError,
    StageSpec, Transform, TransformConfig,
};

mod apply;
mod tables;
#[cfg(test)]
mod tests;
mod walk;
mod width;

use apply::Corrections;
use walk::Walks;
pub use walk::{Loaded, WalkKey};
use width::WidthCorrection;

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::transform::<Correct>("correct", &[Kind::Returns]);

/// Number of waveforms used to estimate the widths of flat targets.
pub const WAVEFORMS: u64 = 50_000;

/// Corrects amplitude-, range- and angle-dependent effects on returns.
///
/// Corrects ranges with the instrument's range table, intensities with its amplitude table and for
/// range, incidence angle and attenuation, and widths for amplitude. Every correction propagates
/// its uncertainty into the standard deviations. `docs/explanation/corrections.md` gives formulas and units.
///
/// Tables are read at the level of the peak in the receiver that gives the intensity: background
/// plus fitted height. A table file has columns (digitiser steps, value of the low-power receiver
/// and, if there are two receivers, value of the high-power receiver), or is JSON: `{"low":
/// [[steps, value], ...], "high": [...]}`, in which a third number is a weight for the fit. If a
/// table is requested but the recording has none, the report says so.
///
/// Without this stage, intensities are those that `decompose` computes with the instrument's
/// amplitude table.
///
/// A receiver without a range table may have a range walk, a delay by amplitude. `range_walk =
/// "auto"` learns it from the recording: neighbouring single returns on a smooth surface differ in
/// amplitude, not in range. Heights that follow the reflectance imitate a walk, so it is applied only
/// if it proves itself: learnt on one half of the scan lines, it must explain the second differences of
/// the other half, both ways, and equally on every kind of surface. `save_model` saves it with the
/// sensor model, for other recordings of the instrument. Width corrections likewise must make the
/// widths of the other half depend less on the amplitude. The report has the figures.
///
/// If `range_walk` or a width correction is `"auto"`, holds back the first lines until it has 50 000
/// waveforms.
///
/// Counts `np_range np_atm np_ibrc np_ibic`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Correct {
    /// Correct ranges for amplitude: with the recording's own table (`true`), not at all (`false`),
    /// or with the tables of this file, which give the delay of the echo in seconds.
    pub range_table: TableKey,
    /// Smooth the range table first, with a penalised cubic in the logarithm of the digitiser
    /// steps.
    pub range_table_fit: bool,
    /// Delay of a receiver by amplitude, where it has no range table and `range_table` is not
    /// `false`: `"model"`, that of the sensor model that `calibrate` loaded, or none; `"auto"`, learnt
    /// from the first waveforms with that walk as prior, and used if it proves itself; the path of a
    /// model saved by `save_model`; or `false`.
    pub range_walk: WalkKey,
    /// Save the sensor model with the range walk to this JSON file; `*` is the name of the recording.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub save_model: Option<String>,
    /// Derive amplitudes in dB, and intensities from them: with the recording's own table (`true`),
    /// not at all (`false`: the intensity is the pulse height), or with the tables of this file, in
    /// dB above the detection limit.
    pub amplitude_table: TableKey,
    /// Width correction of the low-power receiver for amplitude: `"auto"`, estimated from the first
    /// waveforms; a number `c`: widths are divided by `(amplitude / 100 DN)^c`; pairs of amplitude
    /// (DN) and width ratio of a flat target, by ascending amplitude; or `false`.
    pub width_correction_low: WidthKey,
    /// The same for the high-power receiver.
    pub width_correction_high: WidthKey,
    /// Correct intensities for the angle of incidence on flat terrain, or not. If the vertical is
    /// unknown (scanner frame), they are not corrected, and the report says so.
    pub incidence: Incidence,
    /// Reference range to which intensities are normalised, m; `false`: no range correction. Recordings without the sensor position (LAS) are corrected neither for range nor
    /// for attenuation, and the report says so.
    #[schemars(transform = at_least(1.0).at_most(100_000.0))]
    pub reference_range_m: Threshold,
    /// One-way atmospheric attenuation, dB/km. Intensities are corrected for the two-way
    /// attenuation beyond `reference_range_m`; `false`: no correction.
    #[schemars(transform = at_least(0.0).at_most(100.0))]
    pub attenuation_db_per_km: Threshold,
}

/// Source of a table: the recording, none, or a file.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum TableKey {
    /// The recording's own table, or none.
    Own(bool),
    /// The tables of a file.
    File(PathBuf),
}

/// Dependence of width on amplitude.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum WidthKey {
    /// Estimated from the first waveforms.
    Auto(Auto),
    /// A power of the amplitude.
    Power(#[schemars(range(min = -1.0, max = 1.0))] f64),
    /// Amplitudes (DN), and width ratios of a flat target.
    Pairs(#[schemars(transform = above(0.0).at_most(1e6))] Vec<[f64; 2]>),
    /// `false`: no dependence.
    #[schemars(extend("const" = false))]
    Without(bool),
}

/// Terrain model for the angle of incidence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Incidence {
    /// Level terrain.
    Flat,
    /// Unknown: intensities are not corrected.
    None,
}

impl Default for Correct {
    fn default() -> Correct {
        Correct {
            range_table: TableKey::Own(true),
            range_table_fit: true,
            range_walk: WalkKey::Loaded(Loaded::Model),
            save_model: None,
            amplitude_table: TableKey::Own(true),
            width_correction_low: WidthKey::Auto(Auto::Auto),
            width_correction_high: WidthKey::Auto(Auto::Auto),
            incidence: Incidence::Flat,
            reference_range_m: Threshold::Number(1000.0),
            attenuation_db_per_km: Threshold::Without(false),
        }
    }
}

impl Config for Correct {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        width::check("width_correction_low", &self.width_correction_low)?;
        width::check("width_correction_high", &self.width_correction_high)?;
        InvalidKey::unless(
            self.save_model.is_none() || self.range_walk.is_auto() || self.range_walk.file().is_some(),
            "save_model",
            "it saves the range walk: set `range_walk = \"auto\"`, or save the model with `save` of calibrate",
        )
    }

    fn inputs(&self) -> Vec<&str> {
        let tables = [&self.range_table, &self.amplitude_table].into_iter().filter_map(TableKey::file);
        tables.chain(self.range_walk.file().and_then(Path::to_str)).collect()
    }
}

impl TableKey {
    fn file(&self) -> Option<&str> {
        match self {
            TableKey::File(path) => path.to_str(),
            TableKey::Own(_) => None,
        }
    }
}

impl TransformConfig for Correct {
    fn outputs(&self) -> Vec<&str> {
        self.save_model.as_deref().into_iter().collect()
    }

    fn holds(&self) -> Holds {
        Holds::First
    }

    fn learns(&self) -> Option<Learns> {
        let learns_walk = self.range_walk.is_auto() && self.range_table != TableKey::Own(false);
        learns_walk.then_some(Learns { waveforms: WAVEFORMS, makes_model: false })
    }

    fn learn(&self, lines: &mut Vec<ScanLine>, learning: &mut Learning) -> Result<()> {
        let tables = self.corrections(learning.run)?;
        let tables = lines.first().map(|line| tables.range_tables(&line.input)).unwrap_or_default();
        if let Some(model) = &mut learning.known.sensor_model {
            *model = Arc::new(Walks::learnt(lines, &tables, learning.cx).with_walks(model));
        }
        Ok(())
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>> {
        let corrections = self.corrections(run)?;
        let [low, high] =
            [&self.width_correction_low, &self.width_correction_high].map(WidthCorrection::given);
        let walks = match &self.range_walk {
            WalkKey::File(path) => WalkSource::Known(Walks::open(&run.input_path(path))?),
            WalkKey::Without(_) => WalkSource::Known(Walks::default()),
            // Without a correction of ranges for amplitude, none is learnt either.
            _ if self.range_table == TableKey::Own(false) => WalkSource::Known(Walks::default()),
            WalkKey::Loaded(Loaded::Model) => WalkSource::Model,
            WalkKey::Auto(_) => WalkSource::Learnt,
        };
        let save_model = self.save_model.as_ref().filter(|_| run.has_outputs);
        let save_model = save_model.map(|pattern| run.create(pattern)).transpose()?;
        let look_ahead = LookAhead::new(WAVEFORMS);
        Ok(Box::new(Corrector { corrections, widths: [low, high], walks, save_model, look_ahead }))
    }
}

impl Correct {
    /// The corrections, with the tables of the job.
    fn corrections(&self, run: &RunContext) -> Result<Corrections> {
        let open = |key: &TableKey| match key {
            TableKey::File(path) => LookupTables::open(&run.input_path(path)).map(Some),
            TableKey::Own(_) => Ok(None),
        };
        Corrections::new(self, open(&self.range_table)?, open(&self.amplitude_table)?)
    }
}

struct Corrector {
    corrections: Corrections,
    /// For the low-power and the high-power receiver; `None` until estimated.
    widths: [Option<WidthCorrection>; 2],
    walks: WalkSource,
    /// File for the model; `None` once written.
    save_model: Option<OutputFile>,
    look_ahead: LookAhead,
}

/// Where the range walks come from.
enum WalkSource {
    /// The sensor model of the first line.
    Model,
    /// The first waveforms.
    Learnt,
    Known(Walks),
}

impl Transform for Corrector {
    fn process(&mut self, line: ScanLine, out: &mut Output) -> Result<()> {
        if matches!(self.walks, WalkSource::Model) {
            self.walks = WalkSource::Known(Walks::of_model(std::slice::from_ref(&line), out.cx));
        }
        if let ([Some(low), Some(high)], WalkSource::Known(walks)) = (&self.widths, &self.walks) {
            save(&mut self.save_model, walks, &line, out)?;
            return correct(&mut self.corrections, [low, high], walks, line, out);
        }
        let is_enough = self.look_ahead.hold(line, "corrections were estimated", out);
        if is_enough { self.release(out) } else { Ok(()) }
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        if self.look_ahead.lines().is_empty() { Ok(()) } else { self.release(out) }
    }
}

impl Corrector {
    /// Estimates the widths from the held lines and emits these.
    fn release(&mut self, out: &mut Output) -> Result<()> {
        let [low, high] = width::CHANNELS.map(|channel| {
            let given = self.widths[usize::from(channel == width::CHANNELS[1])].take();
            given.unwrap_or_else(|| WidthCorrection::learnt(self.look_ahead.lines(), channel, out.cx))
        });
        let lines = self.look_ahead.lines();
        let walks = match std::mem::replace(&mut self.walks, WalkSource::Learnt) {
            WalkSource::Known(walks) => walks,
            WalkSource::Model => Walks::of_model(lines, out.cx),
            WalkSource::Learnt => {
                let tables = lines.first().map(|line| self.corrections.range_tables(&line.input));
                Walks::learnt(lines, &tables.unwrap_or_default(), out.cx)
            }
        };
        for line in self.look_ahead.release() {
            save(&mut self.save_model, &walks, &line, out)?;
            correct(&mut self.corrections, [&low, &high], &walks, line, out)?;
        }
        self.widths = [Some(low), Some(high)];
        self.walks = WalkSource::Known(walks);
        Ok(())
    }
}

/// Saves the sensor model of a line with the walks, unless done.
fn save(file: &mut Option<OutputFile>, walks: &Walks, line: &ScanLine, out: &mut Output) -> Result<()> {
    match (&line.model, file.take()) {
        (_, None) => Ok(()),
        (Some(model), Some(file)) => {
            if walks.is_empty() {
                out.cx.warn("the saved sensor model has no range walk: none proved itself");
            }
            write_model(&walks.with_walks(model), file, out)
        }
        (None, Some(_)) => Err(StageError::failed(
            "`save_model` needs a sensor model",
            "add calibrate and decompose before correct",
        )),
    }
}

/// Corrects a line and emits it.
fn correct(
    corrections: &mut Corrections,
    widths: [&WidthCorrection; 2],
    walks: &Walks,
    mut line: ScanLine,
    out: &mut Output,
) -> Result<()> {
    let Content::Returns(mut returns) = std::mem::replace(&mut line.content, Content::Returns(Vec::new()))
    else {
        return Err(StageError::failed("correct received no returns", "put it after decompose"));
    };
    corrections.apply(&mut line, &mut returns, widths, walks, out.cx);
    line.content = Content::Returns(returns);
    out.emit(line)
}
