//! Modes of `decompose`.

use wavex::scan_line::flags::{OVERLAP, REFINED};
use wavex_testkit::TestFolder;

use super::{LOW, SHOTS, flags_of, of_shot, recording, run, samples};
use wavex_testkit::table::{Row, number};

/// Returns of the same shots in two modes.
fn pairs<'a>(a: &'a [Row], b: &'a [Row], shots: &[usize]) -> Vec<(&'a Row, &'a Row)> {
    let of = |&shot: &usize| {
        let (a, b) = (of_shot(a, shot), of_shot(b, shot));
        assert_eq!(a.len(), b.len(), "shot {shot}");
        a.into_iter().zip(b).collect::<Vec<_>>()
    };
    shots.iter().flat_map(of).collect()
}

#[test]
fn modes_agree_where_returns_stand_alone_and_refine_on_request_where_they_overlap() {
    modes_differ_as_their_names_say("", 0);
}

/// Also with a background per waveform, few waveforms are left to the plain kernels.
#[test]
fn modes_differ_where_each_waveform_has_a_background_of_its_own() {
    let place = modes_differ_as_their_names_say("background = 'per_waveform'", 3);
    for mode in ["fastest", "fast_separated", "refined"] {
        run(&place, "", "background = 'per_waveform'", &format!("mode = '{mode}'"));
        let left = left_to_plain(&place);
        assert!(left < 0.05 * SHOTS as f64, "{mode}: {left}");
    }
}

/// Number of waveforms left to the plain kernels in the last run.
fn left_to_plain(place: &TestFolder) -> f64 {
    let report: serde_json::Value = serde_json::from_str(&place.text("out/job_report.json")).unwrap();
    let stages = report["inputs"][0]["stages"].as_array().unwrap();
    let observed = |stage: &serde_json::Value| stage["observed"]["left_to_plain_kernels"].clone();
    let left = stages.iter().map(observed).find(|left| !left.is_null()).unwrap();
    left["mean"].as_f64().unwrap() * left["count"].as_f64().unwrap()
}

/// A waveform of two sample blocks counts once.
#[test]
fn waveforms_left_to_the_plain_kernels_are_counted_once() {
    let place = recording(|number, shot| shot.blocks.push((LOW, 1200.0, samples(number, &[(24.0, 90.0)]))));
    let (_, totals) = run(&place, "", "", "mode = 'slow'");
    assert_eq!((totals["nw"].as_u64(), left_to_plain(&place).round()), (Some(SHOTS as u64), SHOTS as f64));
}

/// Runs all modes with this key of `calibrate`, on waveforms whose levels differ by up to
/// `levels - 1` DN.
fn modes_differ_as_their_names_say(calibrate: &str, levels: usize) -> TestFolder {
    let place = recording(|number, shot| {
        if number % 5 == 3 {
            let apart = 7.0 + 0.05 * (number % 40) as f64;
            shot.blocks[1].2 = samples(number, &[(20.0, 120.0), (20.0 + apart, 70.0)]);
        }
        let level = (number % levels.max(1)) as u16;
        shot.blocks[1].2.iter_mut().for_each(|sample| *sample += level);
    });
    let of_mode = |keys: &str| run(&place, "", calibrate, keys);
    let (refined, totals) = of_mode("");
    assert_eq!(totals["nw_refined1x"], SHOTS);
    assert!(refined.iter().all(|row| flags_of(row) & REFINED != 0));
    let (overlapping, isolated): (Vec<usize>, Vec<usize>) = (0..SHOTS).partition(|shot| shot % 5 == 3);
    assert!(overlapping.iter().all(|&shot| of_shot(&refined, shot).len() == 2));

    for mode in ["fastest", "fast_separated", "slow"] {
        let (rows, totals) = of_mode(&format!("mode = '{mode}'"));
        let pairs = pairs(&refined, &rows, &isolated);
        assert_eq!(pairs.len(), isolated.len());
        for quantity in ["time_of_flight_ns", "amplitude_dn", "width_ratio"] {
            let sd = match quantity.rsplit_once('_') {
                Some((name, unit @ ("ns" | "dn"))) => format!("{name}_sd_{unit}"),
                _ => format!("{quantity}_sd"),
            };
            let distance =
                |(a, b): &(&Row, &Row)| (number(a, quantity) - number(b, quantity)).abs() / number(a, &sd);
            let far = pairs.iter().map(distance).fold(0.0, f64::max);
            println!("{mode}: {quantity} within {far:.3} standard deviations");
            assert!(far < 0.5, "{mode} {quantity}: {far}");
        }
        let refined_of = |shots: &[usize]| {
            let rows = shots.iter().flat_map(|&shot| of_shot(&rows, shot));
            rows.filter(|row| flags_of(row) & REFINED != 0).count()
        };
        let found = (refined_of(&isolated), refined_of(&overlapping));
        let both = 2 * overlapping.len();
        match mode {
            // Pulses that one step does not settle are fitted.
            "fastest" => assert!(found.0 == 0 && 4 * found.1 < both, "{found:?}"),
            "fast_separated" => {
                let is = |row: &Row, flag: u16| flags_of(row) & flag != 0;
                assert!(rows.iter().all(|row| is(row, REFINED) == is(row, OVERLAP)));
                assert!(found.0 == 0 && found.1 * 100 >= 95 * both, "{found:?}");
            }
            _ => assert_eq!(found, (isolated.len(), both)),
        }
        let any_refined = |shot: &usize| of_shot(&rows, *shot).iter().any(|row| flags_of(row) & REFINED != 0);
        assert_eq!(totals["nw_refined1x"], (0..SHOTS).filter(any_refined).count(), "{mode}");
    }
    for mode in ["fastest", "fast_separated"] {
        let (rows, _) = of_mode(&format!("mode = '{mode}'\nrefine_when_needed = true"));
        for (expected, found) in pairs(&refined, &rows, &overlapping) {
            assert_eq!(expected, found, "{mode}");
        }
        let untouched = isolated.iter().flat_map(|&shot| of_shot(&rows, shot));
        assert!(untouched.filter(|row| flags_of(row) & REFINED == 0).count() * 10 > isolated.len() * 9);
    }
    place
}
