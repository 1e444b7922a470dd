//! Files that are not valid trajectories, and their messages.

use super::*;

#[test]
fn companions_of_something_else_are_refused() {
    let samples = flight(MIDNIGHT_S + 36_000.0, 4);
    let mut twice = smrmsg::tests::made(&[208_800.0, 208_800.0]);
    twice.truncate(160);
    let folder = Folder::with(&[
        ("a.pof", &pof(&samples, 2, 0, week)),
        ("a.poq", &poq::tests::made(&[1.0, 2.0])),
        ("b.sbet", &sbet(&samples, week)),
        ("twice.out", &twice),
    ]);
    assert_eq!(
        folder.read("a.pof", &Options::default()).unwrap_err(),
        "a.poq: its accuracies cover Sunday 00:00:01.0 to 00:00:02.0 GPS (1.0 to 2.0 s of the \
         week), but the trajectory covers 2025-05-06 10:00:00.0 to 10:00:01.5 GPS (430560800.0 to \
         430560801.5 s, adjusted); give the accuracies of this trajectory"
    );
    let with = |name: &str| Options { accuracy: Some(folder.path(name)), ..Options::default() };
    assert_eq!(
        folder.read("b.sbet", &with("b.sbet")).unwrap_err(),
        "b.sbet: it holds no accuracies: it is neither a POQ nor records of ten numbers (smrmsg); \
         give the .poq of the POF, or the smrmsg_*.out of the SBET"
    );
    let error = folder.read("b.sbet", &with("twice.out")).unwrap().into_trajectory(None).unwrap_err();
    assert_eq!(
        folder.message(&error),
        "b.sbet: its accuracies: records 1 and 2 have the same time 208800 s; keep one record of each time"
    );
}

#[test]
fn files_of_other_formats_are_refused() {
    let nothing = Options::default();
    let folder = Folder::with(&[("a.pls", b"PulseWavesPulse\0 and so on")]);
    assert_eq!(
        folder.read("a.pls", &nothing).unwrap_err(),
        "a.pls: it is a recording, not a trajectory; give the positions and attitudes of the flight: SBET, POF, SOL, TRJ \
         or columns of text"
    );
    assert_eq!(
        read_bytes(b"LASF\0\0\0\0 and so on", &nothing).unwrap_err(),
        "t.dat: unknown trajectory format: its 18 bytes do not begin with `RIEGL \
         POSITION&ORIENTATION` (POF) or `TSCANTRJ` (TRJ), byte 34 is not the XOR of the bytes \
         before it (SOL), bytes 8 to 23 are not a latitude and longitude in radians (SBET), and it \
         is not text; export the trajectory as one of these, with positions in degrees or radians \
         and attitude"
    );
    assert_eq!(
        read_bytes(&poq::tests::made(&[1.0]), &nothing).unwrap_err(),
        "t.dat: it is a POQ file, which has only accuracies; give the POF file; its POQ is found \
         automatically"
    );
    assert_eq!(
        read_bytes(b"GPSTime,Lat,Lon\n1,2,3\n", &nothing).unwrap_err(),
        "t.dat: it is text, but its columns are not defined; it begins with `GPSTime,Lat,Lon`; name \
         them, such as `txyzwpk`, by `trajectory_columns` in a job or `--columns` of `wavex trajectory`: time, longitude, \
         latitude, height, roll, pitch, heading; any other letter skips a column"
    );
    let folder = Folder::with(&[]);
    assert_eq!(
        folder.read("none.sbet", &nothing).unwrap_err(),
        "none.sbet: cannot open: No such file or directory (os error 2); check the path"
    );
}

