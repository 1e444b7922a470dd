//! A scanner in its aircraft, and its beams.

use wavex_geodesy::calibration::Calibration;
use wavex_geodesy::frames::{Rotation, Vector};

/// Mounting and calibration of a scanner.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scanner {
    /// Rotation of the mount from the scanner to the body frame, without boresight.
    pub body_from_mount: Rotation,
    /// Lever arm, boresight, range and angle corrections, time offset.
    pub calibration: Calibration,
}

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
