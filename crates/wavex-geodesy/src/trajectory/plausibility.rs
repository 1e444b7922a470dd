//! Contradictions of a trajectory as a whole: limits of motion and attitude, headings against the
//! course, and stored speeds against the positions.

use core::f64::consts::{PI, TAU};

use super::Sample;
use crate::ellipsoid::WGS84;
use crate::frames::{Vector, ecef_from_ned, inverse, rotate};

/// Limits of plausible attitudes and motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionLimits {
    /// Largest roll, rad.
    pub roll_rad: f64,
    /// Largest pitch, rad.
    pub pitch_rad: f64,
    /// Largest speed, m/s.
    pub speed_mps: f64,
    /// Largest acceleration, m/s².
    pub acceleration_mps2: f64,
    /// Largest change of the heading, rad/s.
    pub turn_rate_rad_per_s: f64,
    /// Largest angle between heading and course, rad.
    pub drift_rad: f64,
}

impl MotionLimits {
    /// An airplane: banks of 75 degrees, pitch of 45 degrees, 350 m/s, 3 g, 90 degrees/s.
    pub const AIRPLANE: MotionLimits = MotionLimits {
        roll_rad: 75.0 * DEGREE,
        pitch_rad: 45.0 * DEGREE,
        speed_mps: 350.0,
        acceleration_mps2: 30.0,
        turn_rate_rad_per_s: 90.0 * DEGREE,
        drift_rad: DRIFT_RAD,
    };
    /// A helicopter or drone, which may fly sideways: 85 degrees, 350 m/s, 6 g, 170 degrees/s.
    pub const HELICOPTER: MotionLimits = MotionLimits {
        roll_rad: 85.0 * DEGREE,
        pitch_rad: 85.0 * DEGREE,
        speed_mps: 350.0,
        acceleration_mps2: 60.0,
        turn_rate_rad_per_s: 170.0 * DEGREE,
        drift_rad: PI,
    };
}

const DEGREE: f64 = PI / 180.0;
/// Largest angle between heading and course of an airplane, rad. Strong wind explains 30 degrees.
const DRIFT_RAD: f64 = 60.0 * DEGREE;
/// Largest such angle of headings that fit, rad.
const FITTING_RAD: f64 = 30.0 * DEGREE;
/// Part of the values that may exceed a limit. Single records are [`super::outliers`].
pub(super) const MOST_PART: f64 = 0.05;
/// Length of the windows over which motion is measured, s.
const WINDOW_S: f64 = 1.0;
const LONGEST_WINDOW_S: f64 = 5.0;
/// Fewest windows that are evidence.
const FEWEST: usize = 5;
/// Smallest speed at which an airplane has a course, m/s.
const LEAST_SPEED_MPS: f64 = 20.0;
/// Part of the records that may repeat a position, and the speed from which they may not, m/s.
const MOST_REPEATED: f64 = 0.5;
const LEAST_MOVING_MPS: f64 = 5.0;
/// Largest difference of stored speeds, m/s, and part of the speed.
const SPEED_DIFFERS_MPS: f64 = 2.0;
const SPEED_DIFFERS_PART: f64 = 0.1;

/// Kind of a contradiction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ContradictionKind {
    /// Angles were read as degrees, but are radians.
    AnglesAreRadians,
    /// Angles were read as radians, but are degrees.
    AnglesAreDegrees,
    /// Roll or pitch beyond the limits.
    Attitude,
    /// Speed, acceleration or turn rate beyond the limits, repeated positions, or stored speeds that differ.
    Motion,
    /// The heading differs from the course.
    Heading,
}

/// A contradiction of the whole trajectory.
#[derive(Clone, Debug, PartialEq)]
pub struct Contradiction {
    /// Its kind.
    pub kind: ContradictionKind,
    /// Description with figures.
    pub problem: String,
}

