//! How accurate decomposition is, on simulated waveforms and with the automatic calibration: every goal of
//! ALGORITHMS.md section 7 beside its figure.
//!
//! `cargo bench --bench accuracy` prints the table; words behind it choose parts of it (`-- A6 A9`), and `count=2000`
//! takes fewer waveforms than 20 000 for each figure. Seeds are fixed and belong to parts of a cell, so that the figures
//! do not depend on the number of threads.
#![allow(missing_docs, reason = "no one imports a bench")]
#![allow(
    clippy::print_stdout,
    clippy::expect_used,
    clippy::unwrap_used,
    reason = "a bench prints its figures"
)]

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

use wavex::kernels::calibrate::{Block, CalibrationSettings, calibrate};
use wavex::kernels::decompose::{DecomposeSettings, Decomposer, Return};
use wavex::kernels::detect::Detector;
use wavex::kernels::gauss_fit::Pulse;
use wavex::kernels::response_calibrate::calibrate_response;
use wavex::kernels::sensor_model::ChannelModel;
use wavex::kernels::shape::Shape;
use wavex::kernels::whitening::Whitener;

#[path = "../tests/common/instrument.rs"]
mod instrument;

use instrument::{
    BACKGROUND_DN, EIGHT_BITS, Echo, Instrument, NOISE_SD_DN, Response, SAMPLES, TWELVE_BITS,
    autocorrelation, bound, mean_bound, moments, noise_sd_dn,
};

const THREADS: u32 = 2;
/// Waveforms of one seed.
const PART: u32 = 500;
const CALIBRATION: u32 = 20_000;
const NOISE_BLOCKS: u32 = 1_000_000;

/// The engine under test: one waveform to its returns.
struct Engine {
    decomposer: Decomposer,
}

impl Engine {
    fn new(model: &ChannelModel, settings: &DecomposeSettings) -> Engine {
        Engine { decomposer: Decomposer::new(model, settings, SAMPLES).expect("a model") }
    }

    fn decompose(&mut self, samples: &[u16]) -> &[Return] {
        self.decomposer.decompose(samples, 0).returns
    }
}

/// What all parts of the table share.
struct Bench {
    response: Arc<Response>,
    /// Waveforms for each figure.
    count: u32,
    missed: u32,
    goals: u32,
}

/// One kind of waveforms and how they are decomposed.
struct Cell<'a> {
    seed: u64,
    count: u32,
    model: &'a ChannelModel,
    settings: &'a DecomposeSettings,
    ringing_sd: f64,
}

impl Bench {
    /// Prints a figure beside its goal.
    fn goal(&mut self, goal: &str, what: &str, figure: String, asked: &str, reached: bool) {
        self.goals += 1;
        self.missed += u32::from(!reached);
        let verdict = if reached { "reached" } else { "MISSED" };
        println!("{goal:4} {what:62} {figure:>28}   {asked:28} {verdict}");
    }

    /// Prints a figure that has no goal.
    fn beside(&self, goal: &str, what: &str, figure: String) {
        println!("{goal:4} {what:62} {figure:>28}   -");
    }

    fn cell<'a>(&self, seed: u64, model: &'a ChannelModel, settings: &'a DecomposeSettings) -> Cell<'a> {
        Cell { seed, count: self.count, model, settings, ringing_sd: 0.0 }
    }

    /// Observes a cell's waveforms in order.
    fn observe<T: Send>(
        &self,
        cell: &Cell<'_>,
        observe: impl Fn(&mut Instrument, &mut Engine) -> T + Sync,
    ) -> Vec<T> {
        let parts = cell.count.div_ceil(PART);
        let next = AtomicU32::new(0);
        let work = || {
            let mut engine = Engine::new(cell.model, cell.settings);
            let mut done = Vec::new();
            loop {
                let part = next.fetch_add(1, Ordering::Relaxed);
                if part >= parts {
                    return done;
                }
                let mut instrument = Instrument::new(&self.response, cell.seed, part);
                instrument.ringing_sd = cell.ringing_sd;
                let count = PART.min(cell.count - part * PART);
                let values: Vec<T> = (0..count).map(|_| observe(&mut instrument, &mut engine)).collect();
                done.push((part, values));
            }
        };
        let mut parts: Vec<(u32, Vec<T>)> = std::thread::scope(|scope| {
            let threads: Vec<_> = (0..THREADS).map(|_| scope.spawn(work)).collect();
            threads.into_iter().flat_map(|thread| thread.join().expect("no panic")).collect()
        });
        parts.sort_by_key(|(part, _)| *part);
        parts.into_iter().flat_map(|(_, values)| values).collect()
    }
}

