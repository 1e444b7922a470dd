//! Accuracy of the response: template error by time, and error factor by the even/odd test.

use super::even_odd::EvenOdd;
use super::{MOST_SCORED, Single};
use crate::decompose::acceptance::response_error::Allowance;
use crate::decompose::{Return, Waveform};
use crate::parallel::map_parts;
use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::Pulse;
use crate::shape::Shape;

/// Half their difference is the standard deviation of a normal distribution.
const PERCENTILES: [f64; 2] = [0.158_655, 0.841_345];
/// Significance threshold of a mean or a spread, in its standard deviations.
const SIGNIFICANT: f64 = 2.0;

/// Number of echoes per task of the even/odd test.
const SCORED_PER_TASK: usize = 64;

pub(super) struct Quality {
    model: ChannelModel,
    shape: Shape,
    even_odd: EvenOdd,
    /// Difference of the positions from even and odd samples, over its expected standard deviation.
    scores: Vec<f64>,
    /// Excess of the squared residual over the noise, relative to the squared height, by sample
    /// since the start of the response: number, sum, sum of squares.
    excess: Vec<[f64; 3]>,
    /// Of each echo: position, height, number of samples, and excess of chi-square.
    fits: Vec<(f64, f64, usize, f64)>,
}

impl Quality {
    pub(super) fn new(model: &ChannelModel, longest: usize) -> Result<Quality, ModelError> {
        let samples = model
            .response
            .as_ref()
            .and_then(|r| r.nodes.first())
            .map_or(0, |node| node.values.len() / crate::sensor_model::response::STEPS_PER_SAMPLE);
        let shape = Shape::of(model)?;
        Ok(Quality {
            model: model.clone(),
            even_odd: EvenOdd::of_shape(shape.clone(), model, longest)?,
            shape,
            scores: Vec::new(),
            excess: vec![[0.0; 3]; samples],
            fits: Vec::new(),
        })
    }

    /// Adds echoes, at most [`MOST_SCORED`] of them to the even/odd test.
    pub(super) fn add_all(&mut self, singles: &[Single<'_>]) {
        singles.iter().for_each(|single| self.add(single));
        let step = singles.len().div_ceil(MOST_SCORED).max(1);
        let scored: Vec<Single<'_>> = singles.iter().copied().step_by(step).collect();
        let scores = map_parts(&scored, SCORED_PER_TASK, |part| {
            let mut even_odd = self.even_odd.clone();
            let score = |single: &Single<'_>| even_odd.score(&self.target(single), start(single));
            part.iter().filter_map(score).collect::<Vec<_>>()
        });
        self.scores.extend(scores.into_iter().flatten());
    }

    /// Writes template error and error factor to a model.
    pub(super) fn apply_to(&self, model: &mut ChannelModel) {
        (model.pulse_error_factor, model.uncertainty.pulse_error_factor) = self.pulse_error_factor();
        if let Some(response) = &mut model.response {
            response.template_error = self.template_error();
            response.excess_part = 1.0;
        }
        let part = self.excess_part(model);
        if let Some(response) = &mut model.response {
            response.excess_part = part;
        }
    }

    /// Adds the residual of an echo.
    fn add(&mut self, single: &Single<'_>) {
        self.add_residual(&self.target(single), start(single));
        let Return { position_samples, amplitude_dn, .. } = single.fitted;
        self.fits.push((position_samples, amplitude_dn, single.block.samples.len(), single.excess));
    }

    /// Samples less the background, DN.
    fn target(&self, single: &Single<'_>) -> Vec<f64> {
        let Waveform { samples, start_phase } = single.block;
        let mut target = Vec::with_capacity(samples.len());
        self.model.signal_into(samples, start_phase, &mut target);
        target
    }

    fn add_residual(&mut self, target: &[f64], pulse: Pulse) {
        let mut residual = target.to_vec();
        self.shape.add(&pulse, -1.0, &mut residual);
        let first = self.model.response.as_ref().map_or(0, |response| response.first_sample);
        let noise = self.model.noise_sd_dn.powi(2);
        for (k, r) in residual.iter().enumerate() {
            let lag = (k as f64 - pulse.position_samples).round() - f64::from(first);
            if lag >= 0.0
                && let Some([count, sum, squares]) = self.excess.get_mut(lag as usize)
            {
                let value = (r * r - noise) / pulse.height_dn.powi(2);
                *count += 1.0;
                *sum += value;
                *squares += value * value;
            }
        }
    }

    /// Template error by time; 0 if not significant.
    pub(super) fn template_error(&self) -> Vec<f64> {
        let error = |[count, sum, squares]: &[f64; 3]| {
            if *count < 20.0 {
                return 0.0;
            }
            let mean = sum / count;
            let sd = ((squares / count - mean * mean) / count).max(0.0).sqrt();
            (mean - SIGNIFICANT * sd).max(0.0).sqrt()
        };
        self.excess.iter().map(error).collect()
    }

    /// Median ratio of the observed excess of chi-square to that expected from the template error of
    /// `model`; 1 if that is 0.
    fn excess_part(&self, model: &ChannelModel) -> f64 {
        let allowance = Allowance::new(model, 0.0, f64::INFINITY);
        let ratio = |&(position, height, samples, excess): &(f64, f64, usize, f64)| {
            let expected = allowance.expected_excess(position, height, samples);
            (expected > 0.0).then(|| excess / expected)
        };
        let mut ratios: Vec<f64> = self.fits.iter().filter_map(ratio).collect();
        ratios.sort_by(f64::total_cmp);
        ratios.get(ratios.len() / 2).map_or(1.0, |part| part.max(0.0))
    }

    /// Spread of the scores and its standard deviation; 1 if not significant.
    pub(super) fn pulse_error_factor(&self) -> (f64, f64) {
        let spread = spread(&self.scores);
        let sd = factor_sd(spread.max(1.0), self.scores.len());
        (if spread > 1.0 + SIGNIFICANT * sd { spread } else { 1.0 }, sd)
    }
}

/// The fitted pulse of an echo.
fn start(single: &Single<'_>) -> Pulse {
    Pulse {
        height_dn: single.fitted.amplitude_dn,
        position_samples: single.fitted.position_samples,
        ln_width_ratio: single.width().ln_width,
        ln_width_precision: 0.0,
    }
}

/// SD of the spread of `n` normal values: `√(0.925/n)`.
fn factor_sd(factor: f64, scores: usize) -> f64 {
    0.962 * factor / (scores.max(1) as f64).sqrt()
}

/// Half the difference of the two percentiles; 0 without values.
fn spread(scores: &[f64]) -> f64 {
    let mut sorted = scores.to_vec();
    sorted.sort_by(f64::total_cmp);
    let at = |part: f64| sorted.get((part * sorted.len() as f64) as usize).copied().unwrap_or(0.0);
    0.5 * (at(PERCENTILES[1]) - at(PERCENTILES[0]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulated::{Random, moments};

    #[test]
    fn the_error_factor_spreads_as_it_says() {
        let mut random = Random::new(8);
        let factors: Vec<f64> =
            (0..400).map(|_| spread(&(0..300).map(|_| 1.1 * random.normal()).collect::<Vec<_>>())).collect();
        let (mean, sd) = moments(&factors);
        assert!((mean - 1.1).abs() < 0.01, "{mean}");
        // The relative uncertainty of an SD of four hundred values is 3.5 %.
        assert!((sd / factor_sd(1.1, 300) - 1.0).abs() < 0.105, "{sd}");
        assert_eq!(spread(&[]), 0.0);
    }
}
