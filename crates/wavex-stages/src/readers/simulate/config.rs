//! Keys of `simulate` and their conversion to parts of the simulator.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{FULL_SCALE_DN, INTERVAL_NS};
use wavex_geodesy::time::{ADJUSTMENT_S, WEEK_S, day_of_year};
use wavex_line::keys::{InvalidKey, above, at_least};
use wavex_line::scan_line::MAX_SHOTS_PER_LINE;
use wavex_line::stage::Config;
use wavex_simulation::detector::DetectorModel;
use wavex_simulation::platform::{Motion, Platform};
use wavex_simulation::pulse::PulseShape;
use wavex_simulation::receiver::{HighPower, ReceiverSettings};
use wavex_simulation::scanner::{GPS_WEEK, START_S, ScanMechanism, Scanner};
use wavex_simulation::scene::{CountrySettings, Scene};
use wavex_simulation::world::World;

/// Lowest pulse rate, Hz.
const LEAST_PULSE_RATE_HZ: f64 = 1000.0;
/// Full width at half maximum of a Gaussian response, ns.
const GAUSSIAN_FWHM_NS: f64 = 4.5;
/// Largest beam angle from nadir, degrees.
///
/// Steeper beams may never reach the ground.
const STEEPEST_DEG: f64 = 75.0;

