//! Damaged PulseWaves.

use serde_json::json;

use wavex_testkit::pulsewaves::{HEADER, PulseWaves, WAVES, WAVES_HEADER, descriptor};
use wavex_testkit::{TO_TABLE, TestFolder, notes, outcome, rejected};

const CUT: &str = "the file is cut off: copy it again from its source";
const AGAIN: &str = "export the file again from its source";
const COPY_AGAIN: &str = "copy both files again: the waves file may be cut off, or that of another recording";

fn place(pulses: &[u8], waves: &[u8]) -> TestFolder {
    TestFolder::with(&[("a.pls", pulses), ("a.wvs", waves)])
}

#[track_caller]
fn refused(place: &TestFolder, message: &str) {
    place.fails("read_pulsewaves", "a.pls", &format!("stage read_pulsewaves: ./{message}"));
}

/// Asserts that a recording of three pulses with replaced bytes in the pulse file is refused.
#[track_caller]
fn refused_with(at: usize, bytes: &[u8], message: &str) {
    let whole = PulseWaves::new(3);
    let mut pulses = whole.pls();
    pulses[at..at + bytes.len()].copy_from_slice(bytes);
    refused(&place(&pulses, &whole.waves), &format!("a.pls: {message}"));
}

#[test]
fn missing_waves() {
    let place = TestFolder::with(&[("a.pls", &PulseWaves::new(3).pls())]);
    refused(
        &place,
        "a.pls: its waves file ./a.wvs is missing; put it into the folder of the pulse \
                     file",
    );
}

#[test]
fn compressed_pulses_without_their_description() {
    let problem = "its pulses are compressed (scheme 1), but the PulseZIP record is missing; the file is cut off \
                   or damaged: copy it again from its source";
    refused_with(204, &[1], problem);
}

#[test]
fn pulses_that_were_cut_off() {
    let whole = PulseWaves::new(3);
    let (pulses, start) = (whole.pls(), whole.offset_of(0));
    for (cut, problem) in [
        (
            pulses.len() - 1,
            format!("byte {}: pulse 2: the header declares 3 pulses, but the file has 2; {CUT}", start + 96),
        ),
        (start, format!("byte {start}: pulse 0: the header declares 3 pulses, but the file has 0; {CUT}")),
        (
            start - 1,
            format!(
                "the pulses start at byte {start}, but the file ends earlier; it is cut off: copy \
                 it again from its source"
            ),
        ),
        (
            HEADER,
            format!(
                "the pulses start at byte {start}, but the file ends earlier; it is cut off: copy \
                 it again from its source"
            ),
        ),
        (200, format!("byte 200: pulse size: 4 bytes needed, 0 left; {CUT}")),
    ] {
        refused(&place(&pulses[..cut], &whole.waves), &format!("a.pls: {problem}"));
    }
}

#[test]
fn waves_that_were_cut_off() {
    let whole = PulseWaves::new(3);
    let last = WAVES_HEADER + 2 * WAVES;
    for (cut, message) in [
        (0, "a.wvs: the file is empty; copy it again from its source".to_string()),
        (59, format!("a.wvs: byte 20: reserved: 40 bytes needed, 39 left; {CUT}")),
        (
            last,
            format!(
                "a.pls: byte {}: pulse 2: offset to waves: {last} is outside the waves file's \
                 bytes 60 to {last}; {COPY_AGAIN}",
                whole.offset_of(2) + 8
            ),
        ),
        (
            last + WAVES - 1,
            format!(
                "a.wvs: byte {}: pulse 2: samples: 48 bytes needed, 47 left in the file; {COPY_AGAIN}",
                last + 56
            ),
        ),
    ] {
        refused(&place(&whole.pls(), &whole.waves[..cut]), &message);
    }
}

#[test]
fn sizes_that_lie() {
    let start = PulseWaves::new(3).offset_of(0);
    let damaged = "the file is damaged: copy or export it again";
    refused_with(
        176,
        &i64::MAX.to_le_bytes(),
        "the pulses start at byte 9223372036854775807, but the file ends earlier; it is cut off: \
         copy it again from its source",
    );
    refused_with(
        184,
        &i64::MAX.to_le_bytes(),
        &format!(
            "byte {}: pulse 3: the header declares 9223372036854775807 pulses, but the file has 3; \
             {CUT}",
            start + 144
        ),
    );
    refused_with(
        200,
        &u32::MAX.to_le_bytes(),
        "byte 200: pulse size: 4294967295 exceeds the limit of 1048576; export the file again from its source",
    );
    refused_with(
        216,
        &u32::MAX.to_le_bytes(),
        &format!("byte 216: number of variable length records: 4294967295 is above 65536; {AGAIN}"),
    );
    refused_with(
        HEADER + 24,
        &i64::MAX.to_le_bytes(),
        &format!(
            "byte 376: variable length record 0: record length after header: 9223372036854775807 does not fit before \
             the pulses; {damaged}"
        ),
    );
}

#[test]
fn a_descriptor_of_more_samples_than_a_waveform_has() {
    let mut whole = PulseWaves::new(3);
    whole.records[0].1 = descriptor(u32::MAX);
    let message = "a.wvs: byte 64: pulse 0: samples: 4294967295 bytes needed, 308 left in the \
                   file; copy both files again: the waves file may be cut off, or that of another recording";
    refused(&place(&whole.pls(), &whole.waves), message);
}

