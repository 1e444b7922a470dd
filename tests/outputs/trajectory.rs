//! `wavex trajectory`: summary, table and errors.

use wavex_testkit::{Outcome, TestFolder};

/// Runs `wavex trajectory` in a folder.
fn trajectory(place: &TestFolder, arguments: &[&str]) -> Outcome {
    place.wavex(&[&["trajectory"], arguments].concat())
}

/// Standard output for a valid trajectory.
#[track_caller]
fn printed(place: &TestFolder, arguments: &[&str]) -> String {
    let Outcome { code, out, err } = trajectory(place, arguments);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    out
}

/// Value of a row of the summary.
#[track_caller]
fn said<'a>(summary: &'a str, name: &str) -> &'a str {
    let row = summary.lines().find_map(|line| line.strip_prefix(&format!("  {name:<10} ")));
    row.unwrap_or_else(|| panic!("{name}:\n{summary}"))
}

/// A simulated flight with its SBET and POF in `out`.
fn flown() -> TestFolder {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 40\nshots_per_line = 100\nroll_deg = 3\n\
               sbet = '*.sbet'\npof = '*.pof'\n[[stage]]\ntype = 'write_arrow'\n";
    assert_eq!(place.run(job), Outcome::success());
    place
}

/// Rows of a table, without its header.
fn rows(text: &str) -> Vec<Vec<f64>> {
    let rows = text.lines().filter(|line| !line.starts_with('#'));
    rows.map(|row| row.split(' ').map(|cell| cell.parse().unwrap()).collect()).collect()
}

#[test]
fn trajectory_is_projected_and_thinned() {
    let place = flown();
    let out = printed(&place, &["out/flight.sbet", "--every", "10", "-o", "po.txt", "--svg", "po.svg"]);
    assert!(out.starts_with("out/flight.sbet: SBET, "), "{out}");
    assert_eq!(said(&out, "clock"), "seconds of the week, GPS");
    assert!(said(&out, "times").starts_with("Tuesday 09:59:59.0 to "), "{out}");
    assert_eq!(said(&out, "rate"), "200.00 Hz, one record every 5.000 ms");
    assert_eq!(said(&out, "gaps"), "none");
    assert_eq!(said(&out, "map"), "EPSG:32633 (WGS 84 / UTM zone 33N)");
    assert!(out.ends_with("\nwrote po.txt, po.svg\n"), "{out}");

    let text = place.text("po.txt");
    let header = "# t lon lat h x y z w p k: seconds of the week; degrees; m; EPSG:32633 (WGS 84 / UTM zone 33N); roll, pitch and \
                  heading in degrees";
    assert_eq!(text.lines().next(), Some(header));
    let table = rows(&text);
    assert!(table.iter().all(|row| row.len() == 10));
    assert!(table.windows(2).all(|pair| (pair[1][0] - pair[0][0] - 0.05).abs() < 1e-6));
    // It starts one second before 320 000 E 5 300 000 N, 600 m above ground of 400 m, and flies
    // north.
    assert!(
        (table[20][4] - 320_000.0).abs() < 1e-3 && (table[20][5] - 5_300_000.0).abs() < 1e-3,
        "{:?}",
        table[20]
    );
    assert!((table[20][3] - 1000.0).abs() < 1e-3 && table[20][6] == table[20][3]);

    let svg = place.text("po.svg");
    assert!(svg.starts_with("<svg ") && svg.ends_with("</svg>\n"));
    for part in
        ["flight.sbet", "easting, m", "height, m", "start", "end", "prefers-color-scheme:dark", "<polyline"]
    {
        assert!(svg.contains(part), "{part}");
    }
}

