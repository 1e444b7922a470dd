//! Coordinates of clouds as a Cartesian frame, seen from a fixed sensor far above.
//!
//! Only positions are corrected, and a shift moves all points of a beam alike: beams need no true origin. All points are seen
//! from one place above the first of them, at a height from which beams are vertical. The frame is placed on the ellipsoid
//! at latitude 0 and longitude 0, so north, east, down of corrections are the axes y, x, -z of the map.

use std::path::Path;

use wavex_align::patch::{Horizon, PatchReturn};
use wavex_align::scanner::{BeamSource, Scanner, ScannerBeam};
use wavex_formats::las::{LasHeader, Point};
use wavex_geodesy::crs::{Crs, units_of_wkt};
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::frames::{Attitude, IDENTITY, LocalFrame, Vector, rotate};
use wavex_geodesy::trajectory::{Accuracy, AccuracySample, Sample, Trajectory, TrajectoryError};

/// Where the frame is placed; any place serves.
const PLACE: Geodetic = Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 };
/// Height of the sensor, m.
const HEIGHT_M: f64 = 1e6;
/// Time before and after a strip for which there is a pose, s.
const MARGIN_S: f64 = 1.0;

/// Origin and units of coordinates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frame {
    /// Coordinates of the origin, in units of the file.
    pub(super) origin: [f64; 3],
    /// Lengths of the units of x and y, and of z, m.
    pub(super) units_m: [f64; 2],
    local: LocalFrame,
    origin_in_ecef_m: Vector,
}

impl Default for Frame {
    fn default() -> Frame {
        Frame::new([0.0; 3], [1.0; 2])
    }
}

impl Frame {
    /// Frame about this place.
    pub(super) fn new(origin: [f64; 3], units_m: [f64; 2]) -> Frame {
        let local = LocalFrame::at(WGS84, PLACE);
        Frame { origin, units_m, local, origin_in_ecef_m: WGS84.ecef_of(PLACE) }
    }

    /// East, north, up of a position, m.
    pub(super) fn local_m(&self, coordinates: [f64; 3]) -> Vector {
        let units_m = [self.units_m[0], self.units_m[0], self.units_m[1]];
        core::array::from_fn(|axis| (coordinates[axis] - self.origin[axis]) * units_m[axis])
    }

    /// Change of coordinates, in units of the file, by a correction.
    pub(super) fn shift(&self, [north_m, east_m, down_m]: [f64; 3]) -> [f64; 3] {
        [east_m / self.units_m[0], north_m / self.units_m[0], -down_m / self.units_m[1]]
    }

    pub(super) fn horizon(&self) -> Horizon {
        Horizon::at(PLACE)
    }

    /// A point as the return of a vertical beam.
    pub(super) fn patch_return(&self, point: &Point, time_s: f64, noise_m: f64) -> PatchReturn {
        let [east_m, north_m, up_m] = self.local_m([point.x, point.y, point.z]);
        let beam_m = [east_m, north_m, up_m - HEIGHT_M];
        let range_m = beam_m.iter().map(|part| part * part).sum::<f64>().sqrt();
        let [east, north, up] = beam_m.map(|part| part / range_m);
        let in_ecef_m = rotate(self.local.ecef_from_local(), [east_m, north_m, up_m]);
        PatchReturn {
            beam: ScannerBeam { time_s, direction: [north, east, -up], range_m },
            source: BeamSource::default(),
            range_sd_m: noise_m,
            n_returns: point.number_of_returns,
            point_in_ecef_m: core::array::from_fn(|axis| self.origin_in_ecef_m[axis] + in_ecef_m[axis]),
            direction_in_ecef: rotate(self.local.ecef_from_local(), [east, north, up]),
        }
    }
}

/// The scanner of all clouds: its axes are north, east, down.
pub(super) fn scanner() -> Scanner {
    Scanner { body_from_mount: IDENTITY, calibration: Default::default() }
}

/// The sensor at rest during a strip, with SDs of its position north, east, down, m.
///
/// # Errors
/// Times that are not finite.
pub(super) fn trajectory(
    span_s: Option<[f64; 2]>,
    position_sd_m: [f64; 3],
) -> Result<Trajectory, TrajectoryError> {
    let [first_s, last_s] = span_s.unwrap_or_default();
    let times_s = [first_s - MARGIN_S, last_s + MARGIN_S];
    let place = Geodetic { height_m: HEIGHT_M, ..PLACE };
    let accuracy = Accuracy { position_sd_m, attitude_sd_rad: [0.0; 3] };
    let samples = times_s.map(|time_s| Sample { time_s, place, attitude: Attitude::default() });
    let accuracies = times_s.map(|time_s| AccuracySample { time_s, accuracy });
    Trajectory::new(samples.to_vec())?.with_accuracies(accuracies.to_vec())
}

/// Units of a file's coordinates.
pub(crate) struct System {
    /// Lengths of the units of x and y, and of z, m.
    pub(crate) units_m: [f64; 2],
    /// What a user should know.
    pub(crate) note: Option<String>,
}

