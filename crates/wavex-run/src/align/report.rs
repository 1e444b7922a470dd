//! The report of an alignment, `align.json`.

use serde_json::{Value, json};

use super::strips::SurveyStrips;
use super::{AlignRequest, TrajectoryModel};
use wavex_align::estimable::{FlightFacts, Treatment, Verdict, reasons};
use wavex_align::result::{Alignment, ParameterResult};
use wavex_engine::build;
use wavex_geodesy::trajectory::corrections::CorrectionKnot;

/// Everything that an alignment found.
pub(super) fn report(request: &AlignRequest<'_>, survey: &SurveyStrips, result: &Alignment) -> Value {
    let parameters = result.parameters.first().map_or(&[][..], |all| &all[..]);
    let name = |strip: u32| survey.strips.get(strip as usize).map_or("", |strip| &strip.name);
    let correlations = result.correlations.iter().map(|found| {
        json!({
            "parameters": [found.first.1.name(), found.second.1.name()],
            "correlation": found.correlation,
        })
    });
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
        survey.failures.iter().map(|failed| json!({ "name": failed.name, "problem": failed.problem }));
    json!({
        "version": 1,
        "wavex": build::VERSION,
        "commit": build::COMMIT,
        "job": request.job.name,
        "trajectory_model": model(request.trajectory),
        "verdict": verdict_word(result.verdict),
        "parameters": parameters.iter().map(|found| parameter(found, &result.facts)).collect::<Vec<_>>(),
        "correlations": correlations.collect::<Vec<_>>(),
        "strips": strips(survey, result),
        "failed_strips": failures.collect::<Vec<_>>(),
        "overlaps": overlaps.collect::<Vec<_>>(),
        "spread_before_m": result.spread_m[0],
        "spread_after_m": result.spread_m[1],
        "residual_scale": result.scale,
        "unknowns": result.n_unknowns,
        "pairs": result.n_pairs,
        "rejected_pairs": result.n_rejected,
        "flight": {
            "crossing_deg": result.facts.crossing_rad.to_degrees(),
            "turn_deg": result.facts.turn_rad.to_degrees(),
            "sloped_ratio": result.facts.sloped,
            "ranges_m": result.facts.ranges_m,
            "scan_angle_difference_deg": result.facts.angles_rad.to_degrees(),
            "receiver_pairs": result.facts.receiver_pairs,
        },
    })
}

fn model(model: TrajectoryModel) -> Value {
    match model {
        TrajectoryModel::None => "none".into(),
        TrajectoryModel::Constant => "constant".into(),
        TrajectoryModel::Linear => "linear".into(),
        TrajectoryModel::Spline(step_s) => step_s.into(),
    }
}

/// Word of a verdict.
pub(super) fn verdict_word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Good => "good",
        Verdict::Doubtful => "doubtful",
        Verdict::Bad => "bad",
    }
}

fn parameter(found: &ParameterResult, facts: &FlightFacts) -> Value {
    let treatment = match found.treatment {
        Treatment::Given => "given",
        Treatment::Estimated => "estimated",
        Treatment::NotEstimable => "not_estimable",
        Treatment::OnlyCombined => "only_combined",
    };
    let causes = match found.treatment {
        Treatment::Given | Treatment::Estimated => Vec::new(),
        Treatment::NotEstimable | Treatment::OnlyCombined => reasons(found.parameter, facts),
    };
    let causes = causes.into_iter().map(|(cause, remedy)| json!({ "cause": cause, "remedy": remedy }));
    json!({
        "name": found.parameter.name(),
        "start": found.start,
        "value": found.value,
        "sd": found.sd,
        "formal_sd": found.formal_sd,
        "jackknife_sd": found.jackknife_sd,
        "prior_sd": found.prior_sd,
        "treatment": treatment,
        "reasons": causes.collect::<Vec<_>>(),
    })
}

fn strips(survey: &SurveyStrips, result: &Alignment) -> Vec<Value> {
    let both = survey.strips.iter().zip(&result.strips);
    let strips = both.map(|(strip, found)| {
        let knot = |(knot, sds): (&CorrectionKnot, &[f64; 6])| {
            json!({
                "time_s": knot.time_s,
                "north_east_down_m": knot.offset.north_east_down_m,
                "roll_pitch_heading_rad": knot.offset.roll_pitch_heading_rad,
                "sds": sds,
            })
        };
        let knots = found.corrections.iter().flat_map(|corrections| corrections.knots());
        json!({
            "name": strip.name,
            "recording": strip.path.display().to_string(),
            "bytes": strip.path.metadata().map(|about| about.len()).unwrap_or_default(),
            "trajectory": survey.trajectory_files.get(strip.trajectory).map(|file| file.display().to_string()),
            "first_s": strip.span_s[0],
            "last_s": strip.span_s[1],
            "shots": strip.n_shots,
            "patches": strip.n_patches,
            "sparse_cells": strip.counts.sparse,
            "cells_of_several_returns": strip.counts.multiple,
            "rough_cells": strip.counts.rough,
            "thinned_patches": strip.counts.thinned,
            "pairs": found.n_pairs,
            "patches_without_pose": found.n_unlocated,
            "prior_sds": found.prior_sds,
            "knots": knots.zip(&found.knot_sds).map(knot).collect::<Vec<_>>(),
        })
    });
    strips.collect()
}
