//! Behaviour of a receiver near full scale: from which height it is overdriven, and how fast it
//! recovers from clipping.

use wavex_simd::statistics::median;

use super::response::{strongest, strongest_without};
use super::{CalibrationError, CalibrationSettings, WeakPulses, decompose_each, evenly};
use crate::decompose::{DecomposeSettings, Decomposition, OVERDRIVEN_PART, Waveform};
use crate::flags;
use crate::sensor_model::{ChannelModel, ReceiverLimits};
use crate::shape::{Pulse, Shape};

/// Heights of pulses that are certainly not overdriven, relative to full scale.
const NORMAL_PARTS: std::ops::Range<f64> = 0.4..OVERDRIVEN_PART;
/// Fewest of them, and most blocks decomposed for them.
const MIN_NORMAL: usize = 50;
const MAX_NORMAL: usize = 500;
/// Highest sample of blocks that may hold a higher pulse, relative to full scale, and most of them.
const NEAR_FULL: f64 = 0.75;
const MAX_HIGH: usize = 2_000;
/// Number of higher pulses in each step of the search; at least two steps are needed.
const STEP: usize = 20;
/// Chi-square over its expectation, relative to that of normal pulses, of overdriven pulses.
const OVERDRIVEN_RATIO: f64 = 2.0;
/// The same up to which a receiver is linear. Overdriven pulses of an LMS-Q680i, whose times are 0.1 ns
/// early, have 1.3. With 50 degrees of freedom the median of 20 pulses of a linear receiver has an SD of 0.056.
const LINEAR_RATIO: f64 = 1.15;
/// Number of groups of heights in which each must agree.
const LINEAR_STEPS: usize = 5;
/// Height up to which the highest pulses represent full scale, relative to it.
const NEARLY_FULL: f64 = 0.9;
/// Fewest clipped pulses for an estimate of the recovery.
const MIN_CLIPPED: usize = 20;
/// Largest residual just after a clipped sample, relative to those further away.
const RECOVERED_RATIO: f64 = 2.0;
/// Flags of clipped echoes whose flanks show nothing.
const BAD_FLANKS: u16 = flags::EXTREMELY_SATURATED | flags::TRUNCATED | flags::DIVERGED | flags::OVERLAP;

/// Estimates the limits of a receiver from its echoes and its calibrated response.
///
/// Limits without enough strong pulses are absent.
pub fn receiver_limits<'a>(
    blocks: impl Iterator<Item = Waveform<'a>>,
    model: &ChannelModel,
    settings: &CalibrationSettings,
) -> Result<ReceiverLimits, CalibrationError> {
    // Saturation, and heights up to full scale, as if nothing overdrove the receiver.
    let limits = ReceiverLimits { overdriven_dn: Some(f64::INFINITY), ..model.limits };
    let model = ChannelModel { limits, ..model.clone() };
    let strong_dn = NORMAL_PARTS.start * model.full_scale_dn;
    let highest = |block: &Waveform| f64::from(block.samples.iter().copied().max().unwrap_or(0));
    let (near_full, strong): (Vec<_>, Vec<_>) = blocks
        .filter(|block| highest(block) >= strong_dn)
        .partition(|block| highest(block) >= NEAR_FULL * model.full_scale_dn);
    let strong = evenly(&strong, MAX_NORMAL).chain(evenly(&near_full, MAX_HIGH));
    let shape = Shape::of(&model)?;
    let (mut normal, mut high, mut clipped) = (Vec::new(), Vec::new(), Clipped::default());
    let mut flanks = Vec::new();
    let decompose = DecomposeSettings { split_evidence: None, ..settings.decompose.clone() };
    decompose_each(strong, &model, &decompose, settings, WeakPulses::FitAgain, |block, outcome| {
        if outcome.saturated {
            clipped.add(&model, &shape, block, outcome);
            if let Some(single) = strongest_without(BAD_FLANKS, outcome, 0.1, model.fwhm_samples())
                && single.flags & flags::SATURATED != 0
                && outcome.degrees_of_freedom() > 0
            {
                flanks.push((single.amplitude_dn, outcome.chi_square / outcome.expected_chi_square()));
            }
        } else if let Some(single) = strongest(outcome, 0.1, model.fwhm_samples())
            && outcome.degrees_of_freedom() > 0
        {
            let ratio = outcome.chi_square / outcome.expected_chi_square();
            let part = single.amplitude_dn / model.full_scale_dn;
            if NORMAL_PARTS.contains(&part) {
                normal.push(ratio);
            } else if part >= OVERDRIVEN_PART {
                high.push((single.amplitude_dn, ratio));
            }
        }
    })?;
    high.sort_by(|a, b| a.0.total_cmp(&b.0));
    flanks.sort_by(|a, b| a.0.total_cmp(&b.0));
    let full_scale_dn = model.full_scale_dn;
    Ok(ReceiverLimits {
        is_linear: is_linear(&normal, &high, &flanks, full_scale_dn),
        overdriven_dn: overdriven_dn(normal, &high, full_scale_dn),
        recovery_samples: clipped.recovers_at_once(model.noise_sd_dn).then_some(0),
        ..model.limits
    })
}

