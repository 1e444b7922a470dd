//! HTML page of an alignment; needs no network or scripts.

use maud::{Markup, html};
use wavex_align::observation::Observation;
use wavex_align::parameters::Global;

use super::residual_map::ResidualMap;
use super::{
    AlignReport, AlignVerdict, AlignedParameter, AlignedStrip, FileDigest, Overlap, ParameterTreatment,
    TrajectoryForm, TrajectoryWord, figures,
};
use crate::numbers::{label, short};
use crate::page::{PagePart, document, figures as side_by_side, maps, section, table, tiles, with_contents};
use crate::verdict::{self, Grade, QualityCheck};

/// Most rows of the table of overlaps.
const MOST_OVERLAPS: usize = 500;
/// Most rows of the table of files.
const MOST_FILES: usize = 500;

/// Additions for this page.
const OWN_STYLE: &str = "\
.rejected{fill:none;stroke:var(--limit);stroke-width:1.1}
.outcome{font-size:17px;margin:0 0 4px}.outcome .badge{font-size:15px;line-height:24px;padding:0 12px;border-radius:12px}
.remedy{margin:6px 0 14px}
";

/// Renders an alignment; each part judges what it shows.
pub fn page(report: &AlignReport, observations: &[Observation]) -> String {
    let map = ResidualMap::new(observations);
    let parts = [
        PagePart::new("Parameters", parameters(report)).judged(parameter_checks(report)),
        PagePart::new("Strip differences", differences(report, observations))
            .judged(difference_checks(report)),
        PagePart::new("Residuals on the ground", ground(report, map.as_ref())),
        PagePart::new("Strips", strips(report)).judged(strip_checks(report)),
        PagePart::new("Flight and files", flight_and_files(report)),
    ];
    let first = html! { (outcome(report)) (key_figures(report)) (warnings(report)) };
    let header = html! {
        h1 { "Strip alignment" }
        p.about { (report.job) "; wavex " (report.wavex) "; corrections of trajectories: " (form(report)) }
    };
    document("wavex align", OWN_STYLE, &header, &with_contents(&parts, "", &first))
}

fn form(report: &AlignReport) -> String {
    match report.trajectory_model {
        TrajectoryForm::Word(TrajectoryWord::None) => "none".to_owned(),
        TrajectoryForm::Word(TrajectoryWord::Constant) => "constant for each strip".to_owned(),
        TrajectoryForm::Word(TrajectoryWord::Linear) => "linear for each strip".to_owned(),
        TrajectoryForm::KnotsEvery(step_s) => {
            format!("linear between knots at most {} s apart", short(step_s))
        }
    }
}

/// The verdict with its reasons, and what to do.
fn outcome(report: &AlignReport) -> Markup {
    let (class, words) = match report.verdict {
        AlignVerdict::Good => ("badge good", "the remaining differences of the strips are noise."),
        AlignVerdict::Doubtful => ("badge look", "check the result before you use it."),
        AlignVerdict::Bad => (
            "badge bad",
            "do not use this result. Calibration and corrections of trajectories are not written.",
        ),
    };
    html! {
        section {
            h2 { "Verdict" }
            p.outcome { span class=(class) { (report.verdict.word()) } " " (words) }
            @if !report.problems.is_empty() { ul.notes { @for problem in &report.problems { li { (problem) } } } }
            @if let Some(remedy) = &report.remedy { p.remedy { b { "What to do: " } (with_code(remedy)) "." } }
        }
    }
}

/// Text whose parts in backticks are code.
fn with_code(text: &str) -> Markup {
    html! {
        @for (i, part) in text.split('`').enumerate() { @if i % 2 == 1 { code { (part) } } @else { (part) } }
    }
}

fn warnings(report: &AlignReport) -> Markup {
    html! {
        section {
            h2 { "Warnings" }
            @if report.warnings.is_empty() { p { "None." } }
            @else { ul.notes { @for warning in &report.warnings { li { (warning) } } } }
        }
    }
}

/// Length in millimetres; `None` is not drawn as 0.
fn millimetres(value_m: Option<f64>, unknown: &str) -> String {
    value_m.map_or_else(|| unknown.to_owned(), |value_m| label(1e3 * value_m, 1))
}

