//! Planes through the ground around a point.

use super::raster::{EMPTY, Grid};

/// Farthest ring of cells that is searched for neighbours.
const FARTHEST_RING: usize = 12;

/// A ground point near another one.
#[derive(Clone, Copy, Debug)]
struct Neighbour {
    /// Position relative to the other point, m.
    offset_m: [f64; 3],
    weight: f64,
}

/// A plane through ground points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct LocalPlane {
    /// Height of the plane relative to the point, m.
    pub(super) height_m: f64,
    /// Slopes (tangents) to the east and north.
    pub(super) gradient: [f64; 2],
    /// Weighted RMS of the residuals, m.
    pub(super) rms_m: f64,
}

/// Which neighbours a plane is fitted to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Neighbourhood {
    /// Rings of cells are added until this number of neighbours is reached.
    pub(super) count: usize,
    /// Farthest ring; `None` is returned if it has fewer neighbours than `count`.
    pub(super) complete_within: Option<usize>,
    /// Only neighbours on this side (unit vector) of the point; zeros for all.
    pub(super) side: [f64; 2],
    /// Variance of positions, in cells², that is added to the neighbours' own. It keeps the slopes of one-sided and
    /// collinear neighbours small.
    pub(super) damping: f64,
}

/// Fits a plane to the ground cells around a cell, without the cell itself.
///
/// Weights fall with the square of the distance. `None` with fewer than three neighbours.
pub(super) fn fit(
    grid: &Grid,
    positions_m: &[[f64; 3]],
    cells: &[usize],
    is_ground: &[bool],
    cell: usize,
    around: &Neighbourhood,
) -> Option<LocalPlane> {
    let position = positions_m[cells[cell]];
    let mut neighbours = Vec::with_capacity(64);
    let farthest = around.complete_within.unwrap_or(FARTHEST_RING);
    for ring in 1..=farthest {
        grid.for_each_in_ring(cell, ring, |at| {
            if cells[at] == EMPTY || !is_ground[at] {
                return;
            }
            let other = positions_m[cells[at]];
            let offset_m = [0, 1, 2].map(|axis| other[axis] - position[axis]);
            let [x, y, _] = offset_m;
            if around.side[0] * x + around.side[1] * y >= -0.25 * grid.cell_m {
                let distance_cells2 = (x * x + y * y) / (grid.cell_m * grid.cell_m);
                neighbours.push(Neighbour { offset_m, weight: 1.0 / (0.5 + distance_cells2) });
            }
        });
        if neighbours.len() >= around.count && ring >= 2 {
            break;
        }
    }
    let is_complete = neighbours.len() >= around.count || around.complete_within.is_none();
    (is_complete && neighbours.len() >= 3)
        .then(|| plane(&neighbours, around.damping * grid.cell_m * grid.cell_m))
}

/// Weighted least squares: height and slopes about the mean position, and the RMS.
fn plane(neighbours: &[Neighbour], damping_m2: f64) -> LocalPlane {
    let sum_weights: f64 = neighbours.iter().map(|neighbour| neighbour.weight).sum();
    let mean = [0, 1, 2].map(|axis| {
        neighbours.iter().map(|neighbour| neighbour.weight * neighbour.offset_m[axis]).sum::<f64>()
            / sum_weights
    });
    let damping = damping_m2 * sum_weights;
    let (mut xx, mut xy, mut yy, mut xz, mut yz) = (damping, 0.0, damping, 0.0, 0.0);
    for &Neighbour { offset_m, weight } in neighbours {
        let [x, y, z] = [0, 1, 2].map(|axis| offset_m[axis] - mean[axis]);
        xx += weight * x * x;
        xy += weight * x * y;
        yy += weight * y * y;
        xz += weight * x * z;
        yz += weight * y * z;
    }
    let determinant = xx * yy - xy * xy;
    let gradient = [(xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant];
    let height_m = mean[2] - gradient[0] * mean[0] - gradient[1] * mean[1];
    let squares: f64 = neighbours
        .iter()
        .map(|&Neighbour { offset_m: [x, y, z], weight }| {
            let residual = z - height_m - gradient[0] * x - gradient[1] * y;
            weight * residual * residual
        })
        .sum();
    LocalPlane { height_m, gradient, rms_m: (squares / sum_weights).sqrt() }
}
