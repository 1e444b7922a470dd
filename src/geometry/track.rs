//! The trajectory of a run, on its own axis of time.

use std::path::{Path, PathBuf};

use super::keys::GeometryKeys;
use super::target::Wanted;
use crate::formats::Error;
use crate::formats::trajectory::sbet::{RECORD_BYTES, SbetRecord};
use crate::geo::ellipsoid::Geodetic;
use crate::geo::frames::Attitude;
use crate::geo::time_axis::{Clock, Times};
use crate::geo::trajectory::{Sample, Trajectory};
use crate::stage::Result;

/// A trajectory and its file.
#[derive(Debug)]
pub(super) struct Track {
    file: PathBuf,
    accuracy: Option<PathBuf>,
    pub(super) trajectory: Trajectory,
    pub(super) times: Times,
    pub(super) knows_accuracy: bool,
    /// What the user should know.
    pub(super) notes: Vec<String>,
}

impl Track {
    /// Whether it was read from these files.
    pub(super) fn is_of(&self, file: &Path, accuracy: Option<&Path>) -> bool {
        self.file == file && self.accuracy.as_deref() == accuracy
    }

    /// Reads a trajectory and the file of its accuracies; places in a map are those of the wanted system.
    pub(super) fn read(
        file: &Path,
        accuracy: Option<&Path>,
        keys: &GeometryKeys,
        wanted: &Wanted,
    ) -> Result<Track> {
        let _ = (keys, wanted);
        let trajectory = read(file)?;
        let [first_s, last_s] = trajectory.span_s();
        let times = Times { clock: Clock::Week, first_s, last_s };
        Ok(Track { file: file.to_path_buf(), accuracy: accuracy.map(Path::to_path_buf), trajectory, times, knows_accuracy: false, notes: Vec::new() })
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
