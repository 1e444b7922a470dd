use super::*;
use crate::noise::ArNoise;
use crate::shape::FOUR_LN_2;
use crate::simulated::{Random, analogue, channel, digitised, moments, pulse};

const FULL_SCALE_DN: f64 = 255.0;

/// Pairs of echoes of 100 to 250 DN in the low-power receiver, with the noise of the high-power
/// receiver.
fn pairs(random: &mut Random, count: usize, gain: f64, delay_ns: impl Fn(f64) -> f64) -> Vec<Pair> {
    let span = |random: &mut Random| 100.0 + 150.0 * random.uniform();
    let pair = |low_power_dn: f64, random: &mut Random| Pair {
        low_power_dn,
        high_power_dn: low_power_dn / gain + 0.3 * random.normal(),
        delay_ns: delay_ns(low_power_dn) + 10.0 / low_power_dn * random.normal(),
    };
    (0..count)
        .map(|_| {
            let low_power_dn = span(random);
            pair(low_power_dn, random)
        })
        .collect()
}

#[test]
fn the_plain_peak_of_a_gaussian_is_exact() {
    for phase in [0.0, 0.2, 0.5, 0.9] {
        let place = 20.0 + phase;
        let signal: Vec<f64> =
            (0..48).map(|k| 30.0 * (-FOUR_LN_2 * ((f64::from(k) - place) / 4.4).powi(2)).exp()).collect();
        let peak = plain_peak_of(&signal).unwrap();
        assert!((peak.position_samples - place).abs() < 1e-9, "{peak:?}");
        assert!((peak.height_dn - 30.0).abs() < 1e-9, "{peak:?}");
    }
}

#[test]
fn what_is_no_whole_unsaturated_peak_has_no_place() {
    let samples: Vec<u16> = [2; 12].into_iter().chain([20, 60, 90, 60, 20]).chain([2; 12]).collect();
    let peak = plain_peak(&samples, FULL_SCALE_DN).unwrap();
    assert!((peak.position_samples - 14.0).abs() < 1e-9, "{peak:?}");
    assert_eq!(plain_peak(&samples, 90.0), None, "saturated");
    assert_eq!(plain_peak(&samples[8..], FULL_SCALE_DN), None, "no samples for the background");
    assert_eq!(plain_peak(&samples[..15], FULL_SCALE_DN), None, "cut off");
    assert_eq!(plain_peak(&[7; 40], FULL_SCALE_DN), None, "flat");
    assert_eq!(plain_peak(&[], FULL_SCALE_DN), None);
}

#[test]
fn the_noise_of_leads_is_that_of_the_samples() {
    let mut random = Random::new(3);
    let blocks: Vec<Vec<u16>> =
        (0..4000).map(|_| (0..8).map(|_| (20.0 + 3.0 * random.normal()).round() as u16).collect()).collect();
    let sd = lead_noise_sd_dn(blocks.iter().map(Vec::as_slice));
    assert!((sd / 3.0 - 1.0).abs() < 0.05, "{sd}");
    assert!(lead_noise_sd_dn(std::iter::empty()).is_nan());
}

#[test]
fn a_mean_without_outliers_is_the_weighted_one_and_outliers_do_not_move_it() {
    let mut random = Random::new(4);
    let mut values: Vec<(f64, f64)> = (0..1000)
        .map(|i| {
            let sd = 1.0 + f64::from(i % 4);
            (5.0 + sd * random.normal(), 1.0 / (sd * sd))
        })
        .collect();
    let weights: f64 = values.iter().map(|(_, w)| w).sum();
    let plain = values.iter().map(|(x, w)| x * w).sum::<f64>() / weights;
    let (mean, sd) = robust_mean(values.iter().copied());
    assert!((mean - plain).abs() < 0.5 * sd, "{mean} {plain}");
    assert!((sd * weights.sqrt() - 1.0).abs() < 0.1, "{sd}");
    values.extend((0..200).map(|_| (500.0, 1.0)));
    let (robust, _) = robust_mean(values.into_iter());
    assert!((robust - plain).abs() < 2.0 * sd, "{robust}");
    assert_eq!(robust_mean([(2.0, 1.0), (2.0, 1.0)].into_iter()), (2.0, 0.0));
    assert!(robust_mean(std::iter::empty()).0.is_nan());
}

#[test]
fn values_that_fall_are_pooled() {
    assert_eq!(pooled(&[(1.0, 1.0), (3.0, 1.0), (2.0, 1.0), (4.0, 1.0)]), [1.0, 2.5, 2.5, 4.0]);
    assert_eq!(pooled(&[(3.0, 1.0), (2.0, 1.0), (1.0, 1.0)]), [2.0, 2.0, 2.0]);
    assert_eq!(pooled(&[]), [0.0; 0]);
}

