//! Reads handmade files; covers each error once.

use std::fs;
use std::path::{Path, PathBuf};

use super::made::{Made, descriptor, evlr, packet, packets, vlr};
use crate::las::{GpsTime, LasHeader, Point, Reader, Wave};

/// Creates a folder with `a.las` of these bytes.
fn folder(bytes: &[u8]) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.las");
    fs::write(&path, bytes).unwrap();
    (folder, path)
}

/// Returns an error message without the path of its file.
fn words(error: crate::Error) -> String {
    let text = error.to_string();
    text.strip_prefix(&format!("{}: ", error.file().display())).unwrap().to_string()
}

/// Returns the error of opening a file of these bytes.
fn refusal(bytes: &[u8]) -> String {
    let (_folder, path) = folder(bytes);
    words(Reader::open(&path).err().unwrap())
}

/// Returns the error of opening `made` with the bytes from `at` replaced.
fn refusal_with(made: &Made, at: usize, bytes: &[u8]) -> String {
    let mut file = made.las();
    file[at..at + bytes.len()].copy_from_slice(bytes);
    refusal(&file)
}

fn first_samples(path: &Path) -> Vec<u16> {
    let mut reader = Reader::open(path).unwrap();
    let (mut point, mut samples) = (Point::default(), Vec::new());
    assert!(reader.next_point(&mut point).unwrap());
    reader.packet(&point.wave, &mut samples).unwrap();
    samples
}

#[test]
fn headers_that_contradict_themselves_are_refused() {
    let made = Made { tail: packets(), ..Made::new(3, 4) };
    assert_eq!(refusal(&[]), "the file is empty; copy it again from its source");
    assert_eq!(
        refusal_with(&made, 0, b"FSAL"),
        "byte 0: file signature: expected `LASF`; give a LAS or LAZ file"
    );
    assert_eq!(
        refusal_with(&made, 24, &[2, 0]),
        "byte 24: version: LAS 2.0 is not supported; convert the file to LAS 1.4"
    );
    assert_eq!(
        refusal_with(&made, 94, &227u16.to_le_bytes()),
        "byte 94: header size: 227 bytes, but LAS 1.3 needs 235; the header is damaged: export the \
         file again"
    );
    assert_eq!(
        refusal_with(&made, 96, &234u32.to_le_bytes()),
        "byte 96: offset to point data: 234 lies inside the header of 235 bytes; \
         the header is damaged: export the file again"
    );
    assert_eq!(
        refusal_with(&made, 96, &9999u32.to_le_bytes()),
        "byte 96: offset to point data: 9999 is beyond the end of the file (497 bytes); the file \
         is cut off: copy it again from its source"
    );
    assert_eq!(
        refusal_with(&made, 104, &[11]),
        "byte 104: point data record format: format 11 is unknown; convert the file to LAS 1.4, format 9 or 10"
    );
    assert_eq!(
        refusal_with(&made, 104, &[1]),
        "byte 104: point data record format: no waveforms in point data format 1; \
         export the flight with waveforms, as LAS point format 4, 5, 9 or 10"
    );
    assert_eq!(
        refusal_with(&made, 105, &56u16.to_le_bytes()),
        "byte 105: point data record length: 56 bytes, but format 4 needs 57; the header is \
         damaged: export the file again"
    );
    assert_eq!(
        refusal_with(&made, 107, &4u32.to_le_bytes()),
        "byte 107: number of point records: the header declares 4 points of 57 bytes, but only 3 \
         fit into the file; the file is cut off: copy it again from its source"
    );
    assert_eq!(
        refusal_with(&made, 139, &0f64.to_le_bytes()),
        "byte 131: scale factor: [0.01, 0.0, 0.01] has a zero, so that all points coincide; \
         the header is damaged: export the file again"
    );
    assert_eq!(
        refusal_with(&made, 155, &f64::NAN.to_le_bytes()),
        "byte 155: offset: [NaN, 0.0, 0.0] is not finite; the header is damaged: export the file again"
    );
    assert_eq!(
        refusal(&made.las()[..230]),
        "byte 96: offset to point data: 315 is beyond the end of the file (230 bytes); the file is \
         cut off: copy it again from its source"
    );
}

