//! Compares real files with dumps of the PulseWaves C++ library.
//!
//! Every field, segment and sample.

use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};

use flate2::read::GzDecoder;

use crate::pulsewaves::{PulseRecord, Reader, Segment, SegmentKind, WaveSegments};

/// Returns the folder of recordings, if set.
pub(super) fn data() -> Option<PathBuf> {
    let folder = std::env::var_os("WAVEX_DATA").map(PathBuf::from);
    if folder.is_none() {
        println!("skipped: WAVEX_DATA not set");
    }
    folder
}

/// Parses the numbers of a line of the dump.
fn numbers<T: std::str::FromStr>(words: &[&str]) -> Vec<T>
where
    T::Err: std::fmt::Debug,
{
    words.iter().map(|w| w.parse().unwrap()).collect()
}

fn check_pulse(words: &[&str], p: &PulseRecord) {
    let mut expected = vec![p.index as i64, p.t];
    expected.extend(p.anchor_raw.map(i64::from));
    expected.extend(p.target_raw.map(i64::from));
    expected.extend([p.first_returning_sample, p.last_returning_sample].map(i64::from));
    expected.extend([i64::from(p.descriptor), i64::from(p.edge_of_scan_line), i64::from(p.scan_direction)]);
    expected.extend([p.mirror_facet, p.intensity, p.classification].map(i64::from));
    assert_eq!(numbers::<i64>(words), expected);
}

/// Compares a segment.
///
/// The reference library stores durations as 32-bit floats. Computed that way they agree in every
/// printed digit; the 64-bit duration is within the rounding of the float.
fn check_segment(words: &[&str], segment: &Segment, samples: &[u16], pulse: &PulseRecord, reader: &Reader) {
    let kind = match segment.kind {
        SegmentKind::Outgoing => 1,
        SegmentKind::Returning => 2,
        SegmentKind::Other(other) => i64::from(other),
    };
    let sampling = &reader.descriptors()[&pulse.descriptor].samplings[usize::from(segment.sampling)];
    let head = [
        i64::from(segment.sampling),
        kind,
        i64::from(segment.channel),
        i64::from(segment.bits),
        i64::from(segment.number),
        i64::from(segment.quantized_duration),
    ];
    assert_eq!(numbers::<i64>(&words[..6]), head, "pulse {}", pulse.index);
    assert_eq!(segment.duration.is_none(), sampling.duration_bits == 0);
    assert_eq!(words[6], format!("{:.6}", float_duration(segment, reader, pulse)), "pulse {}", pulse.index);
    let duration = segment.duration.unwrap_or(0.0);
    assert!((words[6].parse::<f64>().unwrap() - duration).abs() <= duration.abs() * 2e-7 + 1e-6);
    assert_eq!((words[7], words[8]), (samples.len().to_string().as_str(), ":"));
    assert_eq!(numbers::<u16>(&words[9..]), samples, "pulse {}", pulse.index);
}

/// Returns the duration in the arithmetic of the reference library.
fn float_duration(segment: &Segment, reader: &Reader, pulse: &PulseRecord) -> f32 {
    let sampling = &reader.descriptors()[&pulse.descriptor].samplings[usize::from(segment.sampling)];
    if segment.duration.is_none() {
        return 0.0;
    }
    sampling.duration_scale as f32 * segment.quantized_duration as f32 + sampling.duration_offset as f32
}

/// Compares the position of the first sample.
///
/// It agrees to every printed digit in the arithmetic of the reference library (direction, duration
/// and their product are 32-bit floats), and within three roundings of such floats in ours.
fn check_position(words: &[&str], segment: &Segment, pulse: &PulseRecord, reader: &Reader) {
    let ours = pulse.position(segment.duration_of(0.0));
    for axis in 0..3 {
        let direction = ((pulse.target[axis] - pulse.anchor[axis]) / 1000.0) as f32;
        let product = f64::from(direction * float_duration(segment, reader, pulse));
        let theirs = pulse.anchor[axis] + product;
        assert_eq!(words[axis], format!("{theirs:.6}"), "pulse {} axis {axis}", pulse.index);
        let rounding = 3.0 * product.abs() / 2_f64.powi(24) + 1e-6;
        let printed: f64 = words[axis].parse().unwrap();
        assert!((ours[axis] - printed).abs() <= rounding, "pulse {}: {ours:?} {printed}", pulse.index);
    }
}

/// Compares a file with its dump.
///
/// Returns the number of pulses, segments and samples compared.
fn compare(folder: &Path, name: &str) -> (u64, usize, usize) {
    let mut reader = Reader::open(&folder.join(format!("{name}.pls"))).unwrap();
    reader.check_complete().unwrap();
    let dump = File::open(folder.join(format!("{name}.txt.gz"))).unwrap();
    let mut waves = WaveSegments::new();
    let mut pulse: Option<PulseRecord> = None;
    let (mut pulses, mut next, mut segments, mut samples) = (0, 0, 0, 0);
    for line in BufReader::new(GzDecoder::new(dump)).lines() {
        let line = line.unwrap();
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match (words[0], &pulse) {
            ("P", _) => {
                assert_eq!(next, waves.segments().len(), "pulse {pulses}: all segments are in the dump");
                let read = reader.pulse(pulses).unwrap();
                check_pulse(&words[1..], &read);
                reader.waves(&read, &mut waves).unwrap();
                (pulse, next, pulses) = (Some(read), 0, pulses + 1);
            }
            ("S", Some(pulse)) => {
                let segment = &waves.segments()[next];
                check_segment(&words[1..], segment, waves.samples(segment), pulse, &reader);
                (next, segments, samples) = (next + 1, segments + 1, samples + segment.sample_count());
            }
            ("X", Some(pulse)) => check_position(&words[1..], &waves.segments()[next - 1], pulse, &reader),
            _ => assert!(line.starts_with('#'), "{line}"),
        }
    }
    assert_eq!(pulses, reader.pulse_count());
    assert_eq!(next, waves.segments().len());
    (pulses, segments, samples)
}

#[test]
fn every_sample_is_as_the_peer_reads_it() {
    let Some(folder) = data().map(|d| d.join("pulsewaves")) else { return };
    let found = [
        "geolas_example1",
        "las13fwf_example1",
        "lvis_example1",
        "optech_example1",
        "riegl_example3",
        "test",
    ]
    .map(|name| compare(&folder, name));
    let expected = [
        (1000, 2000, 217_434),
        (1000, 1000, 256_000),
        (1000, 2000, 512_000),
        (998, 1996, 122_440),
        (16_486, 32_973, 2_638_080),
        (15, 42, 897),
    ];
    assert_eq!(found, expected);
}
