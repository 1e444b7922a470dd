//! Metadata of a PulseWaves recording.

use std::path::Path;

use crate::reading::recording::units::RecordingUnits;
use wavex_formats::pulsewaves::{Reader, SegmentKind, TimeAxis};
use wavex_formats::{RecordedCrs, geokeys};
use wavex_geodesy::beam_length::BeamLength;
use wavex_geodesy::crs::GeoKeys;
use wavex_line::scan_line::{AmplitudeTable, EmissionReference, Frame, GainControl, InputInfo, TimeScale};

/// Metadata of a recording from its header and records.
pub(super) fn describe(
    reader: &Reader,
    path: &Path,
    stem: &str,
    beams: &BeamLength,
    (units, crs, around_earth): (RecordingUnits, RecordedCrs, bool),
) -> InputInfo {
    let header = reader.header();
    let scanner = reader.scanners().values().next();
    let text = |text: &String| Some(text.clone()).filter(|text| !text.is_empty());
    let samplings = || reader.descriptors().values().flat_map(|descriptor| &descriptor.samplings);
    let mut outgoing = samplings().filter(|sampling| sampling.kind == SegmentKind::Outgoing).peekable();
    let emission_reference =
        match (outgoing.peek().is_some(), outgoing.all(|sampling| sampling.duration_bits > 0)) {
            (false, _) => EmissionReference::Clock,
            (true, true) => EmissionReference::OutgoingPulse,
            (true, false) => EmissionReference::OutgoingPulseFraction,
        };
    // RIEGL's own export names WGS 84 but stores geocentric coordinates.
    let is_geocentric = around_earth || is_geocentric(reader);
    let (mut scale, mut offset) = (header.scale, header.offset);
    scale[2] *= units.height_factor;
    offset[2] *= units.height_factor;
    let bits = samplings().map(|sampling| sampling.bits_per_sample).max();
    InputInfo {
        full_scale_is_set: false,
        path: path.to_path_buf(),
        stem: stem.to_string(),
        format: format!("PulseWaves {}.{}", header.version.0, header.version.1),
        instrument: scanner.and_then(|scanner| text(&scanner.instrument)),
        serial: scanner.and_then(|scanner| text(&scanner.serial)),
        odd_sample_shift: 0.0,
        sampling_interval_ns: samplings().map(|s| s.sample_units_ns).find(|ns| *ns > 0.0).unwrap_or(1.0),
        full_scale_dn: (bits == Some(8)).then_some(255),
        gain_control: GainControl::Off,
        group_velocity_mps: beams.vertical().map_or(GROUP_VELOCITY_MPS, |per_ns| per_ns * units.map_m * 2e9),
        pulse_rate_hz: scanner.map(|s| s.pulse_frequency_khz * 1e3).filter(|hz| *hz > 0.0),
        time_scale: match header.time_axis() {
            TimeAxis::WeekSeconds => TimeScale::Week,
            TimeAxis::Standard => TimeScale::Adjusted,
            TimeAxis::Undecided => TimeScale::Unknown,
        },
        time_scale_is_inferred: header.time_axis() != TimeAxis::Undecided,
        gps_week: None,
        recorded: (header.creation_year > 0).then_some((header.creation_day, header.creation_year)),
        is_file_date: header.creation_year > 0,
        frame: if is_geocentric { Frame::Earth } else { Frame::Map },
        crs_wkt: crs.wkt.filter(|_| !is_geocentric),
        crs_problems: if is_geocentric { Vec::new() } else { crs.problems },
        coordinate_grid: Some((scale, offset)),
        emission_reference,
        clock_sd_ns: None,
        emission_choice_sd_ns: 0.0,
        origin_is_sensor: anchors_are_sensor(reader),
        first_shot: None,
        beam: None,
        beam_power: None,
        columns: Vec::new(),
        has_heights_above_ground: false,
        amplitude_low: amplitude_table(reader, 1),
        amplitude_high: amplitude_table(reader, 0),
        range_low: None,
        range_high: None,
    }
}

/// Whether the records of a file name geocentric coordinates.
fn is_geocentric(reader: &Reader) -> bool {
    let crs = reader.crs();
    crs.geo_keys.as_deref().is_some_and(geokeys::is_geocentric)
        || crs.wkt.as_ref().is_some_and(|wkt| wkt.trim_start().starts_with("GEOCCS"))
}

/// Coordinate reference system of a projected or geographic recording.
pub(super) fn recorded_crs(reader: &Reader) -> RecordedCrs {
    if is_geocentric(reader) {
        return RecordedCrs::default();
    }
    let (crs, header) = (reader.crs(), reader.header());
    let keys = crs.geo_keys.clone().map(|directory| GeoKeys {
        directory,
        doubles: crs.geo_doubles.clone().unwrap_or_default(),
        ascii: crs.geo_ascii.clone().unwrap_or_default(),
    });
    let centre = std::array::from_fn(|axis| f64::midpoint(header.min[axis], header.max[axis]));
    RecordedCrs::new(crs.wkt.as_deref(), keys.as_ref(), false, centre)
}

/// Whether pulse anchors are at the optical centre.
///
/// They are if the descriptors give the distance between the two as 0 and durations of the
/// returning samples are stored. Files converted from formats without the sensor position anchor
/// pulses at their first sample, have no durations, and declare no constant distance.
fn anchors_are_sensor(reader: &Reader) -> bool {
    reader.descriptors().values().all(|descriptor| {
        let mut returning =
            descriptor.samplings.iter().filter(|s| s.kind == SegmentKind::Returning).peekable();
        returning.peek().is_none()
            || descriptor.optical_center_to_anchor == Some(0)
                && returning.all(|sampling| sampling.duration_bits > 0 || sampling.duration_offset != 0.0)
    })
}

/// Default group velocity of a near-infrared pulse near the ground, m/s.
const GROUP_VELOCITY_MPS: f64 = 299_707_502.0;

/// Amplitude table of a returning channel.
fn amplitude_table(reader: &Reader, channel: u8) -> Option<AmplitudeTable> {
    let mut samplings = reader.descriptors().values().flat_map(|descriptor| &descriptor.samplings);
    let of_channel = |s: &&wavex_formats::pulsewaves::SamplingRecord| {
        s.kind == SegmentKind::Returning && s.channel == channel && s.lookup_table_index > 0
    };
    let index = u8::try_from(samplings.find(of_channel)?.lookup_table_index).ok()?;
    let entries = &reader.tables().get(&index)?.tables.first()?.entries;
    AmplitudeTable::new(entries.iter().enumerate().map(|(dn, value)| (dn as f64, f64::from(*value))))
}