/// Motion between two records.
struct MotionInterval {
    /// In the earth-centred frame, m/s.
    velocity_mps: Vector,
    speed_mps: f64,
    horizontal_mps: f64,
    course_rad: f64,
    heading_rad: f64,
    turn_rate_rad_per_s: f64,
    /// From the file, if it has speeds, m/s.
    stored_mps: Option<f64>,
    length_s: f64,
    /// Whether the window before ends where this one begins.
    is_next: bool,
}

/// The first contradiction in samples in order of time.
///
/// `speeds_mps` are the horizontal speeds in the file, m/s, one per sample, or empty.
///
/// ```
/// use wavex_geodesy::ellipsoid::Geodetic;
/// use wavex_geodesy::frames::Attitude;
/// use wavex_geodesy::trajectory::plausibility::{ContradictionKind, MotionLimits, contradiction};
/// use wavex_geodesy::trajectory::Sample;
///
/// let sample = |k: u32| Sample {
///     time_s: f64::from(k),
///     place: Geodetic { latitude_rad: 0.8 + 1e-5 * f64::from(k), longitude_rad: 0.2, height_m: 1000.0 },
///     attitude: Attitude { roll_rad: 1.5, ..Attitude::default() },
/// };
/// let samples: Vec<Sample> = (0..10).map(sample).collect();
/// assert_eq!(contradiction(&samples, &[], &MotionLimits::AIRPLANE).unwrap().kind, ContradictionKind::Attitude);
/// ```
pub fn contradiction(samples: &[Sample], speeds_mps: &[f64], limits: &MotionLimits) -> Option<Contradiction> {
    let windows = windows(samples, speeds_mps);
    heading_unit(&windows)
        .or_else(|| attitude(samples, limits))
        .or_else(|| motion(&windows, limits))
        .or_else(|| repeated(samples, &windows))
        .or_else(|| stored_speed(&windows))
        .or_else(|| heading(&windows, limits))
}

fn windows(samples: &[Sample], speeds_mps: &[f64]) -> Vec<MotionInterval> {
    let has_speeds = speeds_mps.len() == samples.len() && speeds_mps.iter().any(|speed| *speed != 0.0);
    let mut windows = Vec::new();
    let (mut from, mut is_next) = (0, false);
    for (to, sample) in samples.iter().enumerate() {
        let Some(first) = samples.get(from) else { break };
        let length_s = sample.time_s - first.time_s;
        if length_s < WINDOW_S {
            continue;
        }
        if length_s <= LONGEST_WINDOW_S {
            let stored_mps = has_speeds.then(|| 0.5 * (speeds_mps[from] + speeds_mps[to]));
            windows.push(MotionInterval::between(first, sample, stored_mps, is_next));
        }
        is_next = length_s <= LONGEST_WINDOW_S;
        from = to;
    }
    windows
}

impl MotionInterval {
    fn between(first: &Sample, last: &Sample, stored_mps: Option<f64>, is_next: bool) -> MotionInterval {
        let length_s = last.time_s - first.time_s;
        let [from_m, to_m] = [first, last].map(|sample| WGS84.ecef_of(sample.place));
        let velocity_mps: Vector = core::array::from_fn(|axis| (to_m[axis] - from_m[axis]) / length_s);
        let ned_from_ecef = inverse(&ecef_from_ned(first.place.latitude_rad, first.place.longitude_rad));
        let [north, east, down] = rotate(&ned_from_ecef, velocity_mps);
        let turned_rad = wrapped_rad(last.attitude.heading_rad - first.attitude.heading_rad);
        MotionInterval {
            velocity_mps,
            speed_mps: (north * north + east * east + down * down).sqrt(),
            horizontal_mps: (north * north + east * east).sqrt(),
            course_rad: libm::atan2(east, north),
            heading_rad: first.attitude.heading_rad,
            turn_rate_rad_per_s: turned_rad.abs() / length_s,
            stored_mps,
            length_s,
            is_next,
        }
    }
}

