//! Backgrounds that vary from waveform to waveform.
//!
//! A robust level is subtracted before detection ([`super::columns::Columns::estimate_levels`]).
//! Once pulses are fitted and subtracted, one joint linear step of level and pulses brings both to
//! their optimum. With `w` the whitened constant, `c_i = J_iᵀ w`, and `A_i` the normal matrix of
//! cluster `i`:
//!
//! ```text
//! v = 1 / (wᵀ w + q − Σ c_iᵀ A_i⁻¹ c_i),   δ = v (wᵀ r − q β),   θ_i −= g_i δ,   C_i = A_i⁻¹ + g_i g_iᵀ v,   g_i = A_i⁻¹ c_i
//! ```
//!
//! Here `q` is the precision of the prior on the level `β`, and `r` is the residual.

use wavex_simd::{Kernel, LANES, Simd};

use super::fit_queue::add_pulse;
use super::layout::{U_MAX, U_MIN, Values};
use super::level_tables::{LevelStep, LevelTables};
use super::pulse_model::{PulseComponent, PulseModel};
use super::rows::{EMPTY, Rows};
use super::tables::Tables;
use super::template::Lookup;
use crate::shape::SD_OF_FWHM;

/// Minimum number of free samples for a level.
///
/// Waveforms with fewer go to the scalar kernels.
pub(super) const LEAST_FREE: f32 = 6.0;
/// Largest second-order effect of a step, standard deviations of position or width.
///
/// The second order is the square of the change over the pulse's own scale. Above the limit, the
/// pulses are fitted again. The height enters linearly.
const SECOND_ORDER_SD: f32 = 0.02;
/// Minimum fraction of its height that a step leaves, and maximum change of position, samples.
const LIMITS: [f32; 2] = [0.5, 1.0];

/// A step of sixteen levels.
impl LevelTables {
    /// Effect of a level of 1 DN on a whole pulse, and the information it absorbs.
    #[inline(always)]
    pub(super) fn of_whole(&self, tables: &Tables, values: Values) -> (Values, f32) {
        let [height, position, width, explained] = self.of_entry(Lookup::of(tables, values).entry);
        ([height, position / values[0], width / values[0]], explained)
    }

    /// `wᵀ r` of a row with this sum of residuals, and `wᵀ w`.
    #[inline(always)]
    fn products(&self, rows: &Rows, row: usize, order: usize, sum: f32) -> [f32; 2] {
        let length = rows.length(row);
        let order = order.min(length);
        let mut out = [self.steady * sum, self.steady * self.steady * (length - order) as f32];
        // The first samples have their own whitening; they count if no pulse reaches them.
        if rows.counted(row) == length {
            for (one, residual) in self.begin().iter().zip(rows.residual_sixteen(row, 0)).take(order) {
                out[0] += (one - self.steady) * residual;
                out[1] += one * one;
            }
        }
        out
    }
}

/// Computes the level steps of up to sixteen waveforms, and the rows' sums of squares.
///
/// Pulses must be subtracted from the rows. `levels` holds each level and the information on it
/// that the pulses absorb.
#[inline(always)]
fn level_steps<S: Simd>(
    s: S,
    tables: &Tables,
    level: &LevelTables,
    rows: &Rows,
    which: &[usize],
    levels: impl Iterator<Item = [f32; 2]>,
) -> (LevelStep<S::V>, S::V) {
    let mut lanes = [EMPTY; LANES];
    lanes[..which.len()].copy_from_slice(which);
    let [sums, squares] = rows.sums_and_squares(s, &lanes);
    let (mut products, mut information) = ([0.0; LANES], [1.0; LANES]);
    let (mut level_dn, mut explained) = ([0.0; LANES], [0.0; LANES]);
    for ((w, &row), of_row) in which.iter().enumerate().zip(levels) {
        [products[w], information[w]] = level.products(rows, row, tables.order, sums[w]);
        [level_dn[w], explained[w]] = of_row;
    }
    let [level_dn, products] = [s.load(&level_dn), s.load(&products)];
    let step = level.step(s, level_dn, products, s.load(&information), s.load(&explained));
    (step, s.load(&squares))
}

