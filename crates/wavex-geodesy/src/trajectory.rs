//! Interpolation of positions and attitudes between the records of a trajectory.
//!
//! Between two records, position and attitude are interpolated by the cubic through them and their
//! outer neighbours (Lagrange's formula, also for uneven steps). Positions are interpolated in the
//! earth-centred frame, attitudes as rotations relative to the previous record, in modified
//! Rodrigues parameters. Therefore the 180-degree meridian, the 360-degree heading and the poles
//! need no special treatment. Times are on one continuous axis (see [`super::time_axis`]). Results
//! are bit-identical on every machine: only `+ - * /`, square roots and the crate `libm` are used.
//!
//! A step of over twice the median is a [`Gap`]. Short gaps are interpolated, up to
//! 0.2 s or five median steps, whichever is longer. Inside longer gaps, and outside
//! the records, there is no pose.

use core::ops::Range;

use wavex_simd::statistics::median;

use super::ellipsoid::{Geodetic, WGS84};
use super::frames::{Attitude, Rotation, Vector, ecef_from_ned, then};
use accuracies::Accuracies;
pub use error::TrajectoryError;
use outliers::Outlier;
use quaternion::Quaternion;
use time_index::TimeIndex;

mod accuracies;
pub mod corrections;
mod error;
pub mod outliers;
pub mod plausibility;
mod quaternion;
#[cfg(test)]
mod tests;
mod time_index;

/// Longest gap that is interpolated, s.
///
/// The error of the cubic across a gap `T`, for a sway of amplitude `A` and angular frequency `w`,
/// is up to `A (w T)^4 / 384`. For 3 degrees at 0.5 Hz this is 0.0012 degrees at 0.2 s, or 3 cm at
/// 1500 m, and sixteen times as much for twice the gap.
const LONGEST_BRIDGED_S: f64 = 0.2;
/// Gaps of up to this many median steps are also interpolated; a trajectory of 1 Hz has no shorter
/// ones.
const LONGEST_BRIDGED_STEPS: f64 = 5.0;
/// Steps of more than this many medians are gaps: twice, plus a thousandth for the rounding of
/// times.
const GAP_STEPS: f64 = 2.001;
/// A neighbour closer than this fraction of the interpolated step is ignored: it adds only noise.
const CLOSEST: f64 = 1e-3;

/// A record: position on the WGS 84 ellipsoid, and attitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Time on one continuous axis, s.
    pub time_s: f64,
    /// Position of the body's origin.
    pub place: Geodetic,
    /// Attitude of the body relative to north, east, down at the position.
    pub attitude: Attitude,
}

/// Standard deviations of a pose.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Accuracy {
    /// North, east, down, m.
    pub position_sd_m: [f64; 3],
    /// Roll, pitch, heading, rad.
    pub attitude_sd_rad: [f64; 3],
}

/// Accuracy at a time; usually sparser than the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AccuracySample {
    /// Time on the axis of the trajectory, s.
    pub time_s: f64,
    /// Accuracy at that time.
    pub accuracy: Accuracy,
}

/// Position and orientation of the body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Origin of the body in the earth-centred frame of WGS 84, m.
    pub origin_in_ecef_m: Vector,
    /// Rotation from the body (forward, right, down) to the earth-centred frame.
    pub ecef_from_body: Rotation,
    /// Accuracy; `None` if unknown at this time.
    pub accuracy: Option<Accuracy>,
}

/// A gap between two records.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// Index of the record before the gap.
    pub record: usize,
    /// Times of the records before and after it, s.
    pub between_s: [f64; 2],
    /// Whether poses are interpolated inside.
    pub is_bridged: bool,
}

impl Gap {
    /// Length, s.
    pub fn length_s(&self) -> f64 {
        self.between_s[1] - self.between_s[0]
    }
}

