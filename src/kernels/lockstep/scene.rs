//! A waveform of the batch and the pulses that explain it so far.

use std::ops::Range;

use super::fitted::{FittedPulse, Values};
use crate::kernels::decompose::Counts;
use crate::kernels::flags;
use crate::kernels::rules::CLUSTER_WIDTHS;

/// Pulses of one waveform that the fast kernels hold; waveforms with more are decomposed by the plain ones.
pub(super) const MAX_PULSES: usize = 8;
/// Pulses that the fast kernels fit jointly.
pub(super) const MAX_CLUSTER: usize = 3;

/// A pulse, and what is known of it beside its values.
#[derive(Clone, Copy)]
pub(super) struct Pulse {
    values: Values,
    /// `e` to the last value, which is asked for often.
    width_ratio: f32,
    pub(super) sds: Values,
    pub(super) flags: u16,
    /// As [`FittedPulse`] has them.
    pub(super) by_level: Values,
    pub(super) level_information: f32,
}

impl Default for Pulse {
    fn default() -> Pulse {
        Pulse::of_calibrated_width(0.0, 0.0)
    }
}

impl Pulse {
    /// A pulse that is not fitted.
    pub(super) fn new(values: Values) -> Pulse {
        Pulse { values, width_ratio: values[2].exp(), ..Pulse::of_calibrated_width(0.0, 0.0) }
    }

    /// A pulse of the calibrated width that is not fitted.
    pub(super) fn of_calibrated_width(height: f32, position: f32) -> Pulse {
        let values = [height, position, 0.0];
        Pulse {
            values,
            width_ratio: 1.0,
            sds: [0.0; 3],
            flags: 0,
            by_level: [0.0; 3],
            level_information: 0.0,
        }
    }

    /// The pulse with other flags.
    pub(super) fn flagged(self, flags: u16) -> Pulse {
        Pulse { flags, ..self }
    }

    pub(super) fn values(&self) -> Values {
        self.values
    }

    pub(super) fn set_values(&mut self, values: Values) {
        self.values = values;
        self.width_ratio = values[2].exp();
    }

    /// Takes what a fit came to, but for the standard deviations.
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

    /// Whether it has been fitted, and its standard deviations are known.
    pub(super) fn is_fitted(&self) -> bool {
        self.sds[1] > 0.0
    }

    pub(super) fn width_ratio(&self) -> f32 {
        self.width_ratio
    }
}

/// How a waveform is dealt with.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
pub(super) enum Way {
    /// By the fast kernels.
    #[default]
    Fast,
    /// By the plain ones: it is not what the fast ones are made for.
    Plain,
}

/// One waveform. Most have one pulse: what is asked of these stands together at the front.
#[derive(Clone, Copy, Default)]
#[repr(C, align(64))]
pub(super) struct Scene {
    count: usize,
    pub(super) way: Way,
    /// Whether the pulses have been taken off the waveform's row.
    pub(super) taken_off: bool,
    /// Whether a trial has been taken up in the present round.
    pub(super) has_changed: bool,
    pub(super) refined_twice: bool,
    /// Whether its one pulse has been fitted and taken off, and chi-square summed.
    pub(super) is_settled: bool,
    pub(super) chi_square: f32,
    /// Samples that chi-square is the sum over.
    pub(super) samples: usize,
    pub(super) counts: Counts,
    /// By how much chi-square promises to fall with pulses wider than the tables allow.
    pub(super) beyond: f32,
    /// Background of the waveform minus that of the channel, DN, and its variance; both 0 for a fixed background.
    pub(super) level_dn: f32,
    pub(super) level_variance: f32,
    /// Whether these are those of the present pulses.
    pub(super) is_levelled: bool,
    /// Ends of the clusters that are fitted jointly, in order; 0 behind the last.
    ends: [u8; MAX_PULSES],
    pulses: [Pulse; MAX_PULSES],
}

impl Scene {
    pub(super) fn pulses(&self) -> &[Pulse] {
        &self.pulses[..self.count]
    }

