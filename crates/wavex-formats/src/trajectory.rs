//! Trajectory files: position and attitude of the instrument over time.
//!
//! [`read`] recognises the format by its content. All formats yield the same result: times on one
//! continuous axis in GPS time, geodetic or projected positions, and roll, pitch and heading from
//! north.
//!
//! ```
//! use wavex_formats::trajectory::{self, Options, sbet::SbetRecord};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("flight.sbet");
//! let record = |k: i32| SbetRecord {
//!     time_s: 300_000.0 + f64::from(k),
//!     latitude_rad: 0.84 + f64::from(k) * 1e-6,
//!     longitude_rad: 0.26,
//!     height_m: 900.0,
//!     ..SbetRecord::default()
//! };
//! std::fs::write(&path, (0..3).flat_map(|k| record(k).encode()).collect::<Vec<u8>>())?;
//!
//! let recorded = trajectory::read(&path, &Options::default())?;
//! assert_eq!((recorded.format.as_str(), recorded.records.len()), ("SBET", 3));
//! let trajectory = recorded.into_trajectory(None)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use std::path::{Path, PathBuf};

use super::{Error, RecordingFormat, Result};
use input::InputFile;
use wavex_geodesy::ellipsoid::{Geodetic, WGS84};
use wavex_geodesy::frames::{Attitude, ecef_from_ned, inverse, rotate};
use wavex_geodesy::time::ADJUSTMENT_S;
use wavex_geodesy::time_axis::{Clock, TimeSpan};
use wavex_geodesy::trajectory::{AccuracySample, Sample, Trajectory, TrajectoryError};

mod accuracies;
mod ascii;
mod axis;
mod clock_range;
mod input;
pub mod pof;
mod poq;
pub mod sbet;
mod smrmsg;
mod sol;
#[cfg(test)]
mod tests;
mod trj;

/// User settings for what a trajectory format leaves open.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// Time scale of the file.
    ///
    /// Default: as the format says, else seconds of the week, or adjusted seconds if they are too
    /// large.
    pub time: Option<FileTime>,
    /// Unit of roll, pitch and heading in text; default degrees.
    pub angles: Option<Angles>,
    /// Columns of a text, one letter each.
    ///
    /// `t` time, `x` longitude, `y` latitude, `z` height, `w` roll, `p` pitch, `k` heading; any
    /// other letter skips a column.
    pub columns: Option<String>,
    /// Accuracy file, POQ or smrmsg.
    ///
    /// Default: the POQ next to a POF, if any.
    pub accuracy: Option<PathBuf>,
}

/// Time scale of a trajectory file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileTime {
    /// Seconds of the GPS week.
    Week,
    /// Seconds of the day.
    Day,
    /// Adjusted GPS time: seconds since 1980-01-06, minus 1e9.
    Adjusted,
    /// Standard GPS time: seconds since 1980-01-06.
    Standard,
    /// Unix time: seconds of UTC since 1970-01-01, without leap seconds.
    Unix,
}

/// Seconds of UTC from 1970-01-01 to 1980-01-06.
const UNIX_TO_GPS_S: f64 = 315_964_800.0;

impl FileTime {
    /// Clock of the times after the offset.
    fn clock(self) -> Clock {
        match self {
            FileTime::Week => Clock::Week,
            FileTime::Day => Clock::Day,
            FileTime::Adjusted | FileTime::Standard | FileTime::Unix => Clock::Adjusted,
        }
    }

    /// Time of the clock minus the file's time, s.
    fn offset_s(self) -> f64 {
        match self {
            FileTime::Week | FileTime::Day | FileTime::Adjusted => 0.0,
            FileTime::Standard => -ADJUSTMENT_S,
            FileTime::Unix => -UNIX_TO_GPS_S - ADJUSTMENT_S,
        }
    }
}

/// Unit of angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Angles {
    /// 360 per turn.
    Degrees,
    /// 2π per turn.
    Radians,
}