#[test]
fn texts_that_are_no_trajectory_are_refused() {
    let message = |text: &str, letters: &str| read_bytes(text.as_bytes(), &columns(letters)).unwrap_err();
    let rows = "head\n1 11 48 500 0 0 90\n";
    let cases = [
        (
            message(rows, "txyz"),
            "t.dat: `trajectory_columns` is `txyz`, which lacks the pitch (p); use t for time, x \
             for longitude, y for latitude, z for height, w for roll, p for pitch and k for \
             heading",
        ),
        (
            message(rows, "txyzwpkx"),
            "t.dat: `trajectory_columns` is `txyzwpkx`, which has two columns for longitude (x); \
             use t for time, x for longitude, y for latitude, z for height, w for roll, p for \
             pitch and k for heading",
        ),
        (
            message(&format!("{rows}2 11 48 500 0 x 90\n"), "txyzwpk"),
            "t.dat: byte 24: line 3: the pitch (column 6) is `x`; check `trajectory_columns`",
        ),
        (
            message(&format!("{rows}2 11 48 500\n"), "txyzwpk"),
            "t.dat: byte 24: line 3: there are 4 columns, but roll is column 5; check \
             `trajectory_columns`",
        ),
        (
            message("a\nb c\n", "txyzwpk"),
            "t.dat: none of its 2 lines has numbers in all columns of `txyzwpk`: in the last, the time (column 1) is `b`; \
             check `trajectory_columns`",
        ),
        (
            message("1 320000 5300000 500 0 0 90\n", "txyzwpk"),
            "t.dat: byte 0: latitude of line 1: 5300000 degrees is out of range; give geodetic \
             positions, and check `trajectory_columns`",
        ),
        (
            message(&format!("1 {}\n", "9".repeat(70_000)), "txyzwpk"),
            "t.dat: byte 0: line: it is longer than 65536 bytes; give a table with one line per \
             record",
        ),
        (
            message("1 11 48 5e7 0 0 90\n", "txyzwpk"),
            "t.dat: byte 0: height of record 1: invalid value 50000000.000000; the file is \
             damaged, or its positions are not geodetic: export it again",
        ),
    ];
    for (message, expected) in cases {
        assert_eq!(message, expected);
    }
}

#[test]
fn damaged_records_are_refused_where_they_stand() {
    let samples = flight(MIDNIGHT_S + 36_000.0, 4);
    let changed = |mut bytes: Vec<u8>, at: usize, with: &[u8]| {
        bytes[at..at + with.len()].copy_from_slice(with);
        read_bytes(&bytes, &Options::default()).unwrap_err()
    };
    let cut = |bytes: Vec<u8>, length: usize| read_bytes(&bytes[..length], &Options::default()).unwrap_err();
    let damaged = "the file is damaged, or its positions are not geodetic: export it again";
    let cut_off = "the file is cut off: copy it again from its source";
    let nan = f64::NAN.to_le_bytes();
    let cases = [
        (cut(sbet(&samples, week), 300), format!("t.dat: byte 272: record 3: 136 bytes needed, 28 left; {cut_off}")),
        (changed(sbet(&samples, week), 136 + 8, &nan), format!("t.dat: byte 136: latitude of record 2: invalid value NaN; {damaged}")),
        (changed(sbet(&samples, week), 272, &nan), format!("t.dat: byte 272: time of record 3: invalid value NaN; {damaged}")),
        (
            changed(sbet(&samples, week), 136 + 16, &7f64.to_le_bytes()),
            format!("t.dat: byte 136: longitude of record 2: invalid value 401.070457; {damaged}"),
        ),
        (
            changed(sbet(&samples, week), 136 + 56, &1e9f64.to_le_bytes()),
            format!("t.dat: byte 136: roll of record 2: invalid value 57295779513.082321; {damaged}"),
        ),
        (cut(sol(&samples), 200), format!("t.dat: byte 184: record 2: 184 bytes needed, 16 left; {cut_off}")),
        (
            changed(sol(&samples), 184 + 20, &[0x55]),
            "t.dat: byte 218: check byte of record 2: it is not the XOR of the bytes before it; \
             the file is damaged: copy it again from its source"
                .to_owned(),
        ),
        (cut(pof(&samples, 2, 0, week), 400), format!("t.dat: byte 379: record 2: 64 bytes needed, 21 left; {cut_off}")),
        (cut(pof(&samples, 2, 0, week), 100), format!("t.dat: byte 97: time step: 8 bytes needed, 3 left; {cut_off}")),
        (
            changed(pof(&samples, 2, 0, week), 27, &[2]),
            "t.dat: byte 31: version: version 2.1 is not supported; export the trajectory as POF \
             1.1 or as SBET".to_owned(),
        ),
        (
            changed(pof(&samples, 2, 0, week), 31, &[9, 0]),
            "t.dat: byte 31: data offset: records at byte 9 would lie in the header; the file is damaged: export it again"
                .to_owned(),
        ),
        (cut(trj(&samples, week), 1400), format!("t.dat: byte 1376: record 1: 64 bytes needed, 24 left; {cut_off}")),
        (
            changed(trj(&samples, week), 8, &[0]),
            "t.dat: byte 8: version: 20010496 is not between 20010715 and 20010715; the file is damaged: export it again"
                .to_owned(),
        ),
        (
            changed(trj(&samples, week), 20, &[0, 0, 0, 0x7f]),
            "t.dat: byte 20: record size: 2130706432 is not between 56 and 4096; the file is damaged: export it again"
                .to_owned(),
        ),
        (
            changed(trj(&samples, week), 1376 + 64 + 8, &nan),
            "t.dat: byte 1440: x of record 2: invalid value NaN; the file is damaged: export it \
             again".to_owned(),
        ),
    ];
    for (message, expected) in cases {
        assert_eq!(message, expected);
    }
}

