//! Waves of a pulse.
//!
//! Every kind of sampling, handmade and as round trips.

use proptest::prelude::*;

use super::build::{Bytes, Pair, descriptor, sampling};
use crate::pulsewaves::{Reader, SamplingRecord, SegmentKind, WaveSegments};

/// Returns the segments of pulse `index` as (sampling, number, quantised duration, duration,
/// samples).
type Flat = Vec<(u16, u16, i32, Option<f64>, Vec<u16>)>;

fn flat(reader: &mut Reader, index: u64) -> Flat {
    let mut waves = WaveSegments::new();
    let pulse = reader.pulse(index).unwrap();
    reader.waves(&pulse, &mut waves).unwrap();
    let one = |s: &crate::pulsewaves::Segment| {
        (s.sampling, s.number, s.quantized_duration, s.duration, waves.samples(s).to_vec())
    };
    waves.segments().iter().map(one).collect()
}

#[test]
fn fixed_samplings_hold_nothing_but_samples() {
    let (mut reader, _dir) = Pair::plain(2).open();
    let expected = |last| vec![(0, 0, 0, None, vec![1, 2, 3]), (1, 0, 0, None, vec![4, last])];
    assert_eq!(flat(&mut reader, 1), expected(1));
    assert_eq!(flat(&mut reader, 0), expected(0));
}

#[test]
fn waves_longer_than_the_first_read_are_complete() {
    let samples: Vec<u8> = (0..50_000_u32).map(|k| (k % 251) as u8).collect();
    let mut pair = Pair::new(&descriptor(vec![sampling(SegmentKind::Returning, 1, samples.len() as u32)]));
    (0..2).for_each(|_| pair.add(1, &samples));
    let (mut reader, _dir) = pair.open();
    let expected = vec![(0, 0, 0, None, samples.iter().map(|&dn| u16::from(dn)).collect())];
    assert_eq!(flat(&mut reader, 0), expected);
    assert_eq!(flat(&mut reader, 1), expected);
}

#[test]
fn counts_and_signed_durations_of_every_width_are_read() {
    let mut samplings = Vec::new();
    for (duration, segments, samples, bits) in [(8, 0, 8, 8), (16, 8, 16, 16), (32, 16, 0, 8)] {
        let mut s =
            sampling(SegmentKind::Returning, if segments == 0 { 2 } else { 0 }, u32::from(samples == 0));
        (s.duration_bits, s.duration_scale, s.duration_offset) = (duration, 0.5, 1000.0);
        (s.segment_count_bits, s.sample_count_bits, s.bits_per_sample) = (segments, samples, bits);
        s.channel = duration;
        samplings.push(s);
    }
    let mut d = descriptor(samplings);
    d.extra_wave_bytes = 3;
    let b = Bytes::default().raw(&[0xAA; 3]);
    let b = b.i8(-2).u8(2).raw(&[250, 3]).i8(127).u8(0);
    let b = b.u8(2).i16(-30_000).u16(1).u16(65_535).i16(4).u16(2).u16(1).u16(256);
    let b = b.u16(1).i32(-2_000_000_000).u8(9);
    let mut pair = Pair::new(&d);
    pair.add(1, &b.0);
    let (mut reader, _dir) = pair.open();
    let expected = vec![
        (0, 0, -2, Some(999.0), vec![250, 3]),
        (0, 1, 127, Some(1063.5), vec![]),
        (1, 0, -30_000, Some(-14_000.0), vec![65_535]),
        (1, 1, 4, Some(1002.0), vec![1, 256]),
        (2, 0, -2_000_000_000, Some(-999_999_000.0), vec![9]),
    ];
    assert_eq!(flat(&mut reader, 0), expected);
}

#[test]
fn a_segment_carries_what_its_sampling_says() {
    let mut s = sampling(SegmentKind::Returning, 1, 2);
    (s.channel, s.bits_per_sample, s.sample_units_ns) = (3, 16, 2.0);
    (s.duration_bits, s.duration_offset) = (8, 10.0);
    let mut pair = Pair::new(&descriptor(vec![s]));
    pair.add(1, &Bytes::default().i8(1).u16(300).u16(7).0);
    let (mut reader, _dir) = pair.open();
    let (pulse, mut waves) = (reader.pulse(0).unwrap(), WaveSegments::new());
    reader.waves(&pulse, &mut waves).unwrap();
    let segment = &waves.segments()[0];
    assert_eq!((segment.kind, segment.channel, segment.bits), (SegmentKind::Returning, 3, 16));
    assert_eq!((segment.sample_count(), segment.sample_units_ns, segment.units_per_sample), (2, 2.0, 2.0));
    assert_eq!(segment.duration_of(1.5), 11.0 + 3.0);
    assert!(WaveSegments::new().samples(segment).is_empty());
}

