//! File of the residuals (`residuals.arrow`): Arrow IPC, one row per pair of patches.
//!
//! Metadata of the schema: `wavex.residuals` is the version.

use std::collections::HashMap;
use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, Float64Array, RecordBatch, StringArray};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::{FileWriter, IpcWriteOptions};
use arrow_schema::{ArrowError, DataType, Field, Schema, SchemaRef};

use wavex_align::observation::Observation;
use wavex_formats::{Error, Result};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::frames::{ecef_from_ned_at, inverse, rotate};
use wavex_line::stage::{FinishedFile, OutputFile};

const VERSION_KEY: &str = "wavex.residuals";
const VERSION: &str = "1";
const ROWS_PER_BATCH: usize = 1 << 14;
/// Columns of numbers; `difference_before_m` may be null.
const NUMBERS: [&str; 12] = [
    "first_time_s",
    "second_time_s",
    "longitude_deg",
    "latitude_deg",
    "height_m",
    "normal_east",
    "normal_north",
    "normal_up",
    "difference_before_m",
    "difference_after_m",
    "sd_m",
    "normalised",
];

fn schema() -> SchemaRef {
    let texts =
        ["first_strip", "second_strip"].map(|name| Field::new(name, DataType::Utf8, false)).into_iter();
    let numbers = NUMBERS.map(|name| Field::new(name, DataType::Float64, name == "difference_before_m"));
    let used = Field::new("used", DataType::Boolean, false);
    let fields: Vec<Field> = texts.chain(numbers).chain([used]).collect();
    let metadata = HashMap::from([(VERSION_KEY.to_owned(), VERSION.to_owned())]);
    Arc::new(Schema::new(fields).with_metadata(metadata))
}

/// Residuals as record batches; `names` are those of the strips. There is at least one batch.
pub fn residual_batches<'o>(
    observations: &'o [Observation],
    names: &'o [&str],
) -> impl Iterator<Item = std::result::Result<RecordBatch, ArrowError>> + 'o {
    let schema = schema();
    let none: &[Observation] = &[];
    let empty = observations.is_empty().then_some(none);
    let parts = observations.chunks(ROWS_PER_BATCH).chain(empty);
    parts.map(move |part| RecordBatch::try_new(Arc::clone(&schema), columns(part, names)))
}

fn columns(part: &[Observation], names: &[&str]) -> Vec<ArrayRef> {
    let name = |side: usize| -> ArrayRef {
        let of = |one: &Observation| names.get(one.strips[side] as usize).copied().unwrap_or_default();
        Arc::new(part.iter().map(of).map(Some).collect::<StringArray>())
    };
    let numbers: Vec<[Option<f64>; 12]> = part.iter().map(numbers).collect();
    let number = |column: usize| -> ArrayRef {
        Arc::new(numbers.iter().map(|row| row[column]).collect::<Float64Array>())
    };
    let used: ArrayRef = Arc::new(part.iter().map(|one| Some(one.is_used)).collect::<BooleanArray>());
    [name(0), name(1)].into_iter().chain((0..NUMBERS.len()).map(number)).chain([used]).collect()
}

/// Numbers of a row, in the order of [`NUMBERS`].
fn numbers(one: &Observation) -> [Option<f64>; 12] {
    let Geodetic { latitude_rad, longitude_rad, height_m } = WGS84.geodetic_of(one.place_in_ecef_m);
    let ned_from_ecef = inverse(&ecef_from_ned_at(WGS84, one.place_in_ecef_m));
    let [north, east, down] = rotate(&ned_from_ecef, one.normal_in_ecef);
    [
        Some(one.times_s[0]),
        Some(one.times_s[1]),
        Some(longitude_rad.to_degrees()),
        Some(latitude_rad.to_degrees()),
        Some(height_m),
        Some(east),
        Some(north),
        Some(-down),
        one.before_m,
        Some(one.after_m),
        Some(one.sd_m),
        Some(one.after_m / one.sd_m),
    ]
}

/// Writes the residuals; the file gets its name when it is published.
///
/// # Errors
/// If the file cannot be written.
pub fn write_residuals(
    observations: &[Observation],
    names: &[&str],
    mut file: OutputFile,
) -> Result<FinishedFile> {
    let path = file.path().to_owned();
    let options = IpcWriteOptions::default().try_with_compression(Some(CompressionType::ZSTD));
    let written = options.and_then(|options| {
        let mut writer = FileWriter::try_new_with_options(&mut file, &schema(), options)?;
        residual_batches(observations, names).try_for_each(|batch| writer.write(&batch?))?;
        writer.finish()
    });
    written.map_err(|error| match error {
        ArrowError::IoError(_, error) => Error::io(&path, "write")(error),
        other => Error::unusable(&path, other.to_string(), "please report this bug in wavex"),
    })?;
    file.finish()
}

#[cfg(test)]
mod tests {
    use super::*;
    use arrow_array::cast::AsArray;
    use arrow_array::types::Float64Type;

    #[test]
    fn rows_have_places_and_normals() {
        let place = Geodetic { latitude_rad: 0.83, longitude_rad: 0.2, height_m: 300.0 };
        let up = [0.83f64.cos() * 0.2f64.cos(), 0.83f64.cos() * 0.2f64.sin(), 0.83f64.sin()];
        let one = Observation {
            strips: [0, 2],
            place_in_ecef_m: WGS84.ecef_of(place),
            normal_in_ecef: up,
            times_s: [10.0, 20.0],
            before_m: None,
            after_m: 0.02,
            sd_m: 0.01,
            is_used: true,
        };
        let rows = vec![one; ROWS_PER_BATCH + 1];
        let batches: Vec<RecordBatch> =
            residual_batches(&rows, &["a", "b", "c"]).collect::<std::result::Result<_, _>>().unwrap();
        assert_eq!(batches.iter().map(RecordBatch::num_rows).collect::<Vec<_>>(), [ROWS_PER_BATCH, 1]);
        let last = &batches[1];
        let number = |name: &str| {
            let column = last.column_by_name(name).unwrap().as_primitive::<Float64Type>();
            column.iter().next().unwrap()
        };
        let near = |name: &str, expected: f64| (number(name).unwrap() - expected).abs() < 1e-6;
        assert!(near("longitude_deg", 0.2f64.to_degrees()) && near("latitude_deg", 0.83f64.to_degrees()));
        assert!(near("height_m", 300.0) && near("normal_up", 1.0) && near("normal_east", 0.0));
        assert!(near("normalised", 2.0) && near("second_time_s", 20.0));
        assert_eq!(number("difference_before_m"), None, "unknown is not 0");
        assert_eq!(last.column_by_name("second_strip").unwrap().as_string::<i32>().value(0), "c");
        let none: Vec<_> = residual_batches(&[], &[]).collect::<std::result::Result<_, _>>().unwrap();
        assert_eq!(none.iter().map(RecordBatch::num_rows).collect::<Vec<_>>(), [0], "the schema remains");
    }
}
