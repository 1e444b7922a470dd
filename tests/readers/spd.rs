//! SPD files that `tests/python/make_spd.py` makes: a scanner 500 m above flat ground at a height of 100 m.

use serde_json::Value;
use wavex_testkit::table::{number, rows};
use wavex_testkit::{Outcome, TO_TABLE, TestFolder, notes, rejected, root};

/// A folder with one of the made files.
fn with(name: &str) -> TestFolder {
    let place = TestFolder::new();
    let file = root().join("crates/wavex-hdf5/tests/data").join(name);
    place.write("a.spd", &std::fs::read(file).unwrap());
    place
}

#[test]
fn points_lie_at_the_true_places() {
    for name in ["spd_3.spd", "spd_4.spd"] {
        let place = with(name);
        let input = place.succeeds("read_hdf5", "a.spd", TO_TABLE);
        assert_eq!(input["stages"][0]["rejected"], serde_json::json!({}), "{name}");
        let file = place.products().into_iter().find(|file| file.ends_with(".csv")).unwrap();
        let table = rows(&place.text(&format!("out/{file}")));
        let (mut grounds, mut others, mut worst_m) = (0, 0, 0.0_f64);
        for row in &table {
            let shot = number(row, "shot") as u64;
            let scan_rad = (-10.0 + 20.0 * (shot % 40) as f64 / 39.0).to_radians();
            // The weaker echo is 12 ns before the ground.
            let [x, y, z] = ["x", "y", "z"].map(|column| number(row, column));
            let before_m = 12.0 * 0.5 * 0.299_792_458 / 1.000_268_008;
            let ground_m = 500.0 / scan_rad.cos();
            let is_ground = z < 100.9;
            let range_m = if is_ground { ground_m } else { ground_m - before_m };
            let away_m = range_m * scan_rad.sin().abs();
            let east_m = away_m * 0.02_f64.cos() * scan_rad.signum();
            let north_m = away_m * 0.02_f64.sin();
            let line = (shot / 40) as f64;
            let truth =
                [500_000.0 + east_m, 5_400_000.0 + 0.5 * line + north_m, 600.0 - range_m * scan_rad.cos()];
            let error_m =
                [x - truth[0], y - truth[1], z - truth[2]].iter().map(|part| part * part).sum::<f64>().sqrt();
            worst_m = worst_m.max(error_m);
            grounds += u32::from(is_ground);
            others += u32::from(!is_ground);
            assert!(is_ground || shot.is_multiple_of(5), "{name}: shot {shot} at {z} m");
        }
        println!("{name}: {grounds} and {others} points, at most {worst_m:.4} m from the truth");
        assert!(worst_m < 0.02, "{name}: {worst_m} m");
        assert!(grounds >= 400 && others >= 80, "{name}: {grounds} and {others} points");
    }
}

#[test]
fn pulses_that_cannot_be_used_are_counted() {
    let place = with("spd_bad.spd");
    let input = place.succeeds("read_hdf5", "a.spd", "[[stage]]\ntype = 'write_arrow'\n");
    let counts: Vec<(String, u64)> = rejected(&input).into_iter().collect();
    let expected = [
        ("shots: a block more than 0.01 s from its shot", 1),
        ("shots: a pulse without received samples", 1),
        ("shots: a shot that cannot be read", 3),
        ("shots: the direction is not finite", 1),
        ("shots: the origin is not finite", 1),
    ];
    assert_eq!(counts, expected.map(|(reason, count)| (reason.to_owned(), count)));
    let notes = notes(&input);
    assert!(notes.iter().any(|note| note.contains("a.spd: pulse 2: DATA/RECEIVED: 64 samples")), "{notes:?}");
}

#[test]
fn files_without_intervals_or_origins_are_refused() {
    for (name, message) in [
        ("interval", "`SENSOR_TEMPORAL_BIN_SPACING` of the header in nanoseconds"),
        ("origin", "a.spd: its pulses have neither origins nor ranges: both are 0; write the file again"),
        ("zenith", "a.spd: DATA/PULSES has no ZENITH; write the file again"),
    ] {
        let place = with(&format!("refused_spd_{name}.spd"));
        let Outcome { code, err, .. } = place.read("read_hdf5", "a.spd", TO_TABLE);
        assert!(code == Some(1) && err.contains(message), "{name}: {err}");
    }
}

