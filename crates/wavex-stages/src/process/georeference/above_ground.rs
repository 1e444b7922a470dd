//! Height of the sensor above the ground of its line.

use wavex_geodesy::frames::Vector;
use wavex_geodesy::vertical::down_at;
use wavex_line::scan_line::{Emission, Frame, Return};

/// Mean radius of the earth (IUGG 1980), m.
const RADIUS_M: f64 = 6_371_008.8;

/// Heights relative to a reference position.
///
/// They are measured along the vertical there, with a spherical correction for the curvature of the
/// earth. Within 5 km they differ from ellipsoidal heights by less than 2 cm; the difference of two
/// nearby heights is more accurate.
pub(super) struct ReferenceLevel {
    place_m: Vector,
    down: Vector,
    /// Half the curvature, 1/m; 0 in a projected CRS.
    half_curvature: f64,
}

impl ReferenceLevel {
    /// Height reference for a line; `None` if the frame has no vertical.
    pub(super) fn of(frame: Frame, emissions: &[Emission]) -> Option<ReferenceLevel> {
        let place_m = emissions.first()?.origin_m;
        let half_curvature = if frame == Frame::Earth { 0.5 / RADIUS_M } else { 0.0 };
        Some(ReferenceLevel { place_m, down: down_at(frame, place_m)?, half_curvature })
    }

    /// Median height of the sensor above the last returns that are not withheld; `None` without
    /// any.
    pub(super) fn agl_m(&self, emissions: &[Emission], returns: &[Return], points: &[Vector]) -> Option<f64> {
        let is_ground = |r: &Return| r.return_number == r.number_of_returns && !r.withheld;
        let ground = returns.iter().zip(points).filter(|(r, _)| is_ground(r));
        let mut heights: Vec<f64> = ground
            .map(|(r, &point)| self.height_m(emissions[r.emission as usize].origin_m) - self.height_m(point))
            .collect();
        let middle = heights.len().checked_sub(1)? / 2;
        Some(*heights.select_nth_unstable_by(middle, f64::total_cmp).1)
    }

    /// Height above the reference position, m.
    fn height_m(&self, point_m: Vector) -> f64 {
        let from_place: Vector = std::array::from_fn(|axis| point_m[axis] - self.place_m[axis]);
        let fall: f64 = from_place.iter().zip(self.down).map(|(a, b)| a * b).sum();
        let distance: f64 = from_place.iter().map(|part| part * part).sum();
        self.half_curvature * (distance - fall * fall) - fall
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_geodesy::ellipsoid::{Geodetic, WGS84};

    fn emission(origin_m: Vector) -> Emission {
        Emission { origin_m, ..Emission::default() }
    }

    #[test]
    fn heights_near_a_place_are_those_above_the_ellipsoid() {
        for (latitude_rad, longitude_rad) in [(0.0, 0.3), (0.83, 0.22), (-1.4, -2.0)] {
            let ecef_m = |north_m: f64, east_m: f64, height_m| {
                let (latitude_rad, longitude_rad) = (
                    latitude_rad + north_m / 6.37e6,
                    longitude_rad + east_m / (6.38e6 * f64::cos(latitude_rad)),
                );
                WGS84.ecef_of(Geodetic { latitude_rad, longitude_rad, height_m })
            };
            let level = ReferenceLevel::of(Frame::Earth, &[emission(ecef_m(0.0, 0.0, 3000.0))]).unwrap();
            for (north_m, east_m) in [(0.0, 0.0), (5000.0, 0.0), (-3000.0, 4000.0), (0.0, -5000.0)] {
                let [high, low] =
                    [2500.0, 100.0].map(|height_m| level.height_m(ecef_m(north_m, east_m, height_m)));
                assert!((high + 500.0).abs() < 0.02, "{latitude_rad} {north_m} {east_m}: {high}");
                assert!(
                    (high - low - 2400.0).abs() < 0.005,
                    "{latitude_rad} {north_m} {east_m}: {high} {low}"
                );
            }
        }
    }

    /// The second of three shots has two returns; the return of the third is withheld.
    #[test]
    fn the_ground_is_what_shots_end_at() {
        let emissions = [0.0, 1.0, 2.0].map(|x| emission([x, 0.0, 1000.0]));
        let found = |emission, numbers: [u8; 2], withheld| {
            let [return_number, number_of_returns] = numbers;
            Return { withheld, return_number, number_of_returns, emission, ..Return::default() }
        };
        let returns = [
            found(0, [1, 1], false),
            found(1, [1, 2], false),
            found(1, [2, 2], false),
            found(2, [1, 1], true),
        ];
        let points = [100.0, 130.0, 90.0, -500.0].map(|z| [0.0, 0.0, z]);
        let level = ReferenceLevel::of(Frame::Map, &emissions).unwrap();
        assert_eq!(level.agl_m(&emissions, &returns, &points), Some(900.0), "the lower of two middles");
        assert_eq!(level.agl_m(&emissions, &returns[3..], &points[3..]), None);
        assert!(
            ReferenceLevel::of(Frame::Scanner, &emissions).is_none()
                && ReferenceLevel::of(Frame::Map, &[]).is_none()
        );
    }
}