fn aligned(report: &AlignReport) -> usize {
    report.strips.iter().filter(|strip| strip.pairs > 0).count()
}

fn rejected_percent(rejected: usize, pairs: usize) -> Option<f64> {
    (pairs > 0).then(|| 100.0 * rejected as f64 / pairs as f64)
}

fn key_figures(report: &AlignReport) -> Markup {
    let all = report.strips.len() + report.failed_strips.len();
    let rejected = rejected_percent(report.rejected_pairs, report.pairs);
    tiles([
        ("strips aligned", Some(format!("{} of {all}", aligned(report)))),
        ("mm between strips before", Some(millimetres(report.spread_before_m, "too far apart"))),
        ("mm between strips after", Some(millimetres(report.spread_after_m, "unknown"))),
        ("robust SD over stated SD", Some(short(report.residual_scale))),
        ("pairs of patches", Some(label(report.pairs as f64, 0))),
        ("% of them rejected", rejected.map(|percent| label(percent, 1))),
        ("unknowns", Some(label(report.unknowns as f64, 0))),
    ])
}

fn parameter_checks(report: &AlignReport) -> Vec<QualityCheck> {
    let changes = || report.parameters.iter().filter_map(AlignedParameter::change_sds);
    let mut checks =
        vec![verdict::PARAMETER_CHANGE.check(changes().reduce(f64::max), changes().count() as u64)];
    if report.verdict == AlignVerdict::Bad {
        checks.push(QualityCheck {
            grade: Grade::Bad,
            measured: "the alignment is bad: values and SDs mean nothing".to_owned(),
            rule: "see the verdict".to_owned(),
        });
    }
    checks
}

fn difference_checks(report: &AlignReport) -> Vec<QualityCheck> {
    let used = (report.pairs - report.rejected_pairs.min(report.pairs)) as u64;
    let ratio = report.spread_before_m.zip(report.spread_after_m).map(|(before, after)| after / before);
    vec![
        verdict::RESIDUAL_SCALE.check(Some(report.residual_scale), used),
        verdict::SPREAD_RATIO.check(ratio, used),
        verdict::REJECTED_PAIRS.share(report.rejected_pairs as u64, report.pairs as u64),
    ]
}

fn strip_checks(report: &AlignReport) -> Vec<QualityCheck> {
    let all = report.strips.len() + report.failed_strips.len();
    let lost = |strip: &AlignedStrip| strip.patches_without_pose as u64;
    let patches: u64 = report.strips.iter().map(|strip| strip.patches as u64).sum();
    vec![
        verdict::STRIPS_NOT_ALIGNED.check(Some((all - aligned(report)) as f64), all as u64),
        verdict::PATCHES_WITHOUT_POSE.share(report.strips.iter().map(lost).sum(), patches),
    ]
}

/// Text, unit, and size of the unit of a parameter.
fn label_of(name: &str) -> (&str, &str, f64) {
    let known = Global::ALL.into_iter().find(|global| global.name() == name);
    match known {
        Some(known) => known.label(),
        None => (name, "", 1.0),
    }
}

/// Text after the installation, if there are several.
fn of_installation(installation: Option<&str>, text: &str) -> String {
    installation.map_or_else(|| text.to_owned(), |installation| format!("{installation}: {text}"))
}

/// Text with its unit.
fn titled(text: &str, unit: &str) -> String {
    if unit.is_empty() { text.to_owned() } else { format!("{text}, {unit}") }
}