#[test]
fn keys_of_other_products_are_refused() {
    let place = with("spd_3_latest.spd");
    for key in ["beams = ['BEAM0101']", "shots = [1]", "extent_deg = [1, 2, 3, 4]"] {
        let Outcome { code, err, .. } = place.read("read_hdf5", "a.spd", &format!("{key}\n{TO_TABLE}"));
        let name = key.split(' ').next().unwrap();
        let message = format!("`{name}` is for GEDI and LVIS, but this is an SPD file; remove the key");
        assert!(code == Some(1) && err.contains(&message), "{err}");
    }
}

#[test]
fn the_samples_of_gedi_are_refused_by_stages_for_whole_steps() {
    let place = TestFolder::new();
    place.write("a.h5", include_bytes!("../../crates/wavex-hdf5/tests/data/gedi_product.h5"));
    let Outcome { code, err, .. } = place.read("read_hdf5", "a.h5", TO_TABLE);
    let message = "needs samples in whole digitiser steps, but the recording has fractions of a step";
    assert!(code == Some(1) && err.contains(message), "{err}");
    let job = format!("[[stage]]\ntype = 'read_hdf5'\npath = 'a.h5'\n{TO_TABLE}");
    place.write("job.toml", job.as_bytes());
    let checked = place.wavex(&["check", "job.toml"]).out;
    assert!(checked.contains("warning: ") && checked.contains(message), "{checked}");
}

/// Version 4 of the file with channel 5 beside channel 1, and version 3 sorted by place.
#[test]
fn unknown_channels_are_counted_and_files_sorted_by_place_are_a_warning() {
    let place = with("spd_4_channel.spd");
    let input = place.succeeds("read_hdf5", "a.spd", "[[stage]]\ntype = 'write_arrow'\n");
    assert_eq!(rejected(&input).get("blocks: a block of an unknown channel"), Some(&2));
    let place = with("spd_3_sorted.spd");
    let input = place.succeeds("read_hdf5", "a.spd", "[[stage]]\ntype = 'write_arrow'\n");
    let notes = notes(&input);
    assert!(
        notes.iter().any(|note| note.contains("of 12 pulses are earlier than the pulse before")),
        "{notes:?}"
    );
    let place = with("spd_3_latest.spd");
    let sorted = place.succeeds("read_hdf5", "a.spd", "[[stage]]\ntype = 'write_arrow'\n");
    assert!(self::notes(&sorted).iter().all(|note| !note.contains("sorted by place")));
}

#[test]
fn commands_recognise_the_product() {
    let place = with("spd_4.spd");
    let Outcome { code, out, err } = place.wavex(&["scan", "a.spd", "--json"]);
    assert_eq!(code, Some(0), "{err}");
    let json: Value = serde_json::from_str(&out).unwrap();
    assert_eq!((json["shots"].as_u64(), json["format"].as_str()), (Some(400), Some("SPD 4")), "{out}");
    let Outcome { code, err, .. } = place.wavex(&["init", "--from", "a.spd", "job.toml"]);
    assert_eq!(code, Some(0), "{err}");
    let job = place.text("job.toml");
    assert!(job.contains("For a.spd: SPD 4") && job.contains("type = \"decompose\""), "{job}");
    assert!(job.contains("type = \"read_hdf5\"\npath = \"a.spd\"\n"), "{job}");
    let Outcome { code, out, err } = place.wavex(&["check", "job.toml"]);
    assert_eq!(code, Some(0), "{out}{err}");
    let Outcome { code, err, .. } = place.wavex(&["run", "job.toml", "--progress", "never"]);
    assert_eq!(code, Some(0), "{err}");
    let Outcome { code, out, err } = place.wavex(&["explain", "a.spd", "--shot", "20"]);
    assert!(code == Some(0) && out.contains("20"), "{out}{err}");
}
