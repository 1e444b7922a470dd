//! The survey's page and `survey.json`: densities, gaps, and height differences of strips.
//!
//! Each strip is collected while its lines pass ([`StripCollector`]) and stored as a file of cells
//! ([`write_cells`]). The survey is a function of these files alone ([`write_survey`]), so a resumed
//! run or several runs have the survey of one undisturbed run.

use std::io::Write;
use std::path::{Path, PathBuf};

use schemars::JsonSchema;
use serde::Serialize;

use wavex_engine::job::SurveyKeys;
use wavex_formats::{Error, Result};
use wavex_line::stage::{OutputFile, SensorDrift};

mod cell;
mod cells_file;
mod grid;
mod inputs;
mod measures;
mod mosaic;
mod page;
mod rasters;
mod strip;
mod sweep;

pub use cells_file::write_cells;
pub use inputs::{StripPaths, ending_of_cells};
pub use measures::CellDensity;
pub use mosaic::{Gap, Gaps};
pub use strip::{CollectedStrip, StripCollector, StripFacts};

pub(crate) use mosaic::DIFFERENCES;
pub(crate) use rasters::description as raster_description;
pub(super) use strip::UNEXPLAINED;

use cells_file::CellsReader;
use measures::{Lengths, PairOffset, offsets};
use mosaic::Pictures;
use rasters::{RasterContent, RasterFrame, Rasters};
use sweep::{CellScale, Measures, StripMeasures};

/// An input of a survey.
#[derive(Clone, Debug, Default)]
pub struct SurveyInput {
    /// Stem.
    pub stem: String,
    /// Why it has no results.
    pub failure: Option<String>,
    /// File of its cells, if it was processed.
    pub cells: Option<PathBuf>,
    /// Its trajectory.
    pub trajectory: Option<StripTrajectory>,
    /// What its waveforms show about the sensor, if the strips share a sensor model.
    pub sensor: Option<SensorDrift>,
}

/// Trajectory of a strip.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct StripTrajectory {
    /// Path of the file.
    pub path: String,
    /// Median interval between records, s.
    pub median_step_s: f64,
    /// Number of gaps, including bridged ones.
    pub gaps: u64,
}

/// Results of a survey (`*_survey.json`).
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct Survey {
    /// Version.
    pub wavex: String,
    /// Cells and limits: the table `[job.survey]`.
    pub limits: SurveyKeys,
    /// Edge of a cell, m; larger than `cell_m` if a strip has too many cells of that size.
    pub cell_m: f64,
    /// Coordinate reference system as WKT.
    pub crs_wkt: Option<String>,
    /// Coordinates of the west, south, east and north edge of all cells.
    pub extent: Option<[f64; 4]>,
    /// Area of the cells with points, m².
    pub area_m2: f64,
    /// Area of the cells with points of two strips or more, m².
    pub overlap_m2: f64,
    /// Area of the cells below the required pulse density, m²; only with a target.
    pub below_target_m2: Option<f64>,
    /// Density of first returns, all strips together.
    pub pulses: Option<CellDensity>,
    /// Density of points, all strips together.
    pub points: Option<CellDensity>,
    /// Areas without points within the survey.
    pub gaps: Gaps,
    /// Height differences of all pairs of strips on smooth cells.
    pub differences: Option<HeightDifferences>,
    /// Histogram of the differences.
    pub difference_histogram: DifferenceHistogram,
    /// Roughness of the smooth cells of all strips.
    pub roughness: Option<Roughness>,
    /// Strips in the order of the inputs.
    pub strips: Vec<SurveyStrip>,
    /// Pairs of strips with smooth cells in common.
    pub pairs: Vec<StripPair>,
    /// Names of the written rasters.
    pub rasters: Vec<String>,
}

/// Height differences, later strip minus earlier one.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
#[schemars(rename = "Differences")]
pub struct HeightDifferences {
    /// Number of cells compared.
    pub cells: u64,
    /// Mean, m.
    pub mean_m: f64,
    /// Median, m.
    pub median_m: f64,
    /// Standard deviation of the mean by the noise of the points alone, m.
    pub mean_sd_m: f64,
    /// Root mean square, m.
    pub rms_m: f64,
    /// Root mean square that the noise of the points alone would cause, m.
    pub noise_rms_m: f64,
    /// Magnitude below which 95 % of the differences lie, m.
    pub magnitude_95_m: f64,
}

/// Histogram of height differences in bins of 1 mm.
#[derive(Clone, Debug, Default, PartialEq, Serialize, JsonSchema)]
pub struct DifferenceHistogram {
    /// Lower edge of the first bin, m; the outermost bins at ±2 m contain all beyond them.
    pub first_edge_m: f64,
    /// Number of cells in each bin.
    pub counts: Vec<u64>,
}

