//! Criteria for accepting a pulse as a return.

use super::candidates::LeftBehind;
use super::layout::BEFORE_PEAK;
use super::pulse_model::{PulseComponent, PulseModel};
use crate::decompose::acceptance::response_error::{Allowance, ErrorSource};
use crate::decompose::acceptance::{
    CLEAR_PART, DetectionSigma, is_misshapen, is_outside, least_separation_samples, width_filter,
};
use crate::decompose::{DecomposeSettings, Decomposition, Filter};
use crate::detect::Detector;
use crate::detect::ECHO_SAMPLES;
use crate::flags;
use crate::sensor_model::{ChannelModel, ModelError};
use crate::shape::SD_OF_FWHM;
use crate::shape::Shape;
use crate::whitening::Whitener;

/// Distance from the ends of the block with full significance, widths: start, end.
const WHOLE_WIDTHS: [f64; 2] = [2.0, 2.5];

/// Largest part of a pulse before its row, standard deviations of the noise.
const LEFT_OUT_SD: f32 = 0.5;

/// Thresholds of one channel.
#[derive(Clone)]
pub(super) struct Thresholds {
    /// Matched-filter statistic after a pulse of height 1 DN.
    pub(super) left_behind: LeftBehind,
    /// Statistic of a whole pulse of height 1 DN.
    pub(super) per_dn: f32,
    /// Statistic of 1 DN of background; 0 for a known background.
    pub(super) level_response: f32,
    pub(super) allowance: Allowance,
    pub(super) sigma: DetectionSigma,
    fwhm_samples: f64,
    noise_sd_dn: f64,
    ln_width_ratio: [f32; 2],
    /// Distance from the ends of the block with full significance, samples: start, end.
    whole_from_ends: [f32; 2],
    /// Minimum separation of two pulses, samples.
    pub(super) least_separation: f32,
    /// Largest width and height for which a row always holds a pulse.
    held_width_ratio: f32,
    held_height_dn: f32,
    pub(super) shape: Shape,
    /// For pulses at the ends of blocks.
    detector: Detector,
    whitener: Whitener,
}

/// A pulse as the source of response errors.
#[inline(always)]
fn source(pulse: &PulseComponent) -> ErrorSource {
    let height_dn = f64::from(pulse.height());
    ErrorSource {
        position_samples: pulse.position().into(),
        height_dn,
        energy_dn: height_dn * f64::from(pulse.width_ratio().max(1.0)),
    }
}

impl Thresholds {
    /// `shape` is that of the model.
    pub(super) fn new(
        model: &ChannelModel,
        settings: &DecomposeSettings,
        shape: Shape,
    ) -> Result<Thresholds, ModelError> {
        let whitener = Whitener::new(model.noise()?, 0);
        let detector = Detector::new(shape.clone(), model.offset_precision(), &whitener, 0);
        let held_height_dn = 2.0 * model.full_scale_dn;
        let left_out = f64::from(LEFT_OUT_SD) * model.noise_sd_dn / held_height_dn;
        // SD of a Gaussian that falls to this part at the start of its row.
        let held_sd_samples = f64::from(BEFORE_PEAK) / (-2.0 * left_out.min(0.5).ln()).sqrt();
        let overdriven_dn = model.overdriven_dn(settings.overdriven_part);
        let echo = (0..ECHO_SAMPLES).map(|lag| detector.echo(lag as f64) as f32).collect();
        Ok(Thresholds {
            left_behind: LeftBehind::new(echo, model.fwhm_samples()),
            per_dn: detector.full_significance_per_dn() as f32,
            level_response: 0.0,
            allowance: Allowance::new(model, settings.template_error, overdriven_dn),
            sigma: DetectionSigma::of(settings),
            fwhm_samples: model.fwhm_samples(),
            noise_sd_dn: model.noise_sd_dn,
            ln_width_ratio: settings.width_ratio.map(|ratio| ratio.ln() as f32),
            whole_from_ends: WHOLE_WIDTHS.map(|widths| (widths * model.fwhm_samples()) as f32),
            least_separation: least_separation_samples(model.fwhm_samples()) as f32,
            held_width_ratio: (0.99 * held_sd_samples / (SD_OF_FWHM * model.fwhm_samples())) as f32,
            held_height_dn: held_height_dn as f32,
            shape,
            detector,
            whitener,
        })
    }

    /// Factor on the threshold at a position due to response errors of other pulses.
    ///
    /// Counts pulses higher than `height_dn`, or all if it is infinite.
    #[inline(always)]
    pub(super) fn raise(&self, pulse_model: &PulseModel, position: f32, height_dn: f32) -> f64 {
        let sources = pulse_model.pulses().iter().map(source);
        self.allowance.raise(f64::from(position), f64::from(height_dn), f64::from(self.per_dn), sources)
    }

    /// Threshold at a position, raised for response errors of pulses above `height_dn`.
    ///
    /// The last pulse may have its own threshold.
    #[inline(always)]
    pub(super) fn threshold(&self, pulse_model: &PulseModel, position: f32, height_dn: f32) -> f64 {
        self.sigma(pulse_model, position) * self.raise(pulse_model, position, height_dn)
    }

    /// Threshold at a position without response errors.
    #[inline(always)]
    fn sigma(&self, pulse_model: &PulseModel, position: f32) -> f64 {
        self.sigma.at(position, pulse_model.pulses().iter().map(PulseComponent::position))
    }

