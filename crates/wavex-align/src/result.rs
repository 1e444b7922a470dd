//! Result of an alignment.

use rayon::prelude::*;
use wavex_geodesy::trajectory::corrections::TrajectoryCorrections;
use wavex_simd::statistics::median;

use crate::control::ControlResult;
use crate::estimable::{FlightFacts, REPORTED_CORRELATION, Treatment, Verdict, verdict};
use crate::matching::{MatchSettings, Pair, match_patches};
use crate::normal::{Problem, Weighting};
use crate::observation::{Observation, observations};
use crate::parameters::{GLOBALS, Global, OFFSETS};
use crate::patch::Patch;
use crate::solution::Solution;
use crate::survey::{State, Survey};
use crate::time_errors::TimeErrors;
use crate::variance::VarianceComponent;
use crate::vector::{difference, dot, length};

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
    /// SDs of these offsets from the scatter of tiles alone, without the part of the start values.
    pub knot_jackknife_sds: Vec<[f64; OFFSETS]>,
    /// SDs of the start values (0), with the factors of all trajectories.
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
    /// Covariance of the parameters of all installations, in the order of `parameters`; 0 for given ones.
    ///
    /// Correlations are formal, variances those of the stated SDs.
    pub covariance: Vec<Vec<f64>>,
    /// Corrections of each strip.
    pub strips: Vec<StripResult>,
    /// Pairs of the last iteration, used and rejected.
    pub observations: Vec<Observation>,
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
    /// What the pairs of the strips of each installation show.
    pub installation_facts: Vec<FlightFacts>,
    /// Rating.
    pub verdict: Verdict,
    /// Control points.
    pub control: ControlResult,
    /// Factors of the SDs of positions and attitudes of the trajectories; `None` if they were not estimated.
    pub trajectory_sds: Option<[VarianceComponent; 2]>,
    /// Errors that pairs of the same time share; `None` if they were not looked for.
    pub time_errors: Option<TimeErrors>,
}

/// Corrections above this many given SDs of a trajectory are not errors of the trajectory.
const MISPLACED_SDS: f64 = 10.0;
/// Strips whose corrections reach this part of the largest are named with it.
const MISPLACED_PART: f64 = 0.7;

/// A strip with a correction that its trajectory does not explain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MisplacedStrip {
    /// Index of the strip.
    pub strip: usize,
    /// Offset: 0 to 2 north, east, down, 3 to 5 roll, pitch, heading.
    pub offset: usize,
    /// Mean of this offset over the knots, m or rad.
    pub mean: f64,
    /// The same over the SD of the trajectory before any factor.
    pub sds: f64,
}

impl Alignment {
    /// Strips that were probably flown with another installation, largest corrections first: far beyond the given SDs of
    /// their trajectories, and about the largest of all.
    ///
    /// Least squares spread a wrong boresight over the strips of the installation, most of it to the wrong strip.
    pub fn misplaced_strips(&self) -> Vec<MisplacedStrip> {
        let factors = self.trajectory_sds.map_or([1.0; 2], |both| both.map(|own| own.applied()));
        let of_strip = |(strip, own): (usize, &StripResult)| {
            let knots = own.corrections.as_ref()?.knots();
            let offsets = (0..OFFSETS).filter(|offset| own.prior_sds[*offset] > 0.0).map(|offset| {
                let values = knots.iter().map(|knot| match offset {
                    0..3 => knot.offset.north_east_down_m[offset],
                    _ => knot.offset.roll_pitch_heading_rad[offset - 3],
                });
                let mean = values.sum::<f64>() / knots.len() as f64;
                let given = own.prior_sds[offset] / factors[offset / 3];
                MisplacedStrip { strip, offset, mean, sds: mean.abs() / given }
            });
            offsets.max_by(|a, b| a.sds.total_cmp(&b.sds))
        };
        let with_pairs = self.strips.iter().enumerate().filter(|(_, own)| own.n_pairs > 0);
        let all: Vec<MisplacedStrip> = with_pairs.filter_map(of_strip).collect();
        let most = all.iter().map(|own| own.sds).fold(0.0, f64::max);
        let least = MISPLACED_SDS.max(MISPLACED_PART * most);
        let mut named: Vec<_> = all.into_iter().filter(|own| own.sds > least).collect();
        named.sort_by(|a, b| b.sds.total_cmp(&a.sds));
        named
    }
}