#[test]
fn gain_and_delay_are_found_to_within_their_standard_deviations() {
    let mut scores = [Vec::new(), Vec::new()];
    for seed in 0..60 {
        let pairs = pairs(&mut Random::new(seed), 300, 9.0, |_| 0.52);
        let fusion = estimate(&pairs, FULL_SCALE_DN, 0.3).unwrap();
        assert_eq!(fusion.walk, [], "no walk");
        scores[0].push((fusion.gain_ratio - 9.0) / fusion.gain_ratio_sd);
        scores[1].push((fusion.delay_ns - 0.52) / fusion.delay_sd_ns);
    }
    for scores in scores {
        let (mean, sd) = moments(&scores);
        assert!(mean.abs() < 0.4 && (0.75..1.3).contains(&sd), "{mean} {sd}");
    }
}

#[test]
fn delays_of_the_overdriven_receiver_depend_on_height() {
    let delay = |dn: f64| 0.65 - 0.004 * (dn - 210.0).max(0.0);
    let fusion = estimate(&pairs(&mut Random::new(1), 4000, 9.0, delay), FULL_SCALE_DN, 0.3).unwrap();
    assert!((fusion.delay_ns - 0.65).abs() < 4.0 * fusion.delay_sd_ns, "{fusion:?}");
    for dn in [100.0, 220.0, 230.0, 240.0] {
        let (walk_ns, sd_ns) = fusion.walk_ns(dn);
        assert!((walk_ns - (delay(dn) - 0.65)).abs() < 0.004 + 4.0 * sd_ns, "{dn}: {walk_ns} {sd_ns}");
    }
    assert!(fusion.walk.windows(2).all(|pair| pair[1].delay_ns <= pair[0].delay_ns), "monotone");
    let (end_ns, sd_ns) = fusion.walk_ns(2000.0);
    assert!(end_ns < -0.1 && sd_ns > 0.9 * end_ns.abs(), "extrapolation is uncertain: {end_ns} {sd_ns}");
}

/// Estimate, proof, and what is kept.
fn proven(pairs: &[Pair]) -> (ChannelFusion, FusionProof, ChannelFusion) {
    let fusion = estimate(pairs, FULL_SCALE_DN, 0.3).unwrap();
    let proof = prove(&fusion, pairs, FULL_SCALE_DN, 0.3);
    let mut kept = fusion.clone();
    kept.keep_proven(&proof);
    (fusion, proof, kept)
}

#[test]
fn what_both_halves_show_is_kept() {
    let delay = |dn: f64| 0.65 - 0.004 * (dn - 210.0).max(0.0);
    for seed in 0..20 {
        // A tenth of the pairs are two echoes.
        let mut some = pairs(&mut Random::new(seed), 4000, 9.0, delay);
        some.iter_mut().step_by(10).for_each(|pair| pair.delay_ns += 4.0);
        let (fusion, proof, kept) = proven(&some);
        assert!(!fusion.walk.is_empty());
        assert_eq!(fusion, kept, "{proof:?}");
        let (fusion, proof, kept) = proven(&pairs(&mut Random::new(seed), 60, 9.0, |_| 0.5));
        assert!(FusionProof::is_proven(proof.gain_falls) && fusion == kept, "{proof:?}");
    }
}

#[test]
fn a_delay_of_one_half_is_not_applied() {
    let mut some = pairs(&mut Random::new(1), 2000, 9.0, |_| 0.5);
    // Odd twentieths of the recording have the opposite delay, and a larger part of it.
    for (i, pair) in some.iter_mut().enumerate() {
        pair.delay_ns *= if (i / 100) % 2 == 1 { -1.3 } else { 1.0 };
    }
    let (fusion, proof, kept) = proven(&some);
    assert!(!FusionProof::is_proven(proof.delay_falls), "{proof:?}");
    assert_eq!(kept.delay_ns, 0.0);
    assert!(kept.delay_sd_ns >= fusion.delay_ns.abs());
    assert!(FusionProof::is_proven(proof.gain_falls));
}

#[test]
fn no_delay_is_not_applied() {
    let (fusion, _, kept) = proven(&pairs(&mut Random::new(2), 300, 9.0, |_| 0.0));
    assert_eq!(kept.delay_ns, 0.0);
    assert!(kept.delay_sd_ns < 0.02, "{kept:?} {fusion:?}");
}

