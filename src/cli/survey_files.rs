//! Files of a survey: cells of each strip, and the survey's page.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::job::JobSettings;
use crate::report::survey::{
    Strip, StripCollector, StripTrajectory, SurveyInput, survey_files, write_cells, write_density,
    write_survey,
};
use crate::report::{Overview, Overviews};
use crate::scan_line::ScanLine;
use crate::stage::{DecomposedLine, FitShot, OutputFile, Result, RunObserver};

/// Name of the cells of a strip; `*` is the stem of the input.
const CELLS: &str = "*_cells.arrow";
/// Name of the pulse density of a strip.
const DENSITY: &str = "*_pulse_density.tif";

/// End of the names of cells.
pub(super) fn ending_of_cells() -> &'static str {
    CELLS.trim_start_matches('*')
}

/// Input of a survey from its entry of a report.
pub(super) fn input_of(entry: &Value, cells: Option<PathBuf>) -> SurveyInput {
    let trajectory = &entry["trajectory"];
    SurveyInput {
        stem: entry["stem"].as_str().unwrap_or_default().to_owned(),
        failure: entry["failure"].as_str().map(str::to_owned),
        cells,
        trajectory: trajectory["path"].as_str().map(|path| StripTrajectory {
            path: path.to_owned(),
            median_step_s: trajectory["median_step_s"].as_f64().unwrap_or(0.0),
            gaps: trajectory["gaps"].as_u64().unwrap_or(0),
        }),
    }
}

/// Collects the data of the pages that a job requests.
#[derive(Debug)]
pub(super) struct Collected {
    overviews: Option<Overviews>,
    cells: Option<StripCollector>,
}

impl Collected {
    /// `None` if the job requests no page.
    pub(super) fn new(settings: &JobSettings) -> Option<Collected> {
        let overviews = (!settings.report_page.is_empty()).then(Overviews::default);
        let cells = (!settings.survey_page.is_empty()).then(|| StripCollector::new(settings.survey.cell_m));
        (overviews.is_some() || cells.is_some()).then_some(Collected { overviews, cells })
    }

    /// Takes the overview of the current input.
    pub(super) fn overview(&self) -> Option<Overview> {
        self.overviews.as_ref()?.take()
    }

    /// Takes the strip of the current input.
    pub(super) fn strip(&self, stem: &str) -> Option<Strip> {
        Some(self.cells.as_ref()?.take(stem))
    }
}

impl RunObserver for Collected {
    fn begin_input(&self) {
        if let Some(overviews) = &self.overviews {
            overviews.begin_input();
        }
        if let Some(cells) = &self.cells {
            cells.take("");
        }
    }

    fn line(&self, line: &ScanLine) {
        if let Some(overviews) = &self.overviews {
            overviews.line(line);
        }
        if let Some(cells) = &self.cells {
            cells.add(line);
        }
    }

    fn decomposed(&self, line: &DecomposedLine, fit: &mut FitShot) -> Result<()> {
        self.overviews.as_ref().map_or(Ok(()), |overviews| overviews.decomposed(line, fit))
    }
}

/// Files of a survey in an output folder.
#[derive(Debug)]
pub(super) struct SurveyFiles {
    output_dir: PathBuf,
    /// Written files, apart from those of strips.
    written: Vec<PathBuf>,
}

impl SurveyFiles {
    /// `None` if the job requests no page of a survey.
    pub(super) fn new(settings: &JobSettings, output_dir: &Path) -> Option<SurveyFiles> {
        let files = SurveyFiles { output_dir: output_dir.to_owned(), written: Vec::new() };
        (!settings.survey_page.is_empty()).then_some(files)
    }

    /// All files of a survey whose page has this path.
    pub(super) fn of_page(page: &Path) -> Vec<PathBuf> {
        [page.to_owned()].into_iter().chain(survey_files(page)).collect()
    }

    /// Cells of the input with this stem.
    fn cells(&self, stem: &str) -> PathBuf {
        self.output_dir.join(CELLS.replace('*', stem))
    }

    /// Files of the input with this stem.
    pub(super) fn of_input(&self, stem: &str) -> [PathBuf; 2] {
        [self.cells(stem), self.output_dir.join(DENSITY.replace('*', stem))]
    }

    /// Files written by [`SurveyFiles::write`].
    pub(super) fn written(&self) -> &[PathBuf] {
        &self.written
    }

    /// Writes the cells of a strip and the raster of its pulse density; returns their paths.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub(super) fn write_strip(&self, strip: &Strip) -> Result<Vec<PathBuf>> {
        let [cells, density] = self.of_input(&strip.facts.stem);
        let mut written = vec![write_cells(strip, OutputFile::create(&cells)?)?];
        written.extend(write_density(strip, &density)?);
        Ok(written)
    }

    /// Writes the survey of the inputs with these entries of the report.
    ///
    /// # Errors
    /// If the cells of a strip cannot be read, or a file cannot be written.
    pub(super) fn write(&mut self, settings: &JobSettings, entries: &[Value], page: &Path) -> Result<()> {
        let input = |entry: &Value| {
            let is_done = matches!(entry["status"].as_str(), Some("done" | "skipped"));
            let stem = entry["stem"].as_str().filter(|_| is_done);
            input_of(entry, stem.map(|stem| self.cells(stem)))
        };
        let inputs: Vec<SurveyInput> = entries.iter().map(input).collect();
        self.written = write_survey(&inputs, &settings.survey, page)?;
        Ok(())
    }
}
