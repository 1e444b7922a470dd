//! Automatic gain control: results do not depend on the gain of the recorded blocks.

use std::collections::BTreeMap;

use wavex_formats::container::{ContainerHeader, GainControl};
use wavex_testkit::container::{self, container, nadir_shot};
use wavex_testkit::las::{HEADER, Las, descriptor, vlr};
use wavex_testkit::table::{self, number, rows};
use wavex_testkit::{Outcome, TestFolder, notes};

/// Level ground; no echo overdrives the receiver at gain 4, and noise never clips at 0.
const FLIGHT: &str = "\
[[stage]]
type = 'simulate'
truth = '*.truth.csv'
shots_per_line = 1000
background_dn = [20.18, 20.41]
ground_amplitude_dn = 40
building_height_m = 0
canopy_height_m = 0
";
/// Gain from 0.5 to 4 and back, 20 times per second.
const GAINS: &str = "gain_range = [0.5, 4.0]\ngain_period_s = 0.05\n";
const TABLE: &str = "[[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_table'\npath = '*.csv'\n";

/// A single true return and the only return found for its shot.
#[derive(Clone, Copy)]
struct Pair {
    gain: f64,
    range_z: f64,
    amplitude_z: f64,
    intensity_error: f64,
    deviation_ratio: f64,
}

/// Results of a run.
struct Found {
    pairs: Vec<Pair>,
    /// Returns beyond the true ones.
    false_returns: usize,
    shots: usize,
}