fn parameters(report: &AlignReport) -> Markup {
    let heads = [
        "parameter",
        "start",
        "SD of start",
        "value",
        "SD",
        "formal SD",
        "SD by scatter",
        "treatment",
        "why, and what to fly",
    ];
    let is_open = |parameter: &&AlignedParameter| parameter.treatment != ParameterTreatment::Given;
    let given: Vec<String> = report
        .parameters
        .iter()
        .filter(|parameter| !is_open(parameter))
        .map(|parameter| {
            let (text, unit, size) = label_of(&parameter.name);
            let text = of_installation(parameter.installation.as_deref(), text);
            format!("{text} {} {unit}", short(parameter.value / size)).trim_end().to_owned()
        })
        .collect();
    let row = |parameter: &AlignedParameter| {
        let (text, unit, size) = label_of(&parameter.name);
        let number = |value: f64| label(value / size, 5);
        let is_kept = parameter.treatment == ParameterTreatment::NotEstimable;
        let found = |sd: f64| if is_kept { "–".to_owned() } else { number(sd) };
        let treatment = match parameter.treatment {
            ParameterTreatment::Given => "given",
            ParameterTreatment::Estimated => "estimated",
            ParameterTreatment::NotEstimable => "not estimable: kept",
            ParameterTreatment::OnlyCombined => "only with others",
        };
        let reasons: Vec<String> =
            parameter.reasons.iter().map(|reason| format!("{}: {}", reason.cause, reason.remedy)).collect();
        let reasons = match parameter.treatment {
            ParameterTreatment::Given | ParameterTreatment::Estimated => String::new(),
            _ if reasons.is_empty() => "other parameters have the same effect on this flight".to_owned(),
            _ => reasons.join("; "),
        };
        vec![
            of_installation(parameter.installation.as_deref(), &titled(text, unit)),
            number(parameter.start),
            number(parameter.prior_sd),
            number(parameter.value),
            found(parameter.sd),
            found(parameter.formal_sd),
            found(parameter.jackknife_sd),
            treatment.to_owned(),
            reasons,
        ]
    };
    let correlations = report.correlations.iter().map(|found| {
        let [first, second] = found.parameters.each_ref().map(|name| match name.split_once('/') {
            Some((installation, name)) => of_installation(Some(installation), label_of(name).0),
            None => label_of(name).0.to_owned(),
        });
        vec![first, second, label(found.correlation, 3)]
    });
    html! {
        (table("Parameters", &heads, report.parameters.iter().filter(is_open).map(row)))
        p.about {
            "The SD is the larger of the formal one and that of the scatter between places. Not estimable: the flight says less about the "
            "parameter than was known before, so it keeps its start value and the SD of it. Only with others: changed, but only a combination with other parameters is determined."
            @if !given.is_empty() { " Given, and not estimated: " (given.join(", ")) "." }
        }
        (table("Correlations above 0.9", &["parameter", "with", "correlation"], correlations))
        @if report.correlations.is_empty() { p { "No two parameters have a correlation above 0.9." } }
    }
}

fn differences(report: &AlignReport, observations: &[Observation]) -> Markup {
    let heads = [
        "strips",
        "pairs",
        "rejected, %",
        "median before, mm",
        "median after, mm",
        "robust SD before, mm",
        "robust SD after, mm",
    ];
    let mut overlaps: Vec<&Overlap> = report.overlaps.iter().collect();
    // Unknown ones first: all of their pairs are rejected.
    let size = |overlap: &Overlap| overlap.spread_after_m.unwrap_or(f64::INFINITY);
    overlaps.sort_by(|a, b| size(b).total_cmp(&size(a)));
    let row = |overlap: &&Overlap| {
        vec![
            overlap.strips.join(" − "),
            label(overlap.pairs as f64, 0),
            rejected_percent(overlap.rejected_pairs, overlap.pairs)
                .map_or_else(|| "–".to_owned(), |percent| label(percent, 1)),
            millimetres(overlap.median_before_m, "too far apart"),
            millimetres(overlap.median_after_m, "all rejected"),
            millimetres(overlap.spread_before_m, "too far apart"),
            millimetres(overlap.spread_after_m, "all rejected"),
        ]
    };
    let left_out = overlaps.len().saturating_sub(MOST_OVERLAPS);
    let drawn = [figures::before_and_after(report, observations), figures::normalised(report, observations)];
    html! {
        (side_by_side(&drawn.into_iter().flatten().collect::<Vec<_>>()))
        (table("Differences by strips", &heads, overlaps.iter().take(MOST_OVERLAPS).map(row)))
        @if left_out > 0 { p.about { "The other " (left_out) " overlaps, with smaller differences, are in align.json." } }
        p.about {
            "Along the normals of the surface, first strip minus second. Before: pairs found with the start values; too far apart: there are none within 1.5 m. "
            "Robust SD: 1.4826 times the median of the absolute differences of the used pairs."
        }
    }
}

