//! Sparse symmetric positive definite systems of dense blocks.
//!
//! Nodes are groups of unknowns; blocks exist only for nodes that share an observation. The factorisation is a
//! right-looking block Cholesky in the order of least degree, with the last node (the border of an arrow matrix)
//! eliminated last. The inverse is computed where the factor has blocks (Takahashi's recursion), which includes all
//! diagonal blocks.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use nalgebra::{DMatrix, DVector};

/// A symmetric matrix of blocks; only blocks on and below the diagonal are stored.
#[derive(Clone, Debug)]
pub struct BlockMatrix {
    sizes: Vec<usize>,
    starts: Vec<usize>,
    places: HashMap<(u32, u32), usize>,
    blocks: Vec<DMatrix<f64>>,
}

impl BlockMatrix {
    /// A zero matrix with nodes of these sizes.
    pub fn new(sizes: Vec<usize>) -> BlockMatrix {
        let mut next = 0;
        let starts = sizes.iter().map(|size| {
            let start = next;
            next += size;
            start
        });
        let starts = starts.collect();
        let mut matrix = BlockMatrix { sizes, starts, places: HashMap::new(), blocks: Vec::new() };
        for node in 0..matrix.sizes.len() {
            matrix.block_mut(node, node);
        }
        matrix
    }

    /// Number of unknowns.
    pub fn len(&self) -> usize {
        self.starts.last().map_or(0, |start| start + self.sizes[self.sizes.len() - 1])
    }

    /// Whether there are no unknowns.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of stored values.
    pub fn stored_values(&self) -> usize {
        self.blocks.iter().map(DMatrix::len).sum()
    }

    /// Block of two nodes, `row >= column`; created if it does not exist.
    pub fn block_mut(&mut self, row: usize, column: usize) -> &mut DMatrix<f64> {
        let (sizes, blocks) = (&self.sizes, &mut self.blocks);
        let place = *self.places.entry((row as u32, column as u32)).or_insert_with(|| {
            blocks.push(DMatrix::zeros(sizes[row], sizes[column]));
            blocks.len() - 1
        });
        &mut blocks[place]
    }

    /// Takes an unknown out of the system: its row and column become those of the identity.
    ///
    /// Returns the former column.
    pub fn hold(&mut self, node: usize, offset: usize) -> DVector<f64> {
        let mut column = DVector::zeros(self.len());
        for (&(row, col), &place) in &self.places {
            let (row, col) = (row as usize, col as usize);
            let block = &mut self.blocks[place];
            if row == node && col == node {
                column.rows_mut(self.starts[node], self.sizes[node]).copy_from(&block.column(offset));
                block.column_mut(offset).fill(0.0);
                block.row_mut(offset).fill(0.0);
                block[(offset, offset)] = 1.0;
            } else if row == node {
                column.rows_mut(self.starts[col], self.sizes[col]).copy_from(&block.row(offset).transpose());
                block.row_mut(offset).fill(0.0);
            } else if col == node {
                column.rows_mut(self.starts[row], self.sizes[row]).copy_from(&block.column(offset));
                block.column_mut(offset).fill(0.0);
            }
        }
        column
    }

    /// Cholesky factor; `None` if the matrix is not positive definite.
    pub fn factor(self) -> Option<Factor> {
        let BlockMatrix { sizes, starts, places, blocks } = self;
        let order = least_degree_order(sizes.len(), places.keys().copied());
        let mut rank = vec![0u32; order.len()];
        for (k, &node) in order.iter().enumerate() {
            rank[node as usize] = k as u32;
        }
        // Blocks by column and row of the elimination order, below the diagonal.
        let mut columns: Vec<BTreeMap<u32, DMatrix<f64>>> = vec![BTreeMap::new(); order.len()];
        let mut blocks: Vec<Option<DMatrix<f64>>> = blocks.into_iter().map(Some).collect();
        for ((row, column), place) in places {
            let Some(block) = blocks[place].take() else { continue };
            let (r, c) = (rank[row as usize], rank[column as usize]);
            if r >= c {
                columns[c as usize].insert(r, block);
            } else {
                columns[r as usize].insert(c, block.transpose());
            }
        }
        let mut lower = Vec::with_capacity(order.len());
        for k in 0..order.len() {
            let mut column = std::mem::take(&mut columns[k]);
            let diagonal = column.remove(&(k as u32))?.cholesky()?.unpack();
            let mut below = Vec::with_capacity(column.len());
            for (row, block) in column {
                below.push((row, diagonal.solve_lower_triangular(&block.transpose())?.transpose()));
            }
            for (at, (column, right)) in below.iter().enumerate() {
                let right = right.transpose();
                for (row, left) in &below[at..] {
                    let target = columns[*column as usize]
                        .entry(*row)
                        .or_insert_with(|| DMatrix::zeros(left.nrows(), right.ncols()));
                    target.gemm(-1.0, left, &right, 1.0);
                }
            }
            lower.push(FactorColumn { diagonal, below });
        }
        let starts = order.iter().map(|&node| starts[node as usize]).collect();
        Some(Factor { rank, starts, lower })
    }
}

