//! `wavex scan`: the summary matches the recording, and read errors are reported.

use std::fs;

use wavex_formats::container::EmissionReference;
use wavex_testkit::container::{Shot, of_shots};
use wavex_testkit::las::Las;
use wavex_testkit::pulsewaves::PulseWaves;
use wavex_testkit::{Outcome, TestFolder, data};

/// Runs `wavex scan` in a folder.
fn scan(place: &TestFolder, arguments: &[&str]) -> Outcome {
    place.wavex(&[&["scan"], arguments].concat())
}

/// Summary of a successful scan without messages on standard error.
#[track_caller]
fn summary(place: &TestFolder, arguments: &[&str]) -> String {
    let Outcome { code, out, err } = scan(place, arguments);
    assert_eq!((code, err.as_str()), (Some(0), ""));
    out
}

/// Value of a row in a section of the summary.
#[track_caller]
fn said<'a>(summary: &'a str, section: &str, name: &str) -> &'a str {
    let from = summary.find(&format!("\n{section}\n")).unwrap_or_else(|| panic!("{section}:\n{summary}"));
    let lines = summary[from + 1..].lines().skip(1).take_while(|line| !line.is_empty());
    let found = lines.filter_map(|line| line.trim_start().strip_prefix(name)).next();
    found.unwrap_or_else(|| panic!("{section}: {name}:\n{summary}")).trim()
}

/// Counts of a histogram file.
fn counts(text: &str) -> Vec<(f64, u64)> {
    let rows = text.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    rows.map(|row| row.split_once('\t').unwrap())
        .map(|(a, b)| (a.parse().unwrap(), b.parse().unwrap()))
        .collect()
}

fn files(place: &TestFolder) -> Vec<String> {
    let entries = fs::read_dir(place.path("")).unwrap();
    let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.retain(|name| name.contains('_'));
    names.sort();
    names
}

/// A simulated recording, `out/flight.arrow`.
fn simulated(keys: &str) -> TestFolder {
    let place = TestFolder::new();
    let job = format!(
        "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 20\nshots_per_line = 500\npulse_rate_hz = 400000\n\
         {keys}\n[[stage]]\ntype = 'write_arrow'\n"
    );
    assert_eq!(place.run(&job), Outcome::success());
    place
}

