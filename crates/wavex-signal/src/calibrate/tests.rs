use super::*;
use crate::shape::Pulse;
use crate::simulated::{Random, analogue, digitised, pulse};

const FWHM: f64 = 4.25;
/// Offset of each phase from the background of 20 DN, DN.
const PHASES: [f64; 4] = [0.3, -0.2, 0.1, -0.2];

fn process(sd: f64) -> ArNoise {
    let unit = ArNoise::new(&[0.8, -0.25], 1.0).unwrap();
    ArNoise::new(&[0.8, -0.25], sd / unit.sd()).unwrap()
}

/// Returns as over forest: 60 % flat, 40 % widened, 30 % with a second return.
fn echoes(random: &mut Random, sd: f64) -> Vec<Pulse> {
    let mut position = 14.0 + 12.0 * random.uniform();
    let mut pulses = vec![];
    for _ in 0..if random.uniform() < 0.3 { 2 } else { 1 } {
        let width = if random.uniform() < 0.6 { 1.0 } else { 1.05 + random.uniform() };
        pulses.push(pulse(sd * (15.0 + 85.0 * random.uniform()), position, width));
        position += 3.0 + 20.0 * random.uniform();
    }
    pulses
}

fn blocks(seed: u64, count: usize, drift_sd: f64) -> Vec<Vec<u16>> {
    let mut random = Random::new(seed);
    let process = process(2.0);
    (0..count)
        .map(|_| {
            let pulses = echoes(&mut random, 2.0);
            let level = 20.0 + drift_sd * random.normal();
            let mut values = analogue(&mut random, &process, 60, level, FWHM, &pulses);
            for (k, value) in values.iter_mut().enumerate() {
                *value += PHASES[k % 4];
            }
            digitised(&values, 255)
        })
        .collect()
}

fn views(blocks: &[Vec<u16>]) -> impl Iterator<Item = Waveform<'_>> + Clone {
    blocks.iter().map(|samples| Waveform { samples })
}

fn exact_lags() -> [f64; 6] {
    let mut lags = [0.0; 6];
    process(2.0).autocovariance_into(&mut lags);
    lags[0] += QUANTISATION_VARIANCE;
    lags
}

/// docs/explanation/accuracy.md, A10: σ within 1.5 %, background within 0.1 DN, width within 0.6 %.
#[test]
fn a_channel_is_found_from_blocks_that_all_hold_pulses() {
    let blocks = blocks(31, 4000, 0.0);
    let model = calibrate(views(&blocks), &CalibrationSettings::echoes(1.0, 255.0)).unwrap();
    println!("{model:?}");
    let lags = exact_lags();
    assert_eq!(model.background, Background::Fixed);
    assert!((model.noise_sd_dn / lags[0].sqrt() - 1.0).abs() < 0.015, "{}", model.noise_sd_dn);
    for (lag, got) in model.autocorrelation.iter().enumerate() {
        let exact = lags[lag + 1] / lags[0];
        assert!((got - exact).abs() < 0.02, "lag {}: {got} {exact}", lag + 1);
    }
    let truth = fit_by_bic(&lags, 100_000, 4).unwrap();
    assert!((model.innovation_sd_dn / truth.innovation_variance().sqrt() - 1.0).abs() < 0.015);
    for (phase, level) in PHASES.iter().enumerate() {
        assert!((model.background_dn[phase] - 20.0 - level).abs() < 0.1, "{:?}", model.background_dn);
    }
    assert!((model.pulse_fwhm_ns / FWHM - 1.0).abs() < 0.006, "{}", model.pulse_fwhm_ns);
    assert!(model.pulse_fwhm_sd_ns < 0.15 && model.pulses > 1000);
    assert_eq!(model.waveforms, 4000);
}

/// A third of the blocks have an undetectably weak echo before the strong one.
#[test]
fn weak_echoes_do_not_count_as_noise() {
    let mut random = Random::new(39);
    let process = process(2.0);
    let mut raised = NoiseStatistics::default();
    let blocks: Vec<_> = (0..6000)
        .map(|i| {
            let mut echoes = vec![pulse(60.0 + 100.0 * random.uniform(), 42.0 + 8.0 * random.uniform(), 1.0)];
            if i % 3 == 0 {
                let height = 2.0 * (0.5 + 2.5 * random.uniform());
                echoes.push(pulse(height, 3.0 + 28.0 * random.uniform(), 1.0));
            }
            let samples = digitised(&analogue(&mut random, &process, 60, 20.0, FWHM, &echoes), 255);
            raised.add(&samples[..33], 0);
            samples
        })
        .collect();
    let model = calibrate(views(&blocks), &CalibrationSettings::echoes(1.0, 255.0)).unwrap();
    let lags = exact_lags();
    let (all, left) = ((raised.variance() / lags[0]).sqrt(), model.noise_sd_dn / lags[0].sqrt());
    println!(
        "noise over the true noise: {all:.4} from all samples before the echo, {left:.4} from the model"
    );
    // Echoes below the threshold remain in the noise.
    assert!(all > 1.05, "{all}");
    assert!((left - 1.0).abs() < 0.025, "{left}");
    for (lag, got) in model.autocorrelation.iter().enumerate() {
        let exact = lags[lag + 1] / lags[0];
        assert!((got - exact).abs() < 0.02, "lag {}: {got} {exact}", lag + 1);
    }
    assert!(model.background_dn.iter().all(|level| (level - 20.0).abs() < 0.15), "{:?}", model.background_dn);
}

