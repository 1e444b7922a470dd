//! Ground among classified points, and how much of the covered area it reaches.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::view::MapProjection;
use wavex_ground::point::Class;
use wavex_line::scan_line::ScanLine;

/// Ground of an input with classified points.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct GroundSummary {
    /// Number of ground points that are not withheld.
    pub points: u64,
    /// Cells of 2 m by 2 m with points; absent if the area is too large to count them.
    pub covered_cells: Option<u64>,
    /// Those of them without ground within 5 m.
    pub bare_cells: Option<u64>,
}

/// Edge of the cells, m.
const CELL_M: f64 = 2.0;
/// Columns that are near a cell in rows of this distance: their centres are at most 5 m apart.
const NEAR: [(i32, u32); 5] = [(-2, 1), (-1, 2), (0, 2), (1, 2), (2, 1)];
/// Cells of a tile in each direction: the bits of a row.
const TILE: i32 = u32::BITS as i32;
/// Maximum number of tiles: 134 km², 9 MB.
const MOST_TILES: usize = 1 << 15;
/// Largest valid coordinate, m or degrees.
const FARTHEST: f64 = 1e8;

/// Cells of a tile; a bit for each column of each row.
#[derive(Clone, Debug, Default)]
struct TileBits {
    covered: [u32; TILE as usize],
    ground: [u32; TILE as usize],
}

/// Counts collected while lines leave the chain.
#[derive(Clone, Debug, Default)]
pub(super) struct GroundCounts {
    /// Whether any point has a class of the ground classification.
    is_classified: bool,
    points: u64,
    /// Map of the points, and the lengths of its units, m; set by the first point.
    view: Option<(MapProjection, [f64; 2])>,
    tiles: BTreeMap<[i32; 2], TileBits>,
    is_too_large: bool,
}

impl GroundCounts {
    pub(super) fn add(&mut self, scan_line: &ScanLine) {
        let returns = scan_line.returns().map(Vec::as_slice).unwrap_or_default();
        let is_of_ground = |class: u8| class == Class::Ground as u8 || class == Class::Unclassified as u8;
        self.is_classified |= returns.iter().any(|found| is_of_ground(found.class));
        for (found, point) in returns.iter().zip(scan_line.points().unwrap_or_default()) {
            if found.withheld {
                continue;
            }
            let is_ground = found.class == Class::Ground as u8;
            self.points += u64::from(is_ground);
            if point.iter().all(|coordinate| coordinate.abs() < FARTHEST) {
                let (view, units_m) = self.view.get_or_insert_with(|| {
                    let view = MapProjection::of(&scan_line.input, *point);
                    let units_m = view.units_m(view.place(*point)[1].round());
                    (view, units_m)
                });
                let [east, north, _] = view.place(*point);
                let place_m = [east * units_m[0], north * units_m[1]];
                self.mark(place_m, is_ground);
            }
        }
    }

    /// Marks the cell of a point.
    fn mark(&mut self, place_m: [f64; 2], is_ground: bool) {
        let [x, y] = place_m.map(|place_m| (place_m / CELL_M).floor() as i64);
        let tile = [x, y].map(|cell| cell.div_euclid(i64::from(TILE)) as i32);
        if self.tiles.len() >= MOST_TILES && !self.tiles.contains_key(&tile) {
            self.is_too_large = true;
            return;
        }
        let bit = 1 << x.rem_euclid(i64::from(TILE));
        let row = y.rem_euclid(i64::from(TILE)) as usize;
        let tile = self.tiles.entry(tile).or_default();
        tile.covered[row] |= bit;
        tile.ground[row] |= if is_ground { bit } else { 0 };
    }

    /// Ground in a row of a tile, with two columns before and after it; the row may be outside of the tile.
    fn row(&self, [x, y]: [i32; 2], row: i32) -> u64 {
        let y = y + row.div_euclid(TILE);
        let row = row.rem_euclid(TILE) as usize;
        let of = |x: i32| self.tiles.get(&[x, y]).map_or(0, |tile| u64::from(tile.ground[row]));
        of(x - 1) >> (TILE - 2) | of(x) << 2 | (of(x + 1) & 3) << (TILE + 2)
    }

