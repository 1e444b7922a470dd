//! Strips of point clouds, and their patches.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use super::frame::{Frame, system_of};
use crate::Failure;
use rayon::prelude::*;
use wavex_align::patch::{
    BLOCK_CELLS, Patch, PatchBudget, PatchCounts, PatchMaker, PatchSettings, block_rank,
};
use wavex_engine::engine::{self, Cancel};
use wavex_formats::las::{Point, RawPoints};
use wavex_geodesy::crs::{are_contradictory, units_of_wkt};
use wavex_line::stage::Paths;

/// Classes that are not solid surface: vegetation, noise, water.
const NOT_SURFACE: [u8; 6] = [3, 4, 5, 7, 9, 18];
/// Points from which the noise of a strip is estimated.
const NOISE_POINTS: u64 = 500_000;
/// Fewest patches for this estimate.
const LEAST_NOISE_PATCHES: usize = 20;
/// Noise without such an estimate, m.
const ASSUMED_NOISE_M: f64 = 0.02;
/// Smallest noise, m: planes without any have no weights.
const LEAST_NOISE_M: f64 = 1e-4;
/// Most cells of a strip whose points are in no order of time, which are all held; of more, blocks are chosen.
const MOST_HELD_CELLS: f64 = 60_000.0;
/// Longest strip, s; longer spans are no times of one flight line.
const LONGEST_S: f64 = 86_400.0;
/// Points between two looks for an interruption.
const POINTS_PER_LOOK: u64 = 1 << 16;

/// A strip: all points of a file, or those of one point source ID.
pub(super) struct CloudStrip {
    pub(super) name: String,
    /// Index of its file.
    pub(super) file: usize,
    /// Point source ID, if the file has several strips.
    pub(super) source_id: Option<u16>,
    /// First and last time, s; `None` if its points have no usable times.
    pub(super) span_s: Option<[f64; 2]>,
    pub(super) n_points: u64,
    /// SD of the points across smooth surface, m.
    pub(super) noise_m: f64,
    pub(super) n_patches: usize,
    pub(super) counts: PatchCounts,
}

/// A file that could not be used.
pub(super) struct FailedCloud {
    pub(super) name: String,
    /// Problem and remedy, with the name of the file.
    pub(super) problem: String,
}

/// Strips of all clouds, with their patches.
pub(super) struct Clouds {
    pub(super) files: Vec<PathBuf>,
    pub(super) strips: Vec<CloudStrip>,
    pub(super) failures: Vec<FailedCloud>,
    pub(super) patches: Vec<Patch>,
    pub(super) frame: Frame,
    /// Largest area around the points of a strip, m².
    pub(super) area_m2: f64,
    /// What a user should know.
    pub(super) notes: Vec<String>,
}

/// How clouds are read.
#[derive(Clone, Copy)]
pub(super) struct ReadSettings<'a> {
    pub(super) by_source: bool,
    /// Whether corrections depend on time.
    pub(super) needs_time: bool,
    pub(super) cell_m: f64,
    pub(super) cancel: &'a Cancel,
}

/// Files named on the command line: files, folders and patterns.
///
/// # Errors
/// Nothing is found, or two files have the same name.
pub(crate) fn list(inputs: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut names = Vec::new();
    for input in inputs {
        if !input.is_dir() {
            names.push(input.to_string_lossy().into_owned());
            continue;
        }
        let failed = |error: std::io::Error| {
            Failure::Wrong(format!(
                "{}: cannot list the folder: {error}; check its permissions",
                input.display()
            ))
        };
        let entries = input.read_dir().map_err(failed)?.filter_map(|entry| Some(entry.ok()?.path()));
        let mut clouds: Vec<PathBuf> = entries.filter(|path| is_cloud(path) && path.is_file()).collect();
        clouds.sort();
        if clouds.is_empty() {
            return Err(Failure::Wrong(format!(
                "{}: the folder has no .las or .laz files; give the folder of the strips",
                input.display()
            )));
        }
        names.extend(clouds.iter().map(|path| path.to_string_lossy().into_owned()));
    }
    let inputs = engine::expand(Some(&Paths::Many(names)), "", Path::new(""));
    Ok(inputs
        .map_err(|error| Failure::Wrong(error.to_string()))?
        .into_iter()
        .map(|input| input.path)
        .collect())
}

/// Whether a path has the extension of a cloud of points.
pub(crate) fn is_cloud(path: &Path) -> bool {
    let extension = path.extension().unwrap_or_default();
    ["las", "laz"].iter().any(|known| extension.eq_ignore_ascii_case(known))
}

