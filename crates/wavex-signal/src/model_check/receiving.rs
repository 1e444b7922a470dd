//! Blocks of a receiver that does not work.

use crate::sensor_model::{Background, ChannelModel};

/// Fewest samples of a block that can show a defect.
const MIN_SAMPLES: usize = 40;
/// SD of the noise, DN, from which equal samples of a whole block cannot be chance: half of the samples
/// are then on one step, so that 40 are by chance once in 1e12 blocks of white noise.
const CERTAIN_NOISE_DN: f64 = 0.8;
/// Largest range of the samples of a block without an echo, standard deviations of the noise …
const FLAT_SD: f64 = 10.0;
/// … plus this for rounding, DN.
const FLAT_DN: f64 = 2.0;
/// Distance from the background from which a flat block is not of this receiver, in standard
/// deviations of noise and background …
const AWAY_SD: f64 = 12.0;
/// … plus this, DN.
const AWAY_DN: f64 = 3.0;

/// Why a block has no echoes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Silence {
    /// All samples are equal, although the receiver has noise.
    Constant,
    /// The samples are flat, at a level far from the background.
    AwayFromBackground,
}

/// Rule for the blocks of a channel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Receiving {
    noise_sd_dn: f64,
    level_dn: f64,
    level_sd_dn: f64,
    full_scale_dn: f64,
}

impl Receiving {
    /// Creates the rule of a channel.
    pub fn of(model: &ChannelModel) -> Receiving {
        Receiving {
            noise_sd_dn: model.noise_sd_dn,
            level_dn: model.background_dn.iter().sum::<f64>() / 4.0,
            level_sd_dn: match model.background {
                Background::Fixed => 0.0,
                // Without a prior any level is possible.
                Background::PerWaveform if model.background_sd_dn == 0.0 => f64::INFINITY,
                Background::PerWaveform => model.background_sd_dn,
            },
            full_scale_dn: model.full_scale_dn,
        }
    }

    /// Returns the defect of a block, if it has one.
    ///
    /// `range_dn` are its lowest and highest sample, `gain` its gain. A block that is clipped
    /// throughout has none.
    pub fn silence(&self, samples: usize, [lowest, highest]: [u16; 2], gain: f64) -> Option<Silence> {
        let noise_sd_dn = gain * self.noise_sd_dn;
        let [lowest, highest] = [lowest, highest].map(f64::from);
        let is_flat = highest - lowest <= FLAT_SD * noise_sd_dn + FLAT_DN;
        if samples < MIN_SAMPLES || !is_flat || lowest >= self.full_scale_dn {
            return None;
        }
        if highest == lowest && noise_sd_dn >= CERTAIN_NOISE_DN {
            return Some(Silence::Constant);
        }
        let away_dn = (0.5 * (lowest + highest) - self.level_dn).abs();
        let limit_dn = AWAY_SD * noise_sd_dn.hypot(gain * self.level_sd_dn) + AWAY_DN;
        (away_dn > limit_dn).then_some(Silence::AwayFromBackground)
    }
}
