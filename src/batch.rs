//! What flows down a chain: one [`Batch`] is one scan line.
//!
//! A batch always holds its line's emissions; what else it holds is its [`Kind`]: the recorded sample blocks, the
//! returns found in them, or the points they became. Samples lie in one arena per line, so that a line costs a handful
//! of allocations however many pulses it has.

use std::sync::Arc;

use crate::kernels::fusion::ChannelFusion;
use crate::kernels::sensor_model::SensorModel;

mod budget;
mod input;
mod line_stats;
mod points;
mod shots;

pub use budget::{AtWork, Budget, NoRoom, Ticket};
pub use input::{
    AmplitudeTable, EmissionReference, Frame, GainControl, InputInfo, LinearAmplitude, TimeScale,
};
pub use line_stats::LineStats;
pub use points::{Return, ReturnChannel, Returns, flags};
pub use shots::{Block, Blocks, Channel, Emission, OnlineReturn, emission_flags};

/// The longest a scan line may be before a reader ends it, in shots.
pub const MAX_SHOTS_PER_LINE: usize = 4096;

/// One scan line on its way down the chain.
#[derive(Debug)]
pub struct Batch {
    /// What is known of the recording as a whole.
    pub input: Arc<InputInfo>,
    /// Scan line, from 0 in each input.
    pub line: u32,
    /// The line's counters: each stage adds its own, and nobody keeps a second count.
    pub stats: LineStats,
    /// What `calibrate` found, once it has.
    pub model: Option<Arc<SensorModel>>,
    /// What `fuse_channels` found, once it has: the times of the high power blocks then count as the others do.
    pub fusion: Option<Arc<ChannelFusion>>,
    /// The line's emissions in order of time.
    pub emissions: Vec<Emission>,
    /// What was recorded, found or computed for them.
    pub content: Content,
    /// Where a sink of the job wants the recorded blocks together with their returns: they stay here behind `decompose`.
    pub waveforms: Option<Blocks>,
    /// The batch's share of the memory in flight; given back when the batch is dropped.
    pub(crate) ticket: Option<Ticket>,
}

/// What a batch holds besides its emissions.
#[derive(Debug)]
pub enum Content {
    /// The recorded sample blocks.
    Shots(Blocks),
    /// The returns found in them, ordered by emission, then by time.
    Returns(Returns),
    /// The returns, and where each lies in the output frame (same order and length).
    Points(Returns, Vec<[f64; 3]>),
}

/// The kinds of batch: what a stage accepts and makes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// Emissions and recorded sample blocks.
    Shots,
    /// Emissions and the returns found.
    Returns,
    /// Returns with coordinates in the output frame.
    Points,
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Kind::Shots => "Shots",
            Kind::Returns => "Returns",
            Kind::Points => "Points",
        })
    }
}

impl Batch {
    /// A line as a reader delivers it. `nw` and the line's time are set from its emissions and blocks.
    pub fn of_shots(input: Arc<InputInfo>, line: u32, emissions: Vec<Emission>, blocks: Blocks) -> Batch {
        let stats = LineStats {
            gps_time_s: emissions.first().map_or(f64::NAN, |e| e.gps_time_s),
            nw: blocks.waveforms() as u64,
            ..LineStats::default()
        };
        let content = Content::Shots(blocks);
        Batch {
            input,
            line,
            stats,
            model: None,
            fusion: None,
            emissions,
            content,
            waveforms: None,
            ticket: None,
        }
    }

    /// What the batch holds.
    pub fn kind(&self) -> Kind {
        match self.content {
            Content::Shots(_) => Kind::Shots,
            Content::Returns(_) => Kind::Returns,
            Content::Points(..) => Kind::Points,
        }
    }

    /// The recorded blocks, while they are there.
    pub fn blocks(&self) -> Option<&Blocks> {
        match &self.content {
            Content::Shots(blocks) => Some(blocks),
            _ => None,
        }
    }

    /// The returns, once there are some.
    pub fn returns(&self) -> Option<&Returns> {
        match &self.content {
            Content::Returns(returns) | Content::Points(returns, _) => Some(returns),
            Content::Shots(_) => None,
        }
    }

    /// The coordinates in the output frame, once there are some.
    pub fn points(&self) -> Option<&[[f64; 3]]> {
        match &self.content {
            Content::Points(_, points) => Some(points),
            _ => None,
        }
    }

    /// How many returns there are; 0 before `decompose`.
    pub fn n_returns(&self) -> usize {
        self.returns().map_or(0, |returns| returns.len())
    }

    /// The memory the batch takes, in bytes: what `memory_mb` bounds.
    pub fn bytes(&self) -> usize {
        let content = match &self.content {
            Content::Shots(blocks) => blocks.bytes(),
            Content::Returns(returns) => returns.capacity() * size_of::<Return>(),
            Content::Points(returns, points) => {
                returns.capacity() * size_of::<Return>() + points.capacity() * size_of::<[f64; 3]>()
            }
        };
        let waveforms = self.waveforms.as_ref().map_or(0, Blocks::bytes);
        size_of::<Batch>() + self.emissions.capacity() * size_of::<Emission>() + content + waveforms
    }

    /// Tells the budget what the batch takes now, after a stage has changed it.
    pub(crate) fn recount(&mut self) {
        let bytes = self.bytes();
        if let Some(ticket) = &mut self.ticket {
            ticket.resize(bytes);
        }
    }
}
