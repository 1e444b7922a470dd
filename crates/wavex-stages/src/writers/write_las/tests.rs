//! Points as the sink writes them, read back by the `las` crate.

use las::point::Classification;

use super::*;
use wavex_line::scan_line::{Blocks, Content, ReturnChannel, TimeScale, flags};

fn found(return_number: u8) -> Return {
    Return {
        emission: 0,
        return_number,
        number_of_returns: 9,
        channel: ReturnChannel::Low,
        flags: flags::REFINED | flags::OVERLAP | flags::SATURATED | flags::SPLIT,
        mta_zone: 2,
        time_of_flight_ns: 6000.0,
        time_of_flight_sd_ns: 0.02,
        range_m: 900.0,
        range_sd_m: 0.003,
        amplitude_dn: 120.4,
        amplitude_sd_dn: 0.9,
        peak_dn: 122.0,
        peak_sd_dn: 0.9,
        amplitude_db: 20.0,
        width_ratio: 1.25,
        width_ratio_sd: 0.05,
        fwhm_ns: 4.5,
        thickness_m: 0.24,
        thickness_sd_m: 0.125,
        deviation_ratio: 2.0,
        intensity: 70.6,
        intensity_sd: 10.0,
        ..Return::default()
    }
}

fn info(crs_wkt: Option<&str>) -> InputInfo {
    InputInfo {
        stem: "made".into(),
        time_scale: TimeScale::Adjusted,
        crs_wkt: crs_wkt.map(str::to_owned),
        ..InputInfo::default()
    }
}

fn line(input: InputInfo, returns: Vec<Return>) -> ScanLine {
    let flags = emission_flags::SCAN_DIRECTION_POSITIVE | emission_flags::EDGE_OF_FLIGHT_LINE;
    let emission = Emission { gps_time_s: 2e8, flags, scan_angle_deg: -12.6, ..Emission::default() };
    let mut scan_line = ScanLine::of_shots(Arc::new(input), 0, vec![emission], Blocks::default());
    let points = returns.iter().map(|r| [1.0, 2.0, f64::from(r.return_number)]).collect();
    scan_line.content = Content::Points(returns, points);
    scan_line
}

fn run_context(folder: &Path) -> RunContext {
    RunContext {
        input: "made.sdf".into(),
        stem: "made".into(),
        input_dir: folder.into(),
        output_dir: folder.into(),
        simd: wavex_simd::SimdLevel::best(),
        ..RunContext::alone("".as_ref())
    }
}

/// Runs the stage; its files do not yet have their final names.
fn run(keys: &WriteLas, run: &RunContext, lines: &[ScanLine]) -> Context {
    let mut cx = Context::default();
    let mut sink = keys.make(run).unwrap();
    lines.iter().for_each(|line| sink.write(line, &mut cx).unwrap());
    sink.finish(&mut cx).unwrap();
    cx
}

/// The file written for these lines, and the notes of the stage.
fn write(keys: &WriteLas, lines: &[ScanLine]) -> (Vec<u8>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let context = run_context(folder.path());
    let mut cx = run(keys, &context, lines);
    let whole = cx.take_files().into_iter().map(|whole| whole.publish().unwrap());
    let paths: Vec<_> = whole.collect();
    let expected: Vec<_> = keys.outputs().iter().map(|pattern| context.output_path(pattern)).collect();
    assert!(paths.iter().all(|path| expected.contains(path)) && paths.len() == expected.len());
    (std::fs::read(&expected[0]).unwrap(), cx.counters().warnings().collect())
}

fn points(bytes: &[u8]) -> (las::Header, Vec<las::Point>) {
    let mut reader = las::Reader::new(std::io::Cursor::new(bytes.to_vec())).unwrap();
    let header = reader.header().clone();
    let read = reader.read_all().unwrap();
    (header, read.points().map(|point| point.unwrap()).collect())
}

fn keys(path: &str) -> WriteLas {
    WriteLas { path: path.into(), attribute_layout: AttributeLayout::V1_1, ..WriteLas::default() }
}

