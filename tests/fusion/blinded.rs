//! Where the sensitive receiver is blinded: its delay walks with the height of the echo, and echoes share a plateau.

use super::*;

/// The table of returns of a recording, and what was found of the receivers.
fn found(keys: &str) -> (Vec<Row>, InputReport) {
    let folder = tempfile::tempdir().unwrap();
    // The emission is known without an error here, and the clock has none.
    let report = run(keys, Some(""), "timing_error_ns = 0.0", folder.path());
    println!("{:?}", report.channel_fusion);
    (rows(&folder.path().join("returns.csv")), report)
}

/// Errors of ranges, m, and the same over their standard deviations, of returns whose echoes are in `heights_dn`.
fn errors(config: &TwoReceivers, rows: &[Row], heights_dn: [f64; 2]) -> (Vec<f64>, Vec<f64>) {
    let of_row = |row: &Row| {
        let all = truths(config, row.shot);
        let off =
            |&(height_dn, time_ns): &(f64, f64)| (height_dn, row.range_m - 0.5 * SPEED_M_PER_NS * time_ns);
        let (height_dn, error_m) = all.iter().map(off).min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
        let is_asked_for = (heights_dn[0]..heights_dn[1]).contains(&height_dn) && error_m.abs() < 0.3;
        is_asked_for.then_some((error_m, error_m / row.range_sd_m))
    };
    rows.iter().filter_map(of_row).unzip()
}

/// From 210 digitiser steps on the sensitive receiver sees echoes early, by up to 0.2 ns: 30 mm.
#[test]
fn a_walk_by_amplitude_bends_no_range() {
    let keys = "lines = 2\nwalks = true\nheights_dn = [100.0, 1500.0]";
    let config =
        TwoReceivers { lines: 2, walks: true, heights_dn: [100.0, 1500.0], ..TwoReceivers::default() };
    let (rows, report) = found(keys);
    assert_eq!(rows.len(), (config.lines * SHOTS_PER_LINE) as usize, "each echo is one return");
    let walk = &report.channel_fusion.as_ref().unwrap().walk;
    assert!(walk.len() >= 2, "{walk:?}");
    for heights_dn in [[100.0, 210.0], [210.0, 243.0], [243.0, 400.0], [400.0, 800.0], [800.0, 1500.0]] {
        let (errors_m, scores) = errors(&config, &rows, heights_dn);
        let (mean_m, sd_m) = moments(&errors_m);
        println!(
            "{heights_dn:?}: {} errors, mean {:+.2} mm, sd {:.2} mm, score {:.2}",
            errors_m.len(),
            1e3 * mean_m,
            1e3 * sd_m,
            rms(&scores)
        );
        assert!(errors_m.len() > 40 && mean_m.abs() <= 0.003, "{heights_dn:?}: {mean_m}");
        // The few echoes that both receivers see between 210 and 243 tell the walk there in steps: its errors are common.
        let most = if heights_dn[0] == 210.0 { 2.0 } else { 1.2 };
        assert!(rms(&scores) < most, "{heights_dn:?}: {}", rms(&scores));
    }
}

/// Two echoes 6 to 9 ns apart, so strong that the sensitive receiver has one plateau of both: both come back. What errors of
/// the response leave beside them is taken for a return here and there, and is not in their standard deviations.
#[test]
fn echoes_that_share_a_plateau_are_told_apart() {
    let keys = "lines = 2\nshares_plateau = true\nheights_dn = [60.0, 240.0]";
    let config =
        TwoReceivers { lines: 2, shares_plateau: true, heights_dn: [60.0, 240.0], ..TwoReceivers::default() };
    let (rows, _) = found(keys);
    let echoes: usize = (0..config.lines * SHOTS_PER_LINE).map(|shot| truths(&config, shot).len()).sum();
    let (errors_m, scores) = errors(&config, &rows, [900.0, 1e4]);
    let (mean_m, sd_m) = moments(&errors_m);
    println!(
        "{} returns of {echoes} echoes; {} of plateaus, mean {:+.2} mm, sd {:.2} mm, score {:.2}",
        rows.len(),
        errors_m.len(),
        1e3 * mean_m,
        1e3 * sd_m,
        rms(&scores)
    );
    assert!(rows.len() >= echoes && (rows.len() - echoes) * 20 <= echoes, "{} of {echoes}", rows.len());
    assert!(errors_m.len() * 100 >= 99 * (config.lines * SHOTS_PER_LINE) as usize);
    assert!(mean_m.abs() <= 0.005 && sd_m <= 0.01, "{mean_m} {sd_m}");
}
