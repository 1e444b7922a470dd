//! Joint Levenberg-Marquardt fits of one to three pulses, on sixteen rows at a time.

use wavex_simd::{Kernel, LANES, Simd};

use super::fitted::{Fitted, FittedLanes, FittedPulse};
use super::layout::{ROW, U_MAX, Values, sixteen};
use super::rows::{EMPTY, FRONT, Rows};
use super::solve::{Factors, factor};
use super::tables::Tables;
use super::template::{Lookup, Lookups, Pulses, leaves_block, tail, template, weights};
use crate::pulse_fit::{FIRST_DAMPING, NEAR_NEWTON, ROUGH_DECREASE};

/// Purpose of a fit. Chi-square here includes the prior terms.
#[derive(Clone, Copy)]
pub(super) struct Aim {
    /// Largest chi-square at which the fit is useful.
    pub(super) enough: f32,
    /// Row of the waveform whose trials it competes with; only one of them is accepted.
    pub(super) rivals: usize,
}

impl Aim {
    /// The optimum, whatever its chi-square.
    pub(super) const OPTIMUM: Aim = Aim { enough: f32::INFINITY, rivals: usize::MAX };

    /// A fit that must reach `enough` and beat the other trials on the waveform.
    pub(super) fn trial(enough: f32, waveform: usize) -> Aim {
        Aim { enough, rivals: waveform }
    }
}

/// Pulses to fit to a row that contains no others.
#[derive(Clone, Copy)]
pub(super) struct FitJob<const P: usize> {
    pub(super) row: usize,
    /// Start values, in order of position.
    pub(super) pulses: [Values; P],
    pub(super) aim: Aim,
}

impl<const P: usize> FitJob<P> {
    /// Job of a lane without work.
    pub(super) const IDLE: FitJob<P> =
        FitJob { row: EMPTY, pulses: [[1.0, 20.0, 0.0]; P], aim: Aim::OPTIMUM };
}

/// Promised decrease of chi-square below which a fit has converged.
///
/// It is the square of the remaining distance in standard deviations. The step is still made.
pub(super) const DECREASE: f32 = ROUGH_DECREASE as f32;
/// Increase of the objective that rounding and the interpolation of the tables may cause.
///
/// Without it, steps near an optimum are made in turns with ever larger damping.
pub(super) const ROUNDING: f32 = 0.5 * DECREASE;
/// Initial, smallest and largest damping factor of Marquardt.
pub(super) const DAMPING: [f32; 3] = [FIRST_DAMPING as f32, 1e-6, 1e6];
/// Damping at which no step lowers the objective.
///
/// The fit is then at the optimum, at a kink of the response's dependence on height.
pub(super) const NO_DECREASE: f32 = 1e2;
/// Diagonal of the matrix for a value held fixed.
pub(super) const HELD: f32 = 1e30;

/// The normal equations at a point, and the objective.
#[derive(Clone, Copy)]
struct NormalEquations<V, const N: usize> {
    matrix: [[V; N]; N],
    side: [V; N],
    objective: V,
}

impl<V: Copy, const N: usize> NormalEquations<V, N> {
    #[inline(always)]
    fn select<S: Simd<V = V>>(self, s: S, mask: u16, other: NormalEquations<V, N>) -> NormalEquations<V, N> {
        let mut out = other;
        for i in 0..N {
            for j in 0..=i {
                out.matrix[i][j] = s.select(mask, self.matrix[i][j], other.matrix[i][j]);
            }
            out.side[i] = s.select(mask, self.side[i], other.side[i]);
        }
        out.objective = s.select(mask, self.objective, other.objective);
        out
    }
}

/// Fits all jobs of one kind.
///
/// `precision` is that of the prior that draws `ln` widths to 0.
pub(super) struct Fit<'a, const P: usize, const N: usize, const C: usize, const D: usize, const STRONG: bool>
{
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a Rows,
    pub(super) jobs: &'a [FitJob<P>],
    pub(super) precision: f32,
    pub(super) iterations: usize,
    pub(super) out: &'a mut Vec<Fitted<P>>,
}

impl<const P: usize, const N: usize, const C: usize, const D: usize, const STRONG: bool> Kernel
    for Fit<'_, P, N, C, D, STRONG>
{
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let mut sums: ProductSums<S::Half, D> = [[s.halved(s.splat(0.0)); LANES]; D];
        let Fit { tables, rows, precision, iterations, out, .. } = self;
        out.resize(self.jobs.len(), Fitted::NOTHING);
        for (jobs, out) in self.jobs.chunks(LANES).zip(out.chunks_mut(LANES)) {
            fit::<S, P, N, C, D, STRONG>(s, tables, rows, jobs, precision, iterations, &mut sums, out);
        }
    }
}

