//! Compares a channel's model with waveforms of a recording.
//!
//! [`compare`] measures noise, background, pulse shape, clipping level and chi-square of waveforms,
//! without trusting the part of the model that it measures, and reports each [`Finding`] with its
//! measured value, the value of the model and the accepted interval. A finding needs both a
//! significant and a large difference, so that chance and harmless differences are silent.
//! [`Comparison::model_in_use`] is the model with the measured noise and background where these
//! differ. [`Running`] compares stretches of a recording with each other, and [`Receiving`] finds
//! blocks of a receiver that does not work.
//!
//! docs/explanation/sabotage.md shows what each finding notices.

use wavex_simd::SimdLevel;

use crate::calibrate::set_noise;
use crate::decompose::{TableCache, Waveform};
use crate::noise::fit_by_bic;
use crate::sensor_model::{Background, ChannelModel, ModelError};
use statistics::Statistics;

mod finding;
mod limits;
mod receiving;
mod running;
mod statistics;
#[cfg(test)]
mod tests;

pub use finding::{Area, Finding};
pub use receiving::{Receiving, Silence};
pub use running::Running;

/// Fewest waveforms for a comparison.
pub const MIN_WAVEFORMS: usize = 200;
/// Largest number of waveforms that are decomposed, evenly spaced.
const MAX_WAVEFORMS: usize = 2000;
/// Largest order of the noise measured.
const MAX_AR_ORDER: usize = 4;

/// Instructions and tables of the vector kernels.
#[derive(Debug, Clone)]
pub struct KernelContext {
    /// Instructions to use.
    pub simd: SimdLevel,
    /// Tables of equal models of other recordings.
    pub tables: TableCache,
}

/// Result of a comparison.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Differences between model and recording.
    pub findings: Vec<Finding>,
    /// Number of waveforms compared.
    pub waveforms: usize,
    statistics: Statistics,
}

/// Compares a model with waveforms; `None` with fewer than [`MIN_WAVEFORMS`].
///
/// # Errors
/// The model is invalid.
pub fn compare<'a>(
    blocks: impl Iterator<Item = Waveform<'a>> + Clone,
    model: &ChannelModel,
    with: &KernelContext,
) -> Result<Option<Comparison>, ModelError> {
    let waveforms = blocks.clone().count();
    if waveforms < MIN_WAVEFORMS {
        return Ok(None);
    }
    // An odd step covers all phases of the first samples if these alternate.
    let step = waveforms.div_ceil(MAX_WAVEFORMS) | 1;
    let chosen: Vec<Waveform<'a>> = blocks.clone().step_by(step).collect();
    let statistics = Statistics::of(&chosen, model, with)?;
    let mut findings = limits::findings(&statistics, model)?;
    let mut highest = running::Highest::default();
    blocks.for_each(|block| highest.add(block.samples.iter().max().copied().unwrap_or(0)));
    findings.extend(highest.finding(model));
    Ok(Some(Comparison { findings, waveforms, statistics }))
}

impl Comparison {
    /// The model for a recording that differs from it, or `None` if it agrees.
    ///
    /// Noise that differs is replaced by the measured one. A background that differs becomes a free
    /// parameter of each waveform, whose prior covers the difference. A pulse shape that differs
    /// raises the error factor by the root of chi-square over the expected one of single echoes.
    /// The standard deviations of returns follow.
    ///
    /// # Errors
    /// The model is invalid.
    pub fn model_in_use(&self, model: &ChannelModel) -> Result<Option<ChannelModel>, ModelError> {
        let has = |areas: &[Area]| self.findings.iter().any(|finding| areas.contains(&finding.area));
        let mut changed = model.clone();
        if has(&[Area::Noise, Area::Correlation])
            && let Some(quiet) = &self.statistics.quiet
        {
            let lags = &quiet.autocovariance;
            changed.autocorrelation = lags[1..].iter().map(|lag| lag / lags[0]).collect();
            set_noise(&mut changed, fit_by_bic(lags, quiet.samples, MAX_AR_ORDER));
        }
        if has(&[Area::Background]) {
            changed.background = Background::PerWaveform;
            let offset = &self.statistics.offset_dn;
            changed.background_sd_dn = 1.5 * offset.median.abs().max(offset.sd).max(model.background_sd_dn);
            if changed.autocorrelation.is_empty() {
                let mut lags = [0.0; MAX_AR_ORDER + 2];
                changed.noise()?.autocovariance_into(&mut lags);
                changed.autocorrelation = lags[1..].iter().map(|lag| lag / lags[0]).collect();
            }
        }
        if has(&[Area::PulseWidth, Area::PulseShape, Area::TemplateError]) {
            changed.pulse_error_factor *= self.statistics.fits[1].excess_factor();
        }
        Ok((changed != *model).then_some(changed))
    }
}
