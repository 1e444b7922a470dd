//! Statistics of short lists, and values with their standard deviations.

/// A value with its standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WithSd {
    /// The value.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
}

impl WithSd {
    /// An unknown value.
    pub const UNKNOWN: WithSd = WithSd { value: f64::NAN, sd: f64::NAN };
}

/// Returns the median; of an even number of values the upper of the middle two, of none `None`.
///
/// Sorts NaN after all numbers.
pub fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let middle = values.len() / 2;
    (middle < values.len()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn median_is_the_upper_of_the_middle_two() {
        assert_eq!(median([3.0, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([4.0, 1.0, 3.0, 2.0]), Some(3.0));
        assert_eq!(median([f64::NAN, 1.0, 2.0]), Some(2.0));
        assert_eq!(median([]), None);
    }
}