/// Sixteen rows with `P` pulses each.
///
/// `N` is `3 P`, `C` the number of vectors in a frame, `D` the number of products of `N + 1`
/// columns.
struct FitGroup<'a, S: Simd, const P: usize, const N: usize, const C: usize, const D: usize> {
    s: S,
    tables: &'a Tables,
    rows: &'a Rows,
    row: [usize; LANES],
    last: S::V,
    precision: f32,
    sums: &'a mut ProductSums<S::Half, D>,
}

/// Products before summation: half a vector per product and row.
pub(super) type ProductSums<H, const D: usize> = [[H; LANES]; D];

/// Maximum offset of a pulse's row in a frame, samples.
///
/// A frame starts with the row of the first pulse.
const fn farthest(vectors: usize) -> i32 {
    (vectors * LANES - ROW) as i32
}

/// Fits up to sixteen jobs.
///
/// `precision` is that of the prior that draws `ln` widths to 0.
#[inline(always)]
pub(super) fn fit<
    S: Simd,
    const P: usize,
    const N: usize,
    const C: usize,
    const D: usize,
    const STRONG: bool,
>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    jobs: &[FitJob<P>],
    precision: f32,
    iterations: usize,
    sums: &mut ProductSums<S::Half, D>,
    out: &mut [Fitted<P>],
) {
    const { assert!(N == 3 * P && D == (N + 1) * (N + 2) / 2 && C * LANES >= ROW) };
    let (row, last, start) = start_of(s, rows, jobs);
    let mut group: FitGroup<'_, S, P, N, C, D> = FitGroup { s, tables, rows, row, last, precision, sums };
    group.descend::<STRONG>(start, (1u32 << jobs.len().min(LANES)).wrapping_sub(1) as u16, iterations, out);
}

/// Rows of up to sixteen jobs, the last sample of each, and the start values within the tables.
#[inline(always)]
pub(super) fn start_of<S: Simd, const P: usize>(
    s: S,
    rows: &Rows,
    jobs: &[FitJob<P>],
) -> ([usize; LANES], S::V, [Pulses<S::V>; P]) {
    let row: [usize; LANES] = std::array::from_fn(|w| jobs.get(w).unwrap_or(&FitJob::IDLE).row);
    let lengths: [f32; LANES] = std::array::from_fn(|w| rows.length(row[w]).saturating_sub(1) as f32);
    let last = s.load(&lengths);
    let zero = s.splat(0.0);
    let mut start = [Pulses { height: zero, position: zero, width: zero }; P];
    for (p, pulse) in start.iter_mut().enumerate() {
        let mut values = [[0.0; LANES]; 3];
        for w in 0..LANES {
            let of_job = jobs.get(w).unwrap_or(&FitJob::IDLE).pulses[p];
            for i in 0..3 {
                values[i][w] = of_job[i];
            }
        }
        let [height, position, width] = [s.load(&values[0]), s.load(&values[1]), s.load(&values[2])];
        *pulse = Pulses { height, position, width }.within(s, last);
    }
    (row, last, start)
}

/// Sixteen fitted pulses.
///
/// If the tables limit a width, a step from the limit is closer to the true values than the limit.
#[inline(always)]
pub(super) fn beyond_limits<S: Simd>(
    s: S,
    pulses: &Pulses<S::V>,
    step: [S::V; 3],
    variances: [S::V; 3],
) -> FittedLanes {
    let is_cut = s.ge(pulses.width, s.splat(U_MAX as f32));
    FittedLanes::of(s, &pulses.moved(s, step).select(s, is_cut, *pulses), variances)
}

/// Stores how the fits of sixteen jobs of `count` pulses ended.
///
/// `ended` are the lanes at an optimum and those that may go on, `beyond` the promised decreases
/// beyond the limits of the tables.
#[inline(always)]
pub(super) fn results_of_lanes<const P: usize>(
    count: usize,
    ended: [u16; 2],
    beyond: &[f32; LANES],
    out: &mut [Fitted<P>],
) {
    let [optimum, active] = ended;
    for (w, fitted) in out.iter_mut().enumerate() {
        let known = fitted.pulses[..count].iter().all(FittedPulse::is_known);
        fitted.is_optimum = known && optimum & (1 << w) != 0;
        fitted.may_go_on = active & (1 << w) != 0;
        fitted.beyond = beyond[w];
    }
}

