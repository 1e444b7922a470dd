//! Speed of the fast kernels.
//!
//! Million waveforms per core-second, by thread CPU time, medians. `cargo bench --bench kernels`
//! prints a table. If `WAVEX_YARDSTICK` names the run script of the yardstick, it runs before each
//! round, and ratios to it are printed: medians of the rounds, and ratios of the best runs. The AVX2
//! level is compared with the yardstick of `WAVEX_YARDSTICK_AVX2`, compiled for AVX2, if it is set.
//! Absolute figures depend on the core, ratios much less. The name of a run as an argument (`--
//! "mixed, refined"`) measures only that run.
#![allow(clippy::print_stdout, reason = "a bench prints its figures")]

use std::sync::Arc;

use wavex_signal::decompose::Waveform;
use wavex_signal::decompose::{BatchDecomposer, Decompositions, FilterPeak, Mode, Tables};
use wavex_signal::decompose::{DecomposeSettings, Decomposer};
use wavex_signal::distributed::DistributedTargets;
use wavex_signal::noise::ArNoise;
use wavex_signal::sensor_model::{Background, ChannelModel};
use wavex_signal::shape::Shape;
use wavex_signal::simulated;
use wavex_simd::SimdLevel;

use wavex_testkit::clock::cpu_s;
use wavex_testkit::waveforms::{Random, SAMPLES, Scene, Waveforms, model, recording_model};

mod special;

const WAVEFORMS: usize = 20_000;
/// Waveforms per call, as `decompose` gets them from the engine.
///
/// 300 to 4096 are usual.
const SCAN_LINE: usize = 2000;
/// Duration of a run, s.
const RUN_S: f64 = 0.05;
const RUNS: usize = 7;
/// Number of rounds for the SIMD level in use.
///
/// Each follows a run of the yardstick. Other load on the machine slows down either, but rarely for
/// long.
const ROUNDS: usize = 9;
const GOAL: f64 = 0.6;
/// SD of the backgrounds that vary per waveform, DN.
const LEVEL_SD_DN: f64 = 3.0;

/// Returns the blocks of a scene and the positions of their pulses.
fn waveforms(model: &ChannelModel, noise: &ArNoise, scene: Scene, seed: u64) -> (Vec<u16>, Vec<Vec<f64>>) {
    let mut made = Waveforms::new(model, noise, scene, seed);
    let mut samples = Vec::with_capacity(WAVEFORMS * SAMPLES);
    let truths = (0..WAVEFORMS).map(|_| made.next(&mut samples)).collect();
    (samples, truths)
}

/// Million waveforms per core-second.
#[derive(Clone, Copy, Default)]
struct Rate {
    median: f64,
    best: f64,
}

fn rate(mut work: impl FnMut()) -> Rate {
    let mut repeats = 1;
    let mut rates = Vec::new();
    while rates.len() < RUNS {
        let before = cpu_s();
        for _ in 0..repeats {
            work();
        }
        let spent = cpu_s() - before;
        if spent < 0.7 * RUN_S {
            repeats =
                if spent < 0.02 { repeats * 4 } else { (repeats as f64 * RUN_S / spent).ceil() as usize };
        } else {
            rates.push((repeats * WAVEFORMS) as f64 / spent * 1e-6);
        }
    }
    rates.sort_by(f64::total_cmp);
    Rate { median: rates[RUNS / 2], best: rates[RUNS - 1] }
}

/// Returns normalised error SD and fraction of right counts.
///
/// The first is the robust SD of the normalised position error, the second the fraction of
/// waveforms with the right number of returns. Only the latter enter the SD.
fn quality(outcomes: &Decompositions, truths: &[Vec<f64>]) -> (f64, f64) {
    let (mut scores, mut right) = (Vec::new(), 0.0);
    for (outcome, truth) in outcomes.iter().zip(truths) {
        if outcome.returns.len() == truth.len() {
            right += 1.0;
            for (r, place) in outcome.returns.iter().zip(truth) {
                scores.push(((r.position_samples - place) / r.position_sd_samples).abs());
            }
        }
    }
    scores.sort_by(f64::total_cmp);
    // The median of the absolute value of a standard normal variable.
    (scores[scores.len() / 2] / 0.674_49, right / truths.len() as f64)
}

