//! Files that say where an instrument was, and how it was turned, at each moment.
//!
//! [`read`] tells the format by its content. What the formats have in common comes out of it: times on one continuous axis,
//! in GPS time; places on the ellipsoid, or in a map; roll, pitch and the heading from north.

use std::path::{Path, PathBuf};

use super::{Error, Result};
use crate::geo::ellipsoid::{Geodetic, WGS84};
use crate::geo::frames::{Attitude, ecef_from_ned, inverse, rotate};
use crate::geo::time_axis::{Clock, Times};
use crate::geo::trajectory::{AccuracySample, Problem, Sample, Trajectory};
use input::Input;

mod accuracies;
mod ascii;
mod axis;
mod input;
pub mod pof;
pub mod poq;
pub mod sbet;
pub mod smrmsg;
pub mod sol;
#[cfg(test)]
mod tests;
pub mod trj;

/// What the user says of a trajectory, where its format leaves it open.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// What times count; not given: as the format says, else seconds of the week, or adjusted where they are too large.
    pub time: Option<Clock>,
    /// Unit of roll, pitch and heading in text; not given: degrees.
    pub angles: Option<Angles>,
    /// What the columns of a text are, a letter each: `t` time, `x` longitude, `y` latitude, `z` height, `w` roll, `p` pitch,
    /// `k` heading; any other letter passes over its column.
    pub columns: Option<String>,
    /// A file of accuracies, POQ or smrmsg; not given: the POQ beside a POF, where there is one.
    pub accuracy: Option<PathBuf>,
}

/// A unit of angles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Angles {
    /// 360 to the turn.
    Degrees,
    /// 2π to the turn.
    Radians,
}

/// A trajectory as it was recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// The file.
    pub file: PathBuf,
    /// Its format: `POF 1.1`.
    pub format: String,
    /// What its times count, in words: `seconds of the week, GPS, week of 2025-05-06`.
    pub counts: String,
    /// What the records' times count. They are adjusted where the file tells its week or day; they run on across the end of
    /// weeks and days, and are GPS's.
    pub clock: Clock,
    /// In the order of the file.
    pub records: Records,
    /// On the axis of the records; empty where no file tells them.
    pub accuracies: Vec<AccuracySample>,
    /// What the user should know.
    pub notes: Vec<String>,
}

/// Records, as their format has them.
#[derive(Clone, Debug, PartialEq)]
pub enum Records {
    /// Places on the ellipsoid of WGS 84.
    Geodetic(Vec<Sample>),
    /// Places in a map, of which the file does not say which.
    Projected(Vec<MapSample>),
}

/// A place in a map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MapSample {
    /// On one continuous axis, s.
    pub time_s: f64,
    /// Easting, northing and height, in the map's unit.
    pub place: [f64; 3],
    /// The heading counts from the grid's north.
    pub attitude: Attitude,
}

/// From easting, northing and height of a map to a place; what is wrong with them otherwise.
pub type Unproject<'a> = dyn Fn([f64; 3]) -> std::result::Result<Geodetic, String> + 'a;

/// What a decoder makes of a file.
struct Raw {
    format: String,
    /// What the file says of its times.
    stated: axis::Stated,
    /// Times as in the file.
    records: Records,
    notes: Vec<String>,
}

/// Reads a trajectory: POF, TRJ, SOL, SBET or text.
///
/// # Errors
/// The file is none of these, is damaged, has times that are not what they are said to be, or its accuracies cannot be read.
pub fn read(path: &Path, options: &Options) -> Result<Recorded> {
    let mut input = Input::open(path)?;
    let head = input.head()?;
    let raw = match Format::of(&head) {
        Some(Format::Pof) => pof::read(&mut input)?,
        Some(Format::Trj) => trj::read(&mut input)?,
        Some(Format::Sol) => sol::read(&mut input)?,
        Some(Format::Sbet) => sbet::read(&mut input)?,
        Some(Format::Text) => ascii::read(&mut input, options)?,
        Some(Format::Poq) => {
            let remedy = "give the POF beside it; the POQ is found there";
            return Err(Error::unusable(path, "it is a POQ, which holds only accuracies", remedy));
        }
        None => return Err(unknown(path, input.length)),
    };
    axis::settle(path, raw, options)
}

/// The formats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Format {
    Pof,
    Poq,
    Trj,
    Sol,
    Sbet,
    Text,
}

