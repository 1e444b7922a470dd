//! One shot after another: its outgoing pulse, its echo blocks, its returns.

use super::Decompose;
use super::crosstalk::Departures;
use super::found::Found;
use crate::batch::{
    Block, Blocks, Channel, Emission, EmissionReference, InputInfo, LineStats, OnlineReturn, ReturnChannel,
    Returns, flags,
};
use crate::kernels::decompose::{Counts, DecomposeSettings, Decomposer, Decomposition, Return as Pulse};
use crate::kernels::outgoing::OutgoingFitter;
use crate::kernels::sensor_model::{ChannelModel, ModelError, SensorModel};
use crate::stage::{Context, Item, Result, StageError};

/// When a shot left, after its clock.
#[derive(Clone, Copy)]
pub(super) struct Departure {
    pub(super) time_ns: f64,
    pub(super) sd_ns: f64,
    /// Bits that all returns of the shot have.
    pub(super) flags: u16,
}

/// The standard deviation of a position that may be anywhere within one sample: uniform.
fn unknown_within_a_sample_ns(interval_ns: f64) -> f64 {
    interval_ns / 12f64.sqrt()
}

/// One shot's part of a line.
pub(crate) struct Shot<'a> {
    /// The emission's index in its line.
    pub(crate) index: u32,
    /// The line's blocks.
    pub(crate) blocks: &'a Blocks,
    /// Those of the shot.
    pub(crate) of_shot: &'a [Block],
    /// What is known of the recording.
    pub(crate) input: &'a InputInfo,
}

/// What became of one block, beside its returns.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlockFit {
    /// The receiver, as its returns name it.
    pub(crate) channel: ReturnChannel,
    /// What became of the candidates.
    pub(crate) counts: Counts,
    /// `χ²` of the fit.
    pub(crate) chi_square: f64,
    /// Samples less parameters.
    pub(crate) degrees_of_freedom: usize,
    /// What the calibrated error of the response is expected to add to `χ²`.
    pub(crate) expected_excess: f64,
    /// `(χ² - ν)/√(2ν)`, with the expected excess in `ν`.
    pub(crate) deviation_ratio: f64,
    /// Fitted offset from the channel's background, DN.
    pub(crate) background_offset_dn: f64,
}

impl BlockFit {
    fn of(channel: ReturnChannel, result: &Decomposition) -> BlockFit {
        BlockFit {
            channel,
            counts: result.counts,
            chi_square: result.chi_square,
            degrees_of_freedom: result.degrees_of_freedom(),
            expected_excess: result.expected_excess,
            deviation_ratio: result.deviation_ratio(),
            background_offset_dn: result.background_offset_dn,
        }
    }

    /// So many of its returns were dropped as cross-talk.
    fn drop(&mut self, dropped: u64) {
        self.counts.np = self.counts.np.saturating_sub(dropped as u32);
        self.counts.np_xtalk_dropped += dropped as u32;
    }
}

/// Looks on while a shot is decomposed; `()` looks away.
pub(crate) trait Watch {
    /// The outgoing pulse was fitted; the pulse's place counts from the block's first sample.
    fn outgoing(&mut self, _block: &Block, _pulse: Pulse, _fitter: &OutgoingFitter) {}

    /// A block of echoes was decomposed; the decomposer still holds it.
    fn echoes(&mut self, _block: &Block, _fit: BlockFit, _decomposer: &Decomposer) {}
}

impl Watch for () {}

impl Shot<'_> {
    fn online(&self) -> &[OnlineReturn] {
        self.blocks.online_of(self.index)
    }

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
        let sd_ns = unknown_within_a_sample_ns(interval_ns);
        let unknown = Departure { time_ns: 0.0, sd_ns, flags: 0 };
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
        for (difference, sd_ns) in self.online().iter().filter_map(|online| nearest(online.time_ns)) {
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
        Departure { time_ns: sum / weights, sd_ns: 0.0, flags: 0 }
    }
}

/// Blocks of up to so many samples take no further memory.
const BLOCK_SAMPLES: usize = 256;

fn unusable(error: ModelError) -> StageError {
    StageError::failed(error.to_string(), "calibrate on a longer part of the recording")
}

/// Decomposes shots: a decomposer for each receiver that was calibrated.
pub(crate) struct ShotDecomposer {
    low: Option<Decomposer>,
    high: Option<Decomposer>,
    reference: Option<OutgoingFitter>,
    timing_error_ns: f64,
    drop_emission_crosstalk: bool,
    found: Vec<Found>,
}