#[test]
fn waves_that_overlap_take_no_more_memory_than_a_line_may() {
    // 600 pulses with two segments of 1 MB each, from a file of little more than 1 MB.
    let long = 1 << 20;
    let mut whole = PulseWaves::new(600);
    whole.records[0].1 = descriptor(long);
    whole.waves.resize(600 * WAVES + 2 * long as usize + 100, 3);
    let place = place(&whole.pls(), &whole.waves);
    let mut command = place
        .command("[[stage]]\ntype = 'read_pulsewaves'\npath = 'a.pls'\n[[stage]]\ntype = 'write_lstat'\n");
    command.args(["--set", "job.memory_mb=64"]);
    let message = "stage read_pulsewaves: ./a.pls: scan line 0 needs 67.1 MB, too much for the job's memory_mb; \
                   set memory_mb to 135 or more";
    place.left_nothing(outcome(&mut command), message);
}

/// Asserts that one bad pulse in the middle of a recording is skipped and counted, and all others
/// are read.
#[track_caller]
fn loses_one_pulse(bad: &PulseWaves, what: &str, note: Option<&str>) {
    let good = PulseWaves::new(250);
    let whole = place(&good.pls(), &good.waves);
    whole.succeeds("read_pulsewaves", "a.pls", TO_TABLE);
    let place = place(&bad.pls(), &bad.waves);
    let input = place.succeeds("read_pulsewaves", "a.pls", TO_TABLE);
    assert_eq!(json!(rejected(&input)), json!({ what: 1 }));
    let reason = what.split_once(": ").unwrap().1;
    let said = note.map(|note| format!("{reason} was rejected; further ones are only counted: ./{note}"));
    assert_eq!(notes(&input), Vec::from_iter(said));
    let mut expected = whole.times("out/a.csv");
    assert_eq!(expected.len(), 250);
    expected.remove(100);
    assert_eq!(place.times("out/a.csv"), expected);
}

#[test]
fn a_pulse_of_a_descriptor_that_is_missing_is_counted_and_passed_over() {
    let bad = PulseWaves::new(250).change(100, 44, &[9]);
    let note = format!(
        "a.pls: byte {}: pulse 100: pulse descriptor index: the file has no descriptor 9; \
         export the files with 8 or 16 bit uncompressed waves",
        bad.offset_of(100) + 44
    );
    loses_one_pulse(&bad, "shots: a pulse whose waves cannot be read", Some(&note));
}

#[test]
fn a_pulse_whose_waves_lie_outside_of_the_file_is_counted_and_passed_over() {
    for offset in [0, 1 << 30, -1, i64::MAX, i64::MIN] {
        let bad = PulseWaves::new(250).change(100, 8, &offset.to_le_bytes());
        let note = format!(
            "a.pls: byte {}: pulse 100: offset to waves: {offset} is outside the waves file's \
             bytes 60 to 26060; {COPY_AGAIN}",
            bad.offset_of(100) + 8
        );
        loses_one_pulse(&bad, "shots: a pulse whose waves cannot be read", Some(&note));
    }
}

#[test]
fn a_pulse_without_direction_is_counted_and_passed_over() {
    let nowhere = [100i32, 0, 0, 100, 0, 0].map(i32::to_le_bytes).concat();
    let bad = PulseWaves::new(250).change(100, 16, &nowhere);
    loses_one_pulse(&bad, "shots: a pulse without direction", None);
}

#[test]
fn a_coordinate_system_that_is_missing_is_noted() {
    let whole = PulseWaves::new(250);
    let stages = TO_TABLE.replace("write_table'\npath = '*.csv'", "write_las'");
    let input = place(&whole.pls(), &whole.waves).succeeds("read_pulsewaves", "a.pls", &stages);
    let expected =
        ["the input has no coordinate reference system (WKT or EPSG code), so the file has none; set it \
          with the reader's key `crs_of_input`"];
    assert_eq!(notes(&input), expected);
}

#[test]
fn waves_of_another_recording_are_suspected() {
    let whole = PulseWaves::new(250);
    let with_unused = |bytes: usize| [whole.waves.clone(), vec![0; bytes]].concat();
    let suspicions = |waves: &[u8]| {
        let input = place(&whole.pls(), waves).succeeds("read_pulsewaves", "a.pls", TO_TABLE);
        notes(&input).into_iter().filter(|note| note.contains("another recording")).collect::<Vec<_>>()
    };
    assert_eq!(suspicions(&with_unused(whole.waves.len() / 2)), Vec::<String>::new());
    let waves = with_unused(2 * whole.waves.len());
    let expected = format!(
        "the waves of all pulses begin in the first {} of the {} bytes of the waves file: it may be that of another recording; copy \
         both files again, unless the pulses are a part of a recording",
        whole.waves.len() - (whole.waves.len() - 60) / 250,
        waves.len()
    );
    assert_eq!(suspicions(&waves), [expected]);
    // The second of two begins in the middle.
    let two = PulseWaves::new(2);
    let input = place(&two.pls(), &two.waves).read("read_pulsewaves", "a.pls", "");
    assert!(!input.err.contains("another recording"), "{}", input.err);
}
