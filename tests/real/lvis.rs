//! LVIS in PulseWaves: ground and modes against returns of `decompose`, and without outgoing pulses.

use std::collections::BTreeMap;
use std::path::Path;

use wavex_formats::container::{Compression, ContainerReader, ContainerWriter, LineBuilder, channel};
use wavex_testkit::recordings::{Table, robust, run};
use wavex_testkit::{TestFolder, data};

/// Footprints of a recording, as a table.
fn footprints(reader: &str, recording: &Path) -> (Table, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let path = recording.display();
    let job = format!(
        "[[stage]]\ntype = '{reader}'\npath = '{path}'\n[[stage]]\ntype = 'measure_footprints'\n\
         [[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_footprints'\npath = 'a.csv'\n"
    );
    let report = run("lvis.toml", &job, folder.path(), folder.path(), &[]);
    let warnings = report.stages.iter().flat_map(|stage| stage.notes.clone()).collect();
    (Table::read(&folder.path().join("a.csv")), warnings)
}

/// Heights of the returns of `decompose` that are the only ones of their shot, by shot.
fn single_returns(recording: &Path) -> BTreeMap<u64, f64> {
    let folder = tempfile::tempdir().unwrap();
    let job = format!(
        "[[stage]]\ntype = 'read_pulsewaves'\npath = '{}'\n[[stage]]\ntype = 'calibrate'\n[[stage]]\n\
         type = 'decompose'\n[[stage]]\ntype = 'georeference'\n[[stage]]\ntype = 'write_table'\npath = 'a.csv'\n",
        recording.display()
    );
    run("lvis.toml", &job, folder.path(), folder.path(), &[]);
    let table = Table::read(&folder.path().join("a.csv"));
    let [shots, heights_m, counts] = ["shot", "z", "number_of_returns"].map(|name| table.column(name));
    let rows = shots.iter().zip(heights_m).zip(counts).filter(|(_, count)| *count == 1.0);
    rows.map(|((shot, height_m), _)| (*shot as u64, height_m)).collect()
}

/// The smoothed mode lies behind the peak of the pulse, because the pulse has a tail.
#[test]
fn the_ground_of_ice_is_the_single_return() {
    let Some(data) = data() else { return };
    let recording = data.join("pulsewaves/lvis_example1.pls");
    let (table, _) = footprints("read_pulsewaves", &recording);
    assert_eq!(table.len(), 1000, "every shot");
    assert!(table.column("modes").iter().all(|modes| *modes == 1.0));
    let single_m = single_returns(&recording);
    assert!(single_m.len() > 900, "{}", single_m.len());
    let rows = table.column("shot").into_iter().zip(table.column("z"));
    let differences_m: Vec<f64> =
        rows.filter_map(|(shot, z_m)| Some(z_m - single_m.get(&(shot as u64))?)).collect();
    let (centre_m, sd_m) = robust(&differences_m);
    let near = differences_m.iter().filter(|error_m| error_m.abs() < 0.1).count() as f64;
    println!("ground - single return: median {centre_m:.3} m, robust SD {sd_m:.4} m");
    assert!(centre_m.abs() < 0.05 && sd_m < 0.012 && near / differences_m.len() as f64 > 0.99);
    // Half of the energy lies below the mode of such a pulse; all of it within 3 m.
    let (middle_m, spread_m) = robust(&table.column("rh50_m"));
    assert!((-0.25..0.0).contains(&middle_m) && spread_m < 0.05, "{middle_m} {spread_m}");
    assert!(robust(&table.column("rh98_m")).0 < 2.0);
}

