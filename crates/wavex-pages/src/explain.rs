//! One shot with its fit, as a table and as a picture, for `wavex explain` and `wavex view`.

use std::sync::Arc;

use wavex_simd::SimdLevel;

use wavex_line::scan_line::{Content, Emission, InputInfo, LineStats, Returns, ScanLine};
use wavex_line::stage::{Context, Reason, StageError, counted};
use wavex_signal::sensor_model::SensorModel;
use wavex_stages::process::decompose::{
    Decompose, DecomposedShots, Seen, SeenBlock, SeenPulse, ShotBlocks, ShotDecomposer,
};

mod footprint;
mod picture;
mod table;

pub use footprint::ExplainedFootprint;

/// A shot with its decomposition.
pub struct ExplainedShot {
    /// Path of the recording.
    pub(crate) file: String,
    /// The shot, with its fitted emission time.
    pub emission: Emission,
    /// Metadata of the recording.
    pub input: Arc<InputInfo>,
    /// Sorted by time.
    pub returns: Returns,
    /// Sorted by time.
    pub blocks: Vec<SeenBlock>,
    pub(crate) outgoing: Option<SeenPulse>,
    pub(crate) model: Arc<SensorModel>,
    /// Rejections and notes as text.
    pub(crate) remarks: Vec<String>,
}

/// Why a shot cannot be explained.
#[derive(Debug, thiserror::Error)]
pub enum ExplainError {
    /// The shot lacks something: problem and remedy.
    #[error("{0}")]
    Without(String),
    /// A stage failed.
    #[error(transparent)]
    Stage(#[from] StageError),
}

impl ExplainedShot {
    /// Decomposes one shot of a scan line that has passed the stages before `decompose`.
    ///
    /// `file` names the recording.
    pub fn of(
        line: &ScanLine,
        shot: u64,
        config: &Decompose,
        simd: SimdLevel,
        file: &str,
    ) -> Result<ExplainedShot, ExplainError> {
        let without =
            |what: &str| ExplainError::Without(format!("{file}: shot {shot} has {what}; choose another one"));
        let model = line.model.clone().ok_or_else(|| without("no sensor model"))?;
        let index = line.emissions.iter().position(|emission| emission.shot == shot);
        let index = index.ok_or_else(|| without("no position: it is outside of the trajectory"))?;
        let Content::Shots(blocks) = &line.content else {
            return Err(without("no samples"));
        };
        let of_shot = blocks.by_emission().find(|(emission, _)| *emission as usize == index);
        let echoes = of_shot.filter(|(_, of_shot)| of_shot.iter().any(|block| block.channel.is_echo()));
        let Some((index, of_shot)) = echoes else {
            return Err(without("no recorded echoes"));
        };
        let mut seen = Seen::new(blocks);
        let (mut returns, mut cx) = (Returns::new(), Context::default());
        let tables = config.tables(&model);
        let mut shots = ShotDecomposer::new(&model, &tables, config, simd)?.fusing(line.fusion.as_deref())?;
        let of_line = ShotBlocks { index, blocks, of_shot, input: &line.input };
        // The whole line is decomposed first: it defines the usual outgoing pulse.
        let shot_of = |(index, of_shot)| ShotBlocks { index, blocks, of_shot, input: &line.input };
        let all: Vec<ShotBlocks> = blocks.by_emission().map(shot_of).collect();
        let (mut emissions, mut stats) = (line.emissions.clone(), line.stats.clone());
        let mut profiles = Vec::new();
        let mut whole = DecomposedShots {
            emissions: &mut emissions,
            returns: &mut Returns::new(),
            profiles: &mut profiles,
            stats: &mut stats,
        };
        shots.decompose(&all, &mut whole, &mut Context::default(), &mut ())?;
        let mut emissions = line.emissions.clone();
        profiles.clear();
        let mut of_shot = LineStats::default();
        let mut into = DecomposedShots {
            emissions: &mut emissions,
            returns: &mut returns,
            profiles: &mut profiles,
            stats: &mut of_shot,
        };
        shots.decompose_again(&of_line, &mut into, &mut cx, &mut seen)?;
        let emission = emissions[index as usize];
        let (blocks, outgoing) = seen.finish(&emission, &returns);
        let mut remarks = remarks(&cx);
        // The observer sees blocks before the receivers are fused.
        remarks.extend([Reason::NotInLowPower, Reason::NotInHighPower].into_iter().filter_map(|reason| {
            let n = of_shot.filtered.of(reason);
            (n > 0).then(|| format!("filtered {}", counted(n, &format!("returns: {reason}"))))
        }));
        if !line.input.origin_is_sensor {
            remarks.push("ranges start at the first sample: the recording has no sensor position".into());
        }
        let (file, input) = (file.to_owned(), Arc::clone(&line.input));
        Ok(ExplainedShot { file, emission, input, returns, blocks, outgoing, model, remarks })
    }

    /// Returns and fit statistics as text.
    pub fn table(&self) -> String {
        table::table(self, None)
    }

    /// The same in lines of at most this many characters, if it is given.
    pub fn table_within(&self, columns: Option<usize>) -> String {
        table::table(self, columns)
    }

    /// Number and time of the shot, name of the recording, counts of returns and blocks.
    pub(crate) fn title(&self) -> String {
        let name = std::path::Path::new(&self.file).file_name();
        table::title(
            self,
            &name.map_or_else(|| self.file.clone(), |name| name.to_string_lossy().into_owned()),
        )
    }

    /// Samples, fit and residuals as SVG.
    pub fn picture(&self) -> String {
        picture::draw(self)
    }
}

/// Rejections and notes of a context as text.
fn remarks(cx: &Context) -> Vec<String> {
    let rejected = &cx.counters().rejected;
    let dropped = rejected
        .iter()
        .map(|((item, why), n)| format!("rejected {}", counted(*n, &format!("{}: {why}", item.name()))));
    dropped.chain(cx.counters().warnings()).collect()
}
