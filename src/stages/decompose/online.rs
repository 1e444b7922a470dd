//! The instrument's own returns: as returns of shots, and against those that were computed.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::found::UNRELIABLE_RANGE_SD_M;
use crate::batch::{
    Batch, Block, Blocks, Channel, Emission, EmissionReference, InputInfo, OnlineReturn, Return, Returns,
    flags,
};
use crate::kernels::sensor_model::SensorModel;
use crate::stage::{Context, Result, StageError};

/// When the instrument's own returns become points.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum OnlinePoints {
    /// Never.
    Never,
    /// For shots without a recorded waveform.
    #[default]
    Fallback,
    /// For every shot; recorded waveforms are not decomposed.
    Only,
}

/// Why a zone is missing, and what to do.
pub(super) fn unresolved(shot: u64) -> StageError {
    StageError::failed(
        format!("it is not known which pulse caused the echoes of shot {shot}"),
        "put resolve_mta before decompose",
    )
}

/// Adds the instrument's own returns to a line's, ordered by emission, then by time.
///
/// # Errors
/// The zone of a shot is not resolved.
pub(super) fn add(
    choice: OnlinePoints,
    line: &mut Batch,
    blocks: &Blocks,
    returns: &mut Returns,
) -> Result<()> {
    if choice == OnlinePoints::Only {
        let with_echoes =
            blocks.by_emission().filter(|(_, blocks)| blocks.iter().any(|b| b.channel.is_echo()));
        let with_points = with_echoes.filter(|(shot, _)| !blocks.online_of(*shot).is_empty()).count() as u64;
        line.stats.nw_with_points += with_points;
        line.stats.nw_empty += line.stats.nw - with_points;
    }
    let before = returns.len();
    for of_shot in blocks.online.chunk_by(|a, b| a.emission == b.emission) {
        let index = of_shot[0].emission;
        let Some(emission) = line.emissions.get(index as usize) else { continue };
        let is_recorded = blocks.of_emission(index).any(|(_, block)| block.channel.is_echo());
        if choice == OnlinePoints::Never || choice == OnlinePoints::Fallback && is_recorded {
            continue;
        }
        let zone = emission.mta_zone.ok_or_else(|| unresolved(emission.shot))?;
        let first = returns.len();
        returns.extend(of_shot.iter().map(|online| return_of(online, emission, zone, &line.input)));
        returns[first..].sort_by(|a, b| a.time_of_flight_ns.total_cmp(&b.time_of_flight_ns));
        for (i, r) in returns[first..].iter_mut().enumerate() {
            r.return_number = (i + 1).min(255) as u8;
            r.number_of_returns = of_shot.len().min(255) as u8;
        }
    }
    line.stats.np_online += (returns.len() - before) as u64;
    if before > 0 && returns.len() > before {
        returns.sort_by_key(|r| r.emission);
    }
    Ok(())
}

/// A return of the instrument: its time and amplitude, and nothing else that is known.
fn return_of(online: &OnlineReturn, emission: &Emission, zone: i16, input: &InputInfo) -> Return {
    let half_speed_m_per_ns = input.group_velocity_mps * 0.5e-9;
    let within_sample_sd_ns = input.sampling_interval_ns / 12f64.sqrt();
    let range_sd_m = UNRELIABLE_RANGE_SD_M.max(half_speed_m_per_ns * within_sample_sd_ns);
    let time_of_flight_ns = online.time_ns - emission.emission_ns;
    Return {
        emission: online.emission,
        flags: flags::INSTRUMENT,
        mta_zone: zone,
        time_of_flight_ns,
        time_of_flight_sd_ns: range_sd_m / half_speed_m_per_ns,
        range_m: half_speed_m_per_ns * time_of_flight_ns,
        range_sd_m,
        width_ratio: f64::NAN,
        thickness_m: f64::NAN,
        deviation_ratio: f64::NAN,
        intensity: amplitude(online),
        ..Return::default()
    }
}

