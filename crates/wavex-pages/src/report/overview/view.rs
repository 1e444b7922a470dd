//! Projection of points to map coordinates.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_line::scan_line::InputInfo;

/// Name of a coordinate reference system: the first string in its WKT.
pub(crate) fn crs_name(wkt: &str) -> String {
    wkt.split('"').nth(1).filter(|name| !name.is_empty()).unwrap_or("unnamed").to_owned()
}

/// Coordinates of a map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum MapAxes {
    /// The first two coordinates of the points.
    Coordinates,
    /// The same, in degrees of longitude and latitude.
    Degrees,
    /// East and north, m, for geocentric points: in a plane tangential to the sphere near the first
    /// point.
    Plane,
}

/// Conversion of coordinates to map positions.
#[derive(Clone, Debug)]
pub(crate) enum MapProjection {
    Map { axes: MapAxes, unit: &'static str },
    Plane { origin: [f64; 3], axes: [[f64; 3]; 3] },
}

/// Distance of ground points from the centre of the earth, m.
const EARTH_M: [f64; 2] = [6.33e6, 6.39e6];
/// Upper limit of projected heights, m; geocentric z values are below it only near the equator.
const MAP_HEIGHT_M: f64 = 1e5;
/// Length of a degree on the sphere, m: areas are accurate to 1 %.
const DEGREE_M: f64 = 111_195.0;
/// Length of a foot, m; the US survey foot differs by 2e-6.
const FOOT_M: f64 = 0.3048;
/// Spacing of the possible tangent points, m, so that all points of a place share one.
const PLANES_M: f64 = 20_000.0;

impl MapProjection {
    /// The view for a recording with this point.
    pub(crate) fn of(input: &InputInfo, point: [f64; 3]) -> MapProjection {
        let length = dot(point, point).sqrt();
        if point[2].abs() > MAP_HEIGHT_M && EARTH_M[0] < length && length < EARTH_M[1] {
            return MapProjection::plane(point.map(|coordinate| (coordinate / PLANES_M).round() * PLANES_M));
        }
        let wkt = input.crs_wkt.as_deref().unwrap_or_default();
        // Heights may have another unit.
        let horizontal = wkt.split("VERT").next().unwrap_or_default();
        let has = |words: [&str; 2]| words.iter().any(|word| horizontal.contains(word));
        let degrees = has(["GEOGCS", "GEOGCRS"]) && !has(["PROJCS", "PROJCRS"]);
        match degrees {
            true => MapProjection::Map { axes: MapAxes::Degrees, unit: "°" },
            false if has(["foot", "Foot"]) => MapProjection::Map { axes: MapAxes::Coordinates, unit: "ft" },
            false => MapProjection::Map { axes: MapAxes::Coordinates, unit: "m" },
        }
    }

    fn plane(origin: [f64; 3]) -> MapProjection {
        let up = unit(origin);
        let east = unit([-up[1], up[0], 0.0]);
        let north = [
            up[1] * east[2] - up[2] * east[1],
            up[2] * east[0] - up[0] * east[2],
            up[0] * east[1] - up[1] * east[0],
        ];
        MapProjection::Plane { origin, axes: [east, north, up] }
    }

    /// Map position of a point: east, north, height.
    pub(crate) fn place(&self, point: [f64; 3]) -> [f64; 3] {
        match self {
            MapProjection::Map { .. } => point,
            MapProjection::Plane { origin, axes } => {
                let from_origin = std::array::from_fn(|i| point[i] - origin[i]);
                axes.map(|axis| dot(axis, from_origin))
            }
        }
    }

    pub(crate) fn axes(&self) -> MapAxes {
        match self {
            MapProjection::Map { axes, .. } => *axes,
            MapProjection::Plane { .. } => MapAxes::Plane,
        }
    }

