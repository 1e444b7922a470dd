//! Columnar buffer of points for vectorised quantisation.

use wavex_simd::quantise::Steps;

use crate::las::extra_bytes::ExtraAttribute;
use crate::las::point::{PointLayout, Wave};
use crate::las::point_out::{PointOut, scan_angle_steps};

/// Points encoded at once; their columns fit the L1 cache.
pub const TOGETHER: usize = 128;

/// Columns of up to [`TOGETHER`] points.
#[derive(Clone)]
pub(super) struct PointTile {
    format: u8,
    n: usize,
    coordinates: [[f64; TOGETHER]; 3],
    scan_angles_deg: [f64; TOGETHER],
    gps_times_s: [f64; TOGETHER],
    intensities: [u16; TOGETHER],
    /// [`PointOut::fields`].
    fields: [u64; TOGETHER],
    return_numbers: [u8; TOGETHER],
    waves: [Wave; TOGETHER],
    /// Stored coordinates.
    raw: [[i32; TOGETHER]; 3],
    scan_angles: [i32; TOGETHER],
}

impl PointTile {
    /// Creates an empty tile for records of this format.
    pub(super) fn new(format: u8) -> PointTile {
        PointTile {
            format,
            n: 0,
            coordinates: [[0.0; TOGETHER]; 3],
            scan_angles_deg: [0.0; TOGETHER],
            gps_times_s: [0.0; TOGETHER],
            intensities: [0; TOGETHER],
            fields: [0; TOGETHER],
            return_numbers: [0; TOGETHER],
            waves: [Wave::default(); TOGETHER],
            raw: [[0; TOGETHER]; 3],
            scan_angles: [0; TOGETHER],
        }
    }

    /// Replaces the points; ignores points beyond [`TOGETHER`].
    #[inline]
    pub(super) fn fill(&mut self, points: impl Iterator<Item = PointOut>) {
        let has_waves = PointLayout::of(self.format).wave.is_some();
        let mut n = 0;
        for (i, point) in (0..TOGETHER).zip(points) {
            for (column, value) in self.coordinates.iter_mut().zip([point.x, point.y, point.z]) {
                column[i] = value;
            }
            self.scan_angles_deg[i] = f64::from(point.scan_angle_deg);
            // LAZ takes -0 and 0 as the same time, but derives later times from their bits.
            self.gps_times_s[i] = point.gps_time + 0.0;
            self.intensities[i] = point.intensity;
            self.fields[i] = point.fields(self.format);
            self.return_numbers[i] = point.return_number;
            if has_waves {
                self.waves[i] = point.wave;
            }
            n = i + 1;
        }
        self.n = n;
        scan_angle_steps(self.format).count(&self.scan_angles_deg[..n], &mut self.scan_angles[..n]);
    }

    /// Replaces the points by one point of another tile.
    pub(super) fn take_one(&mut self, from: &PointTile, number: usize) {
        let point = number % TOGETHER;
        for (column, from) in self.coordinates.iter_mut().zip(&from.coordinates) {
            column[0] = from[point];
        }
        self.gps_times_s[0] = from.gps_times_s[point];
        self.intensities[0] = from.intensities[point];
        self.fields[0] = from.fields[point];
        self.return_numbers[0] = from.return_numbers[point];
        self.waves[0] = from.waves[point];
        self.scan_angles[0] = from.scan_angles[point];
        self.n = 1;
    }

    /// Returns the return numbers, in point order.
    pub(super) fn return_numbers(&self) -> &[u8] {
        &self.return_numbers[..self.n]
    }

    /// Returns the stored coordinates of an axis, in point order.
    pub(super) fn raw(&self, axis: usize) -> &[i32] {
        &self.raw[axis][..self.n]
    }

    /// Quantises all coordinates.
    ///
    /// Returns the smallest and largest of each axis. `None` if a coordinate may exceed 32 bits.
    pub(super) fn count_steps(&mut self, scale: [f64; 3], offset: [f64; 3]) -> Option<[(i32, i32); 3]> {
        let mut ends = [(i32::MAX, i32::MIN); 3];
        for axis in 0..3 {
            let (scale, offset) = (scale[axis], offset[axis]);
            let steps = Steps { offset, scale, least: i32::MIN, largest: i32::MAX, nan: i32::MIN };
            let raw = &mut self.raw[axis][..self.n];
            steps.count(&self.coordinates[axis][..self.n], raw);
            for value in raw {
                ends[axis] = (ends[axis].0.min(*value), ends[axis].1.max(*value));
            }
        }
        // Values that do not fit, including NaN, were clamped to one of these.
        let fits = ends.iter().all(|(least, largest)| *least > i32::MIN && *largest < i32::MAX);
        fits.then_some(ends)
    }

    /// Returns the coordinates of the single point.
    pub(super) fn first(&self) -> [f64; 3] {
        self.coordinates.map(|column| column[0])
    }

    /// Sets the stored coordinates of the single point.
    pub(super) fn set_raw(&mut self, raw: [i32; 3]) {
        for (column, raw) in self.raw.iter_mut().zip(raw) {
            column[0] = raw;
        }
    }

