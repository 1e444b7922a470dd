//! Corrupt numbers in metadata: each error names the number.

use super::*;

/// Replaces the only occurrence of `from`.
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
fn a_list_out_of_bounds_is_reported_with_its_row() {
    let whole = without_digests(&lines()[..1], false, Compression::None);
    // The samples of the six blocks of shots 0, 2, 2, 3, 3, 4 of the first line.
    let ends = [0, 6, 12, 34, 40, 63, 69];
    for (at, value, problem, row) in [
        (6, 70, "a list from 63 to 70 of 69 items", 4),
        (3, 99, "a list from 12 to 99 of 69 items", 2),
        (3, -1, "a list from 12 to -1 of 69 items", 2),
        (4, 33, "a list from 34 to 33 of 69 items", 3),
    ] {
        let mut changed = ends;
        changed[at] = value;
        let mut bytes = whole.clone();
        patch(&mut bytes, &words(&ends), &words(&changed));
        let error = refusal(bytes);
        let expected = format!("column `blocks.samples`, row {row}: {problem}; the file is damaged");
        assert!(error.contains(&expected), "{error}");
    }
    // The blocks of the rows.
    let mut bytes = whole;
    patch(&mut bytes, &words(&[0, 1, 1, 3, 5, 6]), &words(&[0, 1, 1, 3, 7, 6]));
    let error = refusal(bytes);
    assert!(error.contains("column `blocks`, row 3: a list from 3 to 7 of 6 items"), "{error}");
}

#[test]
fn a_compressed_list_out_of_bounds_is_reported_with_its_row() {
    // Only the last of 300 shots has online returns: LZ4 keeps the end of its list as literals.
    let mut rows: Vec<Row> = (0..300).map(|shot| Row { online: Vec::new(), ..row(shot, 0) }).collect();
    rows[299].online = row(2, 0).online;
    assert_eq!(rows[299].online.len(), 2);
    let mut bytes = without_digests(&[rows], false, Compression::Lz4);
    patch(&mut bytes, &[0x60, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0], &[0x60, 0, 0, 9]);
    let error = refusal(bytes);
    assert!(error.contains("column `online`, row 299: a list from 0 to 9 of 2 items"), "{error}");
}

#[test]
fn rows_count_from_the_start_of_the_container() {
    let mut bytes = without_digests(&lines(), true, Compression::None);
    // The online returns of shots 5 to 8.
    patch(&mut bytes, &words(&[0, 2, 2, 3, 5]), &words(&[0, 2, 2, 6, 5]));
    let error = read_file(&bytes).unwrap_err().to_string();
    assert!(error.contains("column `online`, row 7: a list from 2 to 6 of 5 items"), "{error}");
}

/// Encodes a buffer entry of a record batch: offset and length.
fn entry(offset: i64, length: i64) -> Vec<u8> {
    [offset.to_le_bytes(), length.to_le_bytes()].concat()
}

#[test]
fn wrong_buffer_entries_are_refused() {
    // The first column has five rows and no bitmap, and starts the body.
    let whole = without_digests(&lines()[..1], false, Compression::None);
    let shot = entry(0, 40);
    for (wrong, problem) in [
        (entry(0, 39), "column `shot`: a buffer of 39 bytes, where 40 are needed"),
        (entry(0, -1), "column `shot`: a buffer of -1 bytes at byte 0 of a body of"),
        (entry(-64, 40), "column `shot`: a buffer of 40 bytes at byte -64 of a body of"),
        (entry(0, 1 << 40), "column `shot`: a buffer of 1099511627776 bytes at byte 0 of a body of"),
        (entry(i64::MAX, 40), "column `shot`: a buffer of 40 bytes at byte 9223372036854775807 of a body of"),
    ] {
        let mut bytes = whole.clone();
        patch(&mut bytes, &shot, &wrong);
        let error = refusal(bytes);
        assert!(error.contains(problem), "{error}");
    }
}

