//! Real recordings against the results of others. Skipped with a notice unless `WAVEX_DATA` is set.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test fails by panicking and prints its figures"
)]

mod agreement;
mod compressed;
mod footprints;
mod geometry_alone;
mod ground;
mod instruments;
mod lvis;
mod planes;
mod plausible;
mod relative_heights;
mod vendor_free;

use std::path::Path;
use std::sync::OnceLock;

use wavex::engine;
use wavex::scan_line::Channel;
use wavex_signal::calibrate::CalibrationSettings;
use wavex_signal::decompose::DecomposeSettings;
use wavex_signal::outgoing::OutgoingFitter;
use wavex_signal::sensor_model::SensorModel;
use wavex_testkit::data;
use wavex_testkit::recordings::{Table, median, robust, run_job, samples};

use vendor_free::{
    EvenOddScores, Recording, Single, Superposition, left_beside_strong_echoes, tail_statistics,
};

/// Settings that report about the same returns as RIEGL's own program.
const VENDOR_LIKE: [&str; 2] = ["decompose.split_evidence=false", "decompose.template_error=0.0075"];

/// RIEGL's own returns of the Q680i recording, and ours by one reader.
struct Comparison {
    vendor: Table,
    ours: Table,
}

/// One of RIEGL's returns and our nearest return of the same pulse: indices into the tables.
struct Pair {
    vendor: usize,
    ours: usize,
    distance_m: f64,
}

impl Comparison {
    fn of(job: &str, data: &Path) -> Comparison {
        let out = tempfile::tempdir().unwrap();
        run_job(job, data, out.path(), &[]);
        Comparison {
            vendor: Table::read(&data.join("riegl_q680i_dev/riegl_q680i_dev_vendor_returns.csv")),
            ours: Table::read(&out.path().join("riegl_q680i_dev_returns.csv")),
        }
    }

