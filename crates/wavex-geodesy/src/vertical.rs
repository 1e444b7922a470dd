//! Vertical direction and height in the frame of an input.

use super::ellipsoid::WGS84;
use super::frames::Vector;

/// Coordinate frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
pub enum Frame {
    /// Scanner frame.
    Scanner,
    /// Body frame of the aircraft: forward, right, down.
    Body,
    /// Projected coordinates in the coordinate reference system of the input.
    Map,
    /// Geocentric (ECEF) metres; used for shots with a trajectory.
    Earth,
}

impl Frame {
    /// Whether coordinates in this frame are positions on the earth.
    pub fn is_georeferenced(self) -> bool {
        matches!(self, Frame::Map | Frame::Earth)
    }
}

/// Unit vector straight down at a position (m in `frame`); `None` for instrument frames.
pub fn down_at(frame: Frame, place_m: Vector) -> Option<Vector> {
    match frame {
        Frame::Map => Some([0.0, 0.0, -1.0]),
        Frame::Earth => {
            let place = WGS84.geodetic_of(place_m);
            let (sin_latitude, cos_latitude) = libm::sincos(place.latitude_rad);
            let (sin_longitude, cos_longitude) = libm::sincos(place.longitude_rad);
            Some([-cos_latitude * cos_longitude, -cos_latitude * sin_longitude, -sin_latitude])
        }
        Frame::Scanner | Frame::Body => None,
    }
}

/// Signed axis nearest to the mean of some directions.
///
/// Serves as down in instrument frames: scanners are mounted in various ways, but look down on
/// average.
pub fn main_axis(directions: impl IntoIterator<Item = Vector>) -> Vector {
    let mut sum = [0.0; 3];
    for direction in directions {
        (0..3).for_each(|axis| sum[axis] += direction[axis]);
    }
    let axis = (0..3).max_by(|&a, &b| sum[a].abs().total_cmp(&sum[b].abs())).unwrap_or(2);
    let mut down = [0.0; 3];
    down[axis] = if sum[axis] < 0.0 { -1.0 } else { 1.0 };
    down
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ellipsoid::Geodetic;

    #[test]
    fn moving_down_reduces_the_height() {
        for (latitude_rad, longitude_rad) in [(0.0, 0.0), (0.8, 0.2), (-0.6, 2.9), (1.5, -1.2)] {
            let place_m = WGS84.ecef_of(Geodetic { latitude_rad, longitude_rad, height_m: 900.0 });
            let down = down_at(Frame::Earth, place_m).unwrap();
            let below = std::array::from_fn(|axis| place_m[axis] + 100.0 * down[axis]);
            assert!((WGS84.geodetic_of(below).height_m - 800.0).abs() < 1e-6);
        }
        assert_eq!(down_at(Frame::Map, [5e5, 5e6, 100.0]), Some([0.0, 0.0, -1.0]));
        assert_eq!([Frame::Body, Frame::Scanner].map(|frame| down_at(frame, [0.0; 3])), [None; 2]);
    }
}
