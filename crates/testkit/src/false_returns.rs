//! Simulated scenes with false returns, and scores of outlier filters.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use wavex::registry::STAGES;

use wavex::engine::{self, Options};
use wavex::job::Job;
use wavex::registry;
use wavex::scan_line::{Content, Return, ScanLine};
use wavex::stage::{Context, Output, Plan, RunContext};

/// A scene: name, keys of `simulate`, and minimum distance of a false return from every true one to
/// count as an outlier, m.
///
/// Nearer false returns lie among true ones. The distance is that at which the filter treats two
/// returns as one object.
pub struct Scene {
    /// Name of the row in the table.
    pub name: &'static str,
    /// Keys of `simulate`.
    pub keys: &'static str,
    /// Distance from true returns within which a false one is among them.
    pub margin_m: f64,
}

/// Keys common to all country scenes.
const COUNTRY: &str = "landscape = 'country'\nfalse_alarm_rate = 0.01\nwater_ratio = 0.0\n";

/// All scenes.
pub const SCENES: [Scene; 9] = [
    Scene {
        name: "strips",
        keys: "false_alarm_rate = 0.01\nlines = 60\nshots_per_line = 800\n",
        margin_m: 4.0,
    },
    Scene {
        name: "relief",
        keys: "lines = 60\nshots_per_line = 800\nrelief_m = 600\nflying_height_m = 1000\nwood_ratio = 0.1\n\
               house_ratio = 0.05\nwire_height_m = 0\n",
        margin_m: 4.0,
    },
    Scene {
        name: "forest",
        keys: "lines = 60\nshots_per_line = 800\nwood_ratio = 0.9\ncanopy_height_m = 35\nhouse_ratio = 0.0\nrelief_m = 150\n",
        margin_m: 4.0,
    },
    Scene {
        name: "wires",
        keys: "lines = 120\nshots_per_line = 600\nwood_ratio = 0.0\nhouse_ratio = 0.0\nwire_height_m = 30\nrelief_m = 60\n",
        margin_m: 4.0,
    },
    Scene {
        name: "buildings",
        keys: "lines = 60\nshots_per_line = 800\nwood_ratio = 0.05\nhouse_ratio = 0.8\nbuilding_height_m = 120\n",
        margin_m: 4.0,
    },
    Scene {
        name: "sparse",
        keys: "lines = 100\nshots_per_line = 300\npulse_rate_hz = 9000\nscan_angle_deg = [-25.0, 25.0]\n",
        margin_m: 7.5,
    },
    Scene {
        name: "swinging mirror",
        keys: "lines = 60\nshots_per_line = 800\nscanner = 'oscillating'\nroll_deg = 4\npitch_deg = 2\nyaw_deg = 3\n",
        margin_m: 4.0,
    },
    Scene {
        name: "circular",
        keys: "lines = 60\nshots_per_line = 800\nscanner = 'circular'\nscan_angle_deg = [-20, 20]\nrotation_hz = 93.75\n\
               roll_deg = 4\npitch_deg = 2\nyaw_deg = 3\nwire_height_m = 30\n",
        margin_m: 4.0,
    },
    Scene {
        name: "many false",
        keys: "lines = 60\nshots_per_line = 800\nfalse_alarm_rate = 0.05\nwood_ratio = 0.4\nhouse_ratio = 0.3\n",
        margin_m: 4.0,
    },
];

/// A true return.
#[derive(Clone, Debug, PartialEq)]
pub struct True {
    /// Number of its shot.
    pub shot: u64,
    /// True range.
    pub range_m: f64,
    /// True position.
    pub point_m: [f64; 3],
    /// Type of its target, or `false_alarm`.
    pub class: String,
}

/// A flight: lines with true returns, and the type of each return by line.
pub struct Flight {
    /// Scan lines with true ranges.
    pub lines: Vec<ScanLine>,
    /// True returns of each line, in its order.
    pub truth: Vec<Vec<True>>,
}

