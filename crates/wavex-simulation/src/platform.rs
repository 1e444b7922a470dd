//! Position and attitude of the scanner over time.

use core::f64::consts::TAU;

use super::scene::{MapArea, SceneBeam};
use super::start::{GROUND_HEIGHT_M, START_M};
use wavex_geodesy::frames::{Attitude, IDENTITY, Rotation, rotate, rotation_of_angles, then};

/// An aircraft with a scanner, on a straight or circular track at constant speed and height.
///
/// Positions are in the frame of the scene: x to the right of the initial track, y along it, z up.
/// Apart from its motion, the body (forward, right, down) is level and points along the track.
#[derive(Clone, Debug, PartialEq)]
pub struct Platform {
    speed_mps: f64,
    flying_height_m: f64,
    motion: Motion,
    lever_arm_m: [f64; 3],
    body_from_scanner: Rotation,
    /// Radius of the circle, m, positive to the right; 0: straight track.
    turn_radius_m: f64,
    /// Start of the track relative to [`START_M`], m: right, along.
    track_offset_m: [f64; 2],
    /// Direction of the initial track, rad, clockwise from the y axis of the scene.
    track_direction_rad: f64,
    /// Level, with the scanner at the centre of the body: beams need no rotation.
    is_steady: bool,
}

/// Angular motion of the body: each angle is the sum of two sines.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Maximum roll, pitch and yaw, rad.
    pub angles_rad: [f64; 3],
    /// Period of the slower sine of the roll, s; pitch and yaw are slower.
    pub period_s: f64,
}

/// Amplitude fractions of the slower and the faster sine.
const SHARES: [f64; 2] = [0.7, 0.3];
/// Frequencies of both sines for each angle, relative to the period; no two have a common multiple
/// within a flight.
const FREQUENCIES: [[f64; 2]; 3] = [[1.0, 2.62], [0.73, 1.93], [0.41, 1.27]];

impl Platform {
    /// An aircraft with this ground speed and height above the level ground of the scene.
    ///
    /// `lever_arm_m` is the position of the scanner in the body (forward, right, down);
    /// `boresight_rad` its rotation (roll, pitch, yaw).
    pub fn new(
        speed_mps: f64,
        flying_height_m: f64,
        motion: Motion,
        lever_arm_m: [f64; 3],
        boresight_rad: [f64; 3],
    ) -> Platform {
        let is_steady =
            [motion.angles_rad, lever_arm_m, boresight_rad].as_flattened().iter().all(|&v| v == 0.0);
        let body_from_scanner = if is_steady { IDENTITY } else { rotation_of_angles(boresight_rad) };
        let turn_radius_m = 0.0;
        Platform {
            speed_mps,
            flying_height_m,
            motion,
            lever_arm_m,
            body_from_scanner,
            turn_radius_m,
            track_offset_m: [0.0; 2],
            track_direction_rad: 0.0,
            is_steady,
        }
    }

    /// Moves the track in the scene: offset of its start to the right and along, m, and direction,
    /// rad clockwise.
    ///
    /// Flights over one scene form a survey.
    pub fn on_track(self, track_offset_m: [f64; 2], track_direction_rad: f64) -> Platform {
        let is_steady = self.is_steady && track_direction_rad == 0.0;
        Platform { track_offset_m, track_direction_rad, is_steady, ..self }
    }

    /// Changes the track to a circle of this radius, m: positive to the right, 0: straight.
    pub fn turning(self, turn_radius_m: f64) -> Platform {
        Platform { turn_radius_m, is_steady: self.is_steady && turn_radius_m == 0.0, ..self }
    }

    /// Speed along the track, m/s.
    pub fn speed_mps(&self) -> f64 {
        self.speed_mps
    }

    /// Position of the body's centre in the scene, m.
    pub(crate) fn position_m(&self, since_start_s: f64) -> [f64; 3] {
        let x = START_M[0] + self.track_offset_m[0];
        let y = START_M[1] + self.track_offset_m[1];
        let height_m = GROUND_HEIGHT_M + self.flying_height_m;
        let [right_m, along_m] = match self.turn_radius_m {
            0.0 => [0.0, self.speed_mps * since_start_s],
            radius_m => {
                let (sine, cosine) = libm::sincos(self.turned_rad(since_start_s));
                [radius_m * (1.0 - cosine), radius_m * sine]
            }
        };
        let [right_m, along_m] = self.in_scene([right_m, along_m]);
        [x + right_m, y + along_m, height_m]
    }

