//! Compressed waveform packets (`.wdz`) and compressed PulseWaves (`.plz`, `.wvz`).

use std::fs;

use proptest::prelude::*;
use wavex_formats::las;
use wavex_formats::pulsewaves::{Reader, WaveSegments};
use wavex_testkit::compression::{Segment, chunks, packet, waves};
use wavex_testkit::las::{Las, descriptor, vlr};
use wavex_testkit::pulsewaves::{PULSE, PulseWaves};
use wavex_testkit::{Outcome, TO_TABLE, TestFolder};

/// Samples of 8 or 16 bits: noise, steps and extremes.
fn samples(bits: u8, most: usize) -> impl Strategy<Value = Vec<u16>> {
    let mask = u16::MAX >> (16 - bits);
    let one = prop_oneof![
        9 => (0..3u16).prop_map(|noise| 12 + noise),
        3 => 0..200u16,
        1 => any::<u16>(),
        1 => prop::sample::select(vec![0, u16::MAX, 1 << (bits - 1)]),
    ];
    prop::collection::vec(one.prop_map(move |sample| sample & mask), 1..most)
}

/// Bits and the waveforms of a file, all of the same length.
fn waveforms() -> impl Strategy<Value = (u8, Vec<Vec<u16>>)> {
    let of_bits = |bits: u8| {
        (samples(bits, 400), 1..6usize).prop_map(move |(samples, count)| {
            let all = (0..count).map(|k| samples.iter().map(|&sample| sample ^ (k as u16 & 1)).collect());
            (bits, all.collect())
        })
    };
    prop::sample::select(vec![8u8, 16]).prop_flat_map(of_bits)
}

fn las_of(bits: u8, waveforms: &[Vec<u16>]) -> Las {
    let mut las = Las::new(waveforms.len());
    las.vlrs[0] = vlr("LASF_Spec", 100, &descriptor(bits, waveforms[0].len() as u32, 1000));
    las.vlrs[0][54 + 1] = 1;
    las.packets.truncate(60);
    las.packets[20..28].fill(0);
    for (point, samples) in las.points.iter_mut().zip(waveforms) {
        let packet = packet(bits, samples);
        point[31..39].copy_from_slice(&(las.packets.len() as u64).to_le_bytes());
        point[39..43].copy_from_slice(&(packet.len() as u32).to_le_bytes());
        las.packets.extend(packet);
    }
    las
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn waveform_packets_survive((bits, waveforms) in waveforms()) {
        let las = las_of(bits, &waveforms);
        let place = TestFolder::with(&[("a.las", &las.las()), ("a.wdz", &las.packets)]);
        let mut reader = las::Reader::open(&place.path("a.las")).unwrap();
        let (mut point, mut samples) = (las::Point::default(), Vec::new());
        for expected in &waveforms {
            prop_assert!(reader.next_point(&mut point).unwrap());
            reader.packet(&point.wave, &mut samples).unwrap();
            prop_assert_eq!(&samples, expected);
        }
    }

    #[test]
    fn pulses_survive((records, source_id_bytes) in pulses(), chunk in 1..40usize, varying: bool) {
        let (plain, compressed) = pulse_files(&records, source_id_bytes, chunk, varying);
        let waves = PulseWaves::new(1).waves;
        let place = TestFolder::with(&[("a.pls", &plain), ("b.plz", &compressed), ("a.wvs", &waves), ("b.wvs", &waves)]);
        let mut plain = Reader::open(&place.path("a.pls")).unwrap();
        let mut compressed = Reader::open(&place.path("b.plz")).unwrap();
        prop_assert_eq!(compressed.pulse_count(), records.len() as u64);
        prop_assert!(compressed.check_complete().is_ok());
        for index in (0..plain.pulse_count()).chain((0..plain.pulse_count()).rev()) {
            prop_assert_eq!(compressed.pulse(index).unwrap(), plain.pulse(index).unwrap());
        }
    }

    #[test]
    fn waves_survive(
        (bits, waveforms) in waveforms(),
        durations in prop::collection::vec(any::<i32>(), 6),
    ) {
        // An outgoing segment of fixed length, and a stored number of returning ones.
        let outgoing = Segment {
            is_returning: false,
            bits: 8,
            segments: None,
            duration: None,
            has_count: false,
            samples: vec![2, 9, 255, 9, 2],
        };
        let mut segments = vec![outgoing];
        for (k, samples) in waveforms.iter().enumerate() {
            segments.push(Segment {
                is_returning: true,
                bits,
                segments: (k == 0).then_some(waveforms.len() as u16),
                duration: Some(durations[k]),
                has_count: true,
                samples: samples[..samples.len() - k.min(samples.len())].to_vec(),
            });
        }
        let mut made = PulseWaves::new(1);
        // Fields of the samplings: `wavex_testkit::pulsewaves::descriptor`.
        let payload = &mut made.records[0].1;
        let (first, second) = (92, 92 + 104);
        payload[first + 11] = 0;
        payload[first + 24..first + 28].copy_from_slice(&5u32.to_le_bytes());
        payload[second + 20..second + 22].copy_from_slice(&[16, 16]);
        payload[second + 28] = bits;
        made.waves.truncate(60);
        made.waves[16] = 1;
        made.waves.extend(waves(&segments));
        let place = TestFolder::with(&[("a.pls", &made.pls()), ("a.wvz", &made.waves)]);
        let mut reader = Reader::open(&place.path("a.pls")).unwrap();
        let (pulse, mut found) = (reader.pulse(0).unwrap(), WaveSegments::new());
        reader.waves(&pulse, &mut found).unwrap();
        prop_assert_eq!(found.segments().len(), segments.len());
        for (found_segment, segment) in found.segments().iter().zip(&segments) {
            prop_assert_eq!(found.samples(found_segment), &segment.samples[..]);
            prop_assert_eq!(found_segment.quantized_duration, segment.duration.unwrap_or(0));
        }
    }
}

