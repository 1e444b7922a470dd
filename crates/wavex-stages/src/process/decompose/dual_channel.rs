//! Combines the returns of two receivers (docs/explanation/fusion.md).

use std::collections::BTreeMap;

use super::echo::{FoundEcho, HighPowerView};
use super::shot::{BLINDED, ShotBlocks};
use wavex_line::scan_line::{Block, Channel, LineStats, ReturnChannel, flags};
use wavex_line::stage::{Reason, Result, StageError};
use wavex_signal::decompose::{DEVIANT, OVERDRIVEN_PART};
use wavex_signal::fusion::{ChannelFusion, Expected, JointFit, JointFitted, JointPulse};
use wavex_signal::gain::GainLevel;
use wavex_signal::sensor_model::SensorModel;

/// Largest distance of one echo in both receivers, standard deviations, at least one sample.
const SAME_SD: f64 = 3.0;
/// The same if the low-power receiver is saturated or overdriven, pulse widths.
const SAME_WIDTHS: f64 = 0.5;
/// Distance from a saturated sample within which the low-power receiver may miss an echo, widths.
const NEAR_WIDTHS: f64 = 1.0;
/// Squared distance of the joint fit from the high-power fit that counts as a contradiction.
///
/// In standard deviations, with three degrees of freedom; exceeded once in 100 000 by chance.
const CONTRADICTION: f64 = 26.0;
/// Height above which the high-power receiver misses no echo, noise standard deviations.
const SEEN_SIGMA: f64 = 8.0;
/// Prior SD of `ln` width for overlapping pulses: the spread of single pulses.
const OVERLAP_LN_WIDTH_SD: f64 = 0.15;

/// Two receivers with known gain ratio and delay, at the gains of the blocks.
pub(super) struct BothReceivers {
    unit: TwoReceivers,
    model: SensorModel,
    fusion: ChannelFusion,
    template_error: f64,
    /// Other gains, by level of the low-power and high-power receiver.
    others: BTreeMap<(GainLevel, GainLevel), TwoReceivers>,
}

/// Maximum number of pairs of gains kept, besides (1, 1).
const MOST_PAIRS: usize = 64;

/// Two receivers, each at one gain.
struct TwoReceivers {
    /// Gain and delay between pulses fitted with the models.
    between: ChannelFusion,
    /// Remaining delay of high-power fits on the common time axis, ns.
    left_ns: f64,
    low: JointFit,
    high: JointFit,
    overdriven_dn: f64,
    detection_sigma: f64,
    /// Gain ratio of fitted pulses over the gain ratio of plain peaks.
    over_plain_ratio: f64,
    /// Gain of the high-power receiver.
    high_gain: f64,
}

/// A pulse of the low-power block in the joint fit.
struct JointCandidate {
    /// Index of the return that receives the result.
    found: usize,
    /// Index of the high-power return.
    high: Option<usize>,
    pulse: JointPulse,
    /// Part of the variance of the expected position that is not due to the walk.
    sure_part: f64,
    /// Walk: change of the delay with height, samples.
    walk_samples: f64,
}

impl JointCandidate {
    /// Candidate without a high-power return.
    fn alone(index: usize, found: &FoundEcho) -> JointCandidate {
        JointCandidate { found: index, high: None, pulse: start(found), sure_part: 1.0, walk_samples: 0.0 }
    }

    /// Converts the fitted pulse to the common time axis.
    ///
    /// The overdriven receiver records it early by the walk `w`. The error of the walk does not affect
    /// the high-power position. Let `x` be the position, `y = x - w` that in the block, `m` and `S` the
    /// prior mean and variance of `y`, and `V` its variance after the fit. Then `x` is
    /// `m + w + k (y - m)`, where `k` is the part of `S` that is not due to the walk, and its variance
    /// is `k S - k² (S - V)`.
    fn on_common_axis(&self, fitted: &JointFitted) -> JointFitted {
        let mut fitted = *fitted;
        let Some(expected) = &self.pulse.expected else { return fitted };
        let (m, s, k) = (expected.mean[1], expected.covariance[1][1], self.sure_part);
        fitted.value[1] = m + self.walk_samples + k * (fitted.value[1] - m);
        fitted.covariance[1][1] = k * s - k * k * (s - fitted.covariance[1][1]);
        fitted
    }
}

