//! Full-waveform LAS 1.4, point format 9, built by hand.

use std::io::{Cursor, Seek, SeekFrom};

use crate::compression::packet;
use crate::shots::{METRES_PER_NS, SAMPLES, echo_with, peak, time_s};

/// Size of the header, bytes.
pub const HEADER: usize = 375;
/// Size of a point, bytes.
pub const POINT: usize = 59;

/// A recording under construction.
pub struct Las {
    /// VLRs between the header and the points.
    pub vlrs: Vec<Vec<u8>>,
    /// Point records.
    pub points: Vec<Vec<u8>>,
    /// The waveform packets with their header.
    pub packets: Vec<u8>,
}

impl Las {
    /// This many pulses with one return and one waveform each.
    pub fn new(pulses: usize) -> Las {
        Las::with_odd_sample_shift(pulses, 0.0)
    }

    /// The same, with odd samples taken late by this fraction of a sample.
    pub fn with_odd_sample_shift(pulses: usize, odd_sample_shift: f64) -> Las {
        let mut packets = record_header("LASF_Spec", 65535, (pulses * SAMPLES) as u64, true);
        packets.extend((0..pulses).flat_map(|pulse| echo_with(pulse, odd_sample_shift)));
        let vlrs = vec![vlr("LASF_Spec", 100, &descriptor(8, SAMPLES as u32, 1000))];
        Las { vlrs, points: (0..pulses).map(point).collect(), packets }
    }

    /// The same with a coordinate reference system.
    pub fn with_crs(mut self, wkt: &str) -> Las {
        self.vlrs.push(vlr("LASF_Projection", 2112, wkt.as_bytes()));
        self
    }

    /// Replaces bytes of a point.
    pub fn change(mut self, point: usize, at: usize, bytes: &[u8]) -> Las {
        self.points[point][at..at + bytes.len()].copy_from_slice(bytes);
        self
    }

    /// The same with this northing of all points, cm.
    pub fn at_northing(self, y_cm: i32) -> Las {
        (0..self.points.len()).fold(self, |las, point| las.change(point, 4, &y_cm.to_le_bytes()))
    }

    /// The same without return locations in the waveforms: points are at the start of their
    /// waveforms.
    pub fn without_locations(mut self) -> Las {
        self.points.iter_mut().for_each(|point| point[43..47].fill(0));
        self
    }

    /// The same with compressed waveform packets, for a `.wdz` file with the descriptors of LAStools.
    pub fn with_compressed_packets(mut self) -> Las {
        self.vlrs[0][54 + 1] = 1;
        let old = std::mem::take(&mut self.packets);
        self.packets = old[..60].to_vec();
        self.packets.extend(b"LAStools waveform 210117\x01\0\x01\0\x01\x08");
        self.packets.extend((SAMPLES as u16).to_le_bytes());
        for point in &mut self.points {
            let from = u64::from_le_bytes(point[31..39].try_into().unwrap()) as usize;
            let samples: Vec<u16> = old[from..from + SAMPLES].iter().map(|&byte| byte.into()).collect();
            let packet = packet(8, &samples);
            point[31..39].copy_from_slice(&(self.packets.len() as u64).to_le_bytes());
            point[39..43].copy_from_slice(&(packet.len() as u32).to_le_bytes());
            self.packets.extend(packet);
        }
        let length = self.packets.len() as u64 - 60;
        self.packets[20..28].copy_from_slice(&length.to_le_bytes());
        self
    }

    /// Offset of a point.
    pub fn offset_of(&self, point: usize) -> usize {
        HEADER + self.vlrs.iter().map(Vec::len).sum::<usize>() + point * POINT
    }

    /// The LAS file of a recording with packets in a separate file.
    pub fn las(&self) -> Vec<u8> {
        let mut bytes = header(&self.vlrs, self.points.len(), 9);
        bytes.extend(self.points.concat());
        bytes
    }

    /// The same, compressed.
    pub fn laz(&self) -> Vec<u8> {
        let laz = laz::LazVlrBuilder::default().with_point_format(9, 0).unwrap().build();
        let mut data = Vec::new();
        laz.write_to(&mut data).unwrap();
        let vlrs = [&self.vlrs[..], &[vlr("laszip encoded", 22204, &data)]].concat();
        let mut start = Cursor::new(header(&vlrs, self.points.len(), 9 | 0x80));
        start.seek(SeekFrom::End(0)).unwrap();
        let mut compressor = laz::LasZipCompressor::new(start, laz).unwrap();
        compressor.compress_many(&self.points.concat()).unwrap();
        compressor.done().unwrap();
        compressor.into_inner().into_inner()
    }
}

/// Point of a pulse: at nadir, at the position of its echo.
fn point(pulse: usize) -> Vec<u8> {
    let mut bytes = vec![0; POINT];
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    // Steps of 1 cm.
    put(0, &(10 * pulse as i32).to_le_bytes());
    put(12, &60u16.to_le_bytes());
    put(14, &[0x11]);
    put(22, &time_s(pulse).to_le_bytes());
    put(30, &[1]);
    put(31, &(60 + (pulse * SAMPLES) as u64).to_le_bytes());
    put(39, &(SAMPLES as u32).to_le_bytes());
    put(43, &(peak(pulse) as f32 * 1000.0).to_le_bytes());
    put(55, &(METRES_PER_NS as f32 / 1000.0).to_le_bytes());
    bytes
}

fn header(vlrs: &[Vec<u8>], points: usize, format: u8) -> Vec<u8> {
    let mut bytes = vec![0; HEADER];
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    let offset_to_points = HEADER + vlrs.iter().map(Vec::len).sum::<usize>();
    put(0, b"LASF");
    // The packets are in a separate file.
    put(6, &4u16.to_le_bytes());
    put(24, &[1, 4]);
    put(26, b"made by hand");
    put(90, &[1, 0, 0xe8, 0x07]);
    put(94, &(HEADER as u16).to_le_bytes());
    put(96, &(offset_to_points as u32).to_le_bytes());
    put(100, &(vlrs.len() as u32).to_le_bytes());
    put(104, &[format]);
    put(105, &(POINT as u16).to_le_bytes());
    (0..3).for_each(|axis| put(131 + 8 * axis, &0.01f64.to_le_bytes()));
    put(247, &(points as u64).to_le_bytes());
    bytes.extend(vlrs.concat());
    bytes
}

/// A variable length record.
pub fn vlr(user_id: &str, record_id: u16, data: &[u8]) -> Vec<u8> {
    let mut bytes = record_header(user_id, record_id, data.len() as u64, false);
    bytes.extend(data);
    bytes
}

fn record_header(user_id: &str, record_id: u16, length: u64, extended: bool) -> Vec<u8> {
    let mut bytes = vec![0; 20];
    bytes[2..2 + user_id.len()].copy_from_slice(user_id.as_bytes());
    bytes[18..20].copy_from_slice(&record_id.to_le_bytes());
    bytes.extend(&length.to_le_bytes()[..if extended { 8 } else { 2 }]);
    bytes.extend([0; 32]);
    bytes
}

/// Waveform packet descriptor.
pub fn descriptor(bits: u8, samples: u32, spacing_ps: u32) -> Vec<u8> {
    let mut bytes = vec![bits, 0];
    bytes.extend(samples.to_le_bytes());
    bytes.extend(spacing_ps.to_le_bytes());
    bytes.extend(1f64.to_le_bytes());
    bytes.extend(0f64.to_le_bytes());
    bytes
}
