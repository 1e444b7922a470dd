//! A validated record batch of a container.

use std::ops::Range;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{
    ArrowPrimitiveType, Float32Type, Float64Type, Int16Type, Int64Type, UInt8Type, UInt16Type, UInt32Type,
    UInt64Type,
};
use arrow_array::{
    Array, ArrayRef, FixedSizeListArray, Float32Array, Float64Array, Int16Array, Int64Array, LargeListArray,
    LargeStringArray, ListArray, PrimitiveArray, StringArray, StringViewArray, StructArray, UInt8Array,
    UInt16Array, UInt32Array, UInt64Array,
};

use arrow_buffer::OffsetBuffer;
use arrow_schema::Field;

use super::layout::GAIN;
use super::location::{ContainerLocation, DAMAGED};
use crate::Result;

/// One row: a shot without its blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContainerShot {
    /// Running number of the shot, from 0.
    pub shot: u64,
    /// Scan line, from 0.
    pub line: u32,
    /// Time of the shot, s.
    pub gps_time_s: Option<f64>,
    /// The shot's time on the instrument's clock, ps.
    pub clock_ps: i64,
    /// Origin of the beam, m.
    pub origin_m: [f64; 3],
    /// Unit vector along the outgoing beam.
    pub direction: [f64; 3],
    /// Mirror facet.
    pub facet: u16,
    /// See [`super::layout::COLUMNS`].
    pub flags: u16,
    /// Zone of the row's blocks; `None`: unresolved.
    pub mta_zone: Option<i16>,
    /// Scan angle, degrees.
    pub scan_angle_deg: Option<f32>,
    /// Metres in the frame per metre of range; `None`: 1.
    pub frame_scale: Option<f64>,
}

/// One sample block of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContainerBlock<'a> {
    /// See [`super::channel`]; may have any value.
    pub channel: u8,
    /// Time of the first sample after the row's `clock_ps`, ns.
    pub start_ns: f64,
    /// Sampling interval, ns; `None`: the interval of the header.
    pub interval_ns: Option<f64>,
    /// Zone of this block; `None`: the row's.
    pub zone: Option<i16>,
    /// Gain relative to the reference gain; `None`: 1.
    pub gain: Option<f64>,
    /// Digitiser steps; empty if they are fractions ([`ContainerLine::fractions`]).
    pub samples: &'a [u16],
}

/// What a recording of large footprints says of a row; unknown in version 1 of the layout.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ContainerFootprint<'a> {
    /// Name of the beam.
    pub beam: Option<&'a str>,
    /// Number of the shot in its mission.
    pub shot_number: Option<u64>,
    /// Background by the instrument's processing, digitiser steps.
    pub noise_mean_dn: Option<f64>,
    /// Standard deviation of a sample by the instrument's processing, digitiser steps.
    pub noise_sd_dn: Option<f64>,
    /// Whether the instrument's flags advise against the shot.
    pub is_advised_against: bool,
}

/// A return computed by the instrument.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ContainerOnline {
    /// Time after the row's `clock_ps`, ns.
    pub time_ns: f64,
    /// In the instrument's own unit; NaN if it gave none.
    pub amplitude: f32,
}

/// A record batch with valid types, nulls and lists.
///
/// Values are not checked.
#[derive(Debug)]
pub struct ContainerLine {
    shot: UInt64Array,
    line: UInt32Array,
    gps_time_s: Float64Array,
    clock_ps: Int64Array,
    origin: Float64Array,
    direction: Float64Array,
    facet: UInt16Array,
    flags: UInt16Array,
    mta_zone: Int16Array,
    blocks: BlockColumns,
    online: Online,
    scan_angle_deg: Option<Float32Array>,
    frame_scale: Option<Float64Array>,
    footprint: FootprintColumns,
}

/// Columns of version 2.
#[derive(Debug)]
struct FootprintColumns {
    beam: Option<Texts>,
    shot_number: Option<UInt64Array>,
    noise_mean_dn: Option<Float64Array>,
    noise_sd_dn: Option<Float64Array>,
    advised_against: Option<UInt8Array>,
}

