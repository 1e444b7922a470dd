use std::io::BufReader;

use proptest::prelude::*;

use super::*;
use crate::las::LasDescription;
use crate::las::copc::write_copc;
use crate::las::tests::made::{evlr, vlr};

/// A file of any point format; random fields, of which the encoder subtracts some.
fn any_file(format: u8, minor: u8, extra: usize, seed: u64, n: usize) -> Vec<u8> {
    let layout = PointLayout::of(format);
    let mut state = seed;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 56) as u8
    };
    let records = (0..n).map(|k| {
        let mut record: Vec<u8> = (0..layout.length + extra).map(|_| random()).collect();
        for axis in 0..3 {
            record[4 * axis..4 * axis + 4].copy_from_slice(&(k as i32 * 7 - 100 * axis as i32).to_le_bytes());
        }
        if let Some(at) = layout.gps_time {
            record[at..at + 8].copy_from_slice(&(1000.0 + 0.013 * k as f64).to_le_bytes());
        }
        if let Some(at) = layout.wave {
            record[at + 5..at + 9].fill(0);
        }
        record
    });
    let vlrs = [vlr("someone", 9, b"a record"), vlr("another", 10, &[])].concat();
    let header = LasHeader {
        file_source_id: 7,
        guid: *b"0123456789abcdef",
        system_identifier: "a system".into(),
        generating_software: "some software".into(),
        creation_day: 99,
        creation_year: 2001,
        version: (1, minor),
        // Three bytes of the user after the header, and two after the records.
        header_size: crate::las::header::header_bytes(minor) + 3,
        offset_to_points: u32::from(crate::las::header::header_bytes(minor)) + 3 + vlrs.len() as u32 + 2,
        n_vlrs: 2,
        point_format: format,
        record_length: (layout.length + extra) as u16,
        n_points: n as u64,
        n_points_by_return: [n as u64; 15],
        scale: [0.01, 0.02, 0.001],
        offset: [10.0, 20.0, 30.0],
        ..LasHeader::default()
    };
    let mut bytes = header.write();
    let from = bytes.len() - 3;
    bytes[from..].copy_from_slice(b"abc");
    bytes.extend(vlrs);
    bytes.extend(b"de");
    records.for_each(|record| bytes.extend(record));
    if minor >= 4 {
        let at = bytes.len() as u64;
        bytes[EVLRS_AT..EVLRS_AT + 8].copy_from_slice(&at.to_le_bytes());
        bytes[EVLRS_AT + 8..EVLRS_AT + 12].copy_from_slice(&2u32.to_le_bytes());
        bytes.extend([evlr("someone", 1, b"after the points"), evlr("other", 2, &[7; 70_000])].concat());
    }
    bytes
}

/// Compresses a file; chunks of 64 points, or of any number.
fn compressed(las: &[u8], is_variable: bool) -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.las");
    std::fs::write(&path, las).unwrap();
    let mut points = RawPoints::open(&path).unwrap();
    let header = points.header().clone();
    let extra = header.record_length - PointLayout::of(header.point_format).length as u16;
    let builder = laz::LazVlrBuilder::default().with_point_format(header.point_format, extra).unwrap();
    let laz = match is_variable {
        true => builder.with_variable_chunk_size().build(),
        false => builder.with_fixed_chunk_size(64).build(),
    };
    let mut data = Vec::new();
    laz.write_to(&mut data).unwrap();
    let record = vlr("laszip encoded", 22204, &data);
    let start = header.offset_to_points as usize;
    let mut before = las[..start].to_vec();
    before[104] |= 0x80;
    before[100..104].copy_from_slice(&(header.n_vlrs + 1).to_le_bytes());
    before[96..100].copy_from_slice(&((start + record.len()) as u32).to_le_bytes());
    // Before the two bytes of the user.
    let at = start - 2;
    before.splice(at..at, record);
    let mut records = Vec::new();
    while let Some(record) = points.next_record().unwrap() {
        records.extend_from_slice(record);
    }
    let mut sink = Cursor::new(before);
    sink.seek(SeekFrom::End(0)).unwrap();
    let mut compressor = laz::ParLasZipCompressor::new(sink, laz).unwrap();
    if is_variable {
        let (first, second) = records.split_at(
            records.len() / usize::from(header.record_length) / 3 * usize::from(header.record_length),
        );
        compressor.compress_chunks([first, second]).unwrap();
    } else {
        compressor.compress_many(&records).unwrap();
    }
    compressor.done().unwrap();
    let mut bytes = compressor.into_inner().into_inner();
    if header.n_evlrs > 0 {
        let at = bytes.len() as u64;
        bytes[EVLRS_AT..EVLRS_AT + 8].copy_from_slice(&at.to_le_bytes());
        bytes.extend(&las[header.start_of_evlrs as usize..]);
    }
    bytes
}

/// Header without the offset of extended records, records, and points.
type Content = (Vec<u8>, Vec<(String, u16, String, Vec<u8>)>, Vec<Vec<u8>>);

fn content(bytes: &[u8]) -> Content {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.laz");
    std::fs::write(&path, bytes).unwrap();
    let mut points = RawPoints::open(&path).unwrap();
    let header = points.header().clone();
    let mut before = bytes[..header.offset_to_points as usize].to_vec();
    if header.compressed && header.n_evlrs > 0 {
        before[EVLRS_AT..EVLRS_AT + 8].fill(0);
    }
    let records = points
        .vlrs()
        .iter()
        .map(|vlr| (vlr.user_id.clone(), vlr.record_id, vlr.description.clone(), vlr.data.clone()))
        .collect();
    let mut all = Vec::new();
    while let Some(record) = points.next_record().unwrap() {
        all.push(record.to_vec());
    }
    (before, records, all)
}

