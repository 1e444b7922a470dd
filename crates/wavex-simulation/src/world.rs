//! Position of the scene on the earth, and the trajectory of a flight over it.
//!
//! The scene is a local Cartesian frame: x to the right of the track, y along it, z up, in metres,
//! with the start of the flight at [`START_M`]. There are two ways to place it on the earth.
//!
//! * **Map**: the scene *is* the map. Rotated by the heading about the start, its coordinates are
//!   easting and northing in UTM zone 33 north, and height above the ellipsoid. Beams are straight
//!   in the map, where the scale at the start is 1.
//! * **Earth**: the scene is a Cartesian east-north-up frame tangent to the ellipsoid of WGS 84 at
//!   the start's geodetic position, rotated by the heading about the vertical there. All else
//!   follows from closed formulas. The trajectory is the body's geodetic position and its attitude
//!   relative to the local horizon. Map coordinates of a point are in the transverse Mercator
//!   projection, and its height is ellipsoidal. The start can be moved to any other position, and
//!   the UTM zone is the zone of the start. Level ground is the plane of the horizon at the start: it
//!   rises above the ellipsoid with the square of the distance, by 78 mm at 1 km.

use super::platform::Platform;
use wavex_geodesy::ellipsoid::Geodetic;
use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::frames::{
    Attitude, LocalFrame, Rotation, ecef_from_ned, inverse, rotate, rotation_of_angles, then,
};
use wavex_geodesy::transverse_mercator::{TransverseMercator, TransverseMercatorParameters};

pub use super::start::{GROUND_HEIGHT_M, START_M};

/// CRS of `START_M`: WGS 84 / UTM zone 33N (EPSG:32633) as WKT 1 (OGC 01-009).
pub const CRS_WKT: &str = concat!(
    r#"PROJCS["WGS 84 / UTM zone 33N",GEOGCS["WGS 84",DATUM["WGS_1984","#,
    r#"SPHEROID["WGS 84",6378137,298.257223563,AUTHORITY["EPSG","7030"]],AUTHORITY["EPSG","6326"]],"#,
    r#"PRIMEM["Greenwich",0,AUTHORITY["EPSG","8901"]],"#,
    r#"UNIT["degree",0.0174532925199433,AUTHORITY["EPSG","9122"]],AUTHORITY["EPSG","4326"]],"#,
    r#"PROJECTION["Transverse_Mercator"],PARAMETER["latitude_of_origin",0],"#,
    r#"PARAMETER["central_meridian",15],PARAMETER["scale_factor",0.9996],"#,
    r#"PARAMETER["false_easting",500000],PARAMETER["false_northing",0],"#,
    r#"UNIT["metre",1,AUTHORITY["EPSG","9001"]],AXIS["Easting",EAST],AXIS["Northing",NORTH],"#,
    r#"AUTHORITY["EPSG","32633"]]"#,
);

/// Position of the scene on the earth.
///
/// # Examples
///
/// ```
/// use wavex_simulation::world::{START_M, World};
///
/// let [x, y] = START_M;
/// let [easting_m, northing_m, height_m] = World::new(0.0).on_earth([x, y, 400.0]);
/// assert!((easting_m - x).abs() < 1e-6 && (northing_m - y).abs() < 1e-6);
/// assert!((height_m - 400.0).abs() < 1e-6);
/// ```
#[derive(Clone, Debug)]
pub struct World {
    heading_rad: f64,
    /// Sine and cosine of the heading.
    turn: [f64; 2],
    frame: LocalFrame,
    map: TransverseMercator,
}

/// Position and attitude in a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GeodeticPose {
    /// Centre of the body.
    pub place: Geodetic,
    /// Attitude of the body relative to the local horizon.
    pub attitude: Attitude,
    /// Velocity north, east and down in the local frame, m/s.
    pub velocity_mps: [f64; 3],
}

impl World {
    /// A scene whose track has this heading, rad, clockwise from north.
    pub fn new(heading_rad: f64) -> World {
        let map = TransverseMercator::new(WGS84, TransverseMercatorParameters::utm(33, true));
        let (latitude_rad, longitude_rad) = map.unproject(START_M[0], START_M[1]);
        World::with(map, [longitude_rad, latitude_rad], heading_rad)
    }

