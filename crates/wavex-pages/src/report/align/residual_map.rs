//! Residuals on the ground: a grid of cells around the middle of the survey.

use wavex_align::observation::Observation;
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::frames::{LocalFrame, Vector, inverse, rotate};

use crate::plot::{MapFrame, extent};

/// Cells along the longer side.
const CELLS: f64 = 160.0;
/// Smallest edge of a cell, m: that of a patch.
const LEAST_CELL_M: f64 = 3.0;
/// Most marks of rejected pairs.
const MOST_MARKS: usize = 1500;

/// Sums of a cell.
#[derive(Clone, Copy, Default)]
struct Cell {
    used: u32,
    sum_m: f64,
    rejected: u32,
}

/// Residuals by cells of the ground.
pub(super) struct ResidualMap {
    pub(super) frame: MapFrame,
    pub(super) columns: usize,
    pub(super) cell_m: f64,
    /// Origin of the coordinates.
    pub(super) middle: Geodetic,
    /// Places of rejected pairs, at most [`MOST_MARKS`], spread over all.
    pub(super) rejected: Vec<[f64; 2]>,
    /// Rows from north to south.
    cells: Vec<Cell>,
}

impl ResidualMap {
    /// `None` without observations.
    pub(super) fn new(observations: &[Observation]) -> Option<ResidualMap> {
        let n = observations.len().max(1) as f64;
        let mean = |axis: usize| observations.iter().map(|one| one.place_in_ecef_m[axis]).sum::<f64>() / n;
        let origin_m: Vector = std::array::from_fn(mean);
        let middle = WGS84.geodetic_of(origin_m);
        let local_from_ecef = inverse(LocalFrame::at(WGS84, middle).ecef_from_local());
        let place = |one: &Observation| {
            let offset_m = std::array::from_fn(|axis| one.place_in_ecef_m[axis] - origin_m[axis]);
            let [east_m, north_m, _] = rotate(&local_from_ecef, offset_m);
            [east_m, north_m]
        };
        let places: Vec<[f64; 2]> = observations.iter().map(place).collect();
        let [west_m, east_m] = extent(places.iter().map(|place| place[0]));
        let [south_m, north_m] = extent(places.iter().map(|place| place[1]));
        let (width_m, height_m) = (east_m - west_m, north_m - south_m);
        if !(width_m.is_finite() && height_m.is_finite()) {
            return None;
        }
        let cell_m = (width_m.max(height_m) / CELLS).max(LEAST_CELL_M);
        // A margin of one cell on each side.
        let (west_m, north_m) = (west_m - cell_m, north_m + cell_m);
        let count = |length_m: f64| (length_m / cell_m).ceil() as usize + 2;
        let (columns, rows) = (count(width_m), count(height_m));
        let mut cells = vec![Cell::default(); columns * rows];
        for (place, one) in places.iter().zip(observations) {
            let (column, row) = ((place[0] - west_m) / cell_m, (north_m - place[1]) / cell_m);
            let Some(cell) = cells.get_mut(row as usize * columns + column as usize) else { continue };
            if one.is_used {
                cell.used += 1;
                cell.sum_m += one.after_m;
            } else {
                cell.rejected += 1;
            }
        }
        let of_rejected = places.iter().zip(observations).filter(|(_, one)| !one.is_used);
        let rejected: Vec<[f64; 2]> = of_rejected.map(|(place, _)| *place).collect();
        let every = rejected.len().div_ceil(MOST_MARKS).max(1);
        let (x, y) = ([west_m, west_m + columns as f64 * cell_m], [north_m - rows as f64 * cell_m, north_m]);
        Some(ResidualMap {
            frame: MapFrame::new(x, y, 1.0, ["east, m", "north, m"].map(str::to_owned)),
            columns,
            cell_m,
            middle,
            rejected: rejected.into_iter().step_by(every).collect(),
            cells,
        })
    }

    /// Mean of the used residuals of each cell, m.
    pub(super) fn means_m(&self) -> Vec<Option<f64>> {
        self.cells.iter().map(|cell| (cell.used > 0).then(|| cell.sum_m / f64::from(cell.used))).collect()
    }

    /// Share of rejected pairs of each cell, percent.
    pub(super) fn rejected_percent(&self) -> Vec<Option<f64>> {
        let share = |cell: &Cell| {
            let all = f64::from(cell.used) + f64::from(cell.rejected);
            (all > 0.0).then(|| 100.0 * f64::from(cell.rejected) / all)
        };
        self.cells.iter().map(share).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn observation(east_m: f64, after_m: f64, is_used: bool) -> Observation {
        let middle = Geodetic { latitude_rad: 0.0, longitude_rad: 0.0, height_m: 0.0 };
        let [x, _, z] = WGS84.ecef_of(middle);
        Observation {
            strips: [0, 1],
            place_in_ecef_m: [x, east_m, z],
            normal_in_ecef: [1.0, 0.0, 0.0],
            times_s: [0.0; 2],
            before_m: None,
            after_m,
            sd_m: 0.01,
            is_used,
        }
    }

    #[test]
    fn cells_have_means_and_shares() {
        assert!(ResidualMap::new(&[]).is_none());
        let all = [(0.0, 0.01, true), (0.5, 0.03, true), (0.7, 9.0, false), (30.0, 0.5, false)];
        let all = all.map(|(east_m, after_m, is_used)| observation(east_m, after_m, is_used));
        let map = ResidualMap::new(&all).unwrap();
        let means: Vec<f64> = map.means_m().into_iter().flatten().collect();
        assert_eq!(means.len(), 1, "a cell of rejected pairs alone has no mean");
        assert!((means[0] - 0.02).abs() < 1e-12, "{means:?}");
        let shares: Vec<f64> = map.rejected_percent().into_iter().flatten().collect();
        assert!((shares[0] - 100.0 / 3.0).abs() < 1e-9 && shares[1] == 100.0, "{shares:?}");
        assert_eq!((map.cell_m, map.rejected.len()), (3.0, 2));
        // Many marks are thinned, and none is invented.
        let many: Vec<Observation> = (0..4000).map(|k| observation(f64::from(k), 0.5, false)).collect();
        let map = ResidualMap::new(&many).unwrap();
        assert!((700..=MOST_MARKS).contains(&map.rejected.len()), "{}", map.rejected.len());
    }
}
