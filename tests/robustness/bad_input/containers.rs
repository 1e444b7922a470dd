//! Damaged waveform containers.

use std::fs::File;
use std::path::Path;

use serde_json::{Value, json};
use wavex_formats::container::{
    Compression, ContainerHeader, ContainerShot, ContainerWriter, EmissionReference, TimeScale, channel,
};
use wavex_testkit::container::{Row, compressed, line_of, nadir_shot};

use wavex_testkit::shots::{echo, time_s};
use wavex_testkit::{Outcome, TO_TABLE, TestFolder, notes, outcome, rejected};

const CUT: &str = "the file is cut off: copy it again from its source";
const DAMAGED: &str = "the file is damaged: copy it again from its source";

fn header() -> ContainerHeader {
    ContainerHeader {
        time_scale: TimeScale::Week,
        full_scale_dn: Some(255),
        emission_reference: Some(EmissionReference::Clock),
        ..ContainerHeader::new(1.0, 299_707_502.0)
    }
}

/// Lines of 100 shots with one echo block each, modified by `change`.
fn lines(shots: usize, change: impl Fn(usize, &mut ContainerShot)) -> Vec<Vec<Row>> {
    let row = |&number: &usize| {
        let mut shot = ContainerShot {
            line: number as u32 / 100,
            gps_time_s: Some(time_s(number)),
            origin_m: [number as f64, 0.0, 0.0],
            flags: 1,
            ..nadir_shot(number as u64, number as i64 * 1_000_000)
        };
        change(number, &mut shot);
        let samples = echo(number).into_iter().map(u16::from).collect();
        Row { shot, blocks: vec![(channel::LOW_POWER, 4000.0, samples)] }
    };
    (0..shots).collect::<Vec<_>>().chunks(100).map(|line| line.iter().map(row).collect()).collect()
}

/// A container of such lines.
fn container(shots: usize, compression: Compression, change: impl Fn(usize, &mut ContainerShot)) -> Vec<u8> {
    compressed(&header(), &lines(shots, change), compression)
}

/// The container as an Arrow stream.
fn stream() -> Vec<u8> {
    let mut writer =
        ContainerWriter::stream(Vec::new(), Path::new("-"), &header(), Compression::None).unwrap();
    lines(250, |_, _| {}).iter().for_each(|rows| writer.write(line_of(rows)).unwrap());
    writer.finish().unwrap()
}

#[track_caller]
fn refused(bytes: &[u8], message: &str) {
    let place = TestFolder::with(&[("a.arrow", bytes)]);
    place.fails("read_arrow", "a.arrow", &format!("stage read_arrow: ./a.arrow: {message}"));
}

#[test]
fn a_file_that_was_cut_off() {
    let whole = container(250, Compression::None, |_, _| {});
    for cut in [whole.len() - 1, whole.len() - 10, whole.len() / 2, 1000, 18, 8, 6] {
        let at = cut.saturating_sub(10);
        refused(&whole[..cut], &format!("byte {at}: end of the file: the footer is missing; {CUT}"));
    }
    refused(
        &whole[..5],
        "neither an Arrow IPC file nor a stream; give a waveform container, or use the reader of the file's own format",
    );
}

#[test]
fn sizes_that_lie() {
    let whole = container(250, Compression::None, |_, _| {});
    let end = whole.len() - 10;
    let mut bytes = whole.clone();
    bytes[end..end + 4].copy_from_slice(&i32::MAX.to_le_bytes());
    refused(&bytes, &format!("byte {end}: length of the footer: it is 2147483647; {DAMAGED}"));
    // The samples of a line (100 times 48 of two bytes) claim to unpack to more than an address
    // space.
    let mut bytes = without_digests(container(250, Compression::Lz4, |_, _| {}));
    let at = bytes.windows(8).position(|window| window == 9600i64.to_le_bytes()).unwrap();
    bytes[at..at + 8].copy_from_slice(&(1i64 << 60).to_le_bytes());
    let message = "byte 1920: column `blocks.samples`: 5100 packed bytes that are said to unpack to 1152921504606846976";
    refused(&bytes, &format!("{message}; {DAMAGED}"));
}

