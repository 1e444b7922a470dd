//! Real recordings, against what others made of them. Run with `WAVEX_DATA` set; skipped, loudly, without.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    reason = "a test fails by panicking, and tells its figures"
)]

#[path = "common/recordings.rs"]
mod recordings;
#[path = "common/agreement.rs"]
mod agreement;

use std::path::Path;

use recordings::{Table, data, median, robust, run_job};

/// RIEGL's own returns of the Q680i recording, and ours of one route.
struct Comparison {
    vendor: Table,
    ours: Table,
}

/// A return of RIEGL's and the nearest one of ours of the same pulse: indices into the tables.
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

    /// Each of RIEGL's returns that `wanted` names, with the nearest of ours.
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
fn a_recording_of_sixteen_thousand_pulses_comes_through_whole() {
    let Some(data) = data() else { return };
    let out = tempfile::tempdir().unwrap();
    let report = run_job("example3.toml", &data, out.path(), &["calibrate.waveforms=2000"]);
    assert_eq!(report.totals["nw"], 16_486);
    assert_eq!(report.totals["nw_deleted"], 0);
    assert_eq!(report.emission_reference.as_deref(), Some("outgoing_pulse_fraction"));
    let velocity_mps = report.group_velocity_mps.unwrap();
    // RIEGL's own, by the step of the durations in the file: 299 713 794 +- 18 m/s.
    assert!((velocity_mps / 299_713_794.0 - 1.0).abs() < 5e-5, "{velocity_mps}");
    let low_power = report.sensor_model.unwrap().low_power.unwrap();
    println!("noise {:.3} DN, lag 1 {:.3}", low_power.noise_sd_dn, low_power.autocorrelation[0]);
    assert!((0.80..0.90).contains(&low_power.noise_sd_dn), "{}", low_power.noise_sd_dn);
    assert!((0.57..0.66).contains(&low_power.autocorrelation[0]), "{}", low_power.autocorrelation[0]);
    assert!((4.0..4.4).contains(&low_power.pulse_fwhm_ns), "{}", low_power.pulse_fwhm_ns);
}

/// REALDATA's figures for one setting: each beside what is asked for.
fn agreement(data: &Path, set: &[&str]) -> Vec<agreement::Pulse> {
    let out = tempfile::tempdir().unwrap();
    let report = run_job("q680i_pulsewaves.toml", data, out.path(), set);
    let model = report.sensor_model.unwrap();
    for channel in [&model.low_power, &model.reference].into_iter().flatten() {
        println!(
            "model: {} singles, width {:.3} ns, factor {:.3}, response {:?}",
            channel.pulses,
            channel.pulse_fwhm_ns,
            channel.pulse_error_factor,
            channel.response.as_ref().map(|r| (r.echoes, r.nodes.len(), r.shape_sd))
        );
    }
    let vendor = Table::read(&data.join("riegl_q680i_dev/riegl_q680i_dev_vendor_returns.csv"));
    let ours = Table::read(&out.path().join("riegl_q680i_dev_returns.csv"));
    agreement::pulses(&vendor, &ours)
}

#[test]
fn returns_are_riegls_and_few_more() {
    let Some(data) = data() else { return };
    for set in [&[][..], &["decompose.split_evidence=false", "decompose.template_error=0.0075"]] {
        let pulses = agreement(&data, set);
        let vendor: usize = pulses.iter().map(|p| p.vendor.len()).sum();
        let missed: Vec<_> = pulses.iter().flat_map(|p| p.missed()).collect();
        let extra: usize = pulses.iter().map(|p| p.extra().count()).sum();
        println!("{set:?}: {vendor} returns, {} missed, {extra} extra", missed.len());
        for p in &pulses {
            for m in p.missed() { println!("missed {:.2} ns {:.2} dB of {:?}", m.time_ns, m.amplitude_db, p.vendor.iter().map(|v| (v.time_ns - m.time_ns, v.amplitude_db)).collect::<Vec<_>>()); }
            for m in p.extra() { println!("extra {:.1} DN w {:.2} flags {:b} of {:?}", m.amplitude_dn, m.fwhm_ns, m.flags, p.ours.iter().map(|v| (((v.time_ns - m.time_ns)*100.0).round()/100.0, v.amplitude_dn.round())).collect::<Vec<_>>()); }
        }
        let mut single = (vec![], vec![], vec![], vec![], vec![]);
        let mut multi = (vec![], vec![]);
        let mut devs = vec![];
        for p in &pulses {
            for &(i, j) in &p.pairs {
                let (v, o) = (p.vendor[i], p.ours[j]);
                let d = 1000.0 * (o.time_ns - v.time_ns);
                if p.vendor.len() == 1 && p.ours.len() == 1 {
                    single.0.push(o.amplitude_dn);
                    single.1.push(d);
                    single.2.push(o.amplitude_db - v.amplitude_db);
                    single.3.push(o.fwhm_ns - v.fwhm_ns);
                    single.4.push(1000.0 * o.sd_ns);
                    if o.amplitude_dn < 190.0 { devs.push(o.deviation_ratio); }
                } else if p.vendor.len() > 1 {
                    multi.0.push(d);
                    if p.separation_ns(i) > 12.0 { multi.1.push(d); }
                }
            }
        }
        let left = agreement::without_trend(&single.0, &single.1);
        let (bias, _) = robust(&single.1);
        println!("singles {} median {bias:.1} robust {:.1}, without trend {:.1} ps; sd median {:.1}", single.0.len(), agreement::spread(&single.1), agreement::spread(&left), median(&single.4));
        let z: Vec<f64> = left.iter().zip(&single.4).map(|(d, s)| d / s).collect();
        println!("coverage {:.3} {:.3}", agreement::share(&z, |z| z.abs() < 1.0), agreement::share(&z, |z| z.abs() < 2.0));
        println!("multi {} {:.1}; far {} {:.1}", multi.0.len(), agreement::spread(&multi.0), multi.1.len(), agreement::spread(&multi.1));
        println!("dB {:?} within .05 {:.3}", robust(&single.2), agreement::share(&single.2, |d| d.abs() < 0.05));
        println!("fwhm {:?} within .15 {:.3}", robust(&single.3), agreement::share(&single.3, |d| d.abs() < 0.15));
        println!("dev {:?} {:.4} of {}", robust(&devs), agreement::share(&devs, |d| d.abs() < 3.0), devs.len());
        for (lo, hi) in [(0.,60.),(60.,110.),(110.,130.),(130.,145.),(145.,155.),(155.,165.),(165.,175.),(175.,190.),(190.,210.),(210.,260.)] {
            let sel: Vec<f64> = single.0.iter().zip(&single.1).filter(|(a,_)| **a>=lo && **a<hi).map(|x| *x.1).collect();
            if sel.len() > 3 { println!("{lo}-{hi}: {} {:?}", sel.len(), robust(&sel)); }
        }
    }
}
