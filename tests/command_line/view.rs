//! `wavex view`: what its server says about recordings, jobs and outputs agrees with the other commands.

use serde_json::Value;
use wavex_testkit::view::{Viewer, numbers};
use wavex_testkit::{Outcome, TestFolder, wavex};

/// A simulated recording and the outputs of its run, in `out`.
fn simulated() -> TestFolder {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 6\nshots_per_line = 300\n\
               truth = '*_truth.csv'\n\
               [[stage]]\ntype = 'write_arrow'\n\
               [[stage]]\ntype = 'calibrate'\n\
               [[stage]]\ntype = 'decompose'\ndetection_sigma = 4.5\n\
               [[stage]]\ntype = 'georeference'\n\
               [[stage]]\ntype = 'write_table'\npath = '*.csv'\n";
    assert_eq!(place.run(job), Outcome::success());
    place
}

/// A view of a place in a folder.
fn view(place: &TestFolder, arguments: &[&str]) -> Viewer {
    Viewer::start(wavex().current_dir(place.path("")).args([&["view", "--no-open"], arguments].concat()))
}

/// Rows of a table of returns as pairs of column name and text.
fn rows(table: &str) -> Vec<Vec<(&str, &str)>> {
    let mut lines = table.lines();
    let heads: Vec<&str> = lines.next().unwrap().split(',').collect();
    lines.map(|line| heads.iter().copied().zip(line.split(',')).collect()).collect()
}

fn column<'t>(row: &[(&str, &'t str)], name: &str) -> &'t str {
    row.iter().find(|(head, _)| *head == name).unwrap().1
}

#[test]
fn the_points_of_a_folder_are_those_of_its_run() {
    let place = simulated();
    let table = place.text("out/flight.csv");
    let before = place.outputs();
    let view = view(&place, &["out"]);
    let info = view.ready();
    assert_eq!((info["state"].as_str(), info["error"].as_str()), (Some("ready"), None), "{info}");
    let expected: Vec<[f64; 3]> = rows(&table)
        .iter()
        .map(|row| ["x", "y", "z"].map(|name| column(row, name).parse().unwrap()))
        .collect();
    assert_eq!(info["points"].as_u64(), Some(expected.len() as u64));
    let generation = info["generation"].as_u64().unwrap();
    let tree = view.json(&format!("tree?generation={generation}"));
    let counts: Vec<u64> =
        tree["nodes"].as_array().unwrap().iter().map(|node| node["count"].as_u64().unwrap()).collect();
    assert_eq!(counts.iter().sum::<u64>(), expected.len() as u64);
    let origin: Vec<f64> = info["origin"].as_array().unwrap().iter().map(|m| m.as_f64().unwrap()).collect();
    let count = expected.len();
    let positions = view.ask(&format!("points?generation={generation}&first=0&count={count}"));
    let mut found: Vec<[f64; 3]> = numbers(&positions.body)
        .chunks(3)
        .map(|point| [0, 1, 2].map(|i| f64::from(point[i]) + origin[i]))
        .collect();
    let mut expected = expected;
    let key = |a: &[f64; 3], b: &[f64; 3]| a[1].total_cmp(&b[1]).then(a[0].total_cmp(&b[0]));
    found.sort_by(key);
    expected.sort_by(key);
    let far = |a: &[f64; 3], b: &[f64; 3]| (0..3).map(|i| (a[i] - b[i]).abs()).fold(0.0, f64::max);
    let worst = found.iter().zip(&expected).map(|(a, b)| far(a, b)).fold(0.0, f64::max);
    assert!(worst < 0.01, "{worst} m");
    // A view writes nothing, although the job of the run does.
    assert_eq!(place.outputs(), before);
}

