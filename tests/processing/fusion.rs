//! Joint use of two receivers: ranges across their transition reach the joint bound without a step.
//!
//! The whole chain runs, with all calibration from the recording itself.

mod blinded;

use std::path::Path;
use std::sync::Arc;

use nalgebra::{DMatrix, DVector, Matrix3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex::engine::{self, InputSummary};
use wavex::registry;
use wavex::scan_line::{Blocks, Channel, Emission, EmissionReference, InputInfo, Kind, ScanLine};
use wavex::stage::{Config, Context, Paths, Result, RunContext, Source, SourceConfig, StageSpec};
use wavex_simulation::pulse::PulseShape;
use wavex_simulation::random::{Purpose, Random};
use wavex_simulation::receiver::{HighPower, ReceivedEcho, ReceiverSettings, SimulatedReceiver};
use wavex_testkit::engine_stages::{into, job};

const FULL_SCALE_DN: f64 = 255.0;
const BACKGROUND_DN: [f64; 2] = [12.0, 12.4];
const LOW_NOISE_DN: f64 = 2.0;
const HIGH_NOISE_DN: f64 = 0.7;
const AUTOCORRELATION: [f64; 4] = [0.63, 0.42, 0.22, 0.11];
const GAIN: f64 = 10.0;
/// Delay and sample raster of the other receiver, ns.
const DELAY_NS: f64 = 0.52;
const RASTER_NS: f64 = 1.43;
const SPEED_M_PER_NS: f64 = 0.299_792_458;
const SHOTS_PER_LINE: u32 = 500;

/// One echo per shot, of any amplitude and phase, seen by two receivers.
///
/// The clock gives the exact emission time, so range errors are errors of the echoes only.
#[derive(Clone, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
struct TwoReceivers {
    lines: u32,
    seed: u64,
    /// Amplitudes in the sensitive receiver, evenly spaced in their logarithm.
    heights_dn: [f64; 2],
    /// Whether the saturated sensitive receiver sees echoes early.
    walks: bool,
    /// Whether every second shot has two echoes that share a plateau in the sensitive receiver.
    shares_plateau: bool,
    /// Whether only one shot in 128 is strong, which alone the other receiver records; the others
    /// have 30 to 180 DN.
    few_strong: bool,
}

impl Default for TwoReceivers {
    fn default() -> TwoReceivers {
        TwoReceivers {
            lines: 6,
            seed: 1,
            heights_dn: [60.0, 4400.0],
            walks: false,
            shares_plateau: false,
            few_strong: false,
        }
    }
}

impl Config for TwoReceivers {}

impl SourceConfig for TwoReceivers {
    fn paths(&self) -> Option<&Paths> {
        None
    }

    fn make(&self, _: &RunContext) -> Result<Box<dyn Source>> {
        let input = InputInfo {
            stem: "two".into(),
            full_scale_dn: Some(FULL_SCALE_DN as u16),
            emission_reference: EmissionReference::OutgoingPulse,
            ..InputInfo::default()
        };
        let mut settings = settings();
        if let (true, Some(high)) = (self.few_strong, &mut settings.high_power) {
            high.from_dn = 226.0;
        }
        let receiver = SimulatedReceiver::new(&settings).unwrap();
        Ok(Box::new(Recording { config: self.clone(), line: 0, input: Arc::new(input), receiver }))
    }
}

const TWO_RECEIVERS: StageSpec = StageSpec::source::<TwoReceivers>("two_receivers", Kind::Shots);

fn settings() -> ReceiverSettings {
    ReceiverSettings {
        interval_ns: 1.0,
        full_scale_dn: FULL_SCALE_DN as u16,
        background_dn: BACKGROUND_DN,
        noise_sd_dn: LOW_NOISE_DN,
        noise_autocorrelation: AUTOCORRELATION.to_vec(),
        odd_sample_shift: 0.0,
        response: PulseShape::riegl(),
        reference: PulseShape::riegl_reference(),
        high_power: Some(HighPower { from_dn: 100.0, noise_sd_dn: HIGH_NOISE_DN, delay_ns: DELAY_NS }),
    }
}

struct Recording {
    config: TwoReceivers,
    line: u32,
    input: Arc<InputInfo>,
    receiver: SimulatedReceiver,
}

/// Truth: amplitude and time of the echo of a shot.
fn truth(config: &TwoReceivers, shot: u32) -> (f64, f64) {
    let mut random =
        Random::of_shot(config.seed, shot / SHOTS_PER_LINE, shot % SHOTS_PER_LINE, Purpose::FalseAlarms);
    let is_weak = config.few_strong && !shot.is_multiple_of(128);
    let [least, most] = if is_weak { [30.0, 180.0] } else { config.heights_dn };
    (least * (most / least).powf(random.uniform()), 4000.0 + 200.0 * random.uniform())
}

/// Amplitudes and times of all echoes of a shot.
fn truths(config: &TwoReceivers, shot: u32) -> Vec<(f64, f64)> {
    let (height_dn, time_ns) = truth(config, shot);
    if !config.shares_plateau || shot % 2 == 1 {
        return vec![(height_dn, time_ns)];
    }
    let mut random =
        Random::of_shot(config.seed, shot / SHOTS_PER_LINE, shot % SHOTS_PER_LINE, Purpose::Modulation);
    let mut strong_dn = || 1000.0 * 2.5_f64.powf(random.uniform());
    let heights_dn = [strong_dn(), strong_dn()];
    vec![(heights_dn[0], time_ns), (heights_dn[1], time_ns + 6.0 + 3.0 * random.uniform())]
}

/// Advance of an echo in the saturated sensitive receiver, ns.
fn early_ns(config: &TwoReceivers, height_dn: f64) -> f64 {
    if config.walks { 0.005 * (height_dn - 210.0).clamp(0.0, 40.0) } else { 0.0 }
}

impl Recording {
    /// Adds the blocks of both receivers for a shot.
    fn record(&mut self, index: u32, echoes: &[ReceivedEcho], blocks: &mut Blocks) {
        let mut windows = Vec::new();
        self.receiver.windows(echoes, &mut windows);
        let mut random = [Purpose::Noise, Purpose::HighPowerNoise]
            .map(|p| Random::of_shot(self.config.seed, self.line, index, p));
        // A block without samples gives the exact emission time.
        blocks.push(index, Channel::Reference, None, 0.0, 1.0, &[]);
        let early = |echo: &ReceivedEcho| ReceivedEcho {
            time_ns: echo.time_ns - early_ns(&self.config, echo.amplitude_dn),
            ..*echo
        };
        let seen: Vec<ReceivedEcho> = echoes.iter().map(early).collect();
        let (start_ns, samples) = self.receiver.record(&windows[0], &seen, &mut random[0]);
        blocks.push(index, Channel::LowPower, None, start_ns, 1.0, samples);
        if self.receiver.is_strong(&windows[0], echoes) {
            let recorded = self.receiver.record_high_power(&windows[0], echoes, &mut random[1]);
            let (start_ns, samples) = recorded.unwrap();
            blocks.push(index, Channel::HighPower, None, start_ns, 1.0, samples);
        }
    }
}

impl Source for Recording {
    fn next(&mut self, _cx: &mut Context) -> Result<Option<ScanLine>> {
        if self.line == self.config.lines {
            return Ok(None);
        }
        let (mut blocks, mut emissions) = (Blocks::default(), Vec::new());
        let width = self.receiver.response().width(0.0);
        for index in 0..SHOTS_PER_LINE {
            let shot = self.line * SHOTS_PER_LINE + index;
            let echo = |(amplitude_dn, time_ns): (f64, f64)| ReceivedEcho {
                time_ns,
                amplitude_dn,
                high_power_dn: amplitude_dn / GAIN,
                linear_dn: amplitude_dn,
                width,
            };
            let echoes: Vec<ReceivedEcho> = truths(&self.config, shot).into_iter().map(echo).collect();
            self.record(index, &echoes, &mut blocks);
            emissions.push(Emission {
                shot: u64::from(shot),
                clock_ps: i64::from(shot) * 10_000_000,
                mta_zone: Some(0),
                ..Emission::default()
            });
        }
        self.line += 1;
        Ok(Some(ScanLine::of_shots(Arc::clone(&self.input), self.line - 1, emissions, blocks)))
    }
}

/// A return of the table.
struct Row {
    shot: u32,
    channel: String,
    range_m: f64,
    range_sd_m: f64,
    width_ratio: f64,
    width_ratio_sd: f64,
}

fn rows(path: &Path) -> Vec<Row> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let at = |name: &str| names.iter().position(|known| *known == name).unwrap();
    let [shot, channel, range, range_sd] = ["shot", "channel", "range_m", "range_sd_m"].map(at);
    let [width, width_sd] = ["width_ratio", "width_ratio_sd"].map(at);
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        Row {
            shot: cells[shot].parse().unwrap(),
            channel: cells[channel].to_owned(),
            range_m: cells[range].parse().unwrap(),
            range_sd_m: cells[range_sd].parse().unwrap(),
            width_ratio: cells[width].parse().unwrap(),
            width_ratio_sd: cells[width_sd].parse().unwrap(),
        }
    };
    lines.map(row).collect()
}

