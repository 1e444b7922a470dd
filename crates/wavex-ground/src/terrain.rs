//! Terrain model from ground points, with the standard deviation of each height.
//!
//! The heights of ground points are the terrain, plus noise that is independent from point to point, plus an
//! error that the points of a strip share. A model of an area ([`learn_terrain`]) holds what its points say
//! of roughness and noise. [`terrain_of_tile`] predicts the height at each cell's centre from the points
//! around it, with roughness and noise estimated there.
//!
//! Cells are aligned to multiples of their size, and depend on the points within [`TerrainOptions::margin_m`]
//! of their tile: tiles of any size give the same cells, in any order, with any number of threads.

mod kriging;
mod learn;
mod mask;
mod model;
mod neighbours;
#[cfg(test)]
mod tests;

use rayon::prelude::*;

use crate::point::CloudPoint;
pub use kriging::Smoothness;
use kriging::Target;
pub use learn::learn_terrain;
pub use model::{Assumption, PointSds, TerrainModel};
use model::{NODE_M, NODE_REACH_M, Scratch, data_of};
use neighbours::PointIndex;

/// Limits of the interpolation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TerrainOptions {
    /// Widest gap between points that is filled, m: cells in Delaunay triangles whose circumscribed circle
    /// is wider have no data.
    pub widest_gap_m: f64,
}

impl Default for TerrainOptions {
    fn default() -> TerrainOptions {
        TerrainOptions { widest_gap_m: 50.0 }
    }
}

impl TerrainOptions {
    /// Distance around a tile from which its cells need points, m.
    pub fn margin_m(&self) -> f64 {
        self.widest_gap_m.max(NODE_REACH_M + NODE_M * std::f64::consts::SQRT_2)
    }
}

/// Cells of a tile; cell (column, row) covers `cell_m` times `[column, column + 1)` and `[row, row + 1)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CellRange {
    /// First column from the west, in cells from the origin of the coordinates.
    pub first_column: i64,
    /// Last row in cells from the origin, the northernmost.
    pub north_row: i64,
    /// Number of columns.
    pub columns: usize,
    /// Number of rows.
    pub rows: usize,
}

/// Values of the cells of a tile, row by row from the north-west; NaN: no data.
#[derive(Clone, Debug, PartialEq)]
pub struct TerrainTile {
    /// Heights at the centres of cells, m.
    pub height_m: Vec<f32>,
    /// SDs of the heights, m.
    pub sd_m: Vec<f32>,
    /// Number of ground points in the cell.
    pub n_points: Vec<f32>,
    /// Horizontal distance from the centre to the nearest ground point, m.
    pub distance_m: Vec<f32>,
}

