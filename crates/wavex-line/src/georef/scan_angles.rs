//! Scan angles and mirror directions for recordings that lack them.
//!
//! The scan angle is that of LAS: off the vertical, across the flight, positive to the right,
//! including roll. With a trajectory, the heading defines right ([`super::transform::scan_angle_deg`]).
//! Otherwise, in a projected CRS or on the earth, the course defines it, which is derived from the
//! origins of the beams. The mirror direction is the sign of the change of the angle.

use std::collections::VecDeque;

use super::transform::{cross, dot};
use crate::scan_line::{Emission, Frame, InputInfo, Kind, ScanLine, emission_flags};
use wavex_geodesy::frames::Vector;
use wavex_geodesy::vertical::{down_at, main_axis};
use wavex_signal::sensor_path::{Beam, Window};

/// Number of angle steps on each side that decide a direction.
///
/// Their majority decides, which bridges gaps in a line.
const REACH: usize = 4;

/// Whether any shot of a line lacks a scan angle.
pub fn are_unknown(emissions: &[Emission]) -> bool {
    emissions.iter().any(|emission| emission.scan_angle_deg.is_nan())
}

/// Sets the mirror direction of a line's shots from their scan angles.
///
/// A shot whose angle is constant or unknown keeps its flag.
pub fn set_directions(emissions: &mut [Emission]) {
    let sign = |pair: &[Emission]| match pair {
        [from, to] if to.scan_angle_deg > from.scan_angle_deg => 1,
        [from, to] if to.scan_angle_deg < from.scan_angle_deg => -1,
        _ => 0,
    };
    let steps: Vec<i32> = emissions.windows(2).map(sign).collect();
    for (at, emission) in emissions.iter_mut().enumerate() {
        let near = at.saturating_sub(REACH)..(at + REACH).min(steps.len());
        match steps[near].iter().sum::<i32>().signum() {
            1 => emission.flags |= emission_flags::SCAN_DIRECTION_POSITIVE,
            -1 => emission.flags &= !emission_flags::SCAN_DIRECTION_POSITIVE,
            _ => {}
        }
    }
}

/// Completes scan angles and directions of a line in body or scanner axes.
///
/// Body axes are forward, right and down. In the scanner frame, down is the axis nearest to the
/// mean beam, and right is the positive end of the axis along which the beams sweep.
pub fn complete_in_own_axes(frame: Frame, emissions: &mut [Emission]) {
    if !are_unknown(emissions) {
        return;
    }
    let (right, down) = match frame {
        Frame::Scanner => axes_of_scanner(emissions),
        _ => ([0.0, 1.0, 0.0], [0.0, 0.0, 1.0]),
    };
    set_angles(emissions, |_| (right, down));
}

fn axes_of_scanner(emissions: &[Emission]) -> (Vector, Vector) {
    let down = main_axis(emissions.iter().map(|emission| emission.direction));
    let sweep = |axis: usize| {
        let parts = emissions.iter().map(|emission| emission.direction[axis]);
        let [least, most] = parts.fold([f64::MAX, f64::MIN], |[a, b], part| [a.min(part), b.max(part)]);
        most - least
    };
    let across = (0..3).filter(|axis| down[*axis] == 0.0).max_by(|a, b| sweep(*a).total_cmp(&sweep(*b)));
    let right = std::array::from_fn(|axis| if Some(axis) == across { 1.0 } else { 0.0 });
    (right, down)
}

/// Sets the missing angles of shots, and the directions of all shots.
fn set_angles(emissions: &mut [Emission], axes: impl Fn(&Emission) -> (Vector, Vector)) {
    for emission in emissions.iter_mut().filter(|emission| emission.scan_angle_deg.is_nan()) {
        let (right, down) = axes(emission);
        let [across, deep] = [right, down].map(|axis| dot(emission.direction, axis));
        emission.scan_angle_deg = libm::atan2(across, deep).to_degrees() as f32;
    }
    set_directions(emissions);
}

/// Limits of held bytes and lines; beyond them, lines are emitted without scan angles.
const MOST_HELD_BYTES: usize = 16 << 20;
const MOST_HELD_LINES: usize = 256;

/// Completes scan angles of lines in a projected CRS or on the earth; holds lines until the course
/// is known.
#[derive(Debug, Default)]
pub struct ScanAngles {
    course: Course,
    held: VecDeque<ScanLine>,
    held_bytes: usize,
    /// Lines ready to be emitted.
    ready: VecDeque<ScanLine>,
    /// Whether lines of scanners were emitted without scan angles.
    gave_up: bool,
    contradiction: Option<[f64; 2]>,
}

