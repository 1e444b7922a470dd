//! `wavex align --patches`: files of `write_patches` instead of recordings.

use super::*;

const WRITE: &str = "[[stage]]\ntype = 'write_patches'\n";
const ALIGN: [&str; 4] = ["align", "survey.toml", "-o", "aligned"];
const RESULTS: [&str; 3] = ["calibration.toml", "corrections.toml", "align.json"];

/// A survey whose job writes patches.
fn survey_of_patches(strips: &[&str]) -> TestFolder {
    let place = survey(strips);
    place.write("survey.toml", format!("{JOB}{WRITE}").as_bytes());
    place
}

/// Patch files of runs that do not know each other.
static PATCHES: LazyLock<BTreeMap<String, Vec<u8>>> = LazyLock::new(|| {
    let place = survey_of_patches(&["a", "b", "c", "far"]);
    for strip in ["far", "c", "a", "b"] {
        let input = format!("read_arrow.path=in/{strip}.arrow");
        succeeds(&place, &["run", "survey.toml", "--quiet", "--set", &input]);
    }
    let mut all = files(&place.path("out"));
    all.retain(|name, _| name.ends_with("_patches.arrow"));
    all
});

/// Writes the patches of these strips.
fn with_patches(place: &TestFolder, strips: &[&str]) {
    for strip in strips {
        let name = format!("{strip}_patches.arrow");
        place.write(&format!("out/{name}"), &PATCHES[&name]);
    }
}

/// Patch files of separate runs, and tasks of a plan, give the bytes of an alignment of the recordings.
#[test]
fn patch_files_give_the_alignment_of_the_recordings() {
    let place = survey_of_patches(&["a", "b", "c"]);
    succeeds(&place, &["align", "survey.toml", "-o", "read", "--quiet"]);
    let expect_equal = |folder: &str, other: &str| {
        for name in RESULTS {
            let found = place.text(&format!("{folder}/{name}"));
            assert!(found == place.text(&format!("{other}/{name}")), "{folder}/{name}\n{found}");
        }
    };
    with_patches(&place, &["a", "b", "c"]);
    // In any order.
    let given = ["c", "b", "a"].map(|strip| format!("out/{strip}_patches.arrow"));
    let given: Vec<&str> = given.iter().map(String::as_str).collect();
    succeeds(
        &place,
        &[&["align", "survey.toml", "-o", "files", "--quiet", "--patches"], &given[..]].concat(),
    );
    expect_equal("files", "read");
    // As tasks of a plan, whose bytes are those of separate runs; with options.
    place.write("gcp.csv", control(&[]).as_bytes());
    let options = "--trajectory 5 --estimate e2 --reference b --control gcp.csv --control-crs utm:33N";
    let options: Vec<&str> = options.split(' ').collect();
    succeeds(
        &place,
        &[&["align", "survey.toml", "-o", "optional", "--patches", "out", "--quiet"], &options[..]].concat(),
    );
    fs::remove_dir_all(place.path("out")).unwrap();
    succeeds(
        &place,
        &[&["plan", "survey.toml", "-o", "plan", "--align", "collected"], &options[..]].concat(),
    );
    for strip in ["b", "c", "a"] {
        succeeds(&place, &["run", &format!("plan/tasks/{strip}.toml"), "--quiet"]);
    }
    let collected = succeeds(&place, &["collect", "plan"]);
    assert!(collected.out.contains("verdict: "), "{}", collected.out);
    for strip in ["a", "b", "c"] {
        let name = format!("{strip}_patches.arrow");
        assert!(fs::read(place.path(&format!("out/{name}"))).unwrap() == PATCHES[&name], "{name}");
    }
    expect_equal("collected", "optional");
    // Without the recordings.
    fs::remove_file(place.path("in/a.arrow")).unwrap();
    fs::remove_file(place.path("in/b.arrow")).unwrap();
    fs::remove_file(place.path("in/c.arrow")).unwrap();
    succeeds(&place, &["align", "survey.toml", "-o", "alone", "--patches", "out", "--quiet"]);
    assert!(place.text("alone/calibration.toml") == place.text("read/calibration.toml"));
    assert!(place.text("alone/corrections.toml") == place.text("read/corrections.toml"));
}

