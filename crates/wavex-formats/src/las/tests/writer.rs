//! Written files, read by other programs and by this reader.

use std::io::{Cursor, Seek};
use std::path::Path;
use std::sync::Arc;

use proptest::prelude::*;

use super::made::any_point;
use crate::las::extra_bytes::{self, tests::ATTRIBUTES};
use crate::las::point::PointLayout;
use crate::las::vlr::{self, Vlr};
use crate::las::{
    AMP, CHANNEL, ExtraAttribute, IndexPlace, LasHeader, LasVersion, Point, PointOut, WavePlace, Writer,
    WriterOptions,
};

mod refused;

const WKT: &str = "PROJCS[\"UTM 33N\"]";

pub(super) fn options(extra_attributes: &[ExtraAttribute]) -> WriterOptions<'_> {
    WriterOptions {
        version: LasVersion::V1_4,
        scale: [0.001, 0.001, 0.002],
        offset: [1000.0, -2000.0, 0.0],
        wkt: Some(WKT),
        extra_attributes,
        adjusted_gps_time: true,
        creation_day: 188,
        creation_year: 2015,
        system_identifier: "wavex",
        generating_software: "a name that is longer than the 32 bytes it may have",
        file_source_id: 17,
        project_id: [0; 16],
        waveforms: WavePlace::None,
        index: IndexPlace::None,
        pool: None,
    }
}

/// Writes a file of these points, all with the same extra bytes.
fn write(name: &str, options: &WriterOptions, points: &[PointOut], extra: &[u8]) -> Vec<u8> {
    let mut writer = Writer::new(Cursor::new(Vec::new()), Path::new(name), options).unwrap();
    points.iter().for_each(|point| writer.write_point(point, extra).unwrap());
    assert_eq!(writer.n_points(), points.len() as u64);
    let mut sink = writer.finish().unwrap();
    assert_eq!(sink.stream_position().unwrap(), sink.get_ref().len() as u64);
    sink.into_inner()
}

/// Creates points on a spiral.
///
/// Neighbours are similar, as in a real cloud.
pub(super) fn cloud(n: usize) -> Vec<PointOut> {
    (0..n)
        .map(|i| {
            let t = i as f64 * 0.01;
            PointOut {
                x: 1000.0 + t * t.sin(),
                y: -2000.0 + t * t.cos(),
                z: t,
                intensity: (i % 600) as u16,
                return_number: 1 + (i % 3) as u8,
                number_of_returns: 3,
                gps_time: 1e8 + t,
                ..PointOut::default()
            }
        })
        .collect()
}

fn u16_at(bytes: &[u8], at: usize) -> u16 {
    u16::from_le_bytes(bytes[at..at + 2].try_into().unwrap())
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap())
}

pub(super) fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().unwrap())
}

fn f64_at(bytes: &[u8], at: usize) -> f64 {
    f64::from_bits(u64_at(bytes, at))
}

