//! Waveforms to returns.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::batch::{
    AmplitudeTable, Batch, Block, Blocks, Channel, Content, Emission, EmissionReference, InputInfo, Kind,
    LineStats, Return, ReturnChannel, Returns, flags,
};
use crate::kernels::decompose::{DecomposeSettings, Decomposer, Decomposition};
use crate::kernels::outgoing::OutgoingFitter;
use crate::kernels::sensor_model::{ChannelModel, ModelError, SensorModel};
use crate::stage::{Config, Context, InvalidKey, Item, Map, MapConfig, Result, Site, StageError, StageSpec};

/// The stage's place in the registry.
pub const STAGE: StageSpec =
    StageSpec::map::<Decompose>("decompose", &[Kind::Shots], Some(Kind::Returns)).after(&["calibrate"]);

/// Finds the returns of every waveform, each with its standard deviations.
///
/// Peaks above the detection threshold start a joint least-squares fit of pulses in noise that is correlated as
/// `calibrate` found it; what the fit leaves is searched once more. The outgoing pulse of each shot is fitted by the same
/// estimator, and ranges count from it: peak to peak. Times of a file that has no outgoing pulse but its own return
/// locations (LAS) are tied to those, and where it has neither, the unknown part of a sample goes into the standard
/// deviations.
///
/// Of two receivers the sensitive one is used; the other where the sensitive one is saturated or did not record.
///
/// Per return: `time_of_flight_ns` (echo minus outgoing pulse), `range_m` = group velocity / 2 × time of flight,
/// `amplitude_dn` (height of the fitted peak above the background, digitiser steps), `width_ratio` (full width at half
/// maximum over that of the calibrated pulse), `thickness_m` = group velocity / 2 × √(fwhm² − calibrated fwhm²), 0 for
/// pulses that are not widened, `deviation_ratio` = (χ² − ν) / √(2ν) of the waveform's fit, where ν are its degrees of
/// freedom plus what the error of the calibrated response is expected to add, and `intensity`: 7 × 10^(dB/10) by the
/// instrument's amplitude table, else `amplitude_dn`.
///
/// Counts `np np_filtered np_merged nw_empty nw_saturated nw_refined1x nw_refined2x nw_truncated nw_deleted`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Decompose {
    /// Detection threshold, in standard deviations of the noise after the matched filter.
    pub detection_sigma: f64,
    /// Smallest and largest width of a return over that of the calibrated pulse. A return is dropped only where two
    /// standard deviations of its width do not reach into the range.
    pub width_ratio: [f64; 2],
    /// The part of a range's standard deviation that no fit can show: clock and cabling, ns.
    pub timing_error_ns: f64,
    /// How much two returns must lower chi-square against one widened return to stand in its place; `false`: widened returns
    /// are not divided. At 16 fewer than one single return in a thousand is divided; at 11, three in a thousand, and closer
    /// pairs are told apart. Without effect where pulses are taken to be Gaussians.
    pub split_evidence: SplitEvidence,
    /// How well the system response is known at least, as part of a return's amplitude: what an error of this size looks
    /// like is no return. Raise it where strong returns are followed by false ones.
    pub template_error: f64,
}

/// A gain in chi-square, or `false`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum SplitEvidence {
    /// The least gain.
    Gain(f64),
    /// `false`: never.
    Never(bool),
}

impl SplitEvidence {
    fn gain(self) -> Option<f64> {
        match self {
            SplitEvidence::Gain(gain) => Some(gain),
            SplitEvidence::Never(_) => None,
        }
    }
}

impl Default for Decompose {
    fn default() -> Decompose {
        Decompose {
            detection_sigma: 4.5,
            width_ratio: [0.8, 10.0],
            timing_error_ns: 0.004,
            split_evidence: SplitEvidence::Gain(16.0),
            template_error: 0.005,
        }
    }
}