impl Format {
    /// The format of a file that begins with these bytes.
    fn of(head: &[u8]) -> Option<Format> {
        if head.starts_with(pof::MAGIC) {
            Some(Format::Pof)
        } else if head.starts_with(poq::MAGIC) {
            Some(Format::Poq)
        } else if head.starts_with(trj::MAGIC) {
            Some(Format::Trj)
        } else if ascii::is_text(head) {
            Some(Format::Text)
        } else if sol::is_one(head) {
            Some(Format::Sol)
        } else {
            sbet::is_one(head).then_some(Format::Sbet)
        }
    }
}

fn unknown(path: &Path, length: u64) -> Error {
    let problem = format!(
        "it is no trajectory that wavex knows: its {length} bytes do not begin with `RIEGL POSITION&ORIENTATION` (POF) or \
         `TSCANTRJ` (TRJ), byte 34 is not the exclusive or of those before (SOL), bytes 8 to 23 are no latitude and longitude \
         in radians (SBET), and it is no text"
    );
    Error::unusable(
        path,
        problem,
        "export the trajectory as one of these, with positions in degrees or radians and attitude",
    )
}

impl Recorded {
    /// From when to when it lasts.
    pub fn times(&self) -> Times {
        let mut times = self.records.times_s();
        let first_s = times.next().unwrap_or(f64::NAN);
        Times { clock: self.clock, first_s, last_s: times.last().unwrap_or(first_s) }
    }

    /// The trajectory, with its accuracies where there are any. Places in a map go through `unproject`.
    ///
    /// # Errors
    /// Times in disorder or twice, values that cannot be; places in a map, and nothing says which.
    pub fn into_trajectory(self, unproject: Option<&Unproject>) -> Result<Trajectory> {
        let file = &self.file;
        let samples = match self.records {
            Records::Geodetic(samples) => samples,
            Records::Projected(samples) => {
                let Some(unproject) = unproject else {
                    let problem = "its places are those of a map, and it does not say which";
                    return Err(Error::unusable(file, problem, "say which with `crs`"));
                };
                let place = |(k, sample): (usize, &MapSample)| {
                    sample.on_earth(unproject).map_err(|problem| {
                        let problem = format!("record {}: {problem}", k + 1);
                        Error::unusable(file, problem, "check that `crs` is the trajectory's map")
                    })
                };
                samples.iter().enumerate().map(place).collect::<Result<_>>()?
            }
        };
        let refused = |problem: Problem| Error::unusable(file, problem.to_string(), problem.remedy());
        let trajectory = Trajectory::new(samples).map_err(refused)?;
        if self.accuracies.is_empty() {
            return Ok(trajectory);
        }
        let refused =
            |problem: Problem| Error::unusable(file, format!("its accuracies: {problem}"), problem.remedy());
        trajectory.with_accuracies(self.accuracies).map_err(refused)
    }
}

impl Records {
    /// How many there are.
    pub fn len(&self) -> usize {
        match self {
            Records::Geodetic(samples) => samples.len(),
            Records::Projected(samples) => samples.len(),
        }
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Their times, s.
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

/// Half the length over which the grid's north is looked for, in units of the map.
const NORTH_STEP: f64 = 10.0;

impl MapSample {
    /// The sample on the earth. Where the grid's north points to follows from places north and south of it on the ellipsoid.
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

/// A sample of degrees, with its longitude between -180 and 180.
fn sample_of_degrees(time_s: f64, [longitude, latitude, height_m]: [f64; 3], attitude: Attitude) -> Sample {
    let place = Geodetic {
        latitude_rad: latitude.to_radians(),
        longitude_rad: wrapped_rad(longitude.to_radians()),
        height_m,
    };
    Sample { time_s, place, attitude }
}

/// An angle of up to one turn, between -π and π; what lies there already keeps its bits, what is none stays.
fn wrapped_rad(angle_rad: f64) -> f64 {
    use core::f64::consts::{PI, TAU};
    if (PI..=TAU).contains(&angle_rad.abs()) { angle_rad - TAU.copysign(angle_rad) } else { angle_rad }
}

/// Refuses what cannot be a sample; the error stands where the record begins.
fn check(path: &Path, offset: u64, record: u64, sample: &Sample) -> Result<()> {
    use core::f64::consts::{FRAC_PI_2, TAU};
    let Sample { time_s, place, attitude } = sample;
    let bad = |field: &str, value: f64| {
        let problem = format!("{value:.6} is none");
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

/// No instrument flies higher, m.
const HIGHEST_M: f64 = 1e6;
/// Headings may count some turns on; beyond this an angle is no angle, rad.
const LARGEST_ANGLE_RAD: f64 = 1e3;
