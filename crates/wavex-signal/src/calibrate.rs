//! Estimates a channel's model from its waveforms: background, noise, its correlation, and pulse
//! width.
//!
//! Pulses are assumed Gaussian (docs/explanation/method.md, Calibration). An initial estimate gives a level, a
//! spread and a width. Then, twice, blocks are decomposed with the current model, and a better one
//! is estimated from the samples before the first detected pulse and from the widths of single
//! pulses. Samples after a pulse are not used, because of the receiver's slow tail. Signal is
//! identified by fitted pulses and never by a threshold on samples, which would truncate the peaks
//! of the noise. A peak from pulses too weak to be fitted is replaced by a sign-flipped dip of the
//! noise.

use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use wavex_simd::SimdLevel;

use crate::decompose::{DecomposeSettings, Waveform};
use crate::noise::{ArNoise, fit_by_bic};
use crate::sensor_model::{Background, ChannelModel, Digitiser, ModelError, ModelUncertainty};
use crate::sensor_model::{NoiseSource, Provenance, ReceiverLimits, ResponseSource};
use free_samples::NoiseEstimate;
use initial_estimate::InitialEstimate;
use pass_stats::PassStats;

mod batches;
mod clipping;
mod differences;
mod free_samples;
mod histogram;
mod initial_estimate;
mod jackknife;
mod limits;
mod noise_statistics;
mod pass_stats;
mod progress;
pub(crate) mod quiet;
pub mod response;
mod sign_flip;
#[cfg(test)]
mod tests;
mod uncertainty;
mod width;

pub(crate) use batches::{WeakPulses, decompose_each};
pub use clipping::clipping_level_dn;
pub(crate) use clipping::clipping_level_of_counts;
pub(crate) use differences::noise_sd_dn as noise_by_differences_dn;
pub(crate) use jackknife::jackknife_sd;
pub use limits::receiver_limits;
pub use noise_statistics::NoiseStatistics;
pub use progress::CalibrationProgress;
pub use quiet::separate_noise;
pub(crate) use width::{Narrow, Width};

/// Fewest pulses for a width estimate.
const MIN_PULSES: usize = 10;
/// Number of blocks in each round of decomposition and estimation, relative to the most allowed.
///
/// The first model only serves to make the second. The first round decides whether free samples
/// exist and whether the level drifts.
const ROUND_PARTS: [f64; 2] = [0.05, 1.0];
/// Fraction of blocks with free samples needed to use these.
///
/// Only unsaturated blocks with samples well before their pulses count.
const FREE_PART: f64 = 0.3;
/// Number of consecutive groups of a recording whose scatter gives the uncertainties: to 15 %.
pub(crate) const GROUPS: usize = 25;
/// Largest number of pulses added if the background is unknown.
const MAX_OVERLOOKED: u32 = 4;
/// Variance of the background between blocks, over that of the noise, above which each waveform
/// gets its own.
const DRIFT_PART: f64 = 0.5;
/// Smallest SD of a waveform's own background, in standard deviations of the noise.
const LEAST_DRIFT_SD: f64 = 0.1;
/// Factor on the observed spread for the prior on a waveform's background, if levels are only
/// estimated.
const WIDE: f64 = 3.0;
/// Residual over white noise above which pulses are not Gaussian.
const MISSHAPEN: f64 = 2.0;
/// Variance of rounding to whole steps: the lower limit of the noise.
const QUANTISATION_VARIANCE: f64 = 1.0 / 12.0;

/// Source of the background of a waveform.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BackgroundChoice {
    /// Fixed, unless no sample is free of signal or the level drifts between blocks by as much as
    /// the noise.
    Auto,
    /// The channel's background, by sample phase.
    Fixed,
    /// Each waveform's own background.
    PerWaveform,
}

/// Settings of the calibration of a channel.
#[derive(Debug, Clone)]
pub struct CalibrationSettings {
    /// Sampling interval, ns.
    pub sampling_interval_ns: f64,
    /// Samples at or above this are saturated, DN.
    pub full_scale_dn: f64,
    /// Fewest blocks; fewer are an error.
    pub min_blocks: u64,
    /// Largest number of blocks used, evenly spaced; more would not change the model measurably.
    pub max_blocks: usize,
    /// Largest order of the autoregressive noise model.
    pub max_ar_order: usize,
    /// Source of the background.
    pub background: BackgroundChoice,
    /// Prior knowledge of the digitiser.
    pub digitiser: Digitiser,
    /// Decomposition settings during calibration; the calibration controls the adding and splitting
    /// of pulses.
    pub decompose: DecomposeSettings,
    /// Instruction set of the kernels.
    pub simd: SimdLevel,
    /// Ends the calibration with [`CalibrationError::Cancelled`] once set.
    pub cancelled: Arc<AtomicBool>,
    /// Counts decomposed blocks.
    pub progress: Arc<CalibrationProgress>,
}

