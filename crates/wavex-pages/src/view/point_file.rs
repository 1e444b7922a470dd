//! Points of a LAS, LAZ or COPC file without waveforms.

use std::path::Path;

use wavex_formats::las::{ExtraBytes, Point, RawPoints};
use wavex_line::scan_line::{InputInfo, Return};

/// Stores the value of an extra attribute in a return.
type Store = fn(&mut Return, f64);

/// Attributes of the standard layout of `write_las` that the page shows.
const ATTRIBUTES: [(&str, Store); 7] = [
    ("Raw amplitude", |found, value| found.amplitude_dn = value),
    ("Deviation", |found, value| found.deviation_ratio = value),
    ("Width ratio", |found, value| found.width_ratio = value),
    ("Range SD", |found, value| found.range_sd_m = value),
    ("Total uncertainty", |found, value| found.total_sd_m = value),
    ("MTA zone", |found, value| found.mta_zone = if value.is_nan() { -1 } else { value as i16 }),
    ("Quality flags", |found, value| found.flags = value as u16),
];

/// A file whose points are read once, in order.
pub(super) struct PointFile {
    points: RawPoints,
    attributes: Vec<(ExtraBytes, Store)>,
    point: Point,
}

/// A point as a return, with its place in the coordinates of the file and its flight strip.
pub(super) struct FilePoint {
    pub(super) found: Return,
    pub(super) position: [f64; 3],
    /// Point source ID.
    pub(super) strip: u16,
}

impl PointFile {
    /// Opens a file of any point format.
    ///
    /// # Errors
    /// If it is not LAS or damaged.
    pub(super) fn open(path: &Path) -> wavex_formats::Result<PointFile> {
        let points = RawPoints::open(path)?;
        let shown = |known: &ExtraBytes| {
            let (_, store) = ATTRIBUTES.iter().find(|(name, _)| *name == known.name)?;
            Some((known.clone(), *store))
        };
        let attributes = points.extra_bytes_descriptors().iter().filter_map(shown).collect();
        Ok(PointFile { points, attributes, point: Point::default() })
    }

    /// Number of points.
    pub(super) fn count(&self) -> u64 {
        self.points.header().n_points
    }

    /// The file as an input, with its coordinate reference system.
    pub(super) fn input(&self) -> InputInfo {
        let crs = self.points.crs();
        InputInfo { crs_wkt: crs.wkt, crs_problems: crs.problems, ..InputInfo::default() }
    }

    /// The next point; `None` at the end.
    ///
    /// # Errors
    /// If the file cannot be read or is damaged.
    pub(super) fn next(&mut self) -> wavex_formats::Result<Option<FilePoint>> {
        let Some(extra) = self.points.next_point(&mut self.point)? else { return Ok(None) };
        let point = &self.point;
        let mut found = Return {
            return_number: point.return_number,
            number_of_returns: point.number_of_returns,
            intensity: point.intensity.into(),
            class: point.classification,
            withheld: point.withheld,
            // Unknown unless the file has the attribute.
            width_ratio: f64::NAN,
            deviation_ratio: f64::NAN,
            ..Return::default()
        };
        for (attribute, store) in &self.attributes {
            store(&mut found, attribute.value(extra));
        }
        Ok(Some(FilePoint { found, position: [point.x, point.y, point.z], strip: point.point_source_id }))
    }
}
