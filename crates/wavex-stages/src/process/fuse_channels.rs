//! `fuse_channels`: estimates gain ratio and delay between the two receivers.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::process::calibrate::AutoOrNumber;
use wavex_line::keys::{above, at_least};
use wavex_line::scan_line::{Block, Blocks, Channel, Content, Kind, ScanLine};
use wavex_line::stage::{
    Config, Holds, Learning, Learns, LookAhead, Output, Result, RunContext, StageSpec, SurveyModels,
    Transform, TransformConfig,
};
use wavex_signal::decompose::OVERDRIVEN_PART;
use wavex_signal::fusion::{
    ChannelFusion, FusionProof, MIN_PAIRS, Pair, estimate, lead_noise_sd_dn, plain_peak, prove,
};

/// Registry entry of the stage.
pub const STAGE: StageSpec = StageSpec::transform::<FuseChannels>("fuse_channels", &[Kind::Shots]);

/// Largest time difference of peaks of one echo in both receivers, ns.
const MOST_DELAY_NS: f64 = 10.0;
/// A delay that is not applied is a warning above this many of its standard deviations.
const SIGNIFICANT_DELAY_SD: f64 = 3.0;

/// Estimates the gain ratio and delay between the two receivers of an instrument.
///
/// The gain ratio is the height of an echo in the low-power (sensitive) receiver over its height in
/// the high-power receiver. The delay is how much later the high-power receiver sees the echo; it
/// depends on amplitude where the low-power receiver is overdriven. Both are estimated robustly
/// from peaks of echoes that saturate neither receiver in the first waveforms. The report gives
/// them with their standard deviations, as `channel_fusion`.
///
/// The times of the high-power blocks are shifted by the delay, so that both receivers share one
/// time scale. `decompose` then uses both: the low-power receiver alone where it is neither
/// saturated nor overdriven, both jointly where it is and the high-power receiver sees the same
/// echo, and the high-power receiver alone where the low-power receiver gives no information.
///
/// What is estimated must prove itself: learnt on one half of the echoes, in stretches, it must let the
/// squared differences of heights or times in the other half fall by three standard deviations, both
/// ways. Otherwise a delay is not applied and enters the standard deviations, and receivers whose gain
/// ratio is not proven are not fused; the report says so.
///
/// With fewer than 20 echoes that overdrive the low-power receiver, its delay there is unknown: the
/// standard deviations of such returns contain 0.03 pulse widths, unless `calibrate` finds the receiver
/// linear. A high-power receiver with too few blocks to calibrate is used if both keys are numbers: it
/// then has the response of the other one.
///
/// Place it before `calibrate`. Holds back the first lines until it has enough waveforms, then lets
/// everything through. A recording with one receiver, or with fewer than 20 suitable echoes in
/// both, passes unchanged, and the report says so: the receivers are then used as without this
/// stage.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FuseChannels {
    /// Height of an echo in the low-power receiver over that in the high-power receiver; `"auto"`:
    /// estimated.
    #[schemars(transform = above(0.0).at_most(1e6))]
    pub gain_ratio: AutoOrNumber,
    /// Delay of the high-power receiver relative to the low-power receiver, ns;
    /// `"auto"`: estimated, as a function of amplitude if the data require it. If both keys are
    /// numbers, no lines are held back.
    #[schemars(transform = at_least(-MOST_DELAY_NS).at_most(MOST_DELAY_NS))]
    pub delay_ns: AutoOrNumber,
    /// Number of waveforms to estimate from. Fewer are used if the input has fewer, or if
    /// `memory_mb` cannot hold them.
    #[schemars(range(min = 20, max = i64::MAX))]
    pub waveforms: u64,
}

impl Default for FuseChannels {
    fn default() -> FuseChannels {
        FuseChannels {
            gain_ratio: AutoOrNumber::AUTO,
            delay_ns: AutoOrNumber::AUTO,
            waveforms: LookAhead::WAVEFORMS,
        }
    }
}

impl Config for FuseChannels {}