/// Order of elimination by least degree; the last node stays last.
fn least_degree_order(nodes: usize, edges: impl Iterator<Item = (u32, u32)>) -> Vec<u32> {
    let mut neighbours: Vec<BTreeSet<u32>> = vec![BTreeSet::new(); nodes];
    for (a, b) in edges.filter(|(a, b)| a != b) {
        neighbours[a as usize].insert(b);
        neighbours[b as usize].insert(a);
    }
    let last = nodes.saturating_sub(1) as u32;
    let mut queue: BTreeSet<(usize, u32)> =
        (0..last).map(|node| (neighbours[node as usize].len(), node)).collect();
    let mut order = Vec::with_capacity(nodes);
    while let Some((_, node)) = queue.pop_first() {
        order.push(node);
        let clique = std::mem::take(&mut neighbours[node as usize]);
        for &member in &clique {
            let own = &mut neighbours[member as usize];
            let degree = own.len();
            own.remove(&node);
            own.extend(clique.iter().filter(|other| **other != member));
            let new_degree = own.len();
            if member != last {
                queue.remove(&(degree, member));
                queue.insert((new_degree, member));
            }
        }
    }
    if nodes > 0 {
        order.push(last);
    }
    order
}

/// A column of the factor, in the order of elimination.
#[derive(Clone, Debug)]
struct FactorColumn {
    diagonal: DMatrix<f64>,
    below: Vec<(u32, DMatrix<f64>)>,
}

/// Cholesky factor of a [`BlockMatrix`].
#[derive(Clone, Debug)]
pub struct Factor {
    rank: Vec<u32>,
    /// First unknown of each node, in the order of elimination.
    starts: Vec<usize>,
    lower: Vec<FactorColumn>,
}

impl Factor {
    /// Number of stored values.
    pub fn stored_values(&self) -> usize {
        let of_column = |column: &FactorColumn| {
            column.diagonal.len() + column.below.iter().map(|(_, block)| block.len()).sum::<usize>()
        };
        self.lower.iter().map(of_column).sum()
    }

    /// Solution for a right-hand side in the order of the unknowns.
    pub fn solve(&self, right: &DVector<f64>) -> DVector<f64> {
        let mut x = right.clone();
        for (k, column) in self.lower.iter().enumerate() {
            let (start, size) = (self.starts[k], column.diagonal.nrows());
            column.diagonal.solve_lower_triangular_mut(&mut x.rows_mut(start, size));
            let own = x.rows(start, size).clone_owned();
            for (row, block) in &column.below {
                x.rows_mut(self.starts[*row as usize], block.nrows()).gemv(-1.0, block, &own, 1.0);
            }
        }
        for (k, column) in self.lower.iter().enumerate().rev() {
            let (start, size) = (self.starts[k], column.diagonal.nrows());
            let mut own = x.rows(start, size).clone_owned();
            for (row, block) in &column.below {
                own.gemv_tr(-1.0, block, &x.rows(self.starts[*row as usize], block.nrows()), 1.0);
            }
            column.diagonal.tr_solve_lower_triangular_mut(&mut own);
            x.rows_mut(start, size).copy_from(&own);
        }
        x
    }

    /// Inverse where the factor has blocks.
    pub fn selected_inverse(&self) -> SelectedInverse {
        let mut blocks: HashMap<(u32, u32), DMatrix<f64>> = HashMap::new();
        for (k, column) in self.lower.iter().enumerate().rev() {
            let k = k as u32;
            let size = column.diagonal.nrows();
            let inverse = column
                .diagonal
                .solve_lower_triangular(&DMatrix::identity(size, size))
                .unwrap_or_else(|| DMatrix::zeros(size, size));
            // Y = L_below L_kk^-1; Z_ik = -sum Z_ij Y_j; Z_kk = L_kk^-T L_kk^-1 - sum Y_i^T Z_ik.
            let scaled: Vec<_> = column.below.iter().map(|(row, block)| (*row, block * &inverse)).collect();
            let mut diagonal = inverse.tr_mul(&inverse);
            let mut made = Vec::with_capacity(scaled.len());
            for (i, own) in &scaled {
                let mut z = DMatrix::zeros(own.nrows(), size);
                for (j, y) in &scaled {
                    if i >= j {
                        if let Some(block) = blocks.get(&(*i, *j)) {
                            z.gemm(-1.0, block, y, 1.0);
                        }
                    } else if let Some(block) = blocks.get(&(*j, *i)) {
                        z.gemm_tr(-1.0, block, y, 1.0);
                    }
                }
                diagonal.gemm_tr(-1.0, own, &z, 1.0);
                made.push(((*i, k), z));
            }
            blocks.extend(made);
            blocks.insert((k, k), diagonal);
        }
        SelectedInverse { rank: self.rank.clone(), blocks }
    }
}

