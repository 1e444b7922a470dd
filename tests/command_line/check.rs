//! `wavex check`: inputs, sizes, shots, free space.

use std::fs;

use wavex_geodesy::crs::wkt_of_epsg;
use wavex_testkit::flight::sbet;
use wavex_testkit::las::Las;
use wavex_testkit::pulsewaves::PulseWaves;
use wavex_testkit::{Outcome, TO_TABLE, TestFolder};

/// A folder with a job of this reader.
fn place(reader: &str, paths: &str) -> TestFolder {
    let place = TestFolder::new();
    let job = format!(
        "[job]\noutput_dir = 'out'\n[[stage]]\ntype = '{reader}'\npath = {paths}\n[[stage]]\ntype = 'write_arrow'\n"
    );
    place.write("job.toml", job.as_bytes());
    place
}

fn check(place: &TestFolder, arguments: &[&str]) -> Outcome {
    let outcome = place.wavex(&[&["check", "job.toml"], arguments].concat());
    let folder = place.path("").canonicalize().unwrap();
    let here = |text: String| text.replace(&folder.display().to_string(), "HERE");
    Outcome { code: outcome.code, out: here(outcome.out), err: here(outcome.err) }
}

/// Lines of the output with this name.
fn lines<'o>(outcome: &'o Outcome, name: &str) -> Vec<&'o str> {
    let name = format!("  {name}:");
    outcome.out.lines().filter_map(|line| line.strip_prefix(&name)).map(str::trim).collect()
}

#[test]
fn the_size_of_the_inputs_and_the_number_of_points_are_printed() {
    let place = place("read_las", "'*.las'");
    let las = Las::new(7);
    for stem in ["a", "b"] {
        place.write(&format!("{stem}.las"), &las.las());
        place.write(&format!("{stem}.wdp"), &las.packets);
    }
    let outcome = check(&place, &["--inputs=required"]);
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
    let kilobytes = 2.0 * (las.las().len() + las.packets.len()) as f64 / 1e3;
    assert_eq!(lines(&outcome, "files"), [format!("2, {kilobytes:.1} kB")]);
    // Two first returns may be of one shot, and a shot may have none.
    let counted =
        "about 14, the number of first returns by the header, or else of points; about 14 to 42 points";
    assert_eq!(lines(&outcome, "shots"), [counted]);
    let output = lines(&outcome, "output");
    assert!(
        output[0].starts_with("./out (will be created, ") && output[0].ends_with("B free)"),
        "{output:?}"
    );

    let place = self::place("read_pulsewaves", "'a.pls'");
    let pulses = PulseWaves::new(5);
    place.write("a.pls", &pulses.pls());
    place.write("a.wvs", &pulses.waves);
    assert_eq!(lines(&check(&place, &[]), "shots"), ["5; about 5 to 15 points"]);
}

#[test]
fn a_geographic_crs_of_the_beams_is_a_problem() {
    let place = place("read_las", "'a.las'\ncrs_of_input = 'degrees.wkt'");
    let las = Las::new(5).at_northing(530_000_000);
    place.write("a.las", &las.las());
    place.write("a.wdp", &las.packets);
    place.write("degrees.wkt", wkt_of_epsg(4326).unwrap().as_bytes());
    for set in [&[][..], &["--set", "read_las.crs_of_input=EPSG:4326"]] {
        let outcome = check(&place, set);
        let [warning] = lines(&outcome, "warning")[..] else { panic!("{}", outcome.out) };
        assert!(
            warning.starts_with("HERE/a.las: `crs_of_input`: ") && warning.contains("WGS 84"),
            "{warning}"
        );
        assert!(warning.contains(" is in degrees, but the recording begins at "), "{warning}");
    }
    place.write("text.wkt", b"no WKT");
    let outcome = check(&place, &["--set", "read_las.crs_of_input=text.wkt"]);
    let [warning] = lines(&outcome, "warning")[..] else { panic!("{}", outcome.out) };
    assert!(warning.contains("the WKT cannot be read"), "{warning}");
    let outcome = check(&place, &["--set", "read_las.crs_of_input=utm:33N"]);
    assert_eq!(lines(&outcome, "warning"), Vec::<&str>::new());
}

