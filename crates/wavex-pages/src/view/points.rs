//! Points of all inputs in bounded memory, ordered by a quadtree over x and y.

use std::ops::Range;

use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};

use wavex_line::scan_line::Return;

/// Largest number of points of a node.
const NODE_POINTS: usize = 20_000;
/// Largest depth; deeper nodes keep all of their points.
const MAX_LEVEL: u8 = 24;
/// At most one of 2^32 shots is kept.
const MAX_THINNING: u32 = 32;

/// A point with the quantities that the page can show.
#[derive(Clone, Copy, Debug)]
pub(super) struct ViewPoint {
    /// Shot in its input.
    pub(super) shot: u64,
    /// Position relative to the origin of the view, m.
    pub(super) position_m: [f32; 3],
    pub(super) intensity: f32,
    pub(super) amplitude_dn: f32,
    pub(super) deviation_ratio: f32,
    pub(super) total_sd_m: f32,
    pub(super) range_sd_m: f32,
    pub(super) width_ratio: f32,
    pub(super) flags: u16,
    pub(super) mta_zone: i16,
    /// Index of the input.
    pub(super) input: u16,
    pub(super) return_number: u8,
    pub(super) number_of_returns: u8,
    pub(super) class: u8,
    /// Whether it is marked as an outlier.
    pub(super) withheld: bool,
}

impl ViewPoint {
    /// Point of a return of a shot; `input` is the index of its input.
    pub(super) fn of(found: &Return, shot: u64, input: u16, position_m: [f32; 3]) -> ViewPoint {
        ViewPoint {
            shot,
            position_m,
            intensity: found.intensity as f32,
            amplitude_dn: found.amplitude_at_unit_gain_dn().0 as f32,
            deviation_ratio: found.deviation_ratio as f32,
            total_sd_m: found.total_sd_m as f32,
            range_sd_m: found.range_sd_m as f32,
            width_ratio: found.width_ratio as f32,
            flags: found.flags,
            mta_zone: found.mta_zone,
            input,
            return_number: found.return_number,
            number_of_returns: found.number_of_returns,
            class: found.class,
            withheld: found.withheld,
        }
    }
}

/// A square of the quadtree.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct QuadtreeNode {
    /// Level; the root has 0.
    pub(super) level: u8,
    /// Column and row among the squares of its level, from the south-west corner.
    pub(super) place: [u32; 2],
    /// Its own points: a random sample of the points in its square that no ancestor has.
    pub(super) points: Range<usize>,
    /// Own points and the points of all descendants.
    pub(super) all: Range<usize>,
    /// Lowest and highest z of its own points, relative to the origin, m.
    pub(super) z_m: [f32; 2],
}

/// Points of a view.
#[derive(Debug, Default)]
pub(super) struct ViewPoints {
    points: Vec<ViewPoint>,
    nodes: Vec<QuadtreeNode>,
    /// South-west corner and side of the square of the root, m.
    square: Square,
    /// Number of times that the tree was built; 0: none.
    generation: u32,
    /// Number of points in the tree; later ones follow after them and are not yet shown.
    in_tree: usize,
    /// Limit of the number of points.
    most: usize,
    /// Only every 2^n-th shot is kept.
    thinning: u32,
}

/// A square in the plane, m.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Square {
    pub(super) corner_m: [f64; 2],
    pub(super) side_m: f64,
}

impl ViewPoints {
    /// Points that take at most this memory, bytes.
    pub(super) fn within(bytes: usize) -> ViewPoints {
        ViewPoints { most: (bytes / size_of::<ViewPoint>()).max(2 * NODE_POINTS), ..ViewPoints::default() }
    }

    /// Adds a point; drops further shots once there are too many points.
    pub(super) fn add(&mut self, point: ViewPoint) {
        if !self.keeps(&point) {
            return;
        }
        if self.points.len() >= self.most && self.thinning < MAX_THINNING {
            self.thinning += 1;
            let thinning = self.thinning;
            self.points.retain(|point| is_kept(point, thinning));
            // Nodes no longer fit.
            self.build();
        }
        // Thinning does not help if nearly all points are of one shot.
        if self.points.len() < self.most && self.keeps(&point) {
            self.points.push(point);
        }
    }

    fn keeps(&self, point: &ViewPoint) -> bool {
        is_kept(point, self.thinning)
    }

    /// Only one of this many shots is kept.
    pub(super) fn kept_one_of(&self) -> u64 {
        1 << self.thinning
    }

