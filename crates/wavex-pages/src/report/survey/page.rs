//! HTML page of a survey; needs no network or scripts.

use maud::{Markup, html};
use serde_json::json;

use super::mosaic::Pictures;
use super::strip::{MOST_RETURNS, UNEXPLAINED};
use super::{StripFacts, Survey, SurveyStrip};
use crate::numbers::{label, short};
use crate::page::{PagePart, document, figure, maps as map_figures, section, table, tiles, with_contents};
use crate::report::page::{drift, words};
use crate::verdict::{self, QualityCheck};

mod figures;

/// Maximum number of rows of the table of pairs.
const MOST_PAIRS: usize = 500;
/// Fraction of a strip's waveforms without explanation, or of its returns withheld, for a warning.
const MANY: f64 = 0.05;
/// Offset of a strip for a warning, relative to the limit of the RMS of differences.
const OFFSET: f64 = 0.25;

/// Renders a survey; `pictures` exist if any strip has cells.
pub(super) fn page(survey: &Survey, pictures: Option<&Pictures>) -> String {
    let parts = [
        PagePart::new("Coverage and density", html! { (maps(survey, pictures)) (gaps(survey)) })
            .judged(coverage_checks(survey)),
        PagePart::new("Height differences", differences(survey)).judged(difference_checks(survey)),
        PagePart::new("Strips", strips(survey)).judged(strip_checks(survey)),
        PagePart::new("Waveforms and returns", quality(survey)).judged(quality_checks(survey)),
        PagePart::new("Uncertainty and trajectories", uncertainty(survey)).judged(uncertainty_checks(survey)),
        PagePart::new("Sensor", drift_of_sensor(survey)),
        PagePart::new("Limits", limits(survey)),
    ];
    let first = html! { (key_figures(survey)) (warnings(survey)) };
    let header = html! {
        h1 { "Survey" }
        p.about { "wavex " (survey.wavex) "; " (coordinates(survey)) }
    };
    document("wavex survey", OWN_STYLE, &header, &with_contents(&parts, "", &first))
}

/// Additions for this page.
const OWN_STYLE: &str = "\
polyline.track{stroke:var(--text);stroke-width:1;stroke-opacity:.7}
text.strip{font-weight:600;paint-order:stroke;stroke:var(--card);stroke-width:3px}
image.gap{image-rendering:pixelated}
";

fn coverage_checks(survey: &Survey) -> Vec<QualityCheck> {
    let cells = |area_m2: f64| (area_m2 / (survey.cell_m * survey.cell_m)).round() as u64;
    let area = (survey.area_m2 > 0.0).then_some(survey.area_m2);
    let percent = |part_m2: f64| area.map(|area_m2| 100.0 * part_m2 / area_m2);
    let mut checks = vec![verdict::GAPS.check(percent(survey.gaps.area_m2), cells(survey.area_m2))];
    match survey.below_target_m2 {
        Some(below_m2) => checks.push(verdict::BELOW_TARGET.check(percent(below_m2), cells(survey.area_m2))),
        None => {
            let mean = survey.pulses.as_ref().map(|density| density.mean_per_m2);
            let pulses = mean.map_or(0, |mean| (mean * survey.area_m2) as u64);
            checks.push(verdict::PULSE_DENSITY.check(mean, pulses));
        }
    }
    checks
}

fn difference_checks(survey: &Survey) -> Vec<QualityCheck> {
    let of = survey.differences.as_ref();
    let exceeding = survey.pairs.iter().filter(|pair| pair.exceeds_limit).count();
    let rms = verdict::difference_rms(survey.limits.max_difference_rms_m);
    vec![
        rms.check(of.map(|of| of.rms_m), of.map_or(0, |of| of.cells)),
        verdict::PAIRS.check(Some(exceeding as f64), survey.pairs.len() as u64),
    ]
}

