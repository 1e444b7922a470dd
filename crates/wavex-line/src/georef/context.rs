//! Georeferencing context of a run: the keys with their files read, shared by its stages.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::applied_corrections::{AppliedCorrections, corrected_twice, recording_span, without_entry};
use super::area_of_use::{label, outside_of_map};
use super::calibration::{Calibration, read_calibration};
use super::corrections::CorrectionsFile;
use super::keys::{CalibrationKey, GeometryKeys};
use super::output_crs::{CrsRequest, OutputCrs};
use super::trajectory_file::Track;
use super::transform::Installation;
use super::{Error, Result};
use crate::plausibility::Check;
use crate::scan_line::{Frame, InputInfo};
use wavex_geodesy::crs::Crs;
use wavex_geodesy::frames::Vector;
use wavex_geodesy::time_axis::{Alignment, Clock, TimeSpan};
use wavex_geodesy::trajectory::{Pose, Poses, Trajectory};

/// Georeferencing context of a run.
#[derive(Debug)]
pub struct Geometry {
    keys: GeometryKeys,
    installation: Installation,
    track: Option<Arc<Track>>,
    corrections: Option<AppliedCorrections>,
    /// Notes on the corrections.
    notes: Vec<String>,
    wanted: CrsRequest,
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
    corrections: Option<(PathBuf, CorrectionsFile)>,
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
    /// A calibration, correction file or geoid that cannot be read, or an unknown coordinate reference system.
    pub fn new(keys: &GeometryKeys, input_dir: &Path) -> Result<Loader> {
        let calibration = match &keys.calibration {
            Some(CalibrationKey::File(file)) => read_calibration(&input_dir.join(file))?,
            Some(CalibrationKey::Inline(calibration)) => *calibration,
            None => Calibration::default(),
        };
        let corrections = keys.corrections.as_ref().map(|file| {
            let file = input_dir.join(file);
            CorrectionsFile::read(&file).map(|corrections| (file, corrections))
        });
        Ok(Loader {
            corrections: corrections.transpose()?,
            installation: Installation::new(&keys.mount.unwrap_or_default(), &calibration),
            wanted: CrsRequest::load(keys, input_dir)?,
            keys: keys.clone(),
            input_dir: input_dir.to_path_buf(),
            last: None,
        })
    }

    /// Returns the context for the input with this stem.
    ///
    /// `is_placed` returns whether the beams of the input are georeferenced already; it is called only if the
    /// trajectory cannot be read.
    ///
    /// # Errors
    /// A trajectory that cannot be read, but is needed; ambiguous times of the corrections.
    pub fn load(&mut self, stem: &str, is_placed: impl FnOnce() -> bool) -> Result<Geometry> {
        let file =
            self.keys.trajectory.as_ref().map(|pattern| self.input_dir.join(pattern.replace('*', stem)));
        let track = match file.map(|file| self.track(&file, stem)).transpose() {
            Err(_) if is_placed() => None,
            track => track?,
        };
        let mut geometry = Geometry::of(self.keys.clone(), self.installation, self.wanted.clone(), track);
        if let (Some((file, corrections)), Some(track)) = (&self.corrections, &geometry.track) {
            geometry.corrections = AppliedCorrections::of(file, corrections, stem, track.times)?;
            let note = match &geometry.corrections {
                Some(_) => corrected_twice(track.file()),
                None => Some(without_entry(file, corrections, stem)),
            };
            geometry.notes.extend(note);
        }
        Ok(geometry)
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
pub struct ShotPoses<'a> {
    poses: Poses<'a>,
    alignment: Alignment,
    /// Added to times on the axis of the trajectory, s.
    offset_s: f64,
    corrections: Option<&'a AppliedCorrections>,
}

impl ShotPoses<'_> {
    /// Corrected pose of the aircraft; `None` outside the trajectory or in a gap.
    pub fn at(&mut self, gps_time_s: f64) -> Option<Pose> {
        let time_s = self.alignment.on_trajectory(gps_time_s) + self.offset_s;
        let pose = self.poses.at(time_s)?;
        Some(self.corrections.map_or(pose, |corrections| corrections.at(time_s).applied_to(&pose)))
    }
}

