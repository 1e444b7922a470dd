//! Pulse model of one waveform in the batch.

use std::ops::Range;

use super::fitted::FittedPulse;
use super::layout::Values;
use crate::decompose::acceptance::CLUSTER_WIDTHS;
use crate::decompose::{Counts, Filter, Filtered};
use crate::flags;

/// Maximum number of pulses per waveform; waveforms with more go to the scalar kernels.
///
/// With 11 the first pulse and all before it take two cache lines.
pub(super) const MAX_PULSES: usize = 11;
/// Maximum number of pulses in a joint fit; waveforms with larger clusters go to the scalar kernels.
pub(super) const MAX_CLUSTER: usize = 8;
/// Maximum number of pulses in a trial of the residual search.
///
/// In larger clusters the others are held, and the cluster is fitted again once a trial is accepted.
pub(super) const MAX_TRIAL: usize = 3;

/// A pulse: values, uncertainties and flags.
#[derive(Clone, Copy)]
pub(super) struct PulseComponent {
    values: Values,
    /// Exponential of the third value, cached because it is used often.
    width_ratio: f32,
    pub(super) sds: Values,
    pub(super) flags: u16,
    /// See [`FittedPulse`].
    pub(super) by_level: Values,
    pub(super) level_information: f32,
}

impl Default for PulseComponent {
    fn default() -> PulseComponent {
        PulseComponent::of_calibrated_width(0.0, 0.0)
    }
}

impl PulseComponent {
    /// Creates a pulse that is not fitted.
    pub(super) fn new(values: Values) -> PulseComponent {
        PulseComponent {
            values,
            width_ratio: values[2].exp(),
            ..PulseComponent::of_calibrated_width(0.0, 0.0)
        }
    }

    /// Creates a pulse of the calibrated width that is not fitted.
    pub(super) fn of_calibrated_width(height: f32, position: f32) -> PulseComponent {
        let values = [height, position, 0.0];
        PulseComponent {
            values,
            width_ratio: 1.0,
            sds: [0.0; 3],
            flags: 0,
            by_level: [0.0; 3],
            level_information: 0.0,
        }
    }

    /// Returns the pulse with other flags.
    pub(super) fn flagged(self, flags: u16) -> PulseComponent {
        PulseComponent { flags, ..self }
    }

    pub(super) fn values(&self) -> Values {
        self.values
    }

    pub(super) fn set_values(&mut self, values: Values) {
        self.values = values;
        self.width_ratio = values[2].exp();
    }

    /// Copies a fit result, except the standard deviations.
    pub(super) fn take(&mut self, fitted: &FittedPulse) {
        (self.values, self.width_ratio) = (fitted.values, fitted.width_ratio);
        (self.by_level, self.level_information) = (fitted.by_level, fitted.level_information);
    }

    pub(super) fn height(&self) -> f32 {
        self.values[0]
    }

    pub(super) fn position(&self) -> f32 {
        self.values[1]
    }

    /// Whether it is fitted, with known standard deviations.
    pub(super) fn is_fitted(&self) -> bool {
        self.sds[1] > 0.0
    }

    pub(super) fn width_ratio(&self) -> f32 {
        self.width_ratio
    }
}

/// Progress of a waveform through the SIMD kernels: state of its row, chi-square and level.
///
/// Only these methods of [`PulseModel`] change it:
///
/// | method | from | to |
/// |---|---|---|
/// | `reset` | any | `OnRow` |
/// | `subtract` | `OnRow` | `Subtracted`; other states with subtracted pulses stay |
/// | `settle` | `OnRow` | `Settled` |
/// | `set_level` | `OnRow` | `LevelledOnRow` |
/// | `set_level` | `Subtracted`, `Settled` | `Levelled` |
/// | `reopen` | `Subtracted`, `Settled`, `Levelled` | `Subtracted` |
/// | `leave_to_scalar` | any | `LeftToScalar` |
///
/// `LevelledOnRow` and `LeftToScalar` are final. The outcome of the residual search is independent
/// of the state of the row, so it is a second enum, [`Search`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum RowState {
    /// The row holds the pulses: start values, or a single pulse after its step in the fast modes.
    #[default]
    OnRow,
    /// As `OnRow`; the step of the single pulse included the level. Fast modes only.
    LevelledOnRow,
    /// The row is the residual; while a fit is queued, the pulses of the fit are on it.
    Subtracted,
    /// As `Subtracted`; the only pulse is at its optimum, with its chi-square. Refined mode only.
    Settled,
    /// As `Subtracted`; level and pulses are at their joint optimum, with its chi-square.
    Levelled,
    /// The scalar kernels decompose the waveform from its samples.
    LeftToScalar,
}

