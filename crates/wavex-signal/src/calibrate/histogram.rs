//! Histogram of whole numbers.

use std::iter::repeat_n;

/// Counts by value.
#[derive(Debug, Clone, Default)]
pub(super) struct Histogram {
    /// Value of the first count.
    first: usize,
    counts: Vec<u64>,
}

impl Histogram {
    pub(super) fn add(&mut self, value: u16) {
        let value = usize::from(value);
        if !(self.first..self.first + self.counts.len()).contains(&value) {
            self.extend_to(value);
        }
        self.counts[value - self.first] += 1;
    }

    #[cold]
    fn extend_to(&mut self, value: usize) {
        if self.counts.is_empty() {
            self.first = value;
        }
        if value < self.first {
            // At least twice as many as before, because all of them move.
            let first = value.min(self.first.saturating_sub(self.counts.len()));
            self.counts.splice(0..0, repeat_n(0, self.first - first));
            self.first = first;
        }
        self.counts.resize(self.counts.len().max(value + 1 - self.first), 0);
    }

    /// Number of values.
    pub(super) fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Quantile of the values before rounding; each count is spread over half a step to either
    /// side. 0 without values.
    pub(super) fn quantile(&self, part: f64) -> f64 {
        let mut left = part * self.count() as f64;
        for (value, &count) in (self.first..).zip(&self.counts) {
            let count = count as f64;
            if count > 0.0 && left <= count {
                return value as f64 - 0.5 + left / count;
            }
            left -= count;
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_lie_between_whole_numbers() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.quantile(0.5), 0.0);
        [4, 3, 4, 3].iter().for_each(|&v| histogram.add(v));
        assert_eq!(histogram.quantile(0.5), 3.5);
        assert_eq!(histogram.quantile(0.25), 3.0);
        assert_eq!(histogram.quantile(1.0), 4.5);
        assert_eq!(histogram.count(), 4);
        [200, 0, u16::MAX].iter().for_each(|&v| histogram.add(v));
        let quantiles =
            [1.0 / 7.0, 3.0 / 7.0, 5.0 / 7.0, 6.0 / 7.0, 1.0].map(|part| histogram.quantile(part));
        assert_eq!(quantiles, [0.5, 3.5, 4.5, 200.5, 65_535.5]);
    }
}
