//! Containers and PulseWaves files whose beams, velocities or intervals contradict physics.

use wavex_formats::container::{ContainerHeader, TimeScale, channel};
use wavex_testkit::container::{Row, container, nadir_shot};
use wavex_testkit::pulsewaves::PulseWaves;
use wavex_testkit::shots::METRES_PER_NS;
use wavex_testkit::{Outcome, TO_TABLE, TestFolder};

/// Offset of the target's height in a pulse record, and height of its anchor, mm.
const TARGET_Z: usize = 36;
const ANCHOR_MM: i32 = 600_000;

/// A container of 60 rows with this interval, ns, and group velocity, m/s.
fn of(interval_ns: f64, velocity_mps: f64) -> Vec<u8> {
    let header =
        ContainerHeader { time_scale: TimeScale::Week, ..ContainerHeader::new(interval_ns, velocity_mps) };
    let samples = vec![2, 3, 2, 2, 3, 9, 30, 60, 30, 9, 3, 2, 2, 3];
    let row = |number: u64| Row {
        shot: nadir_shot(number, number as i64 * 10_000_000),
        blocks: vec![(channel::LOW_POWER, 3000.0, samples.clone())],
    };
    container(&header, &[(0..60).map(row).collect()])
}

#[track_caller]
fn is_refused(reader: &str, file: &str, place: &TestFolder, words: &str) {
    let Outcome { code, err, .. } = place.read(reader, file, TO_TABLE);
    assert_eq!(code, Some(1), "{err}");
    assert!(err.contains(words), "{err}");
}

#[test]
fn velocities_and_intervals_of_containers_are_those_of_air_and_digitisers() {
    for (interval_ns, velocity_mps, words) in [
        (1.0, 1.0, "no usual error explains it"),
        (1.0, 2.25e8, "give light a speed of 2.250e8 m/s"),
        (1.0, 149_853_751.0, "half as long"),
        (1000.0, 2.997e8, "in picoseconds, not in nanoseconds"),
        (1e-3, 2.997e8, "in nanoseconds, not in picoseconds"),
    ] {
        let place = TestFolder::with(&[("a.arrow", &of(interval_ns, velocity_mps))]);
        is_refused("read_arrow", "a.arrow", &place, words);
    }
}

#[test]
fn beams_of_pulsewaves_are_as_long_as_light_travels() {
    // The target is 1000 ns below the anchor.
    for (factor, words) in [(2.0, "two-way path"), (1.0 / 0.3048, "in feet"), (7.0, "no usual error")] {
        let pulses = 300;
        let recording = (0..pulses).fold(PulseWaves::new(pulses), |recording, pulse| {
            let down_mm = (1e6 * METRES_PER_NS * factor).round() as i32;
            recording.change(pulse, TARGET_Z, &(ANCHOR_MM - down_mm).to_le_bytes())
        });
        let place = TestFolder::with(&[("a.pls", &recording.pls()), ("a.wvs", &recording.waves)]);
        is_refused("read_pulsewaves", "a.pls", &place, words);
    }
}