#[test]
fn a_shot_is_that_of_explain_and_other_keys_change_it() {
    let place = simulated();
    let view = view(&place, &["out/flight.arrow"]);
    let info = view.ready();
    let generation = info["generation"].as_u64().unwrap();
    // The weakest return goes first when the threshold rises.
    let found = view.json(&format!("find?generation={generation}&sort=amplitude_dn&limit=5"));
    let weakest = &found["found"][0];
    let shot = weakest["shot"].as_u64().unwrap();
    assert_eq!(found["total"], info["points"]);
    let point = view.json(&format!("point?generation={generation}&index={}", weakest["index"]));
    assert_eq!((&point["shot"], &point["position"]), (&weakest["shot"], &weakest["position"]));
    assert_eq!(point["values"]["amplitude_dn"], weakest["value"]);

    let shown = view.json(&format!("shot?input=0&shot={shot}"));
    let explained = place.wavex(&["--quiet", "explain", "out/flight.arrow", "--shot", &shot.to_string()]);
    assert_eq!(explained, Outcome::success());
    assert_eq!(shown["svg"].as_str().unwrap(), place.text(&format!("flight_shot_{shot}.svg")));
    let explained = place.wavex(&["explain", "out/flight.arrow", "--shot", &shot.to_string()]).out;
    assert!(explained.starts_with(shown["text"].as_str().unwrap()), "{explained}\n{}", shown["text"]);
    let returns = shown["returns"].as_array().unwrap();
    let near =
        |a: &Value, b: &Value| (0..3).all(|i| (a[i].as_f64().unwrap() - b[i].as_f64().unwrap()).abs() < 0.01);
    assert!(returns.iter().any(|found| near(&found["position"], &weakest["position"])));
    assert_eq!(shown["difference"], Value::Null);

    let amplitude_dn = weakest["value"].as_f64().unwrap();
    let changed = view.json(&format!("shot?input=0&shot={shot}&set=decompose.detection_sigma%3D60"));
    let changes = changed["difference"]["changes"].as_array().unwrap();
    let gone: Vec<f64> = changes
        .iter()
        .filter(|change| change["change"] == "gone")
        .map(|change| change["before"]["amplitude_dn"].as_f64().unwrap())
        .collect();
    assert!(gone.iter().any(|gone_dn| (gone_dn - amplitude_dn).abs() < 0.01), "{changes:?}");
    assert_eq!(changed["returns"].as_array().unwrap().len() + gone.len(), returns.len());

    let line = view.json(&format!("compare?input=0&shot={shot}&set=decompose.detection_sigma%3D60"));
    assert_eq!((line["shots"].as_u64(), line["limited"].as_bool()), (Some(300), Some(false)));
    let count = |name: &str| line[name].as_u64().unwrap();
    assert_eq!(count("before") + count("new_total") - count("gone_total"), count("after"));
    assert!(line["gone"].as_array().unwrap().iter().any(|gone| gone["shot"].as_u64() == Some(shot)));
    let corners = |name: &str| (info[name][0].as_f64().unwrap(), info[name][1].as_f64().unwrap());
    let (low, high) = (corners("min"), corners("max"));
    let all = view.json(&format!(
        "compare?generation={generation}&from={},{}&to={},{}&set=decompose.detection_sigma%3D60",
        low.0, low.1, high.0, high.1
    ));
    assert_eq!(all["before"], info["points"]);
    assert!(all["gone_total"].as_u64() >= line["gone_total"].as_u64());
    let same = view.json(&format!("compare?input=0&shot={shot}"));
    assert_eq!([&same["new_total"], &same["gone_total"], &same["moved_total"]], [0, 0, 0]);

    let refused = view.ask(&format!("shot?input=0&shot={shot}&set=decompose.detection_sigma%3D1"));
    assert_eq!(refused.json()["error"], "`detection_sigma` must be at least 2 and at most 100, got 1");
    let job = view.ask("job?set=decompose.detection_sigma%3D60");
    place.write("changed.toml", &job.body);
    assert_eq!(place.wavex(&["--quiet", "check", "changed.toml"]).code, Some(0));
    assert!(String::from_utf8_lossy(&job.body).contains("\ndetection_sigma = 60\n"));
}

#[test]
fn a_line_is_a_picture_of_its_waveforms() {
    let place = simulated();
    let view = view(&place, &["out/flight.arrow"]);
    view.ready();
    let line = view.json("line?input=0&shot=350");
    assert_eq!((line["line"].as_u64(), line["width"].as_u64()), (Some(1), Some(300)));
    assert_eq!(line["shots"][50].as_u64(), Some(350));
    assert!(line["image"].as_str().unwrap().starts_with("iVBORw0KGgo"), "PNG");
    let (first_ns, interval_ns) = (line["first_ns"].as_f64().unwrap(), line["interval_ns"].as_f64().unwrap());
    let end_ns = first_ns + interval_ns * line["height"].as_f64().unwrap();
    for found in line["returns"].as_array().unwrap() {
        let flight_ns = found["time_of_flight_ns"].as_f64().unwrap();
        assert!((first_ns..end_ns).contains(&flight_ns), "{found}");
    }
}