/// Lengths of consecutive blocks.
const ALIKE: &[usize] = &[SAMPLES];
const OF_MANY_LENGTHS: &[usize] = &[SAMPLES, SAMPLES - 4, SAMPLES - 7, SAMPLES - 2, SAMPLES - 5];

fn blocks<'a>(samples: &'a [u16], lengths: &[usize]) -> Vec<Waveform<'a>> {
    let lengths = lengths.iter().cycle();
    samples.chunks(SAMPLES).zip(lengths).map(|(s, &n)| Waveform { samples: &s[..n] }).collect()
}

/// Sets of waveforms: samples and truth.
type Sets = [(Vec<u16>, Vec<Vec<f64>>); 3];

/// Measures detection alone.
fn detection(blocks: &[Waveform<'_>], mut detector: BatchDecomposer, shows: bool) -> Rate {
    let mut candidates: Vec<(u32, FilterPeak)> = Vec::with_capacity(2 * WAVEFORMS);
    let rate = rate(|| detector.detect(blocks, &mut candidates));
    if shows {
        println!("      {:.4} candidates per waveform", candidates.len() as f64 / WAVEFORMS as f64);
    }
    rate
}

/// Measures detection, single returns, pairs, the mixed scene, and blocks of varying length.
///
/// In order: detection; one return in modes `refined` and `fastest`; two returns fitted jointly;
/// the mixed scene in modes `refined`, `fast_separated` and `fastest`; one return in mode `fastest`
/// with blocks of varying length. With `shows`, prints the results of the fits.
fn measure(
    path: SimdLevel,
    model: &ChannelModel,
    tables: &Arc<Tables>,
    sets: &Sets,
    shows: bool,
) -> [Rate; 8] {
    let settings = DecomposeSettings::default();
    let plain_settings = DecomposeSettings { max_added: 0, ..settings.clone() };
    let kernels = |settings: &DecomposeSettings, mode: Mode| {
        BatchDecomposer::new(model, Some(Arc::clone(tables)), settings, mode, path).expect("a channel")
    };
    let runs = [
        ("one return", &plain_settings, Mode::Refined, 0, ALIKE),
        ("one return, fastest", &plain_settings, Mode::Fastest, 0, ALIKE),
        ("two returns", &plain_settings, Mode::Refined, 1, ALIKE),
        ("mixed, refined", &settings, Mode::Refined, 2, ALIKE),
        ("mixed, fast_separated", &settings, Mode::FastSeparated, 2, ALIKE),
        ("mixed, fastest", &settings, Mode::Fastest, 2, ALIKE),
        ("many lengths, fastest", &plain_settings, Mode::Fastest, 0, OF_MANY_LENGTHS),
    ];
    let only = std::env::args().skip(1).find(|argument| !argument.starts_with('-'));
    let mut rates = [Rate::default(); 8];
    if only.as_ref().is_none_or(|only| only == "detect") {
        rates[0] = detection(&blocks(&sets[0].0, ALIKE), kernels(&settings, Mode::Refined), shows);
    }
    for (rate_of, (name, settings, mode, set, lengths)) in rates[1..].iter_mut().zip(runs) {
        if only.as_ref().is_some_and(|only| only != name) {
            continue;
        }
        let (samples, truths) = &sets[set];
        let blocks = blocks(samples, lengths);
        let mut kernels = kernels(settings, mode);
        let mut outcomes = Decompositions::default();
        *rate_of = rate(|| {
            for line in blocks.chunks(SCAN_LINE) {
                kernels.decompose(line, &mut outcomes);
            }
        });
        if !shows {
            continue;
        }
        let before = kernels.left_to_plain();
        kernels.decompose(&blocks, &mut outcomes);
        let left = kernels.left_to_plain() - before;
        let (z, right) = quality(&outcomes, truths);
        println!(
            "      {name}: correct number of returns {:.2} %, position z {z:.3}, left to plain \
             kernels {:.2} %",
            100.0 * right,
            100.0 * left as f64 / blocks.len() as f64
        );
    }
    rates
}

/// Measures the mixed scene with a background per waveform, in each mode.
///
/// Prints rates, and their ratio to those with a known background on the same waveforms without the
/// varying level.
fn own_background(
    path: SimdLevel,
    fixed: &ChannelModel,
    tables: &Arc<Tables>,
    mixed: &(Vec<u16>, Vec<Vec<f64>>),
) {
    let own = ChannelModel {
        background: Background::PerWaveform,
        background_sd_dn: LEVEL_SD_DN,
        autocorrelation: vec![0.65],
        ..fixed.clone()
    };
    let of_own = Arc::new(Tables::new(&own).expect("tables"));
    let (samples, truths) = mixed;
    let mut random = Random::new(3);
    let mut levelled = samples.clone();
    for waveform in levelled.chunks_mut(SAMPLES) {
        let level = (LEVEL_SD_DN * random.normal()).round().max(-15.0);
        waveform
            .iter_mut()
            .for_each(|sample| *sample = (f64::from(*sample) + level).clamp(0.0, 254.0) as u16);
    }
    let modes = [
        ("fastest", Mode::Fastest, false),
        ("fastest, refined when needed", Mode::Fastest, true),
        ("fast_separated", Mode::FastSeparated, false),
        ("refined", Mode::Refined, false),
    ];
    for (name, mode, refine) in modes {
        let one = |model: &ChannelModel, tables: &Arc<Tables>, samples: &[u16]| {
            let blocks = blocks(samples, ALIKE);
            let (rate, outcomes, left) = measured(model, tables, mode, refine, path, &blocks);
            (rate, quality(&outcomes, truths), left)
        };
        let rounds: Vec<_> =
            (0..3).map(|_| (one(fixed, tables, samples), one(&own, &of_own, &levelled))).collect();
        let (ratio, range) = median(rounds.iter().map(|(a, b)| b.0.median / a.0.median).collect());
        let best = |of: fn(&(ModeRun, ModeRun)) -> f64| rounds.iter().map(of).fold(0.0, f64::max);
        let (known, unknown) = (best(|(a, _)| a.0.best), best(|(_, b)| b.0.best));
        let (z, right) = rounds[0].1.1;
        println!(
            "background per waveform, {name}: {unknown:.2} M waveforms per core-second, \
             {ratio:.2}{range} of known background's {known:.2}; correct number of returns {:.2} \
             %, z {z:.3}, left to plain kernels {:.2} %",
            100.0 * right,
            100.0 * rounds[0].1.2
        );
    }
}

/// Measures the rate of a mode, with the results and the fraction of blocks left to the scalar kernels.
fn measured(
    model: &ChannelModel,
    tables: &Arc<Tables>,
    mode: Mode,
    refine: bool,
    path: SimdLevel,
    blocks: &[Waveform<'_>],
) -> (Rate, Decompositions, f64) {
    let settings = DecomposeSettings::default();
    let kernels = BatchDecomposer::new(model, Some(Arc::clone(tables)), &settings, mode, path);
    let mut kernels = kernels.expect("a channel").refine_when_needed(refine);
    let mut outcomes = Decompositions::default();
    let rate = rate(|| {
        for line in blocks.chunks(SCAN_LINE) {
            kernels.decompose(line, &mut outcomes);
        }
    });
    let before = kernels.left_to_plain();
    kernels.decompose(blocks, &mut outcomes);
    let left = (kernels.left_to_plain() - before) as f64 / blocks.len() as f64;
    (rate, outcomes, left)
}

/// Samples, limits of the blocks, and positions of the pulses of a scene with blocks of any length.
fn of_many_lengths(
    model: &ChannelModel,
    noise: &ArNoise,
    scene: Scene,
) -> (Vec<u16>, Vec<usize>, Vec<Vec<f64>>) {
    let mut made = Waveforms::new(model, noise, scene, 9);
    let (mut samples, mut ends, mut truths) = (Vec::new(), vec![0], Vec::new());
    for _ in 0..WAVEFORMS {
        truths.push(made.next(&mut samples));
        ends.push(samples.len());
    }
    (samples, ends, truths)
}

fn blocks_between<'a>(samples: &'a [u16], ends: &[usize]) -> Vec<Waveform<'a>> {
    ends.windows(2).map(|ends| Waveform { samples: &samples[ends[0]..ends[1]] }).collect()
}

