//! Received echoes: groups of blocks that belong to one shot, and their peaks.

use std::ops::Range;

use wavex_line::scan_line::{Block, Blocks, Channel, Emission};

/// Number of strongest pulses used per group.
const MOST_ECHOES: usize = 4;
/// Smallest pulse height above the background, digitiser steps.
const LEAST_HEIGHT_DN: f64 = 3.0;
/// Smallest pulse height relative to the highest.
const LEAST_PART: f64 = 0.3;
/// Smallest height of an outgoing pulse that gives an emission time, digitiser steps.
const LEAST_OUTGOING_DN: f64 = 10.0;
/// Largest distance of an online return from its block, ns.
const ONLINE_REACH_NS: f64 = 2.0;
/// Latest possible reception, ns.
const LATEST_NS: f64 = 1e9;

/// Destination of a block or online return before its zone is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Destination {
    /// Stays with its shot: an outgoing pulse, or a block with a known zone.
    Stays,
    /// Goes where its group goes.
    Group(u32),
    /// Has no usable time.
    Nowhere,
}

/// Blocks of one record that overlap in time, and so come from one shot.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Group {
    /// Index of the shot whose record contains them.
    pub record: u32,
    /// Start and end after the clock of that shot, ns.
    pub from_ns: f64,
    to_ns: f64,
    /// Its echoes in [`Received::echoes`].
    pub echoes: Range<u32>,
}

/// One echo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct EchoPeak {
    /// Time after the clock of the shot whose record contains it, ns.
    pub time_ns: f64,
    /// Height above the background at gain 1, digitiser steps.
    pub height_dn: f64,
}

/// Echoes received in a line.
#[derive(Clone, Debug, Default)]
pub(super) struct Received {
    pub groups: Vec<Group>,
    /// The echoes of the groups, group by group.
    pub echoes: Vec<EchoPeak>,
    /// One entry per block.
    pub blocks: Vec<Destination>,
    /// One entry per online return.
    pub online: Vec<Destination>,
    /// Delay of each shot's outgoing pulse after its clock, ns; NaN if not recorded.
    pub outgoing_ns: Vec<f64>,
}

impl Received {
    pub fn of(emissions: &[Emission], blocks: &Blocks) -> Received {
        let mut received = Received {
            blocks: vec![Destination::Stays; blocks.len()],
            online: vec![Destination::Stays; blocks.online.len()],
            outgoing_ns: vec![f64::NAN; emissions.len()],
            ..Received::default()
        };
        let (mut block, mut online) = (0, 0);
        let mut members = Vec::new();
        for (record, emission) in (0u32..).zip(emissions) {
            members.clear();
            while let Some(next) = blocks.get(block).filter(|next| next.emission <= record) {
                received.blocks[block] = place_of(next, emission);
                if next.channel == Channel::Reference {
                    received.outgoing_ns[record as usize] = outgoing_ns(next, blocks.samples(next));
                }
                if received.blocks[block] == Destination::Group(0) {
                    members.push((block, *next));
                }
                block += 1;
            }
            let first = received.groups.len();
            received.add_groups(record, &mut members, blocks);
            let until =
                online + blocks.online[online..].iter().take_while(|one| one.emission <= record).count();
            if emission.mta_zone.is_none() {
                (online..until).for_each(|i| received.add_online(first, i, record, blocks));
            }
            online = until;
        }
        received
    }

    /// Groups the blocks of one record.
    fn add_groups(&mut self, record: u32, members: &mut [(usize, Block)], blocks: &Blocks) {
        members.sort_by(|a, b| a.1.start_ns.total_cmp(&b.1.start_ns));
        let mut from = 0;
        while from < members.len() {
            let mut to_ns = end_ns(&members[from].1);
            let mut until = from + 1;
            while until < members.len() && members[until].1.start_ns < to_ns {
                to_ns = to_ns.max(end_ns(&members[until].1));
                until += 1;
            }
            let group = self.groups.len() as u32;
            let of_group = &members[from..until];
            of_group.iter().for_each(|&(index, _)| self.blocks[index] = Destination::Group(group));
            let first = self.echoes.len() as u32;
            find(of_group, blocks, &mut self.echoes);
            let echoes = first..self.echoes.len() as u32;
            self.groups.push(Group { record, from_ns: of_group[0].1.start_ns, to_ns, echoes });
            from = until;
        }
    }

    /// Assigns an online return to a group: one from `first` on that contains it, or a new one.
    fn add_online(&mut self, first: usize, index: usize, record: u32, blocks: &Blocks) {
        let time_ns = blocks.online[index].time_ns;
        if !has_time(time_ns) {
            self.online[index] = Destination::Nowhere;
            return;
        }
        let covers = |group: &Group| {
            (group.from_ns - ONLINE_REACH_NS..=group.to_ns + ONLINE_REACH_NS).contains(&time_ns)
        };
        let group = match self.groups[first..].iter().position(covers) {
            Some(group) => first + group,
            None => {
                let echo = self.echoes.len() as u32;
                self.echoes.push(EchoPeak { time_ns, height_dn: 1.0 });
                let (from_ns, to_ns) = (time_ns, time_ns);
                self.groups.push(Group { record, from_ns, to_ns, echoes: echo..echo + 1 });
                self.groups.len() - 1
            }
        };
        self.online[index] = Destination::Group(group as u32);
    }
}