    /// Rotates a horizontal vector from right and along the initial track to the scene.
    fn in_scene(&self, [right, along]: [f64; 2]) -> [f64; 2] {
        if self.track_direction_rad == 0.0 {
            return [right, along];
        }
        let (sine, cosine) = libm::sincos(self.track_direction_rad);
        [right * cosine + along * sine, along * cosine - right * sine]
    }

    /// Velocity along the y axis of the scene, to its right, and down, m/s.
    pub fn velocity_mps(&self, since_start_s: f64) -> [f64; 3] {
        let (sine, cosine) = libm::sincos(self.turned_rad(since_start_s));
        let [right, along] = self.in_scene([self.speed_mps * sine, self.speed_mps * cosine]);
        [along, right, 0.0]
    }

    /// Rotation of the track to the right since its start, rad.
    fn turned_rad(&self, since_start_s: f64) -> f64 {
        if self.turn_radius_m == 0.0 { 0.0 } else { self.speed_mps * since_start_s / self.turn_radius_m }
    }

    /// Attitude of the body; heading is relative to the y axis of the scene.
    pub fn attitude(&self, since_start_s: f64) -> Attitude {
        let [roll_rad, pitch_rad, heading_rad] =
            core::array::from_fn(|axis| self.motion.angle(axis, since_start_s));
        Attitude {
            roll_rad,
            pitch_rad,
            heading_rad: heading_rad + self.track_direction_rad + self.turned_rad(since_start_s),
        }
    }

    /// Beam in the scene for a direction in the scanner.
    pub fn beam(&self, since_start_s: f64, direction_in_scanner: [f64; 3]) -> SceneBeam {
        let origin_m = self.position_m(since_start_s);
        if self.is_steady {
            let [forward, right, down] = direction_in_scanner;
            return SceneBeam { origin_m, direction: [right, forward, -down] };
        }
        let track_from_body = self.attitude(since_start_s).ned_from_body();
        let track_from_scanner = then(&self.body_from_scanner, &track_from_body);
        let [forward, right, down] = rotate(&track_from_body, self.lever_arm_m);
        let [along, across, below] = rotate(&track_from_scanner, direction_in_scanner);
        SceneBeam {
            origin_m: [origin_m[0] + right, origin_m[1] + forward, origin_m[2] - down],
            direction: [across, along, -below],
        }
    }

    /// Ground area covered between two scan angles up to a time, for a level flight.
    pub fn swath(&self, scan_angle_rad: [f64; 2], end_s: f64) -> MapArea {
        let across = |angle_rad| START_M[0] + self.flying_height_m * libm::tan(angle_rad);
        let along = |time_s| START_M[1] + self.speed_mps * time_s;
        MapArea { x: scan_angle_rad.map(across), y: [along(0.0), along(end_s)] }
    }
}