impl BothReceivers {
    /// `None` if one of the receivers was not calibrated.
    pub(super) fn new(
        model: &SensorModel,
        fusion: &ChannelFusion,
        detection_sigma: f64,
        template_error: f64,
    ) -> Result<Option<BothReceivers>> {
        let unit = TwoReceivers::new(model, fusion, [GainLevel::UNIT; 2], detection_sigma, template_error)?;
        Ok(unit.map(|unit| BothReceivers {
            unit,
            model: model.clone(),
            fusion: fusion.clone(),
            template_error,
            others: BTreeMap::new(),
        }))
    }

    /// Whether the low-power receiver is saturated or overdriven in a block.
    pub(super) fn is_blinded(&self, samples: &[u16]) -> bool {
        samples.iter().any(|&sample| f64::from(sample) >= self.unit.overdriven_dn)
    }

    /// Converts the time of a return to the common axis and adds the uncertainty.
    pub(super) fn align(&self, found: &mut FoundEcho) {
        self.unit.align(found);
    }

    /// Combines the returns of the same echoes in the blocks of a shot.
    ///
    /// Duplicates are removed from `all` and counted.
    ///
    /// # Errors
    /// A receiver's model is invalid at the gain of a block.
    pub(super) fn fuse(
        &mut self,
        shot: &ShotBlocks,
        all: &mut Vec<FoundEcho>,
        stats: &mut LineStats,
    ) -> Result<()> {
        let mut gone = vec![false; all.len()];
        for (h, high) in shot.of_shot.iter().enumerate() {
            let has_returns = all.iter().any(|found| found.block == h);
            if high.channel != Channel::HighPower || !has_returns {
                continue;
            }
            for (l, low) in shot.of_shot.iter().enumerate().filter(|(_, block)| is_beside(block, high)) {
                let at_gains = self.at_gains([low.gain, high.gain])?;
                at_gains.fuse_blocks(shot, [(l, low), (h, high)], all, &mut gone, stats);
            }
        }
        let mut index = 0;
        all.retain(|_| {
            index += 1;
            !gone[index - 1]
        });
        Ok(())
    }

    /// Returns the receivers at the gains of two blocks.
    fn at_gains(&mut self, gains: [f64; 2]) -> Result<&mut TwoReceivers> {
        let levels = gains.map(GainLevel::of);
        let [low, high] = levels;
        let is_unit = levels == [GainLevel::UNIT; 2];
        if !is_unit && !self.others.contains_key(&(low, high)) {
            if self.others.len() >= MOST_PAIRS {
                self.others.clear();
            }
            let (sigma, error) = (self.unit.detection_sigma, self.template_error);
            let made = TwoReceivers::new(&self.model, &self.fusion, levels, sigma, error)?;
            self.others.extend(made.map(|made| ((low, high), made)));
        }
        let BothReceivers { unit, others, fusion, .. } = self;
        let found = if is_unit { None } else { others.get_mut(&(low, high)) };
        let at_gains = found.unwrap_or(unit);
        // Levels approximate the gains; heights are compared with the exact gains.
        if !is_unit {
            at_gains.set_gains(gains, fusion);
        }
        Ok(at_gains)
    }
}

