//! Nearest points in all directions.

use crate::point::CloudPoint;

/// Number of directions that are searched separately.
const OCTANTS: usize = 8;
/// Points per octant for a prediction.
const PER_OCTANT: usize = 3;
/// Steps between the points chosen for a prediction, tried one after the other.
const STEPS: [usize; 6] = [1, 2, 4, 8, 16, 32];
/// Spread of neighbours across their main direction, relative to that along it, that determines both slopes.
const ENOUGH_SPREAD: f64 = 0.2;
/// Search radius in multiples of the distance of the eighth nearest point.
const REACH: f64 = 6.0;
/// Mean number of points in a bucket.
const IN_BUCKET: f64 = 4.0;
/// Largest number of buckets along an edge.
const MOST_BUCKETS: usize = 4096;

/// Points in canonical order, found by their position.
///
/// Results depend on the set of points alone, not on their order.
#[derive(Debug)]
pub(crate) struct PointIndex {
    points: Vec<CloudPoint>,
    /// First point of each bucket, and the number of points.
    starts: Vec<u32>,
    west: f64,
    south: f64,
    bucket_m: f64,
    size: [usize; 2],
}

/// A point found, with its squared horizontal distance, m², and offset from the target, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Neighbour {
    pub(crate) distance_squared: f64,
    pub(crate) offset_m: [f64; 2],
    pub(crate) index: u32,
}

