//! Conversion of rows to lines, and rejection of rows.

use std::path::Path;

use super::*;
use wavex_formats::container::{Compression, ContainerHeader, ContainerWriter, LineBuilder, channel};
use wavex_line::stage::{Config as _, Item};

fn header() -> ContainerHeader {
    ContainerHeader { time_scale: container::TimeScale::Week, ..ContainerHeader::new(1.0, 299_707_502.0) }
}

fn good(shot: u64, line: u32) -> ContainerShot {
    ContainerShot {
        shot,
        line,
        gps_time_s: Some(shot as f64),
        clock_ps: shot as i64 * 1000,
        origin_m: [0.0; 3],
        direction: [0.0, 0.6, 0.8],
        facet: 0,
        flags: 1,
        mta_zone: None,
        scan_angle_deg: None,
        frame_scale: None,
    }
}

fn echo<'a>() -> ContainerBlock<'a> {
    ContainerBlock {
        channel: channel::LOW_POWER,
        start_ns: 100.0,
        interval_ns: None,
        zone: None,
        gain: None,
        samples: &[2, 9, 2],
    }
}

/// Rows of beams with fractions of a step.
fn of_fractions(rows: &[(&str, &[f32])]) -> (Vec<ScanLine>, Context) {
    let mut line = LineBuilder::new();
    for (shot, (beam, samples)) in (0..).zip(rows) {
        line.shot(&good(shot, 0));
        line.block_of_fractions(&ContainerBlock { zone: Some(1), samples: &[], ..echo() }, samples);
        let shot_number = (shot > 0).then_some(900 + shot);
        let beam = Some(*beam).filter(|beam| !beam.is_empty());
        line.footprint(&ContainerFootprint {
            beam,
            shot_number,
            noise_mean_dn: Some(200.0),
            noise_sd_dn: Some(if shot == 0 { f64::NAN } else { 2.0 }),
            is_advised_against: shot == 1,
        });
    }
    read(&bytes(&ContainerHeader { has_fractions: true, ..header() }, vec![line]))
}

#[test]
fn fractions_and_beams_are_read() {
    let (lines, cx) = of_fractions(&[("", &[0.5]), ("A", &[1.5, 2.25]), ("A", &[3.0]), ("B", &[4.0])]);
    assert!(cx.counters().rejected.is_empty(), "{:?}", cx.counters());
    let beams: Vec<(Option<&str>, usize, Kind)> =
        lines.iter().map(|line| (line.input.beam.as_deref(), line.emissions.len(), line.kind())).collect();
    let kind = Kind::Footprints;
    assert_eq!(beams, [(None, 1, kind), (Some("A"), 2, kind), (Some("B"), 1, kind)]);
    assert_eq!(lines[0].input.format, "wavex container 2 (Arrow IPC stream)");
    let blocks = lines[1].blocks().unwrap();
    let samples: Vec<&[f32]> = blocks.iter().map(|block| blocks.fractions(block)).collect();
    assert_eq!(samples, [&[1.5, 2.25][..], &[3.0]]);
    assert_eq!(blocks.iter().next().unwrap().zone, Some(1));
    let [first, second] = [0, 1].map(|shot| blocks.footprint_of(shot).unwrap());
    let noise = Some(RecordedNoise { mean_dn: 200.0, sd_dn: 2.0 });
    assert_eq!((first.shot_number, first.is_degraded, first.noise), (901, true, noise));
    assert_eq!((second.shot_number, second.is_degraded), (902, false));
    let other = lines[0].blocks().unwrap().footprint_of(0).unwrap();
    assert_eq!((other.shot_number, other.noise), (0, None), "its running number, and impossible noise");
}

#[test]
fn samples_that_are_not_finite_reject_their_shot() {
    for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let (lines, cx) = of_fractions(&[("A", &[1.0]), ("A", &[1.0, wrong]), ("A", &[1.0])]);
        assert_eq!(lines.iter().map(|line| line.emissions.len()).sum::<usize>(), 2);
        assert_eq!(cx.counters().rejected_of(Reason::SampleNotFinite.item()), 1);
    }
}

#[test]
fn stages_for_whole_steps_refuse_fractions() {
    let (lines, _) = of_fractions(&[("A", &[1.5])]);
    let error = stage::check_whole_steps(&lines[0], "decompose").unwrap_err().to_string();
    assert!(
        error.starts_with("`decompose` needs samples in whole digitiser steps, but the recording"),
        "{error}"
    );
}

/// Rows with one echo block each.
fn plain(shots: impl IntoIterator<Item = ContainerShot>) -> LineBuilder {
    let mut line = LineBuilder::new();
    for shot in shots {
        line.shot(&shot);
        line.block(&echo());
    }
    line
}

fn bytes(header: &ContainerHeader, lines: Vec<LineBuilder>) -> Vec<u8> {
    let name = Path::new("made.arrow");
    let mut writer = ContainerWriter::stream(Vec::new(), name, header, Compression::None).unwrap();
    lines.into_iter().for_each(|line| writer.write(line).unwrap());
    writer.finish().unwrap()
}

