//! Simulated echo times with several pulses in the air, for the MTA resolver.
//!
//! Times of emissions and echoes, and the cause of each echo. There are no waveforms: an echo is a
//! time. The geometry of a scene is computed once; recording it with a pulse rate modulation adds
//! the times. Random numbers are hashes of their location, so every run and every part of a scene
//! has the same terrain.

mod landscape;

pub use landscape::hash;
use landscape::{EchoLandscape, HashedRandom, LineTargets, noise};

/// Half the speed of light in air.
///
/// Metres of range per nanosecond of two-way travel time.
pub const METRES_PER_NS: f64 = 0.149_855_27;
const LINE_SPACING_M: f64 = 0.65;
const SHOT_SPACING_M: f64 = 0.6;
const HALF_SWATH_DEG: f64 = 30.0;
const NEAR_SHOTS: u32 = 25;

/// Cause of an echo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TargetClass {
    /// Ground.
    Ground,
    /// Leaves and branches.
    Vegetation,
    /// Roof.
    Building,
    /// Power line.
    Wire,
    /// Noise, or the echo of an emission whose record is lost.
    FalseAlarm,
}

/// Specification of a scene.
#[derive(Clone, Copy, Debug)]
pub struct EchoSceneSpec {
    /// Display name.
    pub name: &'static str,
    /// Height of flight above mean ground, m.
    pub agl_m: f64,
    /// Standard deviation of the terrain height within the swath, m.
    pub relief_m: f64,
    /// Fraction of the area with forest.
    pub forest: f64,
    /// Fraction of the 80 m squares with a building.
    pub buildings: f64,
    /// Whether a power line crosses the scene.
    pub wires: bool,
    /// Fraction of the area with water.
    pub lakes: f64,
    /// Fraction of shots without a return.
    pub dropouts: f64,
    /// False alarms per shot.
    pub false_alarms: f64,
    /// Pause between two lines, as a fraction of a line.
    pub pause: f64,
}

/// The ten scenes.
pub const SCENES: [EchoSceneSpec; 10] = [
    spec("fields", 1500.0, 5.0, 0.2, 0.02, (false, 0.0), (0.05, 1e-3, 0.0)),
    spec("hills, forest", 1500.0, 20.0, 0.6, 0.05, (true, 0.05), (0.10, 3e-3, 0.29)),
    spec("valley", 1800.0, 60.0, 0.5, 0.05, (true, 0.15), (0.08, 2e-3, 0.0)),
    spec("dense forest", 2000.0, 100.0, 0.9, 0.0, (false, 0.0), (0.15, 5e-3, 0.29)),
    spec("city", 2200.0, 40.0, 0.25, 0.7, (true, 0.02), (0.10, 5e-3, 0.0)),
    spec("high hills", 2500.0, 150.0, 0.7, 0.02, (true, 0.03), (0.12, 3e-3, 0.29)),
    spec("alpine", 3000.0, 350.0, 0.4, 0.02, (true, 0.02), (0.10, 2e-3, 0.0)),
    spec("alpine forest", 3000.0, 250.0, 0.9, 0.0, (false, 0.0), (0.20, 5e-3, 0.29)),
    spec("lakes", 2700.0, 10.0, 0.3, 0.03, (true, 0.5), (0.20, 1e-2, 0.0)),
    spec("gorge", 1600.0, 200.0, 0.8, 0.02, (true, 0.05), (0.15, 1e-2, 0.29)),
];

const fn spec(
    name: &'static str,
    agl_m: f64,
    relief_m: f64,
    forest: f64,
    buildings: f64,
    (wires, lakes): (bool, f64),
    (dropouts, false_alarms, pause): (f64, f64, f64),
) -> EchoSceneSpec {
    EchoSceneSpec { name, agl_m, relief_m, forest, buildings, wires, lakes, dropouts, false_alarms, pause }
}

/// Geometry of a scene: the targets of each shot.
///
/// # Examples
///
/// ```
/// use wavex_simulation::mta_scenes::{EchoScene, RecordingSettings, SCENES};
///
/// let scene = EchoScene::new(SCENES[0], 1, 2, 0.1);
/// let lines = scene.record(&RecordingSettings {
///     pulse_rate_hz: 400e3,
///     modulation_ns: 17.0,
///     blind_ns: 15.0,
///     lost_records: 0.0,
/// });
/// assert_eq!(lines.len(), 2);
/// assert!(lines.iter().all(|line| !line.echoes.is_empty()));
/// ```
pub struct EchoScene {
    /// Specification.
    pub spec: EchoSceneSpec,
    /// Seed of the random numbers.
    pub seed: u64,
    sweeps: Vec<LineTargets>,
    /// Angle of each shot from nadir, rad, positive to the right.
    pub angles_rad: Vec<f64>,
    cosines: Vec<f32>,
}