/// Stored steps of the attributes.
fn stored(point: &las::Point, layout: AttributeLayout) -> Vec<u16> {
    let mut rest = point.extra_bytes.as_slice();
    let next = |attribute: &ReturnAttribute| {
        let (now, later) = rest.split_at(attribute.stored.data_type.bytes());
        rest = later;
        u16::from(now[0]) | now.get(1).map_or(0, |high| u16::from(*high) << 8)
    };
    attributes_of(layout, true).iter().map(next).collect()
}

#[test]
fn a_point_tells_of_its_return_in_version_1_4() {
    let outlier = Return { channel: ReturnChannel::Joint, withheld: true, class: 18, ..found(8) };
    let lines = [line(info(Some("PROJCS[\"x\"]")), vec![found(1), outlier])];
    let (bytes, notes) = write(&keys("*.las"), &lines);
    assert!(notes.is_empty(), "{notes:?}");
    let (header, points) = points(&bytes);
    assert_eq!((header.version(), header.has_wkt_crs()), (las::Version::new(1, 4), true));
    let [first, second] = points.as_slice() else { panic!("{} points", points.len()) };
    assert_eq!((first.intensity, first.return_number, first.number_of_returns), (71, 1, 9));
    assert_eq!((second.return_number, second.is_withheld, first.is_withheld), (8, true, false));
    assert_eq!((u8::from(first.classification), u8::from(second.classification)), (0, 20));
    assert_eq!((first.scanner_channel, second.scanner_channel), (0, 1));
    assert_eq!((first.user_data, first.point_source_id, first.gps_time), (0b0100_0011, 2, Some(2e8)));
    assert!(first.is_edge_of_flight_line);
    assert_eq!(first.scan_direction, las::point::ScanDirection::LeftToRight);
    assert!((first.scan_angle + 12.6).abs() < 1e-4);
    // The values of `found` over the steps of the layout.
    assert_eq!(stored(first, AttributeLayout::V1_1), [30, 30, 700, 20, 3, 50, 25, 125, 0]);
    assert_eq!(stored(second, AttributeLayout::V1_1)[8], 1);
}

#[test]
fn version_1_2_clamps_what_its_fields_cannot_hold() {
    let utm_33 = wavex_geodesy::crs::wkt_of_epsg(32633).unwrap();
    let keys = WriteLas { version: VersionKey::V1_2, ..keys("*.las") };
    let (bytes, notes) = write(&keys, &[line(info(Some(&utm_33)), vec![found(1), found(9)])]);
    assert!(notes.is_empty(), "{notes:?}");
    let (header, points) = points(&bytes);
    assert_eq!((header.version(), header.point_format().to_u8().unwrap()), (las::Version::new(1, 2), 1));
    assert_eq!((points[1].return_number, points[1].number_of_returns, points[1].scanner_channel), (7, 7, 0));
    assert_eq!((points[1].scan_angle, points[1].gps_time), (-13.0, Some(2e8)));
    assert_eq!(stored(&points[1], AttributeLayout::V1_1)[..4], [30, 30, 700, 20]);

    let (bytes, notes) = write(&keys, &[line(info(Some("PROJCS[\"x\"]")), vec![found(1)])]);
    assert_eq!(
        notes,
        ["the coordinate reference system has neither an EPSG code nor GeoTIFF keys: the file stores it \
             as WKT, which is defined for LAS 1.4"]
    );
    let reader = las::Reader::new(std::io::Cursor::new(bytes)).unwrap();
    assert!(reader.header().vlrs().iter().any(|vlr| vlr.record_id == 2112));
}

