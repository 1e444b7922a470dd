//! `write_patches`: writes the smooth surface of a strip for `wavex align`.

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_align::patch::PatchSettings;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{Kind, ScanLine};
use wavex_line::stage::{
    Config, Context, OutputFile, Result, RunContext, Sink, SinkConfig, StageError, StageSpec,
};

mod file;
mod maker;

pub use file::{PatchesFile, StripName, read_patches, read_strip_name};
pub use maker::{StripMaker, StripPatches};

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::sink::<WritePatches>("write_patches", &[Kind::Points]);

/// End of the names of the files.
pub const ENDING: &str = "_patches.arrow";

/// Writes patches of smooth surface (ground, roofs), from which `wavex align --patches` aligns a survey.
///
/// With these files, an alignment takes seconds instead of a run over all recordings. The strips of a survey may be
/// written by separate runs, such as the tasks of a cluster: cells have places on the earth that no survey changes.
/// `docs/explanation/alignment.md` describes the patches.
///
/// Needs a recording with beams in the frame of the scanner, and a `trajectory`. The file is an Arrow IPC file with
/// one row per patch, at most 60 000, in the order in which a limit keeps them (any first rows are spread over places, slopes
/// and aspects): three beams that end on a plane, as `time_s`, direction `x`, `y`, `z` and
/// `range_m` in the frame of the scanner without calibration, each with `_1`, `_2`, `_3`; `sd_m`, `slope_sd`,
/// `roughness_m`, `n_returns`, and whether ranges are on the scale of the low-power receiver (`low_power`). Its
/// metadata have the version (`wavex.patches`) and the strip (`wavex.strip`): name, times, counts, calibration,
/// mount, and the digest of the trajectory. `wavex align` leaves out strips whose calibration, mount or trajectory is not
/// that of its job.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WritePatches {
    /// Output file, ending in `_patches.arrow`; `*` is the input's stem.
    pub path: String,
}

impl Default for WritePatches {
    fn default() -> WritePatches {
        WritePatches { path: format!("*{ENDING}") }
    }
}

impl Config for WritePatches {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        let problem = "it must end in _patches.arrow, such as \"align/*_patches.arrow\"";
        InvalidKey::unless(self.path.ends_with(ENDING), "path", problem)
    }
}

impl SinkConfig for WritePatches {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        let maker = StripMaker::new(run.geometry.clone(), PatchSettings::default());
        let file = run.create(&self.path)?;
        Ok(Box::new(PatchWriter { file, maker, stem: run.stem.clone(), recording: run.input.clone() }))
    }
}

struct PatchWriter {
    file: OutputFile,
    maker: StripMaker,
    stem: String,
    recording: PathBuf,
}

impl Sink for PatchWriter {
    fn write(&mut self, line: &ScanLine, _: &mut Context) -> Result<()> {
        self.maker.add(line)
    }

    fn finish(self: Box<Self>, cx: &mut Context) -> Result<()> {
        let PatchWriter { mut file, maker, stem, recording } = *self;
        let strip = maker.finish().ok_or_else(|| {
            StageError::failed("no shot has a pose: there are no patches", "check the trajectory")
        })?;
        PatchesFile::new(stem, &recording, strip).write(&mut file)?;
        cx.publish(file.finish()?);
        Ok(())
    }
}
