//! The instrument's own returns: conversion, and comparison with computed returns.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::echo::UNRELIABLE_RANGE_SD_M;
use wavex_line::scan_line::{
    Block, Blocks, Channel, Emission, EmissionReference, InputInfo, OnlineReturn, Return, Returns, ScanLine,
    flags,
};
use wavex_line::stage::{Context, Result, StageError};
use wavex_signal::sensor_model::SensorModel;

/// Use of the instrument's own returns.
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

/// Error for a shot without a resolved zone.
pub(super) fn unresolved(shot: u64) -> StageError {
    StageError::failed(
        format!("the pulse that caused the echoes of shot {shot} is unknown"),
        "put resolve_mta before decompose",
    )
}

/// Adds the instrument's own returns to a line, by shot and time.
///
/// # Errors
/// The zone of a shot is not resolved.
pub(super) fn add(
    choice: OnlinePoints,
    line: &mut ScanLine,
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

/// Converts a return of the instrument.
///
/// Only time and amplitude are known.
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

/// Sets emission times without a sensor model, ns after the clock.
///
/// 0, or the time stored in an empty block of the outgoing pulse.
///
/// # Errors
/// An outgoing pulse with samples: its peak requires a fit.
pub(super) fn date_without_model(emissions: &mut [Emission], blocks: &Blocks) -> Result<()> {
    for block in blocks.iter().filter(|block| block.channel == Channel::Reference) {
        if !block.is_empty() {
            return Err(StageError::failed(
                "ranges count from the outgoing pulses of this recording, and fitting them requires a sensor model",
                "put calibrate before decompose",
            ));
        }
        if let Some(emission) = emissions.get_mut(block.emission as usize) {
            emission.emission_ns = block.start_ns;
        }
    }
    Ok(())
}

/// Compares the instrument's own returns with computed returns of the same waveforms.
///
/// Two returns match if each is the nearest to the other and they are within a pulse width.
pub(super) fn compare(
    blocks: &Blocks,
    line: &ScanLine,
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
        // Return locations count from the true emission, and `emission_ns` is derived from them.
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

/// Amplitude in the instrument's unit; NaN if unknown (0 in LAS).
fn amplitude(online: &OnlineReturn) -> f64 {
    if online.amplitude > 0.0 { f64::from(online.amplitude) } else { f64::NAN }
}

/// Index of the nearest time.
fn nearest(time_ns: f64, among_ns: &[f64]) -> Option<usize> {
    let distance = |i: &usize| (among_ns[*i] - time_ns).abs();
    (0..among_ns.len()).min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

/// Returns the blocks of outgoing pulses.
pub(super) fn outgoing_only(blocks: &Blocks) -> Vec<Block> {
    blocks.iter().copied().filter(|block| block.channel == Channel::Reference).collect()
}
