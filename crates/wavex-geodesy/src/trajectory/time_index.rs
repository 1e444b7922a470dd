//! Constant-time lookup in a long list of ascending times.

/// Ascending times with an index over equal parts of their span.
///
/// There are as many parts as times. Records at an even rate have one per part; with gaps, some
/// parts have a few more.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct TimeIndex {
    times_s: Vec<f64>,
    parts_per_s: f64,
    /// `starts[k]` is the number of times before part k.
    starts: Vec<u32>,
}

impl TimeIndex {
    /// Index of finite, strictly ascending times: at least two, at most `u32::MAX`.
    pub(super) fn new(times_s: Vec<f64>) -> TimeIndex {
        let parts = times_s.len();
        let span_s = times_s[parts - 1] - times_s[0];
        let parts_per_s = parts as f64 / span_s;
        let mut index = TimeIndex { times_s, parts_per_s, starts: vec![0; parts + 1] };
        for k in 0..parts {
            let part = index.part(index.times_s[k]);
            index.starts[part + 1] += 1;
        }
        for k in 0..parts {
            index.starts[k + 1] += index.starts[k];
        }
        index
    }

    /// All times, s.
    pub(super) fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// First and last time, s.
    pub(super) fn span_s(&self) -> [f64; 2] {
        [self.times_s[0], self.times_s[self.times_s.len() - 1]]
    }

    /// Index of the last time not later than this one.
    ///
    /// Never the index of the last time of all; `None` outside the span.
    pub(super) fn before(&self, time_s: f64) -> Option<usize> {
        let [first_s, last_s] = self.span_s();
        if !(first_s..=last_s).contains(&time_s) {
            return None;
        }
        let part = self.part(time_s);
        let (start, end) = (self.starts[part] as usize, self.starts[part + 1] as usize);
        let after = start + self.times_s[start..end].partition_point(|&other| other <= time_s);
        Some(after.saturating_sub(1).min(self.times_s.len() - 2))
    }

    /// The part that contains a time within the span; monotonic in spite of rounding.
    fn part(&self, time_s: f64) -> usize {
        (((time_s - self.times_s[0]) * self.parts_per_s) as usize).min(self.times_s.len() - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_index_is_that_of_the_last_time_not_later() {
        let index = TimeIndex::new(vec![1.0, 2.0, 3.0, 1e6, 1e6 + 0.5]);
        let found = [1.0, 1.999, 2.0, 3.0, 4.0, 999_999.9, 1e6, 1e6 + 0.5].map(|t| index.before(t).unwrap());
        assert_eq!(found, [0, 0, 1, 2, 2, 2, 3, 3]);
        assert_eq!([0.999, 1e6 + 0.6, f64::NAN].map(|t| index.before(t)), [None; 3]);
        assert_eq!(index.span_s(), [1.0, 1e6 + 0.5]);
    }

    proptest! {
        #[test]
        fn lookup_equals_linear_search(
            steps in proptest::collection::vec(prop_oneof![4 => 0.004..0.006, 1 => 1e-9..1e5], 1..200),
            start in -1e9..1e9f64, part in 0.0..=1.0f64,
        ) {
            let mut times: Vec<f64> = vec![start];
            steps.iter().for_each(|step: &f64| times.push((times[times.len() - 1] + step).next_up()));
            let last = times.len() - 1;
            let time = (start + part * (times[last] - start)).clamp(start, times[last]);
            let expected = (times.partition_point(|&t| t <= time) - 1).min(last - 1);
            prop_assert_eq!(TimeIndex::new(times).before(time), Some(expected));
        }
    }
}
