//! What the table says, with its files read: one for each run, shared by its stages.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use super::calibration::Calibration;
use super::keys::{CalibrationKey, GeometryKeys};
use super::poses::Installation;
use super::target::{Target, Wanted, failed};
use super::track::Track;
use crate::batch::{Emission, Frame, InputInfo};
use crate::geo::frames::Vector;
use crate::geo::time_axis::{Alignment, Clock, Misaligned, Times};
use crate::geo::trajectory::{Pose, Poses, Trajectory};
use crate::stage::{Result, StageError};

/// The geometry of a run.
#[derive(Debug)]
pub struct Geometry {
    keys: GeometryKeys,
    installation: Installation,
    track: Option<Arc<Track>>,
    wanted: Wanted,
    /// From the times of the recording to those of the trajectory.
    alignment: OnceLock<Alignment>,
    /// The recording's first shot.
    first: OnceLock<First>,
    target: OnceLock<Cached<Arc<Target>>>,
    is_own_map: OnceLock<bool>,
}

/// A result that every stage gets: an error is kept by its words, problem and remedy.
type Cached<T> = std::result::Result<T, String>;

/// Where and when a recording begins.
#[derive(Clone, Copy, Debug)]
struct First {
    frame: Frame,
    place_m: Vector,
    time_s: f64,
}

/// Reads the files of the table: those that all runs share once, and a trajectory again only for another file.
#[derive(Debug)]
pub struct Loader {
    keys: GeometryKeys,
    input_dir: PathBuf,
    installation: Installation,
    wanted: Wanted,
    last: Option<Arc<Track>>,
}

impl Default for Geometry {
    /// No trajectory, and nothing to be corrected.
    fn default() -> Geometry {
        let installation = Installation::new(&Default::default(), &Calibration::default());
        Geometry::of(GeometryKeys::default(), installation, Wanted::default(), None)
    }
}

impl Loader {
    /// Reads what does not depend on the input.
    ///
    /// # Errors
    /// A calibration or a geoid that cannot be read, or coordinates that nobody knows.
    pub fn new(keys: &GeometryKeys, input_dir: &Path) -> Result<Loader> {
        let calibration = match &keys.calibration {
            Some(CalibrationKey::File(file)) => Calibration::read(&input_dir.join(file))?,
            Some(CalibrationKey::Inline(calibration)) => *calibration,
            None => Calibration::default(),
        };
        Ok(Loader {
            installation: Installation::new(&keys.mount.unwrap_or_default(), &calibration),
            wanted: Wanted::load(keys, input_dir)?,
            keys: keys.clone(),
            input_dir: input_dir.to_path_buf(),
            last: None,
        })
    }

    /// The geometry of the run over the input with this stem.
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

/// Poses at the times of shots, mostly each near the one before.
pub(super) struct ShotPoses<'a> {
    poses: Poses<'a>,
    alignment: &'a Alignment,
}

impl ShotPoses<'_> {
    /// The aircraft's pose; `None` where the trajectory does not tell it.
    pub(super) fn at(&mut self, gps_time_s: f64) -> Option<Pose> {
        self.poses.at(self.alignment.on_trajectory(gps_time_s))
    }
}

impl Geometry {
    fn of(
        keys: GeometryKeys,
        installation: Installation,
        wanted: Wanted,
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

    /// What the job says.
    pub fn keys(&self) -> &GeometryKeys {
        &self.keys
    }

    /// How the scanner sits in the aircraft.
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

    /// Whether the trajectory tells how sure it is.
    pub fn knows_accuracy(&self) -> bool {
        self.track.as_ref().is_some_and(|track| track.knows_accuracy)
    }

    /// What the user should know of the trajectory.
    pub(super) fn notes(&self) -> &[String] {
        self.track.as_ref().map_or(&[], |track| &track.notes)
    }

    /// Ties the times of a recording to those of the trajectory, once.
    ///
    /// # Errors
    /// The recording does not say what its times count, or they may mean several moments of the trajectory.
    pub(super) fn align(&self, input: &InputInfo, first_s: f64) -> Result<()> {
        let (Some(track), None) = (&self.track, self.alignment.get()) else { return Ok(()) };
        let Some(clock) = Clock::of(input.time_scale) else {
            return Err(StageError::failed(
                "the recording does not say what its times count from: its shots have no place on the trajectory",
                "use a recording with GPS times, or leave `trajectory` out of `[job.geometry]`",
            ));
        };
        let recording = Times { clock, first_s, last_s: first_s };
        let found = Alignment::between(recording, track.times).map_err(|error| failed(&error))?;
        let _ = self.alignment.set(found);
        Ok(())
    }

    /// The aircraft's pose at the time of a shot; `None` where the trajectory does not tell it.
    pub fn pose(&self, gps_time_s: f64) -> Option<Pose> {
        self.poses()?.at(gps_time_s)
    }

    /// The poses at many times; `None` where there is no trajectory, or none that covers the recording.
    pub(super) fn poses(&self) -> Option<ShotPoses<'_>> {
        Some(ShotPoses { poses: self.track.as_ref()?.trajectory.poses(), alignment: self.alignment.get()? })
    }

