//! Waveforms to returns.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::batch::{Batch, Blocks, Content, Emission, Kind, LineStats, Return, Returns};
use crate::kernels::fusion::ChannelFusion;
use crate::kernels::lockstep::Path;
use crate::kernels::sensor_model::SensorModel;
use crate::overview::{Gallery, ShownReturn, ShownShot};
use crate::stage::{Config, Context, InvalidKey, Map, MapConfig, Result, Site, StageError, StageSpec};

mod at_gains;
mod both;
mod crosstalk;
mod found;
mod online;
mod receivers;
mod seen;
mod shots;

use receivers::SharedTables;

pub use online::OnlinePoints;

pub(crate) use receivers::SensorTables;
pub(crate) use seen::{Seen, SeenBlock, SeenPulse};
pub(crate) use shots::{BlockFit, Line, Shot, ShotDecomposer, Watch};

/// The stage's place in the registry.
pub const STAGE: StageSpec = StageSpec::map::<Decompose>("decompose", &[Kind::Shots], Some(Kind::Returns))
    .after(&["calibrate"])
    .unless("online_points", "only");

/// Finds the returns of every waveform, each with its standard deviations.
///
/// Peaks above the detection threshold start a joint least-squares fit of pulses in noise that is correlated as
/// `calibrate` found it; what the fit leaves is searched once more. The outgoing pulse of each shot is fitted by the same
/// estimator, and ranges count from it: peak to peak. Times of a file that has no outgoing pulse but its own return
/// locations (LAS) are tied to those, and where it has neither, the unknown part of a sample goes into the standard
/// deviations.
///
/// Of two receivers the sensitive one is used; the other where the sensitive one is saturated or did not record. Behind
/// `fuse_channels` both are fitted together where the sensitive one is saturated or overdriven and the other sees the same
/// echo (channel `joint`), the other one's are used where the sensitive one contradicts it, and what both see counts once.
///
/// The instrument's own returns, where the recording has them (the column `online` of a container, the points of LAS), become
/// returns as `online_points` says, with flag bit 12. They have time and amplitude of the instrument, which is their
/// intensity; the standard deviation of their range is 0.255 m, and what is not known is `nan` (in LAS: 0). SDF and
/// PulseWaves have none. Where a shot has such returns and computed ones, the report compares them: `online_matched` and
/// `computed_matched` (share of each that has a partner within a pulse width), `online_minus_computed_ns`,
/// `online_computed_distance_ns` (times 1.4826, its median is a robust standard deviation) and
/// `online_over_computed_amplitude`.
///
/// Per return: `time_of_flight_ns`, `range_m`, `amplitude_dn`, `width_ratio`, `thickness_m`, `intensity`, each with its
/// standard deviation, and `deviation_ratio` and `flags`. Their definitions, with formulas and units, stand in
/// `docs/returns.md`, the method in `docs/method.md`.
///
/// With `online_points = "only"` no waveform is decomposed, and `calibrate` is needed only where samples of the outgoing pulse
/// are recorded, by which ranges count.
///
/// A block that was being recorded when another shot of the line left holds what leaked in from that emission, as a pulse
/// like any other. Returns within three widths of that moment have flag bit 3, the block's other returns bit 4. Where an
/// echo lies on a shot's outgoing pulse, all its returns have bit 5. Their ranges count from a joint fit of pulse and echo, and
/// the standard deviations include what it leaves unknown; they are at least 0.255 m where no such fit explains the samples.
///
/// Counts `np np_xtalk np_xtalk_dropped np_filtered np_merged np_online nw_empty nw_saturated nw_refined1x nw_refined2x nw_truncated nw_deleted`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Decompose {
    /// How thoroughly waveforms are decomposed.
    pub mode: Mode,
    /// Refine waveforms whose pulses overlap, weak ones that are dropped later included, or whose deviation ratio exceeds 3; for `fastest` and `fast_separated`, as the
    /// other modes refine all.
    pub refine_when_needed: bool,
    /// Detection threshold, in standard deviations of the noise after the matched filter.
    pub detection_sigma: f64,
    /// The same for the last of two or more returns of a block, where it is to be higher: for receivers that ring behind
    /// strong echoes. A last return below it is dropped, and the one before it becomes the last; `false`: no other threshold.
    pub detection_sigma_last: NumberOrFalse,
    /// Smallest and largest width of a return over that of the calibrated pulse. A return is dropped only where two
    /// standard deviations of its width do not reach into the range.
    pub width_ratio: [f64; 2],
    /// The part of a range's standard deviation that no fit can show: clock and cabling, ns.
    pub timing_error_ns: f64,
    /// How much two returns must lower chi-square against one widened return to stand in its place; `false`: widened returns
    /// are not divided. At 16 at most one single return in a thousand is divided; at 11, four in a thousand, and closer
    /// pairs are told apart. Without effect where pulses are taken to be Gaussians.
    pub split_evidence: NumberOrFalse,
    /// How well the system response is known at least, as part of a return's amplitude: what an error of this size looks
    /// like is no return. Raise it where strong returns are followed by false ones.
    pub template_error: f64,
    /// Drop returns that overlap what leaks in from the emission of another shot (flag bit 3).
    pub drop_emission_crosstalk: bool,
    /// When the instrument's own returns become points: for shots without a recorded waveform, never, or instead of all
    /// that could be computed.
    pub online_points: OnlinePoints,
    #[serde(skip)]
    tables: SharedTables,
}

