//! Columns and metadata keys of a container, for reader, writer and description.

use std::sync::Arc;

use arrow_schema::{DataType, Field, Fields, Metadata, Schema};
use serde_json::{Value, json};

use super::location::ContainerLocation;
use crate::Result;

/// A column, or a field of a column that is a list of structs.
#[derive(Debug)]
pub struct ColumnLayout {
    /// Its name.
    pub name: &'static str,
    /// Its type.
    pub kind: ColumnKind,
    /// Whether it may hold nulls.
    pub nullable: bool,
    /// Whether a container without it is refused.
    pub required: bool,
    /// Meaning.
    pub meaning: &'static str,
}

/// The type of a [`ColumnLayout`].
#[derive(Debug)]
pub enum ColumnKind {
    /// Unsigned, 8 bits.
    U8,
    /// Unsigned, 16 bits.
    U16,
    /// Unsigned, 32 bits.
    U32,
    /// Unsigned, 64 bits.
    U64,
    /// Signed, 16 bits.
    I16,
    /// Signed, 64 bits.
    I64,
    /// IEEE 754 single.
    F32,
    /// IEEE 754 double.
    F64,
    /// Fixed-size list of three doubles.
    Triple,
    /// List of unsigned 16-bit numbers; of singles in version 2.
    Samples,
    /// UTF-8 text.
    Text,
    /// List of structs.
    Structs(&'static [ColumnLayout]),
}

/// A key of the schema's metadata.
#[derive(Debug)]
pub struct MetadataKey {
    /// Its name.
    pub name: &'static str,
    /// Whether a container without it is refused.
    pub required: bool,
    /// Form of its value, a string.
    pub form: &'static str,
    /// What it means.
    pub meaning: &'static str,
}

const fn required(name: &'static str, kind: ColumnKind, meaning: &'static str) -> ColumnLayout {
    ColumnLayout { name, kind, nullable: false, required: true, meaning }
}

const fn optional(name: &'static str, kind: ColumnKind, meaning: &'static str) -> ColumnLayout {
    ColumnLayout { name, kind, nullable: true, required: false, meaning }
}

const fn or_null(mut column: ColumnLayout) -> ColumnLayout {
    column.nullable = true;
    column
}

/// The columns.
///
/// Optional columns are extensions of this project. Other programs may omit or ignore them, and a
/// null means the same as a missing column.
#[rustfmt::skip]
pub static COLUMNS: &[ColumnLayout] = &[
    required("shot", ColumnKind::U64, "running number of the shot, from 0"),
    required("line", ColumnKind::U32, "scan line, from 0; a change within a record batch starts another line"),
    or_null(required("gps_time_s", ColumnKind::F64, "time of the shot, s, on the scale of `wavex.time_scale`")),
    required("clock_ps", ColumnKind::I64, "the shot's time on the instrument's clock, ps from any origin; ranges use this"),
    required("origin", ColumnKind::Triple, "origin of the beam, m, in `wavex.frame`"),
    required("direction", ColumnKind::Triple, "unit vector along the outgoing beam, in `wavex.frame`"),
    required("facet", ColumnKind::U16, "mirror facet"),
    required("flags", ColumnKind::U16, "bit 0 synchronised, 1 within the last second, 2 housekeeping, 8 mirror moves in the positive direction, 9 last shot of a scan line"),
    or_null(required("mta_zone", ColumnKind::I16, "null: blocks are stored with the shot of their record; a number: with the shot that caused them, that many emissions before reception, unless a block has its own `zone`")),
    required("blocks", ColumnKind::Structs(BLOCK), "the sample blocks"),
    or_null(required("online", ColumnKind::Structs(ONLINE), "the instrument's own returns")),
    optional("scan_angle_deg", ColumnKind::F32, "scan angle, degrees, positive to the right of the flight direction; null: unknown"),
    optional("frame_scale", ColumnKind::F64, "metres in the frame per metre of range along the beam; null: 1"),
];

/// Further columns of version 2, whose samples are fractions: of shots with large footprints.
#[rustfmt::skip]
pub static FOOTPRINT: &[ColumnLayout] = &[
    optional("beam", ColumnKind::Text, "name of the beam, of an instrument with several; a change starts another line"),
    optional("shot_number", ColumnKind::U64, "number of the shot in its mission"),
    optional("noise_mean_dn", ColumnKind::F64, "background by the instrument's processing, digitiser steps"),
    optional("noise_sd_dn", ColumnKind::F64, "standard deviation of a sample by the instrument's processing, digitiser steps"),
    optional("advised_against", ColumnKind::U8, "1: the instrument's flags advise against the shot"),
];

/// What a container is written with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct LayoutOptions {
    /// Whether blocks have a gain.
    pub(super) has_gain: bool,
    /// Whether samples are fractions of a digitiser step: version 2.
    pub(super) has_fractions: bool,
}

