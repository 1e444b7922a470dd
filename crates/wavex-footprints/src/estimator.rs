//! Measures waveforms of one receiver.

use wavex_simd::statistics::WithSd;

use super::background::{self, Background, Scratch};
use super::deviation::{Residual, ResidualNoise};
use super::echo::Echo;
use super::ground::{GroundDistribution, Lowest, M_PER_NS};
use super::kernel::Smoother;
use super::measured::{GROUND_FEATURES, GroundCandidate, MOST_SAMPLES, Measured, RecordedNoise};
use super::model::{FREE_WIDTHS, FootprintModel, SD_OF_FWHM};
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
    residual: Residual,
    residual_noise: ResidualNoise,
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
        let fwhm_samples = model.pulse_fwhm_ns / model.sampling_interval_ns;
        FootprintEstimator {
            settings,
            long_run: (1.0 + 2.0 * lags).max(0.1),
            fwhm_samples,
            residual: Residual::new(SD_OF_FWHM * fwhm_samples),
            residual_noise: model.residual_noise,
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
        measured.deviation = self.deviation();
        let m_per_sample = M_PER_NS * self.interval_ns;
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
        if let Some(ground) = measured.modes.last() {
            let behind = profile.energy_behind_dn(ground.position_samples.value);
            let ratio = scaled(behind, 1.0 / (self.echo.behind * energy.value));
            measured.ground_energy_ratio = WithSd { value: ratio.value.min(1.0), ..ratio };
            if !measured.is_cut[1] {
                let lowest = Lowest {
                    values_dn: &narrow.values_dn,
                    modes: &measured.modes,
                    echo: &self.echo,
                    signal: [first, last],
                    least_dn,
                    energy_ratio: measured.ground_energy_ratio.value,
                    m_per_sample,
                    pulse_sd_samples: SD_OF_FWHM * self.fwhm_samples,
                };
                if let Some(features) = lowest.features() {
                    choose_ground(&mut measured, features, m_per_sample);
                }
                let ground = measured.modes.last().map_or(WithSd::UNKNOWN, |mode| mode.position_samples);
                let top = crossing(values, first, front_dn, wide_sd_dn);
                profile.heights(ground, top, &mut measured.heights_samples);
            }
        }
        Some(measured)
    }

    /// Excess of power beyond the frequencies of the response, within the signal.
    fn deviation(&self) -> f64 {
        let per_dn = self.residual_noise.variance_ratio_per_dn;
        let (values, is_free) = (&self.wide.values_dn, self.scratch.is_free());
        let edge = self.edge(self.samples.len());
        let powers = self.residual.power_ratio(values, 0.0, is_free, edge, per_dn);
        powers.map_or(f64::NAN, |powers| powers.deviation(self.residual_noise))
    }

    /// Distance of samples without signal from the signal, and from the ends, which are smoothed with what lies beyond them.
    fn reach(&self) -> usize {
        (FREE_WIDTHS * self.fwhm_samples).ceil() as usize
    }

    fn edge(&self, samples: usize) -> usize {
        self.reach().min(samples / 2)
    }

    /// Subtracts the background and smooths.
    fn remove_background(&mut self, samples: &[f32], recorded: Option<RecordedNoise>) -> Option<Background> {
        self.wide.smooth(samples);
        let reach = self.reach();
        let edge = self.edge(samples.len());
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
        self.residual.filter(&self.samples);
        self.wide.smooth(&self.samples);
        self.narrow.iter_mut().for_each(|narrow| narrow.smooth(&self.samples));
        Some(background)
    }
}

/// Adds SDs and probabilities of the ground.
fn choose_ground(measured: &mut Measured, features: [f64; GROUND_FEATURES], m_per_sample: f64) {
    let Some(ground) = measured.modes.last_mut() else { return };
    let distribution = GroundDistribution::of(&features);
    let position = &mut ground.position_samples;
    position.sd = position.sd.max(distribution.sd_m() / m_per_sample);
    measured.ground_features = features;
    measured.ground_probability = distribution.probability();
    measured.ground_total_sd_samples = position.sd.max(distribution.total_sd_m() / m_per_sample);
    measured.second_ground = distribution.second().map(|(below_m, probability)| {
        let below = scaled(below_m, 1.0 / m_per_sample);
        let position_samples = WithSd { value: position.value + below.value, ..below };
        GroundCandidate { position_samples, probability }
    });
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
