//! Converts file times to one continuous axis.
//!
//! The axis is GPS time, adjusted if the date is known.

use std::path::Path;

use super::super::{Error, Result};
use super::clock_range::{TimeConversion, may_be};
use super::{FileTime, Options, Raw, Recorded, accuracies};
use wavex_geodesy::time::{ADJUSTMENT_S, WEEK_S, gps_week};
use wavex_geodesy::time_axis::{Clock, DAY_S, Unwrap, adjusted_of_date, leap_seconds, utc_of_gps};

/// Declarations of a file about its times.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Stated {
    /// Clock of the times.
    pub(super) clock: Option<Clock>,
    /// Whether times are UTC; otherwise GPS time.
    pub(super) is_utc: bool,
    /// Year, month and day of the recording.
    pub(super) date: Option<[u16; 3]>,
}

/// Puts the decoded records on one time axis and adds the accuracies in the file `accuracy`.
pub(super) fn settle(path: &Path, raw: Raw, options: &Options, accuracy: Option<&Path>) -> Result<Recorded> {
    let Raw { format, mut stated, mut records, speeds_mps, mut notes } = raw;
    let offset_s = options.time.map_or(0.0, FileTime::offset_s);
    records.times_mut().for_each(|time_s| *time_s += offset_s);
    stated.is_utc |= options.time == Some(FileTime::Unix);
    let clock = clock_of(path, &stated, options, records.times_s(), &mut notes)?;
    let mut unwrap = Unwrap::new(clock);
    records.times_mut().for_each(|time_s| *time_s = unwrap.next(*time_s));
    let first_s = records.times_s().next().unwrap_or(0.0);
    let midnight_s = stated.date.and_then(adjusted_of_date);
    let anchor_s = anchor_s(clock, first_s, stated.date.filter(|_| midnight_s.is_some()));
    let leap_s = match anchor_s {
        _ if !stated.is_utc => 0.0,
        Some(anchor_s) => leap_seconds(first_s + anchor_s),
        None => {
            let problem = "its times are UTC, but it has no date to determine leap seconds";
            return Err(Error::unusable(path, problem, "export it with its date, or in GPS time"));
        }
    };
    // Whole seconds, so the sum is exact.
    let shift_s = anchor_s.unwrap_or(0.0) + leap_s;
    records.times_mut().for_each(|time_s| *time_s += shift_s);
    let counts = counts(clock, &stated, midnight_s.is_some(), leap_s);
    if stated.date.is_some() && midnight_s.is_none() {
        notes.push("the header has an invalid date: week and day are unknown".to_owned());
    }
    let on_axis = if anchor_s.is_some() { Clock::Adjusted } else { clock };
    let accuracies = Vec::new();
    let mut recorded = Recorded {
        file: path.to_owned(),
        format,
        counts,
        clock: on_axis,
        records,
        accuracies,
        speeds_mps,
        notes,
    };
    if let Some(path) = accuracy {
        recorded.accuracies =
            accuracies::on_axis(path, &recorded, TimeConversion { clock, leap_s: offset_s + leap_s })?;
    }
    Ok(recorded)
}

/// Chooses the clock.
///
/// The user's, else the file's, else one that fits the times.
fn clock_of(
    path: &Path,
    stated: &Stated,
    options: &Options,
    times_s: impl Iterator<Item = f64>,
    notes: &mut Vec<String>,
) -> Result<Clock> {
    let limits_s = times_s.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], t| [a.min(t), b.max(t)]);
    let said = options.time.map(FileTime::clock);
    if let (Some(said), Some(stated)) = (said, stated.clock)
        && said != stated
    {
        notes.push(format!(
            "the file says that times are {}; they are read as {}",
            stated.name(),
            said.name()
        ));
    }
    let clock = match said.or(stated.clock) {
        Some(clock) => clock,
        None if may_be(Clock::Week, limits_s) => Clock::Week,
        None => {
            notes.push(
                "times are too large for seconds of the week: they are read as adjusted seconds".to_owned(),
            );
            Clock::Adjusted
        }
    };
    let is_empty = limits_s[0] > limits_s[1];
    if is_empty || may_be(clock, limits_s) {
        return Ok(clock);
    }
    let problem =
        format!("its times, from {:.3} to {:.3} s, are not {}", limits_s[0], limits_s[1], clock.name());
    let day = |scale: FileTime| utc_of_gps(limits_s[0] + scale.offset_s()).filter(|_| options.time.is_none());
    let remedy = match [FileTime::Standard, FileTime::Unix].map(day) {
        [Some(standard), Some(unix)] if limits_s[0] > ADJUSTMENT_S => format!(
            "set `trajectory_time` to standard (seconds since 1980-01-06: recorded on {}) or to unix (since \
             1970-01-01: on {})",
            date_of(&standard),
            date_of(&unix)
        ),
        _ => "set `trajectory_time` to week, day, adjusted, standard or unix".to_owned(),
    };
    Err(Error::unusable(path, problem, remedy))
}

/// Date of an ISO 8601 time.
fn date_of(time: &str) -> &str {
    time.split('T').next().unwrap_or_default()
}

/// Returns the offset from a clock to adjusted time, s.
///
/// `None` without a date.
fn anchor_s(clock: Clock, first_s: f64, date: Option<[u16; 3]>) -> Option<f64> {
    if clock == Clock::Adjusted {
        return Some(0.0);
    }
    let midnight_s = adjusted_of_date(date?)?;
    if clock == Clock::Day {
        return Some(midnight_s);
    }
    let [year, month, day] = date?;
    let (week, _) = gps_week(year.into(), month.into(), day.into())?;
    let week_s = f64::from(week) * WEEK_S - ADJUSTMENT_S;
    // At the end of a week the date may belong to either week: choose the one nearest to the first
    // record.
    let weeks = ((midnight_s + 0.5 * DAY_S - (week_s + first_s)) / WEEK_S).round();
    Some(week_s + WEEK_S * weeks)
}

/// Describes the clock of the file's times.
fn counts(clock: Clock, stated: &Stated, has_date: bool, leap_s: f64) -> String {
    let whose = if stated.is_utc { format!("UTC ({leap_s} s less than GPS)") } else { "GPS".to_owned() };
    match stated.date {
        Some([year, month, day]) if has_date => {
            format!("{}, {whose}, {year}-{month:02}-{day:02}", clock.name())
        }
        _ => format!("{}, {whose}", clock.name()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_near_the_end_of_a_week_give_the_week() {
        // Saturday 2025-05-10 ended week 2365, which began 430 315 200 s after 2011-09-14 01:46:40.
        let week_s = 2365.0 * WEEK_S - 1e9;
        let anchors = |first_s, day| anchor_s(Clock::Week, first_s, Some([2025, 5, day])).unwrap() - week_s;
        assert_eq!([anchors(604_000.0, 10), anchors(604_000.0, 11), anchors(208_800.0, 6)], [0.0; 3]);
        assert_eq!([anchors(100.0, 10), anchors(100.0, 11)], [WEEK_S; 2]);
        assert_eq!(anchor_s(Clock::Day, 5.0, Some([2025, 5, 6])), Some(week_s + 2.0 * DAY_S));
        assert_eq!(anchor_s(Clock::Day, 5.0, None), None);
        assert_eq!(anchor_s(Clock::Adjusted, 5.0, None), Some(0.0));
    }
}
