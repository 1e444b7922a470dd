//! Invalid files: every message, and no panic for any bytes.

use std::path::Path;

use proptest::prelude::*;

use super::build::{Pair, descriptor, encode, pulse, sampling, write};
use super::peer::data;
use crate::pulsewaves::{PulseDescriptor, Reader, SamplingRecord, SegmentKind, WaveSegments};

mod pulses;

/// Returns the message without the folder.
fn message(dir: &Path, error: &crate::Error) -> String {
    error.to_string().replace(&format!("{}/", dir.display()), "")
}

/// Returns the message of opening these bytes as a pair.
fn opening(pls: &[u8], wvs: &[u8]) -> String {
    let dir = tempfile::tempdir().unwrap();
    let path = write(dir.path(), pls, wvs);
    message(dir.path(), &Reader::open(&path).unwrap_err())
}

/// Returns the message of opening a plain pair with bytes of the pulse file replaced at `at`.
fn opening_with(at: usize, bytes: &[u8]) -> String {
    let pair = Pair::plain(2);
    let mut pls = pair.pls();
    pls[at..at + bytes.len()].copy_from_slice(bytes);
    opening(&pls, &pair.waves)
}

const AGAIN: &str = "export the file again from its source";
const TOOLS: &str = "write the file again with PulseTools of version 0.3";

#[test]
fn a_file_of_another_kind_is_named() {
    let plain = Pair::plain(1);
    let cases = [
        (vec![], "t.pls: the file is empty; copy it again from its source".to_string()),
        (
            b"LASF\0\0\0\0 and so on".to_vec(),
            "t.pls: this is LAS, not PulseWaves; rename it to .las, and read it with the stage `read_las`"
                .to_string(),
        ),
        (
            plain.waves.clone(),
            "t.pls: this is the waves file of a PulseWaves pair; give the .pls or .plz file of the same name"
                .to_string(),
        ),
        (
            plain.pls()[..200].to_vec(),
            "t.pls: byte 200: pulse size: 4 bytes needed, 0 left; the file is cut off: copy it \
             again from its source"
                .to_string(),
        ),
        (
            plain.pls()[..500].to_vec(),
            "t.pls: the pulses start at byte 748, but the file ends earlier; it is cut off: copy \
             it again from its source"
                .to_string(),
        ),
    ];
    for (pls, expected) in cases {
        assert_eq!(opening(&pls, &plain.waves), expected);
    }
}

#[test]
fn a_field_of_the_header_that_cannot_be_is_named() {
    let nan = f64::NAN.to_le_bytes();
    let cases: [(usize, &[u8], String); 12] = [
        (172, &[0, 2], format!("t.pls: PulseWaves version 0.2 is not supported, only 0.3; {TOOLS}")),
        (174, &[95, 1], format!("t.pls: byte 174: header size: 351 is below 352; {AGAIN}")),
        (
            176,
            &351_i64.to_le_bytes(),
            format!(
                "t.pls: byte 176: offset to pulse data: 351 lies within the header of 352 bytes; {AGAIN}"
            ),
        ),
        (184, &(-1_i64).to_le_bytes(), format!("t.pls: byte 184: number of pulses: -1 is negative; {AGAIN}")),
        (192, &[1], format!("t.pls: pulse format 1 is not defined in PulseWaves 0.3, only 0 is; {TOOLS}")),
        (196, &[1], format!("t.pls: byte 200: pulse size: 48 is below the 50 bytes of a pulse; {AGAIN}")),
        (
            200,
            &(1_u32 << 21).to_le_bytes(),
            format!("t.pls: byte 200: pulse size: 2097152 exceeds the limit of 1048576; {AGAIN}"),
        ),
        (
            204,
            &[1],
            "t.pls: its pulses are compressed (scheme 1), but the PulseZIP record is missing; the file is cut \
             off or damaged: copy it again from its source"
                .to_string(),
        ),
        (
            216,
            &70_000_u32.to_le_bytes(),
            format!("t.pls: byte 216: number of variable length records: 70000 is above 65536; {AGAIN}"),
        ),
        (224, &[0; 8], format!("t.pls: byte 224: T scale factor: 0 is not above zero; {AGAIN}")),
        (232, &nan, format!("t.pls: byte 232: T offset: NaN is not a number; {AGAIN}")),
        (272, &nan, format!("t.pls: byte 272: z scale factor: NaN is not a number; {AGAIN}")),
    ];
    for (at, bytes, expected) in cases {
        assert_eq!(opening_with(at, bytes), expected);
    }
}

