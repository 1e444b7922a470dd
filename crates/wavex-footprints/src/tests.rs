//! Footprints of known ground and canopy.

use super::*;

const SAMPLES: usize = 900;
const LEVEL_DN: f64 = 210.0;
const GROUND: f64 = 520.4;
/// SD of the outgoing pulse, samples.
const PULSE_SD: f64 = 6.6;

/// Noise that neighbours share, of SD 1.5 DN, about the level.
fn noise(seed: u32) -> Vec<f64> {
    let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(1);
    let mut white = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (f64::from(state >> 8) / f64::from(1 << 24) - 0.5) * 12f64.sqrt()
    };
    let white: Vec<f64> = (0..SAMPLES + 4).map(|_| white()).collect();
    white.windows(5).map(|near| LEVEL_DN + 1.5 * near.iter().sum::<f64>() / 5f64.sqrt()).collect()
}

/// A waveform with echoes: height, position and SD in samples.
fn waveform(seed: u32, echoes: &[[f64; 3]]) -> Vec<f32> {
    let of = |k: usize, [height, at, sd]: [f64; 3]| height * (-0.5 * ((k as f64 - at) / sd).powi(2)).exp();
    let signal = |k: usize| echoes.iter().map(|echo| of(k, *echo)).sum::<f64>();
    noise(seed).into_iter().enumerate().map(|(k, dn)| (dn + signal(k)) as f32).collect()
}

fn model() -> FootprintModel {
    let mut learner = FootprintLearner::new(1.0, 15.5);
    for seed in 0..40 {
        let pulse = |k: usize| 200.0 + 900.0 * (-0.5 * ((k as f64 - 60.25) / PULSE_SD).powi(2)).exp();
        learner.add_outgoing(&(0..128).map(|k| pulse(k) as f32).collect::<Vec<_>>());
        learner.add_waveform(&waveform(seed, &[[150.0, GROUND, PULSE_SD]]));
    }
    learner.finish().unwrap()
}

fn measured(settings: FootprintSettings, seed: u32, echoes: &[[f64; 3]]) -> Measured {
    FootprintEstimator::new(&model(), settings).measure(&waveform(seed, echoes), None).unwrap()
}

#[test]
fn noise_and_pulse_are_learnt() {
    let model = model();
    assert!((model.pulse_fwhm_ns - 2.3548 * PULSE_SD).abs() < 0.3, "{}", model.pulse_fwhm_ns);
    assert!((model.noise_sd_dn - 1.5).abs() < 0.1, "{}", model.noise_sd_dn);
    for (lag, expected) in [1.0, 0.8, 0.6, 0.4, 0.2, 0.0].into_iter().enumerate() {
        assert!(
            (model.autocorrelation[lag] - expected).abs() < 0.05,
            "lag {lag}: {}",
            model.autocorrelation[lag]
        );
    }
}

/// A model from elsewhere has numbers of a receiver, and lists of the lengths that are learnt.
#[test]
fn models_with_wrong_numbers_are_refused() {
    let wrong = |change: fn(&mut FootprintModel)| {
        let mut model = model();
        change(&mut model);
        model.check().map_err(|error| error.to_string())
    };
    assert_eq!(wrong(|_| ()), Ok(()));
    let error = |change| wrong(change).unwrap_err();
    assert_eq!(
        error(|model| model.noise_sd_dn = f64::NAN),
        "`noise_sd_dn` must be from 0 to 1000000, got NaN"
    );
    assert_eq!(
        error(|model| model.sampling_interval_ns = 0.0),
        "`sampling_interval_ns` must be from 0.01 to 100, got 0"
    );
    assert_eq!(
        error(|model| model.autocorrelation.truncate(model.autocorrelation.len() - 1)),
        "`autocorrelation` must have 16 values, got 15"
    );
    assert_eq!(error(|model| model.response.clear()), "`response` must have 4 to 65536 values, got 0");
    for (field, change) in [
        ("autocorrelation", (|model| model.autocorrelation[3] = f64::INFINITY) as fn(&mut FootprintModel)),
        ("response", |model| model.response[7] = -3.0),
        ("pulse_fwhm_ns", |model| model.pulse_fwhm_ns = 1e9),
        ("samples_per_independent", |model| model.residual_noise.samples_per_independent = f64::NAN),
        ("variance_ratio_per_dn", |model| model.residual_noise.variance_ratio_per_dn = -1.0),
    ] {
        assert!(error(change).starts_with(&format!("`{field}` must be from ")), "{}", error(change));
    }
}