/// Distance within which a return is that of an echo, samples.
const NEAR_SAMPLES: f64 = 1.5;

/// Returns the echoes with a return and the returns without an echo, per echo.
fn found_and_extra(outcomes: &Decompositions, truths: &[Vec<f64>]) -> (f64, f64) {
    let (mut echoes, mut found, mut returns) = (0, 0, 0);
    for (outcome, truth) in outcomes.iter().zip(truths) {
        let mut left: Vec<f64> = outcome.returns.iter().map(|r| r.position_samples).collect();
        (echoes, returns) = (echoes + truth.len(), returns + left.len());
        for place in truth {
            let distance = |i: &usize| (left[*i] - place).abs();
            let nearest = (0..left.len()).min_by(|i, j| distance(i).total_cmp(&distance(j)));
            if let Some(i) = nearest.filter(|i| distance(i) < NEAR_SAMPLES) {
                left.swap_remove(i);
                found += 1;
            }
        }
    }
    (found as f64 / echoes as f64, (returns - found) as f64 / echoes as f64)
}

/// Measures close echoes recorded with another response than the calibrated one, in each mode.
///
/// Prints the time per waveform, its ratio to single echoes and to the yardstick, the fraction left to
/// the scalar kernels, and the quality. Goals of `refined`: 6 times a single echo, 0.2 % left.
fn close_echoes(
    path: SimdLevel,
    model: &ChannelModel,
    noise: &ArNoise,
    tables: &Arc<Tables>,
    yards: &[[Rate; 5]],
) {
    let only = std::env::args().skip(1).find(|argument| !argument.starts_with('-'));
    if only.is_some_and(|only| only != "close echoes") {
        return;
    }
    let modes = [
        ("refined", Mode::Refined, false),
        ("fast_separated, refined when needed", Mode::FastSeparated, true),
        ("fastest, refined when needed", Mode::Fastest, true),
        ("fast_separated", Mode::FastSeparated, false),
        ("fastest", Mode::Fastest, false),
    ];
    let mut of_single = f64::NAN;
    for (name, scene, recorded) in
        [("single echoes", Scene::One, model), ("close echoes", Scene::Close, &recording_model(noise))]
    {
        let (samples, ends, truths) = of_many_lengths(recorded, noise, scene);
        let blocks = blocks_between(&samples, &ends);
        for (mode_name, mode, refine) in modes {
            let (rate, outcomes, left) = measured(model, tables, mode, refine, path, &blocks);
            let left = 100.0 * left;
            let (z, right) = quality(&outcomes, &truths);
            let (found, extra) = found_and_extra(&outcomes, &truths);
            let spent_us = 1.0 / rate.best;
            if matches!(scene, Scene::One) && mode == Mode::Refined {
                of_single = spent_us;
            }
            let relative = spent_us / of_single;
            let goals = match (scene, mode) {
                (Scene::Close, Mode::Refined) => {
                    format!(" (goals 6 {}, 0.2 % {})", verdict(6.0, relative), verdict(0.2, left))
                }
                _ => String::new(),
            };
            // The yardstick's "one return": detection and a fit of four iterations.
            let yard = yards.iter().map(|yard| yard[1].best).fold(0.0, f64::max);
            let of_yard = if yard > 0.0 {
                format!(", {:.1} of the yardstick's one return", spent_us * yard)
            } else {
                String::new()
            };
            println!(
                "{mode_name}, {name}: {spent_us:.3} us per waveform, {relative:.1} of single echoes{of_yard}; \
                 left to scalar kernels {left:.2} %{goals}; correct number of returns {:.2} %, echoes found \
                 {:.2} %, extra {:.2} %, z {z:.3}",
                100.0 * right,
                100.0 * found,
                100.0 * extra
            );
        }
    }
}