#[test]
fn a_profile_has_the_points_beside_its_line() {
    let place = simulated();
    let view = view(&place, &["out/flight.arrow"]);
    let info = view.ready();
    let generation = &info["generation"];
    let at = |name: &str, i: usize| info[name][i].as_f64().unwrap();
    let middle = 0.5 * (at("min", 1) + at("max", 1));
    let path = |width_m: f64| {
        let (from, to) = (at("min", 0), at("max", 0));
        format!("profile?generation={generation}&from={from},{middle}&to={to},{middle}&width_m={width_m}")
    };
    let all = view.ask(&path(1e4)).body;
    let word = |bytes: &[u8], at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!(u64::from(word(&all, 0)), info["points"].as_u64().unwrap());
    let few = view.ask(&path(1.0)).body;
    let n = word(&few, 0) as usize;
    assert!(0 < n && n < word(&all, 0) as usize && few.len() == 8 + 16 * n);
    let columns = numbers(&few[8..]);
    for i in 0..n {
        let index = columns[3 * n + i].to_bits();
        let point = view.json(&format!("point?generation={generation}&index={index}"));
        assert!((point["position"][1].as_f64().unwrap() - middle).abs() <= 0.51);
        assert!((point["position"][2].as_f64().unwrap() - f64::from(columns[n + i])).abs() < 0.01);
        if i == 20 {
            break;
        }
    }
}

/// The ground is a line of the profile, and a terrain model next to the points is a layer, with its SD.
#[test]
fn the_ground_is_shown_with_points() {
    let place = TestFolder::new();
    let points = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 100\nshots_per_line = 200\nflying_height_m = 150.0\n\
                  [[stage]]\ntype = 'calibrate'\nwaveforms = 2000\n\
                  [[stage]]\ntype = 'decompose'\nmode = 'fastest'\n[[stage]]\ntype = 'georeference'\n\
                  [[stage]]\ntype = 'write_las'\npath = '*.laz'\n";
    assert_eq!(place.run(points), Outcome::success());
    let classify =
        ["--quiet", "classify", "out/flight.laz", "-o", "ground/flight.laz", "--dem", "ground/dtm.tif"];
    let classified = place.wavex(&classify);
    assert_eq!(classified.code, Some(0), "{}", classified.err);
    place.write("ground/other.tif", b"II*\0no raster");
    let ground_of = |file: &str| {
        let view = view(&place, &[file]);
        let info = view.ready();
        let at = |name: &str, i: usize| info[name][i].as_f64().unwrap();
        let (from, to) = ([at("min", 0), at("min", 1)], [at("max", 0), at("max", 1)]);
        let line = format!(
            "generation={}&from={},{}&to={},{}&width_m=4",
            info["generation"], from[0], from[1], to[0], to[1]
        );
        let ground = view.json(&format!("ground?{line}"));
        let body = view.ask(&format!("profile?{line}")).body;
        let n = u32::from_le_bytes(body[..4].try_into().unwrap()) as usize;
        let heights = numbers(&body[8..])[n..2 * n].to_vec();
        let pictures: Vec<u16> = info["layers"]
            .as_array()
            .unwrap()
            .iter()
            .map(|layer| {
                let name = layer["name"].as_str().unwrap().replace(' ', "%20");
                view.ask(&format!("layer?name={name}")).status
            })
            .collect();
        (info, ground, heights, pictures)
    };
    let (info, ground, heights, pictures) = ground_of("ground/flight.laz");
    let parts = ground["ground"].as_array().unwrap();
    let line: Vec<(f64, f64)> = parts
        .iter()
        .flat_map(|part| part.as_array().unwrap())
        .map(|place| (place[0].as_f64().unwrap(), place[1].as_f64().unwrap()))
        .collect();
    assert!(line.len() > 20 && line.windows(2).all(|pair| pair[0].0 < pair[1].0), "{parts:?}");
    let lowest = heights.iter().copied().fold(f32::INFINITY, f32::min);
    assert!(line.iter().all(|(_, height)| *height >= f64::from(lowest)), "{lowest} {line:?}");
    let labels: Vec<&str> =
        info["layers"].as_array().unwrap().iter().map(|layer| layer["label"].as_str().unwrap()).collect();
    assert_eq!(labels, ["dtm: height, m", "dtm: SD of the height, m"]);
    assert_eq!((pictures, info["warnings"].as_array().unwrap().len()), (vec![200, 200], 0), "{info}");
    let sd = &info["layers"][1]["range"];
    assert!(sd[0].as_f64().unwrap() > 0.0 && sd[1].as_f64().unwrap() < 20.0, "{sd}");
    let (info, ground, _, _) = ground_of("out/flight.laz");
    assert_eq!((&ground["ground"], &info["layers"]), (&serde_json::json!([]), &serde_json::json!([])));
}

