//! Waveforms as rows: what of the whitened samples the pulses found so far leave, for a whole batch.
//!
//! A row belongs to one waveform, and every operation on it looks at that row alone.

use super::fitted::Values;
use super::level::LevelTables;
use super::tables::{Aligned, ROW, Tables};
use super::template::{Site, VECTORS, leaves_block, tail, template, weights};
use super::vector::{LANES, Simd, Sixteen};

/// Zeros before the first sample.
pub(super) const FRONT: usize = 32;
/// Zeros behind the last sample: what a frame of a pulse at the block's end still reads.
const BACK: usize = 80;
/// Samples that are filtered at a time.
pub(super) const CHUNK: usize = 64;
/// Waveforms of a batch: enough for full vectors of the rarer fits.
pub(super) const BATCH: usize = 2048;
/// Waveforms that are detected at a time, and a whole batch where nothing is refined and few fits wait for others: what these
/// need stays in the cache.
pub(super) const FAST_BATCH: usize = 512;
/// Blocks up to so many samples come in whole batches, longer ones in smaller ones, for the memory's sake …
const WHOLE_BATCH_SAMPLES: usize = 256;
/// … but not in smaller ones than this.
const LEAST_BATCH: usize = 128;
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
    residual: Aligned,
    /// Samples of each row of `residual`.
    lengths: Vec<usize>,
    /// Those of them that chi-square is the sum over.
    counted: Vec<usize>,
}

impl Rows {
    /// For blocks of up to `samples` samples.
    pub(super) fn new(samples: usize) -> Rows {
        let capacity = samples.div_ceil(CHUNK).max(1) * CHUNK;
        let stride = FRONT + capacity + BACK;
        let mut lengths = vec![0; RESIDUALS];
        lengths[EMPTY] = CHUNK;
        Rows {
            stride,
            capacity,
            residual: Aligned::zeros(stride * RESIDUALS),
            lengths,
            counted: vec![0; RESIDUALS],
        }
    }

    /// Samples that a row can hold.
    pub(super) fn capacity(&self) -> usize {
        self.capacity
    }