#[test]
fn a_record_that_cannot_be_is_named() {
    let damaged = "the file is damaged: copy or export it again";
    let cases: [(usize, &[u8], String); 6] = [
        (
            216,
            &[2],
            format!(
                "t.pls: byte 748: variable length record 1: header: 96 bytes needed, but the \
                 pulses start at byte 748; {damaged}"
            ),
        ),
        (
            352 + 24,
            &[0x2D, 1],
            format!(
                "t.pls: byte 376: variable length record 0: record length after header: \
                 301 does not fit before the pulses; {damaged}"
            ),
        ),
        (448, &[91], format!("t.pls: byte 448: composition record: size: 91 is below 92; {AGAIN}")),
        (540, &[103], format!("t.pls: byte 540: sampling record: size: 103 is below 104; {AGAIN}")),
        (
            644,
            &[105],
            "t.pls: byte 644: sampling record: 105 bytes needed, 104 left; the file is cut off: \
             copy it again from its source"
                .to_string(),
        ),
        (
            352 + 16,
            &[5, 0, 0, 0],
            "t.pls: byte 448: PulseZIP record: compressor 92 and coder 0 are not supported, only 1 and 0; write \
             the file again with PulseTools, or uncompressed"
                .to_string(),
        ),
    ];
    for (at, bytes, expected) in cases {
        assert_eq!(opening_with(at, bytes), expected);
    }
}

#[test]
fn a_lookup_table_that_cannot_be_read_is_named() {
    let table = |change: &dyn Fn(&mut Vec<u8>)| {
        let b = super::build::Bytes::default().u32(76).u32(0).u32(1).text("", 64);
        let mut bytes = b.u32(84).u32(0).u32(2).u16(1).u8(8).u8(0).u32(0).text("", 64).f32(1.0).f32(2.0).0;
        change(&mut bytes);
        let mut pair = Pair::plain(1);
        pair.records = vec![("PulseWaves_Spec", 300_001, bytes)];
        opening(&pair.pls(), &pair.waves)
    };
    assert_eq!(
        table(&|b| b[90] = 9),
        "t.pls: byte 538: lookup table: data type: 9 is unknown, only 8 (32-bit float) is defined; \
         export the file again with float tables"
    );
    assert_eq!(
        table(&|b| b[92] = 1),
        "t.pls: byte 540: lookup table: compression: scheme 1 is unknown; export the file again uncompressed"
    );
    assert_eq!(
        table(&|b| b[88 - 4..88].fill(0xFF)),
        "t.pls: byte 608: lookup table: entries: 17179869180 bytes needed, 8 left; the file is cut \
         off: copy it again from its source"
    );
}

#[test]
fn a_record_of_many_megabytes_is_not_read() {
    let mut pair = Pair::plain(1);
    pair.records[0].2.resize((1 << 24) + 1, 0);
    assert_eq!(
        opening(&pair.pls(), &pair.waves),
        "t.pls: byte 448: record 200001 of PulseWaves_Spec: its 16777217 bytes exceed the limit of \
         16777216; the file is damaged: copy or export it again"
    );
}

#[test]
fn the_waves_file_is_found_or_named() {
    let pair = Pair::plain(1);
    let dir = tempfile::tempdir().unwrap();
    let path = write(dir.path(), &pair.pls(), &pair.waves);
    std::fs::rename(dir.path().join("t.wvs"), dir.path().join("t.WVS")).unwrap();
    assert_eq!(Reader::open(&path).unwrap().pulse_count(), 1);
    std::fs::rename(dir.path().join("t.WVS"), dir.path().join("t.wvz")).unwrap();
    assert_eq!(Reader::open(&path).unwrap().pulse_count(), 1);
    let opened = |path: &Path| message(dir.path(), &Reader::open(path).unwrap_err());
    std::fs::remove_file(dir.path().join("t.wvz")).unwrap();
    let compressed = dir.path().join("t.plz");
    std::fs::copy(&path, &compressed).unwrap();
    assert_eq!(
        opened(&compressed),
        "t.plz: its waves file t.wvz is missing; put it into the folder of the pulse file"
    );
    assert_eq!(
        opened(&path),
        "t.pls: its waves file t.wvs is missing; put it into the folder of the pulse file"
    );
    let absent = opened(&dir.path().join("absent.pls"));
    assert!(absent.starts_with("absent.pls: cannot open: "), "{absent}");
    let folder = Reader::open(dir.path()).unwrap_err().to_string();
    assert!(folder.ends_with("this is not a file; give a .pls or .plz file"), "{folder}");
}

#[test]
fn a_waves_file_that_is_none_is_named() {
    let pair = Pair::plain(1);
    let with = |wvs: &[u8]| opening(&pair.pls(), wvs);
    let mut compressed = pair.waves.clone();
    compressed[16] = 2;
    assert_eq!(
        with(&compressed),
        format!("t.wvs: byte 16: compression: scheme 2 is unknown, only 0 and 1; {AGAIN}")
    );
    assert_eq!(with(&[]), "t.wvs: the file is empty; copy it again from its source");
    assert_eq!(
        with(&[7; 100]),
        "t.wvs: this is not a PulseWaves waves file: its signature differs; put the .wvs or \
         .wvz file of the same export next to the pulses"
    );
    assert_eq!(
        with(&pair.waves[..59]),
        "t.wvs: byte 20: reserved: 40 bytes needed, 39 left; the file is cut off: copy it again \
         from its source"
    );
}