/// Reads all clouds, in parallel.
///
/// # Errors
/// An interruption. Files that cannot be used are in [`Clouds::failures`].
pub(super) fn read(files: Vec<PathBuf>, settings: ReadSettings<'_>) -> Result<Clouds, Failure> {
    let by_source = settings.by_source || files.len() == 1;
    let settings = ReadSettings { by_source, ..settings };
    let scans: Vec<Result<Scan, String>> = files.par_iter().map(|file| Scan::of(file, settings)).collect();
    check_interruption(&settings)?;
    let mut clouds = Clouds {
        strips: Vec::new(),
        failures: Vec::new(),
        patches: Vec::new(),
        frame: Frame::default(),
        area_m2: 0.0,
        notes: Vec::new(),
        files,
    };
    // The first usable file with a coordinate reference system gives that of all.
    let has_system = |scan: &&(usize, &Scan)| scan.1.wkt.is_some();
    let found: Vec<(usize, &Scan)> =
        scans.iter().enumerate().filter_map(|(file, scan)| Some((file, scan.as_ref().ok()?))).collect();
    let first = found.iter().find(has_system).or(found.first());
    let (wkt, of) = first.map_or((None, PathBuf::new()), |(file, scan)| {
        clouds.frame = scan.frame;
        (scan.wkt.clone(), clouds.files[*file].clone())
    });
    let mut usable = Vec::new();
    for (file, scan) in scans.into_iter().enumerate() {
        let path = clouds.files[file].clone();
        match scan.and_then(|scan| scan.check_system(&path, wkt.as_deref(), &of).map(|()| scan)) {
            Ok(scan) => {
                clouds.notes.extend(scan.notes.iter().cloned());
                usable.push((file, scan));
            }
            Err(problem) => clouds.fail(&path, problem),
        }
    }
    let frame = clouds.frame;
    let mut budget = PatchBudget::default();
    // Patches of few files at a time, to thin them before those of the next files are made.
    for of_threads in usable.chunks(rayon::current_num_threads()) {
        let read: Vec<_> = of_threads
            .par_iter()
            .map(|(file, scan)| (*file, scan, scan.patches(&clouds.files[*file], &frame, settings)))
            .collect();
        check_interruption(&settings)?;
        for (file, scan, made) in read {
            let path = clouds.files[file].clone();
            match made {
                Ok(made) => clouds.add(file, scan, made, settings, &mut budget),
                Err(problem) => clouds.fail(&path, problem),
            }
        }
    }
    let (patches, counts) = budget.finish();
    for (strip, n_patches) in clouds.strips.iter_mut().zip(counts) {
        strip.counts.thinned += (strip.n_patches - n_patches) as u64;
        strip.n_patches = n_patches;
    }
    clouds.patches = patches;
    Ok(clouds)
}

fn check_interruption(settings: &ReadSettings<'_>) -> Result<(), Failure> {
    match settings.cancel.is_cancelled() {
        true => Err(Failure::Run("interrupted".into())),
        false => Ok(()),
    }
}

/// Name of a file in messages and results.
fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

impl Clouds {
    fn fail(&mut self, path: &Path, problem: String) {
        self.failures.push(FailedCloud { name: stem(path), problem });
    }

    fn add(
        &mut self,
        file: usize,
        scan: &Scan,
        made: Vec<Made>,
        settings: ReadSettings<'_>,
        budget: &mut PatchBudget,
    ) {
        let path = self.files[file].clone();
        let has_several = scan.strips.len() > 1;
        let mut without_time = Vec::new();
        for (found, Made { patches, counts }) in scan.strips.values().zip(made) {
            let source_id = has_several.then_some(found.source_id);
            let name = match source_id {
                Some(id) => format!("{}:{id}", stem(&path)),
                None => stem(&path),
            };
            if patches.is_empty() {
                let problem = format!(
                    "{}: no smooth surface{}: of its cells, {} have too few points, {} have several returns per shot, {} are \
                     rough; alignment needs ground or roofs with at least one point per m²",
                    path.display(),
                    source_id.map_or(String::new(), |id| format!(" in the points of source {id}")),
                    counts.sparse,
                    counts.multiple,
                    counts.rough
                );
                self.failures.push(FailedCloud { name, problem });
                continue;
            }
            self.area_m2 = self.area_m2.max(found.edges_m().into_iter().product());
            if settings.needs_time && found.span_s().is_none() {
                without_time.push(name.clone());
            }
            self.strips.push(CloudStrip {
                name,
                file,
                source_id,
                span_s: found.span_s(),
                n_points: found.n_points,
                noise_m: found.noise_m,
                n_patches: patches.len(),
                counts,
            });
            budget.add(patches);
        }
        if !without_time.is_empty() {
            self.notes.push(format!(
                "{}: the points have no times, one time, or times of more than a day: the correction of the strip is constant",
                without_time.join(", ")
            ));
        }
    }
}

