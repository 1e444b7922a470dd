//! Map of the points.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::view::MapAxes;
use crate::plot::{HEIGHTS, INTENSITIES, Picture};
use grid::{MapCell, STEPS};
use wavex_line::stage::packed;

mod grid;

pub(super) use grid::MapGrid;

/// Points in cells of a grid; rows from north to south, columns from west to east.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct MapPicture {
    /// Coordinates of the map.
    pub axes: MapAxes,
    /// Unit of the coordinates: `m`, `ft` or `°`.
    pub unit: String,
    /// Coordinate of the west edge, in that unit.
    pub west: f64,
    /// Coordinate of the south edge.
    pub south: f64,
    /// Cell size.
    pub cell: f64,
    /// Number of cells from west to east.
    pub columns: u32,
    /// Number of cells from south to north.
    pub rows: u32,
    /// Number of points in the map.
    pub points: u64,
    /// Number of points outside the map or without coordinates.
    pub outside: u64,
    /// Mean cell heights as colours.
    pub heights: Picture,
    /// Heights of the first and last colour, m.
    pub height_range_m: [f64; 2],
    /// Mean cell intensities as colours.
    pub intensities: Picture,
    /// Intensities of the first and last colour.
    pub intensity_range: [f64; 2],
    /// Mean MTA zones of the cells as colours; absent if all are 0.
    #[serde(default)]
    pub zones: Option<Picture>,
    /// Zones of the first and last colour.
    #[serde(default)]
    pub zone_range: [f64; 2],
    /// Shaded lowest ground of the cells; absent without ground.
    #[serde(default)]
    pub ground: Option<Picture>,
    /// Heights that 1 % and 99 % of these cells do not exceed, in the unit of the heights.
    #[serde(default)]
    pub ground_range: [f64; 2],
    /// Median density of the cells with points, points per square unit.
    pub median_density: f64,
    /// Densities per square metre.
    #[serde(default)]
    pub densities: Option<Densities>,
    /// Some scan lines, in order.
    pub lines: Vec<MapLine>,
}

/// Densities of the cells with points.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Densities {
    /// Area of these cells, m².
    pub area_m2: f64,
    /// Number of these cells.
    pub cells: u64,
    /// Pulses: first returns.
    pub pulses: Density,
    /// Points: all returns.
    pub points: Density,
}

/// Density of one kind.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct Density {
    /// Number in all cells.
    pub count: u64,
    /// Mean, per m².
    pub mean_per_m2: f64,
    /// Density that 5 %, 50 % and 95 % of the cells do not exceed, per m².
    pub quantiles_per_m2: [f64; 3],
    /// Densities of the cells as colours.
    pub picture: Picture,
    /// Densities of the first and last colour, per m².
    pub range_per_m2: [f64; 2],
}

impl Densities {
    fn of(cells: &[MapCell], columns: usize, cell_m2: f64) -> Densities {
        let with_points: Vec<&MapCell> = cells.iter().filter(|cell| cell.points > 0).collect();
        let area_m2 = with_points.len() as f64 * cell_m2;
        let density = |count: fn(&MapCell) -> u64| {
            let mut counts: Vec<u64> = with_points.iter().map(|cell| count(cell)).collect();
            counts.sort_unstable();
            let at = |part: f64| counts.get((part * counts.len().saturating_sub(1) as f64).round() as usize);
            let sum: u64 = counts.iter().sum();
            let values: Vec<Option<f64>> =
                cells.iter().map(|cell| (cell.points > 0).then(|| count(cell) as f64 / cell_m2)).collect();
            let (picture, range_per_m2) = Picture::of(&values, columns, &HEIGHTS);
            Density {
                count: sum,
                mean_per_m2: sum as f64 / area_m2.max(f64::MIN_POSITIVE),
                quantiles_per_m2: [0.05, 0.5, 0.95]
                    .map(|part| at(part).copied().unwrap_or(0) as f64 / cell_m2),
                picture,
                range_per_m2,
            }
        };
        Densities {
            area_m2,
            cells: with_points.len() as u64,
            pulses: density(|cell| cell.pulses),
            points: density(|cell| cell.points),
        }
    }
}