/// Autocovariance of a receiver's recorded noise: a process of order 4 plus white rounding noise.
fn autocovariance(sd_dn: f64, lags: usize) -> Vec<f64> {
    let (recorded, order) = (sd_dn * sd_dn, AUTOCORRELATION.len());
    let analog = recorded - 1.0 / 12.0;
    let mut covariance = vec![analog];
    covariance.extend(AUTOCORRELATION.iter().map(|rho| rho * recorded));
    let matrix = DMatrix::from_fn(order, order, |i, j| covariance[i.abs_diff(j)]);
    let message = DVector::from_fn(order, |i, _| covariance[i + 1]);
    let phi = matrix.lu().solve(&message).unwrap();
    while covariance.len() < lags {
        let next = (0..order).map(|i| phi[i] * covariance[covariance.len() - 1 - i]).sum();
        covariance.push(next);
    }
    covariance[0] = recorded;
    covariance
}

/// Fisher information on log amplitude, time (ns) and log width from the unsaturated of 60 samples
/// of one receiver.
///
/// The first sample is taken `first_ns` before the peak.
fn information(height_dn: f64, first_ns: f64, sd_dn: f64) -> Matrix3<f64> {
    let shape = PulseShape::riegl();
    let times: Vec<f64> = (0..60).map(|k| f64::from(k) - first_ns).collect();
    let level = |k: usize| BACKGROUND_DN[k % 2] + height_dn * shape.at(times[k], 0.0);
    let used: Vec<usize> = (0..60).filter(|&k| level(k) < FULL_SCALE_DN - 0.5).collect();
    let covariance = autocovariance(sd_dn, 60);
    let matrix = DMatrix::from_fn(used.len(), used.len(), |i, j| covariance[used[i].abs_diff(used[j])]);
    let solver = matrix.cholesky().unwrap();
    // A width ratio e^u adds the variance v0 (e^2u - 1) and keeps amplitude and position of the
    // peak.
    let step = 0.02_f64;
    let v0 = (shape.fwhm_ns() / 2.354_820_045).powi(2);
    let widened = |t: f64| {
        let v = v0 * ((2.0 * step).exp() - 1.0);
        let peak_ns = shape.peak_ns(v);
        shape.at(t + peak_ns, v) / shape.at(peak_ns, v)
    };
    let slope = |t: f64| (shape.at(t - 1e-3, 0.0) - shape.at(t + 1e-3, 0.0)) / 2e-3;
    let column = |f: &dyn Fn(f64) -> f64| DVector::from_fn(used.len(), |i, _| height_dn * f(times[used[i]]));
    let columns =
        [column(&|t| shape.at(t, 0.0)), column(&slope), column(&|t| (widened(t) - shape.at(t, 0.0)) / step)];
    let solved = [0, 1, 2].map(|j| solver.solve(&columns[j]));
    Matrix3::from_fn(|i, j| columns[i].dot(&solved[j]))
}

