//! `write_trajectory`: writes the sensor's path as text.

use std::io::Write;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use wavex_formats::Error;
use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::frames::{Attitude, ecef_from_ned, inverse, then};
use wavex_line::georef::Geometry;
use wavex_line::georef::output_crs::OutputCrs;
use wavex_line::keys::InvalidKey;
use wavex_line::scan_line::{Emission, Frame, InputInfo, Kind, ScanLine};
use wavex_line::stage::{
    Cause, Config, Context, OutputFile, Result, RunContext, Sink, SinkConfig, StageSpec,
};

mod beam_intersection;
mod decimation;

use beam_intersection::Met;
use decimation::Pace;

/// Registry entry of the stage.
pub const STAGE: StageSpec =
    StageSpec::sink::<WriteTrajectory>("write_trajectory", &[Kind::Shots, Kind::Returns, Kind::Points]);

/// Writes the sensor's path as text, one row per selected shot.
///
/// The columns, separated by spaces, are `gps_time X Y Z`: the time of the points (adjusted GPS
/// time if it can be derived from the input), and the position of the sensor in the coordinates of
/// the points. With a trajectory (`[job.geometry]`), rows also have `roll pitch heading` in
/// degrees: right wing down, nose up, and clockwise from true north; `nan` if the trajectory does
/// not give them.
///
/// LAS and some PulseWaves files give points on each beam, but not its origin. The sensor position
/// is then estimated from the intersection of the beams of at least `interval_s`. Observes
/// `trajectory_sd_m`, the standard deviation of these positions.
///
/// If shots have no position on the earth, the file has only its header line, and the report says
/// so.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct WriteTrajectory {
    /// Output file; `*` is the input's stem.
    pub path: String,
    /// Time between rows, s. Defaults to 0.1 if `every` is not given either.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 0.0, max = 3600.0))]
    pub interval_s: Option<f64>,
    /// Number of shots between rows, instead of `interval_s`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(range(min = 1, max = i64::MAX))]
    pub every: Option<u64>,
    /// Source of the sensor position.
    pub sensor: Sensor,
    /// Write a header line that starts with `#` and names the columns.
    pub header: bool,
}

/// Source of the sensor position.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Sensor {
    /// Beam origins if the input has them, otherwise beam intersections.
    Auto,
    /// Beam origins.
    Origins,
    /// Beam intersections.
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
        let one = self.every.is_none() || self.interval_s.is_none();
        InvalidKey::unless(one, "every", "it replaces `interval_s`: give only one of them")
    }

    fn spell_out(&mut self) {
        if self.every.is_none() {
            self.interval_s.get_or_insert(decimation::INTERVAL_S);
        }
    }
}

impl SinkConfig for WriteTrajectory {
    fn outputs(&self) -> Vec<&str> {
        vec![&self.path]
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Sink>> {
        let pace = Pace::new(self.every, self.interval_s);
        Ok(Box::new(TrajectoryWriter {
            file: run.create(&self.path)?,
            geometry: Arc::clone(&run.geometry),
            target: None,
            sensor: self.sensor,
            header: self.header,
            frame: Frame::Scanner,
            last: None,
            of_beams: None,
            has_row: false,
            met: Met::new(pace),
            pace,
        }))
    }
}

struct TrajectoryWriter {
    file: OutputFile,
    geometry: Arc<Geometry>,
    /// Output CRS of positions from the earth-centred frame.
    target: Option<OutputCrs>,
    sensor: Sensor,
    /// Whether the header line is still to be written.
    header: bool,
    /// Frame of the input; the scanner frame without input.
    frame: Frame,
    pace: Pace,
    met: Met,
    /// The last shot, if it has no row yet: the path ends with it.
    last: Option<(Arc<InputInfo>, Emission)>,
    /// The recording, if positions are beam intersections.
    of_beams: Option<Arc<InputInfo>>,
    has_row: bool,
}

impl Sink for TrajectoryWriter {
    fn write(&mut self, line: &ScanLine, cx: &mut Context) -> Result<()> {
        self.frame = line.input.frame;
        if line.emissions.is_empty() {
            return Ok(());
        }
        if matches!(line.input.frame, Frame::Scanner | Frame::Body) {
            cx.consequence(Cause::NoTrajectory, "the path of the sensor has no rows");
            return Ok(());
        }
        self.begin()?;
        let from_beams = match self.sensor {
            Sensor::Auto => !line.input.origin_is_sensor,
            Sensor::Origins => false,
            Sensor::Beams => true,
        };
        self.of_beams = from_beams.then(|| Arc::clone(&line.input));
        for emission in &line.emissions {
            if from_beams {
                if let Some(place) = self.met.add(emission) {
                    cx.observe("trajectory_sd_m", place.sd_m);
                    self.row(&line.input, place.gps_time_s, place.position_m)?;
                }
            } else if self.pace.is_due(emission) {
                self.last = None;
                self.row(&line.input, emission.gps_time_s, emission.origin_m)?;
            } else {
                self.last = Some((Arc::clone(&line.input), *emission));
            }
        }
        Ok(())
    }

