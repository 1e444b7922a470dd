//! Header, variable length records and pulse records.

use super::build::{Bytes, Pair, descriptor, encode, pulse, sampling};
use crate::pulsewaves::{LookupRecord, LookupTable, PulseHeader, ScannerRecord, SegmentKind, TimeAxis};

#[test]
fn every_field_of_the_header_is_read() {
    let mut pair = Pair::plain(2);
    pair.more_header = 10;
    let expected = PulseHeader {
        global_parameters: 7,
        source_id: 4711,
        system_identifier: "the system".to_string(),
        generating_software: "the software".to_string(),
        creation_day: 188,
        creation_year: 2015,
        version: (0, 3),
        header_size: 362,
        offset_to_pulses: 362 + 96 + 92 + 2 * 104,
        pulse_count: 2,
        pulse_format: 0,
        pulse_attributes: 0,
        pulse_size: 48,
        pulse_compression: 0,
        vlr_count: 1,
        avlr_count: -1,
        t_scale_s: 1e-6,
        t_offset_s: 0.0,
        min_t: 400_000_000_000,
        max_t: 400_000_000_999,
        scale: [0.01, 0.02, 0.04],
        offset: [1e5, 2e5, 100.0],
        min: [1.0, 3.0, 5.0],
        max: [2.0, 4.0, 6.0],
    };
    assert_eq!(pair.open().0.header(), &expected);
}

#[test]
fn the_time_axis_follows_from_offset_and_values() {
    let (reader, _dir) = Pair::plain(1).open();
    let axis = |offset: f64, min_s: f64, max_s: f64| {
        let mut header = reader.header().clone();
        header.t_offset_s = offset;
        (header.min_t, header.max_t) = ((min_s * 1e6) as i64, (max_s * 1e6) as i64);
        header.time_axis()
    };
    assert_eq!(axis(0.0, 400_992.3, 400_992.5), TimeAxis::WeekSeconds);
    assert_eq!(axis(0.0, 604_799.0, 604_801.0), TimeAxis::Undecided);
    assert_eq!(axis(0.0, 0.0, 0.0), TimeAxis::Undecided);
    assert_eq!(axis(0.0, 2.0, 1.0), TimeAxis::Undecided);
    assert_eq!(axis(0.0, 1_120_000_000.0, 1_120_000_001.0), TimeAxis::Standard);
    assert_eq!(axis(1e9, 120_000_000.0, 120_000_001.0), TimeAxis::Standard);
    assert_eq!(axis(1e9, 61_758.0, 61_760.0), TimeAxis::Undecided);
}

#[test]
fn every_field_of_a_pulse_is_read() {
    let mut pair = Pair::plain(1);
    let mut record = pulse(400_992_325_740, 61, 1, 0xD5);
    record.extend([0x34, 0x12]);
    pair.pulses.push(record);
    (pair.attributes, pair.pulse_size) = (1, 57);
    let (mut reader, _dir) = pair.open();
    let pulse = reader.pulse(1).unwrap();
    assert_eq!((pulse.index, pulse.t, pulse.wave_offset), (1, 400_992_325_740, 61));
    assert_eq!(pulse.gps_time_s, 400_992_325_740.0 * 1e-6);
    assert_eq!((pulse.anchor_raw, pulse.target_raw), ([100, -200, 3000], [101, -202, 2850]));
    assert_eq!(pulse.anchor, [1e5 + 1.0, 2e5 - 4.0, 220.0]);
    assert_eq!(pulse.target, [101.0 * 0.01 + 1e5, 2e5 - 4.04, 214.0]);
    assert_eq!(pulse.step, [0.01 / 1000.0, -0.04 / 1000.0, -150.0 * 0.04 / 1000.0]);
    assert_eq!((pulse.first_returning_sample, pulse.last_returning_sample), (-5, 700));
    assert_eq!((pulse.descriptor, pulse.mirror_facet), (1, 3));
    assert_eq!((pulse.edge_of_scan_line, pulse.scan_direction), (true, false));
    assert_eq!((pulse.intensity, pulse.classification), (77, 9));
    assert_eq!(pulse.source_id, Some(0x1234));
    assert_eq!(pulse.position(500.0), [1e5 + 1.005, 2e5 - 4.02, 217.0]);
}

