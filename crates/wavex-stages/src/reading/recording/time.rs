//! Time scale and GPS week of a recording.
//!
//! Both follow from its file, the job, and the time of its first shot.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_formats::Error;
use wavex_geodesy::calendar::is_date;
use wavex_geodesy::time::{ADJUSTMENT_S, WEEK_S, WEEKDAYS, date, day_of_year, gps_week, weekday};
use wavex_geodesy::time_axis::leap_seconds;
use wavex_line::keys::listed;
use wavex_line::scan_line::{InputInfo, TimeScale};
use wavex_line::stage::Result;

const DAY_S: f64 = 86_400.0;

/// A moment in seconds since the GPS epoch (1980-01-06), without leap seconds.
pub(crate) type SinceEpoch = f64;

/// Time scale of a time window.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ScaleKey {
    /// Seconds of the GPS week.
    Week,
    /// Adjusted GPS time: seconds since 1980-01-06, minus 1e9.
    Adjusted,
}

/// Time scale of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RecordingTime {
    /// Seconds of the GPS week.
    Week,
    /// Seconds of the day.
    Day,
    /// Adjusted GPS time: seconds since 1980-01-06, minus 1e9.
    Adjusted,
    /// Standard GPS time: seconds since 1980-01-06.
    Standard,
}

/// Time scale of a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum RecordedTimeScale {
    Week,
    Day,
    /// Seconds since this moment.
    Since(SinceEpoch),
    Unknown,
}

impl From<RecordingTime> for RecordedTimeScale {
    fn from(said: RecordingTime) -> RecordedTimeScale {
        match said {
            RecordingTime::Week => RecordedTimeScale::Week,
            RecordingTime::Day => RecordedTimeScale::Day,
            RecordingTime::Adjusted => RecordedTimeScale::Since(ADJUSTMENT_S),
            RecordingTime::Standard => RecordedTimeScale::Since(0.0),
        }
    }
}

impl RecordedTimeScale {
    /// The scale that a reader reports.
    pub(crate) fn of(scale: TimeScale) -> RecordedTimeScale {
        match scale {
            TimeScale::Week => RecordedTimeScale::Week,
            TimeScale::Day => RecordedTimeScale::Day,
            TimeScale::Adjusted => RecordedTimeScale::Since(ADJUSTMENT_S),
            TimeScale::Unknown => RecordedTimeScale::Unknown,
        }
    }

    /// The scale of an SDF epoch, as returned by the library.
    pub(crate) fn of_epoch(epoch: &str) -> RecordedTimeScale {
        match epoch.trim() {
            "WEEKSEC" => RecordedTimeScale::Week,
            "DAYSEC" => RecordedTimeScale::Day,
            epoch => date_and_time(epoch).map_or(RecordedTimeScale::Unknown, RecordedTimeScale::Since),
        }
    }

    /// Explains why a typical time cannot be of this scale, if so.
    ///
    /// `file_date`: creation date of the file (day of the year, year).
    pub(crate) fn misfit(self, time_s: f64, file_date: Option<(u16, u16)>) -> Option<String> {
        let (fits, what) = match self {
            // A clock may run on past the end of its week or day.
            RecordedTimeScale::Week => ((0.0..WEEK_S + DAY_S).contains(&time_s), "seconds of the GPS week"),
            RecordedTimeScale::Day => ((0.0..2.0 * DAY_S).contains(&time_s), "seconds of the day"),
            RecordedTimeScale::Since(epoch) => {
                (is_plausible(epoch + time_s, file_date), "seconds since a day in 1980 or later")
            }
            RecordedTimeScale::Unknown => (true, ""),
        };
        let dates = || {
            let readings: Vec<String> =
                dates_of(time_s).map(|(name, date)| format!("{name} GPS time: {date}")).collect();
            if readings.is_empty() { String::new() } else { format!(" (as {})", readings.join(", as ")) }
        };
        let what = match self {
            RecordedTimeScale::Since(ADJUSTMENT_S) => "adjusted GPS time",
            RecordedTimeScale::Since(0.0) => "standard GPS time",
            _ => what,
        };
        (!fits).then(|| {
            format!("the recording's times, such as {time_s:.1} s, {NOT_PLAUSIBLE} {what}{}", dates())
        })
    }
}

/// Dates of a time, as adjusted and as standard GPS time.
fn dates_of(time_s: f64) -> impl Iterator<Item = (&'static str, String)> {
    [("adjusted", 0.0), ("standard", -ADJUSTMENT_S)].into_iter().filter_map(move |(name, shift_s)| {
        let [year, month, day] = date(time_s + shift_s)?;
        Some((name, format!("{year}-{month:02}-{day:02}")))
    })
}

