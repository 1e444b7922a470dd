//! File of a strip's patches (`*_patches.arrow`): Arrow IPC, so other programs can read it.
//!
//! One row per patch, in the order of keeping, in record batches of at most [`ROWS_PER_BATCH`]. The schema's
//! metadata have the version (`wavex.patches`) and the strip as JSON (`wavex.strip`).

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{ArrowPrimitiveType, Float32Type, Float64Type, UInt8Type, UInt16Type};
use arrow_array::{Array as _, ArrayRef, Float32Array, Float64Array, RecordBatch, UInt8Array, UInt16Array};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::{FileWriter, IpcWriteOptions};
use arrow_schema::{ArrowError, DataType, Field, Schema};
use serde::{Deserialize, Serialize};

use super::maker::{StripPatches, scanner_of};
use wavex_align::patch::{Patch, PatchCounts};
use wavex_align::scanner::{BeamSource, Scanner, ScannerBeam};
use wavex_formats::container::TableReader;
use wavex_formats::{Error, Result};
use wavex_geodesy::calibration::Calibration;
use wavex_geodesy::frames::{Rotation, Vector};
use wavex_geodesy::time_axis::Clock;
use wavex_geodesy::trajectory::Trajectory;
use wavex_line::georef::Geometry;
use wavex_line::georef::corrections::CorrectionsTime;
use wavex_line::stage::OutputFile;

/// Version of the layout, and of the rules by which patches are made.
const VERSION: &str = "2";
const VERSION_KEY: &str = "wavex.patches";
const STRIP_KEY: &str = "wavex.strip";
const ROWS_PER_BATCH: usize = 1 << 14;
/// Most patches of a file; `write_patches` keeps fewer.
const MOST_PATCHES: usize = 1_000_000;
const REMEDY: &str = "run its strip again with `write_patches`";

/// Columns of the beams, without the number of the beam.
const OF_BEAM: [&str; 5] = ["time_s", "x", "y", "z", "range_m"];
/// Other columns of 32 bits.
const SMALL: [&str; 6] = ["origin_x_m", "origin_y_m", "origin_z_m", "sd_m", "slope_sd", "roughness_m"];

/// Patches of a strip with everything that an alignment needs besides its trajectory.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchesFile {
    /// Stem of the recording.
    pub stem: String,
    /// File name of the recording.
    pub recording: String,
    /// Time scale of the trajectory.
    pub clock: Clock,
    /// First and last shot, s on the axis of the trajectory.
    pub span_s: [f64; 2],
    /// Number of shots with a pose.
    pub n_shots: u64,
    /// Cells without a patch.
    pub counts: PatchCounts,
    /// Patches of strip 0, in the order of keeping.
    pub patches: Vec<Patch>,
    origin: Origin,
}

/// What the patches were made with.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Origin {
    /// File name of the trajectory.
    trajectory: String,
    /// BLAKE3 of the records of the trajectory during the strip.
    trajectory_digest: String,
    /// Position at the first shot in the earth-centred frame, m.
    first_position_m: Option<Vector>,
    body_from_mount: Rotation,
    calibration: Calibration,
    cell_m: f64,
}

/// The strip as JSON.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct StripJson {
    name: String,
    recording: String,
    time: CorrectionsTime,
    first_s: f64,
    last_s: f64,
    shots: u64,
    patches: usize,
    unusable_returns: u64,
    sparse_cells: u64,
    cells_of_several_returns: u64,
    rough_cells: u64,
    thinned_patches: u64,
    made_with: Origin,
}

impl PatchesFile {
    /// The patches of the strip with this stem and recording.
    pub fn new(stem: String, recording: &Path, strip: StripPatches) -> PatchesFile {
        let recording = recording.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let StripPatches { geometry, cell_m, clock, span_s, n_shots, counts, patches } = strip;
        let origin = Origin::of(&geometry, span_s, cell_m);
        PatchesFile { stem, recording, clock, span_s, n_shots, counts, patches, origin }
    }

    /// Scanner whose start values placed the cells.
    pub fn scanner(&self) -> Scanner {
        Scanner { body_from_mount: self.origin.body_from_mount, calibration: self.origin.calibration }
    }

