//! PulseWaves 0.3, built by hand: an outgoing and a returning segment per pulse.

use crate::compression::{Segment, chunks, waves};
use crate::shots::{METRES_PER_NS, SAMPLES, echo, peak, time_s, waveform};

/// Size of the header, bytes.
pub const HEADER: usize = 352;
/// Size of the waves file's header, bytes.
pub const WAVES_HEADER: usize = 60;
/// Size of a pulse, bytes.
pub const PULSE: usize = 48;
/// Size of the waves of a pulse, bytes: durations of two segments and their samples.
pub const WAVES: usize = 2 * (4 + SAMPLES);
/// Delay from the outgoing pulse to the recording of returns, ns.
const LISTEN_AFTER_NS: i32 = 4000;

/// A recording under construction.
pub struct PulseWaves {
    /// (record ID, payload) of records of `PulseWaves_Spec`.
    pub records: Vec<(u32, Vec<u8>)>,
    /// Pulse records.
    pub pulses: Vec<Vec<u8>>,
    /// The waves file.
    pub waves: Vec<u8>,
}

impl PulseWaves {
    /// A recording of this many pulses.
    pub fn new(pulses: usize) -> PulseWaves {
        let mut waves = b"PulseWavesWaves\0".to_vec();
        waves.resize(WAVES_HEADER, 0);
        for shot in 0..pulses {
            waves.extend(0i32.to_le_bytes());
            waves.extend(waveform(shot + 100_000, 20.0, 150.0));
            waves.extend(LISTEN_AFTER_NS.to_le_bytes());
            waves.extend(echo(shot));
        }
        PulseWaves {
            records: vec![(200_001, descriptor(SAMPLES as u32))],
            pulses: (0..pulses).map(pulse).collect(),
            waves,
        }
    }

    /// Replaces bytes of a pulse.
    pub fn change(mut self, pulse: usize, at: usize, bytes: &[u8]) -> PulseWaves {
        self.pulses[pulse][at..at + bytes.len()].copy_from_slice(bytes);
        self
    }

    /// Offset of a pulse.
    pub fn offset_of(&self, pulse: usize) -> usize {
        HEADER + self.records.iter().map(|(_, payload)| 96 + payload.len()).sum::<usize>() + pulse * PULSE
    }

    /// The same with compressed waves: the waves file is a `.wvz`.
    pub fn with_compressed_waves(mut self) -> PulseWaves {
        let old = std::mem::take(&mut self.waves);
        self.waves = old[..WAVES_HEADER].to_vec();
        self.waves[16] = 1;
        for pulse in &mut self.pulses {
            let from = u64::from_le_bytes(pulse[8..16].try_into().unwrap()) as usize;
            let segment = |number: usize| {
                let bytes = &old[from + number * (4 + SAMPLES)..][..4 + SAMPLES];
                Segment {
                    is_returning: number == 1,
                    bits: 8,
                    segments: None,
                    duration: Some(i32::from_le_bytes(bytes[..4].try_into().unwrap())),
                    has_count: false,
                    samples: bytes[4..].iter().map(|&byte| byte.into()).collect(),
                }
            };
            pulse[8..16].copy_from_slice(&(self.waves.len() as i64).to_le_bytes());
            self.waves.extend(waves(&[segment(0), segment(1)]));
        }
        self
    }

    /// Bytes of the compressed pulse file, with this many pulses per chunk.
    pub fn plz(&self, chunk: u32) -> Vec<u8> {
        // Compressor 1, coder 0, version 0.0, no options; one item: a pulse.
        let mut zip = vec![1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        zip.extend(chunk.to_le_bytes());
        zip.extend([1, 0, 0xe9, 3, PULSE as u8, 0, 1, 0]);
        let records = [&self.records[..], &[(5, zip)]].concat();
        let made = PulseWaves { records, pulses: self.pulses.clone(), waves: Vec::new() };
        let mut bytes = made.pls();
        bytes.truncate(made.offset_of(0));
        bytes.extend(chunks(made.offset_of(0), &made.pulses, chunk as usize, 0, false));
        bytes
    }

    /// Bytes of the pulse file.
    pub fn pls(&self) -> Vec<u8> {
        let mut bytes = vec![0; HEADER];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        put(0, b"PulseWavesPulse");
        put(40, b"made by hand");
        put(168, &[1, 0, 0xe8, 0x07, 0, 3]);
        put(174, &(HEADER as u16).to_le_bytes());
        put(176, &(self.offset_of(0) as i64).to_le_bytes());
        put(184, &(self.pulses.len() as i64).to_le_bytes());
        put(200, &(PULSE as u32).to_le_bytes());
        put(216, &(self.records.len() as u32).to_le_bytes());
        put(224, &1e-6f64.to_le_bytes());
        put(240, &ticks(0).to_le_bytes());
        put(248, &ticks(self.pulses.len()).to_le_bytes());
        (0..3).for_each(|axis| put(256 + 8 * axis, &0.001f64.to_le_bytes()));
        for (record_id, payload) in &self.records {
            let mut head = b"PulseWaves_Spec\0".to_vec();
            head.extend(record_id.to_le_bytes());
            head.extend([0; 4]);
            head.extend((payload.len() as i64).to_le_bytes());
            head.resize(96, 0);
            bytes.extend(head);
            bytes.extend(payload);
        }
        bytes.extend(self.pulses.concat());
        bytes
    }
}

/// Time of a shot, us.
fn ticks(shot: usize) -> i64 {
    (time_s(shot) * 1e6).round() as i64
}

/// A pulse at nadir from 600 m, in millimetres.
fn pulse(shot: usize) -> Vec<u8> {
    let mut bytes = ticks(shot).to_le_bytes().to_vec();
    bytes.extend(((WAVES_HEADER + shot * WAVES) as i64).to_le_bytes());
    let x = 100 * shot as i32;
    let down = (METRES_PER_NS * 1e6).round() as i32;
    [x, 0, 600_000, x, 0, 600_000 - down].iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    let first = LISTEN_AFTER_NS as i16;
    bytes.extend(first.to_le_bytes());
    bytes.extend((first + peak(shot) as i16).to_le_bytes());
    bytes.extend([1, 0, 60, 0]);
    bytes
}

/// Payload of a descriptor: an outgoing and a returning segment of 8-bit samples, 1 ns apart.
///
/// Each segment has its duration from the anchor in 32 bits.
pub fn descriptor(samples: u32) -> Vec<u8> {
    let mut bytes = 92u32.to_le_bytes().to_vec();
    bytes.extend([0; 4]);
    bytes.extend(0i32.to_le_bytes());
    bytes.extend(0u16.to_le_bytes());
    bytes.extend(2u16.to_le_bytes());
    bytes.extend(1f32.to_le_bytes());
    bytes.extend([0; 8]);
    bytes.extend([0; 64]);
    for kind in [1, 2] {
        bytes.extend(104u32.to_le_bytes());
        bytes.extend([0; 4]);
        bytes.extend([kind, 0, 0, 32]);
        bytes.extend(1f32.to_le_bytes());
        bytes.extend(0f32.to_le_bytes());
        bytes.extend([0, 0]);
        bytes.extend(1u16.to_le_bytes());
        bytes.extend(samples.to_le_bytes());
        bytes.extend(8u16.to_le_bytes());
        bytes.extend(0u16.to_le_bytes());
        bytes.extend(1f32.to_le_bytes());
        bytes.extend(0u32.to_le_bytes());
        bytes.extend([0; 64]);
    }
    bytes
}