/// Pulse records, and the size of their source ID; each field changes now and then.
fn pulses() -> impl Strategy<Value = (Vec<Vec<u8>>, usize)> {
    let step = (any::<[u8; 8]>(), any::<[u32; 4]>());
    let steps = prop::collection::vec(step, 1..120);
    (prop::sample::select(vec![0usize, 2, 4]), 0..4usize, steps).prop_map(
        |(source_id_bytes, extra, steps)| {
            let mut record = vec![0u8; PULSE + source_id_bytes + extra];
            let records = steps.iter().map(|(choice, noise)| {
                change(&mut record, choice, noise, source_id_bytes);
                record.clone()
            });
            (records.collect(), source_id_bytes)
        },
    )
}

fn change(record: &mut [u8], choice: &[u8; 8], noise: &[u32; 4], source_id_bytes: usize) {
    let i64_at = |record: &[u8], at: usize| i64::from_le_bytes(record[at..at + 8].try_into().unwrap());
    let small = i64::from(noise[0] % 300);
    let time = match choice[0] % 10 {
        0 => 0,
        1..=4 => 30,
        5 => 30 * small + small % 7,
        6 => -small,
        7 => 1 << (noise[1] % 62),
        8 => 9000 + small,
        _ => 31,
    };
    let offset = match choice[1] % 10 {
        0..=5 => 40 + small % 9,
        6 => -small,
        7 => i64::from(noise[1]) << 8,
        8 => i32::MAX.into(),
        _ => i32::MIN.into(),
    };
    for (at, step) in [(0, time), (8, offset)] {
        let value = i64_at(record, at).wrapping_add(step);
        record[at..at + 8].copy_from_slice(&value.to_le_bytes());
    }
    for k in 0..6 {
        let at = 16 + 4 * k;
        let step = match choice[2] % 8 {
            0 => noise[k % 4],
            1 => i32::MAX as u32,
            _ => 10 + noise[1] % 3,
        };
        let value = u32::from_le_bytes(record[at..at + 4].try_into().unwrap()).wrapping_add(step);
        record[at..at + 4].copy_from_slice(&value.to_le_bytes());
    }
    if choice[3].is_multiple_of(4) {
        record[40..44].copy_from_slice(&noise[2].to_le_bytes());
    } else if choice[3] % 4 == 1 {
        record[40] = record[40].wrapping_add(1);
        record[42] = record[42].wrapping_add(1);
    }
    for k in 0..4 {
        if choice[4] >> k & 3 == 3 {
            record[44 + k] =
                if choice[5].is_multiple_of(2) { noise[3].to_le_bytes()[k] } else { choice[5] % 3 };
        }
    }
    let rest = &mut record[PULSE..];
    if choice[6].is_multiple_of(3) {
        let ids = noise[3].to_le_bytes();
        let id = if choice[6].is_multiple_of(2) { ids } else { [ids[0] % 40, 0, 0, 0] };
        rest[..source_id_bytes].copy_from_slice(&id[..source_id_bytes]);
    }
    rest[source_id_bytes..].iter_mut().for_each(|byte| *byte = byte.wrapping_add(choice[7] % 5));
}

