//! Accuracy of decomposition on simulated waveforms with automatic calibration.
//!
//! `cargo bench --bench accuracy` prints every figure with its goal from docs/explanation/accuracy.md.
//! Arguments select parts of the table (`-- A6 A9`); `count=2000` reduces the waveforms per figure
//! from 20 000. Seeds are fixed for parts of a cell, so the figures do not depend on the number of
//! threads.
#![allow(missing_docs, reason = "a bench is never imported")]
#![allow(
    clippy::print_stdout,
    clippy::expect_used,
    clippy::unwrap_used,
    clippy::panic,
    reason = "a bench prints its figures"
)]

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Instant;

use wavex_signal::calibrate::response::calibrate_response;
use wavex_signal::calibrate::{CalibrationSettings, calibrate, receiver_limits};
use wavex_signal::decompose::Mode;
use wavex_signal::decompose::Waveform;
use wavex_signal::decompose::{DecomposeSettings, Return};
use wavex_signal::detect::Detector;
use wavex_signal::sensor_model::ChannelModel;
use wavex_signal::shape::Pulse;
use wavex_signal::shape::Shape;
use wavex_signal::whitening::Whitener;

mod every;
mod isolated;
mod noise;
mod pairs;
mod strong;
mod timing;

use wavex_testkit::instrument::{
    BACKGROUND_DN, EIGHT_BITS, Echo, Instrument, NOISE_SD_DN, Response, SAMPLES, TWELVE_BITS,
    autocorrelation, bound, mean_bound, moments, noise_sd_dn,
};
use wavex_testkit::waveform_decomposer::WaveformDecomposer;

const THREADS: u32 = 2;
/// Waveforms per seed.
const PART: u32 = 500;
const CALIBRATION: u32 = 20_000;
const NOISE_BLOCKS: u32 = 1_000_000;

/// State shared by all parts of the table.
struct Bench {
    response: Arc<Response>,
    /// Number of waveforms per figure.
    count: u32,
    missed: u32,
    goals: u32,
}

/// Kind of waveforms and their decomposition.
struct Cell<'a> {
    seed: u64,
    count: u32,
    model: &'a ChannelModel,
    settings: &'a DecomposeSettings,
    mode: Mode,
    ringing_sd: f64,
}

impl Bench {
    /// Prints a figure with its goal.
    fn goal(&mut self, goal: &str, what: &str, figure: String, asked: &str, reached: bool) {
        self.verdict(goal, what, figure, asked, [reached, reached]);
    }

    /// Prints a figure with its goal and result.
    ///
    /// `reached` is for the figure itself, and for the figure with a margin of two of its standard
    /// deviations.
    fn verdict(&mut self, goal: &str, what: &str, figure: String, asked: &str, reached: [bool; 2]) {
        self.goals += 1;
        let verdict = match reached {
            [true, _] => "reached",
            [false, true] => "within 2 SD",
            _ => "MISSED",
        };
        self.missed += u32::from(verdict == "MISSED");
        println!("{goal:4} {what:62} {figure:>28}   {asked:28} {verdict}");
    }

    /// Prints a figure without a goal.
    fn beside(&self, goal: &str, what: &str, figure: String) {
        println!("{goal:4} {what:62} {figure:>28}   -");
    }

    fn cell<'a>(&self, seed: u64, model: &'a ChannelModel, settings: &'a DecomposeSettings) -> Cell<'a> {
        Cell { seed, count: self.count, model, settings, mode: Mode::Refined, ringing_sd: 0.0 }
    }

