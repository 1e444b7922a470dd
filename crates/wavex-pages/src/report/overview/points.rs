//! Extent, classes and return numbers of the points, and scan angles of the shots.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::histogram::{Bins, QuantityHistogram};
use super::view::crs_name;
use wavex_line::scan_line::{Return, ScanLine};
use wavex_line::stage::packed;

/// Extent and content of the points of an input.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct PointSummary {
    /// Name of the coordinate reference system of the recording, if it has one.
    pub crs: Option<String>,
    /// Lowest and highest x, y and z of the points that are not withheld, in units of the points.
    pub bounds: Option<[[f64; 2]; 3]>,
    /// Number of returns by LAS class.
    pub by_class: BTreeMap<u8, u64>,
    /// Number of withheld returns.
    pub withheld: u64,
    /// Number of shots by their number of returns, from 0; the last entry also counts more.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub shots_by_returns: Vec<u64>,
    /// Number of returns by return number, from 1; the last entry also counts higher numbers.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub by_return_number: Vec<u64>,
    /// Scan angles of the shots that have one.
    pub scan_angles: Option<QuantityHistogram>,
}

/// Highest number of returns of a shot that is counted separately: the limit of LAS 1.4.
const MOST_RETURNS: usize = 15;
/// Largest valid coordinate, m or degrees.
const FARTHEST: f64 = 1e8;

/// Counts collected while lines leave the chain.
#[derive(Clone, Debug)]
pub(super) struct PointCounts {
    crs: Option<String>,
    bounds: Option<[[f64; 2]; 3]>,
    by_class: BTreeMap<u8, u64>,
    withheld: u64,
    shots_by_returns: [u64; MOST_RETURNS + 1],
    by_return_number: [u64; MOST_RETURNS + 1],
    scan_angles: Bins,
}

impl Default for PointCounts {
    fn default() -> PointCounts {
        PointCounts {
            crs: None,
            bounds: None,
            by_class: BTreeMap::new(),
            withheld: 0,
            shots_by_returns: [0; MOST_RETURNS + 1],
            by_return_number: [0; MOST_RETURNS + 1],
            scan_angles: Bins::linear(-90.0, 0.5, 360),
        }
    }
}

impl PointCounts {
    pub(super) fn add(&mut self, scan_line: &ScanLine) {
        for emission in &scan_line.emissions {
            self.scan_angles.add(f64::from(emission.scan_angle_deg));
        }
        if self.crs.is_none() {
            self.crs = scan_line.input.crs_wkt.as_deref().map(crs_name);
        }
        let Some(returns) = scan_line.returns() else { return };
        for shot in returns.chunk_by(|a, b| a.emission == b.emission) {
            self.shots_by_returns[shot.len().min(MOST_RETURNS)] += 1;
        }
        let with_returns = returns.chunk_by(|a, b| a.emission == b.emission).count();
        self.shots_by_returns[0] += scan_line.emissions.len().saturating_sub(with_returns) as u64;
        for found in returns {
            *self.by_class.entry(found.class).or_default() += 1;
            self.withheld += u64::from(found.withheld);
            self.by_return_number[usize::from(found.return_number).min(MOST_RETURNS)] += 1;
        }
        self.extend(returns, scan_line.points().unwrap_or_default());
    }

    /// Extends the bounds; minimum and maximum do not depend on the order.
    fn extend(&mut self, returns: &[Return], points: &[[f64; 3]]) {
        let is_place = |point: &[f64; 3]| point.iter().all(|coordinate| coordinate.abs() < FARTHEST);
        for (found, point) in returns.iter().zip(points) {
            if found.withheld || !is_place(point) {
                continue;
            }
            // Turns -0 into 0, which compares equal.
            let place = point.map(|coordinate| coordinate + 0.0);
            let bounds = self.bounds.get_or_insert_with(|| place.map(|value| [value; 2]));
            for ([low, high], value) in bounds.iter_mut().zip(place) {
                (*low, *high) = (low.min(value), high.max(value));
            }
        }
    }

    /// Returns the summary; `None` without shots of known angle and without returns.
    pub(super) fn finish(self) -> Option<PointSummary> {
        let trimmed = |counts: &[u64], first: usize| {
            let until = counts.iter().rposition(|count| *count > 0).map_or(0, |last| last + 1);
            counts.get(first..until).unwrap_or_default().to_vec()
        };
        let scan_angles = self.scan_angles.finish("scan angle", "°");
        let has_returns = !self.by_class.is_empty();
        (has_returns || scan_angles.is_some()).then(|| PointSummary {
            crs: self.crs,
            bounds: self.bounds,
            by_class: self.by_class,
            withheld: self.withheld,
            shots_by_returns: if has_returns { trimmed(&self.shots_by_returns, 0) } else { Vec::new() },
            by_return_number: trimmed(&self.by_return_number, 1),
            scan_angles,
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use wavex_line::scan_line::{Blocks, Content, Emission, InputInfo};

    fn line(returns: Vec<Return>, points: Vec<[f64; 3]>) -> ScanLine {
        let wkt = "PROJCS[\"WGS 84 / UTM zone 33N\",GEOGCS[]]".to_owned();
        let input = Arc::new(InputInfo { crs_wkt: Some(wkt), ..InputInfo::default() });
        let emissions = vec![Emission { scan_angle_deg: -3.2, ..Emission::default() }; 4];
        let line = ScanLine::of_shots(input, 0, emissions, Blocks::default());
        ScanLine { content: Content::Points(returns, points), ..line }
    }

    #[test]
    fn points_are_counted_by_class_number_and_extent() {
        let of = |emission, return_number, class, withheld| Return {
            emission,
            return_number,
            class,
            withheld,
            ..Return::default()
        };
        let returns = vec![of(0, 1, 0, false), of(0, 2, 0, false), of(2, 1, 7, true), of(3, 1, 0, false)];
        let points = vec![[5.0, -0.0, 2.0], [4.0, 3.0, 9.0], [99.0; 3], [f64::NAN, 0.0, 0.0]];
        let mut counted = PointCounts::default();
        counted.add(&line(returns, points));
        let found = counted.finish().unwrap();
        assert_eq!(found.crs.as_deref(), Some("WGS 84 / UTM zone 33N"));
        assert_eq!(found.bounds, Some([[4.0, 5.0], [0.0, 3.0], [2.0, 9.0]]));
        assert_eq!(found.by_class, BTreeMap::from([(0, 3), (7, 1)]));
        assert_eq!(
            (found.withheld, found.shots_by_returns, found.by_return_number),
            (1, vec![1, 2, 1], vec![3, 1])
        );
        let angles = found.scan_angles.unwrap();
        assert_eq!((angles.first_edge, angles.counts), (-3.5, vec![4]));
    }

    #[test]
    fn more_returns_than_las_has_are_counted_as_its_most() {
        let returns = (0..20u8).map(|i| Return { return_number: i + 1, ..Return::default() }).collect();
        let mut counted = PointCounts::default();
        counted.add(&line(returns, Vec::new()));
        let found = counted.finish().unwrap();
        assert_eq!((found.shots_by_returns.len(), found.by_return_number.last()), (16, Some(&6)));
        assert_eq!(found.bounds, None);
        assert!(PointCounts::default().finish().is_none());
    }
}
