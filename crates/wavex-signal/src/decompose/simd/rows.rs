//! Waveforms as rows: the whitened residuals of a whole batch.
//!
//! The pulses found so far are subtracted. A row belongs to one waveform, and every operation on it
//! uses that row alone.

use wavex_simd::{LANES, Simd, Sixteen};

use super::layout::{ROW, Values, sixteen};
use super::level_tables::LevelTables;
use super::tables::{Aligned, Tables};
use super::template::{Lookup, VECTORS, leaves_block, tail, template, weights};

/// Zeros before the first sample.
pub(super) const FRONT: usize = 32;
/// Zeros after the last sample, read by the frame of a pulse at the end of the block.
const BACK: usize = 80;
/// Samples filtered at a time.
pub(super) const CHUNK: usize = 64;
/// Waveforms per batch: enough for full vectors in rare kinds of fits.
pub(super) const BATCH: usize = 2048;
/// Waveforms detected at a time; also the batch size without refinement.
///
/// Without refinement few fits are queued. Their data stay in the cache.
pub(super) const FAST_BATCH: usize = 512;
/// Longest blocks in full batches, samples; longer ones use smaller batches to save memory.
const WHOLE_BATCH_SAMPLES: usize = 256;
/// Smallest batch of long blocks.
const LEAST_BATCH: usize = 128;
/// Rows of residuals: those of the batch, as many for trials, and an empty one.
///
/// The empty row is for lanes without work.
const RESIDUALS: usize = 2 * BATCH + 1;
/// Index of the empty row.
pub(super) const EMPTY: usize = 2 * BATCH;

/// Writes sixteen values if the row has room for them.
#[inline(always)]
fn put<S: Simd>(s: S, value: S::V, row: &mut [f32], at: usize) {
    if let Some(to) = row.get_mut(at..).and_then(|from| from.first_chunk_mut()) {
        s.store(value, to);
    }
}

/// Buffers of one thread.
pub(super) struct Rows {
    stride: usize,
    capacity: usize,
    residual: Aligned,
    /// Number of samples in each row of `residual`.
    lengths: Vec<usize>,
    /// Number of samples that count in chi-square.
    counted: Vec<usize>,
}

impl Rows {
    /// Creates buffers for blocks of up to `samples` samples.
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

    /// Number of samples that a row can hold.
    pub(super) fn capacity(&self) -> usize {
        self.capacity
    }

    /// Batch size for blocks of this length.
    pub(super) fn batch(&self) -> usize {
        (BATCH * WHOLE_BATCH_SAMPLES / self.capacity.max(1)).clamp(LEAST_BATCH, BATCH)
    }

    /// Number of samples of the waveform in a row.
    #[inline(always)]
    pub(super) fn length(&self, row: usize) -> usize {
        self.lengths.get(row).copied().unwrap_or(0)
    }

    /// Number of samples that count in chi-square of a row.
    #[inline(always)]
    pub(super) fn counted(&self, row: usize) -> usize {
        self.counted.get(row).copied().unwrap_or(0)
    }

    /// Starts a waveform of `length` samples in a row and clears the values after it.
    ///
    /// The caller must write all its samples.
    #[inline(always)]
    pub(super) fn begin(&mut self, row: usize, length: usize) {
        let before = std::mem::replace(&mut self.lengths[row], length);
        // The row may hold the end of a longer waveform.
        if length < before {
            let row = &mut self.residual.as_mut_slice()[row * self.stride..][..self.stride];
            row[FRONT + length..FRONT + before].fill(0.0);
        }
        self.counted[row] = length;
    }

    /// Writes sixteen whitened samples from `sample` on in consecutive rows.
    ///
    /// Rows that end before `sample` are skipped.
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

    /// Clears the values after the last sample in consecutive rows.
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

    /// Returns sixteen residuals from `sample` on; zeros after the last.
    #[inline(always)]
    pub(super) fn residual_sixteen(&self, row: usize, sample: usize) -> &Sixteen {
        sixteen(self.residual_row(row), FRONT + sample)
    }

    /// Returns the residuals of a row; sample 0 is at `FRONT`.
    #[inline(always)]
    pub(super) fn residual_row(&self, row: usize) -> &[f32] {
        &self.residual.as_slice()[row * self.stride..][..self.stride]
    }

