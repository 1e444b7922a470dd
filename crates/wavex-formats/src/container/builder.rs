//! Builder of the record batch of a scan line.

use std::sync::Arc;

use arrow_array::{
    ArrayRef, FixedSizeListArray, Float32Array, Float64Array, Int16Array, Int64Array, ListArray, RecordBatch,
    StringArray, StructArray, UInt8Array, UInt16Array, UInt32Array, UInt64Array,
};
use arrow_buffer::{NullBuffer, OffsetBuffer, ScalarBuffer};
use arrow_schema::{ArrowError, DataType, Field, FieldRef, SchemaRef};

use super::layout::{ColumnKind, LayoutOptions, ONLINE, block_fields, fields, fractions};
use super::{ContainerBlock, ContainerFootprint, ContainerOnline, ContainerShot};

/// Rows of a scan line by column.
///
/// Blocks and online returns belong to the last added shot.
#[derive(Debug, Default)]
pub struct LineBuilder {
    shot: Vec<u64>,
    line: Vec<u32>,
    gps_time_s: Vec<Option<f64>>,
    clock_ps: Vec<i64>,
    origin: Vec<f64>,
    direction: Vec<f64>,
    facet: Vec<u16>,
    flags: Vec<u16>,
    mta_zone: Vec<Option<i16>>,
    scan_angle_deg: Vec<Option<f32>>,
    frame_scale: Vec<Option<f64>>,
    /// Number of blocks of each shot.
    blocks: Vec<usize>,
    channel: Vec<u8>,
    start_ns: Vec<f64>,
    zone: Vec<Option<i16>>,
    interval_ns: Vec<Option<f64>>,
    gain: Vec<Option<f64>>,
    /// Number of samples of each block.
    lengths: Vec<usize>,
    /// Whether the samples of each block are fractions of a digitiser step.
    has_fractions: Vec<bool>,
    samples: Vec<u16>,
    fractions: Vec<f32>,
    beam: Vec<Option<String>>,
    shot_number: Vec<Option<u64>>,
    noise_mean_dn: Vec<Option<f64>>,
    noise_sd_dn: Vec<Option<f64>>,
    advised_against: Vec<Option<u8>>,
    /// Number of online returns of each shot.
    online: Vec<usize>,
    time_ns: Vec<f64>,
    amplitude: Vec<f32>,
}

impl LineBuilder {
    /// Creates a builder without rows.
    pub fn new() -> LineBuilder {
        LineBuilder::default()
    }

    /// Adds a row without blocks.
    pub fn shot(&mut self, shot: &ContainerShot) {
        self.shot.push(shot.shot);
        self.line.push(shot.line);
        self.gps_time_s.push(shot.gps_time_s);
        self.clock_ps.push(shot.clock_ps);
        self.origin.extend(shot.origin_m);
        self.direction.extend(shot.direction);
        self.facet.push(shot.facet);
        self.flags.push(shot.flags);
        self.mta_zone.push(shot.mta_zone);
        self.scan_angle_deg.push(shot.scan_angle_deg);
        self.frame_scale.push(shot.frame_scale);
        self.blocks.push(0);
        self.online.push(0);
    }

    /// Adds a block to the last row; does nothing before the first row.
    pub fn block(&mut self, block: &ContainerBlock) {
        if self.add_block(block, block.samples.len(), false) {
            self.samples.extend_from_slice(block.samples);
        }
    }

    /// As [`LineBuilder::block`], with samples that are fractions of a digitiser step in place of the block's own.
    ///
    /// The header needs [`ContainerHeader::has_fractions`](super::ContainerHeader::has_fractions).
    pub fn block_of_fractions(&mut self, block: &ContainerBlock, samples: &[f32]) {
        if self.add_block(block, samples.len(), true) {
            self.fractions.extend_from_slice(samples);
        }
    }

    /// Sets what a recording of large footprints says of the last row; version 1 of the layout does not store it.
    pub fn footprint(&mut self, footprint: &ContainerFootprint) {
        let Some(row) = self.shot.len().checked_sub(1) else { return };
        set(&mut self.beam, row, footprint.beam.map(str::to_owned));
        set(&mut self.shot_number, row, footprint.shot_number);
        set(&mut self.noise_mean_dn, row, footprint.noise_mean_dn);
        set(&mut self.noise_sd_dn, row, footprint.noise_sd_dn);
        set(&mut self.advised_against, row, Some(u8::from(footprint.is_advised_against)));
    }

    /// Adds a block without its samples to the last row, if there is one.
    fn add_block(&mut self, block: &ContainerBlock, length: usize, has_fractions: bool) -> bool {
        let Some(blocks) = self.blocks.last_mut() else { return false };
        *blocks += 1;
        self.channel.push(block.channel);
        self.start_ns.push(block.start_ns);
        self.zone.push(block.zone);
        self.interval_ns.push(block.interval_ns);
        self.gain.push(block.gain);
        self.lengths.push(length);
        self.has_fractions.push(has_fractions);
        true
    }

    /// Samples of all blocks as fractions.
    fn all_as_fractions(&mut self) -> Vec<f32> {
        if self.samples.is_empty() {
            return std::mem::take(&mut self.fractions);
        }
        let (mut steps, mut fractions) = (self.samples.iter(), self.fractions.iter());
        let mut all = Vec::with_capacity(steps.len() + fractions.len());
        for (&length, &has_fractions) in self.lengths.iter().zip(&self.has_fractions) {
            match has_fractions {
                true => all.extend(fractions.by_ref().take(length)),
                false => all.extend(steps.by_ref().take(length).map(|&step| f32::from(step))),
            }
        }
        all
    }

