//! Kernels of one receiver at the gains of its blocks.

use std::collections::BTreeMap;

use wavex_line::stage::Result;
use wavex_signal::gain::GainLevel;

/// Maximum number of gains other than 1 kept between lines, a few MB each.
const MOST_KEPT: usize = 32;

/// Kernels by gain.
///
/// Kernels of gains other than 1 are created when a block needs them.
pub(super) struct AtGains<T> {
    unit: T,
    others: BTreeMap<GainLevel, (u64, T)>,
    /// Number of lines so far.
    now: u64,
}

impl<T> AtGains<T> {
    /// Starts with the kernels of gain 1.
    pub(super) fn new(unit: T) -> AtGains<T> {
        AtGains { unit, others: BTreeMap::new(), now: 0 }
    }

    /// Starts a line and drops the least recently used kernels beyond the limit.
    pub(super) fn begin_line(&mut self) {
        self.now += 1;
        while self.others.len() > MOST_KEPT {
            let oldest = self.others.iter().min_by_key(|(_, (used, _))| *used).map(|(level, _)| *level);
            let Some(oldest) = oldest else { return };
            self.others.remove(&oldest);
        }
    }

    /// Returns the kernels of a gain; creates them if missing.
    pub(super) fn need(&mut self, level: GainLevel, make: impl FnOnce(&T) -> Result<T>) -> Result<&mut T> {
        if level == GainLevel::UNIT {
            return Ok(&mut self.unit);
        }
        if !self.others.contains_key(&level) {
            let made = make(&self.unit)?;
            self.others.insert(level, (self.now, made));
        }
        match self.others.get_mut(&level) {
            Some((used, kernels)) => {
                *used = self.now;
                Ok(kernels)
            }
            None => Ok(&mut self.unit),
        }
    }

    /// Returns the kernels of a gain that occurs in this line.
    pub(super) fn get(&self, level: GainLevel) -> Option<&T> {
        if level == GainLevel::UNIT {
            Some(&self.unit)
        } else {
            self.others.get(&level).map(|(_, kernels)| kernels)
        }
    }

    /// Iterates over all kernels with their gains.
    pub(super) fn iter_mut(&mut self) -> impl Iterator<Item = (GainLevel, &mut T)> {
        let others = self.others.iter_mut().map(|(level, (_, kernels))| (*level, kernels));
        std::iter::once((GainLevel::UNIT, &mut self.unit)).chain(others)
    }
}

/// Queued items by gain, in order of first appearance of the gains.
pub(super) struct ByGain<T>(Vec<(GainLevel, Vec<T>)>);

impl<T> ByGain<T> {
    pub(super) fn new() -> ByGain<T> {
        ByGain(Vec::new())
    }

    /// Queues an item and returns its index among the items of its gain.
    pub(super) fn push(&mut self, level: GainLevel, item: T) -> usize {
        let at = match self.0.iter().position(|(of, _)| *of == level) {
            Some(at) => at,
            None => {
                self.0.push((level, Vec::new()));
                self.0.len() - 1
            }
        };
        let queue = &mut self.0[at].1;
        queue.push(item);
        queue.len() - 1
    }

    /// Items of a gain.
    pub(super) fn of(&self, level: GainLevel) -> &[T] {
        self.0.iter().find(|(of, _)| *of == level).map_or(&[], |(_, items)| items)
    }

    /// Iterates over the gains with their items.
    pub(super) fn iter(&self) -> impl Iterator<Item = (GainLevel, &[T])> {
        self.0.iter().map(|(level, items)| (*level, &items[..]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_of_gains_that_are_not_needed_any_more_are_dropped() {
        let mut kernels = AtGains::new(1.0);
        for line in 0..100 {
            kernels.begin_line();
            let gain = 1.0 + 0.1 * f64::from(line);
            let level = GainLevel::of(gain);
            assert_eq!(*kernels.need(level, |unit| Ok(unit * level.gain())).unwrap(), level.gain());
            assert_eq!(kernels.get(level), Some(&level.gain()));
        }
        assert!(kernels.iter_mut().count() <= MOST_KEPT + 2);
        assert_eq!(kernels.get(GainLevel::of(1.3)), None);
        assert_eq!(kernels.get(GainLevel::UNIT), Some(&1.0));
    }

    #[test]
    fn items_are_numbered_within_their_gain() {
        let mut queue = ByGain::new();
        let levels = [1.0, 2.0, 1.0, 2.0].map(GainLevel::of);
        assert_eq!(levels.map(|level| queue.push(level, level.gain())), [0, 0, 1, 1]);
        assert_eq!(queue.of(GainLevel::of(2.0)), [2.0, 2.0]);
        assert!(queue.of(GainLevel::of(4.0)).is_empty());
        assert_eq!(queue.iter().count(), 2);
    }
}
