//! Dates and time scales of a recording, with their evidence.

use wavex_geodesy::time::{self, WEEKDAYS};
use wavex_line::scan_line::{InputInfo, TimeScale};
use wavex_stages::reading::recording::possible_scales;

/// Date of the recording, or of its file, with its day of the week.
pub(super) fn recorded(input: &InputInfo) -> Option<String> {
    let (day, year) = input.recorded?;
    let weekday = WEEKDAYS[time::weekday_of(year, day)];
    let of_file = if input.is_file_date { ": creation of the file, not the flight" } else { "" };
    Some(format!("day {day} of {year}, a {weekday}{of_file}"))
}

/// Time scale of the shots, with its evidence.
pub(super) fn time_scale(input: &InputInfo, first_s: Option<f64>) -> String {
    let week = input.gps_week.map_or(String::new(), |week| format!(", GPS week {week}"));
    let Some(scale) = input.time_scale.words() else {
        let values = first_s.map(|first_s| format!(": {}", possible_scales(first_s))).unwrap_or_default();
        return format!(
            "unknown: the file does not state it, and its times do not show it; set `recording_time`{values}"
        );
    };
    let evidence = match input.time_scale_is_inferred {
        true => "; assumed from the size of the times: the file states no scale, nor GPS time or UTC",
        false => "",
    };
    format!("{scale}{week}{evidence}")
}

/// Day of the week by seconds of the GPS week, compared with the weekday of the date.
pub(super) fn weekday_of_times(input: &InputInfo, first_s: f64) -> Option<String> {
    if input.time_scale != TimeScale::Week || !first_s.is_finite() {
        return None;
    }
    let of_times = time::weekday(first_s);
    let by = format!("{} by the seconds of the week", WEEKDAYS[of_times]);
    // The date of a recording may be local: neighbouring days agree.
    let differs = |day: &usize| match input.is_file_date {
        true => *day != of_times,
        false => (2..=5).contains(&((*day + 7 - of_times) % 7)),
    };
    let of_date = input.recorded.map(|(day, year)| time::weekday_of(year, day)).filter(differs);
    Some(match (of_date, input.is_file_date) {
        (None, _) => by,
        (Some(day), true) => format!("{by}; the file was created on a {}", WEEKDAYS[day]),
        (Some(day), false) => format!(
            "{by}, but the date is a {}: one of them is wrong; set `gps_date` or `recording_time`",
            WEEKDAYS[day]
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_and_time_scales_say_their_evidence() {
        // Day 172 of 2013 is Friday, 21 June; 302 400 s of the week are on Wednesday noon.
        let input = InputInfo {
            recorded: Some((172, 2013)),
            is_file_date: true,
            time_scale: TimeScale::Week,
            time_scale_is_inferred: true,
            ..InputInfo::default()
        };
        assert!(recorded(&input).unwrap().ends_with("a Friday: creation of the file, not the flight"));
        assert!(
            time_scale(&input, None).contains("assumed from the size of the times"),
            "{}",
            time_scale(&input, None)
        );
        let weekday = |input: &InputInfo, first_s| weekday_of_times(input, first_s).unwrap();
        let expected = "Wednesday by the seconds of the week; the file was created on a Friday";
        assert_eq!(weekday(&input, 302_400.0), expected);
        let dated = InputInfo { is_file_date: false, time_scale_is_inferred: false, ..input.clone() };
        assert_eq!(recorded(&dated).unwrap(), "day 172 of 2013, a Friday");
        assert_eq!(time_scale(&dated, None), "seconds of the GPS week");
        assert!(weekday(&dated, 302_400.0).contains("but the date is a Friday: one of them is wrong"));
        assert_eq!(weekday(&dated, 5.5 * 86_400.0), "Friday by the seconds of the week");
        let adjusted = InputInfo { time_scale: TimeScale::Adjusted, ..input };
        assert_eq!(weekday_of_times(&adjusted, 302_400.0), None);
        let unknown = InputInfo::default();
        let expected = "; set `recording_time`: \"adjusted\" (2043-05-23) or \"standard\" (2011-09-14)";
        let said = time_scale(&unknown, Some(1_000_061_758.0));
        assert!(said.ends_with(expected) && recorded(&unknown).is_none(), "{said}");
    }
}
