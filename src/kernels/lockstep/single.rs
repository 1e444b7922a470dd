//! One pulse per waveform: the width bank, Gauss and Newton's steps, the one tabulated step.

use super::rows::{FRONT, Rows, sixteen};
use super::solve::factor;
use super::tables::{BANK, BEFORE_PEAK, PHASES, ROW, Tables};
use super::template::{Pulses, Sites, VECTORS, bounded, counted, leaves_block, template, weights};
use super::vector::{LANES, Simd, Sixteen};
use super::{Echo, Single};

/// Largest change of position (samples) and of `ln` width in one iteration (ALGORITHMS.md, S6).
const LIMITS: [f32; 2] = [1.5, 0.4];
/// Dot products of an iteration: the triangle of the normal matrix, the right side, the residual's square.
pub(super) const DOTS: usize = 10;

/// Dot products before their sums: per product one vector of each waveform.
pub(super) type Dots<V> = [[V; LANES]; DOTS];

/// Start values by the width bank: at the given positions, the width with the largest normalised matched filter, by a
/// parabola through the best and its neighbours.
#[inline(always)]
pub(super) fn start<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    position: S::V,
    sums: &mut Dots<S::V>,
) -> Pulses<S::V> {
    let mut steps = [0; LANES];
    s.to_i32(s.mul(position, s.splat(PHASES as f32)), &mut steps);
    let whitened = rows.whitened.as_slice();
    for w in 0..LANES {
        let first = steps[w].div_euclid(PHASES as i32) - BEFORE_PEAK;
        let at = (rows.row_start(w) + FRONT).saturating_add_signed(first as isize);
        let bank = tables.bank((steps[w] & (PHASES as i32 - 1)) as usize);
        let (low, high) = (s.load(sixteen(whitened, at)), s.load(sixteen(whitened, at + LANES)));
        for (k, sums) in sums.iter_mut().enumerate().take(BANK) {
            let product = s.mul(low, s.load(sixteen(bank, k * ROW)));
            sums[w] = s.fma(high, s.load(sixteen(bank, k * ROW + LANES)), product);
        }
    }
    let mut statistic = [s.splat(0.0); BANK];
    for (value, sums) in statistic.iter_mut().zip(sums.iter()) {
        *value = s.sum_each(sums);
    }
    vertex(s, tables, &statistic, position)
}