impl ScanAngles {
    /// Adds a line; angles that its beams exclude are replaced by the angles of the beams.
    pub fn push(&mut self, mut scan_line: ScanLine) {
        let frame = scan_line.input.frame;
        let is_placed = matches!(frame, Frame::Map | Frame::Earth);
        if let Some(angles_deg) = excluded(frame, &scan_line.emissions) {
            self.contradiction.get_or_insert(angles_deg);
            scan_line.emissions.iter_mut().for_each(|emission| emission.scan_angle_deg = f32::NAN);
        }
        if !is_placed || !are_unknown(&scan_line.emissions) {
            self.release();
            self.ready.push_back(scan_line);
            return;
        }
        self.course.add(&scan_line);
        self.held_bytes += scan_line.bytes();
        self.held.push_back(scan_line);
        let is_full = self.held_bytes > MOST_HELD_BYTES || self.held.len() > MOST_HELD_LINES;
        if self.course.forward.is_some() || is_full {
            self.release();
        }
    }

    /// The next line to emit.
    pub fn pop(&mut self) -> Option<ScanLine> {
        self.ready.pop_front()
    }

    /// Ends the input.
    pub fn finish(&mut self) {
        self.course.settle();
        self.release();
    }

    /// Scan angle in the file and angle of the beam from nadir, degrees, of the first line whose angles were
    /// replaced: medians of their sizes.
    pub fn contradiction(&self) -> Option<[f64; 2]> {
        self.contradiction
    }

    /// Whether any line of a scanner was emitted without scan angles; beams of large footprints do not scan.
    pub fn gave_up(&self) -> bool {
        self.gave_up
    }

    fn release(&mut self) {
        self.held_bytes = 0;
        for mut scan_line in self.held.drain(..) {
            let frame = scan_line.input.frame;
            let Some(forward) = self.course.forward else {
                self.gave_up |= scan_line.kind() != Kind::Footprints;
                self.ready.push_back(scan_line);
                continue;
            };
            let down = scan_line.emissions.first().and_then(|first| down_at(frame, first.origin_m));
            let down = down.unwrap_or_default();
            let right = unit(cross(down, forward));
            set_angles(&mut scan_line.emissions, |_| (right, down));
            self.ready.push_back(scan_line);
        }
    }
}

/// Largest excess of a scan angle over the angle of its beam from nadir, degrees.
///
/// Some files give the angle in the aircraft, without its roll.
pub const MOST_EXCESS_DEG: f64 = 25.0;

/// About as many evenly spaced shots of a line are examined.
const MOST_EXAMINED: usize = 32;