/// Runs a flight and compares the results with its truth.
fn fly(lines: u32, keys: &str, between: &str, decompose: &str) -> Found {
    let place = TestFolder::new();
    let stages = format!(
        "{FLIGHT}lines = {lines}\n{keys}{between}[[stage]]\ntype = 'calibrate'\n[[stage]]\ntype = 'decompose'\n{decompose}{TABLE}"
    );
    assert_eq!(place.run(&stages), Outcome::success());
    let (truth, found) = (place.text("out/simulated.truth.csv"), place.text("out/simulated.csv"));
    let (truth, found) = (rows(&truth), rows(&found));
    let mut of_shot: BTreeMap<&str, Vec<&table::Row>> = BTreeMap::new();
    found.iter().for_each(|row| of_shot.entry(&row["shot"]).or_default().push(row));
    let mut all = Found { pairs: Vec::new(), false_returns: 0, shots: truth.len() };
    for row in &truth {
        assert_eq!(row["number_of_returns"], "1", "level ground gives one return");
        let found = of_shot.get(row["shot"].as_str()).map_or(&[][..], |found| found);
        all.false_returns += found.len().saturating_sub(1);
        let [one] = found else { continue };
        let z = |name: &str, sd: &str| (number(one, name) - number(row, name)) / number(one, sd);
        all.pairs.push(Pair {
            gain: row.get("gain").map_or(1.0, |gain| gain.parse().unwrap()),
            range_z: z("range_m", "range_sd_m"),
            amplitude_z: z("amplitude_dn", "amplitude_sd_dn"),
            intensity_error: number(one, "intensity") / number(row, "linear_dn") - 1.0,
            deviation_ratio: number(one, "deviation_ratio"),
        });
    }
    all
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

fn rms(values: &[f64]) -> f64 {
    mean(&values.iter().map(|value| value * value).collect::<Vec<_>>()).sqrt()
}

/// Normalised errors are 0.95 to 1.05 and intensities unbiased at every gain, within chance.
#[track_caller]
fn is_right_at_every_gain(pairs: &[Pair]) {
    for (least, greatest) in [(0.5, 0.75), (0.75, 1.5), (1.5, 2.75), (2.75, 4.001)] {
        let within: Vec<Pair> =
            pairs.iter().copied().filter(|pair| (least..greatest).contains(&pair.gain)).collect();
        assert!(within.len() > 200, "{} returns of gain {least} to {greatest}", within.len());
        let of = |value: fn(&Pair) -> f64| within.iter().map(value).collect::<Vec<f64>>();
        let (range, amplitude) = (rms(&of(|p| p.range_z)), rms(&of(|p| p.amplitude_z)));
        let (errors, deviation) = (of(|p| p.intensity_error), mean(&of(|p| p.deviation_ratio)));
        let bias = mean(&errors);
        println!(
            "gain {least} to {greatest}: {} returns, z of range {range:.3} and amplitude {amplitude:.3}, \
             intensity {:+.2} %, deviation ratio {deviation:.2}",
            within.len(),
            100.0 * bias
        );
        let n = within.len() as f64;
        let uncertain = 3.0 / (2.0 * n).sqrt();
        assert!((range - 1.0).abs() < 0.05 + uncertain && (amplitude - 1.0).abs() < 0.05 + uncertain);
        assert!(bias.abs() < 0.01);
        assert!(deviation.abs() < 0.1 + 3.0 / n.sqrt());
    }
}

#[test]
fn fast_kernels_are_right_at_every_gain() {
    for mode in ["mode = 'fastest'\n", ""] {
        is_right_at_every_gain(&fly(12, GAINS, "", mode).pairs);
    }
}

#[test]
fn plain_kernels_are_right_at_every_gain() {
    is_right_at_every_gain(&fly(5, GAINS, "", "mode = 'slow'\n").pairs);
}

#[test]
fn gains_that_follow_echoes_leave_intensities_comparable() {
    let keys = "gain_range = [0.5, 5.0]\ngain_follows = 'echo'\ndropout_rate = 0.2\n";
    let found = fly(8, keys, "", "");
    let errors = |is_it: fn(f64) -> bool| -> Vec<f64> {
        found.pairs.iter().filter(|pair| is_it(pair.gain)).map(|pair| pair.intensity_error).collect()
    };
    let (after_nothing, after_an_echo) = (errors(|gain| gain == 5.0), errors(|gain| gain < 4.5));
    assert!(after_nothing.len() > 300 && after_an_echo.len() > 300);
    assert!(mean(&after_nothing).abs() < 0.01 && mean(&after_an_echo).abs() < 0.01);
}

#[test]
fn noise_gives_as_many_false_returns_as_at_one_gain() {
    for mode in ["mode = 'fastest'\n", ""] {
        let keys = format!("detection_sigma = 3.0\n{mode}");
        let (constant, changing) = (fly(12, "", "", &keys), fly(12, GAINS, "", &keys));
        let [one, many] = [&constant, &changing].map(|found| found.false_returns as f64);
        println!(
            "{mode:?}: {one} false returns of {} shots at gain 1, {many} at gains of 0.5 to 4",
            constant.shots
        );
        assert_eq!(constant.shots, changing.shots);
        assert!(one > 50.0, "{one}");
        // Noise SDs are within 2.2 % of those at the gains: on average 3 % more are found.
        assert!((many - one).abs() < 4.0 * (one + many).sqrt() + 0.03 * one, "{one} {many}");
    }
}

/// Blocks moved to the shots that caused them keep their gains.
#[test]
fn gains_move_with_their_blocks() {
    let keys = format!("{GAINS}as_recorded = true\npulse_rate_hz = 400000\nmodulation_ns = 60\n");
    let found = fly(12, &keys, "[[stage]]\ntype = 'resolve_mta'\n", "mode = 'fastest'\n");
    let errors: Vec<f64> = found.pairs.iter().map(|pair| pair.intensity_error).collect();
    let wrong = errors.iter().filter(|error| error.abs() > 0.3).count();
    println!("{} returns, {wrong} with intensities off by more than 30 %", errors.len());
    assert!(errors.len() > 10_000 && wrong * 200 < errors.len());
}

/// Echoes that overdrive the low-power receiver at high gains are fitted in both.
#[test]
fn two_receivers_go_together_at_every_gain() {
    let keys = format!("{GAINS}high_power = true\nhigh_power_from_dn = 20\ndetector = 'linear'\n");
    let keys = keys + "high_power_noise_sd_dn = 0.7\n";
    let flight = FLIGHT.replace("ground_amplitude_dn = 40", "ground_amplitude_dn = 120");
    let place = TestFolder::new();
    let stages = format!(
        "{flight}lines = 10\n{keys}[[stage]]\ntype = 'fuse_channels'\n[[stage]]\ntype = 'calibrate'\n\
         [[stage]]\ntype = 'decompose'\n{TABLE}"
    );
    assert_eq!(place.run(&stages), Outcome::success());
    let (truth, found) = (place.text("out/simulated.truth.csv"), place.text("out/simulated.csv"));
    let truth: BTreeMap<String, _> = rows(&truth).into_iter().map(|row| (row["shot"].clone(), row)).collect();
    let mut errors: BTreeMap<String, Vec<[f64; 2]>> = BTreeMap::new();
    for row in rows(&found).iter().filter(|row| row["number_of_returns"] == "1") {
        let linear_dn = number(&truth[&row["shot"]], "linear_dn");
        // Tables are in decibels above 7 DN.
        let intensity = 7.0 * 10f64.powf(0.1 * number(row, "amplitude_db"));
        let range_z =
            (number(row, "range_m") - number(&truth[&row["shot"]], "range_m")) / number(row, "range_sd_m");
        errors.entry(row["channel"].clone()).or_default().push([intensity / linear_dn - 1.0, range_z]);
    }
    for channel in ["low", "joint"] {
        let errors = &errors[channel];
        let bias = mean(&errors.iter().map(|of| of[0]).collect::<Vec<_>>());
        let range_z = rms(&errors.iter().map(|of| of[1]).collect::<Vec<_>>());
        println!(
            "{channel}: {} returns, intensity {:+.2} %, z of range {range_z:.3}",
            errors.len(),
            100.0 * bias
        );
        assert!(errors.len() > 500 && bias.abs() < 0.01, "{channel}");
        // At changing gains it is unknown how far the low-power receiver is linear. It is here.
        let least = if channel == "joint" { 0.5 } else { 0.9 };
        assert!((least..1.1).contains(&range_z), "{channel}");
    }
}

#[test]
fn a_recording_with_gains_is_the_same_through_a_container() {
    let place = TestFolder::new();
    let flight = format!("{FLIGHT}lines = 2\n{GAINS}");
    let copy = "[[stage]]\ntype = 'write_arrow'\npath = '*.arrow'\n";
    assert_eq!(place.run(&format!("{flight}{copy}")).code, Some(0));
    place.write("simulated.arrow", &std::fs::read(place.path("out/simulated.arrow")).unwrap());
    place.succeeds("read_arrow", "simulated.arrow", "[[stage]]\ntype = 'write_arrow'\npath = 'copy.arrow'\n");
    let bytes = |name: &str| std::fs::read(place.path(name)).unwrap();
    assert!(bytes("simulated.arrow") == bytes("out/copy.arrow"));
    let text = place.wavex(&["scan", "simulated.arrow"]).out;
    assert!(text.contains("yes, with the gain of each block"), "{text}");
    assert!(text.contains("0.500 to "), "{text}");
}

const UNKNOWN: &str =
    "the receiver gain varies between shots, but the recording does not contain the gain of each block";

#[test]
fn a_recording_that_does_not_say_its_gains_is_warned_of() {
    let header = ContainerHeader {
        gain_control: Some(GainControl::NotRecorded),
        ..ContainerHeader::new(1.0, 2.997e8)
    };
    let row = container::Row { shot: nadir_shot(0, 0), blocks: vec![(1, 4000.0, vec![2, 3, 40, 3, 2])] };
    let place = TestFolder::with(&[("made.arrow", &container(&header, &[vec![row]]))]);
    let copy = "[[stage]]\ntype = 'write_arrow'\npath = '*_copy.arrow'\n";
    let input = place.succeeds("read_arrow", "made.arrow", copy);
    assert!(notes(&input).iter().any(|note| note.starts_with(UNKNOWN)), "{:?}", notes(&input));
    let text = place.wavex(&["scan", "made.arrow"]).out;
    assert!(text.contains("intensities are not comparable") && text.contains(UNKNOWN), "{text}");
}

#[test]
fn descriptors_of_different_gains_are_warned_of() {
    let warned = |gain: f64| {
        let mut las = Las::new(20);
        let mut other = descriptor(8, 60, 1000);
        other[10..18].copy_from_slice(&gain.to_le_bytes());
        las.vlrs.push(vlr("LASF_Spec", 101, &other));
        assert!(las.offset_of(0) > HEADER);
        let (points, packets) = (las.las(), las.packets.clone());
        let place = TestFolder::with(&[("made.las", &points), ("made.wdp", &packets)]);
        let copy = "[[stage]]\ntype = 'write_arrow'\npath = '*_copy.arrow'\n";
        let input = place.succeeds("read_las", "made.las", copy);
        notes(&input).iter().any(|note| note.starts_with(UNKNOWN))
    };
    assert!(!warned(1.0));
    assert!(warned(2.0));
}
