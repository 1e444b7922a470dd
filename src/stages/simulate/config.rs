//! The keys of `simulate`, and what they mean for the parts of the simulator.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{FULL_SCALE_DN, INTERVAL_NS};
use crate::batch::MAX_SHOTS_PER_LINE;
use crate::geo::time::{ADJUSTMENT_S, WEEK_S, day_of_year};
use crate::simulation::detector::Detector;
use crate::simulation::platform::{Motion, Platform};
use crate::simulation::pulse::Shape;
use crate::simulation::receiver::{HighPower, Settings};
use crate::simulation::scanner::{GPS_WEEK, Mirror, START_S, Scanner};
use crate::simulation::scene::{CountrySettings, Scene};
use crate::simulation::world::World;
use crate::stage::{Config, InvalidKey};

/// Full width at half maximum of a Gaussian response, ns.
const GAUSSIAN_FWHM_NS: f64 = 4.5;
/// Beams further from straight down than this may never reach the ground, degrees.
const STEEPEST_DEG: f64 = 75.0;

/// Makes the recording of a flight that never took place.
///
/// A scanner flies over land whose every surface is known, and records it as an airborne instrument does. The truth of
/// every return can be written beside it.
///
/// **Frame.** Without a trajectory (`sbet`, `pof`) the geometry is already in a map (UTM zone 33 north, metres), and the
/// truth stands in the same map, in which beams are straight. With one, beams stand in the frame of the scanner (x
/// forward, y right, z down; parallel to the aircraft's but for `boresight_deg`), and the truth's coordinates are UTM in
/// the zone of the start with ellipsoidal heights on WGS 84, computed by closed formulas from the same scene placed on the
/// earth: trajectory, lever arm, boresight and ranges lead to them within rounding.
///
/// **As recorded.** With `as_recorded` blocks stand with the shot after whose emission they were received, and
/// `mta_zone` is not set. The laser of a rotating polygon pauses between lines: what comes back meanwhile stands with the
/// line's last shot. Without it, blocks stand with the shot that caused them, and zones are given.
///
/// **Receivers.** The low-power receiver always records; `high_power` adds the one for strong echoes, whose blocks begin
/// 1.43 ns later. The amplitude tables of both are in the recording.
///
/// The same keys give the same bytes on every machine, and a scan line does not depend on the others.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Simulate {
    /// What the outputs of the run are named after.
    pub stem: String,
    /// Start of the random numbers: another one gives other noise and another grain of the scene.
    pub seed: u64,
    /// Scan lines.
    #[schemars(range(min = 1))]
    pub lines: u32,
    /// Shots of each scan line.
    #[schemars(range(min = 1, max = 4096))]
    pub shots_per_line: u32,
    /// What moves the beam: a polygon of four facets with a pause of half a line between lines; a mirror that swings
    /// there and back; a row of fibres, whose spots are evenly spaced on level ground; or a beam that turns on a cone
    /// around straight down (`circular`), whose lines are nothing but so many shots.
    pub scanner: ScannerKind,
    /// Pulses per second. Echoes that return after the next pulse are given to the pulse that caused them, unless
    /// `as_recorded`.
    #[schemars(range(min = 1000.0, max = 2000000.0))]
    pub pulse_rate_hz: f64,
    /// How far the interval between two pulses may be from its mean: each pulse leaves up to half of this early or late,
    /// independently of the others; 0: the rate is constant. Below half the interval.
    #[schemars(range(min = 0.0))]
    pub modulation_ns: f64,
    /// The first and the last shot's angle from straight down, positive to the right; the half angle of a cone to both sides.
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
    /// Direction of the flight, clockwise from north.
    #[schemars(range(min = -360.0, max = 360.0))]
    pub heading_deg: f64,
    /// Radius of the circle that the aircraft flies with level wings, positive to the right; 0: straight on. At least 100 m.
    pub turn_radius_m: f64,
    /// Longitude and latitude of the first position; without a trajectory, and when not given, 12.59489 and 47.82814, in UTM
    /// zone 33 north.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start_deg: Option<[f64; 2]>,
    /// When the flight begins, seconds of GPS week 2365 (from 4 May 2025 on). Times count on where the week ends.
    #[schemars(range(min = 0.0, max = 604800.0))]
    pub start_time_s: f64,
    /// The largest roll of the aircraft, which sways about level flight.
    #[schemars(range(min = 0.0, max = 15.0))]
    pub roll_deg: f64,
    /// The largest pitch.
    #[schemars(range(min = 0.0, max = 15.0))]
    pub pitch_deg: f64,
    /// The largest deviation of the aircraft's heading from `heading_deg`.
    #[schemars(range(min = 0.0, max = 15.0))]
    pub yaw_deg: f64,
    /// How long the slower part of the rolling takes; pitch and yaw are slower.
    #[schemars(range(min = 1.0, max = 1000.0))]
    pub motion_period_s: f64,
    /// Where the scanner sits, from the place that the trajectory tells: forward, right, down.
    pub lever_arm_m: [f64; 3],
    /// How the scanner is turned against the aircraft: roll, pitch and yaw, `Rz(yaw) Ry(pitch) Rx(roll)`.
    pub boresight_deg: [f64; 3],
    /// What is flown over: `strips`, level ground with one long building and one long wood; or `country`, hills, lakes,
    /// houses, woods and power lines without end.
    pub landscape: Landscape,
    /// Height of the building, or of the highest houses; 0: none.
    #[schemars(range(min = 0.0, max = 200.0))]
    pub building_height_m: f64,
    /// Height of the wood, or of the highest trees; 0: none.
    #[schemars(range(min = 0.0, max = 200.0))]
    pub canopy_height_m: f64,
    /// In the `country`: height of the highest hill above the deepest hollow; 0: level.
    #[schemars(range(min = 0.0, max = 2000.0))]
    pub relief_m: f64,
    /// In the `country`: share of the land, the lowest, that is under water, from which nothing comes back.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub water_ratio: f64,
    /// In the `country`: share of the land that woods cover.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub wood_ratio: f64,
    /// In the `country`: share of the plots, 40 m by 40 m, on which a house stands where neither wood nor water is.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub house_ratio: f64,
    /// In the `country`: height of the lowest wires of power lines above the ground at their pylons; 0: none.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub wire_height_m: f64,
    /// Mean height of the echoes of level ground straight below the aircraft, above the background. The digitiser ends at
    /// 255.
    #[schemars(range(min = 1.0, max = 10000.0))]
    pub ground_amplitude_dn: f64,
    /// Share of the shots that nothing comes back from.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub dropout_rate: f64,
    /// Share of the shots with an echo, as weak as those that just open a block, where there is nothing.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub false_alarm_rate: f64,
    /// Echoes that arrive within so much time of an emission, before or after, are not recorded.
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub blind_gap_ns: f64,
    /// What the echo of a flat target looks like.
    pub response: Response,
    /// How the height of an echo follows its strength: `linear`, or `riegl`, as the amplitude tables of a RIEGL
    /// LMS-Q680i say (low power compresses above 68 digitiser steps, high power is nearly logarithmic).
    pub detector: DetectorKind,
    /// Background of the even and of the odd samples of a block.
    pub background_dn: [f64; 2],
    /// Standard deviation of the recorded noise, the digitiser's rounding included; 0: rounding alone.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub noise_sd_dn: f64,
    /// Autocorrelation of the recorded noise at 1, 2, ... samples; `[]`: none.
    pub noise_autocorrelation: Vec<f64>,
    /// A second receiver, for strong echoes, of about a tenth of the gain.
    pub high_power: bool,
    /// The second receiver's block is kept where an echo's peak has this height in the first, above the background.
    #[schemars(range(min = 0.0, max = 10000.0))]
    pub high_power_from_dn: f64,
    /// Standard deviation of the second receiver's recorded noise, as `noise_sd_dn`.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub high_power_noise_sd_dn: f64,
    /// How much later the second receiver sees an echo.
    #[schemars(range(min = -10.0, max = 10.0))]
    pub high_power_delay_ns: f64,
    /// Automatic gain control: the least and the greatest gain of both echo receivers, 1/1024 to 1024, over that which the
    /// other keys describe. Signal and noise follow the gain, background and rounding do not; each echo block says its gain,
    /// and the truth has a column `gain`. `[1, 1]`: the gain is constant and not written.
    pub gain_range: [f64; 2],
    /// What the gain follows: the time of the flight (`time`), sinusoidal in its logarithm; or the strongest echo of the
    /// shot before in the line (`echo`), which it would bring to 150 digitiser steps. Without one it is the greatest.
    pub gain_follows: GainFollows,
    /// Period of a gain that follows the time.
    #[schemars(range(min = 0.001, max = 1000.0))]
    pub gain_period_s: f64,
    /// Whether blocks stand with the shot after whose emission they were received, instead of with the one that caused
    /// them.
    pub as_recorded: bool,
    /// A file of the trajectory in SBET format (`*` is the stem), 200 positions and attitudes per second, from a second
    /// before the flight to a second after it; not written when not given. Times are seconds of the GPS week.
    pub sbet: Option<String>,
    /// The same trajectory in RIEGL's POF format.
    pub pof: Option<String>,
    /// A CSV file of what a perfect evaluation would find (`*` is the stem); not written when not given. A return stands
    /// there when its peak lies in a recorded block, however weak it is.
    pub truth: Option<String>,
}

