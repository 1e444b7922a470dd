//! What amplitude, range and direction do to ranges, widths and intensities, taken out.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::calibrate::Auto;
use super::decompose::NumberOrFalse;
use crate::batch::{Batch, Content, Kind};
use crate::formats::lookup_tables::LookupTables;
use crate::stage::{
    Config, Holds, InvalidKey, Output, Result, Site, StageError, StageSpec, Survey, Transform,
    TransformConfig,
};

mod apply;
mod tables;
#[cfg(test)]
mod tests;
mod width;

use apply::Corrections;
use width::WidthCorrection;

/// The stage's place in the registry.
pub const STAGE: StageSpec = StageSpec::transform::<Correct>("correct", &[Kind::Returns]);

/// Waveforms that the widths of flat targets are learnt from.
const WAVEFORMS: u64 = 50_000;

/// Takes out of the returns what amplitude, range and direction did to them: ranges by the instrument's range table,
/// intensities by its amplitude table, by range, incidence and air, widths by amplitude. Every correction carries its
/// uncertainty into the standard deviations. Formulas and units stand in `docs/explanation/corrections.md`.
///
/// Tables are read where the peak stands in the receiver that gives the intensity: at background plus fitted height. A file
/// of tables has columns (digitiser steps, value of the sensitive receiver and, where there are two, of the one for strong
/// echoes), or JSON: `{"low": [[steps, value], ...], "high": [...]}`, in which a third number is a weight for the fit.
/// Where a table is wanted and the recording has none, the report says so.
///
/// Without this stage, intensities are what `decompose` makes of the instrument's amplitude table.
///
/// Holds back the first lines where a width correction is `"auto"`, until it has 50 000 waveforms.
///
/// Counts `np_range np_atm np_ibrc np_ibic`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Correct {
    /// Correct ranges by amplitude: with the recording's own table (`true`), not at all (`false`), or with the tables of
    /// this file, in seconds of the echo's place.
    pub range_table: TableKey,
    /// Smooth the range table first: a penalised cubic in the logarithm of the digitiser steps.
    pub range_table_fit: bool,
    /// Take amplitudes in dB, and intensities from them, by the recording's own table (`true`), not at all (`false`: the
    /// intensity is then the height of the pulse), or by the tables of this file, in dB above the detection limit.
    pub amplitude_table: TableKey,
    /// Widths of the sensitive receiver that change with amplitude: `"auto"`, learnt from the first waveforms; a number
    /// `c`: widths are divided by `(amplitude / 100 DN)^c`; pairs of amplitude (DN) and the width ratio of a flat target,
    /// by rising amplitude; or `false`.
    pub width_correction_low: WidthKey,
    /// The same for the receiver for strong echoes.
    pub width_correction_high: WidthKey,
    /// Correct intensities for the angle at which beams meet flat terrain, or not. Without a vertical, in the scanner's own
    /// frame, they are not corrected, and the report says so.
    pub incidence: Incidence,
    /// Intensities are made those of this range, from 1 to 100000; `false`: they fall with the range. A recording that does
    /// not give the position of the sensor (LAS) is corrected neither for range nor for attenuation, and the report says so.
    pub reference_range_m: NumberOrFalse,
    /// What the air takes from the light on one kilometre, one way, from 0 to 100; intensities are freed of it both ways,
    /// beyond `reference_range_m`; `false`: nothing.
    pub attenuation_db_per_km: NumberOrFalse,
}

/// The recording's own table, none, or those of a file.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum TableKey {
    /// The recording's own, or none.
    Own(bool),
    /// Those of a file.
    File(PathBuf),
}

/// How widths depend on amplitude.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum WidthKey {
    /// Learnt from the first waveforms.
    Auto(Auto),
    /// As a power of the amplitude.
    Power(f64),
    /// Amplitudes (DN), and the width ratio of a flat target.
    Pairs(Vec<[f64; 2]>),
    /// `false`: they do not.
    Without(bool),
}

