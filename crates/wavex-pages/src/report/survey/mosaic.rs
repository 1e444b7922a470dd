//! The survey at the resolution of the page: pictures and gaps.

use schemars::JsonSchema;
use serde::Serialize;

use super::rasters::RasterFrame;
use crate::plot::{HEIGHTS, Picture, Ramp};
use wavex_engine::job::SurveyKeys;

/// Maximum number of cells of a picture in each direction.
const MOST_CELLS: u32 = 640;
/// Maximum number of listed gaps.
const MOST_LISTED: usize = 20;
/// A gap contains a square of this many pulse spacings, as a data void of the Lidar Base
/// Specification of the USGS.
const VOID_SPACINGS: f64 = 4.0;
/// Differences: blue where the later strip is lower, orange where it is higher.
pub(crate) const DIFFERENCES: Ramp =
    [[24, 88, 180], [96, 142, 196], [152, 158, 166], [166, 158, 150], [212, 148, 84], [204, 92, 14]];
/// One colour, for gaps.
const GAPS: Ramp = [[206, 32, 41]; 6];

/// Sums of the cells that a cell of the pictures covers.
#[derive(Clone, Copy, Debug, Default)]
struct PictureCellSums {
    cells: u32,
    pulses: u64,
    strips: u32,
    difference_m: f64,
    differences: u32,
}

/// The pictures being filled.
#[derive(Debug)]
pub(super) struct Mosaic {
    frame: RasterFrame,
    /// Cells per cell of the pictures, in each direction.
    factor: u32,
    columns: usize,
    rows: usize,
    sums: Vec<PictureCellSums>,
    cell_area_m2: f64,
}

/// Area without points within the survey.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Gap {
    /// East and north coordinate of its middle.
    pub centre: [f64; 2],
    /// Area, m².
    pub area_m2: f64,
}

/// Gaps of a survey.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct Gaps {
    /// Smallest area of a gap, m².
    pub smallest_m2: f64,
    /// Number of gaps.
    pub count: usize,
    /// Area of all gaps, m².
    pub area_m2: f64,
    /// The largest gaps.
    pub largest: Vec<Gap>,
}

/// Pictures of a survey.
#[derive(Clone, Debug)]
pub(super) struct Pictures {
    pub(super) west: f64,
    pub(super) north: f64,
    /// Width and height in coordinates.
    pub(super) size: [f64; 2],
    pub(super) pulses: (Picture, [f64; 2]),
    pub(super) strips: (Picture, [f64; 2]),
    pub(super) differences: Option<Picture>,
    pub(super) gaps: Option<Picture>,
    /// Cells below the required pulse density.
    pub(super) below_target: Option<Picture>,
}

impl Mosaic {
    /// `cell_area_m2` is the area of a cell of the frame.
    pub(super) fn new(frame: RasterFrame, cell_area_m2: f64) -> Mosaic {
        let factor = frame.columns.max(frame.rows).div_ceil(MOST_CELLS).max(1);
        let [columns, rows] = [frame.columns, frame.rows].map(|cells| cells.div_ceil(factor).max(1) as usize);
        Mosaic {
            frame,
            factor,
            columns,
            rows,
            sums: vec![PictureCellSums::default(); columns * rows],
            cell_area_m2,
        }
    }

    /// Adds a cell with the number of its pulses and strips, and the largest difference.
    pub(super) fn add(&mut self, row: i32, column: i32, pulses: u32, strips: u32, difference_m: Option<f64>) {
        let y = self.frame.north.wrapping_sub(row) as u32 / self.factor;
        let x = column.wrapping_sub(self.frame.west) as u32 / self.factor;
        if let Some(sums) = self.sums.get_mut(y as usize * self.columns + x as usize) {
            sums.cells += 1;
            sums.pulses += u64::from(pulses);
            sums.strips = sums.strips.max(strips);
            sums.difference_m += difference_m.unwrap_or(0.0);
            sums.differences += u32::from(difference_m.is_some());
        }
    }