/// Differences of two strips: their indices, values, m, and number of rejected pairs.
pub(crate) type Differences = Vec<([u32; 2], Vec<f64>, usize)>;

pub(crate) fn pairs_with_residuals(
    problem: &Problem<'_>,
    state: &State,
    settings: &MatchSettings,
) -> Differences {
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

pub(crate) fn report(
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
            let of_tiles = |knot| {
                let own = layout.knot(strip, knot);
                core::array::from_fn(|c| if prior_sds[c] == 0.0 { 0.0 } else { solution.jackknife[own + c] })
            };
            let is_own = |overlap: &&OverlapResult| overlap.strips.contains(&(strip as u32));
            StripResult {
                corrections: state.corrections[strip].clone(),
                knot_sds: (0..count).map(of_knot).collect(),
                knot_jackknife_sds: (0..count).map(of_tiles).collect(),
                prior_sds,
                n_pairs: overlaps.iter().filter(is_own).map(|overlap| overlap.n_pairs).sum(),
                n_unlocated: 0,
            }
        })
        .collect();
    let all_facts = facts(survey, &state, pairs, |_| true);
    let installation_facts = match layout.installations {
        1 => vec![all_facts],
        all => (0..all).map(|own| facts(survey, &state, pairs, |other| other == own)).collect(),
    };
    let mut result = Alignment {
        correlations: correlations(problem, solution),
        covariance: covariance(problem, solution),
        observations: observations(problem, &state, pairs, weighting),
        strips,
        overlaps,
        scale: weighting.scale,
        n_unknowns: layout.len(),
        n_pairs,
        n_rejected,
        spread_m,
        facts: all_facts,
        installation_facts,
        verdict: verdict(
            weighting.scale,
            n_rejected as f64 / n_pairs.max(1) as f64,
            spread_m,
            parameters.iter().flatten().map(ParameterResult::change_sds).fold(0.0, f64::max),
        ),
        parameters,
        state,
        control: ControlResult::default(),
        trajectory_sds: None,
        time_errors: None,
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

/// Formal correlations times the stated SDs.
fn covariance(problem: &Problem<'_>, solution: &Solution) -> Vec<Vec<f64>> {
    let formal = &solution.globals;
    let first = problem.layout.globals_start();
    let sd = |k: usize| match problem.priors.globals[k / GLOBALS][k % GLOBALS] > 0.0 {
        true => solution.sd(first + k),
        false => 0.0,
    };
    let of = |i: usize, j: usize| {
        let correlation = match i == j {
            true => 1.0,
            false => formal[(i, j)] / (formal[(i, i)] * formal[(j, j)]).sqrt(),
        };
        let sds = sd(i) * sd(j);
        if sds > 0.0 { correlation * sds } else { 0.0 }
    };
    let n = formal.nrows();
    (0..n).map(|i| (0..n).map(|j| of(i, j)).collect()).collect()
}

/// Facts of the pairs with a strip of these installations.
fn facts(survey: &Survey<'_>, state: &State, pairs: &[Pair], is_own: impl Fn(usize) -> bool) -> FlightFacts {
    let mut poses = survey.poses();
    let mut facts = FlightFacts { ranges_m: [f64::INFINITY, 0.0], ..FlightFacts::default() };
    let (mut sloped, mut n_pairs) = (0, 0_usize);
    for pair in pairs {
        let [a, b] = pair.patches.map(|patch| &survey.patches[patch as usize]);
        if ![a, b].iter().any(|patch| is_own(survey.strips[patch.strip as usize].installation)) {
            continue;
        }
        n_pairs += 1;
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
    facts.sloped = sloped as f64 / n_pairs.max(1) as f64;
    facts
}
