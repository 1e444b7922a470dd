//! Objects: points that are linked by steps of limited length.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};

use crate::point::CloudPoint;

/// Bits of a voxel's index along one axis.
const BITS: u32 = 21;
const MIDDLE: i64 = 1 << (BITS - 1);
/// A column is this power of two of voxels wide.
const COLUMN_SHIFT: u32 = 2;
/// Length of a step, as a multiple of the scale at which the surface has no holes.
const SCALES: f64 = 2.5;
/// Objects of fewer points are linked with all voxels within a step.
const SMALL: u32 = 500;

/// Hash of keys that are made here; it is the same in all runs.
#[derive(Clone, Copy, Default)]
pub(super) struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn finish(&self) -> u64 {
        self.0
    }

    fn write(&mut self, bytes: &[u8]) {
        for &byte in bytes {
            self.write_u64(byte.into());
        }
    }

    fn write_u64(&mut self, key: u64) {
        let mixed = (self.0 ^ key).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.0 = mixed ^ mixed >> 29;
    }
}

/// A map from keys of cells.
pub(super) type Cells<T> = HashMap<u64, T, BuildHasherDefault<KeyHasher>>;

/// A voxel with points.
#[derive(Clone, Copy, Debug)]
struct Voxel {
    key: u64,
    from: usize,
    to: usize,
}

/// Linked points.
#[derive(Clone, Debug, Default)]
pub(super) struct Object {
    pub(super) n_points: usize,
    /// Columns with the lowest and highest point in each, sorted by column.
    pub(super) columns: Vec<(Column, [f64; 2])>,
    /// Smallest and largest coordinates, m.
    pub(super) low_m: [f64; 3],
    pub(super) high_m: [f64; 3],
    /// Horizontal SDs along the long and the short axis, m.
    axes_m: [f64; 2],
    /// Range in `Objects::voxels_by_object`.
    voxels: [usize; 2],
}

/// Indices of a column of voxels.
pub(super) type Column = [i32; 2];

/// All objects of a cloud.
#[derive(Debug, Default)]
pub(super) struct Objects {
    /// Length of a step, m.
    pub(super) step_m: f64,
    /// Scale at which the surface has no holes, m.
    pub(super) scale_m: f64,
    pub(super) list: Vec<Object>,
    /// Points outside the range of voxels, and whether they are above the middle of the cloud.
    pub(super) far: Vec<(usize, bool)>,
    voxel_m: f64,
    /// Index of the voxel in the middle.
    base: [i64; 3],
    /// Points sorted by voxel.
    order: Vec<usize>,
    voxels: Vec<Voxel>,
    by_key: Cells<usize>,
    voxels_by_object: Vec<usize>,
}

impl Objects {
    /// Links points by steps of at least `step_m`.
    pub(super) fn find(points: &[CloudPoint], step_m: f64) -> Objects {
        let valid: Vec<usize> =
            (0..points.len()).filter(|&at| points[at].position_m.iter().all(|x| x.abs() < 1e12)).collect();
        if valid.is_empty() {
            return Objects::default();
        }
        let middle_m: [f64; 3] = std::array::from_fn(|axis| {
            let mut values: Vec<f64> = valid.iter().map(|&at| points[at].position_m[axis]).collect();
            let middle = values.len() / 2;
            *values.select_nth_unstable_by(middle, f64::total_cmp).1
        });
        let scale_m = scale_without_holes_m(points, &valid, middle_m);
        let step_m = step_m.max(SCALES * scale_m);
        let voxel_m = 0.5 * step_m;
        let base = middle_m.map(|x| (x / voxel_m).floor() as i64);
        let mut objects = Objects { step_m, scale_m, voxel_m, base, ..Objects::default() };
        let mut keys: Vec<(u64, usize)> = Vec::with_capacity(valid.len());
        for at in valid {
            match objects.key_of(points[at].position_m) {
                Some(key) => keys.push((key, at)),
                None => objects.far.push((at, points[at].position_m[2] > middle_m[2])),
            }
        }
        keys.sort_unstable();
        for of_voxel in keys.chunk_by(|a, b| a.0 == b.0) {
            let from = objects.order.len();
            objects.order.extend(of_voxel.iter().map(|&(_, at)| at));
            objects.by_key.insert(of_voxel[0].0, objects.voxels.len());
            objects.voxels.push(Voxel { key: of_voxel[0].0, from, to: objects.order.len() });
        }
        let roots = objects.link(points);
        objects.collect(points, &roots);
        objects
    }

