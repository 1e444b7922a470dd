//! The report of an alignment, `align.json`.

use std::path::Path;

use super::control::Control;
use super::installations::installations;
use super::jobs::JobPlace;
use super::strips::SurveyStrips;
use super::{AlignRequest, TrajectoryModel, words};
use crate::archive::size_and_digest_of;
use wavex_align::estimable::{FlightFacts, Treatment, reasons};
use wavex_align::parameters::{GLOBALS, Global};
use wavex_align::result::{Alignment, OverlapResult, ParameterResult, StripResult};
use wavex_engine::build;
use wavex_geodesy::trajectory::corrections::CorrectionKnot;
use wavex_line::georef::keys::CalibrationKey;
use wavex_pages::report::align::{
    AlignReport, AlignedInstallation, AlignedParameter, AlignedStrip, Covariance, FailedStrip, FileDigest,
    Flight, Knot, NotDetermined, Overlap, ParameterCorrelation, ParameterTreatment, SdFactor, SharedErrors,
    TrajectoryForm, TrajectorySds, TrajectoryWord, VERSION,
};

/// Everything that an alignment found.
pub(super) fn report(
    request: &AlignRequest<'_>,
    places: &[JobPlace<'_>],
    survey: &SurveyStrips,
    result: &Alignment,
    warnings: &[String],
    control: Option<&Control>,
) -> AlignReport {
    let name = |(installation, parameter): (usize, Global)| {
        places.get(installation).map_or_else(String::new, |place| place.label(parameter.name()))
    };
    let correlations = result.correlations.iter().map(|found| ParameterCorrelation {
        parameters: [found.first, found.second].map(name),
        correlation: found.correlation,
    });
    let failures = survey.failures.iter();
    let failures =
        failures.map(|failed| FailedStrip { name: failed.name.clone(), problem: failed.problem.clone() });
    let calibration = |place: &JobPlace<'_>| match &place.job.settings.geometry.calibration {
        Some(CalibrationKey::File(file)) => Some(digested(&place.input_dir().join(file))),
        _ => None,
    };
    let of_installation = |place: &JobPlace<'_>| {
        Some(AlignedInstallation {
            name: place.name.clone()?,
            job: place.job.name.clone(),
            calibration: calibration(place),
        })
    };
    let parameters = installations(places, result).flat_map(|own| {
        let name = own.name.map(str::to_owned);
        own.parameters
            .iter()
            .map(move |found| AlignedParameter { installation: name.clone(), ..parameter(found, own.facts) })
    });
    AlignReport {
        version: VERSION,
        wavex: build::VERSION.to_owned(),
        commit: build::COMMIT.to_owned(),
        job: super::job_names(places),
        trajectory_model: model(request.trajectory),
        verdict: result.verdict.into(),
        problems: words::causes(places, survey, result),
        remedy: words::remedy(result.verdict).map(str::to_owned),
        warnings: warnings.to_vec(),
        parameters: parameters.collect(),
        installations: places.iter().filter_map(of_installation).collect(),
        covariance: covariance(result, name),
        correlations: correlations.collect(),
        strips: survey
            .strips
            .iter()
            .zip(&result.strips)
            .map(|(strip, found)| self::strip(places, survey, strip, found))
            .collect(),
        failed_strips: failures.collect(),
        overlaps: result.overlaps.iter().map(|found| overlap(survey, found)).collect(),
        spread_before_m: known(result.spread_m[0]),
        spread_after_m: known(result.spread_m[1]),
        residual_scale: result.scale,
        unknowns: result.n_unknowns,
        pairs: result.n_pairs,
        rejected_pairs: result.n_rejected,
        flight: flight(&result.facts),
        trajectories: survey.trajectory_files.iter().map(|file| digested(file)).collect(),
        calibration: match places {
            [only] => calibration(only),
            _ => None,
        },
        control: control.map(|control| {
            control.report(result, |strip| {
                survey.strips.get(strip as usize).map_or_else(String::new, |strip| strip.name.clone())
            })
        }),
        reference_strips: request.constraints.references.clone(),
        trajectory_sds: result.trajectory_sds.map(|components| {
            let [position, attitude] = components.map(|own| SdFactor {
                factor: own.factor,
                offsets: own.shown,
                is_used: own.is_used,
            });
            TrajectorySds { position, attitude }
        }),
        shared_errors: result.time_errors.filter(|own| own.factor > 1.0).map(|own| SharedErrors {
            sd_factor: own.factor.sqrt(),
            interval_s: own.interval_s,
            variance_ratios: own.ratios,
        }),
    }
}

