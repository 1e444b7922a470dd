//! Times of the shots: span, date, and shots per time.

use std::collections::BTreeMap;
use std::time::{Duration, SystemTime};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_geodesy::time::{ADJUSTMENT_S, utc};
use wavex_line::scan_line::{InputInfo, ScanLine};
use wavex_line::stage::packed;

/// Times of the shots of an input.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
pub struct TimeCoverage {
    /// Earliest and latest time of a shot on the scale of the recording, s.
    pub span_s: [f64; 2],
    /// The same as ISO 8601 on the GPS time scale, without leap seconds, if the week is known.
    pub gps_dates: Option<[String; 2]>,
    /// Width of a bin, s; a power of two.
    pub bin_s: f64,
    /// Bins with shots: their numbers from that of the earliest shot, separated by spaces.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub bins: Vec<u64>,
    /// Number of shots in each of these bins.
    #[serde(serialize_with = "packed::serialize", deserialize_with = "packed::deserialize")]
    #[schemars(with = "String")]
    pub shots: Vec<u64>,
}

/// Maximum number of bins with shots.
const MOST_BINS: usize = 512;
/// Binary logarithm of the smallest bin, s.
const SMALLEST_BIN: i32 = -10;
/// Seconds from the Unix epoch to the GPS epoch.
const GPS_EPOCH_S: f64 = 315_964_800.0;
/// Latest valid time, s.
const LATEST_S: f64 = 1e11;

/// Shots by time; bins double their width whenever there are too many.
#[derive(Clone, Debug, Default)]
pub(super) struct TimeCounts {
    input: Option<std::sync::Arc<InputInfo>>,
    span_s: Option<[f64; 2]>,
    /// Doublings of the smallest width.
    doublings: i32,
    bins: BTreeMap<i64, u64>,
}

impl TimeCounts {
    pub(super) fn add(&mut self, scan_line: &ScanLine) {
        self.input.get_or_insert_with(|| scan_line.input.clone());
        scan_line.emissions.iter().for_each(|emission| self.count(emission.gps_time_s));
    }

    /// Counts a shot; skips times that are unknown or invalid.
    fn count(&mut self, time_s: f64) {
        if time_s.is_nan() || time_s.abs() >= LATEST_S {
            return;
        }
        let time_s = time_s + 0.0;
        let [first_s, last_s] = self.span_s.get_or_insert([time_s; 2]);
        (*first_s, *last_s) = (first_s.min(time_s), last_s.max(time_s));
        let bin = (time_s / self.bin_s()).floor() as i64;
        *self.bins.entry(bin).or_default() += 1;
        while self.bins.len() > MOST_BINS {
            self.doublings += 1;
            let mut merged = BTreeMap::new();
            self.bins.iter().for_each(|(bin, shots)| *merged.entry(bin >> 1).or_default() += shots);
            self.bins = merged;
        }
    }

    fn bin_s(&self) -> f64 {
        f64::from(SMALLEST_BIN + self.doublings).exp2()
    }

    /// Earliest and latest time, s.
    pub(super) fn span_s(&self) -> Option<[f64; 2]> {
        self.span_s
    }

    /// Returns the coverage; `None` if no shot has a time.
    pub(super) fn finish(self) -> Option<TimeCoverage> {
        let (bin_s, span_s) = (self.bin_s(), self.span_s?);
        let first = *self.bins.keys().next()?;
        let date = |time_s: f64| gps_date(self.input.as_ref()?.adjusted_gps_time(time_s)?);
        Some(TimeCoverage {
            span_s,
            gps_dates: date(span_s[0]).zip(date(span_s[1])).map(|(from, until)| [from, until]),
            bin_s,
            bins: self.bins.keys().map(|bin| bin.abs_diff(first)).collect(),
            shots: self.bins.into_values().collect(),
        })
    }
}

/// Date and time of an adjusted GPS time, without leap seconds.
fn gps_date(adjusted_s: f64) -> Option<String> {
    let since = Duration::try_from_secs_f64(adjusted_s + ADJUSTMENT_S + GPS_EPOCH_S).ok()?;
    let text = utc(SystemTime::UNIX_EPOCH.checked_add(since)?);
    Some(text.trim_end_matches('Z').to_owned())
}

impl TimeCoverage {
    /// Longest time without shots, in whole bins, s.
    pub fn longest_gap_s(&self) -> f64 {
        let empty = self.bins.windows(2).map(|pair| pair[1].saturating_sub(pair[0]).saturating_sub(1));
        empty.max().unwrap_or(0) as f64 * self.bin_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(times_s: impl Iterator<Item = f64>) -> Option<TimeCoverage> {
        let mut counted = TimeCounts::default();
        times_s.for_each(|time_s| counted.count(time_s));
        counted.finish()
    }

    #[test]
    fn bins_double_and_lose_nothing() {
        let times = || (0..2000).map(|i| 100.0 + 0.01 * f64::from(i)).chain([130.0]);
        let found = of(times()).unwrap();
        assert_eq!((found.span_s, found.shots.iter().sum::<u64>()), ([100.0, 130.0], 2001));
        assert!(found.bins.len() <= MOST_BINS && found.bins.len() > MOST_BINS / 4, "{}", found.bins.len());
        assert!((found.longest_gap_s() - 10.0).abs() < 0.1, "{}", found.longest_gap_s());
        assert_eq!(
            Some(found),
            of(times().collect::<Vec<_>>().into_iter().rev()),
            "independent of the order"
        );
    }

    #[test]
    fn shots_without_time_are_skipped() {
        assert_eq!(of([f64::NAN, 1e300, f64::INFINITY].into_iter()), None);
        assert_eq!(of([f64::NAN, 2.0].into_iter()).map(|found| found.shots), Some(vec![1]));
    }

    #[test]
    fn dates_are_those_of_gps_time() {
        assert_eq!(gps_date(0.0).as_deref(), Some("2011-09-14T01:46:40"));
        assert_eq!(gps_date(-1e10), None);
    }
}
