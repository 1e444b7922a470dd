//! Fits pulses to one receiver's block with prior knowledge from another receiver.
//!
//! Minimises `‖L⁻¹(y − model)‖²/f² + Σ (θ_i − m_i)ᵀ P_i (θ_i − m_i)`. The first term is the
//! whitened residual of the used samples, with the calibrated error factor `f`. The second
//! compares, for each pulse in the other receiver, the parameters `θ = (ln height, position, ln
//! width)` with that receiver's fit `m`; its precision `P` includes the uncertainties of gain and
//! delay. If the other fit is an optimum, this is the joint fit of both blocks, to second order in
//! the other's residual. The method is Levenberg–Marquardt.

mod minimise;

use wavex_simd::dot::dot;

use crate::cholesky;
use crate::decompose::OVERDRIVEN_PART;
use crate::decompose::acceptance::CLEAR_OF_ZERO_SD;
use crate::decompose::acceptance::response_error::{Allowance, ErrorSource};
use crate::levenberg_marquardt::{self, LeastSquares};
use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::Pulse;
use crate::shape::Shape;
use crate::whitening::Whitener;
use minimise::RULES;

/// Parameters per pulse.
const PARTS: usize = 3;
/// Number of samples excluded after a saturated one during recovery.
///
/// Used only if the fit shows that the receiver needs to recover.
const RECOVERY_SAMPLES: usize = 1;
/// Excess of chi-square over its degrees of freedom, in standard deviations, above which the model
/// does not describe the receiver. The weight of its samples is then reduced accordingly.
const ASTRAY_SD: f64 = 3.0;

/// Prior knowledge of a pulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Log height (ln DN), position (samples), log width ratio.
    pub mean: [f64; 3],
    /// Covariance of the mean.
    pub covariance: [[f64; 3]; 3],
}

/// A pulse to be fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointPulse {
    /// Start values: log height (ln DN), position (samples), log width ratio.
    pub start: [f64; 3],
    /// Prior knowledge from another receiver.
    pub expected: Option<Expected>,
    /// Precision `1/s²` of a prior on the log width about 0; 0 for none.
    pub ln_width_precision: f64,
}

/// A fitted pulse.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointFitted {
    /// Log height (ln DN), position (samples), log width ratio.
    pub value: [f64; 3],
    /// Covariance of the values.
    pub covariance: [[f64; 3]; 3],
    /// `(θ − m)ᵀ P (θ − m)`; 0 without prior knowledge.
    pub distance: f64,
}

/// Goodness of fit of a block.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointOutcome {
    /// `‖L⁻¹(y − model)‖²`.
    pub chi_square: f64,
    /// Used samples minus parameters.
    pub degrees_of_freedom: usize,
}

impl JointOutcome {
    /// Variance factor from the samples, or `calibrated` if that explains them.
    fn variance_factor(&self, calibrated: f64) -> f64 {
        let nu = self.degrees_of_freedom.max(1) as f64;
        let found = self.chi_square / nu;
        if found > calibrated * (1.0 + ASTRAY_SD * (2.0 / nu).sqrt()) { found } else { calibrated }
    }
}

/// Workspace for the blocks of one receiver.
#[derive(Debug, Clone)]
pub struct JointFit {
    model: ChannelModel,
    shape: Shape,
    whitener: Whitener,
    allowance: Allowance,
    /// Significance of a pulse of height 1 with all samples used.
    per_dn: f64,
    target_dn: Vec<f64>,
    used: Vec<bool>,
    pulses: Vec<JointPulse>,
    /// Inverse of each prior covariance.
    precisions: Vec<[[f64; PARTS]; PARTS]>,
    /// Parameters by pulse, then the background offset if it is free.
    values: Vec<f64>,
    /// Parameters of the last accepted step.
    best: Vec<f64>,
    /// Inverse of the variance factor of the samples.
    weight: f64,
    /// Chi-square at `best` and at `values`.
    chi_square: f64,
    trial_chi_square: f64,
    residual: Vec<f64>,
    columns: Vec<f64>,
    normal: Vec<f64>,
    damped: Vec<f64>,
    gradient: Vec<f64>,
    step: Vec<f64>,
    /// Decrease of the objective promised by the step before it is limited.
    promised: f64,
    fitted: Vec<JointFitted>,
}

