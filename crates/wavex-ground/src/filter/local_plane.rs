//! Planes through the ground around a point.

use super::nodes::Nodes;

/// Rings of cells that are always used.
const NEAREST_RINGS: usize = 2;
/// Rings of the first search, in spacings of nodes: most planes have enough neighbours there.
const FIRST_SEARCH: f64 = 2.0;

/// A ground point near another one.
#[derive(Clone, Copy, Debug)]
struct Neighbour {
    /// Position relative to the other point, m.
    offset_m: [f64; 3],
    /// Distance, in cells along the axis in which it is larger.
    ring: usize,
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
    /// Smallest number of neighbours, at least three.
    pub(super) at_least: usize,
    /// Farthest ring.
    pub(super) rings: usize,
    /// Only neighbours on this side (unit vector) of the point; zeros for all.
    pub(super) side: [f64; 2],
    /// Variance of positions, in cells², that is added to the neighbours' own. It keeps the slopes of one-sided and
    /// collinear neighbours small.
    pub(super) damping: f64,
}

/// Ground around one node, without the node itself. It is searched only as far as planes need it.
pub(super) struct Surroundings<'a> {
    nodes: &'a Nodes,
    is_ground: &'a [bool],
    node: usize,
    neighbours: Vec<Neighbour>,
    /// Neighbours of the current plane.
    used: Vec<Neighbour>,
    /// Number of neighbours on the side of the plane, by ring.
    n_of_ring: Vec<usize>,
    /// Rings that have been searched.
    rings: usize,
    /// Rings of the first search.
    first_rings: usize,
}

impl<'a> Surroundings<'a> {
    /// `spacing` is the distance of nodes in cells.
    pub(super) fn new(nodes: &'a Nodes, is_ground: &'a [bool], spacing: f64) -> Surroundings<'a> {
        Surroundings {
            nodes,
            is_ground,
            node: 0,
            neighbours: Vec::with_capacity(256),
            used: Vec::with_capacity(256),
            n_of_ring: Vec::with_capacity(64),
            rings: 0,
            first_rings: NEAREST_RINGS.max((FIRST_SEARCH * spacing) as usize),
        }
    }

    /// Continues with another node.
    pub(super) fn move_to(&mut self, node: usize) {
        self.node = node;
        self.rings = 0;
    }

    /// Rings on which the planes of this node depend.
    pub(super) fn rings(&self) -> usize {
        self.rings
    }

    fn search(&mut self, rings: usize) {
        let Surroundings { nodes, is_ground, node, neighbours, .. } = self;
        neighbours.clear();
        let position = nodes.positions_m[*node];
        let cell_m2 = nodes.cell_m * nodes.cell_m;
        nodes.for_each_within(*node, rings, |other, ring| {
            if is_ground[other] {
                let offset_m = [0, 1, 2].map(|axis| nodes.positions_m[other][axis] - position[axis]);
                let [x, y, _] = offset_m;
                neighbours.push(Neighbour {
                    offset_m,
                    ring,
                    weight: 1.0 / (0.5 + (x * x + y * y) / cell_m2),
                });
            }
        });
        self.rings = rings;
    }

    /// Fits a plane to the ground around the node. Weights fall with the square of the distance.
    ///
    /// `None` with too few neighbours.
    pub(super) fn fit(&mut self, around: &Neighbourhood) -> Option<LocalPlane> {
        let cell_m = self.nodes.cell_m;
        let mut rings = self.rings.max(self.first_rings).min(around.rings);
        loop {
            if rings > self.rings {
                self.search(rings);
            }
            self.used.clear();
            self.n_of_ring.clear();
            self.n_of_ring.resize(rings + 1, 0);
            for neighbour in self.neighbours.iter().filter(|neighbour| neighbour.ring <= rings) {
                let [x, y, _] = neighbour.offset_m;
                if around.side[0] * x + around.side[1] * y >= -0.25 * cell_m {
                    self.n_of_ring[neighbour.ring] += 1;
                    self.used.push(*neighbour);
                }
            }
            if self.used.len() >= around.count || rings == around.rings {
                break;
            }
            rings = (rings + 2).max(rings * 3 / 2).min(around.rings);
        }
        let mut n_used = 0;
        let ring = self.n_of_ring.iter().enumerate().position(|(ring, n)| {
            n_used += n;
            ring >= NEAREST_RINGS && n_used >= around.count
        });
        if let Some(ring) = ring {
            self.used.retain(|neighbour| neighbour.ring <= ring);
        }
        (self.used.len() >= around.at_least).then(|| plane(&self.used, around.damping * cell_m * cell_m))
    }
}