/// What the terrain is taken to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Incidence {
    /// Level.
    Flat,
    /// Unknown: intensities stay as they are.
    None,
}

impl Default for Correct {
    fn default() -> Correct {
        Correct {
            range_table: TableKey::Own(true),
            range_table_fit: true,
            amplitude_table: TableKey::Own(true),
            width_correction_low: WidthKey::Auto(Auto::Auto),
            width_correction_high: WidthKey::Auto(Auto::Auto),
            incidence: Incidence::Flat,
            reference_range_m: NumberOrFalse::Number(1000.0),
            attenuation_db_per_km: NumberOrFalse::Without(false),
        }
    }
}

impl Config for Correct {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        width::check("width_correction_low", &self.width_correction_low)?;
        width::check("width_correction_high", &self.width_correction_high)?;
        InvalidKey::unless(
            self.reference_range_m.is_within(1.0..=100_000.0),
            "reference_range_m",
            "it must lie between 1 and 100000, or be `false`",
        )?;
        InvalidKey::unless(
            self.attenuation_db_per_km.is_within(0.0..=100.0),
            "attenuation_db_per_km",
            "it must lie between 0 and 100, or be `false`",
        )
    }

    fn inputs(&self) -> Vec<&str> {
        [&self.range_table, &self.amplitude_table].into_iter().filter_map(TableKey::file).collect()
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
    fn holds(&self) -> Holds {
        Holds::First
    }

    fn make(&self, site: &Site) -> Result<Box<dyn Transform>> {
        let open = |key: &TableKey| match key {
            TableKey::File(path) => LookupTables::open(&site.input_path(path)).map(Some),
            TableKey::Own(_) => Ok(None),
        };
        let corrections = Corrections::new(self, open(&self.range_table)?, open(&self.amplitude_table)?)?;
        let [low, high] =
            [&self.width_correction_low, &self.width_correction_high].map(WidthCorrection::given);
        Ok(Box::new(Correcting { corrections, widths: [low, high], survey: Survey::new(WAVEFORMS) }))
    }
}

struct Correcting {
    corrections: Corrections,
    /// Of the sensitive receiver and of the other; `None` while they are being learnt.
    widths: [Option<WidthCorrection>; 2],
    survey: Survey,
}

impl Transform for Correcting {
    fn process(&mut self, batch: Batch, out: &mut Output) -> Result<()> {
        if let [Some(low), Some(high)] = &self.widths {
            return correct(&mut self.corrections, [low, high], batch, out);
        }
        let is_enough = self.survey.hold(batch, "widths of flat targets were learnt", out);
        if is_enough { self.release(out) } else { Ok(()) }
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        if self.survey.lines().is_empty() { Ok(()) } else { self.release(out) }
    }
}

impl Correcting {
    /// Learns the widths from the lines at hand, and gives them on.
    fn release(&mut self, out: &mut Output) -> Result<()> {
        let [low, high] = width::CHANNELS.map(|channel| {
            let given = self.widths[usize::from(channel == width::CHANNELS[1])].take();
            given.unwrap_or_else(|| WidthCorrection::learnt(self.survey.lines(), channel, out.cx))
        });
        for batch in self.survey.release() {
            correct(&mut self.corrections, [&low, &high], batch, out)?;
        }
        self.widths = [Some(low), Some(high)];
        Ok(())
    }
}

/// Corrects a line and gives it on.
fn correct(
    corrections: &mut Corrections,
    widths: [&WidthCorrection; 2],
    mut batch: Batch,
    out: &mut Output,
) -> Result<()> {
    let Content::Returns(mut returns) = std::mem::replace(&mut batch.content, Content::Returns(Vec::new()))
    else {
        return Err(StageError::failed("correct was given no returns", "put it behind decompose"));
    };
    corrections.apply(&mut batch, &mut returns, widths, out.cx);
    batch.content = Content::Returns(returns);
    out.emit(batch)
}