#[test]
fn flags_are_one_bit_each_and_a_long_source_id_wins() {
    let mut pair = Pair::plain(0);
    for flags in [0x00, 0x10, 0x20, 0x40] {
        pair.pulses.push(Bytes(pulse(0, 60, 1, flags)).u16(1).u32(70_000).0);
    }
    (pair.attributes, pair.pulse_size) = (3, 54);
    let (mut reader, _dir) = pair.open();
    let flags: Vec<_> = (0..4)
        .map(|i| reader.pulse(i).unwrap())
        .map(|p| (p.edge_of_scan_line, p.scan_direction, p.mirror_facet, p.source_id))
        .collect();
    let id = Some(70_000);
    let expected = [(false, false, 0, id), (true, false, 0, id), (false, true, 0, id), (false, false, 1, id)];
    assert_eq!(flags, expected);
}

#[test]
fn a_scanner_is_read_by_its_fields() {
    let mut b = Bytes::default().u32(252).u32(0).text("Q680i", 64).text("9997848", 64);
    b = b.f32(1550.0).f32(4.0).u32(2).u32(4).f32(160.0).f32(-30.0).f32(28.0).f32(400.0).f32(10.0).f32(0.5);
    b = b.f32(30.0).f32(3000.0).u32(0xEEEE).text("on the left", 64);
    let mut pair = Pair::plain(0);
    pair.records.push(("PulseWaves_Spec", 100_255, b.0));
    let (reader, _dir) = pair.open();
    let expected = ScannerRecord {
        instrument: "Q680i".to_string(),
        serial: "9997848".to_string(),
        wave_length_nm: 1550.0,
        outgoing_pulse_width_ns: 4.0,
        scan_pattern: 2,
        mirror_facets: 4,
        scan_frequency_hz: 160.0,
        scan_angle_min_deg: -30.0,
        scan_angle_max_deg: 28.0,
        pulse_frequency_khz: 400.0,
        beam_diameter_mm: 10.0,
        beam_divergence_mrad: 0.5,
        range_min_m: 30.0,
        range_max_m: 3000.0,
        description: "on the left".to_string(),
    };
    assert_eq!(reader.scanners().get(&255), Some(&expected));
    assert_eq!(reader.scanners().len(), 1);
}

#[test]
fn lookup_tables_are_read_with_and_without_the_compression_field() {
    let set = Bytes::default().u32(76).u32(0).u32(2).text("two tables", 64);
    let old = set.u32(80).u32(0).u32(2).u16(1).u8(8).u8(3).text("old", 64).f32(-2e37).f32(1.5);
    let both = old.u32(84).u32(0).u32(1).u16(2).u8(8).u8(0).u32(0).text("new", 64).f32(9.0);
    let mut pair = Pair::plain(0);
    pair.records.push(("PulseWaves_Spec", 300_002, both.0));
    let (reader, _dir) = pair.open();
    let table = |unit_of_measurement, options, name: &str, entries: &[f32]| LookupTable {
        unit_of_measurement,
        options,
        description: name.to_string(),
        entries: entries.to_vec(),
    };
    let expected = LookupRecord {
        description: "two tables".to_string(),
        tables: vec![table(1, 3, "old", &[-2e37, 1.5]), table(2, 0, "new", &[9.0])],
    };
    assert_eq!(reader.tables().get(&2), Some(&expected));
}