/// The channel's model from waveforms of many kinds.
fn calibrated(response: &Arc<Response>, seed: u64, full_scale_dn: f64, ringing_sd: f64) -> ChannelModel {
    let mut instrument = Instrument::new(response, seed, 0);
    instrument.ringing_sd = ringing_sd;
    let waveforms: Vec<Vec<u16>> = (0..CALIBRATION).map(|_| instrument.record_any(full_scale_dn)).collect();
    let blocks = || waveforms.iter().map(|samples| Block { samples, start_phase: 0 });
    let settings = CalibrationSettings::echoes(1.0, full_scale_dn);
    let gaussian = calibrate(blocks(), &settings).expect("a calibration");
    calibrate_response(blocks(), &gaussian, &settings).expect("a response").model
}

/// With another end of the scale: what was calibrated with eight bits decomposes strong echoes that are not cut off.
fn of_scale(model: &ChannelModel, full_scale_dn: f64) -> ChannelModel {
    ChannelModel { full_scale_dn, ..model.clone() }
}

fn settings(split_evidence: f64) -> DecomposeSettings {
    DecomposeSettings { split_evidence: Some(split_evidence), ..DecomposeSettings::default() }
}

/// An error and what was said of it.
#[derive(Clone, Copy)]
struct Score {
    error: f64,
    sd: f64,
}

impl Score {
    fn z(self) -> f64 {
        self.error / self.sd
    }
}

fn spread(scores: &[Score]) -> f64 {
    moments(&scores.iter().map(|s| s.z()).collect::<Vec<f64>>()).1
}

fn coverage(scores: &[Score]) -> f64 {
    scores.iter().filter(|s| s.z().abs() < 1.0).count() as f64 / scores.len() as f64
}

/// Place, height, width and deviation ratio of a return against its echo.
fn scores(r: &Return, echo: &Echo) -> ([Score; 3], f64) {
    let place = Score { error: r.position_samples - echo.place, sd: r.position_sd_samples };
    let height = Score { error: r.amplitude_dn - NOISE_SD_DN * echo.snr, sd: r.amplitude_sd_dn };
    let width = Score { error: r.width_ratio - echo.width, sd: r.width_ratio_sd };
    ([place, height, width], r.deviation_ratio)
}

fn within(value: f64, low: f64, high: f64) -> bool {
    (low..=high).contains(&value)
}

/// A10: what calibration finds, beside the truth. Returns the time by which its zero lies behind the truth's, samples:
/// that of an outgoing pulse is subtracted from it, so it is no error.
fn calibration(bench: &mut Bench, model: &ChannelModel) -> f64 {
    let noise = 100.0 * (model.noise_sd_dn / noise_sd_dn() - 1.0);
    bench.goal("A10", "noise's standard deviation", format!("{noise:+.2} %"), "+- 1.5 %", noise.abs() <= 1.5);
    let lag = |lag: usize| autocorrelation(lag) * (NOISE_SD_DN / noise_sd_dn()).powi(2);
    let worst =
        model.autocorrelation.iter().enumerate().map(|(k, rho)| (rho - lag(k + 1)).abs()).fold(0.0, f64::max);
    bench.goal("A10", "correlation, the worst lag", format!("{worst:.4}"), "0.02", worst <= 0.02);
    let worst = model.background_dn.iter().map(|b| (b - BACKGROUND_DN).abs()).fold(0.0, f64::max);
    bench.goal("A10", "background, the worst phase", format!("{worst:.3} DN"), "0.1 DN", worst <= 0.1);
    let response = model.response.as_ref().expect("a response");
    let width = 100.0 * (model.pulse_fwhm_ns / bench.response.fwhm_ns - 1.0);
    bench.goal(
        "A10",
        "response's full width at half maximum",
        format!("{width:+.2} %"),
        "0.6 %",
        width.abs() <= 0.6,
    );
    let mut shift = 0.0;
    for (i, node) in response.nodes.iter().enumerate() {
        let [rms, lag, width] = shape_error(&bench.response, &node.values, response.first_sample);
        if i == 0 {
            shift = lag;
        }
        let what = format!("response for {:.0} DN, shape beside the widened truth", node.peak_dn);
        bench.goal("A10", &what, format!("{:.3} %", 100.0 * rms), "0.1 %", rms <= 1e-3);
        let gauge = format!("{:+.2} ps, {width:.4}", 1e3 * lag);
        bench.beside("A10", "  ... its zero of time and width in the truth's", gauge);
    }
    let factor = model.pulse_error_factor;
    bench.goal(
        "A10",
        "error factor on the pulse",
        format!("{factor:.3}"),
        "1.00 +- 0.01",
        within(factor, 0.99, 1.01),
    );
    let error = 100.0 * response.template_error.iter().fold(0.0, |a: f64, b| a.max(*b));
    bench.beside("A10", "template error, the greatest", format!("{error:.3} %"));
    bench.beside(
        "A10",
        "order of the noise, echoes of the response",
        format!("{}, {}", model.ar.len(), response.echoes),
    );
    shift
}