/// Headings that fit the course in the other unit only.
fn heading_unit(windows: &[MotionInterval]) -> Option<Contradiction> {
    let off_rad = drift_rad(windows, 1.0).filter(|off| *off > DRIFT_RAD)?;
    let units = [
        (ContradictionKind::AnglesAreRadians, 1.0 / DEGREE, "degrees", "radians"),
        (ContradictionKind::AnglesAreDegrees, DEGREE, "radians", "degrees"),
    ];
    let fitting = units.map(|unit| (unit, drift_rad(windows, unit.1).unwrap_or(PI)));
    let best = fitting.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
    let ((kind, _, read, fitting), fitting_rad) = best.filter(|(_, off)| *off < FITTING_RAD)?;
    let problem = format!(
        "its headings, read as {read}, differ by {:.0} degrees and more from the course over ground in a quarter of \
         the flight; read as {fitting}, by {:.0} degrees",
        off_rad / DEGREE,
        fitting_rad / DEGREE
    );
    Some(Contradiction { kind, problem })
}

/// Headings that differ from the course in any unit.
fn heading(windows: &[MotionInterval], limits: &MotionLimits) -> Option<Contradiction> {
    let off_rad = drift_rad(windows, 1.0).filter(|off| *off > limits.drift_rad)?;
    let problem = format!(
        "its headings differ by {:.0} degrees and more from the course over ground in a quarter of the flight",
        off_rad / DEGREE
    );
    Some(Contradiction { kind: ContradictionKind::Heading, problem })
}

/// Upper quartile of the angles between course and scaled heading, rad.
///
/// Not the median: of flights to the north and south, half fits in either unit.
fn drift_rad(windows: &[MotionInterval], scale: f64) -> Option<f64> {
    let moving = windows.iter().filter(|window| window.horizontal_mps > LEAST_SPEED_MPS);
    let off = moving.map(|window| wrapped_rad(scale * window.heading_rad - window.course_rad).abs());
    quantile(off, 0.75)
}

fn attitude(samples: &[Sample], limits: &MotionLimits) -> Option<Contradiction> {
    let roll = samples.iter().map(|sample| wrapped_rad(sample.attitude.roll_rad).abs());
    let pitch = samples.iter().map(|sample| wrapped_rad(sample.attitude.pitch_rad).abs());
    let problem = exceeds("roll", "degrees", DEGREE, roll, limits.roll_rad)
        .or_else(|| exceeds("pitch", "degrees", DEGREE, pitch, limits.pitch_rad))?;
    Some(Contradiction { kind: ContradictionKind::Attitude, problem })
}

fn motion(windows: &[MotionInterval], limits: &MotionLimits) -> Option<Contradiction> {
    let speeds = windows.iter().map(|window| window.speed_mps);
    let accelerations = windows.windows(2).filter(|pair| pair[1].is_next).map(|pair| {
        let square: f64 =
            (0..3).map(|axis| (pair[1].velocity_mps[axis] - pair[0].velocity_mps[axis]).powi(2)).sum();
        square.sqrt() / (0.5 * (pair[0].length_s + pair[1].length_s))
    });
    let turns = windows.iter().map(|window| window.turn_rate_rad_per_s);
    let problem = exceeds("speed", "m/s", 1.0, speeds, limits.speed_mps)
        .or_else(|| exceeds("acceleration", "m/s²", 1.0, accelerations, limits.acceleration_mps2))
        .or_else(|| exceeds("turn rate", "degrees/s", DEGREE, turns, limits.turn_rate_rad_per_s))?;
    Some(Contradiction { kind: ContradictionKind::Motion, problem })
}

/// Positions that are sparser than the records.
fn repeated(samples: &[Sample], windows: &[MotionInterval]) -> Option<Contradiction> {
    let speed_mps = quantile(windows.iter().map(|window| window.speed_mps), 0.5)?;
    let count = samples.windows(2).filter(|pair| pair[0].place == pair[1].place).count();
    let part = count as f64 / samples.len() as f64;
    let problem = format!(
        "{:.1} % of its records repeat the position of the one before, at {speed_mps:.1} m/s",
        100.0 * part
    );
    (part > MOST_REPEATED && speed_mps > LEAST_MOVING_MPS)
        .then_some(Contradiction { kind: ContradictionKind::Motion, problem })
}

