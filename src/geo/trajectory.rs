//! Where a body was, and how it was turned, at any moment between the records of its trajectory.
//!
//! Between two records, position and attitude are the cubic through them and their outer neighbours (Lagrange's formula,
//! for uneven steps as well): the position in the earth-centred frame, the attitude as the rotation from the record
//! before, in modified Rodrigues parameters. So neither a meridian of 180 degrees nor a heading of 360 nor a pole is
//! anything special. Times stand on one continuous axis (see [`super::time_axis`]). Everything is made of `+ - * /`, square
//! roots and the crate `libm`: the same bits on every machine.
//!
//! A step of over twice the median is a [`Gap`]. Interpolation goes on across the short ones, up to
//! [`LONGEST_BRIDGED_S`] or five median steps, whichever is longer; inside a longer one, as outside of the records, there
//! is no pose.

use core::ops::Range;

use super::ellipsoid::{Geodetic, WGS84};
use super::frames::{Attitude, Rotation, Vector, ecef_from_ned, then};
use quaternion::Quaternion;
use time_index::TimeIndex;

mod quaternion;
#[cfg(test)]
mod tests;
mod time_index;

/// Interpolation goes on across gaps up to this, s. The cubic across a gap `T` misses a sway of amplitude `A` and angular
/// frequency `w` by up to `A (w T)^4 / 384`: 3 degrees at 0.5 Hz by 0.0012 degrees at 0.2 s, which is 3 cm at 1500 m,
/// and sixteen times as much at twice the gap.
pub const LONGEST_BRIDGED_S: f64 = 0.2;
/// Gaps up to so many median steps are bridged, too: a trajectory of 1 Hz has no shorter ones.
const LONGEST_BRIDGED_STEPS: f64 = 5.0;
/// A step over so many medians is a gap: over twice, and the thousandth keeps the rounding of times out.
const GAP_STEPS: f64 = 2.001;
/// A neighbour closer to its record than this share of the step that is bridged says nothing but its own noise.
const CLOSEST: f64 = 1e-3;

/// A record: a place on the ellipsoid of WGS 84, and an attitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// On one continuous axis, s.
    pub time_s: f64,
    /// Of the body's origin.
    pub place: Geodetic,
    /// Of the body against north, east, down at the place.
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

/// The accuracy at a time; often there are fewer of these than of samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AccuracySample {
    /// On the axis of the trajectory, s.
    pub time_s: f64,
    /// The accuracy then.
    pub accuracy: Accuracy,
}

/// Where the body is, and how it is turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// The body's origin in the earth-centred frame of WGS 84, m.
    pub origin_in_ecef_m: Vector,
    /// From the body (forward, right, down) to the earth-centred frame.
    pub ecef_from_body: Rotation,
    /// How surely; `None` where nothing says it for this time.
    pub accuracy: Option<Accuracy>,
}

/// Two records between which others are missing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// The record before it, from 0.
    pub record: usize,
    /// Time of the records before and behind it, s.
    pub between_s: [f64; 2],
    /// Whether there are poses inside.
    pub is_bridged: bool,
}

impl Gap {
    /// How long it is, s.
    pub fn length_s(&self) -> f64 {
        self.between_s[1] - self.between_s[0]
    }
}

/// Why records are no trajectory. Records are counted from 1 in the messages, from 0 in the fields.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Problem {
    /// Nothing lies between the records.
    #[error("{count} record(s): a pose takes two at least")]
    TooFew {
        /// How many there are.
        count: usize,
    },
    /// More records than are counted.
    #[error("{count} records: there is room for {} at most", u32::MAX)]
    TooMany {
        /// How many there are.
        count: usize,
    },
    /// Not a number, infinite, or a latitude beyond the poles.
    #[error("record {}: its {field} is {value}", record + 1)]
    Implausible {
        /// Which record.
        record: usize,
        /// Which of its fields.
        field: &'static str,
        /// What stands there.
        value: f64,
    },
    /// Times that run backwards.
    #[error(
        "record {}: its time {time_s} s lies before the {before_s} s of record {record}{}",
        record + 1,
        and_more(*more)
    )]
    Disorder {
        /// The record that comes too late.
        record: usize,
        /// The time of the record before it, s.
        before_s: f64,
        /// Its own, s.
        time_s: f64,
        /// Later records of this kind.
        more: usize,
    },
    /// Two records of one time.
    #[error(
        "records {record} and {} have the same time {time_s} s{}",
        record + 1,
        and_more(*more)
    )]
    Duplicate {
        /// The second of both.
        record: usize,
        /// The time of both, s.
        time_s: f64,
        /// Later records of this kind.
        more: usize,
    },
}

