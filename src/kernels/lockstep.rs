//! The fast kernels: detection, one pulse, two pulses, over sixteen waveforms in lock-step, in `f32`.
//!
//! Samples lie along the vectors, and each waveform's dot products are sums over its own row; only the small systems
//! that follow are solved with a waveform per lane. So templates are read in whole cache lines wherever each waveform's
//! pulse stands, and a waveform's result has the same bits alone, among others, and on every [`Path`].
//!
//! The model is `y_k = b_k + Σ a_i h_u(k − τ_i) + noise` (ALGORITHMS.md, 1.1): a [`Spectrum`] is the response, `ArNoise`
//! the noise, [`Tables`] what is computed from them once, [`Lockstep`] the kernels with a thread's scratch space. After
//! its start a [`Lockstep`] allocates nothing; detection's candidates grow the caller's vector.
//!
//! The first samples of a block, as many as the noise's order, only predict: they carry no weight in a fit. A pulse whose
//! row of 32 samples leaves the block is fitted to what is inside and marked `at_edge`; with [`Method::OneStep`], whose
//! matrix is tabulated for whole rows, a marked result is a start value, not a measurement.

#![allow(
    clippy::needless_range_loop,
    reason = "an index of a lane, row or column runs over several arrays in step"
)]
#![allow(
    clippy::too_many_arguments,
    reason = "kernels are plain functions over tables, rows and scratch space"
)]

mod pair;
mod rows;
mod single;
mod solve;
mod spectrum;
mod tables;
mod template;
mod vector;

#[cfg(test)]
mod tests;

pub use spectrum::Spectrum;
pub use tables::Tables;
pub use vector::Path;

use rows::{FRONT, Rows};
use template::Pulses;
use vector::{Kernel, LANES, Simd};

/// A local maximum of the matched filter.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// Index of the block.
    pub waveform: u32,
    /// Vertex of the parabola through the maximum and its neighbours, samples from the block's first.
    pub position_samples: f32,
    /// The statistic there, in units of its own noise.
    pub statistic: f32,
}

/// A fitted pulse and the standard deviations of its values, all of them free.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Echo {
    /// Coefficient of the response of unit energy gain (`a` of ALGORITHMS.md, 1.1), digitiser steps.
    pub amplitude_dn: f32,
    /// Position of the response's peak, samples from the block's first.
    pub position_samples: f32,
    /// `ln` of the width over the response's own, −0.51 to 1.15.
    pub ln_width_ratio: f32,
    /// Standard deviation of `amplitude_dn`.
    pub amplitude_sd_dn: f32,
    /// Standard deviation of `position_samples`, without timing error.
    pub position_sd_samples: f32,
    /// Standard deviation of `ln_width_ratio`.
    pub ln_width_ratio_sd: f32,
}

/// The strongest pulse of a block.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Single {
    /// Whether a maximum reached the threshold; if not, all else is 0.
    pub found: bool,
    /// Whether the pulse's row leaves the block.
    pub at_edge: bool,
    /// The fit.
    pub echo: Echo,
    /// Sum of the squared whitened residuals over the row.
    pub chi_square: f32,
    /// Samples of the row that count, minus 3; below 1 nothing is measured.
    pub degrees_of_freedom: i32,
}

/// Two pulses of a block.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pair {
    /// Whether the joint frame of 48 samples leaves the block.
    pub at_edge: bool,
    /// Whether the pulses ended more than 16 samples apart, too far for the frame: to be fitted one by one.
    pub beyond_frame: bool,
    /// The fits, in the order of the start values.
    pub echoes: [Echo; 2],
    /// Sum of the squared whitened residuals over the frame.
    pub chi_square: f32,
    /// Samples of the frame that count, minus 6.
    pub degrees_of_freedom: i32,
}

/// Where a fit begins.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Start {
    /// Amplitude, digitiser steps, above 0.
    pub amplitude_dn: f32,
    /// Position, samples from the block's first.
    pub position_samples: f32,
    /// `ln` of the width ratio.
    pub ln_width_ratio: f32,
}