fn stored_speed(windows: &[MotionInterval]) -> Option<Contradiction> {
    let pairs = || windows.iter().filter_map(|window| Some([window.stored_mps?, window.horizontal_mps]));
    let difference = pairs().map(|[stored, own]| (stored - own).abs() - SPEED_DIFFERS_PART * own.max(stored));
    if quantile(difference, 0.5)? <= SPEED_DIFFERS_MPS {
        return None;
    }
    let [stored, own] = [0, 1].map(|which| quantile(pairs().map(move |pair| pair[which]), 0.5));
    let problem = format!(
        "its stored velocity has a median of {:.1} m/s, but its positions move at {:.1} m/s by its times",
        stored?, own?
    );
    Some(Contradiction { kind: ContradictionKind::Motion, problem })
}

/// Describes values that exceed a limit in more than 5 % of the cases.
fn exceeds(
    name: &str,
    unit: &str,
    scale: f64,
    values: impl Iterator<Item = f64> + Clone,
    most: f64,
) -> Option<String> {
    let beyond = || values.clone().filter(|value| *value > most);
    let (count, all) = (beyond().count(), values.clone().count());
    if all < FEWEST || count as f64 <= (MOST_PART * all as f64).max(1.0) {
        return None;
    }
    let largest = beyond().fold(0.0, f64::max);
    Some(format!(
        "its {name} exceeds {:.0} {unit} in {:.1} % of the flight; the largest is {:.1} {unit}",
        most / scale,
        100.0 * count as f64 / all as f64,
        largest / scale
    ))
}

/// Quantile of at least [`FEWEST`] values.
fn quantile(values: impl Iterator<Item = f64>, part: f64) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    if values.len() < FEWEST {
        return None;
    }
    let at = (part * (values.len() - 1) as f64) as usize;
    Some(*values.select_nth_unstable_by(at, f64::total_cmp).1)
}

