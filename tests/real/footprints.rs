//! GEDI: ground, modes, heights and cover against NASA's products of the same shots.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use wavex_testkit::recordings::{Table, robust, run};
use wavex_testkit::view::Viewer;
use wavex_testkit::{TestFolder, data, wavex};

/// Our results and NASA's, by shot number.
struct Shots {
    ours: Vec<[f64; 9]>,
    nasa: Vec<[f64; 8]>,
}

/// Columns of both: ground, modes, RH25, RH50, RH75, RH98, cover. Ours have two more.
const OURS: [&str; 9] =
    ["z", "modes", "rh25_m", "rh50_m", "rh75_m", "rh98_m", "cover", "ground_probability", "deviation"];
const NASA: [&str; 8] = [
    "elev_lowestmode_m",
    "num_detectedmodes",
    "rh25_m",
    "rh50_m",
    "rh75_m",
    "rh98_m",
    "cover",
    "sensitivity",
];

impl Shots {
    fn of(data: &Path, keys: &str) -> Shots {
        let job = format!(
            "[job.geometry]\ncrs = 'EPSG:4979'\n[[stage]]\ntype = 'read_hdf5'\npath = 'gedi/gedi_l1b.h5'\n\
             [[stage]]\ntype = 'measure_footprints'\n{keys}[[stage]]\ntype = 'georeference'\n\
             [[stage]]\ntype = 'write_footprints'\npath = '*.csv'\n"
        );
        let out = tempfile::tempdir().unwrap();
        run("gedi.toml", &job, data, out.path(), &[]);
        let (ours, nasa) =
            (Table::read(&out.path().join("gedi_l1b.csv")), Table::read(&data.join("gedi/gedi_l2.csv")));
        // Shot numbers have more digits than a double, and differ by more than its rounding.
        let numbers = |table: &Table| table.column("shot_number").into_iter().map(f64::to_bits).enumerate();
        let rows: BTreeMap<u64, usize> = numbers(&nasa).map(|(row, number)| (number, row)).collect();
        let pairs: Vec<(usize, usize)> = numbers(&ours).map(|(row, number)| (row, rows[&number])).collect();
        assert_eq!(pairs.len(), 164, "every shot of four beams");
        let (of_ours, of_nasa) = (OURS.map(|name| ours.column(name)), NASA.map(|name| nasa.column(name)));
        Shots {
            ours: pairs.iter().map(|(number, _)| row_of(&of_ours, *number)).collect(),
            nasa: pairs.iter().map(|(_, number)| row_of(&of_nasa, *number)).collect(),
        }
    }

    fn differences(&self, column: usize) -> Vec<f64> {
        self.ours.iter().zip(&self.nasa).map(|(ours, nasa)| ours[column] - nasa[column]).collect()
    }
}

fn row_of<const COLUMNS: usize>(columns: &[Vec<f64>; COLUMNS], row: usize) -> [f64; COLUMNS] {
    std::array::from_fn(|column| columns[column][row])
}

/// The bounds of both settings; `ground_sd_m` is the largest robust SD.
fn check(shots: &Shots, ground_sd_m: f64) {
    let ground_m = shots.differences(0);
    let (centre_m, sd_m) = robust(&ground_m);
    let near = ground_m.iter().filter(|error_m| error_m.abs() < 0.3).count();
    let below = ground_m.iter().filter(|error_m| **error_m < -2.0).count();
    println!(
        "ground: median {:.3} m, robust SD {sd_m:.3} m, {near} of 164 within 0.3 m, {below} below",
        centre_m
    );
    assert!(sd_m <= ground_sd_m && near >= 161 && below <= 1);
    let ours = shots.ours.iter().map(|row| row[1]).sum::<f64>();
    let nasa = shots.nasa.iter().map(|row| row[1]).sum::<f64>();
    println!("modes: {ours} and {nasa}");
    assert!((ours / nasa - 1.0).abs() <= 0.1);
    for (column, name) in [(3, "RH50"), (4, "RH75"), (5, "RH98")] {
        let (_, sd_m) = robust(&shots.differences(column));
        println!("{name}: robust SD {sd_m:.3} m");
        assert!(sd_m <= 0.3, "{name}");
    }
}

#[test]
fn the_preset_repeats_gedis_own_results() {
    let Some(data) = data() else { return };
    let shots = Shots::of(&data, "preset = 'gedi_l2a_a1'\n");
    check(&shots, 0.06);
    let of_cover = shots.differences(6);
    let rmse = (of_cover.iter().map(|error| error * error).sum::<f64>() / of_cover.len() as f64).sqrt();
    println!("cover: root mean square {rmse:.3}");
    assert!(rmse <= 0.03);
}

