//! Orientation of the scanner frame in the body frame.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::keys::at_least;
use wavex_geodesy::frames::{IDENTITY, Rotation, rotation_of_angles};

/// Rotation from the scanner frame to the body frame (forward, right, down): a name, or three
/// angles.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Mount {
    /// A named orientation of the scanner axes.
    Named(MountName),
    /// Roll, pitch and yaw, degrees: `Rz(yaw) Ry(pitch) Rx(roll)`.
    Angles(#[schemars(transform = at_least(-360.0).at_most(360.0))] [f64; 3]),
}

/// Orientation of the scanner axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MountName {
    /// x forward, y right, z down: the body axes.
    Level,
    /// x down, z right, y forward.
    XDownZRight,
    /// x down, z left, y backward.
    XDownZLeft,
    /// x down, z forward, y left.
    XDownZForward,
    /// x down, z backward, y right.
    XDownZBackward,
}

impl Default for Mount {
    fn default() -> Mount {
        Mount::Named(MountName::Level)
    }
}

impl Mount {
    /// Rotation from the scanner frame, without boresight, to the body frame.
    pub fn body_from_scanner(&self) -> Rotation {
        match self {
            Mount::Angles(degrees) => rotation_of_angles(degrees.map(f64::to_radians)),
            Mount::Named(MountName::Level) => IDENTITY,
            Mount::Named(MountName::XDownZRight) => [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
            Mount::Named(MountName::XDownZLeft) => [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]],
            Mount::Named(MountName::XDownZForward) => [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]],
            Mount::Named(MountName::XDownZBackward) => [[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_geodesy::frames::{inverse, rotate, then};

    #[test]
    fn names_say_which_way_the_axes_look() {
        let axes = |name| inverse(&Mount::Named(name).body_from_scanner());
        let (forward, right, down) = ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]);
        let back = |v: [f64; 3]| v.map(|part: f64| 0.0 - part);
        assert_eq!(axes(MountName::Level), [forward, right, down]);
        assert_eq!(axes(MountName::XDownZRight), [down, forward, right]);
        assert_eq!(axes(MountName::XDownZLeft), [down, back(forward), back(right)]);
        assert_eq!(axes(MountName::XDownZForward), [down, back(right), forward]);
        assert_eq!(axes(MountName::XDownZBackward), [down, right, back(forward)]);
    }

    #[test]
    fn every_mount_is_a_rotation() {
        let names = [
            MountName::Level,
            MountName::XDownZRight,
            MountName::XDownZLeft,
            MountName::XDownZForward,
            MountName::XDownZBackward,
        ];
        let mounts = names.map(Mount::Named).into_iter().chain([Mount::Angles([3.0, -40.0, 170.0])]);
        for rotation in mounts.map(|mount| mount.body_from_scanner()) {
            let [x, y, z] = inverse(&rotation);
            let cross = [x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0]];
            assert!(cross.iter().zip(z).all(|(a, b)| (a - b).abs() < 1e-15), "right-handed: {rotation:?}");
            let same = then(&rotation, &inverse(&rotation));
            assert!(
                same.as_flattened().iter().zip(IDENTITY.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-15)
            );
        }
    }

    /// Right wing down by 90 degrees: the scanner's down direction points left.
    #[test]
    fn angles_turn_the_scanner_as_they_turn_an_aircraft() {
        let turned = rotate(&Mount::Angles([90.0, 0.0, 0.0]).body_from_scanner(), [0.0, 0.0, 1.0]);
        assert!(turned.iter().zip([0.0, -1.0, 0.0]).all(|(a, b)| (a - b).abs() < 1e-15), "{turned:?}");
    }
}
