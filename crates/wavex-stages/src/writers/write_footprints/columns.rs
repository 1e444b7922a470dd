//! Columns of the footprint table: names, types, meanings and sources.

use std::fmt::Write as _;
use std::sync::Arc;

use arrow_array::{
    ArrayRef, FixedSizeListArray, Float32Array, Float64Array, RecordBatch, StringArray, UInt8Array,
    UInt32Array, UInt64Array,
};
use arrow_schema::{ArrowError, DataType, Field, Metadata, Schema, SchemaRef};

use crate::writers::table::TableColumns;
use crate::writers::write_table::described;
use wavex_footprints::HEIGHTS;
use wavex_line::scan_line::Footprint;

/// One shot, with the fields of its line that the table needs.
#[derive(Clone, Debug)]
pub struct FootprintRow {
    /// Running number of the shot.
    pub shot: u64,
    /// Name of the beam.
    pub beam: Option<Arc<str>>,
    /// Time of the shot, s; NaN where unknown.
    pub gps_time_s: f64,
    /// Position of the ground in the output frame, if known.
    pub ground: Option<[f64; 3]>,
    /// The footprint.
    pub footprint: Footprint,
}

/// How a row gives the value of a column; `Maybe...` may be null.
enum Values {
    U8(fn(&Footprint) -> u8),
    U32(fn(&Footprint) -> u32),
    U64(fn(&FootprintRow) -> u64),
    Beam,
    F64(fn(&Footprint) -> f64),
    MaybeF64(fn(&FootprintRow) -> Option<f64>),
    Heights(fn(&Footprint) -> &[f32; HEIGHTS]),
    /// A further value of the recording.
    Further(usize),
}

struct FootprintColumn {
    name: &'static str,
    values: Values,
    meaning: &'static str,
}

const fn column(name: &'static str, values: Values, meaning: &'static str) -> FootprintColumn {
    FootprintColumn { name, values, meaning }
}