/// Blocks of an inverse.
#[derive(Clone, Debug)]
pub struct SelectedInverse {
    rank: Vec<u32>,
    blocks: HashMap<(u32, u32), DMatrix<f64>>,
}

impl SelectedInverse {
    /// Diagonal block of a node; `None` if there is no such node.
    pub fn diagonal(&self, node: usize) -> Option<&DMatrix<f64>> {
        let rank = *self.rank.get(node)?;
        self.blocks.get(&(rank, rank))
    }

    /// Element of two unknowns, each a node and its place there; `None` where the factor has no block.
    pub fn value(&self, (row, i): (usize, usize), (column, j): (usize, usize)) -> Option<f64> {
        let (row, column) = (*self.rank.get(row)?, *self.rank.get(column)?);
        match row >= column {
            true => self.blocks.get(&(row, column)).map(|block| block[(i, j)]),
            false => self.blocks.get(&(column, row)).map(|block| block[(j, i)]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::{Rng, SeedableRng};

    /// A random arrow matrix, with its dense form.
    fn arrow(sizes: &[usize], links: &[(usize, usize)], seed: u64) -> (BlockMatrix, DMatrix<f64>) {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let mut uniform = || random.next_u64() as f64 / u64::MAX as f64 - 0.5;
        let mut matrix = BlockMatrix::new(sizes.to_vec());
        let starts = matrix.starts.clone();
        let mut dense = DMatrix::zeros(matrix.len(), matrix.len());
        for &(row, column) in links {
            let (a, b) = (row.max(column), row.min(column));
            for i in 0..sizes[a] {
                for j in 0..sizes[b] {
                    let value = uniform();
                    matrix.block_mut(a, b)[(i, j)] = value;
                    dense[(starts[a] + i, starts[b] + j)] = value;
                    dense[(starts[b] + j, starts[a] + i)] = value;
                }
            }
        }
        for node in 0..sizes.len() {
            for i in 0..sizes[node] {
                matrix.block_mut(node, node)[(i, i)] = 20.0;
                dense[(starts[node] + i, starts[node] + i)] = 20.0;
            }
        }
        (matrix, dense)
    }

    const SIZES: [usize; 7] = [6, 12, 6, 3, 6, 1, 5];
    const LINKS: [(usize, usize); 9] =
        [(0, 1), (1, 2), (3, 4), (0, 6), (2, 6), (4, 6), (1, 4), (0, 5), (2, 3)];

    #[test]
    fn solutions_and_inverse_equal_those_of_the_dense_matrix() {
        for seed in 0..5 {
            let (matrix, dense) = arrow(&SIZES, &LINKS, seed);
            let starts = matrix.starts.clone();
            let right = DVector::from_fn(matrix.len(), |k, _| (k as f64 * 0.7).sin());
            let factor = matrix.factor().unwrap();
            let inverse = dense.try_inverse().unwrap();
            assert!((factor.solve(&right) - &inverse * &right).amax() < 1e-14);
            let selected = factor.selected_inverse();
            for (node, size) in SIZES.into_iter().enumerate() {
                let expected = inverse.view((starts[node], starts[node]), (size, size));
                assert!((selected.diagonal(node).unwrap() - expected).amax() < 1e-14, "{node}");
            }
        }
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_has_no_factor() {
        let (mut matrix, _) = arrow(&SIZES, &LINKS, 1);
        matrix.block_mut(3, 3)[(1, 1)] = -1.0;
        assert!(matrix.factor().is_none());
    }

    /// Holding an unknown solves for the others as if it did not exist.
    #[test]
    fn a_held_unknown_does_not_take_part() {
        let (mut matrix, dense) = arrow(&SIZES, &LINKS, 2);
        let held = matrix.starts[4] + 2;
        let column = matrix.hold(4, 2);
        assert!((column - dense.column(held)).amax() < 1e-15);
        let mut right = DVector::from_fn(matrix.len(), |k, _| (k as f64 * 0.3).cos());
        right[held] = 0.0;
        let found = matrix.factor().unwrap().solve(&right).remove_row(held);
        let reduced = dense.remove_row(held).remove_column(held);
        assert!((found - reduced.try_inverse().unwrap() * right.remove_row(held)).amax() < 1e-14);
    }

    /// A chain of nodes with a border has no more blocks in its factor than in itself.
    #[test]
    fn a_chain_with_a_border_has_no_fill() {
        let nodes = 50;
        let links: Vec<_> =
            (1..nodes - 1).map(|k| (k, k - 1)).chain((0..nodes - 1).map(|k| (nodes - 1, k))).collect();
        let (matrix, _) = arrow(&vec![4; nodes], &links, 3);
        let before = matrix.stored_values();
        assert_eq!(matrix.factor().unwrap().stored_values(), before);
    }
}
