//! Values of the files that `tests/python/make_hdf5.py` makes, and of a real granule.
#![allow(clippy::unwrap_used, reason = "a test fails by it")]
#![allow(clippy::print_stdout, reason = "a test says that it is skipped")]

use std::env;
use std::path::{Path, PathBuf};

use flate2::Crc;
use wavex_hdf5::{Beam, BeamReader, Granule, Position, Power, Product, Shot, TimeScale};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn close(found: f64, expected: f64) {
    assert!((found - expected).abs() <= 1e-12 * expected.abs(), "{found} instead of {expected}");
}

fn assert_position(found: Position, longitude_deg: f64, latitude_deg: f64, height_m: f64) {
    close(found.longitude_rad, longitude_deg.to_radians());
    close(found.latitude_rad, latitude_deg.to_radians());
    close(found.height_m, height_m);
}

/// Received samples of a shot; formula of `sample` in the script.
fn samples(shot: usize) -> Vec<f32> {
    let sample = |k| (200 + (7 * shot + 3 * k) % 101) as f32 + (shot % 4) as f32 / 4.0;
    (0..20 + shot % 3).map(sample).collect()
}

/// Outgoing samples of a shot; formula of `outgoing` in the script.
fn pulse(shot: usize) -> Vec<f32> {
    (0..8).map(|k| (240 + (5 * shot + k) % 50) as f32).collect()
}

fn assert_gedi(beam: &mut BeamReader, index: usize) {
    let mut shot = Shot::default();
    beam.shot(index, &mut shot).unwrap();
    let i = index as f64;
    assert_eq!(shot.shot_number, 19_640_513_500_108_370 + 200_000_001 * index as u64);
    close(shot.time_s, 1_198_800_018.0 + (4.08e7 + 0.00826 * i));
    assert_eq!(shot.received_dn, samples(index));
    assert_eq!(shot.outgoing_dn, pulse(index));
    assert_eq!(f64::from(shot.noise_mean_dn), 200.0 + i / 8.0);
    assert_eq!(f64::from(shot.noise_sd_dn), 2.0 + i / 16.0);
    let (longitude_deg, latitude_deg) = (-44.25 + i / 1024.0, -13.75 - i / 1024.0);
    assert_position(shot.first_bin, longitude_deg, latitude_deg, 850.0 + i / 2.0);
    assert_position(shot.last_bin, longitude_deg, latitude_deg, 730.0 + i / 2.0);
    assert_position(shot.instrument, longitude_deg, latitude_deg, 413_000.0 + i / 2.0);
    assert!(shot.first_bin_delay_s.is_nan());
    assert_eq!(beam.columns(), ["stale_return_flag", "degrade", "geoid"]);
    assert_eq!(shot.columns, [(index % 2) as f64, (index % 3) as f64, -13.0 + i / 4.0]);
}

#[test]
fn every_storage_of_gedi_has_the_same_values() {
    for name in [
        "product",
        "contiguous",
        "deep_tree",
        "shuffle_checksum",
        "checksum",
        "big_endian",
        "user_block",
        "latest",
        "latest_plain",
        "v110",
        "extensible",
        "extensible_plain",
        "implicit",
        "cut",
    ] {
        println!("{name}");
        let granule = Granule::open(&data(&format!("gedi_{name}.h5"))).unwrap();
        assert_eq!((granule.product(), granule.time_scale()), (Product::GediL1b, TimeScale::Gps));
        let mut beam = granule.beam("BEAM0101").unwrap();
        assert_eq!((beam.name(), beam.len(), beam.is_empty()), ("BEAM0101", 12, false));
        (0..12).for_each(|index| assert_gedi(&mut beam, index));
        // Any order gives the same values.
        [11, 0, 7, 7, 2, 10, 1].into_iter().for_each(|index| assert_gedi(&mut beam, index));
    }
}

#[test]
fn beams_without_waveforms_are_listed() {
    let granule = Granule::open(&data("gedi_product.h5")).unwrap();
    let beam = |name: &str, power, shots| Beam { name: name.to_owned(), power: Some(power), shots };
    assert_eq!(granule.beams(), [beam("BEAM0000", Power::Coverage, 0), beam("BEAM0101", Power::Full, 12)]);
}

#[test]
fn a_beam_that_is_named_twice_is_listed_once() {
    let bytes = std::fs::read(data("twice.h5")).unwrap();
    let at = bytes.windows(8).position(|name| name == b"BEAM0110").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("twice.h5");
    std::fs::write(&path, [&bytes[..at], b"BEAM0101", &bytes[at + 8..]].concat()).unwrap();
    let granule = Granule::open(&path).unwrap();
    assert_eq!(granule.beams().len(), 1);
    assert_eq!(granule.beam("BEAM0101").unwrap().len() as u64, granule.beams()[0].shots);
}

#[test]
fn a_group_of_three_hundred_links_is_read() {
    let granule = Granule::open(&data("many_links.h5")).unwrap();
    assert_gedi(&mut granule.beam("BEAM0101").unwrap(), 5);
}

