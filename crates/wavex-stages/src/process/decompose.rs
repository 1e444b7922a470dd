//! Decomposes waveforms into returns.

use std::sync::{Arc, Mutex};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use wavex_simd::SimdLevel;

use wavex_line::keys::{InvalidKey, above, at_least};
use wavex_line::scan_line::{Blocks, Content, Kind, LineStats, Returns, ScanLine};
use wavex_line::stage::{
    Config, Context, DecomposedLine, FittedShot, Map, MapConfig, Result, RunContext, StageError, StageSpec,
    check_whole_steps,
};
use wavex_line::system::Unpoisoned as _;
use wavex_signal::decompose::DecomposeSettings;
use wavex_signal::fusion::ChannelFusion;
use wavex_signal::sensor_model::SensorModel;

mod at_gains;
mod crosstalk;
mod dual_channel;
mod echo;
mod modes;
mod observer;
mod online;
mod profiles;
mod receivers;
mod shot;
mod shots;
mod unexplained;

use receivers::SharedTables;

pub use online::OnlinePoints;
pub use profiles::ProfilesKey;

pub use observer::{Seen, SeenBlock, SeenPulse};
pub(crate) use receivers::SensorTables;
pub use shot::ShotBlocks;
pub use shots::{BlockFit, DecomposedShots, Observer, ShotDecomposer};

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::map::<Decompose>("decompose", &[Kind::Shots], Some(Kind::Returns))
    .after(&["calibrate"])
    .unless("online_points", "only");