    /// Why the patches do not fit the geometry of a job, with remedy; `None` if they do.
    pub fn difference(&self, geometry: &Geometry, cell_m: f64) -> Option<String> {
        let (own, of_job) = (&self.origin, Origin::of(geometry, self.span_s, cell_m));
        if own.body_from_mount != of_job.body_from_mount {
            return Some(
                "the patches were made with another `mount` than the job's; run its strip again".to_owned(),
            );
        }
        if own.calibration != of_job.calibration {
            return Some(format!(
                "the patches were made with another `calibration` than the job's: {} instead of {}; run its strip again, or set \
                 `calibration` in `[job.geometry]` to that of the patches",
                first_difference(&own.calibration, &of_job.calibration).unwrap_or_default(),
                first_difference(&of_job.calibration, &own.calibration).unwrap_or_default(),
            ));
        }
        if own.cell_m != of_job.cell_m {
            let problem =
                format!("the patches have cells of {} m instead of {} m", own.cell_m, of_job.cell_m);
            return Some(format!("{problem}; {REMEDY}"));
        }
        if own.trajectory_digest == of_job.trajectory_digest {
            return None;
        }
        let (file, trajectory) = geometry.trajectory()?;
        let (file, [first_s, last_s], [from_s, to_s]) = (file.display(), self.span_s, trajectory.span_s());
        Some(match (own.first_position_m, of_job.first_position_m) {
            (Some(_), None) => format!(
                "the strip lasts from {first_s:.3} to {last_s:.3} s, but {file} has no pose at its beginning (it lasts from \
                 {from_s:.3} to {to_s:.3} s); give the trajectory of its flight, {}",
                own.trajectory
            ),
            (Some(own_m), Some(found_m)) if distance_m(own_m, found_m) > MOST_SHIFT_M => format!(
                "at its first shot the aircraft is {:.0} m from where {file} has it; check `crs`, `unit` and `geoid`, in \
                 which projected trajectories are read, or run its strip again",
                distance_m(own_m, found_m)
            ),
            _ => format!(
                "the patches were made with other records of a trajectory ({}) than those of {file}; run its strip again, or \
                 give the earlier trajectory with the same keys",
                own.trajectory
            ),
        })
    }

    /// Writes the file.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn write(&self, file: &mut OutputFile) -> Result<()> {
        let path = file.path().to_owned();
        self.write_to(file).map_err(|error| match error {
            ArrowError::IoError(_, error) => Error::io(&path, "write")(error),
            other => Error::unusable(&path, other.to_string(), "please report this bug in wavex"),
        })
    }

    fn write_to(&self, file: &mut OutputFile) -> std::result::Result<(), ArrowError> {
        let strip = StripJson {
            name: self.stem.clone(),
            recording: self.recording.clone(),
            time: self.clock.into(),
            first_s: self.span_s[0],
            last_s: self.span_s[1],
            shots: self.n_shots,
            patches: self.patches.len(),
            unusable_returns: self.counts.unusable_returns,
            sparse_cells: self.counts.sparse,
            cells_of_several_returns: self.counts.multiple,
            rough_cells: self.counts.rough,
            thinned_patches: self.counts.thinned,
            made_with: self.origin.clone(),
        };
        let strip =
            serde_json::to_string(&strip).map_err(|error| ArrowError::JsonError(error.to_string()))?;
        let metadata = [(VERSION_KEY.to_owned(), VERSION.to_owned()), (STRIP_KEY.to_owned(), strip)];
        let field = |name: String, kind| Field::new(name, kind, false);
        let of_beams = (0..OF_BEAM.len() * 3).map(|k| field(beam_column(k), DataType::Float64));
        let small = SMALL.iter().map(|name| field((*name).to_owned(), DataType::Float32));
        let counts =
            [field("n_returns".to_owned(), DataType::UInt16), field("low_power".to_owned(), DataType::UInt8)];
        let fields: Vec<Field> = of_beams.chain(small).chain(counts).collect();
        let schema = Arc::new(Schema::new(fields).with_metadata(HashMap::from(metadata)));
        let options = IpcWriteOptions::default().try_with_compression(Some(CompressionType::ZSTD))?;
        let mut writer = FileWriter::try_new_with_options(file, &schema, options)?;
        for patches in self.patches.chunks(ROWS_PER_BATCH) {
            writer.write(&RecordBatch::try_new(Arc::clone(&schema), columns(patches))?)?;
        }
        writer.finish()
    }
}

/// Longest distance between positions of the same trajectory in the same coordinates, m.
const MOST_SHIFT_M: f64 = 100.0;

impl Origin {
    fn of(geometry: &Geometry, span_s: [f64; 2], cell_m: f64) -> Origin {
        let Scanner { body_from_mount, calibration } = scanner_of(geometry);
        let (file, trajectory) = geometry.trajectory().unzip();
        let name = file.and_then(Path::file_name).unwrap_or_default();
        let first = trajectory.and_then(|trajectory| trajectory.pose(span_s[0]));
        Origin {
            trajectory: name.to_string_lossy().into_owned(),
            trajectory_digest: trajectory.map_or_else(String::new, |trajectory| digest(trajectory, span_s)),
            first_position_m: first.map(|pose| pose.origin_in_ecef_m),
            body_from_mount,
            calibration,
            cell_m,
        }
    }
}

