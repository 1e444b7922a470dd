use super::*;
use crate::noise::ArNoise;
use crate::simulated::{Random, channel, digitised, noise, pulse};

const FWHM_SAMPLES: f64 = 6.0;
const BACKGROUND_DN: f64 = 10.0;
const SAMPLES: usize = 240;
const TOP: f64 = 60.0;

/// A canopy of many echoes and a ground echo behind it.
struct Canopy {
    samples: Vec<u16>,
    ground: f64,
    heights: [f64; 4],
}

fn canopy(random: &mut Random, process: &ArNoise, model: &ChannelModel) -> Canopy {
    let depth = 60.0 + 20.0 * random.uniform();
    let ground = TOP + depth + 18.0 + random.uniform();
    let mut echoes: Vec<(f64, f64)> = (0..300)
        .map(|_| {
            let part = (random.uniform() + random.uniform() + random.uniform()) / 3.0;
            (TOP + depth * part, 6.0)
        })
        .collect();
    echoes.push((ground, 110.0));
    let mut values = noise(random, process, SAMPLES);
    values.iter_mut().for_each(|value| *value += BACKGROUND_DN);
    let shape = Shape::of(model).unwrap();
    for &(position, height_dn) in &echoes {
        // The sum of heights, spread over the canopy.
        let height_dn = if position == ground { height_dn } else { 0.25 * height_dn };
        shape.add(&pulse(height_dn, position, 1.0), 1.0, &mut values);
    }
    echoes.iter_mut().filter(|echo| echo.0 != ground).for_each(|echo| echo.1 *= 0.25);
    echoes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let energy: f64 = echoes.iter().map(|echo| echo.1).sum();
    let heights = RELATIVE_HEIGHTS.map(|part| {
        let mut sum = 0.0;
        let at = echoes.iter().find(|echo| {
            sum += echo.1;
            sum >= (1.0 - part) * energy
        });
        ground - at.unwrap().0
    });
    Canopy { samples: digitised(&values, 4095), ground, heights }
}

#[test]
fn heights_of_a_canopy_and_the_ground_are_found_within_their_uncertainty() {
    let process = ArNoise::new(&[0.4], 1.0).unwrap();
    let model = ChannelModel { full_scale_dn: 4095.0, ..channel(&process, FWHM_SAMPLES, BACKGROUND_DN) };
    let mut targets = DistributedTargets::new(&model, 0.0).unwrap();
    let mut random = Random::new(11);
    let (mut ground, mut heights, mut explained) = (Vec::new(), [(); 4].map(|()| Vec::new()), 0);
    let mut scores = Vec::new();
    for _ in 0..200 {
        let truth = canopy(&mut random, &process, &model);
        let profile = targets.profile(&truth.samples, 0, 0.0).unwrap();
        explained += u32::from(profile.deviation_ratio < 3.0);
        ground.push(profile.last_peak_samples.value - truth.ground);
        scores.push((profile.last_peak_samples.value - truth.ground) / profile.last_peak_samples.sd);
        for ((errors, height), truth) in heights.iter_mut().zip(profile.heights_samples).zip(truth.heights) {
            errors.push([height.value - truth, height.sd]);
        }
    }
    let rms = |values: &[f64]| (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt();
    println!("explained {explained} of 200; ground rms {:.3} samples, z {:.2}", rms(&ground), rms(&scores));
    for (part, errors) in RELATIVE_HEIGHTS.iter().zip(&heights) {
        let of: Vec<f64> = errors.iter().map(|e| e[0]).collect();
        let z: Vec<f64> = errors.iter().map(|e| e[0] / e[1]).collect();
        println!("RH{:.0}: rms {:.3} samples, z {:.2}", 100.0 * part, rms(&of), rms(&z));
    }
    assert!(explained >= 195 && rms(&ground) < 0.1 && (0.6..1.3).contains(&rms(&scores)));
    for errors in &heights {
        let errors_samples: Vec<f64> = errors.iter().map(|e| e[0]).collect();
        let scores: Vec<f64> = errors.iter().map(|e| e[0] / e[1]).collect();
        assert!(rms(&errors_samples) < 1.0 && (0.6..1.3).contains(&rms(&scores)));
    }
}

#[test]
fn a_flat_target_is_one_narrow_peak() {
    let process = ArNoise::new(&[], 1.0).unwrap();
    let model = channel(&process, FWHM_SAMPLES, BACKGROUND_DN);
    let mut targets = DistributedTargets::new(&model, 0.0).unwrap();
    let mut random = Random::new(5);
    let mut values = noise(&mut random, &process, 80);
    values.iter_mut().for_each(|value| *value += BACKGROUND_DN);
    Shape::of(&model).unwrap().add(&pulse(150.0, 40.3, 1.0), 1.0, &mut values);
    let profile = targets.profile(&digitised(&values, 255), 0, 0.0).unwrap();
    assert_eq!(profile.peaks, 1);
    assert_eq!(profile.first_peak_samples, profile.last_peak_samples);
    assert!((profile.last_peak_samples.value - 40.3).abs() < 0.3, "{profile:?}");
    assert!((profile.energy_dn.value - 150.0).abs() < 15.0, "{profile:?}");
    assert!(profile.deviation_ratio.abs() < 4.0, "{profile:?}");
}

#[test]
fn noise_and_short_blocks_have_no_profile() {
    let process = ArNoise::new(&[], 1.0).unwrap();
    let model = channel(&process, FWHM_SAMPLES, BACKGROUND_DN);
    let mut targets = DistributedTargets::new(&model, 0.0).unwrap();
    assert_eq!(targets.profile(&[10; 60], 0, 0.0), None);
    assert_eq!(targets.profile(&[10, 80, 10], 0, 0.0), None);
    assert_eq!(targets.profile(&[255; 60], 0, 0.0), None);
    assert_eq!(targets.profile(&[], 0, 0.0), None);
}
