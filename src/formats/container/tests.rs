//! Containers as a whole: what goes in comes out, what is damaged is told, and nothing panics.

use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use arrow_array::types::Int8Type;
use arrow_array::{
    Array, ArrayRef, DictionaryArray, Float64Array, Int32Array, Int64Array, ListArray, RecordBatch,
    StringArray, StringViewArray, StructArray, UInt16Array, UInt64Array, UnionArray,
};
use arrow_buffer::{NullBuffer, ScalarBuffer};
use arrow_ipc::writer::{FileWriter, StreamWriter};
use arrow_schema::{DataType, Field, Fields, Schema, SchemaRef, UnionFields};
use proptest::prelude::*;

use super::*;
use crate::formats::Result;

/// A row and its lists, owned.
#[derive(Clone, Debug, PartialEq)]
struct Row {
    shot: ContainerShot,
    blocks: Vec<(u8, f64, Option<f64>, Option<i16>, Vec<u16>)>,
    online: Vec<ContainerOnline>,
}

fn header() -> ContainerHeader {
    ContainerHeader {
        instrument: Some("made up".into()),
        serial: None,
        sampling_interval_ns: 1.0,
        group_velocity_mps: 299_707_502.0,
        pulse_rate_hz: None,
        time_scale: TimeScale::Unknown,
        gps_week: None,
        frame: Frame::Scanner,
        crs_wkt: None,
        amplitude_low: None,
        amplitude_high: None,
        range_low: None,
        range_high: None,
        recorded: None,
        full_scale_dn: None,
        coordinate_grid: None,
        emission_reference: None,
    }
}

fn row(shot: u64, line: u32) -> Row {
    let samples = |n: u64| (0..n).map(|i| (2 + (shot * 7 + i * i) % 40) as u16).collect();
    Row {
        shot: ContainerShot {
            shot,
            line,
            gps_time_s: (shot % 3 != 0).then_some(1000.0 + shot as f64 * 2.5e-6),
            clock_ps: shot as i64 * 2_500_000,
            origin_m: [0.0, 0.25, shot as f64],
            direction: [0.6, 0.0, -0.8],
            facet: (shot % 4) as u16,
            flags: 1,
            mta_zone: (shot % 2 == 1).then_some(3),
            scan_angle_deg: (shot % 2 == 0).then_some(-12.5),
            frame_scale: (shot == 2).then_some(0.9996),
        },
        blocks: match shot % 4 {
            0 => vec![(channel::REFERENCE, 0.0, None, None, samples(6))],
            1 => vec![],
            _ => vec![
                (channel::REFERENCE, 0.25, None, None, samples(6)),
                (channel::LOW_POWER, 800.5, Some(0.5), Some(-1), samples(20 + shot)),
            ],
        },
        online: (0..shot % 3)
            .map(|i| ContainerOnline { time_ns: 900.0 + i as f64, amplitude: 3.5 })
            .collect(),
    }
}

/// Three lines: of five rows, of none, and of four.
fn lines() -> Vec<Vec<Row>> {
    vec![(0..5).map(|shot| row(shot, 0)).collect(), vec![], (5..9).map(|shot| row(shot, 7)).collect()]
}

fn builder(rows: &[Row]) -> LineBuilder {
    let mut line = LineBuilder::new();
    for row in rows {
        line.shot(&row.shot);
        for (channel, start_ns, interval_ns, zone, samples) in &row.blocks {
            let (channel, start_ns, interval_ns, zone) = (*channel, *start_ns, *interval_ns, *zone);
            line.block(&ContainerBlock { channel, start_ns, interval_ns, zone, samples });
        }
        row.online.iter().for_each(|online| line.online(online));
    }
    line
}

fn write(lines: &[Vec<Row>], file: bool, compression: Compression) -> Vec<u8> {
    let name = Path::new("made.arrow");
    let begin = if file { ContainerWriter::file } else { ContainerWriter::stream };
    let mut writer = begin(Vec::new(), name, &header(), compression).unwrap();
    lines.iter().for_each(|rows| writer.write(builder(rows)).unwrap());
    writer.finish().unwrap()
}