#[test]
fn the_expected_time_of_a_small_job_is_seconds() {
    let place = place("read_pulsewaves", "'a.pls'");
    let pulses = PulseWaves::new(5);
    place.write("a.pls", &pulses.pls());
    place.write("a.wvs", &pulses.waves);
    let time = |arguments: &[&str]| lines(&check(&place, arguments), "time")[0].to_owned();
    assert_eq!(time(&["--set", "job.threads=1"]), "about 1 s on 1 core");
    assert_eq!(time(&["--set", "job.threads=4"]), "about 1 s on 4 cores");
}

#[test]
fn a_trajectory_must_cover_its_recording() {
    let (reader, name) = ("read_arrow", "a.arrow");
    let place = place(reader, &format!("'{name}'"));
    assert_eq!(place.run("[[stage]]\ntype = 'simulate'\nstem = 'a'\nlines = 6\nshots_per_line = 200\npulse_rate_hz = 1000\nsbet = '*.out'\n[[stage]]\ntype = 'write_arrow'\npath = '../*.arrow'\n").code, Some(0));
    let job = format!(
        "[job.geometry]\ntrajectory = '*.sbet'\n[[stage]]\ntype = '{reader}'\npath = '{name}'\n[[stage]]\ntype = 'write_arrow'\npath = 'out/*.arrow'\n"
    );
    place.write("job.toml", job.as_bytes());
    let scanned: serde_json::Value =
        serde_json::from_str(&place.wavex(&["scan", name, "--json"]).out).unwrap();
    let [first_s, last_s] = ["first_shot_s", "last_shot_s"].map(|key| scanned[key].as_f64().unwrap());
    let warnings = |times_s: [f64; 2]| -> Vec<String> {
        place.write("a.sbet", &sbet(times_s));
        lines(&check(&place, &[]), "warning").into_iter().map(str::to_owned).collect()
    };
    assert_eq!(warnings([first_s - 1.0, last_s + 1.0]), Vec::<String>::new(), "{name}");
    let elsewhere = warnings([first_s + 5_000.0, last_s + 5_000.0]);
    let problem = format!(
        "HERE/{name}: the recording and the trajectory have no time in common: the recording lasts from "
    );
    assert!(elsewhere.len() == 1 && elsewhere[0].starts_with(&problem), "{elsewhere:?}");
    if last_s - first_s > 0.5 {
        let half = warnings([first_s - 1.0, 0.5 * (first_s + last_s)]);
        let problem =
            format!("HERE/{name}: the trajectory covers 50 % of the recording: the recording lasts from ");
        assert!(half.len() == 1 && half[0].starts_with(&problem), "{half:?}");
    }
    place.write("a.sbet", b"no trajectory");
    let unreadable = lines(&check(&place, &[]), "warning").join("\n");
    assert!(unreadable.starts_with("HERE/a.sbet: ") && !unreadable.contains('\n'), "{unreadable}");
}

/// LAS and PulseWaves of the tests are in a map.
#[test]
fn a_trajectory_that_is_not_used_is_named_and_need_not_exist() {
    let said = "the recording is already in a projected CRS: `trajectory` is not used; remove it from `[job.geometry]`";
    let (las, waves) = (Las::new(20), PulseWaves::new(20));
    for (reader, name) in [("read_las", "a.las"), ("read_pulsewaves", "a.pls")] {
        let place = place(reader, "''");
        let files: [(&str, &[u8]); 4] = [
            ("a.las", &las.las()),
            ("a.wdp", &las.packets),
            ("a.pls", &waves.pls()),
            ("a.wvs", &waves.waves),
        ];
        files.iter().for_each(|(name, bytes)| place.write(name, bytes));
        let job = format!(
            "[job]\noutput_dir = 'out'\n[job.geometry]\ntrajectory = '*.sbet'\n[[stage]]\ntype = '{reader}'\npath = '{name}'\n[[stage]]\ntype = 'write_arrow'\n"
        );
        place.write("job.toml", job.as_bytes());
        for trajectory in [None, Some(sbet([1.0, 2.0])), Some(b"no trajectory".to_vec())] {
            trajectory.into_iter().for_each(|bytes| place.write("a.sbet", &bytes));
            assert_eq!(lines(&check(&place, &[]), "warning"), [format!("HERE/{name}: {said}")]);
            let outcome = place.wavex(&["run", "job.toml"]);
            assert!(outcome.code == Some(0) && outcome.err.contains(said), "{outcome:?}");
        }
    }
}

