//! Estimation of all parameters from the pairs of patches.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use wavex_geodesy::trajectory::corrections::TrajectoryCorrections;
use wavex_simd::statistics::median;

use crate::estimable::{EVIDENCE, FlightFacts, REPORTED_CORRELATION, Treatment, Verdict, verdict};
use crate::matching::{MatchSettings, Pair, match_patches};
use crate::normal::{Priors, Problem, Weighting};
use crate::parameters::{
    GLOBALS, Global, Layout, OFFSETS, TrajectoryModel, TrajectoryPriors, knot_times, no_corrections,
};
use crate::patch::Patch;
use crate::survey::{State, Survey};
use crate::vector::{difference, dot, length};

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
}

impl Default for AlignSettings {
    fn default() -> AlignSettings {
        AlignSettings {
            trajectory_model: TrajectoryModel::Constant,
            trajectory_priors: TrajectoryPriors::default(),
            cell_m: 3.0,
            most_pairs: 3000,
        }
    }
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
    /// The normal equations have no solution.
    #[error("the normal equations cannot be solved: priors or patches hold extreme numbers")]
    NotSolvable,
}

/// An estimated or given parameter of an installation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ParameterResult {
    /// The parameter; its name states the unit.
    pub parameter: Global,
    /// Start value.
    pub start: f64,
    /// Value after alignment.
    pub value: f64,
    /// SD: the larger of the formal one and that of the jackknife. That of the start value if not estimable.
    pub sd: f64,
    /// SD from the inverse of the normal matrix.
    pub formal_sd: f64,
    /// SD from the scatter of the gradients of tiles.
    pub jackknife_sd: f64,
    /// SD of the start value.
    pub prior_sd: f64,
    /// How it was treated.
    pub treatment: Treatment,
}

impl ParameterResult {
    /// Change of the start value in its SDs; 0 for a given one.
    pub fn change_sds(&self) -> f64 {
        if self.prior_sd > 0.0 { (self.value - self.start).abs() / self.prior_sd } else { 0.0 }
    }
}

/// Correlation of two parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correlation {
    /// Installation and parameter.
    pub first: (usize, Global),
    /// Installation and parameter.
    pub second: (usize, Global),
    /// Correlation, -1 to 1.
    pub correlation: f64,
}

/// Corrections of a strip.
#[derive(Clone, Debug, PartialEq)]
pub struct StripResult {
    /// Corrections of its trajectory, in the form for `PoseOffset::applied_to`.
    pub corrections: Option<TrajectoryCorrections>,
    /// SDs of the offsets of each knot: north, east, down, m, roll, pitch, heading, rad.
    pub knot_sds: Vec<[f64; OFFSETS]>,
    /// SDs of the start values (0).
    pub prior_sds: [f64; OFFSETS],
    /// Number of pairs with other strips; 0 means that the strip is not connected.
    pub n_pairs: usize,
    /// Patches without a pose.
    pub n_unlocated: usize,
}

/// Differences of two strips along the normals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OverlapResult {
    /// Indices of the strips.
    pub strips: [u32; 2],
    /// Number of pairs, used and rejected.
    pub n_pairs: usize,
    /// Rejected pairs.
    pub n_rejected: usize,
    /// Median difference before and after, m.
    pub median_m: [f64; 2],
    /// Robust SD about zero (1.4826 median of the absolute difference) before and after, m.
    pub spread_m: [f64; 2],
}

/// Result of an alignment.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    /// Values of all parameters.
    pub state: State,
    /// Parameters of each installation.
    pub parameters: Vec<[ParameterResult; GLOBALS]>,
    /// Correlations above 0.9 of parameters that are not given.
    pub correlations: Vec<Correlation>,
    /// Corrections of each strip.
    pub strips: Vec<StripResult>,
    /// Differences of the strips that overlap.
    pub overlaps: Vec<OverlapResult>,
    /// Ratio of the residuals to the stated SDs of the patches.
    pub scale: f64,
    /// Number of unknowns.
    pub n_unknowns: usize,
    /// Number of pairs, used and rejected.
    pub n_pairs: usize,
    /// Rejected pairs.
    pub n_rejected: usize,
    /// Robust SD of the differences before and after, m.
    pub spread_m: [f64; 2],
    /// What the pairs show of the flight.
    pub facts: FlightFacts,
    /// Rating.
    pub verdict: Verdict,
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

