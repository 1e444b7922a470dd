//! Faulty recordings.

use wavex_formats::container::{ContainerHeader, ContainerReader};

use super::flights::{Found, lines_of, recorded, resolve, score, stage};
use wavex_testkit::TestFolder;
use wavex_testkit::container::{Row, container};

fn header() -> ContainerHeader {
    let place = TestFolder::with(&[("a.arrow", &recorded().recording)]);
    ContainerReader::open(&place.path("a.arrow")).unwrap().header().clone()
}

/// Resolves the flight after a modification of its lines.
fn changed(change: impl FnOnce(&mut Vec<Vec<Row>>)) -> Found {
    let mut lines = lines_of(&recorded().recording);
    change(&mut lines);
    resolve(&container(&header(), &lines), "")
}

/// Asserts that all input is passed on or rejected with a reason.
fn nothing_is_lost(found: &Found) {
    let stage = stage(&found.report, "resolve_mta");
    let rejected: u64 = stage["rejected"].as_object().unwrap().values().map(|n| n.as_u64().unwrap()).sum();
    let count = |way: &str, item: &str| stage[way][item].as_u64().unwrap();
    assert_eq!(count("items_in", "blocks"), count("items_out", "blocks") + rejected, "{stage}");
    assert_eq!(count("items_in", "shots"), count("items_out", "shots"));
    assert_eq!(stage["lines_in"], stage["lines_out"]);
}

#[test]
fn a_line_may_have_one_shot() {
    let found = changed(|lines| {
        for at in [20, 40, 60] {
            let mut rest = lines[at].split_off(1);
            rest.iter_mut().for_each(|row| row.shot.line += 1000);
            lines.insert(at + 1, rest);
        }
    });
    nothing_is_lost(&found);
    assert_eq!(stage(&found.report, "resolve_mta")["lines_in"], 67);
    let score = score(&recorded().truth, &found.returns);
    println!("{} of {} right", score.right, score.true_returns);
    assert!(score.part_right() >= 0.999, "{:?}", score.missed_shots);
}

#[test]
fn a_recording_whose_lines_are_one_shot_long_is_resolved() {
    const SHOTS: u64 = 16 * 240;
    let found = changed(|lines| {
        let mut rows: Vec<Row> = lines.drain(..).flatten().take(SHOTS as usize).collect();
        rows.iter_mut().for_each(|row| row.shot.line = row.shot.shot as u32);
        lines.extend(rows.into_iter().map(|row| vec![row]));
    });
    nothing_is_lost(&found);
    assert_eq!(stage(&found.report, "resolve_mta")["lines_out"], SHOTS);
    // The echoes of the last shots were received after the end of the recording.
    let score = score(&truth_before(SHOTS - 5), &found.returns);
    println!("{} of {} right, {} other zones", score.right, score.true_returns, score.other_zones);
    assert!(score.true_returns > 4000);
    assert!(score.part_right() >= 0.999, "{:?}", score.missed_shots);
}

/// Truth of the first shots.
fn truth_before(shots: u64) -> String {
    let shot = |row: &str| row.split(',').next().and_then(|cell| cell.parse::<u64>().ok());
    let rows = recorded().truth.lines().filter(|row| shot(row).is_none_or(|shot| shot < shots));
    rows.map(|row| format!("{row}\n")).collect()
}

#[test]
fn a_clock_that_jumps_costs_the_echoes_in_the_air() {
    const SECOND_PS: i64 = 1_000_000_000_000;
    for (what, first_shot, by_ps) in [
        ("forward within a line", 30 * 240 + 100, SECOND_PS),
        ("forward between lines", 30 * 240, SECOND_PS),
        ("back between lines", 30 * 240, -SECOND_PS),
    ] {
        let found = changed(|lines| {
            for row in lines.iter_mut().flatten().filter(|row| row.shot.shot >= first_shot) {
                row.shot.clock_ps += by_ps;
            }
        });
        nothing_is_lost(&found);
        let score = score(&recorded().truth, &found.returns);
        println!("{what}: {} missed", score.missed_shots.len());
        let is_near = |shot: &u64| (first_shot.saturating_sub(8)..first_shot + 8).contains(shot);
        assert!(score.missed_shots.iter().filter(|shot| !is_near(shot)).count() <= 4, "{what}: {score:?}");
    }
}

#[test]
fn a_clock_that_runs_back_in_a_line_costs_the_shots_behind() {
    let found = changed(|lines| lines[30][100..].iter_mut().for_each(|row| row.shot.clock_ps -= 300_000_000));
    nothing_is_lost(&found);
    let reader = stage(&found.report, "read_arrow");
    assert!(reader["rejected"].to_string().contains("the clock runs backwards"), "{reader}");
    let score = score(&recorded().truth, &found.returns);
    let elsewhere = score.missed_shots.iter().filter(|&&shot| !(30 * 240..31 * 240).contains(&shot)).count();
    assert!(elsewhere <= 4, "{elsewhere}");
}

#[test]
fn shots_with_equal_clocks_are_a_warning() {
    let found = changed(|lines| lines[30][100].shot.clock_ps = lines[30][99].shot.clock_ps);
    nothing_is_lost(&found);
    let notes = stage(&found.report, "resolve_mta")["notes"].to_string();
    assert!(
        notes.contains("shots with duplicate timestamps are indistinguishable; their echoes go to the first"),
        "{notes}"
    );
    let score = score(&recorded().truth, &found.returns);
    assert!(score.missed_shots.len() <= 12, "{:?}", score.missed_shots);
}

#[test]
fn a_recording_that_ends_within_a_line_is_resolved_up_to_there() {
    let found = changed(|lines| {
        lines.truncate(41);
        lines[40].truncate(100);
    });
    nothing_is_lost(&found);
    // The echoes of the last shots were received after the end of the recording.
    let score = score(&truth_before(40 * 240 + 95), &found.returns);
    assert!(score.part_right() >= 0.999, "{:?}", score.missed_shots);
}

#[test]
fn echoes_beyond_the_range_are_counted() {
    let found = resolve(&recorded().recording, "range_m = [30, 1650]");
    nothing_is_lost(&found);
    let all = resolve(&recorded().recording, "");
    let rejected = |found: &Found| stage(&found.report, "resolve_mta")["rejected"].as_object().unwrap().len();
    assert_eq!(rejected(&all), 0);
    let at_most = |found: &Found| {
        let ranges = super::flights::Table::of(&found.returns).numbers("range_m");
        ranges.into_iter().fold(0.0, f64::max)
    };
    assert!(at_most(&all) > 1700.0 && at_most(&found) < 1660.0, "{} {}", at_most(&all), at_most(&found));
}

#[test]
fn blocks_far_from_their_shot_are_counted() {
    let found = changed(|lines| lines[30][100].blocks[1].1 = 1.1e9);
    let rejected = &stage(&found.report, "read_arrow")["rejected"];
    assert_eq!(rejected["shots: a block more than 0.01 s from its shot"], 1, "{rejected}");
}

#[test]
fn an_unresolved_recording_of_nothing_is_no_error() {
    let empty = container(&header(), &[]);
    let place = TestFolder::with(&[("a.arrow", &empty)]);
    let copy = "[[stage]]\ntype = 'resolve_mta'\n[[stage]]\ntype = 'write_arrow'\npath = 'copy.arrow'\n";
    let report = place.succeeds("read_arrow", "a.arrow", copy);
    assert_eq!(stage(&report, "resolve_mta")["lines_out"], 0);
}
