//! What the kernels look up: whitened templates over width and phase, their inverse Fisher matrices, the filters.

use super::spectrum::Spectrum;
use super::vector::{LANES, Sixteen};
use crate::kernels::noise::ArNoise;

/// Samples of a template row: from 9 before the peak's sample to 22 behind it.
pub(super) const ROW: usize = 32;
/// Row samples before the peak's.
pub(super) const BEFORE_PEAK: i32 = 9;
/// Table positions per sample.
pub(super) const PHASES: usize = 16;
/// Widths of the table.
pub(super) const KNOTS: usize = 64;
/// `ln` of the narrowest width ratio, 0.6.
pub(super) const U_MIN: f64 = -0.510_825_623_765_990_7;
/// `ln` of the widest width ratio, about 3.16.
pub(super) const U_MAX: f64 = 1.15;
/// Between knots.
pub(super) const U_STEP: f64 = (U_MAX - U_MIN) / (KNOTS - 1) as f64;
/// Templates per entry: `h, h_t, h_tt, h_u, h_uu, h_tu`.
pub(super) const TEMPLATES: usize = 6;
/// A row and the zeros behind it; those before the first row open the entry.
pub(super) const ROW_STRIDE: usize = ROW + LANES;
/// Values of one entry.
pub(super) const ENTRY: usize = LANES + TEMPLATES * ROW_STRIDE;
/// Highest order of the noise that the kernels whiten.
pub(super) const MAX_ORDER: usize = 4;
/// Lags of the matched filter behind the whitening filter, from 6 before the peak.
const FILTER_LAGS: usize = 14;
const FILTER_BEFORE: i32 = 6;
/// Taps of whitening and matched filter in one.
pub(super) const TAPS: usize = FILTER_LAGS + MAX_ORDER;
/// The first tap meets the sample this many before the position.
pub(super) const TAPS_BEFORE: usize = FILTER_BEFORE as usize + MAX_ORDER;
/// Widths of the bank, as knots: `first + k stride`.
pub(super) const BANK: usize = 6;
const BANK_FIRST: usize = 14;
const BANK_STRIDE: usize = 9;
/// Samples of the slow tail that the tables hold, behind the row.
pub(super) const TAIL: usize = 64;
/// Least share of a pulse's energy with which a position at the block's edge is searched (ALGORITHMS.md, S4).
const LEAST_ENERGY: f64 = 0.3;

/// Values that start on a cache line.
pub(super) struct Aligned {
    values: Vec<f32>,
    start: usize,
    length: usize,
}

impl Aligned {
    pub(super) fn zeros(length: usize) -> Aligned {
        let values = vec![0.0; length + LANES];
        // A start that is not aligned costs time, nothing else.
        let start = values.as_ptr().align_offset(64).min(LANES);
        Aligned { values, start, length }
    }

    #[inline(always)]
    pub(super) fn as_slice(&self) -> &[f32] {
        &self.values[self.start..self.start + self.length]
    }

    #[inline(always)]
    pub(super) fn as_mut_slice(&mut self) -> &mut [f32] {
        &mut self.values[self.start..self.start + self.length]
    }
}

/// Everything that depends on one channel's response and noise, for all threads.
///
/// 1.2 MB of templates; what one width uses, 19 KB, stays in the first-level cache.
pub struct Tables {
    entries: Aligned,
    /// Per entry the inverse Fisher matrix of a unit pulse, lower triangle: aa, aτ, ττ, au, τu, uu.
    inverse_fisher: Vec<[f32; 8]>,
    /// Per phase the six rows of the bank, each of unit energy.
    bank: Aligned,
    /// Inverse root of the energies of the bank's rows.
    pub(super) bank_scale: [f32; BANK],
    /// Per phase the whitened tail of the unwidened pulse, from sample `ROW` of the row on; zeros around.
    tail: Vec<[f32; TAIL + 2 * LANES]>,
    pub(super) taps: [f32; TAPS],
    /// What the statistic is multiplied with at the first positions of a block, and at the last.
    pub(super) leading: Sixteen,
    pub(super) trailing: Sixteen,
    /// Whitening: what the sample is multiplied with, then those before it.
    pub(super) whitening: [f32; MAX_ORDER + 1],
    pub(super) order: usize,
    /// The background by sample number modulo 4, for vectors that start at sample 0 to 3 modulo 4.
    pub(super) background: [Sixteen; 4],
}

