//! Rotations between the earth, the local horizon and the body frame.
//!
//! A rotation `b_from_a` converts the components of a vector from frame `a` to frame `b`. Frames:
//! ECEF (see [`super::ellipsoid`]); NED, ENU: north, east, down or east, north, up at a position,
//! along the ellipsoid's normal; body: forward, right, down. Only `+ - * /`, square roots and the
//! crate `libm` are used.

use super::ellipsoid::{Ellipsoid, Geodetic};

/// Components of a vector.
pub type Vector = [f64; 3];

/// Rotation matrix by rows.
pub type Rotation = [[f64; 3]; 3];

/// The identity rotation.
pub const IDENTITY: Rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Attitude of a body relative to north, east, down, as in an SBET.
///
/// `ned_from_body = Rz(heading) Ry(pitch) Rx(roll)`. The heading of an SBET is its platform heading
/// minus its wander angle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Attitude {
    /// Positive with the right wing down.
    pub roll_rad: f64,
    /// Positive with the nose up, -π/2 to π/2.
    pub pitch_rad: f64,
    /// Clockwise from north as seen from above.
    pub heading_rad: f64,
}

impl Attitude {
    /// Rotation from the body (forward, right, down) to north, east, down.
    pub fn ned_from_body(&self) -> Rotation {
        let (sr, cr) = libm::sincos(self.roll_rad);
        let (sp, cp) = libm::sincos(self.pitch_rad);
        let (sh, ch) = libm::sincos(self.heading_rad);
        [
            [ch * cp, ch * sp * sr - sh * cr, ch * sp * cr + sh * sr],
            [sh * cp, sh * sp * sr + ch * cr, sh * sp * cr - ch * sr],
            [-sp, cp * sr, cp * cr],
        ]
    }

    /// Angles of such a rotation, with roll and heading from -π to π.
    ///
    /// If the nose points straight up or down, only their sum is determined, and the roll is 0.
    pub fn of(ned_from_body: &Rotation) -> Attitude {
        let [[xx, xy, _], [yx, yy, _], [zx, zy, zz]] = *ned_from_body;
        let level = (zy * zy + zz * zz).sqrt();
        let pitch_rad = libm::atan2(-zx, level);
        if level < 1e-12 {
            return Attitude { roll_rad: 0.0, pitch_rad, heading_rad: libm::atan2(-xy, yy) };
        }
        Attitude { roll_rad: libm::atan2(zy, zz), pitch_rad, heading_rad: libm::atan2(yx, xx) }
    }
}

/// `Rz(yaw) Ry(pitch) Rx(roll)` of three angles, rad: the convention of boresight and mount.
pub fn rotation_of_angles([roll_rad, pitch_rad, yaw_rad]: Vector) -> Rotation {
    Attitude { roll_rad, pitch_rad, heading_rad: yaw_rad }.ned_from_body()
}

/// Rotation from north, east, down at a position to the earth-centred frame.
pub fn ecef_from_ned(latitude_rad: f64, longitude_rad: f64) -> Rotation {
    let (sb, cb) = libm::sincos(latitude_rad);
    let (sl, cl) = libm::sincos(longitude_rad);
    [[-sb * cl, -sl, -cb * cl], [-sb * sl, cl, -cb * sl], [cb, 0.0, -sb]]
}

/// Rotation from north, east, down at an earth-centred position, m, to the earth-centred frame.
///
/// As [`ecef_from_ned`] at [`Ellipsoid::geodetic_of`] within 1e-14, for heights below 20 km, without computing
/// angles: Bowring's iteration with sines and cosines. Longitude 0 at the poles.
pub fn ecef_from_ned_at(ellipsoid: Ellipsoid, ecef_m: Vector) -> Rotation {
    let [x, y, z] = ecef_m;
    let (a, f, e2) = (ellipsoid.semi_major_m, ellipsoid.flattening, ellipsoid.eccentricity_squared());
    let b = a * (1.0 - f);
    let from_axis = (x * x + y * y).sqrt();
    let unit = |sine: f64, cosine: f64| {
        let length = (sine * sine + cosine * cosine).sqrt();
        (sine / length, cosine / length)
    };
    // Of the parametric latitude, then of the geodetic one.
    let (mut sine, mut cosine) = unit(z, from_axis * (1.0 - f));
    let (mut sb, mut cb) = (sine, cosine);
    for _ in 0..2 {
        let up = z + e2 / (1.0 - e2) * b * sine * sine * sine;
        let out = from_axis - e2 * a * cosine * cosine * cosine;
        (sb, cb) = unit(up, out);
        (sine, cosine) = unit((1.0 - f) * up, out);
    }
    let (sl, cl) = if from_axis > 0.0 { (y / from_axis, x / from_axis) } else { (0.0, 1.0) };
    [[-sb * cl, -sl, -cb * cl], [-sb * sl, cl, -cb * sl], [cb, 0.0, -sb]]
}