/// Reads these bytes as a job does; returns the lines and the counters.
fn read(bytes: &[u8]) -> (Vec<ScanLine>, Context) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("made.arrow");
    std::fs::write(&path, bytes).unwrap();
    let mut source = ArrowLineReader::open(&RunContext::alone(&path), Sampling::default()).unwrap();
    let mut cx = Context::default();
    let batches = std::iter::from_fn(|| source.next(&mut cx).unwrap()).collect();
    assert_eq!(source.progress(), Some(1.0));
    (batches, cx)
}

/// (line, first shot, number of shots) of each line.
fn lines(batches: &[ScanLine]) -> Vec<(u32, u64, usize)> {
    batches
        .iter()
        .map(|scan_line| (scan_line.line, scan_line.emissions[0].shot, scan_line.emissions.len()))
        .collect()
}

#[test]
fn a_line_ends_with_its_record_batch_its_number_or_its_4096th_shot() {
    let long = MAX_SHOTS_PER_LINE as u64 * 2 + 10;
    let bytes = bytes(
        &header(),
        vec![
            plain((0..3).map(|shot| good(shot, 0))),
            plain((3..5).map(|shot| good(shot, 0))),
            plain([]),
            plain([good(5, 1), good(6, 1), good(7, 4), good(8, 1)]),
            plain((9..9 + long).map(|shot| good(shot, 5))),
        ],
    );
    let (batches, cx) = read(&bytes);
    let expected = [
        (0, 0, 3),
        (0, 3, 2),
        (1, 5, 2),
        (4, 7, 1),
        (1, 8, 1),
        (5, 9, 4096),
        (5, 9 + 4096, 4096),
        (5, 9 + 8192, 10),
    ];
    assert_eq!(lines(&batches), expected);
    assert!(cx.counters().rejected.is_empty());
    for scan_line in &batches {
        assert_eq!(scan_line.stats.nw, scan_line.emissions.len() as u64);
        assert_eq!(scan_line.stats.gps_time_s, scan_line.emissions[0].gps_time_s);
        let blocks = scan_line.blocks().unwrap();
        assert!(blocks.iter().map(|block| block.emission).eq(0..scan_line.emissions.len() as u32));
    }
}

/// A line of three shots: a good one, the one that `add` adds, and a good one.
fn around(add: impl FnOnce(&mut LineBuilder)) -> LineBuilder {
    let mut line = plain([good(0, 0)]);
    add(&mut line);
    line.shot(&good(2, 0));
    line.block(&echo());
    line
}

#[test]
fn each_reason_rejects_a_shot_with_its_blocks_and_the_line_goes_on() {
    type Change = fn(&mut ContainerShot);
    let shots: [(Reason, Change); 12] = [
        (Reason::OriginNotFinite, |shot| shot.origin_m[1] = f64::NAN),
        (Reason::DirectionNotFinite, |shot| shot.direction[2] = f64::INFINITY),
        (Reason::DirectionNotFinite, |shot| shot.direction[0] = f64::NAN),
        (Reason::DirectionNotUnit, |shot| shot.direction[2] = 0.80001),
        (Reason::DirectionNotUnit, |shot| shot.direction = [0.0; 3]),
        (Reason::TimeInfinite, |shot| shot.gps_time_s = Some(f64::NEG_INFINITY)),
        (Reason::BackwardClock, |shot| shot.clock_ps = -1),
        (Reason::WrongFrameScale, |shot| shot.frame_scale = Some(0.0)),
        (Reason::WrongFrameScale, |shot| shot.frame_scale = Some(f64::NAN)),
        (Reason::WrongFrameScale, |shot| shot.frame_scale = Some(1e-300)),
        (Reason::WrongScanAngle, |shot| shot.scan_angle_deg = Some(181.0)),
        (Reason::RepeatedShotNumber, |shot| shot.shot = 0),
    ];
    for (reason, change) in shots {
        let mut shot = good(1, 0);
        change(&mut shot);
        let line = around(|line| {
            line.shot(&shot);
            line.block(&echo());
            line.block(&echo());
        });
        expect_rejected(line, reason, 2);
    }
    let blocks: [(Reason, ContainerBlock); 10] = [
        (Reason::ShotWithUnknownChannel, ContainerBlock { channel: 4, ..echo() }),
        (Reason::BlockWithoutTime, ContainerBlock { start_ns: f64::NAN, ..echo() }),
        (Reason::FarBlock, ContainerBlock { start_ns: 2e7, ..echo() }),
        (Reason::WrongInterval, ContainerBlock { interval_ns: Some(1000.0), ..echo() }),
        (Reason::WrongGain, ContainerBlock { gain: Some(0.0), ..echo() }),
        (Reason::WrongGain, ContainerBlock { gain: Some(1025.0), ..echo() }),
        (Reason::WrongGain, ContainerBlock { gain: Some(f64::NAN), ..echo() }),
        (Reason::WrongInterval, ContainerBlock { interval_ns: Some(0.0), ..echo() }),
        (Reason::WrongInterval, ContainerBlock { interval_ns: Some(-1.0), ..echo() }),
        (Reason::WrongInterval, ContainerBlock { interval_ns: Some(f64::NAN), ..echo() }),
    ];
    for (reason, block) in blocks {
        let line = around(|line| {
            line.shot(&good(1, 0));
            [echo(), block, echo()].iter().for_each(|block| line.block(block));
        });
        expect_rejected(line, reason, 3);
    }
    let line = around(|line| {
        line.shot(&good(1, 0));
        line.online(&ContainerOnline { time_ns: f64::NAN, amplitude: 1.0 });
    });
    expect_rejected(line, Reason::OnlineWithoutTime, 0);
}

