//! Handmade files, byte by byte.

use std::io::{Cursor, Seek, SeekFrom};

use proptest::prelude::*;

use crate::las::{PointOut, Wave};

/// Generates points whose fields are in range.
pub(crate) fn any_point() -> impl Strategy<Value = PointOut> {
    let place = (-1e6..1e6f64, -1e6..1e6f64, -1e4..1e4f64);
    let returns = (any::<u16>(), 0u8..16, 0u8..16, any::<(bool, bool, bool)>());
    let rest = (any::<u8>(), 0u8..4, -30_000i16..=30_000, any::<u8>(), any::<u16>(), -1e9..1e9f64);
    (place, returns, rest, any_wave()).prop_map(|(place, returns, rest, wave)| PointOut {
        x: place.0,
        y: place.1,
        z: place.2,
        intensity: returns.0,
        return_number: returns.1,
        number_of_returns: returns.2,
        scan_direction: returns.3.0,
        edge_of_flight_line: returns.3.1,
        withheld: returns.3.2,
        classification: rest.0,
        scanner_channel: rest.1,
        scan_angle_deg: (f64::from(rest.2) * 0.006) as f32,
        user_data: rest.3,
        point_source_id: rest.4,
        gps_time: rest.5,
        wave,
    })
}

fn any_wave() -> impl Strategy<Value = Wave> {
    let packet = (any::<u8>(), any::<u64>(), any::<u32>(), 0f32..1e6);
    (packet, [-2e-4f32..2e-4, -2e-4f32..2e-4, -2e-4f32..2e-4]).prop_map(|(packet, direction_per_ps)| Wave {
        descriptor: packet.0,
        offset: packet.1,
        size: packet.2,
        location_ps: packet.3,
        direction_per_ps,
    })
}

/// Builder of a full-waveform file: header, VLRs, points, EVLRs.
#[derive(Clone)]
pub(crate) struct Made {
    pub(crate) minor: u8,
    pub(crate) encoding: u16,
    pub(crate) format: u8,
    pub(crate) record_length: u16,
    pub(crate) vlrs: Vec<Vec<u8>>,
    pub(crate) records: Vec<Vec<u8>>,
    pub(crate) start_of_waveforms: u64,
    /// Bytes after the points.
    pub(crate) tail: Vec<u8>,
    pub(crate) n_evlrs: u32,
}

impl Made {
    /// Creates two points of `format` that share one packet of four 16-bit samples, 1 ns apart, at
    /// offset 60.
    pub(crate) fn new(minor: u8, format: u8) -> Made {
        let (length, wave_at) = match format {
            4 => (57, 28),
            _ => (59, 30),
        };
        let record = |descriptor: u8| {
            let mut record = vec![0u8; length];
            record[14] = 0x11;
            record[wave_at] = descriptor;
            record[wave_at + 1] = 60;
            record[wave_at + 9] = 8;
            record
        };
        Made {
            minor,
            encoding: 0,
            format,
            record_length: length as u16,
            vlrs: vec![vlr("LASF_Spec", 100, &descriptor(16, 0, 4, 1000))],
            records: vec![record(1), record(1)],
            start_of_waveforms: 0,
            tail: Vec::new(),
            n_evlrs: 0,
        }
    }

    fn header_size(&self) -> usize {
        match self.minor {
            0..=2 => 227,
            3 => 235,
            4 => 375,
            _ => 393,
        }
    }

    /// Returns the offset of the points.
    pub(crate) fn offset_to_points(&self) -> usize {
        self.header_size() + self.vlrs.iter().map(Vec::len).sum::<usize>()
    }

    /// Returns the offset of the tail of an uncompressed file.
    pub(crate) fn offset_to_tail(&self) -> usize {
        self.offset_to_points() + self.records.iter().map(Vec::len).sum::<usize>()
    }

