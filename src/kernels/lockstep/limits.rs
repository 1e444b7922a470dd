//! What a pulse must reach to be a return.

use super::scene::{Pulse, Scene};
use crate::kernels::allowance::Allowance;
use crate::kernels::decompose::DecomposeSettings;
use crate::kernels::detect::Detector;
use crate::kernels::sensor_model::{ChannelModel, ModelError};
use crate::kernels::shape::Shape;
use crate::kernels::whitening::Whitener;

/// How far behind a pulse its echo in the filter is told, samples.
const ECHO_SAMPLES: usize = 256;
/// Pulses so many widths inside the block have the significance of whole ones.
const WHOLE_WIDTHS: [f64; 2] = [2.0, 2.5];

/// Gates of the score test, chi-square of two degrees of freedom: for pulses up to so many standard deviations of the noise
/// high, and for higher ones.
const SCORE_GATES: [f64; 2] = [4.6, 6.0];
const WEAK_SNR: f64 = 30.0;

/// Thresholds of one channel.
pub(super) struct Limits {
    /// The matched filter's statistic by whole sample behind a pulse of height 1.
    pub(super) echo: Vec<f32>,
    /// The statistic of a whole pulse of height 1.
    pub(super) per_dn: f32,
    pub(super) allowance: Allowance,
    detection_sigma: f64,
    fwhm_samples: f64,
    noise_sd_dn: f64,
    /// For pulses at the ends of blocks.
    detector: Detector,
    whitener: Whitener,
}

impl Limits {
    pub(super) fn new(model: &ChannelModel, settings: &DecomposeSettings) -> Result<Limits, ModelError> {
        let whitener = Whitener::new(model.noise()?, 0);
        let detector = Detector::new(Shape::of(model)?, model.offset_precision(), &whitener, 0);
        let overdriven_dn = settings.overdriven_part * model.full_scale_dn;
        Ok(Limits {
            echo: (0..ECHO_SAMPLES).map(|lag| detector.echo(lag as f64) as f32).collect(),
            per_dn: detector.full_significance_per_dn() as f32,
            allowance: Allowance::new(model, settings.template_error, overdriven_dn),
            detection_sigma: settings.detection_sigma,
            fwhm_samples: model.fwhm_samples(),
            noise_sd_dn: model.noise_sd_dn,
            detector,
            whitener,
        })
    }

    /// By how much the threshold at a place rises for what pulses of a waveform higher than `height_dn` leave there; all
    /// pulses, where that is infinite.
    pub(super) fn raise(&self, scene: &Scene, position: f32, height_dn: f32) -> f64 {
        let others = scene.pulses().iter().map(|p| (f64::from(p.position()), f64::from(p.values[0])));
        self.allowance.raise(f64::from(position), f64::from(height_dn), f64::from(self.per_dn), others)
    }

    /// The score from which a widened pulse of this height is tried as two: 5 % of single pulses reach it, 10 % of weak ones.
    pub(super) fn score_gate(&self, height_dn: f32) -> f64 {
        if f64::from(height_dn) < WEAK_SNR * self.noise_sd_dn { SCORE_GATES[0] } else { SCORE_GATES[1] }
    }

    /// Whether a fitted pulse reaches the threshold, taken with the energy it has and the calibrated width.
    pub(super) fn is_significant(&mut self, scene: &Scene, pulse: &Pulse, samples: usize) -> bool {
        let position = f64::from(pulse.position());
        let [before, behind] = WHOLE_WIDTHS.map(|widths| widths * self.fwhm_samples);
        let is_whole = position >= before && position <= samples as f64 - 1.0 - behind;
        let per_dn = if is_whole { f64::from(self.per_dn) } else { self.at_edge(position, samples) };
        let energy = f64::from(pulse.values[0] * pulse.width_ratio());
        let raise = self.raise(scene, pulse.position(), pulse.values[0]);
        per_dn * energy >= self.detection_sigma * raise
    }

    fn at_edge(&mut self, position: f64, samples: usize) -> f64 {
        if self.whitener.used().len() != samples {
            self.whitener.set_used(&vec![true; samples]);
            self.detector.prepare(&self.whitener);
            self.detector.filter(&self.whitener, &vec![0.0; samples]);
        }
        self.detector.significance_per_dn(&self.whitener, position)
    }
}