/// Values of `recording_time` that fit a time of unknown scale, with the dates they give.
pub fn possible_scales(time_s: f64) -> String {
    let periods = [("week", WEEK_S), ("day", DAY_S)];
    let of_period = periods.into_iter().filter(|(_, period_s)| (0.0..*period_s).contains(&time_s));
    let values: Vec<String> = (of_period.map(|(name, _)| format!("\"{name}\"")))
        .chain(dates_of(time_s).map(|(name, date)| format!("\"{name}\" ({date})")))
        .collect();
    listed(&values, "or")
}

/// Whether a moment is plausible for airborne full-waveform data.
///
/// None was recorded in flight before 1990. A date after 2079, or more than a year after that of
/// the file, is wrong. The first week of adjusted time is in September 2011: in a file of another
/// year, such values are seconds of the week.
fn is_plausible(moment: SinceEpoch, file_date: Option<(u16, u16)>) -> bool {
    let adjusted_s = moment - ADJUSTMENT_S;
    let Some((year, day)) = day_of_year(adjusted_s) else { return false };
    let is_week_of_2011 = (0.0..WEEK_S).contains(&adjusted_s);
    let fits_file = file_date.is_none_or(|(file_day, file_year)| {
        (year, day) <= (file_year + 1, file_day) && !(is_week_of_2011 && file_year != year)
    });
    (1990..2080).contains(&year) && fits_file
}

/// Explains that the day of `gps_date` and seconds of the week are of different weekdays, if so.
///
/// Neighbouring days agree: the date may be local.
pub(crate) fn other_weekday(noon: SinceEpoch, first_s: f64) -> Option<String> {
    let [of_date, of_times] = [noon, first_s].map(weekday);
    let apart = (of_date + 7 - of_times) % 7;
    (2..=5).contains(&apart).then(|| {
        let [of_date, of_times] = [of_date, of_times].map(|day| WEEKDAYS[day]);
        format!(
            "`gps_date` is a {of_date}, but the first time of the recording, {first_s:.1} s of the GPS week, is \
             on a {of_times}: the nearest {of_times} {OTHER_DAY}; correct `gps_date`, or `recording_time` \
             if these are not seconds of the week"
        )
    })
}

/// Explains that `gps_date` and the moment in the file name are of different days, if so.
///
/// Neighbouring days agree: either may be local.
pub(crate) fn other_day(date: Option<SinceEpoch>, named: Option<SinceEpoch>) -> Option<String> {
    let apart_days = ((date? - named?) / DAY_S).abs();
    (apart_days > 2.0).then(|| {
        format!("`gps_date` and {OTHER_NAME} are {apart_days:.0} days apart: the key is used; check date")
    })
}

/// Words of the messages.
pub(crate) const NOT_PLAUSIBLE: &str = "are not plausible as";
pub(crate) const OTHER_DAY: &str = "is taken as its day";
pub(crate) const OTHER_NAME: &str = "the date in the file name";

/// Remedy for implausible times.
pub(crate) const SAY_SCALE: &str = "set the time scale with the reader's key `recording_time`";

/// Interpretation of the times of a file.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Times {
    pub(crate) scale: TimeScale,
    /// Added to a time of the file, s.
    pub(crate) offset_s: f64,
    /// Period after which times of the file wrap around, s.
    pub(crate) period_s: Option<f64>,
    /// The GPS week of the first shot.
    pub(crate) gps_week: Option<u32>,
    /// Day of the first shot: (day of the year from 1, year).
    pub(crate) recorded: Option<(u16, u16)>,
    /// A note for the user.
    pub(crate) remark: Option<&'static str>,
}

/// Converts times of a file to times of the recording in sequence, unwrapping them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Axis {
    /// Added to times of the file, s; increases by one period at each wrap-around.
    pub(crate) offset_s: f64,
    period_s: Option<f64>,
    /// The last time, s; NaN before the first.
    last_s: f64,
}

/// Longest step across a wrap-around, s; any other backward step is a wrong time.
const LONGEST_STEP_S: f64 = 3600.0;

impl Axis {
    /// Converts the next time of the file, s.
    pub(crate) fn next(&mut self, of_file_s: f64) -> f64 {
        if let Some(period_s) = self.period_s {
            let step_s = of_file_s + self.offset_s + period_s - self.last_s;
            if (0.0..LONGEST_STEP_S).contains(&step_s) {
                self.offset_s += period_s;
            }
        }
        let time_s = of_file_s + self.offset_s;
        if !time_s.is_nan() {
            self.last_s = time_s;
        }
        time_s
    }
}