/// Half of the blocks contain two echoes with a common plateau, followed by the receiver's tail.
///
/// One Gaussian does not fit them, and unexplained samples are not free.
#[test]
fn saturated_blocks_without_pulse_are_no_noise() {
    let mut random = Random::new(41);
    let process = process(2.0);
    let blocks: Vec<_> = (0..2000)
        .map(|i| {
            let first = 16.0 + random.uniform();
            let echoes = match i % 2 {
                0 => vec![pulse(60.0 + 100.0 * random.uniform(), first, 1.0)],
                _ => [first, first + 6.0 + 3.0 * random.uniform()]
                    .map(|position| pulse(1000.0 + 1500.0 * random.uniform(), position, 1.0))
                    .into(),
            };
            let mut values = analogue(&mut random, &process, 60, 20.0, FWHM, &echoes);
            for (k, value) in values.iter_mut().enumerate() {
                let behind = |p: &Pulse| (k as f64 - p.position_samples - FWHM).max(0.0);
                let tail = |p: &Pulse| 0.02 * p.height_dn * behind(p) * (-behind(p) / 8.0).exp();
                *value += echoes.iter().map(tail).sum::<f64>();
            }
            digitised(&values, 255)
        })
        .collect();
    let model = calibrate(views(&blocks), &CalibrationSettings::echoes(1.0, 255.0)).unwrap();
    println!("{model:?}");
    assert_eq!(model.background, Background::Fixed);
    // Fourteen thousand free samples determine it to 1.3 %.
    assert!((model.noise_sd_dn / exact_lags()[0].sqrt() - 1.0).abs() < 0.04, "{}", model.noise_sd_dn);
    assert!(model.background_dn.iter().all(|level| (level - 20.0).abs() < 0.2), "{:?}", model.background_dn);
    assert!((model.pulse_fwhm_ns / FWHM - 1.0).abs() < 0.02, "{}", model.pulse_fwhm_ns);
}

/// A level drift of 1.5 times the noise is separated from the noise and selects a background per
/// waveform.
#[test]
fn a_drifting_background_is_each_waveforms_own() {
    let blocks = blocks(32, 3000, 3.0);
    let model = calibrate(views(&blocks), &CalibrationSettings::echoes(1.0, 255.0)).unwrap();
    println!("{model:?}");
    assert_eq!(model.background, Background::PerWaveform);
    assert!((model.background_sd_dn - 3.0).abs() < 0.15, "{}", model.background_sd_dn);
    assert!((model.noise_sd_dn / exact_lags()[0].sqrt() - 1.0).abs() < 0.02, "{}", model.noise_sd_dn);
    assert!((model.pulse_fwhm_ns / FWHM - 1.0).abs() < 0.01, "{}", model.pulse_fwhm_ns);
}

/// The setting of the background overrides the automatic choice.
#[test]
fn the_background_can_be_chosen() {
    let blocks = blocks(33, 1000, 0.0);
    let settings = CalibrationSettings {
        background: BackgroundChoice::PerWaveform,
        ..CalibrationSettings::echoes(1.0, 255.0)
    };
    let model = calibrate(views(&blocks), &settings).unwrap();
    assert_eq!(model.background, Background::PerWaveform);
    assert!(model.background_sd_dn > 0.0 && model.background_sd_dn < 1.0, "{}", model.background_sd_dn);
    assert!((model.noise_sd_dn / exact_lags()[0].sqrt() - 1.0).abs() < 0.05, "{}", model.noise_sd_dn);
    assert!((model.background_dn.iter().sum::<f64>() / 4.0 - 20.0).abs() < 0.1);
}

