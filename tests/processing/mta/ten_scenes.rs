//! Smaller versions of the ten scenes of the bench `mta`, through the whole chain by both readers,
//! against the truth.
//!
//! `cargo bench --bench mta -- chain` runs the full scenes.

use std::path::Path;

use super::flights::text;
use wavex_simulation::mta_scenes::{EchoScene, EchoSceneSpec, RecordingSettings, SCENES};
use wavex_testkit::TestFolder;
use wavex_testkit::mta::chain::{self, Score, quantile};
use wavex_testkit::mta::recording;

/// Lines per scene, and fraction of the swath.
const LINES: u32 = 16;
const PART: f64 = 0.015;
const HOW: RecordingSettings =
    RecordingSettings { pulse_rate_hz: 400e3, modulation_ns: 17.0, blind_ns: 15.0, lost_records: 0.0 };

/// Runs a scene through both readers, which must give the same bytes.
///
/// The first scene calibrates; the others use its sensor model, because all ten have the same
/// receiver.
fn through(spec: EchoSceneSpec, seed: u64, model: &Path) -> Score {
    let place = TestFolder::new();
    let scene = EchoScene::new(spec, seed, LINES, PART);
    let truth = recording::write(&scene, &scene.record(&HOW), &place.path(""));
    let calibrate = match model.exists() {
        false => format!("waveforms = 1000\nsave = '{}'", text(model)),
        true => format!("load = '{}'", text(model)),
    };
    chain::run(&place.path(""), &calibrate);
    let (are_same, score) = chain::compare(&place.path(""), &truth);
    assert!(are_same, "{}: the readers give different bytes", spec.name);
    score
}

#[test]
fn ten_scenes_come_back_by_both_doors() {
    let models = TestFolder::new();
    let (mut echoes, mut right) = (0, 0);
    for (seed, spec) in (100..).zip(SCENES) {
        let score = through(spec, seed, &models.path("model.json"));
        println!("{}: {score}", spec.name);
        // 1500 m are 4.003 intervals, and the highest flight is at 3000 m.
        assert!((4..=7).contains(&score.zone_most), "{}: {score}", spec.name);
        // Pulses of 15 to 160 DN in noise of 1 DN: 0.1 ns for the weakest.
        assert!(quantile(&score.range_errors_m, 50) < 0.004, "{}: {score}", spec.name);
        assert!(quantile(&score.range_errors_m, 99) < 0.02, "{}: {score}", spec.name);
        let beyond_m = score.worst_beyond_range_m;
        assert!(beyond_m < 1e-3, "{}: {beyond_m} m are not the range's", spec.name);
        (echoes, right) = (echoes + score.echoes, right + score.right);
    }
    println!("{right} of {echoes} right");
    assert!(echoes > 11_000);
    assert!(right as f64 >= 0.999 * echoes as f64, "{right} of {echoes}");
}
