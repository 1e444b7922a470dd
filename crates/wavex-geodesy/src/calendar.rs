//! Proleptic Gregorian calendar: dates as `[year, month, day]`, and day numbers since 1970-01-01.
//!
//! Algorithms: H. Hinnant, "chrono-compatible low-level date algorithms".

/// Days from 0000-03-01, on which the first period of 400 years starts, to 1970-01-01.
const EPOCH_DAY: i64 = 719_468;
/// Days of 400 years.
const PERIOD_DAYS: i64 = 146_097;

/// Number of a day, 0 on 1970-01-01.
///
/// An invalid date gets the number of another date: see [`is_date`].
///
/// # Examples
///
/// ```
/// use wavex_geodesy::calendar::{date_of_day, day_number};
///
/// assert_eq!(day_number([1980, 1, 6]), 3657);
/// assert_eq!(date_of_day(3657), [1980, 1, 6]);
/// ```
pub const fn day_number([year, month, day]: [i64; 3]) -> i64 {
    // Years start in March, so the leap day is the last one.
    let (year, month) = if month > 2 { (year, month - 3) } else { (year - 1, month + 9) };
    365 * year + year.div_euclid(4) - year.div_euclid(100)
        + year.div_euclid(400)
        + (153 * month + 2) / 5
        + day
        - 1
        - EPOCH_DAY
}

/// Date of a day by its number, the inverse of [`day_number`].
pub fn date_of_day(number: i64) -> [i64; 3] {
    let days = number + EPOCH_DAY;
    let (period, day) = (days.div_euclid(PERIOD_DAYS), days.rem_euclid(PERIOD_DAYS));
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day = day - (153 * month + 2) / 5 + 1;
    let year = 400 * period + year;
    if month < 10 { [year, month + 3, day] } else { [year + 1, month - 9, day] }
}

/// Whether the calendar has a date.
pub fn is_date(date: [i64; 3]) -> bool {
    date_of_day(day_number(date)) == date
}

/// Day of the year, from 1, of a valid date.
pub fn day_of_year(date: [i64; 3]) -> i64 {
    day_number(date) - day_number([date[0], 1, 1]) + 1
}

/// Date of a day of the year, from 1; `None` if the year has no such day.
pub fn date_in_year(year: i64, day: i64) -> Option<[i64; 3]> {
    let date = date_of_day(day_number([year, 1, 1]) + day - 1);
    (date[0] == year).then_some(date)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn day_numbers_and_dates_are_inverse() {
        let mut date = [-401, 1, 1];
        for number in day_number(date)..day_number([2401, 1, 1]) {
            assert_eq!((date_of_day(number), day_number(date)), (date, number));
            let [year, month, day] = date;
            let is_leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
            let february = if is_leap { 29 } else { 28 };
            let length = [31, february, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31][month as usize - 1];
            date = match (day < length, month < 12) {
                (true, _) => [year, month, day + 1],
                (false, true) => [year, month + 1, 1],
                (false, false) => [year + 1, 1, 1],
            };
        }
        assert_eq!(day_number([1970, 1, 1]), 0);
    }

    #[test]
    fn invalid_dates_are_recognised() {
        for date in [[2013, 2, 29], [1900, 2, 29], [2013, 0, 1], [2013, 13, 1], [2013, 4, 31], [2013, 4, 0]] {
            assert!(!is_date(date), "{date:?}");
        }
        assert!([[2012, 2, 29], [2000, 2, 29], [2013, 12, 31]].into_iter().all(is_date));
    }

    #[test]
    fn days_of_the_year_have_dates() {
        assert_eq!(
            (date_in_year(2013, 60), date_in_year(2012, 60)),
            (Some([2013, 3, 1]), Some([2012, 2, 29]))
        );
        assert_eq!([date_in_year(2013, 0), date_in_year(2013, 366)], [None, None]);
        assert_eq!([[2013, 1, 1], [2013, 12, 31], [2012, 12, 31]].map(day_of_year), [1, 365, 366]);
    }
}