/// A scan line in the map.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct MapLine {
    /// Scan line number.
    pub line: u32,
    /// Points along it, in cells east of `west` and north of `south`, as space-separated pairs.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub places: Vec<f64>,
}

/// Minimum number of cells with points per gap; a map with more gaps is coarsened.
const ENOUGH_FULL: u64 = 10;
/// Maps of at most this many cells in both directions are not coarsened.
const FEW_CELLS: i64 = 24;
/// Maximum fraction of the points outside each side of the map.
const OUTSIDE: f64 = 0.0005;

/// Heights are multiplied by this before they are shaded: hills of some metres must be visible.
pub(in crate::report) const EXAGGERATION: f64 = 3.0;
/// East, north and up of the unit vector towards the light: north-west, 45° above the horizon.
const LIGHT: [f64; 3] = [-0.5, 0.5, std::f64::consts::FRAC_1_SQRT_2];

/// Brightness of cells by their slope; rows from the top, with the size of a cell in the unit of the heights.
fn shades(heights: &[Option<f64>], columns: usize, size: [f64; 2]) -> Vec<Option<f64>> {
    let rows = heights.len() / columns.max(1);
    let height = |row: usize, column: usize| heights.get(row * columns + column).copied().flatten();
    // Slope from the neighbours before and after a cell; one of them or both may be unknown.
    let slope = |here: f64, before: Option<f64>, after: Option<f64>, size: f64| match (before, after) {
        (Some(before), Some(after)) => (after - before) / (2.0 * size),
        (None, Some(after)) => (after - here) / size,
        (Some(before), None) => (here - before) / size,
        (None, None) => 0.0,
    };
    let shade = |(row, column): (usize, usize)| {
        let here = height(row, column)?;
        let west = column.checked_sub(1).and_then(|column| height(row, column));
        let east = (column + 1 < columns).then(|| height(row, column + 1)).flatten();
        let north = row.checked_sub(1).and_then(|row| height(row, column));
        let south = height(row + 1, column);
        let to_east = EXAGGERATION * slope(here, west, east, size[0]);
        let to_north = EXAGGERATION * slope(here, south, north, size[1]);
        let length = (to_east * to_east + to_north * to_north + 1.0).sqrt();
        Some(((LIGHT[2] - LIGHT[0] * to_east - LIGHT[1] * to_north) / length).max(0.0))
    };
    (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))).map(shade).collect()
}

impl MapGrid {
    /// Returns the map; `None` without points.
    pub(super) fn finish(mut self) -> Option<MapPicture> {
        let mut bulk = self.bulk(self.span?);
        while self.is_sparse(bulk) {
            self.coarsen();
            bulk = self.bulk(self.span?);
        }
        let [x, y] = bulk;
        let view = self.view.as_ref()?;
        let rows = (y[0]..=y[1]).rev();
        let cells: Vec<MapCell> =
            rows.flat_map(|y| (x[0]..=x[1]).map(move |x| [x, y])).map(|at| self.cell(at)).collect();
        let mean = |steps: fn(&MapCell) -> i64| -> Vec<Option<f64>> {
            let mean = |cell: &MapCell| steps(cell) as f64 / STEPS / cell.points as f64;
            cells.iter().map(|cell| (cell.points > 0).then(|| mean(cell))).collect()
        };
        let columns = x[1] - x[0] + 1;
        let (heights, height_range_m) =
            Picture::of(&mean(|cell| cell.height_steps), columns as usize, &HEIGHTS);
        let (intensities, intensity_range) =
            Picture::of(&mean(|cell| cell.intensity_steps), columns as usize, &INTENSITIES);
        let zones = cells
            .iter()
            .any(|cell| cell.zone_steps > 0)
            .then(|| Picture::of(&mean(|cell| cell.zone_steps), columns as usize, &HEIGHTS));
        let zone_range = zones.as_ref().map_or([0.0; 2], |(_, range)| *range);
        let ground: Vec<Option<f64>> =
            cells.iter().map(|cell| cell.ground_steps.map(|steps| steps as f64 / STEPS)).collect();
        let inside: u64 = cells.iter().map(|cell| cell.points).sum();
        let all: u64 = self.cells.iter().map(|cell| cell.points).sum();
        let edge = self.edge();
        let (west, south) = (x[0] as f64 * edge, y[0] as f64 * edge);
        let middle = 0.5 * (y[0] + y[1] + 1) as f64 * edge;
        let cell_m2 = edge * edge * view.square_unit_m2(middle);
        let ground_range = Picture::of(&ground, columns as usize, &INTENSITIES).1;
        // Degrees have heights in metres; otherwise all coordinates have one unit.
        let cells_m = match view.axes() {
            MapAxes::Degrees => view.units_m(middle).map(|unit_m| unit_m * edge),
            MapAxes::Coordinates | MapAxes::Plane => [edge; 2],
        };
        let shades = shades(&ground, columns as usize, cells_m);
        let ground = ground.iter().any(Option::is_some);
        let ground = ground.then(|| Picture::within(&shades, columns as usize, &INTENSITIES, [0.0, 1.0]));
        let scan_line = |(line, places): (u32, Vec<[f64; 2]>)| MapLine {
            line,
            places: places.into_iter().flat_map(|[x, y]| [(x - west) / edge, (y - south) / edge]).collect(),
        };
        Some(MapPicture {
            axes: view.axes(),
            unit: view.unit().to_owned(),
            west,
            south,
            cell: edge,
            columns: columns as u32,
            rows: (y[1] - y[0] + 1) as u32,
            points: inside,
            outside: all - inside + self.without_place,
            heights,
            height_range_m,
            intensities,
            intensity_range,
            zones: zones.map(|(picture, _)| picture),
            zone_range,
            ground,
            ground_range,
            median_density: self.median_points(bulk) as f64 / (edge * edge),
            densities: Some(Densities::of(&cells, columns as usize, cell_m2)),
            lines: self.lines.into_iter().map(scan_line).collect(),
        })
    }