/// Bounds on the time of an echo, ns, averaged over sample phases: sensitive receiver, other
/// receiver, both.
fn bounds(height_dn: f64) -> [f64; 3] {
    const PHASES: u32 = 8;
    let mut variances = [0.0; 3];
    for phase in 0..PHASES {
        let first_ns = 16.0 + f64::from(phase) / f64::from(PHASES);
        let low = information(height_dn, first_ns, LOW_NOISE_DN);
        let high = information(height_dn / GAIN, first_ns + DELAY_NS - RASTER_NS, HIGH_NOISE_DN);
        for (variance, fisher) in variances.iter_mut().zip([low, high, low + high]) {
            *variance +=
                fisher.try_inverse().map_or(f64::INFINITY, |inverse| inverse[(1, 1)]) / f64::from(PHASES);
        }
    }
    variances.map(f64::sqrt)
}

fn run(keys: &str, fusion: Option<&str>, decompose: &str, folder: &Path) -> InputSummary {
    let of = |name| registry::find(name).unwrap();
    let mut stages = vec![(&TWO_RECEIVERS, keys)];
    stages.extend(fusion.map(|keys| (of("fuse_channels"), keys)));
    stages.push((of("calibrate"), ""));
    stages.push((of("decompose"), decompose));
    stages.push((of("write_table"), "path = \"returns.csv\""));
    let job = job(&stages);
    engine::run(&job, &into(&job, folder)).unwrap().inputs.remove(0)
}

