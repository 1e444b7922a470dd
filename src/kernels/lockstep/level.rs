//! A background that each waveform has of its own.
//!
//! A robust level is taken off before detection ([`super::columns::Columns::estimate_levels`]). Once pulses are fitted and
//! taken off, one joint linear step of level and pulses brings both to their optimum: with `w` the whitened constant,
//! `c_i = J_iᵀ w` and `A_i` the normal matrix of cluster `i`,
//!
//! ```text
//! v = 1 / (wᵀ w + q − Σ c_iᵀ A_i⁻¹ c_i),   δ = v (wᵀ r − q β),   θ_i −= g_i δ,   C_i = A_i⁻¹ + g_i g_iᵀ v,   g_i = A_i⁻¹ c_i
//! ```
//!
//! with `q` the precision of the prior on the level `β`, and `r` the residual.

use super::filter::Filter;
use super::fitted::Values;
use super::jobs::add_pulse;
use super::rows::{EMPTY, Rows};
use super::scene::{Pulse, Scene, Way};
use super::tables::{MAX_ORDER, Tables, U_MAX, U_MIN};
use super::template::Site;
use super::vector::{Kernel, LANES, Simd};
use crate::kernels::noise::ArNoise;
use crate::kernels::whitening::Whitener;

/// Samples farther from a level than this many standard deviations of the noise do not count for it; nearer ones count
/// by Tukey's biweight (Beaton and Tukey 1974).
const REACH_SD: f64 = 4.0;
/// Free samples that a level is estimated from at least; a waveform with fewer is left to the plain kernels.
pub(super) const LEAST_FREE: f32 = 10.0;
/// The lowest mean of four samples lies below the level by about this many of its standard deviations.
const LOWEST_OF_MEANS_SD: f64 = 1.4;
/// A level farther from the prior's than this many standard deviations is left to the plain kernels.
const LIKELY_SD: f32 = 5.0;
/// Part of the information on a level that pulses must leave.
const LEAST_INFORMATION: f32 = 0.05;
/// A step that moves a pulse's place or width by more than this many standard deviations calls for another fit; the height
/// enters linearly.
const LINEAR_SD: f32 = 0.5;
/// Least share of its height that the step leaves to a pulse, and its largest change of position, samples.
const LIMITS: [f32; 2] = [0.5, 1.0];

/// What depends on the channel.
pub(super) struct LevelTables {
    /// Precision of the prior on a level, 1/DN².
    pub(super) precision: f32,
    /// The whitened constant 1: of the first samples, as many as the noise's order, and of all others.
    begin: [f32; MAX_ORDER],
    pub(super) steady: f32,
    /// What the matched filter makes of a constant 1, as its background.
    pub(super) filter: Filter,
    /// Half width of the window of the robust mean, DN.
    pub(super) reach_dn: f32,
    /// The level less the lowest mean of four samples, on average, DN.
    pub(super) above_lowest_dn: f32,
    /// Mean of the weights of free samples.
    pub(super) mean_weight: f32,
    /// Newton's step over that of the weighted mean.
    pub(super) newton: f32,
    /// By entry, of a whole pulse of height 1: what a level of 1 DN adds to its values, and the information on the level that
    /// the pulse takes up.
    whole: Vec<[f32; 4]>,
}