impl CalibrationSettings {
    /// Settings for an echo channel: 200 to 20 000 blocks, order at most 4, fastest instruction set.
    pub fn echoes(sampling_interval_ns: f64, full_scale_dn: f64) -> CalibrationSettings {
        CalibrationSettings {
            sampling_interval_ns,
            full_scale_dn,
            min_blocks: 200,
            max_blocks: 20_000,
            max_ar_order: 4,
            background: BackgroundChoice::Auto,
            digitiser: Digitiser::default(),
            decompose: DecomposeSettings::default(),
            simd: SimdLevel::best(),
            cancelled: Arc::default(),
            progress: Arc::default(),
        }
    }

    /// Settings for the outgoing pulse: 20 to 2000 blocks, order at most 2, fixed background.
    ///
    /// Every block contains one strong pulse, always the same, and only a few samples precede it.
    pub fn reference(sampling_interval_ns: f64, full_scale_dn: f64) -> CalibrationSettings {
        CalibrationSettings {
            min_blocks: 20,
            max_blocks: 2_000,
            max_ar_order: 2,
            background: BackgroundChoice::Fixed,
            decompose: DecomposeSettings { max_returns: 1, ..DecomposeSettings::default() },
            ..CalibrationSettings::echoes(sampling_interval_ns, full_scale_dn)
        }
    }
}

/// Reasons why a channel cannot be calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// Too few blocks to separate signal from noise.
    #[error(
        "calibration needs {needed} waveforms of the channel and there were {found}; \
         give it more data, or load a saved sensor model"
    )]
    TooFewBlocks {
        /// Number of blocks.
        found: u64,
        /// Required number of blocks.
        needed: u64,
    },
    /// Too few pulses in the blocks.
    #[error(
        "calibration needs {needed} unsaturated pulses above the noise and there were {found} \
         in {blocks} waveforms; give it data with echoes, or load a saved sensor model"
    )]
    TooFewPulses {
        /// Number of pulses.
        found: u64,
        /// Required number of pulses.
        needed: u64,
        /// Number of blocks.
        blocks: u64,
    },
    /// [`CalibrationSettings::cancelled`] was set.
    #[error("the calibration was cancelled")]
    Cancelled,
    /// The settings or the samples give no usable model.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Calibrates one channel.
///
/// The blocks are read several times, so the iterator must be cheap to clone: over samples in
/// memory. In a thread of a `rayon` pool, the other threads share the work; the result does not
/// depend on their number.
///
/// ```
/// use wavex_signal::calibrate::{CalibrationSettings, calibrate};
/// use wavex_signal::decompose::Waveform;
/// # use wavex_signal::{noise::ArNoise, simulated::*};
/// # let (mut random, process) = (Random::new(1), ArNoise::new(&[0.6], 0.8).unwrap());
/// # let recorded: Vec<Vec<u16>> = (0..400)
/// #     .map(|_| {
/// #         let echo = pulse(60.0 + 60.0 * random.uniform(), 20.0 + 9.0 * random.uniform(), 1.0);
/// #         digitised(&analogue(&mut random, &process, 60, 5.0, 4.4, &[echo]), 255)
/// #     })
/// #     .collect();
///
/// // `recorded`: 400 waveforms of 8 bits at 1 GHz.
/// let waveforms = recorded.iter().map(|samples| Waveform { samples });
/// let model = calibrate(waveforms, &CalibrationSettings::echoes(1.0, 255.0))?;
/// assert!((model.pulse_fwhm_ns - 4.4).abs() < 0.1);
/// # Ok::<(), wavex_signal::calibrate::CalibrationError>(())
/// ```
pub fn calibrate<'a, I>(blocks: I, settings: &CalibrationSettings) -> Result<ChannelModel, CalibrationError>
where
    I: Iterator<Item = Waveform<'a>> + Clone,
{
    let found = blocks.clone().count() as u64;
    if found < settings.min_blocks {
        return Err(CalibrationError::TooFewBlocks { found, needed: settings.min_blocks });
    }
    let step = found.div_ceil(settings.max_blocks as u64) as usize | 1;
    let look = InitialEstimate::of(blocks.clone().step_by(step), settings.full_scale_dn);
    if look.pulses < MIN_PULSES {
        let (found_pulses, needed) = (look.pulses as u64, MIN_PULSES as u64);
        return Err(CalibrationError::TooFewPulses { found: found_pulses, needed, blocks: found });
    }
    let background = match settings.background {
        BackgroundChoice::PerWaveform => Background::PerWaveform,
        BackgroundChoice::Fixed | BackgroundChoice::Auto => Background::Fixed,
    };
    let mut model = first_model(&look, background, settings, found);
    let mut free = true;
    for (pass, part) in ROUND_PARTS.into_iter().enumerate() {
        let most = (part * settings.max_blocks as f64).max(1.0) as u64;
        // An odd step covers all phases of the first samples if these alternate.
        let step = found.div_ceil(most) as usize | 1;
        let chosen = || blocks.clone().step_by(step);
        let mut survey = survey(chosen(), &model, free, settings)?;
        free = match pass {
            0 => has_free_samples(&survey, settings),
            _ => free && survey.free.samples() > 0,
        };
        if pass == 0 && settings.background == BackgroundChoice::Auto && (!free || drifts(&survey)) {
            model = first_model(&look, Background::PerWaveform, settings, found);
            survey = self::survey(chosen(), &model, free, settings)?;
            free = free && has_free_samples(&survey, settings);
        }
        model = better_model(&survey, &look, &model, free, settings);
    }
    model.noise()?;
    Ok(model)
}