impl JointFit {
    /// Creates a workspace for a channel; `template_error` is the smallest relative error of its
    /// response.
    ///
    /// # Errors
    /// Fails if the model describes no channel.
    pub fn new(model: &ChannelModel, template_error: f64) -> Result<JointFit, ModelError> {
        let (shape, mut whitener) = (Shape::of(model)?, Whitener::new(model.noise()?, 0));
        let allowance = Allowance::new(model, template_error, model.overdriven_dn(OVERDRIVEN_PART));
        let per_dn = significance_per_dn(&shape, &mut whitener);
        Ok(JointFit {
            shape,
            whitener,
            allowance,
            per_dn,
            model: model.clone(),
            target_dn: Vec::new(),
            used: Vec::new(),
            pulses: Vec::new(),
            precisions: Vec::new(),
            values: Vec::new(),
            best: Vec::new(),
            weight: 1.0,
            chi_square: 0.0,
            trial_chi_square: 0.0,
            residual: Vec::new(),
            columns: Vec::new(),
            normal: Vec::new(),
            damped: Vec::new(),
            gradient: Vec::new(),
            step: Vec::new(),
            promised: 0.0,
            fitted: Vec::new(),
        })
    }

    /// Model of the channel.
    pub fn model(&self) -> &ChannelModel {
        &self.model
    }

    /// FWHM of a pulse of this height and width ratio 1, samples.
    pub fn fwhm_samples_at(&self, height_dn: f64) -> f64 {
        self.shape.fwhm_samples_at(height_dn)
    }

    /// Smallest height of a pulse with significance `sigma`, DN.
    ///
    /// `position_samples` is its position; `beside` gives positions and heights of other pulses,
    /// whose response errors raise the threshold.
    pub fn least_height_dn(
        &self,
        sigma: f64,
        position_samples: f64,
        beside: impl Iterator<Item = (f64, f64)>,
    ) -> f64 {
        let source =
            |(position_samples, height_dn)| ErrorSource { position_samples, height_dn, energy_dn: height_dn };
        let raise = self.allowance.raise(position_samples, f64::INFINITY, self.per_dn, beside.map(source));
        sigma * raise / self.per_dn
    }

    /// Pulses of the last fit, in input order.
    pub fn fitted(&self) -> &[JointFitted] {
        &self.fitted
    }

    /// Fits pulses to a block. `None` without an optimum, or if a prior covariance is not positive
    /// definite.
    pub fn fit(&mut self, samples: &[u16], pulses: impl Iterator<Item = JointPulse>) -> Option<JointOutcome> {
        self.fitted.clear();
        self.pulses.clear();
        self.pulses.extend(pulses);
        self.precisions.clear();
        for pulse in &self.pulses {
            self.precisions.push(match &pulse.expected {
                Some(expected) => inverse(&expected.covariance)?,
                None => [[0.0; PARTS]; PARTS],
            });
        }
        self.values.clear();
        self.values.extend(self.pulses.iter().flat_map(|pulse| pulse.start));
        self.values.extend(self.model.offset_precision().map(|_| 0.0));
        let calibrated = self.model.pulse_error_factor.powi(2);
        // The sample after a clipped one is left out only if the block does not fit with it.
        self.load(samples, 0);
        let mut first = self.minimise(1.0 / calibrated)?;
        let mut factor = first.variance_factor(calibrated);
        if factor > calibrated && self.used.contains(&false) {
            self.load(samples, RECOVERY_SAMPLES);
            first = self.minimise(1.0 / calibrated)?;
            factor = first.variance_factor(calibrated);
        }
        // A receiver that deviates from its model gets less weight against the other one.
        let outcome = if factor > calibrated { self.minimise(1.0 / factor)? } else { first };
        self.weight = 1.0 / factor;
        self.conclude()?;
        Some(outcome)
    }

    /// Loads the samples and marks the used ones; excludes `recovery_samples` after a saturated
    /// one.
    fn load(&mut self, samples: &[u16], recovery_samples: usize) {
        self.target_dn.clear();
        self.model.signal_into(samples, &mut self.target_dn);
        self.used.clear();
        let clear_dn = CLEAR_OF_ZERO_SD * self.model.noise_sd_dn;
        let mut recovering = 0;
        for (k, &sample) in samples.iter().enumerate() {
            if f64::from(sample) >= self.model.full_scale_dn {
                recovering = recovery_samples + 1;
            }
            self.used.push(recovering == 0 && (sample > 0 || self.model.background_at(k) < clear_dn));
            recovering = recovering.saturating_sub(1);
        }
        self.whitener.set_used(&self.used);
    }

    fn pulse(&self, i: usize) -> Pulse {
        let at = |part: usize| self.values[PARTS * i + part];
        Pulse {
            height_dn: at(0).exp(),
            position_samples: at(1),
            ln_width_ratio: at(2),
            ln_width_precision: 0.0,
        }
    }