/// A trajectory: see the [module](self). Takes 124 bytes of memory per record.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    samples: Vec<Sample>,
    nodes: Vec<EcefSample>,
    index: TimeIndex,
    median_step_s: f64,
    longest_bridged_s: f64,
    gaps: Vec<Gap>,
    accuracies: Option<Accuracies>,
}

/// A sample in the earth-centred frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct EcefSample {
    position_m: Vector,
    ecef_from_body: Quaternion,
}

impl Trajectory {
    /// Creates a trajectory from samples in order of time.
    ///
    /// # Errors
    /// Fewer than two samples, values that are not finite, latitudes beyond the poles, unordered or
    /// duplicate times.
    pub fn new(samples: Vec<Sample>) -> Result<Trajectory, TrajectoryError> {
        for (record, sample) in samples.iter().enumerate() {
            check_sample(record, sample)?;
        }
        let index = index(samples.iter().map(|sample| sample.time_s).collect())?;
        let nodes = samples.iter().map(EcefSample::of).collect();
        let median_step_s = median_step_s(index.times_s());
        let longest_bridged_s = LONGEST_BRIDGED_S.max(LONGEST_BRIDGED_STEPS * median_step_s);
        let gaps = gaps(index.times_s(), median_step_s, longest_bridged_s);
        Ok(Trajectory { samples, nodes, index, median_step_s, longest_bridged_s, gaps, accuracies: None })
    }

    /// Adds accuracies; their times may differ from the times of the samples.
    ///
    /// They are interpolated linearly; outside their time span there are none.
    ///
    /// # Errors
    /// As for [`Trajectory::new`]; record numbers refer to the accuracies.
    pub fn with_accuracies(mut self, samples: Vec<AccuracySample>) -> Result<Trajectory, TrajectoryError> {
        self.accuracies = Some(Accuracies::new(&samples)?);
        Ok(self)
    }

    /// The trajectory without these records.
    ///
    /// # Errors
    /// Fewer than two samples are left.
    pub fn without(self, outliers: &[Outlier]) -> Result<Trajectory, TrajectoryError> {
        let mut next = outliers.iter().map(|outlier| outlier.record).peekable();
        let samples = self.samples.into_iter().enumerate();
        let kept = samples.filter(|(record, _)| next.next_if_eq(record).is_none()).map(|(_, sample)| sample);
        Ok(Trajectory { accuracies: self.accuracies, ..Trajectory::new(kept.collect())? })
    }

    /// First and last time, s.
    pub fn span_s(&self) -> [f64; 2] {
        self.index.span_s()
    }

    /// The samples as given.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Median time between records, s.
    pub fn median_step_s(&self) -> f64 {
        self.median_step_s
    }

    /// Longest gap that is interpolated, s.
    pub fn longest_bridged_s(&self) -> f64 {
        self.longest_bridged_s
    }

    /// Steps of over twice the median, in order of time.
    pub fn gaps(&self) -> &[Gap] {
        &self.gaps
    }

    /// Pose at a time; `None` outside the time span and inside gaps that are not interpolated.
    pub fn pose(&self, time_s: f64) -> Option<Pose> {
        self.poses().at(time_s)
    }