/// Measures waveforms of one to eight echoes, and the forest scene, in each mode.
///
/// Prints the time per waveform and the fraction left to the scalar kernels. The goals: four echoes at
/// most 1.6 times as long as three, eight at most 4 times; at most 0.5 % of the forest left.
fn many_echoes(path: SimdLevel, model: &ChannelModel, noise: &ArNoise, tables: &Arc<Tables>) {
    let only = std::env::args().skip(1).find(|argument| !argument.starts_with('-'));
    if only.is_some_and(|only| only != "echoes") {
        return;
    }
    let modes =
        [("refined", Mode::Refined), ("fast_separated", Mode::FastSeparated), ("fastest", Mode::Fastest)];
    let echoes = [1, 2, 3, 4, 6, 8].map(|count| (format!("{count} echoes"), Scene::Echoes(count)));
    let scenes: Vec<_> = echoes.into_iter().chain([("forest".to_owned(), Scene::Forest)]).collect();
    for (mode_name, mode) in modes {
        let mut of_three = f64::NAN;
        for (name, scene) in &scenes {
            let (samples, ends, truths) = of_many_lengths(model, noise, *scene);
            let blocks = blocks_between(&samples, &ends);
            let (rate, outcomes, left) = measured(model, tables, mode, false, path, &blocks);
            let left = 100.0 * left;
            let (z, right) = quality(&outcomes, &truths);
            let spent_us = 1.0 / rate.best;
            if matches!(scene, Scene::Echoes(3)) {
                of_three = spent_us;
            }
            let relative = spent_us / of_three;
            let verdict = match scene {
                Scene::Echoes(4) => verdict(1.6, relative),
                Scene::Echoes(8) => verdict(4.0, relative),
                Scene::Forest if mode == Mode::Refined => verdict(0.5, left),
                _ => "",
            };
            println!(
                "{mode_name}, {name}: {spent_us:.3} us per waveform ({relative:.2} of three echoes), left to \
                 scalar kernels {left:.2} % {verdict}; correct number of returns {:.2} %, z {z:.3}",
                100.0 * right
            );
        }
    }
}

