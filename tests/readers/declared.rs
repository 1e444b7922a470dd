//! Job keys for properties that a recording lacks or states wrongly: time scale, map, atmosphere.

use wavex_formats::container::{ContainerHeader, ContainerReader, EmissionReference, TimeScale};
use wavex_formats::las::{GpsTime, Point, Reader};
use wavex_geodesy::crs::wkt_of_epsg;
use wavex_testkit::container::{Shot, of_shots};
use wavex_testkit::las::Las;
use wavex_testkit::pulsewaves::PulseWaves;
use wavex_testkit::shots::time_s;
use wavex_testkit::{TO_TABLE, TestFolder, notes};

const COPY: &str = "[[stage]]\ntype = 'write_arrow'\npath = '*_copy.arrow'\n";
/// Midnight before 2025-05-06 in adjusted GPS time, and in seconds of its week.
const MIDNIGHT_S: f64 = 430_524_800.0;
const TUESDAY_S: f64 = 172_800.0;

/// A folder with the same recording in three formats.
fn place(las: &Las) -> TestFolder {
    let pulses = PulseWaves::new(20);
    let shot = |number: usize| Shot {
        clock_ps: (time_s(number) * 1e12) as i64,
        blocks: vec![(1, 4000.0, wavex_testkit::shots::echo(number).iter().map(|&dn| dn.into()).collect())],
    };
    let shots: Vec<Shot> = (0..20).map(shot).collect();
    TestFolder::with(&[
        ("a.las", &las.las()),
        ("a.wdp", &las.packets),
        ("a.pls", &pulses.pls()),
        ("a.wvs", &pulses.waves),
        ("a.arrow", &of_shots(&shots, EmissionReference::Clock, true)),
    ])
}

/// The same LAS with other times.
fn las_at(pulses: usize, time_of: impl Fn(usize) -> f64) -> Las {
    (0..pulses).fold(Las::new(pulses), |las, pulse| las.change(pulse, 22, &time_of(pulse).to_le_bytes()))
}

const READERS: [(&str, &str); 3] =
    [("read_las", "a.las"), ("read_pulsewaves", "a.pls"), ("read_arrow", "a.arrow")];

/// Results of a reader with these keys: notes, header of a copy, and times of its shots.
#[track_caller]
fn copied(
    place: &TestFolder,
    reader: &str,
    input: &str,
    keys: &str,
) -> (Vec<String>, ContainerHeader, Vec<f64>) {
    let report = place.succeeds(reader, input, &format!("{keys}\n{COPY}"));
    let mut copy = ContainerReader::open(&place.path("out/a_copy.arrow")).unwrap();
    let header = copy.header().clone();
    let mut times = Vec::new();
    while let Some(line) = copy.next_line().unwrap() {
        times.extend((0..line.rows()).map(|row| line.shot(row).gps_time_s.unwrap()));
    }
    (notes(&report), header, times)
}

/// A LAS file written by a job: notes, time scale in its header, and time of its first point.
#[track_caller]
fn written(place: &TestFolder, keys: &str) -> (Vec<String>, GpsTime, f64) {
    let to_las = TO_TABLE
        .replace("write_table'\npath = '*.csv'", "write_las'\npath = '*_out.las'\nwave_packets = 'internal'");
    let report = place.succeeds("read_las", "a.las", &format!("{keys}\n{to_las}"));
    let mut reader = Reader::open(&place.path("out/a_out.las")).unwrap();
    let mut point = Point::default();
    assert!(reader.next_point(&mut point).unwrap());
    (notes(&report), reader.header().gps_time(), point.gps_time)
}

