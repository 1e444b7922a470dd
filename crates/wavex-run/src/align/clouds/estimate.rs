//! Estimation of the corrections of clouds, their SDs about the mean of all strips, and what is not determined.

use super::files::Clouds;
use super::frame::{scanner, trajectory};
use crate::Failure;
use wavex_align::adjust::{AlignSettings, align};
use wavex_align::estimable::EVIDENCE;
use wavex_align::parameters::{GLOBALS, GlobalPriors};
use wavex_align::result::Alignment;
use wavex_align::survey::{Installation, Strip, Survey};

/// Result of an alignment of clouds.
pub(super) struct CloudAlignment {
    pub(super) result: Alignment,
    /// Whether north, east, down of each strip are left alone because the overlaps do not determine them.
    pub(super) held: Vec<[bool; 3]>,
    /// SDs of the corrections at each knot of each strip: north, east, down, m, about the mean of the strips that are
    /// connected with it.
    pub(super) sds_m: Vec<Vec<[f64; 3]>>,
}

/// Estimates the corrections of all strips.
///
/// What the overlaps do not determine is left at 0, and the others are estimated again.
///
/// # Errors
/// Strips that do not overlap.
pub(super) fn estimate(
    clouds: &Clouds,
    settings: &AlignSettings,
    position_sd_m: f64,
) -> Result<CloudAlignment, Failure> {
    let mut held = vec![[false; 3]; clouds.strips.len()];
    let mut result = adjusted(clouds, settings, position_sd_m, &held)?;
    // Held components make others worse determined only if they were determined by them: few rounds.
    for _ in 0..MOST_ROUNDS {
        let relative = Relative::new(&result, settings, position_sd_m, &held);
        if !relative.hold(&mut held) {
            break;
        }
        result = adjusted(clouds, settings, position_sd_m, &held)?;
    }
    let sds_m = Relative::new(&result, settings, position_sd_m, &held).sds_m();
    Ok(CloudAlignment { result, held, sds_m })
}

/// Most estimations.
const MOST_ROUNDS: usize = 5;

fn adjusted(
    clouds: &Clouds,
    settings: &AlignSettings,
    position_sd_m: f64,
    held: &[[bool; 3]],
) -> Result<Alignment, Failure> {
    let failed = |error: &dyn std::fmt::Display| Failure::Run(error.to_string());
    let trajectories = clouds.strips.iter().zip(held).map(|(strip, held)| {
        trajectory(strip.span_s, held.map(|held| if held { 0.0 } else { position_sd_m }))
    });
    let trajectories: Vec<_> = trajectories.collect::<Result<_, _>>().map_err(|error| failed(&error))?;
    let strips: Vec<Strip> =
        (0..clouds.strips.len()).map(|trajectory| Strip { trajectory, installation: 0 }).collect();
    let survey = Survey {
        trajectories: &trajectories,
        installations: &[Installation { scanner: scanner(), priors: GlobalPriors([0.0; GLOBALS]) }],
        strips: &strips,
        patches: &clouds.patches,
        horizon: clouds.frame.horizon(),
    };
    align(&survey, settings).map_err(|error| failed(&error))
}

/// Variances of corrections about the mean of connected strips.
///
/// Pairs say nothing of a common shift of connected strips. Its information is that of the start values, `q` per component, and
/// the mean weighted by it has variance `1 / q` and is independent of the deviations from it: the variance of a
/// deviation is that of the correction less `1 / q`.
struct Relative<'a> {
    result: &'a Alignment,
    prior_variance: f64,
    held: Vec<[bool; 3]>,
    /// Variance of the mean of the strips that are connected with each strip, and their number, by component.
    mean: Vec<[(f64, usize); 3]>,
}

impl<'a> Relative<'a> {
    fn new(
        result: &'a Alignment,
        settings: &AlignSettings,
        position_sd_m: f64,
        held: &[[bool; 3]],
    ) -> Relative<'a> {
        let block = blocks(result);
        let [correlation_s, _] = settings.trajectory_priors.correlation_s;
        let prior_variance = position_sd_m * position_sd_m;
        let information: Vec<f64> = result
            .strips
            .iter()
            .map(|strip| {
                let knots = strip.corrections.as_ref().map_or(&[][..], |corrections| corrections.knots());
                let of_steps = knots.array_windows().map(|[before, after]| {
                    let rho = ((before.time_s - after.time_s) / correlation_s).exp();
                    (1.0 - rho) / (1.0 + rho)
                });
                (1.0 + of_steps.sum::<f64>()) / prior_variance
            })
            .collect();
        let mean = (0..block.len()).map(|strip| {
            core::array::from_fn(|component| {
                let others = (0..block.len())
                    .filter(|other| block[*other] == block[strip] && !held[*other][component]);
                let (sum, n) = others.fold((0.0, 0), |(sum, n), other| (sum + information[other], n + 1));
                (1.0 / sum, n)
            })
        });
        Relative { result, prior_variance, held: held.to_vec(), mean: mean.collect() }
    }

    /// Formal variance, and that from the scatter of tiles, at a knot.
    fn variances(&self, strip: usize, knot: usize, component: usize) -> [f64; 2] {
        let found = &self.result.strips[strip];
        let of_tiles = found.knot_jackknife_sds[knot][component].powi(2);
        let larger = found.knot_sds[knot][component].powi(2);
        let (of_mean, n) = self.mean[strip][component];
        // A strip alone has no deviation from the mean.
        let formal = if n > 1 { (larger - of_mean).max(0.0) } else { larger };
        [if larger > of_tiles { formal } else { 0.0 }, of_tiles]
    }

    /// Marks horizontal components that are not determined; returns whether there are new ones.
    fn hold(&self, held: &mut [[bool; 3]]) -> bool {
        let mut is_new = false;
        for (strip, (found, held)) in self.result.strips.iter().zip(held).enumerate() {
            for (component, is_held) in held.iter_mut().take(2).enumerate() {
                if *is_held || found.n_pairs == 0 {
                    continue;
                }
                let (of_mean, n) = self.mean[strip][component];
                let before = self.prior_variance - of_mean;
                let knots = 0..found.knot_sds.len();
                let variances = knots.map(|knot| self.variances(strip, knot, component)[0]);
                let least = variances.fold(f64::INFINITY, f64::min);
                if n < 2 || least > EVIDENCE * EVIDENCE * before {
                    *is_held = true;
                    is_new = true;
                }
            }
        }
        is_new
    }

    fn sds_m(&self) -> Vec<Vec<[f64; 3]>> {
        let of_strip = |strip: usize| {
            let sd = |knot, component| {
                let [formal, of_tiles] = self.variances(strip, knot, component);
                if self.held[strip][component] { 0.0 } else { formal.max(of_tiles).sqrt() }
            };
            let knots = 0..self.result.strips[strip].knot_sds.len();
            knots.map(|knot| core::array::from_fn(|component| sd(knot, component))).collect()
        };
        (0..self.result.strips.len()).map(of_strip).collect()
    }
}

/// Block of each strip: the lowest index of the strips that are connected with it by pairs.
fn blocks(result: &Alignment) -> Vec<usize> {
    let mut block: Vec<usize> = (0..result.strips.len()).collect();
    for overlap in result.overlaps.iter().filter(|overlap| overlap.n_pairs > overlap.n_rejected) {
        let [a, b] = overlap.strips.map(|strip| block[strip as usize]);
        let (from, to) = (a.max(b), a.min(b));
        block.iter_mut().filter(|own| **own == from).for_each(|own| *own = to);
    }
    block
}