/// Estimates the returns of every waveform, with standard deviations.
///
/// Peaks above the detection threshold are start values of a joint least-squares fit. The noise is
/// correlated as estimated by `calibrate`. The residual is then searched for further pulses. The
/// outgoing pulse of each shot is fitted with the same estimator; times of flight are from peak to
/// peak. If a file has return locations but no outgoing pulse (LAS), times are tied to these
/// locations. If it has neither, the jitter of the clock is included in the standard deviations
/// (`emission_jitter_ns`).
///
/// If the response is the recorded outgoing pulse, a return must be a peak of the smoothed waveform: no
/// echo has proven the shape that separates closer ones.
///
/// With two receivers, the low-power receiver is used, and the high-power receiver where the first
/// is saturated or did not record. After `fuse_channels`, both are fitted together if the low-power
/// receiver is saturated or overdriven and the other has the same echo (channel `joint`). If the two
/// contradict each other, the returns of the high-power receiver are used. Echoes recorded by both
/// are reported once.
///
/// The instrument's own returns (the column `online` of a container, the points of LAS) become
/// returns as set by `online_points`, with flag bit 12. They have the time and amplitude of the
/// instrument; the amplitude is also their intensity. The standard deviation of their range is
/// 0.255 m, and unknown values are `nan` (in LAS: 0). SDF and PulseWaves have none. If a shot has
/// both such returns and computed ones, the report compares them: `online_matched` and
/// `computed_matched` (share of each with a partner within a pulse width),
/// `online_minus_computed_ns`, `online_computed_distance_ns` (1.4826 times its median is a robust
/// standard deviation) and `online_over_computed_amplitude`.
///
/// Fields of each return: `time_of_flight_ns`, `range_m`, `amplitude_dn`, `width_ratio`,
/// `thickness_m` and `intensity`, each with its standard deviation, and `deviation_ratio` and
/// `flags`. `docs/reference/returns.md` defines them; `docs/explanation/method.md` describes the
/// method.
///
/// With `online_points = "only"` no waveform is decomposed. `calibrate` is then required only if
/// samples of outgoing pulses are recorded, because ranges count from them.
///
/// A block that was being recorded during the emission of another shot of the line may contain light
/// of that emission, which is fitted as a pulse. Returns within three widths of that time have flag
/// bit 3, the block's other returns bit 4. If an echo overlaps the outgoing pulse of a shot, all its
/// returns have bit 5. Their ranges count from a joint fit of pulse and echo, and their standard
/// deviations include its uncertainty; they are at least 0.255 m if no such fit explains the samples.
///
/// Counts `np np_xtalk np_xtalk_dropped np_filtered np_merged np_online nw_empty nw_saturated nw_refined1x nw_refined2x nw_truncated nw_deleted`.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Decompose {
    /// Thoroughness of the decomposition.
    pub mode: Mode,
    /// Refine waveforms with overlapping pulses (including weak ones dropped later) or a deviation
    /// ratio above 3. Only for `fastest` and `fast_separated`; the other modes refine all.
    pub refine_when_needed: bool,
    /// Detection threshold, in standard deviations of the noise after the matched filter.
    #[schemars(range(min = 2.0, max = 100.0))]
    pub detection_sigma: f64,
    /// Higher threshold for the last of two or more returns of a block, for receivers that ring after
    /// strong echoes. A last return below it is dropped, and the previous one becomes the last;
    /// `false`: same threshold.
    #[schemars(transform = at_least(2.0).at_most(1000.0))]
    pub detection_sigma_last: Threshold,
    /// Smallest and largest width of a return relative to the calibrated pulse. A return is dropped
    /// only if its width is outside the range by more than two standard deviations and it is less than
    /// four times above its threshold; stronger ones are kept with flag bit 14.
    #[schemars(transform = above(0.0).at_most(1e6))]
    pub width_ratio: [f64; 2],
    /// Timing error that the fit cannot estimate, such as clock and cables, ns. Added to the standard
    /// deviation of ranges.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub timing_error_ns: f64,
    /// Standard deviation of the emission time of shots without outgoing pulse or return location, ns:
    /// the jitter of the recording's clock relative to the emissions. Defaults to the bound that the
    /// reader derives from smooth points, at most that of a position within one sample, its interval
    /// over the square root of 12. Added to the standard deviation of ranges.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 1000.0))]
    pub emission_jitter_ns: Option<f64>,
    /// Decrease of chi-square required to replace a widened return by two; `false`: widened returns
    /// are not divided. At most 0.1 % of single returns are divided at 16, and 0.4 % at 11, where
    /// closer pairs are resolved. Without effect for Gaussian pulses.
    #[schemars(transform = at_least(4.0).at_most(1e6))]
    pub split_evidence: Threshold,
    /// Minimum relative error assumed for the system response. Residuals of strong returns up to this
    /// fraction of their amplitude are not returns. Raise it if strong returns are followed by false
    /// ones.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub template_error: f64,
    /// Drop returns that overlap leakage from the emission of another shot (flag bit 3).
    pub drop_emission_crosstalk: bool,
    /// Waveforms with relative heights: `true`: all, `false`: none, `"auto"`: those of large-footprint
    /// recordings (blocks of at least 400 ns) and those that pulses do not explain (deviation ratio
    /// above 5, not overdriven; not in the fast modes). Relative heights count from the last
    /// significant mode of the waveform, as in GEDI's level 2A product. `write_table` has them, the
    /// first and last mode, and the energy.
    pub distributed_targets: ProfilesKey,
    /// Use of the instrument's own returns: for shots without a recorded waveform, never, or instead
    /// of computed returns.
    pub online_points: OnlinePoints,
    #[serde(skip)]
    tables: SharedTables,
    #[serde(skip)]
    idle: IdleWorkers,
}

/// Thoroughness of the decomposition.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Mode {
    /// One step for each detected pulse, as if isolated; as accurate as `refined` for single returns.
    Fastest,
    /// One step for isolated returns; overlapping ones are fitted together.
    FastSeparated,
    /// All pulses fitted to the optimum, with residual search and split test.
    #[default]
    Refined,
    /// As `refined` with the plain kernels; every widened pulse is tried as two.
    Slow,
}

/// A number, or `false` for none.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum Threshold {
    /// The number.
    Number(f64),
    /// `false`.
    #[schemars(extend("const" = false))]
    Without(bool),
}

impl Threshold {
    /// Returns the number, if any.
    pub fn number(self) -> Option<f64> {
        match self {
            Threshold::Number(number) => Some(number),
            Threshold::Without(_) => None,
        }
    }
}

impl From<Option<f64>> for Threshold {
    fn from(number: Option<f64>) -> Threshold {
        number.map_or(Threshold::Without(false), Threshold::Number)
    }
}

impl Default for Decompose {
    fn default() -> Decompose {
        let kernels = DecomposeSettings::default();
        Decompose {
            mode: Mode::Refined,
            refine_when_needed: false,
            detection_sigma: kernels.detection_sigma,
            detection_sigma_last: kernels.detection_sigma_last.into(),
            width_ratio: kernels.width_ratio,
            timing_error_ns: 0.004,
            emission_jitter_ns: None,
            split_evidence: kernels.split_evidence.into(),
            template_error: kernels.template_error,
            drop_emission_crosstalk: false,
            distributed_targets: ProfilesKey::default(),
            online_points: OnlinePoints::default(),
            tables: SharedTables::default(),
            idle: IdleWorkers::default(),
        }
    }
}

