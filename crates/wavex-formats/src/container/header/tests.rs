//! Metadata of the header: round trips and errors.

use super::*;
use std::path::Path;

fn location() -> ContainerLocation<'static> {
    ContainerLocation { file: Path::new("a.arrow"), offset: 8, first_row: 0 }
}

fn header() -> ContainerHeader {
    ContainerHeader {
        instrument: Some("LMS-Q680i".into()),
        serial: Some("9997".into()),
        sampling_interval_ns: 1.0,
        group_velocity_mps: 299_707_502.1,
        pulse_rate_hz: Some(400e3),
        time_scale: TimeScale::Week,
        gps_week: Some(1747),
        frame: Frame::Map,
        crs_wkt: Some("GEOCCS[\"x\"]".into()),
        amplitude_low: Some(vec![(9.0, 0.0), (255.0, 19.7)]),
        amplitude_high: None,
        range_low: None,
        range_high: Some(vec![(9.0, -1e-11), (255.0, 0.1 + 0.2)]),
        recorded: Some((60, 2012)),
        created: Some((61, 2012)),
        full_scale_dn: Some(255),
        coordinate_grid: Some(([0.001, 0.01, 0.1], [4e6, 0.0, -1.5])),
        emission_reference: Some(EmissionReference::ReturnLocations),
        clock_sd_ns: Some(0.125),
        emission_choice_sd_ns: Some(0.5),
        gain_control: Some(GainControl::NotRecorded),
        origin: Some(Origin::Waveform),
        has_fractions: false,
    }
}

