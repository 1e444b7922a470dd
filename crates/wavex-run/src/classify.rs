//! Ground classification of clouds of points: files, tiles, results.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};

use rayon::ThreadPoolBuilder;
use rayon::prelude::*;
use wavex_engine::engine::{Cancel, Phase, ProgressMode};
use wavex_formats::las::ClassifiedCopy;
use wavex_ground::point::CloudPoint;
use wavex_ground::terrain::PointSds;
use wavex_line::stage::{FinishedFile, OutputLock, Outputs};

use crate::Failure;
use crate::align::clouds::{is_cloud, list};
use files::{ClassCounts, Cloud, LeftAlone, WriteFailure};
use tiles::{Ground, Tiles};

mod files;
mod report;
mod terrain;
mod text;
mod tiles;

pub use report::{ClassifiedCloud, ClassifyReport, PointsLeftAlone};
pub use terrain::{TerrainRequest, WrittenTerrain, write_terrain};
pub use wavex_ground::filter::GroundSettings;
pub use wavex_stages::terrain::Square;

const INTERRUPTED: &str = "interrupted";

/// Clouds to classify.
#[derive(Clone, Debug)]
pub struct ClassifyRequest<'a> {
    /// Files, folders, or patterns of files.
    pub inputs: &'a [PathBuf],
    /// File to write for one file, or folder.
    pub output: &'a Path,
    /// Classes of points that stay as they are.
    pub kept_classes: &'a [u8],
    /// Settings of the ground classification.
    pub settings: GroundSettings,
    /// Edge of the cells of a surface model, m, if one is written later.
    pub surface_cell_m: Option<f64>,
    /// Memory for the points of tiles that are classified at once, MB; one tile at least.
    pub memory_mb: u64,
    /// Number of threads; 0: one per core.
    pub threads: usize,
    /// Report to write (JSON).
    pub report: Option<&'a Path>,
    /// Progress on standard error.
    pub progress: ProgressMode,
    /// Ends the classification early when set.
    pub cancel: Cancel,
}

/// Classified clouds.
pub struct ClassifiedClouds {
    /// Table for people: points of each class before and after.
    pub text: String,
    /// What a user should know.
    pub warnings: Vec<String>,
    /// Written files.
    pub written: Vec<PathBuf>,
    /// Clouds that could not be classified; `None` if all are.
    pub failure: Option<Failure>,
    /// Ground points of all clouds.
    pub ground: GroundTiles,
}

/// Ground points of classified clouds, in temporary files that end with this.
pub struct GroundTiles {
    ground: Ground,
    sds: PointSds,
    /// Coordinate reference system of the clouds; `None` if no file has one.
    pub wkt: Option<String>,
    /// Lengths of the units of x and y, and of z in this system, m.
    pub units_m: [f64; 2],
}

impl GroundTiles {
    /// Squares of [`SQUARE_M`](wavex_stages::terrain::SQUARE_M) with ground points, in ascending order.
    pub fn squares(&self) -> Vec<Square> {
        self.ground.points.squares()
    }

    /// Ground points from `low` to `high`, m.
    ///
    /// Positions are coordinates of the clouds times [`GroundTiles::units_m`]. The strip of a point is its point source ID. The
    /// order does not depend on threads or on the order of the files.
    ///
    /// # Errors
    /// The temporary file cannot be read.
    pub fn points(&self, low: [f64; 2], high: [f64; 2]) -> Result<Vec<CloudPoint>, Failure> {
        self.ground.points.within(low, high).map_err(|error| Failure::Run(no_room(&error)))
    }
}

/// Points of a cloud by class.
struct CloudResult {
    before: ClassCounts,
    after: ClassCounts,
    left: LeftAlone,
    copy: ClassifiedCopy,
}

