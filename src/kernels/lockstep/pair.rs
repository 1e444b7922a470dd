//! Two pulses per waveform, jointly.

use super::rows::{FRONT, Rows, sixteen};
use super::single::{echo, echoes, last_sample};
use super::solve::factor;
use super::tables::{PHASES, ROW, TAIL, Tables};
use super::template::{Pulses, Sites, counted, leaves_block, template, weights};
use super::vector::{LANES, Simd};
use super::{Pair, WidthPrior};

/// Samples of the joint frame, from the row of the earlier pulse on.
const FRAME: usize = 48;
/// The later row starts at most this far into the frame.
const FARTHEST: i32 = (FRAME - ROW) as i32;
/// Largest change of position (samples) and of `ln` width in one iteration.
const LIMITS: [f32; 2] = [1.0, 0.3];
/// Marquardt's factor on the diagonal: keeps a step between nearly equal pulses finite.
const DAMPING: f32 = 1.0001;
/// Unknowns.
const N: usize = 6;
/// Dot products of an iteration: the triangle of the normal matrix, the right side, the residual's square.
pub(super) const DOTS: usize = N * (N + 1) / 2 + N + 1;

/// Dot products before their sums: per product one vector of each waveform.
pub(super) type Dots<V> = [[V; LANES]; DOTS];

/// The joint frames of sixteen waveforms.
struct Frames {
    sites: [Sites; 2],
    /// Block sample of the frame's first.
    first: [i32; LANES],
}

impl Frames {
    #[inline(always)]
    fn of<S: Simd>(s: S, pulses: &[Pulses<S::V>; 2]) -> Frames {
        let sites = [Sites::of(s, &pulses[0]), Sites::of(s, &pulses[1])];
        let mut first = [0; LANES];
        for (w, first) in first.iter_mut().enumerate() {
            *first = sites[0].first[w].min(sites[1].first[w]);
        }
        Frames { sites, first }
    }

    /// How far into the frame a pulse's row starts.
    #[inline(always)]
    fn shift(&self, pulse: usize, w: usize) -> usize {
        (self.sites[pulse].first[w] - self.first[w]).clamp(0, FARTHEST) as usize
    }
}

/// Derivatives and residual of one waveform's frame, three vectors each.
#[inline(always)]
fn jacobian<S: Simd, const EDGE: bool>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    frames: &Frames,
    w: usize,
) -> [[S::V; N + 1]; FRAME / LANES] {
    let zero = s.splat(0.0);
    let whitened = rows.whitened.as_slice();
    let at = (rows.row_start(w) + FRONT).saturating_add_signed(frames.first[w] as isize);
    let mut out = [[zero; N + 1]; FRAME / LANES];
    for (c, row) in out.iter_mut().enumerate() {
        let mut residual = s.load(sixteen(whitened, at + c * LANES));
        for (p, sites) in frames.sites.iter().enumerate() {
            let entry = tables.entry(sites.entry[w]);
            let from = LANES + c * LANES - frames.shift(p, w);
            let (late, wider) = (s.splat(sites.late[w]), s.splat(sites.wider[w]));
            let [h, t, u] = template(s, entry, from, late, wider);
            row[3 * p] = h;
            row[3 * p + 1] = t;
            row[3 * p + 2] = u;
            let amplitude = s.splat(sites.amplitude[w]);
            residual = s.fnma(amplitude, h, residual);
            // The slow tail behind the row, which only the frame's last vector reaches.
            if c * LANES >= ROW {
                let tail = tables.tail(sites.entry[w] % PHASES);
                let slow = s.load(sixteen(tail, LANES + c * LANES - ROW - frames.shift(p, w)));
                residual = s.fnma(amplitude, slow, residual);
            }
        }
        row[N] = residual;
        if EDGE {
            let first = frames.first[w] + (c * LANES) as i32;
            let weight = weights(s, first, tables.order, rows.lengths[w]);
            for value in row.iter_mut() {
                *value = s.mul(*value, weight);
            }
        }
    }
    out
}

