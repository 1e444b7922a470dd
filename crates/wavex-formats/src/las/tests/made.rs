//! Handmade files, byte by byte.

use std::io::{Cursor, Seek, SeekFrom};
use std::path::Path;

use proptest::prelude::*;

use crate::las::header::{LasHeader, header_bytes};
use crate::las::vlr::Vlr;
use crate::las::{PacketDescriptor, PointOut, Wave};

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

    /// Returns the offset of the points.
    pub(crate) fn offset_to_points(&self) -> usize {
        usize::from(header_bytes(self.minor)) + self.vlrs.iter().map(Vec::len).sum::<usize>()
    }

    /// Returns the offset of the tail of an uncompressed file.
    pub(crate) fn offset_to_tail(&self) -> usize {
        self.offset_to_points() + self.records.iter().map(Vec::len).sum::<usize>()
    }

    /// Encodes header and VLRs.
    fn start(&self) -> Vec<u8> {
        let header = LasHeader {
            global_encoding: self.encoding,
            version: (1, self.minor),
            header_size: header_bytes(self.minor),
            offset_to_points: self.offset_to_points() as u32,
            n_vlrs: self.vlrs.len() as u32,
            point_format: self.format,
            record_length: self.record_length,
            n_points: self.records.len() as u64,
            scale: [0.01; 3],
            start_of_waveforms: self.start_of_waveforms,
            start_of_evlrs: self.offset_to_tail() as u64,
            n_evlrs: self.n_evlrs,
            ..LasHeader::default()
        };
        [header.write(), self.vlrs.concat()].concat()
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
    Vlr::new(user_id, record_id, "", data.to_vec()).write(Path::new("made.las")).unwrap()
}

/// Encodes an EVLR with its header.
pub(crate) fn evlr(user_id: &str, record_id: u16, data: &[u8]) -> Vec<u8> {
    Vlr::new(user_id, record_id, "", data.to_vec()).write_extended()
}

/// Encodes the data of a waveform descriptor.
pub(crate) fn descriptor(bits: u8, compression: u8, samples: u32, spacing_ps: u32) -> Vec<u8> {
    PacketDescriptor { bits, compression, samples, spacing_ps, gain: 1.0, offset: 0.0 }.encode().to_vec()
}

/// Encodes a compressed packet with the coder of the crate `laz`.
pub(crate) fn packet(bits: u32, samples: &[u16]) -> Vec<u8> {
    let mut encoder = laz::encoders::ArithmeticEncoder::new(Vec::new());
    let mut numbers = laz::compressors::IntegerCompressor::new(bits, 1, 8, 0);
    numbers.init();
    for pair in samples.windows(2) {
        numbers.compress(&mut encoder, pair[0].into(), pair[1].into(), 0).unwrap();
    }
    encoder.done().unwrap();
    [&samples[0].to_le_bytes()[..bits as usize / 8], &encoder.into_inner()].concat()
}

/// Encodes the waveform packet record with the four samples 1, 2, 3, 258.
pub(crate) fn packets() -> Vec<u8> {
    evlr("LASF_Spec", 65535, &[1, 0, 2, 0, 3, 0, 2, 1])
}