impl TwoReceivers {
    /// `None` if one of the receivers was not calibrated.
    fn new(
        model: &SensorModel,
        fusion: &ChannelFusion,
        [low_level, high_level]: [GainLevel; 2],
        detection_sigma: f64,
        template_error: f64,
    ) -> Result<Option<TwoReceivers>> {
        let (Some(low), Some(high)) = (&model.low_power, &model.high_power) else { return Ok(None) };
        let made = || {
            let (low, high) = (&low.at_gain(low_level.gain())?, &high.at_gain(high_level.gain())?);
            let between = fusion.at_gains(low_level.gain(), high_level.gain()).between_models(low, high)?;
            Ok(TwoReceivers {
                over_plain_ratio: between.gain_ratio
                    / fusion.at_gains(low_level.gain(), high_level.gain()).gain_ratio,
                high_gain: high_level.gain(),
                left_ns: between.delay_ns - fusion.delay_ns,
                between,
                low: JointFit::new(low, template_error)?,
                high: JointFit::new(high, template_error)?,
                overdriven_dn: low.overdriven_dn(OVERDRIVEN_PART),
                detection_sigma,
            })
        };
        made().map(Some).map_err(|error: wavex_signal::sensor_model::ModelError| {
            StageError::failed(error.to_string(), "calibrate on a longer part of the recording")
        })
    }

    /// Sets the exact gains of two blocks.
    fn set_gains(&mut self, [low, high]: [f64; 2], fusion: &ChannelFusion) {
        let at_gains = fusion.at_gains(low, high);
        self.between.gain_ratio = self.over_plain_ratio * at_gains.gain_ratio;
        self.between.gain_ratio_sd = self.over_plain_ratio * at_gains.gain_ratio_sd;
        self.high_gain = high;
    }

    /// Change of the delay for an echo of this height in the low-power receiver, and its standard
    /// deviation, ns.
    ///
    /// `is_blinded`: the receiver is overdriven or clipped at the echo, whatever its fitted height.
    fn walk_ns(&self, low_power_dn: f64, is_blinded: bool) -> (f64, f64) {
        if self.between.walk_is_known || !is_blinded && low_power_dn < self.overdriven_dn {
            return self.between.walk_ns(low_power_dn);
        }
        (0.0, self.low.model().overdrive_errors().0)
    }

    /// Converts the time of a return to the common axis and adds the uncertainty.
    fn align(&self, found: &mut FoundEcho) {
        let (shift_ns, sd_ns) = match found.channel {
            ReturnChannel::Low => self.walk_ns(found.fitted.amplitude_dn, found.fitted.flags & BLINDED != 0),
            _ => (-self.left_ns, self.between.delay_sd_ns),
        };
        found.time_ns += shift_ns;
        found.time_sd_ns = found.time_sd_ns.hypot(sd_ns);
    }

