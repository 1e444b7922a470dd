//! Measures waveforms of one receiver.

use wavex_simd::statistics::WithSd;

use super::background::{self, Background, Scratch};
use super::echo::Echo;
use super::ground::Evidence;
use super::kernel::Smoother;
use super::measured::{MOST_SAMPLES, Measured, RecordedNoise};
use super::model::{FREE_WIDTHS, FootprintModel};
use super::modes::{ModeRules, SmoothedNoise, modes};
use super::profile::{Profile, SumNoise};
use super::settings::{FootprintSettings, NoiseSource};

/// Measures footprints of one receiver.
pub struct FootprintEstimator {
    settings: FootprintSettings,
    /// For the extent of the signal and its energy.
    wide: Smoother,
    /// For modes, if that is another one.
    narrow: Option<Smoother>,
    /// Variance of the mean of many samples times their number, over the variance of a sample.
    long_run: f64,
    fwhm_samples: f64,
    interval_ns: f64,
    echo: Echo,
    samples: Vec<f32>,
    cumulative_dn: Vec<f64>,
    scratch: Scratch,
}

impl FootprintEstimator {
    /// For the receiver of this model.
    pub fn new(model: &FootprintModel, settings: FootprintSettings) -> FootprintEstimator {
        let autocorrelation = &model.autocorrelation;
        let [wide_ns, narrow_ns] = settings.smoothing_ns(model.pulse_fwhm_ns);
        let smoother = |sd_ns: f64| Smoother::new(sd_ns / model.sampling_interval_ns, autocorrelation);
        let (wide, narrow) = (smoother(wide_ns), (narrow_ns != wide_ns).then(|| smoother(narrow_ns)));
        let lags: f64 = autocorrelation.iter().skip(1).sum();
        FootprintEstimator {
            settings,
            long_run: (1.0 + 2.0 * lags).max(0.1),
            fwhm_samples: model.pulse_fwhm_ns / model.sampling_interval_ns,
            interval_ns: model.sampling_interval_ns,
            echo: Echo::of(model, &narrow.as_ref().unwrap_or(&wide).kernel),
            wide,
            narrow,
            samples: Vec::new(),
            cumulative_dn: Vec::new(),
            scratch: Scratch::default(),
        }
    }