impl Problem {
    /// The record at fault, from 0, where it is one.
    pub fn record(&self) -> Option<usize> {
        match *self {
            Problem::TooFew { .. } | Problem::TooMany { .. } => None,
            Problem::Implausible { record, .. }
            | Problem::Disorder { record, .. }
            | Problem::Duplicate { record, .. } => Some(record),
        }
    }

    /// What the user can do.
    pub fn remedy(&self) -> &'static str {
        match self {
            Problem::TooFew { .. } | Problem::Implausible { .. } => "export it again from its source",
            Problem::TooMany { .. } => "cut it into parts",
            Problem::Disorder { .. } => "sort its records by time",
            Problem::Duplicate { .. } => "keep one record of each time",
        }
    }
}

fn and_more(more: usize) -> String {
    if more == 0 { String::new() } else { format!(" (and {more} more like this)") }
}

/// A trajectory: see the [module](self). It takes 124 bytes of memory per record.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    samples: Vec<Sample>,
    nodes: Vec<Node>,
    index: TimeIndex,
    median_step_s: f64,
    longest_bridged_s: f64,
    gaps: Vec<Gap>,
    accuracies: Option<Accuracies>,
}

/// A sample in the earth-centred frame.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Node {
    position_m: Vector,
    ecef_from_body: Quaternion,
}

impl Trajectory {
    /// The trajectory through these samples, in order of time.
    ///
    /// # Errors
    /// Fewer than two samples, numbers that are none, latitudes beyond the poles, times in disorder or twice.
    pub fn new(samples: Vec<Sample>) -> Result<Trajectory, Problem> {
        for (record, sample) in samples.iter().enumerate() {
            check_sample(record, sample)?;
        }
        let index = index(samples.iter().map(|sample| sample.time_s).collect())?;
        let nodes = samples.iter().map(Node::of).collect();
        let median_step_s = median_step_s(index.times_s());
        let longest_bridged_s = LONGEST_BRIDGED_S.max(LONGEST_BRIDGED_STEPS * median_step_s);
        let gaps = gaps(index.times_s(), median_step_s, longest_bridged_s);
        Ok(Trajectory { samples, nodes, index, median_step_s, longest_bridged_s, gaps, accuracies: None })
    }

    /// The same with accuracies, whose times need not be those of the samples: between two of them they are linear,
    /// outside of their span there are none.
    ///
    /// # Errors
    /// As for [`Trajectory::new`]; the records are those of the accuracies.
    pub fn with_accuracies(mut self, samples: Vec<AccuracySample>) -> Result<Trajectory, Problem> {
        self.accuracies = Some(Accuracies::new(&samples)?);
        Ok(self)
    }

    /// The first and the last time, s.
    pub fn span_s(&self) -> [f64; 2] {
        self.index.span_s()
    }

    /// The samples, as they were given.
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// The usual time from one record to the next, s.
    pub fn median_step_s(&self) -> f64 {
        self.median_step_s
    }

    /// Gaps up to this have poses inside, s.
    pub fn longest_bridged_s(&self) -> f64 {
        self.longest_bridged_s
    }

    /// Steps of over twice the median, in order of time.
    pub fn gaps(&self) -> &[Gap] {
        &self.gaps
    }

    /// The pose at a time; `None` outside the span and inside gaps that are not bridged.
    pub fn pose(&self, time_s: f64) -> Option<Pose> {
        self.poses().at(time_s)
    }

    /// Poses at many times, each mostly near the one before: that one's neighbours are looked at once.
    pub fn poses(&self) -> Poses<'_> {
        Poses { trajectory: self, last: None }
    }

    /// The records that tell about a time between record `before` and the next: both, and the neighbours on either side
    /// where no gap lies between; `None` inside a gap that is not bridged.
    fn around(&self, before: usize, time_s: f64) -> Option<Range<usize>> {
        let times_s = self.index.times_s();
        let [start_s, end_s] = [times_s[before], times_s[before + 1]];
        let step_s = end_s - start_s;
        if step_s > self.longest_bridged_s {
            // The record itself is no part of the gap that begins or ends with it.
            let at = if time_s == start_s { Some(before) } else { (time_s == end_s).then_some(before + 1) };
            return at.map(|record| record..record + 1);
        }
        let tells = |step: f64| step <= self.longest_bridged_s && step >= CLOSEST * step_s;
        let first = before.checked_sub(1).filter(|&first| tells(start_s - times_s[first])).unwrap_or(before);
        let behind = times_s.get(before + 2).is_some_and(|time_s| tells(time_s - end_s));
        Some(first..before + 2 + usize::from(behind))
    }
}

