//! Assigns points to octree nodes from a stream in key order.
//!
//! A node takes the first point of each of its cells that no coarser node took; the others go to
//! deeper nodes. A node that holds few points, including those below it, takes them all. Key order
//! makes this possible with only one open node per level: those that contain the current point.

use super::cube::{self, CELL_LEVELS, DEEPEST};

/// Complete node.
#[derive(Debug, PartialEq)]
pub(super) struct OctreeNode {
    pub(super) level: u32,
    /// Common leading key bits of its points.
    pub(super) prefix: u64,
    /// Records of its points.
    pub(super) records: Vec<u8>,
}

/// Octree builder.
pub(super) struct Octree {
    /// Maximum number of points of a leaf and its descendants.
    leaf_points: u64,
    /// Nodes that contain the last point, from the root down.
    open: Vec<OpenNode>,
}

/// Node that can still receive points.
struct OpenNode {
    prefix: u64,
    /// Cell of the last point taken.
    cell: Option<u64>,
    records: Vec<u8>,
    /// Number of points received, including those passed to deeper nodes.
    points: u64,
    /// Leaves below.
    ///
    /// They are merged into this node if it becomes a leaf itself.
    leaves: Vec<OctreeNode>,
}

impl Octree {
    pub(super) fn new(leaf_points: u64) -> Octree {
        Octree { leaf_points, open: Vec::new() }
    }

    /// Adds the next point; complete nodes go to `done`.
    ///
    /// Keys must not decrease.
    ///
    /// # Errors
    /// `done` fails.
    pub(super) fn push<E>(
        &mut self,
        key: u64,
        record: &[u8],
        done: &mut impl FnMut(OctreeNode) -> Result<(), E>,
    ) -> Result<(), E> {
        let is_open = |(level, node): (usize, &OpenNode)| node.prefix == cube::prefix(key, level as u32);
        let kept = self.open.iter().enumerate().take_while(|(level, node)| is_open((*level, node))).count();
        self.close(kept, done)?;
        for level in 0..=DEEPEST {
            if self.open.len() == level as usize {
                self.open.push(OpenNode::new(cube::prefix(key, level)));
            }
            let Some(node) = self.open.get_mut(level as usize) else { break };
            node.points += 1;
            let cell = cube::prefix(key, level + CELL_LEVELS);
            if level == DEEPEST || node.cell != Some(cell) {
                node.cell = Some(cell);
                node.records.extend_from_slice(record);
                break;
            }
        }
        Ok(())
    }

    /// Completes all nodes.
    ///
    /// # Errors
    /// `done` fails.
    pub(super) fn finish<E>(mut self, done: &mut impl FnMut(OctreeNode) -> Result<(), E>) -> Result<(), E> {
        self.close(0, done)
    }

    /// Closes nodes from the deepest up, until `kept` are left.
    fn close<E>(&mut self, kept: usize, done: &mut impl FnMut(OctreeNode) -> Result<(), E>) -> Result<(), E> {
        while self.open.len() > kept {
            let Some(node) = self.open.pop() else { break };
            let is_leaf = node.points <= self.leaf_points;
            let (own, leaves) = node.into_nodes(self.open.len() as u32, is_leaf);
            match self.open.last_mut() {
                Some(parent) if is_leaf => {
                    parent.leaves.push(own);
                    if parent.points > self.leaf_points {
                        std::mem::take(&mut parent.leaves).into_iter().try_for_each(&mut *done)?;
                    }
                }
                _ => std::iter::once(own).chain(leaves).try_for_each(&mut *done)?,
            }
        }
        Ok(())
    }
}

impl OpenNode {
    fn new(prefix: u64) -> OpenNode {
        OpenNode { prefix, cell: None, records: Vec::new(), points: 0, leaves: Vec::new() }
    }

    /// Returns the node and the leaves below it.
    ///
    /// A leaf absorbs them.
    fn into_nodes(self, level: u32, is_leaf: bool) -> (OctreeNode, Vec<OctreeNode>) {
        let OpenNode { prefix, mut records, mut leaves, .. } = self;
        if is_leaf {
            leaves.drain(..).for_each(|leaf| records.extend(leaf.records));
        }
        (OctreeNode { level, prefix, records }, leaves)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::convert::Infallible;

    use proptest::prelude::*;

    use super::super::cube::KEY_LEVELS;
    use super::*;

    /// Returns the nodes of points whose records are their keys.
    fn nodes(keys: &[u64], leaf_points: u64) -> Vec<OctreeNode> {
        let mut nodes = Vec::new();
        let mut done = |node| {
            nodes.push(node);
            Ok::<(), Infallible>(())
        };
        let mut octree = Octree::new(leaf_points);
        for key in keys {
            octree.push(*key, &key.to_le_bytes(), &mut done).unwrap();
        }
        octree.finish(&mut done).unwrap();
        nodes
    }

    fn keys(node: &OctreeNode) -> Vec<u64> {
        node.records.chunks(8).map(|bytes| u64::from_le_bytes(bytes.try_into().unwrap())).collect()
    }

    #[test]
    fn few_points_are_one_node() {
        let found = nodes(&[0, 0, 5, 1 << 62], 4);
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].level, keys(&found[0])), (0, vec![0, 1 << 62, 0, 5]));
    }

    #[test]
    fn the_first_of_a_cell_stays_and_the_others_go_down() {
        // Three points in the first cell of the cube, one in its last: more than a leaf holds.
        let cell = 1u64 << (3 * (KEY_LEVELS - CELL_LEVELS));
        let found = nodes(&[0, 1, 2, 127 * cell], 2);
        let by_level: BTreeMap<u32, Vec<u64>> = found.iter().map(|node| (node.level, keys(node))).collect();
        assert_eq!(by_level, BTreeMap::from([(0, vec![0, 127 * cell]), (1, vec![1, 2])]));
    }

    #[test]
    fn points_in_one_place_end_in_the_deepest_node() {
        let found = nodes(&[7; 100], 2);
        let mut sizes: Vec<(u32, usize)> = found.iter().map(|node| (node.level, keys(node).len())).collect();
        sizes.sort();
        let expected: Vec<(u32, usize)> =
            (0..DEEPEST).map(|level| (level, 1)).chain([(DEEPEST, 86)]).collect();
        assert_eq!(sizes, expected);
    }

    proptest! {
        #[test]
        fn each_point_is_in_one_node_that_it_lies_in_below_others(
            mut points in prop::collection::vec(0u64..1 << 63, 0..400), shift in 0u32..50, leaf_points in 1u64..40
        ) {
            // Shifted keys cluster in a corner.
            points.iter_mut().for_each(|key| *key >>= shift);
            points.sort();
            let found = nodes(&points, leaf_points);
            let mut all: Vec<u64> = found.iter().flat_map(keys).collect();
            all.sort();
            prop_assert_eq!(all, points);
            let places: BTreeMap<(u32, u64), &OctreeNode> =
                found.iter().map(|node| ((node.level, node.prefix), node)).collect();
            prop_assert_eq!(places.len(), found.len());
            for node in &found {
                prop_assert!(!node.records.is_empty());
                prop_assert!(keys(node).iter().all(|key| cube::prefix(*key, node.level) == node.prefix));
                let parent = node.level.checked_sub(1).map(|level| (level, node.prefix >> 3));
                prop_assert!(parent.is_none_or(|parent| places.contains_key(&parent)));
            }
        }
    }
}
