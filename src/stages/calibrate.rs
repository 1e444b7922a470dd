//! What the sensor is like, found from the recording itself.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::batch::{Batch, Channel, InputInfo, Kind};
use crate::kernels::calibrate::{self, BackgroundChoice, Block, CalibrationError, CalibrationSettings};
use crate::kernels::sensor_model::{ChannelModel, SensorModel};
use crate::stage::{
    Config, InvalidKey, Output, Result, Site, StageError, StageSpec, Transform, TransformConfig,
};

/// The stage's place in the registry.
pub const STAGE: StageSpec = StageSpec::transform::<Calibrate>("calibrate", &[Kind::Shots]);

/// Finds, from the first waveforms, what `decompose` must know of the sensor: for each receiver the background (by sample
/// index modulo 4, or one per waveform where no sample is free of signal), the noise and its correlation, and the width of
/// a pulse from a flat target. Noise is told from signal by fitted pulses, never by a threshold on samples.
///
/// Holds back the first lines until it has enough waveforms, then lets everything through; the model travels with every
/// line, and stands in the report. Fewer than 200 waveforms of the sensitive receiver are an error. A receiver of which
/// there are fewer, or an outgoing pulse that was recorded fewer than 20 times, is left out, and the report says so.
#[derive(Clone, Debug, Deserialize, Serialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Calibrate {
    /// How many waveforms to calibrate from; fewer where the input has fewer, or where `memory_mb` does not hold them.
    pub waveforms: u64,
    /// The background of a waveform: the receiver's (`fixed`), its own (`per_waveform`), or decided from the data (`auto`).
    pub background: BackgroundKey,
}

/// Where the background comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum BackgroundKey {
    /// Fixed where samples are free of signal, else per waveform.
    Auto,
    /// The receiver's, by sample index modulo 4.
    Fixed,
    /// A free parameter of each waveform.
    PerWaveform,
}

impl Default for Calibrate {
    fn default() -> Calibrate {
        Calibrate { waveforms: 100_000, background: BackgroundKey::Auto }
    }
}

impl Config for Calibrate {
    fn check(&self) -> std::result::Result<(), InvalidKey> {
        InvalidKey::unless(self.waveforms >= 200, "waveforms", "at least 200 waveforms are needed")
    }
}

impl TransformConfig for Calibrate {
    fn make(&self, _site: &Site) -> Result<Box<dyn Transform>> {
        Ok(Box::new(Calibrator {
            config: self.clone(),
            held: Vec::new(),
            held_bytes: 0,
            waveforms: 0,
            model: None,
        }))
    }
}

struct Calibrator {
    config: Calibrate,
    held: Vec<Batch>,
    held_bytes: usize,
    waveforms: u64,
    model: Option<Arc<SensorModel>>,
}

impl Transform for Calibrator {
    fn process(&mut self, mut batch: Batch, out: &mut Output) -> Result<()> {
        if let Some(model) = &self.model {
            batch.model = Some(Arc::clone(model));
            return out.emit(batch);
        }
        self.waveforms += batch.stats.nw;
        self.held_bytes += batch.bytes();
        self.held.push(batch);
        let full = self.held_bytes > out.may_hold_bytes();
        if full && self.waveforms < self.config.waveforms {
            out.cx.note(format!(
                "calibrated from {} waveforms instead of {}: more do not fit into memory_mb",
                self.waveforms, self.config.waveforms
            ));
        }
        if full || self.waveforms >= self.config.waveforms { self.release(out) } else { Ok(()) }
    }

    fn finish(&mut self, out: &mut Output) -> Result<()> {
        if self.held.is_empty() { Ok(()) } else { self.release(out) }
    }
}

impl Calibrator {
    /// Calibrates from the lines at hand, and gives them on.
    fn release(&mut self, out: &mut Output) -> Result<()> {
        let model = Arc::new(self.calibrate(out)?);
        self.model = Some(Arc::clone(&model));
        for mut batch in std::mem::take(&mut self.held) {
            batch.model = Some(Arc::clone(&model));
            out.emit(batch)?;
        }
        Ok(())
    }

    fn calibrate(&self, out: &mut Output) -> Result<SensorModel> {
        let low_power = self.channel(Channel::LowPower, out)?;
        let high_power = self.channel(Channel::HighPower, out)?;
        let reference = self.channel(Channel::Reference, out)?;
        if low_power.is_none() && high_power.is_none() {
            let found = self.count(Channel::LowPower).max(self.count(Channel::HighPower));
            let needed = self.settings(Channel::LowPower).min_blocks;
            let error = CalibrationError::TooFewBlocks { found, needed };
            return Err(failed(Channel::LowPower, &error));
        }
        Ok(SensorModel { low_power, high_power, saturation: None, reference })
    }

