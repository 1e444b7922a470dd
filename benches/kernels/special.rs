//! Waveforms that most recordings do not have: long ones, late odd samples, and echoes of two receivers.

use std::sync::Arc;

use wavex_signal::decompose::{DecomposeSettings, Decomposer, Mode, Tables};
use wavex_signal::fusion::{Expected, JointFit, JointPulse};
use wavex_signal::noise::ArNoise;
use wavex_signal::sensor_model::{ChannelModel, Digitiser};
use wavex_simd::SimdLevel;

use wavex_testkit::waveforms::{SAMPLES, Scene, Waveforms};

use super::{ALIKE, WAVEFORMS, Waveform, blocks, cpu_s, measured, waveforms};

/// Number of waveforms of a joint fit's row.
const JOINT_WAVEFORMS: usize = 1000;
/// Difference of the other receiver's fit, and its variance: log height, position in samples, log width.
const OTHER: [(f64, f64); 3] = [(0.02, 1e-3), (0.1, 0.01), (0.01, 1e-3)];

/// Prints all rows.
pub fn rows(simd: SimdLevel, model: &ChannelModel, noise: &ArNoise, tables: &Arc<Tables>) {
    long_blocks(simd, model, noise, tables);
    late_odd_samples(simd, model, noise, tables);
    two_receivers(model, noise);
}

/// Time per sample of blocks with an echo every 4000 samples.
fn long_blocks(simd: SimdLevel, model: &ChannelModel, noise: &ArNoise, tables: &Arc<Tables>) {
    for samples in [1024, 4096, 16_384, 65_535] {
        let mut block = Vec::new();
        let echoes = Waveforms::new(model, noise, Scene::Long(samples), 7).next(&mut block).len();
        let (rate, outcomes, _) =
            measured(model, tables, Mode::Refined, false, simd, &[Waveform { samples: &block }]);
        // `measured` counts the waveforms of a scene, and there is one.
        let spent_us = WAVEFORMS as f64 / rate.best;
        println!(
            "long blocks, {samples} samples, {echoes} echoes: {:.3} ms, {:.0} ns per sample; {} returns",
            1e-3 * spent_us,
            1e3 * spent_us / samples as f64,
            outcomes.get(0).map_or(0, |outcome| outcome.returns.len())
        );
    }
}

/// Rate with odd samples a fifth of an interval late, relative to samples on time.
fn late_odd_samples(simd: SimdLevel, model: &ChannelModel, noise: &ArNoise, tables: &Arc<Tables>) {
    let late =
        ChannelModel { digitiser: Digitiser { odd_sample_shift: 0.2, ..model.digitiser }, ..model.clone() };
    let of_late = Arc::new(Tables::new(&late).expect("tables"));
    let [on_time, late] = [(model, tables), (&late, &of_late)].map(|(model, tables)| {
        let (samples, _) = waveforms(model, noise, Scene::Mixed, 9);
        let (rate, _, left) = measured(model, tables, Mode::Refined, false, simd, &blocks(&samples, ALIKE));
        (rate.best, left)
    });
    println!(
        "late odd samples, refined: {:.2} M waveforms per core-second, {:.2} times the rate of samples on time; left to scalar kernels {:.2} %",
        late.0,
        late.0 / on_time.0,
        100.0 * late.1
    );
}

/// Time of a joint fit of the echoes of a block, given those of the other receiver.
fn two_receivers(model: &ChannelModel, noise: &ArNoise) {
    let mut covariance = [[0.0; 3]; 3];
    (0..3).for_each(|i| covariance[i][i] = OTHER[i].1);
    for echoes in [1, 2, 4] {
        let mut made = Waveforms::new(model, noise, Scene::Echoes(echoes), 11);
        let mut decomposer =
            Decomposer::new(model, &DecomposeSettings::default(), 2 * SAMPLES).expect("a channel");
        let mut blocks = Vec::new();
        for _ in 0..JOINT_WAVEFORMS {
            let mut samples = Vec::new();
            made.next(&mut samples);
            let found = decomposer.decompose(&samples);
            let pulses = found.returns.iter().map(|found| {
                let start = [found.amplitude_dn.ln(), found.position_samples, found.width_ratio.ln()];
                let mean = std::array::from_fn(|part| start[part] + OTHER[part].0);
                JointPulse { start, expected: Some(Expected { mean, covariance }), ln_width_precision: 0.0 }
            });
            let pulses: Vec<JointPulse> = pulses.collect();
            blocks.push((samples, pulses));
        }
        let mut joint = JointFit::new(model, 0.01).expect("a channel");
        let before = cpu_s();
        let fitted =
            blocks.iter().filter(|(samples, pulses)| joint.fit(samples, pulses.iter().copied()).is_some());
        let fitted = fitted.count();
        println!(
            "two receivers, {echoes} echoes: {:.1} us per joint fit; {fitted} of {JOINT_WAVEFORMS} fits",
            (cpu_s() - before) * 1e6 / JOINT_WAVEFORMS as f64
        );
    }
}
