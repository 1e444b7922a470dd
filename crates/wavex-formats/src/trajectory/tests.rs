use core::f64::consts::TAU;
use std::fs;

use super::pof::{PofHeader, PofRecord};
use super::sbet::SbetRecord;
use super::*;
use wavex_geodesy::time::WEEK_S;
use wavex_geodesy::time_axis::DAY_S;
use wavex_geodesy::transverse_mercator::{TransverseMercator, TransverseMercatorParameters};

mod build;
mod refused;

use build::*;

#[test]
fn the_two_sbet_records_of_pdal_are_read() {
    let Some(data) = std::env::var_os("WAVEX_DATA").map(PathBuf::from) else {
        println!("skipped: WAVEX_DATA not set");
        return;
    };
    let recorded = read(&data.join("trajectory/pdal_2-points.sbet"), &Options::default()).unwrap();
    assert_eq!((recorded.format.as_str(), recorded.clock), ("SBET", Clock::Week));
    assert_eq!(recorded.counts, "seconds of the week, GPS");
    let Records::Geodetic(samples) = &recorded.records else { panic!("{recorded:?}") };
    // Time, latitude, longitude, height, roll and pitch as in PDAL's SBET reader; heading minus
    // wander angle.
    let message = samples.iter().map(|sample| {
        let Sample { time_s, place, attitude } = sample;
        let place = [place.latitude_rad, place.longitude_rad, place.height_m];
        (*time_s, place, [attitude.roll_rad, attitude.pitch_rad])
    });
    let expected = [
        (
            151_631.002_836_070_95,
            [0.568_021_185_297_226_4, -2.041_654_392_303_94, 107.715_295_329_656_04],
            [-0.028_134_071_493_213_387, -0.024_299_053_938_891_393],
        ),
        (
            151_631.007_831_864_06,
            [0.568_021_183_472_286_9, -2.041_654_392_034_052_6, 107.715_142_435_750_72],
            [-0.028_138_566_314_230_94, -0.024_252_156_693_921_688],
        ),
    ];
    assert_eq!(message.collect::<Vec<_>>(), expected);
    let headings = [
        3.046_773_230_278_662_3 + 0.021_984_147_369_226_575,
        3.047_131_105_236_810_6 + 0.021_984_160_079_321_084,
    ];
    assert_eq!([samples[0].attitude.heading_rad, samples[1].attitude.heading_rad], headings);
    // It flew south at 2.4 m/s, according to its velocities.
    let trajectory = recorded.into_trajectory(None).unwrap();
    let [a, b] = trajectory
        .span_s()
        .map(|time_s| WGS84.geodetic_of(trajectory.pose(time_s).unwrap().origin_in_ecef_m));
    let south_mps =
        (a.latitude_rad - b.latitude_rad) * 6.36e6 / (trajectory.span_s()[1] - trajectory.span_s()[0]);
    assert!((south_mps - 2.33).abs() < 0.05, "{south_mps}");
}

/// The middle of the files is not read: its records are damaged.
#[test]
fn time_spans_need_the_ends_of_a_file_only() {
    let samples = flight(MIDNIGHT_S + 36_000.0, 4000);
    let files: [(&str, Vec<u8>); 5] = [
        ("SBET", sbet(&samples, week)),
        ("POF", pof(&samples, 2, 0, week)),
        ("SOL", sol(&samples)),
        ("TRJ", trj(&samples, week)),
        ("text", text(&samples, week)),
    ];
    for (format, mut bytes) in files {
        let folder = Folder::with(&[("whole", &bytes)]);
        let options = columns("tyx_zwpk");
        let times = folder.read("whole", &options).unwrap().times();
        let middle = bytes.len() / 2;
        bytes[middle..middle + 300].fill(b'x');
        let folder = Folder::with(&[("damaged", &bytes)]);
        assert!(folder.read("damaged", &options).is_err(), "{format}");
        assert_eq!(time_span(&folder.path("damaged"), &options).unwrap(), times, "{format}");
    }
}