#[test]
fn a_walk_of_one_half_is_not_applied() {
    let mut some = pairs(&mut Random::new(3), 4000, 9.0, |_| 0.5);
    let mut overdriven: Vec<&mut Pair> =
        some.iter_mut().filter(|pair| pair.low_power_dn >= OVERDRIVEN_PART * FULL_SCALE_DN).collect();
    let count = overdriven.len();
    for (i, pair) in overdriven.iter_mut().enumerate() {
        pair.delay_ns += if (i * 20 / count) % 2 == 1 { 0.4 } else { -0.1 };
    }
    let (fusion, proof, kept) = proven(&some);
    assert!(!fusion.walk.is_empty(), "{fusion:?}");
    assert!(!FusionProof::is_proven(proof.walk_falls.unwrap()), "{proof:?}");
    let [was, is] = [&fusion, &kept].map(|fusion| fusion.walk_ns(240.0));
    assert_eq!(is.0, 0.0);
    assert!(is.1 > was.0.abs() && was.0.abs() > 0.01, "{was:?} {is:?}");
}

#[test]
fn heights_without_relation_prove_no_gain() {
    let mut random = Random::new(4);
    let mut some = pairs(&mut random, 400, 1.0, |_| 0.5);
    for (i, pair) in some.iter_mut().enumerate() {
        pair.high_power_dn *= if (i / 20) % 2 == 1 { 1.5 } else { 0.7 };
    }
    let (_, proof, _) = proven(&some);
    assert!(!FusionProof::is_proven(proof.gain_falls), "{proof:?}");
}

#[test]
fn few_or_weak_echoes_calibrate_no_fusion() {
    let mut random = Random::new(2);
    let few = pairs(&mut random, MIN_PAIRS - 1, 9.0, |_| 0.5);
    assert_eq!(estimate(&few, FULL_SCALE_DN, 0.3), None);
    assert_eq!(estimate(&[], FULL_SCALE_DN, 0.3), None);
    let many = pairs(&mut random, 200, 9.0, |_| 0.5);
    assert!(estimate(&many, FULL_SCALE_DN, 0.3).is_some());
    assert_eq!(estimate(&many, FULL_SCALE_DN, 30.0), None, "all below the noise");
}

#[test]
fn a_gain_that_changes_with_height_is_not_relied_upon() {
    let mut random = Random::new(5);
    let mut bent = pairs(&mut random, 1000, 9.0, |_| 0.5);
    bent.iter_mut().for_each(|pair| pair.high_power_dn *= pair.low_power_dn / 150.0);
    let fusion = estimate(&bent, FULL_SCALE_DN, 0.3).unwrap();
    assert!(fusion.gain_ratio_sd / fusion.gain_ratio > 0.5, "{fusion:?}");
}

#[test]
fn between_models_of_one_shape_plain_peaks_need_no_correction() {
    let process = ArNoise::new(&[], 1.0).unwrap();
    let model = channel(&process, 4.4, 10.0);
    let fusion = estimate(&pairs(&mut Random::new(6), 300, 9.0, |_| 0.5), FULL_SCALE_DN, 0.3).unwrap();
    let between = fusion.between_models(&model, &model).unwrap();
    assert!(
        (between.delay_ns - fusion.delay_ns).abs() < 1e-9
            && (between.gain_ratio - fusion.gain_ratio).abs() < 1e-9
    );
}

/// Uncertainty of the position of a Gaussian in white noise.
///
/// For height `a` and width `W` and dense sampling its variance is `σ² / (a² Σ s'²)` with `Σ s'² =
/// √(π/2) √(4 ln 2) / W`, independent of height and width.
#[test]
fn the_fit_alone_has_the_closed_forms_uncertainty() {
    let process = ArNoise::new(&[], 1.0).unwrap();
    let model = channel(&process, 4.4, 10.0);
    let mut fit = JointFit::new(&model, 0.005).unwrap();
    let signal = analogue(&mut Random::new(7), &process, 60, 10.0, 4.4, &[pulse(120.0, 25.3, 1.0)]);
    let alone = JointPulse { start: [100f64.ln(), 25.0, 0.1], expected: None, ln_width_precision: 0.0 };
    fit.fit(&digitised(&signal, 255), [alone].into_iter()).unwrap();
    let found = fit.fitted()[0];
    let slope = (std::f64::consts::FRAC_PI_2 * FOUR_LN_2).sqrt() / 4.4;
    let exact = model.noise_sd_dn / (120.0 * slope.sqrt());
    assert!((found.covariance[1][1].sqrt() / exact - 1.0).abs() < 0.03, "{found:?} {exact}");
    assert!((found.value[1] - 25.3).abs() < 5.0 * exact, "{found:?}");
}

