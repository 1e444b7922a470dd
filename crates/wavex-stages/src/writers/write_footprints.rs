//! `write_footprints`: writes one row per shot with a large footprint as Arrow, Parquet or CSV.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::table::{TableFormat, TableInfo, TableWriter};
use crate::container_info::time_scale_of;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{InputInfo, Kind, ScanLine};
use wavex_line::stage::{
    self, Context, OutputFile, Result, RunContext, Sink, SinkConfig, StageError, StageSpec,
};

mod columns;
#[cfg(test)]
mod tests;

pub use columns::{FootprintColumns, FootprintRow};

/// Registry entry of the stage.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteFootprints>("write_footprints", &[Kind::Returns, Kind::Points])
        .after(&["measure_footprints"]);

/// LAS class of the ground.
const GROUND_CLASS: u8 = 2;

/// Writes ground, canopy and relative heights of every shot that `measure_footprints` has measured.
///
/// One row per shot. The columns, in this order, are: shot, shot_number, beam, gps_time_s, x, y, z (of the
/// ground; null before `georeference` and without ground), ground_sd_m, ground_probability, modes, energy_dn, energy_sd_dn, ground_energy_ratio, ground_energy_ratio_sd, cover, cover_sd,
/// plant_area_index, plant_area_index_sd, sensitivity, deviation_ratio, flags, rh_m and rh_sd_m, then the further values
/// of the recording under their own names. Each column has its meaning as metadata. rh_m and rh_sd_m are lists of 101
/// values, for 0, 1, … 100 % of the energy; in CSV they are columns rh0_m to rh100_m and rh0_sd_m to rh100_sd_m.
/// Unknown quantities are NaN.
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

impl WriteFootprints {
    fn format(&self) -> Option<TableFormat> {
        self.format.or_else(|| TableFormat::of(&self.path))
    }
}

impl stage::Config for WriteFootprints {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(!self.path.is_empty(), "path", "the path is empty")?;
        let problem = "it does not end in .arrow, .parquet or .csv: set the key `format`";
        InvalidKey::unless(self.format().is_some(), "path", problem)
    }
}

impl SinkConfig for WriteFootprints {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        let format = self.format().unwrap_or(TableFormat::Parquet);
        Ok(Box::new(FootprintTableWriter { state: TableState::Waiting(run.create(&self.path)?), format }))
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
    state: TableState,
    format: TableFormat,
}

enum TableState {
    /// Waiting for the first line, which gives time scale and columns.
    Waiting(OutputFile),
    Open(Box<TableWriter<OutputFile, FootprintColumns>>),
    /// A write failed; the run ends.
    Failed,
}

impl FootprintTableWriter {
    /// The table, started with what the first line has.
    fn writer(
        &mut self,
        input: &InputInfo,
        has_points: bool,
    ) -> Result<&mut TableWriter<OutputFile, FootprintColumns>> {
        if let TableState::Waiting(_) = self.state
            && let TableState::Waiting(to) = std::mem::replace(&mut self.state, TableState::Failed)
        {
            let path = to.path().to_path_buf();
            let time_scale = time_scale_of(input.time_scale).name();
            let info = TableInfo { time_scale, crs_wkt: input.crs_wkt.as_deref(), has_points };
            let columns = FootprintColumns::of(&input.columns);
            self.state = TableState::Open(Box::new(TableWriter::new(to, &path, self.format, columns, info)?));
        }
        match &mut self.state {
            TableState::Open(writer) => Ok(writer),
            _ => Err(StageError::Stopped),
        }
    }
}

impl Sink for FootprintTableWriter {
    fn write(&mut self, line: &ScanLine, _: &mut Context) -> Result<()> {
        let writer = self.writer(&line.input, line.points().is_some())?;
        for row in rows_of(line) {
            writer.push(row)?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>, cx: &mut Context) -> Result<()> {
        // A table without lines still has its columns.
        self.writer(&InputInfo::default(), false)?;
        if let TableState::Open(writer) = self.state {
            cx.publish(writer.finish()?.finish()?);
        }
        Ok(())
    }
}
