//! The receivers of a sensor: each decomposes at once what it recorded of a line.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError, Weak};

use super::at_gains::{AtGains, ByGain};
use super::both::BothReceivers;
use super::shots::Shot;
use super::{Decompose, Mode};
use crate::batch::{Block, Channel, ReturnChannel};
use crate::kernels::calibrate::Block as Waveform;
use crate::kernels::decompose::{DecomposeSettings, Decomposition};
use crate::kernels::gain::GainLevel;
use crate::kernels::lockstep::{self, Lockstep, Outcomes, Path, Tables};
use crate::kernels::outgoing::{Outgoing, OutgoingBatch, ReferenceBlock, Usual};
use crate::kernels::sensor_model::{ChannelModel, ModelError, SensorModel};
use crate::stage::{Result, StageError};

/// Iterations of one fit at most where time is of no account.
const SLOW_ITERATIONS: usize = 200;

/// The tables of a sensor's channels; none where the plain kernels do the work.
#[derive(Default)]
pub(crate) struct SensorTables {
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
    /// The tables of a channel at a gain, whose model this is; made where no worker has them.
    fn of(&self, channel: Channel, level: GainLevel, model: &ChannelModel) -> Option<Arc<Tables>> {
        let mut made = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(tables) = made.get(&(channel, level)).and_then(Weak::upgrade) {
            return Some(tables);
        }
        let tables = Arc::new(Tables::new(model)?);
        made.insert((channel, level), Arc::downgrade(&tables));
        Some(tables)
    }
}

impl SensorTables {
    /// The tables of a sensor in this mode.
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

/// Where the workers of a stage find the tables that they have in common: the first one that needs them makes them, and
/// they last as long as a worker holds them.
#[derive(Clone, Default)]
pub(super) struct SharedTables(Arc<Mutex<(Weak<SensorModel>, Weak<SensorTables>)>>);

impl SharedTables {
    /// The tables of this model.
    pub(super) fn of(&self, model: &Arc<SensorModel>, mode: Mode) -> Arc<SensorTables> {
        let mut shared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_theirs = std::ptr::eq(shared.0.as_ptr(), Arc::as_ptr(model));
        if let Some(tables) = shared.1.upgrade().filter(|_| is_theirs) {
            return tables;
        }
        let tables = Arc::new(SensorTables::new(model, mode));
        *shared = (Arc::downgrade(model), Arc::downgrade(&tables));
        tables
    }
}

impl std::fmt::Debug for SharedTables {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("SharedTables")
    }
}

/// What is to become of a block, or has become of it.
#[derive(Clone, Copy)]
pub(super) enum Lot {
    /// Decomposed by the sensitive receiver at a gain, as its block of this number.
    Low(GainLevel, usize),
    /// The same by the coarse one.
    High(GainLevel, usize),
    /// The shot's outgoing pulse, of this number at a gain.
    Outgoing(GainLevel, usize),
    /// Left out, and why.
    Unused(&'static str),
    /// Echoes that the sensitive receiver recorded as well.
    Covered,
    /// Neither an echo nor an outgoing pulse.
    Other,
}

/// A receiver at one gain, and what it found in its blocks of the line.
struct Receiver {
    kernels: Lockstep,
    outcomes: Outcomes,
}

/// The channel of outgoing pulses at one gain.
struct Reference {
    batch: OutgoingBatch,
    outgoing: Vec<Option<Outgoing>>,
    /// What the outgoing pulses of the line have in common.
    usual: Option<Usual>,
}

impl Reference {
    fn new(batch: OutgoingBatch) -> Reference {
        Reference { batch, outgoing: Vec::new(), usual: None }
    }
}

impl Receiver {
    fn new(
        channel: Option<&ChannelModel>,
        tables: Option<&Arc<Tables>>,
        config: &Decompose,
        path: Path,
    ) -> std::result::Result<Option<Receiver>, ModelError> {
        let Some(channel) = channel else { return Ok(None) };
        // A receiver's response is no Gaussian: what a Gaussian leaves of a strong single echo looks like two.
        let split_evidence = channel.response.as_ref().and(config.split_evidence.number());
        let settings = DecomposeSettings { split_evidence, ..settings(config) };
        let mode = match config.mode {
            Mode::Fastest => lockstep::Mode::Fastest,
            Mode::FastSeparated => lockstep::Mode::FastSeparated,
            Mode::Refined | Mode::Slow => lockstep::Mode::Refined,
        };
        let kernels = Lockstep::new(channel, tables.cloned(), &settings, mode, path)?;
        let kernels = kernels.refine_when_needed(config.refine_when_needed);
        Ok(Some(Receiver { kernels, outcomes: Outcomes::default() }))
    }
}

/// What the keys of the stage mean to the kernels.
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

/// The receivers that were calibrated, and what they found in the line.
pub(super) struct Receivers {
    low: Option<AtGains<Receiver>>,
    high: Option<AtGains<Receiver>>,
    reference: Option<AtGains<Reference>>,
    config: Decompose,
    /// Tables of other gains; `None` where the plain kernels do the work.
    tables: Option<TablesAtGains>,
    path: Path,
    left_to_plain: u64,
    /// One for each block of the line's shots, in order.
    lots: Vec<Lot>,
}

impl Receivers {
    pub(super) fn new(
        model: &SensorModel,
        tables: &SensorTables,
        config: &Decompose,
        path: Path,
    ) -> Result<Receivers> {
        let make = |channel: &Option<ChannelModel>, tables: &Option<Arc<Tables>>| {
            Receiver::new(channel.as_ref(), tables.as_ref(), config, path).map_err(unusable)
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
            left_to_plain: 0,
            lots: Vec::new(),
        })
    }

