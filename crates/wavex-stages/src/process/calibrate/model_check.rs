//! Compares the model with the first lines, and checks the receivers along the recording.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::{Calibrator, ECHOES, failed, name};
use wavex_line::scan_line::{Channel, Content, ScanLine};
use wavex_line::stage::{Output, Reason, Result, StageError};
use wavex_signal::calibrate::receiver_limits;
use wavex_signal::decompose::Waveform;
use wavex_signal::gain::GainLevel;
use wavex_signal::model_check::{Area, Comparison, KernelContext, Receiving, Running, Silence, compare};
use wavex_signal::sensor_model::{ChannelModel, ModelError, SensorModel};

/// Number of waveforms with which a given model is compared before the first line is emitted.
pub(super) const CHECKED_WAVEFORMS: u64 = 2_000;

/// State of one receiver along a recording.
#[derive(Default)]
pub(super) struct ReceiverCheck {
    receiving: Option<Receiving>,
    running: Running,
    blocks: u64,
    constant: u64,
    away: u64,
}

impl ReceiverCheck {
    /// Lets the next block take the rule for silent blocks from the model then in use.
    pub(super) fn forget_rule(&mut self) {
        self.receiving = None;
    }
}

impl Calibrator {
    /// Removes the blocks of receivers that do not work, which would give returns without echoes.
    pub(super) fn remove_silent_blocks(&mut self, line: &mut ScanLine, out: &mut Output) {
        let Some(model) = self.in_use.as_ref().or(self.model.as_ref()) else { return };
        let Content::Shots(blocks) = &mut line.content else { return };
        let checks = &mut self.checks;
        for (check, channel) in checks.iter_mut().zip(ECHOES) {
            check.receiving = check.receiving.or_else(|| of_channel(model, channel).map(Receiving::of));
        }
        let (mut constant, mut away) = (0, 0);
        blocks.retain(|block, samples| {
            let Some(index) = ECHOES.iter().position(|channel| *channel == block.channel) else {
                return true;
            };
            let check = &mut checks[index];
            let Some(receiving) = check.receiving.filter(|_| !samples.is_empty()) else { return true };
            check.blocks += 1;
            // Two passes, each of which the compiler turns into vector instructions.
            let lowest = samples.iter().fold(u16::MAX, |low, &dn| low.min(dn));
            let range_dn = [lowest, samples.iter().fold(0, |high, &dn| high.max(dn))];
            let silence = receiving.silence(samples.len(), range_dn, block.gain);
            match silence {
                Some(Silence::Constant) => (constant, check.constant) = (constant + 1, check.constant + 1),
                Some(Silence::AwayFromBackground) => (away, check.away) = (away + 1, check.away + 1),
                None if block.gain == 1.0 => check.running.add(samples, range_dn[1]),
                None => {}
            }
            silence.is_none()
        });
        if constant + away > 0 {
            line.stats.nw = blocks.waveforms() as u64;
            out.cx.reject(Reason::DeadReceiver, constant);
            out.cx.reject(Reason::FlatSamples, away);
        }
    }

    /// The model for the recording: the model of the stage, or one with the measured noise and background.
    ///
    /// Only a given model is changed; one that was calibrated from the recording is not.
    pub(super) fn checked(&self, is_given: bool, out: &mut Output) -> Result<Option<Arc<SensorModel>>> {
        let Some(model) = &self.model else { return Ok(None) };
        let mut changed = SensorModel::clone(model);
        let receivers =
            [(Channel::LowPower, &mut changed.low_power), (Channel::HighPower, &mut changed.high_power)];
        for (channel, of_receiver) in receivers {
            let Some(known) = of_receiver.as_mut() else { continue };
            let level = self.usual_gain(channel);
            let compared =
                self.comparison(channel, known, level).map_err(|error| unusable(channel, &error))?;
            let Some(compared) = compared else { continue };
            let is_adapted = is_given && level == GainLevel::UNIT;
            let in_use = if is_adapted { compared.model_in_use(known) } else { Ok(None) };
            let in_use = in_use.map_err(|error| unusable(channel, &error))?;
            report(channel, &compared, known, in_use.as_ref().unwrap_or(known), is_given, out);
            if let Some(in_use) = in_use {
                *known = in_use;
            }
            if is_adapted {
                self.prove_linear(channel, known, out)?;
            }
        }
        let is_same = changed == **model;
        Ok(Some(if is_same { Arc::clone(model) } else { Arc::new(changed) }))
    }

