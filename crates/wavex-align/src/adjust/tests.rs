//! Simulated flights, and derivatives against differences.

use super::*;
use crate::estimable::{Verdict, reasons};
use crate::parameters::GlobalPriors;
use crate::result::ParameterResult;
use crate::simulated::{Flight, PLACE, Plan, flat, hills, parallel};
use crate::vector::length;
use wavex_geodesy::ellipsoid::WGS84;
use wavex_geodesy::frames::LocalFrame;

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
    let weighting = Weighting {
        scale: 1.0,
        huber: f64::INFINITY,
        reject: f64::INFINITY,
        control_scale: 1.0,
        shared: 1.0,
    };
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
        // Errors that pairs of the same time share have a factor of their own.
        let without =
            AlignSettings { trajectory_model: TrajectoryModel::None, fits_time_errors: false, ..settings() };
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

/// Observations, their covariance and the overlaps agree.
#[test]
fn observations_and_covariance_are_those_of_the_results() {
    let mut plan = Plan::cross();
    plan.truth.calibration.boresight_deg = [0.05, -0.03, 0.05];
    plan.bias_m = |x, y| if x.abs() < 30.0 && y.abs() < 30.0 { 0.3 } else { 0.0 };
    let flight = plan.fly();
    let result = aligned(&flight);
    assert_eq!(result.observations.len(), result.n_pairs);
    for overlap in &result.overlaps {
        let own: Vec<_> = result.observations.iter().filter(|one| one.strips == overlap.strips).collect();
        let used = || own.iter().filter(|one| one.is_used).map(|one| one.after_m);
        assert_eq!((own.len(), used().count()), (overlap.n_pairs, overlap.n_pairs - overlap.n_rejected));
        assert_eq!(median(used()), Some(overlap.median_m[1]));
    }
    let spread = |of: fn(&crate::observation::Observation) -> f64| {
        median(result.observations.iter().map(|one| of(one).abs())).unwrap()
    };
    let (before_m, after_m) = (spread(|one| one.before_m.unwrap()), spread(|one| one.after_m));
    assert!(before_m > 5.0 * after_m, "{before_m} {after_m}");
    for one in &result.observations {
        // Upwards: away from the centre of the earth, apart from the slope.
        assert!((length(one.normal_in_ecef) - 1.0).abs() < 1e-9);
        assert!(crate::vector::dot(one.normal_in_ecef, one.place_in_ecef_m) > 0.0);
    }
    for (i, parameter) in result.parameters[0].iter().enumerate() {
        let own = result.covariance[i][i];
        assert!((own - parameter.sd * parameter.sd).abs() <= 1e-12 * own, "{parameter:?} {own}");
        for j in 0..GLOBALS {
            assert_eq!(result.covariance[i][j], result.covariance[j][i]);
            assert!(result.covariance[i][j].abs() <= parameter.sd * result.parameters[0][j].sd);
        }
    }
}

/// Control points on the terrain, at most this far from the centre.
fn control(plan: &Plan, count: usize, sd_m: f64) -> Vec<ControlPoint> {
    let frame = LocalFrame::at(WGS84, PLACE);
    let of = |k: usize| {
        // Over all scan angles, within the strips.
        let (x, y) = (110.0 * (2.4 * k as f64).sin(), 110.0 * (1.7 * k as f64).cos());
        let place = frame.geodetic_of([x, y, (plan.terrain)(x, y)]);
        ControlPoint { position_in_ecef_m: WGS84.ecef_of(place), sd_m: [sd_m; 3], normal: None }
    };
    (0..count).map(of).collect()
}

/// Mean height of the patches above the terrain, m.
fn height_m(flight: &Flight, plan: &Plan, state: &State) -> f64 {
    let survey = flight.survey();
    let mut poses = survey.poses();
    let above = flight.patches.iter().filter_map(|patch| {
        let [x, y, z] = survey.locate(patch, state, &mut poses)?.centre_m();
        Some(z - (plan.terrain)(x, y))
    });
    let above: Vec<f64> = above.collect();
    above.iter().sum::<f64>() / above.len() as f64
}