    /// Pairs each of RIEGL's returns selected by `wanted` with our nearest one.
    fn pairs(&self, wanted: impl Fn(usize) -> bool) -> Vec<Pair> {
        let pulse = self.vendor.column("pulse_index");
        let shot = self.ours.column("shot");
        let [theirs, ours] =
            [&self.vendor, &self.ours].map(|table| ["x", "y", "z"].map(|axis| table.column(axis)));
        let distance_m = |i: usize, j: usize| {
            (0..3).map(|axis| (theirs[axis][i] - ours[axis][j]).powi(2)).sum::<f64>().sqrt()
        };
        let nearest = |i: usize| {
            let of_pulse = (0..self.ours.len()).filter(|&j| shot[j] == pulse[i]);
            of_pulse.map(|j| (distance_m(i, j), j)).min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let wanted = (0..self.vendor.len()).filter(|&i| wanted(i));
        let pairs = wanted.map(|i| (i, nearest(i).unwrap_or((f64::INFINITY, usize::MAX))));
        pairs.map(|(vendor, (distance_m, ours))| Pair { vendor, ours, distance_m }).collect()
    }

    fn singles(&self) -> Vec<Pair> {
        let returns = self.vendor.column("number_of_returns");
        self.pairs(|i| returns[i] == 1.0)
    }
}

#[test]
fn single_returns_agree_with_riegl_in_time_amplitude_and_width() {
    let Some(data) = data() else { return };
    let comparison = Comparison::of("q680i_pulsewaves.toml", &data);
    let singles = comparison.singles();
    assert_eq!(singles.len(), 549);
    assert!(singles.iter().all(|pair| pair.distance_m < 0.45), "every single return of RIEGL's is found");
    let [theirs, ours] =
        [comparison.vendor.column("range_units_from_anchor"), comparison.ours.column("time_of_flight_ns")];
    let differences_ps: Vec<f64> =
        singles.iter().map(|pair| 1000.0 * (ours[pair.ours] - theirs[pair.vendor])).collect();
    let (median_ps, sd_ps) = robust(&differences_ps);
    println!(
        "time of flight against RIEGL: median {median_ps:.1} ps, robust standard deviation {sd_ps:.1} ps"
    );
    assert!(median_ps.abs() <= 40.0 && sd_ps <= 20.0, "{median_ps} ps, {sd_ps} ps");

    let difference = |theirs: &str, ours: &str| {
        let [theirs, ours] = [comparison.vendor.column(theirs), comparison.ours.column(ours)];
        robust(&singles.iter().map(|pair| ours[pair.ours] - theirs[pair.vendor]).collect::<Vec<f64>>())
    };
    let (median_db, sd_db) = difference("amplitude_db", "amplitude_db");
    println!("amplitude against RIEGL: median {median_db:.3} dB, robust standard deviation {sd_db:.3} dB");
    assert!(median_db.abs() <= 0.05 && sd_db <= 0.03, "{median_db} dB, {sd_db} dB");
    let (median_ns, sd_ns) = difference("fwhm_ns", "fwhm_ns");
    println!("full width at half maximum: median {median_ns:.3} ns, robust standard deviation {sd_ns:.3} ns");
    assert!(median_ns.abs() <= 0.1 && sd_ns <= 0.15, "{median_ns} ns, {sd_ns} ns");
}

/// The job with the stage `correct` and these keys.
fn corrected(data: &Path, keys: &str) -> (Comparison, engine::InputSummary) {
    let job = Path::new(env!("CARGO_MANIFEST_DIR")).join("jobs/q680i_pulsewaves.toml");
    let stage = format!("[[stage]]\ntype = \"correct\"\n{keys}\n[[stage]]\ntype = \"georeference\"");
    let text = std::fs::read_to_string(job).unwrap();
    let text = text.replace("[[stage]]\ntype = \"georeference\"", &stage);
    let out = tempfile::tempdir().unwrap();
    let report = wavex_testkit::recordings::run("corrected.toml", &text, data, out.path(), &[]);
    let vendor = Table::read(&data.join("riegl_q680i_dev/riegl_q680i_dev_vendor_returns.csv"));
    let ours = Table::read(&out.path().join("riegl_q680i_dev_returns.csv"));
    (Comparison { vendor, ours }, report)
}

#[test]
fn amplitudes_by_the_instruments_tables_are_riegls() {
    let Some(data) = data() else { return };
    let amplitude_db = |comparison: &Comparison| {
        let [theirs, ours] = [&comparison.vendor, &comparison.ours].map(|table| table.column("amplitude_db"));
        let singles = comparison.singles();
        robust(&singles.iter().map(|pair| ours[pair.ours] - theirs[pair.vendor]).collect::<Vec<f64>>())
    };
    let (own, report) = corrected(&data, "");
    let (from_file, _) = corrected(&data, "amplitude_table = \"riegl_q680i_dev/lookup_tables.csv\"");
    for (name, comparison) in [("the recording's tables", &own), ("tables of a file", &from_file)] {
        let (median_db, sd_db) = amplitude_db(comparison);
        println!("{name}: median {median_db:.4} dB (goal 0.05), robust standard deviation {sd_db:.4} dB");
        assert!(median_db.abs() <= 0.05 && sd_db <= 0.03, "{median_db} dB, {sd_db} dB");
    }
    // Numbers in the file are rounded to six digits.
    let [own_intensity, file_intensity] = [&own, &from_file].map(|c| c.ours.column("intensity"));
    let same = own_intensity.iter().zip(&file_intensity).all(|(a, b)| (a / b - 1.0).abs() < 1e-5);
    assert!(same && own_intensity.len() == file_intensity.len());
    let total = |name: &str| report.totals[name];
    assert_eq!([total("np_ibic"), total("np_range")], [total("np"); 2]);
    assert_eq!([total("np_ibrc"), total("np_atm")], [0; 2], "the file has no range table");
    let widths = Comparison::of("q680i_pulsewaves.toml", &data).ours.column("width_ratio");
    let (before, after) = (robust(&widths), robust(&own.ours.column("width_ratio")));
    println!("width ratio before {before:.4?} and after {after:.4?}");
    println!("{:?}", report.stages.iter().find(|stage| stage.r#type == "correct").unwrap().notes);
}

#[test]
fn points_lie_where_riegl_has_them() {
    let Some(data) = data() else { return };
    for job in ["q680i_pulsewaves.toml", "q680i_las.toml"] {
        let comparison = Comparison::of(job, &data);
        let all = comparison.pairs(|_| true);
        assert_eq!(all.len(), 667);
        let distances: Vec<f64> = all.iter().map(|pair| pair.distance_m).collect();
        let found = distances.iter().filter(|distance| **distance < 0.45).count();
        println!("{job}: median distance {:.4} m, {found} of 667 found", median(&distances));
        assert!(median(&distances) <= 0.01, "{job}: {}", median(&distances));
        assert!(found >= 655, "{job}: {found}");
    }
}

#[test]
fn las_keeps_the_crs_and_ties_its_times_to_the_file() {
    let Some(data) = data() else { return };
    let out = tempfile::tempdir().unwrap();
    let report = run_job("q680i_las.toml", &data, out.path(), &[]);
    assert_eq!(report.emission_reference.as_deref(), Some("return_locations"));
    assert_eq!(report.totals["nw"], 607);
    let las = std::fs::read(out.path().join("riegl_q680i_dev.laz")).unwrap();
    let wkt = b"PROJCS[\"UTM_North zone 33\"";
    assert!(las.windows(wkt.len()).any(|window| window == wkt));
}

#[test]
fn the_report_compares_riegls_returns_with_computed_ones() {
    let Some(data) = data() else { return };
    let out = tempfile::tempdir().unwrap();
    let report = run_job("q680i_las.toml", &data, out.path(), &[]);
    let decompose = report.stages.iter().find(|stage| stage.r#type == "decompose").unwrap();
    let of = |name: &str| &decompose.observed[name];
    let (online, computed) = (of("online_matched"), of("computed_matched"));
    println!("RIEGL's {} of {}, computed {} of {}", online.mean, online.count, computed.mean, computed.count);
    assert_eq!((online.count, report.totals["np"]), (667, computed.count));
    assert!(online.mean > 0.99 && computed.mean > 0.94, "{} {}", online.mean, computed.mean);
    let (signed, distance) = (of("online_minus_computed_ns"), of("online_computed_distance_ns"));
    assert!(signed.p50.abs() < 0.01 && distance.p90 < 0.05, "{} {}", signed.p50, distance.p90);
    assert!(
        !decompose.observed.contains_key("online_over_computed_amplitude"),
        "the file has no intensities"
    );
    let report = run_job("q680i_las.toml", &data, out.path(), &["decompose.online_points=only"]);
    assert_eq!((report.totals["np"], report.totals["np_online"]), (667, 667));
}

#[test]
fn a_recording_of_sixteen_thousand_pulses_comes_through_whole() {
    let Some(data) = data() else { return };
    let out = tempfile::tempdir().unwrap();
    let report = run_job("example3.toml", &data, out.path(), &["calibrate.waveforms=2000"]);
    assert_eq!(report.totals["nw"], 16_486);
    assert_eq!(report.totals["nw_deleted"], 0);
    assert_eq!(report.emission_reference.as_deref(), Some("outgoing_pulse_fraction"));
    let velocity_mps = report.group_velocity_mps.unwrap();
    // RIEGL's own value, from the resolution of the durations in the file: 299 713 794 +- 18 m/s.
    assert!((velocity_mps / 299_713_794.0 - 1.0).abs() < 5e-5, "{velocity_mps}");
    let low_power = report.sensor_model.as_deref().unwrap().low_power.clone().unwrap();
    println!("noise {:.3} DN, lag 1 {:.3}", low_power.noise_sd_dn, low_power.autocorrelation[0]);
    assert!((0.80..0.90).contains(&low_power.noise_sd_dn), "{}", low_power.noise_sd_dn);
    assert!((0.57..0.66).contains(&low_power.autocorrelation[0]), "{}", low_power.autocorrelation[0]);
    assert!((4.0..4.4).contains(&low_power.pulse_fwhm_ns), "{}", low_power.pulse_fwhm_ns);
}

#[test]
fn las_and_pulsewaves_give_the_same_low_power_samples() {
    let Some(data) = data() else { return };
    let las = samples("read_las", &data.join("riegl_q680i_dev/riegl_q680i_dev.las"));
    let pulsewaves = samples("read_pulsewaves", &data.join("riegl_q680i_dev/riegl_q680i_dev.pls"));
    assert_eq!(
        (las.len(), pulsewaves.len()),
        (607, 608),
        "one waveform has no return of RIEGL's, so LAS lacks it"
    );
    let mut others = pulsewaves.iter();
    assert!(las.iter().all(|block| others.any(|other| other == block)), "sample for sample, in order");
}

/// Comparison with RIEGL's returns for one setting on the Q680i recording.
fn agreement(data: &Path, set: &[&str]) -> Vec<agreement::Pulse> {
    agreement_in(tempfile::tempdir().unwrap().path(), data, set)
}

fn agreement_in(out: &Path, data: &Path, set: &[&str]) -> Vec<agreement::Pulse> {
    let report = run_job("q680i_pulsewaves.toml", data, out, set);
    let channel = report.sensor_model.as_deref().unwrap().low_power.clone().unwrap();
    let response = channel.response.unwrap();
    println!(
        "{set:?}: response of {} echoes, uncertain by {:.5}, {:.3} ns wide; error factor {:.3}",
        response.echoes, response.shape_sd, channel.pulse_fwhm_ns, channel.pulse_error_factor
    );
    let vendor = Table::read(&data.join("riegl_q680i_dev/riegl_q680i_dev_vendor_returns.csv"));
    let ours = Table::read(&out.join("riegl_q680i_dev_returns.csv"));
    agreement::pulses(&vendor, &ours)
}

/// As fractions of RIEGL's returns: missed, extra, and extra at the position of the receiver's
/// after-pulse.
fn missed_and_extra(pulses: &[agreement::Pulse]) -> [f64; 3] {
    let vendor: usize = pulses.iter().map(|pulse| pulse.vendor.len()).sum();
    let missed = pulses.iter().flat_map(agreement::Pulse::missed).count();
    let extra: usize = pulses.iter().map(|pulse| pulse.extra().count()).sum();
    let behind = |pulse: &agreement::Pulse, extra: &agreement::Echo| {
        let strong = pulse.ours.iter().filter(|other| other.amplitude_dn > 10.0 * extra.amplitude_dn);
        strong.map(|other| extra.time_ns - other.time_ns).any(|lag| (9.5..12.0).contains(&lag))
    };
    let after: usize =
        pulses.iter().map(|pulse| pulse.extra().filter(|extra| behind(pulse, extra)).count()).sum();
    [missed, extra, after].map(|count| count as f64 / vendor as f64)
}

/// As fractions of RIEGL's returns: missed ones that are not after-pulses, and extra ones after
/// overdriving echoes.
///
/// After-pulses are returns of at most 0.6 dB, 7.5 to 14 ns after an echo that is 10 dB stronger.
fn missed_echoes_and_overdriven(pulses: &[agreement::Pulse]) -> [f64; 2] {
    let vendor: usize = pulses.iter().map(|pulse| pulse.vendor.len()).sum();
    let is_after_pulse = |pulse: &agreement::Pulse, echo: &agreement::Echo| {
        let strong = pulse.vendor.iter().filter(|other| other.amplitude_db > echo.amplitude_db + 10.0);
        let behind = strong.map(|other| echo.time_ns - other.time_ns).any(|lag| (7.5..14.0).contains(&lag));
        echo.amplitude_db <= 0.6 && behind
    };
    let missed: usize =
        pulses.iter().map(|pulse| pulse.missed().filter(|echo| !is_after_pulse(pulse, echo)).count()).sum();
    let overdriven =
        pulses.iter().filter(|pulse| pulse.strongest().is_some_and(|echo| echo.amplitude_dn > 210.0));
    [missed, overdriven.map(|pulse| pulse.extra().count()).sum()].map(|count| count as f64 / vendor as f64)
}

#[test]
fn returns_are_riegls_and_few_more() {
    let Some(data) = data() else { return };
    let by_default = agreement(&data, &[]);
    let [missed, overdriven] = missed_echoes_and_overdriven(&by_default);
    println!(
        "missed but for RIEGL's after-pulses {:.2} % (goal 0.2), extra where the receiver is overdriven {:.2} % (goal 0.2)",
        100.0 * missed,
        100.0 * overdriven
    );
    assert!(missed <= 0.002 && overdriven <= 0.002);
    let by_default = missed_and_extra(&by_default);
    let vendor_like = missed_and_extra(&agreement(&data, &VENDOR_LIKE));
    let at_six = [&VENDOR_LIKE[..], &["decompose.detection_sigma=6"]].concat();
    let at_six = missed_and_extra(&agreement(&data, &at_six));
    // Two of the returns that the best fits find are at the lag of the after-pulse; one has 7 % of the echo
    // before it, in addition to the 5 % of the response. Of 34 extra returns, chance puts one or two there.
    let [_, _, by_best_fits] = missed_and_extra(&agreement(&data, &["decompose.mode=slow"]));
    for (name, [missed, extra, after], goal) in [
        ("default", by_default, 5.5),
        ("vendor-like", vendor_like, 3.0),
        ("vendor-like at 6 sd", at_six, 3.0),
    ] {
        println!(
            "{name}: missed {:.2} % (goal 0.7), extra {:.2} % (goal {goal}), at the after-pulse {:.2} % (goal 0.15; mode slow by default {:.2})",
            100.0 * missed,
            100.0 * extra,
            100.0 * after,
            100.0 * by_best_fits
        );
        assert!(missed <= 0.007 && after <= 0.0015f64.max(by_best_fits) && by_best_fits <= 0.003);
    }
    assert!(by_default[1] <= 0.055);
    // The goal of 3 % is not reached at 4.5: the rest are real echoes, see the next test. It is
    // 4.05 % and must not rise.
    assert!(vendor_like[1] <= 0.042 && at_six[1] <= 0.03);
}

/// Errors of response or noise appear at fixed distances from strong echoes. Real echoes appear
/// where neighbouring pulses hit as well: RIEGL's returns of other pulses, which share nothing with
/// this waveform, separate the two cases. Objects hit by other pulses too close to the ground for
/// RIEGL to separate form a line.
#[test]
fn returns_beside_riegls_stand_where_other_pulses_hit() {
    let Some(data) = data() else { return };
    for (name, set) in [("default", &[][..]), ("vendor-like", &VENDOR_LIKE[..])] {
        let pulses = agreement(&data, set);
        let vendor: usize = pulses.iter().map(|pulse| pulse.vendor.len()).sum();
        let extras = agreement::extras(&pulses);
        // 1.5 times the spacing of returns of consecutive pulses.
        let near_m = 0.5;
        let near = |extra: &agreement::Extra| {
            agreement::to_another_pulse_m(&pulses, extra.pulse, extra.place_m) <= near_m
        };
        let chance = agreement::near_by_chance(&pulses, &extras, near_m);
        let line = agreement::on_a_line(&extras.iter().map(|extra| extra.place_m).collect::<Vec<_>>(), 0.1);
        let by_chance = (0..100).map(|seed| {
            agreement::on_a_line(&agreement::placed_by_chance(&pulses, &extras, seed), 0.1).len()
        });
        let mut by_chance: Vec<usize> = by_chance.collect();
        by_chance.sort_unstable();
        println!(
            "{name}: in a line of a hundred such sets placed by chance {} at the median, {} at most; {} sets have as many as {}",
            by_chance[50],
            by_chance[99],
            by_chance.iter().filter(|count| **count >= line.len()).count(),
            line.len()
        );
        assert!(line.len() > by_chance[99]);
        let beside = extras.iter().filter(|extra| near(extra)).count();
        let confirmed = (0..extras.len()).filter(|i| near(&extras[*i]) || line.contains(i)).count();
        println!(
            "{name}: of {} returns beside RIEGL's {beside} lie within {near_m} m of one that RIEGL has of another pulse (as far \
             from any pulse's strongest return {:.1} would), {} in one straight line; either {confirmed}, {:.2} % of RIEGL's \
             returns",
            extras.len(),
            chance * extras.len() as f64,
            line.len(),
            100.0 * confirmed as f64 / vendor as f64
        );
        assert!(beside as f64 >= 4.0 * chance * extras.len() as f64 && confirmed * 4 >= extras.len() * 3);
        // Where there are several echoes, they are close to each other; so are our extra returns.
        let [of_one, of_several] = [true, false].map(|is_one| {
            let of = pulses.iter().filter(|pulse| (pulse.vendor.len() == 1) == is_one);
            of.fold([0; 2], |[extra, count], pulse| [extra + pulse.extra().count(), count + 1])
        });
        println!(
            "{name}: extra returns, and pulses: where it has one {of_one:?}, where it has several {of_several:?}"
        );
        let rate = |[extra, count]: [usize; 2]| extra as f64 / count as f64;
        assert!(rate(of_several) >= 4.0 * rate(of_one));
    }
}

/// A response error causes as many minima as maxima near strong echoes; a missed echo causes no
/// minima. The minima therefore bound the number of extra returns due to response errors.
#[test]
fn few_of_the_returns_beside_riegls_are_errors_of_the_response() {
    let Some(data) = data() else { return };
    let q680i = Recording::of(&data.join("riegl_q680i_dev/riegl_q680i_dev.pls"), 1);
    for (name, recording) in [("Q680i", &q680i), ("example3", example3(&data))] {
        let left = |limit| left_beside_strong_echoes(recording, &DecomposeSettings::default(), limit);
        let [at_5, at_6, at_8] = [5.0, 6.0, 8.0].map(left);
        println!(
            "{name}, {} waveforms, left within 12 ns of echoes of 100-200 DN: maxima and minima beyond 5 sd {at_5:?}, beyond 6 \
             {at_6:?}, beyond 8 {at_8:?}",
            recording.blocks.len()
        );
        assert!(at_6[1] as f64 <= 0.001 * recording.blocks.len() as f64, "{at_6:?}");
    }
}

/// Calibrated on even pulses and scored on odd ones, and vice versa.
#[test]
fn a_model_of_one_half_holds_for_the_other() {
    let Some(data) = data() else { return };
    let recording = data.join("riegl_q680i_dev/riegl_q680i_dev.pls");
    let mut scored = [Vec::new(), Vec::new()];
    for half in 0..2 {
        let of_half = |channel, settings: CalibrationSettings| {
            let blocks = wavex_testkit::recordings::samples_of(channel, "read_pulsewaves", &recording);
            let blocks: Vec<_> =
                blocks.into_iter().filter(|(shot, _)| shot % 2 == half).map(|b| b.1).collect();
            Some(vendor_free::model_of(&blocks, &settings))
        };
        let model = SensorModel {
            low_power: of_half(Channel::LowPower, CalibrationSettings::echoes(1.0, 255.0)),
            reference: of_half(Channel::Reference, CalibrationSettings::reference(1.0, 255.0)),
            ..SensorModel::default()
        };
        let out = tempfile::tempdir().unwrap();
        let path = out.path().join("model.json");
        std::fs::write(&path, serde_json::to_string(&model).unwrap()).unwrap();
        let load = format!("calibrate.load='{}'", path.display());
        for (scored, set) in scored.iter_mut().zip([vec![], VENDOR_LIKE.to_vec()]) {
            let pulses = agreement_in(out.path(), &data, &[&[load.as_str()], &set[..]].concat());
            let other = pulses.into_iter().enumerate().filter(|(shot, _)| *shot as u64 % 2 != half);
            scored.extend(other.map(|(_, pulse)| pulse));
        }
    }
    for (name, pulses) in ["default", "vendor-like"].iter().zip(&scored) {
        let [missed, extra, after] = missed_and_extra(pulses).map(|part| 100.0 * part);
        println!("halves, {name}: missed {missed:.2} %, extra {extra:.2} %, at the after-pulse {after:.2} %");
        assert!(missed <= 0.7 && extra <= 6.0);
    }
    let of_singles: Vec<f64> = scored[0]
        .iter()
        .filter(|pulse| pulse.vendor.len() == 1 && pulse.ours.len() == 1)
        .flat_map(|pulse| {
            pulse.pairs.iter().map(|&(i, j)| 1000.0 * (pulse.ours[j].time_ns - pulse.vendor[i].time_ns))
        })
        .collect();
    println!("halves, single returns: {:.1} ps (goal 20)", agreement::spread(&of_singles));
    assert!(agreement::spread(&of_singles) <= 20.0);
}

#[test]
fn returns_agree_with_riegls_to_their_uncertainty() {
    let Some(data) = data() else { return };
    let pulses = agreement(&data, &[]);
    let pairs: Vec<agreement::VendorReturn> =
        pulses.iter().enumerate().flat_map(|(index, pulse)| pulse.reported(index)).collect();
    let raw: Vec<f64> = pairs.iter().map(|pair| 1000.0 * (pair.ours.time_ns - pair.vendor.time_ns)).collect();
    let left = agreement::without_trend(&pairs, &raw, |pulse| pulse % 10);
    let of = |values: &[f64], wanted: &dyn Fn(&agreement::VendorReturn) -> bool| -> Vec<f64> {
        values.iter().zip(&pairs).filter(|(_, pair)| wanted(pair)).map(|(value, _)| *value).collect()
    };
    let single = |pair: &agreement::VendorReturn| pair.single;
    let (multi, far) = (agreement::VendorReturn::is_multi, agreement::VendorReturn::is_far);
    let far_for_riegl = |pair: &agreement::VendorReturn| multi(pair) && pair.vendor_separation_ns > 12.0;
    let spread = |values: &[f64], wanted: &dyn Fn(&agreement::VendorReturn) -> bool| {
        agreement::spread(&of(values, wanted))
    };
    for (name, wanted, goals) in [
        ("singles", &single as &dyn Fn(&agreement::VendorReturn) -> bool, "20, 15"),
        ("multi", &multi, "60"),
        ("multi, more than 12 ns apart", &far, "25"),
        ("multi, more than 12 ns from others of RIEGL's, but not of ours", &far_for_riegl, "none"),
    ] {
        println!(
            "{name}: {} returns, {:.1} ps, without the trend {:.1} ps (goal {goals})",
            of(&raw, wanted).len(),
            spread(&raw, wanted),
            spread(&left, wanted)
        );
    }
    assert!(spread(&raw, &single) <= 20.0 && spread(&left, &single) <= 15.0);
    assert!(spread(&left, &multi) <= 60.0 && spread(&left, &far) <= 25.0);
    let mut of_other_tenths: Vec<f64> = (0..100)
        .map(|way| {
            let tenth_of = |pulse| agreement::scattered(1000 * way + pulse) % 10;
            spread(&agreement::without_trend(&pairs, &raw, tenth_of), &far)
        })
        .collect();
    of_other_tenths.sort_by(f64::total_cmp);
    println!(
        "more than 12 ns apart, by a hundred other ways to make the tenths: {:.1} to {:.1} ps, median {:.1}, {} above 25",
        of_other_tenths[0],
        of_other_tenths[99],
        of_other_tenths[50],
        of_other_tenths.iter().filter(|ps| **ps > 25.0).count()
    );
    assert!(of_other_tenths[50] <= 25.0);

    let scores: Vec<f64> = left.iter().zip(&pairs).map(|(d, pair)| d / (1000.0 * pair.ours.sd_ns)).collect();
    let coverage = |wanted| {
        let scores = of(&scores, wanted);
        [1.0, 2.0].map(|limit| agreement::share(&scores, |z| z.abs() < limit))
    };
    let ([one, two], of_far) = (coverage(&single), coverage(&far));
    println!(
        "coverage: {one:.3} (goal 0.62-0.76), {two:.3} (goal 0.92-0.98); more than 12 ns apart {of_far:.3?}, all of several \
         {:.3?}",
        coverage(&multi)
    );
    assert!((0.62..=0.76).contains(&one) && (0.92..=0.98).contains(&two));

    let singles: Vec<_> = pairs.iter().filter(|pair| pair.single).collect();
    let db: Vec<f64> = singles.iter().map(|pair| pair.ours.amplitude_db - pair.vendor.amplitude_db).collect();
    let fwhm: Vec<f64> = singles.iter().map(|pair| pair.ours.fwhm_ns - pair.vendor.fwhm_ns).collect();
    let below = singles.iter().filter(|pair| pair.ours.amplitude_dn < 190.0);
    let deviations: Vec<f64> = below.map(|pair| pair.ours.deviation_ratio).collect();
    let near = [
        agreement::share(&db, |d| d.abs() < 0.05),
        agreement::share(&fwhm, |d| d.abs() < 0.15),
        agreement::share(&deviations, |d| d.abs() < 3.0),
    ];
    println!(
        "dB: {:.4} (goal 0.03), {:.3} within 0.05 (goal 0.9); width: {:.3} within 0.15 ns (goal 0.9); deviation ratio: \
         {:.3} (goal 1.1), {:.3} within 3 (goal 0.975)",
        agreement::spread(&db),
        near[0],
        near[1],
        agreement::spread(&deviations),
        near[2]
    );
    assert!(agreement::spread(&db) <= 0.03 && near[0] >= 0.9 && near[1] >= 0.9);
    assert!(agreement::spread(&deviations) <= 1.1 && near[2] >= 0.975);
}

/// RIEGL LMS-Q680: calibrated on every fourth waveform, tested on the others.
fn example3(data: &Path) -> &'static Recording {
    static RECORDING: OnceLock<Recording> = OnceLock::new();
    RECORDING.get_or_init(|| Recording::of(&data.join("pulsewaves/riegl_example3.pls"), 4))
}

/// Pairs per kind: enough to determine a standard deviation to 2 %.
const PAIRS: usize = 1200;

#[test]
fn superposed_echoes_are_separated() {
    let Some(data) = data() else { return };
    let recording = example3(&data);
    let singles = recording.singles();
    let of_heights = |heights: std::ops::Range<f64>| -> Vec<Single<'_>> {
        let flat =
            |s: &Single<'_>| (0.9..1.1).contains(&s.fitted.width_ratio) && s.fitted.deviation_ratio < 3.0;
        let wanted = |s: &&Single<'_>| flat(s) && heights.contains(&s.fitted.amplitude_dn);
        singles.iter().filter(wanted).copied().collect()
    };
    let (strong, weak) = (of_heights(100.0..180.0), of_heights(20.0..60.0));
    println!("superposed: {} echoes of 100-180 DN, {} of 20-60 DN", strong.len(), weak.len());
    let mut superposition = Superposition::new(recording);
    for (name, first, second) in [
        ("strong + strong", &strong, &strong),
        ("strong + weak", &strong, &weak),
        ("weak + strong", &weak, &strong),
    ] {
        for separation_ns in [2.5, 3.0, 3.5, 4.5, 5.5, 6.5, 8.0] {
            let reported = superposition.reported(first, second, separation_ns, PAIRS);
            println!(
                "{name} at {separation_ns} ns: both found {:.1} % (goal 99 from 3.5 ns on), more {:.1} %; bias {:+.0} and \
                 {:+.0} ps, z {:.2} and {:.2} (goal 0.75-1.25)",
                100.0 * reported.both,
                100.0 * reported.more,
                reported.bias_ps[0],
                reported.bias_ps[1],
                reported.z[0],
                reported.z[1]
            );
            if separation_ns >= 3.5 {
                assert!(reported.both >= 0.99 && reported.more <= 0.01);
                assert!(reported.z.iter().all(|z| (0.75..=1.25).contains(z)), "{:?}", reported.z);
            }
        }
    }
}

/// Robust SD of the scores of echoes in this amplitude range; 0.5 % of it is chance.
fn spread_of(scores: &[(f64, f64)], heights: std::ops::Range<f64>) -> f64 {
    let scores: Vec<f64> = scores.iter().filter(|s| heights.contains(&s.0)).map(|s| s.1).collect();
    agreement::spread(&scores)
}

#[test]
fn halves_of_an_echo_have_the_same_position() {
    let Some(data) = data() else { return };
    let recording = example3(&data);
    let scores = EvenOddScores::of(recording, &recording.singles());
    let heights = 40.0..200.0;
    let (on, off) = (spread_of(&scores.on, heights.clone()), spread_of(&scores.off, heights));
    println!(
        "even/odd: z {on:.3} on {} echoes of 40-200 DN (goal 1.2), {off:.3} off them (goal 0.95-1.06); factor of the model {:.3}",
        scores.on.len(),
        recording.model.pulse_error_factor
    );
    for height in [40.0, 80.0, 120.0, 160.0] {
        let heights = height..height + 40.0;
        println!(
            "even/odd, from {height} to {} DN: {:.3} on, {:.3} off",
            height + 40.0,
            spread_of(&scores.on, heights.clone()),
            spread_of(&scores.off, heights)
        );
    }
    assert!(on <= 1.2 && (0.95..=1.06).contains(&off), "{on} {off}");
}

#[test]
fn nothing_is_left_behind_echoes() {
    let Some(data) = data() else { return };
    let recording = example3(&data);
    let statistics = tail_statistics(recording, &recording.singles(), 30.0);
    let mean = statistics.iter().sum::<f64>() / statistics.len() as f64;
    let sd = (statistics.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / statistics.len() as f64).sqrt();
    println!(
        "matched filter from 30 ns after echoes: mean {mean:+.3} (goal 0.1), sd {sd:.3} (goal 0.95-1.05)"
    );
    assert!(mean.abs() <= 0.1 && (0.95..=1.05).contains(&sd), "{mean} {sd}");
}

#[test]
fn points_lie_on_planes_and_waveforms_fit() {
    let Some(data) = data() else { return };
    let out = tempfile::tempdir().unwrap();
    run_job("example3.toml", &data, out.path(), &["calibrate.waveforms=4000"]);
    let returns = Table::read(&out.path().join("riegl_example3_returns.csv"));
    let (shot, deviation) = (returns.column("shot"), returns.column("deviation_ratio"));
    let first: Vec<usize> = (0..returns.len()).filter(|&i| i == 0 || shot[i] != shot[i - 1]).collect();
    let fit = agreement::share(&first.iter().map(|&i| deviation[i]).collect::<Vec<_>>(), |d| d.abs() < 3.0);
    println!("deviation ratio below 3: {:.2} % of {} waveforms (goal 97.5)", 100.0 * fit, first.len());
    assert!(fit >= 0.975, "{fit}");

    let beams = planes::stored_beams(&data.join("pulsewaves/riegl_example3.pls"));
    let residuals = planes::Residuals::of(&returns, &beams);
    println!(
        "plane residual: {:.1} mm (goal 18), smoothest half {:.1}, smoothest tenth {:.1}; with the lengths stored {:.1} mm",
        residuals.all_mm, residuals.half_mm, residuals.tenth_mm, residuals.stored_mm
    );
    assert!(residuals.all_mm <= 18.0 && residuals.all_mm < residuals.stored_mm, "{}", residuals.all_mm);
}

/// NEON, Optech Gemini: pulses of 15 ns, blocks that start on the rise, 250 waveforms.
///
/// With Gaussian pulses, as the R package has them. By default the response is the outgoing pulse,
/// whose peak is not the centre of a Gaussian.
#[test]
fn long_pulses_without_free_samples_come_through_unattended() {
    let Some(data) = data() else { return };
    let folder = data.join("neon");
    let out = tempfile::tempdir().unwrap();
    wavex_testkit::neon::to_container(&folder, &out.path().join("neon.arrow"));
    let job = "[job]\noutput_dir = '.'\n[[stage]]\ntype = 'read_arrow'\npath = 'neon.arrow'\n[[stage]]\ntype = 'calibrate'\nresponse = 'gaussian'\n\
               [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_table'\npath = '*.csv'\n";
    let report = wavex_testkit::recordings::run("neon", job, out.path(), out.path(), &[]);
    let model = report.sensor_model.as_deref().unwrap();
    let (low_power, reference) = (model.low_power.clone().unwrap(), model.reference.clone().unwrap());
    println!(
        "NEON: echoes {:.2} ns wide, level {:.1} +- {:.1} DN, fits leave {:.2} % of the height; outgoing pulses {:.2} ns wide",
        low_power.pulse_fwhm_ns,
        low_power.background_dn[0],
        low_power.background_sd_dn,
        100.0 * low_power.pulse_shape_error,
        reference.pulse_fwhm_ns
    );
    // Emission times of the pulses, to convert positions in the block to times of flight.
    let mut fitter = OutgoingFitter::new(&reference, 64).unwrap();
    let departures: Vec<f64> = wavex_testkit::neon::waveforms(&folder.join("outg_1_250.csv"))
        .iter()
        .map(|samples| fitter.fit(samples).unwrap().position_samples)
        .collect();
    let returns = Table::read(&out.path().join("neon.csv"));
    let [shot, time, dn] = ["shot", "time_of_flight_ns", "amplitude_dn"].map(|name| returns.column(name));
    let theirs = wavex_testkit::neon::rows(&folder.join("decomposition_1_250.csv"));
    let mut differences = Vec::new();
    for (i, departure_ns) in departures.iter().enumerate() {
        let components: Vec<f64> = theirs.iter().filter(|c| c[0] as usize == i + 1).map(|c| c[2]).collect();
        let ours = (0..returns.len()).filter(|&j| shot[j] as usize == i);
        let strongest = ours.max_by(|&a, &b| dn[a].total_cmp(&dn[b])).expect("every waveform has a return");
        if let [place] = components[..] {
            differences.push(time[strongest] + departure_ns - wavex_testkit::neon::START_NS - place);
        }
    }
    let (constant, sd) = robust(&differences);
    let near = agreement::share(&differences, |d| (d - constant).abs() < 0.25);
    println!(
        "NEON: {} returns in {} waveforms; of {} with one component {:.1} % within 0.25 ns of the R package (goal 95) after \
         a constant of {constant:.3} ns, robust {sd:.3} ns",
        returns.len(),
        report.totals["nw"],
        differences.len(),
        100.0 * near
    );
    assert_eq!(report.totals["nw_empty"], 0);
    assert!(differences.len() == 156 && near >= 0.95, "{near}");
}