/// Root mean square deviation of a response from the truth of the nearest height, place and width; these two.
fn shape_error(truth: &Response, values: &[f64], first_sample: i32) -> [f64; 3] {
    let times: Vec<f64> = (0..values.len()).map(|k| f64::from(first_sample) + k as f64 / 8.0).collect();
    let inside: Vec<usize> = (0..times.len()).filter(|&k| within(times[k], -9.0, 34.0)).collect();
    let rms = |p: [f64; 3]| {
        let square = |&k: &usize| (values[k] - p[2] * truth.at(times[k] + p[0], p[1])).powi(2);
        (inside.iter().map(square).sum::<f64>() / inside.len() as f64).sqrt()
    };
    let mut best = [0.0, 1.0, 1.0];
    let mut step = [0.016, 0.016, 0.016];
    while step[0] > 1e-5 {
        let mut moved = false;
        for i in 0..3 {
            for sign in [-1.0, 1.0] {
                let mut trial = best;
                // Widths of the truth come in steps of 0.002.
                trial[i] += sign * if i == 1 { f64::max(step[i], 0.002) } else { step[i] };
                if rms(trial) < rms(best) {
                    (best, moved) = (trial, true);
                }
            }
        }
        if !moved {
            step = step.map(|s| 0.5 * s);
        }
    }
    [rms(best), -best[0], best[1]]
}

/// A1 to A4 and coverage: isolated returns.
fn isolated(bench: &mut Bench, model: &ChannelModel, gauge: f64) {
    let settings = DecomposeSettings::default();
    for width in [1.0, 1.5, 2.5] {
        for snr in [6.0, 8.0, 10.0, 15.0, 20.0, 50.0, 100.0] {
            let cell = bench.cell(100 + (10.0 * width + 100.0 * snr) as u64, model, &settings);
            let all = bench.observe(&cell, |instrument, engine| {
                let echo = instrument.echo(snr, width);
                let samples = instrument.record(&[echo], EIGHT_BITS);
                match engine.decompose(&samples) {
                    [r] if (r.position_samples - echo.place).abs() < 3.0 => Some(scores(r, &echo)),
                    _ => None,
                }
            });
            let found: Vec<([Score; 3], f64)> = all.into_iter().flatten().collect();
            isolated_cell(bench, snr, width, gauge, &found);
        }
    }
}