#[test]
fn the_header_is_spelled_out() {
    let points = [
        PointOut { x: 1001.0, y: -2001.0, z: 10.0, return_number: 1, ..PointOut::default() },
        PointOut { x: 1003.5, y: -2000.0, z: -20.0, return_number: 15, ..PointOut::default() },
        PointOut { x: 1002.0, y: -2000.5, z: 0.0, return_number: 16, ..PointOut::default() },
        PointOut { x: 1002.0, y: -2000.5, z: 0.0, return_number: 0, ..PointOut::default() },
    ];
    let las = write("a.las", &options(&[AMP, CHANNEL]), &points, &[7, 0, 1]);
    assert_eq!(&las[..4], b"LASF");
    assert_eq!((u16_at(&las, 4), u16_at(&las, 6)), (17, 0b10001));
    assert_eq!(las[8..24], [0; 16]);
    assert_eq!(las[24..26], [1, 4]);
    assert_eq!(&las[26..32], b"wavex\0");
    assert_eq!(&las[58..90], b"a name that is longer than the 3");
    assert_eq!((u16_at(&las, 90), u16_at(&las, 92)), (188, 2015));
    let offset_to_points = 375 + (54 + WKT.len() + 1) + (54 + 2 * 192);
    assert_eq!((u16_at(&las, 94), u32_at(&las, 96)), (375, offset_to_points as u32));
    assert_eq!((u32_at(&las, 100), las[104], u16_at(&las, 105)), (2, 6, 33));
    assert_eq!(las[107..131], [0; 24], "legacy counts");
    assert_eq!([131, 139, 147].map(|at| f64_at(&las, at)), [0.001, 0.001, 0.002]);
    assert_eq!([155, 163, 171].map(|at| f64_at(&las, at)), [1000.0, -2000.0, 0.0]);
    assert_eq!([179, 187].map(|at| f64_at(&las, at)), [1003.5, 1001.0]);
    assert_eq!([195, 203].map(|at| f64_at(&las, at)), [-2000.0, -2001.0]);
    assert_eq!([211, 219].map(|at| f64_at(&las, at)), [10.0, -20.0]);
    assert_eq!(las[227..247], [0; 20], "no waveforms, no extended records");
    assert_eq!(u64_at(&las, 247), 4);
    let mut by_return = [0; 15];
    (by_return[0], by_return[14]) = (1, 2);
    assert_eq!(std::array::from_fn(|i| u64_at(&las, 255 + 8 * i)), by_return);

    assert_eq!(&las[375 + 2..375 + 18], b"LASF_Projection\0");
    assert_eq!((u16_at(&las, 375 + 18), u16_at(&las, 375 + 20)), (2112, WKT.len() as u16 + 1));
    assert_eq!(&las[429..429 + WKT.len() + 1], [WKT.as_bytes(), &[0]].concat());
    let extra = 429 + WKT.len() + 1;
    assert_eq!(&las[extra + 2..extra + 12], b"LASF_Spec\0");
    assert_eq!((u16_at(&las, extra + 18), u16_at(&las, extra + 20)), (4, 384));
    assert_eq!(las[extra + 54..extra + 246], AMP.descriptor());
    assert_eq!(las.len(), offset_to_points + 4 * 33);
    assert_eq!(las[offset_to_points..offset_to_points + 4], 1000i32.to_le_bytes());
    assert_eq!(las[offset_to_points + 30..offset_to_points + 33], [7, 0, 1]);

    let laz = write("a.LAZ", &options(&[AMP, CHANNEL]), &points, &[7, 0, 1]);
    assert_eq!((laz[104], u32_at(&laz, 100), u16_at(&laz, 105)), (0x86, 3, 33));
    let items = 54 + 34 + 2 * 6;
    assert_eq!(u32_at(&laz, 96), (offset_to_points + items) as u32);
    assert_eq!(laz[107..375], las[107..375]);
}

/// Returns a system with an EPSG code, which becomes GeoTIFF keys.
fn utm_33() -> String {
    wavex_geodesy::crs::wkt_of_epsg(32633).unwrap()
}

#[test]
fn the_header_of_version_1_2_is_spelled_out() {
    let point = |return_number| PointOut { x: 1001.0, y: -2001.0, return_number, ..PointOut::default() };
    let points: Vec<PointOut> = [1, 1, 5, 6, 15, 0].into_iter().map(point).collect();
    let utm_33 = utm_33();
    let old = WriterOptions { version: LasVersion::V1_2, wkt: Some(&utm_33), ..options(&[AMP]) };
    let las = write("a.las", &old, &points, &[7, 0]);
    assert_eq!((u16_at(&las, 6), las[24], las[25]), (1, 1, 2), "adjusted time, no bit for WKT");
    // Model, raster, citation, system, unit, unit of heights; then the citation itself with a bar
    // and a zero.
    let keys = 4 * 2 * 7;
    let citation = "WGS 84 / UTM zone 33N".len() + 2;
    let offset_to_points = 227 + (54 + keys) + (54 + citation) + (54 + 192);
    assert_eq!((u16_at(&las, 94), u32_at(&las, 96)), (227, offset_to_points as u32));
    assert_eq!((u32_at(&las, 100), las[104], u16_at(&las, 105)), (3, 1, 30));
    assert_eq!([107, 111, 115, 119, 123, 127].map(|at| u32_at(&las, at)), [6, 2, 0, 0, 0, 1]);
    assert_eq!([179, 187].map(|at| f64_at(&las, at)), [1001.0, 1001.0]);
    assert_eq!((u16_at(&las, 227 + 18), u16_at(&las, 227 + 20)), (34735, keys as u16));
    assert_eq!(u16_at(&las, 227 + 54 + keys - 24), 3072, "key of the projected system");
    assert_eq!(u16_at(&las, 227 + 54 + keys - 18), 32633);
    assert_eq!([8, 2].map(|back| u16_at(&las, 227 + 54 + keys - back)), [4099, 9001], "heights are metres");
    assert_eq!(u16_at(&las, 227 + 54 + keys + 18), 34737);
    assert_eq!(las.len(), offset_to_points + 6 * 30);
    assert_eq!(las[offset_to_points + 28..offset_to_points + 30], [7, 0]);

    let laz = write("a.laz", &old, &points, &[7, 0]);
    assert_eq!((laz[104], u32_at(&laz, 100)), (0x81, 4));
    assert_eq!(laz[107..227], las[107..227]);
    let without_code = write("a.las", &WriterOptions { wkt: Some(WKT), ..old }, &points, &[7, 0]);
    assert_eq!((u16_at(&without_code, 6), u16_at(&without_code, 227 + 18)), (1, 2112));
}