/// Model of a receiver with too few blocks to calibrate: level and standard deviation of the noise
/// are those of the first samples of its blocks, everything else is another receiver's.
///
/// `None` with fewer than 3 blocks.
pub fn with_borrowed_response<'a>(
    blocks: impl Iterator<Item = Waveform<'a>> + Clone,
    other: &ChannelModel,
    settings: &CalibrationSettings,
) -> Option<ChannelModel> {
    const MIN_BLOCKS: u64 = 3;
    let found = blocks.clone().count() as u64;
    if found < MIN_BLOCKS {
        return None;
    }
    let look = InitialEstimate::of(blocks, settings.full_scale_dn);
    let first = first_model(&look, Background::Fixed, settings, found);
    let ratio = first.noise_sd_dn / other.noise_sd_dn;
    let model = ChannelModel {
        autocorrelation: other.autocorrelation.clone(),
        ar: other.ar.clone(),
        innovation_sd_dn: ratio * other.innovation_sd_dn,
        pulse_fwhm_ns: other.pulse_fwhm_ns,
        pulse_fwhm_sd_ns: other.pulse_fwhm_sd_ns,
        // The samples at the start of one block are hardly independent.
        uncertainty: ModelUncertainty {
            noise_sd_dn: first.noise_sd_dn / (2.0 * found as f64).sqrt(),
            ..first.uncertainty
        },
        ..first
    };
    Some(response::with_response_of(&model, other).unwrap_or(model))
}

/// Decomposes blocks with the current model.
///
/// Only detected pulses are used: on a non-Gaussian pulse a residual search would add components
/// and make it narrow. Detection can overlook a pulse only close to a strong one on an unknown
/// background. It would then contaminate the free samples, so in this case a few pulses are added.
fn survey<'a>(
    blocks: impl Iterator<Item = Waveform<'a>> + Clone,
    model: &ChannelModel,
    free: bool,
    settings: &CalibrationSettings,
) -> Result<PassStats, CalibrationError> {
    let overlooked = free && model.background == Background::PerWaveform;
    let decompose = DecomposeSettings {
        explains_all: false,
        max_added: if overlooked { MAX_OVERLOOKED } else { 0 },
        split_evidence: None,
        ..settings.decompose.clone()
    };
    let mut survey = PassStats::of(model, blocks.clone().count() as u64)?;
    decompose_each(blocks, model, &decompose, settings, WeakPulses::Drop, |block, outcome| {
        survey.add(model, block, outcome)
    })?;
    Ok(survey)
}

/// Whether the level varies between blocks by as much as the noise.
fn drifts(survey: &PassStats) -> bool {
    let (variance, drift) = survey.free.variance_and_drift();
    drift > DRIFT_PART * variance
}

/// Whether enough blocks begin before their pulses; with a fixed background by setting, whether any
/// does.
fn has_free_samples(survey: &PassStats, settings: &CalibrationSettings) -> bool {
    match settings.background {
        BackgroundChoice::Fixed => survey.free.samples() > 0,
        _ => survey.free_blocks > 0 && survey.free_blocks as f64 >= FREE_PART * survey.told_blocks as f64,
    }
}

