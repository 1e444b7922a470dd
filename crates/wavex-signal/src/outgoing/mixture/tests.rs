use std::sync::Arc;

use wavex_simd::SimdLevel;

use super::*;
use crate::decompose::Tables;
use crate::decompose::Waveform;
use crate::noise::ArNoise;
use crate::outgoing::OutgoingBatch;
use crate::sensor_model::response::{ResponseNode, STEPS_PER_SAMPLE, SystemResponse};
use crate::simulated::{Random, analogue, channel, digitised, pulse};

const FWHM: f64 = 4.5;
const HEIGHT_DN: f64 = 160.0;
/// Relative standard deviation of the pulse energy.
const ENERGY_SD: f64 = 0.01;
const SHOTS: usize = 600;
/// Standard deviation of an unexplained position: 0.255 m at 1 GHz.
const UNRELIABLE_SAMPLES: f64 = 1.7;

fn process() -> ArNoise {
    ArNoise::new(&[0.6], 0.7).unwrap()
}

fn model() -> ChannelModel {
    let mut model = channel(&process(), FWHM, 2.3);
    let (first_sample, samples) = (-12, 32);
    let shape = |i: usize| {
        let x = (first_sample as f64 + i as f64 / STEPS_PER_SAMPLE as f64) / FWHM;
        (-4.0 * std::f64::consts::LN_2 * x * x).exp()
    };
    let values = (0..samples * STEPS_PER_SAMPLE).map(shape).collect();
    model.response = Some(SystemResponse {
        first_sample,
        nodes: vec![ResponseNode { peak_dn: 100.0, values }],
        template_error: vec![0.0; samples],
        echoes: 1000,
        excess_part: 1.0,
        shape_sd: 1e-4,
    });
    model
}

/// A line of outgoing pulses: positions and samples.
struct TestLine {
    places: Vec<f64>,
    samples: Vec<Vec<u16>>,
}

/// A line whose shots have these echoes (height over the typical pulse height, distance in
/// samples).
fn line(random: &mut Random, echoes: &[Option<(f64, f64)>]) -> TestLine {
    let mut places = Vec::new();
    let one = |echo: &Option<(f64, f64)>| {
        let place = 10.0 + random.uniform();
        places.push(place);
        let mut pulses = vec![pulse(HEIGHT_DN * (1.0 + ENERGY_SD * random.normal()), place, 1.0)];
        pulses.extend(echo.map(|(strength, distance)| pulse(HEIGHT_DN * strength, place + distance, 1.0)));
        digitised(&analogue(random, &process(), 24, 2.3, FWHM, &pulses), 4095)
    };
    let samples = echoes.iter().map(one).collect();
    TestLine { places, samples }
}

fn judged(batch: &mut OutgoingBatch, line: &TestLine, expected: impl Fn(usize) -> bool) -> Vec<Outgoing> {
    let blocks: Vec<Waveform<'_>> = line.samples.iter().map(|samples| Waveform { samples }).collect();
    let references: Vec<ReferenceBlock<'_>> =
        line.samples.iter().map(|samples| ReferenceBlock { samples, start_samples: -10.0 }).collect();
    let mut pulses = Vec::new();
    batch.fit(&blocks, &mut pulses);
    let usual = batch.usual(&references, &pulses).unwrap();
    for (i, (block, outgoing)) in references.iter().zip(&mut pulses).enumerate() {
        batch.judge(block, outgoing.as_mut().unwrap(), &usual, expected(i));
    }
    pulses.into_iter().map(Option::unwrap).collect()
}

fn batch(is_fast: bool) -> OutgoingBatch {
    let model = ChannelModel { full_scale_dn: 4095.0, ..model() };
    let tables = if is_fast { Tables::new(&model).map(Arc::new) } else { None };
    OutgoingBatch::new(&model, tables, SimdLevel::best()).unwrap()
}

/// Results for the pulses of one test cell.
#[derive(Default)]
struct Cell {
    count: f64,
    flagged: f64,
    error: f64,
    square: f64,
    score: f64,
    variance: f64,
}

impl Cell {
    fn add(&mut self, outgoing: &Outgoing, truth: f64) {
        let pulse = &outgoing.pulse;
        let is_flagged = pulse.flags & flags::ECHO_ON_OUTGOING != 0;
        let least = if is_flagged && !outgoing.is_explained { UNRELIABLE_SAMPLES } else { 0.0 };
        let (error, sd) = (pulse.position_samples - truth, pulse.position_sd_samples.max(least));
        self.count += 1.0;
        self.flagged += f64::from(u8::from(is_flagged));
        self.error += error;
        self.square += error * error;
        self.score += (error / sd).powi(2);
        self.variance += sd * sd;
    }

