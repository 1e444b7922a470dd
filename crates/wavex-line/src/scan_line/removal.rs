//! Removal of returns from a line.

use super::{Content, ScanLine, flags};
use crate::reason::Reason;

impl ScanLine {
    /// Removes returns, with their points; updates the counters and numbers the others of each shot again.
    ///
    /// `is_removed` has one value per return; further returns stay. The caller rejects them in its
    /// context for the same reason. Returns the number of removed returns.
    pub fn remove_returns(&mut self, is_removed: &[bool], reason: Reason) -> u64 {
        let (returns, points) = match &mut self.content {
            Content::Returns(returns) => (returns, None),
            Content::Points(returns, points) => (returns, Some(points)),
            Content::Shots(_) => return 0,
        };
        let stats = &mut self.stats;
        let is_gone = |index: usize| is_removed.get(index).copied().unwrap_or(false);
        let (mut n, mut touched, mut waves, mut from) = (0, 0, 0, 0);
        for of_shot in returns.chunk_by_mut(|a, b| a.emission == b.emission) {
            let gone = (from..from + of_shot.len()).filter(|index| is_gone(*index)).count();
            n += gone as u64;
            waves += u64::from(gone == of_shot.len());
            let left = (of_shot.len() - gone).min(255) as u8;
            let mut number = 0;
            for (index, found) in (from..).zip(of_shot.iter_mut()) {
                if is_gone(index) {
                    touched += u64::from(found.flags & flags::CROSSTALK != 0);
                } else if gone > 0 {
                    number = u8::saturating_add(number, 1);
                    found.return_number = number;
                    found.number_of_returns = left;
                }
            }
            from += of_shot.len();
        }
        if n == 0 {
            return 0;
        }
        stats.np -= n.min(stats.np);
        stats.np_xtalk -= touched.min(stats.np_xtalk);
        stats.filtered.add(reason, n);
        stats.nw_with_points -= waves.min(stats.nw_with_points);
        stats.nw_deleted += waves;
        let mut index = 0;
        returns.retain(|_| {
            index += 1;
            !is_gone(index - 1)
        });
        if let Some(points) = points {
            let mut index = 0;
            points.retain(|_| {
                index += 1;
                !is_gone(index - 1)
            });
        }
        n
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::super::{Blocks, Emission, InputInfo, Return};
    use super::*;

    #[test]
    fn the_others_are_numbered_again() {
        let (emissions, blocks) = (vec![Emission::default(); 2], Blocks::default());
        let mut line = ScanLine::of_shots(Arc::new(InputInfo::default()), 0, emissions, blocks);
        let found = |emission, return_number, number_of_returns| Return {
            emission,
            return_number,
            number_of_returns,
            ..Return::default()
        };
        let returns = vec![found(0, 1, 3), found(0, 2, 3), found(0, 3, 3), found(1, 1, 1)];
        line.content = Content::Points(returns, vec![[0.0; 3], [1.0; 3], [2.0; 3], [3.0; 3]]);
        (line.stats.np, line.stats.nw_with_points) = (4, 2);
        assert_eq!(line.remove_returns(&[true, false, false, true], Reason::DeviatingWaveform), 2);
        let numbers = |found: &Return| (found.emission, found.return_number, found.number_of_returns);
        let left: Vec<_> = line.returns().unwrap().iter().map(numbers).collect();
        assert_eq!(left, [(0, 1, 2), (0, 2, 2)]);
        assert_eq!(line.points().unwrap(), [[1.0; 3], [2.0; 3]]);
        let stats = &line.stats;
        assert_eq!((stats.np, stats.np_filtered(), stats.nw_with_points, stats.nw_deleted), (2, 2, 1, 1));
        assert_eq!(line.remove_returns(&[], Reason::OwnStage), 0);
    }
}