/// The table is itself a valid trajectory: reading it as text gives the same positions.
#[test]
fn what_is_written_can_be_read() {
    let place = flown();
    printed(&place, &["out/flight.pof", "-o", "po.txt"]);
    let options = ["po.txt", "--columns", "txyz___wpk", "--time", "adjusted", "-o", "again.txt"];
    let out = printed(&place, &options);
    assert!(out.starts_with("po.txt: text, "), "{out}");
    let (first, again) = (rows(&place.text("po.txt")), rows(&place.text("again.txt")));
    assert_eq!(first.len(), again.len());
    let same = |(a, b): (&Vec<f64>, &Vec<f64>)| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-4);
    assert!(first.iter().zip(&again).all(same));
}

#[test]
fn both_formats_of_a_flight_agree() {
    let place = flown();
    let out = printed(&place, &["out/flight.pof", "--crs", "geodetic", "-o", "pof.txt"]);
    assert_eq!(said(&out, "clock"), "seconds of the week, GPS, 2025-05-06");
    assert!(said(&out, "times").starts_with("2025-05-06 09:59:59.0 to 10:00:0"), "{out}");
    printed(&place, &["out/flight.sbet", "--crs", "geodetic", "-o", "sbet.txt"]);
    let (pof, sbet) = (rows(&place.text("pof.txt")), rows(&place.text("sbet.txt")));
    assert_eq!(pof.len(), sbet.len());
    for (a, b) in pof.iter().zip(&sbet) {
        assert!((a[0] - b[0] - (2365.0 * 604_800.0 - 1e9)).abs() < 2e-6);
        assert!(a[1..].iter().zip(&b[1..]).all(|(a, b)| (a - b).abs() < 1e-6), "{a:?} {b:?}");
        assert_eq!((a[1], a[2]), (a[4], a[5]), "geodetic coordinates are longitude and latitude");
    }
}

#[test]
fn trajectory_gaps_are_listed() {
    let place = TestFolder::new();
    let rows = (0..40).filter(|k| !(20..25).contains(k) && !(30..37).contains(k));
    let text: String =
        rows.map(|k| format!("{},179.99{k:02},-17,500,0,0,90\n", 0.1 * f64::from(k))).collect();
    place.write("t.csv", text.as_bytes());
    let out = printed(&place, &["t.csv", "--columns", "txyzwpk", "--svg", "t.svg"]);
    assert_eq!(said(&out, "gaps"), "2, the longest 0.800 s; 2 exceed the 0.500 s limit of bridging");
    assert!(out.contains("0.600 s after 1.900 s: no poses in it"), "{out}");
    assert_eq!(said(&out, "longitude"), "179.9900000 to 179.9939000");
    // One line for each of the three parts, in the plan and in the heights.
    assert_eq!(place.text("t.svg").matches("<polyline class=\"fit\"").count(), 6);
}

#[test]
fn what_is_no_trajectory_is_refused() {
    let place = TestFolder::with(&[("a.las", b"LASF\0\0\0\0"), ("t.txt", b"1 11 48 500 0 0 90\n")]);
    let refused = |arguments: &[&str]| {
        let Outcome { code, out, err } = trajectory(&place, arguments);
        assert_eq!(out, "");
        (code, err)
    };
    let (code, err) = refused(&["a.las", "-o", "a.txt"]);
    assert_eq!(err, "error: a.las: it is a recording, not a trajectory; `wavex scan a.las` describes it\n");
    assert_eq!(code, Some(2));
    let options = ["t.txt", "--columns", "txyzwpk"];
    assert_eq!(
        refused(&options),
        (
            Some(1),
            "error: t.txt: 1 record(s): at least two are needed; export it again from its source\n"
                .to_owned()
        )
    );
    let (code, err) = refused(&[options.as_slice(), &["--crs", "EPSG:1"]].concat());
    assert!(code == Some(2) && err.starts_with("error: --crs EPSG:1: "), "{err}");
    let (code, err) = refused(&[options.as_slice(), &["--every", "0"]].concat());
    assert!(code == Some(2) && err.contains("give a whole number of at least 1"), "{err}");
    assert!(!place.path("a.txt").exists(), "a failed run leaves no outputs");
}