impl PointIndex {
    /// Sorts the points with finite positions.
    pub(crate) fn new(points: &[CloudPoint]) -> PointIndex {
        let mut points: Vec<CloudPoint> =
            points.iter().filter(|p| p.position_m.iter().all(|x| x.is_finite())).copied().collect();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in &points {
            for i in 0..2 {
                low[i] = low[i].min(point.position_m[i]);
                high[i] = high[i].max(point.position_m[i]);
            }
        }
        if points.is_empty() {
            (low, high) = ([0.0; 2], [0.0; 2]);
        }
        let extent = [high[0] - low[0], high[1] - low[1]];
        let bucket_m = (extent[0] * extent[1] * IN_BUCKET / points.len().max(1) as f64)
            .sqrt()
            .max(extent[0].max(extent[1]) / MOST_BUCKETS as f64)
            .max(0.01);
        let size = extent.map(|length| (length / bucket_m) as usize + 1);
        let mut index = PointIndex {
            points: Vec::new(),
            starts: Vec::new(),
            west: low[0],
            south: low[1],
            bucket_m,
            size,
        };
        points.sort_unstable_by(|a, b| {
            let order = index.bucket_of(a.position_m).cmp(&index.bucket_of(b.position_m));
            let by = |i: usize| a.position_m[i].total_cmp(&b.position_m[i]);
            order
                .then_with(|| by(0))
                .then_with(|| by(1))
                .then_with(|| by(2))
                .then(a.strip.cmp(&b.strip))
                .then_with(|| a.height_sd_m.total_cmp(&b.height_sd_m))
        });
        let mut starts = vec![0; size[0] * size[1] + 1];
        for point in &points {
            let [x, y] = index.bucket_of(point.position_m).map(|i| i as usize);
            // Buckets are ordered as the pairs that points are sorted by.
            starts[x * size[1] + y + 1] += 1;
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        (index.points, index.starts) = (points, starts);
        index
    }

    pub(crate) fn points(&self) -> &[CloudPoint] {
        &self.points
    }

    fn bucket_of(&self, [x, y, _]: [f64; 3]) -> [i64; 2] {
        let along = |offset: f64, n: usize| ((offset / self.bucket_m) as i64).clamp(0, n as i64 - 1);
        [along(x - self.west, self.size[0]), along(y - self.south, self.size[1])]
    }

    fn in_bucket(&self, x: i64, y: i64) -> std::ops::Range<u32> {
        let inside = (0..self.size[0] as i64).contains(&x) && (0..self.size[1] as i64).contains(&y);
        if !inside {
            return 0..0;
        }
        let at = x as usize * self.size[1] + y as usize;
        self.starts[at]..self.starts[at + 1]
    }

    /// Finds the nearest points of each octant, farther than `hole_m` and within `most_m`, nearest first.
    ///
    /// Points beyond six times the distance of the eighth nearest are left out: they would carry no
    /// weight, and the search would be long at the edge of the data.
    pub(crate) fn nearest(
        &self,
        [x, y]: [f64; 2],
        per_octant: usize,
        hole_m: f64,
        most_m: f64,
        found: &mut Vec<Neighbour>,
    ) {
        found.clear();
        let mut octants: [Vec<Neighbour>; OCTANTS] = Default::default();
        let mut nearest: Vec<Neighbour> = Vec::with_capacity(OCTANTS + 1);
        let centre = [((x - self.west) / self.bucket_m).floor(), ((y - self.south) / self.bucket_m).floor()];
        let centre = centre.map(|i| i.clamp(-1e9, 1e9) as i64);
        let rings = (most_m / self.bucket_m) as i64 + 2;
        let mut limit = most_m * most_m;
        for ring in 0..=rings {
            // Everything nearer than this has been seen.
            let seen_m = ((ring - 1) as f64 * self.bucket_m).max(0.0);
            let farthest = |list: &Vec<Neighbour>, n: usize| {
                list.get(n - 1).map_or(f64::INFINITY, |last: &Neighbour| last.distance_squared)
            };
            limit = limit.min(farthest(&nearest, OCTANTS) * (REACH * REACH));
            let needed = octants.iter().map(|list| farthest(list, per_octant)).fold(0.0, f64::max).min(limit);
            if seen_m * seen_m > needed {
                break;
            }
            let mut visit = |bx: i64, by: i64| {
                for i in self.in_bucket(bx, by) {
                    let at = self.points[i as usize].position_m;
                    let [dx, dy] = [at[0] - x, at[1] - y];
                    let distance_squared = dx * dx + dy * dy;
                    if distance_squared > limit || (hole_m >= 0.0 && distance_squared <= hole_m * hole_m) {
                        continue;
                    }
                    let neighbour = Neighbour { distance_squared, offset_m: [dx, dy], index: i };
                    insert(&mut nearest, neighbour, OCTANTS);
                    insert(&mut octants[octant([dx, dy])], neighbour, per_octant);
                }
            };
            for bx in centre[0] - ring..=centre[0] + ring {
                if (bx - centre[0]).abs() == ring {
                    (centre[1] - ring..=centre[1] + ring).for_each(|by| visit(bx, by));
                } else {
                    visit(bx, centre[1] - ring);
                    visit(bx, centre[1] + ring);
                }
            }
        }
        limit = limit
            .min(nearest.get(OCTANTS - 1).map_or(f64::INFINITY, |n| n.distance_squared * (REACH * REACH)));
        found.extend(octants.iter().flatten().filter(|n| n.distance_squared <= limit));
        // The nearest points of all directions are used in any case.
        found.extend(nearest.iter().filter(|n| !octants.iter().any(|list| list.contains(n))));
        found.sort_unstable_by(order);
    }

    /// Finds the neighbours for a prediction: [`nearest`](Self::nearest) with three points per octant, or more at gaps.
    ///
    /// At the edge of a gap octants are empty, and the nearest points of the others can be of one scan line, which does
    /// not determine the slope across it. The octants with points then get more, chosen at steps from farther ones if needed.
    pub(crate) fn around(&self, at: [f64; 2], hole_m: f64, most_m: f64, found: &mut Vec<Neighbour>) {
        self.nearest(at, PER_OCTANT, hole_m, most_m, found);
        if found.len() >= OCTANTS * PER_OCTANT {
            return;
        }
        let mut is_filled = [false; OCTANTS];
        found.iter().for_each(|n| is_filled[octant(n.offset_m)] = true);
        let filled = is_filled.iter().filter(|filled| **filled).count().max(1);
        let per_octant = (OCTANTS * PER_OCTANT).div_ceil(filled);
        for step in STEPS {
            if per_octant * step > PER_OCTANT {
                self.nearest(at, per_octant * step, hole_m, most_m, found);
                thin(found, step);
            }
            if relative_spread(found.iter().map(|n| n.offset_m)) >= ENOUGH_SPREAD {
                return;
            }
        }
    }
}

/// Keeps the nearest points, and of those of each octant one in `step`.
fn thin(found: &mut Vec<Neighbour>, step: usize) {
    let (mut n, mut of_octant) = (0, [0; OCTANTS]);
    found.retain(|neighbour| {
        let i = &mut of_octant[octant(neighbour.offset_m)];
        let is_kept = n < OCTANTS || *i % step == 0;
        (n, *i) = (n + 1, *i + 1);
        is_kept
    });
}

/// Spread of positions across their main direction, relative to the spread along it; 0: on a line.
pub(crate) fn relative_spread(offsets: impl Iterator<Item = [f64; 2]> + Clone) -> f64 {
    let n = offsets.clone().count() as f64;
    let mean = [0, 1].map(|i| offsets.clone().map(|d| d[i]).sum::<f64>() / n);
    let moment =
        |i: usize, j: usize| offsets.clone().map(|d| (d[i] - mean[i]) * (d[j] - mean[j])).sum::<f64>();
    let (xx, xy, yy) = (moment(0, 0), moment(0, 1), moment(1, 1));
    let half = 0.5 * (xx + yy);
    let root = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
    if half + root > 0.0 { ((half - root).max(0.0) / (half + root)).sqrt() } else { 0.0 }
}

fn order(a: &Neighbour, b: &Neighbour) -> std::cmp::Ordering {
    // Points at the same position are next to each other whatever the buckets; others are not.
    a.distance_squared
        .total_cmp(&b.distance_squared)
        .then_with(|| a.offset_m[0].total_cmp(&b.offset_m[0]))
        .then_with(|| a.offset_m[1].total_cmp(&b.offset_m[1]))
        .then(a.index.cmp(&b.index))
}

/// Inserts into a sorted list of at most `most` neighbours.
fn insert(list: &mut Vec<Neighbour>, neighbour: Neighbour, most: usize) {
    let at = list.partition_point(|n| order(n, &neighbour).is_lt());
    if at < most {
        list.truncate(most - 1);
        list.insert(at, neighbour);
    }
}

/// Octant of a direction, half open: each direction belongs to one.
fn octant([dx, dy]: [f64; 2]) -> usize {
    let steep = dx.abs() < dy.abs();
    usize::from(dx < 0.0) | usize::from(dy < 0.0) << 1 | usize::from(steep) << 2
}

#[cfg(test)]
mod tests {
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::{Rng, SeedableRng};

