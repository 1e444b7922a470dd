//! Texts of an alignment for people, and the calibration file.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::control::Control;
use super::installations::{installations, misplaced};
use super::jobs::JobPlace;
use super::strips::SurveyStrips;
use super::{CALIBRATION_FILE, CORRECTIONS_FILE};
use crate::from_returns::writes_returns;
use wavex_align::estimable::{
    DOUBTFUL_CHANGE_SDS, DOUBTFUL_REJECTED, DOUBTFUL_SCALE, DOUBTFUL_SHARED, FlightFacts, Treatment, Verdict,
    reasons,
};
use wavex_align::result::{Alignment, OverlapResult, ParameterResult};
use wavex_engine::job::Job;
use wavex_geodesy::calibration::Calibration;
use wavex_pages::report::align::AlignVerdict;

/// Most overlaps that are listed.
const LISTED: usize = 12;

/// Factors of SDs beyond this are noted.
const NOTED_FACTOR: f64 = 1.5;

/// Parameters, differences of the strips, verdict.
pub(super) fn summary(
    places: &[JobPlace<'_>],
    survey: &SurveyStrips,
    result: &Alignment,
    control: Option<&Control>,
) -> String {
    let mut text = String::new();
    // Writing to a text cannot fail.
    let _ = writeln!(text, "{:<24} {:>12} {:>10}", "parameter", "value", "SD");
    for own in installations(places, result) {
        if let Some(name) = own.name {
            let _ = writeln!(text, "{name}:");
        }
        for found in own.parameters.iter().filter(|found| found.treatment != Treatment::Given) {
            text += &line_of(found, own.facts);
        }
    }
    let names: Vec<&str> = survey.strips.iter().map(|strip| strip.name.as_str()).collect();
    text += &differences(&names, result);
    for (own, what) in result.trajectory_sds.iter().flatten().zip(["positions", "attitudes"]) {
        if own.is_used && !(1.0 / NOTED_FACTOR..=NOTED_FACTOR).contains(&own.factor) {
            let _ = writeln!(text, "{what} of the trajectories have {:.2} times the given SDs", own.factor);
        }
    }
    text += &control.map_or_else(String::new, |control| control.summary(result));
    let _ = writeln!(text, "verdict: {}", AlignVerdict::from(result.verdict).word());
    text
}

/// Strips, pairs, and the overlaps that differ most.
pub(super) fn differences(names: &[&str], result: &Alignment) -> String {
    let mut text = String::new();
    let all = names.len();
    let aligned = result.strips.iter().filter(|strip| strip.n_pairs > 0).count();
    let n = if aligned == all { all.to_string() } else { format!("{aligned} of {all}") };
    let _ = writeln!(
        text,
        "\n{n} strips, {} pairs of patches, {} rejected; differences (robust SD):",
        result.n_pairs, result.n_rejected
    );
    let name = |strip: u32| names.get(strip as usize).copied().unwrap_or_default();
    let mut overlaps: Vec<&OverlapResult> = result.overlaps.iter().collect();
    overlaps.sort_by(|a, b| b.spread_m[1].total_cmp(&a.spread_m[1]));
    for overlap in overlaps.iter().take(LISTED) {
        let names = overlap.strips.map(name).join(", ");
        let _ = writeln!(text, "  {names}: {}", before_and_after(overlap.spread_m));
    }
    if let more @ 1.. = overlaps.len().saturating_sub(LISTED) {
        let _ = writeln!(text, "  and {more} more with smaller differences");
    }
    let _ = writeln!(text, "  all: {}", before_and_after(result.spread_m));
    text
}

/// Differences of strips; before, they may be too far apart for pairs.
fn before_and_after([before_m, after_m]: [f64; 2]) -> String {
    let before = match before_m.is_nan() {
        true => "too far apart before".to_owned(),
        false => format!("{:.1} mm before", 1e3 * before_m),
    };
    format!("{before}, {:.1} mm after", 1e3 * after_m)
}

/// What is wrong with an alignment that is not good, and what to do.
pub(super) fn problem(places: &[JobPlace<'_>], survey: &SurveyStrips, result: &Alignment) -> Option<String> {
    let remedy = remedy(result.verdict)?;
    Some(format!(
        "the alignment is {}: {}; {remedy}",
        AlignVerdict::from(result.verdict).word(),
        causes(places, survey, result).join("; ")
    ))
}

/// What to do about an alignment that is not good.
pub(super) fn remedy(verdict: Verdict) -> Option<&'static str> {
    match verdict {
        Verdict::Good => None,
        Verdict::Doubtful => {
            Some("check mount, units of the start values and trajectories, or try `--trajectory 20`")
        }
        Verdict::Bad => Some(
            "check mount, units of the start values, trajectories and coordinates; calibration and corrections are not written",
        ),
    }
}

/// Reasons why an alignment is not good; empty if it is good.
pub(super) fn causes(places: &[JobPlace<'_>], survey: &SurveyStrips, result: &Alignment) -> Vec<String> {
    let mut causes = Vec::new();
    if result.verdict == Verdict::Good {
        return causes;
    }
    let rejected = result.n_rejected as f64 / result.n_pairs.max(1) as f64;
    if rejected > DOUBTFUL_REJECTED {
        causes.push(format!("{:.0} % of the pairs are rejected", 100.0 * rejected));
    }
    if result.scale > DOUBTFUL_SCALE {
        causes.push(format!("the remaining differences are {:.1} times their SDs", result.scale));
    }
    if result.control.contradicts() {
        causes.push("the control points contradict the trajectories".to_owned());
    }
    if result.spread_m[1] > result.spread_m[0] {
        causes.push("strips differ more than before".to_owned());
    }
    causes.extend(misplaced(survey, result));
    causes.extend(shared_errors(result));
    let all =
        installations(places, result).flat_map(|own| own.parameters.iter().map(move |one| (own.name, one)));
    let moved = all.filter(|(_, found)| found.change_sds() > DOUBTFUL_CHANGE_SDS);
    causes.extend(moved.map(|(installation, found)| {
        let (name, unit_name, unit) = found.parameter.label();
        let change = (found.value - found.start) / unit;
        format!(
            "the {name}{} moves by {change:.3} {unit_name}, {:.0} SDs of its start value",
            installation.map_or_else(String::new, |name| format!(" of {name}")),
            found.change_sds()
        )
    }));
    causes
}

/// Errors of trajectories that their corrections do not follow; `None` below the threshold.
fn shared_errors(result: &Alignment) -> Option<String> {
    let found = result.time_errors.filter(|own| own.factor > DOUBTFUL_SHARED)?;
    Some(format!(
        "trajectories change within {:.1} s by more than their corrections, and all SDs are raised {:.1} times for it; give \
         knots closer than that with `--trajectory`, such as `--trajectory {}`",
        2.0 * found.interval_s,
        found.factor.sqrt(),
        knots_s(found.interval_s)
    ))
}

/// Distance of knots that follows errors which intervals of this length show, s.
fn knots_s(interval_s: f64) -> f64 {
    [20.0, 10.0, 5.0, 2.0, 1.0].into_iter().find(|step_s| *step_s <= interval_s).unwrap_or(0.5)
}

fn line_of(found: &ParameterResult, facts: &FlightFacts) -> String {
    let (text, unit_name, unit) = found.parameter.label();
    let value = found.value / unit;
    let start = format!("{:<24} {value:>12.5}", format!("{text}, {unit_name}"));
    let with_causes = |text: String| {
        let causes = reasons(found.parameter, facts);
        let lines = causes.iter().map(|(cause, remedy)| format!("    {cause}; {remedy}\n"));
        let unknown = causes
            .is_empty()
            .then(|| "    other parameters have the same effect on this flight\n".to_owned());
        lines.chain(unknown).fold(text, |text, line| text + &line)
    };
    match found.treatment {
        Treatment::NotEstimable => with_causes(format!("{start}   not estimable\n")),
        Treatment::OnlyCombined => {
            with_causes(format!("{start} {:>10.5}   only with others\n", found.sd / unit))
        }
        Treatment::Given | Treatment::Estimated => format!("{start} {:>10.5}\n", found.sd / unit),
    }
}

/// Keys of the job that use the files, as `KEY=VALUE`.
pub(super) fn settings(place: &JobPlace<'_>, written: &[PathBuf]) -> Vec<String> {
    let files = [(CALIBRATION_FILE, "calibration"), (CORRECTIONS_FILE, "corrections")];
    let files = files.map(|(name, key)| (place.output.join(name), key));
    let written = files.into_iter().filter(|(file, _)| written.contains(file));
    let setting = |(file, key): (PathBuf, &str)| {
        let file = from_inputs(&file, place.input_dir());
        format!("job.geometry.{key}={}", toml::Value::String(file.display().to_string()))
    };
    written.map(setting).collect()
}

/// The commands that use the files.
pub(super) fn next_commands(places: &[JobPlace<'_>], settings: &[Vec<String>]) -> String {
    let mut text = String::new();
    for (place, settings) in places.iter().zip(settings).filter(|(_, settings)| !settings.is_empty()) {
        let _ = write!(text, "next: wavex run {}", place.job.name);
        if reads_returns(place.job) || writes_returns(place.job) {
            text += " --from-returns";
        }
        for setting in settings {
            let _ = write!(text, " \\\n  --set '{setting}'");
        }
        text.push('\n');
    }
    text
}

/// Whether the job was made by [`from_returns`](crate::from_returns).
fn reads_returns(job: &Job) -> bool {
    job.stages.first().is_some_and(|stage| stage.spec.name == "read_returns")
}

/// Path of a file as keys of `[job.geometry]` give it: relative to `input_dir` if it is below, else absolute.
fn from_inputs(file: &Path, input_dir: &Path) -> PathBuf {
    let whole = file.canonicalize().unwrap_or_else(|_| file.to_owned());
    let folder = if input_dir.as_os_str().is_empty() { Path::new(".") } else { input_dir };
    match folder.canonicalize() {
        Ok(folder) => whole.strip_prefix(folder).map(Path::to_owned).unwrap_or(whole),
        Err(_) => whole,
    }
}

/// Text of a calibration file: the same bytes for the same values, which it restores exactly.
pub(super) fn calibration_text(calibration: &Calibration) -> String {
    let Calibration { lever_arm_m, boresight_deg, e0, e1, e2, e3, e4, e5, e6, e7, time_offset_s } =
        calibration;
    format!(
        "# Calibration of a scanner by `wavex align`, for `calibration` in `[job.geometry]`.\n\
         lever_arm_m = {lever_arm_m:?}\nboresight_deg = {boresight_deg:?}\n\
         e0 = {e0:?}\ne1 = {e1:?}\ne2 = {e2:?}\ne3 = {e3:?}\ne4 = {e4:?}\ne5 = {e5:?}\ne6 = {e6:?}\ne7 = {e7:?}\n\
         time_offset_s = {time_offset_s:?}\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_without_pairs_before_are_too_far_apart() {
        assert_eq!(before_and_after([0.2, 0.001]), "200.0 mm before, 1.0 mm after");
        assert_eq!(before_and_after([f64::NAN, 0.001]), "too far apart before, 1.0 mm after");
    }
}
