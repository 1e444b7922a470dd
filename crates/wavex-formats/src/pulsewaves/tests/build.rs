//! Writes small file pairs, field by field.

use std::path::{Path, PathBuf};

use crate::pulsewaves::{PulseDescriptor, Reader, SamplingRecord, SegmentKind};

/// Little-endian encoder.
#[derive(Clone, Default)]
pub(super) struct Bytes(pub(super) Vec<u8>);

macro_rules! number {
    ($($name:ident)*) => {
        $(pub(super) fn $name(mut self, value: $name) -> Bytes {
            self.0.extend(value.to_le_bytes());
            self
        })*
    };
}

impl Bytes {
    number!(u8 i8 u16 i16 u32 i32 i64 f32 f64);

    pub(super) fn text(mut self, value: &str, size: usize) -> Bytes {
        let end = self.0.len() + size;
        self.0.extend(value.as_bytes());
        assert!(self.0.len() <= end);
        self.0.resize(end, 0);
        self
    }

    pub(super) fn raw(mut self, bytes: &[u8]) -> Bytes {
        self.0.extend(bytes);
        self
    }

    pub(super) fn floats(self, values: &[f64]) -> Bytes {
        values.iter().fold(self, |b, &v| b.f64(v))
    }
}

/// Encodes a pulse record.
///
/// T, offset to waves, anchor, target, first and last sample, descriptor, flags, intensity, class.
pub(super) fn pulse(t: i64, offset: i64, descriptor: u8, flags: u8) -> Vec<u8> {
    let b = Bytes::default().i64(t).i64(offset);
    let b = [100, -200, 3000, 101, -202, 2850].into_iter().fold(b, Bytes::i32);
    b.i16(-5).i16(700).u8(descriptor).u8(flags).u8(77).u8(9).0
}

/// Creates a sampling of 8-bit samples with fixed counts and no durations.
pub(super) fn sampling(kind: SegmentKind, segments: u16, samples: u32) -> SamplingRecord {
    SamplingRecord {
        kind,
        channel: 0,
        duration_bits: 0,
        duration_scale: 1.0,
        duration_offset: 0.0,
        segment_count_bits: 0,
        sample_count_bits: 0,
        segment_count: segments,
        sample_count: samples,
        bits_per_sample: 8,
        lookup_table_index: 0,
        sample_units_ns: 1.0,
        compression: 0,
        description: String::new(),
    }
}

/// Creates a descriptor of these samplings in units of 1 ns.
pub(super) fn descriptor(samplings: Vec<SamplingRecord>) -> PulseDescriptor {
    PulseDescriptor {
        optical_center_to_anchor: Some(0),
        extra_wave_bytes: 0,
        sample_units_ns: 1.0,
        scanner_index: 0,
        compression: 0,
        description: String::new(),
        samplings,
    }
}

/// Encodes a descriptor record's payload, with `more` bytes of later versions before each
/// description.
pub(super) fn encode(d: &PulseDescriptor, more: usize) -> Vec<u8> {
    let center = d.optical_center_to_anchor.map_or(0x8FFF_FFFF, |c| c as u32);
    let b = Bytes::default().u32(92 + more as u32).u32(0).u32(center).u16(d.extra_wave_bytes);
    let b = b.u16(d.samplings.len() as u16).f32(d.sample_units_ns as f32).u32(d.compression);
    let b = b.u32(d.scanner_index).raw(&vec![0xEE; more]).text(&d.description, 64);
    d.samplings
        .iter()
        .fold(b, |b, s| {
            let kind = match s.kind {
                SegmentKind::Outgoing => 1,
                SegmentKind::Returning => 2,
                SegmentKind::Other(other) => other,
            };
            let b = b.u32(104 + more as u32).u32(0).u8(kind).u8(s.channel).u8(0).u8(s.duration_bits);
            let b = b.f32(s.duration_scale as f32).f32(s.duration_offset as f32);
            let b =
                b.u8(s.segment_count_bits).u8(s.sample_count_bits).u16(s.segment_count).u32(s.sample_count);
            let b = b.u16(s.bits_per_sample).u16(s.lookup_table_index).f32(s.sample_units_ns as f32);
            b.u32(s.compression).raw(&vec![0xEE; more]).text(&s.description, 64)
        })
        .0
}