    /// Copies the residuals of one row to another.
    #[inline(always)]
    pub(super) fn copy(&mut self, from: usize, to: usize) {
        let (from_at, to_at) = (from * self.stride, to * self.stride);
        self.residual.as_mut_slice().copy_within(from_at..from_at + self.stride, to_at);
        self.lengths[to] = self.lengths[from];
        self.counted[to] = self.counted[from];
    }

    /// Adds `sign` times a pulse, including its tail, to a row.
    #[inline(always)]
    pub(super) fn add<S: Simd, const STRONG: bool>(
        &mut self,
        s: S,
        tables: &Tables,
        row: usize,
        lookup: &Lookup,
        sign: f32,
    ) {
        let n = self.lengths[row];
        let to = &mut self.residual.as_mut_slice()[row * self.stride..][..self.stride];
        // A pulse reaches the first samples: from now on, they only predict the others.
        if lookup.first < tables.order as i32 && self.counted[row] == n {
            self.counted[row] = n.saturating_sub(tables.order);
            to[FRONT..FRONT + tables.order.min(n)].fill(0.0);
        }
        let inside = !leaves_block(lookup.first, ROW, tables.order, n);
        let factor = s.splat(sign * lookup.height);
        for c in 0..VECTORS {
            let first = lookup.first + (c * LANES) as i32;
            let at = FRONT.saturating_add_signed(first as isize);
            let mut values = template::<S, STRONG>(s, tables, lookup, LANES + c * LANES).pulse;
            if !inside {
                values = s.mul(values, weights(s, first, tables.order, n));
            }
            put(s, s.fma(factor, values, s.load(sixteen(to, at))), to, at);
        }
        let mut first = lookup.first + ROW as i32;
        let mut from = 0;
        while first < n as i32 {
            let at = FRONT.saturating_add_signed(first as isize);
            let mut values = s.mul(s.splat(sign), tail::<S, STRONG>(s, tables, lookup, from));
            if first < tables.order as i32 || first + LANES as i32 > n as i32 {
                values = s.mul(values, weights(s, first, tables.order, n));
            }
            put(s, s.add(values, s.load(sixteen(to, at))), to, at);
            first += LANES as i32;
            from += LANES as i32;
        }
    }

    /// Subtracts a small change of a pulse's values from a row, to first order.
    ///
    /// The pulse itself must already be subtracted, so that samples in which it does not count are
    /// 0.
    #[inline(always)]
    pub(super) fn take_change_off<S: Simd, const STRONG: bool>(
        &mut self,
        s: S,
        tables: &Tables,
        row: usize,
        lookup: &Lookup,
        [height, position, width]: Values,
    ) {
        let n = self.lengths[row];
        let to = &mut self.residual.as_mut_slice()[row * self.stride..][..self.stride];
        let inside = !leaves_block(lookup.first, ROW, tables.order, n);
        let [by_height, by_time, by_width] =
            [height, -lookup.height * position, lookup.height * width].map(|change| s.splat(change));
        for c in 0..VECTORS {
            let first = lookup.first + (c * LANES) as i32;
            let at = FRONT.saturating_add_signed(first as isize);
            let shape = template::<S, STRONG>(s, tables, lookup, LANES + c * LANES);
            let mut change = s.mul(by_height, shape.by_height);
            change = s.fma(by_time, shape.by_time, change);
            change = s.fma(by_width, shape.by_width, change);
            if !inside {
                change = s.mul(change, weights(s, first, tables.order, n));
            }
            put(s, s.sub(s.load(sixteen(to, at)), change), to, at);
        }
        let factor = s.splat(height / lookup.height);
        let mut first = lookup.first + ROW as i32;
        let mut from = 0;
        while first < n as i32 {
            let at = FRONT.saturating_add_signed(first as isize);
            let mut values = s.mul(factor, tail::<S, STRONG>(s, tables, lookup, from));
            if first < tables.order as i32 || first + LANES as i32 > n as i32 {
                values = s.mul(values, weights(s, first, tables.order, n));
            }
            put(s, s.sub(s.load(sixteen(to, at)), values), to, at);
            first += LANES as i32;
            from += LANES as i32;
        }
    }

    /// Subtracts `level_dn` times the whitened constant from a row.
    ///
    /// Returns the squares of the row, to be summed.
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

    /// Sums of the residuals of sixteen rows, and of their squares.
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

    /// Sums of the squared residuals of sixteen rows.
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
