//! Pulse records.

use std::path::Path;

use super::header::{PULSE_BYTES, PulseHeader};
use crate::Result;
use crate::bytes::Fields;

/// Size of the fields that all records have.
const CORE_BYTES: usize = PULSE_BYTES as usize;

/// Pulse record (specification 0.3, "Pulse Record Type 0", 48 bytes).
///
/// Sample `k` of a segment is at `anchor + (duration + k * units_per_sample) * step`, where `step`
/// is `(target - anchor) / 1000`: see [`PulseRecord::position`] and [`super::Segment::duration_of`].
#[derive(Debug, Clone, PartialEq)]
pub struct PulseRecord {
    /// Number of the pulse in the file, from 0.
    pub index: u64,
    /// GPS time as stored; exact, defines the order of pulses.
    pub t: i64,
    /// GPS time, s: [`PulseHeader::gps_time_s`] of `t`.
    ///
    /// See [`PulseHeader::time_axis`] for the epoch.
    pub gps_time_s: f64,
    /// Offset of the waves from the start of the waves file, bytes.
    pub wave_offset: i64,
    /// Anchor as stored.
    pub anchor_raw: [i32; 3],
    /// Target as stored.
    pub target_raw: [i32; 3],
    /// Anchor x, y, z in the file's coordinate system, the origin of durations.
    ///
    /// It is the optical centre if the descriptor's `optical_center_to_anchor` is 0.
    pub anchor: [f64; 3],
    /// Target x, y, z.
    ///
    /// The point of the beam 1000 sampling units beyond the anchor. Both are rounded, so their
    /// distance is not exact.
    pub target: [f64; 3],
    /// Displacement per sampling unit.
    ///
    /// A thousandth of target minus anchor, from the stored integers.
    pub step: [f64; 3],
    /// Sampling units from the anchor to the first returning sample.
    ///
    /// Rounded; segments hold the fraction.
    pub first_returning_sample: i16,
    /// Sampling units from the anchor to the last returning sample.
    ///
    /// One more in files of several writers.
    pub last_returning_sample: i16,
    /// Index of the descriptor of the waves.
    pub descriptor: u8,
    /// Whether the pulse is the last of a scan line.
    pub edge_of_scan_line: bool,
    /// Direction of the mirror.
    ///
    /// The assignment of directions is not defined.
    pub scan_direction: bool,
    /// Facet of the mirror, 0 to 3.
    pub mirror_facet: u8,
    /// Intensity for display only.
    pub intensity: u8,
    /// Classification; no classes are defined.
    pub classification: u8,
    /// Flight line or scan of the pulse, if stored.
    pub source_id: Option<u32>,
}

impl PulseRecord {
    /// Parses record `index` from its bytes, at byte `base` of `file`.
    pub(super) fn parse(
        file: &Path,
        base: u64,
        bytes: &[u8],
        index: u64,
        header: &PulseHeader,
    ) -> Result<PulseRecord> {
        let mut f = Fields::new(file, base, bytes);
        // One check instead of fourteen: a flight has a billion pulses.
        let core: [u8; CORE_BYTES] = f.array("pulse record")?;
        let t = i64::from_le_bytes(part(&core, 0));
        let wave_offset = i64::from_le_bytes(part(&core, 8));
        let three = |at: usize| [0, 4, 8].map(|axis| i32::from_le_bytes(part(&core, at + axis)));
        let (anchor_raw, target_raw): ([i32; 3], [i32; 3]) = (three(16), three(28));
        let first_returning_sample = i16::from_le_bytes(part(&core, 40));
        let last_returning_sample = i16::from_le_bytes(part(&core, 42));
        let [descriptor, flags, intensity, classification] = part(&core, 44);
        let (short, long) = header.source_ids();
        let short = if short { Some(u32::from(f.u16("pulse source ID")?)) } else { None };
        let long = if long { Some(f.u32("pulse source ID")?) } else { None };
        let place = |raw: [i32; 3]| {
            std::array::from_fn(|axis| f64::from(raw[axis]) * header.scale[axis] + header.offset[axis])
        };
        let step = std::array::from_fn(|axis| {
            (f64::from(target_raw[axis]) - f64::from(anchor_raw[axis])) * header.scale[axis] / 1000.0
        });
        Ok(PulseRecord {
            index,
            t,
            gps_time_s: header.gps_time_s(t),
            wave_offset,
            anchor_raw,
            target_raw,
            anchor: place(anchor_raw),
            target: place(target_raw),
            step,
            first_returning_sample,
            last_returning_sample,
            descriptor,
            edge_of_scan_line: flags & 0x10 != 0,
            scan_direction: flags & 0x20 != 0,
            mirror_facet: flags >> 6,
            intensity,
            classification,
            source_id: long.or(short),
        })
    }

    /// Returns the point `duration` sampling units beyond the anchor.
    ///
    /// The result is in the file's coordinate system. By the specification, durations of *outgoing*
    /// samplings count from the optical centre; it coincides with the anchor in every known file
    /// that gives it.
    pub fn position(&self, duration: f64) -> [f64; 3] {
        std::array::from_fn(|axis| self.anchor[axis] + duration * self.step[axis])
    }
}

/// Bytes of a field.
#[inline(always)]
fn part<const N: usize>(core: &[u8; CORE_BYTES], at: usize) -> [u8; N] {
    std::array::from_fn(|i| core[at + i])
}
