//! Initial values from the width bank, and the tabulated step of the mode `fastest`.

use wavex_simd::{Kernel, LANES, Simd, Sixteen};

use super::detection::ByCount;
use super::fit::FitJob;
use super::fit_queue::add_pulse;
use super::fitted::FittedLanes;
use super::layout::{BEFORE_PEAK, PHASES, ROW, sixteen};
use super::level_tables::LevelTables;
use super::pulse_model::{MAX_PULSES, PulseModel};
use super::rows::{EMPTY, FRONT, Rows};
use super::tables::{BANK, Tables};
use super::template::{Lookup, Lookups, Pulses, VECTORS, bounded, tail, template, weights};

/// Dot products of a row with the bank.
pub(super) type BankSums<H> = [[H; LANES]; BANK];

/// Replaces heights and widths of jobs by those of the bank.
pub(super) struct FromBank<'a> {
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a Rows,
    pub(super) jobs: &'a mut [FitJob<1>],
}

impl Kernel for FromBank<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let mut sums = [[s.halved(s.splat(0.0)); LANES]; BANK];
        for jobs in self.jobs.chunks_mut(LANES) {
            let (mut which, mut positions) = ([EMPTY; LANES], SOMEWHERE);
            for (w, job) in jobs.iter().enumerate() {
                (which[w], positions[w]) = (job.row, job.pulses[0][1]);
            }
            let which = &which[..jobs.len()];
            let (height, width) = from_bank(s, self.tables, self.rows, which, s.load(&positions), &mut sums);
            let (mut heights, mut widths) = ([0.0; LANES], [0.0; LANES]);
            s.store(height, &mut heights);
            s.store(width, &mut widths);
            for (w, job) in jobs.iter_mut().enumerate() {
                (job.pulses[0][0], job.pulses[0][2]) = (heights[w], widths[w]);
            }
        }
    }
}

/// Position in a row for lanes without work.
pub(super) const SOMEWHERE: Sixteen = [20.0; LANES];

/// Selects the waveforms whose pulse of index `number` gets a step.
///
/// Leaves only that pulse on the row. With `separated`, skips pulses that overlap another.
pub(super) struct ClearForStep<'a> {
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a mut Rows,
    pub(super) pulse_models: &'a mut [PulseModel],
    pub(super) by_count: &'a ByCount,
    pub(super) number: usize,
    pub(super) separated: bool,
    pub(super) fwhm: f32,
    pub(super) which: &'a mut Vec<usize>,
}

impl Kernel for ClearForStep<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let ClearForStep { tables, rows, pulse_models, by_count, number, separated, fwhm, which } = self;
        which.clear();
        if number == 0 {
            which.extend(by_count.rows(1));
        }
        for count in (number + 1).max(2)..=MAX_PULSES {
            for row in by_count.rows(count) {
                let pulse_model = &mut pulse_models[row];
                let overlaps = |i: usize| i + 1 < count && pulse_model.overlap(i, i + 1, fwhm);
                let is_stepped = !separated || !(overlaps(number) || number > 0 && overlaps(number - 1));
                let is_off = pulse_model.subtract();
                for (i, pulse) in pulse_model.pulses().iter().enumerate() {
                    let stays = i == number && is_stepped;
                    if stays == is_off {
                        let sign = if stays { 1.0 } else { -1.0 };
                        add_pulse(s, tables, rows, row, pulse.values(), sign);
                    }
                }
                if is_stepped {
                    which.push(row);
                }
            }
        }
    }
}

/// Makes one step from the bank's values on one pulse per waveform.
///
/// If the pulses were subtracted from the row and this one was added back, it is subtracted again.
pub(super) struct OneStep<'a> {
    pub(super) tables: &'a Tables,
    pub(super) rows: &'a mut Rows,
    pub(super) pulse_models: &'a mut [PulseModel],
    pub(super) which: &'a [usize],
    pub(super) number: usize,
    /// Collects rows and indices of pulses that need a fit from the bank's values instead.
    ///
    /// The matrix of the step is only valid for whole pulses.
    pub(super) to_fit: &'a mut Vec<(usize, usize)>,
}

