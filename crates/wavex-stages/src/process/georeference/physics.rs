//! Beams and points that contradict an instrument above the ground of the earth.

use std::ops::RangeInclusive;

use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::frames::Vector;
use wavex_geodesy::vertical::down_at;
use wavex_line::plausibility::Check;
use wavex_line::scan_line::{Emission, Frame, InputInfo, Return};
use wavex_line::stage::Context;

/// Fewest shots that are evidence.
const FEWEST_SHOTS: u64 = 200;
/// Angle from which a beam is far from nadir, degrees.
const FAR_DEG: f64 = 60.0;
/// Part of the beams that may be far from nadir, and of the points that may lie where there is no ground.
const MOST_FAR: f64 = 0.5;
const MOST_NOWHERE: f64 = 0.5;
/// Part of the returns that may lie above the sensor: slopes of mountains.
const MOST_ABOVE: f64 = 0.1;
/// Ellipsoidal heights of ground, m: the shore of the Dead Sea lies at -410 m, Mount Everest at 8820 m.
const GROUND_M: RangeInclusive<f64> = -500.0..=9000.0;

/// Words of the messages.
const DOWN: &str = "away from straight down";
const ABOVE: &str = "of the returns lie above the sensor";
const NOWHERE: &str = "lie where the earth has no ground";

/// The checks of this module.
pub(crate) fn checks() -> Vec<Check> {
    let check = |compared, accepted: String, source, message| {
        Check::warning(compared, accepted, source, message).with_key("mount")
    };
    vec![
        check(
            "beams and straight down, without a frame of the instrument",
            format!("at most half of at least {FEWEST_SHOTS} beams more than {FAR_DEG} degrees away"),
            "scanners of aircraft look down",
            DOWN,
        ),
        check(
            "heights of returns and of the sensor",
            format!("at most {:.0} % of the returns above the sensor", 100.0 * MOST_ABOVE),
            "slopes of mountains",
            ABOVE,
        ),
        check(
            "heights of returns and of the ground of the earth",
            format!("at least half of them from {} to {} m", GROUND_M.start(), GROUND_M.end()),
            "the Dead Sea and Mount Everest",
            NOWHERE,
        )
        .with_key("trajectory_heights"),
    ]
}

/// Counters of all workers, by name.
const NAMES: [&str; 5] =
    ["beams", "beams_far_from_nadir", "heights", "returns_above_sensor", "points_without_ground"];

/// Counts beams far from nadir, returns above the sensor, and points where there is no ground.
pub(super) fn count(
    input: &InputInfo,
    emissions: &[Emission],
    returns: &[Return],
    points: &[Vector],
    cx: &mut Context,
) {
    let Some(down) = emissions.first().and_then(|first| down_at(input.frame, first.origin_m)) else { return };
    let cosine = |emission: &Emission| {
        let direction = emission.direction;
        let length = direction.iter().map(|part| part * part).sum::<f64>().sqrt();
        direction.iter().zip(down).map(|(a, b)| a * b).sum::<f64>() / length
    };
    let least_cosine = FAR_DEG.to_radians().cos();
    let far = emissions.iter().filter(|shot| cosine(shot) < least_cosine).count();
    // Ranges from a point near the waveform may be negative.
    let sign = |r: &Return| if input.origin_is_sensor { r.range_m } else { 1.0 };
    let is_above =
        |r: &&Return| emissions.get(r.emission as usize).is_some_and(|shot| cosine(shot) * sign(r) < 0.0);
    let map_unit_m = input.map_unit_m();
    let is_nowhere = |point: &&Vector| {
        let height_m = match input.frame {
            Frame::Earth => WGS84.geodetic_of(**point).height_m,
            _ => point[2] * map_unit_m,
        };
        !GROUND_M.contains(&height_m)
    };
    let above = returns.iter().filter(is_above).count();
    let nowhere = points.iter().filter(is_nowhere).count();
    let counts = [emissions.len(), far, returns.len(), above, nowhere];
    NAMES.into_iter().zip(counts).for_each(|(name, n)| cx.count(name, n as u64));
}

