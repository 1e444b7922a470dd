//! Parameters of an adjustment, their priors, and their places among the unknowns.

use core::fmt;
use core::str::FromStr;

use wavex_geodesy::trajectory::corrections::{CorrectionKnot, PoseOffset, TrajectoryCorrections};

use crate::scanner::Scanner;
use crate::sparse::BlockMatrix;

/// Number of parameters of an installation.
pub const GLOBALS: usize = 14;
/// Number of offsets of a knot: north, east, down, roll, pitch, heading.
pub const OFFSETS: usize = 6;
/// Knots of a node of the normal matrix.
const KNOTS_PER_NODE: usize = 8;

/// A parameter of an installation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(usize)]
pub enum Global {
    /// Lever arm forward, m.
    LeverForward,
    /// Lever arm to the right, m.
    LeverRight,
    /// Lever arm downwards, m.
    LeverDown,
    /// Boresight roll, rad.
    Roll,
    /// Boresight pitch, rad.
    Pitch,
    /// Boresight yaw, rad.
    Yaw,
    /// Range offset, m.
    E0,
    /// Range scale.
    E1,
    /// Scan angle scale.
    E2,
    /// Quadratic scan angle correction, per rad.
    E3,
    /// Cubic scan angle correction, per rad².
    E4,
    /// Scan angle offset, rad.
    E6,
    /// Range offset of the low-power receiver, m.
    E7,
    /// Time offset, s.
    Time,
}

impl Global {
    /// All, in the order of the unknowns.
    pub const ALL: [Global; GLOBALS] = [
        Global::LeverForward,
        Global::LeverRight,
        Global::LeverDown,
        Global::Roll,
        Global::Pitch,
        Global::Yaw,
        Global::E0,
        Global::E1,
        Global::E2,
        Global::E3,
        Global::E4,
        Global::E6,
        Global::E7,
        Global::Time,
    ];

    /// Name with unit.
    pub fn name(self) -> &'static str {
        match self {
            Global::LeverForward => "lever_forward_m",
            Global::LeverRight => "lever_right_m",
            Global::LeverDown => "lever_down_m",
            Global::Roll => "boresight_roll_rad",
            Global::Pitch => "boresight_pitch_rad",
            Global::Yaw => "boresight_yaw_rad",
            Global::E0 => "e0_m",
            Global::E1 => "e1",
            Global::E2 => "e2",
            Global::E3 => "e3_per_rad",
            Global::E4 => "e4_per_rad2",
            Global::E6 => "e6_rad",
            Global::E7 => "e7_m",
            Global::Time => "time_offset_s",
        }
    }

    /// Text and unit for people, and the unit's size in that of the name; ratios have no unit.
    pub fn label(self) -> (&'static str, &'static str, f64) {
        let degree = 1f64.to_radians();
        match self {
            Global::LeverForward => ("lever arm forward", "m", 1.0),
            Global::LeverRight => ("lever arm right", "m", 1.0),
            Global::LeverDown => ("lever arm down", "m", 1.0),
            Global::Roll => ("boresight roll", "deg", degree),
            Global::Pitch => ("boresight pitch", "deg", degree),
            Global::Yaw => ("boresight yaw", "deg", degree),
            Global::E0 => ("range offset e0", "m", 1.0),
            Global::E1 => ("range scale e1", "", 1.0),
            Global::E2 => ("scan angle scale e2", "", 1.0),
            Global::E3 => ("quadratic scan angle e3", "1/rad", 1.0),
            Global::E4 => ("cubic scan angle e4", "1/rad²", 1.0),
            Global::E6 => ("scan angle offset e6", "rad", 1.0),
            Global::E7 => ("range offset e7", "m", 1.0),
            Global::Time => ("time offset", "ms", 1e-3),
        }
    }

    /// Value of a scanner, in the unit of the name.
    pub fn of(self, scanner: &Scanner) -> f64 {
        let c = &scanner.calibration;
        match self {
            Global::LeverForward => c.lever_arm_m[0],
            Global::LeverRight => c.lever_arm_m[1],
            Global::LeverDown => c.lever_arm_m[2],
            Global::Roll => c.boresight_deg[0].to_radians(),
            Global::Pitch => c.boresight_deg[1].to_radians(),
            Global::Yaw => c.boresight_deg[2].to_radians(),
            Global::E0 => c.e0,
            Global::E1 => c.e1,
            Global::E2 => c.e2,
            Global::E3 => c.e3,
            Global::E4 => c.e4,
            Global::E6 => c.e6,
            Global::E7 => c.e7,
            Global::Time => scanner.calibration.time_offset_s,
        }
    }

    /// Adds to the value of a scanner, in the unit of the name.
    pub fn add_to(self, scanner: &mut Scanner, change: f64) {
        let c = &mut scanner.calibration;
        match self {
            Global::LeverForward => c.lever_arm_m[0] += change,
            Global::LeverRight => c.lever_arm_m[1] += change,
            Global::LeverDown => c.lever_arm_m[2] += change,
            Global::Roll => c.boresight_deg[0] += change.to_degrees(),
            Global::Pitch => c.boresight_deg[1] += change.to_degrees(),
            Global::Yaw => c.boresight_deg[2] += change.to_degrees(),
            Global::E0 => c.e0 += change,
            Global::E1 => c.e1 += change,
            Global::E2 => c.e2 += change,
            Global::E3 => c.e3 += change,
            Global::E4 => c.e4 += change,
            Global::E6 => c.e6 += change,
            Global::E7 => c.e7 += change,
            Global::Time => scanner.calibration.time_offset_s += change,
        }
    }
}