    /// Unit of the east and north coordinates.
    pub(crate) fn unit(&self) -> &'static str {
        match self {
            MapProjection::Map { unit, .. } => unit,
            MapProjection::Plane { .. } => "m",
        }
    }

    /// Length of a unit of the east and the north coordinate at this north coordinate, m.
    pub(crate) fn units_m(&self, north: f64) -> [f64; 2] {
        match (self.axes(), self.unit()) {
            (MapAxes::Degrees, _) => [DEGREE_M * libm::cos(north.to_radians()), DEGREE_M],
            (_, "ft") => [FOOT_M; 2],
            _ => [1.0; 2],
        }
    }

    /// Area of a square unit at this north coordinate, m².
    pub(crate) fn square_unit_m2(&self, north: f64) -> f64 {
        self.units_m(north).into_iter().product()
    }
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Unit vector; at a pole, where east is undefined, the null vector.
fn unit(vector: [f64; 3]) -> [f64; 3] {
    let length = dot(vector, vector).sqrt().max(1e-300);
    vector.map(|component| component / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(wkt: &str, point: [f64; 3]) -> MapProjection {
        MapProjection::of(&InputInfo { crs_wkt: Some(wkt.to_owned()), ..InputInfo::default() }, point)
    }

    #[test]
    fn degrees_follow_from_the_coordinate_system() {
        let axes = |wkt| of(wkt, [11.0, 48.0, 500.0]).axes();
        assert_eq!(axes("GEOGCS[\"WGS 84\"]"), MapAxes::Degrees);
        assert_eq!(axes("COMPD_CS[\"a\",GEOGCS[\"WGS 84\"],VERT_CS[]]"), MapAxes::Degrees);
        assert_eq!(axes("PROJCS[\"UTM\",GEOGCS[\"WGS 84\"]]"), MapAxes::Coordinates);
        assert_eq!(axes(""), MapAxes::Coordinates);
        let unit = |wkt| of(wkt, [2.0e6, 1.0e6, 500.0]).unit();
        let units =
            ["GEOGCS[]", "", "PROJCS[GEOGCS[],UNIT[\"US survey foot\",0.3048]]", "PROJCS[UNIT[\"metre\"]]"];
        assert_eq!(units.map(unit), ["°", "m", "ft", "m"]);
        let heights_in_feet = "COMPD_CS[PROJCS[UNIT[\"metre\"]],VERT_CS[UNIT[\"US survey foot\",0.3048]]]";
        assert_eq!(unit(heights_in_feet), "m");
        let far_north = of("", [500_000.0, 6_340_000.0, 300.0]);
        assert_eq!(far_north.axes(), MapAxes::Coordinates, "a northing is not a distance from the centre");
    }

    /// On the Greenwich meridian, at a latitude whose sine is 0.6: east is y, and north increases z
    /// by 0.8 per unit.
    #[test]
    fn geocentric_points_are_seen_from_above() {
        let ground = [0.8 * 6.36e6, 0.0, 0.6 * 6.36e6];
        let view = of("", ground);
        assert_eq!(view.axes(), MapAxes::Plane);
        let base = view.place(ground);
        let moved = |by: [f64; 3]| {
            let there = view.place(std::array::from_fn(|i| ground[i] + by[i]));
            [0, 1, 2].map(|i| there[i] - base[i])
        };
        let near = |a: [f64; 3], b: [f64; 3]| (0..3).all(|i| (a[i] - b[i]).abs() < 0.2);
        assert!(near(moved([0.0, 100.0, 0.0]), [100.0, 0.0, 0.0]), "{:?}", moved([0.0, 100.0, 0.0]));
        assert!(near(moved([-60.0, 0.0, 80.0]), [0.0, 100.0, 0.0]), "{:?}", moved([-60.0, 0.0, 80.0]));
        assert!(near(moved([80.0, 0.0, 60.0]), [0.0, 0.0, 100.0]), "{:?}", moved([80.0, 0.0, 60.0]));
    }
}
