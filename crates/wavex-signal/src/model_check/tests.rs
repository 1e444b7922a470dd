//! Each finding with the change that it must notice.

use super::*;
use crate::noise::ArNoise;
use crate::sensor_model::{ResponseNode, SystemResponse};
use crate::shape::Shape;
use crate::simulated::{Random, channel, digitised, noise, pulse};

const FWHM: f64 = 4.4;
const BACKGROUND_DN: f64 = 12.3;

fn vectors() -> KernelContext {
    KernelContext { simd: SimdLevel::best(), tables: TableCache::default() }
}

fn process() -> ArNoise {
    ArNoise::new(&[0.6], 0.8).unwrap()
}

/// A channel whose response has an after-pulse of 6 %, and no error.
fn model() -> ChannelModel {
    let value = |t: f64| {
        let bell = |t: f64, fwhm: f64| (-2.772_588_7 * (t / fwhm).powi(2)).exp();
        bell(t, FWHM) + 0.06 * bell(t - 11.0, FWHM)
    };
    let response = SystemResponse {
        first_sample: -12,
        nodes: vec![ResponseNode {
            peak_dn: 155.0,
            values: (-96..=320).map(|k| value(f64::from(k) / 8.0)).collect(),
        }],
        template_error: vec![0.0; 52],
        echoes: 1000,
        excess_part: 1.0,
        shape_sd: 1e-3,
    };
    ChannelModel { response: Some(response), ..channel(&process(), FWHM, BACKGROUND_DN) }
}

/// Waveforms of the channel: one echo each, whose shape differs by `shape_error` of its height.
fn recording(waveforms: usize, shape_error: f64) -> Vec<Vec<u16>> {
    let (mut random, shape) = (Random::new(5), Shape::of(&model()).unwrap());
    (0..waveforms)
        .map(|_| {
            let mut values = noise(&mut random, &process(), 60);
            values.iter_mut().for_each(|value| *value += BACKGROUND_DN);
            let (height, position) = (20.0 + 170.0 * random.uniform(), 18.0 + 4.0 * random.uniform());
            shape.add(&pulse(height, position, 1.0), 1.0, &mut values);
            let other = shape_error * random.normal() * height;
            shape.add(&pulse(other.abs(), position + 3.0, 1.2), other.signum(), &mut values);
            digitised(&values, 255)
        })
        .collect()
}

fn compared(samples: &[Vec<u16>], model: &ChannelModel) -> Comparison {
    let blocks = samples.iter().map(|samples| Waveform { samples });
    compare(blocks, model, &vectors()).unwrap().unwrap()
}

/// Areas of the findings for a changed model.
fn areas(samples: &[Vec<u16>], change: impl Fn(&mut ChannelModel)) -> Vec<Area> {
    let mut changed = model();
    change(&mut changed);
    compared(samples, &changed).findings.iter().map(|finding| finding.area).collect()
}

#[test]
fn the_right_model_has_no_findings() {
    assert_eq!(areas(&recording(600, 0.0), |_| {}), []);
    let few = recording(MIN_WAVEFORMS - 1, 0.0);
    let blocks = few.iter().map(|samples| Waveform { samples });
    assert_eq!(compare(blocks, &model(), &vectors()).unwrap(), None);
}

#[test]
fn a_changed_model_has_a_finding_in_its_area() {
    let samples = recording(600, 0.0);
    let check = |area: Area, change: fn(&mut ChannelModel)| {
        let found = areas(&samples, change);
        assert!(found.contains(&area), "{area:?}: {found:?}");
    };
    for factor in [0.5, 2.0] {
        let found = areas(&samples, |m| {
            (m.noise_sd_dn, m.innovation_sd_dn) = (factor * m.noise_sd_dn, factor * m.innovation_sd_dn)
        });
        assert!(found.contains(&Area::Noise), "{factor}: {found:?}");
    }
    check(Area::Correlation, |m| (m.ar, m.innovation_sd_dn) = (Vec::new(), m.noise_sd_dn));
    check(Area::Background, |m| m.background_dn = [BACKGROUND_DN + 2.0 * m.noise_sd_dn; 4]);
    check(Area::Background, |m| m.background_dn = [BACKGROUND_DN - 2.0 * m.noise_sd_dn; 4]);
    check(Area::PulseShape, |m| {
        m.response.as_mut().unwrap().nodes[0].values[96 + 50..].iter_mut().for_each(|value| *value = 0.0);
    });
    check(Area::TemplateError, |m| {
        m.response.as_mut().unwrap().template_error.fill(0.05);
    });
    check(Area::FullScale, |m| m.full_scale_dn = 150.0);
    // The same model with pulses of other widths.
    for factor in [1.1, 1.0 / 1.1] {
        let found = areas(&samples, |m| {
            m.response = None;
            m.pulse_fwhm_ns *= factor;
        });
        assert!(found.contains(&Area::PulseWidth), "{factor}: {found:?}");
    }
}