/// Roughness of smooth cells.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct Roughness {
    /// Number of smooth cells.
    pub cells: u64,
    /// Median standard deviation of the points from the plane of their cell, m.
    pub median_m: f64,
    /// Standard deviation below which 95 % of the cells are, m.
    pub high_m: f64,
    /// Range of heights less slope times diagonal of the cell: median, m.
    pub range_median_m: f64,
    /// The same for 95 % of the cells, m.
    pub range_high_m: f64,
}

/// A strip of a survey.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct SurveyStrip {
    /// Stem of the input.
    pub stem: String,
    /// Why it is not in the survey.
    pub failure: Option<String>,
    /// Facts collected while it was processed.
    pub facts: Option<StripFacts>,
    /// Area of its cells, m².
    pub area_m2: f64,
    /// Density of its first returns.
    pub pulses: Option<CellDensity>,
    /// Density of its points.
    pub points: Option<CellDensity>,
    /// Area of its cells below the required pulse density, m²; only with a target.
    pub below_target_m2: Option<f64>,
    /// Roughness of its smooth cells.
    pub roughness: Option<Roughness>,
    /// Height above the median strip that reproduces the differences of all pairs best, m.
    pub offset_m: Option<f64>,
    /// Its trajectory.
    pub trajectory: Option<StripTrajectory>,
    /// What its waveforms show about the sensor, if the strips share a sensor model.
    pub sensor: Option<SensorDrift>,
}

/// Two strips with smooth cells in common.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub struct StripPair {
    /// Stems of the earlier and the later strip.
    pub strips: [String; 2],
    /// Their differences.
    #[serde(flatten)]
    pub differences: HeightDifferences,
    /// Whether the RMS exceeds the limit.
    pub exceeds_limit: bool,
}

/// Files of a survey whose page has this path: JSON and rasters.
pub fn survey_files(page: &Path) -> Vec<PathBuf> {
    let stem = page.with_extension("");
    [page.with_extension("json")].into_iter().chain(rasters::paths(&stem)).collect()
}

/// A survey that has been written.
#[derive(Debug, Default)]
pub struct WrittenSurvey {
    /// Page, JSON and rasters.
    pub files: Vec<PathBuf>,
    /// Warnings about processed strips that cannot be compared with the others.
    pub not_compared: Vec<String>,
}

/// Writes the survey of these inputs: page, JSON and rasters.
///
/// # Errors
/// If cells cannot be read or a file cannot be written.
pub fn write_survey(inputs: &[SurveyInput], keys: &SurveyKeys, page: &Path) -> Result<WrittenSurvey> {
    let (survey, pictures) = survey(inputs, keys, Some(&page.with_extension("")))?;
    let json = page.with_extension("json");
    let defect = |error: serde_json::Error| {
        Error::unusable(&json, error.to_string(), "please report this bug in wavex")
    };
    let text = serde_json::to_string_pretty(&survey).map_err(defect)? + "\n";
    let html = page::page(&survey, pictures.as_ref());
    let mut files = vec![publish(page, &html)?, publish(&json, &text)?];
    let folder = page.parent().unwrap_or(Path::new(""));
    files.extend(survey.rasters.iter().map(|name| folder.join(name)));
    let not_compared = inputs.iter().zip(&survey.strips).filter(|(input, _)| input.failure.is_none());
    let not_compared = not_compared.filter_map(|(input, strip)| {
        let (_, reason) = input.cells.as_ref().zip(strip.failure.as_ref())?;
        Some(format!("{} is not on the page of the survey: {reason}", strip.stem))
    });
    Ok(WrittenSurvey { files, not_compared: not_compared.collect() })
}

/// Writes the pulse density of a strip as a raster.
///
/// Returns its path; `None` if the strip has no cells, or is too long for a raster.
///
/// # Errors
/// If the file cannot be written.
pub fn write_density(strip: &CollectedStrip, path: &Path) -> Result<Option<PathBuf>> {
    let Some(frame) = frame([&strip.facts]).filter(RasterFrame::is_possible) else { return Ok(None) };
    let area_m2 = (frame.cell * strip.facts.unit_m).powi(2);
    let mut rasters = Rasters::of_strip(frame, path)?;
    for cell in &strip.cells {
        rasters.begin_row(cell.row)?;
        rasters.set(RasterContent::Pulses, cell.row, cell.column, f64::from(cell.sums.pulses) / area_m2);
    }
    Ok(rasters.finish()?.pop())
}

fn publish(path: &Path, text: &str) -> Result<PathBuf> {
    let mut file = OutputFile::create(path)?;
    file.write_all(text.as_bytes()).map_err(Error::io(path, "write"))?;
    file.finish()?.publish()
}