/// Chi-square of rows, minus the decrease by a step of their levels.
pub(super) struct JointSquares<'a> {
    pub(super) tables: &'a Tables,
    pub(super) level: &'a LevelTables,
    pub(super) rows: &'a Rows,
    pub(super) which: &'a [usize],
    /// Level of each row, DN, and the information on it that the pulses absorb, 1/DN².
    pub(super) levels: &'a [[f32; 2]],
    pub(super) out: &'a mut Vec<f32>,
}

impl Kernel for JointSquares<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let JointSquares { tables, level, rows, out, .. } = self;
        out.clear();
        for (which, levels) in self.which.chunks(LANES).zip(self.levels.chunks(LANES)) {
            let (step, squares) = level_steps(s, tables, level, rows, which, levels.iter().copied());
            let joint = s.max(s.sub(squares, step.gain), s.splat(0.0));
            let mut lanes = [0.0; LANES];
            s.store(s.select(step.made, joint, squares), &mut lanes);
            out.extend_from_slice(&lanes[..which.len()]);
        }
    }
}

/// Makes the joint linear step of level and pulses for some waveforms.
///
/// Subtracts their pulses from the rows first, unless already done.
pub(super) struct SetLevels<'a> {
    pub(super) tables: &'a Tables,
    pub(super) level: &'a LevelTables,
    pub(super) rows: &'a mut Rows,
    pub(super) pulse_models: &'a mut [PulseModel],
    pub(super) which: &'a [usize],
    /// Whether to update the rows for a later search.
    pub(super) follows: bool,
    /// Collects waveforms whose pulses moved so far that they need a new fit.
    pub(super) moved: &'a mut Vec<usize>,
}

impl Kernel for SetLevels<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let SetLevels { tables, level, rows, pulse_models, follows, moved, .. } = self;
        for which in self.which.chunks(LANES) {
            for &row in which {
                let pulse_model = &mut pulse_models[row];
                if !pulse_model.subtract() {
                    for pulse in pulse_model.pulses() {
                        add_pulse(s, tables, rows, row, pulse.values(), -1.0);
                    }
                }
            }
            set_levels(s, tables, level, rows, pulse_models, which, follows, moved);
        }
    }
}

/// Makes the step for up to sixteen waveforms with subtracted pulses.
///
/// With `follows` the rows are updated, and waveforms whose pulses moved so far that they need a
/// new fit are added to `moved`. Otherwise the standard deviations are final.
#[inline(always)]
pub(super) fn set_levels<S: Simd>(
    s: S,
    tables: &Tables,
    level: &LevelTables,
    rows: &mut Rows,
    pulse_models: &mut [PulseModel],
    which: &[usize],
    follows: bool,
    moved: &mut Vec<usize>,
) {
    let levels = which.iter().map(|&row| [pulse_models[row].level_dn, pulse_models[row].level_information()]);
    let (step, squares) = level_steps(s, tables, level, rows, which, levels);
    let [mut by_dn, mut after, mut variances, mut changes] = [[0.0; LANES]; 4];
    s.store(step.by_dn, &mut by_dn);
    s.store(step.level_dn, &mut after);
    s.store(step.variance, &mut variances);
    // The change is predicted by a linear model, which may fall below 0.
    s.store(s.max(s.add(squares, step.chi_square_change), s.splat(0.0)), &mut changes);
    let mut sums = [s.halved(s.splat(0.0)); LANES];
    let sd_samples = (SD_OF_FWHM * tables.fwhm_samples) as f32;
    for (w, &row) in which.iter().enumerate() {
        let pulse_model = &mut pulse_models[row];
        if step.made & (1 << w) == 0 {
            pulse_model.leave_to_scalar();
            continue;
        }
        pulse_model.set_level(after[w], variances[w]);
        pulse_model.samples = rows.counted(row);
        if !follows {
            pulse_model.chi_square = changes[w];
            for pulse in pulse_model.pulses_mut() {
                pulse.follow_level(by_dn[w]);
                pulse.widen(variances[w]);
            }
            continue;
        }
        let mut is_linear = true;
        for pulse in pulse_model.pulses_mut() {
            let before = pulse.values();
            let is_little = pulse.is_moved_little(by_dn[w], sd_samples);
            pulse.follow_level(by_dn[w]);
            if is_little {
                let after = pulse.values();
                let change = std::array::from_fn(|i| after[i] - before[i]);
                take_change_off(s, tables, rows, row, before, change);
            } else {
                is_linear = false;
                add_pulse(s, tables, rows, row, before, 1.0);
                add_pulse(s, tables, rows, row, pulse.values(), -1.0);
            }
        }
        sums[w] = rows.take_level_off(s, level, tables.order, row, by_dn[w]);
        if !is_linear {
            moved.push(row);
        }
    }
    if follows {
        let mut squares = [0.0; LANES];
        s.store(s.sum_each(&sums), &mut squares);
        for (square, &row) in squares.into_iter().zip(which) {
            pulse_models[row].chi_square = square;
        }
    }
}

