//! Simulated flights, and derivatives against differences.

use super::*;
use crate::estimable::{Verdict, reasons};
use crate::parameters::GlobalPriors;
use crate::result::ParameterResult;
use crate::simulated::{Flight, Plan, flat, hills, parallel};
use crate::vector::length;

fn settings() -> AlignSettings {
    AlignSettings { cell_m: 5.0, most_pairs: 600, ..AlignSettings::default() }
}

fn aligned(flight: &Flight) -> Alignment {
    align(&flight.survey(), &settings()).unwrap()
}

fn of(result: &Alignment, global: Global) -> ParameterResult {
    result.parameters[0][global as usize]
}

const MILLIDEGREE: f64 = core::f64::consts::PI / 180e3;

/// Every row of the normal equations is the derivative of its residual.
#[test]
fn rows_are_differences_of_residuals() {
    let mut flight = Plan { length_m: 200.0, ..Plan::cross() }.fly();
    flight.installations[0].priors = GlobalPriors([0.1; GLOBALS]);
    let survey = flight.survey();
    let model = TrajectoryModel::Spline(1.0);
    let problem = problem(&survey, &AlignSettings { trajectory_model: model, ..settings() });
    let settings = MatchSettings { search_m: 5.0, gate_m: 1.0, turn_rad: 0.3, most_pairs: 1, tile_m: 200.0 };
    let mut state = problem.start.clone();
    let away = DVector::from_fn(problem.layout.len(), |k, _| 1e-4 * (k as f64).sin());
    apply(&problem, &mut state, &away).unwrap();
    let mut pair = match_patches(&survey, &state, &settings)[0];
    // The derivatives are exact for the normal with its noise.
    let mut poses = survey.poses();
    let normals = pair
        .patches
        .map(|patch| survey.locate(&survey.patches[patch as usize], &state, &mut poses).unwrap().normal());
    let mean: [f64; 3] = core::array::from_fn(|axis| normals[0][axis] + normals[1][axis]);
    pair.direction = mean.map(|part| (part / length(mean)) as f32);
    let weighting = Weighting { scale: 1.0, huber: f64::INFINITY, reject: f64::INFINITY };
    let weight = weighting.weight(&pair, 0.0);
    let normal = problem.normal(&state, &[pair], &weighting, true);
    let residual = problem.residuals(&state, &[pair])[0].unwrap();
    let group = normal.groups.iter().find(|group| group.amax() > 0.0).unwrap();
    let mut n_checked = 0;
    for unknown in 0..problem.layout.len() {
        let at = |step: f64| {
            let mut moved = state.clone();
            let mut change = DVector::zeros(problem.layout.len());
            change[unknown] = step;
            apply(&problem, &mut moved, &change).unwrap();
            problem.residuals(&moved, &[pair])[0].unwrap()
        };
        let numeric = (at(1e-5) - at(-1e-5)) / 2e-5;
        let found = -group[unknown] / (weight * residual);
        assert!((numeric - found).abs() < 1e-3 * (1.0 + numeric.abs()), "{unknown}: {numeric} {found}");
        n_checked += usize::from(numeric.abs() > 1e-6);
    }
    assert!(n_checked >= 20, "{n_checked}");
}

/// Far from the truth: half a degree of roll and pitch, two of heading, and a lever arm off by 3 m.
#[test]
fn large_misalignment_is_found() {
    let mut plan = Plan::cross();
    plan.truth.calibration.boresight_deg = [0.5, -0.5, 2.0];
    plan.truth.calibration.lever_arm_m = [2.0, -1.5, 1.5];
    plan.truth.calibration.time_offset_s = 0.001;
    let mut flight = plan.fly();
    for lever in [Global::LeverForward, Global::LeverRight, Global::LeverDown] {
        flight.prior(lever, 2.0);
    }
    let result = aligned(&flight);
    for (global, bound) in [(Global::Roll, 1.0), (Global::Pitch, 6.0), (Global::Yaw, 4.0)] {
        let found = of(&result, global);
        let error = (found.value - global.of(&plan.truth)) / MILLIDEGREE;
        assert!(
            error.abs() < bound && error.abs() * MILLIDEGREE < 4.0 * found.sd,
            "{global:?} {error} {found:?}"
        );
    }
    let time = of(&result, Global::Time);
    assert!((time.value - 0.001).abs() < 4.0 * time.sd && time.sd < 2e-4, "{time:?}");
    assert!(result.spread_m[1] < 0.006 && result.spread_m[0] > 0.1, "{:?}", result.spread_m);
    assert_eq!(result.verdict, Verdict::Good);
}

#[test]
fn results_do_not_depend_on_threads() {
    let mut plan = Plan::cross();
    plan.truth.calibration.boresight_deg = [0.02, -0.03, 0.05];
    let flight = plan.fly();
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| aligned(&flight))
    };
    assert_eq!(with(1), with(3));
}

