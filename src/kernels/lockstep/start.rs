//! The width bank, and the one tabulated step of the mode `fastest`.

use super::fit::{FittedLanes, FittedPulse, Job};
use super::rows::{EMPTY, FRONT, Rows, sixteen};
use super::tables::{BANK, BEFORE_PEAK, PHASES, ROW, Tables};
use super::template::{Pulses, Sites, VECTORS, bounded, template};
use super::vector::{Kernel, LANES, Simd, Sixteen};

/// Dot products of a row with the bank.
type BankSums<V> = [[V; LANES]; BANK];

/// Replaces heights and widths of jobs by those of the bank at their positions.
pub(super) struct FromBank<'a> {
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a Rows,
    pub(super) jobs: &'a mut [Job<1>],
}

impl Kernel for FromBank<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let mut sums = [[s.splat(0.0); LANES]; BANK];
        for jobs in self.jobs.chunks_mut(LANES) {
            from_bank(s, self.tables, self.rows, jobs, &mut sums);
        }
    }
}

/// One step on each job, from where the bank has it.
pub(super) struct OneStep<'a> {
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a Rows,
    pub(super) jobs: &'a mut [Job<1>],
    pub(super) out: &'a mut Vec<Stepped>,
}

impl Kernel for OneStep<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let (mut bank, mut sums) = ([[s.splat(0.0); LANES]; BANK], [[s.splat(0.0); LANES]; 4]);
        self.out.resize(self.jobs.len(), Stepped::NOTHING);
        for (jobs, out) in self.jobs.chunks_mut(LANES).zip(self.out.chunks_mut(LANES)) {
            from_bank(s, self.tables, self.rows, jobs, &mut bank);
            one_step(s, self.tables, self.rows, jobs, &mut sums, out);
        }
    }
}

/// Replaces heights and widths of up to sixteen jobs by those of the bank at their positions: the width with the largest
/// normalised matched filter, by a parabola through the best and its neighbours.
#[inline(always)]
fn from_bank<S: Simd>(s: S, tables: &Tables, rows: &Rows, jobs: &mut [Job<1>], sums: &mut BankSums<S::V>) {
    for (w, job) in jobs.iter().enumerate().take(LANES) {
        let steps = (job.pulses[0][1] * PHASES as f32).round_ties_even() as i32;
        let first = steps.div_euclid(PHASES as i32) - BEFORE_PEAK;
        let row = rows.residual_row(job.row);
        let at = FRONT.saturating_add_signed(first as isize);
        let bank = tables.bank((steps & (PHASES as i32 - 1)) as usize);
        let (low, high) = (s.load(sixteen(row, at)), s.load(sixteen(row, at + LANES)));
        for (k, sums) in sums.iter_mut().enumerate() {
            let product = s.mul(low, s.load(sixteen(bank, k * ROW)));
            sums[w] = s.fma(high, s.load(sixteen(bank, k * ROW + LANES)), product);
        }
    }
    let mut statistic = [s.splat(0.0); BANK];
    for (value, sums) in statistic.iter_mut().zip(sums.iter()) {
        *value = s.sum_each(sums);
    }
    let (height, width) = vertex(s, tables, &statistic);
    let (mut heights, mut widths) = ([0.0; LANES], [0.0; LANES]);
    s.store(height, &mut heights);
    s.store(width, &mut widths);
    for (w, job) in jobs.iter_mut().enumerate().take(LANES) {
        job.pulses[0][0] = heights[w];
        job.pulses[0][2] = widths[w];
    }
}

/// Height and width at the maximum of the parabola through the bank's best statistic and its neighbours.
#[inline(always)]
fn vertex<S: Simd>(s: S, tables: &Tables, statistic: &[S::V; BANK]) -> (S::V, S::V) {
    let zero = s.splat(0.0);
    let mut scale = [zero; BANK];
    for (scale, &value) in scale.iter_mut().zip(&tables.bank_scale) {
        *scale = s.splat(value);
    }
    let mut best = [statistic[0], statistic[1], statistic[2]];
    let mut scales = [scale[0], scale[1], scale[2]];
    let mut centre = s.splat(Tables::bank_width(1) as f32);
    for k in 2..BANK - 1 {
        let better = s.gt(statistic[k], best[1]);
        for i in 0..3 {
            best[i] = s.select(better, statistic[k + i - 1], best[i]);
            scales[i] = s.select(better, scale[k + i - 1], scales[i]);
        }
        centre = s.select(better, s.splat(Tables::bank_width(k) as f32), centre);
    }
    let (best, scales) = (Parabola::through(s, best), Parabola::through(s, scales));
    // A curvature that is no maximum's gives a bounded shift.
    let shift = s.div(best.rise, s.max(s.sub(zero, best.bend), s.splat(1e-3)));
    let shift = bounded(s, shift, 1.2);
    let step = (Tables::bank_width(1) - Tables::bank_width(0)) as f32;
    (s.mul(best.at(s, shift), scales.at(s, shift)), s.fma(shift, s.splat(step), centre))
}

/// A parabola through three values one step apart.
struct Parabola<V> {
    centre: V,
    rise: V,
    bend: V,
}

impl<V: Copy> Parabola<V> {
    #[inline(always)]
    fn through<S: Simd<V = V>>(s: S, [left, centre, right]: [V; 3]) -> Parabola<V> {
        Parabola {
            centre,
            rise: s.mul(s.splat(0.5), s.sub(right, left)),
            bend: s.sub(s.add(left, right), s.add(centre, centre)),
        }
    }