/// `from` as `to`, everywhere in a file.
fn replaced(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    assert_eq!(from.len(), to.len());
    let mut bytes = bytes.to_vec();
    let places: Vec<usize> =
        (0..=bytes.len() - from.len()).filter(|at| bytes[*at..].starts_with(from)).collect();
    assert!(!places.is_empty(), "{}", String::from_utf8_lossy(from));
    places.into_iter().for_each(|at| bytes[at..at + to.len()].copy_from_slice(to));
    bytes
}

/// Records of a trajectory, changed.
fn changed(strip: &str, change: impl Fn(SbetRecord) -> SbetRecord) -> Vec<u8> {
    let (records, _) = FLOWN[&format!("{strip}.out")].as_chunks::<RECORD_BYTES>();
    records.iter().flat_map(|record| change(SbetRecord::decode(record)).encode()).collect()
}

/// Every unusable patch file is named with a remedy, and the other strips are aligned.
#[test]
fn unusable_patches_are_named_and_the_rest_is_aligned() {
    const FILE: &str = "out/c_patches.arrow";
    type Break = fn(&TestFolder);
    let again = |place: &TestFolder, set: &str| {
        let input = "read_arrow.path=in/c.arrow";
        succeeds(place, &["run", "survey.toml", "--quiet", "--set", input, "--set", set]);
    };
    let of_c = &PATCHES["c_patches.arrow"];
    let cases: [(Break, &str); 12] = [
        (
            |place| place.write(FILE, &PATCHES["c_patches.arrow"][..5000]),
            "out/c_patches.arrow: byte 4990: end of the file: the footer is missing; the file is cut off: copy it again",
        ),
        (
            |place| place.write(FILE, &FLOWN["c.arrow"]),
            "out/c_patches.arrow: not the patches of a strip; run its strip again with `write_patches`",
        ),
        (|place| place.write(FILE, b"time,x,y,z\n"), "out/c_patches.arrow: "),
        (
            |place| {
                let other = replaced(&PATCHES["c_patches.arrow"], b"\x01\0\0\x002\0", b"\x01\0\0\x001\0");
                place.write(FILE, &other);
            },
            "out/c_patches.arrow: version 1 of patches is not supported; run its strip again with `write_patches`",
        ),
        (
            |place| {
                place.write(FILE, &replaced(&PATCHES["c_patches.arrow"], b"\"patches\":", b"\"patchez\":"))
            },
            "out/c_patches.arrow: invalid description of the strip: ",
        ),
        (
            |place| {
                let name = "out/d_patches.arrow";
                place.write(name, &PATCHES["a_patches.arrow"]);
                fs::remove_file(place.path(FILE)).unwrap();
            },
            "out/d_patches.arrow: the patches of `a` are also in out/a_patches.arrow, which are used; remove the file",
        ),
        (
            |place| fs::remove_file(place.path(FILE)).unwrap(),
            "c: none of the given files has the patches of this input; run it with `write_patches`",
        ),
        (
            |place| {
                fs::remove_file(place.path(FILE)).unwrap();
                fs::remove_file(place.path("in/c.arrow")).unwrap();
                place.write("in/far.out", &FLOWN["far.out"]);
                with_patches(place, &["far"]);
            },
            "far: the strip shares no smooth surface with another one and is not aligned; check its trajectory and area",
        ),
        (
            |place| place.write("in/c.out", &FLOWN["far.out"]),
            "out/c_patches.arrow: the strip lasts from 209000",
        ),
        (
            |place| {
                let shifted =
                    |record: SbetRecord| SbetRecord { longitude_rad: record.longitude_rad + 1e-3, ..record };
                place.write("in/c.out", &changed("c", shifted));
            },
            "out/c_patches.arrow: at its first shot the aircraft is ",
        ),
        (
            |place| {
                let raised = |record: SbetRecord| SbetRecord { height_m: record.height_m + 0.01, ..record };
                place.write("in/c.out", &changed("c", raised));
            },
            "out/c_patches.arrow: the patches were made with other records of a trajectory (c.out) than those of ",
        ),
        (
            |place| {
                let length = PATCHES["c_patches.arrow"].len() as u64;
                let mut many = PATCHES["c_patches.arrow"].clone();
                many.truncate(length as usize - 200);
                place.write(FILE, &many);
            },
            "out/c_patches.arrow: ",
        ),
    ];
    let aligned = |place: &TestFolder, expected: &str| {
        let quick = ["--trajectory", "none", "--patches", "out"];
        let Outcome { code, out, err } = place.wavex(&[&ALIGN[..], &quick].concat());
        println!("{err}");
        let named = expected.starts_with("far: ") || err.contains(&format!("left out: {expected}"));
        assert!(named && err.contains(expected), "{expected}\n{err}");
        assert_eq!(code, Some(0), "{err}");
        assert!(out.contains("verdict: "), "{out}");
    };
    for (change, expected) in cases {
        let place = survey_of_patches(&["a", "b", "c"]);
        with_patches(&place, &["a", "b", "c"]);
        change(&place);
        aligned(&place, expected);
    }
    // More or fewer patches than stated, by one digit.
    let description = String::from_utf8_lossy(of_c).into_owned();
    let digits = description.split("\"patches\":").nth(1).unwrap().split(',').next().unwrap().to_owned();
    let stated = |number: u64| {
        let (from, to) = (format!("\"patches\":{digits},"), format!("\"patches\":{number},"));
        let place = survey_of_patches(&["a", "b", "c"]);
        with_patches(&place, &["a", "b"]);
        place.write(FILE, &replaced(of_c, from.as_bytes(), to.as_bytes()));
        place
    };
    let number: u64 = digits.parse().unwrap();
    aligned(&stated(number + 1), &format!("{FILE}: it has {number} patches instead of {}; run", number + 1));
    aligned(
        &stated(number - 1),
        &format!("{FILE}: it has more patches than the {} that it states; run", number - 1),
    );
    for (set, expected) in [
        (
            "job.geometry.mount=[0,0,1]",
            "the patches were made with another `mount` than the job's; run its strip again",
        ),
        (
            "job.geometry.calibration={lever_arm_m=[0.3,-0.2,0.4],e0=0.05}",
            "the patches were made with another `calibration` than the job's: e0 = 0.05 instead of e0 = 0.03; run its strip",
        ),
    ] {
        let place = survey_of_patches(&["a", "b", "c"]);
        with_patches(&place, &["a", "b"]);
        again(&place, set);
        aligned(&place, &format!("{FILE}: {expected}"));
    }
}

