//! Zones from varying pulse intervals, against the truth.

use std::collections::BTreeMap;
use wavex::registry::STAGES;

use super::flights::{
    FLIGHT, Found, Table, chain, fly, in_scanner_frame, lines_of, recorded, resolve, score, stage,
};
use wavex_testkit::sdf::NAME;
use wavex_testkit::{Outcome, TestFolder};

/// Amplitude at which a return is found despite noise, DN.
const CLEAR_DN: f64 = 25.0;

#[test]
fn each_echo_gets_the_shot_that_caused_it() {
    let flight = recorded();
    let found = resolve(&flight.recording, "");
    let score = score(&flight.truth, &found.returns);
    println!("{} of {} right, {} other zones", score.right, score.true_returns, score.other_zones);
    println!("errors: {:.4} m in the middle, {:.4} m at 95 %", score.error_m(50), score.error_m(95));
    assert!(score.true_returns > 15_000);
    assert!(score.part_right() >= 0.999, "{:?}", score.missed_shots);
    assert_eq!(score.other_zones, 0);
    // Inclined ground and leaves widen echoes, so their ranges differ from those of flat targets.
    assert!(score.error_m(50) < 0.01 && score.error_m(95) < 0.06);
    let stage = stage(&found.report, "resolve_mta");
    assert_eq!(stage["rejected"].as_object().unwrap().len(), 0, "{stage}");
    let rms = stage["observed"]["pulse_interval_rms_ns"]["mean"].as_f64().unwrap();
    // Each pulse is displaced uniformly by up to 7.5 ns, so intervals have an RMS of sqrt(2 / 3)
    // times that.
    assert!((rms - 7.5 * (2f64 / 3.0).sqrt()).abs() < 0.2, "{rms}");
    let found = stage["findings"][0].as_str().unwrap();
    assert!(found.starts_with("echoes by zone: ") && found.contains(" in 3, "), "{found}");
    assert_eq!(stage["notes"].as_array().unwrap().len(), 0, "{stage}");
}

#[test]
fn points_stand_where_the_echoes_came_from() {
    let flight = recorded();
    let place = TestFolder::with(&[("a.arrow", &flight.recording)]);
    let (to_returns, table) = (chain(""), "[[stage]]\ntype = 'write_table'");
    assert_eq!(to_returns.matches(table).count(), 1);
    let georeference = format!("[[stage]]\ntype = 'georeference'\n{table}");
    place.succeeds("read_arrow", "a.arrow", &to_returns.replace(table, &georeference));
    let distances_m = distances_m(&flight.truth, &place.text("out/returns.csv"));
    let near = distances_m.iter().filter(|distance| **distance <= 1.5).count();
    let [middle, most] = [50, 95].map(|percent| distances_m[distances_m.len() * percent / 100]);
    println!(
        "{near} of {} within 1.5 m; {middle:.4} m in the middle, {most:.4} m at 95 %",
        distances_m.len()
    );
    assert!(distances_m.len() > 15_000);
    assert!(near as f64 >= 0.999 * distances_m.len() as f64);
    assert!(middle < 0.01 && most < 0.06);
}

/// Distance from each clear true return to the nearest point of its shot, m, ascending; infinite
/// without one.
fn distances_m(truth: &str, points: &str) -> Vec<f64> {
    let (truth, points) = (Table::of(truth), Table::of(points));
    let places = |table: &Table| {
        let [x, y, z] = ["x", "y", "z"].map(|name| table.numbers(name));
        let shots = table.numbers("shot").into_iter().map(|shot| shot as u64);
        shots.zip(x).zip(y).zip(z).map(|(((shot, x), y), z)| (shot, [x, y, z])).collect::<Vec<_>>()
    };
    let mut by_shot: BTreeMap<u64, Vec<[f64; 3]>> = BTreeMap::new();
    for (shot, place) in places(&points) {
        by_shot.entry(shot).or_default().push(place);
    }
    let clear = truth.numbers("amplitude_dn").into_iter().zip(truth.texts("class"));
    let clear = clear.map(|(amplitude_dn, class)| amplitude_dn >= 12.0 && class != "false_alarm");
    let mut distances: Vec<f64> = places(&truth)
        .into_iter()
        .zip(clear)
        .filter(|(_, is_clear)| *is_clear)
        .map(|((shot, place), _)| {
            let distance =
                |point: &[f64; 3]| point.iter().zip(place).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            by_shot.get(&shot).into_iter().flatten().map(distance).fold(f64::INFINITY, f64::min)
        })
        .collect();
    distances.sort_by(f64::total_cmp);
    distances
}

#[test]
fn first_and_last_lines_are_as_good_as_the_others() {
    let flight = recorded();
    let score = score(&flight.truth, &resolve(&flight.recording, "").returns);
    let line = |shot: &&u64| **shot / 240;
    let at_the_ends = score.missed_shots.iter().filter(|shot| line(shot) < 8 || line(shot) >= 56).count();
    // A quarter of the lines; echoes received after the end of the recording are not in the truth.
    assert!(at_the_ends <= 5, "{:?}", score.missed_shots);
}

