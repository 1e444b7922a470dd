//! Dropped candidates and returns of a scan line, by reason.

use crate::reason::Reason;
use wavex_signal::decompose;

/// Reasons counted in `np_filtered`; the first are the reasons of [`decompose::Filter`], in its order.
const REASONS: [Reason; 12] = [
    Reason::Screened,
    Reason::InExcess,
    Reason::Undetermined,
    Reason::TooWeak,
    Reason::TooNarrow,
    Reason::TooWide,
    Reason::OutsideBlock,
    Reason::WithoutMode,
    Reason::NotInLowPower,
    Reason::NotInHighPower,
    Reason::DeviatingWaveform,
    Reason::OwnStage,
];

/// Number of dropped candidates and returns, by reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Filtered([u64; REASONS.len()]);

impl Filtered {
    /// Adds candidates or returns dropped for a reason.
    ///
    /// All reasons of stages outside of this crate are [`Reason::OwnStage`].
    pub fn add(&mut self, reason: Reason, n: u64) {
        if n == 0 {
            return;
        }
        let own = REASONS.len() - 1;
        let index = match reason {
            Reason::Custom(..) => own,
            reason => REASONS.iter().position(|known| *known == reason).unwrap_or(own),
        };
        self.0[index] += n;
    }

    /// Adds the candidates that the kernels dropped.
    pub fn add_candidates(&mut self, dropped: &decompose::Filtered) {
        for (count, reason) in self.0.iter_mut().zip(decompose::Filter::ALL) {
            *count += u64::from(dropped.of(reason));
        }
    }

    /// Number of one reason.
    pub fn of(&self, reason: Reason) -> u64 {
        self.counts().find(|(known, _)| *known == reason).map_or(0, |(_, n)| n)
    }

    /// Number of all reasons.
    pub fn total(&self) -> u64 {
        self.0.iter().sum()
    }

    /// All reasons with their numbers.
    pub fn counts(&self) -> impl Iterator<Item = (Reason, u64)> {
        REASONS.into_iter().zip(self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reason::{Counter, Item};

    #[test]
    fn all_reasons_of_the_counter_are_known() {
        let counted = |reason: &Reason| {
            matches!(reason.description().counter, Counter::Filtered | Counter::RejectedAndFiltered)
        };
        let expected: Vec<Reason> = Reason::ALL.iter().copied().filter(counted).collect();
        assert_eq!(REASONS.to_vec(), expected);
        assert_eq!(REASONS[decompose::Filter::Outside as usize], Reason::OutsideBlock);
        assert_eq!(REASONS[decompose::Filter::Undetermined as usize], Reason::Undetermined);
    }

    #[test]
    fn the_limit_of_returns_is_that_of_the_kernels() {
        let most = decompose::DecomposeSettings::default().max_returns;
        assert_eq!(Reason::InExcess.text(), format!("in excess of the strongest {most}"));
    }

    #[test]
    fn custom_reasons_are_those_of_own_stages() {
        let mut filtered = Filtered::default();
        filtered.add(Reason::Custom(Item::Returns, "too weak"), 2);
        filtered.add(Reason::TooWeak, 3);
        assert_eq!((filtered.of(Reason::OwnStage), filtered.of(Reason::TooWeak)), (2, 3));
        assert_eq!(filtered.total(), 5);
    }
}