impl LevelTables {
    /// The tables but for those of pulses.
    pub(super) fn new(noise: &ArNoise, precision: f64) -> LevelTables {
        let mut ones = [1.0; 2 * MAX_ORDER];
        let mut whitener = Whitener::new(noise.clone(), ones.len());
        whitener.set_used(&[true; 2 * MAX_ORDER]);
        whitener.whiten(&mut ones);
        let mut lags = [0.0; 4];
        noise.autocovariance_into(&mut lags);
        let variance_of_mean = (4.0 * lags[0] + 6.0 * lags[1] + 4.0 * lags[2] + 2.0 * lags[3]) / 16.0;
        // Moments of the weights over normal noise: `E w`, and `E ψ'` with `ψ = x w`.
        let [m2, m4] = [REACH_SD.powi(-2), 3.0 * REACH_SD.powi(-4)];
        let (weight, slope) = (1.0 - 2.0 * m2 + m4, 1.0 - 6.0 * m2 + 5.0 * m4);
        LevelTables {
            precision: precision as f32,
            begin: std::array::from_fn(|k| ones[k] as f32),
            steady: ones[2 * MAX_ORDER - 1] as f32,
            filter: Filter::NONE,
            reach_dn: (REACH_SD * noise.sd()) as f32,
            above_lowest_dn: (LOWEST_OF_MEANS_SD * variance_of_mean.sqrt()) as f32,
            mean_weight: weight as f32,
            newton: (weight / slope) as f32,
            whole: Vec::new(),
        }
    }

    /// Adds an entry: its inverse Fisher matrix, and the sums of its whitened pulse and derivatives by position and width.
    pub(super) fn push(&mut self, inverse_fisher: &[f32; 8], sums: [f32; 3]) {
        let [aa, at, tt, au, tu, uu, ..] = *inverse_fisher;
        let [a, t, u] = sums.map(|sum| self.steady * sum);
        let values = [aa * a + at * t + au * u, at * a + tt * t + tu * u, au * a + tu * t + uu * u];
        let explained = values[0] * a + values[1] * t + values[2] * u;
        self.whole.push([values[0], values[1], values[2], explained]);
    }

    /// What a level of 1 DN adds to the values of a whole pulse, and the information that it takes up.
    #[inline(always)]
    pub(super) fn of_whole(&self, tables: &Tables, values: Values) -> (Values, f32) {
        let entry = Site::of(tables, values).entry;
        let [height, position, width, explained] = self.whole.get(entry).copied().unwrap_or([0.0; 4]);
        ([height, position / values[0], width / values[0]], explained)
    }

    /// The statistic of a constant 1 far from a block's ends.
    pub(super) fn response(&self) -> f32 {
        -self.filter.scale_and_level(LANES, LANES - 1)[1]
    }

    /// Whether a level is one that the prior lets expect, given the variance of its estimate, DN².
    pub(super) fn is_likely(&self, level_dn: f32, variance: f32) -> bool {
        self.precision == 0.0
            || level_dn * level_dn <= LIKELY_SD * LIKELY_SD * (self.precision.recip() + variance)
    }

    /// `wᵀ r` of a row with this sum of residuals, and `wᵀ w`.
    #[inline(always)]
    fn products(&self, rows: &Rows, row: usize, order: usize, sum: f32) -> [f32; 2] {
        let length = rows.length(row);
        let order = order.min(length);
        let mut out = [self.steady * sum, self.steady * self.steady * (length - order) as f32];
        if rows.counted(row) == length {
            for (one, residual) in self.begin.iter().zip(rows.residual_sixteen(row, 0)).take(order) {
                out[0] += (one - self.steady) * residual;
                out[1] += one * one;
            }
        }
        out
    }

    /// The whitened constant of the first samples.
    pub(super) fn begin(&self) -> &[f32; MAX_ORDER] {
        &self.begin
    }
}

/// The joint linear step of level and pulses for some waveforms; their pulses are taken off their rows where they are not yet.
pub(super) struct SetLevels<'a> {
    pub(super) tables: &'a Tables,
    pub(super) level: &'a LevelTables,
    pub(super) rows: &'a mut Rows,
    pub(super) scenes: &'a mut [Scene],
    pub(super) which: &'a [usize],
    /// Whether rows follow the step: they are searched afterwards.
    pub(super) follows: bool,
    /// Waveforms whose pulses moved so far that they are to be fitted anew are added here.
    pub(super) moved: &'a mut Vec<usize>,
}