/// Classifies clouds of points of any LAS format, and writes copies with other classes.
///
/// All clouds share the ground. The result depends neither on their order nor on threads. Clouds that cannot be used are left
/// out and named in [`ClassifiedClouds::failure`].
///
/// # Errors
/// No cloud can be used, an output would replace an input, outputs or temporary files cannot be written, an interruption.
pub fn classify_clouds(request: &ClassifyRequest<'_>) -> Result<ClassifiedClouds, Failure> {
    let files = list(request.inputs)?;
    let outputs = outputs(request, &files)?;
    let pool = ThreadPoolBuilder::new().num_threads(request.threads).build();
    let pool =
        pool.map_err(|error| Failure::Run(format!("cannot start threads: {error}; set fewer `--threads`")))?;
    pool.install(|| classify(request, files.into_iter().zip(outputs).collect()))
}

/// Outputs of files.
fn outputs(request: &ClassifyRequest<'_>, files: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let wrong = |path: &Path, problem: &str| Err(Failure::Wrong(format!("{}: {problem}", path.display())));
    if let Some(file) = files.iter().find(|file| !is_cloud(file)) {
        return wrong(file, "it is no .las or .laz file; give a cloud of points");
    }
    let is_one = matches!(request.inputs, [input] if files == std::slice::from_ref(input));
    let mut outputs = Vec::new();
    if is_cloud(request.output) && !request.output.is_dir() {
        let [file] = files else {
            return wrong(
                request.output,
                "the output of several clouds is a folder; give one without .las or .laz",
            );
        };
        if !is_one {
            return wrong(
                request.output,
                "the output of a folder or pattern is a folder; give one without .las or .laz",
            );
        }
        let extension = |path: &Path| path.extension().unwrap_or_default().to_ascii_lowercase();
        if extension(file) != extension(request.output) {
            return wrong(
                request.output,
                "the copy is compressed as its input is; give it the extension of the input",
            );
        }
        outputs.push(request.output.to_path_buf());
    } else {
        outputs.extend(files.iter().map(|file| request.output.join(file.file_name().unwrap_or_default())));
    }
    let inputs: BTreeSet<PathBuf> = files.iter().filter_map(|file| file.canonicalize().ok()).collect();
    let mut seen = BTreeSet::new();
    for output in outputs.iter().map(PathBuf::as_path).chain(request.report) {
        if output.canonicalize().is_ok_and(|output| inputs.contains(&output)) {
            return wrong(output, "the output would replace an input; write to another folder");
        }
        if !seen.insert(output) {
            return wrong(output, "two outputs would have this name; rename one of the clouds");
        }
    }
    Ok(outputs)
}

/// Problem with a temporary file, and remedy.
fn no_room(error: &io::Error) -> String {
    format!("cannot use a temporary file next to the outputs: {error}; free disk space")
}

fn check_interruption(cancel: &Cancel) -> Result<(), Failure> {
    if cancel.is_cancelled() { Err(Failure::Run(INTERRUPTED.into())) } else { Ok(()) }
}

/// Progress of several clouds at once.
struct Progress<'a> {
    phase: Mutex<Phase>,
    /// Points of all clouds, and those done.
    n_points: u64,
    done: AtomicU64,
    cancel: &'a Cancel,
}