/// Simulates a flight over a scene; another seed gives another scene of the same kind.
pub fn fly(scene: &Scene, seed: u64) -> Flight {
    let keys = keys(scene, seed);
    let folder = tempfile::tempdir().expect("a folder");
    let text = format!("[[stage]]\ntype = 'simulate'\ntruth = 'truth.csv'\n{keys}");
    let job = Job::parse(STAGES, "fly.toml", &text, &[]).unwrap_or_else(|errors| panic!("{errors}"));
    engine::run(&job, &Options::of_job(&job, folder.path(), folder.path())).expect("a flight");
    let rows = rows(&folder.path().join("truth.csv"));
    let Plan::Source(source) = planned("simulate", &keys) else { panic!("a source") };
    let mut source = source.make(&run()).expect("a flight");
    let mut flight = Flight { lines: Vec::new(), truth: Vec::new() };
    let mut rows = rows.into_iter().peekable();
    while let Some(mut scan_line) = source.next(&mut Context::default()).expect("a line") {
        let mut returns = Vec::new();
        let mut truth = Vec::new();
        for (index, emission) in scan_line.emissions.iter().enumerate() {
            let mut of_shot: Vec<True> = Vec::new();
            while let Some(row) = rows.next_if(|row| row.shot == emission.shot) {
                of_shot.push(row);
            }
            let n = of_shot.len() as u8;
            returns.extend(
                (1..).zip(&of_shot).map(|(number, row)| return_at(index as u32, number, n, row.range_m)),
            );
            truth.extend(of_shot);
        }
        scan_line.stats.nw_with_points = scan_line.stats.nw;
        scan_line.stats.np = returns.len() as u64;
        scan_line.content = Content::Returns(returns);
        flight.lines.push(scan_line);
        flight.truth.push(truth);
    }
    flight
}

/// Copies the lines of `fly(scene, seed)` with beams in the frame of the scanner.
pub fn without_trajectory(flight: &Flight, scene: &Scene, seed: u64) -> Vec<ScanLine> {
    let keys = format!("{}sbet = 'unused.out'\n", keys(scene, seed));
    let Plan::Source(source) = planned("simulate", &keys) else { panic!("a source") };
    let run = RunContext { has_outputs: false, ..run() };
    let mut source = source.make(&run).expect("a flight");
    let mut line = |of_map: &ScanLine| {
        let mut line = source.next(&mut Context::default()).expect("a line").expect("as many lines");
        line.stats = of_map.stats.clone();
        line.content = Content::Returns(of_map.returns().expect("returns").clone());
        line
    };
    flight.lines.iter().map(&mut line).collect()
}

/// Keys of `simulate` for a scene.
fn keys(scene: &Scene, seed: u64) -> String {
    let country = scene.name != "strips";
    let own = |key: &str| scene.keys.contains(key);
    let common: String = COUNTRY
        .lines()
        .filter(|line| country && !own(line.split(' ').next().unwrap_or("")))
        .map(|line| format!("{line}\n"))
        .collect();
    format!("seed = {seed}\n{common}{}", scene.keys)
}

fn run() -> RunContext {
    RunContext {
        input: PathBuf::new(),
        stem: String::new(),
        input_dir: PathBuf::new(),
        output_dir: PathBuf::new(),
        simd: wavex_simd::SimdLevel::best(),
        ..RunContext::alone("".as_ref())
    }
}

fn planned(stage: &str, keys: &str) -> Plan {
    let spec = registry::find(stage).expect("a stage");
    let table = toml::de::DeTable::parse(keys).expect("the test's own TOML");
    (spec.parse)(table).expect("the test's own keys").plan
}

fn rows(path: &Path) -> Vec<True> {
    let text = std::fs::read_to_string(path).expect("the truth");
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().expect("names").split(',').collect();
    let column = |name: &str| names.iter().position(|n| *n == name).expect("a column");
    let [shot, range, x, y, z, class] = ["shot", "range_m", "x", "y", "z", "class"].map(column);
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let number = |at: usize| -> f64 { cells[at].parse().expect("a number") };
        True {
            shot: cells[shot].parse().expect("a shot"),
            range_m: number(range),
            point_m: [number(x), number(y), number(z)],
            class: cells[class].to_owned(),
        }
    };
    lines.map(row).collect()
}

/// A return with a position only.
pub fn return_at(emission: u32, return_number: u8, number_of_returns: u8, range_m: f64) -> Return {
    Return {
        emission,
        return_number,
        number_of_returns,
        range_m,
        range_sd_m: 0.003,
        amplitude_dn: 50.0,
        ..Return::default()
    }
}

/// Copies a line for a second filter.
pub fn copy(line: &ScanLine) -> ScanLine {
    let mut copy =
        ScanLine::of_shots(line.input.clone(), line.line, line.emissions.clone(), Default::default());
    copy.stats = line.stats.clone();
    copy.content = Content::Returns(line.returns().expect("returns").clone());
    copy
}

