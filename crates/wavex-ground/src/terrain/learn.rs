//! Learns the model of an area from samples of its ground points.

use rayon::prelude::*;
use wavex_simd::statistics::median;

use super::kriging::{Parts, Smoothness, Target};
use super::model::{
    Assumption, CLASSES, DISTANCES_M, NODE_M, NODE_POINTS, NOISE_STEPS, PointSds, Scratch, TERRAIN_STEPS,
    TerrainModel, data_of, keep_frequent_strips, posterior, steps,
};
use super::neighbours::PointIndex;
use crate::point::CloudPoint;

/// Most nodes from which roughness and noise are learnt.
const MOST_NODES: usize = 3000;
/// Most points that are predicted from others.
const MOST_POINTS: usize = 1500;
/// Fewest nodes for an estimate.
const FEWEST_NODES: usize = 20;
/// Fewest predicted points for an estimate of a class of distances.
const FEWEST_POINTS: usize = 60;
/// Radii around a predicted point without points, m: points of one scan line are not independent.
const HOLES_M: [f64; 7] = [0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];
/// Distance to the edge of a sample within which points are not predicted, m: nothing is beyond the edge.
const EDGE_M: f64 = 20.0;
/// Iterations of the prior's estimate (expectation, maximisation).
const ITERATIONS: usize = 30;
/// Share of the prior that is spread over all values, for terrain that the samples lack.
const SPREAD: f64 = 0.01;
/// Error in SDs from which a predicted point counts as wrongly classified.
const WRONG: [f64; 2] = [-4.5, 2.5];
/// Largest error in SDs that counts: a few wrong points must not decide.
const MOST_DEVIATION: f64 = 6.0;
/// Assumed SD of the height error of a strip, m.
const ASSUMED_STRIP_M: f64 = 0.05;
/// Typical SD of the height errors of strips, m, with the weight of two strips in the estimate from overlaps.
const TYPICAL_STRIP_M: f64 = 0.02;
/// Fewest points of each of two strips for their difference.
const STRIP_POINTS: usize = 6;

/// A point predicted from others.
#[derive(Clone, Copy, Debug)]
struct LeftOut {
    distance_m: f64,
    error_m: f64,
    /// Variance of the terrain between points before calibration, m².
    terrain: f64,
    /// Variance of everything else, m².
    rest: f64,
}

/// Learns the model from samples: connected sets of ground points in any order.
///
/// `strip_sd_m` is the SD of the height error that the points of a strip share, if known; `sds` is what the SDs of the
/// points include. `most_m` limits the search for neighbours.
pub fn learn_terrain(
    samples: &[Vec<CloudPoint>],
    strip_sd_m: Option<f64>,
    sds: PointSds,
    most_m: f64,
) -> TerrainModel {
    let indices: Vec<PointIndex> = samples.par_iter().map(|points| PointIndex::new(points)).collect();
    let n: usize = indices.iter().map(|index| index.points().len()).sum();
    let known = || {
        let sds = indices.iter().flat_map(|index| index.points()).map(|p| f64::from(p.height_sd_m));
        sds.filter(|sd| *sd > 0.0 && sd.is_finite())
    };
    let typical_sd_m = if 2 * known().count() > n { median(known()).unwrap_or(f64::NAN) } else { f64::NAN };
    let nodes = nodes_of(&indices);
    let fits: Vec<(Smoothness, Vec<f64>, f64)> = Smoothness::ALL
        .par_iter()
        .filter_map(|smoothness| {
            let of_nodes: Vec<Vec<f64>> = nodes
                .par_iter()
                .map_init(Scratch::default, |scratch, (sample, at)| {
                    let found =
                        scratch.likelihood_at(&indices[*sample], *at, -1.0, *smoothness, typical_sd_m);
                    found.then(|| scratch.likelihood.clone())
                })
                .flatten()
                .collect();
            (of_nodes.len() >= FEWEST_NODES).then(|| {
                let (prior, likelihood) = prior_of(&of_nodes);
                (*smoothness, prior, likelihood)
            })
        })
        .collect();
    let best = fits.into_iter().reduce(|a, b| if b.2 > a.2 { b } else { a });
    let mut model = TerrainModel {
        smoothness: Smoothness::Linear,
        prior: Vec::new(),
        gap_factor: [1.0; CLASSES],
        strip_sd_m: 0.0,
        typical_sd_m,
        assumptions: Vec::new(),
    };
    match best {
        Some((smoothness, prior, _)) => (model.smoothness, model.prior) = (smoothness, prior),
        None => {
            model.assumptions.push(Assumption::Roughness);
            model.prior = assumed_prior(typical_sd_m);
        }
    }
    let noise = {
        let [_, noise] = steps();
        model.prior.iter().enumerate().map(|(k, p)| p * noise[k % NOISE_STEPS]).sum::<f64>()
    };
    model.strip_sd_m = match strip_sd_m {
        Some(sd) => sd,
        None => strip_error(&model, &indices, &nodes).unwrap_or_else(|| {
            if sds == PointSds::Total && typical_sd_m.is_finite() {
                (typical_sd_m * typical_sd_m - noise).max(0.0).sqrt()
            } else {
                model.assumptions.push(Assumption::StripError);
                ASSUMED_STRIP_M
            }
        }),
    };
    let left_out = left_out(&model, &indices, most_m);
    model.gap_factor = match gap_factors(&left_out) {
        Some(factors) => factors,
        None => {
            model.assumptions.push(Assumption::Gaps);
            [4.0; CLASSES]
        }
    };
    model
}