/// Height from which chi-square exceeds that of normal pulses, DN; `None` with too few or too low pulses.
///
/// `high` has heights, ascending, and ratios of chi-square to its expectation.
fn overdriven_dn(normal: Vec<f64>, high: &[(f64, f64)], full_scale_dn: f64) -> Option<f64> {
    if normal.len() < MIN_NORMAL || high.len() < 2 * STEP {
        return None;
    }
    let limit = OVERDRIVEN_RATIO * median(normal).unwrap_or(0.0).max(1.0);
    let highest_dn = high.last()?.0;
    match steps(high, STEP).find(|step| median_ratio(step) > limit) {
        Some(step) => step.first().map(|(height_dn, _)| *height_dn),
        // No pulse is overdriven. This is proven up to the highest pulse only, which must be near full scale.
        None => (highest_dn > NEARLY_FULL * full_scale_dn).then_some(full_scale_dn),
    }
}

/// Whether pulses up to full scale, or the flanks of clipped ones, fit like normal pulses.
///
/// `high` and `flanks` are as in [`overdriven_dn`]. None of them made the response. A contradiction by
/// either is decisive.
fn is_linear(normal: &[f64], high: &[(f64, f64)], flanks: &[(f64, f64)], full_scale_dn: f64) -> bool {
    let usual = median(normal.iter().copied()).unwrap_or(0.0);
    if normal.len() < MIN_NORMAL || usual > LINEAR_RATIO {
        return false;
    }
    // A few large steps: of many small ones, some exceed the limit by chance.
    let agrees = |of: &[(f64, f64)]| {
        steps(of, STEP.max(of.len() / LINEAR_STEPS)).all(|step| median_ratio(step) <= LINEAR_RATIO * usual)
    };
    let is_proof = |of: &[(f64, f64)]| of.len() >= 2 * STEP;
    let reaches_full_scale = high.last().is_some_and(|(dn, _)| *dn > NEARLY_FULL * full_scale_dn);
    agrees(high) && agrees(flanks) && (is_proof(flanks) || is_proof(high) && reaches_full_scale)
}

/// Groups of pulses of similar height; a small rest is left out.
fn steps(pulses: &[(f64, f64)], size: usize) -> impl Iterator<Item = &[(f64, f64)]> {
    pulses.chunks(size).filter(move |step| 2 * step.len() > size)
}

fn median_ratio(step: &[(f64, f64)]) -> f64 {
    median(step.iter().map(|(_, ratio)| *ratio)).unwrap_or(0.0)
}

/// Residuals after clipped samples.
#[derive(Default)]
struct Clipped {
    /// Magnitudes at the first unclipped sample, DN.
    first_dn: Vec<f64>,
    /// Magnitudes at the second and third, DN.
    next_dn: Vec<f64>,
}

impl Clipped {
    /// Adds a block with one clipped pulse.
    fn add(&mut self, model: &ChannelModel, shape: &Shape, block: Waveform<'_>, outcome: &Decomposition<'_>) {
        let is_clipped =
            |k: usize| block.samples.get(k).is_some_and(|&s| f64::from(s) >= model.full_scale_dn);
        let bad = flags::EXTREMELY_SATURATED | flags::TRUNCATED | flags::DIVERGED | flags::OVERLAP;
        if outcome.returns.iter().any(|r| r.flags & flags::SATURATED != 0 && r.flags & bad != 0) {
            return;
        }
        let mut residual_dn = Vec::with_capacity(block.samples.len());
        model.signal_into(block.samples, &mut residual_dn);
        for found in outcome.returns {
            let pulse = Pulse {
                height_dn: found.amplitude_dn,
                position_samples: found.position_samples,
                ln_width_ratio: found.width_ratio.ln(),
                ln_width_precision: 0.0,
            };
            shape.add(&pulse, -1.0, &mut residual_dn);
        }
        let at = |k: usize| (residual_dn[k] - outcome.background_offset_dn).abs();
        let ends = (1..block.samples.len().saturating_sub(2)).filter(|&k| is_clipped(k - 1));
        for k in ends.filter(|&k| (k..k + 3).all(|k| !is_clipped(k))) {
            self.first_dn.push(at(k));
            self.next_dn.extend([at(k + 1), at(k + 2)]);
        }
    }

