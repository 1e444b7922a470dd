//! Rotations as unit quaternions, for compact storage.

use super::super::frames::{Rotation, Vector};

/// Rotation by an angle about an axis.
///
/// `w` is the cosine of half the angle, `v` the axis times its sine. `q` and `-q` are the same
/// rotation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Quaternion {
    w: f64,
    v: Vector,
}

impl Quaternion {
    /// The quaternion of a rotation matrix.
    ///
    /// Shepperd 1978, "Quaternion from rotation matrix", J. Guidance and Control 1(3): the largest
    /// component is a square root, so that no division is by a small number.
    pub(super) fn of(rotation: &Rotation) -> Quaternion {
        let r = rotation;
        let trace = r[0][0] + r[1][1] + r[2][2];
        let largest = (0..3).fold(0, |best, axis| if r[axis][axis] > r[best][best] { axis } else { best });
        if trace >= r[largest][largest] {
            let s = 2.0 * (1.0 + trace).sqrt();
            let v = [(r[2][1] - r[1][2]) / s, (r[0][2] - r[2][0]) / s, (r[1][0] - r[0][1]) / s];
            return Quaternion { w: 0.25 * s, v };
        }
        let (i, j, k) = (largest, (largest + 1) % 3, (largest + 2) % 3);
        let s = 2.0 * (1.0 + r[i][i] - r[j][j] - r[k][k]).sqrt();
        let mut v = [0.0; 3];
        v[i] = 0.25 * s;
        v[j] = (r[j][i] + r[i][j]) / s;
        v[k] = (r[k][i] + r[i][k]) / s;
        Quaternion { w: (r[k][j] - r[j][k]) / s, v }
    }

    /// The rotation matrix; independent of the norm of the quaternion, which rounding changes.
    pub(super) fn rotation(&self) -> Rotation {
        let Quaternion { w, v: [x, y, z] } = *self;
        let s = 2.0 / (w * w + x * x + y * y + z * z);
        let (wx, wy, wz) = (s * w * x, s * w * y, s * w * z);
        let (xx, xy, xz) = (s * x * x, s * x * y, s * x * z);
        let (yy, yz, zz) = (s * y * y, s * y * z, s * z * z);
        [
            [1.0 - yy - zz, xy - wz, xz + wy],
            [xy + wz, 1.0 - xx - zz, yz - wx],
            [xz - wy, yz + wx, 1.0 - xx - yy],
        ]
    }

    /// The rotation `other` followed by this one.
    pub(super) fn after(&self, other: &Quaternion) -> Quaternion {
        let (a, [ax, ay, az]) = (self.w, self.v);
        let (b, [bx, by, bz]) = (other.w, other.v);
        Quaternion {
            w: a * b - ax * bx - ay * by - az * bz,
            v: [
                a * bx + b * ax + ay * bz - az * by,
                a * by + b * ay + az * bx - ax * bz,
                a * bz + b * az + ax * by - ay * bx,
            ],
        }
    }

    /// The inverse rotation.
    pub(super) fn inverse(&self) -> Quaternion {
        Quaternion { w: self.w, v: self.v.map(|component| -component) }
    }

    /// Modified Rodrigues parameters: the axis times the tangent of a quarter of the angle.
    ///
    /// For angles of at most half a turn this map is smooth and without singularities (Schaub &
    /// Junkins 1996, J. Astronautical Sciences 44(1)).
    pub(super) fn parameters(&self) -> Vector {
        let sign = if self.w < 0.0 { -1.0 } else { 1.0 };
        let scale = sign / (1.0 + sign * self.w);
        self.v.map(|component| scale * component)
    }

    /// The rotation with these parameters: see [`Quaternion::parameters`].
    pub(super) fn of_parameters(parameters: Vector) -> Quaternion {
        let [x, y, z] = parameters;
        let square = x * x + y * y + z * z;
        let scale = 1.0 / (1.0 + square);
        Quaternion { w: scale * (1.0 - square), v: parameters.map(|p| 2.0 * scale * p) }
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::frames::{IDENTITY, rotation_of_angles, then};
    use super::*;
    use core::f64::consts::{FRAC_PI_2, PI};
    use proptest::prelude::*;

    fn near(a: &Rotation, b: &Rotation) -> bool {
        a.as_flattened().iter().zip(b.as_flattened()).all(|(a, b)| (a - b).abs() < 2e-15)
    }

    #[test]
    fn a_quarter_turn_about_each_axis() {
        let half = 0.5f64.sqrt();
        for axis in 0..3 {
            let mut angles = [0.0; 3];
            angles[axis] = FRAC_PI_2;
            let q = Quaternion::of(&rotation_of_angles(angles));
            assert!((q.w - half).abs() < 1e-15 && (q.v[axis] - half).abs() < 1e-15, "{q:?}");
            // The tangent of a quarter of a quarter turn, PI/8.
            assert!((q.parameters()[axis] - (PI / 8.0).tan()).abs() < 1e-15);
        }
    }

    /// Half turns, in which each component in turn is the largest and w is 0.
    #[test]
    fn half_turns_round_trip() {
        for angles in [[PI, 0.0, 0.0], [0.0, 0.0, PI], [PI, 0.0, PI], [0.0; 3]] {
            let rotation = rotation_of_angles(angles);
            assert!(near(&Quaternion::of(&rotation).rotation(), &rotation), "{angles:?}");
        }
        assert_eq!(Quaternion::of(&IDENTITY).parameters(), [0.0; 3]);
    }

    proptest! {
        #[test]
        fn rotations_round_trip(roll in -3.1..3.1, pitch in -1.5..1.5, yaw in -3.1..3.1) {
            let rotation = rotation_of_angles([roll, pitch, yaw]);
            let q = Quaternion::of(&rotation);
            prop_assert!(near(&q.rotation(), &rotation));
            prop_assert!(near(&Quaternion::of_parameters(q.parameters()).rotation(), &rotation));
            prop_assert!(near(&q.inverse().after(&q).rotation(), &IDENTITY));
        }

        #[test]
        fn products_compose_rotations(a in -3.0..3.0, b in -1.5..1.5, c in -3.0..3.0) {
            let (first, second) = (rotation_of_angles([a, b, c]), rotation_of_angles([c, b, a]));
            let product = Quaternion::of(&second).after(&Quaternion::of(&first));
            prop_assert!(near(&product.rotation(), &then(&first, &second)));
        }
    }
}
