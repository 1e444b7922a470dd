//! Lambert conformal conic projection with one or two standard parallels.
//!
//! Snyder 1987, "Map projections: a working manual", USGS Professional Paper 1395, equations 15-1
//! to 15-11, with the isometric latitude instead of its exponential. Used by most state planes.
//! Only `+ - * /`, square roots and the crate `libm` are used, so results are bit-identical on
//! every machine.

use super::conformal::{EllipsoidNormal, conformal_tangent, geographic_tangent};
use super::ellipsoid::Ellipsoid;

/// Lambert conformal conic projection of an ellipsoid.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct LambertConformal {
    central_meridian_rad: f64,
    /// Sine and cosine of the central meridian.
    central_meridian: [f64; 2],
    false_easting_m: f64,
    false_northing_m: f64,
    eccentricity: f64,
    /// Cone constant: polar angle in projection over longitude difference; negative if the cone
    /// opens to the north.
    cone: f64,
    /// Isometric latitude of the first standard parallel.
    psi_1: f64,
    /// Projected radius of the first standard parallel, m, with the sign of the cone.
    radius_1_m: f64,
    /// Projected radius of the latitude of origin, m.
    origin_m: f64,
}

/// Parameters of a Lambert conformal conic projection (EPSG methods 9801 and 9802).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct LambertParameters {
    /// Standard parallels, rad, along which the scale is constant; equal for one parallel.
    pub standard_parallels_rad: [f64; 2],
    /// Latitude of the false northing, rad.
    pub latitude_of_origin_rad: f64,
    /// Meridian that runs straight north in the projection, rad.
    pub central_meridian_rad: f64,
    /// Scale factor on the standard parallels.
    pub scale: f64,
    /// Easting on the central meridian, m.
    pub false_easting_m: f64,
    /// Northing at the latitude of origin on the central meridian, m.
    pub false_northing_m: f64,
}

impl LambertConformal {
    /// Creates the projection; `None` for parameters that define no cone.
    ///
    /// These are standard parallels at the same distance on both sides of the equator, or at a
    /// pole.
    pub(crate) fn new(ellipsoid: Ellipsoid, parameters: LambertParameters) -> Option<LambertConformal> {
        let e2 = ellipsoid.eccentricity_squared();
        let eccentricity = e2.sqrt();
        let [first_rad, second_rad] = parameters.standard_parallels_rad;
        let psi = |latitude_rad: f64| isometric(eccentricity, libm::tan(latitude_rad));
        // Radius of a parallel over the semi-major axis (Snyder 1987, equation 14-15).
        let parallel = |latitude_rad: f64| {
            let (sine, cosine) = libm::sincos(latitude_rad);
            cosine / (1.0 - e2 * sine * sine).sqrt()
        };
        let cone = if (first_rad - second_rad).abs() < 1e-10 {
            libm::sin(first_rad)
        } else {
            (libm::log(parallel(first_rad)) - libm::log(parallel(second_rad)))
                / (psi(second_rad) - psi(first_rad))
        };
        let sound = [first_rad, second_rad, parameters.latitude_of_origin_rad]
            .iter()
            .all(|latitude_rad| latitude_rad.abs() <= core::f64::consts::FRAC_PI_2);
        let radius_1_m = ellipsoid.semi_major_m * parameters.scale * parallel(first_rad) / cone;
        if !sound || !radius_1_m.is_finite() || cone.abs() < 1e-10 || parallel(first_rad) < 1e-10 {
            return None;
        }
        let mut projection = LambertConformal {
            central_meridian_rad: parameters.central_meridian_rad,
            central_meridian: libm::sincos(parameters.central_meridian_rad).into(),
            false_easting_m: parameters.false_easting_m,
            false_northing_m: parameters.false_northing_m,
            eccentricity,
            cone,
            psi_1: psi(first_rad),
            radius_1_m,
            origin_m: 0.0,
        };
        projection.origin_m = projection.radius_m(libm::tan(parameters.latitude_of_origin_rad));
        projection.origin_m.is_finite().then_some(projection)
    }

    /// Easting and northing, m, of a position; not finite at the pole on the open side of the cone.
    pub(crate) fn project_normal(&self, normal: &EllipsoidNormal) -> (f64, f64) {
        let radius_m = self.radius_m(normal.tangent());
        let [sine, cosine] = normal.longitude_from(self.central_meridian);
        let (sine, cosine) = libm::sincos(self.cone * libm::atan2(sine, cosine));
        (self.false_easting_m + radius_m * sine, self.false_northing_m + self.origin_m - radius_m * cosine)
    }

    /// Latitude and longitude, rad, of easting and northing, m; the longitude is continuous from
    /// the central meridian.
    pub(crate) fn unproject(&self, easting_m: f64, northing_m: f64) -> (f64, f64) {
        let east = easting_m - self.false_easting_m;
        let south = self.origin_m - (northing_m - self.false_northing_m);
        let sign = self.cone.signum();
        let radius_m = sign * (east * east + south * south).sqrt();
        let psi = self.psi_1 - libm::log(radius_m / self.radius_1_m) / self.cone;
        let longitude_rad = self.central_meridian_rad + libm::atan2(sign * east, sign * south) / self.cone;
        (libm::atan(geographic_tangent(self.eccentricity, libm::sinh(psi))), longitude_rad)
    }

