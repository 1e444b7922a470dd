//! Cross-talk from the emission of one shot into the block of another.

use super::echo::FoundEcho;
use super::shot::ShotBlocks;
use wavex_line::scan_line::{Block, Emission, flags};

/// Largest distance of a return from an emission to be flagged, pulse widths.
const NEAR_WIDTHS: f64 = 3.0;

/// Emission times of the other shots of a line, relative to one shot.
pub(super) struct Departures<'a> {
    /// In order of their clocks; empty if block times do not count from the clock.
    emissions: &'a [Emission],
    /// Index of the shot itself.
    index: usize,
    clock_ps: i64,
    /// Delay of the emission after the clock, ns.
    ///
    /// The shot's own delay is used for all.
    delay_ns: f64,
}

impl<'a> Departures<'a> {
    /// `delay_ns` is the delay of the shot's emission after its clock.
    pub(super) fn of(emissions: &'a [Emission], shot: &ShotBlocks, delay_ns: f64) -> Departures<'a> {
        // Without a sensor position, block times count from their own first sample.
        let known = shot.input.origin_is_sensor;
        let index = shot.index as usize;
        let clock_ps = emissions.get(index).map_or(0, |emission| emission.clock_ps);
        Departures { emissions: if known { emissions } else { &[] }, index, clock_ps, delay_ns }
    }

    /// Emission times of other shots between two times after the shot's clock, ns.
    fn within(&self, from_ns: f64, to_ns: f64) -> impl Iterator<Item = f64> + '_ {
        self.others_within(from_ns, to_ns).map(|(_, emission)| {
            emission.clock_ps.saturating_sub(self.clock_ps) as f64 / 1000.0 + self.delay_ns
        })
    }

    /// Other shots emitted between two times after the shot's clock, ns.
    ///
    /// With their index in the line.
    pub(super) fn others_within(
        &self,
        from_ns: f64,
        to_ns: f64,
    ) -> impl Iterator<Item = (usize, &'a Emission)> + '_ {
        let clock_at = |time_ns: f64| {
            // The conversion saturates at the bounds of the integer type.
            self.clock_ps.saturating_add(((time_ns - self.delay_ns) * 1000.0) as i64)
        };
        let (from_ps, to_ps) = (clock_at(from_ns), clock_at(to_ns));
        let first = partition_near(self.emissions, self.index, |emission| emission.clock_ps < from_ps);
        let after = (first..).zip(self.emissions.get(first..).unwrap_or_default());
        // Shots with the same clock are indistinguishable: the time resolution is too low.
        after
            .take_while(move |(_, emission)| emission.clock_ps <= to_ps)
            .filter(|(_, emission)| emission.clock_ps != self.clock_ps)
    }

    /// Flags the echoes `found[first..]` of a block for emissions of other shots.
    ///
    /// Drops echoes that overlap an emission if requested, and returns their number.
    pub(super) fn mark(
        &self,
        block: &Block,
        fwhm_ns: f64,
        drop_overlapped: bool,
        found: &mut Vec<FoundEcho>,
        first: usize,
    ) -> u64 {
        let (from_ns, to_ns) = (block.time_ns(0.0), block.time_ns(block.len().saturating_sub(1) as f64));
        if self.within(from_ns, to_ns).next().is_none() {
            return 0;
        }
        let reach_ns = NEAR_WIDTHS * fwhm_ns;
        for found in &mut found[first..] {
            let near = self.within(from_ns, to_ns).any(|left_ns| (left_ns - found.time_ns).abs() <= reach_ns);
            found.flags |= if near { flags::EMISSION_ON_ECHO } else { flags::EMISSION_IN_BLOCK };
        }
        let before = found.len();
        if drop_overlapped {
            let mut index = 0;
            found.retain(|found| {
                index += 1;
                index <= first || found.flags & flags::EMISSION_ON_ECHO == 0
            });
        }
        (before - found.len()) as u64
    }
}

/// Number of emissions at the start for which `before` is true.
///
/// As `partition_point`, but searches outwards from `near` in doubling steps, because a block is
/// mostly recorded a few emissions after its own.
fn partition_near(emissions: &[Emission], near: usize, before: impl Fn(&Emission) -> bool) -> usize {
    let near = near.min(emissions.len());
    let (mut low, mut high, mut step) = (near, near, 1);
    while emissions.get(high).is_some_and(&before) {
        low = high + 1;
        high = (high + step).min(emissions.len());
        step *= 2;
    }
    while low > 0 && !before(&emissions[low - 1]) {
        high = low - 1;
        low = low.saturating_sub(step);
        step *= 2;
    }
    low + emissions[low..high].partition_point(before)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn at(clock_ps: i64) -> Emission {
        Emission { clock_ps, ..Emission::default() }
    }

    #[test]
    fn departures_count_from_the_shots_clock() {
        let emissions = [at(0), at(1_000_000), at(1_000_000), at(2_500_000), at(9_000_000)];
        let of = |clock_ps, delay_ns, from, to| {
            let index = emissions.partition_point(|emission| emission.clock_ps < clock_ps);
            let departures = Departures { emissions: &emissions, index, clock_ps, delay_ns };
            departures.within(from, to).collect::<Vec<f64>>()
        };
        assert_eq!(of(0, 0.0, 900.0, 2600.0), [1000.0, 1000.0, 2500.0]);
        assert_eq!(of(0, 2.0, 1001.0, 1010.0), [1002.0, 1002.0]);
        assert_eq!(of(1_000_000, 0.0, -10.0, 10.0), [] as [f64; 0], "neither itself nor its equal");
        assert_eq!(of(2_500_000, 0.0, -1600.0, -1400.0), [-1500.0, -1500.0]);
        assert_eq!(of(0, 0.0, f64::NEG_INFINITY, f64::INFINITY).len(), 4);
    }
    proptest! {
        #[test]
        fn a_search_from_anywhere_ends_at_the_same_place(
            mut clocks in prop::collection::vec(0i64..40, 0..60),
            near in 0usize..70,
            sought in -1i64..41,
        ) {
            clocks.sort_unstable();
            let emissions: Vec<Emission> = clocks.into_iter().map(at).collect();
            let before = |emission: &Emission| emission.clock_ps < sought;
            prop_assert_eq!(partition_near(&emissions, near, before), emissions.partition_point(before));
        }
    }
}