fn ground(report: &AlignReport, map: Option<&ResidualMap>) -> Markup {
    let Some(map) = map else { return html! { p { "No pair has a place." } } };
    let middle = &map.middle;
    let about = format!(
        "East and north of longitude {}°, latitude {}°. residuals.arrow has every pair with its place.",
        label(middle.longitude_rad.to_degrees(), 5),
        label(middle.latitude_rad.to_degrees(), 5)
    );
    maps(&about, map.frame.width(), &figures::maps(report, map))
}

fn strips(report: &AlignReport) -> Markup {
    let failed = report.failed_strips.iter().map(|failed| vec![failed.name.clone(), failed.problem.clone()]);
    let figures = figures::corrections(report);
    let heads = [
        "strip",
        "time, s",
        "shots",
        "patches",
        "without pose",
        "pairs",
        "north, mm",
        "east, mm",
        "down, mm",
        "roll, mdeg",
        "pitch, mdeg",
        "heading, mdeg",
        "remark",
    ];
    let row = |(i, strip): (usize, &AlignedStrip)| {
        let mut row = vec![
            format!("{}: {}", i + 1, strip.name),
            label(strip.last_s - strip.first_s, 1),
            label(strip.shots as f64, 0),
            label(strip.patches as f64, 0),
            label(strip.patches_without_pose as f64, 0),
            label(strip.pairs as f64, 0),
        ];
        row.extend((0..6).map(|offset| root_mean_square(strip, offset)));
        let lost = match strip.patches_without_pose {
            0 => None,
            1 => Some("1 patch is outside of the trajectory: check its gaps and its time".to_owned()),
            n => Some(format!("{n} patches are outside of the trajectory: check its gaps and its time")),
        };
        let alone =
            (strip.pairs == 0).then(|| "not aligned: shares no smooth surface with others".to_owned());
        row.push([alone, lost].into_iter().flatten().collect::<Vec<_>>().join("; "));
        row
    };
    html! {
        (table("Strips that could not be used", &["strip", "problem"], failed))
        @if figures.is_empty() { p { "No trajectory is corrected." } }
        (side_by_side(&figures))
        (table("Strips", &heads, report.strips.iter().enumerate().map(row)))
        p.about { "Corrections: root mean square over the knots of the strip; align.json has each knot with its SDs. –: not corrected." }
    }
}

/// Root mean square of an offset over the knots of a strip, mm or millidegrees.
fn root_mean_square(strip: &AlignedStrip, offset: usize) -> String {
    let is_kept = strip.prior_sds.get(offset).is_none_or(|sd| *sd == 0.0);
    if strip.pairs == 0 || strip.knots.is_empty() || is_kept {
        return "–".to_owned();
    }
    let values = strip.knots.iter().map(|knot| {
        let [north, east, down] = knot.north_east_down_m.map(|m| 1e3 * m);
        let [roll, pitch, heading] = knot.roll_pitch_heading_rad.map(|rad| 1e3 * rad.to_degrees());
        [north, east, down, roll, pitch, heading].get(offset).copied().unwrap_or(f64::NAN)
    });
    let mean = values.map(|value| value * value).sum::<f64>() / strip.knots.len() as f64;
    label(mean.sqrt(), 2)
}