/// The maximum of the parabola through the bank's best statistic and its neighbours.
#[inline(always)]
fn vertex<S: Simd>(s: S, tables: &Tables, statistic: &[S::V; BANK], position: S::V) -> Pulses<S::V> {
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
    Pulses {
        amplitude: s.mul(best.at(s, shift), scales.at(s, shift)),
        position,
        width: s.fma(shift, s.splat(step), centre),
    }
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

/// The dot products at sixteen pulses.
#[inline(always)]
fn dots<S: Simd, const EDGE: bool>(s: S, tables: &Tables, rows: &Rows, sites: &Sites, sums: &mut Dots<S::V>) {
    let zero = s.splat(0.0);
    let whitened = rows.whitened.as_slice();
    for w in 0..LANES {
        let entry = tables.entry(sites.entry[w]);
        let (late, wider) = (s.splat(sites.late[w]), s.splat(sites.wider[w]));
        let amplitude = s.splat(sites.amplitude[w]);
        let at = (rows.row_start(w) + FRONT).saturating_add_signed(sites.first[w] as isize);
        let mut acc = [zero; DOTS];
        for c in 0..VECTORS {
            let [mut h, mut t, mut u] = template(s, entry, LANES + c * LANES, late, wider);
            if EDGE {
                let first = sites.first[w] + (c * LANES) as i32;
                let weight = weights(s, first, tables.order, rows.lengths[w]);
                (h, t, u) = (s.mul(h, weight), s.mul(t, weight), s.mul(u, weight));
            }
            let residual = s.fnma(amplitude, h, s.load(sixteen(whitened, at + c * LANES)));
            acc[0] = s.fma(h, h, acc[0]);
            acc[1] = s.fma(h, t, acc[1]);
            acc[2] = s.fma(t, t, acc[2]);
            acc[3] = s.fma(h, u, acc[3]);
            acc[4] = s.fma(t, u, acc[4]);
            acc[5] = s.fma(u, u, acc[5]);
            acc[6] = s.fma(h, residual, acc[6]);
            acc[7] = s.fma(t, residual, acc[7]);
            acc[8] = s.fma(u, residual, acc[8]);
            acc[9] = s.fma(residual, residual, acc[9]);
        }
        for (sums, acc) in sums.iter_mut().zip(acc) {
            sums[w] = acc;
        }
    }
}

/// Gauss and Newton's iterations with the full normal matrix, then covariance and chi-square at the last point.
#[inline(always)]
pub(super) fn newton<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    mut pulses: Pulses<S::V>,
    iterations: usize,
    sums: &mut Dots<S::V>,
    out: &mut [Single],
) {
    let last = last_sample(s, rows);
    let zero = s.splat(0.0);
    pulses = pulses.within(s, last);
    for iteration in 0..=iterations {
        let sites = Sites::of(s, &pulses);
        if sites.at_edge(ROW, tables.order, &rows.lengths, out.len()) {
            dots::<S, true>(s, tables, rows, &sites, sums);
        } else {
            dots::<S, false>(s, tables, rows, &sites, sums);
        }
        // The derivatives by position and width are −a h_t and a h_u.
        let scale = [s.splat(1.0), s.sub(zero, pulses.amplitude), pulses.amplitude];
        let mut matrix = [[zero; 3]; 3];
        let mut k = 0;
        for i in 0..3 {
            for j in 0..=i {
                matrix[i][j] = s.mul(s.sum_each(&sums[k]), s.mul(scale[i], scale[j]));
                k += 1;
            }
        }
        let factors = factor(s, matrix);
        if iteration == iterations {
            let variances = factors.inverse_diagonal(s);
            give(s, tables, rows, &sites, &pulses, variances, s.sum_each(&sums[9]), out);
        } else {
            let mut step = [zero; 3];
            for i in 0..3 {
                step[i] = s.mul(s.sum_each(&sums[6 + i]), scale[i]);
            }
            factors.solve(s, &mut step);
            pulses = pulses.stepped(s, &step, LIMITS, last);
        }
    }
}