/// Measures the inputs; `stem` is the path of the rasters to write.
fn survey(
    inputs: &[SurveyInput],
    keys: &SurveyKeys,
    stem: Option<&Path>,
) -> Result<(Survey, Option<Pictures>)> {
    let (mut strips, mut readers, mut places) = (Vec::new(), Vec::new(), Vec::new());
    for input in inputs {
        let mut strip = SurveyStrip::new(input);
        if let Some(path) = &input.cells {
            let reader = match CellsReader::open(path) {
                Ok(reader) => reader,
                Err(error) => {
                    strip.failure = Some(error.to_string());
                    strips.push(strip);
                    continue;
                }
            };
            strip.facts = Some(reader.facts.clone());
            let first: Option<&CellsReader> = readers.first();
            strip.failure = reader.facts.without_map.clone().or_else(|| mismatch(&reader, first));
            if strip.failure.is_none() && reader.facts.extent.is_some() {
                places.push(strips.len());
                readers.push(reader);
            }
        }
        strips.push(strip);
    }
    let mut survey = Survey::new(keys, strips);
    let Some(frame) = frame(readers.iter().map(|reader| &reader.facts)) else { return Ok((survey, None)) };
    let cell_m = readers.first().map_or(keys.cell_m, |reader| reader.facts.cell * reader.facts.unit_m);
    let scale = CellScale::new(keys, frame.level, cell_m);
    let stem = stem.filter(|_| frame.is_possible());
    let measures = sweep::sweep(&mut readers, &scale, &frame, stem)?;
    let pictures = survey.fill(&measures, &scale, &frame, &places);
    Ok((survey, Some(pictures)))
}

/// Reason why the cells of a strip and of the first strip cannot be compared.
fn mismatch(reader: &CellsReader, first: Option<&CellsReader>) -> Option<String> {
    let (own, first) = (&reader.facts, &first?.facts);
    if own.crs_wkt != first.crs_wkt {
        let stem = &first.stem;
        return Some(format!(
            "its coordinate reference system is not that of {stem}; name a missing one by `crs_of_input` of the reader, \
             set `crs` of `[job.geometry]` for recordings in the earth-centred or the scanner's frame, and give \
             recordings of different frames jobs of their own and their outputs to `wavex survey`"
        ));
    }
    (own.cell != first.cell)
        .then(|| format!("its cells are not those of {}; run it again with the same `cell_m`", first.stem))
}

/// Frame of all cells at the level of the coarsest strip.
fn frame<'f>(strips: impl IntoIterator<Item = &'f StripFacts>) -> Option<RasterFrame> {
    let strips: Vec<&StripFacts> = strips.into_iter().collect();
    let level = strips.iter().map(|facts| facts.level).max()?;
    let extents = strips.iter().filter_map(|facts| {
        let shift = level - facts.level;
        facts.extent.map(|extent| extent.map(|corner| corner.map(|at| at >> shift)))
    });
    let [low, high] = extents.reduce(|[low, high], [other_low, other_high]| {
        let both = |f: fn(i32, i32) -> i32, a: [i32; 2], b: [i32; 2]| [f(a[0], b[0]), f(a[1], b[1])];
        [both(i32::min, low, other_low), both(i32::max, high, other_high)]
    })?;
    let facts = strips.first()?;
    let size = |axis: usize| u32::try_from(i64::from(high[axis]) - i64::from(low[axis]) + 1).ok();
    Some(RasterFrame {
        west: low[0],
        north: high[1],
        columns: size(0)?,
        rows: size(1)?,
        level,
        cell: facts.cell * f64::from(level).exp2(),
        crs_wkt: facts.crs_wkt.clone(),
    })
}

impl SurveyStrip {
    fn new(input: &SurveyInput) -> SurveyStrip {
        let without_cells = || input.cells.is_none().then(|| "it has not been processed".to_owned());
        SurveyStrip {
            stem: input.stem.clone(),
            failure: input.failure.clone().or_else(without_cells),
            facts: None,
            area_m2: 0.0,
            pulses: None,
            points: None,
            below_target_m2: None,
            roughness: None,
            offset_m: None,
            trajectory: input.trajectory.clone(),
            sensor: input.sensor.clone(),
        }
    }

    fn fill(&mut self, measures: &StripMeasures, scale: &CellScale) {
        let area_m2 = scale.area_m2();
        self.area_m2 = measures.points.cells() as f64 * area_m2;
        self.pulses = Some(CellDensity::of(&measures.pulses, area_m2));
        self.points = Some(CellDensity::of(&measures.points, area_m2));
        let target = scale.keys.target_pulses_per_m2;
        self.below_target_m2 = target.map(|target| measures.pulses.below(target * area_m2) as f64 * area_m2);
        self.roughness = Roughness::of(&measures.roughness, &measures.precision);
    }
}

