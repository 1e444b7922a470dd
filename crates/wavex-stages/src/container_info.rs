//! Metadata and channel codes shared by `read_arrow` and `write_arrow`.

use std::path::PathBuf;

use wavex_formats::RecordedCrs;
use wavex_formats::container::{self, ContainerHeader, channel};
use wavex_line::scan_line::{
    AmplitudeTable, Channel, EmissionReference, Frame, GainControl, InputInfo, TimeScale,
};

/// Container header with the metadata of a recording; `has_fractions` as in the header.
pub(crate) fn header_of(info: &InputInfo, has_fractions: bool) -> ContainerHeader {
    let pairs = |table: &Option<AmplitudeTable>| table.as_ref().map(|table| table.pairs().to_vec());
    ContainerHeader {
        instrument: info.instrument.clone(),
        serial: info.serial.clone(),
        sampling_interval_ns: info.sampling_interval_ns,
        group_velocity_mps: info.group_velocity_mps,
        pulse_rate_hz: info.pulse_rate_hz,
        time_scale: time_scale_of(info.time_scale),
        gps_week: info.gps_week,
        frame: match info.frame {
            Frame::Scanner => container::Frame::Scanner,
            Frame::Body => container::Frame::Body,
            Frame::Map => container::Frame::Map,
            Frame::Earth => container::Frame::Earth,
        },
        crs_wkt: info.crs_wkt.clone(),
        amplitude_low: pairs(&info.amplitude_low),
        amplitude_high: pairs(&info.amplitude_high),
        range_low: pairs(&info.range_low),
        range_high: pairs(&info.range_high),
        recorded: info.recorded.filter(|_| !info.is_file_date),
        created: info.recorded.filter(|_| info.is_file_date),
        full_scale_dn: info.full_scale_dn,
        coordinate_grid: info.coordinate_grid,
        emission_reference: Some(reference_of(info.emission_reference)),
        clock_sd_ns: info.clock_sd_ns,
        emission_choice_sd_ns: Some(info.emission_choice_sd_ns).filter(|sd_ns| *sd_ns > 0.0),
        gain_control: match info.gain_control {
            GainControl::Off => None,
            GainControl::Recorded => Some(container::GainControl::Recorded),
            GainControl::NotRecorded => Some(container::GainControl::NotRecorded),
        },
        origin: match (info.origin_is_sensor, info.emission_reference) {
            (false, _) => Some(container::Origin::Waveform),
            (true, EmissionReference::ReturnLocations) => Some(container::Origin::Sensor),
            (true, _) => None,
        },
        has_fractions,
    }
}

/// Converts an emission reference to its code in the container.
pub(crate) fn reference_of(reference: EmissionReference) -> container::EmissionReference {
    match reference {
        EmissionReference::OutgoingPulse => container::EmissionReference::OutgoingPulse,
        EmissionReference::OutgoingPulseFraction => container::EmissionReference::OutgoingPulseFraction,
        EmissionReference::ReturnLocations => container::EmissionReference::ReturnLocations,
        EmissionReference::Clock => container::EmissionReference::Clock,
    }
}

/// Converts a time scale to its code in the container.
pub(crate) fn time_scale_of(time_scale: TimeScale) -> container::TimeScale {
    match time_scale {
        TimeScale::Week => container::TimeScale::Week,
        TimeScale::Day => container::TimeScale::Day,
        TimeScale::Adjusted => container::TimeScale::Adjusted,
        TimeScale::Unknown => container::TimeScale::Unknown,
    }
}