impl Times {
    /// Interprets times from their scale, the first time and the approximate date.
    ///
    /// `first_s`: time of the first shot in the file, if any; `about`: moment of the recording, to
    /// half a day for seconds of the day, to half a week for seconds of the week.
    pub(crate) fn new(scale: RecordedTimeScale, first_s: Option<f64>, about: Option<SinceEpoch>) -> Times {
        match scale {
            RecordedTimeScale::Week => Times::periodic(WEEK_S, TimeScale::Week, first_s, about),
            RecordedTimeScale::Day => Times::periodic(DAY_S, TimeScale::Day, first_s, about),
            RecordedTimeScale::Since(epoch) => Times {
                scale: TimeScale::Adjusted,
                offset_s: epoch - ADJUSTMENT_S,
                ..Times::dated(first_s.map(|s| epoch + s))
            },
            RecordedTimeScale::Unknown => Times { remark: Some(NO_SCALE), ..Times::dated(None) },
        }
    }

    /// The times as reported by a reader.
    pub(crate) fn as_said(info: &InputInfo) -> Times {
        let (scale, gps_week, recorded) = (info.time_scale, info.gps_week, info.recorded);
        Times { scale, gps_week, recorded, ..Times::dated(None) }
    }

    /// Starts the conversion of file times to recording times.
    pub(crate) fn axis(&self) -> Axis {
        Axis { offset_s: self.offset_s, period_s: self.period_s, last_s: f64::NAN }
    }

    /// Times that wrap around with this period.
    fn periodic(period_s: f64, scale: TimeScale, first_s: Option<f64>, about: Option<SinceEpoch>) -> Times {
        let Some(about) = about else {
            return Times { scale, period_s: Some(period_s), remark: Some(NO_WEEK), ..Times::dated(None) };
        };
        let first_s = first_s.unwrap_or(about.rem_euclid(period_s));
        // Of all moments with this time, take the nearest to the moment of the recording: this
        // corrects the date if the two lie on different sides of midnight.
        let period_begins = ((about - first_s) / period_s).round() * period_s;
        let week_begins = (period_begins / WEEK_S).floor() * WEEK_S;
        let offset_s = period_begins - week_begins;
        Times {
            scale: TimeScale::Week,
            offset_s,
            period_s: Some(period_s),
            ..Times::dated(Some(period_begins + first_s))
        }
        .of_week(week_begins)
    }

    /// The same times, later by `by_s`.
    pub(crate) fn later_by(self, by_s: f64) -> Times {
        Times { offset_s: self.offset_s + by_s, ..self }
    }

    /// GPS time minus UTC, s, for a recording in UTC that begins at external time `first_s`.
    ///
    /// # Errors
    /// The day is not known.
    pub(crate) fn leap_s(&self, file: &Path, first_s: Option<f64>) -> Result<f64> {
        let begins_s = self.scale_begins_s().and_then(|begins_s| Some(begins_s + first_s? + self.offset_s));
        let Some(begins_s) = begins_s else {
            let problem = "its times are UTC, but the day is unknown, and with it the number of leap seconds";
            return Err(Error::unusable(file, problem, NO_DAY).into());
        };
        Ok(leap_seconds(begins_s))
    }

    /// Offset from times of this scale to times of the recording, s.
    ///
    /// # Errors
    /// The time scale or the GPS week of the recording is unknown.
    pub(crate) fn shift_s(&self, scale: ScaleKey, file: &Path) -> Result<f64> {
        let week_s = || self.gps_week.map(|week| f64::from(week) * WEEK_S - ADJUSTMENT_S);
        let shift_s = match (scale, self.scale) {
            (ScaleKey::Week, TimeScale::Week) | (ScaleKey::Adjusted, TimeScale::Adjusted) => Some(0.0),
            (ScaleKey::Week, TimeScale::Adjusted) => week_s(),
            (ScaleKey::Adjusted, TimeScale::Week) => week_s().map(|week_s| -week_s),
            _ => None,
        };
        let problem = "`time_scale` needs the GPS week of the recording, which is unknown";
        Ok(shift_s.ok_or_else(|| Error::unusable(file, problem, NO_DAY))?)
    }

    /// Adjusted time at which the recording's time scale begins, s.
    fn scale_begins_s(&self) -> Option<f64> {
        match self.scale {
            TimeScale::Adjusted => Some(0.0),
            TimeScale::Week => self.gps_week.map(|week| f64::from(week) * WEEK_S - ADJUSTMENT_S),
            TimeScale::Day | TimeScale::Unknown => None,
        }
    }