impl Config for Decompose {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        let [low, high] = self.width_ratio;
        InvalidKey::unless(
            (2.0..=100.0).contains(&self.detection_sigma),
            "detection_sigma",
            "it must lie between 2 and 100",
        )?;
        InvalidKey::unless(
            0.0 < low && low < 1.0 && 1.0 < high,
            "width_ratio",
            "it must be a range around 1, as in [0.8, 10.0]",
        )?;
        InvalidKey::unless(
            (0.0..=1.0).contains(&self.timing_error_ns),
            "timing_error_ns",
            "it must lie between 0 and 1",
        )?;
        let split = match self.split_evidence {
            SplitEvidence::Gain(gain) => (4.0..=1e6).contains(&gain),
            SplitEvidence::Never(split) => !split,
        };
        InvalidKey::unless(split, "split_evidence", "it must lie between 4 and 1000000, or be `false`")?;
        InvalidKey::unless(
            (0.0..=1.0).contains(&self.template_error),
            "template_error",
            "it must lie between 0 and 1",
        )
    }
}

impl MapConfig for Decompose {
    fn make(&self, _site: &Site) -> Result<Box<dyn Map>> {
        Ok(Box::new(DecomposeLine { config: self.clone(), kernels: None, found: Vec::new() }))
    }
}

/// One worker: its kernels are made when the first line brings the sensor model.
struct DecomposeLine {
    config: Decompose,
    kernels: Option<(Arc<SensorModel>, Kernels)>,
    found: Vec<Found>,
}

/// A decomposer for each receiver that was calibrated.
struct Kernels {
    low: Option<Decomposer>,
    high: Option<Decomposer>,
    reference: Option<OutgoingFitter>,
}

/// A return before its range is known.
#[derive(Clone, Copy)]
struct Found {
    /// Peak of the echo after the shot's clock.
    time_ns: f64,
    time_sd_ns: f64,
    channel: ReturnChannel,
    zone: i16,
    fwhm_calibrated_ns: f64,
    background_dn: f64,
    fitted: crate::kernels::decompose::Return,
}

/// When a shot left, after its clock.
#[derive(Clone, Copy)]
struct Departure {
    time_ns: f64,
    sd_ns: f64,
}

/// The standard deviation of a position that may be anywhere within one sample: uniform.
fn unknown_within_a_sample_ns(interval_ns: f64) -> f64 {
    interval_ns / 12f64.sqrt()
}

impl Map for DecomposeLine {
    fn map(&mut self, mut batch: Batch, cx: &mut Context) -> Result<Batch> {
        let Some(model) = batch.model.clone() else {
            return Err(StageError::failed(
                "the line comes without a sensor model",
                "put calibrate before decompose",
            ));
        };
        let Content::Shots(blocks) = std::mem::replace(&mut batch.content, Content::Returns(Returns::new()))
        else {
            return Err(StageError::failed(
                "decompose was given no waveforms",
                "put it before the stages that use returns",
            ));
        };
        let mut kernels = match self.kernels.take() {
            Some((of, kernels)) if Arc::ptr_eq(&of, &model) => kernels,
            _ => Kernels::new(&model, &self.config)?,
        };
        let mut returns = Returns::new();
        for (index, of_shot) in blocks.by_emission() {
            let emission = &mut batch.emissions[index as usize];
            let shot =
                Shot { blocks: &blocks, of_shot, online: blocks.online_of(index), input: &batch.input };
            let departure = kernels.departure(&shot, cx);
            self.found.clear();
            kernels.find(&shot, emission, &mut self.found, &mut batch.stats, cx)?;
            let departure = departure.unwrap_or_else(|| shot.anchored_departure(&self.found, cx));
            (emission.emission_ns, emission.emission_sd_ns) = (departure.time_ns, departure.sd_ns);
            self.finish(index, departure, &batch.input, &mut returns);
        }
        batch.stats.np += returns.len() as u64;
        batch.content = Content::Returns(returns);
        self.kernels = Some((model, kernels));
        Ok(batch)
    }
}

impl DecomposeLine {
    /// Turns what was found in a shot's blocks into its returns, in order of time.
    fn finish(&mut self, emission: u32, departure: Departure, input: &InputInfo, returns: &mut Returns) {
        self.found.sort_by(|a, b| a.time_ns.total_cmp(&b.time_ns));
        let number_of_returns = self.found.len().min(255) as u8;
        for (i, found) in self.found.iter().enumerate() {
            let mut r = found.into_return(departure, self.config.timing_error_ns, input);
            r.emission = emission;
            r.return_number = (i + 1).min(255) as u8;
            r.number_of_returns = number_of_returns;
            returns.push(r);
        }
    }
}