    /// Evaluates the waveforms of a cell, in order.
    fn observe<T: Send>(
        &self,
        cell: &Cell<'_>,
        observe: impl Fn(&mut Instrument, &mut WaveformDecomposer) -> T + Sync,
    ) -> Vec<T> {
        let parts = cell.count.div_ceil(PART);
        let next = AtomicU32::new(0);
        let work = || {
            let mut engine = WaveformDecomposer::new(cell.model, cell.settings, cell.mode);
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

/// Calibrates the channel model from waveforms of many kinds.
fn calibrated(response: &Arc<Response>, seed: u64, full_scale_dn: f64, ringing_sd: f64) -> ChannelModel {
    let mut instrument = Instrument::new(response, seed, 0);
    instrument.ringing_sd = ringing_sd;
    let waveforms: Vec<Vec<u16>> = (0..CALIBRATION).map(|_| instrument.record_any(full_scale_dn)).collect();
    let blocks = || waveforms.iter().map(|samples| Waveform { samples });
    let settings = CalibrationSettings::echoes(1.0, full_scale_dn);
    let gaussian = calibrate(blocks(), &settings).expect("a calibration");
    calibrate_response(blocks(), &gaussian, &settings).expect("a response").model
}

/// Changes the full scale of a model.
///
/// A model calibrated with eight bits then fits unsaturated strong echoes.
fn of_scale(model: &ChannelModel, full_scale_dn: f64) -> ChannelModel {
    ChannelModel { full_scale_dn, ..model.clone() }
}

fn settings(split_evidence: f64) -> DecomposeSettings {
    DecomposeSettings { split_evidence: Some(split_evidence), ..DecomposeSettings::default() }
}

/// Error and its predicted standard deviation.
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

/// Compares position, height, width and deviation ratio of a return with its echo.
fn scores(r: &Return, echo: &Echo) -> ([Score; 3], f64) {
    let place = Score { error: r.position_samples - echo.place, sd: r.position_sd_samples };
    let height = Score { error: r.amplitude_dn - NOISE_SD_DN * echo.snr, sd: r.amplitude_sd_dn };
    let width = Score { error: r.width_ratio - echo.width, sd: r.width_ratio_sd };
    ([place, height, width], r.deviation_ratio)
}

fn within(value: f64, low: f64, high: f64) -> bool {
    (low..=high).contains(&value)
}

/// Checks whether a figure is within limits.
///
/// Also within limits widened by two of its SDs.
fn within_known(value: f64, low: f64, high: f64, sd: f64) -> [bool; 2] {
    [within(value, low, high), within(value, low - 2.0 * sd, high + 2.0 * sd)]
}

/// Returns the SD of an estimated SD near 1.
///
/// `known_coverage`: of a fraction near 0.68, %.
fn known_spread(count: usize) -> f64 {
    1.0 / (2.0 * count as f64).sqrt()
}

fn known_coverage(count: usize) -> f64 {
    100.0 * (0.68 * 0.32 / count as f64).sqrt()
}

/// Measures the time to decompose a waveform with one return.
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
        let mut engine = WaveformDecomposer::new(model, &settings, Mode::Refined);
        let started = Instant::now();
        let found: usize = waveforms.iter().map(|samples| engine.decompose(samples).0.len()).sum();
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
    if wanted("A10") {
        timing::calibration(&bench);
    }
    if chosen.iter().all(|word| *word == "A10") && !chosen.is_empty() {
        return;
    }
    let started = Instant::now();
    println!("{count} waveforms for each figure, response {:.3} ns wide", bench.response.fwhm_ns);
    let model = calibrated(&bench.response, 1, EIGHT_BITS, 0.0);
    println!("calibrated in {:.0} s", started.elapsed().as_secs_f64());
    let gauge = isolated::calibration(&mut bench, &model);
    speed(&bench, &model);
    if wanted("A1") {
        isolated::isolated(&mut bench, &model, gauge);
    }
    if wanted("A5") {
        isolated::fastest(&mut bench, &model, gauge);
    }
    if wanted("A6") {
        noise::false_alarms(&mut bench, &model);
    }
    if wanted("A7") {
        pairs::overlapping(&mut bench, &model);
        pairs::false_splits(&mut bench, &model);
    }
    if wanted("C2") {
        pairs::bright(&mut bench, &model);
    }
    if wanted("C3") {
        every::every_return(&mut bench, &model);
    }
    if wanted("A9") {
        strong::late_returns(&mut bench);
    }
    if wanted("A11") {
        strong::saturated(&mut bench, &model);
        strong::clipped(&mut bench, &model);
    }
    println!("{} of {} goals missed; {:.0} s", bench.missed, bench.goals, started.elapsed().as_secs_f64());
}