/// A copy of a container without the blocks of the outgoing pulse.
fn without_outgoing(from: &Path, to: &Path) {
    let mut reader = ContainerReader::open(from).unwrap();
    let header = reader.header().clone();
    let file = std::fs::File::create(to).unwrap();
    let mut writer = ContainerWriter::file(file, to, &header, Compression::Lz4).unwrap();
    while let Some(line) = reader.next_line().unwrap() {
        let mut copy = LineBuilder::new();
        for row in 0..line.rows() {
            copy.shot(&line.shot(row));
            let echoes = line.blocks(row).filter(|block| block.channel != channel::REFERENCE);
            echoes.for_each(|block| copy.block(&block));
        }
        writer.write(copy).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn the_narrowest_echoes_replace_missing_outgoing_pulses() {
    let Some(data) = data() else { return };
    // In the forest no echo is as narrow as the outgoing pulse of 6.5 ns.
    for (name, largest_m) in [("lvis_example1", 0.02), ("lvis_example2_first", 0.15)] {
        let recording = data.join(format!("pulsewaves/{name}.pls"));
        let folder = tempfile::tempdir().unwrap();
        let [whole, echoes] = ["whole.arrow", "echoes.arrow"].map(|file| folder.path().join(file));
        let job = format!(
            "[[stage]]\ntype = 'read_pulsewaves'\npath = '{}'\n[[stage]]\ntype = 'write_arrow'\npath = 'whole.arrow'\n",
            recording.display()
        );
        run("copy.toml", &job, folder.path(), folder.path(), &[]);
        without_outgoing(&whole, &echoes);
        let (direct, _) = footprints("read_pulsewaves", &recording);
        let (copied, warnings) = footprints("read_arrow", &whole);
        assert!(!warnings.iter().any(|text| text.contains("narrowest")), "{warnings:?}");
        let [expected_m, copied_m] = [&direct, &copied].map(|table| table.column("z"));
        assert_eq!(expected_m, copied_m, "the container has the same shots");
        let (table, warnings) = footprints("read_arrow", &echoes);
        let is_it =
            |text: &String| text.contains("no outgoing pulses are recorded: the response is the mean of the");
        assert!(warnings.iter().any(is_it), "{warnings:?}");
        let differences_m: Vec<f64> =
            table.column("z").iter().zip(&expected_m).map(|(z_m, expected_m)| z_m - expected_m).collect();
        let (centre_m, sd_m) = robust(&differences_m);
        println!(
            "{name}: ground without outgoing pulses: {centre_m:.3} m, robust SD {sd_m:.4} m; {warnings:?}"
        );
        assert!(centre_m.abs() < largest_m && sd_m < largest_m, "{name}");
    }
}

/// The proposed job runs, and `wavex explain` measures a shot as the job does.
#[test]
fn a_shot_is_explained_by_the_proposed_job() {
    let Some(data) = data() else { return };
    let place = TestFolder::new();
    let file = data.join("pulsewaves/lvis_example2_first.pls").display().to_string();
    let proposed = place.wavex(&["init", "--from", &file, "lvis.toml"]);
    assert_eq!(proposed.code, Some(0), "{}", proposed.err);
    let outcome = place.wavex(&["run", "lvis.toml", "--set", "write_footprints.path=*.csv"]);
    assert_eq!(outcome.code, Some(0), "{}", outcome.err);
    let text = std::fs::read_to_string(place.path("out/lvis_example2_first.csv")).unwrap();
    let mut rows = text.lines().map(|line| line.split(',').collect::<Vec<&str>>());
    let names = rows.next().unwrap();
    let row = rows.nth(400).unwrap();
    let number = |name: &str| -> f64 {
        row[names.iter().position(|column| *column == name).unwrap()].parse().unwrap()
    };
    let shot = number("shot_number").to_string();
    let explained = place.wavex(&["explain", &file, "--job", "lvis.toml", "--shot", &shot, "--out", "a.svg"]);
    assert_eq!(explained.code, Some(0), "{}", explained.err);
    let rh98 = format!("{:.2} ± {:.2}", number("rh98_m"), number("rh98_sd_m"));
    assert!(explained.out.contains(&rh98), "{rh98}: {}", explained.out);
    let missing = place.wavex(&["explain", &file, "--job", "lvis.toml", "--shot", "5000"]);
    let expected = "no shot 5000; the 500 shots are numbered 0 to 499";
    assert!(missing.code == Some(2) && missing.err.contains(expected), "{}", missing.err);
}