#[test]
fn disorder_names_the_file_and_the_records() {
    let mut samples = flight(100.0, 4);
    samples.swap(1, 2);
    let folder =
        Folder::with(&[("t.sbet", &sbet(&samples, |t| t)), ("t.trj", &trj(&flight(100.0, 2), |t| t))]);
    let message = |name: &str, unproject: Option<&Unproject>| {
        folder
            .message(&folder.read(name, &Options::default()).unwrap().into_trajectory(unproject).unwrap_err())
    };
    assert_eq!(
        message("t.sbet", None),
        "t.sbet: record 3: its time 100.5 s is before the 101 s of record 2; sort its records by time"
    );
    assert_eq!(
        message("t.trj", None),
        "t.trj: its positions are projected, but it does not name their CRS; set `crs`"
    );
    assert_eq!(
        message("t.trj", Some(&|_| Err("outside of the map".to_owned()))),
        "t.trj: record 1: outside of the map; check that `crs` is the CRS of the trajectory"
    );
}

/// A truncated file is a trajectory of fewer records or an error, never a panic.
#[test]
fn files_may_be_cut_off_anywhere() {
    let samples = flight(MIDNIGHT_S + 36_000.0, 2);
    let files = [
        sbet(&samples, week),
        pof(&samples, 2, 0, week),
        sol(&samples),
        trj(&samples, week),
        text(&samples, week),
    ];
    let folder = Folder::with(&[("whole.sbet", &sbet(&samples, week))]);
    let read = |bytes: &[u8], name: &str, options: &Options| {
        fs::write(folder.path("cut"), bytes).unwrap();
        match folder.read(name, options) {
            Ok(recorded) => assert!(recorded.records.len() <= 2 && recorded.accuracies.len() <= 2),
            Err(message) => assert!(message.contains("; "), "{message}: no remedy"),
        }
    };
    for bytes in files {
        (0..=bytes.len()).for_each(|length| read(&bytes[..length], "cut", &columns("tyx_zwpk")));
    }
    let with = Options { accuracy: Some(folder.path("cut")), ..Options::default() };
    for bytes in [poq::tests::made(&[208_800.0, 208_801.0]), smrmsg::tests::made(&[208_800.0, 208_801.0])] {
        (0..=bytes.len()).for_each(|length| read(&bytes[..length], "whole.sbet", &with));
    }
}

/// False counts and sizes allocate no memory.
///
/// Allocations follow from the bytes present.
#[test]
fn counts_are_not_believed() {
    let samples = flight(MIDNIGHT_S + 36_000.0, 4);
    let mut bytes = pof(&samples, 2, 0, week);
    bytes[41..49].copy_from_slice(&i64::MAX.to_le_bytes());
    let message = read_bytes(&bytes, &Options::default()).unwrap_err();
    assert!(message.contains("record 5: 64 bytes needed, 0 left"), "{message}");
    let mut bytes = trj(&samples, week);
    bytes[16..20].copy_from_slice(&i32::MAX.to_le_bytes());
    let message = read_bytes(&bytes, &Options::default()).unwrap_err();
    assert!(message.contains("record 5: 64 bytes needed, 0 left"), "{message}");
}
