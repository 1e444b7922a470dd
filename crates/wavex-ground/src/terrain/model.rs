//! What the terrain and its points are like: learnt once for an area.

use super::kriging::{Datum, Kriging, Parts, Smoothness};
use super::neighbours::{Neighbour, PointIndex};

/// Spacing of the nodes at which roughness and noise are estimated, m.
pub(crate) const NODE_M: f64 = 8.0;
/// Farthest point that takes part in the estimate of a node, m.
pub(crate) const NODE_REACH_M: f64 = 20.0;
/// Points per octant for the estimate of a node.
const NODE_PER_OCTANT: usize = 6;
/// Fewest points for the estimate of a node.
pub(crate) const NODE_POINTS: usize = 12;
/// Most strips of which the points of a node are used.
const NODE_STRIPS: usize = 4;
/// Number of steps of the roughness.
pub(crate) const TERRAIN_STEPS: usize = 22;
/// Number of steps of the noise.
pub(crate) const NOISE_STEPS: usize = 14;
/// Smallest roughness (SD of the terrain at 1 m), m.
const LEAST_TERRAIN_M: f64 = 0.0005;
/// Smallest noise of a point, m.
const LEAST_NOISE_M: f64 = 0.003;
/// Limits of distances to the nearest point between classes, m.
pub(crate) const DISTANCES_M: [f64; 7] = [0.35, 0.7, 1.4, 2.8, 5.6, 11.2, 22.4];
/// Number of classes of distance.
pub(crate) const CLASSES: usize = DISTANCES_M.len() + 1;

/// What the SDs of points include.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PointSds {
    /// Everything, with the error that the points of a strip share.
    Total,
    /// Only what is independent from point to point, such as the noise of ranges.
    Own,
}

/// What was assumed because the data did not determine it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Assumption {
    /// Too few ground points to learn roughness and noise.
    Roughness,
    /// No overlapping strips and no total SDs of the points: the error of a strip is assumed.
    StripError,
    /// Too few points to verify the SDs by points left out.
    Gaps,
}

impl std::fmt::Display for Assumption {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Assumption::Roughness => {
                "too few ground points to learn the roughness of the terrain: standard deviations are assumed, and large"
            }
            Assumption::StripError => {
                "the height error that all points of a strip share is assumed to be 5 cm: no strips overlap, and \
                 points have no total uncertainty"
            }
            Assumption::Gaps => {
                "too few ground points to verify standard deviations by points left out: they are doubled in gaps"
            }
        })
    }
}

/// Terrain and noise of an area.
#[derive(Clone, Debug, PartialEq)]
pub struct TerrainModel {
    /// Generalised covariance of the terrain.
    pub smoothness: Smoothness,
    /// Probabilities of roughness and noise, by `TERRAIN_STEPS` and `NOISE_STEPS`.
    pub(crate) prior: Vec<f64>,
    /// Ratio of the variance of terrain between points to that of the covariance, by distance to the nearest point.
    pub(crate) gap_factor: [f64; CLASSES],
    /// SD of the height error that the points of a strip share, m.
    pub strip_sd_m: f64,
    /// Typical SD of points, the unit of their noise, m; NaN if points have none.
    pub(crate) typical_sd_m: f64,
    /// What was assumed.
    pub assumptions: Vec<Assumption>,
}

/// Variances by step of roughness and noise, m².
pub(crate) fn steps() -> [Vec<f64>; 2] {
    let series = |least: f64, n: usize| (0..n).map(|i| least * least * libm::exp2(i as f64)).collect();
    [series(LEAST_TERRAIN_M, TERRAIN_STEPS), series(LEAST_NOISE_M, NOISE_STEPS)]
}

/// Work space of estimates.
#[derive(Debug, Default)]
pub(crate) struct Scratch {
    pub(crate) kriging: Kriging,
    pub(crate) found: Vec<Neighbour>,
    pub(crate) data: Vec<Datum>,
    pub(crate) likelihood: Vec<f64>,
}

/// Converts the points found to data.
pub(crate) fn data_of(index: &PointIndex, typical_sd_m: f64, found: &[Neighbour], data: &mut Vec<Datum>) {
    data.clear();
    data.extend(found.iter().map(|n| {
        let point = &index.points()[n.index as usize];
        let relative = f64::from(point.height_sd_m) / typical_sd_m;
        let noise = if relative.is_finite() && relative > 0.0 {
            (relative * relative).clamp(0.1, 100.0)
        } else {
            1.0
        };
        Datum { offset_m: n.offset_m, height_m: point.position_m[2], noise, strip: point.strip }
    }));
}