impl Motion {
    fn angle(&self, axis: usize, time_s: f64) -> f64 {
        let largest = self.angles_rad[axis];
        if largest == 0.0 {
            return 0.0;
        }
        let turns = time_s / self.period_s;
        let sines = FREQUENCIES[axis].map(|frequency| libm::sin(TAU * frequency * turns + frequency));
        largest * (SHARES[0] * sines[0] + SHARES[1] * sines[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn platform(angles_rad: [f64; 3], lever_arm_m: [f64; 3], boresight_rad: [f64; 3]) -> Platform {
        Platform::new(60.0, 600.0, Motion { angles_rad, period_s: 5.0 }, lever_arm_m, boresight_rad)
    }

    #[test]
    fn a_level_flight_looks_along_its_scanner() {
        let steady = platform([0.0; 3], [0.0; 3], [0.0; 3]);
        let beam = steady.beam(2.0, [0.0, 0.6, 0.8]);
        assert_eq!(beam.origin_m, [320_000.0, 5_300_120.0, 1000.0]);
        assert_eq!(beam.direction, [0.6, 0.0, -0.8]);
        let swath = steady.swath([-0.5, 0.5], 10.0);
        assert_eq!(swath.y, [5_300_000.0, 5_300_600.0]);
        assert!((swath.x[1] - 320_000.0 - 600.0 * 0.5f64.tan()).abs() < 1e-9);
    }

    /// A quarter circle to the right ends one radius ahead and one to the right, and points right.
    #[test]
    fn a_circular_track_turns_to_its_side() {
        let quarter_s = core::f64::consts::FRAC_PI_2 * 900.0 / 60.0;
        let circling = platform([0.0; 3], [0.0; 3], [0.0; 3]).turning(900.0);
        let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(near(circling.position_m(quarter_s), [320_900.0, 5_300_900.0, 1000.0]));
        assert!(near(circling.velocity_mps(quarter_s), [0.0, 60.0, 0.0]));
        assert!(near(circling.beam(quarter_s, [0.6, 0.0, 0.8]).direction, [0.6, 0.0, -0.8]));
        let left = platform([0.0; 3], [0.0; 3], [0.0; 3]).turning(-900.0);
        assert!(near(left.position_m(quarter_s), [319_100.0, 5_300_900.0, 1000.0]));
    }

    /// To the east from 100 m right and 50 m ahead of the start.
    #[test]
    fn a_track_can_start_anywhere_in_any_direction() {
        let crossing =
            platform([0.0; 3], [0.0; 3], [0.0; 3]).on_track([100.0, 50.0], core::f64::consts::FRAC_PI_2);
        let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9);
        assert!(near(crossing.position_m(2.0), [320_220.0, 5_300_050.0, 1000.0]));
        assert!(near(crossing.velocity_mps(2.0), [0.0, 60.0, 0.0]));
        assert!(near(crossing.beam(2.0, [0.0, 0.6, 0.8]).direction, [0.0, -0.6, -0.8]));
    }

    #[test]
    fn a_scanner_sits_at_its_lever_arm() {
        let beam = platform([0.0; 3], [1.0, 2.0, 3.0], [0.0; 3]).beam(0.0, [0.0, 0.0, 1.0]);
        assert_eq!(beam.origin_m, [320_002.0, 5_300_001.0, 997.0]);
        assert_eq!(beam.direction, [0.0, 0.0, -1.0]);
    }

    /// Right wing down: the beam moves left. Nose up: forward. Nose right: clockwise.
    #[test]
    fn angles_turn_the_beam_as_they_turn_the_aircraft() {
        let beam = |angles| platform([0.0; 3], [0.0; 3], angles).beam(0.0, [0.0, 0.0, 1.0]).direction;
        assert!(beam([0.1, 0.0, 0.0])[0] < -0.09);
        assert!(beam([0.0, 0.1, 0.0])[1] > 0.09);
        let aside = platform([0.0; 3], [0.0; 3], [0.0, 0.0, 0.1]).beam(0.0, [0.0, 0.6, 0.8]).direction;
        assert!(aside[1] < -0.05 && aside[0] > 0.59, "a beam to the right goes back: {aside:?}");
    }

    #[test]
    fn attitude_angles_stay_within_their_maximum_and_reach_it() {
        let swaying = platform([0.05, 0.03, 0.02], [0.0; 3], [0.0; 3]);
        let mut largest = [0.0f64; 3];
        for k in 0..20_000 {
            let attitude = swaying.attitude(0.05 * f64::from(k));
            let angles = [attitude.roll_rad, attitude.pitch_rad, attitude.heading_rad];
            largest.iter_mut().zip(angles).for_each(|(largest, angle)| *largest = largest.max(angle.abs()));
        }
        for (largest, limit) in largest.iter().zip([0.05, 0.03, 0.02]) {
            assert!(*largest <= limit && *largest > 0.95 * limit, "{largest} of {limit}");
        }
        let length = swaying.beam(3.0, [0.0, 0.6, 0.8]).direction.iter().map(|d| d * d).sum::<f64>();
        assert!((length - 1.0).abs() < 1e-14);
    }
}
