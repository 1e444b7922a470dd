//! Rao's score test: whether the residual of one fitted pulse speaks for two.
//!
//! Two pulses near each other differ from one of free height, place and width first by the third and fourth derivative in
//! time. By the heat equation these are, but for what the fitted values explain, the mixed derivative `s_tu` and the second
//! one `s_uu`. With `P` the projection beside the fitted values' directions, `q = ‖P r‖²` on the span of the two follows
//! chi-square of two degrees of freedom under one pulse.

use super::fit::Values;
use super::rows::{EMPTY, FRONT, Rows, sixteen};
use super::solve::factor;
use super::tables::{ROW, ROW_STRIDE, Tables};
use super::template::{Site, VECTORS, leaves_block, template, weights};
use super::vector::{Kernel, LANES, Simd};

/// The fitted values' directions and the two of a division.
const N: usize = 5;
/// Products of the five columns with each other and with the residual.
const PRODUCTS: usize = N * (N + 1) / 2 + N;

/// Products before their sums.
type GateSums<V> = [[V; LANES]; PRODUCTS];

/// `q` of pulses, given by row and values, that have been taken off their rows.
pub(super) struct Scores<'a> {
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a Rows,
    pub(super) pulses: &'a [(usize, Values)],
    pub(super) out: &'a mut Vec<f32>,
}

impl Kernel for Scores<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let mut sums = [[s.splat(0.0); LANES]; PRODUCTS];
        self.out.clear();
        for pulses in self.pulses.chunks(LANES) {
            let scores = scores(s, self.tables, self.rows, pulses, &mut sums);
            self.out.extend_from_slice(&scores[..pulses.len()]);
        }
    }
}

#[inline(always)]
fn scores<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    pulses: &[(usize, Values)],
    sums: &mut GateSums<S::V>,
) -> [f32; LANES] {
    for w in 0..LANES {
        let (row, values) = pulses.get(w).copied().unwrap_or((EMPTY, [1.0, 20.0, 0.0]));
        products(s, tables, rows, row, &Site::of(tables, values), w, sums);
    }
    let zero = s.splat(0.0);
    let (mut matrix, mut side) = ([[zero; N]; N], [zero; N]);
    let mut k = 0;
    for i in 0..N {
        for j in 0..=i {
            matrix[i][j] = s.sum_each(&sums[k]);
            k += 1;
        }
        // A direction that the block does not hold tells nothing.
        matrix[i][i] = s.add(matrix[i][i], s.splat(1e-6));
    }
    for value in side.iter_mut() {
        *value = s.sum_each(&sums[k]);
        k += 1;
    }
    let shares = factor(s, matrix).explained(s, side);
    let mut out = [0.0; LANES];
    s.store(s.add(shares[3], shares[4]), &mut out);
    out
}

#[inline(always)]
fn products<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    row: usize,
    site: &Site,
    w: usize,
    sums: &mut GateSums<S::V>,
) {
    let (values, length) = (rows.residual_row(row), rows.length(row));
    let edge = leaves_block(site.first, ROW, tables.order, length);
    let entry = tables.entry(site.nodes[0], site.entry);
    let mut acc = [s.splat(0.0); PRODUCTS];
    for c in 0..VECTORS {
        let at = LANES + c * LANES;
        let first = site.first + (c * LANES) as i32;
        let shape = template::<S, false>(s, tables, site, at);
        let mut columns = [
            shape.pulse,
            shape.by_time,
            shape.by_width,
            s.load(sixteen(entry, at + 5 * ROW_STRIDE)),
            s.load(sixteen(entry, at + 4 * ROW_STRIDE)),
        ];
        if edge {
            let weight = weights(s, first, tables.order, length);
            for column in columns.iter_mut() {
                *column = s.mul(*column, weight);
            }
        }
        let residual = s.load(sixteen(values, FRONT.saturating_add_signed(first as isize)));
        let mut k = 0;
        for i in 0..N {
            for j in 0..=i {
                acc[k] = s.fma(columns[i], columns[j], acc[k]);
                k += 1;
            }
        }
        for column in columns {
            acc[k] = s.fma(column, residual, acc[k]);
            k += 1;
        }
    }
    for (sums, acc) in sums.iter_mut().zip(acc) {
        sums[w] = acc;
    }
}
