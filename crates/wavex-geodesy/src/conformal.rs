//! Conformal latitude, shared by the conformal projections, and positions as sines and cosines.
//!
//! Only `+ - * /`, square roots and the crate `libm` are used, so results are bit-identical on
//! every machine.

use super::ellipsoid::{Ellipsoid, Geodetic};
use super::frames::Vector;

/// Direction of the ellipsoid normal as sines and cosines of its angles.
///
/// Projections need these and not the angles themselves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct EllipsoidNormal {
    /// Sine and cosine of the geodetic latitude; the cosine is not negative.
    pub latitude: [f64; 2],
    /// Sine and cosine of the longitude.
    pub longitude: [f64; 2],
}

impl EllipsoidNormal {
    /// Normal at a latitude and longitude, rad.
    pub(crate) fn new(latitude_rad: f64, longitude_rad: f64) -> EllipsoidNormal {
        EllipsoidNormal {
            latitude: libm::sincos(latitude_rad).into(),
            longitude: libm::sincos(longitude_rad).into(),
        }
    }

    /// Normals through earth-centred positions, m, and their heights, m.
    ///
    /// Valid for heights from -1000 km to 10 000 km. On the axis the longitude is 0. Each step
    /// handles all positions, which is faster.
    ///
    /// Bowring 1976, as in [`Ellipsoid::geodetic_of`], with tangents instead of angles; after three
    /// steps the result is exact to double precision.
    pub(crate) fn through<const N: usize>(
        ellipsoid: Ellipsoid,
        ecef_m: &[Vector; N],
    ) -> ([EllipsoidNormal; N], [f64; N]) {
        let (a, f, e2) = (ellipsoid.semi_major_m, ellipsoid.flattening, ellipsoid.eccentricity_squared());
        let (b, second_e2) = (a * (1.0 - f), e2 / (1.0 - e2));
        let [x, y, z]: [[f64; N]; 3] = std::array::from_fn(|axis| std::array::from_fn(|i| ecef_m[i][axis]));
        let (mut from_axis, mut parametric, mut latitude) = ([0.0; N], Angles::<N>::ZERO, Angles::<N>::ZERO);
        let (mut longitude, mut height_m) = (Angles::<N>::ZERO, [0.0; N]);
        for i in 0..N {
            from_axis[i] = (x[i] * x[i] + y[i] * y[i]).sqrt();
            longitude.set(i, unit(y[i], x[i]));
            parametric.set(i, unit(z[i], from_axis[i] * (1.0 - f)));
        }
        for _ in 0..3 {
            for i in 0..N {
                let [sine, cosine] = parametric.get(i);
                let up = z[i] + second_e2 * b * sine * sine * sine;
                let out = from_axis[i] - e2 * a * cosine * cosine * cosine;
                latitude.set(i, [up, out]);
                parametric.set(i, unit((1.0 - f) * up, out));
            }
        }
        for i in 0..N {
            let [up, out] = latitude.get(i);
            let [sine, cosine] = unit(up, out);
            latitude.set(i, [sine, cosine]);
            height_m[i] = from_axis[i] * cosine + z[i] * sine - a * (1.0 - e2 * sine * sine).sqrt();
        }
        let normal = |i| EllipsoidNormal { latitude: latitude.get(i), longitude: longitude.get(i) };
        (std::array::from_fn(normal), height_m)
    }

    /// Tangent of the latitude; large but finite at the poles.
    pub(crate) fn tangent(&self) -> f64 {
        let [sine, cosine] = self.latitude;
        sine / cosine.max(1e-20)
    }

    /// Latitude and longitude, rad; the longitude from -π to π.
    pub(crate) fn angles_rad(&self) -> (f64, f64) {
        (libm::atan2(self.latitude[0], self.latitude[1]), libm::atan2(self.longitude[0], self.longitude[1]))
    }

    /// Sine and cosine of the longitude relative to a meridian, given likewise.
    pub(crate) fn longitude_from(&self, [sine_0, cosine_0]: [f64; 2]) -> [f64; 2] {
        let [sine, cosine] = self.longitude;
        [sine * cosine_0 - cosine * sine_0, cosine * cosine_0 + sine * sine_0]
    }
}

impl From<Geodetic> for EllipsoidNormal {
    fn from(place: Geodetic) -> EllipsoidNormal {
        EllipsoidNormal::new(place.latitude_rad, place.longitude_rad)
    }
}

/// Sines and cosines of several angles, in columns.
///
/// May be scaled; the layout allows vectorised loops.
struct Angles<const N: usize> {
    sines: [f64; N],
    cosines: [f64; N],
}