const NOT_FOUND: &str = "timestamp not found in PO file";

/// The check of the dates of recording and trajectory.
pub fn week_check() -> Check {
    Check::error(
        "GPS weeks of recording and trajectory",
        "the same, where both are known",
        "file name, `gps_date` or container; header of a POF, or adjusted times",
        NOT_FOUND,
    )
    .with_key("gps_date")
}

impl Geometry {
    fn of(
        keys: GeometryKeys,
        installation: Installation,
        wanted: CrsRequest,
        track: Option<Arc<Track>>,
    ) -> Geometry {
        Geometry { keys, installation, track, corrections: None, notes: Vec::new(), wanted }
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

    /// Notes on the trajectory and its corrections.
    pub fn notes(&self) -> impl Iterator<Item = &String> {
        self.track.iter().flat_map(|track| &track.notes).chain(&self.notes)
    }

    /// Corrections of the trajectory.
    pub fn corrections(&self) -> Option<&AppliedCorrections> {
        self.corrections.as_ref()
    }

    /// Checks the times of all shots of a recording against its corrections; returns a warning.
    ///
    /// # Errors
    /// The corrections are for another time.
    pub fn judge_corrections(&self, input: &InputInfo, span_s: [f64; 2]) -> Result<Option<String>> {
        match self.corrections.as_ref().zip(recording_span(input, span_s)) {
            Some((corrections, recording)) => corrections.judge(recording),
            None => Ok(None),
        }
    }

    /// Aligns the times of a recording with the times of the trajectory; `None` without a trajectory.
    ///
    /// # Errors
    /// The time scale of the recording is unknown, its times are ambiguous on the trajectory, both have
    /// dates of different weeks, or the corrections are for another time.
    pub fn align(&self, input: &InputInfo, first_s: f64) -> Result<Option<Alignment>> {
        let Some(track) = &self.track else { return Ok(None) };
        let Some(clock) = Clock::of(input.time_scale) else {
            return Err(Error::unusable(
                "the time scale of the recording is unknown: its shots cannot be located on the trajectory",
                "use a recording with GPS times, or remove `trajectory` from `[job.geometry]`",
            ));
        };
        let recording = TimeSpan { clock, first_s, last_s: first_s };
        let alignment = Alignment::between(recording, track.times)?;
        match (input.gps_week, alignment.gps_week(first_s), input.adjusted_gps_time(first_s)) {
            (Some(own), Some(week), Some(own_s)) if own != week => {
                let begins = TimeSpan { clock: Clock::Adjusted, first_s: own_s, last_s: own_s };
                Err(Error::unusable(
                    format!(
                        "{NOT_FOUND} {}: by its date the recording is of {begins}, week {own}, but the \
                         trajectory lasts from {}, week {week}",
                        track.file().display(),
                        track.times
                    ),
                    "check date: that of the recording is in its file name, the reader's key `gps_date` or the container, \
                     that of the trajectory in its header or its adjusted times",
                ))
            }
            _ => {
                if let Some((corrections, start)) =
                    self.corrections.as_ref().zip(recording_span(input, [first_s; 2]))
                {
                    corrections.judge_start(start)?;
                }
                Ok(Some(alignment))
            }
        }
    }

    /// Pose of the aircraft at the time of a shot; `None` outside the trajectory or in a gap.
    pub fn pose(&self, input: &InputInfo, gps_time_s: f64) -> Option<Pose> {
        self.poses(input.first_shot?.alignment?)?.at(gps_time_s)
    }

    /// Poses for a sequence of times; `None` without a trajectory.
    pub fn poses(&self, alignment: Alignment) -> Option<ShotPoses<'_>> {
        let poses = self.track.as_ref()?.trajectory.poses();
        let offset_s = self.installation.calibration().time_offset_s;
        Some(ShotPoses { poses, alignment, offset_s, corrections: self.corrections.as_ref() })
    }

    /// The output CRS, with the zone of the first shot; `None` before the first shot in the
    /// earth-centred frame.
    ///
    /// # Errors
    /// A CRS that is not usable there.
    pub fn target(&self, input: &InputInfo) -> Result<Option<OutputCrs>> {
        origin_m(input, Frame::Earth).map(|first_m| self.wanted.at(first_m)).transpose()
    }

