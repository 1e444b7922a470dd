//! The recorded outgoing pulse as the response of an echo receiver.
//!
//! Where clean single echoes are rare or widened by the target, as over vegetation under a large
//! footprint, the outgoing pulse describes the response better than the echoes. Both are compared
//! on the same echoes.
//!
//! No echo is narrower than the pulse that caused it, if the same receiver recorded both. A response
//! that is narrower comes from echoes that the receiver or its digitiser distorted.

use wavex_simd::statistics::median;

use super::all_waveforms::measure_error;
use super::quality::Quality;
use super::{Calibrated, ERRORS, MIN_ECHOES, Single, chosen_evenly, singles, with_response};
use crate::calibrate::{CalibrationError, CalibrationSettings, WeakPulses, decompose_each, evenly, quiet};
use crate::decompose::Waveform;
use crate::sensor_model::{ChannelModel, ModelUncertainty, ResponseSource, SystemResponse};

/// Largest number of blocks of the comparison, evenly spaced.
const MAX_COMPARED: usize = 500;
/// Fewest blocks of the comparison.
const MIN_COMPARED: usize = 50;
/// Largest residual with the outgoing pulse, relative to that with the response of the echoes, for
/// it to replace that. The response of the echoes contains the echo receiver.
const LARGEST_PART: f64 = 0.93;
/// Width of the echoes over that of the outgoing pulse from which targets have widened them; any
/// smaller residual then suffices.
const WIDENED: f64 = 1.25;

/// Smallest width of a response relative to the outgoing pulse: less contradicts physics. Undistorted
/// echoes of a GeoLas scanner have 0.96, and those above 260 DN 0.74.
const NARROWEST: f64 = 0.92;
/// Largest height of echoes over that of the highest outgoing pulses, for their response to be
/// comparable with them.
const COMPARABLE_HEIGHT: f64 = 1.1;
/// Part of the outgoing pulses that are at most as high as their highest.
const HIGHEST_PART: f64 = 0.95;

/// Whether a response is narrower than the outgoing pulse allows.
pub fn is_too_narrow(model: &ChannelModel, outgoing: &ChannelModel) -> bool {
    model.response.is_some() && model.pulse_fwhm_ns < NARROWEST * outgoing.pulse_fwhm_ns
}

/// Height up to which echoes are comparable with outgoing pulses, DN; `None` without outgoing pulses.
pub fn comparable_height_dn<'a>(
    outgoing_blocks: impl Iterator<Item = Waveform<'a>>,
    outgoing: &ChannelModel,
) -> Option<f64> {
    let height_dn = |block: Waveform<'a>| {
        block.samples.iter().max().map(|&highest| f64::from(highest) - outgoing.background_dn[0])
    };
    let mut heights_dn: Vec<f64> = outgoing_blocks.filter_map(height_dn).collect();
    heights_dn.sort_by(f64::total_cmp);
    let index = (HIGHEST_PART * heights_dn.len() as f64) as usize;
    heights_dn.get(index).map(|highest_dn| COMPARABLE_HEIGHT * highest_dn)
}