    /// A scene that starts at this longitude and latitude, rad, with the map of the UTM zone there.
    pub fn starting_at(start_rad: [f64; 2], heading_rad: f64) -> World {
        let [longitude_rad, latitude_rad] = start_rad;
        let zone = (longitude_rad.to_degrees() / 6.0).floor() + 31.0;
        let parameters = TransverseMercatorParameters::utm(zone.clamp(1.0, 60.0) as u8, latitude_rad >= 0.0);
        World::with(TransverseMercator::new(WGS84, parameters), start_rad, heading_rad)
    }

    fn with(map: TransverseMercator, [longitude_rad, latitude_rad]: [f64; 2], heading_rad: f64) -> World {
        let origin = Geodetic { latitude_rad, longitude_rad, height_m: 0.0 };
        let (sine, cosine) = libm::sincos(heading_rad);
        World { heading_rad, turn: [sine, cosine], frame: LocalFrame::at(WGS84, origin), map }
    }

    /// Converts a vector of the scene (right, along, up) to east, north, up.
    pub fn turned(&self, [right, along, up]: [f64; 3]) -> [f64; 3] {
        if self.heading_rad == 0.0 {
            return [right, along, up];
        }
        let [sine, cosine] = self.turn;
        [right * cosine + along * sine, along * cosine - right * sine, up]
    }

    /// Converts a point of the scene to the map, if the scene is the map.
    pub fn on_flat_map(&self, point_m: [f64; 3]) -> [f64; 3] {
        if self.heading_rad == 0.0 {
            return point_m;
        }
        let [east, north, up] = self.turned([point_m[0] - START_M[0], point_m[1] - START_M[1], point_m[2]]);
        [START_M[0] + east, START_M[1] + north, up]
    }

    /// Converts a point of the scene to easting, northing and ellipsoidal height.
    pub fn on_earth(&self, point_m: [f64; 3]) -> [f64; 3] {
        let place = self.geodetic_of(point_m);
        let (easting_m, northing_m) = self.map.project(place.latitude_rad, place.longitude_rad);
        [easting_m, northing_m, place.height_m]
    }

    fn geodetic_of(&self, point_m: [f64; 3]) -> Geodetic {
        let [x, y, up] = point_m;
        self.frame.geodetic_of(self.turned([x - START_M[0], y - START_M[1], up]))
    }

    /// Position and attitude of a platform on the earth.
    pub fn pose(&self, platform: &Platform, since_start_s: f64) -> GeodeticPose {
        let place = self.geodetic_of(platform.position_m(since_start_s));
        let ecef_from_ned_here = ecef_from_ned(place.latitude_rad, place.longitude_rad);
        let here_from_start = then(&self.ecef_from_start(), &inverse(&ecef_from_ned_here));
        let start_from_track = rotation_of_angles([0.0, 0.0, self.heading_rad]);
        let here_from_track = then(&start_from_track, &here_from_start);
        let track_from_body = platform.attitude(since_start_s).ned_from_body();
        GeodeticPose {
            place,
            attitude: Attitude::of(&then(&track_from_body, &here_from_track)),
            velocity_mps: rotate(&here_from_track, platform.velocity_mps(since_start_s)),
        }
    }

    /// Rotation from north, east, down at the start to the earth-centred frame.
    fn ecef_from_start(&self) -> Rotation {
        self.frame.ecef_from_local().map(|[east, north, up]| [north, east, -up])
    }
}

#[cfg(test)]
mod tests {
    use super::super::platform::Motion;
    use super::*;

    fn distance_m(a: [f64; 3], b: [f64; 3]) -> f64 {
        a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
    }

    #[test]
    fn the_start_has_its_map_coordinates() {
        let world = World::new(0.0);
        let start = world.geodetic_of([START_M[0], START_M[1], 0.0]);
        // Computed by inverting the projection with 40 digits.
        assert!((start.latitude_rad.to_degrees() - 47.828_142_448_644_364).abs() < 1e-13, "{start:?}");
        assert!((start.longitude_rad.to_degrees() - 12.594_893_857_932_11).abs() < 1e-13, "{start:?}");
        assert!(
            distance_m(world.on_earth([START_M[0], START_M[1], 400.0]), [320_000.0, 5_300_000.0, 400.0])
                < 5e-9
        );
    }