/// Weighted least squares: height and slopes about the mean position, and the RMS.
fn plane(neighbours: &[Neighbour], damping_m2: f64) -> LocalPlane {
    let (mut sum_weights, mut mean) = (0.0, [0.0; 3]);
    for neighbour in neighbours {
        sum_weights += neighbour.weight;
        for (sum, offset) in mean.iter_mut().zip(neighbour.offset_m) {
            *sum += neighbour.weight * offset;
        }
    }
    let mean = mean.map(|sum| sum / sum_weights);
    let damping = damping_m2 * sum_weights;
    let (mut xx, mut xy, mut yy, mut xz, mut yz) = (damping, 0.0, damping, 0.0, 0.0);
    for &Neighbour { offset_m, weight, .. } in neighbours {
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
        .map(|&Neighbour { offset_m: [x, y, z], weight, .. }| {
            let residual = z - height_m - gradient[0] * x - gradient[1] * y;
            weight * residual * residual
        })
        .sum();
    LocalPlane { height_m, gradient, rms_m: (squares / sum_weights).sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::filter::raster::{Grid, lowest};

    /// A plane that rises to the east up to 10 m, and a wall beyond.
    fn nodes() -> (Nodes, usize) {
        let grid = Grid::covering([0.0; 2], [20.0; 2], 1.0);
        let positions_m: Vec<[f64; 3]> = (0..441)
            .map(|index| [f64::from(index % 21) + 0.5, f64::from(index / 21) + 0.5])
            .map(|[x, y]| [x, y, if x <= 11.0 { 0.1 * x } else { 30.0 }])
            .collect();
        (Nodes::new(&grid, &positions_m, &lowest(&grid, &positions_m, |_| true)), 10 * 21 + 10)
    }

    const WEST: Neighbourhood =
        Neighbourhood { count: 8, at_least: 8, rings: 6, side: [-1.0, 0.0], damping: 0.0 };

    #[test]
    fn planes_use_one_side_only() {
        let (nodes, node) = nodes();
        let is_ground = vec![true; nodes.len()];
        let mut surroundings = Surroundings::new(&nodes, &is_ground, 1.0);
        surroundings.move_to(node);
        let west = surroundings.fit(&WEST).unwrap();
        assert!(west.height_m.abs() < 1e-9 && west.rms_m < 1e-9 && (west.gradient[0] - 0.1).abs() < 1e-9);
        let around = surroundings.fit(&Neighbourhood { side: [0.0; 2], ..WEST }).unwrap();
        assert!(around.rms_m > 1.0);
    }

    #[test]
    fn rings_are_added_until_there_are_enough_neighbours() {
        let (nodes, node) = nodes();
        let only = |distance: f64| -> Vec<bool> {
            nodes.positions_m.iter().map(|position| (10.5 - position[0]).abs() >= distance).collect()
        };
        let is_found = |is_ground: &[bool], around: Neighbourhood| {
            let mut surroundings = Surroundings::new(&nodes, is_ground, 1.0);
            surroundings.move_to(node);
            surroundings.fit(&around).is_some()
        };
        assert!(is_found(&only(5.0), WEST));
        assert!(!is_found(&only(5.0), Neighbourhood { rings: 4, ..WEST }));
        assert!(!is_found(&only(6.0), Neighbourhood { at_least: 14, count: 14, ..WEST }));
    }
}