/// Trajectory as recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// Source file.
    pub file: PathBuf,
    /// Format, such as `POF 1.1`.
    pub format: String,
    /// Description of the file's clock.
    ///
    /// For example `seconds of the week, GPS, 2025-05-06`.
    pub counts: String,
    /// Clock of the records.
    ///
    /// Adjusted GPS seconds if the file names its week or day. Times continue across the end of
    /// weeks and days, and are GPS time.
    pub clock: Clock,
    /// Records in the order of the file.
    pub records: Records,
    /// Accuracies on the time axis of the records.
    ///
    /// Empty if no file provides them.
    pub accuracies: Vec<AccuracySample>,
    /// Horizontal speeds of the records, m/s.
    ///
    /// Empty if the format has none.
    pub speeds_mps: Vec<f64>,
    /// Notes for the user.
    pub notes: Vec<String>,
}

/// Records with geodetic or projected positions.
#[derive(Clone, Debug, PartialEq)]
pub enum Records {
    /// Geodetic positions on WGS 84.
    Geodetic(Vec<Sample>),
    /// Projected positions; the file does not name the projection.
    Projected(Vec<MapSample>),
}

/// Sample with a projected position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapSample {
    /// Time on the continuous axis, s.
    pub time_s: f64,
    /// Easting, northing and height, in the unit of the projection.
    pub place: [f64; 3],
    /// Attitude; the heading is relative to grid north.
    pub attitude: Attitude,
}

/// Converts projected to geodetic coordinates, or describes the problem.
///
/// The argument is easting, northing and height.
pub type Unproject<'a> = dyn Fn([f64; 3]) -> std::result::Result<Geodetic, String> + 'a;

/// Output of a decoder.
struct Raw {
    format: String,
    /// Declarations of the file about its times.
    stated: axis::Stated,
    /// Records with times as in the file.
    records: Records,
    /// Horizontal speeds, m/s; empty if the format has none.
    speeds_mps: Vec<f64>,
    notes: Vec<String>,
}

/// Reads a trajectory: POF, TRJ, SOL, SBET or text.
///
/// # Errors
/// The file has another format, is damaged, has times that contradict their declared clock, or its
/// accuracies cannot be read.
pub fn read(path: &Path, options: &Options) -> Result<Recorded> {
    let (format, raw) = decode(&mut InputFile::open(path)?, options)?;
    let poq = || if format == TrajectoryFormat::Pof { accuracies::poq_of(path) } else { None };
    let accuracy = options.accuracy.clone().or_else(poq);
    axis::settle(path, raw, options, accuracy.as_deref())
}

/// Time span by the first and the last record; reads no others of a binary file.
///
/// # Errors
/// The file has another format, or its first or last record is damaged.
pub fn time_span(path: &Path, options: &Options) -> Result<TimeSpan> {
    let mut input = InputFile::open(path)?;
    input.only_ends();
    let (_, raw) = decode(&mut input, options)?;
    Ok(axis::settle(path, raw, options, None)?.times())
}

/// Recognises the format and decodes the records.
fn decode(input: &mut InputFile, options: &Options) -> Result<(TrajectoryFormat, Raw)> {
    let Some(format) = TrajectoryFormat::of(&input.head()?) else {
        return Err(unknown(&input.path, input.length));
    };
    let raw = match format {
        TrajectoryFormat::Pof => pof::read(input)?,
        TrajectoryFormat::Trj => trj::read(input)?,
        TrajectoryFormat::Sol => sol::read(input)?,
        TrajectoryFormat::Sbet => sbet::read(input)?,
        TrajectoryFormat::Text => ascii::read(input, options)?,
        TrajectoryFormat::Poq => {
            let remedy = "give the POF file; its POQ is found automatically";
            return Err(Error::unusable(&input.path, "it is a POQ file, which has only accuracies", remedy));
        }
    };
    Ok((format, raw))
}

/// Trajectory formats, and POQ.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum TrajectoryFormat {
    Pof,
    Poq,
    Trj,
    Sol,
    Sbet,
    Text,
}

