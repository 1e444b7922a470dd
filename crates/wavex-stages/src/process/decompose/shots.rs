//! Converts the results of the receivers to returns, shot by shot.

use wavex_simd::SimdLevel;

use super::Decompose;
use super::crosstalk::Departures;
use super::dual_channel::BothReceivers;
use super::echo::{FoundEcho, UNRELIABLE_RANGE_SD_M};
use super::modes::Modes;
use super::online::unresolved;
use super::profiles::Profiles;
use super::receivers::{BlockRoute, Receivers, SensorTables};
use super::shot::{EmissionTime, ShotBlocks};
use super::unexplained::FitCounts;
use wavex_line::scan_line::{
    Block, Channel, Emission, EmissionReference, Filtered, LineStats, OnlineReturn, ReturnChannel, Returns,
    ShotProfile, flags,
};
use wavex_line::stage::{Context, Reason, Result, StageError};
use wavex_signal::decompose::{Counts, Decomposition, Return as Pulse};
use wavex_signal::fusion::ChannelFusion;
use wavex_signal::outgoing::Outgoing;
use wavex_signal::sensor_model::{ChannelModel, SensorModel};

/// Outgoing pulse of a shot.
///
/// Emission time after the shot's clock, ns; block; fit if the block has samples.
type OutgoingBlock<'a> = (f64, &'a Block, Option<(&'a Outgoing, &'a ChannelModel)>);

/// Largest distance of an emission from an echo of another shot to expect that echo on the outgoing
/// pulse, widths.
const EXPECTED_WIDTHS: f64 = 3.0;
/// Standard deviation of an unknown delay between receivers, pulse widths (LMS-Q680i: 0.52 of 4.24 ns).
const UNKNOWN_DELAY_WIDTHS: f64 = 0.12;

/// Fit statistics of one block.
#[derive(Clone, Copy, Debug)]
pub struct BlockFit {
    /// Receiver, as named in returns.
    pub channel: ReturnChannel,
    /// Counts of candidates; those dropped are in `filtered`, with those dropped after the fit.
    pub counts: Counts,
    /// Dropped candidates, by reason.
    pub filtered: Filtered,
    /// `χ²` of the fit.
    pub chi_square: f64,
    /// Samples minus parameters.
    pub degrees_of_freedom: usize,
    /// Expected contribution of the template error to `χ²`.
    pub expected_excess: f64,
    /// `(χ² - ν)/√(2ν)`, with the expected excess in `ν`.
    pub deviation_ratio: f64,
}

impl BlockFit {
    fn of(channel: ReturnChannel, result: &Decomposition) -> BlockFit {
        let mut filtered = Filtered::default();
        filtered.add_candidates(&result.counts.filtered);
        BlockFit {
            channel,
            counts: result.counts,
            filtered,
            chi_square: result.chi_square,
            degrees_of_freedom: result.degrees_of_freedom(),
            expected_excess: result.expected_excess,
            deviation_ratio: result.deviation_ratio(),
        }
    }

    /// Counts returns dropped because they have no peak of their own.
    fn filter(&mut self, dropped: u64) {
        self.counts.np = self.counts.np.saturating_sub(dropped as u32);
        self.filtered.add(Reason::WithoutMode, dropped);
    }

    /// Counts returns dropped as cross-talk.
    fn drop(&mut self, dropped: u64) {
        self.counts.np = self.counts.np.saturating_sub(dropped as u32);
        self.counts.np_xtalk_dropped += dropped as u32;
    }
}

/// Observes decomposition; `()` is the no-op observer.
pub trait Observer {
    /// Called after the outgoing pulse was fitted.
    fn outgoing(&mut self, _block: &Block, _outgoing: &Outgoing, _model: &ChannelModel) {}

