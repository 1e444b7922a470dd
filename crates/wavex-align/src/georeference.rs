//! Position of the end of a beam, and its derivatives by all parameters.
//!
//! `X = X_nav + C_ecef_body (lever + R_mount R_boresight x_scanner)`, with the signs of
//! [`Calibration`](wavex_geodesy::calibration::Calibration) and [`TrajectoryCorrections`] (docs/explanation/georeferencing.md).

use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::frames::{
    Attitude, Rotation, Vector, ecef_from_ned, inverse, rotate, rotation_of_angles, then,
};
use wavex_geodesy::trajectory::corrections::TrajectoryCorrections;
use wavex_geodesy::trajectory::{Pose, Poses};

use crate::parameters::{GLOBALS, Global, OFFSETS};
use crate::scanner::{BeamSource, Scanner, ScannerBeam};
use crate::vector::{cross, scaled, sum};

/// Derivatives of a position in the earth-centred frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Derivatives {
    /// By the parameters of the installation, in the order of [`Global`].
    pub(crate) globals: [Vector; GLOBALS],
    /// By offsets of north, east, down, roll, pitch, heading at the time of the beam.
    pub(crate) offsets: [Vector; OFFSETS],
}

/// A beam in the body frame, with what derivatives need.
struct BodyBeam {
    end_m: Vector,
    boresight: Rotation,
    angle_rad: f64,
    direction: Vector,
    /// Derivative of the direction by the angle correction.
    turning: Vector,
    range_m: f64,
}

impl Scanner {
    /// Position of the end of a beam in the earth-centred frame, m.
    ///
    /// `None` if there is no pose at its time.
    pub fn locate(
        &self,
        source: &BeamSource,
        beam: &ScannerBeam,
        poses: &mut Poses<'_>,
        corrections: Option<&TrajectoryCorrections>,
    ) -> Option<Vector> {
        let time_s = beam.time_s + self.calibration.time_offset_s;
        let pose = corrected_pose(poses, corrections, time_s)?;
        let body = self.in_body(source, beam);
        Some(sum(pose.origin_in_ecef_m, rotate(&pose.ecef_from_body, body.end_m)))
    }

    /// End of a beam in the body frame, m.
    #[cfg(test)]
    pub(crate) fn end_in_body_m(&self, source: &BeamSource, beam: &ScannerBeam) -> Vector {
        self.in_body(source, beam).end_m
    }

    /// Angle of a beam across the flight in the axes of the mounted scanner, rad, positive to the right.
    pub fn scan_angle_rad(&self, beam: &ScannerBeam) -> f64 {
        let [_, right, down] = rotate(&self.body_from_mount, beam.direction);
        libm::atan2(right, down)
    }

    fn in_body(&self, source: &BeamSource, beam: &ScannerBeam) -> BodyBeam {
        let calibration = &self.calibration;
        let [forward, right, down] = rotate(&self.body_from_mount, beam.direction);
        let angle_rad = libm::atan2(right, down);
        let (sine, cosine) = libm::sincos(calibration.angle_correction_rad(angle_rad));
        let turned = [forward, right * cosine + down * sine, down * cosine - right * sine];
        let mount_from_body = inverse(&self.body_from_mount);
        let direction = rotate(&mount_from_body, turned);
        let turning = rotate(&mount_from_body, [0.0, turned[2], -turned[1]]);
        let boresight = rotation_of_angles(calibration.boresight_deg.map(f64::to_radians));
        let range_m = calibration.range_m(beam.range_m, source.on_low_power_scale);
        let in_scanner_m = sum(source.origin_m.map(f64::from), scaled(direction, range_m));
        let in_mount_m = rotate(&boresight, in_scanner_m);
        let end_m = sum(calibration.lever_arm_m, rotate(&self.body_from_mount, in_mount_m));
        BodyBeam { end_m, boresight, angle_rad, direction, turning, range_m }
    }

