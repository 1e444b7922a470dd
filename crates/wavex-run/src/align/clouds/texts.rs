//! Texts of an alignment of clouds: summary, corrections, report.

use std::fmt::Write;

use serde_json::{Value, json};

use super::CloudsRequest;
use super::estimate::CloudAlignment;
use super::files::Clouds;
use crate::align::words::differences;
use wavex_align::estimable::{DOUBTFUL_REJECTED, DOUBTFUL_SCALE, Verdict};
use wavex_align::parameters::TrajectoryModel;
use wavex_align::result::Alignment;
use wavex_engine::build;
use wavex_geodesy::trajectory::corrections::CorrectionKnot;
use wavex_pages::report::align::AlignVerdict;

/// Most strips that are listed.
const LISTED: usize = 24;

/// Knots of a strip with their SDs.
fn knots(found: &CloudAlignment, strip: usize) -> impl Iterator<Item = (&CorrectionKnot, [f64; 3])> {
    let corrections = found.result.strips[strip].corrections.iter();
    corrections.flat_map(|corrections| corrections.knots()).zip(found.sds_m[strip].iter().copied())
}

/// North, east, down as x, y, z.
fn x_y_z([north, east, down]: [f64; 3]) -> [f64; 3] {
    // Without the sign of a zero.
    [east, north, 0.0 - down]
}

/// Corrections of each strip, differences of the strips, verdict.
pub(super) fn summary(clouds: &Clouds, found: &CloudAlignment) -> String {
    let mut text = String::new();
    let result = &found.result;
    // Writing to a text cannot fail.
    let _ = writeln!(
        text,
        "{:<24} {:>16} {:>22} {:>22} {:>22}",
        "correction, mm", "time, s", "x (SD)", "y (SD)", "z (SD)"
    );
    let aligned: Vec<usize> =
        (0..clouds.strips.len()).filter(|strip| result.strips[*strip].n_pairs > 0).collect();
    for &strip in aligned.iter().take(LISTED) {
        let all: Vec<_> = knots(found, strip).collect();
        let ends = all.iter().take(1).chain(all.iter().skip(1).last());
        for (knot, sds_m) in ends {
            let name = &clouds.strips[strip].name;
            let _ = write!(text, "{name:<24} {:>16.3}", knot.time_s);
            let values = x_y_z(knot.offset.north_east_down_m).into_iter().zip(in_map_order(*sds_m));
            for ((value, sd), is_held) in values.zip(in_map_order(found.held[strip])) {
                let shown = match is_held {
                    true => "not estimable".to_owned(),
                    false => format!("{:.1} ({:.1})", 1e3 * value, 1e3 * sd),
                };
                let _ = write!(text, " {shown:>22}");
            }
            text.push('\n');
        }
    }
    if let more @ 1.. = aligned.len().saturating_sub(LISTED) {
        let _ = writeln!(text, "and {more} more in {}", super::CLOUD_CORRECTIONS_FILE);
    }
    if found.held.iter().flatten().any(|held| *held) {
        text += "not estimable: the overlaps are flat or have slopes of one direction only; horizontal offsets need roofs or \
                 slopes of several aspects\n";
    }
    let names: Vec<&str> = clouds.strips.iter().map(|strip| strip.name.as_str()).collect();
    text += &differences(&names, result);
    let _ = writeln!(text, "verdict: {}", AlignVerdict::from(result.verdict).word());
    text
}

/// What belongs to north, east, down in the order x, y, z.
fn in_map_order<T>([north, east, down]: [T; 3]) -> [T; 3] {
    [east, north, down]
}

/// Strips that share no surface with others.
pub(super) fn unconnected(clouds: &Clouds, found: &CloudAlignment) -> Vec<String> {
    let pairs = clouds.strips.iter().zip(&found.result.strips);
    let alone = pairs.filter(|(_, result)| result.n_pairs == 0);
    alone
        .map(|(strip, _)| {
            format!(
                "{}: the strip shares no smooth surface with another one and is not aligned; check its coordinates and area, \
                 or leave it out",
                strip.name
            )
        })
        .collect()
}

/// Drifts between knots that the start values make implausible.
///
/// A tilt of a strip across its course is no drift, but two strips that drift alike can imitate it: their difference is small,
/// and their drifts are large.
pub(super) fn implausible_drifts(
    clouds: &Clouds,
    found: &CloudAlignment,
    (position_sd_m, correlation_s): (f64, f64),
) -> Vec<String> {
    let mut texts = Vec::new();
    for (index, strip) in clouds.strips.iter().enumerate() {
        let all: Vec<_> = knots(found, index).map(|(knot, _)| knot).collect();
        let drifts = all.array_windows().flat_map(|[before, after]| {
            let step_s = after.time_s - before.time_s;
            let sd_m = position_sd_m * (2.0 * (1.0 - (-step_s / correlation_s).exp())).sqrt();
            let [from_m, to_m] = [before, after].map(|knot| x_y_z(knot.offset.north_east_down_m));
            [0, 1, 2].map(|axis| (axis, to_m[axis] - from_m[axis], step_s, sd_m))
        });
        let worst = drifts.max_by(|a, b| (a.1.abs() / a.3).total_cmp(&(b.1.abs() / b.3)));
        let Some((axis, drift_m, step_s, sd_m)) =
            worst.filter(|(_, drift_m, _, sd_m)| drift_m.abs() > DRIFT_SDS * sd_m)
        else {
            continue;
        };
        texts.push(format!(
            "{}: its {} drifts by {:.0} mm in {step_s:.1} s, where {:.0} mm are expected: the strips are rather tilted than \
             drifting; use `--trajectory constant`",
            strip.name,
            ["x", "y", "z"][axis],
            1e3 * drift_m,
            1e3 * sd_m
        ));
    }
    texts
}