fn end_ns(block: &Block) -> f64 {
    block.time_ns(block.len() as f64)
}

fn has_time(time_ns: f64) -> bool {
    time_ns.abs() < LATEST_NS
}

/// Whether a block stays; otherwise its group is set later.
fn place_of(block: &Block, emission: &Emission) -> Destination {
    if block.channel == Channel::Reference || block.zone.or(emission.mta_zone).is_some() {
        Destination::Stays
    } else if has_time(block.start_ns) && has_time(end_ns(block)) {
        Destination::Group(0)
    } else {
        Destination::Nowhere
    }
}

/// Finds the echoes of a group in its most sensitive receiver; at least one.
fn find(group: &[(usize, Block)], blocks: &Blocks, echoes: &mut Vec<EchoPeak>) {
    let order = [Channel::LowPower, Channel::HighPower, Channel::Saturation];
    let recorded = |channel: &Channel| group.iter().any(|(_, block)| block.channel == *channel);
    let channel = order.into_iter().find(recorded).unwrap_or(Channel::LowPower);
    let first = echoes.len();
    for (_, block) in group.iter().filter(|(_, block)| block.channel == channel) {
        peaks(block, blocks.samples(block), echoes);
    }
    let own = &mut echoes[first..];
    own.sort_by(|a, b| b.height_dn.total_cmp(&a.height_dn));
    let least_dn = own.first().map_or(0.0, |highest| (LEAST_PART * highest.height_dn).max(LEAST_HEIGHT_DN));
    // The highest is always kept.
    let kept = own.iter().take(MOST_ECHOES).filter(|peak| peak.height_dn >= least_dn).count().max(1);
    echoes.truncate(first + kept);
    if echoes.len() == first {
        echoes.extend(group.first().map(|(_, block)| EchoPeak { time_ns: block.start_ns, height_dn: 1.0 }));
    }
}

/// Finds the peaks of a block: runs of equal samples above both neighbours.
///
/// The position is the middle of the run; for a single sample it is the vertex of the parabola
/// through it and its neighbours.
fn peaks(block: &Block, samples: &[u16], echoes: &mut Vec<EchoPeak>) {
    let background_dn = f64::from(background(samples));
    let mut from = 0;
    while from < samples.len() {
        let level = samples[from];
        let until = from + samples[from..].iter().take_while(|&&sample| sample == level).count();
        let before = from.checked_sub(1).map(|before| samples[before]);
        let after = samples.get(until).copied();
        if before.is_none_or(|before| before < level) && after.is_none_or(|after| after < level) {
            let position = match (before, after) {
                (Some(before), Some(after)) if until == from + 1 => {
                    from as f64 + vertex(before, level, after)
                }
                _ => 0.5 * (from + until - 1) as f64,
            };
            let height_dn = (f64::from(level) - background_dn) / block.gain;
            echoes.push(EchoPeak { time_ns: block.time_ns(position), height_dn });
        }
        from = until;
    }
}

/// Centroid of the upper part of an outgoing pulse, ns after its shot's clock; NaN if too low.
///
/// Weights are the excess above 30 % of the height, which is more stable than the vertex through
/// three samples.
fn outgoing_ns(block: &Block, samples: &[u16]) -> f64 {
    let checked = |time_ns: f64| if has_time(time_ns) { time_ns } else { f64::NAN };
    let Some(peak) = (0..samples.len()).max_by_key(|&k| (samples[k], std::cmp::Reverse(k))) else {
        // A block without samples carries the time itself.
        return checked(block.start_ns);
    };
    let background_dn = f64::from(background(samples));
    let height_dn = f64::from(samples[peak]) - background_dn;
    if height_dn < LEAST_OUTGOING_DN {
        return f64::NAN;
    }
    let above_dn = |k: &usize| f64::from(samples[*k]) - background_dn - LEAST_PART * height_dn;
    let before = (0..peak).rev().take_while(|k| above_dn(k) > 0.0);
    let after = (peak..samples.len()).take_while(|k| above_dn(k) > 0.0);
    let (sum, weighted) = before
        .chain(after)
        .fold((0.0, 0.0), |(sum, weighted), k| (sum + above_dn(&k), weighted + k as f64 * above_dn(&k)));
    checked(block.time_ns(weighted / sum))
}

/// Background of a block: the lower of the medians of its first and last four samples.
fn background(samples: &[u16]) -> u16 {
    let median = |samples: &[u16]| {
        let mut few = [0; 4];
        let few = &mut few[..samples.len()];
        few.copy_from_slice(samples);
        few.sort_unstable();
        few.get(samples.len() / 2).copied().unwrap_or(0)
    };
    let part = samples.len().min(4);
    median(&samples[..part]).min(median(&samples[samples.len() - part..]))
}