/// One cell of the table: amplitudes from `snr` times the noise on.
struct Cell {
    snr: [f64; 2],
    /// Range errors, m, and errors normalised by the joint bound.
    errors_m: Vec<f64>,
    scores: Vec<f64>,
    /// Errors of ranges and widths, normalised by their own SD.
    own_scores: [Vec<f64>; 2],
    channels: [usize; 3],
}

fn moments(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (mean, (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt())
}

/// RMS including the mean: an error of the delay affects all ranges, and is included in their SD.
/// Standard deviation of a range above which a return counts as undetermined, m.
const UNSURE_M: f64 = 0.1;

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt()
}

fn cells(config: &TwoReceivers, rows: &[Row]) -> Vec<Cell> {
    const EDGES: [f64; 10] = [50.0, 70.0, 100.0, 150.0, 220.0, 330.0, 500.0, 800.0, 1200.0, 2000.0];
    let at_edges = EDGES.map(|snr| bounds(snr * LOW_NOISE_DN));
    let mut cells: Vec<Cell> = Vec::new();
    for (k, pair) in EDGES.windows(2).enumerate() {
        let mut cell = Cell {
            snr: [pair[0], pair[1]],
            errors_m: Vec::new(),
            scores: Vec::new(),
            own_scores: [Vec::new(), Vec::new()],
            channels: [0; 3],
        };
        for row in rows {
            let (height_dn, time_ns) = truth(config, row.shot);
            let part = (height_dn / LOW_NOISE_DN / pair[0]).ln() / (pair[1] / pair[0]).ln();
            let error_m = row.range_m - 0.5 * SPEED_M_PER_NS * time_ns;
            if !(0.0..1.0).contains(&part) || error_m.abs() > 0.3 {
                continue;
            }
            let bound_ns = at_edges[k][2].powf(1.0 - part) * at_edges[k + 1][2].powf(part);
            cell.errors_m.push(error_m);
            cell.scores.push(error_m / (0.5 * SPEED_M_PER_NS * bound_ns));
            cell.own_scores[0].push(error_m / row.range_sd_m);
            cell.own_scores[1].push((row.width_ratio - 1.0) / row.width_ratio_sd);
            cell.channels[["low", "high", "joint"].iter().position(|name| *name == row.channel).unwrap()] +=
                1;
        }
        let [low, high, joint] = at_edges[k].map(|bound_ns| 500.0 * SPEED_M_PER_NS * bound_ns);
        println!(
            "{:5}-{:4}: {:4} ({:?}) bounds mm low {low:5.2} high {high:5.2} joint {joint:5.2}; sd {:5.2} mm, over joint bound {:5.3}, \
             mean {:+5.2} mm, own score {:5.2}, of widths {:5.2}",
            pair[0],
            pair[1],
            cell.errors_m.len(),
            cell.channels,
            1e3 * moments(&cell.errors_m).1,
            moments(&cell.scores).1,
            1e3 * moments(&cell.errors_m).0,
            rms(&cell.own_scores[0]),
            rms(&cell.own_scores[1]),
        );
        cells.push(cell);
    }
    cells
}

/// Asserts at most one extra return per `one_in` echoes.
///
/// At 4.5 sigma, noise causes one false return in 10 000 waveforms per receiver.
fn assert_few_more(rows: &[Row], echoes: usize, one_in: usize) {
    assert!(rows.len() >= echoes && (rows.len() - echoes) * one_in <= echoes, "{} of {echoes}", rows.len());
}