/// State of the residual search of a waveform.
///
/// | method | from | to |
/// |---|---|---|
/// | `reset` | any | `Unchanged` |
/// | `set_undecided` | `Unchanged`, `Undecided` | `Undecided` |
/// | `accept_trial` | `Unchanged`, `Undecided` | `Changed` |
/// | `start_search_round` | `Unchanged`, `Changed` | `Unchanged` |
///
/// Only changed waveforms are in a further round, so `Undecided` without an accepted trial is final.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Search {
    /// No trial was accepted in this round, and no rejected one was close.
    #[default]
    Unchanged,
    /// As `Unchanged`, but a trial without an optimum might have been accepted.
    Undecided,
    /// A trial was accepted in this round.
    Changed,
}

/// Counts of the candidates of a waveform.
///
/// Candidates and pulses are at most [`MAX_PULSES`] at a time, so bytes hold all but the added ones.
#[derive(Clone, Copy, Default)]
pub(super) struct PulseCounts {
    pub(super) n_added: u32,
    pub(super) n_candidates: u8,
    pub(super) np_merged: u8,
    /// By index of [`Filter`].
    filtered: [u8; Filter::ALL.len()],
}

impl PulseCounts {
    /// Counts of `found` candidates: `unexplained` by stronger ones, of which `kept` become pulses.
    #[inline(always)]
    pub(super) fn of_candidates(found: usize, unexplained: usize, kept: usize) -> PulseCounts {
        let mut counts = PulseCounts { n_candidates: found as u8, ..PulseCounts::default() };
        counts.filtered[Filter::Screened as usize] = (found - unexplained) as u8;
        counts.filtered[Filter::Excess as usize] = (unexplained - kept) as u8;
        counts
    }

    /// Counts a dropped pulse.
    pub(super) fn filter(&mut self, reason: Filter) {
        self.filtered[reason as usize] += 1;
    }

    /// Counts of a waveform with `np` returns.
    #[inline(always)]
    pub(super) fn with_returns(&self, np: usize) -> Counts {
        Counts {
            n_candidates: self.n_candidates.into(),
            n_added: self.n_added,
            np: np as u32,
            filtered: Filtered(self.filtered.map(u32::from)),
            np_merged: self.np_merged.into(),
            np_xtalk_dropped: 0,
        }
    }
}

/// Pulse model of one waveform.
///
/// Most waveforms have one pulse: the fields used for these are together at the front.
#[derive(Clone, Copy, Default)]
#[repr(C, align(64))]
pub(super) struct PulseModel {
    count: usize,
    stage: RowState,
    search: Search,
    pub(super) chi_square: f32,
    /// Number of samples that count in chi-square.
    pub(super) samples: usize,
    pub(super) counts: PulseCounts,
    /// Decrease of chi-square promised by widths beyond the tables.
    pub(super) beyond: f32,
    /// Background of the waveform minus that of the channel, DN, and its variance, DN².
    ///
    /// Both are 0 for a fixed background.
    pub(super) level_dn: f32,
    pub(super) level_variance: f32,
    /// Ends of the jointly fitted clusters, in order; 0 after the last.
    ends: [u8; MAX_PULSES],
    pulses: [PulseComponent; MAX_PULSES],
}

const _: () = assert!(std::mem::offset_of!(PulseModel, pulses) + size_of::<PulseComponent>() <= 128);

impl PulseModel {
    pub(super) fn pulses(&self) -> &[PulseComponent] {
        &self.pulses[..self.count]
    }

    pub(super) fn pulses_mut(&mut self) -> &mut [PulseComponent] {
        &mut self.pulses[..self.count]
    }