/// Simulates the recording of an airborne scanner.
///
/// The scanner flies over synthetic terrain and records it as an airborne instrument does. The
/// truth of every return can be written as well.
///
/// **Frame.** Without a trajectory (`sbet`, `pof`), recording and truth are in a map (UTM zone 33
/// north, metres), in which beams are straight. With one, beams are in the frame of the scanner (x
/// forward, y right, z down; parallel to the aircraft's except for `boresight_deg`). The truth is
/// then in UTM in the zone of the start, with ellipsoidal heights on WGS 84, computed by closed
/// formulas from the same scene placed on the earth. Trajectory, lever arm, boresight and ranges
/// reproduce it within rounding.
///
/// **As recorded.** With `as_recorded`, blocks are stored with the last shot emitted before their
/// reception, and `mta_zone` is not set. The laser of a rotating polygon pauses between lines;
/// echoes received during a pause are stored with the last shot of the line. Otherwise blocks are
/// stored with the shot that caused them, with known zones.
///
/// **Receivers.** The low-power receiver always records. `high_power` adds the high-power receiver,
/// whose blocks begin 1.43 ns later. The recording contains the amplitude tables of both.
///
/// The same keys give the same bytes on every machine, and scan lines are independent of each
/// other.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Simulate {
    /// Base name of the outputs.
    pub stem: String,
    /// Seed of the random numbers, which determine noise and details of the scene.
    #[schemars(range(max = i64::MAX))]
    pub seed: u64,
    /// Seed of the scene, by default `seed`. Flights of a survey have the same `scene_seed` and
    /// `country`, and each its own `seed`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(max = i64::MAX))]
    pub scene_seed: Option<u64>,
    /// Number of scan lines.
    #[schemars(range(min = 1, max = u32::MAX))]
    pub lines: u32,
    /// Number of shots per scan line.
    #[schemars(range(min = 1, max = MAX_SHOTS_PER_LINE))]
    pub shots_per_line: u32,
    /// Scan mechanism: a rotating polygon of four facets with a pause of half a line between lines;
    /// an oscillating mirror; parallel lines with spots evenly spaced on level ground; or a beam on
    /// a cone around nadir (`circular`), whose lines are groups of consecutive shots.
    pub scanner: ScannerKind,
    /// Pulse rate. Echoes received after the next pulse are assigned to the pulse that caused them,
    /// unless `as_recorded`.
    #[schemars(range(min = LEAST_PULSE_RATE_HZ, max = 2000000.0))]
    pub pulse_rate_hz: f64,
    /// Modulation: largest deviation of the interval between two pulses from its mean. Each pulse
    /// is emitted up to half of this early or late, independently of the others; 0: constant rate.
    /// Below half the interval.
    #[schemars(transform = at_least(0.0).below(0.5e9 / LEAST_PULSE_RATE_HZ))]
    pub modulation_ns: f64,
    /// Angles of the first and last shot from nadir, positive to the right; for a cone, its half
    /// angle to both sides.
    #[schemars(transform = at_least(-60.0).at_most(60.0))]
    pub scan_angle_deg: [f64; 2],
    /// Revolutions per second of a `circular` scanner.
    #[schemars(range(min = 1.0, max = 1000.0))]
    pub rotation_hz: f64,
    /// Height above the level ground, or above the lowest ground of the `country`.
    #[schemars(range(min = 20.0, max = 10000.0))]
    pub flying_height_m: f64,
    /// Speed over ground.
    #[schemars(range(min = 1.0, max = 1000.0))]
    pub speed_mps: f64,
    /// Flight direction, clockwise from north.
    #[schemars(range(min = -360.0, max = 360.0))]
    pub heading_deg: f64,
    /// Radius of a circular flight with level wings, positive to the right; 0: straight. At least
    /// 100 m.
    #[schemars(range(min = -1000000.0, max = 1000000.0))]
    pub turn_radius_m: f64,
    /// Start of the track in the scene relative to the start of the scene: right and along
    /// `heading_deg`. Flights with different tracks over one scene form a survey.
    #[schemars(transform = at_least(-100_000.0).at_most(100_000.0))]
    pub track_offset_m: [f64; 2],
    /// Direction of the track, clockwise from `heading_deg`; 90 crosses strips of direction 0.
    #[schemars(range(min = -360.0, max = 360.0))]
    pub track_direction_deg: f64,
    /// Error of the recorded sensor height: of the trajectory, or of the beams without one. The truth
    /// is not affected.
    #[schemars(range(min = -10.0, max = 10.0))]
    pub height_error_m: f64,
    /// Longitude and latitude of the first position. Default without a trajectory: 12.59489 and
    /// 47.82814, in UTM zone 33 north.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(transform = at_least(-180.0).at_most(180.0))]
    pub start_deg: Option<[f64; 2]>,
    /// Start of the flight, seconds of GPS week 2365 (from 4 May 2025). Times continue past the end
    /// of the week.
    #[schemars(transform = at_least(0.0).below(WEEK_S))]
    pub start_time_s: f64,
    /// Largest roll of the aircraft, which oscillates around level flight.
    #[schemars(range(min = 0.0, max = 15.0))]
    pub roll_deg: f64,
    /// Largest pitch.
    #[schemars(range(min = 0.0, max = 15.0))]
    pub pitch_deg: f64,
    /// Largest deviation of the heading from `heading_deg`.
    #[schemars(range(min = 0.0, max = 15.0))]
    pub yaw_deg: f64,
    /// Period of the slower part of the roll; pitch and yaw are slower.
    #[schemars(range(min = 1.0, max = 1000.0))]
    pub motion_period_s: f64,
    /// Lever arm from the trajectory's reference point to the scanner: forward, right, down.
    #[schemars(transform = at_least(-10.0).at_most(10.0))]
    pub lever_arm_m: [f64; 3],
    /// Boresight angles between scanner and aircraft: roll, pitch and yaw, `Rz(yaw) Ry(pitch)
    /// Rx(roll)`.
    #[schemars(transform = at_least(-10.0).at_most(10.0))]
    pub boresight_deg: [f64; 3],
    /// Terrain: `strips`, level ground with one long building and one long forest; or `country`,
    /// unlimited hills, lakes, houses, forests and power lines.
    pub landscape: Landscape,
    /// Height of the building, or of the highest houses; 0: none.
    #[schemars(range(min = 0.0, max = 200.0))]
    pub building_height_m: f64,
    /// Height of the forest, or of the highest trees; 0: none.
    #[schemars(range(min = 0.0, max = 200.0))]
    pub canopy_height_m: f64,
    /// In the `country`: height difference between the highest hill and the lowest valley; 0:
    /// level.
    #[schemars(range(min = 0.0, max = 2000.0))]
    pub relief_m: f64,
    /// In the `country`: fraction of the land covered by water, at the lowest heights. Water
    /// returns no echoes.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub water_ratio: f64,
    /// In the `country`: fraction of the land covered by forest.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub wood_ratio: f64,
    /// In the `country`: fraction of the plots of 40 m by 40 m with a house, outside forest and
    /// water.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub house_ratio: f64,
    /// In the `country`: height of the lowest wires of power lines above the ground at the pylons;
    /// 0: none.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub wire_height_m: f64,
    /// Mean echo amplitude of level ground at nadir, above the background. The full scale of the
    /// digitiser is 255.
    #[schemars(range(min = 1.0, max = 10000.0))]
    pub ground_amplitude_dn: f64,
    /// Fraction of shots without an echo.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub dropout_rate: f64,
    /// Fraction of shots with a false echo, as weak as the weakest that trigger a block.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub false_alarm_rate: f64,
    /// Echoes within this time of an emission, before or after, are not recorded.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub blind_gap_ns: f64,
    /// Response to a flat target.
    pub response: Response,
    /// Dependence of the echo amplitude on its strength: `linear`, or `riegl` as in the amplitude
    /// tables of a RIEGL LMS-Q680i (low power compresses above 68 digitiser steps, high power is
    /// nearly logarithmic).
    pub detector: DetectorKind,
    /// Background of the even and odd samples of a block.
    #[schemars(transform = at_least(0.0).at_most(100.0))]
    pub background_dn: [f64; 2],
    /// Delay of the odd samples of a block of every receiver, in samples. Files do not store it: give
    /// the same value to their reader.
    #[schemars(transform = above(-0.5).below(0.5))]
    pub odd_sample_shift: f64,
    /// Standard deviation of the recorded noise, including quantisation, at least 0.5; 0: quantisation
    /// only.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub noise_sd_dn: f64,
    /// Autocorrelation of the recorded noise at lags of 1, 2, ... samples; `[]`: none.
    #[schemars(length(max = 16), transform = above(-1.0).below(1.0))]
    pub noise_autocorrelation: Vec<f64>,
    /// Add a high-power receiver with about a tenth of the gain.
    pub high_power: bool,
    /// Smallest peak of an echo in the low-power receiver, above the background, for which the
    /// high-power block is kept.
    #[schemars(range(min = 0.0, max = 10000.0))]
    pub high_power_from_dn: f64,
    /// Standard deviation of the recorded noise of the high-power receiver, as `noise_sd_dn`.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub high_power_noise_sd_dn: f64,
    /// Delay of the high-power receiver relative to the low-power one.
    #[schemars(range(min = -10.0, max = 10.0))]
    pub high_power_delay_ns: f64,
    /// Automatic gain control: smallest and largest gain of both echo receivers, relative to the gain described by the other keys. Signal and noise scale with the gain,
    /// background and quantisation do not. Each echo block has its gain, and the truth has a column
    /// `gain`. `[1, 1]`: the gain is constant and not written.
    #[schemars(transform = at_least(1.0 / 1024.0).at_most(1024.0))]
    pub gain_range: [f64; 2],
    /// Control of the gain: `time` varies its logarithm sinusoidally with time; `echo` sets it so
    /// that the strongest echo of the previous shot of the line would have 150 digitiser steps, or
    /// to the largest gain if that shot has no echo.
    pub gain_follows: GainFollows,
    /// Period of the gain with `gain_follows = "time"`.
    #[schemars(range(min = 0.001, max = 1000.0))]
    pub gain_period_s: f64,
    /// Store blocks with the last shot emitted before their reception instead of the shot that
    /// caused them.
    pub as_recorded: bool,
    /// Trajectory file in SBET format (`*` is the stem), 200 positions and attitudes per second,
    /// from one second before the flight to one second after it; not written by default. Times are
    /// seconds of the GPS week.
    pub sbet: Option<String>,
    /// The same trajectory in RIEGL's POF format.
    pub pof: Option<String>,
    /// CSV file of the true returns (`*` is the stem); not written by default. It contains each
    /// return whose peak is in a recorded block, however weak.
    pub truth: Option<String>,
}

