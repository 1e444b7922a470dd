//! `read_returns`: reads decomposed scan lines.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::reading::plausible;
use crate::returns_file::ReturnsReader;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{Kind, ScanLine};
use wavex_line::stage::{self, Context, Paths, Result, RunContext, Source, SourceConfig, StageSpec};

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::source::<ReadReturns>("read_returns", Kind::Returns);

/// Reads decomposed scan lines, as `write_returns` writes them.
///
/// Takes the place of the reader and of all stages up to `write_returns`. `wavex run JOB --from-returns` makes this
/// change of a job, and compares the files with the job before: this stage alone reads any file.
///
/// Lines have the beams of the recording, to which trajectory, mount and calibration of `[job.geometry]` apply. Outputs
/// have the names that they have without this stage: `_decomposed` at the end of a name is left out.
///
/// A damaged file, one of another version, and impossible values are errors that name record batch and row. A shot
/// for which the trajectory has a pose only now, or none any more, is an error too: its waveform was, or was not, decomposed.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReadReturns {
    /// The returns files: a file, a pattern, or a list of them. The job runs once for each.
    pub path: Paths,
}

impl stage::Config for ReadReturns {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        self.path.check()
    }
}

impl SourceConfig for ReadReturns {
    fn paths(&self) -> Option<&Paths> {
        Some(&self.path)
    }

    fn stem_suffix(&self) -> &'static str {
        "_decomposed"
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Source>> {
        let reader = ReturnsReader::open(&run.input, &run.stem)?;
        if let Some(input) = reader.input() {
            let remedy = "write the file again: run the job with `write_returns`";
            plausible::check_velocity(
                input.group_velocity_mps,
                "the group velocity in `wavex.input`",
                remedy,
            )?;
            plausible::check_interval(input.sampling_interval_ns, remedy)?;
        }
        Ok(Box::new(ReturnsSource { reader, lines: Vec::new().into_iter() }))
    }
}

struct ReturnsSource {
    reader: ReturnsReader,
    /// Lines of the current record batch.
    lines: std::vec::IntoIter<ScanLine>,
}

impl Source for ReturnsSource {
    fn next(&mut self, _cx: &mut Context) -> Result<Option<ScanLine>> {
        loop {
            if let Some(line) = self.lines.next() {
                return Ok(Some(line));
            }
            match self.reader.next_lines()? {
                Some(lines) => self.lines = lines.into_iter(),
                None => return Ok(None),
            }
        }
    }

    fn progress(&self) -> Option<f64> {
        self.reader.progress()
    }
}