    /// Poses for a sequence of times; neighbours are cached between nearby times.
    ///
    /// # Examples
    ///
    /// ```
    /// use wavex_geodesy::ellipsoid::Geodetic;
    /// use wavex_geodesy::frames::Attitude;
    /// use wavex_geodesy::trajectory::{Sample, Trajectory};
    ///
    /// let sample = |time_s: f64| Sample {
    ///     time_s,
    ///     place: Geodetic { latitude_rad: 0.8 + 1e-5 * time_s, longitude_rad: 0.2, height_m: 1000.0 },
    ///     attitude: Attitude::default(),
    /// };
    /// let trajectory = Trajectory::new((0..10).map(|k| sample(f64::from(k))).collect())?;
    /// let mut poses = trajectory.poses();
    /// assert!(poses.at(4.25).is_some());
    /// assert!(poses.at(9.5).is_none(), "after the last record");
    /// # Ok::<(), wavex_geodesy::trajectory::TrajectoryError>(())
    /// ```
    pub fn poses(&self) -> Poses<'_> {
        Poses { trajectory: self, last: None }
    }

    /// Records used to interpolate between record `before` and the next.
    ///
    /// Both records, and their outer neighbours unless separated by a gap; `None` inside a gap that
    /// is not interpolated.
    fn around(&self, before: usize, time_s: f64) -> Option<Range<usize>> {
        let times_s = self.index.times_s();
        let [start_s, end_s] = [times_s[before], times_s[before + 1]];
        let step_s = end_s - start_s;
        if step_s > self.longest_bridged_s {
            // The bounding records are not part of the gap.
            let at = if time_s == start_s { Some(before) } else { (time_s == end_s).then_some(before + 1) };
            return at.map(|record| record..record + 1);
        }
        let is_useful = |step: f64| step <= self.longest_bridged_s && step >= CLOSEST * step_s;
        let first =
            before.checked_sub(1).filter(|&first| is_useful(start_s - times_s[first])).unwrap_or(before);
        let has_after = times_s.get(before + 2).is_some_and(|time_s| is_useful(time_s - end_s));
        Some(first..before + 2 + usize::from(has_after))
    }
}

/// Sequential access to the poses of a [`Trajectory`].
#[derive(Clone, Debug)]
pub struct Poses<'a> {
    trajectory: &'a Trajectory,
    last: Option<Neighbours>,
}

impl Poses<'_> {
    /// As [`Trajectory::pose`].
    pub fn at(&mut self, time_s: f64) -> Option<Pose> {
        let trajectory = self.trajectory;
        let times_s = trajectory.index.times_s();
        let is_same = |last: &&Neighbours| (times_s[last.before]..times_s[last.before + 1]).contains(&time_s);
        let before = match self.last.as_ref().filter(is_same) {
            Some(last) => last.before,
            None => trajectory.index.before(time_s)?,
        };
        let around = trajectory.around(before, time_s)?;
        let near = match self.last.take() {
            Some(last) if last.before == before && last.around == around => last,
            _ => Neighbours::of(trajectory, before, around),
        };
        let near = self.last.insert(near);
        let weights = weights(&times_s[near.around.clone()], time_s);
        let (mut moved_m, mut turned) = ([0.0; 3], [0.0; 3]);
        for ((moved_by_m, turned_by), weight) in near.moved_m.iter().zip(&near.turned).zip(weights) {
            for axis in 0..3 {
                moved_m[axis] += weight * moved_by_m[axis];
                turned[axis] += weight * turned_by[axis];
            }
        }
        let base = &trajectory.nodes[before];
        Some(Pose {
            origin_in_ecef_m: core::array::from_fn(|axis| base.position_m[axis] + moved_m[axis]),
            ecef_from_body: base.ecef_from_body.after(&Quaternion::of_parameters(turned)).rotation(),
            accuracy: trajectory.accuracies.as_ref().and_then(|accuracies| accuracies.at(time_s)),
        })
    }
}

/// The records used to interpolate between two of them.
#[derive(Clone, Debug)]
struct Neighbours {
    /// Index of the record before the interpolated times.
    before: usize,
    around: Range<usize>,
    /// Displacement and rotation of each of `around` relative to that record; zero beyond the last.
    moved_m: [Vector; 4],
    turned: [[f64; 3]; 4],
}

impl Neighbours {
    fn of(trajectory: &Trajectory, before: usize, around: Range<usize>) -> Neighbours {
        let base = &trajectory.nodes[before];
        let to_body = base.ecef_from_body.inverse();
        let (mut moved_m, mut turned) = ([[0.0; 3]; 4], [[0.0; 3]; 4]);
        let nodes = &trajectory.nodes[around.clone()];
        for ((node, moved_m), turned) in nodes.iter().zip(&mut moved_m).zip(&mut turned) {
            *moved_m = core::array::from_fn(|axis| node.position_m[axis] - base.position_m[axis]);
            *turned = to_body.after(&node.ecef_from_body).parameters();
        }
        Neighbours { before, around, moved_m, turned }
    }
}

