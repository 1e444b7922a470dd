//! Pulses of the files that `tests/python/make_spd.py` makes; the formulas are those of its `truth`.
#![allow(clippy::unwrap_used, reason = "a test fails by it")]

use std::fs;
use std::path::{Path, PathBuf};

use wavex_hdf5::{Granule, Product, SpdPulse, SpdReader, SpdVersion, product_of};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

fn open(name: &str) -> SpdReader {
    SpdReader::open(&data(name)).unwrap()
}

fn pulse(reader: &mut SpdReader, index: u64) -> SpdPulse {
    let mut pulse = SpdPulse::default();
    reader.pulse(index, &mut pulse).unwrap();
    pulse
}

/// One-way path of light in a nanosecond, m; refractive index of SPDLib.
const M_PER_NS: f64 = 0.5 * 0.299_792_458 / 1.000_268_008;

/// Checks a pulse; angles and ranges were rounded by their storage.
fn assert_pulse(found: &SpdPulse, index: u64, range_step_m: f64) {
    let (line, place) = (index / 40, index % 40);
    assert_eq!((found.id, found.scan_line), (1000 + index, Some(line)));
    assert_eq!(found.time_ns, Some(100_000_000_000_000 + 10_000 * index));
    let origin = [500_000.0, 5_400_000.0 + 0.5 * line as f64, 600.0];
    assert!(found.origin.iter().zip(origin).all(|(one, other)| (one - other).abs() < 1e-9), "{found:?}");
    let scan_rad = (-10.0 + 20.0 * place as f64 / 39.0).to_radians();
    assert!((std::f64::consts::PI - scan_rad.abs() - found.zenith_rad).abs() < 3e-7, "{index}");
    let [east, north, up] = found.direction();
    assert!((east - scan_rad.sin() * 0.02_f64.cos()).abs() < 1e-6, "{index}: {east}");
    assert!((north - scan_rad.sin().abs() * 0.02_f64.sin()).abs() < 1e-6, "{index}: {north}");
    assert!((up + scan_rad.cos()).abs() < 1e-6, "{index}: {up}");
    let first = &found.waveforms()[0];
    let start_ns = 38.0 + (index % 17) as f64 / 4.0;
    let start_m = 500.0 / scan_rad.cos() - start_ns * M_PER_NS;
    assert!((first.range_m - start_m).abs() < range_step_m, "{index}: {} and {start_m}", first.range_m);
    assert_eq!((first.received_dn.len(), first.transmitted_dn.len(), first.gain), (64, 20, 1.0));
}

#[test]
fn both_versions_have_the_same_pulses() {
    let [mut three, mut four] = ["spd_3.spd", "spd_4.spd"].map(open);
    assert_eq!((three.header().version, four.header().version), (SpdVersion::Three, SpdVersion::Four));
    for header in [three.header(), four.header()] {
        assert_eq!(header.interval_ns, 1.0);
        assert!(header.crs_wkt.as_ref().unwrap().ends_with("AUTHORITY[\"EPSG\",\"32633\"]]"), "{header:?}");
    }
    assert_eq!((three.header().sample_bits, four.header().sample_bits), (16, 32));
    assert_eq!((three.len(), four.len()), (400, 400));
    for index in 0..400 {
        let (one, other) = (pulse(&mut three, index), pulse(&mut four, index));
        assert_pulse(&one, index, 1e-4);
        assert_pulse(&other, index, 1e-4);
        let [one, other] = [one.waveforms(), other.waveforms()];
        assert_eq!(one[0].received_dn, other[0].received_dn);
        assert_eq!(one[0].transmitted_dn, other[0].transmitted_dn);
        assert_eq!((one.len(), other.len()), (1, if index % 10 == 0 { 2 } else { 1 }));
        if let Some(second) = other.get(1) {
            let doubled: Vec<u16> = one[0].received_dn.iter().map(|sample| 2 * sample).collect();
            assert_eq!((&second.received_dn, second.gain, second.channel), (&doubled, 2.0, 0));
            assert_eq!((other[0].channel, second.transmitted_at), (1, other[0].transmitted_at));
        }
        // The peak of the ground lies where the range says.
        let ground = (38 + (index % 17) / 4) as usize;
        let peak = (0..64).max_by_key(|&k| one[0].received_dn[k]).unwrap();
        assert!(peak.abs_diff(ground) <= 1, "{index}: {peak} and {ground}");
    }
}

#[test]
fn other_forms_of_storage_have_the_same_pulses() {
    for [one, other] in [["spd_3.spd", "spd_3_latest.spd"], ["spd_4.spd", "spd_4_latest.spd"]] {
        let [mut one, mut other] = [one, other].map(open);
        assert_eq!(one.header().crs_wkt, other.header().crs_wkt);
        assert_eq!(other.len(), 12);
        // In any order.
        for index in [11, 0, 5, 10, 3] {
            assert_eq!(pulse(&mut one, index), pulse(&mut other, index), "{index}");
        }
    }
}

#[test]
fn buffers_of_the_pulse_before_are_used_again() {
    let mut reader = open("spd_4.spd");
    let mut again = SpdPulse::default();
    for index in [0, 1, 10, 11] {
        reader.pulse(index, &mut again).unwrap();
        assert_eq!(again.waveforms(), pulse(&mut reader, index).waveforms(), "{index}");
    }
}

