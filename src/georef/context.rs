//! Georeferencing context of a run: the keys with their files read, shared by its stages.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use super::calibration::Calibration;
use super::keys::{CalibrationKey, GeometryKeys};
use super::output_crs::{CrsRequest, Target, failed};
use super::trajectory_file::Track;
use super::transform::Installation;
use crate::scan_line::{Emission, Frame, InputInfo};
use crate::stage::{Result, StageError};
use wavex_geodesy::frames::Vector;
use wavex_geodesy::time_axis::{Alignment, Clock, Misaligned, TimeSpan};
use wavex_geodesy::trajectory::{Pose, Poses, Trajectory};

/// Georeferencing context of a run.
#[derive(Debug)]
pub struct Geometry {
    keys: GeometryKeys,
    installation: Installation,
    track: Option<Arc<Track>>,
    wanted: CrsRequest,
    /// Maps times of the recording to those of the trajectory.
    alignment: OnceLock<Alignment>,
    /// First shot of the recording.
    first: OnceLock<First>,
    target: OnceLock<Cached<Arc<Target>>>,
    is_own_map: OnceLock<bool>,
}

/// A cached result; an error is kept as text with problem and remedy.
type Cached<T> = std::result::Result<T, String>;

/// Position and time of the start of a recording.
#[derive(Clone, Copy, Debug)]
struct First {
    frame: Frame,
    place_m: Vector,
    time_s: f64,
}

/// Reads the files of `[job.geometry]`.
///
/// Shared files are read once; a trajectory is read again only if the file changes.
#[derive(Debug)]
pub struct Loader {
    keys: GeometryKeys,
    input_dir: PathBuf,
    installation: Installation,
    wanted: CrsRequest,
    last: Option<Arc<Track>>,
}

impl Default for Geometry {
    /// No trajectory and no corrections.
    fn default() -> Geometry {
        let installation = Installation::new(&Default::default(), &Calibration::default());
        Geometry::of(GeometryKeys::default(), installation, CrsRequest::default(), None)
    }
}

impl Loader {
    /// Reads the files that do not depend on the input.
    ///
    /// # Errors
    /// A calibration or geoid that cannot be read, or an unknown coordinate reference system.
    pub fn new(keys: &GeometryKeys, input_dir: &Path) -> Result<Loader> {
        let calibration = match &keys.calibration {
            Some(CalibrationKey::File(file)) => Calibration::read(&input_dir.join(file))?,
            Some(CalibrationKey::Inline(calibration)) => *calibration,
            None => Calibration::default(),
        };
        Ok(Loader {
            installation: Installation::new(&keys.mount.unwrap_or_default(), &calibration),
            wanted: CrsRequest::load(keys, input_dir)?,
            keys: keys.clone(),
            input_dir: input_dir.to_path_buf(),
            last: None,
        })
    }

    /// Returns the context for the input with this stem.
    ///
    /// # Errors
    /// A trajectory that cannot be read.
    pub fn load(&mut self, stem: &str) -> Result<Geometry> {
        let track = match &self.keys.trajectory {
            Some(pattern) => Some(self.track(&self.input_dir.join(pattern.replace('*', stem)), stem)?),
            None => None,
        };
        Ok(Geometry::of(self.keys.clone(), self.installation, self.wanted.clone(), track))
    }

    fn track(&mut self, file: &Path, stem: &str) -> Result<Arc<Track>> {
        let accuracy =
            self.keys.trajectory_accuracy.as_ref().map(|path| self.input_dir.join(path.replace('*', stem)));
        match &self.last {
            Some(track) if track.is_of(file, accuracy.as_deref()) => Ok(Arc::clone(track)),
            _ => {
                let track = Arc::new(Track::read(file, accuracy.as_deref(), &self.keys, &self.wanted)?);
                Ok(Arc::clone(self.last.insert(track)))
            }
        }
    }
}

/// Poses at shot times; fastest for nearby consecutive times.
pub(super) struct ShotPoses<'a> {
    poses: Poses<'a>,
    alignment: &'a Alignment,
}

