//! Accepted intervals of the measurements.
//!
//! A difference is a finding only if it is both significant and large enough to matter. Limits are
//! those of simulated and real recordings with their own models (docs/explanation/sabotage.md).

use super::finding::{Area, Finding};
use super::statistics::{Location, Statistics};
use crate::sensor_model::{Background, ChannelModel, ModelError, NoiseSource};

/// Significance of a difference, standard deviations.
const SIGNIFICANT: f64 = 5.0;
/// Largest ratio of the measured noise to that of the model, either way …
const NOISE_RATIO: f64 = 1.3;
/// … and the same if the noise of the model contains the misfit of the pulses.
const ROUGH_NOISE_RATIO: f64 = 2.5;
/// Largest difference of the correlation at a lag of one sample.
const CORRELATION: f64 = 0.2;
/// Largest offset of the background, standard deviations of the noise or of the background.
const BACKGROUND_SD: f64 = 1.0;
/// Largest difference of the logarithm of the width of single echoes.
const LN_WIDTH: f64 = 0.05;
/// Largest mean residual of single echoes relative to their height …
const SHAPE: f64 = 0.012;
/// … and relative to the error that the model states.
const SHAPE_ERRORS: f64 = 2.0;
/// Fewest weak and strong single echoes.
const MIN_FITS: usize = 25;
/// Smallest and largest increase of chi-square from weak to strong echoes over the expected one …
const EXCESS_RATIOS: [f64; 2] = [0.35, 2.8];
/// … and a difference of chi-square per degree of freedom that does not matter.
const EXCESS_MARGIN: f64 = 0.03;
/// Smallest fraction of waveforms with an echo.
const WITH_ECHO: f64 = 0.01;

/// Findings of the measurements of a channel.
pub(super) fn findings(statistics: &Statistics, model: &ChannelModel) -> Result<Vec<Finding>, ModelError> {
    let (noise, correlation) = noise(statistics, model)?;
    let shape = if model.response.is_some() { shape(statistics, model) } else { None };
    let all = [
        noise,
        correlation,
        background(statistics, model),
        width(statistics, model),
        shape,
        template_error(statistics),
        echoes(statistics),
    ];
    Ok(all.into_iter().flatten().filter_map(Finding::unless_accepted).collect())
}

/// Noise by quiet samples, and by fourth differences without them; correlation by quiet samples.
fn noise(
    statistics: &Statistics,
    model: &ChannelModel,
) -> Result<(Option<Finding>, Option<Finding>), ModelError> {
    let process = model.noise()?;
    let is_rough = matches!(model.provenance.noise, NoiseSource::Residuals | NoiseSource::Differences);
    let ratio = if is_rough { ROUGH_NOISE_RATIO } else { NOISE_RATIO };
    let interval = |expected: f64| [expected / ratio, expected * ratio];
    let white_dn = process.difference_sd();
    let by_differences = Finding {
        area: Area::Noise,
        measured: statistics.differences_dn,
        expected: white_dn,
        accepted: interval(white_dn),
        unit: "DN",
    };
    let Some(quiet) = &statistics.quiet else { return Ok((Some(by_differences), None)) };
    let measured = quiet.autocovariance[0].sqrt();
    let total =
        Finding { measured, expected: process.sd(), accepted: interval(process.sd()), ..by_differences };
    let mut lags = [0.0; 2];
    process.autocovariance_into(&mut lags);
    let expected = lags[1] / lags[0];
    let correlation = Finding {
        area: Area::Correlation,
        measured: quiet.autocovariance.get(1).map_or(0.0, |lag| lag / quiet.autocovariance[0]),
        expected,
        accepted: [expected - CORRELATION, expected + CORRELATION],
        unit: "",
    };
    Ok((Some(total), (!is_rough).then_some(correlation)))
}

/// Offset of the waveforms from the background of the model.
fn background(statistics: &Statistics, model: &ChannelModel) -> Option<Finding> {
    let offset = &statistics.offset_dn;
    let limit_dn = match model.background {
        Background::Fixed => BACKGROUND_SD * model.noise_sd_dn,
        // Without a prior any level is expected.
        Background::PerWaveform if model.background_sd_dn == 0.0 => return None,
        Background::PerWaveform => BACKGROUND_SD * model.noise_sd_dn.max(model.background_sd_dn),
    };
    let limit_dn = limit_dn + SIGNIFICANT * offset.median_sd();
    Some(Finding {
        area: Area::Background,
        measured: offset.median,
        expected: 0.0,
        accepted: [-limit_dn, limit_dn],
        unit: "DN",
    })
}

/// Lower mode of the widths of single echoes.
fn width(statistics: &Statistics, model: &ChannelModel) -> Option<Finding> {
    let mode = statistics.ln_width?;
    let limit =
        LN_WIDTH + SIGNIFICANT * mode.median_sd() + model.uncertainty.pulse_fwhm_ns / model.pulse_fwhm_ns;
    Some(Finding {
        area: Area::PulseWidth,
        measured: mode.median.exp(),
        expected: 1.0,
        accepted: [(-limit).exp(), limit.exp()],
        unit: "",
    })
}

/// Mean residual of single echoes at the lag where it exceeds its limit most.
fn shape(statistics: &Statistics, model: &ChannelModel) -> Option<Finding> {
    let response = model.response.as_ref()?;
    let limit = |(lag, residual): &(i32, Location)| {
        let stated = response.template_error_at(f64::from(*lag)).max(response.shape_sd);
        // Tails are a constant part of the height; other targets are not.
        let is_clear = statistics.least_residual == 0.0;
        let spread = if is_clear { 0.0 } else { 2.0 * residual.sd };
        SHAPE.max(statistics.least_residual).max(SHAPE_ERRORS * stated).max(spread)
            + SIGNIFICANT * residual.median_sd()
    };
    let over = |of: &(i32, Location)| of.1.median.abs() / limit(of);
    let worst = statistics.residual.iter().max_by(|a, b| over(a).total_cmp(&over(b)))?;
    Some(Finding {
        area: Area::PulseShape,
        measured: worst.1.median,
        expected: 0.0,
        accepted: [-limit(worst), limit(worst)],
        unit: "",
    })
}

/// Increase of chi-square per degree of freedom from weak to strong single echoes.
///
/// The increase is that of the template error: an error of the noise is common to both.
fn template_error(statistics: &Statistics) -> Option<Finding> {
    let [weak, strong] = &statistics.fits;
    if weak.count < MIN_FITS || strong.count < MIN_FITS {
        return None;
    }
    let expected = strong.expected_excess - weak.expected_excess;
    let margin = EXCESS_MARGIN + SIGNIFICANT * (weak.variance() + strong.variance()).sqrt();
    let [least, most] = EXCESS_RATIOS.map(|ratio| ratio * expected);
    Some(Finding {
        area: Area::TemplateError,
        measured: strong.chi_square - weak.chi_square,
        expected,
        accepted: [least - margin, most + margin],
        unit: "",
    })
}

/// Share of waveforms with an echo.
fn echoes(statistics: &Statistics) -> Option<Finding> {
    Some(Finding {
        area: Area::Echoes,
        measured: statistics.with_echo as f64 / statistics.waveforms as f64,
        expected: 1.0,
        accepted: [WITH_ECHO, f64::INFINITY],
        unit: "",
    })
}