/// Nodes of the grid among the points, spread over the samples.
fn nodes_of(indices: &[PointIndex]) -> Vec<(usize, [f64; 2])> {
    let mut nodes = Vec::new();
    for (sample, index) in indices.iter().enumerate() {
        let mut of_sample: Vec<[i64; 2]> = index
            .points()
            .iter()
            .map(|p| [0, 1].map(|i| (p.position_m[i] / NODE_M).floor() as i64))
            .collect();
        of_sample.sort_unstable();
        of_sample.dedup();
        nodes.extend(of_sample.into_iter().map(|at| (sample, at.map(|i| (i as f64 + 0.5) * NODE_M))));
    }
    let step = nodes.len().div_ceil(MOST_NODES).max(1);
    nodes.into_iter().step_by(step).collect()
}

/// Prior that explains the nodes best, with its log-likelihood.
fn prior_of(of_nodes: &[Vec<f64>]) -> (Vec<f64>, f64) {
    let n = TERRAIN_STEPS * NOISE_STEPS;
    let floor = SPREAD / n as f64;
    let mut prior = vec![1.0 / n as f64; n];
    for _ in 0..ITERATIONS {
        let mut sum = vec![0.0; n];
        for likelihood in of_nodes {
            for (sum, p) in sum.iter_mut().zip(posterior(&prior, likelihood)) {
                *sum += p;
            }
        }
        for (prior, sum) in prior.iter_mut().zip(&sum) {
            *prior = (1.0 - SPREAD) * sum / of_nodes.len() as f64 + floor;
        }
    }
    let evidence = of_nodes.iter().map(|likelihood| {
        let most = likelihood.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = prior.iter().zip(likelihood).map(|(p, l)| p * libm::exp(l - most)).sum();
        most + libm::log(sum.max(f64::MIN_POSITIVE))
    });
    let evidence = evidence.filter(|e| e.is_finite()).sum();
    (prior, evidence)
}

/// Roughness of 0.1 to 0.3 m at 1 m (Brownian), noise as the points say or 3 to 10 cm.
fn assumed_prior(typical_sd_m: f64) -> Vec<f64> {
    let [terrain, noise] = steps();
    let (low, high) = if typical_sd_m.is_finite() { (0.7, 1.5) } else { (0.03, 0.1) };
    let unit = if typical_sd_m.is_finite() { typical_sd_m } else { 1.0 };
    let mut prior: Vec<f64> = (0..TERRAIN_STEPS * NOISE_STEPS)
        .map(|k| {
            let (a, n) = (terrain[k / NOISE_STEPS].sqrt(), noise[k % NOISE_STEPS].sqrt() / unit);
            if (0.1..0.3).contains(&a) && (low..=high).contains(&n) { 1.0 } else { 1e-6 }
        })
        .collect();
    let sum: f64 = prior.iter().sum();
    prior.iter_mut().for_each(|p| *p /= sum);
    prior
}

