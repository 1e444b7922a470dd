//! Fits the outgoing pulses of many blocks with the SIMD kernels.

use std::ops::Range;
use std::sync::Arc;

use wavex_simd::SimdLevel;

use super::mixture::Mixture;
use super::usual::{ReferenceBlock, Usual};
use super::{Outgoing, OutgoingFitter, one_pulse, window};
use crate::decompose::Waveform;
use crate::decompose::{BatchDecomposer, Decompositions, FilterPeak, Mode, Tables};
use crate::sensor_model::{ChannelModel, ModelError};

/// Fits outgoing pulses of one channel in batches; reuses its buffers.
///
/// Differs from [`OutgoingFitter`] in two points. The window is placed by the matched filter alone.
/// It starts some samples earlier, at a multiple of four, to include the samples needed for the
/// noise prediction. Blocks unsuitable for the SIMD kernels are left to [`OutgoingFitter`].
pub struct OutgoingBatch {
    plain: OutgoingFitter,
    mixture: Option<Mixture>,
    fast: BatchDecomposer,
    /// Number of initial samples used only for noise prediction.
    order: usize,
    candidates: Vec<(u32, FilterPeak)>,
    strongest: Vec<FilterPeak>,
    /// Length of each window, index of its block, and its samples.
    windows: Vec<(usize, u32, Range<usize>)>,
    outcomes: Decompositions,
}

impl OutgoingBatch {
    /// Creates a batch fitter for the reference channel; `tables` is `None` or from [`Tables::new`]
    /// for the same model.
    pub fn new(
        model: &ChannelModel,
        tables: Option<Arc<Tables>>,
        path: SimdLevel,
    ) -> Result<OutgoingBatch, ModelError> {
        Ok(OutgoingBatch {
            plain: OutgoingFitter::new(model, 0)?,
            mixture: Mixture::new(model)?,
            fast: BatchDecomposer::new(model, tables, &one_pulse(), Mode::Refined, path)?,
            order: model.ar.len(),
            candidates: Vec::new(),
            strongest: Vec::new(),
            windows: Vec::new(),
            outcomes: Decompositions::default(),
        })
    }

    /// The reference channel.
    pub fn model(&self) -> &ChannelModel {
        self.fast.model()
    }