/// Vertex of a parabola through three samples, relative to the highest, in the middle.
fn vertex(before: u16, middle: u16, after: u16) -> f64 {
    let [before, middle, after] = [before, middle, after].map(f64::from);
    0.5 * (before - after) / (before - 2.0 * middle + after)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unresolved(n: usize) -> Vec<Emission> {
        vec![Emission::default(); n]
    }

    fn times(received: &Received, group: usize) -> Vec<f64> {
        let echoes = &received.groups[group].echoes;
        received.echoes[echoes.start as usize..echoes.end as usize].iter().map(|echo| echo.time_ns).collect()
    }

    #[test]
    fn a_pulse_stands_at_the_vertex_of_its_parabola() {
        let mut blocks = Blocks::default();
        // A parabola with its vertex at 4.25, where it is 100 high.
        let parabola = |i: i32| (100.0 - 8.0 * (f64::from(i) - 4.25).powi(2)).max(0.0) as u16 + 2;
        let samples: Vec<u16> = (0..9).map(parabola).collect();
        blocks.push(0, Channel::LowPower, None, 500.0, 0.5, &samples);
        let received = Received::of(&unresolved(1), &blocks);
        assert_eq!(received.groups.len(), 1);
        assert!((times(&received, 0)[0] - 502.125).abs() < 0.02, "{:?}", received.echoes);
    }

    #[test]
    fn strong_pulses_come_first_and_noise_not_at_all() {
        let mut blocks = Blocks::default();
        let samples = [2, 3, 2, 2, 10, 40, 11, 2, 3, 2, 20, 61, 19, 2, 4, 2, 255, 255, 255, 2, 2];
        blocks.push(0, Channel::LowPower, None, 0.0, 1.0, &samples);
        let received = Received::of(&unresolved(1), &blocks);
        assert_eq!(times(&received, 0), [17.0], "61 is less than 30 % of a saturated pulse");
        let mut blocks = Blocks::default();
        blocks.push(0, Channel::LowPower, None, 0.0, 1.0, &samples[..15]);
        let received = Received::of(&unresolved(1), &blocks);
        assert_eq!(times(&received, 0).iter().map(|t| t.round()).collect::<Vec<_>>(), [11.0, 5.0]);
    }

    #[test]
    fn receivers_that_saw_the_same_go_together() {
        let mut blocks = Blocks::default();
        blocks.push(0, Channel::Reference, None, -5.0, 1.0, &[2, 90, 2]);
        blocks.push(0, Channel::LowPower, None, 100.0, 1.0, &[2, 2, 30, 2, 2]);
        blocks.push(0, Channel::LowPower, None, 300.0, 1.0, &[2, 2, 30, 2, 2]);
        blocks.push(0, Channel::HighPower, None, 101.43, 1.0, &[2, 9, 2, 2, 2]);
        blocks.push(1, Channel::HighPower, None, 301.43, 1.0, &[2, 9, 2, 2, 2]);
        let received = Received::of(&unresolved(2), &blocks);
        let group = Destination::Group;
        assert_eq!(received.blocks, [Destination::Stays, group(0), group(1), group(0), group(2)]);
        assert_eq!([0, 1, 2].map(|g| times(&received, g)), [[102.0], [302.0], [302.43]]);
        assert_eq!(received.groups.iter().map(|group| group.record).collect::<Vec<_>>(), [0, 0, 1]);
    }

    #[test]
    fn blocks_without_samples_or_times_do_no_harm() {
        let mut blocks = Blocks::default();
        blocks.push(0, Channel::LowPower, None, 100.0, 1.0, &[]);
        blocks.push(0, Channel::LowPower, None, 2e9, 1.0, &[1]);
        blocks.push(0, Channel::LowPower, None, f64::NAN, 1.0, &[1]);
        blocks.push(0, Channel::LowPower, Some(3), 500.0, 1.0, &[1]);
        let received = Received::of(&unresolved(1), &blocks);
        assert_eq!(
            received.blocks,
            [Destination::Group(0), Destination::Nowhere, Destination::Nowhere, Destination::Stays]
        );
        assert_eq!(times(&received, 0), [100.0]);
    }

    #[test]
    fn what_the_instrument_computed_goes_with_its_block() {
        let mut blocks = Blocks::default();
        blocks.push(0, Channel::LowPower, None, 100.0, 1.0, &[2, 2, 30, 2, 2]);
        let online = |time_ns| wavex_line::scan_line::OnlineReturn { emission: 0, time_ns, amplitude: 1.0 };
        blocks.online = vec![online(102.1), online(700.0), online(f64::NAN)];
        let received = Received::of(&unresolved(1), &blocks);
        assert_eq!(received.online, [Destination::Group(0), Destination::Group(1), Destination::Nowhere]);
        assert_eq!(times(&received, 1), [700.0]);
    }
}