/// One step with the tabulated inverse Fisher matrix, whose diagonal also gives the uncertainties.
#[inline(always)]
pub(super) fn one_step<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    pulses: Pulses<S::V>,
    sums: &mut Dots<S::V>,
    out: &mut [Single],
) {
    let last = last_sample(s, rows);
    let zero = s.splat(0.0);
    let pulses = pulses.within(s, last);
    let sites = Sites::of(s, &pulses);
    let mut inverse = [[0.0; LANES]; 6];
    let whitened = rows.whitened.as_slice();
    for w in 0..LANES {
        let entry = tables.entry(sites.entry[w]);
        for (inverse, value) in inverse.iter_mut().zip(tables.inverse_fisher(sites.entry[w])) {
            inverse[w] = value;
        }
        let (late, wider) = (s.splat(sites.late[w]), s.splat(sites.wider[w]));
        let amplitude = s.splat(sites.amplitude[w]);
        let at = (rows.row_start(w) + FRONT).saturating_add_signed(sites.first[w] as isize);
        let mut acc = [zero; 4];
        for c in 0..VECTORS {
            let [h, t, u] = template(s, entry, LANES + c * LANES, late, wider);
            let residual = s.fnma(amplitude, h, s.load(sixteen(whitened, at + c * LANES)));
            acc[0] = s.fma(h, residual, acc[0]);
            acc[1] = s.fma(t, residual, acc[1]);
            acc[2] = s.fma(u, residual, acc[2]);
            acc[3] = s.fma(residual, residual, acc[3]);
        }
        for (sums, acc) in sums.iter_mut().zip(acc) {
            sums[w] = acc;
        }
    }
    let right = [s.sum_each(&sums[0]), s.sub(zero, s.sum_each(&sums[1])), s.sum_each(&sums[2])];
    let [aa, at, tt, au, tu, uu] = lanes(s, &inverse);
    // In units of the amplitude for position and width: the table is of a unit pulse.
    let row = |x, y, z| s.fma(x, right[0], s.fma(y, right[1], s.mul(z, right[2])));
    let unit = [row(aa, at, au), row(at, tt, tu), row(au, tu, uu)];
    let told = s.fma(unit[0], right[0], s.fma(unit[1], right[1], s.mul(unit[2], right[2])));
    let per_amplitude = s.div(s.splat(1.0), pulses.amplitude);
    let step = [unit[0], s.mul(unit[1], per_amplitude), s.mul(unit[2], per_amplitude)];
    let stepped = pulses.stepped(s, &step, LIMITS, last);
    let per_amplitude = s.div(s.splat(1.0), stepped.amplitude);
    let squared = s.mul(per_amplitude, per_amplitude);
    let variances = [aa, s.mul(tt, squared), s.mul(uu, squared)];
    give(s, tables, rows, &sites, &stepped, variances, s.sub(s.sum_each(&sums[3]), told), out);
}

#[inline(always)]
fn lanes<S: Simd, const N: usize>(s: S, values: &[Sixteen; N]) -> [S::V; N] {
    let mut out = [s.splat(0.0); N];
    for (out, values) in out.iter_mut().zip(values) {
        *out = s.load(values);
    }
    out
}

/// Number of each block's last sample.
#[inline(always)]
pub(super) fn last_sample<S: Simd>(s: S, rows: &Rows) -> S::V {
    let mut last = [0.0; LANES];
    for (last, &length) in last.iter_mut().zip(&rows.lengths) {
        *last = length.saturating_sub(1) as f32;
    }
    s.load(&last)
}

/// The values of sixteen pulses and their standard deviations, waveform by waveform.
#[inline(always)]
pub(super) fn echoes<S: Simd>(s: S, pulses: &Pulses<S::V>, variances: [S::V; 3]) -> [Sixteen; 6] {
    let mut out = [[0.0; LANES]; 6];
    s.store(pulses.amplitude, &mut out[0]);
    s.store(pulses.position, &mut out[1]);
    s.store(pulses.width, &mut out[2]);
    for (out, variance) in out[3..].iter_mut().zip(variances) {
        s.store(s.sqrt(variance), out);
    }
    out
}

/// One waveform's echo out of [`echoes`].
#[inline(always)]
pub(super) fn echo(values: &[Sixteen; 6], w: usize) -> Echo {
    Echo {
        amplitude_dn: values[0][w],
        position_samples: values[1][w],
        ln_width_ratio: values[2][w],
        amplitude_sd_dn: values[3][w],
        position_sd_samples: values[4][w],
        ln_width_ratio_sd: values[5][w],
    }
}

#[inline(always)]
fn give<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &Rows,
    sites: &Sites,
    pulses: &Pulses<S::V>,
    variances: [S::V; 3],
    chi_square: S::V,
    out: &mut [Single],
) {
    let values = echoes(s, pulses, variances);
    let mut squares = [0.0; LANES];
    s.store(chi_square, &mut squares);
    for (w, single) in out.iter_mut().enumerate().take(LANES) {
        let length = rows.lengths[w];
        single.echo = echo(&values, w);
        single.chi_square = squares[w];
        single.degrees_of_freedom = counted(sites.first[w], ROW, tables.order, length) - 3;
        single.at_edge = leaves_block(sites.first[w], ROW, tables.order, length);
    }
}