impl ShotPoses<'_> {
    /// Pose of the aircraft; `None` outside the trajectory or in a gap.
    pub(super) fn at(&mut self, gps_time_s: f64) -> Option<Pose> {
        self.poses.at(self.alignment.on_trajectory(gps_time_s))
    }
}

impl Geometry {
    fn of(
        keys: GeometryKeys,
        installation: Installation,
        wanted: CrsRequest,
        track: Option<Arc<Track>>,
    ) -> Geometry {
        Geometry {
            keys,
            installation,
            track,
            wanted,
            alignment: OnceLock::new(),
            first: OnceLock::new(),
            target: OnceLock::new(),
            is_own_map: OnceLock::new(),
        }
    }

    /// The keys of the job.
    pub fn keys(&self) -> &GeometryKeys {
        &self.keys
    }

    /// Mounting and calibration of the scanner.
    pub fn installation(&self) -> &Installation {
        &self.installation
    }

    /// Whether there is a trajectory.
    pub fn has_trajectory(&self) -> bool {
        self.track.is_some()
    }

    /// The trajectory and its file.
    pub fn trajectory(&self) -> Option<(&Path, &Trajectory)> {
        self.track.as_ref().map(|track| (track.file(), &track.trajectory))
    }

    /// Whether the trajectory has accuracies.
    pub fn knows_accuracy(&self) -> bool {
        self.track.as_ref().is_some_and(|track| track.knows_accuracy)
    }

    /// Notes on the trajectory.
    pub(super) fn notes(&self) -> &[String] {
        self.track.as_ref().map_or(&[], |track| &track.notes)
    }

    /// Aligns the times of a recording with those of the trajectory, once.
    ///
    /// # Errors
    /// The time scale of the recording is unknown, or its times are ambiguous on the trajectory.
    pub(super) fn align(&self, input: &InputInfo, first_s: f64) -> Result<()> {
        let (Some(track), None) = (&self.track, self.alignment.get()) else { return Ok(()) };
        let Some(clock) = Clock::of(input.time_scale) else {
            return Err(StageError::failed(
                "the time scale of the recording is unknown: its shots cannot be located on the trajectory",
                "use a recording with GPS times, or remove `trajectory` from `[job.geometry]`",
            ));
        };
        let recording = TimeSpan { clock, first_s, last_s: first_s };
        let found = Alignment::between(recording, track.times).map_err(|error| failed(&error))?;
        let _ = self.alignment.set(found);
        Ok(())
    }

    /// Pose of the aircraft at the time of a shot; `None` outside the trajectory or in a gap.
    pub fn pose(&self, gps_time_s: f64) -> Option<Pose> {
        self.poses()?.at(gps_time_s)
    }

