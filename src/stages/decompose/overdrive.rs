//! Standard deviations of overdriven and clipped pulses.

use super::Decompose;
use crate::scan_line::{Block, Blocks, ReturnChannel};
use crate::stage::{Result, StageError};
use wavex_signal::decompose::{DecomposeSettings, Decomposition, Flanks, OverdriveErrors, Waveform};
use wavex_signal::sensor_model::{ChannelModel, SensorModel};

/// Tests of the flanks, by receiver.
pub(super) struct Overdrive {
    low_power: Option<Flanks>,
    high_power: Option<Flanks>,
}

impl Overdrive {
    pub(super) fn new(model: &SensorModel, config: &Decompose) -> Result<Overdrive> {
        let recovery_samples = DecomposeSettings::default().recovery_samples;
        let flanks = |channel: &Option<ChannelModel>| {
            let made =
                channel.as_ref().map(|model| Flanks::new(model, config.template_error, recovery_samples));
            made.transpose().map_err(|error| StageError::failed(error.to_string(), "recalibrate"))
        };
        Ok(Overdrive { low_power: flanks(&model.low_power)?, high_power: flanks(&model.high_power)? })
    }

    /// Errors of the overdriven and clipped pulses of a block.
    ///
    /// `model` is that of the channel at the gain of the block.
    pub(super) fn errors(
        &mut self,
        blocks: &Blocks,
        block: &Block,
        channel: ReturnChannel,
        found: &Decomposition,
        model: &ChannelModel,
    ) -> OverdriveErrors {
        let flanks = match channel {
            ReturnChannel::High => &mut self.high_power,
            _ => &mut self.low_power,
        };
        match flanks.as_mut().filter(|_| block.gain == 1.0) {
            Some(flanks) => {
                flanks.overdrive_errors(Waveform { samples: blocks.samples(block), start_phase: 0 }, found)
            }
            None => OverdriveErrors::of_receiver(model),
        }
    }
}
