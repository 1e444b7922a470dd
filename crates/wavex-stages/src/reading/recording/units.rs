//! Units of the coordinates of a recording.

use wavex_formats::RecordedCrs;
use wavex_geodesy::crs::{units_of_wkt, with_heights_in_map_unit};

/// Units of the coordinates of a recording.
///
/// Coordinates stay in the unit of the map, to which readers convert heights; ranges are in metres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RecordingUnits {
    /// Unit of x and y, m.
    pub(crate) map_m: f64,
    /// Unit of heights in units of x and y.
    pub(crate) height_factor: f64,
}

/// Warning for heights in another unit than x and y.
const OTHER_HEIGHTS: &str = "the heights of the file are in another unit than its eastings and northings: they are converted to the \
     latter, also in the coordinate reference system of the points";

impl RecordingUnits {
    /// Units of a CRS as WKT.
    pub(crate) fn of(crs_wkt: Option<&str>) -> RecordingUnits {
        let [map_m, height_m] = crs_wkt.map_or([1.0; 2], units_of_wkt);
        RecordingUnits { map_m, height_factor: height_m / map_m }
    }

    fn has_other_heights(self) -> bool {
        (self.height_factor - 1.0).abs() > 1e-9
    }

    /// A CRS of these units with heights in the unit of the map.
    pub(crate) fn converted(self, wkt: String) -> String {
        let converted = if self.has_other_heights() { with_heights_in_map_unit(&wkt) } else { None };
        converted.unwrap_or(wkt)
    }

    /// The CRS of a file with heights in the unit of the map; its problems do not matter if the job
    /// declares another.
    pub(crate) fn describe(self, crs: RecordedCrs, is_declared: bool) -> RecordedCrs {
        let mut problems = if is_declared { Vec::new() } else { crs.problems };
        problems.extend(self.has_other_heights().then(|| OTHER_HEIGHTS.to_owned()));
        RecordedCrs { wkt: crs.wkt.map(|wkt| self.converted(wkt)), problems, ..crs }
    }
}