/// Columns that every table has.
#[rustfmt::skip]
static COLUMNS: &[FootprintColumn] = &[
    column("shot", Values::U64(|row| row.shot), "running number of the shot in the file, from 0"),
    column("shot_number", Values::U64(|row| row.footprint.shot_number), "number of the shot in its mission"),
    column("beam", Values::Beam, "name of the beam; null if there is one only"),
    column("gps_time_s", Values::MaybeF64(|row| Some(row.gps_time_s).filter(|time_s| !time_s.is_nan())), "time of the shot, s, on the scale of the metadata `wavex.time_scale`"),
    column("x", Values::MaybeF64(|row| row.ground.map(|point| point[0])), "coordinate of the ground in the output frame; null before `georeference`, and without ground"),
    column("y", Values::MaybeF64(|row| row.ground.map(|point| point[1])), "see x"),
    column("z", Values::MaybeF64(|row| row.ground.map(|point| point[2])), "see x"),
    column("ground_sd_m", Values::F64(|of| of.ground_range_m.sd), "standard deviation of the ground along the beam if this mode is the ground: by noise, slope and vegetation, without that of the geolocation"),
    column("ground_probability", Values::F64(|of| of.ground_probability), "probability that the ground is at the lowest mode, within 1 m or 3 standard deviations, and not below it"),
    column("ground_total_sd_m", Values::F64(|of| of.ground_total_sd_m), "standard deviation of the ground along the beam that includes the choice: grounds below this mode count by their probability; on simulated shots 1.4 to 10 times the error below a cover of 0.9"),
    column("second_ground_height_m", Values::F64(|of| of.second_ground_height_m.value), "height above this mode, negative, of the second candidate for the ground, which has no mode; NaN if its probability is below 0.05"),
    column("second_ground_sd_m", Values::F64(|of| of.second_ground_height_m.sd), "standard deviation of second_ground_height_m if the ground is there"),
    column("second_ground_probability", Values::F64(|of| of.second_ground_probability), "probability that the ground is at the second candidate, within 1 m or 3 standard deviations, and not at this mode"),
    column("ground_amplitude_dn", Values::F64(|of| of.ground_amplitude_dn.value), "height of that mode above the background, digitiser steps"),
    column("ground_amplitude_sd_dn", Values::F64(|of| of.ground_amplitude_dn.sd), "standard deviation of ground_amplitude_dn"),
    column("ground_width_below_ratio", Values::F64(|of| of.ground_half_width_ratios[0]), "distance from that mode to half its height below it, over that of a flat target"),
    column("ground_width_above_ratio", Values::F64(|of| of.ground_half_width_ratios[1]), "the same above it; wider if low vegetation merges with the ground"),
    column("modes", Values::U32(|of| of.modes), "number of significant modes"),
    column("energy_dn", Values::F64(|of| of.energy_dn.value), "energy of the waveform, as the height of a flat target's echo of the same energy, digitiser steps"),
    column("energy_sd_dn", Values::F64(|of| of.energy_dn.sd), "standard deviation of energy_dn"),
    column("ground_energy_ratio", Values::F64(|of| of.ground_energy_ratio.value), "energy of the ground over that of the waveform"),
    column("ground_energy_ratio_sd", Values::F64(|of| of.ground_energy_ratio.sd), "standard deviation of ground_energy_ratio"),
    column("cover", Values::F64(|of| of.cover.value), "part of the footprint that the canopy covers"),
    column("cover_sd", Values::F64(|of| of.cover.sd), "standard deviation of cover"),
    column("plant_area_index", Values::F64(|of| of.plant_area_index.value), "area of leaves and branches per area of ground"),
    column("plant_area_index_sd", Values::F64(|of| of.plant_area_index.sd), "standard deviation of plant_area_index"),
    column("sensitivity", Values::F64(|of| of.sensitivity), "cover of a canopy through which the ground would be found with a probability of 0.9"),
    column("deviation", Values::F64(|of| of.deviation), "excess of the signal's power beyond the frequencies of the outgoing pulse over that of noise, in its standard deviations; large where no profile of ground and canopy explains the waveform"),
    column("flags", Values::U8(|of| of.flags), "1: no ground, 2: the signal begins before the block, 4: clipped samples, 8: the ground has a probability below 0.9, 16: the instrument's flags advise against the shot"),
    column("rh_m", Values::Heights(|of| &of.heights_m), "heights above the ground below which 0, 1, … 100 % of the energy lie"),
    column("rh_sd_m", Values::Heights(|of| &of.heights_sd_m), "standard deviations of rh_m"),
];

/// The columns of the table of footprints, with those of the recording.
pub struct FootprintColumns {
    further: Vec<FootprintColumn>,
}