#[test]
fn spd_is_a_product_without_beams() {
    for name in ["spd_3.spd", "spd_4.spd"] {
        assert_eq!(product_of(&data(name)).unwrap(), Product::Spd);
        let error = Granule::open(&data(name)).unwrap_err().to_string();
        assert!(error.contains("an SPD file, which has pulses but no beams; open it with"), "{error}");
    }
    let error = SpdReader::open(&data("gedi_product.h5")).err().unwrap().to_string();
    assert!(error.contains("no group DATA: this is no SPD file; write"), "{error}");
}

/// Error of a file, or of its pulses.
fn first_error(path: &Path) -> String {
    let read = || {
        let mut reader = SpdReader::open(path)?;
        let mut pulse = SpdPulse::default();
        (0..reader.len()).try_for_each(|index| reader.pulse(index, &mut pulse))
    };
    read().map_or_else(|error: wavex_formats::Error| error.to_string(), |()| "no error".to_owned())
}

#[test]
fn files_that_cannot_be_used_are_refused() {
    const EXPORT: &str = "; write the file again with SPDLib or pylidar, with origins and waveforms";
    for (name, expected) in [
        ("version", "SPD of version 1, which is not supported; convert it to version 3 or 4"),
        ("no_version", "no data set HEADER/VERSION_MAJOR_SPD; the file is damaged"),
        ("points", &format!("no data set DATA/RECEIVED: the file has no received waveforms{EXPORT}")),
        ("zenith", &format!("DATA/PULSES has no ZENITH{EXPORT}")),
        ("text", "HEADER/SPATIAL_REFERENCE: data type: text expected; rewrite the file"),
        ("4_version", "SPD of version 3, which is not supported; convert it to version 3 or 4"),
        (
            "4_no_version",
            "an SPD file without its version: neither VERSION_SPD nor HEADER/VERSION_MAJOR_SPD; ",
        ),
        ("4_waveforms", &format!("no group DATA/WAVEFORMS{EXPORT}")),
        ("4_zenith", &format!("DATA/PULSES has no ZENITH{EXPORT}")),
        ("4_rows", "DATA/PULSES/ZENITH: 5 values for 12 shots; the file is damaged"),
        ("4_gain", "DATA/PULSES/ZENITH: its gain is 0 and its offset 0; the file is damaged"),
        ("4_place", "pulse 0: 2 waveforms from row 1099511627776 of DATA/WAVEFORMS on, it has 14"),
        ("4_many", "pulse 0: 300 waveforms, at most 255"),
        ("4_fraction", "pulse 0: DATA/PULSES: not a whole number"),
    ] {
        let name = format!("refused_spd_{name}.spd");
        let found = first_error(&data(&name));
        assert!(found.contains(&name) && found.contains(expected), "{name}: {found}");
    }
}

#[test]
fn a_bad_pulse_is_an_error_of_its_own() {
    let mut reader = open("spd_bad.spd");
    let mut pulse = SpdPulse::default();
    let mut errors = Vec::new();
    for index in 0..reader.len() {
        errors.extend(reader.pulse(index, &mut pulse).map_err(|error| error.to_string()).err());
    }
    let expected = [
        "spd_bad.spd: pulse 2: DATA/RECEIVED: 64 samples from sample 1099511627776 on, it has 576",
        "spd_bad.spd: pulse 5: DATA/RECEIVED: element 323 is no whole number from 0 to 65535; write the samples",
        "spd_bad.spd: pulse 7: DATA/TRANSMITTED: 500 samples from sample 140 on, it has 180",
    ];
    assert_eq!(errors.len(), expected.len(), "{errors:?}");
    for (error, expected) in errors.iter().zip(expected) {
        assert!(error.contains(expected), "{error}");
    }
    assert!(reader.pulse(9, &mut pulse).unwrap_err().to_string().contains("element 10 is needed, it has 9"));
}

/// Replaces the first bytes that are equal to these.
fn with(name: &str, found: &[u8], offset: usize, bytes: &[u8]) -> String {
    let mut damaged = fs::read(data(name)).unwrap();
    let at = damaged.windows(found.len()).position(|window| window == found).unwrap() + offset;
    damaged[at..at + bytes.len()].copy_from_slice(bytes);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join(name);
    fs::write(&path, damaged).unwrap();
    first_error(&path)
}

#[test]
fn damaged_types_and_texts_are_reported() {
    // The class of the data type of the records and the number of members are before their size.
    let records: &[u8] = &[0x16, 30, 0, 0];
    let size = 4;
    for (name, found, offset, bytes, expected) in [
        (
            "spd_3.spd",
            records,
            0,
            &[0x11_u8][..],
            "DATA/PULSES: data type: records with named members expected",
        ),
        ("spd_3.spd", records, size, &[0, 0, 0, 0], "DATA/PULSES: data type: 0 bytes in a record"),
        ("spd_3.spd", records, size, &[0xff; 4], "DATA/PULSES: data type: 4294967295 bytes in a record"),
        ("spd_3.spd", b"PULSE_ID\0", 16, &[0xff, 0, 0, 0], "member PULSE_ID is outside of its record"),
        ("spd_3.spd", b"PULSE_ID\0", 20, &[1], "member PULSE_ID is an array"),
        ("spd_3.spd", b"GCOL", 0, b"X", "collection of objects: the signature `GCOL` is missing"),
        ("spd_3.spd", b"GCOL", 16, &[9], "collection of objects: it has no object 1"),
        ("spd_3.spd", b"GCOL", 8, &[0xff; 8], "bytes of text in 18446744073709551615"),
        ("spd_4.spd", b"VERSION_SPD\0", 0, b"X", "an SPD file without its version"),
    ] {
        let error = with(name, found, offset, bytes);
        assert!(error.contains(expected), "{name} {offset}: {error}");
    }
}
