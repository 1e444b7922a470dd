//! Sixteen waveforms as columns, for operations on every sample.
//!
//! A row of memory is one sample number, a lane one waveform. Whitening and the matched filter
//! therefore read each value from memory once and need no shuffle. Every operation on a lane uses
//! that lane alone and adds in the same order in every lane.

use wavex_simd::{LANES, Simd, Sixteen};

use super::filter::{HIGHEST, POSITIONS, sums};
use super::layout::{FILTER_BEFORE, FILTER_LAGS, MAX_ORDER, TAPS, TAPS_BEFORE};
use super::rows::{CHUNK, Rows};
use super::tables::{Aligned, Tables};

mod levels;

/// Zero rows before the first sample, read by the filter.
const BEFORE: usize = 16;
/// Zero rows after the last sample.
const BEHIND: usize = 32;
/// Samples loaded at a time: two per lane.
const PAIRS: usize = 2 * LANES;

/// Buffers of one thread for sixteen waveforms.
pub(super) struct Columns {
    capacity: usize,
    /// Two samples per lane, at most [`HIGHEST`]; the first two are at row `BEFORE / 2`.
    pairs: Aligned,
    /// Residuals; that of sample 0 is at row `BEFORE`.
    residuals: Aligned,
    /// Number of rows of `pairs` and `residuals` that may be non-zero.
    filled_pairs: usize,
    filled_residuals: usize,
    /// Detection statistic; position 0 is at row 1.
    statistic: Aligned,
    lengths: [usize; LANES],
    longest: usize,
    /// Background of the waveform minus that of the channel, DN, and its variance, DN².
    ///
    /// Both are 0 for a fixed background.
    level_dn: Sixteen,
    level_variance: Sixteen,
    /// Lanes with a local maximum, by position.
    masks: Vec<[u16; CHUNK]>,
}

impl Columns {
    /// Creates buffers for blocks of up to `capacity` samples, a multiple of [`CHUNK`].
    pub(super) fn new(capacity: usize) -> Columns {
        Columns {
            capacity,
            pairs: Aligned::zeros((BEFORE + capacity + BEHIND) / 2 * LANES),
            residuals: Aligned::zeros((BEFORE + capacity + BEHIND) * LANES),
            filled_pairs: 0,
            filled_residuals: 0,
            statistic: Aligned::zeros((capacity + 2) * LANES),
            lengths: [0; LANES],
            longest: 0,
            level_dn: [0.0; LANES],
            level_variance: [0.0; LANES],
            masks: vec![[0; CHUNK]; capacity / CHUNK],
        }
    }

    /// Loads up to sixteen blocks; returns the lowest and highest sample of each.
    ///
    /// Blocks are cut at the capacity. Missing blocks are empty.
    #[inline(always)]
    pub(super) fn load<S: Simd>(&mut self, s: S, blocks: &[&[u16]]) -> [[u16; 2]; LANES] {
        let mut of_lane: [&[u16]; LANES] = [&[]; LANES];
        for (lane, block) in of_lane.iter_mut().zip(blocks) {
            *lane = block.get(..self.capacity).unwrap_or(block);
        }
        let n = of_lane[0].len();
        // Blocks of one length, the usual case, need neither padding nor masks.
        let alike = n >= PAIRS && n.is_multiple_of(2) && of_lane.iter().all(|block| block.len() == n);
        self.set_lengths(of_lane.map(<[u16]>::len));
        empty_behind(&mut self.pairs, (BEFORE + self.longest).div_ceil(2), &mut self.filled_pairs);
        let (lengths, _) = self.ends(s);
        let nothing = s.splat_pair([0, 0]);
        let (mut lowest, mut highest) = (s.splat_pair([u16::MAX, u16::MAX]), nothing);
        let limit = s.splat_pair([HIGHEST, HIGHEST]);
        for start in (0..self.longest).step_by(PAIRS) {
            // The last group overlaps the one before instead of reading past the end.
            let start = if alike { start.min(n - PAIRS) } else { start };
            let mut pairs =
                if alike { whole_pairs(s, &of_lane, start) } else { padded_pairs(s, &of_lane, start) };
            s.transpose(&mut pairs);
            let Some(to) = rows_from_mut::<LANES>(&mut self.pairs, (BEFORE + start) / 2) else { break };
            unrolled!(k in [0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15] if LANES => {
                let pair = pairs[k];
                let mut least = pair;
                if !alike {
                    // The padding after a block must not count as low samples.
                    let first = s.gt(lengths, s.splat((start + 2 * k) as f32));
                    let second = s.gt(lengths, s.splat((start + 2 * k + 1) as f32));
                    let behind = s.select(second, nothing, s.splat_pair([0, u16::MAX]));
                    let behind = s.select(first, behind, s.splat_pair([u16::MAX, u16::MAX]));
                    least = s.max_pairs(pair, behind);
                }
                lowest = s.min_pairs(lowest, least);
                highest = s.max_pairs(highest, pair);
                s.store(s.min_pairs(pair, limit), &mut to[k]);
            });
        }
        let (mut low, mut high): (Sixteen, Sixteen) = ([0.0; LANES], [0.0; LANES]);
        s.store(s.min(s.first(lowest), s.second(lowest)), &mut low);
        s.store(s.max(s.first(highest), s.second(highest)), &mut high);
        std::array::from_fn(|w| [low[w] as u16, high[w] as u16])
    }