/// Heights of all strips and the lever arm downwards, which no flight shows.
#[test]
fn control_points_determine_the_height() {
    let mut plan = Plan::cross();
    plan.heights_m = vec![0.03, -0.03, 0.02, -0.02];
    plan.truth.calibration.lever_arm_m = [0.0, 0.0, 0.06];
    let flight = plan.fly();
    let without = aligned(&flight);
    let down = of(&without, Global::LeverDown);
    assert!(height_m(&flight, &plan, &without.state).abs() > 0.02);
    assert!(!reasons(Global::LeverDown, &without.facts).is_empty());
    let points = control(&plan, 12, 0.005);
    let constraints = Constraints { control: &points, references: &[] };
    let with = align_with(&flight.survey(), &settings(), &constraints).unwrap();
    let height_m = height_m(&flight, &plan, &with.state);
    assert!(height_m.abs() < 0.006, "{height_m}");
    let found = of(&with, Global::LeverDown);
    assert_eq!(found.treatment, Treatment::Estimated);
    assert!(found.sd < 0.8 * down.sd && (found.value - 0.06).abs() < 3.0 * found.sd, "{found:?} {down:?}");
    assert!(with.control.scale < 1.01, "{}", with.control.scale);
    assert_eq!(with.facts.control_points, 12);
    for own in &with.control.differences {
        assert!(own.len() >= 2, "{own:?}");
        // The terrain is curved between the patches.
        assert!(own.iter().any(|one| one.is_used && one.after_m.abs() < 0.03), "{own:?}");
        assert!(own.iter().all(|one| one.sd_m > 0.005 && one.sd_m < 0.01), "{own:?}");
    }
}

/// Points that are 1 m off, or off the surface, are named and change nothing else.
#[test]
fn wrong_control_points_are_rejected() {
    let mut plan = Plan::cross();
    plan.heights_m = vec![0.06, 0.02, 0.05, 0.04];
    let flight = plan.fly();
    let good = control(&plan, 8, 0.005);
    let with = |points: &[ControlPoint]| {
        align_with(&flight.survey(), &settings(), &Constraints { control: points, references: &[] }).unwrap()
    };
    let right = with(&good);
    let mut points = good;
    let moved = |point: &ControlPoint, up_m: f64| {
        let geodetic = WGS84.geodetic_of(point.position_in_ecef_m);
        let place = wavex_geodesy::ellipsoid::Geodetic { height_m: geodetic.height_m + up_m, ..geodetic };
        ControlPoint { position_in_ecef_m: WGS84.ecef_of(place), ..*point }
    };
    points.push(moved(&control(&plan, 10, 0.005)[8], 1.0));
    let far = LocalFrame::at(WGS84, PLACE).geodetic_of([5000.0, 0.0, 0.0]);
    points.push(ControlPoint { position_in_ecef_m: WGS84.ecef_of(far), ..points[0] });
    let result = with(&points);
    let wrong = &result.control.differences[8];
    assert!(!wrong.is_empty() && wrong.iter().all(|one| !one.is_used && one.after_m < -0.8), "{wrong:?}");
    assert!(result.control.differences[9].is_empty());
    assert!(result.control.differences[..8].iter().flatten().all(|one| one.is_used));
    for (a, b) in result.parameters[0].iter().zip(&right.parameters[0]) {
        assert!((a.value - b.value).abs() <= 0.1 * b.sd + 1e-12, "{a:?} {b:?}");
    }
    // All points off alike: the trajectories win, and the contradiction is shown.
    let off: Vec<ControlPoint> = points[..8].iter().map(|point| moved(point, 40.0)).collect();
    let result = with(&off);
    assert!(result.control.contradicts() && result.verdict == Verdict::Doubtful, "{}", result.control.scale);
    assert!(height_m(&flight, &plan, &result.state).abs() < 0.2);
    let broken = ControlPoint { sd_m: [0.01, 0.0, 0.01], ..points[0] };
    let constraints = Constraints { control: &[broken], references: &[] };
    let error = align_with(&flight.survey(), &settings(), &constraints).unwrap_err();
    assert_eq!(error, AlignError::Control { index: 0 });
}