#[test]
fn ranges_across_the_hand_over_reach_the_joint_bound_without_a_step() {
    let folder = tempfile::tempdir().unwrap();
    // Here the emission time has no error, and neither has the clock.
    let report = run("", Some(""), "timing_error_ns = 0.0", folder.path());
    let fusion = report.channel_fusion.as_ref().unwrap();
    println!("{fusion:?}");
    let count = |names: &[&str]| names.iter().map(|name| report.totals[name]).sum::<u64>();
    let kept_or_not = count(&["np", "np_filtered", "np_merged", "np_xtalk_dropped"]);
    assert_eq!(count(&["n_candidates", "n_added"]), kept_or_not, "every block is counted exactly once");
    assert!(report.totals["np_merged"] > 0);
    assert_eq!(report.filtered_by_reason.values().sum::<u64>(), report.totals["np_filtered"]);
    let rows = rows(&folder.path().join("returns.csv"));
    let config = TwoReceivers::default();
    println!("{} returns of {} shots", rows.len(), config.lines * SHOTS_PER_LINE);
    assert_few_more(&rows, (config.lines * SHOTS_PER_LINE) as usize, 1000);
    // An echo that clips both receivers may come out as two. Their standard deviations say so.
    let (unsure, rows): (Vec<Row>, Vec<Row>) = rows.into_iter().partition(|row| row.range_sd_m > UNSURE_M);
    println!("{} returns with a standard deviation above {UNSURE_M} m", unsure.len());
    assert!(unsure.len() as u32 * 500 <= config.lines * SHOTS_PER_LINE, "{}", unsure.len());
    let cells = cells(&config, &rows);
    for cell in &cells {
        let (_, ratio) = moments(&cell.scores);
        assert!(cell.errors_m.len() > 150 && ratio <= 1.15, "{:?}: {ratio}", cell.snr);
    }
    // Above this, errors of the calibrated response are no longer small compared with the noise,
    // and width SDs do not include them.
    let widths = cells.iter().take_while(|cell| cell.snr[1] <= 800.0).count();
    for (part, what, cells) in [(0, "range", &cells[..]), (1, "width", &cells[..widths])] {
        let all: Vec<f64> = cells.iter().flat_map(|cell| cell.own_scores[part].iter().copied()).collect();
        println!("{what}: errors are {:.3} of their standard deviations (0.95 to 1.05)", rms(&all));
        // Standard error of the root mean square.
        let margin = (2.0 * all.len() as f64).sqrt().recip();
        assert!((rms(&all) - 1.0).abs() <= 0.05 + margin, "{what}: {}", rms(&all));
        for cell in cells {
            let own = rms(&cell.own_scores[part]);
            assert!((0.85..=1.15).contains(&own), "{what}, {:?}: {own}", cell.snr);
        }
    }
    // Cells of the sensitive receiver alone against cells where both are used.
    let mean = |is_joint: bool| {
        let of_kind = cells.iter().filter(|cell| (cell.channels[2] > 0) == is_joint);
        moments(&of_kind.flat_map(|cell| cell.errors_m.iter().copied()).collect::<Vec<f64>>()).0
    };
    let step_m = mean(true) - mean(false);
    let means: Vec<f64> = cells.iter().map(|cell| moments(&cell.errors_m).0).collect();
    let spread = means.iter().fold(f64::NEG_INFINITY, |most: f64, x| most.max(*x))
        - means.iter().fold(f64::INFINITY, |least: f64, x| least.min(*x));
    println!(
        "step between the receivers {:+.2} mm, means of all cells within {:.2} mm (3)",
        1e3 * step_m,
        1e3 * spread
    );
    assert!(step_m.abs() <= 0.003 && spread <= 0.003);
    let delay_off = (fusion.delay_ns - DELAY_NS) / fusion.delay_sd_ns;
    let gain_off = (fusion.gain_ratio - GAIN) / fusion.gain_ratio_sd;
    println!("delay off by {delay_off:+.2} standard deviations, gain by {gain_off:+.2}");
    assert!(delay_off.abs() < 4.0 && (fusion.gain_ratio / GAIN - 1.0).abs() < 0.01);
}

