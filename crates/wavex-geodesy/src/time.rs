//! GPS time scales.

use std::time::{Duration, SystemTime};

use super::calendar;

/// Seconds per GPS week.
pub const WEEK_S: f64 = 604_800.0;

/// Offset subtracted in "adjusted" GPS time, s (ASPRS LAS 1.4 R15, section 2.4, global encoding).
pub const ADJUSTMENT_S: f64 = 1e9;

/// Time scale of GPS times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
pub enum TimeScale {
    /// Seconds of the GPS week.
    Week,
    /// Seconds of the day.
    Day,
    /// Seconds since 1980-01-06 minus 1e9.
    Adjusted,
    /// Not specified by the file.
    Unknown,
}

impl TimeScale {
    /// What its seconds are; `None` if unknown.
    pub fn words(self) -> Option<&'static str> {
        match self {
            TimeScale::Week => Some("seconds of the GPS week"),
            TimeScale::Day => Some("seconds of the day"),
            TimeScale::Adjusted => Some("GPS seconds minus 1e9"),
            TimeScale::Unknown => None,
        }
    }

    /// Converts a time to adjusted GPS time, s; `None` if the week is unknown.
    ///
    /// # Examples
    ///
    /// ```
    /// use wavex_geodesy::time::TimeScale;
    ///
    /// assert_eq!(TimeScale::Week.adjusted_s(Some(2365), 208_800.5), Some(430_560_800.5));
    /// assert_eq!(TimeScale::Week.adjusted_s(None, 208_800.5), None);
    /// ```
    pub fn adjusted_s(self, gps_week: Option<u32>, gps_time_s: f64) -> Option<f64> {
        match (self, gps_week) {
            (TimeScale::Adjusted, _) => Some(gps_time_s),
            // The difference is a whole number below 2^53, so the fraction of a second is exact.
            (TimeScale::Week, Some(week)) => Some(f64::from(week) * WEEK_S - ADJUSTMENT_S + gps_time_s),
            _ => None,
        }
    }
}

/// Number of the day 1980-01-06.
const GPS_EPOCH_DAY: i64 = calendar::day_number([1980, 1, 6]);

/// GPS week of a Gregorian date, and day of the week from Sunday; `None` before 1980-01-06.
pub fn gps_week(year: i32, month: u32, day: u32) -> Option<(u32, u32)> {
    let days = calendar::day_number([year.into(), month.into(), day.into()]) - GPS_EPOCH_DAY;
    let days = u32::try_from(days).ok()?;
    Some((days / 7, days % 7))
}

/// Gregorian date of an adjusted GPS time, without leap seconds: (year, day of the year from 1).
///
/// `None` before 1980-01-06 and after about 2700 years.
pub fn day_of_year(adjusted_s: f64) -> Option<(u16, u16)> {
    let date = date(adjusted_s)?;
    Some((date[0], calendar::day_of_year(date.map(i64::from)) as u16))
}

/// Year, month and day of an adjusted GPS time, without leap seconds.
///
/// `None` before 1980-01-06 and after about 2700 years.
pub fn date(adjusted_s: f64) -> Option<[u16; 3]> {
    let days = ((adjusted_s + ADJUSTMENT_S) / 86_400.0).floor();
    let is_supported = (0.0..1e6).contains(&days);
    is_supported.then(|| calendar::date_of_day(days as i64 + GPS_EPOCH_DAY).map(|part| part as u16))
}

/// Days of the week by number, from Sunday, on which a GPS week begins.
pub const WEEKDAYS: [&str; 7] =
    ["Sunday", "Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday"];

/// Day of the week, from 0 on Sunday, of GPS seconds since 1980-01-06 or since the start of any week.
pub fn weekday(gps_s: f64) -> usize {
    // The cast saturates: NaN becomes 0.
    ((gps_s / 86_400.0).floor().rem_euclid(7.0) as usize).min(6)
}

/// Day of the week, from 0 on Sunday, of a day of the year (from 1).
pub fn weekday_of(year: u16, day: u16) -> usize {
    let days = calendar::day_number([year.into(), 1, 1]) + i64::from(day) - 1;
    (days - GPS_EPOCH_DAY).rem_euclid(7) as usize
}

/// Formats a time as ISO 8601, UTC, to a second.
pub fn utc(time: SystemTime) -> String {
    let since = time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or(Duration::ZERO).as_secs();
    let (days, second) = (since / 86_400, since % 86_400);
    let [year, month, day] = calendar::date_of_day(days as i64);
    let (hour, minute) = (second / 3600, second / 60 % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{:02}Z", second % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weekdays_agree_whether_by_date_or_by_seconds() {
        assert_eq!(WEEKDAYS[weekday_of(2013, 172)], "Friday");
        assert_eq!([weekday_of(1980, 6), weekday_of(1980, 5), weekday_of(2000, 60)], [0, 6, 2]);
        assert_eq!([weekday(0.0), weekday(WEEK_S - 1.0), weekday(-1.0), weekday(f64::NAN)], [0, 6, 6, 0]);
        for (year, month, day) in [(2013, 6, 21), (2024, 2, 29), (1999, 12, 31)] {
            let (week, of_week) = gps_week(year, month, day).unwrap();
            let noon_s = f64::from(week) * WEEK_S + (f64::from(of_week) + 0.5) * 86_400.0;
            let (year, day) = day_of_year(noon_s - ADJUSTMENT_S).unwrap();
            assert_eq!([weekday(noon_s), weekday_of(year, day)], [of_week as usize; 2]);
        }
    }

    #[test]
    fn times_are_those_of_the_calendar() {
        let at = |seconds| utc(SystemTime::UNIX_EPOCH + Duration::from_secs(seconds));
        assert_eq!(at(0), "1970-01-01T00:00:00Z");
        assert_eq!(at(951_782_400), "2000-02-29T00:00:00Z");
        assert_eq!(at(1_735_689_599), "2024-12-31T23:59:59Z");
        assert_eq!(at(4_107_542_400), "2100-03-01T00:00:00Z");
    }

    #[test]
    fn weeks_begin_on_sundays() {
        assert_eq!(gps_week(1980, 1, 6), Some((0, 0)));
        assert_eq!(gps_week(1980, 1, 13), Some((1, 0)));
        assert_eq!(gps_week(2015, 8, 31), Some((1860, 1)));
        assert_eq!(gps_week(2019, 4, 7), Some((2048, 0)), "the second rollover");
        assert_eq!(gps_week(1980, 1, 5), None);
    }

    #[test]
    fn adjusted_time_has_a_date() {
        // 2011-09-14 01:46:40 GPS is 1e9 seconds after the epoch.
        assert_eq!(day_of_year(0.0), Some((2011, 257)));
        assert_eq!(day_of_year(-1e9), Some((1980, 6)));
        assert_eq!(day_of_year(-2e9), None);
        assert_eq!(day_of_year(f64::NAN), None);
    }
}