    fn finish(mut self: Box<Self>, cx: &mut Context) -> Result<()> {
        // A file without rows still gets its header line.
        self.begin()?;
        if let Some((input, emission)) = self.last.take() {
            self.row(&input, emission.gps_time_s, emission.origin_m)?;
        }
        let without = self.met.n_without_place();
        if let Some(input) = self.of_beams.take().filter(|_| !self.has_row) {
            // The recording is shorter than one section.
            match self.met.place() {
                Some(place) => {
                    cx.observe("trajectory_sd_m", place.sd_m);
                    self.row(&input, place.gps_time_s, place.position_m)?;
                }
                None if without == 0 => cx.warn(format!(
                    "the beams of the recording's {:.3} s do not intersect near one position: the path of the sensor \
                     has no rows",
                    self.met.length_s()
                )),
                None => {}
            }
        }
        if without > 0 {
            cx.warn(format!(
                "the beams of {without} sections of the flight do not intersect near one position: the path of the sensor has no rows there"
            ));
        }
        cx.publish(self.file.finish()?);
        Ok(())
    }
}

impl TrajectoryWriter {
    /// Writes the header line, unless already written.
    fn begin(&mut self) -> Result<()> {
        if std::mem::take(&mut self.header) {
            let attitude = if self.frame == Frame::Earth { " roll pitch heading" } else { "" };
            writeln!(self.file, "# gps_time X Y Z{attitude}")
                .map_err(Error::io(self.file.path(), "write"))?;
        }
        Ok(())
    }

    /// Writes a row for an input time and a position in the input frame.
    fn row(&mut self, input: &InputInfo, gps_time_s: f64, place_m: [f64; 3]) -> Result<()> {
        if self.target.is_none() {
            self.target = self.geometry.target(input)?;
        }
        let mut text = number(input.adjusted_gps_time(gps_time_s).unwrap_or(gps_time_s), 6);
        let (place, grid) = match input.frame {
            Frame::Earth => match &self.target {
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
            let [roll, pitch, heading] = self.attitude_deg(input, gps_time_s).map(|angle| number(angle, 6));
            text += &format!(" {roll} {pitch} {heading}");
        }
        self.has_row = true;
        writeln!(self.file, "{text}").map_err(|error| Error::io(self.file.path(), "write")(error))?;
        Ok(())
    }

    /// Roll, pitch and heading of the aircraft, degrees; NaN outside the trajectory.
    fn attitude_deg(&self, input: &InputInfo, gps_time_s: f64) -> [f64; 3] {
        let Some(pose) = self.geometry.pose(input, gps_time_s) else { return [f64::NAN; 3] };
        let place = WGS84.geodetic_of(pose.origin_in_ecef_m);
        let ned_from_ecef = inverse(&ecef_from_ned(place.latitude_rad, place.longitude_rad));
        let attitude = Attitude::of(&then(&pose.ecef_from_body, &ned_from_ecef));
        let heading_deg = attitude.heading_rad.to_degrees();
        let heading_deg = if heading_deg < 0.0 { heading_deg + 360.0 } else { heading_deg };
        [attitude.roll_rad.to_degrees(), attitude.pitch_rad.to_degrees(), heading_deg]
    }
}

/// Smaller steps are in degrees.
const DEGREES_STEP: f64 = 1e-5;

fn number(value: f64, digits: usize) -> String {
    if value.is_nan() { "nan".into() } else { format!("{value:.digits$}") }
}
