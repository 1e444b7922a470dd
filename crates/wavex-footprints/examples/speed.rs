//! Prints the time per shot: `cargo run --release -p wavex-footprints --example speed`.
#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "an example prints its figures and panics on failure"
)]

use std::time::Instant;

use wavex_footprints::{FootprintEstimator, FootprintLearner, FootprintSettings};

/// Shots, and samples of each: those of GEDI.
const SHOTS: usize = 2000;
const SAMPLES: usize = 790;
const RUNS: usize = 9;

/// A ground below two layers, with noise that neighbours share.
fn waveform(shot: usize) -> Vec<f32> {
    let mut state = shot as u32 + 1;
    let mut white = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    let white: Vec<f32> = (0..SAMPLES + 4).map(|_| white()).collect();
    let echo =
        |k: usize, height: f32, at: f32, sd: f32| height * (-0.5 * ((k as f32 - at) / sd).powi(2)).exp();
    let signal = |k: usize| {
        echo(k, 60.0, 300.0, 20.0)
            + echo(k, 40.0, 350.0, 12.0)
            + echo(k, 120.0, 430.0 + (shot % 7) as f32, 7.0)
    };
    white.windows(5).enumerate().map(|(k, near)| 220.0 + 2.0 * near.iter().sum::<f32>() + signal(k)).collect()
}

fn main() {
    let shots: Vec<Vec<f32>> = (0..SHOTS).map(waveform).collect();
    let pulse: Vec<f32> =
        (0..128).map(|k| 1000.0 * (-0.5 * ((k as f32 - 60.2) / 6.6).powi(2)).exp()).collect();
    let begin = Instant::now();
    let mut learner = FootprintLearner::new(1.0, 15.5);
    for shot in shots.iter().take(1000) {
        learner.add_outgoing(&pulse);
        learner.add_waveform(shot);
    }
    let model = learner.finish().unwrap();
    println!("learning from 1000 shots: {:.2} s", begin.elapsed().as_secs_f64());
    let group = FootprintSettings::gedi_l2a(2).unwrap();
    for (name, settings) in [("default", FootprintSettings::default()), ("gedi_l2a_a2", group)] {
        let mut estimator = FootprintEstimator::new(&model, settings);
        let mut run = || {
            let begin = Instant::now();
            let found = shots
                .iter()
                .filter(|shot| estimator.measure(shot, None).is_some_and(|found| found.ground().is_some()));
            assert_eq!(found.count(), SHOTS);
            1e6 * begin.elapsed().as_secs_f64() / SHOTS as f64
        };
        let mut times_us: Vec<f64> = (0..RUNS).map(|_| run()).collect();
        times_us.sort_unstable_by(f64::total_cmp);
        println!("{name}: {:.0} µs per shot of {SAMPLES} samples, median of {RUNS}", times_us[RUNS / 2]);
    }
}
