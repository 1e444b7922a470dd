//! Verdicts on the sections of a page, and all rules with their limits.
//!
//! A verdict is the worst of its checks. A check with too little data is not assessed, and a section
//! without any assessed check neither: missing data is never good.

use super::numbers::{label, short, with_unit};
use wavex_align::estimable::{
    BAD_REJECTED, BAD_SCALE, DOUBTFUL_CHANGE_SDS, DOUBTFUL_REJECTED, DOUBTFUL_SCALE, WORSE,
};

/// Grade of a check or a section, from good to bad.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Grade {
    /// Too little data, or none.
    NotAssessed,
    /// Within the limit.
    Good,
    /// Beyond it: a person should look at the section.
    Look,
    /// Beyond the second limit.
    Bad,
}

impl Grade {
    /// Name on the page.
    pub(crate) fn words(self) -> &'static str {
        match self {
            Grade::NotAssessed => "not assessed",
            Grade::Good => "good",
            Grade::Look => "look",
            Grade::Bad => "bad",
        }
    }
}

/// Limits of a measured quantity.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rule {
    /// Name of the quantity.
    quantity: &'static str,
    /// Unit; empty for counts.
    unit: &'static str,
    /// Whether the limits are minima.
    is_minimum: bool,
    /// Limits of the grades good and look; bad beyond the second.
    limits: [f64; 2],
    /// Number of items below which the quantity is not assessed, and their name.
    enough: (u64, &'static str),
}

const fn at_most(quantity: &'static str, unit: &'static str, limits: [f64; 2]) -> Rule {
    Rule { quantity, unit, is_minimum: false, limits, enough: (1, "value") }
}

impl Rule {
    const fn from(self, number: u64, items: &'static str) -> Rule {
        Rule { enough: (number, items), ..self }
    }
}

/// Limits without a grade: look at most.
const NEVER_BAD: f64 = f64::INFINITY;

/// Rules of the page of a run.
///
/// Densities and total SD: aggregate nominal pulse density and absolute vertical accuracy (RMSEz) of
/// quality levels 2 and 3 (USGS, Lidar Base Specification, tables 1 and 4). The others are limits by
/// experience.
pub(crate) const WARNINGS: Rule = at_most("warnings and kinds of rejected items", "", [0.0, NEVER_BAD]);
pub(crate) const PULSE_DENSITY: Rule =
    Rule { is_minimum: true, ..at_most("mean pulse density", "per m²", [2.0, 0.5]) }.from(100, "pulses");
pub(crate) const WITHHELD: Rule = at_most("withheld returns", "%", [5.0, 20.0]).from(100, "returns");
pub(crate) const WITHOUT_RETURN: Rule =
    at_most("waveforms without return", "%", [10.0, NEVER_BAD]).from(100, "waveforms");
pub(crate) const TIME_GAP: Rule =
    at_most("longest time without shots", "s", [1.0, NEVER_BAD]).from(100, "shots");
pub(crate) const TRAJECTORY_GAP: Rule =
    at_most("longest gap of the trajectory", "s", [0.2, 1.0]).from(2, "records");
pub(crate) const ROLL: Rule = at_most("largest roll", "°", [10.0, 20.0]).from(2, "records");
pub(crate) const RANGE_SD: Rule = at_most("median range SD", "m", [0.03, 0.06]).from(100, "returns");
pub(crate) const TOTAL_SD: Rule = at_most("median total SD", "m", [0.1, 0.2]).from(100, "returns");
pub(crate) const UNCERTAIN_ZONES: Rule =
    at_most("returns of uncertain zone", "%", [1.0, 5.0]).from(100, "returns");
pub(crate) const UNEXPLAINED: Rule =
    at_most("returns with a deviation ratio above 5", "%", [5.0, 20.0]).from(100, "returns");
pub(crate) const OVERESTIMATED: Rule =
    at_most("returns with a deviation ratio below -5", "%", [1.0, 5.0]).from(100, "returns");
pub(crate) const DEVIATION_CENTRE: Rule =
    at_most("distance of the median deviation ratio from 0", "", [1.0, 3.0]).from(100, "returns");
pub(crate) const PILE_UP: Rule =
    at_most("shots whose weak returns pile up at one distance behind strong ones", "%", [2.0, 10.0])
        .from(100, "shots with a strong return");
pub(crate) const GROUND_MISSING: Rule =
    at_most("shots without ground", "%", [10.0, NEVER_BAD]).from(100, "shots");
pub(crate) const AMBIGUOUS_GROUND: Rule =
    at_most("shots whose ground has a probability below 0.9", "%", [50.0, NEVER_BAD]).from(100, "shots");
pub(crate) const SATURATED: Rule = at_most("saturated waveforms", "%", [5.0, 20.0]).from(100, "waveforms");
pub(crate) const CALIBRATION: Rule =
    Rule { is_minimum: true, ..at_most("waveforms of the calibration", "", [500.0, 100.0]) };
