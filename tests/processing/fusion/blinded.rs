//! Saturated sensitive receiver: its delay depends on amplitude, and echoes share a plateau.

use super::*;
use wavex_signal::sensor_model::ChannelModel;

/// Table of returns of a recording, and the report.
fn found(keys: &str) -> (Vec<Row>, InputSummary) {
    let folder = tempfile::tempdir().unwrap();
    // Here the emission time has no error, and neither has the clock.
    let report = run(keys, Some(""), "timing_error_ns = 0.0", folder.path());
    println!("{:?}", report.channel_fusion);
    (rows(&folder.path().join("returns.csv")), report)
}

/// Range errors, m, and errors normalised by their SD, of returns whose echoes have amplitudes in
/// `heights_dn`.
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

/// From 210 DN on, the sensitive receiver sees echoes early by up to 0.2 ns (30 mm).
#[test]
fn a_walk_by_amplitude_bends_no_range() {
    let keys = "lines = 2\nwalks = true\nheights_dn = [100.0, 1500.0]";
    let config =
        TwoReceivers { lines: 2, walks: true, heights_dn: [100.0, 1500.0], ..TwoReceivers::default() };
    let (rows, report) = found(keys);
    assert_few_more(&rows, (config.lines * SHOTS_PER_LINE) as usize, 1000);
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
        // Only few echoes between 210 and 243 DN are seen by both receivers; they determine the
        // walk in steps, whose errors are common to all returns.
        let most = if heights_dn[0] == 210.0 { 2.0 } else { 1.2 };
        assert!(rms(&scores) < most, "{heights_dn:?}: {}", rms(&scores));
    }
}

/// Results for a recording with pairs of echoes.
///
/// Every second shot has two echoes 6 to 9 ns apart, strong enough to share one plateau in the
/// sensitive receiver; the others have one echo with an amplitude in `heights_dn`. Returns also the
/// counts of shots, returns and echoes.
fn found_of_plateaus(seed: u64, heights_dn: [f64; 2]) -> (TwoReceivers, Vec<Row>, usize, InputSummary) {
    let keys = format!("lines = 2\nseed = {seed}\nshares_plateau = true\nheights_dn = {heights_dn:?}");
    let config = TwoReceivers { lines: 2, seed, shares_plateau: true, heights_dn, ..TwoReceivers::default() };
    let (rows, report) = found(&keys);
    let echoes: usize = (0..config.lines * SHOTS_PER_LINE).map(|shot| truths(&config, shot).len()).sum();
    println!("seed {seed}: {} returns of {echoes} echoes", rows.len());
    (config, rows, echoes, report)
}

/// Both echoes are found, with almost no false returns.
#[test]
fn echoes_on_one_plateau_are_separated() {
    for seed in 1..=2 {
        let (config, rows, echoes, _) = found_of_plateaus(seed, [60.0, 2400.0]);
        let (errors_m, scores) = errors(&config, &rows, [900.0, 1e4]);
        let (mean_m, sd_m) = moments(&errors_m);
        let far = errors_m.iter().filter(|error_m| error_m.abs() > 0.01).count();
        println!(
            "{} of plateaus, mean {:+.2} mm, sd {:.2} mm, {far} off by more than 10 mm, score {:.2}",
            errors_m.len(),
            1e3 * mean_m,
            1e3 * sd_m,
            rms(&scores)
        );
        assert_few_more(&rows, echoes, 100);
        assert!(errors_m.len() * 100 >= 99 * (config.lines * SHOTS_PER_LINE) as usize);
        // A few strong echoes are reported as two, with SDs of decimetres.
        assert!(mean_m.abs() <= 0.005 && far * 100 <= errors_m.len() && rms(&scores) < 1.5, "{mean_m} {far}");
    }
}

/// A receiver with too few single echoes uses the response of the other one, including its
/// after-pulse.
#[test]
fn a_receiver_without_single_echoes_has_the_response_of_the_other() {
    // In the first scene single echoes are weak, so the high-power receiver sees only pairs; in the
    // second they are strong.
    for (seed, heights_dn) in [(1, [60.0, 240.0]), (2, [60.0, 240.0]), (9, [60.0, 2400.0])] {
        let (_, rows, echoes, report) = found_of_plateaus(seed, heights_dn);
        let model = report.sensor_model.as_deref().unwrap();
        let of_echoes =
            |model: &Option<ChannelModel>| model.as_ref().unwrap().response.as_ref().unwrap().echoes;
        let borrowed = [&model.low_power, &model.high_power].map(|model| of_echoes(model) == 0);
        assert_eq!(borrowed, [heights_dn[1] > 1000.0, heights_dn[1] < 1000.0]);
        assert_few_more(&rows, echoes, 100);
        let mut notes = report.stages.iter().flat_map(|stage| &stage.notes);
        assert!(notes.any(|note| note.contains("the system response of the other receiver")));
    }
}

/// Sixteen strong echoes in 2000 shots: too few to calibrate or to fuse the receiver that records them.
///
/// Alone, the sensitive receiver sees them early by 80 to 200 ps (12 to 30 mm). With gain and delay of
/// another recording, the other receiver's blocks are used, which are accurate to 10 mm here.
#[test]
fn few_strong_echoes_are_true_to_their_standard_deviations() {
    let keys = "lines = 4\nwalks = true\nfew_strong = true\nheights_dn = [226.0, 289.0]";
    let config = TwoReceivers {
        lines: 4,
        walks: true,
        few_strong: true,
        heights_dn: [226.0, 289.0],
        ..TwoReceivers::default()
    };
    for (given, is_given) in [("", false), ("gain_ratio = 10.0\ndelay_ns = 0.52", true)] {
        let folder = tempfile::tempdir().unwrap();
        let report = run(keys, Some(given), "timing_error_ns = 0.0", folder.path());
        let notes: Vec<&String> = report.stages.iter().flat_map(|stage| &stage.notes).collect();
        println!("{notes:#?}");
        let rows = rows(&folder.path().join("returns.csv"));
        let (errors_m, scores) = errors(&config, &rows, [226.0, 1e4]);
        let (weak_m, weak_scores) = errors(&config, &rows, [30.0, 180.0]);
        let strong: Vec<&Row> = rows.iter().filter(|row| row.shot % 128 == 0).collect();
        let sd_mm = 1e3 * rms(&strong.iter().map(|row| row.range_sd_m).collect::<Vec<f64>>());
        println!(
            "given {is_given}: {} strong, mean {:+.1} mm, sd stated {sd_mm:.1} mm, score {:.2}; weak score {:.2}",
            errors_m.len(),
            1e3 * moments(&errors_m).0,
            rms(&scores),
            rms(&weak_scores)
        );
        let expected_mm = if is_given { 12.6 } else { 20.4 };
        assert_eq!(strong.len(), 16);
        assert!((sd_mm / expected_mm - 1.0_f64).abs() < 0.1, "{sd_mm} mm");
        assert!((0.95..1.05).contains(&rms(&weak_scores)) && weak_m.len() > 1900);
        if is_given {
            assert!(strong.iter().all(|row| row.channel == "joint"));
            assert!(moments(&errors_m).0.abs() < 0.016 && rms(&scores) < 1.5);
            assert!(notes.iter().any(|note| note.contains("too few to calibrate")));
        } else {
            assert!(strong.iter().all(|row| row.channel == "low"));
            assert!((0.5..1.5).contains(&rms(&scores)));
        }
    }
}