/// The same pulses in a `.pls` and a `.plz` file.
fn pulse_files(
    records: &[Vec<u8>],
    source_id_bytes: usize,
    chunk: usize,
    varying: bool,
) -> (Vec<u8>, Vec<u8>) {
    let size = records[0].len();
    let patched = |mut bytes: Vec<u8>| {
        bytes[184..192].copy_from_slice(&(records.len() as i64).to_le_bytes());
        bytes[196] = source_id_bytes as u8 / 2;
        bytes[200] = size as u8;
        bytes
    };
    let mut items = vec![(1001, PULSE)];
    items.extend((source_id_bytes > 0).then_some((1001 + source_id_bytes / 2, source_id_bytes)));
    let extra = size - PULSE - source_id_bytes;
    items.extend((extra > 0).then_some((1000, extra)));
    let mut zip = vec![1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    zip.extend(if varying { u32::MAX } else { chunk as u32 }.to_le_bytes());
    zip.extend((items.len() as u16).to_le_bytes());
    for (kind, size) in items {
        [kind, size, 1].iter().for_each(|field| zip.extend((*field as u16).to_le_bytes()));
    }
    let mut made = PulseWaves { pulses: records.to_vec(), ..PulseWaves::new(0) };
    let plain = patched(made.pls());
    made.records.push((5, zip));
    made.pulses.clear();
    let mut compressed = patched(made.pls());
    compressed.extend(chunks(compressed.len(), records, chunk, source_id_bytes, varying));
    (plain, compressed)
}

/// The table of returns that a job makes of `a.EXTENSION`.
#[track_caller]
fn table(reader: &str, files: &[(&str, &[u8])]) -> String {
    let place = TestFolder::with(files);
    let Outcome { code, err, .. } = place.read(reader, files[0].0, TO_TABLE);
    assert_eq!(code, Some(0), "{err}");
    let names = fs::read_dir(place.path("out")).unwrap().map(|entry| entry.unwrap().path());
    let csv =
        names.filter(|path| path.extension().is_some_and(|extension| extension == "csv")).min().unwrap();
    fs::read_to_string(csv).unwrap()
}

#[test]
fn compressed_recordings_give_the_same_returns() {
    let las = Las::new(300);
    let plain = table("read_las", &[("a.las", &las.las()), ("a.wdp", &las.packets)]);
    let compressed = las.with_compressed_packets();
    assert_eq!(table("read_las", &[("a.laz", &compressed.laz()), ("a.wdz", &compressed.packets)]), plain);
    let pulses = PulseWaves::new(300);
    let plain = table("read_pulsewaves", &[("a.pls", &pulses.pls()), ("a.wvs", &pulses.waves)]);
    let half = table("read_pulsewaves", &[("a.plz", &pulses.plz(70)), ("a.wvs", &pulses.waves)]);
    let compressed = pulses.with_compressed_waves();
    let whole = table("read_pulsewaves", &[("a.plz", &compressed.plz(70)), ("a.wvz", &compressed.waves)]);
    assert_eq!((half, whole), (plain.clone(), plain));
}

#[test]
fn damaged_compressed_waveforms_are_counted() {
    let las = Las::new(300).with_compressed_packets();
    let mut packets = las.packets.clone();
    // In the middle of the packet of the second point.
    let at = u64::from_le_bytes(las.points[1][31..39].try_into().unwrap()) as usize;
    packets[at + 8] ^= 0x55;
    let place = TestFolder::with(&[("a.las", &las.las()), ("a.wdz", &packets)]);
    let outcome = place.read("read_las", "a.las", TO_TABLE);
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
    let said = report(&place);
    assert!(said.contains("a point's waveform that cannot be read was rejected"), "{said}");
    assert!(said.contains(&format!("a.wdz: byte {at}: waveform packet: ")), "{said}");
    let pulses = PulseWaves::new(300).with_compressed_waves();
    let mut waves = pulses.waves.clone();
    let at = u64::from_le_bytes(pulses.pulses[1][8..16].try_into().unwrap()) as usize;
    waves[at + 8] ^= 0x55;
    let place = TestFolder::with(&[("a.plz", &pulses.plz(100)), ("a.wvz", &waves)]);
    let outcome = place.read("read_pulsewaves", "a.plz", TO_TABLE);
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
    let said = report(&place);
    assert!(said.contains("a pulse whose waves cannot be read was rejected"), "{said}");
    assert!(said.contains("a.wvz: byte "), "{said}");
}

/// The report of a run.
fn report(place: &TestFolder) -> String {
    let names = fs::read_dir(place.path("out")).unwrap().map(|entry| entry.unwrap().path());
    let report = names.filter(|path| path.to_string_lossy().ends_with("report.json")).min().unwrap();
    fs::read_to_string(report).unwrap()
}

/// Opens compressed pulses after a change of their bytes; returns the message.
fn opened(change: impl Fn(&mut Vec<u8>, usize)) -> String {
    let made = PulseWaves::new(10);
    let mut bytes = made.plz(4);
    let start =
        PulseWaves { records: [&made.records[..], &[(5, vec![0; 24])]].concat(), ..made }.offset_of(0);
    change(&mut bytes, start);
    let place = TestFolder::with(&[("a.plz", &bytes), ("a.wvs", &PulseWaves::new(10).waves)]);
    let read = Reader::open(&place.path("a.plz")).and_then(|mut reader| {
        reader.check_complete()?;
        (0..reader.pulse_count()).try_for_each(|index| reader.pulse(index).map(|_| ()))
    });
    let folder = format!("{}/", place.path("").display().to_string().trim_end_matches('/'));
    read.unwrap_err().to_string().replace(&folder, "")
}

const CUT: &str = "the file is cut off or damaged: copy it again from its source";

#[test]
fn damaged_compressed_pulses_are_errors() {
    let table_at =
        |bytes: &[u8], start: usize| i64::from_le_bytes(bytes[start..start + 8].try_into().unwrap()) as usize;
    let cut = opened(|bytes, start| bytes.truncate(table_at(bytes, start)));
    assert!(cut.contains("offset to the chunk table: ") && cut.ends_with(CUT), "{cut}");
    let interrupted = opened(|bytes, start| {
        let itself = (start as i64).to_le_bytes();
        bytes[start..start + 8].copy_from_slice(&itself);
    });
    assert!(interrupted.contains("is not between the pulses and the end of the file"), "{interrupted}");
    let version = opened(|bytes, start| {
        let at = table_at(bytes, start);
        bytes[at] = 1;
    });
    assert!(version.contains("chunk table: version 1, 3 chunks in "), "{version}");
    let chunks = opened(|bytes, start| {
        let at = table_at(bytes, start);
        bytes[at + 4..at + 8].fill(9);
    });
    assert!(chunks.contains("chunk table: version 0, 151587081 chunks in "), "{chunks}");
    let sizes = opened(|bytes, start| {
        let at = table_at(bytes, start);
        bytes[at + 9] ^= 0x35;
    });
    assert!(sizes.contains("chunk table: "), "{sizes}");
    let short = opened(|bytes, start| bytes.truncate(table_at(bytes, start) + 9));
    assert!(short.contains("chunk table: it cannot be decoded: the encoded data end too early"), "{short}");
    let pulses = opened(|bytes, start| bytes[start + 8 + PULSE + 5] ^= 0x35);
    let of_chunk = format!("a.plz: byte {}: compressed pulses: ", pulses_start());
    assert!(pulses.starts_with(&of_chunk) && pulses.ends_with(CUT), "{pulses}");
    let fewer = opened(|bytes, _| bytes[184] = 7);
    assert!(fewer.contains("compressed pulses: "), "{fewer}");
    let more = opened(|bytes, _| bytes[184] = 13);
    assert!(more.contains("the header declares 13 pulses, but the file has 12"), "{more}");
}

fn pulses_start() -> usize {
    let made = PulseWaves::new(0);
    PulseWaves { records: [&made.records[..], &[(5, vec![0; 24])]].concat(), ..made }.offset_of(0) + 8
}

#[test]
fn unknown_compressions_of_pulses_are_refused() {
    // The record is the last before the pulses: compressor, coder, version, options, pulses per chunk, items.
    let with = |at: usize, byte: u8| opened(|bytes, start| bytes[start - 24 + at] = byte);
    let end = "write the file again with PulseTools, or uncompressed";
    let record = pulses_start() - 8 - 24;
    for (at, byte, place, problem) in [
        (0, 2, record, "PulseZIP record: compressor 2 and coder 0 are not supported, only 1 and 0"),
        (12, 0, record, "PulseZIP: pulses per chunk: it is 0"),
        (18, 0, record + 18, "PulseZIP: item: type 768 of 48 bytes, version 1, is not supported"),
        (20, 49, record + 18, "PulseZIP: item: type 1001 of 49 bytes, version 1, is not supported"),
        (22, 2, record + 18, "PulseZIP: item: type 1001 of 48 bytes, version 2, is not supported"),
        (16, 0, record, "PulseZIP record: its items do not match pulses of 48 bytes"),
    ] {
        assert_eq!(with(at, byte), format!("a.plz: byte {place}: {problem}; {end}"));
    }
}
