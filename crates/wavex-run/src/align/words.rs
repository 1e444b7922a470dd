//! Texts of an alignment for people, and the calibration file.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::report::verdict_word;
use super::strips::SurveyStrips;
use super::{AlignRequest, CALIBRATION_FILE, CORRECTIONS_FILE};
use wavex_align::adjust::{Alignment, OverlapResult, ParameterResult};
use wavex_align::estimable::{FlightFacts, Treatment, reasons};
use wavex_align::parameters::Global;
use wavex_geodesy::calibration::Calibration;

/// Warning about a bad alignment.
pub(super) const IS_BAD: &str = "the alignment is bad: strips differ more than before, or most pairs of patches were rejected; check mount, \
    trajectories and coordinates, and do not use the files";

/// Most overlaps that are listed.
const LISTED: usize = 12;

/// Parameters, differences of the strips, verdict.
pub(super) fn summary(survey: &SurveyStrips, result: &Alignment) -> String {
    let mut text = String::new();
    let parameters = result.parameters.first().map_or(&[][..], |all| &all[..]);
    // Writing to a text cannot fail.
    let _ = writeln!(text, "{:<24} {:>12} {:>10}", "parameter", "value", "SD");
    for found in parameters.iter().filter(|found| found.treatment != Treatment::Given) {
        text += &line_of(found, &result.facts);
    }
    let n = survey.strips.len();
    let _ = writeln!(
        text,
        "\n{n} strips, {} pairs of patches, {} rejected; differences (robust SD):",
        result.n_pairs, result.n_rejected
    );
    let name = |strip: u32| survey.strips.get(strip as usize).map_or("", |strip| &strip.name);
    let mut overlaps: Vec<&OverlapResult> = result.overlaps.iter().collect();
    overlaps.sort_by(|a, b| b.spread_m[1].total_cmp(&a.spread_m[1]));
    for overlap in overlaps.iter().take(LISTED) {
        let names = overlap.strips.map(name).join(", ");
        let [before_mm, after_mm] = overlap.spread_m.map(|spread_m| 1e3 * spread_m);
        let _ = writeln!(text, "  {names}: {before_mm:.1} mm before, {after_mm:.1} mm after");
    }
    if let more @ 1.. = overlaps.len().saturating_sub(LISTED) {
        let _ = writeln!(text, "  and {more} more with smaller differences");
    }
    let [before_mm, after_mm] = result.spread_m.map(|spread_m| 1e3 * spread_m);
    let _ = writeln!(text, "  all: {before_mm:.1} mm before, {after_mm:.1} mm after");
    let _ = writeln!(text, "verdict: {}", verdict_word(result.verdict));
    text
}

/// Label of a parameter with its unit, and the unit's size in that of [`Global::name`].
fn label(parameter: Global) -> (&'static str, f64) {
    let degree = 1f64.to_radians();
    match parameter {
        Global::LeverForward => ("lever arm forward, m", 1.0),
        Global::LeverRight => ("lever arm right, m", 1.0),
        Global::LeverDown => ("lever arm down, m", 1.0),
        Global::Roll => ("boresight roll, deg", degree),
        Global::Pitch => ("boresight pitch, deg", degree),
        Global::Yaw => ("boresight yaw, deg", degree),
        Global::E0 => ("range offset e0, m", 1.0),
        Global::E7 => ("range offset e7, m", 1.0),
        Global::Time => ("time offset, ms", 1e-3),
        other => (other.name(), 1.0),
    }
}

fn line_of(found: &ParameterResult, facts: &FlightFacts) -> String {
    let (label, unit) = label(found.parameter);
    let value = found.value / unit;
    let start = format!("{label:<24} {value:>12.5}");
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

/// The command that uses the files.
pub(super) fn next_command(request: &AlignRequest<'_>, input_dir: &Path, written: &[PathBuf]) -> String {
    let has = |name: &str| written.iter().any(|path| path.ends_with(name));
    let mut command = format!("wavex run {}", request.job.name);
    for (name, key) in [(CALIBRATION_FILE, "calibration"), (CORRECTIONS_FILE, "corrections")] {
        if has(name) {
            let file = from_inputs(&request.output.join(name), input_dir);
            let value = toml::Value::String(file.display().to_string());
            let _ = write!(command, " \\\n  --set 'job.geometry.{key}={value}'");
        }
    }
    format!("next: {command}\n")
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