/// One shot's part of a line.
struct Shot<'a> {
    blocks: &'a Blocks,
    of_shot: &'a [Block],
    online: &'a [crate::batch::OnlineReturn],
    input: &'a InputInfo,
}

impl Shot<'_> {
    /// Whether a block of the sensitive receiver covers the time of this one without being saturated.
    fn is_covered(&self, block: &Block) -> bool {
        let end_ns = |block: &Block| block.time_ns(block.len() as f64);
        self.of_shot.iter().any(|other| {
            other.channel == Channel::LowPower
                && other.start_ns < end_ns(block)
                && block.start_ns < end_ns(other)
                && !self.is_saturated(other)
        })
    }

    fn is_saturated(&self, block: &Block) -> bool {
        let full_scale = self.input.full_scale_dn.unwrap_or(u16::MAX);
        self.blocks.samples(block).iter().any(|&sample| sample >= full_scale)
    }

    /// The departure of a shot without an outgoing pulse.
    ///
    /// Where the file has return locations, they count from the true departure: their mean difference to the echoes found
    /// is the part of a sample by which the departure misses the clock.
    fn anchored_departure(&self, found: &[Found], cx: &mut Context) -> Departure {
        let interval_ns = self.input.sampling_interval_ns;
        let unknown = Departure { time_ns: 0.0, sd_ns: unknown_within_a_sample_ns(interval_ns) };
        match self.input.emission_reference {
            EmissionReference::ReturnLocations => {}
            EmissionReference::Clock => {
                cx.note("the input has neither outgoing pulses nor return locations: nothing tells which part of a sample the emissions miss their raster by, and the standard deviations of ranges include it");
                return unknown;
            }
            EmissionReference::OutgoingPulse | EmissionReference::OutgoingPulseFraction => {
                cx.note("shots whose outgoing pulse cannot be fitted: their ranges count from the clock, with the standard deviation of a position within one sample");
                return unknown;
            }
        }
        let nearest = |time_ns: f64| {
            let differences = found.iter().map(|found| (found.time_ns - time_ns, found.time_sd_ns));
            differences.min_by(|a, b| a.0.abs().total_cmp(&b.0.abs()))
        };
        let (mut sum, mut weights) = (0.0, 0.0);
        for (difference, sd_ns) in self.online.iter().filter_map(|online| nearest(online.time_ns)) {
            if difference.abs() <= interval_ns {
                sum += difference / (sd_ns * sd_ns);
                weights += 1.0 / (sd_ns * sd_ns);
            }
        }
        if weights == 0.0 {
            cx.note("waveforms whose own return locations match no return found: the part of a sample by which their emission misses the clock is unknown and stands in the standard deviations");
            return unknown;
        }
        // The anchor shares its error with the echoes that it was found from, so it adds none of its own.
        Departure { time_ns: sum / weights, sd_ns: 0.0 }
    }
}

/// Blocks of up to so many samples take no further memory.
const BLOCK_SAMPLES: usize = 256;

fn unusable(error: ModelError) -> StageError {
    StageError::failed(error.to_string(), "calibrate on a longer part of the recording")
}

impl Kernels {
    fn new(model: &SensorModel, config: &Decompose) -> Result<Kernels> {
        let settings = DecomposeSettings {
            detection_sigma: config.detection_sigma,
            width_ratio: config.width_ratio,
            template_error: config.template_error,
            ..DecomposeSettings::default()
        };
        let make = |channel: &Option<ChannelModel>| {
            let decomposer = channel.as_ref().map(|channel| {
                // A receiver's response is no Gaussian: what a Gaussian leaves of a strong single echo looks like two.
                let split_evidence = channel.response.as_ref().and(config.split_evidence.gain());
                let settings = DecomposeSettings { split_evidence, ..settings.clone() };
                Decomposer::new(channel, &settings, BLOCK_SAMPLES)
            });
            decomposer.transpose().map_err(unusable)
        };
        let reference = model.reference.as_ref().map(|channel| OutgoingFitter::new(channel, BLOCK_SAMPLES));
        Ok(Kernels {
            low: make(&model.low_power)?,
            high: make(&model.high_power)?,
            reference: reference.transpose().map_err(unusable)?,
        })
    }

