//! Bayesian fit of a range walk: a smooth curve with a prior, from second differences.

use nalgebra::{DMatrix, DVector};

use super::proof::Proof;
use super::row::{AmplitudeRow, REACH_SD, spread_ln, weight};
use super::stretches::{jackknife_variance, stretches};
use super::{DelayNode, LEAST_TRIPLES, LearntWalk, NoWalk, RangeWalk, SingleEcho, Triple};

/// Distance of the nodes in the logarithm of the amplitude.
const STEP_LN: f64 = 0.2;
/// SD of the prior far from the reference amplitude, ns.
pub(super) const PRIOR_SD_NS: f64 = 0.05;
/// Correlation length of the prior in the logarithm of the amplitude.
const LENGTH_LN: f64 = 0.8;
/// Number of nodes beyond the amplitudes of the recording, over which the prior returns.
const MARGIN_NODES: usize = 8;
/// Variance added to each node of the prior, so that its matrix can be inverted, ns².
const NUGGET_NS2: f64 = 1e-8;
/// Plausible amplitudes, DN; triples with others are ignored.
const AMPLITUDES_DN: std::ops::RangeInclusive<f64> = 1e-2..=1e7;
/// Smallest variance of `ln amplitude` within triples.
const LEAST_VARIANCE_LN: f64 = 1e-4;
/// Part of the amplitudes beyond those reported as learnt from, at either end.
const BEYOND_PART: f64 = 0.001;
/// Distance in shots within which other triples show the roughness of the surface; triples closer
/// than the first share echoes with the triple itself.
const NEIGHBOURS: std::ops::RangeInclusive<u64> = 3..=12;
/// Fewest neighbours that show the roughness.
const LEAST_NEIGHBOURS: usize = 5;
/// Number of passes of the robust fit, and every how many of them the roughness is measured again.
const PASSES: usize = 15;
const ROUGHNESS_EVERY: usize = 5;
/// Standard deviation of a normal distribution over its median absolute deviation.
const SD_OF_MEDIAN: f64 = 1.4826;

/// Nodes of a walk, and the prior of their delays.
struct DelayGrid {
    reference_dn: f64,
    /// Logarithm of the first node's amplitude over the reference.
    first_ln: f64,
    nodes: usize,
    /// Inverse covariance of the prior, ns⁻².
    precision: DMatrix<f64>,
}

impl DelayGrid {
    fn new(reference_dn: f64, least_dn: f64, most_dn: f64) -> Option<DelayGrid> {
        let below = (-(least_dn / reference_dn).ln() / STEP_LN).ceil().max(0.0) as usize + MARGIN_NODES;
        let above = ((most_dn / reference_dn).ln() / STEP_LN).ceil().max(0.0) as usize + MARGIN_NODES;
        let nodes = below + above + 1;
        let at = |node: usize| (node as f64 - below as f64) * STEP_LN;
        let correlation = |a: f64, b: f64| (-0.5 * ((a - b) / LENGTH_LN).powi(2)).exp();
        // A squared-exponential process, conditional on zero at the reference.
        let covariance = DMatrix::from_fn(nodes, nodes, |i, j| {
            let (a, b) = (at(i), at(j));
            let nugget_ns2 = if i == j { NUGGET_NS2 } else { 0.0 };
            PRIOR_SD_NS.powi(2) * (correlation(a, b) - correlation(a, 0.0) * correlation(b, 0.0)) + nugget_ns2
        });
        let precision = covariance.cholesky()?.inverse();
        Some(DelayGrid { reference_dn, first_ln: at(0), nodes, precision })
    }

    fn amplitude_dn(&self, node: usize) -> f64 {
        self.reference_dn * (self.first_ln + node as f64 * STEP_LN).exp()
    }

    fn row(&self, triple: &Triple, stretch: usize, prior: Option<&RangeWalk>) -> AmplitudeRow {
        let prior_ns = |echo: &SingleEcho| prior.map_or(0.0, |walk| walk.late_ns(echo.amplitude_dn).0);
        let of_three = |[a, b, c]: [f64; 3]| a - 2.0 * b + c;
        let variance_ns2 = triple.echoes.map(|echo| echo.flight_sd_ns.powi(2));
        let ln_amplitudes = triple.echoes.map(|echo| (echo.amplitude_dn / self.reference_dn).ln());
        let mut terms = [(0, 0.0); 6];
        for (k, (ln, factor)) in ln_amplitudes.into_iter().zip([1.0, -2.0, 1.0]).enumerate() {
            let position = ((ln - self.first_ln) / STEP_LN).clamp(0.0, (self.nodes - 2) as f64);
            let (node, part) = (position as usize, position.fract());
            terms[2 * k] = (node, factor * (1.0 - part));
            terms[2 * k + 1] = (node + 1, factor * part);
        }
        AmplitudeRow {
            shot: triple.shot,
            stretch,
            difference_ns: of_three(triple.echoes.each_ref().map(|echo| echo.flight_ns - prior_ns(echo))),
            noise_ns: (variance_ns2[0] + 4.0 * variance_ns2[1] + variance_ns2[2]).sqrt(),
            ln_amplitudes,
            terms,
        }
    }
}