/// Two measurements of one quantity: the joint fit is their inverse-variance mean, with the
/// corresponding variance.
#[test]
fn what_is_expected_of_a_place_is_averaged_with_what_is_seen() {
    let process = ArNoise::new(&[], 1.0).unwrap();
    let model = channel(&process, 4.4, 10.0);
    let mut fit = JointFit::new(&model, 0.005).unwrap();
    let samples =
        digitised(&analogue(&mut Random::new(8), &process, 60, 10.0, 4.4, &[pulse(120.0, 25.3, 1.0)]), 255);
    let start = [120f64.ln(), 25.3, 0.0];
    let pulse = |expected| JointPulse { start, expected, ln_width_precision: 0.0 };
    fit.fit(&samples, [pulse(None)].into_iter()).unwrap();
    let seen = fit.fitted()[0];
    let (variance, off) = (4.0 * seen.covariance[1][1], 2.0 * seen.covariance[1][1].sqrt());
    let mut covariance = [[0.0; 3]; 3];
    (covariance[0][0], covariance[1][1], covariance[2][2]) = (1e4, variance, 1e4);
    let expected = Expected { mean: [seen.value[0], seen.value[1] + off, seen.value[2]], covariance };
    fit.fit(&samples, [pulse(Some(expected))].into_iter()).unwrap();
    let joint = fit.fitted()[0];
    assert!((joint.value[1] - (seen.value[1] + 0.2 * off)).abs() < 0.01 * off, "{joint:?} {seen:?}");
    assert!((joint.covariance[1][1] / (0.8 * seen.covariance[1][1]) - 1.0).abs() < 0.01);
    assert!((joint.distance - (0.8 * off).powi(2) / variance).abs() < 0.02, "{joint:?}");
}

#[test]
fn a_saturated_pulse_is_fitted_from_its_flanks_and_what_is_expected() {
    let process = ArNoise::new(&[], 1.0).unwrap();
    let model = channel(&process, 4.4, 10.0);
    let mut fit = JointFit::new(&model, 0.005).unwrap();
    let mut random = Random::new(9);
    let mut scores = Vec::new();
    for _ in 0..200 {
        let place = 25.0 + random.uniform();
        let values = analogue(&mut random, &process, 60, 10.0, 4.4, &[pulse(1500.0, place, 1.0)]);
        let samples = digitised(&values, 255);
        let sd = [0.01, 0.03, 0.01];
        let truth = [1500f64.ln(), place, 0.0];
        let mean = std::array::from_fn(|part| truth[part] + sd[part] * random.normal());
        let covariance =
            std::array::from_fn(|a| std::array::from_fn(|b| if a == b { sd[a] * sd[a] } else { 0.0 }));
        let expected = Some(Expected { mean, covariance });
        let pulse = JointPulse { start: mean, expected, ln_width_precision: 0.0 };
        fit.fit(&samples, [pulse].into_iter()).unwrap();
        let found = fit.fitted()[0];
        assert!(
            found.covariance[1][1].sqrt() < 0.5 * sd[1],
            "flanks add information to the prior: {found:?}"
        );
        scores.push((found.value[1] - place) / found.covariance[1][1].sqrt());
    }
    let (mean, sd) = moments(&scores);
    assert!(mean.abs() < 0.25 && (0.85..1.15).contains(&sd), "{mean} {sd}");
}

#[test]
fn what_is_no_covariance_is_refused() {
    let process = ArNoise::new(&[], 1.0).unwrap();
    let mut fit = JointFit::new(&channel(&process, 4.4, 10.0), 0.005).unwrap();
    let expected = Some(Expected { mean: [4.0, 20.0, 0.0], covariance: [[0.0; 3]; 3] });
    let pulse = JointPulse { start: [4.0, 20.0, 0.0], expected, ln_width_precision: 0.0 };
    assert_eq!(fit.fit(&[10; 60], [pulse].into_iter()), None);
}

#[test]
fn twenty_overdriven_echoes_make_the_walk_known() {
    let of_height =
        |low_power_dn: f64| Pair { low_power_dn, high_power_dn: low_power_dn / 9.0, delay_ns: 0.5 };
    let known = |overdriven: usize| {
        let linear = (0..40).map(|k| of_height(100.0 + f64::from(k)));
        let pairs: Vec<Pair> = linear.chain((0..overdriven).map(|_| of_height(240.0))).collect();
        estimate(&pairs, FULL_SCALE_DN, 0.3).unwrap().walk_is_known
    };
    assert_eq!([19, 20].map(known), [false, true]);
}