impl Tables {
    /// Tables for a response, the noise of the samples (order at most 4) and the background by sample number modulo 4,
    /// in digitiser steps. `None` where the order is higher or the response's width is not between 1 and 8 samples:
    /// rows and filters are made for pulses of about 4 samples.
    pub fn new(response: &Spectrum, noise: &ArNoise, background_dn: [f64; 4]) -> Option<Tables> {
        let fwhm = response.fwhm_samples();
        if noise.order() > MAX_ORDER || !(1.0..=8.0).contains(&fwhm) {
            return None;
        }
        let whitened = response.whitened(noise);
        let variance = (fwhm / (8.0 * 2f64.ln()).sqrt()).powi(2);
        let mut whitening = [0.0; MAX_ORDER + 1];
        let scale = noise.innovation_variance().sqrt().recip();
        whitening[0] = scale as f32;
        for (tap, coefficient) in whitening[1..].iter_mut().zip(noise.coefficients()) {
            *tap = (-coefficient * scale) as f32;
        }
        let (taps, leading, trailing) = filter(response, &whitened, noise);
        let mut tables = Tables {
            entries: Aligned::zeros(KNOTS * PHASES * ENTRY),
            inverse_fisher: Vec::with_capacity(KNOTS * PHASES),
            bank: Aligned::zeros(PHASES * BANK * ROW),
            bank_scale: [0.0; BANK],
            tail: Vec::with_capacity(PHASES),
            taps: taps.map(|tap| tap as f32),
            leading,
            trailing,
            whitening,
            order: noise.order(),
            background: std::array::from_fn(|first| {
                std::array::from_fn(|lane| background_dn[(first + lane) % 4] as f32)
            }),
        };
        tables.fill_templates(&whitened, variance);
        tables.fill_bank();
        tables.fill_tail(&whitened);
        Some(tables)
    }

    /// The templates of a knot and phase: zeros, then rows with zeros behind each.
    #[inline(always)]
    pub(super) fn entry(&self, index: usize) -> &[f32; ENTRY] {
        const NOTHING: &[f32; ENTRY] = &[0.0; ENTRY];
        match self.entries.as_slice().get(index * ENTRY..) {
            Some(from) => from.first_chunk().unwrap_or(NOTHING),
            None => NOTHING,
        }
    }

    /// The inverse Fisher matrix of a unit pulse: aa, aτ, ττ, au, τu, uu; two values more make it a power of two.
    #[inline(always)]
    pub(super) fn inverse_fisher(&self, index: usize) -> [f32; 8] {
        self.inverse_fisher.get(index).copied().unwrap_or([0.0; 8])
    }

    /// The bank's rows at a phase.
    #[inline(always)]
    pub(super) fn bank(&self, phase: usize) -> &[f32; BANK * ROW] {
        const NOTHING: &[f32; BANK * ROW] = &[0.0; BANK * ROW];
        match self.bank.as_slice().get(phase * BANK * ROW..) {
            Some(from) => from.first_chunk().unwrap_or(NOTHING),
            None => NOTHING,
        }
    }

    /// `ln` of the bank's width ratios.
    pub(super) fn bank_width(k: usize) -> f64 {
        U_MIN + (BANK_FIRST + k * BANK_STRIDE) as f64 * U_STEP
    }

    /// The whitened slow tail of a unit pulse at a phase, from 23 samples behind the peak's sample to 86; 16 zeros
    /// before and behind. It begins where the row ends, so row and tail add up to the whole response.
    pub(super) fn tail(&self, phase: usize) -> &[f32; TAIL + 2 * LANES] {
        const NOTHING: &[f32; TAIL + 2 * LANES] = &[0.0; TAIL + 2 * LANES];
        self.tail.get(phase).unwrap_or(NOTHING)
    }

    fn fill_templates(&mut self, whitened: &Spectrum, v0: f64) {
        let mut derivatives = [[0.0; 5]; ROW];
        let entries = self.entries.as_mut_slice();
        for (index, entry) in entries.chunks_exact_mut(ENTRY).enumerate() {
            let u = U_MIN + (index / PHASES) as f64 * U_STEP;
            let scale = v0 * (2.0 * u).exp();
            let first = -f64::from(BEFORE_PEAK) - (index % PHASES) as f64 / PHASES as f64;
            whitened.derivatives_into(scale - v0, first, &mut derivatives);
            let mut fisher = [0.0; 6];
            for (k, &[h, t, tt, ttt, tttt]) in derivatives.iter().enumerate() {
                let values = [h, t, tt, scale * tt, 2.0 * scale * tt + scale * scale * tttt, scale * ttt];
                for (template, value) in values.iter().enumerate() {
                    entry[LANES + template * ROW_STRIDE + k] = *value as f32;
                }
                let row = [h, -t, scale * tt];
                for (f, (i, j)) in fisher.iter_mut().zip(LOWER) {
                    *f += row[i] * row[j];
                }
            }
            self.inverse_fisher.push(inverse(fisher));
        }
    }