/// Model from the initial estimate: white noise, no phases.
fn first_model(
    look: &InitialEstimate,
    background: Background,
    settings: &CalibrationSettings,
    blocks: u64,
) -> ChannelModel {
    let (level, spread, sd) = match background {
        Background::Fixed => (look.start_level_dn, 0.0, look.start_sd_dn),
        Background::PerWaveform => (look.floor_level_dn, WIDE * look.floor_sd_dn, look.white_sd_dn),
    };
    let noise_sd_dn = sd.max(QUANTISATION_VARIANCE.sqrt());
    let provenance = Provenance {
        noise_by_differences_dn: look.white_sd_dn,
        response: ResponseSource::Gaussian,
        ..Provenance::default()
    };
    ChannelModel {
        sampling_interval_ns: settings.sampling_interval_ns,
        full_scale_dn: settings.full_scale_dn,
        background,
        background_dn: [level; 4],
        background_sd_dn: spread,
        noise_sd_dn,
        autocorrelation: Vec::new(),
        ar: Vec::new(),
        innovation_sd_dn: noise_sd_dn,
        pulse_fwhm_ns: look.fwhm_samples * settings.sampling_interval_ns,
        pulse_fwhm_sd_ns: 0.0,
        pulse_shape_error: 0.0,
        pulse_error_factor: 1.0,
        response: None,
        digitiser: settings.digitiser,
        uncertainty: ModelUncertainty::default(),
        provenance,
        limits: ReceiverLimits::default(),
        waveforms: blocks,
        pulses: 0,
    }
}

/// Model from a pass with the previous one.
fn better_model(
    survey: &PassStats,
    look: &InitialEstimate,
    last: &ChannelModel,
    free: bool,
    settings: &CalibrationSettings,
) -> ChannelModel {
    let mut model = ChannelModel { waveforms: survey.blocks, ..last.clone() };
    if free {
        from_free_samples(&mut model, survey, settings);
        model.provenance.noise = NoiseSource::FreeSamples;
    } else {
        from_residuals(&mut model, survey, look);
        model.provenance.noise = NoiseSource::Residuals;
    }
    model.uncertainty =
        if free { survey.free.uncertainty() } else { uncertainty::of_residuals(&model, survey) };
    if let Some(width) = survey.widths.narrow_population() {
        model.pulse_fwhm_ns = width.fwhm_ns;
        model.pulse_fwhm_sd_ns = width.fwhm_sd_ns;
        model.uncertainty.pulse_fwhm_ns = width.fwhm_uncertainty_ns;
        model.pulses = width.pulses;
    }
    model
}

/// Estimates background and noise from samples before the first pulse.
fn from_free_samples(model: &mut ChannelModel, survey: &PassStats, settings: &CalibrationSettings) {
    let drift_sd = survey.free.variance_and_drift().1.sqrt();
    let NoiseEstimate { background_dn, mut autocovariance } = survey.free.estimate();
    // Samples of a quiet receiver may be constant, but their rounding error still has this variance.
    autocovariance[0] = autocovariance[0].max(QUANTISATION_VARIANCE);
    let noise = fit_by_bic(&autocovariance, survey.free.samples(), settings.max_ar_order);
    model.background_dn = background_dn;
    model.background_sd_dn = drift_sd;
    if model.background == Background::PerWaveform {
        // No observed drift does not make the level certain, and 0 would mean no prior.
        model.background_sd_dn = model.background_sd_dn.max(LEAST_DRIFT_SD * autocovariance[0].sqrt());
    }
    model.autocorrelation = autocovariance[1..].iter().map(|r| r / autocovariance[0]).collect();
    set_noise(model, noise);
}

/// Estimates background and noise if no sample is free of signal.
///
/// The noise is white with the variance of the residuals, and the levels are those of the fits.
/// Residuals contain the deviation of the pulse from a Gaussian, so their correlation is not that
/// of the noise; [`separate_noise`] removes it. If they exceed the noise, a free level has absorbed the skirt of the pulse; then
/// the smallest samples of the blocks give a better level.
fn from_residuals(model: &mut ChannelModel, survey: &PassStats, look: &InitialEstimate) {
    let residual_sd_dn = model.noise_sd_dn * survey.residual_sd();
    if residual_sd_dn <= MISSHAPEN * look.white_sd_dn {
        let (offset, spread) = survey.offset_dn();
        model.background_dn = model.background_dn.map(|level| level + offset);
        model.background_sd_dn = WIDE * spread;
    } else {
        model.background_dn = [look.floor_level_dn; 4];
        model.background_sd_dn = look.floor_sd_dn.max(QUANTISATION_VARIANCE.sqrt());
        model.pulse_shape_error = model.noise_sd_dn * survey.residual_part();
    }
    model.autocorrelation.clear();
    set_noise(model, ArNoise::new(&[], residual_sd_dn.max(QUANTISATION_VARIANCE.sqrt())));
}

/// At most `most` items, evenly spaced.
pub(crate) fn evenly<T: Copy>(items: &[T], most: usize) -> impl Iterator<Item = T> {
    items.iter().copied().step_by(items.len().div_ceil(most).max(1))
}

/// Replaces the noise of a model; without a process, leaves it.
pub(crate) fn set_noise(model: &mut ChannelModel, noise: Option<ArNoise>) {
    if let Some(noise) = noise {
        model.noise_sd_dn = noise.sd();
        model.ar = noise.coefficients().to_vec();
        model.innovation_sd_dn = noise.innovation_variance().sqrt();
    }
}
