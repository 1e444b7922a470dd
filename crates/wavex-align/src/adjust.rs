//! Estimation of all parameters from the pairs of patches.

use nalgebra::DVector;
use wavex_geodesy::trajectory::corrections::TrajectoryCorrections;
use wavex_simd::statistics::median;

use crate::control::{ControlPoint, match_control, scale as control_scale};
use crate::estimable::{DOUBTFUL_SHARED, EVIDENCE, FlightFacts, Treatment, Verdict};
use crate::matching::{MatchSettings, Pair, TILE_M, match_patches};
use crate::normal::{Priors, Problem, Weighting};
use crate::parameters::{
    GLOBALS, Global, Layout, OFFSETS, TrajectoryModel, TrajectoryPriors, knot_times, no_corrections,
};
use crate::result::{Alignment, pairs_with_residuals, report};
use crate::solution::Solution;
use crate::survey::{State, Survey};

/// Settings of an alignment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AlignSettings {
    /// Form of the corrections of trajectories.
    pub trajectory_model: TrajectoryModel,
    /// SDs of the trajectories.
    pub trajectory_priors: TrajectoryPriors,
    /// Cell size of the patches, m; above 0.
    pub cell_m: f64,
    /// Most pairs of two strips.
    pub most_pairs: usize,
    /// Whether the SDs of trajectories are corrected by what the strips show of them.
    pub fits_trajectory_sds: bool,
    /// Whether SDs are raised for errors that pairs of the same time share.
    pub fits_time_errors: bool,
    /// Edge of the tiles of the jackknife, m; above 0.
    pub tile_m: f64,
}

impl Default for AlignSettings {
    fn default() -> AlignSettings {
        AlignSettings {
            trajectory_model: TrajectoryModel::Constant,
            trajectory_priors: TrajectoryPriors::default(),
            cell_m: 3.0,
            most_pairs: 3000,
            fits_trajectory_sds: true,
            fits_time_errors: true,
            tile_m: TILE_M,
        }
    }
}

/// What is known besides the priors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Constraints<'a> {
    /// Control points.
    pub control: &'a [ControlPoint],
    /// Indices of strips whose trajectories are not corrected.
    pub references: &'a [usize],
}

/// Reason why a survey is not aligned.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AlignError {
    /// An index is out of range.
    #[error("{what} {index} refers to {other} {wanted}, but there are {count}")]
    Index {
        /// Kind of the item.
        what: &'static str,
        /// Its index.
        index: usize,
        /// Kind of the item it refers to.
        other: &'static str,
        /// Index it refers to.
        wanted: usize,
        /// Number of these items.
        count: usize,
    },
    /// A setting is not a usable number.
    #[error("{name} is {value}: give a number above 0")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// No two strips have a smooth surface in common.
    #[error(
        "no pairs of patches: the strips do not overlap, share no smooth surface, or miss each other by more than \
         {search_m} m; check mount, trajectory and coordinate reference system of each strip"
    )]
    NoPairs {
        /// Largest distance that was searched, m.
        search_m: f64,
    },
    /// A control point is not a usable position with SDs.
    #[error("control point {index} has a coordinate that is not finite, or an SD that is not above 0")]
    Control {
        /// Its index.
        index: usize,
    },
    /// The normal equations have no solution.
    #[error("the normal equations cannot be solved: priors or patches hold extreme numbers")]
    NotSolvable,
}

/// A stage of the estimation, coarse to fine.
struct Level {
    /// In cells.
    search: f64,
    gate_m: f64,
    turn_deg: f64,
    /// Part of the most pairs.
    pairs: f64,
    reject: f64,
    iterations: usize,
    /// The level ends when a step is below this many SDs.
    step_sds: f64,
}