#[test]
fn sdf_and_container_give_the_same_returns() {
    let flight = in_scanner_frame();
    let by_container = resolve(&flight.recording, "");
    let place = TestFolder::with(&[(NAME, &flight.recording)]);
    let reader = format!("[[stage]]\ntype = 'read_sdf'\npath = '{NAME}'\n{}", chain(""));
    assert_eq!(place.run(&reader), Outcome::success());
    assert!(by_container.returns == place.text("out/returns.csv"), "to the byte");
    let score = score(&flight.truth, &by_container.returns);
    println!("{} of {} right", score.right, score.true_returns);
    assert!(score.part_right() >= 0.999 && score.other_zones == 0, "{:?}", score.missed_shots);
}

#[test]
fn a_resolved_recording_of_the_same_flight_has_the_same_returns() {
    let resolved = fly(FLIGHT);
    let place = TestFolder::with(&[("a.arrow", &resolved.recording)]);
    place.succeeds("read_arrow", "a.arrow", super::flights::TO_RETURNS);
    let direct = place.text("out/returns.csv");
    let found = resolve(&recorded().recording, "");
    let ranges = |text: &str| {
        let table = Table::of(text);
        let rows = table.numbers("shot").into_iter().zip(table.numbers("range_m"));
        rows.zip(table.numbers("amplitude_dn"))
            .map(|((shot, range_m), dn)| (shot, range_m, dn))
            .collect::<Vec<_>>()
    };
    let (direct, found) = (ranges(&direct), ranges(&found.returns));
    // Noise and overlapping blocks differ, so weak returns and those in woods may differ.
    let clear = |of: &[(f64, f64, f64)]| of.iter().filter(|one| one.2 >= CLEAR_DN).count();
    let missing = |from: &[(f64, f64, f64)], of: &[(f64, f64, f64)]| {
        let of_shot = |shot: f64| {
            let from = of.partition_point(|other| other.0 < shot);
            &of[from..of.partition_point(|other| other.0 <= shot)]
        };
        let found = |one: &&(f64, f64, f64)| of_shot(one.0).iter().any(|other| (one.1 - other.1).abs() < 1.0);
        clear(from) - from.iter().filter(|one| one.2 >= CLEAR_DN).filter(found).count()
    };
    let (lost, added) = (missing(&direct, &found), missing(&found, &direct));
    println!(
        "{} clear returns directly, {} resolved: {lost} lost, {added} added",
        clear(&direct),
        clear(&found)
    );
    assert!(clear(&direct) > 15_000);
    assert!(lost * 200 < direct.len() && added * 200 < direct.len());
}

#[test]
fn what_is_resolved_passes_through_as_it_is() {
    let resolved = fly("lines = 3\nshots_per_line = 150\n");
    let copy = "[[stage]]\ntype = 'write_arrow'\npath = 'copy.arrow'\ncompression = 'none'\n";
    let run = |stages: &str| {
        let place = TestFolder::with(&[("a.arrow", &resolved.recording)]);
        let report = place.succeeds("read_arrow", "a.arrow", stages);
        (report, std::fs::read(place.path("out/copy.arrow")).unwrap())
    };
    let (report, resolved) = run(&format!("[[stage]]\ntype = 'resolve_mta'\n{copy}"));
    assert!(resolved == run(copy).1, "to the byte");
    let findings = &stage(&report, "resolve_mta")["findings"];
    assert_eq!(findings[0], "lines with known zones pass through unchanged");
}

#[test]
fn resolved_and_unresolved_lines_may_follow_one_another() {
    let flight = recorded();
    let mut lines = lines_of(&flight.recording);
    for row in lines[20..30].iter_mut().flatten() {
        row.shot.mta_zone = Some(0);
    }
    let header = wavex_formats::container::ContainerReader::open(
        &TestFolder::with(&[("a.arrow", &flight.recording)]).path("a.arrow"),
    )
    .unwrap()
    .header()
    .clone();
    let mixed = wavex_testkit::container::container(&header, &lines);
    let found = resolve(&mixed, "");
    let lines_out = &stage(&found.report, "resolve_mta")["lines_out"];
    assert_eq!(lines_out, 64);
    let score = score(&flight.truth, &found.returns);
    let elsewhere = score.missed_shots.iter().filter(|&&shot| !(20 * 240..30 * 240).contains(&shot)).count();
    println!("{elsewhere} missed in the lines that were to be resolved");
    assert!(elsewhere * 500 < score.true_returns, "{elsewhere}");
}

#[test]
fn threads_and_queues_change_no_byte() {
    let first = with_engine(1, 1);
    assert!(first.returns.len() > 1_000_000);
    for (threads, capacity) in [(2, 16), (4, 2)] {
        assert!(with_engine(threads, capacity).returns == first.returns, "{threads} threads, {capacity}");
    }
}

fn with_engine(threads: usize, capacity: usize) -> Found {
    let place = TestFolder::with(&[("a.arrow", &recorded().recording)]);
    let job = format!("[[stage]]\ntype = 'read_arrow'\npath = 'a.arrow'\n{}", chain(""));
    let job = wavex::job::Job::parse(STAGES, "job", &job, &[]).unwrap();
    let options = wavex::engine::Options {
        threads,
        channel_capacity: capacity,
        ..wavex::engine::Options::of_job(&job, place.path(""), place.path("out"))
    };
    wavex::engine::run(&job, &options).unwrap();
    Found { report: serde_json::Value::Null, returns: place.text("out/returns.csv") }
}