    fn start(&self) -> Vec<u8> {
        let mut bytes = vec![0u8; self.header_size()];
        let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
        let n = self.records.len();
        put(0, b"LASF");
        put(6, &self.encoding.to_le_bytes());
        put(24, &[1, self.minor]);
        put(94, &(self.header_size() as u16).to_le_bytes());
        put(96, &(self.offset_to_points() as u32).to_le_bytes());
        put(100, &(self.vlrs.len() as u32).to_le_bytes());
        put(104, &[self.format]);
        put(105, &self.record_length.to_le_bytes());
        (0..3).for_each(|axis| put(131 + 8 * axis, &0.01f64.to_le_bytes()));
        if self.minor >= 3 {
            put(227, &self.start_of_waveforms.to_le_bytes());
        }
        if self.minor >= 4 {
            put(235, &(self.offset_to_tail() as u64).to_le_bytes());
            put(243, &self.n_evlrs.to_le_bytes());
            put(247, &(n as u64).to_le_bytes());
        } else {
            put(107, &(n as u32).to_le_bytes());
        }
        bytes.extend(self.vlrs.concat());
        bytes
    }

    /// Encodes the uncompressed file.
    pub(crate) fn las(&self) -> Vec<u8> {
        [self.start(), self.records.concat(), self.tail.clone()].concat()
    }

    /// Encodes the compressed file, in chunks of `chunk` points, without the tail.
    pub(crate) fn laz(&self, chunk: u32) -> Vec<u8> {
        let laz = self.compression().with_fixed_chunk_size(chunk).build();
        let mut compressor = laz::ParLasZipCompressor::new(self.before_points(&laz), laz).unwrap();
        compressor.compress_many(&self.records.concat()).unwrap();
        compressor.done().unwrap();
        compressor.into_inner().into_inner()
    }

    /// Encodes the compressed file without the tail, in two chunks, the first of `first` points.
    pub(crate) fn laz_in_two(&self, first: usize) -> Vec<u8> {
        let laz = self.compression().with_variable_chunk_size().build();
        let mut compressor = laz::ParLasZipCompressor::new(self.before_points(&laz), laz).unwrap();
        let (first, second) = self.records.split_at(first);
        compressor.compress_chunks([first.concat(), second.concat()]).unwrap();
        compressor.done().unwrap();
        compressor.into_inner().into_inner()
    }

    fn compression(&self) -> laz::LazVlrBuilder {
        let extra = self.record_length - if self.format == 4 { 57 } else { 59 };
        laz::LazVlrBuilder::default().with_point_format(self.format, extra).unwrap()
    }

    /// Encodes everything before the compressed points.
    fn before_points(&self, laz: &laz::LazVlr) -> Cursor<Vec<u8>> {
        let mut data = Vec::new();
        laz.write_to(&mut data).unwrap();
        let mut made = Made { format: self.format | 0x80, ..self.clone() };
        made.vlrs.push(vlr("laszip encoded", 22204, &data));
        let mut cursor = Cursor::new(made.start());
        cursor.seek(SeekFrom::End(0)).unwrap();
        cursor
    }
}

/// Encodes a VLR with its header.
pub(crate) fn vlr(user_id: &str, record_id: u16, data: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0u8; 54];
    bytes[2..2 + user_id.len()].copy_from_slice(user_id.as_bytes());
    bytes[18..20].copy_from_slice(&record_id.to_le_bytes());
    bytes[20..22].copy_from_slice(&(data.len() as u16).to_le_bytes());
    bytes.extend(data);
    bytes
}

/// Encodes an EVLR with its header.
pub(crate) fn evlr(user_id: &str, record_id: u16, data: &[u8]) -> Vec<u8> {
    let mut bytes = vec![0u8; 60];
    bytes[2..2 + user_id.len()].copy_from_slice(user_id.as_bytes());
    bytes[18..20].copy_from_slice(&record_id.to_le_bytes());
    bytes[20..28].copy_from_slice(&(data.len() as u64).to_le_bytes());
    bytes.extend(data);
    bytes
}

/// Encodes the data of a waveform descriptor.
pub(crate) fn descriptor(bits: u8, compression: u8, samples: u32, spacing_ps: u32) -> Vec<u8> {
    let mut bytes = vec![bits, compression];
    bytes.extend(samples.to_le_bytes());
    bytes.extend(spacing_ps.to_le_bytes());
    bytes.extend(1f64.to_le_bytes());
    bytes.extend(0f64.to_le_bytes());
    bytes
}

/// Encodes the waveform packet record with the four samples 1, 2, 3, 258.
pub(crate) fn packets() -> Vec<u8> {
    evlr("LASF_Spec", 65535, &[1, 0, 2, 0, 3, 0, 2, 1])
}