/// Aligns a survey.
///
/// # Errors
/// Indices out of range, settings that are not above 0, no pairs, extreme numbers.
pub fn align(survey: &Survey<'_>, settings: &AlignSettings) -> Result<Alignment, AlignError> {
    check(survey, settings)?;
    let problem = problem(survey, settings);
    let mut state = problem.start.clone();
    let matching = |level: &Level| MatchSettings {
        search_m: level.search * settings.cell_m,
        gate_m: level.gate_m,
        turn_rad: level.turn_deg.to_radians(),
        most_pairs: ((level.pairs * settings.most_pairs as f64) as usize).max(1),
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
    let mut pairs = match_patches(survey, &state, &matching(fine));
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
        let solution = Solution::new(&problem, &state, &pairs, &weighting, &held)?;
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
        } else {
            treatments[installation][global] = Treatment::OnlyCombined;
        }
    };
    Ok(report(&problem, state, &pairs, &solution, &weighting, &treatments, &before))
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

fn problem<'a>(survey: &'a Survey<'a>, settings: &AlignSettings) -> Problem<'a> {
    let n = survey.strips.len();
    let mut spans_s = vec![[f64::INFINITY, f64::NEG_INFINITY]; n];
    for patch in survey.patches {
        let strip = patch.strip as usize;
        let offset_s = survey.installations[survey.strips[strip].installation].scanner.time_offset_s;
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
    }
}

