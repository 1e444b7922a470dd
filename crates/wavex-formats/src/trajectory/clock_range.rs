//! Times that a clock can have.

use wavex_geodesy::time::{ADJUSTMENT_S, WEEK_S};
use wavex_geodesy::time_axis::{Clock, DAY_S};

/// Conversion applied to the file's times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TimeConversion {
    /// Clock of the file's times.
    pub(super) clock: Clock,
    /// GPS time minus the file's time, s.
    pub(super) leap_s: f64,
}

/// Returns whether times in this range are valid for a clock.
pub(super) fn may_be(clock: Clock, [least_s, most_s]: [f64; 2]) -> bool {
    range_s(clock)[0] <= least_s && most_s <= range_s(clock)[1]
}

/// Returns the valid range of a clock, s.
///
/// It has a margin for times that continue across the end of the week or day.
fn range_s(clock: Clock) -> [f64; 2] {
    match clock {
        Clock::Adjusted => [-ADJUSTMENT_S, ADJUSTMENT_S],
        Clock::Week => [-DAY_S, 2.0 * WEEK_S],
        Clock::Day => [-DAY_S, 2.0 * DAY_S],
    }
}