    /// Width of a column, m.
    pub(super) fn column_m(&self) -> f64 {
        self.voxel_m * f64::from(1u32 << COLUMN_SHIFT)
    }

    /// Points of an object.
    pub(super) fn points_of<'a>(&'a self, object: &Object) -> impl Iterator<Item = usize> + 'a {
        let [from, to] = object.voxels;
        self.voxels_by_object[from..to].iter().flat_map(|&voxel| {
            let voxel = self.voxels[voxel];
            self.order[voxel.from..voxel.to].iter().copied()
        })
    }

    /// First point of an object in the order of voxels.
    pub(super) fn first_point(&self, object: &Object) -> usize {
        self.order[self.voxels[self.voxels_by_object[object.voxels[0]]].from]
    }

    /// Points in the voxels that a box overlaps.
    pub(super) fn points_in(&self, low_m: [f64; 3], high_m: [f64; 3]) -> impl Iterator<Item = usize> + '_ {
        let index = |x: f64, axis: usize| ((x / self.voxel_m).floor() as i64).saturating_sub(self.base[axis]);
        let [x, y, z] = std::array::from_fn(|axis| index(low_m[axis], axis)..=index(high_m[axis], axis));
        let of_box = x.flat_map(move |i| {
            let z = z.clone();
            y.clone().flat_map(move |j| z.clone().map(move |k| [i, j, k]))
        });
        of_box.filter_map(|indices| self.by_key.get(&packed(indices)?)).flat_map(|&at| {
            let voxel = self.voxels[at];
            self.order[voxel.from..voxel.to].iter().copied()
        })
    }

    fn key_of(&self, position_m: [f64; 3]) -> Option<u64> {
        packed(std::array::from_fn(|axis| {
            ((position_m[axis] / self.voxel_m).floor() as i64).saturating_sub(self.base[axis])
        }))
    }

    /// Root of each voxel: the first voxel that it is linked with.
    fn link(&self, points: &[CloudPoint]) -> Vec<usize> {
        let mut sets = Sets::new(&self.voxels);
        let near: Vec<[i64; 3]> = offsets(1).filter(|offset| *offset > [0; 3]).collect();
        for at in 0..self.voxels.len() {
            self.link_with(at, &near, points, &mut sets);
        }
        let far: Vec<[i64; 3]> = offsets(2).filter(|offset| offset.iter().any(|d| d.abs() == 2)).collect();
        let is_small = |at: &usize| {
            let root = sets.root(*at);
            sets.n_points[root] < SMALL
        };
        let small: Vec<usize> = (0..self.voxels.len()).filter(is_small).collect();
        for at in small {
            self.link_with(at, &far, points, &mut sets);
        }
        (0..self.voxels.len()).map(|at| sets.root(at)).collect()
    }

    /// Links a voxel with the voxels at these offsets that have a point within a step.
    fn link_with(&self, at: usize, offsets: &[[i64; 3]], points: &[CloudPoint], sets: &mut Sets) {
        let indices = unpacked(self.voxels[at].key);
        for offset in offsets {
            let other = std::array::from_fn(|axis| indices[axis] + offset[axis]);
            let Some(&other) = packed(other).and_then(|key| self.by_key.get(&key)) else { continue };
            if sets.root(at) != sets.root(other) && self.is_within_step(at, other, points) {
                sets.unite(at, other);
            }
        }
    }

    fn is_within_step(&self, a: usize, b: usize, points: &[CloudPoint]) -> bool {
        let of = |at: usize| &self.order[self.voxels[at].from..self.voxels[at].to];
        of(a).iter().any(|&p| {
            of(b).iter().any(|&q| {
                let (p, q) = (points[p].position_m, points[q].position_m);
                (0..3).map(|axis| (p[axis] - q[axis]) * (p[axis] - q[axis])).sum::<f64>()
                    <= self.step_m * self.step_m
            })
        })
    }

    /// Makes the objects from the root of each voxel.
    fn collect(&mut self, points: &[CloudPoint], roots: &[usize]) {
        let mut by_root: Vec<usize> = (0..roots.len()).collect();
        by_root.sort_by_key(|&at| (roots[at], at));
        for of_root in by_root.chunk_by(|&a, &b| roots[a] == roots[b]) {
            let from = self.voxels_by_object.len();
            self.voxels_by_object.extend(of_root);
            let voxels = [from, self.voxels_by_object.len()];
            let mut object = Object {
                voxels,
                low_m: [f64::INFINITY; 3],
                high_m: [f64::NEG_INFINITY; 3],
                ..Object::default()
            };
            let mut columns: Vec<(Column, [f64; 2])> = Vec::new();
            for &at in of_root {
                let voxel = self.voxels[at];
                let [i, j, _] = unpacked(voxel.key);
                let column = [(i >> COLUMN_SHIFT) as i32, (j >> COLUMN_SHIFT) as i32];
                let mut heights_m = [f64::INFINITY, f64::NEG_INFINITY];
                for &point in &self.order[voxel.from..voxel.to] {
                    let position_m = points[point].position_m;
                    for (axis, value) in position_m.into_iter().enumerate() {
                        object.low_m[axis] = object.low_m[axis].min(value);
                        object.high_m[axis] = object.high_m[axis].max(value);
                    }
                    heights_m = [heights_m[0].min(position_m[2]), heights_m[1].max(position_m[2])];
                }
                columns.push((column, heights_m));
                object.n_points += voxel.to - voxel.from;
            }
            columns.sort_by_key(|&(column, _)| column);
            columns.dedup_by(|next, kept| {
                let is_same = next.0 == kept.0;
                if is_same {
                    kept.1 = [kept.1[0].min(next.1[0]), kept.1[1].max(next.1[1])];
                }
                is_same
            });
            object.columns = columns;
            object.axes_m = self.axes_m(points, &object);
            self.list.push(object);
        }
    }

    /// Horizontal SDs of an object along its long and its short axis, m.
    fn axes_m(&self, points: &[CloudPoint], object: &Object) -> [f64; 2] {
        let [mut n, mut x, mut y, mut xx, mut xy, mut yy] = [0.0; 6];
        for point in self.points_of(object) {
            let [px, py, _] = points[point].position_m;
            let (px, py) = (px - object.low_m[0], py - object.low_m[1]);
            (n, x, y) = (n + 1.0, x + px, y + py);
            (xx, xy, yy) = (xx + px * px, xy + px * py, yy + py * py);
        }
        let (x, y) = (x / n, y / n);
        let (xx, xy, yy) = (xx / n - x * x, xy / n - x * y, yy / n - y * y);
        let (half, root) = (0.5 * (xx + yy), (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt());
        [half + root, half - root].map(|variance| variance.max(0.0).sqrt())
    }
}

