//! Relative heights of the energy of a shot above its ground.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::shot::{BLINDED, EmissionTime};
use super::{Decompose, Mode};
use crate::process::calibrate::Auto;
use wavex_line::scan_line::{Block, Blocks, InputInfo, LARGE_FOOTPRINT_NS, ReturnChannel, ShotProfile};
use wavex_line::stage::{Result, StageError};
use wavex_signal::decompose::Decomposition;
use wavex_signal::distributed::{DistributedTargets, TargetProfile, WithSd};
use wavex_signal::sensor_model::{ChannelModel, SensorModel};

/// Deviation ratio of the pulses above which a waveform gets a profile.
///
/// Noise alone exceeds it in 0.003 % of waveforms.
const UNEXPLAINED: f64 = 5.0;
/// Waveforms with relative heights.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(untagged)]
pub enum ProfilesKey {
    /// All, or none.
    Fixed(bool),
    /// Those of large-footprint recordings, and unexplained ones.
    Auto(Auto),
}

impl ProfilesKey {
    /// Whether waveforms of this length get relative heights.
    fn includes(self, length_ns: f64, is_unexplained: impl FnOnce() -> bool) -> bool {
        match self {
            ProfilesKey::Fixed(is_wanted) => is_wanted,
            ProfilesKey::Auto(_) => length_ns >= LARGE_FOOTPRINT_NS || is_unexplained(),
        }
    }
}

impl Default for ProfilesKey {
    fn default() -> ProfilesKey {
        ProfilesKey::Auto(Auto::Auto)
    }
}

/// Estimators of both receivers, and the profile of the current shot.
pub(super) struct Profiles {
    low_power: Option<DistributedTargets>,
    high_power: Option<DistributedTargets>,
    choice: ProfilesKey,
    /// Whether misfits are caused by the target; in the fast modes the fit causes some.
    has_fits: bool,
    timing_error_ns: f64,
    of_shot: Option<(Block, TargetProfile)>,
}

impl Profiles {
    /// Estimators for a sensor; none if the job does not want profiles.
    pub(super) fn new(model: &SensorModel, config: &Decompose) -> Result<Profiles> {
        let choice = config.distributed_targets;
        let estimator = |channel: &Option<ChannelModel>| {
            let wanted = channel.as_ref().filter(|_| choice != ProfilesKey::Fixed(false));
            let made = wanted.map(DistributedTargets::new);
            made.transpose().map_err(|error| StageError::failed(error.to_string(), "recalibrate"))
        };
        Ok(Profiles {
            low_power: estimator(&model.low_power)?,
            high_power: estimator(&model.high_power)?,
            choice,
            has_fits: matches!(config.mode, Mode::Refined | Mode::Slow),
            timing_error_ns: config.timing_error_ns,
            of_shot: None,
        })
    }

    /// Whether the pulses do not explain a waveform.
    ///
    /// The misfit of overdriven pulses is the receiver's, not the target's.
    fn is_unexplained(&self, pulses: &Decomposition) -> bool {
        self.has_fits
            && pulses.deviation_ratio() > UNEXPLAINED
            && pulses.returns.iter().all(|found| found.flags & BLINDED == 0)
    }

    /// Estimates the profile of a block, if it is wanted.
    ///
    /// Of several blocks of a shot, the one with the most energy counts.
    pub(super) fn add(
        &mut self,
        blocks: &Blocks,
        block: &Block,
        channel: ReturnChannel,
        pulses: &Decomposition,
    ) {
        let length_ns = block.len() as f64 * block.interval_ns;
        if block.gain != 1.0 || !self.choice.includes(length_ns, || self.is_unexplained(pulses)) {
            return;
        }
        let estimator = match channel {
            ReturnChannel::High => &mut self.high_power,
            _ => &mut self.low_power,
        };
        let Some(estimator) = estimator else { return };
        let profile = estimator.profile(blocks.samples(block), pulses.background_offset_dn);
        let is_stronger = |profile: &TargetProfile| {
            self.of_shot.as_ref().is_none_or(|(_, best)| {
                let [value, best] = [profile, best].map(|of| of.energy_dn.value);
                best.is_nan() || value > best
            })
        };
        if let Some(profile) = profile.filter(is_stronger) {
            self.of_shot = Some((*block, profile));
        }
    }

    /// The profile of the shot in ranges; the next shot has none yet.
    pub(super) fn take(
        &mut self,
        emission: u32,
        departure: EmissionTime,
        input: &InputInfo,
    ) -> Option<ShotProfile> {
        let (block, profile) = self.of_shot.take()?;
        let half_speed_m_per_ns = 0.5e-9 * input.group_velocity_mps;
        let m_per_sample = half_speed_m_per_ns * block.interval_ns;
        let of_time_ns = departure.sd_ns.hypot(self.timing_error_ns);
        let range = |position: WithSd| WithSd {
            value: half_speed_m_per_ns * (block.time_ns(position.value) - departure.time_ns),
            sd: (m_per_sample * position.sd).hypot(half_speed_m_per_ns * of_time_ns),
        };
        let height =
            |height: WithSd| WithSd { value: m_per_sample * height.value, sd: m_per_sample * height.sd };
        Some(ShotProfile {
            emission,
            first_range_m: range(profile.first_peak_samples),
            last_range_m: range(profile.last_peak_samples),
            peaks: profile.peaks,
            heights_m: profile.heights_samples.map(height),
            top_m: height(profile.top_samples),
            energy_dn: profile.energy_dn,
            flags: profile.flags,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_and_unexplained_waveforms_have_heights_by_default() {
        let by_default = ProfilesKey::default();
        assert!(by_default.includes(864.0, || false) && by_default.includes(60.0, || true));
        assert!(!by_default.includes(256.0, || false));
        assert!(ProfilesKey::Fixed(true).includes(60.0, || false));
        assert!(!ProfilesKey::Fixed(false).includes(864.0, || true));
    }
}