impl FuseChannels {
    /// The fusion given by the keys, if they give all of it.
    fn given(&self) -> Option<ChannelFusion> {
        let (gain_ratio, delay_ns) = (self.gain_ratio.number()?, self.delay_ns.number()?);
        Some(ChannelFusion {
            pairs: 0,
            gain_ratio,
            gain_ratio_sd: 0.0,
            delay_ns,
            delay_sd_ns: 0.0,
            walk: Vec::new(),
            walk_is_known: false,
        })
    }
}

impl TransformConfig for FuseChannels {
    fn holds(&self) -> Holds {
        Holds::First
    }

    fn learns(&self) -> Option<Learns> {
        self.given().is_none().then_some(Learns { waveforms: self.waveforms, makes_model: false })
    }

    fn learn(&self, lines: &mut Vec<ScanLine>, learning: &mut Learning) -> Result<()> {
        let look_ahead = LookAhead::of(std::mem::take(lines));
        let mut fuser = self.fuser(look_ahead);
        let mut emit = |_: ScanLine| Ok(());
        learning.known.fusion = fuser.found(&mut Output::new(learning.cx, usize::MAX, &mut emit));
        *lines = fuser.look_ahead.release();
        Ok(())
    }

    fn make(&self, run: &RunContext) -> Result<Box<dyn Transform>> {
        let survey = run.survey.clone().filter(|_| self.learns().is_some());
        let fuser = self.fuser(LookAhead::new(self.waveforms));
        Ok(Box::new(ChannelFuser { survey, stem: run.stem.clone(), ..fuser }))
    }
}

impl FuseChannels {
    fn fuser(&self, look_ahead: LookAhead) -> ChannelFuser {
        let state =
            self.given().map_or(FusionState::Surveying, |fusion| FusionState::Known(Arc::new(fusion)));
        ChannelFuser { config: self.clone(), look_ahead, state, survey: None, stem: String::new() }
    }
}

struct ChannelFuser {
    config: FuseChannels,
    look_ahead: LookAhead,
    state: FusionState,
    /// Models of the survey, which are used instead of estimating.
    survey: Option<Arc<SurveyModels>>,
    stem: String,
}

/// State of the estimation.
enum FusionState {
    Surveying,
    Known(Arc<ChannelFusion>),
    /// Nothing to fuse.
    Alone,
}

impl Transform for ChannelFuser {
    fn process(&mut self, line: ScanLine, out: &mut Output) -> Result<()> {
        if let Some(survey) = self.survey.take()
            && let Some(fusion) =
                survey.of_recording(&self.stem, &line.input).and_then(|model| model.fusion.clone())
        {
            out.cx.info("gain and delay of the receivers are those of the survey");
            self.state = FusionState::Known(Arc::new(fusion));
        }
        if !matches!(self.state, FusionState::Surveying) {
            return out.emit(self.fused(line));
        }
        let is_enough = self.look_ahead.hold(line, "gain and delay of the receivers were estimated", out);
        if is_enough { self.release(out) } else { Ok(()) }
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        if self.look_ahead.lines().is_empty() { Ok(()) } else { self.release(out) }
    }
}

impl ChannelFuser {
    /// Estimates gain and delay from the held lines and emits these.
    fn release(&mut self, out: &mut Output) -> Result<()> {
        self.state = match self.found(out) {
            Some(fusion) => FusionState::Known(Arc::new(fusion)),
            None => FusionState::Alone,
        };
        self.look_ahead.release().into_iter().try_for_each(|line| out.emit(self.fused(line)))
    }

    /// Shifts the times of the high-power blocks of a line.
    fn fused(&self, mut line: ScanLine) -> ScanLine {
        if let FusionState::Known(fusion) = &self.state {
            if let Content::Shots(blocks) = &mut line.content {
                blocks.shift(Channel::HighPower, -fusion.delay_ns);
            }
            line.fusion = Some(Arc::clone(fusion));
        }
        line
    }