impl<'a> Progress<'a> {
    fn new(title: &'static str, request: &'a ClassifyRequest<'_>, clouds: &[Cloud]) -> Progress<'a> {
        let n_points = clouds.iter().map(|cloud| cloud.header.n_points).sum();
        let phase = Mutex::new(Phase::new("classify", title, request.progress, 1));
        Progress { phase, n_points, done: AtomicU64::new(0), cancel: &request.cancel }
    }

    /// Shows the progress of one cloud; returns whether to continue.
    fn of(&self, cloud: &Cloud) -> impl FnMut(f64) -> bool {
        let mut before = 0;
        let name = cloud.path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        move |part| {
            let now = (part * cloud.header.n_points as f64) as u64;
            let done = self.done.fetch_add(now - before, Ordering::Relaxed) + now - before;
            before = now;
            let part = done as f64 / self.n_points.max(1) as f64;
            self.phase.lock().unwrap_or_else(PoisonError::into_inner).show(&name, 0, part);
            !self.cancel.is_cancelled()
        }
    }
}

fn classify(
    request: &ClassifyRequest<'_>,
    files: Vec<(PathBuf, PathBuf)>,
) -> Result<ClassifiedClouds, Failure> {
    let mut failures = Vec::new();
    let clouds = open(files, &mut failures)?;
    let lock = claim(request, &clouds)?;
    let folder =
        clouds.first().and_then(|cloud| cloud.output.parent()).filter(|folder| *folder != Path::new(""));
    let folder = folder.unwrap_or(Path::new("."));
    let tiles = Tiles::new(folder, request.kept_classes, request.surface_cell_m)
        .map_err(|error| Failure::Run(no_room(&error)))?;
    let progress = Progress::new("reading", request, &clouds);
    let spooled: Vec<_> = clouds
        .par_iter()
        .enumerate()
        .map(|(number, cloud)| cloud.spool(number as u32, &tiles, progress.of(cloud)))
        .collect();
    drop(progress);
    check_interruption(&request.cancel)?;
    let mut read = BTreeMap::new();
    let mut failed = BTreeSet::new();
    for (result, number) in spooled.into_iter().zip(0..) {
        match result {
            Ok(counts) => {
                read.insert(number, counts);
            }
            Err(problem) => {
                failures.push(problem);
                failed.insert(number);
            }
        }
    }
    // A cloud whose damage shows only while it is copied takes no part either.
    loop {
        if failed.len() == clouds.len() {
            return Err(none_usable(&failures));
        }
        let ground = ground(request, &tiles, folder, &failed)?;
        let progress = Progress::new("writing", request, &clouds);
        let numbers = (0..clouds.len() as u32).filter(|number| !failed.contains(number));
        let numbers: Vec<u32> = numbers.collect();
        let copies: Vec<_> = numbers
            .par_iter()
            .map(|number| {
                let cloud = &clouds[*number as usize];
                (*number, cloud.write(*number, &ground, progress.of(cloud)))
            })
            .collect();
        drop(progress);
        check_interruption(&request.cancel)?;
        let n_failed = failed.len();
        let mut results = Vec::new();
        for (number, written) in copies {
            match written {
                Ok((file, after, copy)) => {
                    let (before, left) = read[&number];
                    results.push((&clouds[number as usize], file, CloudResult { before, after, left, copy }));
                }
                Err(WriteFailure::Source(problem)) => {
                    failures.push(problem);
                    failed.insert(number);
                }
                Err(WriteFailure::Output(problem)) => return Err(Failure::Run(problem)),
            }
        }
        if failed.len() == n_failed {
            let classified = finish(request, results, failures, ground, &clouds);
            drop(lock);
            return classified;
        }
    }
}

/// Opens all clouds, in an order that depends on their content.
///
/// # Errors
/// None can be used.
fn open(files: Vec<(PathBuf, PathBuf)>, failures: &mut Vec<String>) -> Result<Vec<Cloud>, Failure> {
    let opened: Vec<_> = files.into_par_iter().map(|(path, output)| Cloud::open(&path, output)).collect();
    let mut clouds = Vec::new();
    for result in opened {
        match result {
            Ok(cloud) => clouds.push(cloud),
            Err(problem) => failures.push(problem),
        }
    }
    // The first of the command line with a coordinate reference system gives that of all.
    if let Some(first) = clouds.iter().position(|cloud| cloud.wkt.is_some()) {
        let other: Vec<_> = clouds.iter().map(|cloud| cloud.check_system(&clouds[first]).err()).collect();
        let mut other = other.into_iter();
        clouds.retain(|_| match other.next().flatten() {
            Some(problem) => {
                failures.push(problem);
                false
            }
            None => true,
        });
    }
    if clouds.is_empty() {
        return Err(none_usable(failures));
    }
    clouds.sort_by_cached_key(Cloud::rank);
    let sds = sds_of(&clouds);
    clouds.iter_mut().for_each(|cloud| cloud.use_sds(sds));
    Ok(clouds)
}

/// What the SDs of all clouds include: everything only if all clouds have total uncertainties.
fn sds_of(clouds: &[Cloud]) -> PointSds {
    if clouds.iter().all(Cloud::has_total_sds) { PointSds::Total } else { PointSds::Own }
}

fn none_usable(failures: &[String]) -> Failure {
    match failures {
        [only] => Failure::Run(only.clone()),
        _ => Failure::Run(format!(
            "no cloud can be used; correct their problems:\n  {}",
            failures.join("\n  ")
        )),
    }
}

/// Claims all outputs, and makes their folders.
fn claim(request: &ClassifyRequest<'_>, clouds: &[Cloud]) -> Result<OutputLock, Failure> {
    let mut claimed = Outputs::new();
    for path in clouds.iter().map(|cloud| cloud.output.as_path()).chain(request.report) {
        let folder = path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).map_err(|error| {
            Failure::Run(format!(
                "{}: cannot create the folder: {error}; check its permissions",
                folder.display()
            ))
        })?;
        claimed.entry(folder.to_path_buf()).or_default().insert(path.to_path_buf());
    }
    OutputLock::acquire(&claimed).map_err(|error| Failure::Run(error.to_string()))
}