#[test]
fn a_job_with_two_receivers_and_open_zones_is_viewed_shot_by_shot() {
    let place = TestFolder::new();
    let chain = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 40\nshots_per_line = 100\n\
                 high_power = true\nas_recorded = true\nflying_height_m = 1500.0\npulse_rate_hz = 150000.0\n\
                 [[stage]]\ntype = 'fuse_channels'\n\
                 [[stage]]\ntype = 'resolve_mta'\n\
                 [[stage]]\ntype = 'calibrate'\n\
                 [[stage]]\ntype = 'decompose'\n\
                 [[stage]]\ntype = 'filter_outliers'\n\
                 [[stage]]\ntype = 'georeference'\n";
    place.write("job.toml", chain.as_bytes());
    let checked = place.wavex(&["check", "job.toml"]);
    if checked.code != Some(0) {
        panic!("{}", checked.err);
    }
    let view = view(&place, &["job.toml"]);
    let info = view.ready();
    assert_eq!(info["error"], Value::Null, "{info}");
    let generation = &info["generation"];
    let found =
        view.json(&format!("find?generation={generation}&sort=amplitude_dn&descending=true&limit=20"));
    for entry in found["found"].as_array().unwrap().iter().take(5) {
        let shown = view.json(&format!("shot?input=0&shot={}", entry["shot"]));
        let returns = shown["returns"].as_array().unwrap();
        let point = view.json(&format!("point?generation={generation}&index={}", entry["index"]));
        let same = returns.iter().find(|found| found["return_number"] == point["return_number"]).unwrap();
        for i in 0..3 {
            let distance_m = same["position"][i].as_f64().unwrap() - point["position"][i].as_f64().unwrap();
            assert!(distance_m.abs() < 0.02, "{point} {same}");
        }
    }
}

#[test]
fn a_shot_has_the_corrections_that_the_run_has_learnt() {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 12\nshots_per_line = 600\ndetector = 'riegl'\n\
               [[stage]]\ntype = 'calibrate'\nwaveforms = 2000\n\
               [[stage]]\ntype = 'decompose'\n\
               [[stage]]\ntype = 'correct'\nrange_walk = 'auto'\nsave_model = 'model.json'\n\
               [[stage]]\ntype = 'georeference'\n";
    place.write("job.toml", job.as_bytes());
    let view = view(&place, &["job.toml"]);
    let info = view.ready();
    assert_eq!(info["error"], Value::Null, "{info}");
    let generation = &info["generation"];
    let find = format!("find?generation={generation}&sort=width_ratio&where=number_of_returns%3D1&limit=20");
    for entry in view.json(&find)["found"].as_array().unwrap() {
        let point = view.json(&format!("point?generation={generation}&index={}", entry["index"]));
        let shown = view.json(&format!("shot?input=0&shot={}", entry["shot"]));
        for (name, value) in
            [("width_ratio", &point["values"]["width_ratio"]), ("range_sd_m", &point["values"]["range_sd_m"])]
        {
            let difference = shown["returns"][0][name].as_f64().unwrap() - value.as_f64().unwrap();
            assert!(difference.abs() < 1e-5, "{name}: {point} {shown}");
        }
    }
    // A view writes nothing.
    let files: Vec<_> =
        std::fs::read_dir(place.path("")).unwrap().map(|file| file.unwrap().file_name()).collect();
    assert_eq!(files, ["job.toml"]);
}