fn strip_checks(survey: &Survey) -> Vec<QualityCheck> {
    let failed = survey.strips.len() - processed(survey);
    let roughness = survey.roughness.as_ref();
    let offsets = || survey.strips.iter().filter_map(|strip| strip.offset_m.map(f64::abs));
    let offset = verdict::strip_offset(survey.limits.max_difference_rms_m);
    vec![
        offset.check(offsets().reduce(f64::max), offsets().count() as u64),
        verdict::FAILED_STRIPS.check(Some(failed as f64), survey.strips.len() as u64),
        verdict::ROUGHNESS.check(roughness.map(|of| of.median_m), roughness.map_or(0, |of| of.cells)),
    ]
}

fn quality_checks(survey: &Survey) -> Vec<QualityCheck> {
    let sum =
        |of: fn(&StripFacts) -> u64| processed_facts(survey).map(|(_, _, facts)| of(facts)).sum::<u64>();
    vec![
        verdict::UNEXPLAINED_WAVEFORMS
            .share(sum(|facts| facts.unexplained_waveforms), sum(|facts| facts.waveforms)),
        verdict::WITHHELD.share(sum(|facts| facts.withheld), sum(|facts| facts.returns)),
        verdict::WITHOUT_RETURN
            .share(sum(|facts| facts.waveforms_without_return), sum(|facts| facts.waveforms)),
    ]
}

/// Checks the strip with the largest median uncertainty.
fn uncertainty_checks(survey: &Survey) -> Vec<QualityCheck> {
    let worst = |of: fn(&StripFacts) -> Option<f64>| {
        let known = processed_facts(survey).filter_map(|(_, _, facts)| Some((of(facts)?, facts.returns)));
        known.max_by(|a, b| a.0.total_cmp(&b.0))
    };
    let check = |rule: verdict::Rule, found: Option<(f64, u64)>| {
        rule.check(found.map(|(sd_m, _)| sd_m), found.map_or(0, |(_, returns)| returns))
    };
    vec![
        check(verdict::RANGE_SD, worst(|facts| facts.range_sd_m)),
        check(verdict::TOTAL_SD, worst(|facts| facts.total_sd_m)),
    ]
}

fn drift_of_sensor(survey: &Survey) -> Markup {
    let rows = survey.strips.iter().filter_map(|strip| serde_json::to_value(strip.sensor.as_ref()?).ok());
    drift::of_survey(&json!({"inputs": rows.collect::<Vec<_>>()}))
}

fn coordinates(survey: &Survey) -> String {
    let crs = survey.crs_wkt.as_deref().and_then(|wkt| wkt.split('"').nth(1));
    let cell = short(survey.cell_m);
    format!("coordinates: {}; cells of {cell} m", crs.unwrap_or("as in the inputs"))
}

fn processed(survey: &Survey) -> usize {
    survey.strips.iter().filter(|strip| strip.failure.is_none()).count()
}

/// Length in metres with millimetres.
fn metres(value: f64) -> String {
    label(value, 3)
}

fn percent(part: f64, of: f64) -> String {
    format!("{:.1}", 100.0 * part / of.max(f64::MIN_POSITIVE))
}

fn square_kilometres(area_m2: f64) -> String {
    short(1e-6 * area_m2)
}

fn key_figures(survey: &Survey) -> Markup {
    let differences = survey.differences.as_ref();
    let figures = [
        ("strips", Some(format!("{} of {}", processed(survey), survey.strips.len()))),
        ("km² covered", Some(square_kilometres(survey.area_m2))),
        ("% of it by several strips", Some(percent(survey.overlap_m2, survey.area_m2))),
        ("pulses per m², median", survey.pulses.as_ref().map(|density| short(density.median_per_m2))),
        ("points per m², median", survey.points.as_ref().map(|density| short(density.median_per_m2))),
        ("% below required density", survey.below_target_m2.map(|area| percent(area, survey.area_m2))),
        ("gaps", Some(survey.gaps.count.to_string())),
        ("m RMS between strips", differences.map(|of| metres(of.rms_m))),
        ("m within 95 %", differences.map(|of| metres(of.magnitude_95_m))),
        ("m roughness, median", survey.roughness.as_ref().map(|of| metres(of.median_m))),
    ];
    tiles(figures)
}