#[test]
fn headers_round_trip() {
    let metadata = header().to_metadata();
    let text: Vec<(&str, &str)> = metadata.iter().map(|(k, v)| (k.as_str(), v.as_str())).collect();
    let expected = [
        ("wavex.clock_sd_ns", "0.125"),
        ("wavex.container", "1"),
        ("wavex.coordinate_grid", r#"{"scale":[0.001,0.01,0.1],"offset":[4000000.0,0.0,-1.5]}"#),
        ("wavex.created", "2012-03-01"),
        ("wavex.crs", "GEOCCS[\"x\"]"),
        ("wavex.emission_choice_sd_ns", "0.5"),
        ("wavex.emission_reference", "return_locations"),
        ("wavex.frame", "map"),
        ("wavex.full_scale_dn", "255"),
        ("wavex.gain_control", "not_recorded"),
        ("wavex.gps_week", "1747"),
        ("wavex.group_velocity_mps", "299707502.1"),
        ("wavex.instrument", "LMS-Q680i"),
        ("wavex.origin", "waveform"),
        ("wavex.pulse_rate_hz", "400000"),
        ("wavex.recorded", "2012-02-29"),
        ("wavex.sampling_interval_ns", "1"),
        ("wavex.serial", "9997"),
        (
            "wavex.tables",
            r#"{"amplitude_low":[[9.0,0.0],[255.0,19.7]],"range_high":[[9.0,-1e-11],[255.0,0.30000000000000004]]}"#,
        ),
        ("wavex.time_scale", "week"),
    ];
    assert_eq!(text, expected);
    assert_eq!(ContainerHeader::from_metadata(&metadata, location()).unwrap(), header());
}

#[test]
fn unknown_values_are_omitted() {
    let short = ContainerHeader::new(1.0, 299_707_502.1);
    let metadata = short.to_metadata();
    let required: Vec<&str> = KEYS.iter().filter(|key| key.required).map(|key| key.name).collect();
    assert!(required.iter().all(|key| metadata.contains_key(key)));
    assert_eq!(metadata.len(), required.len());
    assert_eq!(ContainerHeader::from_metadata(&metadata, location()).unwrap(), short);
    for key in required.iter().skip(1) {
        let mut less = metadata.clone();
        less.remove(key);
        let error = ContainerHeader::from_metadata(&less, location()).unwrap_err().to_string();
        assert!(error.starts_with(&format!("a.arrow: byte 8: metadata `{key}`: is missing; ")), "{error}");
    }
}

#[test]
fn undefined_table_entries_and_other_keys_are_ignored() {
    let metadata = header()
        .to_metadata()
        .with("wavex.tables", r#"{"amplitude_high":[[1,null],[9,0],[10,0.5]],"other":3}"#)
        .with("pandas", "{}");
    let header = ContainerHeader::from_metadata(&metadata, location()).unwrap();
    assert_eq!(header.amplitude_high, Some(vec![(9.0, 0.0), (10.0, 0.5)]));
    assert_eq!(header.amplitude_low, None);
}

#[test]
fn wrong_values_are_reported_with_the_expected_form() {
    let cases = [
        ("wavex.sampling_interval_ns", "0", "number > 0"),
        ("wavex.sampling_interval_ns", "inf", "number > 0"),
        ("wavex.group_velocity_mps", "3e8", "number > 0, at most 299792458"),
        ("wavex.pulse_rate_hz", "NaN", "number > 0"),
        ("wavex.time_scale", "utc", "`week`, `day`, `adjusted` or `unknown`"),
        ("wavex.frame", "ned", "`scanner`, `body` or `map`"),
        ("wavex.gps_week", "-1", "whole number"),
        ("wavex.tables", "[[1,2]]", "JSON object of arrays of pairs"),
        ("wavex.tables", r#"{"range_low":[[1]]}"#, "JSON object of arrays of pairs"),
        ("wavex.recorded", "2013-02-29", "`YYYY-MM-DD`"),
        ("wavex.recorded", "2013-13-01", "`YYYY-MM-DD`"),
        ("wavex.recorded", "13-01-01", "`YYYY-MM-DD`"),
        ("wavex.recorded", "2013-+1-01", "`YYYY-MM-DD`"),
        ("wavex.full_scale_dn", "65536", "whole number up to 65535"),
        (
            "wavex.emission_reference",
            "none",
            "`outgoing_pulse`, `outgoing_pulse_fraction`, `return_locations` or `clock`",
        ),
    ];
    for (key, value, form) in cases.into_iter().chain([("wavex.origin", "earth", "`sensor` or `waveform`")]) {
        let metadata = header().to_metadata().with(key, value);
        let error = ContainerHeader::from_metadata(&metadata, location()).unwrap_err().to_string();
        let expected =
            format!("a.arrow: byte 8: metadata `{key}`: `{value}` is no value for it; write a {form}");
        assert_eq!(error, expected);
    }
}

/// The version follows from the samples; all else is the same.
#[test]
fn fractions_are_version_2() {
    let of_fractions = ContainerHeader { has_fractions: true, ..header() };
    let metadata = of_fractions.to_metadata();
    assert_eq!((header().version(), of_fractions.version()), ("1", "2"));
    assert_eq!(metadata.get("wavex.container").map(String::as_str), Some("2"));
    assert_eq!(metadata.with("wavex.container", "1"), header().to_metadata());
    assert_eq!(
        ContainerHeader::from_metadata(&of_fractions.to_metadata(), location()).unwrap(),
        of_fractions
    );
}

#[test]
fn other_versions_and_other_files_have_different_errors() {
    let newer = header().to_metadata().with("wavex.container", "3");
    let error = ContainerHeader::from_metadata(&newer, location()).unwrap_err().to_string();
    assert_eq!(
        error,
        "a.arrow: a waveform container of version `3`, where 1 and 2 are known; use a newer wavex"
    );
    let error = ContainerHeader::from_metadata(&Metadata::default(), location()).unwrap_err().to_string();
    assert!(error.contains("no waveform container: its metadata has no key `wavex.container`"), "{error}");
}

#[test]
fn days_of_leap_and_common_years_have_dates() {
    for (year, days) in [(2012, 366), (2013, 365), (2000, 366), (1900, 365), (1, 365), (9999, 365)] {
        for day in 1..=days {
            let text = iso_date((day, year)).unwrap();
            assert_eq!(day_of_year(&text), Some((day, year)), "{text}");
        }
        assert_eq!(iso_date((days + 1, year)), None);
    }
    assert_eq!(iso_date((0, 2012)), None);
    assert_eq!(iso_date((1, 10_000)), None);
    assert_eq!(iso_date((366, 2012)).as_deref(), Some("2012-12-31"));
}