/// Texts in one of Arrow's forms. They are not copied: views may repeat a long text.
#[derive(Clone, Debug)]
enum Texts {
    Usual(StringArray),
    Large(LargeStringArray),
    Views(StringViewArray),
}

impl Texts {
    fn of(array: &ArrayRef) -> Option<Texts> {
        let usual = || array.as_string_opt::<i32>().cloned().map(Texts::Usual);
        let large = || array.as_string_opt::<i64>().cloned().map(Texts::Large);
        let views = || array.as_string_view_opt().cloned().map(Texts::Views);
        usual().or_else(large).or_else(views)
    }

    /// The text of a row; `None` for a null.
    fn value(&self, row: usize) -> Option<&str> {
        match self {
            Texts::Usual(texts) => texts.is_valid(row).then(|| texts.value(row)),
            Texts::Large(texts) => texts.is_valid(row).then(|| texts.value(row)),
            Texts::Views(texts) => texts.is_valid(row).then(|| texts.value(row)),
        }
    }
}

#[derive(Debug)]
struct BlockColumns {
    rows: ListArray,
    channel: UInt8Array,
    start_ns: Float64Array,
    lists: ListArray,
    samples: SampleValues,
    zone: Option<Int16Array>,
    interval_ns: Option<Float64Array>,
    gain: Option<Float64Array>,
}

/// Samples of all blocks.
#[derive(Debug)]
enum SampleValues {
    Steps(UInt16Array),
    Fractions(Float32Array),
}

#[derive(Debug)]
struct Online {
    rows: ListArray,
    time_ns: Float64Array,
    amplitude: Float32Array,
}

impl ContainerLine {
    /// `columns` as [`super::layout::COLUMNS`] lists them. An error names the column and the row.
    pub(super) fn try_new(
        columns: &[Option<ArrayRef>],
        location: ContainerLocation,
    ) -> Result<ContainerLine> {
        let all = BatchColumns { columns, location };
        Ok(ContainerLine {
            shot: all.unsigned(0, "shot")?,
            line: all.full::<UInt32Type>(1, "line")?,
            gps_time_s: all.primitive::<Float64Type>(2, "gps_time_s")?,
            clock_ps: all.full::<Int64Type>(3, "clock_ps")?,
            origin: all.triple(4, "origin")?,
            direction: all.triple(5, "direction")?,
            facet: all.full::<UInt16Type>(6, "facet")?,
            flags: all.full::<UInt16Type>(7, "flags")?,
            mta_zone: all.primitive::<Int16Type>(8, "mta_zone")?,
            blocks: all.blocks(9)?,
            online: all.online(10)?,
            scan_angle_deg: all.optional::<Float32Type>(11, "scan_angle_deg")?,
            frame_scale: all.optional::<Float64Type>(12, "frame_scale")?,
            footprint: FootprintColumns {
                beam: all.text(13, "beam")?,
                shot_number: all.optional::<UInt64Type>(14, "shot_number")?,
                noise_mean_dn: all.optional::<Float64Type>(15, "noise_mean_dn")?,
                noise_sd_dn: all.optional::<Float64Type>(16, "noise_sd_dn")?,
                advised_against: all.optional::<UInt8Type>(17, "advised_against")?,
            },
        })
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.shot.len()
    }

    /// The scan line of a row.
    ///
    /// # Panics
    /// `row` is not below [`ContainerLine::rows`]. This also applies to the methods below.
    pub fn line(&self, row: usize) -> u32 {
        self.line.value(row)
    }

    /// Whether blocks have gains.
    pub fn has_gain(&self) -> bool {
        self.blocks.gain.is_some()
    }