/// Rotation from east, north, up at a position to the earth-centred frame.
pub(crate) fn ecef_from_enu(latitude_rad: f64, longitude_rad: f64) -> Rotation {
    ecef_from_ned(latitude_rad, longitude_rad).map(|[north, east, down]| [east, north, -down])
}

/// Applies `rotation` to a vector.
pub fn rotate(rotation: &Rotation, v: Vector) -> Vector {
    rotation.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// The rotation `first` followed by `second`.
pub fn then(first: &Rotation, second: &Rotation) -> Rotation {
    let columns = inverse(first).map(|column| rotate(second, column));
    inverse(&columns)
}

/// The inverse rotation: the transpose.
pub fn inverse(rotation: &Rotation) -> Rotation {
    core::array::from_fn(|row| core::array::from_fn(|column| rotation[column][row]))
}

/// Local Cartesian frame: east, north, up, tangential to the ellipsoid's horizon.
///
/// # Examples
///
/// ```
/// use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
/// use wavex_geodesy::frames::LocalFrame;
///
/// let origin = Geodetic { latitude_rad: 0.8, longitude_rad: 0.2, height_m: 500.0 };
/// let above = LocalFrame::at(WGS84, origin).geodetic_of([0.0, 0.0, 20.0]);
/// assert!((above.height_m - 520.0).abs() < 1e-8);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalFrame {
    ellipsoid: Ellipsoid,
    origin_ecef_m: Vector,
    ecef_from_local: Rotation,
}

impl LocalFrame {
    /// The frame with its origin at this position.
    pub fn at(ellipsoid: Ellipsoid, origin: Geodetic) -> LocalFrame {
        LocalFrame {
            ellipsoid,
            origin_ecef_m: ellipsoid.ecef_of(origin),
            ecef_from_local: ecef_from_enu(origin.latitude_rad, origin.longitude_rad),
        }
    }

    /// Rotation from east, north, up at the origin to the earth-centred frame.
    pub fn ecef_from_local(&self) -> &Rotation {
        &self.ecef_from_local
    }

    /// Geodetic coordinates of a point given east, north, up of the origin, m.
    pub fn geodetic_of(&self, local_m: Vector) -> Geodetic {
        let offset = rotate(&self.ecef_from_local, local_m);
        self.ellipsoid.geodetic_of(core::array::from_fn(|axis| self.origin_ecef_m[axis] + offset[axis]))
    }

    /// Local coordinates, east, north, up of the origin, m.
    pub fn local_of(&self, place: Geodetic) -> Vector {
        let ecef_m = self.ellipsoid.ecef_of(place);
        let offset = core::array::from_fn(|axis| ecef_m[axis] - self.origin_ecef_m[axis]);
        rotate(&inverse(&self.ecef_from_local), offset)
    }
}

#[cfg(test)]
mod tests {
    use super::super::ellipsoid::WGS84;
    use super::*;
    use core::f64::consts::FRAC_PI_2;
    use proptest::prelude::*;