fn isolated_cell(bench: &mut Bench, snr: f64, width: f64, gauge: f64, found: &[([Score; 3], f64)]) {
    let part = |i: usize| -> Vec<Score> { found.iter().map(|(s, _)| s[i]).collect() };
    let (place, height, spreads) = (part(0), part(1), part(2));
    let bounds = mean_bound(&bench.response, snr, width);
    let (mean, sd) = moments(&place.iter().map(|s| s.error).collect::<Vec<f64>>());
    let here = format!("width {width}, SNR {snr}");
    let asked = if snr >= 10.0 { 1.05 } else { 1.15 };
    let ratio = sd / bounds[1];
    bench.goal(
        "A1",
        &format!("{here}: range over its bound ({:.1} ps)", 1e3 * bounds[1]),
        format!("{ratio:.3}"),
        &format!("{asked}"),
        ratio <= asked,
    );
    if snr >= 20.0 {
        let bias = mean - gauge;
        let asked = (0.03 * bounds[1]).min(0.003);
        let known = sd / (found.len() as f64).sqrt();
        bench.goal(
            "A2",
            &format!("{here}: bias of range, zero of time removed"),
            format!("{:+.2} ps (raw {:+.2}, +- {:.2})", 1e3 * bias, 1e3 * mean, 1e3 * known),
            &format!("{:.2} ps", 1e3 * asked),
            bias.abs() <= asked + 2.0 * known,
        );
    }
    if snr >= 10.0 {
        let z = [spread(&place), spread(&height), spread(&spreads)];
        let asked = if snr >= 15.0 { 3 } else { 2 };
        let reached = z[..asked].iter().all(|z| within(*z, 0.95, 1.05));
        bench.goal(
            "A3",
            &format!("{here}: normalised errors of range, height, width"),
            format!("{:.3} {:.3} {:.3}", z[0], z[1], z[2]),
            "0.95-1.05",
            reached,
        );
        let covered = 100.0 * coverage(&place);
        bench.goal(
            "cov",
            &format!("{here}: range within one standard deviation"),
            format!("{covered:.1} %"),
            "66-70 %",
            within(covered, 66.0, 70.0),
        );
    }
    let (centre, fit) = moments(&found.iter().map(|(_, fit)| *fit).collect::<Vec<f64>>());
    bench.goal(
        "A4",
        &format!("{here}: deviation ratio, mean and spread"),
        format!("{centre:+.3} {fit:.3}"),
        "0 +- 0.05, 1 +- 0.05",
        centre.abs() <= 0.05 && within(fit, 0.95, 1.05),
    );
    let heights: Vec<f64> = height.iter().map(|s| s.error / (NOISE_SD_DN * snr)).collect();
    let missing = bench.count as usize - found.len();
    bench.beside(
        "",
        &format!("{here}: bias of height, of width; not one return"),
        format!(
            "{:+.2} %, {:+.2} %; {missing}",
            100.0 * moments(&heights).0,
            100.0 * moments(&spreads.iter().map(|s| s.error / width).collect::<Vec<f64>>()).0
        ),
    );
}

/// Rises through a threshold at the samples, and interpolated maxima above it.
#[derive(Clone, Copy, Default)]
struct Crossings {
    rises: f64,
    maxima: f64,
    kept: f64,
}

/// A6: what noise alone makes, with the calibrated and with the true standard deviation.
fn false_alarms(bench: &mut Bench, model: &ChannelModel) {
    let mut truth = model.clone();
    let part = noise_sd_dn() / model.noise_sd_dn;
    (truth.noise_sd_dn, truth.innovation_sd_dn) = (noise_sd_dn(), part * model.innovation_sd_dn);
    let blocks = if bench.count < 20_000 { 50 * bench.count } else { NOISE_BLOCKS };
    for (name, model) in [("calibrated sigma", model), ("true sigma", &truth)] {
        for sigma in [3.5, 4.0, 4.5] {
            let theory = Theory::of(model, sigma);
            let settings = DecomposeSettings { detection_sigma: sigma, ..DecomposeSettings::default() };
            let blocks = if sigma < 4.0 { blocks / 10 } else { blocks };
            let cell = Cell { count: blocks, ..bench.cell(6000 + (10.0 * sigma) as u64, model, &settings) };
            let all = bench.observe(&cell, |instrument, engine| {
                let samples = instrument.record(&[], EIGHT_BITS);
                Crossings { kept: engine.decompose(&samples).len() as f64, ..theory.count(&samples, sigma) }
            });
            let sum = |f: fn(&Crossings) -> f64| all.iter().map(f).sum::<f64>() / f64::from(blocks);
            let (rises, maxima, kept) = (sum(|c| c.rises), sum(|c| c.maxima), sum(|c| c.kept));
            let known = |rate: f64| (rate / f64::from(blocks)).sqrt();
            let here = format!("T {sigma}, {name}");
            let ratio = |a: f64, b: f64| format!("{:.3} +- {:.3}", a / b, known(a) / b);
            let near = |rate: f64, theory: f64, part: f64| (rate / theory - 1.0).abs() <= part;
            if sigma <= 4.0 {
                bench.goal(
                    "A6",
                    &format!("{here}: interpolated maxima over Rice"),
                    ratio(maxima, theory.rice),
                    "0.85-1.15",
                    near(maxima, theory.rice, 0.15),
                );
                bench.goal(
                    "A6",
                    &format!("{here}: rises at samples over the discrete formula"),
                    ratio(rises, theory.discrete),
                    "0.95-1.05",
                    near(rises, theory.discrete, 0.05),
                );
            }
            bench.goal(
                "A6",
                &format!("{here}: returns over Rice"),
                ratio(kept, theory.rice),
                "1",
                kept <= theory.rice,
            );
            let figure = format!("{:.2e} +- {:.1e}", kept, known(kept));
            match sigma {
                4.5 => bench.goal("A6", &format!("{here}: returns per 60 ns"), figure, "1e-4", kept <= 1e-4),
                _ => bench.beside("A6", &format!("{here}: returns per 60 ns"), figure),
            }
        }
    }
}