#[test]
fn the_ground_of_gedi_is_found_by_default() {
    let Some(data) = data() else { return };
    let shots = Shots::of(&data, "");
    check(&shots, 0.10);
    let ordered = |column: usize| {
        let mut values: Vec<f64> = shots.ours.iter().map(|row| row[column]).collect();
        values.sort_unstable_by(f64::total_cmp);
        values
    };
    let (probabilities, deviations) = (ordered(7), ordered(8));
    let above = |limit: f64| probabilities.iter().filter(|of| **of > limit).count() as f64 / 164.0;
    println!("probability above 0.9: {:.2}, above 0.5: {:.2}", above(0.9), above(0.5));
    assert!(above(0.5) > 0.5);
    let [low, median, high] = [1, 82, 162].map(|k| deviations[k]);
    println!("deviation: 1 % {low:.2}, median {median:.2}, 99 % {high:.2}");
    assert!(median.abs() < 0.5 && low > -5.0 && high < 5.0);
}

/// All columns of the table but the product's own, as text, by name.
fn measured(reader: &str, file: &Path, keys: &str) -> BTreeMap<String, Vec<String>> {
    let place = TestFolder::new();
    let job = format!(
        "[job.geometry]\ncrs = 'EPSG:4979'\n[[stage]]\ntype = '{reader}'\npath = '{}'\n[[stage]]\n\
         type = 'measure_footprints'\n{keys}[[stage]]\ntype = 'georeference'\n\
         [[stage]]\ntype = 'write_footprints'\npath = 'a.csv'\n",
        file.display()
    );
    place.write("gedi.toml", job.as_bytes());
    let outcome = place.wavex(&["run", "gedi.toml"]);
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
    let text = fs::read_to_string(place.path("a.csv")).unwrap();
    let mut rows = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<_>>());
    let names = rows.next().unwrap();
    let mut columns: BTreeMap<String, Vec<String>> = BTreeMap::new();
    for row in rows {
        for (name, cell) in names.iter().zip(row) {
            columns.entry(name.clone()).or_default().push(cell);
        }
    }
    columns
}

/// Version 2 of the container keeps samples, beams, noise and flags: every digit of the results is the same.
#[test]
fn a_container_of_gedi_gives_the_same_results() {
    let Some(data) = data() else { return };
    let place = TestFolder::new();
    let file = data.join("gedi/gedi_l1b.h5");
    let copied = place.wavex(&["convert", &file.display().to_string(), "gedi.arrow"]);
    assert_eq!(copied.code, Some(0), "{}", copied.err);
    let container = place.path("gedi.arrow");
    let header = wavex_formats::container::ContainerReader::open(&container).unwrap().header().clone();
    assert_eq!(header.version(), "2");
    for keys in ["", "preset = 'gedi_l2a_a1'\n"] {
        let [direct, copied] = [("read_hdf5", &file), ("read_arrow", &container)]
            .map(|(reader, file)| measured(reader, file, keys));
        assert_eq!(copied["shot_number"].len(), 164);
        assert!(copied.len() > 220, "{} columns", copied.len());
        for (name, cells) in &copied {
            assert_eq!(Some(cells), direct.get(name), "{name} {keys}");
        }
    }
    let again = place.wavex(&["convert", "gedi.arrow", "again.arrow"]);
    assert_eq!(again.code, Some(0), "{}", again.err);
    let [first, second] = ["gedi.arrow", "again.arrow"].map(|name| fs::read(place.path(name)).unwrap());
    assert!(first == second, "a copy of the copy");
    // Stages for whole steps refuse the container, and name the stage that does not.
    let job = "[[stage]]\ntype = 'read_arrow'\npath = 'gedi.arrow'\n[[stage]]\ntype = 'calibrate'\n[[stage]]\n\
               type = 'decompose'\n[[stage]]\ntype = 'write_table'\n";
    place.write("small.toml", job.as_bytes());
    let refused = place.wavex(&["run", "small.toml"]);
    let expected =
        "`calibrate` needs samples in whole digitiser steps, but the recording has fractions of a step";
    assert!(refused.code == Some(1) && refused.err.contains(expected), "{}", refused.err);
    let proposed = place.wavex(&["init", "--from", "gedi.arrow"]);
    assert!(proposed.out.contains("\ntype = \"measure_footprints\"\n"), "{}", proposed.out);
    let shot = &measured("read_arrow", &container, "")["shot_number"][100];
    let texts = [file.display().to_string(), "gedi.arrow".to_owned()].map(|file| {
        let arguments = ["explain", &file, "--shot", shot, "--out", "a.svg"];
        let explained = place.wavex(&arguments);
        assert_eq!(explained.code, Some(0), "{}", explained.err);
        explained.out.split_once('\n').unwrap().1.to_owned()
    });
    assert_eq!(texts[0], texts[1]);
}