impl Survey {
    fn new(keys: &SurveyKeys, strips: Vec<SurveyStrip>) -> Survey {
        Survey {
            wavex: env!("CARGO_PKG_VERSION").to_owned(),
            limits: keys.clone(),
            cell_m: keys.cell_m,
            crs_wkt: None,
            extent: None,
            area_m2: 0.0,
            overlap_m2: 0.0,
            below_target_m2: None,
            pulses: None,
            points: None,
            gaps: Gaps::default(),
            differences: None,
            difference_histogram: DifferenceHistogram::default(),
            roughness: None,
            strips,
            pairs: Vec::new(),
            rasters: Vec::new(),
        }
    }

    /// Sets the results; `places` are the strips with cells.
    fn fill(
        &mut self,
        measures: &Measures,
        scale: &CellScale,
        frame: &RasterFrame,
        places: &[usize],
    ) -> Pictures {
        let area_m2 = scale.area_m2();
        for (place, of_strip) in places.iter().zip(&measures.strips) {
            self.strips[*place].fill(of_strip, scale);
        }
        let links = measures.pairs.iter().map(|((a, b), lengths)| PairOffset {
            strips: [*a, *b],
            difference_m: lengths.quantile(0.5),
            weight: lengths.count() as f64,
        });
        let heights = offsets(places.len(), &links.collect::<Vec<PairOffset>>());
        for (place, height) in places.iter().zip(heights) {
            self.strips[*place].offset_m = height;
        }
        let stem =
            |strip: usize| places.get(strip).map_or_else(String::new, |at| self.strips[*at].stem.clone());
        let limit_m = self.limits.max_difference_rms_m;
        let pair = |((a, b), lengths): (&(usize, usize), &Lengths)| {
            let differences = HeightDifferences::of(lengths)?;
            let exceeds_limit = differences.rms_m > limit_m;
            Some(StripPair { strips: [stem(*a), stem(*b)], differences, exceeds_limit })
        };
        self.pairs = measures.pairs.iter().filter_map(pair).collect();
        let mut all = Lengths::new();
        measures.pairs.values().for_each(|lengths| all.merge(lengths));
        self.differences = HeightDifferences::of(&all);
        let (first_edge_m, counts) = all.histogram();
        self.difference_histogram = DifferenceHistogram { first_edge_m, counts };
        let (mut roughness, mut precision) = (Lengths::new(), Lengths::new());
        for of_strip in &measures.strips {
            roughness.merge(&of_strip.roughness);
            precision.merge(&of_strip.precision);
        }
        self.roughness = Roughness::of(&roughness, &precision);
        let pulses = CellDensity::of(&measures.pulses, area_m2);
        let (gaps, mask) = measures.mosaic.gaps(self.limits.gap_width_m, pulses.median_per_m2);
        self.gaps = gaps;
        self.pulses = Some(pulses);
        self.points = Some(CellDensity::of(&measures.points, area_m2));
        let target = self.limits.target_pulses_per_m2;
        self.below_target_m2 = target.map(|target| measures.pulses.below(target * area_m2) as f64 * area_m2);
        self.cell_m = scale.edge_m;
        self.crs_wkt.clone_from(&frame.crs_wkt);
        let [west, north] = [f64::from(frame.west), f64::from(frame.north) + 1.0].map(|at| at * frame.cell);
        let [width, height] = [frame.columns, frame.rows].map(|cells| f64::from(cells) * frame.cell);
        self.extent = Some([west, north - height, west + width, north]);
        self.area_m2 = measures.points.cells() as f64 * area_m2;
        self.overlap_m2 = measures.overlap_cells as f64 * area_m2;
        let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        self.rasters = measures.rasters.iter().map(name).collect();
        measures.mosaic.pictures(&mask, &self.limits)
    }
}

impl HeightDifferences {
    /// `None` without values.
    fn of(lengths: &Lengths) -> Option<HeightDifferences> {
        let cells = lengths.count();
        (cells > 0).then(|| HeightDifferences {
            cells,
            mean_m: lengths.mean(),
            median_m: lengths.quantile(0.5),
            mean_sd_m: lengths.noise() / (cells as f64).sqrt(),
            rms_m: lengths.rms(),
            noise_rms_m: lengths.noise(),
            magnitude_95_m: lengths.magnitude(0.95),
        })
    }
}

impl Roughness {
    /// `None` without values.
    fn of(roughness: &Lengths, precision: &Lengths) -> Option<Roughness> {
        (roughness.count() > 0).then(|| Roughness {
            cells: roughness.count(),
            median_m: roughness.quantile(0.5),
            high_m: roughness.quantile(0.95),
            range_median_m: precision.quantile(0.5),
            range_high_m: precision.quantile(0.95),
        })
    }
}

#[cfg(test)]
mod tests;