    /// Poses for a sequence of times; `None` without an aligned trajectory.
    pub(super) fn poses(&self) -> Option<ShotPoses<'_>> {
        Some(ShotPoses { poses: self.track.as_ref()?.trajectory.poses(), alignment: self.alignment.get()? })
    }

    /// Whether the trajectory ends before a time of the recording.
    pub(super) fn has_ended_before(&self, gps_time_s: f64) -> bool {
        self.alignment.get().is_some_and(|found| found.trajectory.last_s < found.on_trajectory(gps_time_s))
    }

    /// Error if the trajectory covers none of the shots, which span `shots_s`.
    pub(super) fn no_overlap(&self, shots_s: [f64; 2]) -> StageError {
        let Some(Alignment { recording, trajectory, .. }) = self.alignment.get() else {
            return StageError::failed("there is no trajectory", "set `trajectory` in `[job.geometry]`");
        };
        let [first_s, last_s] = shots_s;
        let (recording, trajectory) = (TimeSpan { first_s, last_s, ..*recording }, *trajectory);
        failed(&Misaligned::NoOverlap { recording, trajectory })
    }

    /// Note if the trajectory covers only some of the shots.
    pub(super) fn partly_covered(&self, n: u64, [first_s, last_s]: [f64; 2]) -> String {
        let Some(Alignment { recording, trajectory, .. }) = self.alignment.get() else {
            return String::new();
        };
        let missing = TimeSpan { first_s, last_s, ..*recording };
        format!(
            "{n} shots are rejected, because the trajectory has no pose for them: they last from {missing}, the trajectory from {trajectory}"
        )
    }

    /// Sets the first shot of the recording; later calls have no effect.
    pub(super) fn meet(&self, first: &Emission, frame: Frame) {
        let _ = self.first.set(First { frame, place_m: first.origin_m, time_s: time_s(first) });
    }

    /// Time since the first shot, s.
    pub fn since_first_s(&self, emission: &Emission) -> f64 {
        time_s(emission) - self.first.get().map_or(0.0, |first| first.time_s)
    }

    /// Position of the first shot, m, if the recording is in this frame.
    fn first_place_m(&self, frame: Frame) -> Option<Vector> {
        self.first.get().filter(|first| first.frame == frame).map(|first| first.place_m)
    }

    /// The output CRS, with the zone of the first shot; `None` before the first shot in the
    /// earth-centred frame.
    ///
    /// # Errors
    /// A CRS that is not usable there.
    pub fn target(&self) -> Result<Option<Arc<Target>>> {
        let Some(first_m) = self.first_place_m(Frame::Earth) else { return Ok(None) };
        let make = || self.wanted.at(first_m).map(Arc::new).map_err(|error| error.to_string());
        self.target.get_or_init(make).clone().map(Some).map_err(|error| failed(&error))
    }

    /// The CRS of a terrain model: that of its EPSG code, else that of the points.
    ///
    /// `None` before the first shot in the earth-centred frame.
    ///
    /// # Errors
    /// A CRS that cannot be used.
    pub fn map_of(&self, epsg: Option<u16>) -> Result<Option<Arc<Target>>> {
        match (epsg, self.first_place_m(Frame::Earth)) {
            (Some(code), Some(first_m)) => self.wanted.in_map(code).at(first_m).map(Arc::new).map(Some),
            _ => self.target(),
        }
    }

    /// Checks that a recording in a projected CRS may stay there.
    ///
    /// # Errors
    /// The job requests other coordinates.
    pub fn keep_map(&self, crs_wkt: Option<&str>) -> Result<()> {
        let Some(point) = self.first_place_m(Frame::Map).filter(|_| self.keys.wants_coordinates()) else {
            return Ok(());
        };
        if *self.is_own_map.get_or_init(|| crs_wkt.is_some_and(|wkt| self.wanted.is_map(wkt, point))) {
            return Ok(());
        }
        let (name, remedy) = match crs_wkt.and_then(|wkt| wkt.split('"').nth(1)) {
            Some(name) => (
                name,
                "remove `crs`, `geoid` and `unit`, and transform the points with another program, such as PDAL",
            ),
            None => (
                "an unnamed CRS",
                "set it with the reader's key `crs_of_input`, or remove `crs`, `geoid` and `unit`",
            ),
        };
        let problem = format!(
            "the beams of this recording are already in {name}, but `[job.geometry]` requests other coordinates"
        );
        Err(StageError::failed(problem, remedy))
    }

    /// Checks that a recording without georeferencing may stay so.
    ///
    /// # Errors
    /// The job requests coordinates.
    pub fn keep_frame(&self) -> Result<()> {
        if !self.keys.wants_coordinates() {
            return Ok(());
        }
        Err(StageError::failed(
            "`[job.geometry]` requests coordinates, but this recording is not georeferenced",
            "set its `trajectory`, or remove `crs`, `geoid` and `unit`",
        ))
    }
}

/// Time of a shot, s: GPS time if it has one, else the instrument clock.
fn time_s(emission: &Emission) -> f64 {
    match emission.gps_time_s {
        time_s if time_s.is_finite() => time_s,
        _ => emission.clock_ps as f64 * 1e-12,
    }
}