const LEVELS: [Level; 3] = [
    Level {
        search: 3.0,
        gate_m: 15.0,
        turn_deg: 25.0,
        pairs: 0.3,
        reject: 12.0,
        iterations: 20,
        step_sds: 3.0,
    },
    Level { search: 1.0, gate_m: 1.5, turn_deg: 12.0, pairs: 0.5, reject: 8.0, iterations: 8, step_sds: 1.0 },
    Level { search: 0.8, gate_m: 0.4, turn_deg: 8.0, pairs: 1.0, reject: 5.0, iterations: 8, step_sds: 0.1 },
];
/// Residuals beyond this many SDs count linearly: 99 % efficient for normal errors.
const HUBER: f64 = 2.0;
/// Smallest ratio of the residuals to the stated SDs.
const LEAST_SCALE: f64 = 0.3;
/// A parameter below the evidence is changed only if keeping it raises the cost by more than this: 3 SDs.
const CHANGE_NEEDED: f64 = 9.0;
/// Most iterations with control points before parameters are held.
const CONTROL_ITERATIONS: usize = 8;

/// Aligns a survey.
///
/// # Errors
/// Indices out of range, settings that are not above 0, no pairs, extreme numbers.
pub fn align(survey: &Survey<'_>, settings: &AlignSettings) -> Result<Alignment, AlignError> {
    align_with(survey, settings, &Constraints::default())
}

