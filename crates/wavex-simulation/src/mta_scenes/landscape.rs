//! Terrain, vegetation, buildings and wires as functions of position.

use super::super::random::{GOLDEN, mix, unit};
use super::{EchoSceneSpec, LINE_SPACING_M, TargetClass};

/// Spacing of a line's terrain profile, m.
const PROFILE_M: f64 = 1.0;
/// Step along a beam, m.
const STEP_M: f64 = 3.0;

/// Hashes a key to 64 bits that depend on every bit: rounds of SplitMix64.
pub fn hash(key: [u64; 4]) -> u64 {
    key.into_iter().fold(0, |hash, word| mix((hash ^ word).wrapping_add(GOLDEN)))
}

/// Random numbers by hashing a key and a counter.
pub(super) struct HashedRandom(pub(super) [u64; 4]);

impl HashedRandom {
    pub(super) fn uniform(&mut self) -> f64 {
        self.0[3] += 1;
        unit(hash(self.0))
    }

    fn exponential(&mut self, mean: f64) -> f64 {
        -mean * (1.0 - self.uniform()).ln()
    }

    pub(super) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// Returns smooth noise in [0, 1] of the given wavelength.
pub(super) fn noise(seed: u64, x: f64, y: f64, wavelength: f64) -> f64 {
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
pub(super) struct ShotTarget {
    pub(super) shot: u32,
    pub(super) range_m: f32,
    pub(super) class: TargetClass,
}

/// Geometry of a scan line.
pub(super) struct LineTargets {
    pub(super) targets: Vec<ShotTarget>,
    /// Range to the ground for each shot, m.
    pub(super) ground_m: Vec<f32>,
}

/// Terrain and objects on it.
pub(super) struct EchoLandscape {
    spec: EchoSceneSpec,
    seed: u64,
    half_m: f64,
    wavelength_m: f64,
    scale: f64,
    offset: f64,
    forest_limit: f64,
    lake_limit: f64,
}

impl EchoLandscape {
    pub(super) fn new(spec: EchoSceneSpec, seed: u64, half_m: f64) -> EchoLandscape {
        let wavelength_m = 1.5 * half_m;
        let mut world = EchoLandscape {
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

    pub(super) fn sweep(&self, line: u32, shots: u32, angle: &dyn Fn(u32) -> f64) -> LineTargets {
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
        let mut sweep = LineTargets { targets: Vec::new(), ground_m: Vec::new() };
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
            let mut random = HashedRandom([self.seed ^ 5, u64::from(line), u64::from(shot), 0]);
            if low < most && random.uniform() >= self.spec.dropouts {
                self.add_targets(low, low * sin, y, shot, &mut random, &mut sweep.targets);
            }
        }
        sweep
    }

    /// Adds the targets of a shot whose ground is at `range_m`, in order of range.
    fn add_targets(
        &self,
        range_m: f64,
        x: f64,
        y: f64,
        shot: u32,
        random: &mut HashedRandom,
        into: &mut Vec<ShotTarget>,
    ) {
        let mut add = |above_m: f64, class| {
            into.push(ShotTarget { shot, range_m: (range_m - above_m) as f32, class });
        };
        if noise(self.seed ^ 2, x, y, 250.0) >= self.lake_limit {
            if random.uniform() < 0.04 {
                add(0.03 * random.normal(), TargetClass::Ground);
            }
            return;
        }
        if self.spec.wires {
            let wire = self.wire(x, y);
            if wire > 0.0 && random.uniform() < 0.7 {
                add(wire, TargetClass::Wire);
            }
        }
        let roof = self.roof(x, y);
        if roof > 0.0 {
            add(roof + 0.03 * random.normal(), TargetClass::Building);
            return;
        }
        let mut above = self.crown(x, y) - random.exponential(1.5);
        let mut power = 1.0;
        while above > 1.5 && power > 0.15 {
            add(above, TargetClass::Vegetation);
            power *= 0.25 + 0.6 * random.uniform();
            above -= 1.0 + random.exponential(5.0);
        }
        if power > 0.4 || random.uniform() < power {
            add(0.05 * random.normal(), TargetClass::Ground);
        }
    }
}