/// What a first pass finds in a file.
struct Scan {
    wkt: Option<String>,
    frame: Frame,
    /// By point source ID, or all as 0.
    strips: BTreeMap<u16, FoundStrip>,
    notes: Vec<String>,
}

/// Points of a strip in a first pass.
struct FoundStrip {
    source_id: u16,
    n_points: u64,
    times_s: [f64; 2],
    last_s: f64,
    /// Largest step backwards in time, s.
    back_s: f64,
    /// Extent in metres, east and north.
    min_m: [f64; 2],
    max_m: [f64; 2],
    noise_m: f64,
}

impl FoundStrip {
    fn new(source_id: u16) -> FoundStrip {
        FoundStrip {
            source_id,
            n_points: 0,
            times_s: [f64::INFINITY, f64::NEG_INFINITY],
            last_s: f64::NEG_INFINITY,
            back_s: 0.0,
            min_m: [f64::INFINITY; 2],
            max_m: [f64::NEG_INFINITY; 2],
            noise_m: ASSUMED_NOISE_M,
        }
    }

    fn span_s(&self) -> Option<[f64; 2]> {
        let length_s = self.times_s[1] - self.times_s[0];
        (length_s > 0.0 && length_s <= LONGEST_S).then_some(self.times_s)
    }

    /// Extent of the points that are used, m.
    fn edges_m(&self) -> [f64; 2] {
        [0, 1].map(|axis| (self.max_m[axis] - self.min_m[axis]).max(0.0))
    }

    /// Whether points are in the order of time, so that cells are complete while the file is read.
    fn is_in_order(&self, settings: &PatchSettings) -> bool {
        self.span_s().is_some() && self.back_s <= settings.patience_s
    }

    /// Largest rank of the blocks of ground that are used: fewer if all cells have to be held.
    fn most_rank(&self, settings: &PatchSettings) -> u64 {
        let edges = self.edges_m().map(|edge_m| edge_m / settings.cell_m + 1.0);
        let part = MOST_HELD_CELLS / (edges[0] * edges[1]);
        if self.is_in_order(settings) || part >= 1.0 { u64::MAX } else { (part * u64::MAX as f64) as u64 }
    }
}

/// Patches of a strip.
struct Made {
    patches: Vec<Patch>,
    counts: PatchCounts,
}

/// Checks that the coordinate reference system of a cloud at `place` is the first one, that of the file `of`.
///
/// # Errors
/// It is another one: problem and remedy.
pub(crate) fn check_system(
    path: &Path,
    (own, first): (Option<&str>, Option<&str>),
    of: &Path,
    place: [f64; 3],
) -> Result<(), String> {
    let (Some(own), Some(first)) = (own, first) else { return Ok(()) };
    let is_other = units_of_wkt(own) != units_of_wkt(first) || are_contradictory(own, first, place);
    if !is_other {
        return Ok(());
    }
    let name = |wkt: &str| wkt.split('"').nth(1).unwrap_or("an unnamed system").to_owned();
    Err(format!(
        "{}: its coordinate reference system is {}, that of {} is {}; convert all clouds to one system",
        path.display(),
        name(own),
        of.display(),
        name(first)
    ))
}

/// Whether a point may be on solid surface.
fn is_usable(point: &Point) -> bool {
    !(point.withheld || point.synthetic || NOT_SURFACE.contains(&point.classification))
}

