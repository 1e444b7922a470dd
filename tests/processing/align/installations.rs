//! Several jobs: each is an installation with a calibration of its own.

use super::*;

/// Boresight of the second installation.
const OTHER_BORESIGHT_DEG: [f64; 3] = [-0.3, 0.25, -0.2];
/// The command of the how-to, with another folder.
const ALIGN: [&str; 5] = ["align", "day1.toml", "day2.toml", "-o", "aligned"];

/// Strips `d` and `e` of the second installation.
static FLOWN_LATER: LazyLock<BTreeMap<String, Vec<u8>>> = LazyLock::new(|| {
    let place = TestFolder::new();
    for (number, stem, direction_deg, offset_m) in
        [(7, "d", 270.0, [40.0, 40.0]), (8, "e", 180.0, [-30.0, 50.0])]
    {
        let flown = (direction_deg, offset_m, 120);
        let job = simulation(stem, number, flown, OTHER_BORESIGHT_DEG, "house_ratio = 0.3\n", "");
        assert_eq!(place.run(&job), Outcome::success());
    }
    files(&place.path("in"))
});

/// A survey with these strips in two jobs.
fn two_days(first: &[&str], second: &[&str]) -> TestFolder {
    let place = TestFolder::new();
    place.write("in/model.json", &FLOWN["model.json"]);
    for (day, strips) in [("day1", first), ("day2", second)] {
        for strip in strips {
            for ending in ["arrow", "out"] {
                let name = format!("{strip}.{ending}");
                let bytes = FLOWN.get(&name).or_else(|| FLOWN_LATER.get(&name)).unwrap();
                place.write(&format!("{day}/{name}"), bytes);
            }
        }
        let job =
            JOB.replace("in/*.arrow", &format!("{day}/*.arrow")).replace("in/*.out", &format!("{day}/*.out"));
        place.write(&format!("{day}.toml"), format!("{job}[[stage]]\ntype = 'write_patches'\n").as_bytes());
    }
    place
}

#[test]
fn each_job_gets_its_calibration() {
    let page = include_str!("../../../docs/how-to/align-a-survey.md");
    assert!(page.contains("\nwavex align day1.toml day2.toml -o survey\n"));
    let place = two_days(&["a", "b"], &["d", "e"]);
    let Outcome { out, .. } = succeeds(&place, &ALIGN);
    println!("{out}");
    for part in [
        "\nday1:\n",
        "\nday2:\n",
        "day1/a, day2/d: ",
        "next: wavex run day1.toml \\\n  --set 'job.geometry.calibration=\"aligned/day1/calibration.toml\"'",
        "next: wavex run day2.toml \\\n  --set 'job.geometry.calibration=\"aligned/day2/calibration.toml\"'",
    ] {
        assert!(out.contains(part), "{part}: {out}");
    }
    let report = report(&place, "aligned");
    assert_eq!(
        (&report["job"], &report["installations"][1]["name"]),
        (&"day1.toml, day2.toml".into(), &"day2".into())
    );
    let angles = ["boresight_roll_rad", "boresight_pitch_rad", "boresight_yaw_rad"];
    for (day, truth_deg) in [("day1", BORESIGHT_DEG), ("day2", OTHER_BORESIGHT_DEG)] {
        let all =
            report["parameters"].as_array().unwrap().iter().filter(|found| found["installation"] == day);
        let all: Vec<&Value> = all.collect();
        assert_eq!(all.len(), 14);
        for (angle, truth_deg) in angles.into_iter().zip(truth_deg) {
            let found = all.iter().find(|found| found["name"] == angle).unwrap();
            let (value, sd) = (found["value"].as_f64().unwrap(), found["sd"].as_f64().unwrap());
            let error = value - truth_deg.to_radians();
            println!(
                "{day} {angle}: error {:.2}, SD {:.2} mdeg",
                1e3 * error.to_degrees(),
                1e3 * sd.to_degrees()
            );
            assert!(error.abs() < 4.0 * sd && sd < 4e-4, "{found}");
        }
        let calibration = place.text(&format!("aligned/{day}/calibration.toml"));
        assert!(calibration.contains("boresight_deg = ["), "{calibration}");
    }
    let names = report["covariance"]["parameters"].as_array().unwrap();
    assert!(
        names.contains(&"day1/boresight_roll_rad".into())
            && names.contains(&"day2/boresight_roll_rad".into())
    );
    let named = |day: &str| {
        let corrections = place.text(&format!("aligned/{day}/corrections.toml"));
        corrections
            .lines()
            .filter(|line| line.starts_with("recording"))
            .map(str::to_owned)
            .collect::<Vec<_>>()
    };
    assert_eq!(named("day2"), ["recording = \"d\"", "recording = \"e\""]);
    assert!(!place.path("aligned/calibration.toml").exists());
    let page = page_of(&place, "aligned", "good", "good");
    assert!(
        page.contains("<td>day2: boresight roll, deg</td>") && page.contains("day1.toml, day2.toml"),
        "{page}"
    );
    // Patch files find their jobs.
    succeeds(&place, &["run", "day1.toml", "--quiet"]);
    succeeds(&place, &["run", "day2.toml", "--quiet"]);
    succeeds(
        &place,
        &[&["align", "day1.toml", "day2.toml", "-o", "files", "--quiet", "--patches", "out"][..]].concat(),
    );
    for file in ["day1/calibration.toml", "day2/calibration.toml", "day2/corrections.toml", "align.json"] {
        assert!(place.text(&format!("aligned/{file}")) == place.text(&format!("files/{file}")), "{file}");
    }
}