    /// Fits the strongest pulse of each block, in order; see [`OutgoingFitter::fit`]. Clears
    /// `pulses` first.
    pub fn fit(&mut self, blocks: &[Waveform<'_>], pulses: &mut Vec<Option<Outgoing>>) {
        pulses.clear();
        self.choose_windows(blocks);
        let windowed: Vec<Waveform<'_>> = (self.windows.iter())
            .map(|(_, i, window)| Waveform { samples: part(blocks, *i, window) })
            .collect();
        self.fast.decompose(&windowed, &mut self.outcomes);
        pulses.resize(blocks.len(), None);
        for ((outcome, block), (_, i, window)) in self.outcomes.iter().zip(&windowed).zip(&self.windows) {
            let fitted = outcome.returns.first().map(|&pulse| Outgoing {
                pulse: self.plain.finished(pulse, window.start, block.samples),
                window: window.clone(),
                is_explained: false,
            });
            if let Some(place) = pulses.get_mut(*i as usize) {
                *place = fitted;
            }
        }
        for ((block, strongest), pulse) in blocks.iter().zip(&self.strongest).zip(pulses) {
            if strongest.statistic == 0.0 {
                let fitted = self.plain.fit(block.samples);
                *pulse = fitted.map(|pulse| {
                    let window = self.plain.window.clone();
                    Outgoing { pulse, window, is_explained: false }
                });
            }
        }
    }

    /// Typical parameters of the outgoing pulses of a scan line.
    ///
    /// Input of [`OutgoingBatch::judge`]. `None` for fewer than 30 pulses, or without a calibrated
    /// response.
    pub fn usual(&mut self, blocks: &[ReferenceBlock<'_>], pulses: &[Option<Outgoing>]) -> Option<Usual> {
        self.mixture.as_mut()?.usual(blocks, pulses)
    }

    /// Tests for an echo on an outgoing pulse.
    ///
    /// `is_expected`: a recorded echo was received while the pulse left. Sets
    /// [`ECHO_ON_OUTGOING`](crate::flags::ECHO_ON_OUTGOING) if an echo is more probable
    /// than not. Position and standard deviation become those of both hypotheses, weighted by
    /// probability.
    pub fn judge(
        &mut self,
        block: &ReferenceBlock<'_>,
        outgoing: &mut Outgoing,
        usual: &Usual,
        is_expected: bool,
    ) {
        if let Some(mixture) = &mut self.mixture {
            mixture.judge(block, outgoing, usual, is_expected);
        }
    }

    /// Finds the strongest pulse of each block and its window.
    ///
    /// The statistic is 0 for blocks unsuitable for the SIMD kernels. Windows are sorted by length,
    /// because thresholds at the ends of blocks are computed once per length.
    fn choose_windows(&mut self, blocks: &[Waveform<'_>]) {
        let model = self.fast.model();
        let (fwhm, full_scale_dn) = (model.fwhm_samples(), model.full_scale_dn);
        self.fast.detect(blocks, &mut self.candidates);
        self.strongest.clear();
        self.strongest.resize(blocks.len(), FilterPeak::default());
        for (i, candidate) in &self.candidates {
            match self.strongest.get_mut(*i as usize) {
                Some(strongest) if candidate.statistic > strongest.statistic => *strongest = *candidate,
                _ => {}
            }
        }
        self.windows.clear();
        for ((i, block), strongest) in (0..).zip(blocks).zip(&mut self.strongest) {
            let is_saturated = block.samples.iter().any(|&sample| f64::from(sample) >= full_scale_dn);
            if is_saturated {
                *strongest = FilterPeak::default();
            }
            if strongest.statistic > 0.0 {
                let mut window = window(strongest.position_samples.into(), fwhm, block.samples.len());
                // Background phase and sample parity depend on the index in the block.
                window.start = window.start.saturating_sub(self.order) / 4 * 4;
                self.windows.push((window.len(), i, window));
            }
        }
        self.windows.sort_unstable_by_key(|&(length, i, _)| (length, i));
    }
}

/// Samples of a window of a block.
fn part<'a>(blocks: &[Waveform<'a>], index: u32, window: &Range<usize>) -> &'a [u16] {
    blocks.get(index as usize).and_then(|block| block.samples.get(window.clone())).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flags;
    use crate::noise::ArNoise;
    use crate::simulated::{Random, analogue, channel, digitised, moments, pulse};

    const FWHM: f64 = 4.5;

    fn batch(model: &ChannelModel) -> OutgoingBatch {
        let tables = Tables::new(model).map(Arc::new);
        assert!(tables.is_some());
        OutgoingBatch::new(model, tables, SimdLevel::best()).unwrap()
    }

