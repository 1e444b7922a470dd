//! The sensor's path as text.

use std::io::Write;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::batch::{Batch, Emission, Frame, InputInfo, Kind};
use crate::formats::Error;
use crate::geo::ellipsoid::WGS84;
use crate::geo::frames::{Attitude, ecef_from_ned, inverse, then};
use crate::geo::time::adjusted_gps_time;
use crate::geometry::Geometry;
use crate::stage::{Config, Context, InvalidKey, OutputFile, Result, Sink, SinkConfig, Site, StageSpec};

mod met;
mod pace;

use met::Met;
use pace::Pace;

/// The stage's place in the registry.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteTrajectory>("write_trajectory", &[Kind::Shots, Kind::Returns, Kind::Points]);

/// Writes the sensor's path as text: a row for some of the shots, separated by blanks.
///
/// The columns are `gps_time X Y Z`: the time as the points have it, adjusted GPS time where the input tells enough, and
/// the place of the sensor in the coordinates of the points. With a trajectory (`[job.geometry]`) the row has
/// `roll pitch heading`, too: degrees, right wing down, nose up, and clockwise from true north, `nan` where the trajectory
/// does not tell.
///
/// LAS and some PulseWaves files give points on each beam, but not where it began: there the sensor's place is estimated from
/// where the beams of at least `interval_s` meet. Observes `trajectory_sd_m`, the standard deviation of these places.
///
/// Where shots have no place on the earth, the file has no rows but the first line, and the report says so.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteTrajectory {
    /// The file; `*` is the input's stem.
    pub path: String,
    /// Time from row to row; 0.1 when neither it nor `every` is given.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 3600.0))]
    pub interval_s: Option<f64>,
    /// Shots from row to row, in place of `interval_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1))]
    pub every: Option<u64>,
    /// Where the sensor's place comes from.
    pub sensor: Sensor,
    /// Name the columns in a first line that begins with `#`.
    pub header: bool,
}

/// Where the sensor's place comes from.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Sensor {
    /// As the input is: from where its beams begin, unless it does not tell that.
    Auto,
    /// From where the beams begin.
    Origins,
    /// From where the beams meet.
    Beams,
}

impl Default for WriteTrajectory {
    fn default() -> WriteTrajectory {
        WriteTrajectory {
            path: "*_traj.txt".into(),
            interval_s: None,
            every: None,
            sensor: Sensor::Auto,
            header: true,
        }
    }
}

impl Config for WriteTrajectory {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        let fits = self.interval_s.is_none_or(|interval| (0.0..=3600.0).contains(&interval));
        InvalidKey::unless(fits, "interval_s", "it must lie between 0 and 3600")?;
        InvalidKey::unless(self.every != Some(0), "every", "it must be at least 1")?;
        let one = self.every.is_none() || self.interval_s.is_none();
        InvalidKey::unless(one, "every", "it takes the place of `interval_s`: give one of them")
    }

    fn spell_out(&mut self) {
        if self.every.is_none() {
            self.interval_s.get_or_insert(pace::INTERVAL_S);
        }
    }
}

impl SinkConfig for WriteTrajectory {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, site: &Site) -> Result<Box<dyn Sink>> {
        let pace = Pace::new(self.every, self.interval_s);
        Ok(Box::new(TrajectoryWriter {
            file: site.create(&self.path)?,
            geometry: Arc::clone(&site.geometry),
            sensor: self.sensor,
            header: self.header,
            frame: Frame::Scanner,
            last: None,
            met: Met::new(pace),
            pace,
        }))
    }
}

struct TrajectoryWriter {
    file: OutputFile,
    geometry: Arc<Geometry>,
    sensor: Sensor,
    /// Still to be written.
    header: bool,
    /// Of the input; the scanner's where there was none.
    frame: Frame,
    pace: Pace,
    met: Met,
    /// The last shot, where it has no row: the path goes as far.
    last: Option<(Arc<InputInfo>, Emission)>,
}