/// A strip in the job of another installation is named.
#[test]
fn a_strip_in_the_wrong_job_is_named() {
    let place = two_days(&["a", "b", "c", "d"], &["e"]);
    let Outcome { out, err, .. } = succeeds(&place, &ALIGN);
    println!("{out}{err}");
    let named = "trajectories are corrected by far more than their SDs: `day1/d` by ";
    assert!(out.contains("verdict: doubtful") && err.contains(named), "{err}");
    let text = page_of(&place, "aligned", "look", "doubtful");
    assert!(text.contains("the first was probably flown with the installation of another job"), "{text}");
}

/// Jobs that do not fit together are refused; what is not determined between them is said.
#[test]
fn jobs_that_do_not_fit_together_are_named() {
    let place = two_days(&["a", "b"], &["far"]);
    let Outcome { out, err, .. } = succeeds(&place, &ALIGN);
    println!("{out}{err}");
    assert!(
        err.contains(
            "day1.toml and day2.toml share no smooth surface: each is aligned by itself, and a shift or tilt"
        ),
        "{err}"
    );
    assert!(
        place.path("aligned/day1/calibration.toml").exists() && !place.path("aligned/day2").exists(),
        "{out}"
    );
    let refused = |more: &[&str]| {
        let arguments = [&["align", "day1.toml", "-o", "refused", "--quiet"], more].concat();
        let Outcome { code, err, .. } = place.wavex(&arguments);
        assert!(code == Some(2) && !place.path("refused").exists(), "{err}");
        err
    };
    let day1 = place.text("day1.toml");
    place.write("twice.toml", day1.as_bytes());
    assert!(
        refused(&["twice.toml"])
            .contains("twice.toml: day1/a.arrow is also an input of day1.toml; give each strip")
    );
    place.write("other.toml", day1.replace("[job.geometry]", "[job.geometry]\ncrs = 'utm:32N'").as_bytes());
    let expected = "other.toml: `crs` of `[job.geometry]` is `utm:32N`, but not set in day1.toml; jobs that are aligned together";
    assert!(refused(&["other.toml"]).contains(expected));
    place.write("elsewhere/day1.toml", day1.as_bytes());
    assert!(refused(&["elsewhere/day1.toml"]).contains("day1.toml: day1.toml has the same name"));
    assert!(refused(&["day2.toml", "--reference", "a"]).contains("the strips are day1/a, day1/b, day2/far"));
}