    /// Adds an online return to the last row; does nothing before the first row.
    pub fn online(&mut self, online: &ContainerOnline) {
        let Some(count) = self.online.last_mut() else { return };
        *count += 1;
        self.time_ns.push(online.time_ns);
        self.amplitude.push(online.amplitude);
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.shot.len()
    }

    /// Returns the record batch; `schema` is [`ContainerHeader::schema`](super::ContainerHeader::schema).
    ///
    /// # Errors
    /// A list exceeds 2^31 items, the limit of Arrow lists, or a block has a gain and the schema has
    /// no field for it, or has fractions and the schema has whole steps.
    pub fn finish(mut self, schema: SchemaRef) -> Result<RecordBatch, ArrowError> {
        let options = LayoutOptions::of(&schema);
        let samples = if options.has_fractions {
            let values = array(Float32Array::from(self.all_as_fractions()));
            list_of_type(fractions(), &self.lengths, values, None)?
        } else if self.fractions.is_empty() {
            list(ColumnKind::Samples, &self.lengths, array(UInt16Array::from(self.samples)), None)?
        } else {
            let problem =
                "samples are fractions of a digitiser step, but the container header declares whole steps";
            return Err(ArrowError::InvalidArgumentError(problem.into()));
        };
        if !options.has_gain && self.gain.iter().any(Option::is_some) {
            let problem = "a block has a gain, but the container header declares none";
            return Err(ArrowError::InvalidArgumentError(problem.into()));
        }
        let mut of_blocks = vec![
            array(UInt8Array::from(self.channel)),
            array(Float64Array::from(self.start_ns)),
            array(samples),
            array(Int16Array::from(self.zone)),
            array(Float64Array::from(self.interval_ns)),
        ];
        of_blocks.extend(options.has_gain.then(|| array(Float64Array::from(self.gain))));
        let blocks = StructArray::try_new(block_fields(options), of_blocks, None)?;
        let block_list = Arc::new(Field::new("item", DataType::Struct(block_fields(options)), false));
        let online = StructArray::try_new(
            fields(ONLINE),
            vec![array(Float64Array::from(self.time_ns)), array(Float32Array::from(self.amplitude))],
            None,
        )?;
        let some_online: NullBuffer = self.online.iter().map(|&count| count > 0).collect();
        let rows = self.shot.len();
        let mut columns = vec![
            array(UInt64Array::from(self.shot)),
            array(UInt32Array::from(self.line)),
            array(Float64Array::from(self.gps_time_s)),
            array(Int64Array::from(self.clock_ps)),
            array(triple(self.origin)?),
            array(triple(self.direction)?),
            array(UInt16Array::from(self.facet)),
            array(UInt16Array::from(self.flags)),
            array(Int16Array::from(self.mta_zone)),
            array(list_of(block_list, &self.blocks, array(blocks), None)?),
            array(list(ColumnKind::Structs(ONLINE), &self.online, array(online), Some(some_online))?),
            array(Float32Array::from(self.scan_angle_deg)),
            array(Float64Array::from(self.frame_scale)),
        ];
        if options.has_fractions {
            columns.extend([
                array(StringArray::from(of_rows(self.beam, rows))),
                array(UInt64Array::from(of_rows(self.shot_number, rows))),
                array(Float64Array::from(of_rows(self.noise_mean_dn, rows))),
                array(Float64Array::from(of_rows(self.noise_sd_dn, rows))),
                array(UInt8Array::from(of_rows(self.advised_against, rows))),
            ]);
        }
        RecordBatch::try_new(schema, columns)
    }
}

/// Sets the value of the last row; rows before it without a value are null.
fn set<T: Clone>(column: &mut Vec<Option<T>>, row: usize, value: Option<T>) {
    column.resize(row, None);
    column.push(value);
}

/// A column with nulls for the rows at its end that have no value.
fn of_rows<T: Clone>(mut column: Vec<Option<T>>, rows: usize) -> Vec<Option<T>> {
    column.resize(rows, None);
    column
}

fn array(array: impl arrow_array::Array + 'static) -> ArrayRef {
    Arc::new(array)
}

fn triple(values: Vec<f64>) -> Result<FixedSizeListArray, ArrowError> {
    let item = Arc::new(Field::new("item", DataType::Float64, false));
    FixedSizeListArray::try_new(item, 3, array(Float64Array::from(values)), None)
}

fn list(
    kind: ColumnKind,
    lengths: &[usize],
    values: ArrayRef,
    nulls: Option<NullBuffer>,
) -> Result<ListArray, ArrowError> {
    list_of_type(kind.data_type(), lengths, values, nulls)
}

fn list_of_type(
    data_type: DataType,
    lengths: &[usize],
    values: ArrayRef,
    nulls: Option<NullBuffer>,
) -> Result<ListArray, ArrowError> {
    let DataType::List(item) = data_type else {
        return Err(ArrowError::SchemaError("not a list".into()));
    };
    list_of(item, lengths, values, nulls)
}

fn list_of(
    item: FieldRef,
    lengths: &[usize],
    values: ArrayRef,
    nulls: Option<NullBuffer>,
) -> Result<ListArray, ArrowError> {
    if i32::try_from(values.len()).is_err() {
        return Err(ArrowError::InvalidArgumentError("a scan line with a list of over 2^31 items".into()));
    }
    let mut offsets = Vec::with_capacity(lengths.len() + 1);
    offsets.push(0_i32);
    let mut end = 0;
    offsets.extend(lengths.iter().map(|&length| {
        end += length;
        end as i32
    }));
    ListArray::try_new(item, OffsetBuffer::new(ScalarBuffer::from(offsets)), values, nulls)
}