/// Sums of weighted equations.
#[derive(Clone)]
struct DelayEquations {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl DelayEquations {
    fn zero(nodes: usize) -> DelayEquations {
        DelayEquations { matrix: DMatrix::zeros(nodes, nodes), right: DVector::zeros(nodes) }
    }

    fn add(&mut self, row: &AmplitudeRow, weight: f64) {
        for &(i, a) in &row.terms {
            self.right[i] += weight * a * row.difference_ns;
            for &(j, b) in &row.terms {
                self.matrix[(i, j)] += weight * a * b;
            }
        }
    }
}

/// Result of a fit.
struct DelayFit {
    coefficients_ns: DVector<f64>,
    /// Variances of the coefficients, ns².
    variances_ns2: Vec<f64>,
    /// SD of the second difference of each row by roughness and noise, ns.
    sds_ns: Vec<f64>,
}

pub(super) fn learn(triples: &[Triple], prior: Option<&RangeWalk>) -> Result<LearntWalk, NoWalk> {
    let is_usable = |echo: &SingleEcho| {
        echo.flight_ns.is_finite()
            && echo.flight_sd_ns.is_finite()
            && AMPLITUDES_DN.contains(&echo.amplitude_dn)
    };
    let triples: Vec<Triple> =
        triples.iter().filter(|triple| triple.echoes.iter().all(is_usable)).copied().collect();
    if triples.len() < LEAST_TRIPLES {
        return Err(NoWalk::TooFew(triples.len()));
    }
    let mut middle_dn: Vec<f64> = triples.iter().map(|triple| triple.echoes[1].amplitude_dn).collect();
    middle_dn.sort_by(f64::total_cmp);
    let at = |part: f64| middle_dn[(part * (middle_dn.len() - 1) as f64) as usize];
    let all_dn = || triples.iter().flat_map(|triple| triple.echoes.map(|echo| echo.amplitude_dn));
    let (least_dn, most_dn) =
        all_dn().fold((f64::INFINITY, 0.0f64), |(least, most), dn| (least.min(dn), most.max(dn)));
    let reference_dn = prior.map_or(at(0.5), |walk| walk.reference_dn);
    let grid = DelayGrid::new(reference_dn, least_dn, most_dn).ok_or(NoWalk::OneAmplitude)?;
    let (stretch_of, stretches) = stretches(&triples);
    let rows: Vec<AmplitudeRow> =
        triples.iter().zip(stretch_of).map(|(triple, stretch)| grid.row(triple, stretch, prior)).collect();
    let variance_ln = rows.iter().map(|row| spread_ln(row).powi(2)).sum::<f64>() / rows.len() as f64;
    if variance_ln < LEAST_VARIANCE_LN {
        return Err(NoWalk::OneAmplitude);
    }

    let whole = fit(&rows, &grid, stretches, None, |_| true).ok_or(NoWalk::OneAmplitude)?;
    let half = |of: usize| {
        let found = fit(&rows, &grid, stretches, Some(&whole.sds_ns), |row| row.stretch % 2 == of);
        found.ok_or(NoWalk::OneAmplitude)
    };
    let halves = [half(0)?, half(1)?];
    let predicted_ns: Vec<f64> =
        rows.iter().map(|row| row.walk_ns(&halves[1 - row.stretch % 2].coefficients_ns)).collect();
    let proof = Proof::of(&rows, &predicted_ns, &whole.sds_ns, stretches);

    let node = |k: usize| {
        let amplitude_dn = grid.amplitude_dn(k);
        let before_ns = prior.map_or(0.0, |walk| walk.late_ns(amplitude_dn).0);
        let is_reference = (amplitude_dn / reference_dn).ln().abs() < 0.5 * STEP_LN;
        let (late_ns, late_sd_ns) = match is_reference {
            true => (0.0, 0.0),
            false => (before_ns + whole.coefficients_ns[k], whole.variances_ns2[k].sqrt()),
        };
        DelayNode { amplitude_dn, late_ns, late_sd_ns }
    };
    let walk = RangeWalk {
        reference_dn,
        amplitudes_dn: [at(BEYOND_PART), at(1.0 - BEYOND_PART)],
        nodes: (0..grid.nodes).map(node).collect(),
        triples: triples.len() as u64,
    };
    Ok(LearntWalk { walk, proof })
}

/// Fits the used rows; `sds_ns` are those of another fit, measured here if `None`.
fn fit(
    rows: &[AmplitudeRow],
    grid: &DelayGrid,
    stretches: usize,
    sds_ns: Option<&[f64]>,
    is_used: impl Fn(&AmplitudeRow) -> bool,
) -> Option<DelayFit> {
    let mut coefficients_ns = DVector::zeros(grid.nodes);
    let mut own_sds_ns = sds_ns.map(<[f64]>::to_vec).unwrap_or_default();
    let mut parts = vec![DelayEquations::zero(grid.nodes); stretches];
    let (mut weights, mut slopes) = (0.0, 0.0);
    for pass in 0..PASSES {
        let residuals_ns: Vec<f64> =
            rows.iter().map(|row| row.difference_ns - row.walk_ns(&coefficients_ns)).collect();
        if sds_ns.is_none() && pass.is_multiple_of(ROUGHNESS_EVERY) {
            own_sds_ns = roughness_ns(rows, &residuals_ns);
        }
        parts.fill(DelayEquations::zero(grid.nodes));
        (weights, slopes) = (0.0, 0.0);
        for ((row, residual_ns), sd_ns) in rows.iter().zip(&residuals_ns).zip(&own_sds_ns) {
            let u2 = (residual_ns / (REACH_SD * sd_ns)).powi(2);
            if is_used(row) && sd_ns.is_finite() && u2 < 1.0 {
                weights += (1.0 - u2).powi(2);
                slopes += (1.0 - u2) * (1.0 - 5.0 * u2);
                parts[row.stretch].add(row, weight(*residual_ns, *sd_ns));
            }
        }
        let all = sum(&parts)?;
        coefficients_ns = (&all.matrix + &grid.precision).cholesky()?.solve(&all.right);
    }
    let all = sum(&parts)?;
    let covariance = (&all.matrix + &grid.precision).cholesky()?.inverse();
    let by_model = &covariance * &all.matrix * &covariance;
    let mut without_one = Vec::new();
    for part in parts.iter().filter(|part| part.matrix.iter().any(|value| *value != 0.0)) {
        let matrix = &all.matrix - &part.matrix + &grid.precision;
        without_one.push(matrix.cholesky()?.solve(&(&all.right - &part.right)));
    }
    // Weights that follow the residuals scatter more than fixed ones (P. J. Huber, Robust
    // Statistics, 1981, section 7.6).
    let factor = (weights / slopes.max(0.1 * weights)).powi(2);
    let variance_ns2 = |k: usize| {
        let jackknife = jackknife_variance(coefficients_ns[k], without_one.iter().map(|found| found[k]));
        covariance[(k, k)] + (factor * jackknife - by_model[(k, k)]).max(0.0)
    };
    let variances_ns2 = (0..grid.nodes).map(variance_ns2).collect();
    Some(DelayFit { coefficients_ns, variances_ns2, sds_ns: own_sds_ns })
}

fn sum(parts: &[DelayEquations]) -> Option<DelayEquations> {
    let (first, others) = parts.split_first()?;
    let mut all = first.clone();
    for part in others {
        all.matrix += &part.matrix;
        all.right += &part.right;
    }
    Some(all)
}

/// SD of the second difference of every row, from its neighbours and its noise, ns.
///
/// Infinite if there are too few neighbours.
fn roughness_ns(rows: &[AmplitudeRow], residuals_ns: &[f64]) -> Vec<f64> {
    let mut first = 0;
    let mut near_ns = Vec::new();
    let sd_ns = |(i, row): (usize, &AmplitudeRow)| {
        while row.shot.abs_diff(rows[first].shot) > *NEIGHBOURS.end() && first < i {
            first += 1;
        }
        near_ns.clear();
        for (other, residual_ns) in rows[first..].iter().zip(&residuals_ns[first..]) {
            let distance = other.shot.abs_diff(row.shot);
            if NEIGHBOURS.contains(&distance) {
                near_ns.push(residual_ns.abs());
            } else if other.shot > row.shot && distance > *NEIGHBOURS.end() {
                break;
            }
        }
        if near_ns.len() < LEAST_NEIGHBOURS {
            return f64::INFINITY;
        }
        let middle = near_ns.len() / 2;
        let (_, median_ns, _) = near_ns.select_nth_unstable_by(middle, f64::total_cmp);
        (SD_OF_MEDIAN * *median_ns).hypot(row.noise_ns)
    };
    rows.iter().enumerate().map(sd_ns).collect()
}