/// How one pulse is fitted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Method {
    /// So many iterations of Gauss and Newton with the full normal matrix; 4 suffice (ALGORITHMS.md, 5.2).
    GaussNewton {
        /// Iterations.
        iterations: usize,
    },
    /// One step with the tabulated inverse Fisher matrix from the width bank's values: `fastest`.
    OneStep,
}

/// What is known of the widths before a joint fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct WidthPrior {
    /// The expected `ln` width ratio.
    pub ln_width_ratio: f32,
    /// Its standard deviation; infinite for no prior.
    pub sd: f32,
}

impl WidthPrior {
    fn precision(self) -> f32 {
        if self.sd > 0.0 { (self.sd * self.sd).recip() } else { 0.0 }
    }
}

/// The kernels with one thread's scratch space.
pub struct Lockstep<'t> {
    tables: &'t Tables,
    path: Path,
    rows: Rows,
}

impl<'t> Lockstep<'t> {
    /// Kernels for blocks of up to `max_samples` samples (a longer block is read as far). The path is the portable one
    /// where the processor lacks the one asked for.
    pub fn new(tables: &'t Tables, path: Path, max_samples: usize) -> Lockstep<'t> {
        Lockstep { tables, path, rows: Rows::new(max_samples) }
    }

    /// Finds the local maxima of the matched filter that reach the threshold (ALGORITHMS.md, S4), block by block, in
    /// order of position. The vector is emptied first.
    pub fn detect(&mut self, blocks: &[&[u16]], threshold: f32, candidates: &mut Vec<Candidate>) {
        candidates.clear();
        let Lockstep { tables, path, rows } = self;
        path.run(Detect { tables, rows, blocks, threshold, candidates });
    }

    /// Finds and fits the strongest pulse of each block. As many as the shorter of `blocks` and `out`.
    pub fn singles(&mut self, blocks: &[&[u16]], threshold: f32, method: Method, out: &mut [Single]) {
        let Lockstep { tables, path, rows } = self;
        path.run(Singles { tables, rows, blocks, threshold, method, out });
    }

    /// Fits two pulses to each block from the given start values. As many as the shortest of the slices.
    pub fn pairs(
        &mut self,
        blocks: &[&[u16]],
        starts: &[[Start; 2]],
        prior: WidthPrior,
        iterations: usize,
        out: &mut [Pair],
    ) {
        let Lockstep { tables, path, rows } = self;
        path.run(Pairs { tables, rows, blocks, starts, prior, iterations, out });
    }
}

struct Detect<'a> {
    tables: &'a Tables,
    rows: &'a mut Rows,
    blocks: &'a [&'a [u16]],
    threshold: f32,
    candidates: &'a mut Vec<Candidate>,
}

impl Kernel for Detect<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let threshold = s.splat(self.threshold);
        for (group, blocks) in self.blocks.chunks(LANES).enumerate() {
            self.rows.load(s, self.tables, blocks);
            self.rows.filter(s, self.tables, blocks.len());
            for w in 0..blocks.len() {
                let row = self.rows.statistic_row(w);
                for c in (0..self.rows.lengths[w]).step_by(64) {
                    let mut bits = self.rows.maxima(s, w, c, threshold);
                    while bits != 0 {
                        let at = FRONT + c + bits.trailing_zeros() as usize;
                        bits &= bits - 1;
                        let [left, centre, right] = three(row, at);
                        let shift = 0.5 * (left - right) / (left - 2.0 * centre + right);
                        self.candidates.push(Candidate {
                            waveform: (group * LANES + w) as u32,
                            position_samples: (at - FRONT) as f32 + shift,
                            statistic: centre - 0.25 * (left - right) * shift,
                        });
                    }
                }
            }
        }
    }
}

/// A value and its neighbours.
#[inline(always)]
fn three(row: &[f32], at: usize) -> [f32; 3] {
    match row.get(at - 1..) {
        Some(from) => *from.first_chunk().unwrap_or(&[0.0; 3]),
        None => [0.0; 3],
    }
}

struct Singles<'a> {
    tables: &'a Tables,
    rows: &'a mut Rows,
    blocks: &'a [&'a [u16]],
    threshold: f32,
    method: Method,
    out: &'a mut [Single],
}