#[test]
fn scan_describes_a_simulated_flight() {
    let place =
        simulated("modulation_ns = 30\nhigh_power = true\nground_amplitude_dn = 180\nflying_height_m = 800");
    let out = summary(&place, &["out/flight.arrow", "--out", "flight"]);
    assert_eq!(said(&out, "Times", "shots"), "10 000");
    assert_eq!(said(&out, "Times", "gaps within lines"), "none");
    assert_eq!(said(&out, "Times", "clock runs backwards"), "never");
    assert_eq!(said(&out, "Rates", "pulse rate, nominal"), "400000 Hz");
    // Each pulse is up to 15 ns early or late: intervals have an RMS of 30 ns / √6.
    let modulation = said(&out, "Rates", "modulation of the interval").strip_suffix(" ns RMS").unwrap();
    assert!((modulation.parse::<f64>().unwrap() - 30.0 / 6f64.sqrt()).abs() < 0.3, "{modulation}");
    assert_eq!(said(&out, "Lines", "scan lines"), "20");
    assert_eq!(said(&out, "Lines", "facets"), "4");
    let noise = said(&out, "Channel: low power", "noise").split_once(" DN").unwrap().0;
    assert!((noise.parse::<f64>().unwrap() - 0.93).abs() < 0.02, "{noise}");
    let lags = said(&out, "Channel: low power", "noise autocorrelation");
    for (got, exact) in lags.split(' ').zip([0.63, 0.42, 0.22, 0.11]) {
        assert!((got.parse::<f64>().unwrap() - exact).abs() < 0.03, "{lags}");
    }
    assert!(said(&out, "Channel: high power", "blocks").len() >= 4, "{out}");
    assert_eq!(said(&out, "Channel: outgoing pulse", "blocks"), "10 000");
    assert_eq!(said(&out, "Integrity", "read to the end"), "yes");
    assert_eq!(said(&out, "Integrity", "rejected"), "nothing");

    let written = ["amplitudes.txt", "angles.txt", "noise.txt", "ranges.txt", "scan.html", "scan.txt"];
    assert_eq!(files(&place), written.map(|what| format!("flight_{what}")));
    let (text, last) = out.rsplit_once("\nwrote ").unwrap();
    assert_eq!(text, place.text("flight_scan.txt"));
    assert!(last.starts_with("flight_scan.txt, flight_amplitudes.txt, "), "{last}");
    let angles = place.text("flight_angles.txt");
    assert!(angles.starts_with("# scan angles: 10000 values, bins 0.25 wide\n# centre of the bin: angle of a shot, degrees\tcount\n"), "{angles}");
    assert_eq!(counts(&angles).iter().map(|bin| bin.1).sum::<u64>(), 10_000);
    // At nadir, the range to the ground equals the flying height.
    let ranges = counts(&place.text("flight_ranges.txt"));
    assert!(ranges.iter().all(|(centre, _)| (740.0..960.0).contains(centre)), "{:?}", ranges.first());

    let page = place.text("flight_scan.html");
    assert!(page.starts_with("<!DOCTYPE html>") && page.contains("prefers-color-scheme:dark"));
    let without_namespace = page.replace("xmlns=\"http://www.w3.org/2000/svg\"", "");
    assert!(
        !page.contains("<script") && !without_namespace.contains("://"),
        "no script or external resource"
    );
    for title in ["amplitudes, low power", "ranges", "echo blocks over time", "angles of ", "shot 0, "] {
        assert!(page.contains(&format!("<h3>{title}")), "{title}");
    }
    assert_eq!(page.matches("<figure>").count(), page.matches("</svg>").count());
}

#[test]
fn fast_leaves_the_samples_out_and_says_the_same_else() {
    let place = simulated("as_recorded = true");
    let whole = summary(&place, &["out/flight.arrow", "--name", "checks/whole"]);
    let fast = summary(&place, &["--fast", "out/flight.arrow", "-o", "flight"]);
    assert_eq!(files(&place), ["flight_angles.txt", "flight_scan.html", "flight_scan.txt"]);
    assert!(place.path("checks/whole_ranges.txt").exists());
    assert!(!fast.contains("noise") && whole.contains("noise"));
    for (section, name) in [
        ("Times", "shots"),
        ("Rates", "pulse rate, measured"),
        ("Echoes", "shots by number of blocks"),
        ("Channel: low power", "samples per block"),
        ("Channel: low power", "first sample after the clock"),
        ("Beams", "scan angles"),
    ] {
        assert_eq!(said(&fast, section, name), said(&whole, section, name), "{section}: {name}");
    }
    assert!(said(&fast, "Echoes", "pulses in the air").starts_with("unresolved: "), "{fast}");
    let remedy = "zones are unresolved: put `resolve_mta` before `decompose`";
    assert_eq!(said(&fast, "Integrity", "note"), remedy);
    assert!(
        said(&whole, "Echoes", "ranges")
            .ends_with("from the latest emission before reception: zones are unresolved")
    );
}

#[test]
fn fast_reads_no_waveforms_of_las_and_pulsewaves() {
    let las = Las::new(300);
    let waves = PulseWaves::new(300);
    let place = TestFolder::with(&[
        ("a.las", &las.las()),
        ("a.wdp", &las.packets),
        ("b.pls", &waves.pls()),
        ("b.wvs", &waves.waves),
    ]);
    let (whole, fast) = (summary(&place, &["a.las"]), summary(&place, &["a.las", "--fast"]));
    for name in ["blocks", "samples per block", "first sample after the clock"] {
        assert_eq!(said(&fast, "Channel: low power", name), said(&whole, "Channel: low power", name));
    }
    // Without waveform bytes, all pulse attributes are still available.
    fs::write(place.path("b.wvs"), &waves.waves[..60]).unwrap();
    let fast = summary(&place, &["b.pls", "--fast"]);
    assert_eq!(
        (said(&fast, "Times", "shots"), said(&fast, "Echoes", "blocks")),
        ("300", "not read (--fast)")
    );
}