/// Classifies the points of all tiles.
fn ground(
    request: &ClassifyRequest<'_>,
    tiles: &Tiles<'_>,
    folder: &Path,
    failed: &BTreeSet<u32>,
) -> Result<Ground, Failure> {
    let mut phase = Phase::new("classify", "classifying", request.progress, 1);
    let progress = |part| {
        phase.show("ground", 0, part);
        !request.cancel.is_cancelled()
    };
    let ground = tiles.classify(folder, &request.settings, (failed, request.memory_mb), progress);
    let ground = ground.map_err(|error| Failure::Run(no_room(&error)))?;
    ground.ok_or_else(|| Failure::Run(INTERRUPTED.into()))
}

/// Publishes the copies, and collects what a user should know.
fn finish(
    request: &ClassifyRequest<'_>,
    results: Vec<(&Cloud, FinishedFile, CloudResult)>,
    failures: Vec<String>,
    ground: Ground,
    clouds: &[Cloud],
) -> Result<ClassifiedClouds, Failure> {
    let failed = |error: wavex_formats::Error| Failure::Run(error.to_string());
    let mut warnings: Vec<String> =
        results.iter().flat_map(|(cloud, ..)| cloud.notes.iter().cloned()).collect();
    let mut files = Vec::new();
    let mut rows = Vec::new();
    for (cloud, file, result) in results {
        warnings.extend(text::notes(cloud, &result));
        files.push(file);
        rows.push((cloud, result));
    }
    rows.sort_by(|one, other| one.0.path.cmp(&other.0.path));
    if let Some(path) = request.report {
        let report = serde_json::to_string_pretty(&report::report(request, &rows, &failures));
        let report = report.map_err(|error| Failure::Run(error.to_string()))?;
        files.push(crate::align::finished(path, &(report + "\n"))?);
    }
    files.iter_mut().try_for_each(FinishedFile::remove_stale).map_err(failed)?;
    let mut written =
        files.into_iter().map(FinishedFile::publish).collect::<Result<Vec<_>, _>>().map_err(failed)?;
    written.sort();
    let first = clouds.iter().find(|cloud| cloud.wkt.is_some()).or(clouds.first());
    let (wkt, units_m) = first.map_or((None, [1.0; 2]), |cloud| (cloud.wkt.clone(), cloud.units_m));
    let failure = (!failures.is_empty()).then(|| {
        let n = failures.len();
        let plural = if n == 1 { "cloud was" } else { "clouds were" };
        Failure::Run(format!("{n} {plural} left out:\n  {}", failures.join("\n  ")))
    });
    let ground = GroundTiles { ground, sds: sds_of(clouds), wkt, units_m };
    Ok(ClassifiedClouds { text: text::table(&rows), warnings, written, failure, ground })
}