    /// Called after a block of echoes was decomposed.
    ///
    /// `found` still has the returns that are dropped afterwards. `peak_samples` is the final position of
    /// one of them, samples: that of its mode, if it was moved there.
    fn echoes(
        &mut self,
        _block: &Block,
        _fit: BlockFit,
        _found: &Decomposition,
        _peak_samples: impl Fn(&Pulse) -> f64,
        _model: &ChannelModel,
    ) {
    }
}

impl Observer for () {}

impl ShotBlocks<'_> {
    fn online(&self) -> &[OnlineReturn] {
        self.blocks.online_of(self.index)
    }

    /// Whether a low-power block covers the time of this one and is sufficient.
    ///
    /// It must not be saturated, nor overdriven if both receivers can be combined.
    pub(super) fn is_covered(&self, block: &Block, both: Option<&BothReceivers>) -> bool {
        let end_ns = |block: &Block| block.time_ns(block.len() as f64);
        self.of_shot.iter().any(|other| {
            other.channel == Channel::LowPower
                && other.start_ns < end_ns(block)
                && block.start_ns < end_ns(other)
                && match both {
                    Some(both) => !both.is_blinded(self.blocks.samples(other)),
                    None => !self.is_saturated(other),
                }
        })
    }

    fn is_saturated(&self, block: &Block) -> bool {
        let full_scale = self.input.full_scale_dn.unwrap_or(u16::MAX);
        self.blocks.samples(block).iter().any(|&sample| sample >= full_scale)
    }

    /// Emission time of a shot without an outgoing pulse.
    ///
    /// Return locations of the file count from the true emission. Their mean difference from the
    /// echoes is the sub-sample emission offset.
    /// `jitter_ns` is the SD of the clock; by default the one that the reader proved, otherwise that of a
    /// position within one sample.
    fn anchored_departure(
        &self,
        found: &[FoundEcho],
        jitter_ns: Option<f64>,
        cx: &mut Context,
    ) -> EmissionTime {
        let interval_ns = self.input.sampling_interval_ns;
        let clock_sd_ns = self.input.clock_or_sample_sd_ns();
        let unknown = EmissionTime::of_clock(jitter_ns.unwrap_or(clock_sd_ns));
        match self.input.emission_reference {
            EmissionReference::ReturnLocations => {}
            EmissionReference::Clock => {
                if jitter_ns.is_none() && self.input.clock_sd_ns.is_none() {
                    cx.warn("emission times are those of the clock: standard deviations of ranges include a jitter of one sample, because no smooth points prove a smaller one; set `emission_jitter_ns` of `decompose` if the clock is more exact");
                }
                return unknown;
            }
            EmissionReference::OutgoingPulse | EmissionReference::OutgoingPulseFraction => {
                cx.warn("the outgoing pulse of some shots cannot be fitted: their ranges count from the clock, with the standard deviation of the clock");
                return EmissionTime::of_clock(clock_sd_ns);
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
            cx.warn("the return locations of some waveforms match no computed return: their sub-sample emission offset is unknown, and the standard deviations of ranges include it; a few such waveforms are usual; if `range_sd_m` is large for most, the points of the file may belong to other waveforms; or set `emission_jitter_ns` of `decompose` if the clock is more exact");
            return unknown;
        }
        // The offset is computed from the same echoes, so it adds no error.
        EmissionTime { time_ns: sum / weights, sd_ns: 0.0, flags: 0 }
    }
}

/// Whether the mark of a shot is set.
fn is_set(marks: &[bool], index: u32) -> bool {
    marks.get(index as usize).copied().unwrap_or(false)
}

/// Data of a line that decomposition changes.
pub struct DecomposedShots<'a> {
    /// Shots, whose emission times are set.
    pub emissions: &'a mut [Emission],
    /// Returns of all shots so far, by shot and time.
    pub returns: &'a mut Returns,
    /// Profiles of unexplained waveforms of all shots so far.
    pub profiles: &'a mut Vec<ShotProfile>,
    /// Counts of candidates are added.
    pub stats: &'a mut LineStats,
}