    /// The CRS of a terrain model, from its EPSG code; without one, the CRS of the points.
    ///
    /// `None` before the first shot in the earth-centred frame.
    ///
    /// # Errors
    /// A CRS that cannot be used.
    pub fn map_of(&self, input: &InputInfo, epsg: Option<u16>) -> Result<Option<OutputCrs>> {
        match (epsg, origin_m(input, Frame::Earth)) {
            (Some(code), Some(first_m)) => self.wanted.in_map(code).at(first_m).map(Some),
            _ => self.target(input),
        }
    }

    /// Checks what `georeference` does with the coordinates of a recording; returns warnings.
    ///
    /// Judges by the frame and the first shot of the input of `georeference`, which the trajectory may have changed.
    ///
    /// # Errors
    /// The job requests coordinates that the recording cannot get.
    pub fn judge(&self, input: &InputInfo) -> Result<Vec<String>> {
        Ok(match input.frame {
            Frame::Map => {
                self.keep_map(input)?;
                [self.kept_name(input), outside_map(input)].into_iter().flatten().collect()
            }
            Frame::Earth => {
                self.target(input)?.and_then(|target| target.outside_area()).into_iter().collect()
            }
            Frame::Scanner | Frame::Body => {
                self.keep_frame()?;
                Vec::new()
            }
        })
    }

    /// Checks that a recording in a projected CRS may stay there.
    fn keep_map(&self, input: &InputInfo) -> Result<()> {
        let Some(point) = origin_m(input, Frame::Map).filter(|_| self.keys.wants_coordinates()) else {
            return Ok(());
        };
        let crs_wkt = input.crs_wkt.as_deref();
        if crs_wkt.is_some_and(|wkt| self.wanted.is_map(wkt, point)) {
            return Ok(());
        }
        let (name, remedy) = match crs_wkt.and_then(|wkt| wkt.split('"').nth(1)) {
            Some(name) => (
                name,
                "remove `crs`, `geoid` and `unit`, and transform the points with another program, such as PDAL",
            ),
            None => (
                "an unnamed CRS",
                "remove `crs`, `geoid` and `unit`, and name their CRS with the reader's key `crs_of_input`; recordings in \
                 other coordinates need a job of their own",
            ),
        };
        let problem = format!(
            "the beams of this recording are already in {name}, but `[job.geometry]` requests other coordinates"
        );
        Err(Error::unusable(problem, remedy))
    }

    /// A warning if a recording keeps its CRS, although `crs` names another one with the same coordinates.
    fn kept_name(&self, input: &InputInfo) -> Option<String> {
        let (own, wanted) = (Crs::horizontal_of_wkt(input.crs_wkt.as_deref()?)?, self.wanted.by_name()?);
        let is_same = match (own.epsg(), wanted.epsg()) {
            (Some(own), Some(wanted)) => own == wanted,
            _ => own.name() == wanted.name(),
        };
        (!is_same).then(|| {
            format!(
                "the points stay in {}, the CRS of the recording: `crs` of `[job.geometry]` names {}, which has the same \
                 coordinates; remove `crs`, or name the CRS with the reader's key `crs_of_input`, to write that name",
                label(&own),
                label(&wanted)
            )
        })
    }

    /// Checks that a recording without georeferencing may stay so.
    fn keep_frame(&self) -> Result<()> {
        if !self.keys.wants_coordinates() {
            return Ok(());
        }
        Err(Error::unusable(
            "`[job.geometry]` requests coordinates, but this recording is not georeferenced",
            "set its `trajectory`, or remove `crs`, `geoid` and `unit`",
        ))
    }
}

/// A warning if the first shot of a recording in a projected CRS is outside its area of use.
fn outside_map(input: &InputInfo) -> Option<String> {
    outside_of_map(&Crs::horizontal_of_wkt(input.crs_wkt.as_deref()?)?, origin_m(input, Frame::Map)?)
}

/// Origin of the first shot, m, if the recording is in this frame.
fn origin_m(input: &InputInfo, frame: Frame) -> Option<Vector> {
    input.first_shot.filter(|_| input.frame == frame).map(|first| first.origin_m)
}
