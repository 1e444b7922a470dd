use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;

use super::*;
use crate::las::encoding;
use crate::las::{AMP, IndexPlace, LasVersion, PointOut, WavePlace, WriterOptions};

const WKT_TEXT: &str = "LOCAL_CS[\"a place\"]";
const STEP: f64 = 0.01;

/// Points on a wavy surface of 300 m by 200 m, shot after shot.
fn points(n: usize) -> Vec<PointOut> {
    let point = |i: usize| {
        let (x, y) = ((i * 37 % 30_011) as f64 * STEP, (i * 91 % 20_011) as f64 * STEP);
        PointOut {
            x: 500_000.0 + x,
            y: 5_000_000.0 + y,
            z: 100.0 + (x / 20.0).sin() * 8.0 + (i % 7) as f64,
            intensity: i as u16,
            return_number: (i % 3) as u8 + 1,
            number_of_returns: 3,
            classification: (i % 20) as u8,
            withheld: i.is_multiple_of(20),
            scanner_channel: (i % 4) as u8,
            scan_angle_deg: (i % 60) as f32 - 30.0,
            user_data: i as u8,
            point_source_id: (i % 1000) as u16,
            gps_time: 1e8 + i as f64 * 1e-5,
            edge_of_flight_line: i.is_multiple_of(100),
            scan_direction: i % 200 < 100,
            ..PointOut::default()
        }
    };
    (0..n).map(point).collect()
}

fn options(waveforms: WavePlace, index: IndexPlace) -> WriterOptions<'static> {
    WriterOptions {
        version: LasVersion::V1_4,
        scale: [STEP; 3],
        offset: [500_000.0, 5_000_000.0, 0.0],
        wkt: Some(WKT_TEXT),
        extra_attributes: &[AMP],
        adjusted_gps_time: true,
        creation_day: 73,
        creation_year: 2021,
        system_identifier: "a scanner",
        generating_software: "a program",
        file_source_id: 17,
        project_id: [0; 16],
        waveforms,
        index,
        pool: None,
    }
}

/// Writes points with an extra attribute.
fn write(path: &Path, points: &[PointOut], options: &WriterOptions) {
    let file = fs::File::create(path).unwrap();
    let mut writer = crate::las::Writer::new(file, path, options).unwrap();
    for (number, point) in points.iter().enumerate() {
        let mut extra = Vec::new();
        AMP.push(f64::from(number as u16), &mut extra);
        writer.write_point(point, &extra).unwrap();
    }
    writer.finish().unwrap();
}

fn convert(source: &Path, out: &Path, limits: MemoryLimits) -> Result<CopcSummary> {
    let mut keep = |run: &[u8]| Ok(Box::new(Cursor::new(run.to_vec())) as Box<dyn io::Read>);
    write_within(source, fs::File::create(out).unwrap(), out, &mut keep, &mut |_| (), limits)
}

/// Returns all records of a file, sorted.
fn records(path: &Path) -> Vec<Vec<u8>> {
    let mut points = RawPoints::open(path).unwrap();
    let mut records = Vec::new();
    while let Some(record) = points.next_record().unwrap() {
        records.push(record.to_vec());
    }
    records.sort();
    records
}

fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

fn u64_at(bytes: &[u8], at: usize) -> usize {
    u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap()) as usize
}

