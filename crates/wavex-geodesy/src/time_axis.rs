//! Common time axis of a recording and its trajectory.
//!
//! Both count GPS seconds, but from different origins: 1980-01-06 ("adjusted", minus 1e9), Sunday's
//! midnight, or any midnight. [`Unwrap`] continues seconds across the end of the week or day;
//! [`align`] finds the week or day in which both overlap.

use core::fmt;

use super::time::{ADJUSTMENT_S, TimeScale, WEEK_S, WEEKDAYS, date, gps_week, weekday};

/// Seconds of a day.
pub const DAY_S: f64 = 86_400.0;

/// Origin of a time scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Clock {
    /// 1980-01-06, minus 1e9 s.
    Adjusted,
    /// The midnight before Sunday.
    Week,
    /// Any midnight.
    Day,
}

impl Clock {
    /// The clock of a recording; `None` if its time scale is unknown.
    pub fn of(scale: TimeScale) -> Option<Clock> {
        match scale {
            TimeScale::Adjusted => Some(Clock::Adjusted),
            TimeScale::Week => Some(Clock::Week),
            TimeScale::Day => Some(Clock::Day),
            TimeScale::Unknown => None,
        }
    }

    /// Period after which the clock wraps around, s; `None` if it does not.
    pub fn period_s(self) -> Option<f64> {
        match self {
            Clock::Adjusted => None,
            Clock::Week => Some(WEEK_S),
            Clock::Day => Some(DAY_S),
        }
    }

    /// Name in messages.
    pub fn name(self) -> &'static str {
        match self {
            Clock::Adjusted => "adjusted seconds",
            Clock::Week => "seconds of the week",
            Clock::Day => "seconds of the day",
        }
    }

    /// Offset from this clock to adjusted time, s, up to whole periods.
    fn base_s(self) -> f64 {
        if self == Clock::Adjusted { 0.0 } else { -ADJUSTMENT_S }
    }
}

/// Largest disorder of times, s.
const OUT_OF_ORDER_S: f64 = 60.0;

/// Unwraps a sequence of times across the ends of weeks or days.
///
/// A backward step by over half a period is a wrap-around. For times out of order around it, a
/// forward step by more than a period minus one minute undoes it. Other steps are kept. A NaN stays
/// NaN and has no effect on other times.
#[derive(Clone, Copy, Debug)]
pub struct Unwrap {
    period_s: Option<f64>,
    /// NaN before the first time.
    last_s: f64,
    periods: f64,
}

impl Unwrap {
    /// Starts; the first time is unchanged.
    pub fn new(clock: Clock) -> Unwrap {
        Unwrap { period_s: clock.period_s(), last_s: f64::NAN, periods: 0.0 }
    }

    /// Converts the next time, s, to the axis of the first.
    pub fn next(&mut self, time_s: f64) -> f64 {
        let Some(period_s) = self.period_s else { return time_s };
        if !time_s.is_finite() {
            return time_s;
        }
        let step_s = time_s - self.last_s;
        if step_s < -0.5 * period_s {
            self.periods += 1.0;
        } else if step_s > period_s - OUT_OF_ORDER_S {
            self.periods -= 1.0;
        }
        self.last_s = time_s;
        time_s + self.periods * period_s
    }
}

/// Time span; its last time may lie after the end of the clock's week or day.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimeSpan {
    /// Origin of the times.
    pub clock: Clock,
    /// The first time, s.
    pub first_s: f64,
    /// The last time, s; infinite if it is unknown.
    pub last_s: f64,
}

/// Formats as dates and seconds: `2025-05-06 10:00:00.0 to 10:30:12.5 GPS (430560800.0 to
/// 430562612.5 s, adjusted)`; with an unknown end `2025-05-06 10:00:00.0 GPS (430560800.0 s, adjusted) on`.
impl fmt::Display for TimeSpan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let TimeSpan { clock, first_s, last_s } = *self;
        let first = moment(clock, first_s);
        let counted = match clock {
            Clock::Adjusted => "s, adjusted",
            Clock::Week => "s of the week",
            Clock::Day => "s of the day",
        };
        if last_s == f64::INFINITY {
            let text = format!("{} {} GPS", first.0, first.1);
            return write!(f, "{} ({first_s:.1} {counted}) on", text.trim_start());
        }
        let last = moment(clock, last_s);
        let same_day = |(day, _): &&(String, String)| *day == first.0 && !day.is_empty();
        let until = match Some(&last).filter(same_day) {
            Some((_, time)) => time.clone(),
            None => format!("{} {}", last.0, last.1),
        };
        let text = format!("{} {} to {} GPS", first.0, first.1, until.trim_start());
        write!(f, "{} ({first_s:.1} to {last_s:.1} {counted})", text.trim_start())
    }
}

