//! Transverse Mercator projection, including UTM.
//!
//! Krüger series to the sixth order of the third flattening, as in Karney 2011, "Transverse
//! Mercator with an accuracy of a few nanometers", J. Geod. 85:475-485. The error of the series is
//! below 5 nm within 4000 km of the central meridian. Only `+ - * /`, square roots and the crate
//! `libm` are used, so results are bit-identical on every machine.

use super::conformal::{EllipsoidNormal, conformal_tangents, geographic_tangent};
use super::ellipsoid::Ellipsoid;

/// Transverse Mercator projection of an ellipsoid.
///
/// # Examples
///
/// ```
/// use wavex_geodesy::ellipsoid::WGS84;
/// use wavex_geodesy::transverse_mercator::{TransverseMercator, TransverseMercatorParameters};
///
/// let zone_33 = TransverseMercator::new(WGS84, TransverseMercatorParameters::utm(33, true));
/// let (easting_m, _) = zone_33.project(48_f64.to_radians(), 15_f64.to_radians());
/// assert_eq!(easting_m, 500_000.0);
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct TransverseMercator {
    central_meridian_rad: f64,
    /// Sine and cosine of the central meridian.
    central_meridian: [f64; 2],
    false_easting_m: f64,
    false_northing_m: f64,
    /// Scale factor on the central meridian times the rectifying radius, m.
    radius_m: f64,
    eccentricity: f64,
    forward: [f64; 6],
    inverse: [f64; 6],
    /// Projected northing of the latitude of origin minus the false northing, m.
    origin_m: f64,
}

/// Parameters of a transverse Mercator projection (EPSG method 9807).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TransverseMercatorParameters {
    /// Latitude of the false northing, rad.
    pub latitude_of_origin_rad: f64,
    /// Central meridian, along which the scale is constant, rad.
    pub central_meridian_rad: f64,
    /// Scale factor on the central meridian.
    pub scale: f64,
    /// Easting on the central meridian, m.
    pub false_easting_m: f64,
    /// Northing at the latitude of origin, m.
    pub false_northing_m: f64,
}

impl TransverseMercatorParameters {
    /// Parameters of a UTM zone, 1 to 60; `north`: northern hemisphere.
    pub fn utm(zone: u8, north: bool) -> TransverseMercatorParameters {
        TransverseMercatorParameters {
            latitude_of_origin_rad: 0.0,
            central_meridian_rad: (6.0 * f64::from(zone) - 183.0).to_radians(),
            scale: 0.9996,
            false_easting_m: 500_000.0,
            false_northing_m: if north { 0.0 } else { 10_000_000.0 },
        }
    }
}

impl TransverseMercator {
    /// Creates the projection of an ellipsoid.
    pub fn new(ellipsoid: Ellipsoid, parameters: TransverseMercatorParameters) -> TransverseMercator {
        let n = ellipsoid.flattening / (2.0 - ellipsoid.flattening);
        let n2 = n * n;
        let rectifying_m = ellipsoid.semi_major_m / (1.0 + n)
            * (1.0 + n2 * (1.0 / 4.0 + n2 * (1.0 / 64.0 + n2 * (1.0 / 256.0))));
        let mut projection = TransverseMercator {
            central_meridian_rad: parameters.central_meridian_rad,
            central_meridian: libm::sincos(parameters.central_meridian_rad).into(),
            false_easting_m: parameters.false_easting_m,
            false_northing_m: parameters.false_northing_m,
            radius_m: parameters.scale * rectifying_m,
            eccentricity: ellipsoid.eccentricity_squared().sqrt(),
            forward: series(n, &FORWARD),
            inverse: series(n, &INVERSE),
            origin_m: 0.0,
        };
        let (_, northing_m) =
            projection.project(parameters.latitude_of_origin_rad, parameters.central_meridian_rad);
        projection.origin_m = northing_m - parameters.false_northing_m;
        projection
    }

