//! Alignment of clouds of points without trajectory: corrections of the positions of each strip.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use rayon::ThreadPoolBuilder;

use crate::Failure;
use estimate::{CloudAlignment, estimate};
use files::{Clouds, ReadSettings};
use wavex_align::adjust::AlignSettings;
use wavex_align::estimable::Verdict;
use wavex_align::matching::tile_m;
use wavex_align::parameters::{TrajectoryModel, TrajectoryPriors};
use wavex_engine::engine::Cancel;
use wavex_formats::las::{Point, write_shifted};
use wavex_line::stage::{FinishedFile, OutputFile};

use super::{REPORT_FILE, finished};

pub(crate) use files::{check_system, is_cloud, list};
pub(crate) use frame::system_of;

mod estimate;
mod files;
mod frame;
mod texts;

/// Name of the corrections of clouds that an alignment writes.
pub const CLOUD_CORRECTIONS_FILE: &str = "corrections.csv";
/// SD of the position of a strip, m, if none is given.
pub const POSITION_SD_M: f64 = 0.1;
/// Steps of coordinates above this round corrections noticeably, m.
const COARSE_STEP_M: f64 = 0.002;

/// Clouds to align.
#[derive(Clone, Debug)]
pub struct CloudsRequest<'a> {
    /// Files, folders, or patterns of files.
    pub inputs: &'a [PathBuf],
    /// Folder to write.
    pub output: &'a Path,
    /// Form of the corrections; not [`TrajectoryModel::None`].
    pub corrections: TrajectoryModel,
    /// SD of the positions of each strip, m; above 0.
    pub position_sd_m: f64,
    /// Whether the points of each source ID are a strip; so are those of a single file.
    pub by_source: bool,
    /// Whether to write the corrected clouds.
    pub apply: bool,
    /// Number of threads; 0: one per core.
    pub threads: usize,
    /// Ends the alignment early when set.
    pub cancel: Cancel,
}

/// Aligned clouds.
#[derive(Debug)]
pub struct AlignedClouds {
    /// Table for people: corrections, differences of the strips, verdict.
    pub text: String,
    /// Problems of strips that were left out or not aligned, and of a doubtful alignment.
    pub warnings: Vec<String>,
    /// Written files.
    pub written: Vec<PathBuf>,
    /// Why the alignment is bad; `None` if it is usable.
    pub failure: Option<Failure>,
}

/// Whether inputs of `wavex align` are clouds: files `.las` or `.laz`, patterns of them, or folders.
pub fn are_clouds(inputs: &[PathBuf]) -> bool {
    inputs.iter().all(|input| files::is_cloud(input) || input.is_dir())
}

/// Estimates corrections of the positions of each strip from the overlaps of clouds.
///
/// Writes [`REPORT_FILE`] and, unless the alignment is bad, [`CLOUD_CORRECTIONS_FILE`] and, if asked, the corrected clouds.
/// Files that cannot be used are left out.
///
/// # Errors
/// Fewer than two strips, strips that do not overlap, an output that would replace an input, files that cannot be written.
pub fn align_clouds(request: &CloudsRequest<'_>) -> Result<AlignedClouds, Failure> {
    let failed = |problem: String| Failure::Run(problem);
    if request.corrections == TrajectoryModel::None {
        return Err(Failure::Wrong(
            "`--trajectory none` leaves nothing to estimate for clouds; give constant, linear, or the distance of knots in \
             seconds"
                .into(),
        ));
    }
    let files = files::list(request.inputs)?;
    check_outputs(request, &files)?;
    let settings = AlignSettings {
        trajectory_model: request.corrections,
        // Positions alone do not follow a tilt, which is no matter of time.
        fits_time_errors: false,
        ..AlignSettings::default()
    };
    let pool = ThreadPoolBuilder::new().num_threads(request.threads).build();
    let pool =
        pool.map_err(|error| failed(format!("cannot start threads: {error}; set fewer `--threads`")))?;
    pool.install(|| {
        let read = ReadSettings {
            by_source: request.by_source,
            needs_time: request.corrections != TrajectoryModel::Constant,
            cell_m: settings.cell_m,
            cancel: &request.cancel,
        };
        let clouds = files::read(files, read)?;
        if clouds.strips.len() < 2 {
            return Err(too_few(&clouds));
        }
        let settings = AlignSettings { tile_m: tile_m(clouds.area_m2), ..settings };
        let found = estimate(&clouds, &settings, request.position_sd_m)?;
        finish(request, &clouds, &found)
    })
}

/// Error if fewer than two strips are usable.
fn too_few(clouds: &Clouds) -> Failure {
    let usable = match clouds.strips.first() {
        Some(only) => format!("only `{}` can be used", only.name),
        None => "no strip can be used".to_owned(),
    };
    let problems: String = clouds.failures.iter().map(|failed| format!("\n  {}", failed.problem)).collect();
    let remedy = match clouds.failures.is_empty() {
        true => "; give a file for each strip, or one whose points have the point source ID of their strip",
        false => "; correct the problems of the others:",
    };
    Failure::Run(format!("alignment needs two strips, but {usable}{remedy}{problems}"))
}

/// Path of a corrected cloud: the file's name in the folder, without `.copc`.
fn output_of(request: &CloudsRequest<'_>, file: &Path) -> PathBuf {
    let name = file.file_name().unwrap_or_default();
    let text = name.to_string_lossy();
    match text.to_ascii_lowercase().strip_suffix(".copc.laz").and_then(|stem| text.get(..stem.len())) {
        Some(stem) => request.output.join(format!("{stem}.laz")),
        None => request.output.join(name),
    }
}