/// Predicts the terrain at the cells of a tile from the ground points within its margin.
pub fn terrain_of_tile(
    points: &[CloudPoint],
    cells: CellRange,
    cell_m: f64,
    model: &TerrainModel,
    options: &TerrainOptions,
) -> TerrainTile {
    let n = cells.columns * cells.rows;
    let index = PointIndex::new(points);
    let x: Vec<f64> =
        (0..cells.columns).map(|c| ((cells.first_column + c as i64) as f64 + 0.5) * cell_m).collect();
    let y: Vec<f64> = (0..cells.rows).map(|r| ((cells.north_row - r as i64) as f64 + 0.5) * cell_m).collect();
    let mut tile = TerrainTile {
        height_m: vec![f32::NAN; n],
        sd_m: vec![f32::NAN; n],
        n_points: vec![0.0; n],
        distance_m: vec![f32::NAN; n],
    };
    for point in index.points() {
        let column = (point.position_m[0] / cell_m).floor() - cells.first_column as f64;
        let row = cells.north_row as f64 - (point.position_m[1] / cell_m).floor();
        if (0.0..cells.columns as f64).contains(&column) && (0.0..cells.rows as f64).contains(&row) {
            tile.n_points[row as usize * cells.columns + column as usize] += 1.0;
        }
    }
    let mask = mask::covered(&index, [&x, &y], 0.5 * options.widest_gap_m);
    let nodes = Nodes::new(&index, [&x, &y], &mask, model);
    let values: Vec<[f32; 3]> = (0..n)
        .into_par_iter()
        .map_init(Scratch::default, |scratch, i| {
            let at = [x[i % cells.columns], y[i / cells.columns]];
            if !mask[i] && tile.n_points[i] == 0.0 {
                return [f32::NAN; 3];
            }
            index.around(at, -1.0, options.widest_gap_m, &mut scratch.found);
            let Some(nearest) = scratch.found.first() else { return [f32::NAN; 3] };
            let distance_m = nearest.distance_squared.sqrt();
            let parts = model.parts(nodes.at(at));
            data_of(&index, model.typical_sd_m, &scratch.found, &mut scratch.data);
            match scratch.kriging.predict(&mut scratch.data, model.smoothness, parts, Target::Height, &[]) {
                Some(found) => {
                    let sd = model.total(found.variance, distance_m).sqrt();
                    [found.height_m as f32, sd as f32, distance_m as f32]
                }
                None => [f32::NAN; 3],
            }
        })
        .collect();
    for (i, [height, sd, distance]) in values.into_iter().enumerate() {
        (tile.height_m[i], tile.sd_m[i], tile.distance_m[i]) = (height, sd, distance);
    }
    tile
}

/// Roughness and noise at the nodes of a grid that is aligned to its spacing.
#[derive(Debug)]
struct Nodes {
    first: [i64; 2],
    columns: usize,
    variances: Vec<[f64; 2]>,
}

impl Nodes {
    /// Estimates the nodes around the cells that have data.
    fn new(index: &PointIndex, [x, y]: [&[f64]; 2], mask: &[bool], model: &TerrainModel) -> Nodes {
        let floor = |v: f64| (v / NODE_M).floor() as i64;
        let (Some(west), Some(east), Some(north), Some(south)) = (x.first(), x.last(), y.first(), y.last())
        else {
            return Nodes { first: [0; 2], columns: 1, variances: Vec::new() };
        };
        let first = [floor(*west), floor(*south)];
        let size = [floor(*east) - first[0] + 2, floor(*north) - first[1] + 2].map(|n| n as usize);
        let mut is_used = vec![false; size[0] * size[1]];
        for (i, _) in mask.iter().enumerate() {
            let [column, row] = [floor(x[i % x.len()]) - first[0], floor(y[i / x.len()]) - first[1]];
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                is_used[(row + dy) as usize * size[0] + (column + dx) as usize] = true;
            }
        }
        let variances = is_used
            .par_iter()
            .enumerate()
            .map_init(Scratch::default, |scratch, (k, is_used)| {
                if !is_used {
                    return [0.0; 2];
                }
                let at = [first[0] + (k % size[0]) as i64, first[1] + (k / size[0]) as i64];
                model.variances_at(index, at.map(|i| i as f64 * NODE_M), -1.0, scratch)
            })
            .collect();
        Nodes { first, columns: size[0], variances }
    }

    /// Variances of terrain and noise, interpolated between nodes, m².
    fn at(&self, at: [f64; 2]) -> [f64; 2] {
        let position = at.map(|v| v / NODE_M);
        let corner = position.map(|v| v.floor());
        let part = [position[0] - corner[0], position[1] - corner[1]];
        let column = (corner[0] as i64 - self.first[0]) as usize;
        let row = (corner[1] as i64 - self.first[1]) as usize;
        let mut mean = [0.0; 2];
        for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let weight =
                if dx == 1 { part[0] } else { 1.0 - part[0] } * if dy == 1 { part[1] } else { 1.0 - part[1] };
            let of_node = self.variances[(row + dy) * self.columns + column + dx];
            mean[0] += weight * of_node[0];
            mean[1] += weight * of_node[1];
        }
        mean
    }
}
