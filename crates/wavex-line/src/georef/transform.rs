//! Beams from the scanner frame to the earth-centred frame, with their variance.
//!
//! `X = X_nav + C_ecef_body (lever + R_mount R_boresight x_scanner)` (docs/explanation/georeferencing.md): the
//! trajectory gives `X_nav` and `C_ecef_body`, the job the rest.

use super::calibration::Calibration;
use super::mount::Mount;
use crate::scan_line::Emission;
use wavex_geodesy::frames::{IDENTITY, Rotation, Vector, inverse, rotate, rotation_of_angles, then};
use wavex_geodesy::trajectory::{Accuracy, Pose};

/// Mounting and calibration of a scanner in the aircraft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Installation {
    lever_in_body_m: Vector,
    /// Boresight, then mount.
    body_from_scanner: Rotation,
    /// The mount alone and its inverse: scan angles are defined in body axes.
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

    /// Whether scanner and body frame are equal and angles need no correction.
    pub fn is_plain(&self) -> bool {
        self.lever_in_body_m == [0.0; 3]
            && self.body_from_scanner == IDENTITY
            && self.calibration.keeps_angles()
    }

    /// The calibration of ranges and angles.
    pub fn calibration(&self) -> &Calibration {
        &self.calibration
    }

    /// Converts a beam from the scanner frame to the body frame.
    pub fn to_body(&self, emission: &mut Emission) {
        let origin = rotate(&self.body_from_scanner, emission.origin_m);
        emission.origin_m = sum(origin, self.lever_in_body_m);
        let direction_in_scanner = self.corrected(emission);
        emission.direction = rotate(&self.body_from_scanner, direction_in_scanner);
    }

    /// Direction of a beam in the scanner frame, with corrected scan angle.
    ///
    /// The scan angle is that of the mounted scanner, without boresight: about the forward axis,
    /// from straight down, positive to the right.
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

/// Converts a beam from the body frame to the earth-centred frame.
pub fn to_earth(emission: &mut Emission, pose: &Pose) {
    emission.origin_m = sum(pose.origin_in_ecef_m, rotate(&pose.ecef_from_body, emission.origin_m));
    emission.direction = rotate(&pose.ecef_from_body, emission.direction);
    emission.frame_scale = 1.0;
}

/// Angle of a beam off the vertical across the heading, degrees, positive to the right.
///
/// Independent of the definition of roll and pitch. `down` is the vertical at the aircraft.
pub fn scan_angle_deg(direction: Vector, pose: &Pose, down: Vector) -> f64 {
    let right = right_of(pose, down);
    libm::atan2(dot(direction, right), dot(direction, down)).to_degrees()
}

/// Horizontal direction to the right of the heading.
fn right_of(pose: &Pose, down: Vector) -> Vector {
    let forward = inverse(&pose.ecef_from_body)[0];
    let right = cross(down, forward);
    let length = dot(right, right).sqrt();
    right.map(|part| part / length)
}