/// Aligns a survey with control points and reference strips.
///
/// # Errors
/// As [`align`]; positions, SDs or normals of control points that are not usable numbers.
pub fn align_with(
    survey: &Survey<'_>,
    settings: &AlignSettings,
    constraints: &Constraints<'_>,
) -> Result<Alignment, AlignError> {
    check(survey, settings)?;
    check_constraints(survey, constraints)?;
    let mut problem = problem(survey, settings);
    problem.points = constraints.control;
    for &strip in constraints.references {
        problem.priors.offsets[strip] = [0.0; OFFSETS];
    }
    let mut state = problem.start.clone();
    let matching = |level: &Level| MatchSettings {
        search_m: level.search * settings.cell_m,
        gate_m: level.gate_m,
        turn_rad: level.turn_deg.to_radians(),
        most_pairs: ((level.pairs * settings.most_pairs as f64) as usize).max(1),
        tile_m: settings.tile_m,
    };
    let before = pairs_with_residuals(&problem, &state, &matching(&LEVELS[1]));
    let [coarse, middle, fine] = &LEVELS;
    for level in [coarse, middle, fine] {
        for _ in 0..level.iterations {
            let pairs = match_patches(survey, &state, &matching(level));
            if pairs.is_empty() {
                return Err(AlignError::NoPairs { search_m: coarse.search * settings.cell_m });
            }
            let weighting = weighting(&problem, &state, &pairs, level.reject);
            let step_sds = step(&problem, &mut state, &pairs, &weighting, &[])?;
            if step_sds < level.step_sds {
                break;
            }
        }
    }
    // Control points are used once the strips meet: patches are then at their places.
    for _ in 0..if constraints.control.is_empty() { 0 } else { CONTROL_ITERATIONS } {
        problem.control = match_control(survey, constraints.control, &state, settings.cell_m);
        let pairs = match_patches(survey, &state, &matching(fine));
        let weighting = weighting(&problem, &state, &pairs, fine.reject);
        if step(&problem, &mut state, &pairs, &weighting, &[])? < fine.step_sds {
            break;
        }
    }
    let mut pairs = match_patches(survey, &state, &matching(fine));
    let find_time_errors = |problem: &mut Problem<'_>, state: &State, pairs: &[Pair]| {
        problem.shared = 1.0;
        let found = settings.fits_time_errors.then(|| {
            let weighting = weighting(problem, state, pairs, fine.reject);
            problem.time_errors(state, pairs, &weighting, settings.trajectory_model)
        });
        problem.shared = found.map_or(1.0, |found| found.factor);
        found
    };
    let trajectory_sds = match settings.fits_trajectory_sds {
        false => {
            find_time_errors(&mut problem, &state, &pairs);
            None
        }
        true => {
            let fit = |problem: &mut Problem<'_>, state: &mut State| -> Result<_, AlignError> {
                problem.fit_trajectory_sds(state, |problem, state| {
                    let weighting = weighting(problem, state, &pairs, fine.reject);
                    let normal = problem.normal(state, &pairs, &weighting, false);
                    let right = normal.right.clone();
                    let factor = normal.matrix.factor().ok_or(AlignError::NotSolvable)?;
                    apply(problem, state, &factor.solve(&right))?;
                    Ok(factor.selected_inverse())
                })
            };
            let (given, before) = (problem.priors.offsets.clone(), state.clone());
            let mut found = fit(&mut problem, &mut state)?;
            // What corrections follow with larger SDs is not an error that they leave.
            find_time_errors(&mut problem, &state, &pairs);
            if problem.shared > 1.0 {
                (problem.priors.offsets, state) = (given, before);
                found = fit(&mut problem, &mut state)?;
            }
            pairs = match_patches(survey, &state, &matching(fine));
            problem.control = match_control(survey, constraints.control, &state, settings.cell_m);
            Some(found)
        }
    };
    let time_errors = find_time_errors(&mut problem, &state, &pairs);
    let mut treatments = vec![[Treatment::Estimated; GLOBALS]; survey.installations.len()];
    let mut held: Vec<usize> = Vec::new();
    let (solution, weighting) = loop {
        let mut weighting = weighting(&problem, &state, &pairs, fine.reject);
        for _ in 0..4 {
            if step(&problem, &mut state, &pairs, &weighting, &held)? < fine.step_sds {
                break;
            }
            weighting = self::weighting(&problem, &state, &pairs, fine.reject);
        }
        let solution =
            Solution::new(&problem, &state, &pairs, &weighting, &held).ok_or(AlignError::NotSolvable)?;
        let Some((installation, global)) = least_evident(&problem, &solution, &treatments) else {
            break (solution, weighting);
        };
        let start = Global::ALL[global].of(&problem.start.scanners[installation]);
        let change = Global::ALL[global].of(&state.scanners[installation]) - start;
        let unknown = problem.layout.global(installation, global);
        if change * change < CHANGE_NEEDED * solution.formal[unknown].powi(2) {
            treatments[installation][global] = Treatment::NotEstimable;
            Global::ALL[global].add_to(&mut state.scanners[installation], -change);
            held.push(unknown);
            step(&problem, &mut state, &pairs, &weighting, &held)?;
            pairs = match_patches(survey, &state, &matching(fine));
            problem.control = match_control(survey, constraints.control, &state, settings.cell_m);
        } else {
            treatments[installation][global] = Treatment::OnlyCombined;
        }
    };
    let control = problem.control_result(&state, &weighting, settings.cell_m);
    let result = report(&problem, state, &pairs, &solution, &weighting, &treatments, &before);
    let is_shared = time_errors.is_some_and(|own| own.factor > DOUBTFUL_SHARED);
    let verdict = if control.contradicts() || is_shared {
        result.verdict.max(Verdict::Doubtful)
    } else {
        result.verdict
    };
    let control_points = control.differences.iter().filter(|own| own.iter().any(|one| one.is_used)).count();
    let with_control = |facts: FlightFacts| FlightFacts { control_points, ..facts };
    let facts = with_control(result.facts);
    let installation_facts = result.installation_facts.iter().copied().map(with_control).collect();
    Ok(Alignment { control, verdict, trajectory_sds, facts, installation_facts, time_errors, ..result })
}