    fn near(a: Vector, b: Vector, bound: f64) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < bound)
    }

    /// Forward, right and down of an aircraft for each angle alone.
    #[test]
    fn angles_have_the_signs_of_aviation() {
        let body = |roll_rad, pitch_rad, heading_rad| {
            let rotation = Attitude { roll_rad, pitch_rad, heading_rad }.ned_from_body();
            [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| rotate(&rotation, axis))
        };
        let [_, right, down] = body(FRAC_PI_2, 0.0, 0.0);
        assert!(near(right, [0.0, 0.0, 1.0], 1e-15), "the right wing points down");
        assert!(near(down, [0.0, -1.0, 0.0], 1e-15), "the belly points west");
        let [forward, ..] = body(0.0, FRAC_PI_2, 0.0);
        assert!(near(forward, [0.0, 0.0, -1.0], 1e-15), "the nose points up");
        let [forward, right, _] = body(0.0, 0.0, FRAC_PI_2);
        assert!(near(forward, [0.0, 1.0, 0.0], 1e-15), "the nose points east");
        assert!(near(right, [-1.0, 0.0, 0.0], 1e-15), "the right wing points south");
    }

    #[test]
    fn roll_is_zero_if_the_nose_points_up() {
        let up = Attitude { roll_rad: 0.3, pitch_rad: FRAC_PI_2, heading_rad: 1.0 };
        let found = Attitude::of(&up.ned_from_body());
        assert!(near([found.roll_rad, found.pitch_rad, found.heading_rad], [0.0, FRAC_PI_2, 0.7], 1e-9));
    }

    /// At 0 N 0 E, north is z, east is y, and down points to the centre.
    #[test]
    fn horizons_at_known_positions() {
        let rotation = ecef_from_ned(0.0, 0.0);
        assert_eq!(rotate(&rotation, [1.0, 2.0, 3.0]), [-3.0, 2.0, 1.0]);
        let rotation = ecef_from_enu(0.0, FRAC_PI_2);
        assert!(near(rotate(&rotation, [1.0, 2.0, 3.0]), [-1.0, 3.0, 2.0], 1e-15));
    }

    #[test]
    fn a_local_frame_has_up_along_the_normal() {
        let origin = Geodetic { latitude_rad: 0.83, longitude_rad: 0.22, height_m: 12.0 };
        let frame = LocalFrame::at(WGS84, origin);
        let above = frame.geodetic_of([0.0, 0.0, 1000.0]);
        assert!((above.latitude_rad - 0.83).abs() < 1e-15 && (above.height_m - 1012.0).abs() < 3e-9);
        // A tangent departs from the ellipsoid by half the square of its length over the radius of
        // curvature.
        let aside = frame.geodetic_of([1000.0, 0.0, 0.0]);
        let normal_m = 6_378_137.0 / (1.0 - WGS84.eccentricity_squared() * 0.83f64.sin().powi(2)).sqrt();
        assert!((aside.height_m - 12.0 - 0.5e6 / normal_m).abs() < 1e-6, "{aside:?}");
        assert!(aside.longitude_rad > 0.22 && (aside.latitude_rad - 0.83).abs() < 1e-7);
    }

    proptest! {
        #[test]
        fn the_horizon_at_a_position_needs_no_angles(
            latitude in -FRAC_PI_2..FRAC_PI_2, longitude in -3.2..3.2, height_m in -500.0..20_000.0,
        ) {
            let place = Geodetic { latitude_rad: latitude, longitude_rad: longitude, height_m };
            let found = ecef_from_ned_at(WGS84, WGS84.ecef_of(place));
            for (row, expected) in found.iter().zip(ecef_from_ned(latitude, longitude)) {
                prop_assert!(near(*row, expected, 2e-14), "{row:?} {expected:?}");
            }
        }

        #[test]
        fn attitudes_round_trip(roll in -3.0..3.0, pitch in -1.5..1.5, heading in -3.0..3.0) {
            let attitude = Attitude { roll_rad: roll, pitch_rad: pitch, heading_rad: heading };
            let found = Attitude::of(&attitude.ned_from_body());
            prop_assert!((found.roll_rad - roll).abs() < 1e-13);
            prop_assert!((found.pitch_rad - pitch).abs() < 1e-13);
            prop_assert!((found.heading_rad - heading).abs() < 1e-13);
        }

        #[test]
        fn inverse_rotations_cancel(roll in -3.0..3.0, pitch in -1.5..1.5, yaw in -3.0..3.0, x in -1e3..1e3) {
            let rotation = rotation_of_angles([roll, pitch, yaw]);
            let back = then(&rotation, &inverse(&rotation));
            for (row, unit) in back.iter().zip(IDENTITY) {
                prop_assert!(near(*row, unit, 1e-15));
            }
            let other = ecef_from_ned(pitch, yaw);
            let v = [x, 2.0, -7.0];
            let one_by_one = rotate(&other, rotate(&rotation, v));
            prop_assert!(near(rotate(&then(&rotation, &other), v), one_by_one, 1e-12));
        }

        #[test]
        fn local_coordinates_round_trip(
            latitude in -1.5..1.5, longitude in -3.1..3.1, east in -5e4..5e4, north in -5e4..5e4, up in -1e3..1e4,
        ) {
            let origin = Geodetic { latitude_rad: latitude, longitude_rad: longitude, height_m: 100.0 };
            let frame = LocalFrame::at(WGS84, origin);
            let back = frame.local_of(frame.geodetic_of([east, north, up]));
            prop_assert!(near(back, [east, north, up], 5e-9), "{back:?}");
        }
    }
}