    /// Measures a waveform.
    ///
    /// `None` if it has no background beside its signal and none is recorded, has more than [`MOST_SAMPLES`] samples, or
    /// samples that are not finite.
    pub fn measure(&mut self, samples: &[f32], recorded: Option<RecordedNoise>) -> Option<Measured> {
        if samples.len() > MOST_SAMPLES || samples.iter().any(|dn| !dn.is_finite()) {
            return None;
        }
        let background = self.remove_background(samples, recorded)?;
        let mut measured = Measured::without_signal(background.mean_dn);
        let narrow = self.narrow.as_ref().unwrap_or(&self.wide);
        let [wide_sd_dn, narrow_sd_dn] = [&self.wide, narrow].map(|smoother| background.sd_dn * smoother.sd);
        // What the thresholds count in.
        let [wide_unit_dn, narrow_unit_dn] = match (self.settings.noise, recorded) {
            (NoiseSource::Recorded, Some(recorded)) => [recorded.sd_dn; 2],
            _ => [wide_sd_dn, narrow_sd_dn],
        };
        let front_dn = self.settings.front_sigma * wide_unit_dn;
        let back_dn = self.settings.back_sigma * wide_unit_dn;
        let least_dn = self.settings.back_sigma * narrow_unit_dn;
        let values = &self.wide.values_dn;
        let first = values.iter().position(|dn| f64::from(*dn) > front_dn);
        let last = values.iter().rposition(|dn| f64::from(*dn) > back_dn);
        let Some((first, last)) = first.zip(last).filter(|(first, last)| first < last) else {
            return Some(measured);
        };
        measured.is_cut = [first == 0, last + 1 == samples.len()];
        let rules = ModeRules { least_dn, takes_every_maximum: self.settings.takes_every_maximum };
        let noise =
            SmoothedNoise { height_sd_dn: narrow_sd_dn, slope_sd_dn: background.sd_dn * narrow.slope_sd };
        measured.modes = modes(&narrow.values_dn, first..last + 1, &rules, &noise, &self.echo);
        let noise = SumNoise { variance: self.long_run * background.sd_dn.powi(2), free: background.free };
        let signal = values.get(first..=last).unwrap_or_default();
        let profile = Profile::new(signal, first, self.fwhm_samples, noise, &mut self.cumulative_dn);
        let energy = profile.energy_dn();
        if energy.value <= 0.0 {
            return Some(measured);
        }
        measured.energy_dn = scaled(energy, 1.0 / self.echo.area_samples);
        // A ground echo at the threshold is found in every second waveform; at 1.282 SDs above it in nine of ten.
        let least_energy_dn = (least_dn + 1.282 * narrow_sd_dn) * self.echo.area_samples;
        measured.sensitivity = (1.0 - least_energy_dn / energy.value).clamp(0.0, 1.0);
        let count = measured.modes.len();
        if let Some(ground) = measured.modes.last_mut() {
            let behind = profile.energy_behind_dn(ground.position_samples.value);
            let ratio = scaled(behind, 1.0 / (self.echo.behind * energy.value));
            measured.ground_energy_ratio = WithSd { value: ratio.value.min(1.0), ..ratio };
            if !measured.is_cut[1] {
                let evidence = Evidence::of(ground, measured.ground_energy_ratio.value, count);
                ground.position_samples = evidence.position(ground, self.interval_ns);
                measured.ground_probability = evidence.probability();
                let top = crossing(values, first, front_dn, wide_sd_dn);
                profile.heights(ground.position_samples, top, &mut measured.heights_samples);
            }
        }
        Some(measured)
    }

    /// Subtracts the background and smooths.
    fn remove_background(&mut self, samples: &[f32], recorded: Option<RecordedNoise>) -> Option<Background> {
        self.wide.smooth(samples);
        let reach = (FREE_WIDTHS * self.fwhm_samples).ceil() as usize;
        let edge = reach.min(samples.len() / 2);
        let inner = edge..samples.len() - edge;
        let found = background::estimate(
            samples.get(inner.clone())?,
            self.wide.values_dn.get(inner)?,
            reach,
            &mut self.scratch,
        );
        let own = found.or_else(|| {
            recorded.map(|noise| Background {
                mean_dn: noise.mean_dn,
                sd_dn: noise.sd_dn,
                free: background::LEAST_FREE,
            })
        })?;
        let background = match (self.settings.noise, recorded) {
            (NoiseSource::Recorded, Some(recorded)) => Background { mean_dn: recorded.mean_dn, ..own },
            _ => own,
        };
        let level = background.mean_dn as f32;
        self.samples.clear();
        self.samples.extend(samples.iter().map(|dn| dn - level));
        self.wide.smooth(&self.samples);
        self.narrow.iter_mut().for_each(|narrow| narrow.smooth(&self.samples));
        Some(background)
    }
}

fn scaled(value: WithSd, factor: f64) -> WithSd {
    WithSd { value: factor * value.value, sd: factor * value.sd }
}

/// Position at which values first exceed a threshold, between a sample and the one before it; unknown for the first.
fn crossing(values: &[f32], above: usize, threshold_dn: f64, sd_dn: f64) -> WithSd {
    let at = |k: usize| values.get(k).copied().map_or(0.0, f64::from);
    let Some(before) = above.checked_sub(1) else { return WithSd::UNKNOWN };
    let rise_dn = at(above) - at(before);
    WithSd { value: above as f64 - (at(above) - threshold_dn) / rise_dn, sd: sd_dn / rise_dn }
}
