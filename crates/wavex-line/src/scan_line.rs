//! Data that flows through a chain of stages.
//!
//! A [`ScanLine`] is one scan line. It always holds its shots. Its [`Kind`]
//! determines its other content: recorded sample blocks, returns found in them, or points computed
//! from them. The samples of a line share one buffer, so a line needs few allocations, whatever its
//! number of shots.

use std::sync::Arc;

use wavex_signal::fusion::ChannelFusion;
use wavex_signal::sensor_model::SensorModel;

mod budget;
mod copies;
mod filtered;
mod footprint;
mod input;
mod line_stats;
mod points;
mod profiles;
mod removal;
mod shots;

pub use budget::{AtWork, Budget, NoRoom, Ticket};
pub use filtered::Filtered;
pub use footprint::{Footprint, LARGE_FOOTPRINT_NS, footprint_flags, has_large_footprints};
pub use input::{AmplitudeTable, EmissionReference, FirstShot, GainControl, InputInfo, LinearAmplitude};
pub use line_stats::LineStats;
pub use points::{Return, ReturnChannel, Returns, flags};
pub use profiles::ShotProfile;
pub use shots::{Block, Blocks, Channel, Emission, FootprintRecord, OnlineReturn, emission_flags};
pub use wavex_geodesy::{time::TimeScale, vertical::Frame};

/// Maximum length of a scan line, shots.
///
/// Readers end longer lines.
pub const MAX_SHOTS_PER_LINE: usize = 4096;

/// Scan line with its data.
#[derive(Debug)]
pub struct ScanLine {
    /// Metadata of the recording.
    pub input: Arc<InputInfo>,
    /// Number of the scan line, from 0 in each input.
    pub line: u32,
    /// Counters of the line.
    ///
    /// Each stage adds its own, and there is no other count.
    pub stats: LineStats,
    /// Sensor model, set by `calibrate`.
    pub model: Option<Arc<SensorModel>>,
    /// Channel fusion, set by `fuse_channels`.
    ///
    /// Times of high-power blocks are corrected from then on.
    pub fusion: Option<Arc<ChannelFusion>>,
    /// Shots of the line, ordered by time.
    pub emissions: Vec<Emission>,
    /// Sample blocks, returns or points of the shots.
    pub content: Content,
    /// Profiles of shots with distributed targets, ordered by shot; set by `decompose`.
    pub profiles: Vec<ShotProfile>,
    /// Footprints of the shots, ordered by shot; set by `measure_footprints`.
    pub footprints: Vec<Footprint>,
    /// Sample blocks kept after `decompose`, if a sink needs them.
    pub waveforms: Option<Blocks>,
    /// Shots as the source delivered them, if a sink needs them.
    pub recorded: Option<Box<RecordedShots>>,
    /// Share of the memory budget.
    ///
    /// Released when the scan line is dropped.
    pub ticket: Option<Ticket>,
}

/// Shots of a line as its source delivered them, before poses.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedShots {
    /// Metadata of the recording.
    pub input: Arc<InputInfo>,
    /// All shots of the line, with those that no pose exists for.
    pub emissions: Vec<Emission>,
}

/// Content of a scan line besides its shots.
#[derive(Debug)]
pub enum Content {
    /// Recorded sample blocks.
    Shots(Blocks),
    /// Returns, ordered by shot, then by time.
    Returns(Returns),
    /// Returns and their coordinates in the output frame.
    ///
    /// Both have the same order and length.
    Points(Returns, Vec<[f64; 3]>),
}

/// Kind of scan line.
///
/// The input and output type of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Kind {
    /// Shots and recorded sample blocks, in digitiser steps.
    Shots,
    /// Shots and recorded sample blocks with fractions of digitiser steps (GEDI).
    Footprints,
    /// Shots and returns.
    Returns,
    /// Returns with coordinates in the output frame.
    Points,
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Kind::Shots => "Shots",
            Kind::Footprints => "Footprints",
            Kind::Returns => "Returns",
            Kind::Points => "Points",
        })
    }
}

impl ScanLine {
    /// Whether the shots have large footprints ([`has_large_footprints`]), by the first waveform and the mean pulse rate.
    pub fn has_large_footprints(&self) -> bool {
        let first = self.blocks().and_then(|blocks| blocks.iter().find(|block| block.channel.is_echo()));
        let length_ns = first.map_or(f64::NAN, |block| block.len() as f64 * block.interval_ns);
        let ends = self.emissions.first().zip(self.emissions.last());
        let duration_ps = ends.map_or(0, |(first, last)| last.clock_ps.saturating_sub(first.clock_ps));
        let intervals = self.emissions.len().saturating_sub(1);
        let rate_hz = if duration_ps > 0 { intervals as f64 / duration_ps as f64 * 1e12 } else { f64::NAN };
        has_large_footprints(self.input.instrument.as_deref(), length_ns, rate_hz)
    }