/// How thoroughly waveforms are decomposed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// One step for each detected pulse, as if it stood alone: for single returns as good as `refined`.
    Fastest,
    /// The same where returns do not overlap; those that do are fitted together.
    FastSeparated,
    /// All pulses fitted to the optimum, what they leave searched, and widened ones tried as two.
    #[default]
    Refined,
    /// The same by the plain kernels, and every widened pulse is tried as two.
    Slow,
}

/// A number, or `false` for none.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum NumberOrFalse {
    /// The number.
    Number(f64),
    /// `false`.
    Without(bool),
}

impl NumberOrFalse {
    /// The number, where there is one.
    pub fn number(self) -> Option<f64> {
        match self {
            NumberOrFalse::Number(number) => Some(number),
            NumberOrFalse::Without(_) => None,
        }
    }

    /// Whether it is a number that is within, or `false` and not `true`.
    pub(super) fn is_within(self, range: std::ops::RangeInclusive<f64>) -> bool {
        match self {
            NumberOrFalse::Number(number) => range.contains(&number),
            NumberOrFalse::Without(with) => !with,
        }
    }
}

impl Default for Decompose {
    fn default() -> Decompose {
        Decompose {
            mode: Mode::Refined,
            refine_when_needed: false,
            detection_sigma: 4.5,
            detection_sigma_last: NumberOrFalse::Without(false),
            width_ratio: [0.8, 10.0],
            timing_error_ns: 0.004,
            split_evidence: NumberOrFalse::Number(16.0),
            template_error: 0.005,
            drop_emission_crosstalk: false,
            online_points: OnlinePoints::default(),
            tables: SharedTables::default(),
        }
    }
}

impl Config for Decompose {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        let [low, high] = self.width_ratio;
        InvalidKey::unless(
            !self.refine_when_needed || matches!(self.mode, Mode::Fastest | Mode::FastSeparated),
            "refine_when_needed",
            "it has no effect in this `mode`, which refines every waveform; leave it out, or choose \
             `mode = \"fastest\"` or `\"fast_separated\"`",
        )?;
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
        InvalidKey::unless(
            self.detection_sigma_last.is_within(self.detection_sigma..=1000.0),
            "detection_sigma_last",
            "it must lie between detection_sigma and 1000, or be `false`",
        )?;
        InvalidKey::unless(
            self.split_evidence.is_within(4.0..=1e6),
            "split_evidence",
            "it must lie between 4 and 1000000, or be `false`",
        )?;
        InvalidKey::unless(
            (0.0..=1.0).contains(&self.template_error),
            "template_error",
            "it must lie between 0 and 1",
        )
    }
}

impl MapConfig for Decompose {
    fn make(&self, site: &Site) -> Result<Box<dyn Map>> {
        Ok(Box::new(DecomposeLine { config: self.clone(), path: site.simd, worker: None }))
    }
}

/// One worker: its kernels are made when the first line brings the sensor model.
struct DecomposeLine {
    config: Decompose,
    path: Path,
    worker: Option<Worker>,
}

/// A sensor's kernels, and what they share with those of the other workers.
struct Worker {
    model: Arc<SensorModel>,
    fusion: Option<Arc<ChannelFusion>>,
    _tables: Arc<SensorTables>,
    shots: ShotDecomposer,
}

impl Worker {
    fn new(
        model: &Arc<SensorModel>,
        fusion: Option<&Arc<ChannelFusion>>,
        config: &Decompose,
        path: Path,
    ) -> Result<Worker> {
        let tables = config.tables.of(model, config.mode);
        let shots =
            ShotDecomposer::new(model, &tables, config, path)?.fusing(fusion.map(|fusion| &**fusion))?;
        Ok(Worker { model: Arc::clone(model), fusion: fusion.cloned(), _tables: tables, shots })
    }
}