/// Metadata from a container header; `reference` is the default emission reference.
pub(crate) fn info_of(
    header: &ContainerHeader,
    path: PathBuf,
    stem: String,
    format: String,
    reference: EmissionReference,
) -> InputInfo {
    let table = |pairs: &Option<Vec<(f64, f64)>>| pairs.clone().and_then(AmplitudeTable::new);
    // Return locations come from LAS, which does not contain the sensor position.
    let is_from_las = header.emission_reference == Some(container::EmissionReference::ReturnLocations);
    let crs = RecordedCrs::new(header.crs_wkt.as_deref(), None, false, [0.0; 3]);
    InputInfo {
        full_scale_is_set: false,
        path,
        stem,
        format,
        instrument: header.instrument.clone(),
        serial: header.serial.clone(),
        first_shot: None,
        beam: None,
        beam_power: None,
        columns: Vec::new(),
        has_heights_above_ground: false,
        sampling_interval_ns: header.sampling_interval_ns,
        odd_sample_shift: 0.0,
        full_scale_dn: header.full_scale_dn,
        gain_control: match header.gain_control {
            None => GainControl::Off,
            Some(container::GainControl::Recorded) => GainControl::Recorded,
            Some(container::GainControl::NotRecorded) => GainControl::NotRecorded,
        },
        group_velocity_mps: header.group_velocity_mps,
        pulse_rate_hz: header.pulse_rate_hz,
        time_scale: match header.time_scale {
            container::TimeScale::Week => TimeScale::Week,
            container::TimeScale::Day => TimeScale::Day,
            container::TimeScale::Adjusted => TimeScale::Adjusted,
            container::TimeScale::Unknown => TimeScale::Unknown,
        },
        time_scale_is_inferred: false,
        gps_week: header.gps_week,
        recorded: header.recorded.or(header.created),
        is_file_date: header.recorded.is_none() && header.created.is_some(),
        frame: match header.frame {
            container::Frame::Scanner => Frame::Scanner,
            container::Frame::Body => Frame::Body,
            container::Frame::Map => Frame::Map,
            container::Frame::Earth => Frame::Earth,
        },
        crs_wkt: crs.wkt,
        crs_problems: crs.problems,
        coordinate_grid: header.coordinate_grid,
        emission_reference: match header.emission_reference {
            Some(container::EmissionReference::OutgoingPulse) => EmissionReference::OutgoingPulse,
            Some(container::EmissionReference::OutgoingPulseFraction) => {
                EmissionReference::OutgoingPulseFraction
            }
            Some(container::EmissionReference::ReturnLocations) => EmissionReference::ReturnLocations,
            Some(container::EmissionReference::Clock) => EmissionReference::Clock,
            None => reference,
        },
        clock_sd_ns: header.clock_sd_ns,
        emission_choice_sd_ns: header.emission_choice_sd_ns.unwrap_or(0.0),
        origin_is_sensor: match header.origin {
            Some(origin) => origin == container::Origin::Sensor,
            None => !is_from_las,
        },
        amplitude_low: table(&header.amplitude_low),
        amplitude_high: table(&header.amplitude_high),
        range_low: table(&header.range_low),
        range_high: table(&header.range_high),
    }
}

/// Code of a channel in a container.
pub(crate) fn code_of(receiver: Channel) -> u8 {
    match receiver {
        Channel::HighPower => channel::HIGH_POWER,
        Channel::LowPower => channel::LOW_POWER,
        Channel::Saturation => channel::SATURATION,
        Channel::Reference => channel::REFERENCE,
    }
}

/// Channel of a code; `None` for an unknown code.
pub(crate) fn channel_of(code: u8) -> Option<Channel> {
    match code {
        channel::HIGH_POWER => Some(Channel::HighPower),
        channel::LOW_POWER => Some(Channel::LowPower),
        channel::SATURATION => Some(Channel::Saturation),
        channel::REFERENCE => Some(Channel::Reference),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_count_as_in_the_container() {
        let channels = [0, 1, 2, 3, 4, 255].map(channel_of);
        let expected =
            [Channel::HighPower, Channel::LowPower, Channel::Saturation, Channel::Reference].map(Some);
        assert_eq!(channels[..4], expected);
        assert_eq!(channels[4..], [None, None]);
        assert_eq!(expected.map(|channel| code_of(channel.unwrap())), [0, 1, 2, 3]);
    }
}