/// Drifts above this many SDs are implausible.
const DRIFT_SDS: f64 = 4.0;

/// What is wrong with an alignment that is not good, and what to do.
pub(super) fn problem(result: &Alignment) -> Option<String> {
    let remedy = match result.verdict {
        Verdict::Good => return None,
        Verdict::Doubtful => {
            "see the strips with the largest differences: strips may be tilted against each other, or drift"
        }
        Verdict::Bad => "check coordinates and times of the clouds; no corrections are written",
    };
    let mut causes = Vec::new();
    let rejected = result.n_rejected as f64 / result.n_pairs.max(1) as f64;
    if rejected > DOUBTFUL_REJECTED {
        causes.push(format!("{:.0} % of the pairs are rejected", 100.0 * rejected));
    }
    if result.scale > DOUBTFUL_SCALE {
        causes.push(format!("the remaining differences are {:.1} times their SDs", result.scale));
    }
    if result.spread_m[1] > result.spread_m[0] {
        causes.push("strips differ more than before".to_owned());
    }
    Some(format!(
        "the alignment is {}: {}; {remedy}",
        AlignVerdict::from(result.verdict).word(),
        causes.join("; ")
    ))
}

/// Table of the corrections: the same bytes for the same values.
pub(super) fn corrections(clouds: &Clouds, found: &CloudAlignment) -> String {
    let mut text = "strip,time_s,x_m,y_m,z_m,x_sd_m,y_sd_m,z_sd_m\n".to_owned();
    for (index, strip) in clouds.strips.iter().enumerate() {
        if found.result.strips[index].n_pairs == 0 {
            continue;
        }
        let name = match strip.name.contains([',', '"']) {
            true => format!("\"{}\"", strip.name.replace('"', "\"\"")),
            false => strip.name.clone(),
        };
        for (knot, sds_m) in knots(found, index) {
            let [x, y, z] = x_y_z(knot.offset.north_east_down_m);
            let held = found.held[index];
            let sd = |component: usize| match held[component] {
                true => String::new(),
                false => sds_m[component].to_string(),
            };
            let _ = writeln!(text, "{name},{},{x},{y},{z},{},{},{}", knot.time_s, sd(1), sd(0), sd(2));
        }
    }
    text
}

/// Everything that an alignment found.
pub(super) fn report(request: &CloudsRequest<'_>, clouds: &Clouds, found: &CloudAlignment) -> Value {
    let result = &found.result;
    let name = |strip: u32| clouds.strips.get(strip as usize).map_or("", |strip| &strip.name);
    let overlaps = result.overlaps.iter().map(|overlap| {
        json!({
            "strips": overlap.strips.map(name),
            "pairs": overlap.n_pairs,
            "rejected_pairs": overlap.n_rejected,
            "median_before_m": overlap.median_m[0],
            "median_after_m": overlap.median_m[1],
            "spread_before_m": overlap.spread_m[0],
            "spread_after_m": overlap.spread_m[1],
        })
    });
    let failures =
        clouds.failures.iter().map(|failed| json!({ "name": failed.name, "problem": failed.problem }));
    let strips = clouds.strips.iter().enumerate().map(|(index, strip)| {
        let of_knot = |(knot, sds_m): (&CorrectionKnot, [f64; 3])| {
            json!({
                "time_s": knot.time_s,
                "x_y_z_m": x_y_z(knot.offset.north_east_down_m),
                "x_y_z_sd_m": in_map_order(sds_m),
            })
        };
        let of_axis = |component: usize| match found.held[index][component] {
            true => "not_estimable",
            false => "estimated",
        };
        let aligned = found.result.strips[index].n_pairs > 0;
        json!({
            "name": strip.name,
            "file": clouds.files.get(strip.file).map(|file| file.display().to_string()),
            "point_source_id": strip.source_id,
            "first_s": strip.span_s.map(|span_s| span_s[0]),
            "last_s": strip.span_s.map(|span_s| span_s[1]),
            "points": strip.n_points,
            "noise_m": strip.noise_m,
            "patches": strip.n_patches,
            "sparse_cells": strip.counts.sparse,
            "cells_of_several_returns": strip.counts.multiple,
            "rough_cells": strip.counts.rough,
            "thinned_patches": strip.counts.thinned,
            "pairs": found.result.strips[index].n_pairs,
            "x": of_axis(1),
            "y": of_axis(0),
            "z": of_axis(2),
            "knots": knots(found, index).filter(|_| aligned).map(of_knot).collect::<Vec<_>>(),
        })
    });
    json!({
        "version": 1,
        "wavex": build::VERSION,
        "commit": build::COMMIT,
        "clouds": clouds.files.iter().map(|file| file.display().to_string()).collect::<Vec<_>>(),
        "position_sd_m": request.position_sd_m,
        "corrections_model": match request.corrections {
            TrajectoryModel::None => "none".into(),
            TrajectoryModel::Constant => "constant".into(),
            TrajectoryModel::Linear => "linear".into(),
            TrajectoryModel::Spline(step_s) => Value::from(step_s),
        },
        "verdict": AlignVerdict::from(result.verdict).word(),
        "strips": strips.collect::<Vec<_>>(),
        "failed_strips": failures.collect::<Vec<_>>(),
        "overlaps": overlaps.collect::<Vec<_>>(),
        "spread_before_m": result.spread_m[0],
        "spread_after_m": result.spread_m[1],
        "residual_scale": result.scale,
        "pairs": result.n_pairs,
        "rejected_pairs": result.n_rejected,
        "sloped_ratio": result.facts.sloped,
    })
}
