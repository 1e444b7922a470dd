//! Converts fitted pulses to returns.

use std::ops::Range;

use wavex_simd::{Kernel, Simd};

use super::pulse_model::{PulseComponent, PulseModel};
use super::thresholds::Thresholds;
use crate::decompose::{DEVIANT, Waveform};
use crate::decompose::{DecomposeSettings, Decomposer, Decomposition, Return, truncation_flag};
use crate::flags;
use crate::sensor_model::ChannelModel;

/// Deviation ratio above which the scalar kernels decompose a waveform again.
///
/// Noise alone exceeds it in 0.003 % of waveforms of 60 samples; [`DEVIANT`] it exceeds in 0.3 %, and
/// the scalar kernels take as long for these as the SIMD kernels for 10 % of the waveforms. The lower
/// limit is that of waveforms whose residual search ended without a decision.
const GROSS: f64 = 5.0;

/// Returns of many waveforms; reuses its memory.
#[derive(Debug, Clone, Default)]
pub struct Decompositions {
    returns: Vec<Return>,
    waveforms: Vec<(Range<usize>, Decomposition<'static>)>,
}

impl Decompositions {
    /// Number of waveforms.
    pub fn len(&self) -> usize {
        self.waveforms.len()
    }

    /// Whether there are no waveforms.
    pub fn is_empty(&self) -> bool {
        self.waveforms.is_empty()
    }

    /// Returns the decomposition of a waveform; `None` past the last.
    pub fn get(&self, index: usize) -> Option<Decomposition<'_>> {
        let (returns, rest) = self.waveforms.get(index)?;
        Some(Decomposition { returns: self.returns.get(returns.clone())?, ..*rest })
    }

    /// Iterates over the decompositions in order.
    pub fn iter(&self) -> impl Iterator<Item = Decomposition<'_>> {
        self.waveforms
            .iter()
            .map(|(returns, rest)| Decomposition { returns: &self.returns[returns.clone()], ..*rest })
    }

    pub(super) fn clear(&mut self) {
        self.returns.clear();
        self.waveforms.clear();
    }

    pub(super) fn push(&mut self, outcome: &Decomposition<'_>) {
        let first = self.returns.len();
        self.returns.extend_from_slice(outcome.returns);
        let range = first..self.returns.len();
        self.waveforms.push((range, Decomposition { returns: &[], ..*outcome }));
    }
}

/// Converts the pulses of waveforms to returns.
pub(super) struct Finish<'a> {
    pub(super) model: &'a ChannelModel,
    pub(super) settings: &'a DecomposeSettings,
    pub(super) thresholds: &'a mut Thresholds,
    pub(super) plain: &'a mut Decomposer,
    pub(super) left_to_plain: &'a mut u64,
    /// Whether rejecting a pulse requires a new fit of its neighbours by the scalar kernels.
    ///
    /// The fast modes, and calibration where it does not use weak pulses, only drop the pulse.
    pub(super) is_refined: bool,
}

/// Outputs the returns of a batch.
///
/// It uses no lanes, but compiled for the instruction set it rounds without a function call.
pub(super) struct Give<'a> {
    pub(super) finish: Finish<'a>,
    pub(super) blocks: &'a [Waveform<'a>],
    pub(super) pulse_models: &'a mut [PulseModel],
    pub(super) outcomes: &'a mut Decompositions,
}

impl Kernel for Give<'_> {
    type Output = ();

    #[inline(always)]
    fn run<S: Simd>(mut self, _: S) {
        for (block, pulse_model) in self.blocks.iter().zip(self.pulse_models) {
            self.finish.push_returns(block.samples, pulse_model, self.outcomes);
        }
    }
}