impl Decompose {
    /// The same keys, with the tables of another stage, which do not depend on other keys than `mode`.
    pub fn sharing_tables(self, other: &Decompose) -> Decompose {
        Decompose { tables: other.tables.clone(), ..self }
    }

    /// Tables of a sensor for this stage.
    pub fn tables(&self, model: &Arc<SensorModel>) -> Arc<SensorTables> {
        self.tables.of(model, self.mode)
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
            low < 1.0 && 1.0 < high,
            "width_ratio",
            "it must be a range around 1, as in [0.8, 10.0]",
        )?;
        InvalidKey::unless(
            self.detection_sigma_last.number().is_none_or(|sigma| sigma >= self.detection_sigma),
            "detection_sigma_last",
            "it must be at least `detection_sigma`, or `false`",
        )
    }
}

impl MapConfig for Decompose {
    fn make(&self, run: &RunContext) -> Result<Box<dyn Map>> {
        Ok(Box::new(LineDecomposer { config: self.clone(), path: run.simd, worker: None }))
    }

    fn conclude(&self, cx: &mut Context) {
        unexplained::conclude(&self.tables, cx);
    }
}

/// One worker; its kernels are created when the first line brings the sensor model.
struct LineDecomposer {
    config: Decompose,
    path: SimdLevel,
    worker: Option<Worker>,
}

/// Kernels of a sensor, with tables shared by all workers.
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
        path: SimdLevel,
    ) -> Result<Worker> {
        let tables = config.tables.of(model, config.mode);
        let shots =
            ShotDecomposer::new(model, &tables, config, path)?.fusing(fusion.map(|fusion| &**fusion))?;
        Ok(Worker { model: Arc::clone(model), fusion: fusion.cloned(), _tables: tables, shots })
    }
}

/// Workers of finished inputs, kept for later inputs with the same model; clones share them.
#[derive(Clone, Default)]
struct IdleWorkers(Arc<Mutex<Vec<Worker>>>);

impl IdleWorkers {
    /// A worker for this model, if one is idle.
    fn take(&self, model: &Arc<SensorModel>, fusion: Option<&Arc<ChannelFusion>>) -> Option<Worker> {
        let mut idle = self.0.lock().unpoisoned();
        let place = idle.iter().position(|worker| worker.is_for(model, fusion))?;
        Some(idle.swap_remove(place))
    }

    /// Keeps a worker; drops those for other models.
    fn put(&self, worker: Worker) {
        let mut idle = self.0.lock().unpoisoned();
        idle.retain(|other| other.is_for(&worker.model, worker.fusion.as_ref()));
        idle.push(worker);
    }
}

impl std::fmt::Debug for IdleWorkers {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("IdleWorkers")
    }
}