/// Scan mechanism.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ScannerKind {
    /// Rotating polygon of four facets, with pauses between lines.
    RotatingPolygon,
    /// Oscillating mirror.
    Oscillating,
    /// Parallel lines.
    ParallelLines,
    /// Beam on a cone.
    Circular,
}

/// Simulated terrain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Landscape {
    /// Level ground with one long building and one long forest.
    Strips,
    /// Unlimited hills, lakes, houses, forests and power lines.
    Country,
}

/// Response to a flat target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Response {
    /// Gaussian of 4.5 ns full width at half maximum, for comparisons with formulas.
    Gaussian,
    /// As measured on a RIEGL LMS-Q680i: an asymmetric peak of 4.5 ns, an after-pulse of 5 % after
    /// 10.5 ns, and a slow tail. Decomposition into Gaussians finds spurious points with it.
    Riegl,
}

/// Control of the receiver gain.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GainFollows {
    /// Sinusoidal in time.
    Time,
    /// By the strongest echo of the previous shot.
    Echo,
}

/// Dependence of the echo amplitude on its strength.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DetectorKind {
    /// Proportional.
    Linear,
    /// As in the tables of a RIEGL LMS-Q680i.
    Riegl,
}

impl Default for Simulate {
    fn default() -> Simulate {
        Simulate {
            stem: "simulated".to_owned(),
            seed: 1,
            scene_seed: None,
            lines: 200,
            shots_per_line: 1000,
            scanner: ScannerKind::RotatingPolygon,
            pulse_rate_hz: 150_000.0,
            modulation_ns: 0.0,
            scan_angle_deg: [-30.0, 30.0],
            rotation_hz: 80.0,
            flying_height_m: 600.0,
            speed_mps: 60.0,
            heading_deg: 0.0,
            turn_radius_m: 0.0,
            track_offset_m: [0.0; 2],
            track_direction_deg: 0.0,
            height_error_m: 0.0,
            start_deg: None,
            start_time_s: START_S,
            roll_deg: 0.0,
            pitch_deg: 0.0,
            yaw_deg: 0.0,
            motion_period_s: 6.0,
            lever_arm_m: [0.0; 3],
            boresight_deg: [0.0; 3],
            landscape: Landscape::Strips,
            building_height_m: 8.0,
            canopy_height_m: 18.0,
            relief_m: 40.0,
            water_ratio: 0.05,
            wood_ratio: 0.3,
            house_ratio: 0.15,
            wire_height_m: 20.0,
            ground_amplitude_dn: 110.0,
            dropout_rate: 0.002,
            false_alarm_rate: 0.0,
            blind_gap_ns: 0.0,
            response: Response::Riegl,
            detector: DetectorKind::Linear,
            background_dn: [2.18, 2.41],
            odd_sample_shift: 0.0,
            noise_sd_dn: 0.93,
            noise_autocorrelation: vec![0.63, 0.42, 0.22, 0.11],
            high_power: false,
            high_power_from_dn: 100.0,
            high_power_noise_sd_dn: 0.7,
            high_power_delay_ns: 0.52,
            gain_range: [1.0, 1.0],
            gain_follows: GainFollows::Time,
            gain_period_s: 1.0,
            as_recorded: false,
            sbet: None,
            pof: None,
            truth: None,
        }
    }
}