impl TrajectoryFormat {
    /// Recognises the format from the first bytes of a file.
    fn of(head: &[u8]) -> Option<TrajectoryFormat> {
        if head.starts_with(pof::MAGIC) {
            Some(TrajectoryFormat::Pof)
        } else if head.starts_with(poq::MAGIC) {
            Some(TrajectoryFormat::Poq)
        } else if head.starts_with(trj::MAGIC) {
            Some(TrajectoryFormat::Trj)
        } else if ascii::is_text(head) {
            Some(TrajectoryFormat::Text)
        } else if sol::is_one(head) {
            Some(TrajectoryFormat::Sol)
        } else {
            sbet::is_one(head).then_some(TrajectoryFormat::Sbet)
        }
    }
}

fn unknown(path: &Path, length: u64) -> Error {
    if RecordingFormat::of(path).is_some() {
        let remedy = "give the positions and attitudes of the flight: SBET, POF, SOL, TRJ or columns of text";
        return Error::unusable(path, "it is a recording, not a trajectory", remedy);
    }
    let problem = format!(
        "unknown trajectory format: its {length} bytes do not begin with `RIEGL \
         POSITION&ORIENTATION` (POF) or `TSCANTRJ` (TRJ), byte 34 is not the XOR of the bytes \
         before it (SOL), bytes 8 to 23 are not a latitude and longitude in radians (SBET), and it \
         is not text"
    );
    Error::unusable(
        path,
        problem,
        "export the trajectory as one of these, with positions in degrees or radians and attitude",
    )
}

impl Recorded {
    /// Whether the file is text, whose units the user states.
    pub fn is_text(&self) -> bool {
        self.format == ascii::FORMAT
    }

    /// Returns the time span.
    pub fn times(&self) -> TimeSpan {
        let mut times = self.records.times_s();
        let first_s = times.next().unwrap_or(f64::NAN);
        TimeSpan { clock: self.clock, first_s, last_s: times.last().unwrap_or(first_s) }
    }

    /// Converts to a trajectory, with accuracies if present.
    ///
    /// Projected positions are converted by `unproject`.
    ///
    /// # Errors
    /// Times out of order or duplicated, invalid values, or projected positions without
    /// `unproject`.
    pub fn into_trajectory(self, unproject: Option<&Unproject>) -> Result<Trajectory> {
        let file = &self.file;
        let samples = match self.records {
            Records::Geodetic(samples) => samples,
            Records::Projected(samples) => {
                let Some(unproject) = unproject else {
                    let problem = "its positions are projected, but it does not name their CRS";
                    return Err(Error::unusable(file, problem, "set `crs`"));
                };
                let place = |(k, sample): (usize, &MapSample)| {
                    sample.on_earth(unproject).map_err(|problem| {
                        let problem = format!("record {}: {problem}", k + 1);
                        Error::unusable(file, problem, "check that `crs` is the CRS of the trajectory")
                    })
                };
                samples.iter().enumerate().map(place).collect::<Result<_>>()?
            }
        };
        let refused = |problem: TrajectoryError| Error::unusable(file, problem.to_string(), problem.remedy());
        let trajectory = Trajectory::new(samples).map_err(refused)?;
        if self.accuracies.is_empty() {
            return Ok(trajectory);
        }
        let refused = |problem: TrajectoryError| {
            Error::unusable(file, format!("its accuracies: {problem}"), problem.remedy())
        };
        trajectory.with_accuracies(self.accuracies).map_err(refused)
    }
}

impl Records {
    /// Returns the number of records.
    pub fn len(&self) -> usize {
        match self {
            Records::Geodetic(samples) => samples.len(),
            Records::Projected(samples) => samples.len(),
        }
    }