/// Uses the outgoing pulse as response if it explains the echoes clearly better.
///
/// The measure is the median residual of strong echoes over their peak; the model states it for
/// both responses. It must decrease by 7 %, or at all if the echoes gave no response or are a quarter
/// wider than the outgoing pulse. A response that is narrower than physics allows is replaced in any
/// case. `outgoing` is the calibrated channel of the outgoing pulse.
pub fn with_outgoing_pulse<'a>(
    blocks: impl Iterator<Item = Waveform<'a>> + Clone,
    own: &Calibrated,
    outgoing: &ChannelModel,
    settings: &CalibrationSettings,
) -> Result<Calibrated, CalibrationError> {
    let Some(recorded) = &outgoing.response else { return Ok(own.clone()) };
    let blocks = chosen_evenly(blocks, settings.max_blocks);
    let compared: Vec<Waveform<'a>> = evenly(&blocks, MAX_COMPARED).collect();
    let candidate = candidate(&own.model, outgoing, recorded);
    let mut compared_own = own.model.clone();
    // The candidate has no template error yet, and thresholds depend on it.
    compared_own.response.iter_mut().for_each(|response| response.template_error.clear());
    let residuals = [&compared_own, &candidate].map(|model| residuals_over_peak(&compared, model, settings));
    let [of_echoes, of_outgoing] = residuals;
    let pairs = of_echoes?.into_iter().zip(of_outgoing?);
    let common: Vec<(f64, f64)> = pairs.filter_map(|(a, b)| a.zip(b)).collect();
    if common.len() < MIN_COMPARED && !is_too_narrow(&own.model, outgoing) {
        return Ok(own.clone());
    }
    let medians = [0, 1].map(|of| median(common.iter().map(|pair| [pair.0, pair.1][of])).unwrap_or(0.0));
    let mut chosen = own.clone();
    let is_widened = own.model.pulse_fwhm_ns > WIDENED * outgoing.pulse_fwhm_ns;
    let largest_part = if is_widened || own.model.response.is_none() { 1.0 } else { LARGEST_PART };
    if medians[1] < largest_part * medians[0] || is_too_narrow(&own.model, outgoing) {
        chosen.model = finished(&blocks, &candidate, settings)?;
    }
    chosen.model.provenance.residual_over_peak = medians;
    Ok(chosen)
}

/// The echo receiver with the response of the outgoing pulse.
fn candidate(own: &ChannelModel, outgoing: &ChannelModel, recorded: &SystemResponse) -> ChannelModel {
    // Outgoing pulses are strong: the highest node has the most of them.
    let nodes = recorded.nodes.last().cloned().into_iter().collect();
    let response = SystemResponse { nodes, template_error: Vec::new(), ..recorded.clone() };
    let mut model = with_response(own, response);
    model.pulse_error_factor = 1.0;
    model.pulse_fwhm_sd_ns = outgoing.pulse_fwhm_sd_ns;
    model.uncertainty = ModelUncertainty {
        pulse_fwhm_ns: outgoing.uncertainty.pulse_fwhm_ns,
        pulse_error_factor: 0.0,
        ..own.uncertainty.clone()
    };
    model.provenance.response = ResponseSource::OutgoingPulse;
    model
}

/// Residual of each block over its peak; `None` without an unsaturated strong echo.
fn residuals_over_peak(
    blocks: &[Waveform<'_>],
    model: &ChannelModel,
    settings: &CalibrationSettings,
) -> Result<Vec<Option<f64>>, CalibrationError> {
    let strong_dn = super::strong_dn(model);
    let mut residuals = Vec::with_capacity(blocks.len());
    let (blocks, weak) = (blocks.iter().copied(), WeakPulses::FitAgain);
    decompose_each(blocks, model, &settings.decompose, settings, weak, |block, outcome| {
        let highest = block.samples.iter().max().map_or(0.0, |&sample| f64::from(sample));
        let peak_dn = highest - model.background_dn[0] - outcome.background_offset_dn;
        let freedom = outcome.degrees_of_freedom();
        let is_usable = !outcome.saturated && !outcome.returns.is_empty() && freedom > 0;
        residuals.push(
            (is_usable && peak_dn > strong_dn)
                .then(|| model.noise_sd_dn * (outcome.chi_square / freedom as f64).sqrt() / peak_dn),
        );
    })?;
    Ok(residuals)
}

/// Estimates noise, template error and error factor with the chosen response.
fn finished(
    blocks: &[Waveform<'_>],
    candidate: &ChannelModel,
    settings: &CalibrationSettings,
) -> Result<ChannelModel, CalibrationError> {
    let longest = blocks.iter().map(|block| block.samples.len()).max().unwrap_or(0);
    let mut model = quiet::separate_noise(blocks.iter().copied(), candidate, settings)?;
    let singles: Vec<Single<'_>> = singles(blocks, &model, settings, 0.0, ERRORS[3])?;
    if singles.len() < MIN_ECHOES {
        measure_error(blocks, &mut model, settings)?;
    } else {
        Quality::of(&model, &singles, longest)?.apply_to(&mut model);
    }
    Ok(model)
}