    /// Returns a row without its blocks.
    pub fn shot(&self, row: usize) -> ContainerShot {
        ContainerShot {
            shot: self.shot.value(row),
            line: self.line.value(row),
            gps_time_s: value(&self.gps_time_s, row),
            clock_ps: self.clock_ps.value(row),
            origin_m: self.origin.values().as_chunks().0[row],
            direction: self.direction.values().as_chunks().0[row],
            facet: self.facet.value(row),
            flags: self.flags.value(row),
            mta_zone: value(&self.mta_zone, row),
            scan_angle_deg: self.scan_angle_deg.as_ref().and_then(|array| value(array, row)),
            frame_scale: self.frame_scale.as_ref().and_then(|array| value(array, row)),
        }
    }

    /// Number of blocks of a range of rows, and number of their samples.
    ///
    /// # Panics
    /// The range exceeds [`ContainerLine::rows`].
    pub fn blocks_and_samples(&self, rows: Range<usize>) -> (usize, usize) {
        let blocks = items_of(&self.blocks.rows, &rows);
        (blocks.len(), items_of(&self.blocks.lists, &blocks).len())
    }

    /// Iterates over the blocks of a row, in the order of the file.
    pub fn blocks(&self, row: usize) -> impl ExactSizeIterator<Item = ContainerBlock<'_>> {
        items(&self.blocks.rows, row).map(|index| self.blocks.at(index))
    }

    /// Samples of the blocks of a row that are fractions of a digitiser step, in the same order.
    ///
    /// Empty for blocks of whole steps.
    pub fn fractions(&self, row: usize) -> impl ExactSizeIterator<Item = &[f32]> {
        let blocks = &self.blocks;
        items(&blocks.rows, row).map(|index| match &blocks.samples {
            SampleValues::Steps(_) => &[],
            SampleValues::Fractions(values) => &values.values()[items(&blocks.lists, index)],
        })
    }

    /// What a recording of large footprints says of a row.
    pub fn footprint(&self, row: usize) -> ContainerFootprint<'_> {
        let FootprintColumns { beam, shot_number, noise_mean_dn, noise_sd_dn, advised_against } =
            &self.footprint;
        ContainerFootprint {
            beam: beam.as_ref().and_then(|names| names.value(row)),
            shot_number: shot_number.as_ref().and_then(|array| value(array, row)),
            noise_mean_dn: noise_mean_dn.as_ref().and_then(|array| value(array, row)),
            noise_sd_dn: noise_sd_dn.as_ref().and_then(|array| value(array, row)),
            is_advised_against: advised_against.as_ref().and_then(|array| value(array, row)) == Some(1),
        }
    }

    /// The instrument's own returns of a row.
    pub fn online(&self, row: usize) -> impl ExactSizeIterator<Item = ContainerOnline> + '_ {
        let online = &self.online;
        items(&online.rows, row).map(|index| ContainerOnline {
            time_ns: online.time_ns.value(index),
            amplitude: online.amplitude.value(index),
        })
    }
}

impl BlockColumns {
    fn at(&self, index: usize) -> ContainerBlock<'_> {
        ContainerBlock {
            channel: self.channel.value(index),
            start_ns: self.start_ns.value(index),
            interval_ns: self.interval_ns.as_ref().and_then(|array| value(array, index)),
            zone: self.zone.as_ref().and_then(|array| value(array, index)),
            gain: self.gain.as_ref().and_then(|array| value(array, index)),
            samples: match &self.samples {
                SampleValues::Steps(values) => &values.values()[items(&self.lists, index)],
                SampleValues::Fractions(_) => &[],
            },
        }
    }
}

fn value<T: ArrowPrimitiveType>(array: &PrimitiveArray<T>, index: usize) -> Option<T::Native> {
    array.is_valid(index).then(|| array.value(index))
}

/// Items of the child array that belong to a row; none for a null.
///
/// Arrow has checked that they are in the child array.
fn items(lists: &ListArray, row: usize) -> Range<usize> {
    if lists.is_null(row) {
        return 0..0;
    }
    let offsets = lists.value_offsets();
    offsets[row] as usize..offsets[row + 1] as usize
}