type Checked = Result<(), InvalidKey>;

fn unless(holds: bool, key: &'static str, problem: &str) -> Checked {
    InvalidKey::unless(holds, key, problem)
}

impl Config for Simulate {
    fn check(&self) -> Checked {
        self.check_scanner()?;
        self.check_platform()?;
        self.check_scene()?;
        self.check_receiver()
    }
}

/// Conditions on several keys, or on the shape of one.
impl Simulate {
    fn check_scanner(&self) -> Checked {
        let is_name = !self.stem.is_empty() && !self.stem.contains(['/', '\\']);
        unless(is_name, "stem", "must be a file name without folders")?;
        let modulation = self.modulation_ns < 0.5e9 / self.pulse_rate_hz;
        unless(modulation, "modulation_ns", "must be below half the interval between pulses")?;
        let [first, last] = self.scan_angle_deg;
        unless(first < last, "scan_angle_deg", "must be two ascending angles")?;
        let even = self.scanner != ScannerKind::Circular || first == -last;
        unless(even, "scan_angle_deg", "must be -a and a for a circular scanner of half angle a")
    }

    fn check_platform(&self) -> Checked {
        let turns = self.turn_radius_m == 0.0 || self.turn_radius_m.abs() >= 100.0;
        unless(turns, "turn_radius_m", "must be 0, or at least 100 to either side")?;
        if let Some([_, latitude]) = self.start_deg {
            let is_latitude = latitude.abs() <= 89.0;
            unless(is_latitude, "start_deg", "must be a longitude, and a latitude between -89 and 89")?;
            unless(self.has_trajectory(), "start_deg", "needs a trajectory: give `sbet` or `pof`")?;
        }
        let steep = self.steepest_deg() <= STEEPEST_DEG;
        unless(
            steep,
            "scan_angle_deg",
            "must leave beams within 75 degrees of straight down, whatever roll, pitch and boresight",
        )
    }

