//! Rates and durations in words.

/// Rate of shots with two significant digits or more: `96 shots/s`, `8.3 k shots/s`, `1.2 M shots/s`.
pub fn rate(shots_per_s: f64) -> String {
    let (value, prefix) = match shots_per_s {
        // 999.6 is rounded to 1000.
        999_500.0.. => (shots_per_s / 1e6, "M "),
        999.5.. => (shots_per_s / 1e3, "k "),
        _ => (shots_per_s, ""),
    };
    let digits = usize::from(value < 9.95);
    format!("{value:.digits$} {prefix}shots/s")
}

/// Duration with the precision of a glance: `0.8 s`, `42 s`, `3 min`, `2.5 h`.
pub(super) fn duration(seconds: f64) -> String {
    match seconds {
        5_400.0.. => format!("{:.1} h", seconds / 3600.0),
        99.5.. => format!("{:.0} min", seconds / 60.0),
        9.95.. => format!("{seconds:.0} s"),
        _ => format!("{seconds:.1} s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_have_two_digits_or_more() {
        let rates = [0.42, 9.6, 96.4, 999.4, 999.6, 8_310.0, 15_400.0, 999_600.0, 1_234_000.0, 54_000_000.0];
        let words = rates.map(rate);
        let expected = [
            "0.4 shots/s",
            "9.6 shots/s",
            "96 shots/s",
            "999 shots/s",
            "1.0 k shots/s",
            "8.3 k shots/s",
            "15 k shots/s",
            "1.0 M shots/s",
            "1.2 M shots/s",
            "54 M shots/s",
        ];
        assert_eq!(words, expected);
    }

    #[test]
    fn durations_change_their_unit() {
        let words = [0.84, 9.96, 42.4, 180.0, 9_000.0].map(duration);
        assert_eq!(words, ["0.8 s", "10 s", "42 s", "3 min", "2.5 h"]);
    }
}