impl Kernel for OneStep<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let OneStep { tables, rows, pulse_models, number, to_fit, .. } = self;
        let none = s.halved(s.splat(0.0));
        let (mut bank, mut sums) = ([[none; LANES]; BANK], [[none; LANES]; 6]);
        for which in self.which.chunks(LANES) {
            let (mut positions, mut levels, mut alone) = (SOMEWHERE, [0.0; LANES], 0);
            for (w, &row) in which.iter().enumerate() {
                let pulse_model = &pulse_models[row];
                (positions[w], levels[w]) = (pulse_model.pulses()[number].position(), pulse_model.level_dn);
                alone |= u16::from(pulse_model.pulses().len() == 1) << w;
            }
            let position = s.load(&positions);
            let (height, width) = from_bank(s, tables, rows, which, position, &mut bank);
            let start = Pulses { height, position, width };
            let levels = tables.level.as_ref().map(|tables| StepLevels { tables, level_dn: &levels, alone });
            let steps = one_step(s, tables, rows, which, start, levels.as_ref(), &mut sums);
            let (mut heights, mut widths) = ([0.0; LANES], [0.0; LANES]);
            s.store(height, &mut heights);
            s.store(width, &mut widths);
            for (w, &row) in which.iter().enumerate() {
                let pulse_model = &mut pulse_models[row];
                let pulse = &mut pulse_model.pulses_mut()[number];
                let is_in = |lanes: u16| lanes & (1 << w) != 0;
                if !is_in(steps.made) {
                    pulse.set_values([heights[w], positions[w], widths[w]]);
                    to_fit.push((row, number));
                } else {
                    let mut stepped = steps.fitted.get(w);
                    if let Some(level) = &tables.level {
                        if is_in(steps.levelled) {
                            pulse_model.set_level(steps.level_dn[w], steps.level_variance[w]);
                        } else {
                            (stepped.by_level, stepped.level_information) =
                                level.of_whole(tables, stepped.values);
                        }
                    }
                    let pulse = &mut pulse_model.pulses_mut()[number];
                    pulse.take(&stepped);
                    pulse.sds = stepped.sds;
                    (pulse_model.chi_square, pulse_model.samples) = (steps.chi_square[w], steps.samples[w]);
                }
                if pulse_model.is_subtracted() {
                    let values = pulse_model.pulses()[number].values();
                    add_pulse(s, tables, rows, row, values, -1.0);
                }
            }
        }
    }
}

/// Heights and widths from the bank for up to sixteen rows.
///
/// The width is that of the largest normalised matched filter, by a parabola through the best value
/// and its neighbours.
#[inline(always)]
pub(super) fn from_bank<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    which: &[usize],
    position: S::V,
    sums: &mut BankSums<S::Half>,
) -> (S::V, S::V) {
    let mut steps = [0; LANES];
    s.to_i32(s.mul(position, s.splat(PHASES as f32)), &mut steps);
    for (w, &row) in which.iter().enumerate().take(LANES) {
        let first = steps[w].div_euclid(PHASES as i32) - BEFORE_PEAK;
        let row = rows.residual_row(row);
        let at = FRONT.saturating_add_signed(first as isize);
        let bank = tables.bank(steps[w]);
        let (low, high) = (s.load(sixteen(row, at)), s.load(sixteen(row, at + LANES)));
        for (k, sums) in sums.iter_mut().enumerate() {
            let product = s.mul(low, s.load(sixteen(bank, k * ROW)));
            sums[w] = s.halved(s.fma(high, s.load(sixteen(bank, k * ROW + LANES)), product));
        }
    }
    let mut statistic = [s.splat(0.0); BANK];
    for (value, sums) in statistic.iter_mut().zip(sums.iter()) {
        *value = s.sum_each(sums);
    }
    vertex(s, tables, &statistic)
}

/// Height and width at the vertex of the parabola.
///
/// It passes through the bank's best statistic and its neighbours.
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
    // Only inner widths: the parabola needs a neighbour on both sides.
    for k in 2..BANK - 1 {
        let better = s.gt(statistic[k], best[1]);
        for i in 0..3 {
            best[i] = s.select(better, statistic[k + i - 1], best[i]);
            scales[i] = s.select(better, scale[k + i - 1], scales[i]);
        }
        centre = s.select(better, s.splat(Tables::bank_width(k) as f32), centre);
    }
    let (best, scales) = (Parabola::through(s, best), Parabola::through(s, scales));
    // If the curvature is not that of a maximum, the shift is still bounded.
    let shift = s.div(best.rise, s.max(s.sub(zero, best.bend), s.splat(1e-3)));
    // A shift of 1 from an inner width reaches the outermost width of the bank.
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

    /// Value at `steps` from the centre.
    #[inline(always)]
    fn at<S: Simd<V = V>>(&self, s: S, steps: V) -> V {
        s.fma(steps, s.fma(s.mul(s.splat(0.5), steps), self.bend, self.rise), self.centre)
    }
}

/// Products of the step.
///
/// Three of the right side, the square of the residual, and two of the whole row for a level: the
/// additional square, and the product of the residuals with the whitened constant.
type StepSums<H> = [[H; LANES]; 6];