/// The current shot.
struct CurrentShot<'a> {
    shot: &'a ShotBlocks<'a>,
    emission: Emission,
    /// Index of its first block among the blocks of all shots.
    first_block: usize,
}

/// Decomposes the shots of a line.
pub struct ShotDecomposer {
    model: SensorModel,
    detection_sigma: f64,
    template_error: f64,
    receivers: Receivers,
    both: Option<BothReceivers>,
    /// Modes of the low-power and of the high-power receiver; `None` if echoes determined the response.
    modes: [Option<Modes>; 2],
    timing_error_ns: f64,
    emission_jitter_ns: Option<f64>,
    drop_emission_crosstalk: bool,
    found: Vec<FoundEcho>,
    profiles: Profiles,
    explained: FitCounts,
    observations: LineObservations,
    /// By shot index: whether an echo was received during the emission.
    expected: Vec<bool>,
}

impl ShotDecomposer {
    /// Creates a decomposer for a sensor with its tables.
    pub fn new(
        model: &SensorModel,
        tables: &SensorTables,
        config: &Decompose,
        path: SimdLevel,
    ) -> Result<ShotDecomposer> {
        let modes = |channel: &Option<ChannelModel>| -> Result<Option<Modes>> {
            let made = channel.as_ref().map(|channel| Modes::of(channel, config.detection_sigma)).transpose();
            made.map(Option::flatten).map_err(|error| StageError::failed(error.to_string(), "recalibrate"))
        };
        Ok(ShotDecomposer {
            model: model.clone(),
            detection_sigma: config.detection_sigma,
            template_error: config.template_error,
            both: None,
            modes: [modes(&model.low_power)?, modes(&model.high_power)?],
            receivers: Receivers::new(model, tables, config, path)?,
            timing_error_ns: config.timing_error_ns,
            emission_jitter_ns: config.emission_jitter_ns,
            drop_emission_crosstalk: config.drop_emission_crosstalk,
            found: Vec::new(),
            profiles: Profiles::new(model, config)?,
            explained: FitCounts::default(),
            observations: LineObservations::default(),
            expected: Vec::new(),
        })
    }

    /// Combines both receivers with the fusion of `fuse_channels`, if any.
    pub fn fusing(mut self, fusion: Option<&ChannelFusion>) -> Result<ShotDecomposer> {
        if let Some(fusion) = fusion {
            self.both = BothReceivers::new(&self.model, fusion, self.detection_sigma, self.template_error)?;
        }
        Ok(self)
    }

    /// Decomposes the shots of a line.
    pub fn decompose(
        &mut self,
        shots: &[ShotBlocks],
        line: &mut DecomposedShots,
        cx: &mut Context,
        watch: &mut impl Observer,
    ) -> Result<()> {
        self.receivers.begin_line();
        self.receivers.decompose(shots, self.both.as_ref())?;
        cx.observe("left_to_plain_kernels", self.receivers.left_to_plain(shots) as f64);
        self.expect_echoes_on_outgoing(shots, line.emissions);
        self.receivers.judge_outgoing(shots, true, |index| is_set(&self.expected, index));
        self.finish_shots(shots, line, cx, watch)?;
        self.explained.report(cx);
        Ok(())
    }

    /// Decomposes one shot of the last line again, with the same result.
    pub fn decompose_again(
        &mut self,
        shot: &ShotBlocks,
        line: &mut DecomposedShots,
        cx: &mut Context,
        watch: &mut impl Observer,
    ) -> Result<()> {
        let shots = std::slice::from_ref(shot);
        self.receivers.decompose(shots, self.both.as_ref())?;
        self.receivers.judge_outgoing(shots, false, |index| is_set(&self.expected, index));
        self.finish_shots(shots, line, cx, watch)?;
        self.explained = FitCounts::default();
        Ok(())
    }