/// Standard deviations of the start values of an installation, in the order of [`Global`]; 0 keeps a value.
///
/// The default is a scanner with a lever arm from a drawing, and a boresight that is unknown within degrees. Scale and
/// shape of ranges and angles are kept: they are known from the laboratory, and e6 equals the boresight roll.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GlobalPriors(pub [f64; GLOBALS]);

impl Default for GlobalPriors {
    fn default() -> GlobalPriors {
        let degree = 1f64.to_radians();
        GlobalPriors([
            0.05,
            0.05,
            0.05,
            degree,
            degree,
            2.0 * degree,
            0.05,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
            0.002,
        ])
    }
}

/// Form of the corrections of a strip's trajectory.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TrajectoryModel {
    /// No corrections.
    None,
    /// One offset per strip.
    Constant,
    /// Offsets that are linear in time.
    Linear,
    /// Offsets at knots of at most this distance, s, linear between them.
    Spline(f64),
}

impl FromStr for TrajectoryModel {
    type Err = String;

    /// `none`, `constant`, `linear`, or the distance of knots, s; the error says what to give.
    fn from_str(text: &str) -> Result<TrajectoryModel, String> {
        match text {
            "none" => Ok(TrajectoryModel::None),
            "constant" => Ok(TrajectoryModel::Constant),
            "linear" => Ok(TrajectoryModel::Linear),
            _ => {
                let step_s = text.parse().ok().filter(|step_s: &f64| (0.1..=1e6).contains(step_s));
                step_s.map(TrajectoryModel::Spline).ok_or_else(|| {
                    "give none, constant, linear, or the distance of knots in seconds, at least 0.1"
                        .to_owned()
                })
            }
        }
    }
}

impl fmt::Display for TrajectoryModel {
    /// The text that is parsed as this model.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            TrajectoryModel::None => f.write_str("none"),
            TrajectoryModel::Constant => f.write_str("constant"),
            TrajectoryModel::Linear => f.write_str("linear"),
            TrajectoryModel::Spline(step_s) => write!(f, "{step_s}"),
        }
    }
}

/// Standard deviations of trajectories, and how fast their errors change.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrajectoryPriors {
    /// SDs of north, east, down, m, and roll, pitch, heading, rad; 0 keeps a component.
    ///
    /// Used where the trajectory has no accuracy.
    pub sd: [f64; OFFSETS],
    /// Factor of the SDs that come from the trajectory's accuracies.
    pub accuracy_factor: f64,
    /// Correlation time of the errors of position and attitude, s; above 0.
    pub correlation_s: [f64; 2],
}

impl Default for TrajectoryPriors {
    fn default() -> TrajectoryPriors {
        let millidegree = 1e-3f64.to_radians();
        TrajectoryPriors {
            sd: [0.03, 0.03, 0.04, 1.5 * millidegree, 1.5 * millidegree, 4.0 * millidegree],
            accuracy_factor: 1.0,
            correlation_s: [120.0, 300.0],
        }
    }
}

/// Knot times of a strip between its first and last observation.
///
/// At most [`MOST_KNOTS`]; a shorter distance of knots is made longer.
pub(crate) fn knot_times(model: TrajectoryModel, span_s: [f64; 2]) -> Vec<f64> {
    let [first_s, last_s] = span_s;
    let length_s = last_s - first_s;
    let intervals = match model {
        TrajectoryModel::None => return Vec::new(),
        TrajectoryModel::Constant => 0,
        TrajectoryModel::Linear => 1,
        TrajectoryModel::Spline(step_s) => ((length_s / step_s).ceil() as usize).clamp(1, MOST_KNOTS - 1),
    };
    if intervals == 0 || length_s <= 0.0 {
        return vec![0.5 * (first_s + last_s)];
    }
    (0..=intervals).map(|k| first_s + length_s * k as f64 / intervals as f64).collect()
}

/// Most knots of a strip.
pub const MOST_KNOTS: usize = 10_000;

/// Places of the parameters among the unknowns: knots of all strips, then installations.
#[derive(Clone, Debug)]
pub(crate) struct Layout {
    /// First unknown of each strip, and the end.
    strip_starts: Vec<usize>,
    /// First unknown of each node, and the end.
    node_starts: Vec<usize>,
    pub(crate) installations: usize,
}

impl Layout {
    pub(crate) fn new(knots: &[usize], installations: usize) -> Layout {
        let (mut strip_starts, mut node_starts) = (vec![0], Vec::new());
        let mut next = 0;
        for &count in knots {
            for first in (0..count).step_by(KNOTS_PER_NODE) {
                node_starts.push(next);
                next += OFFSETS * (count - first).min(KNOTS_PER_NODE);
            }
            strip_starts.push(next);
        }
        node_starts.push(next);
        node_starts.push(next + GLOBALS * installations);
        Layout { strip_starts, node_starts, installations }
    }