    /// When the shot left by its outgoing pulse, where it has one.
    fn departure(&mut self, shot: &Shot, cx: &mut Context) -> Option<Departure> {
        let block = shot.of_shot.iter().find(|block| block.channel == Channel::Reference)?;
        if block.is_empty() {
            // A block without samples carries the fitted time itself (RIEGL's files made from RXP).
            return Some(Departure { time_ns: block.start_ns, sd_ns: 0.0 });
        }
        let pulse = self.reference.as_mut()?.fit(shot.blocks.samples(block), 0)?;
        let sd_ns = pulse.position_sd_samples * block.interval_ns;
        cx.observe("emission_sd_ns", sd_ns);
        let position = pulse.position_samples;
        let time_ns = match shot.input.emission_reference {
            EmissionReference::OutgoingPulseFraction => (position - position.round()) * block.interval_ns,
            _ => block.time_ns(position),
        };
        Some(Departure { time_ns, sd_ns })
    }

    /// Decomposes the echo blocks of a shot.
    fn find(
        &mut self,
        shot: &Shot,
        emission: &Emission,
        found: &mut Vec<Found>,
        stats: &mut LineStats,
        cx: &mut Context,
    ) -> Result<()> {
        let mut waveform = Waveform::default();
        for block in shot.of_shot.iter().filter(|block| block.channel.is_echo()) {
            waveform.recorded = true;
            let (decomposer, channel) = match block.channel {
                Channel::LowPower => (self.low.as_mut(), ReturnChannel::Low),
                _ if shot.is_covered(block) => {
                    cx.reject(Item::Blocks, "the sensitive receiver recorded it as well", 1);
                    continue;
                }
                _ => (self.high.as_mut(), ReturnChannel::High),
            };
            let Some(decomposer) = decomposer else {
                cx.reject(Item::Blocks, "a receiver that could not be calibrated", 1);
                continue;
            };
            if block.is_empty() {
                cx.reject(Item::Blocks, "a block without samples", 1);
                continue;
            }
            let Some(zone) = block.zone.or(emission.mta_zone) else {
                return Err(StageError::failed(
                    format!("it is not known which pulse caused the echoes of shot {}", emission.shot),
                    "resolve the multiple-time-around zones first: wavex needs them in the input (`mta_zone`)",
                ));
            };
            waveform.used = true;
            let model = decomposer.model();
            let (fwhm_calibrated_ns, background_dn) = (model.pulse_fwhm_ns, mean(&model.background_dn));
            let result = decomposer.decompose(shot.blocks.samples(block), 0);
            waveform.add(&result, stats);
            found.extend(result.returns.iter().map(|fitted| Found {
                time_ns: block.time_ns(fitted.position_samples),
                time_sd_ns: fitted.position_sd_samples * block.interval_ns,
                channel,
                zone,
                fwhm_calibrated_ns,
                background_dn: background_dn + result.background_offset_dn,
                fitted: *fitted,
            }));
        }
        waveform.count(found, stats, cx);
        Ok(())
    }
}

/// What happened to one waveform, over all of its blocks.
#[derive(Default)]
struct Waveform {
    recorded: bool,
    used: bool,
    saturated: bool,
    refined_once: bool,
    refined_twice: bool,
}

impl Waveform {
    fn add(&mut self, result: &Decomposition, stats: &mut LineStats) {
        stats.n_candidates += u64::from(result.counts.n_candidates);
        stats.n_added += u64::from(result.counts.n_added);
        stats.np_filtered += u64::from(result.counts.np_filtered);
        stats.np_merged += u64::from(result.counts.np_merged);
        stats.np_xtalk_dropped += u64::from(result.counts.np_xtalk_dropped);
        self.saturated |= result.saturated;
        self.refined_once |= result.refined_once;
        self.refined_twice |= result.refined_twice;
    }