    fn fill_bank(&mut self) {
        for phase in 0..PHASES {
            for k in 0..BANK {
                let entry = *self.entry((BANK_FIRST + k * BANK_STRIDE) * PHASES + phase);
                let row = &entry[LANES..LANES + ROW];
                let scale = row.iter().map(|&v| f64::from(v).powi(2)).sum::<f64>().sqrt().recip();
                let at = (phase * BANK + k) * ROW;
                for (out, &value) in self.bank.as_mut_slice()[at..at + ROW].iter_mut().zip(row) {
                    *out = (f64::from(value) * scale) as f32;
                }
                // The energy hardly depends on the phase: the middle one stands for all.
                if phase == PHASES / 2 {
                    self.bank_scale[k] = scale as f32;
                }
            }
        }
    }

    fn fill_tail(&mut self, whitened: &Spectrum) {
        let mut derivatives = [[0.0; 5]; TAIL];
        for phase in 0..PHASES {
            let first = ROW as f64 - f64::from(BEFORE_PEAK) - phase as f64 / PHASES as f64;
            whitened.derivatives_into(0.0, first, &mut derivatives);
            let mut row = [0.0; TAIL + 2 * LANES];
            for (out, values) in row[LANES..].iter_mut().zip(&derivatives) {
                *out = values[0] as f32;
            }
            self.tail.push(row);
        }
    }
}

/// Lower triangle of a 3 x 3 matrix, row by row.
const LOWER: [(usize, usize); 6] = [(0, 0), (1, 0), (1, 1), (2, 0), (2, 1), (2, 2)];

fn inverse(m: [f64; 6]) -> [f32; 8] {
    let [aa, at, tt, au, tu, uu] = m;
    let cofactors = [
        tt * uu - tu * tu,
        au * tu - at * uu,
        aa * uu - au * au,
        at * tu - au * tt,
        at * au - aa * tu,
        aa * tt - at * at,
    ];
    let determinant = aa * cofactors[0] + at * cofactors[1] + au * cofactors[3];
    let mut out = [0.0; 8];
    for (out, cofactor) in out.iter_mut().zip(cofactors) {
        *out = (cofactor / determinant) as f32;
    }
    out
}

/// Taps of whitening and matched filter in one, of unit output variance, and what makes it so at a block's edges, where
/// samples are missing (taken as background): the inverse standard deviation, or 0 where too little energy is left.
fn filter(response: &Spectrum, whitened: &Spectrum, noise: &ArNoise) -> ([f64; TAPS], Sixteen, Sixteen) {
    let mut template = [[0.0; 5]; FILTER_LAGS];
    whitened.derivatives_into(0.0, -f64::from(FILTER_BEFORE), &mut template);
    let energy: f64 = template.iter().map(|v| v[0] * v[0]).sum();
    let scale = (energy * noise.innovation_variance()).sqrt().recip();
    let mut taps = [0.0; TAPS];
    for (i, values) in template.iter().enumerate() {
        taps[i + MAX_ORDER] += scale * values[0];
        for (lag, coefficient) in noise.coefficients().iter().enumerate() {
            taps[i + MAX_ORDER - lag - 1] -= scale * coefficient * values[0];
        }
    }
    let mut lags = [0.0; TAPS];
    noise.autocovariance_into(&mut lags);
    let mut pulse = [[0.0; 5]; TAPS];
    response.derivatives_into(0.0, -(TAPS_BEFORE as f64), &mut pulse);
    let part = |used: std::ops::Range<usize>| {
        let signal: f64 = used.clone().map(|i| taps[i] * pulse[i][0]).sum();
        let pairs = used.clone().flat_map(|i| used.clone().map(move |j| (i, j)));
        let variance: f64 = pairs.map(|(i, j)| taps[i] * taps[j] * lags[i.abs_diff(j)]).sum();
        (signal, variance)
    };
    let whole = part(0..TAPS).0.powi(2);
    let gain = |(signal, variance): (f64, f64)| {
        let enough = signal > 0.0 && signal * signal >= LEAST_ENERGY * whole * variance;
        if enough { variance.sqrt().recip() as f32 } else { 0.0 }
    };
    let behind = TAPS - TAPS_BEFORE;
    let leading = std::array::from_fn(|k| match TAPS_BEFORE.saturating_sub(k) {
        0 => 1.0,
        missing => gain(part(missing..TAPS)),
    });
    let trailing = std::array::from_fn(|k| match behind.saturating_sub(LANES - k) {
        0 => 1.0,
        missing => gain(part(0..TAPS - missing)),
    });
    (taps, leading, trailing)
}