#[test]
fn a_window_and_an_offset_are_those_of_every_reader() {
    let place = place(&Las::new(20));
    for (reader, input) in READERS {
        let keys =
            format!("time_offset_s = 10.0\ntime_s = [{}, {}]", time_s(3) + 9.9999, time_s(7) + 10.0001);
        let (_, _, times) = copied(&place, reader, input, &keys);
        let expected: Vec<f64> = (3..8).map(|shot| time_s(shot) + 10.0).collect();
        assert_eq!(times.len(), expected.len(), "{reader}");
        assert!(times.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{reader}: {times:?}");
    }
}

#[test]
fn a_day_a_scale_and_utc_are_those_of_every_reader() {
    let place = place(&Las::new(20));
    for (reader, input) in READERS {
        let (_, header, _) = copied(&place, reader, input, "");
        assert_eq!((header.time_scale, header.gps_week), (TimeScale::Week, None), "{reader}");
        let (_, header, times) = copied(&place, reader, input, "gps_date = '2025-05-06'\nutc = true");
        assert_eq!((header.time_scale, header.gps_week), (TimeScale::Week, Some(2365)), "{reader}");
        assert!((times[0] - time_s(0) - 18.0).abs() < 1e-6, "{reader}: {times:?}");
        let (_, header, times) =
            copied(&place, reader, input, "gps_date = '2025-05-06'\nrecording_time = 'day'");
        assert_eq!((header.time_scale, header.gps_week), (TimeScale::Week, Some(2365)), "{reader}");
        assert!((times[0] - time_s(0) - TUESDAY_S).abs() < 1e-6, "{reader}: {times:?}");
        let (_, header, _) = copied(&place, reader, input, "recording_time = 'adjusted'");
        assert_eq!(header.time_scale, TimeScale::Adjusted, "{reader}");
        let error = format!(
            "stage {reader}: ./{input}: its times are UTC, but the day is unknown, and with it the number \
             of leap seconds; set the day with the key `gps_date`, or remove the key"
        );
        let place = self::place(&Las::new(20));
        place.left_nothing(place.read(reader, input, &format!("utc = true\n{COPY}")), &error);
    }
}

/// Global encoding, bit 0: adjusted GPS time if the date is known, else seconds of the week.
#[test]
fn the_header_of_las_says_what_its_times_count() {
    let place = place(&las_at(320, |pulse| TUESDAY_S + time_s(pulse)));
    assert_eq!((written(&place, "").1, written(&place, "").2), (GpsTime::Week, TUESDAY_S + time_s(0)));
    let adjusted = GpsTime::Standard { offset_s: 1e9 };
    let (_, says, first_s) = written(&place, "gps_date = '2025-05-06'");
    assert_eq!((says, first_s), (adjusted, MIDNIGHT_S + time_s(0)));
    let standard = self::place(&las_at(320, |pulse| 1e9 + MIDNIGHT_S + time_s(pulse)));
    let (notes, says, first_s) = written(&standard, "recording_time = 'standard'");
    assert_eq!((says, first_s), (adjusted, MIDNIGHT_S + time_s(0)));
    assert_eq!(notes.len(), 1, "only the missing map: {notes:?}");
    let (notes, says, _) = written(&place, "recording_time = 'day'\ntime_offset_s = -172800.0");
    assert_eq!(says, GpsTime::Week);
    let of_day = "the times of the points are seconds of the day, but the LAS header can only declare \
                  seconds of the GPS week; set the day with the reader's key `gps_date`";
    assert!(notes.contains(&of_day.to_owned()), "{notes:?}");
}

#[test]
fn times_that_do_not_fit_their_label_are_named_by_runs_and_by_scan() {
    let place = place(&las_at(20, |pulse| 1_000_061_758.0 + time_s(pulse)));
    let said = "are not plausible as seconds of the GPS week (as adjusted GPS time: 2043-05-23, as \
                standard GPS time: 2011-09-14); set the time scale with the reader's key `recording_time`";
    let (notes, _, _) = copied(&place, "read_las", "a.las", "");
    assert!(notes.len() == 1 && notes[0].ends_with(said), "{notes:?}");
    assert_eq!(copied(&place, "read_las", "a.las", "recording_time = 'standard'").0, Vec::<String>::new());
    let summary = place.wavex(&["scan", "a.las"]).out;
    assert!(summary.contains(said), "{summary}");
    // A date cannot be applied to times on another scale.
    let outcome = place.read("read_las", "a.las", &format!("gps_date = '2011-09-14'\n{COPY}"));
    assert!(outcome.code == Some(1) && outcome.err.trim_end().ends_with("`recording_time`"), "{outcome:?}");
}

#[test]
fn a_recording_without_a_time_scale_is_noted_in_las() {
    let header = ContainerHeader::new(1.0, 299_707_502.0);
    assert_eq!(header.time_scale, TimeScale::Unknown);
    let place = place(&Las::new(320));
    // PulseWaves' own writer presets an offset of 1e9 s, also for seconds of the week.
    let mut pls = PulseWaves::new(320).pls();
    pls[232..240].copy_from_slice(&1e9f64.to_le_bytes());
    place.write("a.pls", &pls);
    place.write("a.wvs", &PulseWaves::new(320).waves);
    let to_las = TO_TABLE.replace("write_table'\npath = '*.csv'", "write_las'\npath = '*_out.las'");
    let said = "the time scale of the recording is unknown, and the LAS header declares seconds of the GPS \
                week; set it with the reader's key `recording_time`: ";
    let report = place.succeeds("read_pulsewaves", "a.pls", &to_las);
    let note = notes(&report).into_iter().find_map(|note| note.strip_prefix(said).map(str::to_owned));
    assert!(
        note.is_some_and(|values| values.contains("\"adjusted\" (") && values.contains(" or \"standard\" ("))
    );
    let report =
        place.succeeds("read_pulsewaves", "a.pls", &format!("recording_time = 'standard'\n{to_las}"));
    assert!(!notes(&report).iter().any(|note| note.starts_with(said)), "{:?}", notes(&report));
}

#[test]
fn the_map_of_a_recording_can_be_declared() {
    let place = place(&Las::new(20));
    let wkt = |keys: &str| {
        let (notes, header, _) = copied(&place, "read_las", "a.las", keys);
        (notes, header.crs_wkt.unwrap_or_default())
    };
    assert_eq!(wkt(""), (vec![], String::new()));
    let (notes, zone) = wkt("crs_of_input = 'utm:33N'");
    assert!(notes.is_empty() && zone.contains("UTM zone 33N"), "{notes:?} {zone}");
    let (_, lambert) = wkt("crs_of_input = 'EPSG:2154'");
    assert!(lambert.contains("Lambert-93"), "{lambert}");
    place.write("zone.wkt", lambert.as_bytes());
    assert_eq!(wkt("crs_of_input = 'zone.wkt'").1, lambert);
    let (_, header, _) = copied(&place, "read_pulsewaves", "a.pls", "crs_of_input = 'EPSG:2154'");
    assert_eq!(header.crs_wkt, Some(lambert.clone()));

    let wrong = self::place(&Las::new(20).with_crs(&zone));
    let (notes, header, _) = copied(&wrong, "read_las", "a.las", "crs_of_input = 'EPSG:2154'");
    let overrides = "the file gives WGS 84 / UTM zone 33N as its CRS; `crs_of_input` overrides it with \
                     RGF93 / Lambert-93";
    assert_eq!((notes, header.crs_wkt), (vec![overrides.to_owned()], Some(lambert.clone())));
    assert_eq!(copied(&wrong, "read_las", "a.las", "crs_of_input = 'utm:33N'").0, Vec::<String>::new());
    let broken = self::place(&Las::new(20).with_crs("PROJCS[\"cut"));
    assert_eq!(copied(&broken, "read_las", "a.las", "crs_of_input = 'EPSG:2154'").0, Vec::<String>::new());
}

#[test]
fn a_declared_map_that_cannot_be_used_is_refused() {
    let place = place(&Las::new(20).at_northing(530_000_000));
    place.write("no.wkt", b"no text of that kind");
    place.write("degrees.wkt", wkt_of_epsg(4326).unwrap().as_bytes());
    for (reader, input, word, said) in [
        ("read_las", "a.las", "none.wkt", "none.wkt"),
        ("read_las", "a.las", "no.wkt", "the WKT cannot be read"),
        (
            "read_las",
            "a.las",
            "degrees.wkt",
            "`crs_of_input`: WGS 84 is in degrees, but the recording begins at ",
        ),
        (
            "read_arrow",
            "a.arrow",
            "EPSG:2154",
            "`crs_of_input` names a projected CRS, but this recording is in the scanner frame",
        ),
    ] {
        let outcome = place.read(reader, input, &format!("crs_of_input = '{word}'\n{COPY}"));
        assert!(outcome.code == Some(1) && outcome.err.contains(said), "{word}: {outcome:?}");
    }
}

/// Outputs must not claim degrees.
#[test]
fn a_geographic_crs_of_a_file_in_metres_is_not_used() {
    let degrees = wkt_of_epsg(4326).unwrap();
    let place = place(&Las::new(20).at_northing(530_000_000).with_crs(&degrees));
    let (notes, header, _) = copied(&place, "read_las", "a.las", "");
    let [note] = &notes[..] else { panic!("{notes:?}") };
    assert!(
        note.starts_with("the CRS of the file is not used: WGS 84 is in degrees, but the recording "),
        "{note}"
    );
    assert!(note.ends_with(" with `crs_of_input`, such as `utm:33N`"), "{note}");
    assert_eq!(header.crs_wkt, None);
    assert_eq!(copied(&place, "read_las", "a.las", "crs_of_input = 'utm:33N'").0.len(), 1, "overridden");
    // A recording in degrees keeps its CRS.
    let place = self::place(&Las::new(20).with_crs(&degrees));
    let (notes, header, _) = copied(&place, "read_las", "a.las", "");
    assert!(notes.is_empty() && header.crs_wkt == Some(degrees), "{notes:?}");
}

/// A map without a name is accepted.
#[test]
fn coordinates_may_be_asked_for_in_the_map_that_is_declared() {
    let place = place(&Las::new(320));
    let job = |key: &str| {
        format!(
            "[job.geometry]\ncrs = 'utm:33N'\n[[stage]]\ntype = 'read_las'\npath = 'a.las'\n{key}\n{TO_TABLE}"
        )
    };
    let unnamed = "stage georeference: ./a.las: the beams of this recording are already in an unnamed CRS, \
                   but `[job.geometry]` requests other coordinates; remove `crs`, `geoid` and `unit`, and \
                   name their CRS with the reader's key `crs_of_input`; recordings in other coordinates need a job of their own";
    place.left_nothing(place.run(&job("")), unnamed);
    assert_eq!(place.run(&job("crs_of_input = 'utm:33N'")).err, "");
}

#[test]
fn the_air_may_be_another_than_the_recording_says() {
    let place = place(&Las::new(20));
    for (reader, input) in &READERS[1..] {
        let (_, header, _) = copied(&place, reader, input, "refractive_index_ppm = 280.0");
        assert_eq!(header.group_velocity_mps, 299_792_458.0 / 1.000_28, "{reader}");
    }
    copied(&place, "read_las", "a.las", "");
    let copy = "out/a_copy.arrow";
    let outcome = place.read("read_arrow", copy, &format!("refractive_index_ppm = 280.0\n{COPY}"));
    let said = "`refractive_index_ppm` needs ranges from the sensor, but the ranges of this recording \
                count from the first sample";
    assert!(outcome.code == Some(1) && outcome.err.contains(said), "{outcome:?}");
}