/// Measures relative heights: a canopy, and the ground behind it.
///
/// Prints the time per waveform.
fn profiles(model: &ChannelModel, noise: &ArNoise) {
    let only = std::env::args().skip(1).find(|argument| !argument.starts_with('-'));
    if only.is_some_and(|only| only != "profiles") {
        return;
    }
    const CANOPIES: usize = 200;
    let model = ChannelModel { full_scale_dn: 4095.0, ..model.clone() };
    let shape = Shape::of(&model).expect("a channel");
    for (samples, top, depth) in [(432, 120.0, 160.0), (120, 20.0, 50.0)] {
        let mut random = simulated::Random::new(10);
        let mut canopy = || {
            let mut values = simulated::noise(&mut random, noise, samples);
            values.iter_mut().enumerate().for_each(|(k, value)| *value += model.background_dn[k % 4]);
            for echo in 0..300 {
                let part = (random.uniform() + random.uniform() + random.uniform()) / 3.0;
                let (height_dn, position) = if echo == 0 { (110.0, 1.2) } else { (0.0125 * depth, part) };
                let pulse = simulated::pulse(height_dn, top + depth * position, 1.0);
                shape.add(&pulse, 1.0, &mut values);
            }
            simulated::digitised(&values, 4095)
        };
        let canopies: Vec<Vec<u16>> = (0..CANOPIES).map(|_| canopy()).collect();
        let mut targets = DistributedTargets::new(&model).expect("a channel");
        let mut found = 0;
        let rate = rate(|| {
            found = canopies.iter().filter(|samples| targets.profile(samples, 0.0).is_some()).count();
        });
        // `rate` counts runs of `WAVEFORMS` waveforms.
        let us = |rate: f64| WAVEFORMS as f64 / CANOPIES as f64 / rate;
        println!(
            "relative heights, {samples} samples: {:.0} us per waveform, best run {:.0}; \
             {found} of {CANOPIES} found",
            us(rate.median),
            us(rate.best)
        );
    }
}