    /// Loads the residuals of sixteen rows.
    #[inline(always)]
    pub(super) fn load_residuals<S: Simd>(&mut self, s: S, rows: &Rows, which: &[usize; LANES]) {
        self.set_lengths(which.map(|row| rows.length(row)));
        empty_behind(&mut self.residuals, BEFORE + self.longest, &mut self.filled_residuals);
        for start in (0..self.longest).step_by(LANES) {
            let mut values = [s.splat(0.0); LANES];
            for (value, &row) in values.iter_mut().zip(which) {
                *value = s.load(rows.residual_sixteen(row, start));
            }
            s.transpose(&mut values);
            let Some(to) = rows_from_mut::<LANES>(&mut self.residuals, BEFORE + start) else { return };
            for (value, to) in values.iter().zip(to) {
                s.store(*value, to);
            }
        }
    }

    #[inline(always)]
    fn set_lengths(&mut self, lengths: [usize; LANES]) {
        self.lengths = lengths;
        self.longest = lengths.into_iter().max().unwrap_or(0).min(self.capacity);
    }

    /// Whitens the samples into the residuals from row `first` on.
    ///
    /// The first samples, as many as the order of the noise, have their own whitening. Pulses are
    /// not subtracted from them, so they count only if no pulse reaches them.
    #[inline(always)]
    pub(super) fn whiten<S: Simd>(&self, s: S, tables: &Tables, rows: &mut Rows, first: usize, count: usize) {
        // The last taps are zero for noise of low order.
        if tables.order <= MAX_ORDER / 2 {
            self.whiten_by::<S, { MAX_ORDER / 2 }>(s, tables, rows, first, count);
        } else {
            self.whiten_by::<S, MAX_ORDER>(s, tables, rows, first, count);
        }
    }

    #[inline(always)]
    fn whiten_by<S: Simd, const ORDER: usize>(
        &self,
        s: S,
        tables: &Tables,
        rows: &mut Rows,
        first: usize,
        count: usize,
    ) {
        for (w, &length) in self.lengths.iter().enumerate().take(count) {
            rows.begin(first + w, length);
        }
        let mut taps = [s.splat(0.0); MAX_ORDER + 1];
        for (tap, &value) in taps.iter_mut().zip(&tables.whitening) {
            *tap = s.splat(value);
        }
        let mut background = [s.splat(0.0); 4];
        let levels = s.load(&self.level_dn);
        let steady = s.splat(tables.level.as_ref().map_or(0.0, |level| level.steady));
        for (level, &whitened) in background.iter_mut().zip(&tables.whitened_background) {
            *level = s.sub(s.splat(-whitened), s.mul(levels, steady));
        }
        for start in (0..self.longest).step_by(LANES) {
            let from = (BEFORE + start - MAX_ORDER) / 2;
            let Some(pairs) = rows_from::<{ (MAX_ORDER + LANES) / 2 }>(&self.pairs, from) else { return };
            let mut inputs = [s.splat(0.0); MAX_ORDER + LANES];
            unrolled!(m in [0 1 2 3 4 5 6 7 8 9] if (MAX_ORDER + LANES) / 2 => {
                let pair = s.load(&pairs[m]);
                (inputs[2 * m], inputs[2 * m + 1]) = (s.first(pair), s.second(pair));
            });
            let mut values = [s.splat(0.0); LANES];
            unrolled!(k in [0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15] if LANES => {
                let mut sum = s.fma(taps[0], inputs[MAX_ORDER + k], background[k % 4]);
                unrolled!(lag in [1 2 3 4] if ORDER + 1 => {
                    sum = s.fma(taps[lag], inputs[MAX_ORDER + k - lag], sum);
                });
                values[k] = sum;
            });
            if start == 0 {
                for k in 0..tables.order {
                    let mut value = s.splat(0.0);
                    for j in 0..=k {
                        let sample = s.sub(inputs[MAX_ORDER + j], s.splat(tables.background[j % 4]));
                        let sample = s.sub(sample, levels);
                        value = s.add(value, s.mul(s.splat(tables.begin[k][j]), sample));
                    }
                    values[k] = value;
                }
            }
            s.transpose(&mut values);
            rows.put_residuals(s, &values, first, start, &self.lengths, count);
        }
        rows.end_residuals(s, first, &self.lengths, count);
    }

