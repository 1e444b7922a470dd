//! Which parameters a flight determines, why not, and what to fly.

use crate::parameters::Global;

/// A parameter is estimated if its SD is below this part of the SD of its start value: then the observations have about
/// as much information as the prior, or more.
pub const EVIDENCE: f64 = 0.7;
/// Correlations above this are reported.
pub const REPORTED_CORRELATION: f64 = 0.9;

/// How a parameter was treated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Treatment {
    /// Its start value has an SD of 0.
    Given,
    /// Estimated.
    Estimated,
    /// Left at its start value: the evidence is below the prior.
    NotEstimable,
    /// Changed although its own evidence is below the prior: without the change the strips would not meet.
    OnlyCombined,
}

/// What pairs of strips show of a flight.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FlightFacts {
    /// Largest angle between the courses of two overlapping strips, rad, 0 to π/2: crossing strips.
    pub crossing_rad: f64,
    /// Largest angle between the courses of two overlapping strips, rad, 0 to π: opposite strips.
    pub turn_rad: f64,
    /// Part of the pairs on surfaces of more than 10 % slope.
    pub sloped: f64,
    /// Smallest and largest range of the pairs, m.
    pub ranges_m: [f64; 2],
    /// Largest difference of the scan angles of a pair, rad.
    pub angles_rad: f64,
    /// Pairs of different receivers.
    pub receiver_pairs: usize,
    /// Number of control points that are used.
    pub control_points: usize,
}

/// Reasons why a parameter is not determined by a flight, and the remedy of each.
///
/// Empty if no single cause is known: then other parameters have the same effect on this flight.
pub fn reasons(parameter: Global, facts: &FlightFacts) -> Vec<(&'static str, &'static str)> {
    let is_parallel = facts.crossing_rad < 0.35;
    let is_one_way = facts.turn_rad < 2.0;
    let is_flat = facts.sloped < 0.02;
    let [least_m, most_m] = facts.ranges_m;
    let one_height = most_m < 1.5 * least_m;
    let parallel = ("all strips are parallel", "fly a cross strip");
    let one_way = (
        "no overlapping strips are flown in opposite directions",
        "fly neighbouring strips in opposite directions",
    );
    let flat = ("the overlaps are flat", "fly over roofs or slopes of several aspects");
    let height = ("all strips are flown at one height", "fly one strip at half or twice the height");
    let alike = ("strips see the overlaps under similar scan angles", "fly strips with more overlap");
    let no_receivers = ("no place was seen by both receivers", "fly over surfaces that both receivers range");
    let mut found = Vec::new();
    let mut add = |is: bool, reason| {
        if is {
            found.push(reason);
        }
    };
    match parameter {
        Global::Roll | Global::E6 => {
            add(is_one_way && is_parallel, one_way);
            add(facts.angles_rad < 0.05, alike);
        }
        Global::Pitch => {
            add(is_flat, flat);
            add(is_one_way && is_parallel, one_way);
        }
        Global::Yaw => {
            add(is_flat, flat);
            add(facts.angles_rad < 0.05, alike);
        }
        Global::LeverForward | Global::LeverRight | Global::Time => {
            add(is_flat, flat);
            add(is_one_way && is_parallel, one_way);
            add(one_height, height);
        }
        // Height moves all strips alike.
        Global::LeverDown => match facts.control_points {
            0 => add(true, ("it moves all strips alike", "give control points")),
            _ => add(
                true,
                (
                    "the control points do not separate it from heights of the trajectories",
                    "give more, under several scan angles",
                ),
            ),
        },
        Global::E0 => {
            add(facts.angles_rad < 0.2, alike);
            add(one_height, height);
        }
        Global::E1 | Global::E2 | Global::E3 | Global::E4 => {
            add(one_height, height);
            add(facts.angles_rad < 0.2, alike);
            add(is_parallel, parallel);
        }
        Global::E7 => add(facts.receiver_pairs == 0, no_receivers),
    }
    found
}