#[test]
fn scan_lists_gaps_rejects_and_missing_times() {
    let place = TestFolder::new();
    let block = |height: u16| vec![(3, -2.0, vec![2, 50, 2]), (1, 1000.0, vec![2, 2, 2, height, 2, 2])];
    let clocks = [0, 10, 20, 30, 80, 90].map(|us| us * 1_000_000);
    let mut shots: Vec<Shot> = clocks.iter().map(|&clock_ps| Shot { clock_ps, blocks: block(90) }).collect();
    shots.push(Shot { clock_ps: 100_000_000, blocks: vec![(7, 0.0, vec![1])] });
    shots.push(Shot { clock_ps: 110_000_000, blocks: block(255) });
    place.write("x.arrow", &of_shots(&shots, EmissionReference::OutgoingPulse, false));
    let out = summary(&place, &["x.arrow"]);
    assert_eq!(said(&out, "Times", "shots without a time"), "7 (100.0 %)");
    let gap = "1 of more than 2.5 shot intervals, the longest 50.000 µs (5 shot intervals) before shot 104";
    assert!(said(&out, "Times", "gaps within lines").starts_with(gap.split(" (5").next().unwrap()), "{out}");
    assert_eq!(said(&out, "Integrity", "rejected blocks"), "1: a block of an unknown channel");
    assert_eq!(said(&out, "Integrity", "rejected shots"), "1: a block of an unknown channel");
    assert_eq!(
        said(&out, "Channel: low power", "saturated"),
        "1 (2.381 %) of the samples, 1 (14.3 %) of the blocks"
    );
    // From the middle of the outgoing pulse, 1 ns before the clock, to the fourth sample.
    let range_m = (1003.0 + 1.0) * 0.5e-9 * 299_707_502.0;
    assert_eq!(
        said(&out, "Echoes", "ranges"),
        format!("{range_m:.1} to {range_m:.1} m, median {range_m:.1} m")
    );
}

#[test]
fn a_file_that_is_cut_off_is_an_error_behind_what_it_holds() {
    let waves = PulseWaves::new(300);
    let pls = waves.pls();
    let cut = &pls[..waves.offset_of(200)];
    let place = TestFolder::with(&[("b.pls", cut), ("b.wvs", &waves.waves)]);
    let Outcome { code, out, err } = scan(&place, &["b.pls", "--out", "b"]);
    let offset = waves.offset_of(200);
    let message = format!(
        "b.pls: byte {offset}: pulse 200: the header declares 300 pulses, but the file has 200; \
         the file is cut off: copy it again from its source"
    );
    assert_eq!((code, err), (Some(1), format!("error: {message}\n")));
    assert_eq!(said(&out, "Times", "shots"), "200");
    assert_eq!(said(&out, "Integrity", "read to the end"), format!("no: {message}"));
    assert!(place.text("b_scan.txt").contains(&message) && place.path("b_scan.html").exists());
}

#[test]
fn truncated_las_and_containers_are_read_up_to_the_damage() {
    let las = Las::new(300);
    let place = simulated("");
    let arrow = fs::read(place.path("out/flight.arrow")).unwrap();
    for (name, bytes) in [
        ("c.las", &las.las()[..las.offset_of(200)]),
        ("c.wdp", &las.packets),
        ("d.arrow", &arrow[..arrow.len() * 3 / 4]),
    ] {
        fs::write(place.path(name), bytes).unwrap();
    }
    for (file, shots, problem) in
        [("c.las", 200..201, "only 200 fit into the file"), ("d.arrow", 7000..7501, "the footer is missing")]
    {
        let Outcome { code, out, err } = scan(&place, &[file]);
        assert_eq!(code, Some(1), "{err}");
        assert!(err.starts_with(&format!("error: {file}: byte ")) && err.contains(problem), "{err}");
        let found: u32 = said(&out, "Times", "shots").replace(' ', "").parse().unwrap();
        assert!(shots.contains(&found), "{file}: {found}");
        assert!(said(&out, "Integrity", "read to the end").contains(problem), "{out}");
    }
    // A job refuses them at once.
    for (reader, file) in [("read_las", "c.las"), ("read_arrow", "d.arrow")] {
        let Outcome { code, err, .. } = place.read(reader, file, "[[stage]]\ntype = 'write_arrow'\n");
        assert_eq!(code, Some(1), "{err}");
    }
}