    /// Median number of points in the cells with points.
    fn median_points(&self, [x, y]: [[i64; 2]; 2]) -> u64 {
        let cells = (y[0]..=y[1]).flat_map(|y| (x[0]..=x[1]).map(move |x| [x, y]));
        let mut full: Vec<u64> = cells.map(|at| self.cell(at).points).filter(|points| *points > 0).collect();
        full.sort_unstable();
        full.get(full.len() / 2).copied().unwrap_or(0)
    }

    /// Whether the map would show isolated points or lines instead of surfaces.
    ///
    /// Counts cells with points that lack neighbours in one direction, and empty cells between two
    /// with points.
    fn is_sparse(&self, [x, y]: [[i64; 2]; 2]) -> bool {
        if [x, y].iter().all(|[low, high]| high - low < FEW_CELLS) {
            return false;
        }
        let is_full = |x: i64, y: i64| self.cell([x, y]).points > 0;
        let (mut full, mut torn) = (0u64, 0u64);
        for y in y[0] + 1..y[1] {
            for x in x[0] + 1..x[1] {
                let [west, east, south, north] =
                    [is_full(x - 1, y), is_full(x + 1, y), is_full(x, y - 1), is_full(x, y + 1)];
                let within = is_full(x, y);
                full += u64::from(within);
                torn += u64::from(match within {
                    true => !(west || east) || !(south || north),
                    false => (west && east) || (south && north),
                });
            }
        }
        torn * ENOUGH_FULL >= full
    }

