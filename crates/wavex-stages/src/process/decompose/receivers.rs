//! The receivers of a sensor; each decomposes all its blocks of a line at once.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, Weak};

use wavex_simd::SimdLevel;

use super::at_gains::{AtGains, ByGain};
use super::dual_channel::BothReceivers;
use super::shot::ShotBlocks;
use super::{Decompose, Mode};
use wavex_line::scan_line::{Block, Channel, ReturnChannel};
use wavex_line::stage::{Reason, Result, StageError};
use wavex_line::system::Unpoisoned as _;
use wavex_signal::decompose::{
    self, BatchDecomposer, DecomposeSettings, Decomposition, Decompositions, Tables, Waveform,
};
use wavex_signal::gain::GainLevel;
use wavex_signal::outgoing::{Outgoing, OutgoingBatch, ReferenceBlock, Usual};
use wavex_signal::sensor_model::{ChannelModel, ModelError, Provenance, SensorModel};

/// Maximum number of iterations of one fit in the mode `slow`.
const SLOW_ITERATIONS: usize = 200;

/// Tables of a sensor's channels; empty if only the plain kernels are used.
#[derive(Default)]
pub struct SensorTables {
    low: Option<Arc<Tables>>,
    high: Option<Arc<Tables>>,
    reference: Option<Arc<Tables>>,
    at_gains: TablesAtGains,
}

/// Tables of gains other than 1, shared by the workers that hold them.
#[derive(Clone, Default)]
struct TablesAtGains(Arc<Mutex<ByChannelAndGain>>);

type ByChannelAndGain = BTreeMap<(Channel, GainLevel), Weak<Tables>>;

impl TablesAtGains {
    /// Returns the tables of a channel at a gain; creates them if no worker has them.
    ///
    /// `model` is the channel's model at that gain.
    fn of(&self, channel: Channel, level: GainLevel, model: &ChannelModel) -> Option<Arc<Tables>> {
        let mut made = self.0.lock().unpoisoned();
        if let Some(tables) = made.get(&(channel, level)).and_then(Weak::upgrade) {
            return Some(tables);
        }
        let tables = Arc::new(Tables::new(model)?);
        made.insert((channel, level), Arc::downgrade(&tables));
        Some(tables)
    }
}

impl SensorTables {
    /// Creates the tables of a sensor for a mode.
    pub(crate) fn new(model: &SensorModel, mode: Mode) -> SensorTables {
        if mode == Mode::Slow {
            return SensorTables::default();
        }
        let of = |channel: &Option<ChannelModel>| channel.as_ref().and_then(Tables::new).map(Arc::new);
        SensorTables {
            low: of(&model.low_power),
            high: of(&model.high_power),
            reference: of(&model.reference),
            at_gains: TablesAtGains::default(),
        }
    }
}

/// Tables shared by the workers of a stage.
///
/// The first worker that needs them creates them; the last ones are kept.
#[derive(Clone, Default)]
pub(super) struct SharedTables(Arc<Mutex<CachedTables>>);

/// Number of tables that are kept.
const KEPT_TABLES: usize = 2;

#[derive(Default)]
struct CachedTables {
    /// Tables by model and mode, those used last at the end.
    known: Vec<(Arc<SensorModel>, Mode, Arc<SensorTables>)>,
    /// Data of the model of the first echo receiver.
    provenance: Provenance,
    /// Whether a line had large footprints.
    has_large_footprints: bool,
}

impl SharedTables {
    /// Notes that a line had large footprints.
    pub(super) fn set_large_footprints(&self) {
        self.0.lock().unpoisoned().has_large_footprints = true;
    }

    /// Whether a line had large footprints.
    pub(super) fn have_large_footprints(&self) -> bool {
        self.0.lock().unpoisoned().has_large_footprints
    }

    /// Returns the tables of this model, or of an equal one: each input may load a model of its own.
    pub(super) fn of(&self, model: &Arc<SensorModel>, mode: Mode) -> Arc<SensorTables> {
        let mut shared = self.0.lock().unpoisoned();
        let is_theirs = |known: &&(Arc<SensorModel>, Mode, _)| {
            known.1 == mode && (Arc::ptr_eq(&known.0, model) || known.0 == *model)
        };
        if let Some((_, _, tables)) = shared.known.iter().find(is_theirs) {
            return Arc::clone(tables);
        }
        let tables = Arc::new(SensorTables::new(model, mode));
        if shared.known.len() == KEPT_TABLES {
            shared.known.remove(0);
        }
        shared.known.push((Arc::clone(model), mode, Arc::clone(&tables)));
        shared.provenance = echo_receiver(model).map(|channel| channel.provenance).unwrap_or_default();
        tables
    }

