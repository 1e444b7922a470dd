//! Histograms of unknown range, whose bins double in width as needed.
//!
//! The histograms of a run's overview are separate: their bins are fixed, and a common implementation
//! would change the bins and quantiles of one of them.

/// Values are clamped to this distance from zero.
const FARTHEST: f64 = 1e15;

/// Counts in bins of equal width, on a grid with an edge at 0.
///
/// Bins are merged in pairs whenever the values would need more than `most_bins`. The result
/// depends only on the values, not on their order.
#[derive(Clone, Debug, PartialEq)]
pub struct GrowingHistogram {
    width: f64,
    most_bins: usize,
    /// For whole numbers: a bin of width 1 holds one of them, which is its centre.
    whole: bool,
    /// Index of the first bin, which starts at `first * width`.
    first: i64,
    counts: Vec<u64>,
    total: u64,
    least: f64,
    largest: f64,
}

impl GrowingHistogram {
    /// Bins of initially `width`, at most `most_bins` (2 or more).
    pub fn new(width: f64, most_bins: usize) -> GrowingHistogram {
        GrowingHistogram {
            width,
            most_bins: most_bins.max(2),
            whole: false,
            first: 0,
            counts: Vec::new(),
            total: 0,
            least: f64::INFINITY,
            largest: f64::NEG_INFINITY,
        }
    }

    /// For whole numbers, each in its own bin as long as `most_bins` suffice.
    pub fn of_whole_numbers(most_bins: usize) -> GrowingHistogram {
        GrowingHistogram { whole: true, ..GrowingHistogram::new(1.0, most_bins) }
    }

    /// Counts a value; NaN is ignored.
    pub fn add(&mut self, value: f64) {
        if value.is_nan() {
            return;
        }
        let value = value.clamp(-FARTHEST, FARTHEST);
        self.total += 1;
        self.least = self.least.min(value);
        self.largest = self.largest.max(value);
        let mut bin = (value / self.width).floor() as i64;
        if self.counts.is_empty() {
            self.first = bin;
        }
        while self.span_with(bin) > self.most_bins as i64 {
            self.merge_pairs();
            bin = bin.div_euclid(2);
        }
        if bin < self.first {
            let missing = (self.first - bin) as usize;
            self.counts.splice(0..0, std::iter::repeat_n(0, missing));
            self.first = bin;
        }
        let at = (bin - self.first) as usize;
        if at >= self.counts.len() {
            self.counts.resize(at + 1, 0);
        }
        self.counts[at] += 1;
    }

    /// Number of bins needed to include this one.
    fn span_with(&self, bin: i64) -> i64 {
        let last = self.first + self.counts.len() as i64 - 1;
        last.max(bin) - self.first.min(bin) + 1
    }

    fn merge_pairs(&mut self) {
        let first = self.first.div_euclid(2);
        let mut merged: Vec<u64> = Vec::with_capacity(self.counts.len() / 2 + 1);
        for (bin, count) in (self.first..).zip(&self.counts) {
            let at = (bin.div_euclid(2) - first) as usize;
            if at >= merged.len() {
                merged.push(0);
            }
            merged[at] += count;
        }
        (self.first, self.counts, self.width) = (first, merged, 2.0 * self.width);
    }

    /// Number of values counted.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// Whether no value was counted.
    pub fn is_empty(&self) -> bool {
        self.total == 0
    }

    /// Bin width.
    pub fn width(&self) -> f64 {
        self.width
    }

    /// Smallest and largest value.
    pub fn range(&self) -> Option<[f64; 2]> {
        (self.total > 0).then_some([self.least, self.largest])
    }

    /// Centre and count of the bins in ascending order, including empty ones.
    pub fn bins(&self) -> impl ExactSizeIterator<Item = (f64, u64)> + Clone + '_ {
        let shift = if self.whole { 0.5 } else { 0.0 };
        let centre = move |at: usize| ((self.first + at as i64) as f64 + 0.5) * self.width - shift;
        self.counts.iter().enumerate().map(move |(at, &count)| (centre(at), count))
    }

    /// Quantile for a fraction from 0 to 1, to the width of a bin; `None` without values.
    ///
    /// Linear within a bin; for whole numbers, the number itself.
    pub fn quantile(&self, part: f64) -> Option<f64> {
        let range = self.range()?;
        let mut left = part.clamp(0.0, 1.0) * self.total as f64;
        for (centre, count) in self.bins() {
            let count = count as f64;
            if count > 0.0 && left <= count {
                let within =
                    if self.whole { centre.round() } else { centre + self.width * (left / count - 0.5) };
                return Some(within.clamp(range[0], range[1]));
            }
            left -= count;
        }
        Some(range[1])
    }

    /// Median; `None` without values.
    pub fn median(&self) -> Option<f64> {
        self.quantile(0.5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn of(width: f64, most_bins: usize, values: &[f64]) -> GrowingHistogram {
        let mut histogram = GrowingHistogram::new(width, most_bins);
        values.iter().for_each(|&value| histogram.add(value));
        histogram
    }

    #[test]
    fn bins_double_where_values_spread() {
        let mut histogram = of(1.0, 4, &[-0.5, 0.5, 1.5, 1.6]);
        assert_eq!(histogram.bins().collect::<Vec<_>>(), [(-0.5, 1), (0.5, 1), (1.5, 2)]);
        histogram.add(3.5);
        assert_eq!(histogram.bins().collect::<Vec<_>>(), [(-1.0, 1), (1.0, 3), (3.0, 1)]);
        assert_eq!((histogram.width(), histogram.total()), (2.0, 5));
        assert_eq!(histogram.range(), Some([-0.5, 3.5]));
    }

    #[test]
    fn quantiles_are_linear_within_a_bin_and_whole_numbers_themselves() {
        let histogram = of(10.0, 8, &[0.0, 4.0, 6.0, 10.0]);
        assert_eq!(histogram.quantile(0.375), Some(5.0));
        assert_eq!(histogram.quantile(1.0), Some(10.0), "never above the largest value");
        let mut whole = GrowingHistogram::of_whole_numbers(8);
        [40.0, 40.0, 41.0].into_iter().for_each(|value| whole.add(value));
        assert_eq!((whole.median(), whole.quantile(1.0)), (Some(40.0), Some(41.0)));
        assert_eq!(whole.bins().collect::<Vec<_>>(), [(40.0, 2), (41.0, 1)]);
        (0..8).for_each(|value| whole.add(f64::from(value)));
        assert_eq!(whole.bins().next(), Some((3.5, 8)), "eight numbers in one bin: 0 to 7");
    }

    #[test]
    fn empty_histograms_have_no_statistics() {
        let histogram = of(1.0, 4, &[f64::NAN]);
        assert_eq!((histogram.total(), histogram.range(), histogram.median()), (0, None, None));
        assert!(histogram.is_empty());
    }

    #[test]
    fn no_value_is_too_large() {
        let histogram = of(1e-3, 16, &[f64::INFINITY, f64::NEG_INFINITY, 0.0]);
        assert_eq!(histogram.total(), 3);
        assert!(histogram.bins().len() <= 16);
    }

    proptest! {
        #[test]
        fn the_order_of_values_does_not_matter(mut values in prop::collection::vec(-1e6f64..1e6, 1..60)) {
            let there = of(0.25, 16, &values);
            values.reverse();
            prop_assert_eq!(&there, &of(0.25, 16, &values));
            prop_assert_eq!(there.bins().map(|bin| bin.1).sum::<u64>(), values.len() as u64);
            prop_assert!(there.bins().len() <= 16);
        }
    }
}