#[test]
fn records_that_do_not_fit_are_refused() {
    let made = Made { tail: packets(), ..Made::new(3, 4) };
    let cut = "the header is wrong or the file is cut off: copy it again from its source";
    assert_eq!(
        refusal_with(&made, 100, &2u32.to_le_bytes()),
        format!("byte 315: variable length record: record 2 needs 54 bytes, 0 left; {cut}")
    );
    assert_eq!(
        refusal_with(&made, 235 + 20, &27u16.to_le_bytes()),
        format!(
            "byte 255: record length after header: LASF_Spec/100 declares 27 bytes, 26 left; \
                 {cut}"
        )
    );
    let mut made = Made { tail: packets(), n_evlrs: 1, ..Made::new(4, 9) };
    made.tail[20] = 9;
    assert_eq!(
        refusal(&made.las()),
        format!(
            "byte 593: record length after header: LASF_Spec/65535 declares 9 bytes, 8 left; \
                 {cut}"
        )
    );
}

#[test]
fn every_field_of_the_header_is_read() {
    let mut bytes = Made::new(5, 9).las();
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    put(4, &7u16.to_le_bytes());
    put(6, &(1u16 | 16 | 64).to_le_bytes());
    put(8, &[9; 16]);
    put(26, b"system\0");
    put(58, b"software\0");
    put(90, &[42, 0, 0xe7, 0x07]);
    put(155, &1000f64.to_le_bytes());
    for (number, at) in (179..227).step_by(8).enumerate() {
        put(at, &(number as f64).to_le_bytes());
    }
    put(255, &2u64.to_le_bytes());
    put(391, &1500u16.to_le_bytes());
    let header = LasHeader::read(&mut bytes.as_slice(), Path::new("a.las"), bytes.len() as u64).unwrap();
    let mut by_return = [0; 15];
    by_return[0] = 2;
    let expected = LasHeader {
        file_source_id: 7,
        global_encoding: 81,
        guid: [9; 16],
        version: (1, 5),
        system_identifier: "system".into(),
        generating_software: "software".into(),
        creation_day: 42,
        creation_year: 2023,
        header_size: 393,
        offset_to_points: 473,
        n_vlrs: 1,
        point_format: 9,
        compressed: false,
        record_length: 59,
        n_points: 2,
        n_points_by_return: by_return,
        scale: [0.01; 3],
        offset: [1000.0, 0.0, 0.0],
        min: [1.0, 3.0, 5.0],
        max: [0.0, 2.0, 4.0],
        start_of_waveforms: 0,
        start_of_evlrs: 591,
        n_evlrs: 0,
        time_offset_megaseconds: 1500,
    };
    assert_eq!(header, expected);
    assert_eq!(header.gps_time(), GpsTime::Standard { offset_s: 1.5e9 });
    assert!(header.says_wkt());
    let older = LasHeader { version: (1, 4), ..header };
    assert_eq!(older.gps_time(), GpsTime::Standard { offset_s: 1e9 });
    let week = LasHeader { global_encoding: 64, ..older };
    assert_eq!((week.gps_time(), week.says_wkt()), (GpsTime::Week, false));
}

#[test]
fn packets_are_found_wherever_they_can_only_be() {
    let samples = [1, 2, 3, 258];
    for start_of_waveforms in [429, 0, 100, 5000] {
        // Correct, missing or wrong location in the header: the bytes after the points are the only
        // one left.
        let made = Made { tail: packets(), start_of_waveforms, encoding: 2, ..Made::new(3, 4) };
        assert_eq!(made.offset_to_tail(), 429);
        let (_folder, path) = folder(&made.las());
        assert_eq!(first_samples(&path), samples, "{start_of_waveforms}");
    }
    let text = evlr("other", 1, b"text");
    let made = Made { tail: [text, packets()].concat(), n_evlrs: 2, ..Made::new(4, 9) };
    let (_folder, path) = folder(&made.las());
    assert_eq!(first_samples(&path), samples);
    for name in ["a.wdp", "a.WDP", "a.Wdp"] {
        // The header says "inside", where there are none.
        let (folder, path) = folder(&Made { encoding: 2, ..Made::new(4, 9) }.las());
        fs::write(folder.path().join(name), packets()).unwrap();
        assert_eq!(first_samples(&path), samples, "{name}");
    }
}

