//! A channel's model from its waveforms alone: background, noise and its correlation, width of a pulse.
//!
//! With Gaussian pulses (docs/explanation/method.md, Calibration). A first look gives a level, a spread and a width; then twice blocks are
//! decomposed with the model at hand, and a better one is made of the samples before the first pulse that was found
//! (behind a pulse stands the receiver's slow tail) and of the widths of single pulses. What is signal is thus told by
//! fitted pulses and never by a threshold on samples, which would cut the noise's own peaks away; where pulses too weak to be
//! fitted make a peak, a mirrored dip of the noise stands for it.

use super::decompose::DecomposeSettings;
use super::noise::{ArNoise, fit_by_bic};
use super::sensor_model::{Background, ChannelModel, Digitiser, ModelError, ModelUncertainty};
use first_look::FirstLook;
use free_samples::Told;
use survey::Survey;

mod batches;
mod first_look;
mod free_samples;
mod mirror;
mod noise_statistics;
mod survey;
#[cfg(test)]
mod tests;
mod uncertainty;
mod width;

pub(super) use batches::decompose_each;
pub use noise_statistics::NoiseStatistics;
pub(super) use uncertainty::jackknife_sd;
pub(super) use width::{Narrow, Width};

/// Pulses without which nothing can be said of their width.
const MIN_PULSES: usize = 10;
/// Rounds of decomposing and estimating, each with about so many blocks at most, chosen evenly: the first model only
/// serves to make the second. Whether samples are free, and whether the level drifts, is decided in the first.
const MOST_BLOCKS: [u64; 2] = [5_000, 20_000];
/// Free samples tell the noise where at least this part of the unsaturated blocks begins well before its pulses.
const FREE_PART: f64 = 0.3;
/// A recording is divided into so many consecutive groups, whose scatter tells how well a number is known: to 15 %.
pub(super) const GROUPS: usize = 25;
/// Pulses that are looked for beside those of detection, where the background is unknown.
const MAX_OVERLOOKED: u32 = 4;
/// Background that spreads from block to block by more than this part of the noise's variance is a waveform's own.
const DRIFT_PART: f64 = 0.5;
/// The least spread of a waveform's own background, in standard deviations of the noise.
const LEAST_DRIFT_SD: f64 = 0.1;
/// A prior on a waveform's background this much wider than the spread that was seen, where levels can only be guessed.
const WIDE: f64 = 3.0;
/// Fits that leave more than so many times the white part of the noise are of pulses that are no Gaussians.
const MISSHAPEN: f64 = 2.0;
/// Variance of rounding to whole steps: noise cannot be less.
const QUANTISATION_VARIANCE: f64 = 1.0 / 12.0;

/// One block of samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Block<'a> {
    /// The digitiser's values.
    pub samples: &'a [u16],
    /// Index of the first sample modulo 4.
    pub start_phase: u8,
}

/// Where the background of a waveform is to be taken from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum BackgroundChoice {
    /// Fixed, unless no sample is free of signal or the level drifts from block to block as much as the noise.
    Auto,
    /// The channel's, by the sample's phase.
    Fixed,
    /// Each waveform's own.
    PerWaveform,
}

/// How a channel is calibrated.
#[derive(Debug, Clone, PartialEq)]
pub struct CalibrationSettings {
    /// Time from sample to sample, ns.
    pub sampling_interval_ns: f64,
    /// Samples at or above this are saturated, DN.
    pub full_scale_dn: f64,
    /// Fewer blocks are an error.
    pub min_blocks: u64,
    /// The noise's autoregressive model has at most this order.
    pub max_ar_order: usize,
    /// Where the background is taken from.
    pub background: BackgroundChoice,
    /// What is known beforehand of how samples are taken.
    pub digitiser: Digitiser,
    /// How waveforms are decomposed while calibrating; pulses are added or divided as calibration needs it.
    pub decompose: DecomposeSettings,
}

impl CalibrationSettings {
    /// For a channel of echoes: 200 blocks at least, order 4 at most.
    pub fn echoes(sampling_interval_ns: f64, full_scale_dn: f64) -> CalibrationSettings {
        CalibrationSettings {
            sampling_interval_ns,
            full_scale_dn,
            min_blocks: 200,
            max_ar_order: 4,
            background: BackgroundChoice::Auto,
            digitiser: Digitiser::default(),
            decompose: DecomposeSettings::default(),
        }
    }

    /// For the outgoing pulse: 20 blocks at least, as every block holds the same strong pulse; order 2 at most and a
    /// fixed background, as few samples stand before it.
    pub fn reference(sampling_interval_ns: f64, full_scale_dn: f64) -> CalibrationSettings {
        CalibrationSettings {
            min_blocks: 20,
            max_ar_order: 2,
            background: BackgroundChoice::Fixed,
            ..CalibrationSettings::echoes(sampling_interval_ns, full_scale_dn)
        }
    }
}