impl EcefSample {
    fn of(sample: &Sample) -> EcefSample {
        let Geodetic { latitude_rad, longitude_rad, .. } = sample.place;
        let ecef_from_body =
            then(&sample.attitude.ned_from_body(), &ecef_from_ned(latitude_rad, longitude_rad));
        EcefSample {
            position_m: WGS84.ecef_of(sample.place),
            ecef_from_body: Quaternion::of(&ecef_from_body),
        }
    }
}

/// Lagrange weights at `time_s` of up to four values at these times.
fn weights(times_s: &[f64], time_s: f64) -> [f64; 4] {
    let mut weights = [0.0; 4];
    for (j, (weight, own_s)) in weights.iter_mut().zip(times_s).enumerate() {
        let (mut above, mut below) = (1.0, 1.0);
        for (k, other_s) in times_s.iter().enumerate() {
            if k != j {
                above *= time_s - other_s;
                below *= own_s - other_s;
            }
        }
        *weight = above / below;
    }
    weights
}

fn check_sample(record: usize, sample: &Sample) -> Result<(), TrajectoryError> {
    let Sample { time_s, place, attitude } = sample;
    let fields = [
        ("time", *time_s, f64::MAX),
        ("latitude", place.latitude_rad, core::f64::consts::FRAC_PI_2),
        ("longitude", place.longitude_rad, f64::MAX),
        ("height", place.height_m, f64::MAX),
        ("roll", attitude.roll_rad, f64::MAX),
        ("pitch", attitude.pitch_rad, f64::MAX),
        ("heading", attitude.heading_rad, f64::MAX),
    ];
    match fields.into_iter().find(|(_, value, most)| !matches!(value.abs(), size if size <= *most)) {
        Some((field, value, _)) => Err(TrajectoryError::Implausible { record, field, value }),
        None => Ok(()),
    }
}

/// Index of times that must be strictly ascending.
fn index(times_s: Vec<f64>) -> Result<TimeIndex, TrajectoryError> {
    let count = times_s.len();
    if count < 2 {
        return Err(TrajectoryError::TooFew { count });
    }
    if u32::try_from(count).is_err() {
        return Err(TrajectoryError::TooMany { count });
    }
    let steps = || times_s.windows(2).enumerate().map(|(k, pair)| (k + 1, pair[0], pair[1]));
    let many = |is: fn(f64, f64) -> bool| steps().filter(|&(_, a, b)| is(a, b)).count() - 1;
    match steps().find(|(_, before_s, time_s)| time_s <= before_s) {
        Some((record, before_s, time_s)) if time_s < before_s => {
            Err(TrajectoryError::Disorder { record, before_s, time_s, more: many(|a, b| b < a) })
        }
        Some((record, _, time_s)) => {
            Err(TrajectoryError::Duplicate { record, time_s, more: many(|a, b| a == b) })
        }
        None => Ok(TimeIndex::new(times_s)),
    }
}

fn median_step_s(times_s: &[f64]) -> f64 {
    median(times_s.array_windows().map(|[from, to]| to - from)).unwrap_or(f64::NAN)
}

fn gaps(times_s: &[f64], median_step_s: f64, longest_bridged_s: f64) -> Vec<Gap> {
    let steps =
        times_s.windows(2).enumerate().filter(|(_, pair)| pair[1] - pair[0] > GAP_STEPS * median_step_s);
    let gap = |(record, pair): (usize, &[f64])| Gap {
        record,
        between_s: [pair[0], pair[1]],
        is_bridged: pair[1] - pair[0] <= longest_bridged_s,
    };
    steps.map(gap).collect()
}
