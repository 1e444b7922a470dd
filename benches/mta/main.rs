//! Accuracy and speed of MTA resolution on simulated scenes.
//!
//! There are ten scenes, with goals. `cargo bench --bench mta` prints the table of docs/explanation/mta.md.
//! Arguments select rows (`-- 17ns terrain`); `seed=300` selects other scenes of the same kind. The
//! scenes of a row have about five million echoes. Times are CPU times of the thread, from the
//! first line pushed to the last one popped.
//!
//! `cargo build --release --example sdf_stand_in && cargo bench --bench mta -- chain` runs the
//! scenes with waveforms through the whole chain instead, by `read_arrow` and by `read_sdf` with
//! the stand-in, and compares ranges and points with the truth.
#![allow(missing_docs, reason = "a bench is never imported")]
#![allow(clippy::print_stdout, clippy::expect_used, reason = "a bench prints its figures")]

use wavex_returns::mta::{Cause, Echo, Emission, Line, Method, Prior, Resolved, Resolver, Settings};

use wavex_simulation::mta_scenes::{
    EchoScene, RecordedEcho, RecordedLine, RecordingSettings, SCENES, TargetClass,
};
use wavex_testkit::clock::cpu_s;
use wavex_testkit::mta::{chain, recording};

const LINES: u32 = 120;
const SEED: u64 = 100;
const GOAL_US: f64 = 0.5;
/// Largest errors of the terrain model and of the height above ground, m.
const TERRAIN_ERROR_M: f64 = 20.0;
const HEIGHT_ERROR_M: f64 = 40.0;

/// Prior knowledge in a row.
#[derive(Clone, Copy, PartialEq)]
enum Known {
    Nothing,
    Terrain,
    Height,
}

/// Row of the table.
struct Row {
    name: &'static str,
    modulation_ns: f64,
    pulse_rate_hz: f64,
    known: Known,
    /// Required percentage of correct echoes, away from and near transitions.
    ///
    /// `None` for comparison only.
    goal: Option<f64>,
}

const ROWS: [Row; 8] = [
    row("50ns", 50.0, 400e3, Known::Nothing, Some(99.9)),
    row("17ns", 17.0, 400e3, Known::Nothing, Some(99.9)),
    row("15ns", 15.0, 400e3, Known::Nothing, Some(99.9)),
    row("9ns", 9.0, 400e3, Known::Nothing, Some(99.8)),
    row("5ns", 5.0, 400e3, Known::Nothing, Some(99.0)),
    row("terrain", 0.0, 400e3, Known::Terrain, Some(99.99)),
    row("height", 0.0, 400e3, Known::Height, None),
    row("1MHz", 7.0, 1e6, Known::Nothing, None),
];

const fn row(
    name: &'static str,
    modulation_ns: f64,
    pulse_rate_hz: f64,
    known: Known,
    goal: Option<f64>,
) -> Row {
    Row { name, modulation_ns, pulse_rate_hz, known, goal }
}

/// Numbers of echoes and of wrong ones.
///
/// Away from transitions, near them, then by class.
#[derive(Default)]
struct Tally {
    groups: [(u64, u64); 6],
    uncertain: u64,
    uncertain_wrong: u64,
    echoes: u64,
    seconds: f64,
}

impl Tally {
    fn percent(&self, group: usize) -> f64 {
        let (count, wrong) = self.groups[group];
        100.0 * wrong as f64 / count.max(1) as f64
    }

    fn microseconds(&self) -> f64 {
        self.seconds * 1e6 / self.echoes.max(1) as f64
    }

    fn count(&mut self, recorded: &[RecordedLine], resolved: &[Resolved]) {
        for (line, resolved) in recorded.iter().zip(resolved) {
            for (echo, assigned) in line.echoes.iter().zip(&resolved.echoes) {
                self.echoes += 1;
                let class = match echo.class {
                    TargetClass::Ground => 2,
                    TargetClass::Vegetation => 3,
                    TargetClass::Building => 4,
                    TargetClass::Wire => 5,
                    TargetClass::FalseAlarm => continue,
                };
                let cause = Cause { line: u64::from(echo.cause.0), emission: echo.cause.1 };
                let wrong = u64::from(assigned.cause != Some(cause));
                for group in [usize::from(echo.near), class] {
                    self.groups[group].0 += 1;
                    self.groups[group].1 += wrong;
                }
                self.uncertain += u64::from(assigned.uncertain);
                self.uncertain_wrong += wrong * u64::from(assigned.uncertain);
            }
        }
    }
}

fn lines(scene: &EchoScene, recorded: &[RecordedLine]) -> Vec<Line> {
    let mut shot = 0;
    let mut emission = |line: usize, index: usize, recorded: &RecordedLine| {
        shot += 1;
        Emission {
            clock_ps: recorded.clocks_ps[index],
            shot,
            cos_nadir: recorded.cosines[index],
            prior_range_m: scene.prior_m(line, index, recorded.ground_m[index], TERRAIN_ERROR_M),
            ..Emission::default()
        }
    };
    let echo = |echo: &RecordedEcho| Echo { emission: echo.emission, time_ns: echo.time_ns };
    let line = |(number, recorded): (usize, &RecordedLine)| Line {
        emissions: (0..recorded.clocks_ps.len()).map(|index| emission(number, index, recorded)).collect(),
        echoes: recorded.echoes.iter().map(echo).collect(),
        ..Line::default()
    };
    recorded.iter().enumerate().map(line).collect()
}