    fn fuse_blocks(
        &mut self,
        shot: &ShotBlocks,
        [(l, low), (h, high)]: [(usize, &Block); 2],
        all: &mut [FoundEcho],
        gone: &mut [bool],
        stats: &mut LineStats,
    ) {
        let of_block = |block: usize| (0..all.len()).filter(|&i| all[i].block == block && !gone[i]).collect();
        let (lows, highs): (Vec<usize>, Vec<usize>) = (of_block(l), of_block(h));
        let samples = shot.blocks.samples(low);
        let partner = self.partners(all, &lows, &highs, low);
        let mut joined = Vec::new();
        for (&of_high, &of_low) in highs.iter().zip(&partner) {
            let time_ns = all[of_high].time_ns;
            let is_blind = of_low.is_some_and(|i| all[i].fitted.flags & BLINDED != 0)
                || self.is_near_saturation(samples, low, time_ns);
            let is_within = (low.time_ns(0.0)..=low.time_ns(samples.len() as f64 - 1.0)).contains(&time_ns);
            match of_low {
                _ if is_blind => joined.push((of_high, of_low)),
                Some(_) => {
                    gone[of_high] = true;
                    stats.np_merged += 1;
                }
                None if is_within => {
                    gone[of_high] = true;
                    stats.filtered.add(Reason::NotInLowPower, 1);
                }
                None => {}
            }
        }
        if joined.is_empty() {
            return;
        }
        let matched = |i: usize| joined.iter().any(|&(_, of_low)| of_low == Some(i));
        let explained = |i: usize| {
            let reach_ns = NEAR_WIDTHS * self.low.model().pulse_fwhm_ns;
            joined.iter().any(|&(of_high, _)| (all[of_high].time_ns - all[i].time_ns).abs() <= reach_ns)
        };
        // Returns of the low-power receiver on a plateau next to a high-power echo are that echo.
        let doubles: Vec<usize> = lows
            .iter()
            .copied()
            .filter(|&i| matched(i) || all[i].fitted.flags & BLINDED != 0 && explained(i))
            .collect();
        // A high-power return nearby confirms a return, unless it is part of a joint fit itself.
        let wide_ns = self.wide_ns();
        let is_free = |h: usize| joined.iter().all(|&(of_high, _)| of_high != h);
        let is_near = |i: usize, h: usize| (all[i].time_ns - all[h].time_ns).abs() <= wide_ns;
        let is_confirmed =
            |i: usize| partner.contains(&Some(i)) || highs.iter().any(|&h| is_free(h) && is_near(i, h));
        let (others, false_ones): (Vec<usize>, Vec<usize>) = (lows.iter().copied())
            .filter(|i| !doubles.contains(i))
            .partition(|&i| is_confirmed(i) || self.stands_out(&all[i], [low, high], all, &joined));
        for false_one in false_ones {
            gone[false_one] = true;
            stats.filtered.add(Reason::NotInHighPower, 1);
        }
        self.fit_jointly(shot, [low, high], all, &highs, (&joined, &others));
        for double in doubles {
            gone[double] = true;
            stats.np_merged += 1;
        }
    }

    /// Whether a return of the low-power receiver alone is significant.
    ///
    /// It must exceed the residuals that response errors leave of the echoes that overdrive the
    /// receiver, and be too weak for the high-power receiver.
    fn stands_out(
        &self,
        found: &FoundEcho,
        [low, high]: [&Block; 2],
        all: &[FoundEcho],
        joined: &[(usize, Option<usize>)],
    ) -> bool {
        let gain = self.between.gain_ratio;
        let place = |time_ns: f64, block: &Block| (time_ns - block.start_ns) / block.interval_ns;
        let strong =
            joined.iter().map(|&(i, _)| (place(all[i].time_ns, low), gain * all[i].fitted.amplitude_dn));
        let position = place(found.time_ns, low);
        let height_dn = found.fitted.amplitude_dn;
        if height_dn < self.low.least_height_dn(self.detection_sigma, position, strong) {
            return false;
        }
        let (in_high, beside) = (place(found.time_ns, high), std::iter::empty());
        let is_recorded = (0.0..high.len() as f64).contains(&in_high);
        let seen_dn = self.high.least_height_dn(SEEN_SIGMA.max(self.detection_sigma), in_high, beside);
        !is_recorded || height_dn < gain * seen_dn
    }

    /// Nearest low-power return of each high-power return that may be the same echo.
    fn partners(
        &self,
        all: &[FoundEcho],
        lows: &[usize],
        highs: &[usize],
        low: &Block,
    ) -> Vec<Option<usize>> {
        let mut taken: Vec<usize> = Vec::new();
        let wide_ns = self.wide_ns();
        let mut partner = vec![None; highs.len()];
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (k, &h) in highs.iter().enumerate() {
            for &l in lows {
                let (a, b) = (&all[h], &all[l]);
                let distance_ns = (a.time_ns - b.time_ns).abs();
                let sd_ns = a.time_sd_ns.hypot(b.time_sd_ns);
                let blinded_ns = if b.fitted.flags & BLINDED != 0 { wide_ns } else { 0.0 };
                if distance_ns <= low.interval_ns.max(SAME_SD * sd_ns).max(blinded_ns) {
                    pairs.push((distance_ns, k, l));
                }
            }
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, k, l) in pairs {
            if partner[k].is_none() && !taken.contains(&l) {
                partner[k] = Some(l);
                taken.push(l);
            }
        }
        partner
    }

