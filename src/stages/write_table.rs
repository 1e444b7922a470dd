//! `write_table`: every return in full precision, as Arrow, Parquet or CSV.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::container_info::time_scale_of;
use crate::batch::{Batch, Kind, TimeScale};
use crate::stage::{
    self, Context, InvalidKey, Item, OutputFile, Result, Sink, SinkConfig, Site, StageError, StageSpec,
};

mod columns;
mod writer;

pub use columns::{Row, description};
pub use writer::{Format, ROWS_PER_GROUP, TableWriter};

/// The stage's place in the registry.
pub const STAGE: StageSpec = StageSpec::sink::<Config>("write_table", &[Kind::Returns, Kind::Points]);

/// Writes every return as a row of a table, in full precision.
///
/// What LAS rounds (amplitudes, deviation ratios, times) stands here as it was computed, with every standard deviation.
/// The file is Arrow IPC (`pyarrow.ipc.open_file`,
/// `polars.read_ipc`), Parquet (`read_parquet` of DuckDB, pandas and R) or CSV.
///
/// The columns, in this order, are: shot, gps_time_s, return_number, number_of_returns, channel, mta_zone, range_m,
/// range_sd_m, time_of_flight_ns, time_of_flight_sd_ns, amplitude_dn, amplitude_sd_dn, amplitude_db, width_ratio,
/// width_ratio_sd, fwhm_ns, thickness_m, thickness_sd_m, deviation_ratio, intensity, intensity_sd, flags, withheld,
/// class, x, y, z. Their types and meanings stand in `schemas/return_table.json`. gps_time_s, mta_zone and amplitude_db
/// are null where they are not known, x, y and z before `georeference`; another quantity that is not known is NaN.
///
/// Rows are written in groups of 65 536, so that the memory stays bounded and the same returns give the same bytes.
/// Withheld returns are written, and marked. A table without returns has its columns and no rows. Rejected, and
/// counted, are returns whose emission the line does not hold.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// The file to write; `*` is the input's name. Its extension names the format: `.arrow`, `.parquet`, `.csv`.
    pub path: String,
    /// The format, where the extension does not name it.
    pub format: Option<Format>,
}

impl Default for Config {
    fn default() -> Config {
        Config { path: "*_returns.parquet".into(), format: None }
    }
}

impl Config {
    fn format(&self) -> Option<Format> {
        self.format.or_else(|| Format::of(&self.path))
    }
}

impl stage::Config for Config {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(!self.path.is_empty(), "path", "the path is empty")?;
        let problem = "it ends neither with .arrow nor .parquet nor .csv: give the key `format`";
        InvalidKey::unless(self.format().is_some(), "path", problem)
    }
}

impl SinkConfig for Config {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, site: &Site) -> Result<Box<dyn Sink>> {
        let format = self.format().unwrap_or(Format::Parquet);
        Ok(Box::new(WriteTable { state: State::Waiting(site.create(&self.path)?), format }))
    }
}

/// A table that is being written.
struct WriteTable {
    state: State,
    format: Format,
}

enum State {
    /// The first line says what its times count.
    Waiting(OutputFile),
    Open(Box<TableWriter<OutputFile>>),
    /// A write failed: the run is over.
    Failed,
}

impl WriteTable {
    fn writer(&mut self, time_scale: TimeScale) -> Result<&mut TableWriter<OutputFile>> {
        if let State::Waiting(_) = self.state
            && let State::Waiting(to) = std::mem::replace(&mut self.state, State::Failed)
        {
            let path = to.path().to_path_buf();
            let time_scale = time_scale_of(time_scale).name();
            self.state = State::Open(Box::new(TableWriter::new(to, &path, self.format, time_scale)?));
        }
        match &mut self.state {
            State::Open(writer) => Ok(writer),
            _ => Err(StageError::Stopped),
        }
    }
}

impl Sink for WriteTable {
    fn write(&mut self, batch: &Batch, cx: &mut Context) -> Result<()> {
        let Some(returns) = batch.returns() else {
            return Err(StageError::failed(
                format!("write_table was given {}, and writes Returns or Points", batch.kind()),
                "put it behind `decompose`",
            ));
        };
        let writer = self.writer(batch.input.time_scale)?;
        let points = batch.points().unwrap_or_default();
        for (index, found) in returns.iter().enumerate() {
            let Some(emission) = batch.emissions.get(found.emission as usize) else {
                cx.reject(Item::Returns, "its emission is not in the line", 1);
                continue;
            };
            writer.push(Row {
                shot: emission.shot,
                gps_time_s: emission.gps_time_s,
                found: *found,
                point: points.get(index).copied(),
            })?;
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>, cx: &mut Context) -> Result<()> {
        // A table without a line still has its columns.
        self.writer(TimeScale::Unknown)?;
        if let State::Open(writer) = self.state {
            cx.keep(writer.finish()?.finish()?);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