impl Worker {
    fn is_for(&self, model: &Arc<SensorModel>, fusion: Option<&Arc<ChannelFusion>>) -> bool {
        let same_fusion = match (&self.fusion, fusion) {
            (Some(own), Some(other)) => Arc::ptr_eq(own, other),
            (own, other) => own.is_none() && other.is_none(),
        };
        same_fusion && Arc::ptr_eq(&self.model, model)
    }
}

/// A line that was decomposed.
struct Looked<'a> {
    line: u32,
    emissions: &'a [Emission],
    returns: &'a [Return],
}

impl Worker {
    /// Decomposes the shots that are worth showing once more, looking on.
    fn show(&mut self, shots: &[Shot], looked: &Looked, gallery: &mut Gallery) -> Result<()> {
        for candidate in gallery.candidates(looked.line, looked.emissions, looked.returns) {
            let is_it = |shot: &&Shot| shot.index == candidate.emission;
            let Some(shot) = shots.iter().find(is_it) else { continue };
            let mut seen = Seen::new(shot.blocks);
            let (mut emissions, mut returns) = (looked.emissions.to_vec(), Returns::new());
            let mut line =
                Line { emissions: &mut emissions, returns: &mut returns, stats: &mut LineStats::default() };
            self.shots.decompose_again(shot, &mut line, &mut Context::default(), &mut seen)?;
            let Some(emission) = emissions.get(candidate.emission as usize) else { continue };
            let blocks = seen.finish(emission, &returns).0;
            let shown = ShownShot {
                kind: candidate.kind,
                line: looked.line,
                shot: emission.shot,
                gps_time_s: emission.gps_time_s.is_finite().then_some(emission.gps_time_s),
                deviation_ratio: candidate.deviation_ratio,
                blocks: blocks.into_iter().map(|block| block.shown).collect(),
                returns: returns.iter().map(ShownReturn::from).collect(),
            };
            gallery.show(candidate.merit, shown);
        }
        Ok(())
    }
}

impl Map for DecomposeLine {
    fn map(&mut self, mut batch: Batch, cx: &mut Context) -> Result<Batch> {
        let choice = self.config.online_points;
        let model = batch.model.clone();
        if model.is_none() && choice != OnlinePoints::Only {
            return Err(StageError::failed(
                "the line comes without a sensor model",
                "put calibrate before decompose",
            ));
        }
        let Content::Shots(blocks) = std::mem::replace(&mut batch.content, Content::Returns(Returns::new()))
        else {
            return Err(StageError::failed(
                "decompose was given no waveforms",
                "put it before the stages that use returns",
            ));
        };
        let mut returns = Returns::new();
        match &model {
            Some(model) => self.decompose(model, &mut batch, &blocks, &mut returns, cx)?,
            None => online::date_without_model(&mut batch.emissions, &blocks)?,
        }
        if let Some(model) =
            model.as_ref().filter(|_| choice != OnlinePoints::Only && !blocks.online.is_empty())
        {
            online::compare(&blocks, &batch, &returns, model, cx);
        }
        online::add(choice, &mut batch, &blocks, &mut returns)?;
        batch.stats.np += returns.len() as u64;
        batch.content = Content::Returns(returns);
        if let Some(kept) = &mut batch.waveforms {
            *kept = blocks;
        }
        Ok(batch)
    }
}

impl DecomposeLine {
    /// Decomposes the blocks of a line; those of outgoing pulses alone where the instrument's returns stand for all.
    fn decompose(
        &mut self,
        model: &Arc<SensorModel>,
        batch: &mut Batch,
        blocks: &Blocks,
        returns: &mut Returns,
        cx: &mut Context,
    ) -> Result<()> {
        let mut worker = match self.worker.take() {
            Some(worker) if worker.is_for(model, batch.fusion.as_ref()) => worker,
            _ => Worker::new(model, batch.fusion.as_ref(), &self.config, self.path)?,
        };
        let shot = |(index, of_shot)| Shot { index, blocks, of_shot, input: &batch.input };
        let is_only = self.config.online_points == OnlinePoints::Only;
        let outgoing = if is_only { online::outgoing_only(blocks) } else { Vec::new() };
        let shots: Vec<Shot> = match is_only {
            true => outgoing
                .chunk_by(|a, b| a.emission == b.emission)
                .map(|of_shot| shot((of_shot[0].emission, of_shot)))
                .collect(),
            false => blocks.by_emission().map(shot).collect(),
        };
        let mut line = Line { emissions: &mut batch.emissions, returns, stats: &mut batch.stats };
        worker.shots.decompose(&shots, &mut line, cx, &mut ())?;
        if let Some(gallery) = cx.gallery() {
            let looked = Looked { line: batch.line, emissions: &batch.emissions, returns };
            worker.show(&shots, &looked, gallery)?;
        }
        self.worker = Some(worker);
        Ok(())
    }
}