impl LayoutOptions {
    /// The options by which a schema was made.
    pub(super) fn of(schema: &Schema) -> LayoutOptions {
        let fields = |data_type: &DataType| match data_type {
            DataType::List(item) => match item.data_type() {
                DataType::Struct(fields) => Some(fields.clone()),
                _ => None,
            },
            _ => None,
        };
        let blocks = schema.fields().find("blocks").and_then(|(_, field)| fields(field.data_type()));
        let field = |name: &str| blocks.as_ref().and_then(|fields| fields.find(name));
        LayoutOptions {
            has_gain: field(GAIN).is_some(),
            has_fractions: field("samples").is_some_and(|(_, field)| *field.data_type() == fractions()),
        }
    }

    /// The columns.
    pub(super) fn columns(self) -> impl Iterator<Item = &'static ColumnLayout> {
        COLUMNS.iter().chain(if self.has_fractions { FOOTPRINT } else { &[] })
    }
}

/// The fields of the column `blocks`.
#[rustfmt::skip]
pub static BLOCK: &[ColumnLayout] = &[
    required("channel", ColumnKind::U8, "0 high power, 1 low power, 2 saturation, 3 reference (outgoing pulse)"),
    required("start_ns", ColumnKind::F64, "time of the first sample after the row's `clock_ps`, ns"),
    required("samples", ColumnKind::Samples, "digitiser steps; in version 2 of the layout f32, fractions of a step"),
    optional("zone", ColumnKind::I16, "zone of this block; null: the row's `mta_zone`"),
    optional("interval_ns", ColumnKind::F64, "sampling interval, ns; null: `wavex.sampling_interval_ns`"),
    optional(GAIN, ColumnKind::F64, "gain relative to the reference gain, 1/1024 to 1024: samples are background + gain x (signal + receiver noise) + quantisation noise; null: 1. Written only with automatic gain control"),
];

/// Field of `blocks` in recordings with automatic gain control.
pub(super) const GAIN: &str = "gain";

/// The fields of the column `online`.
#[rustfmt::skip]
pub static ONLINE: &[ColumnLayout] = &[
    required("time_ns", ColumnKind::F64, "time after the row's `clock_ps`, ns"),
    required("amplitude", ColumnKind::F32, "in the instrument's unit; NaN if it gave none"),
];

const fn key(name: &'static str, required: bool, form: &'static str, meaning: &'static str) -> MetadataKey {
    MetadataKey { name, required, form, meaning }
}