impl<const N: usize> Angles<N> {
    const ZERO: Angles<N> = Angles { sines: [0.0; N], cosines: [0.0; N] };

    #[inline(always)]
    fn get(&self, i: usize) -> [f64; 2] {
        [self.sines[i], self.cosines[i]]
    }

    #[inline(always)]
    fn set(&mut self, i: usize, [sine, cosine]: [f64; 2]) {
        self.sines[i] = sine;
        self.cosines[i] = cosine;
    }
}

/// Sine and cosine of the angle of a vector; the null vector has the angle 0.
#[inline(always)]
fn unit(sine: f64, cosine: f64) -> [f64; 2] {
    let length = (sine * sine + cosine * cosine).sqrt();
    if length == 0.0 { [0.0, 1.0] } else { [sine / length, cosine / length] }
}

/// Tangent of the conformal latitude from the tangent of the geographic latitude.
///
/// `eccentricity` is the first eccentricity of the ellipsoid (Karney 2011, J. Geod. 85:475,
/// equations 7 to 9).
pub(crate) fn conformal_tangent(eccentricity: f64, tangent: f64) -> f64 {
    let [conformal] = conformal_tangents(eccentricity, &[tangent]);
    conformal
}

/// [`conformal_tangent`] for several latitudes.
pub(crate) fn conformal_tangents<const N: usize>(eccentricity: f64, tangents: &[f64; N]) -> [f64; N] {
    let secants = tangents.map(|tangent| (1.0 + tangent * tangent).sqrt());
    let mut sigmas: [f64; N] = std::array::from_fn(|i| eccentricity * tangents[i] / secants[i]);
    for sigma in &mut sigmas {
        *sigma = libm::sinh(eccentricity * libm::atanh(*sigma));
    }
    let conformal = |i: usize| tangents[i] * (1.0 + sigmas[i] * sigmas[i]).sqrt() - sigmas[i] * secants[i];
    std::array::from_fn(conformal)
}

/// Inverse of [`conformal_tangent`] by Newton's method; converges in three steps (Karney 2011,
/// equations 19 to 21).
pub(crate) fn geographic_tangent(eccentricity: f64, conformal: f64) -> f64 {
    let e2 = eccentricity * eccentricity;
    let mut tangent = conformal / (1.0 - e2);
    for _ in 0..5 {
        let found = conformal_tangent(eccentricity, tangent);
        let secants = ((1.0 + found * found) * (1.0 + tangent * tangent)).sqrt();
        let step = (conformal - found) * (1.0 + (1.0 - e2) * tangent * tangent) / ((1.0 - e2) * secants);
        tangent += step;
        if step.abs() <= 1e-17 * (1.0 + tangent.abs()) {
            break;
        }
    }
    tangent
}

#[cfg(test)]
mod tests {
    use super::super::ellipsoid::WGS84;
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn positions_on_the_axis_have_normals() {
        for z in [6_356_752.314_245_179f64, -6_356_752.314_245_179] {
            let place_m = [0.0, 0.0, z + 100.0 * z.signum()];
            let ([normal], [height_m]) = EllipsoidNormal::through(WGS84, &[place_m]);
            assert_eq!(normal, EllipsoidNormal { latitude: [z.signum(), 0.0], longitude: [0.0, 1.0] });
            assert!((height_m - 100.0).abs() < 2e-9);
        }
    }

    proptest! {
        #[test]
        fn normals_equal_sines_and_cosines_of_the_angles(
            latitude_rad in -1.57..1.57, longitude_rad in -3.1..3.1, height_m in -1e6..1e7,
        ) {
            let place = Geodetic { latitude_rad, longitude_rad, height_m };
            let ([normal], [found_m]) = EllipsoidNormal::through(WGS84, &[WGS84.ecef_of(place)]);
            let (latitude, longitude) = normal.angles_rad();
            prop_assert!((latitude - latitude_rad).abs() < 1e-15, "{}", latitude - latitude_rad);
            prop_assert!((longitude - longitude_rad).abs() * latitude_rad.cos() < 1e-15);
            prop_assert!((found_m - height_m).abs() < 8e-9, "{}", found_m - height_m);
        }

        #[test]
        fn conformal_latitudes_round_trip(latitude_rad in -1.57..1.57f64) {
            let tangent = latitude_rad.tan();
            let back = geographic_tangent(0.0818, conformal_tangent(0.0818, tangent));
            prop_assert!((back.atan() - latitude_rad).abs() < 1e-15);
        }
    }
}