    fn dated(first: Option<SinceEpoch>) -> Times {
        let week = first.map(|first| (first / WEEK_S).floor()).filter(|week| (0.0..1e5).contains(week));
        Times {
            scale: TimeScale::Unknown,
            offset_s: 0.0,
            period_s: None,
            gps_week: week.map(|week| week as u32),
            recorded: first
                .and_then(|first| day_of_year(first - ADJUSTMENT_S))
                .map(|(year, day)| (day, year)),
            remark: None,
        }
    }

    /// Sets the week in which seconds of the week begin.
    ///
    /// The first shot may lie after the end of that week.
    fn of_week(self, week_begins: SinceEpoch) -> Times {
        let week = week_begins / WEEK_S;
        Times { gps_week: (0.0..1e5).contains(&week).then_some(week as u32), ..self }
    }
}

const NO_DAY: &str = "set the day with the key `gps_date`, or remove the key";
const NO_SCALE: &str =
    "the time scale of the recording is unknown: no trajectory can be matched to its times";
const NO_WEEK: &str = "the GPS week is unknown: the file name does not begin with its date as in 130621_101500.sdf; \
                       set the day with the key `gps_date`";

/// Moment of a recording from its file name: `YYMMDD_HHMMSS`, with any suffix.
pub(crate) fn named(file: &Path) -> Option<SinceEpoch> {
    let name = file.file_stem()?.to_str()?;
    let (date, rest) = name.split_once('_')?;
    let time = rest.get(..6).filter(|_| !rest[6..].starts_with(|next: char| next.is_ascii_digit()))?;
    let [year, month, day] = pairs(date)?;
    let [hour, minute, second] = pairs(time)?;
    let year = if year < 80 { 2000 + year } else { 1900 + year };
    Some(midnight(year as i32, month, day)? + seconds(hour, minute, f64::from(second))?)
}

/// Noon of a day given as `YYYY-MM-DD`.
pub(crate) fn noon(date: &str) -> Option<SinceEpoch> {
    Some(day(date)? + 0.5 * DAY_S)
}

/// Parses an ISO 8601 date and time, with optional fraction and `Z`.
fn date_and_time(text: &str) -> Option<SinceEpoch> {
    let (date, time) = text.split_once(['T', ' '])?;
    let mut parts = time.trim_end_matches('Z').splitn(3, ':');
    let mut whole = || number(parts.next()?, 2);
    let (hour, minute) = (whole()?, whole()?);
    let second: f64 = parts.next()?.parse().ok()?;
    Some(day(date)? + seconds(hour, minute, second)?)
}

fn day(date: &str) -> Option<SinceEpoch> {
    let mut parts = date.splitn(3, '-');
    let year = number(parts.next()?, 4)?;
    midnight(year as i32, number(parts.next()?, 2)?, number(parts.next()?, 2)?)
}

fn midnight(year: i32, month: u32, day: u32) -> Option<SinceEpoch> {
    let (week, day_of_week) = gps_week(year, month, day)?;
    let is_date = is_date([year.into(), month.into(), day.into()]);
    is_date.then(|| f64::from(week) * WEEK_S + f64::from(day_of_week) * DAY_S)
}

fn seconds(hour: u32, minute: u32, second: f64) -> Option<f64> {
    let is_time = hour < 24 && minute < 60 && (0.0..61.0).contains(&second);
    is_time.then(|| f64::from(3600 * hour + 60 * minute) + second)
}

/// Parses three numbers of two digits.
fn pairs(text: &str) -> Option<[u32; 3]> {
    let [a, b, c] = [0, 2, 4].map(|at| text.get(at..at + 2).and_then(|pair| number(pair, 2)));
    (text.len() == 6).then_some([a?, b?, c?])
}