/// SD of the height errors of strips from their differences, m; `None` if strips do not overlap.
fn strip_error(model: &TerrainModel, indices: &[PointIndex], nodes: &[(usize, [f64; 2])]) -> Option<f64> {
    let differences: Vec<(u16, u16, f64, f64)> = nodes
        .par_iter()
        .map_init(Scratch::default, |scratch, (sample, at)| {
            let index = &indices[*sample];
            let variances = model.variances_at(index, *at, -1.0, scratch);
            index.nearest(*at, 8, -1.0, NODE_M, &mut scratch.found);
            data_of(index, model.typical_sd_m, &scratch.found, &mut scratch.data);
            let mut strips = keep_frequent_strips(&mut scratch.data);
            strips.truncate(2);
            scratch.data.retain(|d| strips.contains(&d.strip));
            let least = strips.iter().map(|s| scratch.data.iter().filter(|d| d.strip == *s).count()).min();
            if strips.len() < 2 || least < Some(STRIP_POINTS) {
                return None;
            }
            strips.sort_unstable();
            let parts = Parts { strip: 0.0, ..model.parts(variances) };
            let found = scratch.kriging.predict(
                &mut scratch.data,
                model.smoothness,
                parts,
                Target::StripDifference,
                &strips,
            )?;
            Some((strips[0], strips[1], found.height_m, found.variance.terrain + found.variance.noise))
        })
        .flatten()
        .collect();
    let mut pairs: Vec<(u16, u16)> = differences.iter().map(|d| (d.0, d.1)).collect();
    pairs.sort_unstable();
    pairs.dedup();
    pairs.retain(|pair| differences.iter().filter(|d| (d.0, d.1) == *pair).count() >= 3);
    if pairs.is_empty() {
        return None;
    }
    let square_of = |pair: &(u16, u16)| {
        let (mut sum, mut weight) = (0.0, 0.0);
        for (_, _, difference, variance) in differences.iter().filter(|d| (d.0, d.1) == *pair) {
            let w = 1.0 / variance.max(1e-6);
            sum += w * (difference * difference - variance);
            weight += w;
        }
        sum / weight
    };
    let n = pairs.len() as f64;
    let variance = (0.5 * pairs.iter().map(square_of).sum::<f64>() / n).max(0.0);
    // Differences of pairs that share a strip are not independent.
    let shared = |a: &(u16, u16)| {
        pairs.iter().filter(|b| a.0 == b.0 || a.0 == b.1 || a.1 == b.0 || a.1 == b.1).count() - 1
    };
    let freedom = 4.0 * n * n / (4.0 * n + pairs.iter().map(shared).sum::<usize>() as f64);
    // Mean of the inverse gamma distribution with these degrees of freedom and those of the prior: a few strips that agree by
    // chance do not prove that their errors are small.
    Some((variance + 2.0 * TYPICAL_STRIP_M * TYPICAL_STRIP_M / freedom).sqrt())
}