#[test]
fn what_cannot_be_scanned_is_said() {
    let place = TestFolder::with(&[("x.dat", b""), ("x.arrow", b"")]);
    let refused = |arguments: &[&str], code: i32, message: &str| {
        let Outcome { code: found, out, err } = scan(&place, arguments);
        assert_eq!((found, out.as_str()), (Some(code), ""), "{err}");
        assert!(err.starts_with(&format!("error: {message}")), "{err}");
    };
    refused(&["x.dat"], 2, "x.dat: unknown recording format; supported extensions");
    refused(&["gone.arrow"], 2, "gone.arrow: no such file or folder; check the path\n");
    refused(&["gone*.arrow"], 1, "no file matches `gone*.arrow`; check the pattern and the folder\n");
    refused(
        &["x.arrow", "--set", "read_arrow.odd_sample_shift=3"],
        2,
        "`odd_sample_shift` must be above -0.5 and below 0.5, got 3\n",
    );
    assert_eq!(files(&place), Vec::<String>::new());
}

#[test]
fn quiet_prints_nothing_and_files_are_the_same_again() {
    let place = simulated("");
    let Outcome { code, out, err } = scan(&place, &["-q", "out/flight.arrow", "--out", "flight"]);
    assert_eq!((code, out.as_str(), err.as_str()), (Some(0), "", ""));
    let (text, page) = (place.text("flight_scan.txt"), place.text("flight_scan.html"));
    summary(&place, &["out/flight.arrow", "--out", "flight"]);
    assert_eq!((place.text("flight_scan.txt"), place.text("flight_scan.html")), (text, page));
}

#[test]
fn files_are_written_only_if_asked() {
    let place = simulated("");
    let entries = || {
        let mut names: Vec<_> =
            fs::read_dir(place.path("")).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        names.sort();
        names
    };
    let before = entries();
    let out = summary(&place, &["out/flight.arrow"]);
    assert!(!out.contains("wrote "), "{out}");
    assert_eq!(entries(), before);
    let out = summary(&place, &["out/flight.arrow", "--page"]);
    assert!(out.ends_with("\nwrote flight_scan.html\n"), "{out}");
    assert_eq!(files(&place), ["flight_scan.html"]);
    // A name that ends in `/` is a folder.
    summary(&place, &["out/flight.arrow", "--out", "checks/"]);
    assert!(place.path("checks/flight_scan.txt").exists() && place.path("checks/flight_ranges.txt").exists());
}

#[test]
fn the_summary_is_printed_as_json() {
    let place = simulated("high_power = true");
    fs::copy(place.path("out/flight.arrow"), place.path("b.arrow")).unwrap();
    let Outcome { code, out, err } = scan(&place, &["out/flight.arrow", "b.arrow", "--json", "--page"]);
    assert_eq!((code, err.as_str()), (Some(0), "wrote flight_scan.html\nwrote b_scan.html\n"));
    let found: Vec<serde_json::Value> = out.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(found.len(), 2);
    assert_eq!((&found[0]["file"], &found[1]["file"]), (&"out/flight.arrow".into(), &"b.arrow".into()));
    assert_eq!((&found[0]["shots"], &found[0]["scan_lines"]), (&10_000.into(), &20.into()));
    assert_eq!((&found[0]["read_to_end"], &found[0]["error"]), (&true.into(), &serde_json::Value::Null));
    assert!((found[0]["pulse_rate_hz"].as_f64().unwrap() - 400_000.0).abs() < 100.0, "{out}");
    let channels = found[0]["channels"].as_array().unwrap();
    let low = channels.iter().find(|channel| channel["name"] == "low power").unwrap();
    assert!((low["noise_sd_dn"].as_f64().unwrap() - 0.94).abs() < 0.04, "{low}");
    let range = &found[0]["range_m"];
    assert!(
        range["min"].as_f64() < range["median"].as_f64() && range["median"].as_f64() < range["max"].as_f64()
    );
    // A truncated file: the readable part, and the error.
    let waves = PulseWaves::new(300);
    fs::write(place.path("c.pls"), &waves.pls()[..waves.offset_of(200)]).unwrap();
    fs::write(place.path("c.wvs"), &waves.waves).unwrap();
    let Outcome { code, out, .. } = scan(&place, &["c.pls", "--json"]);
    let cut: serde_json::Value = serde_json::from_str(&out).unwrap();
    assert_eq!((code, &cut["shots"], &cut["read_to_end"]), (Some(1), &200.into(), &false.into()));
    assert!(cut["error"].as_str().unwrap().contains("the file is cut off"), "{out}");
}