#[test]
fn with_packets_inside_and_beside_the_header_decides() {
    let mut other = packets();
    other[60] = 77;
    for (encoding, first) in [(2, 1), (4, 77)] {
        let (folder, path) = folder(&Made { tail: packets(), encoding, ..Made::new(3, 4) }.las());
        fs::write(folder.path().join("a.wdp"), &other).unwrap();
        assert_eq!(first_samples(&path)[0], first);
    }
    let (folder, path) = folder(&Made { tail: packets(), encoding: 6, ..Made::new(3, 4) }.las());
    let wdp = folder.path().join("a.wdp");
    fs::write(&wdp, &other).unwrap();
    assert_eq!(
        words(Reader::open(&path).err().unwrap()),
        format!(
            "byte 6: global encoding: waveforms are both inside the file and in `{}`, and the \
             header does not say which to use; move away the waveform file that does not belong to \
             these points",
            wdp.display()
        )
    );
}

/// Two points of format 4 whose packet of four samples, 1, 2, 3 and 258, is compressed.
fn compressed() -> (Made, Vec<u8>) {
    let packet = packet(16, &[1, 2, 3, 258]);
    let mut made = Made { encoding: 4, ..Made::new(3, 4) };
    made.vlrs = vec![vlr("LASF_Spec", 100, &descriptor(16, 1, 4, 1000))];
    made.records.iter_mut().for_each(|record| record[37] = packet.len() as u8);
    (made, evlr("LASF_Spec", 65535, &packet))
}

#[test]
fn compressed_waveforms_are_read_from_any_place() {
    let (made, packets) = compressed();
    let (folder, path) = folder(&made.las());
    for name in ["a.wdz", "a.WDZ", "a.wdp"] {
        fs::write(folder.path().join(name), &packets).unwrap();
        assert_eq!(first_samples(&path), [1, 2, 3, 258]);
        fs::remove_file(folder.path().join(name)).unwrap();
    }
    // The expected one is taken.
    fs::write(folder.path().join("a.wdz"), &packets).unwrap();
    fs::write(folder.path().join("a.wdp"), b"another").unwrap();
    assert_eq!(first_samples(&path), [1, 2, 3, 258]);
    fs::write(&path, Made { tail: packets, encoding: 2, ..made }.las()).unwrap();
    fs::remove_file(folder.path().join("a.wdz")).unwrap();
    assert_eq!(first_samples(&path), [1, 2, 3, 258]);
}

#[test]
fn a_damaged_compressed_packet_is_lost_alone() {
    let (made, packets) = compressed();
    let (folder, path) = folder(&made.las());
    let place = folder.path().join("a.wdz");
    fs::write(&place, [&packets[..], &[0; 300]].concat()).unwrap();
    let mut reader = Reader::open(&path).unwrap();
    let mut samples = vec![5; 5];
    let good = Wave { descriptor: 1, offset: 60, size: packets.len() as u32 - 60, ..Wave::default() };
    let mut problem = |wave: Wave| {
        let error = reader.packet(&wave, &mut samples).unwrap_err();
        assert!(samples.is_empty());
        assert_eq!(reader.packet_descriptor(&wave).unwrap_err().to_string(), error.to_string());
        reader.packet(&good, &mut samples).unwrap();
        assert_eq!(samples, [1, 2, 3, 258]);
        assert_eq!(reader.packet_descriptor(&good).unwrap().samples, 4);
        words(error)
    };
    const AGAIN: &str = "the waveform is damaged: copy the file again from its source, or export it again";
    let cannot = |bytes: u32, problem: &str| {
        format!("byte 60: waveform packet: {bytes} bytes cannot be decompressed: {problem}; {AGAIN}")
    };
    for size in [0, 1, good.size - 1] {
        let problem = problem(Wave { size, ..good });
        assert_eq!(problem, cannot(size, "the encoded data end too early"));
    }
    let longer = problem(Wave { size: good.size + 2, ..good });
    assert_eq!(longer, cannot(good.size + 2, "2 bytes follow its samples"));
    let shifted = problem(Wave { offset: 61, ..good });
    assert!(shifted.contains("61: waveform packet: ") && shifted.ends_with(AGAIN), "{shifted}");
    assert_eq!(
        problem(Wave { size: 37, ..good }),
        "the waveform packet at byte 60 has 37 bytes, but 4 compressed samples take at most 36; the point or \
         its descriptor is damaged: export the file again"
    );
    let outside = problem(Wave { offset: 60 + 10_000, ..good });
    assert!(outside.contains("are outside the packets"), "{outside}");
}