    /// Resets to a new waveform without pulses.
    #[inline(always)]
    pub(super) fn reset(&mut self) {
        let PulseModel {
            count,
            stage,
            search,
            chi_square,
            samples,
            counts,
            beyond,
            level_dn,
            level_variance,
            ends,
            // Only those within `count` are read.
            pulses: _,
        } = self;
        (*count, *stage, *search, *ends) = (0, RowState::OnRow, Search::Unchanged, [0; MAX_PULSES]);
        (*chi_square, *beyond, *samples, *counts) = (0.0, 0.0, 0, PulseCounts::default());
        (*level_dn, *level_variance) = (0.0, 0.0);
    }

    /// Whether the SIMD kernels decompose the waveform.
    #[inline(always)]
    pub(super) fn is_fast(&self) -> bool {
        self.stage != RowState::LeftToScalar
    }

    /// Whether the pulses are subtracted from the waveform's row.
    #[inline(always)]
    pub(super) fn is_subtracted(&self) -> bool {
        matches!(self.stage, RowState::Subtracted | RowState::Settled | RowState::Levelled)
    }

    /// Whether the pulses still need a fit by the queues.
    #[inline(always)]
    pub(super) fn needs_fit(&self) -> bool {
        matches!(self.stage, RowState::OnRow | RowState::Subtracted)
    }

    /// Whether level and pulses need a joint step, if each waveform has its own background.
    #[inline(always)]
    pub(super) fn needs_level(&self) -> bool {
        matches!(self.stage, RowState::OnRow | RowState::Subtracted | RowState::Settled)
    }

    /// Whether the row is the residual, but its chi-square is unknown.
    ///
    /// Without a branch: the state of successive waveforms is unpredictable.
    #[inline(always)]
    pub(super) fn needs_chi_square(&self) -> bool {
        (self.stage == RowState::Subtracted) | ((self.stage == RowState::OnRow) & (self.count == 0))
    }

    /// Records that the pulses are subtracted; returns whether they already were.
    ///
    /// The caller must subtract them if they were not.
    #[inline(always)]
    pub(super) fn subtract(&mut self) -> bool {
        debug_assert!(
            !matches!(self.stage, RowState::LevelledOnRow | RowState::LeftToScalar),
            "{:?}",
            self.stage
        );
        let already = self.is_subtracted();
        if !already {
            self.stage = RowState::Subtracted;
        }
        already
    }

    /// Records that the pulses have changed, and with them level and chi-square.
    #[inline(always)]
    pub(super) fn reopen(&mut self) {
        debug_assert!(self.is_subtracted(), "{:?}", self.stage);
        self.stage = RowState::Subtracted;
    }

    /// Passes the waveform to the scalar kernels.
    pub(super) fn leave_to_scalar(&mut self) {
        self.stage = RowState::LeftToScalar;
    }

    /// Whether a trial was accepted in this round of the residual search.
    pub(super) fn has_changed(&self) -> bool {
        self.search == Search::Changed
    }

    /// Whether the residual search ended without a decision.
    #[inline(always)]
    pub(super) fn is_undecided(&self) -> bool {
        self.search == Search::Undecided
    }

    /// Begins a round of the residual search.
    pub(super) fn start_search_round(&mut self) {
        debug_assert!(!self.is_undecided());
        self.search = Search::Unchanged;
    }

    /// Records that a trial without an optimum was nearly accepted.
    pub(super) fn set_undecided(&mut self) {
        debug_assert!(!self.has_changed());
        self.search = Search::Undecided;
    }

    /// Records an accepted trial, whose pulses the caller has exchanged in model and row.
    pub(super) fn accept_trial(&mut self) {
        debug_assert!(!self.has_changed());
        self.search = Search::Changed;
        self.counts.n_added += 1;
        self.reopen();
    }

    /// Information on the level that the pulses absorb, 1/DN².
    #[inline(always)]
    pub(super) fn level_information(&self) -> f32 {
        self.pulses().iter().map(|pulse| pulse.level_information).sum()
    }

    /// Sets the level, DN, and variance, DN², for the present pulses.
    #[inline(always)]
    pub(super) fn set_level(&mut self, level_dn: f32, variance: f32) {
        debug_assert!(self.needs_level(), "{:?}", self.stage);
        (self.level_dn, self.level_variance) = (level_dn, variance);
        self.stage = if self.is_subtracted() { RowState::Levelled } else { RowState::LevelledOnRow };
    }