fn rows_of(line: &ContainerLine) -> Vec<Row> {
    let block = |b: ContainerBlock| (b.channel, b.start_ns, b.interval_ns, b.zone, b.samples.to_vec());
    (0..line.rows())
        .map(|row| Row {
            shot: line.shot(row),
            blocks: line.blocks(row).map(block).collect(),
            online: line.online(row).collect(),
        })
        .collect()
}

fn read_rest(mut reader: ContainerReader) -> Result<Vec<Vec<Row>>> {
    let mut lines = Vec::new();
    while let Some(line) = reader.next_line()? {
        lines.push(rows_of(&line));
    }
    Ok(lines)
}

/// Reads from beginning to end, as from standard input.
fn read_stream(bytes: Vec<u8>) -> Result<Vec<Vec<Row>>> {
    read_rest(ContainerReader::from_stream(Path::new("-"), Box::new(Cursor::new(bytes)))?)
}

/// Reads as from a file.
fn read_file(bytes: &[u8]) -> Result<Vec<Vec<Row>>> {
    read_rest(ContainerReader::from_bytes(Path::new("a.arrow"), bytes.to_vec())?)
}

/// What is wrong with a stream, without the file's name and the byte.
fn complaint(bytes: Vec<u8>) -> String {
    let error = read_stream(bytes).unwrap_err().to_string();
    error.split_once(": ").unwrap().1.to_string()
}

const ALL: [Compression; 3] = [Compression::None, Compression::Lz4, Compression::Zstd];

#[test]
fn what_is_written_comes_back_from_files_and_streams() {
    for compression in ALL {
        for file in [true, false] {
            let bytes = write(&lines(), file, compression);
            assert_eq!(read_file(&bytes).unwrap(), lines(), "{compression:?} {file}");
            assert_eq!(read_stream(bytes).unwrap(), lines(), "{compression:?} {file}");
        }
    }
}

#[test]
fn the_same_lines_give_the_same_bytes() {
    for compression in ALL {
        assert_eq!(write(&lines(), true, compression), write(&lines(), true, compression));
    }
}

#[test]
fn a_reader_says_how_far_it_is_and_in_which_form() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.arrow");
    for (file, form) in [(true, "file"), (false, "stream")] {
        std::fs::write(&path, write(&lines(), file, Compression::None)).unwrap();
        let mut reader = ContainerReader::open(&path).unwrap();
        assert_eq!(reader.form(), form);
        assert_eq!(reader.header(), &header());
        let start = reader.progress().unwrap();
        while reader.next_line().unwrap().is_some() {}
        assert!(start < 0.6, "{start}");
        assert_eq!(reader.progress(), Some(1.0));
        assert!(!reader.ended_without_mark());
    }
}

#[test]
fn a_stream_may_end_without_its_mark_but_a_file_may_not() {
    let mut bytes = write(&lines(), false, Compression::None);
    bytes.truncate(bytes.len() - 8);
    let mut reader = ContainerReader::from_stream(Path::new("-"), Box::new(Cursor::new(bytes))).unwrap();
    while reader.next_line().unwrap().is_some() {}
    assert!(reader.ended_without_mark());
    assert_eq!(reader.progress(), None, "nobody knows how much comes through a pipe");
}

#[test]
fn every_cut_of_a_file_is_noticed() {
    let whole = write(&lines(), true, Compression::None);
    let length = *whole.last_chunk::<10>().unwrap().first_chunk::<4>().unwrap();
    // In a pipe the footer is not needed: it stands behind the end mark.
    let footer = whole.len() - 10 - i32::from_le_bytes(length) as usize;
    for len in 0..whole.len() {
        let cut = &whole[..len];
        read_file(cut).unwrap_err();
        assert_eq!(read_stream(cut.to_vec()).is_ok(), len >= footer, "{len} of {}", whole.len());
    }
}

#[test]
fn a_cut_stream_keeps_its_whole_lines() {
    let whole = write(&lines(), false, Compression::Lz4);
    let mut ends = Vec::new();
    for len in 0..whole.len() {
        if let Ok(found) = read_stream(whole[..len].to_vec()) {
            assert_eq!(found, lines()[..found.len()]);
            ends.push(found.len());
        }
    }
    assert_eq!(ends, [0, 1, 2, 3], "behind the schema, and behind each line");
}