impl Drop for LineDecomposer {
    fn drop(&mut self) {
        self.worker.take().into_iter().for_each(|worker| self.config.idle.put(worker));
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

impl Worker {
    /// Decomposes one shot of the last line again, with an observer.
    fn fit(&mut self, shot: &ShotBlocks, line: &DecomposedLine) -> Result<Option<FittedShot>> {
        let mut seen = Seen::new(shot.blocks);
        let (mut emissions, mut returns, mut profiles) =
            (line.emissions.to_vec(), Returns::new(), Vec::new());
        let mut of_shot = DecomposedShots {
            emissions: &mut emissions,
            returns: &mut returns,
            profiles: &mut profiles,
            stats: &mut LineStats::default(),
        };
        self.shots.decompose_again(shot, &mut of_shot, &mut Context::default(), &mut seen)?;
        let emission = emissions.get(shot.index as usize).copied();
        Ok(emission.map(|emission| {
            let blocks = seen.finish(&emission, &returns).0.into_iter().map(|block| block.shown).collect();
            FittedShot { emission, returns, blocks }
        }))
    }
}

impl Map for LineDecomposer {
    fn map(&mut self, mut scan_line: ScanLine, cx: &mut Context) -> Result<ScanLine> {
        check_whole_steps(&scan_line, "decompose")?;
        if scan_line.has_large_footprints() {
            self.config.tables.set_large_footprints();
        }
        let choice = self.config.online_points;
        let model = scan_line.model.clone();
        if model.is_none() && choice != OnlinePoints::Only {
            return Err(StageError::failed("the line has no sensor model", "put calibrate before decompose"));
        }
        let Content::Shots(blocks) =
            std::mem::replace(&mut scan_line.content, Content::Returns(Returns::new()))
        else {
            return Err(StageError::failed(
                "decompose received no waveforms",
                "put it before the stages that use returns",
            ));
        };
        let mut returns = Returns::new();
        match &model {
            Some(model) => self.decompose(model, &mut scan_line, &blocks, &mut returns, cx)?,
            None => online::date_without_model(&mut scan_line.emissions, &blocks)?,
        }
        if let Some(model) =
            model.as_ref().filter(|_| choice != OnlinePoints::Only && !blocks.online.is_empty())
        {
            online::compare(&blocks, &scan_line, &returns, model, cx);
        }
        online::add(choice, &mut scan_line, &blocks, &mut returns)?;
        scan_line.stats.np += returns.len() as u64;
        scan_line.content = Content::Returns(returns);
        if let Some(kept) = &mut scan_line.waveforms {
            *kept = blocks;
        }
        Ok(scan_line)
    }
}

impl LineDecomposer {
    /// Decomposes the blocks of a line.
    ///
    /// With `online_points = "only"`, only the outgoing pulses.
    fn decompose(
        &mut self,
        model: &Arc<SensorModel>,
        scan_line: &mut ScanLine,
        blocks: &Blocks,
        returns: &mut Returns,
        cx: &mut Context,
    ) -> Result<()> {
        let mut worker = match self.worker.take() {
            Some(worker) if worker.is_for(model, scan_line.fusion.as_ref()) => worker,
            _ => match self.config.idle.take(model, scan_line.fusion.as_ref()) {
                Some(worker) => worker,
                None => Worker::new(model, scan_line.fusion.as_ref(), &self.config, self.path)?,
            },
        };
        let shot = |(index, of_shot)| ShotBlocks { index, blocks, of_shot, input: &scan_line.input };
        let is_only = self.config.online_points == OnlinePoints::Only;
        let outgoing = if is_only { online::outgoing_only(blocks) } else { Vec::new() };
        let shots: Vec<ShotBlocks> = match is_only {
            true => outgoing
                .chunk_by(|a, b| a.emission == b.emission)
                .map(|of_shot| shot((of_shot[0].emission, of_shot)))
                .collect(),
            false => blocks.by_emission().map(shot).collect(),
        };
        let mut line = DecomposedShots {
            emissions: &mut scan_line.emissions,
            returns,
            profiles: &mut scan_line.profiles,
            stats: &mut scan_line.stats,
        };
        worker.shots.decompose(&shots, &mut line, cx, &mut ())?;
        if let Some(observer) = cx.observer() {
            let line = DecomposedLine { line: scan_line.line, emissions: &scan_line.emissions, returns };
            let of_emission = |index: u32| shots.iter().find(|shot| shot.index == index);
            let mut fit = |index| of_emission(index).map_or(Ok(None), |shot| worker.fit(shot, &line));
            observer.decomposed(&line, &mut fit)?;
        }
        self.worker = Some(worker);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_signal::noise::ArNoise;
    use wavex_signal::simulated::channel;

    #[test]
    fn idle_workers_are_for_the_model_of_the_last_one() {
        let model = |noise_sd_dn| {
            let low_power = channel(&ArNoise::new(&[], noise_sd_dn).unwrap(), 4.0, 5.0);
            Arc::new(SensorModel { low_power: Some(low_power), ..SensorModel::default() })
        };
        let (first, second) = (model(0.7), model(0.8));
        let config = Decompose::default();
        let worker =
            |model: &Arc<SensorModel>| Worker::new(model, None, &config, SimdLevel::Portable).unwrap();
        config.idle.put(worker(&first));
        assert!(config.idle.take(&second, None).is_none());
        assert!(config.idle.take(&first, None).is_some());
        assert!(config.idle.take(&first, None).is_none(), "it is at work");
        config.idle.put(worker(&first));
        config.idle.put(worker(&second));
        assert!(config.idle.take(&first, None).is_none(), "a new model replaces the old one");
        assert!(config.clone().idle.take(&second, None).is_some());
    }
}