/// Why a channel cannot be calibrated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CalibrationError {
    /// Too few blocks to tell signal from noise.
    #[error(
        "calibration needs {needed} waveforms of the channel and there were {found}; \
         give it more data, or load a saved sensor model"
    )]
    TooFewBlocks {
        /// Blocks there were.
        found: u64,
        /// Blocks there must be.
        needed: u64,
    },
    /// Hardly a pulse in the blocks.
    #[error(
        "calibration needs {needed} unsaturated pulses that stand out of the noise and there were {found} \
         in {blocks} waveforms; give it data with echoes, or load a saved sensor model"
    )]
    TooFewPulses {
        /// Pulses there were.
        found: u64,
        /// Pulses there must be.
        needed: u64,
        /// Blocks there were.
        blocks: u64,
    },
    /// The settings or the samples lead to no usable model.
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// Calibrates one channel.
///
/// The blocks are gone through several times, so the iterator must be cheap to clone: one over samples held in memory.
pub fn calibrate<'a, I>(blocks: I, settings: &CalibrationSettings) -> Result<ChannelModel, CalibrationError>
where
    I: Iterator<Item = Block<'a>> + Clone,
{
    let found = blocks.clone().count() as u64;
    if found < settings.min_blocks {
        return Err(CalibrationError::TooFewBlocks { found, needed: settings.min_blocks });
    }
    let look = FirstLook::of(blocks.clone(), settings.full_scale_dn);
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
    for (pass, most) in MOST_BLOCKS.into_iter().enumerate() {
        // An odd step meets all phases of the first samples where these alternate.
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

/// Decomposes blocks with the model at hand.
///
/// Pulses are those that detection finds: on a pulse that is no Gaussian a second look would find others beside it,
/// and make it narrow. Only beside a strong pulse on an unknown background can detection overlook one, which then
/// would stand in the free samples; there a few are added.
fn survey<'a>(
    blocks: impl Iterator<Item = Block<'a>> + Clone,
    model: &ChannelModel,
    free: bool,
    settings: &CalibrationSettings,
) -> Result<Survey, ModelError> {
    let overlooked = free && model.background == Background::PerWaveform;
    let settings = DecomposeSettings {
        max_added: if overlooked { MAX_OVERLOOKED } else { 0 },
        split_evidence: None,
        ..settings.decompose.clone()
    };
    let mut survey = Survey::of(model, blocks.clone().count() as u64)?;
    decompose_each(blocks, model, &settings, |block, outcome| survey.add(model, block, outcome))?;
    Ok(survey)
}

/// Whether the level changes from block to block by as much as the noise.
fn drifts(survey: &Survey) -> bool {
    let (variance, drift) = survey.free.variance_and_drift();
    drift > DRIFT_PART * variance
}

/// Whether blocks begin before their pulses; with a fixed background by choice, whether any does.
fn has_free_samples(survey: &Survey, settings: &CalibrationSettings) -> bool {
    match settings.background {
        BackgroundChoice::Fixed => survey.free.samples() > 0,
        _ => survey.free_blocks > 0 && survey.free_blocks as f64 >= FREE_PART * survey.told_blocks as f64,
    }
}

/// What a first look tells: white noise, no phases.
fn first_model(
    look: &FirstLook,
    background: Background,
    settings: &CalibrationSettings,
    blocks: u64,
) -> ChannelModel {
    let (level, spread, sd) = match background {
        Background::Fixed => (look.start_level_dn, 0.0, look.start_sd_dn),
        Background::PerWaveform => (look.floor_level_dn, WIDE * look.floor_sd_dn, look.white_sd_dn),
    };
    let noise_sd_dn = sd.max(QUANTISATION_VARIANCE.sqrt());
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
        waveforms: blocks,
        pulses: 0,
    }
}

/// The model that a survey with the last one gives.
fn better_model(
    survey: &Survey,
    look: &FirstLook,
    last: &ChannelModel,
    free: bool,
    settings: &CalibrationSettings,
) -> ChannelModel {
    let mut model = ChannelModel { waveforms: survey.blocks, ..last.clone() };
    if free {
        from_free_samples(&mut model, survey, settings);
    } else {
        from_residuals(&mut model, survey, look);
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

/// Background and noise from samples before the first pulse of their block.
fn from_free_samples(model: &mut ChannelModel, survey: &Survey, settings: &CalibrationSettings) {
    let drift_sd = survey.free.variance_and_drift().1.sqrt();
    let Told { background_dn, mut autocovariance } = survey.free.told();
    autocovariance[0] = autocovariance[0].max(QUANTISATION_VARIANCE);
    let noise = fit_by_bic(&autocovariance, survey.free.samples(), settings.max_ar_order);
    model.background_dn = background_dn;
    model.background_sd_dn = drift_sd;
    if model.background == Background::PerWaveform {
        // No drift seen is still no certainty of a level, and 0 would be no prior at all.
        model.background_sd_dn = model.background_sd_dn.max(LEAST_DRIFT_SD * autocovariance[0].sqrt());
    }
    model.autocorrelation = autocovariance[1..].iter().map(|r| r / autocovariance[0]).collect();
    set_noise(model, noise);
}

/// Background and noise where no sample is free: white noise as large as what the fits leave, and the levels of the fits.
/// What they leave is not the receiver's noise alone but also what a pulse is other than a Gaussian, so its correlation
/// says nothing of the noise's; and where it is more than noise, a free level has taken up the pulse's skirt, so that
/// the blocks' smallest samples tell it better.
fn from_residuals(model: &mut ChannelModel, survey: &Survey, look: &FirstLook) {
    let residual_sd_dn = model.noise_sd_dn * survey.residual_sd();
    if residual_sd_dn <= MISSHAPEN * look.white_sd_dn.max(QUANTISATION_VARIANCE.sqrt()) {
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

fn set_noise(model: &mut ChannelModel, noise: Option<ArNoise>) {
    if let Some(noise) = noise {
        model.noise_sd_dn = noise.sd();
        model.ar = noise.coefficients().to_vec();
        model.innovation_sd_dn = noise.innovation_variance().sqrt();
    }
}