fn check(survey: &Survey<'_>, settings: &AlignSettings) -> Result<(), AlignError> {
    let index = |what, index, other, wanted: usize, count: usize| {
        let error = AlignError::Index { what, index, other, wanted, count };
        if wanted < count { Ok(()) } else { Err(error) }
    };
    for (k, strip) in survey.strips.iter().enumerate() {
        index("strip", k, "trajectory", strip.trajectory, survey.trajectories.len())?;
        index("strip", k, "installation", strip.installation, survey.installations.len())?;
    }
    for (k, patch) in survey.patches.iter().enumerate() {
        index("patch", k, "strip", patch.strip as usize, survey.strips.len())?;
    }
    let [of_position_s, of_attitude_s] = settings.trajectory_priors.correlation_s;
    let mut numbers = vec![
        ("the cell size", settings.cell_m),
        ("the tile size", settings.tile_m),
        ("the correlation time of positions", of_position_s),
        ("the correlation time of attitudes", of_attitude_s),
        ("the factor of accuracies", settings.trajectory_priors.accuracy_factor),
    ];
    if let TrajectoryModel::Spline(step_s) = settings.trajectory_model {
        numbers.push(("the distance of knots", step_s));
    }
    for (name, value) in numbers {
        if !(value.is_finite() && value > 0.0) {
            return Err(AlignError::Setting { name, value });
        }
    }
    let of_installations = survey.installations.iter().flat_map(|installation| installation.priors.0);
    for value in of_installations.chain(settings.trajectory_priors.sd) {
        if !(value.is_finite() && value >= 0.0) {
            return Err(AlignError::Setting { name: "the SD of a start value", value });
        }
    }
    Ok(())
}

fn check_constraints(survey: &Survey<'_>, constraints: &Constraints<'_>) -> Result<(), AlignError> {
    for (k, &wanted) in constraints.references.iter().enumerate() {
        if wanted >= survey.strips.len() {
            let count = survey.strips.len();
            return Err(AlignError::Index { what: "reference", index: k, other: "strip", wanted, count });
        }
    }
    for (index, point) in constraints.control.iter().enumerate() {
        let sds_are_usable = point.sd_m.iter().all(|sd_m| sd_m.is_finite() && *sd_m > 0.0);
        let coordinates = point.position_in_ecef_m.into_iter().chain(point.normal.into_iter().flatten());
        if !(sds_are_usable && coordinates.into_iter().all(f64::is_finite)) {
            return Err(AlignError::Control { index });
        }
    }
    Ok(())
}

fn problem<'a>(survey: &'a Survey<'a>, settings: &AlignSettings) -> Problem<'a> {
    let n = survey.strips.len();
    let mut spans_s = vec![[f64::INFINITY, f64::NEG_INFINITY]; n];
    for patch in survey.patches {
        let strip = patch.strip as usize;
        let offset_s =
            survey.installations[survey.strips[strip].installation].scanner.calibration.time_offset_s;
        for beam in &patch.beams {
            let time_s = beam.time_s + offset_s;
            spans_s[strip] = [spans_s[strip][0].min(time_s), spans_s[strip][1].max(time_s)];
        }
    }
    let times = |span_s: &[f64; 2]| match span_s[0] <= span_s[1] {
        true => knot_times(settings.trajectory_model, *span_s),
        false => Vec::new(),
    };
    let knot_times_s: Vec<Vec<f64>> = spans_s.iter().map(times).collect();
    let priors = &settings.trajectory_priors;
    let offsets = survey.strips.iter().zip(&spans_s).map(|(strip, span_s)| {
        let middle_s = 0.5 * (span_s[0] + span_s[1]);
        let pose = survey.trajectories[strip.trajectory].pose(middle_s);
        match pose.and_then(|pose| pose.accuracy) {
            Some(accuracy) => {
                let [north, east, down] = accuracy.position_sd_m;
                let [roll, pitch, heading] = accuracy.attitude_sd_rad;
                [north, east, down, roll, pitch, heading].map(|sd| sd * priors.accuracy_factor)
            }
            None => priors.sd,
        }
    });
    let start = State {
        scanners: survey.installations.iter().map(|installation| installation.scanner).collect(),
        corrections: knot_times_s.iter().map(|times_s| no_corrections(times_s)).collect(),
    };
    let counts: Vec<usize> = knot_times_s.iter().map(Vec::len).collect();
    Problem {
        survey,
        layout: Layout::new(&counts, survey.installations.len()),
        priors: Priors {
            globals: survey.installations.iter().map(|installation| installation.priors.0).collect(),
            offsets: offsets.collect(),
            knot_times_s,
            correlation_s: priors.correlation_s,
        },
        start,
        points: &[],
        control: Vec::new(),
        spans_s,
        shared: 1.0,
    }
}