fn i32_at(bytes: &[u8], at: usize) -> i32 {
    i32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Folder {
        Folder(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

const SMALL: MemoryLimits = MemoryLimits { leaf_points: 500, sort_bytes: 300_000 };

#[test]
fn records_are_unchanged() {
    let folder = Folder::new();
    let (source, out) = (folder.path("a.laz"), folder.path("a.copc.laz"));
    write(&source, &points(20_000), &options(WavePlace::None, IndexPlace::Appended));
    let summary = convert(&source, &out, SMALL).unwrap();
    assert_eq!((summary.n_points, summary.is_without_waveforms), (20_000, false));
    assert!(summary.n_nodes > 5 && summary.n_levels > 1, "{summary:?}");
    assert_eq!(records(&out), records(&source));
}

#[test]
fn header_and_records_are_kept_and_the_info_is_first() {
    let folder = Folder::new();
    let (source, out) = (folder.path("a.laz"), folder.path("a.copc.laz"));
    write(&source, &points(3000), &options(WavePlace::None, IndexPlace::Appended));
    convert(&source, &out, SMALL).unwrap();
    let (before, after) = (RawPoints::open(&source).unwrap(), RawPoints::open(&out).unwrap());
    let expected = LasHeader {
        generating_software: format!("wavex {}", env!("CARGO_PKG_VERSION")),
        offset_to_points: after.header().offset_to_points,
        n_vlrs: before.header().n_vlrs + 1,
        start_of_evlrs: after.header().start_of_evlrs,
        n_evlrs: 1,
        ..before.header().clone()
    };
    assert_eq!(*after.header(), expected);
    let names = |file: &RawPoints| {
        let name = |vlr: &Vlr| format!("{}/{}", vlr.user_id, vlr.record_id);
        file.vlrs().iter().map(name).collect::<Vec<_>>()
    };
    let expected = ["copc/1", "laszip encoded/22204", "LASF_Projection/2112", "LASF_Spec/4", "copc/1000"];
    assert_eq!(names(&after), expected, "the index of another order of points is gone");
    assert_eq!(after.vlrs()[0].offset, 375 + 54);
    let same = |user_id: &str, record_id| {
        let of = |file: &RawPoints| {
            file.vlrs().iter().find(|vlr| vlr.is(user_id, record_id)).unwrap().data.clone()
        };
        assert_eq!(of(&before), of(&after));
    };
    same("LASF_Projection", 2112);
    same("LASF_Spec", 4);
    assert_eq!(after.fields(), before.fields());
}

#[test]
fn the_octree_leads_to_every_chunk() {
    let folder = Folder::new();
    let (source, out) = (folder.path("a.las"), folder.path("a.copc.laz"));
    write(&source, &points(20_000), &options(WavePlace::None, IndexPlace::None));
    convert(&source, &out, SMALL).unwrap();
    let bytes = fs::read(&out).unwrap();
    let info = &bytes[375 + 54..375 + 54 + 160];
    let (centre, half) = ([f64_at(info, 0), f64_at(info, 8), f64_at(info, 16)], f64_at(info, 24));
    assert_eq!(f64_at(info, 32), half / 64.0, "the spacing of the root's 128 cells");
    let times: Vec<f64> = points(20_000).iter().map(|point| point.gps_time).collect();
    assert_eq!([f64_at(info, 56), f64_at(info, 64)], [times[0], times[19_999]]);
    assert!(info[72..].iter().all(|byte| *byte == 0));
    let (at, length) = (u64_at(info, 40), u64_at(info, 48));
    let file = RawPoints::open(&out).unwrap();
    let record = file.vlrs().iter().find(|vlr| vlr.is("copc", 1000)).unwrap();
    assert_eq!((record.offset as usize, record.length as usize), (at, length));
    let header = file.header();
    let laz = LazVlrBuilder::default().with_point_format(6, 2).unwrap().with_variable_chunk_size().build();
    let (mut keys, mut chunks, mut all) = (BTreeSet::new(), BTreeMap::new(), Vec::new());
    for entry in bytes[at..at + length].chunks(32) {
        let [level, x, y, z] = [0, 4, 8, 12].map(|at| i32_at(entry, at));
        let (at, size, count) = (u64_at(entry, 16), i32_at(entry, 24) as usize, i32_at(entry, 28) as usize);
        chunks.insert(at, size);
        keys.insert([level, x, y, z]);
        let parent = [level - 1, x / 2, y / 2, z / 2];
        assert!(level == 0 || keys.contains(&parent), "parents come first: {parent:?}");
        let edge = 2.0 * half / f64::from(1 << level);
        let mut records = vec![0; count * 32];
        use laz::record::{LayeredPointRecordDecompressor, RecordDecompressor};
        let mut decoder = LayeredPointRecordDecompressor::new(Cursor::new(bytes[at..at + size].to_vec()));
        decoder.set_fields_from(laz.items()).unwrap();
        decoder.decompress_many(&mut records).unwrap();
        for record in records.chunks(32) {
            let place = header.coordinates(raw(record));
            for (axis, number) in [x, y, z].into_iter().enumerate() {
                let low = centre[axis] - half + f64::from(number) * edge;
                assert!(place[axis] >= low - 1e-6 && place[axis] <= low + edge + 1e-6);
            }
            all.push(record.to_vec());
        }
        let times: Vec<f64> = records.chunks(32).map(gps_time).collect();
        assert!(times.is_sorted());
    }
    all.sort();
    assert_eq!(all, records(&source));
    let mut next = header.offset_to_points as usize + 8;
    for (at, size) in chunks {
        assert_eq!(at, next, "chunks follow each other");
        next = at + size;
    }
    assert_eq!(u64_at(&bytes, header.offset_to_points as usize), next, "and then comes their table");
}

#[test]
fn bytes_do_not_depend_on_memory() {
    let folder = Folder::new();
    let source = folder.path("a.laz");
    write(&source, &points(5000), &options(WavePlace::None, IndexPlace::None));
    let file = |name: &str, sort_bytes| {
        let out = folder.path(name);
        convert(&source, &out, MemoryLimits { leaf_points: 500, sort_bytes }).unwrap();
        fs::read(out).unwrap()
    };
    assert!(file("a.copc.laz", 20_000) == file("b.copc.laz", 1 << 30));
}

#[test]
fn waveforms_are_dropped() {
    let folder = Folder::new();
    let (source, out) = (folder.path("a.las"), folder.path("a.copc.laz"));
    write(&source, &points(100), &options(WavePlace::Beside, IndexPlace::None));
    let summary = convert(&source, &out, SMALL).unwrap();
    assert_eq!((summary.n_points, summary.n_nodes, summary.n_levels), (100, 1, 1));
    assert!(summary.is_without_waveforms);
    let shortened: Vec<Vec<u8>> =
        records(&source).iter().map(|record| [&record[..30], &record[59..]].concat()).collect();
    assert_eq!(records(&out), shortened);
    let header = RawPoints::open(&out).unwrap().header().clone();
    assert_eq!((header.point_format, header.global_encoding), (6, encoding::ADJUSTED_TIME | encoding::WKT));
}

#[test]
fn points_in_one_place_are_taken() {
    let folder = Folder::new();
    let (source, out) = (folder.path("a.las"), folder.path("a.copc.laz"));
    let one = points(1).remove(0);
    write(&source, &vec![one; 2000], &options(WavePlace::None, IndexPlace::None));
    let summary = convert(&source, &out, SMALL).unwrap();
    assert_eq!((summary.n_points, summary.n_levels), (2000, cube::DEEPEST + 1));
    assert_eq!(records(&out), records(&source));
}

#[test]
fn unsupported_sources_are_refused() {
    let folder = Folder::new();
    let source = folder.path("a.las");
    let refusal = || convert(&source, &folder.path("a.copc.laz"), SMALL).unwrap_err().to_string();
    let expected = |problem: &str| format!("{}: {problem}", source.display());

    let legacy = WriterOptions { version: LasVersion::V1_2, ..options(WavePlace::None, IndexPlace::None) };
    write(&source, &points(3), &legacy);
    let problem = "COPC needs point format 6 to 10, but this is format 1; write the points with \
                   `version = \"1.4\"`";
    assert_eq!(refusal(), expected(problem));

    write(&source, &[], &options(WavePlace::None, IndexPlace::None));
    assert_eq!(refusal(), expected("it has no points; give a file with points"));

    // LAS 1.5 with a custom time offset: a header 18 bytes longer, with records shifted
    // accordingly.
    write(&source, &points(3), &options(WavePlace::None, IndexPlace::None));
    let mut bytes = fs::read(&source).unwrap();
    let offset = i32_at(&bytes, 96) + 18;
    bytes.splice(375..375, [[0; 16].as_slice(), &[220, 4]].concat());
    bytes[25] = 5;
    bytes[94..96].copy_from_slice(&393u16.to_le_bytes());
    bytes[96..100].copy_from_slice(&offset.to_le_bytes());
    fs::write(&source, bytes).unwrap();
    let problem = "its times have an offset of 1244 million seconds, which LAS 1.4 cannot store; \
                   convert the file to LAS 1.4";
    assert_eq!(refusal(), expected(problem));
}

#[test]
fn a_long_extended_record_is_refused() {
    let folder = Folder::new();
    let source = folder.path("a.las");
    write(&source, &points(3), &options(WavePlace::None, IndexPlace::None));
    let mut bytes = fs::read(&source).unwrap();
    let at = bytes.len() as u64;
    bytes.extend(Vlr::new("me", 7, "", vec![0; (16 << 20) + 1]).write_extended());
    bytes[235..243].copy_from_slice(&at.to_le_bytes());
    bytes[243..247].copy_from_slice(&1u32.to_le_bytes());
    fs::write(&source, bytes).unwrap();
    let error = convert(&source, &folder.path("a.copc.laz"), SMALL).unwrap_err().to_string();
    let problem = "its record me/7 has 16777217 bytes, which is too long; remove that record from the file";
    assert_eq!(error, format!("{}: {problem}", source.display()));
}

#[test]
fn a_short_extended_record_is_carried_over() {
    let folder = Folder::new();
    let (source, out) = (folder.path("a.las"), folder.path("a.copc.laz"));
    write(&source, &points(3), &options(WavePlace::None, IndexPlace::None));
    let mut bytes = fs::read(&source).unwrap();
    let at = bytes.len() as u64;
    bytes.extend(Vlr::new("me", 7, "mine", b"abc".to_vec()).write_extended());
    bytes[235..243].copy_from_slice(&at.to_le_bytes());
    bytes[243..247].copy_from_slice(&1u32.to_le_bytes());
    fs::write(&source, bytes).unwrap();
    convert(&source, &out, SMALL).unwrap();
    let file = RawPoints::open(&out).unwrap();
    let record = file.vlrs().last().unwrap();
    assert_eq!((record.user_id.as_str(), record.record_id, record.data.as_slice()), ("me", 7, &b"abc"[..]));
    assert_eq!(file.header().n_evlrs, 2);
}

#[test]
fn no_records_make_the_compression_panic() {
    let records = Reshape { format: 6, head: 30, extra: 30, extra_length: 0 };
    let laz = records.laz().unwrap();
    let mut state = 1u64;
    for _ in 0..200 {
        let random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 56) as u8
        };
        let bytes: Vec<u8> = std::iter::repeat_with(random).take(30 * 50).collect();
        if let Err(error) = compress(&laz, &bytes) {
            assert!(
                error.to_string().starts_with("the LASzip library cannot compress these points"),
                "{error}"
            );
        }
    }
}

#[test]
fn a_time_of_minus_zero_becomes_zero() {
    let records = Reshape { format: 6, head: 30, extra: 30, extra_length: 1 };
    let mut record = [7; 31];
    record[22..30].copy_from_slice(&(-0.0f64).to_le_bytes());
    let mut out = Vec::new();
    records.reshape(&record, &mut out);
    record[22..30].fill(0);
    assert_eq!(out, record);
}