    use super::*;

    /// All points are compared; buckets must not change what is found.
    #[test]
    fn the_search_finds_the_nearest_of_each_octant() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(4);
        let mut number = move || (random.next_u64() >> 11) as f64 / (1u64 << 53) as f64;
        let points: Vec<_> =
            (0..500).map(|_| CloudPoint::at([100.0 * number(), 30.0 * number(), 0.0])).collect();
        let index = PointIndex::new(&points);
        let mut found = Vec::new();
        for _ in 0..200 {
            let at = [120.0 * number() - 10.0, 50.0 * number() - 10.0];
            index.nearest(at, 2, -1.0, 25.0, &mut found);
            let mut all: Vec<Neighbour> = (0..index.points.len())
                .map(|i| {
                    let p = index.points[i].position_m;
                    let (dx, dy) = (p[0] - at[0], p[1] - at[1]);
                    Neighbour { distance_squared: dx * dx + dy * dy, offset_m: [dx, dy], index: i as u32 }
                })
                .filter(|n| n.distance_squared <= 625.0)
                .collect();
            all.sort_by(order);
            let limit = all.get(7).map_or(f64::INFINITY, |n| 36.0 * n.distance_squared);
            let mut used = [0; 8];
            let expected: Vec<Neighbour> = all
                .iter()
                .enumerate()
                .filter(|(i, n)| {
                    let p = index.points[n.index as usize].position_m;
                    let of = &mut used[octant([p[0] - at[0], p[1] - at[1]])];
                    *of += 1;
                    n.distance_squared <= limit && (*of <= 2 || *i < 8)
                })
                .map(|(_, n)| *n)
                .collect();
            assert_eq!(found, expected);
        }
    }

    #[test]
    fn neighbours_at_the_edge_of_a_gap_are_of_several_scan_lines() {
        let line = |x: i32| (-300..300).map(move |i| [f64::from(x), 0.1 * f64::from(i), 0.0]);
        let points: Vec<_> = (-30..=0).flat_map(line).map(CloudPoint::at).collect();
        let index = PointIndex::new(&points);
        let spread = |found: &[Neighbour]| relative_spread(found.iter().map(|n| n.offset_m));
        let mut found = Vec::new();
        for distance_m in [1.3, 2.5, 4.0] {
            let at = [distance_m, 0.03];
            index.nearest(at, PER_OCTANT, -1.0, 50.0, &mut found);
            assert!(spread(&found) < 1e-6, "{distance_m} {found:?}");
            index.around(at, -1.0, 50.0, &mut found);
            let n = found.len();
            assert!(
                (24..=32).contains(&n) && spread(&found) >= ENOUGH_SPREAD,
                "{distance_m} {n} {}",
                spread(&found)
            );
        }
        // One line alone.
        let alone: Vec<_> = line(0).map(CloudPoint::at).collect();
        PointIndex::new(&alone).around([1.5, 0.03], -1.0, 50.0, &mut found);
        assert!(spread(&found) < 1e-6 && found.len() >= OCTANTS);
    }

    #[test]
    fn no_points_are_found_where_there_are_none() {
        let mut found = vec![Neighbour { distance_squared: 0.0, offset_m: [0.0; 2], index: 0 }];
        PointIndex::new(&[]).nearest([0.0, 0.0], 2, -1.0, 25.0, &mut found);
        assert!(found.is_empty());
        PointIndex::new(&[CloudPoint::at([f64::NAN, 0.0, 0.0])]).nearest([0.0; 2], 2, -1.0, 25.0, &mut found);
        assert!(found.is_empty());
    }
}
