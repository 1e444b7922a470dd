//! The trajectory of a run, on its own axis of time.

use std::path::{Path, PathBuf};

use super::keys::{AnglesKey, GeometryKeys, TimeKey};
use super::target::Wanted;
use crate::formats::trajectory::{self, Angles, Options, Unproject};
use crate::geo::time_axis::{Clock, Times};
use crate::geo::trajectory::{Gap, Trajectory};
use crate::stage::Result;

/// A trajectory and its files.
#[derive(Debug)]
pub(super) struct Track {
    file: PathBuf,
    accuracy: Option<PathBuf>,
    pub(super) trajectory: Trajectory,
    /// From when to when it lasts.
    pub(super) times: Times,
    pub(super) knows_accuracy: bool,
    /// What the user should know.
    pub(super) notes: Vec<String>,
}

impl Track {
    /// The file it was read from.
    pub(super) fn file(&self) -> &Path {
        &self.file
    }

    /// Whether it was read from these files.
    pub(super) fn is_of(&self, file: &Path, accuracy: Option<&Path>) -> bool {
        self.file == file && self.accuracy.as_deref() == accuracy
    }

    /// Reads a trajectory and the file of its accuracies; places in a map are those of the wanted system.
    ///
    /// # Errors
    /// See [`trajectory::read`] and [`trajectory::Recorded::into_trajectory`].
    pub(super) fn read(
        file: &Path,
        accuracy: Option<&Path>,
        keys: &GeometryKeys,
        wanted: &Wanted,
    ) -> Result<Track> {
        let accuracy = accuracy.map(Path::to_path_buf);
        let recorded = trajectory::read(file, &options(keys, accuracy.clone()))?;
        let (times, mut notes) = (recorded.times(), recorded.notes.clone());
        let knows_accuracy = !recorded.accuracies.is_empty();
        let map = wanted.fixed();
        let unproject =
            map.as_ref().map(|map| |place| map.to_geodetic(place).map_err(|error| error.to_string()));
        let trajectory =
            recorded.into_trajectory(unproject.as_ref().map(|unproject| unproject as &Unproject))?;
        notes.extend(gaps(file, &trajectory));
        Ok(Track { file: file.to_path_buf(), accuracy, trajectory, times, knows_accuracy, notes })
    }
}

/// What the keys say of the files.
fn options(keys: &GeometryKeys, accuracy: Option<PathBuf>) -> Options {
    let time = keys.trajectory_time.map(|time| match time {
        TimeKey::Week => Clock::Week,
        TimeKey::Day => Clock::Day,
        TimeKey::Adjusted => Clock::Adjusted,
    });
    let angles = keys.trajectory_angles.map(|angles| match angles {
        AnglesKey::Deg => Angles::Degrees,
        AnglesKey::Rad => Angles::Radians,
    });
    Options { time, angles, columns: keys.trajectory_columns.clone(), accuracy }
}

/// What there is to say of gaps.
fn gaps(file: &Path, trajectory: &Trajectory) -> Option<String> {
    let gaps = trajectory.gaps();
    let longest = gaps.iter().max_by(|a, b| a.length_s().total_cmp(&b.length_s()))?;
    let open = gaps.iter().filter(|gap| !gap.is_bridged).count();
    let Gap { between_s: [from_s, _], .. } = longest;
    Some(format!(
        "{}: {} steps of the trajectory are over twice as long as usual ({:.4} s), the longest of {:.3} s at {from_s:.3} s; poses \
         are interpolated across those of up to {:.3} s, and shots within the other {open} are left out",
        file.display(),
        gaps.len(),
        trajectory.median_step_s(),
        longest.length_s(),
        trajectory.longest_bridged_s(),
    ))
}