    /// Completes a given model, if the echoes prove that its receiver is linear up to full scale.
    ///
    /// The recording from which the model was made may have had no such echoes.
    fn prove_linear(&self, channel: Channel, model: &mut ChannelModel, out: &mut Output) -> Result<()> {
        let limits = &model.limits;
        let is_known = limits.is_linear || limits.overdriven_dn.is_some();
        if is_known || model.response.is_none() || self.gain_changes(channel) {
            return Ok(());
        }
        let settings = self.settings(channel);
        let found = self.in_pool(|| receiver_limits(self.blocks(channel), model, &settings));
        if found.map_err(|error| failed(channel, &error))?.is_linear {
            model.limits.is_linear = true;
            out.cx.info(format!(
                "{} is linear up to full scale, as its strongest echoes show; the sensor model does not say so",
                name(channel)
            ));
        }
        Ok(())
    }

    /// Compares the model of a receiver with the held blocks of one gain.
    fn comparison(
        &self,
        channel: Channel,
        model: &ChannelModel,
        level: GainLevel,
    ) -> std::result::Result<Option<Comparison>, ModelError> {
        let of_gain =
            self.look_ahead.recorded(channel).filter(move |block| GainLevel::of(block.gain) == level);
        let blocks = of_gain.map(|block| Waveform { samples: block.samples });
        let with = KernelContext { simd: self.simd, tables: self.config.shared.tables.clone() };
        compare(blocks, &model.at_gain(level.gain())?, &with)
    }

    /// The gain of most of the held blocks of a receiver.
    fn usual_gain(&self, channel: Channel) -> GainLevel {
        let mut counts = BTreeMap::<GainLevel, u64>::new();
        for block in self.look_ahead.recorded(channel) {
            *counts.entry(GainLevel::of(block.gain)).or_default() += 1;
        }
        counts.into_iter().max_by_key(|(_, count)| *count).map_or(GainLevel::UNIT, |(level, _)| level)
    }

    /// Warns of receivers that changed along the recording, or did not work.
    pub(super) fn conclude_checks(&mut self, out: &mut Output) {
        let Some(model) = &self.in_use else { return };
        for (check, channel) in self.checks.iter().zip(ECHOES) {
            let ReceiverCheck { blocks, constant, away, .. } = *check;
            for (n, problem) in [
                (constant, "whose samples are all equal"),
                (away, "with flat samples far from the background"),
            ] {
                if n > 0 {
                    out.cx.warn(format!(
                        "{} did not work or does not belong to the sensor model: {n} of its {blocks} blocks, \
                         {problem}, have no returns; check the receiver, or calibrate from this recording",
                        name(channel)
                    ));
                }
            }
            let Some(known) = of_channel(model, channel) else { continue };
            for finding in check.running.findings(known) {
                // The comparison with the first lines may have said the same of fewer blocks.
                let is_known = |note: &String| note.starts_with(name(channel)) && note.contains(FULL_SCALE);
                if finding.area != Area::FullScale || !out.cx.counters().notes.iter().any(is_known) {
                    out.cx.warn(format!("{}: {finding}", name(channel)));
                }
            }
        }
    }
}

/// Part of the text of a finding on the clipping level.
const FULL_SCALE: &str = "clipping level";

/// Remedy if a recording contradicts the model that was calibrated from it.
const CONTRADICTED: &str =
    "the recording contradicts its own calibration; look at single shots with `wavex explain`";

/// Warns of the differences between model and recording, and says what the run uses instead.
fn report(
    channel: Channel,
    compared: &Comparison,
    known: &ChannelModel,
    in_use: &ChannelModel,
    is_given: bool,
    out: &mut Output,
) {
    let has_own_noise = (in_use.noise_sd_dn, &in_use.ar) != (known.noise_sd_dn, &known.ar);
    let has_free_background =
        (in_use.background, in_use.background_sd_dn) != (known.background, known.background_sd_dn);
    let has_larger_errors = in_use.pulse_error_factor > known.pulse_error_factor;
    for finding in &compared.findings {
        let adapted = match finding.area {
            Area::Noise | Area::Correlation if has_own_noise => "; this run uses the measured noise",
            Area::Background if has_free_background => "; this run fits the background of each waveform",
            Area::PulseWidth | Area::PulseShape | Area::TemplateError if has_larger_errors => {
                "; standard deviations are raised by the misfit"
            }
            _ => "",
        };
        let finding = finding.to_string();
        // The remedies, the last clause, are for a model from elsewhere.
        let finding = match finding.rsplit_once(": ").filter(|_| !is_given) {
            Some((figures, _)) => format!("{figures}: {CONTRADICTED}"),
            None => finding,
        };
        out.cx.warn(format!("{}: {finding}{adapted} ({} waveforms)", name(channel), compared.waveforms));
    }
}

fn of_channel(model: &SensorModel, channel: Channel) -> Option<&ChannelModel> {
    match channel {
        Channel::LowPower => model.low_power.as_ref(),
        Channel::HighPower => model.high_power.as_ref(),
        Channel::Saturation | Channel::Reference => None,
    }
}

fn unusable(channel: Channel, error: &ModelError) -> StageError {
    StageError::failed(format!("{}: {error}", name(channel)), "load another sensor model, or calibrate")
}