    /// Number of covered cells, and of those without ground nearby.
    fn cells(&self) -> [u64; 2] {
        let (mut covered, mut bare) = (0, 0);
        for (at, tile) in &self.tiles {
            for (row, cells) in (0..TILE).zip(tile.covered) {
                let near = NEAR.iter().fold(0, |near, (rows, columns)| {
                    let ground = self.row(*at, row + rows);
                    (0..=*columns).fold(near, |near, by| near | ground << by | ground >> by)
                });
                covered += u64::from(cells.count_ones());
                bare += u64::from((cells & !((near >> 2) as u32)).count_ones());
            }
        }
        [covered, bare]
    }

    /// Returns the summary; `None` if the ground was not searched.
    pub(super) fn finish(self) -> Option<GroundSummary> {
        let cells = (!self.is_too_large).then(|| self.cells());
        self.is_classified.then(|| GroundSummary {
            points: self.points,
            covered_cells: cells.map(|[covered, _]| covered),
            bare_cells: cells.map(|[_, bare]| bare),
        })
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use wavex_line::scan_line::{Blocks, Content, InputInfo, Return};

    /// Summary of points with classes.
    fn of(wkt: &str, points: &[([f64; 2], u8)]) -> Option<GroundSummary> {
        let input = Arc::new(InputInfo { crs_wkt: Some(wkt.to_owned()), ..InputInfo::default() });
        let mut counts = GroundCounts::default();
        let returns = points.iter().map(|(_, class)| Return { class: *class, ..Return::default() }).collect();
        let places = points.iter().map(|([x, y], _)| [*x, *y, 100.0]).collect();
        let line = ScanLine::of_shots(input, 0, Vec::new(), Blocks::default());
        counts.add(&ScanLine { content: Content::Points(returns, places), ..line });
        counts.finish()
    }

    fn cells(found: Option<GroundSummary>) -> [u64; 3] {
        let found = found.unwrap();
        [found.points, found.covered_cells.unwrap(), found.bare_cells.unwrap()]
    }

    /// Compares bits with distances between centres, also across tiles and below 0.
    #[test]
    fn cells_are_bare_beyond_five_metres() {
        for corner in [-1.0, 63.0, 61.0, 500_033.0] {
            let ground = [corner, corner];
            let grid = (-6..=6).flat_map(|i| (-6..=6).map(move |j| [2.0 * f64::from(i), 2.0 * f64::from(j)]));
            let mut points: Vec<([f64; 2], u8)> =
                grid.clone().map(|[x, y]| ([corner + x, corner + y], 1)).collect();
            points.push((ground, 2));
            let bare = grid.filter(|[x, y]| x.hypot(*y) > 5.0).count() as u64;
            assert_eq!(cells(of("", &points)), [1, 169, bare], "{corner}");
        }
    }

    #[test]
    fn units_are_metres() {
        let points = [([0.0, 0.0], 2), ([14.0, 0.0], 1)];
        assert_eq!(cells(of("", &points)), [1, 2, 1]);
        assert_eq!(cells(of("PROJCS[UNIT[\"US survey foot\",0.3048]]", &points)), [1, 2, 0]);
        assert_eq!(cells(of("GEOGCS[]", &[([11.0, 48.0], 2), ([11.0001, 48.0], 1)])), [1, 2, 1]);
    }

    #[test]
    fn only_a_ground_classification_has_a_summary() {
        assert_eq!(of("", &[([0.0; 2], 0), ([1.0, 1.0], 7)]), None);
        assert_eq!(cells(of("", &[([0.0; 2], 1)])), [0, 1, 1]);
    }

    #[test]
    fn areas_beyond_the_limit_are_not_counted() {
        let points: Vec<_> = (0..=MOST_TILES).map(|i| ([100.0 * i as f64, 0.0], 2)).collect();
        let found = of("", &points).unwrap();
        assert_eq!((found.points, found.covered_cells), (points.len() as u64, None));
        assert_eq!(cells(of("", &points[1..])), [points.len() as u64 - 1, MOST_TILES as u64, 0]);
    }
}