/// Digest of the records on which the poses of a strip depend.
fn digest(trajectory: &Trajectory, [first_s, last_s]: [f64; 2]) -> String {
    let samples = trajectory.samples();
    let from = samples.partition_point(|sample| sample.time_s <= first_s).saturating_sub(2);
    let to = samples.partition_point(|sample| sample.time_s < last_s).saturating_add(2).min(samples.len());
    let mut hasher = blake3::Hasher::new();
    for sample in samples.get(from..to).unwrap_or_default() {
        let (place, attitude) = (&sample.place, &sample.attitude);
        let places = [sample.time_s, place.latitude_rad, place.longitude_rad, place.height_m];
        let angles = [attitude.roll_rad, attitude.pitch_rad, attitude.heading_rad];
        for number in places.into_iter().chain(angles) {
            hasher.update(&number.to_le_bytes());
        }
    }
    hasher.finalize().to_hex().to_string()
}

fn distance_m(a: Vector, b: Vector) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// First value of a calibration that another one does not have.
fn first_difference(calibration: &Calibration, other: &Calibration) -> Option<String> {
    let [own, other] =
        [calibration, other].map(|calibration| serde_json::to_value(calibration).unwrap_or_default());
    let own = own.as_object()?;
    own.iter()
        .find(|(key, value)| other.get(key) != Some(value))
        .map(|(key, value)| format!("{key} = {value}"))
}

/// Name of a column of the beams: all values of the first beam come first.
fn beam_column(k: usize) -> String {
    format!("{}_{}", OF_BEAM[k % OF_BEAM.len()], k / OF_BEAM.len() + 1)
}

fn beam_values(beam: &ScannerBeam) -> [f64; 5] {
    let [x, y, z] = beam.direction;
    [beam.time_s, x, y, z, beam.range_m]
}

fn small_values(patch: &Patch) -> [f32; 6] {
    let [x, y, z] = patch.source.origin_m;
    [x, y, z, patch.sd_m, patch.slope_sd, patch.roughness_m]
}

fn columns(patches: &[Patch]) -> Vec<ArrayRef> {
    let of_beam = |k: usize| -> ArrayRef {
        let values =
            patches.iter().map(|patch| beam_values(&patch.beams[k / OF_BEAM.len()])[k % OF_BEAM.len()]);
        Arc::new(values.collect::<Float64Array>())
    };
    let small = |k: usize| -> ArrayRef {
        Arc::new(patches.iter().map(|patch| small_values(patch)[k]).collect::<Float32Array>())
    };
    let n_returns: UInt16Array = patches.iter().map(|patch| patch.n_returns).collect();
    let low_power: UInt8Array =
        patches.iter().map(|patch| u8::from(patch.source.on_low_power_scale)).collect();
    let of_beams = (0..OF_BEAM.len() * 3).map(of_beam);
    let counts: [ArrayRef; 2] = [Arc::new(n_returns), Arc::new(low_power)];
    of_beams.chain((0..SMALL.len()).map(small)).chain(counts).collect()
}

/// Name of a strip in a file of patches.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StripName {
    /// Stem of the recording.
    pub stem: String,
    /// File name of the recording.
    pub recording: String,
}

/// Reads the name of a strip without its patches.
///
/// # Errors
/// As [`read_patches`], unless it is the patches that are damaged.
pub fn read_strip_name(path: &Path) -> Result<StripName> {
    let (_, strip) = open(path)?;
    Ok(StripName { stem: strip.name, recording: strip.recording })
}

/// Opens a file, with its checked description.
fn open(path: &Path) -> Result<(TableReader, StripJson)> {
    let unusable = |problem: String| Error::unusable(path, problem, REMEDY);
    let table = TableReader::open(path)?;
    let metadata = table.schema().metadata();
    match metadata.get(VERSION_KEY).map(String::as_str) {
        Some(VERSION) => {}
        None => return Err(unusable("not the patches of a strip".to_owned())),
        Some(other) => return Err(unusable(format!("version {other} of patches is not supported"))),
    }
    let strip = metadata.get(STRIP_KEY).map(String::as_str).unwrap_or_default();
    let strip: StripJson = serde_json::from_str(strip)
        .map_err(|error| unusable(format!("invalid description of the strip: {error}")))?;
    if strip.name.is_empty() || strip.first_s > strip.last_s || strip.made_with.cell_m <= 0.0 {
        return Err(unusable("the description of the strip has no name, times or cell size".to_owned()));
    }
    if strip.patches > MOST_PATCHES {
        return Err(unusable(format!("{} patches are more than {MOST_PATCHES}", strip.patches)));
    }
    Ok((table, strip))
}