/// Sixteen pulses after one step.
struct StepLanes {
    fitted: FittedLanes,
    /// Lanes in which the step is valid: the pulse is practically whole and inside the tables.
    made: u16,
    /// Sum of squared whitened residuals, and its number of samples.
    ///
    /// Over the samples of the block in the pulse's row, or over all samples of the block in
    /// levelled lanes.
    chi_square: Sixteen,
    samples: [usize; LANES],
    /// Lanes with a jointly estimated level, the level and its variance.
    ///
    /// Values, standard deviations and chi-square of these lanes include the level.
    levelled: u16,
    level_dn: Sixteen,
    level_variance: Sixteen,
}

/// Levels in the step of sixteen pulses that are alone in their waveforms.
struct StepLevels<'a> {
    tables: &'a LevelTables,
    /// Levels before the step, DN.
    level_dn: &'a Sixteen,
    /// Lanes whose waveforms have one pulse.
    alone: u16,
}

/// Makes one step with the tabulated inverse Fisher matrix.
///
/// Its diagonal also provides the standard deviations. The matrix is that of whole pulses, which
/// pulses that extend past the block are not.
#[inline(always)]
fn one_step<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    which: &[usize],
    start: Pulses<S::V>,
    levels: Option<&StepLevels<'_>>,
    sums: &mut StepSums<S::Half>,
) -> StepLanes {
    let row_of = |w: usize| which.get(w).copied().unwrap_or(EMPTY);
    let lengths: Sixteen = std::array::from_fn(|w| rows.length(row_of(w)).saturating_sub(1) as f32);
    let last = s.load(&lengths);
    let pulses = start.within(s, last);
    let mut lookups = Lookups::NONE;
    lookups.set(s, &pulses);
    let (mut inverse, mut by_level) = ([[0.0; LANES]; 6], [[0.0; LANES]; 4]);
    let (mut made, mut levelled) = (0, 0);
    let mut counted = [0; LANES];
    for w in 0..which.len().min(LANES) {
        let lookup = lookups.get::<true>(tables, w);
        for (inverse, value) in inverse.iter_mut().zip(tables.inverse_fisher(lookup.entry)) {
            inverse[w] = value;
        }
        let row = rows.residual_row(row_of(w));
        let at = FRONT.saturating_add_signed(lookup.first as isize);
        let height = s.splat(lookup.height);
        let (order, length) = (tables.order as i32, rows.length(row_of(w)) as i32);
        let is_inside = |[from, to]: [i32; 2]| lookup.first + from >= order && lookup.first + to <= length;
        let is_whole = is_inside(tables.needed(lookup.entry));
        made |= u16::from(is_whole || is_inside(tables.telling(lookup.entry))) << w;
        let mut acc = [s.splat(0.0); 4];
        let mut sum = s.splat(0.0);
        for c in 0..VECTORS {
            // The matrix of the step is that of the first node's response. The pulse that it
            // corrects has the response for its height.
            let shape = if lookup.height < tables.strong_dn() {
                template::<S, false>(s, tables, &lookup, LANES + c * LANES)
            } else {
                template::<S, true>(s, tables, &lookup, LANES + c * LANES)
            };
            let mut residual = s.fnma(height, shape.pulse, s.load(sixteen(row, at + c * LANES)));
            if !is_whole {
                let first = lookup.first + (c * LANES) as i32;
                residual = s.mul(residual, weights(s, first, tables.order, length as usize));
            }
            acc[0] = s.fma(shape.pulse, residual, acc[0]);
            acc[1] = s.fma(shape.by_time, residual, acc[1]);
            acc[2] = s.fma(shape.by_width, residual, acc[2]);
            acc[3] = s.fma(residual, residual, acc[3]);
            sum = s.add(sum, residual);
        }
        for (sums, acc) in sums.iter_mut().zip(acc) {
            sums[w] = s.halved(acc);
        }
        // The first samples of a block count only if the pulse does not reach them.
        let begin = if is_whole { 0 } else { order };
        counted[w] = ((lookup.first + ROW as i32).min(length) - lookup.first.max(begin)).max(0) as usize;
        if let Some(levels) = levels
            && is_whole
            && levels.alone & (1 << w) != 0
        {
            levelled |= 1 << w;
            let [square, rest] = beyond_row(s, tables, row, &lookup, length);
            let product = s.mul(s.splat(levels.tables.steady), s.add(sum, rest));
            let excess = s.load(&levels.tables.begin_excess);
            sums[4][w] = s.halved(square);
            sums[5][w] = s.halved(s.fma(excess, s.load(sixteen(row, FRONT)), product));
            for (lanes, value) in by_level.iter_mut().zip(levels.tables.of_entry(lookup.entry)) {
                lanes[w] = value;
            }
        }
    }
    let right = [s.sum_each(&sums[0]), s.sub(s.splat(0.0), s.sum_each(&sums[1])), s.sum_each(&sums[2])];
    let mut lanes = [s.splat(0.0); 6];
    for (lane, values) in lanes.iter_mut().zip(&inverse) {
        *lane = s.load(values);
    }
    let [aa, at, tt, au, tu, uu] = lanes;
    // In units of the height for position and width: the table is for a pulse of height 1.
    let row = |x, y, z| s.fma(x, right[0], s.fma(y, right[1], s.mul(z, right[2])));
    let mut unit = [row(aa, at, au), row(at, tt, tu), row(au, tu, uu)];
    // Decrease of chi-square by the step, exact for a linear model.
    let known = s.fma(unit[0], right[0], s.fma(unit[1], right[1], s.mul(unit[2], right[2])));
    let mut chi_square = s.sub(s.sum_each(&sums[3]), known);
    let mut variances = [aa, tt, uu];
    let (mut level_dn, mut level_variance) = ([0.0; LANES], [0.0; LANES]);
    if let Some(levels) = levels {
        let [height, position, width, explained] = by_level.map(|values| s.load(&values));
        let effects = [height, position, width];
        let mut product = s.sum_each(&sums[5]);
        for (effect, right) in effects.into_iter().zip(right) {
            product = s.fnma(effect, right, product);
        }
        let information = levels.tables.information(s, s.add(last, s.splat(1.0)), tables.order);
        let step = levels.tables.step(s, s.load(levels.level_dn), product, information, explained);
        levelled &= step.made;
        let change = s.add(s.sum_each(&sums[4]), step.chi_square_change);
        chi_square = s.select(levelled, s.max(s.add(chi_square, change), s.splat(0.0)), chi_square);
        let by_dn = s.select(levelled, step.by_dn, s.splat(0.0));
        let variance = s.select(levelled, step.variance, s.splat(0.0));
        for i in 0..3 {
            unit[i] = s.fnma(effects[i], by_dn, unit[i]);
            variances[i] = s.fma(s.mul(effects[i], effects[i]), variance, variances[i]);
        }
        s.store(step.level_dn, &mut level_dn);
        s.store(step.variance, &mut level_variance);
    }
    let per_height = s.div(s.splat(1.0), pulses.height);
    let step = [unit[0], s.mul(unit[1], per_height), s.mul(unit[2], per_height)];
    let stepped = pulses.stepped(s, step, last);
    let per_height = s.div(s.splat(1.0), stepped.height);
    let squared = s.mul(per_height, per_height);
    let variances = [variances[0], s.mul(variances[1], squared), s.mul(variances[2], squared)];
    let fitted = FittedLanes::of(s, &stepped, variances);
    for (w, counted) in counted.iter_mut().enumerate() {
        if levelled & (1 << w) != 0 {
            *counted = lengths[w] as usize + 1;
        }
    }
    let mut squares = [0.0; LANES];
    s.store(chi_square, &mut squares);
    let made = made & fitted.known_and_held();
    StepLanes { made, fitted, chi_square: squares, samples: counted, levelled, level_dn, level_variance }
}