fn number(text: &str, digits: usize) -> Option<u32> {
    let plain = text.len() == digits && text.bytes().all(|byte| byte.is_ascii_digit());
    plain.then(|| text.parse().ok()).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times_of(epoch: &str, first_s: Option<f64>, about: Option<SinceEpoch>) -> Times {
        Times::new(RecordedTimeScale::of_epoch(epoch), first_s, about)
    }

    /// 2013-06-21: Friday of GPS week 1745.
    const FRIDAY: f64 = 1745.0 * WEEK_S + 5.0 * DAY_S;

    #[test]
    fn a_name_begins_with_its_date_and_time() {
        let at = |name: &str| named(Path::new(name));
        assert_eq!(at("in/130621_101500.sdf"), Some(FRIDAY + 36_900.0));
        assert_eq!(at("130621_101500_1.sdf"), at("130621_101500.wfm"));
        assert_eq!(at("130621_101500_line 4.sdf"), at("130621_101500.sdf"));
        assert_eq!(at("940102_000000.sdf"), Some(730.0 * WEEK_S), "of the 20th century");
        for other in [
            "flight.sdf",
            "130621.sdf",
            "130621_1015.sdf",
            "130621_1015000.sdf",
            "131321_101500.sdf",
            "130631_101500.sdf",
            "130229_101500.sdf",
            "130621_241500.sdf",
            "1306x1_101500.sdf",
            "130621_ä0150.sdf",
            "800101_000000.sdf",
        ] {
            assert_eq!(at(other), None, "{other}");
        }
    }

    #[test]
    fn seconds_of_the_week_take_the_nearest_week() {
        let times = |first, about| times_of("WEEKSEC", Some(first), Some(about));
        let friday = times(5.0 * DAY_S + 36_901.5, FRIDAY + 36_900.0);
        assert_eq!((friday.scale, friday.offset_s, friday.gps_week), (TimeScale::Week, 0.0, Some(1745)));
        assert_eq!((friday.recorded, friday.remark), (Some((172, 2013)), None));
        // The name is one second before Sunday midnight and the first shot one second after it, and
        // vice versa.
        let sunday = 1745.0 * WEEK_S;
        assert_eq!(times(1.0, sunday - 1.0).gps_week, Some(1745));
        assert_eq!(times(WEEK_S - 1.0, sunday + 1.0).gps_week, Some(1744));
        // A clock that runs on past the end of the week.
        assert_eq!(times(WEEK_S + 1.0, sunday + 1.0).gps_week, Some(1744));
    }

    #[test]
    fn seconds_of_a_known_day_become_those_of_the_week() {
        let times = times_of("DAYSEC", Some(2.0), Some(FRIDAY - 1.0));
        assert_eq!((times.scale, times.offset_s, times.gps_week), (TimeScale::Week, 5.0 * DAY_S, Some(1745)));
        assert_eq!(times.recorded, Some((172, 2013)));
        let unknown = times_of("DAYSEC", Some(2.0), None);
        assert_eq!((unknown.scale, unknown.gps_week, unknown.remark), (TimeScale::Day, None, Some(NO_WEEK)));
    }

    #[test]
    fn a_date_and_time_gives_adjusted_seconds() {
        let times = times_of("2013-06-21T00:00:00", Some(7.5), None);
        assert_eq!((times.scale, times.offset_s), (TimeScale::Adjusted, FRIDAY - 1e9));
        assert_eq!((times.gps_week, times.recorded), (Some(1745), Some((172, 2013))));
        assert_eq!(times_of("2011-09-14T01:46:40.0Z", None, None).offset_s, 0.0);
    }

    #[test]
    fn what_is_not_known_stays_so() {
        for epoch in ["UNKNOWN", "", "2013-06-21", "2013-06-31T00:00:00", "2013-06-21T00:61:00", "tomorrow T"]
        {
            let times = times_of(epoch, Some(1.0), Some(FRIDAY));
            assert_eq!((times.scale, times.gps_week), (TimeScale::Unknown, None), "{epoch}");
            assert_eq!(times.remark, Some(NO_SCALE));
        }
        assert_eq!(times_of("WEEKSEC", Some(1.0), None).remark, Some(NO_WEEK));
    }

    #[test]
    fn without_a_time_the_name_alone_dates_a_recording() {
        let times = times_of("WEEKSEC", None, Some(FRIDAY + 36_900.0));
        assert_eq!((times.gps_week, times.recorded, times.offset_s), (Some(1745), Some((172, 2013)), 0.0));
        assert_eq!(times_of("DAYSEC", None, Some(FRIDAY + 36_900.0)).offset_s, 5.0 * DAY_S);
    }

    #[test]
    fn noon_is_that_of_the_day() {
        assert_eq!(noon("2013-06-21"), Some(FRIDAY + 43_200.0));
        assert_eq!(noon("2013-6-21"), None);
        assert_eq!(other_day(noon("2013-06-22"), Some(FRIDAY)), None);
        let apart = other_day(noon("2012-06-21"), Some(FRIDAY)).unwrap();
        assert!(apart.contains("are 364 days apart"), "{apart}");
        assert_eq!(noon("21.06.2013"), None);
    }
}
