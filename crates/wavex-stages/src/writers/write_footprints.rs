//! `write_footprints`: writes one row per shot with a large footprint as Arrow, Parquet or CSV.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::table::{SinkTable, TableFormat, format_of};
use crate::process::measure_footprints::GROUND_CLASS;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{Kind, ScanLine};
use wavex_line::stage::{self, Context, Result, RunContext, Sink, SinkConfig, StageSpec};

mod columns;
#[cfg(test)]
mod tests;

pub use columns::{FootprintColumns, FootprintRow};

/// Registry entry of the stage.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteFootprints>("write_footprints", &[Kind::Returns, Kind::Points])
        .after(&["measure_footprints"]);

/// Writes ground, canopy and relative heights of every shot that `measure_footprints` has measured.
///
/// One row per shot. The columns, in this order, are: shot, shot_number, beam, gps_time_s, x, y, z (of the
/// ground; null before `georeference` and without ground), ground_sd_m, ground_probability, ground_total_sd_m,
/// second_ground_height_m, second_ground_sd_m, second_ground_probability, ground_amplitude_dn,
/// ground_amplitude_sd_dn, ground_width_below_ratio, ground_width_above_ratio, modes, energy_dn, energy_sd_dn,
/// ground_energy_ratio, ground_energy_ratio_sd, cover, cover_sd, plant_area_index, plant_area_index_sd, sensitivity, deviation, flags,
/// rh_m and rh_sd_m, then the further values of the recording under their own names. Each column has its meaning as metadata.
/// rh_m and rh_sd_m are lists of 101 values, for 0, 1, … 100 % of the energy; in CSV they are columns rh0_m to rh100_m and
/// rh0_sd_m to rh100_sd_m. Unknown quantities are NaN.
///
/// Parquet of points is GeoParquet 1.1, as in `write_table`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteFootprints {
    /// Output file; `*` is the input's stem. The extension sets the format: `.arrow`, `.parquet`,
    /// `.csv`.
    pub path: String,
    /// Format, if not given by the extension.
    pub format: Option<TableFormat>,
}

impl Default for WriteFootprints {
    fn default() -> WriteFootprints {
        WriteFootprints { path: "*_footprints.parquet".into(), format: None }
    }
}

impl stage::Config for WriteFootprints {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        format_of(&self.path, self.format).map(|_| ())
    }
}

impl SinkConfig for WriteFootprints {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        let table = SinkTable::create(run, &self.path, self.format)?;
        Ok(Box::new(FootprintTableWriter { table }))
    }
}

/// Rows of the footprints of a line.
pub fn rows_of(line: &ScanLine) -> impl Iterator<Item = FootprintRow> + '_ {
    let beam: Option<Arc<str>> = line.input.beam.as_deref().map(Arc::from);
    let points = line.points().unwrap_or_default();
    line.footprints.iter().filter_map(move |footprint| {
        let emission = line.emissions.get(footprint.emission as usize)?;
        let mut returns = line.returns().into_iter().flatten().enumerate();
        let ground =
            returns.find(|(_, found)| found.emission == footprint.emission && found.class == GROUND_CLASS);
        Some(FootprintRow {
            shot: emission.shot,
            beam: beam.clone(),
            gps_time_s: emission.gps_time_s,
            ground: ground.and_then(|(index, _)| points.get(index).copied()),
            footprint: footprint.clone(),
        })
    })
}

/// A table being written.
struct FootprintTableWriter {
    table: SinkTable<FootprintColumns>,
}

impl Sink for FootprintTableWriter {
    fn write(&mut self, line: &ScanLine, _: &mut Context) -> Result<()> {
        let columns = || FootprintColumns::of(&line.input.columns);
        let writer = self.table.writer(columns, &line.input, line.points().is_some())?;
        for row in rows_of(line) {
            writer.push(row)?;
        }
        Ok(())
    }

    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()> {
        self.table.finish(|| FootprintColumns::of(&[]), cx)
    }
}
