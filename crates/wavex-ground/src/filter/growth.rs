//! Growth of the ground from the cells that the openings leave.

use super::GroundSettings;
use super::local_plane::{LocalPlane, Neighbourhood, fit};
use super::raster::{EMPTY, Grid};

/// Neighbours on all sides of a cell.
const AROUND: Neighbourhood =
    Neighbourhood { count: 12, complete_within: None, side: [0.0; 2], damping: 0.5 };

/// Neighbours on one side: at edges of terraces and cliffs the ground continues on one side only.
const BESIDE: Neighbourhood =
    Neighbourhood { count: 8, complete_within: Some(6), side: [0.0; 2], damping: 1.0 };

/// A point below the ground around it by more than this multiple of the largest height above it is dropped.
const LOWER_BY: f64 = 2.0;

/// Decides each cell again, from planes through the ground around it, until nothing changes.
///
/// A cell without three neighbours stays as it is. Another is ground if its lowest point is near the plane through its surroundings, or near one through the ground on one
/// side of it. Progressive densification after Axelsson (2000) with planes instead of the facets of a triangulation: a
/// plane averages noise, and its residuals say how rough the ground is.
pub(super) fn grow(
    grid: &Grid,
    positions_m: &[[f64; 3]],
    cells: &[usize],
    is_ground: &mut [bool],
    settings: &GroundSettings,
) {
    for _ in 0..settings.growth_passes {
        let before = is_ground.to_vec();
        let plane =
            |cell: usize, around: &Neighbourhood| fit(grid, positions_m, cells, &before, cell, around);
        let mut is_changed = false;
        for cell in (0..grid.len()).filter(|&cell| cells[cell] != EMPTY) {
            is_ground[cell] = plane(cell, &AROUND).map_or(before[cell], |around| {
                is_near(&around, before[cell], settings)
                    || sides().any(|side| {
                        plane(cell, &Neighbourhood { side, ..BESIDE }).is_some_and(|beside| {
                            beside.height_m.abs() <= settings.side_m + settings.side_roughness * beside.rms_m
                        })
                    })
            });
            is_changed |= is_ground[cell] != before[cell];
        }
        if !is_changed {
            break;
        }
    }
}

/// Whether a point is near the plane around it; points that were ground before may be farther, so that decisions settle.
fn is_near(around: &LocalPlane, was_ground: bool, settings: &GroundSettings) -> bool {
    let [east, north] = around.gradient;
    let slope = (east * east + north * north).sqrt();
    let limit = settings.plane_m + around.rms_m + settings.plane_slope_m * slope;
    let limit = if was_ground { 1.2 * limit } else { limit };
    -around.height_m <= limit && around.height_m <= LOWER_BY * limit
}

/// Eight directions.
fn sides() -> impl Iterator<Item = [f64; 2]> {
    let half = core::f64::consts::FRAC_1_SQRT_2;
    [
        [1.0, 0.0],
        [half, half],
        [0.0, 1.0],
        [-half, half],
        [-1.0, 0.0],
        [-half, -half],
        [0.0, -1.0],
        [half, -half],
    ]
    .into_iter()
}