#[test]
fn without_crs_and_in_week_time_the_bits_are_clear() {
    let plain = WriterOptions { wkt: None, adjusted_gps_time: false, ..options(&[]) };
    let las = write("a.las", &plain, &[], &[]);
    assert_eq!(las.len(), 375);
    assert_eq!((u16_at(&las, 6), u32_at(&las, 100), u64_at(&las, 247)), (0, 0, 0));
    assert_eq!(las[179..227], [0; 48], "no points, no bounding box");
}

/// Returns header and uncompressed records of a file.
///
/// LAZ is decoded by the `laz` crate.
fn records(bytes: &[u8]) -> (LasHeader, Vec<u8>) {
    let header = LasHeader::read(&mut &*bytes, Path::new("a"), bytes.len() as u64).unwrap();
    let start = header.offset_to_points as usize;
    let length = header.n_points as usize * usize::from(header.record_length);
    if !header.compressed {
        assert_eq!(bytes.len(), start + length);
        return (header, bytes[start..].to_vec());
    }
    let vlrs = vlr::read_vlrs(&mut Cursor::new(bytes), Path::new("a"), &header).unwrap();
    let vlr = vlrs.iter().find(|vlr| vlr.is("laszip encoded", 22204)).unwrap();
    let mut cursor = Cursor::new(bytes);
    cursor.set_position(start as u64);
    let laz = laz::LazVlr::from_buffer(&vlr.data).unwrap();
    let mut out = vec![0; length];
    laz::LasZipDecompressor::new(cursor, laz).unwrap().decompress_many(&mut out).unwrap();
    (header, out)
}

#[test]
fn las_and_laz_hold_the_same_records_whatever_the_threads() {
    let points = cloud(230_000);
    let extra = [1, 2, 3];
    let with = |threads| {
        let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let pool = (threads > 0).then(|| Arc::new(pool(threads)));
        WriterOptions { pool, ..options(&[AMP, CHANNEL]) }
    };
    let las = write("a.las", &with(1), &points, &extra);
    let laz = [0, 1, 2, 3].map(|threads| write("a.laz", &with(threads), &points, &extra));
    assert!(laz.iter().all(|other| *other == laz[0]));
    assert!(laz[0].len() < las.len() / 2);
    let (header, plain) = records(&las);
    let (compressed_header, compressed) = records(&laz[0]);
    assert!(plain == compressed);
    assert_eq!(header.n_points, 230_000);
    assert_eq!(header.n_points_by_return[..4], [76_667, 76_667, 76_666, 0]);
    let same = LasHeader {
        compressed: false,
        n_vlrs: 2,
        offset_to_points: header.offset_to_points,
        start_of_evlrs: 0,
        ..compressed_header
    };
    assert_eq!(header, same);
}

#[test]
fn an_index_follows_compressed_points() {
    let options = WriterOptions { index: IndexPlace::Appended, ..options(&[CHANNEL]) };
    let beside = WriterOptions { index: IndexPlace::Beside, ..options.clone() };
    let points = cloud(100);
    let mut writer = Writer::new(Cursor::new(Vec::new()), Path::new("a.las"), &beside).unwrap();
    points.iter().for_each(|point| writer.write_point(point, &[1]).unwrap());
    let index = writer.take_index().unwrap();
    assert_eq!(&index[..4], b"LASX");
    writer.finish().unwrap();

    let bytes = write("a.laz", &options, &points, &[1]);
    let (header, _) = records(&bytes);
    let special = header.offset_to_points as usize - (2 + 2 * 6) - 16;
    let at = u64_at(&bytes, special + 8) as usize;
    assert_eq!((u64_at(&bytes, special), at), (1, bytes.len() - 60 - index.len()));
    assert_eq!((&bytes[at + 2..at + 11], u16_at(&bytes, at + 18)), (&b"LAStools\0"[..], 30));
    assert_eq!(u64_at(&bytes, at + 20), index.len() as u64);
    assert_eq!(bytes[at + 60..], index);
    let without = write("a.laz", &WriterOptions { index: IndexPlace::None, ..options }, &points, &[1]);
    assert_eq!(without.len(), at);
    assert_eq!(without[special..special + 16], [0xff; 16]);
}