/// Pulses of 16 samples in blocks of 50 that begin on the rising edge, each on its own level: no
/// sample is free.
#[test]
fn blocks_without_a_free_sample_are_calibrated() {
    let mut random = Random::new(34);
    let white = ArNoise::new(&[], 1.0).unwrap();
    let blocks: Vec<_> = (0..300)
        .map(|_| {
            let echo = pulse(200.0 + 300.0 * random.uniform(), 16.0 + 6.0 * random.uniform(), 1.0);
            let level = 210.0 + 4.0 * random.normal();
            digitised(&analogue(&mut random, &white, 50, level, 16.0, &[echo]), 4095)
        })
        .collect();
    let model = calibrate(views(&blocks), &CalibrationSettings::echoes(1.0, 4095.0)).unwrap();
    println!("{model:?}");
    assert_eq!(model.background, Background::PerWaveform);
    assert!((model.pulse_fwhm_ns / 16.0 - 1.0).abs() < 0.01, "{}", model.pulse_fwhm_ns);
    let exact = (1.0 + QUANTISATION_VARIANCE).sqrt();
    assert!((model.noise_sd_dn / exact - 1.0).abs() < 0.05, "{}", model.noise_sd_dn);
    assert!((model.background_dn[0] - 210.0).abs() < 1.0, "{:?}", model.background_dn);
    assert!((model.background_sd_dn / (WIDE * 4.0) - 1.0).abs() < 0.2, "{}", model.background_sd_dn);
}

/// Blocks of 24 samples, a tenth of the blocks of a reference flight.
#[test]
fn a_short_reference_channel_is_calibrated() {
    let mut random = Random::new(35);
    let process = process(0.8);
    let blocks: Vec<_> = (0..100)
        .map(|_| {
            let outgoing = pulse(180.0, 11.0 + random.uniform(), 1.0);
            digitised(&analogue(&mut random, &process, 24, 2.2, 4.5, &[outgoing]), 255)
        })
        .collect();
    let model = calibrate(views(&blocks), &CalibrationSettings::reference(1.0, 255.0)).unwrap();
    println!("{model:?}");
    assert_eq!(model.background, Background::Fixed);
    assert!((model.pulse_fwhm_ns / 4.5 - 1.0).abs() < 0.005, "{}", model.pulse_fwhm_ns);
    let exact = (0.64 + QUANTISATION_VARIANCE).sqrt();
    assert!((model.noise_sd_dn / exact - 1.0).abs() < 0.15, "{}", model.noise_sd_dn);
    assert!(model.background_dn.iter().all(|level| (level - 2.2).abs() < 0.4), "{:?}", model.background_dn);
}

#[test]
fn too_few_blocks_are_counted() {
    let blocks = blocks(36, 150, 0.0);
    let error = calibrate(views(&blocks), &CalibrationSettings::echoes(1.0, 255.0)).unwrap_err();
    assert_eq!(
        error.to_string(),
        "calibration needs 200 waveforms of the channel and there were 150; \
         give it more data, or load a saved sensor model"
    );
    assert!(calibrate(views(&blocks), &CalibrationSettings::reference(1.0, 255.0)).is_ok());
}

#[test]
fn blocks_without_pulses_are_counted() {
    let expected = "calibration needs 10 unsaturated pulses above the noise and there were 0 \
                    in 300 waveforms; give it data with echoes, or load a saved sensor model";
    for samples in [vec![], vec![7], vec![7; 60], vec![255; 60]] {
        let same = vec![samples; 300];
        let error = calibrate(views(&same), &CalibrationSettings::echoes(1.0, 255.0)).unwrap_err();
        assert_eq!(error.to_string(), expected);
    }
}

/// Noise-free pulses on a constant level: rounding is the noise.
#[test]
fn without_noise_rounding_is_the_noise() {
    let mut random = Random::new(37);
    let silent = ArNoise::new(&[], 1e-6).unwrap();
    let blocks: Vec<_> = (0..250)
        .map(|_| {
            let echo = pulse(100.0, 20.0 + 10.0 * random.uniform(), 1.0);
            digitised(&analogue(&mut random, &silent, 60, 5.0, FWHM, &[echo]), 255)
        })
        .collect();
    let model = calibrate(views(&blocks), &CalibrationSettings::echoes(1.0, 255.0)).unwrap();
    assert!((model.noise_sd_dn - QUANTISATION_VARIANCE.sqrt()).abs() < 1e-9, "{}", model.noise_sd_dn);
    assert_eq!(model.background_dn, [5.0; 4]);
    assert!((model.pulse_fwhm_ns / FWHM - 1.0).abs() < 0.005, "{}", model.pulse_fwhm_ns);
}

#[test]
fn settings_that_describe_no_channel_are_named() {
    let blocks = blocks(38, 200, 0.0);
    let error = calibrate(views(&blocks), &CalibrationSettings::echoes(0.0, 255.0)).unwrap_err();
    assert_eq!(
        error.to_string(),
        "sensor model: sampling_interval_ns: 0 is not a positive number; \
         recalibrate, or correct the saved model"
    );
}