    /// Data of the model last used.
    pub(super) fn provenance(&self) -> Provenance {
        self.0.lock().unpoisoned().provenance
    }
}

impl std::fmt::Debug for SharedTables {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("SharedTables")
    }
}

fn echo_receiver(model: &SensorModel) -> Option<&ChannelModel> {
    model.low_power.as_ref().or(model.high_power.as_ref())
}

/// Routing of a block and the index of its result.
#[derive(Clone, Copy)]
pub(super) enum BlockRoute {
    /// Decomposed by the low-power receiver: gain and index.
    Low(GainLevel, usize),
    /// Decomposed by the high-power receiver: gain and index.
    High(GainLevel, usize),
    /// Outgoing pulse of the shot: gain and index.
    Outgoing(GainLevel, usize),
    /// Not used, with the reason.
    Unused(Reason),
    /// Echoes recorded by the low-power receiver as well.
    Covered,
    /// Neither an echo nor an outgoing pulse.
    Other,
}

/// A receiver at one gain and its results of the line.
struct ReceiverAtGain {
    kernels: BatchDecomposer,
    outcomes: Decompositions,
}

/// The channel of outgoing pulses at one gain.
struct Reference {
    line: OutgoingBatch,
    outgoing: Vec<Option<Outgoing>>,
    /// Common properties of the outgoing pulses of the line.
    usual: Option<Usual>,
}

impl Reference {
    fn new(line: OutgoingBatch) -> Reference {
        Reference { line, outgoing: Vec::new(), usual: None }
    }
}

impl ReceiverAtGain {
    fn new(
        channel: Option<&ChannelModel>,
        tables: Option<&Arc<Tables>>,
        config: &Decompose,
        path: SimdLevel,
    ) -> std::result::Result<Option<ReceiverAtGain>, ModelError> {
        let Some(channel) = channel else { return Ok(None) };
        let kernels = config.kernels(channel, tables.cloned(), path)?;
        Ok(Some(ReceiverAtGain { kernels, outcomes: Decompositions::default() }))
    }
}

impl Decompose {
    /// Kernels of a channel with these keys, without the use of other channels.
    ///
    /// `tables` belong to the model; `None` for the mode `slow`.
    ///
    /// # Errors
    /// If the model is invalid.
    pub fn kernels(
        &self,
        channel: &ChannelModel,
        tables: Option<Arc<Tables>>,
        path: SimdLevel,
    ) -> std::result::Result<BatchDecomposer, ModelError> {
        // Real responses are not Gaussian: the residual of a strong echo would be taken for a
        // second one.
        let split_evidence = channel.response.as_ref().and(self.split_evidence.number());
        let settings = DecomposeSettings { split_evidence, ..settings(self) };
        let mode = match self.mode {
            Mode::Fastest => decompose::Mode::Fastest,
            Mode::FastSeparated => decompose::Mode::FastSeparated,
            Mode::Refined | Mode::Slow => decompose::Mode::Refined,
        };
        let kernels = BatchDecomposer::new(channel, tables, &settings, mode, path)?;
        Ok(kernels.refine_when_needed(self.refine_when_needed))
    }
}

/// Converts the keys of the stage to settings of the kernels.
fn settings(config: &Decompose) -> DecomposeSettings {
    let settings = DecomposeSettings {
        detection_sigma: config.detection_sigma,
        detection_sigma_last: config.detection_sigma_last.number(),
        width_ratio: config.width_ratio,
        template_error: config.template_error,
        ..DecomposeSettings::default()
    };
    match config.mode {
        Mode::Slow => DecomposeSettings { split_score: 0.0, iterations: SLOW_ITERATIONS, ..settings },
        _ => settings,
    }
}

/// Calibrated receivers and their results of the line.
pub(super) struct Receivers {
    low: Option<AtGains<ReceiverAtGain>>,
    high: Option<AtGains<ReceiverAtGain>>,
    reference: Option<AtGains<Reference>>,
    config: Decompose,
    /// Tables of other gains; `None` if only the plain kernels are used.
    tables: Option<TablesAtGains>,
    path: SimdLevel,
    /// Routing of each block of the line's shots, in order.
    routes: Vec<BlockRoute>,
}

