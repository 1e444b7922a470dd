mod walk;

use std::sync::Arc;

use super::*;
use wavex_line::scan_line::{AmplitudeTable, Blocks, Emission, Frame, InputInfo, Return, ReturnChannel};
use wavex_line::stage::Context;
use wavex_signal::fusion::ChannelFusion;

/// Half the speed of light, m/ns.
const HALF_SPEED: f64 = 0.149896229;

fn emission(direction: [f64; 3]) -> Emission {
    Emission { origin_m: [0.0, 0.0, 1000.0], direction, mta_zone: Some(0), ..Emission::default() }
}

fn found(channel: ReturnChannel, time_of_flight_ns: f64, amplitude_dn: f64) -> Return {
    Return {
        channel,
        time_of_flight_ns,
        time_of_flight_sd_ns: 0.03,
        range_m: HALF_SPEED * time_of_flight_ns,
        range_sd_m: HALF_SPEED * 0.03,
        amplitude_dn,
        amplitude_sd_dn: 0.5,
        peak_dn: amplitude_dn + 2.0,
        peak_sd_dn: 0.5,
        width_ratio: 1.1,
        width_ratio_sd: 0.02,
        fwhm_ns: 4.4,
        thickness_sd_m: 0.0,
        intensity: amplitude_dn,
        intensity_sd: 0.5,
        ..Return::default()
    }
}

/// A line that points straight down, in a projected CRS.
fn line_of(input: InputInfo, returns: Vec<Return>) -> ScanLine {
    let emissions =
        vec![emission([0.0, 0.0, -1.0]); returns.iter().map(|r| r.emission as usize + 1).max().unwrap_or(1)];
    let mut scan_line = ScanLine::of_shots(Arc::new(input), 0, emissions, Blocks::default());
    scan_line.stats.nw = returns.len() as u64;
    scan_line.content = Content::Returns(returns);
    scan_line
}

fn map() -> InputInfo {
    InputInfo { frame: Frame::Map, ..InputInfo::default() }
}

/// Keys that disable all corrections.
fn nothing() -> Correct {
    Correct {
        range_table: TableKey::Own(false),
        amplitude_table: TableKey::Own(false),
        width_correction_low: WidthKey::Without(false),
        width_correction_high: WidthKey::Without(false),
        incidence: Incidence::None,
        reference_range_m: Threshold::Without(false),
        ..Correct::default()
    }
}

/// Runs the stage; returns its lines and notes.
fn run(keys: &Correct, lines: Vec<ScanLine>) -> (Vec<ScanLine>, Vec<String>) {
    let (lines, notes, _) = run_with_findings(keys, lines);
    (lines, notes)
}

/// Runs the stage; returns its lines, notes and findings.
fn run_with_findings(keys: &Correct, lines: Vec<ScanLine>) -> (Vec<ScanLine>, Vec<String>, Vec<String>) {
    let run = RunContext {
        input: PathBuf::new(),
        stem: String::new(),
        input_dir: PathBuf::new(),
        output_dir: PathBuf::new(),
        simd: wavex_simd::SimdLevel::Portable,
        ..RunContext::alone("".as_ref())
    };
    let mut stage = keys.make(&run).unwrap();
    let (mut cx, mut given_on) = (Context::default(), Vec::new());
    let mut emit = |scan_line: ScanLine| {
        given_on.push(scan_line);
        Ok(())
    };
    let mut out = Output::new(&mut cx, usize::MAX, &mut emit);
    lines.into_iter().for_each(|line| stage.process(line, &mut out).unwrap());
    stage.finish(&mut out).unwrap();
    (given_on, cx.counters().warnings().collect(), cx.counters().findings.clone())
}

fn first(lines: &[ScanLine]) -> Return {
    lines[0].returns().unwrap()[0]
}

fn near(a: f64, b: f64) {
    assert!((a - b).abs() <= 1e-9 * b.abs().max(1.0), "{a} is not {b}");
}

#[test]
fn without_any_correction_returns_pass_as_they_are() {
    let before = found(ReturnChannel::Low, 6000.0, 80.0);
    let (lines, notes) = run(&nothing(), vec![line_of(map(), vec![before])]);
    let after = first(&lines);
    assert!(after.amplitude_db.is_nan() && notes.is_empty());
    let known = |r: Return| Return { amplitude_db: 0.0, total_sd_m: 0.0, height_above_ground_m: 0.0, ..r };
    assert_eq!(known(after), known(before));
    let stats = &lines[0].stats;
    assert_eq!((stats.np_range, stats.np_atm, stats.np_ibrc, stats.np_ibic), (0, 0, 0, 0));
}

