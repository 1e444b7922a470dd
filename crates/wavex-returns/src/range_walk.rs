//! Range walk: delay of a receiver that depends on the amplitude of the echo.
//!
//! It is learnt from geometry alone. Three neighbouring single echoes on a smooth surface have a
//! small second difference of their times of flight; if their amplitudes differ, the walk enters it
//! with known factors. A surface whose height follows its reflectance imitates a walk, so a walk is
//! used only if it proves itself on echoes that did not make it (docs/explanation/corrections.md,
//! Range walk).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

mod learn;
mod proof;
mod row;
mod stretches;
#[cfg(test)]
mod tests;

pub use proof::{MeasuredDelay, Proof, Refusal};

/// Fewest triples to learn from.
pub const LEAST_TRIPLES: usize = 1000;
/// A walk is applied in full from this many of its standard deviations, and not at all from
/// [`NOT_APPLIED_SD`] down.
const APPLIED_SD: f64 = 4.0;
/// See [`APPLIED_SD`].
const NOT_APPLIED_SD: f64 = 3.0;
/// Largest plausible delay, ns (150 m).
const MOST_DELAY_NS: f64 = 1000.0;
/// Relative step for the slope.
const SLOPE_STEP: f64 = 0.005;

/// Delay of a receiver by amplitude, relative to that at a reference amplitude.
///
/// Linear in the logarithm of the amplitude between the nodes, constant beyond them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RangeWalk {
    /// Amplitude without delay, DN; positive.
    pub reference_dn: f64,
    /// Smallest and largest amplitude from which it was learnt, DN.
    pub amplitudes_dn: [f64; 2],
    /// Delays by ascending amplitude; they extend beyond `amplitudes_dn`, to where the prior begins.
    pub nodes: Vec<DelayNode>,
    /// Number of triples of echoes from which it was learnt.
    pub triples: u64,
}

/// Delay at one amplitude.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DelayNode {
    /// Amplitude, DN; positive.
    pub amplitude_dn: f64,
    /// Delay, ns.
    pub late_ns: f64,
    /// Standard deviation of the delay, ns.
    pub late_sd_ns: f64,
}

/// Correction for one echo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct WalkCorrection {
    /// Delay to subtract, ns.
    pub late_ns: f64,
    /// Standard deviation of the remaining delay, ns.
    pub remaining_sd_ns: f64,
}

/// A single echo.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SingleEcho {
    /// Time of flight, ns.
    pub flight_ns: f64,
    /// Standard deviation of `flight_ns`.
    pub flight_sd_ns: f64,
    /// Amplitude in the receiver, DN; positive.
    pub amplitude_dn: f64,
}

/// Single echoes of three consecutive shots.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triple {
    /// The echoes in the order of the shots.
    pub echoes: [SingleEcho; 3],
    /// Number of the middle shot; consecutive along a scan line, and at least 100 apart between lines.
    pub shot: u64,
}

/// A walk learnt from a recording, and whether it proved itself there.
#[derive(Clone, Debug, PartialEq)]
pub struct LearntWalk {
    /// The walk.
    pub walk: RangeWalk,
    /// Figures of the proof.
    pub proof: Proof,
}

/// Reason why no walk can be learnt.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoWalk {
    /// The recording has too few triples of single echoes.
    #[error("{0} triples of neighbouring single echoes, {LEAST_TRIPLES} needed")]
    TooFew(usize),
    /// The echoes have one amplitude, so that nothing determines the walk.
    #[error("the amplitudes of neighbouring single echoes do not differ enough")]
    OneAmplitude,
}

impl RangeWalk {
    /// Learns the walk of a receiver from triples in the order of the recording.
    ///
    /// `prior` is the walk expected before, zero without one. [`LearntWalk::proof`] says whether
    /// the walk may be used.
    ///
    /// # Errors
    /// [`NoWalk`] says what the recording lacks.
    pub fn learn(triples: &[Triple], prior: Option<&RangeWalk>) -> Result<LearntWalk, NoWalk> {
        learn::learn(triples, prior)
    }