/// The same container, as of a program that writes no digests.
fn without_digests(mut bytes: Vec<u8>) -> Vec<u8> {
    let (ours, theirs) = (b"wavex.digest", b"other.digest");
    while let Some(at) = bytes.windows(ours.len()).position(|window| window == ours) {
        bytes[at..at + ours.len()].copy_from_slice(theirs);
    }
    bytes
}

#[test]
fn a_stream_that_ends_between_two_lines_is_noted() {
    let mut whole = stream();
    whole.truncate(whole.len() - 8);
    let place = TestFolder::with(&[("a.arrows", &whole)]);
    let mut command =
        place.command("[[stage]]\ntype = 'read_arrow'\npath = '-'\n[[stage]]\ntype = 'write_lstat'\n");
    command.stdin(File::open(place.path("a.arrows")).unwrap());
    assert_eq!(outcome(&mut command), Outcome::success());
    let report: Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    assert_eq!(
        notes(&report["inputs"][0]),
        ["the Arrow stream ends without its end mark: lines may be missing"]
    );
    assert_eq!(report["inputs"][0]["totals"]["nw"], json!(250));
    assert_eq!(place.outputs(), ["job_report.json", "stdin_lstat.txt", "stdin_stat.log"]);
}

#[test]
fn a_stream_that_ends_within_a_line_is_cut_off() {
    let mut whole = stream();
    whole.truncate(whole.len() - 9);
    let place = TestFolder::with(&[("a.arrow", &whole)]);
    let at = whole.len();
    let message = format!("byte 52224: body of a message: the bytes end at byte {at}; {CUT}");
    place.fails("read_arrow", "a.arrow", &format!("stage read_arrow: ./a.arrow: {message}"));
}

#[test]
fn a_shot_that_cannot_be_is_counted_and_passed_over() {
    let bytes = container(250, Compression::None, |number, shot| {
        if number == 100 {
            shot.direction = [0.0, 0.0, f64::NAN];
        }
    });
    let place = TestFolder::with(&[("a.arrow", &bytes)]);
    let input = place.succeeds("read_arrow", "a.arrow", TO_TABLE);
    let reason = "the direction is not finite";
    assert_eq!(
        json!(rejected(&input)),
        json!({ format!("shots: {reason}"): 1, format!("blocks: {reason}"): 1 })
    );
    let expected: Vec<String> = (0..250).filter(|i| *i != 100).map(|i| format!("{:?}", time_s(i))).collect();
    assert_eq!(place.times("out/a.csv"), expected);
    let expected = [
        "emission times are those of the clock: standard deviations of ranges include a jitter of one \
         sample, because no smooth points prove a smaller one; set `emission_jitter_ns` of `decompose` if the clock is more exact",
        "the input is not georeferenced: its points are in the scanner frame; give [job.geometry] a `trajectory` \
         and a `crs`",
    ];
    assert_eq!(notes(&input), expected);
    // One message, regardless of the number of workers that reported the problem.
    let log = place.text("out/job.log");
    expected.iter().for_each(|note| assert_eq!(log.matches(note).count(), 1, "{log}"));
    // Nor do the shots that are fitted again for the page repeat it.
    let stages = format!("[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n{TO_TABLE}");
    assert_eq!(place.run(&format!("report_page = 'page.html'\n{stages}")), Outcome::success());
    assert!(place.text("out/page.html").contains("deviation ratio"));
    let log = place.text("out/job.log");
    expected.iter().for_each(|note| assert_eq!(log.matches(note).count(), 1, "{log}"));
}

#[test]
fn echoes_of_an_unknown_pulse_are_refused() {
    let bytes = container(250, Compression::None, |number, shot| {
        if number == 100 {
            shot.mta_zone = None;
        }
    });
    let place = TestFolder::with(&[("a.arrow", &bytes)]);
    let message = "stage decompose: ./a.arrow: the pulse that caused the echoes of shot 100 is unknown; \
                   put resolve_mta before decompose";
    place.left_nothing(place.read("read_arrow", "a.arrow", TO_TABLE), message);
}
