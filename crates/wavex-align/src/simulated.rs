//! Simulated patches for tests. `tests/python/make_alignment.py` is the independent generator.

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::frames::{Attitude, LocalFrame, rotation_of_angles};
use wavex_geodesy::trajectory::{Sample, Trajectory};

use crate::parameters::{Global, GlobalPriors};
use crate::patch::{Horizon, Patch};
use crate::scanner::{BeamSource, Scanner, ScannerBeam};
use crate::survey::{Installation, Strip, Survey};

pub(crate) const PLACE: Geodetic = Geodetic { latitude_rad: 0.83, longitude_rad: 0.2, height_m: 300.0 };
const HEIGHT_M: f64 = 400.0;
const SPEED_MPS: f64 = 50.0;
/// Distance of the patches.
const SPACING_M: f64 = 5.0;

/// Numbers with the distribution of errors.
pub(crate) struct Normal(Xoshiro256PlusPlus);

impl Normal {
    pub(crate) fn new(seed: u64) -> Normal {
        Normal(Xoshiro256PlusPlus::seed_from_u64(seed))
    }

    /// Sum of twelve uniform numbers: variance 1.
    pub(crate) fn draw(&mut self) -> f64 {
        (0..12).map(|_| self.0.next_u64() as f64 / u64::MAX as f64).sum::<f64>() - 6.0
    }
}

fn start_s(strip: usize) -> f64 {
    1000.0 * (strip + 1) as f64
}

/// A simulated flight.
pub(crate) struct Flight {
    pub(crate) trajectories: Vec<Trajectory>,
    pub(crate) installations: Vec<Installation>,
    pub(crate) strips: Vec<Strip>,
    pub(crate) patches: Vec<Patch>,
    pub(crate) horizon: Horizon,
}

/// What is flown, and with which errors.
pub(crate) struct Plan {
    /// Offset to the right, m, and course, rad, of each strip.
    pub(crate) lines: Vec<(f64, f64)>,
    pub(crate) length_m: f64,
    /// Height of the terrain over east and north.
    pub(crate) terrain: fn(f64, f64) -> f64,
    pub(crate) truth: Scanner,
    pub(crate) start: Scanner,
    /// SD of the range of a patch, m.
    pub(crate) noise_m: f64,
    /// Error of a patch by place, m.
    pub(crate) bias_m: fn(f64, f64) -> f64,
    /// Error of the recorded height of each strip, m.
    pub(crate) heights_m: Vec<f64>,
    pub(crate) seed: u64,
    /// Amplitude of an error of the recorded height with a period of 8 s, m.
    pub(crate) bump_m: f64,
    /// Scanners of further installations, true and at the start, with the first strip of each.
    pub(crate) others: Vec<(usize, Scanner, Scanner)>,
}

pub(crate) fn hills(x: f64, y: f64) -> f64 {
    12.0 * (x / 55.0).sin() + 9.0 * (y / 41.0 + 1.0).sin() + 6.0 * ((x + y) / 31.0).cos()
}

pub(crate) fn flat(_: f64, _: f64) -> f64 {
    0.0
}

pub(crate) fn scanner() -> Scanner {
    Scanner { body_from_mount: rotation_of_angles([0.02, -0.01, 0.03]), calibration: Default::default() }
}

/// Three parallel lines in both directions.
pub(crate) fn parallel() -> Vec<(f64, f64)> {
    let half_turn = core::f64::consts::PI;
    vec![(-120.0, 0.3), (0.0, 0.3 + half_turn), (120.0, 0.3)]
}

impl Plan {
    pub(crate) fn new(lines: Vec<(f64, f64)>, terrain: fn(f64, f64) -> f64) -> Plan {
        Plan {
            heights_m: vec![0.0; lines.len()],
            lines,
            length_m: 320.0,
            terrain,
            truth: scanner(),
            start: scanner(),
            noise_m: 0.003,
            bias_m: flat,
            seed: 1,
            bump_m: 0.0,
            others: Vec::new(),
        }
    }

    /// Parallel strips and a cross strip over hills.
    pub(crate) fn cross() -> Plan {
        let mut lines = parallel();
        lines.push((0.0, 0.3 + core::f64::consts::FRAC_PI_2));
        Plan::new(lines, hills)
    }

    /// Trajectory of a strip along a line, with an error of its height.
    pub(crate) fn trajectory(&self, strip: usize, line: (f64, f64), error_m: f64) -> Trajectory {
        self.recorded(strip, line, error_m, 0.0)
    }

