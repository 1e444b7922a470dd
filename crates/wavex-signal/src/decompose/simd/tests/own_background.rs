//! Tests of waveforms with their own background, against the scalar kernels and the truth.

use super::*;
use crate::simulated::moments;

/// Standard deviation of the level between waveforms, DN.
const DRIFT_DN: f64 = 3.0;
/// Offset added to the samples so that no level comes near 0, DN.
const LIFT_DN: f64 = 20.0;
const MODES: [Mode; 3] = [Mode::Fastest, Mode::FastSeparated, Mode::Refined];

fn own() -> ChannelModel {
    let model = model();
    ChannelModel {
        background: Background::PerWaveform,
        background_sd_dn: DRIFT_DN,
        background_dn: model.background_dn.map(|level| level + LIFT_DN),
        full_scale_dn: 1000.0,
        ..model
    }
}

/// Simulates a block of these pulses on its own level.
fn drifting(model: &ChannelModel, shape: &Shape, random: &mut Random, pulses: &[Pulse]) -> Vec<u16> {
    let level_dn = DRIFT_DN * random.normal();
    let mut lifted = model.clone();
    lifted.background_dn = model.background_dn.map(|level| level + level_dn);
    block(&lifted, shape, random, SAMPLES, pulses)
}

/// Simulates mixed waveforms, each on its own level, in whole steps.
fn drifting_scenes(model: &ChannelModel, seed: u64, count: usize) -> Vec<Vec<u16>> {
    let mut waveforms = pulse_models(model, seed, count);
    let mut random = Random::new(seed + 1);
    for waveform in &mut waveforms {
        let level_dn = (DRIFT_DN * random.normal()).round().max(-LIFT_DN);
        waveform.iter_mut().for_each(|sample| *sample = (f64::from(*sample) + level_dn).max(0.0) as u16);
    }
    waveforms
}

/// The number of returns equals that of the scalar kernels in 98 % of the waveforms.
///
/// For these, 95 % of the values agree to a fifth of a standard deviation. Fewer than 3 % of the
/// waveforms go to the scalar kernels.
#[test]
fn returns_are_those_of_the_plain_kernels_on_any_level() {
    let model = own();
    let waveforms = drifting_scenes(&model, 21, 1500);
    let mut plain = Decomposer::new(&model, &DecomposeSettings::default(), SAMPLES).unwrap();
    let mut kernels = fast(&model, Mode::Refined, SimdLevel::best());
    let outcomes = decompose(&mut kernels, &waveforms);
    let (mut same, mut near, mut all, mut offsets) = (0, 0, 0, Vec::new());
    for (samples, found) in waveforms.iter().zip(outcomes.iter()) {
        let expected = plain.decompose(samples);
        let c = found.counts;
        assert_eq!(c.n_candidates + c.n_added, c.np + c.np_filtered() + c.np_merged + c.np_xtalk_dropped);
        if expected.returns.len() == found.returns.len() {
            same += 1;
            all += found.returns.len();
            offsets.push(found.background_offset_dn - expected.background_offset_dn);
            let differences = expected.returns.iter().zip(found.returns).map(|(a, b)| difference(a, b));
            near += differences.filter(|difference| *difference < 0.2).count();
        }
    }
    let (mean, sd) = moments(&offsets);
    println!("{same} of 1500 alike, {near} of {all} near, levels differ by {mean:.4} +- {sd:.4} DN");
    println!("{} passed to the scalar kernels", kernels.left_to_plain());
    assert!(same >= 1470 && near * 100 >= 95 * all);
    assert!(mean.abs() < 0.02 && sd < 0.1 && kernels.left_to_plain() < 45);
}

