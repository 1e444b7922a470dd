//! Relative gain and delay of two receivers that record the same echoes.
//!
//! Both are estimated from plain peaks. [`JointFit`] fits one receiver's samples with prior
//! knowledge of the pulses from the other. See docs/explanation/fusion.md. The sensitive
//! receiver is *low power*, the one for strong echoes *high power*.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::decompose::OVERDRIVEN_PART;
use crate::sensor_model::{ChannelModel, ModelError};
pub use joint::{Expected, JointFit, JointFitted, JointOutcome, JointPulse};
pub(crate) use plain_peak::plain_peak_of;
pub use plain_peak::{PlainPeak, lead_noise_sd_dn, peak_above_half, plain_peak};
pub use proof::{FusionProof, prove};
use robust::{pooled, robust_mean};

mod joint;
mod plain_peak;
mod proof;
mod robust;
#[cfg(test)]
mod tests;

/// Fewest pairs for an estimate of gain and delay.
pub const MIN_PAIRS: usize = 20;
/// Smallest SNR of echoes in the high-power receiver.
const LEAST_SNR: f64 = 8.0;
/// Largest number of delay nodes for the overdriven receiver.
const WALK_NODES: usize = 4;
/// Significance threshold of a change of delay with height, or of gain between weaker and stronger
/// echoes, in standard deviations.
const SIGNIFICANT_SD: f64 = 4.0;
/// If the gain changes with height, its standard deviation is this many times the change, because
/// stronger echoes are extrapolated.
const EXTRAPOLATION: f64 = 3.0;
/// Peak offset uncertainty, in pulse widths, if only one response is known.
const UNKNOWN_RESPONSE_WIDTHS: f64 = 0.02;
/// Number of sample phases averaged for a model's plain peak.
const PHASES: u32 = 16;
/// Length of the block for a model's plain peak, and position of its pulse, samples.
const MODEL_SAMPLES: usize = 64;
const MODEL_PLACE: f64 = 24.0;

/// Plain peaks of one unsaturated echo in both receivers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// Height above the background in the low-power receiver, DN.
    pub low_power_dn: f64,
    /// Height above the background in the high-power receiver, DN.
    pub high_power_dn: f64,
    /// Delay of the high-power receiver, ns.
    pub delay_ns: f64,
}

/// Gain ratio and delay of the two receivers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ChannelFusion {
    /// Number of echoes used; 0 if all values were given.
    pub pairs: u64,
    /// Height of an echo in the low-power receiver over the high-power one.
    pub gain_ratio: f64,
    /// Standard deviation of `gain_ratio`, including its change with the height of the echo.
    pub gain_ratio_sd: f64,
    /// Delay of the high-power receiver relative to the low-power one, ns.
    pub delay_ns: f64,
    /// Standard deviation of `delay_ns`, ns.
    pub delay_sd_ns: f64,
    /// Delay by ascending height where the low-power receiver is overdriven.
    ///
    /// Empty if it does not change, or is not known.
    pub walk: Vec<WalkNode>,
    /// Whether enough echoes overdrive the low-power receiver to know whether the delay changes.
    #[serde(default)]
    pub walk_is_known: bool,
}

/// Delay at one height.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WalkNode {
    /// Height above the background in the low-power receiver, DN.
    pub low_power_dn: f64,
    /// Delay of the high-power receiver, ns.
    pub delay_ns: f64,
    /// Standard deviation of the delay, ns.
    pub delay_sd_ns: f64,
}

/// Estimates gain and delay of two receivers from common echoes.
///
/// Both are robust weighted means.
///
/// The delay is from echoes that do not overdrive the low-power receiver, whose range ends at
/// `full_scale_dn`. The ratio of heights has the weights of a regression through the origin.
/// `high_noise_dn` is the noise of the high-power receiver. `None` for fewer than [`MIN_PAIRS`]
/// sufficiently strong echoes.
pub fn estimate(pairs: &[Pair], full_scale_dn: f64, high_noise_dn: f64) -> Option<ChannelFusion> {
    let overdriven_dn = OVERDRIVEN_PART * full_scale_dn;
    let (mut linear, mut overdriven) = strong_pairs(pairs, full_scale_dn, high_noise_dn)?;
    if linear.len() < MIN_PAIRS {
        return None;
    }
    linear.sort_by(|a, b| a.low_power_dn.total_cmp(&b.low_power_dn));
    overdriven.sort_by(|a, b| a.low_power_dn.total_cmp(&b.low_power_dn));
    let (ratio, ratio_sd) = ratio(&linear);
    let (weaker, stronger) = linear.split_at(linear.len() / 2);
    let (below, above) = (self::ratio(weaker), self::ratio(stronger));
    let change = (above.0 - below.0).abs();
    let is_change = change > SIGNIFICANT_SD * below.1.hypot(above.1);
    let relative_sd = (ratio_sd / ratio).hypot(if is_change { EXTRAPOLATION * change / ratio } else { 0.0 });
    let (delay_ns, delay_sd_ns) = delay(&linear);
    let base = WalkNode { low_power_dn: overdriven_dn, delay_ns, delay_sd_ns };
    Some(ChannelFusion {
        pairs: linear.len() as u64,
        gain_ratio: 1.0 / ratio,
        gain_ratio_sd: relative_sd / ratio,
        delay_ns,
        delay_sd_ns,
        walk: walk(base, weight(&linear), &overdriven),
        walk_is_known: overdriven.len() >= MIN_PAIRS,
    })
}