/// What theory says of the matched filter's output, and a look at that output.
struct Theory {
    detector: Detector,
    whitener: Whitener,
    background_dn: [f64; 4],
    rice: f64,
    discrete: f64,
}

impl Theory {
    fn of(model: &ChannelModel, sigma: f64) -> Theory {
        let (shape, noise) = (Shape::of(model).expect("a shape"), model.noise().expect("noise"));
        let mut whitener = Whitener::new(noise, 200);
        whitener.set_used(&[true; 200]);
        let reach = (1.5 * shape.fwhm_samples()).ceil();
        let filter = |shift: f64| {
            let mut values = vec![0.0; 200];
            let pulse = Pulse {
                height_dn: 1.0,
                position_samples: 100.0 + shift,
                ln_width_ratio: 0.0,
                ln_width_precision: 0.0,
            };
            shape.add(&pulse, 1.0, &mut values);
            let lobe = |k: usize| (k as f64 - 100.0 - shift).abs() <= reach;
            values.iter_mut().enumerate().for_each(|(k, v)| *v = if lobe(k) { *v } else { 0.0 });
            whitener.whiten(&mut values);
            values
        };
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let template = filter(0.0);
        let energy = dot(&template, &template);
        let correlation = dot(&template, &filter(1.0)) / energy;
        // Of the output's correlation in band-limited form: its second derivative from whole lags.
        let lag = |k: i32| dot(&template, &filter(f64::from(k))) / energy;
        let sinc: f64 =
            (1..60).map(|k| 4.0 * lag(k) * if k % 2 == 0 { 1.0 } else { -1.0 } / f64::from(k * k)).sum();
        let bandwidth = (std::f64::consts::PI.powi(2) / 3.0 + sinc).sqrt();
        let tail = 0.5 * libm::erfc(sigma / std::f64::consts::SQRT_2);
        let rate = bandwidth / std::f64::consts::TAU * (-0.5 * sigma * sigma).exp();
        let mut block = Whitener::new(model.noise().expect("noise"), SAMPLES);
        block.set_used(&[true; SAMPLES]);
        let mut detector = Detector::new(shape, None, &block, SAMPLES);
        detector.prepare(&block);
        let samples = SAMPLES as f64;
        Theory {
            detector,
            whitener: block,
            background_dn: model.background_dn,
            rice: samples * rate + tail,
            discrete: tail + (samples - 1.0) * (tail - both_above(sigma, correlation)),
        }
    }

    fn count(&self, samples: &[u16], sigma: f64) -> Crossings {
        let mut detector = self.detector.clone();
        let target: Vec<f64> =
            samples.iter().enumerate().map(|(k, &s)| f64::from(s) - self.background_dn[k % 4]).collect();
        let values = detector.filter(&self.whitener, &target);
        let mut count = Crossings::default();
        for k in 0..values.len() {
            let at = |k: usize| values.get(k).copied().unwrap_or(f64::NEG_INFINITY);
            let (before, here, after) = (if k > 0 { at(k - 1) } else { f64::NEG_INFINITY }, at(k), at(k + 1));
            count.rises += f64::from(u8::from(before < sigma && here >= sigma));
            let curvature = 2.0 * here - before - after;
            let peak = if curvature.is_finite() {
                here + (after - before).powi(2) / (8.0 * curvature)
            } else {
                here
            };
            count.maxima += f64::from(u8::from(here > before && here >= after && peak >= sigma));
        }
        count
    }
}

/// Probability that two standard normal numbers of this correlation are both above `x` (Simpson's rule on the integral
/// over the angle).
fn both_above(x: f64, correlation: f64) -> f64 {
    let (steps, end) = (400, correlation.asin());
    let value = |i: i32| (-x * x / (1.0 + (end * f64::from(i) / f64::from(steps)).sin())).exp();
    let weight = |i: i32| {
        if i == 0 || i == steps {
            1.0
        } else if i % 2 == 1 {
            4.0
        } else {
            2.0
        }
    };
    let integral = (0..=steps).map(|i| weight(i) * value(i)).sum::<f64>() * end / f64::from(steps) / 3.0;
    (0.5 * libm::erfc(x / std::f64::consts::SQRT_2)).powi(2) + integral / std::f64::consts::TAU
}