#[test]
fn incomplete_offsets_are_refused() {
    let whole = without_digests(&lines()[..1], false, Compression::None);
    let at = whole.windows(28).position(|window| window == words(&[0, 6, 12, 34, 40, 63, 69])).unwrap();
    // The body follows the metadata of the second message; the entry is that of 28 bytes.
    let entries: Vec<usize> = (0..whole.len() - 16)
        .filter(|&i| i64::from_le_bytes(*whole[i + 8..].first_chunk().unwrap()) == 28)
        .filter(|&i| (0..at as i64).contains(&i64::from_le_bytes(*whole[i..].first_chunk().unwrap())))
        .collect();
    assert_eq!(entries.len(), 1, "{entries:?}");
    let mut bytes = whole;
    bytes[entries[0] + 8] = 29;
    let error = refusal(bytes);
    assert!(
        error.contains("column `blocks.samples`: offsets of 29 bytes, which is no multiple of 4"),
        "{error}"
    );
}

#[test]
fn impossible_decompressed_sizes_are_refused() {
    for (compression, most) in [(Compression::Lz4, "255"), (Compression::Zstd, "32768")] {
        // 4000 samples of one value: 8000 bytes that compress well.
        let mut long = row(0, 0);
        long.blocks = vec![(channel::LOW_POWER, 0.0, None, None, vec![3; 4000])];
        let whole = without_digests(&[vec![long]], false, compression);
        for (size, problem) in [
            (1_i64 << 60, "are said to unpack to 1152921504606846976"),
            (-2, "are said to unpack to -2"),
            (100_000, "a buffer that unpacks to 100000 bytes, where 8000 are needed"),
            (7998, "a buffer of 7998 bytes, where 8000 are needed"),
        ] {
            let mut bytes = whole.clone();
            patch(&mut bytes, &8000_i64.to_le_bytes(), &size.to_le_bytes());
            let error = refusal(bytes);
            let exceeds_lz4 = size == 100_000 && compression == Compression::Lz4;
            let problem = if exceeds_lz4 { "are said to unpack to 100000" } else { problem };
            assert!(error.contains("column `blocks.samples`: "), "{most}: {error}");
            assert!(error.contains(problem), "{most}: {error}");
        }
        // A possible but wrong size is found by decompression.
        let mut bytes = whole.clone();
        patch(&mut bytes, &8000_i64.to_le_bytes(), &8002_i64.to_le_bytes());
        let error = refusal(bytes);
        assert!(error.contains("column `blocks`, rows 0 to 0: "), "{most}: {error}");
    }
}

/// Returns the first record batch in the footer: offset, lengths of metadata and body.
fn first_block(whole: &[u8]) -> (i64, i32, i64) {
    let end = whole.len() - 10;
    let length = i32::from_le_bytes(*whole[end..].first_chunk().unwrap()) as usize;
    let footer = arrow_ipc::root_as_footer(&whole[end - length..end]).unwrap();
    let block = footer.recordBatches().unwrap().get(0);
    (block.offset(), block.metaDataLength(), block.bodyLength())
}

fn block_bytes((offset, head, body): (i64, i32, i64)) -> Vec<u8> {
    [&offset.to_le_bytes()[..], &head.to_le_bytes(), &[0; 4], &body.to_le_bytes()].concat()
}

#[test]
fn wrong_footers_are_refused() {
    let whole = without_digests(&lines()[..1], true, Compression::None);
    let length = whole.len() - 10;
    for wrong in [i32::MAX, -1, whole.len() as i32 - 17] {
        let mut bytes = whole.clone();
        bytes[length..length + 4].copy_from_slice(&wrong.to_le_bytes());
        let error = read_file(&bytes).unwrap_err().to_string();
        let expected =
            format!("a.arrow: byte {length}: length of the footer: it is {wrong}; the file is damaged");
        assert!(error.starts_with(&expected), "{error}");
    }
    let (offset, head, body) = first_block(&whole);
    for wrong in [
        (offset + 4096, head, body),
        (7, head, body),
        (-8, head, body),
        (i64::MAX, head, body),
        (offset, 7, body),
        (offset, -1, body),
        (offset, head, i64::MAX),
        (offset, head, -1),
    ] {
        let mut bytes = whole.clone();
        patch(&mut bytes, &block_bytes((offset, head, body)), &block_bytes(wrong));
        let error = read_file(&bytes).unwrap_err().to_string();
        let (offset, head, body) = wrong;
        let expected =
            format!("footer, record batch 0: {head} + {body} bytes at byte {offset} do not lie in the file");
        assert!(error.contains(&expected), "{error}");
    }
}