    /// Whether there are so many more points than in the tree that a new one helps.
    pub(super) fn has_outgrown_its_tree(&self) -> bool {
        self.points.len() >= (2 * self.in_tree).max(NODE_POINTS / 2)
    }

    /// Builds the tree of all points; indices of points change.
    pub(super) fn build(&mut self) {
        self.generation += 1;
        self.in_tree = self.points.len();
        self.nodes.clear();
        self.square = square_of(&self.points);
        let mut builder = Builder {
            nodes: &mut self.nodes,
            square: self.square,
            random: Xoshiro256PlusPlus::seed_from_u64(1),
        };
        builder.build(&mut self.points, 0, 0, [0, 0]);
    }

    pub(super) fn generation(&self) -> u32 {
        self.generation
    }

    pub(super) fn nodes(&self) -> &[QuadtreeNode] {
        &self.nodes
    }

    pub(super) fn square(&self) -> Square {
        self.square
    }

    /// Points in the tree; an index among them identifies a point of this generation.
    pub(super) fn in_tree(&self) -> &[ViewPoint] {
        self.points.get(..self.in_tree).unwrap_or_default()
    }

    /// Number of points, including those that are not yet in the tree.
    pub(super) fn len(&self) -> usize {
        self.points.len()
    }

    /// Ranges of points whose nodes touch a rectangle, from and to x and y, m.
    pub(super) fn near(&self, from_m: [f64; 2], to_m: [f64; 2]) -> impl Iterator<Item = Range<usize>> {
        self.nodes
            .iter()
            .filter(move |node| {
                let side_m = self.square.side_m / f64::from(1_u32 << node.level.min(31));
                (0..2).all(|i| {
                    let low_m = self.square.corner_m[i] + f64::from(node.place[i]) * side_m;
                    // Positions are rounded to 32 bits.
                    let slack_m = 1e-6 * self.square.side_m;
                    low_m <= to_m[i] + slack_m && low_m + side_m >= from_m[i] - slack_m
                })
            })
            .map(|node| node.points.clone())
    }
}

/// Whether a point is of a kept shot: a hash of its number decides.
fn is_kept(point: &ViewPoint, thinning: u32) -> bool {
    let hash = (point.shot ^ (u64::from(point.input) << 48)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    thinning == 0 || hash >> (64 - thinning) == 0
}

/// Smallest square with all points.
fn square_of(points: &[ViewPoint]) -> Square {
    let mut low = [f32::INFINITY; 2];
    let mut high = [f32::NEG_INFINITY; 2];
    for point in points {
        for i in 0..2 {
            low[i] = low[i].min(point.position_m[i]);
            high[i] = high[i].max(point.position_m[i]);
        }
    }
    if low[0] > high[0] {
        return Square { corner_m: [0.0; 2], side_m: 1.0 };
    }
    let side_m = (0..2).map(|i| f64::from(high[i]) - f64::from(low[i])).fold(1.0, f64::max);
    Square { corner_m: low.map(f64::from), side_m }
}

struct Builder<'a> {
    nodes: &'a mut Vec<QuadtreeNode>,
    square: Square,
    random: Xoshiro256PlusPlus,
}

impl Builder<'_> {
    /// Orders points, the first of which has the index `first`: points of a node become adjacent.
    fn build(&mut self, points: &mut [ViewPoint], first: usize, level: u8, place: [u32; 2]) {
        let n = points.len();
        if n == 0 {
            return;
        }
        let own = if n <= NODE_POINTS || level == MAX_LEVEL { n } else { NODE_POINTS };
        if own < n {
            for i in 0..own {
                // The bias of the remainder is below 1e-11.
                let chosen = i + (self.random.next_u64() % (n - i) as u64) as usize;
                points.swap(i, chosen);
            }
        }
        let (sample, rest) = points.split_at_mut(own);
        let z_m = sample.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], point| {
            [low.min(point.position_m[2]), high.max(point.position_m[2])]
        });
        self.nodes.push(QuadtreeNode {
            level,
            place,
            points: first..first + own,
            all: first..first + n,
            z_m,
        });
        let side_m = self.square.side_m / f64::from(1_u32 << (level + 1));
        let middle = [0, 1].map(|i| (self.square.corner_m[i] + f64::from(2 * place[i] + 1) * side_m) as f32);
        let north = partition(rest, |point| point.position_m[1] < middle[1]);
        let (south, north) = rest.split_at_mut(north);
        let mut first = first + own;
        for (row, half) in [(0, south), (1, north)] {
            let east = partition(half, |point| point.position_m[0] < middle[0]);
            let (west, east) = half.split_at_mut(east);
            for (column, quarter) in [(0, west), (1, east)] {
                let count = quarter.len();
                self.build(quarter, first, level + 1, [2 * place[0] + column, 2 * place[1] + row]);
                first += count;
            }
        }
    }
}

