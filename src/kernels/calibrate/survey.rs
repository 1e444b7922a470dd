//! One pass over the blocks with the model at hand: free samples, widths, what the fits leave.

use super::Block;
use super::free_samples::FreeSamples;
use super::width::{Width, Widths};
use crate::kernels::decompose::{Decomposition, Return};
use crate::kernels::flags;
use crate::kernels::rules::BEGINS_WIDTHS;
use crate::kernels::sensor_model::{ChannelModel, ModelError};

/// With fewer free samples in a block, in widths of a pulse, what seems free is the rise of a pulse.
const MIN_FREE_WIDTHS: f64 = 1.0;
/// Pulses from this height on, in standard deviations of the noise, have a width worth knowing.
const STRONG_SD: f64 = 20.0;
/// A pulse is single when others reach no more than this part of its height…
const MINOR_PART: f64 = 0.1;
/// … and stand farther off than so many of its widths.
const APART_WIDTHS: f64 = 2.0;

/// What a pass has seen.
#[derive(Debug, Clone)]
pub(super) struct Survey {
    pub(super) blocks: u64,
    /// Those that tell where their pulses are, as none of them is saturated, and of these, those that begin well before.
    pub(super) told_blocks: u64,
    pub(super) free_blocks: u64,
    pub(super) free: FreeSamples,
    pub(super) widths: Widths,
    offsets_dn: Vec<f64>,
    residual_sds: Vec<f64>,
    residual_parts: Vec<f64>,
}

impl Survey {
    /// Before the first of so many blocks is decomposed with a model.
    pub(super) fn of(model: &ChannelModel, blocks: u64) -> Result<Survey, ModelError> {
        Ok(Survey {
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

    /// Takes in a block and what became of it with the model.
    pub(super) fn add(&mut self, model: &ChannelModel, block: Block<'_>, outcome: &Decomposition<'_>) {
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
        self.free.add(&block.samples[..free], block.start_phase);
        if let Some(r) = single(outcome, fwhm_samples).filter(|r| r.amplitude_dn >= strong_dn) {
            let sd = r.width_ratio_sd / r.width_ratio;
            self.widths.0.push(Width { ln_width: r.fwhm_ns.ln(), sd, deviation_ratio: r.deviation_ratio });
        }
    }

    /// Median of the fitted offsets and their robust spread, DN.
    pub(super) fn offset_dn(&self) -> (f64, f64) {
        let mut sorted = self.offsets_dn.clone();
        sorted.sort_by(f64::total_cmp);
        let at = |part: f64| sorted.get((part * sorted.len() as f64) as usize).copied().unwrap_or(0.0);
        (at(0.5), 0.5 * (at(0.841_345) - at(0.158_655)))
    }

    /// Median standard deviation of what the fits leave, in standard deviations of the noise.
    pub(super) fn residual_sd(&self) -> f64 {
        median(&self.residual_sds, 1.0)
    }

    /// Half of what lies between the 16th and the 84th percentile of those.
    pub(super) fn residual_spread(&self) -> f64 {
        let mut sorted = self.residual_sds.clone();
        sorted.sort_by(f64::total_cmp);
        let at = |part: f64| sorted.get((part * sorted.len() as f64) as usize).copied().unwrap_or(0.0);
        0.5 * (at(0.841_345) - at(0.158_655))
    }

    /// The same median over the height of the block's highest pulse, per DN.
    pub(super) fn residual_part(&self) -> f64 {
        median(&self.residual_parts, 0.0)
    }
}

fn median(values: &[f64], without: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(without)
}

/// Whether there is something, and nothing of it could be fitted.
fn is_given_up(outcome: &Decomposition<'_>) -> bool {
    outcome.returns.is_empty() && outcome.counts.n_candidates > 0
}

/// How many of the block's first samples come before any pulse. What was found and could not be fitted may stand
/// anywhere; samples at the full scale are of a pulse even so.
fn samples_before_pulses(model: &ChannelModel, block: Block<'_>, outcome: &Decomposition<'_>) -> usize {
    if is_given_up(outcome) {
        return 0;
    }
    let before = BEGINS_WIDTHS * model.fwhm_samples();
    let begins = |r: &Return| r.position_samples - before * r.width_ratio.max(1.0);
    let first = outcome.returns.iter().map(begins).fold(f64::INFINITY, f64::min);
    let saturated = block.samples.iter().position(|&s| f64::from(s) >= model.full_scale_dn);
    let first = saturated.map_or(first, |k| first.min(k as f64 - before));
    (first.max(0.0).floor() as usize).min(block.samples.len())
}

/// The strongest return, if it is whole, unsaturated, and what else there is does not touch it: an after-pulse does no
/// harm to the width.
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