#[test]
fn waveforms_of_old_formats_are_compressed_as_laszip_reads_them() {
    let old =
        WriterOptions { version: LasVersion::V1_3, waveforms: WavePlace::Beside, ..options(&[CHANNEL]) };
    let bytes = write("a.laz", &old, &cloud(10), &[1]);
    let at = bytes.windows(14).position(|window| window == b"laszip encoded").unwrap() - 2 + 54 + 32;
    let item = |number: usize| [0, 2, 4].map(|field| u16_at(&bytes, at + 2 + 6 * number + field));
    assert_eq!(u16_at(&bytes, at), 4);
    assert_eq!([0, 1, 2, 3].map(item), [[6, 20, 2], [7, 8, 2], [9, 29, 1], [0, 1, 2]]);
    assert_eq!(records(&bytes).1.len(), 10 * 58);
}

#[test]
fn whole_chunks_and_empty_files_are_valid() {
    for n in [0, 1, 50_000, 100_000] {
        let points = cloud(n);
        let (header, records) = records(&write("a.laz", &options(&[CHANNEL]), &points, &[1]));
        assert_eq!((header.n_points, records.len()), (n as u64, n * 31));
    }
}

fn assert_read_by_las(version: LasVersion, bytes: Vec<u8>, points: &[PointOut], extra: &[u8]) {
    let is_new = version == LasVersion::V1_4;
    let mut reader = las::Reader::new(Cursor::new(bytes)).unwrap();
    let header = reader.header().clone();
    assert_eq!(header.version(), las::Version::new(1, if is_new { 4 } else { 2 }));
    assert_eq!(header.number_of_points(), points.len() as u64);
    assert_eq!((header.has_wkt_crs(), header.gps_time_type()), (is_new, las::GpsTimeType::Standard));
    let read = reader.read_all().unwrap();
    for (written, read) in points.iter().zip(read.points()) {
        let read = read.unwrap();
        let gaps = [read.x - written.x, read.y - written.y, read.z - written.z];
        assert!(
            gaps.iter().zip([0.0005, 0.0005, 0.001]).all(|(gap, half)| gap.abs() <= half + 1e-9),
            "{gaps:?}"
        );
        assert_eq!(read.intensity, written.intensity);
        assert_eq!(
            (read.return_number, read.number_of_returns),
            (written.return_number, written.number_of_returns)
        );
        let to_right = read.scan_direction == las::point::ScanDirection::LeftToRight;
        assert_eq!(
            (to_right, read.is_edge_of_flight_line),
            (written.scan_direction, written.edge_of_flight_line)
        );
        // The crate reads class 12, which is reserved, as the overlap of formats 0 to 5.
        let class = if written.classification == 12 { 1 } else { written.classification };
        assert_eq!((u8::from(read.classification), read.is_withheld), (class, written.withheld));
        assert_eq!((read.scanner_channel, read.user_data), (written.scanner_channel, written.user_data));
        assert!((read.scan_angle - written.scan_angle_deg).abs() < 1e-4);
        assert_eq!(read.point_source_id, written.point_source_id);
        assert_eq!(read.gps_time, Some(written.gps_time));
        assert_eq!(read.extra_bytes, extra);
    }
}

#[test]
fn attributes_are_described_for_other_readers() {
    let mut extra = Vec::new();
    ATTRIBUTES.iter().for_each(|attribute| attribute.push(1.0, &mut extra));
    assert_eq!(extra.len(), 6);
    let bytes = write("a.las", &options(&ATTRIBUTES), &cloud(10), &extra);
    assert_read_by_las(LasVersion::V1_4, bytes.clone(), &cloud(10), &extra);
    let reader = las::Reader::new(Cursor::new(bytes)).unwrap();
    let vlrs = reader.header().vlrs();
    let vlr = vlrs.iter().find(|vlr| (vlr.user_id.as_str(), vlr.record_id) == ("LASF_Spec", 4)).unwrap();
    let ours = Vlr {
        user_id: vlr.user_id.clone(),
        record_id: 4,
        description: String::new(),
        offset: 0,
        length: vlr.data.len() as u64,
        data: vlr.data.clone(),
    };
    let read = extra_bytes::parse(Path::new("a"), &ours).unwrap();
    assert_eq!(read.len(), ATTRIBUTES.len());
    for (read, written) in read.iter().zip(&ATTRIBUTES) {
        assert_eq!((read.name.as_str(), read.scale), (written.name, written.scale));
    }
}
