//! The height of the sensor above the ground of its own line.

use crate::batch::{Emission, Frame, Return};
use crate::geo::frames::Vector;
use crate::geo::vertical::down_at;

/// The earth's mean radius (IUGG 1980), m.
const RADIUS_M: f64 = 6_371_008.8;

/// Heights near one place: along the vertical there, and by the sphere's fall away from the horizon. Within 5 km of it that
/// differs from heights above the ellipsoid by less than 2 cm, and differences of two heights near each other by less.
pub(super) struct Level {
    place_m: Vector,
    down: Vector,
    /// Half of the curvature, 1/m; 0 in a map.
    half_curvature: f64,
}

impl Level {
    /// The heights of a line; `None` where the frame does not tell what is down.
    pub(super) fn of(frame: Frame, emissions: &[Emission]) -> Option<Level> {
        let place_m = emissions.first()?.origin_m;
        let half_curvature = if frame == Frame::Earth { 0.5 / RADIUS_M } else { 0.0 };
        Some(Level { place_m, down: down_at(frame, place_m)?, half_curvature })
    }

    /// The median height of the sensor above the last returns that are not withheld; `None` where there are none.
    pub(super) fn agl_m(&self, emissions: &[Emission], returns: &[Return], points: &[Vector]) -> Option<f64> {
        let is_ground = |r: &Return| r.return_number == r.number_of_returns && !r.withheld;
        let ground = returns.iter().zip(points).filter(|(r, _)| is_ground(r));
        let mut heights: Vec<f64> = ground
            .map(|(r, &point)| self.height_m(emissions[r.emission as usize].origin_m) - self.height_m(point))
            .collect();
        let middle = heights.len().checked_sub(1)? / 2;
        Some(*heights.select_nth_unstable_by(middle, f64::total_cmp).1)
    }

    /// Over the place, m.
    fn height_m(&self, point_m: Vector) -> f64 {
        let from_place: Vector = std::array::from_fn(|axis| point_m[axis] - self.place_m[axis]);
        let fall: f64 = from_place.iter().zip(self.down).map(|(a, b)| a * b).sum();
        let distance: f64 = from_place.iter().map(|part| part * part).sum();
        self.half_curvature * (distance - fall * fall) - fall
    }
}