#[test]
fn a_template_error_that_is_too_small_is_a_finding() {
    assert!(areas(&recording(600, 0.05), |_| {}).contains(&Area::TemplateError));
}

#[test]
fn a_receiver_without_echoes_is_a_finding() {
    let mut random = Random::new(8);
    let silent: Vec<Vec<u16>> = (0..400)
        .map(|_| {
            let values: Vec<f64> =
                noise(&mut random, &process(), 60).iter().map(|n| n + BACKGROUND_DN).collect();
            digitised(&values, 255)
        })
        .collect();
    assert_eq!(areas(&silent, |_| {}), [Area::Echoes]);
}

#[test]
fn clipping_below_full_scale_is_a_finding() {
    let mut samples = recording(600, 0.0);
    samples.iter_mut().flatten().for_each(|dn| *dn = 150.min(*dn));
    let finding =
        compared(&samples, &model()).findings.into_iter().find(|f| f.area == Area::FullScale).unwrap();
    assert_eq!((finding.measured, finding.expected), (150.0, 255.0));
}

#[test]
fn the_model_in_use_has_the_measured_noise_and_a_free_background() {
    let samples = recording(600, 0.0);
    assert_eq!(compared(&samples, &model()).model_in_use(&model()).unwrap(), None);
    let mut changed = model();
    changed.noise_sd_dn *= 0.5;
    changed.innovation_sd_dn *= 0.5;
    changed.background_dn = [BACKGROUND_DN + 4.0; 4];
    let in_use = compared(&samples, &changed).model_in_use(&changed).unwrap().unwrap();
    assert!((in_use.noise_sd_dn / model().noise_sd_dn - 1.0).abs() < 0.1, "{}", in_use.noise_sd_dn);
    assert_eq!(in_use.background, Background::PerWaveform);
    assert!((4.0..10.0).contains(&in_use.background_sd_dn), "{}", in_use.background_sd_dn);
    assert_eq!(compared(&samples, &in_use).findings, [], "it agrees with the recording");
}

#[test]
fn findings_name_figures_and_remedy() {
    let finding =
        Finding { area: Area::Noise, measured: 2.04, expected: 1.0, accepted: [0.77, 1.3], unit: "DN" };
    assert_eq!(
        finding.to_string(),
        "the noise differs from the sensor model: SD 2.04 DN, expected 1.00 DN (accepted: 0.77 DN to 1.30 DN): \
         calibrate from this recording, or load a model of this instrument and setting"
    );
    assert_eq!(Finding { measured: 1.29, ..finding }.unless_accepted(), None);
}

#[test]
fn dead_and_offset_blocks_are_silent() {
    let receiving = Receiving::of(&model());
    let silence = |range_dn: [u16; 2]| receiving.silence(60, range_dn, 1.0);
    assert_eq!(silence([77, 77]), Some(Silence::Constant));
    assert_eq!(silence([12, 12]), Some(Silence::Constant));
    assert_eq!(silence([75, 80]), Some(Silence::AwayFromBackground));
    assert_eq!(silence([9, 16]), None, "noise");
    assert_eq!(silence([9, 200]), None, "an echo");
    assert_eq!(silence([255, 255]), None, "clipped throughout");
    assert_eq!(receiving.silence(8, [77, 77], 1.0), None, "too short");
    let quiet = ChannelModel { noise_sd_dn: 0.3, ..model() };
    assert_eq!(Receiving::of(&quiet).silence(60, [12, 12], 1.0), None, "noise below the rounding");
    let per_waveform = ChannelModel { background: Background::PerWaveform, background_sd_dn: 6.0, ..model() };
    assert_eq!(Receiving::of(&per_waveform).silence(60, [75, 80], 1.0), None);
}