impl Sink for TrajectoryWriter {
    fn write(&mut self, batch: &Batch, cx: &mut Context) -> Result<()> {
        self.frame = batch.input.frame;
        if batch.emissions.is_empty() {
            return Ok(());
        }
        if matches!(batch.input.frame, Frame::Scanner | Frame::Body) {
            cx.note(
                "the input is not georeferenced: where the sensor was is not known, and its path has no rows",
            );
            return Ok(());
        }
        self.begin()?;
        let from_beams = match self.sensor {
            Sensor::Auto => !batch.input.origin_is_sensor,
            Sensor::Origins => false,
            Sensor::Beams => true,
        };
        for emission in &batch.emissions {
            if from_beams {
                if let Some(place) = self.met.add(emission) {
                    cx.observe("trajectory_sd_m", place.sd_m);
                    self.row(&batch.input, place.gps_time_s, place.position_m)?;
                }
            } else if self.pace.is_due(emission) {
                self.last = None;
                self.row(&batch.input, emission.gps_time_s, emission.origin_m)?;
            } else {
                self.last = Some((Arc::clone(&batch.input), *emission));
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>, cx: &mut Context) -> Result<()> {
        // Without a single row the file still says what it is.
        self.begin()?;
        if let Some((input, emission)) = self.last.take() {
            self.row(&input, emission.gps_time_s, emission.origin_m)?;
        }
        let without = self.met.n_without_place();
        if without > 0 {
            cx.note(format!(
                "the beams of {without} stretches of the flight do not meet near one place: the sensor's path has no rows there"
            ));
        }
        cx.keep(self.file.finish()?);
        Ok(())
    }
}

impl TrajectoryWriter {
    /// Writes the first line, unless it stands there.
    fn begin(&mut self) -> Result<()> {
        if std::mem::take(&mut self.header) {
            let attitude = if self.frame == Frame::Earth { " roll pitch heading" } else { "" };
            writeln!(self.file, "# gps_time X Y Z{attitude}")
                .map_err(Error::io(self.file.path(), "write"))?;
        }
        Ok(())
    }

    /// Writes a row for a time of the input and a place in its frame.
    fn row(&mut self, input: &InputInfo, gps_time_s: f64, place_m: [f64; 3]) -> Result<()> {
        let mut text = number(adjusted_gps_time(input, gps_time_s).unwrap_or(gps_time_s), 6);
        let (place, grid) = match input.frame {
            Frame::Earth => match self.geometry.target()? {
                Some(target) => (target.coordinates(place_m)?, target.grid()),
                None => return Ok(()),
            },
            _ => (place_m, input.coordinate_grid),
        };
        for (axis, coordinate) in place.into_iter().enumerate() {
            let is_degrees = grid.is_some_and(|(steps, _)| steps[axis] < DEGREES_STEP);
            text += &format!(" {}", number(coordinate, if is_degrees { 10 } else { 4 }));
        }
        if input.frame == Frame::Earth {
            let [roll, pitch, heading] = self.attitude_deg(gps_time_s).map(|angle| number(angle, 6));
            text += &format!(" {roll} {pitch} {heading}");
        }
        writeln!(self.file, "{text}").map_err(|error| Error::io(self.file.path(), "write")(error))?;
        Ok(())
    }

    /// Roll, pitch and heading of the aircraft, degrees; NaN where the trajectory does not tell.
    fn attitude_deg(&self, gps_time_s: f64) -> [f64; 3] {
        let Some(pose) = self.geometry.pose(gps_time_s) else { return [f64::NAN; 3] };
        let place = WGS84.geodetic_of(pose.origin_in_ecef_m);
        let ned_from_ecef = inverse(&ecef_from_ned(place.latitude_rad, place.longitude_rad));
        let attitude = Attitude::of(&then(&pose.ecef_from_body, &ned_from_ecef));
        let heading_deg = attitude.heading_rad.to_degrees();
        let heading_deg = if heading_deg < 0.0 { heading_deg + 360.0 } else { heading_deg };
        [attitude.roll_rad.to_degrees(), attitude.pitch_rad.to_degrees(), heading_deg]
    }
}

/// A step below this is one of degrees.
const DEGREES_STEP: f64 = 1e-5;

fn number(value: f64, digits: usize) -> String {
    if value.is_nan() { "nan".into() } else { format!("{value:.digits$}") }
}
