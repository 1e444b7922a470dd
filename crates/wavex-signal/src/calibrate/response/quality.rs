//! Accuracy of the response: template error by time, and error factor by the even/odd test.
//!
//! A response made from echoes is judged on echoes that did not make it: each half of them by the
//! response of the other half.

use super::even_odd::EvenOdd;
use super::{MOST_ECHOES, MOST_SCORED, Single, by_height, narrow_population, response_of, with_response};
use crate::calibrate::evenly;
use crate::decompose::Waveform;
use crate::decompose::acceptance::response_error::Allowance;
use crate::parallel::map_parts;
use crate::pulse_fit::{PulseFit, StopCriteria};
use crate::sensor_model::{ChannelModel, ModelError, ResponseSource};
use crate::shape::Pulse;
use crate::shape::Shape;
use crate::whitening::Whitener;

/// Half their difference is the standard deviation of a normal distribution.
const PERCENTILES: [f64; 2] = [0.158_655, 0.841_345];
/// Significance threshold of a mean or a spread, in its standard deviations.
const SIGNIFICANT: f64 = 2.0;

/// Largest number of echoes per height node in each half.
const MOST_OF_HALF: usize = MOST_ECHOES[3] / 2;
/// Largest number of echoes whose residuals are measured.
const MOST_RESIDUALS: usize = 4_000;
/// Smallest effective number of echoes for an error at a sample.
const LEAST_AT_A_LAG: f64 = 20.0;
/// Number of echoes per task of the even/odd test.
const SCORED_PER_TASK: usize = 64;
/// Fraction of the waveforms in which the expected contribution of the template error may exceed
/// chi-square.
const EXCEEDED_PART: f64 = 0.005;
/// Divisor of the number of waveforms: those with the largest expected contributions determine the part.
const CLEAR_FITS: usize = 3;
/// Fits to the response of the other half end within a hundredth of their standard deviations.
const NEAR: StopCriteria = StopCriteria { iterations: 30, decrease: 1e-4, enough: f64::INFINITY };

pub(super) struct Quality {
    model: ChannelModel,
    shape: Shape,
    /// Difference of the positions from even and odd samples, over its expected standard deviation.
    scores: Vec<f64>,
    /// Excess of the squared residual over the noise, by sample since the start of the response.
    excess: Vec<Excess>,
    fits: Vec<Fit>,
}

/// Sums over echoes of the excess `x`, DN², and the squared height `h²`.
#[derive(Clone, Default)]
struct Excess {
    x: f64,
    h2: f64,
    x_x: f64,
    x_h2: f64,
    h2_h2: f64,
}

impl Excess {
    fn add(&mut self, x: f64, h2: f64) {
        self.x += x;
        self.h2 += h2;
        self.x_x += x * x;
        self.x_h2 += x * h2;
        self.h2_h2 += h2 * h2;
    }

    /// Error relative to the height; 0 if not significant.
    ///
    /// Weights each echo by its energy: the excess of weak echoes is mostly noise.
    fn error(&self) -> f64 {
        let effective = self.h2 * self.h2 / self.h2_h2;
        if effective.is_nan() || effective < LEAST_AT_A_LAG {
            return 0.0;
        }
        let mean = self.x / self.h2;
        let squares = self.x_x - 2.0 * mean * self.x_h2 + mean * mean * self.h2_h2;
        let sd = squares.max(0.0).sqrt() / self.h2;
        (mean - SIGNIFICANT * sd).max(0.0).sqrt()
    }
}

/// Fit of an echo.
struct Fit {
    position_samples: f64,
    height_dn: f64,
    samples: usize,
    chi_square: f64,
    degrees_of_freedom: f64,
}