    /// Edge of a cell of the pictures, m.
    fn edge_m(&self) -> f64 {
        f64::from(self.factor) * self.cell_area_m2.sqrt()
    }

    /// Finds gaps up to `width_m` wide, and any that points surround.
    ///
    /// Returns a mask of the gaps, too. `pulses_per_m2` is the median density.
    pub(super) fn gaps(&self, width_m: f64, pulses_per_m2: f64) -> (Gaps, Vec<bool>) {
        let covered: Vec<bool> = self.sums.iter().map(|sums| sums.cells > 0).collect();
        let inside = self.closed(&covered, (0.5 * width_m / self.edge_m()).floor() as usize);
        let is_gap: Vec<bool> =
            covered.iter().zip(&inside).map(|(covered, inside)| *inside && !covered).collect();
        let area_m2 = self.edge_m() * self.edge_m();
        let void_m = VOID_SPACINGS * (1.0 / pulses_per_m2.max(1e-6)).sqrt();
        let side = ((void_m / self.edge_m()).ceil() as usize).max(1);
        // Ragged edges of strips and cells that pulses miss by chance are narrower than a void.
        let is_gap = self.opened(&is_gap, side);
        let smallest_m2 = (side * side) as f64 * area_m2;
        let mut gaps = Gaps { smallest_m2, ..Gaps::default() };
        let mut shown = vec![false; is_gap.len()];
        let mut seen = vec![false; is_gap.len()];
        for first in 0..is_gap.len() {
            if !is_gap[first] || seen[first] {
                continue;
            }
            let members = self.connected(first, &is_gap, &mut seen);
            let gap_m2 = members.len() as f64 * area_m2;
            if gap_m2 < smallest_m2 {
                continue;
            }
            gaps.count += 1;
            gaps.area_m2 += gap_m2;
            gaps.largest.push(Gap { centre: self.centre(&members), area_m2: gap_m2 });
            members.iter().for_each(|member| shown[*member] = true);
        }
        gaps.largest.sort_by(|a, b| b.area_m2.total_cmp(&a.area_m2));
        gaps.largest.truncate(MOST_LISTED);
        (gaps, shown)
    }

    /// Cells of a mask that are connected with one of them; marks them as seen.
    fn connected(&self, first: usize, mask: &[bool], seen: &mut [bool]) -> Vec<usize> {
        let mut members = vec![first];
        seen[first] = true;
        let mut next = 0;
        while let Some(at) = members.get(next).copied() {
            next += 1;
            for other in self.neighbours(at) {
                if mask[other] && !seen[other] {
                    seen[other] = true;
                    members.push(other);
                }
            }
        }
        members
    }

    fn neighbours(&self, at: usize) -> impl Iterator<Item = usize> + use<> {
        let (x, y, columns, rows) = (at % self.columns, at / self.columns, self.columns, self.rows);
        let west = (x > 0).then(|| at - 1);
        let east = (x + 1 < columns).then(|| at + 1);
        let north = (y > 0).then(|| at - columns);
        let south = (y + 1 < rows).then(|| at + columns);
        [west, east, north, south].into_iter().flatten()
    }

    fn centre(&self, members: &[usize]) -> [f64; 2] {
        let mean = |of: &dyn Fn(usize) -> usize| {
            members.iter().map(|at| of(*at) as f64 + 0.5).sum::<f64>() / members.len() as f64
        };
        let [x, y] = [mean(&|at| at % self.columns), mean(&|at| at / self.columns)];
        let step = f64::from(self.factor) * self.frame.cell;
        let [west, north] = self.corner();
        [west + x * step, north - y * step]
    }

    fn corner(&self) -> [f64; 2] {
        [f64::from(self.frame.west) * self.frame.cell, (f64::from(self.frame.north) + 1.0) * self.frame.cell]
    }