    fn check_scene(&self) -> Checked {
        let stands = self.building_height_m.max(self.canopy_height_m);
        let (lowest, problem) = match self.landscape {
            Landscape::Strips => (stands + 20.0, "must be at least 20 m above building and wood"),
            Landscape::Country => {
                let lowest = self.relief_m + stands.max(self.wire_height_m + 4.0) + 30.0;
                (lowest, "must be at least 30 m above all terrain and objects")
            }
        };
        unless(self.flying_height_m >= lowest, "flying_height_m", problem)
    }

    fn check_receiver(&self) -> Checked {
        // Below half a step, quantisation is not independent of the noise.
        let noise = |sd_dn: f64| sd_dn == 0.0 || sd_dn >= 0.5;
        let spread = "must be 0, or at least 0.5";
        unless(noise(self.noise_sd_dn), "noise_sd_dn", spread)?;
        unless(noise(self.high_power_noise_sd_dn), "high_power_noise_sd_dn", spread)?;
        let [least, greatest] = self.gain_range;
        unless(least <= greatest, "gain_range", "must be two ascending gains")?;
        let settings = self.receiver();
        unless(
            settings.noise().is_ok(),
            "noise_autocorrelation",
            "belongs to no noise that can be recorded at this noise_sd_dn",
        )?;
        unless(
            settings.high_power_noise().is_ok(),
            "noise_autocorrelation",
            "belongs to no noise that can be recorded at this high_power_noise_sd_dn",
        )
    }

    /// Largest angle between a beam and nadir, degrees.
    pub(super) fn steepest_deg(&self) -> f64 {
        let [roll, pitch, _] = self.boresight_deg;
        let scan = self.scan_angle_deg.iter().fold(0.0, |most: f64, angle| most.max(angle.abs()));
        scan + roll.abs() + pitch.abs() + self.roll_deg + self.pitch_deg
    }

    /// Whether the gain varies.
    pub(super) fn has_gain_control(&self) -> bool {
        self.gain_range != [1.0, 1.0]
    }

    /// Whether a trajectory is written; beams are then in the frame of the scanner.
    pub(super) fn has_trajectory(&self) -> bool {
        self.sbet.is_some() || self.pof.is_some()
    }

