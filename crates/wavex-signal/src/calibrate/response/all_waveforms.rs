//! Error of a response that no single echo made, measured on all waveforms.
//!
//! Where targets hide single echoes, as vegetation under a large footprint does, the samples around
//! the last strong peak of each waveform show the error: nothing is expected behind the ground. The
//! error is relative to the energy of the peaks, because a broad target lowers its peak, but not the
//! tail behind it.

use super::quality::excess_part;
use super::{chosen_evenly, least_errors, strong_dn};
use crate::calibrate::{CalibrationError, CalibrationSettings, WeakPulses, decompose_each};
use crate::decompose::acceptance::response_error::{Allowance, ErrorSource};
use crate::decompose::{DecomposeSettings, Decomposition, Return, Waveform};
use crate::sensor_model::ChannelModel;
use crate::sensor_model::response::STEPS_PER_SAMPLE;
use crate::shape::{Pulse, Shape};

/// Largest number of waveforms, evenly spaced.
const MAX_WAVEFORMS: usize = 1_000;
/// Fewest waveforms at a lag for an error there.
const MIN_WAVEFORMS: usize = 50;
/// Smallest height of the last strong peak, relative to the highest peak.
const LAST_PART: f64 = 0.1;
/// Smallest energy of the last strong peak, relative to that of all peaks up to it.
const DOMINANT_PART: f64 = 0.5;
/// Part of a normal distribution within one SD.
const WITHIN_SD: f64 = 0.682_69;
/// Error at lags that too few waveforms show, relative to the height, where the response exceeds it.
const UNKNOWN_ERROR: f64 = 0.02;

/// Measures template error and excess part of a response.
pub(super) fn measure_error(
    blocks: &[Waveform<'_>],
    model: &mut ChannelModel,
    settings: &CalibrationSettings,
) -> Result<(), CalibrationError> {
    let chosen = chosen_evenly(blocks.iter().copied(), MAX_WAVEFORMS);
    let mut residuals = Residuals::of(&chosen, model, settings)?;
    if let Some(response) = &mut model.response {
        response.template_error.clear();
        let unknown = least_errors(response, UNKNOWN_ERROR);
        response.template_error = residuals.errors(&unknown);
        response.excess_part = 1.0;
    }
    let part = measured_excess_part(&chosen, model, settings)?;
    if let Some(response) = &mut model.response {
        response.excess_part = part;
    }
    Ok(())
}

/// Residuals around the last strong peaks, relative to the energy, by lag.
struct Residuals {
    first_sample: i32,
    /// Magnitudes, and the squared noise.
    by_lag: Vec<(Vec<f64>, Vec<f64>)>,
}

impl Residuals {
    fn of(
        blocks: &[Waveform<'_>],
        model: &ChannelModel,
        settings: &CalibrationSettings,
    ) -> Result<Residuals, CalibrationError> {
        let lags = model
            .response
            .as_ref()
            .and_then(|response| response.nodes.first())
            .map_or(0, |node| node.values.len() / STEPS_PER_SAMPLE);
        let mut residuals = Residuals {
            first_sample: model.response.as_ref().map_or(0, |response| response.first_sample),
            by_lag: vec![(Vec::new(), Vec::new()); lags],
        };
        let shape = Shape::of(model)?;
        // Only detected peaks: a residual search would fit the error.
        let decompose = DecomposeSettings {
            explains_all: false,
            max_added: 0,
            split_evidence: None,
            ..settings.decompose.clone()
        };
        let blocks = blocks.iter().copied();
        decompose_each(blocks, model, &decompose, settings, WeakPulses::FitAgain, |block, outcome| {
            residuals.add(model, &shape, block, outcome);
        })?;
        Ok(residuals)
    }

    fn add(&mut self, model: &ChannelModel, shape: &Shape, block: Waveform<'_>, outcome: &Decomposition<'_>) {
        let highest_dn = outcome.returns.iter().map(|r| r.amplitude_dn).fold(0.0, f64::max);
        let least_dn = (LAST_PART * highest_dn).max(strong_dn(model));
        let Some(last) = outcome.returns.iter().rposition(|r| r.amplitude_dn >= least_dn) else { return };
        let pulses: Vec<Pulse> = outcome.returns[..=last].iter().map(pulse).collect();
        let mut energies = pulses.iter().map(|pulse| ErrorSource::of(pulse).energy_dn);
        let (total_dn, last_dn) = (energies.clone().sum::<f64>(), energies.next_back().unwrap_or(0.0));
        if outcome.saturated || last_dn < DOMINANT_PART * total_dn {
            return;
        }
        let mut residual_dn = Vec::with_capacity(block.samples.len());
        model.signal_into(block.samples, &mut residual_dn);
        pulses.iter().for_each(|pulse| shape.add(pulse, -1.0, &mut residual_dn));
        let noise = (model.noise_sd_dn / total_dn).powi(2);
        let first = outcome.returns[last].position_samples + f64::from(self.first_sample);
        for (k, dn) in residual_dn.iter().enumerate() {
            let lag = (k as f64 - first).round();
            if lag >= 0.0
                && let Some((magnitudes, noises)) = self.by_lag.get_mut(lag as usize)
            {
                magnitudes.push((dn - outcome.background_offset_dn).abs() / total_dn);
                noises.push(noise);
            }
        }
    }

    /// Robust SD without the noise, by lag; `unknown` at lags with too few waveforms.
    fn errors(&mut self, unknown: &[f64]) -> Vec<f64> {
        let error = |((magnitudes, noises), unknown): (&mut (Vec<f64>, Vec<f64>), &f64)| {
            let (count, noise) = (magnitudes.len() as f64, quantile(noises, 0.5));
            match quantile(magnitudes, WITHIN_SD).zip(noise) {
                Some((sd, noise)) if magnitudes.len() >= MIN_WAVEFORMS => {
                    let excess = sd * sd - noise;
                    // The relative uncertainty of a robust variance of `n` values is `1.9/√n`.
                    if excess > 2.0 * 1.9 * noise / count.sqrt() { excess.sqrt() } else { 0.0 }
                }
                _ => *unknown,
            }
        };
        self.by_lag.iter_mut().zip(unknown).map(error).collect()
    }
}

fn pulse(found: &Return) -> Pulse {
    Pulse {
        height_dn: found.amplitude_dn,
        position_samples: found.position_samples,
        ln_width_ratio: found.width_ratio.ln(),
        ln_width_precision: 0.0,
    }
}

/// Excess part by the decomposition of the waveforms as in a run.
fn measured_excess_part(
    blocks: &[Waveform<'_>],
    model: &ChannelModel,
    settings: &CalibrationSettings,
) -> Result<f64, CalibrationError> {
    let allowance = Allowance::new(model, 0.0, f64::INFINITY);
    let mut fits = Vec::with_capacity(blocks.len());
    let blocks = blocks.iter().copied();
    decompose_each(blocks, model, &settings.decompose, settings, WeakPulses::FitAgain, |block, outcome| {
        let of =
            |r: &Return| allowance.expected_excess(r.position_samples, r.amplitude_dn, block.samples.len());
        let expected = outcome.returns.iter().map(of).sum();
        if !outcome.saturated {
            fits.push([outcome.chi_square, outcome.degrees_of_freedom() as f64, expected]);
        }
    })?;
    Ok(excess_part(fits.into_iter()))
}

/// Quantile of a list, which it reorders; `None` if it is empty.
fn quantile(values: &mut [f64], part: f64) -> Option<f64> {
    let index = (part * values.len() as f64) as usize;
    (index < values.len()).then(|| *values.select_nth_unstable_by(index, f64::total_cmp).1)
}