    fn count(&self, found: &[Found], stats: &mut LineStats, cx: &mut Context) {
        if !self.recorded {
            return;
        }
        let has = |flag: u16| found.iter().any(|found| found.fitted.flags & flag != 0);
        stats.nw_deleted += u64::from(!self.used);
        stats.nw_empty += u64::from(self.used && found.is_empty());
        stats.nw_with_points += u64::from(self.used && !found.is_empty());
        stats.nw_saturated += u64::from(self.saturated);
        stats.nw_refined1x += u64::from(self.refined_once);
        stats.nw_refined2x += u64::from(self.refined_twice);
        stats.nw_truncated += u64::from(has(flags::TRUNCATED));
        if self.used {
            cx.observe("returns_per_waveform", found.len() as f64);
        }
    }
}

impl Found {
    fn into_return(self, departure: Departure, timing_error_ns: f64, input: &InputInfo) -> Return {
        let half_speed_m_per_ns = input.group_velocity_mps * 0.5e-9;
        let fitted = self.fitted;
        let time_of_flight_ns = self.time_ns - departure.time_ns;
        let time_of_flight_sd_ns =
            (self.time_sd_ns.powi(2) + departure.sd_ns.powi(2) + timing_error_ns.powi(2)).sqrt();
        let (thickness_m, thickness_sd_m) = self.thickness(half_speed_m_per_ns);
        let table = match self.channel {
            ReturnChannel::High => &input.amplitude_high,
            _ => &input.amplitude_low,
        };
        let (amplitude_db, intensity, intensity_sd) = self.intensity(table.as_ref());
        Return {
            emission: 0,
            return_number: 0,
            number_of_returns: 0,
            channel: self.channel,
            flags: fitted.flags,
            mta_zone: self.zone,
            time_of_flight_ns,
            time_of_flight_sd_ns,
            range_m: half_speed_m_per_ns * time_of_flight_ns,
            range_sd_m: half_speed_m_per_ns * time_of_flight_sd_ns,
            amplitude_dn: fitted.amplitude_dn,
            amplitude_sd_dn: fitted.amplitude_sd_dn,
            amplitude_db,
            width_ratio: fitted.width_ratio,
            width_ratio_sd: fitted.width_ratio_sd,
            fwhm_ns: fitted.fwhm_ns,
            thickness_m,
            thickness_sd_m,
            deviation_ratio: fitted.deviation_ratio,
            intensity,
            intensity_sd,
            withheld: false,
            class: 0,
        }
    }

    /// Full width at half maximum of the target along the beam, m, and its standard deviation.
    ///
    /// With `d = fwhm² − fwhm0²` and `σ_d` its standard deviation, `T = v/2 √max(d, 0)` and
    /// `σ_T = v/2 σ_d / (2 √max(d, σ_d))`, which stays finite for a flat target (ALGORITHMS S7).
    fn thickness(&self, half_speed_m_per_ns: f64) -> (f64, f64) {
        let calibrated = self.fwhm_calibrated_ns;
        let (ratio, ratio_sd) = (self.fitted.width_ratio, self.fitted.width_ratio_sd);
        let widening = calibrated.powi(2) * (ratio.powi(2) - 1.0);
        let widening_sd = calibrated.powi(2) * 2.0 * ratio * ratio_sd;
        let sd = widening_sd / (2.0 * widening.max(widening_sd).sqrt());
        (half_speed_m_per_ns * widening.max(0.0).sqrt(), half_speed_m_per_ns * sd)
    }

    /// Decibels by the instrument's table (NaN without one), the intensity, and its standard deviation.
    fn intensity(&self, table: Option<&AmplitudeTable>) -> (f64, f64, f64) {
        let (amplitude, sd) = (self.fitted.amplitude_dn, self.fitted.amplitude_sd_dn);
        let Some(table) = table else { return (f64::NAN, amplitude, sd) };
        let linear = |dn: f64| 7.0 * 10f64.powf(table.at(dn) / 10.0);
        let dn = self.background_dn + amplitude;
        // The table's slope around the peak: a central difference over two steps.
        let slope = (linear(dn + 1.0) - linear(dn - 1.0)) / 2.0;
        (table.at(dn), linear(dn), slope.abs() * sd)
    }
}

fn mean(levels: &[f64; 4]) -> f64 {
    levels.iter().sum::<f64>() / 4.0
}
