//! Columns of the return table: names, types, meanings and sources.

use std::fmt::Write as _;
use std::sync::Arc;

use arrow_array::{
    ArrayRef, BooleanArray, Float64Array, Int16Array, RecordBatch, StringArray, UInt8Array, UInt16Array,
    UInt64Array,
};
use arrow_schema::{ArrowError, DataType, Field, Metadata, Schema, SchemaRef};
use serde_json::{Value, json};

use crate::writers::table::TableColumns;
use wavex_line::scan_line::{Return, ShotProfile};

/// One return, with the fields of its shot that the table needs.
#[derive(Clone, Copy, Debug)]
pub struct ReturnRow {
    /// Running number of the shot.
    pub shot: u64,
    /// Time of the shot, s; NaN where unknown.
    pub gps_time_s: f64,
    /// The return.
    pub found: Return,
    /// Position in the output frame, if known.
    pub point: Option<[f64; 3]>,
    /// Profile of the target of its shot, if it is distributed.
    pub profile: Option<ShotProfile>,
}

/// A column.
pub(super) struct ReturnColumn {
    name: &'static str,
    values: ColumnValues,
    meaning: &'static str,
}

/// Type of a column, and how a row gives its value; `Maybe...` may be null.
enum ColumnValues {
    U8(fn(&ReturnRow) -> u8),
    U16(fn(&ReturnRow) -> u16),
    U64(fn(&ReturnRow) -> u64),
    MaybeI16(fn(&ReturnRow) -> Option<i16>),
    F64(fn(&ReturnRow) -> f64),
    MaybeF64(fn(&ReturnRow) -> Option<f64>),
    Bool(fn(&ReturnRow) -> bool),
    Text(fn(&ReturnRow) -> &'static str),
}

fn known(value: f64) -> Option<f64> {
    Some(value).filter(|value| !value.is_nan())
}

fn of_profile<T>(row: &ReturnRow, value: fn(&ShotProfile) -> T) -> Option<T> {
    row.profile.as_ref().map(value)
}

const fn column(name: &'static str, values: ColumnValues, meaning: &'static str) -> ReturnColumn {
    ReturnColumn { name, values, meaning }
}

#[rustfmt::skip]
pub(super) static COLUMNS: &[ReturnColumn] = &[
    column("shot", ColumnValues::U64(|row| row.shot), "running number of the shot, from 0"),
    column("gps_time_s", ColumnValues::MaybeF64(|row| known(row.gps_time_s)), "time of the shot, s, on the scale of the metadata `wavex.time_scale`"),
    column("return_number", ColumnValues::U8(|row| row.found.return_number), "1 for the first return of its shot"),
    column("number_of_returns", ColumnValues::U8(|row| row.found.number_of_returns), "number of returns of the shot, including withheld ones"),
    column("channel", ColumnValues::Text(|row| row.found.channel.name()), "the receiver that gave the intensity: `low`, `high` or `joint`"),
    column("mta_zone", ColumnValues::MaybeI16(|row| Some(row.found.mta_zone).filter(|&zone| zone != -1)), "number of emissions between the causing shot and the reception; null if unresolved"),
    column("range_m", ColumnValues::F64(|row| row.found.range_m), "range along the beam from the origin of the shot, m: from the sensor, or from the first sample for recordings without the sensor position (LAS)"),
    column("range_sd_m", ColumnValues::F64(|row| row.found.range_sd_m), "standard deviation of range_m"),
    column("time_of_flight_ns", ColumnValues::F64(|row| row.found.time_of_flight_ns), "echo minus outgoing pulse, both at the peak of the response, ns"),
    column("time_of_flight_sd_ns", ColumnValues::F64(|row| row.found.time_of_flight_sd_ns), "standard deviation of time_of_flight_ns"),
    column("amplitude_dn", ColumnValues::F64(|row| row.found.amplitude_dn), "peak height of the fitted pulse above the background, digitiser steps"),
    column("amplitude_sd_dn", ColumnValues::F64(|row| row.found.amplitude_sd_dn), "standard deviation of amplitude_dn"),
    column("amplitude_db", ColumnValues::MaybeF64(|row| known(row.found.amplitude_db)), "amplitude above the detection limit from the amplitude table of the input, dB; null without a table"),
    column("width_ratio", ColumnValues::F64(|row| row.found.width_ratio), "full width at half maximum over that of the system response; 1 for a flat target"),
    column("width_ratio_sd", ColumnValues::F64(|row| row.found.width_ratio_sd), "standard deviation of width_ratio"),
    column("fwhm_ns", ColumnValues::F64(|row| row.found.fwhm_ns), "full width at half maximum, ns"),
    column("thickness_m", ColumnValues::F64(|row| row.found.thickness_m), "full width at half maximum of the target along the beam, m"),
    column("thickness_sd_m", ColumnValues::F64(|row| row.found.thickness_sd_m), "standard deviation of thickness_m"),
    column("deviation_ratio", ColumnValues::F64(|row| row.found.deviation_ratio), "(chi-square - degrees of freedom) / sqrt(2 degrees of freedom) of the waveform's fit, with its sign"),
    column("intensity", ColumnValues::F64(|row| row.found.intensity), "amplitude after all corrections"),
    column("intensity_sd", ColumnValues::F64(|row| row.found.intensity_sd), "standard deviation of intensity"),
    column("flags", ColumnValues::U16(|row| row.found.flags), "low byte: the LAS user data; 8 overdriven, 9 truncated, 10 split, 11 zone uncertain"),
    column("withheld", ColumnValues::Bool(|row| row.found.withheld), "marked as an outlier"),
    column("class", ColumnValues::U8(|row| row.found.class), "LAS class: 0; of outliers 7 (low) or 18 (high)"),
    column("x", ColumnValues::MaybeF64(|row| row.point.map(|point| point[0])), "coordinate in the output frame; null before `georeference`"),
    column("y", ColumnValues::MaybeF64(|row| row.point.map(|point| point[1])), "see x"),
    column("z", ColumnValues::MaybeF64(|row| row.point.map(|point| point[2])), "see x"),
    column("total_uncertainty_m", ColumnValues::MaybeF64(|row| known(row.found.total_sd_m)), "square root of the trace of the covariance of the point, m: position, attitude × range and range; null if the trajectory has no accuracies"),
    column("height_above_ground_m", ColumnValues::MaybeF64(|row| known(f64::from(row.found.height_above_ground_m))), "height above the ground points around, m; null unless `classify` computes it, and outside the ground points"),
    column("profile_peaks", ColumnValues::MaybeI16(|row| of_profile(row, |p| p.peaks.min(9999) as i16)), "number of significant modes of the waveform of the shot; null, as all columns of the profile, for shots without one"),
    column("profile_first_range_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.first_range_m.value)), "range of the first significant mode, m"),
    column("profile_first_range_sd_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.first_range_m.sd)), "standard deviation of profile_first_range_m"),
    column("profile_last_range_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.last_range_m.value)), "range of the last significant mode, m: the ground; NaN if it is missing"),
    column("profile_last_range_sd_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.last_range_m.sd)), "standard deviation of profile_last_range_m"),
    column("rh25_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.heights_m[0].value)), "relative height along the beam: 25 % of the energy of the waveform lies below it, counted from the ground, m; NaN if the ground or the top is missing"),
    column("rh25_sd_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.heights_m[0].sd)), "standard deviation of rh25_m"),
    column("rh50_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.heights_m[1].value)), "as rh25_m, of 50 %"),
    column("rh50_sd_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.heights_m[1].sd)), "standard deviation of rh50_m"),
    column("rh75_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.heights_m[2].value)), "as rh25_m, of 75 %"),
    column("rh75_sd_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.heights_m[2].sd)), "standard deviation of rh75_m"),
    column("rh98_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.heights_m[3].value)), "as rh25_m, of 98 %"),
    column("rh98_sd_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.heights_m[3].sd)), "standard deviation of rh98_m"),
    column("rh100_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.top_m.value)), "height above the ground at which the signal begins, m"),
    column("rh100_sd_m", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.top_m.sd)), "standard deviation of rh100_m"),
    column("profile_energy_dn", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.energy_dn.value)), "energy of the waveform, as the height of a flat target's echo of the same energy, digitiser steps"),
    column("profile_energy_sd_dn", ColumnValues::MaybeF64(|row| of_profile(row, |p| p.energy_dn.sd)), "standard deviation of profile_energy_dn"),
    column("profile_flags", ColumnValues::MaybeI16(|row| of_profile(row, |p| i16::from(p.flags))), "1: the ground is missing, 2: the signal begins before the block, 4: clipped samples"),
];

impl ColumnValues {
    fn data_type(&self) -> DataType {
        match self {
            ColumnValues::U8(_) => DataType::UInt8,
            ColumnValues::U16(_) => DataType::UInt16,
            ColumnValues::U64(_) => DataType::UInt64,
            ColumnValues::MaybeI16(_) => DataType::Int16,
            ColumnValues::F64(_) | ColumnValues::MaybeF64(_) => DataType::Float64,
            ColumnValues::Bool(_) => DataType::Boolean,
            ColumnValues::Text(_) => DataType::Utf8,
        }
    }

    fn nullable(&self) -> bool {
        matches!(self, ColumnValues::MaybeI16(_) | ColumnValues::MaybeF64(_))
    }

    fn array(&self, rows: &[ReturnRow]) -> ArrayRef {
        let rows = rows.iter();
        match self {
            ColumnValues::U8(value) => Arc::new(UInt8Array::from_iter_values(rows.map(value))),
            ColumnValues::U16(value) => Arc::new(UInt16Array::from_iter_values(rows.map(value))),
            ColumnValues::U64(value) => Arc::new(UInt64Array::from_iter_values(rows.map(value))),
            ColumnValues::MaybeI16(value) => Arc::new(rows.map(value).collect::<Int16Array>()),
            ColumnValues::F64(value) => Arc::new(Float64Array::from_iter_values(rows.map(value))),
            ColumnValues::MaybeF64(value) => Arc::new(rows.map(value).collect::<Float64Array>()),
            ColumnValues::Bool(value) => Arc::new(rows.map(|row| Some(value(row))).collect::<BooleanArray>()),
            ColumnValues::Text(value) => Arc::new(StringArray::from_iter_values(rows.map(value))),
        }
    }
}

impl ColumnValues {
    /// Adds the value of a row as text, nothing for null; a number is read back exactly.
    fn add_text(&self, row: &ReturnRow, text: &mut String) {
        let added = match self {
            ColumnValues::U8(value) => write!(text, "{}", value(row)),
            ColumnValues::U16(value) => write!(text, "{}", value(row)),
            ColumnValues::U64(value) => write!(text, "{}", value(row)),
            ColumnValues::MaybeI16(value) => value(row).map_or(Ok(()), |value| write!(text, "{value}")),
            ColumnValues::F64(value) => write!(text, "{:?}", value(row)),
            ColumnValues::MaybeF64(value) => value(row).map_or(Ok(()), |value| write!(text, "{value:?}")),
            ColumnValues::Bool(value) => write!(text, "{}", value(row)),
            // Names without commas or quotes.
            ColumnValues::Text(value) => write!(text, "{}", value(row)),
        };
        debug_assert!(added.is_ok(), "a string accepts text");
    }
}

/// The columns of the table of returns.
#[derive(Clone, Copy, Debug, Default)]
pub struct ReturnColumns;

impl TableColumns for ReturnColumns {
    type Row = ReturnRow;

    /// Each field has its `description`, and its `unit` if it has one.
    fn schema(&self, time_scale: &str, crs_wkt: Option<&str>) -> SchemaRef {
        let field = |column: &ReturnColumn| {
            let about = described(column.name, column.meaning);
            let data_type = column.values.data_type();
            Field::new(column.name, data_type, column.values.nullable()).with_metadata(about)
        };
        let fields: Vec<Field> = COLUMNS.iter().map(field).collect();
        let metadata =
            [("wavex.table", Some("1")), ("wavex.time_scale", Some(time_scale)), ("wavex.crs", crs_wkt)];
        let metadata = metadata.into_iter().filter_map(|(key, text)| Some((key, text?)));
        Arc::new(Schema::new_with_metadata(fields, metadata.collect::<Metadata>()))
    }

    fn batch(&self, schema: &SchemaRef, rows: &[ReturnRow]) -> Result<RecordBatch, ArrowError> {
        let arrays = COLUMNS.iter().map(|column| column.values.array(rows)).collect();
        RecordBatch::try_new(Arc::clone(schema), arrays)
    }

    fn csv_header(&self) -> String {
        let names: Vec<&str> = COLUMNS.iter().map(|column| column.name).collect();
        names.join(",") + "\n"
    }

    fn csv(&self, rows: &[ReturnRow]) -> String {
        let mut text = String::new();
        for row in rows {
            for (number, column) in COLUMNS.iter().enumerate() {
                if number > 0 {
                    text.push(',');
                }
                column.values.add_text(row, &mut text);
            }
            text.push('\n');
        }
        text
    }

    fn point(row: &ReturnRow) -> Option<[f64; 3]> {
        row.point
    }
}

/// Metadata of a column: its description, and its unit if it has one.
pub(crate) fn described(name: &str, meaning: &str) -> Metadata {
    let about = [("description", Some(meaning)), ("unit", unit(name))];
    about.into_iter().filter_map(|(key, text)| Some((key, text?))).collect()
}

/// Unit of a column, which is part of its name; `None` for pure numbers and for coordinates.
fn unit(name: &str) -> Option<&'static str> {
    Some(match name.rsplit('_').next()? {
        "s" => "s",
        "ns" => "ns",
        "m" => "m",
        "db" => "dB",
        "dn" => "digitiser steps",
        _ => return None,
    })
}

/// Description of the table as JSON, stored in `schemas/return_table.json`.
pub fn description() -> Value {
    let name = |values: &ColumnValues| match values {
        ColumnValues::U8(_) => "u8",
        ColumnValues::U16(_) => "u16",
        ColumnValues::U64(_) => "u64",
        ColumnValues::MaybeI16(_) => "i16",
        ColumnValues::F64(_) | ColumnValues::MaybeF64(_) => "f64",
        ColumnValues::Bool(_) => "bool",
        ColumnValues::Text(_) => "utf8",
    };
    let columns: Vec<Value> = COLUMNS
        .iter()
        .map(|column| {
            json!({
                "name": column.name,
                "type": name(&column.values),
                "unit": unit(column.name),
                "nullable": column.values.nullable(),
                "meaning": column.meaning,
            })
        })
        .collect();
    json!({
        "title": "wavex table of returns, version 1",
        "format": "Apache Arrow IPC file, Apache Parquet, or CSV with a header line and empty fields for null",
        "row": "one return, sorted by shot, then by time",
        "columns": columns,
        "metadata": [
            {"key": "wavex.table", "form": "`1`", "meaning": "version of this layout; not in CSV"},
            {
                "key": "wavex.time_scale",
                "form": "`week`, `day`, `adjusted` or `unknown`",
                "meaning": "time scale of `gps_time_s`: seconds of the GPS week, of the day, or since 1980-01-06 minus 1e9; \
                            not in CSV",
            },
            {"key": "wavex.crs", "form": "WKT", "meaning": "coordinate reference system of x, y and z, if known; not in CSV"},
            {
                "key": "geo",
                "form": "JSON",
                "meaning": "GeoParquet 1.1: the column `geometry` (WKB of x, y and z), which follows the others in \
                            Parquet after `georeference`",
            },
        ],
    })
}