    /// Appends a pulse; `false` if there is no room.
    #[inline(always)]
    pub(super) fn push(&mut self, pulse: PulseComponent) -> bool {
        let Some(place) = self.pulses.get_mut(self.count) else { return false };
        *place = pulse;
        self.count += 1;
        true
    }

    /// Stores the fit of the only pulse.
    ///
    /// The caller must subtract the pulse from the row.
    #[inline(always)]
    pub(super) fn settle(&mut self, fitted: &FittedPulse) {
        debug_assert!(self.stage == RowState::OnRow && self.count == 1, "{:?}", self.stage);
        self.stage = RowState::Settled;
        if let [pulse] = self.pulses_mut() {
            pulse.take(fitted);
            (pulse.sds, pulse.flags) = (fitted.sds, pulse.flags | flags::REFINED);
        }
    }

    /// Replaces some pulses by others; `false` if there is no room.
    pub(super) fn replace(&mut self, old: Range<usize>, new: &[PulseComponent]) -> bool {
        let count = self.count - old.len() + new.len();
        if count > MAX_PULSES {
            return false;
        }
        self.pulses.copy_within(old.end..self.count, old.start + new.len());
        self.pulses[old.start..old.start + new.len()].copy_from_slice(new);
        self.count = count;
        true
    }

    pub(super) fn sort(&mut self) {
        if self.count < 2 {
            return;
        }
        self.pulses[..self.count].sort_unstable_by(|a, b| a.position().total_cmp(&b.position()));
    }

    /// Whether two pulses are close enough to influence each other.
    pub(super) fn overlap(&self, i: usize, j: usize, fwhm_samples: f32) -> bool {
        let (a, b) = (&self.pulses[i], &self.pulses[j]);
        (a.position() - b.position()).abs() < reach(a, fwhm_samples).max(reach(b, fwhm_samples))
    }

    /// Returns the end of the cluster that starts at a pulse; pulses must be sorted.
    pub(super) fn cluster_end(&self, start: usize, fwhm_samples: f32) -> usize {
        let mut end = start + 1;
        while end < self.count && self.overlap(end - 1, end, fwhm_samples) {
            end += 1;
        }
        end
    }

    /// Divides the sorted pulses into jointly fitted clusters.
    ///
    /// Returns whether the clusters have changed.
    pub(super) fn set_clusters(&mut self, fwhm_samples: f32) -> bool {
        if self.count < 2 {
            let end = self.count as u8;
            let others = self.ends[0] != end || self.ends[1] != 0;
            (self.ends[0], self.ends[1]) = (end, 0);
            return others;
        }
        let before = self.ends;
        self.ends = [0; MAX_PULSES];
        let mut end = 0;
        for number in 0..MAX_PULSES {
            if end < self.count {
                end = self.cluster_end(end, fwhm_samples);
                self.ends[number] = end as u8;
            }
        }
        self.ends != before
    }

    /// Returns a cluster by number.
    pub(super) fn cluster(&self, number: usize) -> Option<Range<usize>> {
        let end = usize::from(*self.ends.get(number)?);
        let start = number.checked_sub(1).map_or(0, |before| usize::from(self.ends[before]));
        (start < end).then_some(start..end)
    }

    /// Returns the sorted pulses that form a cluster with a pulse at `position`.
    pub(super) fn cluster_around(&self, position: f32, fwhm_samples: f32) -> Range<usize> {
        let near = |p: &PulseComponent| (p.position() - position).abs() < reach(p, fwhm_samples);
        let Some(first) = self.pulses().iter().position(near) else {
            let at = self.pulses().partition_point(|p| p.position() < position);
            return at..at;
        };
        let last = self.pulses().iter().rposition(near).unwrap_or(first);
        let (mut start, mut end) = (first, last + 1);
        while start > 0 && self.overlap(start - 1, start, fwhm_samples) {
            start -= 1;
        }
        while end < self.count && self.overlap(end - 1, end, fwhm_samples) {
            end += 1;
        }
        start..end
    }
}

fn reach(pulse: &PulseComponent, fwhm_samples: f32) -> f32 {
    CLUSTER_WIDTHS as f32 * fwhm_samples * pulse.width_ratio().max(1.0)
}
