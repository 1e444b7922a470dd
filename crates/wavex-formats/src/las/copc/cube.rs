//! Bounding cube of all points and its octree division.
//!
//! Keys of points and nodes. A key interleaves the bits of the three cell numbers of the finest
//! division, x lowest (Morton order). Points of the same node, or of the same cell of a node, are
//! therefore consecutive in key order.

/// Bisections of the cube in a key.
///
/// 2^21 cells along an axis.
pub(super) const KEY_LEVELS: u32 = 21;
/// Bisections of a node into cells.
///
/// A node holds one point in each of its 2^7 = 128 cells along an axis.
pub(super) const CELL_LEVELS: u32 = 7;
/// Level of the smallest nodes.
///
/// Their cells are as long as the cells of the keys.
pub(super) const DEEPEST: u32 = KEY_LEVELS - CELL_LEVELS;

/// Axis-aligned cube, in units of the coordinate system.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cube {
    pub(super) centre: [f64; 3],
    /// Half of the edge length; above 0.
    pub(super) half: f64,
}

impl Cube {
    /// Returns the smallest centred cube that contains `min` and `max`.
    ///
    /// Its edge is at least `least`.
    pub(super) fn around(min: [f64; 3], max: [f64; 3], least: f64) -> Cube {
        let centre = std::array::from_fn(|axis| min[axis] / 2.0 + max[axis] / 2.0);
        let half = (0..3).map(|axis| (max[axis] - centre[axis]).max(centre[axis] - min[axis]));
        Cube { centre, half: half.fold(least / 2.0, f64::max) }
    }

    /// Returns the cell key of a position, clamped to the cube.
    pub(super) fn key(&self, place: [f64; 3]) -> u64 {
        let cells = f64::from(1u32 << KEY_LEVELS);
        let cell = |axis: usize| {
            let share = (place[axis] - self.centre[axis]) / self.half / 2.0 + 0.5;
            spread((share * cells).clamp(0.0, cells - 1.0) as u64)
        };
        cell(0) | cell(1) << 1 | cell(2) << 2
    }
}

/// Returns the leading key bits of a node or cell.
///
/// Level 0 is the whole cube.
pub(super) fn prefix(key: u64, level: u32) -> u64 {
    key >> (3 * (KEY_LEVELS - level.min(KEY_LEVELS)))
}

/// Returns the x, y, z numbers of a node in its level.
pub(super) fn numbers(prefix: u64) -> [i32; 3] {
    [0, 1, 2].map(|axis| gather(prefix >> axis) as i32)
}

/// Inserts two zeros above each of the lowest 21 bits.
fn spread(number: u64) -> u64 {
    (0..KEY_LEVELS).fold(0, |key, bit| key | (number >> bit & 1) << (3 * bit))
}

/// Gathers every third bit, from the lowest.
fn gather(key: u64) -> u64 {
    (0..KEY_LEVELS).fold(0, |number, bit| number | (key >> (3 * bit) & 1) << bit)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_cube_holds_all_and_is_no_larger_than_it_must() {
        let cube = Cube::around([0.0, 10.0, -5.0], [8.0, 12.0, 1.0], 0.01);
        assert_eq!(cube, Cube { centre: [4.0, 11.0, -2.0], half: 4.0 });
        let one = Cube::around([3.0; 3], [3.0; 3], 0.5);
        assert_eq!(one, Cube { centre: [3.0; 3], half: 0.25 });
    }

    #[test]
    fn the_first_division_is_by_octants_with_x_lowest() {
        let cube = Cube { centre: [0.0; 3], half: 1.0 };
        let octant = |place| prefix(cube.key(place), 1);
        assert_eq!(octant([-0.5, -0.5, -0.5]), 0);
        assert_eq!(octant([0.5, -0.5, -0.5]), 1);
        assert_eq!(octant([-0.5, 0.5, -0.5]), 2);
        assert_eq!(octant([-0.5, -0.5, 0.5]), 4);
        assert_eq!(octant([1.0, 1.0, 1.0]), 7, "the cube's own corner belongs to it");
        assert_eq!(octant([9.0, -9.0, f64::NAN]), 1, "what lies outside goes to the nearest");
    }

    proptest! {
        #[test]
        fn a_place_lies_in_the_node_that_its_key_names(
            place in prop::array::uniform3(-1.0..1.0f64), level in 0..=DEEPEST
        ) {
            let cube = Cube { centre: [0.0; 3], half: 1.0 };
            let edge = 2.0 / f64::from(1u32 << level);
            for (axis, number) in numbers(prefix(cube.key(place), level)).into_iter().enumerate() {
                let low = f64::from(number) * edge - 1.0;
                prop_assert!((low..=low + edge).contains(&place[axis]));
            }
        }
    }
}