    /// Blocks of 40 samples; every second pulse is followed by a disturbance outside its window.
    #[test]
    fn position_and_its_standard_deviation_are_true_and_those_of_the_plain_form() {
        let process = ArNoise::new(&[0.6, -0.2], 0.8).unwrap();
        let model = channel(&process, FWHM, 2.0);
        let mut random = Random::new(22);
        let one = |i: usize| {
            let truth = pulse(180.0, 14.0 + 8.0 * random.uniform(), 1.0);
            let mut values = analogue(&mut random, &process, 40, 2.0, FWHM, &[truth]);
            if i.is_multiple_of(2) {
                values[32..].iter_mut().for_each(|v| *v += 30.0);
            }
            (truth.position_samples, digitised(&values, 255))
        };
        let shots: Vec<(f64, Vec<u16>)> = (0..3000).map(one).collect();
        let blocks: Vec<Waveform<'_>> = shots.iter().map(|(_, samples)| Waveform { samples }).collect();
        let (mut batch, mut pulses) = (batch(&model), Vec::new());
        batch.fit(&blocks, &mut pulses);
        assert_eq!(pulses.len(), shots.len());
        let mut plain = OutgoingFitter::new(&model, 40).unwrap();
        let (mut errors, mut scores, mut apart) = (vec![], vec![], vec![]);
        for ((truth, samples), found) in shots.iter().zip(&pulses) {
            let Outgoing { pulse, window, .. } = found.as_ref().unwrap();
            assert!(window.start.is_multiple_of(4) && window.end <= 40, "{window:?}");
            errors.push(pulse.position_samples - truth);
            scores.push(errors[errors.len() - 1] / pulse.position_sd_samples);
            let expected = plain.fit(samples).unwrap();
            apart.push((pulse.position_samples - expected.position_samples) / expected.position_sd_samples);
        }
        let ((bias, sd), (_, z), (_, apart)) = (moments(&errors), moments(&scores), moments(&apart));
        println!(
            "outgoing, SIMD: bias {bias:.5} sd {sd:.5} samples, z {z:.3}, difference to scalar {apart:.3}"
        );
        assert!(bias.abs() < 4.0 * sd / 3000f64.sqrt(), "{bias} {sd}");
        assert!((0.95..1.05).contains(&z), "{z}");
        assert!(apart < 0.25, "{apart}");
        assert_eq!(batch.fast.left_to_plain(), 0);
    }

    #[test]
    fn a_pulse_is_the_same_alone_and_among_others() {
        let process = ArNoise::new(&[0.5], 0.8).unwrap();
        let model = channel(&process, FWHM, 2.0);
        let mut random = Random::new(23);
        let one = |i: usize| {
            let truth = pulse(40.0 + 150.0 * random.uniform(), 10.0 + 20.0 * random.uniform(), 1.0);
            digitised(&analogue(&mut random, &process, 30 + i % 20, 2.0, FWHM, &[truth]), 255)
        };
        let shots: Vec<Vec<u16>> = (0..200).map(one).collect();
        let blocks: Vec<Waveform<'_>> = shots.iter().map(|samples| Waveform { samples }).collect();
        let (mut batch, mut all, mut alone) = (batch(&model), Vec::new(), Vec::new());
        batch.fit(&blocks, &mut all);
        assert_eq!(all.len(), 200);
        for (block, expected) in blocks.iter().zip(&all) {
            batch.fit(&[*block], &mut alone);
            assert_eq!(&alone[0], expected);
        }
    }

    /// Saturated pulses and blocks without a pulse give the results of the scalar form.
    #[test]
    fn what_is_not_for_the_fast_kernels_is_left_to_the_plain_ones() {
        let process = ArNoise::new(&[], 0.8).unwrap();
        let model = channel(&process, FWHM, 2.0);
        let mut random = Random::new(24);
        let saturated =
            digitised(&analogue(&mut random, &process, 40, 2.0, FWHM, &[pulse(400.0, 18.3, 1.0)]), 255);
        let cases = [&saturated[..], &[2; 24], &[], &[255; 24]];
        let blocks = cases.map(|samples| Waveform { samples });
        let mut pulses = Vec::new();
        batch(&model).fit(&blocks, &mut pulses);
        let mut plain = OutgoingFitter::new(&model, 40).unwrap();
        for (block, found) in blocks.iter().zip(&pulses) {
            let expected = plain.fit(block.samples);
            assert_eq!(found.as_ref().map(|found| found.pulse), expected);
        }
        let seen: Vec<bool> = pulses.iter().map(Option::is_some).collect();
        assert_eq!(seen, [true, false, false, false]);
        assert!(pulses[0].as_ref().unwrap().pulse.flags & flags::SATURATED != 0);
    }
}
