//! Whitened template of a pulse and its derivatives, from the tables.

use wavex_simd::{LANES, Simd, Sixteen};

use super::layout::{
    BEFORE_PEAK, ENTRY, KNOTS, PHASES, ROW, ROW_STRIDE, U_MAX, U_MIN, U_STEP, Values, sixteen,
};
use super::tables::Tables;
use crate::pulse_fit::{MAX_LN_WIDTH_STEP, MIN_HEIGHT_PART};

/// Sixteen pulses, one per row: height, position and `ln` of the width ratio.
#[derive(Clone, Copy)]
pub(super) struct Pulses<V> {
    pub(super) height: V,
    pub(super) position: V,
    pub(super) width: V,
}

/// Range of positions outside the block, samples.
const OUTSIDE: f32 = 8.0;
/// Minimum fraction of its height that an iteration leaves to a pulse.
const LEAST_LEFT: f32 = MIN_HEIGHT_PART as f32;
/// Maximum change of position (samples) and of `ln` width per iteration.
const LIMITS: [f32; 2] = [1.5, MAX_LN_WIDTH_STEP as f32];

impl<V: Copy> Pulses<V> {
    /// Makes a step within the limits of one iteration and of the tables.
    #[inline(always)]
    pub(super) fn stepped<S: Simd<V = V>>(self, s: S, step: [V; 3], last: V) -> Pulses<V> {
        self.moved(s, step).within(s, last)
    }

    /// Makes a step within the limits of one iteration.
    #[inline(always)]
    pub(super) fn moved<S: Simd<V = V>>(self, s: S, step: [V; 3]) -> Pulses<V> {
        Pulses {
            height: s.max(s.add(self.height, step[0]), s.mul(self.height, s.splat(LEAST_LEFT))),
            position: s.add(self.position, bounded(s, step[1], LIMITS[0])),
            width: s.add(self.width, bounded(s, step[2], LIMITS[1])),
        }
    }

    /// Limits the pulses to the range of tables and rows; NaN becomes the lower bound.
    #[inline(always)]
    pub(super) fn within<S: Simd<V = V>>(self, s: S, last: V) -> Pulses<V> {
        let outside = s.splat(OUTSIDE);
        Pulses {
            height: s.max(self.height, s.splat(1e-3)),
            position: s.min(s.max(self.position, s.sub(s.splat(0.0), outside)), s.add(last, outside)),
            width: s.min(s.max(self.width, s.splat(U_MIN as f32)), s.splat(U_MAX as f32)),
        }
    }

    /// Selects `self` in the lanes of the mask, `other` in the rest.
    #[inline(always)]
    pub(super) fn select<S: Simd<V = V>>(self, s: S, mask: u16, other: Pulses<V>) -> Pulses<V> {
        Pulses {
            height: s.select(mask, self.height, other.height),
            position: s.select(mask, self.position, other.position),
            width: s.select(mask, self.width, other.width),
        }
    }
}

/// Clamps a value to `±limit`.
#[inline(always)]
pub(super) fn bounded<S: Simd>(s: S, value: S::V, limit: f32) -> S::V {
    s.min(s.max(value, s.splat(-limit)), s.splat(limit))
}

/// Table entry of a pulse, and the pulse's distance from it.
#[derive(Clone, Copy, Default)]
pub(super) struct Lookup {
    /// Entry of knot and position.
    pub(super) entry: usize,
    /// Block sample at the start of the row.
    pub(super) first: i32,
    /// Table position minus that of the pulse, samples.
    pub(super) late: f32,
    /// `ln` width of the pulse minus that of the knot.
    pub(super) wider: f32,
    pub(super) height: f32,
    /// Response nodes around the height, and the weight of the second.
    pub(super) nodes: [usize; 2],
    pub(super) share: f32,
    /// Height divided by the distance of the nodes.
    ///
    /// Factor of the response's change with height in the derivative by height.
    pub(super) change: f32,
}

