//! Self-consistency tests of a recording: superposed echoes, halved samples, residuals after
//! echoes.

use std::path::Path;

use wavex_signal::calibrate::response::{EvenOdd, calibrate_response};
use wavex_signal::calibrate::{CalibrationSettings, calibrate};
use wavex_signal::decompose::Waveform;
use wavex_signal::decompose::{DecomposeSettings, Decomposer, Return};
use wavex_signal::detect::Detector;
use wavex_signal::sensor_model::ChannelModel;
use wavex_signal::shape::Pulse;
use wavex_signal::shape::Shape;
use wavex_signal::whitening::Whitener;

use wavex_testkit::recordings::{robust, samples};

/// A recording with a model from some of its blocks; the others are for testing.
pub struct Recording {
    pub model: ChannelModel,
    pub blocks: Vec<Vec<u16>>,
}

/// A block with one return.
#[derive(Clone, Copy)]
pub struct Single<'a> {
    pub samples: &'a [u16],
    pub fitted: Return,
}

impl Recording {
    /// Every `of`-th block is for calibration, the others for testing; with 1, all blocks serve
    /// both.
    pub fn of(path: &Path, of: usize) -> Recording {
        let (calibrated, rest): (Vec<_>, Vec<_>) =
            samples("read_pulsewaves", path).into_iter().enumerate().partition(|(i, _)| i % of == 0);
        let [calibrated, rest] = [calibrated, rest].map(|of| of.into_iter().map(|b| b.1).collect::<Vec<_>>());
        let rest = if of == 1 { calibrated.clone() } else { rest };
        Recording { model: model_of(&calibrated, &CalibrationSettings::echoes(1.0, 255.0)), blocks: rest }
    }

    /// Blocks in which exactly one return is found.
    pub fn singles(&self) -> Vec<Single<'_>> {
        let mut decomposer = Decomposer::new(&self.model, &DecomposeSettings::default(), 80).unwrap();
        let mut found = Vec::new();
        for samples in &self.blocks {
            if let [fitted] = decomposer.decompose(samples).returns {
                found.push(Single { samples, fitted: *fitted });
            }
        }
        found
    }

    fn target_dn(&self, samples: &[u16]) -> Vec<f64> {
        let level = |k: usize| self.model.background_at(k);
        samples.iter().enumerate().map(|(k, &s)| f64::from(s) - level(k)).collect()
    }
}

/// Calibrates a model with system response from blocks.
pub fn model_of(blocks: &[Vec<u16>], settings: &CalibrationSettings) -> ChannelModel {
    let of_blocks = || blocks.iter().map(|samples| Waveform { samples });
    let gaussian = calibrate(of_blocks(), settings).unwrap();
    let model = calibrate_response(of_blocks(), &gaussian, settings).unwrap().model;
    assert!(model.response.is_some());
    model
}

/// A return in the form of the fit.
fn pulse(fitted: &Return) -> Pulse {
    Pulse {
        height_dn: fitted.amplitude_dn,
        position_samples: fitted.position_samples,
        ln_width_ratio: fitted.width_ratio.ln(),
        ln_width_precision: 0.0,
    }
}

/// Result for two recorded echoes in one block.
struct Superposed {
    more: bool,
    /// If both are found: position errors relative to the separate fits, ns, and normalised by
    /// their SD.
    errors: Option<[(f64, f64); 2]>,
}

/// Result for many pairs of one separation.
pub struct VendorReturn {
    /// Fractions of pairs with both found, and with more than two returns.
    pub both: f64,
    pub more: f64,
    /// For the first and the second echoes: median error, ps, and robust SD of the normalised
    /// errors.
    pub bias_ps: [f64; 2],
    pub z: [f64; 2],
}

/// Superposes pairs of recorded echoes.
pub struct Superposition<'a> {
    recording: &'a Recording,
    /// By the shift of the second block modulo 4.
    decomposers: Vec<Decomposer>,
}

