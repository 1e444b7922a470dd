//! Waveforms as rows: samples without background and the detection statistic for sixteen at a time, and what of the
//! whitened samples the pulses found so far leave, for a whole batch.
//!
//! A row belongs to one waveform, and every operation on it looks at that row alone.

use super::tables::{Aligned, FILTER_BEFORE, FILTER_LAGS, MAX_ORDER, ROW, TAPS, TAPS_BEFORE, Tables};
use super::template::{Site, VECTORS, leaves_block, tail, template, weights};
use super::vector::{LANES, Simd, Sixteen};

/// Zeros before the first sample.
pub(super) const FRONT: usize = 32;
/// Zeros behind the last sample: what a frame of a pulse at the block's end still reads.
const BACK: usize = 80;
/// Samples that are filtered at a time.
pub(super) const CHUNK: usize = 64;
/// Waveforms of a batch: enough for full vectors of the rarer fits, and rows that stay in the second-level cache.
pub(super) const BATCH: usize = 512;
/// Rows of residuals: the batch's, as many for trials, and one that stays empty, for lanes without work.
const RESIDUALS: usize = 2 * BATCH + 1;
/// The row that stays empty.
pub(super) const EMPTY: usize = 2 * BATCH;

/// The sixteen values from `at` on; zeros where the row has not that many.
#[inline(always)]
pub(super) fn sixteen(row: &[f32], at: usize) -> &Sixteen {
    match row.get(at..) {
        Some(from) => from.first_chunk().unwrap_or(&[0.0; LANES]),
        None => &[0.0; LANES],
    }
}

/// Writes sixteen values where the row has room for them.
#[inline(always)]
fn put<S: Simd>(s: S, value: S::V, row: &mut [f32], at: usize) {
    if let Some(to) = row.get_mut(at..).and_then(|from| from.first_chunk_mut()) {
        s.store(value, to);
    }
}

/// The scratch space of one thread.
pub(super) struct Rows {
    stride: usize,
    capacity: usize,
    samples: Aligned,
    statistic: Aligned,
    /// Samples that the rows of `samples` held before: what lies beyond is zero.
    before: [usize; LANES],
    residual: Aligned,
    /// Samples of each row of `residual`.
    lengths: [usize; RESIDUALS],
    /// Those of them that chi-square is the sum over.
    counted: [usize; RESIDUALS],
    gain: Aligned,
    gain_length: usize,
}

impl Rows {
    /// For blocks of up to `samples` samples.
    pub(super) fn new(samples: usize) -> Rows {
        let capacity = samples.div_ceil(CHUNK).max(1) * CHUNK;
        let stride = FRONT + capacity + BACK;
        let mut lengths = [0; RESIDUALS];
        lengths[EMPTY] = CHUNK;
        Rows {
            stride,
            capacity,
            samples: Aligned::zeros(stride * LANES),
            statistic: Aligned::zeros(stride * LANES),
            before: [0; LANES],
            residual: Aligned::zeros(stride * RESIDUALS),
            lengths,
            counted: [0; RESIDUALS],
            gain: Aligned::zeros(capacity + LANES),
            gain_length: 0,
        }
    }

    /// Samples that a row can hold.
    pub(super) fn capacity(&self) -> usize {
        self.capacity
    }

    /// Samples of the waveform in a row.
    #[inline(always)]
    pub(super) fn length(&self, row: usize) -> usize {
        self.lengths.get(row).copied().unwrap_or(0)
    }

    /// Samples that chi-square of a row is the sum over.
    #[inline(always)]
    pub(super) fn counted(&self, row: usize) -> usize {
        self.counted.get(row).copied().unwrap_or(0)
    }

    /// Takes up to sixteen blocks of at most [`Rows::capacity`] samples, minus the background; missing blocks are empty.
    #[inline(always)]
    pub(super) fn load<S: Simd>(&mut self, s: S, tables: &Tables, blocks: &[&[u16]]) {
        for w in 0..LANES {
            let block = blocks.get(w).copied().unwrap_or_default();
            let block = block.get(..self.capacity).unwrap_or(block);
            let row = &mut self.samples.as_mut_slice()[w * self.stride..][..self.stride];
            if self.before[w] != block.len() {
                self.before[w] = block.len();
                row.fill(0.0);
            }
            load_row(s, &tables.background, block, row);
        }
    }

    /// Computes the statistic of every position of the rows that are loaded.
    #[inline(always)]
    pub(super) fn filter<S: Simd>(&mut self, s: S, tables: &Tables, count: usize) {
        for w in 0..count.min(LANES) {
            let n = self.before[w];
            if n != self.gain_length {
                self.set_gain(tables, n);
            }
            let from = &self.samples.as_slice()[w * self.stride..][..self.stride];
            let to = &mut self.statistic.as_mut_slice()[w * self.stride..][..self.stride];
            for c in (0..n).step_by(CHUNK) {
                filter_chunk::<S, TAPS, TAPS_BEFORE>(s, &tables.taps, self.gain.as_slice(), c, from, to);
            }
        }
    }