/// Permissions do not bind root.
#[cfg(unix)]
#[test]
fn a_read_only_folder_is_enough() {
    use std::os::unix::fs::PermissionsExt;
    let place = TestFolder::new();
    let waves = PulseWaves::new(300);
    place.write("in/b.pls", &waves.pls());
    place.write("in/b.wvs", &waves.waves);
    let folder = place.path("in");
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o555)).unwrap();
    let scanned = wavex_testkit::outcome(wavex_testkit::wavex().args(["scan", "b.pls"]).current_dir(&folder));
    let count = fs::read_dir(&folder).unwrap().count();
    fs::set_permissions(&folder, fs::Permissions::from_mode(0o755)).unwrap();
    assert_eq!((scanned.code, scanned.err.as_str(), count), (Some(0), "", 2));
}

#[test]
fn scan_describes_real_recordings() {
    let Some(data) = data() else { return };
    let place = TestFolder::new();
    let path = |name: &str| data.join(name).to_str().unwrap().to_owned();
    let out = summary(&place, &[&path("riegl_q680i_dev/riegl_q680i_dev.pls")]);
    assert_eq!((said(&out, "File", "instrument"), said(&out, "Times", "shots")), ("Q680i", "607"));
    assert_eq!(said(&out, "Rates", "pulse rate, nominal"), "400000 Hz");
    assert_eq!(said(&out, "Channel: low power", "blocks"), "608");
    let noise = said(&out, "Channel: low power", "noise").split_once(" DN").unwrap().0;
    assert!((noise.parse::<f64>().unwrap() - 0.93).abs() < 0.03, "{noise}");
    let lags = said(&out, "Channel: low power", "noise autocorrelation");
    for (got, known) in lags.split(' ').zip([0.63, 0.42, 0.22, 0.11]) {
        assert!((got.parse::<f64>().unwrap() - known).abs() < 0.03, "{lags}");
    }
    let las = summary(&place, &[&path("riegl_q680i_dev/riegl_q680i_dev.las")]);
    assert_eq!(said(&las, "Echoes", "instrument returns"), "667 in 607 shots");
    let third = summary(&place, &[&path("pulsewaves/riegl_example3.pls")]);
    assert_eq!((said(&third, "File", "instrument"), said(&third, "Times", "shots")), ("Q680", "16 486"));
    assert_eq!(said(&third, "Rates", "pulse rate, nominal"), "150000 Hz");
}