#[test]
fn metadata_longer_than_its_record_batch_are_refused() {
    let whole = without_digests(&lines()[..1], true, Compression::None);
    let (offset, ..) = first_block(&whole);
    for wrong in [i32::MAX, -1, 1 << 20] {
        let mut bytes = whole.clone();
        bytes[offset as usize + 4..][..4].copy_from_slice(&wrong.to_le_bytes());
        let error = read_file(&bytes).unwrap_err().to_string();
        let expected = format!("byte {offset}: length of the metadata: it passes the record batch");
        assert!(error.contains(&expected), "{error}");
        let error = refusal(bytes);
        let expected = match wrong {
            1_048_576 => "metadata of a message: the bytes end at byte".to_string(),
            _ => format!("length of a message: it is {wrong}; the file is damaged"),
        };
        assert!(error.starts_with(&format!("byte {offset}: ")) || wrong == 1 << 20, "{error}");
        assert!(error.contains(&expected), "{error}");
    }
}

#[test]
fn a_body_of_an_impossible_length_is_refused() {
    let whole = without_digests(&lines()[..1], true, Compression::None);
    let (offset, head, body) = first_block(&whole);
    // The footer has the length as well, but a stream does not read it.
    let metadata = offset as usize..offset as usize + head as usize;
    for (wrong, problem) in [
        (
            i64::MAX,
            "length of the body: a record batch of 9223372036854775807 bytes, where at most 1073741824 are read; write one record batch per scan line",
        ),
        (
            (1 << 30) + 1,
            "length of the body: a record batch of 1073741825 bytes, where at most 1073741824 are read",
        ),
        (-1, "length of the body: it is -1; the file is damaged"),
        (1 << 29, "body of a message: the bytes end at byte"),
    ] {
        let mut bytes = whole.clone();
        patch(&mut bytes[metadata.clone()], &body.to_le_bytes(), &i64::to_le_bytes(wrong));
        let error = refusal(bytes);
        assert!(error.contains(problem), "{error}");
    }
}

/// Returns the first message of a stream, the schema, and the rest.
fn schema_and_rest() -> (Vec<u8>, Vec<u8>) {
    let mut schema = without_digests(&lines()[..1], false, Compression::None);
    let length = i32::from_le_bytes(*schema[4..].first_chunk().unwrap()) as usize;
    let rest = schema.split_off(8 + length);
    (schema, rest)
}

#[test]
fn a_stream_begins_with_its_only_schema() {
    let (schema, rest) = schema_and_rest();
    let error = refusal(rest.clone());
    assert!(error.starts_with("byte 0: schema: the first message is no schema"), "{error}");
    let error = refusal([schema.clone(), schema.clone(), rest].concat());
    let expected = format!("byte {}: message: neither a record batch nor a dictionary", schema.len());
    assert!(error.starts_with(&expected), "{error}");
}

/// Returns the errors of streams with one occurrence of `from` in the metadata replaced.
fn refusals(from: &[u8], to: &[u8]) -> Vec<String> {
    let (schema, rest) = schema_and_rest();
    let head = 8 + i32::from_le_bytes(*rest[4..].first_chunk().unwrap()) as usize;
    let offsets = (8..head - from.len()).filter(|&at| rest[at..].starts_with(from));
    let changed = offsets.map(|at| {
        let mut bytes = [schema.clone(), rest.clone()].concat();
        bytes[schema.len() + at..][..to.len()].copy_from_slice(to);
        bytes
    });
    changed.filter_map(|bytes| read_stream(bytes).err()).map(|error| error.to_string()).collect()
}

