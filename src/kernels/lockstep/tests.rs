//! The fast kernels against the plain ones, which are their oracle, and against themselves on other paths.

use super::*;
use crate::kernels::decompose::Return;
use crate::kernels::gauss_fit::Pulse;
use crate::kernels::noise::ArNoise;
use crate::kernels::response::{ResponseNode, SystemResponse};
use crate::kernels::shape::Shape;
use crate::kernels::simulated::{self, Random, digitised, pulse};

const SAMPLES: usize = 60;
const FULL_SCALE: u16 = 255;

/// A pulse with a ringing and a slow tail: a Gaussian of 1.65 ns behind a decay of 0.9 ns, 4 % at +11 ns, 1.5 % falling off
/// over 40 ns. `tail` makes it stronger.
fn response_values(tail: f64) -> Vec<f64> {
    let narrow = |t: f64| (-0.5 * (t / 1.65).powi(2)).exp();
    let main =
        |t: f64| (0..120).map(|i| f64::from(i) * 0.05).map(|d| (-d / 0.9).exp() * narrow(t - d)).sum::<f64>();
    let slow = |t: f64| if t > 3.0 { (1.0 - (-(t - 3.0) / 4.0).exp()) * (-t / 30.0).exp() } else { 0.0 };
    let value = |t: f64| main(t) / main(0.7) + tail * (0.04 * narrow((t - 11.0) / 1.2) + 0.015 * slow(t));
    let peak = (0..200).map(|i| value(f64::from(i) * 0.01)).fold(0.0, f64::max);
    let place = (0..200).map(|i| f64::from(i) * 0.01).find(|&t| value(t) == peak).unwrap();
    (-96..=640).map(|k| value(f64::from(k) / 8.0 + place) / peak).collect()
}

/// A channel whose response follows the height above 150 DN.
fn model() -> ChannelModel {
    let process = ArNoise::new(&[0.8, -0.25], 0.7).unwrap();
    let node = |peak_dn: f64, tail: f64| ResponseNode { peak_dn, values: response_values(tail) };
    let response = SystemResponse {
        first_sample: -12,
        nodes: vec![node(150.0, 1.0), node(180.0, 1.3)],
        template_error: vec![0.001; 80],
        echoes: 1000,
        shape_sd: 1e-3,
    };
    let pulse_fwhm_ns = response.fwhm_samples();
    let mut model = simulated::channel(&process, pulse_fwhm_ns, 2.2);
    model.response = Some(response);
    model.background_dn = [2.1, 2.4, 2.2, 2.5];
    model
}

fn fast(model: &ChannelModel, mode: Mode, path: Path) -> Lockstep {
    let tables = Some(Arc::new(Tables::new(model).unwrap()));
    Lockstep::new(model, tables, &DecomposeSettings::default(), mode, path).unwrap()
}

/// A block of these pulses in the model's noise.
fn block(
    model: &ChannelModel,
    shape: &Shape,
    random: &mut Random,
    samples: usize,
    pulses: &[Pulse],
) -> Vec<u16> {
    let mut values = simulated::noise(random, &ArNoise::new(&[0.8, -0.25], 0.7).unwrap(), samples);
    for (k, value) in values.iter_mut().enumerate() {
        *value += model.background_dn[k % 4];
    }
    pulses.iter().for_each(|pulse| shape.add(pulse, 1.0, &mut values));
    digitised(&values, FULL_SCALE)
}

/// Waveforms as they come: 15 % empty, 55 % with one pulse, 20 % with two, 10 % with three, 3 to 20 samples apart.
fn scenes(model: &ChannelModel, seed: u64, count: usize) -> Vec<Vec<u16>> {
    let shape = Shape::of(model).unwrap();
    let mut random = Random::new(seed);
    let one = |_: usize| {
        let kind = random.uniform();
        let pulses = [0.15, 0.70, 0.90].iter().filter(|&&limit| kind >= limit).count();
        let mut position = 8.0 + 16.0 * random.uniform();
        let mut truth = Vec::new();
        for _ in 0..pulses {
            let width = if random.uniform() < 0.6 { 1.0 } else { 1.0 + 0.4 * random.uniform() };
            truth.push(pulse(8.0 + 160.0 * random.uniform(), position, width));
            position += 3.0 + 17.0 * random.uniform();
        }
        block(model, &shape, &mut random, SAMPLES, &truth)
    };
    (0..count).map(one).collect()
}

