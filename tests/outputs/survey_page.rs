//! `survey_page`: densities, gaps and height differences of overlapping strips.

use serde_json::Value;
use wavex_testkit::{Outcome, TestFolder};

/// Keys of a strip of the simulated survey over one scene.
fn strip(stem: &str, seed: u32, keys: &str) -> String {
    format!(
        "report = ''\nstat_log = ''\nlog = ''\n[[stage]]\ntype = 'simulate'\nstem = '{stem}'\nseed = {seed}\n\
         scene_seed = 7\nlandscape = 'country'\nrelief_m = 8.0\nwood_ratio = 0.2\nhouse_ratio = 0.1\n\
         building_height_m = 6.0\ncanopy_height_m = 10.0\nwire_height_m = 0.0\nwater_ratio = 0.0\n\
         flying_height_m = 200.0\nscan_angle_deg = [-25.0, 25.0]\nshots_per_line = 200\n\
         pulse_rate_hz = 20000.0\nlines = 130\n{keys}\n[[stage]]\ntype = 'write_arrow'\n"
    )
}

/// Misalignment of the strip `b`, m.
const ERROR_M: f64 = 0.05;

/// Three parallel strips and a crossing one; `b` is 5 cm too high.
fn survey() -> TestFolder {
    let place = TestFolder::new();
    let strips = [
        ("a", ""),
        ("b", "track_offset_m = [80.0, 0.0]\nheight_error_m = 0.05"),
        ("c", "track_offset_m = [160.0, 0.0]"),
        ("d", "track_offset_m = [-40.0, 40.0]\ntrack_direction_deg = 90.0\nlines = 400"),
    ];
    for ((stem, keys), seed) in strips.into_iter().zip(1..) {
        let mut job = strip(stem, seed, keys);
        if keys.contains("lines") {
            job = job.replace("lines = 130\n", "");
        }
        assert_eq!(place.run(&job), Outcome::success());
    }
    place
}

const KEYS: &str = "input_dir = 'out'\nsurvey_page = true\n";
const JOB: &str = "[[stage]]\ntype = 'read_arrow'\npath = '?.arrow'\n[[stage]]\ntype = 'calibrate'\n\
                   waveforms = 2000\n[[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n\
                   [[stage]]\ntype = 'write_las'\npath = '*.las'\n";

fn json(place: &TestFolder) -> Value {
    serde_json::from_str(&place.text("out/job_survey.json")).unwrap()
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("no number: {value}"))
}

#[test]
fn a_misaligned_strip_is_shown_and_quantified() {
    let place = survey();
    let job = format!("{KEYS}[job.survey]\ntarget_pulses_per_m2 = 3.0\n{JOB}");
    assert_eq!(place.run(&job), Outcome::success());
    let survey = json(&place);

    // The offset of the strip and the differences of its pairs.
    let offsets: Vec<f64> =
        survey["strips"].as_array().unwrap().iter().map(|strip| number(&strip["offset_m"])).collect();
    println!("offsets of strips a, b, c, d: {offsets:?} m");
    let tolerance_m = 0.003;
    for (offset_m, expected_m) in offsets.iter().zip([0.0, ERROR_M, 0.0, 0.0]) {
        assert!((offset_m - expected_m).abs() < tolerance_m, "{offsets:?}");
    }
    let pairs = survey["pairs"].as_array().unwrap();
    assert!(pairs.len() >= 5, "{pairs:?}");
    for pair in pairs {
        let expected_m = match [pair["strips"][0].as_str().unwrap(), pair["strips"][1].as_str().unwrap()] {
            [_, "b"] => ERROR_M,
            ["b", _] => -ERROR_M,
            _ => 0.0,
        };
        let (median_m, mean_m) = (number(&pair["median_m"]), number(&pair["mean_m"]));
        println!("{}: {} cells, median {median_m:.4} m, mean {mean_m:.4} m", pair["strips"], pair["cells"]);
        assert!((median_m - expected_m).abs() < tolerance_m, "{pair}");
        assert!((mean_m - expected_m).abs() < tolerance_m, "{pair}");
        // Scatter of the differences about the misalignment: the noise explains it.
        let scatter_m = (number(&pair["rms_m"]).powi(2) - mean_m * mean_m).sqrt();
        let noise_m = number(&pair["noise_rms_m"]);
        println!("   scatter {scatter_m:.4} m, by noise {noise_m:.4} m");
        assert!((0.8..1.6).contains(&(scatter_m / noise_m)), "{pair}");
    }
}
