//! Waveforms that were read recently.

use std::collections::{HashSet, VecDeque};

/// Packet offsets of recently read waveforms, to avoid decomposing one twice.
#[derive(Default)]
pub(super) struct RecentPackets {
    order: VecDeque<u64>,
    /// The same offsets, once they no longer ascend; most files ascend, and need no set.
    unordered: Option<HashSet<u64>>,
}

/// Number of waveforms remembered.
const REMEMBERED: usize = 1 << 16;

impl RecentPackets {
    /// Remembers an offset; `false` if it is known already.
    pub(super) fn is_new(&mut self, offset: u64) -> bool {
        let is_known = match &mut self.unordered {
            Some(offsets) => !offsets.insert(offset),
            None if self.order.back().is_none_or(|last| *last < offset) => false,
            None if self.order.binary_search(&offset).is_ok() => true,
            None => {
                self.unordered = Some(self.order.iter().copied().chain([offset]).collect());
                false
            }
        };
        if is_known {
            return false;
        }
        self.order.push_back(offset);
        if self.order.len() > REMEMBERED {
            let oldest = self.order.pop_front();
            if let (Some(oldest), Some(offsets)) = (oldest, &mut self.unordered) {
                offsets.remove(&oldest);
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_waveform_is_read_once() {
        let mut recent = RecentPackets::default();
        assert!(recent.is_new(60));
        assert!(recent.is_new(180));
        assert!(!recent.is_new(60));
        assert!(recent.is_new(120), "offsets need not ascend");
        assert!(!recent.is_new(120) && !recent.is_new(60) && !recent.is_new(180));
        (0..REMEMBERED as u64).for_each(|i| assert!(recent.is_new(1000 + i)));
        assert!(recent.is_new(60), "old offsets are forgotten");
    }
}