/// The dot products at sixteen pairs: for `i` from 0, the products of column `i` with columns 0 to `i`; the residual is
/// the last column.
#[inline(always)]
fn dots<S: Simd, const EDGE: bool>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    frames: &Frames,
    sums: &mut Dots<S::V>,
) {
    for w in 0..LANES {
        let columns = jacobian::<S, EDGE>(s, tables, rows, frames, w);
        let mut k = 0;
        for i in 0..=N {
            for j in 0..=i {
                let mut sum = s.mul(columns[0][i], columns[0][j]);
                for row in &columns[1..] {
                    sum = s.fma(row[i], row[j], sum);
                }
                sums[k][w] = sum;
                k += 1;
            }
        }
    }
}

/// Damped Gauss-Newton iterations on two pulses with a prior on their widths, then covariance and chi-square.
#[inline(always)]
pub(super) fn newton<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    mut pulses: [Pulses<S::V>; 2],
    prior: WidthPrior,
    iterations: usize,
    sums: &mut Dots<S::V>,
    out: &mut [Pair],
) {
    let last = last_sample(s, rows);
    let precision = s.splat(prior.precision());
    pulses = [pulses[0].within(s, last), pulses[1].within(s, last)];
    for iteration in 0..=iterations {
        let frames = Frames::of(s, &pulses);
        let edge = out
            .iter()
            .enumerate()
            .take(LANES)
            .any(|(w, _)| leaves_block(frames.first[w], FRAME, tables.order, rows.lengths[w]));
        if edge {
            dots::<S, true>(s, tables, rows, &frames, sums);
        } else {
            dots::<S, false>(s, tables, rows, &frames, sums);
        }
        let (mut matrix, mut side) = equations(s, sums, &pulses);
        for (p, pulse) in pulses.iter().enumerate() {
            let u = 3 * p + 2;
            matrix[u][u] = s.add(matrix[u][u], precision);
            side[u] = s.fma(precision, s.sub(s.splat(prior.ln_width_ratio), pulse.width), side[u]);
        }
        if iteration == iterations {
            let variances = factor(s, matrix).inverse_diagonal(s);
            let [v0, v1, v2, v3, v4, v5] = variances;
            let values = [echoes(s, &pulses[0], [v0, v1, v2]), echoes(s, &pulses[1], [v3, v4, v5])];
            let mut squares = [0.0; LANES];
            s.store(s.sum_each(&sums[DOTS - 1]), &mut squares);
            for (w, pair) in out.iter_mut().enumerate().take(LANES) {
                let (first, length) = (frames.first[w], rows.lengths[w]);
                pair.echoes = [echo(&values[0], w), echo(&values[1], w)];
                pair.chi_square = squares[w];
                pair.degrees_of_freedom = counted(first, FRAME, tables.order, length) - N as i32;
                pair.at_edge = leaves_block(first, FRAME, tables.order, length);
                let apart = frames.sites[0].first[w].abs_diff(frames.sites[1].first[w]);
                pair.beyond_frame = apart > FARTHEST as u32;
            }
            return;
        }
        for (i, row) in matrix.iter_mut().enumerate() {
            row[i] = s.mul(row[i], s.splat(DAMPING));
        }
        factor(s, matrix).solve(s, &mut side);
        let (one, two) = side.split_at(3);
        pulses = [pulses[0].stepped(s, one, LIMITS, last), pulses[1].stepped(s, two, LIMITS, last)];
    }
}

/// Normal matrix (lower triangle) and right side out of the dot products.
#[inline(always)]
fn equations<S: Simd>(s: S, sums: &Dots<S::V>, pulses: &[Pulses<S::V>; 2]) -> ([[S::V; N]; N], [S::V; N]) {
    let zero = s.splat(0.0);
    // The derivatives by position and width are −a h_t and a h_u.
    let mut scale = [s.splat(1.0); N];
    for (p, pulse) in pulses.iter().enumerate() {
        scale[3 * p + 1] = s.sub(zero, pulse.amplitude);
        scale[3 * p + 2] = pulse.amplitude;
    }
    let (mut matrix, mut side) = ([[zero; N]; N], [zero; N]);
    let mut k = 0;
    for i in 0..N {
        for j in 0..=i {
            matrix[i][j] = s.mul(s.sum_each(&sums[k]), s.mul(scale[i], scale[j]));
            k += 1;
        }
    }
    for i in 0..N {
        side[i] = s.mul(s.sum_each(&sums[k]), scale[i]);
        k += 1;
    }
    (matrix, side)
}

// The tail's row reaches as far as the frame reads it.
const _: () = assert!(TAIL + 2 * LANES >= 2 * LANES + (FRAME - ROW));
