//! GEDI: ground, modes, heights and cover against NASA's products of the same shots.

use std::collections::BTreeMap;
use std::path::Path;

use wavex_testkit::data;
use wavex_testkit::recordings::{Table, robust, run};

/// Our results and NASA's, by shot number.
struct Shots {
    ours: Vec<[f64; 8]>,
    nasa: Vec<[f64; 8]>,
}

/// Columns of both: ground, modes, RH25, RH50, RH75, RH98, cover.
const OURS: [&str; 8] = ["z", "modes", "rh25_m", "rh50_m", "rh75_m", "rh98_m", "cover", "ground_sd_m"];
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
        let [of_ours, of_nasa] = [OURS.map(|name| ours.column(name)), NASA.map(|name| nasa.column(name))];
        let row = |columns: &[Vec<f64>; 8], row: usize| std::array::from_fn(|column| columns[column][row]);
        Shots {
            ours: pairs.iter().map(|(number, _)| row(&of_ours, *number)).collect(),
            nasa: pairs.iter().map(|(_, number)| row(&of_nasa, *number)).collect(),
        }
    }

    fn differences(&self, column: usize) -> Vec<f64> {
        self.ours.iter().zip(&self.nasa).map(|(ours, nasa)| ours[column] - nasa[column]).collect()
    }

    fn sum(rows: &[[f64; 8]], column: usize) -> f64 {
        rows.iter().map(|row| row[column]).sum()
    }
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
    let [ours, nasa] = [&shots.ours, &shots.nasa].map(|rows| Shots::sum(rows, 1));
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
    check(&Shots::of(&data, ""), 0.10);
}
