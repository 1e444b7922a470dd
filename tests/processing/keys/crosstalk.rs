//! Crosstalk between emissions and echoes.

use wavex::scan_line::flags::{ECHO_ON_OUTGOING, EMISSION_IN_BLOCK, EMISSION_ON_ECHO};
use wavex_testkit::TestFolder;

use super::{INTERVAL_NS, LOW, SHOTS, flags_of, of_shot, recording, run, samples};
use wavex_testkit::table::{Row, number};

/// Shot 50 is recorded while shot 51 is emitted, close to its echo. Shot 60 is recorded while shot
/// 61 is emitted, whose emission leaks in. An echo overlaps the outgoing pulse of shot 70.
fn with_crosstalk() -> TestFolder {
    recording(|number, shot| match number {
        50 => shot.blocks[1].1 = INTERVAL_NS - 20.0,
        60 => shot.blocks[1] = (LOW, INTERVAL_NS - 40.0, samples(number, &[(12.0, 120.0), (40.0, 60.0)])),
        70 => shot.blocks[0].2 = samples(number, &[(20.0, 150.0), (24.0, 60.0)]),
        _ => {}
    })
}

#[test]
fn crosstalk_is_flagged_and_dropped_on_request() {
    let place = with_crosstalk();
    let (rows, totals) = run(&place, "", "", "");
    let flags =
        |shot: usize| of_shot(&rows, shot).iter().map(|row| flags_of(row) & 0b11_1000).collect::<Vec<_>>();
    assert_eq!(flags(50), [EMISSION_ON_ECHO]);
    assert_eq!(flags(60), [EMISSION_IN_BLOCK, EMISSION_ON_ECHO]);
    assert_eq!(flags(70), [ECHO_ON_OUTGOING]);
    let others = (0..SHOTS).filter(|shot| ![50, 60, 70].contains(shot));
    assert!(others.flat_map(flags).all(|flags| flags == 0));
    assert_eq!((&totals["np_xtalk"], &totals["np_xtalk_dropped"]), (&4.into(), &0.into()));

    // The joint fit of pulse and echo recovers the emission time; a separate fit of the pulse is
    // 0.1 m late.
    let mixed = of_shot(&rows, 70)[0];
    let error_m = number(mixed, "range_m") - number(of_shot(&rows, 77)[0], "range_m");
    let sd_m = number(mixed, "range_sd_m");
    assert!(error_m.abs() < 3.0 * sd_m && (0.001..0.03).contains(&sd_m), "{error_m} {mixed:?}");
    assert!(rows.iter().all(|row| row["shot"] == "170" || number(row, "range_sd_m") < 0.02));

    let (kept, totals) = run(&place, "", "", "drop_emission_crosstalk = true");
    assert_eq!(of_shot(&kept, 50).len(), 0);
    assert_eq!(of_shot(&kept, 60).len(), 1);
    assert_eq!((&totals["np_xtalk"], &totals["np_xtalk_dropped"]), (&2.into(), &2.into()));
    let total = |name: &str| totals[name].as_u64().unwrap();
    assert_eq!(
        total("n_candidates") + total("n_added"),
        total("np") + total("np_filtered") + total("np_merged") + total("np_xtalk_dropped")
    );
    assert_eq!(total("nw"), total("nw_empty") + total("nw_deleted") + total("nw_with_points"));
}

/// Echoes 1.5 and 3.25 samples from the outgoing pulse widen it without a second maximum.
#[test]
fn echoes_that_merge_with_the_outgoing_pulse_are_flagged_and_their_ranges_hold() {
    let height = |number: usize| if number.is_multiple_of(20) { 75.0 } else { 15.0 };
    let distance = |number: usize| if number % 40 < 20 { 1.5 } else { 3.25 };
    let place = recording(|number, shot| {
        if number % 10 == 5 || number.is_multiple_of(20) {
            let pulses = [(20.0, 150.0), (20.0 + distance(number), height(number))];
            shot.blocks[0].2 = samples(1000 + number, &pulses);
        }
    });
    let (rows, _) = run(&place, "", "", "");
    let is_mixed = |row: &Row| {
        let shot = number(row, "shot") as usize - 100;
        shot % 10 == 5 || shot.is_multiple_of(20)
    };
    let error_ns = |row: &Row| {
        let place = 0.1 * ((number(row, "shot") as usize - 100) % 7) as f64;
        number(row, "time_of_flight_ns") - (1024.0 + place)
    };
    let (mixed, clean): (Vec<&Row>, Vec<&Row>) = rows.iter().partition(|row| is_mixed(row));
    let flagged = |rows: &[&Row]| rows.iter().filter(|row| flags_of(row) & ECHO_ON_OUTGOING != 0).count();
    assert_eq!((flagged(&mixed), flagged(&clean)), (mixed.len(), 0));
    // Shots share a calibrated constant, estimated from the other shots.
    let constant = clean.iter().map(|row| error_ns(row)).sum::<f64>() / clean.len() as f64;
    let scores = mixed.iter().map(|row| (error_ns(row) - constant) / number(row, "time_of_flight_sd_ns"));
    let z = (scores.map(|score| score * score).sum::<f64>() / mixed.len() as f64).sqrt();
    println!("{} mixed shots: z {z:.2}", mixed.len());
    assert!(mixed.len() == 48 && z < 1.2, "{z}");
}