/// Returns the row whose list contains the item `index`.
fn row_of(lists: &ListArray, index: usize) -> usize {
    let offsets = lists.value_offsets();
    offsets.partition_point(|&offset| offset as usize <= index).saturating_sub(1)
}

/// Columns of a record batch, accessed by type.
struct BatchColumns<'a> {
    columns: &'a [Option<ArrayRef>],
    location: ContainerLocation<'a>,
}

impl BatchColumns<'_> {
    fn get(&self, index: usize) -> Option<&ArrayRef> {
        self.columns.get(index).and_then(Option::as_ref)
    }

    fn primitive<T: ArrowPrimitiveType>(&self, index: usize, name: &str) -> Result<PrimitiveArray<T>> {
        self.typed(name, self.get(index).and_then(|array| array.as_primitive_opt::<T>()))
    }

    fn optional<T: ArrowPrimitiveType>(&self, index: usize, name: &str) -> Result<Option<PrimitiveArray<T>>> {
        self.get(index).map(|array| self.typed(name, array.as_primitive_opt::<T>())).transpose()
    }

    fn text(&self, index: usize, name: &str) -> Result<Option<Texts>> {
        self.get(index).map(|array| self.typed(name, Texts::of(array).as_ref())).transpose()
    }

    fn full<T: ArrowPrimitiveType>(&self, index: usize, name: &str) -> Result<PrimitiveArray<T>> {
        let array = self.primitive::<T>(index, name)?;
        self.no_null(&array, name, 0..array.len(), |row| row)?;
        Ok(array)
    }

    /// As [`BatchColumns::full`]; also accepts signed numbers that are not negative.
    fn unsigned(&self, index: usize, name: &str) -> Result<UInt64Array> {
        let Some(signed) = self.get(index).and_then(|array| array.as_primitive_opt::<Int64Type>()) else {
            return self.full(index, name);
        };
        self.no_null(signed, name, 0..signed.len(), |row| row)?;
        if let Some(row) = signed.values().iter().position(|&number| number < 0) {
            return Err(self.location.bad_row(name, row, "a negative number", "number shots from 0"));
        }
        Ok(signed.values().iter().map(|number| number.cast_unsigned()).collect())
    }

    /// A column of lists; large ones become lists.
    fn lists(&self, name: &str, array: Option<&ArrayRef>) -> Result<ListArray> {
        let lists = array
            .and_then(|array| array.as_list_opt().cloned().or_else(|| narrow(array.as_list_opt::<i64>()?)));
        self.typed(name, lists.as_ref())
    }

    /// The 3n numbers of a column of triples.
    fn triple(&self, index: usize, name: &str) -> Result<Float64Array> {
        let lists: FixedSizeListArray =
            self.typed(name, self.get(index).and_then(|array| array.as_fixed_size_list_opt()))?;
        self.no_null(&lists, name, 0..lists.len(), |row| row)?;
        let values = self.typed(name, lists.values().as_primitive_opt::<Float64Type>())?;
        self.no_null(&values, name, 0..3 * lists.len(), |item| item / 3)?;
        Ok(values)
    }

    fn blocks(&self, index: usize) -> Result<BlockColumns> {
        let rows = self.lists("blocks", self.get(index))?;
        self.no_null(&rows, "blocks", 0..rows.len(), |row| row)?;
        let structs = self.structs(&rows, "blocks")?;
        let lists = self.lists("blocks.samples", structs.column_by_name("samples"))?;
        self.no_null(&lists, "blocks.samples", span(&rows), |item| row_of(&rows, item))?;
        let samples = match lists.values().as_primitive_opt::<Float32Type>() {
            Some(fractions) => SampleValues::Fractions(fractions.clone()),
            None => SampleValues::Steps(
                self.typed("blocks.samples", lists.values().as_primitive_opt::<UInt16Type>())?,
            ),
        };
        let used = span(&rows);
        let within = items_of(&lists, &used);
        self.no_null(lists.values(), "blocks.samples", within, |item| row_of(&rows, row_of(&lists, item)))?;
        let nullable = |name| structs.column_by_name(name);
        Ok(BlockColumns {
            channel: self.inner(&rows, &structs, "blocks.channel", |array| array.as_primitive_opt())?,
            start_ns: self.inner(&rows, &structs, "blocks.start_ns", |array| array.as_primitive_opt())?,
            zone: nullable("zone")
                .map(|array| self.typed("blocks.zone", array.as_primitive_opt()))
                .transpose()?,
            interval_ns: nullable("interval_ns")
                .map(|array| self.typed("blocks.interval_ns", array.as_primitive_opt()))
                .transpose()?,
            gain: nullable(GAIN)
                .map(|array| self.typed("blocks.gain", array.as_primitive_opt()))
                .transpose()?,
            rows,
            lists,
            samples,
        })
    }

    fn online(&self, index: usize) -> Result<Online> {
        let rows = self.lists("online", self.get(index))?;
        let structs = self.structs(&rows, "online")?;
        Ok(Online {
            time_ns: self.inner(&rows, &structs, "online.time_ns", |array| array.as_primitive_opt())?,
            amplitude: self.inner(&rows, &structs, "online.amplitude", |array| array.as_primitive_opt())?,
            rows,
        })
    }

    /// The structs of a column of lists of them.
    fn structs(&self, rows: &ListArray, name: &str) -> Result<StructArray> {
        let structs: StructArray = self.typed(name, rows.values().as_struct_opt())?;
        self.no_null(&structs, name, span(rows), |item| row_of(rows, item))?;
        Ok(structs)
    }

    /// Field of such structs without nulls; `path` is `column.field`.
    fn inner<A: Array + Clone>(
        &self,
        rows: &ListArray,
        structs: &StructArray,
        path: &str,
        cast: impl Fn(&ArrayRef) -> Option<&A>,
    ) -> Result<A> {
        let name = path.rsplit('.').next().unwrap_or(path);
        let array = self.typed(path, structs.column_by_name(name).and_then(cast))?;
        self.no_null(&array, path, span(rows), |item| row_of(rows, item))?;
        Ok(array)
    }

    /// Error for a column of another type than the schema's.
    fn typed<A: Clone>(&self, name: &str, array: Option<&A>) -> Result<A> {
        let problem = "the type is not that of the schema";
        array.cloned().ok_or_else(|| self.location.bad_column(name, None, problem, DAMAGED))
    }

    /// Returns an error at the row of the first null in `within`.
    fn no_null(
        &self,
        array: &dyn Array,
        name: &str,
        within: Range<usize>,
        row_of: impl Fn(usize) -> usize,
    ) -> Result<()> {
        let first_null = array.nulls().and_then(|nulls| within.clone().find(|&item| nulls.is_null(item)));
        match first_null {
            None => Ok(()),
            Some(item) => {
                let remedy = "fill it or leave the row out";
                Err(self.location.bad_row(name, row_of(item), "a null, where none may be", remedy))
            }
        }
    }
}

/// Lists with 32-bit offsets; `None` if there are too many items.
fn narrow(lists: &LargeListArray) -> Option<ListArray> {
    let offsets = lists.offsets().iter().map(|&offset| i32::try_from(offset).ok());
    let offsets = OffsetBuffer::new(offsets.collect::<Option<Vec<i32>>>()?.into());
    let item = Arc::new(Field::new("item", lists.value_type(), true));
    ListArray::try_new(item, offsets, Arc::clone(lists.values()), lists.nulls().cloned()).ok()
}

/// Range of items used by the lists.
fn span(lists: &ListArray) -> Range<usize> {
    items_of(lists, &(0..lists.len()))
}

/// Range of items used by the lists `which`.
fn items_of(lists: &ListArray, which: &Range<usize>) -> Range<usize> {
    let offsets = lists.value_offsets();
    offsets[which.start] as usize..offsets[which.end] as usize
}
