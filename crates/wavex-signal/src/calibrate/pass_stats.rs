//! One pass over the blocks with the current model: free samples, widths, residuals.

use wavex_simd::statistics::median;

use super::free_samples::FreeSamples;
use super::width::{Width, Widths};
use crate::decompose::Waveform;
use crate::decompose::acceptance::BEGINS_WIDTHS;
use crate::decompose::{Decomposition, Return};
use crate::flags;
use crate::sensor_model::{ChannelModel, ModelError};

/// Fewest free samples in a block, in pulse widths; fewer are the rising edge of a pulse.
const MIN_FREE_WIDTHS: f64 = 1.0;
/// Smallest height of pulses whose width is used, in standard deviations of the noise.
const STRONG_SD: f64 = 20.0;
/// Largest height of other pulses, relative to a pulse, for it to be single…
const MINOR_PART: f64 = 0.1;
/// … and their smallest distance from it, in its widths.
const APART_WIDTHS: f64 = 2.0;

/// Statistics of a pass.
#[derive(Debug, Clone)]
pub(super) struct PassStats {
    pub(super) blocks: u64,
    /// Blocks whose pulse positions are known because no sample is saturated, and those of them
    /// that begin well before their pulses.
    pub(super) told_blocks: u64,
    pub(super) free_blocks: u64,
    pub(super) free: FreeSamples,
    pub(super) widths: Widths,
    offsets_dn: Vec<f64>,
    residual_sds: Vec<f64>,
    residual_parts: Vec<f64>,
}

impl PassStats {
    /// Starts a pass over `blocks` blocks with a model.
    pub(super) fn of(model: &ChannelModel, blocks: u64) -> Result<PassStats, ModelError> {
        Ok(PassStats {
            blocks: 0,
            told_blocks: 0,
            free_blocks: 0,
            free: FreeSamples::of(model, blocks)?,
            widths: Widths::default(),
            offsets_dn: Vec::new(),
            residual_sds: Vec::new(),
            residual_parts: Vec::new(),
        })
    }

    /// Adds a block and its decomposition.
    pub(super) fn add(&mut self, model: &ChannelModel, block: Waveform<'_>, outcome: &Decomposition<'_>) {
        let fwhm_samples = model.fwhm_samples();
        let strong_dn = STRONG_SD * model.noise_sd_dn;
        self.blocks += 1;
        self.offsets_dn.push(outcome.background_offset_dn);
        if outcome.degrees_of_freedom() > 0 {
            let sd = (outcome.chi_square / outcome.degrees_of_freedom() as f64).sqrt();
            self.residual_sds.push(sd);
            let highest = outcome.returns.iter().map(|r| r.amplitude_dn).fold(0.0, f64::max);
            self.residual_parts.extend((highest > 0.0).then(|| sd / highest));
        }
        let free = samples_before_pulses(model, block, outcome);
        if !outcome.saturated && !is_given_up(outcome) {
            self.told_blocks += 1;
            self.free_blocks += u64::from(free as f64 >= MIN_FREE_WIDTHS * fwhm_samples);
        }
        self.free.add(&block.samples[..free]);
        if let Some(r) = single(outcome, fwhm_samples).filter(|r| r.amplitude_dn >= strong_dn) {
            let sd = r.width_ratio_sd / r.width_ratio;
            self.widths.0.push(Width { ln_width: r.fwhm_ns.ln(), sd, deviation_ratio: r.deviation_ratio });
        }
    }

    /// Median and robust SD of the fitted offsets, DN.
    pub(super) fn offset_dn(&self) -> (f64, f64) {
        median_and_spread(self.offsets_dn.clone())
    }

    /// Median SD of the residuals, in standard deviations of the noise.
    pub(super) fn residual_sd(&self) -> f64 {
        median(self.residual_sds.iter().copied()).unwrap_or(1.0)
    }

    /// Half the difference of the 16th and 84th percentiles of these.
    pub(super) fn residual_spread(&self) -> f64 {
        median_and_spread(self.residual_sds.clone()).1
    }

    /// Median of the residual SD over the highest pulse, per DN.
    pub(super) fn residual_part(&self) -> f64 {
        median(self.residual_parts.iter().copied()).unwrap_or(0.0)
    }
}

/// Median, and half the difference of the 16th and 84th percentiles; 0 without values.
pub(super) fn median_and_spread(mut values: Vec<f64>) -> (f64, f64) {
    values.sort_by(f64::total_cmp);
    let at = |part: f64| values.get((part * values.len() as f64) as usize).copied().unwrap_or(0.0);
    (at(0.5), 0.5 * (at(0.841_345) - at(0.158_655)))
}

/// Whether candidates exist but none could be fitted.
fn is_given_up(outcome: &Decomposition<'_>) -> bool {
    outcome.returns.is_empty() && outcome.counts.n_candidates > 0
}

/// Number of samples of a block before any pulse.
///
/// 0 if candidates could not be fitted, because their positions are unknown. Saturated samples
/// count as a pulse in any case.
fn samples_before_pulses(model: &ChannelModel, block: Waveform<'_>, outcome: &Decomposition<'_>) -> usize {
    if is_given_up(outcome) {
        return 0;
    }
    let before = BEGINS_WIDTHS * model.fwhm_samples();
    // A widened pulse begins earlier. A width ratio below 1 is noise: no pulse begins later.
    let begins = |r: &Return| r.position_samples - before * r.width_ratio.max(1.0);
    let first = outcome.returns.iter().map(begins).fold(f64::INFINITY, f64::min);
    let saturated = block.samples.iter().position(|&s| f64::from(s) >= model.full_scale_dn);
    let first = saturated.map_or(first, |k| first.min(k as f64 - before));
    (first.max(0.0).floor() as usize).min(block.samples.len())
}

/// The strongest return, if it is complete, unsaturated, and separate from all others.
///
/// An after-pulse does not affect the width.
fn single<'a>(outcome: &Decomposition<'a>, fwhm_samples: f64) -> Option<&'a Return> {
    let returns = outcome.returns;
    let strongest = returns.iter().max_by(|a, b| a.amplitude_dn.total_cmp(&b.amplitude_dn))?;
    let apart = |r: &Return| {
        let distance = (r.position_samples - strongest.position_samples).abs();
        std::ptr::eq(r, strongest)
            || (r.amplitude_dn <= MINOR_PART * strongest.amplitude_dn
                && distance > APART_WIDTHS * fwhm_samples)
    };
    let whole = strongest.flags & (flags::SATURATED | flags::TRUNCATED) == 0;
    (whole && returns.iter().all(apart)).then_some(strongest)
}
