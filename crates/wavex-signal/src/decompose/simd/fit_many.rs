//! Joint Levenberg-Marquardt fits of four to eight pulses, on sixteen rows at a time.
//!
//! The method of [`super::fit`], with loops in place of unrolled code. The columns of a pulse hold
//! its own row only, and products are computed for pulses whose rows overlap.

use wavex_simd::{Kernel, LANES, Simd};

use super::fit::{
    DAMPING, DECREASE, FitJob, HELD, NO_DECREASE, ProductSums, ROUNDING, beyond_limits, results_of_lanes,
    start_of,
};
use super::fitted::Fitted;
use super::layout::{ROW, U_MAX, sixteen};
use super::pulse_model::MAX_CLUSTER;
use super::rows::{FRONT, Rows};
use super::solve::PackedFactors;
use super::tables::Tables;
use super::template::{Lookup, Lookups, Pulses, VECTORS, leaves_block, tail, template, weights};
use crate::pulse_fit::NEAR_NEWTON;

/// Largest number of parameters.
const N: usize = 3 * MAX_CLUSTER;
/// Values of a packed lower triangle.
const PACKED: usize = N * (N + 1) / 2;
/// Vectors that hold a pulse's row at any offset from the frame.
const OF_PULSE: usize = VECTORS + 1;
/// Largest number of vectors in a frame, from the row of the first pulse to that of the last.
const FRAME: usize = 32;
/// Distance beyond which two pulses of the calibrated width count as independent, in such widths.
///
/// Only the tail of the earlier one reaches the later one there: its correlation of some percent
/// changes variances by less than a hundredth. The optimum does not depend on it.
const INDEPENDENT_WIDTHS: f64 = 4.0;

/// Fits all jobs, each of the first `count` pulses.
///
/// `precision` is that of the prior that draws `ln` widths to 0.
pub(super) struct FitMany<'a, const STRONG: bool> {
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a Rows,
    pub(super) jobs: &'a [FitJob<MAX_CLUSTER>],
    pub(super) count: usize,
    pub(super) precision: f32,
    pub(super) iterations: usize,
    pub(super) out: &'a mut Vec<Fitted<MAX_CLUSTER>>,
}

impl<const STRONG: bool> Kernel for FitMany<'_, STRONG> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let FitMany { tables, rows, precision, iterations, out, .. } = self;
        let count = self.count.min(MAX_CLUSTER);
        let none = s.halved(s.splat(0.0));
        let mut frames = [Frame::none(s.splat(0.0)); LANES];
        let mut sums = [[none; LANES]; 9];
        out.resize(self.jobs.len(), Fitted::NOTHING);
        for (jobs, out) in self.jobs.chunks(LANES).zip(out.chunks_mut(LANES)) {
            let (row, last, start) = start_of(s, rows, jobs);
            let (frames, sums) = (&mut frames, &mut sums);
            let mut group = ManyGroup { s, tables, rows, row, last, count, precision, frames, sums };
            let lanes = (1u32 << jobs.len().min(LANES)).wrapping_sub(1) as u16;
            group.descend::<STRONG>(start, lanes, iterations, out);
        }
    }
}

/// Residual of a row around the pulses, and the derivatives of these.
#[derive(Clone, Copy)]
struct Frame<V> {
    vectors: usize,
    residual: [V; FRAME],
    /// First vector of each pulse.
    from: [usize; MAX_CLUSTER],
    /// By pulse, vector and value.
    columns: [[[V; 3]; OF_PULSE]; MAX_CLUSTER],
}

impl<V: Copy> Frame<V> {
    #[inline(always)]
    fn none(zero: V) -> Frame<V> {
        Frame {
            vectors: 0,
            residual: [zero; FRAME],
            from: [0; MAX_CLUSTER],
            columns: [[[zero; 3]; OF_PULSE]; MAX_CLUSTER],
        }
    }
}

/// The normal equations at a point, and the objective.
#[derive(Clone, Copy)]
struct ManyEquations<V> {
    matrix: [V; PACKED],
    side: [V; N],
    objective: V,
    /// First parameter that the parameters of a pulse are coupled to in any lane.
    first: [usize; MAX_CLUSTER],
}

/// Index of an element of the lower triangle.
#[inline(always)]
const fn packed(row: usize, column: usize) -> usize {
    row * (row + 1) / 2 + column
}