/// A given plane shows the horizontal position, too, and patches of other planes do not count.
#[test]
fn given_planes_select_patches() {
    let plan = Plan::cross();
    let flight = plan.fly();
    let mut point = control(&plan, 1, 0.005)[0];
    let result = |point: ControlPoint| {
        let constraints = Constraints { control: &[point], references: &[] };
        align_with(&flight.survey(), &settings(), &constraints).unwrap().control.differences[0].clone()
    };
    let (x, y) = (0.0, 110.0);
    let slope = |dx: f64, dy: f64| (hills(x + dx, y + dy) - hills(x - dx, y - dy)) / 0.02;
    let normal = [-slope(0.01, 0.0), -slope(0.0, 0.01), 1.0];
    point.normal = Some(normal.map(|part| part / length(normal)));
    let found = result(point);
    assert!(found.len() >= 3 && found.iter().all(|one| one.is_used && one.after_m.abs() < 0.1), "{found:?}");
    point.normal = Some([0.0, -0.8, 0.6]);
    assert!(result(point).is_empty());
}

#[test]
fn reference_strips_are_not_corrected() {
    let mut plan = Plan::cross();
    plan.heights_m = vec![0.05, -0.03, 0.0, 0.02];
    let flight = plan.fly();
    let constraints = Constraints { control: &[], references: &[2] };
    let result = align_with(&flight.survey(), &settings(), &constraints).unwrap();
    let knot = result.strips[2].corrections.as_ref().unwrap().knots()[0];
    assert!(knot.offset.is_zero());
    assert_eq!((result.strips[2].knot_sds[0], result.strips[2].prior_sds), ([0.0; 6], [0.0; 6]));
    for strip in [0, 1, 3] {
        let down_m =
            result.strips[strip].corrections.as_ref().unwrap().knots()[0].offset.north_east_down_m[2];
        assert!((down_m - plan.heights_m[strip]).abs() < 0.005, "{strip}: {down_m}");
    }
    let constraints = Constraints { control: &[], references: &[4] };
    let error = align_with(&flight.survey(), &settings(), &constraints).unwrap_err();
    assert_eq!(error.to_string(), "reference 0 refers to strip 4, but there are 4");
}

/// SDs of trajectories that are ten times too small are corrected; exact ones change nothing else.
#[test]
fn wrong_sds_of_trajectories_are_corrected() {
    let mut plan = Plan::cross();
    plan.heights_m = vec![0.15, -0.1, 0.05, -0.12];
    let mut settings = settings();
    settings.trajectory_priors.sd = [0.005, 0.005, 0.005, MILLIDEGREE, MILLIDEGREE, MILLIDEGREE];
    let result = align(&plan.fly().survey(), &settings).unwrap();
    let [position, _] = result.trajectory_sds.unwrap();
    assert!(position.is_used && position.factor > 3.0, "{position:?}");
    assert!(result.strips[0].prior_sds[2] > 0.015);
    settings.fits_trajectory_sds = false;
    let given = align(&plan.fly().survey(), &settings).unwrap();
    assert_eq!((given.trajectory_sds, given.strips[0].prior_sds[2]), (None, 0.005));
}

/// The scan angle scale is estimated if its start value has an SD.
#[test]
fn what_is_asked_is_estimated() {
    let mut plan = Plan::cross();
    plan.truth.calibration.e2 = 3e-4;
    let mut flight = plan.fly();
    assert_eq!(of(&aligned(&flight), Global::E2).treatment, Treatment::Given);
    flight.prior(Global::E2, 1e-3);
    let found = of(&aligned(&flight), Global::E2);
    assert_eq!(found.treatment, Treatment::Estimated);
    assert!((found.value - 3e-4).abs() < 4.0 * found.sd && found.sd < 2e-4, "{found:?}");
}

/// A flight of two installations with mounts of their own: strips 0 and 1, and strips 2 and 3.
fn two_installations() -> Plan {
    let mut plan = Plan::cross();
    plan.truth.calibration.boresight_deg = [0.05, -0.03, 0.06];
    plan.truth.calibration.lever_arm_m = [0.02, -0.01, 0.0];
    let half_turn = wavex_geodesy::frames::rotation_of_angles([0.0, 0.0, core::f64::consts::PI]);
    let start = crate::scanner::Scanner { body_from_mount: half_turn, ..plan.start };
    let mut truth = start;
    truth.calibration.boresight_deg = [-0.08, 0.04, 0.02];
    truth.calibration.e0 = 0.02;
    truth.calibration.time_offset_s = 0.001;
    plan.others = vec![(2, truth, start)];
    plan
}