    /// Encodes one record per point, without extra bytes.
    pub(super) fn encode(&self, records: &mut [u8], record_length: usize) {
        if self.format <= 5 {
            self.encode_at::<20>(records, record_length);
        } else {
            self.encode_at::<22>(records, record_length);
        }
        if let Some(at) = PointLayout::of(self.format).wave {
            for (record, wave) in records.chunks_exact_mut(record_length).zip(&self.waves) {
                encode_wave(wave, &mut record[at..at + WAVE_BYTES]);
            }
        }
    }

    /// Encodes formats with the time at offset `TIME_AT`.
    fn encode_at<const TIME_AT: usize>(&self, records: &mut [u8], record_length: usize) {
        for (i, record) in (0..self.n.min(TOGETHER)).zip(records.chunks_exact_mut(record_length)) {
            let record = &mut record[..TIME_AT + 8];
            let angle = self.scan_angles[i];
            let angle =
                if TIME_AT == 20 { u64::from(angle as u8) << 16 } else { u64::from(angle as u16) << 32 };
            record[..4].copy_from_slice(&self.raw[0][i].to_le_bytes());
            record[4..8].copy_from_slice(&self.raw[1][i].to_le_bytes());
            record[8..12].copy_from_slice(&self.raw[2][i].to_le_bytes());
            record[12..14].copy_from_slice(&self.intensities[i].to_le_bytes());
            record[14..22].copy_from_slice(&(self.fields[i] | angle).to_le_bytes());
            record[TIME_AT..].copy_from_slice(&self.gps_times_s[i].to_le_bytes());
        }
    }
}

/// Length of the waveform fields, bytes.
const WAVE_BYTES: usize = 29;

fn encode_wave(wave: &Wave, bytes: &mut [u8]) {
    bytes[0] = wave.descriptor;
    bytes[1..9].copy_from_slice(&wave.offset.to_le_bytes());
    bytes[9..13].copy_from_slice(&wave.size.to_le_bytes());
    bytes[13..17].copy_from_slice(&wave.location_ps.to_le_bytes());
    for (place, value) in bytes[17..WAVE_BYTES].chunks_exact_mut(4).zip(wave.direction_per_ps) {
        place.copy_from_slice(&value.to_le_bytes());
    }
}

/// Extra bytes of points written together, filled attribute by attribute.
pub struct ExtraColumns<'a> {
    records: &'a mut [u8],
    record_length: usize,
    /// Offset of the next attribute in each record.
    at: usize,
}

impl<'a> ExtraColumns<'a> {
    /// Creates columns for records with standard fields of this length.
    pub(super) fn new(
        records: &'a mut [u8],
        record_length: usize,
        standard_length: usize,
    ) -> ExtraColumns<'a> {
        ExtraColumns { records, record_length, at: standard_length }
    }

    /// Returns the number of unset bytes.
    ///
    /// Negative if too many were set.
    pub(super) fn left(&self) -> i64 {
        self.record_length as i64 - self.at as i64
    }

    /// Sets the next attribute, one value per point, at most 128.
    ///
    /// Does nothing if there are fewer values than points.
    pub fn put(&mut self, attribute: &ExtraAttribute, values: &[f64]) {
        let mut stored = [0; TOGETHER];
        attribute.quantise_column(values, &mut stored);
        let stored = &stored[..values.len().min(TOGETHER)];
        match attribute.data_type.bytes() {
            1 => self.put_bytes::<1>(stored),
            2 => self.put_bytes::<2>(stored),
            _ => self.put_bytes::<4>(stored),
        }
    }

    /// Stores the lowest bytes of each number.
    fn put_bytes<const N: usize>(&mut self, stored: &[i32]) {
        if stored.len() < self.records.len() / self.record_length {
            return;
        }
        let at = self.at;
        for (record, number) in self.records.chunks_exact_mut(self.record_length).zip(stored) {
            let bytes = number.to_le_bytes();
            if let (Some(place), Some(bytes)) = (record.get_mut(at..at + N), bytes.first_chunk::<N>()) {
                place.copy_from_slice(bytes);
            }
        }
        self.at += N;
    }

    /// Stores the same bytes in every record.
    pub(super) fn put_all(&mut self, bytes: &[u8]) {
        let end = self.at + bytes.len();
        for record in self.records.chunks_exact_mut(self.record_length) {
            if let Some(place) = record.get_mut(self.at..end) {
                place.copy_from_slice(bytes);
            }
        }
        self.at = end;
    }
}

/// Encodes one point without extra bytes, with these stored coordinates.
#[cfg(test)]
pub(in crate::las) fn record(format: u8, point: &PointOut, raw: [i32; 3]) -> Vec<u8> {
    let mut tile = PointTile::new(format);
    tile.fill(std::iter::once(point.clone()));
    tile.set_raw(raw);
    let length = PointLayout::of(format).length;
    let mut record = vec![0; length];
    tile.encode(&mut record, length);
    record
}