/// Lines after `filter_outliers` with these keys, and the run time in seconds.
pub fn filtered(lines: Vec<ScanLine>, keys: &str, may_hold_bytes: usize) -> (Vec<ScanLine>, Context, f64) {
    let Plan::Transform(filter) = planned("filter_outliers", keys) else { panic!("a transform") };
    let mut filter = filter.make(&run()).expect("a filter");
    let (mut cx, mut given_on) = (Context::default(), Vec::new());
    let mut emit = |scan_line: ScanLine| {
        given_on.push(scan_line);
        Ok(())
    };
    let mut out = Output::new(&mut cx, may_hold_bytes, &mut emit);
    let started = std::time::Instant::now();
    for line in lines {
        filter.process(line, &mut out).expect("a line");
    }
    filter.finish(&mut out).expect("an end");
    let seconds = started.elapsed().as_secs_f64();
    (given_on, cx, seconds)
}

/// Score of an outlier filter.
#[derive(Clone, Debug, Default)]
pub struct Score {
    /// False returns away from all true ones: total and detected.
    pub outliers: [usize; 2],
    /// False returns among true ones: total and detected.
    pub among: [usize; 2],
    /// True returns by class: total and marked as outliers.
    pub true_returns: HashMap<String, [usize; 2]>,
    /// Returns of rejected waveforms.
    pub rejected: usize,
}

impl Score {
    /// Detected outliers, percent.
    pub fn detected_percent(&self) -> f64 {
        100.0 * self.outliers[1] as f64 / self.outliers[0].max(1) as f64
    }

    /// True returns marked as outliers, percent: all, or of one class.
    pub fn lost_percent(&self, class: Option<&str>) -> f64 {
        let of_class = |(name, _): &(&String, &[usize; 2])| class.is_none_or(|class| class == *name);
        let (mut all, mut lost) = (0, 0);
        for (_, [n, out]) in self.true_returns.iter().filter(of_class) {
            (all, lost) = (all + n, lost + out);
        }
        100.0 * lost as f64 / all.max(1) as f64
    }
}

/// Scores a filter on a flight; `is_out` gives whether a return was marked or rejected.
pub fn score(flight: &Flight, margin_m: f64, is_out: impl Fn(usize, usize) -> bool) -> Score {
    let cell = |p: [f64; 3]| p.map(|x| (x / margin_m).floor() as i64);
    let mut grid: HashMap<[i64; 3], Vec<[f64; 3]>> = HashMap::new();
    for row in flight.truth.iter().flatten().filter(|row| row.class != "false_alarm") {
        grid.entry(cell(row.point_m)).or_default().push(row.point_m);
    }
    let is_among = |p: [f64; 3]| {
        let [i, j, k] = cell(p);
        let near = |q: &[f64; 3]| (0..3).map(|a| (p[a] - q[a]).powi(2)).sum::<f64>() <= margin_m * margin_m;
        let steps = [-1, 0, 1];
        steps.iter().any(|a| {
            steps.iter().any(|b| {
                steps
                    .iter()
                    .any(|c| grid.get(&[i + a, j + b, k + c]).is_some_and(|points| points.iter().any(near)))
            })
        })
    };
    let mut score = Score::default();
    for (line, rows) in flight.truth.iter().enumerate() {
        for (index, row) in rows.iter().enumerate() {
            let out = usize::from(is_out(line, index));
            let counts = match row.class.as_str() {
                "false_alarm" if is_among(row.point_m) => &mut score.among,
                "false_alarm" => &mut score.outliers,
                class => score.true_returns.entry(class.to_owned()).or_default(),
            };
            counts[0] += 1;
            counts[1] += out;
        }
    }
    score
}

/// Line, shot and range (bits) of the returns that are not withheld.
pub fn kept(lines: &[ScanLine]) -> HashSet<(usize, u32, u64)> {
    let of_line = |(at, line): (usize, &ScanLine)| {
        let returns = line.returns().expect("returns").iter().filter(|r| !r.withheld);
        returns.map(move |r| (at, r.emission, r.range_m.to_bits())).collect::<Vec<_>>()
    };
    lines.iter().enumerate().flat_map(of_line).collect()
}

/// Scores `filter_outliers` on a flight.
pub fn score_of_stage(flight: &Flight, lines: &[ScanLine], margin_m: f64) -> Score {
    let kept = kept(lines);
    let before = |line: usize, index: usize| flight.lines[line].returns().expect("returns")[index];
    let is_out = |line: usize, index: usize| {
        let r = before(line, index);
        !kept.contains(&(line, r.emission, r.range_m.to_bits()))
    };
    let mut score = score(flight, margin_m, is_out);
    let n = |lines: &[ScanLine]| lines.iter().map(ScanLine::n_returns).sum::<usize>();
    score.rejected = n(&flight.lines) - n(lines);
    score
}