    pub(super) fn pulses_mut(&mut self) -> &mut [Pulse] {
        &mut self.pulses[..self.count]
    }

    /// A new waveform, without pulses.
    #[inline(always)]
    pub(super) fn reset(&mut self) {
        let Scene {
            way,
            count,
            ends,
            taken_off,
            has_changed,
            chi_square,
            beyond,
            samples,
            counts,
            refined_twice,
            is_settled,
            level_dn,
            level_variance,
            is_levelled,
            ..
        } = self;
        (*way, *count, *ends) = (Way::Fast, 0, [0; MAX_PULSES]);
        (*taken_off, *has_changed, *refined_twice, *is_settled) = (false, false, false, false);
        (*chi_square, *beyond, *samples, *counts) = (0.0, 0.0, 0, Counts::default());
        (*level_dn, *level_variance, *is_levelled) = (0.0, 0.0, false);
    }

    /// The information on the level that the pulses take up, 1/DN².
    #[inline(always)]
    pub(super) fn level_information(&self) -> f32 {
        self.pulses().iter().map(|pulse| pulse.level_information).sum()
    }

    /// Takes a level of the background, DN, and its variance, as those of the present pulses.
    #[inline(always)]
    pub(super) fn set_level(&mut self, level_dn: f32, variance: f32) {
        (self.level_dn, self.level_variance, self.is_levelled) = (level_dn, variance, true);
    }

    /// Leaves the waveform to the plain kernels.
    pub(super) fn give_up(&mut self) {
        self.way = Way::Plain;
    }

    /// Adds a pulse behind the others; `false` where there is no room.
    #[inline(always)]
    pub(super) fn push(&mut self, pulse: Pulse) -> bool {
        let Some(place) = self.pulses.get_mut(self.count) else { return false };
        *place = pulse;
        self.count += 1;
        true
    }

    /// Its one pulse is fitted, and to be taken off its row.
    #[inline(always)]
    pub(super) fn settle(&mut self, fitted: &FittedPulse) {
        (self.is_settled, self.taken_off) = (true, true);
        if let [pulse] = self.pulses_mut() {
            pulse.take(fitted);
            (pulse.sds, pulse.flags) = (fitted.sds, pulse.flags | flags::REFINED);
        }
    }

    /// Puts the given pulses in the place of some; `false` where there is no room.
    pub(super) fn replace(&mut self, old: Range<usize>, new: &[Pulse]) -> bool {
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

    /// Whether two pulses are near enough to bear on each other.
    pub(super) fn overlap(&self, i: usize, j: usize, fwhm_samples: f32) -> bool {
        let (a, b) = (&self.pulses[i], &self.pulses[j]);
        (a.position() - b.position()).abs() < reach(a, fwhm_samples).max(reach(b, fwhm_samples))
    }

    /// The end of the cluster that starts with a pulse, the pulses being sorted.
    pub(super) fn cluster_end(&self, start: usize, fwhm_samples: f32) -> usize {
        let mut end = start + 1;
        while end < self.count && self.overlap(end - 1, end, fwhm_samples) {
            end += 1;
        }
        end
    }

    /// Divides the sorted pulses into the clusters that are fitted jointly; returns whether they are others than before.
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

    /// The cluster of this number.
    pub(super) fn cluster(&self, number: usize) -> Option<Range<usize>> {
        let end = usize::from(*self.ends.get(number)?);
        let start = number.checked_sub(1).map_or(0, |before| usize::from(self.ends[before]));
        (start < end).then_some(start..end)
    }

    /// The pulses, the sorted ones, that a pulse at this place would be in one cluster with.
    pub(super) fn cluster_around(&self, position: f32, fwhm_samples: f32) -> Range<usize> {
        let near = |p: &Pulse| (p.position() - position).abs() < reach(p, fwhm_samples);
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

fn reach(pulse: &Pulse, fwhm_samples: f32) -> f32 {
    CLUSTER_WIDTHS as f32 * fwhm_samples * pulse.width_ratio().max(1.0)
}