    /// Projected radius, m, of the parallel with this latitude tangent, with the sign of the cone.
    fn radius_m(&self, tangent: f64) -> f64 {
        let psi = isometric(self.eccentricity, tangent);
        self.radius_1_m * libm::exp(-self.cone * (psi - self.psi_1))
    }
}

/// Isometric latitude from the tangent of the geographic latitude (Karney 2011, J. Geod. 85:475,
/// equation 3).
fn isometric(eccentricity: f64, tangent: f64) -> f64 {
    libm::asinh(conformal_tangent(eccentricity, tangent))
}

#[cfg(test)]
mod tests {
    use super::super::ellipsoid::GRS80;
    use super::*;
    use proptest::prelude::*;

    fn map(
        parallels: [f64; 2],
        origin: f64,
        meridian: f64,
        scale: f64,
        false_m: [f64; 2],
    ) -> LambertConformal {
        let parameters = LambertParameters {
            standard_parallels_rad: parallels.map(f64::to_radians),
            latitude_of_origin_rad: origin.to_radians(),
            central_meridian_rad: meridian.to_radians(),
            scale,
            false_easting_m: false_m[0],
            false_northing_m: false_m[1],
        };
        LambertConformal::new(GRS80, parameters).unwrap()
    }

    fn france() -> LambertConformal {
        map([49.0, 44.0], 46.5, 3.0, 1.0, [700_000.0, 6_600_000.0])
    }

    fn australia() -> LambertConformal {
        map([-18.0, -36.0], 0.0, 134.0, 1.0, [0.0, 0.0])
    }

    fn one_parallel() -> LambertConformal {
        map([45.9, 45.9], 45.9, 2.5, 0.999_877_42, [600_000.0, 2_200_000.0])
    }

    /// Snyder's formulas in 40 digits.
    #[test]
    fn positions_project_to_reference_coordinates() {
        let cases = [
            (france(), 48.8, 2.3, 648_583.262_125_228_5, 6_855_774.715_696_833),
            (france(), 41.4, 9.5, 1_244_531.122_920_276_4, 6_055_557.061_014_082),
            (france(), 51.0, -4.9, 145_147.920_221_259_31, 7_128_243.551_178_122),
            (australia(), -33.9, 151.2, 1_577_678.253_395_134_6, -3_926_223.221_142_613_3),
            (australia(), -12.4, 113.9, -2_219_204.950_023_658, -1_624_791.529_963_304_3),
            (australia(), -43.6, 134.0, 0.0, -4_906_328.524_196_951),
            (one_parallel(), 45.9, 2.5, 600_000.0, 2_200_000.0),
            (one_parallel(), 42.3, -1.7, 253_200.543_452_570_45, 1_808_909.626_506_510_4),
            (one_parallel(), 49.1, 7.9, 994_612.521_485_960_3, 2_569_280.644_402_324),
        ];
        for (map, latitude, longitude, easting, northing) in cases {
            let (x, y) = map
                .project_normal(&EllipsoidNormal::new(f64::to_radians(latitude), f64::to_radians(longitude)));
            assert!(
                (x - easting).abs() < 1e-8 && (y - northing).abs() < 1e-8,
                "{x} {y}: {easting} {northing}"
            );
        }
    }

    #[test]
    fn parallels_without_a_cone_are_rejected() {
        for parallels in [[30.0, -30.0], [0.0, 0.0], [90.0, 40.0], [f64::NAN, 3.0], [100.0, 3.0]] {
            let parameters = LambertParameters {
                standard_parallels_rad: parallels.map(f64::to_radians),
                latitude_of_origin_rad: 0.0,
                central_meridian_rad: 0.0,
                scale: 1.0,
                false_easting_m: 0.0,
                false_northing_m: 0.0,
            };
            assert_eq!(LambertConformal::new(GRS80, parameters), None, "{parallels:?}");
        }
    }

    proptest! {
        #[test]
        fn places_come_back(latitude in 0.1..1.4f64, longitude in -1.0..1.0f64) {
            for (map, sign) in [(france(), 1.0f64), (australia(), -1.0), (one_parallel(), 1.0)] {
                let longitude = map.central_meridian_rad + longitude;
                let (x, y) = map.project_normal(&EllipsoidNormal::new(sign * latitude, longitude));
                let (back, along) = map.unproject(x, y);
                prop_assert!((back - sign * latitude).abs() * 6.4e6 < 1e-8, "{} m", (back - sign * latitude) * 6.4e6);
                prop_assert!((along - longitude).abs() * 6.4e6 < 1e-8, "{} m", (along - longitude) * 6.4e6);
            }
        }
    }
}