impl FootprintColumns {
    /// With further values of these names.
    pub fn of(names: &[&'static str]) -> FootprintColumns {
        let further =
            |(index, name): (usize, &&'static str)| column(name, Values::Further(index), "as recorded");
        FootprintColumns { further: names.iter().enumerate().map(further).collect() }
    }

    fn all(&self) -> impl Iterator<Item = &FootprintColumn> {
        COLUMNS.iter().chain(&self.further)
    }
}

impl Values {
    fn data_type(&self) -> DataType {
        match self {
            Values::U8(_) => DataType::UInt8,
            Values::U32(_) => DataType::UInt32,
            Values::U64(_) => DataType::UInt64,
            Values::Beam => DataType::Utf8,
            Values::F64(_) | Values::MaybeF64(_) | Values::Further(_) => DataType::Float64,
            Values::Heights(_) => DataType::FixedSizeList(height_field(), HEIGHTS as i32),
        }
    }

    fn array(&self, rows: &[FootprintRow]) -> Result<ArrayRef, ArrowError> {
        let of_footprint = rows.iter().map(|row| &row.footprint);
        Ok(match self {
            Values::U8(value) => Arc::new(UInt8Array::from_iter_values(of_footprint.map(value))),
            Values::U32(value) => Arc::new(UInt32Array::from_iter_values(of_footprint.map(value))),
            Values::U64(value) => Arc::new(UInt64Array::from_iter_values(rows.iter().map(value))),
            Values::Beam => Arc::new(rows.iter().map(|row| row.beam.as_deref()).collect::<StringArray>()),
            Values::F64(value) => Arc::new(Float64Array::from_iter_values(of_footprint.map(value))),
            Values::MaybeF64(value) => Arc::new(rows.iter().map(value).collect::<Float64Array>()),
            Values::Further(index) => {
                Arc::new(of_footprint.map(|of| of.columns.get(*index).copied()).collect::<Float64Array>())
            }
            Values::Heights(value) => {
                let values =
                    Float32Array::from_iter_values(of_footprint.flat_map(|of| value(of).iter().copied()));
                Arc::new(FixedSizeListArray::try_new(height_field(), HEIGHTS as i32, Arc::new(values), None)?)
            }
        })
    }

    /// Adds the value of a row as text, nothing for null; lists as their values.
    fn add_text(&self, row: &FootprintRow, text: &mut String) {
        let of = &row.footprint;
        let maybe =
            |value: Option<f64>, text: &mut String| value.map_or(Ok(()), |value| write!(text, "{value:?}"));
        let added = match self {
            Values::U8(value) => write!(text, "{}", value(of)),
            Values::U32(value) => write!(text, "{}", value(of)),
            Values::U64(value) => write!(text, "{}", value(row)),
            Values::Beam => write!(text, "{}", row.beam.as_deref().unwrap_or_default()),
            Values::F64(value) => write!(text, "{:?}", value(of)),
            Values::MaybeF64(value) => maybe(value(row), text),
            Values::Further(index) => maybe(of.columns.get(*index).copied(), text),
            Values::Heights(value) => {
                let texts: Vec<String> = value(of).iter().map(|height_m| format!("{height_m:?}")).collect();
                write!(text, "{}", texts.join(","))
            }
        };
        debug_assert!(added.is_ok(), "a string accepts text");
    }
}

fn height_field() -> Arc<Field> {
    Arc::new(Field::new("item", DataType::Float32, false))
}

impl TableColumns for FootprintColumns {
    type Row = FootprintRow;

    /// A row has a kilobyte.
    const ROWS_PER_GROUP: usize = 1 << 13;

    fn schema(&self, time_scale: &str, crs_wkt: Option<&str>) -> SchemaRef {
        let field = |column: &FootprintColumn| {
            let nullable = matches!(column.values, Values::Beam | Values::MaybeF64(_) | Values::Further(_));
            let about = described(column.name, column.meaning);
            Field::new(column.name, column.values.data_type(), nullable).with_metadata(about)
        };
        let fields: Vec<Field> = self.all().map(field).collect();
        let metadata =
            [("wavex.footprints", Some("1")), ("wavex.time_scale", Some(time_scale)), ("wavex.crs", crs_wkt)];
        let metadata = metadata.into_iter().filter_map(|(key, text)| Some((key, text?)));
        Arc::new(Schema::new_with_metadata(fields, metadata.collect::<Metadata>()))
    }

    fn batch(&self, schema: &SchemaRef, rows: &[FootprintRow]) -> Result<RecordBatch, ArrowError> {
        let arrays: Result<Vec<ArrayRef>, ArrowError> =
            self.all().map(|column| column.values.array(rows)).collect();
        RecordBatch::try_new(Arc::clone(schema), arrays?)
    }

    fn csv_header(&self) -> String {
        let names = self.all().map(|column| match (&column.values, column.name.strip_prefix("rh")) {
            (Values::Heights(_), Some(rest)) => {
                let names: Vec<String> = (0..HEIGHTS).map(|percent| format!("rh{percent}{rest}")).collect();
                names.join(",")
            }
            _ => column.name.to_owned(),
        });
        names.collect::<Vec<_>>().join(",") + "\n"
    }

    fn csv(&self, rows: &[FootprintRow]) -> String {
        let mut text = String::new();
        for row in rows {
            for (number, column) in self.all().enumerate() {
                if number > 0 {
                    text.push(',');
                }
                column.values.add_text(row, &mut text);
            }
            text.push('\n');
        }
        text
    }

    fn point(row: &FootprintRow) -> Option<[f64; 3]> {
        row.ground
    }
}