    /// Returns whether there are no records.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Iterates over the times, s.
    pub fn times_s(&self) -> Box<dyn Iterator<Item = f64> + '_> {
        match self {
            Records::Geodetic(samples) => Box::new(samples.iter().map(|sample| sample.time_s)),
            Records::Projected(samples) => Box::new(samples.iter().map(|sample| sample.time_s)),
        }
    }

    fn times_mut(&mut self) -> Box<dyn Iterator<Item = &mut f64> + '_> {
        match self {
            Records::Geodetic(samples) => Box::new(samples.iter_mut().map(|sample| &mut sample.time_s)),
            Records::Projected(samples) => Box::new(samples.iter_mut().map(|sample| &mut sample.time_s)),
        }
    }
}

/// Half baseline for grid north, in units of the projection.
const NORTH_STEP: f64 = 10.0;

impl MapSample {
    /// Converts the sample to geodetic coordinates.
    ///
    /// The direction of grid north follows from positions north and south of it on the ellipsoid.
    fn on_earth(&self, unproject: &Unproject) -> std::result::Result<Sample, String> {
        let [x, y, z] = self.place;
        let place = unproject(self.place)?;
        let foot = |place: Geodetic| WGS84.ecef_of(Geodetic { height_m: 0.0, ..place });
        let north = foot(unproject([x, y + NORTH_STEP, z])?);
        let south = foot(unproject([x, y - NORTH_STEP, z])?);
        let along = core::array::from_fn(|axis| north[axis] - south[axis]);
        let ned_from_ecef = inverse(&ecef_from_ned(place.latitude_rad, place.longitude_rad));
        let [north, east, _] = rotate(&ned_from_ecef, along);
        let heading_rad = self.attitude.heading_rad + libm::atan2(east, north);
        Ok(Sample { time_s: self.time_s, place, attitude: Attitude { heading_rad, ..self.attitude } })
    }
}

/// Creates a sample from degrees.
///
/// The longitude is wrapped to -180 to 180.
fn sample_of_degrees(time_s: f64, [longitude, latitude, height_m]: [f64; 3], attitude: Attitude) -> Sample {
    let place = Geodetic {
        latitude_rad: latitude.to_radians(),
        longitude_rad: wrapped_rad(longitude.to_radians()),
        height_m,
    };
    Sample { time_s, place, attitude }
}

/// Wraps an angle of up to one turn to -π..π.
///
/// Angles already in the interval keep their bits; NaN is unchanged.
fn wrapped_rad(angle_rad: f64) -> f64 {
    use core::f64::consts::{PI, TAU};
    if (PI..=TAU).contains(&angle_rad.abs()) { angle_rad - TAU.copysign(angle_rad) } else { angle_rad }
}

/// Rejects invalid samples.
///
/// The error gives the offset of the record.
fn check(path: &Path, offset: u64, record: u64, sample: &Sample) -> Result<()> {
    use core::f64::consts::{FRAC_PI_2, TAU};
    let Sample { time_s, place, attitude } = sample;
    let bad = |field: &str, value: f64| {
        let problem = format!("invalid value {value:.6}");
        let remedy = "the file is damaged, or its positions are not geodetic: export it again";
        Err(Error::malformed(path, offset, format!("{field} of record {record}"), problem, remedy))
    };
    let is_within = |value: f64, most: f64| value.abs() <= most;
    if !time_s.is_finite() {
        return bad("time", *time_s);
    }
    if !is_within(place.latitude_rad, FRAC_PI_2) {
        return bad("latitude", place.latitude_rad.to_degrees());
    }
    if !is_within(place.longitude_rad, TAU) {
        return bad("longitude", place.longitude_rad.to_degrees());
    }
    if !is_within(place.height_m, HIGHEST_M) {
        return bad("height", place.height_m);
    }
    let angles =
        [("roll", attitude.roll_rad), ("pitch", attitude.pitch_rad), ("heading", attitude.heading_rad)];
    match angles.into_iter().find(|(_, angle)| !is_within(*angle, LARGEST_ANGLE_RAD)) {
        Some((field, angle)) => bad(field, angle.to_degrees()),
        None => Ok(()),
    }
}

/// Largest height of an instrument, m.
const HIGHEST_M: f64 = 1e6;
/// Largest valid angle, rad; headings may include several turns.
const LARGEST_ANGLE_RAD: f64 = 1e3;