#[test]
fn shots_are_at_their_points_in_degrees_and_as_geocentric_coordinates() {
    let place = TestFolder::new();
    let simulate = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 4\nshots_per_line = 200\nsbet = '*.sbet'\n\
                    [[stage]]\ntype = 'write_arrow'\n";
    assert_eq!(place.run(simulate), Outcome::success());
    for crs in ["geodetic", "ecef"] {
        let job = format!(
            "[job.geometry]\ntrajectory = 'out/flight.sbet'\ncrs = '{crs}'\n\
             [[stage]]\ntype = 'read_arrow'\npath = 'out/flight.arrow'\n\
             [[stage]]\ntype = 'calibrate'\nwaveforms = 500\n\
             [[stage]]\ntype = 'decompose'\n\
             [[stage]]\ntype = 'georeference'\n"
        );
        place.write("job.toml", job.as_bytes());
        let view = view(&place, &["job.toml"]);
        let info = view.ready();
        assert_eq!((info["error"].as_str(), info["unit"].as_str()), (None, Some("m")), "{info}");
        let generation = &info["generation"];
        let found = view.json(&format!("find?generation={generation}&sort=amplitude_dn&limit=5"));
        for entry in found["found"].as_array().unwrap() {
            let shown = view.json(&format!("shot?input=0&shot={}", entry["shot"]));
            let returns = shown["returns"].as_array().unwrap();
            let same = returns.iter().find(|found| found["return_number"] == entry["return_number"]).unwrap();
            for i in 0..3 {
                let at = |place: &Value| place["position"][i].as_f64().unwrap();
                assert!((at(same) - at(entry)).abs() < 0.1, "{crs}: {entry} {same}");
            }
        }
    }
}

#[test]
fn a_shot_without_echoes_says_so_and_leads_to_the_next() {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nlines = 3\nshots_per_line = 200\ndropout_rate = 0.3\n\
               [[stage]]\ntype = 'calibrate'\nwaveforms = 400\n\
               [[stage]]\ntype = 'decompose'\n\
               [[stage]]\ntype = 'georeference'\n";
    place.write("job.toml", job.as_bytes());
    let view = view(&place, &["job.toml"]);
    view.ready();
    let shots: Vec<Value> = (0..600).map(|shot| view.json(&format!("shot?input=0&shot={shot}"))).collect();
    let without: Vec<usize> = (0..600).filter(|&shot| shots[shot]["svg"].is_null()).collect();
    assert!(without.len() > 100);
    let first = &shots[without[0]];
    assert!(first["problem"].as_str().unwrap().contains("no recorded echoes"), "{first}");
    assert_eq!((first["returns"].as_array().map(Vec::len), first["text"].as_str()), (Some(0), Some("")));
    // From the first shot to the last and back, across lines and empty shots.
    for shot in 0..600_u64 {
        let shown = &shots[shot as usize];
        assert_eq!(shown["next"].as_u64(), (shot < 599).then_some(shot + 1));
        assert_eq!(shown["previous"].as_u64(), shot.checked_sub(1));
    }
}

#[test]
fn the_job_of_a_folder_or_with_other_keys_is_whole() {
    let place = simulated();
    let folder = view(&place, &["out"]);
    folder.ready();
    // A report selects one of several runs in a folder.
    let report = view(&place, &["out/job_report.json"]);
    assert_eq!(report.ready()["points"], folder.ready()["points"]);
    let text = |view: &Viewer| String::from_utf8(view.ask("job?set=decompose.mode%3Dslow").body).unwrap();
    let job = text(&folder);
    assert!(
        job.contains("mode = \"slow\"") && job.contains("write_table") && !job.contains("wavex run"),
        "{job}"
    );
    place.write("elsewhere/again.toml", job.as_bytes());
    assert_eq!(place.wavex(&["check", "elsewhere/again.toml"]).code, Some(0), "{job}");
    place.write(
        "job.toml",
        b"[[stage]]\ntype = 'read_arrow'\npath = 'out/flight.arrow'\n[[stage]]\ntype = 'calibrate'\n\
          [[stage]]\ntype = 'decompose' # by this\nid = 'fit'\n[[stage]]\ntype = 'georeference'\n",
    );
    let with = view(&place, &["job.toml", "--set", "calibrate.waveforms=700"]);
    let info = with.ready();
    let keys: Vec<&str> =
        info["keys"].as_array().unwrap().iter().map(|key| key["key"].as_str().unwrap()).collect();
    assert!(keys.contains(&"decompose.mode"), "{keys:?}");
    let job = text(&with);
    assert!(job.contains("\nwaveforms = 700\n") && job.contains("\nmode = \"slow\"\n"), "{job}");
    assert!(
        job.contains("wavex run job.toml --set calibrate.waveforms=700 --set decompose.mode=slow\n"),
        "{job}"
    );
}