/// Keeps the points of the most frequent strips, which are returned, most frequent first.
pub(crate) fn keep_frequent_strips(data: &mut Vec<Datum>) -> Vec<u16> {
    let mut strips: Vec<(usize, u16)> = Vec::new();
    for d in data.iter() {
        match strips.iter_mut().find(|(_, strip)| *strip == d.strip) {
            Some((n, _)) => *n += 1,
            None => strips.push((1, d.strip)),
        }
    }
    strips.sort_unstable_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    strips.truncate(NODE_STRIPS);
    let strips: Vec<u16> = strips.iter().filter(|(n, _)| *n >= 2).map(|(_, strip)| *strip).collect();
    data.retain(|d| strips.contains(&d.strip));
    strips
}

impl Scratch {
    /// Log-likelihoods of roughness and noise around a position; false if there are too few points.
    pub(crate) fn likelihood_at(
        &mut self,
        index: &PointIndex,
        at: [f64; 2],
        hole_m: f64,
        smoothness: Smoothness,
        typical_sd_m: f64,
    ) -> bool {
        index.nearest(at, NODE_PER_OCTANT, hole_m, NODE_REACH_M, &mut self.found);
        if self.found.len() < NODE_POINTS {
            return false;
        }
        data_of(index, typical_sd_m, &self.found, &mut self.data);
        let strips = keep_frequent_strips(&mut self.data);
        let [terrain, noise] = steps();
        self.kriging.likelihood(&self.data, smoothness, &strips, [&terrain, &noise], &mut self.likelihood) > 0
    }
}

impl TerrainModel {
    /// Variances of terrain and noise around a position, m².
    pub(crate) fn variances_at(
        &self,
        index: &PointIndex,
        at: [f64; 2],
        hole_m: f64,
        scratch: &mut Scratch,
    ) -> [f64; 2] {
        if !scratch.likelihood_at(index, at, hole_m, self.smoothness, self.typical_sd_m) {
            scratch.likelihood.clear();
            scratch.likelihood.resize(self.prior.len(), 0.0);
        }
        let [terrain, noise] = steps();
        let posterior = posterior(&self.prior, &scratch.likelihood);
        let mut mean = [0.0; 2];
        for (k, weight) in posterior.iter().enumerate() {
            mean[0] += weight * terrain[k / NOISE_STEPS];
            mean[1] += weight * noise[k % NOISE_STEPS];
        }
        mean
    }

    /// Variances for predictions, with the error of strips, m².
    pub(crate) fn parts(&self, [terrain, noise]: [f64; 2]) -> Parts {
        Parts { terrain, noise, strip: self.strip_sd_m * self.strip_sd_m }
    }

    /// Variance of a height from its parts and the distance to the nearest point, m².
    pub(crate) fn total(&self, parts: Parts, distance_m: f64) -> f64 {
        parts.noise + parts.strip + parts.terrain * self.factor_at(distance_m)
    }

    /// Gap factor, interpolated over the logarithm of the distance between the middles of classes.
    fn factor_at(&self, distance_m: f64) -> f64 {
        let first = DISTANCES_M[0] / std::f64::consts::SQRT_2;
        let at = (libm::log2(distance_m.max(first) / first)).min((CLASSES - 1) as f64);
        let i = (at as usize).min(CLASSES - 2);
        let part = at - i as f64;
        self.gap_factor[i] * (1.0 - part) + self.gap_factor[i + 1] * part
    }
}

/// Probabilities from prior probabilities and log-likelihoods.
pub(crate) fn posterior(prior: &[f64], likelihood: &[f64]) -> Vec<f64> {
    let most = likelihood.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if most == f64::NEG_INFINITY {
        return prior.to_vec();
    }
    let mut weights: Vec<f64> = prior.iter().zip(likelihood).map(|(p, l)| p * libm::exp(l - most)).collect();
    let sum: f64 = weights.iter().sum();
    if sum <= 0.0 {
        return prior.to_vec();
    }
    weights.iter_mut().for_each(|w| *w /= sum);
    weights
}

impl std::fmt::Display for TerrainModel {
    /// Roughness and noise as medians, and the factors of gaps.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let median = |step: &dyn Fn(usize) -> usize, n: usize| {
            let mut sum = 0.0;
            (0..n)
                .find(|i| {
                    sum +=
                        (0..self.prior.len()).filter(|k| step(*k) == *i).map(|k| self.prior[k]).sum::<f64>();
                    sum >= 0.5
                })
                .unwrap_or(0)
        };
        let [terrain, noise] = steps();
        let roughness = terrain[median(&|k| k / NOISE_STEPS, TERRAIN_STEPS)].sqrt();
        let noise = noise[median(&|k| k % NOISE_STEPS, NOISE_STEPS)].sqrt();
        write!(
            f,
            "{:?} terrain, roughness {roughness:.4} m, noise of points {noise:.3} m, error of strips {:.3} m, factors",
            self.smoothness, self.strip_sd_m
        )?;
        self.gap_factor.iter().try_for_each(|factor| write!(f, " {factor:.2}"))
    }
}