/// Results of a simulated flight over level ground: range errors, channels, and counts of true
/// echoes with no or several returns.
struct Flight {
    low_m: Vec<f64>,
    both_m: Vec<f64>,
    high_m: Vec<f64>,
    returns: usize,
    truths: usize,
}

fn fly(detector: &str, ground_amplitude_dn: f64, fusion: bool) -> Flight {
    let folder = tempfile::tempdir().unwrap();
    let of = |name| registry::find(name).unwrap();
    let keys = format!(
        "lines = 8\nshots_per_line = 400\nhigh_power = true\nground_amplitude_dn = {ground_amplitude_dn:.1}\ndetector = \"{detector}\"\n\
         truth = \"truth.csv\"\nbuilding_height_m = 0.0\ncanopy_height_m = 0.0\nbackground_dn = [12.0, 12.4]"
    );
    let mut stages = vec![(of("simulate"), keys.as_str())];
    stages.extend(fusion.then(|| (of("fuse_channels"), "")));
    stages.extend([
        (of("calibrate"), ""),
        (of("decompose"), ""),
        (of("write_table"), "path = \"returns.csv\""),
    ]);
    let job = job(&stages);
    let report = engine::run(&job, &into(&job, folder.path())).unwrap().inputs.remove(0);
    println!("{detector}: {:?}", report.channel_fusion);
    for stage in &report.stages {
        stage.notes.iter().for_each(|note| println!("{}: {note}", stage.r#type));
    }
    let text = std::fs::read_to_string(folder.path().join("truth.csv")).unwrap();
    let names: Vec<&str> = text.lines().next().unwrap().split(',').collect();
    let at = |name: &str| names.iter().position(|known| *known == name).unwrap();
    let (shot, range) = (at("shot"), at("range_m"));
    let truths: Vec<(u32, f64)> = text
        .lines()
        .skip(1)
        .map(|line| {
            let cells: Vec<&str> = line.split(',').collect();
            (cells[shot].parse().unwrap(), cells[range].parse().unwrap())
        })
        .collect();
    let rows = rows(&folder.path().join("returns.csv"));
    let mut flight = Flight {
        low_m: Vec::new(),
        both_m: Vec::new(),
        high_m: Vec::new(),
        returns: rows.len(),
        truths: truths.len(),
    };
    for row in &rows {
        let off = truths.iter().filter(|truth| truth.0 == row.shot).map(|truth| row.range_m - truth.1);
        let Some(error_m) = off.min_by(|a, b| a.abs().total_cmp(&b.abs())).filter(|off| off.abs() < 0.2)
        else {
            continue;
        };
        match row.channel.as_str() {
            "low" => flight.low_m.push(error_m),
            "joint" => flight.both_m.push(error_m),
            _ => flight.high_m.push(error_m),
        }
    }
    for (name, errors) in [("low", &flight.low_m), ("joint", &flight.both_m), ("high", &flight.high_m)] {
        let (mean, sd) = moments(errors);
        println!(
            "{detector}, {name}: {} errors, mean {:+.2} mm, sd {:.2} mm",
            errors.len(),
            1e3 * mean,
            1e3 * sd
        );
    }
    println!("{} returns of {} echoes", flight.returns, flight.truths);
    flight
}

#[test]
fn a_flight_has_no_step_between_the_receivers() {
    for (detector, ground_amplitude_dn) in [("linear", 300.0), ("riegl", 600.0)] {
        let flight = fly(detector, ground_amplitude_dn, true);
        assert!(flight.low_m.len() > 100 && flight.both_m.len() > 100, "{detector}: both are used");
        let step_m = moments(&flight.both_m).0 - moments(&flight.low_m).0;
        println!("{detector}: step {:+.2} mm (3)", 1e3 * step_m);
        assert!(step_m.abs() <= 0.003, "{detector}: {step_m}");
        assert!(
            flight.returns.abs_diff(flight.truths) * 500 <= flight.truths,
            "{detector}: duplicate or missing returns"
        );
    }
}

#[test]
fn without_fusion_the_receivers_stay_apart() {
    let flight = fly("linear", 300.0, false);
    assert!(flight.both_m.is_empty() && !flight.high_m.is_empty());
}