fn expect_one(refusals: &[String], expected: &str) {
    let found = refusals.iter().filter(|error| error.contains(expected)).count();
    assert_eq!(found, 1, "{expected}: {refusals:?}");
}

#[test]
fn record_batches_of_another_shape_are_refused() {
    let found = refusals(&5_i64.to_le_bytes(), &(-5_i64).to_le_bytes());
    expect_one(&found, "record batch: it has -5 rows; the file is damaged");
    expect_one(&found, "column `shot`: -5 values, 0 of them null, where 5 are expected");
    let found = refusals(&5_i64.to_le_bytes(), &6_i64.to_le_bytes());
    expect_one(&found, "column `shot`: 5 values, 0 of them null, where 6 are expected");
    expect_one(&found, "column `facet`: 6 values, 0 of them null, where 5 are expected");
    // The 23 nodes: the first has five values, none of them null.
    let first = [&5_i64.to_le_bytes()[..], &[0; 8]].concat();
    let nodes = |n: u32| [&n.to_le_bytes()[..], &first].concat();
    let count = (1..100).find(|&n| has(&nodes(n))).unwrap();
    let found = refusals(&nodes(count), &nodes(count - 1));
    expect_one(&found, "column `frame_scale`: the record batch lists fewer buffers than its schema needs");
    // Version 5 is stored as 4, and 3 as 2.
    let found = refusals(&4_i16.to_le_bytes(), &2_i16.to_le_bytes());
    expect_one(
        &found,
        "message: a record batch of the metadata version V3; write it with Arrow 0.8 or later",
    );
}

fn has(bytes: &[u8]) -> bool {
    schema_and_rest().1.windows(bytes.len()).any(|window| window == bytes)
}

#[test]
fn a_union_of_too_many_types_is_refused() {
    use arrow_schema::{DataType, Field, Fields, Schema};
    // The tag changes a struct of 129 fields to a union: 13 is a struct, 14 a union.
    let inner: Fields = (0..129).map(|i| Field::new(i.to_string(), DataType::Int8, true)).collect();
    let field = Field::new("many", DataType::Struct(inner), true);
    let schema = Schema::new_with_metadata(vec![field], header().to_metadata());
    let writer = arrow_ipc::writer::StreamWriter::try_new(Vec::new(), &schema).unwrap();
    let whole = writer.into_inner().unwrap();
    let found = (0..whole.len()).filter(|&at| whole[at] == 13).filter(|&at| {
        let mut bytes = whole.clone();
        bytes[at] = 14;
        refusal(bytes).starts_with("byte 0: column `many`: a union of over 128 types; leave it out")
    });
    assert_eq!(found.count(), 1);
}

#[test]
fn big_endian_numbers_are_refused() {
    let mut made = arrow_ipc::convert::IpcSchemaEncoder::new().schema_to_fb(&arrow_schema::Schema::empty());
    made.reset();
    let mut schema = arrow_ipc::SchemaBuilder::new(&mut made);
    schema.add_endianness(arrow_ipc::Endianness::Big);
    let root = schema.finish();
    made.finish(root, None);
    let schema = arrow_ipc::root_as_schema(made.finished_data()).unwrap();
    let location = location::ContainerLocation { file: Path::new("a.arrow"), offset: 0, first_row: 0 };
    let error = checked_schema::schema_of(schema, location).unwrap_err().to_string();
    assert_eq!(
        error,
        "a.arrow: byte 0: schema: the numbers are big-endian; write the file on a common machine"
    );
}

/// Full disk.
struct Full;

impl std::io::Write for Full {
    fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
        Err(std::io::Error::other("no space left"))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn a_full_disk_is_an_error() {
    let result = ContainerWriter::file(Full, Path::new("a.arrow"), &header(), Compression::None);
    let Err(error) = result else { panic!("writing succeeded") };
    assert_eq!(error.to_string(), "a.arrow: cannot write: no space left");
}