    /// Finds the shots of the line during whose emission echoes were received.
    fn expect_echoes_on_outgoing(&mut self, shots: &[ShotBlocks], emissions: &[Emission]) {
        self.expected.clear();
        self.expected.resize(emissions.len(), false);
        let Some(reference) = &self.model.reference else { return };
        let reach_ns = EXPECTED_WIDTHS * reference.pulse_fwhm_ns;
        let mut first_block = 0;
        for shot in shots {
            let routes = self.receivers.routes(first_block);
            first_block += shot.of_shot.len();
            let delay_ns = self.outgoing(shot, routes).map_or(0.0, |(time_ns, ..)| time_ns);
            let others = Departures::of(emissions, shot, delay_ns);
            for (block, &route) in
                shot.of_shot.iter().zip(routes).filter(|(block, _)| block.channel.is_echo())
            {
                let end_ns = block.time_ns(block.len() as f64);
                if others.others_within(block.start_ns - reach_ns, end_ns + reach_ns).next().is_none() {
                    continue;
                }
                let Some((_, result, _)) = self.receivers.found(route) else { continue };
                for pulse in result.returns {
                    let time_ns = block.time_ns(pulse.position_samples);
                    for (index, _) in others.others_within(time_ns - reach_ns, time_ns + reach_ns) {
                        if let Some(expected) = self.expected.get_mut(index) {
                            *expected = true;
                        }
                    }
                }
            }
        }
    }

    /// Converts the results of the receivers to returns, shot by shot.
    fn finish_shots(
        &mut self,
        shots: &[ShotBlocks],
        line: &mut DecomposedShots,
        cx: &mut Context,
        watch: &mut impl Observer,
    ) -> Result<()> {
        let mut first_block = 0;
        for shot in shots {
            match line.emissions.get(shot.index as usize).copied() {
                Some(emission) => self.shot(&CurrentShot { shot, emission, first_block }, line, cx, watch)?,
                None => cx.reject(Reason::BlockWithoutShot, shot.of_shot.len() as u64),
            }
            first_block += shot.of_shot.len();
        }
        self.observations.report(cx);
        Ok(())
    }

    fn shot(
        &mut self,
        turn: &CurrentShot,
        line: &mut DecomposedShots,
        cx: &mut Context,
        watch: &mut impl Observer,
    ) -> Result<()> {
        let shot = turn.shot;
        let outgoing = self.departure(turn, watch);
        let others =
            Departures::of(line.emissions, shot, outgoing.map_or(0.0, |departure| departure.time_ns));
        self.found.clear();
        self.find(turn, &others, line.stats, cx, watch)?;
        let mut departure =
            outgoing.unwrap_or_else(|| shot.anchored_departure(&self.found, self.emission_jitter_ns, cx));
        departure.sd_ns = departure.sd_ns.hypot(shot.input.emission_choice_sd_ns);
        if outgoing.is_some() && departure.sd_ns > 0.0 {
            self.observations.emission_sds_ns.push(departure.sd_ns);
        }
        if let Some(emission) = line.emissions.get_mut(shot.index as usize) {
            (emission.emission_ns, emission.emission_sd_ns) = (departure.time_ns, departure.sd_ns);
        }
        line.profiles.extend(self.profiles.take(shot.index, departure, shot.input));
        let first = line.returns.len();
        self.finish(shot, departure, line.returns);
        let touched =
            line.returns[first..].iter().filter(|found| found.flags & flags::CROSSTALK != 0).count();
        line.stats.np_xtalk += touched as u64;
        Ok(())
    }