    /// Gain and delay from the held lines; `None`, with a note, if they cannot be estimated.
    fn found(&self, out: &mut Output) -> Option<ChannelFusion> {
        let one = |channel| self.look_ahead.samples(channel).next().is_none();
        if one(Channel::LowPower) || one(Channel::HighPower) {
            out.cx.info("the recording has one receiver: there is nothing to fuse");
            return None;
        }
        let lines = self.look_ahead.lines();
        let full_scale_dn = lines.first().and_then(|line| line.input.full_scale_dn).unwrap_or(u16::MAX);
        let mut pairs = Vec::new();
        for (line, blocks) in lines.iter().filter_map(|line| Some((line, line.blocks()?))) {
            let is_copy = |index: u32| line.emissions.get(index as usize).is_some_and(|shot| shot.is_copy());
            blocks.by_emission().filter(|(index, _)| !is_copy(*index)).for_each(|(_, of_shot)| {
                add_pairs(blocks, of_shot, f64::from(full_scale_dn), &mut pairs);
            });
        }
        let noise_dn = lead_noise_sd_dn(self.look_ahead.samples(Channel::HighPower));
        match estimate(&pairs, f64::from(full_scale_dn), noise_dn) {
            Some(mut found) => {
                let proof = prove(&found, &pairs, f64::from(full_scale_dn), noise_dn);
                let is_given = self.config.gain_ratio.number().is_some();
                if !is_given && !FusionProof::is_proven(proof.gain_falls) {
                    out.cx.warn(format!(
                        "the receivers are not fused: the gain ratio {:.2} ± {:.2} is not proven: {}; set `gain_ratio` and \
                         `delay_ns`",
                        found.gain_ratio,
                        found.gain_ratio_sd,
                        falls("heights", proof.gain_falls)
                    ));
                    return None;
                }
                let estimated = found.clone();
                found.keep_proven(&proof);
                if self.config.delay_ns.number().is_none() {
                    note_unproven(&proof, &estimated, &found, out);
                }
                Some(self.with_given(found))
            }
            None => {
                out.cx.warn(format!(
                    "the receivers are not fused: {MIN_PAIRS} strong unsaturated echoes in both receivers are needed, but fewer of the \
                     {} unsaturated echoes were strong enough in the high power receiver; set \
                     `gain_ratio` and `delay_ns`",
                    pairs.len()
                ));
                None
            }
        }
    }

    /// Replaces estimates by given values, which are taken as exact.
    fn with_given(&self, mut fusion: ChannelFusion) -> ChannelFusion {
        if let Some(gain_ratio) = self.config.gain_ratio.number() {
            (fusion.gain_ratio, fusion.gain_ratio_sd) = (gain_ratio, 0.0);
        }
        if let Some(delay_ns) = self.config.delay_ns.number() {
            (fusion.delay_ns, fusion.delay_sd_ns) = (delay_ns, 0.0);
            fusion.walk.clear();
            fusion.walk_is_known = false;
        }
        fusion
    }
}

/// Notes a delay, and a walk, that were estimated and are not applied.
///
/// A delay within the error of its estimate is no warning: it may well be 0.
fn note_unproven(proof: &FusionProof, estimated: &ChannelFusion, kept: &ChannelFusion, out: &mut Output) {
    if !FusionProof::is_proven(proof.delay_falls) {
        let text = format!(
            "the times of the receivers are not shifted: the estimated delay of {:.3} ± {:.3} ns is not proven: {}; its \
             size enters the standard deviation, {:.3} ns",
            estimated.delay_ns,
            estimated.delay_sd_ns,
            falls("times", proof.delay_falls),
            kept.delay_sd_ns
        );
        match estimated.delay_ns.abs() > SIGNIFICANT_DELAY_SD * estimated.delay_sd_ns {
            true => out.cx.warn(text),
            false => out.cx.info(text),
        }
    }
    if let Some(walk_falls) = proof.walk_falls.filter(|falls| !FusionProof::is_proven(*falls)) {
        out.cx.warn(format!(
            "the delay of the overdriven receiver is taken as constant: its change with the amplitude is not proven: {}; \
             it enters the standard deviations",
            falls("times", walk_falls)
        ));
    }
}

/// Falls of squared differences, in words.
fn falls(what: &str, [first, second]: [f64; 2]) -> String {
    format!(
        "the estimate of one half of the echoes reduces the squared differences of {what} in the other half by \
         {first:.1} and {second:.1} standard deviations, at least 3 are needed"
    )
}