#[test]
fn descriptors_of_lastools_must_be_those_of_the_points() {
    let (made, packets) = compressed();
    let described = |description: &[u8]| {
        let (folder, path) = folder(&made.las());
        let bytes = [&packets[..60], b"LAStools waveform 210117", description].concat();
        fs::write(folder.path().join("a.wdz"), bytes).unwrap();
        Reader::open(&path).err().map(words)
    };
    assert_eq!(described(&[1, 0, 1, 0, 1, 16, 4, 0]), None);
    for other in [[2, 0, 1, 16, 4, 0], [1, 0, 0, 16, 4, 0], [1, 0, 1, 8, 4, 0], [1, 0, 1, 16, 5, 0]] {
        let differs = format!(
            "byte 86: waveform descriptor {}: it differs from that of the points; the waveforms belong to \
             another file: give those that were exported with the points",
            other[0]
        );
        assert_eq!(described(&[&[1, 0], &other[..]].concat()), Some(differs));
    }
    let cut = described(&[2, 0, 1, 0, 1, 16, 4, 0]).unwrap();
    assert!(cut.contains("are outside the packets"), "{cut}");
}

#[test]
fn waveform_files_that_are_missing_or_no_such_are_refused() {
    assert_eq!(
        refusal(&Made { encoding: 4, ..Made::new(3, 4) }.las()),
        "its waveforms are missing: neither inside the file nor in `a.wdp` next to it; copy \
         `a.wdp` into the same folder, or export the file with its waveforms inside"
    );
    let (folder, path) = folder(&Made::new(3, 4).las());
    let wdp = folder.path().join("a.wdp");
    let refusal = |bytes: &[u8]| {
        fs::write(&wdp, bytes).unwrap();
        let error = Reader::open(&path).err().unwrap();
        assert_eq!(error.file(), wdp);
        words(error)
    };
    assert_eq!(refusal(&[]), "the file is empty; copy it again from its source");
    assert_eq!(
        refusal(&[0; 100]),
        "byte 0: header: this is not a waveform packet file (LASF_Spec/65535); give the `.wdp` \
         or `.wdz` file that was exported together with the points"
    );
    assert_eq!(
        refusal(&packets()[..67]),
        "byte 20: record length after header: LASF_Spec/65535 declares 8 bytes, 7 left; the header \
         is wrong or the file is cut off: copy it again from its source"
    );
}

#[test]
fn a_length_of_zero_means_to_the_end_of_the_file() {
    let mut made = Made { tail: packets(), ..Made::new(3, 4) };
    made.tail[20] = 0;
    let (_folder, path) = folder(&made.las());
    assert_eq!(first_samples(&path), [1, 2, 3, 258]);
}

