//! Growth of the ground from the cells that the openings leave.

use super::GroundSettings;
use super::local_plane::{LocalPlane, Neighbourhood, Surroundings};
use super::nodes::Nodes;

/// A point below the ground around it by more than this multiple of the largest height above it is dropped.
const LOWER_BY: f64 = 2.0;

/// Growth of the ground of a tile. It keeps what each decision depends on.
pub(super) struct Growth<'a> {
    nodes: &'a Nodes,
    /// Distance of nodes in cells. Neighbours are searched as far as a constant number of them needs.
    spacing: f64,
    around: Neighbourhood,
    beside: Neighbourhood,
    /// Rings on which the last decision of each node depends.
    depends_on: Vec<usize>,
    /// Ground at the start of the last pass; empty before the first.
    last: Vec<bool>,
}

impl<'a> Growth<'a> {
    pub(super) fn new(nodes: &'a Nodes, spacing: f64) -> Growth<'a> {
        let rings = |n: f64| (n * spacing).round() as usize;
        let around =
            Neighbourhood { count: 12, at_least: 3, rings: rings(12.0), side: [0.0; 2], damping: 0.5 };
        // At edges of terraces and cliffs the ground continues on one side only.
        let beside = Neighbourhood { count: 8, at_least: 8, rings: rings(6.0), side: [0.0; 2], damping: 1.0 };
        Growth { nodes, spacing, around, beside, depends_on: vec![0; nodes.len()], last: Vec::new() }
    }

    /// Decides each node again, from planes through the ground around it, until nothing changes or for `passes`.
    ///
    /// A node is ground if it is near the plane through its surroundings, or near one through the ground on one side of
    /// it. A node without three neighbours stays as it is. Progressive densification after Axelsson (2000) with planes
    /// instead of the facets of a triangulation: a plane averages noise, and its residuals say how rough the ground is.
    pub(super) fn grow(&mut self, is_ground: &mut [bool], passes: usize, settings: &GroundSettings) {
        for _ in 0..passes {
            let due = self.due(is_ground);
            if due.is_empty() {
                break;
            }
            let before = is_ground.to_vec();
            let mut surroundings = Surroundings::new(self.nodes, &before, self.spacing);
            for node in due {
                surroundings.move_to(node);
                is_ground[node] = surroundings.fit(&self.around).map_or(before[node], |plane| {
                    is_near(&plane, before[node], settings)
                        || SIDES.iter().any(|&side| {
                            surroundings.fit(&Neighbourhood { side, ..self.beside }).is_some_and(|plane| {
                                let limit = settings.side_m + settings.side_roughness * plane.rms_m;
                                plane.height_m.abs() <= limit
                            })
                        })
                });
                self.depends_on[node] = surroundings.rings();
            }
            self.last = before;
        }
    }

    /// Nodes whose decision may differ from the last: they, or nodes on which they depend, have changed.
    fn due(&self, is_ground: &[bool]) -> Vec<usize> {
        let mut is_due = vec![self.last.is_empty(); is_ground.len()];
        let farthest = self.depends_on.iter().copied().max().unwrap_or_default();
        for (node, last) in self.last.iter().enumerate() {
            if is_ground[node] != *last {
                is_due[node] = true;
                self.nodes.for_each_within(node, farthest, |other, ring| {
                    is_due[other] |= ring <= self.depends_on[other];
                });
            }
        }
        (0..is_due.len()).filter(|&node| is_due[node]).collect()
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

const HALF: f64 = core::f64::consts::FRAC_1_SQRT_2;

/// Eight directions.
const SIDES: [[f64; 2]; 8] = [
    [1.0, 0.0],
    [HALF, HALF],
    [0.0, 1.0],
    [-HALF, HALF],
    [-1.0, 0.0],
    [-HALF, -HALF],
    [0.0, -1.0],
    [HALF, -HALF],
];

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::raster::{Grid, lowest};

    /// A node is decided again only if a node on which it depends has changed. This must not change the result.
    #[test]
    fn passes_skip_only_nodes_that_would_not_change() {
        let grid = Grid::covering([0.0; 2], [199.0; 2], 1.0);
        let positions_m: Vec<[f64; 3]> = (0..9000u32)
            .map(|index| {
                let random = |factor: u32| f64::from(index.wrapping_mul(factor) >> 8 & 0xffff) / 65536.0;
                let (x, y) = (200.0 * random(2654435761), 200.0 * random(2246822519));
                let bumps = 3.0 * (x / 17.0).sin() * (y / 23.0).cos() + if x > 120.0 { 7.0 } else { 0.0 };
                let plant = if random(3266489917) > 0.8 { 2.0 * random(668265263) } else { 0.0 };
                [x, y, bumps + plant]
            })
            .collect();
        let nodes = Nodes::new(&grid, &positions_m, &lowest(&grid, &positions_m, |_| true));
        let mut is_ground: Vec<bool> =
            (0..nodes.len()).map(|node| nodes.positions_m[node][0] < 30.0).collect();
        let settings = GroundSettings::default();
        let mut one_by_one = is_ground.clone();
        Growth::new(&nodes, 2.1).grow(&mut is_ground, 6, &settings);
        (0..6).for_each(|_| Growth::new(&nodes, 2.1).grow(&mut one_by_one, 1, &settings));
        let n_ground = is_ground.iter().filter(|&&is_ground| is_ground).count();
        assert!((nodes.len() / 2..nodes.len() - 100).contains(&n_ground), "{n_ground}");
        let n_different = is_ground.iter().zip(&one_by_one).filter(|(a, b)| a != b).count();
        assert_eq!(n_different, 0);
    }
}