impl<'a> Superposition<'a> {
    /// The sum of two blocks has twice the noise variance and the sum of both backgrounds.
    pub fn new(recording: &'a Recording) -> Superposition<'a> {
        let model = &recording.model;
        // No echo overdrove the receiver, whatever the height of the sum.
        let settings = DecomposeSettings { overdriven_part: 1.0, ..DecomposeSettings::default() };
        let of_shift = |shift: usize| {
            let background =
                std::array::from_fn(|k| model.background_at(k) + model.background_at(k + 4 - shift));
            let noisier = ChannelModel {
                full_scale_dn: 2.0 * model.full_scale_dn,
                background_dn: background,
                noise_sd_dn: 2f64.sqrt() * model.noise_sd_dn,
                innovation_sd_dn: 2f64.sqrt() * model.innovation_sd_dn,
                ..model.clone()
            };
            Decomposer::new(&noisier, &settings, 80).unwrap()
        };
        Superposition { recording, decomposers: (0..4).map(of_shift).collect() }
    }

    /// Tests this many pairs with this separation, within a fifth of a sample.
    pub fn reported(
        &mut self,
        first: &[Single<'_>],
        second: &[Single<'_>],
        separation_ns: f64,
        pairs: usize,
    ) -> VendorReturn {
        let mut all = Vec::new();
        for i in 0.. {
            // Strides without a common factor: partners are far apart in the recording.
            let (a, b) = (&first[(7 * i) % first.len()], &second[(13 * i + 101) % second.len()]);
            let off = b.fitted.position_samples - a.fitted.position_samples - separation_ns;
            if (off - off.round()).abs() < 0.2 && !std::ptr::eq(a.samples, b.samples) {
                all.push(self.of(a, b, separation_ns));
            }
            if all.len() == pairs {
                break;
            }
        }
        let part = |test: &dyn Fn(&Superposed) -> bool| {
            all.iter().filter(|pair| test(pair)).count() as f64 / pairs as f64
        };
        let errors = |k: usize| all.iter().filter_map(move |pair| pair.errors.map(|errors| errors[k]));
        VendorReturn {
            both: part(&|pair| pair.errors.is_some()),
            more: part(&|pair| pair.more),
            bias_ps: [0, 1].map(|k| robust(&errors(k).map(|e| 1000.0 * e.0).collect::<Vec<_>>()).0),
            z: [0, 1].map(|k| robust(&errors(k).map(|e| e.1).collect::<Vec<_>>()).1),
        }
    }

    /// Superposes two echoes with the separation rounded to whole samples.
    fn of(&mut self, first: &Single<'_>, second: &Single<'_>, separation_ns: f64) -> Superposed {
        assert_eq!(self.recording.model.sampling_interval_ns, 1.0);
        let [at, behind] = [first, second].map(|single| single.fitted.position_samples);
        let shift = (at + separation_ns - behind).round();
        let places = [at, behind + shift];
        let shift = shift as i64;
        let start = shift.max(0) as usize;
        let end = (second.samples.len() as i64 + shift).clamp(0, first.samples.len() as i64) as usize;
        let sum: Vec<u16> =
            (start..end).map(|k| first.samples[k] + second.samples[(k as i64 - shift) as usize]).collect();
        let decomposer = &mut self.decomposers[shift.rem_euclid(4) as usize];
        let returns = decomposer.decompose_window(&sum, start).returns;
        let separation_ns = places[1] - places[0];
        let nearest = |place: f64| {
            let distance = |r: &Return| (r.position_samples + start as f64 - place).abs();
            (0..returns.len())
                .min_by(|&i, &j| distance(&returns[i]).total_cmp(&distance(&returns[j])))
                .filter(|&i| distance(&returns[i]) < 0.4 * separation_ns)
        };
        let found = (nearest(places[0]), nearest(places[1]));
        let errors = match found {
            (Some(i), Some(j)) if i != j => {
                let error = |k: usize, alone: &Single<'_>, place: f64| {
                    let error = returns[k].position_samples + start as f64 - place;
                    // The separate fit shares half of the noise. As the efficient estimate of the
                    // simpler model, its covariance with the other equals its own variance (Hausman
                    // 1978).
                    let variance =
                        returns[k].position_sd_samples.powi(2) - alone.fitted.position_sd_samples.powi(2);
                    (error, error / variance.sqrt())
                };
                Some([error(i, first, places[0]), error(j, second, places[1])])
            }
            _ => None,
        };
        Superposed { more: returns.len() > 2, errors }
    }
}

/// Scores of the even/odd test.
pub struct EvenOddScores {
    /// Recorded echoes: amplitude and score.
    pub on: Vec<(f64, f64)>,
    /// Computed echoes in recorded noise: amplitude and score.
    pub off: Vec<(f64, f64)>,
}

impl EvenOddScores {
    pub fn of(recording: &Recording, singles: &[Single<'_>]) -> EvenOddScores {
        let model = &recording.model;
        let shape = Shape::of(model).unwrap();
        let mut test = EvenOdd::new(model, 80).unwrap();
        let (mut on, mut off) = (Vec::new(), Vec::new());
        for single in singles {
            let (fitted, target) = (pulse(&single.fitted), recording.target_dn(single.samples));
            on.extend(test.score(&target, fitted).map(|score| (fitted.height_dn, score)));
            // The residual from 30 ns after the echo is noise; a computed echo of the same
            // amplitude is added to it.
            let mut rest = target;
            shape.add(&fitted, -1.0, &mut rest);
            let first = (fitted.position_samples + 30.0).ceil() as usize;
            let Some(noise) = rest.get_mut(first..).filter(|noise| noise.len() >= 24) else { continue };
            let added = Pulse {
                position_samples: 10.0 + fitted.position_samples.fract(),
                ln_width_ratio: 0.0,
                ..fitted
            };
            shape.add(&added, 1.0, noise);
            off.extend(test.score(noise, added).map(|score| (added.height_dn, score)));
        }
        EvenOddScores { on, off }
    }
}

/// Matched-filter statistics of the residuals of single echoes, from `behind_ns` after their peak
/// on.
pub fn tail_statistics(recording: &Recording, singles: &[Single<'_>], behind_ns: f64) -> Vec<f64> {
    let model = &recording.model;
    let shape = Shape::of(model).unwrap();
    let mut whitener = Whitener::new(model.noise().unwrap(), 80);
    whitener.set_used(&[true; 80]);
    let mut detector = Detector::new(shape.clone(), None, &whitener, 80);
    detector.prepare(&whitener);
    let margin = (1.5 * shape.fwhm_samples()).ceil() as usize;
    let mut found = Vec::new();
    for single in singles.iter().filter(|single| single.samples.len() == 80) {
        let mut rest = recording.target_dn(single.samples);
        shape.add(&pulse(&single.fitted), -1.0, &mut rest);
        let first = (single.fitted.position_samples + behind_ns).ceil().max(0.0) as usize;
        let statistic = detector.filter(&whitener, &rest);
        found.extend(statistic.get(first..80 - margin).unwrap_or_default());
    }
    found
}

/// Extrema of the matched filter in decomposition residuals near strong echoes.
///
/// Counts extrema beyond `limit` within `reach_ns` of the peak of an echo of at least 100 DN.
/// Missed echoes cause maxima; noise and response errors cause both.
pub fn left_beside_strong_echoes(
    recording: &Recording,
    settings: &DecomposeSettings,
    limit: f64,
) -> [usize; 2] {
    const REACH_NS: f64 = 12.0;
    let model = &recording.model;
    let shape = Shape::of(model).unwrap();
    let mut decomposer = Decomposer::new(model, settings, 80).unwrap();
    let mut found = [0, 0];
    for samples in &recording.blocks {
        let mut rest = recording.target_dn(samples);
        let mut strong = Vec::new();
        for fitted in decomposer.decompose(samples).returns {
            shape.add(&pulse(fitted), -1.0, &mut rest);
            strong.extend((100.0..200.0).contains(&fitted.amplitude_dn).then_some(fitted.position_samples));
        }
        let mut whitener = Whitener::new(model.noise().unwrap(), 80);
        whitener.set_used(&vec![true; samples.len()]);
        let mut detector = Detector::new(shape.clone(), None, &whitener, 80);
        detector.prepare(&whitener);
        let statistic = detector.filter(&whitener, &rest);
        for (sign, found) in [1.0, -1.0].into_iter().zip(&mut found) {
            let at = |k: usize| sign * statistic[k];
            let near = |k: &usize| strong.iter().any(|place| (*k as f64 - place).abs() < REACH_NS);
            let peak = |k: &usize| at(*k) > limit && at(*k) >= at(*k - 1) && at(*k) > at(*k + 1);
            *found += (1..statistic.len() - 1).filter(near).filter(peak).count();
        }
    }
    found
}
