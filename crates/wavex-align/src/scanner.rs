//! A scanner in its aircraft, and its beams.

use wavex_geodesy::calibration::Calibration;
use wavex_geodesy::frames::{Rotation, Vector, inverse, rotate, rotation_of_angles};

use crate::vector::{difference, length, scaled};

/// Mounting and calibration of a scanner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scanner {
    /// Rotation of the mount from the scanner to the body frame, without boresight.
    pub body_from_mount: Rotation,
    /// Lever arm, boresight, range and angle corrections, time offset.
    pub calibration: Calibration,
}

impl Scanner {
    /// Beam without corrections, from the origin of the scanner, whose corrected end is here in the body frame.
    ///
    /// The inverse of [`Scanner::locate`] up to rounding. `None` without a direction.
    pub fn beam_to(
        &self,
        time_s: f64,
        end_in_body_m: Vector,
        on_low_power_scale: bool,
    ) -> Option<ScannerBeam> {
        let calibration = &self.calibration;
        let mount_from_body = inverse(&self.body_from_mount);
        let in_mount_m = rotate(&mount_from_body, difference(end_in_body_m, calibration.lever_arm_m));
        let boresight = rotation_of_angles(calibration.boresight_deg.map(f64::to_radians));
        let in_scanner_m = rotate(&inverse(&boresight), in_mount_m);
        let corrected_m = length(in_scanner_m);
        if corrected_m == 0.0 {
            return None;
        }
        let corrected = scaled(in_scanner_m, 1.0 / corrected_m);
        let offset_m = calibration.range_m(0.0, on_low_power_scale);
        let range_m = (corrected_m - offset_m) / (1.0 + calibration.e1);
        let beam = |direction| Some(ScannerBeam { time_s, direction, range_m });
        if calibration.keeps_angles() {
            return beam(corrected);
        }
        let [forward, right, down] = rotate(&self.body_from_mount, corrected);
        let corrected_rad = libm::atan2(right, down);
        // Corrections are small: each step leaves their slope, a few per mille, of the error.
        let mut correction_rad = 0.0;
        for _ in 0..ANGLE_STEPS {
            correction_rad = calibration.angle_correction_rad(corrected_rad - correction_rad);
        }
        let (sine, cosine) = libm::sincos(correction_rad);
        let recorded = [forward, right * cosine - down * sine, down * cosine + right * sine];
        beam(rotate(&mount_from_body, recorded))
    }
}

/// Steps that find a scan angle from its corrected value.
const ANGLE_STEPS: usize = 12;

/// A beam in the frame of its scanner, without corrections.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ScannerBeam {
    /// Emission time on the axis of the trajectory, s.
    pub time_s: f64,
    /// Unit direction.
    pub direction: Vector,
    /// Range along the direction, m.
    pub range_m: f64,
}

/// What beams of a patch share.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BeamSource {
    /// Origin of the beams in the scanner frame, m.
    pub origin_m: [f32; 3],
    /// Whether ranges are on the scale of the low-power receiver.
    pub on_low_power_scale: bool,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_are_recovered_from_their_ends() {
        let calibration = Calibration {
            lever_arm_m: [0.3, -0.2, 0.4],
            boresight_deg: [0.2, -0.3, 1.4],
            e0: 0.5,
            e1: 1e-3,
            e2: 2e-3,
            e3: 3e-3,
            e4: 4e-3,
            e6: 1e-3,
            e7: 0.25,
            ..Calibration::default()
        };
        let body_from_mount = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]];
        let scanner = Scanner { body_from_mount, calibration };
        for (angle_rad, low) in [(-0.6f64, true), (0.0, false), (0.4, true)] {
            let direction = [angle_rad.cos() * 0.8, 0.6, angle_rad.sin() * 0.8];
            let beam = ScannerBeam { time_s: 7.0, direction, range_m: 1234.5 };
            let source = BeamSource { on_low_power_scale: low, ..BeamSource::default() };
            let found = scanner.beam_to(7.0, scanner.end_in_body_m(&source, &beam), low).unwrap();
            let miss = difference(found.direction, direction).map(f64::abs).into_iter().fold(0.0, f64::max);
            assert!(miss < 1e-14 && (found.range_m - 1234.5).abs() < 1e-9, "{found:?}");
        }
        assert_eq!(scanner.beam_to(0.0, calibration.lever_arm_m, false), None);
    }
}
