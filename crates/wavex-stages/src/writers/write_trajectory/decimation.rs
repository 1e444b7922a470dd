//! Decimation: selects the shots that get a row.

use wavex_line::scan_line::Emission;

/// Counts shots or time since the last row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pace {
    every: Option<u64>,
    interval_s: f64,
    /// Shots since the last selected one.
    since: u64,
    /// Time of the last selected shot, s.
    last_s: Option<f64>,
}

/// Default time between rows, s.
pub(super) const INTERVAL_S: f64 = 0.1;

impl Pace {
    pub(super) fn new(every: Option<u64>, interval_s: Option<f64>) -> Pace {
        Pace { every, interval_s: interval_s.unwrap_or(INTERVAL_S), since: 0, last_s: None }
    }

    /// Whether the next shot is selected; the first is. Restarts if the clock runs backwards.
    pub(super) fn is_due(&mut self, emission: &Emission) -> bool {
        let time_s = emission.time_s();
        let is_due = match self.last_s {
            None => true,
            Some(last_s) => self.is_over(self.since, time_s - last_s) || time_s < last_s,
        };
        if is_due {
            self.last_s = Some(time_s);
            self.since = 0;
        }
        self.since += 1;
        is_due
    }

    /// Whether this number of shots, or this time, reaches the next row.
    pub(super) fn is_over(&self, shots: u64, elapsed_s: f64) -> bool {
        // The tolerance of 1 ns is below the rounding of times.
        self.every.map_or(elapsed_s >= self.interval_s - 1e-9, |every| shots >= every)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::writers::write_trajectory::WriteTrajectory;
    use wavex_line::stage::Config;

    #[test]
    fn the_time_from_row_to_row_is_spelled_out() {
        let pace = |keys: &str| {
            let mut config: WriteTrajectory = toml::from_str(keys).unwrap();
            config.spell_out();
            (config.interval_s, config.every)
        };
        assert_eq!(pace(""), (Some(0.1), None));
        assert_eq!(pace("interval_s = 2"), (Some(2.0), None));
        assert_eq!(pace("every = 3"), (None, Some(3)));
    }

    fn due(mut pace: Pace, times_s: &[f64]) -> Vec<f64> {
        let shot = |&gps_time_s: &f64| Emission { gps_time_s, ..Emission::default() };
        times_s.iter().filter(|time_s| pace.is_due(&shot(time_s))).copied().collect()
    }

    #[test]
    fn rows_come_by_time_or_by_number() {
        let times: Vec<f64> = (0..40).map(|k| 7.0 + f64::from(k) * 0.01).collect();
        assert_eq!(due(Pace::new(None, None), &times), [times[0], times[10], times[20], times[30]]);
        assert_eq!(due(Pace::new(None, Some(0.15)), &times), [times[0], times[15], times[30]]);
        assert_eq!(due(Pace::new(Some(16), None), &times), [times[0], times[16], times[32]]);
        assert_eq!(due(Pace::new(None, Some(0.0)), &times), times);
        assert_eq!(
            due(Pace::new(None, Some(9.0)), &[5.0, 6.0, 2.0, 3.0]),
            [5.0, 2.0],
            "the clock ran backwards"
        );
    }

    #[test]
    fn without_gps_time_the_clock_counts() {
        let shot = Emission { clock_ps: 2_500_000_000_000, ..Emission::default() };
        assert_eq!(shot.time_s(), 2.5);
        assert_eq!(Emission { gps_time_s: 1.5, ..shot }.time_s(), 1.5);
    }
}