    fn z(&self) -> f64 {
        (self.score / self.count).sqrt()
    }

    fn flagged(&self) -> f64 {
        self.flagged / self.count
    }

    fn print(&self, name: &str) {
        println!(
            "{name}: flagged {:5.1} %, bias {:7.4}, rms {:.4}, sd {:.4} samples, z {:.2}",
            100.0 * self.flagged(),
            self.error / self.count,
            (self.square / self.count).sqrt(),
            (self.variance / self.count).sqrt(),
            self.z()
        );
    }
}

const DISTANCES: [f64; 7] = [0.0, 0.5, 1.0, 1.5, 2.0, 3.25, 5.0];
const STRENGTHS: [f64; 4] = [0.05, 0.1, 0.3, 1.0];

/// All distances and strengths, before and after the pulse, on a few shots per line.
fn table(is_fast: bool, is_expected: bool, lines: usize, greatest_z: f64) {
    println!("fast {is_fast}, expected {is_expected}");
    let cases = DISTANCES.len() * STRENGTHS.len();
    let mut cells: Vec<Cell> = (0..cases).map(|_| Cell::default()).collect();
    let mut clean = Cell::default();
    let (mut random, mut batch) = (Random::new(31), batch(is_fast));
    for _ in 0..lines {
        let case = |i: usize| i.is_multiple_of(10).then_some(i / 10).filter(|case| *case < 2 * cases);
        let echo = |i: usize| {
            case(i).map(|case| {
                let distance = DISTANCES[case / 2 % DISTANCES.len()];
                let sign = if case % 2 == 0 { 1.0 } else { -1.0 };
                (STRENGTHS[case / 2 / DISTANCES.len()], sign * distance)
            })
        };
        let echoes: Vec<Option<(f64, f64)>> = (0..SHOTS).map(echo).collect();
        let line = line(&mut random, &echoes);
        let found = judged(&mut batch, &line, |i| is_expected && case(i).is_some());
        for (i, (outgoing, truth)) in found.iter().zip(&line.places).enumerate() {
            case(i).map_or(&mut clean, |case| &mut cells[case / 2]).add(outgoing, *truth);
        }
    }
    for (i, cell) in cells.iter().enumerate() {
        let (strength, distance) = (STRENGTHS[i / DISTANCES.len()], DISTANCES[i % DISTANCES.len()]);
        cell.print(&format!("{:3.0} %, {distance:4} samples", 100.0 * strength));
    }
    clean.print("clean");
    for (i, cell) in cells.iter().enumerate() {
        let (strength, distance) = (STRENGTHS[i / DISTANCES.len()], DISTANCES[i % DISTANCES.len()]);
        assert!(cell.z() <= greatest_z, "{strength} {distance}: {}", cell.z());
        assert!(strength < 0.1 || cell.flagged() >= 0.95, "{strength} {distance}: {}", cell.flagged());
    }
    assert!(clean.flagged() <= 1e-3, "{}", clean.flagged());
    // Increased for pulses slightly higher than usual.
    assert!((0.9..1.05).contains(&clean.z()), "{}", clean.z());
}

#[test]
fn echoes_on_outgoing_pulses_are_flagged_and_their_ranges_within_their_standard_deviations() {
    table(true, false, 30, 1.2);
}

#[test]
fn the_plain_kernels_do_the_same() {
    // With few shots, z has an uncertainty of 20 %.
    table(false, false, 6, 1.5);
}

#[test]
fn echoes_that_are_expected_are_judged_with_other_odds() {
    table(true, true, 6, 1.5);
}

#[test]
fn few_pulses_or_a_gaussian_say_nothing() {
    let (mut random, mut pulses) = (Random::new(32), Vec::new());
    let few = line(&mut random, &[None; LEAST_PULSES - 1]);
    let blocks: Vec<Waveform<'_>> = few.samples.iter().map(|samples| Waveform { samples }).collect();
    let references: Vec<ReferenceBlock<'_>> =
        few.samples.iter().map(|samples| ReferenceBlock { samples, start_samples: 0.0 }).collect();
    let mut batch = batch(true);
    batch.fit(&blocks, &mut pulses);
    assert_eq!(batch.usual(&references, &pulses), None);
    assert!(Mixture::new(&ChannelModel { response: None, ..model() }).unwrap().is_none());
}