/// Reads the patches of a strip.
///
/// # Errors
/// A file that cannot be read, is damaged, or is not the patches of a strip in this version.
pub fn read_patches(path: &Path) -> Result<PatchesFile> {
    let unusable = |problem: String| Error::unusable(path, problem, REMEDY);
    let (mut table, strip) = open(path)?;
    let (span_s, n_patches) = ([strip.first_s, strip.last_s], strip.patches);
    let mut patches = Vec::new();
    while let Some(batch) = table.next_batch()? {
        if batch.num_rows() > n_patches - patches.len() {
            return Err(unusable(format!("it has more patches than the {n_patches} that it states")));
        }
        add_patches(&batch, &mut patches).map_err(unusable)?;
    }
    if patches.len() < n_patches {
        return Err(unusable(format!("it has {} patches instead of {n_patches}", patches.len())));
    }
    let clock = match strip.time {
        CorrectionsTime::Adjusted => Clock::Adjusted,
        CorrectionsTime::Week => Clock::Week,
        CorrectionsTime::Day => Clock::Day,
    };
    let counts = PatchCounts {
        unusable_returns: strip.unusable_returns,
        sparse: strip.sparse_cells,
        multiple: strip.cells_of_several_returns,
        rough: strip.rough_cells,
        thinned: strip.thinned_patches,
    };
    Ok(PatchesFile {
        stem: strip.name,
        recording: strip.recording,
        clock,
        span_s,
        n_shots: strip.shots,
        counts,
        patches,
        origin: strip.made_with,
    })
}

/// Values of a column without nulls.
fn column<'b, T: ArrowPrimitiveType>(
    batch: &'b RecordBatch,
    name: &str,
) -> std::result::Result<&'b [T::Native], String> {
    let column = batch.column_by_name(name).and_then(|column| column.as_primitive_opt::<T>());
    let column = column.filter(|column| column.null_count() == 0);
    let missing = || format!("column `{name}` is missing, has gaps or another type");
    column.map(|column| &**column.values()).ok_or_else(missing)
}

/// Adds the rows of a batch.
fn add_patches(batch: &RecordBatch, patches: &mut Vec<Patch>) -> std::result::Result<(), String> {
    let of_beams: Vec<&[f64]> = (0..OF_BEAM.len() * 3)
        .map(|k| column::<Float64Type>(batch, &beam_column(k)))
        .collect::<std::result::Result<_, _>>()?;
    let small: Vec<&[f32]> =
        SMALL.iter().map(|name| column::<Float32Type>(batch, name)).collect::<std::result::Result<_, _>>()?;
    let n_returns = column::<UInt16Type>(batch, "n_returns")?;
    let low_power = column::<UInt8Type>(batch, "low_power")?;
    for row in 0..batch.num_rows() {
        let beam = |k: usize| {
            let [time_s, x, y, z, range_m] =
                std::array::from_fn(|column| of_beams[k * OF_BEAM.len() + column][row]);
            ScannerBeam { time_s, direction: [x, y, z], range_m }
        };
        let [x, y, z, sd_m, slope_sd, roughness_m] = std::array::from_fn(|column| small[column][row]);
        let patch = Patch {
            strip: 0,
            n_returns: n_returns[row],
            source: BeamSource { origin_m: [x, y, z], on_low_power_scale: low_power[row] != 0 },
            beams: std::array::from_fn(beam),
            sd_m,
            slope_sd,
            roughness_m,
        };
        if let Some(problem) = implausible(&patch) {
            return Err(format!("row {}: {problem}", patches.len()));
        }
        patches.push(patch);
    }
    Ok(())
}

/// What no patch of a strip can be.
fn implausible(patch: &Patch) -> Option<&'static str> {
    let is_beam = |beam: &ScannerBeam| {
        let squares: f64 = beam.direction.iter().map(|part| part * part).sum();
        // Comparisons with NaN are false.
        beam.time_s.abs() < 1e12 && (squares - 1.0).abs() < 1e-6 && beam.range_m.abs() < 1e7
    };
    if !patch.beams.iter().all(is_beam) {
        return Some("a beam has no time, direction or range");
    }
    let is_sd = |sd: f32| sd > 0.0 && sd < 1e3;
    let is_known = is_sd(patch.sd_m) && is_sd(patch.slope_sd) && patch.roughness_m >= 0.0;
    let is_near = patch.source.origin_m.iter().all(|part| part.abs() < 1e3);
    (!is_known || !is_near).then_some("a standard deviation or the origin is impossible")
}