/// Predicts points from others, with holes of several sizes around them.
fn left_out(model: &TerrainModel, indices: &[PointIndex], most_m: f64) -> Vec<LeftOut> {
    let mut chosen: Vec<(u64, usize, u32)> = Vec::new();
    for (sample, index) in indices.iter().enumerate() {
        let ends = |axis: usize| {
            let along = index.points().iter().map(|p| p.position_m[axis]);
            let (low, high) =
                along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
            let edge = EDGE_M.min(0.25 * (high - low));
            low + edge..=high - edge
        };
        let inner = [ends(0), ends(1)];
        let is_inner = |p: &CloudPoint| (0..2).all(|axis| inner[axis].contains(&p.position_m[axis]));
        let points = index.points().iter().enumerate().filter(|(_, p)| is_inner(p));
        chosen.extend(points.map(|(i, p)| (shuffled(p.position_m), sample, i as u32)));
    }
    let n = chosen.len();
    if n > MOST_POINTS {
        chosen.select_nth_unstable(MOST_POINTS);
        chosen.truncate(MOST_POINTS);
    }
    if n < NODE_POINTS {
        return Vec::new();
    }
    chosen.sort_unstable();
    chosen
        .par_iter()
        .map_init(Scratch::default, |scratch, (_, sample, i)| {
            let index = &indices[*sample];
            let point = index.points()[*i as usize];
            let at = [point.position_m[0], point.position_m[1]];
            let mut of_point = Vec::with_capacity(HOLES_M.len());
            for hole_m in HOLES_M {
                let variances = model.variances_at(index, at, hole_m, scratch);
                let parts = model.parts(variances);
                index.around(at, hole_m, most_m, &mut scratch.found);
                let Some(nearest) = scratch.found.first() else { break };
                let distance_m = nearest.distance_squared.sqrt();
                data_of(index, model.typical_sd_m, &scratch.found, &mut scratch.data);
                let Some(found) =
                    scratch.kriging.predict(&mut scratch.data, model.smoothness, parts, Target::Height, &[])
                else {
                    continue;
                };
                let relative = f64::from(point.height_sd_m) / model.typical_sd_m;
                let own = if relative.is_finite() { (relative * relative).clamp(0.1, 100.0) } else { 1.0 };
                let shared = scratch.kriging.weight_of(&scratch.data, point.strip);
                let strip = found.variance.strip + parts.strip * (1.0 - 2.0 * shared);
                of_point.push(LeftOut {
                    distance_m,
                    error_m: point.position_m[2] - found.height_m,
                    terrain: found.variance.terrain,
                    rest: found.variance.noise + strip.max(0.0) + parts.noise * own,
                });
                if hole_m == 0.0 {
                    let first = of_point[0];
                    let deviation = first.error_m / (first.terrain + first.rest).sqrt();
                    if !(WRONG[0]..WRONG[1]).contains(&deviation) {
                        return Vec::new();
                    }
                }
            }
            of_point
        })
        .flatten()
        .collect()
}

/// Mixes the bits of a position (SplitMix64): a choice of points that depends on nothing else.
fn shuffled(position_m: [f64; 3]) -> u64 {
    position_m.iter().fold(0u64, |state, x| {
        let mut z = (state ^ x.to_bits()).wrapping_add(0x9e37_79b9_7f4a_7c15);
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    })
}

/// Factors with which the mean squared deviation of each class of distances is 1.
fn gap_factors(left_out: &[LeftOut]) -> Option<[f64; CLASSES]> {
    let mut factors = [f64::NAN; CLASSES];
    for (class, factor) in factors.iter_mut().enumerate() {
        let of_class: Vec<&LeftOut> = left_out
            .iter()
            .filter(|l| DISTANCES_M.iter().filter(|limit| l.distance_m >= **limit).count() == class)
            .collect();
        if of_class.len() < FEWEST_POINTS {
            continue;
        }
        let excess = |factor: f64| {
            let squares = of_class.iter().map(|l| {
                (l.error_m * l.error_m / (factor * l.terrain + l.rest)).min(MOST_DEVIATION * MOST_DEVIATION)
            });
            squares.sum::<f64>() / of_class.len() as f64 - 1.0
        };
        let (mut low, mut high) = (0.05f64, 400.0f64);
        for _ in 0..40 {
            let middle = (low * high).sqrt();
            if excess(middle) > 0.0 { low = middle } else { high = middle }
        }
        // Where noise dominates, the points say little of the terrain between them.
        let share =
            of_class.iter().map(|l| l.terrain / (l.terrain + l.rest)).sum::<f64>() / of_class.len() as f64;
        *factor = libm::exp(share.sqrt() * libm::log(low));
    }
    let first = factors.iter().position(|f| f.is_finite())?;
    // Classes without points have the factor of the next nearer class, or of the first.
    for class in 0..CLASSES {
        if factors[class].is_nan() {
            factors[class] = if class < first { factors[first] } else { factors[class - 1].max(1.0) };
        }
    }
    Some(factors)
}