#[test]
fn no_flipped_bit_makes_a_panic() {
    // How densely bits are flipped: unpacking is slow in a test.
    for (compression, file, step) in [
        (Compression::None, true, 1),
        (Compression::None, false, 1),
        (Compression::Zstd, false, 2),
        (Compression::Lz4, false, 5),
    ] {
        let whole = write(&lines()[..1], file, compression);
        let mut refused = 0;
        for at in (0..whole.len()).step_by(step) {
            let mut bytes = whole.clone();
            bytes[at] ^= 1 << (at / step % 8);
            let read = if file { read_file(&bytes) } else { read_stream(bytes) };
            refused += usize::from(read.is_err());
        }
        assert!(refused > 500 / step, "{refused}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Words that lie, wherever they stand: lengths, offsets, counts.
    #[test]
    fn no_word_makes_a_panic(
        places in prop::collection::vec((any::<prop::sample::Index>(), word()), 1..4),
        compression in prop::sample::select(&ALL[..]),
        file in any::<bool>(),
    ) {
        let mut bytes = write(&lines()[..1], file, compression);
        for (at, word) in places {
            let at = at.index(bytes.len() / 4) * 4;
            bytes[at..at + 4].copy_from_slice(&word.to_le_bytes());
        }
        let read = if file { read_file(&bytes) } else { read_stream(bytes) };
        if let Ok(found) = read {
            prop_assert!(found.len() <= 1);
        }
    }

    #[test]
    fn no_noise_makes_a_panic(bytes in prop::collection::vec(any::<u8>(), 0..200), magic in any::<bool>()) {
        let mut noise = if magic { b"ARROW1\0\0".to_vec() } else { vec![0xff; 4] };
        noise.extend(bytes);
        read_file(&noise).unwrap_err();
        read_stream(noise).unwrap_err();
    }
}

fn word() -> impl Strategy<Value = u32> {
    prop_oneof![any::<u32>(), Just(0), Just(u32::MAX), Just(i32::MAX as u32), 0..100_000_u32, Just(1 << 31)]
}

#[test]
fn another_file_is_told_at_once() {
    for (bytes, name) in
        [(&b"LASF\0\0\0\0\0\0\0\0\0\0\0\0\0\0"[..], "LAS"), (b"PAR1\x15\x04", "Parquet"), (b"", "empty")]
    {
        assert_eq!(
            complaint(bytes.to_vec()),
            "neither an Arrow IPC file nor a stream; \
             give a waveform container, or use the reader of the file's own format",
            "{name}"
        );
        let error = read_file(bytes).unwrap_err().to_string();
        assert!(error.contains("neither an Arrow IPC file nor a stream"), "{name}: {error}");
    }
}

#[test]
fn a_missing_file_is_named() {
    let Err(error) = ContainerReader::open(Path::new("no/such.arrow")) else { panic!("it opened") };
    assert!(error.to_string().starts_with("no/such.arrow: cannot open: "), "{error}");
}

// ---- record batches that other programs could have written ----

/// The columns of [`lines`]' first line by name, to be changed and written as another program would.
fn columns() -> BTreeMap<usize, (Field, ArrayRef)> {
    let schema: SchemaRef = Arc::new(layout::schema(header().to_metadata()));
    let batch = builder(&lines()[0]).finish(schema.clone()).unwrap();
    let fields = schema.fields().iter().map(|field| field.as_ref().clone());
    fields.zip(batch.columns().to_vec()).enumerate().collect()
}

fn position(name: &str) -> usize {
    layout::COLUMNS.iter().position(|column| column.name == name).unwrap()
}

fn written(columns: BTreeMap<usize, (Field, ArrayRef)>) -> Vec<u8> {
    let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = columns.into_values().unzip();
    let schema = Arc::new(Schema::new_with_metadata(fields, header().to_metadata()));
    let batch = RecordBatch::try_new(schema.clone(), arrays).unwrap();
    let mut writer = StreamWriter::try_new(Vec::new(), &schema).unwrap();
    writer.write(&batch).unwrap();
    writer.into_inner().unwrap()
}

/// The stream of the first line with one column in place of another.
fn with_column(name: &str, array: ArrayRef) -> Vec<u8> {
    let mut columns = columns();
    let field = Field::new(name, array.data_type().clone(), true);
    columns.insert(position(name), (field, array));
    written(columns)
}

#[test]
fn each_missing_column_is_named() {
    for column in layout::COLUMNS {
        let mut columns = columns();
        columns.remove(&position(column.name));
        let result = read_stream(written(columns));
        if column.required {
            let error = result.unwrap_err().to_string();
            let expected = format!(
                "-: byte 0: column `{}`: there is no such column, a {} is expected; \
                 write it as schemas/container.json says",
                column.name,
                column.kind.name()
            );
            assert_eq!(error, expected);
        } else {
            assert_eq!(result.unwrap()[0].len(), 5, "{} is optional", column.name);
        }
    }
}

#[test]
fn another_type_is_named() {
    let shots = Arc::new(Int64Array::from(vec![0, 1, 2, 3, 4]));
    assert_eq!(
        complaint(with_column("shot", shots)),
        "byte 0: column `shot`: the type is Int64 and should be u64; cast it before writing the container"
    );
    let column = |name: &'static str, list: ArrayRef| {
        let DataType::List(item) = columns()[&position("blocks")].0.data_type().clone() else { panic!() };
        let rows = columns()[&position("blocks")].1.as_any().downcast_ref::<ListArray>().unwrap().clone();
        let structs = rows.values().as_any().downcast_ref::<StructArray>().unwrap().clone();
        let (fields, mut arrays, _) = structs.into_parts();
        let at = fields.iter().position(|field| field.name() == name).unwrap();
        let mut fields: Vec<Field> = fields.iter().map(|field| field.as_ref().clone()).collect();
        fields[at] = Field::new(name, list.data_type().clone(), true);
        arrays[at] = list;
        let structs = StructArray::try_new(Fields::from(fields), arrays, None).unwrap();
        let item = Arc::new(Field::new(item.name(), structs.data_type().clone(), true));
        Arc::new(ListArray::try_new(item, rows.offsets().clone(), Arc::new(structs), None).unwrap())
    };
    let blocks = column("start_ns", Arc::new(Int32Array::from(vec![0; 6])));
    assert_eq!(
        complaint(with_column("blocks", blocks)),
        "byte 0: column `blocks.start_ns`: the type is Int32 and should be f64; \
         cast it before writing the container"
    );
    // The reference blocks of shots 0, 2, 3 and 4, and the low-power blocks of 2 and 3.
    let starts = vec![Some(0.0), Some(0.0), Some(0.0), Some(0.0), None, Some(0.0)];
    let blocks = column("start_ns", Arc::new(Float64Array::from(starts)));
    let error = complaint(with_column("blocks", blocks));
    assert!(
        error.ends_with(
            "column `blocks.start_ns`, row 3: a null, where none may be; fill it or leave the row out"
        ),
        "{error}"
    );
    let blocks = column("zone", Arc::new(Int32Array::from(vec![0; 6])));
    let error = complaint(with_column("blocks", blocks));
    assert!(error.contains("column `blocks.zone`: the type is Int32 and should be i16"), "{error}");
}

#[test]
fn nulls_are_named_by_column_and_row() {
    let shots = UInt64Array::from(vec![Some(0), Some(1), Some(2), None, None]);
    let error = complaint(with_column("shot", Arc::new(shots)));
    assert!(
        error.ends_with("column `shot`, row 3: a null, where none may be; fill it or leave the row out"),
        "{error}"
    );

    let nulls = || Some(NullBuffer::from(vec![true, true, false, true, true]));
    let item = Arc::new(Field::new("item", DataType::Float64, true));
    let values: ArrayRef = Arc::new(Float64Array::from(vec![0.0; 15]));
    let triples = arrow_array::FixedSizeListArray::new(item.clone(), 3, values, nulls());
    let error = complaint(with_column("origin", Arc::new(triples)));
    assert!(error.contains("column `origin`, row 2: a null"), "{error}");

    let values: Float64Array = (0..15).map(|i| (i != 13).then_some(0.5)).collect();
    let triples = arrow_array::FixedSizeListArray::new(item, 3, Arc::new(values), None);
    let error = complaint(with_column("direction", Arc::new(triples)));
    assert!(error.contains("column `direction`, row 4: a null"), "{error}");

    let blocks = columns()[&position("blocks")].1.as_any().downcast_ref::<ListArray>().unwrap().clone();
    let (item, offsets, values, _) = blocks.into_parts();
    let blocks = ListArray::new(item, offsets, values, nulls());
    let error = complaint(with_column("blocks", Arc::new(blocks)));
    assert!(error.contains("column `blocks`, row 2: a null"), "{error}");
}

#[test]
fn a_null_sample_is_named_by_its_row() {
    let blocks = columns()[&position("blocks")].1.as_any().downcast_ref::<ListArray>().unwrap().clone();
    let (_, offsets, structs, _) = blocks.into_parts();
    let structs = structs.as_any().downcast_ref::<StructArray>().unwrap().clone();
    let (fields, mut arrays, _) = structs.into_parts();
    let samples = arrays[2].as_any().downcast_ref::<ListArray>().unwrap().clone();
    let (_, of_blocks, values, _) = samples.into_parts();
    let values = values.as_any().downcast_ref::<UInt16Array>().unwrap().clone();
    // Shot 0 has 6 samples; of shot 2 the reference block ends at 12 and the other at 34.
    let values: UInt16Array = (0..values.len()).map(|i| (i != 20).then(|| values.value(i))).collect();
    let item = Arc::new(Field::new("item", DataType::UInt16, true));
    arrays[2] = Arc::new(ListArray::new(item, of_blocks, Arc::new(values), None));
    let mut fields: Vec<Field> = fields.iter().map(|field| field.as_ref().clone()).collect();
    fields[2] = Field::new("samples", arrays[2].data_type().clone(), true);
    let structs = StructArray::new(Fields::from(fields), arrays, None);
    let item = Arc::new(Field::new("element", structs.data_type().clone(), true));
    let blocks = ListArray::new(item, offsets, Arc::new(structs), None);
    let error = complaint(with_column("blocks", Arc::new(blocks)));
    assert!(error.contains("column `blocks.samples`, row 2: a null"), "{error}");
}

#[test]
fn unknown_columns_of_any_type_are_passed_over() {
    let text: ArrayRef = Arc::new(StringArray::from(vec!["a", "b", "c", "d", "e"]));
    let view: ArrayRef =
        Arc::new(StringViewArray::from(vec!["a", "b", "c", "d", "longer than twelve bytes"]));
    let names: DictionaryArray<Int8Type> = vec!["a", "b", "a", "b", "a"].into_iter().collect();
    let union = UnionArray::try_new(
        UnionFields::from_fields([Field::new("a", DataType::Int32, false)]),
        ScalarBuffer::from(vec![0_i8; 5]),
        None,
        vec![Arc::new(Int32Array::from(vec![1; 5]))],
    )
    .unwrap();
    let nothing: ArrayRef = Arc::new(arrow_array::NullArray::new(5));
    let blocks = columns()[&position("blocks")].1.clone();
    let extra = [text, view, Arc::new(names), Arc::new(union), nothing, blocks];
    let mut columns: Vec<(Field, ArrayRef)> = columns().into_values().collect();
    for (index, array) in extra.into_iter().enumerate() {
        // Before, between and behind the known ones.
        let field = Field::new(format!("extra{index}"), array.data_type().clone(), true);
        columns.insert(index * 3, (field, array));
    }
    let columns: BTreeMap<usize, (Field, ArrayRef)> = columns.into_iter().enumerate().collect();
    assert_eq!(read_stream(written(columns.clone())).unwrap(), lines()[..1]);

    let (fields, arrays): (Vec<Field>, Vec<ArrayRef>) = columns.into_values().unzip();
    let schema = Arc::new(Schema::new_with_metadata(fields, header().to_metadata()));
    let batch = RecordBatch::try_new(schema.clone(), arrays).unwrap();
    let mut writer = FileWriter::try_new(Vec::new(), &schema).unwrap();
    writer.write(&batch).unwrap();
    assert_eq!(read_file(&writer.into_inner().unwrap()).unwrap(), lines()[..1]);
}

/// `blocks` with a further field in its structs.
fn with_inner_field(array: ArrayRef) -> Vec<u8> {
    let blocks = columns()[&position("blocks")].1.as_any().downcast_ref::<ListArray>().unwrap().clone();
    let (_, offsets, structs, _) = blocks.into_parts();
    let (fields, mut arrays, _) =
        structs.as_any().downcast_ref::<StructArray>().unwrap().clone().into_parts();
    let mut fields: Vec<Field> = fields.iter().map(|field| field.as_ref().clone()).collect();
    fields.insert(1, Field::new("gate", array.data_type().clone(), true));
    arrays.insert(1, array);
    let structs = StructArray::new(Fields::from(fields), arrays, None);
    let item = Arc::new(Field::new("item", structs.data_type().clone(), true));
    with_column("blocks", Arc::new(ListArray::new(item, offsets, Arc::new(structs), None)))
}

#[test]
fn unknown_fields_of_blocks_are_passed_over_where_that_can_be_done() {
    let gates = Arc::new(StringArray::from(vec!["a", "b", "c", "d", "e", "f"]));
    assert_eq!(read_stream(with_inner_field(gates)).unwrap(), lines()[..1]);
    let gates: DictionaryArray<Int8Type> = vec!["a", "b", "a", "b", "a", "b"].into_iter().collect();
    let error = complaint(with_inner_field(Arc::new(gates)));
    assert!(
        error.contains("column `blocks.gate`: a list cannot be passed over that holds a Dictionary"),
        "{error}"
    );
}

// ---- numbers that lie ----

/// Changes the one place where `from` stands.
fn patch(bytes: &mut [u8], from: &[u8], to: &[u8]) {
    let found: Vec<usize> =
        (0..=bytes.len() - from.len()).filter(|&at| bytes[at..].starts_with(from)).collect();
    assert_eq!(found.len(), 1, "{found:?}");
    bytes[found[0]..][..to.len()].copy_from_slice(to);
}

fn words(numbers: &[i32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

#[test]
fn a_list_that_points_outside_is_named_by_its_row() {
    let whole = write(&lines()[..1], false, Compression::None);
    // The samples of the six blocks of shots 0, 2, 2, 3, 3, 4 of the first line.
    let ends = [0, 6, 12, 34, 40, 63, 69];
    for (at, value, words_of, row) in [
        (6, 70, "a list from 63 to 70 of 69 items", 4),
        (3, 99, "a list from 12 to 99 of 69 items", 2),
        (3, -1, "a list from 12 to -1 of 69 items", 2),
        (4, 33, "a list from 34 to 33 of 69 items", 3),
    ] {
        let mut changed = ends;
        changed[at] = value;
        let mut bytes = whole.clone();
        patch(&mut bytes, &words(&ends), &words(&changed));
        let error = complaint(bytes);
        let expected = format!("column `blocks.samples`, row {row}: {words_of}; the file is damaged");
        assert!(error.contains(&expected), "{error}");
    }
    // The blocks of the rows.
    let mut bytes = whole;
    patch(&mut bytes, &words(&[0, 1, 1, 3, 5, 6]), &words(&[0, 1, 1, 3, 7, 6]));
    let error = complaint(bytes);
    assert!(error.contains("column `blocks`, row 3: a list from 3 to 7 of 6 items"), "{error}");
}

#[test]
fn a_row_is_counted_through_the_whole_container() {
    let mut bytes = write(&lines(), true, Compression::None);
    // The online returns of shots 5 to 8.
    patch(&mut bytes, &words(&[0, 2, 2, 3, 5]), &words(&[0, 2, 2, 6, 5]));
    let error = read_file(&bytes).unwrap_err().to_string();
    assert!(error.contains("column `online`, row 7: a list from 2 to 6 of 5 items"), "{error}");
}

/// A buffer's entry in the metadata of a record batch: where it is, and how long.
fn entry(offset: i64, length: i64) -> Vec<u8> {
    [offset.to_le_bytes(), length.to_le_bytes()].concat()
}

#[test]
fn lengths_of_buffers_that_lie_are_refused() {
    // The first column, of five rows, stands at the beginning of the body, and has no bitmap.
    let whole = write(&lines()[..1], false, Compression::None);
    let shot = entry(0, 40);
    for (lie, problem) in [
        (entry(0, 39), "column `shot`: a buffer of 39 bytes, where 40 are needed"),
        (entry(0, -1), "column `shot`: a buffer of -1 bytes at byte 0 of a body of"),
        (entry(-64, 40), "column `shot`: a buffer of 40 bytes at byte -64 of a body of"),
        (entry(0, 1 << 40), "column `shot`: a buffer of 1099511627776 bytes at byte 0 of a body of"),
        (entry(i64::MAX, 40), "column `shot`: a buffer of 40 bytes at byte 9223372036854775807 of a body of"),
    ] {
        let mut bytes = whole.clone();
        patch(&mut bytes, &shot, &lie);
        let error = complaint(bytes);
        assert!(error.contains(problem), "{error}");
    }
}

#[test]
fn offsets_that_are_no_whole_number_of_words_are_refused() {
    let whole = write(&lines()[..1], false, Compression::None);
    let at = whole.windows(28).position(|window| window == words(&[0, 6, 12, 34, 40, 63, 69])).unwrap();
    // The body starts behind the second message's metadata; the entry is the one of 28 bytes.
    let entries: Vec<usize> = (0..whole.len() - 16)
        .filter(|&i| i64::from_le_bytes(*whole[i + 8..].first_chunk().unwrap()) == 28)
        .filter(|&i| (0..at as i64).contains(&i64::from_le_bytes(*whole[i..].first_chunk().unwrap())))
        .collect();
    assert_eq!(entries.len(), 1, "{entries:?}");
    let mut bytes = whole;
    bytes[entries[0] + 8] = 29;
    let error = complaint(bytes);
    assert!(
        error.contains("column `blocks.samples`: offsets of 29 bytes, which is no multiple of 4"),
        "{error}"
    );
}

#[test]
fn what_a_buffer_is_said_to_unpack_to_must_be_possible() {
    for (compression, most) in [(Compression::Lz4, "255"), (Compression::Zstd, "32768")] {
        // 4000 samples of one value: 8000 bytes that pack well.
        let mut long = row(0, 0);
        long.blocks = vec![(channel::LOW_POWER, 0.0, None, None, vec![3; 4000])];
        let whole = write(&[vec![long]], false, compression);
        for (size, problem) in [
            (1_i64 << 60, "are said to unpack to 1152921504606846976"),
            (-2, "are said to unpack to -2"),
            (100_000, "a buffer that unpacks to 100000 bytes, where 8000 are needed"),
            (7998, "a buffer of 7998 bytes, where 8000 are needed"),
        ] {
            let mut bytes = whole.clone();
            patch(&mut bytes, &8000_i64.to_le_bytes(), &size.to_le_bytes());
            let error = complaint(bytes);
            let lz4_says = size == 100_000 && compression == Compression::Lz4;
            let problem = if lz4_says { "are said to unpack to 100000" } else { problem };
            assert!(error.contains("column `blocks.samples`: "), "{most}: {error}");
            assert!(error.contains(problem), "{most}: {error}");
        }
        // One that is possible but not true is found while unpacking.
        let mut bytes = whole.clone();
        patch(&mut bytes, &8000_i64.to_le_bytes(), &8002_i64.to_le_bytes());
        let error = complaint(bytes);
        assert!(error.contains("column `blocks`, rows 0 to 0: "), "{most}: {error}");
    }
}

#[test]
fn the_layout_stands_in_the_schemas() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("schemas/container.json");
    let expected = serde_json::to_string_pretty(&layout::description()).unwrap() + "\n";
    if std::fs::read_to_string(&path).ok().as_deref() != Some(&expected) {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, expected).unwrap();
        panic!("schemas/container.json was not what the code says: it is now; commit it");
    }
}