#[test]
fn the_range_table_moves_the_echo_and_adds_its_slope_to_the_deviation() {
    // 2 ps per digitiser step: 160 ps at background 2 and amplitude 78.
    let range_low = AmplitudeTable::new([(0.0, 0.0), (100.0, 200e-12)]);
    let keys = Correct { range_table: TableKey::Own(true), range_table_fit: false, ..nothing() };
    let input = InputInfo { range_low, ..map() };
    let (lines, notes) = run(&keys, vec![line_of(input, vec![found(ReturnChannel::Low, 6000.0, 78.0)])]);
    let after = first(&lines);
    near(after.time_of_flight_ns, 6000.0 - 0.16);
    near(after.range_m, HALF_SPEED * (6000.0 - 0.16));
    near(after.time_of_flight_sd_ns, 0.03f64.hypot(0.001));
    near(after.range_sd_m, HALF_SPEED * 0.03f64.hypot(0.001));
    assert_eq!((lines[0].stats.np_ibrc, notes.len()), (1, 0));
}

#[test]
fn noisy_range_tables_are_smoothed_by_default() {
    let truth = |dn: f64| 30e-12 * (dn / 20.0).ln();
    let noise = |dn: u32| 10e-12 * f64::from((dn * 7919) % 101) / 50.0 - 10e-12;
    let table = AmplitudeTable::new((9..=220).map(|dn| (f64::from(dn), truth(f64::from(dn)) + noise(dn))));
    let corrected = |range_table_fit: bool| {
        let keys = Correct { range_table: TableKey::Own(true), range_table_fit, ..nothing() };
        let input = InputInfo { range_low: table.clone(), ..map() };
        let returns = (20..200).map(|dn| found(ReturnChannel::Low, 6000.0, f64::from(dn) - 2.0)).collect();
        let (lines, _) = run(&keys, vec![line_of(input, returns)]);
        let error = |r: &Return| (6000.0 - r.time_of_flight_ns - 1e9 * truth(r.peak_dn)).powi(2);
        (lines[0].returns().unwrap().iter().map(error).sum::<f64>() / 180.0).sqrt()
    };
    assert!(corrected(true) < 0.0015 && corrected(false) > 0.004, "{} {}", corrected(true), corrected(false));
}

#[test]
fn warnings_of_fusion_about_tables_are_not_repeated() {
    use wavex_signal::noise::ArNoise;
    use wavex_signal::simulated::channel;
    let low = channel(&ArNoise::new(&[], 0.5).unwrap(), 4.5, 2.0);
    let model = wavex_signal::sensor_model::SensorModel {
        high_power: Some(low.clone()),
        low_power: Some(low),
        ..Default::default()
    };
    let input = InputInfo {
        range_low: AmplitudeTable::new([(0.0, 1e-10), (300.0, 1e-10)]),
        range_high: AmplitudeTable::new([(0.0, 9e-10), (300.0, 12e-10)]),
        ..map()
    };
    let keys = Correct { range_table: TableKey::Own(true), range_table_fit: false, ..nothing() };
    // The low-power receiver is overdriven from 210 DN on, which is 42 DN in the high-power
    // receiver.
    let mut line = line_of(
        input,
        vec![found(ReturnChannel::High, 6000.0, 42.0), found(ReturnChannel::High, 6001.0, 142.0)],
    );
    line.model = Some(Arc::new(model));
    line.fusion = Some(Arc::new(ChannelFusion {
        pairs: 100,
        gain_ratio: 5.0,
        gain_ratio_sd: 0.0,
        delay_ns: 0.8,
        delay_sd_ns: 0.0,
        walk: Vec::new(),
        walk_is_known: false,
    }));
    let (lines, _) = run(&keys, vec![line]);
    let returns = lines[0].returns().unwrap();
    near(returns[0].time_of_flight_ns, 6000.0 - 0.1);
    near(returns[1].time_of_flight_ns, 6001.0 - 0.2);
}

