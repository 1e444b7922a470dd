//! Reads handmade compressed files; covers each error once.

use std::fs;

use super::made::{Made, vlr};
use crate::Result;
use crate::las::{Point, Reader};

/// Reads the points of a file `a.laz` of these bytes.
fn read(bytes: &[u8]) -> Result<Vec<Point>> {
    read_with(bytes, |_| {})
}

/// Reads the points after `prepare`.
fn read_with(bytes: &[u8], prepare: impl Fn(&mut Reader)) -> Result<Vec<Point>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.laz");
    fs::write(&path, bytes).unwrap();
    fs::write(path.with_extension("wdp"), super::made::packets()).unwrap();
    let mut reader = Reader::open(&path)?;
    prepare(&mut reader);
    let (mut points, mut point) = (Vec::new(), Point::default());
    loop {
        match reader.next_point(&mut point) {
            Ok(true) => points.push(point.clone()),
            Ok(false) => return Ok(points),
            Err(error) => {
                // No point follows an error.
                assert!(!reader.next_point(&mut point).unwrap());
                return Err(error);
            }
        }
    }
}

/// Returns the error of a file of these bytes, without its path.
fn refusal(bytes: &[u8]) -> String {
    let error = read(bytes).unwrap_err();
    error.to_string().strip_prefix(&format!("{}: ", error.file().display())).unwrap().to_string()
}

/// Creates a file of 3000 different points, in chunks of 1000.
fn many(minor: u8, format: u8) -> Made {
    let mut made = Made::new(minor, format);
    let record = made.records[0].clone();
    made.records = (0..3000u32)
        .map(|i| {
            let mut record = record.clone();
            record[..4].copy_from_slice(&(i * i).to_le_bytes());
            record[12] = (i * 7) as u8;
            record[17] = (i / 3) as u8;
            record
        })
        .collect();
    made
}

const CUT: &str = "the file is cut off or damaged: copy it again from its source";

/// Returns the start of the compressed points of `made`, after an additional LASzip record of 40
/// bytes and `items`.
fn start(made: &Made, items: usize) -> usize {
    made.offset_to_points() + 54 + 34 + 6 * items
}

#[test]
fn chunks_follow_each_other() {
    for (minor, format) in [(3, 4), (4, 9)] {
        let made = many(minor, format);
        let fixed = [100, 999, 1000, 1001, 50_000].map(|chunk| made.laz(chunk));
        let variable = [1, 1024, 2999].map(|first| made.laz_in_two(first));
        for bytes in fixed.iter().chain(&variable) {
            let points = read(bytes).unwrap();
            assert_eq!(points.len(), 3000);
            for (i, point) in (0..3000).zip(&points) {
                assert_eq!((point.raw[0], point.wave.descriptor), (i * i, 1));
            }
        }
    }
}

#[test]
fn unused_fields_are_skipped_and_the_others_stay() {
    for (format, keeps_user_data) in [(4, true), (9, false)] {
        let bytes = many(if format == 4 { 3 } else { 4 }, format).laz(1000);
        let (all, used) = (read(&bytes).unwrap(), read_with(&bytes, Reader::skip_unused_fields).unwrap());
        let data = |points: &[Point]| points.iter().map(|point| point.user_data).collect::<Vec<_>>();
        assert_eq!(data(&all) == data(&used), keeps_user_data, "format {format}");
        let is_used = |point: &Point| Point { user_data: 0, ..point.clone() };
        assert!(all.iter().map(is_used).eq(used.iter().map(is_used)), "format {format}");
    }
}

#[test]
fn a_writer_that_could_not_go_back_leaves_the_place_of_the_table_at_the_end() {
    let made = many(4, 9);
    let mut bytes = made.laz(1000);
    let at = start(&made, 2);
    let table_at: [u8; 8] = bytes[at..at + 8].try_into().unwrap();
    bytes[at..at + 8].fill(0xff);
    bytes.extend(table_at);
    assert_eq!(read(&bytes).unwrap().len(), 3000);
}

#[test]
fn what_the_compression_says_of_itself_is_checked() {
    let made = Made::new(4, 9);
    let bytes = made.laz(1000);
    assert_eq!(read(&bytes).unwrap().len(), 2);
    assert_eq!(read(&made.laz(1)).unwrap().len(), 2);
    let record = made.offset_to_points() + 54;
    let refusal_with = |at: usize, new: &[u8]| {
        let mut bytes = bytes.clone();
        bytes[at..at + new.len()].copy_from_slice(new);
        refusal(&bytes)
    };
    assert_eq!(
        refusal(&Made { format: 0x89, ..made.clone() }.las()),
        format!(
            "byte 104: point data record format: the points are marked as compressed, but the \
             LASzip record is missing; {CUT}"
        )
    );
    assert_eq!(
        refusal_with(record, &[1, 0]),
        "byte 509: LASzip record: compressor 1 is not supported, only 2 and 3 (chunked); compress \
         the file again with a LASzip of version 2 or later"
    );
    assert_eq!(
        refusal_with(record + 34, &[99, 0]),
        format!("byte 509: LASzip record: Item with type code: 99 is unknown; {CUT}")
    );
    assert_eq!(
        refusal_with(105, &61u16.to_le_bytes()),
        format!(
            "byte 509: LASzip record: its fields do not match format 9 with 2 extra bytes; \
                 {CUT}"
        )
    );
    assert_eq!(
        refusal_with(105, &5000u16.to_le_bytes()),
        "byte 509: LASzip record: 4941 extra bytes per point, but at most 4096 are supported; \
         remove extra attributes from the file"
    );
    assert_eq!(
        refusal_with(record + 38, &[9, 0]),
        format!(
            "byte {}: compressed points: Item Point14 with compression version: 9 is not supported; {CUT}",
            start(&made, 2) + 8
        )
    );
    let mut short = made.clone();
    short.format = 0x89;
    short.vlrs.push(vlr("laszip encoded", 22204, &[3]));
    assert_eq!(
        refusal(&short.las()),
        "byte 509: compressor: 2 bytes needed, 1 left; the file is cut off: copy it again from its \
         source"
    );
}