    /// Converts the echoes of a shot to returns, in order of time.
    fn finish(&mut self, shot: &ShotBlocks, departure: EmissionTime, returns: &mut Returns) {
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

    /// Emission time from the outgoing pulse, if the shot has one and it is the reference.
    fn departure(&self, turn: &CurrentShot, watch: &mut impl Observer) -> Option<EmissionTime> {
        let shot = turn.shot;
        let is_reference = shot.input.emission_reference != EmissionReference::Clock;
        let (time_ns, block, outgoing) = self.outgoing(shot, self.receivers.routes(turn.first_block))?;
        let Some((outgoing, model)) = outgoing else {
            if !is_reference {
                return None;
            }
            // A block without samples contains the fitted time (RIEGL files made from RXP).
            return Some(EmissionTime { time_ns, sd_ns: 0.0, flags: 0 });
        };
        watch.outgoing(block, outgoing, model);
        if !is_reference {
            return None;
        }
        let flags = outgoing.pulse.flags & flags::ECHO_ON_OUTGOING;
        let mut sd_ns = outgoing.pulse.position_sd_samples * block.interval_ns;
        if flags != 0 && !outgoing.is_explained {
            // The shift of the pulse by the echo is unknown.
            sd_ns = sd_ns.max(UNRELIABLE_RANGE_SD_M / (shot.input.group_velocity_mps * 0.5e-9));
        }
        Some(EmissionTime { time_ns, sd_ns, flags })
    }

    /// Outgoing pulse of a shot, with its fit if the block has samples.
    ///
    /// Emission time after the clock, ns.
    fn outgoing<'a>(&'a self, shot: &ShotBlocks<'a>, routes: &[BlockRoute]) -> Option<OutgoingBlock<'a>> {
        let mut with_routes = shot.of_shot.iter().zip(routes);
        let (block, &route) = with_routes.find(|(block, _)| block.channel == Channel::Reference)?;
        if block.is_empty() {
            return Some((block.start_ns, block, None));
        }
        let fitted = self.receivers.outgoing(route)?;
        let position = fitted.0.pulse.position_samples;
        let time_ns = match shot.input.emission_reference {
            EmissionReference::OutgoingPulseFraction => (position - position.round()) * block.interval_ns,
            EmissionReference::Clock => 0.0,
            _ => block.time_ns(position),
        };
        Some((time_ns, block, Some(fitted)))
    }

    /// Standard deviation of the delay of a receiver that is not fused with the other one, ns.
    fn delay_sd_ns(&self, channel: ReturnChannel, model: &ChannelModel) -> f64 {
        let has_unknown_delay =
            channel == ReturnChannel::High && self.model.low_power.is_some() && self.both.is_none();
        if has_unknown_delay { UNKNOWN_DELAY_WIDTHS * model.pulse_fwhm_ns } else { 0.0 }
    }

    /// Collects the echoes of a shot's blocks.
    fn find(
        &mut self,
        turn: &CurrentShot,
        others: &Departures,
        stats: &mut LineStats,
        cx: &mut Context,
        watch: &mut impl Observer,
    ) -> Result<()> {
        let CurrentShot { shot, emission, first_block } = turn;
        let mut waveform = WaveformOutcome::default();
        let routes = self.receivers.routes(*first_block);
        let blocks = shot.of_shot.iter().zip(routes).enumerate();
        for (index, (block, &route)) in blocks.filter(|(_, (block, _))| block.channel.is_echo()) {
            waveform.recorded = true;
            match route {
                BlockRoute::Unused(reason) => cx.reject(reason, 1),
                BlockRoute::Covered => cx.reject(Reason::RecordedTwice, 1),
                _ => {}
            }
            let Some((channel, result, model)) = self.receivers.found(route) else { continue };
            let Some(zone) = block.zone.or(emission.mta_zone) else {
                return Err(unresolved(emission.shot));
            };
            waveform.used = true;
            waveform.add(&result, stats);
            if !emission.is_copy() {
                self.explained.add(&result);
            }
            let mut fit = BlockFit::of(channel, &result);
            // A waveform's deviation from the digitiser's background scales with the gain.
            let background_dn = mean(&model.background_dn) + result.background_offset_dn / block.gain;
            let in_block = self.found.len();
            let flags = if block.is_zone_uncertain { flags::ZONE_UNCERTAIN } else { 0 };
            let delay_sd_ns = self.delay_sd_ns(channel, model);
            self.found.extend(result.returns.iter().map(|fitted| {
                let mut found = FoundEcho {
                    time_ns: block.time_ns(fitted.position_samples),
                    time_sd_ns: (fitted.position_sd_samples * block.interval_ns).hypot(delay_sd_ns),
                    channel,
                    block: index,
                    zone,
                    background_dn,
                    gain: block.gain,
                    high_power: None,
                    fitted: *fitted,
                    flags,
                };
                found.add_overdrive_sd(model, self.both.is_some());
                found
            }));
            let modes = if channel == ReturnChannel::High { &mut self.modes[1] } else { &mut self.modes[0] };
            if let Some(modes) = modes.as_mut().filter(|_| block.gain == 1.0) {
                let dropped = modes.keep(shot.blocks.samples(block), block, &mut self.found, in_block);
                stats.filtered.add(Reason::WithoutMode, dropped);
                fit.filter(dropped);
            }
            let (fwhm_ns, drops) = (model.pulse_fwhm_ns, self.drop_emission_crosstalk);
            let dropped = others.mark(block, fwhm_ns, drops, &mut self.found, in_block);
            stats.np_xtalk_dropped += dropped;
            fit.drop(dropped);
            // Fused receivers move the times of the high-power receiver afterwards.
            if self.both.is_none() || channel == ReturnChannel::Low {
                self.profiles.add(shot.blocks, block, channel, &result);
            }
            let kept = &self.found[in_block..];
            let peak_samples = |pulse: &Pulse| {
                let same = kept.iter().find(|kept| kept.fitted.position_samples == pulse.position_samples);
                same.map_or(pulse.position_samples, |kept| {
                    (kept.time_ns - block.start_ns) / block.interval_ns
                })
            };
            watch.echoes(block, fit, &result, peak_samples, model);
        }
        if let Some(both) = &mut self.both {
            self.found.iter_mut().for_each(|found| both.align(found));
            both.fuse(shot, &mut self.found, stats)?;
        }
        waveform.count(&self.found, stats, &mut self.observations);
        Ok(())
    }
}

/// Quantities of the shots of a line, which the report gets at once.
#[derive(Default)]
struct LineObservations {
    emission_sds_ns: Vec<f64>,
    /// Waveforms by their number of returns.
    waveforms_by_returns: Vec<u64>,
}

impl LineObservations {
    fn report(&mut self, cx: &mut Context) {
        cx.observe_all("emission_sd_ns", self.emission_sds_ns.drain(..).map(|sd_ns| (sd_ns, 1)));
        let by_returns = (0..).map(f64::from).zip(self.waveforms_by_returns.drain(..));
        cx.observe_all("returns_per_waveform", by_returns.filter(|(_, waveforms)| *waveforms > 0));
    }
}

/// Outcome of one waveform, over all its blocks.
#[derive(Default)]
struct WaveformOutcome {
    recorded: bool,
    used: bool,
    saturated: bool,
    refined_once: bool,
    refined_twice: bool,
}

impl WaveformOutcome {
    fn add(&mut self, result: &Decomposition, stats: &mut LineStats) {
        stats.n_candidates += u64::from(result.counts.n_candidates);
        stats.n_added += u64::from(result.counts.n_added);
        stats.filtered.add_candidates(&result.counts.filtered);
        stats.np_merged += u64::from(result.counts.np_merged);
        stats.np_xtalk_dropped += u64::from(result.counts.np_xtalk_dropped);
        self.saturated |= result.saturated;
        self.refined_once |= result.refined_once;
        self.refined_twice |= result.refined_twice;
    }

    fn count(&self, found: &[FoundEcho], stats: &mut LineStats, observations: &mut LineObservations) {
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
            let most = found.len() + 1;
            observations.waveforms_by_returns.resize(observations.waveforms_by_returns.len().max(most), 0);
            observations.waveforms_by_returns[found.len()] += 1;
        }
    }
}

fn mean(levels: &[f64; 4]) -> f64 {
    levels.iter().sum::<f64>() / 4.0
}