/// Variance of a point position, m²: the trace of its covariance.
///
/// Position, attitude (each angle rotates the point about its own axis) and range contribute
/// independently. `from_nav_m` is the vector from the aircraft to the point.
pub fn variance_m2(
    accuracy: &Accuracy,
    pose: &Pose,
    down: Vector,
    from_nav_m: Vector,
    range_sd_m: f64,
) -> f64 {
    // Heading rotates about the vertical, pitch about the horizontal right axis, roll about the
    // longitudinal body axis.
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

pub(super) fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::super::mount::MountName;
    use super::*;
    use proptest::prelude::*;
    use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
    use wavex_geodesy::frames::{Attitude, ecef_from_ned};

    fn beam(origin_m: Vector, direction: Vector) -> Emission {
        Emission { origin_m, direction, ..Emission::default() }
    }

    fn near(a: Vector, b: Vector, bound: f64) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < bound)
    }

    fn pose(place: Geodetic, attitude: Attitude) -> (Pose, Vector) {
        let ecef_from_ned = ecef_from_ned(place.latitude_rad, place.longitude_rad);
        let pose = Pose {
            origin_in_ecef_m: WGS84.ecef_of(place),
            ecef_from_body: then(&attitude.ned_from_body(), &ecef_from_ned),
            accuracy: None,
        };
        (pose, rotate(&ecef_from_ned, [0.0, 0.0, 1.0]))
    }

    fn attitude([roll, pitch, heading]: [f64; 3]) -> Attitude {
        let [roll_rad, pitch_rad, heading_rad] = [roll, pitch, heading].map(f64::to_radians);
        Attitude { roll_rad, pitch_rad, heading_rad }
    }

    const PLACE: Geodetic = Geodetic { latitude_rad: 0.8, longitude_rad: -2.0, height_m: 700.0 };

    /// The lever arm moves the origin; the boresight is applied before the mount.
    #[test]
    fn a_beam_goes_through_boresight_mount_and_lever_arm() {
        let calibration = Calibration {
            lever_arm_m: [1.0, 2.0, 3.0],
            boresight_deg: [0.0, 0.0, 90.0],
            ..Calibration::default()
        };
        let installation = Installation::new(&Mount::Named(MountName::XDownZRight), &calibration);
        assert!(!installation.is_plain());
        let mut emission = beam([0.1, 0.0, 0.0], [0.0, -1.0, 0.0]);
        installation.to_body(&mut emission);
        // A yaw of 90 degrees rotates x to y, which the mount maps to forward, and -y to x, which
        // it maps to down.
        assert!(near(emission.origin_m, [1.1, 2.0, 3.0], 1e-15), "{:?}", emission.origin_m);
        assert!(near(emission.direction, [0.0, 0.0, 1.0], 1e-15), "{:?}", emission.direction);
        let plain = Installation::new(&Mount::default(), &Calibration { e0: 1.0, ..Calibration::default() });
        assert!(plain.is_plain(), "range corrections do not affect the beam");
    }

    /// Scan angles are defined in body axes, whatever the axes of the scanner.
    #[test]
    fn scan_angles_are_corrected_about_the_axis_of_the_flight() {
        let calibration = Calibration { e2: 1e-2, e3: 2e-2, e4: 3e-2, e6: 1e-3, ..Calibration::default() };
        for name in [MountName::Level, MountName::XDownZLeft] {
            let mount = Mount::Named(name);
            let installation = Installation::new(&mount, &calibration);
            let mount_from_body = inverse(&mount.body_from_scanner());
            for angle in [-0.5f64, 0.0, 0.4] {
                let (across, ahead) = (0.96f64, 0.28);
                let body = [ahead, across * angle.sin(), across * angle.cos()];
                let mut emission = beam([0.0; 3], rotate(&mount_from_body, body));
                emission.scan_angle_deg = 10.0;
                installation.to_body(&mut emission);
                let right = angle + 1e-3 + 1e-2 * angle + 2e-2 * angle * angle + 3e-2 * angle.powi(3);
                let expected = [ahead, across * right.sin(), across * right.cos()];
                assert!(near(emission.direction, expected, 1e-15), "{name:?} {angle}");
                let turned = f64::from(emission.scan_angle_deg) - 10.0;
                assert!((turned - (right - angle).to_degrees()).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn a_beam_stands_on_the_earth_as_the_aircraft_does() {
        // At 0 N 0 E with heading east: forward is east (y), right is south (-z), down is towards
        // the centre (-x).
        let place = Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 1000.0 };
        let (pose, _) = pose(place, attitude([0.0, 0.0, 90.0]));
        let mut emission = Emission { frame_scale: 1.5, ..beam([1.0, 2.0, 3.0], [0.0, 0.6, 0.8]) };
        to_earth(&mut emission, &pose);
        assert!(near(emission.origin_m, [6_379_134.0, 1.0, -2.0], 1e-8), "{:?}", emission.origin_m);
        assert!(near(emission.direction, [-0.8, 0.0, -0.6], 1e-15), "{:?}", emission.direction);
        assert_eq!(emission.frame_scale, 1.0);
    }

    /// In level flight it is the angle of the scanner. With the right wing down by 10 degrees,
    /// the scanner's down points 10 degrees to the left. Pitch and heading have no effect.
    #[test]
    fn scan_angles_count_from_the_vertical() {
        let angle = |degrees: [f64; 3], scan: f64| {
            let (pose, down) = pose(PLACE, attitude(degrees));
            let body = [0.0, scan.to_radians().sin(), scan.to_radians().cos()];
            scan_angle_deg(rotate(&pose.ecef_from_body, body), &pose, down)
        };
        for (degrees, scan, expected) in [
            ([0.0, 0.0, 123.0], 20.0, 20.0),
            ([10.0, 0.0, -50.0], 0.0, -10.0),
            ([10.0, 0.0, 0.0], 25.0, 15.0),
            ([0.0, 20.0, 77.0], 0.0, 0.0),
        ] {
            let found = angle(degrees, scan);
            assert!((found - expected).abs() < 1e-9, "{degrees:?} {scan}: {found}");
        }
    }

    proptest! {
        /// Compares each angle's part of the variance with the motion of the point for a small
        /// change of the angle.
        #[test]
        fn attitude_moves_a_point_as_its_angles_do(
            roll in -40.0..40.0, pitch in -40.0..40.0, heading in -180.0..180.0,
            x in -800.0..800.0, y in -800.0..800.0, z in 100.0..1000.0,
        ) {
            let degrees = [roll, pitch, heading];
            let (at, down) = pose(PLACE, attitude(degrees));
            let body = [x, y, z];
            let from_nav_m = rotate(&at.ecef_from_body, body);
            for axis in 0..3 {
                let step_deg = 1e-4;
                let mut turned = degrees;
                turned[axis] += step_deg;
                let moved = rotate(&pose(PLACE, attitude(turned)).0.ecef_from_body, body);
                let moved_m = moved.iter().zip(from_nav_m).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
                let mut accuracy = Accuracy::default();
                accuracy.attitude_sd_rad[axis] = f64::to_radians(step_deg);
                let told_m = variance_m2(&accuracy, &at, down, from_nav_m, 0.0).sqrt();
                prop_assert!((told_m - moved_m).abs() < 1e-7, "axis {axis}: {told_m} {moved_m}");
            }
        }
    }

    #[test]
    fn independent_errors_add_their_squares() {
        let (at, down) = pose(PLACE, attitude([0.0; 3]));
        let accuracy = Accuracy { position_sd_m: [0.03, 0.04, 0.12], attitude_sd_rad: [1e-4, 0.0, 0.0] };
        // Straight below, roll moves the point by the height times its SD: 0.1 m at 1000 m.
        let below = rotate(&at.ecef_from_body, [0.0, 0.0, 1000.0]);
        let variance = variance_m2(&accuracy, &at, down, below, 0.2);
        assert!((variance - (0.13f64.powi(2) + 0.1f64.powi(2) + 0.2f64.powi(2))).abs() < 1e-12, "{variance}");
    }
}