#[test]
fn the_chunk_table_is_checked() {
    let made = many(4, 9);
    let bytes = made.laz(1000);
    let at = start(&made, 2);
    let table_at = u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize;
    let refusal_with = |at: usize, new: &[u8]| {
        let mut bytes = bytes.clone();
        bytes[at..at + new.len()].copy_from_slice(new);
        refusal(&bytes)
    };
    assert_eq!(
        refusal(&bytes[..at + 7]),
        format!("byte {at}: offset to the chunk table: the file ends before it; {CUT}")
    );
    assert_eq!(
        refusal(&bytes[..table_at]),
        format!(
            "byte {at}: offset to the chunk table: {table_at} is not between the points and the \
             end of the file ({table_at} bytes); {CUT}"
        )
    );
    let room = table_at - at - 8;
    assert_eq!(
        refusal_with(table_at + 4, &u32::MAX.to_le_bytes()),
        format!("byte {table_at}: chunk table: 4294967295 chunks do not fit into {room} bytes; {CUT}")
    );
    assert_eq!(
        refusal_with(table_at + 4, &2u32.to_le_bytes()),
        format!(
            "byte 247: number of point records: the header declares 3000 points, but the chunks hold at \
             most 2000; {CUT}"
        )
    );
    let truncated = refusal(&bytes[..table_at + 10]);
    let expected = format!("byte {table_at}: chunk table: they cannot be decoded (");
    assert!(truncated.starts_with(&expected), "{truncated}");
    let mut table = laz::laszip::ChunkTable::default();
    let entry = laz::laszip::ChunkTableEntry { point_count: 1000, byte_count: room as u64 };
    (0..3).for_each(|_| table.push(entry));
    let laz = laz::LazVlrBuilder::default().with_point_format(9, 0).unwrap().build();
    let mut longer = bytes[..table_at].to_vec();
    table.write_to(&mut longer, &laz).unwrap();
    assert_eq!(
        refusal(&longer),
        format!(
            "byte {table_at}: chunk table: the table declares {} bytes of chunks, but {room} bytes \
             precede it; {CUT}",
            3 * room
        )
    );
}

#[test]
fn damaged_points_are_an_error_at_their_chunk() {
    let made = many(4, 9);
    let bytes = made.laz(1000);
    let first = start(&made, 2) + 8;
    // The sizes of the ten layers follow the first point and the number of points.
    let mut lying = bytes.clone();
    lying[first + 63..first + 67].fill(0xff);
    let error = refusal(&lying);
    assert!(error.starts_with(&format!("byte {}: layers of a chunk: 429496", first + 103)), "{error}");
    // Layers whose sizes were shifted among them run out of data.
    let mut dry = bytes.clone();
    let size = u32::from_le_bytes(dry[first + 63..first + 67].try_into().unwrap());
    dry[first + 63..first + 67].copy_from_slice(&(size / 2).to_le_bytes());
    let error = refusal(&dry);
    let expected = format!("byte {first}: compressed points: they cannot be decoded");
    assert!(error.starts_with(&expected), "{error}");
}

/// A wrong number of points in the header of a file of 3000 points.
#[test]
fn points_that_the_header_does_not_declare_are_refused() {
    for (minor, format, at, extra) in [(3, 4, 107, 4), (4, 9, 247, 8)] {
        let made = many(minor, format);
        let with = |mut bytes: Vec<u8>, n: u64| {
            bytes[at..at + extra].copy_from_slice(&n.to_le_bytes()[..extra]);
            refusal(&bytes)
        };
        for n in [2000, 1, 0] {
            let expected = format!(
                "byte {at}: number of point records: the header declares {n} points, but the chunks hold at \
                 least 2001; {CUT}"
            );
            assert_eq!(with(made.laz(1000), n), expected);
        }
        let expected = format!(
            "byte {at}: number of point records: the header declares 2995 points, but the chunks hold 3000; {CUT}"
        );
        assert_eq!(with(made.laz_in_two(1024), 2995), expected);
        let error = with(made.laz(1000), 2900);
        let problem = match format {
            4 => "bytes of a chunk follow the points that the header declares",
            _ => "number of points of a chunk: it is 1000, but header and chunk table give 900",
        };
        assert!(error.contains(problem) && error.ends_with(CUT), "{error}");
    }
}
