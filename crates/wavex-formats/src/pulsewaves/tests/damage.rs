//! Invalid files: every message, and no panic for any bytes.

use std::path::Path;

use proptest::prelude::*;

use super::build::{Pair, descriptor, encode, pulse, sampling, write};
use super::peer::data;
use crate::pulsewaves::{Descriptor, Reader, Sampling, SegmentKind, Waves};

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

const PULSEZIP: &str = "uncompress the pair with rapidlasso's pulsezip (pulsezip -i in.plz -o out.pls)";
const AGAIN: &str = "export the file again from its source";
const TOOLS: &str = "write the file again with PulseTools of version 0.3";

#[test]
fn a_file_of_another_kind_is_named() {
    let plain = Pair::plain(1);
    let cases = [
        (vec![], "t.pls: the file is empty; copy it again from its source".to_string()),
        (
            b"LASF\0\0\0\0 and so on".to_vec(),
            "t.pls: this is not a PulseWaves pulse file: it starts with \"LASF\\0\\0\\0\\0 and so\"; give a .pls file"
                .to_string(),
        ),
        (
            plain.waves.clone(),
            "t.pls: this is the waves file of a PulseWaves pair; give the .pls file of the same name".to_string(),
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
    let cases: [(usize, &[u8], String); 11] = [
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
        (204, &[1], format!("t.pls: its pulses are compressed (scheme 1); {PULSEZIP}")),
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
        (352 + 16, &[5, 0, 0, 0], format!("t.pls: its pulses are compressed (PulseZIP); {PULSEZIP}")),
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
    let opened = |path: &Path| message(dir.path(), &Reader::open(path).unwrap_err());
    assert_eq!(opened(&path), format!("t.pls: its waves are compressed (.wvz); {PULSEZIP}"));
    std::fs::remove_file(dir.path().join("t.wvz")).unwrap();
    assert_eq!(
        opened(&path),
        "t.pls: its waves file t.wvs is missing; put it into the folder of the pulse file"
    );
    let absent = opened(&dir.path().join("absent.pls"));
    assert!(absent.starts_with("absent.pls: cannot open: "), "{absent}");
    let folder = Reader::open(dir.path()).unwrap_err().to_string();
    assert!(folder.ends_with("this is not a file; give a .pls file"), "{folder}");
}

#[test]
fn a_waves_file_that_is_none_is_named() {
    let pair = Pair::plain(1);
    let with = |wvs: &[u8]| opening(&pair.pls(), wvs);
    let mut compressed = pair.waves.clone();
    compressed[16] = 1;
    assert_eq!(with(&compressed), format!("t.wvs: its waves are compressed (scheme 1); {PULSEZIP}"));
    assert_eq!(with(&[]), "t.wvs: the file is empty; copy it again from its source");
    assert_eq!(
        with(&[7; 100]),
        "t.wvs: this is not a PulseWaves waves file: its signature differs; put the .wvs file of \
         the same export next to the .pls"
    );
    assert_eq!(
        with(&pair.waves[..59]),
        "t.wvs: byte 20: reserved: 40 bytes needed, 39 left; the file is cut off: copy it again \
         from its source"
    );
}

/// Returns the message of reading the waves of pulse 1 of three; the other pulses can be read.
fn waves_of(pair: &Pair) -> String {
    let (mut reader, dir) = pair.open();
    let mut waves = Waves::new();
    let bad = reader.pulse(1).unwrap();
    let mut found = String::new();
    for index in [0, 1, 2] {
        let pulse = reader.pulse(index).unwrap();
        match reader.waves(&pulse, &mut waves) {
            Ok(()) => assert_eq!(waves.segments().len(), 2),
            Err(error) => {
                assert_eq!((index, waves.segments().len()), (bad.index, 0));
                found = message(dir.path(), &error);
            }
        }
    }
    found
}

#[test]
fn a_bad_pulse_is_an_error_of_that_pulse_alone() {
    let with = |offset: i64, descriptor: u8| {
        let mut pair = Pair::plain(3);
        pair.pulses[1] = pulse(0, offset, descriptor, 0);
        waves_of(&pair)
    };
    let offset = |offset: i64| {
        format!(
            "t.pls: byte 804: pulse 1: offset to waves: {offset} is outside the waves file's bytes \
             60 to 75; leave the pulse out, or copy both files again: the waves file may be cut \
             off"
        )
    };
    assert_eq!(with(-1, 1), offset(-1));
    assert_eq!(with(59, 1), offset(59));
    assert_eq!(with(75, 1), offset(75));
    assert_eq!(with(65, 1), "");
    assert_eq!(
        with(72, 1),
        "t.wvs: byte 75: pulse 1: samples: 2 bytes needed, 0 left in the file; leave the pulse \
         out, or copy or export the pair of files again"
    );
    assert_eq!(
        with(65, 9),
        "t.pls: byte 840: pulse 1: pulse descriptor index: the file has no descriptor 9; \
         leave the pulse out, or export the files with 8 or 16 bit uncompressed waves"
    );
}

#[test]
fn a_descriptor_that_is_not_supported_spoils_its_pulses_alone() {
    let with = |change: &dyn Fn(&mut Descriptor)| {
        let mut pair = Pair::plain(3);
        let mut d = descriptor(vec![sampling(SegmentKind::Outgoing, 1, 3)]);
        change(&mut d);
        pair.records.push(("PulseWaves_Spec", 200_002, encode(&d, 0)));
        pair.pulses[1] = pulse(0, 65, 2, 0);
        let message = waves_of(&pair);
        let start = "t.pls: byte 1132: pulse 1: descriptor 2: ";
        let end = "; leave the pulse out, or export the files with 8 or 16 bit uncompressed waves";
        message.strip_prefix(start).and_then(|m| m.strip_suffix(end)).unwrap_or(&message).to_string()
    };
    let first = |change: fn(&mut Sampling)| with(&|d: &mut Descriptor| change(&mut d.samplings[0]));
    assert_eq!(with(&|d| d.compression = 1), "compression: scheme 1 is unknown");
    assert_eq!(with(&|d| d.sample_units_ns = 0.0), "sample units: 0 ns is not a time above zero");
    for (found, expected) in [
        (first(|s| s.bits_per_sample = 32), "bits per sample: 32 bits are not supported, only 8 and 16"),
        (
            first(|s| s.duration_bits = 24),
            "bits for duration from anchor: 24 bits are not supported, only 0, 8, 16 and 32",
        ),
        (
            first(|s| s.duration_scale = 0.0),
            "scale and offset for duration from anchor: 0 and 0 are not a valid time",
        ),
        (
            first(|s| s.segment_count_bits = 32),
            "bits for number of segments: 32 bits are not supported, only 0, 8 and 16",
        ),
        (
            first(|s| s.sample_count = 0),
            "bits for number of samples: neither a stored number nor a fixed one is declared",
        ),
        (first(|s| s.sample_units_ns = f64::NAN), "sample units: NaN ns is not a time above zero"),
        (first(|s| s.compression = 2), "compression: scheme 2 is unknown"),
    ] {
        assert_eq!(found, format!("sampling 0: {expected}"));
    }
}

#[test]
fn a_pulse_of_megabytes_is_refused_before_it_is_read() {
    let mut pair = Pair::plain(3);
    let d = descriptor(vec![sampling(SegmentKind::Outgoing, 1, 5_000_000)]);
    pair.records.push(("PulseWaves_Spec", 200_002, encode(&d, 0)));
    pair.pulses[1] = pulse(0, 60, 2, 0);
    pair.waves.resize(6_000_000, 0);
    assert_eq!(
        waves_of(&pair),
        "t.wvs: byte 60: pulse 1: samples: the waves of the pulse take more than 4194304 bytes; \
         leave the pulse out, or copy or export the pair of files again"
    );
    pair.pulses[1] = pulse(0, 1000, 2, 0);
    let mut many = sampling(SegmentKind::Outgoing, 60_000, 0);
    many.sample_count_bits = 8;
    pair.records[1].2 = encode(&descriptor(vec![many.clone(), many]), 0);
    assert_eq!(
        waves_of(&pair),
        "t.wvs: byte 66536: pulse 1: segments: there are more than 65536; \
         leave the pulse out, or copy or export the pair of files again"
    );
}

#[test]
fn a_promise_of_too_many_pulses_is_checked_against_the_file() {
    let pair = Pair::plain(2);
    let mut pls = pair.pls();
    pls[184..192].copy_from_slice(&i64::MAX.to_le_bytes());
    let dir = tempfile::tempdir().unwrap();
    let mut reader = Reader::open(&write(dir.path(), &pls, &pair.waves)).unwrap();
    assert_eq!(reader.pulse_count(), 2);
    let missing = "pulse 2: the header declares 9223372036854775807 pulses, but the file has 2";
    let expected = format!("t.pls: byte 844: {missing}; the file is cut off: copy it again from its source");
    assert_eq!(message(dir.path(), &reader.check_complete().unwrap_err()), expected);
    assert_eq!(message(dir.path(), &reader.pulse(2).unwrap_err()), expected);
    assert!(reader.pulse(u64::MAX).is_err());
    assert!(reader.pulse(1).is_ok());
    let (mut reader, dir) = pair.open();
    assert!(reader.check_complete().is_ok());
    let error = message(dir.path(), &reader.pulse(2).unwrap_err());
    assert_eq!(error, "t.pls: byte 844: pulse 2: the file has 2 pulses; request one of them");
}

/// Counts readable pulses, and pulses with readable waves.
///
/// All others must give an error.
fn read_all(path: &Path) -> (u64, u64) {
    let Ok(mut reader) = Reader::open(path) else { return (0, 0) };
    let (mut waves, mut with_waves) = (Waves::new(), 0);
    for index in 0..reader.pulse_count() {
        let pulse = reader.pulse(index).unwrap();
        with_waves += u64::from(reader.waves(&pulse, &mut waves).is_ok());
    }
    let complete = reader.pulse_count() == reader.header().pulse_count;
    assert_eq!(reader.check_complete().is_ok(), complete);
    assert!(reader.pulse(reader.pulse_count()).is_err());
    (reader.pulse_count(), with_waves)
}

/// Returns cut positions for a file of `n` bytes.
///
/// 40 in its first kilobytes and 40 over the whole, in order.
fn cuts(n: usize) -> Vec<usize> {
    let places = (0..40).flat_map(|i| [i * n.min(4000) / 40 + i % 7, i * n / 40 + i % 5]);
    let mut places: Vec<usize> = places.filter(|&cut| cut < n).collect();
    places.sort_unstable();
    places
}

#[test]
fn a_recording_cut_anywhere_never_panics_and_loses_only_what_is_gone() {
    let Some(data) = data() else { return };
    let recordings =
        ["geolas_example1", "las13fwf_example1", "lvis_example1", "optech_example1", "riegl_example3"];
    let recordings = recordings.map(|name| data.join("pulsewaves").join(name));
    let more = [data.join("pulsewaves/test"), data.join("riegl_q680i_dev/riegl_q680i_dev")];
    for name in recordings.iter().chain(&more) {
        let read = |ending: &str| std::fs::read(name.with_extension(ending)).unwrap();
        let (pls, wvs) = (read("pls"), read("wvs"));
        let dir = tempfile::tempdir().unwrap();
        let path = write(dir.path(), &pls, &wvs);
        let all = read_all(&path).0;
        assert_eq!(read_all(&path), (all, all));
        let start = Reader::open(&path).unwrap().header().offset_to_pulses as usize;
        for cut in cuts(pls.len()) {
            write(dir.path(), &pls[..cut], &wvs);
            let held = (cut.saturating_sub(start) / 48) as u64;
            assert_eq!(read_all(&path), (held.min(all), held.min(all)), "{} cut at {cut}", name.display());
        }
        let mut before = 0;
        for cut in cuts(wvs.len()) {
            write(dir.path(), &pls, &wvs[..cut]);
            let (pulses, with_waves) = read_all(&path);
            assert_eq!(pulses, if cut < 60 { 0 } else { all });
            assert!(with_waves >= before && with_waves < all, "{} cut at {cut}", name.display());
            before = with_waves;
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn damaged_bytes_never_panic(damage in prop::collection::vec((0..2000_usize, any::<u8>()), 1..12)) {
        let mut pair = Pair::plain(3);
        let mut stored = sampling(SegmentKind::Returning, 0, 0);
        (stored.duration_bits, stored.segment_count_bits, stored.sample_count_bits) = (16, 16, 8);
        pair.records.push(("PulseWaves_Spec", 200_002, encode(&descriptor(vec![stored]), 0)));
        pair.appended = vec![("PulseWaves_Spec", u32::MAX, vec![]), ("PulseWaves_Proj", 2112, b"WKT".to_vec())];
        pair.add(2, &[1, 0, 5, 0, 2, 9, 9]);
        let (mut pls, mut wvs) = (pair.pls(), pair.waves);
        for (at, value) in damage {
            let whole = if at % 8 == 0 { &mut wvs } else { &mut pls };
            let at = at % whole.len();
            whole[at] = value;
        }
        let dir = tempfile::tempdir().unwrap();
        let (pulses, with_waves) = read_all(&write(dir.path(), &pls, &wvs));
        // Damage to both the count and the marker after the pulses may turn pulses into records.
        prop_assert!(352 + 48 * pulses <= pls.len() as u64 && with_waves <= pulses);
    }
}