    /// Opening of a mask: the squares of `side` cells that it contains.
    fn opened(&self, mask: &[bool], side: usize) -> Vec<bool> {
        // Number of cells of the mask north-west of each corner.
        let width = self.columns + 1;
        let mut sums = vec![0u32; width * (self.rows + 1)];
        for (at, set) in mask.iter().enumerate() {
            let corner = (at / self.columns + 1) * width + at % self.columns + 1;
            sums[corner] =
                u32::from(*set) + sums[corner - 1] + sums[corner - width] - sums[corner - width - 1];
        }
        let mut opened = vec![false; mask.len()];
        for y in 0..(self.rows + 1).saturating_sub(side) {
            for x in 0..(self.columns + 1).saturating_sub(side) {
                let (first, last) = (y * width + x, (y + side) * width + x);
                let n = sums[last + side] + sums[first] - sums[first + side] - sums[last];
                if n as usize == side * side {
                    (y..y + side).for_each(|y| opened[y * self.columns + x..][..side].fill(true));
                }
            }
        }
        opened
    }

    /// Closing of a mask by a square of `2 radius + 1` cells, and its holes.
    fn closed(&self, mask: &[bool], radius: usize) -> Vec<bool> {
        // A larger square closes no more.
        let radius = radius.min(self.columns.max(self.rows));
        // The frame has a margin, so that its edges are not inside.
        let margin = radius + 1;
        let [columns, rows] = [self.columns + 2 * margin, self.rows + 2 * margin];
        let mut wide = vec![false; columns * rows];
        for (at, covered) in mask.iter().enumerate() {
            wide[(at / self.columns + margin) * columns + at % self.columns + margin] = *covered;
        }
        let wide = spread(&spread(&wide, columns, radius, true), columns, radius, false);
        let closed: Vec<bool> = wide.iter().map(|covered| !covered).collect();
        let open = spread(&spread(&closed, columns, radius, true), columns, radius, false);
        let mut inside: Vec<bool> = (0..mask.len())
            .map(|at| {
                let wide = (at / self.columns + margin) * columns + at % self.columns + margin;
                mask[at] || !open[wide]
            })
            .collect();
        self.fill_holes(&mut inside);
        inside
    }

    /// Adds the parts of the complement that do not reach the edge.
    fn fill_holes(&self, inside: &mut [bool]) {
        let outside: Vec<bool> = inside.iter().map(|inside| !inside).collect();
        let mut reached = vec![false; inside.len()];
        let edge = (0..inside.len()).filter(|at| {
            let (x, y) = (at % self.columns, at / self.columns);
            x == 0 || y == 0 || x + 1 == self.columns || y + 1 == self.rows
        });
        for at in edge {
            if outside[at] && !reached[at] {
                self.connected(at, &outside, &mut reached);
            }
        }
        inside.iter_mut().zip(reached).for_each(|(inside, reached)| *inside = !reached);
    }