impl Quality {
    /// Measures a model on single echoes that were fitted with it.
    pub(super) fn of(
        model: &ChannelModel,
        singles: &[Single<'_>],
        longest: usize,
    ) -> Result<Quality, ModelError> {
        let samples = model
            .response
            .as_ref()
            .and_then(|r| r.nodes.first())
            .map_or(0, |node| node.values.len() / crate::sensor_model::response::STEPS_PER_SAMPLE);
        let shape = Shape::of(model)?;
        let mut quality = Quality {
            model: model.clone(),
            shape,
            scores: Vec::new(),
            excess: vec![Excess::default(); samples],
            fits: singles.iter().map(Fit::of).collect(),
        };
        let mut halves = Halves::of(model, singles, longest)?;
        for single in evenly(singles, MOST_RESIDUALS) {
            quality.add_residual(&single, &mut halves);
        }
        quality.score(singles, halves.as_ref(), longest)?;
        Ok(quality)
    }

    /// Applies the even/odd test to at most [`MOST_SCORED`] echoes, by a response that they did not make.
    fn score(
        &mut self,
        singles: &[Single<'_>],
        halves: Option<&Halves>,
        longest: usize,
    ) -> Result<(), ModelError> {
        let of_halves = halves.map(|halves| halves.fitters.each_ref().map(|(_, shape)| shape));
        let shapes = std::iter::once(&self.shape).chain(of_halves.into_iter().flatten());
        let tests = shapes
            .map(|shape| EvenOdd::of_shape(shape.clone(), &self.model, longest))
            .collect::<Result<Vec<_>, _>>()?;
        // The test of all echoes, of the first half, and of the second.
        let index =
            |single: &Single<'_>| halves.and_then(|halves| halves.half_of(single)).map_or(0, |half| 2 - half);
        let scored: Vec<Single<'_>> = evenly(singles, MOST_SCORED).collect();
        let scores = map_parts(&scored, SCORED_PER_TASK, |part| {
            let mut tests = tests.clone();
            let mut score =
                |single: &Single<'_>| tests[index(single)].score(&target(&self.model, single), start(single));
            part.iter().filter_map(&mut score).collect::<Vec<_>>()
        });
        self.scores = scores.into_iter().flatten().collect();
        Ok(())
    }

    /// Writes template error and error factor to a model.
    pub(super) fn apply_to(&self, model: &mut ChannelModel) {
        (model.pulse_error_factor, model.uncertainty.pulse_error_factor) = self.pulse_error_factor();
        if let Some(response) = &mut model.response {
            response.template_error = self.template_error();
            response.excess_part = 1.0;
        }
        let allowance = Allowance::new(model, 0.0, f64::INFINITY);
        let of = |fit: &Fit| {
            let expected = allowance.expected_excess(fit.position_samples, fit.height_dn, fit.samples);
            [fit.chi_square, fit.degrees_of_freedom, expected]
        };
        if let Some(response) = &mut model.response {
            response.excess_part = excess_part(self.fits.iter().map(of));
        }
    }

    /// Adds the residual of an echo, by a response that it did not make.
    fn add_residual(&mut self, single: &Single<'_>, halves: &mut Option<Halves>) {
        let target_dn = target(&self.model, single);
        let other = halves.as_mut().and_then(|halves| halves.residual(single, &target_dn));
        let (pulse, residual_dn) = other.unwrap_or_else(|| {
            let (pulse, mut residual_dn) = (start(single), target_dn);
            residual_dn.iter_mut().for_each(|dn| *dn -= single.offset_dn);
            self.shape.add(&pulse, -1.0, &mut residual_dn);
            (pulse, residual_dn)
        });
        let first = self.model.response.as_ref().map_or(0, |response| response.first_sample);
        let noise = self.model.noise_sd_dn.powi(2);
        for (k, r) in residual_dn.iter().enumerate() {
            let lag = (k as f64 - pulse.position_samples).round() - f64::from(first);
            if lag >= 0.0
                && let Some(excess) = self.excess.get_mut(lag as usize)
            {
                excess.add(r * r - noise, pulse.height_dn.powi(2));
            }
        }
    }

    /// Template error by time; 0 if not significant.
    pub(super) fn template_error(&self) -> Vec<f64> {
        self.excess.iter().map(Excess::error).collect()
    }

    /// Spread of the scores and its standard deviation; 1 if not significant.
    pub(super) fn pulse_error_factor(&self) -> (f64, f64) {
        let spread = spread(&self.scores);
        let sd = factor_sd(spread.max(1.0), self.scores.len());
        (if spread > 1.0 + SIGNIFICANT * sd { spread } else { 1.0 }, sd)
    }
}

/// Part of the expected contribution `Σ (κ a/σ)²` of the template error that chi-square shows.
///
/// `fits` has chi-square, degrees of freedom and `Σ (κ a/σ)²` of waveforms. It is the median ratio
/// of the excess of chi-square to that contribution, in the third of the waveforms with the largest
/// contribution, or less: the contribution exceeds chi-square in at most 0.5 % of the waveforms. 1
/// without a template error.
pub(super) fn excess_part(fits: impl Iterator<Item = [f64; 3]>) -> f64 {
    let with_error = fits.filter(|[_, _, expected]| *expected > 0.0);
    let mut fits: Vec<[f64; 3]> = with_error.collect();
    fits.sort_by(|a, b| b[2].total_cmp(&a[2]));
    // In weak echoes the noise of chi-square is larger than the excess.
    let clear = &fits[..fits.len().div_ceil(CLEAR_FITS)];
    let mut ratios: Vec<f64> =
        clear.iter().map(|[chi_square, freedom, expected]| (chi_square - freedom) / expected).collect();
    let mut largest: Vec<f64> = fits.iter().map(|[chi_square, _, expected]| chi_square / expected).collect();
    ratios.sort_by(f64::total_cmp);
    largest.sort_by(f64::total_cmp);
    let at = |sorted: &[f64], part: f64| sorted.get((part * sorted.len() as f64) as usize).copied();
    match (at(&ratios, 0.5), at(&largest, EXCEEDED_PART)) {
        (Some(median), Some(largest)) => median.min(largest).max(0.0),
        _ => 1.0,
    }
}

/// Responses of both halves of the echoes of a response.
struct Halves {
    /// Fits with the response of the first and of the second half.
    fitters: [(PulseFit, Shape); 2],
    whitener: Whitener,
    /// Half to which each single echo belongs.
    half_of: Vec<Option<usize>>,
}

impl Halves {
    /// `None` for a response of other origin, and if a half does not determine one.
    fn of(
        model: &ChannelModel,
        singles: &[Single<'_>],
        longest: usize,
    ) -> Result<Option<Halves>, ModelError> {
        let is_own = model.provenance.response == ResponseSource::Echoes;
        let Some(response) = model.response.as_ref().filter(|_| is_own) else { return Ok(None) };
        let nodes: Vec<f64> = response.nodes.iter().map(|node| node.peak_dn).collect();
        let mut halves = [Vec::new(), Vec::new()];
        let mut half_of = vec![None; singles.len()];
        for group in by_height(singles, model.full_scale_dn) {
            let narrow = narrow_population(&group.singles);
            narrow.iter().enumerate().for_each(|(i, single)| half_of[single.index] = Some(i % 2));
            for (k, half) in halves.iter_mut().enumerate() {
                let of_half: Vec<_> = narrow.iter().skip(k).step_by(2).copied().collect();
                half.extend(evenly(&of_half, MOST_OF_HALF));
            }
        }
        let [first, second] = halves.each_ref().map(|half| -> Result<Option<_>, ModelError> {
            let Some(response) = response_of(half, model, longest, &nodes)? else { return Ok(None) };
            let shape = Shape::of(&with_response(model, response))?;
            let fitter = PulseFit::new(shape.clone(), model.offset_precision(), longest, 1);
            Ok(Some((fitter, shape)))
        });
        let whitener = Whitener::new(model.noise()?, longest);
        Ok(first?.zip(second?).map(|(a, b)| Halves { fitters: [a, b], whitener, half_of }))
    }

    /// Half of an echo; `None` if it is in neither.
    fn half_of(&self, single: &Single<'_>) -> Option<usize> {
        self.half_of.get(single.index).copied().flatten()
    }

    /// Pulse and residual of an echo by the response of the other half; `None` if it is in neither.
    fn residual(&mut self, single: &Single<'_>, target_dn: &[f64]) -> Option<(Pulse, Vec<f64>)> {
        let half = self.half_of(single)?;
        // An echo that made the response would fit it better than others do.
        let (fitter, shape) = &mut self.fitters[1 - half];
        self.whitener.set_used(&vec![true; target_dn.len()]);
        let fit = fitter.fit(&self.whitener, target_dn, &[start(single)], NEAR);
        let pulse = *fitter.pulses().first().filter(|_| fit.termination.is_optimum())?;
        let mut residual_dn: Vec<f64> = target_dn.iter().map(|dn| dn - fitter.offset_dn()).collect();
        shape.add(&pulse, -1.0, &mut residual_dn);
        Some((pulse, residual_dn))
    }
}

impl Fit {
    fn of(single: &Single<'_>) -> Fit {
        Fit {
            position_samples: single.fitted.position_samples,
            height_dn: single.fitted.amplitude_dn,
            samples: single.block.samples.len(),
            chi_square: single.chi_square,
            degrees_of_freedom: single.degrees_of_freedom,
        }
    }
}

/// Samples of a block less the background, DN.
fn target(model: &ChannelModel, single: &Single<'_>) -> Vec<f64> {
    let Waveform { samples } = single.block;
    let mut target_dn = Vec::with_capacity(samples.len());
    model.signal_into(samples, &mut target_dn);
    target_dn
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
    use crate::decompose::Return;
    use crate::noise::ArNoise;
    use crate::sensor_model::response::{ResponseNode, STEPS_PER_SAMPLE, SystemResponse};
    use crate::simulated::{Random, channel, digitised, moments, noise};

    /// Model of a pulse that rises within 2.5 samples and falls within as many as given.
    fn skewed(model: &ChannelModel, fall: f64) -> ChannelModel {
        let value = |step: i32| {
            let t = f64::from(step) / STEPS_PER_SAMPLE as f64;
            (-(t / if t < 0.0 { 2.5 } else { fall }).powi(2)).exp()
        };
        let steps = 12 * STEPS_PER_SAMPLE as i32;
        let node = ResponseNode { peak_dn: 100.0, values: (-steps..steps).map(value).collect() };
        let (template_error, excess_part) = (Vec::new(), 1.0);
        let (first_sample, nodes, echoes, shape_sd) = (-12, vec![node], 1000, 0.0);
        with_response(
            model,
            SystemResponse { first_sample, nodes, template_error, excess_part, echoes, shape_sd },
        )
    }

    #[test]
    fn no_echo_is_scored_by_a_response_that_it_made() {
        let process = ArNoise::new(&[0.3], 0.8).unwrap();
        let model = channel(&process, 5.0, 10.0);
        let mut values = noise(&mut Random::new(1), &process, 60);
        for (k, value) in values.iter_mut().enumerate() {
            *value += 10.0 + 100.0 * (-((k as f64 - 30.3) / 3.0).powi(2)).exp();
        }
        let samples = digitised(&values, 255);
        let fitted = Return {
            position_samples: 30.0,
            position_sd_samples: 0.1,
            amplitude_dn: 100.0,
            amplitude_sd_dn: 1.0,
            width_ratio: 1.0,
            width_ratio_sd: 0.01,
            fwhm_ns: 5.0,
            deviation_ratio: 0.0,
            flags: 0,
        };
        let single = |index| Single {
            block: Waveform { samples: &samples },
            fitted,
            offset_dn: 0.0,
            chi_square: 56.0,
            degrees_of_freedom: 56.0,
            index,
        };
        let shape = |fall| Shape::of(&skewed(&model, fall)).unwrap();
        let fitter =
            |fall| (PulseFit::new(shape(fall), model.offset_precision(), samples.len(), 1), shape(fall));
        let halves = Halves {
            fitters: [fitter(3.5), fitter(5.0)],
            whitener: Whitener::new(model.noise().unwrap(), samples.len()),
            half_of: vec![Some(0), Some(1), None],
        };
        let mut quality = Quality {
            model: model.clone(),
            shape: shape(2.5),
            scores: Vec::new(),
            excess: Vec::new(),
            fits: Vec::new(),
        };
        quality.score(&[0, 1, 2].map(single), Some(&halves), samples.len()).unwrap();
        let expected = [5.0, 3.5, 2.5].map(|fall| {
            let mut test = EvenOdd::of_shape(shape(fall), &model, samples.len()).unwrap();
            test.score(&target(&model, &single(0)), start(&single(0))).unwrap()
        });
        assert_eq!(quality.scores, expected);
        assert!(expected.array_windows().all(|[a, b]| (a - b).abs() > 0.01), "{expected:?}");
    }

    #[test]
    fn weak_echoes_do_not_hide_the_error_of_strong_ones() {
        let error = |excess_dn2: f64, echoes: u32| {
            let mut excess = Excess::default();
            for i in 0..echoes {
                let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
                match i % 10 {
                    0 | 1 => excess.add(excess_dn2 + 50.0 * sign, 1e6),
                    _ => excess.add(1.4 * sign, 1e2),
                }
            }
            excess.error()
        };
        assert!((0.009..0.01).contains(&error(100.0, 1000)), "{}", error(100.0, 1000));
        assert_eq!(error(0.0, 1000), 0.0);
        assert_eq!(error(100.0, 90), 0.0, "18 strong echoes among 90");
        let mut flat = Excess::default();
        (0..20).for_each(|_| flat.add(1.0, 0.0));
        assert_eq!(flat.error(), 0.0, "no height");
    }

    /// The contribution is at most what chi-square shows.
    #[test]
    fn the_expected_contribution_does_not_exceed_chi_square() {
        // An excess from 0 to 20, with 20 expected; in no order, as among waveforms of equal contribution.
        let fits =
            |expected: f64| (0..1000).map(move |i| [60.0 + 0.02 * f64::from(3 * i % 1000), 60.0, expected]);
        assert!((excess_part(fits(20.0)) - 0.5).abs() < 0.01);
        // Contributions from 10 to 1000 for the same chi-square: the median alone would exceed it.
        let uneven = (0..1000).map(|i| [200.0, 60.0, 10.0 + f64::from(i)]);
        let part = excess_part(uneven.clone());
        let exceeded = uneven.filter(|[chi_square, _, expected]| part * expected > *chi_square).count();
        assert!(exceeded <= 10 && part < 0.21, "{part} {exceeded}");
        assert_eq!((excess_part(fits(0.0)), excess_part([].into_iter())), (1.0, 1.0));
        assert_eq!(excess_part([[50.0, 60.0, 5.0]; 9].into_iter()), 0.0);
    }

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