    /// Position and derivatives; `None` if there is no pose at the time of the beam.
    pub(crate) fn locate_with_derivatives(
        &self,
        source: &BeamSource,
        beam: &ScannerBeam,
        poses: &mut Poses<'_>,
        corrections: Option<&TrajectoryCorrections>,
        with_time: bool,
    ) -> Option<(Vector, Derivatives)> {
        let time_s = beam.time_s + self.calibration.time_offset_s;
        let recorded = poses.at(time_s)?;
        let place = WGS84.geodetic_of(recorded.origin_in_ecef_m);
        let ecef_from_ned = ecef_from_ned(place.latitude_rad, place.longitude_rad);
        let offset = corrections.map(|corrections| corrections.at(time_s)).unwrap_or_default();
        let attitude = Attitude::of(&then(&recorded.ecef_from_body, &inverse(&ecef_from_ned)));
        let attitude = Attitude {
            roll_rad: attitude.roll_rad + offset.roll_pitch_heading_rad[0],
            pitch_rad: attitude.pitch_rad + offset.roll_pitch_heading_rad[1],
            heading_rad: attitude.heading_rad + offset.roll_pitch_heading_rad[2],
        };
        let ned_from_body = attitude.ned_from_body();
        let ecef_from_body = then(&ned_from_body, &ecef_from_ned);
        let body = self.in_body(source, beam);
        let in_ned_m = rotate(&ned_from_body, body.end_m);
        let position =
            sum(recorded.origin_in_ecef_m, rotate(&ecef_from_ned, sum(offset.north_east_down_m, in_ned_m)));

        let earth_columns = inverse(&ecef_from_ned);
        let (sine, cosine) = libm::sincos(attitude.heading_rad);
        let by_roll = rotate(&ned_from_body, cross([1.0, 0.0, 0.0], body.end_m));
        let by_pitch = cross([-sine, cosine, 0.0], in_ned_m);
        let by_heading = cross([0.0, 0.0, 1.0], in_ned_m);
        let [roll, pitch, heading] = [by_roll, by_pitch, by_heading].map(|v| rotate(&ecef_from_ned, v));
        let offsets = [earth_columns[0], earth_columns[1], earth_columns[2], roll, pitch, heading];

        let mut globals = [[0.0; 3]; GLOBALS];
        let lever = inverse(&ecef_from_body);
        globals[..3].copy_from_slice(&lever);
        let ecef_from_mount = then(&self.body_from_mount, &ecef_from_body);
        let in_scanner_m = sum(source.origin_m.map(f64::from), scaled(body.direction, body.range_m));
        let in_mount_m = rotate(&body.boresight, in_scanner_m);
        let (sine, cosine) = libm::sincos(self.calibration.boresight_deg[2].to_radians());
        let boresight = [
            rotate(&body.boresight, cross([1.0, 0.0, 0.0], in_scanner_m)),
            cross([-sine, cosine, 0.0], in_mount_m),
            cross([0.0, 0.0, 1.0], in_mount_m),
        ];
        for (global, by_angle) in globals[3..6].iter_mut().zip(boresight) {
            *global = rotate(&ecef_from_mount, by_angle);
        }
        let in_ecef = |v: Vector| rotate(&ecef_from_mount, rotate(&body.boresight, v));
        let along = in_ecef(body.direction);
        globals[Global::E0 as usize] = along;
        globals[Global::E1 as usize] = scaled(along, beam.range_m);
        if source.on_low_power_scale {
            globals[Global::E7 as usize] = along;
        }
        let turning = scaled(in_ecef(body.turning), body.range_m);
        globals[Global::E6 as usize] = turning;
        for (k, global) in [Global::E2, Global::E3, Global::E4].into_iter().enumerate() {
            globals[global as usize] = scaled(turning, body.angle_rad.powi(k as i32 + 1));
        }
        if with_time {
            let mut at = |step_s: f64| {
                let pose = corrected_pose(poses, corrections, time_s + step_s)?;
                Some((sum(pose.origin_in_ecef_m, rotate(&pose.ecef_from_body, body.end_m)), step_s))
            };
            let before = at(-TIME_STEP_S).unwrap_or((position, 0.0));
            let after = at(TIME_STEP_S).unwrap_or((position, 0.0));
            if after.1 > before.1 {
                let motion = sum(after.0, scaled(before.0, -1.0));
                globals[Global::Time as usize] = scaled(motion, 1.0 / (after.1 - before.1));
            }
        }
        Some((position, Derivatives { globals, offsets }))
    }
}