    /// The span without outer cells of very few points: an echo from a cloud would make the rest
    /// small.
    fn bulk(&self, span: [[i64; 2]; 2]) -> [[i64; 2]; 2] {
        let across = |axis: usize, at: i64| -> u64 {
            let [low, high] = span[1 - axis];
            (low..=high)
                .map(|other| self.cell(if axis == 0 { [at, other] } else { [other, at] }).points)
                .sum()
        };
        [0, 1].map(|axis| {
            let [low, high] = span[axis];
            let counts: Vec<u64> = (low..=high).map(|at| across(axis, at)).collect();
            let most = (OUTSIDE * counts.iter().sum::<u64>() as f64) as u64;
            let skipped = |counts: &mut dyn Iterator<Item = &u64>| {
                let mut sum = 0;
                let is_few = |count: &&u64| {
                    sum += **count;
                    sum <= most
                };
                counts.take_while(is_few).count() as i64
            };
            [low + skipped(&mut counts.iter()), high - skipped(&mut counts.iter().rev())]
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::grid::PER_LINE;
    use super::*;
    use wavex_line::scan_line::{InputInfo, Return};

    fn grid(points: &[[f64; 3]]) -> MapGrid {
        let mut grid = MapGrid::default();
        for (line, point) in (0..).zip(points) {
            grid.add_line(
                line,
                &InputInfo::default(),
                &[Return { intensity: 7.0, ..Return::default() }],
                &[*point],
            );
        }
        grid
    }

    #[test]
    fn cells_grow_as_points_need_and_hold_them_all() {
        let corners =
            [[500_000.0, 5_000_000.0, 10.0], [500_100.0, 5_000_050.0, 30.0], [500_100.0, 5_000_050.0, 20.0]];
        let picture = grid(&corners).finish().unwrap();
        // 100 m in few cells whose size is a power of two.
        assert_eq!(picture.cell, 8.0);
        assert_eq!((picture.west, picture.south), (500_000.0, 5_000_000.0));
        assert_eq!((picture.columns, picture.rows), (13, 7));
        assert_eq!((picture.points, picture.outside), (3, 0));
        assert_eq!(picture.height_range_m, [10.0, 25.0]);
        assert_eq!(picture.intensity_range, [7.0, 7.0]);
        assert!(grid(&[]).finish().is_none());
        assert_eq!(grid(&[[1.5, 2.5, 3.0]]).finish().map(|one| (one.columns, one.rows)), Some((1, 1)));
    }

    #[test]
    fn degrees_have_small_cells() {
        let picture = grid(&[[11.5, 48.1, 500.0], [11.501, 48.1005, 500.0]]).finish().unwrap();
        assert!(picture.cell < 1e-4 && picture.columns > 8 && picture.columns <= 25, "{picture:?}");
    }

    #[test]
    fn what_is_nowhere_or_withheld_is_no_point() {
        let mut grid =
            grid(&[[0.0, 0.0, 0.0], [f64::NAN, 0.0, 0.0], [0.0, 1e9, 0.0], [0.0, 0.0, f64::INFINITY]]);
        let withheld = Return { withheld: true, ..Return::default() };
        grid.add_line(9, &InputInfo::default(), &[withheld, Return::default()], &[[5.0; 3], [0.0; 3]]);
        let picture = grid.finish().unwrap();
        assert_eq!((picture.points, picture.outside, picture.columns), (2, 3, 1));
        assert_eq!(picture.intensity_range, [3.5, 3.5], "unknown intensities count as 0");
    }

    #[test]
    fn a_few_points_far_away_are_left_out_of_the_picture() {
        let mut points: Vec<[f64; 3]> =
            (0..10_000).map(|i| [f64::from(i % 100), f64::from(i / 100), 0.0]).collect();
        points.push([9000.0, 50.0, 800.0]);
        let picture = grid(&points).finish().unwrap();
        assert_eq!((picture.points, picture.outside, picture.west), (10_000, 1, 0.0));
        assert!(f64::from(picture.columns) * picture.cell < 200.0);
    }

    #[test]
    fn cells_are_as_small_as_their_points_allow() {
        let filled = |spacing_m: [f64; 2]| {
            let [columns, rows] = spacing_m.map(|spacing_m| (300.0 / spacing_m) as u32);
            let cells = (0..columns * rows).map(|i| [i % columns, i / columns].map(|at| f64::from(at) + 0.5));
            let points: Vec<[f64; 3]> =
                cells.map(|[x, y]| [x * spacing_m[0], y * spacing_m[1], 0.0]).collect();
            grid(&points).finish().map(|picture| (picture.cell, picture.median_density))
        };
        assert_eq!(filled([1.0, 1.0]), Some((1.0, 1.0)));
        assert_eq!(filled([2.0, 2.0]), Some((2.0, 0.25)));
        // Lines 3 m apart: cells between them stay empty until they are larger than that.
        assert_eq!(filled([1.0, 3.0]).map(|(cell, _)| cell), Some(4.0));
    }

    #[test]
    fn ground_is_shaded_from_the_north_west() {
        let plane = |east: f64, north: f64| -> Vec<Option<f64>> {
            let cell = |i: i32| Some(2.0 * (f64::from(i % 3) * east - f64::from(i / 3) * north));
            (0..9).map(cell).collect()
        };
        let of = |heights: &[Option<f64>]| shades(heights, 3, [2.0; 2]);
        let [flat, towards, away] = [(0.0, 0.0), (0.2, -0.2), (-0.2, 0.2)].map(|(east, north)| {
            let shades = of(&plane(east, north));
            assert!(shades.iter().all(|shade| (shade.unwrap() - shades[0].unwrap()).abs() < 1e-12));
            shades[4].unwrap()
        });
        assert!(away < flat && flat < towards && towards <= 1.0, "{away} {flat} {towards}");
        let mut gaps = plane(0.2, -0.2);
        [0, 3, 5, 7].into_iter().for_each(|i| gaps[i] = None);
        let shades = of(&gaps);
        assert_eq!((shades[0], shades[3]), (None, None));
        assert!(shades[4].unwrap() > flat && shades[6] == Some(flat), "{shades:?}");
    }

    #[test]
    fn the_map_has_the_lowest_ground_of_each_cell() {
        let mut with_ground = MapGrid::default();
        let returns = [1, 2, 2].map(|class| Return { class, ..Return::default() });
        with_ground.add_line(
            0,
            &InputInfo::default(),
            &returns,
            &[[0.5, 0.5, 1.0], [0.5, 0.5, 5.0], [0.5, 0.5, 4.0]],
        );
        let found = with_ground.finish().unwrap();
        assert_eq!((found.ground.is_some(), found.ground_range), (true, [4.0, 4.0]));
        assert_eq!(grid(&[[0.5, 0.5, 1.0]]).finish().unwrap().ground, None);
    }

    #[test]
    fn densities_are_per_square_metre() {
        let of = |wkt: &str| {
            let input = InputInfo { crs_wkt: Some(wkt.to_owned()), ..InputInfo::default() };
            let mut grid = MapGrid::default();
            let numbers = [1, 2, 1];
            let returns = numbers.map(|return_number| Return { return_number, ..Return::default() });
            grid.add_line(0, &input, &returns, &[[0.5, 0.5, 0.0], [0.5, 0.5, 1.0], [1.5, 0.5, 0.0]]);
            let mut finished = grid;
            while finished.edge() < 1.0 {
                finished.coarsen();
            }
            finished.finish().and_then(|picture| picture.densities).unwrap()
        };
        let found = of("");
        assert_eq!((found.area_m2, found.cells), (2.0, 2));
        assert_eq!((found.pulses.count, found.pulses.mean_per_m2), (2, 1.0));
        assert_eq!((found.points.mean_per_m2, found.points.quantiles_per_m2), (1.5, [1.0, 2.0, 2.0]));
        let in_feet = of("PROJCS[UNIT[\"US survey foot\",0.3048]]");
        assert!((in_feet.area_m2 - 2.0 * 0.092_903_04).abs() < 1e-12);
        let in_degrees = of("GEOGCS[]");
        assert!((in_degrees.area_m2 / 2.47e10 - 1.0).abs() < 0.01, "{}", in_degrees.area_m2);
    }

    /// The cell size is 4.
    #[test]
    fn some_lines_are_kept_with_both_ends() {
        let mut grid = MapGrid::default();
        for line in 0..1000 {
            let points: Vec<[f64; 3]> = (0..21).map(|i| [f64::from(i), f64::from(line), 0.0]).collect();
            grid.add_line(line, &InputInfo::default(), &[Return::default(); 21], &points);
        }
        let lines = grid.finish().unwrap().lines;
        assert_eq!((lines.len(), lines[1].line), (125, 8));
        assert_eq!(lines[1].places[..4], [0.0, 2.0, 0.5, 2.0]);
        assert_eq!(lines[1].places[2 * PER_LINE - 2..], [5.0, 2.0]);
    }

    proptest! {
        #[test]
        fn the_picture_does_not_depend_on_the_order(
            points in prop::collection::vec([-1e4f64..1e4, -300f64..300.0, 0f64..90.0], 1..60),
        ) {
            let mut reversed = grid(&[]);
            for (line, point) in (0..).zip(&points).collect::<Vec<(u32, _)>>().into_iter().rev() {
                reversed.add_line(line, &InputInfo::default(), &[Return { intensity: 7.0, ..Return::default() }], &[*point]);
            }
            prop_assert_eq!(grid(&points).finish(), reversed.finish());
        }
    }
}