    fn recorded(&self, strip: usize, (right_m, course): (f64, f64), error_m: f64, bump_m: f64) -> Trajectory {
        let frame = LocalFrame::at(WGS84, PLACE);
        let phase = strip as f64;
        let sample = |k: u32| {
            let t = f64::from(k) * 0.02 - 0.5;
            let along = t * SPEED_MPS - 0.5 * self.length_m;
            let (sine, cosine) = course.sin_cos();
            let (x, y) = (right_m * cosine + along * sine, -right_m * sine + along * cosine);
            let sway = |amplitude: f64, rate: f64| amplitude * (rate * t + phase).sin();
            Sample {
                time_s: start_s(strip) + t,
                place: frame.geodetic_of([x, y, HEIGHT_M + error_m + bump_m * (0.8 * t + phase).sin()]),
                attitude: Attitude {
                    roll_rad: sway(0.02, 1.1),
                    pitch_rad: 0.02 + sway(0.012, 0.9),
                    heading_rad: course + sway(0.015, 0.7),
                },
            }
        };
        let count = ((self.length_m / SPEED_MPS + 1.0) / 0.02) as u32;
        Trajectory::new((0..count).map(sample).collect()).unwrap()
    }

    pub(crate) fn fly(&self) -> Flight {
        let mut normal = Normal::new(self.seed);
        let horizon = Horizon::at(PLACE);
        let mut flight = Flight {
            trajectories: Vec::new(),
            installations: [self.start]
                .into_iter()
                .chain(self.others.iter().map(|(_, _, start)| *start))
                .map(|scanner| Installation { scanner, priors: GlobalPriors::default() })
                .collect(),
            strips: Vec::new(),
            patches: Vec::new(),
            horizon,
        };
        for (strip, &(right_m, course)) in self.lines.iter().enumerate() {
            let installation = self.others.iter().filter(|(first, ..)| *first <= strip).count();
            let of_strip = installation.checked_sub(1).map_or(self.truth, |other| self.others[other].1);
            let start_s = start_s(strip);
            let duration_s = self.length_m / SPEED_MPS;
            let truth = self.trajectory(strip, (right_m, course), 0.0);
            let recorded = self.recorded(strip, (right_m, course), self.heights_m[strip], self.bump_m);
            let mut poses = truth.poses();
            for line in 0..(duration_s * SPEED_MPS / SPACING_M) as u32 {
                for column in -44..=44 {
                    let source = BeamSource::default();
                    let noise_m = self.noise_m * normal.draw();
                    let mut beams = [ScannerBeam::default(); 3];
                    for (beam, (ahead, right)) in
                        beams.iter_mut().zip([(0.5, -0.5), (-0.5, -0.5), (0.0, 0.6)])
                    {
                        let angle = (f64::from(column) + right * 0.5) * SPACING_M / HEIGHT_M;
                        beam.time_s = start_s + (f64::from(line) + ahead * 0.5) * SPACING_M / SPEED_MPS;
                        beam.direction = [0.0, angle.sin(), angle.cos()];
                        beam.range_m = HEIGHT_M;
                        let mut at = |beam: &ScannerBeam| {
                            horizon.local_m(of_strip.locate(&source, beam, &mut poses, None).unwrap())
                        };
                        for _ in 0..6 {
                            let [x, y, z] = at(beam);
                            beam.range_m += (z - (self.terrain)(x, y)) / angle.cos();
                        }
                        let [x, y, _] = at(beam);
                        beam.range_m += noise_m + (self.bias_m)(x, y) * if strip == 0 { 1.0 } else { 0.0 };
                    }
                    // Anticlockwise as seen from above: the right of a scanner mounted backwards is on the left.
                    if of_strip.body_from_mount[1][1] < 0.0 {
                        beams.swap(0, 1);
                    }
                    flight.patches.push(Patch {
                        strip: strip as u32,
                        n_returns: 20,
                        source,
                        beams,
                        sd_m: self.noise_m as f32,
                        slope_sd: 1e-4,
                        roughness_m: 0.0,
                    });
                }
            }
            flight.trajectories.push(recorded);
            flight.strips.push(Strip { trajectory: strip, installation });
        }
        flight
    }
}

impl Flight {
    pub(crate) fn survey(&self) -> Survey<'_> {
        Survey {
            trajectories: &self.trajectories,
            installations: &self.installations,
            strips: &self.strips,
            patches: &self.patches,
            horizon: self.horizon,
        }
    }

    pub(crate) fn prior(&mut self, global: Global, sd: f64) {
        self.installations[0].priors.0[global as usize] = sd;
    }
}