    /// The model of one receiver; `None` where it recorded too little, which the report then says.
    fn channel(&self, channel: Channel, out: &mut Output) -> Result<Option<ChannelModel>> {
        let settings = self.settings(channel);
        match calibrate::calibrate(self.blocks(channel), &settings) {
            Ok(model) => Ok(Some(model)),
            Err(CalibrationError::TooFewBlocks { found: 0, .. }) => Ok(None),
            Err(error @ CalibrationError::TooFewBlocks { .. }) => {
                out.cx.note(format!("{} was not calibrated and is not used: {error}", name(channel)));
                Ok(None)
            }
            Err(error) => Err(failed(channel, &error)),
        }
    }

    fn settings(&self, channel: Channel) -> CalibrationSettings {
        let unknown = InputInfo::default();
        let input = self.held.first().map_or(&unknown, |batch| &batch.input);
        let full_scale_dn = f64::from(input.full_scale_dn.unwrap_or(u16::MAX));
        let settings = match channel {
            Channel::Reference => CalibrationSettings::reference(input.sampling_interval_ns, full_scale_dn),
            _ => CalibrationSettings::echoes(input.sampling_interval_ns, full_scale_dn),
        };
        match (channel, self.config.background) {
            (Channel::Reference, _) | (_, BackgroundKey::Auto) => settings,
            (_, BackgroundKey::Fixed) => {
                CalibrationSettings { background: BackgroundChoice::Fixed, ..settings }
            }
            (_, BackgroundKey::PerWaveform) => {
                CalibrationSettings { background: BackgroundChoice::PerWaveform, ..settings }
            }
        }
    }

    /// The blocks of one receiver in the lines at hand.
    fn blocks(&self, channel: Channel) -> impl Iterator<Item = Block<'_>> + Clone {
        let lines = self.held.iter().filter_map(Batch::blocks);
        lines.flat_map(move |blocks| {
            let of_channel = blocks.iter().filter(move |block| block.channel == channel && !block.is_empty());
            of_channel.map(|block| Block { samples: blocks.samples(block), start_phase: 0 })
        })
    }

    fn count(&self, channel: Channel) -> u64 {
        self.blocks(channel).count() as u64
    }
}

fn name(channel: Channel) -> &'static str {
    match channel {
        Channel::HighPower => "the high power receiver",
        Channel::LowPower => "the low power receiver",
        Channel::Saturation => "the saturation receiver",
        Channel::Reference => "the outgoing pulse",
    }
}

fn failed(channel: Channel, error: &CalibrationError) -> StageError {
    let text = format!("{}: {error}", name(channel));
    match text.rsplit_once("; ") {
        Some((problem, remedy)) => StageError::failed(problem, remedy),
        None => StageError::failed(text, "calibrate on another part of the recording"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::{Blocks, Emission};
    use crate::stage::Context;

    /// Lines of noise-like samples, too few to calibrate from.
    fn line(line: u32, shots: u32) -> Batch {
        let mut blocks = Blocks::default();
        (0..shots).for_each(|shot| blocks.push(shot, Channel::LowPower, None, 0.0, 1.0, &[2, 3, 2, 1, 2, 3]));
        let emissions = vec![Emission::default(); shots as usize];
        Batch::of_shots(Arc::new(InputInfo::default()), line, emissions, blocks)
    }

    #[test]
    fn too_few_waveforms_say_how_many_there_were() {
        let mut calibrator = Calibrator {
            config: Calibrate::default(),
            held: Vec::new(),
            held_bytes: 0,
            waveforms: 0,
            model: None,
        };
        let mut cx = Context::default();
        let mut emit = |_: Batch| Ok(());
        let mut out = Output::new(&mut cx, usize::MAX, &mut emit);
        calibrator.process(line(0, 70), &mut out).unwrap();
        calibrator.process(line(1, 53), &mut out).unwrap();
        let error = calibrator.finish(&mut out).unwrap_err().to_string();
        assert_eq!(
            error,
            "the low power receiver: calibration needs 200 waveforms of the channel and there were 123; \
             give it more data, or load a saved sensor model"
        );
    }
}