/// Errors of positions are as large as the noise makes them; the shift by slope is added to the ground alone.
#[test]
fn positions_have_the_sd_of_the_noise() {
    let model = model();
    let mut estimator = FootprintEstimator::new(&model, FootprintSettings::default());
    let mut scores = Vec::new();
    for seed in 100..400 {
        let echoes = [[60.0, 380.3, PULSE_SD], [150.0, GROUND, PULSE_SD]];
        let found = estimator.measure(&waveform(seed, &echoes), None).unwrap();
        let [canopy, ground] = found.modes.as_slice() else { panic!("{} modes", found.modes.len()) };
        scores.push((canopy.position_samples.value - 380.3) / canopy.position_samples.sd);
        assert!((ground.position_samples.value - GROUND).abs() < 0.5 && ground.position_samples.sd > 0.1);
    }
    let square = scores.iter().map(|score| score * score).sum::<f64>() / scores.len() as f64;
    assert!((0.85..1.15).contains(&square.sqrt()), "{}", square.sqrt());
}

#[test]
fn heights_and_energy_follow_from_the_echoes() {
    let found = measured(
        FootprintSettings::default(),
        7,
        &[[100.0, GROUND - 100.0, PULSE_SD], [100.0, GROUND, PULSE_SD]],
    );
    let of = |percent: usize| found.heights_samples[percent].value;
    assert!(of(25).abs() < 2.0 && (of(75) - 100.0).abs() < 2.0, "{} {}", of(25), of(75));
    assert!((found.ground_energy_ratio.value - 0.5).abs() < 0.02, "{:?}", found.ground_energy_ratio);
    assert!((found.energy_dn.value - 200.0).abs() < 5.0, "{:?}", found.energy_dn);
    assert!(found.sensitivity > 0.9 && found.sensitivity < 1.0, "{}", found.sensitivity);
}

#[test]
fn noise_has_neither_modes_nor_ground() {
    for seed in 1000..1200 {
        let found = measured_by(seed, &[]);
        assert!(
            found.modes.is_empty() && found.ground().is_none() && found.energy_dn.value.is_nan(),
            "{found:?}"
        );
    }
}

/// With the default settings, from one model.
fn measured_by(seed: u32, echoes: &[[f64; 3]]) -> Measured {
    thread_local!(static MODEL: FootprintModel = model());
    MODEL.with(|model| {
        let mut estimator = FootprintEstimator::new(model, FootprintSettings::default());
        estimator.measure(&waveform(seed, echoes), None).unwrap()
    })
}

#[test]
fn a_signal_that_is_cut_off_has_no_ground() {
    let found = measured_by(3, &[[100.0, 700.0, PULSE_SD], [100.0, 899.0, PULSE_SD]]);
    assert!(
        found.is_cut[1] && found.ground().is_none() && found.heights_samples[50].value.is_nan(),
        "{found:?}"
    );
    assert!(measured_by(4, &[[100.0, 0.0, PULSE_SD], [100.0, 500.0, PULSE_SD]]).is_cut[0]);
}

#[test]
fn presets_are_the_groups_of_the_product() {
    let echoes = [[100.0, GROUND - 17.0, PULSE_SD], [100.0, GROUND, PULSE_SD]];
    let modes = |group: u8| measured(FootprintSettings::gedi_l2a(group).unwrap(), 5, &echoes).modes.len();
    assert!(modes(1) < modes(2), "the narrower kernel separates more");
    assert!(FootprintSettings::gedi_l2a(0).is_none() && FootprintSettings::gedi_l2a(7).is_none());
}

#[test]
fn what_cannot_be_measured_gives_none() {
    let model = model();
    let mut estimator = FootprintEstimator::new(&model, FootprintSettings::default());
    for samples in [&[][..], &[1.0; 20], &[f32::NAN; 900], &[0.0; MOST_SAMPLES + 1]] {
        assert_eq!(estimator.measure(samples, None), None);
    }
}

#[test]
fn too_few_shots_are_an_error() {
    let mut learner = FootprintLearner::new(1.0, 15.5);
    learner.add_waveform(&waveform(1, &[]));
    assert_eq!(learner.finish(), Err(LearningError::TooFewPulses { found: 0 }));
}

/// Waveforms of bare ground have the narrowest echoes; a layer that merges with the ground, a second echo and noise do not.
#[test]
fn narrow_echoes_replace_outgoing_pulses() {
    let width = |echoes: &[[f64; 3]]| EchoWidth::of(&waveform(1, echoes));
    let bare = width(&[[150.0, GROUND, PULSE_SD]]).unwrap();
    assert!((bare.fwhm_samples - 2.3548 * PULSE_SD).abs() < 0.5, "{bare:?}");
    assert!((bare.spread_samples - 2.5066 * PULSE_SD).abs() < 1.0, "{bare:?}");
    for others in [[150.0, GROUND, 1.5 * PULSE_SD], [60.0, GROUND - 30.0, PULSE_SD]] {
        let wide = width(&[[150.0, GROUND, PULSE_SD], others]).unwrap();
        assert!(wide.spread_samples > 1.2 * bare.spread_samples, "{others:?}: {wide:?}");
    }
    // A signal in the first fifth does not raise the level.
    let high = width(&[[150.0, GROUND, PULSE_SD], [60.0, 90.0, 40.0]]).unwrap();
    assert!((high.spread_samples / bare.spread_samples - 1.0).abs() < 0.1, "{high:?}");
    assert_eq!(width(&[]), None);
    assert_eq!(width(&[[20.0, GROUND, PULSE_SD]]), None, "weak");
    assert_eq!(EchoWidth::of(&[]), None);
    let mut learner = FootprintLearner::new(1.0, 15.5);
    for seed in 0..40 {
        let samples = waveform(seed, &[[150.0, GROUND + 0.1 * f64::from(seed), PULSE_SD]]);
        learner.add_echo(&samples);
        learner.add_waveform(&samples);
    }
    let [of_echoes, of_outgoing] = [learner.finish().unwrap(), model()].map(|model| model.pulse_fwhm_ns);
    assert!((of_echoes - of_outgoing).abs() < 0.4, "{of_echoes} {of_outgoing}");
}