impl Receivers {
    pub(super) fn new(
        model: &SensorModel,
        tables: &SensorTables,
        config: &Decompose,
        path: SimdLevel,
    ) -> Result<Receivers> {
        let make = |channel: &Option<ChannelModel>, tables: &Option<Arc<Tables>>| {
            ReceiverAtGain::new(channel.as_ref(), tables.as_ref(), config, path).map_err(unusable)
        };
        let reference = (model.reference.as_ref())
            .map(|channel| OutgoingBatch::new(channel, tables.reference.clone(), path));
        Ok(Receivers {
            low: make(&model.low_power, &tables.low)?.map(AtGains::new),
            high: make(&model.high_power, &tables.high)?.map(AtGains::new),
            reference: reference.transpose().map_err(unusable)?.map(Reference::new).map(AtGains::new),
            config: config.clone(),
            tables: (config.mode != Mode::Slow).then(|| tables.at_gains.clone()),
            path,
            routes: Vec::new(),
        })
    }

    /// Starts a line and drops the least recently used kernels beyond the limit.
    pub(super) fn begin_line(&mut self) {
        [&mut self.low, &mut self.high].into_iter().flatten().for_each(AtGains::begin_line);
        self.reference.iter_mut().for_each(AtGains::begin_line);
    }

    /// Decomposes all blocks of shots, by receiver and gain.
    ///
    /// # Errors
    /// A channel's model is invalid at the gain of a block.
    pub(super) fn decompose(&mut self, shots: &[ShotBlocks], both: Option<&BothReceivers>) -> Result<()> {
        let (mut low, mut high, mut outgoing) = (ByGain::new(), ByGain::new(), ByGain::new());
        self.routes.clear();
        for shot in shots {
            let mut has_left = false;
            for block in shot.of_shot {
                let waveform = Waveform { samples: shot.blocks.samples(block) };
                let level = GainLevel::of(block.gain);
                let route = match block.channel {
                    _ if block.is_too_long() => BlockRoute::Unused(Reason::LongBlock),
                    Channel::Reference if !has_left => {
                        has_left = true;
                        BlockRoute::Outgoing(level, outgoing.push(level, waveform))
                    }
                    Channel::LowPower => {
                        echoes(&self.low, block, || BlockRoute::Low(level, low.push(level, waveform)))
                    }
                    Channel::HighPower if shot.is_covered(block, both) => BlockRoute::Covered,
                    Channel::HighPower => {
                        echoes(&self.high, block, || BlockRoute::High(level, high.push(level, waveform)))
                    }
                    _ => BlockRoute::Other,
                };
                self.routes.push(route);
            }
        }
        self.decompose_channel(Channel::LowPower, &low)?;
        self.decompose_channel(Channel::HighPower, &high)?;
        self.fit_outgoing(&outgoing)
    }

    /// Decomposes the blocks of one receiver.
    fn decompose_channel(&mut self, channel: Channel, queue: &ByGain<Waveform>) -> Result<()> {
        let Receivers { low, high, config, tables, path, .. } = self;
        let receiver = if channel == Channel::LowPower { low } else { high };
        let Some(receiver) = receiver else { return Ok(()) };
        for (level, waveforms) in queue.iter() {
            let ReceiverAtGain { kernels, outcomes } = receiver.need(level, |unit| {
                let model = unit.kernels.model().at_gain(level.gain()).map_err(unusable)?;
                let tables = tables.as_ref().and_then(|tables| tables.of(channel, level, &model));
                let made =
                    ReceiverAtGain::new(Some(&model), tables.as_ref(), config, *path).map_err(unusable)?;
                made.ok_or(StageError::Stopped)
            })?;
            kernels.decompose(waveforms, outcomes);
        }
        Ok(())
    }

    /// Fits the outgoing pulses.
    fn fit_outgoing(&mut self, queue: &ByGain<Waveform>) -> Result<()> {
        let Receivers { reference: Some(reference), tables, path, .. } = self else { return Ok(()) };
        for (_, at_gain) in reference.iter_mut() {
            at_gain.outgoing.clear();
        }
        for (level, waveforms) in queue.iter() {
            let Reference { line, outgoing, .. } = reference.need(level, |unit| {
                let model = unit.line.model().at_gain(level.gain()).map_err(unusable)?;
                let tables = tables.as_ref().and_then(|tables| tables.of(Channel::Reference, level, &model));
                OutgoingBatch::new(&model, tables, *path).map(Reference::new).map_err(unusable)
            })?;
            line.fit(waveforms, outgoing);
        }
        Ok(())
    }

    /// Number of the shots decomposed last with echoes left to the plain kernels.
    pub(super) fn left_to_plain(&self, shots: &[ShotBlocks]) -> usize {
        let is_left =
            |route: &&BlockRoute| self.found(**route).is_some_and(|(_, found, _)| found.left_to_plain);
        let mut routes = self.routes.iter();
        let blocks_left =
            shots.iter().map(|shot| routes.by_ref().take(shot.of_shot.len()).filter(is_left).count());
        blocks_left.filter(|&blocks| blocks > 0).count()
    }

