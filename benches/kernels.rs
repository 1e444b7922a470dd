//! What the fast kernels reach: million waveforms per core-second, by thread CPU time, medians.
//!
//! `cargo bench --bench kernels` prints a table. With `WAVEX_YARDSTICK` naming the yardstick's run script it also runs
//! that, in the same minute, and prints the ratios to it: absolute figures depend on the core, ratios much less.
#![allow(clippy::print_stdout, reason = "a bench prints its figures")]

use std::f64::consts::TAU;
use std::time::Instant;

use wavex::kernels::lockstep::{
    Candidate, Lockstep, Method, Pair, Path, Single, Spectrum, Start, Tables, WidthPrior,
};
use wavex::kernels::noise::ArNoise;

const WAVEFORMS: usize = 20_000;
const SAMPLES: usize = 60;
const THRESHOLD: f32 = 4.5;
const BACKGROUND_DN: f64 = 20.3;
/// Scheduler clocks are exact to a tick: a run is this long, so that a tick does not matter.
const RUN_S: f64 = 0.15;
const RUNS: usize = 11;
const PRIOR: WidthPrior = WidthPrior { ln_width_ratio: 0.0, sd: 0.15 };
const GOAL: f64 = 0.6;

/// Seconds of CPU time of this thread; of wall-clock time where the system does not tell.
fn cpu_s(started: &Instant) -> f64 {
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let ns = told.and_then(|text| text.split_whitespace().next().and_then(|ns| ns.parse::<f64>().ok()));
    ns.map_or_else(|| started.elapsed().as_secs_f64(), |ns| ns * 1e-9)
}

/// SplitMix64 and Box-Muller: the same waveforms in every run.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (TAU * self.uniform()).cos()
    }
}

/// A Gaussian of 1.65 ns behind a decay of 0.9 ns, at 1 GHz.
fn response() -> Spectrum {
    let fine = |t: f64| {
        let after = (0..200).map(|i| i as f64 * 0.05);
        after.map(|d| (-d / 0.9 - 0.5 * ((t - d) / 1.65).powi(2)).exp()).sum::<f64>()
    };
    let values: Vec<f64> = (0..512).map(|i| fine(i as f64 / 16.0 - 12.0)).collect();
    Spectrum::of_samples(&values, -12.0, 1.0 / 16.0).expect("a pulse")
}

/// Blocks with the given number of echoes: amplitude 40 to 200 DN, pairs 3.4 to 9 samples apart.
fn blocks(response: &Spectrum, noise: &ArNoise, echoes: usize) -> (Vec<u16>, Vec<[Start; 2]>) {
    let mut random = Random(7 + echoes as u64);
    let mut samples = Vec::with_capacity(WAVEFORMS * SAMPLES);
    let mut truths = Vec::with_capacity(WAVEFORMS);
    let mut pulse = [[0.0; 5]; SAMPLES];
    let sd = noise.innovation_variance().sqrt();
    for _ in 0..WAVEFORMS {
        let mut values = [BACKGROUND_DN; SAMPLES];
        let mut past = [0.0; 2];
        for value in values.iter_mut() {
            let now =
                past.iter().zip(noise.coefficients()).map(|(p, c)| p * c).sum::<f64>() + sd * random.normal();
            past = [now, past[0]];
            *value += now;
        }
        let mut truth = [Start::default(); 2];
        let mut position = 16.0 + 12.0 * random.uniform();
        for start in truth.iter_mut().take(echoes) {
            let amplitude = 40.0 + 160.0 * random.uniform();
            response.derivatives_into(0.0, -position, &mut pulse);
            for (value, pulse) in values.iter_mut().zip(&pulse) {
                *value += amplitude * pulse[0];
            }
            *start = Start {
                amplitude_dn: amplitude as f32,
                position_samples: position as f32,
                ln_width_ratio: 0.0,
            };
            position += 3.4 + 5.6 * random.uniform();
        }
        samples.extend(values.iter().map(|v| v.round().clamp(0.0, 4095.0) as u16));
        truths.push(truth);
    }
    (samples, truths)
}

/// Median million waveforms per core-second.
fn rate(mut work: impl FnMut()) -> f64 {
    let started = Instant::now();
    let mut repeats = 1;
    let mut rates = Vec::new();
    while rates.len() < RUNS {
        let before = cpu_s(&started);
        for _ in 0..repeats {
            work();
        }
        let spent = cpu_s(&started) - before;
        if spent < 0.7 * RUN_S {
            repeats =
                if spent < 0.02 { repeats * 4 } else { (repeats as f64 * RUN_S / spent).ceil() as usize };
        } else {
            rates.push((repeats * WAVEFORMS) as f64 / spent * 1e-6);
        }
    }
    rates.sort_by(f64::total_cmp);
    rates[RUNS / 2]
}

/// Standard deviation of error over sigma.
fn z(errors: impl Iterator<Item = f64>) -> f64 {
    let (n, sum) = errors.fold((0.0, 0.0), |(n, sum), z| (n + 1.0, sum + z * z));
    (sum / n).sqrt()
}

