//! Pending scan lines and their echoes.

use super::pulses::LinePulses;

/// An echo of a pending line.
#[derive(Debug, Clone, Copy)]
pub(super) struct HeldEcho {
    /// Time since the last emission before it, ns.
    pub since_ns: f64,
    /// Index of the echo in the pushed line.
    pub input: u32,
    /// Index of the last emission before the echo, or of the first known one.
    pub last: u32,
    /// Index of the emission of zone 0: `last`, shifted so that neighbouring echoes of one surface
    /// have the same zone. May lie beyond the end of the line.
    pub base: i32,
    /// Range if caused by `base`, for even intervals from the line's first emission, m.
    pub even_m: f32,
    /// Range in zone 0, counted from `base`, m; emissions after `last` are assumed at even
    /// intervals.
    pub range_m: f32,
}

impl HeldEcho {
    /// Moves the zone origin `by` emissions later.
    pub(crate) fn count_from(&mut self, by: i32, interval_m: f32) {
        self.base += by;
        self.even_m -= by as f32 * interval_m;
        self.range_m -= by as f32 * interval_m;
    }
}

/// A pending scan line.
#[derive(Debug)]
pub(super) struct Held {
    pub number: u64,
    pub pulses: LinePulses,
    /// Sorted by column and time.
    pub echoes: Vec<HeldEcho>,
    /// Columns of a revolution, whose last is adjacent to the first; 0 for a sweep.
    pub ring: i32,
    /// [`Line::bytes`](super::Line::bytes).
    pub bytes: usize,
}