impl<S: Simd, const P: usize, const N: usize, const C: usize, const D: usize> FitGroup<'_, S, P, N, C, D> {
    #[inline(always)]
    fn descend<const STRONG: bool>(
        &mut self,
        start: [Pulses<S::V>; P],
        lanes: u16,
        iterations: usize,
        out: &mut [Fitted<P>],
    ) {
        let s = self.s;
        let zero = s.splat(0.0);
        let (mut pulses, mut trial) = (start, start);
        let (mut active, mut inside) = (lanes, lanes);
        // The first point is always accepted.
        let mut point =
            NormalEquations { matrix: [[zero; N]; N], side: [zero; N], objective: s.splat(f32::MAX) };
        let mut promised = zero;
        // Ten times the initial value, because the accepted first point lowers it.
        let mut damping = s.splat(if P == 1 { 0.0 } else { 10.0 * DAMPING[0] });
        // One evaluation more than steps: the first has no step before it.
        for _ in 0..=iterations {
            let next = self.evaluate::<STRONG>(&trial, active, &mut inside);
            let better = active & s.ge(s.add(point.objective, s.splat(ROUNDING)), next.objective);
            for p in 0..P {
                pulses[p] = trial[p].select(s, better, pulses[p]);
            }
            point = next.select(s, better, point);
            damping = self.next_damping(damping, better);
            let step = self.step(&point, damping, &pulses);
            let mut gain = zero;
            for i in 0..N {
                gain = s.fma(step[i], point.side[i], gain);
            }
            // The result of a lane stays while others continue: it must not depend on them.
            promised = s.select(active, gain, promised);
            let near = s.ge(s.splat(DECREASE), promised) & s.ge(s.splat(NEAR_NEWTON as f32), damping);
            let done = active & near;
            active &= !near & !s.ge(damping, s.splat(NO_DECREASE));
            for p in 0..P {
                let part = [step[3 * p], step[3 * p + 1], step[3 * p + 2]];
                trial[p] = pulses[p].stepped(s, part, self.last);
                pulses[p] = trial[p].select(s, done, pulses[p]);
                trial[p] = trial[p].select(s, active, pulses[p]);
            }
            if active == 0 {
                break;
            }
        }
        self.results::<STRONG>(&pulses, &point, lanes & !active & inside, active & inside, out);
        let (mut objectives, mut promises) = ([0.0; LANES], [0.0; LANES]);
        s.store(point.objective, &mut objectives);
        s.store(promised, &mut promises);
        for (w, fitted) in out.iter_mut().enumerate() {
            (fitted.objective, fitted.promised) = (objectives[w], promises[w]);
        }
    }

    /// Lowers the damping after a successful step, raises it after others.
    ///
    /// A single pulse needs none at first.
    #[inline(always)]
    fn next_damping(&self, damping: S::V, better: u16) -> S::V {
        let s = self.s;
        let (less, more) = (s.mul(damping, s.splat(0.1)), s.mul(damping, s.splat(10.0)));
        let less = s.max(less, s.splat(if P == 1 { 0.0 } else { DAMPING[1] }));
        let more = s.min(s.max(more, s.splat(DAMPING[0])), s.splat(DAMPING[2]));
        s.select(better, less, more)
    }

    /// Solves the damped equations.
    ///
    /// Widths at the limit of the tables are held if they would leave it: truncating the step would
    /// distort its other values.
    #[inline(always)]
    fn step(&self, point: &NormalEquations<S::V, N>, damping: S::V, pulses: &[Pulses<S::V>; P]) -> [S::V; N] {
        let s = self.s;
        let mut damped = point.matrix;
        for (i, row) in damped.iter_mut().enumerate() {
            row[i] = s.fma(damping, row[i], row[i]);
        }
        for (p, pulse) in pulses.iter().enumerate() {
            let u = 3 * p + 2;
            let leaving = s.ge(pulse.width, s.splat(U_MAX as f32)) & s.gt(point.side[u], s.splat(0.0));
            damped[u][u] = s.select(leaving, s.splat(HELD), damped[u][u]);
        }
        let mut step = point.side;
        factor(s, damped).solve(s, &mut step);
        step
    }

    /// Computes the equations at the points of the lanes in `lanes`.
    ///
    /// The values of other lanes are undefined. Lanes with pulses too far apart for the frame are
    /// removed from `inside`.
    #[inline(always)]
    fn evaluate<const STRONG: bool>(
        &mut self,
        pulses: &[Pulses<S::V>; P],
        lanes: u16,
        inside: &mut u16,
    ) -> NormalEquations<S::V, N> {
        let s = self.s;
        let mut lookups = [Lookups::NONE; P];
        for (lookups, pulse) in lookups.iter_mut().zip(pulses) {
            lookups.set(s, pulse);
        }
        let mut left = lanes;
        while left != 0 {
            let w = left.trailing_zeros() as usize % LANES;
            left &= left - 1;
            let (of_pulse, first, end) = self.lookups_of::<STRONG>(&lookups, w);
            if end - first > farthest(C) {
                *inside &= !(1 << w);
            }
            self.products::<STRONG>(&of_pulse, first, w);
        }
        self.equations(pulses)
    }

    /// Computes the products of the columns of one row.
    #[inline(always)]
    fn products<const STRONG: bool>(&mut self, of_pulse: &[Lookup; P], first: i32, w: usize) {
        let columns = self.columns::<STRONG>(of_pulse, first, w);
        let s = self.s;
        unrolled!(i in [0 1 2 3 4 5 6 7 8 9] if N + 1 => {
            unrolled!(j in [0 1 2 3 4 5 6 7 8 9] if i + 1 => {
                let mut sum = s.mul(columns[i][0], columns[j][0]);
                unrolled!(c in [1 2 3] if C => {
                    sum = s.fma(columns[i][c], columns[j][c], sum);
                });
                self.sums[i * (i + 1) / 2 + j][w] = s.halved(sum);
            });
        });
    }

    /// Derivatives and residual in the frame of one row.
    ///
    /// The array has room for three pulses and the residual, and for four vectors.
    #[inline(always)]
    fn columns<const STRONG: bool>(&self, of_pulse: &[Lookup; P], first: i32, w: usize) -> [[S::V; 4]; 10] {
        let s = self.s;
        let row = self.rows.residual_row(self.row[w]);
        let length = self.rows.length(self.row[w]);
        let edge = leaves_block(first, C * LANES, self.tables.order, length);
        let mut out = [[s.splat(0.0); 4]; 10];
        unrolled!(c in [0 1 2 3] if C => {
            let start = (c * LANES) as i32;
            let mut residual = s.load(sixteen(row, FRONT.saturating_add_signed((first + start) as isize)));
            unrolled!(p in [0 1 2] if P => {
                let lookup = &of_pulse[p];
                // A pulse beyond the frame is moved into it to keep indices valid; its lane is not `inside`.
                let shift = (lookup.first - first).clamp(0, farthest(C));
                if start + LANES as i32 > shift && start < shift + ROW as i32 {
                    let at = LANES.saturating_add_signed((start - shift) as isize);
                    let shape = template::<S, STRONG>(s, self.tables, lookup, at);
                    out[3 * p][c] = shape.by_height;
                    out[3 * p + 1][c] = shape.by_time;
                    out[3 * p + 2][c] = shape.by_width;
                    residual = s.fnma(s.splat(lookup.height), shape.pulse, residual);
                }
                if start + LANES as i32 > shift + ROW as i32 {
                    let behind = tail::<S, STRONG>(s, self.tables, lookup, start - shift - ROW as i32);
                    residual = s.sub(residual, behind);
                }
            });
            out[N][c] = residual;
            if edge {
                let weight = weights(s, first + start, self.tables.order, length);
                unrolled!(i in [0 1 2 3 4 5 6 7 8 9] if N + 1 => {
                    out[i][c] = s.mul(out[i][c], weight);
                });
            }
        });
        out
    }

    /// Normal matrix (lower triangle), right side and objective from the products.
    #[inline(always)]
    fn equations(&self, pulses: &[Pulses<S::V>; P]) -> NormalEquations<S::V, N> {
        let s = self.s;
        let zero = s.splat(0.0);
        // The derivatives by position and width are −a s_t and a s_u.
        let mut scale = [s.splat(1.0); N];
        for (p, pulse) in pulses.iter().enumerate() {
            scale[3 * p + 1] = s.sub(zero, pulse.height);
            scale[3 * p + 2] = pulse.height;
        }
        let mut point = NormalEquations { matrix: [[zero; N]; N], side: [zero; N], objective: zero };
        let mut k = 0;
        for i in 0..N {
            for j in 0..=i {
                point.matrix[i][j] = s.mul(s.sum_each(&self.sums[k]), s.mul(scale[i], scale[j]));
                k += 1;
            }
        }
        for i in 0..N {
            point.side[i] = s.mul(s.sum_each(&self.sums[k]), scale[i]);
            k += 1;
        }
        point.objective = s.sum_each(&self.sums[k]);
        let precision = s.splat(self.precision);
        for (p, pulse) in pulses.iter().enumerate() {
            let u = 3 * p + 2;
            let pull = s.mul(precision, pulse.width);
            point.matrix[u][u] = s.add(point.matrix[u][u], precision);
            point.side[u] = s.sub(point.side[u], pull);
            point.objective = s.fma(pull, pulse.width, point.objective);
        }
        point
    }

    #[inline(always)]
    fn results<const STRONG: bool>(
        &mut self,
        pulses: &[Pulses<S::V>; P],
        point: &NormalEquations<S::V, N>,
        optimum: u16,
        active: u16,
        out: &mut [Fitted<P>],
    ) {
        let s = self.s;
        let factors = factor(s, point.matrix);
        let variances = factors.inverse_diagonal(s);
        let mut beyond = s.splat(0.0);
        for (part, _) in factors.explained(s, point.side) {
            beyond = s.add(beyond, part);
        }
        let mut beyonds = [0.0; LANES];
        s.store(beyond, &mut beyonds);
        let mut step = point.side;
        factors.solve(s, &mut step);
        for (p, pulses) in pulses.iter().enumerate() {
            let of_pulse = [3 * p, 3 * p + 1, 3 * p + 2];
            let lanes = beyond_limits(s, pulses, of_pulse.map(|i| step[i]), of_pulse.map(|i| variances[i]));
            for (w, fitted) in out.iter_mut().enumerate() {
                fitted.pulses[p] = lanes.get(w);
            }
        }
        results_of_lanes(P, [optimum, active], &beyonds, out);
        if let Some(level) = &self.tables.level {
            self.tell_level::<STRONG>(pulses, &factors, level.steady, out);
        }
    }

    /// Stores the effect of a constant background on each pulse's values.
    ///
    /// Also stores the information on the background that the pulses absorb.
    #[inline(always)]
    fn tell_level<const STRONG: bool>(
        &mut self,
        pulses: &[Pulses<S::V>; P],
        factors: &Factors<S::V, N>,
        steady: f32,
        out: &mut [Fitted<P>],
    ) {
        let s = self.s;
        let zero = s.splat(0.0);
        let mut lookups = [Lookups::NONE; P];
        let mut scale = [s.splat(steady); N];
        for (p, pulse) in pulses.iter().enumerate() {
            lookups[p].set(s, pulse);
            scale[3 * p + 1] = s.mul(s.sub(zero, pulse.height), scale[3 * p + 1]);
            scale[3 * p + 2] = s.mul(pulse.height, scale[3 * p + 2]);
        }
        for w in 0..out.len().min(LANES) {
            let (of_pulse, first, _) = self.lookups_of::<STRONG>(&lookups, w);
            let columns = self.columns::<STRONG>(&of_pulse, first, w);
            unrolled!(i in [0 1 2 3 4 5 6 7 8] if N => {
                let mut sum = columns[i][0];
                unrolled!(c in [1 2 3] if C => {
                    sum = s.add(sum, columns[i][c]);
                });
                self.sums[i][w] = s.halved(sum);
            });
        }
        let mut side = [zero; N];
        for i in 0..N {
            side[i] = s.mul(s.sum_each(&self.sums[i]), scale[i]);
        }
        let mut by_level = side;
        factors.solve(s, &mut by_level);
        let mut information = zero;
        for i in 0..N {
            information = s.fma(side[i], by_level[i], information);
        }
        let (mut values, mut explained) = ([[0.0; LANES]; N], [0.0; LANES]);
        for (values, by_level) in values.iter_mut().zip(by_level) {
            s.store(by_level, values);
        }
        s.store(information, &mut explained);
        for (w, fitted) in out.iter_mut().enumerate() {
            for (p, pulse) in fitted.pulses.iter_mut().enumerate() {
                pulse.by_level = std::array::from_fn(|i| values[3 * p + i][w]);
                pulse.level_information = if p == 0 { explained[w] } else { 0.0 };
            }
        }
    }

    /// Returns the lookups of a lane's pulses and their lowest and highest first sample.
    #[inline(always)]
    fn lookups_of<const STRONG: bool>(&self, lookups: &[Lookups; P], w: usize) -> ([Lookup; P], i32, i32) {
        let mut of_pulse = [Lookup::default(); P];
        for (lookup, lookups) in of_pulse.iter_mut().zip(lookups) {
            *lookup = lookups.get::<STRONG>(self.tables, w);
        }
        let mut first = of_pulse[0].first;
        let mut end = first;
        for lookup in &of_pulse[1..] {
            first = first.min(lookup.first);
            end = end.max(lookup.first);
        }
        (of_pulse, first, end)
    }
}