#[test]
fn only_the_named_attributes_are_written() {
    let lines = [line(info(None), vec![found(1)])];
    let names = |chosen: Option<Vec<String>>| -> Vec<String> {
        let (bytes, _) = write(
            &WriteLas { attributes: chosen, attribute_layout: AttributeLayout::Standard, ..keys("*.las") },
            &lines,
        );
        let text = String::from_utf8_lossy(&bytes).into_owned();
        let known = ["Range SD", "Deviation", "Width ratio", "MTA zone", "Channel"];
        known.into_iter().filter(|name| text.contains(name)).map(str::to_owned).collect()
    };
    assert_eq!(names(None), ["Range SD", "Deviation", "Width ratio", "MTA zone", "Channel"]);
    assert_eq!(names(Some(vec!["Deviation".into(), "Range SD".into()])), ["Range SD", "Deviation"]);
    assert_eq!(names(Some(Vec::new())), Vec::<String>::new());
}

#[test]
fn layout_1_0_has_its_own_steps_bits_and_class() {
    let bad = Return { deviation_ratio: 3.01, flags: flags::DIVERGED | flags::SATURATED, ..found(2) };
    let lines = [line(info(None), vec![found(1), bad])];
    let keys = WriteLas { attribute_layout: AttributeLayout::V1_0, ..keys("*.las") };
    let (bytes, notes) = write(&keys, &lines);
    assert_eq!(notes, ["without a trajectory: the LAS file has no coordinate reference system"]);
    let (_, points) = points(&bytes);
    assert_eq!(stored(&points[0], AttributeLayout::V1_0), [13, 30, 700, 120, 40, 3, 50, 25, 125]);
    assert_eq!(points.iter().map(|point| point.user_data).collect::<Vec<_>>(), [0b0100_0001, 0b1000_0000]);
    assert_eq!(points[0].classification, Classification::CreatedNeverClassified);
    assert_eq!(u8::from(points[1].classification), 20);
    assert!(!points[1].is_withheld);
}

#[test]
fn attributes_can_be_left_out() {
    let lengths = [(true, true, 10), (true, false, 6), (false, true, 0)];
    for (extra_attributes, uncertainty, length) in lengths {
        let keys = WriteLas { extra_attributes, uncertainty, ..keys("*.las") };
        let (bytes, _) = write(&keys, &[line(info(None), vec![found(1)])]);
        assert_eq!(points(&bytes).1[0].extra_bytes.len(), length);
    }
    let names = |layout| {
        let without = attributes_of(layout, false);
        without.iter().map(|attribute| attribute.stored.name).collect::<Vec<_>>().join(", ")
    };
    assert_eq!(names(AttributeLayout::V1_1), "WideRatio, TargetThick, Amp, DevRatio, Channel");
    let of_1_0 = "Widening, Target Thickness, Amplitude, Raw Amplitude, Deviation Ratio";
    assert_eq!(names(AttributeLayout::V1_0), of_1_0);
}

#[test]
fn an_index_is_a_file_or_a_part_of_one() {
    let lines = [line(info(None), vec![found(1), found(2)])];
    let beside = WriteLas { index: IndexKey::File, ..keys("sub/*.las") };
    assert_eq!(beside.outputs(), ["sub/*.las", "sub/*.lax"]);
    let (with, _) = write(&beside, &lines);
    let (without, _) = write(&keys("*.las"), &lines);
    assert_eq!(with, without);
    let appended = WriteLas { index: IndexKey::Appended, ..keys("*.laz") };
    let (bytes, _) = write(&appended, &lines);
    assert!(bytes.windows(8).any(|window| window == b"LASX\0\0\0\0"));
}

/// LASzip uses any index with the name of the points, so the index of an earlier run must go.
#[test]
fn an_index_of_earlier_points_is_gone() {
    let lines = [line(info(None), vec![found(1), found(2)])];
    for index in [IndexKey::None, IndexKey::Appended, IndexKey::File] {
        let folder = tempfile::tempdir().unwrap();
        let index_path = folder.path().join("made.lax");
        for name in ["made.lax", "made.LAX", "other.lax"] {
            std::fs::write(folder.path().join(name), b"old").unwrap();
        }
        let mut cx = run(&WriteLas { index, ..keys("*.laz") }, &run_context(folder.path()), &lines);
        assert_eq!(std::fs::read(&index_path).unwrap(), b"old", "kept until the new points are complete");
        cx.take_files().into_iter().for_each(|whole| drop(whole.publish().unwrap()));
        match index {
            IndexKey::File => assert!(std::fs::read(&index_path).unwrap().starts_with(b"LASX")),
            _ => assert!(!index_path.exists()),
        }
        assert!(folder.path().join("other.lax").exists() && !folder.path().join("made.LAX").exists());
    }
}