/// Sufficiently strong pairs in their order: those that do not overdrive the low-power receiver, and
/// those that do; `None` without pairs.
fn strong_pairs(pairs: &[Pair], full_scale_dn: f64, high_noise_dn: f64) -> Option<(Vec<Pair>, Vec<Pair>)> {
    // Selection by the low-power height avoids a bias from the noise of the high-power receiver.
    let least_dn = LEAST_SNR * high_noise_dn / rough_ratio(pairs)?;
    let strong = pairs.iter().filter(|pair| pair.low_power_dn >= least_dn);
    Some(strong.partition(|pair| pair.low_power_dn < OVERDRIVEN_PART * full_scale_dn))
}

/// Median ratio of the heights; `None` without pairs.
fn rough_ratio(pairs: &[Pair]) -> Option<f64> {
    let mut ratios: Vec<f64> = pairs.iter().map(|pair| pair.high_power_dn / pair.low_power_dn).collect();
    let middle = ratios.len() / 2;
    let median = *ratios
        .get_mut(..)?
        .select_nth_unstable_by(middle.min(pairs.len().checked_sub(1)?), f64::total_cmp)
        .1;
    (median > 0.0).then_some(median)
}

/// Height in the high-power receiver over that in the other, and its standard deviation.
///
/// The noise of the high-power receiver dominates and is the same for all echoes, so a line through
/// the origin has weights proportional to the squared height.
fn ratio(pairs: &[Pair]) -> (f64, f64) {
    robust_mean(pairs.iter().map(|pair| (pair.high_power_dn / pair.low_power_dn, pair.low_power_dn.powi(2))))
}

/// Delay and its standard deviation; positions of higher peaks are more accurate.
fn delay(pairs: &[Pair]) -> (f64, f64) {
    robust_mean(pairs.iter().map(|pair| (pair.delay_ns, pair.low_power_dn.powi(2))))
}

/// Sum of the weights.
fn weight(pairs: &[Pair]) -> f64 {
    pairs.iter().map(|pair| pair.low_power_dn.powi(2)).sum()
}

/// Delay by height, beginning with `base` of weight `base_weight`; empty if it does not change.
fn walk(base: WalkNode, base_weight: f64, overdriven: &[Pair]) -> Vec<WalkNode> {
    let nodes = walk_nodes(base, base_weight, overdriven, MIN_PAIRS);
    let change = |node: &WalkNode| (node.delay_ns - base.delay_ns).abs();
    let is_change =
        |node: &WalkNode| change(node) > SIGNIFICANT_SD * node.delay_sd_ns.hypot(base.delay_sd_ns);
    if !nodes.iter().any(is_change) {
        return Vec::new();
    }
    monotone(base, nodes)
}

/// Mean delays of up to four ranges of height, after `base`; empty with fewer than `least_pairs`.
fn walk_nodes(base: WalkNode, base_weight: f64, overdriven: &[Pair], least_pairs: usize) -> Vec<WalkNode> {
    let nodes = (overdriven.len() / least_pairs).min(WALK_NODES);
    if nodes == 0 {
        return Vec::new();
    }
    let bins = overdriven.chunks(overdriven.len().div_ceil(nodes));
    let mut found = vec![base];
    found.extend(bins.map(|bin| {
        let (delay_ns, own_sd_ns) = delay(bin);
        // A few values may agree by chance: their SD is at least that expected from their weight.
        let delay_sd_ns = own_sd_ns.max(base.delay_sd_ns * (base_weight / weight(bin)).sqrt());
        let low_power_dn = bin.iter().map(|pair| pair.low_power_dn).sum::<f64>() / bin.len() as f64;
        WalkNode { low_power_dn, delay_ns, delay_sd_ns }
    }));
    found
}

/// Pools neighbours that violate the common direction of the delays.
fn monotone(base: WalkNode, mut nodes: Vec<WalkNode>) -> Vec<WalkNode> {
    let sign = nodes.iter().map(|node| node.delay_ns - base.delay_ns).sum::<f64>().signum();
    let pooled =
        pooled(&nodes.iter().map(|node| (sign * node.delay_ns, node.delay_sd_ns)).collect::<Vec<_>>());
    nodes.iter_mut().zip(pooled).for_each(|(node, delay_ns)| node.delay_ns = sign * delay_ns);
    nodes
}

