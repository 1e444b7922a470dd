//! Corrections of samples and times, and the threshold of last returns.

use std::collections::BTreeMap;

use wavex_formats::container::EmissionReference;
use wavex_testkit::container::{Shot, of_shots};
use wavex_testkit::{Outcome, TestFolder, shots};

use super::{INTERVAL_NS, LOW, SHOTS, of_shot, recording, run, samples, samples_at};
use wavex_testkit::table::{self, Row, number};

#[test]
fn the_last_of_several_returns_may_have_its_own_threshold() {
    let place = recording(|number, shot| match number {
        10 => shot.blocks[1].2 = samples(number, &[(14.0, 120.0), (36.0, 9.0)]),
        11 => shot.blocks[1].2 = samples(number, &[(14.0, 9.0), (36.0, 120.0)]),
        12 => shot.blocks[1].2 = samples(number, &[(24.0, 9.0)]),
        _ => {}
    });
    let counts = |keys: &str| {
        let (rows, totals) = run(&place, "", "", keys);
        ([10, 11, 12].map(|shot| of_shot(&rows, shot).len()), totals["np_filtered"].as_u64().unwrap())
    };
    let (without, filtered) = counts("");
    assert_eq!(without, [2, 2, 1]);
    let (with, more_filtered) = counts("detection_sigma_last = 30");
    assert_eq!(with, [1, 2, 1], "only the last of several returns is affected");
    assert_eq!(more_filtered, filtered + 1);
}

/// Mean error of `time_of_flight_ns` and its SD, for echoes at 24 + 0.1 (shot % 7).
fn bias_ns(rows: &[Row]) -> (f64, f64) {
    let error = |row: &Row| {
        let place = 0.1 * ((number(row, "shot") as usize - 100) % 7) as f64;
        number(row, "time_of_flight_ns") - (1024.0 + place)
    };
    let errors: Vec<f64> = rows.iter().map(error).filter(|error| error.abs() < 1.0).collect();
    assert!(errors.len() > SHOTS / 2);
    let n = errors.len() as f64;
    let mean = errors.iter().sum::<f64>() / n;
    let variance = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (mean, (variance / n).sqrt())
}

/// Odd samples are taken 0.1 samples late. The bias appears only in the echo digitiser, because the
/// outgoing pulse is omitted and times count from the clock.
#[test]
fn odd_samples_that_come_late_bias_no_range() {
    let late = |k: usize| k as f64 + if k % 2 == 1 { 0.1 } else { 0.0 };
    let shot = |number: usize| Shot {
        clock_ps: (number as f64 * INTERVAL_NS * 1000.0) as i64,
        blocks: vec![(LOW, 1000.0, samples_at(number, &[(24.0 + 0.1 * (number % 7) as f64, 120.0)], late))],
    };
    let all: Vec<Shot> = (0..SHOTS).map(shot).collect();
    let place = TestFolder::with(&[("a.arrow", &of_shots(&all, EmissionReference::Clock, true))]);
    let (without, _) = run(&place, "", "response = 'gaussian'", "");
    let (bias, sd) = bias_ns(&without);
    assert!((bias + 0.05).abs() < 4.0 * sd, "half of the shift: {bias} {sd}");
    let (with, _) = run(&place, "odd_sample_shift = 0.1", "response = 'gaussian'", "");
    let (bias, sd) = bias_ns(&with);
    assert!(bias.abs() < 4.0 * sd && sd < 0.004, "{bias} {sd}");

    // With a response calibrated on the recording itself, time zero is the peak of the response.
    let (with, _) = run(&place, "odd_sample_shift = 0.1", "save = 'model.json'", "");
    let (bias, sd) = bias_ns(&with);
    assert!(bias.abs() < 0.01 + 4.0 * sd, "{bias} {sd}");
    let model: serde_json::Value = serde_json::from_str(&place.text("out/model.json")).unwrap();
    assert_eq!(model["low_power"]["digitiser"]["odd_sample_shift"], 0.1);
}