    #[test]
    fn a_heading_turns_the_scene_about_the_start() {
        let east = World::new(core::f64::consts::FRAC_PI_2);
        let point = [START_M[0] + 3.0, START_M[1] + 100.0, 7.0];
        let turned = east.on_flat_map(point);
        assert!(distance_m(turned, [320_100.0, 5_299_997.0, 7.0]) < 1e-9, "{turned:?}");
        assert_eq!(World::new(0.0).on_flat_map(point), point);
    }

    /// The georeferencing chain from the trajectory reproduces the truth within rounding (1 nm).
    #[test]
    fn trajectory_and_truth_agree() {
        for heading_deg in [0.0f64, 35.0, -120.0, 180.0] {
            let world = World::new(heading_deg.to_radians());
            let motion = Motion { angles_rad: [0.05, 0.03, 0.02], period_s: 5.0 };
            let (lever_arm_m, boresight_rad) = ([0.4, -0.2, 0.7], [0.01, -0.02, 0.005]);
            let platform = Platform::new(60.0, 1500.0, motion, lever_arm_m, boresight_rad);
            for (time_s, angle, range_m) in
                [(0.0, -0.5f64, 1700.0), (33.3, 0.3, 1600.0), (120.0, 0.6, 1900.0)]
            {
                let direction_in_scanner = [0.0, angle.sin(), angle.cos()];
                let truth = world.on_earth(platform.beam(time_s, direction_in_scanner).at(range_m));
                let pose = world.pose(&platform, time_s);
                let in_scanner = direction_in_scanner.map(|d| d * range_m);
                let in_body = rotate(&rotation_of_angles(boresight_rad), in_scanner);
                let in_body: [f64; 3] = core::array::from_fn(|axis| in_body[axis] + lever_arm_m[axis]);
                let in_ned = rotate(&pose.attitude.ned_from_body(), in_body);
                let offset =
                    rotate(&ecef_from_ned(pose.place.latitude_rad, pose.place.longitude_rad), in_ned);
                let body = WGS84.ecef_of(pose.place);
                let point = WGS84.geodetic_of(core::array::from_fn(|axis| body[axis] + offset[axis]));
                let (x, y) = world.map.project(point.latitude_rad, point.longitude_rad);
                assert!(distance_m([x, y, point.height_m], truth) < 2e-8, "{heading_deg} {time_s}");
            }
        }
    }

    #[test]
    fn the_zone_follows_from_the_start() {
        let south = World::starting_at([151.2f64.to_radians(), (-33.9f64).to_radians()], 1.0);
        // Zone 56 south, as in the tests of the projection.
        let start = south.on_earth([START_M[0], START_M[1], 12.0]);
        assert!(distance_m(start, [333_568.941_011_554, 6_247_473.336_844_018, 12.0]) < 5e-9, "{start:?}");
    }

    #[test]
    fn the_velocity_is_the_derivative_of_the_position() {
        let world = World::new(0.6);
        let platform = Platform::new(60.0, 1000.0, Motion::default(), [0.0; 3], [0.0; 3]).turning(1000.0);
        let [before, now, after] = [9.99, 10.0, 10.01].map(|time_s| world.pose(&platform, time_s));
        let moved = LocalFrame::at(WGS84, before.place).local_of(after.place).map(|moved| 50.0 * moved);
        let [north, east, down] = now.velocity_mps;
        assert!(distance_m(moved, [east, north, -down]) < 1e-3, "{moved:?}");
        assert!((north.hypot(east) - 60.0).abs() < 1e-3);
    }

    #[test]
    fn the_reference_system_is_well_formed() {
        let count = |c| CRS_WKT.matches(c).count();
        assert_eq!(count('['), count(']'));
        assert_eq!(count('"') % 2, 0);
        assert!(CRS_WKT.ends_with(r#"AUTHORITY["EPSG","32633"]]"#));
    }
}