    /// Begins a line: kernels of gains that were needed longest ago are dropped where there are too many.
    pub(super) fn begin_line(&mut self) {
        [&mut self.low, &mut self.high].into_iter().flatten().for_each(AtGains::begin_line);
        self.reference.iter_mut().for_each(AtGains::begin_line);
    }

    /// Decomposes all blocks of shots, receiver by receiver and gain by gain.
    ///
    /// # Errors
    /// Where a channel's model is none at the gain of a block.
    pub(super) fn decompose(&mut self, shots: &[Shot], both: Option<&BothReceivers>) -> Result<()> {
        let (mut low, mut high, mut outgoing) = (ByGain::new(), ByGain::new(), ByGain::new());
        self.lots.clear();
        for shot in shots {
            let mut has_left = false;
            for block in shot.of_shot {
                let waveform = Waveform { samples: shot.blocks.samples(block), start_phase: 0 };
                let level = GainLevel::of(block.gain);
                let lot = match block.channel {
                    Channel::Reference if !has_left => {
                        has_left = true;
                        Lot::Outgoing(level, outgoing.push(level, waveform))
                    }
                    Channel::LowPower => {
                        echoes(&self.low, block, || Lot::Low(level, low.push(level, waveform)))
                    }
                    Channel::HighPower if shot.is_covered(block, both) => Lot::Covered,
                    Channel::HighPower => {
                        echoes(&self.high, block, || Lot::High(level, high.push(level, waveform)))
                    }
                    _ => Lot::Other,
                };
                self.lots.push(lot);
            }
        }
        self.decompose_channel(Channel::LowPower, &low)?;
        self.decompose_channel(Channel::HighPower, &high)?;
        self.fit_outgoing(&outgoing)
    }

    /// Decomposes the blocks of one receiver.
    fn decompose_channel(&mut self, channel: Channel, queue: &ByGain<Waveform>) -> Result<()> {
        let Receivers { low, high, config, tables, path, left_to_plain, .. } = self;
        let receiver = if channel == Channel::LowPower { low } else { high };
        let Some(receiver) = receiver else { return Ok(()) };
        for (level, waveforms) in queue.iter() {
            let Receiver { kernels, outcomes } = receiver.need(level, |unit| {
                let model = unit.kernels.model().at_gain(level.gain()).map_err(unusable)?;
                let tables = tables.as_ref().and_then(|tables| tables.of(channel, level, &model));
                let made = Receiver::new(Some(&model), tables.as_ref(), config, *path).map_err(unusable)?;
                made.ok_or(StageError::Stopped)
            })?;
            let before = kernels.left_to_plain();
            kernels.decompose(waveforms, outcomes);
            *left_to_plain += kernels.left_to_plain() - before;
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
            let Reference { batch, outgoing, .. } = reference.need(level, |unit| {
                let model = unit.batch.model().at_gain(level.gain()).map_err(unusable)?;
                let tables = tables.as_ref().and_then(|tables| tables.of(Channel::Reference, level, &model));
                OutgoingBatch::new(&model, tables, *path).map(Reference::new).map_err(unusable)
            })?;
            batch.fit(waveforms, outgoing);
        }
        Ok(())
    }