/// Every format, recognised by content alone, yields the same flight.
#[test]
fn every_format_gives_the_same_flight() {
    let samples = flight(MIDNIGHT_S + 36_000.0, 40);
    let files: [(&str, Vec<u8>, Clock); 6] = [
        ("SBET", sbet(&samples, week), Clock::Week),
        ("POF 1.1", pof(&samples, 2, 0, week), Clock::Adjusted),
        ("POF 1.1", pof(&samples, 1, 0, day), Clock::Adjusted),
        ("SOL", sol(&samples), Clock::Adjusted),
        ("TRJ", trj(&samples, week), Clock::Week),
        ("text", text(&samples, week), Clock::Week),
    ];
    for (format, bytes, clock) in files {
        let folder = Folder::with(&[("misleading.las", &bytes)]);
        let recorded = folder.read("misleading.las", &columns("tyx_zwpk")).unwrap();
        assert_eq!((recorded.format.as_str(), recorded.clock, recorded.records.len()), (format, clock, 40));
        assert_eq!(recorded.notes, Vec::<String>::new(), "{format}");
        let shift_s = recorded.times().first_s - samples[0].time_s;
        assert_eq!(
            shift_s,
            if clock == Clock::Week { 208_800.0 - samples[0].time_s } else { 0.0 },
            "{format}"
        );
        let [place_m, turn] = apart(&recorded.into_trajectory(Some(&unproject)).unwrap(), &samples, shift_s);
        assert!(place_m < 2e-8 && turn < 1e-9, "{format}: {place_m} m, {turn} rad");
    }
}

/// TRJ headings are relative to grid north.
///
/// 2.2 degrees of convergence at 12 E in zone 33.
#[test]
fn the_grids_north_is_not_true_north() {
    let samples = flight(100.0, 2);
    let trajectory = Folder::with(&[("t", &trj(&samples, |t| t))]).flown("t", &Options::default());
    let heading_rad = trajectory.samples()[0].attitude.heading_rad;
    assert!((heading_rad + 1.1).abs() < 1e-9, "{heading_rad}");
    let Records::Projected(map) = read_bytes(&trj(&samples, |t| t), &Options::default()).unwrap().records
    else {
        panic!("a TRJ is projected");
    };
    assert!((map[0].attitude.heading_rad + 1.1).abs().to_degrees() > 2.0);
}

#[test]
fn flights_cross_the_end_of_the_week_and_midnight() {
    let sunday_s = 2366.0 * WEEK_S - 1e9;
    let samples = flight(sunday_s - 5.0, 40);
    let files: [(&str, Vec<u8>, Clock, f64); 5] = [
        ("SBET that begins anew", sbet(&samples, week), Clock::Week, 604_795.0),
        (
            "SBET that counts on",
            sbet(&samples, |t| week(sunday_s - 5.0) + t - sunday_s + 5.0),
            Clock::Week,
            604_795.0,
        ),
        ("SOL", sol(&samples), Clock::Adjusted, sunday_s - 5.0),
        ("text of day seconds", text(&samples, day), Clock::Day, 86_395.0),
        ("TRJ of adjusted seconds", trj(&samples, |t| t), Clock::Adjusted, sunday_s - 5.0),
    ];
    for (name, bytes, clock, first_s) in files {
        let time = (clock == Clock::Day).then_some(FileTime::Day);
        let recorded = read_bytes(&bytes, &Options { time, ..columns("tyx_zwpk") }).unwrap();
        let times = recorded.times();
        assert_eq!((times.clock, times.first_s, times.last_s), (clock, first_s, first_s + 19.5), "{name}");
        let shift_s = first_s - samples[0].time_s;
        let [place_m, _] = apart(&recorded.into_trajectory(Some(&unproject)).unwrap(), &samples, shift_s);
        assert!(place_m < 2e-8, "{name}: {place_m} m");
    }
}