fn classified(bytes: &[u8], mut class_of: impl FnMut(u64, u8) -> u8) -> Result<(Vec<u8>, ClassifiedCopy)> {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("a.laz");
    std::fs::write(&source, bytes).unwrap();
    let mut out = Cursor::new(Vec::new());
    let copy = write_classified(&source, &mut out, Path::new("b.laz"), &mut class_of)?;
    Ok((out.into_inner(), copy))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Every bit but those of the class stays, in every point format and version, compressed or not.
    #[test]
    fn only_classes_change(
        format in 0u8..=10, newer in 0u8..3, extra in 0usize..9, seed in any::<u64>(), n in 0usize..200,
        compression in 0..3,
    ) {
        let minor = match format { 0..=3 => 2 + newer.min(2), 4 | 5 => 3 + newer.min(1), _ => 4 };
        let las = any_file(format, minor, extra, seed, n);
        let bytes = match compression { 0 => las, kind => compressed(&las, kind == 1 && n > 3) };
        let new = |k: u64| (k * 5 % 32) as u8;
        let (copy, summary) = classified(&bytes, |k, _| new(k)).unwrap();
        let (before, after) = (content(&bytes), content(&copy));
        prop_assert_eq!(&before.0, &after.0);
        prop_assert_eq!(&before.1, &after.1);
        prop_assert_eq!((summary.n_points, after.2.len()), (n as u64, n));
        let (at, mask) = if format <= 5 { (15, 31) } else { (16, 255) };
        for ((record, other), k) in before.2.iter().zip(&after.2).zip(0..) {
            let mut expected = record.clone();
            expected[at] = expected[at] & !mask | new(k);
            prop_assert_eq!(&expected, other);
        }
        if compression == 0 {
            prop_assert_eq!(bytes.len(), copy.len());
        }
        // Unchanged classes are an unchanged file.
        let (same, summary) = classified(&bytes, |_, class| class).unwrap();
        prop_assert!(summary.n_changed == 0 && (same == bytes || compression == 1), "{:?}", summary);
    }
}

fn copc() -> Vec<u8> {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("a.las");
    std::fs::write(&source, any_file(7, 4, 3, 5, 3000)).unwrap();
    let mut out = Cursor::new(Vec::new());
    let mut keep = |_: &[u8]| unreachable!("few points");
    write_copc(&source, &mut out, Path::new("a.copc.laz"), &mut keep, &mut |_| {}).unwrap();
    out.into_inner()
}

/// The octree of a copy refers to the chunks of the copy: another reader finds all points in its nodes.
#[test]
fn the_copy_of_a_copc_file_is_a_copc_file() {
    let bytes = copc();
    let (copy, summary) = classified(&bytes, |k, _| (k % 19) as u8).unwrap();
    assert!(summary.n_points == 3000 && !summary.lost_octree);
    let mut reader = las::copc::CopcReader::new(Cursor::new(copy.clone())).unwrap();
    let entries: Vec<_> = reader.hierarchy_entries().collect();
    let (mut nodes, mut all) = (entries.len(), Vec::new());
    for entry in &entries {
        all.extend(reader.read_entry(entry).unwrap().raw_bytes().chunks_exact(39).map(<[u8]>::to_vec));
        nodes -= 1;
    }
    let (mut expected, of_source) = (content(&copy).2, content(&bytes).2);
    for (record, of_source) in expected.iter().zip(&of_source) {
        assert_eq!((&record[..16], &record[17..]), (&of_source[..16], &of_source[17..]));
    }
    all.sort();
    expected.sort();
    assert!(nodes == 0 && all == expected);
}

/// A damaged octree is marked as superseded; the points are those of the source.
#[test]
fn damaged_octrees_are_superseded() {
    let bytes = copc();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.laz");
    std::fs::write(&path, &bytes).unwrap();
    let description =
        LasDescription::read(&mut BufReader::new(Cursor::new(&bytes)), &path, bytes.len() as u64).unwrap();
    let octree = description.vlrs.iter().find(|vlr| vlr.is("copc", 1000)).unwrap().offset as usize;
    let info = description.vlrs.iter().find(|vlr| vlr.is("copc", 1)).unwrap().offset as usize;
    let damaged = |at: usize, value: u64| {
        let mut bytes = bytes.clone();
        bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
        bytes
    };
    // The offset of a chunk; offset and length of the page.
    for bytes in [damaged(octree + 16, 5), damaged(info + 40, 7), damaged(info + 48, u64::MAX)] {
        let (copy, summary) = classified(&bytes, |_, _| 2).unwrap();
        assert!(summary.lost_octree && summary.n_points == 3000);
        let (_, records, points) = content(&copy);
        assert_eq!(points.len(), 3000);
        assert!(records.iter().all(|(user, ..)| user != "copc"), "{records:?}");
    }
}

#[test]
fn damaged_files_are_refused() {
    let las = any_file(6, 4, 0, 3, 100);
    for bytes in [&las[..2000], &compressed(&las, false)[..2000], &[]] {
        assert!(classified(bytes, |_, class| class).is_err());
    }
}
