//! The cube around all points and its division by halves: keys of points and of nodes.
//!
//! A key interleaves the bits of the three cell numbers of the finest division, x lowest ("Morton order"). So the points of
//! each node of each level are neighbours in the order of their keys, and so are those of each cell that a node is seen by.

/// Divisions of the cube by halves that a key tells apart: 2^21 cells along an axis.
pub(super) const KEY_LEVELS: u32 = 21;
/// A node shows one point in each of its 2^7 = 128 cells along an axis.
pub(super) const CELL_LEVELS: u32 = 7;
/// The level of the smallest nodes, whose cells are those of the keys.
pub(super) const DEEPEST: u32 = KEY_LEVELS - CELL_LEVELS;

/// A cube along the axes, in units of the coordinate system.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Cube {
    pub(super) centre: [f64; 3],
    /// Half of an edge; above 0.
    pub(super) half: f64,
}

impl Cube {
    /// The smallest cube with a centre amid `min` and `max` that holds both; its edge is at least `least`.
    pub(super) fn around(min: [f64; 3], max: [f64; 3], least: f64) -> Cube {
        let centre = std::array::from_fn(|axis| min[axis] / 2.0 + max[axis] / 2.0);
        let half = (0..3).map(|axis| (max[axis] - centre[axis]).max(centre[axis] - min[axis]));
        Cube { centre, half: half.fold(least / 2.0, f64::max) }
    }

    /// The key of the cell that a place lies in; of the nearest one where it lies outside of the cube.
    pub(super) fn key(&self, place: [f64; 3]) -> u64 {
        let cells = f64::from(1u32 << KEY_LEVELS);
        let cell = |axis: usize| {
            let share = (place[axis] - self.centre[axis]) / self.half / 2.0 + 0.5;
            spread((share * cells).clamp(0.0, cells - 1.0) as u64)
        };
        cell(0) | cell(1) << 1 | cell(2) << 2
    }
}

/// What the keys of a node or cell of this level, 0 for the whole cube, have in common: their first bits.
pub(super) fn prefix(key: u64, level: u32) -> u64 {
    key >> (3 * (KEY_LEVELS - level.min(KEY_LEVELS)))
}

/// The numbers of a node among those of its level, from its prefix.
pub(super) fn numbers(prefix: u64) -> [i32; 3] {
    [0, 1, 2].map(|axis| gather(prefix >> axis) as i32)
}

/// Two zeros behind each of the lowest 21 bits.
fn spread(number: u64) -> u64 {
    (0..KEY_LEVELS).fold(0, |key, bit| key | (number >> bit & 1) << (3 * bit))
}

/// Every third bit, from the lowest on.
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
