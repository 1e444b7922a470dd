//! Sixteen waveforms as rows: samples without background, whitened samples, the detection statistic.
//!
//! A row belongs to one waveform, and every operation on it looks at that row alone.

use super::tables::{Aligned, MAX_ORDER, TAPS, TAPS_BEFORE, Tables};
use super::vector::{LANES, Simd, Sixteen};

/// Zeros before the first sample.
pub(super) const FRONT: usize = 32;
/// Zeros behind the last sample: what a window of a pulse at the block's end still reads.
const BACK: usize = 80;
/// Samples that are filtered at a time.
const CHUNK: usize = 64;

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
    pub(super) whitened: Aligned,
    statistic: Aligned,
    /// Samples of each waveform.
    pub(super) lengths: [usize; LANES],
    /// Samples that the rows held before: what lies beyond is zero.
    before: [usize; LANES],
    gain: Aligned,
    gain_length: usize,
}

impl Rows {
    /// For blocks of up to `capacity` samples.
    pub(super) fn new(capacity: usize) -> Rows {
        let capacity = capacity.div_ceil(CHUNK).max(1) * CHUNK;
        let stride = FRONT + capacity + BACK;
        Rows {
            stride,
            capacity,
            samples: Aligned::zeros(stride * LANES),
            whitened: Aligned::zeros(stride * LANES),
            statistic: Aligned::zeros(stride * LANES),
            lengths: [0; LANES],
            before: [0; LANES],
            gain: Aligned::zeros(capacity + LANES),
            gain_length: 0,
        }
    }

    /// Where a waveform's row starts, its first sample `FRONT` behind.
    #[inline(always)]
    pub(super) fn row_start(&self, waveform: usize) -> usize {
        waveform * self.stride
    }

    /// Takes up to sixteen blocks, minus the background. What is beyond the capacity is left out; missing blocks are
    /// empty.
    #[inline(always)]
    pub(super) fn load<S: Simd>(&mut self, s: S, tables: &Tables, blocks: &[&[u16]]) {
        for w in 0..LANES {
            let block = blocks.get(w).copied().unwrap_or_default();
            let block = block.get(..self.capacity).unwrap_or(block);
            self.lengths[w] = block.len();
            if self.before[w] != block.len() {
                self.before[w] = block.len();
                self.samples.as_mut_slice()[w * self.stride..][..self.stride].fill(0.0);
                self.whitened.as_mut_slice()[w * self.stride..][..self.stride].fill(0.0);
            }
            let row = &mut self.samples.as_mut_slice()[w * self.stride..][..self.stride];
            load_row(s, &tables.background, block, row);
        }
    }

    /// Whitens the rows. The first samples, as many as the noise's order, only predict; they and what lies beyond the
    /// block become 0.
    #[inline(always)]
    pub(super) fn whiten<S: Simd>(&mut self, s: S, tables: &Tables, count: usize) {
        for w in 0..count.min(LANES) {
            let n = self.lengths[w];
            let from = &self.samples.as_slice()[w * self.stride..][..self.stride];
            let to = &mut self.whitened.as_mut_slice()[w * self.stride..][..self.stride];
            whiten_row(s, tables, n, from, to);
        }
    }

    /// Computes the statistic of every position of the rows.
    #[inline(always)]
    pub(super) fn filter<S: Simd>(&mut self, s: S, tables: &Tables, count: usize) {
        for w in 0..count.min(LANES) {
            let n = self.lengths[w];
            if n != self.gain_length {
                self.set_gain(tables, n);
            }
            let from = &self.samples.as_slice()[w * self.stride..][..self.stride];
            let to = &mut self.statistic.as_mut_slice()[w * self.stride..][..self.stride];
            for c in (0..n).step_by(CHUNK) {
                filter_chunk(s, &tables.taps, self.gain.as_slice(), c, from, to);
            }
        }
    }

    /// The positions `c` to `c + 63` of a waveform that are local maxima of at least the threshold, one bit each.
    #[inline(always)]
    pub(super) fn maxima<S: Simd>(&self, s: S, waveform: usize, c: usize, threshold: S::V) -> u64 {
        let row = self.statistic_row(waveform);
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
    pub(super) fn statistic_row(&self, waveform: usize) -> &[f32] {
        &self.statistic.as_slice()[waveform * self.stride..][..self.stride]
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
    for value in to[FRONT..].iter_mut().take(tables.order) {
        *value = 0.0;
    }
}

#[inline(always)]
fn filter_chunk<S: Simd>(s: S, taps: &[f32; TAPS], gain: &[f32], c: usize, from: &[f32], to: &mut [f32]) {
    const REACH: usize = CHUNK + 2 * LANES;
    let Some(window) = from.get(FRONT + c - TAPS_BEFORE..).and_then(|row| row.first_chunk::<REACH>()) else {
        return;
    };
    let mut sums = [s.splat(0.0); CHUNK / LANES];
    for (k, &tap) in taps.iter().enumerate() {
        let tap = s.splat(tap);
        for (q, sum) in sums.iter_mut().enumerate() {
            *sum = s.fma(tap, s.load(sixteen(window, k + q * LANES)), *sum);
        }
    }
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