fn flight_and_files(report: &AlignReport) -> Markup {
    let flight = &report.flight;
    let angle = |degrees: f64| format!("{}°", label(degrees, 1));
    let ranges = flight.ranges_m.map_or_else(
        || "unknown".to_owned(),
        |[low, high]| format!("{} to {} m", label(low, 0), label(high, 0)),
    );
    let rows = [
        ("crossing strips: largest angle of courses, up to 90°", angle(flight.crossing_deg)),
        ("opposite strips: largest angle of courses, up to 180°", angle(flight.turn_deg)),
        ("pairs on slopes above 10 %", format!("{} %", label(100.0 * flight.sloped_ratio, 1))),
        ("ranges of the pairs", ranges),
        ("largest difference of scan angles of a pair", angle(flight.scan_angle_difference_deg)),
        ("pairs of different receivers", label(flight.receiver_pairs as f64, 0)),
    ];
    let unknown = || "could not be read again".to_owned();
    let file = |kind: &str, path: &str, bytes: Option<u64>, digest: Option<&String>| {
        let size = bytes.map_or_else(unknown, |bytes| label(bytes as f64, 0));
        vec![path.to_owned(), kind.to_owned(), size, digest.cloned().unwrap_or_else(unknown)]
    };
    let of =
        |kind: &'static str| move |one: &FileDigest| file(kind, &one.path, one.bytes, one.blake3.as_ref());
    let recordings = report
        .strips
        .iter()
        .map(|strip| file("recording", &strip.recording, strip.bytes, strip.blake3.as_ref()));
    let trajectories = report.trajectories.iter().map(of("trajectory"));
    let calibration = report.calibration.iter().map(of("calibration"));
    let of_jobs =
        report.installations.iter().filter_map(|own| own.calibration.as_ref()).map(of("calibration"));
    let files = calibration.chain(of_jobs).chain(trajectories).chain(recordings);
    let left_out = (report.strips.len() + report.trajectories.len()).saturating_sub(MOST_FILES);
    html! {
        div.sections { (section("What the pairs show of the flight", rows.into_iter().map(|(name, value)| (name.to_owned(), value)))) }
        (table("Files", &["path", "content", "bytes", "BLAKE3"], files.take(MOST_FILES)))
        @if left_out > 0 { p.about { "The others are in align.json." } }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Covariance, Flight, VERSION};
    use super::*;

    /// Nothing is known, apart from two strips that miss each other.
    fn unknown() -> AlignReport {
        let strip = |name: &str| AlignedStrip {
            name: name.to_owned(),
            installation: None,
            recording: format!("{name}.las"),
            bytes: None,
            blake3: None,
            trajectory: None,
            first_s: 10.0,
            last_s: 20.0,
            shots: 1,
            patches: 1,
            sparse_cells: 0,
            cells_of_several_returns: 0,
            rough_cells: 0,
            thinned_patches: 0,
            pairs: 0,
            patches_without_pose: 1,
            prior_sds: [0.03; 6],
            knots: Vec::new(),
        };
        AlignReport {
            version: VERSION,
            wavex: "1".to_owned(),
            commit: String::new(),
            job: "<survey>.toml".to_owned(),
            trajectory_model: TrajectoryForm::Word(TrajectoryWord::None),
            verdict: AlignVerdict::Bad,
            problems: vec!["60 % of the pairs are rejected".to_owned()],
            remedy: Some("check mount".to_owned()),
            warnings: Vec::new(),
            installations: Vec::new(),
            parameters: Vec::new(),
            covariance: Covariance::default(),
            correlations: Vec::new(),
            strips: vec![strip("a"), strip("b")],
            failed_strips: Vec::new(),
            overlaps: vec![Overlap {
                strips: ["a", "b"].map(str::to_owned),
                pairs: 1,
                rejected_pairs: 1,
                median_before_m: None,
                median_after_m: None,
                spread_before_m: None,
                spread_after_m: None,
            }],
            spread_before_m: None,
            spread_after_m: None,
            residual_scale: 1.0,
            unknowns: 1,
            pairs: 1,
            rejected_pairs: 1,
            flight: Flight {
                crossing_deg: 0.0,
                turn_deg: 0.0,
                sloped_ratio: 0.0,
                ranges_m: None,
                scan_angle_difference_deg: 0.0,
                receiver_pairs: 0,
            },
            trajectories: Vec::new(),
            calibration: None,
            control: None,
            reference_strips: Vec::new(),
            trajectory_sds: None,
            shared_errors: None,
        }
    }

    #[test]
    fn what_is_unknown_is_said() {
        let text = page(&unknown(), &[]);
        for part in [
            "<b>too far apart</b><span>mm between strips before</span>",
            "<b>unknown</b><span>mm between strips after</span>",
            "<td>all rejected</td>",
            "No pair has a place.",
            "<td>unknown</td>",
            "could not be read again",
            "1 patch is outside of the trajectory",
            "not assessed",
            "&lt;survey&gt;.toml",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
        assert!(!text.contains("NaN") && !text.contains("inf m") && !text.contains("<svg"), "{text}");
    }

    #[test]
    fn a_page_is_made_from_its_report_alone() {
        let text = serde_json::to_string(&unknown()).unwrap();
        let again: AlignReport = serde_json::from_str(&text).unwrap();
        assert_eq!(again, unknown());
        assert_eq!(page(&again, &[]), page(&unknown(), &[]));
    }
}
