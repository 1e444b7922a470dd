//! Additional outputs of the simulator: truth and trajectory.

use std::io::Write;

use super::Simulate;
use wavex_formats::Error;
use wavex_formats::trajectory::pof::{PofHeader, PofRecord};
use wavex_formats::trajectory::sbet::SbetRecord;
use wavex_line::stage::{Context, FinishedFile, OutputFile, Result, RunContext};
use wavex_simulation::platform::Platform;
use wavex_simulation::truth::{COLUMNS, GAIN_COLUMN, TrueReturn};
use wavex_simulation::world::{GeodeticPose, World};

/// Trajectory records per second.
const RATE_HZ: f64 = 200.0;
/// Time before the first and after the last shot covered by a trajectory, s.
const MARGIN_S: f64 = 1.0;
/// Wander angle of the SBET, rad.
///
/// Not 0, to detect readers that ignore it.
const WANDER_ANGLE_RAD: f64 = 0.25;
/// Sunday on which the GPS week of the flight begins.
const WEEK_BEGINS: [u16; 3] = [2025, 5, 4];

/// Truth table during writing.
pub(super) struct TruthFile {
    file: OutputFile,
    rows: Vec<u8>,
    with_gain: bool,
}

impl TruthFile {
    pub(super) fn create(run: &RunContext, pattern: &str, with_gain: bool) -> Result<TruthFile> {
        let gain = if with_gain { GAIN_COLUMN } else { "" };
        let rows = format!("{COLUMNS}{gain}\n").into_bytes();
        let mut truth = TruthFile { file: run.create(pattern)?, rows, with_gain };
        truth.flush()?;
        Ok(truth)
    }

    pub(super) fn write(&mut self, returns: &[TrueReturn]) -> Result<()> {
        for truth in returns {
            truth.write(&mut self.rows, self.with_gain);
        }
        self.flush()
    }

    pub(super) fn finish(self) -> Result<FinishedFile> {
        Ok(self.file.finish()?)
    }

    fn flush(&mut self) -> Result<()> {
        let written = self.file.write_all(&self.rows);
        self.rows.clear();
        Ok(written.map_err(Error::io(self.file.path(), "write"))?)
    }
}

/// Trajectory files, whose names are reserved from the start.
pub(super) struct TrajectoryFiles {
    sbet: Option<OutputFile>,
    pof: Option<OutputFile>,
    trajectory: Trajectory,
}

/// Positions and attitudes at regular times.
struct Trajectory {
    /// Start of the flight, s of the GPS week.
    start_time_s: f64,
    platform: Platform,
    world: World,
    /// Error of the height, m.
    height_error_m: f64,
    records: u64,
}

impl TrajectoryFiles {
    pub(super) fn create(run: &RunContext, config: &Simulate) -> Result<TrajectoryFiles> {
        let create = |pattern: &Option<String>| match pattern {
            Some(pattern) => run.create(pattern).map(Some),
            None => Ok(None),
        };
        let flight_s = config.scanner().time_s(config.lines, 0) + 2.0 * MARGIN_S;
        let records = (flight_s * RATE_HZ).ceil() as u64 + 1;
        let start_time_s = config.start_time_s;
        let trajectory = Trajectory {
            start_time_s,
            platform: config.platform(),
            world: config.world(),
            height_error_m: config.height_error_m,
            records,
        };
        Ok(TrajectoryFiles { sbet: create(&config.sbet)?, pof: create(&config.pof)?, trajectory })
    }

    /// Writes and publishes the files.
    pub(super) fn finish(self, cx: &mut Context) -> Result<()> {
        let TrajectoryFiles { sbet, pof, trajectory } = self;
        if let Some(mut file) = sbet {
            for (time_s, pose) in trajectory.poses() {
                write(&mut file, &sbet_record(trajectory.start_time_s + time_s, &pose).encode())?;
            }
            cx.publish(file.finish()?);
        }
        if let Some(mut file) = pof {
            write(&mut file, &trajectory.pof_header().encode())?;
            for (time_s, pose) in trajectory.poses() {
                write(&mut file, &trajectory.pof_record(time_s, &pose).encode())?;
            }
            cx.publish(file.finish()?);
        }
        Ok(())
    }
}

fn write(file: &mut OutputFile, bytes: &[u8]) -> Result<()> {
    let written = file.write_all(bytes);
    Ok(written.map_err(Error::io(file.path(), "write"))?)
}

impl Trajectory {
    /// Times since the start of the flight, s, with the aircraft's pose.
    fn poses(&self) -> impl Iterator<Item = (f64, GeodeticPose)> + '_ {
        (0..self.records).map(|k| {
            let time_s = k as f64 / RATE_HZ - MARGIN_S;
            let mut pose = self.world.pose(&self.platform, time_s);
            pose.place.height_m += self.height_error_m;
            (time_s, pose)
        })
    }

    fn pof_header(&self) -> PofHeader {
        let [year, month, sunday] = WEEK_BEGINS;
        let date = [year, month, sunday + (self.start_time_s / 86_400.0) as u16];
        let mut header = PofHeader {
            date,
            records: self.records as i64,
            longitude_deg: [f64::INFINITY, f64::NEG_INFINITY],
            latitude_deg: [f64::INFINITY, f64::NEG_INFINITY],
            altitude_m: [f64::INFINITY, f64::NEG_INFINITY],
            time_step_s: [1.0 / RATE_HZ, 1.0 / RATE_HZ, 0.0],
            time_unit: 2,
            time_info: 0,
        };
        let extend = |[low, high]: &mut [f64; 2], value: f64| {
            (*low, *high) = (low.min(value), high.max(value));
        };
        for (time_s, pose) in self.poses() {
            let record = self.pof_record(time_s, &pose);
            extend(&mut header.longitude_deg, record.longitude_deg);
            extend(&mut header.latitude_deg, record.latitude_deg);
            extend(&mut header.altitude_m, record.altitude_m);
        }
        header
    }

    fn pof_record(&self, time_s: f64, pose: &GeodeticPose) -> PofRecord {
        PofRecord {
            time_s: self.start_time_s + time_s,
            longitude_deg: pose.place.longitude_rad.to_degrees(),
            latitude_deg: pose.place.latitude_rad.to_degrees(),
            altitude_m: pose.place.height_m,
            roll_deg: pose.attitude.roll_rad.to_degrees(),
            pitch_deg: pose.attitude.pitch_rad.to_degrees(),
            yaw_deg: pose.attitude.heading_rad.to_degrees(),
            distance_m: (time_s + MARGIN_S) * self.platform.speed_mps(),
        }
    }
}

/// Accelerations and angular rates are 0.
fn sbet_record(time_s: f64, pose: &GeodeticPose) -> SbetRecord {
    let [north, east, down] = pose.velocity_mps;
    let (sine, cosine) = libm::sincos(WANDER_ANGLE_RAD);
    SbetRecord {
        time_s,
        latitude_rad: pose.place.latitude_rad,
        longitude_rad: pose.place.longitude_rad,
        height_m: pose.place.height_m,
        velocity_mps: [north * cosine - east * sine, north * sine + east * cosine, down],
        roll_rad: pose.attitude.roll_rad,
        pitch_rad: pose.attitude.pitch_rad,
        platform_heading_rad: pose.attitude.heading_rad + WANDER_ANGLE_RAD,
        wander_angle_rad: WANDER_ANGLE_RAD,
        ..SbetRecord::default()
    }
}