#[test]
fn a_job_without_points_says_what_it_lacks() {
    let place = TestFolder::new();
    place.write("job.toml", b"[[stage]]\ntype = 'simulate'\nlines = 2\n[[stage]]\ntype = 'calibrate'\nwaveforms = 500\n[[stage]]\ntype = 'decompose'\n");
    let view = view(&place, &["job.toml"]);
    let info = view.ready();
    assert_eq!(info["error"], "job.toml: the job has no stage `georeference`; add one");
}

#[test]
fn what_cannot_be_viewed_is_refused_with_a_remedy() {
    let place = TestFolder::with(&[("empty/x.txt", b""), ("a.xyz", b"1 2 3")]);
    let refused = |arguments: &[&str]| {
        let Outcome { code, out, err } = place.wavex(&[&["view", "--no-open"], arguments].concat());
        assert_eq!((code == Some(0), out.as_str()), (false, ""));
        err
    };
    let no_report = "error: empty: no report of a run in this folder; give the report or the job of a run\n";
    assert_eq!(refused(&["empty"]), no_report);
    assert!(refused(&["a.xyz"]).starts_with("error: a.xyz"), "{}", refused(&["a.xyz"]));
    assert!(refused(&["missing.las"]).contains("no such file"));
    place.write("job.toml", b"[[stage]]\ntype = 'read_las'\npath = '-'\n");
    let said = refused(&["job.toml"]);
    assert!(said.contains("standard input cannot be read twice; give a file"), "{said}");
    place.write("empty/run_report.json", b"{\"inputs\": []}");
    let said = refused(&["empty"]);
    assert!(said.contains("the report does not name the folder of the inputs"), "{said}");
    place.write("simulated.toml", b"[[stage]]\ntype = 'simulate'\nlines = 2\n");
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port().to_string();
    let said = refused(&["simulated.toml", "--port", &port]);
    assert!(said.contains("choose another --port"), "{said}");
}

#[test]
fn a_recording_that_cannot_be_read_to_its_end_says_so_on_the_page() {
    let place = simulated();
    let whole = std::fs::read(place.path("out/flight.arrow")).unwrap();
    place.write("cut.arrow", &whole[..whole.len() / 2]);
    let chain = "[[stage]]\ntype = 'read_arrow'\npath = 'cut.arrow'\n[[stage]]\ntype = 'calibrate'\n\
                 [[stage]]\ntype = 'decompose'\n[[stage]]\ntype = 'georeference'\n";
    place.write("job.toml", chain.as_bytes());
    let view = view(&place, &["job.toml"]);
    let info = view.ready();
    assert_eq!(info["state"], "failed");
    assert!(info["error"].as_str().unwrap().contains("cut.arrow"), "{info}");
}