/// Both returns of a pair, when exactly two are found, each within 0.4 of the separation.
fn pair_scores(found: &[Return], echoes: &[Echo; 2]) -> Option<[[Score; 3]; 2]> {
    let separation = echoes[1].place - echoes[0].place;
    let near = |r: &Return, e: &Echo| (r.position_samples - e.place).abs() < 0.4 * separation;
    match found {
        [a, b] if near(a, &echoes[0]) && near(b, &echoes[1]) => {
            Some([scores(a, &echoes[0]).0, scores(b, &echoes[1]).0])
        }
        _ => None,
    }
}

/// Pairs that were found, of a ratio, a separation in widths, and a part of the second in the first.
fn pairs(bench: &Bench, model: &ChannelModel, evidence: f64, kind: [f64; 3]) -> Vec<[[Score; 3]; 2]> {
    let [snr, widths, part] = kind;
    let settings = settings(evidence);
    let model = of_scale(model, TWELVE_BITS);
    let cell = bench.cell(7000 + (1000.0 * widths + 10.0 * snr + part) as u64, &model, &settings);
    let separation = widths * bench.response.fwhm_ns;
    let all = bench.observe(&cell, |instrument, engine| {
        let first = instrument.echo(snr, 1.0);
        let echoes = [first, Echo { snr: part * snr, place: first.place + separation, width: 1.0 }];
        let samples = instrument.record(&echoes, TWELVE_BITS);
        pair_scores(engine.decompose(&samples), &echoes)
    });
    all.into_iter().flatten().collect()
}

/// A7 and A8: overlapping returns told apart; A3 and coverage for them.
fn overlapping(bench: &mut Bench, model: &ChannelModel) {
    let goals = [
        ("A7", 20.0, 0.9, 1.0, 95.0),
        ("A7", 50.0, 0.7, 1.0, 95.0),
        ("A7", 100.0, 0.6, 1.0, 95.0),
        ("A8", 20.0, 1.0, 0.3, 85.0),
        ("A8", 50.0, 0.7, 0.3, 95.0),
        ("A8", 100.0, 0.6, 0.3, 95.0),
    ];
    for (goal, snr, widths, part, asked) in goals {
        let [at_11, at_16] = [11.0, 16.0].map(|evidence| {
            100.0 * pairs(bench, model, evidence, [snr, widths, part]).len() as f64 / f64::from(bench.count)
        });
        let what = format!("SNR {snr}, {widths} widths, second {part} x: both found at 11 (at 16)");
        bench.goal(
            goal,
            &what,
            format!("{at_11:.1} % ({at_16:.1} %)"),
            &format!(">= {asked} %"),
            at_11 >= asked,
        );
    }
    for (snr, widths) in [(20.0, 0.8), (20.0, 1.0), (20.0, 1.5), (50.0, 0.8), (50.0, 1.0), (100.0, 0.8)] {
        let found = pairs(bench, model, 16.0, [snr, widths, 1.0]);
        let z =
            [0, 1, 2].map(|i| spread(&found.iter().flat_map(|p| [p[0][i], p[1][i]]).collect::<Vec<Score>>()));
        let what = format!("pairs, SNR {snr}, {widths} widths: normalised range (height, width)");
        bench.goal(
            "A3",
            &what,
            format!("{:.3} ({:.3}, {:.3})", z[0], z[1], z[2]),
            "0.85-1.15",
            within(z[0], 0.85, 1.15),
        );
    }
    let found = pairs(bench, model, 16.0, [50.0, 0.75, 1.0]);
    let covered = 100.0 * coverage(&found.iter().flat_map(|p| [p[0][0], p[1][0]]).collect::<Vec<Score>>());
    bench.goal(
        "cov",
        "pairs, SNR 50, 0.75 widths: range within one",
        format!("{covered:.1} %"),
        "62-76 %",
        within(covered, 62.0, 76.0),
    );
}

