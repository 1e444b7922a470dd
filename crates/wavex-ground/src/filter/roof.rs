//! Roofs that the growth has climbed.

use super::nodes::Nodes;

/// Nodes are neighbours within this distance, in spacings of nodes, at least [`NEAREST_RINGS`] cells.
const NEIGHBOURS: f64 = 1.5;
/// See [`NEIGHBOURS`].
const NEAREST_RINGS: usize = 2;
/// Height difference of neighbours on one smooth surface, m, besides a slope.
const STEP_M: f64 = 0.3;
/// Slope of a surface that continues.
const REGION_SLOPE: f64 = 0.5;
/// Slope by which the outline of a region goes on to the ground below.
const OUTLINE_SLOPE: f64 = 1.0;
/// Smallest part of the outline that does so.
const SMALLEST_PART: f64 = 1.0 / 3.0;
/// Smaller regions have too few neighbours to decide.
const FEWEST_NODES: usize = 5;

/// Drops regions of grown ground whose outline is a step for more than two thirds.
///
/// A roof that the growth has climbed at one place ends with walls elsewhere. Banks and edges of cliffs go on to the ground
/// that the openings have left, at least on one side. Regions without such ground around them stay.
pub(super) fn drop_roofs(nodes: &Nodes, is_bare: &[bool], spacing: f64, is_ground: &mut [bool]) {
    let rings = ((NEIGHBOURS * spacing).ceil() as usize).max(NEAREST_RINGS);
    let mut is_seen = vec![false; nodes.len()];
    for first in 0..nodes.len() {
        if is_seen[first] || is_bare[first] || !is_ground[first] {
            continue;
        }
        is_seen[first] = true;
        let mut region = vec![first];
        let (mut n_smooth, mut n_outline, mut next) = (0usize, 0usize, 0);
        while let Some(&node) = region.get(next) {
            next += 1;
            nodes.for_each_within(node, rings, |other, _| {
                if !is_ground[other] {
                    return;
                }
                if is_bare[other] {
                    n_outline += 1;
                    n_smooth += usize::from(nodes.is_smooth(node, other, STEP_M, OUTLINE_SLOPE));
                } else if !is_seen[other] && nodes.is_smooth(node, other, STEP_M, REGION_SLOPE) {
                    is_seen[other] = true;
                    region.push(other);
                }
            });
        }
        if region.len() >= FEWEST_NODES && (n_smooth as f64) < SMALLEST_PART * n_outline as f64 {
            region.into_iter().for_each(|node| is_ground[node] = false);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::raster::{Grid, lowest};

    /// Which of 40 by 40 nodes, 1 m apart, are kept. All are ground, and `bare` if the openings leave them.
    fn kept(height: impl Fn(f64, f64) -> (f64, bool)) -> Vec<bool> {
        let grid = Grid::covering([0.0; 2], [39.0; 2], 1.0);
        let (positions_m, is_bare): (Vec<[f64; 3]>, Vec<bool>) = (0..1600)
            .map(|index| {
                let (x, y) = (f64::from(index % 40) + 0.5, f64::from(index / 40) + 0.5);
                let (z, is_bare) = height(x, y);
                ([x, y, z], is_bare)
            })
            .unzip();
        let nodes = Nodes::new(&grid, &positions_m, &lowest(&grid, &positions_m, |_| true));
        let mut is_ground = vec![true; 1600];
        drop_roofs(&nodes, &is_bare, 1.0, &mut is_ground);
        is_ground
    }

    fn is_inside(x: f64, y: f64) -> bool {
        (10.0..30.0).contains(&x) && (10.0..30.0).contains(&y)
    }

    #[test]
    fn a_roof_with_a_ramp_is_dropped() {
        let is_kept = kept(|x, y| {
            let is_ramp = (1.0..10.0).contains(&x) && (18.0..21.0).contains(&y);
            let height_m = if is_inside(x, y) {
                5.0
            } else if is_ramp {
                (x - 1.0) / 2.0
            } else {
                0.0
            };
            (height_m, !is_inside(x, y) && !is_ramp)
        });
        assert!(!is_kept[20 * 40 + 20]);
        assert!(is_kept[5 * 40 + 5]);
    }

    #[test]
    fn an_edge_that_continues_on_one_side_is_kept() {
        assert!(
            kept(|x, y| (if x < 20.0 { 9.0 } else { 0.0 }, !is_inside(x, y))).into_iter().all(|kept| kept)
        );
    }

    #[test]
    fn a_few_nodes_and_islands_are_kept() {
        assert!(
            kept(|x, y| (if x < 2.0 && y < 2.0 { 5.0 } else { 0.0 }, x > 2.0 || y > 2.0))
                .into_iter()
                .all(|kept| kept)
        );
        assert!(kept(|x, y| (if is_inside(x, y) { 5.0 } else { 0.0 }, false)).into_iter().all(|kept| kept));
    }
}
