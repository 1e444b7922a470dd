//! Records without shots, lines, clocks, and emissions without samples.

use wavex::scan_line::emission_flags::EDGE_OF_FLIGHT_LINE;
use wavex_formats::container::{ContainerHeader, EmissionReference, channel};

use wavex_testkit::container::{Row, container};
use wavex_testkit::sdf::{header, lengths, place, plain, plain_line, read, with_edges};
use wavex_testkit::{notes, rejected};

#[test]
fn lines_of_one_shot_are_lines() {
    let lines: Vec<Vec<Row>> = (0..4).map(|line| plain_line([u64::from(line)], line)).collect();
    let place = place(&container(&header(), &lines), "");
    assert_eq!(read(&place, "").1, with_edges(lines));
}

#[test]
fn a_line_ends_with_the_shot_that_says_so() {
    // One record batch: only the flags separate lines.
    let mut rows = plain_line(0..9, 0);
    for last in [2, 3, 8] {
        rows[last].shot.flags |= EDGE_OF_FLIGHT_LINE;
    }
    let place = place(&container(&header(), &[rows]), "");
    let (report, lines) = read(&place, "");
    assert_eq!(lengths(&lines), [(0, 3), (1, 1), (2, 5)]);
    assert_eq!(lines[1][0].shot.flags, 3 | EDGE_OF_FLIGHT_LINE);
    assert_eq!(notes(&report), Vec::<String>::new());
}

#[test]
fn a_clock_that_jumps_back_ends_a_line_and_nothing_is_lost() {
    let mut rows = plain_line(0..8, 0);
    rows[3..].iter_mut().for_each(|row| row.shot.clock_ps -= 4_000_000_000_000);
    rows[6..].iter_mut().for_each(|row| row.shot.clock_ps += 3_000_000_000_000_000);
    let place = place(&container(&header(), &[rows.clone()]), "");
    let (report, lines) = read(&place, "");
    assert_eq!(lengths(&lines), [(0, 3), (1, 5)]);
    assert!(rejected(&report).is_empty());
    let clocks = |rows: &[Row]| rows.iter().map(|row| row.shot.clock_ps).collect::<Vec<_>>();
    assert_eq!(clocks(&lines.concat()), clocks(&rows));
}

#[test]
fn a_shot_that_recorded_nothing_is_a_shot_all_the_same() {
    let mut rows = plain_line(0..5, 0);
    rows[2].blocks.clear();
    rows[4].blocks.clear();
    let place = place(&container(&header(), std::slice::from_ref(&rows)), "");
    assert_eq!(read(&place, "").1, with_edges(vec![rows]));
}

#[test]
fn housekeeping_is_passed_over_and_its_blocks_are_counted() {
    let mut rows = plain_line(0..5, 0);
    rows[1].shot.flags = 7;
    rows[3].shot.flags = 7;
    rows[3].blocks.clear();
    let place = place(&container(&header(), &[rows]), "");
    let (report, lines) = read(&place, "");
    assert_eq!(lengths(&lines), [(0, 3)]);
    let numbers: Vec<u64> = lines[0].iter().map(|row| row.shot.shot).collect();
    assert_eq!(numbers, [0, 1, 2], "shots are numbered as they are read");
    let expected = [("blocks: a block of a housekeeping record".to_owned(), 2)];
    assert_eq!(rejected(&report).into_iter().collect::<Vec<_>>(), expected);
}

#[test]
fn a_block_of_an_unknown_channel_rejects_its_shot() {
    let mut rows = plain_line(0..3, 0);
    rows[1].blocks.push((4, 0.0, vec![1]));
    let place = place(&container(&header(), &[rows]), "");
    let (report, lines) = read(&place, "");
    assert_eq!(lengths(&lines), [(0, 2)]);
    let reason = |item: &str| format!("{item}: a block of an unknown channel");
    assert_eq!(
        rejected(&report).into_iter().collect::<Vec<_>>(),
        [(reason("blocks"), 3), (reason("shots"), 1)]
    );
}

#[test]
fn an_outgoing_pulse_without_samples_is_the_moment_of_emission() {
    let mut rows = plain_line(0..3, 0);
    for row in &mut rows {
        row.blocks[0] = (channel::REFERENCE, 12.000_25, vec![]);
    }
    let place = place(&container(&header(), &[rows]), "");
    let (_, lines) = read(&place, "");
    for (row, shot) in lines[0].iter().zip(0..) {
        let given = plain(shot, 0);
        assert_eq!(row.shot.clock_ps, given.shot.clock_ps + 12_000, "to a picosecond");
        assert_eq!(row.blocks, [(channel::LOW_POWER, 3_988.499_75, vec![2, 9, 30, 9, 2])]);
    }
    let reader = wavex_formats::container::ContainerReader::open(&place.path("out/sdf.arrow")).unwrap();
    let said: &ContainerHeader = reader.header();
    assert_eq!(said.emission_reference, Some(EmissionReference::Clock));
}

#[test]
fn a_recording_without_outgoing_pulses_counts_from_the_clock() {
    let mut rows = plain_line(0..3, 0);
    rows.iter_mut().for_each(|row| drop(row.blocks.remove(0)));
    let header = ContainerHeader { emission_reference: Some(EmissionReference::Clock), ..header() };
    let place = place(&container(&header, std::slice::from_ref(&rows)), "");
    assert_eq!(read(&place, "").1, with_edges(vec![rows]));
    let reader = wavex_formats::container::ContainerReader::open(&place.path("out/sdf.arrow")).unwrap();
    assert_eq!(reader.header(), &header);
}

#[test]
fn an_empty_recording_has_no_lines() {
    let place = place(&container(&header(), &[]), "");
    let outcome = place.run(&wavex_testkit::sdf::copy(""));
    assert_eq!((outcome.code, outcome.err.as_str()), (Some(0), ""));
    let report: serde_json::Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    assert_eq!(notes(&report["inputs"][0]), ["no container is written: there were no shots"]);
}