impl Kernel for Singles<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let mut sums = [[s.splat(0.0); LANES]; single::DOTS];
        for (blocks, out) in self.blocks.chunks(LANES).zip(self.out.chunks_mut(LANES)) {
            let blocks = &blocks[..blocks.len().min(out.len())];
            self.rows.load(s, self.tables, blocks);
            self.rows.filter(s, self.tables, blocks.len());
            self.rows.whiten(s, self.tables, blocks.len());
            let (positions, found) = strongest(s, self.rows, blocks.len(), s.splat(self.threshold));
            let start = single::start(s, self.tables, self.rows, positions, &mut sums);
            let out = &mut out[..blocks.len()];
            match self.method {
                Method::GaussNewton { iterations } => {
                    single::newton(s, self.tables, self.rows, start, iterations, &mut sums, out);
                }
                Method::OneStep => single::one_step(s, self.tables, self.rows, start, &mut sums, out),
            }
            for (w, single) in out.iter_mut().enumerate() {
                single.found = true;
                if found & (1 << w) == 0 {
                    *single = Single::default();
                }
            }
        }
    }
}

/// The positions of the strongest maxima, and which waveforms have one; the middle of the block for the others.
#[inline(always)]
fn strongest<S: Simd>(s: S, rows: &Rows, count: usize, threshold: S::V) -> (S::V, u16) {
    let mut found = 0u16;
    let mut at = [0.0; LANES];
    let mut around = [[0.0, 1.0, 0.0]; LANES];
    for w in 0..count {
        let row = rows.statistic_row(w);
        let mut best = FRONT + rows.lengths[w] / 2;
        let mut height = 0.0;
        for c in (0..rows.lengths[w]).step_by(64) {
            let mut bits = rows.maxima(s, w, c, threshold);
            while bits != 0 {
                let position = FRONT + c + bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let value = three(row, position)[1];
                if value > height {
                    (best, height) = (position, value);
                }
            }
        }
        at[w] = (best - FRONT) as f32;
        if height > 0.0 {
            found |= 1 << w;
            around[w] = three(row, best);
        }
    }
    let mut lanes = [[0.0; LANES]; 3];
    for (w, values) in around.iter().enumerate() {
        for (lane, &value) in lanes.iter_mut().zip(values) {
            lane[w] = value;
        }
    }
    let [left, centre, right] = [s.load(&lanes[0]), s.load(&lanes[1]), s.load(&lanes[2])];
    let bend = s.sub(s.add(left, right), s.add(centre, centre));
    let shift = s.div(s.mul(s.splat(0.5), s.sub(left, right)), bend);
    (s.add(s.load(&at), shift), found)
}

struct Pairs<'a> {
    tables: &'a Tables,
    rows: &'a mut Rows,
    blocks: &'a [&'a [u16]],
    starts: &'a [[Start; 2]],
    prior: WidthPrior,
    iterations: usize,
    out: &'a mut [Pair],
}

impl Kernel for Pairs<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(self, s: S) {
        let mut sums = [[s.splat(0.0); LANES]; pair::DOTS];
        let groups = self.blocks.chunks(LANES).zip(self.starts.chunks(LANES)).zip(self.out.chunks_mut(LANES));
        for ((blocks, starts), out) in groups {
            let count = blocks.len().min(starts.len()).min(out.len());
            let blocks = &blocks[..count];
            self.rows.load(s, self.tables, blocks);
            self.rows.whiten(s, self.tables, count);
            let pulses = [pulses(s, starts, 0), pulses(s, starts, 1)];
            let out = &mut out[..count];
            pair::newton(s, self.tables, self.rows, pulses, self.prior, self.iterations, &mut sums, out);
        }
    }
}

/// Start values, a waveform per lane.
#[inline(always)]
fn pulses<S: Simd>(s: S, starts: &[[Start; 2]], which: usize) -> Pulses<S::V> {
    let mut lanes = [[1.0; LANES], [0.0; LANES], [0.0; LANES]];
    for (w, pair) in starts.iter().enumerate().take(LANES) {
        let start = pair[which];
        lanes[0][w] = start.amplitude_dn;
        lanes[1][w] = start.position_samples;
        lanes[2][w] = start.ln_width_ratio;
    }
    Pulses { amplitude: s.load(&lanes[0]), position: s.load(&lanes[1]), width: s.load(&lanes[2]) }
}
