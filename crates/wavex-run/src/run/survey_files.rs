//! Files of a survey: cells of each strip, and the survey's page.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard};

use wavex_engine::job::JobSettings;
use wavex_geodesy::time_axis::Alignment;
use wavex_geodesy::trajectory::Trajectory;
use wavex_line::scan_line::ScanLine;
use wavex_line::stage::{
    DecomposedLine, FitShot, OutputFile, Result, RunObserver, RunObservers, SurveyModels,
};
use wavex_line::system::Unpoisoned as _;
use wavex_pages::report::survey::{
    CollectedStrip, StripCollector, StripPaths, survey_files, write_cells, write_density, write_survey,
};
use wavex_pages::report::{InputEntry, Overview, Overviews};

/// Collects the data of the pages that a job requests.
#[derive(Debug)]
pub(super) struct PageCollector {
    overviews: Option<Overviews>,
    /// Cell size of the strips, m, if the job requests their cells.
    cell_m: Option<f64>,
    strips: Mutex<BTreeMap<String, Arc<StripCollector>>>,
}

impl PageCollector {
    /// `None` if the job requests no page.
    pub(super) fn new(settings: &JobSettings) -> Option<PageCollector> {
        let overviews = (!settings.report_page.is_empty()).then(Overviews::default);
        let cell_m = settings.cells().map(|_| settings.survey.cell_m);
        let strips = Mutex::default();
        (overviews.is_some() || cell_m.is_some()).then_some(PageCollector { overviews, cell_m, strips })
    }

    /// Takes the overview of an input that has ended.
    pub(super) fn overview(&self, stem: &str) -> Option<Overview> {
        self.overviews.as_ref()?.take(stem)
    }

    /// Takes the strip of an input that has ended.
    pub(super) fn strip(&self, stem: &str) -> Option<CollectedStrip> {
        let strip = self.strips().remove(stem)?;
        Some(strip.take(stem))
    }

    fn strips(&self) -> MutexGuard<'_, BTreeMap<String, Arc<StripCollector>>> {
        self.strips.lock().unpoisoned()
    }
}

impl RunObservers for PageCollector {
    fn of_input(&self, stem: &str) -> Arc<dyn RunObserver> {
        let overview = self.overviews.as_ref().map(|overviews| overviews.of_input(stem));
        let strip = self.cell_m.map(|cell_m| Arc::new(StripCollector::new(cell_m)));
        if let Some(strip) = &strip {
            self.strips().insert(stem.to_owned(), Arc::clone(strip));
        }
        Arc::new(OfInput { overview, strip })
    }
}

/// Collects the data of one input.
#[derive(Debug)]
struct OfInput {
    overview: Option<Arc<dyn RunObserver>>,
    strip: Option<Arc<StripCollector>>,
}

impl RunObserver for OfInput {
    fn line(&self, line: &ScanLine) {
        if let Some(overview) = &self.overview {
            overview.line(line);
        }
        if let Some(strip) = &self.strip {
            strip.add(line);
        }
    }

    fn trajectory(&self, trajectory: &Trajectory, alignment: &Alignment) {
        if let Some(overview) = &self.overview {
            overview.trajectory(trajectory, alignment);
        }
    }

    fn decomposed(&self, line: &DecomposedLine, fit: &mut FitShot) -> Result<()> {
        self.overview.as_ref().map_or(Ok(()), |overview| overview.decomposed(line, fit))
    }
}

/// Files of a survey.
#[derive(Debug)]
pub(super) struct SurveyFiles {
    strips: StripPaths,
    /// Written files, apart from the files of strips.
    written: Vec<PathBuf>,
}

impl SurveyFiles {
    /// `None` if the job requests none.
    pub(super) fn new(settings: &JobSettings, output_dir: &Path) -> Option<SurveyFiles> {
        Some(SurveyFiles { strips: StripPaths::new(settings, output_dir)?, written: Vec::new() })
    }

    /// All files of a survey whose page has this path.
    pub(super) fn of_page(page: &Path) -> Vec<PathBuf> {
        [page.to_owned()].into_iter().chain(survey_files(page)).collect()
    }

    /// Files of the input with this stem.
    pub(super) fn of_input(&self, stem: &str) -> [PathBuf; 2] {
        [self.strips.cells(stem), self.strips.density(stem)]
    }

    /// Files written by [`SurveyFiles::write`].
    pub(super) fn written(&self) -> &[PathBuf] {
        &self.written
    }

    /// Writes the cells of a strip and the raster of its pulse density; returns their paths.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub(super) fn write_strip(&self, strip: &CollectedStrip) -> Result<Vec<PathBuf>> {
        let [cells, density] = self.of_input(&strip.facts.stem);
        let mut written = vec![write_cells(strip, OutputFile::create(&cells)?)?];
        written.extend(write_density(strip, &density)?);
        Ok(written)
    }

    /// Writes the survey of the inputs with these entries of the report, and its sensor models; returns the strips
    /// that cannot be compared with the others, with the reason.
    ///
    /// # Errors
    /// If the cells of a strip cannot be read, or a file cannot be written.
    pub(super) fn write(
        &mut self,
        settings: &JobSettings,
        entries: &[InputEntry],
        models: Option<&SurveyModels>,
        page: &Path,
    ) -> Result<Vec<String>> {
        let models = models.and_then(|models| serde_json::to_value(models).ok()).unwrap_or_default();
        let written = write_survey(&self.strips.inputs(entries, &models), &settings.survey, page)?;
        self.written = written.files;
        Ok(written.not_compared)
    }
}
