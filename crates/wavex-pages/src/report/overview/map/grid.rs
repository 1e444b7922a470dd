//! A grid whose cells double in size whenever it would need too many.

use std::collections::BTreeMap;

use crate::report::overview::view::MapProjection;
use wavex_ground::point::Class;
use wavex_line::scan_line::{InputInfo, Return};

/// Maximum number of cells in each direction.
const CELLS: i64 = 320;
/// Binary logarithm of the smallest cell size; small enough for degrees.
const SMALLEST_CELL: i32 = -24;
/// Largest valid coordinate, m or degrees.
const FARTHEST: f64 = 1e8;
/// Heights and intensities are clamped to this.
const HIGHEST: f64 = 1e7;
/// Steps per unit of height and intensity: integer sums do not depend on the order.
pub(super) const STEPS: f64 = 1000.0;
/// Maximum number of scan lines kept.
const MOST_LINES: usize = 128;
/// Number of points kept per scan line.
pub(super) const PER_LINE: usize = 9;

/// Sums over the points of a cell.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct MapCell {
    pub(super) points: u64,
    /// First returns.
    pub(super) pulses: u64,
    pub(super) height_steps: i64,
    pub(super) intensity_steps: i64,
    pub(super) zone_steps: i64,
    /// Height of the lowest ground point.
    pub(super) ground_steps: Option<i64>,
}

impl MapCell {
    fn add(&mut self, other: MapCell) {
        self.points += other.points;
        self.pulses += other.pulses;
        self.height_steps = self.height_steps.saturating_add(other.height_steps);
        self.intensity_steps = self.intensity_steps.saturating_add(other.intensity_steps);
        self.zone_steps = self.zone_steps.saturating_add(other.zone_steps);
        self.ground_steps = [self.ground_steps, other.ground_steps].into_iter().flatten().min();
    }
}

/// The grid being filled.
#[derive(Clone, Debug)]
pub(in crate::report::overview) struct MapGrid {
    /// The view, set by the first point.
    pub(super) view: Option<MapProjection>,
    /// Binary logarithm of the cell size.
    size: i32,
    /// Lowest and highest cell in both directions, once there are points.
    pub(super) span: Option<[[i64; 2]; 2]>,
    /// Cells by index modulo [`CELLS`]: unique as long as the span does not exceed it.
    pub(super) cells: Vec<MapCell>,
    pub(super) without_place: u64,
    /// Lines whose number is a multiple of this are kept.
    every: u32,
    pub(super) lines: BTreeMap<u32, Vec<[f64; 2]>>,
}

impl Default for MapGrid {
    fn default() -> MapGrid {
        MapGrid {
            view: None,
            size: SMALLEST_CELL,
            span: None,
            cells: Vec::new(),
            without_place: 0,
            every: 1,
            lines: BTreeMap::new(),
        }
    }
}

/// Index of a cell in the list.
fn place([x, y]: [i64; 2]) -> usize {
    (y.rem_euclid(CELLS) * CELLS + x.rem_euclid(CELLS)) as usize
}

/// Cell size from its binary logarithm.
fn edge_of(size: i32) -> f64 {
    f64::from(size).exp2()
}

fn is_place(point: &[f64; 3]) -> bool {
    point.iter().all(|coordinate| coordinate.abs() < FARTHEST)
}

impl MapGrid {
    /// Adds the points of a line; withheld ones are skipped.
    pub(in crate::report::overview) fn add_line(
        &mut self,
        line: u32,
        input: &InputInfo,
        returns: &[Return],
        points: &[[f64; 3]],
    ) {
        let is_kept = line.is_multiple_of(self.every);
        let mut places = Vec::new();
        for (found, point) in returns.iter().zip(points).filter(|(found, _)| !found.withheld) {
            if !is_place(point) {
                self.without_place += 1;
                continue;
            }
            let place = self.view.get_or_insert_with(|| MapProjection::of(input, *point)).place(*point);
            self.add(&place, found);
            if is_kept {
                places.push([place[0], place[1]]);
            }
        }
        self.keep(line, &places);
    }

    fn add(&mut self, [x, y, z]: &[f64; 3], found: &Return) {
        let cells_per_unit = edge_of(-self.size);
        let mut at = [(x * cells_per_unit).floor() as i64, (y * cells_per_unit).floor() as i64];
        let within = |span: [[i64; 2]; 2]| (0..2).all(|i| span[i][0] <= at[i] && at[i] <= span[i][1]);
        if !self.span.is_some_and(within) {
            at = self.make_room(at);
        }
        // The cast saturates; NaN counts as 0.
        let steps = |value: f64| (value.clamp(-HIGHEST, HIGHEST) * STEPS).round() as i64;
        let cell = MapCell {
            points: 1,
            pulses: u64::from(found.return_number == 1),
            height_steps: steps(*z),
            intensity_steps: steps(found.intensity),
            zone_steps: steps(f64::from(found.mta_zone.max(0))),
            ground_steps: (found.class == Class::Ground as u8).then(|| steps(*z)),
        };
        if let Some(at) = self.cells.get_mut(place(at)) {
            at.add(cell);
        }
    }

    /// Extends the span to a cell; returns the cell's index in the resulting grid.
    fn make_room(&mut self, at: [i64; 2]) -> [i64; 2] {
        let Some(before) = self.span else {
            self.cells = vec![MapCell::default(); (CELLS * CELLS) as usize];
            self.span = Some(at.map(|at| [at, at]));
            return at;
        };
        let wide = [0, 1].map(|i| [before[i][0].min(at[i]), before[i][1].max(at[i])]);
        let mut larger = 0;
        while wide.iter().any(|[low, high]| (high >> larger) - (low >> larger) >= CELLS) {
            larger += 1;
        }
        if larger > 0 {
            self.merge(before, larger);
        }
        self.span = Some(wide.map(|ends| ends.map(|end| end >> larger)));
        at.map(|at| at >> larger)
    }

    /// Enlarges cells by this power of two.
    fn merge(&mut self, span: [[i64; 2]; 2], larger: i32) {
        let mut merged = vec![MapCell::default(); self.cells.len()];
        for y in span[1][0]..=span[1][1] {
            for x in span[0][0]..=span[0][1] {
                let from = self.cells.get(place([x, y])).copied().unwrap_or_default();
                if let Some(to) = merged.get_mut(place([x >> larger, y >> larger])) {
                    to.add(from);
                }
            }
        }
        self.cells = merged;
        self.size += larger;
    }

    /// Keeps some positions of a line, and some of the lines.
    fn keep(&mut self, line: u32, places: &[[f64; 2]]) {
        let Some(last) = places.len().checked_sub(1).filter(|last| *last > 0) else { return };
        let some = (0..PER_LINE).filter_map(|i| places.get(i * last / (PER_LINE - 1)).copied()).collect();
        self.lines.insert(line, some);
        while self.lines.len() > MOST_LINES {
            self.every = self.every.saturating_mul(2);
            let every = self.every;
            self.lines.retain(|line, _| line.is_multiple_of(every));
        }
    }

    pub(super) fn cell(&self, at: [i64; 2]) -> MapCell {
        self.cells.get(place(at)).copied().unwrap_or_default()
    }

    /// Cell size.
    pub(super) fn edge(&self) -> f64 {
        edge_of(self.size)
    }

    /// Doubles the cell size.
    pub(super) fn coarsen(&mut self) {
        if let Some(span) = self.span {
            self.merge(span, 1);
            self.span = Some(span.map(|ends| ends.map(|end| end >> 1)));
        }
    }
}
