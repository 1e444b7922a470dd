//! Position of the outgoing pulse in its block: the zero of every time of flight.
//!
//! Uses the estimator for echoes on the main lobe alone, so that an after-pulse, a slow tail or a
//! coincident echo does not bias it.

mod batch;
mod fitted_pulse;
mod mixture;
mod usual;

use std::ops::Range;

use crate::decompose::{DecomposeSettings, Decomposer, Return};
use crate::flags;
use crate::sensor_model::{ChannelModel, ModelError};

pub use batch::OutgoingBatch;
pub use fitted_pulse::Outgoing;
pub use usual::{ReferenceBlock, Usual};

/// Half width of the fitted window, in pulse widths.
const HALF_WINDOW_WIDTHS: f64 = 1.5;
/// Deviation ratio above which a second pulse is tried in the window.
const SUSPICIOUS: f64 = 3.0;

/// Fits outgoing pulses of one channel; reuses its buffers.
#[derive(Debug, Clone)]
pub struct OutgoingFitter {
    /// Detects the pulse in the whole block.
    finder: Decomposer,
    /// Fits the pulse in its window.
    fitter: Decomposer,
    /// Fitted samples of the last block.
    window: Range<usize>,
    /// Tries two pulses in the window. Only with a calibrated response, because the residual of a
    /// Gaussian resembles a second pulse.
    two: Option<Decomposer>,
}

impl OutgoingFitter {
    /// Creates a fitter for a reference channel.
    ///
    /// Blocks longer than `max_samples` allocate.
    pub fn new(model: &ChannelModel, max_samples: usize) -> Result<OutgoingFitter, ModelError> {
        let finder = Decomposer::new(model, &one_pulse(), max_samples)?;
        let settings = DecomposeSettings {
            max_returns: 2,
            max_added: 1,
            explains_all: false,
            ..DecomposeSettings::default()
        };
        let two =
            model.response.as_ref().map(|_| Decomposer::new(model, &settings, max_samples)).transpose()?;
        Ok(OutgoingFitter { fitter: finder.clone(), finder, window: 0..0, two })
    }

    /// Fits the strongest pulse of a block.
    ///
    /// `None` if no pulse exceeds the noise or none can be fitted. Sets
    /// [`flags::ECHO_ON_OUTGOING`] if the window contains a second pulse.
    pub fn fit(&mut self, samples: &[u16]) -> Option<Return> {
        let model = self.finder.model();
        let (fwhm, shifts) = (model.fwhm_samples(), model.digitiser.odd_sample_shift != 0.0);
        let position = self.finder.decompose(samples).returns.first()?.position_samples;
        let mut window = window(position, fwhm, samples.len());
        if shifts {
            // Parity of samples must be preserved in the window.
            window.start -= window.start % 2;
        }
        let fitted = samples.get(window.clone())?;
        let pulse = *self.fitter.decompose_window(fitted, window.start).returns.first()?;
        let pulse = self.finished(pulse, window.start, fitted);
        self.window = window;
        Some(pulse)
    }

    /// Converts a pulse to block coordinates; flags a second pulse.
    fn finished(&mut self, mut pulse: Return, first: usize, window: &[u16]) -> Return {
        if pulse.deviation_ratio > SUSPICIOUS
            && let Some(two) = &mut self.two
            && two.decompose_window(window, first).returns.len() > 1
        {
            pulse.flags |= flags::ECHO_ON_OUTGOING;
        }
        pulse.position_samples += first as f64;
        pulse
    }
}

/// Settings for a single pulse.
fn one_pulse() -> DecomposeSettings {
    DecomposeSettings {
        max_returns: 1,
        max_added: 0,
        split_evidence: None,
        explains_all: false,
        ..DecomposeSettings::default()
    }
}

/// Samples around a pulse to which it is fitted.
fn window(position: f64, fwhm_samples: f64, samples: usize) -> Range<usize> {
    let half = HALF_WINDOW_WIDTHS * fwhm_samples;
    let first = (position - half).ceil().max(0.0) as usize;
    let end = ((position + half).floor().max(0.0) as usize).saturating_add(1).min(samples);
    first..end
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flags;
    use crate::noise::ArNoise;
    use crate::simulated::{Random, analogue, channel, digitised, moments, pulse};

    const FWHM: f64 = 4.5;

    /// Blocks of 24 samples, the pulse near the middle, followed by a disturbance outside its
    /// window.
    #[test]
    fn position_and_its_standard_deviation_are_true() {
        let process = ArNoise::new(&[0.6], 0.8).unwrap();
        let model = channel(&process, FWHM, 2.0);
        let mut fitter = OutgoingFitter::new(&model, 24).unwrap();
        let mut random = Random::new(21);
        let (mut errors, mut scores) = (vec![], vec![]);
        for i in 0..3000 {
            let truth = pulse(180.0, 10.0 + random.uniform(), 1.0);
            let mut values = analogue(&mut random, &process, 24, 2.0, FWHM, &[truth]);
            if i % 2 == 0 {
                values[20..].iter_mut().for_each(|v| *v += 30.0);
            }
            let found = fitter.fit(&digitised(&values, 255)).unwrap();
            errors.push(found.position_samples - truth.position_samples);
            scores.push(errors[errors.len() - 1] / found.position_sd_samples);
            assert_eq!(found.flags & flags::SATURATED, 0);
        }
        let ((bias, sd), (_, z)) = (moments(&errors), moments(&scores));
        println!("outgoing: bias {bias:.5} sd {sd:.5} samples, z {z:.3}");
        assert!(bias.abs() < 4.0 * sd / 3000f64.sqrt(), "{bias} {sd}");
        assert!((0.95..1.05).contains(&z), "{z}");
    }

    #[test]
    fn a_block_without_a_pulse_has_none() {
        let model = channel(&ArNoise::new(&[], 0.8).unwrap(), FWHM, 2.0);
        let mut fitter = OutgoingFitter::new(&model, 24).unwrap();
        assert_eq!(fitter.fit(&[2; 24]), None);
        assert_eq!(fitter.fit(&[]), None);
        assert_eq!(fitter.fit(&[255; 24]), None);
    }
}
