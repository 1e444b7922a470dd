//! A pulse's whitened template and its derivatives, out of the tables.

use super::rows::sixteen;
use super::tables::{BEFORE_PEAK, ENTRY, KNOTS, PHASES, ROW, ROW_STRIDE, U_MAX, U_MIN, U_STEP};
use super::vector::{LANES, Simd, Sixteen};

/// Sixteen pulses, one per waveform: amplitude, position and `ln` of the width ratio.
#[derive(Clone, Copy)]
pub(super) struct Pulses<V> {
    pub(super) amplitude: V,
    pub(super) position: V,
    pub(super) width: V,
}

/// Positions are kept this many samples around the block.
const OUTSIDE: f32 = 8.0;
/// Least share of its amplitude that an iteration leaves to a pulse.
const LEAST_LEFT: f32 = 0.2;

impl<V: Copy> Pulses<V> {
    /// The pulses after a step, within the limits of one iteration (ALGORITHMS.md, S6) and of the tables.
    #[inline(always)]
    pub(super) fn stepped<S: Simd<V = V>>(self, s: S, step: &[V], limits: [f32; 2], last: V) -> Pulses<V> {
        let next = Pulses {
            amplitude: s.max(s.add(self.amplitude, step[0]), s.mul(self.amplitude, s.splat(LEAST_LEFT))),
            position: s.add(self.position, bounded(s, step[1], limits[0])),
            width: s.add(self.width, bounded(s, step[2], limits[1])),
        };
        next.within(s, last)
    }

    /// The pulses within what the tables and rows hold; what is not a number becomes the lower bound.
    #[inline(always)]
    pub(super) fn within<S: Simd<V = V>>(self, s: S, last: V) -> Pulses<V> {
        let outside = s.splat(OUTSIDE);
        Pulses {
            amplitude: s.max(self.amplitude, s.splat(1e-6)),
            position: s.min(s.max(self.position, s.sub(s.splat(0.0), outside)), s.add(last, outside)),
            width: s.min(s.max(self.width, s.splat(U_MIN as f32)), s.splat(U_MAX as f32)),
        }
    }
}

/// The value, at most the limit either way.
#[inline(always)]
pub(super) fn bounded<S: Simd>(s: S, value: S::V, limit: f32) -> S::V {
    s.min(s.max(value, s.splat(-limit)), s.splat(limit))
}

/// Where the tables hold sixteen pulses, and how far the pulses are from there.
pub(super) struct Sites {
    /// Entry of knot and phase.
    pub(super) entry: [usize; LANES],
    /// Block sample of the row's first.
    pub(super) first: [i32; LANES],
    /// Table position minus the pulse's, samples.
    pub(super) late: Sixteen,
    /// The pulse's `ln` width minus the knot's.
    pub(super) wider: Sixteen,
    pub(super) amplitude: Sixteen,
}

impl Sites {
    /// The entries nearest to pulses that are [`Pulses::within`] the tables.
    #[inline(always)]
    pub(super) fn of<S: Simd>(s: S, pulses: &Pulses<S::V>) -> Sites {
        let phases = PHASES as f32;
        let above = s.sub(pulses.width, s.splat(U_MIN as f32));
        let knot = s.mul(above, s.splat(1.0 / U_STEP as f32));
        let phase = s.mul(pulses.position, s.splat(phases));
        let mut sites = Sites {
            entry: [0; LANES],
            first: [0; LANES],
            late: [0.0; LANES],
            wider: [0.0; LANES],
            amplitude: [0.0; LANES],
        };
        let rounded = s.round(phase);
        s.store(s.fma(rounded, s.splat(1.0 / phases), s.sub(s.splat(0.0), pulses.position)), &mut sites.late);
        s.store(s.fnma(s.round(knot), s.splat(U_STEP as f32), above), &mut sites.wider);
        s.store(pulses.amplitude, &mut sites.amplitude);
        let (mut knots, mut steps) = ([0; LANES], [0; LANES]);
        s.to_i32(knot, &mut knots);
        s.to_i32(phase, &mut steps);
        for w in 0..LANES {
            let knot = (knots[w].max(0) as usize).min(KNOTS - 1);
            sites.entry[w] = knot * PHASES + (steps[w] & (PHASES as i32 - 1)) as usize;
            sites.first[w] = steps[w].div_euclid(PHASES as i32) - BEFORE_PEAK;
        }
        sites
    }

    /// Whether any row of the first `count` reaches beyond the samples that count: those from `order` to the length.
    #[inline(always)]
    pub(super) fn at_edge(&self, frame: usize, order: usize, lengths: &[usize; LANES], count: usize) -> bool {
        let mut edge = false;
        for w in 0..count.min(LANES) {
            edge |= leaves_block(self.first[w], frame, order, lengths[w]);
        }
        edge
    }
}

/// Whether a frame reaches beyond the samples that count.
#[inline(always)]
pub(super) fn leaves_block(first: i32, frame: usize, order: usize, length: usize) -> bool {
    first < order as i32 || first + frame as i32 > length as i32
}

/// How many samples of a frame count.
#[inline(always)]
pub(super) fn counted(first: i32, frame: usize, order: usize, length: usize) -> i32 {
    ((first + frame as i32).min(length as i32) - first.max(order as i32)).max(0)
}

/// Sixteen samples of `h`, `h_t` and `h_u` at a pulse: second-order Taylor from its entry.
///
/// `at` counts from the row's first sample, from −16 to 32; beyond the row all three are 0. The error of
/// `h` is below 5e-5 of the peak from a width ratio of 0.9 up, below 4e-4 from 0.8 up.
#[inline(always)]
pub(super) fn template<S: Simd>(s: S, entry: &[f32; ENTRY], at: usize, late: S::V, wider: S::V) -> [S::V; 3] {
    let [h, t, tt, u, uu, tu] = [
        s.load(sixteen(entry, at)),
        s.load(sixteen(entry, at + ROW_STRIDE)),
        s.load(sixteen(entry, at + 2 * ROW_STRIDE)),
        s.load(sixteen(entry, at + 3 * ROW_STRIDE)),
        s.load(sixteen(entry, at + 4 * ROW_STRIDE)),
        s.load(sixteen(entry, at + 5 * ROW_STRIDE)),
    ];
    let half = s.splat(0.5);
    let h_t = s.fma(wider, tu, s.fma(late, tt, t));
    let h_u = s.fma(late, tu, s.fma(wider, uu, u));
    let by_t = s.fma(s.mul(half, late), s.add(t, h_t), h);
    [s.fma(s.mul(half, wider), s.add(u, h_u), by_t), h_t, h_u]
}

/// 1 for the samples of a window that count, 0 for the others.
#[inline(always)]
pub(super) fn weights<S: Simd>(s: S, first: i32, order: usize, length: usize) -> S::V {
    let mut weights = [0.0; LANES];
    for (k, weight) in weights.iter_mut().enumerate() {
        let sample = first + k as i32;
        *weight = f32::from(u8::from(sample >= order as i32 && sample < length as i32));
    }
    s.load(&weights)
}

/// A window of a row that holds a template.
pub(super) const VECTORS: usize = ROW / LANES;
