//! How the receiver for strong echoes goes together with the sensitive one, found from the recording itself.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::calibrate::AutoOrNumber;
use crate::batch::{Batch, Block, Blocks, Channel, Content, Kind};
use crate::kernels::decompose::OVERDRIVEN_PART;
use crate::kernels::fusion::{ChannelFusion, MIN_PAIRS, Pair, estimate, lead_noise_sd_dn, plain_peak};
use crate::stage::{
    Config, Holds, InvalidKey, Output, Result, Site, StageSpec, Survey, Transform, TransformConfig,
};

/// The stage's place in the registry.
pub const STAGE: StageSpec = StageSpec::transform::<FuseChannels>("fuse_channels", &[Kind::Shots]);

/// Peaks of the two receivers that lie further apart are not one echo, ns.
const MOST_DELAY_NS: f64 = 10.0;

/// Finds, from the first waveforms, how the two receivers of an instrument go together: how much higher an echo stands in
/// the sensitive one than in the one for strong echoes, and how much later the other sees it, by amplitude where the
/// sensitive one is overdriven. Both are told from plain peaks of echoes that neither saturates, robustly, and stand in the
/// report with their standard deviations, `channel_fusion`.
///
/// The times of the other receiver's blocks are moved by the delay, so that both count alike, and `decompose` then uses
/// both: the sensitive one alone where it is neither saturated nor overdriven, both together where it is and the other
/// sees the same echo, the other alone where the sensitive one tells nothing.
///
/// It stands before `calibrate`. Holds back the first lines until it has enough waveforms, then lets everything through. A
/// recording of one receiver, or with fewer than 20 echoes that both saw well, passes as it is, and the report says so: the
/// receivers are then used as without this stage.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct FuseChannels {
    /// Height of an echo in the sensitive receiver over that in the other, above 0; `"auto"`: found.
    pub gain_ratio: AutoOrNumber,
    /// How much later the receiver for strong echoes sees an echo, from -10 to 10; `"auto"`: found, by amplitude where the
    /// data call for it. Where both are numbers nothing is held back.
    pub delay_ns: AutoOrNumber,
    /// How many waveforms to learn from; fewer where the input has fewer, or where `memory_mb` does not hold them.
    pub waveforms: u64,
}

impl Default for FuseChannels {
    fn default() -> FuseChannels {
        FuseChannels { gain_ratio: AutoOrNumber::AUTO, delay_ns: AutoOrNumber::AUTO, waveforms: 100_000 }
    }
}

impl Config for FuseChannels {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(
            self.gain_ratio.number().is_none_or(|gain| gain > 0.0 && gain.is_finite()),
            "gain_ratio",
            "it must be above 0, or be \"auto\"",
        )?;
        InvalidKey::unless(
            self.delay_ns.number().is_none_or(|delay_ns| delay_ns.abs() <= MOST_DELAY_NS),
            "delay_ns",
            "it must lie between -10 and 10, or be \"auto\"",
        )?;
        InvalidKey::unless(self.waveforms >= 20, "waveforms", "at least 20 waveforms are needed")
    }
}

impl FuseChannels {
    /// What the keys say, where they say all of it.
    fn given(&self) -> Option<ChannelFusion> {
        let (gain_ratio, delay_ns) = (self.gain_ratio.number()?, self.delay_ns.number()?);
        Some(ChannelFusion {
            pairs: 0,
            gain_ratio,
            gain_ratio_sd: 0.0,
            delay_ns,
            delay_sd_ns: 0.0,
            walk: Vec::new(),
        })
    }
}

impl TransformConfig for FuseChannels {
    fn holds(&self) -> Holds {
        Holds::First
    }

    fn make(&self, _site: &Site) -> Result<Box<dyn Transform>> {
        let state = self.given().map_or(State::Surveying, |fusion| State::Known(Arc::new(fusion)));
        Ok(Box::new(Fuser { config: self.clone(), survey: Survey::new(self.waveforms), state }))
    }
}

struct Fuser {
    config: FuseChannels,
    survey: Survey,
    state: State,
}

/// How far it has come.
enum State {
    Surveying,
    Known(Arc<ChannelFusion>),
    /// There is nothing to fuse.
    Alone,
}

impl Transform for Fuser {
    fn process(&mut self, batch: Batch, out: &mut Output) -> Result<()> {
        if !matches!(self.state, State::Surveying) {
            return out.emit(self.fused(batch));
        }
        let is_enough = self.survey.hold(batch, "gain and delay of the receivers were found", out);
        if is_enough { self.release(out) } else { Ok(()) }
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        if self.survey.lines().is_empty() { Ok(()) } else { self.release(out) }
    }
}

impl Fuser {
    /// Finds gain and delay from the lines at hand, and gives them on.
    fn release(&mut self, out: &mut Output) -> Result<()> {
        self.state = match self.found(out) {
            Some(fusion) => State::Known(Arc::new(fusion)),
            None => State::Alone,
        };
        self.survey.release().into_iter().try_for_each(|batch| out.emit(self.fused(batch)))
    }

    /// A line in which both receivers' times count alike.
    fn fused(&self, mut batch: Batch) -> Batch {
        if let State::Known(fusion) = &self.state {
            if let Content::Shots(blocks) = &mut batch.content {
                blocks.shift(Channel::HighPower, -fusion.delay_ns);
            }
            batch.fusion = Some(Arc::clone(fusion));
        }
        batch
    }