/// Medians of scan angle and angle from nadir, degrees, if the beams of a line exclude its angles.
///
/// An angle across the flight is at most that from nadir.
fn excluded(frame: Frame, emissions: &[Emission]) -> Option<[f64; 2]> {
    let down = down_at(frame, emissions.first()?.origin_m)?;
    let [mut scan_deg, mut nadir_deg, mut excess_deg] = [const { Vec::new() }; 3];
    let examined = emissions.iter().step_by((emissions.len() / MOST_EXAMINED).max(1));
    for emission in examined.filter(|emission| !emission.scan_angle_deg.is_nan()) {
        let across = cross(emission.direction, down);
        let off_deg = libm::atan2(dot(across, across).sqrt(), dot(emission.direction, down)).to_degrees();
        let own_deg = f64::from(emission.scan_angle_deg).abs();
        scan_deg.push(own_deg);
        nadir_deg.push(off_deg);
        excess_deg.push(own_deg - off_deg);
    }
    let median = |values: &mut Vec<f64>| {
        let middle = values.len() / 2;
        (!values.is_empty()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
    };
    if median(&mut excess_deg)? <= MOST_EXCESS_DEG {
        return None;
    }
    Some([median(&mut scan_deg)?, median(&mut nadir_deg)?])
}

/// Course: the direction of flight.
#[derive(Debug, Default)]
struct Course {
    /// The last known direction; not a unit vector.
    forward: Option<Vector>,
    /// Time, s, and origin of the shot from which the next course is measured.
    from: Option<(f64, Vector)>,
    /// Beams of a recording without the sensor position.
    window: Window,
}

/// Minimum motion of the sensor, m, and in steps of its coordinate grid.
const LEAST_WAY_M: f64 = 0.3;
const LEAST_WAY_STEPS: f64 = 30.0;
/// Limits of speed, time and distance; motion outside them is a different flight.
const SPEED_MPS: std::ops::Range<f64> = 0.5..400.0;
const LONGEST_WAY_S: f64 = 10.0;
const LONGEST_WAY_M: f64 = 100.0;
/// Minimum time span of beams for a sensor at unknown position, s.
const LEAST_WINDOW_S: f64 = 0.1;
/// A horizontal grid finer than the vertical one by this factor is in degrees.
const DEGREES_FINER: f64 = 1000.0;

impl Course {
    fn add(&mut self, scan_line: &ScanLine) {
        let time_s = |emission: &Emission| 1e-12 * emission.clock_ps as f64;
        let Some(grid_m) = grid_m(&scan_line.input) else { return };
        if !scan_line.input.origin_is_sensor {
            for emission in &scan_line.emissions {
                let (through_m, direction) = (emission.origin_m, emission.direction);
                self.window.add(&Beam { time_s: time_s(emission), through_m, direction });
            }
            if self.window.length_s() >= LEAST_WINDOW_S {
                self.settle();
            }
            return;
        }
        let way_m = LEAST_WAY_M.max(LEAST_WAY_STEPS * grid_m);
        let (Some(first), Some(last)) = (scan_line.emissions.first(), scan_line.emissions.last()) else {
            return;
        };
        for emission in [first, last] {
            let (time_s, origin_m) = (time_s(emission), emission.origin_m);
            let (from_s, from_m) = *self.from.get_or_insert((time_s, origin_m));
            let way: Vector = std::array::from_fn(|axis| origin_m[axis] - from_m[axis]);
            let length_m = dot(way, way).sqrt();
            if length_m < way_m {
                continue;
            }
            let since_s = time_s - from_s;
            // Some files have no times; the order of the shots is used instead.
            let is_flight = match since_s == 0.0 {
                true => length_m < LONGEST_WAY_M,
                false => since_s.abs() < LONGEST_WAY_S && SPEED_MPS.contains(&(length_m / since_s.abs())),
            };
            self.forward = is_flight.then(|| way.map(|part| if since_s < 0.0 { -part } else { part }));
            self.from = Some((time_s, origin_m));
        }
    }

    /// Determines the course from the collected beams.
    fn settle(&mut self) {
        let velocity_mps = self.window.place().map(|place| place.velocity_mps);
        let is_flight = |velocity: &Vector| SPEED_MPS.contains(&dot(*velocity, *velocity).sqrt());
        if let Some(velocity_mps) = velocity_mps.filter(is_flight) {
            self.forward = Some(velocity_mps);
            self.window = Window::default();
        } else if self.window.length_s() > 20.0 * LEAST_WINDOW_S {
            self.window = Window::default();
        }
    }
}

/// Step of the coordinate grid, m: 0 without a grid; `None` for degrees.
fn grid_m(input: &InputInfo) -> Option<f64> {
    let Some((scale, _)) = input.coordinate_grid else { return Some(0.0) };
    (scale[0] * DEGREES_FINER > scale[2]).then_some(scale.iter().fold(0.0, |most: f64, step| most.max(*step)))
}

fn unit(vector: Vector) -> Vector {
    let length = dot(vector, vector).sqrt();
    vector.map(|part| part / length)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn beam(direction: Vector) -> Emission {
        Emission { direction, ..Emission::default() }
    }

    fn found(emissions: &[Emission]) -> Vec<(f32, bool)> {
        let is_positive = |e: &Emission| e.flags & emission_flags::SCAN_DIRECTION_POSITIVE != 0;
        emissions.iter().map(|e| (e.scan_angle_deg.round(), is_positive(e))).collect()
    }

    #[test]
    fn own_axes_are_those_of_the_sweep() {
        let angles = [-30.0f64, -10.0, 15.0, 20.0].map(f64::to_radians);
        let expected = [-30.0, -10.0, 15.0, 20.0].map(|deg: f32| (deg, true));
        let complete = |frame, of_angle: fn(f64, f64) -> Vector| {
            let mut emissions = angles.map(|angle| beam(of_angle(angle.sin(), angle.cos())));
            complete_in_own_axes(frame, &mut emissions);
            found(&emissions)
        };
        assert_eq!(complete(Frame::Body, |sin, cos| [0.0, sin, cos]), expected);
        assert_eq!(complete(Frame::Scanner, |sin, cos| [0.0, sin, cos]), expected);
        assert_eq!(complete(Frame::Scanner, |sin, cos| [cos, 0.0, sin]), expected);
        assert_eq!(complete(Frame::Scanner, |sin, cos| [sin, 0.0, -cos]), expected);
        let mut own = [Emission { scan_angle_deg: 7.0, ..beam([0.0, 0.0, 1.0]) }; 2];
        complete_in_own_axes(Frame::Body, &mut own);
        assert_eq!(found(&own), [(7.0, false); 2], "recorded angles and flags are kept");
    }

    #[test]
    fn a_gap_in_a_line_turns_no_shot() {
        let angles = [9.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0];
        let mut emissions = angles.map(|deg| Emission { scan_angle_deg: deg, ..Emission::default() });
        set_directions(&mut emissions);
        assert_eq!(found(&emissions), angles.map(|deg| (deg, true)));
        emissions.reverse();
        set_directions(&mut emissions);
        assert!(found(&emissions).iter().all(|(_, is_positive)| !is_positive));
    }

    #[test]
    fn large_footprints_have_no_scan_angles() {
        let input = std::sync::Arc::new(InputInfo { frame: Frame::Map, ..InputInfo::default() });
        let gives_up = |blocks: crate::scan_line::Blocks| {
            let mut angles = ScanAngles::default();
            angles.push(ScanLine::of_shots(input.clone(), 0, vec![beam([0.0, 0.0, -1.0])], blocks));
            angles.finish();
            assert!(angles.pop().is_some());
            angles.gave_up()
        };
        let mut footprint = crate::scan_line::Blocks::default();
        footprint.push_fractions(0, crate::scan_line::Channel::LowPower, 0.0, 1.0, &[0.5, 1.5]);
        assert_eq!([gives_up(footprint), gives_up(Default::default())], [false, true]);
    }

    #[test]
    fn angles_that_the_beams_exclude_are_replaced() {
        let input = InputInfo { frame: Frame::Map, origin_is_sensor: true, ..InputInfo::default() };
        let input = std::sync::Arc::new(input);
        let angles_of = |recorded: fn(f64) -> f64| {
            let shot = |index: u32| {
                let angle = (-20.0 + f64::from(index)).to_radians();
                Emission {
                    clock_ps: 10_000_000_000 * i64::from(index),
                    origin_m: [0.0, 0.6 * f64::from(index), 1000.0],
                    direction: [angle.sin(), 0.0, -angle.cos()],
                    scan_angle_deg: recorded(angle.to_degrees()) as f32,
                    ..Emission::default()
                }
            };
            let emissions: Vec<Emission> = (0..41).map(shot).collect();
            let blocks = crate::scan_line::Blocks::default();
            let mut angles = ScanAngles::default();
            angles.push(ScanLine::of_shots(input.clone(), 0, emissions, blocks));
            angles.finish();
            let scan_line = angles.pop().unwrap();
            let found: Vec<f32> = scan_line.emissions.iter().map(|e| e.scan_angle_deg.round()).collect();
            (angles.contradiction(), found)
        };
        let right: Vec<f32> = (-20i8..=20).map(f32::from).collect();
        assert_eq!(angles_of(|angle| angle), (None, right.clone()));
        assert_eq!(angles_of(|angle| angle + 20.0).0, None, "without the roll of a turn");
        let (contradiction, found) = angles_of(|_| 85.0);
        assert_eq!(contradiction.map(|angles| angles.map(f64::round)), Some([85.0, 10.0]));
        assert_eq!(found, right);
    }

    /// A sensor at unknown position that flies north: beams through points on the ground.
    #[test]
    fn course_of_an_unknown_sensor_is_estimated_from_beams() {
        let input = InputInfo { frame: Frame::Map, origin_is_sensor: false, ..InputInfo::default() };
        let input = std::sync::Arc::new(input);
        let mut angles = ScanAngles::default();
        let mut held = 0;
        for line in 0..20u32 {
            let shot = |index: u32| {
                let clock_ps = 10_000_000 * i64::from(1000 * line + index);
                let angle = (-20.0 + 0.04 * f64::from(index)).to_radians();
                let north_m = 60e-12 * clock_ps as f64;
                let direction = [angle.sin(), 0.0, -angle.cos()];
                Emission {
                    clock_ps,
                    origin_m: [1000.0 * angle.tan(), north_m, 0.0],
                    direction,
                    ..Emission::default()
                }
            };
            let emissions: Vec<Emission> = (0..1000).map(shot).collect();
            angles.push(ScanLine::of_shots(
                input.clone(),
                line,
                emissions,
                crate::scan_line::Blocks::default(),
            ));
            held = held.max(angles.held.len());
            while let Some(scan_line) = angles.pop() {
                let expected: Vec<(f32, bool)> =
                    (0..1000).map(|index| ((-20.0 + 0.04 * index as f32).round(), true)).collect();
                let wrong = found(&scan_line.emissions).iter().zip(&expected).filter(|(a, b)| a != b).count();
                assert!(wrong <= 2, "line {line}: {wrong} differ (in rounding)");
            }
        }
        assert!((9..=11).contains(&held) && !angles.gave_up(), "{held} lines of 10 ms were held");
    }
}