#[test]
fn a_pof_in_utc_becomes_gps() {
    let samples = flight(MIDNIGHT_S + 36_000.0, 4);
    for (unit, utc) in [(1, day(36_000.0 + MIDNIGHT_S) - 18.0), (2, 208_800.0 - 18.0)] {
        let bytes = pof(&samples, unit, 1, |t| t - samples[0].time_s + utc);
        let recorded = read_bytes(&bytes, &Options::default()).unwrap();
        assert_eq!(recorded.times().first_s, MIDNIGHT_S + 36_000.0);
        let unit = if unit == 1 { "day" } else { "week" };
        assert_eq!(recorded.counts, format!("seconds of the {unit}, UTC (18 s less than GPS), 2025-05-06"));
    }
    let unknown = read_bytes(&pof(&samples, 2, 2, week), &Options::default()).unwrap();
    assert_eq!(unknown.notes, ["the header does not say whether times are GPS or UTC: assuming GPS"]);
}

#[test]
fn incomplete_pof_headers_are_noted() {
    let samples = flight(MIDNIGHT_S + 36_000.0, 4);
    // No date, and a count of 0.
    let mut bytes = pof(&samples, 2, 0, week);
    bytes[35..49].fill(0);
    let recorded = read_bytes(&bytes, &Options::default()).unwrap();
    assert_eq!(
        (recorded.clock, recorded.records.len(), recorded.times().first_s),
        (Clock::Week, 4, 208_800.0)
    );
    assert_eq!(
        recorded.notes,
        [
            "the header declares 0 records: reading all to the end of the file",
            "the header has an invalid date: week and day are unknown"
        ]
    );
    // UTC without a date.
    bytes[122] = 1;
    assert_eq!(
        read_bytes(&bytes, &Options::default()).unwrap_err(),
        "t.dat: its times are UTC, but it has no date to determine leap seconds; export it with \
         its date, or in GPS time"
    );
    // Invalid time unit, overridden by the user; count below the number of records.
    let mut bytes = pof(&samples, 9, 0, day);
    bytes[41] = 3;
    let recorded = read_bytes(&bytes, &Options { time: Some(FileTime::Day), ..Options::default() }).unwrap();
    assert_eq!((recorded.times().first_s, recorded.records.len()), (MIDNIGHT_S + 36_000.0, 3));
    assert_eq!(recorded.notes, ["records beyond the header's count of 3 are not read: 1"]);
    // Version 1.0 has no distance.
    let mut bytes = pof(&samples, 2, 0, week);
    bytes[29] = 0;
    let records = bytes.split_off(pof::HEADER_BYTES);
    bytes.extend(records.chunks(64).flat_map(|record| &record[..56]));
    let recorded = read_bytes(&bytes, &Options::default()).unwrap();
    assert_eq!((recorded.format.as_str(), recorded.records.len()), ("POF 1.0", 4));
}

#[test]
fn the_clock_of_the_options_wins() {
    let samples = flight(MIDNIGHT_S + 36_000.0, 4);
    let recorded = read_bytes(&sbet(&samples, |t| t), &Options::default()).unwrap();
    assert_eq!(recorded.clock, Clock::Adjusted);
    assert_eq!(
        recorded.notes,
        ["times are too large for seconds of the week: they are read as adjusted seconds"]
    );
    let adjusted = Options { time: Some(FileTime::Adjusted), ..Options::default() };
    let recorded = read_bytes(&pof(&samples, 2, 0, |t| t), &adjusted).unwrap();
    assert_eq!(recorded.times().first_s, samples[0].time_s);
    assert_eq!(
        recorded.notes,
        ["the file says that times are seconds of the week; they are read as adjusted seconds"]
    );
    let message =
        |bytes: Vec<u8>, time| read_bytes(&bytes, &Options { time, ..Options::default() }).unwrap_err();
    assert_eq!(
        message(sbet(&samples, week), Some(FileTime::Day)),
        "t.dat: its times, from 208800.000 to 208801.500 s, are not seconds of the day; set \
         `trajectory_time` to week, day, adjusted, standard or unix"
    );
    assert_eq!(
        message(sbet(&samples, |t| t + 1e9), None),
        "t.dat: its times, from 1430560800.000 to 1430560801.500 s, are not adjusted seconds; set \
         `trajectory_time` to standard (seconds since 1980-01-06: recorded on 2025-05-06) or to unix (since \
         1970-01-01: on 2015-05-02)"
    );
}