    /// Whether coordinates are in the valid area of the series.
    ///
    /// That is within 4000 km of the central meridian, and not far beyond the poles.
    pub(crate) fn reaches(&self, easting_m: f64, northing_m: f64) -> bool {
        let from_equator_m = northing_m - self.false_northing_m + self.origin_m;
        (easting_m - self.false_easting_m).abs() < 4e6 && from_equator_m.abs() < 1.2e7
    }

    /// Easting and northing, m, of a latitude and longitude, rad.
    pub fn project(&self, latitude_rad: f64, longitude_rad: f64) -> (f64, f64) {
        self.project_normal(&EllipsoidNormal::new(latitude_rad, longitude_rad))
    }

    /// Easting and northing, m, of a position.
    pub(crate) fn project_normal(&self, normal: &EllipsoidNormal) -> (f64, f64) {
        let [coordinates] = self.project_each(&[*normal]);
        coordinates
    }

    /// Eastings and northings, m, of several positions (Karney 2011, equations 7 to 11).
    ///
    /// Each step handles all positions. The harmonics need only the sines of the angles xi and eta,
    /// which are known before the angles.
    pub(crate) fn project_each<const N: usize>(&self, normals: &[EllipsoidNormal; N]) -> [(f64, f64); N] {
        let conformal =
            conformal_tangents(self.eccentricity, &normals.each_ref().map(EllipsoidNormal::tangent));
        let (mut cosines, mut across) = ([0.0; N], [0.0; N]);
        let (mut xi, mut eta) = ([[0.0; N]; 2], [[0.0; N]; 2]);
        for i in 0..N {
            let [sine, cosine] = normals[i].longitude_from(self.central_meridian);
            let length = (conformal[i] * conformal[i] + cosine * cosine).sqrt();
            cosines[i] = cosine;
            across[i] = sine / length;
            (xi[0][i], xi[1][i]) = (conformal[i] / length, cosine / length);
            (eta[0][i], eta[1][i]) = (across[i], (1.0 + across[i] * across[i]).sqrt());
        }
        let (north, east) = harmonics(&self.forward, xi, eta);
        std::array::from_fn(|i| {
            let xi = libm::atan2(conformal[i], cosines[i]);
            let eta = libm::asinh(across[i]);
            (
                self.false_easting_m + self.radius_m * (eta + east[i]),
                self.false_northing_m - self.origin_m + self.radius_m * (xi + north[i]),
            )
        })
    }

    /// Latitude and longitude, rad, of easting and northing, m (Karney 2011, equations 15 to 21).
    ///
    /// The longitude is continuous from the central meridian, without a jump at 180 degrees.
    pub fn unproject(&self, easting_m: f64, northing_m: f64) -> (f64, f64) {
        let xi = (northing_m - self.false_northing_m + self.origin_m) / self.radius_m;
        let eta = (easting_m - self.false_easting_m) / self.radius_m;
        let (sinh, cosh) = (libm::sinh(eta), libm::cosh(eta));
        let (sine, cosine) = libm::sincos(xi);
        let ([north], [east]) = harmonics(&self.inverse, [[sine], [cosine]], [[sinh], [cosh]]);
        let (sine, cosine) = libm::sincos(xi - north);
        let across = libm::sinh(eta - east);
        let conformal = sine / (across * across + cosine * cosine).sqrt();
        let longitude_rad = self.central_meridian_rad + libm::atan2(across, cosine);
        (libm::atan(geographic_tangent(self.eccentricity, conformal)), longitude_rad)
    }
}

/// Coefficients of Karney's equation 35 by order of the harmonic: factors of n^j, n^(j+1), ... n^6.
const FORWARD: [&[f64]; 6] = [
    &[1.0 / 2.0, -2.0 / 3.0, 5.0 / 16.0, 41.0 / 180.0, -127.0 / 288.0, 7891.0 / 37_800.0],
    &[13.0 / 48.0, -3.0 / 5.0, 557.0 / 1440.0, 281.0 / 630.0, -1_983_433.0 / 1_935_360.0],
    &[61.0 / 240.0, -103.0 / 140.0, 15_061.0 / 26_880.0, 167_603.0 / 181_440.0],
    &[49_561.0 / 161_280.0, -179.0 / 168.0, 6_601_661.0 / 7_257_600.0],
    &[34_729.0 / 80_640.0, -3_418_889.0 / 1_995_840.0],
    &[212_378_941.0 / 319_334_400.0],
];