/// Subtracts a small change of a pulse's values from a row, to first order.
#[inline(always)]
fn take_change_off<S: Simd>(
    s: S,
    tables: &Tables,
    rows: &mut Rows,
    row: usize,
    values: Values,
    change: Values,
) {
    let lookup = Lookup::of(tables, values);
    if lookup.height >= tables.strong_dn() {
        rows.take_change_off::<S, true>(s, tables, row, &lookup, change);
    } else {
        rows.take_change_off::<S, false>(s, tables, row, &lookup, change);
    }
}

impl PulseComponent {
    /// Whether the second-order effect of a level change is negligible.
    #[inline(always)]
    fn is_moved_little(&self, step_dn: f32, calibrated_sd_samples: f32) -> bool {
        let [_, position, width] = self.by_level.map(|by| (by * step_dn).powi(2));
        position <= SECOND_ORDER_SD * calibrated_sd_samples * self.width_ratio() * self.sds[1]
            && width <= SECOND_ORDER_SD * self.sds[2]
    }

    /// Adds the uncertainty of the level to the standard deviations.
    #[inline(always)]
    fn widen(&mut self, level_variance: f32) {
        if self.is_fitted() {
            for (sd, by) in self.sds.iter_mut().zip(&self.by_level) {
                *sd = (*sd * *sd + by * by * level_variance).sqrt();
            }
        }
    }

    /// Changes the pulse's values for a step of the level.
    #[inline(always)]
    fn follow_level(&mut self, step_dn: f32) {
        let [mut height, mut position, mut width] = self.values();
        let [by_height, by_position, by_width] = self.by_level;
        height = (height - by_height * step_dn).max(LIMITS[0] * height);
        position -= (by_position * step_dn).clamp(-LIMITS[1], LIMITS[1]);
        if width < U_MAX as f32 {
            // A width below the limit must not reach it: it would be taken for a truncated one.
            let widest = U_MAX as f32 - 1e-3;
            width = (width - by_width * step_dn).clamp(U_MIN as f32, widest.max(width));
        }
        self.set_values([height, position, width]);
    }
}

/// Adds the uncertainty of the level to the standard deviations of all pulses.
pub(super) fn widen(pulse_models: &mut [PulseModel]) {
    for pulse_model in pulse_models.iter_mut().filter(|pulse_model| pulse_model.is_fast()) {
        let variance = pulse_model.level_variance;
        pulse_model.pulses_mut().iter_mut().for_each(|pulse| pulse.widen(variance));
    }
}
