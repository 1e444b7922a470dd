//! Intervals between events: the usual interval, its variation, and gaps.

use hdrhistogram::Histogram;

/// Number of intervals used to determine the usual one.
const LOOKED_AT: usize = 1023;
/// Largest relative deviation of usual intervals from their median.
///
/// Clocks with steps of 1 µs give intervals of 2 or 3 steps for an interval of 2.5 µs.
const USUAL_PART: f64 = 0.5;
/// Intervals longer than this many usual ones are gaps.
const GAP_INTERVALS: f64 = 2.5;
/// Number of longest intervals kept.
const LONGEST: usize = 3;
/// Longer intervals are clamped to this, ps: 11 days.
const MOST_PS: u64 = 1_000_000_000_000_000_000;

/// Intervals in picoseconds, and the longest of them with their positions.
#[derive(Clone, Debug)]
pub struct Intervals {
    all_ps: Histogram<u64>,
    /// The first intervals, until there are enough.
    first_ps: Vec<u64>,
    usual: Option<UsualIntervals>,
    longest: Vec<LongInterval>,
}

/// One of the longest intervals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LongInterval {
    /// Length, ps.
    pub ps: u64,
    /// The shot that ends it.
    pub shot: u64,
    /// Time of that shot, s; NaN if unknown.
    pub gps_time_s: f64,
}

/// Exact sums over the usual intervals, relative to a reference.
#[derive(Clone, Copy, Debug)]
struct UsualIntervals {
    reference_ps: u64,
    count: u64,
    sum: i128,
    squares: i128,
    /// Greatest common divisor of the intervals, ps.
    step_ps: u64,
}

impl Default for Intervals {
    fn default() -> Intervals {
        let all_ps =
            Histogram::new(3).unwrap_or_else(|_| unreachable!("3 digits are within hdrhistogram's limits"));
        Intervals { all_ps, first_ps: Vec::new(), usual: None, longest: Vec::new() }
    }
}

impl Intervals {
    /// Adds an interval that ends with the given shot at the given time.
    pub fn add(&mut self, ps: u64, shot: u64, gps_time_s: f64) {
        let ps = ps.min(MOST_PS);
        // The histogram resizes itself; only values beyond its limits fail.
        let _ = self.all_ps.record(ps);
        if self.longest.len() < LONGEST || self.longest.last().is_some_and(|least| ps > least.ps) {
            let at = self.longest.partition_point(|other| other.ps >= ps);
            self.longest.insert(at, LongInterval { ps, shot, gps_time_s });
            self.longest.truncate(LONGEST);
        }
        match &mut self.usual {
            Some(usual) => usual.add(ps),
            None => {
                self.first_ps.push(ps);
                if self.first_ps.len() == LOOKED_AT {
                    self.settle();
                }
            }
        }
    }

    /// Ends the input.
    pub fn finish(&mut self) {
        if self.usual.is_none() && !self.first_ps.is_empty() {
            self.settle();
        }
    }

    fn settle(&mut self) {
        let middle = self.first_ps.len() / 2;
        let reference_ps = *self.first_ps.select_nth_unstable(middle).1;
        let mut usual = UsualIntervals { reference_ps, count: 0, sum: 0, squares: 0, step_ps: 0 };
        self.first_ps.drain(..).for_each(|ps| usual.add(ps));
        self.usual = Some(usual);
    }

    /// Number of intervals.
    pub fn count(&self) -> u64 {
        self.all_ps.len()
    }

    /// Mean and standard deviation of the usual intervals, ps: intervals within 50 % of the
    /// median of the first 1023.
    pub fn usual_ps(&self) -> Option<[f64; 2]> {
        let usual = self.usual.filter(|usual| usual.count > 0)?;
        let count = usual.count as f64;
        let off = usual.sum as f64 / count;
        let variance = (usual.squares as f64 / count - off * off).max(0.0);
        Some([usual.reference_ps as f64 + off, variance.sqrt()])
    }

    /// Greatest common divisor of the usual intervals, ps: the resolution of the clock, if they
    /// differ.
    pub fn step_ps(&self) -> Option<u64> {
        self.usual.map(|usual| usual.step_ps).filter(|step_ps| *step_ps > 0)
    }

    /// Number of intervals longer than 2.5 usual ones, to three digits.
    pub fn gaps(&self) -> u64 {
        let Some([usual_ps, _]) = self.usual_ps() else { return 0 };
        let limit = GAP_INTERVALS * usual_ps;
        let is_gap = |ps: u64| ps as f64 > limit;
        let all = self.all_ps.iter_recorded();
        all.filter(|step| is_gap(step.value_iterated_to()))
            .map(|step| step.count_since_last_iteration())
            .sum()
    }

    /// The longest interval, if it is a gap.
    pub fn longest_gap(&self) -> Option<LongInterval> {
        self.longest.first().copied().filter(|_| self.gaps() > 0)
    }
}

impl UsualIntervals {
    fn add(&mut self, ps: u64) {
        let off = i128::from(ps) - i128::from(self.reference_ps);
        if off.unsigned_abs() as f64 <= USUAL_PART * self.reference_ps as f64 {
            self.count += 1;
            self.sum += off;
            self.squares += off * off;
            self.step_ps =
                greatest_common_divisor(self.step_ps, self.reference_ps.saturating_add_signed(off as i64));
        }
    }
}

fn greatest_common_divisor(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usual_intervals_are_separated_from_gaps() {
        let mut intervals = Intervals::default();
        for shot in 0..2000 {
            let ps = if shot % 2 == 0 { 2_500_010 } else { 2_499_990 };
            intervals.add(ps, shot, 0.0);
        }
        intervals.add(5_000_000, 2000, 1.0);
        intervals.add(7_500_000, 2001, 2.0);
        intervals.add(25_000_000, 2002, 3.0);
        intervals.finish();
        assert_eq!(intervals.usual_ps(), Some([2_500_000.0, 10.0]));
        assert_eq!((intervals.count(), intervals.gaps(), intervals.step_ps()), (2003, 2, Some(10)));
        let longest = LongInterval { ps: 25_000_000, shot: 2002, gps_time_s: 3.0 };
        assert_eq!(intervals.longest_gap(), Some(longest));
    }

    #[test]
    fn few_intervals_suffice_and_none_give_nothing() {
        let mut few = Intervals::default();
        [10, 10, 12, 100].into_iter().for_each(|ps| few.add(ps, 0, f64::NAN));
        few.finish();
        let [mean, sd] = few.usual_ps().unwrap();
        assert!(
            (mean - 32.0 / 3.0).abs() < 1e-12 && (sd - (8.0f64 / 9.0).sqrt()).abs() < 1e-12,
            "{mean} {sd}"
        );
        assert_eq!(few.gaps(), 1);
        let mut none = Intervals::default();
        none.finish();
        assert_eq!((none.usual_ps(), none.gaps(), none.longest_gap()), (None, 0, None));
    }
}