    /// Gain and delay by the lines at hand; `None` where they do not tell them, which is noted.
    fn found(&self, out: &mut Output) -> Option<ChannelFusion> {
        let one = |channel| self.survey.samples(channel).next().is_none();
        if one(Channel::LowPower) || one(Channel::HighPower) {
            out.cx.note("the recording has one receiver: there is nothing to fuse");
            return None;
        }
        let lines = self.survey.lines();
        let full_scale_dn = lines.first().and_then(|batch| batch.input.full_scale_dn).unwrap_or(u16::MAX);
        let mut pairs = Vec::new();
        for blocks in lines.iter().filter_map(Batch::blocks) {
            blocks.by_emission().for_each(|(_, of_shot)| {
                add_pairs(blocks, of_shot, f64::from(full_scale_dn), &mut pairs);
            });
        }
        let noise_dn = lead_noise_sd_dn(self.survey.samples(Channel::HighPower));
        match estimate(&pairs, f64::from(full_scale_dn), noise_dn) {
            Some(found) => Some(self.with_given(found)),
            None => {
                out.cx.note(format!(
                    "the receivers are not fused: {MIN_PAIRS} echoes that both saw well and unsaturated are needed, and of \
                     {} echoes that both saw unsaturated fewer were strong enough in the receiver for strong echoes; give \
                     gain_ratio and delay_ns",
                    pairs.len()
                ));
                None
            }
        }
    }

    /// What the job gives is taken to be exact.
    fn with_given(&self, mut fusion: ChannelFusion) -> ChannelFusion {
        if let Some(gain_ratio) = self.config.gain_ratio.number() {
            (fusion.gain_ratio, fusion.gain_ratio_sd) = (gain_ratio, 0.0);
        }
        if let Some(delay_ns) = self.config.delay_ns.number() {
            (fusion.delay_ns, fusion.delay_sd_ns) = (delay_ns, 0.0);
            fusion.walk.clear();
        }
        fusion
    }
}

/// Adds the strongest echoes of blocks that both receivers recorded at one time.
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
        // At other gains an overdriven receiver's delay belongs to another height.
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
    use crate::batch::{Emission, InputInfo};
    use crate::stage::Context;

    const INTERVAL_NS: f64 = 1.0;

    /// A Gaussian pulse above a background of 10.
    fn block(height_dn: f64, position: f64) -> Vec<u16> {
        let value =
            |k: u32| 10.0 + height_dn * (-2.772_588_722 * ((f64::from(k) - position) / 4.4).powi(2)).exp();
        (0..48).map(|k| value(k).round().min(255.0) as u16).collect()
    }

    /// Shots seen by one receiver or both: gain 5, delay 0.5 ns, block of the second 1.25 ns later.
    fn line(line: u32, shots: u32, both: bool) -> Batch {
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
        Batch::of_shots(Arc::new(input), line, vec![Emission::default(); shots as usize], blocks)
    }

    /// What comes out of the stage, and what it says.
    fn run(config: &FuseChannels, lines: Vec<Batch>) -> (Vec<Batch>, Vec<String>) {
        let mut stage = Fuser {
            config: config.clone(),
            survey: Survey::new(config.waveforms),
            state: config.given().map_or(State::Surveying, |fusion| State::Known(Arc::new(fusion))),
        };
        let (mut cx, mut given_on) = (Context::default(), Vec::new());
        let mut emit = |batch: Batch| {
            given_on.push(batch);
            Ok(())
        };
        let mut out = Output::new(&mut cx, usize::MAX, &mut emit);
        lines.into_iter().for_each(|line| stage.process(line, &mut out).unwrap());
        stage.finish(&mut out).unwrap();
        (given_on, cx.counters().notes.clone())
    }

    fn start_ns(batch: &Batch, channel: Channel) -> f64 {
        batch.blocks().unwrap().iter().find(|block| block.channel == channel).unwrap().start_ns
    }

    #[test]
    fn gain_and_delay_are_found_and_times_count_alike() {
        let (lines, notes) = run(&FuseChannels::default(), vec![line(0, 40, true), line(1, 40, true)]);
        assert_eq!(notes, [""; 0]);
        assert_eq!(lines.len(), 2);
        for batch in &lines {
            let fusion = batch.fusion.as_ref().unwrap();
            assert_eq!(fusion.pairs, 80);
            assert!((fusion.gain_ratio - 5.0).abs() < 0.05, "{fusion:?}");
            assert!((fusion.delay_ns - 0.5).abs() < 0.01, "{fusion:?}");
            assert_eq!(start_ns(batch, Channel::LowPower), 100.0);
            assert_eq!(start_ns(batch, Channel::HighPower), 101.25 - fusion.delay_ns);
        }
    }

    #[test]
    fn lines_are_held_back_only_until_there_are_enough() {
        let config = FuseChannels { waveforms: 40, ..FuseChannels::default() };
        let (lines, _) = run(&config, (0..3).map(|k| line(k, 30, true)).collect());
        assert_eq!(lines.iter().map(|batch| batch.line).collect::<Vec<_>>(), [0, 1, 2]);
        assert!(lines.iter().all(|batch| batch.fusion.as_ref().unwrap().pairs == 60));
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
        assert_eq!(notes, ["the recording has one receiver: there is nothing to fuse"]);
        assert!(lines.len() == 1 && lines[0].fusion.is_none());
    }

    #[test]
    fn too_few_echoes_say_how_many_there_were() {
        let (lines, notes) = run(&FuseChannels::default(), vec![line(0, 19, true)]);
        assert_eq!(
            notes,
            [
                "the receivers are not fused: 20 echoes that both saw well and unsaturated are needed, and of 19 echoes that \
              both saw unsaturated fewer were strong enough in the receiver for strong echoes; give gain_ratio and delay_ns"
            ]
        );
        assert!(lines[0].fusion.is_none());
        assert_eq!(start_ns(&lines[0], Channel::HighPower), 101.25);
    }
}