    /// Returns the decomposition of a waveform, without its returns.
    #[inline(always)]
    pub(super) fn outcome(&self, pulse_model: &PulseModel, samples: usize) -> Decomposition<'static> {
        let of = |p: &PulseComponent| {
            self.allowance.expected_excess(p.position().into(), p.height().into(), samples)
        };
        Decomposition {
            counts: pulse_model.counts.with_returns(pulse_model.pulses().len()),
            chi_square: f64::from(pulse_model.chi_square),
            expected_excess: pulse_model.pulses().iter().map(of).sum(),
            samples: pulse_model.samples,
            parameters: 3 * pulse_model.pulses().len() + usize::from(self.level_response > 0.0),
            background_offset_dn: pulse_model.level_dn.into(),
            refined_once: pulse_model.pulses().iter().any(|p| p.flags & flags::REFINED != 0),
            refined_twice: pulse_model.counts.n_added > 0,
            ..Decomposition::default()
        }
    }

    /// Whether a row holds the rise of a pulse.
    ///
    /// The part outside must be below the noise.
    #[inline(always)]
    pub(super) fn is_held(&self, pulse: &PulseComponent) -> bool {
        if pulse.width_ratio() <= self.held_width_ratio && pulse.height() <= self.held_height_dn {
            return true;
        }
        let sd_samples = SD_OF_FWHM as f32 * self.fwhm_samples as f32 * pulse.width_ratio();
        let left_out = (-0.5 * (BEFORE_PEAK as f32 / sd_samples).powi(2)).exp();
        pulse.height() * left_out < LEFT_OUT_SD * self.noise_sd_dn as f32
    }

    /// Whether a fitted pulse is acceptable as a return.
    ///
    /// It must be inside the block and strong enough when given the calibrated width and its own
    /// energy; of unusual width, far above the threshold.
    #[inline(always)]
    pub(super) fn is_return(
        &mut self,
        pulse_model: &PulseModel,
        pulse: &PulseComponent,
        samples: usize,
    ) -> bool {
        if self.is_misshapen(pulse) || is_outside(pulse.position(), [-1.0, samples as f32]) {
            return self.is_clear(pulse_model, pulse, samples);
        }
        self.is_significant(pulse_model, pulse, samples, 1.0)
    }

    /// Reason to drop a pulse that is not acceptable as a return.
    #[cold]
    #[inline(never)]
    pub(super) fn filter_of(
        &mut self,
        pulse_model: &PulseModel,
        pulse: &PulseComponent,
        samples: usize,
    ) -> Filter {
        if is_outside(pulse.position(), [-1.0, samples as f32]) {
            Filter::Outside
        } else if !self.is_significant(pulse_model, pulse, samples, 1.0) {
            Filter::Weak
        } else {
            width_filter(pulse.values()[2], self.ln_width_ratio)
        }
    }

    /// Whether a pulse inside the block is far above the threshold.
    #[cold]
    #[inline(never)]
    fn is_clear(&mut self, pulse_model: &PulseModel, pulse: &PulseComponent, samples: usize) -> bool {
        !is_outside(pulse.position(), [-1.0, samples as f32])
            && self.is_significant(pulse_model, pulse, samples, CLEAR_PART)
    }

    /// Whether a pulse has an unusual width.
    #[inline(always)]
    pub(super) fn is_misshapen(&self, pulse: &PulseComponent) -> bool {
        is_misshapen([pulse.values()[2], pulse.sds[2]], self.ln_width_ratio)
    }

    /// Whether its significance is at least `least` times the threshold.
    #[inline(always)]
    fn is_significant(
        &mut self,
        pulse_model: &PulseModel,
        pulse: &PulseComponent,
        samples: usize,
        least: f64,
    ) -> bool {
        let [before, behind] = self.whole_from_ends;
        let is_whole = pulse.position() >= before && pulse.position() <= samples as f32 - 1.0 - behind;
        let per_dn = if is_whole {
            f64::from(self.per_dn) * self.left_by_level(pulse_model).sqrt()
        } else {
            self.at_edge(pulse.position().into(), samples)
        };
        let energy = f64::from(pulse.height() * pulse.width_ratio());
        let statistic = per_dn * energy;
        let sigma = least * self.sigma(pulse_model, pulse.position());
        // A single pulse, or a strong one among others, passes without computing the response
        // errors of the others.
        let most = if pulse_model.pulses().len() == 1 {
            1.0
        } else {
            self.allowance.raise_at_most(self.per_dn.into(), pulse_model.pulses().iter().map(source))
        };
        statistic >= sigma * most
            || (most > 1.0 && statistic >= sigma * self.raise(pulse_model, pulse.position(), pulse.height()))
    }

    /// Fraction of a pulse's squared significance that remains with an uncertain level.
    #[inline(always)]
    pub(super) fn left_by_level(&self, pulse_model: &PulseModel) -> f64 {
        // The product may exceed 1 if pulses leave little information on the level; callers take the root.
        let lost = self.level_response * self.level_response * pulse_model.level_variance;
        1.0 - f64::from(lost.min(0.9))
    }

    #[inline(never)]
    fn at_edge(&mut self, position: f64, samples: usize) -> f64 {
        if self.whitener.used().len() != samples {
            self.whitener.set_used(&vec![true; samples]);
            self.detector.prepare(&self.whitener);
            self.detector.filter(&self.whitener, &vec![0.0; samples]);
        }
        self.detector.significance_per_dn(&self.whitener, position)
    }
}