/// Parameters of a recording.
#[derive(Clone, Copy, Debug)]
pub struct RecordingSettings {
    /// Pulse repetition rate, Hz.
    pub pulse_rate_hz: f64,
    /// Largest deviation of a pulse interval from its mean, ns.
    ///
    /// Each pulse is displaced uniformly by up to half of it.
    pub modulation_ns: f64,
    /// Echoes this close to an emission are lost, ns.
    pub blind_ns: f64,
    /// Fraction of emissions whose record is lost, with its echoes.
    pub lost_records: f64,
}

/// Recorded echo.
#[derive(Clone, Copy, Debug)]
pub struct RecordedEcho {
    /// Emission whose record contains the echo.
    pub emission: u32,
    /// Time after that emission, ns.
    pub time_ns: f64,
    /// Line and emission that caused the echo.
    pub cause: (u32, u32),
    /// Kind of target.
    pub class: TargetClass,
    /// Whether the echo is within 25 shots of a zone change.
    pub near: bool,
}

/// Recorded line.
pub struct RecordedLine {
    /// Emission times, ps.
    pub clocks_ps: Vec<i64>,
    /// Cosine of the angle between beam and vertical, by emission.
    pub cosines: Vec<f32>,
    /// Range to the ground, by emission, m.
    pub ground_m: Vec<f32>,
    /// Echoes, by time.
    pub echoes: Vec<RecordedEcho>,
}

impl EchoScene {
    /// Creates the scene of a specification, with `lines` lines and `part` of the swath width.
    pub fn new(spec: EchoSceneSpec, seed: u64, lines: u32, part: f64) -> EchoScene {
        let half_m = spec.agl_m * HALF_SWATH_DEG.to_radians().tan();
        let shots = (2.0 * half_m / SHOT_SPACING_M * part) as u32;
        let angle = |shot: u32| {
            let place = (f64::from(shot) + 0.5) / f64::from(shots) - 0.5;
            (2.0 * place * HALF_SWATH_DEG * part).to_radians()
        };
        let world = EchoLandscape::new(spec, seed, half_m * 1.6);
        let sweeps = (0..lines).map(|line| world.sweep(line, shots, &angle)).collect();
        let angles_rad: Vec<f64> = (0..shots).map(angle).collect();
        let cosines = angles_rad.iter().map(|angle| angle.cos() as f32).collect();
        EchoScene { spec, seed, sweeps, angles_rad, cosines }
    }

    /// Returns the range predicted by a terrain model with smooth errors of up to `error_m`.
    pub fn prior_m(&self, line: usize, shot: usize, ground_m: f32, error_m: f64) -> f32 {
        let (x, y) = (shot as f64 * SHOT_SPACING_M, line as f64 * LINE_SPACING_M);
        ground_m + ((2.0 * noise(self.seed ^ 77, x, y, 300.0) - 1.0) * error_m) as f32
    }

    /// Simulates a recording of the scene.
    pub fn record(&self, how: &RecordingSettings) -> Vec<RecordedLine> {
        let interval_ps = 1e12 / how.pulse_rate_hz;
        let shots = self.cosines.len();
        let line_ps = interval_ps * shots as f64 * (1.0 + self.spec.pause);
        let mut random = HashedRandom([self.seed, 11, 0, 0]);
        // A pause is not a multiple of the interval; without a pause, pulses continue evenly.
        let clock = |line: usize, shot: usize, random: &mut HashedRandom| {
            let even = line as f64 * line_ps + shot as f64 * interval_ps;
            (even + (random.uniform() - 0.5) * how.modulation_ns * 1e3).round() as i64 + 1_000_000_000
        };
        let clocks: Vec<Vec<i64>> = (0..self.sweeps.len())
            .map(|line| (0..shots).map(|shot| clock(line, shot, &mut random)).collect())
            .collect();
        let mut lines: Vec<RecordedLine> = clocks
            .iter()
            .zip(&self.sweeps)
            .map(|(clocks_ps, sweep)| RecordedLine {
                clocks_ps: clocks_ps.clone(),
                cosines: self.cosines.clone(),
                ground_m: sweep.ground_m.clone(),
                echoes: Vec::new(),
            })
            .collect();
        self.receive(how, &clocks, &mut lines, &mut random);
        lines.iter_mut().for_each(mark_transitions);
        if how.lost_records > 0.0 {
            lose_records(&mut lines, how.lost_records, &mut random);
        }
        lines
    }