/// Coefficients of Karney's equation 36.
const INVERSE: [&[f64]; 6] = [
    &[1.0 / 2.0, -2.0 / 3.0, 37.0 / 96.0, -1.0 / 360.0, -81.0 / 512.0, 96_199.0 / 604_800.0],
    &[1.0 / 48.0, 1.0 / 15.0, -437.0 / 1440.0, 46.0 / 105.0, -1_118_711.0 / 3_870_720.0],
    &[17.0 / 480.0, -37.0 / 840.0, -209.0 / 4480.0, 5569.0 / 90_720.0],
    &[4397.0 / 161_280.0, -11.0 / 504.0, -830_251.0 / 7_257_600.0],
    &[4583.0 / 161_280.0, -108_847.0 / 3_991_680.0],
    &[20_648_693.0 / 638_668_800.0],
];

/// Factors of the harmonics for a third flattening.
fn series(n: f64, coefficients: &[&[f64]; 6]) -> [f64; 6] {
    let mut power = 1.0;
    coefficients.map(|factors| {
        power *= n;
        power * factors.iter().rev().fold(0.0, |sum, factor| sum * n + factor)
    })
}

/// Sums of `c_j sin(2j xi) cosh(2j eta)` and `c_j cos(2j xi) sinh(2j eta)`.
///
/// These are the real and imaginary parts of the sum of `c_j sin(2j (xi + i eta))`, by Clenshaw's
/// recurrence in complex numbers. Arguments are the sine and cosine of `xi` and the hyperbolic sine
/// and cosine of `eta`.
fn harmonics<const N: usize>(
    coefficients: &[f64; 6],
    [sin, cos]: [[f64; N]; 2],
    [sinh, cosh]: [[f64; N]; 2],
) -> ([f64; N], [f64; N]) {
    let (mut real, mut imaginary) = ([0.0; N], [0.0; N]);
    let (mut sine_real, mut sine_imaginary) = ([0.0; N], [0.0; N]);
    for i in 0..N {
        let (sin_2, cos_2) = (2.0 * sin[i] * cos[i], (cos[i] - sin[i]) * (cos[i] + sin[i]));
        let (sinh_2, cosh_2) = (2.0 * sinh[i] * cosh[i], 1.0 + 2.0 * sinh[i] * sinh[i]);
        // Twice the cosine of the doubled angle.
        (real[i], imaginary[i]) = (2.0 * cos_2 * cosh_2, -2.0 * sin_2 * sinh_2);
        (sine_real[i], sine_imaginary[i]) = (sin_2 * cosh_2, cos_2 * sinh_2);
    }
    let (mut last, mut before) = ([[0.0; N]; 2], [[0.0; N]; 2]);
    for coefficient in coefficients.iter().rev() {
        for i in 0..N {
            let next = [
                coefficient + real[i] * last[0][i] - imaginary[i] * last[1][i] - before[0][i],
                real[i] * last[1][i] + imaginary[i] * last[0][i] - before[1][i],
            ];
            (before[0][i], before[1][i]) = (last[0][i], last[1][i]);
            (last[0][i], last[1][i]) = (next[0], next[1]);
        }
    }
    let north = |i: usize| last[0][i] * sine_real[i] - last[1][i] * sine_imaginary[i];
    let east = |i: usize| last[0][i] * sine_imaginary[i] + last[1][i] * sine_real[i];
    (std::array::from_fn(north), std::array::from_fn(east))
}

#[cfg(test)]
mod tests {
    use super::super::ellipsoid::WGS84;
    use super::*;
    use proptest::prelude::*;