    /// Updates the whitened residual to the parameters; returns chi-square.
    fn residual(&mut self) -> f64 {
        let offset = self.values.get(PARTS * self.pulses.len()).copied().unwrap_or(0.0);
        let mut residual = std::mem::take(&mut self.residual);
        residual.clear();
        residual.extend(self.target_dn.iter().map(|y| y - offset));
        (0..self.pulses.len()).for_each(|i| self.shape.add(&self.pulse(i), -1.0, &mut residual));
        self.whitener.whiten(&mut residual);
        self.residual = residual;
        dot(&self.residual, &self.residual)
    }

    /// Prior part of the objective.
    fn prior(&self) -> f64 {
        let pulses = (0..self.pulses.len()).map(|i| {
            let width = self.values[PARTS * i + 2];
            self.distance(i) + self.pulses[i].ln_width_precision * width * width
        });
        let offset = self.values.get(PARTS * self.pulses.len()).map_or(0.0, |b| b * b);
        pulses.sum::<f64>() + offset * self.model.offset_precision().unwrap_or(0.0)
    }

    fn off(&self, i: usize) -> [f64; PARTS] {
        let mean = self.pulses[i].expected.map(|expected| expected.mean);
        std::array::from_fn(|part| mean.map_or(0.0, |mean| self.values[PARTS * i + part] - mean[part]))
    }

    fn distance(&self, i: usize) -> f64 {
        let off = self.off(i);
        let rows = off.iter().zip(&self.precisions[i]);
        rows.map(|(x, row)| x * row.iter().zip(&off).map(|(p, y)| p * y).sum::<f64>()).sum()
    }

    fn add_priors(&mut self) {
        let n = self.values.len();
        for i in 0..self.pulses.len() {
            let off = self.off(i);
            for (a, row) in self.precisions[i].iter().enumerate() {
                for (b, precision) in row.iter().enumerate() {
                    self.normal[(PARTS * i + a) * n + PARTS * i + b] += precision;
                    self.gradient[PARTS * i + a] -= precision * off[b];
                }
            }
            let width = PARTS * i + 2;
            self.normal[width * n + width] += self.pulses[i].ln_width_precision;
            self.gradient[width] -= self.pulses[i].ln_width_precision * self.values[width];
        }
        if let Some(precision) = self.model.offset_precision() {
            self.normal[n * n - 1] += precision;
            self.gradient[n - 1] -= precision * self.values[n - 1];
        }
    }

    /// Minimises the objective with this weight of the samples; `None` without an optimum.
    fn minimise(&mut self, weight: f64) -> Option<JointOutcome> {
        self.weight = weight;
        let (termination, _) = levenberg_marquardt::minimise(self, &RULES);
        self.values.clone_from(&self.best);
        let degrees_of_freedom = self.whitener.used_count().saturating_sub(self.values.len());
        termination.is_optimum().then_some(JointOutcome { chi_square: self.chi_square, degrees_of_freedom })
    }

    /// Computes the covariances at the optimum.
    fn conclude(&mut self) -> Option<()> {
        let n = self.values.len();
        self.residual();
        self.linearise();
        if !cholesky::factor(&mut self.normal, n) {
            return None;
        }
        let mut covariance = vec![0.0; n * n];
        cholesky::invert(&self.normal, n, &mut covariance);
        for i in 0..self.pulses.len() {
            let at = |part: usize| PARTS * i + part;
            self.fitted.push(JointFitted {
                value: std::array::from_fn(|part| self.values[at(part)]),
                covariance: std::array::from_fn(|a| std::array::from_fn(|b| covariance[at(a) * n + at(b)])),
                distance: self.distance(i),
            });
        }
        Some(())
    }
}

/// Root of the chi-square of a pulse of height 1.
fn significance_per_dn(shape: &Shape, whitener: &mut Whitener) -> f64 {
    let samples = (12.0 * shape.fwhm_samples()).ceil().clamp(8.0, 4096.0) as usize;
    let position_samples = 0.5 * samples as f64;
    let mut pulse = vec![0.0; samples];
    let unit = Pulse { height_dn: 1.0, position_samples, ln_width_ratio: 0.0, ln_width_precision: 0.0 };
    shape.add(&unit, 1.0, &mut pulse);
    whitener.set_used(&vec![true; samples]);
    whitener.whiten(&mut pulse);
    pulse.iter().map(|value| value * value).sum::<f64>().sqrt()
}

/// Inverse of a covariance; `None` if it is not positive definite.
fn inverse(covariance: &[[f64; PARTS]; PARTS]) -> Option<[[f64; PARTS]; PARTS]> {
    let mut factor: Vec<f64> = covariance.iter().flatten().copied().collect();
    if !cholesky::factor(&mut factor, PARTS) {
        return None;
    }
    let mut inverse = [0.0; PARTS * PARTS];
    cholesky::invert(&factor, PARTS, &mut inverse);
    Some(std::array::from_fn(|a| std::array::from_fn(|b| inverse[PARTS * a + b])))
}