/// The four kernels' rates on one path.
fn measure(
    path: Path,
    tables: &Tables,
    one: &[&[u16]],
    two: &[&[u16]],
    truths: [&[[Start; 2]]; 2],
) -> [f64; 4] {
    let mut kernels = Lockstep::new(tables, path, SAMPLES);
    let mut candidates: Vec<Candidate> = Vec::with_capacity(2 * WAVEFORMS);
    let mut singles = vec![Single::default(); WAVEFORMS];
    let mut pairs = vec![Pair::default(); WAVEFORMS];
    let away = |start: &[Start; 2]| {
        let [mut a, mut b] = *start;
        a.amplitude_dn *= 0.85;
        a.position_samples += 0.4;
        b.amplitude_dn *= 1.15;
        b.position_samples -= 0.4;
        [a, b]
    };
    let starts: Vec<[Start; 2]> = truths[1].iter().map(away).collect();
    let detect = rate(|| kernels.detect(one, THRESHOLD, &mut candidates));
    println!("      {:.4} candidates per waveform", candidates.len() as f64 / WAVEFORMS as f64);
    let mut fits = [0.0; 2];
    for (fit, method) in fits.iter_mut().zip([Method::GaussNewton { iterations: 4 }, Method::OneStep]) {
        *fit = rate(|| kernels.singles(one, THRESHOLD, method, &mut singles));
        let errors = singles.iter().zip(truths[0]).map(|(s, t)| {
            f64::from(s.echo.position_samples - t[0].position_samples) / f64::from(s.echo.position_sd_samples)
        });
        println!("      {method:?}: z of the position {:.4}", z(errors));
    }
    let pair = rate(|| kernels.pairs(two, &starts, PRIOR, 4, &mut pairs));
    for which in 0..2 {
        let errors = pairs.iter().zip(truths[1]).map(|(p, t)| {
            let echo = p.echoes[which];
            f64::from(echo.position_samples - t[which].position_samples) / f64::from(echo.position_sd_samples)
        });
        println!("      pair, echo {}: z of the position {:.4}", which + 1, z(errors));
    }
    [detect, fits[0], fits[1], pair]
}

/// The lines of the yardstick that the kernels are held against: what both names contain.
const LINES: [(&str, &[&str]); 4] = [
    ("detect, one return", &["detect, one return"]),
    ("one return: detect, bank, whiten, 4 iterations", &["whole single:", "GN full 4 it"]),
    ("one return, fastest: one tabulated step", &["whole single:", "one step (fastest)"]),
    ("two returns jointly, 4 iterations", &["2-peak", " 4 it"]),
];

/// Medians of the yardstick's lines.
fn yardstick() -> Option<[f64; 4]> {
    let script = std::env::var_os("WAVEX_YARDSTICK")?;
    let output = std::process::Command::new(script).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let mut rates = [0.0; 4];
    for (rate, (_, parts)) in rates.iter_mut().zip(LINES) {
        let line = text.lines().find(|line| parts.iter().all(|part| line.contains(part)))?;
        *rate = line.split("median").nth(1)?.split_whitespace().next()?.parse().ok()?;
    }
    Some(rates)
}

fn main() {
    let response = response();
    let noise = ArNoise::new(&[0.85, -0.3], 1.5).expect("stationary noise");
    let tables = Tables::new(&response, &noise, [BACKGROUND_DN; 4]).expect("tables");
    let (one, truth_one) = blocks(&response, &noise, 1);
    let (two, truth_two) = blocks(&response, &noise, 2);
    let one: Vec<&[u16]> = one.chunks(SAMPLES).collect();
    let two: Vec<&[u16]> = two.chunks(SAMPLES).collect();
    let before = yardstick();
    for path in [Path::Avx512, Path::Avx2, Path::Portable].into_iter().filter(|path| path.is_available()) {
        // Without FMA instructions the portable path is exact, not fast: a figure would only cost time.
        if path == Path::Portable
            && path != Path::best()
            && std::env::var_os("WAVEX_BENCH_PORTABLE").is_none()
        {
            continue;
        }
        println!("{path:?}{}", if path == Path::best() { ", the path in use" } else { "" });
        let rates = measure(path, &tables, &one, &two, [&truth_one, &truth_two]);
        for (i, (name, _)) in LINES.iter().enumerate() {
            let ratio = before.map_or_else(String::new, |yard| {
                let ratio = rates[i] / yard[i];
                let verdict = if ratio >= GOAL { "reached" } else { "MISSED" };
                format!("  yardstick {:6.2}  ratio {ratio:.2}, goal {GOAL} {verdict}", yard[i])
            });
            println!("{name:<50} {:7.2} M waveforms per core-second{ratio}", rates[i]);
        }
    }
    if before.is_none() {
        println!(
            "\nNO YARDSTICK: set WAVEX_YARDSTICK to its run script. Without it these figures say little."
        );
    }
}