/// Weights with the robust scale of the residuals.
fn weighting(problem: &Problem<'_>, state: &State, pairs: &[Pair], reject: f64) -> Weighting {
    let residuals = problem.residuals(state, pairs);
    let ratios = residuals.iter().zip(pairs).filter_map(|(r, pair)| Some((*r)?.abs() / pair.sd_m));
    let scale = 1.4826 * median(ratios).unwrap_or(1.0);
    let of_control = problem.control_residuals(state, &problem.control);
    Weighting {
        scale: scale.max(LEAST_SCALE),
        huber: HUBER,
        reject,
        control_scale: control_scale(&problem.control, &of_control),
        shared: problem.shared,
    }
}

/// A Gauss-Newton step; returns its size in SDs, of the combination of unknowns that moves most.
fn step(
    problem: &Problem<'_>,
    state: &mut State,
    pairs: &[Pair],
    weighting: &Weighting,
    held: &[usize],
) -> Result<f64, AlignError> {
    let mut normal = problem.normal(state, pairs, weighting, false);
    for &unknown in held {
        let (node, offset) = problem.layout.place(unknown);
        normal.matrix.hold(node, offset);
        normal.right[unknown] = 0.0;
    }
    let right = normal.right.clone();
    let step = normal.matrix.factor().ok_or(AlignError::NotSolvable)?.solve(&right);
    apply(problem, state, &step)?;
    Ok(step.dot(&right).max(0.0).sqrt())
}

fn apply(problem: &Problem<'_>, state: &mut State, step: &DVector<f64>) -> Result<(), AlignError> {
    let layout = &problem.layout;
    for (installation, scanner) in state.scanners.iter_mut().enumerate() {
        for global in Global::ALL {
            global.add_to(scanner, step[layout.global(installation, global as usize)]);
        }
    }
    for (strip, corrections) in state.corrections.iter_mut().enumerate() {
        let Some(known) = corrections else { continue };
        let mut knots = known.knots().to_vec();
        for (k, knot) in knots.iter_mut().enumerate() {
            let own = layout.knot(strip, k);
            for component in 0..3 {
                knot.offset.north_east_down_m[component] += step[own + component];
                knot.offset.roll_pitch_heading_rad[component] += step[own + 3 + component];
            }
        }
        *corrections = Some(TrajectoryCorrections::new(knots).map_err(|_| AlignError::NotSolvable)?);
    }
    Ok(())
}

/// Estimated parameter with the least evidence, if below [`EVIDENCE`].
fn least_evident(
    problem: &Problem<'_>,
    solution: &Solution,
    treatments: &[[Treatment; GLOBALS]],
) -> Option<(usize, usize)> {
    let mut worst: Option<(f64, (usize, usize))> = None;
    for (installation, sds) in problem.priors.globals.iter().enumerate() {
        for (global, prior_sd) in sds.iter().enumerate().filter(|(_, sd)| **sd > 0.0) {
            let ratio = solution.formal[problem.layout.global(installation, global)] / prior_sd;
            let is_open = treatments[installation][global] == Treatment::Estimated;
            if is_open && ratio > EVIDENCE && worst.is_none_or(|(known, _)| ratio > known) {
                worst = Some((ratio, (installation, global)));
            }
        }
    }
    worst.map(|(_, place)| place)
}

#[cfg(test)]
mod tests;