/// A run killed after any step never leaves points next to packets or an index of another run.
#[test]
fn points_never_stand_beside_what_belongs_to_others() {
    let folder = tempfile::tempdir().unwrap();
    let external =
        WriteLas { wave_packets: WavePacketsKey::External, index: IndexKey::File, ..keys("*.las") };
    let names = ["made.wdp", "made.las", "made.lax"];
    names.iter().for_each(|name| std::fs::write(folder.path().join(name), b"old").unwrap());
    let line = ScanLine { waveforms: Some(Blocks::default()), ..line(info(None), vec![found(1)]) };
    let mut cx = run(&external, &run_context(folder.path()), &[line]);
    // State of each file: o is old, n new, - missing.
    let state = || {
        let state = |name: &str| match std::fs::read(folder.path().join(name)) {
            Ok(bytes) if bytes == b"old" => 'o',
            Ok(_) => 'n',
            Err(_) => '-',
        };
        names.map(state).iter().collect::<String>()
    };
    let mut states = vec![state()];
    let mut files = cx.take_files();
    for whole in &mut files {
        whole.remove_stale().unwrap();
        states.push(state());
    }
    for whole in files {
        whole.publish().unwrap();
        states.push(state());
    }
    assert_eq!(states, ["ooo", "o-o", "o--", "o--", "n--", "nn-", "nnn"]);
}

#[test]
fn invalid_keys_are_errors() {
    let said = |keys: WriteLas| keys.check().err().map(|invalid| format!("{invalid:?}"));
    assert_eq!(said(WriteLas::default()), None);
    assert!(said(keys("a.ply")).unwrap().contains("the file name must end in .las or .laz"));
    let appended = WriteLas { index: IndexKey::Appended, ..keys("a.las") };
    assert!(said(appended).unwrap().contains("an index can only be appended to .laz: write it as a file"));
    let old = WriteLas { version: VersionKey::V1_2, wave_packets: WavePacketsKey::Internal, ..keys("a.las") };
    assert!(said(old).unwrap().contains("LAS 1.2 has no waveforms: write version 1.3 or 1.4"));
}

#[test]
fn the_standard_layout_has_the_flight_line_and_noise_classes() {
    let noise = |class| Return { withheld: true, class, ..found(2) };
    let keys = WriteLas {
        attribute_layout: AttributeLayout::Standard,
        project_id: "00112233-4455-6677-8899-aabbccddeeff".into(),
        ..keys("*.las")
    };
    let lines = [line(info(None), vec![found(1), noise(7), noise(18)])];
    let (bytes, _) = write(&keys, &lines);
    let (header, read) = points(&bytes);
    // Three little-endian numbers, which the crate reads as bytes.
    let guid = "33221100-5544-7766-8899-aabbccddeeff";
    assert_eq!((header.file_source_id(), header.guid().to_string().as_str()), (1, guid));
    let classes =
        |points: &[las::Point]| points.iter().map(|p| u8::from(p.classification)).collect::<Vec<_>>();
    assert_eq!(classes(&read), [0, 7, 18]);
    assert!(read.iter().all(|point| point.point_source_id == 1));
    let legacy = WriteLas { version: VersionKey::V1_2, ..keys.clone() };
    assert_eq!(classes(&points(&write(&legacy, &lines).0).1), [0, 7, 7]);
    let zones = PointSourceKey::Rule(PointSourceRule::Zone);
    let (header, read) = points(&write(&WriteLas { point_source_id: Some(zones), ..keys }, &lines).0);
    assert_eq!((header.file_source_id(), read[0].point_source_id), (0, 2));
}