/// What needs attention, with numbers.
fn warnings(survey: &Survey) -> Markup {
    let mut items: Vec<(String, String)> = Vec::new();
    for strip in &survey.strips {
        if let Some(failure) = &strip.failure {
            items.push((strip.stem.clone(), failure.clone()));
        }
        items.extend(
            unusual(strip, survey.limits.max_difference_rms_m)
                .into_iter()
                .map(|words| (strip.stem.clone(), words)),
        );
    }
    let limit = metres(survey.limits.max_difference_rms_m);
    let exceeding = survey.pairs.iter().filter(|pair| pair.exceeds_limit).count();
    if exceeding > 0 {
        let of = survey.pairs.len();
        items.push((
            "height differences".to_owned(),
            format!("{exceeding} of {of} pairs of strips exceed the limit of {limit} m RMS; see the offsets of strips"),
        ));
    }
    if survey.gaps.count > 0 {
        let area = label(survey.gaps.area_m2, 0);
        items.push(("gaps".to_owned(), format!("{} gaps of {area} m² in all", survey.gaps.count)));
    }
    html! {
        section {
            h2 { "Warnings" }
            @if items.is_empty() { p { "None. The verdicts at the top also judge coverage and density." } }
            @else { ul.notes { @for (what, text) in &items { li { b { (what) } ": " (text) } } } }
        }
    }
}

/// Unusual offset and shares of a strip, as text.
fn unusual(strip: &SurveyStrip, limit_m: f64) -> Vec<String> {
    let Some(facts) = &strip.facts else { return Vec::new() };
    let share = |part: u64, of: u64| part as f64 / of.max(1) as f64;
    let mut found = Vec::new();
    if let Some(offset_m) = strip.offset_m.filter(|offset_m| offset_m.abs() > OFFSET * limit_m) {
        let side = if offset_m > 0.0 { "above" } else { "below" };
        found.push(format!(
            "lies {} m {side} the others; check its trajectory and boresight",
            metres(offset_m.abs())
        ));
    }
    let unexplained = share(facts.unexplained_waveforms, facts.waveforms);
    if unexplained > MANY {
        found.push(format!("the returns do not explain {:.1} % of the waveforms", 100.0 * unexplained));
    }
    let withheld = share(facts.withheld, facts.returns);
    if withheld > MANY {
        found.push(format!("{:.1} % of the points are withheld", 100.0 * withheld));
    }
    found
}

fn maps(survey: &Survey, pictures: Option<&Pictures>) -> Markup {
    let Some(pictures) = pictures else { return Markup::default() };
    let width = short(survey.limits.gap_width_m);
    let words = format!(
        "number of strips per cell; lines: middle of the strips, with their numbers; red: gaps of at least {} m², \
         which points surround or which are up to {width} m wide",
        label(survey.gaps.smallest_m2, 0)
    );
    let mut figures = vec![figure("Strips and gaps", figures::strips(survey, pictures), &words)];
    let mut words = "first returns of all strips, means of cells with points".to_owned();
    if let Some(target) = survey.limits.target_pulses_per_m2 {
        words += &format!("; red: below the required {} pulses per m²", short(target));
    }
    figures.push(figure("Pulse density", figures::pulses(pictures), &words));
    let limit_m = survey.limits.max_difference_rms_m;
    if let Some(svg) = figures::differences(pictures, limit_m) {
        let words = "later strip minus earlier one; of several pairs the largest difference";
        figures.push(figure("Height differences of strips", svg, words));
    }
    if let Some(svg) = figures::histogram(survey) {
        let words = format!("dashed: ±{} m, the limit of the RMS", short(limit_m));
        figures.push(figure("Histogram of height differences", svg, &words));
    }
    let rasters = match survey.rasters.is_empty() {
        true => String::new(),
        false => format!("The same as GeoTIFF in full resolution: {}", survey.rasters.join(", ")),
    };
    map_figures(&rasters, figures::frame(pictures).width(), &figures)
}

