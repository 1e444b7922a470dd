//! LAS files whose vectors, locations or packets contradict physics or their own points.

use wavex_testkit::las::{Las, descriptor, vlr};
use wavex_testkit::shots::{METRES_PER_NS, SAMPLES, peak};
use wavex_testkit::{Outcome, TO_TABLE, TestFolder, notes};

const PULSES: usize = 400;
const VECTOR_Z: usize = 55;
const LOCATION: usize = 43;

/// A recording with another value in each point.
fn with(at: usize, value: impl Fn(usize) -> f64) -> Las {
    let change = |las: Las, pulse| las.change(pulse, at, &(value(pulse) as f32).to_le_bytes());
    (0..PULSES).fold(Las::new(PULSES), change)
}

fn place(las: &Las) -> TestFolder {
    TestFolder::with(&[("a.las", &las.las()), ("a.wdp", &las.packets)])
}

#[track_caller]
fn is_refused(las: &Las, words: &str) {
    let Outcome { code, err, .. } = place(las).read("read_las", "a.las", TO_TABLE);
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains(words), "{err}");
}

/// Eastings, northings and heights of the points that a job writes.
fn points(las: &Las, keys: &str) -> Vec<[f64; 3]> {
    let place = place(las);
    let to_las = TO_TABLE.replace("write_table'\npath = '*.csv'", "write_las'\npath = '*_out.las'");
    place.succeeds("read_las", "a.las", &format!("{keys}\n{to_las}"));
    let mut reader = las::Reader::from_path(place.path("out/a_out.las")).unwrap();
    reader
        .read_all()
        .unwrap()
        .points()
        .map(|point| point.unwrap())
        .map(|point| [point.x, point.y, point.z])
        .collect()
}

#[test]
fn vectors_of_another_unit_are_refused_with_the_factor() {
    let per_ps = METRES_PER_NS / 1000.0;
    for (of_vectors, words) in [
        (2.0 * per_ps, "two-way path"),
        (0.5 * per_ps, "half as long"),
        (1000.0 * per_ps, "per nanosecond"),
        (1.0, "unit vectors"),
        (1200.0, "full ranges"),
        (per_ps / 0.3048, "in feet"),
        (7.0 * per_ps, "no usual error"),
    ] {
        is_refused(&with(VECTOR_Z, |_| of_vectors), words);
    }
}

#[test]
fn directions_of_vectors_give_the_same_points() {
    let sound = points(&Las::new(PULSES), "");
    assert!(sound.len() >= PULSES);
    let by_direction = points(&with(VECTOR_Z, |_| 1.0), "beam_vectors = 'direction'");
    assert_eq!(sound.len(), by_direction.len());
    let apart =
        |(a, b): (&[f64; 3], &[f64; 3])| (0..3).map(|axis| (a[axis] - b[axis]).abs()).fold(0.0, f64::max);
    assert!(sound.iter().zip(&by_direction).map(apart).fold(0.0, f64::max) <= 0.011);
}

#[test]
fn locations_that_are_no_echoes_are_refused() {
    is_refused(&with(LOCATION, |_| 0.0), "all locations are 0");
    is_refused(&with(LOCATION, |_| 0.0), "copy both files again: it may be that of another recording");
    is_refused(&with(LOCATION, peak), "in nanoseconds");
    is_refused(&with(LOCATION, |pulse| 1000.0 * (SAMPLES as f64 - 1.0 - peak(pulse) + 10.0)), "other points");
    let from_last = |pulse| 1000.0 * ((SAMPLES - 1) as f64 - peak(pulse));
    // Echoes in the middle of the waveforms are as far from both ends.
    assert!(points(&with(LOCATION, from_last), "").len() >= PULSES);
    assert!(points(&with(LOCATION, |_| 0.0), "check_locations = false").len() >= PULSES);
}

#[test]
fn spacings_of_another_unit_are_refused() {
    let mut las = Las::new(PULSES);
    las.vlrs = vec![vlr("LASF_Spec", 100, &descriptor(8, SAMPLES as u32, 1))];
    is_refused(&las, "in nanoseconds, not in picoseconds");
}

#[test]
fn words_of_ten_bits_are_recognised_by_their_size() {
    let sound = Las::new(PULSES);
    let mut las = Las::new(PULSES);
    las.vlrs = vec![vlr("LASF_Spec", 100, &descriptor(10, SAMPLES as u32, 1000))];
    let (header, samples) = sound.packets.split_at(60);
    let words = samples.iter().flat_map(|&dn| u16::from(dn).to_le_bytes());
    las.packets = header.iter().copied().chain(words).collect();
    las.packets[20..28].copy_from_slice(&((2 * PULSES * SAMPLES) as u64).to_le_bytes());
    for pulse in 0..PULSES {
        las = las.change(pulse, 31, &((60 + 2 * pulse * SAMPLES) as u64).to_le_bytes());
        las = las.change(pulse, 39, &(2 * SAMPLES as u32).to_le_bytes());
    }
    assert_eq!(points(&las, ""), points(&sound, ""));
}

#[test]
fn samples_that_no_descriptor_names_are_said() {
    let mut las = Las::new(PULSES);
    las.vlrs = vec![vlr("LASF_Spec", 100, &descriptor(8, SAMPLES as u32 - 8, 1000))];
    let report = place(&las).succeeds("read_las", "a.las", TO_TABLE);
    let words = format!("{PULSES} waveform packets have more samples than their descriptor says");
    assert!(notes(&report).iter().any(|note| note.contains(&words)), "{:?}", notes(&report));
    let report = place(&Las::new(PULSES)).succeeds("read_las", "a.las", TO_TABLE);
    assert!(!notes(&report).iter().any(|note| note.contains("descriptor")));
}