/// Summary of the made file of GEDI; `tests/python/make_hdf5.py` has the formulas of its values.
#[test]
fn beams_have_a_table() {
    let place = TestFolder::new();
    place.write("a.h5", include_bytes!("../../crates/wavex-hdf5/tests/data/gedi_product.h5"));
    let out = summary(&place, &["a.h5", "--page"]);
    // Shots have the flags `shots % 3` and `shots % 2`, and the noise 200 + shot / 8 and 2 + shot / 16.
    let words = |name: &str| said(&out, "Beams", name).split_whitespace().collect::<Vec<_>>().join(" ");
    assert_eq!(words("beam "), "power shots degraded stale noise mean, DN noise SD, DN first, s last, s");
    let first_s = 1_198_800_018.0 + 4.08e7 - 1e9;
    let times = format!("{first_s:.6} {:.6}", first_s + 11.0 * 0.00826);
    assert_eq!(words("BEAM0101"), format!("full 12 8 (66.7 %) 6 (50.0 %) 200.69 2.34 {times}"));
    assert_eq!(
        said(&out, "Channel: low power", "noise"),
        "not measured here: samples are fractions of a digitiser step; Beams has the noise recorded by the file"
    );
    assert_eq!(said(&out, "Times", "clock runs backwards"), "never");
    assert!(said(&out, "Rates", "pulse rate, measured").starts_with("121.1 Hz"), "{out}");
    assert!(!out.contains("resolve_mta"), "it does not take large footprints: {out}");
    let page = place.text("a_scan.html");
    assert!(
        page.contains("<h3>Beams of the instrument</h3>") && page.contains("<td>BEAM0101</td>"),
        "{page}"
    );
    let json: serde_json::Value = serde_json::from_str(&summary(&place, &["a.h5", "--json"])).unwrap();
    let beam = &json["beams"][0];
    assert_eq!(
        (&beam["name"], &beam["power"], &beam["shots"]),
        (&"BEAM0101".into(), &"full".into(), &12.into())
    );
    assert_eq!((&beam["degraded_shots"], &beam["stale_shots"]), (&8.into(), &6.into()));
    // LVIS has one beam, without flags, and records no spread of the noise.
    place.write("b.h5", include_bytes!("../../crates/wavex-hdf5/tests/data/lvis_432.h5"));
    let json: serde_json::Value = serde_json::from_str(&summary(&place, &["b.h5", "--json"])).unwrap();
    let beam = &json["beams"][0];
    assert_eq!((&beam["name"], &beam["shots"]), (&"LVIS".into(), &6.into()));
    assert!(beam["power"].is_null() && beam["degraded_shots"].is_null(), "{beam}");
}

/// Times of beams overlap, as beams follow each other in a reading.
#[test]
fn a_change_of_beam_is_no_step_of_the_clock() {
    let Some(data) = data() else { return };
    let place = TestFolder::new();
    let granule = data.join("gedi/gedi_l1b.h5").display().to_string();
    let out = summary(&place, &[&granule]);
    assert_eq!(said(&out, "Times", "clock runs backwards"), "never within a beam");
    let json: serde_json::Value = serde_json::from_str(&summary(&place, &[&granule, "--json"])).unwrap();
    let beams = json["beams"].as_array().unwrap();
    let ends = |key: &'static str| beams.iter().map(move |beam| beam[key].as_f64().unwrap());
    let (first_s, last_s) =
        (ends("first_shot_s").fold(f64::INFINITY, f64::min), ends("last_shot_s").fold(0.0, f64::max));
    assert_eq!((json["first_shot_s"].as_f64(), json["last_shot_s"].as_f64()), (Some(first_s), Some(last_s)));
    assert_eq!(beams.iter().map(|beam| beam["shots"].as_u64().unwrap()).sum::<u64>(), 164);
    assert_eq!(json["clock_backwards"], 0);
}

#[test]
fn one_file_is_no_name_of_several_files() {
    let pulses = PulseWaves::new(5);
    let place = TestFolder::with(&[("a.pls", &pulses.pls()), ("a.wvs", &pulses.waves)]);
    for name in ["x/b.html", "x/b.txt", "x/b.JSON"] {
        let Outcome { code, out, err } = scan(&place, &["a.pls", "--out", name]);
        let expected = format!(
            "error: --out {name}: it is the beginning of the names of several files, not one file; `--out x/b` writes \
             x/b_scan.html, x/b_scan.txt and the histograms, `--page` only the page of each recording, and `--json` \
             prints JSON\n"
        );
        assert_eq!((code, out.as_str(), err), (Some(2), "", expected));
    }
    assert!(!place.path("x").exists());
}
