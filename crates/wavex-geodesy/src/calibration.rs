//! Scanner calibration: lever arm, boresight, and range and angle corrections.
//!
//! The parameters e0 to e7 have public names, but no public signs or units: those here are this
//! program's own.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Calibration; all zero means none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Calibration {
    /// Lever arm from trajectory to scanner origin, m, in body axes: forward, right, down.
    #[schemars(inner(range(min = -100.0, max = 100.0)))]
    pub lever_arm_m: [f64; 3],
    /// Boresight rotation, applied before the mount, degrees: roll, pitch and yaw, `Rz(yaw)
    /// Ry(pitch) Rx(roll)`.
    #[schemars(inner(range(min = -360.0, max = 360.0)))]
    pub boresight_deg: [f64; 3],
    /// Range offset, m.
    #[schemars(range(min = -100.0, max = 100.0))]
    pub e0: f64,
    /// Range scale correction: this fraction of every range is added to it.
    #[schemars(range(min = -0.5, max = 0.5))]
    pub e1: f64,
    /// Scan angle scale correction: this fraction of the angle is added to it.
    #[schemars(range(min = -0.5, max = 0.5))]
    pub e2: f64,
    /// Quadratic scan angle correction, per radian.
    #[schemars(range(min = -0.5, max = 0.5))]
    pub e3: f64,
    /// Cubic scan angle correction, per square radian.
    #[schemars(range(min = -0.5, max = 0.5))]
    pub e4: f64,
    /// No effect.
    #[schemars(range(min = -1e6, max = 1e6))]
    pub e5: f64,
    /// Scan angle offset, radians.
    #[schemars(range(min = -0.5, max = 0.5))]
    pub e6: f64,
    /// Range offset of the low-power receiver, m.
    #[schemars(range(min = -100.0, max = 100.0))]
    pub e7: f64,
    /// Added to the times of shots to get times of the trajectory, s.
    #[schemars(range(min = -1.0, max = 1.0))]
    pub time_offset_s: f64,
}

impl Calibration {
    /// Corrected range, m: `(1 + e1) range + e0`, and `+ e7` on the scale of the low-power
    /// receiver.
    pub fn range_m(&self, range_m: f64, on_low_power_scale: bool) -> f64 {
        let of_receiver_m = if on_low_power_scale { self.e7 } else { 0.0 };
        (1.0 + self.e1) * range_m + self.e0 + of_receiver_m
    }

    /// Scan angle correction, rad: `e6 + e2 angle + e3 angle² + e4 angle³`.
    pub fn angle_correction_rad(&self, angle_rad: f64) -> f64 {
        self.e6 + angle_rad * (self.e2 + angle_rad * (self.e3 + angle_rad * self.e4))
    }

    /// Whether scan angles are left unchanged.
    pub fn keeps_angles(&self) -> bool {
        [self.e2, self.e3, self.e4, self.e6] == [0.0; 4]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_and_angles_follow_their_formulas() {
        let calibration = Calibration {
            e0: 0.5,
            e1: 1e-3,
            e2: 2e-3,
            e3: 3e-3,
            e4: 4e-3,
            e6: 1e-3,
            e7: 0.25,
            ..Default::default()
        };
        assert!((calibration.range_m(1000.0, false) - 1001.5).abs() < 1e-12);
        assert!((calibration.range_m(1000.0, true) - 1001.75).abs() < 1e-12);
        assert!((calibration.angle_correction_rad(0.5) - (1e-3 + 1e-3 + 0.75e-3 + 0.5e-3)).abs() < 1e-16);
        assert!(!calibration.keeps_angles() && Calibration { e5: 1.0, ..Default::default() }.keeps_angles());
    }
}