fn decompose(fast: &mut Lockstep, waveforms: &[Vec<u16>]) -> Outcomes {
    let blocks: Vec<Block<'_>> = waveforms.iter().map(|samples| Block { samples, start_phase: 0 }).collect();
    let mut outcomes = Outcomes::default();
    fast.decompose(&blocks, &mut outcomes);
    outcomes
}

/// Against the plain kernels: the same number of returns in 99 % of the waveforms; of those, 99 % of the values within 0.1
/// of their standard deviations, which agree within 3 %.
#[test]
fn returns_are_those_of_the_plain_kernels() {
    let model = model();
    let waveforms = scenes(&model, 1, 3000);
    let mut plain = Decomposer::new(&model, &DecomposeSettings::default(), SAMPLES).unwrap();
    let outcomes = decompose(&mut fast(&model, Mode::Refined, Path::best()), &waveforms);
    let (mut same, mut values, mut near, mut total) = (0, 0, 0, 0);
    for (samples, found) in waveforms.iter().zip(outcomes.iter()) {
        let expected = plain.decompose(samples, 0);
        let c = found.counts;
        assert_eq!(c.n_candidates + c.n_added, c.np + c.np_filtered + c.np_merged + c.np_xtalk_dropped);
        total += expected.returns.len();
        if expected.returns.len() != found.returns.len() {
            let show = |r: &[Return]| -> Vec<_> {
                r.iter()
                    .map(|r| {
                        (
                            (r.position_samples * 100.0).round() / 100.0,
                            r.amplitude_dn.round(),
                            (r.width_ratio * 100.0).round() / 100.0,
                        )
                    })
                    .collect()
            };
            println!(
                "{:?} chi {:.1}\n   {:?} chi {:.1}",
                show(expected.returns),
                expected.chi_square,
                show(found.returns),
                found.chi_square
            );
            continue;
        }
        same += 1;
        for (a, b) in expected.returns.iter().zip(found.returns) {
            let errors = [
                (a.position_samples - b.position_samples) / a.position_sd_samples,
                (a.amplitude_dn - b.amplitude_dn) / a.amplitude_sd_dn,
                (a.width_ratio - b.width_ratio) / a.width_ratio_sd,
                (a.position_sd_samples / b.position_sd_samples - 1.0) / 0.3,
            ];
            values += 1;
            near += usize::from(errors.iter().all(|e| e.abs() < 0.1));
        }
    }
    println!("{total} returns; the same number in {same} of {}; near {near} of {values}", waveforms.len());
    assert!(same * 100 >= 99 * waveforms.len());
    assert!(near * 100 >= 99 * values);
}

#[test]
fn why() {
    let model = model();
    let shape = Shape::of(&model).unwrap();
    let mut random = Random::new(5);
    let waveforms: Vec<Vec<u16>> = (0..640)
        .map(|i| {
            let p = 12.0 + 12.0 * random.uniform();
            let mut v = vec![pulse(20.0 + 130.0 * random.uniform(), p, 1.0)];
            if i >= 320 {
                v.push(pulse(20.0 + 130.0 * random.uniform(), p + 6.0 + 6.0 * random.uniform(), 1.0));
            }
            block(&model, &shape, &mut random, SAMPLES, &v)
        })
        .collect();
    let settings = DecomposeSettings { max_added: 0, ..DecomposeSettings::default() };
    let tables = Some(Arc::new(Tables::new(&model).unwrap()));
    let mut f = Lockstep::new(&model, tables, &settings, Mode::Refined, Path::best()).unwrap();
    decompose(&mut f, &waveforms);
    println!("{} left", f.left_to_plain());
}