pub(crate) const SHAPE_ERROR: Rule =
    at_most("largest shape error of the response", "% of the peak", [1.0, 3.0]);

/// Rules of the ground classification; `report/page/ground.rs` states reasons and remedies.
pub(crate) const GROUND_DENSITY: Rule =
    Rule { is_minimum: true, ..at_most("ground points", "per m²", [0.5, 0.1]) }.from(100, "points");
pub(crate) const BARE_AREA: Rule =
    at_most("covered area without ground within 5 m", "%", [10.0, 30.0]).from(100, "cells");
pub(crate) const LOW_NOISE: Rule = at_most("low noise (7)", "%", [0.5, 2.0]).from(100, "returns");
pub(crate) const HIGH_NOISE: Rule = at_most("high noise (18)", "%", [1.0, 5.0]).from(100, "returns");

/// Rules of the page of a survey.
///
/// Roughness: smooth surface repeatability of quality levels 2 and 3 (USGS, Lidar Base Specification,
/// table 2). Differences between strips: the default of the job is their swath overlap difference.
pub(crate) const FAILED_STRIPS: Rule = at_most("strips failed or left out", "", [0.0, 0.0]);
pub(crate) const BELOW_TARGET: Rule = at_most("area below the required density", "%", [5.0, 20.0]);
pub(crate) const GAPS: Rule = at_most("area of gaps", "% of the area", [0.0, 1.0]);
pub(crate) const UNEXPLAINED_WAVEFORMS: Rule =
    at_most("waveforms that the returns do not explain", "%", [5.0, 20.0]).from(100, "waveforms");
pub(crate) const PAIRS: Rule = at_most("pairs of strips beyond the limit", "", [0.0, NEVER_BAD]);
pub(crate) const ROUGHNESS: Rule = at_most("median roughness", "m", [0.06, 0.12]).from(100, "smooth cells");

/// Rules of the page of an alignment: those of its verdict.
pub(crate) const RESIDUAL_SCALE: Rule =
    at_most("remaining differences in stated SDs", "", [DOUBTFUL_SCALE, BAD_SCALE]).from(1, "used pair");
pub(crate) const REJECTED_PAIRS: Rule =
    at_most("rejected pairs", "%", [100.0 * DOUBTFUL_REJECTED, 100.0 * BAD_REJECTED]).from(1, "pair");
pub(crate) const SPREAD_RATIO: Rule =
    at_most("differences after over those before", "", [WORSE, WORSE]).from(1, "used pair");
pub(crate) const PARAMETER_CHANGE: Rule =
    at_most("largest change of a parameter in SDs of its start value", "", [DOUBTFUL_CHANGE_SDS, NEVER_BAD]);
pub(crate) const STRIPS_NOT_ALIGNED: Rule = at_most("strips left out or not aligned", "", [0.0, NEVER_BAD]);
pub(crate) const PATCHES_WITHOUT_POSE: Rule =
    at_most("patches outside of the trajectory", "%", [1.0, NEVER_BAD]).from(100, "patches");

/// RMS of height differences between strips: good up to the limit of the job, look up to twice that.
pub(crate) fn difference_rms(limit_m: f64) -> Rule {
    at_most("RMS of height differences", "m", [limit_m, 2.0 * limit_m]).from(100, "cells")
}

/// Offset of a strip: good up to a quarter of the limit of the RMS, look up to all of it.
pub(crate) fn strip_offset(limit_m: f64) -> Rule {
    at_most("largest offset of a strip", "m", [0.25 * limit_m, limit_m])
}

/// Pulse density that a job requires: good from it, look from three quarters of it.
pub(crate) fn target_density(target_per_m2: f64) -> Rule {
    Rule { limits: [target_per_m2, 0.75 * target_per_m2], ..PULSE_DENSITY }
}

/// Rules of the page of a recording.
pub(crate) const REJECTED: Rule = at_most("kinds of rejected items", "", [0.0, NEVER_BAD]);
pub(crate) const CLOCK_STEPS: Rule =
    at_most("backward steps of the clock", "", [0.0, NEVER_BAD]).from(100, "shots");
pub(crate) const WITHOUT_ECHO: Rule =
    at_most("shots without echo", "%", [10.0, NEVER_BAD]).from(100, "shots");
pub(crate) const SATURATED_BLOCKS: Rule = at_most("saturated blocks", "%", [5.0, 20.0]).from(100, "blocks");

/// A graded quantity.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct QualityCheck {
    /// Grade.
    pub(crate) grade: Grade,
    /// The value, or why there is none.
    pub(crate) measured: String,
    /// The rule in words.
    pub(crate) rule: String,
}

/// Verdict on a section.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Verdict(pub(crate) Vec<QualityCheck>);

impl Verdict {
    /// Worst grade; not assessed without any other.
    pub(crate) fn grade(&self) -> Grade {
        self.0.iter().map(|check| check.grade).max().unwrap_or(Grade::NotAssessed)
    }
}