impl ShotDecomposer {
    /// For the sensor of this model.
    pub(crate) fn new(model: &SensorModel, config: &Decompose) -> Result<ShotDecomposer> {
        let settings = DecomposeSettings {
            detection_sigma: config.detection_sigma,
            detection_sigma_last: config.detection_sigma_last.number(),
            width_ratio: config.width_ratio,
            template_error: config.template_error,
            ..DecomposeSettings::default()
        };
        let make = |channel: &Option<ChannelModel>| {
            let decomposer = channel.as_ref().map(|channel| {
                // A receiver's response is no Gaussian: what a Gaussian leaves of a strong single echo looks like two.
                let split_evidence = channel.response.as_ref().and(config.split_evidence.number());
                let settings = DecomposeSettings { split_evidence, ..settings.clone() };
                Decomposer::new(channel, &settings, BLOCK_SAMPLES)
            });
            decomposer.transpose().map_err(unusable)
        };
        let reference = model.reference.as_ref().map(|channel| OutgoingFitter::new(channel, BLOCK_SAMPLES));
        Ok(ShotDecomposer {
            low: make(&model.low_power)?,
            high: make(&model.high_power)?,
            reference: reference.transpose().map_err(unusable)?,
            timing_error_ns: config.timing_error_ns,
            drop_emission_crosstalk: config.drop_emission_crosstalk,
            found: Vec::new(),
        })
    }

    /// Appends a shot's returns in order of time, adds to the line's counters what became of its candidates, and notes in
    /// its emission when it left.
    pub(crate) fn decompose(
        &mut self,
        shot: &Shot,
        emissions: &mut [Emission],
        returns: &mut Returns,
        stats: &mut LineStats,
        cx: &mut Context,
        watch: &mut impl Watch,
    ) -> Result<()> {
        let Some(emission) = emissions.get(shot.index as usize) else {
            cx.reject(Item::Blocks, "its emission is not in the line", shot.of_shot.len() as u64);
            return Ok(());
        };
        let departure = self.departure(shot, cx, watch);
        let others = Departures::of(emissions, shot, departure.map_or(0.0, |departure| departure.time_ns));
        self.found.clear();
        self.find(shot, emission, &others, stats, cx, watch)?;
        let departure = departure.unwrap_or_else(|| shot.anchored_departure(&self.found, cx));
        if let Some(emission) = emissions.get_mut(shot.index as usize) {
            (emission.emission_ns, emission.emission_sd_ns) = (departure.time_ns, departure.sd_ns);
        }
        let first = returns.len();
        self.finish(shot, departure, returns);
        let touched = returns[first..].iter().filter(|found| found.flags & flags::CROSSTALK != 0).count();
        stats.np_xtalk += touched as u64;
        Ok(())
    }

    /// Turns what was found in a shot's blocks into its returns, in order of time.
    fn finish(&mut self, shot: &Shot, departure: Departure, returns: &mut Returns) {
        self.found.sort_by(|a, b| a.time_ns.total_cmp(&b.time_ns));
        let number_of_returns = self.found.len().min(255) as u8;
        for (i, found) in self.found.iter().enumerate() {
            let mut r = found.into_return(departure, self.timing_error_ns, shot.input);
            r.emission = shot.index;
            r.return_number = (i + 1).min(255) as u8;
            r.number_of_returns = number_of_returns;
            returns.push(r);
        }
    }

    /// When the shot left by its outgoing pulse, where it has one.
    fn departure(&mut self, shot: &Shot, cx: &mut Context, watch: &mut impl Watch) -> Option<Departure> {
        let block = shot.of_shot.iter().find(|block| block.channel == Channel::Reference)?;
        if block.is_empty() {
            // A block without samples carries the fitted time itself (RIEGL's files made from RXP).
            return Some(Departure { time_ns: block.start_ns, sd_ns: 0.0, flags: 0 });
        }
        let fitter = self.reference.as_mut()?;
        let pulse = fitter.fit(shot.blocks.samples(block), 0)?;
        let sd_ns = pulse.position_sd_samples * block.interval_ns;
        cx.observe("emission_sd_ns", sd_ns);
        let position = pulse.position_samples;
        let time_ns = match shot.input.emission_reference {
            EmissionReference::OutgoingPulseFraction => (position - position.round()) * block.interval_ns,
            _ => block.time_ns(position),
        };
        watch.outgoing(block, pulse, fitter);
        Some(Departure { time_ns, sd_ns, flags: pulse.flags & flags::ECHO_ON_OUTGOING })
    }

    /// Decomposes the echo blocks of a shot.
    fn find(
        &mut self,
        shot: &Shot,
        emission: &Emission,
        others: &Departures,
        stats: &mut LineStats,
        cx: &mut Context,
        watch: &mut impl Watch,
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
            let (fwhm_ns, background_dn) = (model.pulse_fwhm_ns, mean(&model.background_dn));
            let result = decomposer.decompose(shot.blocks.samples(block), 0);
            waveform.add(&result, stats);
            let mut fit = BlockFit::of(channel, &result);
            let in_block = self.found.len();
            self.found.extend(result.returns.iter().map(|fitted| Found {
                time_ns: block.time_ns(fitted.position_samples),
                time_sd_ns: fitted.position_sd_samples * block.interval_ns,
                channel,
                zone,
                background_dn: background_dn + result.background_offset_dn,
                fitted: *fitted,
                flags: 0,
            }));
            let dropped =
                others.mark(block, fwhm_ns, self.drop_emission_crosstalk, &mut self.found, in_block);
            stats.np_xtalk_dropped += dropped;
            fit.drop(dropped);
            watch.echoes(block, fit, decomposer);
        }
        waveform.count(&self.found, stats, cx);
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

fn mean(levels: &[f64; 4]) -> f64 {
    levels.iter().sum::<f64>() / 4.0
}
