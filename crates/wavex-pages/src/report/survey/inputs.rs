//! Inputs of a survey: the files of each strip, and its facts in reports.

use std::path::{Path, PathBuf};

use serde_json::Value;

use super::{StripTrajectory, SurveyInput};
use crate::report::InputEntry;
use wavex_engine::job::{CELLS, JobSettings};

/// End of the names of cells.
pub fn ending_of_cells() -> &'static str {
    CELLS.trim_start_matches('*')
}

/// Paths of the files of each strip.
#[derive(Clone, Debug)]
pub struct StripPaths {
    /// Path of the cells; `*` is the stem of the input.
    cells: String,
    output_dir: PathBuf,
}

impl StripPaths {
    /// `None` if the job requests no cells.
    pub fn new(settings: &JobSettings, output_dir: &Path) -> Option<StripPaths> {
        let cells = settings.cells()?.to_owned();
        Some(StripPaths { cells, output_dir: output_dir.to_owned() })
    }

    /// Cells of the input with this stem.
    pub fn cells(&self, stem: &str) -> PathBuf {
        self.output_dir.join(self.cells.replace('*', stem))
    }

    /// Raster of the pulse density of the input with this stem.
    pub fn density(&self, stem: &str) -> PathBuf {
        self.cells(stem).with_file_name(format!("{stem}_pulse_density.tif"))
    }

    /// Inputs of the survey from all entries of a report and its sensor models.
    pub fn inputs(&self, entries: &[InputEntry], models: &Value) -> Vec<SurveyInput> {
        let input = |entry: &InputEntry| {
            let entry = &entry.without_model().unwrap_or_default();
            let is_done = matches!(entry["status"].as_str(), Some("done" | "skipped"));
            let mut input = SurveyInput::of_entry(entry, models);
            input.cells = is_done.then(|| self.cells(&input.stem));
            input
        };
        entries.iter().map(input).collect()
    }
}

impl SurveyInput {
    /// Input from its entry of a report and the report's sensor models, without cells.
    pub fn of_entry(entry: &Value, models: &Value) -> SurveyInput {
        let mut rows = models["inputs"].as_array().into_iter().flatten();
        let sensor = rows.find(|row| row["stem"] == entry["stem"]).cloned();
        let trajectory = &entry["trajectory"];
        SurveyInput {
            stem: entry["stem"].as_str().unwrap_or_default().to_owned(),
            failure: entry["failure"].as_str().map(str::to_owned),
            cells: None,
            trajectory: trajectory["path"].as_str().map(|path| StripTrajectory {
                path: path.to_owned(),
                median_step_s: trajectory["median_step_s"].as_f64().unwrap_or(0.0),
                gaps: trajectory["gaps"].as_u64().unwrap_or(0),
            }),
            sensor: sensor.and_then(|row| serde_json::from_value(row).ok()),
        }
    }
}