    /// Computes the statistic at every position from the samples.
    #[inline(always)]
    pub(super) fn filter_samples<S: Simd>(&mut self, s: S, tables: &Tables) {
        // The first taps are zero for noise of low order.
        if tables.order <= MAX_ORDER / 2 {
            self.filter_pairs::<S, { TAPS - MAX_ORDER / 2 }>(s, tables);
        } else {
            self.filter_pairs::<S, TAPS>(s, tables);
        }
    }

    #[inline(always)]
    fn filter_pairs<S: Simd, const N: usize>(&mut self, s: S, tables: &Tables) {
        let filter = &tables.filter;
        let change = tables.level.as_ref().map(|level| self.statistic_change(s, level));
        let taps = filter.taps::<S, N>(s);
        let earlier = N - (TAPS - TAPS_BEFORE);
        let (lengths, shortest) = self.ends(s);
        let mut at = 0;
        while at < self.longest {
            let window = rows_from(&self.pairs, (BEFORE + at - earlier) / 2);
            let to = rows_from_mut::<POSITIONS>(&mut self.statistic, 1 + at);
            let (Some(window), Some(to)) = (window, to) else { return };
            let sums = sums::<S, N>(s, &taps, window);
            unrolled!(i in [0 1 2 3 4 5 6 7] if POSITIONS => {
                let [scale, level] = filter.scales_and_levels(s, at + i, lengths, shortest);
                let mut statistic = s.fma(s.float(sums[i]), scale, level);
                if let Some(change) = &change {
                    statistic = change.of(statistic, at + i);
                }
                s.store(statistic, &mut to[i]);
            });
            at += POSITIONS;
        }
        self.end_statistic(at);
    }

    /// Computes the statistic at every position from the whitened residuals.
    #[inline(always)]
    pub(super) fn filter_residuals<S: Simd>(&mut self, s: S, tables: &Tables) {
        if tables.has_late_samples() {
            self.filter_residuals_by::<S, 2>(s, tables);
        } else {
            self.filter_residuals_by::<S, 1>(s, tables);
        }
    }

    /// `PARITIES` is the number of filters: for all, or for even and odd positions.
    #[inline(always)]
    fn filter_residuals_by<S: Simd, const PARITIES: usize>(&mut self, s: S, tables: &Tables) {
        const EARLIER: usize = FILTER_BEFORE as usize;
        const { assert!(EARLIER <= BEFORE && FILTER_LAGS - EARLIER + POSITIONS <= BEHIND) };
        let mut taps = [[s.splat(0.0); FILTER_LAGS]; PARITIES];
        for (taps, matched) in taps.iter_mut().zip(&tables.matched) {
            for (tap, &value) in taps.iter_mut().zip(matched) {
                *tap = s.splat(value);
            }
        }
        let (lengths, shortest) = self.ends(s);
        let mut at = 0;
        while at < self.longest {
            let window = rows_from(&self.residuals, BEFORE + at - EARLIER);
            let to = rows_from_mut::<POSITIONS>(&mut self.statistic, 1 + at);
            let (Some(window), Some(to)) = (window, to) else { return };
            let sums = filtered::<S, PARITIES>(s, &taps, window);
            unrolled!(i in [0 1 2 3 4 5 6 7] if POSITIONS => {
                let [scale, _] = tables.filter.scales_and_levels(s, at + i, lengths, shortest);
                s.store(s.mul(sums[i], scale), &mut to[i]);
            });
            at += POSITIONS;
        }
        self.end_statistic(at);
    }

    /// Returns the lengths of the waveforms and the shortest of them.
    #[inline(always)]
    fn ends<S: Simd>(&self, s: S) -> (S::V, usize) {
        let lengths: Sixteen = std::array::from_fn(|w| self.lengths[w] as f32);
        (s.load(&lengths), self.lengths.into_iter().min().unwrap_or(0))
    }

    /// Clears the statistic at the position after the filtered ones.
    #[inline(always)]
    fn end_statistic(&mut self, at: usize) {
        if let Some(behind) = self.statistic.as_mut_slice().get_mut((1 + at) * LANES..) {
            behind.iter_mut().take(LANES).for_each(|value| *value = 0.0);
        }
    }