impl Lookup {
    /// Finds the table entry of one pulse; the response depends on its height.
    #[inline(always)]
    pub(super) fn of(tables: &Tables, [height, position, width]: Values) -> Lookup {
        let above = width.clamp(U_MIN as f32, U_MAX as f32) - U_MIN as f32;
        // Rounds as `Lookups::set` does, so that both find the same entry.
        let knot = (above * (1.0 / U_STEP as f32)).round_ties_even();
        let phase = (position * PHASES as f32).round_ties_even();
        let lookup = Lookup {
            entry: tables.index(knot as usize, phase as i32),
            first: (phase as i32).div_euclid(PHASES as i32) - BEFORE_PEAK,
            late: phase / PHASES as f32 - position,
            wider: above - knot * U_STEP as f32,
            height,
            ..Lookup::default()
        };
        lookup.with_nodes(tables)
    }

    /// Sets the response nodes around the pulse's height.
    #[inline(always)]
    fn with_nodes(mut self, tables: &Tables) -> Lookup {
        let nodes = &tables.nodes;
        if nodes.len() == 1 {
            return self;
        }
        let above = nodes.iter().take_while(|node| node.peak_dn <= self.height).count();
        if above == 0 || above == nodes.len() {
            self.nodes = [above.saturating_sub(1); 2];
        } else {
            let (low, high) = (nodes[above - 1].peak_dn, nodes[above].peak_dn);
            self.nodes = [above - 1, above];
            self.share = (self.height - low) / (high - low);
            self.change = self.height / (high - low);
        }
        self
    }
}

/// Lookups of sixteen pulses, one per lane.
#[derive(Clone, Copy)]
pub(super) struct Lookups {
    knot: [i32; LANES],
    /// Positions in units of a phase.
    step: [i32; LANES],
    late: Sixteen,
    wider: Sixteen,
    height: Sixteen,
}

impl Lookups {
    /// Lookups before any are set.
    pub(super) const NONE: Lookups = Lookups {
        knot: [0; LANES],
        step: [0; LANES],
        late: [0.0; LANES],
        wider: [0.0; LANES],
        height: [0.0; LANES],
    };

    /// Sets the lookups of pulses that are [`Pulses::within`] the tables.
    #[inline(always)]
    pub(super) fn set<S: Simd>(&mut self, s: S, pulses: &Pulses<S::V>) {
        let above = s.sub(pulses.width, s.splat(U_MIN as f32));
        let knot = s.mul(above, s.splat(1.0 / U_STEP as f32));
        let phase = s.mul(pulses.position, s.splat(PHASES as f32));
        let rounded = s.mul(s.round(phase), s.splat(1.0 / PHASES as f32));
        s.to_i32(knot, &mut self.knot);
        s.to_i32(phase, &mut self.step);
        s.store(s.sub(rounded, pulses.position), &mut self.late);
        s.store(s.fnma(s.round(knot), s.splat(U_STEP as f32), above), &mut self.wider);
        s.store(pulses.height, &mut self.height);
    }

    /// Block sample at the start of a lane's row.
    #[inline(always)]
    pub(super) fn first(&self, lane: usize) -> i32 {
        self.step[lane].div_euclid(PHASES as i32) - BEFORE_PEAK
    }

    /// Returns the lookup in a lane; with `STRONG` the response depends on height.
    #[inline(always)]
    pub(super) fn get<const STRONG: bool>(&self, tables: &Tables, lane: usize) -> Lookup {
        let knot = (self.knot[lane].max(0) as usize).min(KNOTS - 1);
        let lookup = Lookup {
            entry: tables.index(knot, self.step[lane]),
            first: self.first(lane),
            late: self.late[lane],
            wider: self.wider[lane],
            height: self.height[lane],
            ..Lookup::default()
        };
        if STRONG { lookup.with_nodes(tables) } else { lookup }
    }
}