impl ChannelFusion {
    /// Removes the delay and the walk that are not proven; their values enter the standard
    /// deviations.
    pub fn keep_proven(&mut self, proof: &FusionProof) {
        if !FusionProof::is_proven(proof.delay_falls) {
            let delay_ns = std::mem::take(&mut self.delay_ns);
            self.delay_sd_ns = self.delay_sd_ns.hypot(delay_ns);
            self.walk.iter_mut().for_each(|node| node.delay_ns -= delay_ns);
        }
        if proof.walk_falls.is_some_and(|falls| !FusionProof::is_proven(falls)) {
            for node in &mut self.walk {
                node.delay_sd_ns = node.delay_sd_ns.hypot(node.delay_ns - self.delay_ns);
                node.delay_ns = self.delay_ns;
            }
        }
    }

    /// Change of the delay with height relative to `delay_ns`, and its standard deviation, ns.
    ///
    /// `low_power_dn` is the height in the low-power receiver. Linear between the nodes; constant
    /// above the last, with the whole change as uncertainty.
    pub fn walk_ns(&self, low_power_dn: f64) -> (f64, f64) {
        let after = self.walk.partition_point(|node| node.low_power_dn <= low_power_dn);
        let Some(before) = after.checked_sub(1).and_then(|before| self.walk.get(before)) else {
            return (0.0, 0.0);
        };
        let change = |delay_ns: f64| delay_ns - self.delay_ns;
        match self.walk.get(after) {
            None => (change(before.delay_ns), before.delay_sd_ns.hypot(change(before.delay_ns))),
            Some(next) => {
                let part = (low_power_dn - before.low_power_dn) / (next.low_power_dn - before.low_power_dn);
                let between = |a: f64, b: f64| a + part * (b - a);
                (
                    change(between(before.delay_ns, next.delay_ns)),
                    between(before.delay_sd_ns, next.delay_sd_ns),
                )
            }
        }
    }

    /// Gain and delay between the receivers at other gains.
    ///
    /// For pulse heights as recorded. `low` and `high` are the gains of the two receivers.
    pub fn at_gains(&self, low: f64, high: f64) -> ChannelFusion {
        let factor = low / high;
        let mut fusion = self.clone();
        fusion.gain_ratio *= factor;
        fusion.gain_ratio_sd *= factor;
        fusion
    }

    /// Gain and delay between pulses fitted with these models, corrected for the models' own plain
    /// peaks.
    ///
    /// # Errors
    /// Fails if a model describes no channel.
    pub fn between_models(
        &self,
        low: &ChannelModel,
        high: &ChannelModel,
    ) -> Result<ChannelFusion, ModelError> {
        let height_dn = 0.5 * low.full_scale_dn;
        let (low_shift_ns, low_ratio) = plain_of_model(low, height_dn)?;
        let (high_shift_ns, high_ratio) = plain_of_model(high, height_dn / self.gain_ratio)?;
        let shift_ns = low_shift_ns - high_shift_ns;
        let factor = high_ratio / low_ratio;
        let is_own =
            |model: &ChannelModel| model.response.as_ref().is_some_and(|response| response.echoes > 0);
        let alike = is_own(low) == is_own(high);
        let unknown_ns = if alike { 0.0 } else { UNKNOWN_RESPONSE_WIDTHS * low.pulse_fwhm_ns };
        let mut fusion = self.clone();
        fusion.gain_ratio *= factor;
        fusion.gain_ratio_sd *= factor;
        fusion.delay_ns += shift_ns;
        fusion.delay_sd_ns = fusion.delay_sd_ns.hypot(unknown_ns);
        fusion.walk.iter_mut().for_each(|node| node.delay_ns += shift_ns);
        Ok(fusion)
    }
}

/// Plain peak of a model's pulse of this height: offset from its position, ns, and relative height.
fn plain_of_model(model: &ChannelModel, height_dn: f64) -> Result<(f64, f64), ModelError> {
    let shape = crate::shape::Shape::of(model)?;
    let (mut shift_samples, mut ratio) = (0.0, 0.0);
    // The bias of the parabola depends on the sampling phase, so its mean counts.
    for phase in 0..PHASES {
        let mut signal = [0.0; MODEL_SAMPLES];
        let position_samples = MODEL_PLACE + f64::from(phase) / f64::from(PHASES);
        let pulse =
            crate::shape::Pulse { height_dn, position_samples, ln_width_ratio: 0.0, ln_width_precision: 0.0 };
        shape.add(&pulse, 1.0, &mut signal);
        // A pulse too long for the block has no plain peak; its position is used.
        if let Some(peak) = plain_peak_of(&signal) {
            shift_samples += peak.position_samples - position_samples;
            ratio += peak.height_dn / height_dn - 1.0;
        }
    }
    let phases = f64::from(PHASES);
    Ok((shift_samples / phases * model.sampling_interval_ns, 1.0 + ratio / phases))
}