#[test]
fn compact_values_and_fill_values_are_read() {
    let mut beam = Granule::open(&data("gedi_compact_fill.h5")).unwrap().beam("BEAM1011").unwrap();
    let mut shot = Shot::default();
    for (index, samples) in [[-1.5; 4], [1.0, 2.0, 3.0, 4.0], [-1.5; 4]].into_iter().enumerate() {
        beam.shot(index, &mut shot).unwrap();
        assert_eq!((shot.shot_number, &shot.received_dn[..]), (index as u64, &samples[..]));
        // Seconds since 2018, whose epoch is not in the file.
        assert_eq!(shot.time_s, 1_198_800_020.5);
        assert!(shot.outgoing_dn.is_empty() && shot.noise_mean_dn.is_nan() && !shot.first_bin.is_known());
    }
}

#[test]
fn a_bad_shot_does_not_end_reading() {
    let mut beam = Granule::open(&data("gedi_bad_shots.h5")).unwrap().beam("BEAM0110").unwrap();
    let mut shot = Shot::default();
    let mut error = |index| beam.shot(index, &mut shot).unwrap_err().to_string();
    assert!(error(1).contains(
        "shot 1 of BEAM0110: BEAM0110/rxwaveform: 9 samples from sample 4 on, it has 8; the file is damaged"
    ));
    assert!(error(3).contains("shot 3 of BEAM0110: BEAM0110/rxwaveform: start index 0"));
    assert!(error(4).contains("shot 4 of BEAM0110: BEAM0110/shot_number: element 5 is needed, it has 4"));
    beam.shot(0, &mut shot).unwrap();
    assert_eq!(shot.received_dn, [0.0, 1.0, 2.0, 3.0]);
    beam.shot(2, &mut shot).unwrap();
    assert!(shot.received_dn.is_empty());
}

#[test]
fn every_layout_of_lvis_is_read() {
    for (name, count, pulse) in [
        ("432", 432, 16),
        ("528", 528, 16),
        ("1024", 1024, 16),
        ("1216", 1216, 16),
        ("without_pulse", 352, 0),
    ] {
        println!("{name}");
        let granule = Granule::open(&data(&format!("lvis_{name}.h5"))).unwrap();
        assert_eq!((granule.product(), granule.time_scale()), (Product::LvisL1b, TimeScale::UtcOfDay));
        assert_eq!(granule.beams(), [Beam { name: "LVIS".to_owned(), power: None, shots: 6 }]);
        let mut beam = granule.beam("LVIS").unwrap();
        assert_eq!(beam.columns(), ["lfid", "azimuth_deg", "incident_angle_deg", "range_m"]);
        let mut shot = Shot::default();
        for index in [0, 1, 2, 3, 4, 5, 2, 0] {
            beam.shot(index, &mut shot).unwrap();
            let i = index as f64;
            assert_eq!((shot.shot_number, shot.time_s), (500 + index as u64, 43_200.5 + i / 64.0));
            let expected = (0..count).map(|k| (10 + (11 * index + 2 * k) % 200) as f32);
            assert_eq!(shot.received_dn, expected.collect::<Vec<_>>());
            let expected = (0..pulse).map(|k| (30 + (index + k) % 90) as f32);
            assert_eq!(shot.outgoing_dn, expected.collect::<Vec<_>>());
            assert_eq!(f64::from(shot.noise_mean_dn), 14.0 + i / 4.0);
            assert!(shot.noise_sd_dn.is_nan() && !shot.instrument.is_known());
            // Longitudes of LVIS are 0 to 360 degrees.
            assert_position(shot.first_bin, 310.5 + i / 1024.0 - 360.0, 69.25 + i / 1024.0, 500.0 + i / 2.0);
            assert_position(shot.last_bin, 310.5 + i / 1024.0 - 360.0, 69.25 + i / 1024.0, 372.0 + i / 2.0);
            assert_eq!(shot.columns, [1e6 + i, 10.0 + i, 1.0 + i / 8.0, 8000.0 + i]);
        }
    }
}

/// Figures by `tests/python/check_hdf5.py`, which compares every sample with h5py.
#[test]
fn real_granule_has_the_samples_that_h5py_reads() {
    let Some(folder) = env::var_os("WAVEX_DATA") else {
        println!("skipped: WAVEX_DATA not set");
        return;
    };
    let granule = Granule::open(&Path::new(&folder).join("gedi/gedi_l1b.h5")).unwrap();
    let (mut shots, mut samples, mut digest) = (0, 0, Crc::new());
    let mut shot = Shot::default();
    for beam in granule.beams() {
        let mut beam = granule.beam(&beam.name).unwrap();
        for index in 0..beam.len() {
            beam.shot(index, &mut shot).unwrap();
            for sample in shot.received_dn.iter().chain(&shot.outgoing_dn) {
                digest.update(&sample.to_le_bytes());
                samples += 1;
            }
            shots += 1;
            // 0.15 m one way in a nanosecond, at 6 degrees from the vertical at most.
            let height_m = shot.first_bin.height_m - shot.last_bin.height_m;
            let slant_m = 0.149_896 * (shot.received_dn.len() - 1) as f64;
            assert!((0.99..1.001).contains(&(height_m / slant_m)), "{height_m} m of {slant_m} m");
        }
    }
    assert_eq!((granule.beams().len(), shots, samples, digest.sum()), (4, 164, 150_522, CRC_OF_REAL_GRANULE));
}

const CRC_OF_REAL_GRANULE: u32 = 0x71ef3665;
