//! `write_table`: writes every return in full precision as Arrow, Parquet or CSV.

use arrow_array::RecordBatch;
use arrow_schema::SchemaRef;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::container_info::time_scale_of;
use wavex_geodesy::crs::projjson_of_wkt;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{InputInfo, Kind, ScanLine};
use wavex_line::stage::{self, Context, Reason, Result, RunContext, Sink, SinkConfig, StageError, StageSpec};

mod columns;

pub use super::table::{ROWS_PER_GROUP, TableFormat, TableInfo, TableWriter};
use super::table::{SinkTable, TableColumns, format_of};
pub(crate) use columns::described;
pub use columns::{ReturnColumns, ReturnRow, description};

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::sink::<WriteTable>("write_table", &[Kind::Returns, Kind::Points]);

/// Writes every return as a table row, in full precision.
///
/// Values that LAS rounds (amplitudes, deviation ratios, times) are written as computed, with every
/// standard deviation. The file is Arrow IPC (`pyarrow.ipc.open_file`, `polars.read_ipc`), Parquet
/// (`read_parquet` of DuckDB, pandas and R) or CSV.
///
/// The columns, in this order, are: shot, gps_time_s, return_number, number_of_returns, channel,
/// mta_zone, range_m, range_sd_m, time_of_flight_ns, time_of_flight_sd_ns, amplitude_dn,
/// amplitude_sd_dn, amplitude_db, width_ratio, width_ratio_sd, fwhm_ns, thickness_m,
/// thickness_sd_m, deviation_ratio, intensity, intensity_sd, flags, withheld, class, x, y, z,
/// total_uncertainty_m, height_above_ground_m. `schemas/return_table.json` gives their types, units and meanings, which are
/// also metadata of the columns. gps_time_s, mta_zone and
/// amplitude_db are null if unknown; x, y and z are null before `georeference`; other unknown
/// quantities are NaN.
///
/// Parquet of points is GeoParquet 1.1: a last column, `geometry`, repeats x, y and z as WKB, with the
/// coordinate reference system as PROJJSON (geodetic, transverse Mercator and Lambert systems; for
/// others, only as WKT in the metadata `wavex.crs`). GeoPandas and DuckDB's spatial extension open it.
///
/// Rows are written in groups of 65 536, so that memory is bounded and the same returns give the
/// same bytes. Withheld returns are written, and marked. A table without returns has its columns
/// but no rows. Rejected, and counted, are returns whose shot is not in the line.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteTable {
    /// Output file; `*` is the input's stem. The extension sets the format: `.arrow`, `.parquet`,
    /// `.csv`.
    pub path: String,
    /// Format, if not given by the extension.
    pub format: Option<TableFormat>,
}

impl Default for WriteTable {
    fn default() -> WriteTable {
        WriteTable { path: "*_returns.parquet".into(), format: None }
    }
}

impl stage::Config for WriteTable {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        format_of(&self.path, self.format).map(|_| ())
    }
}

impl SinkConfig for WriteTable {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        let table = SinkTable::create(run, &self.path, self.format)?;
        Ok(Box::new(ReturnTableWriter { table }))
    }
}

/// Rows of the returns of a line, without those whose shot is not in it.
pub fn rows_of(line: &ScanLine) -> impl Iterator<Item = ReturnRow> + '_ {
    let points = line.points().unwrap_or_default();
    line.returns().into_iter().flatten().enumerate().filter_map(move |(index, found)| {
        let emission = line.emissions.get(found.emission as usize)?;
        Some(ReturnRow {
            shot: emission.shot,
            gps_time_s: emission.gps_time_s,
            found: *found,
            point: points.get(index).copied(),
            profile: line.profile(found.emission).copied(),
        })
    })
}

/// Schema of the table of returns of a recording; with the coordinate reference system of its points.
pub fn return_schema(info: &InputInfo, has_points: bool) -> SchemaRef {
    let crs_wkt = info.crs_wkt.as_deref().filter(|_| has_points);
    ReturnColumns.schema(time_scale_of(info.time_scale).name(), crs_wkt)
}

/// Rows as a record batch; `schema` is [`return_schema`].
///
/// # Errors
/// If the schema is another one.
pub fn return_batch(schema: &SchemaRef, rows: &[ReturnRow]) -> Result<RecordBatch> {
    let batch = ReturnColumns.batch(schema, rows);
    batch.map_err(|error| StageError::failed(error.to_string(), "please report this bug in wavex"))
}

/// A table being written.
struct ReturnTableWriter {
    table: SinkTable<ReturnColumns>,
}

/// Warning for a system that GeoParquet cannot store.
const NO_SYSTEM: &str = "the coordinate reference system of the points cannot be written as PROJJSON (only transverse Mercator \
     and Lambert projections and geographic systems can): `crs` of the GeoParquet metadata is null, and the WKT is in \
     `wavex.crs`";

impl Sink for ReturnTableWriter {
    fn write(&mut self, line: &ScanLine, cx: &mut Context) -> Result<()> {
        let Some(returns) = line.returns() else {
            return Err(StageError::failed(
                format!("write_table received {}, but writes Returns or Points", line.kind()),
                "put it after `decompose`",
            ));
        };
        let crs_wkt = line.input.crs_wkt.as_deref();
        let begins_geometry =
            matches!(self.table, SinkTable::Waiting(_, TableFormat::Parquet)) && line.points().is_some();
        if begins_geometry && crs_wkt.is_some_and(|wkt| projjson_of_wkt(wkt).is_none()) {
            cx.warn(NO_SYSTEM);
        }
        let writer = self.table.writer(|| ReturnColumns, &line.input, line.points().is_some())?;
        let mut rows = 0;
        for row in rows_of(line) {
            rows += 1;
            writer.push(row)?;
        }
        cx.reject(Reason::ReturnWithoutShot, (returns.len() - rows) as u64);
        Ok(())
    }

    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()> {
        self.table.finish(|| ReturnColumns, cx)
    }
}

#[cfg(test)]
mod tests;