    /// Largest distance between two positions of one echo if one is uncertain, ns.
    fn wide_ns(&self) -> f64 {
        SAME_WIDTHS * self.low.model().pulse_fwhm_ns
    }

    /// Whether a time is within a width of a saturated sample of a block.
    fn is_near_saturation(&self, samples: &[u16], block: &Block, time_ns: f64) -> bool {
        let model = self.low.model();
        let place = (time_ns - block.start_ns) / block.interval_ns;
        let reach = NEAR_WIDTHS * model.fwhm_samples();
        let saturated = |(_, sample): &(usize, &u16)| f64::from(**sample) >= model.full_scale_dn;
        samples.iter().enumerate().filter(saturated).any(|(k, _)| (k as f64 - place).abs() <= reach)
    }

    /// Fits the low-power block with the high-power fit of the `joined` echoes as a prior.
    ///
    /// `joined` has the index of the high-power return and of the low-power one, if any; `others` are
    /// the remaining low-power returns. Results replace the high-power returns. These remain unchanged
    /// if the receivers contradict each other or the fit fails.
    fn fit_jointly(
        &mut self,
        shot: &ShotBlocks,
        [low, high]: [&Block; 2],
        all: &mut [FoundEcho],
        highs: &[usize],
        (joined, others): (&[(usize, Option<usize>)], &[usize]),
    ) {
        let starts = highs.iter().map(|&i| start(&all[i]));
        if self.high.fit(shot.blocks.samples(high), starts).is_none() {
            return;
        }
        let mut candidates = Vec::new();
        for &(of_high, of_low) in joined {
            let Some(place) = highs.iter().position(|&i| i == of_high) else { continue };
            let Some(fitted) = self.high.fitted().get(place) else { continue };
            let height_dn = (fitted.value[0].exp() * self.between.gain_ratio)
                .max(of_low.map_or(0.0, |i| 0.5 * all[i].fitted.amplitude_dn));
            let (walk_ns, walk_sd_ns) = self.walk_ns(height_dn, true);
            let expected = self.expected(fitted, [low, high], (walk_ns, walk_sd_ns));
            candidates.push(JointCandidate {
                found: of_high,
                high: Some(of_high),
                pulse: JointPulse { start: expected.mean, expected: Some(expected), ln_width_precision: 0.0 },
                sure_part: 1.0 - (walk_sd_ns / low.interval_ns).powi(2) / expected.covariance[1][1],
                walk_samples: walk_ns / low.interval_ns,
            });
        }
        candidates.extend(others.iter().map(|&i| JointCandidate::alone(i, &all[i])));
        let pulses = candidates.iter().map(|candidate| candidate.pulse);
        let Some(outcome) = self.low.fit(shot.blocks.samples(low), pulses) else { return };
        if self.low.fitted().iter().any(|fitted| fitted.distance > CONTRADICTION) {
            return;
        }
        let nu = outcome.degrees_of_freedom.max(1) as f64;
        let deviation_ratio = (outcome.chi_square - nu) / (2.0 * nu).sqrt();
        // The fit's covariances include the misfit.
        let misfit = if deviation_ratio > DEVIANT { flags::MISFIT } else { 0 };
        for (candidate, fitted) in candidates.iter().zip(self.low.fitted()) {
            let was_low = joined.iter().find(|(of_high, _)| Some(*of_high) == candidate.high);
            let flags = was_low.and_then(|(_, of_low)| *of_low).map_or(0, |i| all[i].fitted.flags);
            let found = &mut all[candidate.found];
            let was_blinded = found.channel == ReturnChannel::High && found.fitted.flags & BLINDED != 0;
            if candidate.high.is_some() {
                found.high_power = Some(HighPowerView {
                    gain_ratio: self.between.gain_ratio * self.high_gain,
                    background_dn: found.background_dn,
                });
                found.channel = ReturnChannel::Joint;
                found.gain = low.gain;
            }
            found.fitted.flags = (found.fitted.flags | flags) & !flags::MISFIT | misfit;
            found.fitted.deviation_ratio = deviation_ratio;
            write(&self.low, &candidate.on_common_axis(fitted), low, found);
            if candidate.high.is_none() {
                found.add_overdrive_sd(self.low.model(), true);
                self.align(found);
                continue;
            }
            // Very strong echoes overdrive the high-power receiver as well.
            if was_blinded {
                found.add_sd(self.high.model().overdrive_errors());
            }
            // Below full scale the low-power receiver determines the height.
            let is_unclipped = flags & BLINDED == flags::OVERDRIVEN;
            if is_unclipped && !self.between.walk_is_known {
                found.add_sd((0.0, self.low.model().overdrive_errors().1));
            }
        }
    }