impl Scan {
    /// Reads a file for the first time.
    fn of(path: &Path, settings: ReadSettings<'_>) -> Result<Scan, String> {
        let failed = |error: wavex_formats::Error| error.to_string();
        let mut points = RawPoints::open(path).map_err(failed)?;
        let header = points.header().clone();
        let crs = points.crs();
        let system = system_of(path, crs.wkt.as_deref(), &header)?;
        let mut notes: Vec<String> =
            crs.problems.iter().map(|problem| format!("{}: {problem}", path.display())).collect();
        notes.extend(system.note);
        let mut point = Point::default();
        let mut frame = None;
        let mut strips: BTreeMap<u16, FoundStrip> = BTreeMap::new();
        let mut pilots: BTreeMap<u16, (PatchMaker, u64)> = BTreeMap::new();
        let mut n = 0u64;
        while points.next_point(&mut point).map_err(failed)?.is_some() {
            n += 1;
            if n.is_multiple_of(POINTS_PER_LOOK) && settings.cancel.is_cancelled() {
                return Err("interrupted".into());
            }
            let frame = *frame.get_or_insert_with(|| Frame::new([point.x, point.y, point.z], system.units_m));
            let key = if settings.by_source { point.point_source_id } else { 0 };
            let found = strips.entry(key).or_insert_with(|| FoundStrip::new(key));
            found.n_points += 1;
            if !is_usable(&point) {
                continue;
            }
            let [east_m, north_m, _] = frame.local_m([point.x, point.y, point.z]);
            found.min_m = [found.min_m[0].min(east_m), found.min_m[1].min(north_m)];
            found.max_m = [found.max_m[0].max(east_m), found.max_m[1].max(north_m)];
            if point.gps_time.is_finite() {
                found.times_s = [found.times_s[0].min(point.gps_time), found.times_s[1].max(point.gps_time)];
                found.back_s = found.back_s.max(found.last_s - point.gps_time);
                found.last_s = point.gps_time;
            }
            let (pilot, n_given) = pilots.entry(key).or_insert_with(|| {
                let patches = PatchSettings { cell_m: settings.cell_m, ..PatchSettings::default() };
                (PatchMaker::new(0, frame.horizon(), patches), 0)
            });
            if *n_given < NOISE_POINTS {
                *n_given += 1;
                pilot.add(&frame.patch_return(&point, 0.0, 0.0));
            }
        }
        let Some(frame) = frame else {
            return Err(format!("{}: it has no points; give a file with points", path.display()));
        };
        for (key, (pilot, _)) in pilots {
            let (patches, _) = pilot.finish();
            if let (Some(found), true) = (strips.get_mut(&key), patches.len() >= LEAST_NOISE_PATCHES) {
                // Without range SDs, the roughness is the RMS distance from a plane of three parameters.
                let noise = patches.iter().map(|patch| {
                    let n = f64::from(patch.n_returns);
                    f64::from(patch.roughness_m) * (n / (n - 3.0)).sqrt()
                });
                let mut noise_m: Vec<f64> = noise.collect();
                noise_m.sort_by(f64::total_cmp);
                found.noise_m = noise_m[noise_m.len() / 2].max(LEAST_NOISE_M);
            }
        }
        Ok(Scan { wkt: crs.wkt, frame, strips, notes })
    }

    /// Checks the coordinate reference system against that of the first file.
    fn check_system(&self, path: &Path, first: Option<&str>, of: &Path) -> Result<(), String> {
        check_system(path, (self.wkt.as_deref(), first), of, self.frame.origin)
    }

    /// Reads a file again, for the patches of its strips in the order of their IDs.
    fn patches(&self, path: &Path, frame: &Frame, settings: ReadSettings<'_>) -> Result<Vec<Made>, String> {
        let failed = |error: wavex_formats::Error| error.to_string();
        let given = PatchSettings { cell_m: settings.cell_m, ..PatchSettings::default() };
        // The makers of a file hold up to twice their limits together.
        let most_patches = given.most_patches.min(PatchBudget::most_of(self.strips.len()));
        let given = PatchSettings { most_patches, ..given };
        let mut makers: BTreeMap<u16, (PatchMaker, &FoundStrip, u64)> = BTreeMap::new();
        for (key, found) in &self.strips {
            // Cells are held until the end unless points are in the order of time.
            let patience_s = if found.is_in_order(&given) { given.patience_s } else { f64::INFINITY };
            let maker = PatchMaker::new(0, frame.horizon(), PatchSettings { patience_s, ..given });
            makers.insert(*key, (maker, found, found.most_rank(&given)));
        }
        let mut points = RawPoints::open(path).map_err(failed)?;
        let (mut point, mut n) = (Point::default(), 0u64);
        while points.next_point(&mut point).map_err(failed)?.is_some() {
            n += 1;
            if n.is_multiple_of(POINTS_PER_LOOK) && settings.cancel.is_cancelled() {
                return Err("interrupted".into());
            }
            let key = if settings.by_source { point.point_source_id } else { 0 };
            let Some((maker, found, most_rank)) = makers.get_mut(&key).filter(|_| is_usable(&point)) else {
                continue;
            };
            if *most_rank < u64::MAX {
                let [east_m, north_m, _] = frame.local_m([point.x, point.y, point.z]);
                let block = |along_m: f64| ((along_m / given.cell_m).floor() as i64).div_euclid(BLOCK_CELLS);
                if block_rank((block(east_m), block(north_m))) > *most_rank {
                    continue;
                }
            }
            // One time for all points of a strip without usable times.
            let time_s = if found.span_s().is_some() { point.gps_time } else { 0.0 };
            maker.add(&frame.patch_return(&point, time_s, found.noise_m));
        }
        let made = makers.into_values().map(|(maker, ..)| {
            let (patches, counts) = maker.finish();
            Made { patches, counts }
        });
        Ok(made.collect())
    }
}
