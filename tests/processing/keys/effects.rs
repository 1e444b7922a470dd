//! Effects on returns of `emission_jitter_ns` and the keys of `-t_err`, `-bge`, `-min_width` and
//! `-max_width`.

use super::{INTERVAL_NS, LOW, SHOTS, of_shot, recording, run, samples};
use wavex::scan_line::flags::UNUSUAL;
use wavex_formats::container::{ContainerHeader, ContainerShot, EmissionReference, TimeScale};
use wavex_testkit::container::{self, Shot, of_shots};
use wavex_testkit::table::{Row, number};
use wavex_testkit::{TestFolder, shots};

/// Samples of an echo at sample 24, with its FWHM relative to that of the others.
fn wider(shot: usize, ratio: f64) -> Vec<u16> {
    let noise = shots::waveform(shot, 1e6, 0.0);
    let signal = |k: usize| {
        let x = (k as f64 - 24.0) / (ratio * 4.5 / 2.354_82);
        120.0 * f64::exp(-0.5 * x * x)
    };
    noise.iter().enumerate().map(|(k, &n)| (f64::from(n) + signal(k)).round() as u16).collect()
}

/// The timing error is added to the variance of every time and changes nothing else.
#[test]
fn a_timing_error_widens_the_deviation_of_every_range() {
    let place = recording(|_, _| {});
    let of = |error_ns: f64| run(&place, "", "", &format!("timing_error_ns = {error_ns}")).0;
    let (without, with) = (of(0.0), of(0.5));
    assert!(without.len() >= SHOTS && without.len() == with.len());
    for (a, b) in without.iter().zip(&with) {
        let [time, range, range_sd] =
            ["time_of_flight_sd_ns", "range_m", "range_sd_m"].map(|name| [number(a, name), number(b, name)]);
        let added_ns2 = time[1].powi(2) - time[0].powi(2);
        assert!((added_ns2 - 0.25).abs() < 1e-3 * 0.25, "{a:?} {b:?}");
        let metres_per_ns = range_sd[1] / time[1];
        assert!((metres_per_ns - shots::METRES_PER_NS).abs() < 1e-3 * metres_per_ns, "{b:?}");
        assert_eq!(range[0], range[1]);
        assert_eq!((&a["amplitude_sd_dn"], &a["width_ratio"]), (&b["amplitude_sd_dn"], &b["width_ratio"]));
    }
}

/// Every eighth waveform is raised by 2 DN; only a background per waveform corrects its echo.
#[test]
fn a_background_per_waveform_keeps_its_level_out_of_the_amplitude() {
    const RAISED_DN: u16 = 2;
    let place = recording(|number, shot| {
        if number.is_multiple_of(8) {
            shot.blocks[1].2.iter_mut().for_each(|sample| *sample += RAISED_DN);
        }
    });
    let raised_by_dn = |background: &str| {
        let (rows, _) = run(&place, "", &format!("background = '{background}'"), "");
        let is_raised = |row: &&Row| (number(row, "shot") as usize - 100).is_multiple_of(8);
        let mean = |rows: Vec<&Row>| {
            rows.iter().map(|row| number(row, "amplitude_dn")).sum::<f64>() / rows.len() as f64
        };
        // Each shot has one echo of 120 DN; spurious returns of a raised level are ignored.
        let strong: Vec<&Row> = rows.iter().filter(|row| number(row, "amplitude_dn") > 60.0).collect();
        assert_eq!(strong.len(), SHOTS, "{background}");
        let (raised, others): (Vec<&Row>, Vec<&Row>) = strong.into_iter().partition(is_raised);
        mean(raised) - mean(others)
    };
    let (fixed, own) = (raised_by_dn("fixed"), raised_by_dn("per_waveform"));
    println!(
        "amplitudes of raised waveforms are {fixed:.2} DN higher, and {own:.2} DN with a background of their own"
    );
    // With noise of 1 DN, the mean of 40 amplitudes has an SD of about 0.1 DN.
    assert!(fixed > 1.0 && own.abs() < 0.4, "{fixed} {own}");
}