fn expect_rejected(line: LineBuilder, reason: Reason, blocks: u64) {
    let with_gain = ContainerHeader { gain_control: Some(container::GainControl::Recorded), ..header() };
    let (batches, cx) = read(&bytes(&with_gain, vec![line]));
    let kept: Vec<u64> = batches[0].emissions.iter().map(|emission| emission.shot).collect();
    assert_eq!(kept, [0, 2], "{reason}");
    assert_eq!(batches[0].blocks().unwrap().len(), 2, "{reason}");
    let rejected = &cx.counters().rejected;
    assert_eq!(rejected.get(&(Item::Shots, reason)), Some(&1), "{rejected:?}");
    assert_eq!(cx.counters().rejected_of(Item::Shots), 1, "{rejected:?}");
    assert_eq!(cx.counters().rejected_of(Item::Blocks), blocks, "{rejected:?}");
}

#[test]
fn a_line_without_a_good_shot_is_passed_over() {
    let bad = |shot| ContainerShot { origin_m: [f64::NAN; 3], ..good(shot, 1) };
    let bytes = bytes(&header(), vec![plain([good(0, 0)]), plain([bad(1), bad(2)]), plain([good(3, 2)])]);
    let (batches, cx) = read(&bytes);
    assert_eq!(lines(&batches), [(0, 0, 1), (2, 3, 1)]);
    assert_eq!(cx.counters().rejected_of(Item::Shots), 2);
}

#[test]
fn a_short_unit_vector_and_nulls_are_taken_as_they_are() {
    let mut shot = good(0, 0);
    shot.direction = [0.0, 0.6, 0.800_000_9];
    shot.gps_time_s = None;
    let (batches, cx) = read(&bytes(&header(), vec![plain([shot])]));
    assert!(cx.counters().rejected.is_empty());
    let emission = batches[0].emissions[0];
    assert_eq!(emission.direction, shot.direction);
    assert!(emission.gps_time_s.is_nan() && emission.scan_angle_deg.is_nan());
    assert_eq!((emission.frame_scale, emission.mta_zone), (1.0, None));
    let block = *batches[0].blocks().unwrap().iter().next().unwrap();
    assert_eq!((block.interval_ns, block.zone), (1.0, None));
}

#[test]
fn emission_reference_follows_from_blocks_or_metadata() {
    let reference = |code, said| {
        let mut line = plain([good(0, 0)]);
        line.block(&ContainerBlock { channel: code, ..echo() });
        let header = ContainerHeader { emission_reference: said, ..header() };
        read(&bytes(&header, vec![line])).0[0].input.emission_reference
    };
    assert_eq!(reference(channel::REFERENCE, None), EmissionReference::OutgoingPulse);
    assert_eq!(reference(channel::HIGH_POWER, None), EmissionReference::Clock);
    let said = Some(container::EmissionReference::ReturnLocations);
    assert_eq!(reference(channel::REFERENCE, said), EmissionReference::ReturnLocations);
}

#[test]
fn a_stream_without_its_end_mark_is_noted() {
    let whole = bytes(&header(), vec![plain([good(0, 0)])]);
    let (batches, cx) = read(&whole[..whole.len() - 8]);
    assert_eq!(lines(&batches), [(0, 0, 1)]);
    assert_eq!(cx.counters().notes, ["the Arrow stream ends without its end mark: lines may be missing"]);
    assert!(read(&whole).1.counters().notes.is_empty());
}

#[test]
fn an_empty_container_has_no_lines() {
    let (batches, cx) = read(&bytes(&header(), vec![]));
    assert!(batches.is_empty() && cx.counters().notes.is_empty());
}

#[test]
fn the_key_is_a_path_or_several() {
    let config: ReadArrow = toml::from_str("path = \"-\"").unwrap();
    assert_eq!(config.paths().unwrap().patterns(), ["-"]);
    assert_eq!(config.check(), Ok(()));
    let config: ReadArrow = toml::from_str("path = [\"a.arrow\", \"\"]").unwrap();
    assert_eq!(config.check(), Err(InvalidKey::new("path", "a path is empty")));
    let config: ReadArrow = toml::from_str("path = []").unwrap();
    assert_eq!(config.check(), Err(InvalidKey::new("path", "at least one file is needed")));
    let error = toml::from_str::<ReadArrow>("").unwrap_err().to_string();
    assert!(error.contains("missing field `path`"), "{error}");
    let error = toml::from_str::<ReadArrow>("path = \"a\"\nline = 3").unwrap_err().to_string();
    assert!(error.contains("unknown field `line`"), "{error}");
}