/// Moves the points that fulfil a condition to the front; returns their number.
fn partition(points: &mut [ViewPoint], is_first: impl Fn(&ViewPoint) -> bool) -> usize {
    let (mut front, mut end) = (0, points.len());
    while front < end {
        if is_first(&points[front]) {
            front += 1;
        } else {
            end -= 1;
            points.swap(front, end);
        }
    }
    front
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points on a grid of 1 m with `columns` columns.
    fn grid(columns: u32, rows: u32) -> ViewPoints {
        let mut points = ViewPoints::within(1 << 30);
        for shot in 0..columns * rows {
            let position_m = [(shot % columns) as f32, (shot / columns) as f32, (shot % 7) as f32];
            points.add(ViewPoint::of(&Return::default(), shot.into(), 0, position_m));
        }
        points
    }

    #[test]
    fn each_point_is_in_one_node_that_contains_it() {
        let mut points = grid(400, 300);
        points.build();
        let mut seen = vec![false; 120_000];
        assert!(points.nodes().len() > 5);
        for node in points.nodes() {
            assert!(node.points.len() <= NODE_POINTS && !node.points.is_empty());
            let side_m = points.square().side_m / f64::from(1 << node.level);
            for index in node.points.clone() {
                let point = &points.in_tree()[index];
                assert!(!std::mem::replace(&mut seen[point.shot as usize], true));
                for i in 0..2 {
                    let in_node_m = f64::from(point.position_m[i]) - f64::from(node.place[i]) * side_m;
                    assert!((-1e-3..=side_m + 1e-3).contains(&in_node_m), "{node:?} {point:?}");
                }
                assert!((node.z_m[0]..=node.z_m[1]).contains(&point.position_m[2]));
            }
        }
        assert!(seen.into_iter().all(|seen| seen));
    }

    #[test]
    fn a_rectangle_finds_all_of_its_points() {
        let mut points = grid(400, 300);
        points.build();
        let (from_m, to_m) = ([100.0, 50.0], [110.0, 60.0]);
        let is_inside = |point: &ViewPoint| {
            (0..2).all(|i| (from_m[i]..=to_m[i]).contains(&f64::from(point.position_m[i])))
        };
        let near: Vec<Range<usize>> = points.near(from_m, to_m).collect();
        let looked_at: usize = near.iter().map(ExactSizeIterator::len).sum();
        let found = near.into_iter().flatten().filter(|&index| is_inside(&points.in_tree()[index])).count();
        assert_eq!(found, 121);
        assert!(looked_at < 60_000);
    }

    #[test]
    fn memory_is_bounded_by_leaving_out_whole_shots() {
        let mut points = ViewPoints::within(0);
        for shot in 0..100_000 {
            for return_number in 1..=2 {
                let found = Return { return_number, ..Return::default() };
                points.add(ViewPoint::of(&found, shot, 0, [shot as f32, 0.0, 0.0]));
            }
        }
        points.build();
        assert!(points.len() <= 2 * NODE_POINTS);
        assert!(points.kept_one_of() >= 8 && points.len() > NODE_POINTS / 4);
        let mut shots: Vec<u64> = points.in_tree().iter().map(|point| point.shot).collect();
        shots.sort_unstable();
        assert!(shots.chunks(2).all(|pair| pair.len() == 2 && pair[0] == pair[1]));
    }

    #[test]
    fn memory_is_bounded_although_all_points_are_of_one_shot() {
        let mut points = ViewPoints::within(0);
        for n in 0..3 * NODE_POINTS {
            points.add(ViewPoint::of(&Return::default(), 0, 0, [n as f32, 0.0, 0.0]));
        }
        assert_eq!(points.len(), 2 * NODE_POINTS);
    }

    #[test]
    fn no_points_and_points_at_one_place_have_a_tree() {
        let mut points = ViewPoints::within(1 << 20);
        points.build();
        assert_eq!((points.nodes().len(), points.generation()), (0, 1));
        let mut points = ViewPoints::within(1 << 30);
        (0..50_000).for_each(|shot| points.add(ViewPoint::of(&Return::default(), shot, 0, [0.0; 3])));
        points.build();
        assert_eq!(points.nodes().iter().map(|node| node.points.len()).sum::<usize>(), 50_000);
    }
}