/// Sixteen rows with `count` pulses each.
struct ManyGroup<'a, S: Simd> {
    s: S,
    tables: &'a Tables,
    rows: &'a Rows,
    row: [usize; LANES],
    last: S::V,
    count: usize,
    precision: f32,
    frames: &'a mut [Frame<S::V>; LANES],
    sums: &'a mut ProductSums<S::Half, 9>,
}

impl<S: Simd> ManyGroup<'_, S> {
    #[inline(always)]
    fn descend<const STRONG: bool>(
        &mut self,
        start: [Pulses<S::V>; MAX_CLUSTER],
        lanes: u16,
        iterations: usize,
        out: &mut [Fitted<MAX_CLUSTER>],
    ) {
        let (s, count) = (self.s, self.count);
        let zero = s.splat(0.0);
        let (mut pulses, mut trial) = (start, start);
        let (mut active, mut inside) = (lanes, lanes);
        // The first point is always accepted.
        let mut point = ManyEquations {
            matrix: [zero; PACKED],
            side: [zero; N],
            objective: s.splat(f32::MAX),
            first: [usize::MAX; MAX_CLUSTER],
        };
        let mut next = point;
        let mut factors = PackedFactors::none(zero);
        let mut promised = zero;
        // Ten times the initial value, because the accepted first point lowers it.
        let mut damping = s.splat(10.0 * DAMPING[0]);
        for _ in 0..=iterations {
            self.evaluate::<STRONG>(&trial, active, &mut inside, &mut next);
            let better = active & s.ge(s.add(point.objective, s.splat(ROUNDING)), next.objective);
            for p in 0..count {
                pulses[p] = trial[p].select(s, better, pulses[p]);
            }
            self.take_over(&mut point, &next, better);
            let (less, more) = (s.mul(damping, s.splat(0.1)), s.mul(damping, s.splat(10.0)));
            let more = s.min(s.max(more, s.splat(DAMPING[0])), s.splat(DAMPING[2]));
            damping = s.select(better, s.max(less, s.splat(DAMPING[1])), more);
            let step = self.step(&point, damping, &pulses, &mut factors);
            let mut gain = zero;
            for i in 0..3 * count {
                gain = s.fma(step[i], point.side[i], gain);
            }
            // The result of a lane stays while others continue: it must not depend on them.
            promised = s.select(active, gain, promised);
            let near = s.ge(s.splat(DECREASE), promised) & s.ge(s.splat(NEAR_NEWTON as f32), damping);
            let done = active & near;
            active &= !near & !s.ge(damping, s.splat(NO_DECREASE));
            for p in 0..count {
                trial[p] = pulses[p].stepped(s, [step[3 * p], step[3 * p + 1], step[3 * p + 2]], self.last);
                pulses[p] = trial[p].select(s, done, pulses[p]);
                trial[p] = trial[p].select(s, active, pulses[p]);
            }
            if active == 0 {
                break;
            }
        }
        self.results::<STRONG>(
            &pulses,
            &point,
            &mut factors,
            [lanes & !active & inside, active & inside],
            out,
        );
        let (mut objectives, mut promises) = ([0.0; LANES], [0.0; LANES]);
        s.store(point.objective, &mut objectives);
        s.store(promised, &mut promises);
        for (w, fitted) in out.iter_mut().enumerate() {
            (fitted.objective, fitted.promised) = (objectives[w], promises[w]);
        }
    }

    /// Replaces the equations in the lanes of the mask.
    #[inline(always)]
    fn take_over(&self, point: &mut ManyEquations<S::V>, next: &ManyEquations<S::V>, lanes: u16) {
        let (s, n) = (self.s, 3 * self.count);
        for i in 0..n {
            let of_row = packed(i, next.first[i / 3].min(point.first[i / 3]))..=packed(i, i);
            for (to, &from) in point.matrix[of_row.clone()].iter_mut().zip(&next.matrix[of_row]) {
                *to = s.select(lanes, from, *to);
            }
        }
        for (to, &from) in point.side[..n].iter_mut().zip(&next.side) {
            *to = s.select(lanes, from, *to);
        }
        point.objective = s.select(lanes, next.objective, point.objective);
        for (to, &from) in point.first.iter_mut().zip(&next.first) {
            *to = from.min(*to);
        }
    }

    /// Solves the damped equations.
    ///
    /// Widths at the limit of the tables are held if they would leave it: truncating the step would
    /// distort its other values.
    #[inline(always)]
    fn step(
        &self,
        point: &ManyEquations<S::V>,
        damping: S::V,
        pulses: &[Pulses<S::V>; MAX_CLUSTER],
        factors: &mut PackedFactors<S::V, N, PACKED>,
    ) -> [S::V; N] {
        let (s, n) = (self.s, 3 * self.count);
        let damped = &mut factors.lower;
        damped[..packed(n, 0)].copy_from_slice(&point.matrix[..packed(n, 0)]);
        for i in 0..n {
            let value = &mut damped[packed(i, i)];
            *value = s.fma(damping, *value, *value);
        }
        for (p, pulse) in pulses[..self.count].iter().enumerate() {
            let u = 3 * p + 2;
            let leaving = s.ge(pulse.width, s.splat(U_MAX as f32)) & s.gt(point.side[u], s.splat(0.0));
            damped[packed(u, u)] = s.select(leaving, s.splat(HELD), damped[packed(u, u)]);
        }
        factors.first = parameters_of(&point.first);
        factors.factor(s, n);
        let mut step = point.side;
        factors.solve(s, n, &mut step);
        step
    }

    /// Computes the equations at the points of the lanes in `lanes`.
    ///
    /// The values of other lanes are undefined. Lanes with pulses too far apart for the frame are
    /// removed from `inside`.
    #[inline(always)]
    fn evaluate<const STRONG: bool>(
        &mut self,
        pulses: &[Pulses<S::V>; MAX_CLUSTER],
        lanes: u16,
        inside: &mut u16,
        out: &mut ManyEquations<S::V>,
    ) {
        let s = self.s;
        *inside &= !self.fill_frames::<STRONG>(pulses, lanes);
        let first = &mut out.first;
        // The derivatives by position and width are −a s_t and a s_u.
        let mut scale = [[s.splat(1.0); 3]; MAX_CLUSTER];
        for (scale, pulse) in scale.iter_mut().zip(&pulses[..self.count]) {
            (scale[1], scale[2]) = (s.sub(s.splat(0.0), pulse.height), pulse.height);
        }
        for p in 0..self.count {
            first[p] = 3 * p;
            for q in 0..=p {
                let near = lanes & self.near(&pulses[p], &pulses[q]);
                if near == 0 && q < p {
                    for i in 0..3 {
                        out.matrix[packed(3 * p + i, 3 * q)..][..3].fill(s.splat(0.0));
                    }
                    continue;
                }
                first[p] = first[p].min(3 * q);
                self.overlap(p, q, lanes, near);
                let (of_p, of_q) = (scale[p], scale[q]);
                for i in 0..3 {
                    for j in 0..if p == q { i + 1 } else { 3 } {
                        let sum = s.sum_each(&self.sums[3 * i + j]);
                        out.matrix[packed(3 * p + i, 3 * q + j)] = s.mul(sum, s.mul(of_p[i], of_q[j]));
                    }
                }
            }
            self.side(p, lanes);
            for (i, scale) in scale[p].into_iter().enumerate() {
                out.side[3 * p + i] = s.mul(s.sum_each(&self.sums[i]), scale);
            }
        }
        for w in in_mask(lanes) {
            let frame = &self.frames[w];
            let mut sum = s.splat(0.0);
            for &value in &frame.residual[..frame.vectors] {
                sum = s.fma(value, value, sum);
            }
            self.sums[0][w] = s.halved(sum);
        }
        out.objective = s.sum_each(&self.sums[0]);
        let precision = s.splat(self.precision);
        for (p, pulse) in pulses[..self.count].iter().enumerate() {
            let u = 3 * p + 2;
            let pull = s.mul(precision, pulse.width);
            out.matrix[packed(u, u)] = s.add(out.matrix[packed(u, u)], precision);
            out.side[u] = s.sub(out.side[u], pull);
            out.objective = s.fma(pull, pulse.width, out.objective);
        }
    }

    /// Fills the frames of some lanes; returns the lanes whose pulses are too far apart.
    #[inline(always)]
    fn fill_frames<const STRONG: bool>(&mut self, pulses: &[Pulses<S::V>; MAX_CLUSTER], lanes: u16) -> u16 {
        let mut lookups = [Lookups::NONE; MAX_CLUSTER];
        for (lookups, pulse) in lookups.iter_mut().zip(&pulses[..self.count]) {
            lookups.set(self.s, pulse);
        }
        let mut too_far = 0;
        for w in in_mask(lanes) {
            let mut of_pulse = [Lookup::default(); MAX_CLUSTER];
            for (lookup, lookups) in of_pulse.iter_mut().zip(&lookups[..self.count]) {
                *lookup = lookups.get::<STRONG>(self.tables, w);
            }
            too_far |= u16::from(!self.fill_frame::<STRONG>(&of_pulse[..self.count], w)) << w;
        }
        too_far
    }

    /// Computes residual and derivatives of one row; `false` if the frame is too short.
    #[inline(always)]
    fn fill_frame<const STRONG: bool>(&mut self, of_pulse: &[Lookup], w: usize) -> bool {
        let (s, tables, order) = (self.s, self.tables, self.tables.order);
        let (row, length) = (self.rows.residual_row(self.row[w]), self.rows.length(self.row[w]));
        let frame = &mut self.frames[w];
        let first = of_pulse.iter().map(|lookup| lookup.first).min().unwrap_or(0);
        let last = of_pulse.iter().map(|lookup| lookup.first).max().unwrap_or(0);
        let vectors = (last - first) as usize / LANES + OF_PULSE;
        frame.vectors = vectors.min(FRAME);
        for c in 0..frame.vectors {
            let at = FRONT.saturating_add_signed(first as isize + (c * LANES) as isize);
            frame.residual[c] = s.load(sixteen(row, at));
        }
        for (p, lookup) in of_pulse.iter().enumerate() {
            let shift = (lookup.first - first) as usize;
            let from = (shift / LANES).min(FRAME - OF_PULSE);
            frame.from[p] = from;
            let height = s.splat(lookup.height);
            for c in 0..OF_PULSE {
                let at = ((from + c + 1) * LANES).saturating_sub(shift);
                let shape = template::<S, STRONG>(s, tables, lookup, at);
                frame.columns[p][c] = [shape.by_height, shape.by_time, shape.by_width];
                frame.residual[from + c] = s.fnma(height, shape.pulse, frame.residual[from + c]);
            }
            let behind = shift + ROW;
            for c in behind / LANES..frame.vectors {
                let values = tail::<S, STRONG>(s, tables, lookup, (c * LANES) as i32 - behind as i32);
                frame.residual[c] = s.sub(frame.residual[c], values);
            }
        }
        if leaves_block(first, frame.vectors * LANES, order, length) {
            for c in 0..frame.vectors {
                let weight = weights(s, first + (c * LANES) as i32, order, length);
                frame.residual[c] = s.mul(frame.residual[c], weight);
                for p in 0..of_pulse.len() {
                    if let Some(columns) = frame.columns[p].get_mut(c.wrapping_sub(frame.from[p])) {
                        for value in columns {
                            *value = s.mul(*value, weight);
                        }
                    }
                }
            }
        }
        vectors <= FRAME
    }

    /// The lanes in which two pulses are not independent.
    #[inline(always)]
    fn near(&self, a: &Pulses<S::V>, b: &Pulses<S::V>) -> u16 {
        let s = self.s;
        let reach = s.splat((INDEPENDENT_WIDTHS * self.tables.fwhm_samples) as f32);
        // Wider pulses reach further: the mean of both widths, to first order.
        let reach = s.fma(s.mul(reach, s.splat(0.5)), s.add(a.width, b.width), reach);
        let distance = s.sub(a.position, b.position);
        s.ge(reach, s.max(distance, s.sub(s.splat(0.0), distance)))
    }

    /// Products of the columns of two pulses; 0 in lanes that are not `near`.
    #[inline(always)]
    fn overlap(&mut self, p: usize, q: usize, lanes: u16, near: u16) {
        let s = self.s;
        for w in in_mask(lanes & !near) {
            unrolled!(i in [0 1 2 3 4 5 6 7 8] if 9 => {
                self.sums[i][w] = s.halved(s.splat(0.0));
            });
        }
        for w in in_mask(near) {
            let frame = &self.frames[w];
            let (of_p, of_q) = (frame.from[p], frame.from[q]);
            let mut sums = [s.splat(0.0); 9];
            for c in of_p.max(of_q)..of_p.min(of_q) + OF_PULSE {
                let (a, b) = (&frame.columns[p][c - of_p], &frame.columns[q][c - of_q]);
                unrolled!(i in [0 1 2 3 4 5 6 7 8] if 9 => {
                    sums[i] = s.fma(a[i / 3], b[i % 3], sums[i]);
                });
            }
            unrolled!(i in [0 1 2 3 4 5 6 7 8] if 9 => {
                self.sums[i][w] = s.halved(sums[i]);
            });
        }
    }

    /// Products of the columns of a pulse with the residual.
    #[inline(always)]
    fn side(&mut self, p: usize, lanes: u16) {
        let s = self.s;
        for w in in_mask(lanes) {
            let frame = &self.frames[w];
            let mut sums = [s.splat(0.0); 3];
            for (columns, &residual) in frame.columns[p].iter().zip(&frame.residual[frame.from[p]..]) {
                unrolled!(i in [0 1 2] if 3 => {
                    sums[i] = s.fma(columns[i], residual, sums[i]);
                });
            }
            unrolled!(i in [0 1 2] if 3 => {
                self.sums[i][w] = s.halved(sums[i]);
            });
        }
    }

    /// Stores the results; `ended` are the lanes at an optimum and those that may go on.
    #[inline(always)]
    fn results<const STRONG: bool>(
        &mut self,
        pulses: &[Pulses<S::V>; MAX_CLUSTER],
        point: &ManyEquations<S::V>,
        factors: &mut PackedFactors<S::V, N, PACKED>,
        ended: [u16; 2],
        out: &mut [Fitted<MAX_CLUSTER>],
    ) {
        let (s, n) = (self.s, 3 * self.count);
        factors.lower = point.matrix;
        factors.first = parameters_of(&point.first);
        factors.factor(s, n);
        let variances = factors.inverse_diagonal(s, n);
        let mut step = point.side;
        let beyond = factors.solve(s, n, &mut step);
        let mut beyonds = [0.0; LANES];
        s.store(beyond, &mut beyonds);
        for p in 0..self.count {
            let of_pulse = [3 * p, 3 * p + 1, 3 * p + 2];
            let lanes =
                beyond_limits(s, &pulses[p], of_pulse.map(|i| step[i]), of_pulse.map(|i| variances[i]));
            for (w, fitted) in out.iter_mut().enumerate() {
                fitted.pulses[p] = lanes.get(w);
            }
        }
        results_of_lanes(self.count, ended, &beyonds, out);
        if let Some(level) = &self.tables.level {
            self.tell_level::<STRONG>(pulses, factors, level.steady, out);
        }
    }

    /// Stores the effect of a constant background on each pulse's values.
    ///
    /// Also stores the information on the background that the pulses absorb.
    #[inline(always)]
    fn tell_level<const STRONG: bool>(
        &mut self,
        pulses: &[Pulses<S::V>; MAX_CLUSTER],
        factors: &PackedFactors<S::V, N, PACKED>,
        steady: f32,
        out: &mut [Fitted<MAX_CLUSTER>],
    ) {
        let (s, n) = (self.s, 3 * self.count);
        let lanes = (1u32 << out.len().min(LANES)).wrapping_sub(1) as u16;
        self.fill_frames::<STRONG>(pulses, lanes);
        let mut side = [s.splat(0.0); N];
        for p in 0..self.count {
            for w in in_mask(lanes) {
                for i in 0..3 {
                    let of_pulse = &self.frames[w].columns[p];
                    let mut sum = of_pulse[0][i];
                    for columns in &of_pulse[1..] {
                        sum = s.add(sum, columns[i]);
                    }
                    self.sums[i][w] = s.halved(sum);
                }
            }
            let height = s.mul(s.splat(steady), pulses[p].height);
            let scale = [s.splat(steady), s.sub(s.splat(0.0), height), height];
            for i in 0..3 {
                side[3 * p + i] = s.mul(s.sum_each(&self.sums[i]), scale[i]);
            }
        }
        let mut by_level = side;
        factors.solve(s, n, &mut by_level);
        let mut information = s.splat(0.0);
        let mut values = [[0.0; LANES]; N];
        for i in 0..n {
            information = s.fma(side[i], by_level[i], information);
            s.store(by_level[i], &mut values[i]);
        }
        let mut explained = [0.0; LANES];
        s.store(information, &mut explained);
        for (w, fitted) in out.iter_mut().enumerate() {
            for (p, pulse) in fitted.pulses[..self.count].iter_mut().enumerate() {
                pulse.by_level = std::array::from_fn(|i| values[3 * p + i][w]);
                pulse.level_information = if p == 0 { explained[w] } else { 0.0 };
            }
        }
    }
}

/// By parameter, the value of its pulse.
#[inline(always)]
fn parameters_of(of_pulses: &[usize; MAX_CLUSTER]) -> [usize; N] {
    std::array::from_fn(|i| of_pulses[i / 3])
}

/// The lanes of a mask.
#[inline(always)]
fn in_mask(mut lanes: u16) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = lanes.trailing_zeros() as usize % LANES;
        let is_left = lanes != 0;
        lanes &= lanes.wrapping_sub(1);
        is_left.then_some(lane)
    })
}