impl Kernel for SetLevels<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let SetLevels { tables, level, rows, scenes, follows, moved, .. } = self;
        for which in self.which.chunks(LANES) {
            let mut lanes = [EMPTY; LANES];
            for (lane, &row) in lanes.iter_mut().zip(which) {
                *lane = row;
                let scene = &mut scenes[row];
                if !std::mem::replace(&mut scene.taken_off, true) {
                    for pulse in scene.pulses() {
                        add_pulse(s, tables, rows, row, pulse.values(), -1.0);
                    }
                }
            }
            let [sums, squares] = rows.sums_and_squares(s, &lanes);
            for (w, &row) in which.iter().enumerate() {
                let scene = &mut scenes[row];
                let [product, information] = level.products(rows, row, tables.order, sums[w]);
                let explained: f32 = scene.pulses().iter().map(|pulse| pulse.level_information).sum();
                let left = information - explained;
                // Not a number is no more than anything.
                let is_enough = left > LEAST_INFORMATION * information;
                let all = left + level.precision;
                let step = (product - level.precision * scene.level_dn) / all;
                if !(is_enough && step.is_finite() && level.is_likely(scene.level_dn + step, all.recip())) {
                    scene.give_up();
                    continue;
                }
                let before = scene.level_dn;
                scene.set_level(before + step, all.recip());
                scene.samples = rows.counted(row);
                if follows {
                    let mut is_linear = true;
                    for pulse in scene.pulses_mut() {
                        is_linear &= pulse.is_moved_little(step);
                        add_pulse(s, tables, rows, row, pulse.values(), 1.0);
                        pulse.follow_level(step);
                        add_pulse(s, tables, rows, row, pulse.values(), -1.0);
                    }
                    rows.take_level_off(s, level, tables.order, row, step);
                    if !is_linear {
                        moved.push(row);
                    }
                } else {
                    scene.pulses_mut().iter_mut().for_each(|pulse| pulse.follow_level(step));
                    let prior = level.precision * (before * before - scene.level_dn * scene.level_dn);
                    scene.chi_square = (squares[w] - step * step * all + prior).max(0.0);
                }
            }
            if follows {
                let squares = rows.chi_squares(s, &lanes);
                for (square, &row) in squares.into_iter().zip(which) {
                    (scenes[row].chi_square, scenes[row].samples) = (square, rows.counted(row));
                }
            }
        }
    }
}

impl Pulse {
    /// Whether a change of the level moves place and width by little against their standard deviations.
    #[inline(always)]
    fn is_moved_little(&self, step_dn: f32) -> bool {
        let little = |(by, sd): (&f32, &f32)| (by * step_dn).abs() <= LINEAR_SD * sd;
        self.by_level.iter().zip(&self.sds).skip(1).all(little)
    }

    /// Moves the pulse as the level's change asks for.
    #[inline(always)]
    fn follow_level(&mut self, step_dn: f32) {
        let [mut height, mut position, mut width] = self.values();
        let [by_height, by_position, by_width] = self.by_level;
        height = (height - by_height * step_dn).max(LIMITS[0] * height);
        position -= (by_position * step_dn).clamp(-LIMITS[1], LIMITS[1]);
        if width < U_MAX as f32 {
            // What ended below the tables' end is not to be taken for a pulse that they cut short.
            let widest = U_MAX as f32 - 1e-3;
            width = (width - by_width * step_dn).clamp(U_MIN as f32, widest.max(width));
        }
        self.set_values([height, position, width]);
    }
}

/// Puts the uncertainty of the level into the standard deviations of the pulses.
pub(super) fn widen(scenes: &mut [Scene]) {
    for scene in scenes.iter_mut().filter(|scene| scene.way == Way::Fast) {
        let variance = scene.level_variance;
        for pulse in scene.pulses_mut().iter_mut().filter(|pulse| pulse.is_fitted()) {
            for (sd, by) in pulse.sds.iter_mut().zip(&pulse.by_level) {
                *sd = (*sd * *sd + by * by * variance).sqrt();
            }
        }
    }
}