/// Warns if the counts of all workers contradict an instrument above the ground.
pub(super) fn conclude(cx: &mut Context) {
    let [beams, far, returns, above, nowhere] =
        NAMES.map(|name| cx.counters().counts.get(name).copied().unwrap_or(0));
    if beams < FEWEST_SHOTS {
        return;
    }
    let part = |n: u64, of: u64| n as f64 / of.max(1) as f64;
    let [far, above, nowhere] = [part(far, beams), part(above, returns), part(nowhere, returns)];
    if far > MOST_FAR || above > MOST_ABOVE {
        cx.warn(format!(
            "{:.0} % of the beams point more than {FAR_DEG} degrees {DOWN}, and {:.0} % {ABOVE}: the likely cause \
             is the wrong `mount` in `[job.geometry]`, a trajectory with other axes than forward, right, down, or wrong \
             beam vectors in the file; an instrument on the ground has such beams, too",
            100.0 * far,
            100.0 * above
        ));
    }
    if nowhere > MOST_NOWHERE {
        cx.warn(format!(
            "{:.0} % of the points {NOWHERE}, below {} or above {} m: the likely cause are heights in another unit or \
             above a geoid (`trajectory_heights` in `[job.geometry]`), or wrong ranges",
            100.0 * nowhere,
            GROUND_M.start(),
            GROUND_M.end()
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Warnings about beams at these angles from nadir, with points of this range from 1000 m.
    fn found(angles_deg: impl Iterator<Item = f64>, range_m: f64) -> Vec<String> {
        let beam = |angle: f64| {
            let (sine, cosine) = angle.to_radians().sin_cos();
            Emission { direction: [sine, 0.0, -cosine], ..Emission::default() }
        };
        let emissions: Vec<Emission> = angles_deg.map(beam).collect();
        let returns: Vec<Return> = (0..emissions.len())
            .map(|shot| Return { emission: shot as u32, range_m, ..Return::default() })
            .collect();
        let heights = emissions.iter().map(|shot| [0.0, 0.0, 1000.0 + range_m * shot.direction[2]]);
        let points: Vec<Vector> = heights.collect();
        let input = InputInfo { frame: Frame::Map, origin_is_sensor: true, ..InputInfo::default() };
        let mut cx = Context::default();
        count(&input, &emissions, &returns, &points, &mut cx);
        conclude(&mut cx);
        cx.counters().notes.clone()
    }

    #[track_caller]
    fn says(notes: &[String], words: &str) {
        assert!(notes.len() == 1 && notes[0].starts_with(words), "{notes:?}");
    }

    #[test]
    fn beams_far_from_nadir_and_returns_above_the_sensor_are_said() {
        assert!(found((0..300).map(|k| -45.0 + 0.3 * f64::from(k)), 900.0).is_empty());
        assert!(found((0..100).map(|_| 90.0), 900.0).is_empty(), "too few");
        let far =
            "100 % of the beams point more than 60 degrees away from straight down, and 0 % of the returns";
        says(&found((0..300).map(|_| 85.0), 900.0), far);
        says(&found((0..300).map(|k| if k % 4 == 0 { 120.0 } else { 0.0 }), 900.0), "25 % of the beams");
        let above =
            "0 % of the beams point more than 60 degrees away from straight down, and 100 % of the returns";
        says(&found((0..300).map(|_| 0.0), -100.0), above);
    }

    #[test]
    fn points_where_the_earth_has_no_ground_are_said() {
        let said = |range_m| found((0..300).map(|_| 0.0), range_m);
        assert!(said(1490.0).is_empty());
        says(
            &said(1510.0),
            "100 % of the points lie where the earth has no ground, below -500 or above 9000 m",
        );
        assert!(
            found((0..300).map(|k| if k % 2 == 0 { 0.0 } else { 59.0 }), 1600.0).is_empty(),
            "half of them"
        );
    }
}