/// Deviations of 300 shots, ordered.
fn deviations(model: &FootprintModel, noise_per_dn: f64) -> Vec<f64> {
    let mut estimator = FootprintEstimator::new(model, FootprintSettings::default());
    let of = |seed| estimator.measure(&photons(seed, noise_per_dn), None).unwrap().deviation;
    let mut deviations: Vec<f64> = (500..800).map(of).collect();
    deviations.sort_unstable_by(f64::total_cmp);
    deviations
}

/// A canopy above ground whose noise grows with the signal: the added variance per DN over that of the background.
fn photons(seed: u32, noise_per_dn: f64) -> Vec<f32> {
    let echoes = [[60.0, 380.3, 20.0], [150.0, GROUND, PULSE_SD]];
    let clean = |k: usize| {
        let of = |[height, at, sd]: [f64; 3]| height * (-0.5 * ((k as f64 - at) / sd).powi(2)).exp();
        echoes.into_iter().map(of).sum::<f64>()
    };
    let samples = noise(seed).into_iter().enumerate().map(|(k, dn)| {
        (LEVEL_DN + (dn - LEVEL_DN) * (1.0 + noise_per_dn * clean(k)).sqrt() + clean(k)) as f32
    });
    samples.collect()
}

#[test]
fn deviations_of_profiles_are_those_of_noise() {
    let model = model();
    let found = deviations(&model, 0.0);
    let [low, median, high] = [3, 150, 296].map(|k| found[k]);
    assert!(median.abs() < 0.5 && low > -5.0 && high < 5.0, "{low} {median} {high}");
    let spread = 0.5 * (found[252] - found[47]);
    assert!((0.8..1.25).contains(&spread), "{spread}");
    let mut samples = photons(1, 0.0);
    samples[450] += 20.0;
    let mut estimator = FootprintEstimator::new(&model, FootprintSettings::default());
    let deviation = estimator.measure(&samples, None).unwrap().deviation;
    assert!(deviation > 5.0, "a single sample: {deviation}");
}

/// Noise that grows with the signal is not a deviation.
#[test]
fn noise_of_the_signal_is_learnt() {
    let mut learner = FootprintLearner::new(1.0, 15.5);
    for seed in 0..40 {
        let pulse = |k: usize| 200.0 + 900.0 * (-0.5 * ((k as f64 - 60.25) / PULSE_SD).powi(2)).exp();
        learner.add_outgoing(&(0..128).map(|k| pulse(k) as f32).collect::<Vec<_>>());
        learner.add_waveform(&photons(seed, 0.05));
    }
    let learnt = learner.finish().unwrap();
    let per_dn = learnt.residual_noise.variance_ratio_per_dn;
    assert!((per_dn - 0.05).abs() < 0.01, "{per_dn}");
    let median = deviations(&learnt, 0.05)[150];
    assert!(median.abs() < 0.5, "{median}");
    assert!(deviations(&model(), 0.05)[150] > 3.0, "without it");
}

/// A ground that merges with a layer of twice its height is the second candidate.
#[test]
fn a_hidden_ground_is_the_second_candidate() {
    let found = measured_by(5, &[[60.0, GROUND - 20.0, 9.0], [25.0, GROUND, PULSE_SD]]);
    let second = found.second_ground.unwrap();
    let distance = (second.position_samples.value - GROUND).abs();
    assert!(distance < 3.0 * second.position_samples.sd && found.ground_probability < 0.5, "{found:?}");
    assert!(second.probability > found.ground_probability, "{second:?}");
    assert!(found.ground_total_sd_samples > 3.0 * found.ground().unwrap().position_samples.sd);
    let clear = measured_by(6, &[[60.0, GROUND - 100.0, 9.0], [150.0, GROUND, PULSE_SD]]);
    assert!(clear.ground_probability > 0.9 && clear.second_ground.is_none(), "{clear:?}");
}