/// What moves the beam.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ScannerKind {
    /// A polygon of four facets, with pauses between lines.
    RotatingPolygon,
    /// A mirror that swings there and back.
    Oscillating,
    /// A row of fibres.
    ParallelLines,
    /// A beam that turns on a cone.
    Circular,
}

/// What is flown over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Landscape {
    /// Level ground with one long building and one long wood.
    Strips,
    /// Hills, lakes, houses, woods and power lines without end.
    Country,
}

/// What the echo of a flat target looks like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Response {
    /// A Gaussian of 4.5 ns full width at half maximum, for comparisons with formulas.
    Gaussian,
    /// As measured on a RIEGL LMS-Q680i: a skewed lobe of 4.5 ns, an after-pulse of 5 % 10.5 ns behind it, and a slow
    /// tail. The default, because whoever takes this for a sum of Gaussians finds points that are not there.
    Riegl,
}

/// What the receivers' gain follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum GainFollows {
    /// The time of the flight.
    Time,
    /// The strongest echo of the shot before.
    Echo,
}

/// How the height of an echo follows its strength.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum DetectorKind {
    /// In proportion.
    Linear,
    /// As a RIEGL LMS-Q680i's tables say.
    Riegl,
}

impl Default for Simulate {
    fn default() -> Simulate {
        Simulate {
            stem: "simulated".to_owned(),
            seed: 1,
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

fn within(value: f64, low: f64, high: f64) -> bool {
    (low..=high).contains(&value)
}

impl Config for Simulate {
    fn check(&self) -> Checked {
        self.check_scanner()?;
        self.check_platform()?;
        self.check_scene()?;
        self.check_receiver()
    }
}

impl Simulate {
    fn check_scanner(&self) -> Checked {
        let is_name = !self.stem.is_empty() && !self.stem.contains(['/', '\\']);
        unless(is_name, "stem", "must be a file name without folders")?;
        unless(self.lines >= 1, "lines", "must be at least 1")?;
        let most = MAX_SHOTS_PER_LINE as u32;
        unless((1..=most).contains(&self.shots_per_line), "shots_per_line", "must lie between 1 and 4096")?;
        unless(within(self.pulse_rate_hz, 1e3, 2e6), "pulse_rate_hz", "must lie between 1000 and 2000000")?;
        let modulation = self.modulation_ns >= 0.0 && self.modulation_ns < 0.5e9 / self.pulse_rate_hz;
        unless(modulation, "modulation_ns", "must lie between 0 and half the interval between pulses")?;
        let [first, last] = self.scan_angle_deg;
        let angles = within(first, -60.0, 60.0) && within(last, -60.0, 60.0) && first < last;
        unless(angles, "scan_angle_deg", "must be two ascending angles between -60 and 60")?;
        let even = self.scanner != ScannerKind::Circular || first == -last;
        unless(even, "scan_angle_deg", "must be -a and a for a circular scanner of half angle a")?;
        unless(within(self.rotation_hz, 1.0, 1000.0), "rotation_hz", "must lie between 1 and 1000")
    }

    fn check_platform(&self) -> Checked {
        unless(within(self.speed_mps, 1.0, 1000.0), "speed_mps", "must lie between 1 and 1000")?;
        unless(within(self.heading_deg, -360.0, 360.0), "heading_deg", "must lie between -360 and 360")?;
        let turns = self.turn_radius_m == 0.0 || within(self.turn_radius_m.abs(), 100.0, 1e6);
        unless(turns, "turn_radius_m", "must be 0, or 100 to 1000000 to either side")?;
        if let Some([longitude, latitude]) = self.start_deg {
            let on_earth = within(longitude, -180.0, 180.0) && within(latitude, -89.0, 89.0);
            unless(on_earth, "start_deg", "must be a longitude, and a latitude between -89 and 89")?;
            unless(self.has_trajectory(), "start_deg", "needs a trajectory: give `sbet` or `pof`")?;
        }
        let in_week = self.start_time_s >= 0.0 && self.start_time_s < WEEK_S;
        unless(in_week, "start_time_s", "must lie between 0 and 604800")?;
        let sway = "must lie between 0 and 15";
        unless(within(self.roll_deg, 0.0, 15.0), "roll_deg", sway)?;
        unless(within(self.pitch_deg, 0.0, 15.0), "pitch_deg", sway)?;
        unless(within(self.yaw_deg, 0.0, 15.0), "yaw_deg", sway)?;
        unless(within(self.motion_period_s, 1.0, 1000.0), "motion_period_s", "must lie between 1 and 1000")?;
        let near = self.lever_arm_m.iter().all(|&arm| within(arm, -10.0, 10.0));
        unless(near, "lever_arm_m", "must be three lengths between -10 and 10")?;
        let small = self.boresight_deg.iter().all(|&angle| within(angle, -10.0, 10.0));
        unless(small, "boresight_deg", "must be three angles between -10 and 10")?;
        let steep = self.steepest_deg() <= STEEPEST_DEG;
        unless(
            steep,
            "scan_angle_deg",
            "must leave beams within 75 degrees of straight down, whatever roll, pitch and boresight",
        )
    }

    fn check_scene(&self) -> Checked {
        let heights = "must lie between 0 and 200";
        unless(within(self.building_height_m, 0.0, 200.0), "building_height_m", heights)?;
        unless(within(self.canopy_height_m, 0.0, 200.0), "canopy_height_m", heights)?;
        unless(within(self.relief_m, 0.0, 2000.0), "relief_m", "must lie between 0 and 2000")?;
        let share = "must lie between 0 and 1";
        unless(within(self.water_ratio, 0.0, 1.0), "water_ratio", share)?;
        unless(within(self.wood_ratio, 0.0, 1.0), "wood_ratio", share)?;
        unless(within(self.house_ratio, 0.0, 1.0), "house_ratio", share)?;
        unless(within(self.wire_height_m, 0.0, 100.0), "wire_height_m", "must lie between 0 and 100")?;
        let stands = self.building_height_m.max(self.canopy_height_m);
        match self.landscape {
            Landscape::Strips => {
                let flight = "must lie between 20 m above building and wood, and 10000";
                unless(within(self.flying_height_m, stands + 20.0, 10_000.0), "flying_height_m", flight)?;
            }
            Landscape::Country => {
                let lowest = self.relief_m + stands.max(self.wire_height_m + 4.0) + 30.0;
                let flight = "must lie between 30 m above hills and all that stands on them, and 10000";
                unless(within(self.flying_height_m, lowest, 10_000.0), "flying_height_m", flight)?;
            }
        }
        let amplitude = "must lie between 1 and 10000";
        unless(within(self.ground_amplitude_dn, 1.0, 10_000.0), "ground_amplitude_dn", amplitude)?;
        unless(within(self.dropout_rate, 0.0, 1.0), "dropout_rate", share)?;
        unless(within(self.false_alarm_rate, 0.0, 1.0), "false_alarm_rate", share)
    }

    fn check_receiver(&self) -> Checked {
        unless(within(self.blind_gap_ns, 0.0, 1000.0), "blind_gap_ns", "must lie between 0 and 1000")?;
        let background = self.background_dn.iter().all(|&dn| within(dn, 0.0, 100.0));
        unless(background, "background_dn", "must be two values between 0 and 100")?;
        // Below half a step the rounding is no longer independent of the noise.
        let noise = |sd_dn: f64| sd_dn == 0.0 || within(sd_dn, 0.5, 100.0);
        let spread = "must be 0, or lie between 0.5 and 100";
        unless(noise(self.noise_sd_dn), "noise_sd_dn", spread)?;
        unless(noise(self.high_power_noise_sd_dn), "high_power_noise_sd_dn", spread)?;
        let strong = within(self.high_power_from_dn, 0.0, 10_000.0);
        unless(strong, "high_power_from_dn", "must lie between 0 and 10000")?;
        let delay = within(self.high_power_delay_ns, -10.0, 10.0);
        unless(delay, "high_power_delay_ns", "must lie between -10 and 10")?;
        let [least, greatest] = self.gain_range;
        let gains = within(least, 1.0 / 1024.0, greatest) && greatest <= 1024.0;
        unless(gains, "gain_range", "must be two ascending gains between 1/1024 and 1024")?;
        let period = within(self.gain_period_s, 0.001, 1000.0);
        unless(period, "gain_period_s", "must lie between 0.001 and 1000")?;
        let few = self.noise_autocorrelation.len() <= 16;
        unless(few, "noise_autocorrelation", "must have at most 16 values")?;
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

    /// The largest angle between a beam and straight down, degrees.
    pub(super) fn steepest_deg(&self) -> f64 {
        let [roll, pitch, _] = self.boresight_deg;
        let scan = self.scan_angle_deg.iter().fold(0.0, |most: f64, angle| most.max(angle.abs()));
        scan + roll.abs() + pitch.abs() + self.roll_deg + self.pitch_deg
    }

    /// Whether the gain changes.
    pub(super) fn has_gain_control(&self) -> bool {
        self.gain_range != [1.0, 1.0]
    }

    /// Whether a trajectory is written, so that beams stand in the frame of the scanner.
    pub(super) fn has_trajectory(&self) -> bool {
        self.sbet.is_some() || self.pof.is_some()
    }

    pub(super) fn scanner(&self) -> Scanner {
        Scanner {
            mirror: match self.scanner {
                ScannerKind::RotatingPolygon => Mirror::RotatingPolygon,
                ScannerKind::Oscillating => Mirror::Oscillating,
                ScannerKind::ParallelLines => Mirror::ParallelLines,
                ScannerKind::Circular => Mirror::Circular,
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
    }

    /// The day of the year, and the year, of the flight.
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
        match self.landscape {
            Landscape::Strips => {
                let scanner = self.scanner();
                let swath = self.platform().swath(scanner.scan_angle_rad, scanner.time_s(self.lines, 0));
                let (building, wood) = (self.building_height_m, self.canopy_height_m);
                Scene::strips(self.seed, swath, self.flying_height_m, building, wood)
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
                Scene::country(self.seed, self.flying_height_m, settings)
            }
        }
    }

    pub(super) fn detector(&self) -> Detector {
        match self.detector {
            DetectorKind::Linear => Detector::Linear,
            DetectorKind::Riegl => Detector::Riegl,
        }
    }

    pub(super) fn receiver(&self) -> Settings {
        let (response, reference) = match self.response {
            Response::Gaussian => (Shape::gaussian(GAUSSIAN_FWHM_NS), Shape::gaussian(GAUSSIAN_FWHM_NS)),
            Response::Riegl => (Shape::riegl(), Shape::riegl_reference()),
        };
        Settings {
            interval_ns: INTERVAL_NS,
            full_scale_dn: FULL_SCALE_DN,
            background_dn: self.background_dn,
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