#[test]
fn intensities_follow_their_closed_forms() {
    let table = AmplitudeTable::new(
        (9..=250).map(|dn| (f64::from(dn), 10.0 * ((f64::from(dn) - 2.0) / 7.0).log10())),
    );
    let input = InputInfo { amplitude_low: table, ..map() };
    let keys = Correct {
        amplitude_table: TableKey::Own(true),
        incidence: Incidence::Flat,
        reference_range_m: Threshold::Number(1000.0),
        attenuation_db_per_km: Threshold::Number(0.3),
        ..nothing()
    };
    let mut r = found(ReturnChannel::Low, 1500.0 / HALF_SPEED, 80.0);
    r.range_sd_m = 0.5;
    let mut line = line_of(input, vec![r, Return { emission: 1, ..r }]);
    let angle = 40f64.to_radians();
    line.emissions = vec![emission([0.0, angle.sin(), -angle.cos()]), emission([0.995f64, 0.0, -0.1])];
    let (lines, notes) = run(&keys, vec![line]);
    let after = lines[0].returns().unwrap();
    let factor = 2.25 * 10f64.powf(2.0 * 0.3 * 500.0 / 1e4);
    near(after[0].amplitude_db, 10.0 * (80f64 / 7.0).log10());
    near(after[0].intensity, 80.0 * factor / angle.cos());
    near(after[1].intensity, 80.0 * factor / 0.2);
    let by_range = 80.0 * factor * (2.0 / 1500.0 + 0.6 * std::f64::consts::LN_10 / 1e4) * 0.5;
    let expected = (0.5 * factor).hypot(by_range) / angle.cos();
    assert!((after[0].intensity_sd / expected - 1.0).abs() < 1e-4, "{} {expected}", after[0].intensity_sd);
    let stats = &lines[0].stats;
    assert_eq!((stats.np_range, stats.np_atm, stats.np_ibrc, stats.np_ibic), (2, 2, 0, 2));
    assert_eq!(notes, [""; 0]);
}

#[test]
fn what_is_missing_is_said_once() {
    let keys = Correct { width_correction_low: WidthKey::Without(false), ..Correct::default() };
    let line = || {
        let returns =
            vec![found(ReturnChannel::Low, 6000.0, 80.0), found(ReturnChannel::Joint, 6100.0, 300.0)];
        line_of(InputInfo::default(), returns)
    };
    let (lines, notes, findings) = run_with_findings(&keys, vec![line(), line()]);
    assert_eq!(
        notes,
        [
            "the low power receiver: there is no range table: ranges are not corrected for amplitude; set \
             range_table to a file, or to false if none is wanted",
            "the high power receiver: there is no range table: ranges are not corrected for amplitude; set \
             range_table to a file, or to false if none is wanted",
            "without a trajectory: intensities are not corrected for incidence",
        ]
    );
    let pulse_heights = |of: &str| {
        format!(
            "the {of} power receiver: there is no amplitude table: intensities are pulse heights; set \
             amplitude_table to a file, or to false if none is wanted"
        )
    };
    assert_eq!(findings, ["low", "high"].map(pulse_heights));
    near(first(&lines).intensity, 80.0 * (6000.0 * HALF_SPEED / 1000.0f64).powi(2));
}

#[test]
fn given_widths_change_thickness_and_deviations_with_them() {
    let pairs = vec![[40.0, 1.0], [160.0, 1.21]];
    let keys = Correct { width_correction_low: WidthKey::Pairs(pairs), ..nothing() };
    let high = Return { channel: ReturnChannel::High, ..found(ReturnChannel::Low, 6000.0, 80.0) };
    let (lines, _) = run(&keys, vec![line_of(map(), vec![found(ReturnChannel::Low, 6000.0, 80.0), high])]);
    let after = first(&lines);
    // Half-way between the nodes in the logarithm.
    near(after.width_ratio, 1.1 / 1.1);
    near(after.width_ratio_sd, 0.02 / 1.1);
    near(after.fwhm_ns, 4.0);
    assert!(after.thickness_m < 1e-6, "{}", after.thickness_m);
    near(after.thickness_sd_m, HALF_SPEED * 0.5 * (2.0 * 16.0 * 0.02 / 1.1f64).sqrt());
    assert_eq!(lines[0].returns().unwrap()[1].width_ratio, 1.1, "the other receiver has its own");
    let keys = Correct { width_correction_low: WidthKey::Power(0.5), ..nothing() };
    let (lines, _) = run(&keys, vec![line_of(map(), vec![found(ReturnChannel::Low, 6000.0, 81.0)])]);
    near(first(&lines).width_ratio, 1.1 / 0.9);
}

/// Flat targets, wider by 6 % from 20 to 200 DN, and as many sloped ones.
fn survey_line(line: u32) -> ScanLine {
    let one = |k: u32| {
        let amplitude_dn = 20.0 * 10f64.powf(f64::from(k % 997) / 997.0);
        let widened = if k.is_multiple_of(2) { 1.1 + 0.2 * f64::from(k % 53) / 53.0 } else { 1.0 };
        let flat = 1.0 + 0.06 * (amplitude_dn / 20.0).log10() + 0.01 * (f64::from(k % 31) / 15.0 - 1.0);
        Return {
            emission: k,
            width_ratio: flat * widened,
            width_ratio_sd: 0.01,
            flags: if widened > 1.0 { 4 } else { 0 },
            ..found(ReturnChannel::Low, 6000.0, amplitude_dn)
        }
    };
    let mut scan_line = line_of(map(), (0..2500).map(|k| one(line * 2500 + k)).collect());
    scan_line.line = line;
    scan_line
}