/// Weights with the robust scale of the residuals.
fn weighting(problem: &Problem<'_>, state: &State, pairs: &[Pair], reject: f64) -> Weighting {
    let residuals = problem.residuals(state, pairs);
    let ratios = residuals.iter().zip(pairs).filter_map(|(r, pair)| Some((*r)?.abs() / pair.sd_m));
    let scale = 1.4826 * median(ratios).unwrap_or(1.0);
    Weighting { scale: scale.max(LEAST_SCALE), huber: HUBER, reject }
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

/// Standard deviations at the solution.
struct Solution {
    /// Covariance of the parameters of all installations.
    globals: DMatrix<f64>,
    /// Formal SDs of all unknowns.
    formal: Vec<f64>,
    /// SDs of all unknowns from the scatter of tiles.
    jackknife: Vec<f64>,
}

impl Solution {
    /// Held parameters keep their start values; their SDs pass to the others through their effect on them (consider
    /// parameters of S. F. Schmidt).
    fn new(
        problem: &Problem<'_>,
        state: &State,
        pairs: &[Pair],
        weighting: &Weighting,
        held: &[usize],
    ) -> Result<Solution, AlignError> {
        let layout = &problem.layout;
        let mut normal = problem.normal(state, pairs, weighting, true);
        let mut effects = Vec::new();
        for &unknown in held {
            let (node, offset) = layout.place(unknown);
            effects.push(-normal.matrix.hold(node, offset));
        }
        for effect in effects.iter_mut().chain(&mut normal.groups) {
            held.iter().for_each(|&unknown| effect[unknown] = 0.0);
        }
        let factor = normal.matrix.factor().ok_or(AlignError::NotSolvable)?;
        let inverse = factor.selected_inverse();
        let n_globals = GLOBALS * layout.installations;
        let first = layout.globals_start();
        let block = inverse.diagonal(layout.globals_node()).ok_or(AlignError::NotSolvable)?;
        let mut globals = block.clone();
        let mut formal: Vec<f64> = (0..layout.len())
            .map(|unknown| {
                let (node, offset) = layout.place(unknown);
                inverse.diagonal(node).map_or(0.0, |block| block[(offset, offset)])
            })
            .collect();
        let mut jackknife = vec![0.0; layout.len()];
        let n_groups = normal.groups.iter().filter(|group| group.amax() > 0.0).count().max(2) as f64;
        let factor_of_groups = n_groups / (n_groups - 1.0);
        for group in &normal.groups {
            let change = factor.solve(group);
            jackknife.iter_mut().zip(change.iter()).for_each(|(sum, x)| *sum += factor_of_groups * x * x);
        }
        // The part of the priors, for the parameters of installations.
        for unknown in first..layout.len() {
            let mut unit = DVector::zeros(layout.len());
            unit[unknown] = 1.0;
            let column = factor.solve(&unit);
            let mut product = vec![0.0; layout.len()];
            problem.prior_times(&column, &mut product, None);
            held.iter().for_each(|&unknown| product[unknown] = 0.0);
            jackknife[unknown] += column.iter().zip(product).map(|(x, y)| x * y).sum::<f64>();
        }
        for (&unknown, effect) in held.iter().zip(&effects) {
            let mut effect = factor.solve(effect);
            held.iter().for_each(|&other| effect[other] = 0.0);
            effect[unknown] = 1.0;
            let k = unknown - first;
            let sd = problem.priors.globals[k / GLOBALS][k % GLOBALS];
            let scaled = effect * sd;
            // The held unknown itself has unit information in the system.
            formal[unknown] = 0.0;
            jackknife[unknown] = 0.0;
            globals[(k, k)] = 0.0;
            for (other, x) in scaled.iter().enumerate() {
                formal[other] += x * x;
                jackknife[other] += x * x;
            }
            let of_globals = scaled.rows(first, n_globals);
            globals += of_globals * of_globals.transpose();
        }
        let sds = |variances: Vec<f64>| variances.into_iter().map(|v| v.max(0.0).sqrt()).collect();
        Ok(Solution { globals, formal: sds(formal), jackknife: sds(jackknife) })
    }

    fn sd(&self, unknown: usize) -> f64 {
        self.formal[unknown].max(self.jackknife[unknown])
    }
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

/// Differences of two strips: their indices, values, m, and number of rejected pairs.
type Differences = Vec<([u32; 2], Vec<f64>, usize)>;

fn pairs_with_residuals(problem: &Problem<'_>, state: &State, settings: &MatchSettings) -> Differences {
    let pairs = match_patches(problem.survey, state, settings);
    let residuals = problem.residuals(state, &pairs);
    by_overlap(problem, &pairs, &residuals, |_, _| true)
}

fn by_overlap(
    problem: &Problem<'_>,
    pairs: &[Pair],
    residuals: &[Option<f64>],
    is_used: impl Fn(&Pair, f64) -> bool,
) -> Differences {
    let strips = |pair: &Pair| pair.patches.map(|patch| problem.survey.patches[patch as usize].strip);
    let mut found: Differences = Vec::new();
    let mut order: Vec<usize> = (0..pairs.len()).collect();
    order.sort_by_key(|k| strips(&pairs[*k]));
    for k in order {
        let Some(residual) = residuals[k] else { continue };
        let own = strips(&pairs[k]);
        if found.last().is_none_or(|(known, ..)| *known != own) {
            found.push((own, Vec::new(), 0));
        }
        if let Some((_, values, n_rejected)) = found.last_mut() {
            if is_used(&pairs[k], residual) {
                values.push(residual);
            } else {
                *n_rejected += 1;
            }
        }
    }
    found
}

fn robust_spread(values: impl Iterator<Item = f64>) -> f64 {
    median(values.map(f64::abs)).map_or(f64::NAN, |value| 1.4826 * value)
}

fn report(
    problem: &Problem<'_>,
    state: State,
    pairs: &[Pair],
    solution: &Solution,
    weighting: &Weighting,
    treatments: &[[Treatment; GLOBALS]],
    before: &Differences,
) -> Alignment {
    let (survey, layout) = (problem.survey, &problem.layout);
    let residuals = problem.residuals(&state, pairs);
    let after = by_overlap(problem, pairs, &residuals, |pair, r| weighting.weight(pair, r) > 0.0);
    let overlaps: Vec<OverlapResult> = after
        .iter()
        .map(|(strips, values, n_rejected)| {
            let known = before.iter().find(|(own, ..)| own == strips).map_or(&[][..], |(_, v, _)| v);
            let both = [known, values.as_slice()];
            OverlapResult {
                strips: *strips,
                n_pairs: values.len() + n_rejected,
                n_rejected: *n_rejected,
                median_m: both.map(|values| median(values.iter().copied()).unwrap_or(f64::NAN)),
                spread_m: both.map(|values| robust_spread(values.iter().copied())),
            }
        })
        .collect();
    let all = |differences: &Differences| {
        robust_spread(differences.iter().flat_map(|(_, values, _)| values.iter().copied()))
    };
    let spread_m = [all(before), all(&after)];
    let n_pairs: usize = overlaps.iter().map(|overlap| overlap.n_pairs).sum();
    let n_rejected: usize = overlaps.iter().map(|overlap| overlap.n_rejected).sum();
    let parameters: Vec<[ParameterResult; GLOBALS]> = (0..layout.installations)
        .map(|installation| {
            core::array::from_fn(|global| {
                let parameter = Global::ALL[global];
                let unknown = layout.global(installation, global);
                let prior_sd = problem.priors.globals[installation][global];
                let is_given = prior_sd == 0.0;
                let sd_of = |sd: f64| if is_given { 0.0 } else { sd };
                ParameterResult {
                    parameter,
                    start: parameter.of(&problem.start.scanners[installation]),
                    value: parameter.of(&state.scanners[installation]),
                    sd: sd_of(solution.sd(unknown)),
                    formal_sd: sd_of(solution.formal[unknown]),
                    jackknife_sd: sd_of(solution.jackknife[unknown]),
                    prior_sd,
                    treatment: if is_given { Treatment::Given } else { treatments[installation][global] },
                }
            })
        })
        .collect();
    let strips = (0..survey.strips.len())
        .map(|strip| {
            let count = problem.priors.knot_times_s[strip].len();
            let prior_sds = problem.priors.offsets[strip];
            let of_knot = |knot| {
                let own = layout.knot(strip, knot);
                core::array::from_fn(|c| if prior_sds[c] == 0.0 { 0.0 } else { solution.sd(own + c) })
            };
            let is_own = |overlap: &&OverlapResult| overlap.strips.contains(&(strip as u32));
            StripResult {
                corrections: state.corrections[strip].clone(),
                knot_sds: (0..count).map(of_knot).collect(),
                prior_sds,
                n_pairs: overlaps.iter().filter(is_own).map(|overlap| overlap.n_pairs).sum(),
                n_unlocated: 0,
            }
        })
        .collect();
    let mut result = Alignment {
        correlations: correlations(problem, solution),
        strips,
        overlaps,
        scale: weighting.scale,
        n_unknowns: layout.len(),
        n_pairs,
        n_rejected,
        spread_m,
        facts: facts(survey, &state, pairs),
        verdict: verdict(
            weighting.scale,
            n_rejected as f64 / n_pairs.max(1) as f64,
            spread_m,
            parameters.iter().flatten().map(ParameterResult::change_sds).fold(0.0, f64::max),
        ),
        parameters,
        state,
    };
    let lost: Vec<u32> = survey
        .patches
        .par_chunks(1024)
        .flat_map_iter(|chunk| {
            let mut poses = survey.poses();
            let is_lost = |patch: &&Patch| survey.locate(patch, &result.state, &mut poses).is_none();
            chunk.iter().filter(is_lost).map(|patch| patch.strip).collect::<Vec<_>>()
        })
        .collect();
    for strip in lost {
        result.strips[strip as usize].n_unlocated += 1;
    }
    result
}

fn correlations(problem: &Problem<'_>, solution: &Solution) -> Vec<Correlation> {
    let place = |k: usize| (k / GLOBALS, Global::ALL[k % GLOBALS]);
    let is_open = |k: usize| problem.priors.globals[k / GLOBALS][k % GLOBALS] > 0.0;
    let covariance = &solution.globals;
    let mut found = Vec::new();
    for i in (0..covariance.nrows()).filter(|i| is_open(*i)) {
        for j in (0..i).filter(|j| is_open(*j)) {
            let correlation = covariance[(i, j)] / (covariance[(i, i)] * covariance[(j, j)]).sqrt();
            if correlation.abs() > REPORTED_CORRELATION {
                found.push(Correlation { first: place(j), second: place(i), correlation });
            }
        }
    }
    found
}

fn facts(survey: &Survey<'_>, state: &State, pairs: &[Pair]) -> FlightFacts {
    let mut poses = survey.poses();
    let mut facts = FlightFacts { ranges_m: [f64::INFINITY, 0.0], ..FlightFacts::default() };
    let mut sloped = 0;
    for pair in pairs {
        let [a, b] = pair.patches.map(|patch| &survey.patches[patch as usize]);
        for patch in [a, b] {
            let range_m = patch.beams[0].range_m;
            facts.ranges_m = [facts.ranges_m[0].min(range_m), facts.ranges_m[1].max(range_m)];
        }
        facts.receiver_pairs += usize::from(a.source.on_low_power_scale != b.source.on_low_power_scale);
        let scanner = |strip: u32| &state.scanners[survey.strips[strip as usize].installation];
        let [angle_a, angle_b] = [a, b].map(|patch| scanner(patch.strip).scan_angle_rad(&patch.beams[0]));
        facts.angles_rad = facts.angles_rad.max((angle_a - angle_b).abs());
        if let Some(at) = survey.locate(a, state, &mut poses) {
            let [east, north, up] = at.normal();
            sloped += usize::from(east.hypot(north) > 0.1 * up);
        }
        let mut course = |strip: u32, time_s: f64| {
            let trajectory = survey.strips[strip as usize].trajectory;
            let mut at = |time_s| Some(poses[trajectory].at(time_s)?.origin_in_ecef_m);
            let motion = difference(at(time_s + 0.2)?, at(time_s - 0.2)?);
            (length(motion) > 0.0).then_some(motion)
        };
        let courses = (course(a.strip, a.beams[0].time_s), course(b.strip, b.beams[0].time_s));
        if let (Some(a), Some(b)) = courses {
            let cosine = (dot(a, b) / (length(a) * length(b))).clamp(-1.0, 1.0);
            facts.turn_rad = facts.turn_rad.max(cosine.acos());
            facts.crossing_rad = facts.crossing_rad.max(cosine.abs().acos());
        }
    }
    facts.sloped = sloped as f64 / pairs.len().max(1) as f64;
    facts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimable::reasons;
    use crate::parameters::GlobalPriors;
    use crate::simulated::{Flight, Plan, flat, hills, parallel};

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
        let settings = MatchSettings { search_m: 5.0, gate_m: 1.0, turn_rad: 0.3, most_pairs: 1 };
        let mut state = problem.start.clone();
        let away = DVector::from_fn(problem.layout.len(), |k, _| 1e-4 * (k as f64).sin());
        apply(&problem, &mut state, &away).unwrap();
        let mut pair = match_patches(&survey, &state, &settings)[0];
        // The derivatives are exact for the normal with its noise.
        let mut poses = survey.poses();
        let normals = pair.patches.map(|patch| {
            survey.locate(&survey.patches[patch as usize], &state, &mut poses).unwrap().normal()
        });
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
        plan.truth.time_offset_s = 0.001;
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
}