    /// Waveforms of echoes that the plain kernels decomposed since the start.
    pub(super) fn left_to_plain(&self) -> u64 {
        self.left_to_plain
    }

    /// Looks for echoes on the outgoing pulses of the shots that were decomposed last, gain by gain.
    ///
    /// `is_line`: they are a whole line, and say what is usual; else the last line does. `is_expected` says whether an
    /// echo was received while the emission of this index left.
    pub(super) fn judge_outgoing(
        &mut self,
        shots: &[Shot],
        is_line: bool,
        is_expected: impl Fn(u32) -> bool,
    ) {
        let Some(reference) = &mut self.reference else { return };
        let all = shots.iter().flat_map(|shot| shot.of_shot.iter().map(move |block| (shot, block)));
        let mut recorded = ByGain::new();
        for ((shot, block), lot) in all.zip(&self.lots) {
            let Lot::Outgoing(level, _) = *lot else { continue };
            let start_samples = block.start_ns / block.interval_ns;
            let start_samples = if start_samples.is_finite() { start_samples } else { 0.0 };
            recorded.push(
                level,
                (ReferenceBlock { samples: shot.blocks.samples(block), start_samples }, shot.index),
            );
        }
        for (level, Reference { batch, outgoing, usual }) in reference.iter_mut() {
            let of_gain = recorded.of(level);
            if is_line {
                let blocks: Vec<ReferenceBlock> = of_gain.iter().map(|(block, _)| *block).collect();
                *usual = batch.usual(&blocks, outgoing);
            }
            let Some(usual) = usual else { continue };
            for ((block, index), outgoing) in of_gain.iter().zip(outgoing) {
                if let Some(outgoing) = outgoing {
                    batch.judge(block, outgoing, usual, is_expected(*index));
                }
            }
        }
    }

    /// The lots of the blocks, from one on.
    pub(super) fn lots(&self, from: usize) -> &[Lot] {
        self.lots.get(from..).unwrap_or_default()
    }

    /// What was found in a block of echoes, by which receiver, and that one's model.
    pub(super) fn found(&self, lot: Lot) -> Option<(ReturnChannel, Decomposition<'_>, &ChannelModel)> {
        let (receiver, channel, level, number) = match lot {
            Lot::Low(level, number) => (&self.low, ReturnChannel::Low, level, number),
            Lot::High(level, number) => (&self.high, ReturnChannel::High, level, number),
            Lot::Outgoing(..) | Lot::Unused(_) | Lot::Covered | Lot::Other => return None,
        };
        let receiver = receiver.as_ref()?.get(level)?;
        Some((channel, receiver.outcomes.get(number)?, receiver.kernels.model()))
    }

    /// The outgoing pulse that was found in a block, and the model of its channel.
    pub(super) fn outgoing(&self, lot: Lot) -> Option<(&Outgoing, &ChannelModel)> {
        let Lot::Outgoing(level, number) = lot else { return None };
        let reference = self.reference.as_ref()?.get(level)?;
        Some((reference.outgoing.get(number)?.as_ref()?, reference.batch.model()))
    }
}

/// The lot of a block of echoes, where nothing speaks against its receiver.
fn echoes(receiver: &Option<AtGains<Receiver>>, block: &Block, lot: impl FnOnce() -> Lot) -> Lot {
    match receiver {
        None => Lot::Unused("a receiver that the sensor model lacks"),
        Some(_) if block.is_empty() => Lot::Unused("a block without samples"),
        Some(_) => lot(),
    }
}

fn unusable(error: ModelError) -> StageError {
    StageError::failed(error.to_string(), "calibrate on a longer part of the recording")
}