#[test]
fn automatic_widths_make_flat_targets_as_wide_as_the_pulse() {
    let keys = Correct { width_correction_low: WidthKey::Auto(Auto::Auto), ..nothing() };
    let (lines, notes) = run(&keys, (0..8).map(survey_line).collect());
    assert_eq!(notes, [""; 0]);
    assert_eq!(lines.iter().map(|scan_line| scan_line.line).collect::<Vec<_>>(), (0..8).collect::<Vec<_>>());
    let flat = lines.iter().flat_map(|scan_line| scan_line.returns().unwrap()).filter(|r| r.flags == 0);
    let (mut below, mut above) = (0, 0);
    for r in flat {
        assert!((r.width_ratio - 1.0).abs() < 0.017, "{r:?}");
        *(if r.width_ratio < 1.0 { &mut below } else { &mut above }) += 1;
    }
    assert!(below * 2 > above && above * 2 > below, "{below} {above}");

    let (lines, notes) = run(&keys, vec![line_of(map(), vec![found(ReturnChannel::Low, 6000.0, 80.0)])]);
    assert_eq!(first(&lines).width_ratio, 1.1);
    assert_eq!(
        notes,
        ["the low power receiver: widths are not corrected for amplitude: the width of flat targets \
             cannot be estimated from its single returns (1)"]
    );
}

#[test]
fn widths_of_one_half_alone_correct_nothing() {
    let keys = Correct { width_correction_low: WidthKey::Auto(Auto::Auto), ..nothing() };
    // 20 stretches of 2500 returns; the widths of the odd ones fall with the amplitude.
    let mut lines: Vec<ScanLine> = (0..20).map(survey_line).collect();
    for line in lines.iter_mut().skip(1).step_by(2) {
        let Content::Returns(returns) = &mut line.content else { unreachable!() };
        for r in returns {
            r.width_ratio -= 0.12 * (r.amplitude_dn / 20.0).log10();
        }
    }
    let before: Vec<f64> = lines.iter().map(|line| line.returns().unwrap()[7].width_ratio).collect();
    let (lines, _, findings) = run_with_findings(&keys, lines);
    let after: Vec<f64> = lines.iter().map(|line| line.returns().unwrap()[7].width_ratio).collect();
    assert_eq!(before, after);
    let is_refused = findings[0].contains("widths are not corrected for amplitude")
        && (findings[0].contains("is not proven") || findings[0].contains("do not depend"));
    assert!(is_refused, "{findings:?}");
}

#[test]
fn returns_that_pass_one_another_are_numbered_anew() {
    let range_low = AmplitudeTable::new([(0.0, 0.0), (200.0, 4e-9)]);
    let keys = Correct { range_table: TableKey::Own(true), range_table_fit: false, ..nothing() };
    let returns = vec![
        Return { number_of_returns: 2, ..found(ReturnChannel::Low, 6000.0, 10.0) },
        Return { number_of_returns: 2, return_number: 2, ..found(ReturnChannel::Low, 6002.0, 180.0) },
    ];
    let (lines, _) = run(&keys, vec![line_of(InputInfo { range_low, ..map() }, returns)]);
    let after = lines[0].returns().unwrap();
    assert_eq!(
        after.iter().map(|r| (r.return_number, r.amplitude_dn)).collect::<Vec<_>>(),
        [(1, 180.0), (2, 10.0)]
    );
}

/// Changes a key.
type Change = fn(&mut Correct);

#[test]
fn keys_that_cannot_be_used_say_why() {
    let of = |change: Change| {
        let mut keys = Correct::default();
        change(&mut keys);
        keys.check().map_err(|error| (error.key, error.problem))
    };
    let cases: [(Change, &str, &str); 2] = [
        (
            |keys| keys.width_correction_low = WidthKey::Pairs(vec![[5.0, 1.0], [5.0, 1.0]]),
            "width_correction_low",
            "pairs must have ascending amplitudes and width ratios between 0.1 and 10",
        ),
        (
            |keys| keys.width_correction_low = WidthKey::Pairs(Vec::new()),
            "width_correction_low",
            "pairs must have ascending amplitudes and width ratios between 0.1 and 10",
        ),
    ];
    for (change, key, problem) in cases {
        assert_eq!(of(change), Err((key, problem.to_owned())));
    }
    assert_eq!(of(|_| {}), Ok(()));
}

#[test]
fn a_range_table_in_other_units_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("table.txt");
    std::fs::write(&path, "9 0.01\n200 0.05\n").unwrap();
    let rows = LookupTables::open(&path).unwrap();
    let error = Corrections::new(&Correct::default(), Some(rows), None).err().unwrap().to_string();
    assert_eq!(
        error,
        "the range table has 1e-2 s, which is too large for a range correction; give its values in seconds"
    );
}