impl Object {
    /// Largest extent along an axis, m.
    pub(super) fn extent_m(&self) -> f64 {
        (0..3).map(|axis| self.high_m[axis] - self.low_m[axis]).fold(0.0, f64::max)
    }

    /// Whether it is long and thin: a wire, or a mast.
    pub(super) fn is_thin(&self, step_m: f64) -> bool {
        // SDs of a uniform distribution are its length over the root of 12.
        let [long_m, short_m] = self.axes_m.map(|sd_m| 3.5 * sd_m);
        let tall_m = self.high_m[2] - self.low_m[2];
        long_m > 2.0 * step_m.max(4.0 * short_m).max(tall_m) || tall_m > 2.0 * step_m.max(2.0 * long_m)
    }
}

/// Disjoint sets of voxels; the root of a set is its first voxel.
struct Sets {
    parents: Vec<usize>,
    n_points: Vec<u32>,
}

impl Sets {
    fn new(voxels: &[Voxel]) -> Sets {
        let n_points = voxels.iter().map(|voxel| u32::try_from(voxel.to - voxel.from).unwrap_or(u32::MAX));
        Sets { parents: (0..voxels.len()).collect(), n_points: n_points.collect() }
    }

    fn root(&mut self, mut at: usize) -> usize {
        while self.parents[at] != at {
            self.parents[at] = self.parents[self.parents[at]];
            at = self.parents[at];
        }
        at
    }