    /// Its value so many steps from the centre.
    #[inline(always)]
    fn at<S: Simd<V = V>>(&self, s: S, steps: V) -> V {
        s.fma(steps, s.fma(s.mul(s.splat(0.5), steps), self.bend, self.rise), self.centre)
    }
}

/// Products of the step: the right side and the residual's square.
type StepSums<V> = [[V; LANES]; 4];

/// A pulse after one step, and the sum of the squared whitened residuals over the block's samples in its row.
#[derive(Clone, Copy)]
pub(super) struct Stepped {
    pub(super) pulse: FittedPulse,
    /// Whether the block holds the whole pulse.
    pub(super) is_whole: bool,
    pub(super) chi_square: f32,
    pub(super) samples: usize,
}

impl Stepped {
    const NOTHING: Stepped =
        Stepped { pulse: FittedPulse::NOTHING, is_whole: false, chi_square: 0.0, samples: 0 };
}

/// One step with the tabulated inverse Fisher matrix, whose diagonal also gives the standard deviations. Not whole
/// are pulses that leave the block: the matrix is that of whole ones.
#[inline(always)]
fn one_step<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    jobs: &[Job<1>],
    sums: &mut StepSums<S::V>,
    out: &mut [Stepped],
) {
    let of = |i: usize| -> Sixteen {
        std::array::from_fn(|w| jobs.get(w).map_or([1.0, 20.0, 0.0][i], |job| job.pulses[0][i]))
    };
    let row_of = |w: usize| jobs.get(w).map_or(EMPTY, |job| job.row);
    let lengths: Sixteen = std::array::from_fn(|w| rows.length(row_of(w)).saturating_sub(1) as f32);
    let last = s.load(&lengths);
    let pulses = Pulses { height: s.load(&of(0)), position: s.load(&of(1)), width: s.load(&of(2)) };
    let pulses = pulses.within(s, last);
    let mut sites = Sites::NONE;
    sites.set(s, &pulses);
    let mut inverse = [[0.0; LANES]; 6];
    let mut whole = [false; LANES];
    let mut counted = [0; LANES];
    for w in 0..jobs.len().min(LANES) {
        let site = sites.get::<true>(tables, w);
        for (inverse, value) in inverse.iter_mut().zip(tables.inverse_fisher(site.entry)) {
            inverse[w] = value;
        }
        let row = rows.residual_row(row_of(w));
        let at = FRONT.saturating_add_signed(site.first as isize);
        let height = s.splat(site.height);
        let mut acc = [s.splat(0.0); 4];
        for c in 0..VECTORS {
            // The step's matrix is the first response's; the pulse that it corrects is the height's own.
            let shape = if site.height < tables.strong_dn() {
                template::<S, false>(s, tables, &site, LANES + c * LANES)
            } else {
                template::<S, true>(s, tables, &site, LANES + c * LANES)
            };
            let residual = s.fnma(height, shape.pulse, s.load(sixteen(row, at + c * LANES)));
            acc[0] = s.fma(shape.pulse, residual, acc[0]);
            acc[1] = s.fma(shape.by_time, residual, acc[1]);
            acc[2] = s.fma(shape.by_width, residual, acc[2]);
            acc[3] = s.fma(residual, residual, acc[3]);
        }
        for (sums, acc) in sums.iter_mut().zip(acc) {
            sums[w] = acc;
        }
        let length = rows.length(row_of(w)) as i32;
        let [from, to] = tables.needed(site.entry);
        whole[w] = site.first + from >= tables.order as i32 && site.first + to <= length;
        counted[w] = ((site.first + ROW as i32).min(length) - site.first.max(0)).max(0) as usize;
    }
    let right = [s.sum_each(&sums[0]), s.sub(s.splat(0.0), s.sum_each(&sums[1])), s.sum_each(&sums[2])];
    let mut lanes = [s.splat(0.0); 6];
    for (lane, values) in lanes.iter_mut().zip(&inverse) {
        *lane = s.load(values);
    }
    let [aa, at, tt, au, tu, uu] = lanes;
    // In units of the height for position and width: the table is of a pulse of height 1.
    let row = |x, y, z| s.fma(x, right[0], s.fma(y, right[1], s.mul(z, right[2])));
    let unit = [row(aa, at, au), row(at, tt, tu), row(au, tu, uu)];
    let told = s.fma(unit[0], right[0], s.fma(unit[1], right[1], s.mul(unit[2], right[2])));
    let per_height = s.div(s.splat(1.0), pulses.height);
    let step = [unit[0], s.mul(unit[1], per_height), s.mul(unit[2], per_height)];
    let stepped = pulses.stepped(s, step, last);
    let per_height = s.div(s.splat(1.0), stepped.height);
    let squared = s.mul(per_height, per_height);
    let variances = [aa, s.mul(tt, squared), s.mul(uu, squared)];
    let fitted = FittedLanes::of(s, &stepped, variances);
    let mut chi_squares = [0.0; LANES];
    s.store(s.sub(s.sum_each(&sums[3]), told), &mut chi_squares);
    for (w, stepped) in out.iter_mut().enumerate() {
        *stepped = Stepped {
            pulse: fitted.get(w),
            is_whole: whole[w],
            chi_square: chi_squares[w],
            samples: counted[w],
        };
    }
}