/// Day, if the clock defines it, and time of day.
fn moment(clock: Clock, time_s: f64) -> (String, String) {
    let tenths = (10.0 * (time_s + ADJUSTMENT_S + clock.base_s())).round();
    let of_day = tenths.rem_euclid(10.0 * DAY_S);
    let seconds = of_day / 10.0;
    let (hours, minutes) = ((seconds / 3600.0).floor(), (seconds / 60.0).floor() % 60.0);
    let time = format!("{hours:02.0}:{minutes:02.0}:{:04.1}", (of_day % 600.0) / 10.0);
    let day = match clock {
        Clock::Adjusted => date(tenths / 10.0 - ADJUSTMENT_S)
            .map_or_else(|| "no date".to_owned(), |[year, month, day]| format!("{year}-{month:02}-{day:02}")),
        Clock::Week => WEEKDAYS[weekday(tenths / 10.0)].to_owned(),
        Clock::Day => String::new(),
    };
    (day, time)
}

/// Adjusted GPS time at midnight of a date; `None` for invalid dates and before 1980-01-06.
pub fn adjusted_of_date([year, month, day]: [u16; 3]) -> Option<f64> {
    let (week, day_of_week) = gps_week(year.into(), month.into(), day.into())?;
    let adjusted_s = f64::from(week) * WEEK_S + f64::from(day_of_week) * DAY_S - ADJUSTMENT_S;
    (date(adjusted_s) == Some([year, month, day])).then_some(adjusted_s)
}

/// Start of the months with a new leap second, as year and month (IERS Bulletin C).
///
/// From each one on, UTC is one second further behind GPS time. None has been announced since.
const LEAPS: [(u16, u16); 18] = [
    (1981, 7),
    (1982, 7),
    (1983, 7),
    (1985, 7),
    (1988, 1),
    (1990, 1),
    (1991, 1),
    (1992, 7),
    (1993, 7),
    (1994, 7),
    (1996, 1),
    (1997, 7),
    (1999, 1),
    (2006, 1),
    (2009, 1),
    (2012, 7),
    (2015, 7),
    (2017, 1),
];

/// GPS time minus UTC, s, at a UTC moment given as adjusted seconds of UTC days.
pub fn leap_seconds(adjusted_utc_s: f64) -> f64 {
    let begun = |&&(year, month): &&(u16, u16)| {
        adjusted_of_date([year, month, 1]).is_some_and(|begin_s| begin_s <= adjusted_utc_s)
    };
    LEAPS.iter().filter(begun).count() as f64
}

/// Formats an adjusted GPS time as ISO 8601, UTC, rounded to a millisecond.
///
/// `None` before 1980-01-06 and after about 2700 years. A moment within a leap second gets the second
/// after it.
///
/// # Examples
///
/// ```
/// use wavex_geodesy::time_axis::utc_of_gps;
///
/// // 18 leap seconds.
/// assert_eq!(utc_of_gps(430_560_818.25).as_deref(), Some("2025-05-06T10:00:00.250Z"));
/// ```
pub fn utc_of_gps(adjusted_s: f64) -> Option<String> {
    let mut utc_s = adjusted_s;
    // The second step is for the seconds about a leap second.
    for _ in 0..2 {
        utc_s = adjusted_s - leap_seconds(utc_s);
    }
    let utc_s = (utc_s * 1000.0).round() / 1000.0;
    let [year, month, day] = date(utc_s)?;
    let milliseconds = ((utc_s + ADJUSTMENT_S).rem_euclid(DAY_S) * 1000.0).round() as u64;
    let second = milliseconds / 1000;
    let (hour, minute) = (second / 3600, second / 60 % 60);
    Some(format!(
        "{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{:02}.{:03}Z",
        second % 60,
        milliseconds % 1000
    ))
}

/// Conversion of recording times to the axis of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// Time span of the recording on its own clock.
    pub recording: TimeSpan,
    /// Time span of the trajectory.
    pub trajectory: TimeSpan,
    base_s: f64,
    period_s: Option<f64>,
}

impl Alignment {
    /// As [`align`], without requiring an overlap, for recordings of which only the start is known.
    ///
    /// # Errors
    /// A time of the recording may match more than one moment of the trajectory.
    pub fn between(recording: TimeSpan, trajectory: TimeSpan) -> Result<Alignment, Misaligned> {
        let shared = match (recording.clock, trajectory.clock) {
            (Clock::Adjusted, Clock::Adjusted) => Clock::Adjusted,
            (Clock::Day, _) | (_, Clock::Day) => Clock::Day,
            _ => Clock::Week,
        };
        let period_s = shared.period_s();
        if period_s.is_some_and(|period_s| trajectory.last_s - trajectory.first_s >= period_s) {
            return Err(Misaligned::Ambiguous { recording, trajectory, shared });
        }
        let base_s = recording.clock.base_s() - trajectory.clock.base_s();
        Ok(Alignment { recording, trajectory, base_s, period_s })
    }