/// A7: single returns that are divided.
fn false_splits(bench: &mut Bench, model: &ChannelModel) {
    for width in [1.0, 1.5, 2.0] {
        for snr in [20.0, 50.0, 100.0] {
            let [at_11, at_16] = [11.0, 16.0].map(|evidence| {
                let settings = settings(evidence);
                let cell = bench.cell(7500 + (snr + 1000.0 * width) as u64, model, &settings);
                let all = bench.observe(&cell, |instrument, engine| {
                    let echo = instrument.echo(snr, width);
                    let samples = instrument.record(&[echo], EIGHT_BITS);
                    engine.decompose(&samples).len() > 1
                });
                100.0 * all.iter().filter(|more| **more).count() as f64 / f64::from(bench.count)
            });
            bench.goal(
                "A7",
                &format!("width {width}, SNR {snr}: single returns divided at 11 (at 16)"),
                format!("{at_11:.2} % ({at_16:.2} %)"),
                "<= 0.5 %",
                at_11 <= 0.5,
            );
        }
    }
}

/// A9: nothing false behind strong returns whose ringing varies, and weak ones there kept.
fn late_returns(bench: &mut Bench) {
    let model = calibrated(&bench.response, 9, TWELVE_BITS, 0.25);
    let error =
        model.response.as_ref().map_or(0.0, |r| r.template_error.iter().fold(0.0, |a: f64, b| a.max(*b)));
    bench.beside(
        "A9",
        "template error, the greatest; error factor",
        format!("{:.2} %; {:.3}", 100.0 * error, model.pulse_error_factor),
    );
    let settings = DecomposeSettings::default();
    for snr in [50.0, 100.0, 200.0, 400.0] {
        let cell = Cell { ringing_sd: 0.25, ..bench.cell(9000 + snr as u64, &model, &settings) };
        let all = bench.observe(&cell, |instrument, engine| {
            let echo = instrument.echo(snr, 1.0);
            let samples = instrument.record(&[echo], TWELVE_BITS);
            let found = engine.decompose(&samples);
            let late = found.iter().filter(|r| r.position_samples > echo.place + 3.0).count();
            let nearest = found
                .iter()
                .map(|r| r.position_samples - echo.place)
                .min_by(|a, b| a.abs().total_cmp(&b.abs()));
            (late, found.len().saturating_sub(1 + late), nearest.unwrap_or(f64::NAN))
        });
        let n = f64::from(bench.count);
        let late = all.iter().map(|a| a.0).sum::<usize>() as f64 / n;
        let early = all.iter().map(|a| a.1).sum::<usize>() as f64 / n;
        bench.goal(
            "A9",
            &format!("SNR {snr}: late false returns per waveform (others)"),
            format!("{late:.1e} ({early:.1e})"),
            "<= 1e-3",
            late <= 1e-3,
        );
        bench.beside(
            "A9",
            &format!("SNR {snr}: bias of range"),
            format!("{:+.2} ps", 1e3 * moments(&all.iter().map(|a| a.2).collect::<Vec<f64>>()).0),
        );
    }
    let cell = Cell { ringing_sd: 0.25, ..bench.cell(9900, &model, &settings) };
    let fwhm = bench.response.fwhm_ns;
    let kept = bench.observe(&cell, |instrument, engine| {
        let strong = instrument.echo(100.0, 1.0);
        let weak = Echo { snr: 10.0, place: strong.place + fwhm * instrument.uniform(2.0, 4.0), width: 1.0 };
        let samples = instrument.record(&[strong, weak], TWELVE_BITS);
        engine.decompose(&samples).iter().any(|r| (r.position_samples - weak.place).abs() < 1.5)
    });
    let kept = 100.0 * kept.iter().filter(|kept| **kept).count() as f64 / f64::from(bench.count);
    bench.goal(
        "A9",
        "SNR 10 kept 2 to 4 widths behind SNR 100",
        format!("{kept:.2} %"),
        ">= 99 %",
        kept >= 99.0,
    );
}

