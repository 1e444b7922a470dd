//! Rao's score test: does the residual of a fitted pulse indicate two pulses?
//!
//! Two close pulses differ from one of free height, position and width first by the third and
//! fourth derivative in time. By the heat equation, and apart from what the fitted values explain,
//! these are the mixed derivative `s_tu` and the second derivative `s_uu`. Let `P` be the
//! projection onto the complement of the fitted values' directions. For one pulse, `q = ‖P r‖²` on
//! the span of the two derivatives follows chi-square with two degrees of freedom. Two equal pulses
//! farther apart leave more than these directions show. Their expected residual is a third
//! direction, of known sign, and the larger of the two scores counts.

use wavex_simd::{Kernel, LANES, Simd};

use super::layout::{ROW, ROW_STRIDE, sixteen};
use super::pulse_model::PulseComponent;
use super::rows::{EMPTY, FRONT, Rows};
use super::solve::factor;
use super::tables::Tables;
use super::template::{Lookup, VECTORS, leaves_block, template, weights};
use crate::shape::SD_OF_FWHM;

/// Directions of the three fitted values and the three of a split.
const N: usize = 6;
/// Products of the columns with each other and with the residual.
const PRODUCTS: usize = N * (N + 1) / 2 + N;

/// Products before summation.
type GateSums<H> = [[H; LANES]; PRODUCTS];

/// Computes `q` of pulses that are subtracted from their rows.
pub(super) struct Scores<'a> {
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a Rows,
    pub(super) pulses: &'a [(usize, PulseComponent)],
    /// Score, and whether the earlier of two pulses would be the stronger one.
    pub(super) out: &'a mut Vec<(f32, bool)>,
}

impl Kernel for Scores<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let mut sums = [[s.halved(s.splat(0.0)); LANES]; PRODUCTS];
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
    pulses: &[(usize, PulseComponent)],
    sums: &mut GateSums<S::Half>,
) -> [(f32, bool); LANES] {
    let idle = PulseComponent::of_calibrated_width(1.0, 20.0);
    for w in 0..LANES {
        let (row, pulse) = pulses.get(w).copied().unwrap_or((EMPTY, idle));
        let lookup = Lookup::of(tables, pulse.values());
        products(s, tables, rows, row, &lookup, &halves(tables, &pulse), w, sums);
    }
    let zero = s.splat(0.0);
    let mut products = [zero; PRODUCTS];
    for (product, sums) in products.iter_mut().zip(sums.iter()) {
        *product = s.sum_each(sums);
    }
    let bent = equations::<S, 5>(s, &products, [0, 1, 2, 3, 4]);
    let two = s.add(bent[3].0, bent[4].0);
    let (equal, along) = equations::<S, 4>(s, &products, [0, 1, 2, 5])[3];
    let equal = s.select(s.gt(along, zero), equal, zero);
    let mut scores = [0.0; LANES];
    s.store(s.max(two, equal), &mut scores);
    // A stronger pulse before a weaker one leaves a negative residual along the third derivative.
    let earlier = s.gt(zero, bent[3].1);
    let mut out = [(0.0, false); LANES];
    for (w, (score, is_earlier)) in out.iter_mut().enumerate() {
        (*score, *is_earlier) = (scores[w], earlier & (1 << w) != 0);
    }
    out
}

/// Part of the squared residual explained by each column in addition to earlier ones.
///
/// The second value has the sign of the column's coefficient.
#[inline(always)]
fn equations<S: Simd, const M: usize>(
    s: S,
    products: &[S::V; PRODUCTS],
    columns: [usize; M],
) -> [(S::V, S::V); M] {
    let zero = s.splat(0.0);
    let (mut matrix, mut side) = ([[zero; M]; M], [zero; M]);
    for i in 0..M {
        for j in 0..=i {
            let (a, b) = (columns[i], columns[j]);
            matrix[i][j] = products[a * (a + 1) / 2 + b];
        }
        // A direction outside the block then explains nothing.
        matrix[i][i] = s.add(matrix[i][i], s.splat(1e-6));
        side[i] = products[N * (N + 1) / 2 + columns[i]];
    }
    factor(s, matrix).explained(s, side)
}

#[inline(always)]
fn products<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    row: usize,
    lookup: &Lookup,
    pair: &[Lookup; 2],
    w: usize,
    sums: &mut GateSums<S::Half>,
) {
    let (values, length) = (rows.residual_row(row), rows.length(row));
    let edge = leaves_block(lookup.first, ROW, tables.order, length);
    let entry = tables.entry(lookup.nodes[0], lookup.entry);
    // The six directions and the residual.
    let mut columns = [[s.splat(0.0); VECTORS]; N + 1];
    unrolled!(c in [0 1] if VECTORS => {
        let at = LANES + c * LANES;
        let first = lookup.first + (c * LANES) as i32;
        let shape = template::<S, false>(s, tables, lookup, at);
        columns[0][c] = shape.pulse;
        columns[1][c] = shape.by_time;
        columns[2][c] = shape.by_width;
        columns[3][c] = s.load(sixteen(entry, at + 5 * ROW_STRIDE));
        columns[4][c] = s.load(sixteen(entry, at + 4 * ROW_STRIDE));
        columns[5][c] = equal_pair(s, tables, pair, first);
        columns[6][c] = s.load(sixteen(values, FRONT.saturating_add_signed(first as isize)));
        if edge {
            let weight = weights(s, first, tables.order, length);
            unrolled!(i in [0 1 2 3 4 5] if N => {
                columns[i][c] = s.mul(columns[i][c], weight);
            });
        }
    });
    unrolled!(i in [0 1 2 3 4 5 6] if N + 1 => {
        unrolled!(j in [0 1 2 3 4 5] if (i + 1).min(N) => {
            let product = s.mul(columns[i][0], columns[j][0]);
            let sum = s.fma(columns[i][1], columns[j][1], product);
            sums[i * (i + 1) / 2 + j][w] = s.halved(sum);
        });
    });
}

/// Two equal pulses of calibrated width in place of a widened one.
///
/// They have its energy, centre and variance.
#[inline(always)]
fn halves(tables: &Tables, pulse: &PulseComponent) -> [Lookup; 2] {
    let [height, position, _] = pulse.values();
    let ratio = pulse.width_ratio();
    let reach = SD_OF_FWHM as f32 * tables.fwhm_samples as f32 * (ratio * ratio - 1.0).max(0.0).sqrt();
    let half = |position: f32| Lookup::of(tables, [0.5 * ratio * height, position, 0.0]);
    [half(position - reach), half(position + reach)]
}

/// Sixteen samples of two pulses from `first` on, relative to the pulse that they replace.
#[inline(always)]
fn equal_pair<S: Simd>(s: S, tables: &Tables, pair: &[Lookup; 2], first: i32) -> S::V {
    let mut sum = s.splat(0.0);
    unrolled!(i in [0 1] if 2 => {
        let at = first - pair[i].first + LANES as i32;
        if (1..(LANES + ROW) as i32).contains(&at) {
            sum = s.add(sum, template::<S, false>(s, tables, &pair[i], at as usize).pulse);
        }
    });
    sum
}