/// Clear echoes outside the range of widths are kept and flagged.
#[test]
fn clear_returns_beyond_the_range_of_widths_are_flagged() {
    let place = recording(|number, shot| match number {
        20 => shot.blocks[1] = (LOW, 1000.0, wider(number, 2.0)),
        30 => shot.blocks[1] = (LOW, 1000.0, wider(number, 0.6)),
        _ => {}
    });
    let found = |keys: &str| {
        let (rows, totals) = run(&place, "", "", &format!("split_evidence = false\n{keys}"));
        let is_unusual = |row: &&Row| number(row, "flags") as u16 & UNUSUAL != 0;
        let unusual = |shot: usize| of_shot(&rows, shot).iter().map(is_unusual).collect::<Vec<_>>();
        ([20, 30, 40].map(unusual), totals["np_filtered"].as_u64().unwrap())
    };
    let expected = |unusual: [bool; 3]| (unusual.map(|unusual| vec![unusual]), 0);
    assert_eq!(found("width_ratio = [0.1, 10.0]"), expected([false, false, false]));
    assert_eq!(found("width_ratio = [0.1, 1.5]"), expected([true, false, false]));
    assert_eq!(found("width_ratio = [0.8, 10.0]"), expected([false, true, false]));
}

#[test]
fn the_jitter_of_the_clock_replaces_that_of_a_sample() {
    let shot = |number: usize| Shot {
        clock_ps: (number as f64 * INTERVAL_NS * 1000.0) as i64,
        blocks: vec![(LOW, 1000.0, samples(number, &[(24.0, 120.0)]))],
    };
    let all: Vec<Shot> = (0..SHOTS).map(shot).collect();
    let place = TestFolder::with(&[("a.arrow", &of_shots(&all, EmissionReference::Clock, true))]);
    let sds_ns = |keys: &str| -> Vec<f64> {
        let (rows, _) = run(&place, "", "", keys);
        rows.iter().map(|row| row["time_of_flight_sd_ns"].parse().unwrap()).collect()
    };
    let (of_a_sample, exact, known) =
        (sds_ns(""), sds_ns("emission_jitter_ns = 0.0"), sds_ns("emission_jitter_ns = 0.2"));
    assert!(exact.len() >= SHOTS);
    for ((of_a_sample, exact), known) in of_a_sample.iter().zip(&exact).zip(&known) {
        assert!((of_a_sample.powi(2) - exact.powi(2) - 1.0 / 12.0).abs() < 1e-6, "{of_a_sample} {exact}");
        assert!((known.powi(2) - exact.powi(2) - 0.04).abs() < 1e-6, "{known} {exact}");
        assert!(*exact < 0.1, "{exact}");
    }
}

/// A clock that the reader proved better, and an uncertain choice of the reference, as a container says.
#[test]
fn deviations_include_the_proven_clock_and_the_choice_of_the_reference() {
    let header = |clock_sd_ns, emission_choice_sd_ns| ContainerHeader {
        time_scale: TimeScale::Week,
        full_scale_dn: Some(255),
        emission_reference: Some(EmissionReference::Clock),
        clock_sd_ns,
        emission_choice_sd_ns,
        ..ContainerHeader::new(1.0, 299_707_502.0)
    };
    let row = |number: usize| container::Row {
        shot: ContainerShot {
            gps_time_s: Some(number as f64 * INTERVAL_NS * 1e-9),
            ..container::nadir_shot(number as u64, (number as f64 * INTERVAL_NS * 1000.0) as i64)
        },
        blocks: vec![(LOW, 1000.0, samples(number, &[(24.0, 120.0)]))],
    };
    let rows: Vec<container::Row> = (0..SHOTS).map(row).collect();
    let sds_ns = |clock_sd_ns, choice_sd_ns, keys: &str| -> Vec<f64> {
        let bytes = container::container(&header(clock_sd_ns, choice_sd_ns), std::slice::from_ref(&rows));
        let (rows, _) = run(&TestFolder::with(&[("a.arrow", &bytes)]), "", "", keys);
        rows.iter().map(|row| row["time_of_flight_sd_ns"].parse().unwrap()).collect()
    };
    let exact = sds_ns(None, None, "emission_jitter_ns = 0.0");
    let added_ns = |sds_ns: Vec<f64>| -> f64 {
        let added = sds_ns.iter().zip(&exact).map(|(sd_ns, exact)| sd_ns * sd_ns - exact * exact);
        (added.sum::<f64>() / exact.len() as f64).sqrt()
    };
    let within_a_sample_ns = 1.0 / 12f64.sqrt();
    for (found, expected) in [
        (added_ns(sds_ns(Some(0.1), None, "")), 0.1),
        (added_ns(sds_ns(Some(9999.0), None, "")), within_a_sample_ns),
        (added_ns(sds_ns(Some(0.1), None, "emission_jitter_ns = 0.2")), 0.2),
        (added_ns(sds_ns(Some(0.1), Some(0.5), "")), 0.1f64.hypot(0.5)),
        (added_ns(sds_ns(None, Some(0.5), "emission_jitter_ns = 0.0")), 0.5),
    ] {
        assert!((found - expected).abs() < 1e-4, "{found} ns, {expected} ns");
    }
}