#[test]
fn the_folder_of_a_survey_has_its_strips_and_rasters() {
    let place = TestFolder::new();
    for (seed, strip) in [(1, "a"), (2, "b")] {
        let job = format!(
            "[[stage]]\ntype = 'simulate'\nstem = '{strip}'\nlines = 100\nshots_per_line = 200\nflying_height_m = 150.0\nseed = {seed}\n\
             scene_seed = 7\n[[stage]]\ntype = 'write_arrow'\npath = 'lines/*.arrow'\n"
        );
        assert_eq!(place.run(&job), Outcome::success());
    }
    place.write(
        "survey.toml",
        b"[job]\noutput_dir = 'survey'\nsurvey_page = true\n\
          [[stage]]\ntype = 'read_arrow'\npath = 'out/lines/*.arrow'\n\
          [[stage]]\ntype = 'calibrate'\nwaveforms = 2000\n\
          [[stage]]\ntype = 'decompose'\n\
          [[stage]]\ntype = 'georeference'\n\
          [[stage]]\ntype = 'write_las'\npath = '*.las'\n",
    );
    let run = place.wavex(&["--quiet", "run", "survey.toml"]);
    assert_eq!(run.code, Some(0), "{}", run.err);
    let view = view(&place, &["survey"]);
    let info = view.ready();
    assert_eq!(info["error"], Value::Null, "{info}");
    let names: Vec<&str> =
        info["inputs"].as_array().unwrap().iter().map(|input| input["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["a", "b"]);
    let input = info["attributes"].as_array().unwrap().iter().find(|one| one["name"] == "input").unwrap();
    assert_eq!(input["values"], serde_json::json!([0.0, 1.0]));
    let layers = info["layers"].as_array().unwrap();
    assert_eq!(layers.iter().filter(|layer| layer["diverging"] == true).count(), 1, "{layers:?}");
    for layer in layers {
        let picture = view.ask(&format!("layer?name={}", layer["name"].as_str().unwrap()));
        assert_eq!((picture.status, &picture.body[1..4]), (200, b"PNG".as_slice()));
        // The raster covers the points.
        assert!(layer["min"][0].as_f64() < info["max"][0].as_f64());
        assert!(layer["max"][1].as_f64() > info["min"][1].as_f64());
    }
    for input in [0, 1] {
        let found = view.json(&format!(
            "find?generation={}&sort=amplitude_dn&where=input%3D{input}&limit=3",
            info["generation"]
        ));
        let first = &found["found"][0];
        assert_eq!(first["input"].as_u64(), Some(input));
        let shot = view.json(&format!("shot?input={input}&shot={}", first["shot"]));
        assert!(!shot["returns"].as_array().unwrap().is_empty());
    }
}

/// A folder `out` with points of a run, as LAZ and as COPC, and the number of points.
fn points_of_a_run() -> (TestFolder, u64) {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 6\nshots_per_line = 300\n\
               [[stage]]\ntype = 'calibrate'\n\
               [[stage]]\ntype = 'decompose'\n\
               [[stage]]\ntype = 'georeference'\n\
               [[stage]]\ntype = 'write_las'\npath = '*.laz'\n\
               [[stage]]\ntype = 'write_table'\npath = '*.csv'\n";
    assert_eq!(place.run(job), Outcome::success());
    assert_eq!(place.wavex(&["--quiet", "copc", "out/flight.laz"]), Outcome::success());
    let points = place.text("out/flight.csv").lines().count() as u64 - 1;
    (place, points)
}

#[test]
fn points_without_waveforms_are_shown_with_their_attributes() {
    let (place, points) = points_of_a_run();
    for file in ["out/flight.laz", "out/flight.copc.laz"] {
        let view = view(&place, &[file]);
        let info = view.ready();
        assert_eq!(
            (&info["state"], &info["kind"], &info["error"]),
            (&"ready".into(), &"points".into(), &Value::Null)
        );
        assert_eq!(info["points"].as_u64(), Some(points), "{info}");
        let reason = info["without_waveforms"].as_str().unwrap();
        assert_eq!(
            reason,
            format!(
                "{file}: points without waveforms; `wavex view out` shows the run in this folder with its waveforms"
            )
        );
        assert!(info["crs"].as_str().unwrap().contains("UTM zone 33N"), "{info}");
        assert_eq!(info["keys"], serde_json::json!([]));
        // Each point has the values that the run has written.
        let table = place.text("out/flight.csv");
        let generation = &info["generation"];
        let found =
            view.json(&format!("find?generation={generation}&sort=amplitude_dn&descending=true&limit=5"));
        for entry in found["found"].as_array().unwrap() {
            let point = view.json(&format!("point?generation={generation}&index={}", entry["index"]));
            let number = |name: &str| point["values"][name].as_f64().unwrap();
            let rows = rows(&table);
            let row = rows.iter().find(|row| {
                ["x", "y", "z"].iter().enumerate().all(|(i, name)| {
                    (column(row, name).parse::<f64>().unwrap() - point["position"][i].as_f64().unwrap()).abs()
                        < 0.01
                })
            });
            let row = row.unwrap_or_else(|| panic!("{point}"));
            for (name, tolerance) in [
                ("amplitude_dn", 0.006),
                ("deviation_ratio", 0.06),
                ("width_ratio", 0.0006),
                ("return_number", 0.0),
            ] {
                let written: f64 = column(row, name).parse().unwrap();
                assert!((number(name) - written).abs() <= tolerance, "{name}: {point} {written}");
            }
            let written: f64 = column(row, "range_sd_m").parse().unwrap();
            assert!((number("range_sd_m") / written - 1.0).abs() < 0.005, "{point} {written}");
        }
        let refused = view.ask("shot?input=0&shot=0");
        assert_eq!(refused.status, 400);
    }
}

#[test]
fn points_name_what_has_their_waveforms() {
    let (place, _) = points_of_a_run();
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port().to_string();
    // The port is in use: the command ends after the message.
    let said = |file: &str| place.wavex(&["view", "--no-open", "--port", &port, file]).err;
    let of_run = said("out/flight.laz");
    assert!(of_run.contains("`wavex view out` shows the run in this folder with its waveforms"), "{of_run}");
    place.write("alone.laz", &std::fs::read(place.path("out/flight.laz")).unwrap());
    let alone = said("alone.laz");
    let instead = "alone.laz: points without waveforms; view the folder of the run that wrote them, its job or its recording";
    assert!(alone.contains(instead), "{alone}");
}

#[test]
fn the_folder_of_a_failed_run_says_so() {
    let job = "[job]\noutput_dir = 'out'\n[[stage]]\ntype = 'read_las'\npath = 'none.las'\n[[stage]]\ntype = 'write_arrow'\n";
    let place = TestFolder::with(&[("job.toml", job.as_bytes())]);
    assert_eq!(place.wavex(&["run", "job.toml"]).code, Some(1));
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port().to_string();
    let said = place.wavex(&["view", "--no-open", "--port", &port, "out"]).err;
    assert!(
        said.contains("job_report.json: the last run of this job failed, and its keys are used here"),
        "{said}"
    );
}

#[test]
fn footprints_that_cuts_leave_out_do_not_blame_a_threshold() {
    let granule =
        std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("crates/wavex-hdf5/tests/data/gedi_product.h5");
    let job = format!(
        "[[stage]]\ntype = 'read_hdf5'\npath = '{}'\nextent_deg = [16, -25, 17, -24]\n[[stage]]\n\
         type = 'measure_footprints'\n[[stage]]\ntype = 'georeference'\n",
        granule.display()
    );
    let place = TestFolder::with(&[("job.toml", job.as_bytes())]);
    let info = view(&place, &["job.toml"]).ready();
    assert_eq!(info["error"], "no points: see the warnings");
}

#[test]
fn a_file_without_points_says_so_on_the_page() {
    let place = TestFolder::new();
    let job = "[[stage]]\ntype = 'simulate'\nstem = 'flight'\nlines = 2\nshots_per_line = 300\n\
               [[stage]]\ntype = 'calibrate'\nwaveforms = 500\n\
               [[stage]]\ntype = 'decompose'\n\
               [[stage]]\ntype = 'georeference'\n\
               [[stage]]\ntype = 'write_las'\npath = '*.las'\n";
    assert_eq!(place.run(job), Outcome::success());
    let mut empty = std::fs::read(place.path("out/flight.las")).unwrap();
    let first_point = u32::from_le_bytes(empty[96..100].try_into().unwrap());
    empty.truncate(first_point as usize);
    // Numbers of points, in all and by return, in the fields of LAS 1.0 and 1.4.
    empty[107..131].fill(0);
    empty[247..375].fill(0);
    place.write("empty.las", &empty);
    let view = view(&place, &["empty.las"]);
    let info = view.ready();
    assert_eq!(
        (info["state"].as_str(), info["error"].as_str()),
        (Some("failed"), Some("the file has no points"))
    );
}
