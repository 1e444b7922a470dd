//! Proof of gain, delay and walk of two receivers on echoes that did not make them.

use super::{
    ChannelFusion, MIN_PAIRS, Pair, WalkNode, delay, monotone, ratio, strong_pairs, walk_nodes, weight,
};
use crate::decompose::OVERDRIVEN_PART;

/// Number of stretches of the recording; even ones are one half, odd ones the other.
const STRETCHES: usize = 20;
/// Smallest fall of squared differences, in standard deviations of its jackknife over stretches.
const LEAST_SD: f64 = 3.0;
/// Differences count up to this many times their median, so that outliers do not decide.
const BOUND_MEDIANS: f64 = 6.0;

/// What the estimates of one half do to the other half.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FusionProof {
    /// Falls of the squared differences of heights and of times, both ways, in standard deviations.
    pub gain_falls: [f64; 2],
    /// See `gain_falls`.
    pub delay_falls: [f64; 2],
    /// The same for the walk of the overdriven receiver; `None` without a walk.
    pub walk_falls: Option<[f64; 2]>,
}

impl FusionProof {
    /// Whether a quantity helps both halves.
    pub fn is_proven(falls: [f64; 2]) -> bool {
        falls.iter().all(|fall| *fall >= LEAST_SD)
    }
}

/// Halves of a recording, of pairs with their stretch.
struct ProofHalves([Vec<(usize, Pair)>; 2]);

impl ProofHalves {
    fn of(pairs: &[Pair]) -> ProofHalves {
        let stretch = |i: usize| i * STRETCHES / pairs.len().max(1);
        let half = |of: usize| {
            let of_half = pairs.iter().enumerate().filter(|(i, _)| stretch(*i) % 2 == of);
            of_half.map(|(i, pair)| (stretch(i), *pair)).collect()
        };
        ProofHalves([half(0), half(1)])
    }

    /// Falls of squared differences `without` to those `with` what the other half shows.
    ///
    /// Differences are in units of their standard deviation, up to a common factor.
    fn falls<T>(
        &self,
        learn: impl Fn(&[Pair]) -> T,
        without: impl Fn(&Pair) -> f64,
        with: impl Fn(&T, &Pair) -> f64,
    ) -> [f64; 2] {
        [0, 1].map(|half| {
            let other: Vec<Pair> = self.0[1 - half].iter().map(|(_, pair)| *pair).collect();
            let learnt = learn(&other);
            let mut sizes: Vec<f64> =
                self.0[half].iter().map(|(_, pair)| with(&learnt, pair).abs()).collect();
            let bound = match sizes.len() / 2 {
                0 => f64::INFINITY,
                middle => BOUND_MEDIANS * *sizes.select_nth_unstable_by(middle, f64::total_cmp).1,
            };
            // Residuals without scatter have no bound.
            let bound = if bound > 0.0 { bound } else { f64::INFINITY };
            let mut sums = [None; STRETCHES];
            for (stretch, pair) in &self.0[half] {
                let [without, with] =
                    [without(pair), with(&learnt, pair)].map(|x| x.abs().min(bound).powi(2));
                *sums[*stretch].get_or_insert(0.0) += without - with;
            }
            in_standard_deviations(&sums.into_iter().flatten().collect::<Vec<f64>>())
        })
    }
}

/// Sum of independent values over its standard deviation by their scatter.
fn in_standard_deviations(values: &[f64]) -> f64 {
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    match mean / (variance / count).sqrt() {
        ratio if ratio.is_nan() => 0.0,
        ratio => ratio,
    }
}

/// Proves the estimates of [`super::estimate`] from the same pairs, in the order of the recording.
pub fn prove(fusion: &ChannelFusion, pairs: &[Pair], full_scale_dn: f64, high_noise_dn: f64) -> FusionProof {
    let (linear, overdriven) = strong_pairs(pairs, full_scale_dn, high_noise_dn).unwrap_or_default();
    let halves = ProofHalves::of(&linear);
    // The noise of the high-power receiver is the same for all heights.
    let gain_falls = halves.falls(
        |pairs| ratio(pairs).0,
        |pair| pair.high_power_dn - pair.low_power_dn,
        |ratio, pair| pair.high_power_dn - ratio * pair.low_power_dn,
    );
    // Positions of higher peaks are more accurate.
    let delay_falls = halves.falls(
        |pairs| delay(pairs).0,
        |pair| pair.low_power_dn * pair.delay_ns,
        |delay_ns, pair| pair.low_power_dn * (pair.delay_ns - delay_ns),
    );
    let base = WalkNode {
        low_power_dn: OVERDRIVEN_PART * full_scale_dn,
        delay_ns: fusion.delay_ns,
        delay_sd_ns: fusion.delay_sd_ns,
    };
    let of_half = |half: &[Pair]| {
        let mut half = half.to_vec();
        half.sort_by(|a, b| a.low_power_dn.total_cmp(&b.low_power_dn));
        let nodes = walk_nodes(base, weight(&linear), &half, MIN_PAIRS / 2);
        ChannelFusion { walk: monotone(base, nodes), ..fusion.clone() }
    };
    let walk_falls = (!fusion.walk.is_empty()).then(|| {
        ProofHalves::of(&overdriven).falls(
            of_half,
            |pair| pair.low_power_dn * (pair.delay_ns - fusion.delay_ns),
            |half, pair| {
                pair.low_power_dn * (pair.delay_ns - fusion.delay_ns - half.walk_ns(pair.low_power_dn).0)
            },
        )
    });
    FusionProof { gain_falls, delay_falls, walk_falls }
}