#[test]
fn an_outgoing_pulse_of_bytes_declared_as_words_is_read_again() {
    let mut samplings = [SegmentKind::Outgoing, SegmentKind::Returning].map(|kind| sampling(kind, 1, 4));
    samplings.iter_mut().for_each(|s| s.bits_per_sample = 16);
    let mut pair = Pair::new(&descriptor(samplings.to_vec()));
    // Four bytes, four words, and the next four bytes in the source of the writer.
    let b = Bytes::default().raw(&[1, 9, 200, 2]).u16(3).u16(300).u16(258).u16(4).raw(&[7; 4]);
    pair.add(1, &b.0);
    let (mut reader, _dir) = pair.open();
    let (pulse, mut waves) = (reader.pulse(0).unwrap(), WaveSegments::new());
    reader.waves(&pulse, &mut waves).unwrap();
    assert!(waves.read_outgoing_as_bytes());
    let read: Vec<_> = waves.segments().iter().map(|s| (s.bits, waves.samples(s).to_vec())).collect();
    assert_eq!(read, [(8, vec![1, 9, 200, 2]), (16, vec![3, 300, 258, 4])]);
    assert!(!waves.read_outgoing_as_bytes());
    assert!(!WaveSegments::new().read_outgoing_as_bytes());
}

#[test]
fn warm_waves_keep_their_memory() {
    let (mut reader, _dir) = Pair::plain(50).open();
    let mut waves = WaveSegments::new();
    let pulse = reader.pulse(0).unwrap();
    reader.waves(&pulse, &mut waves).unwrap();
    let first = waves.samples(&waves.segments()[0]).as_ptr();
    for index in 1..50 {
        let pulse = reader.pulse(index).unwrap();
        reader.waves(&pulse, &mut waves).unwrap();
        assert_eq!(waves.samples(&waves.segments()[0]).as_ptr(), first);
    }
}

/// Segments of one pulse in one sampling, as (quantised duration, samples).
type Run = Vec<(i32, Vec<u16>)>;

/// Generates a sampling and the segments of each pulse.
fn any_sampling() -> impl Strategy<Value = (SamplingRecord, Vec<Run>)> {
    let bits = || prop::sample::select(vec![0_u8, 8, 16]);
    let layout =
        (prop::sample::select(vec![0_u8, 8, 16, 32]), bits(), bits(), any::<bool>(), 1..4_u16, 1..6_u32);
    layout.prop_flat_map(|(duration, segment_bits, sample_bits, wide, segment_count, sample_count)| {
        let mut s = sampling(SegmentKind::Returning, segment_count, sample_count);
        (s.duration_bits, s.segment_count_bits, s.sample_count_bits) = (duration, segment_bits, sample_bits);
        (s.bits_per_sample, s.duration_scale, s.duration_offset) = (if wide { 16 } else { 8 }, 0.25, -7.0);
        let most = if wide { u16::MAX } else { 255 };
        let limit = if duration == 0 { 0 } else { i32::MAX >> (32 - u32::from(duration)) };
        let samples = if sample_bits == 0 { sample_count as usize..=sample_count as usize } else { 0..=300 };
        let least = if sample_bits == 8 { 255 } else { 300 };
        let samples = *samples.start()..=(*samples.end()).min(least);
        let segments = match segment_bits {
            0 => usize::from(segment_count)..=usize::from(segment_count),
            _ => 0..=3,
        };
        let segment = (-limit..=limit, prop::collection::vec(0..=most, samples));
        let pulse = prop::collection::vec(segment, segments);
        (Just(s), prop::collection::vec(pulse, 3))
    })
}

/// Returns the low `bits` bits of a number.
fn low(value: i64, bits: u8) -> Vec<u8> {
    value.to_le_bytes()[..usize::from(bits / 8)].to_vec()
}

fn encode(sampling: &SamplingRecord, segments: &[(i32, Vec<u16>)]) -> Vec<u8> {
    let mut bytes = low(segments.len() as i64, sampling.segment_count_bits);
    for (duration, samples) in segments {
        bytes.extend(low(i64::from(*duration), sampling.duration_bits));
        bytes.extend(low(samples.len() as i64, sampling.sample_count_bits));
        bytes.extend(samples.iter().flat_map(|&s| low(i64::from(s), sampling.bits_per_sample as u8)));
    }
    bytes
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_layout_comes_back(samplings in prop::collection::vec(any_sampling(), 1..4)) {
        let d = descriptor(samplings.iter().map(|(s, _)| s.clone()).collect());
        let mut pair = Pair::new(&d);
        for pulse in 0..3 {
            let waves: Vec<u8> = samplings.iter().flat_map(|(s, p)| encode(s, &p[pulse])).collect();
            pair.add(1, &waves);
        }
        let (mut reader, _dir) = pair.open();
        for pulse in (0..3).rev() {
            let mut expected: Flat = Vec::new();
            for (number, (s, pulses)) in samplings.iter().enumerate() {
                for (segment, (q, samples)) in pulses[pulse].iter().enumerate() {
                    let duration = (s.duration_bits > 0).then(|| 0.25 * f64::from(*q) - 7.0);
                    expected.push((number as u16, segment as u16, *q, duration, samples.clone()));
                }
            }
            prop_assert_eq!(flat(&mut reader, pulse as u64), expected);
        }
    }
}