/// The poses of a [`Trajectory`].
#[derive(Clone, Debug)]
pub struct Poses<'a> {
    trajectory: &'a Trajectory,
    last: Option<Neighbours>,
}

impl Poses<'_> {
    /// What [`Trajectory::pose`] tells.
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

/// The records that tell about the times between two of them.
#[derive(Clone, Debug)]
struct Neighbours {
    /// The record before these times.
    before: usize,
    around: Range<usize>,
    /// How far each of `around` is from that record, and how it is turned from it; zeros behind the last.
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

impl Node {
    fn of(sample: &Sample) -> Node {
        let Geodetic { latitude_rad, longitude_rad, .. } = sample.place;
        let ecef_from_body =
            then(&sample.attitude.ned_from_body(), &ecef_from_ned(latitude_rad, longitude_rad));
        Node { position_m: WGS84.ecef_of(sample.place), ecef_from_body: Quaternion::of(&ecef_from_body) }
    }
}

/// Lagrange's weights of up to four values at these times, for the value at a time.
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

/// Accuracies over time.
#[derive(Clone, Debug, PartialEq)]
struct Accuracies {
    index: TimeIndex,
    values: Vec<Accuracy>,
}

impl Accuracies {
    fn new(samples: &[AccuracySample]) -> Result<Accuracies, Problem> {
        for (record, AccuracySample { time_s, accuracy }) in samples.iter().enumerate() {
            let [n, e, d] = accuracy.position_sd_m;
            let [roll, pitch, heading] = accuracy.attitude_sd_rad;
            let fields = [
                ("time", *time_s),
                ("standard deviation to the north", n),
                ("standard deviation to the east", e),
                ("standard deviation in height", d),
                ("standard deviation of the roll", roll),
                ("standard deviation of the pitch", pitch),
                ("standard deviation of the heading", heading),
            ];
            let is_bad =
                |&(field, value): &(&str, f64)| !value.is_finite() || (field != "time" && value < 0.0);
            if let Some((field, value)) = fields.into_iter().find(is_bad) {
                return Err(Problem::Implausible { record, field, value });
            }
        }
        let index = index(samples.iter().map(|sample| sample.time_s).collect())?;
        Ok(Accuracies { index, values: samples.iter().map(|sample| sample.accuracy).collect() })
    }

    fn at(&self, time_s: f64) -> Option<Accuracy> {
        let before = self.index.before(time_s)?;
        let (times_s, a, b) = (self.index.times_s(), &self.values[before], &self.values[before + 1]);
        let part = (time_s - times_s[before]) / (times_s[before + 1] - times_s[before]);
        let between = |a: [f64; 3], b: [f64; 3]| core::array::from_fn(|k| a[k] + part * (b[k] - a[k]));
        Some(Accuracy {
            position_sd_m: between(a.position_sd_m, b.position_sd_m),
            attitude_sd_rad: between(a.attitude_sd_rad, b.attitude_sd_rad),
        })
    }
}

fn check_sample(record: usize, sample: &Sample) -> Result<(), Problem> {
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
        Some((field, value, _)) => Err(Problem::Implausible { record, field, value }),
        None => Ok(()),
    }
}

/// The index of times that must be strictly ascending.
fn index(times_s: Vec<f64>) -> Result<TimeIndex, Problem> {
    let count = times_s.len();
    if count < 2 {
        return Err(Problem::TooFew { count });
    }
    if u32::try_from(count).is_err() {
        return Err(Problem::TooMany { count });
    }
    let steps = || times_s.windows(2).enumerate().map(|(k, pair)| (k + 1, pair[0], pair[1]));
    let many = |is: fn(f64, f64) -> bool| steps().filter(|&(_, a, b)| is(a, b)).count() - 1;
    match steps().find(|(_, before_s, time_s)| time_s <= before_s) {
        Some((record, before_s, time_s)) if time_s < before_s => {
            Err(Problem::Disorder { record, before_s, time_s, more: many(|a, b| b < a) })
        }
        Some((record, _, time_s)) => Err(Problem::Duplicate { record, time_s, more: many(|a, b| a == b) }),
        None => Ok(TimeIndex::new(times_s)),
    }
}

fn median_step_s(times_s: &[f64]) -> f64 {
    let mut steps: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let middle = steps.len() / 2;
    *steps.select_nth_unstable_by(middle, f64::total_cmp).1
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