/// Extra bytes of a return in the standard layout.
fn standard_bytes(r: Return) -> Vec<u8> {
    let keys = WriteLas { attribute_layout: AttributeLayout::Standard, ..keys("*.las") };
    let (_, points) = points(&write(&keys, &[line(info(None), vec![r])]).0);
    points[0].extra_bytes.clone()
}

#[test]
fn the_standard_layout_stores_values_and_their_uncertainties() {
    let bytes = standard_bytes(Return { total_sd_m: 0.04, channel: ReturnChannel::Joint, ..found(1) });
    let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    // 20 dB; 10 log10(70.6 / 7) dB; 4.5 ns; 2.0; 120.4 steps; 1.25; 0.24 m.
    assert_eq!([0, 2, 4, 6].map(u16_at), [2000, 1004, 450, 20]);
    assert_eq!((u16_at(8), u16_at(10), u16_at(12), u16_at(14)), (12_040, 0, 1250, 240));
    let sd = |number: usize| f32::from_le_bytes(*bytes[16 + 4 * number..].first_chunk().unwrap());
    let expected: [f32; 6] = [0.003, 0.9, 0.05 * 4.5 / 1.25, 0.125, 10.0, 0.04];
    for (number, expected) in expected.into_iter().enumerate() {
        assert!((sd(number) / expected - 1.0).abs() < 1.0 / 256.0, "{number}: {}", sd(number));
    }
    let flags = flags::REFINED | flags::OVERLAP | flags::SATURATED | flags::SPLIT;
    assert_eq!((bytes[40], bytes[41], u16_at(42), bytes.len()), (2, 2, flags, 44));
}

#[test]
fn unknown_quantities_are_no_data_in_the_standard_layout() {
    let bytes = standard_bytes(Return { mta_zone: -1, deviation_ratio: f64::NAN, ..Return::default() });
    let u16_at = |at: usize| u16::from_le_bytes([bytes[at], bytes[at + 1]]);
    assert_eq!([0, 2, 4, 6, 8, 10].map(u16_at), [65_535, 32_768, 65_535, 32_768, 65_535, 65_535]);
    for sd in bytes[16..40].chunks_exact(4) {
        assert!(f32::from_le_bytes(*sd.first_chunk().unwrap()).is_nan());
    }
    assert_eq!(bytes[41], 255);
}

/// Files of the classic layouts, which other programs' results depend on.
#[test]
fn classic_layouts_stay_as_they_are_to_the_bit() {
    let returns = vec![found(1), Return { class: 7, withheld: true, ..found(2) }, Return::default()];
    let digest = |(attribute_layout, version, path): (AttributeLayout, VersionKey, &str)| {
        let keys = WriteLas { attribute_layout, version, ..keys(path) };
        let mut bytes = write(&keys, &[line(info(None), returns.clone())]).0;
        // The generating software contains the version of wavex.
        bytes[58..90].fill(0);
        blake3::hash(&bytes).to_hex()[..16].to_owned()
    };
    let (new, old) = (VersionKey::V1_4, VersionKey::V1_2);
    let files = [
        (AttributeLayout::V1_1, new, "*.las"),
        (AttributeLayout::V1_1, new, "*.laz"),
        (AttributeLayout::V1_1, old, "*.las"),
        (AttributeLayout::V1_1, old, "*.laz"),
        (AttributeLayout::V1_0, new, "*.las"),
        (AttributeLayout::V1_0, new, "*.laz"),
        (AttributeLayout::V1_0, old, "*.las"),
        (AttributeLayout::V1_0, old, "*.laz"),
    ];
    let expected = [
        "733ff784635a16f9",
        "1cc60f225df0bdfd",
        "997fa09a4489aa41",
        "fe070823c7332cfa",
        "5df8eea0b16dc409",
        "411a630cb0c8ef77",
        "1079ec829fa115e8",
        "578b08cac320d251",
    ];
    assert_eq!(files.map(digest), expected);
}