#[test]
fn a_bad_packet_is_lost_alone() {
    let mut made = Made { tail: packets(), ..Made::new(3, 4) };
    made.vlrs.push(vlr("LASF_Spec", 102, &descriptor(16, 0, 0, 0)));
    made.vlrs.push(vlr("LASF_Spec", 103, &descriptor(16, 2, 4, 1000)));
    made.vlrs.push(vlr("LASF_Spec", 104, &descriptor(32, 0, 4, 1000)));
    let (_folder, path) = folder(&made.las());
    let mut reader = Reader::open(&path).unwrap();
    let mut samples = vec![5; 5];
    let good = Wave { descriptor: 1, offset: 60, size: 8, ..Wave::default() };
    let mut problem = |wave: Wave| {
        let words = words(reader.packet(&wave, &mut samples).unwrap_err());
        assert!(samples.is_empty());
        reader.packet(&good, &mut samples).unwrap();
        assert_eq!(samples, [1, 2, 3, 258]);
        words
    };
    assert_eq!(problem(Wave::default()), "a point has no waveform (descriptor 0); leave the point out");
    assert_eq!(
        problem(Wave { descriptor: 2, ..good }),
        "a point refers to waveform descriptor 2, but LASF_Spec/101 is missing; the point or the \
         header is damaged: export the file again"
    );
    assert_eq!(
        problem(Wave { descriptor: 3, ..good }),
        "waveform descriptor 3 (LASF_Spec/102): it is empty (0 samples every 0 ps); \
         the point has no waveform: leave it out"
    );
    assert_eq!(
        problem(Wave { descriptor: 4, ..good }),
        "waveform descriptor 4 (LASF_Spec/103): compression 2 is not defined; \
         export the waveforms again, uncompressed and with 8 or 16 bits"
    );
    assert_eq!(
        problem(Wave { descriptor: 5, size: 16, ..good }),
        "waveform descriptor 5 (LASF_Spec/104): 32 bits per sample are not supported, only 2 to \
         16; export the waveforms again, uncompressed and with 8 or 16 bits"
    );
    assert_eq!(
        problem(Wave { size: 7, ..good }),
        "the waveform packet at byte 60 has 7 bytes, but 4 samples of 16 bits need 8; the point or \
         its descriptor is damaged: export the file again"
    );
    let start = made.offset_to_tail() as u64;
    for offset in [0, 59, 61, u64::MAX] {
        assert_eq!(
            problem(Wave { offset, ..good }),
            format!(
                "byte {}: waveform packet: 8 bytes at offset {offset} are outside the packets (60 \
                 to 68); the point is damaged or the waveforms belong to another file: export both \
                 again",
                start.saturating_add(offset)
            )
        );
    }
}

#[test]
fn packets_are_right_in_any_order() {
    let n = 50_000u64;
    let data: Vec<u8> = (0..n).flat_map(|i| [1u16, 2, 3, i as u16]).flat_map(u16::to_le_bytes).collect();
    let (folder, path) = folder(&Made { encoding: 4, ..Made::new(4, 9) }.las());
    fs::write(folder.path().join("a.wdp"), evlr("LASF_Spec", 65535, &data)).unwrap();
    let mut reader = Reader::open(&path).unwrap();
    let mut samples = Vec::new();
    let ahead = 0..n;
    let twice_back = (0..n).rev().step_by(97).flat_map(|i| [i, i]);
    let jumping = (0..2000).map(|i| i * 7919 % n);
    for i in ahead.chain(twice_back).chain(jumping) {
        let wave = Wave { descriptor: 1, offset: 60 + 8 * i, size: 8, ..Wave::default() };
        reader.packet(&wave, &mut samples).unwrap();
        assert_eq!(samples, [1, 2, 3, i as u16]);
    }
}