/// Checks that no output replaces an input or another output.
fn check_outputs(request: &CloudsRequest<'_>, files: &[PathBuf]) -> Result<(), Failure> {
    let inputs: BTreeSet<PathBuf> = files.iter().filter_map(|file| file.canonicalize().ok()).collect();
    let mut seen = BTreeSet::new();
    for file in files.iter().filter(|_| request.apply) {
        let output = output_of(request, file);
        if output.canonicalize().is_ok_and(|output| inputs.contains(&output)) {
            let problem =
                format!("{}: the output would replace an input; write to another folder", output.display());
            return Err(Failure::Wrong(problem));
        }
        if !seen.insert(output.clone()) {
            let problem =
                format!("{}: two clouds would have this output; rename one of them", output.display());
            return Err(Failure::Wrong(problem));
        }
    }
    Ok(())
}

/// Writes the files and what a user should know.
fn finish(
    request: &CloudsRequest<'_>,
    clouds: &Clouds,
    found: &CloudAlignment,
) -> Result<AlignedClouds, Failure> {
    let is_bad = found.result.verdict == Verdict::Bad;
    let mut warnings: Vec<String> =
        clouds.failures.iter().map(|failed| format!("left out: {}", failed.problem)).collect();
    warnings.extend(clouds.notes.iter().cloned());
    warnings.extend(texts::unconnected(clouds, found));
    let [correlation_s, _] = TrajectoryPriors::default().correlation_s;
    warnings.extend(texts::implausible_drifts(clouds, found, (request.position_sd_m, correlation_s)));
    let mut finished_files = Vec::new();
    let corrections = request.output.join(CLOUD_CORRECTIONS_FILE);
    if !is_bad {
        finished_files.push(finished(&corrections, &texts::corrections(clouds, found))?);
        if request.apply {
            for (index, file) in clouds.files.iter().enumerate() {
                finished_files.extend(corrected(request, clouds, found, (index, file), &mut warnings)?);
            }
        }
    }
    let report = serde_json::to_string_pretty(&texts::report(request, clouds, found));
    let report = report.map_err(|error| Failure::Run(error.to_string()))?;
    // Corrections of an earlier alignment would look like those of this one.
    let stale = if is_bad { vec![corrections] } else { Vec::new() };
    finished_files.push(finished(&request.output.join(REPORT_FILE), &(report + "\n"))?.replacing(stale));
    let published = finished_files.into_iter().map(FinishedFile::publish);
    let written = published.collect::<Result<_, _>>().map_err(|error| Failure::Run(error.to_string()))?;
    let problem = texts::problem(&found.result);
    let failure = match is_bad {
        true => problem.map(Failure::Run),
        false => {
            warnings.extend(problem);
            None
        }
    };
    Ok(AlignedClouds { text: texts::summary(clouds, found), warnings, written, failure })
}

/// Corrected cloud of a file; `None` if none of its strips is aligned.
fn corrected(
    request: &CloudsRequest<'_>,
    clouds: &Clouds,
    found: &CloudAlignment,
    (index, file): (usize, &PathBuf),
    warnings: &mut Vec<String>,
) -> Result<Option<FinishedFile>, Failure> {
    let failed = |error: wavex_formats::Error| Failure::Run(error.to_string());
    let strips: Vec<_> =
        clouds.strips.iter().zip(&found.result.strips).filter(|(strip, _)| strip.file == index).collect();
    if strips.iter().all(|(_, result)| result.n_pairs == 0) {
        return Ok(None);
    }
    let shift = |point: &Point| {
        let strip =
            strips.iter().find(|(strip, _)| strip.source_id.is_none_or(|id| id == point.point_source_id));
        let corrections = strip.filter(|(_, result)| result.n_pairs > 0);
        let Some((strip, result)) = corrections else { return [0.0; 3] };
        let middle_s = strip.span_s.map_or(0.0, |[first_s, last_s]| 0.5 * (first_s + last_s));
        let has_time = strip.span_s.is_some() && point.gps_time.is_finite();
        let time_s = if has_time { point.gps_time } else { middle_s };
        let offset =
            result.corrections.as_ref().map(|corrections| corrections.at(time_s)).unwrap_or_default();
        clouds.frame.shift(offset.north_east_down_m)
    };
    let path = output_of(request, file);
    let mut output = OutputFile::create(&path).map_err(failed)?;
    let copy = write_shifted(file, &mut output, &path, shift).map_err(failed)?;
    let mut note = |text: String| warnings.push(format!("{}: {text}", path.display()));
    if copy.was_copc {
        note("written as LAZ without the octree of COPC; convert it again for viewers".into());
    }
    if copy.lost_index {
        note("written without the spatial index of the input (LAX); index it again".into());
    }
    let waveforms = ["wdp", "WDP", "wdz"].map(|extension| file.with_extension(extension));
    if let Some(waveforms) = waveforms.iter().find(|path| copy.has_waveform_file && path.exists()) {
        note(format!("its waveforms are in {}; copy this file next to it", waveforms.display()));
    }
    let [plane_m, height_m] = clouds.frame.units_m;
    let steps_m = [copy.scale[0] * plane_m, copy.scale[1] * plane_m, copy.scale[2] * height_m];
    let step_m = steps_m.into_iter().map(f64::abs).fold(0.0, f64::max);
    if step_m > COARSE_STEP_M {
        note(format!("corrections are rounded to the steps of its coordinates, {step_m} m"));
    }
    output.finish().map(Some).map_err(failed)
}