/// Squares and residuals outside a pulse's row, to be summed.
///
/// Covers the samples of the block before the row, and those after it minus the pulse's tail.
#[inline(always)]
fn beyond_row<S: Simd>(s: S, tables: &Tables, row: &[f32], lookup: &Lookup, length: i32) -> [S::V; 2] {
    let (mut squares, mut sum) = (s.splat(0.0), s.splat(0.0));
    let mut first = lookup.first;
    while first > 0 {
        first -= LANES as i32;
        let value = s.load(sixteen(row, FRONT.saturating_add_signed(first as isize)));
        squares = s.fma(value, value, squares);
        sum = s.add(sum, value);
    }
    first = lookup.first + ROW as i32;
    while first < length {
        let from = first - lookup.first - ROW as i32;
        let mut behind = if lookup.height < tables.strong_dn() {
            tail::<S, false>(s, tables, lookup, from)
        } else {
            tail::<S, true>(s, tables, lookup, from)
        };
        if first + LANES as i32 > length {
            behind = s.mul(behind, weights(s, first, tables.order, length as usize));
        }
        let value = s.sub(s.load(sixteen(row, FRONT.saturating_add_signed(first as isize))), behind);
        squares = s.fma(value, value, squares);
        sum = s.add(sum, value);
        first += LANES as i32;
    }
    [squares, sum]
}