    fn unite(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        if a != b {
            let (first, second) = (a.min(b), a.max(b));
            self.parents[second] = first;
            self.n_points[first] = self.n_points[first].saturating_add(self.n_points[second]);
        }
    }
}

/// Offsets of the voxels around one, up to `reach` along each axis.
fn offsets(reach: i64) -> impl Iterator<Item = [i64; 3]> {
    let along = move || -reach..=reach;
    along().flat_map(move |i| along().flat_map(move |j| along().map(move |k| [i, j, k])))
}

/// Key of a voxel; `None` if an index is out of range.
fn packed(indices: [i64; 3]) -> Option<u64> {
    let mut key = 0;
    for index in indices {
        let index = index.checked_add(MIDDLE).filter(|index| (0..2 * MIDDLE).contains(index))?;
        key = key << BITS | index as u64;
    }
    Some(key)
}

fn unpacked(key: u64) -> [i64; 3] {
    let index = |shift: u32| (key >> shift & ((1 << BITS) - 1)) as i64 - MIDDLE;
    [index(2 * BITS), index(BITS), index(0)]
}

/// Smallest width of cells that are filled where their neighbours are, m.
///
/// Cells of twice the width have four parts; the width is that at which 80 % of these have points.
fn scale_without_holes_m(points: &[CloudPoint], valid: &[usize], middle_m: [f64; 3]) -> f64 {
    const FIRST_M: f64 = 0.25;
    const FILLED: f64 = 0.8;
    let base = [middle_m[0], middle_m[1]].map(|x| (x / FIRST_M).floor());
    let mut cells: Vec<u64> = Vec::with_capacity(valid.len());
    for &at in valid {
        let index =
            |axis: usize| (points[at].position_m[axis] / FIRST_M).floor() - base[axis] + 2f64.powi(30);
        let (i, j) = (index(0), index(1));
        let is_near = |index: f64| (0.0..2f64.powi(31)).contains(&index);
        if is_near(i) && is_near(j) {
            cells.push(spread(i as u64) | spread(j as u64) << 1);
        }
    }
    cells.sort_unstable();
    cells.dedup();
    let (mut width_m, mut before) = (FIRST_M, 0.0);
    while cells.len() > 1 {
        let n = cells.len();
        cells.iter_mut().for_each(|cell| *cell >>= 2);
        cells.dedup();
        let filled = n as f64 / (4 * cells.len()) as f64;
        if filled >= FILLED {
            // Between two widths, the share of filled cells is taken as linear.
            let part =
                if filled > before { ((FILLED - before) / (filled - before)).clamp(0.0, 1.0) } else { 1.0 };
            return if before > 0.0 { 0.5 * width_m * (1.0 + part) } else { width_m };
        }
        (before, width_m) = (filled, 2.0 * width_m);
        if width_m > 32.0 {
            break;
        }
    }
    1.0
}

/// Bits of a number at every second place.
fn spread(number: u64) -> u64 {
    let mut bits = number & 0xffff_ffff;
    for (shift, mask) in [
        (16, 0x0000_ffff_0000_ffff),
        (8, 0x00ff_00ff_00ff_00ff),
        (4, 0x0f0f_0f0f_0f0f_0f0f),
        (2, 0x3333_3333_3333_3333),
        (1, 0x5555_5555_5555_5555u64),
    ] {
        bits = (bits | bits << shift) & mask;
    }
    bits
}