/// Parallel strips over a plain determine the roll only; the rest keeps its start values.
#[test]
fn what_a_flat_flight_does_not_show_is_left_alone() {
    const KEPT: [Global; 4] = [Global::Yaw, Global::LeverForward, Global::LeverRight, Global::LeverDown];
    let mut plan = Plan::new(parallel(), flat);
    plan.truth.calibration.boresight_deg = [0.02, 0.004, 0.002];
    let mut flight = plan.fly();
    KEPT[1..].iter().for_each(|lever| flight.prior(*lever, 0.004));
    flight.prior(Global::Yaw, 2.0 * MILLIDEGREE);
    flight.prior(Global::Pitch, 5.0 * MILLIDEGREE);
    let result = aligned(&flight);
    let roll = of(&result, Global::Roll);
    assert_eq!(roll.treatment, Treatment::Estimated);
    assert!(
        (roll.value - 0.02f64.to_radians()).abs() < 4.0 * roll.sd && roll.sd < 2.0 * MILLIDEGREE,
        "{roll:?}"
    );
    for global in KEPT {
        let kept = of(&result, global);
        assert_eq!((kept.treatment, kept.value), (Treatment::NotEstimable, kept.start), "{kept:?}");
        assert!(kept.sd >= 0.999 * kept.prior_sd && !reasons(global, &result.facts).is_empty());
    }
}

/// Errors of recorded heights become corrections; their SDs hold.
#[test]
fn strips_are_moved_to_each_other() {
    let mut plan = Plan::cross();
    plan.heights_m = vec![0.05, -0.03, 0.0, 0.02];
    let result = aligned(&plan.fly());
    let down = |strip: usize| {
        let corrections = result.strips[strip].corrections.as_ref().unwrap();
        corrections.knots()[0].offset.north_east_down_m[2]
    };
    for strip in 0..3 {
        let truth_m = plan.heights_m[strip] - plan.heights_m[3];
        assert!((down(strip) - down(3) - truth_m).abs() < 0.004, "{strip}: {}", down(strip) - down(3));
        assert!(result.strips[strip].knot_sds[0][2] < 0.04);
    }
}

/// Errors that the patches of a tile share are seen by the jackknife, not by the formal SDs.
#[test]
fn correlated_errors_raise_the_stated_sds() {
    // Third derivatives of the terrain are errors that tiles share, too.
    let gentle = |x: f64, y: f64| 20.0 * (x / 150.0).sin() + 15.0 * (y / 120.0).cos();
    let ratio = |bias_m: fn(f64, f64) -> f64| {
        let flight = Plan { bias_m, terrain: gentle, length_m: 800.0, ..Plan::cross() }.fly();
        let without = AlignSettings { trajectory_model: TrajectoryModel::None, ..settings() };
        let roll = of(&align(&flight.survey(), &without).unwrap(), Global::Roll);
        assert_eq!(roll.sd, roll.formal_sd.max(roll.jackknife_sd));
        roll.jackknife_sd / roll.formal_sd
    };
    let independent = ratio(flat);
    let shared = ratio(|x, _| 0.01 * (x / 130.0).sin());
    assert!(shared > 1.5 * independent.max(0.7), "{shared} {independent}");
}

/// Patches without a pose are counted, and the others aligned.
#[test]
fn patches_of_another_day_are_counted() {
    let mut flight = Plan::cross().fly();
    for patch in flight.patches.iter_mut().filter(|patch| patch.strip == 2) {
        patch.beams.iter_mut().for_each(|beam| beam.time_s += 86_400.0);
    }
    let own = flight.patches.iter().filter(|patch| patch.strip == 2).count();
    let result = aligned(&flight);
    assert_eq!((result.strips[2].n_unlocated, result.strips[2].n_pairs), (own, 0));
    assert!(result.strips[1].n_unlocated == 0 && result.strips[1].n_pairs > 500);
}

#[test]
fn unusable_surveys_are_refused() {
    let flight = Plan { length_m: 100.0, ..Plan::new(vec![(0.0, 0.0), (2000.0, 0.0)], hills) }.fly();
    let error = align(&flight.survey(), &settings()).unwrap_err();
    assert_eq!(error, AlignError::NoPairs { search_m: 15.0 });
    assert!(error.to_string().starts_with("no pairs of patches: the strips do not overlap"));
    let refused = |change: fn(&mut AlignSettings)| {
        let mut settings = settings();
        change(&mut settings);
        align(&flight.survey(), &settings).unwrap_err().to_string()
    };
    assert_eq!(refused(|s| s.cell_m = 0.0), "the cell size is 0: give a number above 0");
    assert_eq!(
        refused(|s| s.trajectory_model = TrajectoryModel::Spline(f64::NAN)),
        "the distance of knots is NaN: give a number above 0"
    );
    let mut lost = flight.survey();
    lost.trajectories = &flight.trajectories[..1];
    let error = align(&lost, &settings()).unwrap_err().to_string();
    assert_eq!(error, "strip 1 refers to trajectory 1, but there are 1");
}