/// Result of a mode.
///
/// Rate, quality (normalised error SD, fraction of right counts), and fraction left to the plain
/// kernels.
type ModeRun = (Rate, (f64, f64), f64);

/// Yardstick lines for comparison, identified by substrings.
const LINES: [(&str, &[&str]); 4] = [
    ("detect, one return", &["detect, one return"]),
    ("one return: detect, bank, whiten, 4 iterations", &["whole single:", "GN full 4 it"]),
    ("one return, fastest: one tabulated step", &["whole single:", "one step (fastest)"]),
    ("two returns jointly, 4 iterations", &["2-peak", " 4 it"]),
];

/// Mixed scene: goals in million waveforms per core-second, for the reference yardstick reading.
const MIXED: [(&str, f64); 3] =
    [("mixed scene, refined", 0.6), ("mixed scene, fast_separated", 1.2), ("mixed scene, fastest", 5.0)];
/// Yardstick line that these goals scale with, and its reading when they were set.
const MIXED_LINE: &str = "detect, two returns";
const MIXED_REFERENCE: f64 = 28.0;

/// Environment variable with the run script of the yardstick for a SIMD level.
///
/// That for AVX2 is compiled for AVX2; without it the usual one serves, and the report says so.
fn yardstick_variable(path: SimdLevel) -> &'static str {
    const FOR_AVX2: &str = "WAVEX_YARDSTICK_AVX2";
    match path {
        SimdLevel::Avx2 if std::env::var_os(FOR_AVX2).is_some() => FOR_AVX2,
        _ => "WAVEX_YARDSTICK",
    }
}

/// Runs the yardstick.
///
/// Returns the rate of each line, that of [`MIXED_LINE`] last.
fn yardstick(path: SimdLevel) -> Option<[Rate; 5]> {
    let script = std::env::var_os(yardstick_variable(path))?;
    let output = std::process::Command::new(script).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let mut rates = [Rate::default(); 5];
    let wanted = LINES.into_iter().map(|(_, parts)| parts).chain([&[MIXED_LINE][..]]);
    for (rate, parts) in rates.iter_mut().zip(wanted) {
        let line = text.lines().find(|line| parts.iter().all(|part| line.contains(part)))?;
        let number = |name: &str| line.split(name).nth(1)?.split_whitespace().next()?.parse().ok();
        *rate = Rate { median: number("median")?, best: number("best")? };
    }
    Some(rates)
}

/// Measures the plain kernels on the mixed scene, thousand waveforms per core-second.
fn plain(model: &ChannelModel, samples: &[u16]) -> f64 {
    let mut decomposer = Decomposer::new(model, &DecomposeSettings::default(), SAMPLES).expect("a channel");
    let before = cpu_s();
    let some = samples.chunks(SAMPLES).take(2000);
    let returns: usize = some.map(|samples| decomposer.decompose(samples).returns.len()).sum();
    let spent = cpu_s() - before;
    println!("      {returns} returns of the first 2000 waveforms");
    2.0 / spent
}

/// Returns the median of an odd number of values, and their range.
fn median(mut values: Vec<f64>) -> (f64, String) {
    values.sort_by(f64::total_cmp);
    let range = match values[..] {
        [least, .., greatest] => format!(" ({least:.2}-{greatest:.2})"),
        _ => String::new(),
    };
    (values[values.len() / 2], range)
}

/// Prints the rows of special waveforms, unless another row is asked for.
fn special_rows(path: SimdLevel, model: &ChannelModel, noise: &ArNoise, tables: &Arc<Tables>) {
    let only = std::env::args().skip(1).find(|argument| !argument.starts_with('-'));
    if only.is_none_or(|only| only == "special") {
        special::rows(path, model, noise, tables);
    }
}

/// Compares a figure with its goal.
fn verdict(figure: f64, goal: f64) -> &'static str {
    if figure >= goal { "reached" } else { "MISSED" }
}

