use super::*;
use crate::sensor_model::response::{ResponseNode, STEPS_PER_SAMPLE, SystemResponse};
use crate::shape::FOUR_LN_2;
use crate::simulated::{Random, channel, digitised, noise, pulse};

const FWHM_SAMPLES: f64 = 6.0;
const BACKGROUND_DN: f64 = 10.3;
const SAMPLES: usize = 240;
const TOP: f64 = 60.0;

fn wide_channel(process: &ArNoise) -> ChannelModel {
    ChannelModel { full_scale_dn: 4095.0, ..channel(process, FWHM_SAMPLES, BACKGROUND_DN) }
}

/// A canopy of many echoes, a ground echo behind it, and the waveform's own percentiles.
struct Canopy {
    samples: Vec<u16>,
    ground: f64,
    heights: [f64; 4],
}

/// A canopy of 12 DN times `scale`, or none, over a ground of 110 DN times `scale`.
fn canopy(random: &mut Random, process: &ArNoise, model: &ChannelModel, scale: f64, is_bare: bool) -> Canopy {
    let depth = 60.0 + 20.0 * random.uniform();
    let ground = TOP + depth + 18.0 + random.uniform();
    let mut signal = vec![0.0; SAMPLES];
    let shape = Shape::of(model).unwrap();
    for _ in 0..if is_bare { 0 } else { 300 } {
        let part = (random.uniform() + random.uniform() + random.uniform()) / 3.0;
        shape.add(&pulse(1.5 * scale, TOP + depth * part, 1.0), 1.0, &mut signal);
    }
    shape.add(&pulse(110.0 * scale, ground, 1.0), 1.0, &mut signal);
    let energy: f64 = signal.iter().sum();
    let heights = RELATIVE_HEIGHTS.map(|part| {
        let (mut sum, wanted) = (0.0, (1.0 - part) * energy);
        let at = signal.iter().position(|dn| {
            sum += dn;
            sum >= wanted
        });
        let at = at.unwrap();
        ground - (at as f64 + 0.5 - (sum - wanted) / signal[at])
    });
    let mut values = noise(random, process, SAMPLES);
    values.iter_mut().zip(&signal).for_each(|(value, dn)| *value += BACKGROUND_DN + dn);
    Canopy { samples: digitised(&values, 4095), ground, heights }
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// Normalised errors of ground and heights against the percentiles of the waveform without noise.
#[test]
fn heights_above_the_ground_have_true_standard_deviations() {
    const COUNT: usize = 600;
    for (coefficients, scale, is_bare) in [
        (&[][..], 1.0, false),
        (&[0.4], 1.0, false),
        (&[-0.5], 0.4, false),
        (&[0.9, -0.3], 3.0, false),
        (&[0.6, -0.2], 1.0, true),
    ] {
        let process = ArNoise::new(coefficients, 1.0).unwrap();
        let model = wide_channel(&process);
        let mut targets = DistributedTargets::new(&model).unwrap();
        let mut random = Random::new(11);
        let mut scores = vec![Vec::new(); 5];
        let mut gross = 0;
        for _ in 0..COUNT {
            let truth = canopy(&mut random, &process, &model, scale, is_bare);
            // An unknown background.
            let profile = targets.profile(&truth.samples, 2.0).unwrap();
            assert_eq!(profile.flags, 0);
            let found = [profile.last_peak_samples].into_iter().chain(profile.heights_samples);
            let wanted = [truth.ground].into_iter().chain(truth.heights);
            gross += usize::from((profile.last_peak_samples.value - truth.ground).abs() > 3.0);
            for ((scores, found), wanted) in scores.iter_mut().zip(found).zip(wanted) {
                scores.push((found.value - wanted) / found.sd);
            }
        }
        let z: Vec<f64> = scores.iter().map(|scores| rms(scores)).collect();
        println!("noise {coefficients:?}, signal {scale}, bare {is_bare}: z {z:.2?}");
        assert_eq!(gross, 0);
        assert!(z.iter().all(|z| (0.88..1.12).contains(z)), "{z:.2?}");
    }
}

fn waveform(model: &ChannelModel, echoes: &[(f64, f64)], samples: usize) -> Vec<u16> {
    let mut random = Random::new(5);
    let mut values = noise(&mut random, &ArNoise::new(&[], 1.0).unwrap(), samples);
    values.iter_mut().for_each(|value| *value += BACKGROUND_DN);
    let shape = Shape::of(model).unwrap();
    for &(height_dn, position) in echoes {
        shape.add(&pulse(height_dn, position, 1.0), 1.0, &mut values);
    }
    digitised(&values, 4095)
}

#[test]
fn half_of_the_energy_of_a_hard_ground_lies_above_it() {
    let model = wide_channel(&ArNoise::new(&[], 1.0).unwrap());
    let mut targets = DistributedTargets::new(&model).unwrap();
    let profile = targets.profile(&waveform(&model, &[(150.0, 140.3)], SAMPLES), 0.0).unwrap();
    println!("{profile:?}");
    assert_eq!((profile.peaks, profile.flags), (1, 0));
    assert_eq!(profile.first_peak_samples, profile.last_peak_samples);
    assert!((profile.last_peak_samples.value - 140.3).abs() < 0.1);
    assert!((profile.energy_dn.value - 150.0).abs() < 4.0 * profile.energy_dn.sd);
    let [rh25, rh50, rh75, _] = profile.heights_samples;
    assert!(rh50.value.abs() < 4.0 * rh50.sd && rh50.sd < 0.1);
    assert!((rh25.value + rh75.value).abs() < 0.3 && rh75.value > 1.0);
    assert!((9.0..12.0).contains(&profile.top_samples.value));
}

/// A waveform that the block ends, one that it begins, a clipped one, and one that is too weak.
#[test]
fn what_is_missing_is_flagged_and_unknown() {
    let model = wide_channel(&ArNoise::new(&[], 1.0).unwrap());
    let mut targets = DistributedTargets::new(&model).unwrap();
    let echoes = [(30.0, 60.0), (40.0, 66.0), (90.0, 120.0)];
    let of = |targets: &mut DistributedTargets, samples: &[u16]| targets.profile(samples, 0.0).unwrap();
    let samples = waveform(&model, &echoes, SAMPLES);
    let whole = of(&mut targets, &samples);
    assert_eq!((whole.flags, whole.peaks), (0, 2));

    let cut = of(&mut targets, &samples[..119]);
    assert_eq!(cut.flags, GROUND_MISSING);
    assert!(cut.last_peak_samples.value.is_nan() && cut.top_samples.sd.is_nan());
    assert!(cut.heights_samples.iter().all(|height| height.value.is_nan() && height.sd.is_nan()));

    // Only the foot of the ground is recorded.
    let foot = of(&mut targets, &samples[..116]);
    assert_eq!(foot.flags, GROUND_MISSING);

    let late = of(&mut targets, &samples[60..]);
    assert_eq!(late.flags, TOP_MISSING);
    assert!((late.last_peak_samples.value - 60.0).abs() < 0.3);
    assert!(late.heights_samples.iter().all(|height| height.value.is_nan()));

    let clipped = ChannelModel { full_scale_dn: 80.0, ..model.clone() };
    let clipped = of(&mut DistributedTargets::new(&clipped).unwrap(), &samples);
    assert_eq!(clipped.flags, CLIPPED);
    assert!(clipped.last_peak_samples.value.is_nan() && clipped.heights_samples[0].value.is_nan());

    // Above the threshold, but no significant mode.
    let noisy = wide_channel(&ArNoise::new(&[], 10.0).unwrap());
    let mut noisy = DistributedTargets::new(&noisy).unwrap();
    let weak = of(&mut noisy, &waveform(&model, &[(25.0, 140.0)], SAMPLES));
    assert_eq!((weak.flags, weak.peaks), (GROUND_MISSING, 0));
    assert!(weak.heights_samples[1].value.is_nan());
}

/// An echo that rings is one mode; a ground of its height behind it is one if the response has no
/// such ringing.
#[test]
fn ringing_is_no_ground() {
    let process = ArNoise::new(&[], 1.0).unwrap();
    let plain = wide_channel(&process);
    let mut values = vec![0.0; 240 * STEPS_PER_SAMPLE];
    let shape = |t: f64| (-FOUR_LN_2 * (t / FWHM_SAMPLES).powi(2)).exp();
    for (k, value) in values.iter_mut().enumerate() {
        let t = k as f64 / STEPS_PER_SAMPLE as f64 - 20.0;
        *value = shape(t) + 0.05 * shape(t - 20.0);
    }
    let node = ResponseNode { peak_dn: 100.0, values };
    let response = SystemResponse {
        first_sample: -20,
        nodes: vec![node],
        template_error: vec![0.0; 240],
        excess_part: 1.0,
        echoes: 1000,
        shape_sd: 0.0,
    };
    let ringing = ChannelModel { response: Some(response), ..plain.clone() };
    let samples = waveform(&ringing, &[(400.0, 100.0)], SAMPLES);
    let of = |model: &ChannelModel| DistributedTargets::new(model).unwrap().profile(&samples, 0.0).unwrap();
    let (known, unknown) = (of(&ringing), of(&plain));
    assert_eq!((known.peaks, unknown.peaks), (1, 2));
    assert!((known.last_peak_samples.value - 100.0).abs() < 0.1, "{known:?}");
}

#[test]
fn noise_and_short_blocks_have_no_profile() {
    let model = wide_channel(&ArNoise::new(&[], 1.0).unwrap());
    let mut targets = DistributedTargets::new(&model).unwrap();
    assert_eq!(targets.profile(&[10; 60], 0.0), None);
    assert_eq!(targets.profile(&waveform(&model, &[], 60), 0.0), None);
    assert_eq!(targets.profile(&[10, 80, 10], 0.0), None);
    assert_eq!(targets.profile(&[], 0.0), None);
}