    /// Creates a line as delivered by a reader.
    ///
    /// Sets `nw` and the line's time.
    pub fn of_shots(input: Arc<InputInfo>, line: u32, emissions: Vec<Emission>, blocks: Blocks) -> ScanLine {
        let stats = LineStats {
            gps_time_s: emissions.first().map_or(f64::NAN, |e| e.gps_time_s),
            nw: blocks.waveforms() as u64,
            ..LineStats::default()
        };
        let content = Content::Shots(blocks);
        ScanLine {
            input,
            line,
            stats,
            model: None,
            fusion: None,
            emissions,
            content,
            profiles: Vec::new(),
            footprints: Vec::new(),
            waveforms: None,
            recorded: None,
            ticket: None,
        }
    }

    /// Copy without its share of the memory budget.
    pub fn copied(&self) -> ScanLine {
        let content = match &self.content {
            Content::Shots(blocks) => Content::Shots(blocks.clone()),
            Content::Returns(returns) => Content::Returns(returns.clone()),
            Content::Points(returns, points) => Content::Points(returns.clone(), points.clone()),
        };
        ScanLine {
            input: Arc::clone(&self.input),
            line: self.line,
            stats: self.stats.clone(),
            model: self.model.clone(),
            fusion: self.fusion.clone(),
            emissions: self.emissions.clone(),
            content,
            profiles: self.profiles.clone(),
            footprints: self.footprints.clone(),
            waveforms: self.waveforms.clone(),
            recorded: self.recorded.clone(),
            ticket: None,
        }
    }

    /// Profile of a shot's target, if it has one.
    pub fn profile(&self, emission: u32) -> Option<&ShotProfile> {
        let found = self.profiles.binary_search_by_key(&emission, |profile| profile.emission);
        self.profiles.get(found.ok()?)
    }

    /// Returns the kind of content.
    pub fn kind(&self) -> Kind {
        match &self.content {
            Content::Shots(blocks) if blocks.has_fractions() => Kind::Footprints,
            Content::Shots(_) => Kind::Shots,
            Content::Returns(_) => Kind::Returns,
            Content::Points(..) => Kind::Points,
        }
    }

    /// Returns the recorded blocks, before `decompose`.
    pub fn blocks(&self) -> Option<&Blocks> {
        match &self.content {
            Content::Shots(blocks) => Some(blocks),
            _ => None,
        }
    }

    /// Returns the returns, after `decompose`.
    pub fn returns(&self) -> Option<&Returns> {
        match &self.content {
            Content::Returns(returns) | Content::Points(returns, _) => Some(returns),
            Content::Shots(_) => None,
        }
    }

    /// Returns the coordinates in the output frame, after `georeference`.
    pub fn points(&self) -> Option<&[[f64; 3]]> {
        match &self.content {
            Content::Points(_, points) => Some(points),
            _ => None,
        }
    }

    /// Returns the number of returns; 0 before `decompose`.
    pub fn n_returns(&self) -> usize {
        self.returns().map_or(0, |returns| returns.len())
    }

    /// Returns the memory used by the scan line, bytes.
    ///
    /// It is limited by `memory_mb`.
    pub fn bytes(&self) -> usize {
        let content = match &self.content {
            Content::Shots(blocks) => blocks.bytes(),
            Content::Returns(returns) => returns.capacity() * size_of::<Return>(),
            Content::Points(returns, points) => {
                returns.capacity() * size_of::<Return>() + points.capacity() * size_of::<[f64; 3]>()
            }
        };
        let waveforms = self.waveforms.as_ref().map_or(0, Blocks::bytes);
        let recorded = self.recorded.as_ref().map_or(0, |recorded| recorded.emissions.capacity());
        size_of::<ScanLine>()
            + (self.emissions.capacity() + recorded) * size_of::<Emission>()
            + self.footprints.capacity() * size_of::<Footprint>()
            + content
            + waveforms
    }

    /// Updates the share of the budget after a change.
    pub fn recount(&mut self) {
        let bytes = self.bytes();
        if let Some(ticket) = &mut self.ticket {
            ticket.resize(bytes);
        }
    }
}
