//! Public header block of a written file, and its summary fields.

use super::options::{Version, WavePlace, WriterOptions};
use super::records::text;
use crate::las::header::encoding;
use crate::las::point_out::{LEGACY_RETURNS, RETURNS};

/// Offset of the number of VLRs in the header.
const N_VLRS: usize = 100;

/// Header fields that do not come from the options.
pub(super) struct Shape {
    pub(super) record_length: usize,
    pub(super) n_vlrs: usize,
    pub(super) offset_to_points: usize,
    pub(super) compressed: bool,
}

/// Encodes the header; fields that depend on points are zero.
pub(super) fn header(options: &WriterOptions, shape: &Shape) -> Vec<u8> {
    let version = options.version;
    let bit = |set: bool, bit: u16| if set { bit } else { 0 };
    let waves = match options.waveforms {
        WavePlace::None => 0,
        WavePlace::Inside => encoding::WAVES_INSIDE,
        WavePlace::Beside => encoding::WAVES_BESIDE,
    };
    let encoding = waves
        | bit(options.adjusted_gps_time, encoding::ADJUSTED_TIME)
        | bit(options.wkt.is_some() && !version.is_legacy(), encoding::WKT);
    let mut header = Vec::with_capacity(version.header_bytes().into());
    header.extend(b"LASF");
    header.extend(options.file_source_id.to_le_bytes());
    header.extend(encoding.to_le_bytes());
    header.extend([0; 16]); // project ID
    header.extend([1, version.minor()]);
    header.extend(text::<32>(options.system_identifier));
    header.extend(text::<32>(options.generating_software));
    header.extend(options.creation_day.to_le_bytes());
    header.extend(options.creation_year.to_le_bytes());
    header.extend(version.header_bytes().to_le_bytes());
    header.extend((shape.offset_to_points as u32).to_le_bytes());
    header.extend((shape.n_vlrs as u32).to_le_bytes());
    header.push(options.point_format() | if shape.compressed { 0x80 } else { 0 });
    header.extend((shape.record_length as u16).to_le_bytes());
    header.extend([0; 24]); // legacy counts: 0 for formats 6 and above
    options.scale.iter().chain(&options.offset).for_each(|value| header.extend(value.to_le_bytes()));
    header.resize(version.header_bytes().into(), 0);
    header
}

/// Stores the number of VLRs and the packet offset.
///
/// The offset is that of packets inside the file.
pub(super) fn patch_waveforms(header: &mut [u8], version: Version, n_vlrs: usize, packets_at: Option<u64>) {
    let mut put = |at: usize, bytes: &[u8]| header[at..at + bytes.len()].copy_from_slice(bytes);
    put(N_VLRS, &(n_vlrs as u32).to_le_bytes());
    let Some(packets_at) = packets_at else { return };
    put(227, &packets_at.to_le_bytes());
    if version == Version::V1_4 {
        put(235, &packets_at.to_le_bytes());
        put(243, &1u32.to_le_bytes());
    }
}

/// Header fields that summarise all points.
pub(super) struct Totals {
    pub(super) points: u64,
    by_return: [u64; 15],
    min: [i32; 3],
    max: [i32; 3],
}

impl Totals {
    pub(super) fn new() -> Totals {
        Totals { points: 0, by_return: [0; 15], min: [i32::MAX; 3], max: [i32::MIN; 3] }
    }

    /// Counts points by return number and extends the bounds.
    ///
    /// `ends` are the smallest and largest stored coordinates of each axis.
    pub(super) fn add(&mut self, version: Version, ends: [(i32, i32); 3], return_numbers: &[u8]) {
        self.points += return_numbers.len() as u64;
        let most = if version.is_legacy() { LEGACY_RETURNS } else { RETURNS };
        for return_number in return_numbers {
            // Return number 0 has no count.
            let column = usize::from((*return_number).min(most)).checked_sub(1);
            if let Some(count) = column.and_then(|column| self.by_return.get_mut(column)) {
                *count += 1;
            }
        }
        for (axis, (least, largest)) in ends.into_iter().enumerate() {
            self.min[axis] = self.min[axis].min(least);
            self.max[axis] = self.max[axis].max(largest);
        }
    }

    /// Stores the summary fields.
    ///
    /// The bounding box is that of the quantised coordinates.
    pub(super) fn patch(&self, header: &mut [u8], options: (Version, [f64; 3], [f64; 3])) {
        let (version, scale, offset) = options;
        let mut put = |at: usize, bytes: &[u8]| header[at..at + bytes.len()].copy_from_slice(bytes);
        if version.is_legacy() {
            // The writer limits points to 32 bits. Return numbers above 5 have no count.
            put(107, &(self.points as u32).to_le_bytes());
            for (column, count) in self.by_return.iter().take(5).enumerate() {
                put(111 + 4 * column, &(*count as u32).to_le_bytes());
            }
        } else {
            put(247, &self.points.to_le_bytes());
            for (column, count) in self.by_return.iter().enumerate() {
                put(255 + 8 * column, &count.to_le_bytes());
            }
        }
        if self.points == 0 {
            return;
        }
        for axis in 0..3 {
            let place = |raw: i32| f64::from(raw) * scale[axis] + offset[axis];
            put(179 + 16 * axis, &place(self.max[axis]).to_le_bytes());
            put(187 + 16 * axis, &place(self.min[axis]).to_le_bytes());
        }
    }
}