/// Metadata keys of the schema.
///
/// Numbers are written with enough digits to read back the same bits.
#[rustfmt::skip]
pub static KEYS: &[MetadataKey] = &[
    key("wavex.container", true, "`1` or `2`", "version of this layout: with `2`, samples are fractions of a digitiser step (f32)"),
    key("wavex.instrument", false, "text", "name of the instrument"),
    key("wavex.serial", false, "text", "serial number of the instrument"),
    key("wavex.sampling_interval_ns", true, "number > 0", "sampling interval, ns, unless a block has its own"),
    key("wavex.group_velocity_mps", true, "number > 0, at most 299792458", "group velocity in air, m/s"),
    key("wavex.pulse_rate_hz", false, "number > 0", "nominal pulse rate, Hz"),
    key("wavex.time_scale", true, "`week`, `day`, `adjusted` or `unknown`", "time scale of `gps_time_s`: seconds of the GPS week, of the day, or since 1980-01-06 minus 1e9"),
    key("wavex.gps_week", false, "whole number", "GPS week of the first shot"),
    key("wavex.frame", true, "`scanner`, `body` or `map`", "frame of `origin` and `direction`"),
    key("wavex.crs", false, "WKT", "coordinate reference system of the frame `map`"),
    key("wavex.tables", false, "JSON object of arrays of pairs", "`amplitude_low`, `amplitude_high`: [digitiser steps, dB]; `range_low`, `range_high`: [digitiser steps, seconds]"),
    key("wavex.recorded", false, "`YYYY-MM-DD`", "extension: day of the recording; dates outputs"),
    key("wavex.created", false, "`YYYY-MM-DD`", "extension: day on which the file of the recording was created; dates outputs if `wavex.recorded` is absent"),
    key("wavex.full_scale_dn", false, "whole number up to 65535", "extension: largest value of the digitiser"),
    key("wavex.coordinate_grid", false, "JSON object {`scale`: [x, y, z], `offset`: [x, y, z]}", "extension: coordinate grid of the recording's own file; point outputs use the same"),
    key("wavex.emission_reference", false, "`outgoing_pulse`, `outgoing_pulse_fraction`, `return_locations` or `clock`", "extension: source of the emission time; default `outgoing_pulse` if the first scan line has blocks of channel 3, else `clock`"),
    key("wavex.clock_sd_ns", false, "number >= 0", "extension: standard deviation of emission times that count from the clock, ns; default that of a position within one sample"),
    key("wavex.emission_choice_sd_ns", false, "number >= 0", "extension: standard deviation of emission times for an uncertain choice of `wavex.emission_reference`, ns; default 0"),
    key("wavex.gain_control", false, "`recorded` or `not_recorded`", "extension: the receiver gain varies, and blocks contain it or not; default `recorded` if blocks have a `gain`, else the gain is constant"),
    key("wavex.origin", false, "`sensor` or `waveform`", "extension: whether `origin` is the sensor position, or a point on the beam near the waveform; default `sensor`, unless `wavex.emission_reference` is `return_locations`"),
];

impl ColumnKind {
    /// The Arrow type.
    pub fn data_type(&self) -> DataType {
        let item = |data_type| Arc::new(Field::new("item", data_type, false));
        match self {
            ColumnKind::U8 => DataType::UInt8,
            ColumnKind::U16 => DataType::UInt16,
            ColumnKind::U32 => DataType::UInt32,
            ColumnKind::U64 => DataType::UInt64,
            ColumnKind::I16 => DataType::Int16,
            ColumnKind::I64 => DataType::Int64,
            ColumnKind::F32 => DataType::Float32,
            ColumnKind::F64 => DataType::Float64,
            ColumnKind::Triple => DataType::FixedSizeList(item(DataType::Float64), 3),
            ColumnKind::Samples => DataType::List(item(DataType::UInt16)),
            ColumnKind::Text => DataType::Utf8,
            ColumnKind::Structs(columns) => DataType::List(item(DataType::Struct(fields(columns)))),
        }
    }

    /// Name of the type.
    pub fn name(&self) -> &'static str {
        match self {
            ColumnKind::U8 => "u8",
            ColumnKind::U16 => "u16",
            ColumnKind::U32 => "u32",
            ColumnKind::U64 => "u64",
            ColumnKind::I16 => "i16",
            ColumnKind::I64 => "i64",
            ColumnKind::F32 => "f32",
            ColumnKind::F64 => "f64",
            ColumnKind::Triple => "fixed-size list of 3 f64",
            ColumnKind::Samples => "list of u16",
            ColumnKind::Text => "utf8",
            ColumnKind::Structs(_) => "list of struct",
        }
    }
}

impl ColumnLayout {
    /// The Arrow field.
    pub fn field(&self) -> Field {
        Field::new(self.name, self.kind.data_type(), self.nullable)
    }
}

/// The fields of some columns.
pub(super) fn fields(columns: &[ColumnLayout]) -> Fields {
    columns.iter().map(ColumnLayout::field).collect()
}

/// Fields of the column `blocks` to write.
pub(super) fn block_fields(options: LayoutOptions) -> Fields {
    let written = BLOCK.iter().filter(|column| options.has_gain || column.name != GAIN);
    let field = |column: &ColumnLayout| match column.kind {
        ColumnKind::Samples if options.has_fractions => Field::new(column.name, fractions(), column.nullable),
        _ => column.field(),
    };
    written.map(field).collect()
}

/// Type of the samples of version 2.
pub(super) fn fractions() -> DataType {
    DataType::List(Arc::new(Field::new("item", DataType::Float32, false)))
}