/// Whether a frame extends past the samples that count, from `order` to `length`.
#[inline(always)]
pub(super) fn leaves_block(first: i32, frame: usize, order: usize, length: usize) -> bool {
    first < order as i32 || first + frame as i32 > length as i32
}

/// Sixteen samples of a pulse of height 1 and its derivatives.
///
/// The derivatives are by height, time and width. That by height is multiplied with the height; it
/// equals the pulse if the response does not depend on height.
#[derive(Clone, Copy)]
pub(super) struct Template<V> {
    pub(super) pulse: V,
    pub(super) by_height: V,
    pub(super) by_time: V,
    pub(super) by_width: V,
}

/// Returns the template of a lookup.
///
/// `at` counts from the first value of the entry, 16 before the row. Values outside the row are 0.
#[inline(always)]
pub(super) fn template<S: Simd, const STRONG: bool>(
    s: S,
    tables: &Tables,
    lookup: &Lookup,
    at: usize,
) -> Template<S::V> {
    let (late, wider) = (s.splat(lookup.late), s.splat(lookup.wider));
    let [mut pulse, mut by_time, mut by_width] =
        expanded(s, tables.entry(lookup.nodes[0], lookup.entry), at, late, wider);
    let mut by_height = pulse;
    if STRONG {
        let other = expanded(s, tables.entry(lookup.nodes[1], lookup.entry), at, late, wider);
        let share = s.splat(lookup.share);
        let change = s.sub(other[0], pulse);
        pulse = s.fma(share, change, pulse);
        by_height = s.fma(s.splat(lookup.change), change, pulse);
        by_time = s.fma(share, s.sub(other[1], by_time), by_time);
        by_width = s.fma(share, s.sub(other[2], by_width), by_width);
    }
    Template { pulse, by_height, by_time, by_width }
}

/// Second-order Taylor expansion from an entry.
///
/// The error of the pulse is below 5e-5 of the peak for width ratios from 0.9, below 4e-4 from 0.8.
#[inline(always)]
fn expanded<S: Simd>(s: S, entry: &[f32; ENTRY], at: usize, late: S::V, wider: S::V) -> [S::V; 3] {
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

/// Sixteen samples of a lookup's tail, times its height.
///
/// `from` counts samples from the end of its row; it may be negative.
#[inline(always)]
pub(super) fn tail<S: Simd, const STRONG: bool>(s: S, tables: &Tables, lookup: &Lookup, from: i32) -> S::V {
    let at = usize::try_from(from + LANES as i32).unwrap_or(usize::MAX);
    let mut values = s.load(sixteen(tables.tail(lookup.nodes[0], lookup.entry), at));
    if STRONG {
        let other = s.load(sixteen(tables.tail(lookup.nodes[1], lookup.entry), at));
        values = s.fma(s.splat(lookup.share), s.sub(other, values), values);
    }
    s.mul(values, s.splat(lookup.height * tables.tail_gain(lookup.entry)))
}

/// Zeros, ones and zeros again.
static STEP_UP_AND_DOWN: [f32; 3 * LANES] = {
    let mut values = [0.0; 3 * LANES];
    let mut i = LANES;
    while i < 2 * LANES {
        values[i] = 1.0;
        i += 1;
    }
    values
};

/// Weights of a window's samples: 1 from `order` to `length`, 0 outside.
#[inline(always)]
pub(super) fn weights<S: Simd>(s: S, first: i32, order: usize, length: usize) -> S::V {
    let window = LANES as i32;
    let before = (order as i32 - first).clamp(0, window);
    let behind = (first + window - length as i32).clamp(0, window);
    let from = s.load(sixteen(&STEP_UP_AND_DOWN, LANES.saturating_add_signed(-before as isize)));
    let to = s.load(sixteen(&STEP_UP_AND_DOWN, LANES + behind as usize));
    s.mul(from, to)
}

/// Vectors in a row of a template.
pub(super) const VECTORS: usize = ROW / LANES;