/// Residuals above this many times their SDs are more than noise.
pub const DOUBTFUL_SCALE: f64 = 2.0;
/// Variances of residuals over intervals of time above this many times those of independent ones: the trajectories change
/// faster than their corrections.
pub const DOUBTFUL_SHARED: f64 = 3.0;
/// Residuals above this many times their SDs: the strips do not meet.
pub const BAD_SCALE: f64 = 10.0;
/// Part of the pairs that may be rejected.
pub const DOUBTFUL_REJECTED: f64 = 0.1;
/// Part of the pairs above which those that are left are chance.
pub const BAD_REJECTED: f64 = 0.5;
/// Change of a parameter, SDs of its start value, above which the start value or its SD is wrong.
pub const DOUBTFUL_CHANGE_SDS: f64 = 5.0;
/// Differences of the strips after over those before: above this, the alignment made them worse.
pub const WORSE: f64 = 1.1;

/// Rating of an alignment.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// The differences of the strips are noise.
    Good,
    /// The strips differ by more than noise, more observations than expected were rejected, or a start value was far off.
    Doubtful,
    /// Strips do not meet, differ more than before, or most observations were rejected.
    Bad,
}

/// Verdict from the scale of the residuals, the rejected part of the pairs, the differences before and after, m, and the
/// largest change of a parameter, SDs of its start value.
pub fn verdict(scale: f64, rejected: f64, [before_m, after_m]: [f64; 2], change_sds: f64) -> Verdict {
    if rejected > BAD_REJECTED || scale > BAD_SCALE || after_m > WORSE * before_m {
        Verdict::Bad
    } else if rejected > DOUBTFUL_REJECTED || scale > DOUBTFUL_SCALE || change_sds > DOUBTFUL_CHANGE_SDS {
        Verdict::Doubtful
    } else {
        Verdict::Good
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_depend_on_the_flight() {
        let parallel = FlightFacts {
            crossing_rad: 0.01,
            turn_rad: 3.1,
            sloped: 0.0,
            ranges_m: [1000.0, 1150.0],
            angles_rad: 0.5,
            receiver_pairs: 0,
            control_points: 0,
        };
        let texts = |facts: &FlightFacts, parameter| {
            reasons(parameter, facts).into_iter().map(|(cause, _)| cause).collect::<Vec<_>>()
        };
        assert_eq!(texts(&parallel, Global::Yaw), ["the overlaps are flat"]);
        assert!(texts(&parallel, Global::Roll).is_empty());
        assert_eq!(texts(&parallel, Global::E7), ["no place was seen by both receivers"]);
        let hills = FlightFacts { sloped: 0.5, crossing_rad: 1.5, ..parallel };
        assert!(texts(&hills, Global::Yaw).is_empty());
        assert_eq!(texts(&hills, Global::LeverForward), ["all strips are flown at one height"]);
        let one_way = FlightFacts { turn_rad: 0.01, ..hills };
        assert!(!texts(&FlightFacts { crossing_rad: 0.0, ..one_way }, Global::Roll).is_empty());
    }

    #[test]
    fn verdicts_follow_the_differences() {
        let better_m = [0.5, 0.02];
        assert_eq!(verdict(1.0, 0.02, better_m, 1.0), Verdict::Good);
        assert_eq!(verdict(1.0, 0.02, [f64::NAN, 0.02], 1.0), Verdict::Good, "too far apart before");
        assert_eq!(verdict(2.5, 0.02, better_m, 1.0), Verdict::Doubtful);
        assert_eq!(verdict(1.0, 0.2, better_m, 1.0), Verdict::Doubtful);
        assert_eq!(verdict(1.0, 0.02, better_m, 6.0), Verdict::Doubtful);
        assert_eq!(verdict(1.0, 0.02, [0.02, 0.05], 1.0), Verdict::Bad);
        assert_eq!(verdict(1.0, 0.6, better_m, 1.0), Verdict::Bad);
        assert_eq!(verdict(100.0, 0.02, better_m, 1.0), Verdict::Bad);
    }
}