#[test]
fn standard_gps_and_unix_times_become_adjusted() {
    let samples = flight(MIDNIGHT_S + 36_000.0, 4);
    // UTC is 18 s less than GPS time.
    for (time, offset_s) in [(FileTime::Standard, 1e9), (FileTime::Unix, 1e9 + 315_964_800.0 - 18.0)] {
        let options = Options { time: Some(time), ..Options::default() };
        let recorded = read_bytes(&sbet(&samples, |t| t + offset_s), &options).unwrap();
        assert_eq!(
            (recorded.clock, recorded.times().first_s),
            (Clock::Adjusted, samples[0].time_s),
            "{time:?}"
        );
    }
}

#[test]
fn accuracies_come_from_their_companions() {
    let samples = flight(MIDNIGHT_S + 36_000.0, 40);
    let poq = poq::tests::made(&[208_800.0, 208_801.0, 208_819.0]);
    let smrmsg = smrmsg::tests::made(&[208_800.0, 208_830.0]);
    let folder = Folder::with(&[
        ("a.pof", &pof(&samples, 2, 0, week)),
        ("a.poq", &poq),
        ("b.sol", &sol(&samples)),
        ("c.sbet", &sbet(&samples, week)),
        ("smrmsg_c.out", &smrmsg),
    ]);
    let at = |trajectory: &Trajectory, since_s: f64| {
        trajectory.pose(trajectory.span_s()[0] + since_s).unwrap().accuracy
    };
    let beside = folder.flown("a.pof", &Options::default());
    assert_eq!(at(&beside, 5.0).unwrap().position_sd_m, [1.0, 2.0, 3.0]);
    assert_eq!(at(&beside, 19.25), None, "the POQ ends earlier");
    let given = Options { accuracy: Some(folder.path("smrmsg_c.out")), ..Options::default() };
    for name in ["b.sol", "c.sbet"] {
        assert_eq!(folder.flown(name, &Options::default()).pose(0.0), None);
        assert_eq!(at(&folder.flown(name, &given), 19.0).unwrap().position_sd_m, [0.01, 0.02, 0.03]);
    }
}

#[test]
fn angles_of_a_text_may_be_radians() {
    let text = b"# a comment\n1,2,1,500,0.1,0.2,-0.3\n\n2,2,1,500,0.1,0.2,-0.3\n";
    let options = Options { angles: Some(Angles::Radians), ..columns("txyzwpk") };
    let recorded = read_bytes(text, &options).unwrap();
    let Records::Geodetic(samples) = &recorded.records else { panic!("{recorded:?}") };
    let attitude = Attitude { roll_rad: 0.1, pitch_rad: 0.2, heading_rad: -0.3 };
    assert_eq!(samples[1].attitude, attitude);
    assert_eq!(samples[1].place.longitude_rad, 2f64.to_radians());
    assert_eq!(recorded.notes, ["longitude and latitude are read as degrees, but they may be radians"]);
}

#[test]
fn longitudes_may_count_to_360() {
    let recorded =
        read_bytes(b"1 348.5 48 500 0 0 350\n2 348.5 48 500 0 0 350\n", &columns("txyzwpk")).unwrap();
    let Records::Geodetic(samples) = &recorded.records else { panic!("{recorded:?}") };
    assert!((samples[0].place.longitude_rad - (-11.5f64).to_radians()).abs() < 1e-15);
    assert!(samples.iter().all(|sample| (sample.attitude.heading_rad - 350.0 / 360.0 * TAU).abs() < 1e-15));
}