    /// Detects echoes on the outgoing pulses of the shots decomposed last, by gain.
    ///
    /// With `is_line` the shots are a whole line, which gives the reference; otherwise the last line
    /// does. `is_expected`: whether an echo was received during the emission of a shot, by its index.
    pub(super) fn judge_outgoing(
        &mut self,
        shots: &[ShotBlocks],
        is_line: bool,
        is_expected: impl Fn(u32) -> bool,
    ) {
        let Some(reference) = &mut self.reference else { return };
        let all = shots.iter().flat_map(|shot| shot.of_shot.iter().map(move |block| (shot, block)));
        let mut recorded = ByGain::new();
        for ((shot, block), route) in all.zip(&self.routes) {
            let BlockRoute::Outgoing(level, _) = *route else { continue };
            let start_samples = block.start_ns / block.interval_ns;
            let start_samples = if start_samples.is_finite() { start_samples } else { 0.0 };
            recorded.push(
                level,
                (ReferenceBlock { samples: shot.blocks.samples(block), start_samples }, shot.index),
            );
        }
        for (level, Reference { line, outgoing, usual }) in reference.iter_mut() {
            let of_gain = recorded.of(level);
            if is_line {
                let blocks: Vec<ReferenceBlock> = of_gain.iter().map(|(block, _)| *block).collect();
                *usual = line.usual(&blocks, outgoing);
            }
            let Some(usual) = usual else { continue };
            for ((block, index), outgoing) in of_gain.iter().zip(outgoing) {
                if let Some(outgoing) = outgoing {
                    line.judge(block, outgoing, usual, is_expected(*index));
                }
            }
        }
    }

    /// Routing of the blocks from an index on.
    pub(super) fn routes(&self, from: usize) -> &[BlockRoute] {
        self.routes.get(from..).unwrap_or_default()
    }

    /// Result of a block of echoes, with its receiver and the receiver's model.
    pub(super) fn found(
        &self,
        route: BlockRoute,
    ) -> Option<(ReturnChannel, Decomposition<'_>, &ChannelModel)> {
        let (receiver, channel, level, number) = match route {
            BlockRoute::Low(level, number) => (&self.low, ReturnChannel::Low, level, number),
            BlockRoute::High(level, number) => (&self.high, ReturnChannel::High, level, number),
            BlockRoute::Outgoing(..) | BlockRoute::Unused(_) | BlockRoute::Covered | BlockRoute::Other => {
                return None;
            }
        };
        let receiver = receiver.as_ref()?.get(level)?;
        Some((channel, receiver.outcomes.get(number)?, receiver.kernels.model()))
    }

    /// Fitted outgoing pulse of a block, with the model of its channel.
    pub(super) fn outgoing(&self, route: BlockRoute) -> Option<(&Outgoing, &ChannelModel)> {
        let BlockRoute::Outgoing(level, number) = route else { return None };
        let reference = self.reference.as_ref()?.get(level)?;
        Some((reference.outgoing.get(number)?.as_ref()?, reference.line.model()))
    }
}

/// Routes a block of echoes to its receiver, if calibrated.
fn echoes(
    receiver: &Option<AtGains<ReceiverAtGain>>,
    block: &Block,
    route: impl FnOnce() -> BlockRoute,
) -> BlockRoute {
    match receiver {
        None => BlockRoute::Unused(Reason::UnknownReceiver),
        Some(_) if block.is_empty() => BlockRoute::Unused(Reason::EmptyBlock),
        Some(_) => route(),
    }
}

fn unusable(error: ModelError) -> StageError {
    StageError::failed(error.to_string(), "calibrate on a longer part of the recording")
}

#[cfg(test)]
mod tests {
    use wavex_signal::noise::ArNoise;
    use wavex_signal::simulated::channel;

    use super::*;

    #[test]
    fn equal_models_share_their_tables() {
        let shared = SharedTables::default();
        let model = |fwhm_samples: f64| {
            let channel = channel(&ArNoise::new(&[], 0.5).unwrap(), fwhm_samples, 10.0);
            Arc::new(SensorModel { low_power: Some(channel), ..SensorModel::default() })
        };
        let first = shared.of(&model(4.0), Mode::Fastest);
        assert!(Arc::ptr_eq(&first, &shared.of(&model(4.0), Mode::Fastest)));
        assert!(!Arc::ptr_eq(&first, &shared.of(&model(4.0), Mode::Refined)));
        assert!(!Arc::ptr_eq(&first, &shared.of(&model(5.0), Mode::Fastest)));
    }
}