/// Builder of a file pair.
#[derive(Clone)]
pub(super) struct Pair {
    pub(super) attributes: u32,
    pub(super) pulse_size: u32,
    pub(super) more_header: usize,
    pub(super) records: Vec<(&'static str, u32, Vec<u8>)>,
    pub(super) pulses: Vec<Vec<u8>>,
    pub(super) appended: Vec<(&'static str, u32, Vec<u8>)>,
    pub(super) waves: Vec<u8>,
}

impl Pair {
    /// Creates a pair without pulses; the descriptor has index 1.
    pub(super) fn new(descriptor: &PulseDescriptor) -> Pair {
        Pair {
            attributes: 0,
            pulse_size: 48,
            more_header: 0,
            records: vec![("PulseWaves_Spec", 200_001, encode(descriptor, 0))],
            pulses: Vec::new(),
            appended: Vec::new(),
            waves: Bytes::default().text("PulseWavesWaves", 16).u32(0).raw(&[0; 40]).0,
        }
    }

    /// Creates one outgoing segment of three samples and one returning one of two: 5 bytes of waves
    /// per pulse.
    pub(super) fn plain(pulses: usize) -> Pair {
        let samplings = vec![sampling(SegmentKind::Outgoing, 1, 3), sampling(SegmentKind::Returning, 1, 2)];
        let mut pair = Pair::new(&descriptor(samplings));
        for i in 0..pulses {
            pair.add(1, &[1, 2, 3, 4, i as u8]);
        }
        pair
    }

    /// Adds a pulse with these waves.
    pub(super) fn add(&mut self, descriptor: u8, waves: &[u8]) {
        let t = 400_000_000_000 + self.pulses.len() as i64;
        self.pulses.push(pulse(t, self.waves.len() as i64, descriptor, 0));
        self.waves.extend(waves);
    }

    /// Encodes the pulse file.
    pub(super) fn pls(&self) -> Vec<u8> {
        let header_size = 352 + self.more_header;
        let mut records = Bytes::default();
        for (user, id, payload) in &self.records {
            let b = records.text(user, 16).u32(*id).u32(0).i64(payload.len() as i64);
            records = b.text("a record", 64).raw(payload);
        }
        let b = Bytes::default().text("PulseWavesPulse", 16).u32(7).u32(4711).raw(&[0xAB; 16]);
        let b = b.text("the system", 64).text("the software", 64).u16(188).u16(2015).u8(0).u8(3);
        let b = b.u16(header_size as u16).i64((header_size + records.0.len()) as i64);
        let b = b.i64(self.pulses.len() as i64).u32(0).u32(self.attributes).u32(self.pulse_size).u32(0);
        let b = b.i64(0).u32(self.records.len() as u32).i32(-1).f64(1e-6).f64(0.0);
        let b = b.i64(400_000_000_000).i64(400_000_000_999).floats(&[0.01, 0.02, 0.04, 1e5, 2e5, 100.0]);
        let b = b.floats(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]);
        assert_eq!(b.0.len(), 352);
        let mut b = b.raw(&vec![0xCD; self.more_header]).raw(&records.0);
        for pulse in &self.pulses {
            let start = b.0.len();
            b = b.raw(pulse);
            b.0.resize(start + self.pulse_size as usize, 0xEF);
        }
        for (user, id, payload) in &self.appended {
            b = b.raw(payload).text(user, 16).u32(*id).u32(0).i64(payload.len() as i64).text("", 64);
        }
        b.0
    }

    /// Writes the pair and opens it.
    pub(super) fn open(&self) -> (Reader, tempfile::TempDir) {
        let dir = tempfile::tempdir().unwrap();
        let path = write(dir.path(), &self.pls(), &self.waves);
        (Reader::open(&path).unwrap(), dir)
    }
}

/// Writes `t.pls` and `t.wvs`; returns the path of the former.
pub(super) fn write(dir: &Path, pls: &[u8], wvs: &[u8]) -> PathBuf {
    std::fs::write(dir.join("t.wvs"), wvs).unwrap();
    let path = dir.join("t.pls");
    std::fs::write(&path, pls).unwrap();
    path
}
