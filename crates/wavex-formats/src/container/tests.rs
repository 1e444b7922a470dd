//! Whole containers: round trips, truncated and damaged input, no panics.

use std::io::Cursor;
use std::path::Path;

use proptest::prelude::*;

use super::*;
use crate::Result;

mod corrupt;
mod digests;
mod foreign;
mod fractions;

/// Channel, start, interval, zone and samples of a block.
type OwnBlock = (u8, f64, Option<f64>, Option<i16>, Vec<u16>);

/// Row with owned lists.
#[derive(Clone, Debug, PartialEq)]
struct Row {
    shot: ContainerShot,
    blocks: Vec<OwnBlock>,
    online: Vec<ContainerOnline>,
}

fn header() -> ContainerHeader {
    ContainerHeader { instrument: Some("made up".into()), ..ContainerHeader::new(1.0, 299_707_502.0) }
}

fn row(shot: u64, line: u32) -> Row {
    let samples = |n: u64| (0..n).map(|i| (2 + (shot * 7 + i * i) % 40) as u16).collect();
    Row {
        shot: ContainerShot {
            shot,
            line,
            gps_time_s: (!shot.is_multiple_of(3)).then_some(1000.0 + shot as f64 * 2.5e-6),
            clock_ps: shot as i64 * 2_500_000,
            origin_m: [0.0, 0.25, shot as f64],
            direction: [0.6, 0.0, -0.8],
            facet: (shot % 4) as u16,
            flags: 1,
            mta_zone: (shot % 2 == 1).then_some(3),
            scan_angle_deg: shot.is_multiple_of(2).then_some(-12.5),
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

/// Creates three lines of five, zero and four rows.
fn lines() -> Vec<Vec<Row>> {
    vec![(0..5).map(|shot| row(shot, 0)).collect(), vec![], (5..9).map(|shot| row(shot, 7)).collect()]
}

fn builder(rows: &[Row]) -> LineBuilder {
    let mut line = LineBuilder::new();
    for row in rows {
        line.shot(&row.shot);
        for (channel, start_ns, interval_ns, zone, samples) in &row.blocks {
            let (channel, start_ns, interval_ns, zone) = (*channel, *start_ns, *interval_ns, *zone);
            line.block(&ContainerBlock { channel, start_ns, interval_ns, zone, gain: None, samples });
        }
        row.online.iter().for_each(|online| line.online(online));
    }
    line
}

fn write(lines: &[Vec<Row>], file: bool, compression: Compression) -> Vec<u8> {
    write_as(lines, compression, (file, true))
}

/// As [`write`], without digests, which would refuse every changed byte.
fn without_digests(lines: &[Vec<Row>], file: bool, compression: Compression) -> Vec<u8> {
    write_as(lines, compression, (file, false))
}

fn write_as(lines: &[Vec<Row>], compression: Compression, form: (bool, bool)) -> Vec<u8> {
    let name = Path::new("made.arrow");
    let mut writer = ContainerWriter::begin(Vec::new(), name, &header(), compression, form).unwrap();
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

/// Reads sequentially, as from standard input.
fn read_stream(bytes: Vec<u8>) -> Result<Vec<Vec<Row>>> {
    read_rest(ContainerReader::from_stream(Path::new("-"), Box::new(Cursor::new(bytes)))?)
}

/// Reads with random access, as from a file.
fn read_file(bytes: &[u8]) -> Result<Vec<Vec<Row>>> {
    read_rest(ContainerReader::from_bytes(Path::new("a.arrow"), bytes.to_vec())?)
}

/// Returns the error of a stream, without the name of the file.
fn refusal(bytes: Vec<u8>) -> String {
    let error = read_stream(bytes).unwrap_err().to_string();
    error.split_once(": ").unwrap().1.to_string()
}

const ALL: [Compression; 3] = [Compression::None, Compression::Lz4, Compression::Zstd];

#[test]
fn files_and_streams_round_trip() {
    for compression in ALL {
        for file in [true, false] {
            let bytes = write(&lines(), file, compression);
            assert_eq!(read_file(&bytes).unwrap(), lines(), "{compression:?} {file}");
            assert_eq!(read_stream(bytes).unwrap(), lines(), "{compression:?} {file}");
        }
    }
}

#[test]
fn without_samples_the_rest_of_a_line_is_the_same() {
    let without_values = |mut lines: Vec<Vec<Row>>| {
        let blocks = lines.iter_mut().flatten().flat_map(|row| &mut row.blocks);
        blocks.for_each(|(.., samples)| samples.fill(0));
        lines
    };
    for compression in ALL {
        let bytes = write(&lines(), true, compression);
        let mut reader = ContainerReader::from_bytes(Path::new("a.arrow"), bytes).unwrap();
        reader.skip_samples();
        let read = read_rest(reader).unwrap();
        assert_eq!(read == lines(), compression == Compression::None, "only compressed samples are skipped");
        assert_eq!(without_values(read), without_values(lines()), "{compression:?}");
    }
}

/// The memory of a line is reused only after the line is dropped.
#[test]
fn lines_that_are_held_keep_their_values() {
    for compression in ALL {
        let bytes = write(&lines(), true, compression);
        let mut reader = ContainerReader::from_bytes(Path::new("a.arrow"), bytes).unwrap();
        let held: Vec<ContainerLine> = std::iter::from_fn(|| reader.next_line().unwrap()).collect();
        assert_eq!(held.iter().map(rows_of).collect::<Vec<_>>(), lines(), "{compression:?}");
    }
}

#[test]
fn the_same_lines_give_the_same_bytes() {
    for compression in ALL {
        assert_eq!(write(&lines(), true, compression), write(&lines(), true, compression));
    }
}

#[test]
fn progress_and_form_are_reported() {
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
fn a_stream_without_end_mark_is_read() {
    let mut bytes = write(&lines(), false, Compression::None);
    bytes.truncate(bytes.len() - 8);
    let mut reader = ContainerReader::from_stream(Path::new("-"), Box::new(Cursor::new(bytes))).unwrap();
    while reader.next_line().unwrap().is_some() {}
    assert!(reader.ended_without_mark());
    assert_eq!(reader.progress(), None, "the length of a pipe is unknown");
}

#[test]
fn every_truncation_of_a_file_is_refused() {
    let whole = write(&lines(), true, Compression::None);
    let length = *whole.last_chunk::<10>().unwrap().first_chunk::<4>().unwrap();
    // A pipe does not need the footer, which follows the end mark.
    let footer = whole.len() - 10 - i32::from_le_bytes(length) as usize;
    for len in 0..whole.len() {
        let cut = &whole[..len];
        read_file(cut).unwrap_err();
        assert_eq!(read_stream(cut.to_vec()).is_ok(), len >= footer, "{len} of {}", whole.len());
    }
}

#[test]
fn a_truncated_stream_keeps_complete_lines() {
    let whole = write(&lines(), false, Compression::Lz4);
    let mut ends = Vec::new();
    for len in 0..whole.len() {
        if let Ok(found) = read_stream(whole[..len].to_vec()) {
            assert_eq!(found, lines()[..found.len()]);
            ends.push(found.len());
        }
    }
    assert_eq!(ends, [0, 1, 2, 3], "after the schema, and after each line");
}

#[test]
fn flipped_bits_never_panic() {
    // Compressed containers are sampled more sparsely: unpacking is slow in tests.
    for (compression, file, step) in [
        (Compression::None, true, 1),
        (Compression::None, false, 1),
        (Compression::Zstd, false, 2),
        (Compression::Lz4, false, 5),
    ] {
        let whole = without_digests(&lines()[..1], file, compression);
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
    #![proptest_config(ProptestConfig::with_cases(100))]

    #[test]
    fn arbitrary_samples_round_trip(
        shots in prop::collection::vec((0usize..700, 1usize..40, 0u16..5), 1..8),
        seed in any::<u16>(),
    ) {
        let mut state = u32::from(seed);
        let mut noise = |most: u16| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 16) as u16 % (most + 1)
        };
        let mut rows = Vec::new();
        for (shot, (len, period, most)) in (0..).zip(shots) {
            let samples = (0..len).map(|i| (i % period) as u16 * 9 + noise(most)).collect();
            rows.push(Row { blocks: vec![(0, 1.5, None, None, samples)], ..row(shot, 0) });
        }
        let lines = [rows];
        for compression in ALL {
            prop_assert_eq!(&read_file(&write(&lines, true, compression)).unwrap(), &lines, "{:?}", compression);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Replaces words anywhere: lengths, offsets, counts.
    #[test]
    fn changed_words_never_panic(
        places in prop::collection::vec((any::<prop::sample::Index>(), word()), 1..4),
        compression in prop::sample::select(&ALL[..]),
        file in any::<bool>(),
    ) {
        let mut bytes = without_digests(&lines()[..1], file, compression);
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
    fn noise_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..200), magic in any::<bool>()) {
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
fn other_formats_are_refused() {
    assert_eq!(refusal(Vec::new()), "the file is empty; copy it again from its source");
    let neither = "neither an Arrow IPC file nor a stream; give a waveform container, or use the reader of the file's own \
                   format";
    let las = "this is LAS, not Arrow; rename it to .las, and read it with the stage `read_las`";
    for (bytes, of_file) in [(&b"LASF\0\0\0\0\0\0\0\0\0\0\0\0\0\0"[..], las), (b"PAR1\x15\x04", neither)] {
        assert_eq!(refusal(bytes.to_vec()), neither, "as a stream");
        let error = read_file(bytes).unwrap_err().to_string();
        assert!(error.ends_with(of_file), "{error}");
    }
}

#[test]
fn the_error_of_a_missing_file_names_it() {
    let Err(error) = ContainerReader::open(Path::new("no/such.arrow")) else { panic!("it opened") };
    assert!(error.to_string().starts_with("no/such.arrow: cannot open: "), "{error}");
}

#[test]
fn the_schema_file_matches_the_layout() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../schemas/container.json");
    let expected = serde_json::to_string_pretty(&layout::description()).unwrap() + "\n";
    if std::fs::read_to_string(&path).ok().as_deref() != Some(&expected) {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, expected).unwrap();
        panic!("schemas/container.json was outdated and has been rewritten: commit it");
    }
}