#[test]
fn what_else_a_file_says_is_kept() {
    let mut made = Made { tail: packets(), ..Made::new(4, 9) };
    let extra = crate::las::AMP.descriptor();
    made.vlrs.push(vlr("LASF_Spec", 4, &extra));
    made.vlrs.push(vlr("LASF_Projection", 34735, &[1, 0, 1, 0]));
    made.tail.extend(evlr("LASF_Projection", 2112, b"PROJCS[]\0\0"));
    made.n_evlrs = 2;
    made.record_length += 2;
    made.records.iter_mut().enumerate().for_each(|(i, record)| record.extend([i as u8, 1]));
    let (_folder, path) = folder(&made.las());
    let mut reader = Reader::open(&path).unwrap();
    assert_eq!(reader.crs().wkt.as_deref(), Some("PROJCS[]"));
    assert_eq!(reader.projection(34735).unwrap().data, [1, 0, 1, 0]);
    assert!(reader.projection(34736).is_none());
    assert_eq!((reader.vlrs().len(), reader.evlrs().len()), (3, 2));
    assert_eq!((reader.evlrs()[0].length, reader.evlrs()[0].data.len()), (8, 0));
    assert_eq!(reader.extra_bytes_descriptors()[0].name, "Amp");
    let mut point = Point::default();
    assert!(reader.extra_bytes().is_empty());
    assert!(reader.next_point(&mut point).unwrap());
    assert_eq!(reader.extra_bytes(), [0, 1]);
    assert!(reader.next_point(&mut point).unwrap());
    assert_eq!(reader.extra_bytes(), [1, 1]);
    assert!(!reader.next_point(&mut point).unwrap());
    assert!(!reader.next_point(&mut point).unwrap());
}

const COUNT_REMEDY: &str = "correct the number of points in the header, or export the file again";

#[test]
fn points_that_the_header_does_not_declare_are_refused() {
    let mut made = Made { tail: packets(), encoding: 2, ..Made::new(3, 4) };
    made.records = vec![made.records[0].clone(); 7];
    made.start_of_waveforms = made.offset_to_tail() as u64;
    assert_eq!(
        refusal_with(&made, 107, &2u32.to_le_bytes()),
        format!(
            "byte 107: number of point records: the header declares 2 points, but 5 more records of 57 \
             bytes follow; {COUNT_REMEDY}"
        )
    );
    let mut made = Made { tail: packets(), n_evlrs: 1, ..Made::new(4, 9) };
    made.records = vec![made.records[0].clone(); 7];
    assert_eq!(
        refusal_with(&made, 247, &6u64.to_le_bytes()),
        format!(
            "byte 247: number of point records: the header declares 6 points, but 1 more record of 59 \
             bytes follow; {COUNT_REMEDY}"
        )
    );
    assert_eq!(
        refusal_with(&made, 247, &8u64.to_le_bytes()),
        format!(
            "byte 247: number of point records: the 8 points end at byte {}, but an extended record begins \
             at byte {}; {COUNT_REMEDY}",
            made.offset_to_tail() + 59,
            made.offset_to_tail()
        )
    );
}

#[test]
fn padding_after_points_is_accepted() {
    for (tail, surplus) in [(vec![7; 57], 0), (vec![0; 59 * 3], 0), (vec![7; 100], 100)] {
        let (folder, path) = folder(&Made { tail, encoding: 4, ..Made::new(4, 9) }.las());
        fs::write(folder.path().join("a.wdp"), packets()).unwrap();
        assert_eq!(Reader::open(&path).unwrap().surplus_bytes(), surplus);
        assert_eq!(first_samples(&path), [1, 2, 3, 258]);
    }
}

#[test]
fn formats_that_the_version_lacks_are_refused() {
    let made = Made { tail: packets(), ..Made::new(4, 9) };
    assert_eq!(
        refusal_with(&made, 25, &[3]),
        "byte 104: point data record format: LAS 1.3 has no format 9; the version or the format is wrong: \
         export the file again"
    );
}

#[test]
fn coordinates_beyond_the_earth_are_refused() {
    let made = Made { tail: packets(), ..Made::new(3, 4) };
    let damaged = "the header is damaged: export the file again";
    assert_eq!(
        refusal_with(&made, 155, &1e300f64.to_le_bytes()),
        format!("byte 155: offset: [1e300, 0.0, 0.0] is no position on the Earth, beyond 1e10; {damaged}")
    );
    for scale in [1e4, -1e300, 1e-300] {
        assert_eq!(
            refusal_with(&made, 131, &f64::to_le_bytes(scale)),
            format!(
                "byte 131: scale factor: [{scale:?}, 0.01, 0.01] is not between 1e-12 and 1e3; {damaged}"
            )
        );
    }
}