#[test]
fn descriptors_of_later_versions_are_read_by_their_declared_sizes() {
    let mut first = sampling(SegmentKind::Outgoing, 0, 0);
    first.channel = 3;
    (first.duration_bits, first.duration_scale, first.duration_offset) = (32, 0.25, -8192.0);
    (first.segment_count_bits, first.sample_count_bits, first.bits_per_sample) = (8, 16, 16);
    (first.lookup_table_index, first.sample_units_ns, first.description) = (2, 0.5, "reference".to_string());
    let mut d = descriptor(vec![
        first,
        sampling(SegmentKind::Returning, 3, 70_000),
        sampling(SegmentKind::Other(9), 1, 1),
    ]);
    (d.optical_center_to_anchor, d.extra_wave_bytes, d.scanner_index) = (None, 11, 5);
    d.description = "three samplings".to_string();
    let mut pair = Pair::plain(0);
    pair.records.push(("PulseWaves_Spec", 200_002, encode(&d, 8)));
    let (reader, _dir) = pair.open();
    assert_eq!(reader.descriptors().get(&2), Some(&d));
    assert_eq!(d.units_per_sample(&d.samplings[0]), 0.5);
}

#[test]
fn the_coordinate_system_is_kept_raw() {
    let mut pair = Pair::plain(0);
    for (user, id, payload) in [
        ("PulseWaves_Proj", 34735, &b"keys"[..]),
        ("PulseWaves_Proj", 34736, b"doubles"),
        ("LASF_Projection", 34737, b"ascii|"),
        ("PulseWaves_Proj", 2111, b"MATH\0\0"),
        ("PulseWaves_Proj", 2112, b"PROJCS\0"),
        ("PulseWaves_Proj", 4, b"something else"),
        ("somebody", 34735, b"not ours"),
    ] {
        pair.records.push((user, id, payload.to_vec()));
    }
    let (reader, _dir) = pair.open();
    let crs = reader.crs();
    assert_eq!(crs.geo_keys.as_deref(), Some(&b"keys"[..]));
    assert_eq!(crs.geo_doubles.as_deref(), Some(&b"doubles"[..]));
    assert_eq!(crs.geo_ascii.as_deref(), Some(&b"ascii|"[..]));
    assert_eq!(crs.math_transform_wkt.as_deref(), Some("MATH"));
    assert_eq!(crs.wkt.as_deref(), Some("PROJCS"));
    assert_eq!(reader.records().len(), 8);
}

#[test]
fn appended_records_add_and_replace() {
    let mut pair = Pair::plain(2);
    let replaced = descriptor(vec![sampling(SegmentKind::Returning, 1, 4)]);
    pair.appended = vec![
        ("PulseWaves_Spec", u32::MAX, Vec::new()),
        ("PulseWaves_Spec", 200_001, encode(&replaced, 0)),
        ("somebody", 1, vec![0; 500]),
        ("PulseWaves_Proj", 2112, b"GEOGCS".to_vec()),
    ];
    let (reader, _dir) = pair.open();
    assert_eq!(reader.descriptors().get(&1), Some(&replaced));
    assert_eq!(reader.crs().wkt.as_deref(), Some("GEOGCS"));
    let appended: Vec<_> = reader.records().iter().filter(|r| r.appended).map(|r| r.length).collect();
    assert_eq!(appended, [92 + 104, 500, 6]);
    assert_eq!(reader.pulse_count(), 2);
}

#[test]
fn a_promise_of_more_pulses_never_reaches_into_appended_records() {
    let mut pair = Pair::plain(2);
    pair.appended = vec![("PulseWaves_Spec", u32::MAX, Vec::new())];
    let mut pls = pair.pls();
    pls[184..192].copy_from_slice(&4_i64.to_le_bytes());
    let dir = tempfile::tempdir().unwrap();
    let path = super::build::write(dir.path(), &pls, &pair.waves);
    let reader = crate::pulsewaves::Reader::open(&path).unwrap();
    assert_eq!((reader.pulse_count(), reader.header().pulse_count), (2, 4));
}

#[test]
fn what_is_no_chain_of_appended_records_is_passed_over() {
    for tail in [vec![0; 300], vec![0xFF; 300], b"PulseWaves_Spec".repeat(30)] {
        let mut pair = Pair::plain(2);
        pair.appended = vec![("somebody", 1, tail)];
        let (reader, _dir) = pair.open();
        assert_eq!(reader.records().len(), 1);
        assert_eq!(reader.pulse_count(), 2);
    }
}