    /// GPS week in which a recording's seconds of the week count, by the date of the trajectory.
    ///
    /// `None` if the trajectory has no date, or the recording another clock.
    pub fn gps_week(&self, time_s: f64) -> Option<u32> {
        let is_dated = self.recording.clock == Clock::Week && self.trajectory.clock == Clock::Adjusted;
        let week = ((self.on_trajectory(time_s) - time_s + ADJUSTMENT_S) / WEEK_S).round();
        (is_dated && (0.0..1e5).contains(&week)).then_some(week as u32)
    }

    /// Converts a recording time, s, to the axis of the trajectory.
    ///
    /// The result is within half a period of the middle of the trajectory, so wrap-arounds of the
    /// recording's clock do not matter.
    pub fn on_trajectory(&self, time_s: f64) -> f64 {
        let middle_s = 0.5 * (self.trajectory.first_s + self.trajectory.last_s);
        let periods_s = self
            .period_s
            .map_or(0.0, |period_s| period_s * ((middle_s - (time_s + self.base_s)) / period_s).round());
        // Both are whole numbers, so the sum added to the time is exact.
        time_s + (self.base_s + periods_s)
    }
}

/// Largest offset of UTC that is suspected, s; it has been 18 s since 2017.
const MOST_LEAP_S: f64 = 20.0;

/// Hint at a mix of UTC and GPS time for a recording, or a part of it, at most 20 s from the trajectory.
pub fn utc_hint(mut recording: TimeSpan, trajectory: TimeSpan) -> &'static str {
    if recording.last_s == f64::INFINITY {
        recording.last_s = recording.first_s;
    }
    let is_near = Alignment::between(recording, trajectory).is_ok_and(|alignment| {
        let near_s = trajectory.first_s - MOST_LEAP_S..=trajectory.last_s + MOST_LEAP_S;
        [recording.first_s, recording.last_s].iter().all(|&t| near_s.contains(&alignment.on_trajectory(t)))
    });
    if is_near {
        "; if the recording counts UTC, 18 s less than GPS time, set `utc = true` of the reader; if the trajectory \
         does, export it in GPS time, or set `time_offset_s` of the reader"
    } else {
        ""
    }
}

/// Reason why a recording and a trajectory do not match.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Misaligned {
    /// They have no time in common.
    #[error(
        "the recording and the trajectory have no time in common: the recording lasts from {recording}, the trajectory \
         from {trajectory}; use the trajectory of this flight, or set its time scale with `trajectory_time`{}", utc_hint(*recording, *trajectory)
    )]
    NoOverlap {
        /// Time span of the recording.
        recording: TimeSpan,
        /// Time span of the trajectory.
        trajectory: TimeSpan,
    },
    /// The trajectory is longer than the period of the clock, so times are ambiguous.
    #[error(
        "the trajectory lasts from {trajectory}, longer than the period of the clock: {} of the recording, which lasts from \
         {recording}, are ambiguous; cut the trajectory to the flight", shared.name()
    )]
    Ambiguous {
        /// Time span of the recording.
        recording: TimeSpan,
        /// Time span of the trajectory.
        trajectory: TimeSpan,
        /// The clock with the shorter period.
        shared: Clock,
    },
}

/// Aligns a recording with a trajectory by whole weeks or days, so that they overlap.
///
/// If the clock of the recording wraps around, its last time may precede its first.
///
/// # Errors
/// No such week or day, or more than one.
///
/// # Examples
///
/// ```
/// use wavex_geodesy::time_axis::{Clock, TimeSpan, align};
///
/// // The recording counts seconds of the day, the trajectory seconds of the week.
/// let recording = TimeSpan { clock: Clock::Day, first_s: 36_500.0, last_s: 37_000.0 };
/// let trajectory = TimeSpan { clock: Clock::Week, first_s: 208_800.0, last_s: 212_800.0 };
/// let alignment = align(recording, trajectory)?;
/// assert_eq!(alignment.on_trajectory(36_500.0), 209_300.0);
/// # Ok::<(), wavex_geodesy::time_axis::Misaligned>(())
/// ```
pub fn align(recording: TimeSpan, trajectory: TimeSpan) -> Result<Alignment, Misaligned> {
    let alignment = Alignment::between(recording, trajectory)?;
    let [first_s, last_s] = [recording.first_s, recording.last_s].map(|t| alignment.on_trajectory(t));
    let within = |time_s: f64| (trajectory.first_s..=trajectory.last_s).contains(&time_s);
    let around = first_s <= trajectory.first_s && trajectory.last_s <= last_s;
    if within(first_s) || within(last_s) || around {
        Ok(alignment)
    } else {
        Err(Misaligned::NoOverlap { recording, trajectory })
    }
}

#[cfg(test)]
mod tests;