    /// Whether the first sample after clipping is as good as the following.
    fn recovers_at_once(self, noise_sd_dn: f64) -> bool {
        self.first_dn.len() >= MIN_CLIPPED
            && median(self.first_dn).unwrap_or(0.0)
                <= RECOVERED_RATIO * median(self.next_dn).unwrap_or(0.0).max(noise_sd_dn)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::calibrate;
    use crate::calibrate::response::calibrate_response;
    use crate::noise::ArNoise;
    use crate::simulated::{Random, digitised, noise};
    use wavex_simulation::pulse::PulseShape as Truth;

    /// Limits of a receiver that flattens heights above `linear_dn`, clips at 255, and loses
    /// `dip_dn` after clipping.
    fn limits(linear_dn: f64, dip_dn: f64) -> ReceiverLimits {
        let (truth, process) = (Truth::riegl(), ArNoise::new(&[], 0.7).unwrap());
        let mut random = Random::new(91);
        let blocks: Vec<Vec<u16>> = (0..1500)
            .map(|_| {
                let (height, place) = (40.0 + 280.0 * random.uniform(), 14.0 + 8.0 * random.uniform());
                let mut values = noise(&mut random, &process, 60);
                for (k, value) in values.iter_mut().enumerate() {
                    let signal = height * truth.at(k as f64 - place, 0.0);
                    *value += 5.0 + signal.min(linear_dn + 0.5 * (signal - linear_dn).max(0.0));
                }
                let clipped = |k: usize| values[k] > 255.0;
                let ends = (1..60).filter(|&k| clipped(k - 1) && !clipped(k)).collect::<Vec<_>>();
                ends.into_iter().for_each(|k| values[k] -= dip_dn);
                digitised(&values, 255)
            })
            .collect();
        let views = || blocks.iter().map(|samples| Waveform { samples });
        let settings = CalibrationSettings::echoes(1.0, 255.0);
        let gaussian = calibrate(views(), &settings).unwrap();
        let model = calibrate_response(views(), &gaussian, &settings).unwrap().model;
        assert!(model.response.is_some());
        receiver_limits(views(), &model, &settings).unwrap()
    }

    #[test]
    fn a_linear_receiver_is_not_overdriven_and_recovers_at_once() {
        let limits = limits(1000.0, 0.0);
        println!("{limits:?}");
        assert_eq!((limits.overdriven_dn, limits.recovery_samples), (Some(255.0), Some(0)));
        assert!(limits.is_linear);
    }

    #[test]
    fn a_receiver_that_flattens_and_dips_has_its_limits() {
        let limits = limits(225.0, 20.0);
        println!("{limits:?}");
        assert!((215.0..245.0).contains(&limits.overdriven_dn.unwrap()), "{limits:?}");
        assert_eq!(limits.recovery_samples, None);
        assert!(!limits.is_linear);
    }

    #[test]
    fn linearity_needs_proof_by_high_pulses_or_by_flanks() {
        let is_linear = |normal: usize, high: &[(f64, f64)], flanks: &[(f64, f64)]| {
            is_linear(&vec![1.0; normal], high, flanks, 255.0)
        };
        let (fits, misfits) = ([(240.0, 1.02); 40], [(240.0, 1.3); 40]);
        assert!(is_linear(50, &[], &fits), "flanks alone");
        assert!(is_linear(50, &fits, &[]), "high pulses alone");
        for (normal, high, flanks) in [
            (49, &fits[..], &fits[..]),
            (50, &[], &[]),
            (50, &[], &fits[..39]),
            (50, &[(220.0, 1.0); 40], &[]),
            (50, &misfits, &fits),
            (50, &fits, &misfits),
            (50, &misfits[..11], &fits),
        ] {
            assert!(!is_linear(normal, high, flanks), "{normal} {high:?} {flanks:?}");
        }
        assert!(!super::is_linear(&[1.3; 50], &fits, &fits, 255.0), "normal pulses do not fit");
        // Only the highest are distorted.
        let mut upper = fits.to_vec();
        upper.extend([(400.0, 1.4); 20]);
        assert!(!is_linear(50, &[], &upper));
    }

    #[test]
    fn few_strong_pulses_give_no_limit() {
        assert_eq!(overdriven_dn(vec![1.0; 49], &[(220.0, 1.0); 100], 255.0), None);
        assert_eq!(overdriven_dn(vec![1.0; 50], &[(220.0, 1.0); 39], 255.0), None);
        assert_eq!(overdriven_dn(vec![1.0; 50], &[(220.0, 1.0); 40], 255.0), None);
        assert_eq!(overdriven_dn(vec![1.0; 50], &[(240.0, 1.0); 40], 255.0), Some(255.0));
        assert_eq!(overdriven_dn(vec![1.0; 50], &[(240.0, 2.1); 40], 255.0), Some(240.0));
    }
}