/// Units of the coordinates of a file.
///
/// # Errors
/// Coordinates are degrees or earth-centred: problem and remedy.
pub(crate) fn system_of(path: &Path, wkt: Option<&str>, header: &LasHeader) -> Result<System, String> {
    let of = |problem: &str| Err(format!("{}: {problem}", path.display()));
    let degrees = "its coordinates are degrees; project the clouds to a system in metres, such as UTM";
    let is_projected = wkt.is_some_and(|wkt| wkt.contains("PROJCS") || wkt.contains("PROJCRS"));
    let system = wkt.and_then(Crs::horizontal_of_wkt);
    let is_geocentric = system.as_ref().is_some_and(Crs::is_ecef);
    if is_geocentric || wkt.is_some_and(|wkt| wkt.contains("GEOCCS")) {
        return of(
            "its coordinates are earth-centred; project the clouds to a system in metres, such as UTM",
        );
    }
    let is_geographic = wkt.is_some_and(|wkt| wkt.contains("GEOGCS") || wkt.contains("GEOGCRS"));
    if system.as_ref().is_some_and(Crs::is_geodetic) || (is_geographic && !is_projected) {
        return of(degrees);
    }
    let is_within = |axis: usize, most: f64| header.min[axis] >= -most && header.max[axis] <= most;
    // A step of 1e-5 degrees is a metre; no cloud in metres has so fine steps.
    if !is_projected && is_within(0, 180.0) && is_within(1, 90.0) && header.scale[0].abs() < 1e-5 {
        return of(degrees);
    }
    match wkt.filter(|_| is_projected) {
        Some(wkt) => Ok(System { units_m: units_of_wkt(wkt), note: None }),
        None => Ok(System {
            units_m: [1.0; 2],
            note: Some(format!(
                "{}: no coordinate reference system is known; coordinates are taken as metres",
                path.display()
            )),
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_geodesy::crs::wkt_of_epsg;

    fn problem(wkt: Option<&str>, header: &LasHeader) -> String {
        system_of(Path::new("a.las"), wkt, header).err().unwrap()
    }

    /// Far points stay where they are, seen from the sensor.
    #[test]
    fn beams_end_at_their_points() {
        let frame = Frame::new([500_000.0, 5_300_000.0, 100.0], [1.0; 2]);
        let point = Point { x: 512_345.678, y: 5_290_123.456, z: 234.567, ..Point::default() };
        let given = frame.patch_return(&point, 3.0, 0.01);
        let trajectory = trajectory(Some([0.0, 10.0]), [0.1; 3]).unwrap();
        let end = scanner().locate(&given.source, &given.beam, &mut trajectory.poses(), None).unwrap();
        for (end_m, given_m) in end.iter().zip(given.point_in_ecef_m) {
            assert!((end_m - given_m).abs() < 1e-6, "{end:?} {given:?}");
        }
        let local_m = frame.horizon().local_m(end);
        for (found_m, expected_m) in local_m.iter().zip([12_345.678, -9_876.544, 134.567]) {
            assert!((found_m - expected_m).abs() < 1e-6, "{local_m:?}");
        }
    }

    #[test]
    fn degrees_and_earth_centred_coordinates_are_refused() {
        let header = LasHeader { scale: [0.001; 3], max: [1e6; 3], ..LasHeader::default() };
        assert!(problem(wkt_of_epsg(4326).as_deref(), &header).contains("its coordinates are degrees"));
        assert!(problem(wkt_of_epsg(4978).as_deref(), &header).contains("earth-centred"));
        let degrees = LasHeader {
            scale: [1e-7; 3],
            min: [11.0, 48.0, 0.0],
            max: [11.1, 48.1, 500.0],
            ..LasHeader::default()
        };
        assert!(problem(None, &degrees).contains("its coordinates are degrees"));
        let utm = system_of(Path::new("a.las"), wkt_of_epsg(32633).as_deref(), &header).unwrap();
        assert!(utm.units_m == [1.0; 2] && utm.note.is_none());
        let unknown = system_of(Path::new("a.las"), None, &header).unwrap();
        assert!(unknown.note.unwrap().contains("taken as metres"));
    }

    #[test]
    fn feet_are_converted() {
        let header = LasHeader { scale: [0.001; 3], max: [1e6; 3], ..LasHeader::default() };
        // NAD83 / California zone 5 (ftUS).
        let feet = wkt_of_epsg(2229).unwrap();
        let units_m = system_of(Path::new("a.las"), Some(&feet), &header).unwrap().units_m;
        assert!((units_m[0] - 1200.0 / 3937.0).abs() < 1e-12);
        let frame = Frame::new([1000.0; 3], units_m);
        let moved = frame.shift([0.3, 0.6, 0.9]);
        let local_m = frame.local_m(core::array::from_fn(|axis| 1000.0 + moved[axis]));
        for (found_m, expected_m) in local_m.iter().zip([0.6, 0.3, -0.9]) {
            assert!((found_m - expected_m).abs() < 1e-9, "{local_m:?}");
        }
    }
}