impl Rule {
    /// Checks a value that was measured from `items`; `None` if it is unknown.
    pub(crate) fn check(&self, value: Option<f64>, items: u64) -> QualityCheck {
        let rule = self.words();
        let (least, name) = self.enough;
        let Some(value) = value.filter(|value| value.is_finite() && items >= least) else {
            let few = format!("{}: {} {name}, {least} needed", self.quantity, label(items as f64, 0));
            let measured = if items < least { few } else { format!("{}: unknown", self.quantity) };
            return QualityCheck { grade: Grade::NotAssessed, measured, rule };
        };
        let is_within = |limit: f64| if self.is_minimum { value >= limit } else { value <= limit };
        let grade = match self.limits.map(is_within) {
            [true, _] => Grade::Good,
            [false, true] => Grade::Look,
            [false, false] => Grade::Bad,
        };
        QualityCheck {
            grade,
            measured: self.with_unit(&format!("{}: {}", self.quantity, short(value))),
            rule,
        }
    }

    /// Checks the share of a part in percent.
    pub(crate) fn share(&self, part: u64, of: u64) -> QualityCheck {
        self.check((of > 0).then(|| 100.0 * part as f64 / of as f64), of)
    }

    /// The limits in words.
    fn words(&self) -> String {
        let side = if self.is_minimum { "from" } else { "up to" };
        let [good, look] = self.limits;
        let limit = |value: f64| self.with_unit(&short(value));
        match (good == 0.0, look) {
            (true, NEVER_BAD) => "good if none, else look".to_owned(),
            (false, NEVER_BAD) => format!("good {side} {}, else look", limit(good)),
            (false, bad) if bad == good => format!("good {side} {}, else bad", limit(good)),
            (true, 0.0) => "good if none, else bad".to_owned(),
            (true, _) => format!("good if none, look {side} {}, else bad", limit(look)),
            (false, _) => format!("good {side} {}, look {side} {}, else bad", limit(good), limit(look)),
        }
    }

    fn with_unit(&self, text: &str) -> String {
        with_unit(text, self.unit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn limits_are_inclusive_and_in_words() {
        let grade = |rule: Rule, value: f64| rule.check(Some(value), 1000).grade;
        assert_eq!(
            [2.0, 1.99, 0.5, 0.49].map(|value| grade(PULSE_DENSITY, value)),
            [Grade::Good, Grade::Look, Grade::Look, Grade::Bad]
        );
        assert_eq!(
            [5.0, 5.1, 20.0, 20.1].map(|value| grade(WITHHELD, value)),
            [Grade::Good, Grade::Look, Grade::Look, Grade::Bad]
        );
        assert_eq!(
            [0.0, 1.0, 1e9].map(|value| grade(WARNINGS, value)),
            [Grade::Good, Grade::Look, Grade::Look]
        );
        assert_eq!([0.0, 1.0].map(|value| grade(FAILED_STRIPS, value)), [Grade::Good, Grade::Bad]);
        let found = PULSE_DENSITY.check(Some(3.1378), 100);
        assert_eq!(found.measured, "mean pulse density: 3.14 per m²");
        assert_eq!(found.rule, "good from 2 per m², look from 0.5 per m², else bad");
        assert_eq!(WARNINGS.check(Some(0.0), 1).rule, "good if none, else look");
        assert_eq!(ROLL.check(Some(4.0), 9).measured, "largest roll: 4°");
        assert_eq!(GAPS.check(Some(0.5), 9).rule, "good if none, look up to 1 % of the area, else bad");
        assert_eq!(target_density(4.0).check(Some(3.0), 100).grade, Grade::Look);
        assert_eq!(SPREAD_RATIO.check(Some(1.2), 1).rule, "good up to 1.1, else bad");
        assert_eq!(difference_rms(0.08).check(Some(0.17), 100).grade, Grade::Bad);
    }

    #[test]
    fn too_little_data_is_never_good() {
        let few = WITHHELD.share(0, 99);
        assert_eq!(
            (few.grade, few.measured.as_str()),
            (Grade::NotAssessed, "withheld returns: 99 returns, 100 needed")
        );
        assert_eq!(WITHHELD.share(0, 0).grade, Grade::NotAssessed);
        assert_eq!(RANGE_SD.check(Some(f64::NAN), 1000).grade, Grade::NotAssessed);
        assert_eq!(RANGE_SD.check(None, 1000).measured, "median range SD: unknown");
        assert_eq!(Verdict::default().grade(), Grade::NotAssessed);
    }

    #[test]
    fn the_worst_check_decides() {
        let of = |grades: &[Grade]| {
            let check =
                |grade: &Grade| QualityCheck { grade: *grade, measured: String::new(), rule: String::new() };
            Verdict(grades.iter().map(check).collect()).grade()
        };
        assert_eq!(of(&[Grade::Good, Grade::NotAssessed]), Grade::Good);
        assert_eq!(of(&[Grade::Good, Grade::Look]), Grade::Look);
        assert_eq!(of(&[Grade::Bad, Grade::Look, Grade::Good]), Grade::Bad);
    }
}