    /// Number of unknowns.
    pub(crate) fn len(&self) -> usize {
        self.globals_start() + GLOBALS * self.installations
    }

    /// First unknown of the installations.
    pub(crate) fn globals_start(&self) -> usize {
        self.strip_starts[self.strip_starts.len() - 1]
    }

    /// Node of the installations.
    pub(crate) fn globals_node(&self) -> usize {
        self.node_starts.len() - 2
    }

    pub(crate) fn global(&self, installation: usize, global: usize) -> usize {
        self.globals_start() + GLOBALS * installation + global
    }

    pub(crate) fn knot(&self, strip: usize, knot: usize) -> usize {
        self.strip_starts[strip] + OFFSETS * knot
    }

    pub(crate) fn node_start(&self, node: usize) -> usize {
        self.node_starts[node]
    }

    pub(crate) fn matrix(&self) -> BlockMatrix {
        BlockMatrix::new(self.node_starts.windows(2).map(|pair| pair[1] - pair[0]).collect())
    }

    /// Node of an unknown, and its place there.
    pub(crate) fn place(&self, unknown: usize) -> (usize, usize) {
        let node = self.node_starts.partition_point(|start| *start <= unknown) - 1;
        (node, unknown - self.node_starts[node])
    }
}

/// Weights of the knots around a time: index of the first, and weights of it and the next.
pub(crate) fn knot_weights(times_s: &[f64], time_s: f64) -> Option<(usize, [f64; 2])> {
    let last = times_s.len().checked_sub(1)?;
    let after = times_s.partition_point(|knot_s| *knot_s <= time_s);
    if after == 0 {
        return Some((0, [1.0, 0.0]));
    }
    if after > last {
        return Some((last, [1.0, 0.0]));
    }
    let (before_s, after_s) = (times_s[after - 1], times_s[after]);
    let part = (time_s - before_s) / (after_s - before_s);
    Some((after - 1, [1.0 - part, part]))
}

/// Corrections of zero at these knots; `None` without knots.
pub(crate) fn no_corrections(times_s: &[f64]) -> Option<TrajectoryCorrections> {
    let knots = times_s.iter().map(|&time_s| CorrectionKnot { time_s, offset: PoseOffset::default() });
    TrajectoryCorrections::new(knots.collect()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knots_cover_the_strip() {
        assert!(knot_times(TrajectoryModel::None, [10.0, 20.0]).is_empty());
        assert_eq!(knot_times(TrajectoryModel::Constant, [10.0, 20.0]), [15.0]);
        assert_eq!(knot_times(TrajectoryModel::Linear, [10.0, 20.0]), [10.0, 20.0]);
        assert_eq!(knot_times(TrajectoryModel::Spline(4.0), [10.0, 22.0]), [10.0, 14.0, 18.0, 22.0]);
        assert_eq!(knot_times(TrajectoryModel::Spline(1e-9), [10.0, 22.0]).len(), MOST_KNOTS);
        assert_eq!(knot_times(TrajectoryModel::Spline(4.0), [10.0, 10.0]), [10.0]);
    }

    #[test]
    fn weights_are_those_of_the_corrections() {
        let times_s = [10.0, 14.0, 18.0];
        for (k, _) in times_s.iter().enumerate() {
            let mut knots = no_corrections(&times_s).unwrap().knots().to_vec();
            knots[k].offset.north_east_down_m[1] = 1.0;
            let corrections = TrajectoryCorrections::new(knots).unwrap();
            for time_s in [0.0, 10.0, 11.0, 14.0, 17.5, 18.0, 99.0] {
                let (first, weights) = knot_weights(&times_s, time_s).unwrap();
                let found: f64 = weights
                    .iter()
                    .enumerate()
                    .filter(|(j, _)| first + j == k)
                    .map(|(_, weight)| weight)
                    .sum();
                assert_eq!(found, corrections.at(time_s).north_east_down_m[1], "{k} {time_s}");
            }
        }
    }

    #[test]
    fn every_unknown_has_a_place() {
        let layout = Layout::new(&[1, 0, 20], 2);
        assert_eq!(layout.len(), 21 * 6 + 28);
        assert_eq!(layout.knot(2, 9), 60);
        assert_eq!(layout.place(60), (2, 60 - layout.node_start(2)));
        assert_eq!(layout.place(layout.global(1, 3)), (layout.globals_node(), 17));
    }

    #[test]
    fn parameters_are_read_where_they_are_added() {
        let mut scanner =
            Scanner { body_from_mount: wavex_geodesy::frames::IDENTITY, calibration: Default::default() };
        for (k, global) in Global::ALL.into_iter().enumerate() {
            assert_eq!(global as usize, k);
            global.add_to(&mut scanner, 0.25 + k as f64);
        }
        for (k, global) in Global::ALL.into_iter().enumerate() {
            assert!((global.of(&scanner) - 0.25 - k as f64).abs() < 1e-14);
        }
    }
}