/// The angle from -π to π, rad.
pub(super) fn wrapped_rad(angle_rad: f64) -> f64 {
    let rest_rad = angle_rad % TAU;
    rest_rad - TAU * (rest_rad / TAU).round()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ellipsoid::Geodetic;
    use crate::frames::Attitude;

    const SPEED_MPS: f64 = 60.0;

    /// Two strips of 50 s with this course and back, at 20 Hz.
    fn flight(course_deg: f64) -> Vec<Sample> {
        let (mut north_m, mut east_m) = (0.0, 0.0);
        (0..2000)
            .map(|k| {
                let time_s = 0.05 * f64::from(k);
                let course_rad = DEGREE * (course_deg + if k < 1000 { 0.0 } else { 180.0 });
                north_m += 0.05 * SPEED_MPS * course_rad.cos();
                east_m += 0.05 * SPEED_MPS * course_rad.sin();
                let latitude_rad = 0.8 + north_m / 6.37e6;
                Sample {
                    time_s,
                    place: Geodetic {
                        latitude_rad,
                        longitude_rad: 0.2 + east_m / (6.38e6 * latitude_rad.cos()),
                        height_m: 1000.0,
                    },
                    attitude: Attitude {
                        roll_rad: 3.0 * DEGREE * time_s.sin(),
                        pitch_rad: 2.0 * DEGREE,
                        heading_rad: course_rad + 5.0 * DEGREE,
                    },
                }
            })
            .collect()
    }

    fn found(
        course_deg: f64,
        limits: &MotionLimits,
        change: impl Fn(&mut Sample),
    ) -> Option<ContradictionKind> {
        let mut samples = flight(course_deg);
        samples.iter_mut().for_each(change);
        contradiction(&samples, &[], limits).map(|found| found.kind)
    }

    fn scale(attitude: &mut Attitude, by: f64) {
        attitude.roll_rad *= by;
        attitude.pitch_rad *= by;
        attitude.heading_rad *= by;
    }

    #[test]
    fn sound_flights_have_no_contradiction() {
        for course_deg in [0.0, 47.0, 90.0, 200.0] {
            for limits in [MotionLimits::AIRPLANE, MotionLimits::HELICOPTER] {
                assert_eq!(found(course_deg, &limits, |_| {}), None, "{course_deg}");
                let bank = |s: &mut Sample| s.attitude.roll_rad = 60.0 * DEGREE;
                assert_eq!(found(course_deg, &limits, bank), None, "{course_deg}");
            }
        }
    }

    #[test]
    fn angles_in_the_other_unit_are_found() {
        for course_deg in [0.0, 47.0, 90.0, 200.0] {
            let small = found(course_deg, &MotionLimits::AIRPLANE, |s| scale(&mut s.attitude, DEGREE));
            assert_eq!(small, Some(ContradictionKind::AnglesAreRadians), "{course_deg}");
        }
        // At 90 degrees, 275 rad happen to fit the course.
        for course_deg in [0.0, 47.0, 200.0] {
            let large = found(course_deg, &MotionLimits::AIRPLANE, |s| scale(&mut s.attitude, 1.0 / DEGREE));
            assert_eq!(large, Some(ContradictionKind::AnglesAreDegrees), "{course_deg}");
            let heading = |s: &mut Sample| s.attitude.heading_rad /= DEGREE;
            assert_eq!(
                found(course_deg, &MotionLimits::HELICOPTER, heading),
                Some(ContradictionKind::AnglesAreDegrees)
            );
        }
    }

    #[test]
    fn headings_across_the_course_are_found_for_airplanes() {
        let turn = |s: &mut Sample| s.attitude.heading_rad += 90.0 * DEGREE;
        assert_eq!(found(47.0, &MotionLimits::AIRPLANE, turn), Some(ContradictionKind::Heading));
        assert_eq!(found(47.0, &MotionLimits::HELICOPTER, turn), None);
    }

    #[test]
    fn attitudes_and_motion_beyond_limits_are_found() {
        let of = |change: fn(&mut Sample)| found(47.0, &MotionLimits::AIRPLANE, change);
        assert_eq!(of(|s| s.attitude.roll_rad = 1.5), Some(ContradictionKind::Attitude));
        assert_eq!(of(|s| s.attitude.pitch_rad = 1.0), Some(ContradictionKind::Attitude));
        assert_eq!(
            of(|s| s.place.latitude_rad = 0.8 + 10.0 * (s.place.latitude_rad - 0.8)),
            Some(ContradictionKind::Motion)
        );
        let oscillate = |s: &mut Sample| s.place.height_m += 100.0 * (s.time_s * 2.0).sin();
        assert_eq!(of(oscillate), Some(ContradictionKind::Motion));
        assert_eq!(
            of(|s| s.attitude.heading_rad += 100.0 * DEGREE * s.time_s),
            Some(ContradictionKind::Motion)
        );
    }

    #[test]
    fn positions_sparser_than_the_records_are_found() {
        let mut samples = flight(47.0);
        (0..2000).for_each(|k| samples[k].place = samples[k / 20 * 20].place);
        let found = contradiction(&samples, &[], &MotionLimits::AIRPLANE).unwrap();
        assert!(found.problem.starts_with("95.0 % of its records repeat the position"), "{found:?}");
    }

    #[test]
    fn stored_speeds_must_be_those_of_the_positions() {
        let samples = flight(47.0);
        let of = |speed_mps: f64| contradiction(&samples, &[speed_mps; 2000], &MotionLimits::AIRPLANE);
        assert_eq!((of(0.0), of(SPEED_MPS), of(SPEED_MPS + 3.0)), (None, None, None));
        let problem = of(SPEED_MPS * 3.6).unwrap().problem;
        assert!(problem.contains("216.0 m/s, but its positions move at 6"), "{problem}");
    }
}