/// Step of the difference that gives velocity and angular rate, s: below the step of trajectories, so that both ends
/// are on nearly the same cubic.
const TIME_STEP_S: f64 = 1e-3;

fn corrected_pose(
    poses: &mut Poses<'_>,
    corrections: Option<&TrajectoryCorrections>,
    time_s: f64,
) -> Option<Pose> {
    let pose = poses.at(time_s)?;
    Some(match corrections {
        Some(corrections) => corrections.at(time_s).applied_to(&pose),
        None => pose,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated::{Plan, flat, scanner};
    use proptest::prelude::*;
    use wavex_geodesy::trajectory::corrections::{CorrectionKnot, PoseOffset};

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        /// Analytic derivatives are central differences, for any value of the parameters.
        #[test]
        fn derivatives_are_differences(
            time_s in 1001.0..1009.0, angle in -0.5..0.5, ahead in -0.2..0.2, range_m in 300.0..600.0,
            values in proptest::array::uniform14(-0.02..0.02), offsets in proptest::array::uniform6(-0.02..0.02),
            on_low_power_scale: bool,
        ) {
            let plan = Plan { length_m: 500.0, ..Plan::new(Vec::new(), flat) };
            let trajectory = plan.trajectory(0, (0.0, 0.7), 0.0);
            let mut poses = trajectory.poses();
            let mut scanner = scanner();
            for (global, value) in Global::ALL.into_iter().zip(values) {
                global.add_to(&mut scanner, value);
            }
            let direction = rotate(&rotation_of_angles([angle, ahead, 0.0]), [0.0, 0.0, 1.0]);
            let beam = ScannerBeam { time_s, direction, range_m };
            let source = BeamSource { origin_m: [0.1, -0.05, 0.02], on_low_power_scale };
            let corrections = |offsets: [f64; OFFSETS]| {
                let [n, e, d, roll, pitch, heading] = offsets;
                let offset = PoseOffset { north_east_down_m: [n, e, d], roll_pitch_heading_rad: [roll, pitch, heading] };
                TrajectoryCorrections::new(vec![CorrectionKnot { time_s: 0.0, offset }]).unwrap()
            };
            let given = corrections(offsets);
            let (position, derivatives) =
                scanner.locate_with_derivatives(&source, &beam, &mut poses, Some(&given), true).unwrap();
            let plain = scanner.locate(&source, &beam, &mut poses, Some(&given)).unwrap();
            for axis in 0..3 {
                prop_assert!((position[axis] - plain[axis]).abs() < 1e-8);
            }
            for (k, global) in Global::ALL.into_iter().enumerate() {
                // Ranges scale with hundreds of metres, angles too.
                let step = if global == Global::E1 { 1e-6 } else { 1e-5 };
                let mut at = |step: f64| {
                    let mut moved = scanner;
                    global.add_to(&mut moved, step);
                    moved.locate(&source, &beam, &mut poses, Some(&given)).unwrap()
                };
                let (after, before) = (at(step), at(-step));
                for axis in 0..3 {
                    let numeric = (after[axis] - before[axis]) / (2.0 * step);
                    let found = derivatives.globals[k][axis];
                    prop_assert!((numeric - found).abs() < 2e-3, "{global:?} {numeric} {found}");
                }
            }
            for k in 0..OFFSETS {
                let mut at = |step: f64| {
                    let mut moved = offsets;
                    moved[k] += step;
                    scanner.locate(&source, &beam, &mut poses, Some(&corrections(moved))).unwrap()
                };
                let (after, before) = (at(1e-5), at(-1e-5));
                for axis in 0..3 {
                    let numeric = (after[axis] - before[axis]) / 2e-5;
                    prop_assert!((numeric - derivatives.offsets[k][axis]).abs() < 2e-3, "offset {k}");
                }
            }
        }
    }
}