    /// Delay of an echo of this amplitude, ns, and its standard deviation; 0 if it is not positive.
    pub fn late_ns(&self, amplitude_dn: f64) -> (f64, f64) {
        let after = self.nodes.partition_point(|node| node.amplitude_dn <= amplitude_dn);
        let before = after.checked_sub(1).and_then(|before| self.nodes.get(before));
        match (before, self.nodes.get(after)) {
            _ if amplitude_dn.is_nan() || amplitude_dn <= 0.0 => (0.0, 0.0),
            (Some(a), Some(b)) => {
                let part = (amplitude_dn / a.amplitude_dn).ln() / (b.amplitude_dn / a.amplitude_dn).ln();
                let between = |a: f64, b: f64| a + part * (b - a);
                (between(a.late_ns, b.late_ns), between(a.late_sd_ns, b.late_sd_ns))
            }
            (Some(node), None) | (None, Some(node)) => (node.late_ns, node.late_sd_ns),
            (None, None) => (0.0, 0.0),
        }
    }

    /// Correction of an echo of this amplitude.
    ///
    /// The delay is subtracted in full where it exceeds four of its standard deviations, not at all
    /// below three, and by a part that rises linearly between. What is not subtracted enters the
    /// standard deviation.
    pub fn correction(&self, amplitude_dn: f64) -> WalkCorrection {
        let (late_ns, sd_ns) = self.late_ns(amplitude_dn);
        let ratio = late_ns.abs() / sd_ns.max(f64::MIN_POSITIVE);
        let part = ((ratio - NOT_APPLIED_SD) / (APPLIED_SD - NOT_APPLIED_SD)).clamp(0.0, 1.0);
        WalkCorrection { late_ns: part * late_ns, remaining_sd_ns: sd_ns.hypot((1.0 - part) * late_ns) }
    }

    /// Whether any amplitude from which it was learnt has a correction.
    pub fn is_seen(&self) -> bool {
        let [least_dn, most_dn] = self.amplitudes_dn;
        let is_within = |node: &&DelayNode| (least_dn..=most_dn).contains(&node.amplitude_dn);
        self.nodes.iter().filter(is_within).any(|node| self.correction(node.amplitude_dn).late_ns != 0.0)
    }

    /// Standard deviation of an echo's delay if the walk is possible, but not applied, ns.
    ///
    /// Constant beyond the amplitudes from which it was learnt.
    pub fn not_applied_sd_ns(&self, amplitude_dn: f64) -> f64 {
        let [least_dn, most_dn] = self.amplitudes_dn;
        let (late_ns, sd_ns) = self.late_ns(amplitude_dn.max(least_dn).min(most_dn));
        late_ns.hypot(sd_ns)
    }

    /// Change of the correction with the amplitude, ns/DN.
    pub fn slope_ns_per_dn(&self, amplitude_dn: f64) -> f64 {
        let [below_dn, above_dn] = [1.0 - SLOPE_STEP, 1.0 + SLOPE_STEP].map(|part| part * amplitude_dn);
        let slope =
            (self.correction(above_dn).late_ns - self.correction(below_dn).late_ns) / (above_dn - below_dn);
        if slope.is_finite() { slope } else { 0.0 }
    }

    /// Whether all numbers are usable.
    pub fn is_valid(&self) -> bool {
        let [least_dn, most_dn] = self.amplitudes_dn;
        // Bounds of plausible amplitudes, which also bound the number of nodes.
        let is_positive = |dn: f64| (1e-2..=1e7).contains(&dn);
        let is_delay = |ns: f64| ns.abs() <= MOST_DELAY_NS;
        let is_node = |node: &DelayNode| {
            is_positive(node.amplitude_dn)
                && is_delay(node.late_ns)
                && is_delay(node.late_sd_ns)
                && node.late_sd_ns >= 0.0
        };
        [self.reference_dn, least_dn, most_dn].into_iter().all(is_positive)
            && least_dn <= most_dn
            && self.nodes.iter().all(is_node)
            && self.nodes.is_sorted_by(|a, b| a.amplitude_dn < b.amplitude_dn)
    }
}
