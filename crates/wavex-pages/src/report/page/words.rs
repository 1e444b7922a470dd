//! Names and units of counters and measured quantities for readers of a page.

/// Counters of a run in the order of processing: key, name.
const COUNTERS: [(&str, &str); 23] = [
    ("nw", "waveforms"),
    ("nw_with_points", "waveforms with returns"),
    ("nw_empty", "waveforms without return"),
    ("nw_saturated", "waveforms with saturated samples"),
    ("nw_truncated", "waveforms with a return cut off at the edge"),
    ("nw_refined1x", "waveforms refined iteratively"),
    ("nw_refined2x", "waveforms refined twice"),
    ("nw_deleted", "waveforms that could not be used"),
    ("n_candidates", "candidates of detection"),
    ("n_added", "candidates of the residual search"),
    ("np_filtered", "candidates rejected by a threshold"),
    ("np_merged", "candidates merged with another"),
    ("np_xtalk", "returns touched by cross-talk of an emission"),
    ("np_xtalk_dropped", "returns dropped for cross-talk"),
    ("np", "returns"),
    ("np_online", "returns computed by the instrument"),
    ("n_georef", "points with coordinates"),
    ("np_air", "outliers above their neighbours"),
    ("np_low", "outliers below their neighbours"),
    ("np_range", "intensities corrected for range"),
    ("np_atm", "intensities corrected for the atmosphere"),
    ("np_ibrc", "ranges corrected by amplitude"),
    ("np_ibic", "amplitudes corrected by the table of the instrument"),
];

/// Other keys of reports: key, name, unit.
const QUANTITIES: [(&str, &str, &str); 44] = [
    ("path", "file", ""),
    ("format", "format", ""),
    ("instrument", "instrument", ""),
    ("serial", "serial number", ""),
    ("sampling_interval_ns", "sampling interval", "ns"),
    ("group_velocity_mps", "group velocity in air", "m/s"),
    ("time_scale", "time scale of results", ""),
    ("frame", "frame of the beams", ""),
    ("emission_reference", "emission time from", ""),
    ("ranges_count_from", "ranges count from", ""),
    ("coordinates", "coordinates of the points", ""),
    ("started", "started (UTC)", ""),
    ("ended", "ended (UTC)", ""),
    ("wall_s", "duration of the run", "s"),
    ("peak_in_flight_bytes", "peak memory of scan lines", "bytes"),
    ("records", "records", ""),
    ("span_s", "time span", "s"),
    ("median_step_s", "median step", "s"),
    ("gaps", "gaps, bridged ones included", ""),
    ("noise_sd_dn", "noise SD", "DN"),
    ("autocorrelation", "noise autocorrelation from lag 1", ""),
    ("background_dn", "background by sample phase", "DN"),
    ("pulse_fwhm_ns", "pulse width, FWHM", "ns"),
    ("waveforms", "waveforms used", ""),
    ("mta_zone", "MTA zone", ""),
    ("mta_margin_nats", "margin of the MTA zone", "nats"),
    ("mta_uncertain", "uncertainty of the MTA zone", ""),
    ("pulse_interval_ns", "pulse interval", "ns"),
    ("pulse_interval_rms_ns", "RMS of the pulse interval", "ns"),
    ("returns_per_waveform", "returns per waveform", ""),
    ("emission_sd_ns", "SD of the emission time", "ns"),
    ("left_to_plain_kernels", "waveforms per line by the plain kernels", ""),
    ("online_matched", "instrument's returns with a computed one", ""),
    ("computed_matched", "computed returns with an instrument's one", ""),
    ("online_computed_distance_ns", "instrument's minus computed time", "ns"),
    ("trajectory_sd_m", "SD of sensor positions", "m"),
    ("points_per_line", "points per scan line", ""),
    ("cell_m", "cell size", "m"),
    ("target_pulses_per_m2", "required pulse density", "per m²"),
    ("max_slope_deg", "largest slope of a smooth cell", "°"),
    ("max_roughness_m", "largest roughness of a smooth cell", "m"),
    ("min_points", "fewest points of a smooth cell", ""),
    ("max_difference_rms_m", "largest RMS of height differences", "m"),
    ("gap_width_m", "largest width of a gap", "m"),
];

/// Counters with their names, in the order of processing.
pub(super) fn counters() -> impl Iterator<Item = (&'static str, &'static str)> {
    COUNTERS.into_iter()
}

/// Name and unit of a key of a report; an unknown key in words.
pub(in crate::report) fn of_key(key: &str) -> (String, &'static str) {
    match QUANTITIES.iter().find(|(known, ..)| *known == key) {
        Some((_, name, unit)) => ((*name).to_owned(), unit),
        None => (key.replace('_', " "), ""),
    }
}

/// Text of a value that names a choice.
pub(super) fn of_choice(value: &str) -> String {
    let words = match value {
        "map" => "map coordinates",
        "earth" => "earth-centred",
        "body" => "aircraft body",
        "adjusted" => "adjusted GPS time (GPS seconds minus 1e9)",
        "week" => "seconds of the GPS week",
        "day" => "seconds of the day",
        "outgoing_pulse" => "the outgoing pulse",
        "outgoing_pulse_fraction" => "the outgoing pulse, without its start time",
        "return_locations" => "the return locations of the file",
        "clock" => "the clock of the shot",
        "first_sample" => "the first sample",
        "sensor" => "the sensor",
        other => other,
    };
    words.to_owned()
}

/// Name of a LAS class.
pub(super) fn of_class(class: u8) -> &'static str {
    match class {
        0 => "never classified",
        1 => "unclassified",
        2 => "ground",
        3..=5 => "vegetation",
        6 => "building",
        7 => "low noise",
        9 => "water",
        17 => "bridge deck",
        18 => "high noise",
        20 => "outlier",
        _ => "other",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wavex_line::scan_line::LineStats;

    #[test]
    fn every_counter_has_a_name() {
        let named: std::collections::BTreeSet<&str> = counters().map(|(key, _)| key).collect();
        let counted = LineStats::default().counts().map(|(key, _)| key).into_iter().collect();
        assert_eq!(named, counted);
    }

    #[test]
    fn keys_become_words() {
        assert_eq!(of_key("points_per_line"), ("points per scan line".to_owned(), ""));
        assert_eq!(of_key("pulse_interval_ns").1, "ns");
        assert_eq!(of_key("of_tomorrow").0, "of tomorrow");
    }
}