    /// Whether the trajectory ends before a time of the recording.
    pub(super) fn has_ended_before(&self, gps_time_s: f64) -> bool {
        self.alignment.get().is_some_and(|found| found.trajectory.last_s < found.on_trajectory(gps_time_s))
    }

    /// The trajectory covers none of the shots, which lasted so long.
    pub(super) fn no_overlap(&self, shots_s: [f64; 2]) -> StageError {
        let Some(Alignment { recording, trajectory, .. }) = self.alignment.get() else {
            return StageError::failed("there is no trajectory", "give `trajectory` in `[job.geometry]`");
        };
        let [first_s, last_s] = shots_s;
        let (recording, trajectory) = (Times { first_s, last_s, ..*recording }, *trajectory);
        failed(&Misaligned::NoOverlap { recording, trajectory })
    }

    /// The trajectory covers some of the shots, but not these.
    pub(super) fn partly_covered(&self, n: u64, [first_s, last_s]: [f64; 2]) -> String {
        let Some(Alignment { recording, trajectory, .. }) = self.alignment.get() else {
            return String::new();
        };
        let missing = Times { first_s, last_s, ..*recording };
        format!(
            "{n} shots are left out, for which the trajectory tells no pose: they are from {missing}, the trajectory from {trajectory}"
        )
    }

    /// Tells of the first shot of the recording; later ones change nothing.
    pub(super) fn meet(&self, first: &Emission, frame: Frame) {
        let _ = self.first.set(First { frame, place_m: first.origin_m, time_s: time_s(first) });
    }

    /// Time since the first shot, s.
    pub fn since_first_s(&self, emission: &Emission) -> f64 {
        time_s(emission) - self.first.get().map_or(0.0, |first| first.time_s)
    }

    /// Where the first shot is, m, if the recording is in this frame.
    fn first_place_m(&self, frame: Frame) -> Option<Vector> {
        self.first.get().filter(|first| first.frame == frame).map(|first| first.place_m)
    }

    /// The coordinates that points get, the zone being that of the recording's first shot; `None` before any shot has its
    /// place in the earth's frame.
    ///
    /// # Errors
    /// Coordinates that cannot be had there.
    pub fn target(&self) -> Result<Option<Arc<Target>>> {
        let Some(first_m) = self.first_place_m(Frame::Earth) else { return Ok(None) };
        let make = || self.wanted.at(first_m).map(Arc::new).map_err(|error| error.to_string());
        self.target.get_or_init(make).clone().map(Some).map_err(|error| failed(&error))
    }

    /// The map that a terrain model is in: that of a code of EPSG, else the one of the points. `None` before any shot has its
    /// place in the earth's frame.
    ///
    /// # Errors
    /// A system that cannot be used.
    pub fn map_of(&self, epsg: Option<u16>) -> Result<Option<Arc<Target>>> {
        match (epsg, self.first_place_m(Frame::Earth)) {
            (Some(code), Some(first_m)) => self.wanted.in_map(code).at(first_m).map(Arc::new).map(Some),
            _ => self.target(),
        }
    }

    /// Whether a recording in a map may stay there.
    ///
    /// # Errors
    /// Where the job asks for other coordinates.
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
                "leave `crs`, `geoid` and `unit` out, and transform the points with another program, such as PDAL",
            ),
            None => (
                "a map that the recording does not name",
                "name it with the reader's key `crs_of_input`, or leave `crs`, `geoid` and `unit` out",
            ),
        };
        let problem = format!(
            "the beams of this recording are in {name} already, and `[job.geometry]` asks for other coordinates"
        );
        Err(StageError::failed(problem, remedy))
    }

    /// Whether a recording without a place on the earth may stay so.
    ///
    /// # Errors
    /// Where the job asks for coordinates.
    pub fn keep_frame(&self) -> Result<()> {
        if !self.keys.wants_coordinates() {
            return Ok(());
        }
        Err(StageError::failed(
            "`[job.geometry]` asks for coordinates, and where the shots of this recording are on the earth is not known",
            "give its `trajectory`, or leave `crs`, `geoid` and `unit` out",
        ))
    }
}

/// The time of a shot: GPS time where it has one, else that of the instrument's clock.
fn time_s(emission: &Emission) -> f64 {
    match emission.gps_time_s {
        time_s if time_s.is_finite() => time_s,
        _ => emission.clock_ps as f64 * 1e-12,
    }
}