/// Resolves all lines and returns the CPU time.
///
/// `None` if the resolver reports an error.
fn resolve(settings: &Settings, lines: &[Line]) -> Option<(Vec<Resolved>, f64)> {
    let before = cpu_s();
    let mut resolver = Resolver::new(settings).expect("settings");
    let mut resolved = Vec::with_capacity(lines.len());
    for line in lines {
        resolver.push(line).ok()?;
        resolved.extend(std::iter::from_fn(|| resolver.pop()));
    }
    resolver.finish().ok()?;
    resolved.extend(std::iter::from_fn(|| resolver.pop()));
    Some((resolved, cpu_s() - before))
}

fn settings(row: &Row, scene: &EchoScene, method: Method) -> Settings {
    let prior = match row.known {
        Known::Nothing => Prior::None,
        Known::Terrain => Prior::PerEmission { sd_m: TERRAIN_ERROR_M },
        Known::Height => Prior::Agl {
            agl_m: scene.spec.agl_m + HEIGHT_ERROR_M,
            sd_m: scene.spec.relief_m.max(HEIGHT_ERROR_M),
        },
    };
    Settings { method, prior, ..Settings::default() }
}

/// Measures one row, with the block method and with the variance method.
fn measure(row: &Row, scenes: &[EchoScene]) -> [Tally; 2] {
    let mut tallies = [Tally::default(), Tally::default()];
    for scene in scenes {
        let how = RecordingSettings {
            pulse_rate_hz: row.pulse_rate_hz,
            modulation_ns: row.modulation_ns,
            blind_ns: 15.0,
            lost_records: 0.0,
        };
        let recorded = scene.record(&how);
        let lines = lines(scene, &recorded);
        for (tally, method) in tallies.iter_mut().zip([Method::Blocks, Method::Variance { buffer: 50 }]) {
            let before = tally.groups.map(|group| group.1);
            if let Some((resolved, seconds)) = resolve(&settings(row, scene, method), &lines) {
                tally.count(&recorded, &resolved);
                tally.seconds += seconds;
            }
            let wrong = tally.groups[0].1 + tally.groups[1].1 - before[0] - before[1];
            if method == Method::Blocks && wrong > 0 {
                println!("      {}: {wrong} wrong in \"{}\"", row.name, scene.spec.name);
            }
        }
    }
    tallies
}

fn print(row: &Row, [blocks, variance]: &[Tally; 2]) {
    let right = |group: usize| 100.0 - blocks.percent(group);
    let goal = row.goal.map_or(String::new(), |goal| {
        let reached = right(0) >= goal && right(1) >= goal;
        format!("goal {goal} % right: {}", if reached { "reached" } else { "NOT REACHED" })
    });
    let speed = if blocks.microseconds() <= GOAL_US { "reached" } else { "NOT REACHED" };
    println!(
        "{:8} wrong away {:.4} %, near {:.4} %; ground {:.4}, vegetation {:.4}, buildings {:.4}, wires {:.4} %; {goal}",
        row.name,
        blocks.percent(0),
        blocks.percent(1),
        blocks.percent(2),
        blocks.percent(3),
        blocks.percent(4),
        blocks.percent(5),
    );
    println!(
        "      {:.3} us per echo (goal {GOAL_US}: {speed}), {} echoes, {} uncertain, {} of these wrong",
        blocks.microseconds(),
        blocks.echoes,
        blocks.uncertain,
        blocks.uncertain_wrong
    );
    println!(
        "      variance method: wrong away {:.2} %, near {:.2} %, {:.3} us per echo",
        variance.percent(0),
        variance.percent(1),
        variance.microseconds()
    );
}

/// Runs the scenes with a modulation of ±17 ns through the whole chain with both readers.
fn through_the_chain(seed: u64) {
    let how =
        RecordingSettings { pulse_rate_hz: 400e3, modulation_ns: 17.0, blind_ns: 15.0, lost_records: 0.0 };
    let (mut echoes, mut right) = (0, 0);
    for (seed, spec) in (seed..).zip(SCENES) {
        let folder = tempfile::tempdir().expect("a folder");
        let scene = EchoScene::new(spec, seed, LINES, 1.0);
        let truth = recording::write(&scene, &scene.record(&how), folder.path());
        chain::run(folder.path(), "");
        let (are_same, score) = chain::compare(folder.path(), &truth);
        let same = if are_same { "identical bytes from both readers" } else { "THE READERS DIFFER" };
        println!(
            "{}: {same}; {score}; point and range errors differ by at most {:.4} mm",
            spec.name,
            1e3 * score.worst_beyond_range_m
        );
        (echoes, right) = (echoes + score.echoes, right + score.right);
    }
    println!("{right} of {echoes} right: {:.4} %", 100.0 * right as f64 / echoes.max(1) as f64);
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    let seed = arguments.iter().find_map(|word| word.strip_prefix("seed=")?.parse().ok()).unwrap_or(SEED);
    let chosen: Vec<&String> = arguments.iter().filter(|word| !word.starts_with("seed=")).collect();
    if chosen.iter().any(|word| *word == "chain") {
        return through_the_chain(seed);
    }
    let is_chosen = |row: &Row| chosen.is_empty() || chosen.iter().any(|word| *word == row.name);
    for fast in [false, true] {
        let rows: Vec<&Row> =
            ROWS.iter().filter(|row| is_chosen(row) && (row.pulse_rate_hz > 5e5) == fast).collect();
        if rows.is_empty() {
            continue;
        }
        let scenes: Vec<EchoScene> = (0u64..)
            .zip(SCENES)
            .map(|(i, mut spec)| {
                // At 1 MHz the flying height is 1200 to 2000 m, with half the relief.
                if fast {
                    (spec.agl_m, spec.relief_m) = (1200.0 + 800.0 / 9.0 * i as f64, 0.5 * spec.relief_m);
                }
                EchoScene::new(spec, seed + i, LINES, 1.0)
            })
            .collect();
        for row in rows {
            print(row, &measure(row, &scenes));
        }
    }
}
