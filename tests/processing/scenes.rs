//! Calibration and decomposition over different landscapes: bare, fully wooded, and so bright that
//! most echoes are clipped.
//!
//! A model calibrated over one landscape must be valid over the next.

use std::collections::BTreeMap;
use std::path::Path;

use wavex::engine;
use wavex::registry;
use wavex_signal::sensor_model::ChannelModel;
use wavex_simulation::pulse::PulseShape;
use wavex_testkit::engine_stages::{into, job};

const NOISE_DN: f64 = 0.93;
/// Minimum distance of separate echoes (two pulse widths), and minimum signal-to-noise ratio of
/// strong echoes.
const APART_M: f64 = 1.35;
const STRONG_SD: f64 = 8.0;
/// Echoes are faint below this fraction of another echo's amplitude.
const FAINT_PART: f64 = 0.03;
/// Higher echoes may overdrive the receiver.
const HIGHEST_DN: f64 = 200.0;

struct Scene {
    name: &'static str,
    keys: &'static str,
    two_receivers: bool,
    /// Tolerated relative excess of the noise: undetectable weak returns increase it.
    noise_part: f64,
}

const SCENES: [Scene; 7] = [
    Scene {
        name: "bare ground",
        keys: "canopy_height_m = 0.0\nbuilding_height_m = 0.0",
        two_receivers: false,
        noise_part: 0.015,
    },
    Scene {
        name: "hills, houses, woods",
        keys: "landscape = \"country\"",
        two_receivers: false,
        noise_part: 0.025,
    },
    Scene {
        name: "woods all over",
        keys: "landscape = \"country\"\nwood_ratio = 1.0\nwater_ratio = 0.0",
        two_receivers: false,
        noise_part: 0.04,
    },
    Scene {
        name: "dark woods all over",
        keys: "landscape = \"country\"\nwood_ratio = 1.0\nwater_ratio = 0.0\nground_amplitude_dn = 40.0",
        two_receivers: false,
        noise_part: 0.1,
    },
    Scene {
        name: "ground that clips the digitiser",
        keys: "ground_amplitude_dn = 500.0",
        two_receivers: false,
        noise_part: 0.025,
    },
    Scene {
        name: "the same with a second receiver",
        keys: "ground_amplitude_dn = 500.0\nhigh_power = true",
        two_receivers: true,
        noise_part: 0.025,
    },
    Scene {
        name: "bright woods all over, with a second receiver",
        keys: "landscape = \"country\"\nwood_ratio = 1.0\nwater_ratio = 0.0\nground_amplitude_dn = 600.0\nhigh_power = true",
        two_receivers: true,
        noise_part: 0.04,
    },
];

/// Range (m), amplitude (DN) and range SD of true or found returns, by shot.
type Rows = BTreeMap<u64, Vec<[f64; 3]>>;

fn rows(path: &Path, columns: [&str; 3]) -> Rows {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let at = |name: &str| names.iter().position(|known| *known == name).unwrap();
    let (shot, columns) = (at("shot"), columns.map(at));
    let mut rows = Rows::new();
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let row = columns.map(|column| cells[column].parse().unwrap());
        rows.entry(cells[shot].parse().unwrap()).or_default().push(row);
    }
    rows
}

/// Model of the sensitive receiver, truth and returns of a scene.
fn flown(scene: &Scene) -> (ChannelModel, Rows, Rows) {
    let folder = tempfile::tempdir().unwrap();
    let simulate = format!("stem = \"scene\"\nlines = 8\ntruth = \"truth.csv\"\n{}", scene.keys);
    let of = |name| registry::find(name).unwrap();
    let mut stages = vec![(of("simulate"), simulate.as_str())];
    if scene.two_receivers {
        stages.push((of("fuse_channels"), ""));
    }
    stages.extend([
        (of("calibrate"), ""),
        (of("decompose"), ""),
        (of("write_table"), "path = \"returns.csv\""),
    ]);
    let job = job(&stages);
    let report = engine::run(&job, &into(&job, folder.path())).unwrap();
    let model = report.inputs[0].sensor_model.as_deref().unwrap().low_power.clone().unwrap();
    let truth = rows(&folder.path().join("truth.csv"), ["range_m", "amplitude_dn", "width_ratio"]);
    let returns = rows(&folder.path().join("returns.csv"), ["range_m", "amplitude_dn", "range_sd_m"]);
    (model, truth, returns)
}

#[test]
fn the_instrument_is_found_over_every_land() {
    let fwhm_ns = PulseShape::riegl().fwhm_ns();
    for scene in &SCENES {
        let (model, truth, returns) = flown(scene);
        let (mut echoes, mut missed, mut scores) = (0, 0, Vec::new());
        for (shot, hits) in &truth {
            for (i, [range_m, height_dn, _]) in hits.iter().enumerate() {
                let near = |other: &[f64; 3]| (other[0] - range_m).abs();
                let is_apart = hits.iter().enumerate().all(|(j, hit)| i == j || near(hit) > APART_M);
                let heights_dn = STRONG_SD * NOISE_DN..HIGHEST_DN;
                // Spurious echoes allowed for response errors next to a stronger echo are not
                // counted.
                let is_faint = hits.iter().any(|hit| FAINT_PART * hit[1] > *height_dn);
                // After a clipped echo the receiver needs time to recover; before it, it is not
                // affected.
                let is_clear = hits.iter().all(|hit| hit[1] < HIGHEST_DN || hit[0] > *range_m);
                if !is_apart || !is_clear || is_faint || !heights_dn.contains(height_dn) {
                    continue;
                }
                echoes += 1;
                let found = returns.get(shot).into_iter().flatten();
                match found.min_by(|a, b| near(a).total_cmp(&near(b))).filter(|found| near(found) < 0.4) {
                    Some(found) => scores.push((found[0] - range_m) / found[2]),
                    None => missed += 1,
                }
            }
        }
        let within = scores.iter().filter(|score| score.abs() < 1.0).count() as f64 / scores.len() as f64;
        println!(
            "{}: noise {:.4} of {NOISE_DN} DN, width {:.3} of {fwhm_ns:.3} ns, error factor {:.3}; {missed} of {echoes} echoes \
             missed, {:.1} % of the ranges within a standard deviation",
            scene.name,
            model.noise_sd_dn,
            model.pulse_fwhm_ns,
            model.pulse_error_factor,
            100.0 * within
        );
        let noise_part = model.noise_sd_dn / NOISE_DN - 1.0;
        assert!(noise_part > -0.015 && noise_part < scene.noise_part, "{}: {noise_part}", scene.name);
        assert!((model.pulse_fwhm_ns / fwhm_ns - 1.0).abs() < 0.02, "{}", scene.name);
        assert!(model.response.is_some(), "{}", scene.name);
        assert!(echoes > 500 && missed * 1000 <= echoes, "{}: {missed} of {echoes}", scene.name);
        assert!((0.64..0.73).contains(&within), "{}: {within}", scene.name);
    }
}