/// A run judges by the same function.
#[test]
fn coordinates_of_beams_are_judged_as_by_a_run() {
    let place = place("read_las", "''");
    let las = Las::new(320);
    place.write("a.las", &las.las());
    place.write("a.wdp", &las.packets);
    let keeps = "the points stay in EPSG:32633 (WGS 84 / UTM zone 33N), the CRS of the recording: `crs` of `[job.geometry]` \
                 names EPSG:25833 (ETRS89 / UTM zone 33N), which has the same coordinates; remove `crs`, or name the CRS \
                 with the reader's key `crs_of_input`, to write that name";
    let refuses = "the beams of this recording are already in WGS 84 / UTM zone 33N, but `[job.geometry]` requests other \
                   coordinates; ";
    for (crs, code, expected) in [
        ("EPSG:32633", 0, None),
        ("utm:33N", 0, None),
        ("EPSG:25833", 0, Some(keeps)),
        ("EPSG:25832", 1, Some(refuses)),
        ("EPSG:4326", 1, Some(refuses)),
    ] {
        let job = format!(
            "[job]\noutput_dir = 'out'\n[job.geometry]\ncrs = '{crs}'\n[[stage]]\ntype = 'read_las'\npath = 'a.las'\ncrs_of_input = 'EPSG:32633'\n{TO_TABLE}"
        );
        place.write("job.toml", job.as_bytes());
        let checked = check(&place, &[]);
        let outcome = place.wavex(&["run", "job.toml"]);
        assert_eq!(outcome.code, Some(code), "{outcome:?}");
        // The beams are made west of the zone.
        let mut warnings = lines(&checked, "warning");
        warnings.retain(|warning| !warning.contains("is made for longitude"));
        match (warnings.as_slice(), expected) {
            ([], None) => {}
            ([warning], Some(expected)) => {
                assert!(
                    warning.strip_prefix("HERE/a.las: ").is_some_and(|said| said.starts_with(expected)),
                    "{warning}"
                );
                assert!(outcome.err.contains(expected), "{}", outcome.err);
            }
            (warnings, _) => panic!("{crs}: {warnings:?}"),
        }
    }
}

#[test]
fn a_format_without_a_number_of_shots_is_named() {
    let place = place("read_arrow", "'a.arrow'");
    place.write("a.arrow", b"");
    let expected = "unknown, and so are the points: read_arrow counts shots only by reading the data";
    assert_eq!(lines(&check(&place, &[]), "shots"), [expected]);
}

#[test]
fn inputs_that_are_missing_or_damaged_are_warnings_or_errors() {
    let place = place("read_las", "['a.las', 'none/*.las', 'b.las', 'more/*.laz']");
    place.write("a.las", b"LASF");
    let problems = [
        "no file matches `HERE/none/*.las`; check `path` of the reader and `input_dir` of the job",
        "no file matches `HERE/more/*.laz`; check `path` of the reader and `input_dir` of the job",
        "HERE/b.las: no such file; did you mean HERE/a.las?",
        "HERE/a.las: byte 4: file source ID: 2 bytes needed, 0 left; the file is cut off: copy it again from its source",
    ];
    for arguments in [&[][..], &["--inputs=optional"]] {
        let outcome = check(&place, arguments);
        assert_eq!((outcome.code, outcome.err.as_str()), (Some(0), ""));
        assert_eq!(lines(&outcome, "warning"), problems);
    }
    let expected = format!("error: job.toml: 4 problems with the inputs\n  {}\n", problems.join("\n  "));
    assert_eq!(check(&place, &["--inputs=required"]), Outcome::failure(2, expected));
    assert!(!place.path("out").exists());

    fs::remove_file(place.path("job.toml")).unwrap();
    place.write("job.toml", b"[[stage]]\ntype = 'read_las'\npath = 'b.las'\n");
    let expected =
        "error: job.toml: 1 problem with the inputs\n  HERE/b.las: no such file; did you mean HERE/a.las?\n";
    assert_eq!(check(&place, &["--inputs=required"]), Outcome::failure(2, expected));
}

#[test]
fn a_recording_of_another_format_than_hdf5_is_named() {
    let job = b"[[stage]]\ntype = 'read_hdf5'\npath = 'a.pls'\n[[stage]]\ntype = 'measure_footprints'\n\
        [[stage]]\ntype = 'write_footprints'\n";
    let place = TestFolder::with(&[("job.toml", job), ("a.pls", b"PulseWavesPulse\0")]);
    let checked = check(&place, &[]);
    let warnings = lines(&checked, "warning");
    assert!(warnings.iter().any(|warning| warning.contains("this is PulseWaves, not HDF5")), "{warnings:?}");
}