    pub(super) fn scanner(&self) -> Scanner {
        Scanner {
            mirror: match self.scanner {
                ScannerKind::RotatingPolygon => ScanMechanism::RotatingPolygon,
                ScannerKind::Oscillating => ScanMechanism::Oscillating,
                ScannerKind::ParallelLines => ScanMechanism::ParallelLines,
                ScannerKind::Circular => ScanMechanism::Circular,
            },
            shots_per_line: self.shots_per_line,
            pulse_rate_hz: self.pulse_rate_hz,
            modulation_ns: self.modulation_ns,
            seed: self.seed,
            scan_angle_rad: self.scan_angle_deg.map(f64::to_radians),
            rotation_hz: self.rotation_hz,
        }
    }

    pub(super) fn platform(&self) -> Platform {
        let angles_rad = [self.roll_deg, self.pitch_deg, self.yaw_deg].map(f64::to_radians);
        let motion = Motion { angles_rad, period_s: self.motion_period_s };
        let boresight_rad = self.boresight_deg.map(f64::to_radians);
        Platform::new(self.speed_mps, self.flying_height_m, motion, self.lever_arm_m, boresight_rad)
            .turning(self.turn_radius_m)
            .on_track(self.track_offset_m, self.track_direction_deg.to_radians())
    }

    /// Day of the year and year of the flight.
    pub(super) fn recorded(&self) -> Option<(u16, u16)> {
        let adjusted_s = f64::from(GPS_WEEK) * WEEK_S - ADJUSTMENT_S + self.start_time_s;
        day_of_year(adjusted_s).map(|(year, day)| (day, year))
    }

    pub(super) fn world(&self) -> World {
        let heading_rad = self.heading_deg.to_radians();
        match self.start_deg {
            Some(start) => World::starting_at(start.map(f64::to_radians), heading_rad),
            None => World::new(heading_rad),
        }
    }

    pub(super) fn scene(&self) -> Scene {
        let seed = self.scene_seed.unwrap_or(self.seed);
        match self.landscape {
            Landscape::Strips => {
                let scanner = self.scanner();
                let swath = self.platform().swath(scanner.scan_angle_rad, scanner.time_s(self.lines, 0));
                let (building, wood) = (self.building_height_m, self.canopy_height_m);
                Scene::strips(seed, swath, self.flying_height_m, building, wood)
            }
            Landscape::Country => {
                let settings = CountrySettings {
                    relief_m: self.relief_m,
                    water_ratio: self.water_ratio,
                    wood_ratio: if self.canopy_height_m > 0.0 { self.wood_ratio } else { 0.0 },
                    wood_height_m: self.canopy_height_m,
                    house_ratio: if self.building_height_m > 0.0 { self.house_ratio } else { 0.0 },
                    house_height_m: self.building_height_m,
                    wire_height_m: self.wire_height_m,
                };
                Scene::country(seed, self.flying_height_m, settings)
            }
        }
    }

    pub(super) fn detector(&self) -> DetectorModel {
        match self.detector {
            DetectorKind::Linear => DetectorModel::Linear,
            DetectorKind::Riegl => DetectorModel::Riegl,
        }
    }

    pub(super) fn receiver(&self) -> ReceiverSettings {
        let (response, reference) = match self.response {
            Response::Gaussian => {
                (PulseShape::gaussian(GAUSSIAN_FWHM_NS), PulseShape::gaussian(GAUSSIAN_FWHM_NS))
            }
            Response::Riegl => (PulseShape::riegl(), PulseShape::riegl_reference()),
        };
        ReceiverSettings {
            interval_ns: INTERVAL_NS,
            full_scale_dn: FULL_SCALE_DN,
            background_dn: self.background_dn,
            odd_sample_shift: self.odd_sample_shift,
            noise_sd_dn: self.noise_sd_dn,
            noise_autocorrelation: self.noise_autocorrelation.clone(),
            response,
            reference,
            high_power: self.high_power.then_some(HighPower {
                from_dn: self.high_power_from_dn,
                noise_sd_dn: self.high_power_noise_sd_dn,
                delay_ns: self.high_power_delay_ns,
            }),
        }
    }
}