fn gaps(survey: &Survey) -> Markup {
    let row = |gap: &super::Gap| {
        let [east, north] = gap.centre.map(|coordinate| label(coordinate, 0));
        vec![east, north, label(gap.area_m2, 0)]
    };
    let rows = survey.gaps.largest.iter().map(row);
    html! { (table("Largest gaps", &["east of the centre", "north", "area, m²"], rows)) }
}

fn differences(survey: &Survey) -> Markup {
    let heads = ["pair", "cells", "median, m", "mean ± SD, m", "RMS, m", "RMS by noise, m", "95 %, m", ""];
    let mut pairs: Vec<_> = survey.pairs.iter().collect();
    pairs.sort_by(|a, b| b.differences.rms_m.total_cmp(&a.differences.rms_m));
    let row = |pair: &&super::StripPair| {
        let of = &pair.differences;
        vec![
            format!("{} − {}", pair.strips[1], pair.strips[0]),
            label(of.cells as f64, 0),
            metres(of.median_m),
            format!("{} ± {}", label(of.mean_m, 4), label(of.mean_sd_m, 4)),
            metres(of.rms_m),
            metres(of.noise_rms_m),
            metres(of.magnitude_95_m),
            if pair.exceeds_limit { "exceeds the limit".to_owned() } else { String::new() },
        ]
    };
    let left_out = pairs.len().saturating_sub(MOST_PAIRS);
    html! {
        (table("Height differences by pair", &heads, pairs.iter().take(MOST_PAIRS).map(row)))
        @if left_out > 0 { p.about { "The other " (left_out) " pairs, with smaller RMS, are in the JSON file." } }
        @if !pairs.is_empty() { (method(survey)) }
    }
}

/// How differences are computed, and their uncertainty.
fn method(survey: &Survey) -> Markup {
    let keys = &survey.limits;
    let cell = short(survey.cell_m);
    html! {
        p.about {
            "Method: in each cell of " (cell) " m, a plane is fitted to the single returns of each strip. A cell is smooth if it has "
            (keys.min_points) " of them or more, a slope up to " (short(keys.max_slope_deg)) "°, and a standard deviation from the plane up to "
            (short(keys.max_roughness_m)) " m. Where a cell is smooth in two strips, the heights of their planes are compared in the middle between "
            "the centroids of their points. RMS by noise: what the scatter of the points within cells causes by itself; the SD of the mean assumes that "
            "this scatter is independent between cells. Errors that all cells of a pair share, such as those of the trajectory, are the result, not part of this SD."
        }
    }
}

fn strips(survey: &Survey) -> Markup {
    let heads = [
        "strip",
        "km²",
        "pulses/m²",
        "points/m²",
        "% below target",
        "offset, m",
        "smooth cells",
        "roughness, m",
        "95 %, m",
        "range less slope, 95 %, m",
    ];
    let row = |(i, strip): (usize, &SurveyStrip)| {
        let text = |value: Option<String>| value.unwrap_or_else(|| "–".to_owned());
        let roughness = strip.roughness.as_ref();
        vec![
            format!("{}: {}", i + 1, strip.stem),
            square_kilometres(strip.area_m2),
            text(strip.pulses.as_ref().map(|of| short(of.median_per_m2))),
            text(strip.points.as_ref().map(|of| short(of.median_per_m2))),
            text(strip.below_target_m2.map(|area| percent(area, strip.area_m2))),
            text(strip.offset_m.map(metres)),
            text(roughness.map(|of| label(of.cells as f64, 0))),
            text(roughness.map(|of| metres(of.median_m))),
            text(roughness.map(|of| metres(of.high_m))),
            text(roughness.map(|of| metres(of.range_high_m))),
        ]
    };
    html! {
        (table("Strips", &heads, survey.strips.iter().enumerate().map(row)))
        p.about {
            "Densities are medians of the cells with points. Offset: height above the median strip that reproduces the median differences of all pairs best. "
            "Roughness: standard deviation of the single returns from the plane of a smooth cell. Range less slope: highest minus lowest of these points, "
            "less slope times diagonal of the cell."
        }
    }
}