    /// Prior of a pulse in the low-power block from its high-power fit.
    fn expected(
        &self,
        fitted: &JointFitted,
        [low, high]: [&Block; 2],
        (walk_ns, walk_sd_ns): (f64, f64),
    ) -> Expected {
        let between = &self.between;
        let [ln_height, position, ln_width] = fitted.value;
        let samples = high.interval_ns / low.interval_ns;
        let time_ns = high.time_ns(position) - self.left_ns - walk_ns;
        let scale = [1.0, samples, 1.0];
        let mut covariance: [[f64; 3]; 3] =
            std::array::from_fn(|a| std::array::from_fn(|b| scale[a] * scale[b] * fitted.covariance[a][b]));
        covariance[0][0] += (between.gain_ratio_sd / between.gain_ratio).powi(2);
        covariance[1][1] += (between.delay_sd_ns.powi(2) + walk_sd_ns.powi(2)) / low.interval_ns.powi(2);
        let mean =
            [ln_height + between.gain_ratio.ln(), (time_ns - low.start_ns) / low.interval_ns, ln_width];
        Expected { mean, covariance }
    }
}

/// Start values from a return for a fit of its own block.
fn start(found: &FoundEcho) -> JointPulse {
    let fitted = &found.fitted;
    let overlaps = fitted.flags & flags::OVERLAP != 0;
    JointPulse {
        start: [fitted.amplitude_dn.ln(), fitted.position_samples, fitted.width_ratio.ln()],
        expected: None,
        ln_width_precision: if overlaps { OVERLAP_LN_WIDTH_SD.powi(-2) } else { 0.0 },
    }
}

/// Whether a block is of the low-power receiver and overlaps `other` in time.
fn is_beside(block: &Block, other: &Block) -> bool {
    let end_ns = |block: &Block| block.time_ns(block.len() as f64);
    block.channel == Channel::LowPower && block.start_ns < end_ns(other) && other.start_ns < end_ns(block)
}

/// Stores a fitted pulse of a block of the fit's receiver in a return.
fn write(fit: &JointFit, fitted: &JointFitted, block: &Block, found: &mut FoundEcho) {
    let [ln_height, position, ln_width] = fitted.value;
    let sd = |part: usize| fitted.covariance[part][part].sqrt();
    let (amplitude_dn, width_ratio) = (ln_height.exp(), ln_width.exp());
    found.time_ns = block.time_ns(position);
    found.time_sd_ns = sd(1) * block.interval_ns;
    let pulse = &mut found.fitted;
    (pulse.position_samples, pulse.position_sd_samples) = (position, sd(1));
    (pulse.amplitude_dn, pulse.amplitude_sd_dn) = (amplitude_dn, amplitude_dn * sd(0));
    (pulse.width_ratio, pulse.width_ratio_sd) = (width_ratio, width_ratio * sd(2));
    pulse.fwhm_ns = width_ratio * fit.fwhm_samples_at(amplitude_dn) * fit.model().sampling_interval_ns;
}