/// A flight whose digitisers take odd samples 0.2 samples late.
///
/// With the key, errors of ranges have mean 0 and their standard deviations. Without it, the misfit
/// raises the standard deviations.
#[test]
fn ranges_from_late_odd_samples_have_their_standard_deviations() {
    let place = TestFolder::new();
    let flight = "[[stage]]\ntype = 'simulate'\ntruth = '*.truth.csv'\nlines = 3\nshots_per_line = 700\n\
                  odd_sample_shift = 0.2\nresponse = 'gaussian'\nbackground_dn = [20.18, 20.41]\n\
                  ground_amplitude_dn = 60\nbuilding_height_m = 0\ncanopy_height_m = 0\n\
                  [[stage]]\ntype = 'write_arrow'\npath = '*.arrow'\n";
    assert_eq!(place.run(flight), Outcome::success());
    let truth = table::rows(&place.text("out/simulated.truth.csv"));
    let truth: BTreeMap<&str, &Row> = truth.iter().map(|row| (row["shot"].as_str(), row)).collect();
    let measure = |key: &str| {
        let job = format!(
            "[[stage]]\ntype = 'read_arrow'\npath = 'out/simulated.arrow'\n{key}\n[[stage]]\n\
             type = 'calibrate'\nresponse = 'gaussian'\n[[stage]]\ntype = 'decompose'\n[[stage]]\n\
             type = 'write_table'\npath = '*.csv'\n"
        );
        assert_eq!(place.run(&job), Outcome::success());
        let rows = table::rows(&place.text("out/simulated.csv"));
        let singles = rows.iter().filter(|row| row["number_of_returns"] == "1");
        let errors = singles.map(|row| {
            let true_ns = number(truth[row["shot"].as_str()], "time_of_flight_ns");
            let error_ns = number(row, "time_of_flight_ns") - true_ns;
            [error_ns / number(row, "time_of_flight_sd_ns"), number(row, "deviation_ratio")]
        });
        let errors: Vec<[f64; 2]> = errors.collect();
        let n = errors.len() as f64;
        let mean = |of: fn(&[f64; 2]) -> f64| errors.iter().map(of).sum::<f64>() / n;
        let [bias, rms, deviation] = [mean(|of| of[0]), mean(|of| of[0] * of[0]).sqrt(), mean(|of| of[1])];
        println!("{key}: {n} returns, z {bias:.3} and {rms:.3}, deviation ratio {deviation:.2}");
        (n, bias, rms, deviation)
    };
    let (n, bias, rms, deviation) = measure("odd_sample_shift = 0.2");
    assert!(n > 1900.0 && bias.abs() < 4.0 / n.sqrt() && (rms - 1.0).abs() < 0.07 && deviation.abs() < 0.3);
    let (_, _, rms, deviation) = measure("");
    assert!((rms - 1.0).abs() > 0.2 && deviation > 3.0);
}

/// Points of LAS move along their beams by the added time of flight.
#[test]
fn a_time_offset_moves_points_along_their_beams() {
    let las = wavex_testkit::las::Las::new(SHOTS);
    let place = TestFolder::with(&[("a.las", &las.las()), ("a.wdp", &las.packets)]);
    let mut found = Vec::new();
    for offset in ["", "range_time_offset_ns = 10.0\n"] {
        let stages = format!("{offset}{}", wavex_testkit::TO_TABLE);
        place.succeeds("read_las", "a.las", &stages);
        let text = place.text("out/a.csv");
        let mut rows = text.lines().map(|row| row.split(',').map(str::to_owned).collect::<Vec<_>>());
        let names = rows.next().unwrap();
        let columns = ["range_m", "x", "y", "z"].map(|name| names.iter().position(|n| n == name).unwrap());
        found.push(rows.map(|row| columns.map(|at| row[at].parse::<f64>().unwrap())).collect::<Vec<_>>());
    }
    let [as_is, moved] = &found[..] else { panic!("two runs") };
    assert!(as_is.len() >= SHOTS && as_is.len() == moved.len());
    let expected_m = 10.0 * shots::METRES_PER_NS;
    for (as_is, moved) in as_is.iter().zip(moved) {
        let farther_m = moved[0] - as_is[0];
        let step_m = (1..4).map(|axis| (moved[axis] - as_is[axis]).powi(2)).sum::<f64>().sqrt();
        assert!(
            (farther_m - expected_m).abs() < 1e-5 && (step_m - expected_m).abs() < 1e-3,
            "{farther_m} {step_m}"
        );
    }
}

/// Every echo has an exponential tail of 40 % of its area. After its removal, no return is found in
/// it, and widths and amplitudes are those of the echoes.
#[test]
fn a_given_tail_is_taken_off_before_everything_else() {
    let (amplitude, time_ns) = (0.4, 12.0);
    let with_tail = |number: usize| {
        let clean = samples(number, &[(16.0, 120.0)]);
        let kept = f64::exp(-1.0 / time_ns);
        let mut tail = 0.0;
        let digitised = clean.iter().map(|&sample| {
            let seen = f64::from(sample) + tail;
            tail = kept * tail + amplitude * (1.0 - kept) * (f64::from(sample) - 3.0);
            seen.round().clamp(0.0, 255.0) as u16
        });
        digitised.collect::<Vec<u16>>()
    };
    let shot = |number: usize| Shot {
        clock_ps: (number as f64 * INTERVAL_NS * 1000.0) as i64,
        blocks: vec![(LOW, 1000.0, with_tail(number))],
    };
    let all: Vec<Shot> = (0..SHOTS).map(shot).collect();
    let place = TestFolder::with(&[("a.arrow", &of_shots(&all, EmissionReference::Clock, true))]);
    let gaussian = "response = 'gaussian'";
    let (without, _) = run(&place, "", gaussian, "");
    let keys = format!("{gaussian}\ndecay_amplitude = {amplitude}\ndecay_time_ns = {time_ns}");
    let (with, _) = run(&place, "", &keys, "");
    assert!(without.len() > SHOTS * 5 / 4, "a Gaussian takes the tail for returns: {}", without.len());
    assert_eq!(with.len(), SHOTS);
    let mean = |column: &str| with.iter().map(|row| number(row, column)).sum::<f64>() / with.len() as f64;
    assert!((mean("amplitude_dn") - 120.0).abs() < 0.5, "{}", mean("amplitude_dn"));
    assert!((mean("time_of_flight_ns") - 1016.0).abs() < 0.01, "{}", mean("time_of_flight_ns"));
    assert!((mean("fwhm_ns") - 4.5).abs() < 0.05, "{}", mean("fwhm_ns"));
}