/// Areas of the findings along a recording whose later half is changed.
fn drift(change: impl Fn(f64) -> f64) -> Vec<Area> {
    drift_from(600, 1200, change)
}

/// The same for another number of waveforms, of which those from `first` on are changed.
fn drift_from(first: usize, waveforms: usize, change: impl Fn(f64) -> f64) -> Vec<Area> {
    let mut running = Running::default();
    let samples = recording(waveforms, 0.0);
    for (number, block) in samples.iter().enumerate() {
        let change = |&dn: &u16| if number < first { dn } else { change(f64::from(dn)).round() as u16 };
        let block: Vec<u16> = block.iter().map(change).collect();
        running.add(&block, block.iter().max().copied().unwrap());
    }
    running
        .findings(&ChannelModel { full_scale_dn: 1000.0, ..model() })
        .iter()
        .map(|finding| finding.area)
        .collect()
}

#[test]
fn changes_along_a_recording_are_findings() {
    assert_eq!(drift(|dn| dn), []);
    assert_eq!(drift(|dn| dn + 4.0), [Area::BackgroundDrift]);
    assert_eq!(drift(|dn| BACKGROUND_DN + 1.6 * (dn - BACKGROUND_DN)), [Area::NoiseDrift]);
}

#[test]
fn short_recordings_are_compared_by_fewer_parts() {
    assert_eq!(drift_from(30, 60, |dn| dn + 4.0), [Area::BackgroundDrift], "only two parts are long enough");
    assert_eq!(drift_from(76, 100, |dn| dn + 4.0), [Area::BackgroundDrift], "only four parts show it");
    assert_eq!(drift_from(24, 48, |dn| dn + 4.0), []);
}

/// Each echo has a second one of this relative height, 16 ± `spread` samples later.
fn with_second(part: f64, spread: f64) -> Vec<Vec<u16>> {
    let (mut random, shape) = (Random::new(6), Shape::of(&model()).unwrap());
    let mut waveform = || {
        let mut values = noise(&mut random, &process(), 60);
        values.iter_mut().for_each(|value| *value += BACKGROUND_DN);
        let (height, position) = (100.0 + 90.0 * random.uniform(), 15.0 + 4.0 * random.uniform());
        let later = position + 16.0 + spread * (2.0 * random.uniform() - 1.0);
        shape.add(&pulse(height, position, 1.0), 1.0, &mut values);
        shape.add(&pulse(part * height, later, 1.0), 1.0, &mut values);
        digitised(&values, 255)
    };
    (0..600).map(|_| waveform()).collect()
}

#[test]
fn a_tail_that_is_fitted_as_returns_is_a_finding() {
    let has = |part, spread| areas(&with_second(part, spread), |_| {}).contains(&Area::PulseShape);
    assert!(has(0.2, 0.0));
    assert!(!has(0.2, 6.0), "other targets");
    assert!(!has(0.5, 0.0), "too high for a tail");
}

#[test]
fn few_echoes_cut_by_the_end_of_the_block_are_no_template_error() {
    let (mut random, shape) = (Random::new(7), Shape::of(&model()).unwrap());
    let mut waveform = |height_dn: f64, is_cut: bool| {
        let mut values = noise(&mut random, &process(), 60);
        values.iter_mut().for_each(|value| *value += BACKGROUND_DN);
        shape.add(&pulse(height_dn, 20.0 + random.uniform(), 1.0), 1.0, &mut values);
        if is_cut {
            shape.add(&pulse(80.0, 61.0, 1.0), 1.0, &mut values);
        }
        digitised(&values, 255)
    };
    let samples: Vec<_> =
        (0..600).map(|k| waveform(80.0 + 0.1 * f64::from(k), k < 200 && k % 12 == 0)).collect();
    assert_eq!(areas(&samples, |_| {}), []);
}

#[test]
fn a_long_recording_keeps_evenly_spaced_blocks() {
    let mut running = Running::default();
    let block: Vec<u16> = (0..40).map(|k| 10 + k % 3).collect();
    (0..20_000).for_each(|_| running.add(&block, 12));
    assert!(running.findings(&model()).is_empty());
    assert_eq!(running.kept_every(), 8);
}