impl Finish<'_> {
    /// Outputs the returns of a waveform.
    #[inline(always)]
    pub(super) fn push_returns(
        &mut self,
        samples: &[u16],
        pulse_model: &mut PulseModel,
        outcomes: &mut Decompositions,
    ) {
        let is_done = pulse_model.is_fast()
            && (self.all_acceptable(pulse_model, samples.len()) || self.drop(pulse_model, samples.len()));
        let mut outcome = self.thresholds.outcome(pulse_model, samples.len());
        let deviation_ratio = outcome.deviation_ratio();
        let limit = if pulse_model.is_undecided() { DEVIANT } else { GROSS };
        let is_unexplained = self.is_refined
            && deviation_ratio > limit
            && self.settings.explains_all
            && self.settings.max_added > 0;
        if !is_done || is_unexplained {
            // By value: a reference would keep `outcome` in memory.
            let done = is_done.then_some([deviation_ratio, f64::from(outcome.counts.np)]);
            if self.push_plain(samples, done, outcomes) {
                return;
            }
            outcome.left_to_plain = true;
        }
        let misfit_factor = outcome.misfit_factor(deviation_ratio, self.settings);
        let sd_factor = misfit_factor * self.model.pulse_error_factor;
        let misfit_flag = if misfit_factor > 1.0 { flags::MISFIT } else { 0 };
        outcome.refined_once |= self.is_refined && pulse_model.counts.n_candidates > 0;
        let first = outcomes.returns.len();
        let fwhm_samples = self.model.fwhm_samples();
        let fwhm = fwhm_samples as f32;
        let mut overlaps_last = false;
        for (i, pulse) in pulse_model.pulses().iter().enumerate() {
            let overlaps_next = i + 1 < pulse_model.pulses().len() && pulse_model.overlap(i, i + 1, fwhm);
            let overlaps = std::mem::replace(&mut overlaps_last, overlaps_next) || overlaps_next;
            let [height, position, _] = pulse.values().map(f64::from);
            let sds = pulse.sds.map(|sd| sd_factor * f64::from(sd));
            let width_ratio = f64::from(pulse.width_ratio());
            let overdriven = self.thresholds.allowance.overdrives(height);
            outcomes.returns.push(Return {
                position_samples: position,
                position_sd_samples: sds[1],
                amplitude_dn: height,
                amplitude_sd_dn: sds[0],
                width_ratio,
                width_ratio_sd: width_ratio * sds[2],
                fwhm_ns: width_ratio
                    * self.thresholds.shape.fwhm_samples_at(height)
                    * self.model.sampling_interval_ns,
                deviation_ratio,
                flags: pulse.flags
                    | truncation_flag(position, width_ratio * fwhm_samples, samples.len())
                    | if overlaps { flags::OVERLAP } else { 0 }
                    | if overdriven { flags::OVERDRIVEN } else { 0 }
                    | misfit_flag
                    | if self.thresholds.is_misshapen(pulse) { flags::UNUSUAL } else { 0 },
            });
        }
        outcomes.waveforms.push((first..outcomes.returns.len(), outcome));
    }

    /// Outputs the returns of the scalar kernels; `false` if they explain the waveform no better.
    ///
    /// `done` holds the deviation ratio and the number of returns so far; `None` if there are none.
    #[cold]
    #[inline(never)]
    fn push_plain(&mut self, samples: &[u16], done: Option<[f64; 2]>, outcomes: &mut Decompositions) -> bool {
        *self.left_to_plain += 1;
        let plain = match done {
            Some(_) => self.plain.decompose_thoroughly(samples),
            None => self.plain.decompose(samples),
        };
        let is_better = done.is_none_or(|done| plain.is_better(done));
        if is_better {
            outcomes.push(&plain);
        }
        is_better
    }

    /// Whether the pulse is fitted, and its row holds enough of it or the waveform is explained.
    #[inline(always)]
    fn is_determined(&self, pulse_model: &PulseModel, pulse: &PulseComponent, samples: usize) -> bool {
        pulse.is_fitted()
            && (!self.is_refined
                || self.thresholds.is_held(pulse)
                || self.thresholds.outcome(pulse_model, samples).deviation_ratio() <= DEVIANT)
    }

    /// Whether all pulses are acceptable as returns and sufficiently separated.
    #[inline(always)]
    fn all_acceptable(&mut self, pulse_model: &PulseModel, samples: usize) -> bool {
        let mut before = f32::NEG_INFINITY;
        pulse_model.pulses().iter().all(|pulse| {
            let is_apart = pulse.position() - before >= self.thresholds.least_separation;
            before = pulse.position();
            is_apart
                && self.is_determined(pulse_model, pulse, samples)
                && self.thresholds.is_return(pulse_model, pulse, samples)
        })
    }

    /// Drops unacceptable pulses if neighbours need no new fit.
    ///
    /// Returns `false` if the scalar kernels must decompose the waveform.
    #[inline(never)]
    fn drop(&mut self, pulse_model: &mut PulseModel, samples: usize) -> bool {
        if self.is_refined || !pulse_model.pulses().iter().all(PulseComponent::is_fitted) {
            return false;
        }
        let least = self.thresholds.least_separation;
        let mut i = 0;
        while i < pulse_model.pulses().len() {
            let near =
                i > 0 && pulse_model.pulses()[i].position() - pulse_model.pulses()[i - 1].position() < least;
            if near {
                // The scalar kernels merge the two and fit the sum; here nothing is fitted again.
                let weaker = if pulse_model.pulses()[i].height() < pulse_model.pulses()[i - 1].height() {
                    i
                } else {
                    i - 1
                };
                pulse_model.replace(weaker..weaker + 1, &[]);
                pulse_model.counts.np_merged += 1;
            } else if !self.thresholds.is_return(pulse_model, &pulse_model.pulses()[i], samples) {
                let reason = self.thresholds.filter_of(pulse_model, &pulse_model.pulses()[i], samples);
                pulse_model.replace(i..i + 1, &[]);
                pulse_model.counts.filter(reason);
            } else {
                i += 1;
            }
        }
        true
    }
}
