//! The receivers of a sensor: each decomposes at once what it recorded of a line.

use std::sync::{Arc, Mutex, PoisonError, Weak};

use super::both::BothReceivers;
use super::shots::Shot;
use super::{Decompose, Mode};
use crate::batch::{Block, Channel, ReturnChannel};
use crate::kernels::calibrate::Block as Waveform;
use crate::kernels::decompose::{DecomposeSettings, Decomposition};
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
    /// Decomposed by the sensitive receiver, as its block of this number.
    Low(usize),
    /// The same by the coarse one.
    High(usize),
    /// The shot's outgoing pulse, of this number.
    Outgoing(usize),
    /// Left out, and why.
    Unused(&'static str),
    /// Echoes that the sensitive receiver recorded as well.
    Covered,
    /// Neither an echo nor an outgoing pulse.
    Other,
}

/// A receiver and what it found in its blocks of the line.
struct Receiver {
    kernels: Lockstep,
    outcomes: Outcomes,
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
    low: Option<Receiver>,
    high: Option<Receiver>,
    reference: Option<OutgoingBatch>,
    outgoing: Vec<Option<Outgoing>>,
    /// What the outgoing pulses of the line have in common.
    usual: Option<Usual>,
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
            low: make(&model.low_power, &tables.low)?,
            high: make(&model.high_power, &tables.high)?,
            reference: reference.transpose().map_err(unusable)?,
            outgoing: Vec::new(),
            usual: None,
            lots: Vec::new(),
        })
    }

    /// Decomposes all blocks of shots, receiver by receiver.
    pub(super) fn decompose(&mut self, shots: &[Shot], both: Option<&BothReceivers>) {
        let (mut low, mut high, mut outgoing) = (Vec::new(), Vec::new(), Vec::new());
        self.lots.clear();
        for shot in shots {
            let mut has_left = false;
            for block in shot.of_shot {
                let waveform = Waveform { samples: shot.blocks.samples(block), start_phase: 0 };
                let lot = match block.channel {
                    Channel::Reference if !has_left => {
                        has_left = true;
                        queued(&mut outgoing, waveform, Lot::Outgoing)
                    }
                    Channel::LowPower => {
                        self.echoes(self.low.as_ref(), block, || queued(&mut low, waveform, Lot::Low))
                    }
                    Channel::HighPower if shot.is_covered(block, both) => Lot::Covered,
                    Channel::HighPower => {
                        self.echoes(self.high.as_ref(), block, || queued(&mut high, waveform, Lot::High))
                    }
                    _ => Lot::Other,
                };
                self.lots.push(lot);
            }
        }
        for (receiver, waveforms) in [(&mut self.low, &low), (&mut self.high, &high)] {
            if let Some(Receiver { kernels, outcomes }) = receiver {
                kernels.decompose(waveforms, outcomes);
            }
        }
        self.outgoing.clear();
        if let Some(reference) = &mut self.reference {
            reference.fit(&outgoing, &mut self.outgoing);
        }
    }

    /// Waveforms of echoes that the plain kernels decomposed since the start.
    pub(super) fn left_to_plain(&self) -> u64 {
        [&self.low, &self.high].into_iter().flatten().map(|receiver| receiver.kernels.left_to_plain()).sum()
    }

    /// Looks for echoes on the outgoing pulses of the shots that were decomposed last.
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
        let lots = self.lots.iter();
        let all = shots.iter().flat_map(|shot| shot.of_shot.iter().map(move |block| (shot, block)));
        let recorded = all.zip(lots).filter(|(_, lot)| matches!(lot, Lot::Outgoing(_)));
        let (blocks, indices): (Vec<ReferenceBlock>, Vec<u32>) = recorded
            .map(|((shot, block), _)| {
                let start_samples = block.start_ns / block.interval_ns;
                let start_samples = if start_samples.is_finite() { start_samples } else { 0.0 };
                (ReferenceBlock { samples: shot.blocks.samples(block), start_samples }, shot.index)
            })
            .unzip();
        if is_line {
            self.usual = reference.usual(&blocks, &self.outgoing);
        }
        let Some(usual) = &self.usual else { return };
        for ((block, index), outgoing) in blocks.iter().zip(indices).zip(&mut self.outgoing) {
            if let Some(outgoing) = outgoing {
                reference.judge(block, outgoing, usual, is_expected(index));
            }
        }
    }

    /// The lot of a block of echoes, where nothing speaks against its receiver.
    fn echoes(&self, receiver: Option<&Receiver>, block: &Block, lot: impl FnOnce() -> Lot) -> Lot {
        match receiver {
            None => Lot::Unused("a receiver that the sensor model lacks"),
            Some(_) if block.is_empty() => Lot::Unused("a block without samples"),
            Some(_) => lot(),
        }
    }

    /// The lots of the blocks, from one on.
    pub(super) fn lots(&self, from: usize) -> &[Lot] {
        self.lots.get(from..).unwrap_or_default()
    }

    /// What was found in a block of echoes, by which receiver, and that one's model.
    pub(super) fn found(&self, lot: Lot) -> Option<(ReturnChannel, Decomposition<'_>, &ChannelModel)> {
        let (receiver, channel, number) = match lot {
            Lot::Low(number) => (&self.low, ReturnChannel::Low, number),
            Lot::High(number) => (&self.high, ReturnChannel::High, number),
            Lot::Outgoing(_) | Lot::Unused(_) | Lot::Covered | Lot::Other => return None,
        };
        let receiver = receiver.as_ref()?;
        Some((channel, receiver.outcomes.get(number)?, receiver.kernels.model()))
    }

    /// The outgoing pulse that was found in a block, and the model of its channel.
    pub(super) fn outgoing(&self, lot: Lot) -> Option<(&Outgoing, &ChannelModel)> {
        let Lot::Outgoing(number) = lot else { return None };
        Some((self.outgoing.get(number)?.as_ref()?, self.reference.as_ref()?.model()))
    }
}

/// Queues a waveform and says so.
fn queued<'a>(queue: &mut Vec<Waveform<'a>>, waveform: Waveform<'a>, lot: fn(usize) -> Lot) -> Lot {
    queue.push(waveform);
    lot(queue.len() - 1)
}

fn unusable(error: ModelError) -> StageError {
    StageError::failed(error.to_string(), "calibrate on a longer part of the recording")
}
