//! What the table says, with its files read: one for each run, shared by its stages.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use super::calibration::Calibration;
use super::keys::{CalibrationKey, GeometryKeys};
use super::mount::Mount;
use super::poses::Installation;
use super::target::{Target, Wanted};
use crate::batch::{Emission, Frame, InputInfo};
use crate::formats::Error;
use crate::formats::trajectory::sbet::{RECORD_BYTES, SbetRecord};
use crate::geo::ellipsoid::Geodetic;
use crate::geo::frames::{Attitude, Vector};
use crate::geo::trajectory::{Pose, Sample, Trajectory};
use crate::stage::{Context, Result, StageError};

/// The geometry of a run.
#[derive(Debug)]
pub struct Geometry {
    keys: GeometryKeys,
    installation: Installation,
    track: Option<Arc<Track>>,
    wanted: Wanted,
    /// What to add to a shot's time to have the trajectory's, s.
    offset_s: OnceLock<f64>,
    /// The recording's first shot.
    first: OnceLock<First>,
    target: OnceLock<std::result::Result<Arc<Target>, (String, String)>>,
}

/// Where and when a recording begins.
#[derive(Clone, Copy, Debug)]
struct First {
    /// In the earth's frame, m, if it has its place there.
    place_m: Option<Vector>,
    time_s: f64,
}

/// A trajectory and its file.
#[derive(Debug)]
pub(super) struct Track {
    file: PathBuf,
    trajectory: Trajectory,
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
        Geometry::of(GeometryKeys::default(), installation_of(&Mount::default(), &Calibration::default()), Wanted::default(), None)
    }
}

fn installation_of(mount: &Mount, calibration: &Calibration) -> Installation {
    Installation::new(mount, calibration)
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
            installation: installation_of(&keys.mount.unwrap_or_default(), &calibration),
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
            Some(pattern) => Some(self.track(&self.input_dir.join(pattern.replace('*', stem)))?),
            None => None,
        };
        Ok(Geometry::of(self.keys.clone(), self.installation, self.wanted.clone(), track))
    }

    fn track(&mut self, file: &Path) -> Result<Arc<Track>> {
        match &self.last {
            Some(track) if track.file == file => Ok(Arc::clone(track)),
            _ => {
                let track = Arc::new(Track { file: file.to_path_buf(), trajectory: read(file)? });
                Ok(Arc::clone(self.last.insert(track)))
            }
        }
    }
}

fn read(file: &Path) -> Result<Trajectory> {
    let bytes = std::fs::read(file).map_err(Error::io(file, "read the trajectory"))?;
    let (records, _) = bytes.as_chunks::<RECORD_BYTES>();
    let samples = records.iter().map(SbetRecord::decode).map(|record| Sample {
        time_s: record.time_s,
        place: Geodetic {
            latitude_rad: record.latitude_rad,
            longitude_rad: record.longitude_rad,
            height_m: record.height_m,
        },
        attitude: Attitude {
            roll_rad: record.roll_rad,
            pitch_rad: record.pitch_rad,
            heading_rad: record.platform_heading_rad - record.wander_angle_rad,
        },
    });
    let trajectory = Trajectory::new(samples.collect());
    Ok(trajectory.map_err(|problem| Error::unusable(file, problem.to_string(), "check the trajectory"))?)
}

impl Geometry {
    fn of(keys: GeometryKeys, installation: Installation, wanted: Wanted, track: Option<Arc<Track>>) -> Geometry {
        Geometry {
            keys,
            installation,
            track,
            wanted,
            offset_s: OnceLock::new(),
            first: OnceLock::new(),
            target: OnceLock::new(),
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

    /// Ties the times of a recording to those of the trajectory, once; `first_s` is that of a shot.
    pub(super) fn align(&self, input: &InputInfo, first_s: f64, cx: &mut Context) -> Result<()> {
        let _ = (input, first_s, cx);
        let _ = self.offset_s.set(0.0);
        Ok(())
    }

    /// The aircraft's pose at the time of a shot; `None` where the trajectory does not tell it.
    pub fn pose(&self, gps_time_s: f64) -> Option<Pose> {
        let offset_s = self.offset_s.get()?;
        self.track.as_ref()?.trajectory.pose(gps_time_s + offset_s)
    }

    /// Whether the trajectory ends before a time of the recording.
    pub(super) fn has_ended_before(&self, gps_time_s: f64) -> bool {
        let (Some(track), Some(offset_s)) = (&self.track, self.offset_s.get()) else { return false };
        track.trajectory.span_s()[1] < gps_time_s + offset_s
    }

    /// The trajectory covers none of the shots.
    pub(super) fn no_overlap(&self, shots_s: Option<[f64; 2]>) -> StageError {
        let [first, last] = shots_s.unwrap_or([f64::NAN; 2]);
        let (file, [begin, end]) = self.span();
        StageError::failed(
            format!("the shots are of {first:.3} to {last:.3} s, and the trajectory {file} is of {begin:.3} to {end:.3} s: none of them has a pose"),
            "give the trajectory of this flight, or say with `trajectory_time` what its times count",
        )
    }

    /// The trajectory covers some of the shots, but not these.
    pub(super) fn partly_covered(&self, n: u64, [first, last]: [f64; 2]) -> String {
        let (file, [begin, end]) = self.span();
        format!(
            "{n} shots from {first:.3} to {last:.3} s have no pose and are left out: the trajectory {file} goes from {begin:.3} to \
             {end:.3} s"
        )
    }

    /// The trajectory's file, and its span on the recording's axis of time, s.
    fn span(&self) -> (String, [f64; 2]) {
        let offset_s = self.offset_s.get().copied().unwrap_or(0.0);
        self.track.as_ref().map_or((String::new(), [f64::NAN; 2]), |track| {
            (track.file.display().to_string(), track.trajectory.span_s().map(|time_s| time_s - offset_s))
        })
    }

    /// Tells of the first shot of the recording; later ones change nothing.
    pub(super) fn meet(&self, first: &Emission, frame: Frame) {
        let place_m = (frame == Frame::Earth).then_some(first.origin_m);
        let _ = self.first.set(First { place_m, time_s: time_s(first) });
    }

    /// Time since the first shot, s.
    pub fn since_first_s(&self, emission: &Emission) -> f64 {
        time_s(emission) - self.first.get().map_or(0.0, |first| first.time_s)
    }

    /// Whether no shot has its place in the earth's frame.
    pub fn is_nowhere(&self) -> bool {
        self.first.get().is_none_or(|first| first.place_m.is_none())
    }

    /// Whether the trajectory tells how sure it is.
    pub fn knows_accuracy(&self) -> bool {
        self.track.as_ref().is_some_and(|_| self.keys.trajectory_accuracy.is_some())
    }

    /// The coordinates that points get, the zone being that of the recording's first shot.
    ///
    /// # Errors
    /// Coordinates that cannot be had there.
    pub fn target(&self) -> Result<Arc<Target>> {
        let made = self.target.get_or_init(|| {
            let first_m = self.first.get().and_then(|first| first.place_m).unwrap_or([f64::NAN; 3]);
            self.wanted.at(first_m).map(Arc::new)
        });
        made.clone().map_err(|(problem, remedy)| StageError::failed(problem, remedy))
    }

    /// Whether a recording in a map may stay there.
    ///
    /// # Errors
    /// Where the job asks for other coordinates.
    pub fn keep_map(&self, crs_wkt: Option<&str>) -> Result<()> {
        let _ = crs_wkt;
        Ok(())
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