/// A11: peaks cut off by the digitiser, beside the bound of the samples that are left.
fn saturated(bench: &mut Bench, model: &ChannelModel) {
    let settings = DecomposeSettings::default();
    for snr in [150.0, 200.0, 300.0, 400.0, 600.0, 800.0] {
        let cell =
            Cell { count: bench.count.min(10_000), ..bench.cell(11_000 + snr as u64, model, &settings) };
        let response = bench.response.clone();
        let all = bench.observe(&cell, |instrument, engine| {
            let echo = instrument.echo(snr, 1.0);
            let samples = instrument.record(&[echo], EIGHT_BITS);
            let near =
                engine.decompose(&samples).iter().find(|r| (r.position_samples - echo.place).abs() < 0.5);
            let score = near.map(|r| scores(r, &echo).0[0]);
            // The bound is the same for all but a few: a tenth of the waveforms tells it.
            let told = instrument.uniform(0.0, 1.0) < 0.1;
            (score, told.then(|| bound(&response, echo, &unsaturated(&samples))[1]))
        });
        let found: Vec<Score> = all.iter().filter_map(|(score, _)| *score).collect();
        let squares: Vec<f64> = all.iter().filter_map(|(_, bound)| bound.map(|b| b * b)).collect();
        let bound = moments(&squares).0.sqrt();
        let (mean, sd) = moments(&found.iter().map(|s| s.error).collect::<Vec<f64>>());
        let z = spread(&found);
        let failures = all.len() - found.len();
        bench.goal(
            "A11",
            &format!("SNR {snr}: range over its bound ({:.1} ps)", 1e3 * bound),
            format!("{:.3}", sd / bound),
            "<= 1.10",
            sd / bound <= 1.1,
        );
        bench.goal(
            "A11",
            &format!("SNR {snr}: normalised error; bias"),
            format!("{z:.3}; {:+.1} ps", 1e3 * mean),
            "0.9-1.1",
            within(z, 0.9, 1.1),
        );
        bench.goal(
            "A11",
            &format!("SNR {snr}: failures of {}", all.len()),
            format!("{failures}"),
            "0",
            failures == 0,
        );
    }
}

/// Samples within the scale, but for the one behind a saturated one.
fn unsaturated(samples: &[u16]) -> Vec<bool> {
    let at_end = |k: usize| f64::from(samples[k]) >= EIGHT_BITS;
    (0..samples.len()).map(|k| samples[k] > 0 && !(at_end(k) || k > 0 && at_end(k - 1))).collect()
}

/// What the engine takes for one waveform with one return.
fn speed(bench: &Bench, model: &ChannelModel) {
    for (name, settings) in [
        ("as by default", DecomposeSettings::default()),
        ("without split test", DecomposeSettings { split_evidence: None, ..DecomposeSettings::default() }),
    ] {
        let mut instrument = Instrument::new(&bench.response, 12, 0);
        let waveforms: Vec<Vec<u16>> = (0..2000)
            .map(|i| {
                let echo = instrument.echo([20.0, 50.0, 100.0][i % 3], [1.0, 1.2, 1.5][i / 3 % 3]);
                instrument.record(&[echo], EIGHT_BITS)
            })
            .collect();
        let mut engine = Engine::new(model, &settings);
        let started = Instant::now();
        let found: usize = waveforms.iter().map(|samples| engine.decompose(samples).len()).sum();
        let each = 1e6 * started.elapsed().as_secs_f64() / waveforms.len() as f64;
        bench.beside(
            "",
            &format!("single returns {name}: time for one ({found} found)"),
            format!("{each:.1} us"),
        );
    }
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let count = words
        .iter()
        .find_map(|word| word.strip_prefix("count="))
        .map_or(20_000, |n| n.parse().expect("a number"));
    let chosen: Vec<&String> = words.iter().filter(|word| !word.contains('=')).collect();
    let wanted = |goal: &str| chosen.is_empty() || chosen.iter().any(|word| *word == goal);
    let mut bench = Bench { response: Arc::new(Response::new()), count, missed: 0, goals: 0 };
    let started = Instant::now();
    println!("{count} waveforms for each figure, response {:.3} ns wide", bench.response.fwhm_ns);
    let model = calibrated(&bench.response, 1, EIGHT_BITS, 0.0);
    println!("calibrated in {:.0} s", started.elapsed().as_secs_f64());
    let gauge = calibration(&mut bench, &model);
    speed(&bench, &model);
    if wanted("A1") {
        isolated(&mut bench, &model, gauge);
    }
    if wanted("A6") {
        false_alarms(&mut bench, &model);
    }
    if wanted("A7") {
        overlapping(&mut bench, &model);
        false_splits(&mut bench, &model);
    }
    if wanted("A9") {
        late_returns(&mut bench);
    }
    if wanted("A11") {
        saturated(&mut bench, &model);
    }
    println!("{} of {} goals missed; {:.0} s", bench.missed, bench.goals, started.elapsed().as_secs_f64());
}
