//! Histogram of whole numbers.

/// Counts by value.
#[derive(Debug, Clone, Default)]
pub(super) struct Histogram {
    counts: Vec<u64>,
}

impl Histogram {
    pub(super) fn add(&mut self, value: u16) {
        let index = usize::from(value);
        if index >= self.counts.len() {
            self.counts.resize(index + 1, 0);
        }
        self.counts[index] += 1;
    }

    /// Number of values.
    pub(super) fn count(&self) -> u64 {
        self.counts.iter().sum()
    }

    /// Quantile of the values before rounding; each count is spread over half a step to either
    /// side. 0 without values.
    pub(super) fn quantile(&self, part: f64) -> f64 {
        let mut left = part * self.count() as f64;
        for (value, &count) in self.counts.iter().enumerate() {
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
        [3, 3, 4, 4].iter().for_each(|&v| histogram.add(v));
        assert_eq!(histogram.quantile(0.5), 3.5);
        assert_eq!(histogram.quantile(0.25), 3.0);
        assert_eq!(histogram.quantile(1.0), 4.5);
        assert_eq!(histogram.count(), 4);
    }
}