/// Adds the strongest echoes of blocks that both receivers recorded simultaneously.
fn add_pairs(blocks: &Blocks, of_shot: &[Block], full_scale_dn: f64, pairs: &mut Vec<Pair>) {
    let end_ns = |block: &Block| block.time_ns(block.len() as f64);
    for low in of_shot.iter().filter(|block| block.channel == Channel::LowPower) {
        let overlaps = |other: &&Block| {
            other.channel == Channel::HighPower
                && other.start_ns < end_ns(low)
                && low.start_ns < end_ns(other)
        };
        let Some(high) = of_shot.iter().find(overlaps) else { continue };
        let peak = |block: &Block| {
            let peak = plain_peak(blocks.samples(block), full_scale_dn)?;
            Some((peak.height_dn, block.time_ns(peak.position_samples)))
        };
        let (Some((low_power_dn, low_ns)), Some((high_power_dn, high_ns))) = (peak(low), peak(high)) else {
            continue;
        };
        let delay_ns = high_ns - low_ns;
        // The delay of an overdriven receiver depends on the recorded height, which scales with the gain.
        let is_plain = low.gain == 1.0 || low_power_dn < OVERDRIVEN_PART * full_scale_dn;
        if delay_ns.abs() <= MOST_DELAY_NS && is_plain {
            let (low_power_dn, high_power_dn) = (low_power_dn / low.gain, high_power_dn / high.gain);
            pairs.push(Pair { low_power_dn, high_power_dn, delay_ns });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::scan_line::{Emission, InputInfo};
    use wavex_line::stage::Context;

    const INTERVAL_NS: f64 = 1.0;

    /// A Gaussian pulse above a background of 10.
    fn block(height_dn: f64, position: f64) -> Vec<u16> {
        let value =
            |k: u32| 10.0 + height_dn * (-2.772_588_722 * ((f64::from(k) - position) / 4.4).powi(2)).exp();
        (0..48).map(|k| value(k).round().min(255.0) as u16).collect()
    }

    /// Shots seen by one receiver or both: gain 5, delay 0.5 ns, block of the second 1.25 ns later.
    fn line(line: u32, shots: u32, both: bool) -> ScanLine {
        let mut blocks = Blocks::default();
        for shot in 0..shots {
            let (height_dn, place) = (120.0 + f64::from(shot), 20.0 + 0.37 * f64::from(shot) % 1.0);
            blocks.push(shot, Channel::LowPower, None, 100.0, INTERVAL_NS, &block(height_dn, place));
            if both {
                let samples = block(height_dn / 5.0, place + 0.5 - 1.25);
                blocks.push(shot, Channel::HighPower, None, 101.25, INTERVAL_NS, &samples);
            }
        }
        let input = InputInfo { full_scale_dn: Some(255), ..InputInfo::default() };
        ScanLine::of_shots(Arc::new(input), line, vec![Emission::default(); shots as usize], blocks)
    }

    /// The lines that the stage emits, and its notes.
    fn run(config: &FuseChannels, lines: Vec<ScanLine>) -> (Vec<ScanLine>, Vec<String>) {
        let mut stage = config.fuser(LookAhead::new(config.waveforms));
        let (mut cx, mut given_on) = (Context::default(), Vec::new());
        let mut emit = |scan_line: ScanLine| {
            given_on.push(scan_line);
            Ok(())
        };
        let mut out = Output::new(&mut cx, usize::MAX, &mut emit);
        lines.into_iter().for_each(|line| stage.process(line, &mut out).unwrap());
        stage.finish(&mut out).unwrap();
        (given_on, cx.counters().notes.clone())
    }

    fn start_ns(scan_line: &ScanLine, channel: Channel) -> f64 {
        scan_line.blocks().unwrap().iter().find(|block| block.channel == channel).unwrap().start_ns
    }

    #[test]
    fn gain_and_delay_are_found_and_times_count_alike() {
        let (lines, notes) = run(&FuseChannels::default(), vec![line(0, 40, true), line(1, 40, true)]);
        assert_eq!(notes, [""; 0]);
        assert_eq!(lines.len(), 2);
        for scan_line in &lines {
            let fusion = scan_line.fusion.as_ref().unwrap();
            assert_eq!(fusion.pairs, 80);
            assert!((fusion.gain_ratio - 5.0).abs() < 0.05, "{fusion:?}");
            assert!((fusion.delay_ns - 0.5).abs() < 0.01, "{fusion:?}");
            assert_eq!(start_ns(scan_line, Channel::LowPower), 100.0);
            assert_eq!(start_ns(scan_line, Channel::HighPower), 101.25 - fusion.delay_ns);
        }
    }

    #[test]
    fn a_delay_that_half_of_the_lines_contradict_is_not_applied() {
        let mut lines: Vec<ScanLine> = (0..20).map(|k| line(k, 40, true)).collect();
        for contradicting in lines.iter_mut().skip(1).step_by(2) {
            let Content::Shots(blocks) = &mut contradicting.content else { unreachable!() };
            blocks.shift(Channel::HighPower, -1.2);
        }
        let (lines, notes) = run(&FuseChannels::default(), lines);
        let fusion = lines[0].fusion.as_ref().unwrap();
        assert_eq!(fusion.delay_ns, 0.0);
        assert_eq!(start_ns(&lines[0], Channel::HighPower), 101.25);
        assert!(notes[0].contains("the estimated delay of"), "{notes:?}");
    }

    #[test]
    fn a_delay_of_zero_is_no_warning() {
        let mut lines: Vec<ScanLine> = (0..20).map(|k| line(k, 40, true)).collect();
        for (k, either) in lines.iter_mut().enumerate() {
            let Content::Shots(blocks) = &mut either.content else { unreachable!() };
            blocks.shift(Channel::HighPower, if k % 2 == 0 { -0.2 } else { -0.8 });
        }
        let (lines, notes) = run(&FuseChannels::default(), lines);
        assert_eq!(lines[0].fusion.as_ref().unwrap().delay_ns, 0.0);
        assert_eq!(notes, [""; 0]);
    }

    #[test]
    fn lines_are_held_back_only_until_there_are_enough() {
        let config = FuseChannels { waveforms: 40, ..FuseChannels::default() };
        let (lines, _) = run(&config, (0..3).map(|k| line(k, 30, true)).collect());
        assert_eq!(lines.iter().map(|scan_line| scan_line.line).collect::<Vec<_>>(), [0, 1, 2]);
        assert!(lines.iter().all(|scan_line| scan_line.fusion.as_ref().unwrap().pairs == 60));
    }

    #[test]
    fn what_is_given_is_used_as_it_is() {
        let given = FuseChannels {
            gain_ratio: AutoOrNumber::Number(7.0),
            delay_ns: AutoOrNumber::Number(0.25),
            ..FuseChannels::default()
        };
        let (lines, _) = run(&given, vec![line(0, 3, true)]);
        let fusion = lines[0].fusion.as_ref().unwrap();
        assert_eq!((fusion.pairs, fusion.gain_ratio, fusion.delay_ns), (0, 7.0, 0.25));
        assert_eq!(start_ns(&lines[0], Channel::HighPower), 101.0);
        let half = FuseChannels { gain_ratio: AutoOrNumber::AUTO, ..given };
        let (lines, _) = run(&half, vec![line(0, 40, true)]);
        let fusion = lines[0].fusion.as_ref().unwrap();
        assert!((fusion.gain_ratio - 5.0).abs() < 0.05 && fusion.delay_ns == 0.25, "{fusion:?}");
    }

    #[test]
    fn one_receiver_passes_as_it_is() {
        let (lines, notes) = run(&FuseChannels::default(), vec![line(0, 40, false)]);
        assert!(notes.is_empty(), "{notes:?}");
        assert!(lines.len() == 1 && lines[0].fusion.is_none());
    }

    #[test]
    fn too_few_echoes_say_how_many_there_were() {
        let (lines, notes) = run(&FuseChannels::default(), vec![line(0, 19, true)]);
        assert_eq!(
            notes,
            ["the receivers are not fused: 20 strong unsaturated echoes in both receivers are needed, but \
                 fewer of the 19 unsaturated echoes were strong enough in the high power receiver; set \
                 `gain_ratio` and `delay_ns`"]
        );
        assert!(lines[0].fusion.is_none());
        assert_eq!(start_ns(&lines[0], Channel::HighPower), 101.25);
    }
}