    /// Marks the positions that are local maxima of at least the threshold.
    #[inline(always)]
    pub(super) fn mark_maxima<S: Simd>(&mut self, s: S, threshold: f32) {
        let limit = s.splat(threshold);
        let rows = self.statistic.as_slice().as_chunks::<LANES>().0;
        let (Some(first), Some(second)) = (rows.first(), rows.get(1)) else { return };
        let (mut before, mut here) = (s.load(first), s.load(second));
        for (chunk, masks) in self.masks.iter_mut().enumerate().take(self.longest.div_ceil(CHUNK)) {
            let from = chunk * CHUNK;
            let count = (self.longest - from).min(CHUNK);
            masks[count..].fill(0);
            let Some(rows) = rows.get(from + 2..from + 2 + count) else { return };
            for (mask, next) in masks.iter_mut().zip(rows) {
                let next = s.load(next);
                *mask = s.ge(here, s.max(limit, next)) & s.gt(here, before);
                (before, here) = (here, next);
            }
        }
    }

    /// Returns the marked positions of a lane.
    ///
    /// Each item is the first of 64 positions and one bit for each of them.
    #[inline(always)]
    pub(super) fn maxima<S: Simd>(&self, s: S, lane: usize) -> impl Iterator<Item = (usize, u64)> {
        let chunks = self.masks.iter().take(self.lengths[lane].div_ceil(CHUNK)).enumerate();
        chunks.map(move |(chunk, masks)| (chunk * CHUNK, s.lane_bits(masks, lane)))
    }

    /// Returns the statistic of a lane at a position; 0 outside.
    #[inline(always)]
    pub(super) fn statistic(&self, lane: usize, position: usize) -> f32 {
        self.statistic.as_slice().get((1 + position) * LANES + lane).copied().unwrap_or(0.0)
    }

    /// Returns the statistic of a lane before, at and after a position.
    #[inline(always)]
    pub(super) fn around(&self, lane: usize, position: usize) -> [f32; 3] {
        match rows_from::<3>(&self.statistic, position) {
            Some(rows) => rows.map(|row| row[lane]),
            None => [0.0; 3],
        }
    }
}

/// Clears the filled rows after `kept`.
///
/// The next load may fill up to sixteen rows more than `kept`.
#[inline(always)]
fn empty_behind(rows: &mut Aligned, kept: usize, filled: &mut usize) {
    if *filled > kept {
        rows.as_mut_slice()[kept * LANES..*filled * LANES].fill(0.0);
    }
    *filled = kept + LANES;
}

/// Sums of the taps over eight windows, each one sample later.
///
/// Every input is read once and multiplied with all taps that need it.
#[inline(always)]
fn filtered<S: Simd, const PARITIES: usize>(
    s: S,
    taps: &[[S::V; FILTER_LAGS]; PARITIES],
    window: &[Sixteen; FILTER_LAGS + POSITIONS - 1],
) -> [S::V; POSITIONS] {
    let mut sums = [s.splat(0.0); POSITIONS];
    unrolled!(m in [0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20] if FILTER_LAGS + POSITIONS - 1 => {
        let value = s.load(&window[m]);
        unrolled!(i in [0 1 2 3 4 5 6 7] if POSITIONS => {
            if m >= i && m - i < FILTER_LAGS {
                sums[i] = s.fma(taps[i % PARITIES][m - i], value, sums[i]);
            }
        });
    });
    sums
}

/// Returns `N` consecutive rows of sixteen.
#[inline(always)]
fn rows_from<const N: usize>(of: &Aligned, row: usize) -> Option<&[Sixteen; N]> {
    of.as_slice().as_chunks::<LANES>().0.get(row..)?.first_chunk()
}

#[inline(always)]
fn rows_from_mut<const N: usize>(of: &mut Aligned, row: usize) -> Option<&mut [Sixteen; N]> {
    of.as_mut_slice().as_chunks_mut::<LANES>().0.get_mut(row..)?.first_chunk_mut()
}

/// Loads the samples of each block from `start` on; all blocks must be long enough.
#[inline(always)]
fn whole_pairs<S: Simd>(s: S, blocks: &[&[u16]; LANES], start: usize) -> [S::V; LANES] {
    let mut pairs = [s.splat(0.0); LANES];
    unrolled!(w in [0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15] if LANES => {
        let samples = blocks[w].get(start..).and_then(|rest| rest.first_chunk());
        pairs[w] = s.pairs(samples.unwrap_or(&[0; PAIRS]));
    });
    pairs
}

/// Loads the samples of blocks that may end earlier; zeros after the last sample.
#[inline(always)]
fn padded_pairs<S: Simd>(s: S, blocks: &[&[u16]; LANES], start: usize) -> [S::V; LANES] {
    let mut pairs = [s.splat(0.0); LANES];
    for w in 0..LANES {
        pairs[w] = s.some_pairs(blocks[w].get(start..).unwrap_or_default());
    }
    pairs
}

#[cfg(test)]
mod tests;