/// Prints the measured rates and ratios.
///
/// Ratios are medians, if the yardstick ran before each round.
fn report(rounds: &[[Rate; 8]], yards: &[[Rate; 5]]) {
    let rate = |i: usize| median(rounds.iter().map(|rates| rates[i].median).collect()).0;
    let ratio = |i: usize, yard: usize| {
        median(rounds.iter().zip(yards).map(|(r, y)| r[i].median / y[yard].median).collect())
    };
    let best = |i: usize, yard: usize| {
        rounds.iter().map(|r| r[i].best).fold(0.0, f64::max)
            / yards.iter().map(|y| y[yard].best).fold(0.0, f64::max)
    };
    for (i, (name, _)) in LINES.iter().enumerate().filter(|(i, _)| rate(*i) > 0.0) {
        print!("{name:<50} {:7.2} M waveforms per core-second", rate(i));
        if !yards.is_empty() {
            let (ratio, range) = ratio(i, i);
            let yard = median(yards.iter().map(|yard| yard[i].median).collect()).0;
            let (best, verdict) = (best(i, i), verdict(ratio, GOAL));
            print!(
                "  yardstick {yard:6.2}  ratio {ratio:.2}{range}, best runs {best:.2}, goal {GOAL} {verdict}"
            );
        }
        println!();
    }
    for (i, (name, goal)) in MIXED.iter().enumerate().filter(|(i, _)| rate(LINES.len() + i) > 0.0) {
        print!("{name:<50} {:7.2} M waveforms per core-second", rate(LINES.len() + i));
        if !yards.is_empty() {
            let scaled = MIXED_REFERENCE * ratio(LINES.len() + i, LINES.len()).0;
            let best = MIXED_REFERENCE * best(LINES.len() + i, LINES.len());
            let verdict = verdict(scaled, *goal);
            print!(
                "  scaled to a yardstick of 28: {scaled:.2}, best runs {best:.2}, goal {goal} \
                    {verdict}"
            );
        }
        println!();
    }
    let many_lengths = LINES.len() + MIXED.len();
    if rate(many_lengths) > 0.0 {
        let name = "one return, fastest, blocks of 53 to 60 samples";
        println!("{name:<50} {:7.2} M waveforms per core-second", rate(many_lengths));
    }
}

fn main() {
    let noise = wavex_testkit::waveforms::noise();
    let model = model(&noise);
    let tables = Arc::new(Tables::new(&model).expect("tables"));
    let sets = [(Scene::One, 7), (Scene::Two, 8), (Scene::Mixed, 9)]
        .map(|(scene, seed)| waveforms(&model, &noise, scene, seed));
    let mut has_yardstick = true;
    for path in [SimdLevel::Avx512, SimdLevel::Avx2, SimdLevel::Portable]
        .into_iter()
        .filter(|path| path.is_available())
    {
        // Without FMA instructions the portable level is exact but slow; measuring it would only
        // cost time.
        if path == SimdLevel::Portable
            && path != SimdLevel::best()
            && std::env::var_os("WAVEX_BENCH_PORTABLE").is_none()
        {
            continue;
        }
        println!("{path:?}{}", if path == SimdLevel::best() { ", the SIMD level in use" } else { "" });
        let (mut rounds, mut yards) = (Vec::new(), Vec::new());
        for round in 0..if path == SimdLevel::best() { ROUNDS } else { 3 } {
            yards.extend(yardstick(path));
            rounds.push(measure(path, &model, &tables, &sets, round == 0));
        }
        has_yardstick = yards.len() == rounds.len();
        if has_yardstick {
            println!("yardstick: {}", yardstick_variable(path));
        }
        if path == SimdLevel::best() {
            own_background(path, &model, &tables, &sets[2]);
        }
        many_echoes(path, &model, &noise, &tables);
        close_echoes(path, &model, &noise, &tables, &yards);
        if path == SimdLevel::best() {
            profiles(&model, &noise);
            special_rows(path, &model, &noise, &tables);
        }
        report(&rounds, if has_yardstick { &yards } else { &[] });
    }
    println!(
        "mixed scene, plain kernels: {:.1} thousand waveforms per core-second",
        plain(&model, &sets[2].0)
    );
    if !has_yardstick {
        println!(
            "\nNO YARDSTICK: set WAVEX_YARDSTICK to its run script. Absolute figures depend on the \
             core."
        );
    }
}