/// Each installation gets its own calibration, and facts of its own pairs.
#[test]
fn installations_have_parameters_of_their_own() {
    let plan = two_installations();
    let flight = plan.fly();
    let result = aligned(&flight);
    assert_eq!((result.parameters.len(), result.verdict), (2, Verdict::Good));
    assert!(result.n_rejected * 100 < result.n_pairs, "{} {}", result.n_rejected, result.n_pairs);
    for (own, truth) in result.parameters.iter().zip([plan.truth, plan.others[0].1]) {
        for found in own.iter().filter(|found| found.treatment == Treatment::Estimated) {
            let error = found.value - found.parameter.of(&truth);
            assert!(error.abs() < 4.0 * found.sd, "{error} {found:?}");
        }
        for angle in [Global::Roll, Global::Pitch, Global::Yaw] {
            let found = own[angle as usize];
            assert!(found.treatment == Treatment::Estimated && found.sd < 10.0 * MILLIDEGREE, "{found:?}");
        }
    }
    let between = result.covariance[Global::Roll as usize][GLOBALS + Global::Roll as usize];
    assert!(between != 0.0, "installations that overlap have correlated errors");
    // Strips 0 and 1 alone are parallel, but each overlaps the cross strip of the other installation.
    assert!(result.installation_facts.iter().all(|facts| facts.crossing_rad > 1.5));
}

/// One calibration for two installations leaves differences, or corrections that no trajectory needs.
#[test]
fn one_calibration_does_not_fit_two_installations() {
    let mut plan = two_installations();
    let (_, truth, start) = &mut plan.others[0];
    (truth.body_from_mount, start.body_from_mount) = (plan.start.body_from_mount, plan.start.body_from_mount);
    let mut flight = plan.fly();
    for strip in &mut flight.strips {
        strip.installation = 0;
    }
    let result = aligned(&flight);
    assert_ne!(result.verdict, Verdict::Good, "{}", result.scale);
}

/// A strip of another installation gets corrections far beyond the SDs of its trajectory.
#[test]
fn a_strip_of_another_installation_stands_out() {
    let mut plan = two_installations();
    let mut turned = plan.start;
    turned.calibration.boresight_deg = [-0.3, 0.2, 0.1];
    plan.others = vec![(2, turned, plan.start)];
    let mut flight = plan.fly();
    assert!(aligned(&flight).misplaced_strips().is_empty());
    flight.strips[1].installation = 1;
    let found = aligned(&flight).misplaced_strips();
    assert!(found[0].strip == 1 && found.iter().all(|own| own.strip != 0), "{found:?}");
}

/// Errors of trajectories that change within the strip raise the SDs; corrections that follow them do not.
#[test]
fn errors_that_corrections_do_not_follow_raise_the_sds() {
    let mut plan = Plan { length_m: 800.0, ..Plan::cross() };
    plan.bump_m = 0.03;
    let flight = plan.fly();
    let with = |trajectory_model| {
        align(&flight.survey(), &AlignSettings { trajectory_model, fits_trajectory_sds: false, ..settings() })
            .unwrap()
    };
    let (stiff, free) = (with(TrajectoryModel::Constant), with(TrajectoryModel::Spline(1.0)));
    let factor = |result: &Alignment| result.time_errors.unwrap().factor;
    assert!(
        factor(&stiff) > 3.0 && factor(&free) < 0.5 * factor(&stiff),
        "{:?} {:?}",
        stiff.time_errors,
        free.time_errors
    );
    assert!(stiff.verdict >= Verdict::Doubtful);
    let settings = AlignSettings { fits_time_errors: false, fits_trajectory_sds: false, ..settings() };
    let without = align(&flight.survey(), &settings).unwrap();
    assert!(of(&stiff, Global::Roll).formal_sd > 1.5 * of(&without, Global::Roll).formal_sd);
}
