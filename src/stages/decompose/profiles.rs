//! Profiles of waveforms that pulses do not explain.

use super::shots::EmissionTime;
use super::{Decompose, Mode};
use crate::scan_line::{Block, Blocks, InputInfo, ReturnChannel, ShotProfile, flags};
use crate::stage::{Result, StageError};
use wavex_signal::decompose::Decomposition;
use wavex_signal::distributed::{DistributedTargets, TargetProfile, WithSd};
use wavex_signal::sensor_model::{ChannelModel, SensorModel};

/// Deviation ratio of the pulses above which a waveform gets a profile.
///
/// Noise alone exceeds it in 0.003 % of waveforms, and 3 in 0.3 %: their profiles would take longer
/// than the pulses of all others.
const UNEXPLAINED: f64 = 5.0;

/// Estimators of both receivers, and the profile of the current shot.
pub(super) struct Profiles {
    low_power: Option<DistributedTargets>,
    high_power: Option<DistributedTargets>,
    timing_error_ns: f64,
    of_shot: Option<(Block, TargetProfile)>,
}

impl Profiles {
    /// Estimators for a sensor; none if the job does not want profiles, or in a fast mode.
    pub(super) fn new(model: &SensorModel, config: &Decompose) -> Result<Profiles> {
        let is_wanted = config.distributed_targets && matches!(config.mode, Mode::Refined | Mode::Slow);
        let estimator = |channel: &Option<ChannelModel>| {
            let wanted = channel.as_ref().filter(|_| is_wanted);
            let made = wanted.map(|channel| DistributedTargets::new(channel, config.template_error));
            made.transpose().map_err(|error| StageError::failed(error.to_string(), "recalibrate"))
        };
        Ok(Profiles {
            low_power: estimator(&model.low_power)?,
            high_power: estimator(&model.high_power)?,
            timing_error_ns: config.timing_error_ns,
            of_shot: None,
        })
    }

    /// Estimates the profile of a block that its pulses do not explain.
    ///
    /// The misfit of overdriven pulses is the receiver's, not the target's. Of several blocks of a
    /// shot, the one with the most energy counts.
    pub(super) fn add(
        &mut self,
        blocks: &Blocks,
        block: &Block,
        channel: ReturnChannel,
        pulses: &Decomposition,
    ) {
        const OF_RECEIVER: u16 = flags::OVERDRIVEN | flags::SATURATED | flags::EXTREMELY_SATURATED;
        let estimator = match channel {
            ReturnChannel::High => &mut self.high_power,
            _ => &mut self.low_power,
        };
        let is_of_receiver = || pulses.returns.iter().any(|found| found.flags & OF_RECEIVER != 0);
        let Some(estimator) = estimator
            .as_mut()
            .filter(|_| block.gain == 1.0 && pulses.deviation_ratio() > UNEXPLAINED && !is_of_receiver())
        else {
            return;
        };
        let profile = estimator.profile(blocks.samples(block), 0, pulses.background_offset_dn);
        let energy_dn = |profile: &TargetProfile| profile.energy_dn.value;
        let most_dn = self.of_shot.as_ref().map_or(0.0, |(_, profile)| energy_dn(profile));
        if let Some(profile) = profile
            && profile.deviation_ratio < pulses.deviation_ratio()
            && energy_dn(&profile) > most_dn
        {
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
            energy_dn: profile.energy_dn,
            deviation_ratio: profile.deviation_ratio,
        })
    }
}