    /// Whitens the rows that are loaded into the residuals from row `first` on. The first samples, as many as the noise's
    /// order, have a whitening of their own, in which pulses are not taken off: they count as long as no pulse reaches them.
    #[inline(always)]
    pub(super) fn whiten<S: Simd>(&mut self, s: S, tables: &Tables, count: usize, first: usize) {
        for w in 0..count.min(LANES) {
            let n = self.before[w];
            let from = &self.samples.as_slice()[w * self.stride..][..self.stride];
            let to = &mut self.residual.as_mut_slice()[(first + w) * self.stride..][..self.stride];
            if self.lengths[first + w] != n {
                self.lengths[first + w] = n;
                to.fill(0.0);
            }
            self.counted[first + w] = n;
            whiten_row(s, tables, n, from, to);
        }
    }

    /// Computes the statistic of a residual's positions, in the first row of statistics.
    #[inline(always)]
    pub(super) fn filter_residual<S: Simd>(&mut self, s: S, tables: &Tables, row: usize) {
        let n = self.lengths[row];
        if n != self.gain_length {
            self.set_gain(tables, n);
        }
        let from = &self.residual.as_slice()[row * self.stride..][..self.stride];
        let to = &mut self.statistic.as_mut_slice()[..self.stride];
        for c in (0..n).step_by(CHUNK) {
            const BEFORE: usize = FILTER_BEFORE as usize;
            filter_chunk::<S, FILTER_LAGS, BEFORE>(s, &tables.matched, self.gain.as_slice(), c, from, to);
        }
    }

    /// The positions `c` to `c + 63` of a row of statistics that are local maxima of at least the threshold, one bit each.
    #[inline(always)]
    pub(super) fn maxima<S: Simd>(&self, s: S, lane: usize, c: usize, threshold: S::V) -> u64 {
        let row = self.statistic_row(lane);
        let mut bits = 0;
        for q in (0..CHUNK).step_by(LANES) {
            let at = FRONT + c + q;
            let centre = s.load(sixteen(row, at));
            let mask = s.ge(centre, threshold)
                & s.gt(centre, s.load(sixteen(row, at - 1)))
                & s.ge(centre, s.load(sixteen(row, at + 1)));
            bits |= u64::from(mask) << q;
        }
        bits
    }

    /// The statistic, position 0 at `FRONT`.
    #[inline(always)]
    pub(super) fn statistic_row(&self, lane: usize) -> &[f32] {
        &self.statistic.as_slice()[lane * self.stride..][..self.stride]
    }

    /// What the pulses leave of a row, sample 0 at `FRONT`.
    #[inline(always)]
    pub(super) fn residual_row(&self, row: usize) -> &[f32] {
        &self.residual.as_slice()[row * self.stride..][..self.stride]
    }

    /// Copies one residual to another row.
    #[inline(always)]
    pub(super) fn copy(&mut self, from: usize, to: usize) {
        let (from_at, to_at) = (from * self.stride, to * self.stride);
        self.residual.as_mut_slice().copy_within(from_at..from_at + self.stride, to_at);
        self.lengths[to] = self.lengths[from];
        self.counted[to] = self.counted[from];
    }

    /// Adds `sign` times a pulse, its tail included, to a residual.
    #[inline(always)]
    pub(super) fn add<S: Simd, const STRONG: bool>(
        &mut self,
        s: S,
        tables: &Tables,
        row: usize,
        site: &Site,
        sign: f32,
    ) {
        let n = self.lengths[row];
        let to = &mut self.residual.as_mut_slice()[row * self.stride..][..self.stride];
        if site.first < tables.order as i32 && self.counted[row] == n {
            self.counted[row] = n.saturating_sub(tables.order);
            to[FRONT..FRONT + tables.order.min(n)].fill(0.0);
        }
        let inside = !leaves_block(site.first, ROW, tables.order, n);
        let factor = s.splat(sign * site.height);
        for c in 0..VECTORS {
            let first = site.first + (c * LANES) as i32;
            let at = FRONT.saturating_add_signed(first as isize);
            let mut values = template::<S, STRONG>(s, tables, site, LANES + c * LANES).pulse;
            if !inside {
                values = s.mul(values, weights(s, first, tables.order, n));
            }
            put(s, s.fma(factor, values, s.load(sixteen(to, at))), to, at);
        }
        let mut first = site.first + ROW as i32;
        let mut from = 0;
        while first < n as i32 {
            let at = FRONT.saturating_add_signed(first as isize);
            let mut values = s.mul(s.splat(sign), tail::<S, STRONG>(s, tables, site, from));
            if first < tables.order as i32 || first + LANES as i32 > n as i32 {
                values = s.mul(values, weights(s, first, tables.order, n));
            }
            put(s, s.add(values, s.load(sixteen(to, at))), to, at);
            first += LANES as i32;
            from += LANES as i32;
        }
    }