fn processed_facts(survey: &Survey) -> impl Iterator<Item = (usize, &SurveyStrip, &StripFacts)> {
    survey.strips.iter().enumerate().filter_map(|(i, strip)| Some((i, strip, strip.facts.as_ref()?)))
}

fn quality(survey: &Survey) -> Markup {
    let mut heads: Vec<String> =
        ["strip", "waveforms", "without return, %", "unexplained, %", "withheld, %", "returns per pulse"]
            .map(str::to_owned)
            .to_vec();
    heads.extend(
        (1..=MOST_RETURNS).map(|n| if n == MOST_RETURNS { format!("{n}+, %") } else { format!("{n}, %") }),
    );
    let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
    let row = |(i, strip, facts): (usize, &SurveyStrip, &StripFacts)| {
        let with_returns: u64 = facts.shots_by_returns.iter().sum();
        let part = |n: u64, of: u64| percent(n as f64, of as f64);
        let mut row = vec![
            format!("{}: {}", i + 1, strip.stem),
            label(facts.waveforms as f64, 0),
            part(facts.waveforms_without_return, facts.waveforms),
            part(facts.unexplained_waveforms, facts.waveforms),
            part(facts.withheld, facts.returns),
            format!("{:.2}", facts.returns as f64 / with_returns.max(1) as f64),
        ];
        row.extend(facts.shots_by_returns.iter().map(|shots| part(*shots, with_returns)));
        row
    };
    html! {
        (table("Waveforms and returns", &heads, processed_facts(survey).map(row)))
        p.about {
            "Unexplained: deviation ratio above " (short(UNEXPLAINED)) ". Columns 1 to " (MOST_RETURNS)
            "+: share of the shots with returns that have this number of returns."
        }
    }
}

fn uncertainty(survey: &Survey) -> Markup {
    let heads = [
        "strip",
        "total SD, m",
        "95 %, m",
        "range SD, m",
        "position and attitude, m",
        "trajectory",
        "step, s",
        "gaps",
    ];
    let row = |(i, strip, facts): (usize, &SurveyStrip, &StripFacts)| {
        let length = |value: Option<f64>| value.map_or_else(|| "unknown".to_owned(), metres);
        let others = facts.total_sd_m.zip(facts.range_sd_m);
        let others = others.map(|(total, range)| (total * total - range * range).max(0.0).sqrt());
        let track = strip.trajectory.as_ref();
        vec![
            format!("{}: {}", i + 1, strip.stem),
            length(facts.total_sd_m),
            length(facts.total_sd_95_m),
            length(facts.range_sd_m),
            length(others),
            track.map_or_else(|| "none".to_owned(), |track| track.path.clone()),
            track.map_or_else(String::new, |track| short(track.median_step_s)),
            track.map_or_else(String::new, |track| track.gaps.to_string()),
        ]
    };
    html! {
        (table("Uncertainty and trajectories", &heads, processed_facts(survey).map(row)))
        p.about {
            "Total SD: median of the points, known with a trajectory accuracy. Position and attitude: the part of the total SD that is not of the range."
        }
    }
}

fn limits(survey: &Survey) -> Markup {
    let keys = serde_json::to_value(&survey.limits).unwrap_or_default();
    let rows = keys.as_object().into_iter().flatten().filter(|(_, value)| !value.is_null() && *value != "");
    let rows = rows.map(|(key, value)| {
        let (name, unit) = words::of_key(key);
        (
            name,
            format!("{} {unit}", value.as_f64().map_or_else(|| value.to_string(), short))
                .trim_end()
                .to_owned(),
        )
    });
    html! { div.sections { (section("Limits of the job", rows)) } }
}