    /// Waveforms of a batch of blocks this long.
    pub(super) fn batch(&self) -> usize {
        (BATCH * WHOLE_BATCH_SAMPLES / self.capacity.max(1)).clamp(LEAST_BATCH, BATCH)
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

    /// Begins a waveform of so many samples, all of which are to be written, in a residual row: nothing stands behind them.
    #[inline(always)]
    pub(super) fn begin(&mut self, row: usize, length: usize) {
        let before = std::mem::replace(&mut self.lengths[row], length);
        if length < before {
            let row = &mut self.residual.as_mut_slice()[row * self.stride..][..self.stride];
            row[FRONT + length..FRONT + before].fill(0.0);
        }
        self.counted[row] = length;
    }

    /// Writes sixteen whitened samples of consecutive residuals, each from `sample` on, where they are that long.
    #[inline(always)]
    pub(super) fn put_residuals<S: Simd>(
        &mut self,
        s: S,
        values: &[S::V; LANES],
        first: usize,
        sample: usize,
        lengths: &[usize; LANES],
        count: usize,
    ) {
        let at = first * self.stride + FRONT + sample;
        let rows = self.residual.as_mut_slice().get_mut(at..).unwrap_or_default();
        unrolled!(w in [0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15] if LANES => {
            if w < count && sample < lengths[w] {
                put(s, values[w], rows, w * self.stride);
            }
        });
    }

    /// Empties what stands behind the last sample of consecutive residuals.
    #[inline(always)]
    pub(super) fn end_residuals<S: Simd>(
        &mut self,
        s: S,
        first: usize,
        lengths: &[usize; LANES],
        count: usize,
    ) {
        let rows = self.residual.as_mut_slice().get_mut(first * self.stride..).unwrap_or_default();
        for (w, row) in rows.chunks_exact_mut(self.stride).enumerate().take(count.min(LANES)) {
            put(s, s.splat(0.0), row, FRONT + lengths[w]);
        }
    }

    /// Sixteen samples of a residual from `sample` on; zeros behind the last.
    #[inline(always)]
    pub(super) fn residual_sixteen(&self, row: usize, sample: usize) -> &Sixteen {
        sixteen(self.residual_row(row), FRONT + sample)
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

    /// Takes a small change of a pulse's height, position and width off a residual, to first order. The pulse itself has been
    /// taken off, so that samples that it does not count in are 0.
    #[inline(always)]
    pub(super) fn take_change_off<S: Simd, const STRONG: bool>(
        &mut self,
        s: S,
        tables: &Tables,
        row: usize,
        site: &Site,
        [height, position, width]: Values,
    ) {
        let n = self.lengths[row];
        let to = &mut self.residual.as_mut_slice()[row * self.stride..][..self.stride];
        let inside = !leaves_block(site.first, ROW, tables.order, n);
        let [by_height, by_time, by_width] =
            [height, -site.height * position, site.height * width].map(|change| s.splat(change));
        for c in 0..VECTORS {
            let first = site.first + (c * LANES) as i32;
            let at = FRONT.saturating_add_signed(first as isize);
            let shape = template::<S, STRONG>(s, tables, site, LANES + c * LANES);
            let mut change = s.mul(by_height, shape.by_height);
            change = s.fma(by_time, shape.by_time, change);
            change = s.fma(by_width, shape.by_width, change);
            if !inside {
                change = s.mul(change, weights(s, first, tables.order, n));
            }
            put(s, s.sub(s.load(sixteen(to, at)), change), to, at);
        }
        let factor = s.splat(height / site.height);
        let mut first = site.first + ROW as i32;
        let mut from = 0;
        while first < n as i32 {
            let at = FRONT.saturating_add_signed(first as isize);
            let mut values = s.mul(factor, tail::<S, STRONG>(s, tables, site, from));
            if first < tables.order as i32 || first + LANES as i32 > n as i32 {
                values = s.mul(values, weights(s, first, tables.order, n));
            }
            put(s, s.sub(s.load(sixteen(to, at)), values), to, at);
            first += LANES as i32;
            from += LANES as i32;
        }
    }

    /// Takes so much of a constant, whitened, off a residual; returns its squares, to be summed.
    #[inline(always)]
    pub(super) fn take_level_off<S: Simd>(
        &mut self,
        s: S,
        level: &LevelTables,
        order: usize,
        row: usize,
        level_dn: f32,
    ) -> S::Half {
        let n = self.lengths[row];
        let is_begun = self.counted[row] == n;
        let to = &mut self.residual.as_mut_slice()[row * self.stride..][..self.stride];
        if is_begun {
            for (value, one) in to[FRONT..FRONT + order.min(n)].iter_mut().zip(level.begin()) {
                *value -= level_dn * one;
            }
        }
        let constant = s.splat(level_dn * level.steady);
        let mut sum = s.splat(0.0);
        for c in (0..n).step_by(LANES) {
            let mut value = s.load(sixteen(to, FRONT + c));
            if c < order || c + LANES > n {
                value = s.fnma(constant, weights(s, c as i32, order, n), value);
            } else {
                value = s.sub(value, constant);
            }
            sum = s.fma(value, value, sum);
            put(s, value, to, FRONT + c);
        }
        s.halved(sum)
    }

    /// Sums of sixteen residuals, and of their squares.
    #[inline(always)]
    pub(super) fn sums_and_squares<S: Simd>(&self, s: S, rows: &[usize; LANES]) -> [Sixteen; 2] {
        let none = s.halved(s.splat(0.0));
        let (mut sums, mut squares) = ([none; LANES], [none; LANES]);
        for (w, &row) in rows.iter().enumerate() {
            let (mut sum, mut square) = (s.splat(0.0), s.splat(0.0));
            let values = self.residual_row(row);
            for c in (0..self.lengths[row]).step_by(LANES) {
                let value = s.load(sixteen(values, FRONT + c));
                sum = s.add(sum, value);
                square = s.fma(value, value, square);
            }
            (sums[w], squares[w]) = (s.halved(sum), s.halved(square));
        }
        let mut out = [[0.0; LANES]; 2];
        s.store(s.sum_each(&sums), &mut out[0]);
        s.store(s.sum_each(&squares), &mut out[1]);
        out
    }

    /// Sums of squares of sixteen residuals.
    #[inline(always)]
    pub(super) fn chi_squares<S: Simd>(&self, s: S, rows: &[usize; LANES]) -> Sixteen {
        let mut sums = [s.halved(s.splat(0.0)); LANES];
        for (half, &row) in sums.iter_mut().zip(rows) {
            let mut sum = s.splat(0.0);
            let values = self.residual_row(row);
            for c in (0..self.lengths[row]).step_by(LANES) {
                let value = s.load(sixteen(values, FRONT + c));
                sum = s.fma(value, value, sum);
            }
            *half = s.halved(sum);
        }
        let mut out = [0.0; LANES];
        s.store(s.sum_each(&sums), &mut out);
        out
    }
}