/// The schema of a container with this metadata.
pub(super) fn schema(metadata: Metadata, options: LayoutOptions) -> Schema {
    let blocks = DataType::Struct(block_fields(options));
    let blocks = DataType::List(Arc::new(Field::new("item", blocks, false)));
    let field = |column: &ColumnLayout| match column.name {
        "blocks" => Field::new(column.name, blocks.clone(), column.nullable),
        _ => column.field(),
    };
    Schema::new_with_metadata(options.columns().map(field).collect::<Fields>(), metadata)
}

/// Indices of the columns of a version in a schema; `None` for a missing optional one.
///
/// Errors name the column that is missing or has another type. Names of list items and declared
/// nullability are ignored; the contents of the columns are checked instead. Large lists, large texts, views of texts and
/// signed shot numbers, as Polars writes them, are accepted.
pub(super) fn find(
    schema: &Schema,
    has_fractions: bool,
    location: ContainerLocation,
) -> Result<Vec<Option<usize>>> {
    let columns = LayoutOptions { has_fractions, ..LayoutOptions::default() }.columns();
    let sample = if has_fractions { DataType::Float32 } else { DataType::UInt16 };
    columns.map(|column| find_one(schema.fields(), column, "", &sample, location)).collect()
}

fn find_one(
    found: &Fields,
    column: &ColumnLayout,
    prefix: &str,
    sample: &DataType,
    location: ContainerLocation,
) -> Result<Option<usize>> {
    let path = format!("{prefix}{}", column.name);
    let Some((index, field)) = found.find(column.name) else {
        if !column.required {
            return Ok(None);
        }
        let problem = format!("there is no such column, a {} is expected", column.kind.name());
        return Err(location.bad(
            format!("column `{path}`"),
            problem,
            "write it as schemas/container.json says",
        ));
    };
    let same = match (&column.kind, field.data_type()) {
        (ColumnKind::Triple, DataType::FixedSizeList(item, 3)) => *item.data_type() == DataType::Float64,
        (ColumnKind::U64, DataType::Int64) => true,
        (ColumnKind::Text, DataType::LargeUtf8 | DataType::Utf8View) => true,
        (ColumnKind::Samples, DataType::List(item) | DataType::LargeList(item)) => item.data_type() == sample,
        (ColumnKind::Structs(inner), DataType::List(item) | DataType::LargeList(item)) => {
            match item.data_type() {
                DataType::Struct(found) => {
                    let prefix = format!("{path}.");
                    inner.iter().try_for_each(|column| {
                        find_one(found, column, &prefix, sample, location).map(drop)
                    })?;
                    true
                }
                _ => false,
            }
        }
        (kind, found) => kind.data_type() == *found,
    };
    if !same {
        let expected = match column.kind {
            ColumnKind::Samples if *sample == DataType::Float32 => "list of f32",
            _ => column.kind.name(),
        };
        let problem = format!("the type is {} and should be {expected}", field.data_type());
        return Err(location.bad(
            format!("column `{path}`"),
            problem,
            "cast it before writing the container",
        ));
    }
    Ok(Some(index))
}

/// The layout as JSON, the content of `schemas/container.json`.
pub fn description() -> Value {
    let keys: Vec<Value> = KEYS
        .iter()
        .map(|key| json!({"key": key.name, "required": key.required, "form": key.form, "meaning": key.meaning}))
        .collect();
    json!({
        "title": "wavex open waveform container, versions 1 and 2",
        "format": "Apache Arrow IPC, file or stream; buffers plain, LZ4_FRAME or ZSTD",
        "record_batch": "one scan line",
        "row": "one shot",
        "columns": describe(COLUMNS),
        "columns_of_version_2": describe(FOOTPRINT),
        "metadata": keys,
        "digest": {
            "key": super::digest::KEY,
            "place": "custom metadata of the schema message, of each record batch message and of the footer",
            "required": false,
            "form": "16 hexadecimal digits",
            "meaning": "XXH3-64 of the body, with the XXH3-64 of the flatbuffer as seed; the flatbuffer includes its padding, and this value counts as 16 zeros",
        },
    })
}

fn describe(columns: &[ColumnLayout]) -> Vec<Value> {
    columns.iter().map(describe_one).collect()
}

fn describe_one(column: &ColumnLayout) -> Value {
    let mut value = json!({
        "name": column.name,
        "type": column.kind.name(),
        "nullable": column.nullable,
        "required": column.required,
        "meaning": column.meaning,
    });
    if let (ColumnKind::Structs(inner), Some(object)) = (&column.kind, value.as_object_mut()) {
        object.insert("fields".into(), describe(inner).into());
    }
    value
}