    fn utm(central_meridian: f64) -> TransverseMercator {
        let central_meridian_rad = central_meridian.to_radians();
        TransverseMercator::new(
            WGS84,
            TransverseMercatorParameters {
                central_meridian_rad,
                ..TransverseMercatorParameters::utm(31, true)
            },
        )
    }

    /// The projection as the complex continuation of the meridian arc length, integrated in 40
    /// digits.
    #[test]
    fn positions_project_to_reference_coordinates() {
        let cases = [
            ((0.0, 0.0, 0.0), (500_000.0, 0.0)),
            ((45.0, 3.0, 0.0), (736_446.026_101_208, 4_987_329.504_698_915)),
            ((47.83, 12.6, 15.0), (320_388.538_295_350, 5_300_194.552_707_259)),
            ((60.0, 3.5, 0.0), (695_161.172_731_225, 6_656_575.859_115_896)),
            ((84.0, -3.0, 0.0), (465_005.344_938_864, 9_329_005.182_447_436)),
            ((-33.9, 151.2, 153.0), (333_568.941_011_554, -3_752_526.663_155_982)),
            ((1.0, -3.0, 0.0), (166_072.062_903_676, 110_682.837_758_791)),
            ((70.0, 18.0, 15.0), (614_473.714_745_798, 7_768_690.108_775_234)),
            ((30.0, -10.0, 0.0), (-466_939.692_242_264, 3_361_248.752_300_656)),
        ];
        for ((latitude, longitude, meridian), (easting, northing)) in cases {
            let (x, y) = utm(meridian).project(f64::to_radians(latitude), f64::to_radians(longitude));
            assert!(
                (x - easting).abs() < 3e-9 && (y - northing).abs() < 3e-9,
                "{x} {y}: {easting} {northing}"
            );
        }
    }

    #[test]
    fn zones_have_their_meridians_and_their_false_origins() {
        let south = TransverseMercator::new(WGS84, TransverseMercatorParameters::utm(56, false));
        let (x, y) = south.project((-33.9f64).to_radians(), 151.2f64.to_radians());
        assert!((x - 333_568.941_011_554).abs() < 3e-9 && (y - 6_247_473.336_844_018).abs() < 3e-9);
        let degrees = [1, 33, 60]
            .map(|zone| TransverseMercatorParameters::utm(zone, true).central_meridian_rad.to_degrees());
        assert!(degrees.iter().zip([-177.0, 15.0, 177.0]).all(|(a, b): (&f64, f64)| (a - b).abs() < 1e-12));
    }

    /// The northing counts from the latitude of origin.
    #[test]
    fn the_latitude_of_origin_has_the_false_northing() {
        let parameters = TransverseMercatorParameters {
            latitude_of_origin_rad: 0.9,
            central_meridian_rad: -0.03,
            scale: 0.999_601_271_7,
            false_easting_m: 400_000.0,
            false_northing_m: -100_000.0,
        };
        let map = TransverseMercator::new(WGS84, parameters);
        let (x, y) = map.project(0.9, -0.03);
        assert!((x - 400_000.0).abs() < 1e-9 && (y + 100_000.0).abs() < 2e-9, "{x} {y}");
        let (latitude, longitude) = map.unproject(x, y);
        assert!((latitude - 0.9).abs() < 1e-15 && (longitude + 0.03).abs() < 1e-15);
    }

    proptest! {
        #[test]
        fn places_come_back(latitude in -1.5..1.5, longitude in -0.2..0.2) {
            let map = utm(0.0);
            let (x, y) = map.project(latitude, longitude);
            let (back, along) = map.unproject(x, y);
            let east_m = (along - longitude) * 6.4e6 * latitude.cos();
            prop_assert!((back - latitude).abs() * 6.4e6 < 5e-9, "{} m", (back - latitude) * 6.4e6);
            prop_assert!(east_m.abs() < 5e-9, "{} m", east_m);
        }
    }
}