/// The SD of normalised errors of isolated returns is 0.95 to 1.05 in every mode.
///
/// This holds for time, height and width. The bias is below a tenth of a standard deviation.
#[test]
fn standard_deviations_hold_the_uncertainty_of_the_level() {
    let model = own();
    let shape = Shape::of(&model).unwrap();
    let mut random = Random::new(31);
    let truth: Vec<Pulse> = (0..6000)
        .map(|_| pulse(15.0 + 100.0 * random.uniform(), 18.0 + 14.0 * random.uniform(), 1.1))
        .collect();
    let waveforms: Vec<Vec<u16>> =
        truth.iter().map(|one| drifting(&model, &shape, &mut random, &[*one])).collect();
    for mode in MODES {
        let mut kernels = fast(&model, mode, SimdLevel::best());
        let outcomes = decompose(&mut kernels, &waveforms);
        let mut scores = [Vec::new(), Vec::new(), Vec::new()];
        for (outcome, truth) in outcomes.iter().zip(&truth) {
            let [r] = outcome.returns else { continue };
            scores[0].push((r.position_samples - truth.position_samples) / r.position_sd_samples);
            scores[1].push((r.amplitude_dn - truth.height_dn) / r.amplitude_sd_dn);
            scores[2].push((r.width_ratio - truth.ln_width_ratio.exp()) / r.width_ratio_sd);
        }
        let left = kernels.left_to_plain();
        for (scores, name) in scores.iter().zip(["position", "height", "width"]) {
            let (mean, sd) = moments(scores);
            println!(
                "{mode:?} {name}: {mean:.3} +- {sd:.3}, {} found, {left} passed to the scalar kernels",
                scores.len()
            );
            assert!(scores.len() >= 5900 && left <= 60, "{mode:?} {name}");
            assert!(mean.abs() < 0.1 && (0.95..1.05).contains(&sd), "{mode:?} {name}: {mean} {sd}");
        }
    }
}

/// Noise reaches a threshold no more often than with a known background.
///
/// At 4.5 it does so as often (docs/explanation/performance.md), below that a little less often.
#[test]
fn noise_alone_is_detected_no_more_often() {
    let own = own();
    let fixed = ChannelModel { background: Background::Fixed, ..own.clone() };
    let shape = Shape::of(&own).unwrap();
    let mut random = Random::new(41);
    let steady: Vec<Vec<u16>> =
        (0..60_000).map(|_| block(&fixed, &shape, &mut random, SAMPLES, &[])).collect();
    let maxima = |model: &ChannelModel| {
        let tables = Some(Arc::new(Tables::new(model).unwrap()));
        let settings = DecomposeSettings { detection_sigma: 3.5, ..DecomposeSettings::default() };
        let mut kernels =
            BatchDecomposer::new(model, tables, &settings, Mode::Fastest, SimdLevel::best()).unwrap();
        let blocks: Vec<Waveform<'_>> = steady.iter().map(|samples| Waveform { samples }).collect();
        let mut found = Vec::new();
        kernels.detect(&blocks, &mut found);
        found.len() as f64
    };
    let (expected, found) = (maxima(&fixed), maxima(&own));
    println!("{found} maxima, {expected} with a known background");
    assert!((0.6..1.1).contains(&(found / expected)));
}

/// Waveforms full of signal have no free samples, or a level that the prior excludes.
#[test]
fn waveforms_without_free_samples_are_left_to_the_plain_kernels() {
    let model = own();
    let shape = Shape::of(&model).unwrap();
    let mut random = Random::new(51);
    let full: Vec<Pulse> = (0..14).map(|i| pulse(60.0, 4.2 * f64::from(i), 1.0)).collect();
    let waveforms: Vec<Vec<u16>> = (0..20).map(|_| drifting(&model, &shape, &mut random, &full)).collect();
    let mut plain = Decomposer::new(&model, &DecomposeSettings::default(), SAMPLES).unwrap();
    for mode in MODES {
        let mut kernels = fast(&model, mode, SimdLevel::best());
        let outcomes = decompose(&mut kernels, &waveforms);
        assert_eq!(kernels.left_to_plain(), 20);
        assert_eq!(outcomes.get(3), Some(plain.decompose(&waveforms[3])));
    }
}

#[test]
fn levels_have_the_same_bits_on_every_path_alone_and_among_others() {
    let model = own();
    let mut waveforms = mixture(&model);
    waveforms.extend(drifting_scenes(&model, 61, 60));
    let together = everything(&model, SimdLevel::best(), &waveforms);
    for path in SimdLevel::ALL {
        assert_eq!(everything(&model, path, &waveforms), together, "{path:?}");
    }
    for (samples, together) in waveforms.iter().zip(&together).step_by(7) {
        assert_eq!(&everything(&model, SimdLevel::best(), std::slice::from_ref(samples))[0], together);
    }
}