    /// Sums of squares of sixteen residuals.
    #[inline(always)]
    pub(super) fn chi_squares<S: Simd>(&self, s: S, rows: &[usize; LANES]) -> Sixteen {
        let mut sums = [s.splat(0.0); LANES];
        for (sum, &row) in sums.iter_mut().zip(rows) {
            let values = self.residual_row(row);
            for c in (0..self.lengths[row]).step_by(LANES) {
                let value = s.load(sixteen(values, FRONT + c));
                *sum = s.fma(value, value, *sum);
            }
        }
        let mut out = [0.0; LANES];
        s.store(s.sum_each(&sums), &mut out);
        out
    }

    /// 1 within a block of `n` samples, the edges' factors at its ends, 0 beyond.
    fn set_gain(&mut self, tables: &Tables, n: usize) {
        let gain = self.gain.as_mut_slice();
        gain.fill(0.0);
        gain[..n].fill(1.0);
        for (value, factor) in gain[..n].iter_mut().zip(tables.leading) {
            *value *= factor;
        }
        for (value, factor) in gain[..n].iter_mut().rev().zip(tables.trailing.iter().rev()) {
            *value *= factor;
        }
        self.gain_length = n;
    }
}

#[inline(always)]
fn load_row<S: Simd>(s: S, background: &[Sixteen; 4], block: &[u16], row: &mut [f32]) {
    let n = block.len();
    let even = s.load(&background[0]);
    for (c, samples) in block.as_chunks::<LANES>().0.iter().enumerate() {
        put(s, s.sub(s.widen(samples), even), row, FRONT + c * LANES);
    }
    if n.is_multiple_of(LANES) {
        return;
    }
    if let Some(last) = block.last_chunk::<LANES>() {
        let start = n - LANES;
        put(s, s.sub(s.widen(last), s.load(&background[start % 4])), row, FRONT + start);
    } else {
        for (k, &sample) in block.iter().enumerate() {
            row[FRONT + k] = f32::from(sample) - background[0][k];
        }
    }
}

#[inline(always)]
fn whiten_row<S: Simd>(s: S, tables: &Tables, n: usize, from: &[f32], to: &mut [f32]) {
    let taps = tables.whitening.map_lanes(s);
    for c in (0..n).step_by(LANES) {
        let at = FRONT + c;
        let mut value = s.mul(taps[0], s.load(sixteen(from, at)));
        for lag in 1..=MAX_ORDER {
            value = s.fma(taps[lag], s.load(sixteen(from, at - lag)), value);
        }
        put(s, value, to, at);
    }
    put(s, s.splat(0.0), to, FRONT + n);
    for k in 0..tables.order.min(n) {
        let mut value = 0.0;
        for j in 0..=k {
            value += tables.begin[k][j] * from[FRONT + j];
        }
        to[FRONT + k] = value;
    }
}

/// Sixty-four positions of the statistic: taps over what stands `BEFORE` samples before a position and later.
#[inline(always)]
fn filter_chunk<S: Simd, const N: usize, const BEFORE: usize>(
    s: S,
    taps: &[f32; N],
    gain: &[f32],
    c: usize,
    from: &[f32],
    to: &mut [f32],
) {
    const { assert!(BEFORE <= LANES && N <= LANES - BEFORE + 2 * LANES && N <= 18) };
    const REACH: usize = CHUNK + 3 * LANES;
    let Some(window) = from.get(FRONT + c - LANES..).and_then(|row| row.first_chunk::<REACH>()) else {
        return;
    };
    let mut values = [s.splat(0.0); REACH / LANES];
    for (q, value) in values.iter_mut().enumerate() {
        *value = s.load(sixteen(window, q * LANES));
    }
    let mut sums = [s.splat(0.0); CHUNK / LANES];
    unrolled!(k in [0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17] if N => {
        let (vector, by) = ((LANES - BEFORE + k) / LANES, (LANES - BEFORE + k) % LANES);
        let tap = s.splat(taps[k]);
        unrolled!(q in [0 1 2 3] if CHUNK / LANES => {
            let at = (q + vector) * LANES;
            if let Some(held) = window.get(at..).and_then(|rest| rest.first_chunk()) {
                let value = s.slide(values[q + vector], values[q + vector + 1], by, held);
                sums[q] = s.fma(tap, value, sums[q]);
            }
        });
    });
    for (q, sum) in sums.iter().enumerate() {
        let at = c + q * LANES;
        put(s, s.mul(*sum, s.load(sixteen(gain, at))), to, FRONT + at);
    }
}

/// Each value in all lanes.
trait MapLanes<const N: usize> {
    fn map_lanes<S: Simd>(&self, s: S) -> [S::V; N];
}

impl<const N: usize> MapLanes<N> for [f32; N] {
    #[inline(always)]
    fn map_lanes<S: Simd>(&self, s: S) -> [S::V; N] {
        let mut lanes = [s.splat(0.0); N];
        for (lane, &value) in lanes.iter_mut().zip(self) {
            *lane = s.splat(value);
        }
        lanes
    }
}