/// The item of points at UTM 33N, and the notes of the stage.
fn written_item(keys: &WriteLas, input: InputInfo) -> (Option<serde_json::Value>, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("made.json"), b"old").unwrap();
    let mut points = line(input, vec![found(1), found(2)]);
    if let Content::Points(_, places) = &mut points.content {
        *places = vec![[500_000.0, 5_300_000.0, 100.0], [500_100.0, 5_300_200.0, 150.0]];
    }
    let mut cx = run(keys, &run_context(folder.path()), &[points]);
    cx.take_files().into_iter().for_each(|whole| drop(whole.publish().unwrap()));
    let text = std::fs::read_to_string(folder.path().join("made.json")).ok();
    let item = text.map(|text| serde_json::from_str(&text).unwrap());
    (item, cx.counters().notes.clone())
}

#[test]
fn a_stac_item_describes_the_points() {
    let keys = WriteLas { stac: true, attribute_layout: AttributeLayout::Standard, ..keys("*.laz") };
    assert_eq!(keys.outputs(), ["*.laz", "*.json"]);
    let utm_33 = wavex_geodesy::crs::wkt_of_epsg(32633).unwrap();
    let input = InputInfo { instrument: Some("an instrument".into()), ..info(Some(&utm_33)) };
    let (item, notes) = written_item(&keys, input);
    let item = item.unwrap();
    assert!(notes.is_empty(), "{notes:?}");
    let about = &item["properties"];
    assert_eq!((&item["id"], &item["assets"]["data"]["href"]), (&"made".into(), &"./made.laz".into()));
    assert_eq!(item["assets"]["data"]["type"], "application/vnd.laszip");
    // 2e8 s after 2011-09-14T01:46:40 GPS, 18 leap seconds.
    assert_eq!(about["datetime"], "2018-01-14T21:19:42.000Z");
    assert_eq!((&about["start_datetime"], &about["end_datetime"]), (&about["datetime"], &about["datetime"]));
    assert_eq!((&about["pc:count"], &about["pc:encoding"]), (&2.into(), &"LAZ".into()));
    assert_eq!(
        (&about["proj:code"], &about["instruments"][0]),
        (&"EPSG:32633".into(), &"an instrument".into())
    );
    assert_eq!(about["proj:bbox"], serde_json::json!([5e5, 5.3e6, 100.0, 500_100.0, 5_300_200.0, 150.0]));
    let bbox: Vec<f64> = item["bbox"].as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect();
    assert!((bbox[0] - 15.0).abs() < 1e-6 && (bbox[1] - 47.85).abs() < 0.01, "{bbox:?}");
    assert_eq!(item["geometry"]["coordinates"][0].as_array().unwrap().len(), 17);
    let schemas = about["pc:schemas"].as_array().unwrap();
    let dimension = |name: &str| schemas.iter().find(|one| one["name"] == name).unwrap();
    assert_eq!(dimension("Range SD")["size"], 4);
    assert_eq!(
        (&dimension("Amplitude")["type"], &dimension("GpsTime")["size"]),
        (&"floating".into(), &8.into())
    );
    assert_eq!(about["pc:statistics"][3]["minimum"], 2e8);
}

#[test]
fn a_stac_item_has_no_place_without_a_coordinate_reference_system() {
    let keys = WriteLas { stac: true, ..keys("*.las") };
    let (item, _) = written_item(&keys, info(None));
    let item = item.unwrap();
    assert!(item["geometry"].is_null() && item.get("bbox").is_none());
    assert!(item["properties"]["proj:code"].is_null());
    assert_eq!(item["assets"]["data"]["type"], "application/vnd.las");
}

#[test]
fn a_stac_item_needs_a_date() {
    let keys = WriteLas { stac: true, ..keys("*.las") };
    let week = |recorded| InputInfo { time_scale: TimeScale::Week, recorded, ..info(None) };
    let (item, _) = written_item(&keys, week(Some((33, 2024))));
    assert_eq!(item.unwrap()["properties"]["datetime"], "2024-02-02T00:00:00Z");
    let (item, notes) = written_item(&keys, week(None));
    assert_eq!(item, None, "the item of earlier points is removed");
    assert!(notes.iter().any(|note| note.starts_with("no STAC item is written")), "{notes:?}");
}