    /// Pictures, with `gaps` as a mask.
    pub(super) fn pictures(&self, gaps: &[bool], limits: &SurveyKeys) -> Pictures {
        let picture_area_m2 = |sums: &PictureCellSums| f64::from(sums.cells) * self.cell_area_m2;
        let values = |of: &dyn Fn(&PictureCellSums) -> f64| -> Vec<Option<f64>> {
            self.sums.iter().map(|sums| (sums.cells > 0).then(|| of(sums))).collect()
        };
        let strips = values(&|sums| f64::from(sums.strips));
        let most = strips.iter().flatten().copied().fold(2.0, f64::max);
        let difference = |sums: &PictureCellSums| {
            (sums.differences > 0).then(|| sums.difference_m / f64::from(sums.differences))
        };
        let differences: Vec<Option<f64>> = self.sums.iter().map(difference).collect();
        let limit_m = limits.max_difference_rms_m;
        let target = limits.target_pulses_per_m2.unwrap_or(0.0);
        let density = |sums: &PictureCellSums| sums.pulses as f64 / picture_area_m2(sums);
        let is_below = |sums: &PictureCellSums| sums.cells > 0 && density(sums) < target;
        let below: Vec<Option<f64>> = self.sums.iter().map(|sums| is_below(sums).then_some(1.0)).collect();
        let has_differences = differences.iter().any(Option::is_some);
        let is_gap: Vec<Option<f64>> = gaps.iter().map(|gap| gap.then_some(1.0)).collect();
        let step = f64::from(self.factor) * self.frame.cell;
        let [west, north] = self.corner();
        Pictures {
            west,
            north,
            size: [self.columns as f64 * step, self.rows as f64 * step],
            pulses: Picture::of(&values(&density), self.columns, &HEIGHTS),
            strips: (Picture::within(&strips, self.columns, &HEIGHTS, [1.0, most]), [1.0, most]),
            differences: has_differences
                .then(|| Picture::within(&differences, self.columns, &DIFFERENCES, [-limit_m, limit_m])),
            gaps: gaps.contains(&true).then(|| Picture::within(&is_gap, self.columns, &GAPS, [0.0, 1.0])),
            below_target: limits
                .target_pulses_per_m2
                .map(|_| Picture::within(&below, self.columns, &GAPS, [0.0, 1.0])),
        }
    }
}

/// Sets each cell that has a set cell within `radius` along rows (or columns).
fn spread(mask: &[bool], columns: usize, radius: usize, along_rows: bool) -> Vec<bool> {
    let rows = mask.len() / columns.max(1);
    let (lines, length, step, stride) =
        if along_rows { (rows, columns, 1, columns) } else { (columns, rows, columns, 1) };
    let mut wide = vec![false; mask.len()];
    for line in 0..lines {
        let at = |i: usize| line * stride + i * step;
        // Distance from the last set cell, in both directions.
        for backwards in [false, true] {
            let mut since = usize::MAX;
            for i in 0..length {
                let i = if backwards { length - 1 - i } else { i };
                since = if mask[at(i)] { 0 } else { since.saturating_add(1) };
                wide[at(i)] |= since <= radius;
            }
        }
    }
    wide
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mosaic(rows: &[&str]) -> Mosaic {
        let (columns, n) = (rows[0].len() as u32, rows.len() as u32);
        let frame =
            RasterFrame { west: 100, north: 50, columns, rows: n, level: 0, cell: 10.0, crs_wkt: None };
        let mut mosaic = Mosaic::new(frame, 100.0);
        for (y, row) in (0..).zip(rows) {
            for (x, cell) in (0..).zip(row.chars()) {
                if cell == '#' {
                    mosaic.add(50 - y, 100 + x, 400, 1, None);
                }
            }
        }
        mosaic
    }

    #[test]
    fn a_slit_between_strips_is_a_gap() {
        let slit = mosaic(&["####..####", "####..####", "####..####", "####..####"]);
        let (gaps, mask) = slit.gaps(40.0, 4.0);
        assert_eq!((gaps.count, gaps.area_m2), (1, 800.0));
        assert_eq!(gaps.largest[0].centre, [1050.0, 490.0]);
        assert_eq!(mask.iter().filter(|gap| **gap).count(), 8);
        // Wider than the limit, it is the space between two sites.
        assert_eq!(slit.gaps(10.0, 4.0).0.count, 0);
    }

    #[test]
    fn a_hole_of_any_size_is_a_gap() {
        let hole = mosaic(&["########", "#......#", "#......#", "########"]);
        assert_eq!(hole.gaps(10.0, 4.0).0.area_m2, 1200.0);
        // Not if it is small compared with the distance of pulses: 4 x 10 m squared.
        assert_eq!(hole.gaps(10.0, 0.01).0.count, 0);
    }

    #[test]
    fn the_outside_is_no_gap() {
        let bay = mosaic(&["########", "###.....", "###.....", "###....."]);
        assert_eq!(bay.gaps(20.0, 4.0).0, Gaps { smallest_m2: 100.0, ..Gaps::default() });
    }
}