/// Sets the moments of emission without a sensor model: the clock's, or the time that an empty block of the outgoing pulse
/// carries, ns after the clock.
///
/// # Errors
/// A recorded outgoing pulse: where its peak lies is known only by a fit.
pub(super) fn date_without_model(emissions: &mut [Emission], blocks: &Blocks) -> Result<()> {
    for block in blocks.iter().filter(|block| block.channel == Channel::Reference) {
        if !block.is_empty() {
            return Err(StageError::failed(
                "ranges count from the outgoing pulses of this recording, which a sensor model is needed to find",
                "put calibrate before decompose",
            ));
        }
        if let Some(emission) = emissions.get_mut(block.emission as usize) {
            emission.emission_ns = block.start_ns;
        }
    }
    Ok(())
}

/// Compares the instrument's own returns with those that were computed from the same waveforms. Returns of both belong
/// together where neither has a nearer one, and they lie within a pulse width of each other.
pub(super) fn compare(
    blocks: &Blocks,
    line: &Batch,
    returns: &[Return],
    model: &SensorModel,
    cx: &mut Context,
) {
    let widths =
        [&model.low_power, &model.high_power].map(|of| of.as_ref().map_or(0.0, |of| of.pulse_fwhm_ns));
    let window_ns = widths[0].max(widths[1]);
    for online in blocks.online.chunk_by(|a, b| a.emission == b.emission) {
        let index = online[0].emission;
        let Some(emission) = line.emissions.get(index as usize) else { continue };
        if !blocks.of_emission(index).any(|(_, block)| block.channel.is_echo()) {
            continue;
        }
        let from = returns.partition_point(|r| r.emission < index);
        let until = returns.partition_point(|r| r.emission <= index);
        let computed = &returns[from..until];
        // Return locations count from the true departure, which `emission_ns` was found by.
        let departure_ns = match line.input.emission_reference {
            EmissionReference::ReturnLocations => 0.0,
            _ => emission.emission_ns,
        };
        let online_ns: Vec<f64> = online.iter().map(|one| one.time_ns - departure_ns).collect();
        let computed_ns: Vec<f64> = computed.iter().map(|r| r.time_of_flight_ns).collect();
        let mut matched = 0;
        for (i, &time_ns) in online_ns.iter().enumerate() {
            let pair = nearest(time_ns, &computed_ns)
                .filter(|&j| nearest(computed_ns[j], &online_ns) == Some(i))
                .filter(|&j| (time_ns - computed_ns[j]).abs() <= window_ns);
            cx.observe("online_matched", f64::from(u8::from(pair.is_some())));
            let Some(j) = pair else { continue };
            matched += 1;
            cx.observe_signed("online_minus_computed_ns", time_ns - computed_ns[j]);
            cx.observe("online_computed_distance_ns", (time_ns - computed_ns[j]).abs());
            let ratio = amplitude(&online[i]) / computed[j].amplitude_at_unit_gain_dn().0;
            if ratio.is_finite() {
                cx.observe("online_over_computed_amplitude", ratio);
            }
        }
        (0..computed.len()).for_each(|i| cx.observe("computed_matched", f64::from(u8::from(i < matched))));
    }
}

/// The amplitude in the instrument's unit; `NaN` where there is none (0 in LAS).
fn amplitude(online: &OnlineReturn) -> f64 {
    if online.amplitude > 0.0 { f64::from(online.amplitude) } else { f64::NAN }
}

/// The place of the time nearest to this one.
fn nearest(time_ns: f64, among_ns: &[f64]) -> Option<usize> {
    let distance = |i: &usize| (among_ns[*i] - time_ns).abs();
    (0..among_ns.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

/// The blocks of outgoing pulses alone.
pub(super) fn outgoing_only(blocks: &Blocks) -> Vec<Block> {
    blocks.iter().copied().filter(|block| block.channel == Channel::Reference).collect()
}
