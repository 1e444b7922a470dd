//! Simulated echo times with several pulses in the air, for the MTA resolver.
//!
//! Times of emissions and echoes, and the cause of each echo. There are no waveforms: an echo is a
//! time. The geometry of a scene is computed once; recording it with a pulse rate modulation adds
//! the times. Random numbers are hashes of their location, so every run and every part of a scene
//! has the same terrain.

/// Half the speed of light in air.
///
/// Metres of range per nanosecond of two-way travel time.
pub const METRES_PER_NS: f64 = 0.149_855_27;
const LINE_SPACING_M: f64 = 0.65;
const SHOT_SPACING_M: f64 = 0.6;
const HALF_SWATH_DEG: f64 = 30.0;
/// Spacing of a line's terrain profile, m.
const PROFILE_M: f64 = 1.0;
/// Step along a beam, m.
const STEP_M: f64 = 3.0;
const NEAR_SHOTS: u32 = 25;

/// Cause of an echo.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
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
pub struct Spec {
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
pub const SCENES: [Spec; 10] = [
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
) -> Spec {
    Spec { name, agl_m, relief_m, forest, buildings, wires, lakes, dropouts, false_alarms, pause }
}

/// Hashes a key to 64 bits that depend on every bit: rounds of SplitMix64.
pub fn hash(key: [u64; 4]) -> u64 {
    key.into_iter().fold(0, |hash, word| {
        let z = (hash ^ word).wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}

fn unit(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1u64 << 53) as f64
}

/// Random number generator.
struct Random([u64; 4]);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0[3] += 1;
        unit(hash(self.0))
    }

    fn exponential(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.uniform()).ln()
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Returns smooth noise in [0, 1] of the given wavelength.
fn noise(seed: u64, x: f64, y: f64, wavelength: f64) -> f64 {
    let (u, v) = (x / wavelength + 1000.0, y / wavelength + 1000.0);
    let (i, j) = (u.floor(), v.floor());
    let smooth = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
    let (p, q) = (smooth(u - i), smooth(v - j));
    let at = |di: f64, dj: f64| unit(hash([seed, (i + di) as u64, (j + dj) as u64, 0]));
    let low = at(0.0, 0.0) * (1.0 - p) + at(1.0, 0.0) * p;
    let high = at(0.0, 1.0) * (1.0 - p) + at(1.0, 1.0) * p;
    low * (1.0 - q) + high * q
}

/// Sums octaves from `wavelength` down to 10 m.
///
/// Each has half the wavelength and 0.36 times the amplitude of the previous one, which gives
/// realistic slopes.
fn terrain(seed: u64, x: f64, y: f64, wavelength: f64) -> f64 {
    let (mut sum, mut height, mut length) = (0.0, 1.0, wavelength);
    while length > 10.0 {
        sum += height * (noise(seed.wrapping_add(length as u64), x, y, length) - 0.5);
        height *= 0.36;
        length *= 0.5;
    }
    sum
}

/// Target of a shot.
#[derive(Clone, Copy)]
struct Target {
    shot: u32,
    range_m: f32,
    class: Class,
}

/// Geometry of a scan line.
struct Sweep {
    targets: Vec<Target>,
    /// Range to the ground for each shot, m.
    ground_m: Vec<f32>,
}

/// Geometry of a scene: the targets of each shot.
pub struct Scene {
    /// Specification.
    pub spec: Spec,
    /// Seed of the random numbers.
    pub seed: u64,
    sweeps: Vec<Sweep>,
    /// Angle of each shot from nadir, rad, positive to the right.
    pub angles_rad: Vec<f64>,
    cosines: Vec<f32>,
}

/// Parameters of a recording.
#[derive(Clone, Copy, Debug)]
pub struct Recording {
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
    pub class: Class,
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

impl Scene {
    /// Creates the scene of a specification, with `lines` lines and `part` of the swath width.
    pub fn new(spec: Spec, seed: u64, lines: u32, part: f64) -> Scene {
        let half_m = spec.agl_m * HALF_SWATH_DEG.to_radians().tan();
        let shots = (2.0 * half_m / SHOT_SPACING_M * part) as u32;
        let angle = |shot: u32| {
            let place = (f64::from(shot) + 0.5) / f64::from(shots) - 0.5;
            (2.0 * place * HALF_SWATH_DEG * part).to_radians()
        };
        let world = World::new(spec, seed, half_m * 1.6);
        let sweeps = (0..lines).map(|line| world.sweep(line, shots, &angle)).collect();
        let angles_rad: Vec<f64> = (0..shots).map(angle).collect();
        let cosines = angles_rad.iter().map(|angle| angle.cos() as f32).collect();
        Scene { spec, seed, sweeps, angles_rad, cosines }
    }