#[test]
fn missing_patches_are_refused() {
    let place = survey_of_patches(&["a", "b"]);
    let refused = |arguments: &[&str]| {
        let Outcome { code, err, .. } = place.wavex(arguments);
        (code, err)
    };
    fs::create_dir(place.path("empty")).unwrap();
    let (code, err) = refused(&[&ALIGN[..], &["--patches", "empty"]].concat());
    assert_eq!(code, Some(1));
    assert!(
        err.contains("empty: no patches (*_patches.arrow); run the job with the stage `write_patches`"),
        "{err}"
    );
    place.write("survey.toml", JOB.as_bytes());
    let (code, err) = refused(&["plan", "survey.toml", "-o", "plan", "--align", "aligned"]);
    assert_eq!(code, Some(1));
    assert!(err.contains("an alignment needs the patches of all strips, but the job writes none"), "{err}");
    for (options, code, expected) in [
        (&["--trajectory", "linear"][..], 2, "are for an alignment; add `--align FOLDER`"),
        (
            &["--align", "aligned", "--reference", "z"],
            2,
            "there is no strip `z` for `--reference`; the strips are a, b",
        ),
        (&["--align", "aligned", "--control", "none.csv"], 2, "none.csv"),
    ] {
        let (found, err) = refused(&[&["plan", "survey.toml", "-o", "plan"], options].concat());
        assert!(found == Some(code) && err.contains(expected), "{options:?}: {found:?} {err}");
    }
    assert!(!place.path("plan").exists());
    place.write("survey.toml", format!("{JOB}{WRITE}path = 'patches.arrow'\n").as_bytes());
    let (code, err) = refused(&["check", "survey.toml"]);
    assert_eq!(code, Some(2));
    assert!(err.contains("it must end in _patches.arrow"), "{err}");
}
