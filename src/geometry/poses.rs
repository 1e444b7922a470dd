//! From a beam in the scanner's frame to one in the earth's, and how surely.
//!
//! `X = X_nav + C_ecef_body (lever + R_mount R_boresight x_scanner)` (docs/georeferencing.md): the trajectory gives `X_nav`
//! and `C_ecef_body`, the job the rest.

use super::calibration::Calibration;
use super::mount::Mount;
use crate::batch::Emission;
use crate::geo::frames::{IDENTITY, Rotation, Vector, inverse, rotate, rotation_of_angles, then};
use crate::geo::trajectory::{Accuracy, Pose};

/// How a scanner sits in the aircraft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Installation {
    lever_in_body_m: Vector,
    /// Boresight, then mount.
    body_from_scanner: Rotation,
    /// The mount alone, and back: in the aircraft's axes the scan angle is told.
    mount: [Rotation; 2],
    calibration: Calibration,
}

impl Installation {
    /// A scanner with this mount and calibration.
    pub fn new(mount: &Mount, calibration: &Calibration) -> Installation {
        let boresight = rotation_of_angles(calibration.boresight_deg.map(f64::to_radians));
        let body_from_mount = mount.body_from_scanner();
        Installation {
            lever_in_body_m: calibration.lever_arm_m,
            body_from_scanner: then(&boresight, &body_from_mount),
            mount: [body_from_mount, inverse(&body_from_mount)],
            calibration: *calibration,
        }
    }

    /// Whether the scanner's frame is the aircraft's, and nothing is to be corrected.
    pub fn is_plain(&self) -> bool {
        self.lever_in_body_m == [0.0; 3]
            && self.body_from_scanner == IDENTITY
            && self.calibration.keeps_angles()
    }

    /// What the ranges are corrected by.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// Turns a beam of the scanner's frame into one of the aircraft's.
    pub fn to_body(&self, emission: &mut Emission) {
        let origin = rotate(&self.body_from_scanner, emission.origin_m);
        emission.origin_m = sum(origin, self.lever_in_body_m);
        let direction_in_scanner = self.corrected(emission);
        emission.direction = rotate(&self.body_from_scanner, direction_in_scanner);
    }

    /// The direction of a beam, in the scanner's frame, with its scan angle as it should be. The scan angle is that of the
    /// mounted scanner, without boresight: about the axis that looks forward, from straight down, positive to the right.
    fn corrected(&self, emission: &mut Emission) -> Vector {
        if self.calibration.keeps_angles() {
            return emission.direction;
        }
        let [body_from_mount, mount_from_body] = &self.mount;
        let [forward, right, down] = rotate(body_from_mount, emission.direction);
        let correction_rad = self.calibration.angle_correction_rad(libm::atan2(right, down));
        emission.scan_angle_deg += correction_rad.to_degrees() as f32;
        let (sine, cosine) = libm::sincos(correction_rad);
        rotate(mount_from_body, [forward, right * cosine + down * sine, down * cosine - right * sine])
    }
}

/// Turns a beam of the aircraft's frame into one of the earth's.
pub fn to_earth(emission: &mut Emission, pose: &Pose) {
    emission.origin_m = sum(pose.origin_in_ecef_m, rotate(&pose.ecef_from_body, emission.origin_m));
    emission.direction = rotate(&pose.ecef_from_body, emission.direction);
    emission.frame_scale = 1.0;
}

/// The angle of a beam off the vertical, across the aircraft's heading, degrees: positive to the right, whatever roll and
/// pitch. `down` is the vertical at the aircraft.
pub fn scan_angle_deg(direction: Vector, pose: &Pose, down: Vector) -> f64 {
    let right = right_of(pose, down);
    libm::atan2(dot(direction, right), dot(direction, down)).to_degrees()
}

/// The level direction to the right of the heading.
fn right_of(pose: &Pose, down: Vector) -> Vector {
    let forward = inverse(&pose.ecef_from_body)[0];
    let right = cross(down, forward);
    let length = dot(right, right).sqrt();
    right.map(|part| part / length)
}

/// The variance of a point's place, m²: the trace of its covariance, of which position, attitude (each angle moves the
/// point about its own axis) and range have independent parts. `from_nav` leads from the aircraft's place to the point.
pub fn variance_m2(accuracy: &Accuracy, pose: &Pose, down: Vector, from_nav_m: Vector, range_sd_m: f64) -> f64 {
    // Heading turns about the vertical, pitch about the level axis to the right, roll about the aircraft's own axis.
    let axes = [inverse(&pose.ecef_from_body)[0], right_of(pose, down), down];
    let position: f64 = accuracy.position_sd_m.iter().map(|sd| sd * sd).sum();
    let attitude: f64 = axes
        .into_iter()
        .zip(accuracy.attitude_sd_rad)
        .map(|(axis, sd)| {
            let lever = cross(axis, from_nav_m);
            sd * sd * dot(lever, lever)
        })
        .sum();
    position + attitude + range_sd_m * range_sd_m
}

fn sum(a: Vector, b: Vector) -> Vector {
    core::array::from_fn(|axis| a[axis] + b[axis])
}

pub(super) fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}