    /// Returns the range predicted by a terrain model with smooth errors of up to `error_m`.
    pub fn prior_m(&self, line: usize, shot: usize, ground_m: f32, error_m: f64) -> f32 {
        let (x, y) = (shot as f64 * SHOT_SPACING_M, line as f64 * LINE_SPACING_M);
        ground_m + ((2.0 * noise(self.seed ^ 77, x, y, 300.0) - 1.0) * error_m) as f32
    }

    /// Simulates a recording of the scene.
    pub fn record(&self, how: &Recording) -> Vec<RecordedLine> {
        let interval_ps = 1e12 / how.pulse_rate_hz;
        let shots = self.cosines.len();
        let line_ps = interval_ps * shots as f64 * (1.0 + self.spec.pause);
        let mut random = Random([self.seed, 11, 0, 0]);
        // A pause is not a multiple of the interval; without a pause, pulses continue evenly.
        let clock = |line: usize, shot: usize, random: &mut Random| {
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

    fn receive(&self, how: &Recording, clocks: &[Vec<i64>], lines: &mut [RecordedLine], random: &mut Random) {
        let interval_ns = 1e9 / how.pulse_rate_hz;
        let all: Vec<(i64, u32, u32)> = (0u32..)
            .zip(clocks)
            .flat_map(|(line, clocks)| (0u32..).zip(clocks).map(move |(shot, &clock)| (clock, line, shot)))
            .collect();
        let mut echoes: Vec<(f64, (u32, u32), Class)> = Vec::new();
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
                    echoes.push((time_ps, (line, shot), Class::FalseAlarm));
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
        line.echoes.iter().filter(|echo| echo.class != Class::FalseAlarm).collect();
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
fn lose_records(lines: &mut [RecordedLine], part: f64, random: &mut Random) {
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
                (echo.class, echo.cause) = (Class::FalseAlarm, (line_number, 0));
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

/// Terrain and objects on it.
struct World {
    spec: Spec,
    seed: u64,
    half_m: f64,
    wavelength_m: f64,
    scale: f64,
    offset: f64,
    forest_limit: f64,
    lake_limit: f64,
}

impl World {
    fn new(spec: Spec, seed: u64, half_m: f64) -> World {
        let wavelength_m = 1.5 * half_m;
        let mut world = World {
            spec,
            seed,
            half_m,
            wavelength_m,
            scale: 1.0,
            offset: 0.0,
            forest_limit: 0.0,
            lake_limit: 0.0,
        };
        let swath = half_m / 1.6;
        let places: Vec<(f64, f64)> =
            (0..4000).map(|i| ((f64::from(i) / 2000.0 - 1.0) * swath, f64::from(i % 8) * 10.0)).collect();
        let heights: Vec<f64> = places.iter().map(|&(x, y)| terrain(seed, x, y, wavelength_m)).collect();
        let mean = heights.iter().sum::<f64>() / heights.len() as f64;
        let sd = (heights.iter().map(|h| (h - mean).powi(2)).sum::<f64>() / heights.len() as f64).sqrt();
        world.scale = spec.relief_m / sd;
        world.offset = mean;
        let limit = |part: f64, value: &dyn Fn(f64, f64) -> f64| {
            let mut values: Vec<f64> = places.iter().map(|&(x, y)| value(x, y)).collect();
            values.sort_by(f64::total_cmp);
            values.get(((1.0 - part) * values.len() as f64) as usize).copied().unwrap_or(f64::INFINITY)
        };
        world.forest_limit = limit(spec.forest, &|x, y| noise(seed ^ 1, x, y, 120.0));
        world.lake_limit = limit(spec.lakes, &|x, y| noise(seed ^ 2, x, y, 250.0));
        world
    }

    fn ground(&self, x: f64, y: f64) -> f64 {
        (terrain(self.seed, x, y, self.wavelength_m) - self.offset) * self.scale
    }

    /// Returns the height of a roof above ground, m.
    fn roof(&self, x: f64, y: f64) -> f64 {
        let (i, j) = ((x / 80.0).floor(), (y / 80.0).floor());
        let key = |n| unit(hash([self.seed ^ 3, i as i64 as u64, j as i64 as u64, n]));
        let (half_x, half_y) = (8.0 + 20.0 * key(1), 8.0 + 20.0 * key(2));
        let (dx, dy) = (x - (i + 0.5) * 80.0, y - (j + 0.5) * 80.0);
        let inside = dx.abs() < half_x && dy.abs() < half_y && key(0) < self.spec.buildings;
        if inside { 6.0 + 54.0 * key(3).powi(2) } else { 0.0 }
    }

    /// Returns the height of the crown of the nearest tree, m.
    fn crown(&self, x: f64, y: f64) -> f64 {
        if noise(self.seed ^ 1, x, y, 120.0) < self.forest_limit {
            return 0.0;
        }
        let (i, j) = ((x / 6.0).floor(), (y / 6.0).floor());
        let key = |n| unit(hash([self.seed ^ 4, i as i64 as u64, j as i64 as u64, n]));
        let (dx, dy) = (x - (i + 0.3 + 0.4 * key(1)) * 6.0, y - (j + 0.3 + 0.4 * key(2)) * 6.0);
        let squared = (dx * dx + dy * dy) / (2.2 + 2.0 * key(3)).powi(2);
        if squared < 1.0 { (10.0 + 22.0 * key(0)) * (0.5 + 0.5 * (1.0 - squared).sqrt()) } else { 0.0 }
    }

    /// Returns the height of a wire hit by the beam, m.
    ///
    /// Above ground; spans between masts every 250 m.
    fn wire(&self, x: f64, y: f64) -> f64 {
        let hit = (0..3).any(|n| {
            let across = x + 0.4 * y + f64::from(n) * 6.0 - 0.3 * self.half_m;
            let along = y - 0.02 * x - 20.0 - f64::from(n) * 5.0;
            across.abs() < 0.2 || along.abs() < 0.2
        });
        let place = (x / 250.0).rem_euclid(1.0) - 0.5;
        if hit { 25.0 + 60.0 * place * place } else { 0.0 }
    }

    fn sweep(&self, line: u32, shots: u32, angle: &dyn Fn(u32) -> f64) -> Sweep {
        let y = f64::from(line) * LINE_SPACING_M;
        let cells = (2.0 * self.half_m / PROFILE_M) as usize + 2;
        let profile: Vec<f64> =
            (0..cells).map(|i| self.ground(i as f64 * PROFILE_M - self.half_m, y)).collect();
        let height = |x: f64| {
            let place = ((x + self.half_m) / PROFILE_M).clamp(0.0, (cells - 2) as f64);
            let i = place as usize;
            profile[i] + (profile[i + 1] - profile[i]) * (place - i as f64)
        };
        let top_m = profile.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mut sweep = Sweep { targets: Vec::new(), ground_m: Vec::new() };
        for shot in 0..shots {
            let (sin, cos) = angle(shot).sin_cos();
            let is_above = |range_m: f64| self.spec.agl_m - range_m * cos > height(range_m * sin);
            let (mut low, most) = ((self.spec.agl_m - top_m) / cos - 1.0, 1.6 * self.spec.agl_m);
            // The first crossing: terrain beyond a ridge is in its shadow.
            while low < most && is_above(low + STEP_M) {
                low += STEP_M;
            }
            let mut high = low + STEP_M;
            while high - low > 0.01 {
                let middle = 0.5 * (low + high);
                if is_above(middle) { low = middle } else { high = middle }
            }
            sweep.ground_m.push(low as f32);
            let mut random = Random([self.seed ^ 5, u64::from(line), u64::from(shot), 0]);
            if low < most && random.uniform() >= self.spec.dropouts {
                self.meet(low, low * sin, y, shot, &mut random, &mut sweep.targets);
            }
        }
        sweep
    }

    /// Adds the targets of a shot whose ground is at `range_m`, in order of range.
    fn meet(&self, range_m: f64, x: f64, y: f64, shot: u32, random: &mut Random, into: &mut Vec<Target>) {
        let mut add = |above_m: f64, class| {
            into.push(Target { shot, range_m: (range_m - above_m) as f32, class });
        };
        if noise(self.seed ^ 2, x, y, 250.0) >= self.lake_limit {
            if random.uniform() < 0.04 {
                add(0.03 * random.normal(), Class::Ground);
            }
            return;
        }
        if self.spec.wires {
            let wire = self.wire(x, y);
            if wire > 0.0 && random.uniform() < 0.7 {
                add(wire, Class::Wire);
            }
        }
        let roof = self.roof(x, y);
        if roof > 0.0 {
            add(roof + 0.03 * random.normal(), Class::Building);
            return;
        }
        let mut above = self.crown(x, y) - random.exponential(1.5);
        let mut power = 1.0;
        while above > 1.5 && power > 0.15 {
            add(above, Class::Vegetation);
            power *= 0.25 + 0.6 * random.uniform();
            above -= 1.0 + random.exponential(5.0);
        }
        if power > 0.4 || random.uniform() < power {
            add(0.05 * random.normal(), Class::Ground);
        }
    }
}