    fn receive(
        &self,
        how: &RecordingSettings,
        clocks: &[Vec<i64>],
        lines: &mut [RecordedLine],
        random: &mut HashedRandom,
    ) {
        let interval_ns = 1e9 / how.pulse_rate_hz;
        let all: Vec<(i64, u32, u32)> = (0u32..)
            .zip(clocks)
            .flat_map(|(line, clocks)| (0u32..).zip(clocks).map(move |(shot, &clock)| (clock, line, shot)))
            .collect();
        let mut echoes: Vec<(f64, (u32, u32), TargetClass)> = Vec::new();
        for (line, sweep) in (0u32..).zip(&self.sweeps) {
            let emitted = &clocks[line as usize];
            for target in &sweep.targets {
                let flight_ns = f64::from(target.range_m) / METRES_PER_NS + 0.1 * random.normal();
                let time_ps = emitted[target.shot as usize] as f64 + flight_ns * 1e3;
                echoes.push((time_ps, (line, target.shot), target.class));
            }
            for (shot, &clock) in (0u32..).zip(emitted) {
                if random.uniform() < self.spec.false_alarms {
                    let time_ps = clock as f64 + random.uniform() * interval_ns * 1e3;
                    echoes.push((time_ps, (line, shot), TargetClass::FalseAlarm));
                }
            }
        }
        echoes.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut next = 0;
        for (time_ps, cause, class) in echoes {
            while next < all.len() && all[next].0 as f64 <= time_ps {
                next += 1;
            }
            let Some(&(clock, line, shot)) = next.checked_sub(1).and_then(|last| all.get(last)) else {
                continue;
            };
            let time_ns = (time_ps - clock as f64) * 1e-3;
            let until_ns = all.get(next).map_or(f64::INFINITY, |next| (next.0 as f64 - time_ps) * 1e-3);
            if time_ns > how.blind_ns && until_ns > how.blind_ns {
                let echo = RecordedEcho { emission: shot, time_ns, cause, class, near: false };
                lines[line as usize].echoes.push(echo);
            }
        }
    }
}

/// Marks the echoes near a zone change.
fn mark_transitions(line: &mut RecordedLine) {
    let zone = |echo: &RecordedEcho| i64::from(echo.emission) - i64::from(echo.cause.1);
    let real: Vec<&RecordedEcho> =
        line.echoes.iter().filter(|echo| echo.class != TargetClass::FalseAlarm).collect();
    let mut near = vec![false; line.clocks_ps.len()];
    for pair in real.windows(2).filter(|pair| zone(pair[0]) != zone(pair[1])) {
        let from = pair[0].emission.saturating_sub(NEAR_SHOTS) as usize;
        let to = ((pair[1].emission + NEAR_SHOTS) as usize).min(near.len() - 1);
        near[from..=to].fill(true);
    }
    line.echoes.iter_mut().for_each(|echo| echo.near = near[echo.emission as usize]);
}

/// Removes random records with their echoes.
///
/// Echoes with a removed cause become false alarms.
fn lose_records(lines: &mut [RecordedLine], part: f64, random: &mut HashedRandom) {
    let kept: Vec<Vec<bool>> =
        lines.iter().map(|line| line.clocks_ps.iter().map(|_| random.uniform() >= part).collect()).collect();
    let place = |(line, shot): (u32, u32)| {
        kept[line as usize][..shot as usize].iter().filter(|&&kept| kept).count() as u32
    };
    for (line, kept_here) in lines.iter_mut().zip(&kept) {
        line.echoes.retain(|echo| kept_here[echo.emission as usize]);
        let line_number = line.echoes.iter().map(|echo| echo.cause.0).max().unwrap_or(0);
        for echo in &mut line.echoes {
            echo.emission = kept_here[..echo.emission as usize].iter().filter(|&&kept| kept).count() as u32;
            if kept[echo.cause.0 as usize][echo.cause.1 as usize] {
                echo.cause = (echo.cause.0, place(echo.cause));
            } else {
                (echo.class, echo.cause) = (TargetClass::FalseAlarm, (line_number, 0));
            }
        }
        let mut flags = kept_here.iter();
        line.clocks_ps.retain(|_| flags.next() == Some(&true));
        let mut flags = kept_here.iter();
        line.cosines.retain(|_| flags.next() == Some(&true));
        let mut flags = kept_here.iter();
        line.ground_m.retain(|_| flags.next() == Some(&true));
    }
}