/// `wavex explain` finds a shot by number, running number and time, and says what the table of a run says.
#[test]
fn an_explained_shot_is_that_of_the_table() {
    let Some(data) = data() else { return };
    let place = TestFolder::new();
    let file = data.join("gedi/gedi_l1b.h5").display().to_string();
    let job = format!(
        "[job.geometry]\ncrs = 'EPSG:4979'\n[[stage]]\ntype = 'read_hdf5'\npath = '{file}'\n\
         [[stage]]\ntype = 'measure_footprints'\n[[stage]]\ntype = 'georeference'\n\
         [[stage]]\ntype = 'write_footprints'\npath = '*.csv'\n"
    );
    place.write("gedi.toml", job.as_bytes());
    assert_eq!(place.wavex(&["run", "gedi.toml"]).code, Some(0));
    let table = fs::read_to_string(place.path("gedi_l1b.csv")).unwrap();
    let mut lines = table.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    // A shot of the third beam.
    let (running, row) = (100, lines.nth(100).unwrap().split(',').collect::<Vec<&str>>());
    let cell = |name: &str| row[names.iter().position(|column| *column == name).unwrap()];
    let number = |name: &str| cell(name).parse::<f64>().unwrap();
    let shot = cell("shot_number");
    let explained = place.wavex(&["explain", &file, "--shot", shot, "--out", "a.svg"]);
    assert_eq!(explained.code, Some(0), "{}", explained.err);
    let text = explained.out.as_str();
    assert!(text.starts_with(&format!("shot {shot} of {file}, BEAM")), "{text}");
    for (name, value) in [
        ("ground, probability", format!("{:.2}", number("ground_probability"))),
        ("ground, height above the ellipsoid, m", format!("{:.3}", number("z"))),
        ("ground, standard deviation with the choice, m", format!("{:.3}", number("ground_total_sd_m"))),
        ("deviation of the waveform, standard deviations", format!("{:.2}", number("deviation"))),
        ("RH50, m", format!("{:.2} ± {:.2}", number("rh50_m"), number("rh50_sd_m"))),
        ("RH98, m", format!("{:.2} ± {:.2}", number("rh98_m"), number("rh98_sd_m"))),
        ("cover", format!("{:.3} ± {:.3}", number("cover"), number("cover_sd"))),
        ("sensitivity", format!("{:.3}", number("sensitivity"))),
    ] {
        let is_it = |line: &str| line.strip_prefix(name).is_some_and(|rest| rest.trim() == value);
        assert!(text.lines().any(is_it), "{name} {value}\n{text}");
    }
    let [second_m, second_sd_m] = ["second_ground_height_m", "second_ground_sd_m"].map(number);
    let second = format!(" {second_m:.2} ± {second_sd_m:.2}");
    assert_eq!(text.contains(&second), !number("second_ground_probability").is_nan(), "{second}\n{text}");
    let picture = fs::read_to_string(place.path("a.svg")).unwrap();
    assert!(picture.contains(">RH98</text>") && picture.contains("height above the ground, m"));
    let view = Viewer::start(wavex().current_dir(place.path("")).args(["view", "--no-open", &file]));
    view.ready();
    let shown = view.json(&format!("shot?input=0&shot={running}"));
    assert!(text.starts_with(shown["text"].as_str().unwrap()), "{shown}");
    assert_eq!(shown["svg"].as_str(), Some(picture.as_str()));
    let modes: f64 = number("modes");
    assert_eq!(shown["returns"].as_array().unwrap().len() as f64, modes, "its modes as points");
    let line = view.json(&format!("line?input=0&shot={running}"));
    assert!(line["highest_dn"].as_f64().unwrap() > 20.0, "above the background");
    for other in [["--shot", &running.to_string()], ["--time", cell("gps_time_s")]] {
        let again = place.wavex(&["explain", &file, other[0], other[1]]);
        assert_eq!(again.out.replace(&format!("gedi_l1b_shot_{shot}.svg"), "a.svg"), text, "{other:?}");
    }
}