/// A number; `None` if it is unknown.
fn known(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn model(model: TrajectoryModel) -> TrajectoryForm {
    match model {
        TrajectoryModel::None => TrajectoryForm::Word(TrajectoryWord::None),
        TrajectoryModel::Constant => TrajectoryForm::Word(TrajectoryWord::Constant),
        TrajectoryModel::Linear => TrajectoryForm::Word(TrajectoryWord::Linear),
        TrajectoryModel::Spline(step_s) => TrajectoryForm::KnotsEvery(step_s),
    }
}

fn flight(facts: &FlightFacts) -> Flight {
    Flight {
        crossing_deg: facts.crossing_rad.to_degrees(),
        turn_deg: facts.turn_rad.to_degrees(),
        sloped_ratio: facts.sloped,
        ranges_m: Some(facts.ranges_m).filter(|[least_m, most_m]| least_m <= most_m),
        scan_angle_difference_deg: facts.angles_rad.to_degrees(),
        receiver_pairs: facts.receiver_pairs,
    }
}

/// Rows and columns of the parameters that are not given.
fn covariance(result: &Alignment, name: impl Fn((usize, Global)) -> String) -> Covariance {
    let all = &result.covariance;
    let of_installation = |(installation, own): (usize, &[ParameterResult; GLOBALS])| {
        own.each_ref().map(|found| (installation, found.parameter, found.treatment))
    };
    let parameters: Vec<_> = result.parameters.iter().enumerate().flat_map(of_installation).collect();
    let open: Vec<usize> = (0..parameters.len()).filter(|k| parameters[*k].2 != Treatment::Given).collect();
    let row = |i: &usize| open.iter().map(|j| all[*i][*j]).collect();
    Covariance {
        parameters: open.iter().map(|k| name((parameters[*k].0, parameters[*k].1))).collect(),
        matrix: open.iter().map(row).collect(),
    }
}

fn parameter(found: &ParameterResult, facts: &FlightFacts) -> AlignedParameter {
    let causes = match found.treatment {
        Treatment::Given | Treatment::Estimated => Vec::new(),
        Treatment::NotEstimable | Treatment::OnlyCombined => reasons(found.parameter, facts),
    };
    let reasons = causes
        .into_iter()
        .map(|(cause, remedy)| NotDetermined { cause: cause.to_owned(), remedy: remedy.to_owned() });
    AlignedParameter {
        name: found.parameter.name().to_owned(),
        installation: None,
        start: found.start,
        value: found.value,
        sd: found.sd,
        formal_sd: found.formal_sd,
        jackknife_sd: found.jackknife_sd,
        prior_sd: found.prior_sd,
        treatment: match found.treatment {
            Treatment::Given => ParameterTreatment::Given,
            Treatment::Estimated => ParameterTreatment::Estimated,
            Treatment::NotEstimable => ParameterTreatment::NotEstimable,
            Treatment::OnlyCombined => ParameterTreatment::OnlyCombined,
        },
        reasons: reasons.collect(),
    }
}

fn overlap(survey: &SurveyStrips, found: &OverlapResult) -> Overlap {
    let name =
        |strip: u32| survey.strips.get(strip as usize).map_or_else(String::new, |strip| strip.name.clone());
    Overlap {
        strips: found.strips.map(name),
        pairs: found.n_pairs,
        rejected_pairs: found.n_rejected,
        median_before_m: known(found.median_m[0]),
        median_after_m: known(found.median_m[1]),
        spread_before_m: known(found.spread_m[0]),
        spread_after_m: known(found.spread_m[1]),
    }
}

fn strip(
    places: &[JobPlace<'_>],
    survey: &SurveyStrips,
    strip: &super::strips::SurveyStrip,
    found: &StripResult,
) -> AlignedStrip {
    let knot = |(knot, sds): (&CorrectionKnot, &[f64; 6])| Knot {
        time_s: knot.time_s,
        north_east_down_m: knot.offset.north_east_down_m,
        roll_pitch_heading_rad: knot.offset.roll_pitch_heading_rad,
        sds: *sds,
    };
    let knots = found.corrections.iter().flat_map(|corrections| corrections.knots());
    let file = digested(&strip.path);
    AlignedStrip {
        name: strip.name.clone(),
        installation: places.get(strip.installation).and_then(|place| place.name.clone()),
        recording: file.path,
        bytes: file.bytes,
        blake3: file.blake3,
        trajectory: survey.trajectory_files.get(strip.trajectory).map(|file| file.display().to_string()),
        first_s: strip.span_s[0],
        last_s: strip.span_s[1],
        shots: strip.n_shots,
        patches: strip.n_patches,
        sparse_cells: strip.counts.sparse,
        cells_of_several_returns: strip.counts.multiple,
        rough_cells: strip.counts.rough,
        thinned_patches: strip.counts.thinned,
        pairs: found.n_pairs,
        patches_without_pose: found.n_unlocated,
        prior_sds: found.prior_sds,
        knots: knots.zip(&found.knot_sds).map(knot).collect(),
    }
}

/// State of a file that was read.
fn digested(path: &Path) -> FileDigest {
    let known = size_and_digest_of(path).ok();
    let (bytes, blake3) = known.unzip();
    FileDigest { path: path.display().to_string(), bytes, blake3 }
}
